"""Standable surfaces, the sheets that steps make of them, and how floors go on under things.

Surfaces are judged column by column from the winding of the line: of solids below a point, how
many were entered and not left. Sheets are the connected components of surfaces that are a step
apart, by union-find. Floors grow ring by ring, breadth first.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.kernels.constants import CLOSED_SURFACE, OPEN_SURFACE, SAME, SLACK
from navbake.baker.kernels.tiles import cell_center
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.navgrid.kernels.union_find import find_root, unite
from navbake.types import Bool, Float, Int, Int32


@part(**UNCOUNTED)
def count_planes_over(planes, x, y, z):
    """How many infinite planes have a point behind them."""
    count = 0
    for p in range(planes.geom.shape[0]):
        depth = (
            planes.mat[p, 2] * (x - planes.pos[p, 0])
            + planes.mat[p, 5] * (y - planes.pos[p, 1])
            + planes.mat[p, 8] * (z - planes.pos[p, 2])
        )
        if depth < -SAME:
            count += 1
    return count


@part(**UNCOUNTED)
def look_up(crossings, i, last):
    """How many solids of a column hold the i-th surface, and the height of the next one above.

    A solid that begins at the surface's own height (within SAME) stands on it and covers it: its
    underside doesn't count as left. One that ends there doesn't cover it.

    Returns how many closed surfaces hold it, how many other solids, and the height.
    """
    z, normal, closed = crossings.z, crossings.normal, crossings.closed
    surfaces, others, above = 0, 0, math.inf
    for j in range(i + 1, last):
        if z[j] - z[i] <= SAME:
            continue
        if above == math.inf:
            above = z[j]
        turn = 1 if normal[j, 2] > 0.0 else -1
        if closed[j] == CLOSED_SURFACE:
            surfaces += turn
        elif closed[j] != OPEN_SURFACE:
            others += turn
    return surfaces, others, above


@kernel(nogil=True, **UNCOUNTED)
def mark_surfaces(lattice, crossings, planes, limits, floor_like, standable, count, cell0, end):
    """Tell which crossings are floor-like and which are standable, into two (n,) bool arrays.

    `count`, (cells,) int64, receives how many of a cell are standable.

    Floor-like: faces up within the slope, or faces up more steeply at most a step above one that
    does: a bump too low to be an obstacle. Standable: faces up within the slope, lies inside of
    no solid, and the next surface above is at least the headroom higher. Of several surfaces at
    one height the lowest counts. Looks at the cells ``range(cell0, end)``.
    """
    for cell in range(cell0, end):
        first, last = crossings.start[cell], crossings.start[cell + 1]
        previous, gentle = -math.inf, -math.inf
        count[cell] = 0
        for i in range(first, last):
            z, up = crossings.z[i], crossings.normal[i, 2]
            standable[i] = False
            floor_like[i] = up > 0.0 and z - gentle <= limits.step + SLACK
            if up < limits.min_up:
                continue
            floor_like[i] = True
            gentle = z
            if z - previous <= SAME:
                continue
            surfaces, others, above = look_up(crossings, i, last)
            if above - z < limits.headroom - SLACK:
                continue
            x, y = cell_center(lattice, cell)
            if surfaces + others + count_planes_over(planes, x, y, z) <= 0:
                standable[i] = True
                count[cell] += 1
                previous = z


class Surfaces(NamedTuple):
    """Standable surfaces, and the heights of floor-like ones, column by column.

    Attributes:
        z, cell, geom: of each standable one, float64 [m], int32, int32.
        surface: which of the floor-like ones it is, int32.
        is_top: whether nothing lies above it in its column, bool.
        footing: heights of the floor-like ones, float64 [m].
    """

    z: Float
    cell: Int32
    surface: Int32
    geom: Int32
    is_top: Bool
    footing: Float


@kernel(nogil=True, **UNCOUNTED)
def list_surfaces(crossings, marks, places, before, found, writing, first, end):
    """List the surfaces that `mark_surfaces` marked; twice: to count, then to write.

    Looks at the columns ``range(first, end)`` of the crossings.

    Args:
        marks: which crossings are floor-like, and which are standable, (n,) bool each.
        places: by column, where its standable surfaces go, and where its floor-like ones do, int64;
            of these, ``places[1][column + 1]`` receives the number in the first call.
        before: how many cells, and how many floor-like surfaces, come before these columns.
        found: receives the surfaces.
    """
    (floor_like, standable), (start, footing_start) = marks, places
    z, geom = crossings.z, crossings.geom
    for column in range(first, end):
        begin, past = crossings.start[column], crossings.start[column + 1]
        if not writing:
            count = 0
            for i in range(begin, past):
                count += floor_like[i]
            footing_start[column + 1] = count
            continue
        at, footing = start[column], footing_start[column]
        for i in range(begin, past):
            if standable[i]:
                found.z[at], found.geom[at] = z[i], geom[i]
                found.cell[at] = before[0] + column
                found.surface[at] = before[1] + footing
                found.is_top[at] = z[past - 1] - z[i] <= SLACK
                at += 1
            if floor_like[i]:
                found.footing[footing] = z[i]
                footing += 1


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
def neighbours(lattice, cell):
    """The next cells east, south, west and north, each -1 for none."""
    width, num = lattice.width, lattice.width * lattice.height
    col = cell % width
    east = cell + 1 if col + 1 < width else -1
    south = cell + width if cell + width < num else -1
    west = cell - 1 if col > 0 else -1
    return east, south, west, cell - width


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


@part(inline="always")
def _slope_joins(dz, one, other, step):
    """Whether slopes join two surfaces of neighbouring cells that are `dz` apart.

    `one` and `other` are the rises over a cell that each one's slope predicts; the steeper one is
    more than a step. Between them lies whatever a floor with these two slopes may rise that bends
    somewhere on the way, as at a ramp's foot.
    """
    if max(abs(one), abs(other)) <= step + SLACK:
        return False
    if min(one, other) - SLACK <= dz <= max(one, other) + SLACK:
        return True
    return abs(dz - one) <= step + SLACK and abs(dz - other) <= step + SLACK


@kernel
def join_by_slopes(lattice, start, z, normal, step):
    """Find the pairs of surfaces in neighbouring cells that their slopes join, but no step does.

    Surfaces are listed as for `join_by_steps`, with their normals, (n, 3) float32. Returns the
    pairs, (m, 2) int64, by cell.
    """
    pairs = np.empty((0, 2), np.int64)
    for writing in (False, True):
        count = 0
        for cell in range(start.shape[0] - 1):
            for way in range(2):
                other = neighbour(lattice, cell, way)
                if other < 0:
                    continue
                for a in range(start[cell], start[cell + 1]):
                    for b in range(start[other], start[other + 1]):
                        dz = z[b] - z[a]
                        if abs(dz) <= step + SLACK:
                            continue
                        # rows run south, against y
                        axis, turn = (0, -lattice.cell_size) if way == 0 else (1, lattice.cell_size)
                        rise_a = turn * normal[a, axis] / normal[a, 2]
                        rise_b = turn * normal[b, axis] / normal[b, 2]
                        if _slope_joins(dz, rise_a, rise_b, step):
                            if writing:
                                pairs[count, 0], pairs[count, 1] = a, b
                            count += 1
        if not writing:
            pairs = np.empty((count, 2), np.int64)
    return pairs


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


@kernel(nogil=True)
def find_links(lattice, start, z, level, step):
    """Pairs of surfaces in neighbouring cells, a step apart, on different levels.

    Returns surfaces a and b of each pair, (n, 2) int64, the lower level's first, by cell.
    """
    pairs = np.empty((0, 2), np.int64)
    for writing in (False, True):
        count = 0
        for cell in range(start.shape[0] - 1):
            if start[cell] == start[cell + 1]:
                continue
            for way in range(2):
                other = neighbour(lattice, cell, way)
                if other < 0:
                    continue
                for a in range(start[cell], start[cell + 1]):
                    for b in range(start[other], start[other + 1]):
                        if level[a] == level[b] or level[a] < 0 or level[b] < 0:
                            continue
                        if abs(z[a] - z[b]) > step + SLACK:
                            continue
                        if writing:
                            swap = level[b] < level[a]
                            pairs[count, 0] = b if swap else a
                            pairs[count, 1] = a if swap else b
                        count += 1
        if count == 0:
            break
        if not writing:
            pairs = np.empty((count, 2), np.int64)
    return pairs


@kernel(nogil=True, **UNCOUNTED)
def count_options(footing, candidate, floor, lowest, highest, count, cell0, end):
    """Count the heights at which a level's floor may go on in each cell, into (cells,) int64.

    Those are the candidate footings, (n,) bool, of cells without a floor (NaN), between the cell's
    lowest and highest height [m]. Looks at the cells ``range(cell0, end)``.
    """
    for cell in range(cell0, end):
        count[cell] = 0
        if math.isnan(floor[cell]):
            for i in range(footing.start[cell], footing.start[cell + 1]):
                if candidate[i] and lowest[cell] <= footing.z[i] <= highest[cell]:
                    count[cell] += 1


@kernel(nogil=True, **UNCOUNTED)
def list_options(footing, candidate, lowest, highest, start, height, cell0, end):
    """Write the heights that `count_options` counts, (options,) float64 [m].

    Cell i's, in the order of its footings, are ``height[start[i] : start[i + 1]]``.
    """
    for cell in range(cell0, end):
        place = start[cell]
        if place == start[cell + 1]:
            continue
        for i in range(footing.start[cell], footing.start[cell + 1]):
            if candidate[i] and lowest[cell] <= footing.z[i] <= highest[cell]:
                height[place] = footing.z[i]
                place += 1


@kernel(nogil=True)
def grow_floor(lattice, start, height, floor, step):
    """Let a level's floor go on under things, ring by ring, in place.

    Patches of cells that don't touch grow one after the other, as each then stays in fast memory.
    A cell without a floor (NaN) takes that of its heights that is nearest to the floor of a
    neighbour (the lower one if two are equally near), when they differ by at most a step. All
    cells of a ring are decided before any is written, so their order decides nothing. The
    heights are listed by cell, see `list_options`.
    """
    num = np.int64(0)
    for cell in range(floor.shape[0]):
        num += 1 if start[cell] < start[cell + 1] else 0
    ring, following = np.empty(num, np.int64), np.empty(num, np.int64)
    queued, seen = np.zeros(floor.shape[0], np.bool_), np.zeros(floor.shape[0], np.bool_)
    value, beside = np.empty(num, np.float64), np.empty(4, np.float64)
    rings = Rings(ring, following, queued, value, beside, seen)
    _grow(lattice, start, height, floor, step, rings)


class Rings(NamedTuple):
    """Room for the rings that a floor grows by.

    Attributes:
        ring, following: the cells of a ring and of the next one, int64.
        queued: whether a cell is in one of them, bool by cell.
        value: the floors of the ring's cells [m].
        beside: (4,) float64, floors beside a cell [m].
        seen: whether a cell's patch is known, bool by cell.
    """

    ring: Int
    following: Int
    queued: Bool
    value: Float
    beside: Float
    seen: Bool


@part(**UNCOUNTED)
def _grow(lattice, start, height, floor, step, rings):
    """See `grow_floor`; one patch of cells after the other."""
    for cell in range(floor.shape[0]):
        if start[cell] < start[cell + 1] and not rings.seen[cell]:
            _grow_patch(lattice, start, height, floor, step, rings, cell)


@part(inline="always")
def _grow_patch(lattice, start, height, floor, step, rings, cell):
    """Let a floor go on in the cells with heights that hang together with one of them."""
    ring, following, queued, value, beside, seen = rings
    following[0], seen[cell] = cell, True
    end, known, count = 0, 0, 1
    while known < count:
        cell = following[known]
        known += 1
        if _list_beside(lattice, cell, floor, beside) > 0:
            queued[cell] = True
            ring[end] = cell
            end += 1
        for other in _around(lattice, cell):
            if other >= 0 and not seen[other] and start[other] < start[other + 1]:
                seen[other] = True
                following[count] = other
                count += 1
    while end > 0:
        for q in range(end):
            cell = ring[q]
            found = _list_beside(lattice, cell, floor, beside)
            heights = height[start[cell] : start[cell + 1]]
            value[q] = nearest_height(heights, beside[:found], step)
        for q in range(end):
            queued[ring[q]] = False
            floor[ring[q]] = value[q]
        count = 0
        for q in range(end):
            if math.isnan(value[q]):
                continue
            for other in _around(lattice, ring[q]):
                if other < 0 or queued[other] or start[other] == start[other + 1]:
                    continue
                if math.isnan(floor[other]):
                    queued[other] = True
                    following[count] = other
                    count += 1
        end = count
        ring, following = following, ring


@part(inline="always")
def _around(lattice, cell):
    """The next cells east, south, west and north, less than 0 for none; see `neighbour`."""
    width, col = lattice.width, cell % lattice.width
    east = cell + 1 if col + 1 < width else np.int64(-1)
    south = cell + width if cell + width < width * lattice.height else np.int64(-1)
    west = cell - 1 if col > 0 else np.int64(-1)
    return east, south, west, cell - width


@part(inline="always")
def _list_beside(lattice, cell, floor, beside):
    """Write the floors of a cell's neighbours that have one; returns how many they are."""
    count = 0
    for other in _around(lattice, cell):
        if other >= 0 and not math.isnan(floor[other]):
            beside[count] = floor[other]
            count += 1
    return count


@part(inline="always")
def nearest_height(heights, beside, step):
    """The height at which a floor goes on in a cell, or NaN."""
    best, best_gap = math.nan, step + SLACK
    for floor in beside:
        for z in heights:
            gap = abs(z - floor)
            # gaps within SAME are equally near; then the lower height counts
            if gap < best_gap - SAME or (gap <= best_gap + SAME and z < best):
                best, best_gap = z, min(gap, best_gap)
            elif math.isnan(best) and gap <= best_gap:
                best, best_gap = z, gap
    return best
