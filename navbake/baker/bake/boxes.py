"""Finds the box of each level (`bbox`), by which the original client finds a position's level.

The original client is the program that the grid's JSON format was made for: `NavScene.js` of sstk.
It takes the first level whose box contains a position, edges included; if no box does, it fails. So
a box begins below the lowest floor of its level, and ends below the next box above its cells. If
levels interleave (a stair of one level rises past the lowest tread of the next), a box ends where
the client finds the wrong level for the fewest free cells.

Source: sstk's `NavScene.js`, `positionToCell`. The client's grid of a level has one more column and
one more row, after the last ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.core.windows import Window, bounding_window, grow_window
from navbake.baker.floors.levels import LevelFloor
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Vector3

Box = tuple[Vector3, Vector3]
"""Lower and upper corner, file frame (y up) [m]."""

# A box begins this far below its lowest floor, beyond the rounding of float32 and of units [m]
BOX_MARGIN = 0.001
BOX_GAP = 1e-6  # between a box and the one above it [m]
BOX_DECIMALS = 6  # decimals of heights that are multiples of `BOX_MARGIN` and `BOX_GAP`
LENGTH_DECIMALS = 9  # decimals of all other lengths: what is smaller is rounding


class LevelBoxes(NamedTuple):
    """The rectangle of cells and the bounding box of each level, lowest level first.

    The boxes are for the original client, the program that the grid's JSON format was made for
    (`NavScene.js` of sstk): it finds a position's level by them.

    Attributes:
        windows: the rectangle of each level: rows and columns of the lattice.
        boxes: the box of each level, in the frame of the grid's file.
        num_misplaced_cells: the number of free cells for which the original client finds a wrong
            level, or none, with all doors open. This may happen where levels interleave.
        misplaced_levels: the numbers of the levels that these cells belong to, ascending.
    """

    windows: list[Window]
    boxes: list[Box]
    num_misplaced_cells: int
    misplaced_levels: list[int]


def find_level_boxes(
    levels: Sequence[LevelFloor],
    is_occupied_by_level: Sequence[Bool],
    lattice: Lattice,
    scene_box: Float | None,
    agent_height: float,
) -> LevelBoxes:
    """Crop each level to its own rectangle of the lattice, and find its box.

    A single level keeps the whole lattice. Its box is the scene's, enlarged where a floor lies
    outside.

    Several levels are each cropped to the cells that have a floor, and a ring of one cell around
    them. The ring has no floor, so its cells count as occupied, and walls there keep larger agents
    away. A level's box spans the cells that have a floor, without the ring. Only where the scene
    ends in the outer half of the last of these cells, the box ends there, too. In height, it spans
    from `BOX_MARGIN` below the level's lowest floor to `BOX_GAP` below the next box above it, or to
    the scene's top. An agent on the highest floor is inside of the highest level's box. Whether
    doors are open or closed has no influence on either.

    Args:
        levels: the levels on the whole lattice, lowest first.
        is_occupied_by_level: the cells of each level that structure occupies, (height, width).
        lattice: the cells of all levels.
        scene_box: the box of all finite geoms of the structure, (2, 3) [m]; None for none.
        agent_height: height of the agent [m].

    Returns:
        The rectangles, the boxes, and the free cells for which the original client finds a wrong
        level by these boxes.
    """
    floors = [level.floor.astype(np.float32) for level in levels]  # as written to a file
    lowest_floors = [float(np.fmin.reduce(floor, axis=None)) for floor in floors]
    highest_floors = [float(np.fmax.reduce(floor, axis=None)) for floor in floors]
    floor_windows = [bounding_window(~np.isnan(floor)) for floor in floors]
    box_sides = [_level_sides(lattice.cut(*window), scene_box) for window in floor_windows]
    if len(levels) == 1:
        full_window = (slice(0, lattice.height), slice(0, lattice.width))
        box = _single_level_box(
            box_sides[0], lowest_floors[0], highest_floors[0], scene_box, agent_height
        )
        return LevelBoxes([full_window], [box], 0, [])
    bottoms = [round(z - BOX_MARGIN, BOX_DECIMALS) for z in lowest_floors]
    bottoms[0] = min(bottoms[0], round(levels[0].ground - BOX_MARGIN, BOX_DECIMALS))
    highest_top = max(highest_floors) + agent_height
    if scene_box is not None:
        highest_top = max(highest_top, float(scene_box[1, 2]))
    # The floors of single cells matter only where a level reaches up to a box above it.
    free_floors = [np.empty((0, 0)) for _ in levels]
    if any(
        z > min(bottoms[k:], default=np.inf) - 2 * BOX_GAP for k, z in enumerate(highest_floors, 1)
    ):
        free_floors = [
            np.where(is_occupied, np.float64(np.nan), floor)
            for floor, is_occupied in zip(floors, is_occupied_by_level, strict=True)
        ]
    tops, num_misplaced_cells = _find_tops(
        free_floors,
        windows=floor_windows,
        bottoms=bottoms,
        lowest_floors=np.array(lowest_floors),
        highest_top=round(highest_top, LENGTH_DECIMALS),
    )
    boxes = [_to_file_frame(*box) for box in zip(box_sides, bottoms, tops, strict=True)]
    return LevelBoxes(
        windows=[grow_window(window, 1, 1, lattice.shape) for window in floor_windows],
        boxes=boxes,
        num_misplaced_cells=int(num_misplaced_cells.sum()),
        misplaced_levels=np.flatnonzero(num_misplaced_cells).tolist(),
    )


def rounded_ground(level: LevelFloor) -> float:
    """Return a level's ground height, rounded to a nanometre [m]."""
    return round(level.ground, LENGTH_DECIMALS) + 0.0  # + 0.0 turns -0.0 into 0.0


def _find_tops(
    free_floors: list[Float],
    windows: list[Window],
    bottoms: list[float],
    lowest_floors: Float,
    highest_top: float,
) -> tuple[list[float], Int]:
    """Find the top of each level's box, the lowest level first, as the client searches.

    Args:
        free_floors: the floor of each level's free cells as written, NaN elsewhere [m]. Cells that
            the client misplaces become NaN.
        windows: the rectangle of each level's cells that have a floor.
        bottoms: the bottom of each level's box [m].
        lowest_floors: the lowest floor of each level, free or not, shape (levels,) [m].
        highest_top: the top of the highest box [m].

    Returns:
        The tops [m], and how many free cells of each level the client misplaces.
    """
    tops = []
    num_misplaced_cells = np.zeros(len(free_floors), dtype=np.int64)
    # The levels in the order of their lowest floors. For each k, the levels from number k on begin
    # at an index in this order: levels at a smaller index all have numbers below k.
    ascending_levels = np.argsort(lowest_floors, kind="stable")
    index_of_level = np.argsort(ascending_levels)
    first_index_from_level = np.minimum.accumulate(index_of_level[::-1])[::-1].tolist()
    first_index_from_level.append(len(ascending_levels))
    for k, (floor, window, bottom) in enumerate(zip(free_floors, windows, bottoms, strict=True)):
        free_heights = floor[~np.isnan(floor)]
        highest_floor = float(free_heights.max(initial=-np.inf))
        levels_above = []
        # the box ends below this height: levels whose floors are all higher do not matter
        height_limit = np.inf
        for j in ascending_levels[first_index_from_level[k + 1] :].tolist():
            if lowest_floors[j] > height_limit:
                break
            if j <= k:
                continue
            levels_above.append(j)
            is_over_all_floors = bottoms[j] > highest_floor
            if height_limit == np.inf and is_over_all_floors and _are_adjacent(window, windows[j]):
                height_limit = max(float(lowest_floors[j]), highest_floor, bottom) + 2 * BOX_MARGIN
        floors_above = [free_floors[j][window] for j in levels_above]
        heights_above = np.concatenate([np.empty(0), *(z[z >= bottom] for z in floors_above)])
        highest_contained_floor = _last_floor(free_heights, heights_above)
        # The box ends below the boxes, and the floors of levels that interleave, that it must not
        # contain. Cells beside each other count as well: see the source at the top of this file.
        top_limits = [
            bottoms[j]
            for j in levels_above
            if bottoms[j] > highest_contained_floor and _are_adjacent(window, windows[j])
        ]
        next_floor = float(
            heights_above[heights_above > highest_contained_floor].min(initial=np.inf)
        )
        top_limit = min([*top_limits, next_floor - BOX_MARGIN])
        top = highest_top
        if top_limit <= highest_top:
            top = round(top_limit - BOX_GAP, BOX_DECIMALS)
            # however large the limit is, the top is below it: at the next float, if need be
            top = float(min(top, np.nextafter(top_limit, -np.inf)))
        top = max(top, highest_contained_floor, bottom)
        tops.append(top)
        # the client misses the floors above the box, and takes higher levels' floors in it for k's
        is_misplaced = floor > top
        num_misplaced_cells[k] += np.count_nonzero(is_misplaced)
        floor[is_misplaced] = np.nan
        for j, z in zip(levels_above, floors_above, strict=True):
            is_misplaced = (z >= bottom) & (z <= top)
            num_misplaced_cells[j] += np.count_nonzero(is_misplaced)
            z[is_misplaced] = np.nan
    return tops, num_misplaced_cells


def _are_adjacent(first_window: Window, second_window: Window) -> bool:
    """Return whether two windows have cells in common, or touch along an edge or at a corner."""
    range_pairs = zip(first_window, second_window, strict=True)
    return all(
        first_range.start <= second_range.stop and second_range.start <= first_range.stop
        for first_range, second_range in range_pairs
    )


def _last_floor(floors: Float, heights_above: Float) -> float:
    """Return the height of the highest floor that a level's box should contain; -inf for none [m].

    It is chosen so that the client finds the right level for as many cells as possible: the most
    floors of the level itself are in its box, less the floors of higher levels that are in it, too.

    Args:
        floors: heights of the level's free cells, shape (n,) [m].
        heights_above: heights of the free cells of higher levels over the same rectangle, at or
            above the bottom of the level's box, shape (m,) [m].
    """
    highest_floor = floors.max(initial=-np.inf)
    if highest_floor < heights_above.min(initial=np.inf):
        return float(highest_floor)
    # Of the floors below all of the higher levels', only the highest can be the best.
    is_below_all = floors < heights_above.min(initial=np.inf)
    heights, num_at_height = np.unique(floors[~is_below_all], return_counts=True)
    heights = np.append(floors[is_below_all].max(initial=-np.inf), heights)
    num_contained = np.append(np.count_nonzero(is_below_all), num_at_height).cumsum()
    heights_above = np.sort(heights_above[heights_above <= highest_floor])
    num_misplaced_cells = np.searchsorted(heights_above, heights, side="right")
    scores = np.append(0, num_contained - num_misplaced_cells)
    best_index = len(scores) - 1 - int(np.argmax(scores[::-1]))  # the highest of equally good ones
    return float(np.append(-np.inf, heights)[best_index])


def _level_sides(lattice: Lattice, scene_box: Float | None) -> Float:
    """Return x_min, y_min, x_max, y_max of a level's box, shape (4,) [m].

    They are the sides of the rectangle of the level's cells that have a floor. Where the scene ends
    in the outer half of the rectangle's last cells, the scene's side takes their place.

    Args:
        lattice: the cells of this rectangle.
        scene_box: the box of all finite geoms of the structure, (2, 3) [m]; None for none.
    """
    x_min, y_min, x_max, y_max = lattice.bounds
    sides = np.round([x_min, y_min, x_max, y_max], LENGTH_DECIMALS) + 0.0
    if scene_box is None:
        return sides
    half_cell_size = lattice.cell_size / 2
    scene_sides = np.round(scene_box[:, :2].ravel(), LENGTH_DECIMALS) + 0.0
    # Only a side between the rectangle's side and the centres of the outermost cells along it is
    # taken from the scene.
    center_lines = np.array(
        [
            x_min + half_cell_size,
            y_min + half_cell_size,
            x_max - half_cell_size,
            y_max - half_cell_size,
        ]
    )
    is_between = np.minimum(sides, center_lines) <= scene_sides
    is_between &= scene_sides <= np.maximum(sides, center_lines)
    return np.where(is_between, scene_sides, sides)


def _single_level_box(
    sides: Float,
    lowest_floor: float,
    highest_floor: float,
    scene_box: Float | None,
    agent_height: float,
) -> Box:
    """Return the box of the only level: the scene's box, enlarged where the grid extends beyond it.

    Args:
        sides: x_min, y_min, x_max, y_max of the grid, shape (4,) [m].
        lowest_floor: height of the lowest floor [m].
        highest_floor: height of the highest floor [m].
        scene_box: the box of all finite geoms of the structure, (2, 3) [m]; None for none.
        agent_height: height of the agent [m].
    """
    if scene_box is None:
        bottom = round(lowest_floor - BOX_MARGIN, LENGTH_DECIMALS)
        top = round(highest_floor + agent_height, LENGTH_DECIMALS)
        return _to_file_frame(sides, bottom, top)
    scene_corners = np.round(scene_box, LENGTH_DECIMALS) + 0.0
    sides[:2] = np.minimum(sides[:2], scene_corners[0, :2])
    sides[2:] = np.maximum(sides[2:], scene_corners[1, :2])
    bottom = float(scene_corners[0, 2])
    top = float(scene_corners[1, 2])
    if bottom > lowest_floor:
        bottom = round(lowest_floor - BOX_MARGIN, BOX_DECIMALS)
    return _to_file_frame(sides, bottom, max(top, highest_floor))


def _to_file_frame(sides: Float, bottom: float, top: float) -> Box:
    """Return a box in the frame of the file, where y is up.

    Args:
        sides: x_min, y_min, x_max, y_max in the world frame, shape (4,) [m].
        bottom: height of the box's bottom [m].
        top: height of the box's top [m].
    """
    x_min, y_min, x_max, y_max = sides.tolist()
    return (x_min, bottom + 0.0, 0.0 - y_max), (x_max, top + 0.0, 0.0 - y_min)
