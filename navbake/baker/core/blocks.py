"""Blocks of cells: stages work on them on all threads, and merge what each block yields.

A lattice is cut into blocks of BLOCK x BLOCK cells, numbered row by row. What is global, such as
regions, is merged from rows of numbers that a kernel lists for each block.
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

# Rows of numbers that the first call of a kernel in `list_rows` has room for
FIRST_CAPACITY = 4096


class Blocks:
    """The blocks of a lattice.

    Attributes:
        lattice: the cells.
        rows, cols: how many blocks there are along y and along x.
        num: how many blocks there are.
    """

    def __init__(self, lattice: Lattice) -> None:
        """Divide a lattice."""
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
            The block of each row, (n,), and the arrays of the rows' fields, (n, ...) each.
        """
        block_ids = np.arange(self.num)
        counts, columns = list_rows(kernel, block_ids, empty, *args)
        return np.repeat(block_ids, counts), columns


def join_arrays(chunks: list[list[NDArray[Any]]]) -> list[NDArray[Any]]:
    """Concatenate the arrays of several chunks one by one, and free each chunk's memory on the way.

    Args:
        chunks: at least one list of arrays, all of one length; the lists are emptied.

    Returns:
        The concatenated arrays: the k-th one joins the k-th arrays of all chunks.
    """
    if len(chunks) == 1:
        return chunks[0]
    return [np.concatenate([chunk.pop(0) for chunk in chunks]) for _ in range(len(chunks[0]))]


def splice(old: NDArray[Any], first: Int, last: Int, new: NDArray[Any], start: Int) -> NDArray[Any]:
    """Replace slices of an array: ``old[first[i]:last[i]]`` by ``new[start[i]:start[i + 1]]``.

    Where the runs are few, copying what lies between them is faster than numpy's masks and indices.

    Args:
        old: entries, shape (n, ...).
        first, last: begin and end of each run in `old`, ascending, (runs,).
        new: entries to put in place of them, shape (m, ...).
        start: begin of each run in `new`, and the end of the last one, (runs + 1,).
    """
    gap_begins = [0, *last.tolist()]
    gap_ends = [*first.tolist(), len(old)]
    pieces = [new[:0]] * (2 * len(first) + 1)
    pieces[::2] = [old[begin:end] for begin, end in zip(gap_begins, gap_ends, strict=True)]
    pieces[1::2] = [new[begin:end] for begin, end in pairwise(start.tolist())]
    return np.concatenate(pieces)


def list_rows(
    kernel: Callable[..., int],
    blocks: Int,
    empty: tuple[NDArray[Any], ...],
    *args: object,
    least: int = 1,
) -> tuple[Int, list[NDArray[Any]]]:
    """List rows of numbers for some blocks or cells, on all threads.

    Args:
        kernel: ``kernel(*args, blocks, counts, columns, begin, end)`` writes the rows of
            ``blocks[begin:end]`` into the columns, from their first row on, and how many each
            block has into `counts`. It returns the index of the first block for which there was no
            room, or `end`. It is called again for the blocks from there on, with more room.
        blocks: ids of the blocks or cells, (k,).
        empty: for each field of a row, an empty array with its dtype and shape.
        args: the kernel's first arguments.
        least: smallest range of blocks for one call, see `run_in_chunks`.

    Returns:
        How many rows each block has, (k,) int64, and for each field of a row an array, (n, ...), in
        the order of the blocks.
    """
    counts = np.zeros(len(blocks), dtype=np.int64)
    # the columns of each range of blocks, by the index of its first block; those of none by -1
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
