"""Polygons into triangles: convex ones as a fan, the others by clipping ears."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]
Float = NDArray[np.float64]


def triangulate(vertices: Float, corners: Index, sizes: Index) -> Index:
    """Split polygons into triangles that cover the same area, also where they aren't convex.

    Args:
        vertices: shape (n, 3), float64.
        corners: the polygons' vertices, one polygon after the other, shape (sum of sizes,).
        sizes: how many corners each has; those with fewer than three have no area and yield
            nothing.

    Returns:
        Triangles, shape (m, 3), int64, in the order of the polygons and turning as they do.
    """
    first = np.concatenate([[0], np.cumsum(sizes)])[:-1]
    num_triangles = np.maximum(sizes - 2, 0)
    start = np.concatenate([[0], np.cumsum(num_triangles)])
    triangles = np.empty((int(start[-1]), 3), dtype=np.int64)
    for size in np.unique(sizes[sizes >= 3]):
        chosen = np.flatnonzero(sizes == size)
        polygon = corners[first[chosen, None] + np.arange(size)]
        step = np.arange(1, size - 1)
        fan = np.stack([np.zeros_like(step), step, step + 1], axis=1)
        triangles[start[chosen, None] + np.arange(size - 2)] = polygon[:, fan]
        if size > 3:
            for i in np.flatnonzero(~_is_convex(vertices[polygon])):
                ears = np.array(_clip_ears(_flatten(vertices[polygon[i]])))
                triangles[start[chosen[i]] : start[chosen[i] + 1]] = polygon[i][ears]
    return triangles


def _normals(points: Float) -> Float:
    """Newell's normals of polygons, shape (k, size, 3) -> (k, 3), as long as twice the area."""
    local = points - points[:, :1]
    normals: Float = np.cross(local, np.roll(local, -1, axis=1)).sum(axis=1)
    return normals


def _is_convex(points: Float) -> NDArray[np.bool_]:
    """Whether no corner turns against its polygon, shape (k, size, 3) -> (k,)."""
    edge = np.roll(points, -1, axis=1) - points
    turn = np.einsum("kij,kj->ki", np.cross(np.roll(edge, 1, axis=1), edge), _normals(points))
    scale = np.abs(turn).max(axis=1, keepdims=True)
    convex: NDArray[np.bool_] = (turn >= -1e-9 * scale).all(axis=1)
    return convex


def _flatten(points: Float) -> Float:
    """A polygon in the plane of its normal's two smaller axes, counter-clockwise, (size, 2)."""
    normal = _normals(points[None])[0]
    drop = int(np.abs(normal).argmax())
    flat = np.delete(points, drop, axis=1)
    if (normal[drop] < 0) != (drop == 1):  # leaving out y turns x, z round
        flat = flat * [1.0, -1.0]
    return np.asarray(flat, dtype=np.float64)


def _clip_ears(flat: Float) -> list[tuple[int, int, int]]:
    """Triangles of a counter-clockwise polygon in the plane; always size - 2 of them."""
    left = list(range(len(flat)))
    triangles = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(flat, left, i)), 0)
        before, here, after = left[ear - 1], left[ear], left[(ear + 1) % len(left)]
        triangles.append((before, here, after))
        del left[ear]
    return [*triangles, (left[0], left[1], left[2])]


def _is_ear(flat: Float, left: list[int], i: int) -> bool:
    a, b, c = flat[left[i - 1]], flat[left[i]], flat[left[(i + 1) % len(left)]]
    if _turn(a, b, c) <= 0:
        return False
    others = flat[[k for k in left if not (flat[k] == a).all() and not (flat[k] == b).all()]]
    others = others[~(others == c).all(axis=1)]
    inside = (_turn(a, b, others) >= 0) & (_turn(b, c, others) >= 0) & (_turn(c, a, others) >= 0)
    return not inside.any()


def _turn(a: Float, b: Float, c: Float) -> Float:
    """Twice the area of a triangle, > 0 where it turns left; `c` may be many points."""
    turn: Float = (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])
    return turn
