"""A made-up run with every kind of tile, obstacles and holes, opened as a map."""

from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core import CANOPY, FREE, OBSTACLE, UNSEEN, CostTable, ObjectStack
from bumpymap.layers import open_map, write_products
from bumpymap.views import write_map_views

RUN = {
    "calibration": {"id": "c0ffee", "vehicle": "warthog", "class_limits": [0.1, 0.2, 0.4]},
    "vehicle": {"name": "warthog", "width_m": 1.4, "height_m": 1.0, "clearance_m": 0.25, "speed_mps": 2.0},
    "settings": {"rating": "ride", "compat": "none"},
}


def with_objects(cost_map, seed=9):
    rng = np.random.default_rng(seed)
    tiles, pixels = len(cost_map.class_id), cost_map.patches.grid.pixels
    kinds = np.array([FREE, OBSTACLE, CANOPY, UNSEEN], np.uint8)
    objects = rng.choice(kinds, (tiles, pixels, pixels), p=(0.9, 0.03, 0.03, 0.04))
    share = (objects == OBSTACLE).mean(axis=(1, 2)).astype(np.float32)
    height, canopy = np.where(share > 0, 0.5, 0.0).astype(np.float32), (objects == CANOPY).mean(axis=(1, 2))
    bare = ObjectStack.empty(tiles, pixels)
    stack = replace(bare, objects=objects, obstacle=share, obstacle_height=height, canopy=canopy.astype(np.float32))
    return replace(cost_map, objects=stack)


def write_map(cost_map, folder, *, local=False):
    folder.mkdir()
    write_products(CostTable.of(cost_map), folder, views=write_map_views, local=local, manifest=RUN)
    return folder


@pytest.fixture(name="write_map", scope="session")
def write_map_fixture():
    return write_map


@pytest.fixture(name="with_objects", scope="session")
def with_objects_fixture():
    return with_objects


@pytest.fixture(scope="session")
def folder(make_field, tmp_path_factory):
    return write_map(with_objects(make_field(21, 16)), tmp_path_factory.mktemp("export") / "site")


@pytest.fixture(scope="session")
def route_map(folder):
    return open_map([folder])


@pytest.fixture(scope="session")
def easy_folder(make_field, tmp_path_factory):
    """Most of it is passable."""
    return write_map(make_field(24, 20, easy=True, holes=0.05), tmp_path_factory.mktemp("export") / "easy")


@pytest.fixture(scope="session")
def easy_map(easy_folder):
    return open_map([easy_folder])
