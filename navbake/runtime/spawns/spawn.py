"""Draws where many agents start, see `PathFinder.spawn`."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.cells import check_level, check_positions
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.inflation.inflate import check_radius, find_blocked
from navbake.runtime.inflation.margins import agent_radius, exact_radius, ledges_of
from navbake.runtime.places.checks import REAL, as_generator, check_distance
from navbake.runtime.spawns.crowd import Spacing, place_crowd
from navbake.runtime.spawns.strata import (
    STRATA,
    along_hilbert,
    parts_of_area,
    parts_of_regions,
)
from navbake.types import Bool, Float, Int

MAX_KEPT = 8  # selections of cells that are kept for the next call


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


class Spawner:
    """Draws starts on a grid, and keeps the last few selections of cells.

    Args:
        cache: the grid, and what follows from it.
    """

    def __init__(self, cache: GridCache) -> None:
        self._cache = cache
        self._cells: dict[tuple[int, Selection], Int] = {}
        self._clear: dict[tuple[int, float], Bool] = {}

    def select(
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
            home = int(cache.islands.number[cache.flat.free_cell_at(reachable_from)[1]])
            if island not in (None, home):
                raise QueryError(f"island {island} can't be reached: the position is on {home}")
            island = home
        return Selection(numbers, level, island, None if clearance is None else float(clearance))

    def draw(
        self,
        rng: np.random.Generator | None,
        n: int,
        selection: Selection,
        *,
        min_distance: float | None,
        facing: ArrayLike | None,
        stratify: str | None,
    ) -> Spawns:
        """`PathFinder.spawn`, in selected cells."""
        rng, cache = as_generator(rng), self._cache
        if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 1:
            raise QueryError(f"expected a number of agents n >= 1, got {n!r}")
        if stratify not in (None, *STRATA):
            raise QueryError(f"expected {', '.join(STRATA)} or None as stratify, got {stratify!r}")
        if min_distance is not None:
            check_distance(min_distance, "min_distance")
        target = self._check_facing(facing)
        spacing = self._spacing(selection, min_distance)
        cells, where = self._cells_of(selection), self._describe(selection)
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

    def _spacing(self, selection: Selection, min_distance: float | None) -> Spacing:
        grid = self._cache.grid
        radius = agent_radius(grid)
        if min_distance is None:
            radius = max(radius, selection.clearance or 0.0)
        return Spacing(radius, float(min_distance or 0.0), grid.agent_height)

    def _check_facing(self, facing: ArrayLike | None) -> Float | None:
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

    def _cells_of(self, selection: Selection) -> Int:
        """The selected cells along Hilbert's curve, at least one."""
        cache = self._cache
        key = (cache.search.version, selection)
        cells = self._cells.pop(key, None)
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
        self._cells[key] = cells  # last in the row, so the first is the one unused for longest
        for old in list(self._cells)[:-MAX_KEPT]:
            del self._cells[old]
        return cells

    def _clear_for(self, clearance: float) -> Bool:
        """Where a disc of a radius meets nothing, as `grid.inflate` has it, by flat id."""
        grid, key = self._cache.grid, (self._cache.search.version, clearance)
        if key not in self._clear:
            ledges = ledges_of(grid) if exact_radius(grid) else "avoid"
            levels = range(len(grid.levels))
            masks = [~find_blocked(grid, k, clearance, ledges).ravel() for k in levels]
            self._clear = {key: np.concatenate(masks)}
        return self._clear[key]

    def _describe(self, selection: Selection) -> str:
        """What a message calls the selected cells."""
        cache = self._cache
        names = [repr(cache.rooms.id_of(number)) for number in selection.rooms]
        words = f"in {', '.join(names) or repr(cache.grid.scene_id)}"
        words += f" on level {selection.level}" if selection.level is not None else ""
        return words + (f" on island {selection.island}" if selection.island is not None else "")
