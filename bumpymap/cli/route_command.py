"""``bumpymap route``: the cheapest way over mapped ground."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import PATH, Run, job, settings_options
from bumpymap.cli._output import Table, cell
from bumpymap.route import CostSettings, RouteConfig

if TYPE_CHECKING:
    from bumpymap.core import Route
    from bumpymap.route import RouteResult

_TIGHT_DEG = 10.0
"""Tight turns from which on they are mentioned."""
_TITLES = (
    "way",
    "length (m)",
    "detour",
    "cost (m)",
    "c_r (rad/m)",
    "of the line",
    "worst c_r",
    "arrives",
    "unknown (m)",
    "up/down (m)",
    "time",
)


def _lines(result: "RouteResult", config: RouteConfig) -> Iterator[str | Table]:
    yield Table([_row(result.route)], _TITLES)
    yield from result.notes
    yield from _remarks(result.route)
    if config.out is not None:
        folder = result.files[0].parent if result.files else config.out
        yield f"Files in {folder}: {', '.join(path.name for path in result.files)}"


def _row(route: "Route") -> tuple[str, ...]:
    from bumpymap.core import chance_text

    found = route.figures
    minutes, seconds = divmod(round(found.seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (
        route.name,
        f"{found.length_m:,.0f}",
        f"{found.detour:.2f}",
        f"{found.cost_m:,.0f}",
        cell(found.c_r_mean, ".3f"),
        cell(found.c_r_line, ".3f"),
        cell(found.c_r_max, ".3f"),
        chance_text(found.p_arrives),
        f"{found.unknown_m:,.0f}",
        f"{found.climb_m:.0f}/{found.descent_m:.0f}",
        f"{hours}:{minutes:02}:{seconds:02} h" if hours else f"{minutes}:{seconds:02} min",
    )


def _remarks(route: "Route") -> Iterator[str]:
    found = route.figures
    if found.unknown_m > 0:
        yield f"{found.unknown_m:,.0f} m lie on unknown ground, whose ride and risk are not in the figures"
    if found.obstacle_m > 0:
        yield (
            f"the way touches obstacles on {found.obstacle_m:,.1f} m: there is no way between them; arrives counts "
            "each of these metres as failing every second time"
        )
    if found.tight_turns_deg >= _TIGHT_DEG:
        yield (
            f"the way turns by {found.tight_turns_deg:,.0f} degrees in all close to what stops the vehicle, where its "
            "corners may touch; arrives counts each degree as failing once in a hundred times"
        )
    if route.straight and route.straight.words:
        yield route.straight.words
    rest = "and failures on different metres are independent; errors of neighbouring tiles go together"
    yield f"arrives: {found.seen.condition} {rest}. {found.seen.sentence}".rstrip()


def _record(result: "RouteResult", config: RouteConfig) -> dict[str, Any]:
    from bumpymap.layers import route_properties

    return {
        "out": None if config.out is None else str(config.out),
        "files": [path.name for path in result.files],
        "routes": [route_properties(result.route)],
        "notes": list(result.notes),
    }


@job("route", RouteConfig, settings_options(CostSettings))
@click.argument("layers", type=PATH, metavar="LAYERS", required=False)
def command(run: Run) -> None:
    """Find the cheapest way over the ground that `bumpymap map` wrote to LAYERS.

    \b
    bumpymap route layers --from 11.5001,48.2003 --to 11.5034,48.2011 --out way
    bumpymap route layers --from 434100,5411200 --to 434300,5411200 --by time --return
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.route import plan_routes

    settings = run.settings
    own = {name: settings.pop(name) for name in CostSettings.__dataclass_fields__ if name in settings}
    cost = replace(settings.pop("cost", CostSettings()), **own)
    config = RouteConfig(settings.pop("layers", None), cost=cost, **settings)
    with run.progress() as progress:
        result = plan_routes(config, progress)
    run.show(_record(result, config), _lines(result, config))
