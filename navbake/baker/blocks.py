"""Blocks of cells: the units of an update.

A lattice is cut into blocks of SIZE x SIZE cells, numbered row by row. Global results, such as
sheets, are merged from those of each block; so an update evaluates the changed blocks and merges.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.tiles import SIZE
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Bool, Int

# Rows that `list_rows` has room for at first
ROOM = 4096


class Blocks:
    """The blocks of a lattice.

    Attributes:
        rows, cols, num: how many there are.
    """

    def __init__(self, lattice: Lattice) -> None:
        self.lattice = lattice
        self.rows, self.cols = -(-lattice.height // SIZE), -(-lattice.width // SIZE)
        self.num = self.rows * self.cols

    def of(self, cells: Int) -> Int:
        """The block of each cell."""
        row, col = np.divmod(cells, self.lattice.width)
        block: Int = row // SIZE * self.cols + col // SIZE
        return block

    def all(self) -> Bool:
        """All blocks."""
        return np.ones(self.num, dtype=np.bool_)

    def holding(self, cells: Int) -> Bool:
        """The blocks that hold any of some cells."""
        mask = np.zeros(self.num, dtype=np.bool_)
        mask[self.of(cells)] = True
        return mask

    def around(self, mask: Bool, reach: int = 1) -> Bool:
        """Some blocks and those with a cell within `reach` rows and columns of them."""
        by = -(-reach // SIZE)
        grid = mask.reshape(self.rows, self.cols)
        for _ in ("rows", "columns"):
            wide = grid.copy()
            for k in range(1, min(by, len(grid) - 1) + 1):
                wide[k:] |= grid[:-k]
                wide[:-k] |= grid[k:]
            grid = wide.T
        return grid.ravel()

    def near(self, cells: Int, reach: int) -> Bool:
        """The blocks with a cell within `reach` rows and columns of some cells."""
        if reach > SIZE:
            return self.around(self.holding(cells), reach)
        (height, width), away = self.lattice.shape, np.array([-reach, 0, reach])
        row, col = np.divmod(cells, width)
        rows = np.clip(row[:, None] + away, 0, height - 1) // SIZE
        cols = np.clip(col[:, None] + away, 0, width - 1) // SIZE
        mask = np.zeros(self.num, dtype=np.bool_)
        mask[rows[:, :, None] * self.cols + cols[:, None]] = True
        return mask

    def before(self, mask: Bool) -> Bool:
        """Some blocks, and those whose eastern or southern neighbour is one of them."""
        grid = mask.reshape(self.rows, self.cols).copy()
        grid[:, :-1] |= mask.reshape(grid.shape)[:, 1:]
        grid[:-1] |= mask.reshape(grid.shape)[1:]
        return grid.ravel()

    def cells(self, mask: Bool) -> Int:
        """The cells of some blocks."""
        (height, width), along = self.lattice.shape, np.arange(SIZE)
        row, col = (
            SIZE * place[:, None] + along for place in np.divmod(np.flatnonzero(mask), self.cols)
        )
        inside = (row < height)[:, :, None] & (col < width)[:, None, :]
        cells: Int = (row[:, :, None] * width + col[:, None, :])[inside]
        return cells

    def rim(self, mask: Bool) -> Int:
        """The border cells of the blocks around some blocks; those next to these are among them."""
        cells = self.cells(self.around(mask) & ~mask)
        row, col = np.divmod(cells, self.lattice.width)
        return cells[np.isin(row % SIZE, (0, SIZE - 1)) | np.isin(col % SIZE, (0, SIZE - 1))]


def fit(array: NDArray[Any], length: int) -> NDArray[Any]:
    """The array, or if it is shorter a copy with room for so many members."""
    if len(array) >= length:
        return array
    wide = np.empty((length, *array.shape[1:]), dtype=array.dtype)
    wide[: len(array)] = array
    return wide


def join_parts(parts: list[list[NDArray[Any]]]) -> list[NDArray[Any]]:
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
        least: see `run_in_bands`.
    """
    counts = np.zeros(len(blocks), dtype=np.int64)
    found: dict[int, list[NDArray[Any]]] = {-1: list(empty)}

    def work(first: int, end: int) -> None:
        room = ROOM
        while first < end:
            columns = tuple(np.empty((room, *one.shape[1:]), one.dtype) for one in empty)
            done = kernel(*args, blocks, counts, columns, first, end)
            found[first] = [column[: counts[first:done].sum()] for column in columns]
            first, room = done, 2 * room

    run_in_bands(work, len(blocks), least=least)
    if len(found) == 2:
        return counts, found[0]
    parts = zip(*(found[first] for first in sorted(found)), strict=True)
    return counts, [np.concatenate(arrays) for arrays in parts]


class BlockTable:
    """A table with rows for each block, in columns of numbers.

    Args:
        empty: an empty array of each column's dtype and shape.
    """

    def __init__(self, num_blocks: int, *empty: NDArray[Any]) -> None:
        self._empty, self._columns = empty, list(empty)
        self._counts = np.zeros(num_blocks, dtype=np.int64)

    def fill(self, kernel: Callable[..., int], blocks: Int, *args: Any) -> Int:
        """List the rows of some blocks again, as `list_rows`; returns how many each block has."""
        counts, columns = list_rows(kernel, blocks, self._empty, *args)
        if len(blocks) == len(self._counts):
            self._counts[:], self._columns = counts, columns
            return counts
        last = np.cumsum(self._counts)[blocks]
        runs, start = (last - self._counts[blocks], last), np.append(0, np.cumsum(counts))
        pairs = zip(self._columns, columns, strict=True)
        self._columns = [splice(old, *runs, new, start) for old, new in pairs]
        self._counts[blocks] = counts
        return counts

    def take(self) -> tuple[Int, list[NDArray[Any]]]:
        """The block of each row, and the columns of all blocks, one block after the other."""
        return np.repeat(np.arange(len(self._counts)), self._counts), self._columns


class Seen:
    """The values of each block in the last update."""

    def __init__(self, num_blocks: int) -> None:
        self._counts, self._values = np.zeros(num_blocks, dtype=np.int64), np.empty(0)

    def differ(self, counts: Int, values: NDArray[Any]) -> Bool:
        """The blocks whose values differ from the last ones, which are replaced."""
        changed: Bool = self._counts != counts
        same = ~changed
        was, now = self._values[np.repeat(same, self._counts)], values[np.repeat(same, counts)]
        changed[np.repeat(np.flatnonzero(same), counts[same])[was != now]] = True
        self._counts, self._values = counts.copy(), values
        return changed


class BlockAnswers:
    """A cache of answers about places, valid while a block's places and surroundings stay."""

    def __init__(self, num_blocks: int) -> None:
        self._seen, self._counts = Seen(num_blocks), np.zeros(num_blocks, dtype=np.int64)
        self._answers, self._now = np.empty(0, dtype=np.uint8), 0

    def find(
        self, block: Int, places: Int, last: Int, now: int, ask: Callable[[Bool], NDArray[np.uint8]]
    ) -> NDArray[np.uint8]:
        """The answer for each place.

        Args:
            block: of each place, ascending.
            places: the key of each place, shape (places, n).
            last: the last update that changed something near each block; `now` is this one.
            ask: finds the answers for the places of a mask.
        """
        counts = np.bincount(block, minlength=len(last))
        same = ~self._seen.differ(counts * places.shape[1], places.ravel()) & (last <= self._now)
        known = same[block]
        answers = np.empty(len(block), dtype=np.uint8)
        answers[known] = self._answers[np.repeat(same, self._counts)]
        answers[~known] = ask(~known)
        self._counts, self._answers, self._now = counts, answers, now
        return answers
