"""Split meshes into connected parts, and decide what each part encloses."""

from __future__ import annotations

import numpy as np

from navbake.baker.core.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.geometry.mesh_part_kernels import DUPLICATE, find_parts
from navbake.baker.geometry.shapes import (
    MIN_ITEMS_PER_CHUNK,
    GeomTriangles,
    choose_num_chunks,
    triangle_areas,
)
from navbake.baker.geometry.shell_kernels import (
    NOT_SHELL,
    chain_edges,
    label_shells,
    pair_half_edges,
    weld_points,
)
from navbake.baker.geometry.triangle_kernels import bound_parts, measure_part_volumes
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# A part whose volume is less than this times its area encloses nothing: it is a sheet with two
# sides [m]
MIN_THICKNESS = 1e-6
# At most this many pairs of a triangle and a point are tested at a time
MAX_PAIRS_AT_ONCE = 1 << 20


def split_mesh(vertices: Float, faces: Int | Int32) -> GeomTriangles:
    """Separate the parts of a mesh that enclose a volume from its open surfaces.

    Parts are connected over edges; vertices at one place count as one vertex. A part is closed if
    its triangles run along each edge as often in one direction as in the other. A closed part that
    faces out encloses a volume. A closed part that faces in bounds a cavity if it lies inside of a
    part that faces out, and then counts as enclosing, too. By itself it is a room drawn from
    inside, and encloses nothing. A closed part stays closed if stray triangles touch it, or if a
    membrane lies across its inside.

    In closed parts, a triangle that faces to the other side than most triangles around it is
    flipped, see `mesh_part_kernels`. Left out are duplicates of triangles, and triangles with two
    corners at one place.

    Args:
        vertices: shape (n, 3) [m].
        faces: vertices of each triangle, counter-clockwise from the front, shape (m, 3).

    Returns:
        The triangles, with their parts and what these enclose.
    """
    triangles, corner_points, part_of_triangle = _find_shells(
        vertices, np.ascontiguousarray(faces, dtype=np.int32)
    )
    is_flipped = np.zeros(len(triangles), dtype=np.bool_)
    is_no_shell = part_of_triangle == NOT_SHELL
    if is_no_shell.any():
        candidate_triangles = np.flatnonzero(is_no_shell)  # they are connected to no shell
        part_of_candidate, is_candidate_flipped = find_parts(
            corner_points[candidate_triangles],
            triangle_areas(vertices, triangles[candidate_triangles]),
            len(vertices),
        )
        is_flipped[candidate_triangles] = is_candidate_flipped
        # the lowest triangle of each part, by its index among all
        is_closed = part_of_candidate >= 0
        part_of_triangle[candidate_triangles] = np.where(
            is_closed, candidate_triangles[part_of_candidate], part_of_candidate
        )
    del corner_points, is_no_shell
    is_unique = part_of_triangle != DUPLICATE
    # closed parts are numbered from 1 by their lowest triangles; open surfaces are 0
    lowest_triangles = np.flatnonzero(
        part_of_triangle == np.arange(len(part_of_triangle), dtype=np.int32)
    )
    num_parts = len(lowest_triangles)
    part_number_of_lowest = np.empty(len(part_of_triangle), dtype=np.int32)
    part_number_of_lowest[lowest_triangles] = np.arange(1, num_parts + 1)

    def number_parts(first_triangle: int, end_triangle: int) -> None:
        lowest_triangle = part_of_triangle[first_triangle:end_triangle]
        part_of_triangle[first_triangle:end_triangle] = np.where(
            lowest_triangle < 0, 0, part_number_of_lowest[lowest_triangle]
        )

    run_in_chunks(number_parts, len(part_of_triangle), min_chunk_size=MIN_ITEMS_PER_CHUNK)
    if not is_unique.all():
        triangles = triangles[is_unique]
        part_of_triangle = part_of_triangle[is_unique]
        is_flipped = is_flipped[is_unique]
    is_enclosing = _find_enclosing(vertices, triangles, is_flipped, part_of_triangle, num_parts)
    new_part_number = np.where(is_enclosing, np.cumsum(is_enclosing), 0).astype(np.int32)
    closed_code = np.empty(len(triangles), dtype=np.uint8)
    code_of_part = np.where(is_enclosing, CLOSED_SURFACE, OPEN_SURFACE).astype(np.uint8)

    def renumber_parts(first_triangle: int, end_triangle: int) -> None:
        np.take(
            code_of_part,
            part_of_triangle[first_triangle:end_triangle],
            out=closed_code[first_triangle:end_triangle],
            mode="clip",
        )
        np.take(
            new_part_number,
            part_of_triangle[first_triangle:end_triangle],
            out=part_of_triangle[first_triangle:end_triangle],
            mode="clip",
        )

    run_in_chunks(renumber_parts, len(triangles), min_chunk_size=MIN_ITEMS_PER_CHUNK)
    is_flipped &= part_of_triangle > 0
    if is_flipped.any():
        triangles = np.where(is_flipped[:, None], triangles[:, ::-1], triangles)
    num_closed = np.count_nonzero(part_of_triangle)
    num_flipped = np.count_nonzero(is_flipped)
    description = (
        "closed surface" if num_closed == len(part_of_triangle) else "partly closed surface"
    )
    description += f", {num_flipped} turned" if num_flipped else ""
    return GeomTriangles(
        vertices, triangles, part_of_triangle, closed_code, description if num_closed else "surface"
    )


def _find_shells(vertices: Float, faces: Int32) -> tuple[Int32, Int32, Int32]:
    """Find the shells of a mesh: connected parts in which exactly two triangles meet at each edge.

    Args:
        vertices: shape (n, 3) [m].
        faces: vertices of each triangle, shape (k, 3).

    Returns:
        The triangles whose corners are at three places, as vertices, (m, 3); their corners as
        points, (m, 3), where a point is the index of the first vertex at its place; and for each
        triangle the lowest triangle of its shell, or NOT_SHELL, (m,).
    """
    coordinate_bits = np.ascontiguousarray(vertices, dtype=np.float64).view(np.uint64)
    point_of_vertex = np.empty(len(coordinate_bits), dtype=np.int32)
    num_chunks = choose_num_chunks(len(coordinate_bits))
    run_in_chunks(weld_points, num_chunks, coordinate_bits, num_chunks, point_of_vertex)
    while True:
        corner_points = np.empty_like(faces)
        has_three_points = np.empty(len(faces), dtype=np.bool_)
        mate_of_half_edge = np.empty(3 * len(faces), dtype=np.int32)
        num_chunks = choose_num_chunks(len(faces))
        last_half_edges = np.full((num_chunks, len(coordinate_bits)), -1, dtype=np.int32)
        run_in_chunks(
            chain_edges,
            num_chunks,
            point_of_vertex,
            faces,
            corner_points,
            has_three_points,
            last_half_edges,
            mate_of_half_edge,
        )
        if has_three_points.all():
            break
        faces = faces[has_three_points]
    run_in_chunks(
        pair_half_edges,
        len(coordinate_bits),
        corner_points.reshape(-1),
        last_half_edges,
        mate_of_half_edge,
        min_chunk_size=MIN_ITEMS_PER_CHUNK,
    )
    shell_of_triangle = np.empty(len(faces), dtype=np.int32)
    label_shells(mate_of_half_edge, shell_of_triangle)
    return faces, corner_points, shell_of_triangle


def _find_enclosing(
    vertices: Float, faces: Int32, is_flipped: Bool, part_of_triangle: Int32, num_parts: int
) -> Bool:
    """Mark the closed parts that enclose a volume, see `split_mesh`.

    Args:
        vertices: shape (n, 3) [m].
        faces: vertices of each triangle, shape (m, 3).
        is_flipped: which triangles count as facing the other way, shape (m,).
        part_of_triangle: the closed part of each triangle, from 1; 0 for none, shape (m,).
        num_parts: how many closed parts there are.

    Returns:
        A mask by number of the part, shape (num_parts + 1,); parts count from 1, entry 0 is False.
    """
    is_enclosing = np.zeros(num_parts + 1, dtype=np.bool_)
    if num_parts == 0:
        return is_enclosing
    volume = np.zeros(num_parts + 1)
    area = np.zeros(num_parts + 1)
    min_parts_per_call = -(
        -num_parts // choose_num_chunks(len(faces))
    )  # a call visits all triangles
    run_in_chunks(
        measure_part_volumes,
        num_parts,
        vertices,
        faces,
        is_flipped,
        part_of_triangle,
        volume,
        area,
        min_chunk_size=min_parts_per_call,
        begin=1,
    )
    is_enclosing[1:] = volume[1:] > MIN_THICKNESS * area[1:]
    inward_parts = np.flatnonzero(volume < -MIN_THICKNESS * area)
    if not len(inward_parts) or not is_enclosing.any():
        return is_enclosing

    # inward parts that lie inside of outward ones are cavities
    part_boxes = np.repeat([[np.inf] * 3 + [-np.inf] * 3], num_parts + 1, axis=0)
    largest_area = np.full(num_parts + 1, -1.0)
    largest_triangle = np.zeros(num_parts + 1, dtype=np.int64)
    bound_parts(
        vertices, faces, is_flipped, part_of_triangle, part_boxes, largest_area, largest_triangle
    )
    outward_triangles = np.flatnonzero(is_enclosing[part_of_triangle])
    outward_faces = faces[outward_triangles]
    outward_faces = np.where(
        is_flipped[outward_triangles, None], outward_faces[:, ::-1], outward_faces
    )
    origin = vertices[faces[0, 0]]
    inner_points = (vertices[faces[largest_triangle[inward_parts]]] - origin).mean(axis=1)
    outer_part, point_index = _find_surrounding(
        vertices[outward_faces] - origin, part_of_triangle[outward_triangles], inner_points
    )
    inner_part = inward_parts[point_index]
    is_inside = (part_boxes[outer_part, :3] <= part_boxes[inner_part, :3]).all(axis=1)
    is_inside &= (part_boxes[outer_part, 3:] >= part_boxes[inner_part, 3:]).all(axis=1)
    is_enclosing[inner_part[is_inside]] = True
    return is_enclosing


def _find_surrounding(corners: Float, part_of_triangle: Int32, points: Float) -> tuple[Int, Int]:
    """Find the parts that surround points, by winding numbers (Sunday, Inclusion of a point, 2001).

    A part surrounds a point if its triangles above the point wind around the vertical line more
    often counter-clockwise than clockwise.

    Args:
        corners: corners of triangles, shape (m, 3, 3) [m].
        part_of_triangle: the part of each triangle, shape (m,).
        points: points, shape (n, 3) [m].

    Returns:
        Pairs of a part and a point inside of it: the parts, and the indices of the points.
    """
    sort_indices = np.argsort(points[:, 0])
    x_min = corners[:, :, 0].min(axis=1)
    x_max = corners[:, :, 0].max(axis=1)
    first_point = np.searchsorted(points[sort_indices, 0], x_min)
    num_points_near = np.searchsorted(points[sort_indices, 0], x_max, side="right") - first_point
    pair_ends = np.cumsum(num_points_near)
    pair_ids = [np.empty(0, np.int64)]
    windings = [np.empty(0, np.int64)]
    batch_limits = np.searchsorted(
        pair_ends, np.arange(MAX_PAIRS_AT_ONCE, num_points_near.sum(), MAX_PAIRS_AT_ONCE)
    )
    for batch_triangles in np.split(np.arange(len(num_points_near)), batch_limits):
        num_pairs = num_points_near[batch_triangles]
        pair_triangles = np.repeat(batch_triangles, num_pairs)
        pair_to_point_offset = np.cumsum(num_pairs) - num_pairs - first_point[batch_triangles]
        point_index = sort_indices[
            np.arange(len(pair_triangles)) - np.repeat(pair_to_point_offset, num_pairs)
        ]
        winding = _find_windings_above(corners[pair_triangles], points[point_index])
        pair_id = part_of_triangle[pair_triangles].astype(np.int64) * len(points) + point_index
        pair_ids.append(pair_id[winding != 0])
        windings.append(winding[winding != 0])
    unique_ids, pair_index = np.unique(np.concatenate(pair_ids), return_inverse=True)
    total_winding = np.bincount(pair_index, np.concatenate(windings), len(unique_ids))
    surrounding_part, point_index = np.divmod(unique_ids[total_winding > 0], len(points))
    return surrounding_part, point_index


def _find_windings_above(corners: Float, points: Float) -> Int:
    """Return which way round a triangle above a point winds around it, for pairs of both.

    Args:
        corners: corners of n triangles, one for each point, shape (n, 3, 3) [m].
        points: the points, shape (n, 3) [m].

    Returns:
        Seen from above: 1 for counter-clockwise, -1 for clockwise, 0 if the triangle is not above
        the point; shape (n,).
    """
    x = points[:, :1]
    y = points[:, 1:2]
    start_x = corners[:, :, 0]
    start_y = corners[:, :, 1]
    end_x = np.roll(start_x, -1, axis=1)
    end_y = np.roll(start_y, -1, axis=1)
    # left of the edge from its lower end to its upper one, so that both triangles at an edge give
    # one answer
    is_reversed = ~((start_x < end_x) | ((start_x == end_x) & (start_y < end_y)))
    edge_x = np.where(is_reversed, start_x - end_x, end_x - start_x)
    edge_y = np.where(is_reversed, start_y - end_y, end_y - start_y)
    to_point_x = x - np.where(is_reversed, end_x, start_x)
    to_point_y = y - np.where(is_reversed, end_y, start_y)
    is_left = (edge_x * to_point_y - edge_y * to_point_x > 0) ^ is_reversed
    is_rising = (start_y <= y) & (end_y > y) & is_left
    is_falling = (start_y > y) & (end_y <= y) & ~is_left
    winding = is_rising.sum(axis=1) - is_falling.sum(axis=1)
    a, b, c = np.moveaxis(corners, 1, 0)
    normals = np.cross(b - a, c - a)
    signed_volume = (normals * (a - points)).sum(axis=1)
    is_above = np.where(normals[:, 2] > 0, signed_volume > 0, signed_volume < 0)
    return np.where(is_above, winding, 0)
