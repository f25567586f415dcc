from .advice import (
    Measured as Measured,
    Outcome as Outcome,
    advise as advise,
    enough_points as enough_points,
    models_for as models_for,
    size_options as size_options,
)
from .api import (
    map_survey as map_survey,
)
from .engine.block_work import (
    BlockWork as BlockWork,
)
from .engine.budget import (
    Budget as Budget,
    memory_bytes as memory_bytes,
)
from .engine.pool import (
    WorkerPool as WorkerPool,
)
from .engine.resource_estimate import (
    Estimate as Estimate,
    estimate as estimate,
)
from .pipeline import (
    map_surveys as map_surveys,
)
from .result import (
    MapResult as MapResult,
)
