import json
import re
import sys
from dataclasses import replace

import pytest
from click.testing import CliRunner

from bumpymap.cli import main
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate import calibrate as calibrate_module, refit
from bumpymap.lab.simulate.drive import PatchDrives
from bumpymap.lab.simulate.motion_fit import MotionRecord
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
        purpose, first, *rest = job.key
        if purpose == "library":
            c_r, failed = 0.02 * (1 + KINDS.index(first)), first == "kerb"
            return PatchDrives(("completed", "stuck" if failed else "completed"), (c_r, None if failed else c_r))
        if purpose == "crossing":
            return PatchDrives(("stuck",), (None,))
        if purpose == "motion":
            c_r = 0.02 * (1 + KINDS.index(first))
            return MotionRecord(*(((scale * c_r, scale * 1.1 * c_r, scale * 1.3 * c_r),) for scale in (1, 2, 3)))
        c_r = 0.03 * (1 + first) * (1 + 5 * rest[0]) * (1 + 0.1 * rest[1])
        if rest[0] == 2:
            return PatchDrives(("completed", "rolled"), (c_r, None))
        return PatchDrives(("completed",) * 2, (c_r,) * 2)

    monkeypatch.setattr(calibrate_module, "run_job", run)
    shipped = Calibration.shipped("warthog")
    monkeypatch.setattr(refit, "fit_ride", lambda *_: shipped.ride)
    monkeypatch.setattr(refit, "fit_thin_surveys", lambda *_: shipped.thin)


def calibrate(*words):
    return CliRunner().invoke(main, ["calibrate", "--vehicle", "warthog", *map(str, words)])


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
    assert calibration.ride == Calibration.shipped("warthog").ride
    assert calibration.steps["seed"] == 9
    assert calibration.steps["crossing"]["fail_up"][0] == [1, 1, 1]
    assert calibration.motion["origin"]["used"] == calibration.motion["origin"]["terrains"] == 34
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
    assert len(ran) == 8 + 2 + (36 + 17 + 72 + 34) - 5  # with the two that tell how long it will take


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
