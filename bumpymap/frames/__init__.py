"""Readers of scans: frames of a moving robot's LiDAR and its poses."""
