"""What the triangles of a mesh enclose, connected part by connected part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.kernels.parts import (
    COPY,
    SHEET,
    find_cavities,
    find_parts,
    list_edges,
    weld_points,
)
from navbake.types import Float, Int, Int32

# A part that encloses less than this times its area is a sheet with two sides [m]
THICKNESS = 1e-6


@dataclass(frozen=True)
class MeshParts:
    """The triangles of a mesh by what they enclose.

    Attributes:
        faces: the triangles without copies and without those of two corners at one place, shape
            (m, 3), indices into the mesh's vertices.
        part: of each, 0 for what encloses nothing, 1, 2, … for closed parts, shape (m,), int32.
        closed: of each, OPEN_SURFACE or CLOSED_SURFACE, shape (m,), uint8.
    """

    faces: NDArray[np.integer[Any]]
    part: Int32
    closed: NDArray[np.uint8]

    @property
    def kind(self) -> str:
        """What a report calls it: a closed surface, a surface, or partly closed."""
        is_closed = self.closed == CLOSED_SURFACE
        if not is_closed.any():
            return "surface"
        return "closed surface" if is_closed.all() else "partly closed"


def split_mesh(vertices: Float, faces: NDArray[np.integer[Any]]) -> MeshParts:
    """Tell the parts of a mesh that enclose a volume from the sheets in it.

    Parts are what hangs together over edges; vertices at one place count as one. A part encloses
    a volume when each of its edges is met as often in one direction as in the other, and it faces
    out: the volume that its triangles sum up to is positive. One that faces in is a cavity, and
    counts, where it lies inside of one that faces out. By itself it is a room drawn from inside,
    and encloses nothing. A triangle that hangs on a closed part by less than all of its edges is
    no part of it, so that a stray one opens nothing.

    Args:
        vertices: shape (n, 3), float64 [m].
        faces: shape (m, 3), indices, counter-clockwise from the front.
    """
    point = weld_points(np.ascontiguousarray(vertices, dtype=np.float64))[faces]
    has_area = (point != np.roll(point, -1, axis=1)).all(axis=1)
    faces, point = faces[has_area], point[has_area]
    found = find_parts(point, *list_edges(point, int(point.max(initial=0)) + 1))
    kept = found != COPY
    faces, found = faces[kept], found[kept]
    roots, part = np.unique(found, return_inverse=True)
    if len(roots) and roots[0] == SHEET:
        roots = roots[1:]
    else:
        part = part + 1
    encloses = _find_enclosing(vertices, faces, part, len(roots))
    number = np.where(encloses, np.cumsum(encloses), 0)[part].astype(np.int32)
    closed = np.where(number > 0, CLOSED_SURFACE, OPEN_SURFACE).astype(np.uint8)
    return MeshParts(faces, number, closed)


def _find_enclosing(
    vertices: Float, faces: NDArray[np.integer[Any]], part: Int, num: int
) -> NDArray[np.bool_]:
    """Mark the closed parts, numbered from 1, that enclose a volume; index 0 stands for sheets."""
    encloses = np.zeros(num + 1, dtype=np.bool_)
    if num == 0:
        return encloses
    corners = vertices[faces] - vertices[faces[0, 0]]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.bincount(part, np.einsum("ij,ij->i", corners[:, 0], cross), num + 1) / 6
    area = np.bincount(part, np.linalg.norm(cross, axis=1), num + 1) / 2
    encloses[1:] = volume[1:] > THICKNESS * area[1:]
    facing_in = volume < -THICKNESS * area
    facing_in[0] = False
    if facing_in.any() and encloses.any():
        member = np.argsort(part, kind="stable")
        start = np.searchsorted(part[member], np.arange(num + 2))
        point = np.zeros((num + 1, 3))
        by_size = np.argsort(np.linalg.norm(cross, axis=1), kind="stable")
        point[part[by_size]] = corners[by_size].mean(axis=1)  # of its largest triangle
        find_cavities(start, member, corners, point, encloses, facing_in)
    return encloses
