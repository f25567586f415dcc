"""Every command of README.md and the pages runs, or its rule says why it does not.

Each page has a folder of its own with the files that its commands name.
"""

import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import laspy
import numpy as np
import pytest
import rasterio
from bags import cloud, lidar_rows, odometry, write_bag
from made_drives import MadeDrive, log_of, write_table
from made_frames import churned_field, write_bin
from pypcd4 import Encoding, PointCloud
from rasterio.windows import Window
from scipy.spatial.transform import Rotation
from small_surveys import run, write_las

from bumpymap.cli import main

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
FILES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs" / "pages").glob("*.md")))
PROGRAMS = (
    "bumpymap", "chmod", "dask", "grass", "make", "openssl", "pip", "python", "sudo",
)  # fmt: skip
SHELL = {"", "bash", "console", "sh", "shell"}
CRS = "EPSG:32614"


RULES = {
    r"^(\S*python -m )?pip install": "downloads; the extras that it names are held to pyproject.toml",
    r"^\. \.venv/bin/activate$": "changes the shell; `make demo` makes the environment",
    r"^make ": ".ci/run and .ci/fresh-machine run it; the target is held to the Makefile",
    r"^sudo apt-get ": "changes the system; .ci/run installs the same packages",
    r"^dask |scheduler=|^export DASK_": "takes a cluster: tests/survey/test_engine.py has one",
    r"^(openssl|chmod) ": "makes keys: tests/survey/test_engine.py runs them",
    r"^grass ": "takes GRASS",
    r"^(xdg-open|qgis) ": "opens a window",
    r"^python docs/licences/": "writes a page anew; a test of its own holds it",
    r"^python tests/tools/faults\.py": "runs tests for every fault, for an hour",
    r"^python tests/tools/tables\.py": "tests/lab/test_tables.py runs it",
    r"^python tests/tools/speed\.py": "measures for a minute or more, and means little beside other tests",
    r"^python tests/tools/driven\.py": "an hour of drives",
    r"^bumpymap settings |--config map\.toml": "writes a file that is to be edited",
    r"^python tests/fuzz/": "an hour",
    r"^python docs/pictures/": "draws over a picture of the pages; takes minutes",
    r"^bumpymap vehicle new ": "writes the profile that later commands want filled in",
    r"^bumpymap calibrate ": "hours of drives",
    r"^\S*python \.ci/refresh_constraints\.py": "asks the package index for every file",
    r"^python docs/drives/": "takes a data set; tests/docs/test_pages.py runs it where that is",
    r"--refit ": "takes hundreds of metres of drives: tests/cli/test_lab_commands.py makes them",
    r"--calibration small\.json": "takes a calibration for such tiles: hours of drives",
    r"^python tests/benchmarks/": "measures for minutes or hours, some beside other programs; tests run parts",
    r"^python docs/models/|model=rellis\.onnx": "takes open3d, a data set or minutes",
    r"^bumpymap (evaluate|train) ": "hours of drives or learning; tests/lab runs short ones",
}
"""What does not simply run in the suite, as patterns of commands, and why."""


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


def filled(command: str) -> list[str]:
    """Put files that are there in the place of words in capitals."""
    words = {"SURVEY": "site.laz", "DIR": "dir", "EPSG:CODE": CRS, "FOLDER": "folder", "YOUR_SURVEY.laz": "site.laz"}
    return [words.get(word, word) for word in shlex.split(command)]


def furnish(folder: Path) -> None:
    """Put the files there that commands name: small surveys, frames of a drive, a vehicle of one's own."""
    data, samples = ROOT / "bumpymap" / "rating" / "data", ROOT / "sample_data"
    run("map", samples / "quarry.laz", "--out", folder / "demo_out" / "layers", "--quiet")
    (folder / "sample_data").mkdir()
    for name in ("quarry.laz", "quarry_drive_imu.csv", "quarry_drive_gnss.csv"):
        shutil.copy(samples / name, folder / "sample_data")
    survey = laspy.read(samples / "quarry.laz")
    x, y, z = (np.asarray(axis) for axis in (survey.x, survey.y, survey.z))
    for name, east in (("site.laz", 0.0), ("flights/1.laz", 0.0), ("flights/2.laz", 12.0)):
        near = (abs(x - np.median(x) - east) < 6) & (abs(y - np.median(y)) < 9)
        classes = {"classification": np.asarray(survey.classification)[near]}
        write_las(folder / name, x[near], y[near], z[near], crs=CRS, offset=survey.header.offsets, **classes)
    for name in ("survey.laz", "may.laz", "june.laz"):
        shutil.copy(folder / "site.laz", folder / name)
    odm = folder / "odm_project"
    for name in ("odm_georeferencing/odm_georeferenced_model.laz", "odm_orthophoto/odm_orthophoto.tif"):
        (odm / name).parent.mkdir(parents=True)
    shutil.copy(folder / "site.laz", odm / "odm_georeferencing" / "odm_georeferenced_model.laz")
    kinds = {"ortho": ("odm_project/odm_orthophoto/odm_orthophoto.tif", "ortho.tif"), "dsm": ("dsm.tif", "dtm.tif")}
    for kind, names in kinds.items():
        shutil.copy(samples / f"quarry_{kind}.tif", folder / "sample_data")
        with rasterio.open(samples / f"quarry_{kind}.tif") as raster:
            values = raster.read(window=Window(0, 0, raster.width // 2, raster.height // 2))
            about = raster.profile | {"crs": CRS, "width": values.shape[2], "height": values.shape[1]}  # as site.laz
        for name in names:
            with rasterio.open(folder / name, "w", **about) as raster:
                raster.write(values)
    local = np.column_stack([x, y, z])[near] - (np.median(x), np.median(y), np.median(z))
    PointCloud.from_xyz_points(local.astype(np.float32)).save(str(folder / "slam.pcd"), Encoding.BINARY)
    _drive(folder)
    for name in ("my_vehicle", "my_robot"):
        shutil.copy(data / "vehicles" / "small_rover.toml", folder / f"{name}.toml")
        shutil.copy(data / "calibrations" / "small_rover.json", folder / f"{name}.json")
    for name in ("own.onnx", "scan.onnx"):
        shutil.copy(next((ROOT / "bumpymap" / "scan" / "data" / "models").glob("scan*.onnx")), folder / name)


def _drive(folder: Path) -> None:
    """Write frames of a robot that goes ahead, over ground that is smooth on one side, and their poses."""
    for frame in range(3):
        write_bin(folder / "drive" / f"{frame:06d}.bin", churned_field(frame))
    (folder / "poses.txt").write_text("".join(f"1 0 0 {frame} 0 1 0 0 0 0 1 0\n" for frame in range(3)))
    points = np.fromfile(folder / "drive" / "000000.bin", "<f4").reshape(-1, 4)[:, :3]
    PointCloud.from_xyz_points(points).save(str(folder / "frame.pcd"), Encoding.BINARY)
    _bag(folder)
    log, _, _ = log_of(MadeDrive(seconds=38.0, turning=0.5, noise=1e-3, place_white=0.02, mount_deg=(1.0, -2.0, 1.0)))
    write_table(folder / "drive.csv", log, (512_352.0, 5_403_239.0))


def _bag(folder: Path) -> None:
    """Write the frames and poses of the drive to a bag."""
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


SHOWN = [(page.name, command) for page in FILES for command in shown(page)]
RUN = [(page, command) for page, command in SHOWN if not any(re.search(rule, command) for rule in RULES)]
OF_README = {command for page, command in RUN if page == "README.md"}
PAGES = ["README.md", *sorted({page for page, command in RUN if command not in OF_README} - {"README.md"})]


@pytest.fixture(scope="module")
def furnished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("furnished")
    furnish(folder)
    return folder


@pytest.mark.usefixtures("batches_here")
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_run_one_after_the_other(page, furnished, tmp_path, monkeypatch):
    folder = shutil.copytree(furnished, tmp_path / "page")
    monkeypatch.chdir(folder)
    outputs = []
    for command in (command for where, command in RUN if where == page):
        program, *words = filled(command)
        assert program == "bumpymap", f"no rule says what to do with: {command}"
        done = run(*words, code=0)
        outputs.append(done.output)
    if page == "routes.md":  # it shows what its second command prints
        assert said(shown_output(page)) == said(outputs[1])


def shown_output(page: str) -> str:
    """Give the first block of plain text of a page."""
    return re.search(r"(?ms)^```text\n(.*?)^```", (ROOT / "docs" / "pages" / page).read_text(encoding="utf-8"))[1]


def said(text: str) -> str:
    """Give a text without the time that a run took and how the command is called here, and its lines joined."""
    return " ".join(re.sub(r"(?m), [\d.]+ s$|(?<=yours: ).* map", "", text).split())


def test_the_first_page_shows_what_the_demo_prints(furnished, monkeypatch):
    monkeypatch.chdir(furnished)
    assert said(shown_output("first-map.md")) == said(run("demo", "--out", "demo_out").output)


OWN = [(page, line) for page, line in SHOWN if line.startswith("bumpymap ") and not line.startswith("bumpymap --")]


@pytest.mark.parametrize(("page", "line"), OWN)
def test_every_command_that_is_shown_can_be_given(page, line):
    _, name, *words = shlex.split(re.sub(r" > \S+", "", line))
    given = main.get_command(click.Context(main), name)
    if isinstance(given, click.Group):
        given = given.commands[words.pop(0)]
    given.make_context(name, words)


def test_what_does_not_run_names_extras_targets_and_scripts_that_are_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    targets = re.findall(r"(?m)^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"))
    for page, command in SHOWN:
        for extras in re.findall(r"'\.\[([^\]]*)\]'", command):
            assert set(extras.split(",")) <= set(project["optional-dependencies"]), f"{page}: {command}"
        words = command.split()
        if words[0] == "make":
            assert {word for word in words[1:] if "=" not in word} <= set(targets), f"{page}: {command}"
        if words[0].endswith("python") and words[1].endswith(".py"):
            assert (ROOT / words[1]).is_file(), f"{page}: {command}"
