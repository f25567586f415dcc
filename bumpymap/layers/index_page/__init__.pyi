from .page import (
    SurveyView as SurveyView,
    index_page as index_page,
)
from .thumbnail import (
    read_thumbnail as read_thumbnail,
)
