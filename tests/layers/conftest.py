"""Made-up maps as fixtures."""

from dataclasses import replace

import numpy as np
import pytest
from cost_maps import make_field, make_map

from bumpymap.core import CostTable


@pytest.fixture(scope="session")
def cost_map():
    return make_field(40, 30)


@pytest.fixture(scope="session")
def at_two_speeds():
    """A table with the ride at 0.5 and 2 m/s."""
    field = make_field(12, 10)
    slow = np.stack([field.c_r, field.c_r, field.c_r / 4], axis=1)
    motion = np.hstack([slow, 2 * slow]).astype(np.float32)
    return replace(CostTable.of(replace(field, motion=motion)), speeds=(0.5, 2.0))


@pytest.fixture(name="make_map", scope="session")
def make_map_fixture():
    return make_map


@pytest.fixture(name="make_field", scope="session")
def make_field_fixture():
    return make_field
