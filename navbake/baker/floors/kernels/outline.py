"""The edges of sheets, and what lies beyond them along straight lines of cells.

Contour following cell by cell (as in Recast's region contours): an edge is one of a cell's four
sides beyond which the cell has no neighbour of its own sheet.
"""

import math

import numpy as np

from navbake.baker.floors.kernels.sheets import neighbour
from navbake.baker.kernels.constants import SLACK
from navbake.compiled import UNCOUNTED, kernel, part


@part(inline="always")
def _holds_sheet(standable, cell, sheet):
    """Whether a cell has a surface of a sheet."""
    for t in range(standable.start[cell], standable.start[cell + 1]):
        if standable.sheet[t] == sheet:
            return True
    return False


@kernel(nogil=True)
def list_edges(standable, chosen):
    """List the edges of the chosen sheets, (sheets,) bool.

    Returns the surface and the way of each edge, int64: east (0), south (1), west (2), north (3).
    """
    num = standable.z.shape[0]
    # pages of memory that nothing is written into cost nothing
    surface, way_out = np.empty(4 * num, np.int64), np.empty(4 * num, np.int64)
    count = 0
    for node in range(num):
        sheet = standable.sheet[node]
        if not chosen[sheet]:
            continue
        for way in range(4):
            other = neighbour(standable.lattice, int(standable.cell[node]), way)
            if other < 0 or not _holds_sheet(standable, other, sheet):
                surface[count], way_out[count] = node, way
                count += 1
    return surface[:count].copy(), way_out[:count].copy()


@kernel(nogil=True, **UNCOUNTED)
def look_out(standable, surface, way, step, cells, floors):
    """Look out from edges: the cells beyond each, and the floors more than a step below in them.

    Args:
        standable: all standable surfaces.
        surface, way: the edges, see `list_edges`.
        step: [m].
        cells: (edges, reach) int64; receives the cells beyond each edge, the nearest first, and
            -1 from where the lattice ends, or the sheet begins again.
        floors: (edges, reach) float64; receives the highest floor of another sheet that lies
            more than a step below the edge in each of these cells, NaN for none [m].
    """
    for e in range(surface.shape[0]):
        node = surface[e]
        sheet, limit = standable.sheet[node], standable.z[node] - step - SLACK
        cell = int(standable.cell[node])
        for k in range(cells.shape[1]):
            floors[e, k] = math.nan
            if cell >= 0:
                cell = neighbour(standable.lattice, cell, way[e])
            if cell >= 0 and _holds_sheet(standable, cell, sheet):
                cell = -1
            cells[e, k] = cell
            if cell < 0:
                continue
            for t in range(standable.start[cell], standable.start[cell + 1]):
                if standable.z[t] < limit:
                    floors[e, k] = standable.z[t]
