"""Where the upright faces of geoms look, and how far geoms reach along two directions.

The facing is the mode of a histogram of directions, weighted by area and modulo a right angle, and
the mean of what fell into that bin.
"""

import math

import numpy as np
from numba import njit

from navbake.compiled import UNCOUNTED

RIGHT = math.pi / 2


@njit(cache=True, nogil=True, **UNCOUNTED)
def find_ways(corners, directions, way, weight, off, first, end):
    """Find where the upright part of triangles' faces looks, modulo a right angle.

    Args:
        corners: of triangles, (m, 3, 3) float64 [m].
        directions: how many are told apart over a right angle.
        way: receives the direction nearest to it, -1 for level triangles, (m,) int32.
        weight: receives twice the area as seen from the side, (m,) float64 [m²].
        off: receives how far it is off the direction, (m,) float64 [rad].
    """
    step = RIGHT / directions
    for t in range(first, end):
        c = corners[t]
        ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
        vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
        x, y = uy * vz - uz * vy, uz * vx - ux * vz
        way[t], weight[t] = -1, math.sqrt(x * x + y * y)
        if weight[t] > 0.0:
            angle = math.atan2(y, x) % RIGHT
            direction = np.int64(math.floor(angle / step + 0.5)) % directions
            # from the direction, also over the end of the range
            off[t] = (angle - direction * step + RIGHT / 2) % RIGHT - RIGHT / 2
            way[t] = direction


@njit(cache=True, nogil=True, **UNCOUNTED)
def add_votes(group, way, weight, off, votes, sums):
    """Add triangles' weights to the votes of their group, by direction, in their order.

    Args:
        group: the group of each triangle, (m,) int32.
        way, weight, off: see `find_ways`.
        votes: by group and direction, float64.
        sums: the same for weight times `off`.
    """
    for t in range(group.shape[0]):
        if way[t] >= 0:
            votes[group[t], way[t]] += weight[t]
            sums[group[t], way[t]] += weight[t] * off[t]


@njit(cache=True, nogil=True)
def measure_spans(corners, group, way):
    """How far groups of triangles reach: along their ways, along what is left of these, and up.

    Args:
        corners, group: see `find_ways` and `add_votes`.
        way: a horizontal unit vector for each group, (num, 2) float64.

    Returns:
        low and high, (num, 3) float64 [m].
    """
    low, high = np.full((way.shape[0], 3), math.inf), np.full((way.shape[0], 3), -math.inf)
    for t in range(corners.shape[0]):
        g = group[t]
        for corner in range(3):
            x, y, z = corners[t, corner, 0], corners[t, corner, 1], corners[t, corner, 2]
            along, left = x * way[g, 0] + y * way[g, 1], y * way[g, 0] - x * way[g, 1]
            low[g, 0], high[g, 0] = min(low[g, 0], along), max(high[g, 0], along)
            low[g, 1], high[g, 1] = min(low[g, 1], left), max(high[g, 1], left)
            low[g, 2], high[g, 2] = min(low[g, 2], z), max(high[g, 2], z)
    return low, high
