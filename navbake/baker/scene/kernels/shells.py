"""Which triangles of a mesh belong to a shell: a part whose edges are met by two triangles each.

Points at one place are welded by a hash table. The half-edges are listed by their lower point (a
counting sort), and sorted by the upper one within each list (Shell's sort, 1959), so that those of
one edge are neighbours. Triangles at an edge are united (see `unite`). Parts of which any edge
is met by other than two triangles, or by two in one direction, are no shells: what they enclose is
a harder question, see `navbake.baker.kernels.parts`.
"""

import numpy as np

from navbake.compiled import kernel, part
from navbake.navgrid.kernels.connect import find_root, unite

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
    """Number points so that equal ones have equal numbers: each has that of the first one.

    A hash table with open addressing over the coordinates' bits, (n, 3) uint64, for each share of
    the points, which their hashes tell. Writes the numbers, (n,) int32, for ``range(first, end)``
    of the shares.
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
def _list_edges(faces, num):
    """Number the undirected edges of triangles; see `find_shells` for what it returns."""
    # the half-edges by the lower one of their two points, ragged
    end, half = np.zeros(num + 1, np.int32), np.empty(3 * faces.shape[0], np.int32)
    for writing in (False, True):
        for h in range(half.shape[0]):
            low = min(faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3])
            if writing:
                half[end[low]] = h
            end[low] += 1
        if not writing:  # to where each list begins, from where writing takes it to its end
            total = np.int32(0)
            for low in range(num):
                count = end[low]
                end[low] = total
                total += count
    edge, start = np.empty(half.shape[0], np.int32), np.empty(half.shape[0] + 1, np.int32)
    keys = np.empty(16, np.int64)
    first, edges = 0, 0
    for low in range(num):
        count = end[low] - first
        if count > keys.shape[0]:
            keys = np.empty(2 * count, np.int64)
        for i in range(count):
            h = half[first + i]
            high = max(faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3])
            keys[i] = (np.int64(high) << 32) | h
        sort_keys(keys, count)
        for i in range(count):
            h = keys[i] & 0xFFFFFFFF
            if i == 0 or keys[i] >> 32 != keys[i - 1] >> 32:
                start[edges] = first + i
                edges += 1
            half[first + i], edge[h] = h, edges - 1
        first = end[low]
    start[edges] = half.shape[0]
    return edge, start[: edges + 1].copy(), half


@part(inline="always")
def _are_neighbours(faces, h, g):
    """Whether two triangles run along their edge in opposite ways, and are no back of each other.

    Takes their half-edges there.
    """
    here, next_ = faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3]
    other, third = faces[g // 3, g % 3], faces[g // 3, (g % 3 + 2) % 3]
    return here != other and next_ == other and third != faces[h // 3, (h % 3 + 2) % 3]


@kernel
def find_shells(faces, num):
    """Find the parts of a mesh whose edges are all met by two triangles, in either direction once.

    Args:
        faces: corners of each triangle, (m, 3) int32, of distinct points below `num`.

    Returns:
        By triangle the lowest one that it hangs together with over edges, (m,) int32; whether that
        part is such a shell, (m,) bool; the edge of each half-edge 3 f + k, from corner k of
        triangle f to the next one, (3 m,) int32; and the half-edges of each edge, ragged,
        ascending, int32: `start` and `half`.
    """
    edge, start, half = _list_edges(faces, num)
    is_shell = np.ones(faces.shape[0], np.bool_)
    part = np.arange(faces.shape[0]).astype(np.int32)
    for e in range(start.shape[0] - 1):
        first = np.int64(half[start[e]])
        for i in range(start[e] + 1, start[e + 1]):
            unite(part, first // 3, np.int64(half[i]) // 3)
        is_pair = start[e + 1] - start[e] == 2
        if not is_pair or not _are_neighbours(faces, first, np.int64(half[start[e] + 1])):
            is_shell[first // 3] = False
    for f in range(part.shape[0]):
        part[f] = find_root(part, np.int64(f))
        if not is_shell[f]:
            is_shell[part[f]] = False
    for f in range(part.shape[0]):
        is_shell[f] = is_shell[part[f]]
    return part, is_shell, edge, start, half
