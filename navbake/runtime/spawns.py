"""Where many agents start, and the positions of a lattice that steps lead to."""

import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.cells import check_level, check_positions
from navbake.runtime.crowd import Spacing, place_crowd
from navbake.runtime.draws import DrawQuestions, as_generator
from navbake.runtime.flat_grid import REAL, FlatGrid, check_distance
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.inflation import agent_radius, check_radius, exact_radius, ledges_of
from navbake.runtime.places import ManyPlaces
from navbake.runtime.surroundings import find_blocked
from navbake.types import Bool, Float, Int

MAX_KEPT = 8  # selections of cells that are kept for the next call
STRATA = ("area", "room", "island")
STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
NEAR = 1e-4  # of a cell: how far from where it should be a step may end
TOUCH = 1e-9  # share of a radius by which a disc may be over what it touches


class Spawns(NamedTuple):
    """Where agents start.

    Attributes:
        positions: world x, y and floor z [m], shape (n, 3), float64.
        headings: 0 along x, counted towards y, -pi to pi [rad], shape (n,), float64.
    """

    positions: Float
    headings: Float


class Selection(NamedTuple):
    """Which cells agents may start in.

    Attributes:
        rooms: by number, ascending; none for all cells, in rooms or not.
        level: None for all.
        island: None for all.
        clearance: from obstacles [m]; None for that of the grid.
    """

    rooms: tuple[int, ...]
    level: int | None
    island: int | None
    clearance: float | None


class _Kept(NamedTuple):
    """Cells that agents may start in, from the last calls; each by the search's version then."""

    cells: dict[tuple[int, Selection], Int]
    clear: dict[tuple[int, float], Bool]


class SpawnQuestions(DrawQuestions):
    """Where many agents start, and where steps lead."""

    @property
    def many(self) -> ManyPlaces:
        """The same questions about many positions at once."""
        raise NotImplementedError

    def spawn(
        self,
        rng: np.random.Generator | None,
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
        """Draw where many agents start: none meets anything, or another one.

        Places are centres of cells where the agent's radius fits, that of the grid's inflation, or
        else of its bake. One after the other is drawn, evenly by area, from those that are far
        enough from all before it (Poisson-disc sampling). Distances between agents are measured
        on the map; agents on floors that are the agent's height or more apart don't count.

        Args:
            rng: see `random_point`.
            n: how many agents, >= 1.
            rooms: in these rooms, by id or name; one or several.
            level: on this level.
            island: on this island; 1 is the largest.
            reachable_from: where a path leads to from this world position [m].
            clearance: a disc of this radius round each agent meets no obstacle and no drop, as
                with `grid.inflate` [m]; unless `min_distance` is given, nor another agent's.
            min_distance: between the centres of any two agents [m]; in any case more than twice
                the agent's radius.
            facing: where all look: a world position [m], or a heading [rad]; everywhere, if None.
            stratify: ``area`` cuts the cells into n parts of one area and draws one agent in
                each; ``room`` and ``island`` draw as many agents in each, give or take one, and
                leave out cells in no room. Agents that don't fit into a part go to others.

        Returns:
            Positions and headings, in random order.

        Raises:
            QueryError: they don't fit, with how many do at most where that can be proved at once;
                there is no such room, level or island; a number makes no sense.
        """
        selection = self._select(rooms, level, island, reachable_from, clearance)
        rng, cache = as_generator(rng), self._cache
        if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 1:
            raise QueryError(f"expected a number of agents n >= 1, got {n!r}")
        if stratify not in (None, *STRATA):
            raise QueryError(f"expected {', '.join(STRATA)} or None as stratify, got {stratify!r}")
        if min_distance is not None:
            check_distance(min_distance, "min_distance")
        target = _check_facing(facing)
        radius = agent_radius(self.grid)
        if min_distance is None:
            radius = max(radius, selection.clearance or 0.0)
        spacing = Spacing(radius, float(min_distance or 0.0), self.grid.agent_height)
        cells, where = self._selected(selection), self._describe(selection)
        parts = [cells]
        if stratify == "area":
            parts = parts_of_area(cache.flat, cells, int(n), rng.random())
        elif stratify is not None:
            parts = parts_of_regions(cache, cells, stratify)
        chosen = place_crowd(cache.flat, parts, int(n), spacing, rng, where)
        positions = cache.flat.positions(chosen)
        if target is None:
            return Spawns(positions, rng.uniform(-math.pi, math.pi, size=int(n)))
        if target.ndim == 0:
            turned = math.remainder(float(target), 2.0 * math.pi)
            return Spawns(positions, np.full(int(n), turned))
        away = target[:2] - positions[:, :2]
        return Spawns(positions, np.arctan2(away[:, 1], away[:, 0]))

    def reachable_positions(
        self, start: ArrayLike, spacing: float = 0.25, *, level: int | None = None
    ) -> Float:
        """List the positions that steps of one length along x and y lead to.

        The positions are those of a square lattice through the start. A step is taken where
        `try_step` gets to its end without sliding, over links to other levels as well, and where
        the agent's disc meets no obstacle at its end. AI2-THOR calls these positions so.

        Args:
            start: world position [m] where an agent can stand; the first in the list. From a
                cell's centre, steps of whole cells lead to centres.
            spacing: of the lattice [m], a cell's size or more.

        Returns:
            World x, y and floor z [m], shape (n, 3), float64, those of the fewest steps first.

        Raises:
            QueryError: no agent can stand at the start, or the spacing is less than a cell.
        """
        flat, radius = self._cache.flat, agent_radius(self.grid)
        cell = float(flat.layout.cell_size.max())
        if not isinstance(spacing, REAL) or not cell * (1 - NEAR) <= spacing < np.inf:
            raise QueryError(f"expected a spacing of a cell's {cell:g} m or more, got {spacing!r}")
        p, home = flat.free_cell_at(start, level)
        first = np.append(p[:2], flat.positions(home)[2])
        seen = _Seen(flat, first[:2], float(spacing))
        places, at = first[None], np.zeros((1, 2), dtype=np.int64)
        seen.add(at, flat.level_of(np.array([home])))
        found = [places]
        while len(places):
            at = (at[:, None] + STEPS).reshape(-1, 2)
            wanted = first[:2] + at * spacing
            ends = self.many.try_step(np.repeat(places, len(STEPS), axis=0), wanted, slide=False)
            arrived = (np.abs(ends[:, :2] - wanted) <= NEAR * cell).all(axis=1)
            at, places = at[arrived], ends[arrived]
            cells = flat.cells_at(places)
            new = seen.add(at, flat.level_of(cells))
            at, places, cells = at[new], places[new], cells[new]
            # at a free cell's centre the agent's disc meets nothing; beside it, that is measured
            off = np.abs(places - flat.positions(cells))[:, :2].max(axis=1)
            is_center = off <= NEAR * flat.layout.cell_size[flat.level_of(cells)]
            clearance = self.many.clearance(places, max_distance=2.0 * radius + 1.0)
            stands = is_center | (clearance >= radius * (1.0 - TOUCH))
            at, places = at[stands], places[stands]
            found.append(places)
        return np.concatenate(found)

    def _select(
        self,
        rooms: str | Sequence[str] | None,
        level: int | None,
        island: int | None,
        reachable_from: ArrayLike | None,
        clearance: float | None,
    ) -> Selection:
        """Check what limits the cells."""
        cache = self._cache
        check_level(level, cache.flat.num_levels)
        if clearance is not None:
            check_radius(clearance, "clearance")
        numbers: tuple[int, ...] = ()
        if rooms is not None:
            is_one = isinstance(rooms, str) or not isinstance(rooms, Iterable)
            names: list[Any] = [rooms] if is_one else list(rooms)
            if not names:
                raise QueryError("expected at least one room, got none")
            numbers = tuple(sorted({cache.rooms.find(name) for name in names}))
        if island is not None:
            island = cache.islands.check(island)
        if reachable_from is not None:
            island = cache.home_island(reachable_from, island)
        return Selection(numbers, level, island, None if clearance is None else float(clearance))

    def _selected(self, selection: Selection) -> Int:
        """The selected cells along Hilbert's curve, at least one."""
        cache, kept = self._cache, self._kept.cells
        key = (cache.search.version, selection)
        cells = kept.pop(key, None)
        if cells is None:
            allowed = cache.allowed(level=selection.level, island=selection.island)
            if selection.rooms:
                allowed = allowed & np.isin(cache.rooms.number, selection.rooms)
            if selection.clearance is not None:
                allowed = allowed & self._clear_for(selection.clearance)
            cells = along_hilbert(cache.flat, np.flatnonzero(allowed))
        if not len(cells):
            needed = "" if selection.clearance is None else f" with {selection.clearance:g} m round"
            raise QueryError(f"no free cell{needed} {self._describe(selection)}")
        kept[key] = cells  # last in the row, so the first is the one unused for longest
        for old in list(kept)[:-MAX_KEPT]:
            del kept[old]
        return cells

    def _clear_for(self, clearance: float) -> Bool:
        """Where a disc of a radius meets nothing, as `grid.inflate` has it, by flat id."""
        grid, clear, key = self.grid, self._kept.clear, (self._cache.search.version, clearance)
        if key not in clear:
            ledges = ledges_of(grid) if exact_radius(grid) else "avoid"
            levels = range(len(grid.levels))
            masks = [~find_blocked(grid, k, clearance, ledges).ravel() for k in levels]
            clear.clear()
            clear[key] = np.concatenate(masks)
        return clear[key]

    def _describe(self, selection: Selection) -> str:
        """What a message calls the selected cells."""
        cache = self._cache
        names = [repr(cache.rooms.id_of(number)) for number in selection.rooms]
        words = f"in {', '.join(names) or repr(cache.grid.scene_id)}"
        words += f" on level {selection.level}" if selection.level is not None else ""
        return words + (f" on island {selection.island}" if selection.island is not None else "")

    @cached_property
    def _kept(self) -> _Kept:
        return _Kept({}, {})


def _check_facing(facing: ArrayLike | None) -> Float | None:
    """A heading [rad] of shape (), or a position; None for neither."""
    if facing is None:
        return None
    if isinstance(facing, REAL) and not isinstance(facing, bool):
        if not math.isfinite(facing):
            raise QueryError(f"expected a finite heading [rad] as facing, got {facing!r}")
        return np.asarray(float(facing))
    p = check_positions(facing, 1)
    if p.ndim != 1:
        raise QueryError(f"expected one position or heading as facing, got shape {p.shape}")
    return p


class _Seen:
    """The points of the lattice that steps have led to, on each level."""

    def __init__(self, flat: FlatGrid, origin: Float, spacing: float) -> None:
        layout = flat.layout
        x1 = layout.x_min + layout.width * layout.cell_size
        y0 = layout.y_max - layout.height * layout.cell_size
        low = np.array([layout.x_min.min(), y0.min()])
        high = np.array([x1.max(), layout.y_max.max()])
        self._first = np.floor((low - origin) / spacing).astype(np.int64) - 1
        size = np.ceil((high - origin) / spacing).astype(np.int64) + 2 - self._first
        self._seen = np.zeros((flat.num_levels, *size), dtype=np.bool_)

    def add(self, at: Int, levels: Int) -> Int:
        """Note points on levels; the indices of those that are new, each once."""
        places = np.ravel_multi_index((levels, *(at - self._first).T), self._seen.shape)
        _, once = np.unique(places, return_index=True)
        once = np.sort(once)
        new = once[~self._seen.ravel()[places[once]]]
        self._seen.ravel()[places[new]] = True
        return new


def parts_of_area(flat: FlatGrid, cells: Int, n: int, start: float) -> list[Int]:
    """Cut cells, ordered by `along_hilbert`, into n parts of one area each; some may be empty.

    The first part begins at a share `start` of the whole, and parts run on from its end to its
    beginning. So with a random start each cell is as likely as its area has it.

    Source: He and Owen, "Extensible grids: uniform sampling on a space filling curve" (2016).
    """
    ends = np.cumsum(flat.layout.cell_size[flat.level_of(cells)] ** 2)
    # a cell belongs to the part that its middle is in
    middle = (ends - np.diff(ends, prepend=0.0) / 2) / ends[-1]
    part = np.floor(((middle - start) % 1.0) * n).astype(np.int64)
    order = np.argsort(part, kind="stable")
    return np.split(cells[order], np.searchsorted(part[order], np.arange(1, n)))


def parts_of_regions(cache: GridCache, cells: Int, kind: str) -> list[Int]:
    """The cells of each room or island; those in none are left out."""
    numbers = (cache.rooms.number if kind == "room" else cache.islands.number)[cells]
    cells, numbers = cells[numbers > 0], numbers[numbers > 0]
    if not len(cells):
        raise QueryError(f"no {kind} of {cache.grid.scene_id!r} has a free cell to spawn on")
    order = np.argsort(numbers, kind="stable")
    _, first = np.unique(numbers[order], return_index=True)
    return np.split(cells[order], first[1:])


def along_hilbert(flat: FlatGrid, cells: Int) -> Int:
    """Cells in the order of Hilbert's curve, level by level: neighbours in the row are near."""
    level, row, col = flat.split(cells)
    return cells[np.lexsort((_hilbert_index(row, col), level))]


def _hilbert_index(row: Int, col: Int) -> Int:
    """How far along Hilbert's curve (1891) each cell of a square of 2^k by 2^k cells is."""
    x, y, index = col.copy(), row.copy(), np.zeros_like(row)
    side = 1 << max(int(max(row.max(initial=0), col.max(initial=0))).bit_length() - 1, 0)
    while side:
        right, lower = (x & side > 0).astype(np.int64), (y & side > 0).astype(np.int64)
        index += side * side * ((3 * right) ^ lower)
        # each quarter holds the curve of half the size, turned or mirrored to fit
        mirrored = (lower == 0) & (right == 1)
        x, y = np.where(mirrored, side - 1 - x, x), np.where(mirrored, side - 1 - y, y)
        x, y = np.where(lower == 0, y, x), np.where(lower == 0, x, y)
        x, y = x & (side - 1), y & (side - 1)
        side >>= 1
    return index
