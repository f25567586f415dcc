"""Make bumpymap/views/page/data/countries.npz anew: python docs/models/countries.py countries-50m.json.

The file is that of the npm package world-atlas 2.0.2 (`npm pack world-atlas`): Natural Earth 4.1, 1:50m, public domain.
"""

import json
import sys
from pathlib import Path

import numpy as np
import shapely

import bumpymap

STEP = 0.02
"""Degrees."""
LEAST, SHARE, MOST = 6.0, 0.006, 0.3
"""A line may be off by this share of the smallest land that it bounds, which counts as ``LEAST`` degrees; by ``MOST``
at most."""
TINY = 0.2
"""Smaller islands, in degrees, are left out, unless a country has no larger land."""
OUT = Path(bumpymap.__file__).parent / "views" / "page" / "data" / "countries.npz"
SOURCE = "Natural Earth 4.1, Admin 0 countries 1:50m, public domain (naturalearthdata.com), simplified"


def main(path: Path) -> None:
    """Simplify the arcs, so that neighbours keep one border, and write the outer ring of each land."""
    atlas = json.loads(path.read_text(encoding="utf-8"))
    scale, shift = (np.array(atlas["transform"][name]) for name in ("scale", "translate"))
    arcs = [np.cumsum(arc, axis=0) * scale + shift for arc in atlas["arcs"]]
    lands = []
    for number, country in enumerate(atlas["objects"]["countries"]["geometries"]):
        parts = [country["arcs"]] if country["type"] == "Polygon" else country.get("arcs", ())
        # the highest ring of a part is its outer one: the first one of Antarctica is the pole
        lands += [(number, max(part, key=lambda land: np.ptp(ring(arcs, land)[:, 1]))) for part in parts]
    sizes = [np.ptp(ring(arcs, land), axis=0).max() for _, land in lands]
    off, largest = np.full(len(arcs), MOST), {}
    for (number, land), size in zip(lands, sizes, strict=True):
        largest[number] = max(size, largest.get(number, 0.0))
        for at in land:
            off[max(at, ~at)] = min(off[max(at, ~at)], SHARE * max(size, LEAST))
    lines = [shapely.LineString(arc).simplify(most) for arc, most in zip(arcs, off, strict=True)]
    arcs = [np.rint(shapely.get_coordinates(line) / STEP).astype(int) for line in lines]
    rings = [
        corners
        for (number, land), size in zip(lands, sizes, strict=True)
        if (size >= TINY or size == largest[number]) and len(corners := ring(arcs, land)) > 2
    ]
    np.savez_compressed(
        OUT,
        # one after the other, each as its steps from the one before: small numbers pack well
        steps=np.ascontiguousarray(np.diff(np.concatenate(rings), axis=0, prepend=0).T.astype("<i2")),
        starts=np.cumsum([0, *map(len, rings[:-1])]).astype("<i4"),
        step_deg=STEP,
        source=SOURCE,
    )
    print(f"{len(rings):,} lands, {sum(map(len, rings)):,} corners, {OUT.stat().st_size:,} bytes")


def ring(arcs: list[np.ndarray], land: list[int]) -> np.ndarray:
    """Join the arcs of a land; ``~n`` is arc n backwards. Longitudes run on across the antimeridian."""
    corners = np.concatenate([arcs[at][:-1] if at >= 0 else arcs[~at][:0:-1] for at in land])
    turn = 360 if corners.dtype.kind == "f" else round(360 / STEP)
    lon = np.unwrap(corners[:, 0], period=turn)
    lon -= turn * np.rint((lon.min() + lon.max()) / 2 / turn).astype(lon.dtype)
    found = np.column_stack([lon, corners[:, 1]])
    if abs(lon[-1] - lon[0]) > turn / 2:  # around the pole, over which it is closed
        found = np.append(found, [[lon[-1], -turn // 4], [lon[0], -turn // 4]], axis=0)
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]))
