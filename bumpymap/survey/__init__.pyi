from .advice import (
    Outcome as Outcome,
    advise as advise,
    enough_points as enough_points,
    ground_line as ground_line,
    outcome_of_run as outcome_of_run,
    require_known as require_known,
    unknown_line as unknown_line,
)
from .batch.run import (
    BatchReport as BatchReport,
    BatchResult as BatchResult,
    map_batch as map_batch,
    run_batch as run_batch,
)
from .batch.settings import (
    BatchConfig as BatchConfig,
    MapSettings as MapSettings,
    PathLike as PathLike,
    map_settings as map_settings,
)
from .engine.budget import (
    Budget as Budget,
    Estimate as Estimate,
    estimate as estimate,
    with_memory as with_memory,
)
from .flight_lines import (
    FlightLines as FlightLines,
    compare_lines as compare_lines,
    describe_lines as describe_lines,
)
from .inputs import (
    file_doubts as file_doubts,
    read_options as read_options,
)
from .pipeline import (
    MapResult as MapResult,
    map_surveys as map_surveys,
)
