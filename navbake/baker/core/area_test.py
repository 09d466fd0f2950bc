"""Whether cells are enough for a floor: `floors.min_area` after `floors.shrink`."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.config.settings import FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int


class AreaTest(NamedTuple):
    """Whether a set of cells is large enough for a floor: how many are left when it is shrunk.

    Attributes:
        needed: how many cells have to be left.
        reach: the radius of the disc around a cell that is left, all of the set [cells].
        half: of each row of the disc, from ``-reach`` to `reach`, how far it reaches to either
            side, -1 for a row that need not be looked at, int64.
    """

    min_cells: int
    radius: int
    half_widths: Int


@lru_cache(maxsize=4)  # several tests of a scene ask for the same, and so do scenes of a batch
def disc_half_widths(limit: float, shorter: int) -> Int:
    """`AreaTest.half` of the cells nearer than a limit [cells]; don't change it.

    Where no cell of the lattice, by its `shorter` side, is as far from outside as the limit, the
    disc's own row and its last ones are enough, of which one always leads out.
    """
    out = (shorter + 1) // 2
    if limit > out:
        half = np.full(2 * out + 1, -1, dtype=np.int64)
        half[out] = out
        half[[0, -1]] = 0
        return half
    away = np.arange(-int(np.ceil(limit)), int(np.ceil(limit)) + 1)
    near = np.sqrt(away[:, None] ** 2 + away**2) < limit
    half = np.where(near, away, np.int64(-1)).max(axis=1, initial=-1)
    return np.asarray(half[half >= 0], dtype=np.int64)


def area_test(lattice: Lattice, settings: FloorSettings) -> AreaTest:
    """The test of `min_area` after shrinking, which leaves centres `shrink` from the set's edge."""
    needed = int(np.ceil(max((settings.min_area - LIMIT_SLACK) / lattice.cell_size**2, 0.0)))
    limit = (settings.shrink - LIMIT_SLACK) / lattice.cell_size + 0.5
    half = disc_half_widths(limit, min(lattice.width, lattice.height))
    return AreaTest(needed, len(half) // 2, half)


def is_large_enough(lattice: Lattice, settings: FloorSettings, marked: Bool) -> bool:
    """Whether the marked cells of a lattice are enough for a floor, see `area_test`."""
    test = area_test(lattice, settings)
    padded = np.pad(marked.reshape(lattice.shape), test.radius)
    remaining = np.flatnonzero(padded)
    for row, half in enumerate(test.half_widths.tolist(), start=-test.radius):
        for col in range(-half, half + 1):
            remaining = remaining[padded.ravel()[remaining + row * padded.shape[1] + col]]
    return len(remaining) >= test.min_cells
