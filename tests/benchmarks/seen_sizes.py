"""Measure which standing objects and steps surveys show, beside what `bumpymap.core.seen_sizes` says.

    python tests/benchmarks/seen_sizes.py [--surveys 4] [--seed 1]

Objects are posts of 1 m with square tops, seen from straight above, in surveys with classes and without; steps join two
level plains; `closes` is the height that a vehicle cannot cross, 0.275 m for the Warthog. Both tables hold the size
that is said, and the shares that are found at 0.6, 0.8, 1 and 1.2 times that.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from seen_surveys import level_step, share_of_posts, share_of_steps

from bumpymap.core import SeenSizes
from bumpytiles import Grid

TIMES = (0.6, 0.8, 1.0, 1.2)
HEAD = " | ".join(f"x {times:g}" for times in TIMES)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--surveys", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    print(f"| points/m2 | classes | narrowest object, m | {HEAD} |\n|{'---|' * (3 + len(TIMES))}")
    for in_relief in (False, True):
        for density in (4, 8, 10, 12, 15, 20, 35, 60, 100, 200, 400):
            width = SeenSizes.forecast(density, Grid().pixel_size, in_relief=in_relief).object_m
            shares = [
                share_of_posts(density, width * times, rng, in_relief=in_relief, surveys=args.surveys)
                for times in TIMES
            ]
            row = " | ".join(f"{share:.2f}" for share in shares)
            print(f"| {density} | {'no' if in_relief else 'yes'} | {width:.2f} | {row} |", flush=True)
    print(f"\n| points/m2 | noise, m | closes, m | lowest step, m | {HEAD} |\n|{'---|' * (4 + len(TIMES))}")
    for closing in (np.inf, 0.275, 0.1):
        for density in (4, 10, 20, 35, 100, 400):
            for noise in (0.005, 0.01, 0.03, 0.05):
                height, surveys = level_step(density, noise, rng, closing), 4 * args.surveys
                shares = [
                    share_of_steps(height * times, density, noise, rng, closing=closing, surveys=surveys)
                    for times in TIMES
                ]
                row = " | ".join(f"{share:.2f}" for share in shares)
                print(f"| {density} | {noise:g} | {closing:g} | {height:.2f} | {row} |", flush=True)


if __name__ == "__main__":
    main()
