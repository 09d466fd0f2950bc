"""Connected components of graphs and of cells, and runs of cells in rows.

scipy has such functions, but takes longer to load than the apartment takes to bake.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.union_find import number_components
from navbake.types import Int, Int32


def label_components(pairs: Int, num_nodes: int) -> Int32:
    """Number the connected components of a graph from 0, in the order of their first nodes.

    Args:
        pairs: the two nodes of each edge, shape (2, n).
        num_nodes: number of nodes; nodes are numbered from 0.

    Returns:
        The component of each node, shape (num_nodes,).
    """
    labels: Int32 = number_components(np.ascontiguousarray(pairs, dtype=np.int64), num_nodes)
    return labels


def list_adjacent_pairs(cells: Int, width: int) -> Int:
    """List the pairs of cells that share an edge or a corner.

    Args:
        cells: ids of cells, ascending, shape (m,).
        width: number of columns of the lattice.

    Returns:
        The two cells of each pair, as indices into `cells`, shape (2, n).
    """
    col = cells % width
    pairs = list[Int]()
    for row_step, col_step in ((0, 1), (1, -1), (1, 0), (1, 1)):
        first_index = np.flatnonzero((col + col_step >= 0) & (col + col_step < width))
        neighbor_id = cells[first_index] + row_step * width + col_step
        second_index = np.searchsorted(cells, neighbor_id)
        is_in_cells = np.append(cells, -1)[second_index] == neighbor_id
        pairs.append(np.stack([first_index[is_in_cells], second_index[is_in_cells]]))
    return np.concatenate(pairs, axis=1)


def expand_ranges(begin: Int | Int32, end: Int | Int32) -> tuple[Int, Int]:
    """List the integers of several ranges ``begin[i]:end[i]``, range by range.

    Args:
        begin, end: the ranges, shape (n,); a range is empty if its end is not above its begin.

    Returns:
        For each integer, the index i of its range; and the integers themselves; shape (sum of the
        ranges' lengths,) each.
    """
    range_length = np.maximum(end - begin, 0)
    range_index = np.repeat(np.arange(len(range_length)), range_length)
    value_minus_position = np.repeat(begin - np.cumsum(range_length) + range_length, range_length)
    return range_index, np.arange(len(range_index)) + value_minus_position


def find_row_runs(values: NDArray[Any]) -> tuple[Int, Int, Int, NDArray[Any]]:
    """Find the runs of equal values other than 0 in the rows of an array.

    Args:
        values: bool or integer, shape (rows, cols).

    Returns:
        For each run: its row, its first column, the column after its last one, and its value; shape
        (runs,) each, row by row from the left.
    """
    num_rows = values.shape[0]
    padded_width = values.shape[1] + 1
    flat_values = np.zeros(
        num_rows * padded_width + 1, dtype=values.dtype
    )  # each row ends with a 0
    flat_values[1:].reshape(num_rows, padded_width)[:, :-1] = values
    change_indices = np.flatnonzero(flat_values[1:] != flat_values[:-1])
    value_after_change = flat_values[1 + change_indices]
    run_indices = np.flatnonzero(value_after_change)
    row, first_col = np.divmod(change_indices[run_indices], padded_width)
    return (
        row,
        first_col,
        change_indices[run_indices + 1] - row * padded_width,
        value_after_change[run_indices],
    )


def count_cells_by_label(labels: Int32, num_labels: int) -> Int:
    """Count the cells of each label.

    Args:
        labels: the label of each cell, from 0 to ``num_labels - 1``, shape (rows, cols).
        num_labels: number of labels, including label 0.

    Returns:
        How many cells each label has, shape (num_labels,). Cells with label 0 are not counted, so
        the first entry is 0.
    """
    _, first_col, end_col, label = find_row_runs(labels)
    return np.bincount(label, end_col - first_col, num_labels).astype(np.int64)


def label_components_2d(values: NDArray[Any]) -> tuple[Int32, int]:
    """Label the 4-connected components of cells with equal values (Rosenfeld and Pfaltz, 1966).

    Args:
        values: bool or integer, shape (rows, cols); cells with 0 are in no component.

    Returns:
        The label of each cell, shape (rows, cols), and the number of components. Labels count from
        1, in the order of the components' first cells; 0 means no component.
    """
    num_rows, num_cols = values.shape
    row_of_run, first_col, end_col, value_of_run = find_row_runs(values)
    # each row has a column more, so that no run touches the next row's
    run_begin = row_of_run * (num_cols + 1) + first_col
    run_end = row_of_run * (num_cols + 1) + end_col
    # the runs of the next row that begin before a run's end and end behind its beginning
    first_lower_run = np.searchsorted(run_end, run_begin + num_cols + 1, "right")
    end_lower_run = np.searchsorted(run_begin, run_end + num_cols + 1, "left")
    upper_run, lower_run = expand_ranges(first_lower_run, end_lower_run)
    is_equal = value_of_run[upper_run] == value_of_run[lower_run]
    component_of_run = label_components(
        np.stack([upper_run[is_equal], lower_run[is_equal]]), len(row_of_run)
    )
    # lengths of gap, run, gap, run, … over all cells in order; then the gap behind the last run
    run_bounds = np.stack(
        [row_of_run * num_cols + first_col, row_of_run * num_cols + end_col], axis=1
    ).ravel()
    piece_lengths = np.diff(run_bounds, prepend=0)
    label_of_piece = np.zeros(len(piece_lengths) + 1, dtype=np.int32)
    label_of_piece[1:-1:2] = component_of_run + 1
    labels = np.repeat(
        label_of_piece, np.append(piece_lengths, num_rows * num_cols - piece_lengths.sum())
    )
    return labels.reshape(num_rows, num_cols), int(component_of_run.max(initial=-1)) + 1
