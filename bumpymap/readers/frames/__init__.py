"""Readers of LiDAR scans of a moving robot, and of its poses."""
