"""The calibration as a whole, with few and short drives."""

import errno
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bumpymap.core.errors import OutputError
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate import calibrate as calibrate_module
from bumpymap.lab.simulate.calibrate import calibrate_vehicle, calibration_journal, class_limits, run_job
from bumpymap.lab.simulate.drive import DriveSettings, PatchDrives
from bumpymap.lab.simulate.jobs import DriveJob
from bumpymap.lab.simulate.plan import library_terrains
from bumpymap.lab.worlds.terrains import KINDS
from bumpymap.rating.calibration import Calibration, shipped_calibrations
from bumpymap.rating.vehicle_profile import Vehicle, load_profile

pytest.importorskip("dartpy")

pytestmark = pytest.mark.slow
SHORT = DriveSettings(settle_s=0.2, ramp_s=0.3, cruise_s=0.0, measure_s=0.6)
SETTINGS = CalibrationSettings(
    load_profile("warthog"), 4, patches=2, starts=1, z_range=(0.05, 0.4), terrains=1, terrain_starts=2, drive=SHORT
)
TABLE, LIBRARY = 16, len(KINDS)


@pytest.fixture(scope="module", autouse=True)
def without_fits():
    """Only table and library: no crossings, no other speeds, no models."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrate_module, "refit", lambda made: made)
        patch.setattr(calibrate_module, "fit_steps", lambda *_: None)
        patch.setattr(calibrate_module, "fit_motion", lambda *_: SimpleNamespace(to_record=lambda: None))
        for name in ("crossing_jobs", "motion_jobs"):
            patch.setattr(calibrate_module, name, lambda _: [])
        yield


@pytest.fixture(scope="module")
def calibration():
    return calibrate_vehicle(SETTINGS)


@pytest.fixture
def fake_drives(monkeypatch):
    """Jobs that cost nothing; returns the list of those that ran."""
    ran = []

    def run(settings, job):
        ran.append(job)
        kind = job.key[1]
        c_r = 0.03 * (1 + kind) if job.key[0] == "table" else 0.01 * (1 + KINDS.index(kind))
        return PatchDrives(("completed",) * job.starts, (c_r,) * job.starts)

    monkeypatch.setattr(calibrate_module, "run_job", run)
    return ran


def test_real_calibration_rises_with_z_range_and_reads_back(calibration):
    assert all(low < high for low, high in calibration.c_r)
    assert calibration.drives == ((2, 2),) * 4
    assert calibration.ride is None
    assert Calibration.from_json(calibration.to_json(), "x") == calibration


def test_classes_mean_the_same_for_tiles_of_another_size(fake_drives):
    like = replace(Calibration.shipped("warthog"), class_limits=(0.05, 0.09, 0.13))
    made = calibrate_vehicle(SETTINGS, like=like)
    assert made.class_limits == like.class_limits
    c_r = np.array([terrain.c_r for terrain in library_terrains(made)])
    class_id = np.searchsorted(like.class_limits, c_r, side="right")
    assert made.class_c_r == pytest.approx([c_r[class_id == k].mean() for k in range(4)])
    assert like.id in made.settings["class_rule"]


@pytest.mark.later
def test_number_of_workers_changes_nothing(calibration):
    assert calibrate_vehicle(SETTINGS, workers=2) == calibration


def test_interruption_changes_nothing_and_driven_patches_are_not_driven_again(calibration, tmp_path, monkeypatch):
    path = tmp_path / "out.json.progress.jsonl"

    def stop(done, _total):
        if done >= TABLE + 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrate_vehicle(SETTINGS, stop, journal=calibration_journal(path, SETTINGS))
    assert len(path.read_text().splitlines()) == 1 + TABLE + 3
    ran = []
    monkeypatch.setattr(calibrate_module, "run_job", lambda s, job: ran.append(job) or run_job(s, job))
    assert calibrate_vehicle(SETTINGS, journal=calibration_journal(path, SETTINGS)) == calibration
    assert len(ran) == LIBRARY - 3


def test_job_depends_on_nothing_but_the_settings(calibration):
    more = replace(SETTINGS, patches=5, starts=2, terrains=3, terrain_starts=3)
    table, library = DriveJob(("table", 3, 1, 1), 1), DriveJob(("library", "furrows", 0), 2)
    assert run_job(more, replace(table, starts=2)).c_r[:1] == run_job(SETTINGS, table).c_r
    assert calibration.settings["patch_c_r"][3][1][1] == run_job(SETTINGS, table).c_r[0]
    made = run_job(SETTINGS, library)
    assert run_job(more, replace(library, starts=3)).c_r[:2] == made.c_r
    assert calibration.settings["library"]["furrows"]["c_r"] == [pytest.approx(made.mean_c_r, rel=1e-5)]


def test_cut_off_line_is_dropped(fake_drives, tmp_path, caplog):
    path = tmp_path / "progress"
    whole = calibrate_vehicle(SETTINGS, journal=calibration_journal(path, SETTINGS))
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:4]) + "\n" + lines[4][:25])
    fake_drives.clear()
    assert calibrate_vehicle(SETTINGS, journal=calibration_journal(path, SETTINGS)) == whole
    assert len(fake_drives) == TABLE + LIBRARY - 3
    assert "damaged line" in caplog.text
    assert path.read_text().splitlines() == lines


def test_progress_of_other_settings_is_refused_unless_told(fake_drives, tmp_path):
    path = tmp_path / "progress"
    calibrate_vehicle(SETTINGS, journal=calibration_journal(path, SETTINGS))
    other = replace(SETTINGS, seed=5)
    with pytest.raises(OutputError, match=r"other settings.*--overwrite"):
        calibrate_vehicle(other, journal=calibration_journal(path, other))
    fake_drives.clear()
    calibrate_vehicle(other, journal=calibration_journal(path, other), discard_other=True)
    assert len(fake_drives) == TABLE + LIBRARY
    assert json.loads(path.read_text().splitlines()[0])["settings"]["seed"] == 5


def test_a_progress_file_that_is_a_link_is_left_alone_even_if_it_became_one_during_the_run(tmp_path, fake_drives):
    path, mine = tmp_path / "progress", tmp_path / "mine"
    mine.write_text("mine")
    for target in (mine, tmp_path / "none"):
        path.symlink_to(target)
        with pytest.raises(OutputError, match="is a link and was not touched"):
            calibrate_vehicle(SETTINGS, journal=calibration_journal(path, SETTINGS), discard_other=True)
        path.unlink()
    journal = calibration_journal(path, SETTINGS)
    assert journal.resume(discard_other=False) == {}
    path.unlink()
    path.symlink_to(mine)
    with pytest.raises(OutputError, match="is a link and was not touched"):
        journal.add(("a", 1), PatchDrives(("completed",), (0.1,)))
    assert sorted(found.name for found in tmp_path.iterdir()) == ["mine", "progress"]
    assert mine.read_text() == "mine"


def test_a_full_disk_does_not_cost_what_was_driven(tmp_path, fake_drives, monkeypatch):
    path = tmp_path / "progress"
    calibrate_vehicle(SETTINGS, journal=calibration_journal(path, SETTINGS))
    before = path.read_text()

    def full(file, *_, **__):
        with file.open("w") as opened:
            opened.write("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.write_text", full)
        with pytest.raises(OutputError, match="No space left"):
            calibration_journal(path, SETTINGS).resume(discard_other=False)
    assert path.read_text() == before


@pytest.mark.later
@pytest.mark.parametrize("name", shipped_calibrations())
def test_shipped_calibration_is_what_this_code_makes(name):
    shipped = Calibration.shipped(name)
    made = shipped.settings
    profile = load_profile(name)
    assert Vehicle.from_dict(shipped.vehicle, name) == profile
    settings = CalibrationSettings(
        profile, **{name: made[name] for name in ("seed", "patches", "starts", "terrains", "terrain_starts")}
    )
    wanted = {name: value for name, value in settings.to_dict().items() if name not in ("versions", "vehicle")}
    assert {name: made[name] for name in wanted} == wanted
    for texture, z in ((0, 5), (3, 2)):
        drives = run_job(settings, DriveJob(("table", texture, z, 0), settings.starts))
        assert drives.mean_c_r == pytest.approx(made["patch_c_r"][texture][z][0], rel=0.01)
    drives = run_job(settings, DriveJob(("library", "fractal_5", 1), settings.terrain_starts))
    assert drives.mean_c_r == pytest.approx(made["library"]["fractal_5"]["c_r"][1], rel=0.01)


@pytest.mark.parametrize("name", shipped_calibrations())
def test_shipped_class_limits_and_cell_means_follow_from_the_shipped_drives(name):
    shipped = Calibration.shipped(name)
    assert shipped.class_limits == class_limits(library_terrains(shipped))
    means = [
        [np.mean([c for c in cell if c is not None] or np.nan) for cell in z] for z in shipped.settings["patch_c_r"]
    ]
    np.testing.assert_allclose(np.array(shipped.c_r, dtype=float), means, rtol=1e-12)
