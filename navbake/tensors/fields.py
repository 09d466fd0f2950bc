"""Distances to goals and the ways there, from the fields that the tensors were made with."""

from collections.abc import Callable

import numpy as np

from navbake.errors import QueryError
from navbake.tensors.grid_tensors import Array, GridTensors
from navbake.tensors.locate import (
    centers,
    check_number,
    check_numbers,
    check_positions,
    check_scenes,
    locate,
)
from navbake.tensors.pieces import answer_all


def distance_to_goal(
    t: GridTensors,
    positions: Array,
    goal: Array | int = 0,
    scene_id: Array | int | None = None,
) -> Array:
    """What the cheapest path from each position to a goal costs, as `PathFinder.distances` has it.

    Args:
        t: tensors that were made with goals.
        positions: world x, y, z [m], shape (..., 3), in the tensors' dtype.
        goal: the place of the goal among those that the tensors were made with; an integer, or
            integers that fit the shape (...).
        scene_id: which grid, where there are several.

    Returns:
        Shape (...): metres times weights; inf where no path leads to the goal, NaN beside the
        grid.
    """

    def answer(p: Array, first: Array | int, scenes: Array) -> Array:
        found = locate(t, p, scenes)
        return t.xp.where(found.inside, t.cost[first + found.cell], t.xp.nan)

    return _ask(t, answer, positions, goal, scene_id)


def path_step(
    t: GridTensors,
    positions: Array,
    goal: Array | int = 0,
    scene_id: Array | int | None = None,
) -> Array:
    """The direction to go from each position to get to a goal.

    It is that from the position to the centre of the next cell of the cheapest path. Whoever
    follows it stays in the cells of that path, over links to other levels as well.

    Args:
        t, positions, goal, scene_id: see `distance_to_goal`.

    Returns:
        World x, y of unit vectors, shape (..., 2): zeros in the goal's cell, NaN where there is
        no path.
    """
    return _ask(t, lambda *given: _steps(t, *given), positions, goal, scene_id)


def _steps(t: GridTensors, p: Array, first: Array | int, scenes: Array) -> Array:
    """`path_step` of checked positions."""
    xp = t.xp
    found = locate(t, p, scenes)
    onward = xp.astype(t.onward[first + found.cell], t.index)
    leads = found.inside & (onward >= 0)
    ways = centers(t, xp.where(leads, onward, 0)) - p[..., :2]
    ways = xp.where((leads & (onward != found.cell))[..., None], ways, 0.0)
    length = xp.sqrt(ways[..., 0] ** 2 + ways[..., 1] ** 2)
    unit = ways / xp.where(length > 0, length, 1.0)[..., None]
    return xp.where(leads[..., None], unit, xp.nan)


def _ask(
    t: GridTensors,
    answer: Callable[..., Array],
    positions: Array,
    goal: Array | int,
    scene_id: Array | int | None,
) -> Array:
    xp, p, count = t.xp, check_positions(t, positions), len(t.goals)
    if not count:
        raise QueryError("the tensors know no goals: name them when they are made, goals=[…]")
    shape, num_cells = p.shape[:-1], int(t.floor.shape[0])
    if isinstance(goal, int | np.integer):
        first = check_number(goal, "goal", count) * num_cells
    else:
        goals = check_numbers(t, goal, "goal", count, shape)
        p = xp.where((goals >= 0)[..., None], p, xp.nan)  # to no goal, so from nowhere
        first = xp.where(goals >= 0, goals, 0) * num_cells
    # `first` is where the goal's cells begin in `cost` and `onward`
    return answer_all(t, answer, p, first, check_scenes(t, scene_id, shape))
