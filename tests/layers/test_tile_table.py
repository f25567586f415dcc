"""tiles.parquet of others: what it would take is known before it is read."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from route_maps import write_folder

import bumpymap
from bumpymap.core import BadInputError
from bumpymap.layers import describe_file, tile_table
from bumpymap.views import write_report


@pytest.fixture(name="folder")
def folder_fixture(make_field, tmp_path):
    return write_folder(tmp_path / "site", make_field(12, 9))


def replace_table(folder, table, **options):
    """Put another table in its place, and into the list of files, as a run would."""
    pq.write_table(table, folder / "tiles.parquet", **options)
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    entry = next(file for file in record["files"] if file["path"] == "tiles.parquet")
    entry |= describe_file(folder / "tiles.parquet") | {"path": "tiles.parquet"}
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")


def repeated(folder, times):
    """Return the tiles many times over: a small file, since equal rows take next to nothing."""
    table = pq.read_table(folder / "tiles.parquet").drop_columns(["heights", "geometry", "bbox"])
    return table.take(pa.array(np.repeat(np.arange(len(table)), times)))


@pytest.fixture(name="pool")
def pool_fixture():
    """Memory that Arrow takes from here on."""
    before = pa.default_memory_pool()
    pool = pa.proxy_memory_pool(before)
    yield pool
    pa.set_memory_pool(before)


def test_more_rows_than_the_run_counts_are_refused_before_they_are_read(folder, pool):
    replace_table(folder, repeated(folder, 10_000))
    pa.set_memory_pool(pool)
    for read in (lambda: write_report(folder), bumpymap.open(folder).tiles):
        with pytest.raises(BadInputError, match=r"tiles\.parquet holds [\d,]+ rows, and run\.json counts \d+ tiles"):
            read()
    assert pool.max_memory() < 1 << 20


def test_a_row_group_larger_than_a_run_writes_is_refused(folder):
    table = repeated(folder, 1000)
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    record["counts"]["tiles"] = len(table)
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")
    replace_table(folder, table, row_group_size=len(table))
    with pytest.raises(BadInputError, match=r"a group of [\d,]+ rows; at most 65,536 are read at once"):
        write_report(folder)


def test_rows_that_do_not_fit_into_memory_are_refused(folder, monkeypatch):
    monkeypatch.setattr(tile_table, "free_memory", lambda: 1000)
    with pytest.raises(BadInputError, match=r"tiles\.parquet takes .* of memory, and .* are free"):
        write_report(folder)
