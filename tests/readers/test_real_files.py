"""Every real file either gives all its points or a BadInputError; what each is was looked up by hand."""

from pathlib import Path

import numpy as np
import pytest

from bumpymap.core import common_georeference, horizontal_of
from bumpymap.core.errors import BadInputError
from bumpymap.readers import ReadOptions, find_surveys, open_survey

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"
REFUSED = {
    "simple1_3.las": "32632",  # a CRS code where a unit belongs, and an extent a thousand times too large
    "simple1_4.las": "degrees",
    "pdrf10-1.5.laz": "cannot be decoded",
    "pdrf7-v4-1.4.laz": "cannot be decoded",
    "pdrf9-1.5.laz": "cannot be decoded",
    "empty.ply": "0 vertices",
    "emptyIO_ply_empty_ascii.ply": "0 vertices",
    "emptyIO_ply_empty_bin.ply": "0 vertices",
    "emptyIO_ply_empty_header.ply": "vertex",
}
BIG = "godie_espacio.laz"
FILES = [path for path in find_surveys([SHARED]) if path.name != BIG] if SHARED.is_dir() else []

pytestmark = [
    pytest.mark.realdata,
    pytest.mark.skipif(not FILES, reason="the real surveys (../shared/data) are not here"),
    pytest.mark.slow,
]


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_real_file_is_read_in_full_or_refused(path, read):
    if path.name in REFUSED:
        with pytest.raises(BadInputError, match=REFUSED[path.name]):
            open_survey(path)
        return
    reader = open_survey(path)
    points, ground = read(reader)
    assert len(points) == len(ground) == reader.info.point_count - sum(reader.dropped.values())
    assert np.isfinite(points).all()


@pytest.mark.parametrize("name", ["pdrf4-1.3", "pdrf5-1.3", "pdrf6-1.4", "pdrf8-1.4", "pdrf9-1.4", "pdrf10-1.4"])
def test_compressed_and_plain_twins_hold_the_same_points(name, read):
    folder = SHARED / "zoo" / "las" / "loadersgl"
    plain, packed = (read(open_survey(folder / f"{name}.{ending}")) for ending in ("las", "laz"))
    assert np.array_equal(plain[0], packed[0])
    assert np.array_equal(plain[1], packed[1])


def test_copc_and_its_plain_twin_hold_the_same_points(read):
    folder = SHARED / "zoo" / "las" / "loadersgl"
    twins = [read(open_survey(folder / name))[0] for name in ("copc_ellipsoid.copc.laz", "copc_ellipsoid.laz")]
    first, second = (table[np.lexsort(table.T)] for table in twins)
    assert np.array_equal(first, second)
    assert open_survey(folder / "copc_ellipsoid.copc.laz").info.format.startswith("COPC")


@pytest.mark.parametrize(
    ("name", "code", "unit", "unit_z"),
    [
        ("laspy/autzen_geo_proj.las", 2994, 0.3048, 0.3048),
        ("laspy/1_4_w_evlr.laz", 2903, 1200 / 3937, 1200 / 3937),
        ("laspy/append-bug.laz", 2154, 1.0, 1.0),
        ("laspy/simple.copc.laz", 2991, 1.0, 1200 / 3937),
        ("las-rs/autzen.copc.laz", 2992, 0.3048, 1200 / 3937),
        ("las-rs/32-1-472-150-76.laz", 25832, 1.0, 1.0),
    ],
)
def test_crs_and_units_of_real_files(name, code, unit, unit_z):
    place = open_survey(SHARED / "zoo" / "las" / name).info.georeference
    assert horizontal_of(place.crs).to_epsg() == code
    assert (place.metres_per_unit, place.metres_per_unit_z) == (unit, unit_z)


def test_a_header_a_thousand_times_too_large(read):
    path = SHARED / "zoo" / "las" / "laspy" / "simple1_3.las"
    with pytest.raises(BadInputError, match=r"no place on Earth .* header is wrong, `trust_points=True`"):
        read(open_survey(path, ReadOptions(crs="EPSG:32632")))
    points, _ = read(open_survey(path, ReadOptions(crs="EPSG:32632", trust_points=True)))
    assert len(points) == 999


def test_adjoining_files_share_a_crs():
    infos = [open_survey(path).info for path in find_surveys([SHARED / "surveys" / "bcts_adjoining"])]
    assert len(infos) == 4
    assert horizontal_of(common_georeference(infos).crs).to_epsg() == 3005


def test_the_large_survey_is_read_in_full():
    reader = open_survey(SHARED / "surveys" / BIG)
    assert sum(cloud.easting.size for cloud in reader.clouds()) == reader.info.point_count == 10_515_262
