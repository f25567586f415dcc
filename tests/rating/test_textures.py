"""Textures of tiles: the shipped network on the made forms, and what must hold for any network."""

from pathlib import Path

import numpy as np
import pytest
from cost_maps import patch_stack
from scipy.ndimage import map_coordinates

from bumpymap.core import TEXTURES, BadInputError, Reason, UsageError
from bumpymap.lab.terrains import make_textures
from bumpymap.rating.textures import TextureModel, classify
from bumpytiles import Grid


def stack_of(relief, reason=0, grid=None, count=0):
    """Tiles of known relief; no pixel tells its noise, or ``count`` points in it do."""
    relief = np.asarray(relief, np.float32)
    count, reason = np.broadcast_to(count, relief.shape), np.broadcast_to(np.uint8(reason), len(relief))
    spread = {"spread_count": count, "spread_variance": np.where(count > 0, 1e-4 * count, np.nan)}
    return patch_stack(len(relief), grid, relief_map=relief, reason=reason, **spread)


def _textures(per_texture, seed=99):
    rng = np.random.default_rng([seed, 1234])
    return np.concatenate([make_textures(texture, per_texture, rng) for texture in TEXTURES])


@pytest.fixture(scope="module")
def model():
    return TextureModel.shipped()


def seen(measure_points, relief, points, noise, rng):
    """Tiles (n, 15, 15) [m] as points of a density [1/m2] and an error [m] at random places show them."""
    n = len(relief)
    ground = np.concatenate(relief, axis=1)
    x, y = rng.uniform(0, 3 * n, int(points * 9 * n)), rng.uniform(0, 3, int(points * 9 * n))
    row, col = np.clip(14.5 - 5 * y, 0, 14), np.clip(5 * x - 0.5, 0, 15 * n - 1)
    z = map_coordinates(ground, (row, col), order=1) + rng.normal(0, noise, len(x))
    return measure_points(x, y, z)


@pytest.mark.parametrize(("points", "noise"), [(5, 0.02), (10, 0.05), (30, 0.001), (100, 0.005), (400, 0.05)])
def test_level_ground_is_flat_through_any_noise(model, measure_points, points, noise):
    patches = seen(measure_points, np.zeros((60, 15, 15)), points, noise, np.random.default_rng(0))
    judged = patches.reason == Reason.OK
    assert judged.all() or points <= 10, "only few points leave too many holes"
    answer = classify(patches, model)[judged].argmax(axis=1)
    assert np.count_nonzero(answer) <= (0.05 if points > 10 else 0.15) * len(answer)


@pytest.mark.parametrize(("k", "relief"), [(0, 0.2), (1, 0.2), (1, 0.6), (2, 0.6), (2, 1.2), (3, 1.2), (3, 2.5)])
@pytest.mark.parametrize(("points", "noise"), [(20, 0.01), (400, 0.05)])
def test_each_form_at_its_relief_is_told_through_noise(model, measure_points, k, relief, points, noise):
    rng = np.random.default_rng([k, points])
    patches = seen(measure_points, relief * make_textures(TEXTURES[k], 100, rng), points, noise, rng)
    assert (classify(patches, model).argmax(axis=1) == k).mean() > 0.9


@pytest.mark.parametrize(("wavelength", "crossing"), [(0.4, False), (0.6, True), (0.75, False), (0.75, True)])
def test_short_regular_waves_are_never_taken_for_smooth_ground(model, measure_points, wavelength, crossing):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 29.9, (2, 90_000))
    k = 2 * np.pi / wavelength
    for turn in np.linspace(0, np.pi / 2, 5):
        along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
        z = 0.1 * np.sin(k * along) * (np.sin(k * across) if crossing else 1.0) + 0.003 * rng.normal(size=len(x))
        flat = classify(measure_points(x, y, z), model)[:, TEXTURES.index("flat")]
        assert len(flat) == 100
        assert flat.mean() < 0.1
        assert np.quantile(flat, 0.97) < 0.5


def test_ground_without_any_relief_is_flat(model):
    level = np.zeros((3, 15, 15))
    level[1] = 5.0
    level[2] = _textures(1)[3] * 1e-3
    assert classify(stack_of(level), model)[:, 0].min() > 0.95


@pytest.mark.parametrize("grid", [Grid(1.5, 15), Grid(3.0, 30)])
def test_another_grid_is_refused_with_the_remedy(model, grid):
    relief = np.zeros((1, grid.pixels, grid.pixels))
    remedy = f"bumpymap train textures --set tile_size={grid.tile_size:g} --set network.pixels={grid.pixels}"
    with pytest.raises(UsageError, match=f"trained for 3 m with 15(.|\n)*{remedy}"):
        classify(stack_of(relief, grid=grid), model)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": None}, "not a texture network"),
        ({"pixels": None}, "damaged"),
        ({"tile_size": "wide"}, "damaged"),
        ({"classes": '["sand", "mud"]'}, "sand, mud"),
        ({"feature_version": "1"}, "version 1"),
    ],
)
def test_foreign_and_damaged_networks_are_refused(model, tmp_path, changes, message):
    onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
    proto = onnx.load_model_from_string(model.content)
    onnx.helper.set_model_props(proto, {key: value for key, value in (model.metadata | changes).items() if value})
    onnx.save_model(proto, tmp_path / "odd.onnx")
    with pytest.raises(BadInputError, match=message) as refusal:
        TextureModel.load(tmp_path / "odd.onnx")
    assert all(words in str(refusal.value) for words in ("odd.onnx", "bumpymap train"))


def test_documentation_states_the_measured_accuracies(model):
    assert len(model.content) < 1_000_000
    root = Path(__file__).resolve().parents[2]
    for page in (root / "docs/pages/textures.md", root / "bumpymap/rating/data/models/textures.md"):
        text = page.read_text(encoding="utf-8")
        assert model.metadata["command"] in text
        for name in ("accuracy_unseen", "accuracy_altered_copies", "accuracy_level", "accuracy_short_waves"):
            assert f"{100 * float(model.metadata[name]):.2f} %" in text, page
