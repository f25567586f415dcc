"""Runs whose layers say the same of the survey: the same points then give the same bytes, however they are split."""

from contextlib import contextmanager

import pytest

ALIKE = {"name": "survey", "checksum": "blake3-1MiB:0", "dates": None}


@contextmanager
def alike_surveys():
    """Name, checksum and dates of all surveys mapped in this process meanwhile are ``ALIKE``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bumpymap.survey.run_record.survey_record", lambda *_: ALIKE)
        yield
