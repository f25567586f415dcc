"""Readers: a point cloud file in, chunks of points in metres out."""

from bumpymap.crs import common_georeference
from bumpymap.readers.detect import open_survey
from bumpymap.readers.find import find_surveys
from bumpymap.readers.protocol import ReadOptions, SurveyInfo, SurveyReader
from bumpymap.readers.summary import PointSummary, enough_points, summarise

__all__ = [
    "PointSummary",
    "ReadOptions",
    "SurveyInfo",
    "SurveyReader",
    "common_georeference",
    "enough_points",
    "find_surveys",
    "open_survey",
    "summarise",
]
