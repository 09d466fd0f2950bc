"""What stands in each cell: every geom that meets its column, and which of them block it.

Two passes over the tiles: the first counts for each cell the geoms whose boxes meet its column,
so that the second knows where each cell may write. In both the geoms go to the cells near them,
not the cells to the geoms. A geom's triangles are looked at together, behind the box of those
that lie over the tile; where lines have proved all that is asked about it, none of them is. The
cells that are still asked about are bits of a number for each flag, so that a triangle over none
of them is passed over at once.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.kernels.arrays import Band, Crossings, Prism, Probe
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
from navbake.baker.kernels.gjk import Simplex, make_simplex
from navbake.baker.kernels.overlap import (
    ANY_GEOM,
    Polygons,
    line_is_blocked,
    make_polygons,
    outside,
    plane_meets_prism,
)
from navbake.baker.kernels.tiles import (
    TILE,
    cell_bit,
    cell_bits,
    cells_near,
    center_of,
    tile_window,
)
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Bool, Float, Int


class TileCells(NamedTuple):
    """What is known of a tile's cells before its geoms are looked at, and while they are.

    Arrays are of shape (TILE, TILE), by row and column in the tile.

    Attributes:
        length: how many geoms a cell's list has, int64; -1 where nothing is asked.
        by_line: whether the cell is occupied, and its line alone proves it, bool.
        known: flags of all its candidates, int64.
        span: the lowest floor and the highest ceiling of the cells that are asked about, (2,)
            float64 [m].
        flags: those of the geom whose triangles are looked at, int64.
        wanted: the flags that are asked about it, int64; 0 where it is no candidate.
        still: for STANDS, BLOCKS and PROBED, the cells where that is asked and not known yet, a
            bit each, see `cell_bit`; (3,) int64.
        band: the heights between which each of these is asked, (3, 2) float64 [m].
        simplex, polygons: room for the geoms' tests.
    """

    length: Int
    by_line: Bool
    known: Int
    span: Float
    flags: Int
    wanted: Int
    still: Int
    band: Float
    simplex: Simplex
    polygons: Polygons


class TileQuestion(NamedTuple):
    """What is asked about a tile's cells; `window` is of `tile_window`."""

    lattice: Any
    window: tuple[int, int, int, int]
    crossings: Crossings
    footprint: Any
    probe: Probe


@part
def _make_tile_cells():
    square = (TILE, TILE)
    return TileCells(
        np.empty(square, np.int64),
        np.empty(square, np.bool_),
        np.empty(square, np.int64),
        np.empty(2, np.float64),
        np.empty(square, np.int64),
        np.empty(square, np.int64),
        np.empty(3, np.int64),
        np.empty((3, 2), np.float64),
        make_simplex(),
        make_polygons(),
    )


@part(inline="always")
def _reach(lattice, footprint):
    """How far from its centre a cell looks for geoms: a hair beyond, see `facet_meets_prism`."""
    return max(lattice.cell_size / 2, footprint.square, footprint.radius) + 2.0 * TOUCH


@part(inline="always")
def _column(lattice, row, col, cells, reach):
    """All of a cell's column; NaN heights where there is no floor."""
    x, y = center_of(lattice, row, col)
    cell = row * lattice.width + col
    return Prism(x, y, cells.floor[cell], cells.ceiling[cell], reach, reach)


@kernel(nogil=True, **UNCOUNTED)
def count_candidates(lattice, solids, planes, tiles, groups, footprint, cells, first, end):
    """Count for each cell with a floor the geoms whose boxes meet its column: an upper bound.

    Looks at the tiles ``range(first, end)``. ``cells.slot[cell + 1]``, 0 at first, receives the
    number.
    """
    reach, slot = _reach(lattice, footprint), cells.slot
    for tile in range(first, end):
        window = tile_window(lattice, tile)
        if planes.geom.shape[0] > 0:
            for row in range(window[0], window[1]):
                for col in range(window[2], window[3]):
                    column = _column(lattice, row, col, cells, reach)
                    for p in range(planes.geom.shape[0]):
                        if not math.isnan(column.low) and plane_meets_prism(planes, p, column):
                            slot[row * lattice.width + col + 1] += 1
        for is_solid in (True, False):
            boxes, start = groups.box, groups.start
            if is_solid:
                boxes, start = solids.bounds, tiles.solid_start
            for k in range(start[tile], start[tile + 1]):
                i = tiles.solid_item[k] if is_solid else k
                row0, row1, col0, col1 = cells_near(lattice, window, boxes, i, reach)
                for row in range(row0, row1):
                    for col in range(col0, col1):
                        column = _column(lattice, row, col, cells, reach)
                        if not math.isnan(column.low) and not outside(boxes, i, column):
                            slot[row * lattice.width + col + 1] += 1


@part(inline="always")
def _volumes(asked, column):
    """What is asked about in a cell's column."""
    footprint, probe = asked.footprint, asked.probe
    half = asked.lattice.cell_size / 2 - TOUCH
    x, y, floor = column.x, column.y, column.low
    low, high = floor + footprint.low, floor + footprint.high
    return Volumes(
        Prism(x, y, floor + (SAME + TOUCH), column.high, half, 0.0),
        Prism(x, y, low, high, footprint.square, footprint.radius),
        Prism(x, y, floor + probe.low, floor + probe.high, half, 0.0),
    )


@part(inline="always")
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


@part(**UNCOUNTED)
def _begin(asked, planes, cells, here):
    """Note what is known of a tile's cells, and list the planes in them."""
    lattice, window, crossings, footprint, _ = asked
    here.span[0], here.span[1] = math.inf, -math.inf
    for row in range(window[0], window[1]):
        for col in range(window[2], window[3]):
            r, c, cell = row - window[0], col - window[2], row * lattice.width + col
            num_candidates = cells.slot[cell + 1] - cells.slot[cell]
            if math.isnan(cells.floor[cell]) or num_candidates == 0:
                here.length[r, c] = -1
                continue
            column = _column(lattice, row, col, cells, _reach(lattice, footprint))
            here.span[0] = min(here.span[0], column.low)
            here.span[1] = max(here.span[1], column.high)
            volumes = _volumes(asked, column)
            is_taken, by_line, known = cells.occupied[cell], False, 0
            if is_taken and num_candidates == 1:
                # nothing else can be what blocks it; within the square alone it stands there, too
                known = BLOCKS if footprint.radius > 0.0 else BLOCKS | STANDS
            elif is_taken:
                band = Band(volumes.blocks.low, volumes.blocks.high)
                by_line = line_is_blocked(crossings, cell, band, ANY_GEOM)
            count = 0
            for p in range(planes.geom.shape[0]):
                if not plane_meets_prism(planes, p, column):
                    continue
                proved = STANDS | (BLOCKS if by_line else 0)
                flags = known | line_flags(crossings, cell, planes.geom[p], volumes) & proved
                flags = plane_flags(planes, p, volumes, is_taken, flags)
                count = _add(cells, cell, count, planes.geom[p], flags)
            here.length[r, c], here.by_line[r, c], here.known[r, c] = count, by_line, known


@part(inline="always")
def _ask_lines(asked, window, boxes, i, geom, cells, here):
    """Ask the lines of the cells near a solid or a group of triangles, by its box.

    Notes what they leave open, and between which heights that is.
    """
    lattice = asked.lattice
    here.still[:] = 0
    here.band[:, 0], here.band[:, 1] = math.inf, -math.inf
    reach = _reach(lattice, asked.footprint)
    maybe = STANDS | (PROBED if asked.probe.geoms[geom] else 0)
    for row in range(window[0], window[1]):
        for col in range(window[2], window[3]):
            r, c = row - asked.window[0], col - asked.window[2]
            cell = row * lattice.width + col
            here.wanted[r, c] = 0
            column = _column(lattice, row, col, cells, reach)
            if here.length[r, c] < 0 or outside(boxes, i, column):
                continue
            volumes = _volumes(asked, column)
            # the flags that it may have, and those of them that the line alone proves
            wanted = maybe | (BLOCKS if cells.occupied[cell] else 0)
            flags = here.known[r, c]
            if flags & wanted != wanted:
                proved = maybe | (BLOCKS if here.by_line[r, c] else 0)
                flags |= line_flags(asked.crossings, cell, geom, volumes) & proved
            here.wanted[r, c], here.flags[r, c] = wanted, flags
            _note_open(here, r, c, wanted & ~flags, volumes)


@part(inline="always")
def _note_open(here, r, c, flags, volumes):
    """Note that flags are still asked about a cell."""
    for k, volume in enumerate(volumes):
        if flags & (1 << k):
            here.still[k] |= cell_bit(r, c)
            here.band[k, 0] = min(here.band[k, 0], volume.low)
            here.band[k, 1] = max(here.band[k, 1], volume.high)


@part(inline="always")
def _cells_open_between(here, low, high):
    """The cells about which something is still asked between two heights, a bit each."""
    cells = 0
    for k in range(3):
        if low < here.band[k, 1] and high > here.band[k, 0]:
            cells |= here.still[k]
    return cells


@part(**UNCOUNTED)
def _list_geom(asked, shapes, tiles, groups, is_solid, n, cells, here):
    """Add a geom to the lists of the cells over a tile that it stands in or blocks.

    It is a solid, the n-th of the tiles' list, or the n-th group of triangles.
    """
    solids, facets, lattice = shapes[0], shapes[1], asked.lattice
    if is_solid:
        box, boxes, items = solids.bounds, solids.bounds, tiles.solid_item
        first, last, i = n, n + 1, np.int64(items[n])
        geom = solids.geom[i]
    else:
        box, boxes, items = groups.box, facets.bounds, tiles.triangle_item
        first, last, i = groups.first[n], groups.first[n + 1], n
        geom = facets.geom[items[first]]
    if box[i, 2] >= here.span[1] or box[i, 5] <= here.span[0]:
        return
    reach = _reach(lattice, asked.footprint)
    window = cells_near(lattice, asked.window, box, i, reach)
    _ask_lines(asked, window, box, i, geom, cells, here)
    for k in range(first, last):
        t = items[k]
        if here.still[0] | here.still[1] | here.still[2] == 0:
            break
        still = _cells_open_between(here, boxes[t, 2], boxes[t, 5])
        if still == 0:
            continue
        near = cells_near(lattice, window, boxes, t, reach)
        still &= cell_bits(asked.window, near)
        if still == 0:
            continue
        for row in range(near[0], near[1]):
            for col in range(near[2], near[3]):
                r, c = row - asked.window[0], col - asked.window[2]
                if still & cell_bit(r, c) == 0:
                    continue
                wanted, flags = here.wanted[r, c], here.flags[r, c]
                volumes = _volumes(asked, _column(lattice, row, col, cells, reach))
                if is_solid:
                    flags = solid_flags(solids, t, volumes, flags, wanted, here.simplex)
                else:
                    flags = triangle_flags(facets, t, volumes, flags, wanted, here.polygons)
                here.flags[r, c] = flags
                for flag in range(3):
                    if flags & (1 << flag):
                        here.still[flag] &= ~cell_bit(r, c)
    for row in range(window[0], window[1]):
        for col in range(window[2], window[3]):
            r, c = row - asked.window[0], col - asked.window[2]
            if here.wanted[r, c]:
                cell = row * lattice.width + col
                here.length[r, c] = _add(cells, cell, here.length[r, c], geom, here.flags[r, c])


@part(**UNCOUNTED)
def _list_tile(tile, asked, shapes, tiles, groups, cells, here):
    """List what stands in the cells of a tile or blocks them."""
    _begin(asked, shapes[2], cells, here)
    for is_solid in (False, True):
        start = tiles.solid_start if is_solid else groups.start
        for n in range(start[tile], start[tile + 1]):
            _list_geom(asked, shapes, tiles, groups, is_solid, n, cells, here)


@kernel(nogil=True)
def list_geoms(lattice, crossings, shapes, tiles, groups, footprint, probe, cells, first, end):
    """List for each cell with a floor the geoms that stand in it or block it.

    A geom stands in a cell when it meets the cell's square between a hair over the floor and the
    ceiling; it blocks the cell when `check_cells` would find it in the band, which it does in
    occupied cells only; it is PROBED when it stands there and meets the square in the probed
    band. Where rounding leaves no proof that it blocks, it is UNPROVED.

    Looks at the tiles ``range(first, end)``; `shapes` are solids, facets and planes.
    """
    here = _make_tile_cells()
    for tile in range(first, end):
        asked = TileQuestion(lattice, tile_window(lattice, tile), crossings, footprint, probe)
        _list_tile(tile, asked, shapes, tiles, groups, cells, here)


@kernel(**UNCOUNTED)
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


@kernel(**UNCOUNTED)
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


@kernel(**UNCOUNTED)
def mark_cells(start, chosen, marked):
    """Mark the cells with a chosen entry in their lists; see `LevelContents` for `start`."""
    for cell in range(marked.shape[0]):
        for i in range(start[cell], start[cell + 1]):
            marked[cell] |= chosen[i]


@kernel(**UNCOUNTED)
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
