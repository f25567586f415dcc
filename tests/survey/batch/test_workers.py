"""Worker processes: one for many surveys; one that dies takes its survey along, no other."""

from pathlib import Path

import pytest

from bumpymap.core import MapConfig
from bumpymap.survey.batch import one_survey
from bumpymap.survey.batch.one_survey import MapTask

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("jobs", [pytest.param(1, marks=pytest.mark.later), 2])
def test_a_process_maps_many_surveys_and_one_that_dies_fails_its_survey_alone(monkeypatch, jobs):
    monkeypatch.setattr(one_survey, "_MODULE", "worker_of_a_batch")
    names, begun = ["s", "a", "s2", "dies", "b", "raises", "dies_too", "c"], []
    tasks = [MapTask(name, MapConfig((Path(f"{name}.laz"),), Path("o"))) for name in names]
    rows = [end.row for end in one_survey.map_tasks(tasks, jobs, lambda task: begun.append(task.name))]
    assert begun == names
    assert sorted(row.name for row in rows) == sorted(names)
    rows = {row.name: row for row in rows}
    assert {name for name, row in rows.items() if row.status == "done"} == {"s", "a", "s2", "b", "c"}
    assert len({rows[name].message for name in ("s", "a", "s2")}) <= jobs  # processes that mapped them
    assert "SIGKILL" in rows["dies"].message
    assert rows["dies"].survey == "dies.laz"
    assert "of no kind that is expected" in rows["raises"].message
