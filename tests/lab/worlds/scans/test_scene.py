"""Scenes follow from their seed and hold what their labels say."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bumpymap.core.errors import UsageError
from bumpymap.lab.worlds.scans.ground import ground_mesh, make_blob, make_road
from bumpymap.lab.worlds.scans.scene import ROADSIDES, THEMES, make_scene, make_street
from bumpymap.lab.worlds.scans.things import REFLECTIONS, Label, leaves, make_field

pytestmark = pytest.mark.slow

AREA = np.linspace(-30, 30, 121)
X, Y = (axis.ravel() for axis in np.meshgrid(AREA, AREA))


def _area(soup):
    edges = soup[:, 1:] - soup[:, :1]
    return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2


@pytest.mark.parametrize("theme", THEMES)
def test_the_seed_decides_every_bit_of_a_scene(theme):
    one, two, other = make_scene(3, 5, theme), make_scene(3, 5, theme), make_scene(3, 6, theme)
    assert_array_equal(one.ground.sample(X, Y).z, two.ground.sample(X, Y).z)
    assert [label for label, _ in one.things] == [label for label, _ in two.things]
    for (_, soup), (_, again) in zip(one.things, two.things, strict=True):
        assert_array_equal(soup, again)
    assert (one.ground.sample(X, Y).z != other.ground.sample(X, Y).z).any()


def test_an_unknown_theme_is_refused():
    with pytest.raises(UsageError, match="'moon'; it must be one of meadow"):
        make_scene(1, 1, "moon")


def test_all_labels_turn_up_and_all_have_an_answer_to_light():
    found = set()
    for index in range(2 * len(THEMES)):
        scene = make_scene(8, index)
        found |= {label for label, _ in scene.things} | set(scene.ground.sample(X, Y).label.tolist())
    assert found == set(REFLECTIONS) == set(Label) - {Label.VOID}


def test_nothing_but_ground_is_nearer_than_the_robot_is_wide():
    for index in range(len(THEMES)):
        for label, soup in make_scene(9, index).things:
            if label not in {Label.TREE, Label.RUBBLE}:  # a crown may hang over it
                assert np.hypot(soup[..., 0], soup[..., 1]).min() > 1.0, label


def test_water_is_level_and_ground_is_not():
    rng = np.random.default_rng(4)
    scene = make_scene(1, 0, "meadow")
    pond = make_blob(rng, Label.WATER, (8.0, 0.0), 6.0, 0.001, -0.5)
    ground = replace(scene.ground, regions=(pond,))
    sample = ground.sample(X, Y)
    wet = sample.label == Label.WATER
    assert_array_equal(wet, pond.reach(X, Y) < 1)
    assert 0.2 < wet.sum() * 0.25 / (np.pi * 36) < 3  # a quarter of a square metre each
    assert np.abs(sample.z[wet] + 0.5).max() < 0.01
    far = pond.reach(X, Y) > 1.4
    dry = replace(ground, regions=()).sample(X, Y)
    assert_array_equal(sample.z[far], dry.z[far])


def test_roads_are_graded_and_tracks_have_ruts_150_cm_apart():
    rng = np.random.default_rng(5)
    scene = make_scene(1, 0, "meadow")
    way = replace(make_road(rng, Label.DIRT, 0.0), bearing=(1.0, 0.0), bends=(), rut_m=0.2, rough_m=0.0)
    ground = replace(scene.ground, regions=(way,), hills_m=0.0, cover_rough_m=0.0, bumps_m=0.1, slope=(0.0, 0.0))
    y = np.linspace(-1.2, 1.2, 2401)
    across = ground.sample(np.zeros_like(y), y).z
    assert_allclose(abs(y[np.argmin(across)]), 0.75, atol=0.02)
    assert across.min() == pytest.approx(-0.2, abs=0.02)
    assert_allclose(across, across[::-1], atol=1e-12)  # the bumps are gone
    flat = replace(ground, regions=(replace(way, rut_m=0.0),)).sample(np.zeros_like(y), y)
    assert np.abs(flat.z).max() < 1e-12


def test_a_kerb_is_a_step_of_concrete():
    way = replace(make_road(np.random.default_rng(5), Label.ASPHALT, 0.0), bearing=(1.0, 0.0), bends=(), kerb_m=0.12)
    way = replace(way, crown_m=0.0)
    ground = replace(make_scene(1, 0, "meadow").ground, regions=(way,), hills_m=0.0, bumps_m=0.0, slope=(0.0, 0.0))
    y = way.half_width_m + np.array([-0.1, 0.1, 0.4])
    sample = ground.sample(np.zeros(3), y)
    assert sample.label.tolist() == [Label.ASPHALT, Label.CONCRETE, Label.GRASS]
    assert sample.z[1] - sample.z[0] == pytest.approx(0.12, abs=0.03)


def test_a_pavement_lies_behind_its_kerb_and_a_ditch_beside_its_road():
    way = replace(make_road(np.random.default_rng(5), Label.ASPHALT, 0.0), bearing=(1.0, 0.0), bends=(), crown_m=0.0)
    street = replace(way, kerb_m=0.12, pavement_m=2.0)
    beyond = np.array([-0.1, 0.1, 1.9, 2.1])
    on = (np.zeros(4), street.half_width_m + beyond)
    assert_allclose(street.relief(*on), [0.0, 0.12, 0.12, 0.12])
    assert_allclose(street.on_kerb(street.across(*on)), [0, 1, 1, 0])
    country = replace(way, kerb_m=0.0, ditch_m=0.8, verge_m=2.0, banks_m=(-1.0, 3.0), bank_width_m=5.0)
    beyond = np.array([0.0, 2.0, 4.0, 7.0])
    for side, bank in ((1.0, 3.0), (-1.0, -1.0)):
        found = country.relief(np.zeros(4), side * (country.half_width_m + beyond))
        assert_allclose(found[[0, 1, 3]], [0.0, -0.8, bank], atol=1e-12)


def test_places_along_a_road_are_as_far_from_its_centreline_as_asked():
    for seed in range(5):
        way = make_street(np.random.default_rng(seed), ROADSIDES["street"])
        along, across = np.linspace(-80, 80, 33), np.linspace(-9, 9, 33)
        place = way.places(along, across)
        assert_allclose(way.across(place[:, 0], place[:, 1]), across, atol=0.05)
        ahead = way.places(along + 0.01, np.zeros(33)) - way.places(along, np.zeros(33))
        assert_allclose(np.cos(np.arctan2(ahead[:, 1], ahead[:, 0]) - place[:, 2]), 1.0, atol=1e-6)
        assert abs(way.across(np.zeros(1), np.zeros(1))[0]) < way.half_width_m + way.pavement_m


def test_slopes_reach_35_degrees_and_no_more():
    steep = 0.0
    for index in range(16):
        scene = make_scene(6, index, "hillside")
        for bank in scene.ground.banks:
            x, y = np.random.default_rng(index).uniform(-60, 60, (2, 4000))
            slopes = [(bank.rise(x + e, y + n) - bank.rise(x, y)) / 0.01 for e, n in ((0.01, 0.0), (0.0, 0.01))]
            steep = max(steep, np.degrees(np.arctan(np.hypot(*slopes))).max())
        assert np.hypot(*scene.ground.slope) <= np.tan(np.radians(25.0))
    assert 25 < steep < 45  # a wavy line makes it a little steeper


@pytest.mark.parametrize("theme", ROADSIDES)
def test_a_robot_stands_on_its_street(theme):
    labels = [make_scene(5, index, theme).ground.sample(np.zeros(1), np.zeros(1)).label[0] for index in range(6)]
    assert set(labels) <= {Label.ASPHALT, Label.CONCRETE}


def test_fields_have_unit_spread_the_asked_waves_and_repeat():
    field = make_field(np.random.default_rng(1), 256, 0.5, 0.7, (4.0, 40.0))
    assert field.values.std() == pytest.approx(1.0, abs=1e-3)
    power = np.abs(np.fft.rfft2(field.values)) ** 2
    k = np.hypot(np.fft.fftfreq(256, 0.5)[:, None], np.fft.rfftfreq(256, 0.5)[None, :])
    outside = (k > 1 / 4.0) | (k < 1 / 40.0)
    assert power[outside].max() < 1e-6 * power.max()
    cos, sin = field.turn
    x, y = np.random.default_rng(2).uniform(-500, 500, (2, 50))
    assert_allclose(field.at(x, y), field.at(x + 128 * cos, y + 128 * sin), atol=1e-3)


def test_leaves_stop_beams_after_their_free_path():
    """A cube cut out of a large cloud holds 1 / path m2 of leaves in a cubic metre, seen from any side."""
    rng = np.random.default_rng(3)
    soup = leaves(rng, np.zeros(3), np.full(3, 2.0), 20_000, 0.5)
    assert len(soup) == 20_000
    volume = 4 / 3 * np.pi * 8
    # Triangles any way up show half of their area; sides vary by 0.6 to 1.4, which adds 5 % of area.
    assert _area(soup) / volume / 2 == pytest.approx(1 / 0.5, rel=0.08)


def test_the_mesh_follows_the_ground(monkeypatch):
    monkeypatch.setattr("bumpymap.lab.worlds.scans.ground.STEP", 0.03)
    ground = make_scene(2, 3).ground
    corners, triangles = ground_mesh(ground, np.random.default_rng(1), 20.0)
    assert_allclose(corners[:, 2], ground.sample(*corners[:, :2].astype(float).T).z, atol=0.05)
    edges = corners[triangles[:, 1:]] - corners[triangles[:, :1]]
    up = np.cross(edges[:, 0], edges[:, 1])[:, 2]
    assert (up > 0).all() or (up < 0).all()  # no triangle is folded over
