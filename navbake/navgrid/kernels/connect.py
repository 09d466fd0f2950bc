"""Connected parts of graphs, of cells and of the free cells of all levels, by union-find.

Disjoint sets as a forest of parents (Galler and Fischer, 1964) with path halving (Tarjan and van
Leeuwen, 1984). Of two roots the lower item becomes the parent, not that of the larger tree: so a
root is the first member of its set, whatever the order in which sets were joined, and numbers
that follow the roots depend on nothing else. Path halving alone keeps the trees shallow enough.
"""

import numpy as np

from navbake.compiled import UNCOUNTED, kernel, part


@part(**UNCOUNTED)
def find_root(parent, item):
    """The root of an item's set, its lowest member; of roots, `parent` has themselves."""
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@part(**UNCOUNTED)
def unite(parent, one, other):
    """Join the sets of two items."""
    one, other = find_root(parent, one), find_root(parent, other)
    if one != other:
        parent[max(one, other)] = min(one, other)


@kernel
def number_parts(pairs, count):
    """Number the connected parts of a graph from 0, by their first nodes.

    Pairs of nodes that hang together are (2, n) int64. Returns the part of each of `count` nodes,
    int32.
    """
    parent = np.arange(count)
    for k in range(pairs.shape[1]):
        unite(parent, pairs[0, k], pairs[1, k])
    part = np.empty(count, dtype=np.int32)
    parts = 0
    for node in range(count):
        root = find_root(parent, node)
        if root == node:
            part[node] = parts
            parts += 1
        else:
            part[node] = part[root]
    return part


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
