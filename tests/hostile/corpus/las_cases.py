"""Damage to LAS: headers, records, coordinate systems, ends; what LAZ adds, chunks and their table; what COPC adds."""

import io
from functools import partial

import lazrs
import numpy as np
from las_files import geokeys, wkt
from pyproj import CRS

from .files import (
    EITHER,
    HEADER,
    HEADER_1_4,
    MAPPED,
    REFUSED,
    Case,
    bases,
    cloud,
    cut,
    field_cases,
    flipped,
    las_file,
    layout_of,
    patched,
    renamed,
)

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
        "empty": (b"", EITHER),
        "not_utf8": (b"\xff\xfe\x80PROJCS\xc3\x28", REFUSED),
        "brackets": (b"PROJCS[" * 8_000, REFUSED),
        "geographic": (CRS.from_epsg(4326).to_wkt("WKT1_GDAL").encode(), REFUSED),
        "earth_centred": (CRS.from_epsg(4978).to_wkt().encode(), REFUSED),
        "nan_unit": (utm.replace('UNIT["metre",1', 'UNIT["metre",nan').encode(), REFUSED),
        "unknown_authority": (utm.replace('"EPSG"', '"NOBODY"').encode(), EITHER),
    }
    keys = {
        "unknown_code": ({1024: 1, 3072: 1}, REFUSED),
        "geocentric": ({1024: 3}, REFUSED),
        "wild_model": ({1024: 60_000, 3072: 65_535}, EITHER),
        "unit_of_angle": ({1024: 1, 3072: 32614, 3076: 9102}, REFUSED),
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
    plain = las_file(xyz, **kinds)
    return [
        Case("las12-points-one.las", las_file(xyz[:1], **kinds), MAPPED),
        Case("las12-points-same.las", las_file(np.tile(xyz[:1], (100, 1)), **kinds), MAPPED),
        Case("las12-points-trailing_bytes.las", plain + b"more", MAPPED),
        Case("las12-points-all_withheld.las", las_file(xyz, withheld=True, **kinds)),
        Case("las14-points-all_withheld.las", las_file(xyz, minor=4, fmt=6, withheld=True)),
        Case("las12-points-all_noise.las", las_file(xyz, class_id=7, **kinds)),
        Case("las14-points-all_high_noise.las", las_file(xyz, minor=4, fmt=6, class_id=18)),
        Case("las12-points-one_2000_km_away.las", las_file(far, **kinds)),
        Case("las12-points-2000_km_wide.las", las_file(wide, **kinds), EITHER),
        # The first point lies 2,147 km east of the header's box.
        Case("las12-points-largest.las", patched(plain, layout_of(plain).points_at, "i", 2**31 - 1)),
    ]


_RECORD = {
    "compressor": (0, "H", {"0": 0, "4": 4, "65535": 65535}),
    "one_stream": (0, "H", {"1": 1}),
    "coder": (2, "H", {"1": 1, "65535": 65535}),
    "chunk_size": (12, "I", {"0": 0, "1": 1, "2to31": 2**31}),
    "item_count": (32, "H", {"0": 0, "1": 1, "65535": 65535}),
    "item_type": (34, "H", {"5": 5, "11": 11, "99": 99, "65535": 65535}),
    "item_size": (36, "H", {"0": 0, "1": 1, "one_more": 21, "65535": 65535}),
    "item_version": (38, "H", {"0": 0, "4": 4, "65535": 65535}),
}
"""Fields of the LASzip record."""
_LOOSE = dict.fromkeys(("one_stream", "coder", "chunk_size", "item_type"), EITHER)
"""Where a decoder goes by something else than the field, the points must be the right ones."""
# Chunks of 2^32 - 1 points are the sign for chunks of any size: in a file of such, no lie. In the other, chunks of
# other sizes than the record says are one, be it by a little.
_FIXED = {"chunk_size": (12, "I", {"2to32": 2**32 - 1, "79": 79, "81": 81, "400": 400})}
_WRONG = dict.fromkeys(("chunk_size-79", "chunk_size-81", "chunk_size-400"), REFUSED)
_LAYERS = {"0": 0, "2to32": 2**32 - 1}


def laz_cases():
    """Every case of the compression."""
    made = []
    for name in ("laz12.laz", "laz14v.laz"):
        made += _laszip(name) + _table(name) + _entries(name) + _chunks(name)
    return [*made, _endless()]


def _laszip(name):
    data, stem = bases()[name], name.removesuffix(".laz")
    at = data.index(b"laszip encoded") - 2
    made = field_cases(f"{stem}-laszip.laz", data, _RECORD, at + 54, exits=_LOOSE, base=name)
    if name == "laz12.laz":
        made += field_cases(f"{stem}-laszip.laz", data, _FIXED, at + 54, exits=_LOOSE | _WRONG, base=name)
    gone = data.replace(b"laszip encoded", b"laszip nothing")
    return [
        *made,
        Case(f"{stem}-laszip-missing.laz", gone),
        Case(f"{stem}-laszip-short.laz", patched(data, at + 20, "H", 10)),
    ]


def _endless():
    """Times that go on and on: each asks the decoder of point formats 1 and 3 for one more, deeper in the stack.

    A large chunk, since how deep it goes follows the bytes of the chunk.
    """
    data = bases(20_000)["laz12.laz"]
    start, end, _ = layout_of(data).chunks[0]
    at = start + 40
    return Case("laz12-chunk_1-endless_times.laz", data[:at] + b"\xbe\x04" + b"\xff" * (end - at - 2) + data[end:])


def _table(name):
    """Tables that are not where the file says."""
    data, stem = bases()[name], name.removesuffix(".laz")
    layout = layout_of(data)
    places = {
        "0": 0,
        "minus_1": -1,
        "minus_2to63": -(2**63),
        "points": layout.points_at,
        "first_chunk": layout.points_at + 8,
        "mid_points": (layout.points_at + layout.table_at) // 2,
        "one_early": layout.table_at - 1,
        "one_late": layout.table_at + 1,
        "last_byte": len(data) - 1,
        "end": len(data),
        "beyond": 2**40,
        "2to63": 2**63 - 1,
    }
    counts = {"0": 0, "4": 4, "6": 6, "10to7": 10**7, "2to31": 2**31, "2to32": 2**32 - 1}
    fields = {"table_at": (layout.points_at, "q", places), "table_count": (layout.table_at + 4, "I", counts)}
    made = field_cases(name, data, fields)
    for seed in range(6):
        place = layout.table_at + 8 + seed % (layout.table_end - layout.table_at - 8)
        made.append(Case(f"{stem}-table-flip_{seed}.laz", flipped(data, [place], seed), EITHER, name))
    return made


def with_table(data, entries):
    """Replace the chunk table: ``entries`` of (points, bytes), with the coding of a valid table."""
    layout = layout_of(data)
    record = next(data[body:end] for start, body, end in layout.vlrs if data[start + 2 :].startswith(b"laszip"))
    out = io.BytesIO()
    lazrs.write_chunk_table(out, entries, lazrs.LazVlr(record))
    return data[: layout.table_at] + out.getvalue() + data[layout.table_end :]


def _entries(name):
    """Tables that say untruths in good form."""
    data, stem = bases()[name], name.removesuffix(".laz")
    held = [(points, end - start) for start, end, points in layout_of(data).chunks]
    (many, size), (_, after) = held[0], held[1]
    spoilt = {
        "bytes_0": [(many, 0), *held[1:]],
        "bytes_one_less": [(many, size - 1), *held[1:]],
        "bytes_swapped": [(many, after), (held[1][0], size), *held[2:]],
        "bytes_2to31": [(many, 2**31 - 1), *held[1:]],
        "bytes_2to32": [(many, 2**32 - 1), *held[1:]],
        "one_gone": held[:-1],
        "ten_thousand": held + [(1, 1)] * 10_000,
    }
    exits = {"bytes_one_less": EITHER, "bytes_swapped": EITHER}
    if name == "laz14v.laz":
        spoilt |= {
            "points_0": [(0, size), *held[1:]],
            "points_one_less": [(many - 1, size), *held[1:]],
            "points_swapped": [(held[1][0], size), (many, after), *held[2:]],
            "points_2to31": [(2**31 - 1, size), *held[1:]],
            "points_2to32": [(2**32 - 1, size), *held[1:]],
            "points_all_2to32": [(2**32 - 1, bytes_) for _, bytes_ in held],
        }
    return [
        Case(f"{stem}-entries-{word}.laz", with_table(data, entries), exits.get(word, REFUSED), name)
        for word, entries in spoilt.items()
    ]


def _chunks(name):
    """Spoil chunk 3 of 5: its first point, which is stored plainly, and seeded bytes of its coded rest."""
    data, stem = bases()[name], name.removesuffix(".laz")
    start, end, _ = layout_of(data).chunks[2]
    made = [
        Case(f"{stem}-chunk_3-far_point.laz", patched(data, start, "i", 2**31 - 1)),
        # Point formats 0 to 5 code their points without any length: zeros are coded points too.
        Case(f"{stem}-chunk_3-zeros.laz", data[:start] + bytes(end - start) + data[end:], EITHER),
        Case(f"{stem}-chunk_3-ones.laz", data[:start] + b"\xff" * (end - start) + data[end:]),
    ]
    for seed in range(6):
        places = np.random.default_rng(seed).integers(start, end, 1 + seed).tolist()
        made.append(Case(f"{stem}-chunk_3-flip_{seed}.laz", flipped(data, places, seed), EITHER))
    if name == "laz14v.laz":
        # Point formats 6 and up: a count, then the bytes of each layer, behind the first point of 36 bytes. Layers that
        # nobody decodes may lie; those that are decoded must be told from the right ones.
        fields = {f"layer_{layer}": (40 + 4 * layer, "I", _LAYERS) for layer in range(10)}
        fields["chunk_points"] = (36, "I", {"0": 0, "more": "+1", "2to32": 2**32 - 1})
        made += field_cases(name, data, fields, start, default=EITHER, base=name)
    return made


def copc_cases():
    """Every case of COPC, whose points are read without its hierarchy, as those of any LAZ file."""
    data = bases()["copc.copc.laz"]
    layout = layout_of(data)
    info, *_ = layout.vlrs[0]
    make = partial(Case, exits=EITHER, base="copc.copc.laz")
    start, body, end = layout.evlrs[0]
    made = [
        make("copc-info-not_first.copc.laz", patched(data, info + 2, "4s", b"nocc")),
        Case("copc-info-length_0.copc.laz", patched(data, info + 20, "H", 0)),
        make("copc-info-length_159.copc.laz", patched(data, info + 20, "H", 159)),
        Case("copc-evlr_length-2to63.copc.laz", patched(data, start + 20, "Q", 2**63 - 1), REFUSED),
    ]
    places = {"no_evlr": start, "evlr_head": body, "mid_root_page": body + 48, "no_second_page": end - 32}
    return made + cut("copc.copc.laz", data, places)
