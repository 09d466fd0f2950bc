"""Random places and poses, where many agents start, and the lattice that steps lead to.

Many agents start at a distance by Poisson-disc sampling, by dart throwing (Cook 1986), on the cells
that are still free of the agents before. A crowd that jams is drawn again, and at last packed row
by row. Two agents clash if their centres are less than `reach` [m] apart on the map and their
floors less than `height` [m].
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.cells import check_level
from navbake.runtime.flat_grid import REAL, FlatGrid, check_distance, text_of
from navbake.runtime.inflation import check_radius, ledges_of
from navbake.runtime.places import SLACK, PlaceQuestions, cells_in_annulus
from navbake.runtime.surroundings import free_for
from navbake.types import Bool, Float, Int

INSIDE = 1e-6  # of a cell: how far from its edges a point stays
STRATA = ("area", "room", "island")
STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
NEAR = 1e-4  # of a cell: tolerance of a step's end
TOUCH = 1e-9  # share of a radius by which a disc may overlap a square
TRIES = 8  # random crowds before one is packed
DARTS = 32  # cells drawn at once
SHIFTS = 3  # of the honeycomb, along each axis
REMEDY = "expected fewer agents, or a smaller min_distance or clearance"


class Pose(NamedTuple):
    """An agent's position and heading."""

    position: Float  #: World x, y and floor z [m], shape (3,), float64.
    heading: float  #: 0 along x, counted towards y, -pi to pi [rad].


class Spawns(NamedTuple):
    """Start poses of many agents; as `Pose`, of shapes (n, 3) and (n,)."""

    positions: Float
    headings: Float


class DrawQuestions(PlaceQuestions):
    """Draws random places, poses and start poses, and lists the lattice of reachable positions."""

    def random_point(
        self,
        rng: Generator | None = None,
        count: int | None = None,
        *,
        level: int | None = None,
        room: str | None = None,
        island: int | None = None,
        reachable_from: ArrayLike | None = None,
        anywhere: bool = False,
    ) -> Float:
        """Draw places where an agent can stand, uniformly by area.

        Args:
            count: how many, with repetition; one unless given.
            level, room, island: only there.
            reachable_from: only where a path leads to from this free position.
            anywhere: draw points anywhere in the cells, up to half a cell nearer to obstacles;
                else the cells' centres, where the agent's radius fits.

        Raises:
            QueryError: there is no such place, or `rng` is no numpy Generator.
        """
        search = self.search
        islands = search.chosen_islands(island, reachable_from)
        cells = np.flatnonzero(search.allowed(level=level, room=room, islands=islands))
        where = ", ".join(map(str, islands or ()))
        return self._draw(cells, rng, count, anywhere, level=level, room=room, island=where or None)

    def random_point_near(
        self,
        rng: Generator | None,
        position: ArrayLike,
        max_distance: float,
        count: int | None = None,
        *,
        min_distance: float = 0.0,
        straight: bool = False,
        room: str | None = None,
        level: int | None = None,
        anywhere: bool = False,
    ) -> Float:
        """Draw places near a position, else as `random_point`.

        Distances [m] to cells' centres are those of the shortest path, from a free position; or,
        if `straight`, straight-line distances on the map of its level, also through walls.
        """
        cells, limits = self._cells_near(position, (min_distance, max_distance), straight, level)
        if room is not None:
            cells = cells[self.rooms.number[cells] == self.rooms.find(room)]
        return self._draw(cells, rng, count, anywhere, room=room, **limits)

    def any_free_in_annulus(
        self,
        position: ArrayLike,
        min_distance: float,
        max_distance: float,
        *,
        level: int | None = None,
    ) -> bool:
        """Whether a free cell's centre lies in an annulus [m] round a position, on its level."""
        cells, _ = self._cells_near(position, (min_distance, max_distance), True, level)
        return len(cells) > 0

    def random_pose(
        self,
        rng: Generator | None = None,
        target: ArrayLike | None = None,
        max_distance: float = 1.0,
        *,
        min_distance: float = 0.0,
        in_sight: bool = True,
        same_room: bool = False,
        level: int | None = None,
    ) -> Pose:
        """Draw a pose, facing a target if there is one.

        Args:
            target: a position, which may be inside an object; the agent stands on its level.
            max_distance, min_distance: from the target, in a straight line on the map [m].
            in_sight: only the object that the target is in may be in between, as with `snap`.
            same_room: stand in the target's room.
            level: of the target; without a target, of the agent.

        Raises:
            QueryError: as `random_point`.
        """
        rng = as_generator(rng)
        search = self.search
        if target is None:
            cells = np.flatnonzero(search.allowed(level=level))
            place = self._draw(cells, rng, None, False, level=level)
            return Pose(place, float(rng.uniform(-math.pi, math.pi)))
        cells, limits = self._cells_near(target, (min_distance, max_distance), True, level)
        flat = search.flat
        number = search.rooms.number
        p, home = flat.locate(target, level)
        if same_room:
            cells = cells[(number[cells] == number[home]) & (number[home] > 0)]
        if in_sight:
            # the first in a random order that sees the target: uniform among all that do
            cells = rng.permutation(cells)
            points = np.ascontiguousarray(flat.positions(cells)[:, :2])
            found = search.first_in_sight(home, p, cells, points, number)
            cells = cells[found : found + 1] if found >= 0 else cells[:0]
        place = self._draw(cells, rng, None, False, **limits, **{"in sight": in_sight})
        return Pose(place, math.atan2(p[1] - place[1], p[0] - place[0]))

    def spawn(
        self,
        rng: Generator | None,
        n: int,
        *,
        rooms: str | Sequence[str] | None = None,
        level: int | None = None,
        island: int | None = None,
        reachable_from: ArrayLike | None = None,
        clearance: float | None = None,
        min_distance: float | None = None,
        facing: ArrayLike | None = None,
        stratify: str | None = None,
    ) -> Spawns:
        """Draw collision-free start poses for many agents.

        Positions are centres of cells, drawn one after the other, uniformly by area, from the
        cells far enough from all earlier ones on the map (Poisson-disc sampling). Agents whose
        floors are the agent's height or more apart are always far enough.

        Args:
            n: how many agents, >= 1.
            rooms: in these rooms; one or several.
            level, island, reachable_from: see `random_point`.
            clearance: a disc of this radius round each agent overlaps no obstacle and no drop, as
                with `grid.inflate` [m]; nor another agent's, unless `min_distance` is given.
            min_distance: between the centres of any two agents [m]; always more than twice the
                agent's radius, that of the grid's inflation, or else of its bake.
            facing: a position or a heading [rad] that all face; random headings if None.
            stratify: ``area`` draws one agent in each of n parts of equal area; ``room`` and
                ``island`` share the agents out evenly, and none stand in cells without a room.
                Agents that don't fit into a part go to others.

        Raises:
            QueryError: they don't fit; the message has an upper bound where one is known.
        """
        rng = as_generator(rng)
        search = self.search
        grid = self.grid
        check_level(level, search.flat.num_levels)
        if clearance is not None:
            check_radius(clearance, "clearance")
            clearance = float(clearance)
        names = [rooms] if isinstance(rooms, str | int) else list(rooms or ())
        if rooms is not None and not names:
            raise QueryError("expected at least one room, got none")
        numbers = tuple(sorted({search.rooms.find(name) for name in names}))
        islands = search.chosen_islands(island, reachable_from)
        if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 1:
            raise QueryError(f"expected a number of agents n >= 1, got {n!r}")
        if stratify not in (None, *STRATA):
            raise QueryError(f"expected {', '.join(STRATA)} or None as stratify, got {stratify!r}")
        least = 0.0 if min_distance is None else min_distance
        radius = grid.radius
        check_distance(least, "min_distance")
        if min_distance is None:
            radius = max(radius, clearance or 0.0)
        ids = [search.rooms.id_of(number) for number in numbers] or [grid.scene_id]
        where = f"in {', '.join(map(repr, ids))}"
        where += f" on level {level}" if level is not None else ""
        if islands is not None:
            plural = "s" if len(islands) > 1 else ""
            where += f" on island{plural} {', '.join(map(str, islands))}"

        def find() -> Int:
            allowed = search.allowed(level=level, islands=islands)
            if numbers:
                allowed = allowed & np.isin(search.rooms.number, numbers)
            if clearance is not None:
                allowed = allowed & free_for(grid, clearance, ledges_of(grid))
            return along_hilbert(search.flat, np.flatnonzero(allowed))

        cells = search.cached("spawns", (numbers, level, islands, clearance), find)
        if not len(cells):
            needed = "" if clearance is None else f" with {clearance:g} m round"
            raise QueryError(f"no free cell{needed} {where}")
        parts = [cells]
        if stratify == "area":
            parts = parts_of_area(search.flat, cells, int(n), rng.random())
        elif stratify is not None:
            number = (search.rooms if stratify == "room" else search.islands).number[cells]
            if not number.any():
                raise QueryError(f"no {stratify} of {grid.scene_id!r} has a free cell to spawn on")
            order = np.argsort(number, kind="stable")[np.count_nonzero(number == 0) :]
            _, first = np.unique(number[order], return_index=True)
            parts = np.split(cells[order], first[1:])
        # centres up to this distance apart clash, with slack for rounding
        reach = max(2.0 * radius, least - 2.0 * SLACK, 0.0)
        words = f"{least:g} m apart" if least > 2.0 * radius else f"of radius {radius:g} m"
        apart = reach, grid.agent_height
        chosen = place_crowd(search.flat, parts, int(n), apart, rng, (words, where))
        positions = search.flat.positions(chosen)
        if facing is None:
            return Spawns(positions, rng.uniform(-math.pi, math.pi, size=int(n)))
        if isinstance(facing, REAL):
            if not math.isfinite(facing):
                raise QueryError(f"expected a finite heading [rad] as facing, got {facing!r}")
            return Spawns(positions, np.full(int(n), math.remainder(facing, 2.0 * math.pi)))
        target = search.flat.check_one(facing, 0, "position or heading as facing")
        away = target[:2] - positions[:, :2]
        return Spawns(positions, np.arctan2(away[:, 1], away[:, 0]))

    def reachable_positions(
        self, start: ArrayLike, spacing: float = 0.25, *, level: int | None = None
    ) -> Float:
        """List the lattice positions that steps along x and y reach from a start, as AI2-THOR does.

        The square lattice goes through the start, a free position. A step counts if `try_step`
        reaches its end without sliding and the agent's disc is free of obstacles there. The start
        comes first, then positions by number of steps. `spacing` is at least a cell's size [m].
        """
        flat = self.search.flat
        radius = self.grid.radius
        cell = float(flat.layout.cell_size.max())
        if not isinstance(spacing, REAL) or not cell * (1 - NEAR) <= spacing < np.inf:
            raise QueryError(f"expected a spacing of a cell's {cell:g} m or more, got {spacing!r}")
        p, home = flat.free_cell_at(start, level)
        first = np.append(p[:2], flat.positions(home)[2])
        places = first[None]
        at = np.zeros((1, 2), dtype=np.int64)
        seen = {(int(flat.level_of(home)), 0, 0)}
        found = [places]
        while len(places):
            at = (at[:, None] + STEPS).reshape(-1, 2)
            wanted = first[:2] + at * spacing
            ends = self.try_step(np.repeat(places, len(STEPS), axis=0), wanted, slide=False)
            arrived = (np.abs(ends[:, :2] - wanted) <= NEAR * cell).all(axis=1)
            at = at[arrived]
            places = ends[arrived]
            cells = flat.cells_at(places)
            points = list(zip(flat.level_of(cells).tolist(), *at.T.tolist(), strict=True))
            new = [p not in seen and seen.add(p) is None for p in points]  # type: ignore[func-returns-value]
            at = at[new]
            places = places[new]
            cells = cells[new]
            # free cells' centres are free of obstacles; elsewhere, measure the clearance
            off = np.abs(places - flat.positions(cells))[:, :2].max(axis=1)
            is_center = off <= NEAR * flat.layout.cell_size[flat.level_of(cells)]
            clearance = self.clearance(places, max_distance=2.0 * radius + 1.0)
            stands = is_center | (clearance >= radius * (1.0 - TOUCH))
            at = at[stands]
            places = places[stands]
            found.append(places)
        return np.concatenate(found)

    def _draw(
        self, cells: Int, rng: Generator | None, count: int | None, anywhere: bool, **limits: object
    ) -> Float:
        """Draw places in some cells; `limits` are named in the error if there are none."""
        rng = as_generator(rng)
        if count is not None and (not isinstance(count, int | np.integer) or count < 0):
            raise QueryError(f"expected a count >= 0, got {count!r}")
        if not len(cells):
            given = [f"{name} {v}" for name, v in limits.items() if v not in (None, False)]
            asked = f" with {', '.join(given)}" if given else ""
            raise QueryError(f"no free cell in {self.grid.scene_id!r}{asked}")
        flat = self.search.flat
        num = 1 if count is None else int(count)
        chosen = cells[draw_cells(flat, cells, rng, num)]
        positions = flat.positions(chosen)
        if anywhere:
            size = flat.layout.cell_size[flat.level_of(chosen)]
            half = 0.5 - INSIDE
            positions[:, :2] += rng.uniform(-half, half, size=(num, 2)) * size[:, None]
        return positions.reshape(3) if count is None else positions

    def _cells_near(
        self, position: ArrayLike, distances: tuple[float, float], straight: bool, level: int | None
    ) -> tuple[Int, dict[str, object]]:
        """The free cells within distances of a position, and the limits for `_draw`."""
        low, high = distances
        if not (isinstance(low, REAL) and isinstance(high, REAL) and 0 <= low <= high):
            wanted = "0 <= min_distance <= max_distance [m]"
            raise QueryError(f"expected {wanted}, got {low} and {high}")
        flat = self.search.flat
        p, home = flat.locate(position, level)
        if home < 0:
            where = f"in no cell of {self.grid.scene_id!r}"
            raise QueryError(f"{text_of(p)} is {where}: nothing is near")
        if straight:
            cells = cells_in_annulus(flat, int(flat.level_of(home)), p, distances, flat.free)
        else:
            flat.free_cell_at(p, level)
            field = self.search.field(np.array([home]), by="length", backwards=False)
            near = (field >= low) & (field <= high + SLACK)
            cells = np.flatnonzero(near & np.isfinite(field))  # inf <= inf where no path leads
        return cells, {"distance [m]": f"{low:g} to {high:g}"}


def as_generator(rng: object) -> Generator:
    """The given generator, or a new one for None; raises QueryError for anything else."""
    if rng is None:
        return np.random.default_rng()
    if not isinstance(rng, Generator):
        wanted = "a numpy.random.Generator, or None"
        raise QueryError(f"expected {wanted}, got {rng!r}: make one with numpy.random.default_rng")
    return rng


# ---------------------------------------------------------------- crowds


def place_crowd(
    flat: FlatGrid,
    parts: list[Int],
    n: int,
    apart: tuple[float, float],
    rng: Generator,
    words: tuple[str, str],
) -> Int:
    """Draw a cell for each of n agents: flat ids in random order; QueryError if they don't fit.

    Each part, an array of flat ids, gets n / len(parts) agents, rounded; agents that don't fit go
    to other parts. `apart` is (`reach`, `height`); `words` name the agents and the area in errors.
    """
    agents = f"{'1 agent' if n == 1 else f'{n} agents'} {words[0]}"
    where = words[1]
    found = most = 0
    for attempt in range(TRIES):
        # the part of each agent
        whole = np.tile(np.arange(len(parts)), n // len(parts))
        rest = rng.permutation(len(parts))[: n % len(parts)]
        owner = rng.permutation(np.concatenate([whole, rest]))
        chosen = _draw_crowd(flat, parts, apart, owner, rng)
        found = max(found, len(chosen))
        if found == n:
            return chosen
        if attempt == 0:
            most = most_that_fit(flat, np.concatenate(parts), apart)
            if most < n:
                raise QueryError(f"{agents}: at most {most} fit {where}; {REMEDY}")
    packed = _pack_crowd(flat, np.concatenate(parts), apart, n, rng)
    if len(packed) == n:
        return rng.permutation(packed)
    known = f"places for {max(found, len(packed))} were found {where}"
    raise QueryError(f"{agents}: {known}, and more than {most} never fit; {REMEDY}")


def most_that_fit(flat: FlatGrid, cells: Int, apart: tuple[float, float]) -> int:
    """An upper bound of the number of agents that fit on some cells.

    In a honeycomb whose hexagons are `reach` wide, each hexagon holds one agent. The bound is the
    least number of hexagons with cells over several shifted honeycombs.
    """
    reach = apart[0] * (1.0 - 1e-6)
    height = apart[1]
    if reach <= 0.0 or not len(cells):
        return len(cells)
    p = flat.positions(cells)
    p -= p.min(axis=0)
    layer = np.floor(p[:, 2] / height) if height > 0 else np.zeros(len(cells))
    most = len(cells)
    for x, y in ((p[:, 0], p[:, 1]), (p[:, 1], p[:, 0])):
        for shift in np.ndindex(SHIFTS, SHIFTS):
            offset = np.array(shift) * reach / SHIFTS
            # axial coordinates of hexagons whose corners are half of `reach` from their middles,
            # rounded so that q + r + s is 0 again: the one with the largest error gives way
            u = (x + offset[0]) / (reach / 2)
            v = (y + offset[1]) / (reach / 2)
            exact = np.stack([math.sqrt(3.0) / 3.0 * u - v / 3.0, 2.0 / 3.0 * v])
            exact = np.vstack([exact, -exact.sum(axis=0)])
            near = np.round(exact)
            worst = np.argmax(np.abs(near - exact), axis=0), np.arange(len(cells))
            near[worst] -= near.sum(axis=0)
            q, r = near[:2] - near[:2].min(axis=1, keepdims=True)
            numbers = q + (q.max() + 1) * (r + (r.max() + 1) * layer)
            most = min(most, len(np.unique(numbers)))
    return most


def _take(flat: FlatGrid, apart: tuple[float, float], taken: Bool, cell: int) -> None:
    """Mark the cells that are too near to a cell as taken."""
    reach, height = apart
    here = flat.positions(cell)
    for level in range(flat.num_levels):
        near = cells_in_annulus(flat, level, here, (0.0, reach), flat.free)
        if flat.num_levels > 1 or reach > height:
            rise = np.abs(flat.positions(near)[:, 2] - here[2])
            near = near[rise < height]
        taken[near] = True
    taken[cell] = True


def _draw_crowd(
    flat: FlatGrid, parts: list[Int], apart: tuple[float, float], owner: Int, rng: Generator
) -> Int:
    """Draw a cell for each agent from its part, else from another; stops early if none is left."""
    left = list(parts)
    chosen = np.empty(len(owner), dtype=np.int64)
    taken = np.zeros(flat.num_cells, dtype=np.bool_)

    def throw(cells: Int) -> Int:
        darts = cells[draw_cells(flat, cells, rng, DARTS)] if len(cells) else cells
        return darts[~taken[darts]]

    for k, own in enumerate(owner.tolist()):
        for part in (own, *rng.permutation(len(parts)).tolist()):
            hits = throw(left[part])
            while not len(hits) and len(left[part]):
                left[part] = left[part][~taken[left[part]]]
                hits = throw(left[part])
            if len(hits):
                break
        else:
            return chosen[:k]
        chosen[k] = hits[0]
        _take(flat, apart, taken, int(hits[0]))
    return chosen


def _pack_crowd(
    flat: FlatGrid, cells: Int, apart: tuple[float, float], n: int, rng: Generator
) -> Int:
    """Place up to n agents row by row from a random side, each in the first cell left."""
    swap = rng.integers(2)
    signs = rng.choice([-1.0, 1.0], size=2)
    p = flat.positions(cells)[:, :2] * signs
    taken = np.zeros(flat.num_cells, dtype=np.bool_)
    chosen: list[int] = []
    for cell in cells[np.lexsort((p[:, swap], p[:, 1 - swap]))].tolist():
        if len(chosen) < n and not taken[cell]:
            chosen.append(cell)
            _take(flat, apart, taken, cell)
    return np.array(chosen, dtype=np.int64)


def draw_cells(flat: FlatGrid, cells: Int, rng: Generator, count: int) -> Int:
    """Draw indices into cells, with probability in proportion to the cells' areas."""
    sizes = flat.layout.cell_size
    if len(set(sizes)) == 1:
        return rng.integers(len(cells), size=count)
    # cells of different areas: search a random number in the cumulative area
    edges = np.cumsum(sizes[flat.level_of(cells)] ** 2)
    found = np.searchsorted(edges, rng.uniform(0.0, edges[-1], size=count), side="right")
    return np.minimum(found, len(cells) - 1)


def parts_of_area(flat: FlatGrid, cells: Int, n: int, start: float) -> list[Int]:
    """Cut cells, ordered by `along_hilbert`, into n parts of equal area; some may be empty.

    The first part begins at the share `start` of the whole area.
    Source: He and Owen, "Extensible grids: uniform sampling on a space filling curve" (2016).
    """
    ends = np.cumsum(flat.layout.cell_size[flat.level_of(cells)] ** 2)
    # a cell belongs to the part that contains its middle
    middle = (ends - np.diff(ends, prepend=0.0) / 2) / ends[-1]
    part = np.floor(((middle - start) % 1.0) * n).astype(np.int64)
    order = np.argsort(part, kind="stable")
    return np.split(cells[order], np.searchsorted(part[order], np.arange(1, n)))


def along_hilbert(flat: FlatGrid, cells: Int) -> Int:
    """Sort cells by level and along the curve of Hilbert (1891)."""
    level, row, col = flat.split(cells)
    x = col
    y = row
    index = np.zeros_like(row)
    side = 1 << max(int(max(row.max(initial=0), col.max(initial=0))).bit_length() - 1, 0)
    while side:
        right = (x & side > 0).astype(np.int64)
        lower = (y & side > 0).astype(np.int64)
        index += side * side * ((3 * right) ^ lower)
        # each quarter holds the curve of half the size, turned or mirrored to fit
        mirrored = (lower == 0) & (right == 1)
        x = np.where(mirrored, side - 1 - x, x)
        y = np.where(mirrored, side - 1 - y, y)
        x, y = np.where(lower == 0, y, x), np.where(lower == 0, x, y)
        x = x & (side - 1)
        y = y & (side - 1)
        side >>= 1
    return cells[np.lexsort((index, level))]
