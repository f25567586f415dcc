from .read import (
    read_scan as read_scan,
    scene_points as scene_points,
)
