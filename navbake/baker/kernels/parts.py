"""Which triangles of a mesh enclose something: closed parts, told from what hangs on them loosely.

Triangles with a bare edge, on which no other one ends, are peeled off, and so are those whose edges
that lays bare, as a queue has them: of a sheet nothing is left, of a closed surface all. What is
left falls into parts by union-find over the edges. A part is closed when each of its edges is met
as often in one direction as in the other. Whether a part is inside of another is told by the solid
angle under which a point of it sees the other's triangles (Van Oosterom and Strackee, The solid
angle of a plane triangle, 1983).
"""

import math

import numpy as np
from numba import njit

from navbake.navgrid.kernels.union_find import find_root, unite

# What a triangle is when it belongs to no closed part: one of a sheet, or a copy of another
SHEET, COPY = np.int64(-1), np.int64(-2)


@njit(cache=True)
def _sort_by(key, order, num):
    """Sort items by a key below num, stable: a counting sort. Returns the new order."""
    start = np.zeros(num + 1, np.int64)
    for item in order:
        start[key[item] + 1] += 1
    for k in range(num):
        start[k + 1] += start[k]
    out = np.empty_like(order)
    for item in order:
        out[start[key[item]]] = item
        start[key[item]] += 1
    return out


@njit(cache=True)
def list_edges(faces, num):
    """Number the undirected edges of triangles whose corners are numbers below num.

    Returns:
        edge, start and half, as `find_parts` takes them.
    """
    size = 3 * faces.shape[0]
    low, high = np.empty(size, np.int64), np.empty(size, np.int64)
    for h in range(size):
        one, other = faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3]
        low[h], high[h] = min(one, other), max(one, other)
    half = _sort_by(low, _sort_by(high, np.arange(size), num), num)
    edge, start = np.empty(size, np.int64), np.empty(size + 1, np.int64)
    count = 0
    for i in range(size):
        if i == 0 or low[half[i]] != low[half[i - 1]] or high[half[i]] != high[half[i - 1]]:
            start[count] = i
            count += 1
        edge[half[i]] = count - 1
    start[count] = size
    return edge, start[: count + 1].copy(), half


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
def _winding_number(point, corners, items):
    """How often closed triangles wind round a point, (3,) float64 [m]: 0 outside."""
    total = 0.0
    x, y, z = point[0], point[1], point[2]
    for t in items:
        c = corners[t]
        ax, ay, az = c[0, 0] - x, c[0, 1] - y, c[0, 2] - z
        bx, by, bz = c[1, 0] - x, c[1, 1] - y, c[1, 2] - z
        cx, cy, cz = c[2, 0] - x, c[2, 1] - y, c[2, 2] - z
        a = math.sqrt(ax * ax + ay * ay + az * az)
        b = math.sqrt(bx * bx + by * by + bz * bz)
        c_ = math.sqrt(cx * cx + cy * cy + cz * cz)
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        across = a * b * c_ + (ax * bx + ay * by + az * bz) * c_
        across += (ax * cx + ay * cy + az * cz) * b + (bx * cx + by * cy + bz * cz) * a
        total += 2.0 * math.atan2(volume, across)
    return total / (4.0 * math.pi)


@njit(cache=True)
def find_cavities(start, member, corners, point, encloses, facing_in):
    """Mark parts that face in and lie inside of one that encloses something, in `encloses`.

    Args:
        start, member: the triangles of each part, ragged, int64.
        corners: of all triangles, (m, 3, 3) float64 [m].
        point: a point of each part, (parts, 3) float64 [m].
        encloses, facing_in: by part, bool.
    """
    num = start.shape[0] - 1
    box = np.empty((num, 6), np.float64)
    box[:, :3], box[:, 3:] = math.inf, -math.inf
    for p in range(num):
        for t in member[start[p] : start[p + 1]]:
            for corner in range(3):
                for k in range(3):
                    value = corners[t, corner, k]
                    box[p, k], box[p, 3 + k] = min(box[p, k], value), max(box[p, 3 + k], value)
    outer = np.flatnonzero(encloses)
    for p in range(num):
        if not facing_in[p]:
            continue
        for q in outer:
            is_around = True
            for k in range(3):
                is_around &= box[q, k] <= box[p, k] and box[q, 3 + k] >= box[p, 3 + k]
            if is_around:
                items = member[start[q] : start[q + 1]]
                if _winding_number(point[p], corners, items) > 0.5:
                    encloses[p] = True
                    break


@njit(cache=True)
def weld_points(points):
    """Number points, (n, 3) float64, so that equal ones have equal numbers, by first appearance.

    A hash table with open addressing over the coordinates' bits. Returns (n,) int64.
    """
    num = points.shape[0]
    size = 16
    while size < 2 * num:  # at most half full, so that probing stays short
        size *= 2
    bits = (points + 0.0).view(np.uint64)  # -0.0 is 0.0
    table = np.full(size, -1, np.int64)
    number = np.empty(num, np.int64)
    count = 0
    for i in range(num):
        key = np.uint64(1469598103934665603)
        for k in range(3):
            key = (key ^ bits[i, k]) * np.uint64(1099511628211)
            key ^= key >> np.uint64(29)
        place = np.int64(key & np.uint64(size - 1))
        while table[place] >= 0:
            j = table[place]
            if bits[j, 0] == bits[i, 0] and bits[j, 1] == bits[i, 1] and bits[j, 2] == bits[i, 2]:
                break
            place = (place + 1) & (size - 1)
        if table[place] < 0:
            table[place] = i
            number[i] = count
            count += 1
        else:
            number[i] = number[table[place]]
    return number
