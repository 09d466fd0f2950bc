"""What can move, and leaves that are no doors: which cells they are in, and what they block there.

They are looked at by themselves, over the floors that what stands has: all once, and again near
what moved. What they block, what stands blocks and what doors block is put together in the grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.column_sources import index_by_cell
from navbake.baker.columns.columns import (
    RowChunk,
    cast_columns,
    cast_points,
    split_into_row_chunks,
    tile_shapes,
)
from navbake.baker.core.constants import BUILDING, OBJECT, WALL
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.baker.core.windows import Window, cells_near_boxes
from navbake.baker.floors.levels import Floors
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.occupancy.occupancy import Footprint, Occupancy
from navbake.baker.occupancy.occupancy_kernels import AT_WALL_HEIGHT, BLOCKING, OCCUPYING
from navbake.baker.occupants.cell_names import BLOCKERS, OBJECTS, WALLS, name_cells
from navbake.baker.occupants.standing import (
    StandingOccupants,
    check_level_occupancy,
    entries_of_cells,
    find_tops,
)
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import Shared, UserData, without_garbage_collection
from navbake.types import Bool, Float, Int, Int32

# Rows of cells whose entries lie together
CHUNK_ROWS = 16
# Where more than this share of a block's cells are looked at, all of its columns are cast together,
# which is faster by the column
MOST_POINTS = 1 / 8


class Entries(NamedTuple):
    """Geoms in cells, by cell and geom; flags as of `LevelOccupants`."""

    cell: Int
    geom: Int32
    flags: NDArray[np.uint8]


class LevelMovables(NamedTuple):
    """What was found over the floors of some cells of a level.

    Attributes:
        entries: the geoms in them.
        occupied: those of the cells that these occupy.
        solid: those whose squares they meet.
    """

    entries: Entries
    occupied: Int
    solid: Int


class MovableOccupants(NamedTuple):
    """What can move, and leaves that are no doors, over the floors of all levels.

    Attributes:
        entries: the geoms in cells, by level and band of `CHUNK_ROWS` rows.
        blocked: the cells of each level that they or what stands blocks, (height, width).
        blocked_squares: the cells whose squares they or what stands blocks; None where these are
            the same.
        num_blocked_alone: by body id, how many cells it blocks that nothing which stands blocks.
    """

    entries: list[list[Entries]]
    blocked: list[Bool]
    blocked_squares: list[Bool] | None
    num_blocked_alone: Int


class MovableContext(NamedTuple):
    """Over which floors one looks for what can move, and for what.

    Attributes:
        lattice: the cells.
        floors: the storeys.
        standing: the cells that what stands occupies.
        footprint: the volume over a cell's floor that has to be free.
        agent: who needs it.
        mover_of: by geom id, the body that it moves with.
    """

    lattice: Lattice
    floors: Floors
    standing: Occupancy
    footprint: Footprint
    agent: AgentSettings
    mover_of: Int


NO_ENTRIES = Entries(
    cell=np.empty(0, dtype=np.int64),
    geom=np.empty(0, dtype=np.int32),
    flags=np.empty(0, dtype=np.uint8),
)


def find_movable_occupants(
    over: MovableContext, shapes: Shapes, in_the_way: Bool
) -> MovableOccupants:
    """Find what can move over the floors of all cells.

    Args:
        shapes: all geometry that counts.
        in_the_way: by geom id, whether it is looked for.
    """
    num_bands = -(-over.lattice.height // CHUNK_ROWS)
    nothing = MovableOccupants(
        entries=[[NO_ENTRIES] * num_bands for _ in over.floors.levels],
        blocked=over.standing.levels,
        blocked_squares=over.standing.blocked_squares,
        num_blocked_alone=np.zeros(int(over.mover_of.max(initial=0)) + 1, dtype=np.int64),
    )
    boxes = shapes.boxes[in_the_way[shapes.boxed_geoms]]
    return update_movable_occupants(nothing, over, shapes, in_the_way, boxes)


def update_movable_occupants(
    occupants: MovableOccupants,
    over: MovableContext,
    shapes: Shapes,
    in_the_way: Bool,
    boxes: Float,
) -> MovableOccupants:
    """Find again what can move in the cells near some boxes, (n, 6) [m]."""
    lattice = over.lattice
    cells = cells_near_boxes(lattice, boxes, over.footprint.reach + 2 * TOUCH_DEPTH)
    if not len(cells):
        return occupants
    entries = [list(bands) for bands in occupants.entries]
    occupied = [layer.copy() for layer in occupants.blocked]
    solid = (
        None
        if occupants.blocked_squares is None
        else [layer.copy() for layer in occupants.blocked_squares]
    )
    taken = occupants.num_blocked_alone.copy()
    for rows in split_into_row_chunks(lattice):
        first, end = np.searchsorted(cells, rows.cell_range(lattice))
        some = cells[first:end]
        if not len(some):
            continue
        near = in_the_way & _mark_near(shapes, some, lattice, over.footprint.reach)
        for k, found in enumerate(_look_at_cells(over, shapes.only(near), rows, some)):
            standing = over.standing.levels[k]
            removed = _replace_entries(entries[k], some, found.entries, lattice)
            taken -= _count_taken(removed, standing, over.mover_of, len(taken))
            taken += _count_taken(found.entries, standing, over.mover_of, len(taken))
            _replace_cells(occupied[k], standing, some, found.occupied)
            if solid is not None and over.standing.blocked_squares is not None:
                _replace_cells(solid[k], over.standing.blocked_squares[k], some, found.solid)
    return MovableOccupants(entries, occupied, solid, taken)


def _replace_cells(layer: Bool, standing: Bool, cells: Int, occupied: Int) -> None:
    """Write into a layer which of some cells are occupied: as what stands has it, and more."""
    flat = layer.ravel()
    flat[cells] = standing.ravel()[cells]
    flat[occupied] = True


def _replace_entries(bands: list[Entries], cells: Int, found: Entries, lattice: Lattice) -> Entries:
    """Replace the entries of some cells, ascending, in their bands; returns the former ones."""
    band_cells = CHUNK_ROWS * lattice.width
    removed = [NO_ENTRIES]
    band_of = cells // band_cells
    for band in band_of[np.diff(band_of, prepend=-1) != 0].tolist():
        low = band * band_cells
        high = low + band_cells
        first, end = np.searchsorted(found.cell, [low, high]).tolist()
        new = Entries(found.cell[first:end], found.geom[first:end], found.flags[first:end])
        before = bands[band]
        if len(before.cell):
            is_asked = np.zeros(band_cells, dtype=np.bool_)
            first, end = np.searchsorted(cells, [low, high]).tolist()
            is_asked[cells[first:end] - low] = True
            is_removed = is_asked[before.cell - low]
            removed.append(Entries(*(array[is_removed] for array in before)))
            kept = Entries(*(array[~is_removed] for array in before))
            both = join_entries([kept, new])
            order = np.argsort(both.cell, kind="stable")
            new = Entries(both.cell[order], both.geom[order], both.flags[order])
        bands[band] = new
    return join_entries(removed)


def join_entries(parts: Sequence[Entries]) -> Entries:
    """The entries of several parts, one after the other."""
    return Entries(
        cell=np.concatenate([part.cell for part in parts]),
        geom=np.concatenate([part.geom for part in parts]),
        flags=np.concatenate([part.flags for part in parts]),
    )


def _count_taken(entries: Entries, standing: Bool, mover_of: Int, num_bodies: int) -> Int:
    """How many cells each body blocks that nothing which stands blocks."""
    blocks_alone = (entries.flags & BLOCKING) > 0
    blocks_alone &= ~standing.ravel()[entries.cell]
    # a cell's entries lie together, and so do those of a body in it
    bodies = mover_of[entries.geom[blocks_alone]]
    pair = entries.cell[blocks_alone] * num_bodies + bodies
    is_first = np.diff(pair, prepend=-1) != 0
    return np.bincount(pair[is_first] % num_bodies, minlength=num_bodies)


def _look_at_cells(
    over: MovableContext, shapes: Shapes, rows: RowChunk, cells: Int
) -> list[LevelMovables]:
    """Find what can move over some cells, ascending, of a block of rows, by level."""
    lattice = over.lattice
    tiled = tile_shapes(shapes, lattice, over.footprint.reach)
    first, end = rows.cell_range(lattice)
    if len(cells) > MOST_POINTS * (end - first):
        columns = cast_columns(tiled, rows)
    else:
        centers = lattice.positions(*np.divmod(cells, lattice.width))
        columns = index_by_cell(lattice, cells, cast_points(tiled, cells, centers))
    probed = np.zeros(len(shapes.endless), dtype=np.bool_)
    found = []
    for level, top in zip(over.floors.levels, find_tops(over.floors), strict=True):
        look = check_level_occupancy(
            columns,
            tiled,
            footprint=over.footprint,
            cells=cells,
            level=level,
            top=top,
            agent=over.agent,
            probed=probed,
        )
        place, geom, flags = entries_of_cells(
            look.listing.first,
            look.found.geom,
            look.found.flags,
            np.arange(len(look.cells)),
        )
        found.append(
            LevelMovables(
                entries=Entries(look.cells[place], geom, flags),
                occupied=look.cells[look.found.occupied],
                solid=look.cells[look.found.solid],
            )
        )
    return found


def _mark_near(shapes: Shapes, cells: Int, lattice: Lattice, reach: float) -> Bool:
    """Mark the geoms whose boxes are near the rectangle round some cells, ascending."""
    row, col = np.divmod(cells, lattice.width)
    far = reach + lattice.cell_size
    x, y = lattice.positions(row[[0, -1]], np.array([col.min(), col.max()])).T
    boxes = shapes.boxes
    is_near = (boxes[:, 0] <= x[1] + far) & (boxes[:, 3] >= x[0] - far)
    is_near &= (boxes[:, 1] <= y[0] + far) & (boxes[:, 4] >= y[1] - far)
    marked = np.zeros(len(shapes.endless), dtype=np.bool_)
    marked[shapes.boxed_geoms[is_near]] = True
    return marked


def name_occupants(
    contents: StandingOccupants, occupants: MovableOccupants, level: int, window: Window
) -> UserData:
    """Name what is in a storey's cells, as the original client does.

    `objects` are all things but walls and the building's own floors, ceilings and stairs, also
    those that one stands on (rugs, pallets); `walls` the walls. Both stand, hang or lie between
    the floor and the next storey. `blockers` are what the agent's disc or square meets in its
    band, where these are not the same names. `navbake.navgrid.door_states.with_door_names` adds
    the doors.

    The data is by cell id on the window: sorted names under each key that has any.
    """
    # deferred: planning and plotting don't need it
    return UserData(partial(_name_cells, contents, occupants.entries[level], level, window))


def _name_cells(
    contents: StandingOccupants, bands: Sequence[Entries], level: int, window: Window
) -> Shared:
    moving = join_entries(bands)
    listed = contents.levels[level]
    cells = np.arange(len(listed.first))
    cell, geom, flags = entries_of_cells(listed.first, listed.geom, listed.flags, cells)
    kind = contents.kinds[geom]
    stands = (flags & OCCUPYING) > 0
    is_wall = (kind == WALL) | ((kind == BUILDING) & ((flags & AT_WALL_HEIGHT) > 0))
    bits = np.where(flags & BLOCKING, BLOCKERS, 0)
    bits |= np.where(stands & is_wall, WALLS, 0)
    bits |= np.where(stands & (kind == OBJECT), OBJECTS, 0)
    carrier = listed.carrier
    below = np.flatnonzero(carrier >= 0)
    below = below[contents.kinds[carrier[below]] == OBJECT]
    # walls are what the settings call so
    standing_as = np.where(contents.kinds[moving.geom] == WALL, WALLS, OBJECTS)
    moving_bits = np.where(moving.flags & BLOCKING, BLOCKERS, 0)
    moving_bits |= np.where(moving.flags & OCCUPYING, standing_as, 0)
    carried = np.full(len(below), OBJECTS)
    with without_garbage_collection():
        return Shared(
            *name_cells(
                np.concatenate([cell, below, moving.cell]),
                np.concatenate([geom, carrier[below], moving.geom]),
                np.concatenate([bits, carried, moving_bits]),
                contents.names,
                listed.lattice,
                window,
            )
        )
