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

import math

import numpy as np

from navbake.compiled import UNCOUNTED, kernel, part
from navbake.navgrid.kernels.union_find import find_root, unite

# Triangles that share one box when one looks for those over a point
BLOCK = 64
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


@part(inline="always")
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


@part(inline="always")
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


@kernel
def list_halves(faces, num):
    """List the half-edges of triangles, as `pair_halves` takes them: where lists end, and they."""
    return _list_by_lower_point(faces, num)


@kernel(nogil=True)
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


@part(**UNCOUNTED)
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


@kernel
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


@kernel
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


@part(inline="always")
def _is_left(ax, ay, bx, by, x, y):
    """Whether a point is left of the line from a to b; the same answer, turned, from b to a."""
    if ax < bx or (ax == bx and ay < by):
        return (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0
    return not ((ax - bx) * (y - by) - (ay - by) * (x - bx) > 0.0)


@part(inline="always")
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


@part(inline="always")
def _is_above(c, x, y, z):
    """Whether the plane of a triangle that is not upright is above a point."""
    ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
    vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    height = nx * (c[0, 0] - x) + ny * (c[0, 1] - y) + nz * (c[0, 2] - z)
    return height > 0.0 if nz > 0.0 else height < 0.0


@part
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


@part(inline="always")
def _is_around(box, q, p):
    """Whether the box of part q holds that of part p."""
    is_around = True
    for k in range(3):
        is_around &= box[q, k] <= box[p, k] and box[q, 3 + k] >= box[p, 3 + k]
    return is_around


@kernel
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


@kernel
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
