"""Damage to PCD: counts, sizes of fields, packed lengths."""

import numpy as np

from .bases import bases
from .case import EITHER, MAPPED, Case, cut, field_cases, patched
from .las_file import cloud
from .text_file import pcd_file, pcd_header

_NAMES = ("text.pcd", "binary.pcd", "packed.pcd")
_LINES = {
    "POINTS": {"one_more": 401, "10to12": 10**12, "2to63": 2**63, "negative": -1, "0": 0, "word": "many", "gone": None},
    "FIELDS": {"no_z": "x y w intensity", "one_less": "x y z", "x_twice": "x x y z", "empty": "", "gone": None},
    "SIZE": {"0": "0 8 8 4", "3": "3 8 8 4", "10to9": "1000000000 8 8 4", "negative": "-8 8 8 4", "gone": None},
    "TYPE": {"unknown": "Q F F F", "one_less": "F F F", "gone": None},
    "COUNT": {"0": "0 1 1 1"},
    "DATA": {"unknown": "zipped", "gone": None},
}
_COUNTS = {"text": 2**63, "binary": 10**6, "packed": 10**9}
"""Values a point in one field. One lie an encoding: the header is read by the same code."""
_LOOSE = {
    "WIDTH": {"0": 0, "10to12": 10**12, "one_less": 399, "negative": -1, "gone": None},
    "HEIGHT": {"0": 0, "2to63": 2**63, "2": 2, "gone": None},
    "VERSION": {"9": 9, "word": "new", "gone": None},
    "VIEWPOINT": {"nan": "nan 0 0 1 0 0 0", "one_less": "0 0 0 1 0 0", "words": "a b c d e f g", "gone": None},
}
"""Lines beside the points: a reader may do without them."""


def pcd_cases():
    """Every case of PCD."""
    made = [case for name in _NAMES for case in _lines(name) + _cuts(name)]
    return made + _packed() + _values() + _headers()


def _lines(name):
    data, stem = bases()[name], name.removesuffix(".pcd")
    encoding = {"text": "ascii", "binary": "binary", "packed": "binary_compressed"}[stem]
    body = data[len(pcd_header(400, encoding)) :]
    made = [
        Case(f"pcd_{stem}-{line}-{word}.pcd", pcd_header(400, encoding, **{line: value}) + body)
        for line, choices in _LINES.items()
        for word, value in choices.items()
    ]
    wild = pcd_header(400, encoding, COUNT=f"1 1 1 {_COUNTS[stem]}")
    made.append(Case(f"pcd_{stem}-COUNT-{_COUNTS[stem]}.pcd", wild + body))
    loose = _LOOSE if stem == "binary" else {}
    return made + [
        Case(f"pcd_{stem}-{line}-{word}.pcd", pcd_header(400, encoding, **{line: value}) + body, EITHER, name)
        for line, choices in loose.items()
        for word, value in choices.items()
    ]


def _cuts(name):
    data = bases()[name]
    body = data.index(b"\n", data.index(b"DATA")) + 1
    places = {"mid_header": body // 2, "header": body, "mid_row": body + 5, "mid_data": (body + len(data)) // 2}
    if name != "text.pcd":  # without its last byte, its line end, a text is whole
        places |= {"last_byte": len(data) - 1}
    return cut(f"pcd_{name}", data, places)


def _packed():
    """Packed points: how long they are packed, and unpacked, stands before them."""
    data = bases()["packed.pcd"]
    at = len(pcd_header(400, "binary_compressed"))
    fields = {
        "packed": (0, "I", {"0": 0, "one_less": "-1", "one_more": "+1", "2to32": 2**32 - 1}),
        "plain": (4, "I", {"0": 0, "one_less": "-1", "one_more": "+1", "2to31": 2**31, "2to32": 2**32 - 1}),
        "body": (8, "8s", {"0": bytes(8), "255": b"\xff" * 8}),
    }
    # Bytes too many may be ignored, and a spoilt byte may still unpack to numbers.
    loose = ("packed-one_less", "plain-one_more", "plain-2to31", "plain-2to32", "body-0", "body-255")
    made = field_cases("pcd_packed.pcd", data, fields, at, exits=dict.fromkeys(loose, EITHER))
    # All of it claims: 2^32 - 1 bytes of 153 million points.
    head = pcd_header((2**32 - 1) // 28, "binary_compressed")
    return [*made, Case("pcd_packed-bomb.pcd", head + patched(data[at:], 4, "I", 2**32 - 1))]


def _values():
    made = []
    for word, value in {"nan": np.nan, "inf": np.inf, "1e300": 1e300, "4e9": 4e9}.items():
        made.append(Case(f"pcd_values-all-{word}.pcd", pcd_file(np.full((60, 3), value), "binary")))
    some = cloud(100)
    some[:50] = np.nan
    return [*made, Case("pcd_values-half-nan.pcd", pcd_file(some, "binary_compressed"), MAPPED)]


def _headers():
    return [
        Case("pcd_header-endless_line.pcd", b"# .PCD v0.7\nVERSION 0.7\nFIELDS " + b"x " * 5_000_000),
        Case("pcd_header-endless_lines.pcd", b"# .PCD v0.7\n" + b"VERSION 0.7\n" * 500_000),
        Case("pcd_header-zero_bytes.pcd", b"# .PCD v0.7\n" + bytes(3000)),
        Case(
            "pcd_header-not_utf8.pcd",
            pcd_header(1, "ascii").replace(b"intensity", b"\xff\xfe") + b"1 2 3 4\n",
            EITHER,
        ),
    ]
