"""Write the files of one frame."""

from collections.abc import Collection
from pathlib import Path

from bumpymap.core import ClassedSectors, Scan
from bumpymap.layers.scan.cloud import write_cloud
from bumpymap.layers.scan.names import FRAME_FILES, FRAME_FOLDER
from bumpymap.layers.scan.picture import write_picture
from bumpymap.layers.scan.polygons import write_polygons

__all__ = ["frame_files", "has_files", "write_frame"]


def frame_files(name: str, folder: Path, products: Collection[str]) -> list[Path]:
    """Return the files that `write_frame` writes."""
    endings = [ending for product, ending in FRAME_FILES.items() if product in products]
    return [folder / FRAME_FOLDER / f"{name}{ending}" for ending in endings]


def has_files(name: str, folder: Path, products: Collection[str]) -> bool:
    """Return whether all files exist that `write_frame` would write."""
    return all(path.is_file() for path in frame_files(name, folder, products))


def write_frame(
    name: str, scan: Scan, classed: ClassedSectors, folder: Path, products: Collection[str], range_m: float = 40.0
) -> None:
    """Write those ``products`` that are files per frame to ``folder / "frames"``, without flushing them to the disk.

    Parameters
    ----------
    name : str
        Name of the frame and of its files.
    scan : Scan
    classed : ClassedSectors
    folder : Path
    products : collection of str
        Polygons, cloud, picture; others are ignored.
    range_m : float
        Distance from the sensor to the edge of the picture, m.
    """
    for path in frame_files(name, folder, products):
        path.parent.mkdir(exist_ok=True)
        if path.suffix == FRAME_FILES["polygons"]:
            write_polygons(name, classed, path)
        elif path.suffix == FRAME_FILES["cloud"]:
            write_cloud(scan, classed, path)
        else:
            write_picture(scan, classed, path, range_m)
