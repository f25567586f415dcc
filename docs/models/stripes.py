"""Make bumpymap/scan/data/models/stripes.json anew, and print the tables of stripes.md: python docs/models/stripes.py.

Takes some minutes and open3d. Scenes are those of seed 5150: twelve of every theme, each seen by another sensor.
"""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scan_scenes.lidar import scene_scan
from scan_scenes.scene import THEMES
from sklearn.cluster import KMeans

import bumpymap
from bumpymap.core import CLASSES, NOT_TRAVERSABLE
from bumpymap.lab import LABEL_SETS
from bumpymap.lab.train.scan_net import crowns_as_bushes
from bumpymap.scan import classify_filter, polar_sectors
from bumpymap.scan.stripes import StripeFilter, StripeModel, count_stripes

SEED, OF_A_THEME = 5150, 12
OUT = Path(bumpymap.__file__).parent / "scan" / "data" / "models" / "stripes.json"


def main() -> None:
    """Fit, write, print."""
    stacks = [polar_sectors(crowns_as_bushes(scene_scan(SEED, i))) for i in range(OF_A_THEME * len(THEMES))]
    counts = np.concatenate([count_stripes(stack.heights[stack.traversable]) for stack in stacks])
    pixels = stacks[0].settings.pixels
    found = KMeans(CLASSES, init="k-means++", n_init=10, random_state=0).fit(counts.astype(np.float64)[:, None])
    smooth, fair, rough = sorted(found.cluster_centers_.ravel().tolist(), reverse=True)
    model = StripeModel(StripeFilter(), pixels, (smooth, fair, rough), len(stacks), len(counts), 0)
    record = {"format": "bumpymap stripes 2", **asdict(model)}
    OUT.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    print(f"{model.sectors:,} sectors with ground of {model.scans} scans; centres {model.centres}")
    class_id = np.concatenate([classify_filter(stack, model).class_id for stack in stacks])
    variance, residual, label = (
        np.concatenate([getattr(stack, column) for stack in stacks]) for column in ("variance", "residual", "label")
    )
    for number in range(CLASSES):
        own = class_id == number
        print(
            f"| {number} | {model.centres[number]:.2f} | {own.sum():,} | {variance[own].mean():.4f} "
            f"| {np.nanmean(residual[own]):.4f} |"
        )
    truth = LABEL_SETS["rellis"].classes_of(label)
    for number in range(CLASSES):
        own = (truth == number) & (class_id != NOT_TRAVERSABLE)
        print(f"labelled {number}: of class 0, 1, 2: {[int((own & (class_id == k)).sum()) for k in range(CLASSES)]}")


if __name__ == "__main__":
    main()
