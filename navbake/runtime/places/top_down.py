"""A picture of a level from above, as an array."""

import math

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import check_level
from navbake.navgrid.colors import FREE, NO_FLOOR, OCCUPIED, rgb_of
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.places.checks import REAL

MAX_PIXELS = 1 << 28


def draw_top_down(flat: FlatGrid, level: int, metres_per_pixel: float | None) -> NDArray[np.uint8]:
    """`PathFinder.top_down`."""
    if level is None:
        raise QueryError(f"expected a level, 0 to {flat.num_levels - 1}, got None")
    check_level(level, flat.num_levels)
    shape = int(flat.layout.height[level]), int(flat.layout.width[level])
    cells = flat.cells_of(level)
    has_floor = ~np.isnan(flat.floors.z[cells])
    kind = np.where(flat.free[cells], 0, np.where(has_floor, 1, 2)).reshape(shape)
    if metres_per_pixel is not None:
        cell = float(flat.layout.cell_size[level])
        if not (isinstance(metres_per_pixel, REAL) and 0 < metres_per_pixel < math.inf):
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
