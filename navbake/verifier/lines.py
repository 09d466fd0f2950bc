"""Vertical lines through the obstacles, by MuJoCo's rays."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np

from navbake.types import Vector3
from navbake.verifier.obstacles import CAVITY, CONVEX, HALF_SPACE, HEIGHT_FIELD, SOLID, Obstacles

GEOM = mujoco.mjtGeom
UP, DOWN = 1, -1
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


class Lines:
    """Casts vertical lines."""

    def __init__(self, obstacles: Obstacles) -> None:
        self.obstacles, self._kind = obstacles, obstacles.model.geom_type.tolist()
        self._normal, self._point = np.zeros(3), np.zeros(3)

    def at(self, x: float, y: float) -> Line:
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
        depth, begin = 0, 0.0
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
            for surface in self.at(x + distance * a, y + distance * b).surfaces:
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
            pos, normal = self.obstacles.pos[number], self.obstacles.mat[number, 2::3]
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
        own, kind = self.obstacles, self._kind[geom]
        self._point[:] = x, y, z
        ray = self._point, WAY[way]
        if kind in (GEOM.mjGEOM_MESH, GEOM.mjGEOM_HFIELD):
            cast = mujoco.mj_rayMesh if kind == GEOM.mjGEOM_MESH else mujoco.mj_rayHfield
            distance = cast(own.model, own.data, geom, *ray, self._normal)
        else:
            place = own.pos[geom], own.mat[geom], own.size[geom]
            distance = mujoco.mju_rayGeom(*place, *ray, kind, self._normal)
        return None if distance < 0 else (z + way * distance, float(self._normal[2]))
