"""Scenes follow from their seed and hold what their labels say."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bumpymap.lab.worlds.scans.ground import ground_mesh, make_blob, make_road
from bumpymap.lab.worlds.scans.scene import ROADSIDES, THEMES, make_scene
from bumpymap.lab.worlds.scans.things import REFLECTIONS, Label

pytestmark = pytest.mark.slow

AREA = np.linspace(-30, 30, 121)
X, Y = (axis.ravel() for axis in np.meshgrid(AREA, AREA))


@pytest.mark.parametrize("theme", THEMES)
def test_the_seed_decides_every_bit_of_a_scene(theme):
    one, two, other = make_scene(3, 5, theme), make_scene(3, 5, theme), make_scene(3, 6, theme)
    assert_array_equal(one.ground.sample(X, Y).z, two.ground.sample(X, Y).z)
    assert [label for label, _ in one.things] == [label for label, _ in two.things]
    for (_, soup), (_, again) in zip(one.things, two.things, strict=True):
        assert_array_equal(soup, again)
    assert (one.ground.sample(X, Y).z != other.ground.sample(X, Y).z).any()


def test_all_labels_turn_up_and_all_have_an_answer_to_light():
    found = set()
    for index in range(2 * len(THEMES)):
        scene = make_scene(8, index)
        found |= {label for label, _ in scene.things} | set(scene.ground.sample(X, Y).label.tolist())
    assert found == set(REFLECTIONS) == set(Label) - {Label.VOID}


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


@pytest.mark.parametrize("theme", ROADSIDES)
def test_a_robot_stands_on_its_street(theme):
    labels = [make_scene(5, index, theme).ground.sample(np.zeros(1), np.zeros(1)).label[0] for index in range(6)]
    assert set(labels) <= {Label.ASPHALT, Label.CONCRETE}


def test_the_mesh_follows_the_ground(monkeypatch):
    monkeypatch.setattr("bumpymap.lab.worlds.scans.ground.STEP", 0.03)
    ground = make_scene(2, 3).ground
    corners, triangles = ground_mesh(ground, np.random.default_rng(1), 20.0)
    assert_allclose(corners[:, 2], ground.sample(*corners[:, :2].astype(float).T).z, atol=0.05)
    edges = corners[triangles[:, 1:]] - corners[triangles[:, :1]]
    up = np.cross(edges[:, 0], edges[:, 1])[:, 2]
    assert (up > 0).all() or (up < 0).all()  # no triangle is folded over
