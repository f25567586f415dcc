"""Rate the tiles of a survey again with fewer points and with moved points, and time the steps of a tile.

    python tests/benchmarks/tile_changes.py SURVEY [--crs EPSG:CODE] [--densities 50,20,10] [--out FOLDER]

The survey is thinned at random, rated again and compared with the rating of all points; the points of each tile are
turned, mirrored, tilted and lifted inside it; the costs are of one thread, with points in memory, in processor time.
"""

import argparse
from pathlib import Path

from _records import show_records
from _tile_trials import density_sweep, invariance, step_costs

from bumpymap.core import Reason, SilentProgress
from bumpymap.lab.evaluate.rated_survey import Subject, load_survey, open_readers
from bumpymap.lab.settings import EvaluateSettings
from bumpymap.rating import TextureModel, find_calibration
from bumpymap.readers import ReadOptions
from bumpytiles import Grid


def main() -> None:
    """Print a table for each change and the costs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey", type=Path)
    parser.add_argument("--crs")
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--densities", default="100,50,20,10,5", help="points per m2")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path(), help="folder for temporary points")
    given = parser.parse_args()
    subject = Subject.of(find_calibration(given.vehicle), TextureModel.shipped(), "ride")
    grid = Grid(subject.calibration.tile_size, subject.calibration.pixels)
    readers, quiet = open_readers([given.survey], ReadOptions(crs=given.crs), local=True), SilentProgress()
    with load_survey(readers, "auto", grid, EvaluateSettings().features, given.out, quiet) as survey:
        stacks = [survey.measured(points) for points in survey.points()]
        counts = [count for stack in stacks for count in stack.count[stack.reason == Reason.OK].tolist()]
        density = sum(counts) / len(counts) / grid.tile_size**2
        densities = [float(word) for word in given.densities.split(",")]
        show_records("Fewer points", density_sweep(survey, subject, density, densities, given.seed, quiet))
        show_records("Moved points", invariance(survey.points(), survey.measured, subject, given.seed))
        show_records("Costs of a tile", step_costs(survey, subject, quiet))


if __name__ == "__main__":
    main()
