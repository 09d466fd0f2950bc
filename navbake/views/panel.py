"""What a picture shows of one level, and the colour of each of its cells."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.door_lines import DoorLine
from navbake.views.color_scale import ColorScale

LIT, SHADED = 0.3, 0.35  # most that relief mixes white or black into a colour
BAND_CELLS = 1 << 20  # painted at once


class Label(NamedTuple):
    """A name on a picture."""

    text: str
    fallback: str  # written in its place if no font has its letters
    x: float  # of its middle, world frame [m]
    y: float
    width: float  # of what it names at this place [m]
    height: float  # of the same [m]
    number: int = 0  # written where there is no space for the name


class Panel(NamedTuple):
    """One layer of one level; cells whose value is finite are coloured by that, not by `rgb`."""

    title: str
    rgb: NDArray[np.uint8]  # shape (height, width, 3)
    values: NDArray[np.float32] | None = None  # shape (height, width)
    scale: ColorScale | None = None  # of the values
    legend: tuple[tuple[str, str], ...] = ()  # meanings and their colours
    labels: tuple[Label, ...] = ()
    doors: tuple[DoorLine, ...] = ()
    relief: float = 0.0  # a step of values that gets 3/4 of the most light or shade; 0: no relief


def paint(panel: Panel) -> NDArray[np.uint8]:
    """The colour of each cell, shape (height, width, 3), row 0 at the largest y."""
    if panel.values is None or panel.scale is None:
        return panel.rgb
    painted = panel.rgb.copy()
    # in bands: the numbers in between take ten times the memory of a picture
    band = max(BAND_CELLS // panel.values.shape[1], 1)
    for first in range(0, len(painted), band):
        rows = slice(first, first + band)
        values = panel.values[rows]
        shown = np.isfinite(values)
        colors = panel.scale.color(values[shown])
        if panel.relief:
            above = min(first, 1)  # light falls on the first row by the one above it
            lit = light_of(panel.values[first - above : first + band], panel.relief)[above:]
            colors = _light(colors, lit[shown])
        painted[rows][shown] = colors
    return painted


def light_of(heights: NDArray[Any], step: float) -> NDArray[np.float32]:
    """How the light falls on floors, from -1, in shade, to 1, lit: shape (height, width).

    The light comes from the upper left, as on maps. A cell that is higher than its neighbours
    above and to the left is lit, one that is lower lies in shade, by 3/4 where it is higher or
    lower by `step`. Where there is no floor beside it, it is neither. So a step of 2 cm shows as
    a line, whatever the scale of colours spans.
    """
    rise = np.zeros(heights.shape, dtype=np.float32)
    finite = np.where(np.isfinite(heights), heights, np.nan)
    for part, before in (
        ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
    ):
        rise[part] += np.nan_to_num(finite[part] - finite[before])
    lit: NDArray[np.float32] = np.tanh(rise / np.float32(step))
    return lit


def _light(colors: NDArray[np.uint8], lit: NDArray[np.float32]) -> NDArray[np.uint8]:
    share = np.where(lit > 0, lit * LIT, -lit * SHADED)[:, None]
    toward = np.where(lit > 0, 255, 0)[:, None]
    mixed: NDArray[np.uint8] = np.round(colors * (1 - share) + toward * share).astype(np.uint8)
    return mixed
