"""Makes the graph of routes of a grid: nodes where agents turn, and lanes that are free for them.

Nodes are doors, rooms' middles, the stops of links and stairs, and junctions of the medial axis of
the free cells; where a free cell is farther than `REACH` from all of these, waypoints are added.
Lanes are straight lines that `Search.can_pass` allows an agent inflated to its radius, so that its
disc meets nothing on them. They are a greedy spanner: a lane is left out where the way over shorter
ones costs at most 5 % more. Where regions of nodes are near that are joined by no such way, the
corners of the path between them become nodes.

Source: Althöfer et al. 1993 for the spanner; Zhang and Suen 1984 for thinning.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.links import SPEED, Agent
from navbake.routes.graph import FLOOR, Lane, Node, RouteGraph
from navbake.runtime.blocking import find_agent, fit_grid
from navbake.runtime.flat_grid import find_leaf_cells, find_stairs
from navbake.runtime.paths import find_path
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

ndimage = lazy("scipy.ndimage")
sparse = lazy("scipy.sparse")
spatial = lazy("scipy.spatial")

LEAST_AREA = 4.0  # m²: smaller islands have no nodes but stops of links
REACH = 1.8  # metres from any cell to a node
APART = 1.0  # metres between nodes that see each other
SNAP = 0.4  # metres from a corner of a path to a node that takes its place
HOPS = 3  # regions from one node's to another's, between which a way has to be short
STRETCH = 1.05  # of the cost of a way over other lanes, against a straight one
LONGEST = 20.0  # metres of a lane
DIGITS = 6  # of positions and lengths, after the point: micrometres


def make_routes(grid: NavGrid, agent: str | Agent | None = None) -> RouteGraph:
    """Make the graph of routes of a grid for an agent, as the grid is now.

    The grid is inflated to the agent's radius. `agent` is its name in the grid, or an Agent; None
    for one of the grid's radius with all rights. Raises a QueryError if the grid names no such
    agent, or isn't for one of its size.
    """
    return _Builder(grid, find_agent(grid, agent)).build()


class _Builder:
    """The nodes and lanes of a graph while they are found."""

    def __init__(self, grid: NavGrid, agent: Agent | None) -> None:
        self.speed = SPEED if agent is None else agent.speed
        fitted = fit_grid(grid, agent)
        self.radius = fitted.radius
        # lines are swept exactly on inflated grids only
        exact = fitted if fitted.inflated_radius >= fitted.radius else fitted.inflate(fitted.radius)
        self.search = Search(exact, agent=agent and agent.of_any_size(), radius=self.radius)
        self.grid = self.search.grid
        self.flat = flat = self.search.flat
        areas = self.search.islands.areas
        self.inside: Bool = flat.free & (areas >= LEAST_AREA)[self.search.islands.number]
        self.least = float(flat.weight[flat.free].min(initial=1.0))  # price of a cell
        self.clearance = np.concatenate([
            ndimage.distance_transform_edt(
                np.pad(flat.free[flat.cells_of(number)].reshape(level.shape), 1)
            )[1:-1, 1:-1].ravel() * level.lattice.cell_size
            for number, level in enumerate(self.grid.levels)
        ])  # fmt: skip
        self.areas = np.concatenate([level.area_index.ravel() for level in self.grid.levels])
        self.leaves = {
            cell: own.id for own in grid.doors for cell in find_leaf_cells(own, flat).tolist()
        }
        self.links = [
            link
            for link in self.grid.links
            if link.refuses(self.search.agent) is None and link.fits(self.radius)
        ]
        # stairs by their names and kinds, with both cells of a step, the lower first
        self.stairs: list[tuple[str, str, list[int]]] = []
        for number, (_, _, kind, steps) in enumerate(find_stairs(self.grid, flat)):
            # the free step that is the farthest from what is beside it
            ends = steps[self.inside[steps].all(axis=1)]
            if len(ends):
                room = np.round(self.clearance[ends].min(axis=1), DIGITS)
                places = flat.positions(ends).mean(axis=1)
                off = np.linalg.norm(places - places.mean(axis=0), axis=1)
                step = ends[np.lexsort((off, -room))[0]].tolist()
                self.stairs.append((f"{kind} {number}", kind, step))
        self.cells: list[int] = []  # of the nodes
        self.nodes: list[Node] = []
        self.points = np.empty((0, 3))
        self.lanes: list[Lane] = []
        self.distance = np.empty((0, 0))  # of the cheapest ways over lanes [m]

    def build(self) -> RouteGraph:
        self._add_named_places()
        self._add_junctions()
        self._cover()
        self._link()
        self._join_visible()
        self._join_regions()
        return self._graph()

    # ---------------------------------------------------------------- nodes

    def _add(
        self, cell: int, kind: str, name: str = "", *, door: str | None = None, link: str = ""
    ) -> int:
        """Add a node; returns the index of it, or of the one that its cell has already.

        Links that stop on one cell have a node each, because a node names one link.
        """
        at = np.round(self.flat.positions(cell), DIGITS) + 0.0
        room = self.search.rooms.id_of(int(self.search.rooms.number[cell]))
        level = int(self.flat.level_of(cell))
        x, y, z = at.tolist()
        node = Node(name, (x, y, z), level, kind, room, door, link or None)
        for number, other in enumerate(self.nodes):
            is_of_other = link and other.link and link != other.link
            if self.cells[number] == cell and not is_of_other:
                if other.kind in ("junction", "waypoint") and kind != "waypoint":
                    self.nodes[number] = node
                return number
        self.cells.append(cell)
        self.nodes.append(node)
        self.points = np.concatenate([self.points, at[None]])
        self.distance = np.pad(self.distance, (0, 1), constant_values=math.inf)
        self.distance[-1, -1] = 0.0
        return len(self.nodes) - 1

    def _add_named_places(self) -> None:
        """Add the stops of links and stairs, doors, and the widest place of each room."""
        flat = self.flat
        rooms = self.search.rooms
        for link in self.links:
            for number, stop in enumerate(link.stops):
                cell = int(flat.layout.start[stop.level]) + stop.cell
                if flat.free[cell]:
                    self._add(cell, "stop", f"{link.name} {number}", link=link.name)
        for name, _, step in self.stairs:
            for cell in step:
                self._add(cell, "stop", f"{name} {flat.level_of(cell)}")
        for door in self.grid.doors:
            cells = find_leaf_cells(door, flat)
            cells = cells[self.inside[cells]]
            if len(cells):
                cell = int(cells[np.argmax(np.round(self.clearance[cells], DIGITS))])
                self._add(cell, "door", door.id, door=door.id)
        for number, room in enumerate(rooms.rooms, 1):
            cells = np.flatnonzero((rooms.number == number) & self.inside)
            if len(cells):  # of several, the nearest to the room's centre
                off = np.linalg.norm(flat.positions(cells) - room.centroid, axis=1)
                best = np.lexsort((off, -np.round(self.clearance[cells], DIGITS)))[0]
                self._add(int(cells[best]), "room", room.name or room.id)

    def _add_junctions(self) -> None:
        """Add where three branches of the medial axis meet and no node is near, widest first."""
        found = []
        for number, level in enumerate(self.grid.levels):
            part = self.flat.cells_of(number)
            thin = thin_mask(self.inside[part].reshape(level.shape))
            _, turns = _around(np.pad(thin, 1))
            found.append(part.start + np.flatnonzero(thin & (turns >= 3)))
        cells = np.concatenate(found)
        order = np.argsort(-np.round(self.clearance[cells], DIGITS), kind="stable")
        for cell in cells[order].tolist():
            on = int(self.flat.level_of(cell))
            at = self.flat.positions(cell)
            near = np.flatnonzero(np.hypot(*(self.points - at)[:, :2].T) < APART).tolist()
            if not any(self.nodes[k].level == on and self._sees(self.cells[k], cell) for k in near):
                self._add(cell, "junction")

    def _cover(self) -> None:
        """Add waypoints until every cell is near a node."""
        cells = np.flatnonzero(self.inside)
        places = self.flat.positions(cells)
        places[:, 2] += 1e3 * self.flat.level_of(cells)  # other levels are far
        tree = spatial.cKDTree(places)
        while True:
            nodes = np.array(self.cells, dtype=np.int64)
            far = np.full(len(cells), math.inf)
            if len(nodes):
                far = self.search.field(nodes, by="length")[cells]
            left = np.flatnonzero(far > REACH)
            if not len(left):
                return
            left = left[np.argsort(-far[left], kind="stable")]
            taken = np.zeros(len(cells), dtype=np.bool_)
            for one in left.tolist():
                if not taken[one]:
                    near = np.array(tree.query_ball_point(places[one], REACH / 2))
                    same = self.search.islands.number[cells[near]]
                    near = near[same == self.search.islands.number[cells[one]]]
                    room = np.round(self.clearance[cells[near]], DIGITS)
                    best = near[np.lexsort((near, -room))[0]]
                    # a wider place only where it still reaches this one
                    best = best if self._sees(cells[best], cells[one]) else one
                    self._add(int(cells[best]), "waypoint")
                    taken[tree.query_ball_point(places[one], REACH)] = True

    def _sees(self, one: int, other: int) -> bool:
        """Whether an agent may move straight from one cell's centre to another's on its level.

        It may where `Search.can_pass` allows it, or over steps along a row, column or diagonal.
        """
        from navbake.runtime.grid_arrays import COL_STEP, ROW_STEP  # numba loads slowly

        level = int(self.flat.level_of(one))
        a, b = self.flat.positions(np.array([one, other]))
        a = np.round(a[:2], DIGITS)
        b = np.round(b[:2], DIGITS)
        if self.search.can_pass(a, b, level):
            return True
        _, (row, to_row), (col, to_col) = self.flat.split(np.array([one, other]))
        down = int(to_row - row)
        across = int(to_col - col)
        count = max(abs(down), abs(across))
        if not count or not (down == 0 or across == 0 or abs(down) == abs(across)):
            return False
        step = down // count * int(self.flat.layout.width[level]) + across // count
        steps = zip(ROW_STEP, COL_STEP, strict=True)
        bit = next(k for k, way in enumerate(steps) if way == (down // count, across // count))
        return bool((self.search.graph.moves[one + step * np.arange(count)] >> bit & 1).all())

    # ---------------------------------------------------------------- lanes

    def _apart(self, one: Any, other: Any) -> Any:
        """How far nodes are apart, seen from above, as paths' lengths are [m]."""
        return np.hypot(*(self.points[one] - self.points[other])[..., :2].T)

    def _cost(self, one: int, other: int) -> float:
        """The cost of a straight lane, or of a step between levels, which costs its length [m]."""
        level = self.nodes[one].level
        if level != self.nodes[other].level:
            return float(self._apart(one, other))
        return self._cost_of(self.points[[one, other], :2], level)

    def _cost_of(self, line: Float, level: int) -> float:
        """The cost of a line on a level, shape (n, 2) [m]."""
        steps = itertools.pairwise(line)
        return sum(float(np.hypot(*(b - a))) * self._price(a, b, level) for a, b in steps)

    def _price(self, a: Float, b: Float, level: int) -> float:
        """The mean weight of the cells on a straight line."""
        return float(self.flat.weight[self._cells_on(a, b, level)].mean())

    def _join(self, one: int, other: int, **fields: Any) -> None:
        """Add a lane between two nodes, and what it shortens."""
        length = self._apart(one, other)
        fields = {"length": length, "cost": self._cost(one, other), **fields}
        self.lanes.append(Lane(one, other, "", **fields))
        ways = [(one, other)] + [(other, one)] * fields.get("two_way", True)
        for a, b in ways:
            over = self.distance[:, a, None] + fields["cost"] + self.distance[None, b]
            np.minimum(self.distance, over, out=self.distance)

    def _link(self) -> None:
        """Add the lanes over links and stairs."""
        start = self.flat.layout.start
        for link in self.links:
            index = {
                cell: k
                for k, (cell, own) in enumerate(zip(self.cells, self.nodes, strict=True))
                if own.link in (None, link.name)
            }
            cells = [int(start[stop.level]) + stop.cell for stop in link.stops]
            for i, j in zip(*np.triu_indices(len(cells), 1), strict=True):
                if {cells[i], cells[j]} <= index.keys() and cells[i] != cells[j]:
                    length = link.length(int(i), int(j))
                    cost = length if link.cost is None else link.cost
                    self._join(
                        index[cells[i]], index[cells[j]], length=length, cost=cost,
                        two_way=not link.one_way, kind=link.kind, link=link.name,
                        seconds=cost / self.speed if link.seconds is None else link.seconds,
                    )  # fmt: skip
        index = {cell: k for k, cell in enumerate(self.cells)}
        for _, kind, (low, high) in self.stairs:
            self._join(index[low], index[high], kind=kind)

    def _is_free(self, one: int, other: int, doors: set[str | None]) -> bool:
        """Whether a straight lane is free, and leads through no other doors than some."""
        seen = self._sees(self.cells[one], self.cells[other])
        return seen and self._doors_on(one, other) <= doors

    def _doors_on(self, one: int, other: int) -> set[str | None]:
        """The doors whose leaves lie on the line between two nodes, and those of its ends; None."""
        level = self.nodes[one].level
        a, b = self.points[[one, other], :2]
        on = {self.leaves.get(cell) for cell in self._cells_on(a, b, level).tolist()}
        return on | {None, self.nodes[one].door, self.nodes[other].door}

    def _cells_on(self, a: Float, b: Float, level: int) -> Int:
        """The cells along a line, by points a quarter of a cell apart."""
        size = float(self.flat.layout.cell_size[level])
        count = math.ceil(float(np.linalg.norm(b - a)) / size * 4) + 1
        shares = (np.arange(count) + 0.5)[:, None] / count
        return self.flat.cells_at(a + shares * (b - a), level)

    def _join_visible(self) -> None:
        """Add lanes between nodes that see each other, unless a way over shorter ones will do."""
        levels = self.flat.level_of(np.array(self.cells, dtype=np.int64))
        pairs = []
        for level in range(self.flat.num_levels):
            own = np.flatnonzero(levels == level)
            if len(own) > 1:
                tree = spatial.cKDTree(self.points[own, :2])
                pairs.append(own[tree.query_pairs(LONGEST, output_type="ndarray")])
        if not pairs:
            return
        one, other = np.sort(np.concatenate(pairs), axis=1).T
        length = np.round(self._apart(one, other), DIGITS)
        order = np.lexsort((other, one, length))
        ways = zip(one[order].tolist(), other[order].tolist(), length[order].tolist(), strict=True)
        for a, b, straight in ways:
            doors = {None, self.nodes[a].door, self.nodes[b].door}
            if (
                self.distance[a, b] > STRETCH * straight * self.least
                and self.distance[a, b] > STRETCH * self._cost(a, b)
                and self._is_free(a, b, doors)
            ):
                self._join(a, b)

    def _join_regions(self) -> None:
        """Add the paths between nodes whose regions are near, unless a way over lanes will do.

        A cell belongs to the node that is the nearest by steps.
        """
        size = len(self.nodes)
        if not size:
            return
        ends = self._touching()
        touch = sparse.csr_array((np.ones(len(ends), np.int64), tuple(ends.T)), (size, size))
        near = touch = touch + touch.T
        for _ in range(HOPS - 1):
            near = near + near @ touch
        one, other = sparse.triu(near, 1).nonzero()
        straight = np.round(self._apart(one, other), DIGITS)
        order = np.lexsort((other, one, straight))
        pairs = np.stack([one, other], axis=1)[order].tolist()
        for (a, b), least in zip(pairs, straight[order].tolist(), strict=True):
            if self.distance[a, b] > STRETCH * least * self.least:
                self._join_path(a, b, {None, self.nodes[a].door, self.nodes[b].door})
        for a, b in self._touching().tolist():  # through doors that stand side by side
            if not math.isfinite(self.distance[a, b]):
                self._join_path(a, b, {None, *self.leaves.values()})

    def _touching(self) -> Int:
        """The pairs of nodes whose regions touch on a level, shape (n, 2)."""
        from navbake.runtime.grid_arrays import EAST, SOUTH  # numba loads slowly

        cells = np.array(self.cells)
        _, onward = self.search.find_next_cells(cells)
        root = np.where(onward < 0, np.arange(len(onward)), onward)
        while (root != root[root]).any():
            root = root[root]
        index = np.full(len(root), -1)
        index[cells] = np.arange(len(cells))
        pairs = []
        for level in range(self.flat.num_levels):
            own = self.flat.cells_of(level)
            width = int(self.flat.layout.width[level])
            for bit, step in ((EAST, 1), (SOUTH, width)):
                here = own.start + np.flatnonzero(self.search.graph.moves[own] & bit)
                pairs.append(np.stack([index[root[here]], index[root[here + step]]], axis=1))
        found = np.unique(np.concatenate(pairs), axis=0)
        differ: Int = found[(found >= 0).all(axis=1) & (found[:, 0] != found[:, 1])]
        return differ

    def _join_path(self, one: int, other: int, doors: set[str | None]) -> None:
        """Add the path between two nodes of a level: its corners, and lanes between them."""
        level = self.nodes[one].level
        if level != self.nodes[other].level:
            return
        start = self.points[one, :2]
        end = self.points[other, :2]
        found = find_path(self.search, start, end, level, by="cost", smooth=True)
        if found is None or found.links or (found.levels != level).any():
            return
        if self.distance[one, other] <= STRETCH * self._cost_of(found.positions[:, :2], level):
            return
        cells = self.flat.cells_at(found.positions[1:-1, :2], level)
        centers = self.flat.positions(cells)[:, :2]
        turns = np.abs(centers - found.positions[1:-1, :2]).max(axis=1, initial=0.0) < 1e-6
        # corners of the path, without the points where only the floor bends
        left = [*cells[turns].tolist(), self.cells[other]]
        corners = [one]
        while left:
            here = corners[-1]
            ahead_xy = self.flat.positions(np.array(left))[:, :2]
            line = np.concatenate([self.points[[here], :2], ahead_xy])
            seen = [
                k
                for k, cell in enumerate(left)
                if self._sees(self.cells[here], cell)
                and self._cost_of(line[[0, k + 1]], level)
                <= STRETCH * self._cost_of(line[: k + 2], level)
            ]
            last = max(seen, default=0)
            ahead = left[last + 1 : last + 2]
            price = self._price(line[0], line[last + 1], level)
            near = np.hypot(*(self.points - self.flat.positions(left[last]))[:, :2].T)
            ends = self.cells[here], *ahead
            known = [
                k
                for k in np.flatnonzero(near < SNAP).tolist()
                if self.nodes[k].level == level
                and all(self._sees(self.cells[k], end) for end in ends)
                and self._cost(here, k) <= STRETCH * price * self._apart(here, k)
            ]
            if known and ahead:
                corners.append(min(known, key=near.__getitem__))
            else:
                corners.append(self._add(left[last], "waypoint"))
            left = left[last + 1 :]
        for a, b in itertools.pairwise(corners):
            if a != b and self.distance[a, b] > self._cost(a, b) and self._is_free(a, b, doors):
                self._join(a, b)

    # ---------------------------------------------------------------- the graph

    def _graph(self) -> RouteGraph:
        """The graph: nodes have unique names, and lanes their doors and what areas make of them."""
        taken = set[str]()
        nodes = list[Node]()
        lanes = list[Lane]()
        for number, node in enumerate(self.nodes):
            name = base = node.name or f"{node.kind} {number}"
            while name in taken:
                name = f"{base} ({number})"
                number += 1
            taken.add(name)
            nodes.append(replace(node, name=name))
        for lane in self.lanes:
            one = nodes[lane.start]
            other = nodes[lane.end]
            fields: dict[str, Any] = {"name": f"{one.name} - {other.name}"}
            for key in ("length", "cost", "seconds"):
                value = getattr(lane, key)
                fields[key] = None if value is None else round(float(value), DIGITS)
            if lane.kind == FLOOR:
                through = self._doors_on(lane.start, lane.end)
                fields["door"] = min((door for door in through if door), default=None)
                begin, end = self.points[[lane.start, lane.end], :2]
                numbers = np.unique(self.areas[self._cells_on(begin, end, one.level)]).tolist()
                speeds = [self.grid.areas[k - 1].speed for k in numbers if k]
                fields["speed"] = min((v for v in speeds if v is not None), default=None)
            lanes.append(replace(lane, **fields))
        return RouteGraph(
            tuple(nodes), tuple(lanes), self.grid.scene_id, tuple(self.grid.level_names),
            (self.search.agent and self.search.agent.name) or None, self.radius, self.speed,
        )  # fmt: skip


def _around(padded: Bool) -> tuple[Int, Int]:
    """How many of the eight neighbours of cells are set, and how often the ring turns to set."""
    inner = padded[1:-1, 1:-1].shape
    ways = ((0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0))
    ring = [padded[r : r + inner[0], c : c + inner[1]].view(np.int8) for r, c in ways]
    turns = [
        (one == 0) & (other == 1) for one, other in zip(ring, ring[1:] + ring[:1], strict=True)
    ]
    return np.sum(ring, axis=0), np.sum(turns, axis=0)


def thin_mask(mask: Bool) -> Bool:
    """Thin a mask to lines one cell wide."""
    padded = np.pad(mask, 1)
    while True:
        before = np.count_nonzero(padded)
        for first in (True, False):
            count, turns = _around(padded)
            north = padded[:-2, 1:-1]
            east = padded[1:-1, 2:]
            south = padded[2:, 1:-1]
            west = padded[1:-1, :-2]
            keeps = (north & east & south) | (east & south & west)
            if not first:
                keeps = (north & east & west) | (north & south & west)
            goes = padded[1:-1, 1:-1] & (count >= 2) & (count <= 6) & (turns == 1) & ~keeps
            padded[1:-1, 1:-1][goes] = False
        if np.count_nonzero(padded) == before:
            return padded[1:-1, 1:-1]
