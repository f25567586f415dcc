"""EPTs of points that a test chooses: the points of a LAS file, shared out additively among the nodes of an octree."""

import copy
import json
from collections import Counter

import laspy
import numpy as np


def write_ept(folder, las_path, *, levels=3, split=None, offsets=False, compress=True, **head):
    """Write an EPT with the points of a LAS file; return the path of its ``ept.json``.

    Each point goes to the node around it at a random level. Nodes from level ``split`` on, and what is below them,
    stand in hierarchy files of their own. ``offsets``: each node has its own, as Entwine writes them. ``head`` replaces
    values of ``ept.json``.
    """
    las = laspy.read(las_path)
    xyz = np.column_stack([las.x, las.y, las.z])
    low, high = np.floor(xyz.min(axis=0)), np.ceil(xyz.max(axis=0))
    side = float((high - low).max()) + 1.0
    level = np.random.default_rng(0).integers(0, levels + 1, len(xyz))
    cells = np.floor((xyz - low) / side * 2.0 ** level[:, None]).astype(int)
    keys = ["-".join(map(str, key)) for key in np.column_stack([level, cells]).tolist()]
    for name in ("ept-data", "ept-hierarchy"):
        (folder / name).mkdir(parents=True)
    for key in dict.fromkeys(keys):
        chosen = np.array(keys) == key
        own = laspy.LasData(copy.deepcopy(las.header), las.points[chosen])
        if offsets:
            own.change_scaling(offsets=np.floor(xyz[chosen].mean(axis=0)))
        own.write(folder / "ept-data" / f"{key}.laz", do_compress=compress)
    write_hierarchy(folder, Counter(keys), split)
    cube = [*low.tolist(), *(low + side).tolist()]
    content = {
        "bounds": cube,
        "boundsConforming": [*xyz.min(axis=0).tolist(), *xyz.max(axis=0).tolist()],
        "dataType": "laszip",
        "hierarchyType": "json",
        "points": len(xyz),
        "schema": [],
        "span": 128,
        "srs": {},
        "version": "1.0.0",
    }
    path = folder / "ept.json"
    path.write_text(json.dumps(content | head), encoding="utf-8")
    return path


def write_hierarchy(folder, counts, split=None):
    """Write the files of the hierarchy."""
    files = {"0-0-0-0": {}}
    for key, points in counts.items():
        level, *place = map(int, key.split("-"))
        top = "0-0-0-0"
        if split is not None and level >= split:
            top = "-".join(map(str, [split, *(at >> (level - split) for at in place)]))
            files["0-0-0-0"][top] = -1
        files.setdefault(top, {})[key] = points
    for top, listed in files.items():
        (folder / "ept-hierarchy" / f"{top}.json").write_text(json.dumps(listed), encoding="utf-8")
