"""Write the files of one frame."""

from collections.abc import Collection
from pathlib import Path

from bumpymap.core import ClassedSectors, Scan
from bumpymap.layers.scan.cloud import write_cloud
from bumpymap.layers.scan.folder import sync_to_disk
from bumpymap.layers.scan.names import FRAME_FILES, FRAME_FOLDER
from bumpymap.layers.scan.picture import write_picture
from bumpymap.layers.scan.polygons import write_polygons

__all__ = ["has_files", "write_frame"]


def has_files(name: str, folder: Path, products: Collection[str]) -> bool:
    """Return whether all files exist that `write_frame` would write."""
    wanted = [ending for product, ending in FRAME_FILES.items() if product in products]
    return all((folder / FRAME_FOLDER / f"{name}{ending}").is_file() for ending in wanted)


def write_frame(name: str, scan: Scan, classed: ClassedSectors, folder: Path, products: Collection[str]) -> None:
    """Write those ``products`` that are files per frame (polygons, cloud, picture) to ``folder / "frames"``."""
    wanted = {product: ending for product, ending in FRAME_FILES.items() if product in products}
    for product, ending in wanted.items():
        path = folder / FRAME_FOLDER / f"{name}{ending}"
        path.parent.mkdir(exist_ok=True)
        if product == "polygons":
            write_polygons(name, classed, path)
        elif product == "cloud":
            write_cloud(scan, classed, path)
        else:
            write_picture(scan, classed, path)
        sync_to_disk(path)
