"""What stands in each cell: every geom that meets its column, and which of them block it.

Two passes over the tiles: the first counts for each cell the geoms whose boxes meet its column,
so that the second knows where each cell may write. A geom's triangles are looked at together,
behind the box of those that lie over the tile.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from navbake.baker.kernels.arrays import Prism
from navbake.baker.kernels.constants import SAME, TOUCH
from navbake.baker.kernels.flags import (
    BLOCKS,
    PROBED,
    STANDS,
    Volumes,
    line_flags,
    plane_flags,
    solid_flags,
    triangle_flags,
)
from navbake.baker.kernels.gjk import make_simplex
from navbake.baker.kernels.overlap import (
    ANY_GEOM,
    line_is_blocked,
    make_polygons,
    outside,
    plane_meets_prism,
)
from navbake.baker.kernels.tiles import cell_center, count_tiles, tile_window
from navbake.types import Float, Int, Int32


class Groups(NamedTuple):
    """A tile's triangles by geom: group g is ``items[start[g] : start[g + 1]]`` in ``box[g]``."""

    items: Int32
    start: Int
    box: Float


class CellQuestion(NamedTuple):
    """What is asked about one cell, and what is known before its geoms are looked at.

    Attributes:
        cell: its id.
        column: all of it from floor to ceiling, as wide as anything is looked for.
        volumes: what a geom may meet.
        is_taken: whether the cell is occupied, so that something blocks it.
        by_line: whether its line alone proves that.
        known: flags of all its candidates.
    """

    cell: int
    column: Prism
    volumes: Volumes
    is_taken: bool
    by_line: bool
    known: int


@njit(inline="always")
def _group_triangles(items, facets):
    """Group a tile's triangles, which are sorted by geom."""
    geom, num = facets.geom, 0
    for i in range(items.shape[0]):
        if i == 0 or geom[items[i]] != geom[items[i - 1]]:
            num += 1
    start = np.empty(num + 1, np.int64)
    box = np.empty((num, 6), np.float64)
    group = -1
    for i in range(items.shape[0]):
        bounds = facets.bounds[items[i]]
        is_first = i == 0 or geom[items[i]] != geom[items[i - 1]]
        if is_first:
            group += 1
            start[group] = i
        for k in range(3):
            box[group, k] = bounds[k] if is_first else min(box[group, k], bounds[k])
        for k in range(3, 6):
            box[group, k] = bounds[k] if is_first else max(box[group, k], bounds[k])
    start[num] = items.shape[0]
    return Groups(items, start, box)


@njit(inline="always")
def _tile_items(tile, tiles, facets):
    """The solids and the triangles over a tile."""
    solids = tiles.solid_item[tiles.solid_start[tile] : tiles.solid_start[tile + 1]]
    first, last = tiles.triangle_start[tile], tiles.triangle_start[tile + 1]
    return solids, _group_triangles(tiles.triangle_item[first:last], facets)


@njit(inline="always")
def _reach(lattice, footprint):
    """How far from its centre a cell looks for geoms: a hair beyond its edges, see `with_edges`."""
    return max(lattice.cell_size / 2, footprint.square, footprint.radius) + 2.0 * TOUCH


@njit(inline="always")
def _column(lattice, cell, cells, reach):
    """All of a cell's column; NaN heights where there is no floor."""
    x, y = cell_center(lattice, cell)
    return Prism(x, y, cells.floor[cell], cells.ceiling[cell], reach, reach)


@njit(cache=True)
def _count_tile(tile, lattice, solids, facets, planes, tiles, footprint, cells):
    nearby, groups = _tile_items(tile, tiles, facets)
    reach = _reach(lattice, footprint)
    row0, row1, col0, col1 = tile_window(lattice, tile)
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = row * lattice.width + col
            column = _column(lattice, cell, cells, reach)
            if math.isnan(column.low):
                continue
            count = 0
            for p in range(planes.geom.shape[0]):
                if plane_meets_prism(planes, p, column):
                    count += 1
            for s in nearby:
                if not outside(solids.bounds, s, column):
                    count += 1
            for g in range(groups.box.shape[0]):
                if not outside(groups.box, g, column):
                    count += 1
            cells.slot[cell + 1] = count


@njit(cache=True, parallel=True)
def count_candidates(lattice, solids, facets, planes, tiles, footprint, cells):
    """Count for each cell with a floor the geoms whose boxes meet its column: an upper bound.

    ``cells.slot[cell + 1]`` receives the number.
    """
    for tile in prange(count_tiles(lattice)):
        _count_tile(np.int64(tile), lattice, solids, facets, planes, tiles, footprint, cells)


@njit(inline="always")
def _add(cells, cell, count, geom, flags):
    """Insert an entry into a cell's list, which is sorted by geom; the list's new length."""
    if not flags & STANDS:
        flags &= ~PROBED
    if not flags:
        return count
    first = cells.slot[cell]
    i = first + count
    while i > first and cells.geom[i - 1] > geom:
        cells.geom[i], cells.flags[i] = cells.geom[i - 1], cells.flags[i - 1]
        i -= 1
    cells.geom[i], cells.flags[i] = geom, flags
    return count + 1


@njit(inline="always")
def _ask(lattice, cell, crossings, footprint, probe, cells):
    """Put together what is asked about a cell."""
    half = lattice.cell_size / 2 - TOUCH
    column = _column(lattice, cell, cells, _reach(lattice, footprint))
    x, y, floor = column.x, column.y, column.low
    low, high = floor + footprint.low, floor + footprint.high
    volumes = Volumes(
        Prism(x, y, floor + (SAME + TOUCH), column.high, half, 0.0),
        Prism(x, y, low, high, footprint.square, footprint.radius),
        Prism(x, y, floor + probe.low, floor + probe.high, half, 0.0),
    )
    is_taken, by_line, known = cells.occupied[cell], False, 0
    if is_taken and cells.slot[cell + 1] - cells.slot[cell] == 1:
        # nothing else can be what blocks it; within the square alone it stands there, too
        known = BLOCKS if footprint.radius > 0.0 else BLOCKS | STANDS
    elif is_taken:
        by_line = line_is_blocked(crossings, cell, volumes.blocks, ANY_GEOM)
    return CellQuestion(cell, column, volumes, is_taken, by_line, known)


@njit(inline="always")
def _wanted(question, geom, probe):
    """The flags that a geom may have in a cell, and those of them that a line may prove."""
    wanted = STANDS | (PROBED if probe.geoms[geom] else 0)
    by_line = wanted | (BLOCKS if question.by_line else 0)
    return wanted | (BLOCKS if question.is_taken else 0), by_line


@njit(inline="always")
def _list_planes(question, planes, crossings, cells):
    count, cell, volumes = np.int64(0), question.cell, question.volumes
    by_line = STANDS | (BLOCKS if question.by_line else 0)
    for p in range(planes.geom.shape[0]):
        if not plane_meets_prism(planes, p, question.column):
            continue
        geom = planes.geom[p]
        flags = question.known | line_flags(crossings, cell, geom, volumes, by_line)
        flags = plane_flags(planes, p, volumes, question.is_taken, flags)
        count = _add(cells, cell, count, geom, flags)
    return count


@njit(inline="always")
def _list_triangles(question, groups, facets, crossings, probe, cells, count, polygons):
    cell, volumes = question.cell, question.volumes
    for g in range(groups.box.shape[0]):
        if outside(groups.box, g, question.column):
            continue
        items = groups.items[groups.start[g] : groups.start[g + 1]]
        geom = facets.geom[items[0]]
        wanted, by_line = _wanted(question, geom, probe)
        flags = question.known
        if flags & wanted != wanted:
            flags |= line_flags(crossings, cell, geom, volumes, by_line)
        flags = triangle_flags(items, facets, volumes, flags, wanted, polygons)
        count = _add(cells, cell, count, geom, flags)
    return count


@njit(inline="always")
def _list_solids(question, nearby, solids, crossings, probe, cells, count, simplex):
    cell, volumes = question.cell, question.volumes
    for s in nearby:
        if outside(solids.bounds, s, question.column):
            continue
        geom = solids.geom[s]
        wanted, by_line = _wanted(question, geom, probe)
        flags = question.known
        if flags & wanted != wanted:
            flags |= line_flags(crossings, cell, geom, volumes, by_line)
        if flags & wanted != wanted:
            flags = solid_flags(solids, s, volumes, flags, wanted, simplex)
        count = _add(cells, cell, count, geom, flags)
    return count


@njit(cache=True)
def _list_tile(
    tile, lattice, crossings, solids, facets, planes, tiles, footprint, probe, cells
):  # fmt: skip
    nearby, groups = _tile_items(tile, tiles, facets)
    simplex, polygons = make_simplex(), make_polygons()
    row0, row1, col0, col1 = tile_window(lattice, tile)
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = row * lattice.width + col
            if math.isnan(cells.floor[cell]) or cells.slot[cell + 1] == cells.slot[cell]:
                continue
            question = _ask(lattice, cell, crossings, footprint, probe, cells)
            count = _list_planes(question, planes, crossings, cells)
            count = _list_triangles(
                question, groups, facets, crossings, probe, cells, count, polygons
            )
            _list_solids(question, nearby, solids, crossings, probe, cells, count, simplex)


@njit(cache=True, parallel=True)
def list_geoms(lattice, crossings, solids, facets, planes, tiles, footprint, probe, cells):
    """List for each cell with a floor the geoms that stand in it or block it.

    A geom stands in a cell when it meets the cell's square between a hair over the floor and the
    ceiling; it blocks the cell when `check_cells` would find it in the band, which it does in
    occupied cells only; it is PROBED when it stands there and meets the square in the probed
    band. Where rounding leaves no proof that it blocks, it is UNPROVED.
    """
    for tile in prange(count_tiles(lattice)):
        _list_tile(
            np.int64(tile), lattice, crossings, solids, facets, planes, tiles, footprint, probe,
            cells
        )  # fmt: skip


@njit(cache=True)
def describe_floors(floors, crossings, min_up, support):
    """Find which geom carries each cell's floor, and how far below the next floor lies.

    `support` receives the answers, see `FloorSupport`; the gap is the height over the nearest
    surface below that faces up within the slope and belongs to another geom.
    """
    z, geom, normal = crossings.z, crossings.geom, crossings.normal
    # so little work a cell that threads would not repay their compiling
    for cell in range(floors.shape[0]):
        floor = floors[cell]
        support.geom[cell], support.gap[cell] = -1, math.inf
        if math.isnan(floor):
            continue
        first, last = crossings.start[cell], crossings.start[cell + 1]
        for i in range(first, last):
            if z[i] == floor and normal[i, 2] >= min_up:
                support.geom[cell] = geom[i]
                break
        for i in range(first, last):
            if z[i] > floor:
                break
            if normal[i, 2] >= min_up and geom[i] != support.geom[cell]:
                support.gap[cell] = floor - z[i]


@njit(cache=True)
def count_supports(support, standable, limit, covering, counts):
    """Count the cells of one storey by the geom that carries their floor.

    Args:
        support: what carries the floors, and how far the next one lies below.
        standable: (cells,) bool.
        limit: (geoms,) float64, gaps up to this mean that the geom lies on a floor [m].
        covering: gaps up to this mean that it only covers one [m].
        counts: see `SupportCounts`; are added to.
    """
    for i in range(support.geom.shape[0]):
        geom = support.geom[i]
        if geom < 0:
            continue
        counts.cells[geom] += 1
        counts.over[geom] += 1 if support.gap[i] <= limit[geom] else 0
        counts.near[geom] += 1 if support.gap[i] <= covering else 0
        counts.stood_on[geom] |= standable[i]


@njit(cache=True)
def measure_over_floors(listed, floors, extents, base, rise, area, upper_area):
    """Measure how a storey's geoms stand over its floors, into four (geoms,) arrays.

    `base` and `rise` are the least height of a geom's lower end over a floor, and the largest of
    its upper end over its lower one or a floor; they are lowered and raised [m]. `area` and
    `upper_area` count the cells it stands in, and those where it does so in the wall's band.
    """
    for cell in range(floors.shape[0]):
        for i in range(listed.start[cell], listed.start[cell + 1]):
            g = listed.geom[i]
            upper_area[g] += 1 if listed.upper[i] else 0
            if not listed.stands[i]:
                continue
            area[g] += 1
            floor, low, high = floors[cell], extents.low[g], extents.high[g]
            if low - floor < base[g]:
                base[g] = low - floor
            if high - max(low, floor) > rise[g]:
                rise[g] = high - max(low, floor)
