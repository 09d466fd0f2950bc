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
from navbake.baker.geometry.gjk_kernels import allocate_simplex
from navbake.baker.geometry.overlap_kernels import (
    X,
    Y,
    allocate_polygons,
    clip_polygon_between,
    is_beside_prism,
    plane_meets_prism,
)
from navbake.baker.geometry.solid_kernels import solid_meets_prism
from navbake.baker.geometry.triangle_kernels import allocate_triangle, copy_triangle
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
def _label(column, first_voxel, end_voxel, label):
    """Give the voxels ``first_voxel:end_voxel`` of a column a label.

    A voxel that has a lower label already (other than 0, for an empty voxel) keeps it.
    """
    for voxel in range(first_voxel, end_voxel):
        if column[voxel] == 0 or column[voxel] > label:
            column[voxel] = label


@subkernel(**NO_REFCOUNT)
def _fill_between(voxels, column, bottom, top, label):
    """Label the voxels of a column that overlap the heights from `bottom` to `top` [m].

    Voxels that are overlapped by less than TOUCH_DEPTH are not labelled.
    """
    num_voxels = column.shape[0]
    bottom_in_voxels = (bottom + TOUCH_DEPTH - voxels.bottom) / voxels.res
    top_in_voxels = (top - TOUCH_DEPTH - voxels.bottom) / voxels.res
    if bottom_in_voxels < num_voxels and top_in_voxels > 0.0:
        first_voxel = math.floor(bottom_in_voxels) if bottom_in_voxels > 0.0 else 0
        _label(
            column,
            first_voxel,
            math.ceil(top_in_voxels) if top_in_voxels < num_voxels else num_voxels,
            label,
        )


@subkernel(**NO_REFCOUNT)
def _meets(voxels, solids, planes, shape_index, x, y, first_voxel, end_voxel, simplex):
    """Return whether a solid or a plane meets any of the given voxels of a column.

    Args:
        voxels: the grid, as `Voxels`.
        solids: the solids, as `Solids`.
        planes: the infinite planes, as `Planes`.
        shape_index: the index of a solid, or the number of solids plus the index of a plane.
        x, y: the column's middle line [m].
        first_voxel: index of the first of these voxels, counted from the bottom.
        end_voxel: index past the last one.
        simplex: room for the iteration of GJK, see `allocate_simplex`.
    """
    bottom = voxels.bottom + first_voxel * voxels.res + TOUCH_DEPTH
    top = voxels.bottom + end_voxel * voxels.res - TOUCH_DEPTH
    prism = Prism(x, y, bottom, top, voxels.res / 2.0 - TOUCH_DEPTH, NOT_ROUND)
    num_solids = solids.geom.shape[0]
    if shape_index >= num_solids:
        return plane_meets_prism(planes, shape_index - num_solids, prism)
    if is_beside_prism(solids.bounds, shape_index, prism):
        return False
    return solid_meets_prism(solids, shape_index, prism, simplex) != APART


@subkernel(**NO_REFCOUNT)
def _fill_convex(voxels, solids, planes, shape_index, column, x, y, label, simplex):
    """Label the voxels of a column that a convex solid or a half-space meets.

    The arguments are as in `_meets`; `column` are the voxels of the column, and `label` is their
    new label.
    """
    first_voxel = np.int64(0)
    end_voxel = np.int64(column.shape[0])
    if shape_index < solids.geom.shape[0]:  # only as far as its box reaches
        box = solids.bounds[shape_index]
        num_voxels = float(column.shape[0])
        first_voxel = np.int64(max((box[2] - voxels.bottom) / voxels.res, 0.0))
        end_voxel = np.int64(math.ceil(min((box[5] - voxels.bottom) / voxels.res, num_voxels)))
    if first_voxel >= end_voxel or not _meets(
        voxels, solids, planes, shape_index, x, y, first_voxel, end_voxel, simplex
    ):
        return
    # bisect for the first voxel that is met: a range from `first_voxel` on is met if it contains it
    search_low = first_voxel
    search_high = end_voxel - 1
    while search_low < search_high:
        middle_voxel = (search_low + search_high) // 2
        if _meets(
            voxels, solids, planes, shape_index, x, y, first_voxel, middle_voxel + 1, simplex
        ):
            search_high = middle_voxel
        else:
            search_low = middle_voxel + 1
    first_voxel = search_low
    # and for the last one: the voxels from it on are met together
    search_high = end_voxel - 1
    while search_low < search_high:
        middle_voxel = (search_low + search_high + 1) // 2
        if _meets(voxels, solids, planes, shape_index, x, y, middle_voxel, end_voxel, simplex):
            search_low = middle_voxel
        else:
            search_high = middle_voxel - 1
    _label(column, first_voxel, search_low + 1, label)


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
    first_hit = hits.start[cell]
    end_hit = hits.start[cell + 1]
    for hit in range(first_hit, end_hit):
        if hits.closed[hit] == OPEN_SURFACE:
            continue
        geom = hits.geom[hit]
        winding_number = 0  # above the hit
        next_hit = hit + 1  # of the same geom
        for lower_hit in range(first_hit, hit + 1):
            if hits.geom[lower_hit] == geom and hits.closed[lower_hit] != OPEN_SURFACE:
                winding_number += 1 if hits.normal[lower_hit, 2] < 0.0 else -1
        while next_hit < end_hit and hits.geom[next_hit] != geom:
            next_hit += 1
        if winding_number > 0 and next_hit < end_hit:
            bottom_in_voxels = (hits.z[hit] - voxels.bottom) / voxels.res
            top_in_voxels = (hits.z[next_hit] - voxels.bottom) / voxels.res
            num_voxels = float(column.shape[0])
            first_voxel = math.ceil(min(max(bottom_in_voxels - 0.5, 0.0), num_voxels))
            end_voxel = math.ceil(min(max(top_in_voxels - 0.5, 0.0), num_voxels))
            _label(column, first_voxel, end_voxel, labels[geom])


@subkernel(**NO_REFCOUNT)
def _fill_triangle(voxels, lattice, window, triangle_copy, label, polygons, strip_polygon):
    """Label the voxels that a triangle meets.

    The triangle is clipped to each strip of columns with the same x; the rest of it is clipped to
    each column of the strip.

    Args:
        voxels: the grid, as `Voxels`.
        lattice: the lattice whose cells are the columns.
        window: only columns over these rows and columns of cells are filled, see `tile_window`.
        triangle_copy: the triangle, as `TriangleCopy`.
        label: the label of its geom.
        polygons: room for clipping, see `allocate_polygons`.
        strip_polygon: room for the triangle clipped to a strip, (12, 3) float64.
    """
    half_voxel = voxels.res / 2.0
    num_rows = lattice.height
    first_row, end_row, first_col, end_col = window_near_box(
        lattice, window, triangle_copy.box, 0, half_voxel
    )
    for col in range(first_col, end_col):
        x, _ = cell_center_at(lattice, first_row, col)
        x_limits = (x - half_voxel + TOUCH_DEPTH, x + half_voxel - TOUCH_DEPTH)
        num_strip_corners = clip_polygon_between(
            triangle_copy.corners,
            np.int64(3),
            polygons.scratch_polygon,
            X,
            x_limits,
            strip_polygon,
        )
        if num_strip_corners == 0:
            continue
        for row in range(first_row, end_row):
            _, y = cell_center_at(lattice, row, col)
            y_limits = (y - half_voxel + TOUCH_DEPTH, y + half_voxel - TOUCH_DEPTH)
            polygon = polygons.polygon
            num_corners = clip_polygon_between(
                strip_polygon, num_strip_corners, polygons.scratch_polygon, Y, y_limits, polygon
            )
            if num_corners > 0:
                lowest_z = polygon[0, 2]
                highest_z = polygon[0, 2]
                for corner in range(1, num_corners):
                    lowest_z = min(lowest_z, polygon[corner, 2])
                    highest_z = max(highest_z, polygon[corner, 2])
                column = voxels.values[col, num_rows - 1 - row]
                _fill_between(voxels, column, lowest_z, highest_z, label)


@kernel(nogil=True)
def fill_voxels(
    voxels, lattice, solids, facets, planes, tile_index, hits, labels, first_tile, end_tile
):
    """Label the voxels of the tiles ``range(first_tile, end_tile)`` that geoms meet.

    Args:
        voxels: the grid to fill, as `Voxels`.
        lattice: the lattice whose cells lie under the voxels: entry (i, j) of `voxels.values` is
            the stack of voxels over the cell at row ``ny - 1 - j``, column i.
        solids, facets, planes: the shapes, as `Solids`, `Facets` and `Planes`.
        tile_index: the solids and facets over each tile of the lattice.
        hits: hits of the columns' middle lines with the facets, as `ColumnHits`.
        labels: the label of each geom, by geom id, > 0, in the dtype of the grid's values. A voxel
            keeps the label that it has if that is lower.
        first_tile: number of the first tile.
        end_tile: number past the last one.
    """
    polygons = allocate_polygons()
    strip_polygon = np.empty((12, 3))
    simplex = allocate_simplex()
    triangle_copy = allocate_triangle()
    for tile in range(first_tile, end_tile):
        window = tile_window(lattice, tile)
        for row in range(window[0], window[1]):
            for col in range(window[2], window[3]):
                x, y = cell_center_at(lattice, row, col)
                column = voxels.values[col, lattice.height - 1 - row]
                for item in range(tile_index.solid_start[tile], tile_index.solid_start[tile + 1]):
                    solid = np.int64(tile_index.solid_indices[item])
                    label = labels[solids.geom[solid]]
                    _fill_convex(voxels, solids, planes, solid, column, x, y, label, simplex)
                for plane in range(planes.geom.shape[0]):
                    shape_index = solids.geom.shape[0] + plane
                    label = labels[planes.geom[plane]]
                    _fill_convex(voxels, solids, planes, shape_index, column, x, y, label, simplex)
                _fill_inside(voxels, column, hits, row * lattice.width + col, labels)
        for item in range(tile_index.triangle_start[tile], tile_index.triangle_start[tile + 1]):
            triangle = tile_index.triangle_indices[item]
            label = labels[facets.geom[triangle]]
            copy_triangle(facets, triangle, triangle_copy)
            _fill_triangle(voxels, lattice, window, triangle_copy, label, polygons, strip_polygon)
