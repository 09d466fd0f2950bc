"""Surfaces like floors that lie inside of closed meshes, by the winding of their column's line."""

import math

import numpy as np

from navbake.baker.floors.kernels.surfaces import count_planes_over, look_up
from navbake.baker.kernels.constants import CLOSED_SURFACE, SAME, SLACK
from navbake.baker.kernels.tiles import cell_center
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.navgrid.kernels.union_find import find_root, unite


@part
def neighbour(lattice, cell, way):
    """The next cell east (0), south (1), west (2) or north (3), or -1."""
    width, col = lattice.width, cell % lattice.width
    if way == 0:
        return cell + 1 if col + 1 < width else -1
    if way == 1:
        return cell + width if cell + width < width * lattice.height else -1
    if way == 2:
        return cell - 1 if col > 0 else -1
    return cell - width


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
def find_holders(lattice, cells, crossings, planes, limits, holder, begin, end):
    """Find the surfaces that an agent could stand on if closed meshes held nothing inside.

    They face up within the slope, have headroom, and lie inside of closed meshes alone. `holder`,
    (n,) int32, receives the geom of such a mesh, and -1 for all other surfaces. Looks at
    the columns ``range(begin, end)``, which belong to ``cells``.
    """
    for n in range(begin, end):
        x, y = cell_center(lattice, cells[n])
        first, last = crossings.start[n], crossings.start[n + 1]
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
def count_ends(lattice, cells, heights, surfaces, step, at_cell):
    """Count the edges of a sheet, and those beyond which a floor may go on at its height.

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
            first = surfaces.first[other]
            for i in range(first, first + surfaces.length[other]):
                if abs(surfaces.z[i] - heights[n]) <= step + SLACK:
                    goes_on += 1
                    break
    for cell in cells:
        at_cell[cell] = False
    return edges, goes_on


@kernel(nogil=True)
def join_by_steps(lattice, start, z, group, step):
    """Label the connected parts of standable surfaces: of one group, neighbours a step apart.

    Surfaces are listed by column, ascending: start, (cells + 1,) int64, and z, (n,) float64 [m].
    `group` is (n,) int32. Returns the part of each, (n,) int32, numbered from 0 by their first
    members; and the parts' sizes, int64.
    """
    parent = np.arange(z.shape[0])
    for cell in range(start.shape[0] - 1):
        if start[cell] == start[cell + 1]:
            continue
        for way in range(2):
            other = neighbour(lattice, cell, way)
            if other < 0:
                continue
            for a in range(start[cell], start[cell + 1]):
                for b in range(start[other], start[other + 1]):
                    if group[a] == group[b] and abs(z[a] - z[b]) <= step + SLACK:
                        unite(parent, a, b)
    part = np.empty(z.shape[0], np.int32)
    size = np.zeros(z.shape[0], np.int64)
    count = 0
    for node in range(z.shape[0]):
        root = find_root(parent, node)
        if root == node:  # roots are the lowest of their part, so met first
            part[node] = count
            count += 1
        else:
            part[node] = part[root]
        size[part[node]] += 1
    return part, size[:count].copy()


@kernel(nogil=True)
def group_members(part, size):
    """List the members of each part, given the part of each surface, int32, and the parts' sizes.

    Returns start, (parts + 1,) int64, and member, (n,) int64, ascending within a part.
    """
    start = np.zeros(size.shape[0] + 1, np.int64)
    for i in range(size.shape[0]):
        start[i + 1] = start[i] + size[i]
    cursor = start[:-1].copy()
    member = np.empty(part.shape[0], np.int64)
    for i in range(part.shape[0]):
        member[cursor[part[i]]] = i
        cursor[part[i]] += 1
    return start, member
