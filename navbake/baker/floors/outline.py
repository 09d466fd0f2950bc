"""How sheets end: at walls, at drops, at the lattice's border, or in some other way."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from navbake.baker.blocks import Rows, gather_rows
from navbake.baker.columns import Columns, ColumnSource
from navbake.baker.connect import label_parts
from navbake.baker.floors.kernels.members import Labelled, list_edges
from navbake.baker.floors.sheets import Sheets
from navbake.baker.kernels.arrays import Band
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Int32

# How an edge of a sheet ends, see `find_endings`
WALL, BARRIER, DROP, BORDER, OPEN = range(5)
# How thick the two bands are that tell a wall, at an agent's feet and at its head [m]
PROBE = 0.01


class OccupancyTest(Protocol):
    """Tells which cells are occupied over their squares."""

    def __call__(self, cells: Int, floors: Float, band: Band | None = None, /) -> Bool:
        """Ask for cells and floor heights, shape (n,) [m].

        Args:
            cells: cell ids.
            floors: the floor's height in each [m].
            band: what counts as in the way, as heights above the floor [m]: without it, the
                band between a step and the agent's height.

        Returns:
            Whether a geom meets the band over each cell's square, shape (n,), bool.
        """


class Edges(NamedTuple):
    """Edges of sheets: sides of cells beyond which there is no surface of the same sheet.

    Attributes:
        sheet: the sheet that ends there, shape (edges,), int32.
        cell: the cell on this side, shape (edges,), int64.
        z: the sheet's height in it, shape (edges,), float64 [m].
        way: the way out: east (0), south (1), west (2), north (3), shape (edges,), int64.
        cells: the cells beyond, the nearest first, -1 from where the lattice ends or the sheet
            begins again, shape (edges, reach), int64.
        floors: the highest floor of another sheet that is more than a step lower in each of these
            cells, NaN for none, shape (edges, reach), float64 [m].
        landing: the sheets of these floors, -1 for none, shape (edges, reach), int32.
    """

    sheet: Int32
    cell: Int
    z: Float
    way: Int
    cells: Int
    floors: Float
    landing: Int32

    def only(self, kept: Bool | Int) -> Edges:
        """The edges that are kept: a mask, shape (edges,), or their indices."""
        return Edges._make(array[kept] for array in self)


class Endings(NamedTuple):
    """How a sheet ends at each of its edges, see `find_endings`.

    Attributes:
        kind: WALL, BARRIER, DROP, BORDER or OPEN, shape (edges,), uint8.
        cell: the cell that a drop leads to, -1 for the others, shape (edges,), int64.
        landing: the height of the floor there, NaN for the others, shape (edges,), float64 [m].
        floor: the sheet of that floor, -1 for the others, shape (edges,), int32.
    """

    kind: NDArray[np.uint8]
    cell: Int
    landing: Float
    floor: Int32


class KnownEdges:
    """The edges of sheets that were asked for, found again in blocks where something changed."""

    def __init__(self) -> None:
        self._rows: dict[Any, tuple[int, Rows]] = {}
        self._kept: dict[Any, tuple[int, Rows]] = {}

    def begin(self, last: Int, now: int) -> None:
        """Begin an update; what was not asked for in the last one is forgotten.

        Args:
            last: in which update something last changed in or near each block.
            now: the number of the update.
        """
        self._kept, self._rows, self._last, self._now = self._rows, {}, last, now

    def find(
        self, sheets: Sheets, asked: tuple[Labelled, Bool, float, int], among_large: bool
    ) -> Edges:
        """The edges of chosen sheets, see `list_edges`; they are kept if `among_large`."""
        _, chosen, _, reach = asked
        name = reach, tuple(sheets.key[chosen].tolist())
        tick, rows = self._kept.get(name, (-1, None))
        if rows is None or not among_large:
            tick, rows = -1, Rows(sheets.blocks.num, *_no_edges(reach))
        stale = np.flatnonzero((self._last > tick) & (sheets.blocks_of(chosen) | (tick >= 0)))
        counts, *found = gather_rows(list_edges, len(stale), *asked, stale)
        sheet, *others, landing = found
        # keys stay, numbers do not
        keys = np.where(landing >= 0, sheets.key[landing], -1)
        rows.put(stale, counts, sheets.key[sheet], *others, keys)
        if among_large:
            self._rows[name] = self._now, rows
        sheet, *others, keys = rows.take()
        landing = np.where(keys >= 0, np.searchsorted(sheets.key, keys), -1)
        number = np.searchsorted(sheets.key, sheet)
        return Edges._make([number.astype(np.int32), *others, landing.astype(np.int32)])


def _no_edges(reach: int) -> list[NDArray[Any]]:
    ids, heights = np.empty(0, dtype=np.int64), np.empty(0)
    cells = np.empty((0, reach), dtype=np.int64)
    return [ids, ids, heights, ids, cells, np.empty((0, reach)), cells]


class Site(NamedTuple):
    """What the rules that tell tops, roofs and shelves from floors ask about.

    Attributes:
        sheets: all sheets, furniture included.
        is_large: which of them are large enough for floors, shape (sheets,), bool.
        columns: all surfaces.
        agent: who walks there.
        settings: of the floors.
        is_occupied: tells which cells are occupied.
        cropped: whether the scene goes on beyond the lattice in the east, south, west and north,
            shape (4,), bool.
        known: the edges that are known.
    """

    sheets: Sheets
    is_large: Bool
    columns: ColumnSource
    agent: AgentSettings
    settings: FloorSettings
    is_occupied: OccupancyTest
    cropped: Bool
    known: KnownEdges

    @property
    def reach(self) -> int:
        """How many cells one looks out from a sheet for floors beside it.

        The side of the thing itself, or a post, may block the cell at its edge: one more.
        """
        return int(np.ceil(self.settings.shrink / self.sheets.lattice.cell_size)) + 1

    def edges(self, chosen: Bool, reach: int, among: Bool | None = None) -> Edges:
        """Find the edges of chosen sheets, and the floors below them.

        Args:
            reach: how many cells to look out for floors below, >= 1.
            among: the sheets that count, the large ones if None.
        """
        counts, step = (
            self.is_large if among is None else among,
            self.agent.traversable_floor_height,
        )
        asked = self.sheets.labelled(counts), chosen, step, reach
        return self.known.find(self.sheets, asked, counts is self.is_large)

    def outer_edges(self, chosen: Bool, reach: int) -> Edges:
        """The edges of some sheets along their outlines, without those of the holes in them."""
        edges = self.edges(chosen, reach)
        return edges.only(find_rims(edges, self.sheets) == 0)

    def endings(self, edges: Edges, agent: AgentSettings | None = None) -> Endings:
        """Tell how sheets end at edges, see `find_endings`, for the agent or another one."""
        return find_endings(edges, self.columns, agent or self.agent, self.is_occupied)


def find_endings(
    edges: Edges,
    columns: ColumnSource,
    agent: AgentSettings,
    is_occupied: OccupancyTest,
) -> Endings:
    """Tell how a sheet ends at each of its edges.

    - WALL: something stands in the cell on this side of the edge, or in the one beyond, at an
      agent's feet (just above a step) and at its head (just below its height). So it does not
      matter how a wall ends at the ceiling, nor whether it is thinner than a cell; and a chair's
      back is none.
    - BARRIER: something stands at an agent's feet only: a parapet, a headboard, a sill.
    - DROP: an agent that steps out gets to a floor more than a step lower, where it can stand.
      Where a surface goes on from the sheet's height over that floor, one that is too steep or
      has too little headroom, there is no drop: the storey below an attic is no floor that one
      drops to. One looks past what is lower than the sheet, such as a bed's frame or a rail, as
      far as `edges.cells` reach, and stops at a barrier.
    - BORDER: the lattice ends.
    - OPEN: none of these: an abyss, a steep slope, a floor on which nobody can stand.
    """
    z, inner = edges.z, edges.cell
    step = agent.traversable_floor_height
    feet, head = probe_bands(agent)
    outer = edges.cells[:, 0]
    # all that is asked about, so that it is found at once
    known = columns.at(np.concatenate([inner, edges.cells[edges.cells >= 0]]))
    at_feet = _either_occupied(inner, outer, z, feet, is_occupied)
    at_head = np.zeros_like(at_feet)
    at_head[at_feet] = _either_occupied(
        inner[at_feet], outer[at_feet], z[at_feet], head, is_occupied
    )
    ending, landing = np.full(len(z), OPEN, dtype=np.uint8), np.full(len(z), np.nan)
    cell, floor = np.full(len(z), -1, dtype=np.int64), np.full(len(z), -1, dtype=np.int32)
    ending[outer < 0] = BORDER
    ending[at_feet] = BARRIER
    ending[at_head] = WALL
    looking, ground = np.flatnonzero(ending == OPEN), z.copy()
    for k in range(edges.cells.shape[1]):
        looking = looking[edges.cells[looking, k] >= 0]
        if k > 0:  # the nearest cell has been asked
            stops = is_occupied(edges.cells[looking, k], z[looking], feet)
            ending[looking[stops]] = BARRIER
            looking = looking[~stops]
        ground[looking] = _find_surface(known, edges.cells[looking, k], ground[looking], step)
        below = looking[~np.isnan(edges.floors[looking, k])]
        cells, floors = edges.cells[below, k], edges.floors[below, k]
        goes_on = ground[below] > floors + agent.height + SLACK
        lands = below[~goes_on & ~is_occupied(cells, floors)]
        ending[lands], landing[lands] = DROP, edges.floors[lands, k]
        cell[lands], floor[lands] = edges.cells[lands, k], edges.landing[lands, k]
        looking = looking[ending[looking] == OPEN]
    return Endings(ending, cell, landing, floor)


def find_cropped(lattice: Lattice, bounds: Float | None) -> Bool:
    """Whether a scene goes on beyond the lattice in the east, south, west and north, shape (4,).

    Args:
        bounds: the box round the scene, shape (2, 3) [m]; None if it is endless.
    """
    if bounds is None:
        return np.ones(4, dtype=np.bool_)
    x_min, y_min, x_max, y_max = lattice.bounds
    low, high = bounds
    return np.array([high[0] - x_max, y_min - low[1], x_min - low[0], high[1] - y_max]) > SLACK


def share_of_known(num_sheets: int, edges: Edges, which: Bool, known: Bool) -> Float:
    """The share of each sheet's known edges that are of some kind, shape (sheets,).

    NaN where none is known.
    """
    of_kind = np.bincount(edges.sheet, which & known, num_sheets)
    whole = np.bincount(edges.sheet, known, num_sheets)
    share = np.full(num_sheets, np.nan)
    np.divide(of_kind, whole, out=share, where=whole > 0)
    return share


def is_known(edges: Edges, kind: NDArray[np.uint8], cropped: Bool) -> Bool:
    """Whether one knows how the sheet ends at edges: not where the lattice crops the scene.

    At a border beyond which there is no scene, nothing stands beside the sheet, nor is a floor.
    """
    known: Bool = (kind != BORDER) | ~cropped[edges.way]
    return known


def find_rims(edges: Edges, sheets: Sheets) -> Int:
    """Number the rims of sheets: 0 is the outer one, 1 and up those of the holes in the sheet.

    What stands on a roof, or on a shelf, interrupts its sheet, but is no wall around it.

    Returns:
        The rim of its sheet that each edge belongs to, shape (edges,), int64.
    """
    lattice, outer = sheets.lattice, edges.cells[:, 0]
    rim, order = np.zeros(len(outer), dtype=np.int64), np.argsort(edges.sheet, kind="stable")
    asked = np.unique(edges.sheet)
    bounds = np.searchsorted(edges.sheet[order], [*asked, len(sheets.key)])
    for k, sheet in enumerate(asked.tolist()):
        own = order[bounds[k] : bounds[k + 1]]
        own = own[outer[own] >= 0]
        mask, row0, col0 = sheets.mask(sheet, margin=1)
        outside, _ = label_parts(~mask)  # in the order of rows, so the outside is the first
        row, col = np.divmod(outer[own], lattice.width)
        rim[own] = outside[row - row0, col - col0] - 1
    return rim


def _find_surface(columns: Columns, cells: Int, z: Float, step: float) -> Float:
    """The highest surface of cells' columns within a step of heights, shape (n,), else NaN [m]."""
    first, last = columns.start[cells], columns.start[cells + 1]
    found = np.full(len(cells), np.nan)
    for k in range(int((last - first).max(initial=0))):
        height = columns.z[np.minimum(first + k, last - 1)]
        near = (first + k < last) & (abs(height - z) <= step + SLACK)
        found[near] = height[near]
    return found


def probe_bands(agent: AgentSettings) -> tuple[Band, Band]:
    """The bands above a floor at an agent's feet and at its head, where walls are felt for [m]."""
    low, high = agent.traversable_floor_height, agent.height
    thickness = min(PROBE, (high - low) / 2)
    return Band(low, low + thickness), Band(high - thickness, high)


def _either_occupied(
    inner: Int, outer: Int, z: Float, band: Band, is_occupied: OccupancyTest
) -> Bool:
    """Whether a band is occupied on this side of edges, or beyond them."""
    occupied = is_occupied(inner, z, band)
    ask = np.flatnonzero(~occupied & (outer >= 0))
    occupied[ask] = is_occupied(outer[ask], z[ask], band)
    return occupied
