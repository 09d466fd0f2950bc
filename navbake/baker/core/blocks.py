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
from navbake.threads import run_in_chunks
from navbake.types import Int

# How many rows of numbers the first call of a kernel in `list_rows` has room for
FIRST_CAPACITY = 4096


class Blocks:
    """The blocks of a lattice.

    Attributes:
        lattice: the cells.
        rows, cols: how many rows and columns of blocks there are.
        num: how many blocks there are in all.
    """

    def __init__(self, lattice: Lattice) -> None:
        """Divide a lattice into blocks of BLOCK x BLOCK cells."""
        self.lattice = lattice
        self.rows = -(-lattice.height // BLOCK)
        self.cols = -(-lattice.width // BLOCK)
        self.num = self.rows * self.cols

    def cells(self, blocks: Int) -> Int:
        """Return the ids of the cells of some blocks, block by block, shape (n,)."""
        height, width = self.lattice.shape
        offsets = np.arange(BLOCK)
        block_row, block_col = np.divmod(blocks, self.cols)
        row = BLOCK * block_row[:, None] + offsets
        col = BLOCK * block_col[:, None] + offsets
        inside = (row < height)[:, :, None] & (col < width)[:, None, :]
        cells: Int = (row[:, :, None] * width + col[:, None, :])[inside]
        return cells

    def list_rows(
        self, kernel: Callable[..., int], empty: tuple[NDArray[Any], ...], *args: object
    ) -> tuple[Int, list[NDArray[Any]]]:
        """List rows of numbers for all blocks, by `list_rows` of this module.

        Args:
            kernel: see `list_rows`.
            empty: see `list_rows`.
            args: the kernel's first arguments.

        Returns:
            The block of each row, (n,); and the rows, as arrays of shape (n, ...).
        """
        block_ids = np.arange(self.num)
        counts, columns = list_rows(kernel, block_ids, empty, *args)
        return np.repeat(block_ids, counts), columns


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


def splice(old: NDArray[Any], begin: Int, end: Int, new: NDArray[Any], start: Int) -> NDArray[Any]:
    """Replace slices of an array: ``old[begin[i]:end[i]]`` by ``new[start[i]:start[i + 1]]``.

    For few slices, copying what lies between them is faster than numpy's masks and indices.

    Args:
        old: the array, shape (n, ...).
        begin, end: begin and end of each slice of `old`, ascending, shape (k,).
        new: what replaces the slices, shape (m, ...).
        start: begin of each slice of `new`, and the end of the last one, shape (k + 1,).

    Returns:
        The new array; `old` is not changed.
    """
    unchanged_begin = [0, *end.tolist()]
    unchanged_end = [*begin.tolist(), len(old)]
    pieces = [new[:0]] * (2 * len(begin) + 1)
    pieces[::2] = [old[i:j] for i, j in zip(unchanged_begin, unchanged_end, strict=True)]
    pieces[1::2] = [new[i:j] for i, j in pairwise(start.tolist())]
    return np.concatenate(pieces)


def list_rows(
    kernel: Callable[..., int],
    blocks: Int,
    empty: tuple[NDArray[Any], ...],
    *args: object,
    least: int = 1,
) -> tuple[Int, list[NDArray[Any]]]:
    """List rows of numbers for some blocks or cells, on all threads.

    A row consists of an entry in each of several arrays, the columns.

    Args:
        kernel: ``kernel(*args, blocks, counts, columns, begin, end)`` writes the rows of
            ``blocks[begin:end]`` into the columns, from their first entry on, and into
            ``counts[begin:end]`` how many rows each block has. It returns `end`, or the index of
            the first block that had no room. It is then called again from that block on, with
            columns that have more room.
        blocks: ids of the blocks or cells, (k,).
        empty: an empty array for each column, with its dtype and its shape after the first axis.
        args: the kernel's first arguments.
        least: smallest number of blocks for one call, see `run_in_chunks`.

    Returns:
        How many rows each block has, (k,) int64; and the columns, (n, ...) each, with the rows in
        the order of the blocks.
    """
    counts = np.zeros(len(blocks), dtype=np.int64)
    # index of a range's first block -> columns of the range; -1 -> empty columns
    columns_of_range: dict[int, list[NDArray[Any]]] = {-1: list(empty)}

    def list_range(first: int, end: int) -> None:
        capacity = FIRST_CAPACITY
        while first < end:
            columns = tuple(
                np.empty((capacity, *column.shape[1:]), column.dtype) for column in empty
            )
            next_block = kernel(*args, blocks, counts, columns, first, end)
            num_rows = counts[first:next_block].sum()
            columns_of_range[first] = [column[:num_rows] for column in columns]
            first = next_block
            capacity = 2 * capacity

    run_in_chunks(list_range, len(blocks), least=least)
    if len(columns_of_range) == 2:
        return counts, columns_of_range[0]
    in_order = [columns_of_range[first] for first in sorted(columns_of_range)]
    return counts, [np.concatenate(arrays) for arrays in zip(*in_order, strict=True)]
