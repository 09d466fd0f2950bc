"""What a picture shows of one level, and the colour of each of its cells."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.views.color_scale import ColorScale
from navbake.views.door_marks import DoorMark

LIT, SHADED = 0.4, 0.5  # most that relief mixes white or black into a colour
RELIEF_HEIGHT = 0.04  # a step of this height gets three quarters of it [m]


class Label(NamedTuple):
    """A name on a picture."""

    text: str
    fallback: str  # written in its place if no font has its letters
    x: float  # of its middle, world frame [m]
    y: float
    width: float  # of what it names at this place [m]
    height: float  # of the same [m]


class Panel(NamedTuple):
    """One layer of one level; cells whose value is finite are coloured by that, not by `rgb`."""

    title: str
    rgb: NDArray[np.uint8]  # shape (height, width, 3)
    values: NDArray[np.float32] | None = None  # shape (height, width)
    scale: ColorScale | None = None  # of the values
    legend: tuple[tuple[str, str], ...] = ()  # meanings and their colours
    labels: tuple[Label, ...] = ()
    doors: tuple[DoorMark, ...] = ()
    has_relief: bool = False  # whether the values are heights, lit from the upper left


def paint(panel: Panel) -> NDArray[np.uint8]:
    """The colour of each cell, shape (height, width, 3), row 0 at the largest y."""
    if panel.values is None or panel.scale is None:
        return panel.rgb
    shown = np.isfinite(panel.values)
    colors = panel.scale.color(panel.values[shown])
    if panel.has_relief:
        colors = _light(colors, relief(panel.values)[shown])
    painted = panel.rgb.copy()
    painted[shown] = colors
    return painted


def relief(heights: NDArray[Any]) -> NDArray[np.float32]:
    """How the light falls on floors, from -1, in shade, to 1, lit: shape (height, width).

    The light comes from the upper left, as on maps. A cell that is higher than its neighbours
    above and to the left is lit, one that is lower lies in shade; where there is no floor beside
    it, neither. So a step of 2 cm shows as a line, whatever the scale of colours spans.
    """
    rise = np.zeros(heights.shape, dtype=np.float32)
    finite = np.where(np.isfinite(heights), heights, np.nan)
    for part, before in (
        ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
    ):
        rise[part] += np.nan_to_num(finite[part] - finite[before])
    lit: NDArray[np.float32] = np.tanh(rise / np.float32(RELIEF_HEIGHT))
    return lit


def _light(colors: NDArray[np.uint8], lit: NDArray[np.float32]) -> NDArray[np.uint8]:
    share = np.where(lit > 0, lit * LIT, -lit * SHADED)[:, None]
    toward = np.where(lit > 0, 255, 0)[:, None]
    mixed: NDArray[np.uint8] = np.round(colors * (1 - share) + toward * share).astype(np.uint8)
    return mixed
