"""Splits meshes into their connected parts, and decides which of them enclose a volume.

Parts are defined as in the bake, but found by code of this module's own: connected components of
graphs, where the bake uses flood fills.
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
# No triangle of a patch is inverted if the areas that are wound one way and the other way differ by
# at most this share of the patch's area
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
        edge_id: The edge of each half-edge, (3 m,).
        direction: 1 where a half-edge runs from its lower to its higher point, else -1, (3 m,).
        opposite_point_id: The point at the third corner of the triangle, (3 m,).
        sorted_by_edge: The half-edges, sorted by their edge, (3 m,).
        start: Where the half-edges of each edge begin in `sorted_by_edge`, (edges + 1,).
    """

    edge_id: Int
    direction: Int
    opposite_point_id: Int
    sorted_by_edge: Int
    start: Int


class Patches(NamedTuple):
    """The patches of a mesh: triangles that are connected over edges at which exactly two meet.

    Attributes:
        patch_of_face: The patch of each triangle, (m,); -1 for triangles that are left out.
        num_patches: The number of patches.
        is_flipped: The triangles that face to the other side than most of their patch, (m,).
    """

    patch_of_face: Int
    num_patches: int
    is_flipped: Bool


def split_mesh_parts(vertices: Float, faces: Int) -> list[ClassifiedPart]:
    """Split a mesh into its connected parts, and classify each by what it encloses.

    1. Vertices at the same position count as one vertex. Triangles with two corners at one
       position, and duplicates of triangles, are dropped.
    2. Open surfaces are peeled off: triangles with an edge that no other triangle shares, until no
       such triangle is left.
    3. The remaining triangles form patches: they are connected over edges at which exactly two of
       them meet. Triangles wound against most of their patch's area are inverted. Membranes (see
       `_drop_membranes`) are dropped.
    4. Patches that close each other's edges are one part. It encloses a volume if triangles run
       through each of its edges as often in one direction as in the other.

    Args:
        vertices: The positions of the vertices, (n, 3) [m].
        faces: The indices of each triangle's vertices, (m, 3).

    Returns:
        The parts that enclose a volume; then all other triangles as one open surface, if there are
        any.
    """
    _, point_id_of_vertex = np.unique(vertices, axis=0, return_inverse=True)
    corner_point_ids = point_id_of_vertex.reshape(-1)[faces].reshape(-1, 3)
    has_distinct_corners = (corner_point_ids != np.roll(corner_point_ids, 1, axis=1)).all(axis=1)
    faces = faces[has_distinct_corners]
    corner_point_ids = corner_point_ids[has_distinct_corners]
    is_first_copy = _mark_first_copies(corner_point_ids)
    faces = faces[is_first_copy]
    corner_point_ids = corner_point_ids[is_first_copy]
    if not len(faces):
        return []
    face_areas, _ = _measure_faces(vertices, faces)
    half_edges = _find_half_edges(corner_point_ids)
    is_remaining = np.ones(len(faces), np.bool_)
    while True:
        _remove_open_surfaces(half_edges, is_remaining)
        patches = _find_patches(half_edges, face_areas, is_remaining)
        if not _drop_membranes(half_edges, face_areas, patches, is_remaining):
            break
    part_of_face = _unite_patches(half_edges, patches, is_remaining)
    return _classify_parts(vertices, faces, part_of_face, patches.is_flipped)


def _mark_first_copies(corner_point_ids: Int) -> Bool:
    """Mark each triangle unless an earlier one has the same corners in the same cyclic order."""
    if not len(corner_point_ids):
        return np.zeros(0, np.bool_)
    lowest_corner_index = corner_point_ids.argmin(axis=1)
    rotated_corners = np.take_along_axis(
        corner_point_ids, (lowest_corner_index[:, None] + np.arange(3)) % 3, axis=1
    )
    _, first_copy_faces = np.unique(rotated_corners, axis=0, return_index=True)
    is_first_copy = np.zeros(len(corner_point_ids), np.bool_)
    is_first_copy[first_copy_faces] = True
    return is_first_copy


def _find_half_edges(corner_point_ids: Int) -> HalfEdges:
    """Return the half-edges of triangles, given the points at their corners, (m, 3)."""
    begin_point_ids = corner_point_ids.ravel()
    end_point_ids = np.roll(corner_point_ids, -1, axis=1).ravel()
    sorted_ends = np.sort(np.stack([begin_point_ids, end_point_ids], axis=1), axis=1)
    _, edge_of_half_edge, num_half_edges_at_edge = np.unique(
        sorted_ends, axis=0, return_inverse=True, return_counts=True
    )
    edge_of_half_edge = edge_of_half_edge.reshape(-1)
    return HalfEdges(
        edge_id=edge_of_half_edge,
        direction=np.where(begin_point_ids < end_point_ids, 1, -1),
        opposite_point_id=np.roll(corner_point_ids, -2, axis=1).ravel(),
        sorted_by_edge=np.argsort(edge_of_half_edge, kind="stable"),
        start=np.concatenate([[0], np.cumsum(num_half_edges_at_edge)]),
    )


def _list_remaining_half_edges(
    half_edges: HalfEdges, edges: Int, is_remaining: Bool
) -> tuple[Int, Int]:
    """List the half-edges of remaining triangles at some edges.

    Returns:
        The half-edges, (n,); and for each, the index of its edge in `edges`, (n,).
    """
    first_sorted_indices = half_edges.start[edges]
    num_half_edges = half_edges.start[edges + 1] - first_sorted_indices
    edge_index = np.repeat(np.arange(len(edges)), num_half_edges)
    sorted_indices = np.arange(len(edge_index)) + np.repeat(
        first_sorted_indices - (np.cumsum(num_half_edges) - num_half_edges), num_half_edges
    )
    listed_half_edges = half_edges.sorted_by_edge[sorted_indices]
    is_remaining_half_edge = is_remaining[listed_half_edges // 3]
    return listed_half_edges[is_remaining_half_edge], edge_index[is_remaining_half_edge]


def _remove_open_surfaces(half_edges: HalfEdges, is_remaining: Bool) -> None:
    """Remove triangles at bare edges from `is_remaining` until there is no such edge.

    An edge is bare if one triangle is left there, or two with the same corners.
    """
    edges = np.arange(len(half_edges.start) - 1)
    while len(edges):
        remaining_half_edges, edge_index = _list_remaining_half_edges(
            half_edges, edges, is_remaining
        )
        num_remaining_at_edge = np.bincount(edge_index, minlength=len(edges))
        opposite_point_ids = half_edges.opposite_point_id[remaining_half_edges]
        # the sum of two equal numbers is twice their largest
        largest_point_id = np.zeros(len(edges), np.int64)
        np.maximum.at(largest_point_id, edge_index, opposite_point_ids)
        has_same_opposite = (
            np.bincount(edge_index, opposite_point_ids, len(edges)) == 2 * largest_point_id
        )
        is_bare = (num_remaining_at_edge == 1) | ((num_remaining_at_edge == 2) & has_same_opposite)
        removed_faces = np.unique(remaining_half_edges[is_bare[edge_index]] // 3)
        is_remaining[removed_faces] = False
        half_edges_of_removed = 3 * removed_faces[:, None] + np.arange(3)
        edges = np.unique(half_edges.edge_id[half_edges_of_removed])


def _find_patches(half_edges: HalfEdges, face_areas: Float, is_remaining: Bool) -> Patches:
    """Find the patches of the remaining triangles, and those that are wound against their patch.

    A graph has two nodes for each triangle: as it is, and inverted. An edge at which two triangles
    meet connects the nodes in which both are wound the same way.
    """
    num_faces = len(is_remaining)
    all_edges = np.arange(len(half_edges.start) - 1)
    remaining_half_edges, edge_index = _list_remaining_half_edges(
        half_edges, all_edges, is_remaining
    )
    is_manifold = np.bincount(edge_index, minlength=len(all_edges))[edge_index] == 2
    first_half_edges, second_half_edges = remaining_half_edges[is_manifold].reshape(-1, 2).T
    is_same_direction = (
        half_edges.direction[first_half_edges] == half_edges.direction[second_half_edges]
    )
    begin_nodes = first_half_edges // 3
    end_nodes = second_half_edges // 3 + num_faces * is_same_direction
    begin_nodes = np.concatenate([begin_nodes, begin_nodes + num_faces])
    end_nodes = np.concatenate([end_nodes, (end_nodes + num_faces) % (2 * num_faces)])
    component_of_oriented_face = _find_components(begin_nodes, end_nodes, 2 * num_faces)
    component_of_face = _find_components(begin_nodes % num_faces, end_nodes % num_faces, num_faces)
    patch_of_face = np.full(num_faces, -1)
    remaining_faces = np.flatnonzero(is_remaining)
    _, first_index_of_patch, patch_of_face[remaining_faces] = np.unique(
        component_of_face[remaining_faces], return_index=True, return_inverse=True
    )
    num_patches = len(first_index_of_patch)
    is_opposite = (
        component_of_oriented_face[remaining_faces]
        != component_of_oriented_face[remaining_faces[first_index_of_patch]][
            patch_of_face[remaining_faces]
        ]
    )
    opposite_area_of_patch = np.bincount(
        patch_of_face[remaining_faces], face_areas[remaining_faces] * is_opposite, num_patches
    )
    area_of_patch = np.bincount(
        patch_of_face[remaining_faces], face_areas[remaining_faces], num_patches
    )
    opposite_excess_of_patch = 2.0 * opposite_area_of_patch - area_of_patch
    is_even_patch = np.abs(opposite_excess_of_patch) <= EVEN_SHARE * area_of_patch
    is_flipped = np.zeros(num_faces, np.bool_)
    is_flipped[remaining_faces] = (
        is_opposite != (opposite_excess_of_patch > 0.0)[patch_of_face[remaining_faces]]
    ) & ~is_even_patch[patch_of_face[remaining_faces]]
    return Patches(patch_of_face, num_patches, is_flipped)


def _find_components(begin_nodes: Int, end_nodes: Int, num_nodes: int) -> Int:
    """Return the connected component of each node of a graph, given the ends of its edges."""
    edge_weights = np.ones(len(begin_nodes), np.int8)
    graph = coo_array((edge_weights, (begin_nodes, end_nodes)), (num_nodes, num_nodes))
    component_of_node: Int = connected_components(graph, directed=False)[1]
    return component_of_node


def _find_wound_directions(half_edges: HalfEdges, patches: Patches) -> Int:
    """Return the directions of half-edges after triangles were inverted, (3 m,)."""
    sign_of_face = np.where(patches.is_flipped, -1, 1)
    wound_directions: Int = half_edges.direction * np.repeat(sign_of_face, 3)
    return wound_directions


def _drop_membranes(
    half_edges: HalfEdges, face_areas: Float, patches: Patches, is_remaining: Bool
) -> bool:
    """Drop membranes: patches without which fewer half-edges lack a partner.

    The partner of a half-edge runs along the same edge in the opposite direction. Patches are
    judged one after the other, the smallest first. Only edges at which more than two triangles meet
    are looked at; triangles of dropped patches count at an edge, too.

    Returns:
        Whether any patch was dropped.
    """
    num_edges = len(half_edges.start) - 1
    shared_half_edges = np.flatnonzero(np.repeat(is_remaining, 3))
    edge_of_half_edge = half_edges.edge_id[shared_half_edges]
    is_shared = np.bincount(edge_of_half_edge, minlength=num_edges)[edge_of_half_edge] > 2
    shared_half_edges = shared_half_edges[is_shared]
    if not len(shared_half_edges):
        return False
    remaining_faces = np.flatnonzero(is_remaining)
    area_of_patch = np.bincount(
        patches.patch_of_face[remaining_faces], face_areas[remaining_faces], patches.num_patches
    )
    wound_directions = _find_wound_directions(half_edges, patches)
    # An edge's balance is the sum of its half-edges' directions, 0 if each has a partner. A pair is
    # a patch and one of its edges; the pair's balance is that of the patch's half-edges there.
    patch_edge_codes = (
        patches.patch_of_face[shared_half_edges // 3] * num_edges
        + half_edges.edge_id[shared_half_edges]
    )
    patch_edge_codes, pair_index = np.unique(patch_edge_codes, return_inverse=True)
    pair_balance = np.bincount(pair_index, wound_directions[shared_half_edges]).astype(np.int64)
    pair_patch, pair_edge = np.divmod(patch_edge_codes, num_edges)
    edge_balance = np.bincount(pair_edge, pair_balance, num_edges).astype(np.int64)
    first_pair_of_patch = np.searchsorted(pair_patch, np.arange(patches.num_patches + 1))
    is_dropped = np.zeros(patches.num_patches, np.bool_)
    for patch in np.argsort(area_of_patch, kind="stable").tolist():
        patch_edges = pair_edge[first_pair_of_patch[patch] : first_pair_of_patch[patch + 1]]
        balance_without_patch = (
            edge_balance[patch_edges]
            - pair_balance[first_pair_of_patch[patch] : first_pair_of_patch[patch + 1]]
        )
        if np.abs(edge_balance[patch_edges]).sum() > np.abs(balance_without_patch).sum():
            edge_balance[patch_edges] = balance_without_patch
            is_dropped[patch] = True
    is_remaining[remaining_faces[is_dropped[patches.patch_of_face[remaining_faces]]]] = False
    return bool(is_dropped.any())


def _unite_patches(half_edges: HalfEdges, patches: Patches, is_remaining: Bool) -> Int:
    """Unite patches at edges that none of them closes by itself.

    Returns:
        The closed part of each triangle, (m,); -1 for triangles that are in none.
    """
    num_edges = len(half_edges.start) - 1
    remaining_half_edges = np.flatnonzero(np.repeat(is_remaining, 3))
    wound_directions = _find_wound_directions(half_edges, patches)[remaining_half_edges]
    edge_balance = np.bincount(
        half_edges.edge_id[remaining_half_edges], wound_directions, num_edges
    )
    patch_edge_codes = (
        patches.patch_of_face[remaining_half_edges // 3] * num_edges
        + half_edges.edge_id[remaining_half_edges]
    )
    patch_edge_codes, pair_index = np.unique(patch_edge_codes, return_inverse=True)
    is_unclosed = np.bincount(pair_index, wound_directions, len(patch_edge_codes)) != 0
    unclosed_patches, unclosed_edges = np.divmod(patch_edge_codes[is_unclosed], num_edges)
    # patches and edges are the nodes of one graph
    component_of_patch = _find_components(
        unclosed_patches, patches.num_patches + unclosed_edges, patches.num_patches + num_edges
    )[: patches.num_patches]
    is_open = np.zeros(component_of_patch.max(initial=-1) + 1, np.bool_)
    is_open[component_of_patch[unclosed_patches[edge_balance[unclosed_edges] != 0]]] = True
    part_of_face = np.full(len(is_remaining), -1)
    remaining_faces = np.flatnonzero(is_remaining)
    part_of_remaining_face = component_of_patch[patches.patch_of_face[remaining_faces]]
    part_of_face[remaining_faces] = np.where(
        is_open[part_of_remaining_face], -1, part_of_remaining_face
    )
    return part_of_face


def _classify_parts(
    vertices: Float, faces: Int, part_of_face: Int, is_flipped: Bool
) -> list[ClassifiedPart]:
    """Classify closed parts by their volume: solids, cavities in solids, or open surfaces.

    Args:
        vertices: The positions of the vertices, (n, 3) [m].
        faces: The indices of each triangle's vertices, (m, 3).
        part_of_face: The closed part of each triangle, (m,), -1 for none.
        is_flipped: The triangles to invert, (m,).
    """
    solids = list[ClassifiedPart]()
    inward_parts = list[Int]()
    open_faces = [faces[part_of_face < 0]]
    wound_faces = np.where(is_flipped[:, None], faces[:, ::-1], faces)
    closed_faces = np.flatnonzero(part_of_face >= 0)
    closed_faces = closed_faces[np.argsort(part_of_face[closed_faces], kind="stable")]
    start_of_part = np.flatnonzero(np.diff(part_of_face[closed_faces], prepend=-1))
    for part_faces in np.split(closed_faces, start_of_part[1:]) if len(closed_faces) else []:
        areas, volumes = _measure_faces(vertices, wound_faces[part_faces])
        thickness = volumes.sum() / max(areas.sum(), np.finfo(np.float64).tiny)
        if thickness > MAX_SHEET_THICKNESS:
            solids.append(ClassifiedPart(SOLID, wound_faces[part_faces]))
        elif thickness < -MAX_SHEET_THICKNESS:
            inward_parts.append(part_faces)
        else:
            open_faces.append(faces[part_faces])
    cavities = list[ClassifiedPart]()
    for part_faces in inward_parts:
        if any(_is_surrounding(vertices, solid.faces, wound_faces[part_faces]) for solid in solids):
            cavities.append(ClassifiedPart(CAVITY, wound_faces[part_faces]))
        else:
            open_faces.append(faces[part_faces])
    parts = solids + cavities
    all_open_faces = np.concatenate(open_faces)
    if len(all_open_faces):
        parts.append(ClassifiedPart(OPEN_SURFACE, all_open_faces))
    return parts


def _is_surrounding(vertices: Float, outer_faces: Int, inner_faces: Int) -> bool:
    """Return whether a solid surrounds a closed part: its box, and a point of its surface.

    The solid winds around the point by the sum of its triangles' solid angles (van Oosterom and
    Strackee, The solid angle of a plane triangle, 1983).
    """
    outer_points = vertices[outer_faces].reshape(-1, 3)
    inner_corners = vertices[inner_faces]
    inner_points = inner_corners.reshape(-1, 3)
    if (outer_points.min(axis=0) > inner_points.min(axis=0)).any():
        return False
    if (outer_points.max(axis=0) < inner_points.max(axis=0)).any():
        return False
    face_areas, _ = _measure_faces(vertices, inner_faces)
    inner_point = inner_corners[face_areas.argmax()].mean(axis=0)
    to_first_corners, to_second_corners, to_third_corners = np.moveaxis(
        vertices[outer_faces] - inner_point, 1, 0
    )
    first_lengths = np.linalg.norm(to_first_corners, axis=1)
    second_lengths = np.linalg.norm(to_second_corners, axis=1)
    third_lengths = np.linalg.norm(to_third_corners, axis=1)
    triple_products = (to_first_corners * np.cross(to_second_corners, to_third_corners)).sum(axis=1)
    angle_denominators = first_lengths * second_lengths * third_lengths
    angle_denominators += (to_first_corners * to_second_corners).sum(axis=1) * third_lengths + (
        to_second_corners * to_third_corners
    ).sum(axis=1) * first_lengths
    angle_denominators += (to_third_corners * to_first_corners).sum(axis=1) * second_lengths
    solid_angles = 2.0 * np.arctan2(triple_products, angle_denominators)
    return bool(solid_angles.sum() / (4.0 * np.pi) > MIN_WINDING)


def _measure_faces(vertices: Float, faces: ArrayLike) -> tuple[Float, Float]:
    """Return the area of each triangle [m²], and the volume of its pyramid to one point [m³]."""
    corners = vertices[np.asarray(faces)]
    a, b, c = np.moveaxis(corners - corners[0, 0], 1, 0)
    cross_products = np.cross(b - a, c - a)
    volumes: Float = (a * cross_products).sum(axis=1) / 6.0
    areas: Float = np.linalg.norm(cross_products, axis=1) / 2.0
    return areas, volumes
