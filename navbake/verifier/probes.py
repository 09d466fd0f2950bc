"""What vertical lines meet in a scene, by MuJoCo's rays, and what upright columns touch.

FCL and MuJoCo both say what a column touches. Where they contradict each other, a plane that is
proved to separate the two shapes decides; MuJoCo's `mj_geomDistance` is off by centimetres in rare
poses of capsules, and FCL's iteration may end early.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import fcl
import mujoco
import numpy as np

from navbake.types import Float, Vector3
from navbake.verifier.obstacles import CAVITY, CONVEX, HALF_SPACE, HEIGHT_FIELD, SOLID, Obstacles

GEOM = mujoco.mjtGeom
UP = 1
DOWN = -1
WAY = {UP: np.array([0.0, 0.0, 1.0]), DOWN: np.array([0.0, 0.0, -1.0])}
NEXT = 1e-6  # how far behind one hit of a mesh the next one is looked for [m]
MOST_HITS = 200
SAME = 1e-5  # surfaces this close together are one [m]
FACES_UP = 1e-6  # least z of the unit normal of what faces up
CRACK = 0.03  # width of a crack that is no gap, unless the settings say otherwise [m]
RIM = 1e-6  # a line this near to an edge may meet it or not [m]
SPACING = 1 / 3  # of reach: no place within it is farther than this from a line beside
AROUND = [(np.cos(a), np.sin(a)) for a in np.arange(16) * (np.pi / 8)]
BEYOND = 1.0  # how far from all geometry a line begins [m]

# a dispute counts as a touch where margins are measured
APART = 0
TOUCHES = 1
DISPUTED = 2
SEPARATED = 1e-7  # least width of a gap that a plane proves [m]
REACH = 1.0  # how far from a column the nearest obstacle is looked for [m]
HALVINGS = 14  # of an interval of at most `REACH`: to a tenth of a millimetre


class Surface(NamedTuple):
    """A crossing of a vertical line: its height [m], the normal's z, and the obstacle."""

    z: float
    up: float
    number: int


class Line(NamedTuple):
    """What a vertical line meets: crossings, lowest first, and stretches inside of solids [m]."""

    surfaces: list[Surface]
    solid: list[tuple[float, float]]

    def is_inside(self, z: float) -> bool:
        """Whether a height lies inside of a solid, or is covered by one that stands on it."""
        return any(low <= z + SAME and high > z + SAME for low, high in self.solid)

    def faces_up(self, low: float, high: float) -> bool:
        """Whether a surface between two heights faces up [m], also inside of a solid."""
        return any(s.up >= FACES_UP and low <= s.z <= high for s in self.surfaces)

    def standable(self, height: float, min_up: float) -> list[Surface]:
        """The surfaces that one can stand on, lowest first, one of several at one height."""
        found: list[Surface] = []
        for surface in self.surfaces:
            if surface.up < min_up - 1e-6 or self.is_inside(surface.z):
                continue
            ceiling = min((s.z for s in self.surfaces if s.z > surface.z + SAME), default=np.inf)
            is_other = not found or surface.z - found[-1].z > SAME
            if ceiling - surface.z >= height and is_other:
                found.append(surface)
        return found


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
    c = np.cos(yaw)
    s = np.sin(yaw)
    mat = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    shape = fcl.Cylinder(x, 2 * z) if is_round else fcl.Box(2 * x, 2 * y, 2 * z)
    return fcl.CollisionObject(shape, fcl.Transform(mat, np.zeros(3))), mat


class Probes:
    """Casts vertical lines among obstacles, and puts one column after the other there."""

    def __init__(self, obstacles: Obstacles) -> None:
        self.obstacles = obstacles
        self._column = Column(0.0, 0.0, 0.0, False)
        self._made = lru_cache(4096)(_make)
        self._kind = obstacles.model.geom_type.tolist()
        self._normal = np.zeros(3)
        self._point = np.zeros(3)

    def line(self, x: float, y: float) -> Line:
        """All that the vertical line at x, y meets [m]."""
        surfaces: list[Surface] = []
        solid: list[tuple[float, float]] = []
        inside: list[tuple[float, int]] = []
        for number in self.obstacles.meeting((x, y, -np.inf), (x, y, np.inf)):
            kind = self.obstacles.items[number].kind
            found = self._cross(number, x, y)
            surfaces += found
            if kind == HALF_SPACE and found and found[0].up > 0:
                solid.append((-np.inf, found[0].z))
            elif kind in (CONVEX, HEIGHT_FIELD) and found:
                solid.append((found[0].z, found[-1].z))
            elif kind in (SOLID, CAVITY):
                # what faces down is the underside of something solid, also of what is over a cavity
                inside += [(surface.z, 1 if surface.up < 0 else -1) for surface in found]
        # where the line is inside of more solids than cavities
        depth = 0
        begin = 0.0
        for z, step in sorted(inside):
            if depth <= 0 < depth + step:
                begin = z
            elif depth > 0 >= depth + step:
                solid.append((begin, z))
            depth += step
        return Line(sorted(surfaces), solid)

    def faces_up_beside(
        self, at: Vector3, off: float, reach: float = CRACK, *, min_up: float = np.inf
    ) -> bool:
        """Whether a surface faces up within reach of a place [m]: its line may run through a crack.

        It may be `off` above or below, and more on a slope whose normal's z is at least `min_up`.
        """
        x, y, z = at
        beyond = np.array([reach + RIM, reach + RIM, off])
        if not self.obstacles.meeting(at - beyond, at + beyond):
            return False
        for distance, (a, b) in product((RIM, reach / 4, reach / 2, reach), AROUND):
            for surface in self.line(x + distance * a, y + distance * b).surfaces:
                if surface.up < FACES_UP:
                    continue
                slope = np.sqrt(max(1 / surface.up**2 - 1, 0.0)) if surface.up >= min_up else 0.0
                if abs(surface.z - z) <= off + slope * reach * SPACING:
                    return True
        return False

    def crossings(self, number: int, point: Vector3) -> tuple[int, int]:
        """How often the way up from a point leaves what is solid of a surface, and enters it."""
        geoms = self.obstacles.facing.get(number, [number])
        hits = [up for geom in geoms for _, up in self._hits(geom, *point, UP)]
        if self._kind[number] == GEOM.mjGEOM_HFIELD:  # its underside is entered first
            return (len(hits) + 1) // 2, len(hits) // 2
        return sum(up > 0 for up in hits), sum(up < 0 for up in hits)

    def _cross(self, number: int, x: float, y: float) -> list[Surface]:
        """The crossings with one obstacle, lowest first."""
        kind = self.obstacles.items[number].kind
        if kind == HALF_SPACE:
            pos = self.obstacles.pos[number]
            normal = self.obstacles.mat[number, 2::3]
            if abs(normal[2]) < 1e-9:
                return []
            z = pos[2] - ((x - pos[0]) * normal[0] + (y - pos[1]) * normal[1]) / normal[2]
            return [Surface(float(z), float(normal[2]), number)]
        above = float(self.obstacles.items[number].high[2]) + BEYOND
        below = float(self.obstacles.items[number].low[2]) - BEYOND
        if kind in (CONVEX, HEIGHT_FIELD):
            ends = self._ray(number, x, y, below, UP), self._ray(number, x, y, above, DOWN)
            found = [end for end in ends if end is not None]
        else:
            geoms = self.obstacles.facing.get(number, [number])
            found = sorted(hit for geom in geoms for hit in self._hits(geom, x, y, above, DOWN))
        return [Surface(*hit, number) for hit in found]

    def _hits(self, geom: int, x: float, y: float, z: float, way: int) -> list[tuple[float, float]]:
        """All that a vertical ray from a point meets of a geom of the model, as `_ray`."""
        found: list[tuple[float, float]] = []
        while len(found) < MOST_HITS and (hit := self._ray(geom, x, y, z, way)) is not None:
            found.append(hit)
            z = hit[0] + way * NEXT
        return found

    def _ray(self, geom: int, x: float, y: float, z: float, way: int) -> tuple[float, float] | None:
        """Where a vertical ray first meets a geom of the model: z [m], and z of the unit normal."""
        own = self.obstacles
        kind = self._kind[geom]
        self._point[:] = x, y, z
        ray = self._point, WAY[way]
        if kind in (GEOM.mjGEOM_MESH, GEOM.mjGEOM_HFIELD):
            cast = mujoco.mj_rayMesh if kind == GEOM.mjGEOM_MESH else mujoco.mj_rayHfield
            distance = cast(own.model, own.data, geom, *ray, self._normal)
        else:
            place = own.pos[geom], own.mat[geom], own.size[geom]
            distance = mujoco.mju_rayGeom(*place, *ray, kind, self._normal)
        return None if distance < 0 else (z + way * distance, float(self._normal[2]))

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
            obstacles.size[geom] = size
            obstacles.mat[geom] = self._mat.ravel()
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
        ends = np.zeros((2, 3))
        obstacles = self.obstacles
        model = obstacles.model
        data = obstacles.data
        mujoco.mj_geomDistance(model, data, self._geom, number, 10.0, ends.ravel())
        result = fcl.DistanceResult()
        request = fcl.DistanceRequest(enable_nearest_points=True)
        fcl.distance(self._object, obstacles.items[number].shape, request, result)
        middle = obstacles.pos[number] - self._center
        mat = obstacles.mat[number].reshape(3, 3)
        ways = [ends[1] - ends[0], np.subtract(*result.nearest_points[::-1])]
        ways += [middle, middle * [1.0, 1.0, 0.0], *np.eye(3), *-np.eye(3), *self._mat.T]
        half_x, half_y, half_z, is_round, _ = self._column
        for way in (*ways, *mat.T, *-mat.T):
            length = float(np.linalg.norm(way))
            if 1e-12 < length < np.inf:
                unit = way / length
                x, y, z = np.abs(self._mat.T @ unit)
                across = half_x * np.hypot(x, y) if is_round else half_x * x + half_y * y
                end = float(self._center @ unit + across + half_z * z)  # of the column
                if -obstacles.support(number, -unit) - end > SEPARATED:
                    return True
        return False

    def depth(self, column: Column, center: Float, number: int) -> float:
        """By how much a column must shrink to leave an obstacle [m], up to half its least size."""
        return -self._margin(column, center, number, -min(column[:3]), 0.0)

    def nearest(self, column: Column, center: Float) -> tuple[float, int] | None:
        """By how much a column has to grow to touch anything within `REACH` [m], and what."""
        reach = np.array(column[:3]) + REACH
        nearest = None
        gap = REACH
        for number in self.obstacles.meeting(center - reach, center + reach):
            if self.touches(number, column, center, gap):
                nearest = number
                gap = self._margin(column, center, number, 0.0, gap)
        return None if nearest is None else (gap, nearest)

    def _margin(self, column: Column, center: Float, number: int, low: float, high: float) -> float:
        """The margin by which a column has to grow to touch an obstacle, by bisection [m]."""
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            is_met = self.touches(number, column, center, middle)
            low, high = (low, middle) if is_met else (middle, high)
        return high
