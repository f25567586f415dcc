"""The font of pictures."""

from functools import lru_cache

from PIL import ImageFont

__all__ = ["font"]


@lru_cache(maxsize=16)
def font(size: int) -> ImageFont.FreeTypeFont:
    """Return Pillow's own font with Pillow's own layout engine, so that pixels are the same on every machine."""
    found = ImageFont.load_default(size)
    if not isinstance(found, ImageFont.FreeTypeFont):
        raise TypeError("this Pillow was built without FreeType")
    return found.font_variant(layout_engine=ImageFont.Layout.BASIC)
