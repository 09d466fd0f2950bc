"""The arrays that the kernels of `navbake.runtime` take, and functions that look up cells in them.

The cells of all levels are numbered one after the other. The flat id of a cell is ``start[level] +
row * width[level] + col``. "By cell" means: one entry for each flat id.

Reading a field of a tuple takes longer than a step of a search. So kernels with a hot loop assign
the arrays that they need to local variables before the loop.

This module imports nothing of `navbake.runtime`, so that each module there may import it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import subkernel
from navbake.types import Bool, Float, Int, Int32

# share of a cell: how far inside the cell's edges a point is put, so that it stays inside after
# rounding
EDGE_MARGIN = 1e-6
DIAGONAL = math.sqrt(2.0)  # length of a diagonal step, in cells
# Directions 0 to 7: east, north, west, south, then north-east, north-west, south-west, south-east.
# North is row - 1. Bit d of a cell's moves is set if a step leads in direction d.
EAST = 1
NORTH = 2
WEST = 4
SOUTH = 8
SOUTH_WEST = 64
SOUTH_EAST = 128
ROW_STEP = np.array([0, -1, 0, 1, -1, -1, 1, 1])
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1])


class Layout(NamedTuple):
    """Where the cells of each level lie; rows run towards smaller y.

    Attributes:
        start: first flat id of each level, and one past the last, shape (levels + 1,).
        width: number of columns, by level.
        height: number of rows, by level.
        x_min: world x of the outer corner of cell (0, 0), by level [m].
        y_max: world y of the outer corner of cell (0, 0), by level [m].
        cell_size: edge of a cell, by level [m]; levels of other programs' files may differ.
    """

    start: Int
    width: Int
    height: Int
    x_min: Float
    y_max: Float
    cell_size: Float


class Links(NamedTuple):
    """Steps between cells that are not neighbours on one level, and passages over named links.

    From ``cell[i]``, links lead to ``target[start[i]:start[i + 1]]``. A link costs its length times
    the weight of its target, plus its cost.

    Attributes:
        cell: flat ids of all cells that links lead from or to, ascending, each once, shape (n,).
        start: index in `target` of the first link of each of `cell`, shape (n + 1,).
        target: flat ids that the links lead to, ascending for each cell, shape (m,).
        length: the length of each step [m], shape (m,); 0 for a passage.
        cost: the cost of each passage, [m] or [s], shape (m,); 0 for a step.
        is_end: by cell, whether it is one of `cell`; empty if there are no links.
    """

    cell: Int
    start: Int
    target: Int
    length: Float
    cost: Float
    is_end: Bool


class FloorHeights(NamedTuple):
    """The heights of floors, world z [m].

    A cell without a floor counts as being at the height of all its neighbours.

    Attributes:
        z: by cell, NaN for no floor; the ground on a level whose file has no heights.
        ground: by level, the floor of free cells without a floor of their own.
        max_step: largest step between neighbours [m], see `navbake.navgrid.islands.step_limit`.
    """

    z: Float
    ground: Float
    max_step: float


class Graph(NamedTuple):
    """The steps that an agent can take between cells, and their costs.

    A step costs its length [m] times the weight of the cell that it leads to. If paths are planned
    by time, weights are seconds for each metre [s/m].

    Attributes:
        layout: where the cells lie.
        links: the links that the agent may use.
        moves: by cell, a bit for each direction that a step leads in, uint8.
        weight: by cell, inf where it isn't free.
        uniform_weight: the weight of all free cells if it is the same; 0 if weights differ.
        least_weight: the smallest weight of a free cell, >= 0.
        bucket_width: costs that differ by less than this share a bucket of the search's queue, see
            `navbake.runtime.search_kernels`.
        num_buckets: number of buckets, a power of two.
        link_saving: by how much, at most, links make a route cheaper than the search's estimate
            of its cost, which ignores links; a cost, >= 0.
    """

    layout: Layout
    links: Links
    moves: NDArray[np.uint8]
    weight: Float
    uniform_weight: float
    least_weight: float
    bucket_width: float
    num_buckets: int
    link_saving: float = 0.0


class OffCenter(NamedTuple):
    """Where an agent of a given radius fits when it isn't at the centre of a cell.

    Attributes:
        anywhere: by cell, whether the agent fits at every point of the cell.
        sweepable: by cell, whether nothing but solid squares of the cell's own level can be in the
            agent's way. There, sweeping its disc over these squares decides whether it fits. True
            also where `anywhere` is.
        num_solid_before: entry i is the number of solid cells with flat ids below i, shape
            (n + 1,).
        radius: the agent's radius [m]; 0 for an agent that fits at every point of free cells.
    """

    anywhere: Bool
    sweepable: Bool
    num_solid_before: Int32
    radius: float


class Visits(NamedTuple):
    """How a search reached each cell, and memory for its queue.

    All searches write into the same arrays, one after the other. Each mark holds the number of the
    search that wrote it, so that marks of earlier searches need not be cleared.

    Attributes:
        mark: by cell, bits that `navbake.runtime.search_kernels` explains.
        cost: by cell, the cost to reach it; valid where `mark` has the number of this search.
        link_from: for each of ``links.cell`` that was reached over a link, the flat id that the
            link leads from.
        entry_cell: flat id of each entry of the queue.
        entry_next: the next entry of the same bucket, -1 for none.
    """

    mark: Int32
    cost: Float
    link_from: Int
    entry_cell: Int32
    entry_next: Int32


@subkernel
def level_of(start, cell):
    """Find the level of a cell.

    Args:
        start: `Layout.start`.
        cell: flat id.

    Returns:
        The level's number.
    """
    level = 0
    while cell >= start[level + 1]:  # levels are few, so that no search is faster
        level += 1
    return level


@subkernel
def find_link_cell_index(link_cell, cell):
    """Find the index of a cell in ``links.cell``, by binary search.

    Args:
        link_cell: the `cell` of `Links`.
        cell: flat id.

    Returns:
        The index in `link_cell`, -1 if it isn't there.
    """
    first = 0
    stop = link_cell.shape[0]
    while first < stop:
        middle = (first + stop) >> 1
        if link_cell[middle] < cell:
            first = middle + 1
        else:
            stop = middle
    return first if first < link_cell.shape[0] and link_cell[first] == cell else -1


@subkernel
def cell_center(layout, cell):
    """Compute world x, y of a cell's centre [m].

    Args:
        layout: `Layout`.
        cell: flat id.
    """
    level = level_of(layout.start, cell)
    row, col = divmod(cell - layout.start[level], layout.width[level])
    cell_size = layout.cell_size[level]
    return layout.x_min[level] + (col + 0.5) * cell_size, layout.y_max[level] - (
        row + 0.5
    ) * cell_size


@subkernel
def floor_at(floors, level, cell):
    """Return world z of a cell's floor, or of the level's ground where it has none [m].

    Args:
        floors: `FloorHeights`.
        level: the cell's level.
        cell: flat id.
    """
    z = floors.z[cell]
    return floors.ground[level] if math.isnan(z) else z


@subkernel
def clamp_to_cell(layout, cell, x, y):
    """Move a point to the nearest point of a cell's square, at least `EDGE_MARGIN` from its edges.

    Args:
        layout: `Layout`.
        cell: flat id.
        x: world x of the point [m].
        y: world y of the point [m].

    Returns:
        World x, y [m].
    """
    center_x, center_y = cell_center(layout, cell)
    half_edge = (0.5 - EDGE_MARGIN) * layout.cell_size[level_of(layout.start, cell)]
    x = min(max(x, center_x - half_edge), center_x + half_edge)
    y = min(max(y, center_y - half_edge), center_y + half_edge)
    return x, y


@subkernel
def to_cell_units(layout, level, x, y):
    """Convert a point to units of a level's cells.

    Args:
        layout: `Layout`.
        level: number of the level.
        x: world x of the point [m].
        y: world y of the point [m].

    Returns:
        u in columns and v in rows, both from the outer corner of cell (0, 0).
    """
    cell_size = layout.cell_size[level]
    col_position = (x - layout.x_min[level]) / cell_size
    row_position = (layout.y_max[level] - y) / cell_size
    return col_position, row_position
