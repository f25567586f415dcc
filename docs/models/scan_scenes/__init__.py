"""Labelled outdoor scenes and a simulated LiDAR, from which the shipped scan network and stripe classes were made."""
