"""The connected parts of free cells, through all levels: connected components by union-find."""

import numpy as np

from navbake.compiled import kernel, part
from navbake.navgrid.kernels.union_find import unite


@kernel
def label_islands(start, width, free, floor, limit, links):
    """Number the parts by the rule of `navbake.navgrid.islands.find_islands`.

    The cells of all levels are in one row, by flat id: those of level i from ``start[i]`` to
    ``start[i + 1]``, in rows of ``width[i]``. `limit` is in the unit of the floors, and `links`
    are pairs of flat ids, shape (m, 2), int64.

    Returns:
        The part of each cell, shape (n,), int32, 0 where it isn't free; and the number of cells
        of each part, shape (num_parts + 1,), int64, 0 for part 0.
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


@part
def _join(parent, cell, other, floor, limit):
    if parent[other] >= 0 and not abs(np.float64(floor[cell]) - np.float64(floor[other])) > limit:
        unite(parent, cell, other)


@part
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
    size, largest = np.zeros(num_parts + 1, dtype=np.int64), 0
    for cell in range(len(parent)):
        if number[cell] > 0:
            size[number[cell]] += 1
            largest = max(largest, size[number[cell]])
    # a counting sort, so that equal parts stay in the order of their roots
    before = np.zeros(largest + 1, dtype=np.int64)
    for number_of in range(1, num_parts + 1):
        before[size[number_of]] += 1
    larger = 0
    for cells in range(largest, 0, -1):
        larger += before[cells]
        before[cells] = larger - before[cells]
    rank, ranked = np.zeros(num_parts + 1, dtype=np.int32), np.zeros(num_parts + 1, dtype=np.int64)
    for number_of in range(1, num_parts + 1):
        before[size[number_of]] += 1
        rank[number_of] = before[size[number_of]]
        ranked[rank[number_of]] = size[number_of]
    for cell in range(len(parent)):
        number[cell] = rank[number[cell]]
    return number, ranked
