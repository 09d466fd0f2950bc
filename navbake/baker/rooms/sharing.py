"""What marked rooms leave of the segments: whose it is."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.baker.rooms.openings import EDGES
from navbake.baker.rooms.segmentation import number_by_place
from navbake.types import Int32

# A segment belongs to the marked rooms altogether where they hold at least this share of it
MOST = 0.5


def share_rest(owner: Int32, segment: Int32, least: float) -> tuple[Int32, Int32]:
    """Share what marked rooms leave of segments.

    Where marked rooms hold most of a segment, they share the rest of it, and everywhere what is
    too small for a room; each connected part of that goes to the room that it touches most.

    Args:
        owner: the marked room of each cell, shape (height, width), int32, 0 for none.
        segment: the segment of each cell, likewise.
        least: cells that a room has at least.

    Returns:
        Owners with what they take over, and new rooms in what is left, each of the same shape.
    """
    left = np.where(owner == 0, segment, 0)
    part = _label_equal(left)
    count = int(part.max(initial=0)) + 1
    cells = np.bincount(part.ravel(), minlength=count)
    all_of = np.bincount(segment.ravel())
    held = np.bincount(segment[owner > 0].ravel(), minlength=len(all_of)) / np.maximum(all_of, 1)
    of_part = np.zeros(count, dtype=np.int32)
    of_part[part.ravel()] = left.ravel()
    touched = _most_touched(part, owner, count)
    joins = (touched > 0) & ((cells < least) | (held[of_part] >= MOST))
    is_room = ~joins & (cells >= least)
    joins[0] = is_room[0] = False
    taken = np.where(joins[part], touched[part], owner).astype(np.int32)
    return taken, number_by_place(np.where(is_room[part], part, 0).astype(np.int32))


def _label_equal(label: Int32) -> Int32:
    """Number the parts of equal labels that are connected over edges; 0 stays."""
    cells = np.flatnonzero(label)
    node = np.full(label.shape, -1, dtype=np.int64)
    node.ravel()[cells] = np.arange(len(cells))
    pairs = []
    for one, other in EDGES:
        same = (label[one] == label[other]) & (label[one] > 0)
        pairs.append(np.stack([node[one][same], node[other][same]]))
    sources, targets = np.concatenate(pairs, axis=1)
    edges = np.ones(len(sources), dtype=np.bool_), (sources, targets)
    _, number = connected_components(coo_array(edges, shape=(len(cells),) * 2), directed=False)
    part = np.zeros(label.shape, dtype=np.int32)
    part.ravel()[cells] = number + 1
    return part


def _most_touched(part: Int32, owner: Int32, count: int) -> Int32:
    """The owner that each part has most edges in common with, 0 for none; of several the first."""
    keys = []
    base = int(owner.max(initial=0)) + 1
    for one, other in EDGES:
        for a, b in ((one, other), (other, one)):
            meet = (part[a] > 0) & (owner[b] > 0)
            keys.append(part[a][meet].astype(np.int64) * base + owner[b][meet])
    key, edges = np.unique(np.concatenate(keys), return_counts=True)
    order = np.lexsort((-key, edges))  # the last one written stays
    touched = np.zeros(count, dtype=np.int32)
    touched[key[order] // base] = key[order] % base
    return touched
