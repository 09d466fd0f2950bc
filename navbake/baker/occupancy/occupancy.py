"""Decides which cells are occupied: where a geom meets the agent's footprint over the floor.

The footprint is an upright prism, from the highest step to the agent's height above the floor, see
`Footprint`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import Columns, TiledShapes, tile_of
from navbake.baker.core.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE
from navbake.baker.core.tiles import TILE
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy_kernels import check_tiles
from navbake.baker.occupancy.volume_kernels import (
    BLOCKING,
    BLOCKING_SQUARE,
    MAYBE_BLOCKING,
    MAYBE_BLOCKING_SQUARE,
    OccupantLists,
    Queries,
    ShapeArrays,
)
from navbake.lazy import lazy
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

fcl = lazy("fcl")  # few scenes have a cell that nothing else decides

FCL_SHAPES: dict[int, Callable[[Float], object]] = {
    SPHERE: lambda size: fcl.Sphere(size[0]),
    CAPSULE: lambda size: fcl.Capsule(size[0], 2 * size[1]),
    ELLIPSOID: lambda size: fcl.Ellipsoid(*size),
    CYLINDER: lambda size: fcl.Cylinder(size[0], 2 * size[1]),
    BOX: lambda size: fcl.Box(*(2 * size)),
}
"""MuJoCo's geom type -> a function that makes FCL's shape from MuJoCo's size of a geom."""
NO_LISTS = OccupantLists(
    ceiling=np.empty(0),
    first=np.empty(0, np.int32),
    floor_geom=np.empty(0, np.int32),
    gap_below=np.empty(0),
    is_wall_candidate=np.empty(0, np.bool_),
    wall_low=0.0,
    wall_high=0.0,
    min_up=0.0,
)
"""Settings for `check_occupancy` to list no occupants."""


class Occupancy(NamedTuple):
    """Which cells structure occupies; movables and doors are not included.

    Attributes:
        levels: for each level, a mask of shape (height, width) of the whole lattice: structure
            meets the agent's footprint over the cell's floor, or the cell has no floor.
        blocked_squares: the same for the volume over the cell's square alone, without the agent's
            disc; None if the disc doesn't reach beyond the square.
    """

    levels: list[Bool]
    blocked_squares: list[Bool] | None


class CellOccupancy(NamedTuple):
    """Occupancy of some cells, and the lists of their occupants.

    Attributes:
        occupied: whether a geom meets the footprint over the cell's floor, shape (n,), bool.
        square_occupied: whether a geom meets the volume over the cell's square alone, without the
            agent's disc, shape (n,), bool.
        geom: the lists of the geoms in each cell, one after the other: geom ids, and -1 at the end
            of each list, int32; see `check_tiles`.
        flags: the flags of each entry of `geom`, see `volume_kernels`, uint8.
    """

    occupied: Bool
    square_occupied: Bool
    geom: Int32
    flags: NDArray[np.uint8]


def check_occupancy(
    columns: Columns,
    tiled: TiledShapes,
    footprint: Footprint,
    cells: Int,
    floors: Float,
    lists: OccupantLists = NO_LISTS,
) -> CellOccupancy:
    """Check whether a geom meets the footprint over the floors of cells.

    The footprint is an upright prism over the cell's square and the agent's disc, usually from the
    highest step to the agent's height above the floor. If the cell's vertical line crosses a geom
    within the footprint, or runs inside of a geom there, the cell is occupied. Otherwise each geom
    nearby is tested; if rounding leaves open whether it meets the footprint, FCL decides. A geom
    that reaches in by less than TOUCH_DEPTH does not meet it.

    Args:
        columns: the geoms' hits on the vertical line through each cell's centre.
        tiled: the geoms near the cells, on the same lattice.
        footprint: the volume over a floor that has to be free.
        cells: cell ids, shape (n,), int64, in any order; a cell may be repeated.
        floors: height of each cell's floor, shape (n,), float64 [m].
        lists: settings for the lists of occupants, and arrays that receive where they begin;
            `cells` then have to be ascending. NO_LISTS to list none.

    Returns:
        The occupancy of each cell, shape (n,), and the lists of occupants.
    """
    if len(cells) and np.any(cells[1:] < cells[:-1]):  # the kernel goes tile by tile
        order = np.argsort(cells, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        in_order = check_occupancy(columns, tiled, footprint, cells[order], floors[order])
        return in_order._replace(
            occupied=in_order.occupied[place],
            square_occupied=in_order.square_occupied[place],
        )
    lattice = columns.lattice
    shapes = tiled.shapes
    shape_arrays = ShapeArrays(shapes.solids, tiled.facets, shapes.planes)
    cells = cells.astype(np.int64, copy=False)
    query_flags = np.zeros(len(cells), dtype=np.uint8)
    queries = Queries(
        cell=cells,
        floor=np.ascontiguousarray(floors),
        flags=query_flags,
        tested_flags=np.zeros(len(cells), dtype=np.uint8),
        geom_flags=np.zeros(len(cells), dtype=np.uint8),
    )
    lists_by_row: dict[int, tuple[Int32, NDArray[np.uint8]]] = {}

    def check_rows(first: int, end: int) -> None:
        geom, flags, used = check_tiles(
            lattice,
            columns.hits,
            shape_arrays,
            tiled.tile_index,
            footprint,
            queries,
            lists,
            first,
            end,
        )
        lists_by_row[first] = geom[:used], flags[:used]

    if len(cells):
        first_row, last_row = (cells[[0, -1]] // lattice.width // TILE).tolist()
        run_in_chunks(check_rows, last_row - first_row + 1, begin=first_row)
    geom, flags = _join_lists(lists_by_row, lists.first, cells, lattice)

    occupied = (query_flags & BLOCKING) > 0
    is_undecided = ~occupied & ((query_flags & MAYBE_BLOCKING) > 0)
    for n in np.flatnonzero(is_undecided):
        occupied[n] = _fcl_finds_overlap(tiled, footprint, int(cells[n]), float(floors[n]))
    square_occupied = occupied
    if footprint.radius > 0:
        square_occupied = (query_flags & BLOCKING_SQUARE) > 0
        square = footprint._replace(square=lattice.cell_size / 2 - TOUCH_DEPTH, radius=0.0)
        is_undecided = occupied & ~square_occupied & ((query_flags & MAYBE_BLOCKING_SQUARE) > 0)
        for n in np.flatnonzero(is_undecided):
            square_occupied[n] = _fcl_finds_overlap(tiled, square, int(cells[n]), float(floors[n]))
        square_occupied &= occupied
    if len(lists.first):
        # FCL has decided about the cell, not about a geom: all geoms that may block an occupied
        # cell count as blocking it
        for n in np.flatnonzero(occupied & ((query_flags & MAYBE_BLOCKING) > 0)):
            i = lists.first[n]
            while geom[i] >= 0:
                if flags[i] & MAYBE_BLOCKING:
                    flags[i] |= BLOCKING
                i += 1
        flags &= ~np.uint8(MAYBE_BLOCKING)
    return CellOccupancy(occupied, square_occupied, geom, flags)


def _join_lists(
    lists_by_row: dict[int, tuple[Int32, NDArray[np.uint8]]],
    first_entry: Int32,
    cells: Int,
    lattice: Lattice,
) -> tuple[Int32, NDArray[np.uint8]]:
    """Join the lists of the geoms in each cell that several calls of `check_tiles` made.

    Args:
        lists_by_row: first row of tiles of a call -> geom ids and flags that the call listed.
        first_entry: for each cell, where its list begins in the lists of its call; changed to where
            it begins in the joined lists. Empty if nothing is listed.
        cells: the cells, ascending.
        lattice: the lattice.

    Returns:
        Geom ids and flags of all lists.
    """
    if not lists_by_row:
        return np.full(1, -1, dtype=np.int32), np.zeros(1, dtype=np.uint8)
    first_rows = sorted(lists_by_row)
    if len(first_entry):
        row_cells = [row * TILE * lattice.width for row in first_rows[1:]]
        num_entries = 0
        first_by_row = np.split(first_entry, np.searchsorted(cells, row_cells))
        for row, first in zip(first_rows, first_by_row, strict=True):
            first += num_entries  # a view: `first_entry` changes
            geom, _ = lists_by_row[row]
            num_entries += len(geom)
    if len(first_rows) == 1:
        return lists_by_row[first_rows[0]]
    geom = np.concatenate([lists_by_row[row][0] for row in first_rows])
    flags = np.concatenate([lists_by_row[row][1] for row in first_rows])
    return geom, flags


def _fcl_finds_overlap(tiled: TiledShapes, footprint: Footprint, cell: int, floor: float) -> bool:
    """Return whether FCL finds that a solid meets the footprint over the floor of a cell.

    Args:
        tiled: the geoms near the cell; of these, the primitives (solids) are tested.
        footprint: the volume over a floor that has to be free.
        cell: id of the cell.
        floor: height of its floor [m].
    """
    lattice = tiled.lattice
    tiles = tiled.tile_index
    solids = tiled.shapes.solids
    tile = tile_of(lattice, cell)
    half_height = (footprint.high - footprint.low) / 2
    x, y = lattice.positions(*divmod(cell, lattice.width))
    center = np.array([x, y, floor + (footprint.low + footprint.high) / 2])
    prisms = []
    if footprint.square > 0:
        prisms.append(fcl.Box(2 * footprint.square, 2 * footprint.square, 2 * half_height))
    if footprint.radius > 0:
        prisms.append(fcl.Cylinder(footprint.radius, 2 * half_height))
    footprint_objects = [fcl.CollisionObject(prism, fcl.Transform(center)) for prism in prisms]
    for solid in tiles.solid_item[tiles.solid_start[tile] : tiles.solid_start[tile + 1]]:
        shape = FCL_SHAPES[int(solids.kind[solid])](solids.size[solid])
        pose = fcl.Transform(solids.mat[solid].reshape(3, 3), solids.pos[solid])
        solid_object = fcl.CollisionObject(shape, pose)
        if any(fcl.collide(prism, solid_object) > 0 for prism in footprint_objects):
            return True
    return False
