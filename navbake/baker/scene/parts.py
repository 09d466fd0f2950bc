"""What the triangles of a mesh enclose, connected part by connected part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.kernels.parts import COPY, SHEET, find_parts
from navbake.baker.scene.kernels.shells import find_cavities, find_shells, list_edges, weld_points
from navbake.baker.scene.kernels.triangles import measure_areas, measure_parts
from navbake.threads import num_threads, run_in_bands
from navbake.types import Bool, Float, Int32

# A part that encloses less than this times its area is a sheet with two sides [m]
THICKNESS = 1e-6


@dataclass(frozen=True)
class MeshParts:
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
    """Tell the parts of a mesh that enclose a volume from the sheets in it.

    Parts are what hangs together over edges; vertices at one place count as one. A part encloses
    a volume when each of its edges is met as often in one direction as in the other, and it faces
    out: the volume that its triangles sum up to is positive. One that faces in is a cavity, and
    counts, where it lies inside of one that faces out. By itself it is a room drawn from inside,
    and encloses nothing. A triangle that hangs on a closed part by less than all of its edges is
    no part of it, so that a stray one opens nothing. Nor is a membrane: a sheet across
    the inside of one that is closed without it.

    Triangles that face to the other side than most of the area that they hang together with, over
    edges at which two triangles meet, are taken as turned; in a closed part they are.
    """
    bits = np.ascontiguousarray(vertices, dtype=np.float64).view(np.uint64)
    number, shares = np.empty(len(vertices), dtype=np.int32), num_threads()
    run_in_bands(weld_points, shares, bits, shares, number)
    point = number[faces]
    one, two, three = point.T
    kept = (one != two) & (two != three) & (three != one)
    if not kept.all():
        faces, point = faces[kept], point[kept]
    edges = list_edges(point, len(vertices))
    found, is_shell = find_shells(point, *edges[1:])
    turned = np.zeros(len(faces), dtype=np.bool_)
    if not is_shell.all():
        rest = np.flatnonzero(~is_shell)  # these hang together with no shell
        own, corners = faces[rest], point[rest]
        edges = list_edges(corners, len(vertices)) if is_shell.any() else edges
        part, turned[rest] = find_parts(corners, measure_areas(vertices, own), *edges)
        found[rest] = np.where(part >= 0, rest[part], part)
    del point, is_shell, edges
    kept = found != COPY
    if not kept.all():
        faces, found, turned = faces[kept], found[kept], turned[kept]
    part, num = _number_parts(found)
    encloses = _find_enclosing(vertices, faces, turned, part, num)
    part = np.where(encloses, np.cumsum(encloses), 0).astype(np.int32)[part]
    closed = np.where(part > 0, CLOSED_SURFACE, OPEN_SURFACE).astype(np.uint8)
    turned &= part > 0
    if turned.any():
        faces = np.where(turned[:, None], faces[:, ::-1], faces)
    return MeshParts(faces, part, closed, int(np.count_nonzero(turned)))


def _number_parts(found: Int32) -> tuple[Int32, int]:
    """Number closed parts from 1 by their lowest triangles; sheets are 0. Also returns how many."""
    is_first = np.zeros(int(found.max(initial=-1)) + 1, dtype=np.bool_)
    is_first[found[found != SHEET]] = True
    number = np.cumsum(is_first, dtype=np.int32)
    num = int(number[-1]) if len(number) else 0
    return np.where(found == SHEET, np.int32(0), np.append(number, np.int32(0))[found]), num


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
    facing_in = volume < -THICKNESS * area
    facing_in[0] = False
    if not facing_in.any():
        return encloses
    inner = np.flatnonzero(facing_in)
    some = np.flatnonzero(encloses[part])
    if not len(some):
        return encloses
    some = some[np.argsort(part[some], kind="stable")]
    of_part = np.where(turned[some, None], faces[some, ::-1], faces[some])
    origin = vertices[faces[0, 0]]
    point = (vertices[faces[largest]] - origin).mean(axis=1)
    inner = inner[np.argsort(point[inner, 0])]
    corners = vertices[of_part] - origin
    find_cavities(part[some], corners, inner, point[inner, 0], point, box, encloses)
    return encloses
