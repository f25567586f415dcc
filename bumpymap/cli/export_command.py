"""``bumpymap export``: write a map for robots."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import PATH, Run, grouped_option, job, settings_options
from bumpymap.cli._text import option_name
from bumpymap.core import ExportFormat, ExportSettings, UsageError, share_text

if TYPE_CHECKING:
    from bumpymap.layers import MapReader
    from bumpymap.views import Export

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
def command(run: Run, layers: Path, out: Path, overwrite: bool) -> None:
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
    _refuse_idle(run.changed(), run.given["to"])
    from bumpymap.layers import open_map
    from bumpymap.views import export_map

    # Settings that need no map are checked before it is opened.
    points = {name: run.given.pop(name) for name in _POINTS if name in run.given}
    settings = ExportSettings(**run.settings)
    route_map = open_map(layers)
    done = export_map(route_map, out, _placed(settings, points, route_map), overwrite=overwrite)
    files = [path.name for path in done.files]
    run.show({"out": str(out), "files": files, **done.record}, [*_summary(done), f"Files in {out}: {', '.join(files)}"])


def _refuse_idle(given: Mapping[str, Any], to: str) -> None:
    """Raise UsageError for options that would have no effect."""
    for name, formats in _ONLY_FOR.items():
        if name in given and to not in formats:
            raise UsageError(f"{option_name(name)} has no effect with --to {to}, only with {', '.join(formats)}")
    if "radius" in given and "around" not in given:
        raise UsageError("--radius has no effect without --around POINT")


def _placed(settings: ExportSettings, points: Mapping[str, str], route_map: "MapReader") -> ExportSettings:
    """Add the points, as places on the map."""
    from bumpymap.route import parse_point

    beyond = {"around": settings.radius, "datum": _DATUM_M if route_map.has_crs else _LOCAL_DATUM_M}
    places: dict[str, Any] = {
        name: tuple(parse_point(text, route_map, beyond_m=beyond[name])) for name, text in points.items()
    }
    return replace(settings, **places)


def _summary(done: "Export") -> Iterator[str]:
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
