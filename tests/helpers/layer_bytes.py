"""What the layers of one survey must have in common however it is cut into files."""

import json

from bumpymap.layers import PRODUCT_NAMES


def layer_bytes(folder):
    """Bytes of the layers, and their item but for what it says of the survey's files."""
    item = json.loads((folder / "item.json").read_text(encoding="utf-8"))
    for key in ("title", "bumpymap:survey_checksum"):
        item["properties"].pop(key, None)
    layers = [name for name in PRODUCT_NAMES if name not in {"run.json", "item.json"}]
    return {name: (folder / name).read_bytes() for name in layers} | {"item.json": item | {"id": None}}
