"""Fill voxels, column by column, with the labels of the geoms that meet them.

A convex solid or a half-space meets one run of a column's voxels; both ends are found by bisection
with the tests of occupancy (see `solids` and `overlap`). A triangle is clipped to the column's
square, and meets the voxels between its lowest and its highest point there. A voxel that no
triangle of a closed surface meets is inside of it as its centre is, by the winding number of the
column's middle line (scan conversion of solids: Lee and Requicha, 1982).

Voxels are narrowed by TOUCH_DEPTH on all sides: what reaches in by less only touches. Where several
geoms meet a voxel the least label stays, in any order.
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
    """A grid that is filled.

    Attributes:
        values: (nx, ny, nz), unsigned integers, 0 for empty.
        bottom: its lower end [m].
        res: edge of a voxel [m].
    """

    values: NDArray[Any]
    bottom: float
    res: float


@subkernel(**NO_REFCOUNT)
def _label(column, first, end, label):
    """Label voxels of a column; the least label stays."""
    for k in range(first, end):
        if column[k] == 0 or column[k] > label:
            column[k] = label


@subkernel(**NO_REFCOUNT)
def _fill_between(voxels, column, low, high, label):
    """Label the voxels of a column that a span of heights meets."""
    num = column.shape[0]
    start = (low + TOUCH_DEPTH - voxels.bottom) / voxels.res
    end = (high - TOUCH_DEPTH - voxels.bottom) / voxels.res
    if start < num and end > 0.0:
        first = math.floor(start) if start > 0.0 else 0
        _label(column, first, math.ceil(end) if end < num else num, label)


@subkernel(**NO_REFCOUNT)
def _meets(voxels, solids, planes, item, x, y, first, end, simplex):
    """Whether a solid or, numbered after these, a plane meets voxels ``[first, end)`` at (x, y)."""
    low = voxels.bottom + first * voxels.res + TOUCH_DEPTH
    high = voxels.bottom + end * voxels.res - TOUCH_DEPTH
    prism = Prism(x, y, low, high, voxels.res / 2.0 - TOUCH_DEPTH, NOT_ROUND)
    num = solids.geom.shape[0]
    if item >= num:
        return plane_meets_prism(planes, item - num, prism)
    if is_beside_prism(solids.bounds, item, prism):
        return False
    return solid_meets_prism(solids, item, prism, simplex) != APART


@subkernel(**NO_REFCOUNT)
def _fill_convex(voxels, solids, planes, item, column, x, y, label, simplex):
    """Label the voxels of a column that a solid or a half-space meets, see `_meets`."""
    first = np.int64(0)
    end = np.int64(column.shape[0])
    if item < solids.geom.shape[0]:  # not beyond what it reaches
        box = solids.bounds[item]
        most = float(column.shape[0])
        first = np.int64(max((box[2] - voxels.bottom) / voxels.res, 0.0))
        end = np.int64(math.ceil(min((box[5] - voxels.bottom) / voxels.res, most)))
    if first >= end or not _meets(voxels, solids, planes, item, x, y, first, end, simplex):
        return
    low = first
    high = end - 1
    while low < high:  # the first one is met by what reaches up to it
        middle = (low + high) // 2
        if _meets(voxels, solids, planes, item, x, y, first, middle + 1, simplex):
            high = middle
        else:
            low = middle + 1
    first = low
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
    """Label the voxels of a column whose middles closed surfaces enclose."""
    first = hits.start[cell]
    last = hits.start[cell + 1]
    for i in range(first, last):
        if hits.closed[i] == OPEN_SURFACE:
            continue
        geom = hits.geom[i]
        inside = 0
        after = i + 1
        for j in range(first, i + 1):
            if hits.geom[j] == geom and hits.closed[j] != OPEN_SURFACE:
                inside += 1 if hits.normal[j, 2] < 0.0 else -1
        while after < last and hits.geom[after] != geom:
            after += 1
        if inside > 0 and after < last:
            start = (hits.z[i] - voxels.bottom) / voxels.res
            end = (hits.z[after] - voxels.bottom) / voxels.res
            num = float(column.shape[0])
            low = math.ceil(min(max(start - 0.5, 0.0), num))
            _label(column, low, math.ceil(min(max(end - 0.5, 0.0), num)), labels[geom])


@subkernel(**NO_REFCOUNT)
def _fill_triangle(voxels, lattice, window, facets, t, label, polygons, strip):
    """Label the voxels that a triangle meets; it is clipped to each strip of columns first."""
    half = voxels.res / 2.0
    num_rows = lattice.height
    row0, row1, col0, col1 = window_near_box(lattice, window, facets.bounds, t, half)
    for col in range(col0, col1):
        x, _ = cell_center_at(lattice, row0, col)
        between = x - half + TOUCH_DEPTH, x + half - TOUCH_DEPTH
        num = clip_between(facets.corners[t], np.int64(3), polygons.other, X, between, strip)
        if num == 0:
            continue
        for row in range(row0, row1):
            _, y = cell_center_at(lattice, row, col)
            between = y - half + TOUCH_DEPTH, y + half - TOUCH_DEPTH
            left = clip_between(strip, num, polygons.other, Y, between, polygons.one)
            if left > 0:
                low = polygons.one[0, 2]
                high = polygons.one[0, 2]
                for i in range(1, left):
                    low = min(low, polygons.one[i, 2])
                    high = max(high, polygons.one[i, 2])
                column = voxels.values[col, num_rows - 1 - row]
                _fill_between(voxels, column, low, high, label)


@kernel(nogil=True)
def fill_voxels(
    voxels, lattice, solids, facets, planes, tiles, hits, labels, first_tile, end
):  # fmt: skip
    """Label the voxels of the tiles ``range(first_tile, end)`` that geoms meet.

    Args:
        lattice: of the voxels' columns: column (i, j) is the cell at row ``ny - 1 - j``, column i.
        tiles: what lies over each tile of the lattice.
        hits: of the columns' middle lines with the triangles.
        labels: by geom id, > 0, in the dtype of the grid's values. A voxel keeps the least of those
            that meet it and of its own, unless that is 0; labels are neither summed nor ORed.
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
                for n in range(tiles.solid_start[tile], tiles.solid_start[tile + 1]):
                    s = np.int64(tiles.solid_item[n])
                    label = labels[solids.geom[s]]
                    _fill_convex(voxels, solids, planes, s, column, x, y, label, simplex)
                for p in range(planes.geom.shape[0]):
                    item = solids.geom.shape[0] + p
                    label = labels[planes.geom[p]]
                    _fill_convex(voxels, solids, planes, item, column, x, y, label, simplex)
                _fill_inside(voxels, column, hits, row * lattice.width + col, labels)
        for n in range(tiles.triangle_start[tile], tiles.triangle_start[tile + 1]):
            t = tiles.triangle_item[n]
            label = labels[facets.geom[t]]
            _fill_triangle(voxels, lattice, window, facets, t, label, polygons, strip)
