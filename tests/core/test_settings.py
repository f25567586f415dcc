"""Settings and JSON of anyone, as asked for or refused; the CRS that counts: stated, given, shared; units, places."""

import csv
import json
import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import geopandas
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
from hypothesis import given, strategies as st
from pyproj import CRS
from small_surveys import run, write_survey

from bumpymap.core import BadInputError, Georeference, Place, UsageError, common_georeference, same_crs, stated_crs
from bumpymap.core.crs import CrsStatement, GivenCrs, georeference, parse_crs, place_notes, statement_from_wkt, utm_epsg
from bumpymap.core.errors import share_text, shares_text
from bumpymap.core.files import Each, Nullable, Number, parse_json, shape_fault, write_csv
from bumpymap.core.settings import Setting, check_settings, read_settings_file, read_toml, settings_of_call

Colour = Literal["red", "blue"]


@dataclass(frozen=True, slots=True)
class Inner:
    number: float = 1.0
    corners: tuple[float, float] = (0.0, 1.0)
    counts: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Outer:
    places: tuple[Path, ...] = ()
    files: tuple[Path, ...] = ()
    file: Path | None = None
    text: str | None = None
    count: int = 0
    maybe: int | None = None
    yes: bool = False
    colour: Colour = "red"
    other: Colour | None = None
    colours: tuple[Colour, ...] = ()
    inner: Inner = field(default_factory=Inner)


def read(tmp_path, content, owner=Outer):
    file = tmp_path / "a.toml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_settings_file(file, owner) if owner else read_toml(file, "settings", UsageError)


EVERY = """
text = 'é "a"'
count = -9223372036854775808
maybe = 9223372036854775807
yes = true
colour = "blue"
other = "red"
colours = ["red", "blue"]
places = ["a", "/b"]
files = ["e", "f/g"]
file = "../h"
[inner]
number = 2
corners = [-1e-300, 1.5]
counts = [3, -4]
"""


def test_what_is_written_comes_back_and_paths_start_at_the_folder_of_the_file(tmp_path):
    assert read(tmp_path, EVERY) == {
        "text": 'é "a"',
        "count": -(2**63),
        "maybe": 2**63 - 1,
        "yes": True,
        "colour": "blue",
        "other": "red",
        "colours": ("red", "blue"),
        "places": (tmp_path / "a", Path("/b")),
        "files": (tmp_path / "e", tmp_path / "f" / "g"),
        "file": tmp_path / "../h",
        "inner": Inner(2.0, (-1e-300, 1.5), (3, -4)),
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("none = 1\nnever = 2", r"a\.toml: unknown setting never, none; there are: places, files, file"),
        ("[inner]\nnone = 1", r"a\.toml: \[inner\]: unknown setting none; there are: number, corners, counts"),
        ("inner = 1", r"inner is 1; it must be a table, \[inner\], with number, corners, counts"),
        ('places = ["a", 7]', "value 2 of places is 7; it must be a string"),
        ("count = 1.0", r"count is 1\.0; it must be a whole number"),
        ("yes = 1", "yes is 1; it must be true or false"),
        ('colour = "green"', "colour is 'green'; it must be one of red, blue"),
        ('colours = ["red", "green"]', "value 2 of colours is 'green'; it must be one of red, blue"),
        ("[inner]\nnumber = true", r"inner\.number is True; it must be a number"),
        (f"[inner]\nnumber = 1{'0' * 400}", "it must be a number"),
        ("[inner]\ncorners = [1]", r"inner\.corners is \[1\]; it must be a list of 2 numbers"),
        ("[inner]\ncounts = [1, 2.5]", r"value 2 of inner\.counts is 2\.5; it must be a whole number"),
        ("count = ", "cannot read settings from .*a.toml"),
    ],
)
def test_what_is_wrong_is_said_with_what_is_allowed(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        read(tmp_path, text)


def test_all_faults_are_said_at_once(tmp_path):
    with pytest.raises(UsageError) as caught:
        read(tmp_path, "none = 1\ncount = 1.5\nplaces = [1, 'a', 2]\n[inner]\nnumber = true\nlow = 1\n")
    first, *faults = caught.value.args
    assert first == f"{tmp_path / 'a.toml'}: 6 errors"
    assert [fault.split(";")[0] for fault in faults] == [
        "  unknown setting none",
        "  value 1 of places is 1",
        "  value 3 of places is 2",
        "  count is 1.5",
        "  [inner]: unknown setting low",
        "  inner.number is True",
    ]


def test_the_faults_of_a_hostile_file_are_said_in_short(tmp_path):
    with pytest.raises(UsageError) as caught:
        read(tmp_path, f"places = [{'1,' * 500}]")
    assert caught.value.args[0].endswith("a.toml: 500 errors")
    assert caught.value.args[-1] == "  and 460 more"
    assert len(caught.value.args) == 42


@dataclass(frozen=True, slots=True)
class Job:
    side: Annotated[float, Setting("Side of a tile", "M", 0.0, 10.0, "m", exclusive=True)] = 3.0
    count: Annotated[int, Setting("How many", "N", 1, why=", or there is nothing to do")] = 1
    offset: Annotated[float | None, Setting("Height", "M", unit="m")] = None
    speeds: Annotated[tuple[float, ...], Setting("Speeds", "LIST", 0.5, 9.0, "m/s")] = ()
    width: Annotated[Literal[4, 5], Setting("Columns", "N")] = 4

    def __post_init__(self):
        check_settings(self)


@pytest.mark.parametrize(
    ("name", "value", "text", "allowed"),
    [
        ("side", 0.0, "0.0", "a number between 0 and 10 m"),
        ("count", 0, "0", "a whole number, at least 1, or there is nothing to do"),
        ("count", 1.5, "1.5", "a whole number, at least 1"),
        ("offset", math.inf, "inf", r"a finite number \(m\)"),
        ("offset", math.nan, "nan", r"a finite number \(m\)"),
        ("speeds", (1.0, 9.5), "[1.0, 9.5]", "a list of numbers from 0.5 to 9 m/s"),
        ("width", 6, "6", "one of 4, 5"),
    ],
)
def test_one_declaration_checks_objects_files_and_calls(tmp_path, name, value, text, allowed):
    for make in (
        lambda: Job(**{name: value}),
        lambda: read(tmp_path, f"{name} = {text}\n", Job),
        lambda: settings_of_call({name: value}, Job, "call"),
    ):
        with pytest.raises(UsageError, match=f"{name}.* is .*; it must be {allowed}"):
            make()


# --- TOML that no settings can be read from ---
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"x = 1\n" * 50_000, r"it has more than 16 kB"),
        (b"x = " + b"[" * 5000, r"nested too deep"),
        (b'\\"' * 5_000, r"Invalid"),
        (b"x = 1\0", r"invalid|Invalid|Expected"),
        (b"x = '\xff'", r"not UTF-8 text at byte 5; save it as UTF-8"),
        ("x = 1".encode("utf-16"), r"not UTF-8 text at byte 0"),
        (b"x = " + b"9" * 5000, r"cannot read settings"),
        (b"x = 1\nx = 2", r"Cannot overwrite a value"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, content, message):
    with pytest.raises(UsageError, match=message) as caught:
        read(tmp_path, content, None)
    assert str(caught.value).startswith(f"cannot read settings from {tmp_path / 'a.toml'}: ")
    assert len(str(caught.value)) < 1000


def test_a_mark_of_byte_order_is_skipped(tmp_path):
    assert read(tmp_path, b"\xef\xbb\xbfa = 1", None) == {"a": 1}


def test_only_regular_files_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    for path in (tmp_path / "pipe.toml", Path("/dev/zero"), tmp_path, tmp_path / "none.toml", Path("a\0b")):
        with pytest.raises(UsageError, match=r"cannot read settings from .*: (it is a pipe|Is a|No such|embedded)"):
            read_toml(path, "settings", UsageError)


# ---- text for people and JSON of others ----


@given(st.lists(st.integers(20, 100), min_size=1, max_size=5), st.integers(0, 2))
def test_shares_of_a_whole_make_100_percent(counts, decimals):
    told = [float(text) for text in shares_text(counts, (), decimals, "")]
    assert sum(told) == pytest.approx(100.0, abs=1e-6)
    for share, count in zip(told, counts, strict=True):
        assert abs(share - 100 * count / sum(counts)) < 10.0**-decimals + 1e-6


@pytest.mark.parametrize("counts", [(1, 1, 1), (1255, 785, 745), (125, 375, 500), (495, 495, 10), (0, 0, 7)])
def test_a_share_that_is_told_elsewhere_is_the_same_everywhere(counts):
    told = shares_text(counts, (0, 1))
    assert told[:2] == [share_text(count / sum(counts)) for count in counts[:2]]
    assert sum(int(text.strip("%")) for text in told) == 100


def test_small_shares_are_not_rounded_to_nothing_nor_large_ones_to_all():
    assert shares_text([1, 9999], (), 1) == ["under 0.1%", "over 99.9%"]
    assert shares_text([0, 5]) == ["0%", "100%"]


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
        ("+1 north", "'+1 north"),
        (" -x", "' -x"),
        ("\t=1", "\\t=1"),
        ("\uff1d1", "'\uff1d1"),
        ("a\x1b[31m\u202eb\nc\udce9", "a\\x1b[31m\\u202eb\\nc\\xe9"),
        ("quarry, é 道 = 'a'", "quarry, é 道 = 'a'"),
        ("-1.50", "-1.50"),
        (-1.5, "-1.5"),
        (True, "true"),
        (None, ""),
        ("", ""),
    ],
)
def test_cells_are_text_or_numbers_and_no_formulas(tmp_path, value, cell):
    write_csv(tmp_path / "a.csv", ["one", "two"], [[value, 1]])
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["one", "two"], [cell, "1"]]


SHAPE = {"a": Number(0, 9, whole=True), "b?": [str], "c?": (Nullable(Number()),) * 2, "d?": Each({"e": bool})}


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        ({"a": 9, "more": None}, ""),
        ({"a": 1, "b": [], "c": [None, 0.5], "d": {"x": {"e": True}}}, ""),
        ({}, "it is "),
        ({"a": True}, "a is "),
        ({"a": 1, "b": ["x", 2]}, "b.1 is "),
        ({"a": 1, "c": [1, float("nan")]}, "c.1 is "),
        ({"a": 1, "d": {"x": {"e": 1}}}, "d.x.e is "),
    ],
)
def test_the_first_fault_of_a_shape_is_named(value, fault):
    found = shape_fault(value, SHAPE)
    assert found.startswith(fault)
    assert bool(found) == bool(fault)


@pytest.mark.parametrize("depth", [51, 200_000])
@pytest.mark.parametrize(("opening", "closing"), ["[]", ('{"a":', "}")])
def test_what_is_deep_is_refused(depth, opening, closing):
    with pytest.raises(ValueError, match="more than 50 deep"):
        parse_json(opening * depth + "1" + closing * depth)


pytestmark = pytest.mark.usefixtures("without_views")

US_FOOT = 1200 / 3937
HERE = Place(Path("site.laz"), (500000.0, 4000000.0, 100.0))
SILENT = CrsStatement()


def settle(statement=SILENT, crs=None, z_unit=None, place=HERE, force=None, must_agree=False, xy_unit=None):
    return georeference(place, statement, GivenCrs(crs, force, must_agree, xy_unit, z_unit))


@pytest.mark.parametrize("text", ["EPSG:32614", "epsg:32614", "32614", "+proj=utm +zone=14 +datum=WGS84"])
def test_what_a_user_may_write(text):
    assert same_crs(parse_crs(text), CRS(32614))


@pytest.mark.parametrize("text", ["", "EPSG:1", "utm zone 14", "EPSG:32614x"])
def test_what_a_user_may_not_write(text):
    with pytest.raises(UsageError, match="EPSG:32614"):
        parse_crs(text)


TRANSVERSE = (
    'PROJCS["x",GEOGCS["x",DATUM["x",SPHEROID["x",6378137,298.257]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["central_meridian",-99],UNIT["metre",1],EXTENSION["PROJ4","{}"]]'
)
DERIVED = (
    'PROJCRS["x",BASEGEOGCRS["x",DATUM["x",ELLIPSOID["x",6378137,298.257]]],CONVERSION["x",METHOD["{}"]{}],'
    'CS[Cartesian,2],AXIS["E",east],AXIS["N",north],LENGTHUNIT["metre",1]]'
)
SHIFTED = CRS("+proj=utm +zone=14 +ellps=clrk66 +nadgrids=conus +type=crs").to_wkt()


@pytest.mark.parametrize("file", ["{}", "@{}", "conus,@{}", "../{}", "http://127.0.0.1/a.tif", "C:\\a.gsb", "~/a.gsb"])
@pytest.mark.parametrize(
    "form",
    [
        "+proj=utm +zone=14 +ellps=clrk66 +nadgrids={} +type=crs",
        "proj=utm zone=14 ellps=clrk66 nadgrids = {}",
        "+proj=utm +zone=14 +datum=WGS84 +geoidgrids={} +type=crs",
        "+init={}:1",
        "+proj=pipeline +step +proj=utm +zone=14 +step +proj=hgridshift +grids={}",
        TRANSVERSE.format("+init={}:1"),
        TRANSVERSE.format("+proj=utm +zone=14 +ellps=clrk66 +nadgrids={} +title=[").replace("x", "[+"),
        DERIVED.format("PROJ-based operation method: +proj=hgridshift +grids={}", ""),
        DERIVED.format("PROJ hgridshift", ',PARAMETERFILE["grids","{}"]'),
        SHIFTED.replace('"conus"', '"{}"'),
        CRS(SHIFTED).to_json().replace('"conus"', '"{}"'),
    ],
)
def test_a_crs_that_names_a_file_elsewhere_is_refused(tmp_path, form, file):
    """PROJ would open it: a pipe would be waited for."""
    text = form.replace("{}", file.replace("{}", str(tmp_path / "a")))
    with pytest.raises(UsageError, match="names a file by its path"):
        parse_crs(text)
    assert statement_from_wkt(text).trouble


@pytest.mark.parametrize(
    "text",
    [
        SHIFTED,
        CRS(3857).to_wkt("WKT1_GDAL"),
        "+proj=utm +zone=14 +datum=WGS84 +units=us-ft +type=crs",
        "urn:ogc:def:crs:EPSG::32614",
        'LOCAL_CS["a/b",UNIT["metre",1]]',
    ],
)
def test_a_crs_may_name_what_proj_has(text):
    assert stated_crs(text) == CRS(text)


@pytest.mark.parametrize("spelling", ["WKT1_GDAL", "WKT1_ESRI", "WKT2_2019"])
@pytest.mark.parametrize("code", [32614, 3005, 2992, 2276, 2154, 31467])
def test_one_crs_in_every_spelling(code, spelling):
    statement = statement_from_wkt(CRS(code).to_wkt(spelling))
    assert same_crs(statement.crs, CRS(code))
    place, _ = settle(statement)
    assert place.metres_per_unit == {2992: 0.3048, 2276: US_FOOT}.get(code, 1.0)


# What a file states, what is given, and the CRS that counts; the units of the forced ones.
@pytest.mark.parametrize(
    ("own", "crs", "used"),
    [
        ("EPSG:32614", "EPSG:32613", "EPSG:32614"),
        ("EPSG:2276", "EPSG:32614", "EPSG:2276"),
        ("EPSG:32614+6360", "EPSG:32614+5703", "EPSG:32614+6360"),
        ("EPSG:32614+5703", "EPSG:32613", "EPSG:32614+5703"),
    ],
)
def test_a_given_crs_is_for_files_that_have_none(own, crs, used):
    file = CrsStatement(CRS(own))
    place, notes = settle(file, crs)
    assert place == settle(file)[0]
    assert place.crs == CRS(used)
    assert f"`force_crs='{crs}'`" in "".join(notes)
    with pytest.raises(UsageError, match=r"site\.laz.*`force_crs='EPSG"):
        settle(file, crs, must_agree=True)
    assert settle(file, force=crs)[0].crs.to_2d().to_epsg() == CRS(crs).to_2d().to_epsg()


@pytest.mark.parametrize(("own", "crs"), [("EPSG:32614", "EPSG:32614+5703"), ("EPSG:32614+5703", "EPSG:32614")])
def test_a_given_crs_that_agrees_supplies_heights_and_makes_no_noise(own, crs):
    place, notes = settle(CrsStatement(CRS(own)), crs, must_agree=True)
    assert (place.crs, notes) == (CRS("EPSG:32614+5703"), ())


FEET = CRS(2276).to_wkt("WKT1_GDAL").replace("0.304800609601219", "0.3048006096")
BOUND = CRS("+proj=utm +zone=33 +ellps=intl +towgs84=-87,-98,-121 +type=crs").to_wkt()
CLAUSE = 'TOWGS84[-87,-98,-121,0,0,0,0],AUTHORITY["EPSG","6230"]]'
CODED = CRS(23033).to_wkt("WKT1_GDAL").replace('AUTHORITY["EPSG","6230"]]', CLAUSE)
NAVD = "EPSG:32614+5703"


@pytest.mark.parametrize(
    ("own", "given", "crs", "units", "said"),
    [
        (NAVD, {}, NAVD, (1.0, 1.0), ""),
        (None, {"crs": NAVD}, NAVD, (1.0, 1.0), ""),
        (CRS(NAVD).to_wkt("WKT1_GDAL"), {}, NAVD, (1.0, 1.0), ""),
        # Heights that are said to be feet are metres in the layers, from the same zero.
        (NAVD, {"z_unit": "us-ft"}, NAVD, (1.0, US_FOOT), ""),
        # Depths, and heights above the ellipsoid, are left out.
        ("EPSG:32614+5715", {}, "EPSG:32614", (1.0, 1.0), ""),
        (CRS(32614).to_3d().to_wkt(), {}, "EPSG:32614", (1.0, 1.0), ""),
        # The file's unit of height stays, unless the forced CRS has one, or contradicts the file's horizontal unit.
        ("EPSG:32614+6360", {"force": NAVD}, NAVD, (1.0, 1.0), ""),
        ("EPSG:32614+6360", {"force": "EPSG:32613"}, "EPSG:32613", (1.0, US_FOOT), ""),
        ("EPSG:2276+6360", {"force": "EPSG:32614"}, "EPSG:32614", (1.0, 1.0), ""),
        (
            "EPSG:2276+6360",
            {},
            "EPSG:2276+6360",
            (US_FOOT, US_FOOT),
            "NAVD88 height (ftUS) (EPSG:6360) is not in metres",
        ),
        # A clause around a CRS with a code is taken off.
        (BOUND, {}, BOUND, (1.0, 1.0), ""),
        (CODED, {}, "EPSG:23033", (1.0, 1.0), ""),
        # A local CRS is no CRS, but has units.
        ('LOCAL_CS["pit grid",UNIT["foot",0.3048]]', {}, None, (0.3048, 0.3048), "pit grid"),
        # A unit is given where no CRS has one; heights follow it.
        (None, {"xy_unit": "us-ft"}, None, (US_FOOT, US_FOOT), ""),
        (None, {"xy_unit": "ft", "z_unit": "m"}, None, (0.3048, 1.0), ""),
        ('LOCAL_CS["pit grid",UNIT["metre",1]]', {"xy_unit": "ft"}, None, (0.3048, 0.3048), ""),
        (FEET, {"xy_unit": "ft"}, FEET, (US_FOOT, US_FOOT), ""),
    ],
)
def test_the_crs_and_the_units_that_count(own, given, crs, units, said):
    place, notes = settle(statement_from_wkt(own) if own else SILENT, **given)
    assert place.crs == (crs and CRS(crs))
    assert crs is None or place.crs.to_epsg() == CRS(crs).to_epsg()
    assert (place.metres_per_unit, place.metres_per_unit_z) == units
    assert said in "".join(notes)


def test_a_unit_that_nothing_states_is_assumed_and_one_that_contradicts_the_crs_is_refused():
    assert settle()[0] == Georeference(None, 1.0, 1.0, assumed=True)
    for known in (settle(xy_unit="m"), settle(crs="EPSG:32614"), settle(CrsStatement(None, 0.3048))):
        assert not known[0].assumed
    with pytest.raises(UsageError, match=r"site\.laz.*metre.*xy_unit='ft'.*force_crs"):
        settle(crs="EPSG:32614", xy_unit="ft")


def test_trouble_is_refused_or_set_aside():
    trouble = CrsStatement(trouble="it is a riddle")
    with pytest.raises(BadInputError, match=r"site\.laz.*riddle.*`crs`"):
        settle(trouble)
    place, notes = settle(trouble, "EPSG:32614")
    assert place.crs.to_epsg() == 32614
    assert any("riddle" in note for note in notes)


def test_earth_centred_coordinates_are_refused_with_their_zone():
    # 99.1 W, 19.4 N at 2240 m, by the closed formula on the WGS 84 ellipsoid.
    place = Place(Path("a.laz"), (-952_258.6, -5_944_768.1, 2_106_146.8))
    with pytest.raises(BadInputError, match=r"Earth-centred.*out_srs=EPSG:32614"):
        settle(CrsStatement(CRS(4978)), place=place)


def test_utm_at_the_ends_of_the_earth():
    assert [utm_epsg(*place) for place in [(10, 85), (10, -81), (180, 1), (-180, -1), (190, 1)]] == [
        5041, 5042, 32601, 32701, 32602,
    ]  # fmt: skip


@pytest.mark.parametrize("unit", [0, 1e-9, 1e12])
def test_units_that_are_none(unit):
    wkt = CRS("EPSG:32614").to_wkt("WKT1_GDAL").replace('UNIT["metre",1', f'UNIT["metre",{unit}')
    with pytest.raises(BadInputError, match=r"CRS of site\.laz is unclear: .* has an invalid unit of .*`force_crs`"):
        settle(statement_from_wkt(wkt))
    with pytest.raises(UsageError, match="has an invalid unit of"):
        settle(crs=wkt)
    assert settle(statement_from_wkt(wkt), force="EPSG:32614")[0].metres_per_unit == 1.0


@pytest.mark.parametrize(
    ("code", "x", "y", "says"),
    [
        (3857, 1e6, 6.2e6, "0.66"),  # 48.6 N: the cosine is what a metre is
        (3832, 4_000_000, -2_000_000, "one metre"),  # its area crosses the antimeridian
        (32614, 500_000, 2_136_000, ""),
        (32614, 830_000, 2_135_914, ""),  # 0.1 degrees beyond the border of the zone, as of a survey that crosses it
        (32614, 2_135_914, 480_717, "Eastings and northings seem to be swapped.*force_crs"),
        (25832, 512_350 / 0.3048, 5_403_300 / 0.3048, "Feet seem to have been read as metres.*force_crs"),
        (2227, 1_900_000, 600_000, "Metres seem to have been read as feet.*force_crs"),
        (2992, 100, 100, "local frame.*force_crs"),
        (31467, 512_350, 5_403_300, "34.8 degrees outside.*force_crs"),  # without the number of the zone
    ],
)
def test_what_is_odd_of_a_place_in_its_crs_is_noted(code, x, y, says):
    notes = place_notes(Place(Path("site.laz"), (x, y, 0.0)), CRS(code))
    assert len(notes) == bool(says)
    assert all(re.search(says, note, re.DOTALL) for note in notes)


def test_coordinates_that_are_no_place_in_their_crs_are_refused():
    with pytest.raises(BadInputError, match="is no place on Earth in WGS 84"):
        place_notes(Place(Path("site.laz"), (1e12, 1e12, 0.0)), CRS(32614))


@dataclass
class Info:
    path: Path
    georeference: Georeference


def infos(*crs):
    return [Info(Path(f"{i}.laz"), Georeference(c and CRS(c), 1.0)) for i, c in enumerate(crs)]


VERTICAL = CRS("EPSG:32614+5703").to_wkt("WKT1_GDAL").replace("Datum 1988", "Datum_1988").replace(",AUTHORITY[", ",X[")


@pytest.mark.parametrize(
    ("crs", "shared", "said"),
    [
        (("EPSG:32614", CRS(32614).to_wkt("WKT1_ESRI"), "EPSG:32614"), "EPSG:32614", ""),
        ((None, None), None, ""),
        (
            ("EPSG:32614+5703", "EPSG:32614"),
            "EPSG:32614",
            "1 of 2 files state a vertical CRS (NAVD88 height (EPSG:5703)), so the layers carry none",
        ),
        # Metres and feet from one zero share it in metres.
        (("EPSG:32614+6360", "EPSG:32614+5703"), "EPSG:32614+5703", ""),
        (("EPSG:32614+5703", VERTICAL), "EPSG:32614+5703", ""),
    ],
)
def test_files_of_one_crs_share_it_however_it_is_spelled(crs, shared, said, caplog):
    found = common_georeference(infos(*crs)).crs
    assert found == (shared and CRS(shared))
    assert found is None or found.to_epsg() == CRS(shared).to_epsg()
    assert said in caplog.text
    assert bool(caplog.text) == bool(said)


@pytest.mark.parametrize(
    ("crs", "says"),
    [
        (("EPSG:32614", "EPSG:32613"), ["0.laz: WGS 84 / UTM zone 14N (EPSG:32614)", "EPSG:32613", "crs`"]),
        (("EPSG:32614", None), ["0.laz: WGS 84 / UTM zone 14N (EPSG:32614)", "no CRS", "crs`"]),
        (
            ("EPSG:32614+5703", "EPSG:32614+5773"),
            [
                "heights",
                "UTM zone 14N + NAVD88 height (EPSG:32614+5703)",
                "1.laz: WGS 84 / UTM zone 14N + EGM96",
                "`force_crs`",
            ],
        ),
    ],
)
def test_files_of_several_crs_are_listed(crs, says):
    with pytest.raises(BadInputError) as caught:
        common_georeference(infos(*crs))
    assert [part for part in says if part not in str(caught.value)] == []


@pytest.mark.parametrize(
    ("crs", "text"),
    [
        ("EPSG:32614+5703", "NAVD88 height (EPSG:5703); heights in metres"),
        ("EPSG:32614", "none given; heights as in the survey, in metres"),
        ("EPSG:2271+6360", "NAVD88 height (ftUS) (EPSG:6360); heights in metres"),
    ],
)
def test_layers_with_heights_carry_it_others_do_not_and_all_name_it(tmp_path, crs, text):
    out, crs = tmp_path / "out", CRS(crs)
    survey = write_survey(tmp_path / "site.las", epsg=crs)
    run("map", survey, "--out", out, code=0)
    in_metres = crs if "ftUS" not in text else crs.sub_crs_list[0]
    for path in out.rglob("*.tif"):
        with rasterio.open(path) as raster:
            assert raster.tags()["vertical_crs"] == text
            assert CRS.from_wkt(raster.crs.to_wkt()) == (
                in_metres if path.stem in {"heightmap", "relief"} else crs.to_2d()
            )
    tiles = geopandas.read_parquet(out / "tiles.parquet")
    assert tiles.crs == in_metres
    assert pq.read_schema(out / "tiles.parquet").metadata[b"vertical_crs"].decode() == text
    assert json.loads((out / "cost.geojson").read_text(encoding="utf-8"))["vertical_crs"] == text
    lines = pyogrio.read_info(out / "cost.fgb")
    assert (lines["crs"], lines["layer_metadata"]["vertical_crs"]) == (crs.to_2d().to_string(), text)
    stated = json.loads((out / "run.json").read_text(encoding="utf-8"))["crs"]
    assert CRS.from_wkt(stated["wkt"]) == CRS.from_user_input(stated["code"]) == in_metres
