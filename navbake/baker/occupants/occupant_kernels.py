"""Kernels that read the lists of geoms in each cell of a level.

They measure how high geoms rise over floors, and mark the cells that walls block.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.constants import BUILDING, WALL
from navbake.baker.core.tiles import block_window
from navbake.baker.occupancy.volume_kernels import AT_WALL_HEIGHT, BLOCKING, OCCUPYING
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Bool, Float, Int32

if TYPE_CHECKING:  # kernels depend on kernels alone
    from navbake.navgrid.lattice import Lattice

# Columns of the rows of `measure_blocks`, int64. A row is about a geom in a block of cells: in how
# many cells of the block the geom ...
NUM_CELLS = 0  # is an occupant
NUM_AT_WALL_HEIGHT = 1  # is an occupant that is AT_WALL_HEIGHT
NUM_FLOORS = 2  # has the surface that is the floor
NUM_ON_FLOORS = 3  # has that surface, and lies on another geom's floor
NUM_COVERS = 4  # has that surface, and only covers another geom's floor, as a rug does
NUM_COUNTS = 5
IS_STANDABLE = 5  # 1 if an agent can stand on the geom in any cell of the block, else 0
GEOM = 6  # the geom's id
# Columns of heights of the same rows, float64 [m]
MIN_BOTTOM_HEIGHT = 0  # the least height of the geom's lower end over a floor
# The greatest height of the geom's upper end over its lower end, or over the floor if higher
MAX_RISE = 1

# Bits of `LevelOccupants.floor_flags`
ON_FLOOR = np.uint8(1)  # the geom whose surface is the floor lies on another geom's floor
COVERING = np.uint8(2)  # that geom only covers another geom's floor, as a rug does


class LevelOccupants(NamedTuple):
    """The geoms in a level's cells.

    The list of cell i begins at `geom[first[i]]`, and ends before the next -1. The arrays are not
    changed after they were filled.

    Attributes:
        lattice: the whole lattice.
        list_start: for each cell, the index in `geom` at which its list begins, shape (cells,),
            int32.
        geom: MuJoCo's geom ids, ascending within a cell, with -1 after each list, int32.
        flags: the flags of each entry of `geom`, uint8: OCCUPYING if the geom meets the cell's
            square between floor and ceiling; BLOCKING if it meets the agent's footprint;
            AT_WALL_HEIGHT if it is OCCUPYING and meets the square within `WALL_HEIGHTS`; only wall
            candidates have it.
        floor_geom: the id of the geom whose surface is the cell's floor, -1 for none, (cells,),
            int32.
        floor_flags: bits that say how the geom of `floor_geom` lies on another one: ON_FLOOR and
            COVERING; (cells,), uint8.
    """

    lattice: Lattice
    list_start: Int32
    geom: Int32
    flags: NDArray[np.uint8]
    floor_geom: Int32
    floor_flags: NDArray[np.uint8]


class FloorLayers(NamedTuple):
    """The floors of a level; arrays of shape (cells,).

    Attributes:
        height: height of the floor [m], NaN for none, float64.
        standable: whether an agent can stand on the floor, bool.
    """

    height: Float
    standable: Bool


class GeomHeights(NamedTuple):
    """Heights of all geoms, by geom id.

    Attributes:
        low: height of the lower end [m], NaN for an endless plane, float64.
        high: height of the upper end [m], NaN for an endless plane, float64.
    """

    low: Float
    high: Float


@subkernel(**NO_REFCOUNT)
def _get_row(rows, row_of_geom, first_row, num_rows, geom):
    """Return the row of a geom in the block whose rows begin at `first_row`.

    A geom that has no row in this block yet gets the next row; -1 if there is no room for it.

    Args:
        rows: counts and heights, see `measure_blocks`.
        row_of_geom: the row that each geom got last, in this block or one before; it is changed.
        first_row: the first row of the block.
        num_rows: the number of rows in use.
        geom: id of the geom.
    """
    counts, heights = rows
    row = row_of_geom[geom]
    if row < first_row:
        if num_rows == counts.shape[0]:
            return np.int64(-1)
        row = num_rows
        row_of_geom[geom] = num_rows
        counts[row, :GEOM] = 0
        counts[row, GEOM] = geom
        heights[row, MIN_BOTTOM_HEIGHT] = math.inf
        heights[row, MAX_RISE] = -math.inf
    return row


@kernel(nogil=True)
def measure_blocks(
    occupants, floors, geom_heights, blocks, num_rows_in_block, rows, first_block, end_block
):
    """Measure how high geoms rise over floors, and in how many cells their surfaces are the floor.

    It does so block by block (squares of cells). A row is written for each pair of a block and a
    geom in it. The caller is `navbake.baker.core.blocks.list_rows`.

    Args:
        occupants: the geoms in the level's cells, as `LevelOccupants`.
        floors: the floors of the level, as `FloorLayers`.
        geom_heights: heights of all geoms, as `GeomHeights`.
        blocks: ids of the blocks to measure.
        num_rows_in_block: receives the number of rows of each block.
        rows: two arrays that receive the rows: ``NUM_CELLS`` to ``GEOM``, (capacity, 7) int64; and
            ``MIN_BOTTOM_HEIGHT`` and ``MAX_RISE`` [m], (capacity, 2) float64.
        first_block: index into `blocks` of the first block that this call measures.
        end_block: index after the last of them.

    Returns:
        The index into `blocks` of the first block whose rows did not fit; `end_block` if all fit.
    """
    counts, heights = rows
    num_rows = np.int64(0)
    row_of_geom = np.full(geom_heights.low.shape[0], np.int64(-1))
    for block_index in range(first_block, end_block):
        first_row = num_rows
        first_lattice_row, end_lattice_row, first_col, end_col = block_window(
            occupants.lattice, blocks[block_index]
        )
        for lattice_row in range(first_lattice_row, end_lattice_row):
            first_cell = lattice_row * occupants.lattice.width
            for cell in range(first_cell + first_col, first_cell + end_col):
                entry = occupants.list_start[cell]
                while occupants.geom[entry] >= 0:
                    geom = occupants.geom[entry]
                    flags = np.int64(occupants.flags[entry])
                    entry += 1
                    if not flags & OCCUPYING:
                        continue
                    row = _get_row(rows, row_of_geom, first_row, num_rows, geom)
                    if row < 0:
                        return block_index
                    num_rows = max(num_rows, row + 1)
                    counts[row, NUM_CELLS] += 1
                    counts[row, NUM_AT_WALL_HEIGHT] += 1 if flags & AT_WALL_HEIGHT else 0
                    floor = floors.height[cell]
                    geom_bottom = geom_heights.low[geom]
                    geom_top = geom_heights.high[geom]
                    # no comparison holds for an endless plane, whose heights are NaN
                    if geom_bottom - floor < heights[row, MIN_BOTTOM_HEIGHT]:
                        heights[row, MIN_BOTTOM_HEIGHT] = geom_bottom - floor
                    if geom_top - max(geom_bottom, floor) > heights[row, MAX_RISE]:
                        heights[row, MAX_RISE] = geom_top - max(geom_bottom, floor)
                floor_geom = occupants.floor_geom[cell]
                floor_flags = occupants.floor_flags[cell]
                if floor_geom >= 0:
                    row = _get_row(rows, row_of_geom, first_row, num_rows, floor_geom)
                    if row < 0:
                        return block_index
                    num_rows = max(num_rows, row + 1)
                    counts[row, NUM_FLOORS] += 1
                    counts[row, NUM_ON_FLOORS] += 1 if floor_flags & ON_FLOOR else 0
                    counts[row, NUM_COVERS] += 1 if floor_flags & COVERING else 0
                    counts[row, IS_STANDABLE] |= 1 if floors.standable[cell] else 0
        num_rows_in_block[block_index] = num_rows - first_row
    return end_block


@kernel(nogil=True, **NO_REFCOUNT)
def mark_walls(occupants, kinds, cells, is_wall, is_low_wall, first_index, end_index):
    """Mark which of ``cells[first_index:end_index]`` a wall blocks, and which a low wall blocks.

    In a marked cell the wall is over the cell's square (OCCUPYING) and meets the agent's footprint
    (BLOCKING). The mesh of a whole building counts as a wall in a cell where it is AT_WALL_HEIGHT,
    else as a low wall. A cell with a building's mesh AT_WALL_HEIGHT has no low wall.

    Args:
        occupants: the geoms in the level's cells, as `LevelOccupants`.
        kinds: kinds by geom id, see `StandingOccupants`, uint8.
        cells: cell ids.
        is_wall: receives for each of `cells` whether a wall blocks it, bool.
        is_low_wall: receives for each of `cells` whether a low wall blocks it, bool.
        first_index: index into `cells` of the first cell that this call marks.
        end_index: index after the last of them.
    """
    for cell_index in range(first_index, end_index):
        entry = occupants.list_start[cells[cell_index]]
        is_wall[cell_index] = False
        is_low_wall[cell_index] = False
        has_tall_building = False
        while occupants.geom[entry] >= 0:
            geom_kind = kinds[occupants.geom[entry]]
            flags = np.int64(occupants.flags[entry])
            entry += 1
            if not flags & OCCUPYING:
                continue
            if geom_kind == BUILDING and flags & AT_WALL_HEIGHT:
                has_tall_building = True
            if flags & BLOCKING:
                is_wall[cell_index] |= geom_kind == WALL or (
                    geom_kind == BUILDING and flags & AT_WALL_HEIGHT != 0
                )
                is_low_wall[cell_index] |= geom_kind == BUILDING
        is_low_wall[cell_index] &= not has_tall_building
