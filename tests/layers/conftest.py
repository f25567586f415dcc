"""Made-up maps as fixtures."""

import pytest
from cost_maps import make_field, make_map


@pytest.fixture(scope="session")
def cost_map():
    return make_field(40, 30)


@pytest.fixture(name="make_map", scope="session")
def make_map_fixture():
    return make_map


@pytest.fixture(name="make_field", scope="session")
def make_field_fixture():
    return make_field
