"""Masks into labelled parts, and labels into numbers: places, sizes, slopes and borders.

Parts are found by two-pass connected-component labelling over runs in rows (Rosenfeld and Pfaltz,
1966): the first pass gives each run a label and notes which touch, the second writes the number
of each run's part.
"""

import numpy as np

from navbake.compiled import UNCOUNTED, kernel, part
from navbake.navgrid.kernels.union_find import find_root, unite


@kernel
def label_parts(mask):
    """Label the parts of a (rows, cols) mask that hang together over edges.

    Returns int32 of the same shape, 0 outside, parts numbered by their first cells from 1; and how
    many parts there are.
    """
    rows, cols = mask.shape
    label = np.zeros((rows, cols), dtype=np.int32)
    parent = np.empty(rows * ((cols + 1) // 2) + 1, dtype=np.int32)  # of runs, from 1
    number, parts = _number_parts(parent, _label_runs(mask, label, parent))
    for row in range(rows):
        for col in range(cols):
            label[row, col] = number[label[row, col]]
    return label, parts


@part(inline="always")
def _label_runs(mask, label, parent):
    """Label the runs of each row, and join those that touch; returns how many runs there are."""
    rows, cols = mask.shape
    count = 0
    for row in range(rows):
        col = 0
        while col < cols:
            if not mask[row, col]:
                col += 1
                continue
            count += 1
            parent[count] = count
            above = 0
            while col < cols and mask[row, col]:
                label[row, col] = count
                if row > 0 and label[row - 1, col] != above:
                    above = label[row - 1, col]
                    if above > 0:
                        unite(parent, count, above)
                col += 1
    return count


@part(inline="always")
def _number_parts(parent, count):
    """The number of each run's part: a root is its first run, so it is met first."""
    number = np.zeros(count + 1, dtype=np.int32)
    parts = 0
    for run in range(1, count + 1):
        root = find_root(parent, run)
        if root == run:
            parts += 1
            number[run] = parts
        else:
            number[run] = number[root]
    return number, parts


@kernel
def cells_of_nodes(label):
    """The label of each cell's centre, or else the highest on its edges and corners.

    Labels are of nodes, (2 rows + 1, 2 cols + 1) int32; returns those of cells, (rows, cols) int32.
    """
    rows, cols = label.shape[0] // 2, label.shape[1] // 2
    cells = np.empty((rows, cols), dtype=np.int32)
    for row in range(rows):
        for col in range(cols):
            found = label[2 * row + 1, 2 * col + 1]
            if found == 0:
                for i in range(2 * row, 2 * row + 3):
                    for j in range(2 * col, 2 * col + 3):
                        found = max(found, label[i, j])
            cells[row, col] = found
    return cells


@kernel
def count_cells(label, count):
    """Count the cells of each label from 0 to ``count - 1``, int64."""
    cells = np.zeros(count, dtype=np.int64)
    for number in label.ravel():
        cells[number] += 1
    return cells


@kernel(**UNCOUNTED)
def mark_fresh(open_cells, owner, label, used):
    """Mark the labels, of (rows, cols) int32, of open cells that have no owner yet.

    `used`, bool by label, receives the marks.
    """
    for row in range(label.shape[0]):
        for col in range(label.shape[1]):
            if open_cells[row, col] and owner[row, col] == 0:
                used[label[row, col]] = True


@kernel(**UNCOUNTED)
def give_fresh(open_cells, owner, label, number):
    """Give the cells that `mark_fresh` looks at to the owner with their label's number, int32."""
    for row in range(label.shape[0]):
        for col in range(label.shape[1]):
            if open_cells[row, col] and owner[row, col] == 0:
                owner[row, col] = number[label[row, col]]


@kernel(**UNCOUNTED)
def note_under(under, label, number):
    """Write the numbers of labels where there are none yet; arrays as for `give_fresh`."""
    for row in range(label.shape[0]):
        for col in range(label.shape[1]):
            if under[row, col] == 0:
                under[row, col] = number[label[row, col]]


@kernel
def first_cells(label, count):
    """The first cell of each label from 0 to ``count - 1``; how many there are for none."""
    labels = label.ravel()
    first = np.full(count, labels.shape[0], dtype=np.int64)
    for cell in range(labels.shape[0] - 1, -1, -1):
        first[labels[cell]] = cell
    return first


@kernel
def measure_regions(label, distance, num_regions):
    """Count the cells of each label, and measure how far they are from the walls.

    Labels are of cells, (rows, cols) int32, 0 to `num_regions`, where 0 is left out; distances are
    of nodes, (2 rows + 1, 2 cols + 1) int32. Returns the number of cells, int64, the largest
    distance of a node on one of them, int32, and the sum of their centres' distances, int64, by
    label.
    """
    cells = np.zeros(num_regions + 1, dtype=np.int64)
    peaks = np.zeros(num_regions + 1, dtype=np.int32)
    sums = np.zeros(num_regions + 1, dtype=np.int64)
    rows, cols = label.shape
    for row in range(rows):
        for col in range(cols):
            region = label[row, col]
            if region == 0:
                continue
            cells[region] += 1
            sums[region] += distance[2 * row + 1, 2 * col + 1]
            for i in range(2 * row, 2 * row + 3):
                for j in range(2 * col, 2 * col + 3):
                    peaks[region] = max(peaks[region], distance[i, j])
    return cells, peaks, sums


@kernel
def measure_slopes(label, floor, reach, rise, num_regions):
    """Count the steep cells of each label, int64, and sum the floor heights of all, float64.

    A cell is steep where the floor rises by `rise` (of the two directions together) from `reach`
    cells on one side to as many on the other. What isn't there, or has no label, is taken for
    level.
    """
    steep = np.zeros(num_regions + 1, dtype=np.int64)
    heights = np.zeros(num_regions + 1, dtype=np.float64)
    rows, cols = label.shape
    for row in range(rows):
        for col in range(cols):
            region = label[row, col]
            if region == 0:
                continue
            heights[region] += floor[row, col]
            down = across = 0.0
            if reach <= row < rows - reach:
                both = label[row - reach, col] > 0 and label[row + reach, col] > 0
                down = floor[row + reach, col] - floor[row - reach, col] if both else 0.0
            if reach <= col < cols - reach:
                both = label[row, col - reach] > 0 and label[row, col + reach] > 0
                across = floor[row, col + reach] - floor[row, col - reach] if both else 0.0
            if down * down + across * across >= rise * rise:
                steep[region] += 1
    return steep, heights


@kernel
def find_passes(label, distance):
    """Find the edges between cells with different labels, none of them 0.

    Labels and distances are as for `measure_regions`. Returns the two labels, the lower one first,
    (n, 2) int64; and the largest distance of the three nodes on each edge, (n,) int32.
    """
    rows, cols = label.shape
    pairs = np.empty((0, 2), dtype=np.int64)
    saddles = np.empty(0, dtype=np.int32)
    for writing in (False, True):
        count = 0
        for row in range(rows):
            for col in range(cols):
                here = label[row, col]
                for down in range(2):
                    right = 1 - down
                    if here == 0 or row + down == rows or col + right == cols:
                        continue
                    there = label[row + down, col + right]
                    if there == 0 or there == here:
                        continue
                    if writing:
                        pairs[count, 0], pairs[count, 1] = min(here, there), max(here, there)
                        i, j = 2 * row + 1 + down, 2 * col + 1 + right
                        saddles[count] = max(
                            distance[i, j],
                            distance[i - right, j - down],
                            distance[i + right, j + down],
                        )
                    count += 1
        if not writing:
            pairs = np.empty((count, 2), dtype=np.int64)
            saddles = np.empty(count, dtype=np.int32)
    return pairs, saddles


@kernel
def sum_rooms(index, floor, center_x, center_y, num_rooms):
    """Count the cells of each room from 0 to `num_rooms`, and sum their x, y and floor height [m].

    `index` is (rows, cols), `center_x` by column, `center_y` by row. Returns four float64 arrays.
    """
    sums = np.zeros((4, num_rooms + 1), dtype=np.float64)
    for row in range(index.shape[0]):
        for col in range(index.shape[1]):
            room = index[row, col]
            if room > 0:
                sums[0, room] += 1.0
                sums[1, room] += center_x[col]
                sums[2, room] += center_y[row]
                sums[3, room] += floor[row, col]
    return sums[0], sums[1], sums[2], sums[3]
