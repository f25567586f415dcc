"""EPT (Entwine Point Tile): an octree whose nodes are LAZ files, listed with their numbers of points in files of JSON.

The files count as one, in which they follow each other: ``ept.json``, those of the hierarchy, then the nodes in reading
order. It has a size, a version and a checksum, and the nodes are chunks of it as those of COPC are. A node is opened
when its points are read. The layout follows the specification of Entwine; nodes are named ``level-x-y-z``.

Entwine gives each node an offset of its own. The integers of its points are moved to the offset of the first node,
which must be a whole number of steps away, so that coordinates keep their bits.
"""

import hashlib
import io
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    BadInputError,
    CrsStatement,
    Each,
    FileHash,
    Nullable,
    Number,
    allocate_shared,
    parse_json,
    shape_fault,
    statement_from_wkt,
    with_vertical,
)
from bumpymap.readers.copc import DEEPEST, ChunkTable, depth_first_order, node_boxes, read_table, refuse_sizes
from bumpymap.readers.las import LasSurvey, Records
from bumpymap.readers.las_header import RawHeader, joined_statement, read_raw_header, statement_of_las
from bumpymap.readers.protocol import Chunk
from bumpymap.readers.source import (
    EPT_NAME,
    Location,
    Version,
    decoding,
    is_url,
    open_source,
    pinned_version,
    read_into,
    read_range,
    refuse_count,
    require_unchanged,
    version_of,
)

_KEY = re.compile("-".join(["(0|[1-9][0-9]{0,9})"] * 4))
_KEY_NAMES = ["level", "x", "y", "z"]
_NODE = np.dtype([("level", "<i4"), ("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("points", "<i8")])
_ROOT: tuple[int, ...] = (0, 0, 0, 0)
_ELSEWHERE = -1
"""Number of points of a node that a hierarchy file of its own lists, with all nodes below it."""
MOST_NODES = 1_000_000
_MOST_JSON = 32 << 20
"""Bytes of a file of JSON at most: a million nodes need fewer."""
_MOST_BESIDE = 1 << 17
"""Bytes of a node at most, beyond twice those of its points when decoded."""
_REQUESTS = 16
"""Requests at a time for the versions of nodes on a server."""
_BOX = (Number(),) * 6
_HEAD = {
    "bounds": _BOX,
    "boundsConforming?": _BOX,
    "dataType": str,
    "hierarchyType?": str,
    "points": Number(1, 1e15, whole=True),
    "srs?": Nullable({"wkt?": Nullable(str)}),
}
_HIERARCHY = Each(Number(_ELSEWHERE, (1 << 31) - 1, whole=True))
_REBUILD = "Build the EPT again, or copy it again"
_ONE_FILE = "Write it as one file: pdal translate --reader readers.ept EPT OUT.copc.laz"


@dataclass(frozen=True, slots=True)
class EptFiles:
    """The files of an EPT, as one."""

    head: Mapping[str, Any]
    """Content of ``ept.json``."""
    nodes: NDArray[np.void]
    """Nodes with points, in reading order."""
    places: Sequence[Location]
    """``ept.json``, the hierarchy, and as the last the files of ``nodes``."""
    versions: Sequence[Version]
    ends: NDArray[np.int64]
    """Offset behind each file."""

    @classmethod
    def find(cls, location: Location) -> "EptFiles":
        """Read ``ept.json`` and the hierarchy, and look up the nodes.

        Raises
        ------
        BadInputError
            A file is missing, leads out of the folder or cannot be read; the hierarchy is none of an octree, or has no
            points; or the points are not LAZ.
        """
        head, version = _read_json(location, _HEAD)
        for name, read in (("dataType", "laszip"), ("hierarchyType", "json")):
            if (found := head.get(name, read)) != read:
                raise BadInputError(f"the {name} of {location} is {found[:40]!r}; {read!r} is read. {_ONE_FILE}")
        nodes, places, versions = _read_hierarchy(location)
        of_nodes = [_beside(location, "ept-data", key, "laz") for key in nodes[_KEY_NAMES].tolist()]
        versions = [version, *versions, *_each(_look_up, of_nodes)]
        ends = np.cumsum([version["size"] for version in versions])
        return cls(head, nodes, [location, *places, *of_nodes], versions, ends)

    @property
    def version(self) -> Version:
        """Version of all files as one; ``version`` is empty if a server reports none for a file."""
        known = all(version.get("version", "time") for version in self.versions)
        digest = hashlib.sha256(json.dumps(self.versions).encode()).hexdigest()
        return {"size": int(self.ends[-1]), "version": f"files {digest}" if known else ""}

    def read(self, start: int, size: int) -> NDArray[np.uint8]:
        """Read ``size`` bytes from offset ``start`` of all files as one; fewer at the end.

        Raises
        ------
        BadInputError
            A file has changed, or cannot be read.
        """
        size = min(size, int(self.ends[-1]) - start)
        data, held = np.empty(size, np.uint8), 0
        file = int(np.searchsorted(self.ends, start, side="right"))
        while held < size:
            place, version, left = self.places[file], self.versions[file], int(self.ends[file]) - start - held
            wanted = min(size - held, left)
            with pinned_version(place, version):
                got = read_into(place, version["size"] - left, data[held : held + wanted])
                refuse_count(place, wanted, got, "bytes")
            if not is_url(place):
                require_unchanged(place, version)
            held, file = held + wanted, file + 1
        return data


class _Node(NamedTuple):
    """A node that was read."""

    place: Location
    steps: tuple[int, int, int]
    """To add to the integers of its points for the offset of the first node."""
    table: ChunkTable
    data: NDArray[np.uint8]
    """Its LAZ chunks."""


class EptSurvey(LasSurvey):
    """An EPT, by the path or the URL of its file ``ept.json``."""

    def _read_header(self, stream: BinaryIO) -> tuple[RawHeader, CrsStatement, str]:
        """Return the header of the first node, with the extent and the number of points of all."""
        self._files = files = EptFiles.find(self._path)
        self._version, count = files.version, len(files.nodes)
        place, box = files.places[-count], files.head.get("boundsConforming", files.head["bounds"])
        with decoding(place, "the header"), open_source(place) as node:
            raw = read_raw_header(node, place)
        low, high = ((float(x), float(y), float(z)) for x, y, z in (box[:3], box[3:]))
        size, points = self._version["size"], int(files.nodes["points"].sum())
        raw = replace(raw, compressed=True, size=size, point_count=points, mins=low, maxs=high)
        stated = _statement(files.head.get("srs") or {}, statement_of_las(raw))
        if points != files.head["points"]:  # Entwine counts those that it left out too
            note = f"its ept.json counts {files.head['points']:,} points, and its hierarchy {points:,}, which are read"
            stated = replace(stated, notes=(*stated.notes, note))
        return raw, stated, f"EPT of {count:,} nodes"

    def _read_table(self, stream: BinaryIO, raw: RawHeader, metres_per_unit: float | None) -> ChunkTable:
        """Return the nodes, with their place among the bytes of all files."""
        files, count = self._files, len(self._files.nodes)
        counts, starts = files.nodes["points"], files.ends[-count - 1 : -1]
        sizes = files.ends[-count:] - starts
        if (large := np.flatnonzero(sizes > 2 * counts * raw.point_size + _MOST_BESIDE)).size:
            worst = large[0]
            raise BadInputError(
                f"{files.places[worst - count]} takes {sizes[worst]:,} bytes, too many for its {counts[worst]:,} "
                f"points: damaged. {_REBUILD}"
            )
        root = np.array(files.head["bounds"], np.float64)[[0, 1, 3, 4]]
        self._nodes = ChunkTable(counts, starts, sizes, node_boxes(files.nodes, root, metres_per_unit))
        refuse_sizes(self._path, raw, self._nodes)
        return self._nodes

    def _require_unchanged(self) -> None:
        _each(require_unchanged, self._files.places, self._files.versions)

    def _finish_hash(self, own: FileHash) -> None:
        own.finish(self._files.read)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Each file is checked on its own when it is read, see `EptFiles.read`."""
        yield

    def _fetch(self, chunk: Chunk) -> Records:
        """Read the nodes of a chunk, decode all LAZ chunks in them at once, and bring them to one offset."""
        part, first = self._part(chunk, self._nodes), int(np.searchsorted(self._ends, chunk.first, side="right"))
        data = self._files.read(int(part.starts[0]), int(part.sizes.sum()))
        if self._hash is not None:
            self._hash.add(int(part.starts[0]), data)
        parts = np.split(data, np.cumsum(part.sizes)[:-1])
        nodes = [self._open_node(number, own) for number, own in enumerate(parts, first)]
        try:
            records = self._decode_nodes(self._path, nodes)
        except BadInputError:
            for node in nodes:
                self._decode_nodes(node.place, [node])  # raises an error that names the damaged one
            raise
        for node, own in zip(nodes, np.split(records, np.cumsum(part.counts)[:-1]), strict=True):
            if any(node.steps):
                words = own[:, :12].view("<i4")
                moved = words + np.array(node.steps)
                if abs(moved).max() >= 1 << 31:
                    raise BadInputError(f"{node.place} lies too far from the first node for its scale. {_ONE_FILE}")
                words[...] = moved
        return records

    def _open_node(self, number: int, data: NDArray[np.uint8]) -> _Node:
        """Read the header and the chunk table of a node, whose points must be stored as those of the first one."""
        places, count, points = self._files.places, len(self._files.nodes), int(self._nodes.counts[number])
        place, stream = places[number - count], io.BytesIO(data.tobytes())
        with decoding(place, "the header"):
            header = read_raw_header(stream, place)
            if header.point_count != points:
                raise BadInputError(
                    f"{place} holds {header.point_count:,} points, and the hierarchy of its EPT says {points:,}: "
                    f"damaged. {_REBUILD}"
                )
            steps = _steps(self._raw, header)
            if steps is None or _storage(header) != _storage(self._raw):
                raise BadInputError(
                    f"the points of {place} are not stored as those of {places[-count]}: point format, scale and "
                    f"LASzip record must be the same, and offsets whole steps of the scale apart. {_ONE_FILE}"
                )
            table = read_table(stream, place, header, self._laszip)
        return _Node(place, steps, table, data[table.starts[0] : table.starts[-1] + table.sizes[-1]])

    def _decode_nodes(self, place: Location, nodes: Sequence[_Node]) -> Records:
        compressed = allocate_shared(sum(node.data.size for node in nodes))
        np.concatenate([node.data for node in nodes], out=compressed.data)
        columns = zip(*((node.table.counts, node.table.starts, node.table.sizes) for node in nodes), strict=True)
        return self._decode(place, ChunkTable(*map(np.concatenate, columns)), compressed)


def _storage(header: RawHeader) -> tuple[Any, ...]:
    record = header.records.get((b"laszip encoded", 22204))
    return header.compressed, header.point_format, header.point_size, header.scales, header.source_id, record


def _steps(first: RawHeader, other: RawHeader) -> tuple[int, int, int] | None:
    """Return how many steps of the scale the offsets of another node lie from those of the first one.

    None if they are not whole, by the decimals of the numbers, or too many.
    """
    offsets = zip(other.offsets, first.offsets, first.scales, strict=True)
    x, y, z = ((Fraction(repr(own)) - Fraction(repr(to))) / Fraction(repr(scale)) for own, to, scale in offsets)
    whole = all(step.denominator == 1 and abs(step) <= 1 << 32 for step in (x, y, z))
    return (int(x), int(y), int(z)) if whole else None


def _statement(srs: Mapping[str, Any], of_nodes: CrsStatement) -> CrsStatement:
    """Return the CRS of ``ept.json``: its WKT, or codes of an authority, the vertical one if the WKT has none.

    If there is none, or none that is understood, it is that of the nodes.
    """
    authority = srs.get("authority") or "EPSG"
    codes = [f"{authority}:{srs[key]}" for key in ("horizontal", "vertical") if srs.get(key)]
    own = statement_from_wkt(srs.get("wkt") or codes[0]) if srs.get("wkt") or codes else CrsStatement()
    if own.crs is None:
        return own if own.trouble and of_nodes.crs is None else of_nodes
    vertical = statement_from_wkt(codes[1]).crs if len(codes) > 1 and not own.crs.is_compound else None
    if vertical is not None and vertical.is_vertical:
        own = replace(own, crs=with_vertical(own.crs, vertical))
    return joined_statement(own, of_nodes, (EPT_NAME, "nodes"))


def _read_hierarchy(location: Location) -> tuple[NDArray[np.void], list[Location], list[Version]]:
    """Return the nodes with points, depth first, and the files that list them."""
    places, versions = list[Location](), list[Version]()
    waiting, listed = [_ROOT], list[tuple[int, ...]]()
    while waiting:
        top = waiting.pop()
        places.append(_beside(location, "ept-hierarchy", top, "json"))
        entries, version = _read_json(places[-1], _HIERARCHY)
        versions.append(version)
        for key, points in entries.items():
            node = _node_below(top, key)
            if node is None or (points == _ELSEWHERE and node == top):
                raise BadInputError(
                    f"{places[-1]} gives {key[:60]!r} {points} points: its nodes must be {_name(top)} and nodes of "
                    f"that octree below it, and -1 stands for one in another file. {_REBUILD}"
                )
            if points == _ELSEWHERE:
                waiting.append(node)
            elif points:
                listed.append((*node, points))
        if len(places) + len(waiting) + len(listed) > MOST_NODES:
            raise BadInputError(f"{location} lists more than {MOST_NODES:,} nodes, the most that are read")
    nodes = np.array(listed, _NODE)
    nodes = nodes[depth_first_order(nodes)]
    keys = nodes[_KEY_NAMES]
    if (twice := np.flatnonzero(keys[1:] == keys[:-1])).size:
        raise BadInputError(f"the hierarchy of {location} lists {_name(keys[twice[0]])} twice. {_REBUILD}")
    if not nodes.size:
        raise BadInputError(f"{location} holds no points (its hierarchy lists none): nothing to map. {_REBUILD}")
    return nodes, places, versions


def _read_json(place: Location, shape: Any) -> tuple[Any, Version]:
    version = _look_up(place)
    if version["size"] > _MOST_JSON:
        raise BadInputError(f"{place} has {version['size']:,} bytes; at most {_MOST_JSON:,} are read. {_ONE_FILE}")
    with pinned_version(place, version), decoding(place, "the JSON"):
        content = parse_json(read_range(place, 0, version["size"]).tobytes().decode())
    if fault := shape_fault(content, shape):
        raise BadInputError(f"{place} is not a file of an EPT: {fault}. {_REBUILD}")
    return content, version


def _look_up(place: Location) -> Version:
    """Return the version of a file; a link must not lead out of the folder of ``ept.json``."""
    if isinstance(place, Path) and place.name != EPT_NAME and (place.is_symlink() or place.parent.is_symlink()):
        folder = os.path.realpath(place.parents[1])
        if not Path(os.path.realpath(place)).is_relative_to(folder):
            raise BadInputError(f"{place} is a link out of {folder}, which is not followed. Copy the file to its place")
    return version_of(place)


def _each(function: Callable[..., Any], places: Sequence[Location], *values: Sequence[Any]) -> list[Any]:
    """Call a function for each file; for files on a server, several at a time."""
    if not is_url(places[0]):
        return list(map(function, places, *values))
    with ThreadPoolExecutor(_REQUESTS) as pool:
        return list(pool.map(function, places, *values))


def _beside(location: Location, folder: str, node: Iterable[int], suffix: str) -> Location:
    """Return the place of a file of a node; a query of the URL, which may be a key, stays."""
    name = f"{folder}/{_name(node)}.{suffix}"
    if isinstance(location, Path):
        return location.parent / name
    plain, mark, query = location.partition("?")
    return f"{plain.removesuffix(EPT_NAME)}{name}{mark}{query}"


def _name(node: Iterable[int]) -> str:
    return "-".join(map(str, node))


def _node_below(top: tuple[int, ...], key: str) -> tuple[int, ...] | None:
    """Return the level, x, y and z of a key; None if it is not that of a node of an octree, at or below ``top``."""
    match = _KEY.fullmatch(key)
    level, *place = map(int, match.groups()) if match else (-1, 0, 0, 0)
    depth = level - top[0]
    if depth < 0 or level > DEEPEST or any(at >> depth != above for at, above in zip(place, top[1:], strict=True)):
        return None
    return (level, *place)
