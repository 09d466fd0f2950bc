"""Lines of sight from the middles of cells to the middles of others, in space, many at once.

A line goes from cell to cell as in Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray
Tracing" (1987). From middle to middle, the cells that it runs over follow from the numbers of rows
and columns between its ends alone. So all lines up to a length are traced once, in whole numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Bool, Float, Int

HEIGHT_SLACK = 1e-3  # by how much a line may run below the top of a thing, for rounding [m]


class Obstructions(NamedTuple):
    """The things in each cell that may hide other things behind them.

    Attributes:
        bottoms: world z of their lower ends [m], shape (rows, cols, things); inf for no thing.
        tops: world z of their upper ends [m], of the same shape; -inf for no thing.
        has_thing: whether a cell has any of them, shape (rows, cols).
    """

    bottoms: Float
    tops: Float
    has_thing: Bool

    def hide(self, rows: Int, cols: Int, lowest: Float, highest: Float) -> Bool:
        """Mark the cells in which a thing is at the height of a line.

        Args:
            rows: rows of the cells, any shape.
            cols: their columns, of that shape.
            lowest: lower end of each line over its cell, world z [m], of that shape.
            highest: its upper end [m].

        Returns:
            bool, of that shape.
        """
        is_hidden = self.has_thing[rows, cols]
        # most cells are empty: heights are compared in the others alone
        at_thing = np.nonzero(is_hidden)
        thing_rows = rows[at_thing]
        thing_cols = cols[at_thing]
        tops = self.tops[thing_rows, thing_cols]
        bottoms = self.bottoms[thing_rows, thing_cols]
        is_below_top = lowest[at_thing][:, None] < tops - HEIGHT_SLACK
        is_above_bottom = highest[at_thing][:, None] > bottoms + HEIGHT_SLACK
        is_hidden[at_thing] = (is_below_top & is_above_bottom).any(axis=-1)
        return is_hidden


class SightLines(NamedTuple):
    """The cells that lines run over, for each number of rows and columns that they lead over.

    The arrays have the shape (rows, cols, steps). Each step leads into the line's next cell, over
    an edge or through a corner of four cells; steps after the line's end stay there.

    Attributes:
        row: rows from the line's start to the cell that the step leads into.
        col: columns to that cell.
        row_before: rows to the cell before.
        col_before: columns to the cell before.
        share: share of the line's length up to where it enters the cell, 1 after its end.
    """

    row: NDArray[np.int16]
    col: NDArray[np.int16]
    row_before: NDArray[np.int16]
    col_before: NDArray[np.int16]
    share: Float

    def find_hidden(
        self,
        obstructions: Obstructions,
        starts: Int,
        ends: Int,
        start_heights: Float,
        end_heights: Float,
    ) -> Bool:
        """Mark the steps of lines at which something is in between.

        A line may run through a corner if nothing hides it in one of the two cells beside it. The
        cell that it starts in doesn't count.

        Args:
            obstructions: the things in each cell.
            starts: row and column of each line's start, shape (n, 2).
            ends: row and column of each line's end, shape (n, 2).
            start_heights: world z of each line's start [m], shape (n,).
            end_heights: world z of each line's end [m], shape (n,).

        Returns:
            bool, shape (n, steps).
        """
        line_vectors = ends - starts
        num_rows, num_cols = np.abs(line_vectors).T
        row_sign, col_sign = np.sign(line_vectors).T[:, :, None]
        start_row, start_col = starts.T[:, :, None]
        max_num_steps = int((num_rows + num_cols).max(initial=0))
        if not obstructions.has_thing.any():
            return np.zeros((len(starts), max_num_steps), dtype=np.bool_)
        rows = start_row + row_sign * self.row[num_rows, num_cols, :max_num_steps]
        cols = start_col + col_sign * self.col[num_rows, num_cols, :max_num_steps]
        shares = self.share[num_rows, num_cols, :max_num_steps]
        rises = (end_heights - start_heights)[:, None]
        heights = start_heights[:, None] + rises * shares
        heights_after = np.concatenate([heights[:, 1:], end_heights[:, None]], axis=1)[
            :, :max_num_steps
        ]
        lowest_heights = np.minimum(heights, heights_after)
        highest_heights = np.maximum(heights, heights_after)
        is_hidden = obstructions.hide(rows, cols, lowest_heights, highest_heights)
        rows_before = start_row + row_sign * self.row_before[num_rows, num_cols, :max_num_steps]
        cols_before = start_col + col_sign * self.col_before[num_rows, num_cols, :max_num_steps]
        at_corner = np.nonzero((rows != rows_before) & (cols != cols_before))
        corner_heights = heights[at_corner]
        is_below_hiding = obstructions.hide(
            rows[at_corner], cols_before[at_corner], corner_heights, corner_heights
        )
        is_beside_hiding = obstructions.hide(
            rows_before[at_corner], cols[at_corner], corner_heights, corner_heights
        )
        is_hidden[at_corner] |= is_below_hiding & is_beside_hiding
        return is_hidden

    def list_cells(self, start: Int, end: Int) -> Int:
        """List the cells that a line runs over, from the cell after its start to its end.

        Args:
            start: row and column, shape (2,).
            end: row and column, shape (2,).

        Returns:
            Rows and columns, shape (steps, 2).
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
    shape = (*num_rows.shape, 2 * max_cells)
    lines = SightLines(
        row=np.empty(shape, dtype=np.int16),
        col=np.empty(shape, dtype=np.int16),
        row_before=np.empty(shape, dtype=np.int16),
        col_before=np.empty(shape, dtype=np.int16),
        share=np.empty(shape),
    )
    for step in range(2 * max_cells):
        # where on the line the next edges are, times 2 * num_rows * num_cols
        next_row_edge = np.where(row < num_rows, (2 * row + 1) * num_cols, np.inf)
        next_col_edge = np.where(col < num_cols, (2 * col + 1) * num_rows, np.inf)
        is_down = (next_row_edge <= next_col_edge) & (row < num_rows)
        is_right = (next_col_edge <= next_row_edge) & (col < num_cols)
        row_share = np.where(is_down, (2 * row + 1) / np.maximum(2 * num_rows, 1), 1.0)
        col_share = np.where(is_right, (2 * col + 1) / np.maximum(2 * num_cols, 1), 1.0)
        lines.share[..., step] = np.minimum(row_share, col_share)
        lines.row_before[..., step] = row
        lines.col_before[..., step] = col
        row = row + is_down
        col = col + is_right
        lines.row[..., step] = row
        lines.col[..., step] = col
    return lines
