"""Runs whose layers say the same of the survey: the same points then give the same bytes, however they are split."""

from contextlib import contextmanager

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

ALIKE = {"name": "survey", "checksum": "blake3:0", "dates": None}


@contextmanager
def alike_surveys():
    """Name, checksum and dates of all surveys mapped in this process meanwhile are ``ALIKE``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bumpymap.survey.run_record.survey_record", lambda *_: ALIKE)
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
