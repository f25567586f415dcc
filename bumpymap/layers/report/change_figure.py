"""The map of a page of changes: what stands there before the script runs, its controls and legends."""

from bumpymap.core import CHANGE_KINDS
from bumpymap.layers.colours import CHANGE_COLOURS
from bumpymap.layers.report.change_site import ChangeSite
from bumpymap.layers.report.charts import swatch
from bumpymap.layers.report.codes import NOT_KNOWN, ByteGrid
from bumpymap.layers.report.map_figure import controls_of, scale_of, stage_of
from bumpymap.layers.report.markup import Html, tag

__all__ = ["DIFFERENCE_RAMP", "change_figure"]

DIFFERENCE_RAMP = (
    *("#053061", "#2166ac", "#4393c3", "#92c5de", "#f7f7f7"),
    *("#f4a582", "#d6604d", "#b2182b", "#67001f"),
)
"""Colours from the least over none, white, to the most of a difference."""
_GREY = (178, 178, 178)
_NAMES = {"d_height": "Difference of height", "d_c_r": "Difference of ride cost C_r"}


def change_figure(site: ChangeSite, title: str) -> Html:
    """Return the figure of the map; the script fills it."""
    grids = [grid for grid in site.grids if (grid.codes != NOT_KNOWN).any()]
    names = [("changed", "What has changed"), *((grid.key, _NAMES[grid.key]) for grid in grids)]
    radios = [
        tag("label", tag("input", type="radio", name="layer-0", value=key, checked=key == "changed"), f" {name}")
        for key, name in names
    ]
    box = tag("input", type="checkbox", value="places", checked=True)
    boxes = [tag("label", box, " Numbers of the places")] if site.places else []
    legends = [_legend("changed"), *(_legend(grid.key, grid) for grid in grids)]
    return tag(
        "figure",
        controls_of(radios, boxes),
        stage_of(title, site.still, "what has changed", 0),
        tag("div", *legends, class_="legends"),
        tag("p", _notes(site, grids), class_="note"),
        class_="map",
        data_map="0",
    )


def _legend(key: str, grid: ByteGrid | None = None) -> Html:
    if grid is None:
        items = [tag("li", swatch(CHANGE_COLOURS[code]), f" {name}") for code, name in enumerate(CHANGE_KINDS)]
        last = " not compared: may have changed or not"
    else:
        items = [scale_of(grid, DIFFERENCE_RAMP, ("blue", "red"))]
        last = " not compared, or not known in one survey"
    items.append(tag("li", swatch(_GREY, hatched=True), last))
    return tag("ul", *items, class_="legend", data_of=key, hidden=grid is not None)


def _notes(site: ChangeSite, grids: list[ByteGrid]) -> str:
    if site.step > 1:
        size = (
            f"One pixel of the map is {site.metres:g} m, {site.step} x {site.step} tiles of {site.tile_size:g} m. It "
            "shows a change if one of its tiles has changed; else it counts as not compared if one of them was not. "
            "Its differences are those farthest from 0."
        )
    else:
        size = f"One square of the map is a tile of {site.tile_size:g} m."
    text = f"{size} Differences are those of all tiles, changed or not: most are noise. "
    text += "Colours go with the square root of a difference, so that small ones are seen."
    left = site.record["counts"]["regions"] - len(site.places)
    if left:
        text += f" The {len(site.places)} largest places are framed, {left:,} are not."
    rounding = "; ".join(grid.rounding for grid in grids)
    return f"{text} Values are rounded for this page ({rounding}); change.tif holds them in full." if grids else size
