from .night import (
    BatchReport as BatchReport,
    BatchResult as BatchResult,
    run_batch as run_batch,
)
from .settings import (
    BatchConfig as BatchConfig,
    SurveyPer as SurveyPer,
    read_batch_settings as read_batch_settings,
)
