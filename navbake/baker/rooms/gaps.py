"""Rooms from gaps that part spaces by their width against the width of both."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.baker.rooms.kernels import gaps as kernels
from navbake.baker.rooms.kernels.labels import label_parts
from navbake.baker.rooms.kernels.watershed import squared_distances
from navbake.types import Bool, Float, Int, Int32

# The widest opening that can part two rooms [m]
WIDEST = 2.5
# Two spaces are one where the gap between them is at least this share of both, or of the narrower
BOTH, NARROWER = 0.8, 0.78
# A gap is looked for where the space widens by this factor, and by this much [m]
GROWTH, RISE = 1.15, 0.2
# Walls are at most this thick at a doorway [m]
THICKNESS = 0.6
# How wide the spaces are is measured so far behind the gap; the widest counts [m]
DEPTHS = (0.1, 0.25, 0.45)
# A passage opens into a space as wide as it is, but is its own from this length on, measured in
# its widths, where the space is wider by this factor
LONG, WIDER = 3.0, 1.5
# The directions of walls are taken at this distance from them, in bins of so many degrees; those
# count that belong to this length of wall, and to this share of all
OFF_WALL, BIN, LEAST_WALL, LEAST_SHARE = 0.3, 5, 2.0, 0.01


class Direction(NamedTuple):
    """A direction that walls run in.

    Attributes:
        swapped: whether it is scanned with rows and columns swapped.
        shift: the row of a line in each column less that in the first, (cols,) int64.
        stretch: length of a step along the line [cells].
    """

    swapped: bool
    shift: Int
    stretch: float


@dataclass
class GapsOfDirection:
    """The gaps of a direction: see `measure_gap` for `gaps`, shape (n, 8), int64."""

    direction: Direction
    label: Int32
    is_open: Bool
    gaps: Int


def find_directions(open_cells: Bool, cell_size: float) -> list[Direction]:
    """Find the directions that walls run in, from the slope of the distance to them."""
    reach = max(3, round(OFF_WALL / cell_size))
    squared = squared_distances(~open_cells, reach + 2, 0, 1)
    distance = np.sqrt(squared, dtype=np.float32)
    at = (squared[2:-2, 2:-2] >= (reach - 1) ** 2) & (squared[2:-2, 2:-2] < reach**2)
    rows, cols = np.nonzero(at)
    rows, cols = rows + 2, cols + 2
    down = distance[rows + 2, cols] - distance[rows - 2, cols]
    right = distance[rows, cols + 2] - distance[rows, cols - 2]
    # a wall runs across the slope; where two walls are as near, there is less of one
    clear = np.hypot(down, right) > 3.2
    angle = np.mod(np.rad2deg(np.arctan2(down[clear], right[clear])) + 90.0, 180.0)
    num = 180 // BIN
    count = np.bincount(np.rint(angle / BIN).astype(np.int64) % num, minlength=num).astype(float)
    smooth = count + np.roll(count, 1) + np.roll(count, -1)
    # round the corners of walls the slope has all directions alike
    around = 2.0 * float(np.median(smooth))
    least = around + max(LEAST_WALL / cell_size, LEAST_SHARE * count.sum())
    directions = []
    while smooth.max() >= least:
        best = int(smooth.argmax())
        off = (angle - best * BIN + 90.0) % 180.0 - 90.0
        mean = best * BIN + float(off[np.abs(off) <= 1.5 * BIN].mean())
        directions.append(_direction(round(mean, 3), open_cells.shape))
        smooth[np.arange(best - 2, best + 3) % num] = 0.0
    return directions


def _direction(angle: float, shape: tuple[int, ...]) -> Direction:
    """A direction from its angle from the columns' axis towards the rows' [degrees]."""
    swapped = 45.0 < angle < 135.0
    slope = np.tan(np.deg2rad(90.0 - angle if swapped else angle))
    count = shape[0] if swapped else shape[1]
    shift = np.rint(np.arange(count) * slope).astype(np.int64)
    return Direction(swapped, shift, float(np.hypot(1.0, slope)))


def find_gap_cells(
    open_cells: Bool, directions: list[Direction], cell_size: float
) -> tuple[Bool, list[Int32]]:
    """Mark the cells of gaps in all directions, and measure the runs of each."""
    marked = np.zeros(open_cells.shape, dtype=np.bool_)
    runs = []
    for direction in directions:
        cells = _turned(open_cells, direction)
        run = kernels.measure_runs(cells, direction.shift)
        gap = np.zeros(cells.shape, dtype=np.bool_)
        step = direction.stretch * cell_size
        thickness = int(THICKNESS * direction.stretch / cell_size) + 2
        kernels.mark_gaps(run, int(WIDEST / step), GROWTH, RISE / step, thickness, gap)
        marked |= gap.T if direction.swapped else gap
        runs.append(run)
    return marked, runs


def part_at_gaps(open_cells: Bool, cell_size: float) -> tuple[Int32, int]:
    """Label the spaces that gaps part; the cells of gaps have none yet."""
    directions = find_directions(open_cells, cell_size)
    marked, runs = find_gap_cells(open_cells, directions, cell_size)
    label, count = label_parts(open_cells & ~marked)
    found = []
    for direction, run in zip(directions, runs, strict=True):
        turned = _turned(label, direction)
        widest = int(WIDEST / direction.stretch / cell_size)
        crossings = kernels.list_crossings(turned, _turned(marked, direction), run, widest)
        number = kernels.group_crossings(crossings, direction.shift)
        gaps = _bounds(crossings, number)
        found.append(GapsOfDirection(direction, turned, _turned(open_cells, direction), gaps))
    whole = np.arange(count + 1, dtype=np.int64)
    cells = np.bincount(label.ravel(), minlength=count + 1).astype(np.int64)
    _merge(found, whole, cells, cell_size)
    return whole.astype(np.int32)[label], count


def _bounds(crossings: Int, number: Int) -> Int:
    """First and last column of each gap, its rows there, and its regions."""
    if not len(crossings):
        return np.empty((0, 8), dtype=np.int64)
    order = np.argsort(number, kind="stable")
    start = np.flatnonzero(np.diff(number[order], prepend=-1))
    end = np.append(start[1:], len(order)) - 1
    a, b = crossings[order[start]], crossings[order[end]]
    return np.stack([a[:, 0], b[:, 0], a[:, 1], a[:, 2], b[:, 1], b[:, 2], a[:, 3], a[:, 4]], 1)


def _merge(found: list[GapsOfDirection], whole: Int, cells: Int, cell_size: float) -> None:
    """Join the spaces that are one, those first that continue each other."""
    width = np.concatenate([(g.gaps[:, 1] - g.gaps[:, 0] + 1) * g.direction.stretch for g in found])
    pairs = np.concatenate([g.gaps[:, 6:] for g in found])

    def measure() -> Float:
        shares = []
        for g in found:
            depths = np.array(
                [max(1, round(d * g.direction.stretch / cell_size)) for d in DEPTHS], dtype=np.int64
            )
            shares.append(
                kernels.measure_gaps(
                    g.label, g.is_open, whole, g.direction.shift, g.gaps, depths
                )
            )
        return np.concatenate(shares)

    for narrower in (False, True):
        while True:
            shares = measure()
            apart = whole[pairs[:, 0]] != whole[pairs[:, 1]]
            if narrower:
                score = shares.max(axis=1)
                thin = np.where(shares[:, 0] >= shares[:, 1], pairs[:, 0], pairs[:, 1])
                area = cells[whole[thin]]
                own = (area >= LONG * width**2) & (shares.min(axis=1) <= 1 / WIDER)
                joins = apart & (score >= NARROWER) & ~own
            else:
                score = shares.min(axis=1)
                joins = apart & (score >= BOTH)
            if not joins.any():
                break
            changed = set()
            for k in np.flatnonzero(joins)[np.argsort(-score[joins], kind="stable")]:
                a, b = sorted(whole[pairs[k]].tolist())
                if a == b or (narrower and (a in changed or b in changed)):
                    continue
                changed |= {a, b}
                whole[whole == b] = a
                cells[a] += cells[b]


def _turned(array, direction):
    return np.ascontiguousarray(array.T) if direction.swapped else array
