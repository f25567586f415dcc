"""The learning method's inference: what it sees, what it refuses, and that a sector's answer is its own."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bumpymap.core import cell_numbers
from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.core.scan_types import NOT_TRAVERSABLE, PolarSettings, Scan
from bumpymap.scan.ground import cell_layout
from bumpymap.scan.learned import (
    CHANNELS,
    MEASURES,
    ScanModel,
    classify_learned,
    infer,
    network_input,
    probabilities,
)
from bumpymap.scan.polar import polar_sectors


def _world(seed=1, count=60_000):
    """Smooth ground ahead, heaps to the left, a thicket behind; (n, 3)."""
    rng = np.random.default_rng(seed)
    away, turn = rng.uniform(4, 27, count), rng.uniform(-np.pi, np.pi, count)
    x, y = away * np.cos(turn), away * np.sin(turn)
    z = -1.4 + rng.normal(0, 0.008, count)
    heaps = (y > 3) & (x > -8)
    blocks = rng.uniform(0, 0.8, (100, 100))  # 30 cm wide, up to 80 cm high
    z[heaps] += blocks[(x[heaps] / 0.3).astype(int) % 100, (y[heaps] / 0.3).astype(int) % 100]
    thicket = x < -8
    z[thicket] += rng.uniform(0, 3, thicket.sum())
    return np.column_stack([x, y, z]).astype(np.float32)


@pytest.fixture(scope="module")
def stack():
    return polar_sectors(Scan(_world()))


@pytest.fixture(scope="module")
def model():
    return ScanModel.shipped()


def test_smooth_ground_is_class_0_and_rough_ground_is_not(stack, model):
    classed = classify_learned(stack, model)
    assert classed.method == "learned"
    assert classed.stripes is None
    middle = np.array([stack.point_sector == row for row in range(len(stack.zone))]) @ _world() / stack.count[:, None]
    smooth = (middle[:, 0] > 2) & (middle[:, 1] < -1)
    heaps = (middle[:, 0] > -5) & (middle[:, 1] > 6)
    thicket = middle[:, 0] < -11
    assert (classed.class_id[smooth] == 0).mean() > 0.95
    assert (classed.class_id[heaps] == 0).mean() < 0.1
    assert (classed.class_id[thicket] > 0).all()


def test_the_gate_comes_first(stack, model):
    shut = replace(stack, traversable=stack.traversable & (np.arange(len(stack.zone)) % 2 == 0))
    class_id = classify_learned(shut, model).class_id
    assert (class_id[1::2] == NOT_TRAVERSABLE).all()
    assert set(class_id[::2][stack.traversable[::2]]) <= {0, 1, 2}
    none = replace(stack, traversable=np.zeros(len(stack.zone), bool))
    assert (classify_learned(none, model).class_id == NOT_TRAVERSABLE).all()


def test_open_sectors_share_smooth_or_fair_with_their_neighbours_and_nothing_else(stack, model):
    alone = probabilities(stack, model)
    classed = classify_learned(stack, model)
    is_open = stack.traversable & (stack.ground_count >= 0.55 * stack.count)
    assert 0 < is_open.sum() < stack.traversable.sum()
    covered = stack.traversable & ~is_open
    assert_array_equal(classed.class_id[covered], alone[covered].argmax(axis=1))
    rough = stack.traversable & (alone[:, 2] > 0.5)
    assert (classed.class_id[rough] == 2).all()
    assert (classed.class_id[stack.traversable & ~rough & (alone[:, 2] < 0.3)] < 2).all()
    # Log-odds of fair against smooth: its own, and one and a half times the mean of the open sectors around it.
    near, cell = cell_layout(stack.settings).near, cell_numbers(stack)
    smooth, fair = np.maximum(alone[:, :2], 1e-3).T
    odds = dict(zip(cell[is_open].tolist(), np.log(fair / smooth)[is_open].tolist(), strict=True))
    for row in np.flatnonzero(is_open):
        beside = [odds[other] for other in near[cell[row]].tolist() if other in odds]
        share = 1.0 / (1.0 + np.exp(-odds[cell[row]] - 1.5 * np.mean(beside or [0.0])))
        either = alone[row, 0] + alone[row, 1]
        most = max(either * share, either * (1.0 - share), alone[row, 2])
        assert classed.confidence[row] == pytest.approx(most, rel=1e-4)


def test_an_answer_does_not_depend_on_its_place_in_the_batch(stack, model):
    patches, measures = network_input(stack)
    whole = infer(model.content, {"patches": patches, "measures": measures})
    for rows in (slice(5, 6), slice(3, 40), slice(None, None, -1)):
        part = infer(model.content, {"patches": patches[rows], "measures": measures[rows]})
        assert_array_equal(part, whole[rows])


def test_what_the_network_sees(stack):
    patches, measures = network_input(stack)
    asked = stack.traversable
    assert patches.shape == (asked.sum(), CHANNELS, 15, 15)
    assert measures.shape == (asked.sum(), len(MEASURES))
    assert patches.dtype == measures.dtype == np.float32
    assert np.isfinite(patches).all()
    assert np.isfinite(measures).all()
    assert_allclose(patches[:, 0].min(axis=(1, 2)), -1)
    assert_allclose(patches[:, 0].max(axis=(1, 2)), 1)
    assert_allclose(0.05 * np.sinh(3 * patches[:, 1]), stack.heights[asked], atol=1e-5)
    assert_allclose(patches[:, 2] * stack.settings.height_m, stack.things[asked, 0], rtol=1e-5)
    assert_allclose(np.expm1(3 * patches[:, 3]), stack.things[asked, 1], rtol=1e-4)
    ground, count = stack.ground_count[asked], stack.count[asked]
    for name, wanted in (("count", ground / 200), ("ground", None)):
        column = measures[:, MEASURES.index(name)]
        assert_allclose(
            *((10**column, wanted) if wanted is not None else ((column + 1) / 2, ground / count)), rtol=1e-5
        )
    inner = ((stack.zone == 1) & (stack.ring == 0))[asked]
    assert_allclose(10 ** measures[inner, MEASURES.index("distance")] * 20, 5.0, rtol=1e-5)
    assert_allclose(10 ** measures[inner, MEASURES.index("depth")] * 4, 2.0, rtol=1e-5)
    assert_allclose(10 ** measures[inner, MEASURES.index("width")] * 4, 5.0 * 2 * np.pi / 24, rtol=1e-5)
    assert_allclose(
        10 ** measures[inner, MEASURES.index("beside")], ground[inner] / np.median(ground[inner]), rtol=1e-5
    )
    blocked = (stack.obstacle & asked)[asked]
    assert blocked.any()
    height = (measures[:, MEASURES.index("obstacle_height")] + 1) / 2 * stack.settings.height_m
    assert_allclose(height[blocked], stack.obstacle_height[asked][blocked], rtol=1e-5)
    assert_allclose(height[~blocked], 0, atol=1e-6)


def test_walls_do_not_make_the_ground_beside_them_look_wet(stack):
    """However many points obstacles catch, ground is compared with ground."""
    _, before = network_input(stack)
    crowded = replace(stack, count=stack.count + 50 * (stack.count - stack.ground_count))
    column = MEASURES.index("beside")
    assert_array_equal(network_input(crowded)[1][:, column], before[:, column])
    first = np.arange(len(stack.zone)) == np.flatnonzero(stack.traversable)[0]
    lost = replace(stack, ground_count=np.where(first, 1, stack.ground_count))
    assert network_input(lost)[1][0, column] < -1


def test_any_grid_is_classified_but_not_heightmaps_of_another_size(model):
    scan = Scan(_world())
    with pytest.raises(UsageError, match="was trained on heightmaps of 15"):
        classify_learned(polar_sectors(scan, PolarSettings(pixels=9)), model)
    grid = PolarSettings(zone_starts_m=(2.0, 10.0), end_m=26.0, sectors=(18, 36), rings=(3, 5), anchored=False)
    classed = classify_learned(polar_sectors(scan, grid), model)
    assert set(classed.class_id.tolist()) >= {0, 2}


def test_other_files_are_refused(tmp_path, model):
    with pytest.raises(BadInputError, match="cannot read"):
        ScanModel.load(tmp_path / "none.onnx")
    (tmp_path / "text.onnx").write_text("no model")
    with pytest.raises(BadInputError, match="is not an ONNX model"):
        ScanModel.load(tmp_path / "text.onnx")
    from importlib.resources import files

    (tmp_path / "other.onnx").write_bytes((files("bumpymap.rating") / "data" / "models" / "textures.onnx").read_bytes())
    with pytest.raises(BadInputError, match="not a scan network"):
        ScanModel.load(tmp_path / "other.onnx")
    onnx = pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
    old = onnx.load_model_from_string(model.content)
    for prop in old.metadata_props:
        if prop.key == "sector_version":
            prop.value = "0"
    (tmp_path / "old.onnx").write_bytes(old.SerializeToString())
    with pytest.raises(BadInputError, match="of version 0; this bumpymap uses version 3"):
        ScanModel.load(tmp_path / "old.onnx")
