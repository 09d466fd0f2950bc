"""Which triangles of a mesh belong to a shell: a part whose edges are met by two triangles each.

Points at one place are welded by a hash table; a filter with one hash (Bloom, 1970) first finds the
few that may have an equal. Half-edges are chained by their lower point, and those of a point
compared by the upper one. Triangles are united (union-find) over the edges where two meet, in
opposite directions. A part with any other edge is no shell; `navbake.baker.kernels.parts` decides
what it encloses.
"""

import numpy as np

from navbake.baker.kernels.connect import find_root, unite
from navbake.compiled import UNCOUNTED, kernel, part

MINUS_ZERO = np.uint64(1 << 63)  # its bits
OPEN = np.int32(-1)  # in place of the number of a shell
MOST_EDGES = 256  # at a point, of which each is compared with all; others belong to no shell


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


@part(inline="always")
def _place_of(key, filter_size):
    """The byte of a filter, and the bit in it, that stand for a hash."""
    bit = key & np.uint64(8 * filter_size - 1)
    return np.int64(bit >> np.uint64(3)), np.uint8(1 << np.int64(bit & np.uint64(7)))


@kernel(nogil=True, **UNCOUNTED)
def filter_points(points, once, twice, first, end):
    """Mark the hashes of points, (n, 3) uint64, the coordinates' bits, which meet once and twice.

    Each share of the points, of ``range(first, end)``, has its own filters, (shares, size) uint8 of
    0, the size a power of two; so a hash that two shares meet once is met twice.
    """
    num, shares, size = points.shape[0], once.shape[0], once.shape[1]
    for share in range(first, end):
        for i in range(num * share // shares, num * (share + 1) // shares):
            place, bit = _place_of(_hash(points, i), size)
            twice[share, place] |= once[share, place] & bit
            once[share, place] |= bit


@kernel(nogil=True, **UNCOUNTED)
def find_twice(points, twice, is_twice, first, end):
    """Write whether the hashes of points ``range(first, end)`` are met twice, (n,) bool."""
    for i in range(first, end):
        place, bit = _place_of(_hash(points, i), twice.shape[0])
        is_twice[i] = twice[place] & bit != 0


@kernel(nogil=True)
def weld_points(points, chosen, num_shares, number, first, end):
    """Number the chosen points, ascending, by the first one that equals each.

    They are divided into shares by their hashes, each with a hash table with open addressing.
    Writes the numbers, (n,) int32, of the shares ``range(first, end)``; others stay.
    """
    for share in range(first, end):
        own, count = np.empty(chosen.shape[0], np.int32), 0
        for i in chosen:
            if np.int64(_hash(points, i) >> np.uint64(40)) % num_shares == share:
                own[count] = i
                count += 1
        room = 16
        while room < 2 * count:  # at most half full, so that probing stays short
            room *= 2
        table = np.full(room, np.int32(-1), np.int32)
        for i in own[:count]:
            place = np.int64(_hash(points, i) & np.uint64(room - 1))
            while table[place] >= 0 and not _are_equal(points, table[place], i):
                place = (place + 1) & (room - 1)
            if table[place] < 0:
                table[place] = i
            number[i] = table[place]


@kernel(nogil=True, **UNCOUNTED)
def take_points(number, faces, point, kept, first, end):
    """Write the points of triangles ``range(first, end)``, and which of them have three."""
    for f in range(first, end):
        for k in range(3):
            point[f, k] = number[faces[f, k]]
        a, b, c = point[f, 0], point[f, 1], point[f, 2]
        kept[f] = a != b and b != c and c != a


@part(inline="always")
def _next(half):
    """The next half-edge of a triangle."""
    return half - 2 if half % 3 == 2 else half + 1


@kernel(nogil=True, **UNCOUNTED)
def chain_edges(faces, last, before, first, end):
    """Chain the half-edges 3 f + k, from corner k of triangle f to the next, by their lower point.

    Each share of the triangles, of ``range(first, end)``, has its own chains: ``last[share, low]``
    is the last half-edge of a chain, (shares, points) int32 of -1, and `before` the one before
    each, -1 if none, (3 m,) int32.
    """
    num, shares = faces.shape[0], last.shape[0]
    for share in range(first, end):
        for f in range(num * share // shares, num * (share + 1) // shares):
            for k in range(3):
                low = min(faces[f, k], faces[f, (k + 1) % 3])
                before[3 * f + k] = last[share, low]
                last[share, low] = 3 * f + k


@kernel(nogil=True)
def pair_edges(corners, last, mate, first, end):
    """Find the half-edge that each one is alone with at its edge, as in a shell.

    Takes the corners of triangles, (3 m,), and the chains of `chain_edges`, of the points
    ``range(first, end)``. `mate` is its `before`, which becomes the other half-edge; OPEN if there
    is none or several, if the two run in one direction or belong to triangles back to back, or for
    edges beyond `MOST_EDGES` of a point.
    """
    upper, half = np.empty(MOST_EDGES, np.int32), np.empty(MOST_EDGES, np.int64)
    num = np.empty(MOST_EDGES, np.int64)
    for low in range(first, end):
        edges = 0
        for share in range(last.shape[0]):
            following = np.int64(last[share, low])
            while following >= 0:
                h = following
                following = np.int64(mate[h])
                mate[h] = OPEN
                high, e = max(corners[h], corners[_next(h)]), 0
                while e < edges and upper[e] != high:
                    e += 1
                if e == MOST_EDGES:
                    continue
                if e == edges:
                    upper[e], half[e], num[e] = high, h, 0
                    edges += 1
                one, num[e] = half[e], num[e] + 1
                if num[e] == 2:
                    is_opposite = corners[one] != corners[h]
                    if is_opposite and corners[_next(_next(one))] != corners[_next(_next(h))]:
                        mate[one], mate[h] = h, one
                elif num[e] == 3 and mate[one] != OPEN:
                    mate[mate[one]], mate[one] = OPEN, OPEN


@kernel(nogil=True)
def find_shells(mate):
    """The lowest triangle of the shell that each one belongs to, (m,) int32, or OPEN.

    `mate` is of `pair_edges`.
    """
    num = mate.shape[0] // 3
    shell, is_shell = np.empty(num, np.int32), np.ones(num, np.bool_)
    for f in range(num):
        shell[f] = f
        for k in range(3):
            h = np.int64(mate[3 * f + k])
            if h == OPEN:
                is_shell[f] = False
            elif h // 3 < f:
                unite(shell, np.int64(f), h // 3)
    for f in range(num):
        shell[f] = find_root(shell, np.int64(f))
        if not is_shell[f]:
            is_shell[shell[f]] = False
    for f in range(num):
        if not is_shell[shell[f]]:
            shell[f] = OPEN
    return shell


@kernel(nogil=True, **UNCOUNTED)
def number_shells(shell):
    """Number closed parts from 1 by their lowest triangles, in place; what is negative becomes 0.

    Takes the lowest triangle of each one's part, (m,) int32; returns how many parts there are.
    """
    count = 0
    for f in range(shell.shape[0]):
        if shell[f] == f:
            count += 1
            shell[f] = count
        else:
            shell[f] = shell[shell[f]] if shell[f] >= 0 else 0
    return count
