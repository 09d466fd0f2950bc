"""Regions: ascending lists of cells that something is asked about."""

import math

import numpy as np
from numba import njit

from navbake.baker.floors.kernels.sheets import neighbour
from navbake.navgrid.kernels.union_find import find_root, unite


@njit(cache=True)
def cells_of_boxes(lattice, boxes, grow, flag):
    """The cells whose centres lie in boxes, (n, 6) [m], grown by `grow` [m] and a cell, ascending.

    `flag`, (cells,) bool, is all False, and so again afterwards.
    """
    size, count = lattice.cell_size, 0
    ranges = np.zeros((boxes.shape[0], 4), np.int64)
    for n in range(boxes.shape[0]):
        # clipped before they are whole numbers, which a far box would exceed
        left = (boxes[n, 0] - grow - lattice.x_min) / size - 1.5
        right = (boxes[n, 3] + grow - lattice.x_min) / size + 0.5
        top = (lattice.y_max - boxes[n, 4] - grow) / size - 1.5
        bottom = (lattice.y_max - boxes[n, 1] + grow) / size + 0.5
        ranges[n, 0] = math.floor(min(max(top, 0.0), lattice.height))
        ranges[n, 1] = math.ceil(min(max(bottom + 1.0, 0.0), lattice.height))
        ranges[n, 2] = math.floor(min(max(left, 0.0), lattice.width))
        ranges[n, 3] = math.ceil(min(max(right + 1.0, 0.0), lattice.width))
        for row in range(ranges[n, 0], ranges[n, 1]):
            for col in range(ranges[n, 2], ranges[n, 3]):
                cell = row * lattice.width + col
                if not flag[cell]:
                    flag[cell] = True
                    count += 1
    cells, k = np.empty(count, np.int64), 0
    for n in range(boxes.shape[0]):
        for row in range(ranges[n, 0], ranges[n, 1]):
            for col in range(ranges[n, 2], ranges[n, 3]):
                cell = row * lattice.width + col
                if flag[cell]:
                    flag[cell] = False
                    cells[k] = cell
                    k += 1
    cells.sort()
    return cells


@njit(cache=True)
def join_cells(one, other):
    """The cells of two regions, each once, ascending: a merge."""
    cells, i, j, count = np.empty(one.shape[0] + other.shape[0], np.int64), 0, 0, 0
    while i < one.shape[0] or j < other.shape[0]:
        if j == other.shape[0] or (i < one.shape[0] and one[i] <= other[j]):
            cell = one[i]
            i += 1
            if j < other.shape[0] and other[j] == cell:
                j += 1
        else:
            cell = other[j]
            j += 1
        cells[count] = cell
        count += 1
    return cells[:count].copy()


@njit(cache=True)
def _grow_along(cells, by, stride, place, length, flag):
    """Some cells and those at most so many away along one axis; the axis' own place is given."""
    count, found = 0, np.empty(2 * cells.shape[0] + 64, np.int64)
    for n in range(cells.shape[0]):
        first, last = max(place[n] - by, 0), min(place[n] + by, length - 1)
        origin = cells[n] - place[n] * stride
        for at in range(first, last + 1):
            other = origin + at * stride
            if flag[other]:
                continue
            flag[other] = True
            if count == found.shape[0]:
                larger = np.empty(2 * count, np.int64)
                larger[:count] = found
                found = larger
            found[count] = other
            count += 1
    found = found[:count].copy()
    for cell in found:
        flag[cell] = False
    return found


@njit(cache=True)
def grow_cells(width, height, cells, by, flag):
    """Some cells and those at most so many rows and columns away, ascending; see above."""
    beside = _grow_along(cells, by, 1, cells % width, width, flag)
    found = _grow_along(beside, by, width, beside // width, height, flag)
    found.sort()
    return found


@njit(cache=True)
def near_tiles(boxes, reach, lattice, tile, summed, result):
    """Tell which boxes, (n, 6) [m], grown by `reach` [m], may lie over marked tiles; (n,) bool.

    Args:
        tile: edge of a tile [cells].
        summed: by tile, how many marked ones there are above and left of it, (rows + 1,
            columns + 1), a summed-area table (Crow, 1984).
    """
    edge = tile * lattice.cell_size
    num_rows, num_cols = summed.shape[0] - 1, summed.shape[1] - 1
    for n in range(boxes.shape[0]):
        # rounding may add a tile, and never loses one
        left = (boxes[n, 0] - reach - lattice.x_min) / edge - 1e-6
        right = (boxes[n, 3] + reach - lattice.x_min) / edge + 1e-6
        top = (lattice.y_max - boxes[n, 4] - reach) / edge - 1e-6
        bottom = (lattice.y_max - boxes[n, 1] + reach) / edge + 1e-6
        col0 = math.floor(min(max(left, 0.0), num_cols))
        row0 = math.floor(min(max(top, 0.0), num_rows))
        col1 = math.floor(min(max(right + 1.0, 0.0), num_cols))
        row1 = math.floor(min(max(bottom + 1.0, 0.0), num_rows))
        count = 0
        if row1 > row0 and col1 > col0:
            count = summed[row1, col1] - summed[row0, col1] - summed[row1, col0]
            count += summed[row0, col0]
        result[n] = count > 0


@njit(cache=True)
def label_cells(lattice, cells, local):
    """The connected part of each cell of a region over edges, (n,) int64.

    `local`, (all cells,) int32, is -1 everywhere, and so again afterwards.
    """
    for n in range(cells.shape[0]):
        local[cells[n]] = n
    parent = np.arange(cells.shape[0])
    for n in range(cells.shape[0]):
        for way in range(2):
            other = neighbour(lattice, cells[n], way)
            if other >= 0 and local[other] >= 0:
                unite(parent, n, local[other])
    part, num = np.empty(cells.shape[0], np.int64), 0
    for n in range(cells.shape[0]):
        root = find_root(parent, n)
        if root == n:
            part[n] = num
            num += 1
        else:
            part[n] = part[root]
        local[cells[n]] = -1
    return part
