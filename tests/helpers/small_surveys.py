"""Small surveys, good ones and broken ones; pictures that are none; layers that say the same of the survey."""

import shutil
import struct
import zlib
from contextlib import contextmanager

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rasterio
from click.testing import CliRunner
from pyproj import CRS

from bumpymap.cli import main
from bumpymap.layers.products import PRODUCT_NAMES

SIDES = tuple(f"rasters/{name}.tif.aux.xml" for name in ("barred", "class", "obstacle", "reason"))
"""Files of a map that GDAL looks for: names, colours and counts of the values of a raster."""


def run(*arguments, code=None):
    """Call bumpymap with words, paths and numbers; it must end with the exit code that is given."""
    done = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert code in {None, done.exit_code}, (done.output, done.exception)
    return done


def killed_at(place, left, *words):
    """Map until a place of bumpymap is reached, and leave in a folder what a kill then leaves."""
    out = left.with_name(f"{left.name} killed")

    def killed(*_, **__):
        shutil.copytree(out, left)
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"bumpymap.{place}", killed)
        run("map", *words, "--out", out, code=130)


def files_in(folder):
    """Bytes of every file in a folder and in those in it, by its path there."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def layers_of(folder):
    """Bytes of every layer but run.json, which says when it was made."""
    return {name: (folder / name).read_bytes() for name in PRODUCT_NAMES if name != "run.json"}


def band(path, name=None):
    """The first band of a raster, or the one of that name."""
    with rasterio.open(path) as file:
        return file.read(file.descriptions.index(name) + 1 if name else 1)


def write_las(path, x, y, z, *, crs="EPSG:32614", offset=(500_000, 4_000_000, 0), scales=(0.001,) * 3, **columns):
    """Write points to a LAS or LAZ file with a CRS (None: without one); ``columns`` have the names of laspy."""
    header = laspy.LasHeader(point_format=7 if "red" in columns else 6, version="1.4")
    header.offsets, header.scales = offset, scales
    if crs:
        header.add_crs(CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = (np.asarray(axis, float) for axis in (x, y, z))
    for name, values in columns.items():
        las[name] = values
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)
    return path


def write_survey(path, *, epsg=32614, points=20_000, seed=0, side=20.0, height=None):
    """Ground of some tiles, nearly flat or ``height(x, y)``; no CRS if ``epsg`` is None."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(500_001, 500_001 + side, points), rng.uniform(4_000_002, 4_000_002 + side, points)
    z = 100 + 0.02 * rng.standard_normal(points) if height is None else height(x, y)
    return write_las(path, x, y, z, crs=epsg)


def write_broken(path):
    """The first half of a survey."""
    data = write_survey(path).read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


def write_bomb(path):
    """A tiny PNG or JPEG whose header declares more pixels than any memory holds."""
    size = struct.pack(">II", 100_000, 100_000) + b"\x08\x02\0\0\0"
    chunks = [
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in ((b"IHDR", size), (b"IDAT", zlib.compress(bytes(9))), (b"IEND", b""))
    ]
    frame = b"\xff\xc0\0\x11\x08" + struct.pack(">HH", 65_500, 65_500) + b"\x03\x01\x11\0\x02\x11\0\x03\x11\0"
    jpeg = b"\xff\xd8" + frame + b"\xff\xda\0\x0c\x03\x01\0\x02\0\x03\0\0\x3f\0" + bytes(9) + b"\xff\xd9"
    path.write_bytes(jpeg if path.suffix == ".jpg" else b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    return path


@contextmanager
def no_views():
    """Maps made in this process meanwhile have layers alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bumpymap.views.write_map_views", lambda *_: None)
        yield


@contextmanager
def batches_here():
    """Batches meanwhile map their surveys in this process, one after the other."""
    from bumpymap.core.run_folder import lock_for
    from bumpymap.survey.batch.run import map_one

    def here(_, __, ___, tasks, ____):
        yield from ((number, 0.0, map_one(*task)) for number, task in enumerate(tasks))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bumpymap.survey.batch.run.call_in_children", here)
        yield
    lock_for({})


ALIKE = {"name": "survey", "checksum": "blake3:0", "dates": None}


@contextmanager
def alike_surveys():
    """Name, checksum and dates of all surveys mapped in this process meanwhile are ``ALIKE``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bumpymap.survey.pipeline.survey_record", lambda *_: ALIKE)
        yield


def tiles_without_survey(path):
    """Bytes of all columns and metadata of a tiles.parquet but what names the survey, for runs of other processes."""
    table = pq.read_table(path)
    metadata = {key: value for key, value in table.schema.metadata.items() if not key.startswith(b"survey")}
    assert len(metadata) < len(table.schema.metadata)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema.with_metadata(metadata)) as stream:
        stream.write_table(table.replace_schema_metadata(metadata))
    return sink.getvalue().to_pybytes()
