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
def grow_cells(width, height, cells, by, flag):
    """Some cells and those at most so many rows and columns away, ascending; see above."""
    count = 0
    found = np.empty(64, np.int64)
    for cell in cells:
        row, col = cell // width, cell % width
        for r in range(max(row - by, 0), min(row + by + 1, height)):
            for c in range(max(col - by, 0), min(col + by + 1, width)):
                other = r * width + c
                if not flag[other]:
                    flag[other] = True
                    if count == found.shape[0]:
                        larger = np.empty(2 * count, np.int64)
                        larger[:count] = found
                        found = larger
                    found[count] = other
                    count += 1
    found = found[:count].copy()
    found.sort()
    for cell in found:
        flag[cell] = False
    return found


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
