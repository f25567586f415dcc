"""Readers of scans: frames of a moving robot's LiDAR and its poses."""

from bumpymap.frames.find import find_frames
from bumpymap.frames.kitti import label_file
from bumpymap.frames.poses import read_poses
from bumpymap.frames.read import Robot, read_scan

__all__ = ["Robot", "find_frames", "label_file", "read_poses", "read_scan"]
