"""Commands of a few lines: ``compile``, ``demo``, ``report``, ``settings``, ``vehicle`` and ``view``."""

import shlex
import shutil
import sys
from itertools import chain
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import PATH, Run, grouped_option, job
from bumpymap.cli._text import print_json, print_line
from bumpymap.core import (
    BadInputError,
    MapConfig,
    OutputError,
    ReportSettings,
    UsageError,
    atomic,
    settings_schema,
    settings_template,
)

if TYPE_CHECKING:
    from bumpymap.rating import Vehicle

_SAMPLE = Path("sample_data") / "quarry.laz"
"""In an installed package it lies inside, in the sources beside it."""
_WITH_SETTINGS = (
    *("map", "batch", "info", "scan", "route", "check", "diff", "export", "calibrate", "report"),
    *("evaluate scans", "train textures", "train scans"),
)
"""Commands that have settings."""


@job("compile")
def compile_command(run: Run) -> None:
    """Compile the numerical kernels, and the templates of pages, now and once, not in the first run that needs them."""
    from bumpymap.views import compile_pages
    from bumpytiles import compile_packages

    with run.progress():
        kept = compile_packages("bumpymap", "bumpytiles")
        compile_pages()
    if not kept:
        folder = "a folder of your own that nobody else can write to"
        raise OutputError(f"the compiled kernels cannot be kept. Set NUMBA_CACHE_DIR to {folder}")


@job("demo")
@grouped_option(
    "--out",
    group="Output",
    default="demo_out",
    type=PATH,
    metavar="DIR",
    show_default=True,
    help="Folder for the survey and the layers.",
)
def demo_command(run: Run, out: Path) -> None:
    """Map a synthetic quarry as an example."""
    from bumpymap.cli._summary import map_lines, map_record
    from bumpymap.layers import MapFile
    from bumpymap.survey import map_surveys

    survey = _copy_sample(out / "survey" / _SAMPLE.name)
    config = MapConfig(surveys=(survey,), out=out / "layers", overwrite=True)
    with run.progress() as progress:
        result = map_surveys(config, progress)
    look = [f"Open {config.out / MapFile.PROJECT} in QGIS, or the layers in any other GIS."]
    look += [f"Open {config.out / MapFile.REPORT} in a browser."]
    look += [f"Map a survey of yours: {_called()} map SURVEY.laz --out DIR"]
    run.show(map_record(result, config), chain([f"Mapped {survey}"], map_lines(result, config), look))


def _called() -> str:
    """Return how a shell in this folder calls this command."""
    command = sys.argv[0]
    if Path(command).stem == "__main__":
        return f"{shlex.quote(sys.executable)} -m bumpymap"
    on_path = shutil.which("bumpymap")
    return "bumpymap" if on_path and Path(on_path).absolute() == Path(command).absolute() else shlex.quote(command)


def _copy_sample(survey: Path) -> Path:
    """Copy the sample survey and return the copy."""
    package = Path(__file__).resolve().parents[1]
    found = [path for path in (package / _SAMPLE, package.parent / _SAMPLE) if path.is_file()]
    if not found:
        raise BadInputError(f"{package / _SAMPLE} is missing: install bumpymap again")
    try:
        survey.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the survey to {survey.parent}: {error}. Choose another --out") from error
    with atomic(survey) as beside:
        shutil.copyfile(found[0], beside)
    return survey


_ROUTE = grouped_option(
    "--route",
    group="Input",
    type=PATH,
    metavar="PATH",
    help="Draw ways: the folder of `bumpymap route`, or route.geojson.",
)


@job("report", owners=(ReportSettings,))
@click.argument("layers", type=PATH, metavar="LAYERS")
@grouped_option("--out", group="Output", type=PATH, metavar="FILE", help="File to write [LAYERS/report.html].")
@_ROUTE
@grouped_option("--overwrite", group="Output", is_flag=True, help="Replace FILE if it exists.")
def report_command(run: Run, layers: Path, **settings: Any) -> None:
    """Make the page of a map again. LAYERS is a folder of `bumpymap map`.

    For a folder of `bumpymap diff`, the page of what has changed is made again.

    \b
    bumpymap report layers --route way
    bumpymap report layers --set page.client="City of Aix" --set page.logo=logo.png
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.views import write_report

    path = write_report(layers, page=run.settings.get("page"), **settings)
    run.show({"report": str(path), "bytes": path.stat().st_size}, [f"Open {path} in a browser."])


@job("view", owners=())
@click.argument("layers", type=PATH, metavar="LAYERS")
@grouped_option("--out", group="Output", type=PATH, metavar="FILE", help="Write a picture (PNG), without a screen.")
@_ROUTE
def view_command(run: Run, layers: Path, out: Path | None, route: Path | None) -> None:
    """Look at a map in three dimensions. LAYERS is a folder of `bumpymap map`.

    The relief has the colours of the map, obstacles are points, and ways are lines. A window opens, unless --out is
    given.

    \b
    bumpymap view layers --route way
    bumpymap view layers --out view.png
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.views import show_in_space

    show_in_space(layers, out, route)
    run.show({"picture": None if out is None else str(out)}, [] if out is None else [f"Open {out}."])


@click.command("settings")
@click.argument("words", nargs=-1, required=True, metavar="COMMAND")
@click.option(
    "--schema", is_flag=True, help="Print a JSON schema of the file, for editors that complete and check TOML."
)
def settings_command(words: tuple[str, ...], schema: bool) -> None:
    """Print a settings file of COMMAND: every setting with its description and default, commented out.

    Remove the # before a line to set it, and give the file with --config. One setting alone is given with --set
    KEY=VALUE, that of a table with --set TABLE.KEY=VALUE. An editor that knows TOML (Taplo, Even Better TOML) finds the
    schema by a first line such as "#:schema ./map.schema.json".

    \b
    bumpymap settings map > map.toml
    bumpymap settings map --schema > map.schema.json
    bumpymap map site.laz --out layers --config map.toml
    bumpymap map site.laz --out layers --set pixels=21 --set csf.rigidness=2
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    name = " ".join(words)
    if name not in _WITH_SETTINGS:
        raise UsageError(f"{name} is no command with settings; these are {', '.join(_WITH_SETTINGS)}")
    context = click.get_current_context()
    command: Any = context.find_root().command
    for word in words:
        command = command.get_command(context, word)
    if schema:
        print_json(settings_schema(command.owners), indent=2)
        return
    print_line(f"# Settings of `bumpymap {name}`, with their defaults. Remove the # before a line to set it, and give")
    print_line("# the file with --config. Options override it; paths are relative to this file.")
    print_line()
    for line in settings_template(command.owners).splitlines():
        print_line(line)


@click.group("vehicle")
def vehicle_command() -> None:
    """List, create and check vehicle profiles.

    \b
    bumpymap vehicle list
    bumpymap vehicle new my_vehicle
    bumpymap vehicle check my_vehicle.toml
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped


@vehicle_command.command("list")
def list_command() -> None:
    """List the included vehicles."""
    from bumpymap.rating import Vehicle, shipped_profiles

    for name in shipped_profiles():
        print_line(f"{name:12s} {Vehicle.load(name).description}")


@vehicle_command.command("check")
@click.argument("vehicle", metavar="NAME_OR_FILE")
def check_command(vehicle: str) -> None:
    """Report the errors in a profile, or a summary of the vehicle and what was estimated.

    NAME_OR_FILE is a TOML file or the name of an included vehicle. The exit code is 3 if the profile has errors.
    """
    from bumpymap.rating import Vehicle, estimated_values

    profile = Vehicle.load(vehicle)
    for name, value in (*_meaning(profile), ("calibration", _calibration(vehicle))):
        print_line(f"{name:13s} {value}")  # one line each, so that a command in it can be copied
    estimates = estimated_values(vehicle)
    if estimates:
        print_line("estimated from mass, size and suspension; each may be set in the profile:")
    for name, value in estimates.items():
        print_line(f"  {name} = {value}")


@vehicle_command.command("new")
@click.argument("name", metavar="NAME")
@click.option("--out", type=PATH, metavar="FILE", help="File to write [default: NAME.toml].")
@click.option("--like", metavar="NAME_OR_FILE", help="Copy all values of this vehicle instead.")
def new_command(name: str, out: Path | None, like: str | None) -> None:
    """Write a vehicle profile to fill in: ten values, with units and ranges; the rest is estimated from them.

    NAME is the name of the vehicle.
    """
    from bumpymap.rating import write_profile_template

    path = out or Path(f"{name}.toml")
    write_profile_template(name, path, like)
    what = "change what differs" if like else "fill it in"
    print_line(f"wrote {path}: {what}, then: bumpymap vehicle check {shlex.quote(str(path))}")


def _meaning(profile: "Vehicle") -> list[tuple[str, str]]:
    wheel, belly = profile.wheel, profile.belly
    return [
        ("vehicle", f"{profile.name}: {profile.description}"),
        ("mass", f"{profile.mass_kg:,.6g} kg"),
        ("footprint", f"{profile.length_m:.3g} m long, {profile.width_m:.3g} m wide"),
        ("wheels", f"radius {wheel.radius_m:g} m, {profile.wheelbase_m:g} m from axle to axle"),
        ("belly", f"{belly.length_m:g} m x {belly.width_m:g} m, {belly.clearance_m:g} m above level ground"),
        ("driven at", f"{profile.speed_mps:g} m/s, on slopes up to {profile.slope_limit_deg:g} degrees"),
        ("comfort", f"{_comfort(profile.comfort)} (speed.tif)"),
        (
            "tips over",
            f"across {profile.tips_deg:.0f} degrees, at rest: a `side_limit` of routes is half of it or less",
        ),
        ("floor", _floor(profile.floor.c_r_radpm)),
        ("ride weight", f"{profile.ride_weight:g} m/rad: acceptable detour to avoid one radian of pitch motion"),
        ("fail weight", f"{profile.fail_weight:g} m: acceptable detour to avoid one failure"),
    ]


def _comfort(limits: Any) -> str:
    shaken = f"up to {limits.pitch_rate_radps:g} rad/s of pitch motion"
    shaken += f" and {limits.a_w_mps2:g} m/s2 of weighted acceleration" if limits.a_w_mps2 else ""
    return f"{shaken}, up to {limits.top_speed_mps:g} m/s" if limits.top_speed_mps else shaken


def _floor(c_r: float) -> str:
    if c_r == 0.0:
        return "none: C_r is that of the ground alone, and even ground reads as almost free"
    return f"{c_r:g} rad/m ({degrees(c_r):.1f} degrees of pitch motion per metre) on even, level ground"


def _calibration(vehicle: str) -> str:
    """Return the calibration of the vehicle and how to use it, or why there is none."""
    from bumpymap.rating import find_calibration

    try:
        found: Any = find_calibration(vehicle)
    except BadInputError as error:
        return str(error)
    tiles = f"tiles of {found.tile_size:g} m with {found.pixels} pixels"
    return f"{found.id}, {tiles}; bumpymap map --vehicle {shlex.quote(vehicle)}"
