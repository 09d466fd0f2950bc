"""The box of each level (`bbox`), so that the original client finds each cell's own level.

The client takes the first level whose box holds a position, edges included, or fails. So a box
begins below the lowest floor of its level, and ends below the next box above its cells. Where
levels interleave (a stair of one rises past the lowest tread of the next), a box ends where the
fewest free cells are lost.

Source: sstk's `NavScene.js`, `positionToCell`. Its grid also takes the cells one column and one
row beyond the last for its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.core.windows import Window, bounding_window
from navbake.baker.floors.levels import LevelFloor
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Vector3

Box = tuple[Vector3, Vector3]
"""Lower and upper corner, file frame (y up) [m]."""

# A box begins this far below its lowest floor, beyond the rounding of float32 and of units [m]
MARGIN = 0.001
GAP = 1e-6  # between a box and the one above it [m]
GAP_DIGITS = 6  # decimals of heights that are multiples of the two
DIGITS = 9  # decimals of other lengths: what is smaller is rounding


class LevelBoxes(NamedTuple):
    """Where the levels lie, lowest first, and what their boxes cost."""

    windows: list[Window]  # rows and columns of the lattice that each level's grid has
    boxes: list[Box]  # of each level
    # how many free cells, doors being open, the original client puts on another level, or on none
    lost: int
    lost_on: list[int]  # the levels whose cells these are, ascending


def find_level_boxes(
    levels: Sequence[LevelFloor],
    occupied: Sequence[Bool],
    lattice: Lattice,
    scene_box: Float | None,
    agent_height: float,
) -> LevelBoxes:
    """Cut each level's rectangle from the lattice, and find its box.

    A single level keeps the whole lattice. Its box is the scene's, made larger where a floor lies
    outside. Of several, each is cut to the cells that have a floor; its box spans the rectangle, up
    to the scene's sides, from `MARGIN` below its lowest floor to `GAP` below the next box above it,
    or to the scene's top. Doors change neither.

    `levels` are the lowest first, `occupied` their cells that what stands occupies, `scene_box`
    is that of all finite geoms that stand, (2, 3) [m]. An agent on the highest floor is in the
    highest level's box.
    """
    written = [level.floor.astype(np.float32) for level in levels]
    lowest = [float(np.fmin.reduce(floor, axis=None)) for floor in written]
    peaks = [float(np.fmax.reduce(floor, axis=None)) for floor in written]
    highest = max(peaks)
    windows = [bounding_window(~np.isnan(floor)) for floor in written]
    sides = [_level_sides(lattice.cut(*window), scene_box) for window in windows]
    if len(levels) == 1:
        whole = (slice(0, lattice.height), slice(0, lattice.width))
        box = _scene_box(sides[0], lowest[0], highest, scene_box, agent_height)
        return LevelBoxes([whole], [box], 0, [])
    bottoms = [round(z - MARGIN, GAP_DIGITS) for z in lowest]
    bottoms[0] = min(bottoms[0], round(levels[0].ground - MARGIN, GAP_DIGITS))
    top = highest + agent_height
    if scene_box is not None:
        top = max(top, float(scene_box[1, 2]))
    heights = [np.empty((0, 0)) for _ in levels]  # they matter where one reaches up to a box above
    if any(z > min(bottoms[k:], default=np.inf) - 2 * GAP for k, z in enumerate(peaks, 1)):
        heights = [floor.astype(np.float64) for floor in written]
        for floor, taken in zip(heights, occupied, strict=True):
            floor[taken] = np.nan
    tops, lost = _find_tops(heights, windows, bottoms, round(top, DIGITS))
    boxes = [_to_file(*box) for box in zip(sides, bottoms, tops, strict=True)]
    return LevelBoxes(windows, boxes, int(lost.sum()), np.flatnonzero(lost).tolist())


def rounded_ground(level: LevelFloor) -> float:
    """A level's ground height without what rounding added to it [m]."""
    return round(level.ground, DIGITS) + 0.0  # + 0.0: without a minus before 0


def _find_tops(
    heights: list[Float], windows: list[Window], bottoms: list[float], highest: float
) -> tuple[list[float], Int]:
    """The top of each level's box, and how many free cells of each level boxes lose.

    The lowest level is decided first, as by the client. `heights` are floors of free cells, as
    written, NaN elsewhere [m]; cells that are lost become NaN.
    """
    tops = []
    lost = np.zeros(len(heights), dtype=np.int64)
    for k, (own, window, bottom) in enumerate(zip(heights, windows, bottoms, strict=True)):
        above = range(k + 1, len(heights))
        inside = [heights[j][window] for j in above]
        others = np.concatenate([np.empty(0), *(z[z >= bottom] for z in inside)])
        last = _last_floor(own[~np.isnan(own)], others)
        # the box ends below what it doesn't hold: boxes, or floors of levels that interleave; cells
        # beside each other count, too: see the file's source
        limits = [bottoms[j] for j in above if bottoms[j] > last and _meet(window, windows[j])]
        limit = min([*limits, float(others[others > last].min(initial=np.inf)) - MARGIN])
        # a hair below, which stays below however large the two are
        below = min(round(limit - GAP, GAP_DIGITS), np.nextafter(limit, -np.inf))
        tops.append(max(highest if limit > highest else float(below), last, bottom))
        for j, z in zip([k, *above], [own, *inside], strict=True):
            is_lost = z > tops[k] if j == k else (z >= bottom) & (z <= tops[k])
            lost[j] += np.count_nonzero(is_lost)
            z[is_lost] = np.nan
    return tops, lost


def _meet(one: Window, other: Window) -> bool:
    """Whether two windows have cells in common, or beside each other."""
    pairs = zip(one, other, strict=True)
    return all(a.start <= b.stop and b.start <= a.stop for a, b in pairs)


def _last_floor(own: Float, others: Float) -> float:
    """The highest floor of a box with the most own floors less those of others; -inf for none."""
    # of its own floors below all others, the highest stands for all
    is_low = own < others.min(initial=np.inf)
    highest = own.max(initial=-np.inf)
    heights, counts = np.unique(own[~is_low], return_counts=True)
    heights = np.append(own[is_low].max(initial=-np.inf), heights)
    num_own = np.append(np.count_nonzero(is_low), counts).cumsum()
    others = np.sort(others[others <= highest])
    gain = np.append(0, num_own - np.searchsorted(others, heights, side="right"))
    best = len(gain) - 1 - int(np.argmax(gain[::-1]))
    return float(np.append(-np.inf, heights)[best])


def _level_sides(part: Lattice, scene_box: Float | None) -> Float:
    """x_min, y_min, x_max, y_max of a level, cut by half a cell at most to the scene's sides."""
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
    sides: Float, lowest: float, highest: float, scene_box: Float | None, agent_height: float
) -> Box:
    """The box of the only level: the scene's, and what of the grid lies outside of it."""
    if scene_box is None:
        bottom = round(lowest - MARGIN, DIGITS)
        top = round(highest + agent_height, DIGITS)
        return _to_file(sides, bottom, top)
    scene = np.round(scene_box, DIGITS) + 0.0
    sides[:2] = np.minimum(sides[:2], scene[0, :2])
    sides[2:] = np.maximum(sides[2:], scene[1, :2])
    bottom = float(scene[0, 2])
    top = float(scene[1, 2])
    if bottom > lowest:
        bottom = round(lowest - MARGIN, GAP_DIGITS)
    return _to_file(sides, bottom, max(top, highest))


def _to_file(sides: Float, bottom: float, top: float) -> Box:
    x0, y0, x1, y1 = sides.tolist()
    return (x0, bottom + 0.0, 0.0 - y1), (x1, top + 0.0, 0.0 - y0)
