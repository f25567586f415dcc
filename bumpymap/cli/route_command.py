"""``bumpymap route``: the cheapest way over mapped ground, and what can be reached."""

from typing import Any

import click

from bumpymap.cli._events import set_up_logging
from bumpymap.cli._options import given_options, output_options
from bumpymap.cli._progress import show_progress
from bumpymap.cli._terminal import PATH, NumberList
from bumpymap.core import UsageError

__all__ = ["command"]

_OF_COST = ("risk", "robust", "unknown", "avoid", "only", "allow_outside", "through_obstacles")


@click.command("route")
@click.argument("layers", nargs=-1, type=PATH, metavar="LAYERS...")
@click.option("--from", "start", metavar="POINT", help="Start: lon,lat or x,y in the survey's CRS.")
@click.option("--to", "goal", metavar="POINT", help="Goal; without one, map what can be reached.")
@click.option("--via", multiple=True, metavar="POINT", help="Point to pass on the way; may be given several times.")
@click.option("--points", type=PATH, metavar="FILE", help="Start, points to pass and goal (GeoJSON, GPX, CSV).")
@click.option("--visit", is_flag=True, help="Pass the points in the best order.")
@click.option("--return", "round_trip", is_flag=True, help="Return to the start.")
@click.option("--alternatives", type=int, metavar="N", help="Number of ways to propose [default: 1].")
@click.option("--compare", type=PATH, multiple=True, metavar="DIR", help="Layers of the site for another vehicle.")
@click.option("--risk", type=float, metavar="M", help="Detour that one certain failure is worth [default: profile].")
@click.option("--robust", is_flag=True, help="Plan on the upper end of the interval of c_r.")
@click.option("--unknown", type=float, metavar="COST", help="Cross unknown ground at this cost per metre.")
@click.option("--through-obstacles", is_flag=True, help="Touch obstacles where there is no other way.")
@click.option("--snap", type=float, metavar="M", help="Move points on closed ground by up to M [default: 0].")
@click.option("--avoid", type=PATH, metavar="FILE", help="Polygons that are not entered.")
@click.option("--only", type=PATH, metavar="FILE", help="Polygons that are not left.")
@click.option("--allow-outside", is_flag=True, help="It is no error if no polygon lies on the map.")
@click.option("--isochrones", type=NumberList(), metavar="LIST", help="Outlines of what is reached in so many minutes.")
@click.option("--isocosts", type=NumberList(), metavar="LIST", help="Outlines of what is reached at these costs, m.")
@click.option("--out", type=PATH, metavar="PATH", help="Folder, or a .geojson, .gpx, .csv or .png file.")
@click.option("--overwrite", is_flag=True, help="Replace the files of an earlier run.")
@click.option("--memory", metavar="SIZE", help="Memory limit of the search [default: auto, a quarter of what is free].")
@output_options()
def command(*, quiet: bool, log_json: bool, **given: Any) -> None:
    """Find the cheapest way over the ground that `bumpymap map` wrote to LAYERS.

    \b
    bumpymap route layers --from 11.5001,48.2003 --to 11.5034,48.2011 --out way
    bumpymap route layers --from 434100,5411200 --out reach --isochrones 1,2,5
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    set_up_logging(as_json=log_json)
    settings = given_options(given)
    if not settings.get("layers"):
        raise UsageError("no layers given: name the folder that `bumpymap map` wrote")
    from bumpymap.route import CostSettings, RouteConfig, plan_routes

    cost = CostSettings(**{name: settings.pop(name) for name in _OF_COST if name in settings})
    config = RouteConfig(cost=cost, **settings)
    with show_progress(quiet=quiet, as_json=log_json) as progress:
        result = plan_routes(config, progress)
    if not quiet:
        from bumpymap.cli._route_summary import show

        show(result, config, as_json=log_json)
