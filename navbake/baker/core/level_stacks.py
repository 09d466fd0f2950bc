"""Stacks of levels: arrays in which several levels lie, so that one call works on all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.types import Int, ScalarT

# A stack of small levels has up to this many cells: enough that the time of numpy's calls doesn't
# count, and so few that its arrays need little memory. A larger level is a stack by itself
MAX_STACK_CELLS = 1 << 20


class LevelStack:
    """Several levels in arrays in which the rows of one level follow those of the level before.

    A row of zeros lies between two levels. So cells of two levels are never neighbours, and a
    function of one level's cells and their neighbours works on all levels of a stack at once.

    Attributes:
        levels: the numbers of the levels.
    """

    def __init__(self, levels: range, shape: tuple[int, int]) -> None:
        """Stack levels.

        Args:
            levels: the numbers of the levels, at least one.
            shape: the shape of each level, (height, width).
        """
        self.levels = levels
        self._height, self._width = shape
        self._num_rows = self._height + (len(levels) > 1)  # of a level in the stack

    def stack(self, arrays: Sequence[NDArray[ScalarT]]) -> NDArray[ScalarT]:
        """Put arrays of levels into one array.

        Args:
            arrays: an array for each level of the scene, shape (height, width).

        Returns:
            The arrays of the stack's levels as one array, shape (rows, width). It is a copy, but
            for a stack of one level.
        """
        if len(self.levels) == 1:
            return arrays[self.levels[0]]
        stacked_array = np.zeros(
            (len(self.levels), self._num_rows, self._width), arrays[self.levels[0]].dtype
        )
        np.stack([arrays[level] for level in self.levels], out=stacked_array[:, : self._height])
        return stacked_array.reshape(-1, self._width)

    def unstack(self, stacked_array: NDArray[ScalarT]) -> NDArray[ScalarT]:
        """Return the levels of a stacked array one by one, as a view.

        Args:
            stacked_array: an array with an entry for each cell of the stack, shape (rows, width).

        Returns:
            The array of each level, shape (levels, height, width).
        """
        by_level = stacked_array.reshape(len(self.levels), self._num_rows, self._width)
        return by_level[:, : self._height]

    def cells_of(self, level: int | Int, cells: Int) -> Int:
        """Return the ids that cells of levels have in the stack.

        Args:
            level: the number of the cells' level, or of each cell's level, shape (n,).
            cells: ids of the cells on their level, shape (n,).
        """
        return (level - self.levels[0]) * (self._num_rows * self._width) + cells


def make_level_stacks(num_levels: int, shape: tuple[int, int]) -> list[LevelStack]:
    """Divide levels into stacks: many small levels to a stack, or one large one.

    Args:
        num_levels: how many levels there are.
        shape: the shape of each level, (height, width).

    Returns:
        The stacks, lowest levels first.
    """
    levels_per_stack = max(1, MAX_STACK_CELLS // (shape[0] * shape[1]))
    return [
        LevelStack(range(first_level, min(first_level + levels_per_stack, num_levels)), shape)
        for first_level in range(0, num_levels, levels_per_stack)
    ]
