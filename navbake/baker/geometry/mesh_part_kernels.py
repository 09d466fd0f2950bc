"""Find the closed parts of meshes: the triangles that enclose something, without open surfaces.

1. `_remove_open_surfaces` removes triangles with a bare edge, at which no other triangle ends,
   until there is none: nothing is left of an open surface, but all of a closed one.
2. `_find_patches` divides the rest into manifold patches, by a flood over the edges at which two
   triangles meet, and finds the triangles that face the other way; `_flip_minority` flips them (Ju,
   Robust repair of polygonal models, 2004, section 2, lists the faults of meshes).
3. `_drop_membranes` drops patches that lie across the inside of a closed surface.
4. `_unite_patches` unites the patches that close a surface together. A part is closed if its
   triangles run along each edge as often in one direction as in the other.

A half-edge is one side of a triangle. Half-edge ``3 f + k`` runs from corner k of triangle f to the
next corner. The half-edges at edge e are ``half_edges[edge_start[e] : edge_start[e + 1]]``. Two
half-edges at one edge that run in opposite directions are partners.
"""

import numpy as np

from navbake.baker.core.union_find import find_root, unite
from navbake.compiled import kernel, subkernel

# Values in place of the number of a triangle's closed part
NO_CLOSED_PART = np.int32(-1)  # the triangle is in no closed part
DUPLICATE = np.int32(-2)  # an earlier triangle has the same corners


@subkernel(inline="always")
def _opposite_corner(faces, half_edge):
    """Return the corner of a triangle that lies opposite to a half-edge: the number of its point.

    `faces` are the points of each triangle's corners, (m, 3).
    """
    return faces[half_edge // 3, (half_edge % 3 + 2) % 3]


@subkernel(inline="always")
def _half_edge_direction(faces, is_flipped, half_edge):
    """Return 1 if a half-edge runs up, from the point with the lower number to the other, else -1.

    `faces` are the points of each triangle's corners. Half-edges of flipped triangles run the other
    way.
    """
    face = half_edge // 3
    k = half_edge % 3
    runs_up = faces[face, k] < faces[face, (k + 1) % 3]
    return 1 if runs_up != is_flipped[face] else -1


@subkernel(inline="always")
def _sort_keys(keys, num_keys):
    """Sort the first `num_keys` keys, ascending, in place, by Shell's sort."""
    gap = 1
    while gap < num_keys // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, num_keys):
            key = keys[i]
            j = i
            while j >= gap and keys[j - gap] > key:
                keys[j] = keys[j - gap]
                j -= gap
            keys[j] = key
        gap //= 3


@subkernel
def _list_edges(faces, num_points):
    """List the half-edges of a mesh, edge by edge.

    Half-edges are collected by the lower number of their two points (counting sort), then sorted by
    the higher number.

    Args:
        faces: the points of each triangle's corners, (m, 3) int32.
        num_points: how many points there are.

    Returns:
        edge_start: edge e has the half-edges ``half_edges[edge_start[e] : edge_start[e + 1]]``,
            (edges + 1,) int32.
        half_edges: the half-edges, ascending for each edge, (3 m,) int32.
    """
    next_entry_of_point = np.zeros(num_points, np.int32)
    half_edges = np.empty(3 * faces.shape[0], np.int32)
    for is_writing in (False, True):
        for face in range(faces.shape[0]):
            for k in range(3):
                lower_point = min(faces[face, k], faces[face, (k + 1) % 3])
                if is_writing:
                    half_edges[next_entry_of_point[lower_point]] = 3 * face + k
                next_entry_of_point[lower_point] += 1
        if (
            not is_writing
        ):  # set to where each point's list begins; writing moves it to the list's end
            num_entries_before = np.int32(0)
            for lower_point in range(num_points):
                num_half_edges_at_point = next_entry_of_point[lower_point]
                next_entry_of_point[lower_point] = num_entries_before
                num_entries_before += num_half_edges_at_point
    edge_start = np.empty(half_edges.shape[0] + 1, np.int32)
    keys = np.empty(16, np.int64)
    first_entry = np.int32(0)
    num_edges = 0
    for lower_point in range(num_points):
        num_half_edges_at_point = next_entry_of_point[lower_point] - first_entry
        if num_half_edges_at_point > keys.shape[0]:
            keys = np.empty(2 * num_half_edges_at_point, np.int64)
        for i in range(num_half_edges_at_point):
            half_edge = half_edges[first_entry + i]
            higher_point = max(
                faces[half_edge // 3, half_edge % 3], faces[half_edge // 3, (half_edge % 3 + 1) % 3]
            )
            keys[i] = (np.int64(higher_point) << 32) | half_edge
        _sort_keys(keys, num_half_edges_at_point)
        for i in range(num_half_edges_at_point):
            if i == 0 or keys[i] >> 32 != keys[i - 1] >> 32:
                edge_start[num_edges] = first_entry + i
                num_edges += 1
            half_edges[first_entry + i] = keys[i] & 0xFFFFFFFF
        first_entry = next_entry_of_point[lower_point]
    edge_start[num_edges] = half_edges.shape[0]
    return edge_start[: num_edges + 1], half_edges


@subkernel(inline="always")
def _mark_duplicates(faces, edge_start, half_edges, part_of_face):
    """Mark duplicates: triangles with the corners of an earlier triangle, in the same cyclic order.

    `part_of_face` receives DUPLICATE for each of them.
    """
    keys = np.empty(16, np.int64)
    for edge in range(edge_start.shape[0] - 1):
        if edge_start[edge + 1] - edge_start[edge] > keys.shape[0]:
            keys = np.empty(2 * (edge_start[edge + 1] - edge_start[edge]), np.int64)
        num_keys = 0
        for half_edge in half_edges[edge_start[edge] : edge_start[edge + 1]]:
            face = half_edge // 3
            k = half_edge % 3
            first_corner = faces[face, k]
            second_corner = faces[face, (k + 1) % 3]
            third_corner = _opposite_corner(faces, half_edge)
            # each triangle counts at one edge only: the one behind its lowest corner
            if first_corner < second_corner and first_corner < third_corner:
                keys[num_keys] = (np.int64(third_corner) << 32) | face
                num_keys += 1
        if num_keys > 1:
            _sort_keys(keys, num_keys)
        for i in range(1, num_keys):
            if keys[i] >> 32 == keys[i - 1] >> 32:
                part_of_face[keys[i] & 0xFFFFFFFF] = DUPLICATE


@subkernel(inline="always")
def _is_bare(faces, edge, edge_start, half_edges, num_faces_at_edge, is_remaining):
    """Return whether an edge is bare: one triangle remains at it, or two with the same corners.

    `is_remaining` says which triangles of the mesh are not removed yet; `num_faces_at_edge` is the
    number of these at each edge.
    """
    if num_faces_at_edge[edge] == 1:
        return True
    if num_faces_at_edge[edge] != 2:
        return False
    opposite_corner = np.int64(-1)
    for half_edge in half_edges[edge_start[edge] : edge_start[edge + 1]]:
        if is_remaining[half_edge // 3]:
            if opposite_corner >= 0:
                return _opposite_corner(faces, half_edge) == opposite_corner
            opposite_corner = _opposite_corner(faces, half_edge)
    return False


@subkernel(inline="always")
def _remove_at_edge(edge, edge_start, half_edges, is_remaining, queue, queue_end):
    """Remove the remaining triangles at an edge, and append them to a queue.

    `is_remaining` becomes False for them. Returns the index past the last entry of the queue.
    """
    for half_edge in half_edges[edge_start[edge] : edge_start[edge + 1]]:
        if is_remaining[half_edge // 3]:
            is_remaining[half_edge // 3] = False
            queue[queue_end] = half_edge // 3
            queue_end += 1
    return queue_end


@subkernel
def _remove_open_surfaces(faces, edge_of_half_edge, edge_start, half_edges, is_remaining):
    """Remove triangles with a bare edge, at which no other triangle ends, until there is none.

    So all of an open surface is removed. `is_remaining` becomes False for the removed triangles.
    Returns the number of remaining triangles at each edge, int32.
    """
    num_faces_at_edge = np.zeros(edge_start.shape[0] - 1, np.int32)
    for half_edge in range(edge_of_half_edge.shape[0]):
        if is_remaining[half_edge // 3]:
            num_faces_at_edge[edge_of_half_edge[half_edge]] += 1
    queue = np.empty(faces.shape[0], np.int32)
    queue_end = 0
    queue_front = 0
    for edge in range(edge_start.shape[0] - 1):
        if num_faces_at_edge[edge] > 0 and _is_bare(
            faces, edge, edge_start, half_edges, num_faces_at_edge, is_remaining
        ):
            queue_end = _remove_at_edge(
                edge, edge_start, half_edges, is_remaining, queue, queue_end
            )
    # a removed triangle counts at its edges until its turn in the queue
    while queue_front < queue_end:
        face = queue[queue_front]
        queue_front += 1
        for k in range(3):
            edge = edge_of_half_edge[3 * face + k]
            num_faces_at_edge[edge] -= 1
            if num_faces_at_edge[edge] > 0 and _is_bare(
                faces, edge, edge_start, half_edges, num_faces_at_edge, is_remaining
            ):
                queue_end = _remove_at_edge(
                    edge, edge_start, half_edges, is_remaining, queue, queue_end
                )
    return num_faces_at_edge


@subkernel(inline="always")
def _find_neighbor_over_edge(edge, face, edge_start, half_edges, is_remaining):
    """Return a triangle's neighbor over an edge at which two triangles remain.

    Args:
        edge: the edge.
        face: the triangle.
        edge_start: where each edge's half-edges begin in `half_edges`, int32.
        half_edges: the half-edges of all edges, edge by edge, int32.
        is_remaining: which triangles remain, bool.

    Returns:
        The neighbor's half-edge at the edge, -1 if there is no neighbor.
    """
    for half_edge in half_edges[edge_start[edge] : edge_start[edge + 1]]:
        if is_remaining[half_edge // 3] and half_edge // 3 != face:
            return half_edge
    return np.int64(-1)


@subkernel
def _find_patches(
    faces, edge_of_half_edge, edge_start, half_edges, is_remaining, num_faces_at_edge
):
    """Number the manifold patches: triangles connected over edges where two triangles meet.

    Args:
        faces: the points of each triangle's corners, (m, 3) int32.
        edge_of_half_edge: the edge of each half-edge, (3 m,) int32.
        edge_start: where each edge's half-edges begin in `half_edges`, int32.
        half_edges: the half-edges of all edges, edge by edge, int32.
        is_remaining: which triangles are not removed, (m,) bool.
        num_faces_at_edge: how many of these are at each edge, int32.

    Returns:
        patch_of_face: the patch of each triangle, int32; -1 for removed triangles.
        patch_faces: the triangles of all patches, patch by patch, int32.
        patch_start: patch p is ``patch_faces[patch_start[p] : patch_start[p + 1]]``, int32.
        is_opposite: whether each triangle faces to the other side than the first triangle of its
            patch, bool.
    """
    num_faces = faces.shape[0]
    patch_of_face = np.full(num_faces, np.int32(-1), np.int32)
    is_opposite = np.zeros(num_faces, np.bool_)
    patch_faces = np.empty(num_faces, np.int32)  # also the queue of the flood
    patch_start = np.empty(num_faces + 1, np.int32)
    num_patches = 0
    queue_front = 0
    queue_end = 0
    for first_face in range(num_faces):
        if not is_remaining[first_face] or patch_of_face[first_face] >= 0:
            continue
        patch_start[num_patches] = queue_end
        patch_of_face[first_face] = num_patches
        patch_faces[queue_end] = first_face
        queue_end += 1
        while queue_front < queue_end:
            face = patch_faces[queue_front]
            queue_front += 1
            for k in range(3):
                edge = edge_of_half_edge[3 * face + k]
                if num_faces_at_edge[edge] != 2:
                    continue
                half_edge = _find_neighbor_over_edge(
                    edge, face, edge_start, half_edges, is_remaining
                )
                if half_edge < 0 or patch_of_face[half_edge // 3] >= 0:
                    continue
                patch_of_face[half_edge // 3] = num_patches
                # triangles that face the same way run along their shared edge in opposite
                # directions
                is_same_direction = _half_edge_direction(
                    faces, is_opposite, half_edge
                ) == _half_edge_direction(faces, is_opposite, 3 * face + k)
                is_opposite[half_edge // 3] = is_same_direction
                patch_faces[queue_end] = half_edge // 3
                queue_end += 1
        num_patches += 1
    patch_start[num_patches] = queue_end
    return patch_of_face, patch_faces, patch_start[: num_patches + 1].copy(), is_opposite


@subkernel(inline="always")
def _flip_minority(area, patch_faces, patch_start, is_opposite, is_flipped):
    """Flip triangles so that a patch faces to one side: the one that most of its area faces.

    Args:
        area: area of each triangle, float64 [m²].
        patch_faces: the triangles of all patches, see `_find_patches`.
        patch_start: where each patch begins in `patch_faces`.
        is_opposite: whether each triangle faces to the other side than the first triangle of its
            patch.
        is_flipped: receives which triangles are flipped.
    """
    for patch_index in range(patch_start.shape[0] - 1):
        same_area = 0.0
        opposite_area = 0.0
        for face in patch_faces[patch_start[patch_index] : patch_start[patch_index + 1]]:
            if is_opposite[face]:
                opposite_area += area[face]
            else:
                same_area += area[face]
        if abs(same_area - opposite_area) <= 1e-9 * (same_area + opposite_area):
            continue  # undecided: nothing is flipped
        for face in patch_faces[patch_start[patch_index] : patch_start[patch_index + 1]]:
            is_flipped[face] = is_opposite[face] != (opposite_area > same_area)


@subkernel(inline="always")
def _remove_from_balance(
    faces, edge_of_half_edge, face, num_faces_at_edge, is_flipped, edge_balance, sign
):
    """Remove a triangle from the balances of its edges (`sign` 1), or add it to them (-1).

    The balance of an edge is how many of its half-edges run up, less how many run down, see
    `_half_edge_direction`; its absolute value is the number of half-edges without a partner. Only
    edges at which more than two triangles meet are changed.

    Returns:
        By how much the number of half-edges without a partner falls.
    """
    num_unpaired_removed = 0
    for k in range(3):
        edge = edge_of_half_edge[3 * face + k]
        if num_faces_at_edge[edge] > 2:
            num_unpaired_before = abs(edge_balance[edge])
            edge_balance[edge] -= sign * _half_edge_direction(faces, is_flipped, 3 * face + k)
            num_unpaired_removed += num_unpaired_before - abs(edge_balance[edge])
    return num_unpaired_removed


@subkernel(inline="always")
def _drop_membranes(
    faces,
    area,
    edge_of_half_edge,
    num_faces_at_edge,
    patch_faces,
    patch_start,
    is_flipped,
    is_remaining,
):
    """Drop membranes: patches without which fewer half-edges have no partner, the smallest first.

    A membrane is, for example, a wall without thickness across the inside of a block.
    `is_remaining` becomes False for the triangles of dropped patches. Returns whether any patch was
    dropped.
    """
    # for each edge: how many of its half-edges run up, less how many run down, see
    # `_half_edge_direction`
    edge_balance = np.zeros(num_faces_at_edge.shape[0], np.int32)
    patch_area = np.zeros(patch_start.shape[0] - 1)
    for patch_index in range(patch_start.shape[0] - 1):
        for face in patch_faces[patch_start[patch_index] : patch_start[patch_index + 1]]:
            patch_area[patch_index] += area[face]
            for k in range(3):
                edge_balance[edge_of_half_edge[3 * face + k]] += _half_edge_direction(
                    faces, is_flipped, 3 * face + k
                )
    is_any_dropped = False
    for patch_index in np.argsort(patch_area, kind="mergesort"):
        num_unpaired_removed = 0
        for face in patch_faces[patch_start[patch_index] : patch_start[patch_index + 1]]:
            num_unpaired_removed += _remove_from_balance(
                faces, edge_of_half_edge, face, num_faces_at_edge, is_flipped, edge_balance, 1
            )
        for face in patch_faces[patch_start[patch_index] : patch_start[patch_index + 1]]:
            if num_unpaired_removed > 0:
                is_remaining[face] = False
            else:
                _remove_from_balance(
                    faces, edge_of_half_edge, face, num_faces_at_edge, is_flipped, edge_balance, -1
                )
        is_any_dropped |= num_unpaired_removed > 0
    return is_any_dropped


@subkernel
def _unite_patches(
    faces, edge_start, half_edges, is_remaining, patch_of_face, is_flipped, num_patches
):
    """Unite the patches that meet at an edge at which each has half-edges without a partner.

    Returns:
        parent: the parent of each patch, see `find_root`; united patches have the same root.
        is_open: for each root, whether its patches together leave a half-edge without a partner.
    """
    parent = np.arange(num_patches)
    is_open = np.zeros(num_patches, np.bool_)
    patch_balance = np.zeros(num_patches, np.int64)  # of each patch at one edge
    for sweep in range(2):  # first unite, then find open edges
        for edge in range(edge_start.shape[0] - 1):
            edge_balance = 0
            for half_edge in half_edges[edge_start[edge] : edge_start[edge + 1]]:
                if is_remaining[half_edge // 3]:
                    edge_balance += _half_edge_direction(faces, is_flipped, half_edge)
                    patch_balance[patch_of_face[half_edge // 3]] += _half_edge_direction(
                        faces, is_flipped, half_edge
                    )
            previous_patch = np.int64(-1)
            for half_edge in half_edges[edge_start[edge] : edge_start[edge + 1]]:
                if (
                    is_remaining[half_edge // 3]
                    and patch_balance[patch_of_face[half_edge // 3]] != 0
                ):
                    if sweep == 0 and previous_patch >= 0:
                        unite(parent, previous_patch, patch_of_face[half_edge // 3])
                    if sweep == 1 and edge_balance != 0:
                        is_open[find_root(parent, patch_of_face[half_edge // 3])] = True
                    previous_patch = patch_of_face[half_edge // 3]
            for half_edge in half_edges[edge_start[edge] : edge_start[edge + 1]]:
                if is_remaining[half_edge // 3]:
                    patch_balance[patch_of_face[half_edge // 3]] = 0
    return parent, is_open


@kernel
def find_parts(faces, area, num_points):
    """Find the closed parts of a mesh: connected triangles that have no open edge.

    Args:
        faces: the three different points of each triangle, (m, 3) int32.
        area: area of each triangle, (m,) float64 [m²].
        num_points: number of points; points are numbered from 0.

    Returns:
        part_of_face: for each triangle, the lowest index of a triangle of its closed part;
            NO_CLOSED_PART or DUPLICATE; (m,) int32.
        is_flipped: whether a triangle of a closed part faces to the other side than most of its
            patch, (m,) bool.
    """
    num_faces = faces.shape[0]
    part_of_face = np.full(num_faces, NO_CLOSED_PART, np.int32)
    is_flipped = np.zeros(num_faces, np.bool_)
    if num_faces == 0:
        return part_of_face, is_flipped
    edge_start, half_edges = _list_edges(faces, num_points)
    edge_of_half_edge = np.empty(half_edges.shape[0], np.int32)
    for edge in range(edge_start.shape[0] - 1):
        for half_edge in half_edges[edge_start[edge] : edge_start[edge + 1]]:
            edge_of_half_edge[half_edge] = edge
    _mark_duplicates(faces, edge_start, half_edges, part_of_face)
    is_remaining = part_of_face == NO_CLOSED_PART
    while True:  # dropping a membrane joins the patches at its rim, so patches are found again
        num_faces_at_edge = _remove_open_surfaces(
            faces, edge_of_half_edge, edge_start, half_edges, is_remaining
        )
        patch_of_face, patch_faces, patch_start, is_opposite = _find_patches(
            faces, edge_of_half_edge, edge_start, half_edges, is_remaining, num_faces_at_edge
        )
        is_flipped[:] = False
        _flip_minority(area, patch_faces, patch_start, is_opposite, is_flipped)
        if not _drop_membranes(
            faces,
            area,
            edge_of_half_edge,
            num_faces_at_edge,
            patch_faces,
            patch_start,
            is_flipped,
            is_remaining,
        ):
            break
    num_patches = patch_start.shape[0] - 1
    parent, is_open = _unite_patches(
        faces, edge_start, half_edges, is_remaining, patch_of_face, is_flipped, num_patches
    )
    lowest_face_of_root = np.full(num_patches, np.int64(-1))
    for face in range(num_faces):
        if is_remaining[face]:
            root = find_root(parent, patch_of_face[face])
            if is_open[root]:
                continue
            if lowest_face_of_root[root] < 0:
                lowest_face_of_root[root] = face
            part_of_face[face] = lowest_face_of_root[root]
    return part_of_face, is_flipped & (part_of_face >= 0)
