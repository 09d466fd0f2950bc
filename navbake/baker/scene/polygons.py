"""Polygons of a mesh as triangles."""

from __future__ import annotations

import numpy as np

from navbake.types import Float, Int, Int32


def triangulate(vertices: Float, counts: Int, indices: Int, holes: Int) -> Int32:
    """Triangles of polygons in space, which wind as these do, (n, 3).

    Convex ones are fans; of others ears are cut off (Meisters, Polygons have ears, 1975).

    Args:
        vertices: shape (m, 3).
        counts: corners of each polygon; those with fewer than three are left out.
        indices: the vertices of all corners, polygon by polygon.
        holes: numbers of polygons that are left out.
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
