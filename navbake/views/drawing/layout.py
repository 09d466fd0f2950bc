"""Where the panels of a picture lie."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

# All lengths are inches. A picture is 8.3 inches wide at most, 830 pixels of a README at 100 an
# inch: letters of 8 points are 11 pixels high there.
WIDTH = 8.3
MIN_WIDTH = 4.6  # so that the legend has space
MAX_HEIGHT = 300.0
MARGIN = 0.12
HEADING = 0.34  # the picture's title
TITLE = 0.27  # a panel's
LEFT, BELOW = 0.42, 0.3  # the numbers on the axes
BAR, BAR_GAP, BAR_NUMBERS = 0.1, 0.08, 0.46  # the bar of a colour scale and its numbers
GAP = 0.14  # between panels
MAX_MAP_HEIGHT = 5.6
MIN_MAP = 0.02  # least side of a map
MIN_SLOT = 2.3  # least width of a panel, so that its title has space
MAX_COLUMNS = 3
WIDE = 2.4  # maps so much wider than high lie below each other


class Layout(NamedTuple):
    """The place of each panel of a picture [inches from its lower left corner]."""

    width: float
    height: float
    map_size: tuple[float, float]  # the same for all panels
    title_widths: tuple[float, ...]  # what each panel's title has
    corners: tuple[tuple[float, float], ...]  # lower left one of each map


def plan_layout(
    extent: tuple[float, float], num_levels: int, bars: Sequence[bool], *, footer: float
) -> Layout:
    """Place the panels of a picture: those of a level in a row, if they fit.

    Levels of one layer lie beside each other. Corridors lie below each other, as wide as the
    picture.

    Args:
        extent: width and height of what all panels show [m].
        num_levels: how many levels there are.
        bars: of each layer, whether it has a colour scale.
        footer: height of the scale bar and the legend.
    """
    is_wide = extent[0] > WIDE * extent[1]
    num_layers = len(bars)
    in_line = num_layers if num_layers > 1 else num_levels
    columns = 1 if is_wide else min(in_line, MAX_COLUMNS)
    rows_each = math.ceil(num_layers / columns)  # of a level
    rows = num_levels * rows_each if num_layers > 1 else math.ceil(num_levels / columns)

    has_bar = [any(bars[column::columns] if num_layers > 1 else bars) for column in range(columns)]
    around_x = [LEFT + GAP + (BAR_GAP + BAR + BAR_NUMBERS if bar else 0.0) for bar in has_bar]
    around_y = TITLE + BELOW
    wide = (WIDTH - 2 * MARGIN - sum(around_x)) / columns
    high = min(MAX_MAP_HEIGHT, (MAX_HEIGHT - HEADING - footer) / rows - around_y)
    scale = min(wide / extent[0], max(high, MIN_MAP) / extent[1])
    map_size = max(extent[0] * scale, MIN_MAP), max(extent[1] * scale, MIN_MAP)

    slots = [map_size[0] + around for around in around_x]
    spare = (WIDTH - 2 * MARGIN - sum(slots)) / columns
    slots = [slot + max(0.0, min(MIN_SLOT - slot, spare)) for slot in slots]
    width = max(sum(slots) + 2 * MARGIN, MIN_WIDTH)
    height = HEADING + rows * (map_size[1] + around_y) + footer
    corners, title_widths = [], []
    for level in range(num_levels):
        for layer in range(num_layers):
            row, column = divmod(layer if num_layers > 1 else level, columns)
            row += level * rows_each if num_layers > 1 else 0
            top = height - HEADING - row * (map_size[1] + around_y)
            left = MARGIN + sum(slots[:column]) + LEFT
            corners.append((left, top - TITLE - map_size[1]))
            title_widths.append(slots[column] - LEFT - GAP)
    return Layout(width, height, map_size, tuple(title_widths), tuple(corners))
