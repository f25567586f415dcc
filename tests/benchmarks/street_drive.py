"""Map drives along made-up streets with `bumpymap scan --poses` and compare with the truth.

python tests/benchmarks/street_drive.py [--streets 3] [--frames 24] [--sensor 64_narrow]

Each street is driven once and mapped with true poses, and with errors of 5 cm and 0.3 degrees. Judged are the tiles
along the way within 9 m of the axis: those in the lanes, which a vehicle can cross, and those that hold a parked car, a
wall or a trunk beside which a disc of the vehicle's width does not fit.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from bumpymap.lab.worlds.scans.lidar import SENSORS
from bumpymap.scan import ScanConfig, scan_frames

sys.path.append(str(Path(__file__).resolve().parents[1] / "worlds"))

from made_street import Street, drive_street, make_street, noisy_poses
from made_woods import swept_tiles

BELLY_M, HEIGHT_M, WIDTH_M = 0.25, 1.38, 1.37
"""Of the Warthog."""
TILE_M = 3.0


def write_drive(folder: Path, street: Street, sensor: str, frames: int) -> np.ndarray:
    """Write the frames of a drive; return the true poses."""
    scans, poses = drive_street(street, SENSORS[sensor], frames)
    folder.mkdir(parents=True)
    for number, scan in enumerate(scans):
        np.column_stack([scan.points, scan.intensity]).astype("<f4").tofile(folder / f"{number}.bin")
    return poses


def judge(folder: Path, street: Street, end_m: float) -> dict[str, float]:
    """Compare the map in a folder with the street, from 3 m on to ``end_m``."""
    table = pq.read_table(folder / "map" / "tiles.parquet", columns=["col", "row", "class", "passable", "c_r"])
    col, row = table["col"].to_numpy(), table["row"].to_numpy()
    class_id = np.array([9 if value is None else value for value in table["class"].to_pylist()])
    c_r = np.array([np.nan if value is None else value for value in table["c_r"].to_pylist()])
    passable = np.array([value is True for value in table["passable"].to_pylist()])
    count = round(street.length_m / TILE_M)
    inside = (col >= 1) & (TILE_M * (col + 1) <= end_m) & (row >= -3) & (row <= 2)
    col, row, class_id, c_r, passable = (values[inside] for values in (col, row, class_id, c_r, passable))
    north = count // 2 - 1 - row
    held = street.blocked(BELLY_M, HEIGHT_M, 0.1).reshape(count, 30, count, 30).mean(axis=(1, 3))[north, col]
    free = swept_tiles(street, BELLY_M, HEIGHT_M, WIDTH_M, TILE_M)[north, col]
    lane = (row == -1) | (row == 0)
    full = (held > 0.0) & ~free
    return {
        "lane tiles": int(lane.sum()),
        "class 0 or 1": float((class_id[lane] <= 1).mean()),
        "c_r": float(np.nanmedian(c_r[lane])),
        "passable": float(passable[lane].mean()),
        "full tiles": int(full.sum()),
        "barred": float((~passable[full]).mean()),
        "passable right": float(np.concatenate([passable[lane], ~passable[full]]).mean()),
        "by mistake": int((passable & ~free).sum()),
    }


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--streets", type=int, default=3)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--sensor", default="64_narrow", choices=SENSORS)
    given = parser.parse_args()
    names: list[str] = []
    for seed in range(given.streets):
        street = make_street(seed)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            true = write_drive(folder / "drive", street, given.sensor, given.frames)
            for noise in (0.0, 1.0):
                poses = noisy_poses(true, seed, 0.05 * noise, 0.3 * noise)
                np.savetxt(folder / "poses.txt", poses[:, :3].reshape(-1, 12))
                out = folder / f"out{noise:.0f}"
                config = ScanConfig(
                    (folder / "drive",), out, poses=folder / "poses.txt", products=("table",), method="filter"
                )
                merged = scan_frames(config).merged["poses"]
                found = {"street": seed, "noise": noise, "disagree": merged["before_m"], "after": merged["after_m"]}
                found |= judge(out, street, true[-1, 0, 3] + 6.0)
                if not names:
                    names = list(found)
                    print(" | ".join(names))
                values = (f"{value:.3f}" if isinstance(value, float) else str(value) for value in found.values())
                print(" | ".join(values))


if __name__ == "__main__":
    main()
