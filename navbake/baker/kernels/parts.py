"""Which triangles of a mesh enclose something: closed parts, told from what hangs on them loosely.

Triangles with a bare edge, on which no other one ends, are peeled off, and so are those whose edges
that lays bare, as a queue has them: of a sheet nothing is left, of a closed surface all. What is
left falls into manifold patches, by a flood over the edges at which two triangles meet, which also
tells which of them face to the other side (Ju, Robust repair of polygonal models, 2004, section 2,
lists the faults of meshes). Patches that close no edge, membranes, are dropped. The others are
united where they close each other's edges. A part is closed when each of its edges is met as often
in one direction as in the other. Whether a part is inside of another is told by the other's
triangles on a vertical line over a point of it, each counted by how it winds round that line
(Sunday, Inclusion of a point in a polygon, 2001).
"""

import math

import numpy as np
from numba import njit

from navbake.baker.scene.kernels.shells import sort_keys
from navbake.navgrid.kernels.union_find import find_root, unite

# What a triangle is when it belongs to no closed part: one of a sheet, or a copy of another
SHEET, COPY = np.int32(-1), np.int32(-2)

# Triangles that share one box when one looks for those over a point
BLOCK = 64


@njit(inline="always")
def _opposite(faces, half):
    """The corner of a triangle that is not on one of its edges; edges are numbered 3 f + k."""
    return faces[half // 3, (half % 3 + 2) % 3]


@njit(inline="always")
def _direction(faces, turned, half):
    """1 for a half-edge that runs to the corner with the higher number, -1 for one that runs back.

    One of a triangle that is to be turned runs the other way.
    """
    face, k = half // 3, half % 3
    runs_up = faces[face, k] < faces[face, (k + 1) % 3]
    return 1 if runs_up != turned[face] else -1


@njit(inline="always")
def _drop_copies(faces, start, half, part):
    """Mark triangles that have the corners of an earlier one, the same way round.

    Each triangle is listed at one of its edges, by its third corner and the way it runs: copies are
    neighbours then.
    """
    keys = np.empty(16, np.int64)
    for e in range(start.shape[0] - 1):
        if start[e + 1] - start[e] > keys.shape[0]:
            keys = np.empty(2 * (start[e + 1] - start[e]), np.int64)
        count = 0
        for h in half[start[e] : start[e + 1]]:
            f, k = h // 3, h % 3
            here, after, third = faces[f, k], faces[f, (k + 1) % 3], _opposite(faces, h)
            # the edge behind the lowest corner is the one that copies are listed at
            if here < after and here < third:
                keys[count] = (np.int64(third) << 32) | f
                count += 1
        if count > 1:
            sort_keys(keys, count)
        for i in range(1, count):
            if keys[i] >> 32 == keys[i - 1] >> 32:
                part[keys[i] & 0xFFFFFFFF] = COPY


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
    """Take away triangles with a bare edge until none is left.

    Returns how many triangles are left at each edge.
    """
    left = np.zeros(start.shape[0] - 1, np.int32)
    for h in range(edge.shape[0]):
        if kept[h // 3]:
            left[edge[h]] += 1
    queue = np.empty(faces.shape[0], np.int32)
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
    return left


@njit(inline="always")
def _partner(e, face, start, half, kept):
    """The half-edge of the other triangle at an edge with two that are left."""
    for h in half[start[e] : start[e + 1]]:
        if kept[h // 3] and h // 3 != face:
            return h
    return np.int64(-1)


@njit(cache=True)
def _find_patches(faces, edge, start, half, kept, left):
    """Number what hangs together over edges with two triangles: the manifold patches.

    Returns:
        patch: of each triangle, -1 for one that is not kept, (m,) int32.
        face, first: the triangles of each patch, ragged, int32.
        differs: whether a triangle has to be turned to face to the same side as the first one of
            its patch, (m,) bool.
    """
    num = faces.shape[0]
    patch, differs = np.full(num, np.int32(-1), np.int32), np.zeros(num, np.bool_)
    queue, first = np.empty(num, np.int32), np.empty(num + 1, np.int32)
    count = at = end = 0
    for seed in range(num):
        if not kept[seed] or patch[seed] >= 0:
            continue
        first[count] = end
        patch[seed] = count
        queue[end] = seed
        end += 1
        while at < end:
            face = queue[at]
            at += 1
            for k in range(3):
                e = edge[3 * face + k]
                if left[e] != 2:
                    continue
                h = _partner(e, face, start, half, kept)
                if h < 0 or patch[h // 3] >= 0:
                    continue
                patch[h // 3] = count
                is_same = _direction(faces, differs, h) == _direction(faces, differs, 3 * face + k)
                differs[h // 3] = is_same
                queue[end] = h // 3
                end += 1
        count += 1
    first[count] = end
    return patch, queue, first[: count + 1].copy(), differs


@njit(inline="always")
def _turn_minority(area, face, first, differs, turned):
    """Turn the triangles of each patch that face to the side that less of its area faces."""
    for p in range(first.shape[0] - 1):
        one = other = 0.0
        for f in face[first[p] : first[p + 1]]:
            if differs[f]:
                other += area[f]
            else:
                one += area[f]
        if abs(one - other) <= 1e-9 * (one + other):  # nobody knows: it is left as it is
            continue
        for f in face[first[p] : first[p + 1]]:
            turned[f] = differs[f] != (other > one)


@njit(inline="always")
def _take_away(faces, edge, face, left, turned, balance, sign):
    """Take a triangle's half-edges at edges with more than two from their balance, or add them.

    Returns how many half-edges are without partner less than before.
    """
    gain = 0
    for k in range(3):
        e = edge[3 * face + k]
        if left[e] > 2:
            before = abs(balance[e])
            balance[e] -= sign * _direction(faces, turned, 3 * face + k)
            gain += before - abs(balance[e])
    return gain


@njit(inline="always")
def _drop_membranes(faces, area, edge, left, face, first, turned, kept):
    """Drop patches, the smallest first, if that leaves fewer half-edges without partner.

    Such as a wall without thickness across the inside of a block. Returns whether any was.
    """
    balance = np.zeros(left.shape[0], np.int32)
    size = np.zeros(first.shape[0] - 1)
    for p in range(first.shape[0] - 1):
        for f in face[first[p] : first[p + 1]]:
            size[p] += area[f]
            for k in range(3):
                balance[edge[3 * f + k]] += _direction(faces, turned, 3 * f + k)
    dropped = False
    for p in np.argsort(size, kind="mergesort"):
        gain = 0
        for f in face[first[p] : first[p + 1]]:
            gain += _take_away(faces, edge, f, left, turned, balance, 1)
        for f in face[first[p] : first[p + 1]]:
            if gain > 0:
                kept[f] = False
            else:
                _take_away(faces, edge, f, left, turned, balance, -1)
        dropped |= gain > 0
    return dropped


@njit(cache=True)
def _unite_patches(faces, start, half, kept, patch, turned, num):
    """Unite patches at the edges that they close for each other, in `num` patches.

    A patch that by itself is met as often in one direction as in the other at an edge, such as one
    of two blocks that touch there, needs no other one.

    Returns:
        By patch, its root, and by root, whether an edge of it stays without partner.
    """
    parent, is_open = np.arange(num), np.zeros(num, np.bool_)
    own = np.zeros(num, np.int64)  # balance of each patch at one edge
    for turn in range(2):
        for e in range(start.shape[0] - 1):
            balance = 0
            for h in half[start[e] : start[e + 1]]:
                if kept[h // 3]:
                    balance += _direction(faces, turned, h)
                    own[patch[h // 3]] += _direction(faces, turned, h)
            last = np.int64(-1)
            for h in half[start[e] : start[e + 1]]:
                if kept[h // 3] and own[patch[h // 3]] != 0:
                    if turn == 0 and last >= 0:
                        unite(parent, last, patch[h // 3])
                    if turn == 1 and balance != 0:
                        is_open[find_root(parent, patch[h // 3])] = True
                    last = patch[h // 3]
            for h in half[start[e] : start[e + 1]]:
                if kept[h // 3]:
                    own[patch[h // 3]] = 0
    return parent, is_open


@njit(cache=True)
def find_parts(faces, area, edge, start, half):
    """Find the closed parts of a mesh.

    Args:
        faces: corners of each triangle, (m, 3) int32, no two of one triangle the same; equal
            numbers are the same point.
        area: of each triangle, (m,) float64 [m²].
        edge: the undirected edge of each half-edge 3 f + k, from corner k of triangle f to the
            next one, (3 m,) int32.
        start, half: the half-edges of each edge, ragged, ascending, int32; see `list_edges`.

    Returns:
        part: by triangle, a number of its closed part, the lowest triangle in it, or SHEET, or
            COPY; (m,) int32.
        turned: whether a triangle of a closed part faces to the other side than the part, (m,)
            bool.
    """
    num = faces.shape[0]
    part, turned = np.full(num, SHEET, np.int32), np.zeros(num, np.bool_)
    if num == 0:
        return part, turned
    _drop_copies(faces, start, half, part)
    kept = part == SHEET
    while True:  # a membrane that is gone joins the patches at its rim
        left = _peel(faces, edge, start, half, kept)
        patch, face, first, differs = _find_patches(faces, edge, start, half, kept, left)
        turned[:] = False
        _turn_minority(area, face, first, differs, turned)
        if not _drop_membranes(faces, area, edge, left, face, first, turned, kept):
            break
    count = first.shape[0] - 1
    parent, is_open = _unite_patches(faces, start, half, kept, patch, turned, count)
    lowest = np.full(count, np.int64(-1))
    for f in range(num):
        if kept[f]:
            root = find_root(parent, patch[f])
            if is_open[root]:
                continue
            if lowest[root] < 0:
                lowest[root] = f
            part[f] = lowest[root]
    return part, turned & (part >= 0)


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
