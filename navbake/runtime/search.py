"""Shortest-path searches on a grid's flat cells, and caches of what is derived from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.lazy import lazy
from navbake.navgrid.cells import Cells, check_level
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.links import Agent
from navbake.navgrid.obstacle_state import NO_DIAGONAL, NO_OFF_CENTER, Window
from navbake.runtime import flat_grid
from navbake.runtime.blocking import find_agent, fit_grid
from navbake.runtime.flat_grid import octile
from navbake.runtime.inflation import find_room
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:
    from navbake.runtime.grid_arrays import Graph

arrays = lazy("navbake.runtime.grid_arrays")  # numba loads slowly
lines = lazy("navbake.runtime.line_kernels")
routes = lazy("navbake.runtime.search_kernels")
walks = lazy("navbake.runtime.walk_kernels")

LAST_SEARCH = 2**31 // 64 - 2  # `mark` is int32 and holds the number of a search times 64
FIRST_ROOM = 1 << 15  # entries for open cells at first
MAX_KEPT = 8  # cached results of each kind
NO_CELLS = np.empty(0, dtype=np.int64)
NO_ROOMS = np.empty(0, dtype=np.int32)
Kept = TypeVar("Kept")


class Route(NamedTuple):
    """The cheapest cells from one to another."""

    cells: Int  # flat ids
    by_link: Bool  # whether a link led to each, or a step to another level
    cost: float  # by what was planned for


class Search:
    """Searches over the cells of all levels of a grid, and cached results.

    Not thread-safe. `grid` is fitted to the agent, see `navbake.runtime.blocking`; `flat` are its
    cells, `graph` the steps between them; `free_diagonally` marks free cells with room for a
    diagonal step, `off_center` those where a line may leave the centres. `update` takes over the
    grid's blocks; each change increments `version`.

    Args:
        grid: as it was loaded or baked.
        cut_corners: see `PathFinder`.
        agent: who plans.
        radius: that links have to be wide enough for [m]; the grid's if None.
        penalty: see `navbake.runtime.flat_grid.flatten`.
    """

    def __init__(
        self,
        grid: NavGrid,
        *,
        cut_corners: bool = False,
        agent: str | Agent | None = None,
        radius: float | None = None,
        penalty: float | None = None,
    ) -> None:
        self.agent = find_agent(grid, agent)
        self.grid = grid = fit_grid(grid, self.agent)
        clean = grid.without_blocks()
        self.cut_corners = cut_corners
        self.version = 0
        self.radius = grid.radius if radius is None else radius
        self.flat = flat = flat_grid.flatten(clean, self.agent, penalty)
        self._kept: dict[str, dict[Any, Any]] = {}
        self._room = find_room(clean)
        self._masks = [mask & flat.free for mask in self._room or (flat.free,) * 3]
        self.free_diagonally, anywhere, by_squares = self._masks
        solid = [v.solid.ravel() != 0 for v in clean.levels] if self._room else [NO_CELLS]
        before = np.append(np.int32(0), np.cumsum(np.concatenate(solid), dtype=np.int32))
        is_closed = len(grid.levels) > 1
        self.off_center = arrays.OffCenter(
            anywhere, by_squares, before, grid.inflated_radius, is_closed
        )
        if (least := flat.weight[flat.free].min(initial=0.0)) < 0:
            raise QueryError(f"expected weights >= 0, got {least:g}: no path is the cheapest then")
        # the buckets fit the weights of all cells, blocked ones included
        self._moves = np.zeros(flat.num_cells, dtype=np.uint8)
        self.graph = self._make_graph("cost", False)
        self._visits = arrays.Visits(
            mark=np.zeros(flat.num_cells, dtype=np.int32),
            cost=np.zeros(flat.num_cells, dtype=np.float64),
            link_from=np.zeros(len(self.graph.links.cell), dtype=np.int64),
            entry_cell=np.empty(FIRST_ROOM, dtype=np.int32),
            entry_next=np.empty(FIRST_ROOM, dtype=np.int32),
        )
        self._number = 0
        self._seen = [0] * flat.num_levels
        for number, level in enumerate(grid.levels):
            self._find_moves(number, (0, level.height, 0, level.width))
        self.update()

    def graph_by(self, by: str, *, backwards: bool = False) -> Graph:
        """The steps and what they cost: ``cost`` [m], ``time`` [s], or their ``length`` [m].

        Of `length` only passages over links have a cost of their own. `backwards`, links are turned
        round.
        """
        if by == "cost" and not (backwards and len(self.flat.arcs.ends)):
            return self.graph
        make = partial(self._make_graph, by, backwards)
        return self.cached("graphs", (by, backwards), make)

    def _make_graph(self, by: str, backwards: bool) -> Graph:
        flat = self.flat
        weight = self.flat.weight
        weights = np.ones(1)
        if by == "time":
            weights = flat.pace
            if len(flat.pace) > 1:
                weight = np.where(flat.free, flat.pace, np.inf)
                weights = flat.pace[flat.free]
        elif by == "cost":
            weights = flat.weight[flat.free]
        least, most = (float(weights.min()), float(weights.max())) if weights.size else (1.0, 1.0)
        links = flat.links(self.radius, by_time=by == "time", backwards=backwards)
        size = float(flat.layout.cell_size.min())
        longest = float(links.length.max(initial=0))
        wide = flat.arcs.fits_radius(self.radius)
        one, other = flat.positions(flat.arcs.ends[wide].T)
        covered = least * octile(one - other)
        spent = (flat.arcs.seconds if by == "time" else flat.arcs.cost)[wide]
        dearest = float((spent + covered).max(initial=0.0))
        buckets = routes.plan_buckets(size, least, most, longest, dearest)
        same = least if least == most else 0.0
        graph: Graph = arrays.Graph(flat.layout, links, self._moves, weight, same, least, *buckets)
        return graph

    def update(self) -> None:
        """Take over cells that were blocked or freed since the last call."""
        for number, level in enumerate(self.grid.levels):
            state = level.obstacle_state
            if state is None or state.revision == self._seen[number]:
                continue
            whole = [(0, level.height, 0, level.width)]
            for row0, row1, col0, col1 in state.windows_since(self._seen[number]) or whole:
                inside = np.s_[row0:row1, col0:col1]
                first = self.flat.cells_of(number).start
                rows = np.arange(row0, row1)[:, None]
                cols = np.arange(col0, col1)
                cells = first + rows * level.width + cols
                weight = level.weights[inside].astype(np.float64)
                self.flat.weight[cells] = self.flat.priced(weight, cells)
                self.flat.free[cells] = free = np.isfinite(self.flat.weight[cells])
                for k, layer in enumerate((NO_DIAGONAL, NO_OFF_CENTER, NO_OFF_CENTER)):
                    self._masks[k][cells] = free
                    if self._room is not None:
                        has_room = self._room[k][cells] & (state.count[layer][inside] == 0)
                        self._masks[k][cells] &= has_room
                self._find_moves(number, (row0 - 1, row1 + 1, col0 - 1, col1 + 1))
            self._seen[number] = state.revision
            self.version += 1

    def _find_moves(self, level: int, window: Window) -> None:
        flat = self.flat
        layout = self.flat.layout
        routes.find_moves(
            flat.free, self.free_diagonally, flat.floors, flat.slopes, self.cut_corners, layout,
            level, window, self._moves,
        )  # fmt: skip

    def cached(self, kind: str, key: Any, make: Callable[[], Kept], most: int = MAX_KEPT) -> Kept:
        """Return `make()`, cached per kind, key and grid version; keeps the `most` last used."""
        kept = self._kept.setdefault(kind, {})
        key = (self.version, key)
        value: Kept = kept.pop(key) if key in kept else make()
        kept[key] = value  # most recently used last
        for old in list(kept)[:-most]:
            del kept[old]
        return value

    @cached_property
    def rooms(self) -> flat_grid.RoomMap:
        return flat_grid.map_rooms(self.grid)

    @cached_property
    def doors(self) -> flat_grid.DoorMap:
        """The doors of each cell."""
        return flat_grid.map_doors(self.grid, self.flat)

    @property
    def islands(self) -> flat_grid.IslandMap:
        """The connected parts of the currently free cells."""
        moves = self.graph.moves if self.cut_corners else None
        find = partial(flat_grid.map_islands, self.flat, self.radius, moves)
        return self.cached("islands", None, find, 1)

    @property
    def occupied(self) -> Bool:
        """Cells that are occupied now or have no floor, by flat id; see `SceneGrid2D.solid`."""
        solid = (level.solid.ravel() != 0 for level in self.grid.levels)
        return self.cached("occupied", None, lambda: np.concatenate(list(solid)), 1)

    def first_in_sight(
        self, cell: int, point: Float, cells: Int, points: Float, room: Int32 = NO_ROOMS
    ) -> int:
        """The index of the first of some points that is in sight of a point, -1 for none.

        Only occupied cells hide; heights are not compared.

        Args:
            cell: flat id of the cell that the point is in.
            point: world x, y [m], shape (2,) or (3,).
            cells: flat ids of the cells of `points`, shape (n,).
            points: world x, y [m], shape (n, 2) or (n, 3), C-contiguous.
            room: by flat id. The line may start in occupied cells, and leave them within the room
                of the first one; empty if it may not.
        """
        is_clear = self.cached("clear", None, lambda: ~self.occupied, 1)
        floors = self.flat.floors._replace(max_step=math.inf)
        return int(
            walks.first_in_sight(
                self.flat.layout,
                self.flat.steps,
                floors,
                is_clear,
                room,
                cell,
                point,
                cells,
                points,
            )
        )

    def allowed(
        self,
        *,
        level: int | None = None,
        room: str | None = None,
        islands: Sequence[int] | None = None,
    ) -> Bool:
        """The free cells on a level, in a room and on some islands, by flat id."""
        allowed = self.flat.free
        if level is not None:
            check_level(level, self.flat.num_levels)
            inside = self.flat.cells_of(level)
            allowed = np.zeros_like(allowed)
            allowed[inside] = self.flat.free[inside]
        if room is not None:
            allowed = allowed & (self.rooms.number == self.rooms.find(room))
        if islands is not None:
            allowed = allowed & np.isin(self.islands.number, islands)
        return allowed

    def chosen_islands(
        self, island: int | None, reachable_from: ArrayLike | None
    ) -> tuple[int, ...] | None:
        """The islands that a free position leads to, of these the given one; None for all.

        Raises:
            QueryError: there is no such island, or the position doesn't lead there.
        """
        if reachable_from is None:
            return None if island is None else (self.islands.check(island),)
        home = int(self.islands.number[self.flat.free_cell_at(reachable_from)[1]])
        reached = self.islands.reached_from(home)
        if island is None:
            return reached
        if island not in reached:
            raise QueryError(f"island {island} can't be reached: the position is on {home}")
        return (island,)

    def route(self, origin: int, goals: Int, by: str = "cost") -> Route | None:
        """The cheapest route to the cheapest of several free cells."""
        if (goals == origin).any():
            return Route(np.array([origin]), np.zeros(1, dtype=np.bool_), 0.0)
        graph = self.graph_by(by)
        if len(self.flat.arcs.ends):
            # by how much links may make a way cheaper than the octile distance to the goals' box
            flat = self.flat
            least = graph.least_weight
            find = partial(flat.ways_by_links, self.radius, least, by_time=by == "time")
            stops, ways = self.cached("ways by links", by, find)
            if len(stops):
                places = flat.positions(goals)[:, :2]
                low = places.min(axis=0)
                high = places.max(axis=0)
                direct = least * octile(np.maximum(np.maximum(low - stops, stops - high), 0.0))
                graph = graph._replace(
                    link_saving=float((direct - (ways + direct).min(axis=1)).max())
                )
        cells = self._find(graph, np.array([origin]), goals)
        if not len(cells):
            return None
        by_link = self._visits.mark[cells] & routes.MOVE_BITS == routes.BY_LINK
        return Route(cells, by_link, float(self._visits.cost[cells[-1]]))

    def measure(
        self, route: Route, places: Cells, by: str
    ) -> tuple[float, float, list[tuple[int, str]]]:
        """The cost of a route that was found by cost or time [m], its seconds, and its links.

        `places` are its cells' levels, rows and columns. Links are named after the place in the
        route of the cell that they lead to.
        """
        flat = self.flat
        graph = self.graph
        is_plain = graph.same_weight > 0.0 and len(flat.pace) == 1 and not route.by_link.any()
        if by == "cost" and is_plain:
            return route.cost, route.cost / graph.same_weight * float(flat.pace[0]), []
        level, row, col = places
        length = flat.layout.cell_size[level]
        length[1:][(np.diff(row) != 0) & (np.diff(col) != 0)] *= math.sqrt(2.0)
        length[0] = 0.0
        pace = flat.pace[route.cells] if len(flat.pace) > 1 else flat.pace
        if by == "cost" and not route.by_link.any():
            return route.cost, float((length * pace).sum()), []
        cost = np.zeros_like(length)
        seconds = np.zeros_like(length)
        names = list[tuple[int, str]]()
        sources, targets = flat.step_ends()
        for k in np.flatnonzero(route.by_link).tolist():
            ends = route.cells[k - 1 : k + 1]
            step = np.flatnonzero((sources == ends[0]) & (targets == ends[1]))
            length[k] = flat.steps.length[step[0]] if len(step) else 0.0
            arcs = (flat.arcs.ends == ends).all(axis=1) & flat.arcs.fits_radius(self.radius)
            if not arcs.any():
                continue
            spent = flat.arcs.seconds if by == "time" else flat.arcs.cost
            arc = int(np.argmin(np.where(arcs, spent, np.inf)))
            price = self.graph_by(by)
            of_step = length[k] * (price.same_weight or price.weight[ends[1]])
            if not len(step) or spent[arc] < of_step:
                names.append((k, self.grid.links[flat.arcs.link[arc]].name))
                length[k] = 0.0
                cost[k] = flat.arcs.cost[arc]
                seconds[k] = flat.arcs.seconds[arc]
        cost = cost + length * flat.weight[route.cells]
        seconds = seconds + length * pace
        return route.cost if by == "cost" else float(cost.sum()), float(seconds.sum()), names

    def field(self, goals: Int, *, by: str = "cost", backwards: bool = True) -> Float:
        """What the cheapest route from each cell to any goal costs, or to each cell; inf for none.

        See `graph_by`; routes to each cell are measured by ``length`` only.
        """
        return self._flood(goals, by, backwards)[0]

    def find_next_cells(self, goals: Int) -> tuple[Float, Int]:
        """The `field` by cost, and the next cell of each route: itself at a goal, -1 for none."""
        flat = self.flat
        links = self.graph.links
        cost, way = self._flood(goals, "cost", True)
        cells = np.arange(flat.num_cells)
        # the field grew from the goals: the next cell is the reversed move
        steps = np.zeros((2, routes.MOVE_BITS + 1), dtype=np.int64)
        steps[:, : len(arrays.ROW_STEP)] = arrays.ROW_STEP, arrays.COL_STEP
        down, across = steps[:, way]
        width = flat.layout.width[flat.level_of(cells)]
        onward = np.where(np.isfinite(cost), cells - down * width - across, -1)
        by_link = (way[links.cell] == routes.BY_LINK) & (onward[links.cell] >= 0)
        onward[links.cell[by_link]] = self._visits.link_from[by_link]
        return cost, onward

    def _flood(self, goals: Int, by: str, backwards: bool) -> tuple[Float, Int32]:
        """Search from goals; returns each cell's cost and the move that reached it."""
        self._find(self.graph_by(by, backwards=backwards), goals, NO_CELLS)
        mark = self._visits.mark
        cost = self._visits.cost
        return np.where(
            mark >= self._number * routes.SEARCH_UNIT, cost, np.inf
        ), mark & routes.MOVE_BITS

    def _find(self, graph: Any, sources: Int, goals: Int) -> Int:
        """`navbake.runtime.search_kernels.find_route`, with a queue that grows as needed."""
        while True:
            # marks of earlier searches stay, as each search has its own number
            self._number += 1
            if self._number > LAST_SEARCH:
                self._visits.mark[:] = 0
                self._number = 1
            result, route = routes.find_route(graph, sources, goals, self._number, self._visits)
            if result == routes.DONE:
                return np.asarray(route)
            cell, following = np.empty((2, 4 * len(self._visits.entry_cell)), dtype=np.int32)
            self._visits = self._visits._replace(entry_cell=cell, entry_next=following)

    def can_pass(self, a: Float, b: Float, level: int) -> bool:
        """Whether an agent can currently move along a line between points x, y of a level [m]."""
        return bool(lines.can_pass(a, b, level, self.graph, self.off_center))
