"""Write what has changed between two surveys: change.tif, change.geojson, their views and change.json, or nothing."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
import shapely.geometry
from numpy.typing import NDArray

from bumpymap.core import (
    Georeference,
    UsageError,
    atomic,
    locked,
    remove_empty_on_error,
    write_together,
)
from bumpymap.layers._cog import write_cog
from bumpymap.layers._notebook import import_notebook
from bumpymap.layers._raster_spec import BandSpec, RasterSpec
from bumpymap.layers._replacing import refuse_present, require_folder
from bumpymap.layers.gis.styles import write_change_style
from bumpymap.layers.lonlat import BoundingBox
from bumpymap.layers.manifest import (
    MANIFEST_NAME,
    describe_file,
    place_entries,
    plain_manifest,
    software_versions,
    write_manifest,
)
from bumpymap.layers.outlines import trace_labels
from bumpymap.layers.placement import Placement, RasterWindow, check_extent
from bumpymap.layers.products import REPORT_NAME, check_folder
from bumpymap.layers.vector import GeoJsonCoordinates
from bumpytiles import BLOCK_TILES, Grid, TileWindow

if TYPE_CHECKING:
    import geopandas

__all__ = [
    "CHANGE_MANIFEST_NAME",
    "CHANGE_NAMES",
    "CHANGE_VIEW_NAMES",
    "ChangeField",
    "change_regions",
    "check_change_out",
    "write_change",
]

CHANGE_MANIFEST_NAME = "change.json"
CHANGE_NAMES = ("change.tif", "change.geojson", CHANGE_MANIFEST_NAME)
CHANGE_VIEW_NAMES = ("change.qml", REPORT_NAME)
"""Files to look at the others with: a style, a page. GIS programs rewrite them, so they have no checksum."""
_FORMAT = "bumpymap-change"
_VERSION = 1
_BLOCK = 128
_WINDOW = 16 * BLOCK_TILES
"""Side of a window, tiles."""
_CHANGED = "0 not changed, 1 ground changed but not the ride, 2 ride rougher, 3 ride smoother, 4 unknown in one survey"
_BANDS = (
    BandSpec("d_c_r", "rad/m", "ride cost after minus before"),
    BandSpec("z_c_r", "", "difference of ln c_r over its combined spread"),
    BandSpec("d_height", "m", "mean height after minus before, the offset taken off"),
    BandSpec("z_height", "", "evidence for another height, over its spread"),
    BandSpec("z_shape", "", "evidence for another shape, over its spread"),
    BandSpec("changed", "", _CHANGED),
)


@dataclass(frozen=True, slots=True)
class ChangeField:
    """What has changed in the tiles of a window. Arrays are (rows, cols), north row first; NaN where not compared."""

    georeference: Georeference
    grid: Grid
    window: TileWindow
    d_c_r: NDArray[np.float32]
    """Ride cost after minus before, rad/m."""
    z_c_r: NDArray[np.float32]
    d_height: NDArray[np.float32]
    """Mean height after minus before, m."""
    z_height: NDArray[np.float32]
    z_shape: NDArray[np.float32]
    changed: NDArray[np.float32]
    """0 not changed; 1 ground changed, ride as before; 2 rougher; 3 smoother; 4 ground changed, one ride unknown."""
    area: NDArray[np.int32]
    """Number of the connected change that a tile belongs to, 1..m; 0: none."""
    regions: tuple[Mapping[str, Any], ...]
    """(m,) properties of each."""

    @property
    def placement(self) -> Placement:
        """The raster that the window spans. Raises BadInputError if it is too large for one."""
        check_extent(self.grid, self.window)
        return Placement(self.georeference, self.grid, self.window)


def check_change_out(out: Path, *, overwrite: bool) -> None:
    """Check, before anything is computed, that the files can be written to a folder. Writes nothing.

    Raises
    ------
    UsageError
        ``out`` holds the layers of a survey.
    OutputError
        There are files that must not be replaced, or ``out`` is a file.
    """
    require_folder(out)
    if lexists(out / MANIFEST_NAME):
        raise UsageError(f"{out} holds the layers of a survey. Give a folder of its own as `out`")
    refuse_present(out, (*CHANGE_NAMES, *CHANGE_VIEW_NAMES), overwrite=overwrite)


def write_change(field: ChangeField, out: Path, *, manifest: Mapping[str, Any], overwrite: bool = False) -> list[Path]:
    """Write the files of ``CHANGE_NAMES`` and ``CHANGE_VIEW_NAMES`` to a folder, which is created if it is missing.

    All files appear or none; links are replaced, never followed. Except for change.json no file depends on folder
    names.

    Parameters
    ----------
    field : ChangeField
    out : Path
        The folder.
    manifest : mapping
        The run's own entries for change.json: settings, sources, counts.
    overwrite : bool
        Allow files of an earlier run to be replaced.

    Raises
    ------
    UsageError, OutputError
        See `check_change_out`; or a file cannot be written.
    BadInputError
        The window is too large for a raster.
    """
    with remove_empty_on_error(out), locked(out):
        check_folder(out, overwrite=True)
        check_change_out(out, overwrite=overwrite)
        with write_together(out, CHANGE_MANIFEST_NAME) as staged:
            _write_raster(field, staged / CHANGE_NAMES[0])
            _write_regions(field, staged / CHANGE_NAMES[1])
            files = [describe_file(staged / name) | {"path": name} for name in CHANGE_NAMES[:2]]
            head = {"format": _FORMAT, "version": _VERSION, "versions": software_versions()}
            record = head | place_entries(field.placement) | dict(manifest) | {"files": files}
            write_change_style(staged / CHANGE_VIEW_NAMES[0], 1 + [band.name for band in _BANDS].index("changed"))
            _write_page(staged, record)
            write_manifest(record, staged / CHANGE_MANIFEST_NAME)
    return [out / name for name in (*CHANGE_NAMES, *CHANGE_VIEW_NAMES)]


def change_regions(field: ChangeField, names: Sequence[str]) -> "geopandas.GeoDataFrame":
    """Return the connected changes as a table: outlines in the survey's CRS, and the properties ``names`` of each.

    Raises
    ------
    UsageError
        The extra ``notebook`` is not installed.
    """
    geopandas = import_notebook("geopandas")
    place, numbers = field.placement, range(1, len(field.regions) + 1)
    traced = trace_labels(field.area, field.window, slice(0, field.window.rows), numbers) if numbers else ()
    outlines = [shapely.transform(outline, place.to_crs) for outline in traced]
    columns = {name: [about[name] for about in field.regions] for name in names}
    index = import_notebook("pandas").RangeIndex(1, len(numbers) + 1, name="id")
    return geopandas.GeoDataFrame(columns, geometry=outlines, crs=place.horizontal_crs, index=index)


def _write_page(folder: Path, record: Mapping[str, Any]) -> None:
    from bumpymap.layers.report.change_page import write_change_report  # Pillow takes some 10 ms to import

    write_change_report(folder, plain_manifest(record), folder / REPORT_NAME)


def _write_raster(field: ChangeField, path: Path) -> None:
    layers = np.stack([getattr(field, band.name) for band in _BANDS]).astype(np.float32, copy=False)
    spec = RasterSpec(
        bands=_BANDS,
        dtype="float32",
        nodata=float("nan"),
        pixels=1,
        crs=field.placement.horizontal_crs,
        overviews="NEAREST",
        block=_BLOCK,
        tags={"title": "change between two surveys", "changed": _CHANGED},
    )

    def paint(window: RasterWindow) -> NDArray[np.generic]:
        rows = slice(window.line, window.line + window.tiles.rows)
        return layers[:, rows, window.column : window.column + window.tiles.cols]

    write_cog(path, field.placement, spec, paint, _WINDOW)


def _write_regions(field: ChangeField, path: Path) -> None:
    """Write change.geojson: RFC 7946 in WGS 84, or the survey's own coordinates without a CRS; one change a feature."""
    place = GeoJsonCoordinates.of(field.placement, local=True)
    box = BoundingBox()
    features: list[dict[str, Any]] = []
    if field.regions:
        numbers = range(1, len(field.regions) + 1)
        polygons = place.polygons(trace_labels(field.area, field.window, slice(0, field.window.rows), numbers))
        box.add(polygons)
        features = [
            {"type": "Feature", "id": number, "properties": dict(about), "geometry": shapely.geometry.mapping(polygon)}
            for number, (about, polygon) in enumerate(zip(field.regions, polygons, strict=True), start=1)
        ]
    extent = {"bbox": place.bounds(box)} if features else {}
    collection = {"type": "FeatureCollection", "name": "change", **place.members, **extent, "features": features}
    text = json.dumps(collection, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    with atomic(path) as temporary:
        temporary.write_text(f"{text}\n", encoding="utf-8")
