"""The directions that walls run in, and the lattice as it is scanned along them."""

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.baker.rooms.kernels.watershed import squared_distances
from navbake.types import Bool, Float, Int

T = TypeVar("T", bound=np.generic)

# The directions of walls are taken at this distance from them, in bins of so many degrees; those
# count that belong to this length of wall, and to this share of all
OFF_WALL, BIN, LEAST_WALL, LEAST_SHARE = 0.3, 5, 2.0, 0.01
# That at an angle to the lattice is found in steps of so many degrees, by lines so wide [cells]
FINE, LINE = 0.25, 0.5
# Nearer to it [cells] the lattice's steps disturb it; and walls this near to an axis of the
# lattice run along it [degrees]
OFF_STEPS, ALONG_AXIS = 5, 1.0
# Cells round the lattice in which slopes at its edge are measured
PADDING = 2


class Direction(NamedTuple):
    """A direction that walls run in.

    Attributes:
        swapped: whether it is scanned with rows and columns swapped.
        shift: the row of a line in each column less that in the first, (cols,) int64.
        slope: rows that a line goes down with each column.
        stretch: length of a step along the line [cells].
    """

    swapped: bool
    shift: Int
    slope: float
    stretch: float


def find_directions(open_cells: Bool, cell_size: float) -> list[Direction]:
    """Find the directions that walls run in, from the slope of the distance to them."""
    reach = max(OFF_STEPS, round(OFF_WALL / cell_size))
    # the edge of the lattice is no wall: what is there goes on beyond it
    closed = np.pad(~open_cells, PADDING, mode="edge")
    squared = squared_distances(closed, reach + 2, 0, 1)
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
    foot = np.stack([rows, cols]) - distance[rows, cols] * np.stack([down, right]) / np.hypot(
        down, right
    )
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
        near = np.abs(off) <= 1.5 * BIN
        mean = best * BIN + float(off[near].mean())
        axis = 90.0 * round(mean / 90.0)
        if abs(mean - axis) <= ALONG_AXIS:
            directions.append(_direction(axis, open_cells.shape))
        else:
            directions.append(_direction(_align(foot[:, near], best * BIN), open_cells.shape))
        smooth[np.arange(best - 2, best + 3) % num] = 0.0
    return directions


def _align(foot: Float, around: float) -> float:
    """The angle within 1.5 bins at which points on walls gather on the fewest lines [degrees].

    A Radon transform of the points, whose sharpest projection is that along the walls. The slopes
    alone are off by some degrees, because a lattice has walls at an angle in steps.

    Args:
        foot: rows and columns of points on the walls, shape (2, n).
    """
    sharpest, best = -1.0, around
    for angle in np.arange(around - 1.5 * BIN, around + 1.5 * BIN + FINE / 2, FINE):
        turn = np.deg2rad(angle)
        across = foot[0] * np.cos(turn) - foot[1] * np.sin(turn)
        count = np.bincount(((across - across.min()) / LINE).astype(np.int64)).astype(float)
        smooth = count[1:] + count[:-1] if len(count) > 1 else count
        sharpness = float((smooth * smooth).sum())
        if sharpness > sharpest:
            sharpest, best = sharpness, float(angle)
    return best


def _direction(angle: float, shape: tuple[int, ...]) -> Direction:
    """A direction from its angle from the columns' axis towards the rows' [degrees]."""
    swapped = 45.0 < angle < 135.0
    slope = np.tan(np.deg2rad(90.0 - angle if swapped else angle))
    count = shape[0] if swapped else shape[1]
    shift = np.rint(np.arange(count) * slope).astype(np.int64)
    return Direction(swapped, shift, float(slope), float(np.hypot(1.0, slope)))


def turned(array: NDArray[T], direction: Direction) -> NDArray[T]:
    """An array as the kernels scan it in a direction."""
    return np.ascontiguousarray(array.T) if direction.swapped else array
