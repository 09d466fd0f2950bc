"""Stacks of levels: what is stacked comes back, and no cells of two levels are neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.baker.core.components import label_components_2d
from navbake.baker.core.level_stacks import MAX_STACK_CELLS, LevelStack, make_level_stacks

SHAPE = (3, 4)


def make_levels(num_levels: int) -> list[np.ndarray]:
    cells = np.arange(SHAPE[0] * SHAPE[1], dtype=np.int32).reshape(SHAPE)
    return [cells + 100 * level for level in range(num_levels)]


@pytest.mark.parametrize("levels", [range(5), range(2, 5), range(3, 4)])
def test_levels_come_back_from_a_stack(levels):
    arrays = make_levels(5)
    stack = LevelStack(levels, SHAPE)
    stacked = stack.stack(arrays)
    np.testing.assert_array_equal(stack.unstack(stacked), arrays[levels[0] : levels[-1] + 1])
    cells = np.array([0, 5, 11])
    for level in levels:
        expected = arrays[level].ravel()[cells]
        np.testing.assert_array_equal(stacked.ravel()[stack.cells_of(level, cells)], expected)


def test_components_end_with_their_level():
    is_open = [np.ones(SHAPE, dtype=np.bool_)] * 3
    stack = LevelStack(range(3), SHAPE)
    label, num_cells = label_components_2d(stack.stack(is_open))
    assert len(num_cells) - 1 == 3
    assert [np.unique(labels).tolist() for labels in stack.unstack(label)] == [[1], [2], [3]]


@pytest.mark.parametrize(
    ("num_levels", "shape"),
    [(1, SHAPE), (7, (MAX_STACK_CELLS // 3, 1)), (3, (MAX_STACK_CELLS, 2)), (2000, (40, 40))],
)
def test_each_level_is_in_one_stack(num_levels, shape):
    stacks = make_level_stacks(num_levels, shape)
    assert [level for stack in stacks for level in stack.levels] == list(range(num_levels))
    for stack in stacks:
        num_cells = len(stack.levels) * shape[0] * shape[1]
        assert num_cells <= MAX_STACK_CELLS or len(stack.levels) == 1
