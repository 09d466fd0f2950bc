"""Lines of sight between the middles of cells, many at once.

A line goes from cell to cell as in Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray
Tracing" (1987). From middle to middle, the cells that it runs over follow from the numbers of rows
and columns between its ends alone. So all lines up to a length are traced once, in whole numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.types import Bool, Int


class SightLines(NamedTuple):
    """The cells that lines run over, for each number of rows and columns that they lead over.

    The arrays have the shape (rows, cols, steps). Each step leads into the line's next cell, over
    an edge or through a corner of four cells; steps after the line's end stay there.

    Attributes:
        row: rows from the line's start to the cell that the step leads into.
        col: columns to that cell.
        row_before: rows to the cell before.
        col_before: columns to the cell before.
    """

    row: Int
    col: Int
    row_before: Int
    col_before: Int

    def find_clear(self, is_clear: Bool, starts: Int, ends: Int) -> Bool:
        """Mark the lines that run over clear cells only.

        A line may run through a corner if one of the two cells beside it is clear. The cell that
        it starts in doesn't count.

        Args:
            is_clear: the clear cells, shape (rows, cols).
            starts: row and column of each line's start, shape (n, 2).
            ends: row and column of each line's end, shape (n, 2).

        Returns:
            bool, shape (n,).
        """
        line_vectors = ends - starts
        num_rows, num_cols = np.abs(line_vectors).T
        row_sign, col_sign = np.sign(line_vectors).T[:, :, None]
        start_row, start_col = starts.T[:, :, None]
        max_num_steps = int((num_rows + num_cols).max(initial=0))
        rows = start_row + row_sign * self.row[num_rows, num_cols, :max_num_steps]
        cols = start_col + col_sign * self.col[num_rows, num_cols, :max_num_steps]
        rows_before = start_row + row_sign * self.row_before[num_rows, num_cols, :max_num_steps]
        cols_before = start_col + col_sign * self.col_before[num_rows, num_cols, :max_num_steps]
        # where a step leads over an edge, one of these two is the cell itself
        has_passage = is_clear[rows, cols_before] | is_clear[rows_before, cols]
        is_line_clear: Bool = (is_clear[rows, cols] & has_passage).all(axis=1)
        return is_line_clear

    def list_cells(self, start: Int, end: Int) -> Int:
        """List the cells that a line runs over, from the cell after its start to its end.

        Args:
            start: row and column, shape (2,).
            end: row and column, shape (2,).

        Returns:
            Rows and columns, shape (n, 2).
        """
        num_rows, num_cols = np.abs(end - start)
        steps = np.stack([self.row[num_rows, num_cols], self.col[num_rows, num_cols]], axis=1)
        cells: Int = start + np.sign(end - start) * steps[: num_rows + num_cols]
        return cells


def trace_sight_lines(max_cells: int) -> SightLines:
    """Trace the lines that lead over up to a number of rows and of columns.

    Args:
        max_cells: the largest number of rows, and of columns.
    """
    line_spans = np.arange(max_cells + 1)
    num_rows, num_cols = np.meshgrid(line_spans, line_spans, indexing="ij")
    row = np.zeros_like(num_rows)
    col = np.zeros_like(num_cols)
    rows = []
    cols = []
    rows_before = []
    cols_before = []
    for _ in range(2 * max_cells):
        # where on the line the next edges are, times 2 * num_rows * num_cols
        next_row_edge = np.where(row < num_rows, (2 * row + 1) * num_cols, np.inf)
        next_col_edge = np.where(col < num_cols, (2 * col + 1) * num_rows, np.inf)
        is_down = (next_row_edge <= next_col_edge) & (row < num_rows)
        is_right = (next_col_edge <= next_row_edge) & (col < num_cols)
        rows_before.append(row)
        cols_before.append(col)
        row = row + is_down
        col = col + is_right
        rows.append(row)
        cols.append(col)
    return SightLines(
        row=np.stack(rows, axis=-1),
        col=np.stack(cols, axis=-1),
        row_before=np.stack(rows_before, axis=-1),
        col_before=np.stack(cols_before, axis=-1),
    )
