from .budget import (
    Budget as Budget,
    memory_bytes as memory_bytes,
)
from .cluster import (
    ClusterRun as ClusterRun,
    Crew as Crew,
    hired as hired,
)
from .job import (
    Done as Done,
    Job as Job,
)
from .local import (
    LocalRun as LocalRun,
)
from .workspace import (
    ADVICE as ADVICE,
    Workspace as Workspace,
)
