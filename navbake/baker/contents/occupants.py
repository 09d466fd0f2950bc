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

from navbake.baker.column_blocks import place_columns
from navbake.baker.columns import cast_points, tile_shapes
from navbake.baker.contents.cell_names import BLOCKERS, OBJECTS, WALLS, name_cells
from navbake.baker.contents.contents import Contents, find_tops, look_at_level, take_entries
from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.constants import BUILDING, OBJECT, TOUCH, WALL
from navbake.baker.kernels.walk import BLOCKS, PROBED, STANDS
from navbake.baker.lattice import Window, cells_near
from navbake.baker.occupancy.occupancy import Footprint
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import Shared, UserData, collector_off
from navbake.types import Bool, Float, Int, Int32


class LevelOccupants(NamedTuple):
    """What can move, in the cells of a storey.

    Attributes:
        cell, geom, flags: the geoms in cells, by cell and geom; flags as of `LevelContents`.
        occupied: the cells that they occupy, ascending.
        solid: the cells whose squares they meet, ascending; empty where the footprint is the
            square.
    """

    cell: Int
    geom: Int32
    flags: NDArray[np.uint8]
    occupied: Int
    solid: Int


NO_CELLS = np.empty(0, dtype=np.int64)
NOTHING = LevelOccupants(
    cell=NO_CELLS,
    geom=np.empty(0, dtype=np.int32),
    flags=np.empty(0, dtype=np.uint8),
    occupied=NO_CELLS,
    solid=NO_CELLS,
)


def find_occupants(
    shapes: Shapes,
    lattice: Lattice,
    floors: Floors,
    footprint: Footprint,
    agent: AgentSettings,
    cells: Int | None = None,
) -> list[LevelOccupants]:
    """Find what can move over the floors of cells, by level.

    Args:
        shapes: the geometry of what can move.
        cells: the cells that are looked at, ascending; all near the shapes if None.
    """
    boxes = boxes_of(shapes)
    if cells is None:
        cells = cells_near(lattice, boxes, footprint.reach + 2 * TOUCH)
    if not len(cells):
        return [NOTHING for _ in floors.levels]
    shapes = _only_near(shapes, boxes, cells, lattice, footprint.reach)
    tiled = tile_shapes(shapes, lattice, footprint.reach)
    centers = lattice.positions(*np.divmod(cells, lattice.width))
    columns = place_columns(lattice, cells, cast_points(tiled, cells, centers))
    probed = np.zeros(len(shapes.endless), dtype=np.bool_)
    occupants = []
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
        solid = look.cells[look.found.solid] if footprint.radius > 0.0 else look.cells[:0]
        occupants.append(
            LevelOccupants(
                cell=look.cells[place],
                geom=geom,
                flags=flags,
                occupied=look.cells[look.found.occupied],
                solid=solid,
            )
        )
    return occupants


def boxes_of(shapes: Shapes) -> Float:
    """Boxes round the geometry, one a geom, (n, 6) [m], endless for planes."""
    planes = np.tile(np.repeat([-np.inf, np.inf], 3), (len(shapes.planes.geom), 1))
    return np.concatenate([shapes.solids.bounds, shapes.meshes.boxes, planes])


def geoms_of(shapes: Shapes) -> Int32:
    """The geom of each of `boxes_of`."""
    return np.concatenate([shapes.solids.geom, shapes.meshes.geom, shapes.planes.geom])


def _only_near(
    shapes: Shapes, boxes: Float, cells: Int, lattice: Lattice, reach: float
) -> Shapes:
    """The shapes whose boxes are near the rectangle round some cells."""
    row, col = np.divmod(cells, lattice.width)
    far = reach + lattice.cell_size
    x, y = lattice.positions(row[[0, -1]], np.array([col.min(), col.max()])).T
    is_near = (boxes[:, 0] <= x[1] + far) & (boxes[:, 3] >= x[0] - far)
    is_near &= (boxes[:, 1] <= y[0] + far) & (boxes[:, 4] >= y[1] - far)
    if is_near.all():
        return shapes
    chosen = np.zeros(len(shapes.endless), dtype=np.bool_)
    chosen[geoms_of(shapes)[is_near]] = True
    return shapes.only(chosen)


def replace_occupants(
    occupants: Sequence[LevelOccupants], cells: Int, num_cells: int, found: Sequence[LevelOccupants]
) -> list[LevelOccupants]:
    """Replace what can move in some cells by what was found there again."""
    is_other = np.zeros(num_cells, dtype=np.bool_)
    is_other[cells] = True
    replaced = []
    for before, now in zip(occupants, found, strict=True):
        kept = ~is_other[before.cell]
        cell = np.concatenate([before.cell[kept], now.cell])
        order = np.argsort(cell, kind="stable")
        replaced.append(
            LevelOccupants(
                cell=cell[order],
                geom=np.concatenate([before.geom[kept], now.geom])[order],
                flags=np.concatenate([before.flags[kept], now.flags])[order],
                occupied=_replace_cells(before.occupied, is_other, now.occupied),
                solid=_replace_cells(before.solid, is_other, now.solid),
            )
        )
    return replaced


def _replace_cells(before: Int, is_other: Bool, now: Int) -> Int:
    return np.sort(np.concatenate([before[~is_other[before]], now]))


def count_taken(
    occupants: Sequence[LevelOccupants], standing: Sequence[Bool], mover_of: Int, num_bodies: int
) -> Int:
    """How many cells each body takes that only what can move blocks; so a cup on a table none.

    Args:
        standing: the cells that what stands occupies, by level.
        mover_of: by geom id, the body that it moves with.
    """
    taken = np.zeros(num_bodies, dtype=np.int64)
    for level, occupied in zip(occupants, standing, strict=True):
        blocks = (level.flags & BLOCKS) > 0
        blocks &= ~occupied.ravel()[level.cell]
        pairs = np.unique(level.cell[blocks] * num_bodies + mover_of[level.geom[blocks]])
        taken += np.bincount(pairs % num_bodies, minlength=num_bodies)
    return taken


def name_contents(
    contents: Contents, occupants: Sequence[LevelOccupants], level: int, window: Window
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
    return UserData(partial(_name_cells, contents, occupants[level], level, window))


def _name_cells(
    contents: Contents, occupants: LevelOccupants, level: int, window: Window
) -> Shared:
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
    standing_as = np.where(contents.kinds[occupants.geom] == WALL, WALLS, OBJECTS)
    moving = np.where(occupants.flags & BLOCKS, BLOCKERS, 0)
    moving |= np.where(occupants.flags & STANDS, standing_as, 0)
    carried = np.full(len(below), OBJECTS)
    with collector_off():
        return Shared(
            *name_cells(
                np.concatenate([cell, below, occupants.cell]),
                np.concatenate([geom, carrier[below], occupants.geom]),
                np.concatenate([bits, carried, moving]),
                contents.names,
                listed.lattice,
                window,
            )
        )
