"""Which triangles of a mesh belong to a shell: a part whose edges are met by two triangles each.

Points at one place are welded by a hash table. The half-edges are listed by their lower point (a
counting sort), and sorted by the upper one within each list (Shell's sort, 1959), so that those of
one edge are neighbours. Triangles at an edge are united (see `union_find`). Parts of which any edge
is met by other than two triangles, or by two in one direction, are no shells: what they enclose is
a harder question, see `navbake.baker.kernels.parts`.

Shells that face in are cavities where they lie inside of one that faces out: that is told by the
other's triangles on a vertical line over a point of it, each counted by how it winds round that
line (Sunday, Inclusion of a point in a polygon, 2001).
"""

import numpy as np

from navbake.compiled import kernel, part
from navbake.navgrid.kernels.union_find import find_root, unite

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


@kernel
def list_edges(faces, num):
    """Number the undirected edges of triangles, (m, 3) int32, of distinct points below `num`.

    Returns:
        The edge of each half-edge 3 f + k, from corner k of triangle f to the next one, (3 m,)
        int32; and the half-edges of each edge, ragged, ascending, int32: `start` and `half`.
    """
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
def find_shells(faces, start, half):
    """Find the parts of a mesh whose edges are all met by two triangles, in either direction once.

    Takes `list_edges`' arguments and results. Returns by triangle the lowest one that it hangs
    together with over edges, (m,) int32; and whether that part is such a shell, (m,) bool.
    """
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
    return part, is_shell


@part(inline="always")
def _is_left(ax, ay, bx, by, x, y):
    """Whether a point is left of the line from a to b; the same answer, turned, from b to a."""
    if ax < bx or (ax == bx and ay < by):
        return (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0
    return not ((ax - bx) * (y - by) - (ay - by) * (x - bx) > 0.0)


@part(inline="always")
def _winding_above(c, x, y, z):
    """How a triangle that is above a point, seen from there, winds round it.

    1, 0, or -1 for one that faces down.
    """
    turns = 0
    for k in range(3):
        ax, ay, bx, by = c[k, 0], c[k, 1], c[(k + 1) % 3, 0], c[(k + 1) % 3, 1]
        if (ay <= y) != (by <= y):
            is_left = _is_left(ax, ay, bx, by, x, y)
            if by > y and is_left:
                turns += 1
            elif by <= y and not is_left:
                turns -= 1
    if turns == 0:
        return 0
    ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
    vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    height = nx * (c[0, 0] - x) + ny * (c[0, 1] - y) + nz * (c[0, 2] - z)
    return turns if (height > 0.0 if nz > 0.0 else height < 0.0) else 0


@kernel
def find_cavities(part, corners, facing_in, order, point, box, encloses):
    """Mark parts that face in and lie inside of one that encloses something, in `encloses`.

    A part is inside of another one where more of that one's triangles over a point of it face up
    than down, and where its box is inside of the other's.

    Args:
        part, corners: of the triangles that enclose something, by part, (m,) and (m, 3, 3) [m].
        facing_in, order: the parts that face in, from west to east, and the x of their points [m].
        point, box, encloses: by part, (parts, 3), (parts, 6) float64 [m] and (parts,) bool.
    """
    total = np.zeros(facing_in.shape[0], np.int64)
    for t in range(part.shape[0]):
        c, q = corners[t], part[t]
        if t == 0 or part[t - 1] != q:
            total[:] = 0
        west, east = min(c[0, 0], c[1, 0], c[2, 0]), max(c[0, 0], c[1, 0], c[2, 0])
        for i in range(np.searchsorted(order, west), len(order)):
            if order[i] > east:
                break
            p = facing_in[i]
            total[i] += _winding_above(c, point[p, 0], point[p, 1], point[p, 2])
        if t + 1 == part.shape[0] or part[t + 1] != q:
            for i in range(len(order)):
                p = facing_in[i]
                is_around = total[i] > 0
                for k in range(3):
                    is_around &= box[q, k] <= box[p, k] and box[q, 3 + k] >= box[p, 3 + k]
                encloses[p] |= is_around
