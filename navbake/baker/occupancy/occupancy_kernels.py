"""Find which cells are occupied, and which geoms are in each, in one pass over the geoms near them.

A query is a cell and the height of a floor in it. Geoms are tested against upright prisms over that
floor, see `volume_kernels`. The query is occupied if a geom meets the agent's footprint: the prism
over the cell's square and the agent's disc, from the highest step above the floor (the ground
clearance) to the agent's height above it. The steps:

1. `_check_lines`: if the vertical line through the cell's centre hits a surface within the
   footprint, or runs inside of a solid there, the query is occupied.
2. `_check_geom`: each geom over a tile of cells, in the order of their ids, gets its flags in the
   queries near it. A flag says that the geom meets the prism of that name. Some flags are proved by
   the vertical line (`find_flags_on_line`), the others by the geom's shapes (`shape_meets_prism`).
3. `_keep_flags`: the geom's flags are added to the query's flags, and the geom to the tile's list
   of occupants. A query is occupied if any geom is BLOCKING.
4. If no geom is BLOCKING, but one is MAYBE_BLOCKING, the caller has to ask FCL.

If no occupants are listed, cells that steps 1 and 2 have decided are not tested further.

As in a rasterizer, the cells near each geom are visited, tile by tile. Which cells of a tile are
still to be tested is kept as the bits of one number. So a triangle smaller than a cell costs one or
two tests, and a triangle over decided cells costs none. The tests of a cell do not depend on other
cells: any number of threads gives the same answers.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import ColumnHits, HeightRange
from navbake.baker.core.bisection_kernels import find_first_above, find_first_at_or_above
from navbake.baker.core.constants import APART, MEETS
from navbake.baker.core.tiles import (
    TILE,
    cell_bit,
    tile_window,
    window_bits,
    window_near_box,
)
from navbake.baker.core.tolerances import SAME_HEIGHT, TOUCH_DEPTH
from navbake.baker.geometry.gjk_kernels import allocate_simplex
from navbake.baker.geometry.overlap_kernels import (
    allocate_polygons,
    count_enclosing,
    count_most_hits,
    is_beside_prism,
    is_line_blocked,
    plane_meets_prism,
)
from navbake.baker.geometry.triangle_kernels import allocate_triangle, copy_triangle
from navbake.baker.occupancy.volume_kernels import (
    AT_WALL_HEIGHT,
    BLOCKING,
    BLOCKING_SQUARE,
    MAYBE_BLOCKING,
    MAYBE_BLOCKING_SQUARE,
    OCCUPYING,
    PLANE_KIND,
    SEARCH_MARGIN,
    SOLID_KIND,
    TRIANGLE_KIND,
    OccupantLists,
    Queries,
    ShapeArrays,
    VolumeScratch,
    describe_floor,
    find_flags_on_line,
    make_envelope,
    make_volumes,
    shape_meets_prism,
)
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int, Int32

if TYPE_CHECKING:  # kernels depend on kernels alone
    from navbake.baker.occupancy.footprint import Footprint
    from navbake.navgrid.lattice import Lattice

BLOCKED_BY_LINE = 64  # flag of a query: its cell's vertical line alone proves it occupied
NO_GEOM = np.int32(2**31 - 1)  # greater than all geom ids
FIRST_CAPACITY = np.int64(1024)  # how many entries arrays have room for at first


class TileEntries(NamedTuple):
    """The geoms over the floors of a tile: an entry for each query and each geom over its floor.

    A query is a cell with the height of a floor. All arrays have the shape (n,), in the order of
    geom ids.

    Attributes:
        query: index of the query, int32.
        geom: id of a geom that meets at least one of the prisms (`Volumes`) over its floor, int32.
        flags: bits that say which of these prisms the geom meets: OCCUPYING, BLOCKING and
            AT_WALL_HEIGHT, uint8.
    """

    query: Int32
    geom: Int32
    flags: NDArray[np.uint8]


class TileState(NamedTuple):
    """The queries of a tile, and which of its cells are still to be tested.

    Attributes:
        row_queries: for each row of the tile, the index of its first query (a cell with the height
            of a floor), and the index past its last query, (TILE, 2) int64.
        first_query: for each cell of the tile, the index of its first query, (TILE, TILE) int64.
        end_query: for each cell, the index past its last query, (TILE, TILE) int64.
        first_near_query: for each cell, the index of its first query near the current geom's
            heights, (TILE, TILE) int64.
        end_near_query: for each cell, the index past the last such query, (TILE, TILE) int64.
        end_geom_hit: for each cell, an index that no hit of the current geom is at or above,
            (TILE, TILE) int64.
        prism_heights: lowest and highest z of all prisms that are tested, (2,) float64 [m].
        open_cell_bits: a bit for each cell for which further geoms are tested, (1,) int64.
        pending_cell_bits: for each flag, a bit for each cell in which the current geom is to be
            tested against the flag's prism, (4,) int64.
        pending_heights: for each flag, the lowest and highest z of the prisms of these cells,
            (4, 2) float64 [m].
        geom_box: box around the current geom over the tile, lower corner, upper corner, (1, 6)
            float64 [m].
        current_plane: index of the current plane, (1,) int32.
        scratch: memory for the tests.
    """

    row_queries: Int
    first_query: Int
    end_query: Int
    first_near_query: Int
    end_near_query: Int
    end_geom_hit: Int
    prism_heights: Float
    open_cell_bits: Int
    pending_cell_bits: Int
    pending_heights: Float
    geom_box: Float
    current_plane: Int32
    scratch: VolumeScratch


class TileTask(NamedTuple):
    """All inputs and outputs of the work on one tile.

    Attributes:
        lattice: the cells.
        window: rows and columns of the tile, see `tile_window`.
        hits: hits on the vertical line through each cell's centre.
        shape_arrays: the shapes that are tested.
        footprint: the volume over a floor that has to be free.
        queries: all queries, of which some are in the tile.
        occupant_lists: settings of the lists of occupants, and where they begin.
        tile_state: the queries of the tile, and which of its cells are still to be tested.
    """

    lattice: Lattice
    window: tuple[int, int, int, int]
    hits: ColumnHits
    shape_arrays: ShapeArrays
    footprint: Footprint
    queries: Queries
    occupant_lists: OccupantLists
    tile_state: TileState


@kernel(nogil=True)
def check_tiles(
    lattice,
    hits,
    shape_arrays,
    tiles,
    footprint,
    queries,
    occupant_lists,
    first_tile_row,
    end_tile_row,
):
    """Decide which queries in some rows of tiles are occupied, and list the occupants of each.

    A query is a cell with the height of a floor. It is occupied if a geom meets the footprint over
    that floor, a prism from the highest step to the agent's height above it; `queries.flags` says
    so. The query's list of occupants holds the geoms that meet any of the prisms over the floor, in
    the order of ids, from index `occupant_lists.list_start` to the next -1. Lists begin at index 1;
    at 0 is the empty list of all queries without occupants.

    Args:
        lattice: the cells.
        hits: hits on the vertical line through each cell's centre, as `ColumnHits`.
        shape_arrays: the shapes that are tested.
        tiles: the solids and triangles over each tile.
        footprint: the volume over a floor that has to be free.
        queries: the queries; receives the answers.
        occupant_lists: receives where the lists begin; nothing is listed if its arrays are empty.
        first_tile_row: number of the first row of tiles.
        end_tile_row: number of the row of tiles after the last.

    Returns:
        The geom ids of all lists, int32; their flags, uint8; and how long the used part of both
        arrays is.
    """
    tile_state = TileState(
        row_queries=np.zeros((TILE, 2), np.int64),
        first_query=np.empty((TILE, TILE), np.int64),
        end_query=np.empty((TILE, TILE), np.int64),
        first_near_query=np.empty((TILE, TILE), np.int64),
        end_near_query=np.empty((TILE, TILE), np.int64),
        end_geom_hit=np.empty((TILE, TILE), np.int64),
        prism_heights=np.empty(2),
        open_cell_bits=np.empty(1, np.int64),
        pending_cell_bits=np.empty(4, np.int64),
        pending_heights=np.empty((4, 2)),
        geom_box=np.empty((1, 6)),
        current_plane=np.empty(1, np.int32),
        scratch=VolumeScratch(allocate_simplex(), allocate_polygons(), allocate_triangle()),
    )
    num_cells = queries.cell.shape[0]
    row_size = TILE * lattice.width
    first_query = find_first_at_or_above(
        queries.cell, np.int64(0), num_cells, first_tile_row * row_size
    )
    end_query = find_first_at_or_above(
        queries.cell, first_query, num_cells, end_tile_row * row_size
    )
    most_hits = count_most_hits(hits, queries.cell, first_query, end_query)
    num_enclosing = np.empty(most_hits + 1, np.int64)
    list_geom = np.empty(FIRST_CAPACITY, np.int32)
    list_flags = np.empty(FIRST_CAPACITY, np.uint8)
    list_geom[0] = -1
    list_flags[0] = 0
    # a plain 1 has a type of its own, and the functions that take it would be compiled twice
    next_list_start = np.int64(1)
    entries = _make_entries(FIRST_CAPACITY)
    num_tile_cols = (lattice.width + TILE - 1) // TILE
    for tile in range(first_tile_row * num_tile_cols, end_tile_row * num_tile_cols):
        window = tile_window(lattice, tile)
        num_queries = _find_queries(lattice, window, queries.cell, tile_state.row_queries)
        if num_queries == 0:
            continue
        task = TileTask(
            lattice=lattice,
            window=window,
            hits=hits,
            shape_arrays=shape_arrays,
            footprint=footprint,
            queries=queries,
            occupant_lists=occupant_lists,
            tile_state=tile_state,
        )
        # most floors of a tower have a geom over them: a tile that has no room is checked again
        if occupant_lists.ceiling.shape[0] > 0 and num_queries > entries.geom.shape[0]:
            entries = _make_entries(num_queries + num_queries // 2)
        num_entries = np.int64(-1)
        while num_entries < 0:
            _check_lines(task, num_enclosing)
            num_entries = _check_tile(task, tiles, tile, entries)
            if num_entries < 0:
                entries = _make_entries(4 * entries.geom.shape[0])
        if occupant_lists.ceiling.shape[0] == 0:
            continue
        # each list ends with an entry of its own
        if next_list_start + num_entries + num_queries > list_geom.shape[0]:
            larger_capacity = 2 * list_geom.shape[0] + num_entries + num_queries
            larger_geom = np.empty(larger_capacity, np.int32)
            larger_flags = np.empty(larger_capacity, np.uint8)
            for i in range(next_list_start):  # slices take longer to compile: their errors are text
                larger_geom[i] = list_geom[i]
                larger_flags[i] = list_flags[i]
            list_geom = larger_geom
            list_flags = larger_flags
        next_list_start = _write_lists(
            tile_state.row_queries,
            entries,
            num_entries,
            occupant_lists.list_start,
            list_geom,
            list_flags,
            next_list_start,
        )
    return list_geom, list_flags, next_list_start


# ---------------------------------------------------------------- the queries of a tile


@subkernel(**NO_REFCOUNT)
def _find_queries(lattice, window, cells, row_queries):
    """Find the queries in each row of a tile, and return how many there are in all.

    A query is a cell with the height of a floor. Queries are in the order of cell ids. Tiles have
    to be visited in order: in each row, the queries of a tile follow those of the tile to its left.

    Args:
        lattice: the cells.
        window: rows and columns of the tile, see `tile_window`.
        cells: the cell of each query, ascending.
        row_queries: see `TileState`; has the queries of the tile to the left, receives those of
            this tile.
    """
    num_queries = 0
    for row in range(window[0], window[1]):
        tile_row = row - window[0]
        query = row_queries[tile_row, 1]
        if window[2] == 0:  # the first tile in its row of tiles: find the first query by bisection
            query = 0
            end_query = cells.shape[0]
            while query < end_query:
                middle_query = (query + end_query) // 2
                if cells[middle_query] < row * lattice.width:
                    query = middle_query + 1
                else:
                    end_query = middle_query
        row_queries[tile_row, 0] = query
        while query < cells.shape[0] and cells[query] < row * lattice.width + window[3]:
            query += 1
        row_queries[tile_row, 1] = query
        num_queries += query - row_queries[tile_row, 0]
    # a tile at the lower edge has fewer rows
    for tile_row in range(window[1] - window[0], row_queries.shape[0]):
        row_queries[tile_row, 0] = row_queries[tile_row, 1]
    return num_queries


@subkernel(**NO_REFCOUNT)
def _check_lines(task, num_enclosing):
    """Decide the queries of a tile that the vertical line through the cell's centre decides.

    A query is a cell with the height of a floor. It is occupied if the line hits a surface between
    the lower and the upper height of the footprint over the floor, or runs inside of a solid there.

    Also marks in `open_cell_bits` the cells for which geoms are tested next: those with a query
    that is not decided yet, or all cells if occupants are listed.

    Args:
        task: a `TileTask`, whose queries, lists and tile state receive the results.
        num_enclosing: an array for `count_enclosing`, with room for all of a cell's hits.
    """
    queries = task.queries
    occupant_lists = task.occupant_lists
    tile_state = task.tile_state
    hits = task.hits
    footprint = task.footprint
    is_listing = occupant_lists.ceiling.shape[0] > 0
    tile_state.first_query[:] = 0
    tile_state.end_query[:] = 0
    tile_state.first_near_query[:] = 0
    tile_state.end_near_query[:] = 0
    tile_state.end_geom_hit[:] = 0
    tile_state.open_cell_bits[0] = 0
    tile_state.prism_heights[0] = math.inf
    tile_state.prism_heights[1] = -math.inf
    hit_above_floor = np.int64(0)  # the first hit of the cell above the query's floor
    hit_above_step = np.int64(0)  # the first one above the lower end of the query's footprint
    for tile_row in range(tile_state.row_queries.shape[0]):
        row = task.window[0] + tile_row
        for query in range(
            tile_state.row_queries[tile_row, 0], tile_state.row_queries[tile_row, 1]
        ):
            cell = queries.cell[query]
            floor = queries.floor[query]
            col = cell - row * task.lattice.width
            tile_col = col - task.window[2]
            is_first_in_cell = tile_state.end_query[tile_row, tile_col] == 0
            if is_first_in_cell:
                tile_state.first_query[tile_row, tile_col] = query
                tile_state.first_near_query[tile_row, tile_col] = query
                tile_state.end_near_query[tile_row, tile_col] = query
                tile_state.end_geom_hit[tile_row, tile_col] = hits.start[cell]
                hit_above_floor = hits.start[cell]
                hit_above_step = hits.start[cell]
                count_enclosing(hits, cell, num_enclosing)
            tile_state.end_query[tile_row, tile_col] = query + 1
            agent_heights = HeightRange(floor + footprint.low, floor + footprint.high)
            end_hit = hits.start[cell + 1]
            # the floors of a cell ascend
            while hit_above_step < end_hit and hits.z[hit_above_step] <= agent_heights.low:
                hit_above_step += 1
            is_blocked = is_line_blocked(hits, cell, agent_heights, num_enclosing, hit_above_step)
            queries.flags[query] = BLOCKING | BLOCKING_SQUARE | BLOCKED_BY_LINE if is_blocked else 0
            if is_listing:
                occupant_lists.list_start[query] = 0
                while hit_above_floor < end_hit and hits.z[hit_above_floor] <= floor:
                    hit_above_floor += 1
                floor_geom, gap_below = describe_floor(
                    hits, cell, floor, occupant_lists.min_normal_z, hit_above_floor
                )
                occupant_lists.floor_geom[query] = floor_geom
                occupant_lists.gap_below[query] = gap_below
            envelope = make_envelope(
                task.lattice, footprint, queries, occupant_lists, query, row, col
            )
            queries.highest_prism_z[query] = envelope.high
            if not is_first_in_cell:
                queries.highest_prism_z[query] = max(
                    envelope.high, queries.highest_prism_z[query - 1]
                )
            if is_listing or not is_blocked:
                tile_state.prism_heights[0] = min(tile_state.prism_heights[0], envelope.low)
                tile_state.prism_heights[1] = max(tile_state.prism_heights[1], envelope.high)
                tile_state.open_cell_bits[0] |= cell_bit(tile_row, tile_col)


# ---------------------------------------------------------------- the geoms over a tile


@subkernel(**NO_REFCOUNT)
def _check_tile(task, tiles, tile, entries):
    """Test all geoms over a tile against the prisms over the floors of the tile's queries.

    `_check_lines` comes before it.

    A tile has TILE x TILE cells; a query is a cell with the height of a floor.

    Planes, solids and triangles are three lists in the order of geom ids: they are merged, so that
    the occupants of each query are found in the order of ids.

    Args:
        task: a `TileTask`, whose queries receive the answers.
        tiles: the solids and triangles over each tile.
        tile: number of the tile.
        entries: a `TileEntries` that receives the geoms over each query's floor.

    Returns:
        The number of entries, -1 if there is no room for them.
    """
    solids = task.shape_arrays.solids
    facets = task.shape_arrays.facets
    planes = task.shape_arrays.planes
    tile_state = task.tile_state
    geom_box = tile_state.geom_box
    triangle_copy = tile_state.scratch.triangle_copy
    num_entries = np.int64(0)  # see `next_list_start` above
    next_plane = 0
    next_solid = tiles.solid_start[tile]
    end_solid = tiles.solid_start[tile + 1]
    next_triangle = tiles.triangle_start[tile]
    end_triangle = tiles.triangle_start[tile + 1]
    while num_entries >= 0 and tile_state.open_cell_bits[0] != 0:
        plane_geom = planes.geom[next_plane] if next_plane < planes.geom.shape[0] else NO_GEOM
        solid_geom = (
            solids.geom[tiles.solid_indices[next_solid]] if next_solid < end_solid else NO_GEOM
        )
        triangle_geom = (
            facets.geom[tiles.triangle_indices[next_triangle]]
            if next_triangle < end_triangle
            else NO_GEOM
        )
        geom = min(plane_geom, solid_geom, triangle_geom)
        if geom == NO_GEOM:
            break
        # the geom's shapes over the tile: `shape_ids[first_shape:end_shape]`
        shape_kind = SOLID_KIND
        shape_ids = tiles.solid_indices
        bounds = solids.bounds
        first_shape = next_solid
        end_shape = next_solid + 1
        if geom == plane_geom:
            shape_kind = PLANE_KIND
            shape_ids = tile_state.current_plane
            first_shape = np.int64(0)
            end_shape = np.int64(1)
            tile_state.current_plane[0] = next_plane
            next_plane += 1
        elif geom == solid_geom:
            next_solid += 1
        else:
            shape_kind = TRIANGLE_KIND
            shape_ids = tiles.triangle_indices
            bounds = triangle_copy.box
            first_shape = next_triangle
            while next_triangle < end_triangle and facets.geom[shape_ids[next_triangle]] == geom:
                next_triangle += 1
            end_shape = next_triangle
        # one loop for solids and triangles, and one call below: both are compiled where they stand
        for axis in range(3):
            geom_box[0, axis] = math.inf
            geom_box[0, 3 + axis] = -math.inf
        for shape in shape_ids[
            first_shape : end_shape if shape_kind != PLANE_KIND else first_shape
        ]:
            shape_in_bounds = shape
            if shape_kind == TRIANGLE_KIND:
                copy_triangle(facets, shape, triangle_copy)
                shape_in_bounds = 0
            for axis in range(3):
                geom_box[0, axis] = min(geom_box[0, axis], bounds[shape_in_bounds, axis])
                geom_box[0, 3 + axis] = max(
                    geom_box[0, 3 + axis], bounds[shape_in_bounds, 3 + axis]
                )
        if shape_kind == PLANE_KIND:
            for axis in range(3):
                geom_box[0, axis] = -math.inf
                geom_box[0, 3 + axis] = math.inf
            is_level_ground = (
                planes.mat[shape_ids[0], 2] == 0.0
                and planes.mat[shape_ids[0], 5] == 0.0
                and planes.mat[shape_ids[0], 8] > 0.0
            )
            if is_level_ground:
                geom_box[0, 5] = planes.pos[shape_ids[0], 2]
        num_entries = _check_geom(
            task, shape_kind, shape_ids[first_shape:end_shape], geom, entries, num_entries
        )
    return num_entries


@subkernel(inline="always")
def _check_geom(task, shape_kind, shape_ids, geom, entries, num_entries):
    """Test a geom against the prisms over the floors of the queries near it, and keep its flags.

    A query is a cell with the height of a floor. A flag says that the geom meets the prism of that
    name over the floor, see `volume_kernels`.

    Args:
        task: a `TileTask`, whose queries receive the flags.
        shape_kind: PLANE_KIND, SOLID_KIND or TRIANGLE_KIND.
        shape_ids: the numbers of the geom's shapes over the tile: one plane, one solid, or
            triangles.
        geom: id of the geom.
        entries: a `TileEntries` that receives the geom for each query where it has a flag.
        num_entries: the number of entries so far.

    Returns:
        The number of entries, -1 if there is no room for them.
    """
    lattice = task.lattice
    window = task.window
    tile_state = task.tile_state
    queries = task.queries
    if (
        tile_state.geom_box[0, 2] >= tile_state.prism_heights[1]
        or tile_state.geom_box[0, 5] <= tile_state.prism_heights[0]
    ):
        return num_entries
    footprint = task.footprint
    facets = task.shape_arrays.facets
    triangle_copy = tile_state.scratch.triangle_copy
    box = triangle_copy.box
    # how far from a cell's centre shapes can meet the prisms over its square, and any of its prisms
    square_search_distance = lattice.cell_size / 2 + SEARCH_MARGIN
    prism_search_distance = max(
        square_search_distance, max(footprint.half_square, footprint.radius) + SEARCH_MARGIN
    )
    window_near_geom = window_near_box(
        lattice, window, tile_state.geom_box, 0, prism_search_distance
    )
    _find_pending_cells(task, shape_kind, shape_ids, geom, window_near_geom)
    pending_cell_bits = tile_state.pending_cell_bits
    pending_heights = tile_state.pending_heights
    for shape in shape_ids:
        if (
            pending_cell_bits[0]
            | pending_cell_bits[1]
            | pending_cell_bits[2]
            | pending_cell_bits[3]
            == 0
        ):
            break
        if shape_kind == TRIANGLE_KIND:
            copy_triangle(facets, shape, triangle_copy)
        # cells near the shape where BLOCKING is open, whose prism may be a disc wider than the
        # cell, and cells where another flag is open, whose prisms are over the cell's square
        disc_cell_bits = np.int64(0)
        square_cell_bits = np.int64(0)
        window_near_shape = window_near_geom
        for flag_index in range(4):
            is_at_height = shape_kind != TRIANGLE_KIND or (
                box[0, 2] < pending_heights[flag_index, 1]
                and box[0, 5] > pending_heights[flag_index, 0]
            )
            disc_cell_bits |= (
                pending_cell_bits[flag_index] if is_at_height and 1 << flag_index == BLOCKING else 0
            )
            square_cell_bits |= (
                pending_cell_bits[flag_index] if is_at_height and 1 << flag_index != BLOCKING else 0
            )
        if shape_kind == TRIANGLE_KIND and disc_cell_bits | square_cell_bits != 0:
            triangle_search_distance = (
                prism_search_distance if disc_cell_bits != 0 else square_search_distance
            )
            window_near_shape = window_near_box(
                lattice, window_near_geom, box, 0, triangle_search_distance
            )
            disc_cell_bits &= window_bits(window, window_near_shape)
            if square_cell_bits != 0:
                window_near_square = window_near_box(
                    lattice, window_near_shape, box, 0, square_search_distance
                )
                square_cell_bits &= window_bits(window, window_near_square)
        if disc_cell_bits | square_cell_bits == 0:  # as for most triangles of a fine mesh
            continue
        for row in range(window_near_shape[0], window_near_shape[1]):
            for col in range(window_near_shape[2], window_near_shape[3]):
                tile_row = row - window[0]
                tile_col = col - window[2]
                if (disc_cell_bits | square_cell_bits) & cell_bit(tile_row, tile_col) == 0:
                    continue
                open_flags = np.int64(0)
                first_near_query = tile_state.first_near_query[tile_row, tile_col]
                for query in range(first_near_query, tile_state.end_near_query[tile_row, tile_col]):
                    if queries.tested_flags[query] & ~queries.geom_flags[query]:
                        volumes = make_volumes(
                            lattice, footprint, queries, task.occupant_lists, query, row, col
                        )
                        _check_shape(task, shape_kind, shape, query, volumes)
                        open_flags |= queries.tested_flags[query] & ~queries.geom_flags[query]
                for flag_index in range(4):
                    pending_cell_bits[flag_index] &= (
                        -1 if open_flags & (1 << flag_index) else ~cell_bit(tile_row, tile_col)
                    )
    return _keep_flags(task, window_near_geom, geom, entries, num_entries)


@subkernel(**NO_REFCOUNT)
def _bracket(heights, begin, end, limit, guess):
    """Return a range around a guess in which ascending heights reach and pass a limit.

    The range is widened by steps that double (Bentley and Yao, 1976), so that bisecting it takes
    little time where the guess is good.

    Args:
        heights: heights, ascending in ``[begin:end]``.
        begin: index of the first height.
        end: index past the last one.
        limit: the limit.
        guess: index near which the limit is expected, from `begin` to `end`.

    Returns:
        The first index of the range, and its end: heights before it are below the limit, and those
        from its end on are above.
    """
    low = guess
    step = 1
    while low > begin and heights[low - 1] >= limit:
        low = max(begin, low - step)
        step *= 2
    high = guess
    step = 1
    while high < end and heights[high] <= limit:
        high = min(end, high + step)
        step *= 2
    return low, high


@subkernel(**NO_REFCOUNT)
def _find_pending_cells(task, shape_kind, shape_ids, geom, window_near_geom):
    """Find the cells near a geom in which the vertical line leaves some of its flags open.

    Args:
        task: a `TileTask`, whose `tile_state` receives the cells and the heights of their prisms,
            and whose queries receive the flags that the line proves.
        shape_kind: PLANE_KIND, SOLID_KIND or TRIANGLE_KIND.
        shape_ids: the numbers of the geom's shapes over the tile.
        geom: id of the geom.
        window_near_geom: rows and columns of the cells near the geom.
    """
    lattice = task.lattice
    window = task.window
    tile_state = task.tile_state
    queries = task.queries
    hits = task.hits
    footprint = task.footprint
    pending_cell_bits = tile_state.pending_cell_bits
    pending_heights = tile_state.pending_heights
    pending_cell_bits[:] = 0
    pending_heights[:, 0] = math.inf
    pending_heights[:, 1] = -math.inf
    lowest_z = tile_state.geom_box[0, 2]
    highest_z = tile_state.geom_box[0, 5] + SAME_HEIGHT
    for row in range(window_near_geom[0], window_near_geom[1]):
        for col in range(window_near_geom[2], window_near_geom[3]):
            tile_row = row - window[0]
            tile_col = col - window[2]
            first_query = tile_state.first_query[tile_row, tile_col]
            end_query = tile_state.end_query[tile_row, tile_col]
            # geoms that follow each other are often near each other: the search begins at the range
            # of the geom before
            low, high = _bracket(
                queries.highest_prism_z,
                first_query,
                end_query,
                lowest_z,
                tile_state.first_near_query[tile_row, tile_col],
            )
            first_near_query = find_first_above(queries.highest_prism_z, low, high, lowest_z)
            # the lowest of the prisms begins at the floor, or higher
            low, high = _bracket(
                queries.floor,
                first_near_query,
                end_query,
                highest_z,
                max(first_near_query, tile_state.end_near_query[tile_row, tile_col]),
            )
            end_near_query = find_first_at_or_above(queries.floor, low, high, highest_z)
            tile_state.first_near_query[tile_row, tile_col] = first_near_query
            tile_state.end_near_query[tile_row, tile_col] = end_near_query
            if first_near_query == end_near_query:
                continue
            cell = queries.cell[first_query]
            low, high = _bracket(
                hits.z,
                hits.start[cell],
                hits.start[cell + 1],
                highest_z,
                tile_state.end_geom_hit[tile_row, tile_col],
            )
            tile_state.end_geom_hit[tile_row, tile_col] = find_first_above(
                hits.z, low, high, highest_z
            )
            for query in range(first_near_query, end_near_query):
                queries.tested_flags[query] = 0
                envelope = make_envelope(
                    lattice, footprint, queries, task.occupant_lists, query, row, col
                )
                if is_beside_prism(tile_state.geom_box, 0, envelope):
                    continue
                if shape_kind == PLANE_KIND and not plane_meets_prism(
                    task.shape_arrays.planes, shape_ids[0], envelope
                ):
                    continue
                volumes = make_volumes(
                    lattice, footprint, queries, task.occupant_lists, query, row, col
                )
                _begin_geom(
                    task,
                    shape_kind,
                    geom,
                    query,
                    volumes,
                    tile_state.end_geom_hit[tile_row, tile_col],
                )
                open_flags = np.int64(queries.tested_flags[query] & ~queries.geom_flags[query])
                for flag_index, volume in enumerate(volumes):
                    if open_flags & (1 << flag_index):
                        pending_cell_bits[flag_index] |= cell_bit(tile_row, tile_col)
                        pending_heights[flag_index, 0] = min(
                            pending_heights[flag_index, 0], volume.low
                        )
                        pending_heights[flag_index, 1] = max(
                            pending_heights[flag_index, 1], volume.high
                        )


@subkernel(inline="always")
def _begin_geom(task, shape_kind, geom, query, volumes, end_geom_hit):
    """Set for which flags a geom is tested in a query, and which of them the vertical line proves.

    Args:
        task: a `TileTask`, whose queries receive the flags.
        shape_kind: PLANE_KIND, SOLID_KIND or TRIANGLE_KIND.
        geom: id of the geom.
        query: number of the query.
        volumes: the prisms of the flags over the query's floor.
        end_geom_hit: see `TileState`, of the query's cell.
    """
    queries = task.queries
    occupant_lists = task.occupant_lists
    footprint = task.footprint
    query_flags = np.int64(queries.flags[query])
    tested_flags = 0
    geom_flags = 0
    # where the square is a part of the footprint, each geom is tested; else no geom is tested once
    # another geom has met the square
    if footprint.radius > 0.0 and (
        footprint.half_square > 0.0 or not query_flags & BLOCKING_SQUARE
    ):
        tested_flags = BLOCKING_SQUARE
    if occupant_lists.ceiling.shape[0] > 0:
        tested_flags |= OCCUPYING | BLOCKING
        if (
            shape_kind != PLANE_KIND and occupant_lists.is_wall_candidate[geom]
        ):  # a plane is no wall
            tested_flags |= AT_WALL_HEIGHT
        # the geom's own winding number proves BLOCKING only where that of all geoms does, too
        provable_flags = (
            OCCUPYING | AT_WALL_HEIGHT | (BLOCKING if query_flags & BLOCKED_BY_LINE else 0)
        )
        flags_on_line = find_flags_on_line(
            task.hits, queries.cell[query], geom, end_geom_hit, volumes
        )
        geom_flags = flags_on_line & provable_flags & tested_flags
    elif not query_flags & BLOCKING:
        tested_flags |= BLOCKING
    queries.tested_flags[query] = tested_flags
    queries.geom_flags[query] = geom_flags


@subkernel(**NO_REFCOUNT)
def _check_shape(task, shape_kind, shape, query, volumes):
    """Test a shape of a geom against the prisms of all flags that are still open in a query.

    The flags of the prisms that it meets are added to `queries.geom_flags`.

    Args:
        task: a `TileTask`.
        shape_kind: PLANE_KIND, SOLID_KIND or TRIANGLE_KIND.
        shape: number of the plane, solid or triangle.
        query: number of the query.
        volumes: the prisms of the flags over the query's floor.
    """
    queries = task.queries
    footprint = task.footprint
    geom_flags = np.int64(queries.geom_flags[query])
    open_flags = np.int64(queries.tested_flags[query]) & ~geom_flags
    for flag_index, volume in enumerate(volumes):
        flag = 1 << flag_index
        if not open_flags & flag:
            continue
        overlap_result = shape_meets_prism(
            task.shape_arrays, shape_kind, shape, volume, task.tile_state.scratch
        )
        if overlap_result == MEETS:
            geom_flags |= flag
        elif overlap_result == APART:
            # a shape that misses a prism also misses that of BLOCKING_SQUARE if it is a part of it
            if flag == OCCUPYING and footprint.low >= SAME_HEIGHT + TOUCH_DEPTH:
                open_flags &= ~BLOCKING_SQUARE
            if flag == BLOCKING and footprint.half_square == 0.0:
                open_flags &= ~BLOCKING_SQUARE
        elif flag == BLOCKING:
            geom_flags |= MAYBE_BLOCKING
        elif flag == BLOCKING_SQUARE:
            geom_flags |= MAYBE_BLOCKING_SQUARE
        else:  # lists need no proof: a geom that reaches in by a rounding error is an occupant
            geom_flags |= flag
    queries.geom_flags[query] = geom_flags


# ---------------------------------------------------------------- the occupants of a tile


@subkernel
def _make_entries(capacity):
    """Allocate a `TileEntries` with room for `capacity` entries."""
    return TileEntries(
        np.empty(capacity, np.int32), np.empty(capacity, np.int32), np.empty(capacity, np.uint8)
    )


@subkernel(**NO_REFCOUNT)
def _keep_flags(task, window_near_geom, geom, entries, num_entries):
    """Add the flags of a geom to those of the queries near it, and the geom to the occupants there.

    Cells for which no further geom has to be tested are removed from `open_cell_bits`.

    Args:
        task: a `TileTask`, whose queries receive the flags.
        window_near_geom: window of the cells near the geom, see `tile_window`.
        geom: id of the geom.
        entries: a `TileEntries` that receives the geom for each query where it has a flag.
        num_entries: the number of entries so far.

    Returns:
        The number of entries, -1 if there is no room for them.
    """
    tile_state = task.tile_state
    queries = task.queries
    footprint = task.footprint
    is_listing = task.occupant_lists.ceiling.shape[0] > 0
    for row in range(window_near_geom[0], window_near_geom[1]):
        for col in range(window_near_geom[2], window_near_geom[3]):
            tile_row = row - task.window[0]
            tile_col = col - task.window[2]
            first_near_query = tile_state.first_near_query[tile_row, tile_col]
            for query in range(first_near_query, tile_state.end_near_query[tile_row, tile_col]):
                flags = np.int64(queries.geom_flags[query])
                if queries.tested_flags[query] and flags:
                    # the square is a part of the footprint, or lies in its disc
                    if flags & MAYBE_BLOCKING_SQUARE and footprint.half_square > 0.0:
                        flags |= MAYBE_BLOCKING
                    if flags & BLOCKING_SQUARE:
                        flags |= BLOCKING
                    queries.flags[query] |= flags & (
                        BLOCKING | BLOCKING_SQUARE | MAYBE_BLOCKING | MAYBE_BLOCKING_SQUARE
                    )
                    if flags & BLOCKING:
                        flags &= ~MAYBE_BLOCKING
                    if not flags & OCCUPYING:
                        flags &= ~AT_WALL_HEIGHT
                    flags &= OCCUPYING | BLOCKING | AT_WALL_HEIGHT | MAYBE_BLOCKING
                    if is_listing and flags:
                        if num_entries == entries.geom.shape[0]:
                            return -1
                        entries.query[num_entries] = query
                        entries.geom[num_entries] = geom
                        entries.flags[num_entries] = flags
                        num_entries += 1
                queries.tested_flags[query] = 0
            is_open = is_listing
            query = tile_state.first_query[tile_row, tile_col]
            while not is_open and query < tile_state.end_query[tile_row, tile_col]:
                query_flags = np.int64(queries.flags[query])
                is_open = not query_flags & BLOCKING or (
                    footprint.radius > 0.0 and not query_flags & BLOCKING_SQUARE
                )
                query += 1
            if not is_open:
                tile_state.open_cell_bits[0] &= ~cell_bit(tile_row, tile_col)
    return num_entries


@subkernel(**NO_REFCOUNT)
def _write_lists(
    row_queries, entries, num_entries, list_start, list_geom, list_flags, next_list_start
):
    """Write the occupants of a tile's queries as one list for each query.

    A counting sort: entries are in the order of geoms, lists in the order of queries.

    Args:
        row_queries: the queries in each row of the tile, see `TileState`.
        entries: the geoms over each query's floor, a `TileEntries`.
        num_entries: the number of entries.
        list_start: receives for each query where its list begins; 0 at first.
        list_geom: receives geom ids, and -1 after each list.
        list_flags: receives the geoms' flags, and 0 after each list.
        next_list_start: the index at which the first of these lists begins.

    Returns:
        The index after the last list.
    """
    for entry in range(num_entries):
        list_start[entries.query[entry]] += 1
    for tile_row in range(row_queries.shape[0]):  # a constant length would be unrolled
        for query in range(row_queries[tile_row, 0], row_queries[tile_row, 1]):
            if list_start[query] > 0:
                next_list_start += list_start[query] + 1
                # the place of the end mark; the list is filled from there to its beginning
                list_start[query] = next_list_start - 1
                list_geom[list_start[query]] = -1
                list_flags[list_start[query]] = 0
    for entry in range(num_entries - 1, -1, -1):
        query = entries.query[entry]
        list_start[query] -= 1
        list_geom[list_start[query]] = entries.geom[entry]
        list_flags[list_start[query]] = entries.flags[entry]
    return next_list_start
