"""Print the paper's Tables I, II, IV and V beside ours, of any survey and any frames of a scanner.

    python tests/tools/tables.py SURVEY... [--crs EPSG:CODE] [--scans FRAME...]

Table I is that of a map with ``compat = "paper"``: of all its tiles, and of those that are not class 3 for the want of
points alone. Table II is measured here, on up to 64 blocks of the survey. Tables IV and V are those of scans.
"""

import argparse
import sys
import time
from itertools import islice
from pathlib import Path

import numpy as np

import bumpymap
from bumpymap.core import FeatureSettings, Georeference, SilentProgress
from bumpymap.lab import ScanEvaluateSettings, evaluate_scans, open_readers
from bumpymap.lab.evaluate.agreement import Verdict, class_table
from bumpymap.lab.evaluate.report import class_lines, number, scan_class_lines, table
from bumpymap.lab.evaluate.survey_trial import load_survey
from bumpymap.rating import Calibration, TextureModel, classify, rate_as_paper
from bumpymap.readers import ReadOptions, find_frames, read_scan
from bumpymap.scan import ScanModel, load_stripes
from bumpytiles import Grid

PAPER_COSTS = (("heightmap method", "12.257", "0.084"), ("variance and residual from points", "41.027", "-"))
"""The paper's Table II: processor time [ms] and memory [kB] of a patch."""
MOST_BLOCKS = 64
NO_FIGURES = "The paper's own figures of Tables IV and V are not on record in this project, so only ours are printed."
NO_LABELS = (
    "The paper's network learned from the authors' labels of RELLIS-3D, which this project does not have: `learned` is "
    "the included network, which learned from simulated scenes."
)
NO_SCANS = "Tables IV and V are of scans: give frames with --scans."


def first_table(layers):
    """Return the lines of Table I of a map with ``compat = "paper"``."""
    tiles = layers.tiles()
    tiles = tiles[tiles["class"].notna()]
    names = ("class", "c_r", "c_r_low", "c_r_high", "p_fail", "confidence", "z_variance", "ransac_residual")
    class_id, *rated, variance, residual = (tiles[name].to_numpy(np.float64) for name in names)
    verdict, full = Verdict(class_id.astype(np.uint8), *rated), tiles["confidence"].notna().to_numpy()
    found = {"compat=paper": class_table(verdict, variance, residual)}
    if full.any():
        found["its full tiles"] = class_table(verdict.take(full), variance[full], residual[full])
    holes = f"{np.count_nonzero(~full)} of {len(full)} tiles are class 3 because they have too few points, or more than"
    return [*class_lines(found), "", f"{holes} 30 % of their pixels hold none; the full tiles are the others."]


def second_table(surveys, crs, heightmap_bytes):
    """Return the lines of Table II; ``heightmap_bytes`` are those of a tile in heightmap.tif."""
    calibration, network = Calibration.shipped("warthog"), TextureModel.shipped()
    grid = Grid(calibration.tile_size, calibration.pixels)
    options = ReadOptions(crs, pixel_m=calibration.tile_size / calibration.pixels)
    readers = open_readers(surveys, options, local=True)
    survey = load_survey(readers, "auto", grid, FeatureSettings(), SilentProgress())

    def measured():
        return list(survey.measured(islice(survey.buckets.blocks(), MOST_BLOCKS)))

    def judged(stacks):
        return [rate_as_paper(one, classify(one, network), calibration, Georeference(None)) for one in stacks]

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
    """Return the lines of Tables IV and V of the frames of a scanner."""
    found = find_frames(frames)
    scans = map(read_scan, found)
    settings, stripes, network = ScanEvaluateSettings(), load_stripes(), ScanModel.shipped()
    return scan_class_lines(evaluate_scans(scans, len(found), settings, stripes, network, SilentProgress()))


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
