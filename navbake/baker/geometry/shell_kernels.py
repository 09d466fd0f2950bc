"""Find the shells of meshes: connected parts in which exactly two triangles meet at each edge.

The two triangles run along the edge in opposite directions. A part with any other edge is no shell;
`mesh_part_kernels` decides what it encloses.

Points at one place are welded by a hash table; a filter with one hash (Bloom, 1970) first finds the
few points that may be at the place of another point. Half-edges with the same lower point (by
number) are chained, and those of a chain are compared by their upper point. Triangles are united
(union-find) over the edges at which two meet.

A half-edge is one side of a triangle. Half-edge ``3 f + k`` runs from corner k of triangle f to the
next corner.
"""

import numpy as np

from navbake.baker.core.union_find import find_root, unite
from navbake.compiled import NO_REFCOUNT, kernel, subkernel

MINUS_ZERO = np.uint64(1 << 63)  # the bits of -0.0
# In place of the number of a triangle's shell, or of a half-edge's mate: there is none
NOT_SHELL = np.int32(-1)
# The edges of a point are searched one by one, so at most this many are. Triangles at further edges
# are in no shell; `find_parts` decides what they enclose
MAX_EDGES_OF_POINT = 256


@subkernel(inline="always")
def _bits(points, i, k):
    """Return the bits of coordinate k of point i; for -0.0, the bits of 0.0."""
    return np.uint64(0) if points[i, k] == MINUS_ZERO else points[i, k]


@subkernel(inline="always")
def _are_equal(points, i, j):
    """Return whether two points are at the same place."""
    is_equal = True
    for k in range(3):
        is_equal &= _bits(points, i, k) == _bits(points, j, k)
    return is_equal


@subkernel(inline="always")
def _hash(points, i):
    """Return the hash of a point's coordinates (FNV-1a), uint64."""
    key = np.uint64(1469598103934665603)
    for k in range(3):
        key = (key ^ _bits(points, i, k)) * np.uint64(1099511628211)
        key ^= key >> np.uint64(29)
    return key


@subkernel(inline="always")
def _filter_bit(key, filter_size):
    """Return the index of a byte of a filter, and the bit in it, that stand for a hash."""
    bit = key & np.uint64(8 * filter_size - 1)
    return np.int64(bit >> np.uint64(3)), np.uint8(1 << np.int64(bit & np.uint64(7)))


@kernel(nogil=True)
def weld_points(points, num_shares, number, first, end):
    """Give all points at one place the same number: the index of the first of them.

    Points are divided into shares by their hashes, so that several threads work side by side. Each
    share has its own filter and its own hash table with open addressing.

    Args:
        points: bits of the coordinates, (n, 3) uint64.
        num_shares: number of shares.
        number: receives the number of each point, (n,) int32.
        first, end: range of shares to work on.
    """
    num_points = points.shape[0]
    shares = np.uint64(num_shares)
    for share in range(first, end):
        share_points = np.empty(num_points + 1, np.int32)
        count = 0
        for i in range(num_points):
            share_points[count] = i  # without a branch, which the CPU could not predict
            count += (
                1 if (_hash(points, i) >> np.uint64(40)) * shares >> np.uint64(24) == share else 0
            )
        filter_size = 16
        while filter_size < count:  # 8 bits a point
            filter_size *= 2
        seen_once = np.zeros(filter_size, np.uint8)
        seen_twice = np.zeros(filter_size, np.uint8)
        for i in share_points[:count]:
            byte, bit = _filter_bit(_hash(points, i), filter_size)
            seen_twice[byte] |= seen_once[byte] & bit
            seen_once[byte] |= bit
        num_candidates = 0
        for i in share_points[:count]:
            number[i] = i
            byte, bit = _filter_bit(_hash(points, i), filter_size)
            if seen_twice[byte] & bit:
                share_points[num_candidates] = i
                num_candidates += 1
        table_size = 16
        while table_size < 2 * num_candidates:  # at most half full, so that probing stays short
            table_size *= 2
        table = np.full(table_size, np.int32(-1), np.int32)
        for i in share_points[:num_candidates]:
            slot = np.int64(_hash(points, i) & np.uint64(table_size - 1))
            while table[slot] >= 0 and not _are_equal(points, table[slot], i):
                slot = (slot + 1) & (table_size - 1)
            if table[slot] < 0:
                table[slot] = i
            number[i] = table[slot]


@subkernel(inline="always")
def _next(half_edge):
    """Return the next half-edge of the same triangle."""
    return half_edge - 2 if half_edge % 3 == 2 else half_edge + 1


@kernel(nogil=True, **NO_REFCOUNT)
def chain_edges(number, faces, point, is_proper, last, previous, first, end):
    """Chain the half-edges that have the same lower point.

    Triangles are divided into shares, ranges for one thread each. This is done for shares
    ``range(first, end)``, each with its own chains.

    Args:
        number: the point of each vertex, see `weld_points`, (n,) int32.
        faces: vertices of each triangle, (m, 3) int32.
        point: receives the points of each triangle, (m, 3) int32.
        is_proper: receives whether a triangle has three different points, (m,) bool; the half-edges
            of other triangles are in no chain.
        last: -1 everywhere; ``last[share, low]`` receives the last half-edge in the chain of point
            `low`, (shares, n) int32.
        previous: receives the half-edge before each half-edge in its chain, -1 for none, (3 m,)
            int32.
        first, end: range of shares.
    """
    num_faces = faces.shape[0]
    num_shares = last.shape[0]
    for share in range(first, end):
        for f in range(num_faces * share // num_shares, num_faces * (share + 1) // num_shares):
            a = number[faces[f, 0]]
            b = number[faces[f, 1]]
            c = number[faces[f, 2]]
            point[f, 0] = a
            point[f, 1] = b
            point[f, 2] = c
            is_proper[f] = a != b and b != c and c != a
            for k in range(3 if is_proper[f] else 0):
                low = min(point[f, k], point[f, (k + 1) % 3])
                previous[3 * f + k] = last[share, low]
                last[share, low] = 3 * f + k


@kernel(nogil=True)
def pair_half_edges(corners, last, mate, first, end):
    """Find each half-edge's mate: the other half-edge at its edge, which runs the opposite way.

    A half-edge has no mate, and gets NOT_SHELL, if

    - its edge does not have exactly two half-edges,
    - the two run in the same direction, or their triangles have the same three corners,
    - or its lower point already has MAX_EDGES_OF_POINT other edges.

    Args:
        corners: points of the triangles, (3 m,) int32.
        last: the chains of `chain_edges`.
        mate: `previous` of `chain_edges`; receives the mates, (3 m,) int32.
        first, end: range of points; half-edges with their lower point in it are paired.
    """
    # of each edge at the point: its upper point, its first half-edge, its number of half-edges
    upper_point = np.empty(MAX_EDGES_OF_POINT, np.int32)
    first_half_edge = np.empty(MAX_EDGES_OF_POINT, np.int64)
    num_half_edges = np.empty(MAX_EDGES_OF_POINT, np.int64)
    for low in range(first, end):
        num_edges = 0
        for share in range(last.shape[0]):
            next_half_edge = np.int64(last[share, low])
            while next_half_edge >= 0:
                h = next_half_edge
                next_half_edge = np.int64(mate[h])
                mate[h] = NOT_SHELL
                high = max(corners[h], corners[_next(h)])
                e = 0
                while e < num_edges and upper_point[e] != high:
                    e += 1
                if e == MAX_EDGES_OF_POINT:
                    continue
                if e == num_edges:
                    upper_point[e] = high
                    first_half_edge[e] = h
                    num_half_edges[e] = 0
                    num_edges += 1
                partner = first_half_edge[e]
                num_half_edges[e] = num_half_edges[e] + 1
                if num_half_edges[e] == 2:
                    is_opposite = corners[partner] != corners[h]
                    third_corner = corners[_next(_next(h))]
                    if is_opposite and corners[_next(_next(partner))] != third_corner:
                        mate[partner] = h
                        mate[h] = partner
                elif num_half_edges[e] == 3 and mate[partner] != NOT_SHELL:
                    mate[mate[partner]] = NOT_SHELL
                    mate[partner] = NOT_SHELL


@kernel
def label_shells(mate, shell):
    """Find the shells: triangles that are connected over mates, and whose half-edges all have one.

    Args:
        mate: see `pair_half_edges`, (3 m,) int32.
        shell: receives, for each triangle, the lowest triangle of its shell, or NOT_SHELL, (m,)
            int32.
    """
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
