"""Paths and their goals: planning, and the rooms and doors along a path."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.known_names import check_choice, suggest
from navbake.lazy import lazy, resolve
from navbake.navgrid.cells import check_positions
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.user_data import NAME_KEYS, UserData, names_in
from navbake.runtime.flat_grid import FlatGrid, list_doors_along
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int, Int32

line_kernels = lazy("navbake.runtime.line_kernels")  # numba loads slowly
ndimage = lazy("scipy.ndimage")  # saves scipy at start-up

Goal: TypeAlias = ArrayLike | str
"""A position, several of them, ``room:NAME`` or ``object:NAME``."""

CRITERIA = ("cost", "time")  # what paths can be planned by
NO_POINT = np.full(2, np.nan)
MAX_OBJECT_DISTANCE = 1.0  # [m]: a place next to an object is at most this far from it


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A path on the floor; a notebook shows its picture.

    Example:
        >>> path = finder.find_path((1.0, 0.5, 0.0), "room:kitchen")
        >>> path.length, path.rooms
    """

    positions: Float
    """World x, y, z [m], shape (n, 3), n >= 1; z is the floor's height. Straight in between."""
    levels: Int  #: Level of each position, shape (n,), int64.
    cells: Int
    """Level, row and column of each cell of the route, shape (m, 3), int64. A smooth path may
    leave these cells where that is shorter and costs no more."""
    length: float  #: Length of the path, seen from above [m].
    #: Cost of the route [m]: the sum of each step's length times the weight of the cell that it
    #: leads to, and times the cost of that cell's area; plus the costs of links.
    cost: float
    rooms: list[str]  #: Ids of the rooms along the path, in order, repeated where entered again.
    doors: list[str]  #: Ids of the doors along the path, in order.
    links: list[str]  #: Names of the links that it takes, in order.
    seconds: float  #: How long the route takes, at the agent's speed and the limits of areas.
    by: str  #: What it was planned for, ``cost`` or ``time``.
    #: For each of `links`, the indices of the positions that it leads from and to, shape (k, 2).
    stops: Int
    grid: NavGrid | None = None  #: The grid of the search.

    def _repr_png_(self) -> bytes | None:
        """Return a picture of the path as PNG, which notebooks show; None without a grid."""
        # pictures import this module
        picture: bytes | None = resolve("navbake.views.notebook:draw_path")(self)
        return picture

    def __repr__(self) -> str:
        text = f"Path({self.length:.2f} m, cost {self.cost:.2f}, {len(self.positions)} points"
        for noun, names in (("rooms", self.rooms), ("doors", self.doors), ("links", self.links)):
            text += f", {noun} {' '.join(names)}" if names else ""
        return f"{text})"

    @property
    def points(self) -> Float:
        """The array `positions`, under an alias."""
        return self.positions

    def at(self, distance: ArrayLike) -> Float:
        """Compute positions at distances along the path.

        Args:
            distance: the distance from the start, seen from above [m], shape (...); less than 0
                stands for the start, more than `length` for the end.

        Returns:
            World x, y, z [m], shape (..., 3).
        """
        return positions_at(self.positions, distances_of_points(self.positions), distance)


def distances_of_points(positions: Float) -> Float:
    """Compute how far along a polyline each of its points is, seen from above [m].

    Args:
        positions: world x, y of the points [m], shape (n, 2 or more).

    Returns:
        Distances from the first point, shape (n,).
    """
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(positions[:, :2], axis=0).T)))


def positions_at(positions: Float, point_distances: Float, distance: ArrayLike) -> Float:
    """Compute positions at distances along a polyline.

    Args:
        positions: world x, y, z of its points [m], shape (n, 3).
        point_distances: see `distances_of_points`.
        distance: the distances, see `Path.at` [m], shape (...).

    Returns:
        World x, y, z [m], shape (..., 3).
    """
    distances = np.asarray(distance, dtype=np.float64)
    return np.stack([np.interp(distances, point_distances, axis) for axis in positions.T], axis=-1)


# ---------------------------------------------------------------- goals


@dataclass(frozen=True, eq=False)
class Target:
    """The cells of a goal.

    Attributes:
        name: the goal's name, for messages.
        cells: flat ids, free or not; -1 for positions in no cell.
        positions: the goal's positions, world x, y or x, y, z [m], shape (n, 2) or (n, 3); None if
            the goal is a room or an object.
    """

    name: str
    cells: Int
    positions: Float | None = None

    def free_cells(self, flat: FlatGrid) -> Int:
        """List the goal's free cells by flat id, ascending and each once."""
        cells_in_grid = self.cells[self.cells >= 0]
        return np.unique(cells_in_grid[flat.free[cells_in_grid]])


def find_target(search: Search, goal: Goal, level: int | None = None) -> Target:
    """Find the cells of a goal.

    Args:
        search: the search on the grid, up to date with added obstacles.
        goal: a position, several of them, ``room:NAME`` or ``object:NAME``.
        level: the level of positions; None finds each one's level by its z.

    Returns:
        The cells, with the goal's name.

    Raises:
        QueryError: there is no such room or object, or a position is not valid.
    """
    flat = search.flat
    if isinstance(goal, str):
        goal_kind, _, name = goal.partition(":")
        if goal_kind == "room":
            return Target(f"room {name!r}", search.rooms.cells(name))
        if goal_kind == "object":
            return Target(f"object {name!r}", cells_next_to_object(search, name))
        expected = "a position, room:NAME or object:NAME"
        raise QueryError(
            f"expected {expected}, got {goal!r}", key="goal", value=goal, expected=expected
        )
    goal_positions = check_positions(goal, flat.num_levels, level)
    if goal_positions.ndim > 2 or not goal_positions.size:
        expected = "positions of shape (3,) or (n, 3), n >= 1"
        raise QueryError(
            f"expected {expected}, got {goal_positions.shape}",
            key="goal",
            value=goal,
            expected=expected,
        )
    name = "the goal" if goal_positions.ndim == 1 else f"one of {len(goal_positions)} goals"
    goal_positions = np.atleast_2d(goal_positions)
    return Target(name, flat.cells_at(goal_positions, level), goal_positions)


def cells_next_to_object(search: Search, name: str) -> Int:
    """List the free cells next to an object, or on it if it is no obstacle.

    On each level, a search spreads from the object's cells in rings, up to 1 m away, over cells
    without obstacles. If it meets no free cell, the object may stand on a table: the search then
    also spreads over cells that only objects block. For each island that it meets, the result has
    the island's cells in the first ring that meets it and in the ring after that.

    Args:
        search: the search on the grid, up to date with added obstacles.
        name: the object's name in the grid's user data.

    Returns:
        Flat ids, ascending.

    Raises:
        QueryError: there is no such object.
    """
    flat = search.flat
    object_cells = cells_with_name(search.grid, flat, name)
    goal_cells = []
    for level_number, level in enumerate(search.grid.levels):
        level_cells = flat.cells_of(level_number)
        is_on_level = (object_cells >= level_cells.start) & (object_cells < level_cells.stop)
        object_cell_ids = object_cells[is_on_level] - level_cells.start
        if not len(object_cell_ids):
            continue
        island_numbers = search.islands.number[level_cells]
        goal_cells.append(
            level_cells.start + _find_cells_next_to(level, object_cell_ids, island_numbers)
        )
    return np.concatenate(goal_cells)


def _find_cells_next_to(level: SceneGrid2D, object_cell_ids: Int, island_numbers: Int32) -> Int:
    """List the free cells of a level next to an object's cells; see `cells_next_to_object`.

    Args:
        level: the level.
        object_cell_ids: ids of the object's cells on the level, at least one.
        island_numbers: by id on the level, the number of each cell's island, 0 where it isn't free.

    Returns:
        Ids on the level, ascending.
    """
    # a window round the object
    num_rings = math.ceil(MAX_OBJECT_DISTANCE / level.lattice.cell_size)
    object_rows, object_cols = np.divmod(object_cell_ids, level.width)
    first_row = max(object_rows.min() - num_rings, 0)
    stop_row = min(object_rows.max() + num_rings + 1, level.height)
    first_col = max(object_cols.min() - num_rings, 0)
    stop_col = min(object_cols.max() + num_rings + 1, level.width)
    rows = np.arange(first_row, stop_row)
    cols = np.arange(first_col, stop_col)
    window_cell_ids = rows[:, None] * level.width + cols
    island_numbers = island_numbers[window_cell_ids]
    is_object = np.isin(window_cell_ids, object_cell_ids)
    is_passable = is_object | (island_numbers > 0) | (level.solid.take(window_cell_ids) == 0)
    is_goal = _find_nearest_rings(is_object, is_passable, island_numbers, num_rings)
    if not is_goal.any():
        is_passable |= _mark_blocked_by_objects(level, window_cell_ids)
        is_goal = _find_nearest_rings(is_object, is_passable, island_numbers, num_rings)
    goal_cell_ids: Int = window_cell_ids[is_goal]
    return goal_cell_ids


def _find_nearest_rings(
    is_object: Bool, is_passable: Bool, island_numbers: Int32, num_rings: int
) -> Bool:
    """Mark each island's cells in its ring nearest to an object, and in the next ring.

    Ring k holds the cells that k steps over passable cells lead to from the object.

    Args:
        is_object: mask of the object's cells, shape (rows, cols).
        is_passable: mask of the cells that rings grow over, of the same shape.
        island_numbers: the number of each cell's island, 0 where it isn't free, of the same shape.
        num_rings: number of rings.

    Returns:
        The mask, of the same shape.
    """
    ring_numbers = np.where(is_object, 0, -1)
    for ring_number in range(1, num_rings + 1):
        is_next_ring = ndimage.binary_dilation(ring_numbers >= 0) & is_passable & (ring_numbers < 0)
        ring_numbers[is_next_ring] = ring_number
    is_goal = np.zeros(ring_numbers.shape, dtype=np.bool_)
    is_before_last_ring = (ring_numbers >= 0) & (ring_numbers < num_rings)
    for island_number in np.unique(island_numbers[is_before_last_ring & (island_numbers > 0)]):
        nearest_ring = ring_numbers[is_before_last_ring & (island_numbers == island_number)].min()
        is_goal |= (
            (island_numbers == island_number)
            & (ring_numbers >= 0)
            & (ring_numbers <= nearest_ring + 1)
        )
    return is_goal


def _mark_blocked_by_objects(level: SceneGrid2D, cell_ids: Int) -> Bool:
    """Mark the cells of a level that objects block and no wall blocks, by the user data.

    `cell_ids` are ids on the level; returns a mask of their shape.
    """
    entries = UserData.of(level.user_data).find(cell_ids.ravel())
    wall_names = {name for entry in entries for name in names_in(entry, "walls")}
    has_objects_only = []
    for entry in entries:
        names = {*names_in(entry, "objects"), *names_in(entry, "blockers")}
        has_wall = names_in(entry, "walls") or names & wall_names
        has_objects_only.append(bool(names) and not has_wall)
    return np.reshape(has_objects_only, cell_ids.shape)


def cells_with_name(grid: NavGrid, flat: FlatGrid, name: str) -> Int:
    """List the cells of an object, door or wall.

    Args:
        grid: the grid with the names.
        flat: the grid's cells.
        name: the name of the object, door or wall in the user data.

    Returns:
        Flat ids, at least one.

    Raises:
        QueryError: there is no such name.
    """
    if not isinstance(name, str):
        expected = "the name of an object"
        raise QueryError(
            f"expected {expected}, got {name!r}", key="object", value=name, expected=expected
        )
    named_cells: list[Int] = []
    known_names: set[str] = set()
    first_cells = flat.layout.start[:-1].tolist()
    for first_cell, level in zip(first_cells, grid.levels, strict=True):
        cells, entry_indices, entries = UserData.of(level.user_data).shared_entries()
        names_by_entry = [
            {entry_name for key in NAME_KEYS for entry_name in names_in(entry, key)}
            for entry in entries
        ]
        has_name = np.array([name in names for names in names_by_entry], dtype=np.bool_)
        named_cells.append(first_cell + cells[has_name[entry_indices]])
        known_names.update(*names_by_entry)
    if name not in known_names:
        hint = suggest(name, sorted(known_names))
        raise QueryError(
            f"no object {name!r} in {grid.scene_id!r}: {hint}", key="object", value=name, hint=hint
        )
    return np.concatenate(named_cells)


# ---------------------------------------------------------------- planning


def find_path(
    search: Search, start: ArrayLike, goal: Goal, level: int | None, *, by: str, smooth: bool
) -> Path | None:
    """Find the cheapest or the quickest path: `PathFinder.find_path`.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start: world x, y, z [m].
        goal: a position, several of them, ``room:NAME`` or ``object:NAME``.
        level: the level of positions; None finds each one's level by its z.
        by: ``cost`` or ``time``.
        smooth: whether the path is pulled straight.

    Returns:
        The path, None if there is none.

    Raises:
        QueryError: an argument is not valid.
    """
    check_choice(by, CRITERIA, "by", QueryError)
    flat = search.flat
    start_position, start_cell = flat.locate(start, level, "start")
    target = find_target(search, goal, level)
    goal_cells = target.free_cells(flat)
    if start_cell < 0 or not flat.free[start_cell] or not len(goal_cells):
        return None
    route = search.find_route(start_cell, goal_cells, by)
    if route is None:
        return None
    cells_of_route = flat.to_cells(route.cells)
    costs = search.measure_route(route, cells_of_route, by)
    end_point = NO_POINT
    if target.positions is not None:  # the first that is in the cell
        end_point = target.positions[int(np.argmax(target.cells == route.cells[-1])), :2]
    positions, levels, link_end_indices = line_kernels.lay_route(
        route.cells,
        route.is_by_link,
        start_position[:2],
        end_point,
        smooth,
        search.graph_with_costs(by),
        flat.floors,
        search.off_center,
    )
    # The indices of the points before and after each link. `link_end_indices` has the index of the
    # cell that the link leads to: at the point before the link and, if the floor rises there, at
    # the points on it.
    stops = []
    for link in costs.links:
        indices_on_link = np.flatnonzero(link_end_indices == link.cell_index)
        stops.append([indices_on_link[0], indices_on_link[-1] + 1])
    room_numbers = search.rooms.number[route.cells]
    is_entered = np.append(True, room_numbers[1:] != room_numbers[:-1])
    return Path(
        positions=positions,
        levels=levels,
        cells=np.stack(cells_of_route, axis=1),
        length=float(np.hypot(*np.diff(positions[:, :2], axis=0).T).sum()),
        cost=costs.cost,
        rooms=[
            str(search.rooms.id_of(int(number))) for number in room_numbers[is_entered] if number
        ],
        doors=list_doors_along(search.doors, route.cells),
        links=[link.name for link in costs.links],
        seconds=costs.seconds,
        by=by,
        stops=np.array(stops, dtype=np.int64).reshape(-1, 2),
        grid=search.grid,
    )


def find_field(
    search: Search, goal: Goal, level: int | None, *, weighted: bool = True, by: str = "cost"
) -> Float:
    """Compute the costs of `PathFinder.distance_field`, by flat id.

    Args:
        search: the search on the grid, up to date with added obstacles.
        goal: a position, several of them, ``room:NAME`` or ``object:NAME``.
        level: the level of positions; None finds each one's level by its z.
        weighted: whether weights and areas count; else costs are lengths [m].
        by: ``cost`` or ``time``.

    Returns:
        float64, by flat id, inf for no path; read-only. Goals with the same cells share one array.

    Raises:
        QueryError: an argument is not valid, or `weighted=False` is combined with ``by="time"``.
    """
    check_choice(by, CRITERIA, "by", QueryError)
    if not weighted and by == "time":
        raise QueryError("expected by='cost' for lengths (weighted=False), got by='time'")
    criterion = by if weighted else "length"
    goal_cells = find_target(search, goal, level).free_cells(search.flat)

    def compute_field() -> Float:
        field = search.compute_cost_field(goal_cells, by=criterion)
        field.flags.writeable = False
        return field

    return search.cached_result("fields", (criterion, goal_cells.tobytes()), compute_field)
