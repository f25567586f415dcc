"""Write all files of a map to its folder, the manifest last."""

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from bumpymap.core import (
    CostTable,
    Georeference,
    Progress,
    SilentProgress,
    describe_crs,
    vertical_of,
    write_together,
)
from bumpymap.layers.colours import class_limits
from bumpymap.layers.geotiff import shows_photo, write_raster
from bumpymap.layers.manifest import (
    MANIFEST_NAME,
    MapSummary,
    complete_manifest,
    describe_file,
    software_versions,
    summarise,
    write_manifest,
)
from bumpymap.layers.placement import Placement
from bumpymap.layers.products import EVERY_FILE, SOME_NAMES, MapFile
from bumpymap.layers.regions import dissolve
from bumpymap.layers.stac import write_item
from bumpymap.layers.tile_table import write_tiles
from bumpymap.layers.vector import GeoJsonCoordinates, flatgeobuf_writer, geojson_writer


def layer_metadata(manifest: Mapping[str, Any], place: Georeference) -> dict[str, Any]:
    """Return the entries that layers carry as metadata, as texts and lists of numbers; what is not known is left out.

    ``manifest``: the run's own entries for run.json, see `complete_manifest`; ``place``: CRS of the survey.
    """
    survey, calibration, settings = (manifest[name] for name in ("survey", "calibration", "settings"))
    is_papers, dates = settings.get("compat") == "paper", survey["dates"]
    vertical = None if place.crs is None else vertical_of(place.crs)
    heights = "none given; heights as in the survey, in metres"
    entries = {
        "survey": survey["name"],
        "survey_checksum": survey["checksum"],
        "survey_header_dates": "/".join(dates) if dates else None,  # first and last
        "vehicle": calibration["vehicle"],
        "calibration": calibration["id"],
        # Without it the speed is that of the vehicle's profile.
        "speed_m_per_s": settings.get("speed"),
        "p_fail_speed_m_per_s": manifest["vehicle"].get("drives_mps") if settings.get("speed") else None,
        "texture_model": manifest["model"],
        "rating": "paper" if is_papers else settings.get("rating"),
        # The paper's classes follow from its table of textures and z ranges.
        "class_limits_rad_per_m": None if is_papers else class_limits(manifest),
        "bumpymap_version": software_versions().get("bumpymap"),
        "vertical_crs": heights if vertical is None else f"{describe_crs(vertical)}; heights in metres",
    }
    return {name: value for name, value in entries.items() if value is not None}


_log = logging.getLogger(__name__)


def write_products(
    table: CostTable,
    folder: Path,
    *,
    local: bool,
    manifest: Mapping[str, Any],
    views: Callable[[Path, Mapping[str, Any], Callable[..., None]], None],
    progress: Progress | None = None,
) -> tuple[list[Path], MapSummary]:
    """Write all files of a run, or none; run.json is written last, so a folder that has one is complete.

    Files of an earlier run stay until all new ones are complete. Except for run.json, no file depends on the time, on
    the order of the tiles or on the output folder: the same map of the same survey has the same bytes.

    ``folder``: an existing folder, see `check_folder`; ``local``: write cost.geojson in the survey's own coordinates if
    it has no CRS; ``manifest``: the run's own entries for run.json, see `complete_manifest`; ``views``: writes the
    files of ``EVERY_VIEW_NAME``, given the folder, the content of run.json, and what waits for the layers of some
    names, or for all, since they are still being written; ``progress``: counts the layers as they are written. Returns
    the files, in the order of ``EVERY_FILE``; counts and medians of the map. Raises OutputError: a file cannot be
    written; BadInputError: the extent is too large for a raster, or there is no CRS and ``local`` is False.
    """
    started = time.perf_counter()
    placement = Placement.of(table)
    # Fail early: there may be no transformation from the survey's CRS to longitude and latitude.
    coordinates = GeoJsonCoordinates.of(placement, local=local)
    metadata = layer_metadata(manifest, table.georeference)
    progress = progress or SilentProgress()
    with write_together(folder, MANIFEST_NAME, EVERY_FILE) as staged:
        for layer in MapFile:
            (staged / layer).parent.mkdir(exist_ok=True)
        with _written(_layers(table, coordinates, staged, metadata), staged, progress) as written:
            summary = summarise(table, class_limits(manifest))
            record = complete_manifest(manifest, table, summary)

            def wait(*names: str) -> None:
                for name in names or written:
                    if name in written:
                        written[name].result()

            views(staged, record, wait)
            files = {file["path"]: file for future in written.values() for file in future.result()}
        record["files"] = [files[name] for name in EVERY_FILE if name in files]
        write_item(staged, record, placement)
        record["seconds"] = {**manifest["seconds"], "write": round(time.perf_counter() - started, 3)}
        record["files"].append(describe_file(staged / MapFile.ITEM) | {"path": MapFile.ITEM})
        write_manifest(record, staged / MANIFEST_NAME)
    _log.info("wrote %d tiles to %s", summary.tiles, folder)
    return [path for path in (folder / name for name in EVERY_FILE) if path.exists()], summary


_Layers: TypeAlias = dict[tuple[str, ...], Callable[[], None]]
_SIDE_BY_SIDE = 3
"""Layers that are written at a time: rasters take turns where GDAL writes them, see `raster_lock`, and save time where
it does not."""


def _layers(table: CostTable, coordinates: GeoJsonCoordinates, folder: Path, metadata: Mapping[str, Any]) -> _Layers:
    """Return functions that write layers, keyed by file names, in the order in which they begin.

    What the page shows and what takes longest comes first.
    """
    # Formats that hold nothing but texts have the numbers of a list with spaces between them.
    tags = {name: " ".join(map(str, own)) if isinstance(own, list) else str(own) for name, own in metadata.items()}

    def rasters(*names: MapFile) -> _Layers:
        return {(name,): partial(write_raster, name, table, folder / name, tags) for name in names}

    def write_regions() -> None:
        flat = folder / MapFile.REGIONS_IN_CRS
        with (
            geojson_writer(folder / MapFile.REGIONS, coordinates, metadata) as write_geojson,
            flatgeobuf_writer(flat, coordinates.placement, tags) as write_flatgeobuf,
        ):
            for regions in dissolve(table):
                write_geojson(regions)
                write_flatgeobuf(regions)

    some = zip(SOME_NAMES, (table.tiles.has("headings"), shows_photo(table)), strict=True)
    return {
        **rasters(MapFile.HEIGHTMAP, MapFile.CLASS),
        (MapFile.TILES,): partial(write_tiles, table, folder / MapFile.TILES, tags),
        **rasters(*(name for name, there in some if there), MapFile.OBSTACLE, MapFile.ROUGHNESS),
        (MapFile.REGIONS, MapFile.REGIONS_IN_CRS): write_regions,
        **rasters(MapFile.PASSAGE, MapFile.REASON, MapFile.RELIEF, MapFile.COST, MapFile.SPEED, MapFile.BARRED),
    }


@contextmanager
def _written(layers: _Layers, folder: Path, progress: Progress) -> Iterator[dict[str, "Future[list[dict[str, Any]]]"]]:
    """Write layers side by side; after an error, and at the end of the body, no more begin.

    Yields by file name what will hold path, size and checksum of the files of its layer.
    """

    def write(names: Sequence[str], layer: Callable[[], None]) -> list[dict[str, Any]]:
        layer()
        files = [describe_file(folder / name) | {"path": name} for name in names]
        progress.advance(1)
        return files

    progress.start("writing layers", len(layers))
    with ThreadPoolExecutor(_SIDE_BY_SIDE) as pool:
        try:
            futures = {names: pool.submit(write, names, layer) for names, layer in layers.items()}
            yield {name: future for names, future in futures.items() for name in names}
        finally:
            pool.shutdown(cancel_futures=True)
