"""Filling voxels column by column, from the heights that each geom has over a column's square.

What a solid, a half-space or a triangle has over a square is one span of heights, so a column
costs one calculation, not one a voxel. The inside of closed surfaces follows by the winding rule
from a line through the column's middle, with the crossings noted per voxel and summed up from
below (scan conversion of solids: Lee and Requicha, 1982). Voxels are narrowed by `touch` on all
sides: what reaches in by less only touches. Where several geoms meet a voxel the least label
stays, in whatever order they come.

The hard step is a line through an edge: both triangles have to agree which of them it crosses.
`_side` breaks the tie by an infinitesimal shift of the line (simulation of simplicity, Edelsbrunner
and Muecke, 1990). What rounding still tears open shows as crossings that don't add up to 0, and
the column is asked again on another line.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import CONVEX_SOLID, OPEN_SURFACE
from navbake.baker.kernels.overlap import Polygons, X, Y, clip_between, make_polygons
from navbake.baker.kernels.tiles import TILE
from navbake.baker.voxelize.kernels.spans import Square, plane_span, polygon_span, solid_span
from navbake.baker.voxelize.kernels.tiles import touched
from navbake.compiled import kernel, part
from navbake.types import Float, Int, Int32

# A triangle this little beside a column is looked at, because rounding may have put it there
MARGIN = 1e-3  # [voxels]
# Where a line is moved to when it ran through an edge and rounding lost a crossing [voxels]
ASIDE = np.array([[0, 0], [0.137, 0.071], [-0.093, 0.119], [0.061, -0.143], [-0.127, -0.083]])


class Voxels(NamedTuple):
    """A grid that is filled.

    Attributes:
        values: (nx, ny, nz), unsigned integers, 0 for empty.
        origin: its lower corner, (3,) float64 [m].
        res: edge of a voxel [m].
        touch: by how much voxels are narrowed on all sides [m].
    """

    values: NDArray[Any]
    origin: Float
    res: float
    touch: float


class Patch(NamedTuple):
    """Columns ``[i0, i1)`` along x and ``[j0, j1)`` along y."""

    i0: int
    i1: int
    j0: int
    j1: int


class Scratch(NamedTuple):
    """What one geom's triangles leave over the columns of a tile, and room to clip in.

    Attributes:
        spans: (TILE, TILE, 2) float64, the heights of a convex solid [m].
        winding: (TILE, TILE, nz + 1) int32, crossings by the first voxel whose middle is above.
        reaches: (TILE, TILE, 2) int64, the first and last entry of `winding` that may not be 0.
        polygons: two polygons, and strip: another, (12, 3) float64.
    """

    spans: Float
    winding: Int32
    reaches: Int
    polygons: Polygons
    strip: Float


@part
def _label(voxels, i, j, first, last, label):
    """Label the voxels of a column from first to before last; the least label stays."""
    values = voxels.values
    for k in range(first, last):
        if values[i, j, k] == 0 or values[i, j, k] > label:
            values[i, j, k] = label


@part
def _fill_span(voxels, i, j, span, label):
    """Label the voxels of a column that a span of heights meets."""
    num, bottom = voxels.values.shape[2], voxels.origin[2]
    start = (span[0] + voxels.touch - bottom) / voxels.res
    end = (span[1] - voxels.touch - bottom) / voxels.res
    if start < num and end > 0.0:
        first = math.floor(start) if start > 0.0 else 0
        last = math.ceil(end) if end < num else num
        _label(voxels, i, j, first, last, label)


@part
def _square(voxels, i, j):
    """The cross-section of a column, narrowed."""
    x, y = voxels.origin[0] + i * voxels.res, voxels.origin[1] + j * voxels.res
    res, touch = voxels.res, voxels.touch
    return Square(x + touch, x + res - touch, y + touch, y + res - touch)


@part
def _columns_under(voxels, tile, low_x, high_x, low_y, high_y):
    """The columns of a tile under a rectangle."""
    origin, res = voxels.origin, voxels.res
    i0, i1 = touched(low_x, high_x, origin[0] + tile.i0 * res, res, tile.i1 - tile.i0)
    j0, j1 = touched(low_y, high_y, origin[1] + tile.j0 * res, res, tile.j1 - tile.j0)
    return Patch(tile.i0 + i0, tile.i0 + i1 + 1, tile.j0 + j0, tile.j0 + j1 + 1)


@part(inline="always")
def _fill_solid(voxels, tile, solids, s, label, polygons):
    box = solids.bounds[s]
    patch = _columns_under(voxels, tile, box[0], box[3], box[1], box[4])
    for i in range(patch.i0, patch.i1):
        for j in range(patch.j0, patch.j1):
            span = solid_span(solids, s, _square(voxels, i, j), polygons)
            _fill_span(voxels, i, j, span, label)


@part(inline="always")
def _fill_plane(voxels, tile, planes, p, label):
    for i in range(tile.i0, tile.i1):
        for j in range(tile.j0, tile.j1):
            _fill_span(voxels, i, j, plane_span(planes, p, _square(voxels, i, j)), label)


@part
def _side(ax, ay, bx, by, px, py):
    """On which side of the line from a to b a point is: 1 left, -1 right, 0 where a is b.

    The same but for the sign, to the bit, for the line from b to a; a point on the line counts
    as moved by a hair along x, and by a hair of that along y.
    """
    swap = ax > bx or (ax == bx and ay > by)
    if swap:
        ax, ay, bx, by = bx, by, ax, ay
    cross = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    if cross == 0.0:
        cross = ay - by
    if cross == 0.0:
        cross = bx - ax
    if cross == 0.0:
        return 0
    return -1 if (cross > 0.0) == swap else 1


@part
def _crossing(c, x, y):
    """How the upright line at (x, y) crosses a triangle: 1 if it faces up there, -1, or 0."""
    side = _side(c[0, 0], c[0, 1], c[1, 0], c[1, 1], x, y)
    if side == 0 or side != _side(c[1, 0], c[1, 1], c[2, 0], c[2, 1], x, y):
        return 0
    return side if side == _side(c[2, 0], c[2, 1], c[0, 0], c[0, 1], x, y) else 0


@part(inline="always")
def _height_at(c, x, y):
    """The height of a triangle at (x, y) inside of it."""
    ax, ay = c[0, 0] - x, c[0, 1] - y
    bx, by = c[1, 0] - x, c[1, 1] - y
    cx, cy = c[2, 0] - x, c[2, 1] - y
    u, v, w = bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay
    low, high = polygon_span(c, 3)
    total = u + v + w
    if total == 0.0:
        return low
    return min(max((u * c[0, 2] + v * c[1, 2] + w * c[2, 2]) / total, low), high)


@part
def _note_crossing(voxels, c, x, y, winding, reach):
    """Add a triangle's crossing of a column's line at the first voxel with its middle above."""
    side = _crossing(c, x, y)
    if side != 0:
        above = (_height_at(c, x, y) - voxels.origin[2]) / voxels.res + 0.5
        last = winding.shape[0] - 1
        k = 0 if above < 0.0 else (last if above >= last else int(above))
        winding[k] -= side
        reach[0], reach[1] = min(reach[0], k), max(reach[1], k)


@part(inline="always")
def _columns_in_strip(voxels, tile, square, strip, num):
    """The columns that a polygon in a strip of one x may lie over."""
    low, high = strip[0, 1], strip[0, 1]
    for n in range(1, num):
        low, high = min(low, strip[n, 1]), max(high, strip[n, 1])
    margin = MARGIN * voxels.res
    return _columns_under(voxels, tile, square.x0, square.x1, low - margin, high + margin)


@part
def _add_triangle(voxels, tile, c, closed, label, scratch):
    """Fill what one triangle meets, and note what its geom needs to be filled.

    The triangle is clipped to each strip of one x first, and what is left to each column of it.
    """
    one, other, strip = scratch.polygons.one, scratch.polygons.other, scratch.strip
    x_low, x_high = min(c[0, 0], c[1, 0], c[2, 0]), max(c[0, 0], c[1, 0], c[2, 0])
    y_low, y_high = min(c[0, 1], c[1, 1], c[2, 1]), max(c[0, 1], c[1, 1], c[2, 1])
    patch = _columns_under(voxels, tile, x_low, x_high, y_low, y_high)
    for i in range(patch.i0, patch.i1):
        square = _square(voxels, i, 0)
        num = clip_between(c, c.shape[0], other, X, (square.x0, square.x1), strip)
        if num == 0:
            continue
        part = _columns_in_strip(voxels, tile, square, strip, num)
        for j in range(part.j0, part.j1):
            a, b = i - tile.i0, j - tile.j0
            square = _square(voxels, i, j)
            left = clip_between(strip, num, other, Y, (square.y0, square.y1), one)
            if left > 0:
                low, high = polygon_span(one, left)
                if closed == CONVEX_SOLID:
                    span = scratch.spans[a, b]
                    span[0], span[1] = min(span[0], low), max(span[1], high)
                else:
                    _fill_span(voxels, i, j, (low, high), label)
            x, y = (square.x0 + square.x1) / 2.0, (square.y0 + square.y1) / 2.0
            is_noted = closed != OPEN_SURFACE and closed != CONVEX_SOLID
            if is_noted and x_low <= x <= x_high and y_low <= y <= y_high:
                _note_crossing(voxels, c, x, y, scratch.winding[a, b], scratch.reaches[a, b])


@part(inline="always")
def _close_column(voxels, items, triangles, x, y, winding, reach):
    """See to it that a column's crossings add up to 0, on another line if one was lost."""
    for attempt in range(1, ASIDE.shape[0]):
        left = 0
        for k in range(reach[0], reach[1] + 1):
            left += winding[k]
        if left == 0:
            break
        for k in range(reach[0], reach[1] + 1):
            winding[k] = 0
        aside_x, aside_y = x + ASIDE[attempt, 0] * voxels.res, y + ASIDE[attempt, 1] * voxels.res
        for t in items:
            if triangles.closed[t] != OPEN_SURFACE:
                _note_crossing(voxels, triangles.corners[t], aside_x, aside_y, winding, reach)


@part(inline="always")
def _fill_inside(voxels, tile, items, triangles, label, scratch):
    """Fill the inside of a closed surface from its crossings, column by column; clear them."""
    num = voxels.values.shape[2]
    for i in range(tile.i0, tile.i1):
        for j in range(tile.j0, tile.j1):
            a, b = i - tile.i0, j - tile.j0
            winding, reach = scratch.winding[a, b], scratch.reaches[a, b]
            square = _square(voxels, i, j)
            x, y = (square.x0 + square.x1) / 2.0, (square.y0 + square.y1) / 2.0
            _close_column(voxels, items, triangles, x, y, winding, reach)
            inside = 0
            for k in range(reach[0], reach[1] + 1):
                inside += winding[k]
                winding[k] = 0
                if inside > 0 and k < num:
                    _label(voxels, i, j, k, k + 1, label)
            reach[0], reach[1] = num, -1


@part
def _fill_triangles(voxels, tile, items, triangles, label, scratch):
    """Fill what the triangles of one geom meet and enclose within a tile."""
    scratch.spans[:, :, 0], scratch.spans[:, :, 1] = math.inf, -math.inf
    is_convex, encloses = False, False
    for t in items:
        closed = triangles.closed[t]
        is_convex |= closed == CONVEX_SOLID
        encloses |= closed != OPEN_SURFACE
        _add_triangle(voxels, tile, triangles.corners[t], closed, label, scratch)
    if is_convex:
        for i in range(tile.i0, tile.i1):
            for j in range(tile.j0, tile.j1):
                low, high = scratch.spans[i - tile.i0, j - tile.j0]
                if low <= high:
                    _fill_span(voxels, i, j, (low, high), label)
    elif encloses:
        _fill_inside(voxels, tile, items, triangles, label, scratch)


@part(inline="always")
def _fill_geoms(voxels, tile, items, triangles, labels, polygons):
    """Label what a tile's triangles meet and enclose, geom by geom."""
    num = voxels.values.shape[2]
    scratch = Scratch(
        np.empty((TILE, TILE, 2)),
        np.zeros((TILE, TILE, num + 1), np.int32),
        np.empty((TILE, TILE, 2), np.int64),
        polygons,
        np.empty((12, 3)),
    )
    scratch.reaches[:, :, 0], scratch.reaches[:, :, 1] = num, -1
    first, end = 0, items.shape[0]
    while first < end:
        geom = triangles.geom[items[first]]
        last = first + 1
        while last < end and triangles.geom[items[last]] == geom:
            last += 1
        part = items[first:last]
        _fill_triangles(voxels, tile, part, triangles, labels[geom], scratch)
        first = last


@part
def _fill_tile(voxels, number, tile, solids, planes, triangles, tiles, labels):
    """Label the voxels of one tile."""
    polygons = make_polygons()
    for s in tiles.solid_item[tiles.solid_start[number] : tiles.solid_start[number + 1]]:
        _fill_solid(voxels, tile, solids, s, labels[solids.geom[s]], polygons)
    for p in range(planes.geom.shape[0]):
        _fill_plane(voxels, tile, planes, p, labels[planes.geom[p]])
    first, last = tiles.triangle_start[number], tiles.triangle_start[number + 1]
    if last > first:
        items = tiles.triangle_item[first:last]
        _fill_geoms(voxels, tile, items, triangles, labels, polygons)


@kernel(nogil=True)
def fill_voxels(voxels, solids, planes, triangles, tiles, labels, first, end):
    """Label the voxels of some tiles that geoms meet; labels are added to what the grid holds.

    Args:
        solids, planes, triangles: the geometry; the triangles sorted by geom.
        tiles: what lies over each tile of columns.
        labels: by geom id, > 0, in the dtype of the grid's values.
        first, end: which tiles.
    """
    tiles_y = (voxels.values.shape[1] + TILE - 1) // TILE
    for number in range(first, end):
        i, j = number // tiles_y * TILE, number % tiles_y * TILE
        num_x, num_y, _ = voxels.values.shape
        tile = Patch(i, min(i + TILE, num_x), j, min(j + TILE, num_y))
        _fill_tile(voxels, number, tile, solids, planes, triangles, tiles, labels)
