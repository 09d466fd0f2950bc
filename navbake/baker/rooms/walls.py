"""Walls: distances to them, the directions that they run in, and the sills that continue them."""

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.baker.connect import list_runs
from navbake.baker.rooms.kernels import gaps as kernels
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

T = TypeVar("T", bound=np.generic)

STRIP = 64  # columns that are worth a thread's while
# The directions of walls are taken at this distance from them, in bins of so many degrees; those
# count that belong to this length of wall, and to this share of all
OFF_WALL, BIN, LEAST_WALL, LEAST_SHARE = 0.3, 5, 2.0, 0.01
# Each is then found in steps of so many degrees, by lines so wide [cells], and about so many
# points; an axis of the lattice is taken if it is as sharp as this share of the sharpest
FINE, LINE, MOST_POINTS, AS_SHARP = 0.25, 0.5, 2000, 0.9
# Nearer to it [cells] the lattice's steps disturb it
OFF_STEPS = 5
# Cells round the lattice in which slopes at its edge are measured
PADDING = 2

# A sill is at most this thick [m]; it fills every cell it touches, one more on each side
SILL_THICKNESS = 0.5


def squared_distances(target: Bool, reach: int) -> Int32:
    """Squared distance of each node to the nearest target, ``(reach + 1) ** 2`` beyond `reach`."""
    along, far = np.empty(target.shape, dtype=np.int16), np.int16(reach + 1)
    target = np.ascontiguousarray(target)
    run_in_bands(kernels.sweep_columns, target.shape[1], target, far, along, least=STRIP)
    answer = np.empty(target.shape, dtype=np.int32)
    run_in_bands(kernels.sweep_rows, len(target), along, reach, answer)
    return answer


def wall_nodes(open_cells: Bool) -> Bool:
    """Mark the nodes of a lattice half as wide that lie on a cell that isn't open, or beyond all.

    Node (2 r + 1, 2 c + 1) is the centre of cell (r, c); the others are edges' middles and
    corners, so that gaps can be measured to half a cell. Shape (2 height + 1, 2 width + 1).
    """
    closed = np.pad(~open_cells, 1, constant_values=True)
    rows = closed.repeat(2, axis=0)[1:-1]
    rows = rows[:-1] | rows[1:]  # each row's upper edge, its centre, …, the last one's lower edge
    cols = rows.repeat(2, axis=1)[:, 1:-1]
    return cols[:, :-1] | cols[:, 1:]


class Direction(NamedTuple):
    """A direction that walls run in."""

    swapped: bool  # rows and columns, to scan it
    shift: Int  # the row of a line in each column less that in the first
    slope: float  # the rows that it goes down with each column
    stretch: float  # the length of a step along it [cells]


def find_directions(open_cells: Bool, cell_size: float) -> list[Direction]:
    """Find the directions that walls run in, from the slope of the distance to them."""
    reach = max(OFF_STEPS, round(OFF_WALL / cell_size))
    # the edge of the lattice is no wall: what is there goes on beyond it
    closed = np.pad(~open_cells, PADDING, mode="edge")
    squared = squared_distances(closed, reach + 2)
    distance = np.sqrt(squared, dtype=np.float32)
    at = (squared[2:-2, 2:-2] >= (reach - 1) ** 2) & (squared[2:-2, 2:-2] < reach**2)
    rows, cols = np.nonzero(at)
    rows, cols = rows + 2, cols + 2
    down = distance[rows + 2, cols] - distance[rows - 2, cols]
    right = distance[rows, cols + 2] - distance[rows, cols - 2]
    # a wall runs across the slope; where two walls are as near, there is less of one
    clear = np.hypot(down, right) > 3.2
    rows, cols, down, right = rows[clear], cols[clear], down[clear], right[clear]
    angle = np.mod(np.rad2deg(np.arctan2(down, right)) + 90.0, 180.0)
    slope = np.hypot(down, right)
    foot = np.stack([rows, cols]) - distance[rows, cols] * np.stack([down, right]) / slope
    num = 180 // BIN
    count = np.bincount(np.rint(angle / BIN).astype(np.int64) % num, minlength=num).astype(float)
    smooth = count + np.roll(count, 1) + np.roll(count, -1)
    # round the corners of walls the slope has all directions alike
    around = 2.0 * float(np.median(smooth))
    least = around + max(LEAST_WALL / cell_size, LEAST_SHARE * count.sum())
    is_peak = np.all([smooth >= np.roll(smooth, k) for k in (-2, -1, 1, 2)], axis=0)
    smooth[~is_peak] = 0.0
    directions = []
    while smooth.max() >= least:
        best = int(smooth.argmax())
        off = (angle - best * BIN + 90.0) % 180.0 - 90.0
        chosen = _align(foot[:, np.abs(off) <= 1.5 * BIN], best * BIN)
        directions.append(direction_of(chosen, open_cells.shape))
        smooth[np.arange(best - 2, best + 3) % num] = 0.0
    return directions


def _align(foot: Float, around: float) -> float:
    """The angle within 1.5 bins at which points on walls, (2, n), are on the fewest lines [°].

    A Radon transform of the points, whose sharpest projection is that along the walls; an axis of
    the lattice where that is about as sharp. Slopes alone are off by some degrees.
    """
    foot = foot[:, :: max(1, foot.shape[1] // MOST_POINTS)]
    angles = around + FINE * np.arange(-round(1.5 * BIN / FINE), round(1.5 * BIN / FINE) + 1)
    sharpness = np.zeros(len(angles))
    for k, angle in enumerate(np.deg2rad(angles)):
        across = foot[0] * np.cos(angle) - foot[1] * np.sin(angle)
        across = (across - across.min()) / LINE
        for phase in (0.0, 0.5):  # so that no wall falls between two lines
            count = np.bincount((across + phase).astype(np.int64))
            # the squares of the sums of two lines next to each other; whole numbers, so exact
            sharp = 2 * (count @ count + count[1:] @ count[:-1])
            sharpness[k] = max(sharpness[k], float(sharp))
    is_axis = angles % 90.0 == 0.0
    if (sharpness[is_axis] >= AS_SHARP * sharpness.max()).any():
        return float(angles[is_axis][0])
    return float(angles[sharpness.argmax()])


def direction_of(angle: float, shape: tuple[int, ...]) -> Direction:
    """A direction from its angle from the columns' axis towards the rows' [degrees]."""
    swapped = 45.0 < angle < 135.0
    slope = np.tan(np.deg2rad(90.0 - angle if swapped else angle))
    count = shape[0] if swapped else shape[1]
    shift = np.rint(np.arange(count) * slope).astype(np.int64)
    return Direction(swapped, shift, float(slope), float(np.hypot(1.0, slope)))


def turned(array: NDArray[T], direction: Direction) -> NDArray[T]:
    """An array as the kernels scan it in a direction."""
    return np.ascontiguousarray(array.T) if direction.swapped else array


def find_windows(low: Bool, wall: Bool, cell_size: float) -> Bool:
    """Mark the cells of sills and parapets that continue a wall.

    Where walls, floors and furniture are one mesh, `low` are the cells that it blocks at an agent's
    height, but not above heads; `wall` those that it blocks there, too. Along the direction of a
    wall a sill goes from one piece of wall to the next without a break, and is as thin as a wall,
    other than tables, beds, counters along a wall, and what fills a niche.
    """
    found = np.zeros(low.shape, dtype=np.bool_)
    if not low.any():
        return found
    for direction in find_directions(~wall, cell_size):
        # drawn sills are as wide as their wall, so that each line of theirs ends at it
        scanned = turned(low, direction), turned(wall, direction)
        bridge = np.zeros_like(scanned[0])
        kernels.mark_bridges(*scanned, direction.shift, bridge)
        most = int(SILL_THICKNESS * direction.stretch / cell_size) + 2
        for col, top, end, _ in zip(*list_runs(bridge.T), strict=True):
            if end - top > most:
                bridge[top:end, col] = False
        found |= bridge.T if direction.swapped else bridge
    return found
