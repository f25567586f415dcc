"""A batch: many surveys, each mapped to a folder of its own, with one summary."""
