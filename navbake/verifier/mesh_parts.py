"""Splits meshes into their connected parts, and decides which of them enclose a volume.

It has the definition of the bake, in code of its own: the bake floods, this computes connected
components of graphs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.types import Bool, Float, Int

# Kinds of parts
OPEN_SURFACE = "open surface"  # encloses nothing
SOLID = "solid"  # closed, its faces point outwards
CAVITY = "cavity"  # closed, its faces point inwards, inside of a solid

MAX_SHEET_THICKNESS = 1e-6  # a closed part with at most this volume / area is a flat sheet [m]
# Of a patch, this share of its area may be wound either way before most of it counts [1]
EVEN_SHARE = 1e-9
# A point lies inside of a part that winds around it more than this often
MIN_WINDING = 0.5


class ClassifiedPart(NamedTuple):
    """A connected part of a mesh.

    Attributes:
        kind: `OPEN_SURFACE`, `SOLID` or `CAVITY`.
        faces: The indices of the vertices of each of its triangles, (m, 3).
    """

    kind: str
    faces: Int


class HalfEdges(NamedTuple):
    """The half-edges of triangles: half-edge 3 f + k runs from corner k of triangle f to the next.

    Attributes:
        edge: The edge of each half-edge, (3 m,).
        direction: 1 where a half-edge runs from its lower to its higher point, else -1, (3 m,).
        opposite: The third corner of its triangle, (3 m,).
        by_edge: The half-edges, sorted by their edge, (3 m,).
        start: The half-edges of edge e are ``by_edge[start[e] : start[e + 1]]``, (edges + 1,).
    """

    edge: Int
    direction: Int
    opposite: Int
    by_edge: Int
    start: Int


class Patches(NamedTuple):
    """Triangles that are connected over edges at which two triangles meet.

    Attributes:
        patch: The patch of each triangle, (m,); -1 for triangles that are left out.
        num: The number of patches.
        is_flipped: The triangles that face to the other side than most of their patch, (m,).
    """

    patch: Int
    num: int
    is_flipped: Bool


def split_mesh_parts(vertices: Float, faces: Int) -> list[ClassifiedPart]:
    """Split a mesh into its connected parts, and classify each by what it encloses.

    Vertices at the same position count as one vertex. Triangles with two corners at one position,
    and duplicates of triangles, are dropped. Then open surfaces are peeled off: triangles at an
    edge that no other triangle shares, until there is none. The rest are patches of triangles,
    connected over edges at which two of them meet; triangles wound against most of their patch's
    area are inverted. Membranes (see `_drop_membranes`) are dropped. Patches that close each
    other's edges are one part. It is closed if triangles run through each of its edges as often in
    one direction as in the other.

    Args:
        vertices: The positions of the vertices, (n, 3) [m].
        faces: The indices of each triangle's vertices, (m, 3).

    Returns:
        The parts that enclose a volume; then all other triangles as one open surface, if there are
        any.
    """
    _, point = np.unique(vertices, axis=0, return_inverse=True)
    corner = point.reshape(-1)[faces].reshape(-1, 3)
    is_proper = (corner != np.roll(corner, 1, axis=1)).all(axis=1)
    faces = faces[is_proper]
    corner = corner[is_proper]
    is_first = _mark_first_copies(corner)
    faces = faces[is_first]
    corner = corner[is_first]
    if not len(faces):
        return []
    area, _ = _measure_faces(vertices, faces)
    half_edges = _find_half_edges(corner)
    remains = np.ones(len(faces), np.bool_)
    while True:
        _peel(half_edges, remains)
        patches = _find_patches(half_edges, area, remains)
        if not _drop_membranes(half_edges, area, patches, remains):
            break
    part = _unite_patches(half_edges, patches, remains)
    return _classify_parts(vertices, faces, part, patches.is_flipped)


def _mark_first_copies(corner: Int) -> Bool:
    """Mark each triangle unless an earlier one has the same corners in the same cyclic order."""
    if not len(corner):
        return np.zeros(0, np.bool_)
    shift = corner.argmin(axis=1)
    from_lowest = np.take_along_axis(corner, (shift[:, None] + np.arange(3)) % 3, axis=1)
    _, first = np.unique(from_lowest, axis=0, return_index=True)
    is_first = np.zeros(len(corner), np.bool_)
    is_first[first] = True
    return is_first


def _find_half_edges(corner: Int) -> HalfEdges:
    """Return the half-edges of triangles; `corner` has the points at their corners, (m, 3)."""
    begin = corner.ravel()
    end = np.roll(corner, -1, axis=1).ravel()
    ends = np.sort(np.stack([begin, end], axis=1), axis=1)
    _, edge, num_at_edge = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    return HalfEdges(
        edge=edge,
        direction=np.where(begin < end, 1, -1),
        opposite=np.roll(corner, -2, axis=1).ravel(),
        by_edge=np.argsort(edge, kind="stable"),
        start=np.concatenate([[0], np.cumsum(num_at_edge)]),
    )


def _remaining_at(half_edges: HalfEdges, edges: Int, remains: Bool) -> tuple[Int, Int]:
    """List the half-edges of remaining triangles at some edges.

    Returns:
        The half-edges, (n,); and for each, the index of its edge in `edges`, (n,).
    """
    first = half_edges.start[edges]
    count = half_edges.start[edges + 1] - first
    index = np.repeat(np.arange(len(edges)), count)
    place = np.arange(len(index)) + np.repeat(first - (np.cumsum(count) - count), count)
    half_edge = half_edges.by_edge[place]
    is_left = remains[half_edge // 3]
    return half_edge[is_left], index[is_left]


def _peel(half_edges: HalfEdges, remains: Bool) -> None:
    """Remove triangles at bare edges from `remains` until there is no such edge.

    An edge is bare if one triangle is left there, or two with the same corners.
    """
    edges = np.arange(len(half_edges.start) - 1)
    while len(edges):
        half_edge, index = _remaining_at(half_edges, edges, remains)
        count = np.bincount(index, minlength=len(edges))
        opposite = half_edges.opposite[half_edge]
        # the sum of two equal numbers is twice their largest
        largest = np.zeros(len(edges), np.int64)
        np.maximum.at(largest, index, opposite)
        is_same = np.bincount(index, opposite, len(edges)) == 2 * largest
        is_bare = (count == 1) | ((count == 2) & is_same)
        removed = np.unique(half_edge[is_bare[index]] // 3)
        remains[removed] = False
        sides = 3 * removed[:, None] + np.arange(3)
        edges = np.unique(half_edges.edge[sides])


def _find_patches(half_edges: HalfEdges, area: Float, remains: Bool) -> Patches:
    """Find the patches of the remaining triangles, and those that are wound against their patch.

    A graph has two nodes for each triangle: as it is, and inverted. An edge at which two triangles
    meet connects the nodes in which both are wound the same way.
    """
    num_faces = len(remains)
    all_edges = np.arange(len(half_edges.start) - 1)
    half_edge, edge = _remaining_at(half_edges, all_edges, remains)
    is_manifold = np.bincount(edge, minlength=len(all_edges))[edge] == 2
    first, second = half_edge[is_manifold].reshape(-1, 2).T
    runs_along = half_edges.direction[first] == half_edges.direction[second]
    begin = first // 3
    end = second // 3 + num_faces * runs_along
    begin = np.concatenate([begin, begin + num_faces])
    end = np.concatenate([end, (end + num_faces) % (2 * num_faces)])
    oriented = _connected(begin, end, 2 * num_faces)
    component = _connected(begin % num_faces, end % num_faces, num_faces)
    patch = np.full(num_faces, -1)
    face = np.flatnonzero(remains)
    _, first_index, patch[face] = np.unique(component[face], return_index=True, return_inverse=True)
    num = len(first_index)
    is_opposite = oriented[face] != oriented[face[first_index]][patch[face]]
    opposite_area = np.bincount(patch[face], area[face] * is_opposite, num)
    total_area = np.bincount(patch[face], area[face], num)
    excess = 2.0 * opposite_area - total_area
    is_even = np.abs(excess) <= EVEN_SHARE * total_area
    is_flipped = np.zeros(num_faces, np.bool_)
    is_flipped[face] = (is_opposite != (excess > 0.0)[patch[face]]) & ~is_even[patch[face]]
    return Patches(patch, num, is_flipped)


def _connected(begin: Int, end: Int, num_nodes: int) -> Int:
    """Return the connected component of each node of a graph, given the ends of its edges."""
    ones = np.ones(len(begin), np.int8)
    graph = coo_array((ones, (begin, end)), (num_nodes, num_nodes))
    component: Int = connected_components(graph, directed=False)[1]
    return component


def _wound_directions(half_edges: HalfEdges, patches: Patches) -> Int:
    """Return the directions of half-edges after triangles were inverted, (3 m,)."""
    sign = np.where(patches.is_flipped, -1, 1)
    directions: Int = half_edges.direction * np.repeat(sign, 3)
    return directions


def _drop_membranes(half_edges: HalfEdges, area: Float, patches: Patches, remains: Bool) -> bool:
    """Drop membranes: patches without which fewer half-edges lack a partner.

    The partner of a half-edge runs along the same edge in the opposite direction. Patches are
    judged one after the other, the smallest first. Only edges at which more than two triangles meet
    are looked at; triangles of dropped patches count at an edge, too.

    Returns:
        Whether any patch was dropped.
    """
    num_edges = len(half_edges.start) - 1
    half_edge = np.flatnonzero(np.repeat(remains, 3))
    edge = half_edges.edge[half_edge]
    is_shared = np.bincount(edge, minlength=num_edges)[edge] > 2
    half_edge = half_edge[is_shared]
    if not len(half_edge):
        return False
    face = np.flatnonzero(remains)
    patch_area = np.bincount(patches.patch[face], area[face], patches.num)
    direction = _wound_directions(half_edges, patches)
    # of each patch, by how much it changes the balance of each of its edges
    pair = patches.patch[half_edge // 3] * num_edges + half_edges.edge[half_edge]
    pair, pair_index = np.unique(pair, return_inverse=True)
    share = np.bincount(pair_index, direction[half_edge]).astype(np.int64)
    pair_patch, pair_edge = np.divmod(pair, num_edges)
    balance = np.bincount(pair_edge, share, num_edges).astype(np.int64)
    first = np.searchsorted(pair_patch, np.arange(patches.num + 1))
    is_dropped = np.zeros(patches.num, np.bool_)
    for k in np.argsort(patch_area, kind="stable").tolist():
        edges = pair_edge[first[k] : first[k + 1]]
        without = balance[edges] - share[first[k] : first[k + 1]]
        if np.abs(balance[edges]).sum() > np.abs(without).sum():
            balance[edges] = without
            is_dropped[k] = True
    remains[face[is_dropped[patches.patch[face]]]] = False
    return bool(is_dropped.any())


def _unite_patches(half_edges: HalfEdges, patches: Patches, remains: Bool) -> Int:
    """Unite patches at edges that none of them closes by itself.

    Returns:
        The closed part of each triangle, (m,); -1 for triangles that are in none.
    """
    num_edges = len(half_edges.start) - 1
    half_edge = np.flatnonzero(np.repeat(remains, 3))
    direction = _wound_directions(half_edges, patches)[half_edge]
    balance = np.bincount(half_edges.edge[half_edge], direction, num_edges)
    pair = patches.patch[half_edge // 3] * num_edges + half_edges.edge[half_edge]
    pair, pair_index = np.unique(pair, return_inverse=True)
    is_unclosed = np.bincount(pair_index, direction, len(pair)) != 0
    patch, edge = np.divmod(pair[is_unclosed], num_edges)
    # patches and edges are the nodes of one graph
    component = _connected(patch, patches.num + edge, patches.num + num_edges)[: patches.num]
    is_open = np.zeros(component.max(initial=-1) + 1, np.bool_)
    is_open[component[patch[balance[edge] != 0]]] = True
    part = np.full(len(remains), -1)
    face = np.flatnonzero(remains)
    part_of_face = component[patches.patch[face]]
    part[face] = np.where(is_open[part_of_face], -1, part_of_face)
    return part


def _classify_parts(
    vertices: Float, faces: Int, part: Int, is_flipped: Bool
) -> list[ClassifiedPart]:
    """Classify closed parts by their volume: solids, cavities in solids, or open surfaces.

    Args:
        vertices: The positions of the vertices, (n, 3) [m].
        faces: The indices of each triangle's vertices, (m, 3).
        part: The closed part of each triangle, (m,), -1 for none.
        is_flipped: The triangles to invert, (m,).
    """
    solids = list[ClassifiedPart]()
    inward_parts = list[Int]()
    open_faces = [faces[part < 0]]
    turned = np.where(is_flipped[:, None], faces[:, ::-1], faces)
    closed = np.flatnonzero(part >= 0)
    closed = closed[np.argsort(part[closed], kind="stable")]
    begins = np.flatnonzero(np.diff(part[closed], prepend=-1))
    for members in np.split(closed, begins[1:]) if len(closed) else []:
        area, volume = _measure_faces(vertices, turned[members])
        thickness = volume.sum() / max(area.sum(), np.finfo(np.float64).tiny)
        if thickness > MAX_SHEET_THICKNESS:
            solids.append(ClassifiedPart(SOLID, turned[members]))
        elif thickness < -MAX_SHEET_THICKNESS:
            inward_parts.append(members)
        else:
            open_faces.append(faces[members])
    cavities = list[ClassifiedPart]()
    for members in inward_parts:
        if any(_surrounds(vertices, solid.faces, turned[members]) for solid in solids):
            cavities.append(ClassifiedPart(CAVITY, turned[members]))
        else:
            open_faces.append(faces[members])
    parts = solids + cavities
    all_open = np.concatenate(open_faces)
    if len(all_open):
        parts.append(ClassifiedPart(OPEN_SURFACE, all_open))
    return parts


def _surrounds(vertices: Float, outer: Int, inner: Int) -> bool:
    """Return whether a solid surrounds a closed part: its box, and a point of its surface.

    The solid winds around the point by the sum of its triangles' solid angles (van Oosterom and
    Strackee, The solid angle of a plane triangle, 1983).
    """
    outer_points = vertices[outer].reshape(-1, 3)
    inner_corners = vertices[inner]
    inner_points = inner_corners.reshape(-1, 3)
    if (outer_points.min(axis=0) > inner_points.min(axis=0)).any():
        return False
    if (outer_points.max(axis=0) < inner_points.max(axis=0)).any():
        return False
    area, _ = _measure_faces(vertices, inner)
    point = inner_corners[area.argmax()].mean(axis=0)
    a, b, c = np.moveaxis(vertices[outer] - point, 1, 0)
    length_a = np.linalg.norm(a, axis=1)
    length_b = np.linalg.norm(b, axis=1)
    length_c = np.linalg.norm(c, axis=1)
    triple = (a * np.cross(b, c)).sum(axis=1)
    scalar = length_a * length_b * length_c
    scalar += (a * b).sum(axis=1) * length_c + (b * c).sum(axis=1) * length_a
    scalar += (c * a).sum(axis=1) * length_b
    solid_angle = 2.0 * np.arctan2(triple, scalar)
    return bool(solid_angle.sum() / (4.0 * np.pi) > MIN_WINDING)


def _measure_faces(vertices: Float, faces: ArrayLike) -> tuple[Float, Float]:
    """Return the area of each triangle [m²], and the volume of its pyramid to one point [m³]."""
    corners = vertices[np.asarray(faces)]
    a, b, c = np.moveaxis(corners - corners[0, 0], 1, 0)
    cross = np.cross(b - a, c - a)
    volume: Float = (a * cross).sum(axis=1) / 6.0
    area: Float = np.linalg.norm(cross, axis=1) / 2.0
    return area, volume
