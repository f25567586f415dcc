import json
import re
import sys
from dataclasses import asdict, replace

import pytest
from click.testing import CliRunner

from bumpymap.cli import main
from bumpymap.lab.settings import CalibrationSettings, LibraryJob
from bumpymap.lab.simulate import calibrate as calibrate_module, motion_fit, refit, ride_fit
from bumpymap.lab.simulate.drive import PatchDrives
from bumpymap.lab.simulate.jobs import SimulatorCheck
from bumpymap.lab.worlds.terrains import KINDS
from bumpymap.rating.calibration import Calibration

pytest.importorskip("dartpy")


@pytest.fixture
def fake_drives(monkeypatch):
    monkeypatch.setattr(
        CalibrationSettings,
        "quick",
        lambda self: replace(self, patches=3, starts=2, z_range=(0.02, 0.2, 2.0), terrains=1, terrain_starts=2),
    )

    def run(settings, job):
        if isinstance(job, LibraryJob):
            c_r = 0.02 * (1 + KINDS.index(job.kind))
            failed = job.kind == "kerb"
            return PatchDrives(("completed", "stuck" if failed else "completed"), (c_r, None if failed else c_r))
        c_r = 0.03 * (1 + job.texture) * (1 + 5 * job.z) * (1 + 0.1 * job.patch)
        return (
            PatchDrives(("completed", "rolled"), (c_r, None))
            if job.z == 2
            else PatchDrives(("completed",) * 2, (c_r,) * 2)
        )

    monkeypatch.setattr(calibrate_module, "run_job", run)
    monkeypatch.setattr(refit, "add_steps", lambda made, *_, **__: replace(made, steps={"seed": made.settings["seed"]}))
    monkeypatch.setattr(motion_fit, "add_motion", lambda made, *_, effort, **__: replace(made, motion=asdict(effort)))
    monkeypatch.setattr(ride_fit, "fit_ride", lambda _profile, _terrains, driven: {"terrains": len(driven)})
    monkeypatch.setattr(ride_fit, "fit_thin_surveys", lambda _profile, terrains, _ride, _limit: {"n": len(terrains)})


def calibrate(*words):
    named = [] if {"--vehicle", "--check"} & set(words) else ["--vehicle", "warthog"]
    return CliRunner().invoke(main, ["calibrate", *named, *map(str, words)])


def test_calibration_is_written_and_summed_up(tmp_path, fake_drives):
    out = tmp_path / "new" / "warthog.json"
    result = calibrate("--out", out, "--quick", "--jobs", 1, "--set", "seed=9")
    assert result.exit_code == 0, result.output
    calibration = Calibration.load(out)
    assert calibration.settings["seed"] == 9
    assert calibration.settings["command"] == (
        "bumpymap calibrate --vehicle warthog --out warthog.json --tile-size 3 --quick --set seed=9 --set patches=3 "
        "--set starts=2 --set terrains=1 --set terrain_starts=2 --set pixels=15"
    )
    assert calibration.ride == {"terrains": 17}
    assert calibration.steps == {"seed": 9}
    assert calibration.thin == {"n": 17}
    assert calibration.motion["terrains"] == 2
    assert re.search(r"warthog: \d+ drives, about .* with 1 process\.", result.output)
    assert "72 drives over textures, 12 failed" in result.output
    assert "34 drives over 17 terrains of the library, 1 failed" in result.output
    assert "class 3 very rough" in result.output
    assert calibration.id in result.output
    assert [path.name for path in out.parent.iterdir()] == ["warthog.json"]


def test_existing_file_is_kept_unless_told(tmp_path, fake_drives):
    out = tmp_path / "c.json"
    out.write_text("mine")
    refused = calibrate("--out", out, "--quick", "--jobs", 1)
    assert refused.exit_code == 3
    assert "exists" in refused.output
    assert "--overwrite" in refused.output
    assert out.read_text() == "mine"
    assert calibrate("--out", out, "--quick", "--jobs", 1, "--overwrite").exit_code == 0
    assert json.loads(out.read_text())["format"] == "bumpymap-calibration"


def test_interrupted_run_says_how_to_go_on(tmp_path, fake_drives, monkeypatch):
    out = tmp_path / "c.json"
    run, ran = calibrate_module.run_job, []

    def interrupted(settings, job):
        ran.append(job)
        if len(ran) == 8:
            raise KeyboardInterrupt
        return run(settings, job)

    monkeypatch.setattr(calibrate_module, "run_job", interrupted)
    result = calibrate("--out", out, "--quick", "--jobs", 1)
    assert result.exit_code == 130
    assert "same command again" in result.output
    assert not out.exists()
    assert calibrate("--out", out, "--quick", "--jobs", 1).exit_code == 0
    assert len(ran) == 8 + 2 + (36 + 17) - 5  # with the two that tell how long it will take


def test_a_calibration_is_for_a_vehicle_that_is_named(tmp_path):
    result = CliRunner().invoke(main, ["calibrate", "--out", str(tmp_path / "c.json")])
    assert result.exit_code == 2
    assert all(word in result.output for word in ("--vehicle", "warthog", "bumpymap vehicle new"))
    assert not any(tmp_path.iterdir())


def test_missing_engine_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "dartpy", None)
    result = calibrate("--out", tmp_path / "c.json")
    assert result.exit_code == 2
    assert "pip install 'bumpymap[sim]'" in result.output
    assert list(tmp_path.iterdir()) == []


def test_failing_check_gives_a_table_and_an_exit_code(monkeypatch):
    results = [SimulatorCheck("level", 0.0001, "< 0.001", ok=True), SimulatorCheck("sine", 7.1, "+-5", ok=False)]
    monkeypatch.setattr("bumpymap.lab.all_checks", lambda *_args: iter(results))
    result = calibrate("--check")
    assert result.exit_code == 1
    assert "7.1" in result.output
    assert "FAILED" in result.output
    monkeypatch.setattr("bumpymap.lab.all_checks", lambda *_args: iter(results[:1]))
    assert calibrate("--check").exit_code == 0
