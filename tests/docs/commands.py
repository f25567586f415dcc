"""Every command that README.md and the pages show, and how each is held to what it says.

The suite runs the quick ones (``test_commands.py``), each page in a folder of its own with the files that its commands
name; a rule names the others with the reason.
"""

import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
import pyproj

from bumpymap.cli import main as bumpymap_main

ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs" / "pages").glob("*.md")))
PROGRAMS = (
    "bumpymap", "chmod", "dask", "gdal_translate", "gdaldem", "grass", "make", "openssl", "pip", "python", "sudo",
)  # fmt: skip
SHELL = {"", "bash", "console", "sh", "shell"}
CRS = "EPSG:32614"


@dataclass(frozen=True)
class Rule:
    """What is done with commands that a pattern matches."""

    pattern: str
    why: str
    """Why it does not simply run in the suite."""


RULES = (
    Rule(r"^(\S*python -m )?pip install", "downloads; the extras that it names are held to pyproject.toml"),
    Rule(r"^make ", ".ci/run and .ci/fresh-machine run it; the target is held to the Makefile"),
    Rule(r"^sudo apt-get ", "changes the system; .ci/run installs the same packages"),
    Rule(r"^dask |scheduler=|^export DASK_", "takes a cluster: tests/survey/engine/test_cluster.py has one"),
    Rule(r"^(openssl|chmod) ", "makes keys: tests/survey/engine/test_cluster_security.py runs them"),
    Rule(r"^gdal", "takes GDAL's own tools"),
    Rule(r"^grass ", "takes GRASS"),
    Rule(r"^(xdg-open|qgis) ", "opens a window"),
    Rule(r"^python docs/licences/", "writes a page anew; a test of its own holds it"),
    Rule(r"^bumpymap map wide ", "takes a site that no page makes in the suite"),
    Rule(r"^python tests/tools/faults\.py", "runs tests for every fault, for an hour"),
    Rule(r"^bumpymap settings |--config map\.toml", "writes a file that is to be edited"),
    Rule(r"^python tests/fuzz/", "an hour"),
    Rule(r"^python docs/models/", "takes open3d, and simulates scenes for hours"),
    Rule(r"^python docs/pictures/", "draws over a picture of the pages; takes minutes"),
    Rule(r"^bumpymap vehicle new ", "writes the profile that later commands want filled in"),
    Rule(r"^bumpymap calibrate ", "hours of drives"),
    Rule(r"^\S*python \.ci/refresh_constraints\.py", "asks the package index for every file"),
    Rule(r"^python docs/drives/", "takes a data set; tests/docs/test_drives.py runs it where that is"),
    Rule(r"--refit ", "takes hundreds of metres of drives: tests/cli/test_check_refit.py makes them"),
    Rule(r"--calibration small\.json", "takes a calibration for such tiles: hours of drives"),
    Rule(r"^python tests/benchmarks/", "measures for minutes or hours, some beside other programs; tests run parts"),
    Rule(r"^python docs/models/|model=rellis\.onnx", "takes open3d and hours, or a data set"),
    Rule(r"^bumpymap (evaluate|train) ", "hours of drives or learning; tests/lab runs short ones"),
)


def shown(page: Path) -> Iterator[str]:
    """Give the commands of a page in their order: of its blocks, and those in its sentences that name a file."""
    text = page.read_text(encoding="utf-8")
    found: list[tuple[int, str]] = []
    for block in re.finditer(r"(?ms)^( *)```(\S*)[^\n]*\n(.*?)^\1```", text):
        program = block[3].strip().removeprefix("$ ").partition(" ")[0]
        if block[2] in SHELL and (block[2] or program in PROGRAMS):  # a block of no language may be a formula
            found += [(block.start(), line) for line in _lines(block[3])]
    begin = "|".join(PROGRAMS)
    found += [(line.start(), line[1]) for line in re.finditer(rf"(?m)^    ((?:{begin}) .*)$", text)]
    found += [(word.start(), word[1]) for word in re.finditer(r"`((?:\S*python \S+/|make |sudo\s)[^`]+)`", text)]
    for _, line in sorted(found, key=lambda one: one[0]):
        plain = line if "<<" in line else shlex.join(shlex.split(" ".join(line.split()), comments=True))
        yield plain.replace(".venv/bin/bumpymap", "bumpymap")


def _lines(block: str) -> list[str]:
    """Give the commands of a block: continued lines and what follows ``<<'END'`` belong to one."""
    block = re.sub(r"\\\n\s*", " ", block)
    block = re.sub(r"(?ms)^[^\n]*<<'?(\w+)'?\n.*?^\1$", lambda whole: whole[0].replace("\n", "\0"), block)
    prompted = any(line.strip().startswith("$ ") for line in block.splitlines())
    lines = [line.strip() for line in block.splitlines()]
    lines = [line.removeprefix("$ ") for line in lines if not prompted or line.startswith("$ ")]
    return [line.replace("\0", "\n") for line in lines if line and not line.startswith("#")]


def rule_of(command: str) -> Rule | None:
    """Give the rule of a command; None: it runs as it stands."""
    return next((rule for rule in RULES if re.search(rule.pattern, command)), None)


def filled(command: str) -> list[str]:
    """Put files that are there in the place of words in capitals."""
    words = {"SURVEY": "site.laz", "DIR": "dir", "EPSG:CODE": CRS, "FOLDER": "folder", "YOUR_SURVEY.laz": "site.laz"}
    return [words.get(word, word) for word in shlex.split(command)]


def furnish(folder: Path) -> None:
    """Put the files there that commands name: small surveys, frames of a drive, a vehicle of one's own."""
    data = ROOT / "bumpymap" / "rating" / "data"
    survey = laspy.read(ROOT / "sample_data" / "quarry.laz")
    x, y = np.asarray(survey.x), np.asarray(survey.y)
    (folder / "flights").mkdir()
    bumpymap_main(
        ["map", str(ROOT / "sample_data" / "quarry.laz"), "--out", str(folder / "demo_out" / "layers"), "--quiet"],
        standalone_mode=False,
    )
    (folder / "sample_data").mkdir()
    for name in ("quarry.laz", "quarry_drive_imu.csv", "quarry_drive_gnss.csv"):
        shutil.copy(ROOT / "sample_data" / name, folder / "sample_data")
    for name, east in (
        ("site.laz", 0.0),
        ("survey.laz", 0.0),
        ("may.laz", 0.0),
        ("june.laz", 0.0),
        ("flights/1.laz", 0.0),
        ("flights/2.laz", 12.0),
    ):
        part = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
        near = (abs(x - np.median(x) - east) < 6) & (abs(y - np.median(y)) < 9)
        part.header.offsets, part.header.scales = survey.header.offsets, survey.header.scales
        part.x, part.y, part.z = x[near], y[near], np.asarray(survey.z)[near]
        part.classification = survey.classification[near]
        part.header.add_crs(pyproj.CRS.from_user_input(CRS))
        part.write(folder / name)
    _drive(folder)
    shutil.copy(data / "vehicles" / "small_rover.toml", folder / "my_vehicle.toml")
    shutil.copy(folder / "my_vehicle.toml", folder / "my_robot.toml")
    shutil.copy(next((ROOT / "bumpymap" / "scan" / "data" / "models").glob("scan*.onnx")), folder / "own.onnx")
    shutil.copy(folder / "own.onnx", folder / "scan.onnx")
    for name in ("my_vehicle.json", "my_robot.json"):
        shutil.copy(data / "calibrations" / "small_rover.json", folder / name)


def _drive(folder: Path) -> None:
    """Write frames of a robot that goes ahead, over ground that is smooth on one side, and their poses."""
    (folder / "drive").mkdir()
    rng = np.random.default_rng(1)
    lines = []
    for frame in range(3):
        place = rng.uniform(-18, 18, (60_000, 2))
        z = -1.5 + rng.normal(0, 0.01, len(place)) + np.where(place[:, 1] > 0, 0.3 * rng.uniform(-1, 1, len(place)), 0)
        np.column_stack([place, z, np.zeros(len(place))]).astype("<f4").tofile(folder / "drive" / f"{frame:06d}.bin")
        lines.append(f"1 0 0 {frame} 0 1 0 0 0 0 1 0")
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
    )
    points = np.fromfile(folder / "drive" / "000000.bin", "<f4").reshape(-1, 4)[:, :3]
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA binary\n"
    )
    packed = head.encode() + np.ascontiguousarray(points).tobytes()
    (folder / "frame.pcd").write_bytes(packed)
    _bag(folder)
    _drive_log(folder)


def _drive_log(folder: Path) -> None:
    """Write the log of a robot that drives over the sample survey: one CSV, positions in every tenth row."""
    sys.path.append(str(ROOT / "tests" / "check"))
    from made_drives import MadeDrive, log_of

    log, _, _ = log_of(MadeDrive(seconds=115.0, turning=0.5, noise=1e-3, place_white=0.02, mount_deg=(1.0, -2.0, 1.0)))
    lon, lat = pyproj.Transformer.from_crs("EPSG:32632", "OGC:CRS84", always_xy=True).transform(
        512_352.0 + log.places.x, 5_403_239.0 + log.places.y
    )
    rows = [[*row, "", ""] for row in np.column_stack([log.imu.time, log.imu.rate, log.imu.acceleration]).tolist()]
    for at, *place in zip(np.searchsorted(log.imu.time, log.places.time).tolist(), lon, lat, strict=True):
        rows[at][7:] = place
    head = "time [s],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s],acc_x [m/s2],acc_y [m/s2],acc_z [m/s2],lon,lat"
    lines = [",".join(f"{value:.9f}" if value != "" else "" for value in row) for row in rows]
    (folder / "drive.csv").write_text("\n".join([head, *lines]) + "\n")


def _bag(folder: Path) -> None:
    """Write the frames and poses of the drive to a bag."""
    sys.path.append(str(ROOT / "tests" / "helpers"))
    from bags import cloud, lidar_rows, odometry, write_bag
    from scipy.spatial.transform import Rotation

    messages = []
    for number, file in enumerate(sorted((folder / "drive").iterdir())):
        points = np.fromfile(file, "<f4").reshape(-1, 4)[:, :3]
        pose = Rotation.identity(), (float(number), 0.0, 0.0)
        time_ns = 1_700_000_000_000_000_000 + number * 500_000_000
        messages.append(("/odom", time_ns, odometry(time_ns, pose, child="lidar")))
        messages.append(("/points", time_ns, cloud(lidar_rows(points), time_ns)))
    bag = write_bag(folder / "bag", messages)
    (bag / "bag.mcap").rename(folder / "drive.mcap")
    shutil.rmtree(bag)
