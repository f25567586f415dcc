"""Calls above all rooms: map a survey, open its layers as a lazy dataset and as tables, plan on them, export them."""

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.util import Finalize
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from bumpymap.core import (
    BANDS,
    BARRED_TEXT,
    CLASS_NAMES,
    OBJECT_NAMES,
    REASON_TEXT,
    BadInputError,
    Band,
    BumpymapError,
    MapConfig,
    UsageError,
    path_of_call,
    settings_of_call,
    shares_text,
    short_repr,
    with_pixels,
)
from bumpymap.layers import (
    MapFile,
    import_notebook,
    open_layer,
    read_manifest,
    require_tiles,
    require_written,
)
from bumpymap.survey import MapSettings, PathLike, map_settings

if TYPE_CHECKING:
    import geopandas
    import xarray

    from bumpymap.core import Route
    from bumpymap.views import Export

    Point = str | tuple[float, float]

_TILE_RASTERS: dict[MapFile, tuple[Band, ...]] = {
    MapFile.ROUGHNESS: BANDS,
    MapFile.CLASS: (Band("class", "", "roughness class, 0 (smooth) to 3 (very rough)", CLASS_NAMES),),
    MapFile.REASON: (Band("reason", "", "why a tile has no class", tuple(REASON_TEXT.values())),),
    MapFile.COST: (Band("cost", "", "factor on distance for a planner; NaN where the tile is not passable"),),
    MapFile.SPEED: (Band("speed", "m/s", "highest speed within the comfort limits; 0 where the tile is not passable"),),
    MapFile.BARRED: (Band("barred", "", "why the tile is not passable", tuple(BARRED_TEXT.values())),),
}
_HEIGHT = Band("height", "m", "mean height of the points in the pixel")
_OBJECTS = Band("objects", "", "standing objects", OBJECT_NAMES)
_PASSAGE = Band("passage", "", "area of the tile in which the middle of the vehicle can move; 0 where it cannot be")


class Layers:
    """The layers of a run, as returned by `map_survey` and `open`.

    Only the manifest is read at once; the other files are read when a method needs them: it raises BadInputError if one
    is missing or damaged. Arrays and tables need the extra ``notebook``; without it, their methods raise UsageError.

    Parameters
    ----------
    folder : path
        The output folder of a complete run.
    in_memory : bool
        Delete the folder together with this object. Datasets are then loaded at once instead of lazily, and it cannot
        be pickled.
    """

    def __init__(self, folder: PathLike, *, in_memory: bool = False) -> None:
        self.folder = Path(path_of_call("the folder of the layers", folder))
        """The folder that holds the files."""
        self.manifest = read_manifest(self.folder)
        """The content of run.json: inputs, settings, versions, calibration, counts, files with their checksums."""
        self._in_memory = in_memory
        self._checked: set[str] = set()
        if in_memory:
            # Unlike weakref.finalize, this runs at the end of the workers of multiprocessing too; in no other process.
            Finalize(self, shutil.rmtree, (self.folder, True), exitpriority=0)

    def __fspath__(self) -> str:
        """Return the folder, so that the layers can be given wherever a path to them is asked for."""
        return os.fspath(self.folder)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the path of the folder."""
        if self._in_memory:
            raise UsageError(
                "these layers are in memory, and no other process can have them. Map the survey with `out='DIR'`: "
                "layers in a folder are pickled as its path"
            )
        return Layers, (self.folder.absolute(),)

    def dataset(self) -> "xarray.Dataset":
        """Open all rasters of every map with one pixel per tile as one dataset on the grid of tiles.

        Returns
        -------
        xarray.Dataset
            Dimensions ``y`` (north first) and ``x``, at tile centres. The bands of roughness.tif (``c_r``, ``slope``,
            ...), ``cost`` and ``speed`` are float32 variables, NaN where unknown; ``class``
            (255 where unknown), ``reason`` (0 where there is a class) and ``barred`` (0 where passable) are uint8, 255
            outside the tiles with points.
            Each has the attributes ``units`` and ``long_name``, the dataset ``survey``, ``vehicle``, ``calibration``;
            ``to_netcdf`` needs no other library. CRS and transform are in ``spatial_ref``. Values are
            read from the files when they are used; those of a run in memory are loaded already.
        """
        found = [variable for name, bands in _TILE_RASTERS.items() for variable in self._variables(name, *bands)]
        for other in found[1:]:
            if not all(other[side].equals(found[0][side]) for side in "xy"):
                raise BadInputError(f"the rasters in {self.folder} do not span the same tiles. Map the survey again")
        dataset = import_notebook("xarray").Dataset({variable.name: variable for variable in found})
        about, rating = self._about, self.manifest["settings"].get("rating")
        title = f"ride cost and roughness for {about['vehicle']}"
        return dataset.assign_attrs(title=title, **about, rating=rating or "")

    def heights(self) -> "xarray.DataArray":
        """Open heightmap.tif: the mean height of the points in each pixel, in metres; NaN in pixels without points.

        Returns
        -------
        xarray.DataArray
            Dimensions ``y`` (north first) and ``x``, at pixel centres. Values are read when they are used.
        """
        return next(self._variables(MapFile.HEIGHTMAP, _HEIGHT)).assign_attrs(self._about)

    def obstacles(self) -> "xarray.DataArray":
        """Open obstacle.tif: 0 free, 1 obstacle, 2 canopy, 3 unknown; 255 outside the tiles with points.

        Returns
        -------
        xarray.DataArray
            Dimensions ``y`` (north first) and ``x``, the pixels of `heights`. Values are read when they are used.
        """
        return next(self._variables(MapFile.OBSTACLE, _OBJECTS)).assign_attrs(self._about)

    def passage(self) -> "xarray.DataArray":
        """Open passage.tif: 0 closed, else the number of the area of its tile; 255 outside the tiles with points.

        The areas are the nodes of a graph, and where pixels of two of them touch across the border of their tiles is an
        arc. See `obstacles` for the dimensions.
        """
        return next(self._variables(MapFile.PASSAGE, _PASSAGE)).assign_attrs(self._about)

    def tiles(self) -> "geopandas.GeoDataFrame":
        """Read tiles.parquet.

        Returns
        -------
        geopandas.GeoDataFrame
            One row for each tile with points; the geometry is the square of the tile, in the survey's CRS.
        """
        with self._file(MapFile.TILES) as path:
            require_tiles(path, self.manifest["counts"]["tiles"])
            return import_notebook("geopandas").read_parquet(path)

    def route(self, start: "Point", goal: "Point", **settings: Any) -> "Route":
        """Find the cheapest way over these layers; see `bumpymap.find_routes` for parameters and errors.

        Returns
        -------
        Route
            With ``line`` [m], ``figures`` and ``profile``.
        """
        from bumpymap.route import find_routes

        return find_routes(self, start, goal, **settings)[0]

    def export(self, out: PathLike, *, overwrite: bool = False, **settings: Any) -> "Export":
        """Write the map in a format that robots read, as ``bumpymap export`` does; errors: `bumpymap.views.export_map`.

        Parameters
        ----------
        out : path
            A folder of its own.
        overwrite : bool
            Replace an earlier export in the same format.
        **settings
            Fields of `bumpymap.core.ExportSettings`: ``to`` (``nav2``, ``gridmap``, ``plan``), ...
        """
        from bumpymap.core import ExportSettings
        from bumpymap.layers import open_map
        from bumpymap.views import export_map

        own = ExportSettings(**settings_of_call(settings, ExportSettings, "Layers.export"))
        target = Path(path_of_call("out", out))
        return export_map(open_map(self.folder), target, own, overwrite=overwrite)

    def report(self, out: PathLike | None = None, *, route: PathLike | None = None, overwrite: bool = False) -> Path:
        """Write the page of this map, as ``bumpymap report`` does; for errors see `bumpymap.views.write_report`.

        Parameters
        ----------
        out : path, optional
            The file; default is report.html in the folder of the layers.
        route : path, optional
            A folder that ``bumpymap route`` wrote: its ways are drawn.
        overwrite : bool
            Replace ``out`` if it exists.

        Returns
        -------
        Path
            The file.
        """
        from bumpymap.views import write_report

        for name, place in {"out": out, "route": route}.items():
            if place is not None:
                path_of_call(name, place)
        return write_report(self.folder, out, route=route, overwrite=overwrite)

    def __repr__(self) -> str:
        counts, grid, crs = (self.manifest[name] for name in ("counts", "grid", "crs"))
        where = "in memory" if self._in_memory else f"in {self.folder}"
        place = "local coordinates, no CRS" if crs is None else f"{crs['name']} ({crs['code'] or 'no code'})"
        with suppress(BadInputError), open_layer(self.folder / MapFile.CLASS) as file:
            west, south, east, north = file.bounds
            place += f", x {west:,.2f} to {east:,.2f}, y {south:,.2f} to {north:,.2f}"
        classes = {**counts["by_class"], "unknown": counts["unknown"]}
        shares = zip(classes, shares_text(list(classes.values()), (len(classes) - 1,), 1), strict=True)
        return "\n".join(
            [
                f"<Layers {where}>",
                f"  place    {place}",
                f"  size     {counts['tiles']:,} tiles of {grid['tile_size_m']:g} m, {counts['points']:,} points",
                f"  vehicle  {self._about['vehicle']}",
                f"  classes  {', '.join(f'{name} {share}' for name, share in shares)}",
            ]
        )

    @property
    def _about(self) -> dict[str, str]:
        """Survey, vehicle and calibration, as attributes of arrays."""
        survey, calibration = self.manifest["survey"]["name"], self.manifest["calibration"]
        return {"survey": survey, "vehicle": calibration["vehicle"], "calibration": calibration["id"]}

    def _variables(self, name: MapFile, *bands: Band) -> "Iterator[xarray.DataArray]":
        """Yield the bands of a raster as named variables with units."""
        with self._file(name) as path:
            rioxarray = import_notebook("rioxarray")
            with open_layer(path) as checked, rioxarray.open_rasterio(path, cache=False, driver=checked.driver) as file:
                from bumpymap.layers import lazy_values  # needs the extra

                values = file.values if self._in_memory else lazy_values(path, checked.driver, file.shape, file.dtype)
                raster, nodata = file.copy(data=values), file.rio.nodata
            if raster.rio.crs is None and self.manifest["crs"]:  # one that GeoTIFF cannot hold
                raster.rio.write_crs(self.manifest["crs"]["wkt"], inplace=True)
        if raster.sizes["band"] != len(bands):
            raise BadInputError(
                f"{path} has {raster.sizes['band']} bands, and bumpymap now writes {len(bands)}. Map the survey again"
            )
        for number, band in enumerate(bands):
            variable = raster.isel(band=number, drop=True).rename(band.name)
            variable.attrs = {"long_name": band.description, "units": band.unit or "1"}
            if band.categories:
                variable.attrs |= {
                    "flag_values": list(range(len(band.categories))),
                    "flag_meanings": " ".join(text.replace(" ", "_") for text in band.categories),
                }
            if variable.dtype == "uint8":  # netCDF 3, which is all that SciPy writes, has no such type
                variable.encoding["dtype"], nodata = "int16", nodata.astype("int16")
            variable.attrs["_FillValue"] = nodata
            yield variable

    @contextmanager
    def _file(self, name: MapFile) -> Iterator[Path]:
        """Yield the path of a file; errors while the body of the ``with`` reads it become BadInputErrors.

        So is one that is not the file that run.json lists; that is looked at once.
        """
        path = self.folder / name
        if name not in self._checked and not self._in_memory:
            require_written(self.folder, self.manifest, (name,))
            self._checked.add(name)
        try:
            yield path
        except BumpymapError:
            raise
        except Exception as error:  # the errors of rasterio, pyarrow and pyogrio have no common base class
            raise BadInputError(f"cannot read {path}: {error}. Map the survey again") from error


def open_layers(folder: PathLike) -> Layers:
    """Open the layers that ``bumpymap map`` or `map_survey` wrote to a folder.

    Parameters
    ----------
    folder : path
        The output folder of the run, given to it as ``out``.

    Returns
    -------
    Layers

    Raises
    ------
    BadInputError
        The folder does not exist, or holds no complete run.

    Examples
    --------
    >>> import bumpymap
    >>> layers = bumpymap.open("site_layers")
    >>> layers.manifest["counts"]["tiles"]
    1426
    """
    return Layers(folder)


def map_survey(
    surveys: PathLike | Iterable[PathLike], out: PathLike | None = None, **settings: Unpack[MapSettings]
) -> Layers:
    """Map surveys: roughness, classes and ride cost of each tile.

    Parameters
    ----------
    surveys : path, or several
        Files and folders (LAS, LAZ, COPC, PLY, PCD, DSM as GeoTIFF); strings or path-like objects.
    out : path, optional
        Folder for the layers. Without one they are temporary, and deleted with the returned object.
    **settings
        Those of ``bumpymap map``, with underscores: ``tile_size`` [m], ``pixels``, ``ground``,
        ``ground_classes``, ``align``, ``rating``,
        ``compat``, ``vehicle``, ``calibration``, ``speed`` [m/s], ``model``, ``crs``, ``force_crs``,
        ``xy_unit``, ``z_unit``, ``dtm``, ``photo``, ``local``, ``trust_points``, ``skip_bad``, ``max_unknown``,
        ``overwrite``, ``threads``, ``memory``, ``scratch``, ``scheduler``, ``provider``, ``license``; ``features``,
        ``csf`` and ``page`` are dicts, the tables of a settings file.

    Returns
    -------
    Layers

    Raises
    ------
    BumpymapError
        Bad inputs or settings, or a full disk; no file is left half-written.
    TooUnknownError
        More tiles are unknown than ``max_unknown`` allows; the layers in ``out`` are complete.

    Examples
    --------
    >>> import bumpymap
    >>> layers = bumpymap.map_survey("sample_data/quarry.laz", ground="all")
    >>> layers.manifest["counts"]["by_class"]["smooth"] > 500
    True
    """
    own = with_pixels(map_settings(settings, "map_survey", MapSettings.__annotations__))
    places = _places(surveys)
    if out is not None:
        target = Path(path_of_call("out", out))
        _map(MapConfig(surveys=places, out=target, **own))
        return Layers(target)
    folder = tempfile.mkdtemp(prefix="bumpymap-layers-")
    try:
        _map(MapConfig(surveys=places, out=Path(folder), **own))
        return Layers(folder, in_memory=True)
    except BaseException as end:
        shutil.rmtree(folder, ignore_errors=True)
        end.__notes__ = [
            note for note in getattr(end, "__notes__", []) if "the same again" not in note
        ]  # the temporary folder is deleted, so there is nothing to continue
        raise


def _map(config: MapConfig) -> None:
    from bumpymap.survey import map_surveys, require_known

    require_known(map_surveys(config), config)


def _places(surveys: PathLike | Iterable[PathLike]) -> tuple[Path, ...]:
    """Convert one path or several to Path objects."""
    several = [surveys] if isinstance(surveys, str | os.PathLike) else surveys
    if not isinstance(several, Iterable):
        raise UsageError(f"surveys is {short_repr(several)}; give a path or a list of them")
    texts = [path_of_call("surveys", survey) for survey in several]
    if not texts:
        raise UsageError("surveys is empty; give a path or a list of them")
    return tuple(map(Path, texts))
