"""Finds the cells that contain, or are blocked by, movables and leaves that are no doors.

A bake checks all cells with a floor; an update checks the cells near things that moved. A cell of
the grid is occupied if a movable, structure or a door blocks it.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
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
from navbake.baker.core.windows import Window, find_cells_near_boxes
from navbake.baker.floors.levels import Floors
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import (
    StructureOccupancy,
    check_level_occupancy,
    select_list_entries,
)
from navbake.baker.occupancy.volume_kernels import AT_WALL_HEIGHT, BLOCKING, OCCUPYING
from navbake.baker.occupants.cell_names import BLOCKERS, OBJECTS, WALLS, name_cells
from navbake.baker.occupants.standing import StandingOccupants
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import SharedEntries, UserData
from navbake.types import Bool, Float, Int, Int32

# Entries are stored in chunks; a chunk has those of this many rows of cells
ROWS_PER_CHUNK = 16
# If more than this share of the cells of some rows are checked, the vertical lines of all cells in
# these rows are cast together, which takes less time for each line
MAX_SHARE_OF_SINGLE_CELLS = 1 / 8


def _make_key_bits() -> Int:
    """Make the table of the keys under which structure is listed in the user data of a cell.

    Returns:
        The bits OBJECTS, WALLS and BLOCKERS, by the kind of a geom and by its flags in the cell,
        shape (kinds, 256).
    """
    kind, flags = np.ogrid[: BUILDING + 1, :256]
    is_occupying = (flags & OCCUPYING) > 0
    is_wall = (kind == WALL) | ((kind == BUILDING) & ((flags & AT_WALL_HEIGHT) > 0))
    key_bits = np.where(flags & BLOCKING, BLOCKERS, 0)
    key_bits = key_bits | np.where(is_occupying & is_wall, WALLS, 0)
    key_bits |= np.where(is_occupying & (kind == OBJECT), OBJECTS, 0)
    return np.asarray(key_bits, dtype=np.int64)


KEY_BITS = _make_key_bits()


class OccupantEntries(NamedTuple):
    """Pairs of a cell and a geom in it, ordered by cell and then geom; arrays of shape (n,).

    Attributes:
        cell: cell ids, int64.
        geom: geom ids, int32.
        flags: bits that say which volumes over the cell's floor the geom meets, see
            `LevelOccupants.flags`, uint8.
    """

    cell: Int
    geom: Int32
    flags: NDArray[np.uint8]


class LevelMovables(NamedTuple):
    """The movables over some cells of a level.

    Attributes:
        entries: the movables in each cell.
        blocked: ids of the cells where these geoms overlap the footprint of an agent at the cell's
            centre (the cell's square joined with the agent's disc).
        blocked_squares: the same for the cell's own square, without the agent's disc.
    """

    entries: OccupantEntries
    blocked: Int
    blocked_squares: Int


class MovableOccupants(NamedTuple):
    """Movables, and leaves that are no doors, over the floors of all levels.

    Attributes:
        entries: for each level and row chunk, the geoms in its cells.
        blocked: for each level, a mask of the cells that anything but a door blocks: these geoms or
            structure, (height, width), bool.
        blocked_squares: like `blocked`, but a geom has to overlap the cell's own square; the
            agent's disc does not count. None if it would equal `blocked`.
        num_free_cells_blocked: for each body, the number of cells that it blocks and structure
            doesn't block.
    """

    entries: list[list[OccupantEntries]]
    blocked: list[Bool]
    blocked_squares: list[Bool] | None
    num_free_cells_blocked: Int

    @property
    def occupied(self) -> list[Bool]:
        """The same as `blocked`: its name before version 0.4."""
        text = "`stages.occupants.occupied` is called `stages.occupants.blocked` since 0.4"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return self.blocked


class MovableSearchInputs(NamedTuple):
    """The inputs of the search for movables that stay the same while things move.

    Attributes:
        lattice: the whole lattice.
        floors: the floors of all levels.
        structure_occupancy: the cells that structure occupies.
        footprint: the volume over a floor that has to be free.
        agent: the agent; its height and largest slope are read.
        mover_of_geom: for each geom, the id of the body that it moves with.
    """

    lattice: Lattice
    floors: Floors
    structure_occupancy: StructureOccupancy
    footprint: Footprint
    agent: AgentSettings
    mover_of_geom: Int


NO_ENTRIES = OccupantEntries(
    cell=np.empty(0, dtype=np.int64),
    geom=np.empty(0, dtype=np.int32),
    flags=np.empty(0, dtype=np.uint8),
)


def find_movable_occupants(
    inputs: MovableSearchInputs, shapes: Shapes, is_obstacle_geom: Bool
) -> MovableOccupants:
    """Find the movables, and leaves that are no doors, over the floors of all cells.

    Args:
        inputs: the floors, and the structure that stands on them.
        shapes: all geometry that the bake uses.
        is_obstacle_geom: mask by geom id of the geoms to search for, shape (ngeom,), bool.

    Returns:
        The geoms in each cell, and the cells that they or structure block.
    """
    num_chunks = -(-inputs.lattice.height // ROWS_PER_CHUNK)
    structure_occupancy = inputs.structure_occupancy
    blocked_squares = None
    if structure_occupancy.blocked_squares is not None:
        blocked_squares = [mask.copy() for mask in structure_occupancy.blocked_squares]
    no_occupants = MovableOccupants(
        entries=[[NO_ENTRIES] * num_chunks for _ in inputs.floors.levels],
        blocked=[mask.copy() for mask in structure_occupancy.levels],
        blocked_squares=blocked_squares,
        num_free_cells_blocked=np.zeros(
            int(inputs.mover_of_geom.max(initial=0)) + 1, dtype=np.int64
        ),
    )
    boxes = shapes.boxes[is_obstacle_geom[shapes.geom_of_box]]
    cells = find_affected_cells(inputs, boxes)
    occupants, _ = update_movable_occupants(no_occupants, inputs, shapes, is_obstacle_geom, cells)
    return occupants


def find_affected_cells(inputs: MovableSearchInputs, boxes: Float) -> Int:
    """Find the cells whose occupants may change if geoms move.

    Args:
        inputs: the lattice and the footprint are read.
        boxes: boxes around these geoms, before and after the move: lower corner, upper corner,
            shape (n, 6) [m].

    Returns:
        Ids of the cells, ascending, shape (m,).
    """
    return find_cells_near_boxes(
        inputs.lattice, boxes, inputs.footprint.half_width + 2 * TOUCH_DEPTH
    )


def update_movable_occupants(
    occupants: MovableOccupants,
    inputs: MovableSearchInputs,
    shapes: Shapes,
    is_obstacle_geom: Bool,
    cells: Int,
) -> tuple[MovableOccupants, list[Int]]:
    """Bring the occupants up to date after things moved; only some cells are searched again.

    Args:
        occupants: the occupants before the move. Their masks are changed, as copies of whole masks
            would take a tenth of an update; the entries are not, as grids read them later.
        inputs: the floors, and the structure that stands on them.
        shapes: all geometry that the bake uses, in the new pose.
        is_obstacle_geom: mask by geom id of the geoms to search for, shape (ngeom,), bool.
        cells: ids of the cells to search again, ascending, see `find_affected_cells`.

    Returns:
        The occupants after the move, with the same masks; and for each level, the ids of the cells
        in which the masks have changed, ascending.
    """
    lattice = inputs.lattice
    footprint = inputs.footprint
    if not len(cells):
        return occupants, [cells for _ in occupants.blocked]
    entries = [list(row_chunks) for row_chunks in occupants.entries]
    changed_cells: list[list[Int]] = [[] for _ in occupants.blocked]
    num_free_cells_blocked = occupants.num_free_cells_blocked.copy()
    num_bodies = len(num_free_cells_blocked)
    for rows in split_into_row_chunks(lattice):
        first_cell, end_cell = np.searchsorted(cells, rows.cell_range(lattice))
        row_cells = cells[first_cell:end_cell]
        if not len(row_cells):
            continue
        is_near = is_obstacle_geom & _mark_geoms_near(
            shapes, row_cells, lattice, footprint.half_width
        )
        movables_by_level = _find_movables_over_cells(inputs, shapes.only(is_near), rows, row_cells)
        for level_number, movables in enumerate(movables_by_level):
            structure_mask = inputs.structure_occupancy.levels[level_number]
            replaced_entries = _replace_cell_entries(
                entries[level_number], row_cells, movables.entries, lattice
            )
            num_free_cells_blocked -= _count_free_cells_blocked(
                replaced_entries, structure_mask, inputs.mover_of_geom, num_bodies
            )
            num_free_cells_blocked += _count_free_cells_blocked(
                movables.entries, structure_mask, inputs.mover_of_geom, num_bodies
            )
            is_changed = _update_blocked_mask(
                occupants.blocked[level_number], structure_mask, row_cells, movables.blocked
            )
            if (
                occupants.blocked_squares is not None
                and inputs.structure_occupancy.blocked_squares is not None
            ):
                is_changed |= _update_blocked_mask(
                    occupants.blocked_squares[level_number],
                    inputs.structure_occupancy.blocked_squares[level_number],
                    row_cells,
                    movables.blocked_squares,
                )
            changed_cells[level_number].append(row_cells[is_changed])
    updated_occupants = occupants._replace(
        entries=entries, num_free_cells_blocked=num_free_cells_blocked
    )
    return updated_occupants, [np.concatenate(chunks) for chunks in changed_cells]


def _update_blocked_mask(
    mask: Bool, is_blocked_by_structure: Bool, cells: Int, blocked_cells: Int
) -> Bool:
    """Update some cells of a mask of blocked cells, after movables were searched for in them.

    Args:
        mask: the mask, (height, width); is changed.
        is_blocked_by_structure: a mask of the cells that structure blocks, (height, width).
        cells: ids of the cells to update.
        blocked_cells: ids of those updated cells that movables block.

    Returns:
        Marks those of `cells` that have changed.
    """
    flat_mask = mask.ravel()
    was_blocked = flat_mask[cells]
    flat_mask[cells] = is_blocked_by_structure.ravel()[cells]
    flat_mask[blocked_cells] = True
    is_changed: Bool = flat_mask[cells] != was_blocked
    return is_changed


def _replace_cell_entries(
    entries_by_chunk: list[OccupantEntries],
    cells: Int,
    new_entries: OccupantEntries,
    lattice: Lattice,
) -> OccupantEntries:
    """Replace the entries of some cells in their row chunks; return the entries that were replaced.

    Args:
        entries_by_chunk: the entries of each row chunk; the list is changed.
        cells: ids of the cells, ascending.
        new_entries: the new entries of these cells.
        lattice: the whole lattice.
    """
    chunk_size = ROWS_PER_CHUNK * lattice.width
    replaced_entries = [NO_ENTRIES]
    first_chunk, last_chunk = (cells[[0, -1]] // chunk_size).tolist()
    first_cells = np.arange(first_chunk, last_chunk + 2) * chunk_size  # of the chunks
    cell_slices = _slices_between(cells, first_cells)
    entry_slices = _slices_between(new_entries.cell, first_cells)
    for chunk_number, cell_slice, entry_slice in zip(
        range(first_chunk, last_chunk + 1), cell_slices, entry_slices, strict=True
    ):
        if cell_slice.start == cell_slice.stop:
            continue
        entries = _select_entries(new_entries, entry_slice)
        chunk_entries = entries_by_chunk[chunk_number]
        if len(chunk_entries.cell):
            first_cell = chunk_number * chunk_size
            is_updated_cell = np.zeros(chunk_size, dtype=np.bool_)
            is_updated_cell[cells[cell_slice] - first_cell] = True
            is_replaced_entry = is_updated_cell[chunk_entries.cell - first_cell]
            replaced_entries.append(_select_entries(chunk_entries, is_replaced_entry))
            remaining_entries = _select_entries(chunk_entries, ~is_replaced_entry)
            merged_entries = join_entries([remaining_entries, entries])
            entries = _select_entries(
                merged_entries, np.argsort(merged_entries.cell, kind="stable")
            )
        entries_by_chunk[chunk_number] = entries
    return join_entries(replaced_entries)


def _slices_between(values: Int, borders: Int) -> list[slice]:
    """Divide ascending values at borders: return the slice from each border to the next one."""
    return [slice(*ends) for ends in pairwise(np.searchsorted(values, borders).tolist())]


def _select_entries(entries: OccupantEntries, selection: Bool | Int | slice) -> OccupantEntries:
    """Return the entries that a mask, an array of indices or a slice selects."""
    return OccupantEntries(
        entries.cell[selection], entries.geom[selection], entries.flags[selection]
    )


def join_entries(entry_chunks: Sequence[OccupantEntries]) -> OccupantEntries:
    """Concatenate the entries (geoms in cells) of several row chunks, in their order."""
    return OccupantEntries(
        cell=np.concatenate([chunk.cell for chunk in entry_chunks]),
        geom=np.concatenate([chunk.geom for chunk in entry_chunks]),
        flags=np.concatenate([chunk.flags for chunk in entry_chunks]),
    )


def _count_free_cells_blocked(
    entries: OccupantEntries, is_blocked_by_structure: Bool, mover_of_geom: Int, num_bodies: int
) -> Int:
    """Count for each body the cells that it blocks and structure doesn't.

    Args:
        entries: geoms in cells of a level.
        is_blocked_by_structure: a mask of the cells that structure blocks, shape (height, width).
        mover_of_geom: for each geom, the id of the body that it moves with.
        num_bodies: number of bodies.

    Returns:
        The number of cells by body id, shape (num_bodies,).
    """
    blocks_free_cell = (entries.flags & BLOCKING) > 0
    blocks_free_cell &= ~is_blocked_by_structure.ravel()[entries.cell]
    # a cell's entries lie together, and so do those of a body in it
    bodies = mover_of_geom[entries.geom[blocks_free_cell]]
    cell_body_key = entries.cell[blocks_free_cell] * num_bodies + bodies
    is_first_of_pair = np.ones(len(cell_body_key), dtype=np.bool_)
    np.not_equal(cell_body_key[1:], cell_body_key[:-1], out=is_first_of_pair[1:])
    return np.bincount(cell_body_key[is_first_of_pair] % num_bodies, minlength=num_bodies)


def _find_movables_over_cells(
    inputs: MovableSearchInputs, shapes: Shapes, rows: RowChunk, cells: Int
) -> list[LevelMovables]:
    """Find the movables over some cells, for each level.

    Args:
        inputs: the floors, and the structure that stands on them.
        shapes: the geometry of the movables near the cells.
        rows: the rows that contain the cells.
        cells: ids of the cells, ascending.
    """
    lattice = inputs.lattice
    tiled_shapes = tile_shapes(shapes, lattice, inputs.footprint.half_width)
    first_cell, end_cell = rows.cell_range(lattice)
    if len(cells) > MAX_SHARE_OF_SINGLE_CELLS * (end_cell - first_cell):
        columns = cast_columns(tiled_shapes, rows)
    else:
        centers = lattice.positions(*np.divmod(cells, lattice.width))
        columns = index_by_cell(lattice, cells, cast_points(tiled_shapes, cells, centers))
    no_wall_candidates = np.zeros(len(shapes.is_endless), dtype=np.bool_)
    movables_by_level = []
    occupancy_by_level = check_level_occupancy(
        columns,
        tiled_shapes,
        footprint=inputs.footprint,
        cells=cells,
        floors=inputs.floors,
        agent=inputs.agent,
        wall_candidates=no_wall_candidates,
    )
    for level_occupancy in occupancy_by_level:
        occupancy = level_occupancy.occupancy
        cell_index, geom, flags = select_list_entries(
            level_occupancy.occupant_lists.list_start,
            occupancy.geom,
            occupancy.flags,
            np.arange(len(level_occupancy.cells)),
        )
        movables_by_level.append(
            LevelMovables(
                entries=OccupantEntries(level_occupancy.cells[cell_index], geom, flags),
                blocked=level_occupancy.cells[occupancy.occupied],
                blocked_squares=level_occupancy.cells[occupancy.square_occupied],
            )
        )
    return movables_by_level


def _mark_geoms_near(shapes: Shapes, cells: Int, lattice: Lattice, max_distance: float) -> Bool:
    """Mark the geoms whose boxes are near the rectangle round some cells, seen from above.

    Args:
        shapes: the geometry of the geoms.
        cells: ids of the cells, ascending, at least one.
        lattice: the whole lattice.
        max_distance: the greatest distance of a geom from a cell's centre at which it counts [m].

    Returns:
        A mask by geom id, shape (ngeom,), bool.
    """
    first_row, last_row = (cells[[0, -1]] // lattice.width).tolist()
    cols = cells % lattice.width
    margin = max_distance + lattice.cell_size
    x_min, y_max = lattice.position(first_row, int(cols.min()))  # rows go from north to south
    x_max, y_min = lattice.position(last_row, int(cols.max()))
    boxes = shapes.boxes
    is_near = (boxes[:, 0] <= x_max + margin) & (boxes[:, 3] >= x_min - margin)
    is_near &= (boxes[:, 1] <= y_max + margin) & (boxes[:, 4] >= y_min - margin)
    is_near_geom = np.zeros(len(shapes.is_endless), dtype=np.bool_)
    is_near_geom[shapes.geom_of_box[is_near]] = True
    return is_near_geom


def name_occupants(
    standing: StandingOccupants, movable: MovableOccupants, level: int, window: Window
) -> UserData:
    """Return the names of the geoms in a level's cells, under the keys of the grid's JSON format.

    `objects` names all things between the floor and the next storey, also those that an agent
    stands on (rugs, pallets), except walls and the building's own floors, ceilings and stairs.
    `walls` names the walls there. `blockers` names the geoms that the agent's disc or the cell's
    square meets within the agent's height; it is left out where it has the same names as `objects`
    and `walls` together. `navbake.navgrid.door_states.with_door_names` adds the doors.

    Args:
        standing: the structure in the cells.
        movable: the movables in the cells.
        level: number of the level.
        window: the rows and columns of the lattice that the grid holds.

    Returns:
        For each cell of the window that has any: key -> sorted names, by cell id on the window.
        They are computed when they are first read.
    """
    # deferred: planning and plotting don't need it
    return UserData(partial(_name_cells, standing, movable.entries[level], level, window))


def _name_cells(
    standing: StandingOccupants,
    movable_entry_chunks: Sequence[OccupantEntries],
    level: int,
    window: Window,
) -> SharedEntries:
    """Return the names of the geoms in a level's cells, see `name_occupants`.

    Args:
        standing: the structure in the cells.
        movable_entry_chunks: the movables in the cells of the level, by row chunk.
        level: number of the level.
        window: the rows and columns of the lattice that the grid holds.
    """
    occupants = standing.levels[level]
    all_cells = np.arange(len(occupants.list_start))
    occupied_cells, occupant_geoms, flags = select_list_entries(
        occupants.list_start, occupants.geom, occupants.flags, all_cells
    )
    key_bits = KEY_BITS[standing.kinds[occupant_geoms], flags]

    # things that are the floor of a cell
    floor_cells = np.flatnonzero(occupants.floor_geom >= 0)
    floor_geom = occupants.floor_geom[floor_cells]
    is_thing = standing.kinds[floor_geom] == OBJECT
    floor_cells = floor_cells[is_thing]
    floor_geom = floor_geom[is_thing]
    floor_key_bits = np.full(len(floor_cells), OBJECTS)

    movable_entries = join_entries(movable_entry_chunks)
    # of what can move, only what the settings name is a wall
    object_or_wall_bit = np.where(standing.kinds[movable_entries.geom] == WALL, WALLS, OBJECTS)
    movable_key_bits = np.where(movable_entries.flags & BLOCKING, BLOCKERS, 0)
    movable_key_bits |= np.where(movable_entries.flags & OCCUPYING, object_or_wall_bit, 0)
    cells, entry_numbers, entries = name_cells(
        np.concatenate([occupied_cells, floor_cells, movable_entries.cell]),
        np.concatenate([occupant_geoms, floor_geom, movable_entries.geom]),
        np.concatenate([key_bits, floor_key_bits, movable_key_bits]),
        names=standing.names,
        lattice=occupants.lattice,
        window=window,
    )
    return SharedEntries(cells, entry_numbers, entries)
