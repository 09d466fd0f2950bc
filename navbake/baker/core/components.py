"""Connected parts of graphs and of cells.

scipy has such functions, but takes longer to load than the apartment to bake.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.union_find import number_components
from navbake.types import Int, Int32


def label_components(pairs: Int, count: int) -> Int32:
    """Number the connected parts of a graph from 0, in the order of their first of `count` nodes.

    `pairs` are the nodes that hang together, shape (2, n).
    """
    part: Int32 = number_components(np.ascontiguousarray(pairs, dtype=np.int64), count)
    return part


def adjacent_pairs(cells: Int, width: int) -> Int:
    """The pairs of cells that meet at an edge or a corner, as places in `cells`, shape (2, n).

    `cells` are ascending ids, shape (m,), of a lattice of a `width`.
    """
    col = cells % width
    pairs = list[Int]()
    for down, right in ((0, 1), (1, -1), (1, 0), (1, 1)):
        one = np.flatnonzero((col + right >= 0) & (col + right < width))
        beside = cells[one] + down * width + right
        other = np.searchsorted(cells, beside)
        found = np.append(cells, -1)[other] == beside
        pairs.append(np.stack([one[found], other[found]]))
    return np.concatenate(pairs, axis=1)


def expand_ranges(begin: Int | Int32, end: Int | Int32) -> tuple[Int, Int]:
    """Concatenate ranges begin[i]:end[i]; returns the range index and the value of each entry."""
    count = np.maximum(end - begin, 0)
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) + np.repeat(begin - np.cumsum(count) + count, count)


def find_row_runs(values: NDArray[Any]) -> tuple[Int, Int, Int, NDArray[Any]]:
    """The runs of values other than 0 in the rows of an array, bool or integer, by rows.

    Returns for each its row, its first column and the one past its last, and the value of its
    cells, shape (n,).
    """
    rows = values.shape[0]
    width = values.shape[1] + 1
    line = np.zeros(rows * width + 1, dtype=values.dtype)  # each row ends with a 0
    line[1:].reshape(rows, width)[:, :-1] = values
    bounds = np.flatnonzero(line[1:] != line[:-1])
    value = line[1 + bounds]
    inside = np.flatnonzero(value)
    row, first = np.divmod(bounds[inside], width)
    return row, first, bounds[inside + 1] - row * width, value[inside]


def count_cells_by_label(labels: Int32, count: int) -> Int:
    """How many cells have each label from 1 to below `count`; by label, 0 for 0."""
    _, first, end, label = find_row_runs(labels)
    return np.bincount(label, end - first, count).astype(np.int64)


def label_components_2d(values: NDArray[Any]) -> tuple[Int32, int]:
    """Label the 4-connected parts of cells with one value (Rosenfeld and Pfaltz, 1966).

    Takes shape (rows, cols), bool or integer; cells with 0 are in no part. Returns the label of
    each cell, int32, 0 for none, by first cells from 1; and the number of labels.
    """
    rows, cols = values.shape
    row, first, end, value = find_row_runs(values)
    place = row * (cols + 1) + first
    past = row * (cols + 1) + end
    # the runs of the next row that begin before a run's end and end behind its beginning
    begin = np.searchsorted(past, place + cols + 1, "right")
    one, other = expand_ranges(begin, np.searchsorted(place, past + cols + 1, "left"))
    same = value[one] == value[other]
    part = label_components(np.stack([one[same], other[same]]), len(row))
    # the cells before each run, those of the run, and so on; those behind the last one
    lengths = np.diff(np.stack([row * cols + first, row * cols + end], axis=1).ravel(), prepend=0)
    number = np.zeros(len(lengths) + 1, dtype=np.int32)
    number[1:-1:2] = part + 1
    label = np.repeat(number, np.append(lengths, rows * cols - lengths.sum()))
    return label.reshape(rows, cols), int(part.max(initial=-1)) + 1
