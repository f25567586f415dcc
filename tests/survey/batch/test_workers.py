"""Worker processes: one for many surveys; one that dies takes its survey along, no other."""

from pathlib import Path

import pytest

from bumpymap.core import MapConfig
from bumpymap.survey.batch import one_survey
from bumpymap.survey.batch.one_survey import MapTask

pytestmark = pytest.mark.slow


@pytest.fixture
def ended(monkeypatch):
    monkeypatch.setattr(one_survey, "_MODULE", "worker_of_a_batch")

    def run(names, jobs):
        tasks = [MapTask(name, MapConfig((Path(f"{name}.laz"),), Path("o"))) for name in names]
        begun = []
        ends = list(one_survey.map_tasks(tasks, jobs, lambda task: begun.append(task.name)))
        assert begun == names
        assert sorted(end.row.name for end in ends) == sorted(names)
        return {end.row.name: end.row for end in ends}

    return run


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_process_maps_many_surveys_and_one_that_dies_fails_its_survey_alone(ended, jobs):
    assert len({row.message for row in ended([f"s{number}" for number in range(6)], jobs).values()}) <= jobs
    rows = ended(["a", "dies", "b", "raises", "dies_too", "c"], jobs)
    assert {name for name, row in rows.items() if row.status == "done"} == {"a", "b", "c"}
    assert "SIGKILL" in rows["dies"].message
    assert rows["dies"].survey == "dies.laz"
    assert "of no kind that is expected" in rows["raises"].message
