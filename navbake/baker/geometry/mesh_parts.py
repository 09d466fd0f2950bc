"""Split meshes into connected parts, and decide what each part encloses."""

from __future__ import annotations

import numpy as np

from navbake.baker.core.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.geometry.mesh_part_kernels import DUPLICATE, find_parts
from navbake.baker.geometry.shapes import (
    MIN_ITEMS_PER_SHARE,
    GeomTriangles,
    choose_num_shares,
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
MAX_PAIRS = 1 << 20


def split_mesh(vertices: Float, faces: Int | Int32) -> GeomTriangles:
    """Separate the parts of a mesh that enclose a volume from its open surfaces.

    Parts are connected over edges; vertices at one place count as one vertex. A part is closed if
    its triangles run along each edge as often in one direction as in the other. A closed part that
    faces out encloses a volume. A closed part that faces in bounds a cavity if it lies inside of a
    part that faces out, and then counts as enclosing, too. By itself it is a room drawn from
    inside, and encloses nothing. Stray triangles at a closed part don't open it, nor do membranes
    across its inside.

    In closed parts, a triangle that faces to the other side than most triangles around it is
    flipped, see `mesh_part_kernels`. Left out are duplicates of triangles, and triangles with two
    corners at one place.

    Args:
        vertices: shape (n, 3) [m].
        faces: vertices of each triangle, counter-clockwise from the front, shape (m, 3).

    Returns:
        The triangles, with their parts and what these enclose.
    """
    triangles, point, part = _find_shells(vertices, np.ascontiguousarray(faces, dtype=np.int32))
    is_flipped = np.zeros(len(triangles), dtype=np.bool_)
    is_no_shell = part == NOT_SHELL
    if is_no_shell.any():
        candidates = np.flatnonzero(is_no_shell)  # they are connected to no shell
        candidate_part, candidate_is_flipped = find_parts(
            point[candidates], triangle_areas(vertices, triangles[candidates]), len(vertices)
        )
        is_flipped[candidates] = candidate_is_flipped
        # the lowest triangle of each part, by its index among all
        is_closed = candidate_part >= 0
        part[candidates] = np.where(is_closed, candidates[candidate_part], candidate_part)
    del point, is_no_shell
    is_unique = part != DUPLICATE
    # closed parts are numbered from 1 by their lowest triangles; open surfaces are 0
    lowest = np.flatnonzero(part == np.arange(len(part), dtype=np.int32))
    num_parts = len(lowest)
    number = np.empty(len(part), dtype=np.int32)
    number[lowest] = np.arange(1, num_parts + 1)

    def number_parts(first: int, end: int) -> None:
        lowest_of_part = part[first:end]
        part[first:end] = np.where(lowest_of_part < 0, 0, number[lowest_of_part])

    run_in_chunks(number_parts, len(part), least=MIN_ITEMS_PER_SHARE)
    if not is_unique.all():
        triangles = triangles[is_unique]
        part = part[is_unique]
        is_flipped = is_flipped[is_unique]
    encloses = _find_enclosing(vertices, triangles, is_flipped, part, num_parts)
    new_number = np.where(encloses, np.cumsum(encloses), 0).astype(np.int32)
    closed = np.empty(len(triangles), dtype=np.uint8)
    code_of_part = np.where(encloses, CLOSED_SURFACE, OPEN_SURFACE).astype(np.uint8)

    def renumber_parts(first: int, end: int) -> None:
        np.take(code_of_part, part[first:end], out=closed[first:end], mode="clip")
        np.take(new_number, part[first:end], out=part[first:end], mode="clip")

    run_in_chunks(renumber_parts, len(triangles), least=MIN_ITEMS_PER_SHARE)
    is_flipped &= part > 0
    if is_flipped.any():
        triangles = np.where(is_flipped[:, None], triangles[:, ::-1], triangles)
    num_closed = np.count_nonzero(part)
    num_flipped = np.count_nonzero(is_flipped)
    kind = "closed surface" if num_closed == len(part) else "partly closed"
    kind += f", {num_flipped} turned" if num_flipped else ""
    return GeomTriangles(vertices, triangles, part, closed, kind if num_closed else "surface")


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
    bits = np.ascontiguousarray(vertices, dtype=np.float64).view(np.uint64)
    number = np.empty(len(bits), dtype=np.int32)
    num_shares = choose_num_shares(len(bits))
    run_in_chunks(weld_points, num_shares, bits, num_shares, number)
    while True:
        point = np.empty_like(faces)
        is_proper = np.empty(len(faces), dtype=np.bool_)
        mate = np.empty(3 * len(faces), dtype=np.int32)
        num_shares = choose_num_shares(len(faces))
        last = np.full((num_shares, len(bits)), -1, dtype=np.int32)
        run_in_chunks(chain_edges, num_shares, number, faces, point, is_proper, last, mate)
        if is_proper.all():
            break
        faces = faces[is_proper]
    run_in_chunks(
        pair_half_edges, len(bits), point.reshape(-1), last, mate, least=MIN_ITEMS_PER_SHARE
    )
    shell = np.empty(len(faces), dtype=np.int32)
    label_shells(mate, shell)
    return faces, point, shell


def _find_enclosing(
    vertices: Float, faces: Int32, is_flipped: Bool, part: Int32, num_parts: int
) -> Bool:
    """Mark the closed parts that enclose a volume, see `split_mesh`.

    Args:
        vertices: shape (n, 3) [m].
        faces: vertices of each triangle, shape (m, 3).
        is_flipped: which triangles count as facing the other way, shape (m,).
        part: the closed part of each triangle, from 1; 0 for none, shape (m,).
        num_parts: how many closed parts there are.

    Returns:
        A mask by number of the part, shape (num_parts + 1,); parts count from 1, entry 0 is False.
    """
    encloses = np.zeros(num_parts + 1, dtype=np.bool_)
    if num_parts == 0:
        return encloses
    volume = np.zeros(num_parts + 1)
    area = np.zeros(num_parts + 1)
    least_parts = -(-num_parts // choose_num_shares(len(faces)))  # a call visits all triangles
    run_in_chunks(
        measure_part_volumes,
        num_parts,
        vertices,
        faces,
        is_flipped,
        part,
        volume,
        area,
        least=least_parts,
        begin=1,
    )
    encloses[1:] = volume[1:] > MIN_THICKNESS * area[1:]
    inward_parts = np.flatnonzero(volume < -MIN_THICKNESS * area)
    if not len(inward_parts) or not encloses.any():
        return encloses

    # inward parts that lie inside of outward ones are cavities
    box = np.repeat([[np.inf] * 3 + [-np.inf] * 3], num_parts + 1, axis=0)
    largest_area = np.full(num_parts + 1, -1.0)
    largest_triangle = np.zeros(num_parts + 1, dtype=np.int64)
    bound_parts(vertices, faces, is_flipped, part, box, largest_area, largest_triangle)
    outward = np.flatnonzero(encloses[part])
    outward_faces = faces[outward]
    outward_faces = np.where(is_flipped[outward, None], outward_faces[:, ::-1], outward_faces)
    origin = vertices[faces[0, 0]]
    point = (vertices[faces[largest_triangle[inward_parts]]] - origin).mean(axis=1)
    outer_part, k = _find_surrounding(vertices[outward_faces] - origin, part[outward], point)
    inner_part = inward_parts[k]
    is_inside = (box[outer_part, :3] <= box[inner_part, :3]).all(axis=1)
    is_inside &= (box[outer_part, 3:] >= box[inner_part, 3:]).all(axis=1)
    encloses[inner_part[is_inside]] = True
    return encloses


def _find_surrounding(corners: Float, part: Int32, point: Float) -> tuple[Int, Int]:
    """Find the parts that surround points, by winding numbers (Sunday, Inclusion of a point, 2001).

    A part surrounds a point if its triangles above the point wind around the vertical line more
    often counter-clockwise than clockwise.

    Args:
        corners: corners of triangles, shape (m, 3, 3) [m].
        part: the part of each triangle, shape (m,).
        point: points, shape (n, 3) [m].

    Returns:
        Pairs of a part and a point inside of it: the parts, and the indices of the points.
    """
    order = np.argsort(point[:, 0])
    x_min = corners[:, :, 0].min(axis=1)
    x_max = corners[:, :, 0].max(axis=1)
    first = np.searchsorted(point[order, 0], x_min)
    count = np.searchsorted(point[order, 0], x_max, side="right") - first
    pair_ends = np.cumsum(count)
    pair_ids = [np.empty(0, np.int64)]
    windings = [np.empty(0, np.int64)]
    cuts = np.searchsorted(pair_ends, np.arange(MAX_PAIRS, count.sum(), MAX_PAIRS))
    for batch in np.split(np.arange(len(count)), cuts):
        num_points = count[batch]
        triangle = np.repeat(batch, num_points)
        offset = np.cumsum(num_points) - num_points - first[batch]
        k = order[np.arange(len(triangle)) - np.repeat(offset, num_points)]
        winding = _winding_above(corners[triangle], point[k])
        pair_id = part[triangle].astype(np.int64) * len(point) + k
        pair_ids.append(pair_id[winding != 0])
        windings.append(winding[winding != 0])
    unique_ids, pair = np.unique(np.concatenate(pair_ids), return_inverse=True)
    total = np.bincount(pair, np.concatenate(windings), len(unique_ids))
    surrounding_part, k = np.divmod(unique_ids[total > 0], len(point))
    return surrounding_part, k


def _winding_above(corners: Float, point: Float) -> Int:
    """Return which way round a triangle above a point winds around it, for pairs of both.

    Args:
        corners: corners of n triangles, one for each point, shape (n, 3, 3) [m].
        point: the points, shape (n, 3) [m].

    Returns:
        Seen from above: 1 for counter-clockwise, -1 for clockwise, 0 if the triangle is not above
        the point; shape (n,).
    """
    x = point[:, :1]
    y = point[:, 1:2]
    ax = corners[:, :, 0]
    ay = corners[:, :, 1]
    bx = np.roll(ax, -1, axis=1)
    by = np.roll(ay, -1, axis=1)
    # left of the edge from its lower end to its upper one, so that both triangles at an edge give
    # one answer
    is_reversed = ~((ax < bx) | ((ax == bx) & (ay < by)))
    ux = np.where(is_reversed, ax - bx, bx - ax)
    uy = np.where(is_reversed, ay - by, by - ay)
    vx = x - np.where(is_reversed, bx, ax)
    vy = y - np.where(is_reversed, by, ay)
    is_left = (ux * vy - uy * vx > 0) ^ is_reversed
    rises = (ay <= y) & (by > y) & is_left
    falls = (ay > y) & (by <= y) & ~is_left
    winding = rises.sum(axis=1) - falls.sum(axis=1)
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    height = (normal * (a - point)).sum(axis=1)
    is_above = np.where(normal[:, 2] > 0, height > 0, height < 0)
    return np.where(is_above, winding, 0)
