"""Find the ground on vertical lines: the highest surface that faces up, near a height.

That needs no columns. Triangles that face down, or that are far from the height, are left out, and
no hits are written or sorted. A column may lack a hit at the edge of a triangle, see `hit_kernels`,
so the ground is uncertain where such a hit would be the highest.

Lines are put into the order of tiles and cells by a counting sort, so that each triangle is
intersected only with lines in the cells under it.
"""

import math
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

CELLS_PER_TILE = TILE * TILE


class GroundLines(NamedTuple):
    """Vertical lines on which ground is searched, in the order of tiles, and of cells in each tile.

    Attributes:
        points: x and y of each line, (n, 2) float64 [m].
        z: the height near which each line's ground is, (n,) float64 [m].
        rise: how far each line's ground is above its height, -inf for none, (n,) float64 [m].
            Crossings at edges of triangles don't count.
        edge_rise: the same of crossings at edges of triangles. If it is greater than `rise`, the
            ground is uncertain.
        original_index: the index of each line before the lines were sorted, (n,) int64.
        place: the place of each line, before they were sorted, in the order of tiles and cells:
            CELLS_PER_TILE for each tile after the first one, and the cell in its tile; -1 outside
            of the lattice, (n,) int64.
        first_tile: a tile; no line runs through a tile before it.
        start: the index of the first line of each cell of this tile and the following ones, then
            the number of lines, int64. Each tile has CELLS_PER_TILE cells, also at the lattice's
            edge. Zeros before lines are sorted, with another entry at the end.
    """

    points: Float
    z: Float
    rise: Float
    edge_rise: Float
    original_index: Int
    place: Int
    first_tile: int
    start: Int


@subkernel(**NO_REFCOUNT)
def _sort_by_cell(lattice, points, z, lines):
    """Sort vertical lines by tile, and by cell in each tile.

    Args:
        lattice: the cells, as `Lattice`.
        points: x and y of each line, (n, 2) float64 [m].
        z: the height near which each line's ground is, (n,) float64 [m].
        lines: receives the lines in their order, as `GroundLines`; those outside of the lattice
            are left out.
    """
    tiles_per_row = (lattice.width + TILE - 1) // TILE
    place = lines.place
    start = lines.start
    for line in range(points.shape[0]):
        row = math.floor((lattice.y_max - points[line, 1]) / lattice.cell_size)
        col = math.floor((points[line, 0] - lattice.x_min) / lattice.cell_size)
        place[line] = -1
        if 0 <= row < lattice.height and 0 <= col < lattice.width:
            tile = row // TILE * tiles_per_row + col // TILE - lines.first_tile
            place[line] = tile * CELLS_PER_TILE + row % TILE * TILE + col % TILE
            # two entries further on: the sums are each cell's next line while lines are put into
            # order, and each cell's first line after that
            start[place[line] + 2] += 1
    for i in range(1, start.shape[0]):
        start[i] += start[i - 1]
    for line in range(points.shape[0]):
        if place[line] >= 0:
            sorted_index = start[place[line] + 1]
            start[place[line] + 1] += 1
            lines.original_index[sorted_index] = line
            lines.points[sorted_index, 0] = points[line, 0]
            lines.points[sorted_index, 1] = points[line, 1]
            lines.z[sorted_index] = z[line]


@subkernel(**NO_REFCOUNT)
def _raise_ground_to_triangles(lattice, facets, tile_index, tile, lines, max_rise, triangle_copy):
    """Raise the ground of a tile's lines to the triangles that they cross.

    Args:
        lattice: the cells, as `Lattice`.
        facets: the triangles, as `Facets`.
        tile_index: the shapes over each tile, as `ShapeIndex`.
        tile: the tile.
        lines: the lines, as `GroundLines`, whose `rise` and `edge_rise` are raised.
        max_rise: how far ground is above or below the line's height at most [m].
        triangle_copy: room for a copy of a triangle.
    """
    corners = triangle_copy.corners
    box = triangle_copy.box
    window = tile_window(lattice, tile)
    first_place = (tile - lines.first_tile) * CELLS_PER_TILE
    first_line = lines.start[first_place]
    end_line = lines.start[first_place + CELLS_PER_TILE]
    lines_x_low = np.inf
    lines_x_high = -np.inf
    lines_y_low = np.inf
    lines_y_high = -np.inf
    lines_z_low = np.inf
    lines_z_high = -np.inf
    for line in range(first_line, end_line):
        lines_x_low = min(lines_x_low, lines.points[line, 0])
        lines_x_high = max(lines_x_high, lines.points[line, 0])
        lines_y_low = min(lines_y_low, lines.points[line, 1])
        lines_y_high = max(lines_y_high, lines.points[line, 1])
        lines_z_low = min(lines_z_low, lines.z[line])
        lines_z_high = max(lines_z_high, lines.z[line])
    reach = 0.5 * lattice.cell_size + RIM_WIDTH
    for entry in range(tile_index.triangle_start[tile], tile_index.triangle_start[tile + 1]):
        triangle = tile_index.triangle_indices[entry]
        if not faces_up(facets, triangle):
            continue
        copy_triangle(facets, triangle, triangle_copy)
        x_low = box[0, 0] - RIM_WIDTH
        x_high = box[0, 3] + RIM_WIDTH
        y_low = box[0, 1] - RIM_WIDTH
        y_high = box[0, 4] + RIM_WIDTH
        z_low = box[0, 2]
        z_high = box[0, 5]
        if (
            x_high < lines_x_low
            or x_low > lines_x_high
            or y_high < lines_y_low
            or y_low > lines_y_high
            or z_high - lines_z_low < -max_rise
            or z_low - lines_z_high > max_rise
        ):
            continue
        row_first, row_end, col_first, col_end = window_near_box(lattice, window, box, 0, reach)
        if col_first >= col_end or unit_normal(corners[0], corners[1], corners[2])[2] <= 0.0:
            continue
        edge_limits = find_edge_limits(corners)
        for row in range(row_first, row_end):
            row_place = first_place + (row - window[0]) * TILE - window[2]
            for line in range(lines.start[row_place + col_first], lines.start[row_place + col_end]):
                x = lines.points[line, 0]
                y = lines.points[line, 1]
                if x < x_low or x > x_high or y < y_low or y > y_high:
                    continue
                # a triangle that is no higher than the ground so far changes nothing
                highest_rise = z_high - lines.z[line]
                if highest_rise <= lines.rise[line] or highest_rise < -max_rise:
                    continue
                crossing_kind, z = cross_triangle(corners, x, y, edge_limits)
                if crossing_kind == 0 or abs(z - lines.z[line]) > max_rise:
                    continue
                if crossing_kind == 1:
                    lines.rise[line] = max(lines.rise[line], z - lines.z[line])
                else:
                    lines.edge_rise[line] = max(lines.edge_rise[line], z - lines.z[line])


@subkernel(**NO_REFCOUNT)
def _raise_ground_to_hits(hits, num_hits, lines, line, max_rise):
    """Raise a line's ground to those of the first `num_hits` hits that face up.

    Args:
        hits: hits of solids or planes, as `LineHits`.
        num_hits: how many hits there are.
        lines: the lines, as `GroundLines`, whose `rise` is raised.
        line: index of the line.
        max_rise: how far ground is above or below the line's height at most [m].
    """
    for i in range(num_hits):
        rise = hits.z[i] - lines.z[line]
        if hits.normal[i, 2] > 0.0 and abs(rise) <= max_rise:
            lines.rise[line] = max(lines.rise[line], rise)


@kernel(nogil=True)
def find_ground_rises(
    lattice, geometry, tile_index, points, z, max_rise, lines, rise, is_uncertain
):
    """Find how far the ground on lines is above given heights.

    A line is only intersected with the shapes over the tile that it runs through.

    Args:
        lattice: the cells, as `Lattice`.
        geometry: the shapes, as `Geometry`.
        tile_index: the shapes over each tile, as `ShapeIndex`.
        points: x and y of each line, (n, 2) float64 [m].
        z: the height near which each line's ground is, (n,) float64 [m].
        max_rise: how far ground is above or below this height at most [m].
        lines: room for the lines in the order of tiles, as `GroundLines`.
        rise: NaN everywhere, (n,) float64; receives how far each line's ground is above its height
            [m]. It stays NaN where there is no ground, where the ground is uncertain, and outside
            of the lattice.
        is_uncertain: False everywhere, (n,); receives whether the highest crossing is at an edge of
            triangles, so that only the whole column tells whether it counts.
    """
    solids = geometry.solids
    planes = geometry.planes
    height_range = geometry.height_range
    ray = allocate_ray()
    hits = allocate_hits(2)
    first_hit = np.int64(0)
    triangle_copy = allocate_triangle()
    _sort_by_cell(lattice, points, z, lines)
    for first_place in range(0, lines.start.shape[0] - CELLS_PER_TILE, CELLS_PER_TILE):
        first_line = lines.start[first_place]
        end_line = lines.start[first_place + CELLS_PER_TILE]
        if first_line == end_line:
            continue
        tile = lines.first_tile + first_place // CELLS_PER_TILE
        for line in range(first_line, end_line):
            x = lines.points[line, 0]
            y = lines.points[line, 1]
            for plane in range(planes.geom.shape[0]):
                num_hits = hit_plane(planes, plane, x, y, height_range, ray, hits, first_hit)
                _raise_ground_to_hits(hits, num_hits, lines, line, max_rise)
            for entry in range(tile_index.solid_start[tile], tile_index.solid_start[tile + 1]):
                solid = tile_index.solid_indices[entry]
                if not is_beside(solids.bounds, solid, x, y):
                    num_hits = hit_solid(solids, solid, x, y, ray, hits, first_hit)
                    _raise_ground_to_hits(hits, num_hits, lines, line, max_rise)
        _raise_ground_to_triangles(
            lattice, geometry.facets, tile_index, tile, lines, max_rise, triangle_copy
        )
        for line in range(first_line, end_line):
            original_index = lines.original_index[line]
            if lines.edge_rise[line] > lines.rise[line]:
                is_uncertain[original_index] = True
            elif lines.rise[line] > -np.inf:
                rise[original_index] = lines.rise[line]
