"""Colours for values: heights, distances, costs.

The colours are viridis, by Nathaniel Smith and Stéfan van der Walt (CC0), without its dark end,
which would look like what is occupied. It gets lighter all the way, so that a picture reads in
grey and for the colour-blind.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.colors import rgb_of

# From 0.22 to 1, at places whose colours look equally far apart to people who see no red, no green,
# or both
VIRIDIS = ["#3e4989", "#31678e", "#287d8e", "#218e8d", "#1e9c89", "#24ab82", "#39b976", "#5bc863"]
VIRIDIS += ["#8ed644", "#fde725"]
STOPS = tuple((number / (len(VIRIDIS) - 1), color) for number, color in enumerate(VIRIDIS))
SHADES = 1024  # colours that a scale is rounded to
MIN_RANGE = 0.1  # least span of a scale, so that flat floors look flat
HEIGHT_STEP = 0.01  # heights nearer than this are one [m]
MIN_LENGTH = 5.0  # of a scale of heights, in steps that lie beside each other
MAX_HEIGHTS = 1 << 16  # steps that a range of heights is split into at most
MAX_TICKS = 6
TICK_GAP = 0.11  # least distance of two ticks, of the scale's length


class Tick(NamedTuple):
    """A value beside the bar of a scale."""

    position: float  # along the bar, 0 to 1
    text: str


class ColorScale(NamedTuple):
    """Which colour stands for which value.

    A bar runs from 0, the lowest value, to 1, the highest. Values lie on it between `values` at
    `positions`, and colours between `stops`, both by straight lines.
    """

    label: str  # what the values are, with their unit
    values: tuple[float, ...]  # ascending
    positions: tuple[float, ...]  # ascending, 0 to 1, of each of them
    ticks: tuple[Tick, ...]
    stops: tuple[tuple[float, str], ...] = STOPS  # positions and their colours

    @property
    def low(self) -> float:
        """The lowest value."""
        return self.values[0]

    @property
    def high(self) -> float:
        """The highest value."""
        return self.values[-1]

    def bar(self, count: int) -> NDArray[np.uint8]:
        """Colours at equal distances along the bar, lowest value first, shape (count, 3)."""
        where = np.linspace(0.0, 1.0, count)
        at = [position for position, _ in self.stops]
        rgb = np.array([rgb_of(color) for _, color in self.stops], dtype=np.float64)
        return np.stack(
            [np.round(np.interp(where, at, channel)) for channel in rgb.T], axis=1
        ).astype(np.uint8)

    def color(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """The colours of finite values of any shape, shape (…, 3); those beyond it are clipped."""
        place = np.interp(values, self.values, self.positions)
        shade = np.round(place * (SHADES - 1)).astype(np.intp)
        painted: NDArray[np.uint8] = self.bar(SHADES).take(shade, axis=0)
        return painted


def linear_scale(values: NDArray[Any], label: str, *, dark_high: bool = False) -> ColorScale:
    """A scale from the least to the largest of some finite values, shape (n,).

    The largest is the lightest, or the darkest where `dark_high` asks for it.
    """
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, MIN_RANGE)
    ticks = _round_ticks(low, high)
    widen = max(0.0, MIN_RANGE - (high - low)) / 2
    low, high = (low, high + 2 * widen) if dark_high else (low - widen, high + widen)
    placed = tuple(Tick((value - low) / (high - low), text) for value, text in ticks)
    stops = STOPS
    if dark_high:
        stops = tuple((1 - position, color) for position, color in reversed(STOPS))
    return ColorScale(label, (low, high), (0.0, 1.0), placed, stops)


def _round_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Some round numbers from one value to another; the value itself where they are one."""
    if high == low:
        return [(low, f"{low:g}")]
    step = nice_step((high - low) / MAX_TICKS)
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [(n * step, f"{n * step + 0.0:.{digits}f}") for n in range(first, last + 1)]


def nice_step(least: float) -> float:
    """The first of 1, 2, 5, 10, 20, … that is no less, whatever its power of ten."""
    power = 10.0 ** math.floor(math.log10(least))
    return next((n * power for n in (1, 2, 5) if n * power >= least * (1 - 1e-9)), 10 * power)


def height_scale(heights: NDArray[Any], label: str) -> ColorScale:
    """A scale that tells floors 2 cm apart and 3 m apart in one picture.

    Heights are rounded to centimetres. Where there are floors at all heights, as on a ramp, the
    scale is even. Where there are none from one height to the next, it shrinks to the cube root of
    the gap: 3 m take 5 times as much of it as 2 cm, not 150 times.

    Args:
        heights: finite ones, shape (n,) [m].
        label: what they are.
    """
    if not heights.size:
        return linear_scale(heights, label)
    low, high = float(heights.min()), float(heights.max())
    step = max(HEIGHT_STEP, (high - low) / MAX_HEIGHTS)
    counts = np.bincount(np.round((heights - low) / step).astype(np.int64))
    steps = np.flatnonzero(counts)
    length = np.concatenate([[0.0], np.cumsum(np.cbrt(np.diff(steps)))])
    # flat floors look flat: a few centimetres are a part of the scale, not all of it
    spread = max(float(length[-1]), MIN_LENGTH)
    positions = 0.5 + (length - length[-1] / 2) / spread
    values = low + steps * step
    at = zip(positions.tolist(), values.tolist(), strict=True)
    ticks = _choose_ticks([Tick(p, f"{v + 0.0:.2f}") for p, v in at], counts[steps])
    if positions[0] > 0:
        positions = np.concatenate([[0.0], positions, [1.0]])
        values = np.concatenate([[low - step], values, [values[-1] + step]])
    return ColorScale(label, tuple(values.tolist()), tuple(positions.tolist()), ticks)


def _choose_ticks(ticks: list[Tick], areas: NDArray[np.int64]) -> tuple[Tick, ...]:
    """That of the largest area, the ends, and those of the next largest, none too close."""
    order = np.argsort(-areas, kind="stable").tolist()
    chosen: list[Tick] = []
    for number in [order[0], 0, len(ticks) - 1, *order]:
        tick = ticks[number]
        if all(abs(tick.position - other.position) >= TICK_GAP for other in chosen):
            chosen.append(tick)
        if len(chosen) == MAX_TICKS:
            break
    return tuple(sorted(chosen))
