"""The nearest place where an agent can stand."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.places.checks import check_distance
from navbake.runtime.places.navigable import MAX_DROP
from navbake.runtime.places.sample import cells_in_annulus
from navbake.runtime.places.sight import Sight
from navbake.types import Bool, Float

# Functions import kernels when they run: numba takes long to load.

FIRST_LOOK = 1.0  # metres round a position that are searched first for what is in sight


def snap_to(
    flat: FlatGrid,
    position: ArrayLike,
    allowed: Bool,
    *,
    level: int | None = None,
    same_level: bool = True,
    sight: Sight | None = None,
    max_distance: float = math.inf,
) -> Float | None:
    """`PathFinder.snap`, to the allowed cells of a mask; in sight, if `sight` is given."""
    check_distance(max_distance)
    p, home = flat.locate(position, level)
    if home is not None and allowed[home]:
        floor = flat.positions(home)[2]
        if level is not None or len(p) == 2 or p[2] - floor <= MAX_DROP:
            return np.append(p[:2], floor)
    if level is None and home is not None:
        level = int(flat.level_of(home))
    on_map = level is not None and (same_level or len(p) == 2)
    levels = [level] if on_map and level is not None else list(range(flat.num_levels))
    if len(p) == 2:
        p = np.append(p, flat.floors.ground[level or 0])
    nearby = _Nearby(flat, p, allowed, levels, float(max_distance), on_map)
    cell = nearby.nearest() if sight is None else nearby.nearest_in_sight(home, sight)
    return flat.positions(cell) if cell >= 0 else None


def nearest_on_level(
    flat: FlatGrid,
    position: ArrayLike,
    mask: Bool,
    *,
    level: int | None = None,
    max_distance: float = math.inf,
) -> int | None:
    """The cell of a mask with the nearest centre on the position's level; None for none."""
    check_distance(max_distance)
    p, home = flat.locate(position, level)
    if home is None:
        return None
    cell = _Nearby(flat, p, mask, [int(flat.level_of(home))], float(max_distance), True).nearest()
    return cell if cell >= 0 else None


class _Nearby(NamedTuple):
    """Looks for the allowed cell that is the nearest to a position."""

    flat: FlatGrid
    p: Float  # world x, y, z [m]; x, y are enough on the map
    allowed: Bool  # by flat id
    levels: list[int]
    max_distance: float  # farther cells are ignored [m]
    on_map: bool  # distances are measured on the map, else in space

    def nearest(self) -> int:
        """The nearest allowed cell, -1 for none."""
        from navbake.runtime.kernels.nearest import IN_SPACE, TO_CENTER, Wanted, nearest_cell

        flat = self.flat
        measure = TO_CENTER if self.on_map else IN_SPACE
        best, found = self.max_distance, -1
        for level in self.levels:
            ground = flat.floors.ground[level]
            wanted = Wanted(flat.layout, self.allowed, flat.floors.z, measure, ground)
            cell, distance = nearest_cell(wanted, level, self.p, best)
            if cell >= 0 and (found < 0 or distance < best):
                best, found = distance, int(cell)
        return found

    def nearest_in_sight(self, home: int | None, sight: Sight) -> int:
        """The nearest allowed cell in sight of the position's own, -1 for none.

        Lines of sight cost more than distances. So cells are looked at from the nearest on, in
        rounds that reach twice as far each.
        """
        if home is None:
            return -1
        from navbake.runtime.kernels.nearest import first_in_sight  # saves numba at start-up

        flat, p = self.flat, self.p
        space = flat.sight_through(sight.clear)
        reach, done = FIRST_LOOK, -1.0
        farthest = min(self.max_distance, self._farthest())
        while done < farthest:
            radius = min(reach, farthest)
            discs = (cells_in_annulus(flat, k, p, (0.0, radius), self.allowed) for k in self.levels)
            cells = np.concatenate(list(discs))
            offset = flat.positions(cells) - p
            distance = np.linalg.norm(offset[:, :2] if self.on_map else offset, axis=1)
            near = np.flatnonzero((distance > done) & (distance <= radius))
            # stable, so that of equally near cells the lowest id comes first
            ordered = cells[near[np.argsort(distance[near], kind="stable")]]
            found = first_in_sight(space, sight.room, home, p[0], p[1], ordered)
            if found >= 0:
                return int(found)
            reach, done = 2.0 * reach, reach
        return -1

    def _farthest(self) -> float:
        """A distance [m] from the position that no cell of the levels exceeds."""
        layout, floors, p = self.flat.layout, self.flat.floors, self.p
        x1 = layout.x_min + layout.width * layout.cell_size
        y0 = layout.y_max - layout.height * layout.cell_size
        across = np.maximum(np.abs(layout.x_min - p[0]), np.abs(x1 - p[0]))
        along = np.maximum(np.abs(layout.y_max - p[1]), np.abs(y0 - p[1]))
        farthest = float(np.hypot(across, along)[self.levels].max())
        if self.on_map:
            return farthest
        # by the triangle inequality: across the map, then up or down
        heights = np.append(floors.z, floors.ground)
        return farthest + float(np.nanmax(np.abs(heights - p[2])))
