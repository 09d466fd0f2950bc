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
        num_turned: how many triangles of closed parts faced in and were turned.
    """

    faces: NDArray[np.integer[Any]]
    part: Int32
    closed: NDArray[np.uint8]
    num_turned: int

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

    Args:
        vertices: shape (n, 3), float64 [m].
        faces: shape (m, 3), indices, counter-clockwise from the front.
    """
    point = weld_points(np.ascontiguousarray(vertices, dtype=np.float64))[faces]
    has_area = (point != np.roll(point, -1, axis=1)).all(axis=1)
    faces, point = faces[has_area], point[has_area]
    cross = _cross(vertices[faces])
    area = np.linalg.norm(cross, axis=1) / 2
    edges = list_edges(point, int(point.max(initial=0)) + 1)
    found, turned = find_parts(point, area, *edges)
    kept = found != COPY
    faces, found, turned = faces[kept], found[kept], turned[kept]
    roots, part = np.unique(found, return_inverse=True)
    if len(roots) and roots[0] == SHEET:
        roots = roots[1:]
    else:
        part = part + 1
    consistent = np.where(turned[:, None], faces[:, ::-1], faces)
    encloses = _find_enclosing(vertices, consistent, part, len(roots))
    number = np.where(encloses, np.cumsum(encloses), 0)[part].astype(np.int32)
    closed = np.where(number > 0, CLOSED_SURFACE, OPEN_SURFACE).astype(np.uint8)
    turned &= number > 0
    faces = np.where(turned[:, None], consistent, faces)
    return MeshParts(faces, number, closed, int(np.count_nonzero(turned)))


def _cross(corners: Float) -> Float:
    """Normals of triangles, as long as twice their area, shape (m, 3) [m²]."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _find_enclosing(
    vertices: Float, faces: NDArray[np.integer[Any]], part: Int, num: int
) -> NDArray[np.bool_]:
    """Mark the closed parts, numbered from 1, that enclose a volume; index 0 stands for sheets."""
    encloses = np.zeros(num + 1, dtype=np.bool_)
    if num == 0:
        return encloses
    corners = vertices[faces] - vertices[faces[0, 0]]
    cross = _cross(corners)
    volume = np.bincount(part, np.einsum("ij,ij->i", corners[:, 0], cross), num + 1) / 6
    area = np.bincount(part, np.linalg.norm(cross, axis=1), num + 1) / 2
    encloses[1:] = volume[1:] > THICKNESS * area[1:]
    facing_in = volume < -THICKNESS * area
    facing_in[0] = False
    if facing_in.any() and encloses.any():
        member = np.lexsort((corners[:, :, 0].sum(axis=1), part))  # from west to east
        start = np.searchsorted(part[member], np.arange(num + 2))
        point = np.zeros((num + 1, 3))
        by_size = np.argsort(np.linalg.norm(cross, axis=1), kind="stable")
        point[part[by_size]] = corners[by_size].mean(axis=1)  # of its largest triangle
        find_cavities(start, member, corners, point, encloses, facing_in)
    return encloses
