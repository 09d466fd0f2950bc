"""Which triangles of a mesh enclose something: closed parts, told from what hangs on them loosely.

Triangles with a bare edge, on which no other one ends, are peeled off, and so are those whose edges
that lays bare, as a queue has them: of a sheet nothing is left, of a closed surface all. What is
left falls into parts by union-find over the edges. A part is closed when each of its edges is met
as often in one direction as in the other. Whether a point is inside of one is told by the solid
angle under which it sees the triangles (Van Oosterom and Strackee, The solid angle of a plane
triangle, 1983).
"""

import math

import numpy as np
from numba import njit

from navbake.navgrid.kernels.union_find import find_root, unite

# What a triangle is when it belongs to no closed part: one of a sheet, or a copy of another
SHEET, COPY = np.int64(-1), np.int64(-2)


@njit(inline="always")
def _opposite(faces, half):
    """The corner of a triangle that is not on one of its edges; edges are numbered 3 f + k."""
    return faces[half // 3, (half % 3 + 2) % 3]


@njit(inline="always")
def _same_way(faces, one, other):
    """Whether two half-edges of one edge run in the same direction."""
    return faces[one // 3, one % 3] == faces[other // 3, other % 3]


@njit(inline="always")
def _drop_copies(faces, start, half, part):
    """Mark triangles that have the corners of an earlier one, the same way round."""
    for e in range(start.shape[0] - 1):
        if start[e + 1] - start[e] < 3:
            continue
        for i in range(start[e], start[e + 1]):
            for j in range(start[e], i):
                one, other = half[j], half[i]
                same = _opposite(faces, one) == _opposite(faces, other)
                if same and _same_way(faces, one, other) and part[one // 3] == SHEET:
                    part[other // 3] = COPY


@njit(inline="always")
def _is_bare(faces, e, start, half, left, kept):
    """Whether only one triangle is left at an edge, or one and its own back."""
    if left[e] == 1:
        return True
    if left[e] != 2:
        return False
    corner = np.int64(-1)
    for h in half[start[e] : start[e + 1]]:
        if kept[h // 3]:
            if corner >= 0:
                return _opposite(faces, h) == corner
            corner = _opposite(faces, h)
    return False


@njit(cache=True)
def _peel(faces, edge, start, half, kept):
    """Take away triangles with a bare edge until none is left."""
    left = np.zeros(start.shape[0] - 1, np.int64)
    for h in range(edge.shape[0]):
        if kept[h // 3]:
            left[edge[h]] += 1
    queue = np.empty(faces.shape[0], np.int64)
    end = at = 0
    for e in range(start.shape[0] - 1):
        if left[e] > 0 and _is_bare(faces, e, start, half, left, kept):
            for h in half[start[e] : start[e + 1]]:
                if kept[h // 3]:
                    kept[h // 3] = False
                    queue[end] = h // 3
                    end += 1
    # a triangle counts at its edges until its turn in the queue
    while at < end:
        face = queue[at]
        at += 1
        for k in range(3):
            e = edge[3 * face + k]
            left[e] -= 1
            if left[e] > 0 and _is_bare(faces, e, start, half, left, kept):
                for h in half[start[e] : start[e + 1]]:
                    if kept[h // 3]:
                        kept[h // 3] = False
                        queue[end] = h // 3
                        end += 1


@njit(cache=True)
def find_parts(faces, edge, start, half):
    """Find the closed parts of a mesh.

    Args:
        faces: corners of each triangle, (m, 3) int64, no two of one triangle the same; equal
            numbers are the same point.
        edge: the undirected edge of each half-edge 3 f + k, from corner k of triangle f to the
            next one, (3 m,) int64.
        start, half: the half-edges of each edge, ragged, ascending, int64.

    Returns:
        By triangle, a number of its closed part, the lowest triangle in it, or SHEET, or COPY;
        (m,) int64.
    """
    num = faces.shape[0]
    part = np.full(num, SHEET)
    _drop_copies(faces, start, half, part)
    kept = part == SHEET
    _peel(faces, edge, start, half, kept)
    parent = np.arange(num)
    for e in range(start.shape[0] - 1):
        first = np.int64(-1)
        for h in half[start[e] : start[e + 1]]:
            if kept[h // 3]:
                if first >= 0:
                    unite(parent, first, h // 3)
                first = h // 3
    is_open = np.zeros(num, np.bool_)
    for e in range(start.shape[0] - 1):
        balance, first = 0, np.int64(-1)
        for h in half[start[e] : start[e + 1]]:
            if kept[h // 3]:
                first = h if first < 0 else first
                balance += 1 if _same_way(faces, first, h) else -1
        if balance != 0:
            is_open[find_root(parent, first // 3)] = True
    for face in range(num):
        if kept[face]:
            root = find_root(parent, face)
            part[face] = SHEET if is_open[root] else root
    return part


@njit(cache=True)
def winding_number(point, corners):
    """How often closed triangles, (m, 3, 3) float64 [m], wind round a point, (3,): 0 outside."""
    total = 0.0
    for t in range(corners.shape[0]):
        ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
        bx, by, bz = corners[t, 1, 0], corners[t, 1, 1], corners[t, 1, 2]
        cx, cy, cz = corners[t, 2, 0], corners[t, 2, 1], corners[t, 2, 2]
        ax, ay, az = ax - point[0], ay - point[1], az - point[2]
        bx, by, bz = bx - point[0], by - point[1], bz - point[2]
        cx, cy, cz = cx - point[0], cy - point[1], cz - point[2]
        a = math.sqrt(ax * ax + ay * ay + az * az)
        b = math.sqrt(bx * bx + by * by + bz * bz)
        c = math.sqrt(cx * cx + cy * cy + cz * cz)
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        across = (
            a * b * c
            + (ax * bx + ay * by + az * bz) * c
            + (ax * cx + ay * cy + az * cz) * b
            + (bx * cx + by * cy + bz * cz) * a
        )
        total += 2.0 * math.atan2(volume, across)
    return total / (4.0 * math.pi)
