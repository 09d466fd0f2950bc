"""What the triangles of a mesh enclose, connected part by connected part."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.kernels.parts import COPY, SHEET, find_parts
from navbake.baker.scene.kernels.shells import find_shells, weld_points
from navbake.baker.scene.kernels.triangles import measure_areas, measure_parts
from navbake.threads import num_threads, run_in_bands
from navbake.types import Bool, Float, Int, Int32

# A part that encloses less than this times its area is a sheet with two sides [m]
THICKNESS = 1e-6
MOST_PAIRS = 1 << 20  # of a triangle and a point that are looked at at once


class MeshParts(NamedTuple):
    """The triangles of a mesh by what they enclose."""

    faces: NDArray[np.integer[Any]]  # without copies and without those of two corners at one place
    part: Int32  # of each, 0 for what encloses nothing, 1, 2, … for closed parts
    closed: NDArray[np.uint8]  # of each, OPEN_SURFACE or CLOSED_SURFACE
    num_turned: int  # triangles of closed parts that faced in and were turned

    @property
    def kind(self) -> str:
        """What a report calls it: a closed surface, a surface, or partly closed."""
        is_closed = self.closed == CLOSED_SURFACE
        if not is_closed.any():
            return "surface"
        kind = "closed surface" if is_closed.all() else "partly closed"
        return f"{kind}, {self.num_turned} turned" if self.num_turned else kind


def split_mesh(vertices: Float, faces: NDArray[np.integer[Any]]) -> MeshParts:
    """Separate the parts of a mesh that enclose a volume from the sheets in it.

    Parts are connected over edges; vertices at one place count as one. A part encloses a volume
    when each of its edges is met as often in one direction as in the other, and it faces out. One
    that faces in is a cavity, and counts, inside of one that faces out; by itself it is a room
    drawn from inside. Stray triangles at a closed part do not open it, nor do membranes across its
    inside.

    Triangles that face to the other side than most of their patch, see
    `navbake.baker.kernels.parts`, are turned in closed parts.
    """
    bits = np.ascontiguousarray(vertices, dtype=np.float64).view(np.uint64)
    number, shares = np.empty(len(vertices), dtype=np.int32), num_threads()
    run_in_bands(weld_points, shares, bits, shares, number)
    point, kept = np.empty(faces.shape, dtype=np.int32), np.empty(len(faces), dtype=np.bool_)
    run_in_bands(_take_points, len(faces), number, faces, point, kept, least=4096)
    if not kept.all():
        faces, point = faces[kept], point[kept]
    parts, is_shell = np.empty((shares, len(faces)), np.int32), np.ones(len(faces), np.bool_)
    asked = point, len(vertices), parts, is_shell
    run_in_bands(find_shells, shares, *asked)
    find_shells(*asked, shares, shares + 1)
    found = parts[0]
    turned = np.zeros(len(faces), dtype=np.bool_)
    if not is_shell.all():
        rest = np.flatnonzero(~is_shell)  # these hang together with no shell
        area = measure_areas(vertices, faces[rest])
        part, turned[rest] = find_parts(point[rest], area, len(vertices))
        found[rest] = np.where(part >= 0, rest[part], part)
    del point, is_shell, parts
    kept = found != COPY
    if not kept.all():
        faces, found, turned = faces[kept], found[kept], turned[kept]
    # closed parts are numbered from 1 by their lowest triangles; sheets are 0
    is_first = np.zeros(int(found.max(initial=0)) + 1, dtype=np.bool_)
    is_first[found[found != SHEET]] = True
    number = np.cumsum(is_first, dtype=np.int32)
    part = np.where(found == SHEET, np.int32(0), number[found])
    encloses = _find_enclosing(vertices, faces, turned, part, int(number[-1]))
    part = np.where(encloses, np.cumsum(encloses), 0).astype(np.int32)[part]
    closed = np.where(part > 0, CLOSED_SURFACE, OPEN_SURFACE).astype(np.uint8)
    turned &= part > 0
    if turned.any():
        faces = np.where(turned[:, None], faces[:, ::-1], faces)
    return MeshParts(faces, part, closed, int(np.count_nonzero(turned)))


def _take_points(
    number: Int32, faces: NDArray[np.integer[Any]], point: Int32, kept: Bool, first: int, end: int
) -> None:
    """Write the points of some triangles, and which have three."""
    np.take(number, faces[first:end], out=point[first:end], mode="clip")
    one, two, three = np.ascontiguousarray(point[first:end].T)
    kept[first:end] = (one != two) & (two != three) & (three != one)


def _find_enclosing(
    vertices: Float, faces: NDArray[np.integer[Any]], turned: Bool, part: Int32, num: int
) -> Bool:
    """Mark the closed parts, numbered from 1, that enclose a volume; index 0 stands for sheets."""
    encloses = np.zeros(num + 1, dtype=np.bool_)
    if num == 0:
        return encloses
    volume, area = sums = np.zeros((2, num + 1))
    box = np.repeat([[np.inf] * 3 + [-np.inf] * 3], num + 1, axis=0)
    best, largest = np.full(num + 1, -1.0), np.zeros(num + 1, dtype=np.int64)
    measure_parts(vertices, faces, turned, part, sums, box, best, largest)
    encloses[1:] = volume[1:] > THICKNESS * area[1:]
    inner = np.flatnonzero(volume < -THICKNESS * area)
    some = np.flatnonzero(encloses[part])
    if not len(some) or not len(inner := inner[inner > 0]):
        return encloses
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
    west, east = corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
    first = np.searchsorted(point[order, 0], west)
    count = np.searchsorted(point[order, 0], east, side="right") - first
    ends = np.cumsum(count)
    key, turns = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
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
    x, y = point[:, :1], point[:, 1:2]
    ax, ay = corners[:, :, 0], corners[:, :, 1]
    bx, by = np.roll(ax, -1, axis=1), np.roll(ay, -1, axis=1)
    # left of the edge from its lower end to its upper one, so that both ways give one answer
    is_back = ~((ax < bx) | ((ax == bx) & (ay < by)))
    ux, uy = np.where(is_back, ax - bx, bx - ax), np.where(is_back, ay - by, by - ay)
    vx, vy = x - np.where(is_back, bx, ax), y - np.where(is_back, by, ay)
    is_left = (ux * vy - uy * vx > 0) ^ is_back
    rises, falls = (ay <= y) & (by > y) & is_left, (ay > y) & (by <= y) & ~is_left
    turns = rises.sum(axis=1) - falls.sum(axis=1)
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    height = (normal * (a - point)).sum(axis=1)
    return np.where(np.where(normal[:, 2] > 0, height > 0, height < 0), turns, 0)
