"""Blocks of cells: stages work on several at a time, on all threads, and merge the results.

A lattice is cut into blocks of BLOCK x BLOCK cells, numbered row by row. A kernel lists rows of
numbers for each block; things that extend over blocks, such as regions, are merged from these rows.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.tiles import BLOCK
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS, run_in_chunks
from navbake.types import Int

# How many rows of numbers the first call of a kernel in `list_rows` has room for
FIRST_CAPACITY = 4096
# The fewest blocks in a chunk, where little is done for each cell
LEAST_BLOCKS = LEAST_CELLS // BLOCK**2
# How many times as many rows the next call has room for. A block that had no room is done again,
# and may have many rows, as in a tower; memory that no row is written into takes none
CAPACITY_GROWTH = 8


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
        cells_of_block_rows = [
            cells[max(row - first_row, 0) : row + BLOCK - first_row]
            for row in range(first_row // BLOCK * BLOCK, end_row, BLOCK)
        ]
        return np.concatenate(
            [
                block_row_cells[:, col : col + BLOCK].ravel()
                for block_row_cells in cells_of_block_rows
                for col in range(0, width, BLOCK)
            ]
        )

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
    return [np.concatenate([chunk.pop(0) for chunk in chunks]) for _ in range(len(chunks[0]))]


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
    row_counts = np.zeros(len(blocks), dtype=np.int64)
    # index of a range's first block -> the range's rows; -1 -> arrays without rows
    arrays_of_range: dict[int, list[NDArray[Any]]] = {-1: list(empty_arrays)}

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
    if len(arrays_of_range) == 2:
        return row_counts, arrays_of_range[0]
    ranges_in_order = [arrays_of_range[first_block] for first_block in sorted(arrays_of_range)]
    return row_counts, [np.concatenate(arrays) for arrays in zip(*ranges_in_order, strict=True)]
