"""What of a drawing is below a height: triangles cut by a level plane, solids closed there."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Int
from navbake.views.viewer.mesh.drawing import Drawing, Surface

CAP_SHADE = 0.35  # light of a cut face, by that of its geom


def cut_drawing(drawing: Drawing, height: float) -> tuple[Surface, ...]:
    """The surfaces below a height [m], world z.

    A triangle across the plane is replaced by its lower part. Cut boxes, cylinders and so on get
    a face there, darker than they are; meshes and height fields stay open.
    """
    kept: list[Surface] = []
    for surface in drawing.surfaces:
        z = surface.vertices[:, 2]
        if not len(z) or float(z.max()) <= height:
            kept.append(surface)
            continue
        below, ends = _cut_surface(surface, height)
        kept += [one for one in (below, _close(surface, ends, drawing.solid)) if one is not None]
    return tuple(kept)


class _Ends(NamedTuple):
    """Where the edges of cut triangles meet the plane.

    Attributes:
        places: shape (n, 3), world frame [m].
        geom: whose they are, shape (n,).
        vertex: of the surface, that the edge comes from, shape (n,).
    """

    places: NDArray[np.float32]
    geom: NDArray[np.int32]
    vertex: Int


def _cut_surface(surface: Surface, height: float) -> tuple[Surface | None, _Ends]:
    """The part of a surface below the plane, and where its triangles meet it."""
    above = surface.vertices[:, 2] > height
    num_above = above[surface.faces].sum(axis=1)
    whole = num_above == 0
    # one corner above leaves a quad, two leave a triangle; the odd corner comes first
    single, double = (_turned(surface, above, num_above, count) for count in (1, 2))
    crossed = [  # edges from the odd corner to the other two
        np.stack([faces[:, [0, 0]], faces[:, [1, 2]]], axis=-1).reshape(-1, 2)
        for faces, _ in (single, double)
    ]
    edges = np.concatenate(crossed).astype(np.int64)
    new, first = _meet(surface, edges, height), len(surface.vertices)
    ids = (first + np.arange(len(edges))).reshape(-1, 2)
    of_single, of_double = ids[: len(single[0])], ids[len(single[0]) :]
    faces = np.concatenate(
        [
            surface.faces[whole].astype(np.int64),
            np.column_stack([of_single[:, 0], single[0][:, 1], single[0][:, 2]]),
            np.column_stack([of_single[:, 0], single[0][:, 2], of_single[:, 1]]),
            np.column_stack([double[0][:, 0], of_double[:, 0], of_double[:, 1]]),
        ]
    )
    geom = np.concatenate([surface.geom[whole], single[1], single[1], double[1]])
    owners = np.repeat(np.concatenate([single[1], double[1]]), 2)
    ends = _Ends(new[:, :3], owners, edges[:, 0])
    if not len(faces):
        return None, ends
    colors = np.concatenate([surface.colors, surface.colors[edges[:, 0]]])
    vertices = np.concatenate([surface.vertices, new[:, :3]])
    uv = None if surface.uv is None else np.concatenate([surface.uv, new[:, 3:]])
    used, faces = np.unique(faces, return_inverse=True)
    cut = surface._replace(
        vertices=vertices[used],
        faces=faces.reshape(-1, 3).astype(np.uint32),
        geom=geom,
        colors=colors[used],
        uv=None if uv is None else uv[used],
    )
    return cut, ends


def _turned(
    surface: Surface, above: NDArray[np.bool_], num_above: Int, count: int
) -> tuple[NDArray[np.uint32], NDArray[np.int32]]:
    """Triangles with so many corners above, turned so that the odd corner comes first."""
    chosen = num_above == count
    faces = surface.faces[chosen]
    odd = np.argmax(above[faces] == (count == 1), axis=1)
    order = (odd[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, order, axis=1), surface.geom[chosen]


def _meet(surface: Surface, edges: Int, height: float) -> NDArray[np.float32]:
    """Where edges meet the plane: x, y, z, and u, v if the surface has them."""
    values = surface.vertices
    if surface.uv is not None:
        values = np.hstack([values, surface.uv])
    begin, end = values[edges[:, 0]], values[edges[:, 1]]
    share = (height - begin[:, 2]) / (end[:, 2] - begin[:, 2])
    met = begin + share[:, None] * (end - begin)
    met[:, 2] = height
    ends: NDArray[np.float32] = met.astype(np.float32)
    return ends


def _close(surface: Surface, ends: _Ends, solid: NDArray[np.bool_]) -> Surface | None:
    """Faces over cut solids: each a fan round its middle, for a section of one is convex."""
    chosen = solid[ends.geom]
    places, geom, vertex = ends.places[chosen], ends.geom[chosen], ends.vertex[chosen]
    if not len(geom):
        return None
    owners, owner, count = np.unique(geom, return_inverse=True, return_counts=True)
    middle = np.stack(
        [np.bincount(owner, places[:, axis]) / count for axis in range(3)], axis=1
    ).astype(np.float32)
    away = places - middle[owner]
    order = np.lexsort([np.arctan2(away[:, 1], away[:, 0]), owner])
    places, owner, vertex = places[order], owner[order], vertex[order]
    start = np.cumsum(count) - count
    after = np.arange(len(owner)) + 1
    after[start + count - 1] = start  # the last of each geom goes on to its first
    hub = len(places) + np.arange(len(owners))
    shade = np.array([CAP_SHADE, CAP_SHADE, CAP_SHADE, 1], dtype=np.float32)
    colors = surface.colors[np.concatenate([vertex, vertex[start]])] * shade
    return Surface(
        np.concatenate([places, middle]),
        np.column_stack([np.arange(len(owner)), after, hub[owner]]).astype(np.uint32),
        owners[owner].astype(np.int32),
        colors,
    )
