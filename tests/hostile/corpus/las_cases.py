"""Damage that LAS and LAZ share: headers, records, coordinate systems, and where a file may end."""

import numpy as np
from pyproj import CRS

from .bases import bases, geokeys, wkt
from .case import EITHER, MAPPED, REFUSED, Case, cut, field_cases, flipped, patched, renamed
from .las_file import HEADER, HEADER_1_4, cloud, las_file, layout_of

_NAN, _INF = float("nan"), float("inf")
_WILD = {
    "signature": {"lasf": b"lasf"},
    "version_major": {"0": 0, "2": 2, "255": 255},
    "version_minor": {"9": 9, "255": 255},
    "header_size": {"0": 0, "226": 226, "65535": 65535},
    "offset_to_points": {"0": 0, "inside_header": 100, "one_late": "+1", "2to32": 2**32 - 1},
    "vlr_count": {"2to31": 2**31, "2to32": 2**32 - 1},
    "point_format": {"11": 11, "63": 63, "127": 127},
    "record_length": {"0": 0, "1": 1, "one_short": "-1", "one_long": "+1", "65535": 65535},
    "scale_x": {"0": 0.0, "nan": _NAN, "inf": _INF, "minus_inf": -_INF, "1e300": 1e300, "1e8": 1e8, "tiny": 1e-300},
    "scale_y": {"0": 0.0, "nan": _NAN, "negative": -0.001},
    "scale_z": {"0": 0.0, "nan": _NAN, "1e300": 1e300},
    "offset_x": {"nan": _NAN, "inf": _INF, "1e300": 1e300, "4e9": 4e9},
    "offset_y": {"nan": _NAN, "minus_inf": -_INF},
    "offset_z": {"nan": _NAN, "1e300": 1e300},
    "max_x": {"nan": _NAN, "inf": _INF, "4e9": 4e9, "below_min": 0.0},
    "min_y": {"nan": _NAN, "minus_inf": -_INF, "minus_4e9": -4e9},
}
_COUNTS = {"0": 0, "one_more": "+1", "2to31": 2**31, "2to32": 2**32 - 1}
_LONG_COUNTS = _COUNTS | {"2to63": 2**63 - 1, "2to64": 2**64 - 1, "10to12": 10**12}
_LONG = {"2to32": 2**32 - 1, "2to63": 2**63 - 1, "2to64": 2**64 - 1}
_EVLRS = {
    "evlr_at": {"0": 0, "inside_points": 500, "beyond": 2**40, "2to63": 2**63 - 1, "2to64": 2**64 - 1},
    "evlr_count": {"one_more": "+1", "2to32": 2**32 - 1},
}


def las_cases():
    """Every case of LAS, and those of LAZ that do not concern its compression."""
    made = []
    for names, places, choices in (
        (("las12.las", "laz12.laz"), HEADER, _WILD | {"count": _COUNTS}),
        (("las14.las", "laz14.laz"), HEADER_1_4, {"count_1_4": _LONG_COUNTS} | _EVLRS),
    ):
        fields = {field: (*places[field], values) for field, values in choices.items()}
        # With the tiniest scale all points are in one corner of the header's box.
        tiny = {"scale_x-tiny": EITHER}
        made += [case for name in names for case in field_cases(name, bases()[name], fields, exits=tiny)]
    for name, places in (("las12.las", HEADER), ("laz14.laz", HEADER | HEADER_1_4)):
        made += [
            Case(renamed(name, f"flip-{field}"), flipped(bases()[name], [place], seed), EITHER)
            for seed, (field, (place, _)) in enumerate(places.items())
        ]
    made += [case for name in ("las12.las", "las14.las", "laz12.laz", "laz14.laz") for case in _cuts(name)]
    return made + _flips("las12.las") + _flips("las14.las") + _records() + _systems() + _points()


def _cuts(name):
    """Cases that end at, and inside, every part of the file."""
    data = bases()[name]
    layout = layout_of(data)
    start, body, end = layout.vlrs[0]
    places = {
        "signature": 4,
        "mid_header": 120,
        "header": layout.header_end,
        "mid_vlr_head": start + 20,
        "vlr_head": body,
        "mid_vlr": (body + end) // 2,
        "vlrs": layout.points_at,
        "mid_first_point": layout.points_at + 11,
        "mid_points": (layout.points_at + layout.points_end) // 2,
        "last_byte": len(data) - 1,
    }
    if layout.chunks:
        places |= {
            "table_place": layout.points_at + 4,
            "no_chunk": layout.points_at + 8,
            "mid_chunk_1": sum(layout.chunks[0][:2]) // 2,
            "chunk_1": layout.chunks[0][1],
            "chunk_3": layout.chunks[2][1],
            "no_table": layout.table_at,
            "mid_table": layout.table_at + 6,
            "table_head": layout.table_at + 8,
        }
    if layout.evlrs:
        start, body, end = layout.evlrs[0]
        places |= {"no_evlr": start, "mid_evlr_head": start + 30, "evlr_head": body, "mid_evlr": (body + end) // 2}
    return cut(name, data, places)


def _flips(name):
    """Spoil points at seeded places."""
    data = bases()[name]
    layout = layout_of(data)
    made = []
    for seed in range(4):
        places = np.random.default_rng(seed).integers(layout.points_at, layout.points_end, 1 + 4 * seed).tolist()
        made.append(Case(renamed(name, f"flip-points_{seed}"), flipped(data, places, seed), EITHER))
    return made


def _records():
    """Variable length records that are longer than the file, or shorter than what they hold."""
    made = []
    for name in ("las14.las", "laz12.laz", "laz14.laz"):
        layout = layout_of(bases()[name])
        fields = {"vlr_length": (layout.vlrs[0][0] + 20, "H", {"65535": 65535})}
        if layout.evlrs:
            fields["evlr_length"] = (layout.evlrs[0][0] + 20, "Q", _LONG)
        made += field_cases(name, bases()[name], fields)
    return made


def _systems():
    """Coordinate systems that are none."""
    utm = CRS.from_epsg(32614).to_wkt("WKT1_GDAL")
    texts = {
        "garbage": (b'PROJCS[;;["x",,]]\0', REFUSED),
        "cut": (utm[:200].encode(), REFUSED),
        "empty": (b"", EITHER),
        "zeros": (bytes(400), EITHER),
        "not_utf8": (b"\xff\xfe\x80PROJCS\xc3\x28", REFUSED),
        "megabyte": (b"A" * 60_000, REFUSED),
        "brackets": (b"PROJCS[" * 8_000, REFUSED),
        "geographic": (CRS.from_epsg(4326).to_wkt("WKT1_GDAL").encode(), REFUSED),
        "earth_centred": (CRS.from_epsg(4978).to_wkt().encode(), REFUSED),
        "vertical_only": (CRS.from_epsg(5703).to_wkt().encode(), REFUSED),
        "wild_unit": (utm.replace('UNIT["metre",1', 'UNIT["metre",0').encode(), REFUSED),
        "nan_unit": (utm.replace('UNIT["metre",1', 'UNIT["metre",nan').encode(), REFUSED),
        "unknown_authority": (utm.replace('"EPSG"', '"NOBODY"').encode(), EITHER),
    }
    keys = {
        "unknown_code": ({1024: 1, 3072: 1}, REFUSED),
        "unused_code": ({1024: 1, 3072: 32699}, REFUSED),
        "geographic": ({1024: 2, 2048: 4326}, REFUSED),
        "geocentric": ({1024: 3}, REFUSED),
        "wild_model": ({1024: 60_000, 3072: 65_535}, EITHER),
        "unit_of_angle": ({1024: 1, 3072: 32614, 3076: 9102}, REFUSED),
        "unit_unlike_crs": ({1024: 1, 3072: 32614, 3076: 9002}, REFUSED),
    }
    xyz = cloud(100)
    made = [
        Case(f"las14-wkt-{word}.las", las_file(xyz, minor=4, fmt=6, vlrs=[wkt(text)], wkt_bit=True), exits)
        for word, (text, exits) in texts.items()
    ]
    made += [
        Case(f"las12-geokeys-{word}.las", las_file(xyz, minor=2, fmt=1, vlrs=[geokeys(held)]), exits)
        for word, (held, exits) in keys.items()
    ]
    wild = geokeys({1024: 1, 3072: 32614}, count=65_535)
    made.append(Case("las12-geokeys-wild_count.las", las_file(xyz, minor=2, fmt=1, vlrs=[wild]), EITHER))
    far = las_file(xyz, minor=4, fmt=6, evlrs=[wkt(b"B" * 1_000_000)], wkt_bit=True)
    return [*made, Case("las14-evlr_wkt-megabyte.las", far)]


def _points():
    """Points that are fine one by one and make no survey, or hardly one."""
    xyz = cloud(100)
    far, wide = xyz.copy(), xyz.copy()
    far[0, :2] += 2_000_000
    wide[:, 0] += np.arange(100) * 20_000
    kinds = {"minor": 2, "fmt": 1}
    return [
        Case("las12-points-one.las", las_file(xyz[:1], **kinds), MAPPED),
        Case("las12-points-same.las", las_file(np.tile(xyz[:1], (100, 1)), **kinds), MAPPED),
        Case("las12-points-trailing_bytes.las", las_file(xyz, **kinds) + b"more", MAPPED),
        Case("las12-points-all_withheld.las", las_file(xyz, withheld=True, **kinds)),
        Case("las14-points-all_withheld.las", las_file(xyz, minor=4, fmt=6, withheld=True)),
        Case("las12-points-all_noise.las", las_file(xyz, class_id=7, **kinds)),
        Case("las14-points-all_high_noise.las", las_file(xyz, minor=4, fmt=6, class_id=18)),
        Case("las12-points-one_2000_km_away.las", las_file(far, **kinds)),
        Case("las12-points-2000_km_wide.las", las_file(wide, **kinds), EITHER),
        Case("las12-points-largest.las", _largest(las_file(xyz, **kinds))),
    ]


def _largest(data):
    """Move the first point to the largest integer, 2,147 km east of the header's box."""
    return patched(data, layout_of(data).points_at, "i", 2**31 - 1)
