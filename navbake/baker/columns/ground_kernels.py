"""Find the ground on vertical lines: the highest surface that faces up, near a height.

That needs no columns. Triangles that face down, or that are far from the height, are left out, and
no hits are written or sorted. A column may lack a hit at the edge of a triangle, see `hit_kernels`,
so the ground is uncertain where such a hit would be the highest.
"""

from typing import NamedTuple

import numpy as np

from navbake.baker.columns.hit_kernels import RIM_WIDTH, allocate_hits
from navbake.baker.columns.raster_kernels import cross_triangle, find_edge_limits, is_beside
from navbake.baker.columns.ray_kernels import allocate_ray, hit_plane, hit_solid
from navbake.baker.core.tiles import TILE, tile_window, window_near_box
from navbake.baker.geometry.triangle_kernels import (
    allocate_triangle,
    copy_triangle,
    faces_up,
    unit_normal,
)
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int


class GroundLines(NamedTuple):
    """Vertical lines on which ground is searched, ordered by tile, and by cell in each tile.

    Attributes:
        points: x and y of each line, (n, 2) float64 [m].
        cells: id of the cell that each line runs through, (n,) int64.
        z: the height near which each line's ground is, (n,) float64 [m].
        tiles: the tiles that have lines, ascending, (m,) int64.
        start: index of each tile's first line, then the number of lines, (m + 1,) int64.
    """

    points: Float
    cells: Int
    z: Float
    tiles: Int
    start: Int


@subkernel(**NO_REFCOUNT)
def _find_lines_of_cells(lattice, lines, first_line, end_line, window, line_start):
    """Find which lines of a tile run through each of its cells.

    Args:
        lattice: the cells, as `Lattice`.
        lines: the lines, as `GroundLines`.
        first_line: index of the tile's first line.
        end_line: index past its last line.
        window: window of the tile's cells, see `tile_window`.
        line_start: receives the index of the first line of each cell of the tile, then `end_line`,
            (TILE * TILE + 1,) int64. Each row has TILE cells, also in a tile at the lattice's edge.
    """
    line_start[:] = 0
    for line in range(first_line, end_line):
        row = lines.cells[line] // lattice.width - window[0]
        col = lines.cells[line] % lattice.width - window[2]
        line_start[row * TILE + col + 1] += 1
    line_start[0] = first_line
    for i in range(TILE * TILE):
        line_start[i + 1] += line_start[i]


@subkernel(**NO_REFCOUNT)
def _raise_ground_to_triangles(
    lattice, facets, triangles, lines, max_rise, window, line_start, triangle_copy, rise, edge_rise
):
    """Raise the ground of a tile's lines to the triangles that they cross.

    Args:
        lattice: the cells, as `Lattice`.
        facets: the triangles, as `Facets`.
        triangles: indices into `facets` of the triangles over the tile.
        lines: the lines, as `GroundLines`.
        max_rise: how far ground is above or below the line's height at most [m].
        window: window of the tile's cells, see `tile_window`.
        line_start: the index of the first line of each cell, see `_find_lines_of_cells`.
        triangle_copy: room for a copy of a triangle.
        rise: for each line, how far the ground is above the line's height, -inf for none, (n,) [m];
            raised to crossings inside of triangles.
        edge_rise: the same, raised to crossings at edges of triangles.
    """
    corners = triangle_copy.corners
    box = triangle_copy.box
    first_line = line_start[0]
    end_line = line_start[TILE * TILE]
    low_z = np.inf
    high_z = -np.inf
    for line in range(first_line, end_line):
        low_z = min(low_z, lines.z[line])
        high_z = max(high_z, lines.z[line])
    reach = 0.5 * lattice.cell_size + RIM_WIDTH
    for entry in range(triangles.shape[0]):
        triangle = triangles[entry]
        if not faces_up(facets, triangle):
            continue
        copy_triangle(facets, triangle, triangle_copy)
        if box[0, 5] - low_z < -max_rise or box[0, 2] - high_z > max_rise:
            continue
        row_first, row_end, col_first, col_end = window_near_box(lattice, window, box, 0, reach)
        if col_first >= col_end or unit_normal(corners[0], corners[1], corners[2])[2] <= 0.0:
            continue
        edge_limits = find_edge_limits(corners)
        for row in range(row_first, row_end):
            first_cell = (row - window[0]) * TILE - window[2]
            for line in range(line_start[first_cell + col_first], line_start[first_cell + col_end]):
                x = lines.points[line, 0]
                y = lines.points[line, 1]
                if is_beside(box, 0, x, y):
                    continue
                crossing_kind, z = cross_triangle(corners, x, y, edge_limits)
                if crossing_kind == 0 or abs(z - lines.z[line]) > max_rise:
                    continue
                if crossing_kind == 1:
                    rise[line] = max(rise[line], z - lines.z[line])
                else:
                    edge_rise[line] = max(edge_rise[line], z - lines.z[line])


@subkernel(**NO_REFCOUNT)
def _raise_ground_to_hits(hits, num_hits, line_z, max_rise, line, rise):
    """Raise a line's ground to those of the first `num_hits` hits that face up.

    Args:
        hits: hits of solids or planes, as `LineHits`.
        num_hits: how many hits there are.
        line_z: the line's height [m].
        max_rise: how far ground is above or below this height at most [m].
        line: index of the line.
        rise: for each line, how far the ground is above its height, -inf for none, (n,) [m].
    """
    for i in range(num_hits):
        if hits.normal[i, 2] > 0.0 and abs(hits.z[i] - line_z) <= max_rise:
            rise[line] = max(rise[line], hits.z[i] - line_z)


@kernel(nogil=True)
def raise_ground(
    lattice, geometry, tile_index, lines, max_rise, rise, edge_rise, first_tile, end_tile
):
    """Raise the ground of lines to the highest surface that faces up, near a height.

    This is done for the lines of the tiles ``range(first_tile, end_tile)`` of `lines`. A line is
    only intersected with the shapes over its tile.

    Args:
        lattice: the cells, as `Lattice`.
        geometry: the shapes, as `Geometry`.
        tile_index: the shapes over each tile, as `ShapeIndex`.
        lines: the lines, as `GroundLines`.
        max_rise: how far ground is above or below a line's height at most [m].
        rise: -inf everywhere, (n,) float64; receives how far each line's ground is above its
            height, where there is ground [m]. Crossings at edges of triangles don't count.
        edge_rise: -inf everywhere, (n,) float64; receives the same of crossings at edges of
            triangles. If it is greater than `rise`, the ground is uncertain.
        first_tile: index of the first tile in `lines.tiles`.
        end_tile: index past the last one.
    """
    solids = geometry.solids
    planes = geometry.planes
    height_range = geometry.height_range
    ray = allocate_ray()
    hits = allocate_hits(2)
    first_hit = np.int64(0)
    triangle_copy = allocate_triangle()
    line_start = np.empty(TILE * TILE + 1, np.int64)
    for i in range(first_tile, end_tile):
        tile = lines.tiles[i]
        for line in range(lines.start[i], lines.start[i + 1]):
            x = lines.points[line, 0]
            y = lines.points[line, 1]
            for plane in range(planes.geom.shape[0]):
                num_hits = hit_plane(planes, plane, x, y, height_range, ray, hits, first_hit)
                _raise_ground_to_hits(hits, num_hits, lines.z[line], max_rise, line, rise)
            for entry in range(tile_index.solid_start[tile], tile_index.solid_start[tile + 1]):
                solid = tile_index.solid_indices[entry]
                if not is_beside(solids.bounds, solid, x, y):
                    num_hits = hit_solid(solids, solid, x, y, ray, hits, first_hit)
                    _raise_ground_to_hits(hits, num_hits, lines.z[line], max_rise, line, rise)
        window = tile_window(lattice, tile)
        _find_lines_of_cells(lattice, lines, lines.start[i], lines.start[i + 1], window, line_start)
        first_entry = tile_index.triangle_start[tile]
        end_entry = tile_index.triangle_start[tile + 1]
        _raise_ground_to_triangles(
            lattice,
            geometry.facets,
            tile_index.triangle_indices[first_entry:end_entry],
            lines,
            max_rise,
            window,
            line_start,
            triangle_copy,
            rise,
            edge_rise,
        )
