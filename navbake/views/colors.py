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
MARKS = ("#d6336c", "#1c7ed6", "#e8590c", "#2b8a3e", "#7048e8", "#0b7285")  # by kind

OUTDOORS = "#e2ecba"
ROOMS = ("#b092f6", "#ecec88", "#60b09c", "#cec4f6", "#a6ceb0", "#a69cc4")
BLOCKED_SHARE = 0.55  # of `OCCUPIED` in the colour of a room where something stands in it
DARKER = "#6b6f78"  # stands in the legend for all rooms' darker colours

UP, DOWN, ACROSS = "#2b8a3e", "#7048e8", "#1c7ed6"  # where a link leads


def rgb_of(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour like ``#f7f3e8``."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def darkened(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The colours of rooms, shape (…, 3), where something stands in them."""
    mixed = rgb * (1 - BLOCKED_SHARE) + np.array(rgb_of(OCCUPIED)) * BLOCKED_SHARE
    return np.round(mixed).astype(np.uint8)
