"""Random places: uniform numbers in, places out."""

from __future__ import annotations

from navbake.errors import QueryError
from navbake.tensors.grid_tensors import Array, GridTensors
from navbake.tensors.layers import island
from navbake.tensors.locate import (
    as_array,
    bounded,
    broadcast,
    check_numbers,
    check_scenes,
    device_of,
    split,
)


def sample(
    t: GridTensors,
    u: Array,
    room: Array | int | None = None,
    min_clearance: Array | float | None = None,
    reachable_from: Array | None = None,
    scene_id: Array | int | None = None,
) -> Array:
    """Turn uniform random numbers into places where an agent can stand, each cell equally likely.

    The same numbers give the same places. The free cells are kept sorted by island and room, so a
    draw is one look-up; with `min_clearance` a running sum over the cells comes before it.

    Args:
        t: tensors of one or several grids; the cells of a grid's levels are of one size.
        u: numbers in [0, 1), shape (..., 3): the first chooses the cell, the others the x and y in
            it. 0.5 for these is the cell's centre, where the agent's radius fits for certain.
            Shape (..., 1) gives centres.
        room: only in this room, by its number (see `room`); an integer or integers of shape (...).
        min_clearance: only in cells with so much of `clearance` [m]; one number.
        reachable_from: only where a walk leads to from these world positions, shape (..., 3) or
            (3,).
        scene_id: which grid, where there are several; an integer or integers of shape (...).

    Returns:
        World x, y and floor z [m], shape (..., 3); NaN where there is no such place, or a number
        of `u` is NaN.
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
        cells, keys = t.by_room, t.room_key
        is_known = is_known & (group >= 0)
    else:
        start = as_array(t, reachable_from)
        if scenes is not None:
            start = broadcast(t, start, (*shape, 3), "reachable_from")
        home = broadcast(t, island(t, start, scenes), shape, "reachable_from")
        group = xp.astype(home, t.index)
        cells, keys = t.by_island, t.island_key
        is_known = is_known & (group > 0)
    if cells.shape[0] == 0:
        return xp.full((*shape, 3), xp.nan, dtype=t.dtype, device=device_of(t))
    low, high = group * base, (group + 1) * base
    if room is not None:
        number = check_numbers(t, room, "room", base, shape)
        is_known = is_known & (number >= 0)
        low = group * base + number
        high = low + 1
    begin, end = _find(t, keys, low), _find(t, keys, high)
    if min_clearance is not None:
        if getattr(min_clearance, "ndim", 0) != 0:
            raise QueryError("expected one number as min_clearance [m], got an array of them")
        allowed = xp.astype(t.clearance[cells] >= min_clearance, t.index)
        before = xp.concat([xp.zeros_like(allowed[:1]), xp.cumulative_sum(allowed)])
        count = before[end] - before[begin]
        at = _find(t, before[1:], before[begin] + _rank(t, first, count) + 1)
    else:
        count = end - begin
        at = begin + _rank(t, first, count)
    cell = xp.astype(cells[bounded(xp, at, 0, cells.shape[0] - 1)], t.index)
    places = _within(t, cell, numbers)
    is_place = is_known & (count > 0) & ~xp.any(xp.isnan(places), axis=-1)
    return xp.where(is_place[..., None], places, xp.nan)


def _rank(t: GridTensors, u: Array, count: Array) -> Array:
    """Which of `count` cells a number in [0, 1) means, 0 to count - 1."""
    rank = t.xp.astype(t.xp.floor(u * t.xp.astype(count, t.dtype)), t.index)
    rank = t.xp.minimum(rank, count - 1)  # u * count may be rounded up
    return t.xp.where(rank < 0, 0, rank)


def _find(t: GridTensors, keys: Array, wanted: Array) -> Array:
    """How many of the sorted keys are smaller than each number."""
    flat = t.xp.reshape(t.xp.astype(wanted, keys.dtype), (-1,))
    found = t.xp.searchsorted(keys, flat, side="left")
    return t.xp.reshape(t.xp.astype(found, t.index), wanted.shape)


def _within(t: GridTensors, cell: Array, numbers: Array) -> Array:
    """Places in cells: at their centres, or where the second and third numbers say."""
    xp, shape = t.xp, t.shape
    level, row, col = split(t, cell)
    z = t.floor[cell]
    z = xp.where(xp.isnan(z), t.ground[level], z)
    west = t.x_edge[level * (shape.cols + 1) + col]
    east = t.x_edge[level * (shape.cols + 1) + col + 1]
    north = t.y_edge[level * (shape.rows + 1) + row]
    south = t.y_edge[level * (shape.rows + 1) + row + 1]
    across, down = (0.5, 0.5) if numbers.shape[-1] == 1 else (numbers[..., 1], numbers[..., 2])
    # the eastern and the southern edge belong to the next cells
    x = xp.minimum(west + across * (east - west), xp.nextafter(east, xp.full_like(east, -xp.inf)))
    y = xp.maximum(north - down * (north - south), xp.nextafter(south, xp.full_like(south, xp.inf)))
    return xp.stack([x, y, z], axis=-1)
