"""PLY held against another reader of the format."""

import numpy as np
import pytest

from bumpymap.readers import open_survey

trimesh = pytest.importorskip("trimesh")


def vertices(path):
    """Columns of the element ``vertex``, by name."""
    loaded = trimesh.load(path, process=False)
    return loaded.metadata["_ply_raw"]["vertex"]["data"]


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
