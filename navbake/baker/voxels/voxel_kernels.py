"""Fill voxels with the labels of the geoms that meet them, column by column (along z).

The voxels of a column that a convex solid or a half-space meets follow each other without a gap;
the first and the last of them are found by bisection with the tests of occupancy (`solid_kernels`
and `overlap_kernels`). A triangle is clipped to the column's square, and meets the voxels between
its lowest and its highest point there. A voxel that no triangle of a closed surface meets is inside
of the surface if its centre is. This is decided by the winding number of the column's middle line
(scan conversion of solids: Lee and Requicha, 1982).

A geom that reaches into a voxel by less than TOUCH_DEPTH does not meet it. If several geoms meet a
voxel, it gets the least of their labels, in whatever order they come.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import NOT_ROUND, Prism
from navbake.baker.core.constants import APART, OPEN_SURFACE
from navbake.baker.core.tiles import cell_center_at, tile_window, window_near_box
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.baker.geometry.gjk_kernels import make_simplex
from navbake.baker.geometry.overlap_kernels import (
    X,
    Y,
    clip_between,
    is_beside_prism,
    make_polygons,
    plane_meets_prism,
)
from navbake.baker.geometry.solid_kernels import solid_meets_prism
from navbake.compiled import NO_REFCOUNT, kernel, subkernel


class Voxels(NamedTuple):
    """A voxel grid to fill.

    Attributes:
        values: labels, (nx, ny, nz) unsigned integers, 0 for empty voxels.
        bottom: z of the grid's lower end [m].
        res: edge of a voxel [m].
    """

    values: NDArray[Any]
    bottom: float
    res: float


@subkernel(**NO_REFCOUNT)
def _label(column, first, end, label):
    """Give the voxels ``first:end`` of a column a label.

    A voxel that has a lower label already (other than 0, for an empty voxel) keeps it.
    """
    for k in range(first, end):
        if column[k] == 0 or column[k] > label:
            column[k] = label


@subkernel(**NO_REFCOUNT)
def _fill_between(voxels, column, low, high, label):
    """Label the voxels of a column that overlap the heights from `low` to `high` [m].

    Voxels that are overlapped by less than TOUCH_DEPTH are not labelled.
    """
    num_voxels = column.shape[0]
    start = (low + TOUCH_DEPTH - voxels.bottom) / voxels.res
    end = (high - TOUCH_DEPTH - voxels.bottom) / voxels.res
    if start < num_voxels and end > 0.0:
        first = math.floor(start) if start > 0.0 else 0
        _label(column, first, math.ceil(end) if end < num_voxels else num_voxels, label)


@subkernel(**NO_REFCOUNT)
def _meets(voxels, solids, planes, item, x, y, first, end, simplex):
    """Return whether a solid or a plane meets any of the voxels ``first:end`` of a column.

    Args:
        voxels: the grid, as `Voxels`.
        solids: the solids, as `Solids`.
        planes: the infinite planes, as `Planes`.
        item: the index of a solid, or the number of solids plus the index of a plane.
        x, y: the column's middle line [m].
        first, end: range of voxels, counted from the bottom.
        simplex: room for the iteration of GJK, see `make_simplex`.
    """
    low = voxels.bottom + first * voxels.res + TOUCH_DEPTH
    high = voxels.bottom + end * voxels.res - TOUCH_DEPTH
    prism = Prism(x, y, low, high, voxels.res / 2.0 - TOUCH_DEPTH, NOT_ROUND)
    num_solids = solids.geom.shape[0]
    if item >= num_solids:
        return plane_meets_prism(planes, item - num_solids, prism)
    if is_beside_prism(solids.bounds, item, prism):
        return False
    return solid_meets_prism(solids, item, prism, simplex) != APART


@subkernel(**NO_REFCOUNT)
def _fill_convex(voxels, solids, planes, item, column, x, y, label, simplex):
    """Label the voxels of a column that a convex solid or a half-space meets.

    The arguments are as in `_meets`; `column` are the voxels of the column, and `label` is their
    new label.
    """
    first = np.int64(0)
    end = np.int64(column.shape[0])
    if item < solids.geom.shape[0]:  # only as far as its box reaches
        box = solids.bounds[item]
        num_voxels = float(column.shape[0])
        first = np.int64(max((box[2] - voxels.bottom) / voxels.res, 0.0))
        end = np.int64(math.ceil(min((box[5] - voxels.bottom) / voxels.res, num_voxels)))
    if first >= end or not _meets(voxels, solids, planes, item, x, y, first, end, simplex):
        return
    # bisect for the first voxel that is met: the voxels up to it are met together
    low = first
    high = end - 1
    while low < high:
        middle = (low + high) // 2
        if _meets(voxels, solids, planes, item, x, y, first, middle + 1, simplex):
            high = middle
        else:
            low = middle + 1
    first = low
    # and for the last one: the voxels from it on are met together
    high = end - 1
    while low < high:
        middle = (low + high + 1) // 2
        if _meets(voxels, solids, planes, item, x, y, middle, end, simplex):
            low = middle
        else:
            high = middle - 1
    _label(column, first, low + 1, label)


@subkernel(**NO_REFCOUNT)
def _fill_inside(voxels, column, hits, cell, labels):
    """Label the voxels of a column whose centres are inside of closed surfaces.

    Args:
        voxels: the grid, as `Voxels`.
        column: the voxels of the column.
        hits: hits of the columns' middle lines with triangles, as `ColumnHits`.
        cell: index of the column in `hits`.
        labels: the label of each geom, by geom id.
    """
    first = hits.start[cell]
    last = hits.start[cell + 1]
    for i in range(first, last):
        if hits.closed[i] == OPEN_SURFACE:
            continue
        geom = hits.geom[i]
        winding_number = 0  # above hit i
        next_hit = i + 1  # of the same geom
        for j in range(first, i + 1):
            if hits.geom[j] == geom and hits.closed[j] != OPEN_SURFACE:
                winding_number += 1 if hits.normal[j, 2] < 0.0 else -1
        while next_hit < last and hits.geom[next_hit] != geom:
            next_hit += 1
        if winding_number > 0 and next_hit < last:
            start = (hits.z[i] - voxels.bottom) / voxels.res
            end = (hits.z[next_hit] - voxels.bottom) / voxels.res
            num_voxels = float(column.shape[0])
            low = math.ceil(min(max(start - 0.5, 0.0), num_voxels))
            high = math.ceil(min(max(end - 0.5, 0.0), num_voxels))
            _label(column, low, high, labels[geom])


@subkernel(**NO_REFCOUNT)
def _fill_triangle(voxels, lattice, window, facets, t, label, polygons, strip):
    """Label the voxels that a triangle meets.

    The triangle is clipped to each strip of columns with the same x; the rest of it is clipped to
    each column of the strip.

    Args:
        voxels: the grid, as `Voxels`.
        lattice: the lattice whose cells are the columns.
        window: only columns over these rows and columns of cells are filled, see `tile_window`.
        facets: the triangles, as `Facets`.
        t: index of the triangle.
        label: the label of its geom.
        polygons: room for clipping, see `make_polygons`.
        strip: room for the triangle clipped to a strip, (12, 3) float64.
    """
    half = voxels.res / 2.0
    num_rows = lattice.height
    row_first, row_end, col_first, col_end = window_near_box(
        lattice, window, facets.bounds, t, half
    )
    for col in range(col_first, col_end):
        x, _ = cell_center_at(lattice, row_first, col)
        x_limits = (x - half + TOUCH_DEPTH, x + half - TOUCH_DEPTH)
        num_in_strip = clip_between(
            facets.corners[t], np.int64(3), polygons.second, X, x_limits, strip
        )
        if num_in_strip == 0:
            continue
        for row in range(row_first, row_end):
            _, y = cell_center_at(lattice, row, col)
            y_limits = (y - half + TOUCH_DEPTH, y + half - TOUCH_DEPTH)
            polygon = polygons.first
            num_corners = clip_between(strip, num_in_strip, polygons.second, Y, y_limits, polygon)
            if num_corners > 0:
                low = polygon[0, 2]
                high = polygon[0, 2]
                for i in range(1, num_corners):
                    low = min(low, polygon[i, 2])
                    high = max(high, polygon[i, 2])
                column = voxels.values[col, num_rows - 1 - row]
                _fill_between(voxels, column, low, high, label)


@kernel(nogil=True)
def fill_voxels(voxels, lattice, solids, facets, planes, tile_index, hits, labels, first_tile, end):
    """Label the voxels of tiles ``range(first_tile, end)`` that geoms meet.

    Args:
        voxels: the grid to fill, as `Voxels`.
        lattice: the lattice whose cells are the voxels' columns: the voxels ``values[i, j]`` are
            over the cell at row ``ny - 1 - j``, column i.
        solids, facets, planes: the shapes.
        tile_index: the solids and facets over each tile of the lattice.
        hits: hits of the columns' middle lines with the facets, as `ColumnHits`.
        labels: the label of each geom, by geom id, > 0, in the dtype of the grid's values. A voxel
            keeps the label that it has if that is lower.
        first_tile, end: range of tiles.
    """
    polygons = make_polygons()
    strip = np.empty((12, 3))
    simplex = make_simplex()
    for tile in range(first_tile, end):
        window = tile_window(lattice, tile)
        for row in range(window[0], window[1]):
            for col in range(window[2], window[3]):
                x, y = cell_center_at(lattice, row, col)
                column = voxels.values[col, lattice.height - 1 - row]
                for n in range(tile_index.solid_start[tile], tile_index.solid_start[tile + 1]):
                    s = np.int64(tile_index.solid_item[n])
                    label = labels[solids.geom[s]]
                    _fill_convex(voxels, solids, planes, s, column, x, y, label, simplex)
                for p in range(planes.geom.shape[0]):
                    item = solids.geom.shape[0] + p
                    label = labels[planes.geom[p]]
                    _fill_convex(voxels, solids, planes, item, column, x, y, label, simplex)
                _fill_inside(voxels, column, hits, row * lattice.width + col, labels)
        for n in range(tile_index.triangle_start[tile], tile_index.triangle_start[tile + 1]):
            t = tile_index.triangle_item[n]
            label = labels[facets.geom[t]]
            _fill_triangle(voxels, lattice, window, facets, t, label, polygons, strip)
