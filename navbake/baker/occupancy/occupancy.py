"""Occupancy: whether a geom meets the agent's footprint in the band above a cell's floor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import Columns, TiledShapes, tile_of
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE
from navbake.baker.core.tiles import TILE
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.baker.occupancy.occupancy_kernels import (
    BLOCKING,
    BLOCKING_SQUARE,
    MAYBE_BLOCKING,
    MAYBE_BLOCKING_SQUARE,
    OccupantLists,
    Queries,
    occupy_tiles,
)
from navbake.config.settings import AgentSettings
from navbake.lazy import lazy
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

fcl = lazy("fcl")  # few scenes have a cell that nothing else decides

FCL_SHAPES: dict[int, Callable[[Float], Any]] = {
    SPHERE: lambda size: fcl.Sphere(size[0]),
    CAPSULE: lambda size: fcl.Capsule(size[0], 2 * size[1]),
    ELLIPSOID: lambda size: fcl.Ellipsoid(*size),
    CYLINDER: lambda size: fcl.Cylinder(size[0], 2 * size[1]),
    BOX: lambda size: fcl.Box(*(2 * size)),
}
NO_LISTING = OccupantLists(
    np.empty(0),
    np.empty(0, np.int32),
    np.empty(0, np.int32),
    np.empty(0),
    np.empty(0, np.bool_),
    0.0,
    0.0,
    0.0,
)


class Footprint(NamedTuple):
    """The volume over a cell's floor: its square joined with the agent's disc, in a band.

    Attributes:
        square: half of the square's edge less TOUCH_DEPTH, 0 where the disc covers the square [m].
        radius: the disc's radius less TOUCH_DEPTH, 0 where the square covers the disc [m].
        low, high: the band above the floor, narrowed by TOUCH_DEPTH [m].
    """

    square: float
    radius: float
    low: float
    high: float

    @property
    def reach(self) -> float:
        """How far the footprint reaches from the cell's centre along an axis [m]."""
        return max(self.square, self.radius) + TOUCH_DEPTH

    @classmethod
    def of(cls, agent: AgentSettings, cell_size: float) -> Footprint:
        """The footprint of an agent on cells of a size [m]."""
        half = cell_size / 2
        radius = agent.radius
        return cls(
            square=half - TOUCH_DEPTH if radius < half * np.sqrt(2.0) else 0.0,
            radius=radius - TOUCH_DEPTH if radius > half else 0.0,
            low=agent.traversable_floor_height + TOUCH_DEPTH,
            high=agent.height - TOUCH_DEPTH,
        )

    def between(self, band: HeightRange) -> Footprint:
        """The same over another band above the floor [m]."""
        return self._replace(low=band.low + TOUCH_DEPTH, high=band.high - TOUCH_DEPTH)


class Occupancy(NamedTuple):
    """Occupancy of all storeys.

    Attributes:
        levels: of each storey, shape (height, width) of the whole lattice, bool: a geom meets
            the volume over the cell's floor, or there is no floor.
        blocked_squares: `levels` for the volume over the cell's square alone; None where the
            agent's disc doesn't reach beyond it.
    """

    levels: list[Bool]
    blocked_squares: list[Bool] | None


class CellOccupancy(NamedTuple):
    """What a look at cells found.

    Attributes:
        occupied: which cells are occupied, shape (n,), bool.
        solid: the same for their squares alone.
        geom, flags: the lists of what stands in the cells, see `occupy_tiles`.
    """

    occupied: Bool
    solid: Bool
    geom: Int32
    flags: NDArray[np.uint8]


def check_occupancy(
    columns: Columns,
    tiled: TiledShapes,
    footprint: Footprint,
    cells: Int,
    floors: Float,
    listing: OccupantLists = NO_LISTING,
) -> CellOccupancy:
    """Check for cells and floor heights, shape (n,), whether a geom meets the footprint above.

    A ray of the cell's column that crosses a geom there, or runs inside of one, proves it occupied.
    Otherwise each geom nearby is proved apart or overlapping; where rounding leaves no proof, FCL
    decides. Geoms that reach in by less than TOUCH_DEPTH only touch.

    Args:
        listing: receives what stands there; then cells have to ascend.
    """
    if len(cells) and np.any(cells[1:] < cells[:-1]):  # the kernel goes tile by tile
        order = np.argsort(cells, kind="stable")
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        found = check_occupancy(columns, tiled, footprint, cells[order], floors[order])
        return found._replace(occupied=found.occupied[back], solid=found.solid[back])
    shapes = tiled.shapes
    lattice = columns.lattice
    cells = cells.astype(np.int64, copy=False)
    state, *scratch = np.zeros((3, len(cells)), dtype=np.uint8)
    queries = Queries(cells, np.ascontiguousarray(floors), state, *scratch)
    parts: dict[int, tuple[Int32, NDArray[np.uint8]]] = {}

    def look(first: int, end: int) -> None:
        geometry = shapes.solids, tiled.facets, shapes.planes
        asked = lattice, columns.hits, geometry, tiled.tile_index, footprint, queries, listing
        geom, flags, used = occupy_tiles(*asked, first, end)
        parts[first] = geom[:used], flags[:used]

    if len(cells):
        rows = cells[[0, -1]] // lattice.width // TILE
        run_in_chunks(look, int(rows[1] - rows[0]) + 1, begin=int(rows[0]))
    firsts = sorted(parts)
    used = 0
    if len(listing.first):  # places are counted in each part
        ends = np.searchsorted(cells, [row * TILE * lattice.width for row in firsts[1:]])
        for own, first in zip(np.split(listing.first, ends), firsts, strict=True):
            own += used
            used += len(parts[first][0])
    lists = [parts[first] for first in firsts]
    lists = lists or [(np.full(1, -1, dtype=np.int32), np.zeros(1, dtype=np.uint8))]
    geom, flags = lists[0]
    if len(lists) > 1:
        geom, flags = map(np.concatenate, zip(*lists, strict=True))
    occupied = (state & BLOCKING) > 0
    unproved = np.flatnonzero(~occupied & ((state & MAYBE_BLOCKING) > 0))
    for n in unproved:
        occupied[n] = ask_fcl(tiled, footprint, int(cells[n]), float(floors[n]))
    solid = occupied
    if footprint.radius > 0:
        solid = (state & BLOCKING_SQUARE) > 0
        square = footprint._replace(square=lattice.cell_size / 2 - TOUCH_DEPTH, radius=0.0)
        for n in np.flatnonzero(occupied & ~solid & ((state & MAYBE_BLOCKING_SQUARE) > 0)):
            solid[n] = ask_fcl(tiled, square, int(cells[n]), float(floors[n]))
        solid &= occupied
    if len(listing.first):  # FCL has decided about the cell
        for n in np.flatnonzero(occupied & ((state & MAYBE_BLOCKING) > 0)):
            i = listing.first[n]
            while geom[i] >= 0:
                flags[i] |= BLOCKING if flags[i] & MAYBE_BLOCKING else 0
                i += 1
        flags &= ~np.uint8(MAYBE_BLOCKING)
    return CellOccupancy(occupied, solid, geom, flags)


def ask_fcl(tiled: TiledShapes, footprint: Footprint, cell: int, floor: float) -> bool:
    """FCL's answer for one cell, over all solids of its tile."""
    lattice = tiled.lattice
    tiles = tiled.tile_index
    solids = tiled.shapes.solids
    tile = tile_of(lattice, cell)
    half_z = (footprint.high - footprint.low) / 2
    x, y = lattice.positions(*divmod(cell, lattice.width))
    center = np.array([x, y, floor + (footprint.low + footprint.high) / 2])
    box = [fcl.Box(2 * footprint.square, 2 * footprint.square, 2 * half_z)]
    disc = [fcl.Cylinder(footprint.radius, 2 * half_z)]
    parts = (box if footprint.square > 0 else []) + (disc if footprint.radius > 0 else [])
    prisms = [fcl.CollisionObject(shape, fcl.Transform(center)) for shape in parts]
    for s in tiles.solid_item[tiles.solid_start[tile] : tiles.solid_start[tile + 1]]:
        place = fcl.Transform(solids.mat[s].reshape(3, 3), solids.pos[s])
        solid = fcl.CollisionObject(FCL_SHAPES[int(solids.kind[s])](solids.size[s]), place)
        if any(fcl.collide(prism, solid) > 0 for prism in prisms):
            return True
    return False
