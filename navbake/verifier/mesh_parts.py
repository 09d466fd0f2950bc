"""Which parts of a mesh enclose a volume, by the words of the documentation and plain NumPy.

A part is what hangs together over edges. It encloses a volume where each of its edges is met as
often in one direction as in the other. What only might enclose one (edges that are met twice, but
in one direction) is called unclear: there, only its surface is judged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.types import Float, Int

SHEET, SOLID, CAVITY, UNCLEAR = "sheet", "solid", "cavity", "unclear"
MOST_OPEN = 0.05  # share of open edges up to which a part may be a closed one with a flaw
THINNEST = 1e-6  # volume by area of what is a sheet with two sides [m]


class Part(NamedTuple):
    """Triangles of a mesh.

    Attributes:
        kind: SHEET (encloses nothing), SOLID, CAVITY (a closed part that faces in) or UNCLEAR.
        faces: shape (n, 3), indices of the mesh's vertices.
    """

    kind: str
    faces: Int


def split_parts(vertices: Float, faces: Int) -> list[Part]:
    """All sheets as one part, and each part that encloses something, or may, by itself.

    Args:
        vertices: shape (n, 3) [m].
        faces: shape (m, 3), counter-clockwise from outside.
    """
    _, point = np.unique(vertices, axis=0, return_inverse=True)
    corner = point.reshape(-1)[faces]
    whole = (corner != np.roll(corner, 1, axis=1)).all(axis=1)
    faces, corner = faces[whole], corner[whole]
    if not len(faces):
        return []
    first, second = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    ends = np.sort(np.stack([first, second], axis=1), axis=1)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    face = np.repeat(np.arange(len(faces)), 3)
    num_edges = int(edge.max()) + 1
    # faces and edges as the nodes of one graph: faces with an edge in common hang together
    graph = coo_array(
        (np.ones(len(face), dtype=np.int8), (face, len(faces) + edge)),
        shape=(len(faces) + num_edges,) * 2,
    )
    _, label = connected_components(graph, directed=False)
    number, part = np.unique(label[: len(faces)], return_inverse=True)
    direction = np.where(first < second, 1, -1)
    surplus = np.bincount(edge, direction, num_edges)
    met = np.bincount(edge, minlength=num_edges)
    part_of_edge = np.zeros(num_edges, dtype=np.int64)
    part_of_edge[edge] = part[face]
    is_turned = np.bincount(part_of_edge, surplus != 0, len(number)) > 0
    volume, area = _measure(vertices, faces, part, len(number))
    is_thin = np.abs(volume) <= THINNEST * area
    kind = np.where(volume > 0, SOLID, CAVITY).astype(object)
    kind[is_turned] = UNCLEAR
    # an almost closed part may enclose something, with a stray triangle or a membrane
    open_edges = np.bincount(part_of_edge, met % 2, len(number))
    all_edges = np.bincount(part_of_edge, minlength=len(number))
    is_sheet = open_edges > MOST_OPEN * all_edges
    kind[open_edges > 0] = UNCLEAR
    kind[is_sheet | (is_thin & ~is_turned)] = SHEET
    by_part = np.argsort(part, kind="stable")
    pieces = np.split(faces[by_part], np.searchsorted(part[by_part], np.arange(1, len(number))))
    sheets = [piece for piece, k in zip(pieces, kind, strict=True) if k == SHEET]
    parts = [Part(k, f) for k, f in zip(kind, pieces, strict=True) if k != SHEET]
    return [*parts, Part(SHEET, np.concatenate(sheets))] if sheets else parts


def _measure(vertices: Float, faces: Int, part: Int, num: int) -> tuple[Float, Float]:
    """Volume and area of each part, the volume as seen from its first corner [m³, m²]."""
    _, first = np.unique(part, return_index=True)
    corners = vertices[faces] - vertices[faces[first[part], 0]][:, None]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.bincount(part, np.einsum("ij,ij->i", corners[:, 0], cross), num) / 6
    return volume, np.bincount(part, np.linalg.norm(cross, axis=1), num) / 2
