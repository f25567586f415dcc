from .scan.data import (
    UNSEEN as UNSEEN,
    crowns_as_bushes as crowns_as_bushes,
    scene_scan as scene_scan,
)
