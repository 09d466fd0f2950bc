"""Occupancy: does anything stand in the band above a cell's floor, over its footprint?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns, TiledShapes
from navbake.baker.kernels.arrays import Queries
from navbake.baker.kernels.constants import MEETS, TOUCH, UNDECIDED
from navbake.baker.kernels.occupancy import check_cells
from navbake.baker.kernels.tiles import tile_of
from navbake.baker.occupancy.contact import prisms, solid_touches
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


@dataclass(frozen=True)
class Answers:
    """Answers of `check_occupancy`.

    Attributes:
        occupied: shape (n,), bool.
        by_ray: how many a ray alone proved occupied.
        by_fcl: how many had no proof, so that FCL decided.
    """

    occupied: Bool
    by_ray: int
    by_fcl: int


def check_occupancy(
    columns: Columns, tiled: TiledShapes, footprint: Footprint, cells: Int, floors: Float
) -> Answers:
    """Tell for each cell and floor whether a geom meets the open volume above it.

    The volume stands over the cell's footprint, between the floor plus the traversable height
    and the floor plus the agent's height. A ray of the cell's column that crosses a geom there,
    or runs inside of one, proves it occupied. Otherwise each geom nearby is proved apart or
    overlapping; where rounding leaves no proof, FCL decides. Geoms that reach in by less than
    5e-7 m only touch.

    Args:
        columns: the surfaces.
        tiled: the same scene's geometry on the same lattice.
        footprint: the volume.
        cells: cell ids on the lattice, shape (n,), int64.
        floors: the floor heights asked about, shape (n,), float64 [m].

    Returns:
        The answers, in the order of the questions.
    """
    shapes = tiled.shapes
    state, by_line = np.zeros(len(cells), np.uint8), np.zeros(len(cells), np.bool_)
    check_cells(
        columns.lattice,
        columns.crossings,
        shapes.solids,
        tiled.facets,
        shapes.planes,
        tiled.tiles,
        footprint,
        Queries(cells, floors, state, by_line),
    )
    undecided = np.flatnonzero(state == UNDECIDED)
    for n in undecided:
        if _ask_fcl(tiled, footprint, int(cells[n]), float(floors[n])):
            state[n] = MEETS
    return Answers(occupied=state == MEETS, by_ray=int(by_line.sum()), by_fcl=len(undecided))


def _ask_fcl(tiled: TiledShapes, footprint: Footprint, cell: int, floor: float) -> bool:
    """FCL's answer for one cell, over all solids of its tile."""
    lattice, solids = tiled.lattice, tiled.shapes.solids
    row, col = divmod(cell, lattice.width)
    middle = floor + (footprint.low + footprint.high) / 2
    center = np.array([*lattice.positions(row, col), middle])
    half_z = (footprint.high - footprint.low) / 2
    volumes = prisms(footprint.square, footprint.radius, half_z)
    tiles, tile = tiled.tiles, tile_of(lattice, cell)
    nearby = tiles.solid_item[tiles.solid_start[tile] : tiles.solid_start[tile + 1]]
    return any(solid_touches(solids, int(s), center, volumes) for s in nearby)
