"""Made-up maps with pages and exports, a comparison, and a made-up scan with its classes."""

from dataclasses import replace

import numpy as np
import pytest
from check_records import made_up_check, on_site
from classed_site import classed_fixture, nothing_fixture, scan_fixture  # noqa: F401 (found by pytest)
from cost_maps import COLS, ROWS, make_field, survey, with_objects
from rings import write_points
from route_maps import write_folder
from scenes import Place, Scene, Solid, survey_scene
from small_surveys import no_views

import bumpymap
from bumpymap.check.pipeline import write_check
from bumpymap.layers import open_map


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """Layers of 40 x 30 tiles with every class and reason, and objects."""
    return write_folder(tmp_path_factory.mktemp("report") / "site", with_objects(make_field(40, 30)), views=True)


@pytest.fixture(scope="session")
def may(tmp_path_factory):
    """A survey whose name is markup, with ground that the next one has not."""
    about = {"name": "pit <b>", "checksum": None, "dates": ["2024-05-01", "2024-05-01"]}
    return write_folder(tmp_path_factory.mktemp("change") / "may", survey(1), survey=about)


@pytest.fixture(scope="session")
def comparison(may):
    """What has changed a year later: a rut, and a corner that was not flown, ground whose ride is unknown."""
    row, col = np.mgrid[0:ROWS, 0:COLS]
    made = survey(3, rut=0.1, c_r=3.0, tiles=(row > 4) | (col > 8))
    for ride in (made.c_r, made.c_r_low, made.c_r_high):
        ride[40:60] = np.nan
    later = {"name": "pit <b>", "checksum": None, "dates": ["2025-05-02", "2025-05-03"]}
    june = write_folder(may.parent / "june", made, survey=later)
    return bumpymap.diff_surveys(may, june, may.parent / "out").folder


@pytest.fixture(scope="session")
def checked(site, tmp_path_factory):
    """A check of the map ``site``: its folder and its findings; names are markup."""
    bad = "<img src=x onerror=alert(1)>\"'</script><script>alert(2)</script>"
    result, ground = on_site(made_up_check(50, noise=0.35, unknown=[4], drives=2, warnings=[bad]), site)
    result = replace(result, drives=(replace(result.drives[0], name=bad), result.drives[1]))
    out = tmp_path_factory.mktemp("checked") / "out"
    write_check(result, out, ground=ground)
    return out, result


RUN = {"vehicle": {"name": "warthog", "width_m": 1.4, "height_m": 1.0, "clearance_m": 0.25, "speed_mps": 2.0}}


@pytest.fixture(scope="session")
def write_map():
    return lambda cost_map, folder: write_folder(folder, cost_map, **RUN)


@pytest.fixture(scope="session")
def folder(write_map, tmp_path_factory):
    return write_map(with_objects(make_field(21, 16)), tmp_path_factory.mktemp("export") / "site")


@pytest.fixture(scope="session")
def route_map(folder):
    return open_map(folder)


@pytest.fixture(scope="session")
def easy_folder(write_map, tmp_path_factory):
    """Most of it is passable."""
    return write_map(make_field(24, 20, easy=True, holes=0.05), tmp_path_factory.mktemp("export") / "easy")


@pytest.fixture(scope="session")
def easy_map(easy_folder):
    return open_map(easy_folder)


def _solids(rng):
    """Posts, boxes and walls, each somewhere in its tile."""
    shapes = [
        {"length": 0.2, "width": 0.2, "top": 1.5},
        {"length": 0.0, "width": 0.2, "top": 1.0, "is_round": True},
        {"length": 0.3, "width": 0.3, "top": 4.0},
        {"length": 0.6, "width": 0.6, "top": 0.6},
        {"length": 1.2, "width": 0.8, "top": 1.2},
        {"length": 4.0, "width": 0.2, "top": 2.0},
        {"length": 4.0, "width": 0.3, "top": 1.0},
    ]
    places = np.stack(np.meshgrid(*[np.arange(-15.0, 16.0, 7.5)] * 2), axis=-1).reshape(-1, 2)
    places += rng.uniform(-1.5, 1.5, places.shape)
    turns = rng.choice([0.0, 45.0, 70.0], len(places))
    return [Solid(x, y, turn=turn, **shapes[n % 7]) for n, ((x, y), turn) in enumerate(zip(places, turns, strict=True))]


@pytest.fixture(scope="session", params=[True, False], ids=["classes", "no classes"])
def obstacle_site(request, tmp_path_factory):
    """A map of level ground with obstacles on it, and the middles of the pixels that they stand on, (n, 2), m."""
    folder, rng = tmp_path_factory.mktemp("obstacles"), np.random.default_rng(7)
    scene = Scene("obstacles", tuple(_solids(rng)), half=18.0)
    place = Place(0.0, 500_000 + rng.uniform(0.0, 3.0), 5_700_000 + rng.uniform(0.0, 3.0))
    points = survey_scene(scene, 400.0, classified=request.param, sides=True, place=place, noise=0.01, margin=3.0)
    write_points(points, folder / "obstacles.las")
    with no_views():
        bumpymap.map_survey(folder / "obstacles.las", folder / "layers")
    middles = np.stack(np.meshgrid(*(low + np.arange(0.1, 48.0, 0.2) for low in (499_977.0, 5_699_977.0))), axis=-1)
    x, y = place.in_scene(*np.moveaxis(middles, -1, 0))
    under = np.any([solid.inside(x, y) for solid in scene.solids], axis=0)
    return open_map(folder / "layers"), middles[under]
