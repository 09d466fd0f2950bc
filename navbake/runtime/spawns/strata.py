"""Parts of the cells that agents are drawn from, and how many are drawn from each."""

import numpy as np

from navbake.errors import QueryError
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.grid_cache import GridCache
from navbake.types import Int

STRATA = ("area", "room", "island")


def parts_of_area(flat: FlatGrid, cells: Int, n: int, start: float) -> list[Int]:
    """Cut cells, ordered by `along_hilbert`, into n parts of one area each; some may be empty.

    The first part begins at a share `start` of the whole, and parts run on from its end to its
    beginning. So with a random start each cell is as likely as its area has it.

    Source: He and Owen, "Extensible grids: uniform sampling on a space filling curve" (2016).
    """
    ends = np.cumsum(flat.layout.cell_size[flat.level_of(cells)] ** 2)
    # a cell belongs to the part that its middle is in
    middle = (ends - np.diff(ends, prepend=0.0) / 2) / ends[-1]
    part = np.floor(((middle - start) % 1.0) * n).astype(np.int64)
    order = np.argsort(part, kind="stable")
    return np.split(cells[order], np.searchsorted(part[order], np.arange(1, n)))


def parts_of_regions(cache: GridCache, cells: Int, kind: str) -> list[Int]:
    """The cells of each room or island; those in none are left out."""
    numbers = (cache.rooms.number if kind == "room" else cache.islands.number)[cells]
    cells, numbers = cells[numbers > 0], numbers[numbers > 0]
    if not len(cells):
        raise QueryError(f"no {kind} of {cache.grid.scene_id!r} has a free cell to spawn on")
    order = np.argsort(numbers, kind="stable")
    _, first = np.unique(numbers[order], return_index=True)
    return np.split(cells[order], first[1:])


def share_out(n: int, num_parts: int, rng: np.random.Generator) -> Int:
    """The part of each of n agents: as many in each, give or take one, in random order."""
    whole = np.tile(np.arange(num_parts), n // num_parts)
    rest = rng.permutation(num_parts)[: n % num_parts]
    return rng.permutation(np.concatenate([whole, rest]))


def along_hilbert(flat: FlatGrid, cells: Int) -> Int:
    """Cells in the order of Hilbert's curve, level by level: neighbours in the row are near."""
    level, row, col = flat.split(cells)
    return cells[np.lexsort((_hilbert_index(row, col), level))]


def _hilbert_index(row: Int, col: Int) -> Int:
    """How far along Hilbert's curve (1891) each cell of a square of 2^k by 2^k cells is."""
    x, y, index = col.copy(), row.copy(), np.zeros_like(row)
    side = 1 << max(int(max(row.max(initial=0), col.max(initial=0))).bit_length() - 1, 0)
    while side:
        right, lower = (x & side > 0).astype(np.int64), (y & side > 0).astype(np.int64)
        index += side * side * ((3 * right) ^ lower)
        # each quarter holds the curve of half the size, turned or mirrored to fit
        mirrored = (lower == 0) & (right == 1)
        x, y = np.where(mirrored, side - 1 - x, x), np.where(mirrored, side - 1 - y, y)
        x, y = np.where(lower == 0, y, x), np.where(lower == 0, x, y)
        x, y = x & (side - 1), y & (side - 1)
        side >>= 1
    return index
