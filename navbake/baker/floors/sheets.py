"""Sheets: the standable surfaces that steps join, and which of them are floors."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns
from navbake.baker.connect import connect
from navbake.baker.floors.kernels.sheets import (
    Surfaces,
    group_members,
    join_by_slopes,
    join_by_steps,
    list_surfaces,
    mark_surfaces,
)
from navbake.baker.floors.kernels.shrink import east_rim, mark_inner, near_offsets
from navbake.baker.gathered import Gathered
from navbake.baker.kernels.arrays import AgentLimits
from navbake.baker.kernels.constants import SLACK
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_beside, run_in_bands
from navbake.types import Bool, Float, Int, Int32


class Standable(NamedTuple):
    """Standable surfaces, ragged by cell as in `Columns`.

    Attributes:
        lattice: the cells.
        start: shape (cells + 1,), int64.
        z: heights, ascending in a cell, shape (n,), float64 [m].
        cell: cell id of each, shape (n,), int32.
        surface: each one's index in the `Footing`, shape (n,), int32.
        geom: MuJoCo's geom id of each, shape (n,), int32.
        is_top: whether nothing lies above it in its column, shape (n,), bool.
        sheet: the sheet that it belongs to, shape (n,), int32.
        sheet_size: how many surfaces each sheet has, shape (sheets,), int64; a sheet that was
            dropped has none.
        slopes: pairs of surfaces in neighbouring cells that no step joins but their slopes, see
            `find_slopes`, shape (m, 2), int64.
    """

    lattice: Lattice
    start: Int
    z: Float
    cell: Int32
    surface: Int32
    geom: Int32
    is_top: Bool
    sheet: Int32
    sheet_size: Int
    slopes: Int

    def members(self, sheets: Int | Int32) -> Iterator[tuple[int, Int]]:
        """Of some sheets, each one's number and the indices of its surfaces."""
        if not len(sheets):
            return
        start, member = group_members(self.sheet, self.sheet_size)
        for sheet in sheets:
            yield sheet, member[start[sheet] : start[sheet + 1]]

    def only_sheets(self, counts: Bool) -> Standable:
        """The surfaces of the sheets that count, shape (sheets,); they keep their numbers."""
        return self.only(counts[self.sheet])

    def only(self, kept: Bool) -> Standable:
        """The surfaces that are kept, shape (n,)."""
        if kept.all():
            return self
        renumbered, chosen = run_beside(self._renumber, kept), np.flatnonzero(kept)
        sheet = self.sheet[chosen]
        size = np.bincount(sheet, minlength=len(self.sheet_size))
        arrays = self.z[chosen], self.cell[chosen], self.surface[chosen]
        told = self.geom[chosen], self.is_top[chosen]
        start, slopes = renumbered()
        return Standable(self.lattice, start, *arrays, *told, sheet, size, slopes)

    def _renumber(self, kept: Bool) -> tuple[Int, Int]:
        """`start` and `slopes` of the surfaces that are kept, see `only`."""
        number = np.zeros(len(kept) + 1, dtype=np.int64)
        np.cumsum(kept, out=number[1:])  # of those before each
        return number[self.start], number[self.slopes[kept[self.slopes].all(axis=1)]]

    def sheets_at(self, cells: Int, heights: Float) -> Int32:
        """The sheets of the surfaces in some cells at heights at which there is one, shape (n,)."""
        surface = self.start[cells]
        for _ in range(int(np.diff(self.start).max(initial=0)) - 1):
            surface += self.z[surface] < heights
        sheet: Int32 = self.sheet[surface]
        return sheet


def agent_limits(agent: AgentSettings) -> AgentLimits:
    """What an agent can stand and walk on, as kernels take it."""
    min_up = float(np.cos(np.radians(agent.max_slope))) - SLACK
    return AgentLimits(min_up, agent.height, agent.traversable_floor_height)


class Footing(NamedTuple):
    """The surfaces that a floor may go on at: facing up within the slope, or low bumps.

    Ragged by cell as in `Columns`.

    Attributes:
        start: shape (cells + 1,), int64.
        z: heights, ascending in a cell, shape (n,), float64 [m].
    """

    start: Int
    z: Float


class StandableFinder:
    """Finds the standable surfaces, block by block.

    Args:
        lattice: the cells.
        shapes: the geometry that the columns were cast at.
        agent: who stands there.

    Attributes:
        num_surfaces: how many surfaces were looked at.
    """

    def __init__(self, lattice: Lattice, shapes: Shapes, agent: AgentSettings) -> None:
        self._lattice, self._planes, self._agent = lattice, shapes.planes, agent
        num_cells = lattice.width * lattice.height
        # by cell, how many there are; then where they begin
        self._start, self._footing_start = (
            np.zeros(num_cells + 1, dtype=np.int64) for _ in range(2)
        )
        heights, ids, marks = np.empty(0), np.empty(0, np.int32), np.empty(0, np.bool_)
        self._surfaces = Gathered(heights, ids, ids, ids, marks)
        self._normals = Gathered(np.empty((0, 3), dtype=np.float32))
        self._footing = Gathered(heights)
        self.num_surfaces = 0

    def add(self, columns: Columns) -> None:
        """Look at the columns of a block; blocks come in the order of their rows."""
        known, count = columns.known_rows.cells(self._lattice), len(columns.z)
        self.num_surfaces += count
        floor_like, is_standable = (np.empty(count, dtype=np.bool_) for _ in range(2))
        asked = self._lattice, columns.crossings, self._planes, agent_limits(self._agent)
        work = known[1] - known[0], *asked, floor_like, is_standable, self._start[1:]
        run_in_bands(mark_surfaces, *work, begin=known[0])
        cells = slice(known[0] + 1, known[1] + 1)
        start, footing_start = (np.zeros(known[1] - known[0] + 1, np.int64) for _ in range(2))
        np.cumsum(self._start[cells], out=start[1:])
        crossings = columns.crossings._replace(start=columns.start[known[0] : known[1] + 1])
        marks, places = (floor_like, is_standable), (start, footing_start)
        listed = crossings, marks, places, (known[0], len(self._footing))
        run_in_bands(list_surfaces, len(start) - 1, *listed, _make_surfaces(0, 0), False)
        self._footing_start[cells] = footing_start[1:]
        np.cumsum(footing_start, out=footing_start)
        found = _make_surfaces(int(start[-1]), int(footing_start[-1]))
        run_in_bands(list_surfaces, len(start) - 1, *listed, found, True)
        share = known[1] / (len(self._start) - 1)
        parts = found.z, found.cell, found.surface, found.geom, found.is_top
        self._surfaces.add(*parts, share=share)
        if _slopes_may_join(self._lattice, self._agent):
            self._normals.add(columns.normal[is_standable], share=share)
        self._footing.add(found.footing, share=share)

    def found(self) -> tuple[Standable, Footing]:
        """The standable surfaces and their sheets, and all that a floor may go on at."""
        start, lattice, step = self._start, self._lattice, self._agent.traversable_floor_height
        for counts in (start, self._footing_start):
            np.cumsum(counts, out=counts)
        (footing,), (normal,) = self._footing.take(), self._normals.take()
        z, cell, surface, geom, is_top = self._surfaces.take()
        sheet, size = join_by_steps(lattice, start, z, np.zeros(len(z), dtype=np.int32), step)
        slopes = find_slopes(lattice, start, z, normal, self._agent)
        if len(slopes):
            sheet, size = _unite(sheet, sheet[slopes], len(size))
        parts = z, cell, surface, geom, is_top, sheet, size, slopes
        return Standable(lattice, start, *parts), Footing(self._footing_start, footing)


def _make_surfaces(count: int, footings: int) -> Surfaces:
    z, footing = np.empty(count), np.empty(footings)
    cell, surface, geom = (np.empty(count, dtype=np.int32) for _ in range(3))
    return Surfaces(z, cell, surface, geom, np.empty(count, dtype=np.bool_), footing)


def _slopes_may_join(lattice: Lattice, agent: AgentSettings) -> bool:
    """Whether a slope that is standable may rise more than a step over a cell."""
    rise = lattice.cell_size * np.tan(np.radians(agent.max_slope))
    return bool(rise > agent.traversable_floor_height)


def find_slopes(
    lattice: Lattice, start: Int, z: Float, normal: NDArray[np.float32], agent: AgentSettings
) -> Int:
    """Find the pairs of surfaces that slopes join where a ramp rises more than a step over a cell.

    Two surfaces of neighbouring cells, more than a step apart, are one walk when the steeper one's
    own slope rises more than a step over a cell, and their heights differ by what the two slopes
    predict: by anything between the two predictions (as where a ramp meets a floor somewhere
    between the cells' centres), or by at most a step less or more than both.

    Args:
        start, z, normal: the standable surfaces, ragged by cell as in `Columns`.

    Returns:
        Pairs of surfaces, shape (m, 2), int64; none where no slope that is standable rises that
        much.
    """
    if not _slopes_may_join(lattice, agent):
        return np.empty((0, 2), dtype=np.int64)
    pairs: Int = join_by_slopes(lattice, start, z, normal, agent.traversable_floor_height)
    return pairs


def _unite(part: Int32, pairs: Int32, count: int) -> tuple[Int32, Int]:
    """Unite parts by pairs of their numbers: the part of each member then, and the parts' sizes."""
    # by their first members, as `join_by_steps` numbers them
    united: Int32 = connect(pairs.T.astype(np.int64), count).astype(np.int32)[part]
    return united, np.bincount(united)


def drop_furniture(standable: Standable, settings: FloorSettings) -> Standable:
    """Keep the sheets that count: those large enough after shrinking.

    A sheet's cells are taken together over all heights; a cell survives shrinking when its
    centre is at least `shrink` from the sheet's edge.
    """
    size, test = standable.sheet_size, AreaTest(standable.lattice, settings)
    counts = np.zeros(len(size), dtype=np.bool_)
    for sheet, members in standable.members(np.flatnonzero(size >= test.needed)):
        counts[sheet] = test.passes(standable.cell[members])
    return standable.only_sheets(counts)


def middle_of(lattice: Lattice, cells: Int | Int32, z: Float) -> tuple[float, float, float]:
    """A place on a floor, of its cells the one nearest to its middle: world x, y, z [m].

    Args:
        cells, z: the floor's cells, and its height in each, shape (n,) [m].
    """
    row, col = np.divmod(cells, lattice.width)
    nearest = np.hypot(row - row.mean(), col - col.mean()).argmin()
    x, y = lattice.center_x()[col[nearest]], lattice.center_y()[row[nearest]]
    return float(x), float(y), float(z[nearest])


def mask_window(cells: Int | Int32, lattice: Lattice, margin: int) -> tuple[Bool, Int, Int]:
    """Cells as a mask over their own rectangle, with a margin; and its first row and column."""
    row, col = np.divmod(cells, lattice.width)
    row0, col0 = row.min() - margin, col.min() - margin
    mask = np.zeros((row.max() - row0 + 1 + margin, col.max() - col0 + 1 + margin), dtype=np.bool_)
    mask[row - row0, col - col0] = True
    return mask, row0, col0


@lru_cache(maxsize=4)  # several tests of a scene ask for the same, and so do scenes of a batch
def _list_near(limit: float, shorter: int) -> tuple[Int, Int]:
    """See `near_offsets` and `east_rim`; nobody changes them."""
    disc = near_offsets(limit, shorter)
    return disc, east_rim(disc)


class AreaTest:
    """Whether cells are enough for a floor: `min_area` after shrinking.

    Shrinking leaves the cells whose centres are at least `shrink` from the edge of the set.

    Attributes:
        needed: cells that have to be left after shrinking; smaller sets need no test.
    """

    def __init__(self, lattice: Lattice, settings: FloorSettings) -> None:
        self.needed = (settings.min_area - SLACK) / lattice.cell_size**2
        self._shape = lattice.width, lattice.height
        limit = (settings.shrink - SLACK) / lattice.cell_size + 0.5
        self._disc, self._rim = _list_near(limit, min(self._shape))
        self._mask = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
        self._counted = self._mask.copy()

    def passes(self, cells: Int | Int32) -> bool:
        """Whether a set of cells is large enough; ids may repeat, shape (n,)."""
        needed = int(np.ceil(max(self.needed, 0.0)))
        return self._mark(cells, needed)[0] >= needed

    def inner(self, cells: Int | Int32) -> Bool:
        """Which cells of a set are left after shrinking, shape (n,)."""
        return self._mark(cells, len(cells) + 1)[1]

    def _mark(self, cells: Int | Int32, needed: int) -> tuple[int, Bool]:
        inner = np.zeros(len(cells), dtype=np.bool_)
        masks = self._mask, self._counted
        cells = cells.astype(np.int32, copy=False)
        found = mark_inner(cells, self._disc, self._rim, *self._shape, needed, *masks, inner)
        return int(found), inner
