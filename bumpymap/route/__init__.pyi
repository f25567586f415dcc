from ._moves import (
    MOVES as MOVES,
)
from .growing import (
    plan_way as plan_way,
)
from .line import (
    is_clear as is_clear,
    line_cost as line_cost,
    trace as trace,
)
from .search import (
    FROM_START as FROM_START,
    NOT_REACHED as NOT_REACHED,
    Way as Way,
    find_way as find_way,
    follow_back as follow_back,
    spread as spread,
)
from .straighten import (
    pull_tight as pull_tight,
)
