"""Blocks of cells: stages work on several at a time, on all threads, and merge the results.

A lattice is cut into blocks of BLOCK x BLOCK cells, numbered row by row. A kernel lists rows of
numbers for each block; things that extend over blocks, such as regions, are merged from these rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.tiles import BLOCK
from navbake.navgrid.lattice import Lattice
from navbake.processes import give_back_memory
from navbake.threads import LEAST_CELLS, run_in_chunks
from navbake.types import Bool, Int, ScalarT

# How many rows of numbers the first call of a kernel in `list_rows` has room for
FIRST_CAPACITY = 4096
# The fewest blocks in a chunk, where little is done for each cell
LEAST_BLOCKS = LEAST_CELLS // BLOCK**2
# How many times as many rows the next call has room for. A block that had no room is done again,
# and may have many rows, as in a tower; memory that no row is written into takes none
CAPACITY_GROWTH = 8
# Arrays of a `RowsBuilder` that are too small are replaced by some of the expected size times this
SPARE_FACTOR = 1.1
# They have room for at most this many times as many rows as there are by then: address space may be
# limited, and the remaining cells may have few rows
MAX_GROWTH = 4.0


class Blocks:
    """The blocks of a lattice: squares of BLOCK x BLOCK cells, for which kernels list results.

    Attributes:
        lattice: the cells.
        num_rows, num_cols: how many rows and columns of blocks there are.
        num_blocks: how many blocks there are in all.
    """

    def __init__(self, lattice: Lattice) -> None:
        """Divide a lattice into blocks of BLOCK x BLOCK cells."""
        self.lattice = lattice
        self.num_rows = -(-lattice.height // BLOCK)
        self.num_cols = -(-lattice.width // BLOCK)
        self.num_blocks = self.num_rows * self.num_cols

    def list_cells(self, first_row: int, end_row: int) -> Int:
        """List the ids of the cells of some rows, block by block.

        Args:
            first_row: the first row of cells.
            end_row: the row past the last one.

        Returns:
            Ids of cells, shape (n,).
        """
        width = self.lattice.width
        cells = np.arange(first_row * width, end_row * width).reshape(-1, width)
        cells_by_block = np.empty(cells.size, dtype=np.int64)
        num_listed = 0
        for cells_of_blocks in self._split_by_block(cells, first_row):
            listed_cells = cells_by_block[num_listed : num_listed + cells_of_blocks.size]
            listed_cells.reshape(cells_of_blocks.shape)[...] = cells_of_blocks
            num_listed += cells_of_blocks.size
        return cells_by_block

    def list_cells_of_blocks(self, is_selected: Bool) -> Int:
        """List the ids of all cells of some blocks, ascending.

        Args:
            is_selected: a mask of the blocks, shape (num_blocks,).

        Returns:
            Ids of cells, shape (n,).
        """
        lattice = self.lattice
        is_in_block_row = np.repeat(
            is_selected.reshape(self.num_rows, self.num_cols), BLOCK, axis=1
        )[:, : lattice.width]
        pieces = [np.empty(0, dtype=np.int64)]
        for block_row in np.flatnonzero(is_in_block_row.any(axis=1)).tolist():
            cols = np.flatnonzero(is_in_block_row[block_row])
            rows = np.arange(block_row * BLOCK, min((block_row + 1) * BLOCK, lattice.height))
            pieces.append(np.add.outer(rows * lattice.width, cols).ravel())
        return np.concatenate(pieces)

    def order_by_cell(
        self, values: NDArray[ScalarT], first_row: int, values_by_row: NDArray[ScalarT]
    ) -> None:
        """Bring values of cells into the order of the cells' ids.

        Args:
            values: a value for each cell that `list_cells` lists, in its order, shape (n,).
            first_row: the first row of these cells, which make up entire rows.
            values_by_row: receives the values, shape (rows, width).
        """
        num_ordered = 0
        for cells_of_blocks in self._split_by_block(values_by_row, first_row):
            next_values = values[num_ordered : num_ordered + cells_of_blocks.size]
            cells_of_blocks[...] = next_values.reshape(cells_of_blocks.shape)
            num_ordered += cells_of_blocks.size

    def _split_by_block(
        self, cells: NDArray[ScalarT], first_row: int
    ) -> Iterator[NDArray[ScalarT]]:
        """Split an array with an entry for each cell of some rows, as views.

        Args:
            cells: the array, shape (rows, width).
            first_row: the first of the rows.

        Yields:
            For each row of blocks, the blocks that have all their columns, shape (blocks, rows of
            cells, BLOCK); and the block that the lattice cuts off, shape (rows of cells, columns),
            which may have no columns.
        """
        end_of_whole_blocks = self.lattice.width // BLOCK * BLOCK
        for row in range(-(first_row % BLOCK), len(cells), BLOCK):
            block_row = cells[max(row, 0) : row + BLOCK]
            whole_blocks = block_row[:, :end_of_whole_blocks].reshape(
                len(block_row), end_of_whole_blocks // BLOCK, BLOCK
            )
            yield whole_blocks.swapaxes(0, 1)
            yield block_row[:, end_of_whole_blocks:]

    def list_rows(
        self,
        kernel: Callable[..., int],
        empty_arrays: tuple[NDArray[Any], ...],
        *args: object,
        least: int = 1,
    ) -> tuple[Int, list[NDArray[Any]]]:
        """Call a kernel that lists rows of numbers for each block, on all threads.

        Args:
            kernel: lists the rows of some blocks; its arguments are those that the function
                `list_rows` of this module describes.
            empty_arrays: arrays without entries, which have the dtypes, and the shapes after the
                first axis, of the arrays that receive the rows.
            args: the kernel's first arguments.
            least: smallest number of blocks for one call, see `run_in_chunks`.

        Returns:
            The id of the block that each row belongs to, (n,); and the rows, as arrays of shape
            (n, ...).
        """
        block_ids = np.arange(self.num_blocks)
        row_counts, row_arrays = list_rows(kernel, block_ids, empty_arrays, *args, least=least)
        return np.repeat(block_ids, row_counts), row_arrays


def join_arrays(chunks: list[list[NDArray[Any]]]) -> list[NDArray[Any]]:
    """Concatenate the arrays of several chunks one by one, and free each chunk's memory on the way.

    Args:
        chunks: at least one chunk; each is a list of equally many arrays, and is emptied.

    Returns:
        The concatenated arrays: the k-th one joins the k-th arrays of all chunks.
    """
    if len(chunks) == 1:
        return chunks[0]
    arrays = [np.concatenate([chunk.pop(0) for chunk in chunks]) for _ in range(len(chunks[0]))]
    give_back_memory()  # memory that is freed between arrays in use stays reserved
    return arrays


class RowsBuilder:
    """Collects rows of numbers that a stage lists for one part of a lattice after the other.

    A row of numbers is spread over several arrays: it has an entry in each of them. Where the
    arrays are full, larger ones take their place. These have room for the rows of all cells, as
    estimated from the cells so far, but for at most `MAX_GROWTH` times as many rows as there are.
    So most rows are copied only a few times. Room that stays empty takes no memory: the system
    provides it when it is written.

    Attributes:
        num_rows: how many rows have been appended.
    """

    def __init__(self, empty_arrays: Sequence[NDArray[Any]]) -> None:
        """Start with no rows.

        Args:
            empty_arrays: for each array of the rows, an array without entries that has its dtype,
                and its shape after the first axis.
        """
        self.num_rows = 0
        self._arrays = list(empty_arrays)

    def append(self, pieces: Sequence[Sequence[NDArray[Any]]], appended_fraction: float) -> None:
        """Append rows.

        Args:
            pieces: the rows in any number of pieces; each has arrays of shape (n, ...).
            appended_fraction: the fraction of all cells that have their rows after this call, in
                (0, 1].
        """
        end_row = self.num_rows + sum(len(arrays[0]) for arrays in pieces)
        if end_row > len(self._arrays[0]):
            spare_factor = SPARE_FACTOR if appended_fraction < 1.0 else 1.0
            capacity = int(end_row * min(spare_factor / appended_fraction, MAX_GROWTH))
            for index, array in enumerate(self._arrays):
                self._arrays[index] = np.empty((capacity, *array.shape[1:]), array.dtype)
                self._arrays[index][: self.num_rows] = array[: self.num_rows]
        for arrays in pieces:
            rows_of_piece = slice(self.num_rows, self.num_rows + len(arrays[0]))
            for array, appended_array in zip(self._arrays, arrays, strict=True):
                array[rows_of_piece] = appended_array
            self.num_rows = rows_of_piece.stop

    def build(self) -> list[NDArray[Any]]:
        """Return the arrays with all rows, (n, ...) each."""
        return [array[: self.num_rows] for array in self._arrays]


def replace_slices(
    array: NDArray[Any],
    slice_begin: Int,
    slice_end: Int,
    replacement: NDArray[Any],
    replacement_start: Int,
) -> NDArray[Any]:
    """Replace slices of an array by other values, also by more or fewer than they have.

    ``array[slice_begin[i]:slice_end[i]]`` becomes
    ``replacement[replacement_start[i]:replacement_start[i + 1]]``.

    For few slices, copying what lies between them is faster than numpy's masks and indices.

    Args:
        array: the array, shape (n, ...).
        slice_begin: where each slice of `array` begins, ascending, shape (k,).
        slice_end: where each slice ends, exclusive, shape (k,).
        replacement: what replaces the slices, shape (m, ...).
        replacement_start: begin of each slice of `replacement`, and the end of the last one, shape
            (k + 1,).

    Returns:
        The new array; `array` is not changed.
    """
    unchanged_begin = [0, *slice_end.tolist()]
    unchanged_end = [*slice_begin.tolist(), len(array)]
    pieces = [replacement[:0]] * (2 * len(slice_begin) + 1)
    pieces[::2] = [
        array[begin:end] for begin, end in zip(unchanged_begin, unchanged_end, strict=True)
    ]
    pieces[1::2] = [replacement[begin:end] for begin, end in pairwise(replacement_start.tolist())]
    return np.concatenate(pieces)


def list_rows(
    kernel: Callable[..., int],
    blocks: Int,
    empty_arrays: tuple[NDArray[Any], ...],
    *args: object,
    least: int = 1,
) -> tuple[Int, list[NDArray[Any]]]:
    """Call a kernel that lists rows of numbers for some blocks or cells, on all threads.

    A row of numbers is spread over several arrays: it has an entry in each of them.

    Args:
        kernel: ``kernel(*args, blocks, row_counts, row_arrays, begin, end)`` writes the rows of
            ``blocks[begin:end]`` into the arrays `row_arrays`, from their first entry on, and into
            ``row_counts[begin:end]`` how many rows each block has. It returns `end`, or the index
            of the first block that had no room. It is then called again from that block on, with
            arrays that have more room.
        blocks: ids of the blocks or cells, (k,).
        empty_arrays: arrays without entries, which have the dtypes, and the shapes after the first
            axis, of the arrays that receive the rows.
        args: the kernel's first arguments.
        least: smallest number of blocks for one call, see `run_in_chunks`.

    Returns:
        How many rows each block has, (k,) int64; and the arrays with the rows, (n, ...) each, in
        the order of the blocks.
    """
    row_counts, pieces = list_rows_in_pieces(kernel, blocks, empty_arrays, *args, least=least)
    if len(pieces) == 1:
        return row_counts, pieces[0]
    return row_counts, [np.concatenate(arrays) for arrays in zip(*pieces, strict=True)]


def list_rows_in_pieces(
    kernel: Callable[..., int],
    blocks: Int,
    empty_arrays: tuple[NDArray[Any], ...],
    *args: object,
    least: int = 1,
) -> tuple[Int, list[list[NDArray[Any]]]]:
    """List rows as `list_rows` does, and leave it to the caller to join them.

    Args:
        kernel, blocks, empty_arrays, args, least: see `list_rows`.

    Returns:
        How many rows each block has, (k,) int64; and the arrays with the rows in pieces, in the
        order of the blocks, at least one piece.
    """
    row_counts = np.zeros(len(blocks), dtype=np.int64)
    arrays_of_range = dict[int, list[NDArray[Any]]]()  # by the index of the range's first block

    def list_range(first_block: int, end_block: int) -> None:
        capacity = FIRST_CAPACITY
        while first_block < end_block:
            row_arrays = tuple(
                np.empty((capacity, *array.shape[1:]), array.dtype) for array in empty_arrays
            )
            next_block = kernel(*args, blocks, row_counts, row_arrays, first_block, end_block)
            num_rows = row_counts[first_block:next_block].sum()
            arrays_of_range[first_block] = [array[:num_rows] for array in row_arrays]
            first_block = next_block
            capacity = CAPACITY_GROWTH * capacity

    run_in_chunks(list_range, len(blocks), min_chunk_size=least)
    pieces = [arrays_of_range[first_block] for first_block in sorted(arrays_of_range)]
    return row_counts, pieces or [list(empty_arrays)]
