"""Blocks of cells: the units in which a bake notes what has changed.

A lattice is cut into blocks of SIZE x SIZE cells, numbered row by row. What is global, such as
which surfaces make one sheet, is merged from what was found in each block; so an update looks at
the blocks again that something touched, and merges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.blocks import SIZE
from navbake.navgrid.lattice import Lattice
from navbake.threads import num_threads, run_in_bands
from navbake.types import Bool, Int


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
        """Some blocks and those with a cell at most so many rows and columns away from them."""
        by = -(-reach // SIZE)
        grid = mask.reshape(self.rows, self.cols)
        for axis in (0, 1):
            wide, moved = grid.copy(), np.moveaxis(grid, axis, 0)
            onto = np.moveaxis(wide, axis, 0)
            for k in range(1, min(by, len(moved) - 1) + 1):
                onto[k:] |= moved[:-k]
                onto[:-k] |= moved[k:]
            grid = wide
        return grid.ravel()

    def before(self, mask: Bool) -> Bool:
        """Some blocks, and those whose eastern or southern neighbour is one of them."""
        grid = mask.reshape(self.rows, self.cols).copy()
        grid[:, :-1] |= mask.reshape(grid.shape)[:, 1:]
        grid[:-1] |= mask.reshape(grid.shape)[1:]
        return grid.ravel()

    def windows(self, mask: Bool) -> list[tuple[slice, slice]]:
        """The rows and columns of cells of some blocks."""
        height, width = self.lattice.shape
        found = []
        for block in np.flatnonzero(mask).tolist():
            row, col = block // self.cols * SIZE, block % self.cols * SIZE
            found.append((slice(row, min(row + SIZE, height)), slice(col, min(col + SIZE, width))))
        return found


class Rows:
    """A table of which each block has some rows, in columns of numbers.

    Args:
        empty: an empty array of each column's dtype and shape.
    """

    def __init__(self, num_blocks: int, *empty: NDArray[Any]) -> None:
        self._parts: list[tuple[NDArray[Any], ...]] = [empty] * num_blocks

    def put_all(self, counts: Int, values: NDArray[Any]) -> Bool:
        """Replace the rows of all blocks, of one column; tells which blocks changed."""
        (old,), was = self.take(), self.counts()
        ends = np.cumsum(counts)
        changed: Bool = np.not_equal(was, counts)
        self._parts = [(part,) for part in np.split(values, ends[:-1])]
        same = ~changed
        if same.all():
            block = np.repeat(np.arange(len(counts)), counts)
            changed[block[old != values]] = True
        elif same.any():
            kept = np.repeat(same, counts), np.repeat(same, was)
            block = np.repeat(np.arange(len(counts)), counts)[kept[0]]
            changed[block[old[kept[1]] != values[kept[0]]]] = True
        return changed

    def put(self, blocks: Int, counts: Int, *columns: NDArray[Any]) -> Bool:
        """Replace the rows of some blocks, which follow each other; tells which changed."""
        ends = np.cumsum(counts).tolist()
        changed, begin = np.zeros(len(blocks), dtype=np.bool_), 0
        for k, (block, end) in enumerate(zip(blocks.tolist(), ends, strict=True)):
            new = tuple(column[begin:end] for column in columns)
            old = self._parts[block]
            changed[k] = not all(map(np.array_equal, new, old))
            self._parts[block], begin = new, end
        return changed

    def of(self, block: int) -> tuple[NDArray[Any], ...]:
        """The rows of a block."""
        return self._parts[block]

    def take(self) -> list[NDArray[Any]]:
        """The columns of all blocks, one block after the other."""
        return [np.concatenate(arrays) for arrays in zip(*self._parts, strict=True)]

    def counts(self) -> Int:
        """How many rows each block has."""
        return np.array([len(part[0]) for part in self._parts], dtype=np.int64)


def gather_rows(
    kernel: Callable[..., Any], count: int, *args: Any, least: int = 1
) -> list[NDArray[Any]]:
    """Call a kernel that returns arrays for ranges of work, and join these in their order."""
    found: dict[int, Sequence[NDArray[Any]]] = {}

    def work(first: int, end: int) -> None:
        found[first] = kernel(*args, first, end)

    if num_threads() == 1 or count <= least:
        return list(kernel(*args, 0, count))
    run_in_bands(work, count, least=least)
    return [np.concatenate(parts) for parts in zip(*(found[k] for k in sorted(found)), strict=True)]
