"""Upright boxes and cylinders that are put into the scene, and asked what they touch.

FCL and MuJoCo both answer. Where they contradict each other, a plane that is proved to separate
the two shapes decides; MuJoCo's `mj_geomDistance` is off by centimetres in rare poses of capsules,
and FCL's iteration may end early.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import fcl
import mujoco
import numpy as np

from navbake.types import Float
from navbake.verifier.obstacles import CONVEX, HALF_SPACE, Obstacles

APART, TOUCHES, DISPUTED = 0, 1, 2
SEPARATED = 1e-7  # least width of a gap that a plane proves [m]
FARTHEST = 1.0  # how far from a column the nearest obstacle is looked for [m]
GEOM = mujoco.mjtGeom


class Column(NamedTuple):
    """An upright prism: a box, which may be turned round the vertical, or a cylinder.

    Attributes:
        half_x, half_y: half-sizes of the box [m]; of a cylinder both are its radius.
        half_z: half of its height [m].
        is_round: whether it is a cylinder.
    """

    half_x: float
    half_y: float
    half_z: float
    is_round: bool

    def grown(self, margin: float) -> Column | None:
        """The same, larger on all sides [m], or smaller; None if nothing is left."""
        x, y, z = (half + margin for half in self[:3])
        return Column(x, y, z, self.is_round) if min(x, y, z) > 0 else None


class Probe:
    """A column that can be placed anywhere."""

    def __init__(self, column: Column, obstacles: Obstacles) -> None:
        self.column, self._obstacles = column, obstacles
        x, y, z, is_round = column
        shape = fcl.Cylinder(x, 2 * z) if is_round else fcl.Box(2 * x, 2 * y, 2 * z)
        self._object = fcl.CollisionObject(shape)
        self._geom = obstacles.cylinder_probe if is_round else obstacles.box_probe
        self._size = np.array([x, z, 0.0] if is_round else [x, y, z])
        self._mat = np.eye(3)
        self._center = np.zeros(3)
        self._is_turned = False

    def place(self, center: Float, yaw: float = 0.0) -> None:
        """Move it: its centre, shape (3,) [m], and its turn round the vertical [rad]."""
        self._center = center
        if yaw or self._is_turned:
            c, s = np.cos(yaw), np.sin(yaw)
            self._mat = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            self._object.setTransform(fcl.Transform(self._mat, center))
            self._is_turned = True
        else:
            self._object.setTranslation(center)

    def select(self) -> None:
        """Give MuJoCo's probe this column's size; to be called before a run of questions."""
        self._obstacles.size[self._geom] = self._size
        radius = np.linalg.norm(self._size) + self._size.max()
        self._obstacles.model.geom_rbound[self._geom] = radius
        self._obstacles.mat[self._geom] = self._mat.ravel()

    def touches(self, number: int) -> int:
        """APART, TOUCHES or DISPUTED: how it stands to an obstacle."""
        item = self._obstacles.items[number]
        by_fcl = fcl.collide(self._object, item.shape) > 0
        if not item.same_in_mujoco:
            return TOUCHES if by_fcl else APART
        model, data = self._obstacles.model, self._obstacles.data
        self._obstacles.pos[self._geom] = self._center
        if self._is_turned:
            self._obstacles.mat[self._geom] = self._mat.ravel()
        by_mujoco = mujoco.mj_geomDistance(model, data, self._geom, number, 1e-3, None) <= 0.0
        if by_fcl == by_mujoco:
            return TOUCHES if by_fcl else APART
        if self._is_separated(number):
            return APART
        return TOUCHES if by_fcl else DISPUTED

    def _is_separated(self, number: int) -> bool:
        """Whether one of a few planes provably lies between it and an obstacle."""
        ends = np.zeros((2, 3))
        model, data = self._obstacles.model, self._obstacles.data
        mujoco.mj_geomDistance(model, data, self._geom, number, 10.0, ends.ravel())
        result = fcl.DistanceResult()
        request = fcl.DistanceRequest(enable_nearest_points=True)
        fcl.distance(self._object, self._obstacles.items[number].shape, request, result)
        ways = [ends[1] - ends[0], np.subtract(*result.nearest_points[::-1])]
        middle = self._obstacles.pos[number] - self._center
        ways += [middle, middle * [1.0, 1.0, 0.0], *np.eye(3), *-np.eye(3), *self._mat.T]
        mat = self._obstacles.mat[number].reshape(3, 3)
        ways += [*mat.T, *-mat.T]
        for way in ways:
            length = float(np.linalg.norm(way))
            if not 1e-12 < length < np.inf:
                continue
            unit = way / length
            gap = -support(self._obstacles, number, -unit) - self._support(unit)
            if gap > SEPARATED:
                return True
        return False

    def _support(self, way: Float) -> float:
        """How far it reaches along a unit vector [m]."""
        column, local = self.column, self._mat.T @ way
        if column.is_round:
            across = column.half_x * float(np.hypot(local[0], local[1]))
        else:
            across = column.half_x * abs(local[0]) + column.half_y * abs(local[1])
        return float(self._center @ way + across + column.half_z * abs(local[2]))


def support(obstacles: Obstacles, number: int, way: Float) -> float:
    """How far a convex obstacle or a half-space reaches along a unit vector [m]; may be inf."""
    item = obstacles.items[number]
    if len(item.points):
        return float((item.points @ way).max())
    pos, mat = obstacles.pos[number], obstacles.mat[number].reshape(3, 3)
    if item.kind == HALF_SPACE:
        return float(pos @ way) if way @ mat[:, 2] > 1 - 1e-12 else np.inf
    if item.kind != CONVEX:
        return np.inf
    size, local = obstacles.size[number], mat.T @ way
    kind = int(obstacles.model.geom_type[number])
    if kind == GEOM.mjGEOM_SPHERE:
        reach = size[0]
    elif kind == GEOM.mjGEOM_CAPSULE:
        reach = size[0] + size[1] * abs(local[2])
    elif kind == GEOM.mjGEOM_ELLIPSOID:
        reach = np.linalg.norm(size * local)
    elif kind == GEOM.mjGEOM_CYLINDER:
        reach = size[0] * np.hypot(local[0], local[1]) + size[1] * abs(local[2])
    else:
        reach = (size * np.abs(local)).sum()
    return float(pos @ way + reach)


class Probes:
    """Probes of the columns that are asked for, each made once."""

    def __init__(self, obstacles: Obstacles) -> None:
        self.obstacles = obstacles
        self._made: dict[Column, Probe] = {}

    def of(self, column: Column) -> Probe:
        """The probe of a column, ready to be placed."""
        if column not in self._made:
            if len(self._made) > 4096:
                self._made.clear()
            self._made[column] = Probe(column, self.obstacles)
        probe = self._made[column]
        probe.select()
        return probe


def depth_of(probes: Probes, column: Column, center: Any, number: int, yaw: float = 0.0) -> float:
    """By how much a column has to shrink on all sides until it no longer touches an obstacle [m].

    Found by bisection with FCL; at most half of the column's least size, where it touches at its
    very middle.
    """
    low, high = 0.0, min(column[:3])
    for _ in range(12):
        middle = (low + high) / 2
        smaller = column.grown(-middle)
        if smaller is None:
            break
        probe = probes.of(smaller)
        probe.place(center, yaw)
        low, high = (middle, high) if probe.touches(number) == TOUCHES else (low, middle)
    return low


def nearest_to(probes: Probes, column: Column, center: Float) -> tuple[float, int] | None:
    """By how much a column has to grow on all sides to touch anything [m], and what it touches.

    Found by bisection; None if nothing is within `FARTHEST`.
    """
    obstacles = probes.obstacles
    reach = np.array(column[:3]) + FARTHEST
    near = (obstacles.low < center + reach).all(axis=1)
    near &= (obstacles.high > center - reach).all(axis=1)
    nearest, gap = None, FARTHEST
    for number in np.flatnonzero(near).tolist():
        if not _touches_grown(probes, column, center, number, gap):
            continue
        low = 0.0
        for _ in range(14):  # to a tenth of a millimetre
            middle = (low + gap) / 2
            touches = _touches_grown(probes, column, center, number, middle)
            low, gap = (low, middle) if touches else (middle, gap)
        nearest = number
    return None if nearest is None else (gap, nearest)


def _touches_grown(
    probes: Probes, column: Column, center: Float, number: int, margin: float
) -> bool:
    grown = column.grown(margin)
    if grown is None:
        return False
    probe = probes.of(grown)
    probe.place(center)
    return probe.touches(number) != APART
