from .features import (
    join_stacks as join_stacks,
    measure as measure,
)
from .ground.cloth import (
    close_filter as close_filter,
    filter_version as filter_version,
    mark_ground as mark_ground,
    require_filter as require_filter,
)
