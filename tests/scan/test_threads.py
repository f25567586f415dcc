"""Frames in threads: the same files as one after another, and what happens when a run ends early."""

import hashlib
import threading
from dataclasses import replace

import numpy as np
import pytest

from bumpymap.layers import part_path
from bumpymap.readers import read_scan
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.pipeline import scan_frames

FRAMES = 7


@pytest.fixture(name="frames", scope="module")
def frames_fixture(tmp_path_factory):
    """Seven scans of rolling ground with a wall, each a metre further along it."""
    folder = tmp_path_factory.mktemp("frames")
    for number in range(FRAMES):
        rng = np.random.default_rng(number)
        x, y = rng.uniform(-20, 20, (2, 12_000))
        z = -1.5 + 0.05 * np.sin(3 * (x + number)) * np.cos(2 * y)
        y, z = np.where(y > 15.0, 15.0, y), np.where(y > 15.0, rng.uniform(-1.5, 1.0, len(y)), z)
        np.column_stack([x, y, z, np.ones(len(x))]).astype("<f4").tofile(folder / f"{number}.bin")
    places = [f"1 0 0 {number} 0 1 0 0 0 0 1 1.5" for number in range(FRAMES)]
    (folder / "poses.txt").write_text("\n".join(places) + "\n", encoding="utf-8")
    return folder


def settings(frames, out, **more):
    paths = tuple(frames / f"{number}.bin" for number in range(FRAMES))
    return ScanConfig(paths, out, method="filter", **more)


def checksums(folder):
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in {"scan.json", "run.json"}
    }


@pytest.fixture
def out_of_order(monkeypatch):
    """Let frame 0 wait until frame 2 has been read."""
    read = threading.Event()

    def reading(path, *rest):
        if path.stem == "0":
            assert read.wait(20.0)
        scan = read_scan(path, *rest)
        if path.stem == "2":
            read.set()
        return scan

    monkeypatch.setattr("bumpymap.scan.frames.read_scan", reading)


@pytest.fixture(name="serial", scope="module")
def serial_fixture(frames, tmp_path_factory):
    out = tmp_path_factory.mktemp("serial") / "out"
    return out, scan_frames(settings(frames, out, poses=frames / "poses.txt", pictures=3, threads=1))


def test_any_number_of_threads_gives_the_same_bytes(frames, serial, tmp_path, out_of_order):
    config = settings(frames, tmp_path / "out", poses=frames / "poses.txt", pictures=3, threads=3)
    result = scan_frames(config)
    assert checksums(tmp_path / "out") == checksums(serial[0])
    assert [report.frame.name for report in result.frames] == [str(number) for number in range(FRAMES)]
    untimed = [replace(report, seconds=0.0).record() | {"pose": None} for report in result.frames]
    assert untimed == [replace(report, seconds=0.0).record() | {"pose": None} for report in serial[1].frames]


class _Stopped:
    """A progress that ends the run after three frames."""

    def __init__(self):
        self.left = 3

    def start(self, stage, total):
        pass

    def advance(self, steps):
        self.left -= steps
        if not self.left:
            raise KeyboardInterrupt


def test_what_a_power_cut_has_left_half_written_is_made_again(frames, serial, tmp_path):
    config = settings(frames, tmp_path / "out", poses=frames / "poses.txt", pictures=3, threads=1)
    before = set(threading.enumerate())
    with pytest.raises(KeyboardInterrupt):
        scan_frames(config, _Stopped())
    assert not set(threading.enumerate()) - before
    run = config.out / ".bumpymap-run"
    for cut in (part_path(run, 0), run / "products" / "frames" / "1.ply"):
        cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    (run / "products" / "frames" / "2.ply").unlink()
    scan_frames(config)
    assert checksums(tmp_path / "out") == checksums(serial[0])
