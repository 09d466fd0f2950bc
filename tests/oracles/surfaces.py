"""Triangle surfaces: vertical lines through them, and whether they meet upright prisms."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracles.prisms import ENTERS, FREE, OCCUPIED, TOUCHES, UNKNOWN, Prisms
from oracles.solids import Float


@dataclass(frozen=True)
class Surface:
    """Triangles, counter-clockwise from their front.

    Attributes:
        corners: shape (t, 3, 3) [m].
        closed: whether they enclose a volume, from outside.
    """

    corners: Float
    closed: bool

    def cross(self, x: Float, y: Float) -> tuple[Float, Float]:
        """Heights and z of the unit normals at the lines at x, y, shape (t, n), NaN for none."""
        z = np.full((len(self.corners), len(x)), np.nan)
        up = z.copy()
        for t, (a, b, c) in enumerate(self.corners):
            normal = np.cross(b - a, c - a)
            if abs(normal[2]) < 1e-12 * max(np.linalg.norm(normal), 1e-300):
                continue
            sides = [
                (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
                for p, q in ((a, b), (b, c), (c, a))
            ]
            within = np.all(np.array(sides) * np.sign(normal[2]) >= 0, axis=0)
            height = a[2] - (normal[0] * (x - a[0]) + normal[1] * (y - a[1])) / normal[2]
            z[t, within] = height[within]
            up[t, within] = normal[2] / np.linalg.norm(normal)
        return z, up


def surface_meets_prisms(surface: Surface, prisms: Prisms) -> NDArray[np.int64]:
    """FREE, OCCUPIED or UNKNOWN for each prism; the inside of closed surfaces doesn't count."""
    state = np.full(len(prisms.x), FREE)
    inner, outer = prisms.shrunk(ENTERS), prisms.shrunk(TOUCHES)
    if inner.half <= 0:
        return np.full(len(prisms.x), UNKNOWN)
    for corners in surface.corners:
        near = np.flatnonzero(_boxes_meet(corners, outer) & (state != OCCUPIED))
        if not len(near):
            continue
        meets = disc_meets if prisms.is_round else square_meets
        state[near[meets(corners[None], outer.only(near))]] = UNKNOWN
        near = near[meets(corners[None], inner.only(near))]
        state[near] = OCCUPIED
    return state


def _boxes_meet(corners: Float, prisms: Prisms) -> NDArray[np.bool_]:
    low, high = corners.min(axis=0), corners.max(axis=0)
    met = (low[2] <= prisms.high) & (high[2] >= prisms.low)
    for axis, center in enumerate((prisms.x, prisms.y)):
        met &= (low[axis] <= center + prisms.half) & (high[axis] >= center - prisms.half)
    return met


def square_meets(corners: Float, prisms: Prisms) -> NDArray[np.bool_]:
    """No one of the thirteen axes separates a triangle from a box.

    Args:
        corners: of a triangle for each prism, or of one for all, shape (n or 1, 3, 3) [m].
        prisms: n of them.
    """
    local = corners - prisms.center()[:, None]
    half = np.stack(
        [np.full_like(prisms.x, prisms.half)] * 2 + [(prisms.high - prisms.low) / 2], axis=1
    )
    edges = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(edges[:, 0], edges[:, 1])[:, None]
    across = np.cross(edges[:, :, None], np.eye(3)).reshape(-1, 9, 3)
    sides = np.broadcast_to(np.eye(3), (len(corners), 3, 3))
    axes = np.concatenate([sides, normals, across], axis=1)
    lengths = np.linalg.norm(axes, axis=2)
    is_axis = lengths >= 1e-12
    units = axes / np.where(is_axis, lengths, 1.0)[:, :, None]
    on_axes = local @ units.transpose(0, 2, 1)  # by prism, corner and axis
    reach = (half[:, None] @ np.abs(units).transpose(0, 2, 1))[:, 0]
    overlaps = (on_axes.min(axis=1) <= reach) & (on_axes.max(axis=1) >= -reach)
    met: NDArray[np.bool_] = (overlaps | ~is_axis).all(axis=1)
    return met


def disc_meets(corners: Float, prisms: Prisms) -> NDArray[np.bool_]:
    """The part of a triangle between the heights comes near enough to the axis.

    The nearest point of that part is above or below the axis itself, on an edge, or where the
    triangle passes one of the two heights.

    Args:
        corners: of a triangle for each prism, or of one for all, shape (n or 1, 3, 3) [m].
        prisms: n of them.
    """
    z = _heights_at(corners, prisms.x, prisms.y)
    met = (z >= prisms.low) & (z <= prisms.high)
    edges = [(corners[:, k], corners[:, (k + 1) % 3]) for k in range(3)]
    for a, b in edges:
        rise = b[:, 2] - a[:, 2]
        is_level = rise == 0.0
        inside = (a[:, 2] >= prisms.low) & (a[:, 2] <= prisms.high)
        ends = np.stack([prisms.low, prisms.high]) - a[:, 2]
        ends = np.sort(ends / np.where(is_level, 1.0, rise), axis=0)
        first = np.where(is_level, np.where(inside, 0.0, 1.0), np.maximum(ends[0], 0.0))
        last = np.where(is_level, np.where(inside, 1.0, 0.0), np.minimum(ends[1], 1.0))
        met |= _line_near(a, b, first, last, prisms)
    for height in (prisms.low, prisms.high):
        ends = []
        for a, b in edges:
            rise = b[:, 2] - a[:, 2]
            t = (height - a[:, 2]) / np.where(rise == 0.0, 1.0, rise)
            passes = (rise != 0.0) & (t >= 0) & (t <= 1)
            ends.append(np.where(passes[:, None], a + t[:, None] * (b - a), np.nan))
        for a, b in itertools.combinations(ends, 2):
            valid = ~np.isnan(a[:, 0] + b[:, 0])
            first, last = np.zeros(len(height)), np.where(valid, 1.0, -1.0)
            met |= _line_near(np.nan_to_num(a), np.nan_to_num(b), first, last, prisms)
    return met


def _heights_at(corners: Float, x: Float, y: Float) -> Float:
    """Heights of triangles at lines, one triangle each or one for all; NaN where it is missed."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    is_upright = np.abs(normal[:, 2]) < 1e-12 * np.linalg.norm(normal, axis=1).clip(1e-300)
    within = ~is_upright
    for p, q in ((a, b), (b, c), (c, a)):
        side = (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])
        within = within & (side * np.sign(normal[:, 2]) >= 0)
    along = normal[:, 0] * (x - a[:, 0]) + normal[:, 1] * (y - a[:, 1])
    height = a[:, 2] - along / np.where(is_upright, 1.0, normal[:, 2])
    return np.where(within, height, np.nan)


def _line_near(a: Float, b: Float, first: Float, last: Float, prisms: Prisms) -> NDArray[np.bool_]:
    """Whether ``a + t (b - a)``, t in [first, last], comes as near as the disc's radius."""
    center = np.stack([prisms.x, prisms.y], axis=1)
    way = (b - a)[:, :2]
    length = np.maximum(np.square(way).sum(axis=1), 1e-300)
    t = ((center - a[:, :2]) * way).sum(axis=1) / length
    t = np.clip(t, first, np.maximum(first, last))
    nearest = a[:, :2] + t[:, None] * way
    return (first <= last) & (np.linalg.norm(nearest - center, axis=1) <= prisms.half)
