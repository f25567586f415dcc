"""Make bumpymap/scan/data/models/scan.onnx anew, and print the scores that its card holds.

    python docs/models/scan.py [--scenes 440] [--out FILE]

Simulates scenes with labels and scans them (needs open3d, as the tests do), trains on their sectors, and scores on
scenes of other numbers: hours, most of them for the scenes. The same command gives the same bits on the same machine
and libraries; an interrupted training goes on, the scenes are simulated again.
"""

import argparse
from pathlib import Path

import numpy as np
from scan_scenes.lidar import overhead_scan, scene_scan
from scan_scenes.scene import make_scene

from bumpymap.lab.settings import ScanTrainSettings
from bumpymap.lab.train.model_files import training_files, write_model
from bumpymap.lab.train.scan_net import (
    Sectors,
    draw_cuts,
    evaluate,
    join,
    labelled_sectors,
    metadata_of,
    to_onnx,
    train,
)

UNSEEN, UNSEEN_SCENES = 1_000_000, 110
"""Number of the first scene that is never used in training, and of the scenes in the scores: ten of every theme."""


def simulated_sectors(seed: int, scenes: range, turns: int = 0) -> list[Sectors]:
    """Return the sectors of the scan of each scene, cut ``turns`` more times after a random rotation."""
    return [
        labelled_sectors(scene_scan(seed, index), draw_cuts(np.random.default_rng([seed, index, 3]), turns))
        for index in scenes
    ]


def overhead_sectors(seed: int, scenes: range) -> list[Sectors]:
    """Return the sectors of the ground of each scene, fully visible and partly covered with blocks."""
    seen = (overhead_scan(make_scene(seed, index), index) for index in scenes)
    return [labelled_sectors(scan) for scan in seen]


def main() -> None:
    """Simulate, train, score, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=440)
    parser.add_argument("--unseen", type=int, default=UNSEEN_SCENES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--epochs", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("scan.onnx"))
    given = parser.parse_args()
    settings = ScanTrainSettings(seed=given.seed, epochs=given.epochs)
    command = f"python docs/models/scan.py --seed {given.seed} --epochs {given.epochs} --scenes {given.scenes}"
    with training_files(given.out) as checkpoint:
        learn = simulated_sectors(given.seed, range(given.scenes), settings.turns)
        learn += overhead_sectors(given.seed, range(0, given.scenes - 9, 10))  # every tenth, in every theme
        sectors = join(learn)
        unseen = join(simulated_sectors(given.seed, range(UNSEEN, UNSEEN + given.unseen)))
        net = train(settings, sectors, checkpoint, print)
        scores = evaluate(net, unseen, given.unseen)
        write_model(given.out, to_onnx(net, metadata_of(settings, scores, command)), checkpoint)
    print(scores)


if __name__ == "__main__":
    main()
