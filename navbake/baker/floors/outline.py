"""How regions end: at walls, at drops, at the lattice's border, or otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import ColumnSource
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.member_kernels import (
    ITSELF,
    Edges,
    Labelled,
    list_edges,
    look_below,
    mark_holes,
)
from navbake.baker.floors.regions import Regions
from navbake.baker.floors.surfaces import find_near
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# How an edge of a region ends, see `Site.endings`
WALL, BARRIER, DROP, BORDER, OPEN = range(5)
# The thickness of the bands at an agent's feet and head that both meet a wall [m]
PROBE = 0.01
# An empty array of rows of `list_edges`
NO_EDGES = np.empty((0, 5), dtype=np.int64)

OccupancyTest = Callable[[Int, Float, HeightRange | None], Bool]
"""Whether a geom meets a band of heights above the floor, over each cell's square.

Called with cell ids, the floor's height in each [m], and the band [m]; None is the one between a
step and the agent's height.
"""


class Endings(NamedTuple):
    """How a region ends at each of its edges, see `Site.endings`.

    Attributes:
        kind: WALL, BARRIER, DROP, BORDER or OPEN, shape (edges,), uint8.
        landing: the height of the floor that a drop leads to, NaN for the others [m].
        floor: the region of that floor, -1 for the others, int32.
        is_known: False at borders where the lattice crops the scene; at the others nothing stands
            beside the region, nor is a floor.
    """

    kind: NDArray[np.uint8]
    landing: Float
    floor: Int32
    is_known: Bool


class ListedEdges(NamedTuple):
    """Edges of regions, as `list_edges` has them.

    Attributes:
        region: that ends there, int32.
        rows: see `list_edges`, shape (edges, 5), int64.
    """

    region: Int32
    rows: Int


class Site(NamedTuple):
    """The input of the rules for tops, roofs and shelves.

    Attributes:
        regions: all regions, furniture included.
        is_large: which of them are large enough for floors, shape (regions,), bool.
        columns: all surfaces.
        cropped: see `find_cropped`.
        edges: of the large regions.
        reach: how many cells beyond a region's edge floors are looked for.
    """

    regions: Regions
    is_large: Bool
    columns: ColumnSource
    agent: AgentSettings
    settings: FloorSettings
    is_occupied: OccupancyTest
    cropped: Bool
    edges: ListedEdges
    reach: int

    def edges_of(self, mask: Bool, reach: int) -> Edges:
        """The edges of some large regions, and the floors below them.

        Args:
            reach: how many cells to look out for floors below.
        """
        regions = self.regions
        step = self.agent.traversable_floor_height
        listed = self.edges
        is_in_mask = mask[listed.region]
        _, cell, place, way, _ = listed.rows[is_in_mask].T
        edges = Edges(
            region=listed.region[is_in_mask],
            cell=cell.copy(),
            z=regions.surfaces.z[place],
            way=way.copy(),
            cells=np.full((len(cell), reach), -1),
            floors=np.full((len(cell), reach), np.nan),
            landing=np.full((len(cell), reach), -1, dtype=np.int32),
        )
        labelled = regions.labelled(self.is_large)
        looking = np.arange(len(cell))
        for k in range(reach):
            cells = beside(regions.lattice, edges.cell[looking], edges.way[looking], k + 1)
            is_inside = cells >= 0
            looking = looking[is_inside]
            cells = cells[is_inside]
            limits = edges.z[looking] - step - LIMIT_SLACK
            places, below = find_below(labelled, cells, limits, edges.region[looking])
            goes_out = places != ITSELF
            looking = looking[goes_out]
            places = places[goes_out]
            edges.cells[looking, k] = cells[goes_out]
            edges.landing[looking, k] = below[goes_out]
            lies = places >= 0
            edges.floors[looking[lies], k] = labelled.surfaces.z[places[lies]]
        return edges

    def barriers(self, edges: Edges, agent: AgentSettings) -> NDArray[np.uint8]:
        """`kind` of `endings`, but OPEN in place of DROP; for the agent or another one."""
        outer = beside(self.regions.lattice, edges.cell, edges.way)
        kind = np.full(len(outer), OPEN, dtype=np.uint8)
        kind[outer < 0] = BORDER
        looking = np.arange(len(outer))
        at_feet, at_head = probe_bands(agent)
        for band, meaning in ((at_feet, BARRIER), (at_head, WALL)):
            stands = self.is_occupied(edges.cell[looking], edges.z[looking], band)
            beyond = np.flatnonzero(~stands & (outer[looking] >= 0))
            cells = outer[looking[beyond]]
            stands[beyond] = self.is_occupied(cells, edges.z[looking[beyond]], band)
            looking = looking[stands]
            kind[looking] = meaning
        return kind

    def endings(self, edges: Edges) -> Endings:
        """Classify how a region ends at each of its edges.

        - WALL: something stands in the cell on this side of the edge, or in the one beyond, at an
          agent's feet (just above a step) and at its head (just below its height).
        - BARRIER: something stands at an agent's feet only: a parapet, a headboard, a sill.
        - DROP: an agent that steps out gets to a floor more than a step lower, where it can stand;
          in any of `edges.cells` up to a barrier, past a bed's frame. There is no drop where a
          surface continues from the region over that floor, as in an attic.
        - BORDER: the lattice ends.
        - OPEN: an abyss, a steep slope, a floor on which nobody can stand.
        """
        agent = self.agent
        at_feet, _ = probe_bands(agent)
        # of all these cells at once
        columns = self.columns.covering(np.concatenate([edges.cell, edges.cells[edges.cells >= 0]]))
        kind = self.barriers(edges, agent)
        landing = np.full(len(kind), np.nan)
        floor = np.full(len(kind), -1, dtype=np.int32)
        ground = edges.z.copy()
        looking = np.flatnonzero(kind == OPEN)
        for k in range(edges.cells.shape[1]):
            looking = looking[edges.cells[looking, k] >= 0]
            if k > 0:  # the nearest cell has been asked
                stops = self.is_occupied(edges.cells[looking, k], edges.z[looking], at_feet)
                kind[looking[stops]] = BARRIER
                looking = looking[~stops]
            cells = edges.cells[looking, k]
            ground[looking] = find_near(
                columns.start[cells],
                columns.start[cells + 1],
                columns.z,
                ground[looking],
                agent.traversable_floor_height,
            )
            below = looking[~np.isnan(edges.floors[looking, k])]
            floors = edges.floors[below, k]
            goes_on = ground[below] > floors + agent.height + LIMIT_SLACK
            lands = below[~goes_on & ~self.is_occupied(edges.cells[below, k], floors, None)]
            kind[lands] = DROP
            landing[lands] = edges.floors[lands, k]
            floor[lands] = edges.landing[lands, k]
            looking = looking[kind[looking] == OPEN]
        return Endings(kind, landing, floor, self.is_known(kind, edges.way))

    def is_known(self, kind: NDArray[np.uint8], way: Int) -> Bool:
        """Which edges do not end where the lattice crops the scene, by their endings and ways."""
        known: Bool = (kind != BORDER) | ~self.cropped[way]
        return known

    def share(self, edges: Edges, which: Bool, known: Bool) -> Float:
        """The share of each region's known edges that are of some kind, NaN where none is known."""
        num_of_kind = np.bincount(edges.region, which & known, len(self.is_large))
        num_known = np.bincount(edges.region, known, len(self.is_large))
        share = np.full(len(num_known), np.nan)
        np.divide(num_of_kind, num_known, out=share, where=num_known > 0)
        return share


def look_at_site(
    regions: Regions,
    is_large: Bool,
    columns: ColumnSource,
    cropped: Bool,
    agent: AgentSettings,
    settings: FloorSettings,
    is_occupied: OccupancyTest,
) -> Site:
    """List the edges of large regions; for the arguments, see `Site`."""
    reach = int(np.ceil(settings.shrink / regions.lattice.cell_size)) + 1
    lowest = regions.low[is_large].min(initial=np.inf)
    _, (rows,) = regions.blocks.list_rows(
        list_edges,
        (NO_EDGES,),
        regions.labelled(is_large),
        lowest,
        agent.traversable_floor_height,
        reach,
    )
    return Site(
        regions=regions,
        is_large=is_large,
        columns=columns,
        agent=agent,
        settings=settings,
        is_occupied=is_occupied,
        cropped=cropped,
        edges=ListedEdges(regions.of_part[rows[:, 0]], rows),
        reach=reach,
    )


def find_below(
    labelled: Labelled, cells: Int, limits: Float, regions: Int32 | None = None
) -> tuple[Int, Int32]:
    """The highest surfaces of other regions, or of any, below limits, see `look_below`."""
    if regions is None:
        regions = np.full(len(cells), -2, dtype=np.int32)
    places = np.empty(len(cells), dtype=np.int64)
    below = np.empty(len(cells), dtype=np.int32)
    run_in_chunks(
        look_below, len(cells), labelled, cells, regions, limits, places, below, least=1000
    )
    return places, below


def find_cropped(lattice: Lattice, bounds: Float | None) -> Bool:
    """Whether a scene continues beyond the lattice in the east, south, west and north, shape (4,).

    `bounds` are its box, shape (2, 3) [m]; None if it is endless.
    """
    if bounds is None:
        return np.ones(4, dtype=np.bool_)
    x_min, y_min, x_max, y_max = lattice.bounds
    low, high = bounds
    return (
        np.array([high[0] - x_max, y_min - low[1], x_min - low[0], high[1] - y_max]) > LIMIT_SLACK
    )


def find_holes(edges: Edges, lattice: Lattice) -> Bool:
    """Which edges are at rims of holes, shape (edges,); `edges` are all those of some regions."""
    order = np.argsort(edges.region, kind="stable")
    start = np.append(np.flatnonzero(np.diff(edges.region[order], prepend=-1)), len(order))
    marked = np.empty(len(order), dtype=np.bool_)
    in_hole = np.empty(len(order), dtype=np.bool_)
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


def probe_bands(agent: AgentSettings) -> tuple[HeightRange, HeightRange]:
    """The bands above a floor at an agent's feet and at its head, see `Site.endings` [m]."""
    low = agent.traversable_floor_height
    high = agent.height
    thickness = min(PROBE, (high - low) / 2)
    return HeightRange(low, low + thickness), HeightRange(high - thickness, high)
