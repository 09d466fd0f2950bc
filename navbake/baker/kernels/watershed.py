"""Distances to walls, and floods from seeds."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

# Columns that one thread sweeps at a time
STRIP = 256


@njit(cache=True, parallel=True)
def squared_distances(target, reach, first=0, step=1):
    """Squared distance of each node to the nearest target, exact up to `reach`.

    Args:
        target: shape (rows, cols), bool.
        reach: nodes, >= 0.
        first, step: which rows to answer for: those of ``range(first, rows, step)``.

    Returns:
        Shape (answered rows, cols), int32; ``(reach + 1) ** 2`` where there is none within reach.
    """
    rows, cols = target.shape
    far = np.int16(reach + 1)
    beyond = np.int32((reach + 1) ** 2)
    along = np.empty((rows, cols), dtype=np.int16)
    for strip in prange((cols + STRIP - 1) // STRIP):
        part = slice(strip * STRIP, min((strip + 1) * STRIP, cols))
        _sweep(target[:, part], along[:, part], far)
    answer = np.empty((max(0, (rows - first + step - 1) // step), cols), dtype=np.int32)
    for number in prange(answer.shape[0]):
        squares = np.full(cols + 2 * reach, beyond, dtype=np.int32)
        for col in range(cols):
            value = np.int32(along[first + number * step, col])
            squares[col + reach] = value * value
        nearest = answer[number]
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
