"""The made-up outdoors that scans are practised on: labelled scenes, and a LiDAR that looks around in them.

Everything is seeded: the same seed gives the same bits on the same machine. Only ``lidar.py`` imports open3d.
"""

from bumpymap.scan_world.folder import write_folder
from bumpymap.scan_world.lidar import SimulatedScan, load_open3d, simulate
from bumpymap.scan_world.overhead import look_down
from bumpymap.scan_world.scene import THEMES, Scene, make_scene
from bumpymap.scan_world.sensor import SENSORS, Sensor, draw_sensor

__all__ = [
    "SENSORS",
    "THEMES",
    "Scene",
    "Sensor",
    "SimulatedScan",
    "draw_sensor",
    "load_open3d",
    "look_down",
    "make_scene",
    "simulate",
    "write_folder",
]
