from .advice import (
    Outcome as Outcome,
    advise as advise,
    enough_points as enough_points,
    models_for as models_for,
    size_options as size_options,
)
from .api import (
    map_survey as map_survey,
)
from .batch.api import (
    map_batch as map_batch,
)
from .batch.night import (
    BatchReport as BatchReport,
    BatchResult as BatchResult,
    run_batch as run_batch,
)
from .batch.settings import (
    BatchConfig as BatchConfig,
    SurveyPer as SurveyPer,
    read_batch_settings as read_batch_settings,
)
from .end_of_run import (
    ground_line as ground_line,
    outcome_of_run as outcome_of_run,
    require_known as require_known,
    unknown_line as unknown_line,
)
from .engine.block_work import (
    BlockWork as BlockWork,
)
from .engine.budget import (
    Budget as Budget,
    with_memory as with_memory,
)
from .engine.resource_estimate import (
    Estimate as Estimate,
    estimate as estimate,
)
from .flight_lines import (
    FlightLines as FlightLines,
    compare_lines as compare_lines,
    describe_lines as describe_lines,
    describe_pairs as describe_pairs,
)
from .pipeline import (
    map_surveys as map_surveys,
)
from .result import (
    MapResult as MapResult,
)
