"""The layers of a level as pictures, a pixel a cell, inside of a page."""

import io
from base64 import b64encode

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.color_scale import ColorScale
from navbake.views.layers import LAYERS, make_panel, paint
from navbake.views.report.cells import thinning

BAR = 64  # colours of the bar beside a layer
PALETTE = 256  # most colours of a picture that numbers them, one byte a pixel


def draw_layers(grid: NavGrid, number: int) -> list[Json]:
    """Each layer of a level: name, picture, legend, scale of colours, and names of rooms."""
    return [_draw_layer(grid, number, layer) for layer in LAYERS]


def to_png(rgb: NDArray[np.uint8]) -> str:
    """A picture, shape (rows, cols, 3), as the URL of a PNG that holds all of it."""
    number = rgb.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], dtype=np.uint32)
    colors, index = np.unique(number, return_inverse=True)
    if len(colors) <= PALETTE:
        image = Image.fromarray(index.reshape(number.shape).astype(np.uint8), mode="L")
        image.putpalette(
            np.stack([colors >> 16, colors >> 8 & 255, colors & 255], 1).astype(np.uint8).tobytes()
        )
    else:
        image = Image.fromarray(rgb)
    content = io.BytesIO()
    image.save(content, format="PNG", optimize=True)
    return "data:image/png;base64," + b64encode(content.getvalue()).decode("ascii")


def _draw_layer(grid: NavGrid, number: int, layer: str) -> Json:
    panel = make_panel(grid, layer, number)
    every = thinning(grid.levels[number])
    return {
        "name": layer,
        "title": panel.title.removeprefix(f"{grid.level_names[number]}: "),
        "png": to_png(paint(panel)[::every, ::every]),
        "legend": panel.legend,
        "scale": None if panel.scale is None else _describe_scale(panel.scale),
        "labels": [label._asdict() for label in panel.labels],
        "doors": [door._asdict() for door in panel.doors],
    }


def _describe_scale(scale: ColorScale) -> Json:
    colors = [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in scale.bar(BAR).tolist()]
    return {
        "label": scale.label,
        "colors": colors,
        "ticks": [tick._asdict() for tick in scale.ticks],
    }
