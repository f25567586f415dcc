"""The script that the tutorial shows draws the layers that `map` writes today."""

import subprocess
import sys
from pathlib import Path

import pytest
from cost_maps import make_field
from PIL import Image
from route_maps import RUN

from bumpymap.core import CostTable
from bumpymap.layers import write_products
from bumpymap.views import write_map_views

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_layers_are_drawn(tmp_path):
    write_products(CostTable.of(make_field(20, 15)), tmp_path, views=write_map_views, local=False, manifest=RUN)
    picture = tmp_path / "picture.png"
    command = [sys.executable, str(ROOT / "docs" / "pictures" / "layers.py"), str(tmp_path), str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with Image.open(picture) as image:
        assert len(image.convert("RGB").getcolors(1 << 20)) > 100
