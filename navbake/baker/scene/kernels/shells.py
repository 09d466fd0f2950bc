"""Which triangles of a mesh belong to a shell: a part whose edges are met by two triangles each.

Points at one place are welded by a hash table. Half-edges are sorted by their lower point (counting
sort) and then by the upper one (Shell's sort, 1959), so that those of one edge are neighbours.
Triangles at an edge are united (union-find). Parts with an edge that is met by other than two
triangles, or by two in one direction, are no shells; `navbake.baker.kernels.parts` decides what
they enclose.
"""

import numpy as np

from navbake.baker.kernels.connect import find_root, unite
from navbake.compiled import kernel, part

MINUS_ZERO = np.uint64(1 << 63)  # its bits


@part(inline="always")
def _bits(points, i, k):
    """A coordinate's bits; -0.0 is 0.0."""
    return np.uint64(0) if points[i, k] == MINUS_ZERO else points[i, k]


@part(inline="always")
def _are_equal(points, i, j):
    is_equal = True
    for k in range(3):
        is_equal &= _bits(points, i, k) == _bits(points, j, k)
    return is_equal


@part(inline="always")
def _hash(points, i):
    key = np.uint64(1469598103934665603)
    for k in range(3):
        key = (key ^ _bits(points, i, k)) * np.uint64(1099511628211)
        key ^= key >> np.uint64(29)
    return key


@kernel(nogil=True)
def weld_points(points, num_shares, number, first, end):
    """Number points, (n, 3) uint64, the coordinates' bits, by the first one that equals each.

    Points are divided into shares by their hashes, each with a hash table with open addressing.
    Writes the numbers, (n,) int32, of the shares ``range(first, end)``.
    """
    num, shares = points.shape[0], np.uint64(num_shares)
    for share in range(first, end):
        count = 0
        for i in range(num):
            count += 1 if (_hash(points, i) >> np.uint64(40)) % shares == np.uint64(share) else 0
        size = 16
        while size < 2 * count:  # at most half full, so that probing stays short
            size *= 2
        table = np.full(size, np.int32(-1), np.int32)
        for i in range(num):
            key = _hash(points, i)
            if (key >> np.uint64(40)) % shares != np.uint64(share):
                continue
            place = np.int64(key & np.uint64(size - 1))
            while table[place] >= 0 and not _are_equal(points, table[place], i):
                place = (place + 1) & (size - 1)
            if table[place] < 0:
                table[place] = i
            number[i] = table[place]


@part(inline="always")
def sort_keys(keys, num):
    """Sort the first keys, ascending, in place: Shell's sort."""
    gap = 1
    while gap < num // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, num):
            key, j = keys[i], i
            while j >= gap and keys[j - gap] > key:
                keys[j] = keys[j - gap]
                j -= gap
            keys[j] = key
        gap //= 3


@part
def list_edges(faces, low0, low_end):
    """List the half-edges 3 f + k, from corner k of triangle f to the next one, edge by edge.

    Of the edges whose lower points are in ``range(low0, low_end)``: `start`, (edges + 1,), and
    `half`, ragged, ascending, both int32.
    """
    stop, half = np.zeros(low_end - low0, np.int32), np.empty(0, np.int32)
    for writing in (False, True):
        for f in range(faces.shape[0]):
            for k in range(3):
                low = min(faces[f, k], faces[f, (k + 1) % 3])
                if low0 <= low < low_end:
                    if writing:
                        half[stop[low - low0]] = 3 * f + k
                    stop[low - low0] += 1
        if not writing:  # to where each list begins, from where writing takes it to its end
            total = np.int32(0)
            for low in range(low_end - low0):
                count = stop[low]
                stop[low] = total
                total += count
            half = np.empty(total, np.int32)
    start, keys = np.empty(half.shape[0] + 1, np.int32), np.empty(16, np.int64)
    first, edges = np.int32(0), 0
    for low in range(low_end - low0):
        count = stop[low] - first
        if count > keys.shape[0]:
            keys = np.empty(2 * count, np.int64)
        for i in range(count):
            h = half[first + i]
            high = max(faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3])
            keys[i] = (np.int64(high) << 32) | h
        sort_keys(keys, count)
        for i in range(count):
            if i == 0 or keys[i] >> 32 != keys[i - 1] >> 32:
                start[edges] = first + i
                edges += 1
            half[first + i] = keys[i] & 0xFFFFFFFF
        first = stop[low]
    start[edges] = half.shape[0]
    return start[: edges + 1], half


@part(inline="always")
def _are_neighbours(faces, h, g):
    """Whether two half-edges of an edge run in opposite ways, of triangles not back to back."""
    here, next_ = faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3]
    other, third = faces[g // 3, g % 3], faces[g // 3, (g % 3 + 2) % 3]
    return here != other and next_ == other and third != faces[h // 3, (h % 3 + 2) % 3]


@kernel(nogil=True)
def find_shells(faces, num, parts, is_shell, first, end):
    """Find the parts of a mesh whose edges are all met by two triangles, in either direction once.

    The points are divided into shares, of which this looks at ``range(first, end)``; and then, for
    the share behind the last, puts together what was found.

    Args:
        faces: corners of each triangle, (m, 3) int32, of distinct points below `num`.
        parts: by share, (shares, m) int32: receives parents of the triangles; ``parts[0]`` at last
            the lowest triangle of each one's part, connected over edges.
        is_shell: (m,) bool, all True; becomes whether each one's part is a shell.
    """
    shares, part = parts.shape[0], parts[0]
    for share in range(first, min(end, shares)):
        for f in range(faces.shape[0]):
            parts[share, f] = f
        low, low_end = num * share // shares, num * (share + 1) // shares
        start, half = list_edges(faces, low, low_end)
        for e in range(start.shape[0] - 1):
            one = np.int64(half[start[e]])
            for i in range(start[e] + 1, start[e + 1]):
                unite(parts[share], one // 3, np.int64(half[i]) // 3)
            is_pair = start[e + 1] - start[e] == 2
            if not is_pair or not _are_neighbours(faces, one, np.int64(half[start[e] + 1])):
                is_shell[one // 3] = False
    if end <= shares:
        return
    for share in range(1, shares):
        for f in range(part.shape[0]):
            if parts[share, f] != f:
                unite(part, np.int64(f), np.int64(parts[share, f]))
    for f in range(part.shape[0]):
        part[f] = find_root(part, np.int64(f))
        if not is_shell[f]:
            is_shell[part[f]] = False
    for f in range(part.shape[0]):
        is_shell[f] = is_shell[part[f]]
