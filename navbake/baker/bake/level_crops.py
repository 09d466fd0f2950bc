"""Converts layers, steps, doors and rooms for a grid: crops them to each level's own rectangle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from navbake.baker.bake.baked import BakedStructure, GridDoor, StructureLayers
from navbake.baker.bake.boxes import LevelBoxes
from navbake.baker.core.windows import Window
from navbake.baker.doors.doors import ClassifiedLeaf, find_door_cells, is_stuck, make_door
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.occupants.movable import MovableOccupants
from navbake.baker.rooms.rooms import Rooms
from navbake.config.settings import BakeConfig
from navbake.navgrid.rooms import Door, Runs
from navbake.types import Int, Json


def crop_layers(
    levels: Sequence[LevelFloor], rooms: Rooms, windows: Sequence[Window]
) -> list[StructureLayers]:
    """Crop the layers that follow from structure to each level's own rectangle.

    Args:
        levels: the levels on the whole lattice, lowest first.
        rooms: the room of each cell of the whole lattice.
        windows: the rectangle of each level: rows and columns of the lattice.

    Returns:
        The cropped layers, one record for each level.
    """
    layers = []
    for level, room_index, window in zip(levels, rooms.index, windows, strict=True):
        unseen = None
        if level.unseen is not None:
            unseen = level.unseen[window].astype(np.uint8)
        layers.append(
            StructureLayers(
                floor=level.floor[window].astype(np.float32),
                room_index=np.ascontiguousarray(room_index[window]),
                unseen=unseen,
            )
        )
    return layers


def crop_steps(steps: Int, boxes: LevelBoxes, num_cols: int) -> list[list[int]]:
    """Convert the cell ids of steps between levels to ids on each level's own rectangle.

    Args:
        steps: level a, cell a, level b, cell b, shape (n, 4), int64; cells of the lattice.
        boxes: the rectangle of each level.
        num_cols: the number of columns of the whole lattice.

    Returns:
        The same rows as `steps`; each cell's id is that on its level's own rectangle.
    """
    cropped_steps = steps.copy()
    # first row, first column and width of each level's rectangle
    rectangles = np.array(
        [(rows.start, cols.start, cols.stop - cols.start) for rows, cols in boxes.windows]
    )
    for level_column, cell_column in ((0, 1), (2, 3)):
        first_row, first_col, rectangle_width = rectangles[steps[:, level_column]].T
        row, col = np.divmod(steps[:, cell_column], num_cols)
        # Each cell has a floor, so that none lies outside of its rectangle.
        cropped_steps[:, cell_column] = (row - first_row) * rectangle_width + col - first_col
    step_rows: list[list[int]] = cropped_steps.tolist()
    return step_rows


def make_grid_door(
    leaf: ClassifiedLeaf,
    baked_structure: BakedStructure,
    occupants: MovableOccupants,
    config: BakeConfig,
) -> GridDoor:
    """Make a door of the grid, with the cells that nothing else occupies, by level.

    Args:
        leaf: a leaf that is a door.
        baked_structure: all that follows from structure; the rectangle of each level is read.
        occupants: the cells that anything except doors occupies.
        config: all settings; `doors.state` is the state that the door is written in.

    Returns:
        The door, and its entry in the file.
    """
    door_cells = find_door_cells(leaf, occupants.blocked, occupants.blocked_squares)
    door = make_door(
        leaf,
        door_cells,
        windows=baked_structure.boxes.windows,
        num_cols=baked_structure.lattice.width,
        wanted_state=config.doors.state,
    )
    return GridDoor(door, door_to_json(door), is_stuck(door_cells))


def door_to_json(door: Door) -> Json:
    """Return a door as it is written to a file; `navbake.navgrid.rooms.parse_doors` reads it."""
    entry: Json = {
        "id": door.id,
        "joint": door.joint,
        "rooms": list(door.rooms),
        "state": door.state,
        "cells": _runs_to_json(door.cells),
    }
    if door.width is not None:
        entry["width"] = door.width
    if door.solid:
        entry["solid"] = _runs_to_json(door.solid)
    return entry


def _runs_to_json(runs_by_state: Mapping[str, Mapping[int, Runs]]) -> Json:
    """Return the cells of each state of a door as they are written to a file.

    Args:
        runs_by_state: state of the door -> level -> runs of cells on the level's rectangle. Runs
            are a list of the first cell and the number of cells of each run, in turns.

    Returns:
        State of the door -> a list of pairs of a level and its runs.
    """
    entry: Json = {}
    for state, runs_by_level in runs_by_state.items():
        entry[state] = [[level, runs] for level, runs in runs_by_level.items()]
    return entry


def rooms_to_json(rooms: Rooms, doors: Sequence[ClassifiedLeaf]) -> list[Json]:
    """Return the table of rooms as it is written to a file, with the doors between rooms.

    Args:
        rooms: the table without doors.
        doors: the leaves that are doors.

    Returns:
        An entry for each room.
    """
    closed_doors = {door.candidate.id: (door.rooms, door.closed_cells) for door in doors}
    return [room.to_json() for room in rooms.with_neighbours(closed_doors).table]
