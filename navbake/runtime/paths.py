"""Paths and their goals: planning, and the rooms and doors along a path."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import Method, lazy
from navbake.navgrid.cells import check_positions
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.user_data import NAMES, UserData, names_in
from navbake.runtime.flat_grid import FlatGrid, doors_on
from navbake.runtime.inflation import check_word
from navbake.runtime.search import Search
from navbake.types import Float, Int

lines = lazy("navbake.runtime.line_kernels")  # numba loads slowly
ndimage = lazy("scipy.ndimage")  # saves scipy at start-up

Goal: TypeAlias = ArrayLike | str
"""A position, several of them, ``room:NAME`` or ``object:NAME``."""

BY = ("cost", "time")
NOWHERE = np.full(2, np.nan)
MAX_REACH = 1.0  # [m] from an object to a place next to it


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A path on the floor; a notebook shows its picture."""

    positions: Float
    """World x, y, z [m], shape (n, 3), n >= 1; z is the floor's height. Straight in between."""
    levels: Int  #: Level of each position, shape (n,), int64.
    cells: Int
    """Level, row and column of each cell of the route, shape (m, 3), int64. A smooth path may
    leave these cells where that is shorter and costs no more."""
    length: float  #: Of the path, seen from above [m].
    #: Of the route: of each step [m] times the weight of the cell that it leads to, and its area's
    #: cost; and of links [m].
    cost: float
    rooms: list[str]  #: Ids of the rooms on the way, in order, repeated where entered again.
    doors: list[str]  #: Ids of the doors on the way, in order.
    links: list[str]  #: Names of the links that it takes, in order.
    seconds: float  #: Of the route, at the agent's speed and those of areas and links.
    by: str  #: What it was planned for, ``cost`` or ``time``.
    #: From which of the positions each of `links` leads on, and to which, shape (k, 2).
    stops: Int
    grid: NavGrid | None = None  #: The grid of the search.

    _repr_png_ = Method[bytes | None]("navbake.views.notebook:draw_path")

    def __repr__(self) -> str:
        text = f"Path({self.length:.2f} m, cost {self.cost:.2f}, {len(self.positions)} points"
        for kind, names in (("rooms", self.rooms), ("doors", self.doors), ("links", self.links)):
            text += f", {kind} {' '.join(names)}" if names else ""
        return f"{text})"

    @property
    def points(self) -> Float:
        """The `positions`."""
        return self.positions

    def at(self, distance: ArrayLike) -> Float:
        """World x, y, z [m] at distances [m] from the start, seen from above: shape (..., 3)."""
        run = run_of(self.positions)
        along = np.asarray(distance, dtype=np.float64)
        return np.stack([np.interp(along, run, axis) for axis in self.positions.T], axis=-1)


def run_of(positions: Float) -> Float:
    """Distances along a polyline up to each of its points, seen from above [m]."""
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(positions[:, :2], axis=0).T)))


@dataclass(frozen=True, eq=False)
class Target:
    """The cells of a goal."""

    name: str  # for messages
    cells: Int  # flat ids, free or not; -1 for positions in no cell
    positions: Float | None = None  # given ones, world, shape (n, 2) or (n, 3)

    def free_cells(self, flat: FlatGrid) -> Int:
        """The free ones, ascending and each once."""
        inside = self.cells[self.cells >= 0]
        return np.unique(inside[flat.free[inside]])


def find_target(search: Search, goal: Goal, level: int | None = None) -> Target:
    """Find the cells of a goal; raises QueryError for an unknown or wrong one."""
    flat = search.flat
    if isinstance(goal, str):
        kind, _, name = goal.partition(":")
        if kind == "room":
            return Target(f"room {name!r}", search.rooms.cells(name))
        if kind == "object":
            return Target(f"object {name!r}", cells_next_to_object(search, name))
        raise QueryError(f"expected a position, room:NAME or object:NAME, got {goal!r}")
    p = check_positions(goal, flat.num_levels, level)
    if p.ndim > 2 or not p.size:
        raise QueryError(f"expected positions of shape (3,) or (n, 3), n >= 1, got {p.shape}")
    name = "the goal" if p.ndim == 1 else f"one of {len(p)} goals"
    p = np.atleast_2d(p)
    return Target(name, flat.cells_at(p, level), p)


def cells_next_to_object(search: Search, name: str) -> Int:
    """The free cells next to an object, or on it where it is no obstacle; flat ids, ascending.

    A search runs ring by ring on each level from the object's cells, up to 1 m away, over cells
    without obstacles; an object enclosed by others, as on a table, is left over these. Each
    island's nearest ring and the next one count.
    """
    grid = search.grid
    flat = search.flat
    islands = search.islands.number
    found = []
    named = cells_named(grid, flat, name)
    for number, level in enumerate(grid.levels):
        part = flat.cells_of(number)
        cells = named[(named >= part.start) & (named < part.stop)] - part.start
        if not len(cells):
            continue
        reach = math.ceil(MAX_REACH / level.lattice.cell_size)
        rows, cols = (
            np.arange(max(v.min() - reach, 0), min(v.max() + reach + 1, size))
            for v, size in zip(np.divmod(cells, level.width), level.shape, strict=True)
        )
        ids = rows[:, None] * level.width + cols
        island = islands[part.start + ids]
        own = np.isin(ids, cells)
        passable = own | (island > 0) | (level.solid.take(ids) == 0)
        is_goal = np.zeros(ids.shape, dtype=np.bool_)
        for over_objects in (False, True):
            if is_goal.any():
                break
            if over_objects:
                # cells that are empty or blocked by objects alone, and by no wall
                entries = UserData.of(level.user_data).find(ids.ravel())
                walls = {name for entry in entries for name in names_in(entry, "walls")}
                holds = []
                for entry in entries:
                    names = {*names_in(entry, "objects"), *names_in(entry, "blockers")}
                    is_wall = names_in(entry, "walls") or names & walls
                    holds.append(bool(names) and not is_wall)
                passable |= np.reshape(holds, ids.shape)
            ring = np.where(own, 0, -1)
            for step in range(1, reach + 1):
                ring[ndimage.binary_dilation(ring >= 0) & passable & (ring < 0)] = step
            is_near = (ring >= 0) & (ring < reach)
            for one in np.unique(island[is_near & (island > 0)]):
                first = ring[is_near & (island == one)].min()
                is_goal |= (island == one) & (ring >= 0) & (ring <= first + 1)
        found.append(part.start + ids[is_goal])
    return np.concatenate(found)


def cells_named(grid: NavGrid, flat: FlatGrid, name: str) -> Int:
    """The flat ids of a named object's, door's or wall's cells, at least one."""
    if not isinstance(name, str):
        raise QueryError(f"expected the name of an object, got {name!r}")
    found = list[Int]()
    known = set[str]()
    for start, level in zip(flat.layout.start.tolist(), grid.levels, strict=False):
        cells, number, entries = UserData.of(level.user_data).shared()
        names = [{n for key in NAMES for n in names_in(entry, key)} for entry in entries]
        has_name = np.array([name in of_entry for of_entry in names], dtype=np.bool_)
        found.append(start + cells[has_name[number]])
        known.update(*names)
    if name not in known:
        raise QueryError(f"no object {name!r} in {grid.scene_id!r}: {suggest(name, sorted(known))}")
    return np.concatenate(found)


def find_path(
    search: Search, start: ArrayLike, goal: Goal, level: int | None, *, by: str, smooth: bool
) -> Path | None:
    """`PathFinder.find_path`."""
    check_word(by, BY, "by")
    flat = search.flat
    rooms = search.rooms
    p, origin = flat.locate(start, level, "start")
    target = find_target(search, goal, level)
    goals = target.free_cells(flat)
    if origin < 0 or not flat.free[origin] or not len(goals):
        return None
    found = search.route(origin, goals, by)
    if found is None:
        return None
    route, by_link, _ = found
    places = flat.split(route)
    cost, seconds, links = search.measure(found, places, by)
    end = NOWHERE
    if target.positions is not None:  # the first that is in the cell
        end = target.positions[int(np.argmax(target.cells == route[-1])), :2]
    positions, levels, leads_to = lines.lay_route(
        route, by_link, p[:2], end, smooth, search.graph_by(by), flat.floors, search.off_center
    )
    # the points before and after each link, by the cell that a link leads to after each point
    stops = [np.flatnonzero(leads_to == at)[[0, -1]] + [0, 1] for at, _ in links]
    numbers = rooms.number[route]
    entered = numbers[np.append(True, numbers[1:] != numbers[:-1])]
    return Path(
        positions=positions,
        levels=levels,
        cells=np.stack(places, axis=1),
        length=float(np.hypot(*np.diff(positions[:, :2], axis=0).T).sum()),
        cost=cost,
        rooms=[str(rooms.id_of(int(n))) for n in entered if n],
        doors=doors_on(search.doors, route),
        links=[name for _, name in links],
        seconds=seconds,
        by=by,
        stops=np.array(stops, dtype=np.int64).reshape(-1, 2),
        grid=search.grid,
    )


def find_field(
    search: Search, goal: Goal, level: int | None, *, weighted: bool = True, by: str = "cost"
) -> Float:
    """The costs of `PathFinder.distance_field`, by flat id; read-only."""
    check_word(by, BY, "by")
    if not weighted and by == "time":
        raise QueryError("expected by='cost' for lengths (weighted=False), got by='time'")
    by = by if weighted else "length"
    # goals of the same cells share a field
    goals = find_target(search, goal, level).free_cells(search.flat)

    def make() -> Float:
        field = search.field(goals, by=by)
        field.flags.writeable = False
        return field

    return search.cached("fields", (by, goals.tobytes()), make)
