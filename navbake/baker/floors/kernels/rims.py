"""The rims of sheets: which of their edges are those of holes."""

import numpy as np

from navbake.baker.kernels.connect import find_root, unite
from navbake.compiled import kernel

NONE, INNER = np.int32(-1), np.int32(-2)


@kernel(nogil=True)
def mark_holes(cells, ways, start, lattice, in_hole):
    """Mark the edges at the rims of holes, of sheets with the edges ``start[n]:start[n + 1]``.

    A rim's edges are connected by the cells beyond them, which meet at an edge or a corner. At a
    corner, either of the two cells between them is none of the sheet's. The outer rim has the first
    of these cells.
    """
    # a margin around the lattice, and an empty column between two rows
    width, wide = lattice.width, lattice.width + 3
    out = np.array([1, wide, -1, -wide])  # the ways east, south, west and north
    # INNER on this side of an edge; beyond it, the parents of union-find, by place
    parent = np.full(wide * (lattice.height + 3), NONE)
    inner, outer = np.empty((2, cells.shape[0]), np.int64)
    for s in range(start.shape[0] - 1):
        first, end = start[s], start[s + 1]
        least = np.int64(parent.shape[0])
        for n in range(first, end):
            inner[n] = (cells[n] // width + 1) * wide + cells[n] % width + 1
            outer[n] = inner[n] + out[ways[n]]
            least = min(least, outer[n])
            parent[inner[n]], parent[outer[n]] = INNER, outer[n]
        for n in range(first, end):
            place = outer[n]
            for beside in (place + 1, place + wide - 1, place + wide, place + wide + 1):
                if parent[beside] < 0:
                    continue
                at_corner = beside != place + 1 and beside != place + wide
                if at_corner and parent[beside - wide] == INNER and parent[place + wide] == INNER:
                    continue
                unite(parent, place, beside)
        for n in range(first, end):
            in_hole[n] = find_root(parent, outer[n]) != least
        for n in range(first, end):
            parent[inner[n]] = parent[outer[n]] = NONE
