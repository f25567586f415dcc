from .block_work import (
    BlockWork as BlockWork,
    MeasuredTiles as MeasuredTiles,
    engine_errors as engine_errors,
)
from .budget import (
    Budget as Budget,
    with_memory as with_memory,
)
from .cluster import (
    ClusterExecutor as ClusterExecutor,
    connect as connect,
)
from .local import (
    LocalExecutor as LocalExecutor,
)
from .resource_estimate import (
    Estimate as Estimate,
    estimate as estimate,
)
from .run import (
    Executor as Executor,
    run_engine as run_engine,
)
from .sink import (
    TileSink as TileSink,
)
from .workspace import (
    ADVICE as ADVICE,
    Workspace as Workspace,
)
