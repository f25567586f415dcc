"""Rasters where the system gives no more threads: written by one, never waited for."""

import subprocess
import sys
from pathlib import Path

import pytest
import rasterio

pytestmark = pytest.mark.slow

_WITHOUT_THREADS = """
import resource, sys, threading
from pathlib import Path
from bumpymap.layers import _cog
from bumpymap.layers.placement import Placement
from bumpymap.core.types import Georeference
from bumpytiles import Grid, TileWindow
import numpy as np

pages = int(Path("/proc/self/statm").read_text().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (128 << 20),) * 2)
try:
    threading.Thread(target=print).start()
    sys.exit("a thread could be started")
except RuntimeError:
    pass
place = Placement(Georeference(None), Grid(), TileWindow(0, 0, 100, 100))
sheet = _cog.RasterSpec([_cog.BandSpec("height")], None, pixels=15, block=512)
paint = lambda window: np.full((1, window.tiles.rows * 15, window.tiles.cols * 15), 7, np.float32)
_cog.write_cog(Path(sys.argv[1]), place, sheet, paint, 100)
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="asks Linux how much memory is mapped")
def test_a_raster_is_written_where_no_thread_can_be_started(tmp_path):
    """GDAL waits for ever for threads that it could not start; here one has a stack of 512 MB, and 128 MB are left."""
    path = tmp_path / "a.tif"
    command = ["bash", "-c", 'ulimit -s 524288 && exec "$@"', "-", sys.executable, "-c", _WITHOUT_THREADS, str(path)]
    result = subprocess.run(command, capture_output=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr.decode()
    with rasterio.open(path) as file:
        assert file.overviews(1)
        assert (file.read(1) == 7).all()
