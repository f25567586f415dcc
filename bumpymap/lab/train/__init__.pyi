from .scan.data import (
    UNSEEN as UNSEEN,
    scene_scan as scene_scan,
)
