"""Decides which cells are occupied: where a geom meets the agent's footprint over the floor.

The footprint is an upright prism, from the highest step to the agent's height above the floor, see
`Footprint`. `check_occupancy` checks any cells; `check_level_occupancy` those of all levels, and
lists the geoms over their floors: first of structure, then of movables, see
`navbake.baker.occupants`.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import Columns, TiledShapes, tile_of
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.components import expand_ranges
from navbake.baker.core.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE
from navbake.baker.core.limits import make_agent_limits
from navbake.baker.core.tiles import TILE
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.baker.floors.levels import Floors
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
from navbake.config.settings import AgentSettings
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
# Heights over a floor at which walls are, but neither sills nor most furniture [m]
WALL_HEIGHTS = HeightRange(1.5, 1.8)
# The last level ends this far above its floors [m]
TOP_LEVEL_HEIGHT = 100.0
NO_OCCUPANT_LISTS = OccupantLists(
    ceiling=np.empty(0),
    list_start=np.empty(0, np.int32),
    floor_geom=np.empty(0, np.int32),
    gap_below=np.empty(0),
    is_wall_candidate=np.empty(0, np.bool_),
    wall_low=0.0,
    wall_high=0.0,
    min_normal_z=0.0,
)
"""The value of `occupant_lists` for which `check_occupancy` lists no occupants."""


class StructureOccupancy(NamedTuple):
    """The cells that structure occupies; movables and doors are not included.

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
        flags: for each entry of `geom`, bits that say which volumes over the cell's floor the geom
            meets, see `volume_kernels`, uint8.
    """

    occupied: Bool
    square_occupied: Bool
    geom: Int32
    flags: NDArray[np.uint8]


def check_occupancy(
    columns: Columns,
    tiled_shapes: TiledShapes,
    footprint: Footprint,
    cells: Int,
    floors: Float,
    occupant_lists: OccupantLists = NO_OCCUPANT_LISTS,
) -> CellOccupancy:
    """Check which cells are occupied: those where a geom meets the footprint over the floor.

    The footprint is an upright prism over the cell's square and the agent's disc, usually from the
    highest step to the agent's height above the floor. If the cell's vertical line crosses a geom
    within the footprint, or runs inside of a geom there, the cell is occupied. Otherwise each geom
    nearby is tested; if rounding leaves open whether it meets the footprint, FCL decides. A geom
    that reaches in by less than TOUCH_DEPTH does not meet it.

    Args:
        columns: the geoms' hits on the vertical line through each cell's centre.
        tiled_shapes: the geoms near the cells, on the same lattice.
        footprint: the volume over a floor that has to be free.
        cells: cell ids, shape (n,), int64, in any order; a cell may be repeated.
        floors: height of each cell's floor, shape (n,), float64 [m].
        occupant_lists: settings for the lists of occupants, and arrays that receive where they
            begin; `cells`, and the floors in each of them, then have to be ascending.
            NO_OCCUPANT_LISTS to list none.

    Returns:
        The occupancy of each cell, shape (n,), and the lists of occupants.
    """
    # the kernel goes tile by tile, and bisects the floors of a cell
    if not _are_ascending(cells, floors):
        sort_indices = np.lexsort((floors, cells))
        place_in_order = np.empty_like(sort_indices)
        place_in_order[sort_indices] = np.arange(len(sort_indices))
        sorted_occupancy = check_occupancy(
            columns, tiled_shapes, footprint, cells[sort_indices], floors[sort_indices]
        )
        return sorted_occupancy._replace(
            occupied=sorted_occupancy.occupied[place_in_order],
            square_occupied=sorted_occupancy.square_occupied[place_in_order],
        )
    lattice = columns.lattice
    shapes = tiled_shapes.shapes
    shape_arrays = ShapeArrays(shapes.solids, tiled_shapes.facets, shapes.planes)
    cells = cells.astype(np.int64, copy=False)
    query_flags = np.zeros(len(cells), dtype=np.uint8)
    queries = Queries(
        cell=cells,
        floor=np.ascontiguousarray(floors),
        highest_prism_z=np.empty(len(cells)),
        flags=query_flags,
        tested_flags=np.zeros(len(cells), dtype=np.uint8),
        geom_flags=np.zeros(len(cells), dtype=np.uint8),
    )
    lists_by_tile_row: dict[int, tuple[Int32, NDArray[np.uint8]]] = {}

    def check_rows(first_row: int, end_row: int) -> None:
        geom, flags, num_entries = check_tiles(
            lattice,
            columns.hits,
            shape_arrays,
            tiled_shapes.tile_index,
            footprint,
            queries,
            occupant_lists,
            first_row,
            end_row,
        )
        lists_by_tile_row[first_row] = geom[:num_entries], flags[:num_entries]

    if len(cells):
        first_tile_row, last_tile_row = (cells[[0, -1]] // lattice.width // TILE).tolist()
        run_in_chunks(check_rows, last_tile_row - first_tile_row + 1, begin=first_tile_row)
    geom, flags = _join_lists(lists_by_tile_row, occupant_lists.list_start, cells, lattice)

    occupied = (query_flags & BLOCKING) > 0
    is_undecided = ~occupied & ((query_flags & MAYBE_BLOCKING) > 0)
    for query in np.flatnonzero(is_undecided):
        occupied[query] = _fcl_finds_overlap(
            tiled_shapes, footprint, int(cells[query]), float(floors[query])
        )
    square_occupied = occupied
    if footprint.radius > 0:
        square_occupied = (query_flags & BLOCKING_SQUARE) > 0
        square_footprint = footprint._replace(
            half_square=lattice.cell_size / 2 - TOUCH_DEPTH, radius=0.0
        )
        is_undecided = occupied & ~square_occupied & ((query_flags & MAYBE_BLOCKING_SQUARE) > 0)
        for query in np.flatnonzero(is_undecided):
            square_occupied[query] = _fcl_finds_overlap(
                tiled_shapes, square_footprint, int(cells[query]), float(floors[query])
            )
        square_occupied &= occupied
    if len(occupant_lists.list_start):
        # FCL has decided about the cell, not about a geom: all geoms that may block an occupied
        # cell count as blocking it
        for query in np.flatnonzero(occupied & ((query_flags & MAYBE_BLOCKING) > 0)):
            entry = occupant_lists.list_start[query]
            while geom[entry] >= 0:
                if flags[entry] & MAYBE_BLOCKING:
                    flags[entry] |= BLOCKING
                entry += 1
        flags &= ~np.uint8(MAYBE_BLOCKING)
    return CellOccupancy(occupied, square_occupied, geom, flags)


def _are_ascending(cells: Int, floors: Float) -> bool:
    """Return whether cells ascend, and so do the floors of a cell that is listed several times.

    Args:
        cells: cell ids, shape (n,).
        floors: the height of a floor in each cell, shape (n,) [m].
    """
    # where the next cell is no higher; most are higher, so that few floors have to be compared
    indices = np.flatnonzero(cells[1:] <= cells[:-1])
    if not len(indices):
        return True
    is_same_cell = cells[indices + 1] == cells[indices]
    is_next_floor_lower = floors[indices + 1] < floors[indices]
    return bool(np.all(is_same_cell & ~is_next_floor_lower))


def _join_lists(
    lists_by_tile_row: dict[int, tuple[Int32, NDArray[np.uint8]]],
    list_start: Int32,
    cells: Int,
    lattice: Lattice,
) -> tuple[Int32, NDArray[np.uint8]]:
    """Join the lists of the geoms in each cell that several calls of `check_tiles` made.

    Args:
        lists_by_tile_row: first row of tiles of a call -> geom ids and flags that the call listed.
        list_start: for each cell, where its list begins in the lists of its call; changed to where
            it begins in the joined lists. Empty if nothing is listed.
        cells: the cells, ascending.
        lattice: the lattice.

    Returns:
        Geom ids and flags of all lists.
    """
    if not lists_by_tile_row:
        return np.full(1, -1, dtype=np.int32), np.zeros(1, dtype=np.uint8)
    first_tile_rows = sorted(lists_by_tile_row)
    if len(first_tile_rows) == 1:
        return lists_by_tile_row[first_tile_rows[0]]
    if len(list_start):
        first_cells = [tile_row * TILE * lattice.width for tile_row in first_tile_rows[1:]]
        num_entries = 0
        starts_by_tile_row = np.split(list_start, np.searchsorted(cells, first_cells))
        for tile_row, list_starts in zip(first_tile_rows, starts_by_tile_row, strict=True):
            list_starts += num_entries  # a view: this changes `list_start`
            geom, _ = lists_by_tile_row[tile_row]
            num_entries += len(geom)
    geom = np.concatenate([lists_by_tile_row[tile_row][0] for tile_row in first_tile_rows])
    flags = np.concatenate([lists_by_tile_row[tile_row][1] for tile_row in first_tile_rows])
    return geom, flags


def _fcl_finds_overlap(
    tiled_shapes: TiledShapes, footprint: Footprint, cell: int, floor: float
) -> bool:
    """Return whether FCL finds that a solid meets the footprint over the floor of a cell.

    Args:
        tiled_shapes: the geoms near the cell; of these, the primitives (solids) are tested.
        footprint: the volume over a floor that has to be free.
        cell: id of the cell.
        floor: height of its floor [m].
    """
    lattice = tiled_shapes.lattice
    tile_index = tiled_shapes.tile_index
    solids = tiled_shapes.shapes.solids
    tile = tile_of(lattice, cell)
    half_height = (footprint.high - footprint.low) / 2
    x, y = lattice.positions(*divmod(cell, lattice.width))
    center = np.array([x, y, floor + (footprint.low + footprint.high) / 2])
    prisms = []
    if footprint.half_square > 0:
        prisms.append(
            fcl.Box(2 * footprint.half_square, 2 * footprint.half_square, 2 * half_height)
        )
    if footprint.radius > 0:
        prisms.append(fcl.Cylinder(footprint.radius, 2 * half_height))
    footprint_objects = [fcl.CollisionObject(prism, fcl.Transform(center)) for prism in prisms]
    for solid in tile_index.solid_indices[
        tile_index.solid_start[tile] : tile_index.solid_start[tile + 1]
    ]:
        fcl_shape = FCL_SHAPES[int(solids.kind[solid])](solids.size[solid])
        pose = fcl.Transform(solids.mat[solid].reshape(3, 3), solids.pos[solid])
        solid_object = fcl.CollisionObject(fcl_shape, pose)
        if any(fcl.collide(prism, solid_object) > 0 for prism in footprint_objects):
            return True
    return False


# ---------------------------------------------------------------- all levels


class LevelOccupancy(NamedTuple):
    """The occupancy of some cells of a level, and the lists of the geoms in them.

    Attributes:
        cells: ids of the checked cells that have a floor, shape (n,).
        occupancy: the occupancy of these cells.
        occupant_lists: where the list of each cell's geoms begins in `occupancy.geom`; all arrays
            are empty if no lists were requested.
    """

    cells: Int
    occupancy: CellOccupancy
    occupant_lists: OccupantLists


def find_level_ceilings(floors: Floors) -> list[float]:
    """Return the height at which each level ends: the next level's ground, inf for the last [m]."""
    return [*(level.ground for level in floors.levels[1:]), np.inf]


def check_level_occupancy(
    columns: Columns,
    tiled_shapes: TiledShapes,
    footprint: Footprint,
    cells: Int,
    floors: Floors,
    agent: AgentSettings,
    wall_candidates: Bool | None,
) -> list[LevelOccupancy]:
    """Check which cells of each level are occupied by geoms, and list the geoms in each cell.

    All levels are checked in one pass over the geoms.

    Args:
        columns: the geoms' hits on the vertical line through each cell's centre.
        tiled_shapes: the geoms near the cells.
        footprint: the volume over a floor that has to be free.
        cells: cell ids, ascending.
        floors: the floors of all levels.
        agent: the agent; its height and largest slope are read.
        wall_candidates: mask by geom id of the geoms that are tested for AT_WALL_HEIGHT, bool; None
            to list no occupants.

    Returns:
        For each level, its cells that have a floor, their occupancy, and the lists of their
        occupants. All levels' lists are in the same arrays.
    """
    # the floors of all levels, one level after the other
    cells_by_level = []
    heights_by_level = []
    ceilings_by_level = []
    for level, level_ceiling in zip(floors.levels, find_level_ceilings(floors), strict=True):
        level_heights = level.floor.ravel()[cells]
        has_floor = ~np.isnan(level_heights)
        level_heights = level_heights[has_floor]
        cells_by_level.append(cells[has_floor])
        heights_by_level.append(level_heights)
        if wall_candidates is not None:
            ceilings = level_heights + TOP_LEVEL_HEIGHT
            np.minimum(ceilings, level_ceiling, out=ceilings)
            np.maximum(ceilings, level_heights + agent.height, out=ceilings)
            ceilings -= TOUCH_DEPTH
            ceilings_by_level.append(ceilings)
    num_floors = [len(level_cells) for level_cells in cells_by_level]
    floor_cells = np.concatenate(cells_by_level)
    floor_heights = np.concatenate(heights_by_level)
    # in ascending order of cells, and of heights in a cell, for the check
    order: Int | slice = slice(None)
    place_in_order: Int | slice = slice(None)
    if len(floors.levels) > 1:
        # a stable sort merges the levels, whose cells ascend, and their floors mostly do
        order = np.argsort(floor_cells, kind="stable")
        if not _are_ascending(floor_cells[order], floor_heights[order]):
            order = np.lexsort((floor_heights, floor_cells))
        place_in_order = np.empty_like(order)
        place_in_order[order] = np.arange(len(order))
    floor_cells = floor_cells[order]
    floor_heights = floor_heights[order]
    occupant_lists = NO_OCCUPANT_LISTS
    if wall_candidates is not None:
        occupant_lists = OccupantLists(
            ceiling=np.concatenate(ceilings_by_level)[order],
            list_start=np.empty(len(floor_cells), dtype=np.int32),
            floor_geom=np.empty(len(floor_cells), dtype=np.int32),
            gap_below=np.empty(len(floor_cells)),
            is_wall_candidate=wall_candidates,
            wall_low=WALL_HEIGHTS.low + TOUCH_DEPTH,
            wall_high=WALL_HEIGHTS.high - TOUCH_DEPTH,
            min_normal_z=make_agent_limits(agent).min_normal_z,
        )
    occupancy = check_occupancy(
        columns, tiled_shapes, footprint, floor_cells, floor_heights, occupant_lists
    )
    # one level after the other again
    occupied = occupancy.occupied[place_in_order]
    square_occupied = occupancy.square_occupied[place_in_order]
    occupant_lists = _select_lists(occupant_lists, place_in_order)
    occupancy_by_level = []
    first_floors = accumulate(num_floors, initial=0)
    for level_cells, (first_floor, end_floor) in zip(
        cells_by_level, pairwise(first_floors), strict=True
    ):
        level_floors = slice(first_floor, end_floor)
        cell_occupancy = occupancy._replace(
            occupied=occupied[level_floors], square_occupied=square_occupied[level_floors]
        )
        level_lists = _select_lists(occupant_lists, level_floors)
        occupancy_by_level.append(LevelOccupancy(level_cells, cell_occupancy, level_lists))
    return occupancy_by_level


def _select_lists(occupant_lists: OccupantLists, selected: Int | slice) -> OccupantLists:
    """Return the lists of some cells, by their indices; without lists, what is given.

    Args:
        occupant_lists: the lists of all cells, or `NO_OCCUPANT_LISTS`.
        selected: indices of cells, shape (n,), or a slice.
    """
    if occupant_lists is NO_OCCUPANT_LISTS:
        return occupant_lists
    return occupant_lists._replace(
        ceiling=occupant_lists.ceiling[selected],
        list_start=occupant_lists.list_start[selected],
        floor_geom=occupant_lists.floor_geom[selected],
        gap_below=occupant_lists.gap_below[selected],
    )


def select_list_entries(
    list_starts: Int32, geom: Int32, flags: NDArray[np.uint8], cells: Int
) -> tuple[Int, Int32, NDArray[np.uint8]]:
    """Return the geoms that are listed for some cells, ordered by cell and then geom.

    Args:
        list_starts: by cell id, the index into `geom` at which the cell's list begins. The list
            ends before the next -1 in `geom`.
        geom: geom ids of all lists, one list after the other.
        flags: the flags of each entry of `geom`.
        cells: cell ids, shape (n,).

    Returns:
        For each pair of a cell and a geom in it: the index of the cell in `cells`, the geom's id,
        and its flags.
    """
    first_entries = list_starts[cells]
    list_lengths = np.zeros(len(cells), dtype=np.int64)
    unfinished_lists = np.flatnonzero(geom[first_entries] >= 0)
    while len(unfinished_lists):  # cells whose lists go on
        list_lengths[unfinished_lists] += 1
        next_geom = geom[first_entries[unfinished_lists] + list_lengths[unfinished_lists]]
        unfinished_lists = unfinished_lists[next_geom >= 0]
    cell_index, entry_index = expand_ranges(first_entries, first_entries + list_lengths)
    return cell_index, geom[entry_index], flags[entry_index]
