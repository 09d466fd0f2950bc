"""Batched queries: layers at positions, surroundings of agents, paths to goals, random places.

Each function takes the tensors `t` of one or several grids, and positions, world x, y, z [m], of
any shape (..., 3) in the tensors' dtype, and returns values of shape (...). With several grids,
`scene_id` selects one: an integer, or integers of shape (...). A position that is not finite or
outside the grid gives NaN, False, 0 or -1. QueryError is raised for an array of another shape or
dtype, and for an unknown scene or goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from navbake.errors import QueryError
from navbake.tensors.grid_tensors import (
    Array,
    GridTensors,
    Ids,
    answer_all,
    as_array,
    bounded,
    broadcast,
    check_number,
    check_numbers,
    check_positions,
    check_scenes,
    device_of,
    first_level,
    locate,
    split,
)

MODES = ("nearest", "bilinear")


def level_at(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """The level of each position, int32, as in `PathFinder.cell_at`; -1 for none."""

    def answer(p: Array, scenes: Array) -> Array:
        _, level, inside = locate(t, p, scenes)
        return t.xp.astype(t.xp.where(inside, level, -1), t.xp.int32)

    return _ask(t, answer, positions, scene_id)


def floor(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """World z of the floor under each position [m], NaN for none."""
    return _value(t, t.floor, t.xp.nan, positions, scene_id)


def room(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """The room of each position, int32, 0 for none; ``t.rooms[scene][number - 1]`` is its id."""
    return _value(t, t.room, 0, positions, scene_id)


def area(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """The area of each position, int32, 0 for none; ``t.areas[scene][number - 1]`` is its name."""
    return _value(t, t.area, 0, positions, scene_id)


def island(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """The connected part of each position, int32, 0 for none.

    Parts are numbered through all scenes in order. In tensors of one grid, the numbers are those of
    `PathFinder.island_at`.
    """
    return _value(t, t.island, 0, positions, scene_id)


def is_navigable(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """Whether an agent can stand at each position, by the `max_drop` of `make_tensors`; bool."""

    def answer(p: Array, scenes: Array) -> Array:
        cell, _, inside = locate(t, p, scenes)
        return inside & (p[..., 2] <= t.top[cell])

    return _ask(t, answer, positions, scene_id)


def clearance(
    t: GridTensors, positions: Array, scene_id: Ids = None, mode: str = "bilinear"
) -> Array:
    """The distance from each position to the nearest cell that isn't free [m]; NaN outside.

    Unlike `PathFinder.clearance`, which measures from the position to obstacles, it is a layer,
    `navbake.navgrid.islands.clearance`: from each free cell's centre to the nearest centre of a
    cell that isn't free, less half a cell; 0 in all others.

    The mode ``"nearest"`` returns the value of the position's cell, as ``grid.values_at`` does;
    ``"bilinear"`` interpolates between the centres of the four cells round the position on its
    level, and is differentiable; the outer cells are continued at the edge of the grid.
    """
    if mode not in MODES:
        raise QueryError(f"expected a mode of {', '.join(MODES)}, got {mode!r}")
    if mode == "nearest":
        return _value(t, t.clearance, t.xp.nan, positions, scene_id)
    xp = t.xp
    shape = t.shape

    def answer(p: Array, scenes: Array) -> Array:
        _, on, inside = locate(t, p, scenes)
        level = first_level(t, scenes) + on
        # keep positions outside the grid out of the gradient
        x = xp.where(inside, p[..., 0], t.x_first[level])
        y = xp.where(inside, p[..., 1], t.y_first[level])
        across = (x - t.x_first[level]) * t.scale[level] - 0.5
        down = (t.y_first[level] - y) * t.scale[level] - 0.5
        last_col = t.num_cols[level] - 1
        last_row = t.num_rows[level] - 1
        col0 = bounded(xp, xp.astype(xp.floor(across), t.index), 0, last_col)
        row0 = bounded(xp, xp.astype(xp.floor(down), t.index), 0, last_row)
        col1 = xp.minimum(col0 + 1, last_col)
        row1 = xp.minimum(row0 + 1, last_row)
        share_x = bounded(xp, across - xp.astype(col0, t.dtype), 0.0, 1.0)
        share_y = bounded(xp, down - xp.astype(row0, t.dtype), 0.0, 1.0)

        def along(row: Array) -> Array:
            at = level * (shape.rows * shape.cols) + row * shape.cols
            return t.clearance[at + col0] * (1 - share_x) + t.clearance[at + col1] * share_x

        between = along(row0) * (1 - share_y) + along(row1) * share_y
        return xp.where(inside, between, xp.nan)

    return _ask(t, answer, positions, scene_id)


def _value(t: GridTensors, layer: Array, outside: float, positions: Array, scene_id: Ids) -> Array:
    """The values of a layer in the cells of positions."""

    def answer(p: Array, scenes: Array) -> Array:
        cell, _, inside = locate(t, p, scenes)
        return t.xp.where(inside, layer[cell], outside)

    return _ask(t, answer, positions, scene_id)


def _ask(t: GridTensors, answer: Callable[..., Array], positions: Array, scene_id: Ids) -> Array:
    p = check_positions(t, positions)
    return answer_all(t, answer, p, check_scenes(t, scene_id, p.shape[:-1]))


LAYERS: dict[str, Any] = {
    "floor": floor,
    "free": is_navigable,
    "room": room,
    "area": area,
    "island": island,
    "clearance": partial(clearance, mode="nearest"),
}
"""The function behind each layer of `patch`."""


def heights(
    t: GridTensors, positions: Array, yaw: Array, pattern: Array, scene_id: Ids = None
) -> Array:
    """A height scan: floor heights at a pattern of points round each agent, rotated with it.

    Each point's floor is the nearest below the agent, by the rule of `level_at`. `yaw` are the
    agents' headings [rad], 0 along x, counted towards y, shape (...); `pattern` are points in their
    frames, x ahead, y to the left [m], shape (k, 2). World z [m], shape (..., k); NaN for no floor.
    """
    return floor(t, *_turned(t, positions, yaw, pattern, scene_id))


def patch(
    t: GridTensors,
    positions: Array,
    yaw: Array,
    shape: tuple[int, int] = (64, 64),
    cell: float = 0.05,
    layer: str = "free",
    scene_id: Ids = None,
) -> Array:
    """Cut an egocentric map of a layer round each agent, with its heading up.

    The agent is in the middle. Each pixel, of edge `cell` [m], shows the cell at its middle, by the
    rule of `level_at` at the agent's z. The layer is ``free`` (bool), ``floor``, ``clearance``
    (both [m]), ``room``, ``area`` or ``island`` (int32); `yaw` as of `heights`. Shape (..., rows,
    columns); False, NaN or 0 outside.
    """
    if layer not in LAYERS:
        raise QueryError(f"no layer {layer!r}: expected one of {', '.join(LAYERS)}")
    if not isinstance(shape, Sequence) or [isinstance(n, int) for n in shape] != [True, True]:
        raise QueryError(f"expected a shape (rows, columns), whole numbers, got {shape!r}")
    rows, cols = shape
    if rows < 1 or cols < 1 or not 0 < cell < math.inf:
        raise QueryError(f"expected rows, columns and a cell > 0, got {shape} and {cell!r}")
    xp = t.xp
    device = device_of(t)
    cell = float(cell)
    ahead = (xp.arange(rows, dtype=t.dtype, device=device) - (rows - 1) / 2) * -cell
    left = (xp.arange(cols, dtype=t.dtype, device=device) - (cols - 1) / 2) * -cell
    grid = xp.reshape(xp.stack(xp.meshgrid(ahead, left, indexing="ij"), axis=-1), (-1, 2))
    values = LAYERS[layer](t, *_turned(t, positions, yaw, grid, scene_id))
    return xp.reshape(values, (*values.shape[:-1], rows, cols))


def _turned(
    t: GridTensors, positions: Array, yaw: Array, pattern: Array, scene_id: Ids
) -> tuple[Array, Array]:
    """World positions of a pattern's points round agents, shape (..., k, 3), and their scenes."""
    xp = t.xp
    p = check_positions(t, positions)
    turn = as_array(t, yaw)
    points = as_array(t, pattern)
    if points.ndim != 2 or points.shape[-1] != 2:
        raise QueryError(f"expected a pattern of shape (k, 2), got {tuple(points.shape)}")
    shape = tuple(p.shape[:-1])
    given = tuple(turn.shape)
    if given != shape:
        raise QueryError(f"expected a yaw of shape {shape}, one for each position, got {given}")
    cos = xp.cos(turn)[..., None]
    sin = xp.sin(turn)[..., None]
    x = p[..., 0, None] + cos * points[:, 0] - sin * points[:, 1]
    y = p[..., 1, None] + sin * points[:, 0] + cos * points[:, 1]
    world = xp.stack([x, y, xp.broadcast_to(p[..., 2, None], x.shape)], axis=-1)
    scenes = check_scenes(t, scene_id, shape)
    return world, None if scenes is None else scenes[..., None]


def distance_to_goal(
    t: GridTensors, positions: Array, goal: Ids = 0, scene_id: Ids = None
) -> Array:
    """The cost of the cheapest path from each position to a goal, as in `PathFinder.distances`.

    `goal` is its number among those of the tensors: an integer, or integers that broadcast to
    (...). Costs are metres times weights; inf for no path, NaN outside the grid.
    """

    def answer(p: Array, first: Array | int, scenes: Array) -> Array:
        cell, _, inside = locate(t, p, scenes)
        return t.xp.where(inside, t.cost[first + cell], t.xp.nan)

    return _ask_goal(t, answer, positions, goal, scene_id)


def distances(
    t: GridTensors, starts: Array, goals: Array | None = None, scene_id: Ids = None
) -> Array:
    """`distance_to_goal` from each start to each of several goals, shape (..., m).

    `goals` are their numbers, shape (m,); all goals of the tensors in their order unless given.
    """
    count = _num_goals(t)
    num_cells = int(t.floor.shape[0])
    given = list(range(count)) if goals is None else goals
    numbers = check_numbers(t, given, "goal", count, (len(given),))

    def answer(p: Array, scenes: Array) -> Array:
        cell, _, inside = locate(t, p, scenes)
        first = t.xp.where(numbers >= 0, numbers, 0) * num_cells
        known = inside[..., None] & (numbers >= 0)
        return t.xp.where(known, t.cost[first + cell[..., None]], t.xp.nan)

    return _ask(t, answer, starts, scene_id)


def path_step(t: GridTensors, positions: Array, goal: Ids = 0, scene_id: Ids = None) -> Array:
    """The direction from each position to the centre of the next cell of the cheapest path.

    Following it stays in the cells of that path, also over steps to other levels; at the stop of a
    link it points to the stop that the path leads to. World x, y of unit vectors, shape (..., 2):
    zeros in the goal's cell and in a lift whose stops lie over each other, NaN for no path.
    """
    xp = t.xp

    def answer(p: Array, first: Array | int, scenes: Array) -> Array:
        cell, _, inside = locate(t, p, scenes)
        onward = xp.astype(t.onward[first + cell], t.index)
        leads = inside & (onward >= 0)
        level, row, col = split(t, xp.where(leads, onward, 0))
        size = 1 / t.scale[level]
        x = t.x_first[level] + (xp.astype(col, t.dtype) + 0.5) * size
        y = t.y_first[level] - (xp.astype(row, t.dtype) + 0.5) * size
        ways = xp.stack([x, y], axis=-1) - p[..., :2]
        ways = xp.where((leads & (onward != cell))[..., None], ways, 0.0)
        length = xp.sqrt(ways[..., 0] ** 2 + ways[..., 1] ** 2)
        unit = ways / xp.where(length > 0, length, 1.0)[..., None]
        return xp.where(leads[..., None], unit, xp.nan)

    return _ask_goal(t, answer, positions, goal, scene_id)


def _ask_goal(
    t: GridTensors, answer: Callable[..., Array], positions: Array, goal: Ids, scene_id: Ids
) -> Array:
    xp = t.xp
    p = check_positions(t, positions)
    num_cells = int(t.floor.shape[0])
    shape = p.shape[:-1]
    if isinstance(goal, int | np.integer):
        first = check_number(goal, "goal", _num_goals(t)) * num_cells
    else:
        goals = check_numbers(t, goal, "goal", _num_goals(t), shape)
        p = xp.where((goals >= 0)[..., None], p, xp.nan)  # unknown goals
        first = xp.where(goals >= 0, goals, 0) * num_cells
    # `first` is where the goal's cells begin in `cost` and `onward`
    return answer_all(t, answer, p, first, check_scenes(t, scene_id, shape))


def _num_goals(t: GridTensors) -> int:
    if not t.goals:
        raise QueryError("the tensors know no goals: name them when they are made, goals=[…]")
    return len(t.goals)


def sample(
    t: GridTensors,
    u: Array,
    room: Ids = None,
    min_clearance: Array | float | None = None,
    reachable_from: Array | None = None,
    scene_id: Ids = None,
) -> Array:
    """Turn uniform random numbers into places where an agent can stand, each cell equally likely.

    The same numbers give the same places. A grid's levels must have cells of one size.

    Args:
        u: numbers in [0, 1), shape (..., 3): the first chooses the cell, the others the x and y in
            it. 0.5 is the cell's centre, where the agent's radius fits for certain.
            Shape (..., 1) returns centres.
        room: only in this room, by its number (see `room`); an integer or integers of shape (...).
        min_clearance: only in cells with at least this `clearance` [m]; one number.
        reachable_from: only cells of the island of these world positions, shape (..., 3) or (3,).

    Returns:
        World x, y and floor z [m], shape (..., 3); NaN if there is no such place.
    """
    xp = t.xp
    numbers = as_array(t, u)
    if numbers.ndim == 0 or numbers.shape[-1] not in (1, 3):
        raise QueryError(f"expected u of shape (..., 3) or (..., 1), got {tuple(numbers.shape)}")
    shape = tuple(numbers.shape[:-1])
    scenes = check_scenes(t, scene_id, shape)
    base = t.num_rooms + 1
    is_known = ~xp.isnan(numbers[..., 0])
    first = xp.where(is_known, numbers[..., 0], 0.0)
    if reachable_from is None:
        group = xp.zeros_like(first, dtype=t.index) if scenes is None else scenes
        cells = t.by_room
        keys = t.room_key
        is_known = is_known & (group >= 0)
    else:
        start = as_array(t, reachable_from)
        if scenes is not None:
            start = broadcast(t, start, (*shape, 3), "reachable_from")
        home = broadcast(t, island(t, start, scenes), shape, "reachable_from")
        group = xp.astype(home, t.index)
        cells = t.by_island
        keys = t.island_key
        is_known = is_known & (group > 0)
    if cells.shape[0] == 0:
        return xp.full((*shape, 3), xp.nan, dtype=t.dtype, device=device_of(t))
    low = group * base
    high = (group + 1) * base
    if room is not None:
        number = check_numbers(t, room, "room", base, shape)
        is_known = is_known & (number >= 0)
        low = group * base + number
        high = low + 1

    def find(keys: Array, wanted: Array) -> Array:
        """The number of sorted keys smaller than each number."""
        flat = xp.reshape(xp.astype(wanted, keys.dtype), (-1,))
        found = xp.searchsorted(keys, flat, side="left")
        return xp.reshape(xp.astype(found, t.index), wanted.shape)

    begin = find(keys, low)
    end = find(keys, high)
    count = end - begin
    before = None
    if min_clearance is not None:
        if getattr(min_clearance, "ndim", 0) != 0:
            raise QueryError("expected one number as min_clearance [m], got an array of them")
        allowed = xp.astype(t.clearance[cells] >= min_clearance, t.index)
        before = xp.concat([xp.zeros_like(allowed[:1]), xp.cumulative_sum(allowed)])
        count = before[end] - before[begin]
    # the number's cell among `count`; the product may be rounded up
    rank = xp.astype(xp.floor(first * xp.astype(count, t.dtype)), t.index)
    rank = bounded(xp, xp.minimum(rank, count - 1), 0, cells.shape[0])
    at = begin + rank if before is None else find(before[1:], before[begin] + rank + 1)
    cell = xp.astype(cells[bounded(xp, at, 0, cells.shape[0] - 1)], t.index)
    level, row, col = split(t, cell)
    z = t.floor[cell]
    z = xp.where(xp.isnan(z), t.ground[level], z)
    column = level * (t.shape.cols + 1) + col
    line = level * (t.shape.rows + 1) + row
    west = t.x_edge[column]
    east = t.x_edge[column + 1]
    north = t.y_edge[line]
    south = t.y_edge[line + 1]
    across, down = (0.5, 0.5) if numbers.shape[-1] == 1 else (numbers[..., 1], numbers[..., 2])
    # the eastern and the southern edge belong to the next cells
    x = xp.minimum(west + across * (east - west), xp.nextafter(east, xp.full_like(east, -xp.inf)))
    y = xp.maximum(north - down * (north - south), xp.nextafter(south, xp.full_like(south, xp.inf)))
    places = xp.stack([x, y, z], axis=-1)
    is_place = is_known & (count > 0) & ~xp.any(xp.isnan(places), axis=-1)
    return xp.where(is_place[..., None], places, xp.nan)
