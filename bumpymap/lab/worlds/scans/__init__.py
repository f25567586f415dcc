"""Labelled outdoor scenes and a simulated LiDAR. Only ``lidar`` imports open3d."""
