"""EPTs of points that a test chooses: the points of a LAS file, shared out additively among the nodes of an octree."""

import copy
import json

import laspy
import numpy as np


def write_ept(folder, las_path, *, levels=3, split=None, offsets=False, **head):
    """Write an EPT with the points of a LAS file; return the path of its ``ept.json``.

    Each point goes to the node around it at a random level. Nodes from level ``split`` on, and what is below them,
    stand in hierarchy files of their own. ``offsets``: each node has its own, as Entwine writes them. ``head`` replaces
    values of ``ept.json``.
    """
    las = laspy.read(las_path)
    xyz = np.column_stack([las.x, las.y, las.z])
    low, side = np.floor(xyz.min(axis=0)), float(np.ceil(np.ptp(xyz, axis=0).max())) + 2.0
    level = np.random.default_rng(0).integers(0, levels + 1, len(xyz))
    cells = np.floor((xyz - low) / side * 2.0 ** level[:, None]).astype(int)
    keys, node = np.unique(np.column_stack([level, cells]), axis=0, return_inverse=True)
    files = {"0-0-0-0": {}}
    for name in ("ept-data", "ept-hierarchy"):
        (folder / name).mkdir(parents=True)
    for number, (depth, *place) in enumerate(keys.tolist()):
        name, chosen, top = "-".join(map(str, (depth, *place))), node.ravel() == number, "0-0-0-0"
        own = laspy.LasData(copy.deepcopy(las.header), las.points[chosen])
        if offsets:
            own.change_scaling(offsets=np.floor(xyz[chosen].mean(axis=0)))
        own.write(folder / "ept-data" / f"{name}.laz")
        if split is not None and depth >= split:
            top = "-".join(map(str, (split, *(at >> (depth - split) for at in place))))
            files["0-0-0-0"][top] = -1
        files.setdefault(top, {})[name] = int(chosen.sum())
    for top, listed in files.items():
        (folder / "ept-hierarchy" / f"{top}.json").write_text(json.dumps(listed), encoding="utf-8")
    content = {
        "bounds": [*low.tolist(), *(low + side).tolist()],
        "boundsConforming": [*xyz.min(axis=0).tolist(), *xyz.max(axis=0).tolist()],
        "dataType": "laszip",
        "hierarchyType": "json",
        "points": len(xyz),
        "schema": [],
        "span": 128,
        "srs": {},
        "version": "1.0.0",
    }
    (folder / "ept.json").write_text(json.dumps(content | head), encoding="utf-8")
    return folder / "ept.json"
