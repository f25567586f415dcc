"""Readers: a point cloud file in, pieces of points in metres out."""

from bumpymap.crs import common_georeference
from bumpymap.readers.decoder import rest as rest_decoder
from bumpymap.readers.detect import open_survey, reopen_survey
from bumpymap.readers.find import find_surveys
from bumpymap.readers.protocol import PIECE_POINTS, Batch, Piece, ReadOptions, SurveyInfo, SurveyReader
from bumpymap.readers.source import Location, Version, changed, identity, is_url, version_of
from bumpymap.readers.summary import PointSummary, enough_points, summarise
from bumpymap.readers.tally import Tally

__all__ = [
    "PIECE_POINTS",
    "Batch",
    "Location",
    "Piece",
    "PointSummary",
    "ReadOptions",
    "SurveyInfo",
    "SurveyReader",
    "Tally",
    "Version",
    "changed",
    "common_georeference",
    "enough_points",
    "find_surveys",
    "identity",
    "is_url",
    "open_survey",
    "reopen_survey",
    "rest_decoder",
    "summarise",
    "version_of",
]
