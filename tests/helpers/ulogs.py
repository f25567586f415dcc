"""Made-up ULog files, written byte by byte as its format says."""

import struct

CODES = {"uint64_t": "Q", "float": "f", "double": "d", "int32_t": "i", "uint8_t": "B", "bool": "?"}
MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35\x01"


def _message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


def _field(text):
    """(type, count, name) of ``float[3] gyro_rad``."""
    kind, name = text.split()
    base, _, count = kind.partition("[")
    return base, int(count.rstrip("]") or 1) if count else 1, name


def ulog(topics, dropouts=()):
    """Bytes of a ULog.

    Parameters
    ----------
    topics : dict
        Name, perhaps with ``:instance`` -> (fields such as ``["uint64_t timestamp", "float[3] xyz"]``, rows of flat
        numbers).
    dropouts : sequence of int
        ms.
    """
    parts = [MAGIC, struct.pack("<Q", 0), _message("B", bytes(40))]
    formats = {}
    for name, (fields, _) in topics.items():
        formats.setdefault(name.partition(":")[0], fields)
    parts += [_message("F", f"{name}:{';'.join(fields)};".encode()) for name, fields in formats.items()]
    for number, name in enumerate(topics):
        bare, _, instance = name.partition(":")
        parts.append(_message("A", struct.pack("<BH", int(instance or 0), number) + bare.encode()))
    rows = []
    for number, (fields, values) in enumerate(topics.values()):
        layout = "<" + "".join(CODES[kind] * count for kind, count, _ in map(_field, fields))
        rows += [
            (row[0], _message("D", struct.pack("<H", number) + struct.pack(layout, *map(_plain, row))))
            for row in values
        ]
    parts += [data for _, data in sorted(rows, key=lambda each: each[0])]
    parts += [_message("O", struct.pack("<H", each)) for each in dropouts]
    return b"".join(parts)


def _plain(value):
    return value.item() if hasattr(value, "item") else value
