"""The colours of pictures, as ``#rrggbb``."""

import colorsys

import numpy as np
from numpy.typing import NDArray

FREE, OCCUPIED, NO_FLOOR, DOOR = "#f7f3e8", "#3b4252", "#b9c0cc", "#c0392b"
DARKER = "#8f8f8f"  # stands in the legend for all rooms' darker colours
ROUTE = "#d6336c"
MARKS = ("#d6336c", "#1c7ed6", "#e8590c", "#2b8a3e", "#7048e8", "#0b7285")  # by kind

# Hues a golden ratio of a turn apart stay apart, however many there are
GOLDEN = 0.618034
FIRST_HUE = 0.58
SHADES = ((0.5, 0.97), (0.25, 0.95), (0.6, 0.87))  # saturation and value, in turn


def rgb_of(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour like ``#f7f3e8``."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def make_palette(count: int) -> NDArray[np.uint8]:
    """A colour for each number from 1, shape (count + 1, 3), uint8; 0 is black."""
    colors = [(0.0, 0.0, 0.0)]
    for number in range(count):
        saturation, value = SHADES[number % len(SHADES)]
        colors.append(colorsys.hsv_to_rgb((FIRST_HUE + number * GOLDEN) % 1.0, saturation, value))
    return np.round(np.array(colors) * 255).astype(np.uint8)
