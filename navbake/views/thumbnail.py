"""A small picture of a grid, as pages of many grids show it."""

from __future__ import annotations

import io

from PIL import Image

from navbake.navgrid.grid import NavGrid
from navbake.views.notebook import draw_levels

SIDE = 240  # longest side [pixels]
COLORS = 64  # of which each pixel has one: a byte a pixel, a third of what true colours take


def draw_thumbnail(grid: NavGrid) -> bytes:
    """Draw the levels beside each other, as PNG: at most `SIDE` pixels long, `COLORS` colours.

    Cells have the colours that `navbake.views.notebook` gives them. The same grid gives the same
    bytes.
    """
    image = draw_levels(grid, SIDE)
    if image.getcolors(COLORS) is None:
        image = image.quantize(COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    else:  # few colours stay as they are
        image = image.convert("P", palette=Image.Palette.ADAPTIVE, colors=COLORS)
    content = io.BytesIO()
    image.save(content, format="png")
    return content.getvalue()
