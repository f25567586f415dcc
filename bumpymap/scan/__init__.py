"""Dynamic scenes: one scan of a moving robot in, classed sectors out."""
