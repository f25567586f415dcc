from .advice import (
    Measured as Measured,
    Outcome as Outcome,
    advise as advise,
    enough_points as enough_points,
    made_for as made_for,
    size_options as size_options,
)
from .engine.block_work import (
    BlockWork as BlockWork,
    MeasuredTiles as MeasuredTiles,
)
from .engine.budget import (
    Budget as Budget,
    memory_bytes as memory_bytes,
)
from .engine.cluster import (
    ClusterExecutor as ClusterExecutor,
)
from .engine.local import (
    LocalExecutor as LocalExecutor,
)
from .engine.pool import (
    WorkerPool as WorkerPool,
    connect as connect,
)
from .engine.resource_estimate import (
    Estimate as Estimate,
    estimate as estimate,
)
from .engine.run import (
    Executor as Executor,
    Inputs as Inputs,
    run_engine as run_engine,
)
from .engine.workspace import (
    ADVICE as ADVICE,
    Workspace as Workspace,
)
from .pipeline import (
    MapResult as MapResult,
    map_surveys as map_surveys,
)
