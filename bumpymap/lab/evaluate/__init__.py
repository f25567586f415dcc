"""Compare the map with drives in the simulation."""
