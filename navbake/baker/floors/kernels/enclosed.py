"""Surfaces like floors that lie inside of closed meshes, by the winding of their column's line."""

import math

import numpy as np

from navbake.baker.floors.kernels.sheets import count_planes_over, look_up, neighbour
from navbake.baker.kernels.constants import CLOSED_SURFACE, SAME, SLACK
from navbake.baker.kernels.tiles import cell_center
from navbake.compiled import UNCOUNTED, kernel, part


@part(inline="always")
def _find_holder(crossings, i, last):
    """The geom of a closed surface that holds the i-th surface, the one that ends lowest; or -1."""
    z, normal, geom, closed = crossings.z, crossings.normal, crossings.geom, crossings.closed
    for j in range(i + 1, last):
        if closed[j] != CLOSED_SURFACE or normal[j, 2] <= 0.0 or z[j] - z[i] <= SAME:
            continue
        inside = 0
        for k in range(i + 1, last):
            if geom[k] == geom[j] and closed[k] == CLOSED_SURFACE and z[k] - z[i] > SAME:
                inside += 1 if normal[k, 2] > 0.0 else -1
        if inside > 0:
            return geom[j]
    return np.int32(-1)


@kernel(nogil=True, **UNCOUNTED)
def find_holders(lattice, crossings, planes, limits, holder, first_cell, end):
    """Find the surfaces that an agent could stand on if closed meshes held nothing inside.

    They face up within the slope, have headroom, and lie inside of closed meshes alone. `holder`,
    (n,) int32, receives the geom of such a mesh, and -1 for all other surfaces. Looks at the
    cells ``range(first_cell, end)``.
    """
    for cell in range(first_cell, end):
        x, y = cell_center(lattice, cell)
        first, last = crossings.start[cell], crossings.start[cell + 1]
        previous = -math.inf
        for i in range(first, last):
            holder[i] = -1
            z = crossings.z[i]
            if crossings.normal[i, 2] < limits.min_up or z - previous <= SAME:
                continue
            surfaces, others, above = look_up(crossings, i, last)
            if surfaces <= 0 or others > 0 or above - z < limits.headroom - SLACK:
                continue
            if count_planes_over(planes, x, y, z) == 0:
                holder[i] = _find_holder(crossings, i, last)
                previous = z


@kernel
def count_ends(lattice, cells, heights, footing, step, at_cell):
    """Count the edges of a sheet, and those beyond which a footing goes on at its height.

    `at_cell`, (cells,) bool, is all False, and so again afterwards.
    """
    for cell in cells:
        at_cell[cell] = True
    edges, goes_on = 0, 0
    for n in range(cells.shape[0]):
        for way in range(4):
            other = neighbour(lattice, cells[n], way)
            if other >= 0 and at_cell[other]:
                continue
            edges += 1
            if other < 0:
                continue
            for i in range(footing.start[other], footing.start[other + 1]):
                if abs(footing.z[i] - heights[n]) <= step + SLACK:
                    goes_on += 1
                    break
    for cell in cells:
        at_cell[cell] = False
    return edges, goes_on
