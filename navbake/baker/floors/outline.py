"""How sheets end: at walls, at drops, at the lattice's border, or otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.blocks import BlockAnswers, list_rows
from navbake.baker.columns import ColumnSource
from navbake.baker.floors.kernels.members import (
    ITSELF,
    Edges,
    Labelled,
    list_edges,
    look_below,
    mark_holes,
)
from navbake.baker.floors.sheets import SheetFacts, Sheets
from navbake.baker.floors.surfaces import find_near
from navbake.baker.kernels.arrays import Band
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

# How an edge of a sheet ends, see `Site.endings`
WALL, BARRIER, DROP, BORDER, OPEN = range(5)
# The thickness of the bands at an agent's feet and head that both meet a wall [m]
PROBE = 0.01
# An empty array of rows of `list_edges`
NO_EDGES = np.empty((0, 5), dtype=np.int64)

OccupancyTest = Callable[[Int, Float, Band | None], Bool]
"""Whether a geom meets a band of heights above the floor, over each cell's square.

Called with cell ids, the floor's height in each [m], and the band [m]; None is the one between a
step and the agent's height.
"""


class Endings(NamedTuple):
    """How a sheet ends at each of its edges, see `Site.endings`.

    Attributes:
        kind: WALL, BARRIER, DROP, BORDER or OPEN, shape (edges,), uint8.
        landing: the height of the floor that a drop leads to, NaN for the others [m].
        floor: the sheet of that floor, -1 for the others, int32.
        is_known: False at borders where the lattice crops the scene; at the others nothing stands
            beside the sheet, nor is a floor.
    """

    kind: NDArray[np.uint8]
    landing: Float
    floor: Int32
    is_known: Bool


class Site(NamedTuple):
    """The input of the rules for tops, roofs and shelves.

    Attributes:
        sheets: all sheets, furniture included.
        is_large: which of them are large enough for floors, shape (sheets,), bool.
        columns: all surfaces.
        cropped: see `find_cropped`.
        edges: the block of each edge of large sheets, and its row, see `list_edges`.
        reach: how many cells beyond a sheet's edge floors are looked for.
        last: the last update in which something changed near each block.
        near, at_edges: the same near each sheet's surfaces, and near its edges, shape (sheets,).
        facts: the cache of facts about sheets.
        walls: the cache of endings for the rule of roofs.
    """

    sheets: Sheets
    is_large: Bool
    columns: ColumnSource
    agent: AgentSettings
    settings: FloorSettings
    is_occupied: OccupancyTest
    cropped: Bool
    edges: tuple[Int, Int]
    reach: int
    last: Int
    near: Int
    at_edges: Int
    facts: SheetFacts
    walls: BlockAnswers

    def edges_of(self, chosen: Bool, reach: int, among: Bool | None = None) -> Edges:
        """Find the edges of chosen sheets, and the floors below them.

        Args:
            reach: how many cells to look out for floors below.
            among: the sheets that count, the large ones if None.
        """
        sheets, step = self.sheets, self.agent.traversable_floor_height
        labelled = sheets.labelled(self.is_large if among is None else among)
        block, rows = self.edges
        if among is not None:
            blocks = np.flatnonzero(sheets.blocks_of(chosen))
            asked = labelled, np.inf, step, reach  # no edge looks for a drop, which isn't needed
            counts, (rows,) = list_rows(list_edges, blocks, (NO_EDGES,), *asked)
            block = np.repeat(blocks, counts)
        sheet = sheets.sheet_at(block, rows[:, 0])
        kept = chosen[sheet]
        _, cell, place, way, _ = rows[kept].T
        shape = len(cell), reach
        beyond = np.full(shape, -1), np.full(shape, np.nan), np.full(shape, -1, dtype=np.int32)
        edges = Edges(sheet[kept], cell.copy(), sheets.surfaces.z[place], way.copy(), *beyond)
        looking = np.arange(len(cell))
        for k in range(reach):
            cells = beside(sheets.lattice, edges.cell[looking], edges.way[looking], k + 1)
            looking, cells = looking[cells >= 0], cells[cells >= 0]
            limits = edges.z[looking] - step - SLACK
            places, below = find_below(labelled, cells, limits, edges.sheet[looking])
            goes_out = places != ITSELF
            looking, places = looking[goes_out], places[goes_out]
            edges.cells[looking, k], edges.landing[looking, k] = cells[goes_out], below[goes_out]
            lies = places >= 0
            edges.floors[looking[lies], k] = labelled.z[places[lies]]
        return edges

    def barriers(self, edges: Edges, agent: AgentSettings) -> NDArray[np.uint8]:
        """`kind` of `endings`, but OPEN in place of DROP; for the agent or another one."""
        outer = beside(self.sheets.lattice, edges.cell, edges.way)
        kind, asked = np.full(len(outer), OPEN, dtype=np.uint8), np.arange(len(outer))
        kind[outer < 0] = BORDER
        for band, means in zip(probe_bands(agent), (BARRIER, WALL), strict=True):
            stands = self.is_occupied(edges.cell[asked], edges.z[asked], band)
            beyond = np.flatnonzero(~stands & (outer[asked] >= 0))
            cells, z = outer[asked[beyond]], edges.z[asked[beyond]]
            stands[beyond] = self.is_occupied(cells, z, band)
            asked = asked[stands]
            kind[asked] = means
        return kind

    def endings(self, edges: Edges) -> Endings:
        """Classify how a sheet ends at each of its edges.

        - WALL: something stands in the cell on this side of the edge, or in the one beyond, at an
          agent's feet (just above a step) and at its head (just below its height).
        - BARRIER: something stands at an agent's feet only: a parapet, a headboard, a sill.
        - DROP: an agent that steps out gets to a floor more than a step lower, where it can stand;
          in any of `edges.cells` up to a barrier, past a bed's frame. There is no drop where a
          surface continues from the sheet over that floor, as in an attic.
        - BORDER: the lattice ends.
        - OPEN: an abyss, a steep slope, a floor on which nobody can stand.
        """
        agent, z, is_occupied = self.agent, edges.z, self.is_occupied
        # of all these cells at once
        known = self.columns.at(np.concatenate([edges.cell, edges.cells[edges.cells >= 0]]))
        kind, landing = self.barriers(edges, agent), np.full(len(z), np.nan)
        floor = np.full(len(z), -1, dtype=np.int32)
        looking, ground = np.flatnonzero(kind == OPEN), z.copy()
        for k in range(edges.cells.shape[1]):
            looking = looking[edges.cells[looking, k] >= 0]
            if k > 0:  # the nearest cell has been asked
                stops = is_occupied(edges.cells[looking, k], z[looking], probe_bands(agent)[0])
                kind[looking[stops]] = BARRIER
                looking = looking[~stops]
            cells = edges.cells[looking, k]
            column = known.start[cells], known.start[cells + 1], known.z
            ground[looking] = find_near(*column, ground[looking], agent.traversable_floor_height)
            below = looking[~np.isnan(edges.floors[looking, k])]
            cells, floors = edges.cells[below, k], edges.floors[below, k]
            goes_on = ground[below] > floors + agent.height + SLACK
            lands = below[~goes_on & ~is_occupied(cells, floors, None)]
            kind[lands], landing[lands] = DROP, edges.floors[lands, k]
            floor[lands] = edges.landing[lands, k]
            looking = looking[kind[looking] == OPEN]
        return Endings(kind, landing, floor, self.is_known(kind, edges.way))

    def is_known(self, kind: NDArray[np.uint8], way: Int) -> Bool:
        """Which edges do not end where the lattice crops the scene, by their endings and ways."""
        known: Bool = (kind != BORDER) | ~self.cropped[way]
        return known

    def share(self, edges: Edges, which: Bool, known: Bool) -> Float:
        """The share of each sheet's known edges that are of some kind, NaN where none is known."""
        of_kind, whole = (
            np.bincount(edges.sheet, mask, len(self.is_large)) for mask in (which & known, known)
        )
        share = np.full(len(whole), np.nan)
        np.divide(of_kind, whole, out=share, where=whole > 0)
        return share


def find_below(
    labelled: Labelled, cells: Int, limits: Float, sheets: Int32 | None = None
) -> tuple[Int, Int32]:
    """The highest surfaces of other sheets, or of any, below limits, see `look_below`."""
    if sheets is None:
        sheets = np.full(len(cells), -2, dtype=np.int32)
    places, below = np.empty(len(cells), dtype=np.int64), np.empty(len(cells), dtype=np.int32)
    asked = labelled, cells, sheets, limits, places, below
    run_in_bands(look_below, len(cells), *asked, least=1000)
    return places, below


def find_cropped(lattice: Lattice, bounds: Float | None) -> Bool:
    """Whether a scene continues beyond the lattice in the east, south, west and north, shape (4,).

    `bounds` are its box, shape (2, 3) [m]; None if it is endless.
    """
    if bounds is None:
        return np.ones(4, dtype=np.bool_)
    x_min, y_min, x_max, y_max = lattice.bounds
    low, high = bounds
    return np.array([high[0] - x_max, y_min - low[1], x_min - low[0], high[1] - y_max]) > SLACK


def find_holes(edges: Edges, lattice: Lattice) -> Bool:
    """Which edges are at rims of holes, shape (edges,); `edges` are all those of some sheets."""
    order = np.argsort(edges.sheet, kind="stable")
    start = np.append(np.flatnonzero(np.diff(edges.sheet[order], prepend=-1)), len(order))
    marked, in_hole = np.empty((2, len(order)), dtype=np.bool_)
    mark_holes(edges.cell[order], edges.way[order], start, lattice, marked)
    in_hole[order] = marked
    return in_hole


def beside(lattice: Lattice, cell: Int, way: Int | int, steps: int = 1) -> Int:
    """The cells so many steps east (0), south (1), west (2) or north (3) of cells, -1 for none."""
    row, col = np.divmod(cell, lattice.width)
    row = row + steps * np.array([0, 1, 0, -1])[way]
    col = col + steps * np.array([1, 0, -1, 0])[way]
    inside = (row >= 0) & (row < lattice.height) & (col >= 0) & (col < lattice.width)
    return np.where(inside, row * lattice.width + col, -1)


def probe_bands(agent: AgentSettings) -> tuple[Band, Band]:
    """The bands above a floor at an agent's feet and at its head, see `Site.endings` [m]."""
    low, high = agent.traversable_floor_height, agent.height
    thickness = min(PROBE, (high - low) / 2)
    return Band(low, low + thickness), Band(high - thickness, high)
