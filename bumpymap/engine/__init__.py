"""The engine: files in, finished tiles on disk out, within a memory budget, on one machine or many."""

from bumpymap.engine.budget import Budget, memory_bytes
from bumpymap.engine.cluster import ClusterRun, Crew, hired
from bumpymap.engine.job import Done, Job
from bumpymap.engine.local import LocalRun
from bumpymap.engine.workspace import Workspace, work_folder

__all__ = [
    "Budget",
    "ClusterRun",
    "Crew",
    "Done",
    "Job",
    "LocalRun",
    "Workspace",
    "hired",
    "memory_bytes",
    "work_folder",
]
