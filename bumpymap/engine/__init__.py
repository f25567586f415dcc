"""The engine: files in, finished tiles on disk out, within a memory budget, on one machine or many."""

from bumpymap.engine.budget import Budget, memory_bytes
from bumpymap.engine.cluster import ClusterRun, Crew, hired
from bumpymap.engine.estimate import Estimate, estimate
from bumpymap.engine.job import Done, Job
from bumpymap.engine.local import LocalRun
from bumpymap.engine.workspace import ADVICE, Workspace

__all__ = [
    "ADVICE",
    "Budget",
    "ClusterRun",
    "Crew",
    "Done",
    "Estimate",
    "Job",
    "LocalRun",
    "Workspace",
    "estimate",
    "hired",
    "memory_bytes",
]
