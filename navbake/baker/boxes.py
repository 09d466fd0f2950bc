"""The box of each level (`bbox`), so that the original client finds each cell's own level.

The client takes the first level whose box holds a position, edges included, and ends with an
error where none does. So a box begins below the lowest floor of its level, and ends below the box
of the next level that has cells in common with it. Where levels interleave (a stair of one level
rises past the lowest tread of the next), no boxes are right for all cells. Then a box ends where
the fewest free cells are lost.

Source: sstk's `NavScene.js`, `positionToCell`. Its grid also takes the cells one column and one
row beyond the last for its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.lists import count_heights
from navbake.baker.lattice import Window, bounding_window
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Vector3

Box = tuple[Vector3, Vector3]
"""Lower and upper corner, file frame (y up) [m]."""

# A box begins this far below its lowest floor: more than float32 and a change of units move it [m]
MARGIN = 0.001
GAP = 1e-6  # between a box and the one above it [m]
GAP_DIGITS = 6  # decimals of heights that are multiples of the two
DIGITS = 9  # decimals of other lengths: what is smaller is rounding


class LevelBoxes(NamedTuple):
    """Where the levels lie, lowest first, and what their boxes cost.

    Attributes:
        windows: rows and columns of the lattice that each level's grid has.
        boxes: the box of each level.
        num_free: free cells of all levels, doors being open.
        lost: how many of them the original client puts on another level, or on none.
        lost_on: the levels whose cells these are, ascending.
    """

    windows: list[Window]
    boxes: list[Box]
    num_free: int
    lost: int
    lost_on: list[int]


class _Open(NamedTuple):
    """The free cells of one level, doors being open, by their floors; a height may repeat.

    Attributes:
        z: heights as written [m].
        cells: how many have each.
        inside: whether these cells lie in the windows of all levels, shape (n, levels), bool.
    """

    z: Float
    cells: Int
    inside: Bool


def find_level_boxes(
    levels: Sequence[LevelFloor],
    occupied: Sequence[Bool],
    lattice: Lattice,
    scene_box: Float | None,
    agent_height: float,
) -> LevelBoxes:
    """Cut each level's rectangle from the lattice, and find its box.

    One level keeps the whole lattice. Its box is the scene's own, made larger where a floor of
    the grid lies outside. Of several, each is cut to the cells that have a floor. Its box spans
    its rectangle, up to the scene's sides, from `MARGIN` below its lowest floor to `GAP` below
    the next box above it, or to the scene's top. No two boxes share a height over a cell, unless
    the levels interleave there; neither depends on the state of doors.

    Args:
        levels: lowest first.
        occupied: the occupied cells of each level, as its floor is shaped, doors left out.
        lattice: of the whole scene.
        scene_box: (2, 3), of all finite geoms [m], None if there are none.
        agent_height: an agent on the highest floor is in the highest level's box [m].
    """
    written = [level.floor.astype(np.float32).astype(np.float64) for level in levels]
    if len(levels) == 1:
        free = int(np.count_nonzero(~np.isnan(written[0]) & ~occupied[0]))
        whole = (slice(0, lattice.height), slice(0, lattice.width))
        box = _scene_box(written[0], lattice, scene_box, agent_height)
        return LevelBoxes([whole], [box], free, 0, [])
    windows = [bounding_window(~np.isnan(floor)) for floor in written]
    bottoms = [round(float(np.nanmin(floor)) - MARGIN, GAP_DIGITS) for floor in written]
    bottoms[0] = min(bottoms[0], round(levels[0].ground - MARGIN, GAP_DIGITS))
    top = max(float(np.nanmax(floor)) for floor in written) + agent_height
    if scene_box is not None:
        top = max(top, float(scene_box[1, 2]))
    cells = [_open_cells(*pair, windows) for pair in zip(written, occupied, strict=True)]
    tops, lost = _find_tops(cells, windows, bottoms, round(top, DIGITS))
    sides = [_level_sides(lattice.cut(*window), scene_box) for window in windows]
    boxes = [_to_file(*box) for box in zip(sides, bottoms, tops, strict=True)]
    counts = [int(own.cells[mask].sum()) for own, mask in zip(cells, lost, strict=True)]
    lost_on = [number for number, count in enumerate(counts) if count]
    free = sum(int(level.cells.sum()) for level in cells)
    return LevelBoxes(windows, boxes, free, sum(counts), lost_on)


def written_ground(level: LevelFloor) -> float:
    """A level's ground height without what rounding added to it [m]."""
    return round(level.ground, DIGITS) + 0.0  # + 0.0: without a minus before 0


def _find_tops(
    cells: list[_Open], windows: list[Window], bottoms: list[float], highest: float
) -> tuple[list[float], list[Bool]]:
    """The top of each level's box, and the free cells of each level that boxes lose.

    Lower levels come first for the client, so they are decided first, each by the cells that
    are not lost yet.
    """
    tops, lost = [], [np.zeros(len(level.z), dtype=np.bool_) for level in cells]
    for k, (level, window, bottom) in enumerate(zip(cells, windows, bottoms, strict=True)):
        above = range(k + 1, len(cells))
        inside = {j: cells[j].inside[:, k] & (cells[j].z >= bottom) for j in above}
        kept = {j: inside[j] & ~lost[j] for j in above}
        others = [cells[j].z[kept[j]] for j in above]
        counts = [cells[j].cells[kept[j]] for j in above]
        own = level.z[~lost[k]], level.cells[~lost[k]]
        heights = np.concatenate([np.empty(0), *others])
        last = _last_floor(*own, heights, np.concatenate([np.empty(0, dtype=np.int64), *counts]))
        # the box ends below what it doesn't hold: boxes, or floors of levels that interleave
        limits = [bottoms[j] for j in above if _share_cells(window, windows[j])]
        limits = [height for height in limits if height > last]
        limits += [float(z[z > last].min(initial=np.inf)) - MARGIN for z in others]
        limit = min(limits, default=np.inf)
        top = highest if limit > highest else _just_below(limit)
        tops.append(max(top, last, bottom))
        lost[k] |= level.z > tops[k]
        for j in above:
            lost[j] |= inside[j] & (cells[j].z <= tops[k])
    return tops, lost


def _last_floor(own: Float, own_count: Int, others: Float, others_count: Int) -> float:
    """The floor that a box from the bottom up ends with; -inf if it had better hold none.

    It holds the most of its own floors over those of others (the last of several such ends).
    """
    heights, where = np.unique(own, return_inverse=True)
    num_own = np.bincount(where, own_count, minlength=len(heights)).cumsum()
    order = np.argsort(others)
    before = np.concatenate([[0], np.cumsum(others_count[order])])
    num_others = before[np.searchsorted(others[order], heights, side="right")]
    gain = np.append(0, num_own - num_others)[::-1]
    return float(np.append(-np.inf, heights)[::-1][int(np.argmax(gain))])


def _just_below(height: float) -> float:
    """A height a hair below another, which stays below it however large the two are [m]."""
    return float(min(round(height - GAP, GAP_DIGITS), np.nextafter(height, -np.inf)))


def _open_cells(written: Float, occupied: Bool, windows: Sequence[Window]) -> _Open:
    """Count the free cells by height, in each rectangle that the windows' sides cut out."""
    height, width = written.shape
    sides = [
        np.unique(
            [0, end, *(s for window in windows for s in (window[axis].start, window[axis].stop))]
        )
        for axis, end in ((0, height), (1, width))
    ]
    heights, counts, inside = (
        [np.empty(0)],
        [np.empty(0, np.int64)],
        [np.empty((0, len(windows)), bool)],
    )
    for row0, row1 in pairwise(sides[0].tolist()):
        for col0, col1 in pairwise(sides[1].tolist()):
            part = np.s_[row0:row1, col0:col1]
            z, count = count_heights(written[part], occupied[part])
            is_in = [
                rows.start <= row0 < rows.stop and cols.start <= col0 < cols.stop
                for rows, cols in windows
            ]
            heights.append(z)
            counts.append(count)
            inside.append(np.tile(is_in, (len(z), 1)))
    return _Open(*(np.concatenate(arrays) for arrays in (heights, counts, inside)))


def _share_cells(one: Window, other: Window) -> bool:
    """Whether two rectangles have cells in common, or lie side by side: see the file's source."""
    return all(a.start <= b.stop and b.start <= a.stop for a, b in zip(one, other, strict=True))


def _level_sides(part: Lattice, scene_box: Float | None) -> Float:
    """x_min, y_min, x_max, y_max of a level's rectangle, cut to the scene's box.

    Outermost cells reach beyond the scene by up to half, and so to their centres at most. Where
    a grid is larger than the scene, its own sides count.
    """
    x0, y0, x1, y1 = part.bounds
    sides = np.round([x0, y0, x1, y1], DIGITS) + 0.0
    if scene_box is None:
        return sides
    half = part.cell_size / 2
    scene = np.round(scene_box[:, :2].ravel(), DIGITS) + 0.0
    # the scene's side lies between the rectangle's and the outermost centres
    inner = np.array([x0 + half, y0 + half, x1 - half, y1 - half])
    between = (np.minimum(sides, inner) <= scene) & (scene <= np.maximum(sides, inner))
    return np.where(between, scene, sides)


def _scene_box(
    written: Float, lattice: Lattice, scene_box: Float | None, agent_height: float
) -> Box:
    """The box of the only level: the scene's, and what of the grid lies outside of it."""
    lowest, highest = float(np.nanmin(written)), float(np.nanmax(written))
    sides = _level_sides(lattice.cut(*bounding_window(~np.isnan(written))), scene_box)
    if scene_box is None:
        return _to_file(
            sides, round(lowest - MARGIN, DIGITS), round(highest + agent_height, DIGITS)
        )
    scene = np.round(scene_box, DIGITS) + 0.0
    sides[:2] = np.minimum(sides[:2], scene[0, :2])
    sides[2:] = np.maximum(sides[2:], scene[1, :2])
    bottom, top = float(scene[0, 2]), float(scene[1, 2])
    if bottom > lowest:
        bottom = round(lowest - MARGIN, GAP_DIGITS)
    return _to_file(sides, bottom, max(top, highest))


def _to_file(sides: Float, bottom: float, top: float) -> Box:
    x0, y0, x1, y1 = sides.tolist()
    return (x0, bottom + 0.0, 0.0 - y1), (x1, top + 0.0, 0.0 - y0)
