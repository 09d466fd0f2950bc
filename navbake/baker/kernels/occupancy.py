"""Occupancy of cells over their floors: the cell's line first, then geom by geom.

Most cells are told by their line. The others ask planes, triangles and solids of their tile, and
the first proof that something is in the way ends the search.
"""

from numba import njit, prange

from navbake.baker.kernels.arrays import Band, Prism
from navbake.baker.kernels.constants import APART, MEETS, UNDECIDED
from navbake.baker.kernels.gjk import SQUARE, make_simplex
from navbake.baker.kernels.overlap import (
    ANY_GEOM,
    facet_meets_prism,
    line_is_blocked,
    make_polygons,
    outside,
    plane_meets_prism,
    with_edges,
)
from navbake.baker.kernels.solids import disc_too, part_of_solid
from navbake.baker.kernels.tiles import cell_center, tile_of


@njit(inline="always")
def _any_triangle(items, facets, prism):
    if items.shape[0] == 0:
        return False
    polygons, wide = make_polygons(), with_edges(prism)
    for t in items:  # noqa: SIM110 (numba has no generators in `any`)
        if facet_meets_prism(facets, t, prism, wide, polygons):
            return True
    return False


@njit(inline="always")
def _any_solid(items, solids, prism):
    """MEETS where any solid does; else UNDECIDED where that of any is open; else APART."""
    if items.shape[0] == 0:
        return APART
    simplex, answer = make_simplex(), APART
    for s in items:
        if outside(solids.bounds, s, prism):
            continue
        part = part_of_solid(solids, s, prism, SQUARE, simplex)
        part = disc_too(solids, s, prism, part, simplex)
        if part == MEETS:
            return MEETS
        if part == UNDECIDED:
            answer = UNDECIDED
    return answer


@njit(inline="always")
def _any_geom(tile, solids, facets, planes, tiles, prism):
    """Whether any geom over a tile meets a prism."""
    for p in range(planes.geom.shape[0]):
        if plane_meets_prism(planes, p, prism):
            return MEETS
    first, last = tiles.triangle_start[tile], tiles.triangle_start[tile + 1]
    if _any_triangle(tiles.triangle_item[first:last], facets, prism):
        return MEETS
    first, last = tiles.solid_start[tile], tiles.solid_start[tile + 1]
    return _any_solid(tiles.solid_item[first:last], solids, prism)


@njit(cache=True, parallel=True)
def check_cells(lattice, crossings, solids, facets, planes, tiles, footprint, queries):
    """Tell for each cell and floor of the queries whether anything is in the band above it.

    `footprint` is what an agent sweeps over a cell; the answers are written into the queries.
    """
    # writes into these by way of their tuple would be dropped, see `arrays`
    state, by_line = queries.state, queries.by_line
    for n in prange(queries.cell.shape[0]):
        cell, floor = queries.cell[n], queries.floor[n]
        x, y = cell_center(lattice, cell)
        low, high = floor + footprint.low, floor + footprint.high
        prism = Prism(x, y, low, high, footprint.square, footprint.radius)
        by_line[n] = line_is_blocked(crossings, cell, prism, ANY_GEOM)
        if by_line[n]:
            state[n] = MEETS
        else:
            state[n] = _any_geom(tile_of(lattice, cell), solids, facets, planes, tiles, prism)


@njit(cache=True, parallel=True)
def lines_blocked(cells, low, high, crossings, out):
    """Whether each cell's line alone proves that something is between two heights [m], into out."""
    for n in prange(cells.shape[0]):
        out[n] = line_is_blocked(crossings, cells[n], Band(low[n], high[n]), ANY_GEOM)
