"""Triangles over the cells' centres that they cover: which of them a vertical line crosses, where.

Each triangle visits the cells it covers, row by row, instead of each cell looking at all triangles
nearby: most triangles of a fine mesh cover no centre at all. A line is inside of a triangle by the
signs of its edge functions (Pineda, A parallel algorithm for polygon rasterization, 1988), as
MuJoCo's own rays are not used here: `mj_rayMesh` loses lines that run through a shared edge, and
stops at the first crossing. A line within RIM of an edge crosses the triangle.

The distance to an edge is the edge function by the edge's length. Both are rounded, and RIM is
exact, so the length is taken from the line's own point of view where it may decide; a line that is
twice as far from all edges as RIM is told without.
"""

import math

import numpy as np
from numba import njit

from navbake.baker.kernels.hits import AT_EDGE, INSIDE, RIM
from navbake.baker.kernels.tiles import cell_center, centers_between

# Edges shorter than this tell nothing without their own length [m]
SHORT = 1e-6
# No line is far from the edges by these
NEVER_FAR = (np.inf, np.inf, np.inf)
# Spans of a triangle's rows are worth computing where its box has more columns than this
NARROW = 4


@njit(inline="always")
def is_beside(box, x, y):
    """Whether a line is beside a box by more than RIM."""
    return x < box[0] - RIM or x > box[3] + RIM or y < box[1] - RIM or y > box[4] + RIM


@njit(inline="always")
def _far_of_edge(corners, i, j):
    """The edge function of a line that is twice as far from an edge as RIM."""
    length = math.hypot(corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1])
    return 2.0 * RIM * length if length > SHORT else np.inf


@njit(inline="always")
def _far_of_edges(corners):
    """What edge functions are surely further from zero than RIM, opposite to each corner."""
    return (
        _far_of_edge(corners, 1, 2),
        _far_of_edge(corners, 2, 0),
        _far_of_edge(corners, 0, 1),
    )


@njit(inline="always")
def _cross_triangle(corners, x, y, far):
    """Where the line at (x, y) crosses a triangle, and whether it does.

    `far` is what `_far_of_edges` says, or NEVER_FAR. Returns 0 for nowhere, 1 for
    inside, 2 for within RIM of an edge; and the height.
    """
    ax, ay = corners[0, 0] - x, corners[0, 1] - y
    bx, by = corners[1, 0] - x, corners[1, 1] - y
    cx, cy = corners[2, 0] - x, corners[2, 1] - y
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
    z0, z1, z2 = corners[0, 2], corners[1, 2], corners[2, 2]
    z = (u * z0 + v * z1 + w * z2) / (u + v + w)
    z = min(max(z, min(z0, z1, z2)), max(z0, z1, z2))
    return place, z


@njit(inline="always")
def hit_triangle(facets, t, x, y, far, hits, at):
    """Note that a line crosses a triangle, at a place of the hits; returns how often, 0 or 1."""
    place, z = _cross_triangle(facets.corners[t], x, y, far)
    if place == 0:
        return 0
    hits.z[at] = z
    for axis in range(3):
        hits.normal[at, axis] = facets.normal[t, axis]
    hits.geom[at] = facets.geom[t]
    hits.closed[at] = facets.closed[t]
    hits.facet[at] = t
    hits.at_edge[at] = AT_EDGE if place == 2 else INSIDE
    return 1


@njit(inline="always")
def _span_of_row(corners, box, y, far):
    """Between which x a triangle may be crossed at some y: where its edge functions allow it."""
    low, high = box[0] - RIM, box[3] + RIM
    x0, y0 = corners[0, 0], corners[0, 1]
    area = (corners[1, 0] - x0) * (corners[2, 1] - y0) - (corners[2, 0] - x0) * (corners[1, 1] - y0)
    turn = 1.0 if area > 0.0 else -1.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        bx, by = corners[i, 0] - box[0], corners[i, 1] - y
        cx, cy = corners[j, 0] - box[0], corners[j, 1] - y
        # the edge function at the box's side, and how it grows along the row
        at_side, growth = turn * (bx * cy - cx * by), turn * (corners[i, 1] - corners[j, 1])
        if growth > 0.0:
            low = max(low, box[0] - (at_side + far[k]) / growth)
        elif growth < 0.0:
            high = min(high, box[0] - (at_side + far[k]) / growth)
    return low, high


@njit(cache=True)
def raster_triangle(facets, t, lattice, rows, hits, end, writing):
    """Note that the lines of the centres that a triangle covers cross it.

    Args:
        rows: the first of the rows that are asked about, and past the last.
        hits: those of the rows' lines.
        end: for each line of the rows, where its next hit goes; is advanced.
        writing: whether hits go there; else they are only counted, and their place is the first.
    """
    if facets.normal[t, 2] == 0.0:
        return
    box, corners = facets.bounds[t], facets.corners[t]
    y_max, x_min, cell = lattice.y_max, lattice.x_min, lattice.cell_size
    first, last = centers_between(y_max - box[4] - RIM, y_max - box[1] + RIM, cell, lattice.height)
    first, last = max(first, rows[0]), min(last, rows[1] - 1)
    left, right = centers_between(box[0] - RIM - x_min, box[3] + RIM - x_min, cell, lattice.width)
    far = _far_of_edges(corners)
    is_wide = right - left >= NARROW
    for row in range(first, last + 1):
        begin, stop = left, right
        y = cell_center(lattice, row * lattice.width)[1]
        if is_wide:
            low, high = _span_of_row(corners, box, y, far)
            begin, stop = centers_between(low - x_min, high - x_min, cell, lattice.width)
        for col in range(begin, stop + 1):
            x = cell_center(lattice, col)[0]
            if is_beside(box, x, y):
                continue
            line = (row - rows[0]) * lattice.width + col
            place = end[line] if writing else 0
            end[line] += hit_triangle(facets, t, x, y, far, hits, place)
