from .files import (
    make_quarry_survey as make_quarry_survey,
)
