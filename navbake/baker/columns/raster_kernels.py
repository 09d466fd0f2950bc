"""Find which triangles the vertical lines through cells' centres cross, and at which height.

For each triangle, the cells that it covers are visited row by row; most triangles of a fine mesh
cover no centre at all. Signs of edge functions tell whether a line is inside of a triangle (Pineda,
A parallel algorithm for polygon rasterization, 1988). `mj_rayMesh` is not used, as it loses lines
that run through a shared edge, and stops at the first crossing.

A line at most RIM_WIDTH outside of an edge crosses the triangle, too. Its distance to the edge is
the edge function divided by the edge's length; coordinates are relative to the line, which keeps
rounding small. If the line is farther than twice RIM_WIDTH, the edge function alone decides.
"""

import math

import numpy as np

from navbake.baker.columns.hit_kernels import AT_EDGE, INSIDE, RIM_WIDTH
from navbake.baker.core.tiles import cell_center, find_centers_between
from navbake.baker.geometry.triangle_kernels import copy_triangle, unit_normal
from navbake.compiled import NO_REFCOUNT, subkernel

# For edges shorter than this, the distance is always computed [m]
SHORT_EDGE = 1e-6
# If the first and the last column under a triangle's box are at least this far apart, they are
# computed anew for each row [cells]
MIN_COLUMNS_FOR_SPANS = 4


@subkernel(inline="always")
def is_beside(boxes, box, x, y):
    """Return whether a vertical line passes a box at a distance of more than RIM_WIDTH.

    Args:
        boxes: (n, 6) float64, lower corner, upper corner [m].
        box: index of the box.
        x, y: the line [m].
    """
    return (
        x < boxes[box, 0] - RIM_WIDTH
        or x > boxes[box, 3] + RIM_WIDTH
        or y < boxes[box, 1] - RIM_WIDTH
        or y > boxes[box, 4] + RIM_WIDTH
    )


@subkernel(inline="always")
def _edge_limit(corners, first_corner, second_corner):
    """Return the edge function of points at twice RIM_WIDTH from a triangle's edge.

    The edge function of a point is its distance to the edge times the edge's length [m²]. For an
    edge shorter than SHORT_EDGE, inf is returned.
    """
    dx = corners[second_corner, 0] - corners[first_corner, 0]
    dy = corners[second_corner, 1] - corners[first_corner, 1]
    length = math.sqrt(dx * dx + dy * dy)
    return 2.0 * RIM_WIDTH * length if length > SHORT_EDGE else np.inf


@subkernel(inline="always")
def find_edge_limits(corners):
    """Return the `_edge_limit` of the edges opposite to corners 0, 1 and 2 of a triangle [m²]."""
    return (
        _edge_limit(corners, 1, 2),
        _edge_limit(corners, 2, 0),
        _edge_limit(corners, 0, 1),
    )


@subkernel(inline="always")
def cross_triangle(corners, x, y, edge_limits):
    """Return whether the vertical line at (x, y) crosses a triangle, and at which height [m].

    The first number is 0 for no crossing, 1 for a crossing inside, 2 for a crossing at most
    RIM_WIDTH from an edge. `edge_limits` are the triangle's, see `find_edge_limits`.
    """
    ax = corners[0, 0] - x
    ay = corners[0, 1] - y
    bx = corners[1, 0] - x
    by = corners[1, 1] - y
    cx = corners[2, 0] - x
    cy = corners[2, 1] - y
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if abs(area) < 1e-14:
        return 0, 0.0
    # edge functions: twice the areas that (x, y) spans with the edges, all of one sign inside
    winding_sign = 1.0 if area > 0.0 else -1.0
    edge_function_a = winding_sign * (bx * cy - cx * by)
    edge_function_b = winding_sign * (cx * ay - ax * cy)
    edge_function_c = winding_sign * (ax * by - bx * ay)
    if (
        edge_function_a < -edge_limits[0]
        or edge_function_b < -edge_limits[1]
        or edge_function_c < -edge_limits[2]
    ):
        return 0, 0.0
    crossing_kind = 1
    if (
        edge_function_a <= edge_limits[0]
        or edge_function_b <= edge_limits[1]
        or edge_function_c <= edge_limits[2]
    ):
        # distance to an edge = edge function / edge length
        distance_a = edge_function_a / math.hypot(cx - bx, cy - by)
        distance_b = edge_function_b / math.hypot(ax - cx, ay - cy)
        distance_c = edge_function_c / math.hypot(bx - ax, by - ay)
        least_distance = min(distance_a, distance_b, distance_c)
        if least_distance < -RIM_WIDTH:
            return 0, 0.0
        if least_distance <= RIM_WIDTH:
            crossing_kind = 2
    z0 = corners[0, 2]
    z1 = corners[1, 2]
    z2 = corners[2, 2]
    z = (edge_function_a * z0 + edge_function_b * z1 + edge_function_c * z2) / (
        edge_function_a + edge_function_b + edge_function_c
    )
    z = min(max(z, min(z0, z1, z2)), max(z0, z1, z2))
    return crossing_kind, z


@subkernel(inline="always")
def hit_triangle(corners, facets, facet_index, x, y, edge_limits, hits, hit_index, is_writing):
    """Intersect a line with a triangle that isn't vertical; write the hit if `is_writing`.

    Args:
        corners: the triangle's corners in a frame in which the line is vertical, (3, 3) float64
            [m].
        facets: the triangles in the world frame.
        facet_index: index of the triangle in `facets`.
        x, y: the line [m].
        edge_limits: a limit for each of the edges opposite to corners 0, 1 and 2 [m²], see
            `find_edge_limits`. If the edge function's absolute value is larger, its sign alone
            tells on which side of the edge the line runs; else the line's distance to the edge is
            computed.
        hits: `LineHits` to write into.
        hit_index: index in `hits` at which to write.
        is_writing: whether to write the hit.

    Returns:
        The number of hits, 0 or 1.
    """
    crossing_kind, z = cross_triangle(corners, x, y, edge_limits)
    if crossing_kind == 0:
        return 0
    if not is_writing:
        return 1
    nx, ny, nz = unit_normal(corners[0], corners[1], corners[2])
    hits.z[hit_index] = z
    hits.normal[hit_index, 0] = nx
    hits.normal[hit_index, 1] = ny
    hits.normal[hit_index, 2] = nz
    hits.geom[hit_index] = facets.geom[facet_index]
    hits.closed[hit_index] = facets.closed[facet_index]
    hits.facet[hit_index] = facet_index
    hits.is_at_edge[hit_index] = AT_EDGE if crossing_kind == 2 else INSIDE
    return 1


@subkernel(inline="always")
def _span_of_row(corners, x_low, x_high, y, edge_limits):
    """Return the range of x between x_low and x_high in which lines at y may cross a triangle [m].

    Edge functions are linear along a row of cells, so each edge bounds the range.
    """
    x0 = corners[0, 0]
    y0 = corners[0, 1]
    area = (corners[1, 0] - x0) * (corners[2, 1] - y0)
    area -= (corners[2, 0] - x0) * (corners[1, 1] - y0)
    winding_sign = 1.0 if area > 0.0 else -1.0
    span_low = x_low
    span_high = x_high
    for k in range(3):
        i = (k + 1) % 3
        j = (k + 2) % 3
        bx = corners[i, 0] - x_low
        by = corners[i, 1] - y
        cx = corners[j, 0] - x_low
        cy = corners[j, 1] - y
        edge_function_at_low = winding_sign * (bx * cy - cx * by)
        edge_function_slope = winding_sign * (corners[i, 1] - corners[j, 1])
        if edge_function_slope > 0.0:
            span_low = max(
                span_low, x_low - (edge_function_at_low + edge_limits[k]) / edge_function_slope
            )
        elif edge_function_slope < 0.0:
            span_high = min(
                span_high, x_low - (edge_function_at_low + edge_limits[k]) / edge_function_slope
            )
    return span_low, span_high


@subkernel(**NO_REFCOUNT)
def raster_triangles(
    facets, triangles, is_crossed, lattice, rows, triangle_copy, hits, next_hit, is_writing
):
    """Write where the vertical lines through cells' centres cross triangles.

    Args:
        facets: the triangles, as `Facets`.
        triangles: indices into `facets` of those to cross, ascending.
        is_crossed: whether any line crosses each entry of `triangles`, bool; written while
            counting, read while writing.
        lattice: the cells, as `Lattice`.
        rows: the first row to cast lines in, and the row after the last one.
        triangle_copy: room for a copy of a triangle.
        hits: `LineHits` of the rows' lines.
        next_hit: for each line of the rows, where its next hit goes in `hits`, int64; advanced by 1
            for each hit.
        is_writing: whether to write hits; else they are only counted.
    """
    corners = triangle_copy.corners
    box = triangle_copy.box
    y_max = lattice.y_max
    x_min = lattice.x_min
    cell_size = lattice.cell_size
    width = lattice.width
    height = lattice.height
    for list_index in range(triangles.shape[0]):
        triangle = triangles[list_index]
        num_hits_of_triangle = 0
        if is_writing and not is_crossed[list_index]:
            continue
        copy_triangle(facets, triangle, triangle_copy)
        if unit_normal(corners[0], corners[1], corners[2])[2] == 0.0:
            is_crossed[list_index] = False
            continue
        y_high = box[0, 4] + RIM_WIDTH
        y_low = box[0, 1] - RIM_WIDTH
        first_row, last_row = find_centers_between(y_max - y_high, y_max - y_low, cell_size, height)
        x_low = box[0, 0] - RIM_WIDTH
        x_high = box[0, 3] + RIM_WIDTH
        first_col, last_col = find_centers_between(x_low - x_min, x_high - x_min, cell_size, width)
        needs_spans = last_col - first_col >= MIN_COLUMNS_FOR_SPANS
        edge_limits = find_edge_limits(corners)
        for row in range(max(first_row, rows[0]), min(last_row, rows[1] - 1) + 1):
            y = cell_center(lattice, row * width)[1]
            if needs_spans:
                span_low, span_high = _span_of_row(corners, x_low, x_high, y, edge_limits)
                first_col, last_col = find_centers_between(
                    span_low - x_min, span_high - x_min, cell_size, width
                )
            for col in range(first_col, last_col + 1):
                x = cell_center(lattice, col)[0]
                if not is_beside(box, 0, x, y):
                    line = (row - rows[0]) * width + col
                    hit_index = next_hit[line] if is_writing else 0
                    num_hits = hit_triangle(
                        corners,
                        facets,
                        triangle,
                        x,
                        y,
                        edge_limits,
                        hits,
                        hit_index,
                        is_writing,
                    )
                    next_hit[line] += num_hits
                    num_hits_of_triangle += num_hits
        is_crossed[list_index] = num_hits_of_triangle > 0
