"""Which triangles of a mesh belong to a shell: a part whose edges are met by two triangles each.

Points at one place are welded by a hash table. The half-edges are listed by their lower point (a
counting sort), and sorted by the upper one within each list (Shell's sort, 1959), so that those of
one edge are neighbours. Triangles at an edge are united (see `union_find`). Parts of which any edge
is met by other than two triangles, or by two in one direction, are no shells: what they enclose is
a harder question, see `navbake.baker.kernels.parts`.
"""

import numpy as np
from numba import njit

from navbake.compiled import UNCOUNTED
from navbake.navgrid.kernels.union_find import find_root, unite

MINUS_ZERO = np.uint64(1 << 63)  # its bits


@njit(inline="always")
def _bits(points, i, k):
    """A coordinate's bits; -0.0 is 0.0."""
    return np.uint64(0) if points[i, k] == MINUS_ZERO else points[i, k]


@njit(inline="always")
def _are_equal(points, i, j):
    is_equal = True
    for k in range(3):
        is_equal &= _bits(points, i, k) == _bits(points, j, k)
    return is_equal


@njit(inline="always")
def _hash(points, i):
    key = np.uint64(1469598103934665603)
    for k in range(3):
        key = (key ^ _bits(points, i, k)) * np.uint64(1099511628211)
        key ^= key >> np.uint64(29)
    return key


@njit(cache=True, nogil=True)
def weld_points(points, num_shares, number, first, end):
    """Number points so that equal ones have equal numbers: each has that of the first one.

    A hash table with open addressing over the coordinates' bits for each share of the points,
    which their hashes tell. Looks at the shares ``range(first, end)``.

    Args:
        points: the bits of the coordinates, (n, 3) uint64.
        number: receives the numbers, (n,) int32.
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


@njit(cache=True)
def weld_faces(faces, number):
    """The triangles' corners as numbers of points, (m, 3) int32, and whether these are three.

    Args:
        faces: corners of each triangle, indices of vertices, (m, 3).
        number: the point of each vertex, see `weld_points`.
    """
    point, is_triangle = np.empty(faces.shape, np.int32), np.empty(faces.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        a, b, c = number[faces[f, 0]], number[faces[f, 1]], number[faces[f, 2]]
        point[f, 0], point[f, 1], point[f, 2] = a, b, c
        is_triangle[f] = a != b and b != c and c != a
    return point, is_triangle


@njit(inline="always")
def _list_by_lower_point(faces, num):
    """The half-edges 3 f + k of triangles, ragged, by the lower one of their two points."""
    start = np.zeros(num + 1, np.int32)
    half = np.empty(3 * faces.shape[0], np.int32)
    for writing in (False, True):
        for f in range(faces.shape[0]):
            for k in range(3):
                low = min(faces[f, k], faces[f, (k + 1) % 3])
                if writing:
                    half[start[low]] = 3 * f + k
                start[low] += 1
        if not writing:  # to where each list begins
            total = np.int32(0)
            for low in range(num):
                count = start[low]
                start[low] = total
                total += count
    return start, half  # start is now where each list ends


@njit(inline="always")
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


@njit(inline="always")
def _are_neighbours(faces, key, other):
    """Whether two triangles run along their edge in opposite ways, and are no back of each other.

    Their keys are those of `pair_halves`.
    """
    f, g = (key & 0xFFFFFFFF) >> 1, (other & 0xFFFFFFFF) >> 1
    # both have the edge's two points, so equal sums are equal third points
    is_back = (
        np.int64(faces[f, 0]) + faces[f, 1] + faces[f, 2]
        == np.int64(faces[g, 0]) + faces[g, 1] + faces[g, 2]
    )
    return (key & 1) != (other & 1) and not is_back


@njit(cache=True)
def list_halves(faces, num):
    """List the half-edges of triangles, as `pair_halves` takes them: where lists end, and they."""
    return _list_by_lower_point(faces, num)


@njit(cache=True, nogil=True)
def pair_halves(faces, end_of, half, is_shell, low0, low_end):
    """Bring the triangles at each edge together, in place of the half-edges of some lower points.

    The first triangle f at an edge becomes -1 - f, those that follow are as they are. Looks at the
    points ``range(low0, low_end)``.

    Args:
        faces: corners of each triangle, numbers of points, no two of one triangle the same, (m, 3)
            int32.
        end_of, half: see `list_halves`.
        is_shell: (m,) bool, receives False for the first triangle at each edge that is met by other
            than two triangles, in either direction once.
    """
    most, first = 0, end_of[low0 - 1] if low0 > 0 else 0
    for low in range(low0, low_end):
        most, first = max(most, end_of[low] - first), end_of[low]
    _pair_halves(faces, end_of, half, is_shell, np.empty(most, np.int64), low0, low_end)


@njit(cache=True, **UNCOUNTED)
def _pair_halves(faces, end_of, half, is_shell, keys, low0, low_end):
    """See `pair_halves`; `keys` has room for those of a point."""
    for low in range(low0, low_end):
        first = end_of[low - 1] if low > 0 else 0
        count = end_of[low] - first
        for i in range(count):
            f, k = half[first + i] // 3, half[first + i] % 3
            high = max(faces[f, k], faces[f, (k + 1) % 3])
            # the direction in the lowest bit
            keys[i] = (np.int64(high) << 32) | (np.int64(f) << 1) | (faces[f, k] == low)
        sort_keys(keys, count)
        i = 0
        while i < count:
            last = i + 1
            while last < count and keys[last] >> 32 == keys[i] >> 32:
                half[first + last] = (keys[last] & 0xFFFFFFFF) >> 1
                last += 1
            one = (keys[i] & 0xFFFFFFFF) >> 1
            half[first + i] = -1 - one
            if last - i != 2 or not _are_neighbours(faces, keys[i], keys[i + 1]):
                is_shell[one] = False
            i = last


@njit(cache=True)
def unite_pairs(paired, is_shell):
    """Find the parts of a mesh whose edges are all met by two triangles, in either direction once.

    Args:
        paired: the triangles at each edge, see `pair_halves`.
        is_shell: what `pair_halves` says, (m,) bool; becomes whether a triangle's part is a shell.

    Returns:
        By triangle, the lowest triangle that it hangs together with over edges, (m,) int32.
    """
    part = np.arange(is_shell.shape[0]).astype(np.int32)
    one = np.int64(0)
    for i in range(paired.shape[0]):
        if paired[i] < 0:
            one = np.int64(-1 - paired[i])
        else:
            unite(part, one, np.int64(paired[i]))
    for f in range(part.shape[0]):
        part[f] = find_root(part, np.int64(f))
        if not is_shell[f]:
            is_shell[part[f]] = False
    for f in range(part.shape[0]):
        is_shell[f] = is_shell[part[f]]
    return part


@njit(cache=True)
def list_edges(faces, num):
    """Number the undirected edges of triangles.

    Args:
        faces: see `pair_halves`.

    Returns:
        edge: the undirected edge of each half-edge 3 f + k, from corner k of triangle f to the next
            one, (3 m,) int32.
        start, half: the half-edges of each edge, ragged, ascending, int32.
    """
    end, half = _list_by_lower_point(faces, num)
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
