"""The questions of other modules, each asked of many positions in one call from Python.

A plain loop over the kernels for one position: a call from Python costs more than most answers.
"""

from navbake.compiled import kernel
from navbake.runtime.kernels.arrays import put_into
from navbake.runtime.kernels.crossing import walk_line
from navbake.runtime.kernels.nearest import nearest_cell
from navbake.runtime.kernels.slide import slide


@kernel
def nearest_each(wanted, levels, points, farthest, cells, distances):
    """`nearest_cell` of points, shape (n, 3) [m], each on its own level within its own distance.

    Writes flat ids, -1 for none, and distances [m].
    """
    for i in range(len(points)):
        cells[i], distances[i] = nearest_cell(wanted, levels[i], points[i], farthest[i])


@kernel
def step_each(space, no_rooms, cells, ends, sliding, points):
    """Walk from points in cells straight to ends, all x, y [m], and slide on where that is asked.

    Cells and points, shape (n, 2), become those where the ways end.
    """
    layout = space.layout
    for i in range(len(points)):
        x0, y0, x1, y1 = points[i, 0], points[i, 1], ends[i, 0], ends[i, 1]
        cell, share = walk_line(space, no_rooms, cells[i], x0, y0, x1, y1)
        x, y = put_into(layout, cell, x0 + share * (x1 - x0), y0 + share * (y1 - y0))
        if share < 1.0 and sliding:
            cell, x, y = slide(space, cell, x, y, x1, y1)
        cells[i], points[i, 0], points[i, 1] = cell, x, y
