"""A look at a map in three dimensions, by Open3D: the relief in the colours of the map, obstacles as points, ways."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates

from bumpymap.core import CROSSING_UNKNOWN, NO_TILE, OBSTACLE, OPEN_THROUGH, Floats, UsageError, atomic, install_command
from bumpymap.layers import (
    CLOSED_COLOUR,
    MID_GREY,
    OBJECT_COLOURS,
    ROUTE_COLOUR,
    STEP_LINE,
    UNKNOWN_COLOUR,
    MapReader,
    RideScale,
    box_sum,
    first_island,
    on_islands,
    open_map,
)
from bumpymap.views.light import LEVEL, grey_of, hard_light, levelled, light_of
from bumpymap.views.page.site import read_ways

Numbers = NDArray[np.floating[Any]]

_MOST_SIDE = 900
"""Vertices along the longer side of the relief, at most: 1.6 million triangles."""
_MOST_PIXELS = 36_000_000
"""Pixels of a map up to which its obstacles are drawn one by one; beyond, the colours of the relief show them."""
_SIZE = (1800, 1200)
"""Width and height of a window, px, and of a picture before its empty edges are cut off."""
_MARGIN, _WHITE = 24, 250
"""Empty edge that is left, px, and the least brightness of empty pixels."""
NO_DATA = (255, 255, 255)
"""Colour of ground without points."""
STRIP_TILES = 4_000_000
"""Most tiles to read at a time."""
_SHADE = 0.35
"""Share of the relief in the light of a photo: chosen."""
_GAPS = (1, 3, 7)
"""Half widths of the boxes from which holes in the relief are filled, pixels."""
_ABOVE_M = 0.4
"""Height of ways above the ground, m."""
_VIEW_DEG, _TILT = 50.0, 0.9
"""Angle of view; height of the eye over its distance from the middle, which it looks at from the south."""


class Space(NamedTuple):
    """Geometry of a map; coordinates in m from its middle, z up."""

    vertices: Floats
    """(n, 3) of the relief."""
    colours: Floats
    """(n, 3) from 0 to 1."""
    triangles: NDArray[np.int32]
    """(m, 3) numbers of vertices."""
    obstacles: Floats
    """(k, 3) points at the top of obstacles."""
    ways: tuple[Floats, ...]
    """(l, 3) each."""


def show_in_space(layers: Path, out: Path | None = None, route: Path | None = None) -> None:
    """Draw a map in three dimensions, in a window, or in a PNG file without a screen.

    ``layers``: folder of `bumpymap map`; ``out``: the picture; without, a window opens; ``route``: folder of `bumpymap
    route`, or its route.geojson: its ways are drawn too. Raises UsageError: Open3D is not installed, or cannot draw
    here; BadInputError: the layers or the route cannot be read; OutputError: the picture cannot be written.
    """
    if out is not None and out.suffix.lower() not in {".png", ".jpg"}:
        raise UsageError(f"{out} is no picture: give a name that ends in .png")
    _require_means(with_screen=out is None)
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise UsageError(
            f"maps are drawn in three dimensions with Open3D, which cannot be imported ({error}): "
            f"{install_command('view')}. On Debian and Ubuntu it needs libusb-1.0-0, libegl1, libgl1 and libx11-6"
        ) from error
    reader = open_map(layers)
    with reader.kept_open():
        space = space_of(reader, route)
    drawn = _geometries(open3d, space)
    if out is None:
        open3d.visualization.draw_geometries(drawn, str(layers), *_SIZE)
        return
    utility = open3d.utility
    with _silent_driver(), utility.VerbosityContextManager(utility.VerbosityLevel.Error):
        picture = _render(open3d, drawn, space)
    pixels = np.asarray(picture)
    seen = np.argwhere((pixels < _WHITE).any(axis=-1))
    top, left = np.maximum(seen.min(axis=0) - _MARGIN, 0)
    bottom, right = seen.max(axis=0) + _MARGIN
    with atomic(out) as temporary:
        image: Any = open3d.geometry.Image
        open3d.io.write_image(temporary, image(np.ascontiguousarray(pixels[top:bottom, left:right])))


@contextmanager
def _silent_driver() -> Iterator[None]:
    """Keep what the renderer says of its driver, on the process's standard output, out of that of the command."""
    sys.stdout.flush()
    kept = os.dup(1)
    with Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def _render(open3d: Any, drawn: list[Any], space: Space) -> Any:
    """Return the picture of geometries, seen from the south."""
    rendering = open3d.visualization.rendering
    renderer = rendering.OffscreenRenderer(*_SIZE)
    renderer.scene.set_background([1.0, 1.0, 1.0, 1.0])
    renderer.scene.view.set_post_processing(False)  # it would change the colours of the map
    for number, geometry in enumerate(drawn):
        material = rendering.MaterialRecord()
        material.shader = "unlitLine" if isinstance(geometry, open3d.geometry.LineSet) else "defaultUnlit"
        material.line_width, material.point_size = 4.0, 2.0
        renderer.scene.add_geometry(str(number), geometry, material)
    reach = 0.52 * float(np.ptp(space.vertices, axis=0)[:2].max()) / np.tan(np.radians(_VIEW_DEG / 2))
    eye = reach * np.array([0.0, -1.0, _TILT]) / np.hypot(1.0, _TILT)
    renderer.setup_camera(_VIEW_DEG, [0.0, 0.0, 0.0], eye, [0.0, 0.0, 1.0])
    return renderer.render_to_image()


def space_of(reader: MapReader, route: Path | None = None) -> Space:
    """Return what is drawn of a map, and of the ways of a route over it."""
    import shapely

    bounds, grid = reader.grid.window_bounds(reader.window), reader.grid
    wide, high = bounds.east - bounds.west, bounds.north - bounds.south
    metres = max(grid.pixel_size, max(wide, high) / _MOST_SIDE)
    cols, rows = (max(2, round(side / metres)) for side in (wide, high))
    heights = _filled(reader.relief(reader.window, (rows, cols)).astype(np.float64))
    known = np.isfinite(heights)
    middle = np.array([(bounds.west + bounds.east) / 2, (bounds.south + bounds.north) / 2, np.mean(heights[known])])
    filled = heights[tuple(distance_transform_edt(~known, return_distances=False, return_indices=True))]

    def placed(x: Numbers, y: Numbers, above: Numbers | float) -> Floats:
        at = [(bounds.north - y) / high * rows - 0.5, (x - bounds.west) / wide * cols - 0.5]
        z = map_coordinates(filled, at, order=1, mode="nearest") + above
        return np.asarray(np.column_stack([x, y, z]) - middle, np.float64)

    corner = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    triangles = np.concatenate([np.stack([a, c, b], -1)[whole], np.stack([b, c, d], -1)[whole]]).astype(np.int32)
    east = bounds.west + (np.arange(cols) + 0.5) * wide / cols
    north = bounds.north - (np.arange(rows) + 0.5) * high / rows
    x, y = (axis.ravel() for axis in np.meshgrid(east, north))
    vertices = np.column_stack([x, y, filled.ravel()]) - middle
    lines = [] if route is None else [line for way in read_ways(route, reader.manifest) for line in way.lines]
    # With corners at most so far apart a way follows the relief.
    ways = (shapely.get_coordinates(shapely.segmentize(shapely.linestrings(line), 2 * metres)) for line in lines)
    return Space(
        vertices,
        painted(reader, heights).reshape(-1, 3) / 255.0,
        triangles,
        _obstacles(reader, placed),
        tuple(placed(way[:, 0], way[:, 1], _ABOVE_M) for way in ways),
    )


def painted(reader: MapReader, heights: Floats) -> Floats:
    """Return the colours of a map, (rows, cols, 3) from 0 to 255: what can be driven by its ride cost, the rest muted.

    ``heights`` (rows, cols): m, of pixels that span the map, for their shade.
    """
    shape, window, size = heights.shape, reader.window, reader.grid.tile_size
    barred, c_r, island = _sampled(reader, shape)
    passable = np.isin(barred, OPEN_THROUGH) & np.isfinite(c_r) & reader.passage(window, shape)
    unknown = ~passable & np.isin(barred, CROSSING_UNKNOWN)
    obstacle = np.isin(reader.objects(window, shape), (OBSTACLE, STEP_LINE)) & ~unknown
    colour = RideScale.of(reader.manifest).colours(np.where(passable, c_r, 0.0))
    colour[island] = on_islands(colour[island])
    colour[~passable] = CLOSED_COLOUR[:3]
    colour[unknown] = UNKNOWN_COLOUR[:3]
    colour[obstacle] = OBJECT_COLOURS[OBSTACLE][:3]
    shade = light_of(heights, (window.rows * size / shape[0], window.cols * size / shape[1]))[..., None] / LEVEL
    light = MID_GREY * shade
    if (photo := reader.photo(window, shape)) is not None:
        seen = levelled(photo)
        seen = np.where((passable & ~obstacle & ~island)[..., None], seen, grey_of(seen))
        light = np.where(np.isfinite(seen), seen * (1 - _SHADE + _SHADE * shade), light)
    colour = hard_light(colour, np.clip(light, 0, 255))
    colour[barred == NO_TILE] = NO_DATA
    return np.rint(np.clip(colour, 0, 255))


def _sampled(
    reader: MapReader, shape: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]:
    """Return what bars the tile in the middle of each pixel, of ``shape``, its ride cost, and if it is an island."""
    window, first = reader.window, first_island(reader.manifest)
    line, col = (
        ((np.arange(count) + 0.5) * tiles / count).astype(np.int64)
        for count, tiles in zip(shape, (window.rows, window.cols), strict=True)
    )
    barred, c_r, island = np.empty(shape, np.uint8), np.empty(shape, np.float32), np.zeros(shape, np.bool_)
    for top, part in window.cut(max(1, STRIP_TILES // window.cols)):
        rows = (line >= top) & (line < top + part.rows)
        field, place = reader.read(part, ("c_r",)), np.ix_(line[rows] - top, col)
        barred[rows], c_r[rows] = field.barred[place], field.c_r[place]
        if first is not None:
            island[rows] = reader.values(part, ("zone",))["zone"][place] >= first
    return barred, c_r, island


def _filled(heights: Floats) -> Floats:
    """Fill holes with the mean of the heights around them; NaN stays where nothing is near."""
    for half in _GAPS:
        known = np.isfinite(heights)
        if known.all() or not known.any():
            break
        base = float(heights[known].mean())  # sums of small numbers lose no digits
        count = box_sum(known.astype(np.float64), half)
        total = box_sum(np.where(known, heights - base, 0.0), half)
        near = ~known & (count > 0.5)
        heights = heights.copy()
        heights[near] = total[near] / count[near] + base
    return heights


def _obstacles(reader: MapReader, placed: Callable[[Numbers, Numbers, Numbers], Floats]) -> Floats:
    """Return points at the tops of the obstacle pixels of a map that is not too large.

    Where all points count as ground, obstacles are part of the relief, and nothing says how high they are.
    """
    window, grid = reader.window, reader.grid
    if window.rows * window.cols * grid.pixels**2 > _MOST_PIXELS:
        return np.empty((0, 3))
    row, col = np.nonzero(reader.objects(window) == OBSTACLE)
    height = reader.values(window, ("obstacle_height",))["obstacle_height"][row // grid.pixels, col // grid.pixels]
    row, col, height = (values[height > 0.0] for values in (row, col, height))
    bounds = grid.window_bounds(window)
    x, y = bounds.west + (col + 0.5) * grid.pixel_size, bounds.north - (row + 0.5) * grid.pixel_size
    return placed(x, y, height.astype(np.float64))


def _geometries(open3d: Any, space: Space) -> list[Any]:
    geometry, vectors = open3d.geometry, open3d.utility.Vector3dVector
    mesh = geometry.TriangleMesh(vectors(space.vertices), open3d.utility.Vector3iVector(space.triangles))
    mesh.vertex_colors = vectors(space.colours)
    mesh.compute_vertex_normals()
    cloud = geometry.PointCloud(vectors(space.obstacles))
    cloud.paint_uniform_color(np.array(OBJECT_COLOURS[OBSTACLE][:3]) / 255.0)
    lines = []
    for way in space.ways:
        ends = np.column_stack([np.arange(len(way) - 1), np.arange(1, len(way))])
        line = geometry.LineSet(vectors(way), open3d.utility.Vector2iVector(ends))
        line.paint_uniform_color(np.array(ROUTE_COLOUR[:3]) / 255.0)
        lines.append(line)
    return [mesh, *([cloud] if len(space.obstacles) else []), *lines]


def _require_means(*, with_screen: bool) -> None:
    """Raise UsageError if there is no screen for a window, or no driver to draw without one, which would end Python."""
    if with_screen and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UsageError("there is no screen to open a window on. Give a picture to write: --out view.png")
    folders = (Path(folder) / "vulkan" / "icd.d" for folder in ("/usr/share", "/usr/local/share", "/etc"))
    has_driver = os.environ.get("VK_DRIVER_FILES") or any(any(folder.glob("*.json")) for folder in folders)
    if not with_screen and not (find_library("vulkan") and has_driver):
        raise UsageError(
            "drawing without a screen needs a Vulkan driver. On Debian and Ubuntu: "
            "sudo apt-get install libvulkan1 mesa-vulkan-drivers"
        )
