"""Which triangles of a mesh enclose something: closed parts, without the sheets that hang on them.

Triangles with a bare edge, where no other one ends, are peeled off, and by a queue those that this
lays bare: nothing is left of a sheet, all of a closed surface. A flood over the edges where two
triangles meet divides the rest into manifold patches, and finds the triangles that face the other
way (Ju, Robust repair of polygonal models, 2004, section 2, lists the faults of meshes). Patches
that close no edge, membranes, are dropped; the others are united where they close each other's
edges. A part is closed when each edge is met as often in one direction as in the other.
"""

import numpy as np

from navbake.baker.core.union_find import find_root, unite
from navbake.compiled import kernel, subkernel

# In place of a closed part's number: of a sheet, or a copy of another triangle
SHEET = np.int32(-1)
COPY = np.int32(-2)


@subkernel(inline="always")
def _opposite(faces, half):
    """The corner of a triangle that is not on one of its edges; edges are numbered 3 f + k."""
    return faces[half // 3, (half % 3 + 2) % 3]


@subkernel(inline="always")
def _direction(faces, turned, half):
    """1 for a half-edge, of turned triangles turned, that runs to its higher corner, else -1."""
    face = half // 3
    k = half % 3
    runs_up = faces[face, k] < faces[face, (k + 1) % 3]
    return 1 if runs_up != turned[face] else -1


@subkernel(inline="always")
def _sort_keys(keys, num):
    """Sort the first keys, ascending, in place: Shell's sort."""
    gap = 1
    while gap < num // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, num):
            key = keys[i]
            j = i
            while j >= gap and keys[j - gap] > key:
                keys[j] = keys[j - gap]
                j -= gap
            keys[j] = key
        gap //= 3


@subkernel
def _list_edges(faces, num_points):
    """List the half-edges 3 f + k, from corner k of triangle f to the next one, edge by edge.

    Those with one lower point (counting sort) are sorted by the upper one. Returns `start`,
    (edges + 1,), and `half`, ragged, ascending, both int32.
    """
    stop = np.zeros(num_points, np.int32)
    half = np.empty(3 * faces.shape[0], np.int32)
    for writing in (False, True):
        for f in range(faces.shape[0]):
            for k in range(3):
                low = min(faces[f, k], faces[f, (k + 1) % 3])
                if writing:
                    half[stop[low]] = 3 * f + k
                stop[low] += 1
        if not writing:  # to where each list begins, from where writing takes it to its end
            total = np.int32(0)
            for low in range(num_points):
                count = stop[low]
                stop[low] = total
                total += count
    start = np.empty(half.shape[0] + 1, np.int32)
    keys = np.empty(16, np.int64)
    first = np.int32(0)
    edges = 0
    for low in range(num_points):
        count = stop[low] - first
        if count > keys.shape[0]:
            keys = np.empty(2 * count, np.int64)
        for i in range(count):
            h = half[first + i]
            high = max(faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3])
            keys[i] = (np.int64(high) << 32) | h
        _sort_keys(keys, count)
        for i in range(count):
            if i == 0 or keys[i] >> 32 != keys[i - 1] >> 32:
                start[edges] = first + i
                edges += 1
            half[first + i] = keys[i] & 0xFFFFFFFF
        first = stop[low]
    start[edges] = half.shape[0]
    return start[: edges + 1], half


@subkernel(inline="always")
def _drop_copies(faces, start, half, part):
    """Mark triangles that have the corners of an earlier one, the same way round."""
    keys = np.empty(16, np.int64)
    for e in range(start.shape[0] - 1):
        if start[e + 1] - start[e] > keys.shape[0]:
            keys = np.empty(2 * (start[e + 1] - start[e]), np.int64)
        count = 0
        for h in half[start[e] : start[e + 1]]:
            f = h // 3
            k = h % 3
            here = faces[f, k]
            after = faces[f, (k + 1) % 3]
            third = _opposite(faces, h)
            # each triangle is listed once, at the edge behind its lowest corner
            if here < after and here < third:
                keys[count] = (np.int64(third) << 32) | f
                count += 1
        if count > 1:
            _sort_keys(keys, count)
        for i in range(1, count):
            if keys[i] >> 32 == keys[i - 1] >> 32:
                part[keys[i] & 0xFFFFFFFF] = COPY


@subkernel(inline="always")
def _is_bare(faces, e, start, half, left, kept):
    """Whether only one triangle is left at an edge, or two back to back."""
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


@subkernel(inline="always")
def _take_at(e, start, half, kept, queue, end):
    """Remove the triangles at an edge, and queue them; returns the end of the queue."""
    for h in half[start[e] : start[e + 1]]:
        if kept[h // 3]:
            kept[h // 3] = False
            queue[end] = h // 3
            end += 1
    return end


@subkernel
def _peel(faces, edge, start, half, kept):
    """Remove triangles with a bare edge until there is none; returns the triangles at each edge."""
    left = np.zeros(start.shape[0] - 1, np.int32)
    for h in range(edge.shape[0]):
        if kept[h // 3]:
            left[edge[h]] += 1
    queue = np.empty(faces.shape[0], np.int32)
    end = at = 0
    for e in range(start.shape[0] - 1):
        if left[e] > 0 and _is_bare(faces, e, start, half, left, kept):
            end = _take_at(e, start, half, kept, queue, end)
    # a triangle counts at its edges until its turn in the queue
    while at < end:
        face = queue[at]
        at += 1
        for k in range(3):
            e = edge[3 * face + k]
            left[e] -= 1
            if left[e] > 0 and _is_bare(faces, e, start, half, left, kept):
                end = _take_at(e, start, half, kept, queue, end)
    return left


@subkernel(inline="always")
def _partner(e, face, start, half, kept):
    """The half-edge of the other triangle at an edge with two that are left."""
    for h in half[start[e] : start[e + 1]]:
        if kept[h // 3] and h // 3 != face:
            return h
    return np.int64(-1)


@subkernel
def _find_patches(faces, edge, start, half, kept, left):
    """Number the manifold patches, which hang together over edges with two triangles.

    Returns the patch of each triangle, -1 unless kept; the triangles of each patch, ragged; and
    which triangles face the other way than the first one of their patch.
    """
    num = faces.shape[0]
    patch = np.full(num, np.int32(-1), np.int32)
    differs = np.zeros(num, np.bool_)
    queue = np.empty(num, np.int32)
    first = np.empty(num + 1, np.int32)
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


@subkernel(inline="always")
def _turn_minority(area, face, first, differs, turned):
    """Turn the triangles of each patch that face as less than half of its area does."""
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


@subkernel(inline="always")
def _take_away(faces, edge, face, left, turned, balance, sign):
    """Remove a triangle from edges with more than two, or add it (`sign` -1).

    Returns how many fewer half-edges are without partner.
    """
    gain = 0
    for k in range(3):
        e = edge[3 * face + k]
        if left[e] > 2:
            before = abs(balance[e])
            balance[e] -= sign * _direction(faces, turned, 3 * face + k)
            gain += before - abs(balance[e])
    return gain


@subkernel(inline="always")
def _drop_membranes(faces, area, edge, left, face, first, turned, kept):
    """Drop patches, the smallest first, if that leaves fewer half-edges without partner.

    A wall without thickness across a block is one. Returns whether any was dropped.
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


@subkernel
def _unite_patches(faces, start, half, kept, patch, turned, num):
    """Unite patches at edges that neither closes by itself, as blocks that touch there do.

    Returns each patch's parent, and by root, whether an edge of it stays without partner.
    """
    parent = np.arange(num)
    is_open = np.zeros(num, np.bool_)
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


@kernel
def find_parts(faces, area, num_points):
    """Find the closed parts of a mesh.

    Args:
        faces: corners of each triangle, (m, 3) int32, no two of one triangle the same; equal
            numbers are the same point, all below `num_points`.
        area: of each triangle, (m,) float64 [m²].

    Returns:
        part: by triangle, a number of its closed part, the lowest triangle in it, or SHEET, or
            COPY; (m,) int32.
        turned: whether a triangle of a closed part faces to the other side than the part, (m,)
            bool.
    """
    num = faces.shape[0]
    part = np.full(num, SHEET, np.int32)
    turned = np.zeros(num, np.bool_)
    if num == 0:
        return part, turned
    start, half = _list_edges(faces, num_points)
    edge = np.empty(half.shape[0], np.int32)
    for e in range(start.shape[0] - 1):
        for h in half[start[e] : start[e + 1]]:
            edge[h] = e
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
