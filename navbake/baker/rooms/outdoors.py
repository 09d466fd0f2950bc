"""What is open: floor under the sky up to the edge of the grid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.connect import connect, touching
from navbake.baker.contents.walls import WALL_BAND
from navbake.baker.floors.sheets import agent_limits
from navbake.baker.kernels.constants import SAME, SLACK
from navbake.baker.lattice import EDGES
from navbake.baker.rooms.distances import squared_distances
from navbake.baker.rooms.kernels.labels import label_parts
from navbake.baker.rooms.overhead import Overhead
from navbake.baker.rooms.spaces import WIDEST
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Int32

# What is outdoors reaches the edge over more than this in one piece: no opening in a wall at the
# edge is so wide [m]
EDGE_LENGTH = WIDEST
# What is no further from the edge lies under eaves, if it isn't under the sky [m]
EAVES = 1.2
# Outdoors, at least this share of the floor is under the sky or under eaves
OPEN_SHARE = 0.5
# The scene goes on beyond the lattice where it does so by more than this share of a cell
BEYOND = 0.5


class Outdoors(NamedTuple):
    """The segments of a level, and which of them are outdoors.

    Attributes:
        segment: of each cell; those that are outdoors and touch have the least number of all.
        outdoors: the numbers of those that are outdoors.
        asked_sky: whether it was asked above which cells there is nothing but the sky.
    """

    segment: Int32
    outdoors: set[int]
    asked_sky: bool


def find_edge(open_cells: Bool, floor: Float, overhead: Overhead, agent: AgentSettings) -> Bool:
    """Mark the open cells of a level at the edge of the grid, or at what lies before it.

    That is floor beyond which there is nothing up to that edge, or ground that is too steep to
    stand on, such as the bank of a ditch. Walls and pillars are left out.
    """
    is_empty = np.isnan(overhead.top).reshape(floor.shape)
    steep = _is_steep(floor, overhead, agent)
    edge = _edge_cells(is_empty | steep, np.ones((2, 2), dtype=np.bool_)) & open_cells
    cell = np.flatnonzero(edge)
    edge[edge] = ~_is_under_top(cell, floor, overhead.columns.at(cell))
    return edge


def find_outdoors(
    segment: Int32, edge: Bool, floor: Float, overhead: Overhead, agent: AgentSettings, scene: Scene
) -> Outdoors:
    """Find the segments of a level that are outdoors, and unite those that touch.

    They reach the edge of the grid in one piece that is wider than any door; and at least half of
    their cells have nothing above an agent's head, or lie under eaves, 1.2 m from where the scene
    ends at most. What walls enclose is a room, with a ceiling or without one: a gap parts it from
    what is outdoors, and doors at the edge are too narrow. Walls part two pieces of outdoors, too;
    a ditch does not, nor what stands on endless ground, because one walks round it.

    Args:
        segment: the segment of each cell, 0 for none.
        edge: the cells at the edge, of the same shape, see `find_edge`.
        floor: heights of the floor, of the same shape, NaN for none [m].
        scene: with its bounds, and ground that goes on beyond them.
    """
    lattice = overhead.columns.lattice
    count = int(segment.max(initial=0)) + 1
    steep = _is_steep(floor, overhead, agent)
    is_empty = np.isnan(overhead.top).reshape(lattice.shape)
    edge = edge & (segment > 0)
    candidates = _longest_runs(segment, edge, count) * lattice.cell_size > EDGE_LENGTH
    if not candidates.any():
        return Outdoors(segment, set(), False)
    is_candidate = candidates[segment]
    cell = np.flatnonzero(is_candidate)
    number, top = segment.ravel()[cell], overhead.top[cell]
    is_open = top <= floor.ravel()[cell] + agent.height + SLACK
    if not is_open.all() and scene.bounds is not None:
        # a window of a larger scene cuts through rooms, and they go on beyond it
        end = is_candidate & _edge_cells(is_empty, find_ends(lattice, scene.bounds))
        if end.any():
            away = squared_distances(end, int(EAVES / lattice.cell_size) + 1).ravel()[cell]
            is_open |= np.sqrt(away) * lattice.cell_size <= EAVES
    open_cells = np.bincount(number[is_open], minlength=count)
    all_cells = np.bincount(number, minlength=count)
    outdoors = candidates & (open_cells >= OPEN_SHARE * all_cells)
    united = _unite_touching(segment, outdoors, steep)
    if outdoors.any() and len(scene.shapes.planes.geom):
        united[outdoors] = united[outdoors].min()
    return Outdoors(united[segment], set(np.unique(united[outdoors]).tolist()), True)


def find_ends(lattice: Lattice, bounds: Float) -> Bool:
    """At which sides of a lattice the scene in a box ends: [[upper, lower], [left, right]]."""
    x0, y0, x1, y1 = lattice.bounds
    (low_x, low_y), (high_x, high_y) = bounds[:, :2]
    more = np.array([[high_y - y1, y0 - low_y], [x0 - low_x, high_x - x1]])
    return np.asarray(more <= BEYOND * lattice.cell_size)


def _is_under_top(cell: Int, floor: Float, columns: Columns) -> Bool:
    """Whether cells hold something that reaches above heads, such as a pillar between doors."""
    height = floor.ravel()[cell]
    start, end = columns.start[cell], columns.start[cell + 1]
    owner = np.repeat(np.arange(len(cell)), end - start)
    entry = np.arange(len(owner)) + (start - np.cumsum(end - start) + (end - start))[owner]
    below = columns.z[entry] <= height[owner] + SAME
    above = start + np.bincount(owner[below], minlength=len(cell))
    tall = above < end
    above = above[tall]
    tall[tall] = (columns.normal[above, 2] > 0) & (columns.z[above] > height[tall] + WALL_BAND[0])
    return tall


def _is_steep(floor: Float, overhead: Overhead, agent: AgentSettings) -> Bool:
    """Mark the cells without a floor that are steep ground under the sky."""
    bare = np.isnan(floor).ravel()
    up = overhead.up[bare]
    bare[bare] = (up > 0) & (up < agent_limits(agent).min_up)
    return bare.reshape(floor.shape)


def _unite_touching(segment: Int32, chosen: Bool, steep: Bool) -> Int32:
    """By segment, the least number of the chosen ones that it touches, or its own.

    Those touch, too, that steep ground lies between.
    """
    part, count = label_parts(steep)
    node = np.where(steep, part + len(chosen) - 1, segment)
    joins = np.concatenate([chosen, np.ones(count, dtype=np.bool_)])
    pairs = []
    for one, other in EDGES:
        meet = (node[one] != node[other]) & joins[node[one]] & joins[node[other]]
        pairs.append(np.stack([node[one][meet], node[other][meet]]))
    number = connect(np.concatenate(pairs, axis=1), len(joins))
    least = np.full(len(joins), len(joins), dtype=np.int32)
    np.minimum.at(least, number, np.arange(len(joins), dtype=np.int32))
    return least[number][: len(chosen)]


def _longest_runs(segment: Int32, edge: Bool, count: int) -> Float:
    """How far each segment's cells at the edge reach at most without a break [cells]."""
    rows, cols = np.nonzero(edge)
    number = segment[rows, cols]
    cell = rows * segment.shape[1] + cols
    pairs = touching(cell, segment.shape[1])
    run = connect(pairs[:, number[pairs[0]] == number[pairs[1]]], len(cell))
    reach = np.zeros(len(cell))
    for place in (rows, cols):
        low, high = np.full(len(cell), np.inf), np.full(len(cell), -np.inf)
        np.minimum.at(low, run, place)
        np.maximum.at(high, run, place)
        reach = np.hypot(reach, (high - low)[run])
    longest = np.zeros(count)
    np.maximum.at(longest, number, reach + 1)
    return longest


def _edge_cells(is_open: Bool, sides: Bool) -> Bool:
    """Cells on the edge of the lattice, or of open cells that reach it, and are not open.

    `sides` says which of the lattice's edges count: [[upper, lower], [left, right]].
    """
    shape = is_open.shape
    empty = np.zeros((shape[0] + 2, shape[1] + 2), dtype=np.bool_)
    empty[1:-1, 1:-1] = is_open
    empty[[0, -1]] |= sides[0][:, None]
    empty[:, [0, -1]] |= sides[1]
    part, _ = label_parts(empty)
    outer = np.unique(np.concatenate([part[[0, -1]].ravel(), part[:, [0, -1]].ravel()]))
    beyond = np.isin(part, outer[outer > 0])
    edge: Bool = beyond[:-2, 1:-1] | beyond[2:, 1:-1] | beyond[1:-1, :-2] | beyond[1:-1, 2:]
    return edge & ~beyond[1:-1, 1:-1]
