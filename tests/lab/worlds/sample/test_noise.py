import numpy as np
import pytest

from bumpymap.lab.worlds.quarry import BlockLayer, WaveField, smooth_step, uniform


def test_smooth_step_is_exact_at_and_beyond_its_ends_and_may_fall():
    value = np.array([-1.0, 0.0, 1.0, 2.0, 3.0])
    assert smooth_step(value, 0.0, 2.0).tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert smooth_step(value, 2.0, 0.0).tolist() == [1.0, 1.0, 0.5, 0.0, 0.0]


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_wave_field_has_the_deviation_that_was_asked_for(seed):
    field = WaveField.seeded((seed, 1), 0.5, 3.0, 0.02, waves=24)
    x, y = np.random.default_rng(0).random((2, 100_000)) * 500.0
    assert field(x, y).std() == pytest.approx(0.02, rel=0.03)


def test_wave_field_depends_on_its_seed_alone():
    x, y = np.arange(5.0), np.arange(5.0)
    first = WaveField.seeded((1, 1), 0.5, 3.0, 0.02)(x, y)
    assert np.array_equal(first, WaveField.seeded((1, 1), 0.5, 3.0, 0.02)(x, y))
    assert not np.allclose(first, WaveField.seeded((2, 1), 0.5, 3.0, 0.02)(x, y))


def test_lattice_numbers_are_uniform_and_unlike_their_neighbours():
    column, line = np.meshgrid(np.arange(-100, 100), np.arange(-100, 100))
    draw = uniform(column, line, 5)
    counts, _ = np.histogram(draw, bins=10, range=(0.0, 1.0))
    assert counts.sum() == draw.size
    assert np.all(np.abs(counts - draw.size / 10) < 5 * np.sqrt(draw.size / 10))
    pairs = ((draw[:, 1:], draw[:, :-1]), (draw[1:], draw[:-1]), (draw, uniform(column, line, 6)))
    for one, other in pairs:
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.03


def test_stones_keep_their_heights_and_lie_only_where_they_may():
    layer = BlockLayer(3, 1.25, 0.2, 0.5)
    x, y = np.random.default_rng(1).random((2, 50_000)) * 40.0
    top = layer.height(x, y, lambda x, _: (x > 20.0).astype(float))
    assert top.min() == 0.0
    assert 0.35 < top.max() <= 0.5
    assert np.all(top[x < 19.0] == 0.0)
    assert 0.2 < np.mean(top[x > 21.0] > 0.0) < 0.9


def test_no_stone_is_cut_off_at_a_cell_border():
    layer = BlockLayer(3, 1.25, 0.2, 0.5)
    x = np.arange(0.0, 30.0, 0.0005)
    for y in (0.3, 4.7, 11.1):
        jumps = np.abs(np.diff(layer.height(x, np.full(x.shape, y), lambda x, _: np.ones(x.shape))))
        # The steepest flank: 0.5 m over 0.3 of the shortest half side, 0.2 cells.
        assert jumps.max() < 2.0 * 0.0005 * 0.5 / (0.3 * 0.2 * 1.25)
