import numpy as np
import pytest

from bumpymap.lab.worlds.quarry import CROWN, KERB_HEIGHT, RAMP_SLOPE_DEG, WASHBOARD_AMPLITUDE, WASHBOARD_LENGTH
from bumpymap.lab.worlds.sample import ZONES, QuarrySite
from bumpytiles import Grid

SITE = QuarrySite(1)
NAMED = [zone for zone in ZONES if zone != "outside"]


def scatter(count, seed=0):
    box = SITE.bounds
    draw = np.random.default_rng(seed).random((2, count))
    return box.west + draw[0] * (box.east - box.west), box.south + draw[1] * (box.north - box.south)


def tile_lattice(col, row, steps=40):
    inner = (np.arange(steps) + 0.5) * 3.0 / steps
    return np.meshgrid(col * 3.0 + inner, row * 3.0 + inner)


def residual_deviation(col, row):
    east, north = (axis.ravel() for axis in tile_lattice(col, row))
    z = SITE.height(east, north)
    design = np.column_stack((east - col * 3.0, north - row * 3.0, np.ones(z.size)))
    return np.std(z - design @ np.linalg.lstsq(design, z, rcond=None)[0])


def test_a_height_depends_on_its_own_place_alone():
    east, north = scatter(3000)
    together = SITE.height(east, north)
    assert np.array_equal(together[::-7], SITE.height(east[::-7], north[::-7]))
    assert np.array_equal(together.reshape(30, 100), SITE.height(east.reshape(30, 100), north.reshape(30, 100)))
    assert SITE.height(east[0], north[0]) == together[0]


def test_a_seed_gives_one_relief_and_another_seed_another():
    east, north = scatter(500)
    assert np.array_equal(SITE.height(east, north), QuarrySite(1).height(east, north))
    assert np.abs(SITE.height(east, north) - QuarrySite(2).height(east, north)).max() > 0.1
    assert np.array_equal(SITE.zone_at(east, north), QuarrySite(2).zone_at(east, north))
    with pytest.raises(ValueError, match="-1"):
        QuarrySite(-1)


def test_the_ground_is_continuous_but_for_the_kerb():
    east, north = scatter(40_000, seed=3)
    step = 1e-4
    jump = np.abs(SITE.height(east + step, north) - SITE.height(east, north))
    # The steepest stone flank is 0.25 m over 0.036 m, folded rock stays below that.
    assert jump.max() < 10.0 * step


def test_ramp_is_exactly_a_plane_of_its_slope():
    col, row = SITE.tiles_inside("ramp")
    assert col.size >= 20
    for c, r in zip(col[::3], row[::3], strict=True):
        east, north = tile_lattice(c, r)
        rise = np.gradient(SITE.height(east, north), 3.0 / 40)
        assert np.degrees(np.arctan(rise[0])) == pytest.approx(np.full(rise[0].shape, RAMP_SLOPE_DEG), abs=1e-6)
        assert np.abs(rise[1]).max() < 1e-9


def test_kerb_has_its_height_on_all_four_sides():
    west, east = SITE.bounds.west + 58.4, SITE.bounds.west + 76.4
    south, north = SITE.bounds.south + 44.3, SITE.bounds.south + 59.3
    inside = SITE.height(np.array([west + 1e-4, 512405.0, east - 1e-4, 512405.0]), _sides(south, north, -1e-4))
    outside = SITE.height(np.array([west - 1e-4, 512405.0, east + 1e-4, 512405.0]), _sides(south, north, 1e-4))
    assert inside - outside == pytest.approx(np.full(4, KERB_HEIGHT), abs=1e-5)


def _sides(south, north, out):
    middle = (south + north) / 2.0
    return np.array([middle, south - out, middle, north + out])


def test_washboard_is_a_sine_of_its_amplitude_and_wavelength():
    box = SITE.bounds
    east = box.west + np.arange(50.0, 50.0 + 40 * WASHBOARD_LENGTH, WASHBOARD_LENGTH / 20.0)[:800]
    z = SITE.height(east, box.south + 26.0 + 4.0 * np.sin(2.0 * np.pi * (east - box.west - 10.0) / 140.0))
    phase = 2.0 * np.pi * (east - box.west) / WASHBOARD_LENGTH
    trend = np.polynomial.Polynomial.fit(east - box.west, z, 5)(east - box.west)
    amplitude = 2.0 * np.hypot(np.mean((z - trend) * np.sin(phase)), np.mean((z - trend) * np.cos(phase)))
    assert amplitude == pytest.approx(WASHBOARD_AMPLITUDE, rel=0.05)


def test_road_is_crowned():
    box = SITE.bounds
    east = np.full(3, box.west + 45.0 - 20.0)
    centre = 26.0 + 4.0 * np.sin(2.0 * np.pi * 15.0 / 140.0)
    south, middle, north = SITE.height(east, box.south + centre + np.array([-5.5, 0.0, 5.5]))
    drop = middle - (south + north) / 2.0
    assert drop == pytest.approx(CROWN * 5.5, abs=0.03)


@pytest.mark.parametrize("zone", NAMED)
def test_whole_tiles_lie_in_every_zone_and_within_its_bounds(zone):
    col, row = SITE.tiles_inside(zone)
    assert col.size >= {"pond": 2, "pad": 6, "stockpile": 5}.get(zone, 20)
    box = SITE.zone_bounds(zone)
    assert col.min() * 3.0 >= box.west - 0.25
    assert (col.max() + 1) * 3.0 <= box.east + 0.25
    assert row.min() * 3.0 >= box.south - 0.25
    assert (row.max() + 1) * 3.0 <= box.north + 0.25
    for c, r in zip(col[::9], row[::9], strict=True):
        assert np.all(SITE.zone_at(*tile_lattice(c, r)) == zone)


def test_tiles_inside_follow_the_grid_that_is_asked_for():
    col, row = SITE.tiles_inside("rubble", Grid(tile_size=1.5, pixels=30))
    assert col.size > 4 * SITE.tiles_inside("rubble")[0].size
    assert np.all(SITE.zone_at((col + 0.5) * 1.5, (row + 0.5) * 1.5) == "rubble")


def test_no_tile_inside_a_zone_lies_under_a_crown():
    col, row = SITE.tiles_inside("meadow")
    assert 20 <= len(SITE.trees) <= 30
    for tree in SITE.trees:
        nearest_east = np.clip(tree.easting, col * 3.0, (col + 1) * 3.0)
        nearest_north = np.clip(tree.northing, row * 3.0, (row + 1) * 3.0)
        gap = np.hypot(nearest_east - tree.easting, nearest_north - tree.northing)
        # Judged at places 0.1 m apart.
        assert gap.min() > tree.radius - 0.02


def test_pond_is_about_ten_by_eight_metres():
    box = SITE.zone_bounds("pond")
    assert (box.east - box.west, box.north - box.south) == (pytest.approx(10.0, abs=0.5), pytest.approx(8.0, abs=0.5))


def test_places_beyond_the_site_are_outside():
    box = SITE.bounds
    assert SITE.zone_at(np.array([box.west - 0.1, box.east]), np.array([box.south, box.south])).tolist() == [
        "outside",
        "outside",
    ]


def test_zones_are_as_rough_as_their_names():
    rough = {
        zone: np.median([residual_deviation(c, r) for c, r in np.transpose(SITE.tiles_inside(zone))[::4]])
        for zone in ("pad", "road", "washboard", "ruts", "rubble", "bank", "step", "ramp", "floor")
    }
    assert rough["ramp"] < 1e-9
    assert rough["pad"] < 1e-9
    assert 0.0 < rough["road"] < rough["floor"] < rough["washboard"] < rough["ruts"] < rough["rubble"] < rough["bank"]
    assert rough["ruts"] < rough["step"] < rough["rubble"]


def test_zone_without_a_place_is_refused():
    with pytest.raises(ValueError, match="outside"):
        SITE.zone_bounds("outside")
