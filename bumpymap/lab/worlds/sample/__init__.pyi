from ._surfaces import (
    CROWN as CROWN,
    KERB_HEIGHT as KERB_HEIGHT,
    RAMP_SLOPE_DEG as RAMP_SLOPE_DEG,
    WASHBOARD_AMPLITUDE as WASHBOARD_AMPLITUDE,
    WASHBOARD_LENGTH as WASHBOARD_LENGTH,
)
from .files import (
    SampleFiles as SampleFiles,
    make_quarry_survey as make_quarry_survey,
)
from .site import (
    EPSG as EPSG,
    ZONES as ZONES,
    QuarrySite as QuarrySite,
    Zone as Zone,
)
from .survey import (
    NOISE_SIGMA as NOISE_SIGMA,
    SurveyPoints as SurveyPoints,
    sample_survey as sample_survey,
)
