"""Vertical lines through the obstacles, by MuJoCo's rays."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from navbake.types import Float
from navbake.verifier.mesh_parts import CAVITY, SOLID
from navbake.verifier.obstacles import CONVEX, HALF_SPACE, HEIGHT_FIELD, Obstacles

GEOM = mujoco.mjtGeom
UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
NEXT = 1e-6  # how far behind one hit of a mesh the next one is looked for [m]
MOST_HITS = 200
SAME = 1e-5  # surfaces this close together are one [m]
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
        finite = obstacles.low[np.isfinite(obstacles.low).all(axis=1)]
        self._bottom = float(finite[:, 2].min()) - BEYOND if len(finite) else -BEYOND
        upper = obstacles.high[np.isfinite(obstacles.high).all(axis=1)]
        self._top = float(upper[:, 2].max()) + BEYOND if len(upper) else BEYOND

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
                # a solid is entered at its underside, a cavity left there
                sign = 1 if kind == SOLID else -1
                for k, surface in enumerate(found):
                    inside.append((surface.z, sign if k % 2 == 0 else -sign))
        surfaces.sort()
        return Line(surfaces, solid + _stretches(inside))

    def _at(self, x: float, y: float, z: float) -> Float:
        self._point[:] = x, y, z
        return self._point

    def _cross(self, number: int, x: float, y: float) -> list[Surface]:
        """The crossings with one obstacle, lowest first."""
        kind = self.obstacles.items[number].kind
        top = max(self._top, BEYOND)
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
        z = min(self._high[number] + BEYOND, top + BEYOND)
        for _ in range(MOST_HITS):
            distance, up = self.ray(number, self._at(x, y, z), DOWN)
            if distance < 0:
                break
            found.append(Surface(z - distance, up, number))
            z -= distance + NEXT
        return found[::-1]

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
