"""The connected parts of free cells, through all levels: connected components by union-find."""

import numpy as np
from numba import njit

from navbake.navgrid.kernels.union_find import unite


@njit(cache=True)
def label_islands(start, width, free, floor, limit, links):
    """Number the connected parts of free cells, the largest first.

    Two free cells are joined where they share an edge and their floors differ by at most `limit`,
    or where a link leads. NaN differs from nothing.

    Args:
        start: first flat id of each level, and one past the last, shape (num_levels + 1,), int64.
        width: number of columns of each level, shape (num_levels,), int64.
        free: by flat id, shape (n,), bool, n >= 1.
        floor: by flat id, shape (n,), float32 or float64.
        limit: in the unit of the floors.
        links: flat ids of two cells each, shape (m, 2), int64.

    Returns:
        Shape (n,), int32: 0 where the cell isn't free, else its part from 1; and the number of
        cells of each part, shape (num_parts + 1,), int64, 0 for part 0. Of parts of equal size,
        the one with the lowest flat id comes first.
    """
    parent = np.empty(len(free), dtype=np.int32)
    for level in range(len(width)):
        first, columns = start[level], width[level]
        for cell in range(first, start[level + 1]):
            if not free[cell]:
                parent[cell] = -1
                continue
            parent[cell] = cell
            if (cell - first) % columns > 0:
                _join(parent, cell, cell - 1, floor, limit)
            if cell - first >= columns:
                _join(parent, cell, cell - columns, floor, limit)
    for i in range(len(links)):
        one, other = links[i, 0], links[i, 1]
        if parent[one] >= 0 and parent[other] >= 0:
            unite(parent, one, other)
    return _rank(parent)


@njit(cache=True)
def _join(parent, cell, other, floor, limit):
    if parent[other] >= 0 and not abs(np.float64(floor[cell]) - np.float64(floor[other])) > limit:
        unite(parent, cell, other)


@njit(cache=True)
def _rank(parent):
    """Number the parts by size; a root is the lowest cell of its part."""
    number = np.zeros(len(parent), dtype=np.int32)
    num_parts = 0
    for cell in range(len(parent)):
        if parent[cell] == cell:
            num_parts += 1
            number[cell] = num_parts
        elif parent[cell] >= 0:
            parent[cell] = parent[parent[cell]]  # the cells before this one point at their roots
            number[cell] = number[parent[cell]]
    size = np.bincount(number)
    size[0] = 0
    # a stable sort, so that equal parts stay in the order of their roots; part 0 stays first
    order = np.argsort(-size[1:], kind="mergesort") + 1
    rank = np.zeros(num_parts + 1, dtype=np.int32)
    rank[order] = np.arange(1, num_parts + 1)
    size[1:] = size[order]
    return rank[number], size
