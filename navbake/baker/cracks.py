"""Cracks: gaps between floors at one height that are too narrow to be any."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.columns import (
    Columns,
    GatheredColumns,
    Rows,
    TiledShapes,
    cast_columns,
    cast_points,
    empty_crossings,
    split_rows,
)
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels import cracks as kernels
from navbake.baker.kernels.arrays import AgentLimits, Crossings, Tiles
from navbake.baker.kernels.constants import SLACK
from navbake.baker.kernels.cracks import (
    COUNT,
    MARK,
    WRITE,
    Asked,
    Found,
    GapRoom,
    find_gaps,
    probe_lines,
    splice_columns,
)
from navbake.baker.kernels.tiles import list_near
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int

# Ways in which a gap's width is measured, over half a turn: the widths of a gap that runs between
# two of them are 2 % too large at most
AXES = 8
# Lines a way at first: a crack beside one is found when the slab in between is wider than a
# quarter of the crack's width
SAMPLES = 4
# Halvings of the distance between such lines: to 1e-5 m for the default width
HALVINGS = 10
# How far one looks around a gap, in widths of a crack, and how many neighbouring ways may be
# without floor there: three leave an eighth of a turn open, as the inner corner of a wall does;
# a crack leaves less, as seen from its edge
AROUND, OPEN_WAYS = 1.5, 2

# Rounds of choosing among lines that a margin of rows is made for at first: mostly there is one
MARGIN_ROUNDS = 4

# How much farther than its lines go one looks for what is near a gap, for rounding [m]
HAIR = 1e-6
# How much of half a cell's edge a line may be moved: it stays inside of the cell's square
WITHIN = 0.999

# Unit vectors of the ways, opposite ones AXES apart
WAYS = np.stack([f(np.arange(2 * AXES) * (np.pi / AXES)) for f in (np.cos, np.sin)], axis=1)


class Gaps(NamedTuple):
    """Places where a cell has no floor between cells with floors at one height.

    Attributes:
        cell: cell ids, ascending, shape (n,), int64.
        low, high: heights of the floors on both sides, shape (n,), float64 [m].
    """

    cell: Int
    low: Float
    high: Float

    def only(self, kept: Bool) -> Gaps:
        """The gaps that are kept, shape (n,)."""
        return Gaps(self.cell[kept], self.low[kept], self.high[kept])


class Moved(NamedTuple):
    """Lines that were moved out of cracks.

    Attributes:
        cells: cell ids, ascending, shape (n,), int64.
        offset: of each line from its cell's centre, shape (n, 2), float64 [m].
    """

    cells: Int
    offset: Float

    def of_rows(self, rows: Rows, lattice: Lattice) -> Moved:
        """Those of some rows."""
        part = slice(*np.searchsorted(self.cells, rows.cells(lattice)).tolist())
        return Moved(self.cells[part], self.offset[part])


NONE_MOVED = Moved(np.empty(0, dtype=np.int64), np.empty((0, 2)))


def find_columns(tiled: TiledShapes, agent: AgentSettings, crack: float) -> tuple[Columns, Moved]:
    """Cast the columns of all cells, and close the cracks, band by band for the memory it takes.

    Returns:
        The columns, and which of their lines were moved.
    """
    lattice, gathered = tiled.lattice, GatheredColumns(tiled.lattice)
    bands, moved = split_rows(lattice), [NONE_MOVED]
    if len(bands) == 1:
        columns = cast_columns(tiled)
        if crack == 0:
            return columns, NONE_MOVED
        return _close_cracks(columns, tiled, agent, crack)[:2]
    for rows in bands:
        columns, lines = find_columns_of_rows(tiled, agent, crack, rows)
        gathered.add(columns, rows)
        moved.append(lines)
    cells, offsets = zip(*moved, strict=True)
    return gathered.join(), Moved(np.concatenate(cells), np.concatenate(offsets))


def find_columns_of_rows(
    tiled: TiledShapes, agent: AgentSettings, crack: float, rows: Rows
) -> tuple[Columns, Moved]:
    """The columns of some rows of cells, the same that `find_columns` finds there.

    Which line a cell in a crack gets depends on its neighbours, and on theirs. So more rows are
    cast than are asked for, and again more where choosing among lines took more rounds.

    Returns:
        The columns of these rows, and which of their lines were moved.
    """
    lattice, margin = tiled.lattice, 0
    if crack > 0:
        margin = MARGIN_ROUNDS * crack_cells(crack, lattice)
    while True:
        columns = cast_columns(tiled, rows.grown(margin, lattice))
        if crack == 0:
            return columns.only_rows(rows), NONE_MOVED
        closed, moved, rounds = _close_cracks(columns, tiled, agent, crack)
        needed = (rounds + 1) * crack_cells(crack, lattice)
        known = columns.known_rows
        if known == Rows(0, lattice.height) or needed <= margin:
            return closed.only_rows(rows), moved.of_rows(rows, lattice)
        margin = 2 * needed


def move_lines(columns: Columns, tiled: TiledShapes, moved: Moved) -> Columns:
    """Columns with some lines moved, all of cells that are known."""
    return _replace_lines(columns, tiled, *moved) if len(moved.cells) else columns


def find_columns_at(tiled: TiledShapes, moved: Moved, cells: Int) -> Columns:
    """The columns of some cells, as `find_columns` finds them; others mean nothing.

    Args:
        moved: all lines that were moved.
        cells: cell ids, ascending, none twice.
    """
    lattice, offset = tiled.lattice, np.zeros((len(cells), 2))
    _, at, which = np.intersect1d(cells, moved.cells, assume_unique=True, return_indices=True)
    offset[at] = moved.offset[which]
    found = _cast_beside(tiled, cells, offset)
    start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
    start[cells], start[cells + 1] = found.start[:-1], found.start[1:]
    return Columns(lattice, found._replace(start=start))


def close_cracks(
    columns: Columns, tiled: TiledShapes, agent: AgentSettings, crack: float
) -> Columns:
    """Move the lines that fall into a crack aside, onto the lower floor beside it.

    A crack is a gap between two floors at one height (within a step) that is narrower than
    `crack` [m] in some direction, measured through the cell's centre, with floor nearly all
    around: in an inner corner, gaps are narrow too. In place of the line that falls into it, the
    cell gets the one just beyond the crack's edge, all of it, so that solids are entered and left
    as often as they should be. An agent has room to stand on it there; where it has on neither
    side, the crack stays. The line stays inside of the cell's square, for which it speaks, unless
    the square is so small that all of it lies in the crack. Of storeys over each other whose cracks
    are not plumb, the line falls into as few as it can.

    Args:
        tiled: what the columns were cast at, listed for lines up to `crack_reach` away.
    """
    if crack == 0:
        return columns
    return _close_cracks(columns, tiled, agent, crack).columns


class _Closed(NamedTuple):
    """Columns whose cracks are closed, what was moved, and the rounds that it took to choose."""

    columns: Columns
    moved: Moved
    rounds: int


def _close_cracks(
    columns: Columns, tiled: TiledShapes, agent: AgentSettings, crack: float
) -> _Closed:
    """See `close_cracks`.

    Where columns of a band of rows are given, those of its outermost rows stay open: one row for
    each cell that a line may be moved past, and as many again for each round.
    """
    limits = agent_limits(agent)
    cells, candidates = measure_cracks(list_gaps(columns, limits, crack), tiled, limits, crack)
    if not len(cells):
        return _Closed(columns, NONE_MOVED, 0)
    return _replace_by_best(columns, tiled, cells, candidates, limits, crack)


def measure_cracks(
    gaps: Gaps, tiled: TiledShapes, limits: AgentLimits, crack: float
) -> tuple[Int, Float]:
    """The cells with a gap that is a crack, and the lines that each may get instead of its own.

    See `_list_candidates`; no cell where no gap is a crack.
    """
    nothing = np.empty(0, dtype=np.int64), np.empty((0, 0, 2))
    if not len(gaps.cell):
        return nothing
    # most gaps are open: half of the ways tell most of these, and to measure is dearest
    for spacing in (2, 1):
        probe = _make_probe(gaps, tiled, limits, crack_reach(crack))
        gaps = gaps.only(~_find_open(probe, crack, spacing))
        if not len(gaps.cell):
            return nothing
    offset = _measure(_make_probe(gaps, tiled, limits, crack), crack)
    closed = ~np.isnan(offset[:, 0, 0])
    if not closed.any():
        return nothing
    return _list_candidates(gaps.cell[closed], offset[closed])


def _list_candidates(cell: Int, offset: Float) -> tuple[Int, Float]:
    """The lines that each cell with cracks may get, the best first, NaN where there are fewer.

    Before the second choices for its cracks come the first ones, those for lower cracks first.

    Args:
        cell: of each crack, ascending, shape (n,).
        offset: the two choices for each, shape (n, 2, 2) [m].

    Returns:
        The cells, and offsets from their centres, shape (cells, choices, 2) [m].
    """
    cells, first, row, count = np.unique(cell, True, True, True)
    rank = np.arange(len(cell)) - first[row]
    candidates = np.full((len(cells), 2 * count.max(), 2), np.nan)
    candidates[row, rank] = offset[:, 0]
    candidates[row, count.max() + rank] = offset[:, 1]
    return cells, candidates


def _replace_by_best(
    columns: Columns,
    tiled: TiledShapes,
    cells: Int,
    candidates: Float,
    limits: AgentLimits,
    crack: float,
) -> _Closed:
    """The columns with the line in each cell that leaves the fewest gaps, the first of several."""
    near = only_near(columns, cells, crack_cells(crack, columns.lattice))
    best, rounds = candidates[:, 0].copy(), 0
    fewest = np.full(len(cells), np.iinfo(np.int64).max)
    for offset in candidates.swapaxes(0, 1):
        asked = (fewest > 0) & ~np.isnan(offset[:, 0])
        if not asked.any():
            continue
        trial = np.where(asked[:, None], offset, best)
        left = count_gaps(_replace_lines(near, tiled, cells, trial), cells, limits, crack)
        better, rounds = asked & (left < fewest), rounds + 1
        best[better], fewest[better] = offset[better], left[better]
    return _Closed(_replace_lines(columns, tiled, cells, best), Moved(cells, best), rounds)


def only_near(columns: Columns, cells: Int, reach: int) -> Columns:
    """The columns of the cells within a reach of some cells, in cells along both axes.

    Of those that are known; all others are empty, so that a trial copies few.
    """
    lattice, known = columns.lattice, columns.known_rows
    first, end = known.cells(lattice)
    # row by row, then column by column: a window for each cell would take memory
    is_near = np.zeros((known.end - known.first, lattice.width), dtype=np.bool_)
    row, col = np.divmod(cells - first, lattice.width)
    for k in range(-reach, reach + 1):
        is_near[np.clip(row + k, 0, len(is_near) - 1), col] = True
    row, col = np.nonzero(is_near)
    for k in range(-reach, reach + 1):
        is_near[row, np.clip(col + k, 0, lattice.width - 1)] = True
    near = first + np.flatnonzero(is_near)
    counts = columns.start[near + 1] - columns.start[near]
    # `zeros_like` would write them all, for each block again
    start = np.zeros(len(columns.start), dtype=np.int64)
    start[near + 1] = counts
    np.cumsum(start[first : end + 1], out=start[first : end + 1])
    total = int(start[end])
    taken = np.repeat(columns.start[near] - start[near], counts) + np.arange(total)
    _, z, normal, geom, closed = columns.crossings
    crossings = Crossings(start, z[taken], normal[taken], geom[taken], closed[taken])
    return Columns(lattice, crossings, columns.rows)


def crack_reach(crack: float) -> float:
    """How far from a cell's centre one looks for cracks of a width [m]."""
    return AROUND * crack


def crack_cells(crack: float, lattice: Lattice) -> int:
    """How far the nearest line beyond a crack may be [cells]."""
    return int(crack / lattice.cell_size) + 1


def count_gaps(columns: Columns, cells: Int, limits: AgentLimits, crack: float) -> Int:
    """How many gaps `list_gaps` would find in some cells."""
    counts, none = np.empty(len(cells), dtype=np.int64), np.empty(0)
    stands = np.empty(len(columns.z), dtype=np.bool_)
    room = GapRoom(stands, none, columns.start, none, none)
    reach = crack_cells(crack, columns.lattice)
    kernels.count_gaps(columns.lattice, columns.crossings, limits, reach, room, cells, counts)
    return counts


def list_gaps(columns: Columns, limits: AgentLimits, crack: float) -> Gaps:
    """List the gaps of the cells whose neighbours are known."""
    lattice, reach, known = columns.lattice, crack_cells(crack, columns.lattice), columns.known_rows
    # beyond the lattice is no floor, beyond the rows that are known there may be one
    first = known.first + reach if known.first > 0 else 0
    end = known.end - reach if known.end < lattice.height else lattice.height
    first_cell, end_cell = Rows(first, max(end, first)).cells(lattice)
    # arrays of all cells, of which only the pages of these rows are ever touched
    start = np.zeros(len(columns.start), dtype=np.int64)
    stands, none = np.empty(len(columns.z), dtype=np.bool_), np.empty(0)
    room = GapRoom(stands, np.empty(len(start) - 1), start, none, none)
    asked = lattice, columns.crossings, limits, reach
    run_in_bands(find_gaps, known.end - known.first, *asked, room, MARK, begin=known.first)
    run_in_bands(find_gaps, max(end - first, 0), *asked, room, COUNT, begin=first)
    counted = start[first_cell : end_cell + 1]
    cells = np.flatnonzero(counted[1:])
    counts = counted[1:][cells]
    np.cumsum(counted, out=counted)
    room = room._replace(low=np.empty(counted[-1]), high=np.empty(counted[-1]))
    if counted[-1]:
        run_in_bands(find_gaps, end - first, *asked, room, WRITE, begin=first)
    return Gaps(np.repeat(first_cell + cells, counts), room.low, room.high)


def _find_open(probe: _Probe, crack: float, spacing: int) -> Bool:
    """Which gaps are open to one side: neighbouring ones of each so many ways lead to no floor."""
    run, is_open = OPEN_WAYS // spacing + 1, np.empty(len(probe.gaps.cell), dtype=np.bool_)
    offsets = WAYS[::spacing] * crack_reach(crack)
    work = kernels.find_open, len(is_open), probe.gaps, probe.geometry, probe.limits, offsets
    run_in_bands(*work, run, is_open)
    return is_open


def _measure(probe: _Probe, crack: float) -> Float:
    """Where beside a cell's centre lines lie that are not in the crack, NaN for no crack.

    The better one first, shape (n, 2, 2) [m]; the other is NaN where it is no choice. Along each of
    some axes, both ways, one looks for the first line that meets a floor, first from sample to
    sample, then by bisection.
    """
    gaps = probe.gaps
    gap, way = np.divmod(np.arange(len(gaps.cell) * 2 * AXES), 2 * AXES)
    near, far = np.zeros(len(gap)), np.full(len(gap), np.inf)
    for distance in crack * np.arange(1, SAMPLES + 1) / SAMPLES:
        asked = np.flatnonzero(np.isinf(far))
        floors, _ = probe.floors(gap[asked], way[asked], np.full(len(asked), distance))
        hits = ~np.isnan(floors)
        far[asked[hits]] = distance
        near[asked[~hits]] = distance
    # an axis is two opposite ways: only where the two may add up to a crack, they matter
    opposite = gap * 2 * AXES + (way + AXES) % (2 * AXES)
    asked = np.flatnonzero(np.isfinite(far) & np.isfinite(far[opposite]))
    asked = asked[near[asked] + near[opposite[asked]] < crack]
    for _ in range(HALVINGS):
        middle = (near[asked] + far[asked]) / 2
        hits = ~np.isnan(probe.floors(gap[asked], way[asked], middle)[0])
        far[asked[hits]], near[asked[~hits]] = middle[hits], middle[~hits]
    width = np.full(len(gap), np.inf)
    width[asked] = far[asked] + far[opposite[asked]]
    narrowest = width.reshape(-1, 2 * AXES).argmin(axis=1)  # one of the first half of the turn
    one = np.arange(len(gaps.cell)) * 2 * AXES + narrowest
    one = one[width[one] < crack]
    sides = np.stack([one, opposite[one]])
    offset = np.full((len(gaps.cell), 2, 2), np.nan)
    if len(one):
        offset[gap[one]] = _order_sides(probe, gap[sides], way[sides], far[sides])
    return offset


def _order_sides(probe: _Probe, gap: Int, way: Int, far: Float) -> Float:
    """Of the two sides of each crack, arrays of shape (2, n), the lines that the cell may get [m].

    First the one on the lower floor with room for an agent; of two at one height, the nearer. NaN
    where there is no room, the floors are more than a step apart, or the line lies outside of the
    cell's square and the other one inside. Shape (n, 2, 2).
    """
    found = [probe.floors(*side) for side in zip(gap, way, far, strict=True)]
    floor, standable = (np.stack(heights) for heights in zip(*found, strict=True))
    offset = WAYS[way] * far[:, :, None]
    half = WITHIN * probe.tiled.lattice.cell_size / 2
    is_outside = abs(offset).max(axis=2) > half
    order = np.lexsort((far, standable, is_outside, np.isnan(standable)), axis=0)
    level = abs(floor[0] - floor[1]) <= probe.limits.step + SLACK
    chosen = level & ~np.isnan(standable)
    is_inside = chosen & ~is_outside
    chosen &= is_inside | ~is_inside.any(axis=0)
    offset[~chosen] = np.nan
    ordered: Float = np.take_along_axis(offset, order[:, :, None], axis=0).swapaxes(0, 1)
    return ordered


class _Probe(NamedTuple):
    """Looks for floors on lines beside the centres of the cells with gaps."""

    gaps: Gaps
    tiled: TiledShapes
    near: Tiles  # what lies near each gap's cell
    limits: AgentLimits

    @property
    def geometry(self) -> tuple[Any, ...]:
        """What the kernels look at."""
        tiled, shapes = self.tiled, self.tiled.shapes
        solids, planes = shapes.solids, shapes.planes
        return tiled.lattice, solids, tiled.facets, planes, self.near, tiled.heights

    def floors(self, gap: Int, way: Int, distance: Float) -> tuple[Float, Float]:
        """The floor that continues a gap's sides, some way from the centre, NaN for none [m].

        And the lowest such floor with room for an agent.
        """
        found = Found(np.empty(len(gap)), np.empty(len(gap)))
        asked = Asked(gap, WAYS[way] * distance[:, None])
        known = self.gaps, self.geometry, self.limits
        run_in_bands(probe_lines, len(gap), *known, asked, found, least=16)
        return found.floor, found.standable


def _make_probe(gaps: Gaps, tiled: TiledShapes, limits: AgentLimits, reach: float) -> _Probe:
    """List once what lies near each gap, as far as lines go: it is less than a tile has."""
    tiles, cells, reach = tiled.tiles, gaps.cell, reach + HAIR
    solids = tiled.shapes.solids.bounds, tiles.solid_start, tiles.solid_item
    triangles = tiled.facets.bounds, tiles.triangle_start, tiles.triangle_item
    near = (list_near(tiled.lattice, *items, cells, reach) for items in (solids, triangles))
    return _Probe(gaps, tiled, Tiles(*itertools.chain(*near)), limits)


def _cast_beside(tiled: TiledShapes, cells: Int, offset: Float) -> Crossings:
    """The crossings of lines at offsets, shape (n, 2) [m], from cells' centres; one a column."""
    centers = tiled.lattice.positions(*np.divmod(cells, tiled.lattice.width))
    return cast_points(tiled, cells, centers + offset)


def _replace_lines(columns: Columns, tiled: TiledShapes, cells: Int, offset: Float) -> Columns:
    """The columns with other lines, at offsets from the centres, in some cells (ascending)."""
    old, new = columns.crossings, _cast_beside(tiled, cells, offset)
    first, end = columns.known_rows.cells(columns.lattice)
    counts = np.diff(old.start[first : end + 1])
    counts[cells - first] = np.diff(new.start)
    start = np.zeros(len(old.start), dtype=np.int64)
    np.cumsum(counts, out=start[first + 1 : end + 1])
    replaced = empty_crossings(start, int(start[end]))
    run_in_bands(splice_columns, end - first, old, new, cells, replaced, begin=first)
    return replace(columns, crossings=replaced)
