from .block_work import (
    BlockWork as BlockWork,
    MeasuredTiles as MeasuredTiles,
    TileSink as TileSink,
    engine_errors as engine_errors,
)
from .budget import (
    Budget as Budget,
    Workspace as Workspace,
    with_memory as with_memory,
)
from .cluster import (
    ClusterExecutor as ClusterExecutor,
    connect as connect,
)
from .run import (
    Executor as Executor,
    LocalExecutor as LocalExecutor,
    run_engine as run_engine,
)
