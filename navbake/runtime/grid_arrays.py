"""The arrays that the kernels of the run time take, and how a cell is found in them.

The cells of all levels stand in one row: the flat id of a cell is ``start[level] + row *
width[level] + col``. "By cell" means: one entry for each flat id.

Looking an array up in a tuple costs more than a step of a search. So kernels with a hot loop take
the arrays out of their tuples first.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import subkernel
from navbake.types import Bool, Float, Int, Int32

EDGE = 1e-6  # of a cell: how far inside of its edges a point is put
DIAGONAL = math.sqrt(2.0)  # length of a diagonal step, in cells
# Directions: east, north, west, south, then north-east, north-west, south-west, south-east. North
# is row - 1. Bit d of a cell's moves is set where a step leads that way.
EAST = 1
NORTH = 2
WEST = 4
SOUTH = 8
SOUTH_WEST = 64
SOUTH_EAST = 128
ROW_STEP = np.array([0, -1, 0, 1, -1, -1, 1, 1])
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1])


class Layout(NamedTuple):
    """Where the cells of each level lie; rows run towards smaller y."""

    start: Int  # first flat id of each level, and one past the last
    width: Int  # number of columns, by level
    height: Int  # number of rows, by level
    x_min: Float  # outer corner of cell (0, 0), by level, world [m]
    y_max: Float
    cell_size: Float  # by level [m]; levels of other programs' files may differ


class Links(NamedTuple):
    """Steps between cells that are not neighbours on one level, and passages over named links.

    From ``cell[i]``, links lead to ``target[start[i]:start[i + 1]]``. A link costs its length times
    the weight of its target, plus its cost.
    """

    cell: Int  # flat ids of all cells that links lead from or to, ascending, each once
    start: Int
    target: Int  # flat ids, ascending for each cell
    length: Float  # of each step [m], as `target`; 0 of a passage
    cost: Float  # of each passage [m] or [s]; 0 of a step
    is_end: Bool  # by cell, whether it is one of `cell`; empty if there is none


class FloorHeights(NamedTuple):
    """The heights of floors, world z [m]. Any step to or from a cell without floor is flat."""

    z: Float  # by cell, NaN for no floor; the ground on a level whose file has no heights
    ground: Float  # by level: the floor of free cells that have none of their own
    max_step: float  # between neighbours, see `navbake.navgrid.islands.step_limit`


class Graph(NamedTuple):
    """The steps of an agent and what they cost: the length [m] times the target's weight.

    Planned by time, the weight is seconds for each metre.
    """

    layout: Layout
    links: Links
    moves: NDArray[np.uint8]  # by cell, a bit for each direction
    weight: Float  # by cell, inf where it isn't free
    same_weight: float  # the weight of all free cells, 0 where they differ
    least_weight: float  # the smallest weight of a free cell, >= 0
    bucket: float  # width and number of the queue's buckets, see `navbake.runtime.search_kernels`
    num_buckets: int
    # by how much links may make the way to the goals cheaper than the estimate says
    lead: float = 0.0


class OffCenter(NamedTuple):
    """Where an agent of a radius may be off the centres of cells."""

    anywhere: Bool  # by cell: free, wherever in the cell the agent is
    # by cell: so, or free and in the way of nothing but solid squares of its own level, so that a
    # sweep of the disc decides
    by_squares: Bool
    solid_before: Int32  # how many solid cells there are before each flat id, (n + 1,)
    radius: float  # of the agent [m]; 0 if only free cells count
    is_closed: bool  # whether all beyond a level's cells is solid


class Visits(NamedTuple):
    """How a search reached the cells, and memory for its queue.

    It is kept from search to search, so that none has to clear it.
    """

    mark: Int32  # by cell, see `navbake.runtime.search_kernels`
    cost: Float  # by cell, valid where `mark` is of this search
    link_from: Int  # by index in ``links.cell``: where the link that was taken leads from
    entry_cell: Int32  # of the queue's entries
    entry_next: Int32


@subkernel
def level_of(start, cell):
    """The level of a flat id."""
    level = 0
    while cell >= start[level + 1]:  # levels are few, so that no search is faster
        level += 1
    return level


@subkernel
def find_slot(link_cell, cell):
    """Where a cell is in ``links.cell``, by binary search; -1 if no link leads from it."""
    low = 0
    high = link_cell.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if link_cell[middle] < cell:
            low = middle + 1
        else:
            high = middle
    return low if low < link_cell.shape[0] and link_cell[low] == cell else -1


@subkernel
def center(layout, cell):
    """World x, y of a cell's centre [m]."""
    level = level_of(layout.start, cell)
    row, col = divmod(cell - layout.start[level], layout.width[level])
    size = layout.cell_size[level]
    return layout.x_min[level] + (col + 0.5) * size, layout.y_max[level] - (row + 0.5) * size


@subkernel
def floor_at(floors, level, cell):
    """World z of a cell's floor, or of the level's ground where it has none [m]."""
    z = floors.z[cell]
    return floors.ground[level] if math.isnan(z) else z


@subkernel
def put_into(layout, cell, x, y):
    """The point of a cell's square nearest to x, y, EDGE inside of its edges."""
    middle_x, middle_y = center(layout, cell)
    half = (0.5 - EDGE) * layout.cell_size[level_of(layout.start, cell)]
    x = min(max(x, middle_x - half), middle_x + half)
    return x, min(max(y, middle_y - half), middle_y + half)


@subkernel
def in_cells(layout, level, x, y):
    """A world position [m] in a level's own units: u in columns, v in rows, from its corner."""
    size = layout.cell_size[level]
    return (x - layout.x_min[level]) / size, (layout.y_max[level] - y) / size
