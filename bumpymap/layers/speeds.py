"""Write speeds.tif: what is felt on each tile at several speeds."""

from pathlib import Path

from bumpymap.core import CostTable, speed_bands
from bumpymap.layers._raster_spec import BandSpec
from bumpymap.layers._tile_bands import write_bands
from bumpymap.layers._tile_pixels import layer_tags

__all__ = ["write_speeds"]


def write_speeds(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write speeds.tif: a float32 COG, one pixel per tile, the bands of `speed_bands`, NaN if unknown.

    Parameters
    ----------
    table : CostTable
        The tiles, with ``speeds``.
    path : Path
        The file to write.
    about : dict, optional
        Metadata of the file, such as vehicle and calibration.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The extent is too large for a raster.
    """
    bands = [BandSpec(band.name, band.unit, band.description) for band in speed_bands(table.speeds)]
    own = {"speeds_m_per_s": " ".join(f"{speed:g}" for speed in table.speeds)}
    tags = layer_tags(table, "pitch, roll and vertical acceleration at several speeds", own | (about or {}))
    write_bands(table, path, bands, tags, ("motion",), lambda found: found["motion"].T)
