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
def _coordinate_bits(point_bits, point, axis):
    """Return the bits of a point's coordinate along an axis; for -0.0, the bits of 0.0."""
    return np.uint64(0) if point_bits[point, axis] == MINUS_ZERO else point_bits[point, axis]


@subkernel(inline="always")
def _are_equal(point_bits, first_point, second_point):
    """Return whether two points are at the same place."""
    is_equal = True
    for k in range(3):
        is_equal &= _coordinate_bits(point_bits, first_point, k) == _coordinate_bits(
            point_bits, second_point, k
        )
    return is_equal


@subkernel(inline="always")
def _hash_point(point_bits, point):
    """Return the hash of a point's coordinates (FNV-1a), uint64."""
    point_hash = np.uint64(1469598103934665603)
    for k in range(3):
        point_hash = (point_hash ^ _coordinate_bits(point_bits, point, k)) * np.uint64(
            1099511628211
        )
        point_hash ^= point_hash >> np.uint64(29)
    return point_hash


@subkernel(inline="always")
def _filter_bit(point_hash, filter_size):
    """Return the index of a byte of a filter, and the bit in it, that stand for a hash."""
    bit_index = point_hash & np.uint64(8 * filter_size - 1)
    return np.int64(bit_index >> np.uint64(3)), np.uint8(1 << np.int64(bit_index & np.uint64(7)))


@kernel(nogil=True)
def weld_points(point_bits, num_chunks, welded_point, first_chunk, end_chunk):
    """Weld the points at one place: each gets the index of the first point at its place.

    Points are divided into chunks by their hashes, so that several threads work side by side. Each
    chunk has its own filter and its own hash table with open addressing.

    Args:
        point_bits: x, y and z of each point: the bits of float64 numbers, read as integers, (n, 3)
            uint64.
        num_chunks: number of chunks.
        welded_point: receives, for each point, the index of the first point at its place, (n,)
            int32.
        first_chunk: number of the first chunk to work on.
        end_chunk: number past the last one.
    """
    num_points = point_bits.shape[0]
    num_chunks_unsigned = np.uint64(num_chunks)
    for chunk in range(first_chunk, end_chunk):
        chunk_points = np.empty(num_points + 1, np.int32)
        num_chunk_points = 0
        for i in range(num_points):
            chunk_points[num_chunk_points] = i  # without a branch, which the CPU could not predict
            num_chunk_points += (
                1
                if (_hash_point(point_bits, i) >> np.uint64(40)) * num_chunks_unsigned
                >> np.uint64(24)
                == chunk
                else 0
            )
        filter_size = 16
        while filter_size < num_chunk_points:  # 8 bits a point
            filter_size *= 2
        seen_once_filter = np.zeros(filter_size, np.uint8)
        seen_twice_filter = np.zeros(filter_size, np.uint8)
        for i in chunk_points[:num_chunk_points]:
            byte_index, bit_mask = _filter_bit(_hash_point(point_bits, i), filter_size)
            seen_twice_filter[byte_index] |= seen_once_filter[byte_index] & bit_mask
            seen_once_filter[byte_index] |= bit_mask
        num_candidates = 0
        for i in chunk_points[:num_chunk_points]:
            welded_point[i] = i
            byte_index, bit_mask = _filter_bit(_hash_point(point_bits, i), filter_size)
            if seen_twice_filter[byte_index] & bit_mask:
                chunk_points[num_candidates] = i
                num_candidates += 1
        table_size = 16
        while table_size < 2 * num_candidates:  # at most half full, so that probing stays short
            table_size *= 2
        hash_table = np.full(table_size, np.int32(-1), np.int32)
        for i in chunk_points[:num_candidates]:
            slot = np.int64(_hash_point(point_bits, i) & np.uint64(table_size - 1))
            while hash_table[slot] >= 0 and not _are_equal(point_bits, hash_table[slot], i):
                slot = (slot + 1) & (table_size - 1)
            if hash_table[slot] < 0:
                hash_table[slot] = i
            welded_point[i] = hash_table[slot]


@subkernel(inline="always")
def _next_half_edge(half_edge):
    """Return the next half-edge of the same triangle."""
    return half_edge - 2 if half_edge % 3 == 2 else half_edge + 1


@kernel(nogil=True, **NO_REFCOUNT)
def chain_edges(
    point_of_vertex,
    faces,
    corner_points,
    has_three_points,
    last_half_edge,
    previous_half_edge,
    first_chunk,
    end_chunk,
):
    """Chain the half-edges that have the same lower point: each refers to the one before it.

    The lower point of a half-edge is that of its two ends that has the lower number. Triangles are
    divided into chunks, each with its own chains, so that several threads work side by side. This
    is done for the chunks ``range(first_chunk, end_chunk)``.

    Args:
        point_of_vertex: the point of each vertex, see `weld_points`, (n,) int32.
        faces: vertices of each triangle, (m, 3) int32.
        corner_points: receives the points of each triangle, (m, 3) int32.
        has_three_points: receives whether a triangle has three different points, (m,) bool; the
            half-edges of other triangles are in no chain.
        last_half_edge: -1 everywhere; ``last_half_edge[chunk, lower_point]`` receives the last
            half-edge in the chain of point `lower_point`, (chunks, n) int32.
        previous_half_edge: receives the half-edge before each half-edge in its chain, -1 for none,
            (3 m,) int32.
        first_chunk: number of the first chunk to work on.
        end_chunk: number past the last one.
    """
    num_faces = faces.shape[0]
    num_chunks = last_half_edge.shape[0]
    for chunk in range(first_chunk, end_chunk):
        for face in range(num_faces * chunk // num_chunks, num_faces * (chunk + 1) // num_chunks):
            point_a = point_of_vertex[faces[face, 0]]
            point_b = point_of_vertex[faces[face, 1]]
            point_c = point_of_vertex[faces[face, 2]]
            corner_points[face, 0] = point_a
            corner_points[face, 1] = point_b
            corner_points[face, 2] = point_c
            has_three_points[face] = (
                point_a != point_b and point_b != point_c and point_c != point_a
            )
            for k in range(3 if has_three_points[face] else 0):
                lower_point = min(corner_points[face, k], corner_points[face, (k + 1) % 3])
                previous_half_edge[3 * face + k] = last_half_edge[chunk, lower_point]
                last_half_edge[chunk, lower_point] = 3 * face + k


@kernel(nogil=True)
def pair_half_edges(point_of_corner, last_half_edge, mate_of_half_edge, first_point, end_point):
    """Find each half-edge's mate: the other half-edge at its edge, which runs the opposite way.

    A half-edge has no mate, and gets NOT_SHELL, if

    - its edge does not have exactly two half-edges,
    - the two run in the same direction, or their triangles have the same three corners,
    - or its lower point already has MAX_EDGES_OF_POINT other edges.

    Args:
        point_of_corner: points of the triangles, (3 m,) int32.
        last_half_edge: the chains of `chain_edges`.
        mate_of_half_edge: `previous_half_edge` of `chain_edges`; receives the mates, (3 m,) int32.
        first_point: the first point; half-edges whose lower point lies in the range are paired.
        end_point: the number past the last point.
    """
    # of each edge at the point: its upper point, its first half-edge, its number of half-edges
    upper_point = np.empty(MAX_EDGES_OF_POINT, np.int32)
    first_half_edge = np.empty(MAX_EDGES_OF_POINT, np.int64)
    num_half_edges = np.empty(MAX_EDGES_OF_POINT, np.int64)
    for lower_point in range(first_point, end_point):
        num_edges = 0
        for chunk in range(last_half_edge.shape[0]):
            next_half_edge = np.int64(last_half_edge[chunk, lower_point])
            while next_half_edge >= 0:
                half_edge = next_half_edge
                next_half_edge = np.int64(mate_of_half_edge[half_edge])
                mate_of_half_edge[half_edge] = NOT_SHELL
                higher_point = max(
                    point_of_corner[half_edge], point_of_corner[_next_half_edge(half_edge)]
                )
                edge = 0
                while edge < num_edges and upper_point[edge] != higher_point:
                    edge += 1
                if edge == MAX_EDGES_OF_POINT:
                    continue
                if edge == num_edges:
                    upper_point[edge] = higher_point
                    first_half_edge[edge] = half_edge
                    num_half_edges[edge] = 0
                    num_edges += 1
                partner = first_half_edge[edge]
                num_half_edges[edge] = num_half_edges[edge] + 1
                if num_half_edges[edge] == 2:
                    is_opposite = point_of_corner[partner] != point_of_corner[half_edge]
                    third_corner = point_of_corner[_next_half_edge(_next_half_edge(half_edge))]
                    if (
                        is_opposite
                        and point_of_corner[_next_half_edge(_next_half_edge(partner))]
                        != third_corner
                    ):
                        mate_of_half_edge[partner] = half_edge
                        mate_of_half_edge[half_edge] = partner
                elif num_half_edges[edge] == 3 and mate_of_half_edge[partner] != NOT_SHELL:
                    mate_of_half_edge[mate_of_half_edge[partner]] = NOT_SHELL
                    mate_of_half_edge[partner] = NOT_SHELL


@kernel
def label_shells(mate_of_half_edge, shell_of_face):
    """Find the shells: triangles that mates connect, and whose half-edges all have a mate.

    Args:
        mate_of_half_edge: the other half-edge at each half-edge's edge, NOT_SHELL for none, see
            `pair_half_edges`, (3 m,) int32.
        shell_of_face: receives, for each triangle, the lowest index of a triangle of its shell, or
            NOT_SHELL, (m,) int32.
    """
    is_shell = np.ones(shell_of_face.shape[0], np.bool_)
    for face in range(shell_of_face.shape[0]):
        shell_of_face[face] = face
        for k in range(3):
            half_edge = np.int64(mate_of_half_edge[3 * face + k])
            if half_edge == NOT_SHELL:
                is_shell[face] = False
            elif half_edge // 3 < face:
                unite(shell_of_face, np.int64(face), half_edge // 3)
    for face in range(shell_of_face.shape[0]):
        shell_of_face[face] = find_root(shell_of_face, np.int64(face))
        if not is_shell[face]:
            is_shell[shell_of_face[face]] = False
    for face in range(shell_of_face.shape[0]):
        if not is_shell[shell_of_face[face]]:
            shell_of_face[face] = NOT_SHELL
