"""Connected components of graphs and of cells, and runs of cells in rows.

scipy has such functions, but takes longer to load than the apartment takes to bake.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.union_find import number_components
from navbake.types import Int, Int32, ScalarT


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


class RowRuns(NamedTuple):
    """Runs of equal values other than 0 in the rows of an array, row by row from the left.

    Attributes:
        row: the row of each run, shape (runs,).
        first_col: its first column, shape (runs,).
        end_col: the column after its last one, shape (runs,).
        value: its value, shape (runs,).
    """

    row: Int
    first_col: Int
    end_col: Int
    value: NDArray[Any]

    def paint(self, values: NDArray[ScalarT], shape: tuple[int, ...]) -> NDArray[ScalarT]:
        """Return an array with a value for each run, and 0 between the runs.

        This takes a fraction of the time that it takes to look up each cell's value in a table.

        Args:
            values: the value of each run, shape (runs,).
            shape: the shape of the array whose runs these are, (rows, cols).
        """
        num_rows, num_cols = shape
        # gap, run, gap, run, … over all cells in order; then the gap behind the last run
        value_of_piece = np.zeros(2 * len(values) + 1, dtype=values.dtype)
        value_of_piece[1::2] = values
        piece_bounds = np.zeros(len(value_of_piece) + 1, dtype=np.int64)
        piece_bounds[1:-1:2] = self.row * num_cols + self.first_col
        piece_bounds[2:-1:2] = self.row * num_cols + self.end_col
        piece_bounds[-1] = num_rows * num_cols
        return np.repeat(value_of_piece, np.diff(piece_bounds)).reshape(num_rows, num_cols)

    def merged_with(self, other: RowRuns) -> RowRuns:
        """Merge these runs with those of another array, in the order of rows and columns.

        Args:
            other: the runs of an array of the same shape; none overlaps one of these runs.
        """
        row = np.concatenate([self.row, other.row])
        first_col = np.concatenate([self.first_col, other.first_col])
        order = np.lexsort([first_col, row])
        return RowRuns(
            row=row[order],
            first_col=first_col[order],
            end_col=np.concatenate([self.end_col, other.end_col])[order],
            value=np.concatenate([self.value, other.value])[order],
        )

    def list_touching(self) -> tuple[Int, Int]:
        """List the pairs of runs that touch: along a row, or at the edges of cells in two rows.

        Returns:
            The indices of the runs on the left or above, and of those on the right or below, shape
            (pairs,) each.
        """
        left_run = np.flatnonzero(
            (self.row[:-1] == self.row[1:]) & (self.end_col[:-1] == self.first_col[1:])
        )
        # each row has a column more, so that no run touches the next row's
        num_cols = int(self.end_col.max(initial=0)) + 1
        run_begin = self.row * num_cols + self.first_col
        run_end = self.row * num_cols + self.end_col
        # the runs of the next row that begin before a run's end and end behind its beginning
        first_lower_run = np.searchsorted(run_end, run_begin + num_cols, "right")
        end_lower_run = np.searchsorted(run_begin, run_end + num_cols, "left")
        upper_run, lower_run = expand_ranges(first_lower_run, end_lower_run)
        return np.append(left_run, upper_run), np.append(left_run + 1, lower_run)

    def count_cells(self, labels: Int | Int32, num_labels: int) -> Int:
        """Count the cells of each label.

        Args:
            labels: the label of each run, shape (runs,).
            num_labels: number of labels, which count from 0.

        Returns:
            How many cells the runs of each label have together, shape (num_labels,).
        """
        return np.bincount(labels, self.end_col - self.first_col, num_labels).astype(np.int64)


def find_row_runs(values: NDArray[Any]) -> RowRuns:
    """Find the runs of equal values other than 0 in the rows of an array.

    Args:
        values: bool or integer, shape (rows, cols), at least one column.
    """
    num_cols = values.shape[1]
    flat_values = values.reshape(-1)
    # a run, or a gap between runs, begins where the value changes, and in each row's first cell
    is_begin = np.empty(len(flat_values), dtype=np.bool_)
    np.not_equal(flat_values[1:], flat_values[:-1], out=is_begin[1:])
    is_begin[::num_cols] = True
    begin = np.flatnonzero(is_begin)
    length = np.diff(begin, append=len(flat_values))
    value = flat_values[begin]
    run_indices = np.flatnonzero(value)
    begin = begin[run_indices]
    row = begin // num_cols
    first_col = begin - row * num_cols
    return RowRuns(
        row=row,
        first_col=first_col,
        end_col=first_col + length[run_indices],
        value=value[run_indices],
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
    runs = find_row_runs(labels)
    return runs.count_cells(runs.value, num_labels)


def label_runs(runs: RowRuns) -> tuple[Int32, Int]:
    """Label the 4-connected components of runs with equal values (Rosenfeld and Pfaltz, 1966).

    Args:
        runs: the runs of an array.

    Returns:
        The label of each run, shape (runs,); and the number of cells with each label, shape
        (components + 1,), 0 for label 0. Labels count from 1, in the order of the components' first
        runs.
    """
    first_run, second_run = runs.list_touching()
    is_equal = runs.value[first_run] == runs.value[second_run]
    label = 1 + label_components(
        np.stack([first_run[is_equal], second_run[is_equal]]), len(runs.row)
    )
    return label, runs.count_cells(label, int(label.max(initial=0)) + 1)


def label_components_2d(values: NDArray[Any]) -> tuple[Int32, Int]:
    """Label the 4-connected components of cells with equal values.

    Args:
        values: bool or integer, shape (rows, cols); cells with 0 are in no component.

    Returns:
        The label of each cell, shape (rows, cols), and the number of cells with each label, shape
        (components + 1,). Labels count from 1, in the order of the components' first cells; 0 means
        no component, and its cells are not counted.
    """
    runs = find_row_runs(values)
    label_of_run, num_cells = label_runs(runs)
    return runs.paint(label_of_run, values.shape), num_cells
