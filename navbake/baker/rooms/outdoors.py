"""What is open: floor under the sky up to the edge of the grid, and holes in floors."""

import numpy as np
from scipy import ndimage

from navbake.baker.columns import Columns
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings
from navbake.types import Bool, Float, Int32

# What is outdoors reaches the edge over more than this: the doorways of a wall at the edge are
# narrower [m]
EDGE_LENGTH = 2.5
# Outdoors, at least this share of the floor has nothing over it
SKY_SHARE = 0.5


def find_outdoors(segment: Int32, floor: Float, columns: Columns, height: float) -> set[int]:
    """Find the segments of a level that are outdoors.

    They reach the edge of the grid, or floor beyond which there is nothing up to that edge, over
    more than a door's width; and most of their cells have nothing above the head of an agent of
    a height [m]. What walls enclose is a room, with a ceiling or without one: a gap parts it from
    what is outdoors.

    Args:
        segment: the segment of each cell, 0 for none.
        floor: heights of the floor, of the same shape, NaN for none [m].
    """
    count = int(segment.max(initial=0)) + 1
    at_edge = np.bincount(segment[_edge_cells(columns)], minlength=count)
    candidates = at_edge * columns.lattice.cell_size > EDGE_LENGTH
    candidates[0] = False
    if not candidates.any():
        return set()
    cell = np.flatnonzero(candidates[segment.ravel()])
    number, top = segment.ravel()[cell], columns.z[columns.start[cell + 1] - 1]
    is_sky = top <= floor.ravel()[cell] + height + SLACK
    open_cells = np.bincount(number[is_sky], minlength=count)
    all_cells = np.bincount(number, minlength=count)
    return set(np.flatnonzero(candidates & (open_cells >= SKY_SHARE * all_cells)).tolist())


def _edge_cells(columns: Columns) -> Bool:
    """Cells on the edge of the lattice, or of the empty space that reaches it."""
    shape = columns.lattice.shape
    empty = np.ones((shape[0] + 2, shape[1] + 2), dtype=np.bool_)
    empty[1:-1, 1:-1] = (np.diff(columns.start) == 0).reshape(shape)
    part, _ = ndimage.label(empty)
    beyond = part == part[0, 0]
    edge = ndimage.binary_dilation(beyond)[1:-1, 1:-1]
    edge &= ~beyond[1:-1, 1:-1]
    result: Bool = edge
    return result


def find_holes(level: LevelFloor, columns: Columns, agent: AgentSettings) -> Bool:
    """Mark the cells without a floor in which nothing stands at the height of an agent's body.

    That is so where the next surface over the level's ground and a step is higher than the agent,
    unless it is the top of something.
    """
    holes = np.isnan(level.floor)
    cell = np.flatnonzero(holes)
    if not len(cell):
        return holes
    below = columns.z <= level.ground + agent.traversable_floor_height
    count = np.concatenate([[0], np.cumsum(below)])
    start, end = columns.start[cell], columns.start[cell + 1]
    following = start + count[end] - count[start]
    has_next = np.flatnonzero(following < end)
    entry = following[has_next]
    is_low = columns.z[entry] <= level.ground + agent.height
    is_top = columns.normal[entry, 2] > 0
    holes.ravel()[cell[has_next[is_low | is_top]]] = False
    return holes
