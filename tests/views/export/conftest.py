"""A made-up run with every kind of tile, obstacles and holes, opened as a map."""

import pytest
from cost_maps import with_objects
from route_maps import write_folder

from bumpymap.layers import open_map

RUN = {
    "calibration": {"id": "c0ffee", "vehicle": "warthog", "class_limits": [0.1, 0.2, 0.4]},
    "vehicle": {"name": "warthog", "width_m": 1.4, "height_m": 1.0, "clearance_m": 0.25, "speed_mps": 2.0},
}


def write_map(cost_map, folder):
    return write_folder(folder, cost_map, **RUN)


@pytest.fixture(name="write_map", scope="session")
def write_map_fixture():
    return write_map


@pytest.fixture(scope="session")
def folder(make_field, tmp_path_factory):
    return write_map(with_objects(make_field(21, 16)), tmp_path_factory.mktemp("export") / "site")


@pytest.fixture(scope="session")
def route_map(folder):
    return open_map(folder)


@pytest.fixture(scope="session")
def easy_folder(make_field, tmp_path_factory):
    """Most of it is passable."""
    return write_map(make_field(24, 20, easy=True, holes=0.05), tmp_path_factory.mktemp("export") / "easy")


@pytest.fixture(scope="session")
def easy_map(easy_folder):
    return open_map(easy_folder)
