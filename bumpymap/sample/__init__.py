"""A made-up survey with known truth: for the demo, the tutorial and the tests.

>>> from bumpymap.sample import QuarrySite
>>> site = QuarrySite(seed=1)
>>> site.zone_at(512_400.0, 5_403_240.0).item()
'washboard'
"""

from bumpymap.sample._surfaces import CROWN, KERB_HEIGHT, RAMP_SLOPE_DEG, WASHBOARD_AMPLITUDE, WASHBOARD_LENGTH
from bumpymap.sample.files import SampleFiles, make_quarry_survey
from bumpymap.sample.site import EPSG, ZONES, QuarrySite, Zone
from bumpymap.sample.survey import NOISE_SIGMA, SurveyPoints, sample_survey

__all__ = [
    "CROWN",
    "EPSG",
    "KERB_HEIGHT",
    "NOISE_SIGMA",
    "RAMP_SLOPE_DEG",
    "WASHBOARD_AMPLITUDE",
    "WASHBOARD_LENGTH",
    "ZONES",
    "QuarrySite",
    "SampleFiles",
    "SurveyPoints",
    "Zone",
    "make_quarry_survey",
    "sample_survey",
]
