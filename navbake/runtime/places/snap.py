"""The nearest place where an agent can stand."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid.cells import check_positions
from navbake.runtime.places.locate import flat_cell, links_of, place_of
from navbake.runtime.places.navigable import MAX_DROP
from navbake.runtime.places.sample import cells_in_annulus, check_distance

if TYPE_CHECKING:
    from navbake.runtime.flat_grid import Walk
    from navbake.runtime.places.sight import Sight

FIRST_LOOK = 1.0  # metres round a position that are searched first for what is in sight


def snap_to(
    walk: Walk,
    position: ArrayLike,
    allowed: NDArray[np.bool_],
    *,
    level: int | None = None,
    same_level: bool = True,
    sight: Sight | None = None,
    max_distance: float = math.inf,
) -> NDArray[np.float64] | None:
    """Find the nearest place where an agent can stand.

    Where the position's own cell is allowed, and its floor is at most 0.5 m below, that is the
    position itself, put on the floor. Else it is the centre of a cell: of the one whose centre
    is the nearest on the map on the position's level, or in space on any level.

    Args:
        walk: the grid.
        position: world x, y, z [m]; x, y will do on one level.
        allowed: cells that one may snap to, by flat id, shape (n,), bool.
        level: which level the position is on; that of the nearest floor below it unless given.
        same_level: whether to stay on that level. A position that is on none is snapped to the
            nearest floor in space.
        sight: if given, nothing may stand between the position and the place. The position may
            be in something: then the line has to come out of it without leaving its room.
        max_distance: farther ones don't count [m], >= 0.

    Returns:
        World x, y and floor z [m], shape (3,), float64; None where there is no such place.

    Raises:
        QueryError: there is no such level, the position is none, or the distance is negative.
    """
    check_distance(max_distance)
    p = check_positions(position, walk.num_levels, level)
    home = flat_cell(walk, p, level)
    if home is not None and allowed[home] and _is_on_floor(walk, p, home, level):
        return np.append(p[:2], walk.positions(np.array(home))[2])
    if level is None and home is not None:
        level = int(walk.level_of(np.array(home)))
    on_map = level is not None and (same_level or len(p) == 2)
    levels = [level] if on_map and level is not None else list(range(walk.num_levels))
    if len(p) == 2:
        p = np.append(p, walk.ground[level or 0])
    if sight is not None:
        cell = _nearest_in_sight(walk, p, home, allowed, levels, sight, max_distance, on_map)
    else:
        cell = _nearest(walk, p, allowed, levels, max_distance, on_map)
    return walk.positions(np.array(cell)) if cell >= 0 else None


def nearest_on_level(
    walk: Walk,
    position: ArrayLike,
    mask: NDArray[np.bool_],
    *,
    level: int | None = None,
    max_distance: float = math.inf,
) -> int | None:
    """Find the cell of a mask whose centre is the nearest on the map, on the position's level.

    Args:
        walk: the grid.
        position: world x, y, z [m]; x, y will do on one level.
        mask: by flat id, shape (n,), bool.
        level: which level the position is on; that of the nearest floor below it unless given.
        max_distance: farther ones don't count [m].

    Returns:
        Flat id; None for none, and for a position that is in no cell.

    Raises:
        QueryError: there is no such level, the position is none, or the distance is negative.
    """
    check_distance(max_distance)
    p = check_positions(position, walk.num_levels, level)
    home = flat_cell(walk, p, level)
    if home is None:
        return None
    cell = _nearest(walk, p, mask, [int(walk.level_of(np.array(home)))], max_distance, True)
    return cell if cell >= 0 else None


def _is_on_floor(walk: Walk, p: NDArray[np.float64], cell: int, level: int | None) -> bool:
    if level is not None or len(p) == 2:
        return True
    return bool(p[2] - walk.positions(np.array(cell))[2] <= MAX_DROP)


def _nearest(
    walk: Walk,
    p: NDArray[np.float64],
    allowed: NDArray[np.bool_],
    levels: list[int],
    max_distance: float,
    on_map: bool,
) -> int:
    """The nearest allowed cell of some levels, -1 for none."""
    from navbake.runtime.kernels.nearest import IN_SPACE, TO_CENTER, nearest_cell

    measure = TO_CENTER if on_map else IN_SPACE
    best, found = max_distance, -1
    for level in levels:
        cell, distance = nearest_cell(
            place_of(walk), level, allowed, walk.floor, p, best, measure, walk.ground[level]
        )
        if cell >= 0 and (found < 0 or distance < best):
            best, found = distance, int(cell)
    return found


def _nearest_in_sight(
    walk: Walk,
    p: NDArray[np.float64],
    home: int | None,
    allowed: NDArray[np.bool_],
    levels: list[int],
    sight: Sight,
    max_distance: float,
    on_map: bool,
) -> int:
    """The nearest allowed cell in sight, -1 for none: rounds of twice the reach each."""
    if home is None:
        return -1
    from navbake.runtime.kernels.nearest import first_in_sight

    reach, done = FIRST_LOOK, -1.0
    farthest = min(max_distance, _farthest(walk, p, levels, on_map))
    while done < farthest:
        radius = min(reach, farthest)
        cells = np.concatenate(
            [cells_in_annulus(walk, k, p[0], p[1], 0.0, radius, allowed) for k in levels]
        )
        offset = walk.positions(cells) - p
        distance = np.linalg.norm(offset[:, :2] if on_map else offset, axis=1)
        near = np.flatnonzero((distance > done) & (distance <= radius))
        found = first_in_sight(
            place_of(walk), links_of(walk), sight.clear, walk.floor, sight.room, home,
            p[0], p[1], cells[near[np.argsort(distance[near], kind="stable")]],
        )  # fmt: skip
        if found >= 0:
            return int(found)
        reach, done = 2.0 * reach, reach
    return -1


def _farthest(walk: Walk, p: NDArray[np.float64], levels: list[int], on_map: bool) -> float:
    """No cell of the levels is farther from a position [m], on the map or in space."""
    x1 = walk.x_min + walk.width * walk.cell_size
    y0 = walk.y_max - walk.height * walk.cell_size
    across = np.maximum(np.abs(walk.x_min - p[0]), np.abs(x1 - p[0]))
    along = np.maximum(np.abs(walk.y_max - p[1]), np.abs(y0 - p[1]))
    farthest = float(np.hypot(across, along)[levels].max())
    if on_map:
        return farthest
    heights = np.append(walk.floor, walk.ground)
    return farthest + float(np.nanmax(np.abs(heights - p[2])))
