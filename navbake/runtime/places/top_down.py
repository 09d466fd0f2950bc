"""A picture of a level from above, as an array."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import check_level
from navbake.runtime.places.sample import Number
from navbake.views.colors import FREE, NO_FLOOR, OCCUPIED, rgb_of

if TYPE_CHECKING:
    from navbake.runtime.flat_grid import Walk

MAX_PIXELS = 1 << 28


def draw_top_down(
    walk: Walk, level: int, metres_per_pixel: float | None = None
) -> NDArray[np.uint8]:
    """Draw where on a level an agent can stand.

    The first row is the largest y, the first column the smallest x, as in the grid's arrays.

    Args:
        walk: the grid.
        level: which level, 0 is the lowest.
        metres_per_pixel: [m], > 0; a pixel a cell unless given. A pixel shows the cell that its
            middle is in.

    Returns:
        Red, green and blue, shape (rows, cols, 3), uint8, in the colours of ``navbake plot``:
        free, blocked, no floor.

    Raises:
        QueryError: there is no such level, or the pixels are none or too many.
    """
    if level is None:
        raise QueryError(f"expected a level, 0 to {walk.num_levels - 1}, got None")
    check_level(level, walk.num_levels)
    shape = int(walk.height[level]), int(walk.width[level])
    cells = slice(int(walk.start[level]), int(walk.start[level + 1]))
    kind = np.where(walk.free[cells], 0, np.where(np.isnan(walk.floor[cells]), 2, 1)).reshape(shape)
    if metres_per_pixel is not None:
        cell = float(walk.cell_size[level])
        is_number = isinstance(metres_per_pixel, Number)
        if not (is_number and 0 < metres_per_pixel < math.inf):
            raise QueryError(f"expected metres_per_pixel > 0, got {metres_per_pixel!r}")
        pixels = [math.ceil(n * cell / metres_per_pixel - 1e-6) for n in shape]
        if math.prod(pixels) > MAX_PIXELS:
            raise QueryError(f"{pixels[1]} × {pixels[0]} pixels are too many: make them larger")
        rows, cols = (
            np.minimum(((np.arange(count) + 0.5) * metres_per_pixel / cell).astype(int), n - 1)
            for count, n in zip(pixels, shape, strict=True)
        )
        kind = kind[rows[:, None], cols]
    palette = np.array([rgb_of(FREE), rgb_of(OCCUPIED), rgb_of(NO_FLOOR)], dtype=np.uint8)
    return palette[kind]
