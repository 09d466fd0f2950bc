"""Which closed parts of a mesh that face in are cavities: those inside of one that faces out.

Whether a part is inside of another is told by the other's triangles on a vertical line over a point
of it, each counted by how it winds round that line (Sunday, Inclusion of a point in a polygon,
2001).
"""

import math

import numpy as np
from numba import njit

# Triangles that share one box when one looks for those over a point
BLOCK = 64


@njit(inline="always")
def _is_left(ax, ay, bx, by, x, y):
    """Whether a point is left of the line from a to b; the same answer, turned, from b to a."""
    if ax < bx or (ax == bx and ay < by):
        return (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0
    return not ((ax - bx) * (y - by) - (ay - by) * (x - bx) > 0.0)


@njit(inline="always")
def _winding(c, x, y):
    """How a triangle, seen from above, winds round a point: 1, 0, or -1 for one that faces down."""
    turns = 0
    for k in range(3):
        ax, ay, bx, by = c[k, 0], c[k, 1], c[(k + 1) % 3, 0], c[(k + 1) % 3, 1]
        if (ay <= y) != (by <= y):
            is_left = _is_left(ax, ay, bx, by, x, y)
            if by > y and is_left:
                turns += 1
            elif by <= y and not is_left:
                turns -= 1
    return turns


@njit(inline="always")
def _is_above(c, x, y, z):
    """Whether the plane of a triangle that is not upright is above a point."""
    ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
    vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    height = nx * (c[0, 0] - x) + ny * (c[0, 1] - y) + nz * (c[0, 2] - z)
    return height > 0.0 if nz > 0.0 else height < 0.0


@njit(cache=True)
def _is_inside(point, corners, member, low, high, block):
    """Whether a point is inside of closed triangles that face out, ``member[low:high]``.

    More of those over the point face up than down. `block` has the bounds of BLOCK members each.
    """
    x, y, z = point[0], point[1], point[2]
    total = 0
    for b in range(low // BLOCK, (high + BLOCK - 1) // BLOCK):
        if x < block[b, 0] or y < block[b, 1] or x > block[b, 2] or y > block[b, 3]:
            continue
        for t in member[max(low, b * BLOCK) : min(high, (b + 1) * BLOCK)]:
            turns = _winding(corners[t], x, y)
            if turns != 0 and _is_above(corners[t], x, y, z):
                total += turns
    return total > 0


@njit(inline="always")
def _is_around(box, q, p):
    """Whether the box of part q holds that of part p."""
    is_around = True
    for k in range(3):
        is_around &= box[q, k] <= box[p, k] and box[q, 3 + k] >= box[p, 3 + k]
    return is_around


@njit(cache=True)
def find_around(box, encloses, facing_in):
    """Mark parts that enclose something and whose box holds that of a part that faces in.

    Takes the boxes of the parts, (parts, 6) float64 [m], and bools by part.
    """
    marked = np.zeros(box.shape[0], np.bool_)
    inner = np.flatnonzero(facing_in)
    for q in range(box.shape[0]):
        if encloses[q]:
            for p in inner:
                if _is_around(box, q, p):
                    marked[q] = True
                    break
    return marked


@njit(cache=True)
def find_cavities(start, member, corners, point, box, encloses, facing_in):
    """Mark parts that face in and lie inside of one that encloses something, in `encloses`.

    Args:
        start, member: the triangles of each part that `find_around` marks, ragged, int64; fast
            where neighbours in the list are neighbours in space.
        corners: of these triangles, (m, 3, 3) float64 [m].
        point: a point of each part, (parts, 3) float64 [m].
        box: of each part, (parts, 6) float64 [m].
        encloses, facing_in: by part, bool.
    """
    num = start.shape[0] - 1
    block = np.empty((member.shape[0] // BLOCK + 1, 4), np.float64)
    block[:, :2], block[:, 2:] = math.inf, -math.inf
    for i in range(member.shape[0]):
        b = i // BLOCK
        for corner in range(3):
            for k in range(2):
                value = corners[member[i], corner, k]
                block[b, k] = min(block[b, k], value)
                block[b, 2 + k] = max(block[b, 2 + k], value)
    outer = np.flatnonzero(encloses)
    outer = outer[np.argsort(box[outer, 0], kind="mergesort")]
    for p in range(num):
        if not facing_in[p]:
            continue
        for q in outer:
            if box[q, 0] > box[p, 0]:
                break
            if not _is_around(box, q, p):
                continue
            if _is_inside(point[p], corners, member, start[q], start[q + 1], block):
                encloses[p] = True
                break
