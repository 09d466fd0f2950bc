"""Triangles over the cells' centres that they cover: which of them a vertical line crosses, where.

Each triangle visits the cells it covers, row by row: most triangles of a fine mesh cover no centre
at all. A line is inside of a triangle by the signs of its edge functions (Pineda, A parallel
algorithm for polygon rasterization, 1988). `mj_rayMesh` is not used, as it loses lines that run
through a shared edge, and stops at the first crossing. A line within RIM of an edge crosses the
triangle; its distance is the edge function by the edge's length, both of coordinates relative to
the line, which keeps rounding small. Lines twice as far as RIM need no length.
"""

import math

import numpy as np

from navbake.baker.columns.hit_kernels import AT_EDGE, INSIDE, RIM
from navbake.baker.core.tiles import cell_center, centers_between
from navbake.baker.geometry.triangle_kernels import unit_normal
from navbake.compiled import NO_REFCOUNT, subkernel

# Lines are never surely far from edges shorter than this [m]
SHORT = 1e-6
# No line is far from the edges by these
NEVER_FAR = (np.inf, np.inf, np.inf)
# Spans of a triangle's rows are worth computing where its box has more columns than this
NARROW = 4


@subkernel(inline="always")
def is_beside(boxes, i, x, y):
    """Whether a line is beside the i-th box by more than RIM."""
    return (
        x < boxes[i, 0] - RIM
        or x > boxes[i, 3] + RIM
        or y < boxes[i, 1] - RIM
        or y > boxes[i, 4] + RIM
    )


@subkernel(inline="always")
def _far_of_edge(corners, t, i, j):
    """The edge function of a line that is twice as far from an edge as RIM."""
    dx = corners[t, j, 0] - corners[t, i, 0]
    dy = corners[t, j, 1] - corners[t, i, 1]
    length = math.sqrt(dx * dx + dy * dy)
    return 2.0 * RIM * length if length > SHORT else np.inf


@subkernel(inline="always")
def _cross_triangle(corners, t, x, y, far):
    """Whether a line crosses a triangle: 0 for no, 1 inside, 2 within RIM of an edge; and how high.

    `far` are `_far_of_edge` of the edges opposite the corners, or NEVER_FAR.
    """
    ax = corners[t, 0, 0] - x
    ay = corners[t, 0, 1] - y
    bx = corners[t, 1, 0] - x
    by = corners[t, 1, 1] - y
    cx = corners[t, 2, 0] - x
    cy = corners[t, 2, 1] - y
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if abs(area) < 1e-14:
        return 0, 0.0
    # edge functions: twice the areas that (x, y) spans with the edges, all of one sign inside
    turn = 1.0 if area > 0.0 else -1.0
    u = turn * (bx * cy - cx * by)
    v = turn * (cx * ay - ax * cy)
    w = turn * (ax * by - bx * ay)
    if u < -far[0] or v < -far[1] or w < -far[2]:
        return 0, 0.0
    place = 1
    if u <= far[0] or v <= far[1] or w <= far[2]:
        # distance to an edge = edge function / edge length
        du = u / math.hypot(cx - bx, cy - by)
        dv = v / math.hypot(ax - cx, ay - cy)
        dw = w / math.hypot(bx - ax, by - ay)
        nearest = min(du, dv, dw)
        if nearest < -RIM:
            return 0, 0.0
        if nearest <= RIM:
            place = 2
    z0 = corners[t, 0, 2]
    z1 = corners[t, 1, 2]
    z2 = corners[t, 2, 2]
    z = (u * z0 + v * z1 + w * z2) / (u + v + w)
    z = min(max(z, min(z0, z1, z2)), max(z0, z1, z2))
    return place, z


@subkernel(inline="always")
def hit_triangle(corners, n, facets, t, x, y, far, hits, at, writing):
    """Whether a line crosses a triangle that isn't upright, 0 or 1; notes the hit if `writing`.

    Its corners are the n-th of some, in the frame of the line.
    """
    place, z = _cross_triangle(corners, n, x, y, far)
    if place == 0:
        return 0
    if not writing:
        return 1
    nx, ny, nz = unit_normal(corners, n)
    hits.z[at] = z
    hits.normal[at, 0] = nx
    hits.normal[at, 1] = ny
    hits.normal[at, 2] = nz
    hits.geom[at] = facets.geom[t]
    hits.closed[at] = facets.closed[t]
    hits.facet[at] = t
    hits.at_edge[at] = AT_EDGE if place == 2 else INSIDE
    return 1


@subkernel(inline="always")
def _span_of_row(corners, t, left, right, y, far):
    """Between which x a triangle may be crossed at some y, within (left, right) [m].

    Edge functions are linear along a row, so each bounds the span.
    """
    x0 = corners[t, 0, 0]
    y0 = corners[t, 0, 1]
    area = (corners[t, 1, 0] - x0) * (corners[t, 2, 1] - y0)
    area -= (corners[t, 2, 0] - x0) * (corners[t, 1, 1] - y0)
    turn = 1.0 if area > 0.0 else -1.0
    low = left
    high = right
    for k in range(3):
        i = (k + 1) % 3
        j = (k + 2) % 3
        bx = corners[t, i, 0] - left
        by = corners[t, i, 1] - y
        cx = corners[t, j, 0] - left
        cy = corners[t, j, 1] - y
        at_left = turn * (bx * cy - cx * by)
        growth = turn * (corners[t, i, 1] - corners[t, j, 1])
        if growth > 0.0:
            low = max(low, left - (at_left + far[k]) / growth)
        elif growth < 0.0:
            high = min(high, left - (at_left + far[k]) / growth)
    return low, high


@subkernel(**NO_REFCOUNT)
def raster_triangles(facets, listed, is_crossed, lattice, rows, hits, end, writing):
    """Note that the lines of the centres that triangles cover cross them.

    Args:
        listed: the triangles, ascending.
        is_crossed: of each, whether any of the lines crosses it, bool; is written while counting.
        rows: the first of the rows that are asked about, and past the last.
        hits: those of the rows' lines.
        end: for each line of the rows, where its next hit goes; is advanced.
        writing: else hits are only counted.
    """
    corners = facets.corners
    bounds = facets.bounds
    y_max = lattice.y_max
    x_min = lattice.x_min
    cell = lattice.cell_size
    width = lattice.width
    height = lattice.height
    for i in range(listed.shape[0]):
        t = listed[i]
        count = 0
        if (writing and not is_crossed[i]) or (not writing and facets.facing[t] == 0):
            is_crossed[i] = False
            continue
        top = bounds[t, 4] + RIM
        bottom = bounds[t, 1] - RIM
        first, last = centers_between(y_max - top, y_max - bottom, cell, height)
        x0 = bounds[t, 0] - RIM
        x1 = bounds[t, 3] + RIM
        begin, stop = centers_between(x0 - x_min, x1 - x_min, cell, width)
        is_wide = stop - begin >= NARROW
        far = (
            _far_of_edge(corners, t, 1, 2),
            _far_of_edge(corners, t, 2, 0),
            _far_of_edge(corners, t, 0, 1),
        )
        for row in range(max(first, rows[0]), min(last, rows[1] - 1) + 1):
            y = cell_center(lattice, row * width)[1]
            if is_wide:
                low, high = _span_of_row(corners, t, x0, x1, y, far)
                begin, stop = centers_between(low - x_min, high - x_min, cell, width)
            for col in range(begin, stop + 1):
                x = cell_center(lattice, col)[0]
                if not is_beside(bounds, t, x, y):
                    line = (row - rows[0]) * width + col
                    place = end[line] if writing else 0
                    found = hit_triangle(corners, t, facets, t, x, y, far, hits, place, writing)
                    end[line] += found
                    count += found
        is_crossed[i] = count > 0
