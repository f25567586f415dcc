from .find import (
    find_frames as find_frames,
)
from .kitti import (
    label_file as label_file,
)
from .poses import (
    read_poses as read_poses,
)
from .read import (
    Robot as Robot,
    read_scan as read_scan,
    scene_points as scene_points,
)
