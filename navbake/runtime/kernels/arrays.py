"""The arrays that the kernels of the run time take, and how a cell is found in them.

The cells of all levels stand in one row: the flat id of a cell is ``start[level] + row *
width[level] + col``. "By cell" means: one entry for each flat id.

Looking an array up in a tuple counts a reference, which costs more than a step of a search. So
kernels with a hot loop take the arrays out of their tuples first and hand them on one by one.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import part
from navbake.types import Bool, Float, Int, Int32

EDGE = 1e-6  # of a cell: how far inside of its edges a point is put
DIAGONAL = math.sqrt(2.0)  # length of a diagonal step, in cells
# Directions: east, north, west, south, then north-east, north-west, south-west, south-east. North
# is row - 1. Bit d of a cell's moves is set where a step leads that way.
EAST, NORTH, WEST, SOUTH = 1, 2, 4, 8
SOUTH_WEST, SOUTH_EAST = 64, 128
ROW_STEP = np.array([0, -1, 0, 1, -1, -1, 1, 1])
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1])


class Layout(NamedTuple):
    """Where the cells of each level lie; rows run towards smaller y.

    Attributes:
        start: first flat id of each level, and one past the last, shape (num_levels + 1,).
        width, height: number of columns and of rows, by level.
        x_min, y_max: outer corner of cell (0, 0), by level, world [m].
        cell_size: edge of a cell, by level [m]; levels of other programs' files may differ.
    """

    start: Int
    width: Int
    height: Int
    x_min: Float
    y_max: Float
    cell_size: Float


class Links(NamedTuple):
    """Steps between cells that are not neighbours on one level; each is listed both ways.

    Attributes:
        cell: flat ids of the cells that links lead from, shape (m,), ascending, each once.
        start: shape (m + 1,): from ``cell[i]``, links lead to ``target[start[i]:start[i + 1]]``.
        target: flat ids, ascending for each cell.
        length: of each link [m], as `target`.
    """

    cell: Int
    start: Int
    target: Int
    length: Float


class Floors(NamedTuple):
    """The heights of floors, world z [m].

    Attributes:
        z: by cell, NaN where there is no floor; the ground on a level whose file has no heights.
        ground: by level: the floor of free cells that have none of their own.
        max_step: by how much the floors of neighbours may differ, slack included; see
            `navbake.navgrid.islands.step_limit`. Any step to or from a cell without floor is flat.
    """

    z: Float
    ground: Float
    max_step: float


class Space(NamedTuple):
    """What a straight line may run through.

    Attributes:
        floors: with a `max_step` of infinity, heights are not compared.
        passable: by cell.
    """

    layout: Layout
    links: Links
    floors: Floors
    passable: Bool


class Graph(NamedTuple):
    """The steps of an agent and what they cost: the length [m] times the target's weight.

    Attributes:
        moves: by cell, a bit for each direction, see `navbake.runtime.kernels.routes`.
        weight: by cell, inf where it isn't free.
        same_weight: the weight of all free cells, 0 where they differ.
        least_weight: the smallest weight of a free cell, >= 0.
        bucket, num_buckets: of the queue, see `navbake.runtime.kernels.routes`.
    """

    layout: Layout
    links: Links
    moves: NDArray[np.uint8]
    weight: Float
    same_weight: float
    least_weight: float
    bucket: float
    num_buckets: int


class OffCenter(NamedTuple):
    """Where an agent of a radius may be off the centres of cells.

    Attributes:
        anywhere: by cell: free, wherever in the cell the agent is.
        by_squares: by cell: so, or free and in the way of nothing but solid squares of its own
            level, so that a sweep of the disc decides.
        solid_before: see `navbake.runtime.kernels.lines.disc_passes`.
        radius: of the agent [m]; 0 if only free cells count.
        is_closed: whether all beyond a level's cells is solid.
    """

    anywhere: Bool
    by_squares: Bool
    solid_before: Int32
    radius: float
    is_closed: bool


class Entries(NamedTuple):
    """Memory for the entries of a queue, see `navbake.runtime.kernels.routes`; of one length."""

    cell: Int32
    next: Int32


class Visits(NamedTuple):
    """How a search reached the cells; kept from search to search, so that none has to clear it.

    Attributes:
        mark: by cell, see `navbake.runtime.kernels.routes`.
        cost: by cell, valid where `mark` is of this search.
        link_from: by index in ``links.cell``: where the link that was taken leads from.
    """

    mark: Int32
    cost: Float
    link_from: Int


class Line(NamedTuple):
    """A line over cells, seen from above.

    Attributes:
        points: world x, y [m], shape (n, 2), each in a cell of its level.
        levels: of the points, shape (n,).
        is_link: whether a link leads from a point to the next, shape (n - 1,).
    """

    points: Float
    levels: Int
    is_link: Bool


class Rect(NamedTuple):
    """The cells of one level: the first one's flat id, and how many columns and rows there are."""

    first: int
    width: int
    height: int


@part
def level_of(start, cell):
    """The level of a flat id."""
    level = 0
    while cell >= start[level + 1]:  # levels are few, so that no search is faster
        level += 1
    return level


@part
def rect_of(layout, level):
    """The cells of a level."""
    return Rect(layout.start[level], layout.width[level], layout.height[level])


@part
def find_slot(link_cell, cell):
    """Where a cell is in ``links.cell``, by binary search; -1 if no link leads from it."""
    low, high = 0, link_cell.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if link_cell[middle] < cell:
            low = middle + 1
        else:
            high = middle
    return low if low < link_cell.shape[0] and link_cell[low] == cell else -1


@part
def center(layout, cell):
    """World x, y of a cell's centre [m]."""
    level = level_of(layout.start, cell)
    row, col = divmod(cell - layout.start[level], layout.width[level])
    size = layout.cell_size[level]
    return layout.x_min[level] + (col + 0.5) * size, layout.y_max[level] - (row + 0.5) * size


@part
def floor_at(floors, level, cell):
    """World z of a cell's floor, or of the level's ground where it has none [m]."""
    z = floors.z[cell]
    return floors.ground[level] if math.isnan(z) else z


@part
def put_into(layout, cell, x, y):
    """The point of a cell's square nearest to x, y, EDGE inside of its edges."""
    middle_x, middle_y = center(layout, cell)
    half = (0.5 - EDGE) * layout.cell_size[level_of(layout.start, cell)]
    x = min(max(x, middle_x - half), middle_x + half)
    return x, min(max(y, middle_y - half), middle_y + half)


@part
def in_cells(layout, level, x, y):
    """A world position [m] in a level's own units: u in columns, v in rows, from its corner."""
    size = layout.cell_size[level]
    return (x - layout.x_min[level]) / size, (layout.y_max[level] - y) / size
