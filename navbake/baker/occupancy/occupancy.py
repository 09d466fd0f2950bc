"""Occupancy: does anything stand in the band above a cell's floor, over its footprint?"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns, TiledShapes
from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.arrays import Band, Queries
from navbake.baker.kernels.constants import MEETS, TOUCH, UNDECIDED
from navbake.baker.kernels.occupancy import check_cells
from navbake.baker.kernels.tiles import TILE, tile_of
from navbake.baker.occupancy.contact import touch_prism
from navbake.config.settings import AgentSettings
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int


class Footprint(NamedTuple):
    """What a cell sweeps over its floor: its square joined with the agent's disc, in a band.

    Attributes:
        square: half of the square's edge less TOUCH, 0 where the disc covers the square [m].
        radius: the disc's radius less TOUCH, 0 where the square covers the disc [m].
        low, high: the band above the floor, narrowed by TOUCH [m].
    """

    square: float
    radius: float
    low: float
    high: float

    @property
    def reach(self) -> float:
        """How far the footprint reaches from the cell's centre along an axis [m]."""
        return max(self.square, self.radius) + TOUCH

    @classmethod
    def of(cls, agent: AgentSettings, cell_size: float) -> Footprint:
        """The footprint of an agent on cells of a size [m]."""
        half, radius = cell_size / 2, agent.radius
        return cls(
            square=half - TOUCH if radius < half * np.sqrt(2.0) else 0.0,
            radius=radius - TOUCH if radius > half else 0.0,
            low=agent.traversable_floor_height + TOUCH,
            high=agent.height - TOUCH,
        )

    def between(self, band: Band) -> Footprint:
        """The same over another band above the floor [m]."""
        return self._replace(low=band.low + TOUCH, high=band.high - TOUCH)


class Footprints(NamedTuple):
    """The footprint that is baked, and the cell's square alone.

    Attributes:
        whole: the square joined with the agent's disc.
        square: the square alone; None where the disc doesn't reach beyond it.
    """

    whole: Footprint
    square: Footprint | None

    @classmethod
    def of(cls, agent: AgentSettings, cell_size: float) -> Footprints:
        """The footprints of an agent on cells of a size [m]."""
        whole = Footprint.of(agent, cell_size)
        point = agent.model_copy(update={"radius": 0.0})
        return cls(whole, Footprint.of(point, cell_size) if whole.radius > 0.0 else None)


class Answers(NamedTuple):
    """What a check of cells found.

    Attributes:
        occupied: which cells are occupied, shape (n,), bool.
        solid: the same for their squares alone.
        by_ray: how many cells a ray alone proved occupied.
        by_fcl: how many had no proof either way, so that FCL decided.
    """

    occupied: Bool
    solid: Bool
    by_ray: int
    by_fcl: int


class Occupancy(NamedTuple):
    """Occupancy of all storeys.

    Attributes:
        levels: of each storey, shape (height, width) of the whole lattice, bool: a geom meets
            the volume over the cell's floor, or there is no floor.
        by_ray, by_fcl: how many cells were decided so, see `Answers`.
        solid: the same for the volume over the cell's square alone; None where the agent's disc
            doesn't reach beyond it.
    """

    levels: list[Bool]
    by_ray: int
    by_fcl: int
    solid: list[Bool] | None


class OccupancyFinder:
    """Decides for every cell of every storey whether it is occupied, block by block.

    Attributes:
        levels: see `Occupancy`; cells of blocks that were not looked at have an open floor yet.
    """

    def __init__(self, floors: Floors, tiled: TiledShapes, footprints: Footprints) -> None:
        self._floors, self._tiled, self._footprints = floors, tiled, footprints
        self.levels = [np.isnan(level.floor) for level in floors.levels]
        has_solid = footprints.square is not None
        self._solids = [mask.copy() for mask in self.levels] if has_solid else None
        self._by_ray = self._by_fcl = 0

    def add(self, columns: Columns) -> None:
        """Check the cells of a block, see `check_footprints`."""
        first, end = columns.known_rows.cells(columns.lattice)
        for number, level in enumerate(self._floors.levels):
            floor = level.floor.ravel()[first:end]
            here = np.flatnonzero(~np.isnan(floor))
            cells, heights = first + here, floor[here]
            answers = check_footprints(columns, self._tiled, self._footprints, cells, heights)
            self.levels[number].ravel()[cells] = answers.occupied
            if self._solids is not None:
                self._solids[number].ravel()[cells] = answers.solid
            self._by_ray += answers.by_ray
            self._by_fcl += answers.by_fcl

    def found(self) -> Occupancy:
        """The occupancy of all cells."""
        return Occupancy(self.levels, self._by_ray, self._by_fcl, self._solids)


def check_footprints(
    columns: Columns, tiled: TiledShapes, footprints: Footprints, cells: Int, floors: Float
) -> Answers:
    """Check the whole footprint and the square alone, see `check_occupancy`.

    The square is part of the footprint, and a cell's own line is part of the square: so only the
    cells that are occupied, and not by their line, are asked again.
    """
    occupied, by_line, by_fcl = _check(columns, tiled, footprints.whole, cells, floors)
    solid = occupied
    if footprints.square is not None:
        asked = np.flatnonzero(occupied & ~by_line)
        solid = by_line.copy()
        solid[asked], *_ = _check(columns, tiled, footprints.square, cells[asked], floors[asked])
    return Answers(occupied, solid, int(by_line.sum()), by_fcl)


def check_occupancy(
    columns: Columns, tiled: TiledShapes, footprint: Footprint, cells: Int, floors: Float
) -> Answers:
    """Check for cells and floor heights, shape (n,), whether a geom meets the volume above.

    The volume stands over the cell's footprint, between the floor plus the traversable height
    and the floor plus the agent's height. A ray of the cell's column that crosses a geom there,
    or runs inside of one, proves it occupied. Otherwise each geom nearby is proved apart or
    overlapping; where rounding leaves no proof, FCL decides. Geoms that reach in by less than
    TOUCH only touch.
    """
    return check_footprints(columns, tiled, Footprints(footprint, None), cells, floors)


def _check(
    columns: Columns, tiled: TiledShapes, footprint: Footprint, cells: Int, floors: Float
) -> tuple[Bool, Bool, int]:
    """See `check_occupancy`; also which cells a ray proved occupied, and how many FCL decided."""
    if len(cells) and np.any(cells[1:] < cells[:-1]):  # the kernel goes tile by tile
        order = np.argsort(cells, kind="stable")
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        occupied, by_line, by_fcl = _check(columns, tiled, footprint, cells[order], floors[order])
        return occupied[back], by_line[back], by_fcl
    shapes, known, cells = tiled.shapes, columns.known_rows, cells.astype(np.int64, copy=False)
    first, end = known.first // TILE, -(-known.end // TILE)
    if len(cells):  # the kernel looks at each tile of these rows
        rows = cells[[0, -1]] // columns.lattice.width // TILE
        first, end = max(first, int(rows[0])), min(end, int(rows[1]) + 1)
    queries = Queries(cells, floors, np.zeros(len(cells), np.uint8), np.zeros(len(cells), np.bool_))
    asked = columns.lattice, columns.crossings, shapes.solids, tiled.facets, shapes.planes
    if len(cells):
        work = check_cells, end - first, *asked, tiled.tiles, footprint, queries
        run_in_bands(*work, begin=first)
    state = queries.state
    undecided = np.flatnonzero(state == UNDECIDED)
    for n in undecided:
        if _ask_fcl(tiled, footprint, int(cells[n]), float(floors[n])):
            state[n] = MEETS
    return state == MEETS, queries.by_line, len(undecided)


def _ask_fcl(tiled: TiledShapes, footprint: Footprint, cell: int, floor: float) -> bool:
    """FCL's answer for one cell, over all solids of its tile."""
    lattice, tiles, tile = tiled.lattice, tiled.tiles, tile_of(tiled.lattice, cell)
    middle, half_z = (footprint.low + footprint.high) / 2, (footprint.high - footprint.low) / 2
    center = np.array([*lattice.positions(*divmod(cell, lattice.width)), floor + middle])
    nearby = tiles.solid_item[tiles.solid_start[tile] : tiles.solid_start[tile + 1]]
    size = (footprint.square, footprint.radius, half_z)
    return touch_prism(tiled.shapes.solids, nearby, center, *size)
