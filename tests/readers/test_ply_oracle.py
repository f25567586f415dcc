"""PLY held against another reader of the format."""

import numpy as np
import pytest

from bumpymap.core.ply_file import PLY_TYPES, write_vertices
from bumpymap.readers import open_survey

trimesh = pytest.importorskip("trimesh")


def vertices(path):
    """Columns of the element ``vertex``, by name."""
    loaded = trimesh.load(path, process=False)
    return loaded.metadata["_ply_raw"]["vertex"]["data"]


def test_what_is_written_is_what_another_reader_sees(tmp_path):
    rng = np.random.default_rng(2)
    kinds = [(f"is_{code}", code) for code in dict.fromkeys(PLY_TYPES.values())]
    rows = np.empty(40, [("x", "f8"), ("y", ">f4"), ("z", "<f8"), *kinds])
    for name in rows.dtype.names:
        rows[name] = rng.integers(0, 120, 40) / (8 if rows.dtype[name].kind == "f" else 1)
    with (tmp_path / "a.ply").open("wb") as stream:
        write_vertices(rows, ["the axes are", "x, y and z"], stream)
    seen = vertices(tmp_path / "a.ply")
    for name in rows.dtype.names:
        np.testing.assert_array_equal(np.asarray(seen[name]).ravel(), rows[name])


@pytest.mark.realdata
def test_real_files_of_every_kind(shared_data, read):
    compared = 0
    for path in sorted((shared_data / "zoo" / "ply").rglob("*.ply")):
        try:
            seen = vertices(path)
        except Exception:  # noqa: BLE001, S112 - what it cannot read says nothing about us
            continue
        if seen["x"].size == 0:
            continue
        expected = np.column_stack([np.asarray(seen[axis], np.float64).ravel() for axis in "xyz"])
        points, _ = read(open_survey(path))
        assert points.shape == expected.shape, path
        np.testing.assert_allclose(points, expected, rtol=1e-6, atol=1e-6, err_msg=str(path))
        compared += 1
    assert compared >= 20
