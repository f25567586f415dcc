"""Synthetic ground with known truth: terrains, a sample survey, outdoor scenes for scans."""
