"""What a bake has to yield, computed from the words of design.md by plain exact geometry."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from oracles.prisms import FREE, OCCUPIED, UNKNOWN, Prisms
from oracles.scene import HalfSpace, Part, Thing, cross_all, part_meets_prisms, part_of, widen
from oracles.solids import Float, Polytope
from oracles.surfaces import Surface

Bool = NDArray[np.bool_]

ONE = 1e-5  # surfaces this close together are one [m]
SURE = 1e-7  # less than this is rounding [m]
RIM = 1e-8  # for exact rims [m]
BESIDE = 1e-6  # how far beside a seam its lines are cast [m]
UNSURE = 2e-6  # up to this a limit may count as kept or not [m]
LEANING = 0.05  # sides that face up by at most this may be upright ones that lean


class UnsureError(Exception):
    """The scene has a place where rounding decides something that other cells hang on."""


@dataclass(frozen=True)
class Rules:
    """The settings of a bake that decide what cells hold."""

    cell_size: float
    bounds: tuple[float, float, float, float]
    height: float = 1.14
    radius: float = 0.05
    step: float = 0.25
    max_slope: float = 45.0
    min_area: float = 1.0
    shrink: float = 0.3


@dataclass
class Truth:
    """The truth about a scene.

    Attributes:
        rules: the settings.
        snapped: whether rims of boxes and upright cylinders lie under cells' centres exactly:
            such lines cross them.
        shape: (rows, cols) of the lattice.
        x, y: centres of the cells, by cell id [m].
        top: floor-like surfaces, shape (k, cells), NaN for none [m].
        standable: which of them one can stand on, whatever the size of their sheet.
        counted: which of those belong to a sheet that counts.
    """

    things: list[Thing]
    rules: Rules
    snapped: bool = False
    shape: tuple[int, int] = (0, 0)
    x: Float = field(default_factory=lambda: np.zeros(0))
    y: Float = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self._lay_cells()
        self._parts: list[Part] = [part_of(thing) for thing in self.things]
        min_normal_z = math.cos(math.radians(self.rules.max_slope))
        lined_up = [part_of(widen(thing, RIM)) for thing in self.things]
        lined_up = lined_up if self.snapped else self._parts
        x, y = self.x, self.y
        if self.snapped:  # a line in two faces belongs to what lies east or north of them
            x, y = (at + np.where(self._on_seam(k, at), BESIDE, 0.0) for k, at in ((0, x), (1, y)))
        self._columns, unsure = cross_all(lined_up, x, y, min_normal_z)
        if unsure.any() and not self.snapped:
            raise UnsureError("a line runs along a rim")
        z = np.concatenate([c.z for c in self._columns])
        up = np.concatenate([c.up for c in self._columns])
        self._all_z = z
        with np.errstate(invalid="ignore"):
            self.top = np.where(up >= min_normal_z - SURE, z, np.nan)
            self._rise = self.rules.cell_size * np.sqrt(np.clip(1 - up**2, 0, None)) / up
            self._steep = np.where((up > 0) & ~(up >= min_normal_z - SURE), z, np.nan)
        self._refuse_leaning_sides(up)
        self.standable = np.stack([self._is_standable(k) for k in range(len(self.top))])
        self.counted = self._count_sheets()

    def _refuse_leaning_sides(self, up: Float) -> None:
        """Be unsure where a line passes a side that is nearly upright, at most a step above a top.

        The bake takes such sides for upright ones of a building that leans, the truth for bumps.
        """
        for z, is_leaning in zip(self._steep, (up > 0) & (up <= LEANING + SURE), strict=True):
            with np.errstate(invalid="ignore"):
                below = np.where(self.top <= z, self.top, -np.inf).max(axis=0)
                if (is_leaning & (z - below <= self.rules.step + UNSURE)).any():
                    raise UnsureError("a side leans a little")

    def _lay_cells(self) -> None:
        x0, y0, x1, y1 = self.rules.bounds
        cell = self.rules.cell_size
        cols, rows = (max(1, math.ceil(extent / cell - 1e-6)) for extent in (x1 - x0, y1 - y0))
        x = (x0 + x1) / 2 + (np.arange(cols) + 0.5 - cols / 2) * cell
        y = (y0 + y1) / 2 - (np.arange(rows) + 0.5 - rows / 2) * cell
        self.shape = rows, cols
        self.x, self.y = np.tile(x, rows), np.repeat(y, cols)

    def _on_seam(self, axis: int, at: Float) -> Bool:
        """The lines that run in faces that look both ways along an axis."""
        other = (self.y, self.x)[axis]
        marks = np.zeros((2, len(at)), dtype=bool)
        for part in self._parts:
            faces: list[tuple[Float, Float]] = []  # a normal, and corners
            if isinstance(part, Surface):
                faces = [(np.cross(b - a, c - a), np.stack([a, b, c])) for a, b, c in part.corners]
            elif isinstance(part, Polytope):
                for normal, offset in zip(part.normals, part.offsets, strict=True):
                    on = np.abs(part.vertices @ normal - offset) < SURE
                    faces.append((normal, part.vertices[on]))
            for normal, corners in faces:
                if np.ptp(corners[:, axis]) > SURE or np.linalg.norm(normal) < 1e-12:
                    continue
                low, high = corners[:, 1 - axis].min(), corners[:, 1 - axis].max()
                hit = np.abs(at - corners[0, axis]) <= 2 * SURE
                hit &= (other >= low - 2 * SURE) & (other <= high + 2 * SURE)
                marks[int(normal[axis] > 0)] |= hit
        both: Bool = marks.all(axis=0)
        return both

    def _is_standable(self, k: int) -> Bool:
        """Faces up, lies inside no solid, and has headroom; the first of several at one height."""
        cells = np.flatnonzero(~np.isnan(self.top[k]))
        top = self.top[:, cells]
        z = top[k]
        valid = np.ones(len(z), dtype=bool)
        covered = np.zeros(len(z), dtype=bool)
        unsure = np.zeros(len(z), dtype=bool)
        with np.errstate(invalid="ignore"):
            for column in self._columns:
                for low, high in zip(column.low[:, cells], column.high[:, cells], strict=True):
                    begins = low - z
                    if not column.is_solid:
                        unsure |= (np.abs(begins) < 3 * ONE) & (high > z + SURE)
                    covered |= (begins <= ONE) & (high > z + ONE)
            all_z = self._all_z[:, cells]
            above = np.where(all_z > z + ONE, all_z, np.inf).min(axis=0, initial=np.inf)
            gap = above - z
            low_head = gap < self.rules.height - UNSURE
            unsure |= (gap < self.rules.height - SURE) & ~low_head
            for other in range(len(top)):
                apart = np.abs(top[other] - z)
                unsure |= (apart > SURE) & (apart < 2 * ONE)
                if other < k:
                    valid &= ~(apart <= SURE)
        standable = valid & ~covered & ~low_head
        if (unsure & standable).any():
            raise UnsureError("surfaces almost touch")
        answer = np.zeros(self.top.shape[1], dtype=bool)
        answer[cells] = standable
        return answer

    def _count_sheets(self) -> Bool:
        """Surfaces of sheets that are large enough, steps taken together."""
        number = np.full(self.standable.shape, -1)
        number[self.standable] = np.arange(self.standable.sum())
        rows, cols = self.shape
        grid = number.reshape(-1, rows, cols)
        height = self.top.reshape(-1, rows, cols)
        rises = self._rise.reshape(-1, rows, cols)
        pairs = []
        layers = [int(k) for k in np.flatnonzero(self.standable.any(axis=1))]
        for a in layers:
            for b in layers:
                for here, there in (
                    (np.s_[:, :-1], np.s_[:, 1:]),
                    (np.s_[:-1, :], np.s_[1:, :]),
                ):
                    both = (grid[a][here] >= 0) & (grid[b][there] >= 0)
                    if not both.any():
                        continue
                    step = np.abs(height[a][here] - height[b][there])
                    if (
                        both & (step > self.rules.step + SURE) & (step < self.rules.step + UNSURE)
                    ).any():
                        raise UnsureError("a step is just as high as can be taken")
                    joined = both & (step <= self.rules.step + SURE)
                    # which way a surface is steep isn't known here: see the tests of ramps
                    rise = np.fmax(rises[a][here], rises[b][there])
                    by_slopes = (rise > self.rules.step) & (step <= rise + self.rules.step + SURE)
                    if (both & ~joined & by_slopes).any():
                        raise UnsureError("slopes may join two floors")
                    pairs.append(np.stack([grid[a][here][joined], grid[b][there][joined]]))
        joined = np.concatenate(pairs, axis=1) if pairs else np.zeros((2, 0), dtype=int)
        num = int(self.standable.sum())
        graph = coo_array((np.ones(joined.shape[1]), joined), shape=(num, num))
        _, label = connected_components(graph, directed=False)
        self.sheet = np.full(self.standable.shape, -1)
        self.sheet[self.standable] = label
        counted = np.zeros_like(self.standable)
        for sheet in range(label.max(initial=-1) + 1):
            if self._is_large((self.sheet == sheet).any(axis=0)):
                counted |= self.sheet == sheet
        return counted

    def _is_large(self, cells: Bool) -> bool:
        """Whether enough is left of cells after shrinking.

        How far a centre is from the sheet's edge can be told from the squares beyond it, or, a
        little farther at corners, from their centres less half a cell: unsure where they differ.
        """
        cell, limit = self.rules.cell_size, self.rules.min_area
        if cells.sum() * cell**2 < limit - 1e-5:  # even before shrinking it is too small
            return False
        reach = math.ceil(self.rules.shrink / cell) + 1
        mask = np.pad(cells.reshape(self.shape), reach)
        away = np.abs(np.arange(-reach, reach + 1))
        away_of_square = np.maximum(away - 0.5, 0.0)
        too_near = (
            np.hypot(away_of_square[:, None], away_of_square) * cell < self.rules.shrink - SURE
        )
        by_square = mask & binary_erosion(mask, too_near)  # without shrinking, nothing is too near
        too_near = (np.hypot(away[:, None], away) - 0.5) * cell < self.rules.shrink - SURE
        by_center = binary_erosion(mask, too_near)
        least, most = by_square.sum() * cell**2, by_center.sum() * cell**2
        if (least >= limit) != (most >= limit) or min(abs(least - limit), abs(most - limit)) < 1e-5:
            raise UnsureError("a sheet is just large enough")
        return bool(least >= limit)

    def place(self, grounds: list[float], tolerance: float = SURE) -> list[Float]:
        """The counted surfaces on levels with these grounds: floors by cell id, NaN for none [m].

        A surface belongs to the highest ground at or below it. Where two of a column would be on
        one level, see `place_column`; unsure where it matters which of them are stairs.
        """
        levels = [np.full(len(self.x), np.nan) for _ in grounds]
        heights = np.where(self.counted, self.top, np.nan)
        below = UNSURE if tolerance > SURE else 0.0
        home = np.zeros(heights.shape, dtype=int)
        for k, ground in enumerate(grounds):
            home[ground <= heights + tolerance] = k
            under = (ground - tolerance) - heights
            if ((under > -below) & (under < UNSURE)).any():
                raise UnsureError("a surface just below a ground")
        num_layers = self.counted.sum(axis=0)
        for layer, counted in enumerate(self.counted):
            for k, level in enumerate(levels):
                alone = counted & (num_layers == 1) & (home[layer] == k)
                level[alone] = heights[layer, alone]
        for cell in np.flatnonzero(num_layers > 1):
            layers = np.flatnonzero(self.counted[:, cell])
            layers = layers[np.argsort(heights[layers, cell], kind="stable")]
            homes = tuple(home[layers, cell].tolist())
            places = place_in_all_ways(homes, len(grounds))
            if len(places) > 1:
                raise UnsureError("stairs would be placed otherwise")
            (place,) = places
            for layer, level in zip(layers, place, strict=True):
                z = heights[layer, cell]
                assert level >= 0, f"no level for the surface at {z} m of cell {cell}"
                levels[level][cell] = z
        return levels

    def grow(self, levels: list[Float], number: int) -> Float:
        """Let a level's floor go on under things, ring by ring.

        It takes surfaces that face up within the slope, and low bumps on those; none that one
        can stand on; and it keeps the agent's height from the levels above and below.

        Args:
            levels: the counted surfaces of all levels, see `place`.
            number: which of them.
        """
        floor = levels[number].copy()
        candidate = np.concatenate([self.top, self._low_bumps()])
        layers = np.flatnonzero(self.counted.any(axis=1))
        counted_z = np.where(self.counted[layers], self.top[layers], np.nan)
        with np.errstate(invalid="ignore"):
            for k in range(len(candidate)):
                candidate[k][(np.abs(counted_z - candidate[k]) <= ONE).any(axis=0)] = np.nan
            for other, surface in enumerate(levels):
                gap = (surface - candidate) * np.sign(other - number)
                if ((gap < self.rules.height - SURE) & (gap > self.rules.height - UNSURE)).any():
                    raise UnsureError("a floor goes on just low enough under a level")
                if other != number:
                    candidate[gap < self.rules.height - SURE] = np.nan
        while True:
            ring = self._next_ring(floor, candidate)
            if not ring:
                return floor
            for cell, z in ring.items():
                floor[cell] = z

    def _low_bumps(self) -> Float:
        """Surfaces that face up too steeply, at most a step above one that doesn't."""
        bumps = np.full_like(self._steep, np.nan)
        for k in np.flatnonzero(~np.isnan(self._steep).all(axis=1)):
            z = self._steep[k]
            with np.errstate(invalid="ignore"):
                below = np.where(self.top <= z, self.top, -np.inf).max(axis=0)
                rise = z - below - self.rules.step
                if (np.abs(rise) < UNSURE).any():
                    raise UnsureError("a bump is just a step high")
                bumps[k] = np.where(rise < 0, z, np.nan)
        return bumps

    def _next_ring(self, floor: Float, candidate: Float) -> dict[int, float]:
        rows, cols = self.shape
        ring = {}
        padded = np.pad(~np.isnan(floor.reshape(rows, cols)), 1)
        is_beside = padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
        is_open = np.isnan(floor) & is_beside.ravel()
        for cell in np.flatnonzero(is_open & ~np.isnan(candidate).all(axis=0)):
            row, col = divmod(int(cell), cols)
            beside = [
                floor[r * cols + c]
                for r, c in ((row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1))
                if 0 <= r < rows and 0 <= c < cols and not np.isnan(floor[r * cols + c])
            ]
            gaps = [
                (abs(z - other), z)
                for other in beside
                for z in candidate[:, cell]
                if not np.isnan(z)
            ]
            if any(SURE < gap - self.rules.step < UNSURE for gap, _ in gaps):
                raise UnsureError("a floor goes on just within a step")
            gaps = [(gap, z) for gap, z in gaps if gap <= self.rules.step + SURE]
            if not gaps:
                continue
            least = min(gap for gap, _ in gaps)
            z = min(z for gap, z in gaps if gap <= least + SURE)
            if any(gap < least + 4 * ONE and abs(other - z) > SURE for gap, other in gaps) and any(
                SURE < gap - least < 4 * ONE for gap, other in gaps if abs(other - z) > SURE
            ):
                raise UnsureError("two floors almost equally near")
            ring[int(cell)] = z
        return ring

    def occupied(self, cells: NDArray[np.intp], floors: Float) -> NDArray[np.int64]:
        """FREE, OCCUPIED or UNKNOWN for cells and floors."""
        state = np.full(len(cells), FREE)
        low, high = floors + self.rules.step, floors + self.rules.height
        x, y = self.x[cells], self.y[cells]
        footprints = [Prisms(x, y, low, high, self.rules.cell_size / 2, False)]
        if self.rules.radius > self.rules.cell_size / 2:
            footprints.append(Prisms(x, y, low, high, self.rules.radius, True))
        _, unsure = np.zeros(0), np.zeros(len(cells), dtype=bool)
        for part, column in zip(self._parts, self._columns, strict=True):
            here = type(column)(
                *(a[:, cells] for a in (column.z, column.up, column.low, column.high)),
                column.is_solid,
            )
            for prisms in footprints:
                near = np.flatnonzero((state != OCCUPIED) & self._is_near(part, prisms))
                if not len(near):
                    continue
                part_here = type(here)(
                    *(a[:, near] for a in (here.z, here.up, here.low, here.high)), here.is_solid
                )
                answer = part_meets_prisms(part, part_here, prisms.only(near))
                state[near[answer == OCCUPIED]] = OCCUPIED
                unsure[near[answer == UNKNOWN]] = True
        state[(state == FREE) & unsure] = UNKNOWN
        return state

    def _is_near(self, part: Part, prisms: Prisms) -> Bool:
        """Where the boxes round part and prism meet."""
        near = np.ones(len(prisms.x), dtype=bool)
        if isinstance(part, HalfSpace) or not hasattr(part, "support"):
            return near
        ways = np.concatenate([np.eye(3), -np.eye(3)])
        reach = part.support(ways)
        for way, limit in zip(ways, reach, strict=True):
            near &= prisms.support(np.tile(-way, (len(near), 1))) + limit > 0
        return near


@cache
def place_in_all_ways(homes: tuple[int, ...], num_levels: int) -> frozenset[tuple[int, ...]]:
    """What `place_column` makes of a column, whichever of its surfaces are stairs."""
    stairs = itertools.product((False, True), repeat=len(homes))
    return frozenset(tuple(place_column([*homes], each, num_levels)) for each in stairs)


def place_column(homes: list[int], is_stair: Sequence[bool], num_levels: int) -> list[int]:
    """The levels of a column's surfaces, -1 where all are taken, by trying all of them.

    In their order, no two on one level; left out, rather than moved, are stairs, and moved rather
    floors than none of them left out. Of equal ways the upper surface is left out, or higher.
    What is left out goes to the free level nearest to its home, the upper of two.
    """
    if len(set(homes)) == len(homes):
        return homes
    best: tuple[object, list[int]] | None = None
    for levels in itertools.product(range(-1, num_levels), repeat=len(homes)):
        placed = [level for level in levels if level >= 0]
        if placed != sorted(set(placed)):
            continue
        cost = [0, 0, 0, 0]  # floors left out, floors moved, stairs left out, stairs moved
        for level, home, stair in zip(levels, homes, is_stair, strict=True):
            cost[2 * stair + (level >= 0)] += 1 if level < 0 else abs(level - home)
        order = [-num_levels if level < 0 else -level for level in reversed(levels)]
        if best is None or (cost, order) < best[0]:  # type: ignore[operator]
            best = (cost, order), list(levels)
    assert best is not None
    found = best[1]
    for i, home in enumerate(homes):
        if found[i] < 0:
            free = sorted(set(range(num_levels)) - set(found), key=lambda k: (abs(k - home), -k))
            found[i] = free[0] if free else -1
    return found
