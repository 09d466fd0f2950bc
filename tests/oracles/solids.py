"""Convex bodies in closed form: vertical lines, supports and cuts. Nothing of navbake's in it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Crossing:
    """Where vertical lines cross a convex body, NaN where they miss it.

    Attributes:
        low, high: heights, shape (n,) [m].
        low_up, high_up: z of the outward unit normals there, shape (n,).
    """

    low: Float
    high: Float
    low_up: Float
    high_up: Float


class Body(Protocol):
    """A convex body."""

    def cross(self, x: Float, y: Float) -> Crossing:
        """Cross it with the vertical lines at x, y, shape (n,)."""

    def support(self, way: Float) -> Float:
        """The largest ``p @ way`` of its points, for ways of shape (n, 3)."""

    def cuts(self, p: Float) -> tuple[Float, Float]:
        """Convex f <= 0 inside, at p of shape (n, 3): f (n, m) and gradients (n, m, 3)."""


def rotation(quat: tuple[float, float, float, float]) -> Float:
    """The rotation matrix of a quaternion w, x, y, z of any length."""
    w, x, y, z = np.asarray(quat, dtype=np.float64) / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _between_roots(a: Float, b: Float, c: Float) -> tuple[Float, Float]:
    """Where ``a t² + 2 b t + c <= 0``, a > 0; NaN where nowhere."""
    with np.errstate(invalid="ignore"):
        root = np.sqrt(b * b - a * c)
    return (-b - root) / a, (-b + root) / a


@dataclass(frozen=True)
class Polytope:
    """A convex polytope.

    Attributes:
        vertices: shape (v, 3) [m].
        normals: outward unit normals of its faces, shape (f, 3).
        offsets: ``normals @ p <= offsets`` inside, shape (f,) [m].
    """

    vertices: Float
    normals: Float
    offsets: Float

    @classmethod
    def box(cls, pos: Float, rot: Float, half: Float) -> Polytope:
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * half
        normals = np.concatenate([rot.T, -rot.T])
        offsets = normals @ pos + np.concatenate([half, half])
        return cls(corners @ rot.T + pos, normals, offsets)

    @classmethod
    def hull(cls, points: Float) -> Polytope:
        """The hull of a few points, by trying every plane through three of them."""
        normals: list[Float] = []
        offsets: list[float] = []
        for i, j, k in itertools.combinations(range(len(points)), 3):
            normal = np.cross(points[j] - points[i], points[k] - points[i])
            length = np.linalg.norm(normal)
            if length < 1e-9:
                continue
            normal = normal / length
            side = (points - points[i]) @ normal
            for sign in (1.0, -1.0):
                if (sign * side).max() < 1e-9:
                    known = any(
                        np.abs(sign * normal - n).max() < 1e-7
                        and abs(sign * normal @ points[i] - d) < 1e-7
                        for n, d in zip(normals, offsets, strict=True)
                    )
                    if not known:
                        normals.append(sign * normal)
                        offsets.append(float((points @ (sign * normal)).max()))
        return cls(points, np.array(normals), np.array(offsets))

    def cross(self, x: Float, y: Float) -> Crossing:
        num = len(x)
        low, high = np.full(num, -np.inf), np.full(num, np.inf)
        low_up, high_up = np.full(num, -1.0), np.ones(num)
        missed = np.zeros(num, dtype=bool)
        for (nx, ny, nz), offset in zip(self.normals, self.offsets, strict=True):
            rest = offset - nx * x - ny * y
            if abs(nz) < 1e-12:
                missed |= rest < 0
                continue
            z = rest / nz
            if nz > 0:
                nearer = z < high
                high, high_up = np.where(nearer, z, high), np.where(nearer, nz, high_up)
            else:
                nearer = z > low
                low, low_up = np.where(nearer, z, low), np.where(nearer, nz, low_up)
        missed |= low > high
        low[missed] = high[missed] = np.nan
        return Crossing(low, high, low_up, high_up)

    def support(self, way: Float) -> Float:
        return (way @ self.vertices.T).max(axis=1)

    def cuts(self, p: Float) -> tuple[Float, Float]:
        f = p @ self.normals.T - self.offsets
        return f, np.broadcast_to(self.normals, (*f.shape, 3))


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid, or a sphere.

    Attributes:
        pos: centre, shape (3,) [m].
        rot: rotation matrix.
        half: half-axes, shape (3,) [m].
    """

    pos: Float
    rot: Float
    half: Float

    def cross(self, x: Float, y: Float) -> Crossing:
        start = (np.stack([x, y, np.zeros_like(x)], axis=1) - self.pos) @ self.rot / self.half
        way = self.rot[2] / self.half
        low, high = _between_roots(
            np.full_like(x, way @ way), start @ way, np.square(start).sum(axis=1) - 1.0
        )
        return Crossing(low, high, self._up(x, y, low), self._up(x, y, high))

    def _up(self, x: Float, y: Float, z: Float) -> Float:
        local = (np.stack([x, y, z], axis=1) - self.pos) @ self.rot / self.half**2
        normal = local @ self.rot.T
        return normal[:, 2] / np.linalg.norm(normal, axis=1)

    def support(self, way: Float) -> Float:
        return way @ self.pos + np.linalg.norm(way @ self.rot * self.half, axis=1)

    def cuts(self, p: Float) -> tuple[Float, Float]:
        local = (p - self.pos) @ self.rot / self.half
        norm = np.linalg.norm(local, axis=1, keepdims=True)
        gradient = (local / self.half / np.maximum(norm, 1e-300)) @ self.rot.T
        return norm - 1.0, gradient[:, None, :]


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along its own z.

    Attributes:
        pos, rot: centre and rotation matrix.
        radius, half: [m].
    """

    pos: Float
    rot: Float
    radius: float
    half: float

    def cross(self, x: Float, y: Float) -> Crossing:
        start = (np.stack([x, y, np.zeros_like(x)], axis=1) - self.pos) @ self.rot
        way = self.rot[2]
        out = np.square(start[:, :2]).sum(axis=1) - self.radius**2
        across = way[:2] @ way[:2]
        if across < 1e-24:
            low = np.where(out <= 0, -np.inf, np.nan)
            high = -low
        else:
            low, high = _between_roots(np.full_like(x, across), start[:, :2] @ way[:2], out)
        low_up, high_up = self._side_up(start, low), self._side_up(start, high)
        if abs(way[2]) < 1e-12:
            missed = np.abs(start[:, 2]) > self.half
        else:
            ends = np.sort((np.array([[-self.half], [self.half]]) - start[:, 2]) / way[2], axis=0)
            low_up = np.where(ends[0] > low, -abs(way[2]), low_up)
            high_up = np.where(ends[1] < high, abs(way[2]), high_up)
            low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
            missed = low > high
        low, high = np.where(missed, np.nan, low), np.where(missed, np.nan, high)
        return Crossing(low, high, low_up, high_up)

    def _side_up(self, start: Float, z: Float) -> Float:
        with np.errstate(invalid="ignore"):
            local = start + z[:, None] * self.rot[2]
            return local[:, :2] @ self.rot[2, :2] / self.radius

    def support(self, way: Float) -> Float:
        local = way @ self.rot
        across = np.linalg.norm(local[:, :2], axis=1)
        return way @ self.pos + self.radius * across + self.half * np.abs(local[:, 2])

    def cuts(self, p: Float) -> tuple[Float, Float]:
        local = (p - self.pos) @ self.rot
        across = np.linalg.norm(local[:, :2], axis=1)
        side = np.zeros_like(local)
        side[:, :2] = local[:, :2] / np.maximum(across, 1e-300)[:, None]
        axis = np.zeros_like(local)
        axis[:, 2] = np.sign(local[:, 2])
        f = np.stack([across - self.radius, np.abs(local[:, 2]) - self.half], axis=1)
        return f, np.stack([side, axis], axis=1) @ self.rot.T


@dataclass(frozen=True)
class Capsule:
    """A capsule along its own z.

    Attributes:
        pos, rot: centre and rotation matrix.
        radius, half: of the ball that is swept, and half of its way [m].
    """

    pos: Float
    rot: Float
    radius: float
    half: float

    def cross(self, x: Float, y: Float) -> Crossing:
        start = (np.stack([x, y, np.zeros_like(x)], axis=1) - self.pos) @ self.rot
        way = self.rot[2]
        ends = []
        for shift in (-self.half, self.half):
            ball = start - np.array([0.0, 0.0, shift])
            out = np.square(ball).sum(axis=1) - self.radius**2
            ends.append(_between_roots(np.ones_like(x), ball @ way, out))
        barrel = Cylinder(self.pos, self.rot, self.radius, self.half).cross(x, y)
        ends.append((barrel.low, barrel.high))
        low = np.fmin.reduce([e[0] for e in ends])
        high = np.fmax.reduce([e[1] for e in ends])
        return Crossing(low, high, self._up(start, low), self._up(start, high))

    def _up(self, start: Float, z: Float) -> Float:
        local = start + z[:, None] * self.rot[2]
        local[:, 2] -= np.clip(local[:, 2], -self.half, self.half)
        return local @ self.rot[2] / self.radius

    def support(self, way: Float) -> Float:
        along = np.abs(way @ self.rot[:, 2])
        return way @ self.pos + self.half * along + self.radius * np.linalg.norm(way, axis=1)

    def cuts(self, p: Float) -> tuple[Float, Float]:
        local = (p - self.pos) @ self.rot
        local[:, 2] -= np.clip(local[:, 2], -self.half, self.half)
        norm = np.linalg.norm(local, axis=1, keepdims=True)
        gradient = (local / np.maximum(norm, 1e-300)) @ self.rot.T
        return norm - self.radius, gradient[:, None, :]
