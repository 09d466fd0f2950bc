"""What a click meets: the nearest thing on a ray, and the cell there.

Algorithm: Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid.cells import Cell
from navbake.navgrid.grid import NavGrid
from navbake.types import Float
from navbake.views.viewer.mesh.drawing import Surface
from navbake.views.viewer.mesh.overlay import Carpet

BELOW = 0.05  # a floor so much over what was clicked is still under it [m]


class Pick(NamedTuple):
    """What a click has met.

    Attributes:
        cell: level, row and column.
        position: world x, y of the click, and z of the cell's floor, or of the level's ground
            where it has none [m].
        geom: id of the geom that was clicked, None where it was the grid itself.
    """

    cell: Cell
    position: tuple[float, float, float]
    geom: int | None


class Ray(NamedTuple):
    """A line of sight in the world frame."""

    origin: Float  # shape (3,) [m]
    direction: Float  # shape (3,)

    @classmethod
    def of(cls, origin: ArrayLike, direction: ArrayLike) -> Ray:
        """A ray of what a browser tells."""
        return cls(np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64))

    def at(self, distance: float) -> Float:
        """The place at a distance, in lengths of the direction."""
        place: Float = self.origin + distance * self.direction
        return place


def pick(
    grid: NavGrid,
    ray: Ray,
    surfaces: Sequence[Surface],
    carpets: Sequence[Carpet],
    levels: Collection[int],
) -> Pick | None:
    """Find the cell under a click, on one of the levels that are shown; None for none.

    The cell is the one below the nearest thing, be it a geom or the grid. Of several levels it is
    the one whose floor is the nearest below; where none has a floor there, whose ground is.

    Args:
        surfaces: what is drawn of the scene.
        carpets: of all levels, and
        levels: which of them are shown.
    """
    distance, geom = np.inf, None
    for surface in surfaces:
        found, triangle = _meet_triangles(ray, surface)
        if found < distance:
            distance, geom = found, int(surface.geom[triangle])
    for level in levels:
        found = _meet_carpet(ray, carpets[level])
        if found <= distance:
            distance, geom = found, None
    if not np.isfinite(distance):
        return None
    place = ray.at(distance)
    number = _level_below(grid, place, levels)
    if number is None:
        return None
    here = grid.levels[number]
    row, col = (int(v) for v in here.lattice.rows_cols(place))
    floor = float(here.floor_of(np.array(row), np.array(col)))
    z = floor if np.isfinite(floor) else here.ground
    return Pick(Cell(number, row, col), (float(place[0]), float(place[1]), z), geom)


def _meet_triangles(ray: Ray, surface: Surface) -> tuple[float, int]:
    """How far the nearest triangle is, and which it is; infinite for none."""
    if not len(surface.faces):
        return np.inf, -1
    corners = surface.vertices[surface.faces]
    first = corners[:, 0].astype(np.float64)
    along, across = corners[:, 1] - first, corners[:, 2] - first
    normal = np.cross(ray.direction, across)
    volume = (along * normal).sum(axis=1)
    away = ray.origin - first
    turned = np.cross(away, along)
    with np.errstate(divide="ignore", invalid="ignore"):  # a triangle that the ray runs along
        u = (away * normal).sum(axis=1) / volume
        v = turned @ ray.direction / volume
        distance = (across * turned).sum(axis=1) / volume
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    distance = np.where(met, distance, np.inf)
    nearest = int(np.argmin(distance))
    return float(distance[nearest]), nearest


def _meet_carpet(ray: Ray, carpet: Carpet) -> float:
    """How far the nearest cell is that a carpet draws."""
    patches, lattice = carpet.patches, carpet.level.lattice
    if not len(patches.z) or ray.direction[2] == 0:
        return np.inf
    distance = (patches.z + carpet.lift - ray.origin[2]) / ray.direction[2]
    xy = ray.origin[:2] + distance[:, None] * ray.direction[:2]
    rows, cols = lattice.rows_cols(xy)
    met = (distance > 0) & (rows >= patches.rows[:, 0]) & (rows < patches.rows[:, 1])
    met &= (cols >= patches.cols[:, 0]) & (cols < patches.cols[:, 1])
    met[met] &= carpet.shown[rows[met], cols[met]]
    return float(distance[met].min(initial=np.inf))


def _level_below(grid: NavGrid, place: Float, levels: Collection[int]) -> int | None:
    """The level whose floor, or else whose ground, is the nearest below a place."""
    best: tuple[bool, bool, float] | None = None
    found = None
    for number in sorted(levels):
        level = grid.levels[number]
        row, col = (int(v) for v in level.lattice.rows_cols(place))
        if not (0 <= row < level.height and 0 <= col < level.width):
            continue
        floor = float(level.floor_of(np.array(row), np.array(col)))
        has_floor = bool(np.isfinite(floor))
        depth = float(place[2]) - (floor if has_floor else level.ground)
        rank = (not has_floor, depth < -BELOW, abs(depth))
        if best is None or rank < best:
            best, found = rank, number
    return found


def mesh_of(surfaces: Sequence[Surface], geoms: Collection[int]) -> NDArray[np.float32]:
    """The triangles of some geoms, shape (n, 3, 3), world frame [m]."""
    chosen = np.array(sorted(geoms), dtype=np.int32)
    found = [one.vertices[one.faces[np.isin(one.geom, chosen)]] for one in surfaces]
    return np.concatenate([np.empty((0, 3, 3), np.float32), *found])
