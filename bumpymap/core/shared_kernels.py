"""Planes, as the kernels of scans have them; those of compiled loops stand in ``planes.hpp``."""

Plane = tuple[float, float, float, float]
"""Unit normal (a, b, c), upward, and d of a x + b y + c z + d = 0; all zero where there is none."""

NO_PLANE: Plane = (0.0, 0.0, 0.0, 0.0)
"""Of points that span none: its normal is zero."""
