"""Upright boxes and cylinders that are put into the scene, and asked what they touch.

FCL and MuJoCo both answer. Where they contradict each other, a plane that is proved to separate
the two shapes decides; MuJoCo's `mj_geomDistance` is off by centimetres in rare poses of capsules,
and FCL's iteration may end early.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import fcl
import mujoco
import numpy as np

from navbake.types import Float
from navbake.verifier.obstacles import Obstacles

APART, TOUCHES, DISPUTED = 0, 1, 2
SEPARATED = 1e-7  # least width of a gap that a plane proves [m]
FARTHEST = 1.0  # how far from a column the nearest obstacle is looked for [m]
HALVINGS = 14  # of an interval of at most `FARTHEST`: to a tenth of a millimetre


class Column(NamedTuple):
    """An upright prism: a box, which may be turned round the vertical, or a cylinder [m]."""

    half_x: float  # of a cylinder both are its radius
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
        self._object = fcl.CollisionObject(
            fcl.Cylinder(x, 2 * z) if is_round else fcl.Box(2 * x, 2 * y, 2 * z)
        )
        self._geom = obstacles.probe_geom(is_round=is_round)
        self._size = np.array([x, z, 0.0] if is_round else [x, y, z])
        self._mat, self._center, self._is_turned = np.eye(3), np.zeros(3), False

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
        ends, obstacles = np.zeros((2, 3)), self._obstacles
        model, data = obstacles.model, obstacles.data
        mujoco.mj_geomDistance(model, data, self._geom, number, 10.0, ends.ravel())
        result = fcl.DistanceResult()
        request = fcl.DistanceRequest(enable_nearest_points=True)
        fcl.distance(self._object, obstacles.items[number].shape, request, result)
        middle = obstacles.pos[number] - self._center
        mat = obstacles.mat[number].reshape(3, 3)
        ways = [ends[1] - ends[0], np.subtract(*result.nearest_points[::-1])]
        ways += [middle, middle * [1.0, 1.0, 0.0], *np.eye(3), *-np.eye(3), *self._mat.T]
        for way in (*ways, *mat.T, *-mat.T):
            length = float(np.linalg.norm(way))
            if 1e-12 < length < np.inf:
                unit = way / length
                if -obstacles.support(number, -unit) - self._support(unit) > SEPARATED:
                    return True
        return False

    def _support(self, way: Float) -> float:
        """How far it reaches along a unit vector [m]."""
        (half_x, half_y, half_z, is_round), local = self.column, self._mat.T @ way
        if is_round:
            across = half_x * float(np.hypot(local[0], local[1]))
        else:
            across = half_x * abs(local[0]) + half_y * abs(local[1])
        return float(self._center @ way + across + half_z * abs(local[2]))


class Probes:
    """Probes of the columns that are asked for, each made once."""

    def __init__(self, obstacles: Obstacles) -> None:
        self.obstacles = obstacles
        self._made = lru_cache(4096)(lambda column: Probe(column, obstacles))

    def of(self, column: Column) -> Probe:
        """The probe of a column, ready to be placed."""
        probe = self._made(column)
        probe.select()
        return probe

    def depth(self, column: Column, center: Float, number: int, yaw: float = 0.0) -> float:
        """By how much a column has to shrink on all sides to leave an obstacle [m].

        At most half of its least size, where it touches at its very middle.
        """
        return -self._margin(column, center, number, -min(column[:3]), 0.0, yaw)

    def nearest(self, column: Column, center: Float) -> tuple[float, int] | None:
        """By how much a column has to grow on all sides to touch anything [m], and what it touches.

        None if nothing is within `FARTHEST`.
        """
        reach = np.array(column[:3]) + FARTHEST
        nearest, gap = None, FARTHEST
        for number in self.obstacles.meeting(center - reach, center + reach):
            if self._touches(column, center, number, gap):
                nearest, gap = number, self._margin(column, center, number, 0.0, gap)
        return None if nearest is None else (gap, nearest)

    def _margin(
        self, column: Column, center: Float, number: int, low: float, high: float, yaw: float = 0.0
    ) -> float:
        """The margin by which a column has to grow to touch an obstacle, by bisection [m]."""
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            if self._touches(column, center, number, middle, yaw):
                high = middle
            else:
                low = middle
        return high

    def _touches(
        self, column: Column, center: Float, number: int, margin: float, yaw: float = 0.0
    ) -> bool:
        grown = column.grown(margin)
        if grown is None:
            return False
        probe = self.of(grown)
        probe.place(center, yaw)
        return probe.touches(number) != APART
