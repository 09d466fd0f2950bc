"""Distances to walls, floods from seeds, and the borders between what they fill."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

# Columns that one thread sweeps at a time
STRIP = 256


@njit(cache=True, parallel=True)
def squared_distances(target, reach):
    """Squared distance of each node to the nearest target, exact up to `reach`.

    Args:
        target: shape (rows, cols), bool.
        reach: nodes, >= 0.

    Returns:
        Shape (rows, cols), int32; ``(reach + 1) ** 2`` where there is none within reach.
    """
    rows, cols = target.shape
    far = np.int16(reach + 1)
    beyond = np.int32((reach + 1) ** 2)
    along = np.empty((rows, cols), dtype=np.int16)
    for strip in prange((cols + STRIP - 1) // STRIP):
        part = slice(strip * STRIP, min((strip + 1) * STRIP, cols))
        _sweep(target[:, part], along[:, part], far)
    answer = np.empty((rows, cols), dtype=np.int32)
    for row in prange(rows):
        squares = np.full(cols + 2 * reach, beyond, dtype=np.int32)
        for col in range(cols):
            squares[col + reach] = np.int32(along[row, col]) * np.int32(along[row, col])
        nearest = answer[row]
        nearest[:] = beyond
        for shift in range(2 * reach + 1):
            _take_lower(nearest, squares[shift : shift + cols], np.int32((shift - reach) ** 2))
    return answer


@njit(cache=True)
def _sweep(target, along, far):
    """Distances within the columns, at most `far`."""
    rows, cols = target.shape
    for col in range(cols):
        along[0, col] = 0 if target[0, col] else far
    for row in range(1, rows):
        for col in range(cols):
            step = min(along[row - 1, col] + np.int16(1), far)
            along[row, col] = 0 if target[row, col] else step
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            along[row, col] = min(along[row, col], along[row + 1, col] + np.int16(1))


@njit(cache=True)
def _take_lower(lowest, values, add):
    for i in range(lowest.shape[0]):
        lowest[i] = min(lowest[i], np.int32(values[i] + add))


@njit(cache=True)
def flood(label, fillable, height, highest):
    """Fill cells from seeds, the highest first; a watershed whose lines take no cells.

    Cells are filled in order of height, and those of a height wave by wave, each wave one step
    across edges. A cell that several seeds reach in one wave goes to the one with the nearest
    cell, measured straight; of two as near, to the lowest label. So the order in which cells
    are looked at decides nothing.

    Args:
        label: shape (rows, cols), int32: > 0 in seeds, else 0; is filled.
        fillable: shape (rows, cols), bool.
        height: shape (rows, cols), int32, 0 to `highest`.
        highest: the largest height.
    """
    rows, cols = label.shape
    labels, heights, may_fill = label.ravel(), height.ravel(), fillable.ravel()
    source = np.arange(rows * cols).astype(np.int32)  # the cell of the seed that each one is from
    waiting = may_fill & (labels == 0)  # and not yet in a queue
    after = np.full(rows * cols, -1, dtype=np.int32)  # a linked list of cells a height
    head = np.full(highest + 1, -1, dtype=np.int32)
    near = np.empty(4, dtype=np.int32)
    for cell in range(rows * cols):
        if labels[cell] > 0:
            for i in range(_neighbours(cell, rows, cols, near)):
                if waiting[near[i]]:
                    waiting[near[i]] = False
                    after[near[i]] = head[heights[near[i]]]
                    head[heights[near[i]]] = near[i]
    wave = np.empty(rows * cols, dtype=np.int32)
    origin = np.empty(rows * cols, dtype=np.int32)
    for level in range(highest, -1, -1):
        count = 0
        cell = head[level]
        while cell >= 0:
            wave[count] = cell
            count += 1
            cell = after[cell]
        begin = 0
        while begin < count:
            end = count
            for k in range(begin, end):
                number = _neighbours(wave[k], rows, cols, near)
                origin[k] = _nearest_origin(wave[k], near[:number], labels, source, cols)
            for k in range(begin, end):
                source[wave[k]] = origin[k]
                labels[wave[k]] = labels[origin[k]]
            for k in range(begin, end):
                for i in range(_neighbours(wave[k], rows, cols, near)):
                    other = near[i]
                    if not waiting[other]:
                        continue
                    waiting[other] = False
                    if heights[other] >= level:
                        wave[count] = other
                        count += 1
                    else:
                        after[other] = head[heights[other]]
                        head[heights[other]] = other
            begin = end


@njit(cache=True)
def _nearest_origin(cell, near, labels, source, cols):
    """The seed's cell that is nearest, of those that labelled neighbours come from.

    Of two as near, that of the lower label; of one label's, the one that is further clockwise,
    because that turns with the map.
    """
    best, least, best_row, best_col = -1, 0, 0, 0
    for other in near:
        if labels[other] == 0:
            continue
        row, col = source[other] // cols - cell // cols, source[other] % cols - cell % cols
        square = row * row + col * col
        is_better = best < 0 or square < least
        if not is_better and square == least:
            turn = best_col * row - best_row * col
            is_better = labels[other] < labels[best]
            is_better |= labels[other] == labels[best] and turn > 0
        if is_better:
            best, least, best_row, best_col = source[other], square, row, col
    return best


@njit(cache=True)
def _neighbours(cell, rows, cols, near):
    """Write the cells that share an edge with a cell; returns how many they are."""
    count = 0
    col = cell % cols
    if col + 1 < cols:
        near[count] = cell + 1
        count += 1
    if cell + cols < rows * cols:
        near[count] = cell + cols
        count += 1
    if col > 0:
        near[count] = cell - 1
        count += 1
    if cell >= cols:
        near[count] = cell - cols
        count += 1
    return count


@njit(cache=True)
def first_cells(label, count):
    """The first cell of each label from 0 to ``count - 1``; how many there are for none."""
    labels = label.ravel()
    first = np.full(count, labels.shape[0], dtype=np.int64)
    for cell in range(labels.shape[0] - 1, -1, -1):
        first[labels[cell]] = cell
    return first


@njit(cache=True)
def measure_basins(label, distance, num_basins):
    """Count the cells of each label, and find its node farthest from the walls.

    Args:
        label: of cells, shape (rows, cols), int32, 0 to `num_basins`.
        distance: of nodes, shape (2 rows + 1, 2 cols + 1), int32.
        num_basins: the largest label.

    Returns:
        Number of cells, (num_basins + 1,) int64; largest distance of a node on one of them,
        (num_basins + 1,) int32. What has no label is left out.
    """
    cells = np.zeros(num_basins + 1, dtype=np.int64)
    peaks = np.zeros(num_basins + 1, dtype=np.int32)
    rows, cols = label.shape
    for row in range(rows):
        for col in range(cols):
            basin = label[row, col]
            if basin == 0:
                continue
            cells[basin] += 1
            for i in range(2 * row, 2 * row + 3):
                for j in range(2 * col, 2 * col + 3):
                    peaks[basin] = max(peaks[basin], distance[i, j])
    return cells, peaks


@njit(cache=True)
def find_passes(label, distance):
    """Find the edges between cells with different labels, none of them 0.

    Args:
        label: of cells, shape (rows, cols), int32.
        distance: of nodes, shape (2 rows + 1, 2 cols + 1), int32.

    Returns:
        The two labels, the lower one first, (n, 2) int64; and the largest distance of the three
        nodes on each edge, (n,) int32.
    """
    rows, cols = label.shape
    pairs = np.empty((0, 2), dtype=np.int64)
    saddles = np.empty(0, dtype=np.int32)
    for writing in (False, True):
        count = 0
        for row in range(rows):
            for col in range(cols):
                here = label[row, col]
                for down in range(2):
                    right = 1 - down
                    if here == 0 or row + down == rows or col + right == cols:
                        continue
                    there = label[row + down, col + right]
                    if there == 0 or there == here:
                        continue
                    if writing:
                        pairs[count] = min(here, there), max(here, there)
                        i, j = 2 * row + 1 + down, 2 * col + 1 + right
                        saddles[count] = max(
                            distance[i, j],
                            distance[i - right, j - down],
                            distance[i + right, j + down],
                        )
                    count += 1
        if not writing:
            pairs = np.empty((count, 2), dtype=np.int64)
            saddles = np.empty(count, dtype=np.int32)
    return pairs, saddles
