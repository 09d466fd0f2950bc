"""The connected parts of a grid as it is now, and their areas."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.runtime.flat_grid import FlatGrid
from navbake.types import Float, Int, Int32

# Functions import kernels when they run: numba takes long to load.


@dataclass(frozen=True, eq=False)
class IslandMap:
    """Islands by number, from 1, the one of the most cells.

    Attributes:
        number: of each cell, by flat id, shape (n,), int32; 0 where it isn't free.
        areas: of each island [m²], shape (count + 1,), float64; 0 for number 0.
    """

    number: Int32
    areas: Float

    @property
    def count(self) -> int:
        """Number of islands."""
        return len(self.areas) - 1

    def check(self, island: int) -> int:
        """Raise QueryError for the number of an unknown island."""
        if isinstance(island, int | np.integer) and 1 <= island <= self.count:
            return int(island)
        there_are = f"1 to {self.count}, 1 the largest" if self.count else "none"
        raise QueryError(f"no island {island!r}: there are {there_are}")


def map_islands(flat: FlatGrid, corners: NDArray[np.uint8] | None = None) -> IslandMap:
    """Find the islands of a grid, by the rule of `navbake.navgrid.islands.find_islands`.

    `corners` are the moves of each cell, see `navbake.runtime.kernels.moves`, where corners may be
    cut: then diagonal ones join cells that nothing else does.
    """
    from navbake.navgrid.kernels.islands import label_islands  # saves numba at start-up

    layout, floors = flat.layout, flat.floors
    links = np.stack(flat.link_ends(), axis=1)
    if corners is not None:
        links = np.concatenate([links, _over_corners(flat, corners)])
    number, sizes = label_islands(
        layout.start, layout.width, flat.free, floors.z, floors.max_step, links
    )
    # one size of cells on all levels is the rule; else each level's cells count by their own area
    areas = sizes * layout.cell_size[0] ** 2
    if len(set(layout.cell_size)) > 1:
        areas = np.zeros(len(sizes))
        for level, size in enumerate(layout.cell_size):
            of_level = number[flat.cells_of(level)]
            areas += np.bincount(of_level, minlength=len(sizes)) * size**2
        areas[0] = 0.0
    return IslandMap(number, areas)


def _over_corners(flat: FlatGrid, moves: NDArray[np.uint8]) -> Int:
    """The pairs of cells that a diagonal move joins, shape (n, 2)."""
    from navbake.runtime.kernels.moves import SOUTH_EAST, SOUTH_WEST

    pairs = []
    for bit, across in ((SOUTH_WEST, -1), (SOUTH_EAST, 1)):
        cells = np.flatnonzero(moves & bit)
        width = flat.layout.width[flat.level_of(cells)]
        pairs.append(np.stack([cells, cells + width + across], axis=1))
    return np.concatenate(pairs)
