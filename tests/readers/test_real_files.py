"""Every real file either gives all its points or a BadInputError; what each is was looked up by hand."""

from pathlib import Path

import numpy as np
import pytest
from point_files import read_points

from bumpymap.core import BadInputError, common_georeference, horizontal_of
from bumpymap.readers import find_surveys, open_survey

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"
LAS, PLY = SHARED / "zoo" / "las", SHARED / "zoo" / "ply"
REFUSED = {
    "simple1_3.las": "32632",  # a CRS code where a unit belongs, and an extent a thousand times too large
    "simple1_4.las": "degrees",
    "pdrf10-1.5.laz": "cannot be decoded",
    "pdrf7-v4-1.4.laz": "cannot be decoded",
    "pdrf9-1.5.laz": "cannot be decoded",
    **dict.fromkeys(("empty.ply", "emptyIO_ply_empty_ascii.ply", "emptyIO_ply_empty_bin.ply"), "holds no points"),
    "emptyIO_ply_empty_header.ply": "vertex",
}
FILES = find_surveys([SHARED]) if SHARED.is_dir() else []

pytestmark = [
    pytest.mark.realdata,
    pytest.mark.skipif(not FILES, reason="the real surveys (../shared/data) are not here"),
    pytest.mark.slow,
]


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_real_file_is_read_in_full_or_refused(path):
    if path.name in REFUSED:
        with pytest.raises(BadInputError, match=REFUSED[path.name]):
            open_survey(path)
        return
    reader, points = open_survey(path), 0
    for cloud in reader.clouds():
        points += len(cloud.easting)
        assert all(np.isfinite(axis).all() for axis in (cloud.easting, cloud.northing, cloud.upward))
    assert points == reader.info.point_count - sum(reader.dropped.values())
    assert path.name != "godie_espacio.laz" or points == 10_515_262


PLAIN = [f"pdrf{name}" for name in ("4-1.3", "5-1.3", "6-1.4", "8-1.4", "9-1.4", "10-1.4")]


@pytest.mark.parametrize(
    ("one", "other"),
    [*((f"{name}.las", f"{name}.laz") for name in PLAIN), ("copc_ellipsoid.laz", "copc_ellipsoid.copc.laz")],
)
def test_twins_hold_the_same_points(one, other):
    readers = [open_survey(LAS / "loadersgl" / name) for name in (one, other)]
    tables = [np.column_stack(read_points(reader)) for reader in readers]
    if ".copc." in other:
        assert readers[1].info.format.startswith("COPC")
        tables = [table[np.lexsort(table.T)] for table in tables]
    assert np.array_equal(*tables)


@pytest.mark.parametrize(
    ("name", "code", "unit", "unit_z"),
    [
        ("laspy/autzen_geo_proj.las", 2994, 0.3048, 0.3048),
        ("laspy/1_4_w_evlr.laz", 2903, 1200 / 3937, 1200 / 3937),
        ("laspy/append-bug.laz", 2154, 1.0, 1.0),
        ("laspy/simple.copc.laz", 2991, 1.0, 1200 / 3937),
        ("las-rs/autzen.copc.laz", 2992, 0.3048, 1200 / 3937),
        ("las-rs/32-1-472-150-76.laz", 25832, 1.0, 1.0),
        ("../../surveys/bcts_adjoining", 3005, 1.0, 1.0),  # adjoining files share a CRS
    ],
)
def test_crs_and_units_of_real_files(name, code, unit, unit_z):
    place = common_georeference([open_survey(path).info for path in find_surveys([LAS / name])])
    assert horizontal_of(place.crs).to_epsg() == code
    assert (place.metres_per_unit, place.metres_per_unit_z) == (unit, unit_z)


def test_points_of_ply_files_are_those_of_trimesh():
    trimesh, compared = pytest.importorskip("trimesh"), 0
    for path in sorted(PLY.rglob("*.ply")):
        try:
            seen = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
        except Exception:  # noqa: BLE001, S112 - what it cannot read says nothing about us
            continue
        if seen["x"].size == 0:
            continue
        expected = np.column_stack([np.asarray(seen[axis], np.float64).ravel() for axis in "xyz"])
        np.testing.assert_allclose(read_points(open_survey(path))[0], expected, rtol=1e-6, atol=1e-6, err_msg=str(path))
        compared += 1
    assert compared >= 20
