"""The area test of floors: is enough area (`floors.min_area`) left after `floors.shrink`?

Regions of floor, grounds of levels, and the room that a mesh's hull hides have to pass it.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.config.settings import FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int


class AreaTest(NamedTuple):
    """The area test of floors: cells are eroded by a disc, and enough of them have to remain.

    Attributes:
        min_cells: how many cells have to remain.
        radius: radius of the disc [cells]. A marked cell remains if all cells of the disc around it
            are marked, too.
        half_widths: for each row of the disc, from ``-radius`` to `radius`, how many cells the row
            has on either side of its middle, (2 radius + 1,) int64; -1 for rows that need no test.
    """

    min_cells: int
    radius: int
    half_widths: Int


@lru_cache(maxsize=4)  # several tests of a scene need the same disc, and so do scenes of a batch
def disc_half_widths(disc_radius: float, shorter_side: int) -> Int:
    """Compute the half width of each row of a disc of cells, for `AreaTest.half_widths`.

    The disc has the cells that are nearer to its centre than the radius. If the lattice is too
    narrow for the disc, no cell can remain after erosion, as the disc's first, middle or last row
    is always partly outside. Then only these three rows have a half width, and all others -1.

    Args:
        disc_radius: the radius, which need not be a whole number [cells].
        shorter_side: number of rows or columns of the lattice, whichever is smaller.

    Returns:
        The half widths, shape (2 radius + 1,). The array is shared between calls: don't change it.
    """
    max_radius = (shorter_side + 1) // 2
    if disc_radius > max_radius:
        half_widths = np.full(2 * max_radius + 1, -1, dtype=np.int64)
        half_widths[max_radius] = max_radius
        half_widths[[0, -1]] = 0
        return half_widths
    cells_from_center = np.arange(-int(np.ceil(disc_radius)), int(np.ceil(disc_radius)) + 1)
    is_in_disc = np.sqrt(cells_from_center[:, None] ** 2 + cells_from_center**2) < disc_radius
    half_widths = np.where(is_in_disc, cells_from_center, np.int64(-1)).max(axis=1, initial=-1)
    return np.asarray(half_widths[half_widths >= 0], dtype=np.int64)


def make_area_test(lattice: Lattice, settings: FloorSettings) -> AreaTest:
    """Make the area test of the settings: erosion by `shrink`, after which `min_area` is left.

    Args:
        lattice: the cells.
        settings: settings of `floors`; `min_area` [m²] and `shrink` [m] are used.
    """
    min_cells = int(np.ceil(max((settings.min_area - LIMIT_SLACK) / lattice.cell_size**2, 0.0)))
    disc_radius = (settings.shrink - LIMIT_SLACK) / lattice.cell_size + 0.5
    half_widths = disc_half_widths(disc_radius, min(lattice.width, lattice.height))
    return AreaTest(min_cells, len(half_widths) // 2, half_widths)


def is_large_enough(lattice: Lattice, settings: FloorSettings, is_marked: Bool) -> bool:
    """Return whether marked cells are enough for a floor: `min_area` is left after erosion.

    Args:
        lattice: the cells.
        settings: settings of `floors`; `min_area` [m²] and `shrink` [m] are used.
        is_marked: mask of the cells, shape (cells,) or (height, width), bool.
    """
    return keeps_min_cells(make_area_test(lattice, settings), is_marked.reshape(lattice.shape))


def keeps_min_cells(area_test: AreaTest, is_marked: Bool) -> bool:
    """Return whether the marked cells of a window pass an area test: enough remain after erosion.

    Args:
        area_test: the area test of the lattice.
        is_marked: mask of the window's cells, shape (rows, cols); cells beside the window aren't
            marked.
    """
    is_marked_padded = np.pad(is_marked, area_test.radius)
    remaining_cells = np.flatnonzero(is_marked_padded)
    for row, half_width in enumerate(area_test.half_widths.tolist(), start=-area_test.radius):
        for col in range(-half_width, half_width + 1):
            remaining_cells = remaining_cells[
                is_marked_padded.ravel()[remaining_cells + row * is_marked_padded.shape[1] + col]
            ]
    return len(remaining_cells) >= area_test.min_cells
