"""What is open: floor under the sky up to the edge of the grid."""

from __future__ import annotations

import numpy as np

from navbake.baker.connect import connect, label_parts, touching
from navbake.baker.lattice import EDGES
from navbake.baker.rooms.flags import RoomFlags, edge_cells
from navbake.baker.rooms.gaps import WIDEST
from navbake.baker.rooms.walls import squared_distances
from navbake.types import Bool, Float, Int32

# What is outdoors reaches the edge over more than this in one piece: no opening in a wall at the
# edge is so wide [m]
EDGE_LENGTH = WIDEST
# What is no further from the edge lies under eaves, if it isn't under the sky [m]
EAVES = 1.2
# Outdoors, at least this share of the floor is under the sky or under eaves
OPEN_SHARE = 0.5


def find_outdoors(segment: Int32, flags: RoomFlags, level: int) -> tuple[Int32, set[int]]:
    """Find the segments of a level that are outdoors, and unite those that touch.

    They reach the edge of the grid in one piece that is wider than any door; and at least half of
    their cells have nothing above an agent's head, or lie under eaves, 1.2 m from where the scene
    ends at most. What walls enclose is a room, with a ceiling or without one: a gap parts it from
    what is outdoors, and doors at the edge are too narrow. Walls part two pieces of outdoors, too;
    a ditch does not, nor what stands on endless ground, because one walks round it.

    Returns the segments of the level, of which those that are outdoors and touch have the least
    number of all; and the numbers of those that are outdoors.
    """
    own, cell_size = flags.levels[level], flags.lattice.cell_size
    count = int(segment.max(initial=0)) + 1
    candidates = _longest_runs(segment, own.edge & (segment > 0), count) * cell_size > EDGE_LENGTH
    if not candidates.any():
        return segment, set()
    asked = candidates[segment]
    is_open = own.sky[asked]
    if not is_open.all() and flags.ends.any():
        # a window of a larger scene cuts through rooms, and they go on beyond it
        end = asked & edge_cells(flags.empty, flags.ends)
        if end.any():
            away = squared_distances(end, int(EAVES / cell_size) + 1)[asked]
            is_open |= np.sqrt(away) * cell_size <= EAVES
    open_cells = np.bincount(segment[asked][is_open], minlength=count)
    all_cells = np.bincount(segment[asked], minlength=count)
    outdoors = candidates & (open_cells >= OPEN_SHARE * all_cells)
    united = _unite_touching(segment, outdoors, own.bank)
    if outdoors.any() and flags.has_ground:
        united[outdoors] = united[outdoors].min()
    return united[segment], set(np.unique(united[outdoors]).tolist())


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
    # the first node of a part is its least
    number = connect(np.concatenate(pairs, axis=1), len(joins))
    least = np.unique(number, return_index=True)[1].astype(np.int32)
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
