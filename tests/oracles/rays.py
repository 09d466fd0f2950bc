"""A ray against triangles, one by one."""

import numpy as np


def first_hit(triangles, point, direction):
    """The nearest hit of a ray with triangles, by Möller and Trumbore; -1 for none."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    across = np.cross(direction, c - a)
    det = ((b - a) * across).sum(axis=1)
    with np.errstate(all="ignore"):
        u = ((point - a) * across).sum(axis=1) / det
        q = np.cross(point - a, b - a)
        v = (q @ direction) / det
        t = ((c - a) * q).sum(axis=1) / det
        hits = t[(u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & np.isfinite(t)]
    return hits.min() if len(hits) else -1.0
