"""Which triangles of a mesh belong to a shell: a part whose edges are met by two triangles each.

Points at one place are welded by a hash table; a filter with one hash (Bloom, 1970) first finds the
few that may have an equal. Half-edges are chained by their lower point, and those of a point
compared by the upper one. Triangles are united (union-find) over the edges where two meet, in
opposite directions. A part with any other edge is no shell; `mesh_part_kernels` decides
what it encloses.
"""

import numpy as np

from navbake.baker.core.union_find import find_root, unite
from navbake.compiled import NO_REFCOUNT, kernel, subkernel

MINUS_ZERO = np.uint64(1 << 63)  # its bits
NOT_SHELL = np.int32(-1)  # in place of the number of a shell
# Edges at a point that are compared, each with all; the triangles of others are no part of a shell
# here, and `find_parts` decides about them, as it does about those
MAX_EDGES = 256


@subkernel(inline="always")
def _bits(points, i, k):
    """A coordinate's bits; -0.0 is 0.0."""
    return np.uint64(0) if points[i, k] == MINUS_ZERO else points[i, k]


@subkernel(inline="always")
def _are_equal(points, i, j):
    is_equal = True
    for k in range(3):
        is_equal &= _bits(points, i, k) == _bits(points, j, k)
    return is_equal


@subkernel(inline="always")
def _hash(points, i):
    key = np.uint64(1469598103934665603)
    for k in range(3):
        key = (key ^ _bits(points, i, k)) * np.uint64(1099511628211)
        key ^= key >> np.uint64(29)
    return key


@subkernel(inline="always")
def _place_of(key, filter_size):
    """The byte of a filter, and the bit in it, that stand for a hash."""
    bit = key & np.uint64(8 * filter_size - 1)
    return np.int64(bit >> np.uint64(3)), np.uint8(1 << np.int64(bit & np.uint64(7)))


@kernel(nogil=True)
def weld_points(points, num_shares, number, first, end):
    """Number points, (n, 3) uint64, the coordinates' bits, by the first one that equals each.

    Points are divided into shares by their hashes, each with a filter and a hash table with open
    addressing. Writes the numbers, (n,) int32, of the shares ``range(first, end)``.
    """
    num = points.shape[0]
    shares = np.uint64(num_shares)
    for share in range(first, end):
        own = np.empty(num + 1, np.int32)
        count = 0
        for i in range(num):
            own[count] = i  # without a branch, which nobody could predict
            count += (
                1 if (_hash(points, i) >> np.uint64(40)) * shares >> np.uint64(24) == share else 0
            )
        size = 16
        while size < count:  # 8 bits a point
            size *= 2
        once = np.zeros(size, np.uint8)
        twice = np.zeros(size, np.uint8)
        for i in own[:count]:
            place, bit = _place_of(_hash(points, i), size)
            twice[place] |= once[place] & bit
            once[place] |= bit
        chosen = 0
        for i in own[:count]:
            number[i] = i
            place, bit = _place_of(_hash(points, i), size)
            if twice[place] & bit:
                own[chosen] = i
                chosen += 1
        room = 16
        while room < 2 * chosen:  # at most half full, so that probing stays short
            room *= 2
        table = np.full(room, np.int32(-1), np.int32)
        for i in own[:chosen]:
            place = np.int64(_hash(points, i) & np.uint64(room - 1))
            while table[place] >= 0 and not _are_equal(points, table[place], i):
                place = (place + 1) & (room - 1)
            if table[place] < 0:
                table[place] = i
            number[i] = table[place]


@subkernel(inline="always")
def _next(half):
    """The next half-edge of a triangle."""
    return half - 2 if half % 3 == 2 else half + 1


@kernel(nogil=True, **NO_REFCOUNT)
def chain_edges(number, faces, point, kept, last, before, first, end):
    """Chain the half-edges 3 f + k, from corner k of triangle f to the next, by their lower point.

    Each share of the triangles, of ``range(first, end)``, has its own chains: ``last[share, low]``
    is the last half-edge of a chain, (shares, points) int32 of -1, and `before` the one before
    each, -1 if none, (3 m,) int32. Writes also the points of each triangle by their numbers,
    (m, 3) int32, and whether it has three, (m,) bool; those with fewer are in no chain.
    """
    num = faces.shape[0]
    shares = last.shape[0]
    for share in range(first, end):
        for f in range(num * share // shares, num * (share + 1) // shares):
            a = number[faces[f, 0]]
            b = number[faces[f, 1]]
            c = number[faces[f, 2]]
            point[f, 0] = a
            point[f, 1] = b
            point[f, 2] = c
            kept[f] = a != b and b != c and c != a
            for k in range(3 if kept[f] else 0):
                low = min(point[f, k], point[f, (k + 1) % 3])
                before[3 * f + k] = last[share, low]
                last[share, low] = 3 * f + k


@kernel(nogil=True)
def find_shells(corners, last, mate, shell, first, end):
    """Find the half-edge that each one is alone with at its edge, and then the shells.

    The first are of the points ``range(first, end)``: `mate`, the `before` of `chain_edges`,
    becomes the other half-edge; NOT_SHELL if there is none or several, if the two run in one
    direction or belong to triangles back to back, or for edges beyond `MAX_EDGES` of a point. The
    shells are found for the point behind the last one.

    Args:
        corners: points of the triangles, (3 m,) int32.
        last: the chains of `chain_edges`.
        shell: (m,) int32; receives the lowest triangle of each one's shell, or NOT_SHELL.
    """
    upper = np.empty(MAX_EDGES, np.int32)
    half = np.empty(MAX_EDGES, np.int64)
    num = np.empty(MAX_EDGES, np.int64)
    for low in range(first, min(end, last.shape[1])):
        edges = 0
        for share in range(last.shape[0]):
            following = np.int64(last[share, low])
            while following >= 0:
                h = following
                following = np.int64(mate[h])
                mate[h] = NOT_SHELL
                high = max(corners[h], corners[_next(h)])
                e = 0
                while e < edges and upper[e] != high:
                    e += 1
                if e == MAX_EDGES:
                    continue
                if e == edges:
                    upper[e] = high
                    half[e] = h
                    num[e] = 0
                    edges += 1
                one = half[e]
                num[e] = num[e] + 1
                if num[e] == 2:
                    is_opposite = corners[one] != corners[h]
                    if is_opposite and corners[_next(_next(one))] != corners[_next(_next(h))]:
                        mate[one] = h
                        mate[h] = one
                elif num[e] == 3 and mate[one] != NOT_SHELL:
                    mate[mate[one]] = NOT_SHELL
                    mate[one] = NOT_SHELL
    if end <= last.shape[1]:
        return
    is_shell = np.ones(shell.shape[0], np.bool_)
    for f in range(shell.shape[0]):
        shell[f] = f
        for k in range(3):
            h = np.int64(mate[3 * f + k])
            if h == NOT_SHELL:
                is_shell[f] = False
            elif h // 3 < f:
                unite(shell, np.int64(f), h // 3)
    for f in range(shell.shape[0]):
        shell[f] = find_root(shell, np.int64(f))
        if not is_shell[f]:
            is_shell[shell[f]] = False
    for f in range(shell.shape[0]):
        if not is_shell[shell[f]]:
            shell[f] = NOT_SHELL
