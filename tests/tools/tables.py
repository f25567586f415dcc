"""Print the paper's Tables I, II, IV and V beside ours, of any survey and any frames of a scanner.

    python tests/tools/tables.py SURVEY... [--crs EPSG:CODE] [--scans FRAME...]

Table I is that of a map with ``compat = "paper"``. Table II is measured here, on up to 64 blocks of the survey; IV and
V are those of scans.
"""

import argparse
import math
import sys
import time
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd

import bumpymap
from bumpymap.core import CLASS_NAMES, BadInputError, FeatureSettings, decide_ground
from bumpymap.lab.evaluate import percent, table
from bumpymap.patches import decks_as_ground, measure
from bumpymap.rating import Calibration, TextureModel, classify, rate_as_paper
from bumpymap.readers import PointStats, ReadOptions, find_frames, find_surveys, open_survey, read_scan
from bumpymap.scan import ScanModel, classify_filter, classify_learned, load_stripes, polar_sectors
from bumpytiles import Grid, TileBuckets

PAPER_COSTS = (("heightmap method", "12.257", "0.084"), ("variance and residual from points", "41.027", "-"))
"""The paper's Table II: processor time [ms] and memory [kB] of a patch."""
PAPER_CLASSES = (
    ("paper, first site", (0.0039, 0.0329, 0.0952, 36.1), (0.0369, 0.0788, 0.1718, 3.62)),
    ("paper, second site", (0.0096, 0.0693, 0.1517, 0.6955), (0.036, 0.0961, 0.0932, 0.1759)),
)
"""The paper's Table I: means of variance [m2] and residual [m] of class 0 to 3."""
FIGURES = {
    "variance [m2], median": ("z_variance", "median"),
    "variance, mean": ("z_variance", "mean"),
    "residual [m], median": ("ransac_residual", "median"),
    "residual, mean": ("ransac_residual", "mean"),
    "C_r [rad/m], median": ("c_r", "median"),
}
"""Figures of our Table I: column of the tiles, and how it is summed up."""
MOST_BLOCKS = 64
NO_FIGURES = "The paper's own figures of Tables IV and V are not on record in this project, so only ours are printed."
NO_LABELS = (
    "The paper's network learned from the authors' labels of RELLIS-3D, which this project does not have: `learned` is "
    "the included network, which learned from simulated scenes."
)
NO_SCANS = "Tables IV and V are of scans: give frames with --scans."


def number(value):
    """Format a number with three significant digits; a dash if it is not finite."""
    return f"{value:.3g}" if math.isfinite(value) else "-"


class MeasuredSurvey:
    """All points of surveys, 14 to 26 bytes each, by block of a grid."""

    def __init__(self, surveys, options, grid):
        self.buckets = TileBuckets(grid)
        for reader in (open_survey(path, options) for path in find_surveys(surveys)):
            stats = PointStats()
            for chunk in reader.chunks():
                batch = reader.convert(chunk, reader.fetch(chunk))
                stats = stats.merge(batch.stats)
                self.buckets.add_chunk(batch.grouped(grid))
            reader.verify(stats)
        if not len(self.buckets):
            raise BadInputError("no point is left: every point is withheld, noise or without return")
        flags = np.concatenate([self.buckets.flags(key) for key in self.buckets.keys()])  # noqa: SIM118 (no mapping)
        # For a single tile, the share of ground points replaces the count of tiles with ground points.
        self.ground_only = decide_ground("auto", 1, float(np.mean(flags[flags.any(axis=1), 1])))

    def measured(self, parts):
        """Measure the tiles of blocks; a dense block comes in several parts."""
        for points in parts:
            yield measure(decks_as_ground(points), FeatureSettings(), ground_only=self.ground_only)


def first_table(layers):
    """Return the lines of Table I of a map with ``compat = "paper"``."""
    tiles = layers.tiles()
    tiles = tiles[tiles["class"].notna()]
    full, rows = tiles["confidence"].notna(), []
    for class_id, name in enumerate(CLASS_NAMES):
        own = tiles[tiles["class"] == class_id]
        figures = (number(float(getattr(own[column], how)())) for column, how in FIGURES.values())
        rows.append(["compat=paper", f"{class_id} {name}", str(len(own)), percent(len(own) / len(tiles)), *figures])
    for site, variance, residual in PAPER_CLASSES:
        figures = enumerate(zip(map(number, variance), map(number, residual), strict=True))
        rows += [[site, str(k), "-", "-", "-", square, "-", away, "-"] for k, (square, away) in figures]
    holes = f"{np.count_nonzero(~full)} of {len(full)} tiles are class 3 because they have too few points, or more than"
    return [*table(("rating", "class", "tiles", "share", *FIGURES), rows), f"{holes} 30 % of their pixels hold none."]


def second_table(surveys, crs, heightmap_bytes):
    """Return the lines of Table II; ``heightmap_bytes`` are those of a tile in heightmap.tif."""
    calibration, network = Calibration.shipped("warthog"), TextureModel.shipped()
    grid = Grid(calibration.tile_size, calibration.pixels)
    options = ReadOptions(crs, pixel_m=calibration.tile_size / calibration.pixels)
    survey = MeasuredSurvey(surveys, options, grid)

    def measured():
        return list(survey.measured(islice(survey.buckets.blocks(), MOST_BLOCKS)))

    def judged(stacks):
        return [rate_as_paper(one, classify(one, network), calibration) for one in stacks]

    judged(measured())  # loads code and network
    start = time.process_time()
    stacks = measured()
    between = time.process_time()
    judged(stacks)
    count = sum(len(stack.col) for stack in stacks)
    measuring, judging = (1000 * value / count for value in (between - start, time.process_time() - between))
    rows = [
        ["bumpymap: heightmap, variance and residual, in one pass", number(measuring), number(heightmap_bytes / 1000)],
        ["bumpymap: texture and class", number(judging), "-"],
        ["bumpymap: all", number(measuring + judging), number(heightmap_bytes / 1000)],
        *([f"paper: {step}", *values] for step, *values in PAPER_COSTS),
    ]
    points = sum(int(stack.count.sum()) for stack in stacks)
    return [
        *table(("step", "processor time [ms] a patch", "kB a patch"), rows),
        f"Ours: {count} tiles of {points / count:.0f} points, on this machine; kB: heightmap.tif over its tiles.",
        "The paper's: an i7 with an RTX 3070.",
    ]


def scan_tables(frames):
    """Return the lines of Tables IV and V of the frames of a scanner: of sectors with ground, by class."""
    stripes, network, parts = load_stripes(), ScanModel.shipped(), []
    for scan in map(read_scan, find_frames(frames)):
        stack = polar_sectors(scan)
        by_filter = classify_filter(stack, stripes)
        for method, found in (("filter", by_filter), ("learned", classify_learned(stack, network))):
            own = {"class": found.class_id, "stripes": by_filter.stripes}
            own |= {"variance [m2]": stack.variance, "residual [m]": stack.residual}
            parts.append(pd.DataFrame(own)[stack.traversable].assign(method=method))
    classes = pd.concat(parts).groupby(["method", "class"])
    figures = classes.agg(["median", "mean"])
    rows = [[*map(str, key), str(classes.size()[key]), *map(number, row)] for key, *row in figures.itertuples()]
    return table(("method", "class", "sectors", *map(", ".join, figures.columns)), rows)


def main():
    """Map the survey by the paper's rules, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surveys", nargs="+", metavar="SURVEY", type=Path)
    parser.add_argument("--crs")
    parser.add_argument("--scans", nargs="+", default=[], metavar="FRAME", type=Path)
    given = parser.parse_args()
    own = {"crs": given.crs} if given.crs else {}
    try:
        layers = bumpymap.map_survey(given.surveys, compat="paper", **own)
        size = (layers.folder / "rasters" / "heightmap.tif").stat().st_size / layers.manifest["counts"]["tiles"]
        print("## Table I: variance and residual of the classes", "", *first_table(layers), "", sep="\n")
        print("## Table II: cost of a patch", "", *second_table(given.surveys, given.crs, size), "", sep="\n")
        scans = scan_tables(given.scans) if given.scans else [NO_SCANS]
    except bumpymap.BumpymapError as error:
        sys.exit(f"tables.py: {error}")
    print("## Tables IV and V: classes of scans", "", *scans, NO_FIGURES, NO_LABELS, sep="\n")


if __name__ == "__main__":
    main()
