"""Textures of tiles: the shipped network, and what must hold for any network."""

import json
import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.core.types import TEXTURES, PatchStack, Reason
from bumpymap.rating.textures import FLAT_RELIEF, TextureModel, classify, make_textures
from bumpytiles import Grid


def _stack(relief, reason=None, grid=None):
    n = len(relief)
    floats, whole = np.zeros(n), np.zeros(n, np.int64)
    relief = np.asarray(relief, np.float32)
    return PatchStack(
        grid=grid or Grid(),
        col=np.arange(n),
        row=whole,
        count=whole,
        z_min=floats,
        z_max=floats,
        z_variance=floats,
        ransac_residual=floats,
        slope=floats,
        z_range=floats,
        density=floats,
        coverage=floats,
        heights=relief,
        spread_count=np.zeros(relief.shape, np.int32),
        spread_variance=relief,
        relief_map=relief,
        relief=floats,
        reason=np.zeros(n, np.uint8) if reason is None else np.asarray(reason, np.uint8),
    )


def _textures(per_texture, seed=99):
    rng = np.random.default_rng([seed, 1234])
    return np.concatenate([make_textures(texture, per_texture, rng) for texture in TEXTURES])


@pytest.fixture(scope="module")
def model():
    return TextureModel.shipped()


def test_shipped_network_knows_fresh_textures(model):
    per_texture = 250
    relief = _textures(per_texture) * 0.4 - 0.1
    probability = classify(_stack(relief), model).probability
    assert np.abs(probability.sum(axis=1) - 1).max() < 1e-5
    assert np.abs(classify(_stack(100 * relief), model).probability - probability).max() < 1e-3, (
        "height does not matter"
    )
    answer = probability.argmax(axis=1).reshape(4, per_texture)
    right = (answer == np.arange(4)[:, None]).mean(axis=1)
    assert right.mean() >= 0.97
    assert right.min() >= 0.93


@pytest.mark.parametrize("wavelength", [0.4, 0.5, 0.6, 0.75])
@pytest.mark.parametrize("crossing", [False, True])
def test_short_regular_waves_are_never_taken_for_smooth_ground(model, measure_points, wavelength, crossing):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 29.9, (2, 90_000))
    k = 2 * np.pi / wavelength
    for turn in np.linspace(0, np.pi / 2, 5):
        along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
        z = 0.1 * np.sin(k * along) * (np.sin(k * across) if crossing else 1.0) + 0.003 * rng.normal(size=len(x))
        flat = classify(measure_points(x, y, z), model).probability[:, TEXTURES.index("flat")]
        assert len(flat) == 100
        assert flat.mean() < 0.02
        assert np.quantile(flat, 0.97) < 0.5


@pytest.mark.parametrize("sizes", [[1] * 30, [255, 1, 256, 88], [257, 343], [100, 500], [600]])
def test_the_way_a_stack_is_split_changes_no_bit(model, sizes):
    relief = _textures(150)[np.random.default_rng(0).permutation(600)][: sum(sizes)]
    whole = classify(_stack(relief), model).probability
    borders = np.cumsum([0, *sizes])
    parts = [classify(_stack(relief[a:b]), model).probability for a, b in pairwise(borders)]
    assert_array_equal(np.concatenate(parts), whole)


def test_order_changes_no_bit(model):
    relief = _textures(75)
    order = np.random.default_rng(5).permutation(len(relief))
    assert_array_equal(
        classify(_stack(relief[order]), model).probability, classify(_stack(relief), model).probability[order]
    )


def test_unknown_tiles_stay_unknown_and_disturb_nobody(model):
    relief = _textures(3)
    reason = np.zeros(12, np.uint8)
    reason[[0, 5]] = Reason.TOO_FEW_POINTS, Reason.TOO_MANY_HOLES
    holed = relief.copy()
    holed[[0, 5]] = np.nan
    probability = classify(_stack(holed, reason), model).probability
    assert np.isnan(probability[[0, 5]]).all()
    others = np.setdiff1d(np.arange(12), [0, 5])
    assert_array_equal(probability[others], classify(_stack(relief), model).probability[others])


def test_level_ground_is_flat_for_certain(model):
    level = np.zeros((3, 15, 15))
    level[1] = 5.0
    level[2] = _textures(1)[3] * 0.9 * FLAT_RELIEF
    assert_array_equal(classify(_stack(level), model).probability, [[1, 0, 0, 0]] * 3)
    rough = classify(_stack(_textures(1)[3:] * 2 * FLAT_RELIEF), model).probability
    assert rough[0].argmax() == 3


def test_a_hole_in_known_ground_is_an_error(model):
    relief = _textures(1)
    relief[0, 3, 3] = np.nan
    with pytest.raises(ValueError, match="has NaN"):
        classify(_stack(relief), model)


@pytest.mark.parametrize("grid", [Grid(1.5, 15), Grid(3.0, 30)])
def test_another_grid_is_refused_with_the_remedy(model, grid):
    relief = np.zeros((1, grid.pixels, grid.pixels))
    with pytest.raises(UsageError, match="trained for 3 m with 15") as refusal:
        classify(_stack(relief, grid=grid), model)
    assert f"bumpymap train textures --set tile_size={grid.tile_size:g} --set network.pixels={grid.pixels}" in str(
        refusal.value
    )


def test_shipped_file_says_where_it_comes_from(model):
    assert len(model.content) < 1_000_000
    assert json.loads(model.metadata["classes"]) == list(TEXTURES)
    assert (model.tile_size, model.pixels) == (3.0, 15)
    assert model.metadata["command"].startswith("bumpymap train ")
    assert float(model.metadata["accuracy_unseen"]) >= 0.985
    assert float(model.metadata["accuracy_altered_copies"]) >= 0.985
    for name in ("confusion_unseen", "confusion_altered_copies"):
        assert np.array(json.loads(model.metadata[name])).shape == (4, 4)
    assert len(model.id) == 12


def _with_metadata(model, **changes):
    onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
    proto = onnx.load_model_from_string(model.content)
    props = {**model.metadata, **changes}
    onnx.helper.set_model_props(proto, {key: value for key, value in props.items() if value is not None})
    return proto.SerializeToString()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": None}, "not a texture network"),
        ({"pixels": None}, "damaged"),
        ({"tile_size": "wide"}, "damaged"),
        ({"classes": '["sand", "mud"]'}, "sand, mud"),
        ({"feature_version": "2"}, "version 2"),
    ],
)
def test_foreign_and_damaged_networks_are_refused(model, tmp_path, changes, message):
    (tmp_path / "odd.onnx").write_bytes(_with_metadata(model, **changes))
    with pytest.raises(BadInputError, match=message) as refusal:
        TextureModel.load(tmp_path / "odd.onnx")
    assert "odd.onnx" in str(refusal.value)
    assert "bumpymap train" in str(refusal.value)


@pytest.mark.parametrize("content", [b"", b"no model at all", "half", None])
def test_files_that_are_no_model_are_refused(model, tmp_path, content):
    path = tmp_path / "bad.onnx"
    if content == "half":
        content = model.content[: len(model.content) // 2]
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadInputError, match=r"bad\.onnx"):
        TextureModel.load(path)


def test_onnxruntime_is_loaded_only_when_used():
    program = "import sys, bumpymap.rating.textures; assert not {'onnxruntime', 'torch', 'onnx'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True, env=dict(os.environ))


def test_documentation_states_the_measured_accuracies(model):
    root = Path(__file__).resolve().parents[2]
    pages = [root / "docs/pages/textures.md", root / "bumpymap/rating/data/models/textures.md"]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        for name in ("accuracy_unseen", "accuracy_altered_copies", "accuracy_short_waves"):
            assert f"{100 * float(model.metadata[name]):.2f} %" in text, page
        now = model.metadata["command"].replace("train", "train textures")  # of a time when settings were options
        now = now.replace("--pixels ", "--network.pixels ").replace("patches-per", "patches_per")
        now = re.sub(r"--(\S+) ", lambda found: f"--set {found[1].replace('-', '_')}=", now)
        assert now in text
