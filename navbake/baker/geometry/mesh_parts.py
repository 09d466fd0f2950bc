"""What the triangles of a mesh enclose, connected part by connected part."""

from __future__ import annotations

import numpy as np

from navbake.baker.core.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.geometry.mesh_part_kernels import COPY, find_parts
from navbake.baker.geometry.shapes import LEAST, GeomTriangles, count_shares, triangle_areas
from navbake.baker.geometry.shell_kernels import NOT_SHELL, chain_edges, find_shells, weld_points
from navbake.baker.geometry.triangle_kernels import bound_parts, measure_part_volumes
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# A part that encloses less than this times its area is a sheet with two sides [m]
THICKNESS = 1e-6
MOST_PAIRS = 1 << 20  # of a triangle and a point that are looked at at once


def split_mesh(vertices: Float, faces: Int | Int32) -> GeomTriangles:
    """Separate the parts of a mesh that enclose a volume from the sheets in it.

    Parts are connected over edges; vertices at one place count as one. A part encloses a volume
    when each of its edges is met as often in one direction as in the other, and it faces out. One
    that faces in is a cavity, and counts, inside of one that faces out; by itself it is a room
    drawn from inside. Stray triangles at a closed part do not open it, nor do membranes across its
    inside.

    Triangles that face to the other side than most of their patch, see
    `mesh_part_kernels`, are turned in closed parts. Copies of triangles are left out, and
    those with two corners at one place.
    """
    triangles, point, part = _find_shells(vertices, np.ascontiguousarray(faces, dtype=np.int32))
    turned = np.zeros(len(triangles), dtype=np.bool_)
    is_open = part == NOT_SHELL
    if is_open.any():
        rest = np.flatnonzero(is_open)  # these hang together with no shell
        found, turned[rest] = find_parts(
            point[rest], triangle_areas(vertices, triangles[rest]), len(vertices)
        )
        part[rest] = np.where(found >= 0, rest[found], found)
    del point, is_open
    kept = part != COPY
    # closed parts are numbered from 1 by their lowest triangles; sheets are 0
    lowest = np.flatnonzero(part == np.arange(len(part), dtype=np.int32))
    num = len(lowest)
    number = np.empty(len(part), dtype=np.int32)
    number[lowest] = np.arange(1, num + 1)

    def count(first: int, end: int) -> None:
        some = part[first:end]
        part[first:end] = np.where(some < 0, 0, number[some])

    run_in_chunks(count, len(part), least=LEAST)
    if not kept.all():
        triangles = triangles[kept]
        part = part[kept]
        turned = turned[kept]
    encloses = _find_enclosing(vertices, triangles, turned, part, num)
    number = np.where(encloses, np.cumsum(encloses), 0).astype(np.int32)
    closed = np.empty(len(triangles), dtype=np.uint8)
    codes = np.where(encloses, CLOSED_SURFACE, OPEN_SURFACE).astype(np.uint8)

    def settle(first: int, end: int) -> None:
        np.take(codes, part[first:end], out=closed[first:end], mode="clip")
        np.take(number, part[first:end], out=part[first:end], mode="clip")

    run_in_chunks(settle, len(triangles), least=LEAST)
    turned &= part > 0
    if turned.any():
        triangles = np.where(turned[:, None], triangles[:, ::-1], triangles)
    num_closed = np.count_nonzero(part)
    num_turned = np.count_nonzero(turned)
    kind = "closed surface" if num_closed == len(part) else "partly closed"
    kind += f", {num_turned} turned" if num_turned else ""
    return GeomTriangles(vertices, triangles, part, closed, kind if num_closed else "surface")


def _find_shells(vertices: Float, faces: Int32) -> tuple[Int32, Int32, Int32]:
    """The triangles with three different points, these, and each one's shell or NOT_SHELL.

    Points are numbered by the first one at their place, shells by their lowest triangle.
    """
    bits = np.ascontiguousarray(vertices, dtype=np.float64).view(np.uint64)
    number = np.empty(len(bits), dtype=np.int32)
    shares = count_shares(len(bits))
    run_in_chunks(weld_points, shares, bits, shares, number)
    while True:
        point = np.empty_like(faces)
        kept = np.empty(len(faces), dtype=np.bool_)
        mate = np.empty(3 * len(faces), dtype=np.int32)
        shares = count_shares(len(faces))
        last = np.full((shares, len(bits)), -1, dtype=np.int32)
        run_in_chunks(chain_edges, shares, number, faces, point, kept, last, mate)
        if kept.all():
            break
        faces = faces[kept]
    shell = np.empty(len(faces), dtype=np.int32)
    corners = point.reshape(-1)
    run_in_chunks(find_shells, len(bits), corners, last, mate, shell, least=LEAST)
    find_shells(corners, last, mate, shell, len(bits), len(bits) + 1)
    return faces, point, shell


def _find_enclosing(vertices: Float, faces: Int32, turned: Bool, part: Int32, num: int) -> Bool:
    """Mark the closed parts, numbered from 1, that enclose a volume; index 0 stands for sheets."""
    encloses = np.zeros(num + 1, dtype=np.bool_)
    if num == 0:
        return encloses
    mesh = vertices, faces, turned, part
    volume, area = np.zeros((2, num + 1))
    share = -(-num // count_shares(len(faces)))  # each looks at all triangles
    run_in_chunks(measure_part_volumes, num, *mesh, volume, area, least=share, begin=1)
    encloses[1:] = volume[1:] > THICKNESS * area[1:]
    inner = np.flatnonzero(volume < -THICKNESS * area)
    if not len(inner) or not encloses.any():
        return encloses
    box = np.repeat([[np.inf] * 3 + [-np.inf] * 3], num + 1, axis=0)
    best = np.full(num + 1, -1.0)
    largest = np.zeros(num + 1, dtype=np.int64)
    bound_parts(*mesh, box, best, largest)
    some = np.flatnonzero(encloses[part])
    of_part = np.where(turned[some, None], faces[some, ::-1], faces[some])
    origin = vertices[faces[0, 0]]
    point = (vertices[faces[largest[inner]]] - origin).mean(axis=1)
    outer, k = _find_around(vertices[of_part] - origin, part[some], point)
    holds = (box[outer, :3] <= box[inner[k], :3]) & (box[outer, 3:] >= box[inner[k], 3:])
    encloses[inner[k[holds.all(axis=1)]]] = True
    return encloses


def _find_around(corners: Float, part: Int32, point: Float) -> tuple[Int, Int]:
    """Pairs of a part and the number of a point inside of it, by the winding number over the point.

    Triangles count as they wind round the vertical line (Sunday, Inclusion of a point, 2001).
    """
    order = np.argsort(point[:, 0])
    west = corners[:, :, 0].min(axis=1)
    east = corners[:, :, 0].max(axis=1)
    first = np.searchsorted(point[order, 0], west)
    count = np.searchsorted(point[order, 0], east, side="right") - first
    ends = np.cumsum(count)
    key = [np.empty(0, np.int64)]
    turns = [np.empty(0, np.int64)]
    cuts = np.searchsorted(ends, np.arange(MOST_PAIRS, count.sum(), MOST_PAIRS))
    for chosen in np.split(np.arange(len(count)), cuts):
        num = count[chosen]
        triangle = np.repeat(chosen, num)
        k = order[np.arange(len(triangle)) - np.repeat(np.cumsum(num) - num - first[chosen], num)]
        wound = _winding_above(corners[triangle], point[k])
        key.append((part[triangle].astype(np.int64) * len(point) + k)[wound != 0])
        turns.append(wound[wound != 0])
    pairs, pair = np.unique(np.concatenate(key), return_inverse=True)
    total = np.bincount(pair, np.concatenate(turns), len(pairs))
    outer, k = np.divmod(pairs[total > 0], len(point))
    return outer, k


def _winding_above(corners: Float, point: Float) -> Int:
    """How triangles above points wind round them, seen from there: 1, 0, or -1 (down), (n,)."""
    x = point[:, :1]
    y = point[:, 1:2]
    ax = corners[:, :, 0]
    ay = corners[:, :, 1]
    bx = np.roll(ax, -1, axis=1)
    by = np.roll(ay, -1, axis=1)
    # left of the edge from its lower end to its upper one, so that both ways give one answer
    is_back = ~((ax < bx) | ((ax == bx) & (ay < by)))
    ux = np.where(is_back, ax - bx, bx - ax)
    uy = np.where(is_back, ay - by, by - ay)
    vx = x - np.where(is_back, bx, ax)
    vy = y - np.where(is_back, by, ay)
    is_left = (ux * vy - uy * vx > 0) ^ is_back
    rises = (ay <= y) & (by > y) & is_left
    falls = (ay > y) & (by <= y) & ~is_left
    turns = rises.sum(axis=1) - falls.sum(axis=1)
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    height = (normal * (a - point)).sum(axis=1)
    return np.where(np.where(normal[:, 2] > 0, height > 0, height < 0), turns, 0)
