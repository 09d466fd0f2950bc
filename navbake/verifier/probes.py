"""Upright boxes and cylinders that are put into the scene, and asked what they touch.

FCL and MuJoCo both answer. Where they contradict each other, a plane that is proved to separate
the two shapes decides; MuJoCo's `mj_geomDistance` is off by centimetres in rare poses of capsules,
and FCL's iteration may end early.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import fcl
import mujoco
import numpy as np

from navbake.types import Float
from navbake.verifier.obstacles import Obstacles

APART, TOUCHES, DISPUTED = 0, 1, 2  # a dispute counts as a touch where margins are measured
SEPARATED = 1e-7  # least width of a gap that a plane proves [m]
FARTHEST = 1.0  # how far from a column the nearest obstacle is looked for [m]
HALVINGS = 14  # of an interval of at most `FARTHEST`: to a tenth of a millimetre


class Column(NamedTuple):
    """An upright prism: a box or a cylinder, which may be turned round the vertical [m, rad]."""

    half_x: float  # of a cylinder both are its radius
    half_y: float
    half_z: float
    is_round: bool
    yaw: float = 0.0


def _make(column: Column) -> tuple[Any, Float]:
    """A column as FCL's object, and its frame."""
    x, y, z, is_round, yaw = column
    c, s = np.cos(yaw), np.sin(yaw)
    mat = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    shape = fcl.Cylinder(x, 2 * z) if is_round else fcl.Box(2 * x, 2 * y, 2 * z)
    return fcl.CollisionObject(shape, fcl.Transform(mat, np.zeros(3))), mat


class Probes:
    """Puts one column after the other among obstacles."""

    def __init__(self, obstacles: Obstacles) -> None:
        self.obstacles, self._column = obstacles, Column(0.0, 0.0, 0.0, False)
        self._made = lru_cache(4096)(_make)

    def touches(self, number: int, column: Column, center: Float, margin: float = 0.0) -> int:
        """APART, TOUCHES or DISPUTED: how a column at a centre, (3,) [m], stands to an obstacle.

        It is larger on all sides by a margin [m], or smaller; where nothing is left, it is apart.
        """
        obstacles = self.obstacles
        x, y, z = (half + margin for half in column[:3])
        if min(x, y, z) <= 0:
            return APART
        column = Column(x, y, z, *column[3:])
        if column != self._column:
            self._column, (self._object, self._mat) = column, self._made(column)
            self._geom = geom = len(obstacles.items) + column.is_round
            size = np.array([x, z, 0.0] if column.is_round else [x, y, z])
            obstacles.size[geom], obstacles.mat[geom] = size, self._mat.ravel()
            obstacles.model.geom_rbound[geom] = np.linalg.norm(size) + size.max()
        self._center = obstacles.pos[self._geom] = center
        self._object.setTranslation(center)
        item = obstacles.items[number]
        by_fcl = fcl.collide(self._object, item.shape) > 0
        if not item.same_in_mujoco:
            return TOUCHES if by_fcl else APART
        pair = self._geom, number
        by_mujoco = mujoco.mj_geomDistance(obstacles.model, obstacles.data, *pair, 1e-3, None) <= 0
        if by_fcl == by_mujoco:
            return TOUCHES if by_fcl else APART
        if self._is_separated(number):
            return APART
        return TOUCHES if by_fcl else DISPUTED

    def _is_separated(self, number: int) -> bool:
        """Whether one of a few planes provably lies between the column and an obstacle."""
        ends, obstacles = np.zeros((2, 3)), self.obstacles
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
        """How far the column reaches along a unit vector [m]."""
        half_x, half_y, half_z, is_round, _ = self._column
        x, y, z = np.abs(self._mat.T @ way)
        across = half_x * np.hypot(x, y) if is_round else half_x * x + half_y * y
        return float(self._center @ way + across + half_z * z)

    def depth(self, column: Column, center: Float, number: int) -> float:
        """By how much a column must shrink to leave an obstacle [m], up to half its least size."""
        return -self._margin(column, center, number, -min(column[:3]), 0.0)

    def nearest(self, column: Column, center: Float) -> tuple[float, int] | None:
        """By how much a column has to grow to touch anything within `FARTHEST` [m], and what."""
        reach = np.array(column[:3]) + FARTHEST
        nearest, gap = None, FARTHEST
        for number in self.obstacles.meeting(center - reach, center + reach):
            if self.touches(number, column, center, gap):
                nearest, gap = number, self._margin(column, center, number, 0.0, gap)
        return None if nearest is None else (gap, nearest)

    def _margin(self, column: Column, center: Float, number: int, low: float, high: float) -> float:
        """The margin by which a column has to grow to touch an obstacle, by bisection [m]."""
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            is_met = self.touches(number, column, center, middle)
            low, high = (low, middle) if is_met else (middle, high)
        return high
