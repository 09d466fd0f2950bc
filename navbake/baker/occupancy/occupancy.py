"""Occupancy: does anything stand in the band above a cell's floor, over its footprint?"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns, TiledShapes
from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.arrays import Band, Queries
from navbake.baker.kernels.constants import MEETS, TOUCH, UNDECIDED
from navbake.baker.kernels.occupancy import check_cells
from navbake.baker.kernels.tiles import tile_of
from navbake.baker.occupancy.contact import touch_prism
from navbake.config.settings import AgentSettings
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


class Answers(NamedTuple):
    """Which cells are occupied, shape (n,), bool; how many of them a ray alone proved so, and how
    many had no proof either way, so that FCL decided.
    """

    occupied: Bool
    by_ray: int
    by_fcl: int


class Occupancy(NamedTuple):
    """Occupancy of all storeys.

    Attributes:
        levels: of each storey, shape (height, width) of the whole lattice, bool: a geom meets
            the volume over the cell's floor, or there is no floor.
        by_ray, by_fcl: how many cells were decided so, see `Answers`.
    """

    levels: list[Bool]
    by_ray: int
    by_fcl: int


def find_occupancy(
    floors: Floors, columns: Columns, tiled: TiledShapes, footprint: Footprint
) -> Occupancy:
    """Decide for every cell of every storey whether it is occupied; see `check_occupancy`."""
    levels, by_ray, by_fcl = [], 0, 0
    for level in floors.levels:
        occupied = np.isnan(level.floor)
        cells = np.flatnonzero(~occupied)
        answers = check_occupancy(columns, tiled, footprint, cells, level.floor.ravel()[cells])
        occupied.flat[cells] = answers.occupied
        levels.append(occupied)
        by_ray, by_fcl = by_ray + answers.by_ray, by_fcl + answers.by_fcl
    return Occupancy(levels, by_ray, by_fcl)


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
    geometry = (tiled.shapes.solids, tiled.facets, tiled.shapes.planes, tiled.tiles)
    queries = Queries(cells, floors, np.zeros(len(cells), np.uint8), np.zeros(len(cells), np.bool_))
    check_cells(columns.lattice, columns.crossings, *geometry, footprint, queries)
    state = queries.state
    undecided = np.flatnonzero(state == UNDECIDED)
    for n in undecided:
        if _ask_fcl(tiled, footprint, int(cells[n]), float(floors[n])):
            state[n] = MEETS
    return Answers(state == MEETS, int(queries.by_line.sum()), len(undecided))


def _ask_fcl(tiled: TiledShapes, footprint: Footprint, cell: int, floor: float) -> bool:
    """FCL's answer for one cell, over all solids of its tile."""
    lattice, tiles, tile = tiled.lattice, tiled.tiles, tile_of(tiled.lattice, cell)
    middle, half_z = (footprint.low + footprint.high) / 2, (footprint.high - footprint.low) / 2
    center = np.array([*lattice.positions(*divmod(cell, lattice.width)), floor + middle])
    nearby = tiles.solid_item[tiles.solid_start[tile] : tiles.solid_start[tile + 1]]
    size = (footprint.square, footprint.radius, half_z)
    return touch_prism(tiled.shapes.solids, nearby, center, *size)
