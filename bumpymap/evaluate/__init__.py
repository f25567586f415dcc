"""The evaluation workshop: holds the map against drives in the simulation, and says how far to trust it."""
