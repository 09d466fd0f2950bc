"""Queries about places: free space, neighbourhood, lines of sight, and steps."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.lazy import lazy
from navbake.navgrid.cells import Cell, check_level, check_positions
from navbake.navgrid.colors import FREE, NO_FLOOR, OCCUPIED, rgb_of
from navbake.navgrid.grid import NavGrid
from navbake.runtime import flat_grid
from navbake.runtime.flat_grid import REAL, FlatGrid
from navbake.runtime.paths import cells_named
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

places = lazy("navbake.runtime.place_kernels")  # numba loads slowly
walks = lazy("navbake.runtime.walk_kernels")

MAX_DROP = 0.5  # [m], see `navbake.runtime.place_kernels`, which loads numba
FIRST_LOOK = 1.0  # [m], first radius of the search in sight
SLACK = 1e-9  # metres


@dataclass(frozen=True, eq=False)
class Obstacle:
    """The nearest point of an obstacle."""

    distance: float  #: On the map [m].
    position: Float  #: World x, y, z [m], shape (3,); z is the floor's at the given position.


class PlaceQuestions:
    """Queries about islands, rooms, free places, and their surroundings."""

    grid: NavGrid
    _search: Search

    @property
    def search(self) -> Search:
        """The search over the cells, up to date with the grid's blocks."""
        self._search.update()
        return self._search

    @property
    def rooms(self) -> flat_grid.RoomMap:
        return self._search.rooms

    @property
    def islands(self) -> flat_grid.IslandMap:
        """The connected parts of the currently free cells: ``count``, ``areas`` [m²]."""
        return self.search.islands

    @property
    def navigable_area(self) -> float:
        """Area of all free cells [m²]."""
        return float(self.islands.areas.sum())

    @property
    def bounds(self) -> tuple[Float, Float]:
        """Lower and upper corner of the bounding box of all free cells' floors, world [m]."""
        flat = self.search.flat
        cells = np.flatnonzero(flat.free)
        if not len(cells):
            raise QueryError(f"no cell of {self.grid.scene_id!r} is free: it has no bounds")
        centers = flat.positions(cells)
        half = (flat.layout.cell_size[flat.level_of(cells)] / 2)[:, None] * [1.0, 1.0, 0.0]
        return (centers - half).min(axis=0), (centers + half).max(axis=0)

    def island_at(self, position: ArrayLike, *, level: int | None = None) -> int | None:
        """Number of the island of a position, from 1, the largest; None where it isn't free."""
        _, cell = self.search.flat.locate(position, level)
        return int(self.islands.number[cell]) or None if cell >= 0 else None

    def same_island(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether both positions are on one island, so that paths lead from each to the other."""
        one = self.island_at(a, level=level)
        other = self.island_at(b, level=level)
        return one is not None and one == other

    def island_area(self, island: int) -> float:
        """Area of an island [m²]."""
        return float(self.islands.areas[self.islands.check(island)])

    def room_at(self, position: ArrayLike, *, level: int | None = None) -> str | None:
        """The id of a position's room, None for none."""
        _, cell = self.search.flat.locate(position, level)
        return self.rooms.id_of(int(self.rooms.number[cell])) if cell >= 0 else None

    def same_room(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether both positions are in one room."""
        one = self.room_at(a, level=level)
        other = self.room_at(b, level=level)
        return one is not None and one == other

    def room_near(
        self, position: ArrayLike, max_distance: float = math.inf, *, level: int | None = None
    ) -> str | None:
        """The id of the room nearest on the level, None if none is within `max_distance` [m]."""
        flat = self.search.flat
        number = self.rooms.number
        p, home = flat.locate(position, level)
        flat_grid.check_distance(max_distance)
        if home < 0:
            return None
        on = int(flat.level_of(home))
        _, cell = snap(flat, number > 0, p, on, max_distance=max_distance)
        return self.rooms.id_of(int(number[cell])) if cell >= 0 else None

    def room_of(self, name: str) -> str | None:
        """The id of the room that holds most cells of a named object; None for none."""
        numbers = self.rooms.number[cells_named(self.grid, self.search.flat, name)]
        counts = np.bincount(numbers[numbers > 0], minlength=1)
        return self.rooms.id_of(int(np.argmax(counts)))

    def is_navigable(
        self, position: ArrayLike, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> bool | Bool:
        """Whether a position's cell is free, its floor at most `max_drop` below it [m].

        For positions of shape (..., 3), bool of shape (...).
        """
        flat_grid.check_distance(max_drop, "max_drop")
        flat = self.search.flat
        p = check_positions(position, flat.num_levels, level)
        on, points = flat_grid.as_points(p, level)
        if on >= 0:
            cells = places.locate(flat.layout, flat.floors, on, points)
            answers = (cells >= 0) & flat.free[cells]
        else:
            answers = places.mark_standing(
                flat.layout, flat.floors, flat.free, float(max_drop), points
            )
        return bool(answers[0]) if p.ndim == 1 else answers.reshape(p.shape[:-1])

    def cell_at(self, position: ArrayLike, *, level: int | None = None) -> Cell | None:
        """A position's cell; see `navbake.navgrid.cells.cell_at`."""
        flat = self.search.flat
        _, cell = flat.locate(position, level)
        return flat.cell(cell) if cell >= 0 else None

    def snap(
        self,
        position: ArrayLike,
        *,
        level: int | None = None,
        same_level: bool = True,
        same_room: bool = False,
        room: str | None = None,
        island: int | None = None,
        in_sight: bool = False,
        max_distance: float = math.inf,
    ) -> Float | None:
        """Find the nearest place where an agent can stand, for one position or each of many.

        If the position's own cell is allowed and its floor at most 0.5 m below, that is the
        position itself, put on the floor. Else it is the nearest centre of a cell: on the map
        of the position's level, or in space on any level. Without such a place, None, or a row of
        NaN for many positions. `same_room` and `in_sight` take one position.

        Args:
            same_level: stay on its level. A position on none snaps to the nearest floor in space.
            same_room: stay in its room; None if it is in none.
            room, island: only cells of these.
            in_sight: no obstacle may be in between. From inside an object, the line must leave
                it within its room.
            max_distance: at most this far away [m].
        """
        search = self.search
        flat = search.flat
        flat_grid.check_distance(max_distance)
        if same_room or in_sight:
            p = flat.check_one(position, level)
        else:
            p = check_positions(position, flat.num_levels, level)
        if same_room:
            here = self.room_at(p, level=level)
            if here is None or self.rooms.find(room or here) != self.rooms.find(here):
                return None
            room = here
        allowed = search.allowed(room=room, islands=search.chosen_islands(island, None))
        if in_sight:
            return _snap_in_sight(search, allowed, p, level, same_level, max_distance)
        found, cells = snap(
            flat, allowed, p, level, same_level=same_level, max_distance=max_distance
        )
        return None if p.ndim == 1 and cells < 0 else found

    def try_step(
        self, start: ArrayLike, end: ArrayLike, *, slide: bool = True, level: int | None = None
    ) -> Float:
        """Move straight from a position towards another, and stop at cells that are not free.

        Starts of shape (..., 3) have an end each, or one in common. The way runs over the map from
        cell to cell and over steps to other levels, not over links, and so never passes thin walls.
        It may end anywhere in a free cell, up to half a cell nearer to obstacles than at its
        centre. The end's z is ignored. Raises QueryError if the start isn't free.

        Sliding goes on from where the straight way stops, to the point nearest to the end among
        those within a walk as long as the rest of the way.
        """
        flat = self.search.flat
        p = check_positions(start, flat.num_levels, level)
        q = check_positions(end, flat.num_levels, 0)  # the level follows from the way
        if q.shape[:-1] not in (p.shape[:-1], ()):
            counts = f"{p.shape[:-1]} of them, got {q.shape[:-1]}"
            raise QueryError(f"expected an end for each start, {counts}")
        on, points = flat_grid.as_points(p, level)
        to = np.broadcast_to(q[..., :2], (*p.shape[:-1], 2)).reshape(-1, 2)
        found, bad = walks.step_each(
            flat.layout, flat.steps, flat.floors, flat.free, on, points,
            np.ascontiguousarray(to), slide,
        )  # fmt: skip
        if bad >= 0:
            flat.free_cell_at(points[bad], level)  # raises with the position and a remedy
        return np.asarray(found.reshape(*p.shape[:-1], 3))

    def line_of_sight(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether the straight line between two positions crosses no occupied cell.

        The line runs over the map, from cell to cell and over steps, and through a corner of four
        if one of the two cells beside it is clear; heights are not compared. False also if one of
        the positions is outside the grid or occupied.
        """
        search = self.search
        p, one = search.flat.locate(a, level)
        q, other = search.flat.locate(b, level)
        if one < 0 or other < 0:
            return False
        return search.first_in_sight(one, p, np.array([other]), q[None]) == 0

    def nearest_obstacle(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> Obstacle | None:
        """Find the nearest point of an occupied cell's square on the position's level.

        The area outside the grid has no obstacles. Where the level ends and another goes on, as at
        the top of stairs, the other level counts where its floor is less than the agent's height,
        less a step, above or below, and its own isn't. None if there is none within `max_distance`
        [m]; distance 0 inside an occupied cell.
        """
        flat = self.search.flat
        p = flat.check_one(position, level)
        (home,), (cell,), (distance,) = _find_obstacles(self._search, p, level, max_distance)
        if cell < 0:
            return None
        half = flat.layout.cell_size[flat.level_of(home)] / 2
        center = flat.positions(cell)[:2]
        point = np.clip(p[:2], center - half, center + half)
        return Obstacle(float(distance), np.append(point, flat.positions(home)[2]))

    def clearance(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> float | Float:
        """Distance to the nearest obstacle [m], at most `max_distance`; see `nearest_obstacle`.

        For positions of shape (..., 3), float64 of shape (...).
        """
        p = check_positions(position, self.search.flat.num_levels, level)
        _, cells, distances = _find_obstacles(self._search, p, level, max_distance)
        found = np.where(cells < 0, max_distance, distances)
        return float(found[0]) if p.ndim == 1 else found.reshape(p.shape[:-1])

    def top_down(self, level: int, metres_per_pixel: float | None = None) -> NDArray[np.uint8]:
        """Draw a level's free cells as an image.

        RGB, shape (rows, cols, 3), uint8, in the colours of ``navbake plot``: free, blocked, no
        floor; rows and columns as in the grid's arrays. A pixel shows the cell at its middle;
        without `metres_per_pixel`, > 0, there is one pixel a cell.
        """
        flat = self.search.flat
        if level is None:
            raise QueryError(f"expected a level, 0 to {flat.num_levels - 1}, got None")
        check_level(level, flat.num_levels)
        cells = flat.cells_of(level)
        shape = self.grid.levels[level].shape
        has_floor = ~np.isnan(flat.floors.z[cells])
        kind = np.where(flat.free[cells], 0, np.where(has_floor, 1, 2)).reshape(shape)
        if metres_per_pixel is not None:
            if not (isinstance(metres_per_pixel, REAL) and 0 < metres_per_pixel < math.inf):
                raise QueryError(f"expected metres_per_pixel > 0, got {metres_per_pixel!r}")
            each = metres_per_pixel / float(flat.layout.cell_size[level])
            middles = ((np.arange(math.ceil(n / each - 1e-6)) + 0.5) * each for n in shape)
            at = (np.minimum(m.astype(int), n - 1) for m, n in zip(middles, shape, strict=True))
            kind = kind[np.ix_(*at)]
        palette = np.array([rgb_of(FREE), rgb_of(OCCUPIED), rgb_of(NO_FLOOR)], dtype=np.uint8)
        return palette[kind]


def snap(
    flat: FlatGrid,
    allowed: Bool,
    p: Float,
    level: int | None = None,
    *,
    same_level: bool = True,
    max_distance: float = math.inf,
) -> tuple[Float, Int]:
    """`PathFinder.snap` of checked positions to the cells of a mask.

    Returns places, shape (..., 3), NaN for none, and their cells by flat id, -1 for none.
    """
    on, points = flat_grid.as_points(p, level)
    if points.shape[1] == 2:
        same_level = True
        points = np.column_stack([points, np.full(len(points), flat.floors.ground[on])])
    found, cells = places.snap_positions(
        flat.layout, flat.floors, allowed, on, same_level, float(max_distance), points
    )
    return found.reshape(*p.shape[:-1], 3), cells.reshape(p.shape[:-1])


def _snap_in_sight(
    search: Search, allowed: Bool, p: Float, level: int | None, same_level: bool, farthest: float
) -> Float | None:
    """`PathFinder.snap` in sight; searches growing radii, as lines cost more than distances."""
    flat = search.flat
    home = int(search.flat.cells_at(p, level))
    place, cell = snap(flat, allowed, p, level, same_level=same_level, max_distance=farthest)
    if home < 0 or cell < 0:
        return None
    if cell == home:
        return place
    axes = 2 if same_level or len(p) == 2 else 3
    levels = [int(flat.level_of(home))] if axes == 2 else list(range(flat.num_levels))
    most = sum(np.count_nonzero(allowed[flat.cells_of(k)]) for k in levels)
    radius = min(FIRST_LOOK, float(farthest))
    while True:
        discs = [cells_in_annulus(flat, k, p, (0.0, radius), allowed) for k in levels]
        cells = np.concatenate(discs)
        centers = flat.positions(cells)
        distance = np.linalg.norm(centers[:, :axes] - p[:axes], axis=1)
        # stable, so that of equally near cells the lowest id comes first
        order = np.argsort(distance, kind="stable")
        near = order[: np.count_nonzero(distance <= radius)]
        found = search.first_in_sight(home, p, cells[near], centers[near], search.rooms.number)
        if found >= 0:
            return np.asarray(centers[near[found]])
        if len(near) == most or radius >= farthest:
            return None
        radius = min(2.0 * radius, float(farthest))


def _find_obstacles(
    search: Search, p: Float, level: int | None, max_distance: float
) -> tuple[Int, Int, Float]:
    """Own cells, nearest occupied cells, -1 for none, and distances [m] of checked positions."""
    flat_grid.check_distance(max_distance)
    flat = search.flat
    # floors less than this apart are at one height for an agent, as in `grid.inflate`
    overlap = search.grid.agent_height - flat.floors.max_step
    on, points = flat_grid.as_points(p, level)
    homes, cells, distances = places.find_nearest_obstacles(
        flat.layout, flat.floors, search.occupied, overlap, on, float(max_distance), points
    )
    if (homes < 0).any():
        first = points[int(np.argmax(homes < 0))]
        raise QueryError(f"{flat_grid.text_of(first)} lies beside the grid: no obstacles")
    return homes, cells, distances


def cells_in_annulus(
    flat: FlatGrid, level: int, point: Float, distances: tuple[float, float], allowed: Bool
) -> Int:
    """The allowed cells of a level with centres in an annulus round a point, ascending."""
    layout = flat.layout
    size = layout.cell_size[level]
    shape = (layout.height[level], layout.width[level])
    at = (layout.y_max[level] - point[1], point[0] - layout.x_min[level])
    off = [
        (np.arange(count) + 0.5) * size - middle for count, middle in zip(shape, at, strict=True)
    ]
    rows, cols = (np.flatnonzero(np.abs(v) <= distances[1] + SLACK) for v in off)
    squared = (off[0][rows, None] ** 2) + off[1][cols] ** 2
    low = max(distances[0] - SLACK, 0.0)
    high = distances[1] + SLACK
    near = (squared >= low**2) & (squared <= high**2)
    cells: Int = (layout.start[level] + rows[:, None] * shape[1] + cols)[near]
    return cells[allowed[cells]]
