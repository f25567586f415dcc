"""The look at a map in three dimensions: what is drawn, and drawn by Open3D itself."""

import numpy as np
import pytest
from PIL import Image
from small_surveys import run, write_survey

from bumpymap.layers import open_map
from bumpymap.views import space


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    """A slope of 0.1, and a way over it."""
    folder = tmp_path_factory.mktemp("space")
    survey = write_survey(folder / "a.las", points=60_000, height=lambda x, _: 0.1 * (x - 500_000) + 50)
    run("map", survey, "--out", folder / "layers", code=0)
    places = "--from", "500005,4000005", "--to", "500015,4000015"
    run("route", folder / "layers", *places, "--out", folder / "way", code=0)
    return folder / "layers", folder / "way"


def test_the_relief_has_its_heights_and_colours_and_ways_lie_over_it(layers):
    drawn = space.space_of(open_map(layers[0]), layers[1])
    used = drawn.vertices[np.unique(drawn.triangles)]
    slope = np.polyfit(used[:, 0], used[:, 2], 1)[0]
    assert slope == pytest.approx(0.1, abs=0.01)
    corners = drawn.vertices[drawn.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()  # seen from above
    assert drawn.colours.shape == drawn.vertices.shape
    assert 0.0 <= drawn.colours.min() < drawn.colours.max() <= 1.0
    (way,) = drawn.ways
    ground = np.polyval(np.polyfit(used[:, 0], used[:, 2], 1), way[:, 0])
    np.testing.assert_allclose(way[:, 2], ground + 0.4, atol=0.1)
    assert np.hypot(*np.diff(way[[0, -1], :2], axis=0)[0]) == pytest.approx(14.1, abs=0.5)


def test_without_a_screen_or_a_driver_it_says_what_to_do(layers, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "VK_DRIVER_FILES"):
        monkeypatch.delenv(name, raising=False)
    assert "--out view.png" in run("view", layers[0]).output
    assert "view.tif is no picture" in run("view", layers[0], "--out", tmp_path / "view.tif").output
    monkeypatch.setattr(space, "find_library", lambda _: None)
    assert "apt-get install libvulkan1" in run("view", layers[0], "--out", tmp_path / "view.png").output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.open3d
def test_open3d_draws_it_without_a_screen(layers, tmp_path):
    picture = tmp_path / "view.png"
    done = run("view", layers[0], "--route", layers[1], "--out", picture)
    if "Vulkan driver" in done.output:
        pytest.skip(done.output)
    assert done.output == f"Open {picture}.\n"
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    white, black = ((pixels == shade).all(axis=1).mean() for shade in (255, 0))
    assert 0.1 < white < 0.95  # the ground is there, and what lies beside it
    assert 0 < black < 0.05  # so is the way
