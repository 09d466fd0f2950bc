"""One walk over the geoms near cells: what occupies the cells, and which geoms stand in each.

Tile by tile, each geom visits the cells near it, as in a rasterizer. A triangle smaller than a cell
costs one or two tests, and one over no undecided cell costs none: these are the bits of a number.
Cheap tests come before exact ones: the winding number of the cell's line, then boxes (broad phase),
then `overlap` (clipping) and `solids` (closed forms, then GJK). The tests of a cell do not depend
on the order of the cells, so any number of threads gives the same result.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import NOT_ROUND, ColumnHits, Facets, HeightRange, Prism
from navbake.baker.core.constants import APART, MEETS
from navbake.baker.core.tiles import (
    TILE,
    cell_bit,
    cell_center_at,
    tile_window,
    window_bits,
    window_near_box,
)
from navbake.baker.core.tolerances import SAME_HEIGHT, TOUCH_DEPTH
from navbake.baker.geometry.gjk_kernels import Simplex, make_simplex
from navbake.baker.geometry.overlap_kernels import (
    ANY_GEOM,
    Polygons,
    facet_meets_prism,
    is_beside_prism,
    is_line_blocked,
    make_polygons,
    plane_meets_prism,
)
from navbake.baker.geometry.solid_kernels import solid_meets_prism
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Bool, Float, Int, Int32

# What a geom does in a cell: it stands there, meets the occupancy's volume, meets the square in the
# probed band, and meets the square in the band of the occupancy
OCCUPYING = 1
BLOCKING = 2
AT_WALL_HEIGHT = 4
BLOCKING_SQUARE = 8
# No proof whether it meets the occupancy's volume, or the square there
MAYBE_BLOCKING = 16
MAYBE_BLOCKING_SQUARE = 32
BLOCKED_BY_LINE = 64  # of a cell: its line alone proves it occupied
PLANE = np.int64(0)
SOLIDS = np.int64(1)
TRIANGLES = np.int64(2)
NO_GEOM = np.int32(2**31 - 1)


class Queries(NamedTuple):
    """Floors of cells, and what is found over each, arrays of shape (n,).

    Attributes:
        cell: ids, ascending, int64.
        floor: [m].
        state: receives the flags of all geoms but OCCUPYING and AT_WALL_HEIGHT, uint8.
        wanted, flags: scratch: what is tested of a geom, and what it does, uint8.
    """

    cell: Int
    floor: Float
    state: NDArray[np.uint8]
    wanted: NDArray[np.uint8]
    flags: NDArray[np.uint8]


class OccupantLists(NamedTuple):
    """What is to be listed over the queries; all arrays are empty where nothing is.

    Attributes:
        ceiling: (n,), at least as high as the agent [m].
        first: receives where each query's list begins, (n,) int32, see `occupy_tiles`.
        carrier, gap: receive the geoms of the floors, and the gaps below, see `_describe_floor`.
        probed: by geom id, bool: whether it is tested in the probed band.
        low, high: the probed band, over the floor [m].
        min_up: least z of the normal of what carries a floor.
    """

    ceiling: Float
    first: Int32
    carrier: Int32
    gap: Float
    probed: Bool
    low: float
    high: float
    min_up: float


class Entries(NamedTuple):
    """What a tile's geoms do, in their order: the query, the geom and its flags, of each entry."""

    query: Int32
    geom: Int32
    flags: NDArray[np.uint8]


class Here(NamedTuple):
    """What is known of a tile's queries, and room for the geoms' tests.

    Attributes:
        run: the queries of each of its rows of cells, first and past the last, (TILE, 2) int64.
        first, end: the queries of each cell, (TILE, TILE) int64.
        span: the heights of all volumes that are tested, (2,) float64 [m].
        open: a bit for each undecided cell; (1,) int64.
        still, bands: of each volume of a geom, a bit for each cell that it is to be tested in,
            (4,) int64; and the heights of all these volumes, (4, 2) float64 [m].
        box: around a geom over the tile, (1, 6) float64 [m].
        plane: the number of a plane, (1,) int32.
    """

    run: Int
    first: Int
    end: Int
    span: Float
    open: Int
    still: Int
    bands: Float
    box: Float
    plane: Int32
    simplex: Simplex
    polygons: Polygons


class Walk(NamedTuple):
    """All that a walk reads and writes; `window` is the tile's, see `tile_window`."""

    lattice: Any
    window: tuple[int, int, int, int]
    hits: ColumnHits
    solids: Any
    facets: Facets
    planes: Any
    footprint: Any
    queries: Queries
    listing: OccupantLists
    here: Here


@kernel(nogil=True)
def occupy_tiles(lattice, hits, geometry, tiles, footprint, queries, listing, first, end):
    """Find what stands near the queries in the rows of tiles ``range(first, end)``.

    A cell is occupied where its line or a geom meets `footprint` over its floor. A listed geom
    is OCCUPYING a cell if it meets the cell's square between a hair over the floor and the
    ceiling; it is AT_WALL_HEIGHT if it also meets the square in the probed band.

    Args:
        geometry: solids, facets and planes.

    Returns:
        Geom ids, int32, and flags, uint8: each query's list, by geom, from its `first` to the geom
        -1; and how much of them is used. Lists begin at 1; place 0 is that of all empty ones.
    """
    here = Here(
        np.zeros((TILE, 2), np.int64),
        np.empty((TILE, TILE), np.int64),
        np.empty((TILE, TILE), np.int64),
        np.empty(2),
        np.empty(1, np.int64),
        np.empty(4, np.int64),
        np.empty((4, 2)),
        np.empty((1, 6)),
        np.empty(1, np.int32),
        make_simplex(),
        make_polygons(),
    )
    solids, facets, planes = geometry
    geom = np.empty(1024, np.int32)
    flags = np.empty(1024, np.uint8)
    geom[0] = -1
    flags[0] = 0
    used = np.int64(1)  # a plain 1 has a type of its own, and its functions would be compiled twice
    entries = _make_entries(1024)
    tiles_x = (lattice.width + TILE - 1) // TILE
    for tile in range(first * tiles_x, end * tiles_x):
        window = tile_window(lattice, tile)
        num = _find_queries(lattice, window, queries.cell, here.run)
        if num == 0:
            continue
        walk = Walk(
            lattice, window, hits, solids, facets, planes, footprint, queries, listing, here
        )
        count = np.int64(-1)
        while count < 0:
            count = _look_at_tile(walk, tiles, tile, entries)
            if count < 0:
                entries = _make_entries(4 * entries.geom.shape[0])
        if listing.ceiling.shape[0] == 0:
            continue
        if used + count + num > geom.shape[0]:
            size = 2 * geom.shape[0] + count + num
            wider = np.empty(size, np.int32)
            marks = np.empty(size, np.uint8)
            for i in range(used):  # slices take longer to compile: their errors are text
                wider[i] = geom[i]
                marks[i] = flags[i]
            geom = wider
            flags = marks
        used = _write_lists(here.run, entries, count, listing.first, geom, flags, used)
    return geom, flags, used


@subkernel
def _make_entries(size):
    """Room for some entries."""
    return Entries(np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.uint8))


@subkernel(**NO_REFCOUNT)
def _find_queries(lattice, window, cells, run):
    """Find the queries of each row of a tile's cells; returns how many there are."""
    count = 0
    for row in range(window[0], window[1]):
        r = row - window[0]
        # queries are sorted by cell, so a tile's follow on those of the tile before
        n = run[r, 1]
        if window[2] == 0:
            n = 0
            last = cells.shape[0]
            while n < last:
                middle = (n + last) // 2
                if cells[middle] < row * lattice.width:
                    n = middle + 1
                else:
                    last = middle
        run[r, 0] = n
        while n < cells.shape[0] and cells[n] < row * lattice.width + window[3]:
            n += 1
        run[r, 1] = n
        count += n - run[r, 0]
    for r in range(window[1] - window[0], run.shape[0]):
        run[r, 0] = run[r, 1]
    return count


@subkernel(**NO_REFCOUNT)
def _write_lists(run, entries, count, first, geom, flags, used):
    """Write a tile's entries as lists behind the `used` part; returns the end of the lists."""
    for e in range(count):
        first[entries.query[e]] += 1
    for r in range(run.shape[0]):  # of a length that the compiler doesn't know, or it unrolls
        for n in range(run[r, 0], run[r, 1]):
            if first[n] > 0:
                used += first[n] + 1
                first[n] = used - 1  # past its last entry, from which it is filled
                geom[first[n]] = -1
                flags[first[n]] = 0
    for e in range(count - 1, -1, -1):
        n = entries.query[e]
        first[n] -= 1
        geom[first[n]] = entries.geom[e]
        flags[first[n]] = entries.flags[e]
    return used


@subkernel(inline="always")
def _column(walk, n, row, col):
    """The volume around all that is tested of a query; a hair wider, see `facet_meets_prism`."""
    lattice = walk.lattice
    footprint = walk.footprint
    floor = walk.queries.floor[n]
    x, y = cell_center_at(lattice, row, col)
    reach = max(lattice.cell_size / 2, footprint.square, footprint.radius) + 2.0 * TOUCH_DEPTH
    low = floor + footprint.low
    high = floor + footprint.high
    if walk.listing.ceiling.shape[0] > 0:
        low = floor
        high = walk.listing.ceiling[n]
    return Prism(x, y, low, high, reach, NOT_ROUND)


@subkernel(inline="always")
def _volumes(walk, n, row, col):
    """The volumes of the four flags that geoms are tested for, over a query's floor."""
    footprint = walk.footprint
    listing = walk.listing
    floor = walk.queries.floor[n]
    x, y = cell_center_at(walk.lattice, row, col)
    low = floor + footprint.low
    high = floor + footprint.high
    half = walk.lattice.cell_size / 2 - TOUCH_DEPTH
    is_round = footprint.radius > 0.0
    ceiling = listing.ceiling[n] if listing.ceiling.shape[0] > 0 else high
    return (
        Prism(x, y, floor + (SAME_HEIGHT + TOUCH_DEPTH), ceiling, half, NOT_ROUND),
        Prism(x, y, low, high, footprint.radius if is_round else half, is_round),
        Prism(x, y, floor + listing.low, floor + listing.high, half, NOT_ROUND),
        Prism(x, y, low, high, half, NOT_ROUND),
    )


@subkernel(**NO_REFCOUNT)
def _ask_lines(walk):
    """Test the lines of a tile's cells, and note the cells that these leave undecided."""
    queries = walk.queries
    listing = walk.listing
    here = walk.here
    hits = walk.hits
    footprint = walk.footprint
    lists = listing.ceiling.shape[0] > 0
    here.first[:] = 0
    here.end[:] = 0
    here.open[0] = 0
    here.span[0] = math.inf
    here.span[1] = -math.inf
    for r in range(here.run.shape[0]):
        row = walk.window[0] + r
        for n in range(here.run[r, 0], here.run[r, 1]):
            cell = queries.cell[n]
            floor = queries.floor[n]
            col = cell - row * walk.lattice.width
            c = col - walk.window[2]
            if here.end[r, c] == 0:
                here.first[r, c] = n
            here.end[r, c] = n + 1
            band = HeightRange(floor + footprint.low, floor + footprint.high)
            is_blocked = is_line_blocked(hits, cell, band, ANY_GEOM)
            queries.state[n] = BLOCKING | BLOCKING_SQUARE | BLOCKED_BY_LINE if is_blocked else 0
            if lists:
                listing.first[n] = 0
                carried = _describe_floor(hits, cell, floor, listing.min_up)
                listing.carrier[n], listing.gap[n] = carried
            if lists or not is_blocked:
                column = _column(walk, n, row, col)
                here.span[0] = min(here.span[0], column.low)
                here.span[1] = max(here.span[1], column.high)
                here.open[0] |= cell_bit(r, c)


@subkernel(inline="always")
def _describe_floor(hits, cell, floor, min_up):
    """The geom that carries a floor, or -1, and the gap to another geom's floor below [m]."""
    carrier = np.int32(-1)
    gap = math.inf
    for i in range(hits.start[cell], hits.start[cell + 1]):
        if hits.z[i] == floor and hits.normal[i, 2] >= min_up:
            carrier = hits.geom[i]
            break
    for i in range(hits.start[cell], hits.start[cell + 1]):
        if hits.z[i] > floor:
            break
        if hits.normal[i, 2] >= min_up and hits.geom[i] != carrier:
            gap = floor - hits.z[i]
    return carrier, gap


@subkernel(**NO_REFCOUNT)
def _look_at_tile(walk, tiles, tile, entries):
    """Test the geoms over a tile, by geom id; returns the number of entries, -1 for no room."""
    solids = walk.solids
    facets = walk.facets
    planes = walk.planes
    here = walk.here
    _ask_lines(walk)
    # see `used` above
    p = 0
    count = np.int64(0)
    s = tiles.solid_start[tile]
    last_s = tiles.solid_start[tile + 1]
    t = tiles.triangle_start[tile]
    last_t = tiles.triangle_start[tile + 1]
    while count >= 0 and here.open[0] != 0:
        plane = planes.geom[p] if p < planes.geom.shape[0] else NO_GEOM
        solid = solids.geom[tiles.solid_item[s]] if s < last_s else NO_GEOM
        facet = facets.geom[tiles.triangle_item[t]] if t < last_t else NO_GEOM
        geom = min(plane, solid, facet)
        box = here.box
        if geom == NO_GEOM:
            break
        kind = SOLIDS
        items = tiles.solid_item
        bounds = solids.bounds
        begin = s
        end = s + 1
        if geom == plane:
            kind = PLANE
            items = here.plane
            begin = np.int64(0)
            end = np.int64(1)
            here.plane[0] = p
            p += 1
        elif geom == solid:
            s += 1
        else:
            kind = TRIANGLES
            items = tiles.triangle_item
            bounds = facets.bounds
            begin = t
            while t < last_t and facets.geom[items[t]] == geom:
                t += 1
            end = t
        # one loop for solids and triangles, as what it calls is compiled where it stands
        for k in range(3):
            box[0, k] = math.inf
            box[0, 3 + k] = -math.inf
        for i in items[begin : end if kind != PLANE else begin]:
            for k in range(3):
                box[0, k] = min(box[0, k], bounds[i, k])
                box[0, 3 + k] = max(box[0, 3 + k], bounds[i, 3 + k])
        if kind == PLANE:
            for k in range(3):
                box[0, k] = -math.inf
                box[0, 3 + k] = math.inf
            if (
                planes.mat[items[0], 2] == 0.0
                and planes.mat[items[0], 5] == 0.0
                and planes.mat[items[0], 8] > 0.0
            ):
                box[0, 5] = planes.pos[items[0], 2]  # of level ground
        count = _ask_geom(walk, kind, items[begin:end], geom, entries, count)
    return count


@subkernel(inline="always")
def _ask_geom(walk, kind, items, geom, entries, count):
    """Test a plane, a solid or a geom's triangles for the queries near; see `_look_at_tile`.

    A geom's triangles follow one another; the box around them is tested first.
    """
    lattice = walk.lattice
    window = walk.window
    here = walk.here
    queries = walk.queries
    if here.box[0, 2] >= here.span[1] or here.box[0, 5] <= here.span[0]:
        return count
    footprint = walk.footprint
    facets = walk.facets
    half = lattice.cell_size / 2 + 2.0 * TOUCH_DEPTH
    reach = max(half, max(footprint.square, footprint.radius) + 2.0 * TOUCH_DEPTH)
    all_near = window_near_box(lattice, window, here.box, 0, reach)
    still = here.still
    bands = here.bands
    still[:] = 0
    bands[:, 0] = math.inf
    bands[:, 1] = -math.inf
    for row in range(all_near[0], all_near[1]):
        for col in range(all_near[2], all_near[3]):
            r = row - window[0]
            c = col - window[2]
            for n in range(here.first[r, c], here.end[r, c]):
                queries.wanted[n] = 0
                column = _column(walk, n, row, col)
                if is_beside_prism(here.box, 0, column):
                    continue
                if kind == PLANE and not plane_meets_prism(walk.planes, items[0], column):
                    continue
                volumes = _volumes(walk, n, row, col)
                _begin(walk, kind, geom, n, volumes)
                left = np.int64(queries.wanted[n] & ~queries.flags[n])
                for k, volume in enumerate(volumes):
                    if left & (1 << k):
                        still[k] |= cell_bit(r, c)
                        bands[k, 0] = min(bands[k, 0], volume.low)
                        bands[k, 1] = max(bands[k, 1], volume.high)
    for i in items:
        if still[0] | still[1] | still[2] | still[3] == 0:
            break
        # the cells that want the disc's flag, or a square's, at the heights of a triangle
        wide = np.int64(0)
        narrow = np.int64(0)
        near = all_near
        for k in range(4):
            is_level = kind != TRIANGLES or (
                facets.bounds[i, 2] < bands[k, 1] and facets.bounds[i, 5] > bands[k, 0]
            )
            wide |= still[k] if is_level and 1 << k == BLOCKING else 0
            narrow |= still[k] if is_level and 1 << k != BLOCKING else 0
        if kind == TRIANGLES and wide | narrow != 0:
            near = window_near_box(
                lattice, all_near, facets.bounds, i, reach if wide != 0 else half
            )
            wide &= window_bits(window, near)
            if narrow != 0:
                square = window_near_box(lattice, near, facets.bounds, i, half)
                narrow &= window_bits(window, square)
        if wide | narrow == 0:  # so it is for most triangles of a fine mesh
            continue
        for row in range(near[0], near[1]):
            for col in range(near[2], near[3]):
                r = row - window[0]
                c = col - window[2]
                if (wide | narrow) & cell_bit(r, c) == 0:
                    continue
                left = np.int64(0)
                for n in range(here.first[r, c], here.end[r, c]):
                    if queries.wanted[n] & ~queries.flags[n]:
                        _ask_shape(walk, kind, i, n, _volumes(walk, n, row, col))
                        left |= queries.wanted[n] & ~queries.flags[n]
                for k in range(4):
                    still[k] &= -1 if left & (1 << k) else ~cell_bit(r, c)
    return _note_entries(walk, all_near, geom, entries, count)


@subkernel(inline="always")
def _begin(walk, kind, geom, n, volumes):
    """Note what is wanted of a geom over a query, and what the cell's line proves of it."""
    queries = walk.queries
    listing = walk.listing
    footprint = walk.footprint
    state = np.int64(queries.state[n])
    wanted = 0
    flags = 0
    # a square that is a part of the footprint is tested for each geom, others until one meets it
    if footprint.radius > 0.0 and (footprint.square > 0.0 or not state & BLOCKING_SQUARE):
        wanted = BLOCKING_SQUARE
    if listing.ceiling.shape[0] > 0:
        wanted |= OCCUPYING | BLOCKING
        if kind != PLANE and listing.probed[geom]:  # a plane is no wall
            wanted |= AT_WALL_HEIGHT
        # where the winding number of all geoms is no proof, that of one is none
        proves = OCCUPYING | AT_WALL_HEIGHT | (BLOCKING if state & BLOCKED_BY_LINE else 0)
        proved = _ask_line(walk.hits, queries.cell[n], geom, volumes)
        flags = proved & proves & wanted
    elif not state & BLOCKING:
        wanted |= BLOCKING
    queries.wanted[n] = wanted
    queries.flags[n] = flags


@subkernel(**NO_REFCOUNT)
def _ask_line(hits, cell, geom, volumes):
    """The flags that a cell's line proves of a geom: `is_line_blocked` for each volume."""
    stands, blocks, probed, _ = volumes
    lowest = min(stands.low, blocks.low, probed.low)
    flags = 0
    in_stands = 0
    in_blocks = 0
    in_probed = 0
    for i in range(hits.start[cell + 1] - 1, hits.start[cell] - 1, -1):
        z = hits.z[i]
        if z <= lowest:
            break
        if hits.geom[i] != geom:
            continue
        entered = 0
        if hits.closed[i]:
            entered = 1 if hits.normal[i, 2] > 0.0 else -1
        # a hit is within a volume, or counts for the winding number of what is below it
        if z >= stands.high:
            in_stands += entered
        elif z > stands.low:
            flags |= OCCUPYING
        if z >= blocks.high:
            in_blocks += entered
        elif z > blocks.low:
            flags |= BLOCKING
        if z >= probed.high:
            in_probed += entered
        elif z > probed.low:
            flags |= AT_WALL_HEIGHT
    flags |= OCCUPYING if in_stands > 0 else 0
    flags |= BLOCKING if in_blocks > 0 else 0
    return flags | (AT_WALL_HEIGHT if in_probed > 0 else 0)


@subkernel(**NO_REFCOUNT)
def _ask_shape(walk, kind, i, n, volumes):
    """Add the wanted flags of a plane, a solid or a triangle over a query."""
    queries = walk.queries
    footprint = walk.footprint
    flags = np.int64(queries.flags[n])
    wanted = np.int64(queries.wanted[n]) & ~flags
    for k, volume in enumerate(volumes):
        flag = 1 << k
        if not wanted & flag:
            continue
        if kind == PLANE:
            answer = MEETS if plane_meets_prism(walk.planes, i, volume) else APART
        elif kind == TRIANGLES:
            meets = facet_meets_prism(walk.facets, i, volume, walk.here.polygons)
            answer = MEETS if meets else APART
        elif is_beside_prism(walk.solids.bounds, i, volume):
            answer = APART
        else:
            # GJK is exact to a share of the prism's height: no more of it than the solid may meet
            high = min(volume.high, walk.solids.bounds[i, 5] + 1.0)
            part_of = Prism(volume.x, volume.y, volume.low, high, volume.half, volume.is_round)
            answer = solid_meets_prism(walk.solids, i, part_of, walk.here.simplex)
        if answer == APART:
            # what misses a volume misses the square that is a part of it
            if flag == OCCUPYING and footprint.low >= SAME_HEIGHT + TOUCH_DEPTH:
                wanted &= ~BLOCKING_SQUARE
            if flag == BLOCKING and footprint.square == 0.0:
                wanted &= ~BLOCKING_SQUARE
        elif answer == MEETS or flag in (OCCUPYING, AT_WALL_HEIGHT):
            flags |= flag
        else:
            flags |= MAYBE_BLOCKING if flag == BLOCKING else MAYBE_BLOCKING_SQUARE
    queries.flags[n] = flags


@subkernel(**NO_REFCOUNT)
def _note_entries(walk, near, geom, entries, count):
    """Note what a geom does over the queries near; the number of entries, -1 for no room."""
    here = walk.here
    queries = walk.queries
    footprint = walk.footprint
    lists = walk.listing.ceiling.shape[0] > 0
    for row in range(near[0], near[1]):
        for col in range(near[2], near[3]):
            r = row - walk.window[0]
            c = col - walk.window[2]
            is_open = lists
            for n in range(here.first[r, c], here.end[r, c]):
                flags = np.int64(queries.flags[n])
                if queries.wanted[n] and flags:
                    if flags & MAYBE_BLOCKING_SQUARE and footprint.square > 0.0:
                        flags |= MAYBE_BLOCKING
                    if flags & BLOCKING_SQUARE:
                        flags |= BLOCKING
                    queries.state[n] |= flags & (
                        BLOCKING | BLOCKING_SQUARE | MAYBE_BLOCKING | MAYBE_BLOCKING_SQUARE
                    )
                    flags &= ~(MAYBE_BLOCKING if flags & BLOCKING else 0)
                    if not flags & OCCUPYING:
                        flags &= ~AT_WALL_HEIGHT
                    flags &= OCCUPYING | BLOCKING | AT_WALL_HEIGHT | MAYBE_BLOCKING
                    if lists and flags:
                        if count == entries.geom.shape[0]:
                            return -1
                        entries.query[count] = n
                        entries.geom[count] = geom
                        entries.flags[count] = flags
                        count += 1
                queries.wanted[n] = 0
                state = np.int64(queries.state[n])
                is_open |= not state & BLOCKING or (
                    footprint.radius > 0.0 and not state & BLOCKING_SQUARE
                )
            if not is_open:
                here.open[0] &= ~cell_bit(r, c)
    return count
