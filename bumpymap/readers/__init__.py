"""Readers: a point cloud file in, chunks of points in metres out."""

from bumpymap.readers.detect import open_survey
from bumpymap.readers.find import find_surveys
from bumpymap.readers.protocol import ReadOptions, SurveyInfo, SurveyReader

__all__ = ["ReadOptions", "SurveyInfo", "SurveyReader", "find_surveys", "open_survey"]
