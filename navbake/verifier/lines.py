"""Vertical lines through the obstacles, by MuJoCo's rays."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np

from navbake.types import Float, Vector3
from navbake.verifier.obstacles import CAVITY, CONVEX, HALF_SPACE, HEIGHT_FIELD, SOLID, Obstacles

GEOM = mujoco.mjtGeom
UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
NEXT = 1e-6  # how far behind one hit of a mesh the next one is looked for [m]
MOST_HITS = 200
SAME = 1e-5  # surfaces this close together are one [m]
FACES_UP = 1e-6  # least z of the unit normal of what faces up
CRACK = 0.03  # width of a crack that is no gap, unless the settings say otherwise [m]
RIM = 1e-6  # a line this near to an edge may meet it or not [m]
SPACING = 1 / 3  # of reach: no place within it is farther than this from a line beside
WAYS = [(np.cos(a), np.sin(a)) for a in np.arange(16) * (np.pi / 8)]
BEYOND = 1.0  # how far from all geometry a line begins [m]


class Surface(NamedTuple):
    """A crossing of a vertical line: its height [m], the normal's z, and the obstacle."""

    z: float
    up: float
    number: int


class Line(NamedTuple):
    """What a vertical line meets.

    Attributes:
        surfaces: the crossings, lowest first.
        solid: the stretches inside of something solid: lower and upper end [m].
    """

    surfaces: list[Surface]
    solid: list[tuple[float, float]]

    def is_inside(self, z: float) -> bool:
        """Whether a height lies inside of a solid, or is covered by one that stands on it."""
        return any(low <= z + SAME and high > z + SAME for low, high in self.solid)

    def faces_up(self, low: float, high: float) -> bool:
        """Whether a surface between two heights faces up [m].

        It may lie inside of a solid: floors go on under things.
        """
        return any(s.up >= FACES_UP and low <= s.z <= high for s in self.surfaces)

    def headroom(self, z: float) -> float:
        """The distance to the next surface above [m]; infinite under the open sky."""
        return min((s.z for s in self.surfaces if s.z > z + SAME), default=np.inf) - z

    def standable(self, height: float, min_up: float) -> list[Surface]:
        """The surfaces that one can stand on, lowest first, one of several at one height."""
        found: list[Surface] = []
        for surface in self.surfaces:
            if surface.up < min_up - 1e-6 or self.is_inside(surface.z):
                continue
            if self.headroom(surface.z) < height:
                continue
            if found and surface.z - found[-1].z <= SAME:
                continue
            found.append(surface)
        return found


class Lines:
    """Casts vertical lines."""

    def __init__(self, obstacles: Obstacles) -> None:
        self.obstacles = obstacles
        self._normal, self._point = np.zeros(3), np.zeros(3)
        self._kind: list[int] = obstacles.model.geom_type.tolist()
        self._low, self._high = obstacles.low[:, 2].tolist(), obstacles.high[:, 2].tolist()

    def ray(self, number: int, point: Float, way: Float) -> tuple[float, float]:
        """Distance to an obstacle along a way [m], -1 for none, and the z of its normal there."""
        model, data, normal = self.obstacles.model, self.obstacles.data, self._normal
        kind = self._kind[number]
        if kind == GEOM.mjGEOM_MESH:
            distance = mujoco.mj_rayMesh(model, data, number, point, way, normal)
        elif kind == GEOM.mjGEOM_HFIELD:
            distance = mujoco.mj_rayHfield(model, data, number, point, way, normal)
        else:
            pos, mat = self.obstacles.pos[number], self.obstacles.mat[number]
            size = self.obstacles.size[number]
            distance = mujoco.mju_rayGeom(pos, mat, size, point, way, kind, normal)
        return distance, float(normal[2])

    def at(self, x: float, y: float) -> Line:
        """All that the vertical line at x, y meets [m]."""
        surfaces: list[Surface] = []
        solid: list[tuple[float, float]] = []
        inside: list[tuple[float, int]] = []
        for number in self.obstacles.over(x, y):
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
        surfaces.sort()
        return Line(surfaces, solid + _stretches(inside))

    def faces_up_beside(
        self,
        x: float,
        y: float,
        low: float,
        high: float,
        reach: float = CRACK,
        *,
        min_up: float = np.inf,
    ) -> bool:
        """Whether a surface between two heights faces up within reach of a line [m].

        So it is where the line runs through a crack, or past a rim. Lines are cast at some places
        beside it.

        Args:
            min_up: least z of the normal of floors that count also between these lines, where
                their slope may take them.
        """
        side = reach + RIM
        if not self.obstacles.meets_box(
            np.array([x - side, y - side, low]), np.array([x + side, y + side, high])
        ):
            return False
        for distance, (a, b) in product((RIM, reach / 4, reach / 2, reach), WAYS):
            for surface in self.at(x + distance * a, y + distance * b).surfaces:
                if surface.up < FACES_UP:
                    continue
                slope = np.sqrt(max(1 / surface.up**2 - 1, 0.0)) if surface.up >= min_up else 0.0
                more = slope * reach * SPACING
                if low - more <= surface.z <= high + more:
                    return True
        return False

    def _at(self, x: float, y: float, z: float) -> Float:
        self._point[:] = x, y, z
        return self._point

    def _cross(self, number: int, x: float, y: float) -> list[Surface]:
        """The crossings with one obstacle, lowest first."""
        kind = self.obstacles.items[number].kind
        if kind in (CONVEX, HEIGHT_FIELD):
            above, below = self._high[number] + BEYOND, self._low[number] - BEYOND
            down, up = self.ray(number, self._at(x, y, above), DOWN)
            if down < 0:
                return []
            upper = Surface(above - down, up, number)
            rise, under = self.ray(number, self._at(x, y, below), UP)
            lower = Surface(below + rise, under, number) if rise >= 0 else upper
            return [lower, upper]
        if kind == HALF_SPACE:
            return self._cross_plane(number, x, y)
        found: list[Surface] = []
        for geom in self.obstacles.facing.get(number, [number]):
            hits = self._hits(geom, (x, y, self._high[number] + BEYOND), DOWN)
            found += [Surface(z, up, number) for z, up in hits]
        return sorted(found)

    def crossings(self, number: int, point: Vector3) -> tuple[int, int]:
        """How often the way up from a point leaves what is solid of a surface, and enters it."""
        geoms = self.obstacles.facing.get(number, [number])
        hits = [up for geom in geoms for _, up in self._hits(geom, point, UP)]
        if self._kind[number] == GEOM.mjGEOM_HFIELD:  # its underside is entered first
            return (len(hits) + 1) // 2, len(hits) // 2
        return sum(up > 0 for up in hits), sum(up < 0 for up in hits)

    def _hits(self, geom: int, point: Vector3, way: Float) -> list[tuple[float, float]]:
        """Where a vertical ray from a point meets a geom of the model: z, and z of the normal."""
        (x, y, z), found = point, list[tuple[float, float]]()
        for _ in range(MOST_HITS):
            distance, up = self.ray(geom, self._at(x, y, z), way)
            if distance < 0:
                break
            found.append((z + way[2] * distance, up))
            z += way[2] * (distance + NEXT)
        return found

    def _cross_plane(self, number: int, x: float, y: float) -> list[Surface]:
        """Where the line meets an infinite plane: a ray meets its front alone."""
        normal = self.obstacles.mat[number, 2::3]
        if abs(normal[2]) < 1e-9:
            return []
        pos = self.obstacles.pos[number]
        z = pos[2] - ((x - pos[0]) * normal[0] + (y - pos[1]) * normal[1]) / normal[2]
        start, way = (z + BEYOND, DOWN) if normal[2] > 0 else (z - BEYOND, UP)
        distance, _ = self.ray(number, self._at(x, y, start), way)
        return [Surface(start + way[2] * distance, float(normal[2]), number)]


def _stretches(ends: list[tuple[float, int]]) -> list[tuple[float, float]]:
    """Where a line is inside of more solids than cavities."""
    found, depth, begin = [], 0, 0.0
    for z, step in sorted(ends):
        if depth <= 0 < depth + step:
            begin = z
        elif depth > 0 >= depth + step:
            found.append((begin, z))
        depth += step
    return found
