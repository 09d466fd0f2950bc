"""A bucket queue of cells by cost (Dial 1969), each bucket as wide as a share of the cheapest step.

Dial's algorithm has one bucket for each whole cost. Here costs are real numbers, so a bucket
holds a range of them and its cells come out in any order: the "untidy" priority queue of Yatziv,
Bartesaghi and Sapiro (2006). Unlike there, the answer stays exact, because a cell that gets
cheaper after it was taken out is put in again (label correcting).

The buckets are used in a circle, which is long enough for the dearest step. Each is a linked
stack; freed entries are reused, so the queue stays small, and in the processor's cache.
"""

import math

import numpy as np

from navbake.compiled import kernel, part

DIAGONAL = math.sqrt(2.0)
SHARE = 0.5  # of the cheapest step: up to 1, few cells are expanded twice
MAX_BUCKETS = 1 << 16
SPARE, USED, OPEN = 0, 1, 2  # first entry to use again, entries ever used, entries in the queue


@kernel
def bucket_width(size, least, most, longest_link):
    """Width of the buckets, and how many of them a circle needs: a power of two.

    Of the smallest edge of a cell [m], the smallest and the largest weight of free cells, and the
    longest link [m].
    """
    farthest = 2.0 * most * max(DIAGONAL * size, longest_link)  # from a bucket to a new entry
    width = max(SHARE * size * least, farthest / (MAX_BUCKETS - 4))
    if not width > 0.0:  # all steps are free of cost: one bucket holds everything
        return 1.0, 4
    count = 4
    while count < farthest / width + 3:
        count *= 2
    return width, count


@part
def make_queue(num_buckets):
    """The first entry of each bucket, int32, and the counters of an empty queue, int64."""
    return np.full(num_buckets, -1, np.int32), np.array([-1, 0, 0])


@part
def push(head, state, entry_cell, entry_next, bucket, cell):
    """Put a cell into a bucket; the caller has checked that an entry is left."""
    slot = bucket & (head.shape[0] - 1)  # the remainder, as the number is a power of two
    entry = state[SPARE]
    if entry >= 0:
        state[SPARE] = entry_next[entry]
    else:
        entry = state[USED]
        state[USED] += 1
    entry_cell[entry], entry_next[entry] = cell, head[slot]
    head[slot] = entry
    state[OPEN] += 1


@part
def pop(head, state, entry_cell, entry_next, bucket):
    """Take a cell out of a bucket; -1 if it is empty."""
    slot = bucket & (head.shape[0] - 1)
    entry = head[slot]
    if entry < 0:
        return np.int64(-1)
    head[slot] = entry_next[entry]
    entry_next[entry] = state[SPARE]
    state[SPARE] = entry
    state[OPEN] -= 1
    return np.int64(entry_cell[entry])
