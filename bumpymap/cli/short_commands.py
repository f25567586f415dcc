"""Short commands: ``diff``, ``export``, ``report``, ``settings``, ``vehicle`` and ``view``."""

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import PATH, Run, grouped_option, job, settings_options
from bumpymap.cli._output import Table, option_name, print_json, print_line
from bumpymap.core import (
    BadInputError,
    DiffConfig,
    ExportFormat,
    ExportSettings,
    ReportSettings,
    UsageError,
    count_text,
    settings_schema,
    settings_template,
    share_text,
    shares_text,
)

if TYPE_CHECKING:
    from bumpymap.change import ChangeResult
    from bumpymap.layers import MapReader
    from bumpymap.rating import Vehicle
    from bumpymap.views import Export

_WITH_SETTINGS = (
    *("map", "batch", "info", "scan", "route", "check", "diff", "export", "calibrate", "report"),
    *("evaluate scans", "train textures", "train scans"),
)
"""Commands that have settings."""


def _class_names() -> tuple[str, ...]:
    from bumpymap.core import CLASS_NAMES

    return (*(f"{number} {name}" for number, name in enumerate(CLASS_NAMES)), "unknown")


def _diff_lines(result: "ChangeResult", config: DiffConfig) -> Iterator[str | Table]:
    from bumpymap.views import volumes_text

    counts = result.counts
    yield (
        f"{count_text(counts['in_both'], 'tile is', 'tiles are')} in both surveys, {counts['compared']:,} compared, "
        f"{counts['changed']:,} changed ({share_text(counts['changed'] / max(counts['compared'], 1), 1)}) in "
        f"{count_text(counts['regions'], 'place')}"
    )
    if volumes := volumes_text(counts["volumes"]):
        yield f"in these places {volumes} (80 % intervals)"
    tiles = counts["by_change"]
    shares = shares_text(list(tiles.values()), (0,), 1)
    changes = [(text, f"{count:,}", share) for (text, count), share in zip(tiles.items(), shares, strict=True)]
    yield Table(changes, ("change", "tiles", "share"))
    yield "Classes before (rows) and after (columns), tiles:"
    names = _class_names()
    rows = ((name, *(f"{tiles:,}" for tiles in row)) for name, row in zip(names, result.transitions, strict=True))
    yield Table(rows, ("before", *names))
    if counts["passable_lost"] or counts["passable_won"]:
        yield (
            f"of the changed tiles, {count_text(counts['passable_lost'], 'is', 'are')} no longer passable and "
            f"{count_text(counts['passable_won'], 'is', 'are')} now"
        )
    yield from result.notes
    if config.out is not None:
        yield f"Files in {config.out}: {', '.join(path.name for path in result.files)}"


def _diff_record(result: "ChangeResult", config: DiffConfig) -> dict[str, Any]:
    return {
        "out": None if config.out is None else str(config.out),
        "files": [path.name for path in result.files],
        "counts": dict(result.counts),
        "classes": {"names": list(_class_names()), "tiles_before_after": result.transitions.tolist()},
        "fit": dict(result.fit),
        "notes": list(result.notes),
    }


@job("diff", DiffConfig)
@click.argument("before", type=PATH, metavar="BEFORE")
@click.argument("after", type=PATH, metavar="AFTER")
def diff_command(run: Run) -> None:
    """Find what has changed between two surveys of a site, BEFORE and AFTER: folders of `bumpymap map`.

    \b
    bumpymap diff may_layers june_layers --out may_to_june
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.change import find_changes

    config = DiffConfig(**run.settings)
    with run.progress() as progress:
        result = find_changes(config, progress)
    run.show(_diff_record(result, config), _diff_lines(result, config))


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
def report_command(run: Run, layers: Path, out: Path | None, route: Path | None, overwrite: bool) -> None:
    """Make the page of a map again. LAYERS is a folder of `bumpymap map`.

    \b
    bumpymap report layers --route way
    bumpymap report layers --set page.client="City of Aix" --set page.logo=logo.png
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.views import write_report

    path = write_report(layers, out, route=route, overwrite=overwrite, page=run.settings.get("page"))
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
    wheel, belly, comfort, c_r = profile.wheel, profile.belly, profile.comfort, profile.floor.c_r_radpm
    shaken = f"up to {comfort.pitch_rate_radps:g} rad/s of pitch motion"
    shaken += f" and {comfort.a_w_mps2:g} m/s2 of weighted acceleration" if comfort.a_w_mps2 else ""
    top = f", up to {comfort.top_speed_mps:g} m/s" if comfort.top_speed_mps else ""
    floor = f"{c_r:g} rad/m ({degrees(c_r):.1f} degrees of pitch motion per metre) on even, level ground"
    if c_r == 0.0:
        floor = "none: C_r is that of the ground alone, and even ground reads as almost free"
    return [
        ("vehicle", f"{profile.name}: {profile.description}"),
        ("mass", f"{profile.mass_kg:,.6g} kg"),
        ("footprint", f"{profile.length_m:.3g} m long, {profile.width_m:.3g} m wide"),
        ("wheels", f"radius {wheel.radius_m:g} m, {profile.wheelbase_m:g} m from axle to axle"),
        ("belly", f"{belly.length_m:g} m x {belly.width_m:g} m, {belly.clearance_m:g} m above level ground"),
        ("driven at", f"{profile.speed_mps:g} m/s, on slopes up to {profile.slope_limit_deg:g} degrees"),
        ("comfort", f"{shaken}{top} (speed.tif)"),
        (
            "tips over",
            f"across {profile.tips_deg:.0f} degrees, at rest: a `side_limit` of routes is half of it or less",
        ),
        ("floor", floor),
        ("ride weight", f"{profile.ride_weight:g} m/rad: acceptable detour to avoid one radian of pitch motion"),
        ("fail weight", f"{profile.fail_weight:g} m: acceptable detour to avoid one failure"),
    ]


def _calibration(vehicle: str) -> str:
    """Return the calibration of the vehicle and how to use it, or why there is none."""
    from bumpymap.rating import find_calibration

    try:
        found: Any = find_calibration(vehicle)
    except BadInputError as error:
        return str(error)
    tiles = f"tiles of {found.tile_size:g} m with {found.pixels} pixels"
    return f"{found.id}, {tiles}; bumpymap map --vehicle {shlex.quote(vehicle)}"


_ONLY_FOR: dict[str, tuple[ExportFormat, ...]] = {
    "around": ("nav2", "gridmap", "cost"),
    "radius": ("nav2", "gridmap", "cost"),
    "datum": ("nav2", "gridmap"),
    "resolution": ("nav2", "gridmap"),
    "max_cost": ("nav2",),
    "route": ("plan",),
    "through_obstacles": ("plan",),
}
"""Formats that an option has an effect on."""
_POINTS = ("around", "datum")
_DATUM_M = 10_000.0
"""How far from the map the origin of the frame may lie, m: maps that share one frame may lie side by side."""
_LOCAL_DATUM_M = 1e6
"""The same for a map without a CRS, whose frame may begin anywhere."""


@job("export", settings_options(ExportSettings, required=("to",)), owners=(ExportSettings,))
@click.argument("layers", type=PATH, metavar="LAYERS")
@grouped_option("--out", required=True, type=PATH, metavar="DIR", help="Folder for the files.", group="Output")
@grouped_option(
    "--around", metavar="POINT", help="Tiles around lon,lat or x,y in the survey's CRS [all].", group="Input"
)
@grouped_option("--datum", metavar="POINT", help="Origin of the frame [a corner of a middle tile].", group="Output")
@grouped_option("--overwrite", is_flag=True, help="Replace an earlier export in the same format.", group="Output")
def export_command(run: Run, layers: Path, out: Path, overwrite: bool) -> None:
    """Write the map in LAYERS, the folder that `bumpymap map` wrote, in a format that robots read.

    \b
    nav2     maps with cost, keepout and speed limits for Nav2, and the parameters that load them
    gridmap  a grid_map message in a ROS 2 bag; needs the extra `ros`
    plan     a mission for QGroundControl, from a route
    cost     cost of driving with 0.2 m pixels, what stops the vehicle grown by half its width

    \b
    bumpymap export site_layers --to nav2 --out site_nav2
    bumpymap export site_layers --to plan --route route.geojson --out site_plan
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    changed, to = run.changed(), run.given["to"]
    for name, formats in _ONLY_FOR.items():
        if name in changed and to not in formats:
            raise UsageError(f"{option_name(name)} has no effect with --to {to}, only with {', '.join(formats)}")
    if "radius" in changed and "around" not in changed:
        raise UsageError("--radius has no effect without --around POINT")
    from bumpymap.layers import open_map
    from bumpymap.views import export_map

    # Settings that need no map are checked before it is opened.
    points = {name: run.given.pop(name) for name in _POINTS if name in run.given}
    settings = ExportSettings(**run.settings)
    route_map = open_map(layers)
    done = export_map(route_map, out, _placed(settings, points, route_map), overwrite=overwrite)
    files = [path.name for path in done.files]
    lines = [*_export_lines(done), f"Files in {out}: {', '.join(files)}"]
    run.show({"out": str(out), "files": files, **done.record}, lines)


def _placed(settings: ExportSettings, points: Mapping[str, str], route_map: "MapReader") -> ExportSettings:
    """Add the points, as places on the map."""
    from bumpymap.route import parse_point

    beyond = {"around": settings.radius, "datum": _DATUM_M if route_map.has_crs else _LOCAL_DATUM_M}
    places: dict[str, Any] = {
        name: tuple(parse_point(text, route_map, beyond_m=beyond[name])) for name, text in points.items()
    }
    return replace(settings, **places)


def _export_lines(done: "Export") -> Iterator[str]:
    record, place = done.record, done.record["datum"]
    area = record["area"]
    if record["to"] != "plan":
        yield (
            f"{area['east'] - area['west']:,.0f} m x {area['north'] - area['south']:,.0f} m, "
            f"cells of {record['resolution_m']:g} m, frame {record['frame']}"
        )
        lonlat = "" if place["longitude"] is None else f", lon,lat {place['longitude']:.7f},{place['latitude']:.7f}"
        yield f"origin of the frame: x,y {place['x']:.3f},{place['y']:.3f} in the survey's CRS{lonlat}"
    if cells := record.get("cells"):
        whole = sum(cells.values())
        yield ", ".join(f"{count:,} {name} ({share_text(count / whole)})" for name, count in cells.items()) + " cells"
        cost = record["cost"]
        yield (
            f"cost per metre: 1 is value 0, {cost['value_98']:.3f} is value 98, in steps of "
            f"{(cost['value_98'] - 1.0) / 98:.3f}; the highest of a free cell is {cost['highest']:.3f}"
        )
    if layers := record.get("layer_names"):
        yield f"grid_map on {record['topic']}: {', '.join(layers)}"
    if plan := record.get("plan"):
        yield f"{plan['waypoints']:,} waypoints at {plan['speed_m_per_s']:g} m/s"
