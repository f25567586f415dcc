"""Compiled loops over the points and pixels of tiles; a module that uses some loads them, so all compile at once."""
