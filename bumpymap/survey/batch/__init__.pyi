from .run import (
    BatchReport as BatchReport,
    BatchResult as BatchResult,
    BatchSettings as BatchSettings,
    map_batch as map_batch,
    run_batch as run_batch,
)
from .settings import (
    BatchConfig as BatchConfig,
    SurveyPer as SurveyPer,
    read_batch_settings as read_batch_settings,
)
