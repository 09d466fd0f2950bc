"""Triangles of solids, and of the polygons of a mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.scene.shapes import hull_faces
from navbake.types import Float, Int, Int32

SIDES = 32  # of a round solid that is drawn by triangles


class Mesh(NamedTuple):
    """Triangles that several pieces may have in common, counter-clockwise from outside."""

    vertices: Float
    faces: Int32


def tessellate(kind: str, size: Sequence[float]) -> Mesh:
    """A solid as triangles; round ones, and cones, with `SIDES` sides.

    Sizes are MuJoCo's; a cone's are the radius of its base and half its height, its tip is up.
    """
    if kind == "plane":
        corners = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        halves = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
        return Mesh(corners * (*size[:2], 1.0), halves)
    if kind == "box":
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
        hull = hull_faces(corners.astype(np.float64))
        assert hull is not None
        return Mesh(corners, hull)
    radius, half = size[0], size[1] if len(size) > 1 else 0.0
    arc = np.linspace(-math.pi / 2, 0.0, SIDES // 4 + 1)
    if kind == "cylinder":
        profile = [(0.0, -half), (radius, -half), (radius, half), (0.0, half)]
    elif kind == "cone":
        profile = [(0.0, -half), (radius, -half), (0.0, half)]
    else:
        lift = half if kind == "capsule" else 0.0
        lower = [(radius * math.cos(a), radius * math.sin(a) - lift) for a in arc.tolist()]
        profile = lower + [(r, -z) for r, z in lower[::-1][lift == 0 :]]
    ends, rings = (profile[0], profile[-1]), profile[1:-1]
    turn = np.arange(SIDES) * (2 * math.pi / SIDES)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    layers = [np.column_stack([r * around, np.full(SIDES, z)]) for r, z in rings]
    vertices = np.concatenate([*layers, [[0.0, 0.0, ends[0][1]], [0.0, 0.0, ends[1][1]]]])
    here, beside = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    low, high = len(vertices) - 2, len(vertices) - 1
    top = (len(rings) - 1) * SIDES
    faces = [np.column_stack([np.full(SIDES, low), beside, here])]
    for start in range(0, top, SIDES):
        a, b = start + here, start + beside
        faces += [np.column_stack([a, b, b + SIDES]), np.column_stack([a, b + SIDES, a + SIDES])]
    faces.append(np.column_stack([top + here, top + beside, np.full(SIDES, high)]))
    if kind == "ellipsoid":
        vertices = vertices / radius * np.asarray(size)
    return Mesh(vertices, np.concatenate(faces).astype(np.int32))


def triangulate(vertices: Float, counts: Int, indices: Int, holes: Int) -> Int32:
    """Triangles of polygons in space, which wind as these do, (n, 3).

    Convex ones are fans; of others ears are cut off (Meisters, Polygons have ears, 1975). Takes
    vertices, (m, 3), how many corners each polygon has, and the vertices of all corners, polygon by
    polygon. Those with fewer than three, and those numbered in `holes`, are left out.
    """
    if not len(holes) and (counts == 3).all():
        return np.asarray(indices.reshape(-1, 3).astype(np.int32))
    start, found = np.cumsum(counts) - counts, [np.empty((0, 3), dtype=np.int32)]
    kept = counts >= 3
    kept[holes[(holes >= 0) & (holes < len(counts))]] = False
    for size in np.unique(counts[kept]).tolist():
        first = start[kept & (counts == size)]
        corners = indices[first[:, None] + np.arange(size)].astype(np.int32)
        if size > 3:
            is_convex = _are_convex(vertices[corners])
            found += [_cut_ears(vertices[one], one) for one in corners[~is_convex]]
            corners = corners[is_convex]
        for k in range(1, size - 1):
            found.append(corners[:, [0, k, k + 1]])
    return np.concatenate(found)


def _are_convex(points: Float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Mark the polygons that turn to one side at all corners, shape of points (n, k, 3)."""
    points = points - points[:, :1]
    edge = np.roll(points, -1, axis=1) - points
    turn = np.cross(edge, np.roll(edge, -1, axis=1))
    normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)  # Newell's
    bends = np.einsum("nkc,nc->nk", turn, normal)
    return np.asarray((bends >= -1e-9 * np.abs(bends).max(axis=1, keepdims=True)).all(axis=1))


def _cut_ears(points: Float, corners: Int32) -> Int32:
    """The triangles of one simple polygon."""
    points = points - points[0]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    drop = int(np.abs(normal).argmax())  # the plane in which the polygon is widest
    flat = np.delete(points, drop, axis=1)
    way = 1.0 if (normal[drop] > 0) == (drop != 1) else -1.0
    left, found = list(range(len(points))), list[list[int]]()

    def area(a: Float, b: Float, c: Float) -> Float:
        """Twice the area of triangles, positive where they wind as the polygon."""
        ab, ac = b - a, c - a
        return np.asarray(way * (ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]))

    while len(left) > 3:
        for k in range(len(left)):
            ear = left[k - 1], left[k], left[(k + 1) % len(left)]
            a, b, c = flat[list(ear)]
            size = area(a, b, c)
            others = flat[[p for p in left if p not in ear]]
            # corners at the place of one of the ear's belong to a slit
            others = others[~(others[:, None] == [a, b, c]).all(axis=2).any(axis=1)]
            sides = area(a, b, others), area(b, c, others), area(c, a, others)
            if size > 0 and not (np.min(sides, axis=0) >= 0).any():
                break
        else:  # corners on a line, or lines that cross: the flattest is cut off
            ears = [[left[k - 1], left[k], left[(k + 1) % len(left)]] for k in range(len(left))]
            k = int(np.argmin([abs(area(*flat[ear])) for ear in ears]))
            ear = left[k - 1], left[k], left[(k + 1) % len(left)]
        found.append([*ear])
        left.pop(k)
    return np.asarray(corners[np.array([*found, left])])
