"""Occupancy of cells over their floors: the cell's line first, then geom by geom.

Most cells are told by their line. For the others the search is turned round: tile by tile, each
solid and each triangle goes to the cells near it that are still open, as a rasterizer goes over
pixels, and asks whether it meets the volume over their floors. So a triangle smaller than a cell
costs one or two questions, and a tile without open cells costs none. What is asked of a cell
doesn't depend on the order, so that any number of threads gives the same answers.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.kernels.arrays import Band, Prism
from navbake.baker.kernels.constants import APART, MEETS, TOUCH
from navbake.baker.kernels.gjk import Simplex, make_simplex
from navbake.baker.kernels.overlap import (
    ANY_GEOM,
    Polygons,
    facet_meets_prism,
    line_is_blocked,
    make_polygons,
    outside,
    plane_meets_prism,
)
from navbake.baker.kernels.solids import solid_meets
from navbake.baker.kernels.tiles import (
    TILE,
    cell_bit,
    cell_bits,
    cells_near,
    center_of,
    tile_window,
)
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Int


class Search(NamedTuple):
    """What is known of a tile's queries while its geoms are asked, and room for the geoms' tests.

    Attributes:
        run: the queries of each of its rows of cells, first and past the last, (TILE, 2) int64.
        first: the first query of each cell that lines left open, (TILE, TILE) int64, -1
            for none.
    """

    run: Int
    first: Int
    simplex: Simplex
    polygons: Polygons


@part
def _make_search():
    run, first = np.empty((TILE, 2), np.int64), np.empty((TILE, TILE), np.int64)
    return Search(run, first, make_simplex(), make_polygons())


@part(inline="always")
def _volume(lattice, row, col, floor, footprint):
    """What has to be free over a cell's floor."""
    x, y = center_of(lattice, row, col)
    low, high = floor + footprint.low, floor + footprint.high
    return Prism(x, y, low, high, footprint.square, footprint.radius)


@part(**UNCOUNTED)
def _check_lines(lattice, crossings, planes, footprint, queries, window, search):
    """Ask the lines of a tile's cells, and planes.

    Returns the cells with open queries, a bit each, and the heights between which these are.
    """
    still, low, high = np.int64(0), math.inf, -math.inf
    for row in range(window[0], window[1]):
        r = row - window[0]
        for c in range(TILE):
            search.first[r, c] = -1
        for n in range(search.run[r, 0], search.run[r, 1]):
            cell = queries.cell[n]
            col = cell - row * lattice.width
            prism = _volume(lattice, row, col, queries.floor[n], footprint)
            by_line = line_is_blocked(crossings, cell, Band(prism.low, prism.high), ANY_GEOM)
            meets = by_line
            for p in range(planes.geom.shape[0]):
                meets = meets or plane_meets_prism(planes, p, prism)
            queries.by_line[n], queries.state[n] = by_line, MEETS if meets else APART
            if not meets:
                still |= cell_bit(r, col - window[2])
                if search.first[r, col - window[2]] < 0:
                    search.first[r, col - window[2]] = n
                low, high = min(low, prism.low), max(high, prism.high)
    return still, low, high


@part(inline="always")
def _is_of(queries, n, cell):
    """Whether query n, -1 for none, is about a cell."""
    return 0 <= n < queries.cell.shape[0] and queries.cell[n] == cell


@part(inline="always")
def _first_from(cells, cell):
    """How many of the cells, which ascend, come before one."""
    first, last = 0, cells.shape[0]
    while first < last:
        middle = (first + last) // 2
        if cells[middle] < cell:
            first = middle + 1
        else:
            last = middle
    return first


@part(**UNCOUNTED)
def _check_shapes(tile, shapes, tiles, footprint, queries, search, still_open):
    """Ask the solids and then the triangles over a tile about its open queries.

    Args:
        still_open: what `_check_lines` returns.
    """
    lattice, solids, facets = shapes
    (still, low, high), window = still_open, tile_window(lattice, tile)
    reach = max(footprint.square, footprint.radius) + 2.0 * TOUCH  # see `facet_meets_prism`
    for is_solid in (True, False):
        boxes, start, item = facets.bounds, tiles.triangle_start, tiles.triangle_item
        if is_solid:
            boxes, start, item = solids.bounds, tiles.solid_start, tiles.solid_item
        for k in range(start[tile], start[tile + 1]):
            i = item[k]
            if still == 0:
                break
            if boxes[i, 2] >= high or boxes[i, 5] <= low:
                continue
            near = cells_near(lattice, window, boxes, i, reach)
            asked = still & cell_bits(window, near)
            if asked == 0:  # so it is for most triangles of a fine mesh
                continue
            for row in range(near[0], near[1]):
                for col in range(near[2], near[3]):
                    bit = cell_bit(row - window[0], col - window[2])
                    if asked & bit == 0:
                        continue
                    n = search.first[row - window[0], col - window[2]]
                    still &= ~bit
                    while _is_of(queries, n, row * lattice.width + col):
                        if queries.state[n] != MEETS:
                            prism = _volume(lattice, row, col, queries.floor[n], footprint)
                            answer = APART
                            if not is_solid:
                                meets = facet_meets_prism(facets, i, prism, search.polygons)
                                answer = MEETS if meets else APART
                            elif not outside(boxes, i, prism):
                                answer = solid_meets(solids, i, prism, search.simplex)
                            if answer != APART:
                                queries.state[n] = answer
                            still |= bit if answer != MEETS else 0
                        n += 1


@kernel(nogil=True)
def check_cells(
    lattice, crossings, solids, facets, planes, tiles, footprint, queries, first, end
):  # fmt: skip
    """Tell for each cell and floor of the queries whether anything is in the band above it.

    Looks at the queries of the rows of tiles ``range(first, end)``. `footprint` is what an agent
    sweeps over a cell; the queries are sorted by cell, and the answers are written into them.
    """
    asked = lattice, crossings, planes, footprint, queries
    _check_rows(asked, (lattice, solids, facets), tiles, _make_search(), first, end)


@part(**UNCOUNTED)
def _check_rows(asked, shapes, tiles, search, first, end):
    """See `check_cells`."""
    lattice, crossings, planes, footprint, queries = asked
    run, tiles_x = search.run, (lattice.width + TILE - 1) // TILE
    for tile in range(first * tiles_x, end * tiles_x):
        window, num_asked = tile_window(lattice, tile), 0
        for row in range(window[0], window[1]):
            # queries are sorted by cell, so a tile's follow on those of the tile before
            n = run[row - window[0], 1]
            if window[2] == 0:
                n = _first_from(queries.cell, row * lattice.width)
            run[row - window[0], 0] = n
            while n < queries.cell.shape[0] and queries.cell[n] < row * lattice.width + window[3]:
                n += 1
            run[row - window[0], 1] = n
            num_asked += n - run[row - window[0], 0]
        if num_asked == 0:
            continue
        still_open = _check_lines(lattice, crossings, planes, footprint, queries, window, search)
        if still_open[0] != 0:
            _check_shapes(tile, shapes, tiles, footprint, queries, search, still_open)


@kernel(nogil=True)
def lines_blocked(cells, low, high, crossings, out, first, end):
    """Whether each cell's line alone proves that something is between two heights [m], into out."""
    for n in range(first, end):
        out[n] = line_is_blocked(crossings, cells[n], Band(low[n], high[n]), ANY_GEOM)
