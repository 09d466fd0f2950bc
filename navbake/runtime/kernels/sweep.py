"""Sweeps a disc along a straight line over squares: exact, with one look at each row of cells.

What the disc covers on its way (a capsule, the Minkowski sum of a line and a disc) is convex. So it
meets the cells of one row in a single interval of columns, whose ends have a closed form, and
running sums tell at once whether any of these cells is solid.

Ends of lines are pairs u, v in the level's own units, columns and rows, as in `sight`.
"""

import math

import numpy as np

from navbake.compiled import part
from navbake.types import Bool, Int32

TOUCH = 1e-9  # share of a radius by which a disc may be over what it touches


@part
def disc_passes(a, b, rect, solid_before, radius, is_closed):
    """Whether an open disc meets no solid square of a level while it moves along a line.

    Args:
        a, b: ends of the line.
        rect: the cells of the level.
        solid_before: how many solid cells there are before each flat id, (n + 1,) int32.
        radius: in cells.
        is_closed: whether all beyond the level's cells is solid.
    """
    (u0, v0), (u1, v1) = a, b
    reach = radius * (1.0 - TOUCH)
    first_v, last_v = min(v0, v1) - reach, max(v0, v1) + reach
    for row in range(math.floor(first_v), math.ceil(last_v)):
        low, high = max(float(row), first_v), min(row + 1.0, last_v)
        left = -_farthest(-u0, v0, -u1, v1, low, high, reach)
        right = _farthest(u0, v0, u1, v1, low, high, reach)
        col0, col1 = math.floor(left), math.ceil(right)
        if row < 0 or row >= rect.height or col0 < 0 or col1 > rect.width:
            if is_closed:
                return False
            if row < 0 or row >= rect.height:
                continue
        col0, col1 = max(col0, 0), min(col1, rect.width)
        here = rect.first + row * rect.width
        if col0 < col1 and solid_before[here + col1] > solid_before[here + col0]:
            return False
    return True


@part
def _farthest(u0, v0, u1, v1, low, high, reach):
    """The largest u of a swept disc between two v that it reaches."""
    # Towards larger v the edge first moves out, up to the middle of the disc at the line's
    # farther end, and then back in. So the v nearest to that one has the largest u.
    peak = v1 if u1 > u0 else v0
    if u0 == u1:  # all along the line it is as far
        peak = min(max(low, min(v0, v1)), max(v0, v1))
    v = min(max(peak, low), high)
    du, dv = u1 - u0, v1 - v0
    t = 1.0 if u1 > u0 else 0.0
    if dv != 0.0:
        # the disc that reaches the farthest at v touches the edge where its radius is upright on
        # the line, or else is the one at an end
        along = -math.copysign(du, du * dv) if du != 0.0 else 0.0
        t = (v - reach * along / math.hypot(du, dv) - v0) / dv
        t = min(max(t, 0.0), 1.0)
    off = v - v0 - t * dv
    return u0 + t * du + math.sqrt(max(reach * reach - off * off, 0.0))


def count_solid(levels: list[Bool]) -> Int32:
    """How many solid cells there are before each flat id, and in all: (n + 1,) int32."""
    before = np.zeros(sum(len(level) for level in levels) + 1, dtype=np.int32)
    if levels:
        np.cumsum(np.concatenate(levels), out=before[1:])
    return before
