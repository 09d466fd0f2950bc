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
from navbake.baker.core.tiles import cell_center, centers_between
from navbake.baker.geometry.triangle_kernels import unit_normal
from navbake.compiled import NO_REFCOUNT, subkernel

# For edges shorter than this, the distance is always computed [m]
SHORT_EDGE = 1e-6
# In place of the `_edge_limit` of a triangle's three edges: distances are always computed
NO_LIMITS = (np.inf, np.inf, np.inf)
# If the first and the last column under a triangle's box are at least this far apart, they are
# computed anew for each row [cells]
MIN_COLUMNS_FOR_SPANS = 4


@subkernel(inline="always")
def is_beside(boxes, i, x, y):
    """Return whether a vertical line passes a box at a distance of more than RIM_WIDTH.

    Args:
        boxes: (n, 6) float64, lower corner, upper corner [m].
        i: index of the box.
        x, y: the line [m].
    """
    return (
        x < boxes[i, 0] - RIM_WIDTH
        or x > boxes[i, 3] + RIM_WIDTH
        or y < boxes[i, 1] - RIM_WIDTH
        or y > boxes[i, 4] + RIM_WIDTH
    )


@subkernel(inline="always")
def _edge_limit(corners, t, i, j):
    """Return the edge function of points at twice RIM_WIDTH from the edge between corners i and j.

    The edge function of a point is its distance to the edge times the edge's length [m²]. For an
    edge shorter than SHORT_EDGE, inf is returned.
    """
    dx = corners[t, j, 0] - corners[t, i, 0]
    dy = corners[t, j, 1] - corners[t, i, 1]
    length = math.sqrt(dx * dx + dy * dy)
    return 2.0 * RIM_WIDTH * length if length > SHORT_EDGE else np.inf


@subkernel(inline="always")
def _cross_triangle(corners, t, x, y, limits):
    """Return whether the vertical line at (x, y) crosses triangle t, and at which height [m].

    The first number is 0 for no crossing, 1 for a crossing inside, 2 for a crossing at most
    RIM_WIDTH from an edge. `limits` are the `_edge_limit` of the edges opposite to corners 0, 1 and
    2, or NO_LIMITS.
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
    sign = 1.0 if area > 0.0 else -1.0
    u = sign * (bx * cy - cx * by)
    v = sign * (cx * ay - ax * cy)
    w = sign * (ax * by - bx * ay)
    if u < -limits[0] or v < -limits[1] or w < -limits[2]:
        return 0, 0.0
    crossing = 1
    if u <= limits[0] or v <= limits[1] or w <= limits[2]:
        # distance to an edge = edge function / edge length
        du = u / math.hypot(cx - bx, cy - by)
        dv = v / math.hypot(ax - cx, ay - cy)
        dw = w / math.hypot(bx - ax, by - ay)
        nearest = min(du, dv, dw)
        if nearest < -RIM_WIDTH:
            return 0, 0.0
        if nearest <= RIM_WIDTH:
            crossing = 2
    z0 = corners[t, 0, 2]
    z1 = corners[t, 1, 2]
    z2 = corners[t, 2, 2]
    z = (u * z0 + v * z1 + w * z2) / (u + v + w)
    z = min(max(z, min(z0, z1, z2)), max(z0, z1, z2))
    return crossing, z


@subkernel(inline="always")
def hit_triangle(corners, n, facets, t, x, y, limits, hits, place, writing):
    """Intersect a line with a triangle that isn't vertical; write the hit if `writing`.

    Args:
        corners: corners of triangles in a frame in which the line is vertical, (…, 3, 3) float64
            [m].
        n: index of the triangle in `corners`.
        facets: the triangles in the world frame.
        t: index of the triangle in `facets`.
        x, y: the line [m].
        limits: `_edge_limit` of the edges opposite to corners 0, 1 and 2, or NO_LIMITS.
        hits: `LineHits` to write into.
        place: index in `hits` at which to write.
        writing: whether to write the hit.

    Returns:
        The number of hits, 0 or 1.
    """
    crossing, z = _cross_triangle(corners, n, x, y, limits)
    if crossing == 0:
        return 0
    if not writing:
        return 1
    nx, ny, nz = unit_normal(corners, n)
    hits.z[place] = z
    hits.normal[place, 0] = nx
    hits.normal[place, 1] = ny
    hits.normal[place, 2] = nz
    hits.geom[place] = facets.geom[t]
    hits.closed[place] = facets.closed[t]
    hits.facet[place] = t
    hits.at_edge[place] = AT_EDGE if crossing == 2 else INSIDE
    return 1


@subkernel(inline="always")
def _span_of_row(corners, t, x_low, x_high, y, limits):
    """Return the range of x between x_low and x_high in which lines at y may cross triangle t [m].

    Edge functions are linear along a row of cells, so each edge bounds the range.
    """
    x0 = corners[t, 0, 0]
    y0 = corners[t, 0, 1]
    area = (corners[t, 1, 0] - x0) * (corners[t, 2, 1] - y0)
    area -= (corners[t, 2, 0] - x0) * (corners[t, 1, 1] - y0)
    sign = 1.0 if area > 0.0 else -1.0
    low = x_low
    high = x_high
    for k in range(3):
        i = (k + 1) % 3
        j = (k + 2) % 3
        bx = corners[t, i, 0] - x_low
        by = corners[t, i, 1] - y
        cx = corners[t, j, 0] - x_low
        cy = corners[t, j, 1] - y
        at_low = sign * (bx * cy - cx * by)
        growth = sign * (corners[t, i, 1] - corners[t, j, 1])
        if growth > 0.0:
            low = max(low, x_low - (at_low + limits[k]) / growth)
        elif growth < 0.0:
            high = min(high, x_low - (at_low + limits[k]) / growth)
    return low, high


@subkernel(**NO_REFCOUNT)
def raster_triangles(facets, triangles, is_crossed, lattice, rows, hits, end, writing):
    """Write where the vertical lines through cells' centres cross triangles.

    Args:
        facets: the triangles, as `Facets`.
        triangles: indices into `facets` of those to cross, ascending.
        is_crossed: whether any line crosses each entry of `triangles`, bool; written while
            counting, read while writing.
        lattice: the cells, as `Lattice`.
        rows: the first row to cast lines in, and the row after the last one.
        hits: `LineHits` of the rows' lines.
        end: for each line of the rows, where its next hit goes in `hits`, int64; advanced by 1 for
            each hit.
        writing: whether to write hits; else they are only counted.
    """
    corners = facets.corners
    bounds = facets.bounds
    y_max = lattice.y_max
    x_min = lattice.x_min
    cell_size = lattice.cell_size
    width = lattice.width
    height = lattice.height
    for i in range(triangles.shape[0]):
        t = triangles[i]
        count = 0
        if (writing and not is_crossed[i]) or (not writing and facets.facing[t] == 0):
            is_crossed[i] = False
            continue
        y_high = bounds[t, 4] + RIM_WIDTH
        y_low = bounds[t, 1] - RIM_WIDTH
        first_row, last_row = centers_between(y_max - y_high, y_max - y_low, cell_size, height)
        x_low = bounds[t, 0] - RIM_WIDTH
        x_high = bounds[t, 3] + RIM_WIDTH
        first_col, last_col = centers_between(x_low - x_min, x_high - x_min, cell_size, width)
        needs_spans = last_col - first_col >= MIN_COLUMNS_FOR_SPANS
        limits = (
            _edge_limit(corners, t, 1, 2),
            _edge_limit(corners, t, 2, 0),
            _edge_limit(corners, t, 0, 1),
        )
        for row in range(max(first_row, rows[0]), min(last_row, rows[1] - 1) + 1):
            y = cell_center(lattice, row * width)[1]
            if needs_spans:
                low, high = _span_of_row(corners, t, x_low, x_high, y, limits)
                first_col, last_col = centers_between(low - x_min, high - x_min, cell_size, width)
            for col in range(first_col, last_col + 1):
                x = cell_center(lattice, col)[0]
                if not is_beside(bounds, t, x, y):
                    line = (row - rows[0]) * width + col
                    place = end[line] if writing else 0
                    num_hits = hit_triangle(
                        corners, t, facets, t, x, y, limits, hits, place, writing
                    )
                    end[line] += num_hits
                    count += num_hits
        is_crossed[i] = count > 0
