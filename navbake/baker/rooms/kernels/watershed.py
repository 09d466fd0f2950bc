"""Distances to walls, and floods from seeds.

The squared Euclidean distance is found in two passes, along the columns and then across them, as
the lower envelope of parabolas separates by axis (Saito and Toriwaki, 1994; Felzenszwalb and
Huttenlocher, 2012). Only distances up to a reach matter, so the second pass just takes the lowest
of all parabolas within it; that vectorizes, which the exact envelope does not.

The flood is a watershed by flooding from markers (Meyer, 1991; Vincent and Soille, 1991) with
one bucket for each height in place of a priority queue.
"""

from typing import NamedTuple

import numpy as np

from navbake.compiled import kernel, part
from navbake.types import Bool, Int32


@kernel(nogil=True)
def sweep_columns(target, far, along, col0, end):
    """Distances to the nearest target within columns ``range(col0, end)``, at most `far`.

    `target` is (rows, cols) bool, and `along`, int16, receives the distances.
    """
    _sweep(target[:, col0:end], along[:, col0:end], far)  # loops from 0 vectorize


@part
def _sweep(target, along, far):
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


@kernel(nogil=True)
def sweep_rows(along, reach, rows, answer, number0, end):
    """Squared distances, for the `number0`-th to the end-th of some rows, from those in columns.

    `along` is what `sweep_columns` found, `rows` (n,) int64, and `answer`, (n, cols) int32,
    receives ``(reach + 1) ** 2`` where there is no target within reach.
    """
    cols = along.shape[1]
    beyond = np.int32((reach + 1) ** 2)
    squares = np.full(cols + 2 * reach, beyond, dtype=np.int32)
    for number in range(number0, end):
        for col in range(cols):
            value = np.int32(along[rows[number], col])
            squares[col + reach] = value * value
        nearest = answer[number]
        nearest[:] = beyond
        for shift in range(2 * reach + 1):
            _take_lower(nearest, squares[shift : shift + cols], np.int32((shift - reach) ** 2))


@part
def _take_lower(lowest, values, add):
    for i in range(lowest.shape[0]):
        lowest[i] = min(lowest[i], np.int32(values[i] + add))


class Buckets(NamedTuple):
    """Cells that wait, by their height: a linked list for each.

    Attributes:
        head: by height, the first cell, -1 for none, int32.
        after: by cell in a list, the next one, -1 for none, int32.
        waiting: by cell, whether it may be filled and is in no list yet, bool.
    """

    head: Int32
    after: Int32
    waiting: Bool


@kernel
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
    """
    rows, cols = label.shape
    labels, heights = label.ravel(), height.ravel()
    source = np.arange(rows * cols, dtype=np.int32)  # the cell of the seed that each one is from
    buckets = Buckets(
        np.full(highest + 1, -1, dtype=np.int32),
        np.empty(rows * cols, dtype=np.int32),
        fillable.ravel() & (labels == 0),
    )
    near = np.empty(4, dtype=np.int32)
    wave = np.empty(rows * cols, dtype=np.int32)
    origin = np.empty(rows * cols, dtype=np.int32)
    for cell in range(rows * cols):
        if buckets.waiting[cell] and _has_label_beside(cell, rows, cols, labels, near):
            _queue(cell, heights, buckets)
    for level in range(highest, -1, -1):
        begin, end = 0, _take_bucket(buckets, level, wave)
        while begin < end:
            # a whole wave is decided before any of it is written: all of it is as near to come by
            for k in range(begin, end):
                filled = np.int64(wave[k])  # of the type of the cells above, see `arrays`
                number = _neighbours(filled, rows, cols, near)
                origin[k] = _nearest_origin(filled, near[:number], labels, source, cols)
            for k in range(begin, end):
                source[wave[k]] = origin[k]
                labels[wave[k]] = labels[origin[k]]
            count = end
            for k in range(begin, end):
                filled = np.int64(wave[k])
                count = _queue_around(
                    filled, rows, cols, heights, level, buckets, wave, count, near
                )
            begin, end = end, count


@part(inline="always")
def _has_label_beside(cell, rows, cols, labels, near):
    """Whether a cell that shares an edge with a cell has a label."""
    for other in near[: _neighbours(cell, rows, cols, near)]:  # noqa: SIM110 (no `any` in numba)
        if labels[other] > 0:
            return True
    return False


@part(inline="always")
def _queue(cell, heights, buckets):
    """Let a cell wait in the bucket of its height."""
    buckets.waiting[cell] = False
    buckets.after[cell] = buckets.head[heights[cell]]
    buckets.head[heights[cell]] = cell


@part(inline="always")
def _take_bucket(buckets, level, wave):
    """Write the cells that wait at a height into a wave; returns how many they are."""
    count = 0
    cell = buckets.head[level]
    while cell >= 0:
        wave[count] = cell
        count += 1
        cell = buckets.after[cell]
    return count


@part
def _queue_around(cell, rows, cols, heights, level, buckets, wave, count, near):
    """Queue the cells round one: in the next wave from a height on, lower ones in their bucket.

    Returns how many cells are in the waves of this height.
    """
    for i in range(_neighbours(cell, rows, cols, near)):
        other = near[i]
        if not buckets.waiting[other]:
            continue
        if heights[other] >= level:  # a basin that lies higher fills at once: no way out but here
            buckets.waiting[other] = False
            wave[count] = other
            count += 1
        else:
            _queue(other, heights, buckets)
    return count


@part(inline="always")
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


@part
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
