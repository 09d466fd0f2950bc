"""The colours of pictures, as ``#rrggbb``.

They are chosen so that people who see no red or no green tell them apart, too:
`tests/views/test_colors.py` measures how far apart they stay. What is free is light, what is
blocked is dark, so that a picture printed in grey still reads.
"""

import numpy as np
from numpy.typing import NDArray

FREE, OCCUPIED, NO_FLOOR = "#f7f3e8", "#3b4252", "#b9c0cc"
DOOR = "#c8440a"  # where a door blocks the way
DOORWAY = "#ff9f5a"  # where it would, were it closed
ROUTE = "#1864ab"
MARKS = ("#d24bff", "#0f875a", "#a5a50f", "#780f96", "#f07896", "#4b4b00")  # by kind

OUTDOORS = "#e2ecba"
ROOMS = ("#a6ceb0", "#cec4f6", "#ecec88", "#60b09c", "#b092f6", "#c0f0f8")
BLOCKED_SHARE = 0.55  # of `OCCUPIED` in the colour of a room where something stands in it
DARKER = "#6b6f78"  # stands in the legend for all rooms' darker colours

UP, DOWN, ACROSS = MARKS[1], MARKS[3], MARKS[0]  # where a link leads


def rgb_of(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour like ``#f7f3e8``."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def darkened(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The colours of rooms, shape (…, 3), where something stands in them."""
    mixed = rgb * (1 - BLOCKED_SHARE) + np.array(rgb_of(OCCUPIED)) * BLOCKED_SHARE
    return np.round(mixed).astype(np.uint8)
