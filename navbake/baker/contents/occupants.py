"""What can move, and leaves that are no doors: which cells they are in, and what they block there.

They are looked at by themselves, over the floors that what stands has: all once, and again near
what moved. What they block, what stands blocks and what doors block is put together in the grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.column_blocks import place_columns
from navbake.baker.columns import Rows, cast_columns, cast_points, split_rows, tile_shapes
from navbake.baker.contents.cell_names import BLOCKERS, OBJECTS, WALLS, name_cells
from navbake.baker.contents.contents import Contents, find_tops, look_at_level, take_entries
from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.constants import BUILDING, OBJECT, TOUCH, WALL
from navbake.baker.kernels.walk import BLOCKS, PROBED, STANDS
from navbake.baker.lattice import Window, cells_near
from navbake.baker.occupancy.occupancy import Footprint, Occupancy
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import Shared, UserData, collector_off
from navbake.types import Bool, Float, Int, Int32

# Rows of cells whose entries lie together
BAND_ROWS = 8
# Where more than this share of a block's cells are looked at, all of its columns are cast together,
# which is faster by the column
MOST_POINTS = 1 / 8


class Entries(NamedTuple):
    """Geoms in cells, by cell and geom; flags as of `LevelContents`."""

    cell: Int
    geom: Int32
    flags: NDArray[np.uint8]


class LevelFound(NamedTuple):
    """What was found over the floors of some cells of a level.

    Attributes:
        entries: the geoms in them.
        occupied: those of the cells that these occupy.
        solid: those whose squares they meet.
    """

    entries: Entries
    occupied: Int
    solid: Int


class Occupants(NamedTuple):
    """What can move, and leaves that are no doors, over the floors of all levels.

    Attributes:
        entries: the geoms in cells, by level and band of `BAND_ROWS` rows.
        occupied: the cells of each level that they or what stands occupies, (height, width).
        solid: the cells whose squares they or what stands meets; None where these are the same.
    """

    entries: list[list[Entries]]
    occupied: list[Bool]
    solid: list[Bool] | None


NO_ENTRIES = Entries(
    cell=np.empty(0, dtype=np.int64),
    geom=np.empty(0, dtype=np.int32),
    flags=np.empty(0, dtype=np.uint8),
)


def find_occupants(
    shapes: Shapes,
    lattice: Lattice,
    floors: Floors,
    footprint: Footprint,
    agent: AgentSettings,
    standing: Occupancy,
) -> Occupants:
    """Find what can move over the floors of all cells.

    Args:
        shapes: the geometry of what can move.
        standing: the cells that what stands occupies.
    """
    cells = cells_near(lattice, boxes_of(shapes), footprint.reach + 2 * TOUCH)
    nothing = Occupants(
        entries=[[NO_ENTRIES] * -(-lattice.height // BAND_ROWS) for _ in floors.levels],
        occupied=standing.levels,
        solid=standing.solid,
    )
    return find_occupants_again(
        nothing,
        cells,
        shapes=shapes,
        lattice=lattice,
        floors=floors,
        footprint=footprint,
        agent=agent,
        standing=standing,
    )


def find_occupants_again(
    occupants: Occupants,
    cells: Int,
    shapes: Shapes,
    lattice: Lattice,
    floors: Floors,
    footprint: Footprint,
    agent: AgentSettings,
    standing: Occupancy,
) -> Occupants:
    """Replace what can move in some cells, ascending, by what is there now."""
    entries = [list(bands) for bands in occupants.entries]
    occupied = [layer.copy() for layer in occupants.occupied]
    solid = None if occupants.solid is None else [layer.copy() for layer in occupants.solid]
    for rows in split_rows(lattice):
        first, end = np.searchsorted(cells, rows.cells(lattice))
        some = cells[first:end]
        if not len(some):
            continue
        found = _look_at_cells(shapes, rows, some, lattice, floors, footprint, agent)
        for k, level in enumerate(found):
            _replace_entries(entries[k], some, level.entries, lattice)
            _replace_cells(occupied[k], standing.levels[k], some, level.occupied)
            if solid is not None and standing.solid is not None:
                _replace_cells(solid[k], standing.solid[k], some, level.solid)
    return Occupants(entries, occupied, solid)


def _replace_cells(layer: Bool, standing: Bool, cells: Int, occupied: Int) -> None:
    """Write into a layer which of some cells are occupied: as what stands has it, and more."""
    flat = layer.ravel()
    flat[cells] = standing.ravel()[cells]
    flat[occupied] = True


def bands_of(cells: Int, lattice: Lattice) -> list[int]:
    """The bands that hold some cells, ascending."""
    band = cells // (BAND_ROWS * lattice.width)
    bands: list[int] = band[np.diff(band, prepend=-1) != 0].tolist()
    return bands


def _replace_entries(bands: list[Entries], cells: Int, found: Entries, lattice: Lattice) -> None:
    """Replace the entries of some cells, ascending, in the bands that hold them."""
    band_cells = BAND_ROWS * lattice.width
    for band in bands_of(cells, lattice):
        ends = [band * band_cells, (band + 1) * band_cells]
        first, end = np.searchsorted(found.cell, ends).tolist()
        new = Entries(found.cell[first:end], found.geom[first:end], found.flags[first:end])
        before = bands[band]
        if len(before.cell):
            asked = np.zeros(band_cells, dtype=np.bool_)
            own_first, own_end = np.searchsorted(cells, ends).tolist()
            asked[cells[own_first:own_end] - ends[0]] = True
            kept = ~asked[before.cell - ends[0]]
            cell = np.concatenate([before.cell[kept], new.cell])
            order = np.argsort(cell, kind="stable")
            new = Entries(
                cell=cell[order],
                geom=np.concatenate([before.geom[kept], new.geom])[order],
                flags=np.concatenate([before.flags[kept], new.flags])[order],
            )
        bands[band] = new


def _look_at_cells(
    shapes: Shapes,
    rows: Rows,
    cells: Int,
    lattice: Lattice,
    floors: Floors,
    footprint: Footprint,
    agent: AgentSettings,
) -> list[LevelFound]:
    """Find what can move over some cells, ascending, of a block of rows, by level."""
    near = _only_near(shapes, cells, lattice, footprint.reach)
    tiled = tile_shapes(near, lattice, footprint.reach)
    first, end = rows.cells(lattice)
    if len(cells) > MOST_POINTS * (end - first):
        columns = cast_columns(tiled, rows)
    else:
        centers = lattice.positions(*np.divmod(cells, lattice.width))
        columns = place_columns(lattice, cells, cast_points(tiled, cells, centers))
    probed = np.zeros(len(shapes.endless), dtype=np.bool_)
    found = []
    for level, top in zip(floors.levels, find_tops(floors), strict=True):
        look = look_at_level(
            columns,
            tiled,
            footprint=footprint,
            cells=cells,
            level=level,
            top=top,
            agent=agent,
            probed=probed,
        )
        place, geom, flags = take_entries(
            look.listing.first,
            look.found.geom,
            look.found.flags,
            np.arange(len(look.cells)),
        )
        found.append(
            LevelFound(
                entries=Entries(look.cells[place], geom, flags),
                occupied=look.cells[look.found.occupied],
                solid=look.cells[look.found.solid],
            )
        )
    return found


def boxes_of(shapes: Shapes) -> Float:
    """Boxes round the geometry, one a geom, (n, 6) [m], endless for planes."""
    planes = np.tile(np.repeat([-np.inf, np.inf], 3), (len(shapes.planes.geom), 1))
    return np.concatenate([shapes.solids.bounds, shapes.meshes.boxes, planes])


def geoms_of(shapes: Shapes) -> Int32:
    """The geom of each of `boxes_of`."""
    return np.concatenate([shapes.solids.geom, shapes.meshes.geom, shapes.planes.geom])


def _only_near(shapes: Shapes, cells: Int, lattice: Lattice, reach: float) -> Shapes:
    """The shapes without the meshes whose boxes are not near the rectangle round some cells."""
    boxes = shapes.meshes.boxes
    if not len(boxes):
        return shapes
    row, col = np.divmod(cells, lattice.width)
    far = reach + lattice.cell_size
    x, y = lattice.positions(row[[0, -1]], np.array([col.min(), col.max()])).T
    is_near = (boxes[:, 0] <= x[1] + far) & (boxes[:, 3] >= x[0] - far)
    is_near &= (boxes[:, 1] <= y[0] + far) & (boxes[:, 4] >= y[1] - far)
    return replace(shapes, meshes=shapes.meshes.only(is_near))


def count_taken(
    occupants: Occupants,
    bands: Sequence[int] | None,
    standing: Sequence[Bool],
    mover_of: Int,
    num_bodies: int,
) -> Int:
    """How many cells each body takes that only what can move blocks; so a cup on a table none.

    Args:
        bands: the numbers of the bands of cells that count; all if None.
        standing: the cells that what stands occupies, by level.
        mover_of: by geom id, the body that it moves with.
    """
    taken = np.zeros(num_bodies, dtype=np.int64)
    for entries, layer in zip(occupants.entries, standing, strict=True):
        chosen = entries if bands is None else [entries[band] for band in bands]
        for band in chosen:
            counts = (band.flags & BLOCKS) > 0
            counts &= ~layer.ravel()[band.cell]
            # a cell's entries lie together, and so do those of a body in it
            pair = band.cell[counts] * num_bodies + mover_of[band.geom[counts]]
            is_first = np.diff(pair, prepend=-1) != 0
            taken += np.bincount(pair[is_first] % num_bodies, minlength=num_bodies)
    return taken


def name_contents(contents: Contents, occupants: Occupants, level: int, window: Window) -> UserData:
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


def _name_cells(contents: Contents, bands: Sequence[Entries], level: int, window: Window) -> Shared:
    moving_cell = np.concatenate([band.cell for band in bands])
    moving_geom = np.concatenate([band.geom for band in bands])
    moving_flags = np.concatenate([band.flags for band in bands])
    listed = contents.levels[level]
    cells = np.arange(len(listed.first))
    cell, geom, flags = take_entries(listed.first, listed.geom, listed.flags, cells)
    kind = contents.kinds[geom]
    stands = (flags & STANDS) > 0
    is_wall = (kind == WALL) | ((kind == BUILDING) & ((flags & PROBED) > 0))
    bits = np.where(flags & BLOCKS, BLOCKERS, 0)
    bits |= np.where(stands & is_wall, WALLS, 0)
    bits |= np.where(stands & (kind == OBJECT), OBJECTS, 0)
    carrier = listed.carrier
    below = np.flatnonzero(carrier >= 0)
    below = below[contents.kinds[carrier[below]] == OBJECT]
    # walls are what the settings call so
    standing_as = np.where(contents.kinds[moving_geom] == WALL, WALLS, OBJECTS)
    moving = np.where(moving_flags & BLOCKS, BLOCKERS, 0)
    moving |= np.where(moving_flags & STANDS, standing_as, 0)
    carried = np.full(len(below), OBJECTS)
    with collector_off():
        return Shared(
            *name_cells(
                np.concatenate([cell, below, moving_cell]),
                np.concatenate([geom, carrier[below], moving_geom]),
                np.concatenate([bits, carried, moving]),
                contents.names,
                listed.lattice,
                window,
            )
        )
