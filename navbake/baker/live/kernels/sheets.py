"""Sheets of surfaces in a region: their parts there, and how far a part goes on outside.

Connected components by union-find in the region; outside, breadth-first search on the pool.
"""

import numpy as np

from navbake.baker.floors.kernels.enclosed import find_holders
from navbake.baker.floors.kernels.sheets import mark_surfaces, neighbour
from navbake.baker.kernels.constants import SLACK
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.navgrid.kernels.union_find import find_root, unite


@part(inline="always")
def _end_of_run(cells, n, end):
    """Where the run of consecutive cells ends that begins with the n-th."""
    m = n + 1
    while m < end and cells[m] == cells[m - 1] + 1:
        m += 1
    return m


@kernel(nogil=True, **UNCOUNTED)
def mark_region(lattice, cells, crossings, planes, limits, marks, count, first, end):
    """`mark_surfaces` for some cells alone, ``cells[first:end]``, run by run.

    ``crossings.start`` and `count` are by cell id; `marks` are `floor_like` and `standable`.
    """
    floor_like, standable = marks
    n = first
    while n < end:
        m = _end_of_run(cells, n, end)
        begin, past = cells[n], cells[m - 1] + 1
        mark_surfaces(lattice, crossings, planes, limits, floor_like, standable, count, begin, past)
        n = m


@kernel(nogil=True)
def hold_region(lattice, cells, crossings, planes, limits, holder):
    """`find_holders` for some cells alone; ``crossings.start`` is by cell id."""
    n = 0
    while n < cells.shape[0]:
        m = _end_of_run(cells, n, cells.shape[0])
        find_holders(lattice, crossings, planes, limits, holder, cells[n], cells[m - 1] + 1)
        n = m


@kernel(nogil=True)
def group_parts(part, num):
    """The surfaces of each part, ascending: ``order[bounds[k]:bounds[k + 1]]``; a counting sort.

    `part` is (n,) int64, -1 for surfaces that belong to none of the `num` parts.
    """
    bounds = np.zeros(num + 1, np.int64)
    for i in range(part.shape[0]):
        if part[i] >= 0:
            bounds[part[i] + 1] += 1
    for k in range(num):
        bounds[k + 1] += bounds[k]
    place, order = bounds[:-1].copy(), np.empty(bounds[num], np.int64)
    for i in range(part.shape[0]):
        if part[i] >= 0:
            order[place[part[i]]] = i
            place[part[i]] += 1
    return order, bounds


@kernel(nogil=True)
def only_sheets(part, sheet, num):
    """The one sheet that surfaces of each part belong to: -1 for none, -2 for several, (num,).

    `part` is (n,) int64; `sheet`, (n,) int32, -1 for those that belong to none.
    """
    only = np.full(num, -1, np.int64)
    for i in range(part.shape[0]):
        known = only[part[i]]
        if sheet[i] >= 0 and known != sheet[i]:
            only[part[i]] = sheet[i] if known == -1 else -2
    return only


@kernel(nogil=True)
def label_region(lattice, cells, start, z, step, local):
    """The connected part of each surface of a region, (n,) int64.

    Neighbours hang together that are at most a step apart. `start` is by number of the region's
    cells; `local`, (all cells,) int32, is -1 everywhere, and so again afterwards. Returns also how
    many parts there are; they are numbered by their first surfaces.
    """
    for n in range(cells.shape[0]):
        local[cells[n]] = n
    parent = np.arange(z.shape[0])
    for n in range(cells.shape[0]):
        for way in range(2):
            other = neighbour(lattice, cells[n], way)
            if other < 0 or local[other] < 0:
                continue
            m = local[other]
            for a in range(start[n], start[n + 1]):
                for b in range(start[m], start[m + 1]):
                    if abs(z[a] - z[b]) <= step + SLACK:
                        unite(parent, a, b)
    part, num = np.empty(z.shape[0], np.int64), 0
    for i in range(z.shape[0]):
        root = find_root(parent, i)
        if root == i:
            part[i] = num
            num += 1
        else:
            part[i] = part[root]
    for cell in cells:
        local[cell] = -1
    return part, num


@kernel(nogil=True)
def explore(lattice, pool, step, cells, places, sheet, mark, most):
    """Go from some surfaces to all of their sheet that hang together with them.

    Args:
        cells, places: the cells of the surfaces to begin with, and their places in the pool.
        sheet: only surfaces of it are gone to.
        mark: by place in the pool, bool, False everywhere, and so again afterwards.
        most: how many surfaces are visited at most.

    Returns:
        Whether these are all; and cells and places of the visited surfaces.
    """
    room = max(4 * places.shape[0], 1024)
    queue_cell, queue_place = np.empty(room, np.int64), np.empty(room, np.int64)
    begin, end = 0, places.shape[0]
    queue_cell[:end], queue_place[:end] = cells, places
    for place in places:
        mark[place] = True
    while begin < end <= most:
        cell, z = queue_cell[begin], pool.z[queue_place[begin]]
        begin += 1
        for way in range(4):
            other = neighbour(lattice, cell, way)
            if other < 0:
                continue
            for j in range(pool.first[other], pool.first[other] + pool.length[other]):
                if pool.sheet[j] != sheet or mark[j] or abs(pool.z[j] - z) > step + SLACK:
                    continue
                if end == queue_cell.shape[0]:
                    queue_cell = np.concatenate((queue_cell, np.empty_like(queue_cell)))
                    queue_place = np.concatenate((queue_place, np.empty_like(queue_place)))
                mark[j] = True
                queue_cell[end], queue_place[end] = other, j
                end += 1
    for place in queue_place[:end]:
        mark[place] = False
    return begin == end, queue_cell[:end].copy(), queue_place[:end].copy()
