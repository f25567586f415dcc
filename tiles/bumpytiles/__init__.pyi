from ._dask import (
    ClusterError as ClusterError,
    Workers as Workers,
    threads_here as threads_here,
    workers_at as workers_at,
)
from ._loops import (
    loops_of as loops_of,
)
from .buckets import (
    MemoryLimits as MemoryLimits,
    TileBuckets as TileBuckets,
    TooManyPointsError as TooManyPointsError,
)
from .grid import (
    BLOCK_TILES as BLOCK_TILES,
    PER_METRE as PER_METRE,
    Bounds as Bounds,
    Grid as Grid,
    TileWindow as TileWindow,
)
from .grouping import (
    DECIMALS as DECIMALS,
    GroupedPoints as GroupedPoints,
    ScaledPoints as ScaledPoints,
    Scaling as Scaling,
    TilePoints as TilePoints,
    group_points as group_points,
    group_scaled_points as group_scaled_points,
    join_tiles as join_tiles,
    photo_of as photo_of,
    sort_block as sort_block,
)
from .pack import (
    BlockKey as BlockKey,
    Column as Column,
    Pack as Pack,
    PackError as PackError,
    key_codes as key_codes,
    write_pack as write_pack,
)
from .run import (
    blocked_signals as blocked_signals,
    grouped_blocks as grouped_blocks,
    run_blocks as run_blocks,
    start_python as start_python,
)
from .tile_table import (
    TileTable as TileTable,
)
