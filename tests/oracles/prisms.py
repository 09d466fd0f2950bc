"""Does a convex body meet an upright prism? Proved one way or the other, by the ellipsoid method.

The method keeps an ellipsoid round all points that the two may have in common. Its centre either
is one of them, or a constraint that it breaks cuts off more than half. It shrinks to a common
point, or until nothing is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracles.solids import Body, Float

Bool = NDArray[np.bool_]

MOST_CUTS = 900
# A body that reaches less than TOUCHES into a prism only touches it, one that reaches more than
# ENTERS meets it; in between the answer is not asked for [m]
TOUCHES, ENTERS = 2e-7, 1e-6
FREE, UNKNOWN, OCCUPIED = 0, 1, 2


@dataclass(frozen=True)
class Prisms:
    """Upright prisms of one footprint.

    Attributes:
        x, y, low, high: centres and heights, shape (n,) [m].
        half: half of the square's edge, or the disc's radius: one for all, or shape (n,) [m].
        is_round: discs rather than squares.
    """

    x: Float
    y: Float
    low: Float
    high: Float
    half: float | Float
    is_round: bool

    def shrunk(self, margin: float) -> Prisms:
        low, high = self.low + margin, self.high - margin
        return Prisms(self.x, self.y, low, high, self.half - margin, self.is_round)

    def only(self, kept: NDArray[np.intp] | Bool) -> Prisms:
        part = (a[kept] for a in (self.x, self.y, self.low, self.high))
        return Prisms(*part, self.half, self.is_round)

    def center(self) -> Float:
        return np.stack([self.x, self.y, (self.low + self.high) / 2], axis=1)

    def support(self, way: Float) -> Float:
        """The largest ``p @ way`` of each prism's points, a way of shape (n or 1, 3) each."""
        if self.is_round:
            across = np.hypot(way[:, 0], way[:, 1])
        else:
            across = np.abs(way[:, 0]) + np.abs(way[:, 1])
        upright = np.abs(way[:, 2]) * (self.high - self.low) / 2
        center = self.x * way[:, 0] + self.y * way[:, 1] + (self.low + self.high) / 2 * way[:, 2]
        return center + self.half * across + upright

    def cuts(self, p: Float) -> tuple[Float, Float]:
        """Convex f <= 0 inside, (n, m), and gradients, (n, m, 3)."""
        from_center = p - self.center()
        f, gradients = [], []
        upright = np.zeros_like(p)
        upright[:, 2] = np.sign(from_center[:, 2])
        f.append(np.abs(from_center[:, 2]) - (self.high - self.low) / 2)
        gradients.append(upright)
        if self.is_round:
            across = np.hypot(from_center[:, 0], from_center[:, 1])
            outward = np.zeros_like(p)
            outward[:, :2] = from_center[:, :2] / np.maximum(across, 1e-300)[:, None]
            f.append(across - self.half)
            gradients.append(outward)
        else:
            for axis in (0, 1):
                side = np.zeros_like(p)
                side[:, axis] = np.sign(from_center[:, axis])
                f.append(np.abs(from_center[:, axis]) - self.half)
                gradients.append(side)
        return np.stack(f, axis=1), np.stack(gradients, axis=1)


def body_meets_prisms(body: Body, prisms: Prisms) -> NDArray[np.int64]:
    """FREE, OCCUPIED or UNKNOWN for each prism."""
    outer, inner = prisms.shrunk(TOUCHES), prisms.shrunk(ENTERS)
    state = np.full(len(prisms.x), UNKNOWN)
    if inner.half <= 0:
        return state
    line = body.cross(prisms.x, prisms.y)
    state[(line.low < inner.high) & (line.high > inner.low)] = OCCUPIED
    state[_separated(body, outer)] = FREE
    open_ = np.flatnonzero(state == UNKNOWN)
    point, apart = _common_point(body, outer.only(open_))
    state[open_[apart]] = FREE
    inside = (inner.only(open_).cuts(point)[0] <= 0).all(axis=1) & ~np.isnan(point[:, 0])
    state[open_[inside]] = OCCUPIED
    open_ = open_[~apart & ~inside]
    point, _ = _common_point(body, inner.only(open_))
    state[open_[~np.isnan(point[:, 0])]] = OCCUPIED
    return state


def _separated(body: Body, prisms: Prisms) -> Bool:
    """Where one of a few obvious planes lies between the two."""
    num = len(prisms.x)
    ways = [*np.eye(3)[:, None], *-np.eye(3)[:, None]]  # one for all prisms
    ways += [n[None] for n in getattr(body, "normals", np.zeros((0, 3)))]
    if (rot := getattr(body, "rot", None)) is not None:
        ways += [rot[None, :, 2], -rot[None, :, 2]]
    if (pos := getattr(body, "pos", None)) is not None:
        toward = prisms.center() - pos
        level = toward * [1.0, 1.0, 0.0]
        ways += [w / np.maximum(np.linalg.norm(w, axis=1), 1e-12)[:, None] for w in (toward, level)]
    found = np.zeros(num, dtype=bool)
    for way in ways:
        found |= body.support(way) + prisms.support(-way) < 0
    return found


def _common_point(body: Body, prisms: Prisms) -> tuple[Float, Bool]:
    """A common point of body and prism each (NaN: none found), and where there is proved none."""
    num = len(prisms.x)
    found = np.full((num, 3), np.nan)
    apart = np.zeros(num, dtype=bool)
    index = np.arange(num)
    center = prisms.center()
    reach = np.sqrt(2.0) * prisms.half + (prisms.high - prisms.low) / 2
    shape = np.eye(3) * np.square(reach)[:, None, None]
    for _ in range(MOST_CUTS):
        if not len(index):
            break
        f, g = (
            np.concatenate(both, axis=1)
            for both in zip(body.cuts(center), prisms.cuts(center), strict=True)
        )
        worst = np.argmax(f / np.linalg.norm(g, axis=2).clip(1e-300), axis=1)
        each = np.arange(len(index))
        f, g = f[each, worst], g[each, worst]
        turned = np.einsum("nij,nj->ni", shape, g)
        width = np.sqrt(np.maximum(np.einsum("ni,ni->n", g, turned), 1e-300))
        depth = f / width
        here = f <= 0
        found[index[here]] = center[here]
        apart[index[depth > 1 + 1e-6]] = True
        going = ~here & (depth < 1 - 1e-9)
        index, center, shape, prisms = index[going], center[going], shape[going], prisms.only(going)
        depth, turned = depth[going], turned[going] / width[going, None]
        center = center - ((1 + 3 * depth) / 4)[:, None] * turned
        outer = np.einsum("ni,nj->nij", turned, turned)
        factor = 2 * (1 + 3 * depth) / (4 * (1 + depth))
        shape = (9 / 8 * (1 - depth**2))[:, None, None] * (shape - factor[:, None, None] * outer)
    return found, apart
