"""Blocks of cells: what stages run on all threads, and what their results are merged from.

A lattice is cut into blocks of BLOCK x BLOCK cells, numbered row by row. What is global, such as
regions, is merged from the rows of numbers that a kernel lists for each block.
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

# Rows that `list_rows` has room for at first
ROOM = 4096


class Blocks:
    """The blocks of a lattice.

    Attributes:
        rows, cols, num: how many there are.
    """

    def __init__(self, lattice: Lattice) -> None:
        self.lattice = lattice
        self.rows = -(-lattice.height // BLOCK)
        self.cols = -(-lattice.width // BLOCK)
        self.num = self.rows * self.cols

    def cells(self, blocks: Int) -> Int:
        """The cells of some blocks."""
        height, width = self.lattice.shape
        along = np.arange(BLOCK)
        block_row, block_col = np.divmod(blocks, self.cols)
        row = BLOCK * block_row[:, None] + along
        col = BLOCK * block_col[:, None] + along
        inside = (row < height)[:, :, None] & (col < width)[:, None, :]
        cells: Int = (row[:, :, None] * width + col[:, None, :])[inside]
        return cells

    def list_rows(
        self, kernel: Callable[..., int], empty: tuple[NDArray[Any], ...], *args: Any
    ) -> tuple[Int, list[NDArray[Any]]]:
        """List rows of numbers for all blocks, see `list_rows`: the block of each, and columns."""
        every_block = np.arange(self.num)
        counts, columns = list_rows(kernel, every_block, empty, *args)
        return np.repeat(every_block, counts), columns


def join_arrays(parts: list[list[NDArray[Any]]]) -> list[NDArray[Any]]:
    """Concatenate the arrays of parts, one at least, and free each one's memory on the way."""
    if len(parts) == 1:
        return parts[0]
    return [np.concatenate([part.pop(0) for part in parts]) for _ in range(len(parts[0]))]


def splice(old: NDArray[Any], first: Int, last: Int, new: NDArray[Any], start: Int) -> NDArray[Any]:
    """Replace runs of rows: ``old[first[i]:last[i]]`` by ``new[start[i]:start[i + 1]]``.

    The runs ascend. Where they are few, copying what lies between them is faster than numpy's
    masks and indices.
    """
    ends = zip([0, *last.tolist()], [*first.tolist(), len(old)], strict=True)
    pieces = [new[:0]] * (2 * len(first) + 1)
    pieces[::2] = [old[begin:end] for begin, end in ends]
    pieces[1::2] = [new[begin:end] for begin, end in pairwise(start.tolist())]
    return np.concatenate(pieces)


def list_rows(
    kernel: Callable[..., int],
    blocks: Int,
    empty: tuple[NDArray[Any], ...],
    *args: Any,
    least: int = 1,
) -> tuple[Int, list[NDArray[Any]]]:
    """List rows of numbers for some blocks or cells: how many each has, and the columns of all.

    Args:
        kernel: ``kernel(*args, blocks, counts, columns, begin, end)`` writes the rows of
            ``blocks[begin:end]`` into the columns, from their first row on, and how many each has
            into `counts`; returns the place of the first block for which there is no room, or
            `end`.
        empty: an empty array of each column's dtype and shape.
        least: see `run_in_chunks`.
    """
    counts = np.zeros(len(blocks), dtype=np.int64)
    # the columns of each range of blocks, by its first block
    ranges: dict[int, list[NDArray[Any]]] = {-1: list(empty)}

    def work(first: int, end: int) -> None:
        room = ROOM
        while first < end:
            columns = tuple(np.empty((room, *column.shape[1:]), column.dtype) for column in empty)
            done = kernel(*args, blocks, counts, columns, first, end)
            num_rows = counts[first:done].sum()
            ranges[first] = [column[:num_rows] for column in columns]
            first = done
            room = 2 * room

    run_in_chunks(work, len(blocks), least=least)
    if len(ranges) == 2:
        return counts, ranges[0]
    in_order = [ranges[first] for first in sorted(ranges)]
    return counts, [np.concatenate(arrays) for arrays in zip(*in_order, strict=True)]
