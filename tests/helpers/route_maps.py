"""Made-up maps for tests of routes: folders as a run leaves them, maps without files, a site with a wall and a gap."""

import json
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import rasterio
from cost_maps import make_map, table_of
from pyproj import CRS, Transformer

from bumpymap.core import NO_CLASS, CostRule, Georeference, Reason, RouteVehicle
from bumpymap.layers import MapReader, describe_file, write_products
from bumpymap.views import write_map_views
from bumpytiles import Grid, TileWindow

VEHICLE = {"name": "warthog", "width_m": 1.38, "height_m": 1.3, "clearance_m": 0.25, "speed_mps": 1.0}
RUN = {
    "survey": {"name": "pit", "checksum": None, "dates": None},
    "inputs": [],
    "calibration": {"id": "c0ffee", "vehicle": "warthog", "class_limits": [0.1, 0.2, 0.4]},
    "settings": {"rating": "ride", "compat": "none"},
    "vehicle": VEHICLE,
    "model": "m1",
    "points": 1_000,
    "seconds": {},
}
RULE = CostRule(
    ride_weight=5.0, fail_weight=300.0, drive_m=10.0, slope_limit_deg=30.0, speeds=((0.3, 1.0),), drive_log_sd=0.2
)
UTM = CRS.from_epsg(32614)


def write_folder(folder, cost_map, *, views=False, **changes):
    """Write the layers of a map to a folder, and its page and styles if asked; ``changes`` of the manifest."""
    folder.mkdir()
    local, shown = cost_map.georeference.crs is None, write_map_views if views else lambda *_: None
    write_products(table_of(cost_map), folder, views=shown, local=local, manifest=RUN | changes)
    return folder


def copy_folder(folder, target, **changes):
    """Copy a folder of layers; ``changes`` replace entries of the manifest (None: leave out)."""
    copytree(folder, target)
    record = json.loads((target / "run.json").read_text()) | changes
    (target / "run.json").write_text(json.dumps({key: value for key, value in record.items() if value is not None}))
    return target


def list_anew(folder, **changes):
    """State the files that are there now, as who planted them would; ``changes`` replace entries of the manifest."""
    record = json.loads((folder / "run.json").read_text()) | changes
    for entry in record["files"]:
        entry.update(describe_file(folder / entry["path"]) | {"path": entry["path"]})
    (folder / "run.json").write_text(json.dumps(record))


def plant_photo(folder, colours):
    """Give a map the photo (3, rows, cols), on the pixels of its heights, and list it."""
    with rasterio.open(folder / "rasters/heightmap.tif") as file:
        about = file.profile | {"driver": "GTiff", "count": 3, "dtype": "uint8", "nodata": None}
        whole = np.broadcast_to(colours, (3, file.height, file.width)).astype(np.uint8)
    with rasterio.open(folder / "rasters/photo.tif", "w", **about) as file:
        file.write(whole)
    record = json.loads((folder / "run.json").read_text())
    list_anew(folder, files=[*record["files"], {"path": "rasters/photo.tif"}])
    return folder


def change_bars(folder, code, bar):
    """Give all tiles of a class another entry in the column ``barred``."""
    path = folder / "tiles.parquet"
    table = pq.read_table(path)
    at = table.schema.get_field_index("barred")
    field = table.schema.field(at)
    chosen = pc.fill_null(pc.equal(table["class"], code), fill_value=False)
    bars = pc.if_else(chosen, pa.scalar(bar, pa.string()), table["barred"].cast(pa.string()))
    pq.write_table(table.set_column(at, field, bars.cast(field.type)), path)
    list_anew(folder)
    return folder


def bare_map(window=None, *, crs=UTM, unit=1.0):
    """Map without files: its place is known, nothing can be read."""
    window = window or TileWindow(160_000, 712_000, 100, 80)
    return MapReader(
        folder=Path("nowhere"),
        manifest={},
        grid=Grid(),
        window=window,
        georeference=Georeference(crs, unit),
        rule=RULE,
        vehicle=RouteVehicle("warthog", 1.38, 1.0),
    )


ROWS, COLS = 24, 30
WEST, SOUTH = 160_000, 712_000
TO_DEGREES = Transformer.from_crs("EPSG:32614", "EPSG:4326", always_xy=True)


def place(row, col):
    """Easting and northing of field coordinates, as text."""
    return f"{(WEST + col) * 3.0},{(SOUTH + ROWS - row) * 3.0}"


def lonlat(row, col):
    lon, lat = TO_DEGREES.transform((WEST + col) * 3.0, (SOUTH + ROWS - row) * 3.0)
    return f"{lon:.9f},{lat:.9f}"


def site(*, seed=1):
    """A wall of steep ground in the middle, with a gap in the north; a patch of unknown ground in the south-west."""
    row, col = (index.ravel() for index in np.mgrid[0:ROWS, 0:COLS])
    unknown = (row > 18) & (col < 5)
    reason = np.where(unknown, Reason.TOO_FEW_POINTS, Reason.OK)
    class_id = np.where(unknown, NO_CLASS, 0)
    made = make_map(WEST + col, SOUTH + ROWS - 1 - row, class_id, reason, grid=Grid(3.0, 4), seed=seed, easy=True)
    wall = (col == 15) & (row > 2)
    slope = np.where(wall, 60.0, 2.0)
    c_r = np.where(unknown, np.nan, 0.1 + 0.05 * (seed - 1)).astype(np.float32)
    p_fail = np.where(unknown, np.nan, 0.01).astype(np.float32)
    patches = replace(made.patches, slope=slope)
    return replace(
        made, patches=patches, probability=None, c_r=c_r, c_r_low=c_r * 0.8, c_r_high=c_r * 1.2, p_fail=p_fail
    )
