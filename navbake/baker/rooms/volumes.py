"""Intersections of vertical lines with solids, for sites that mark a volume."""

import numpy as np

from navbake.baker.kernels.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE
from navbake.baker.scene.shapes import Solids
from navbake.types import Float

Chords = tuple[Float, Float]


def vertical_chords(solid: Solids, x: Float, y: Float) -> Chords:
    """Cross vertical lines at world x, y, shape (...), with a single solid [m].

    Returns:
        Heights where each line enters and leaves it, shape (...), float64 [m]; where it misses
        the solid, the former is the greater.
    """
    rotation = solid.mat[0].reshape(3, 3)
    point = np.stack([x, y, np.zeros_like(x)], axis=-1) - solid.pos[0]
    start, way = point @ rotation, rotation[2]  # in its own frame; a line's parameter is z
    kind, size = int(solid.kind[0]), solid.size[0]
    if kind == BOX:
        return _within([_slab(start[..., k], way[k], size[k]) for k in range(3)])
    if kind in (SPHERE, ELLIPSOID):
        radii = size if kind == ELLIPSOID else np.full(3, size[0])
        return _ball(start / radii, way / radii)
    if kind not in (CYLINDER, CAPSULE):
        raise ValueError(f"expected a solid, got MuJoCo's type {kind}")
    radius, half = size[0], size[1]
    pipe = _ball(start[..., :2] / radius, way[:2] / radius)
    body = _within([pipe, _slab(start[..., 2], way[2], half)])
    if kind == CYLINDER:
        return body
    ends = [_ball((start - [0.0, 0.0, end]) / radius, way / radius) for end in (half, -half)]
    return _around([body, *ends])


def _slab(start: Float, way: float, half: float) -> Chords:
    """Where ``|start + t way| <= half``."""
    if way == 0.0:
        far = np.where(np.abs(start) <= half, np.inf, -np.inf)
        return -far, far
    ends = (-half - start) / way, (half - start) / way
    return np.minimum(*ends), np.maximum(*ends)


def _ball(start: Float, way: Float) -> Chords:
    """Where ``|start + t way| <= 1``."""
    a, b = float(way @ way), start @ way
    c = (start * start).sum(axis=-1) - 1.0
    if a == 0.0:
        far = np.where(c <= 0, np.inf, -np.inf)
        return -far, far
    square = b * b - a * c
    root = np.sqrt(np.maximum(square, 0.0))
    hit = square >= 0
    return np.where(hit, (-b - root) / a, np.inf), np.where(hit, (-b + root) / a, -np.inf)


def _within(chords: list[Chords]) -> Chords:
    low, high = zip(*chords, strict=True)
    return np.max(low, axis=0), np.min(high, axis=0)


def _around(chords: list[Chords]) -> Chords:
    """From the first entry to the last exit of parts that make up one convex body."""
    enter = np.min([np.where(high >= low, low, np.inf) for low, high in chords], axis=0)
    leave = np.max([np.where(high >= low, high, -np.inf) for low, high in chords], axis=0)
    return enter, leave
