"""Doors: which of the bodies that may be one join rooms, and what each blocks in each state.

Doors are no part of what floors, levels and rooms are found from. Their cells are laid over the
occupancy of everything else, so that a grid with a door in another state equals a bake of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import cast_columns, tile_shapes
from navbake.baker.doors.bodies import DoorBody, largest_side, pose_doors
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.occupancy.occupancy import Footprint, check_occupancy
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.navgrid.doors import STATES, to_runs
from navbake.navgrid.lattice import Lattice

Bool = NDArray[np.bool_]
Float = NDArray[np.float64]
Int = NDArray[np.int64]
RoomAt = Callable[[int, int], str | None]
Rooms = tuple[str | None, str | None]

LOOK = 0.6  # how far on each side of a leaf its room may begin [m]
# Where along a leaf one looks for the rooms on its sides, as shares of its width
SHARES = (-0.3, -0.15, 0.0, 0.15, 0.3)


@dataclass(frozen=True)
class Door:
    """A door on the grid.

    Attributes:
        id: its body's name.
        joint: its joint's name, or None.
        rooms: the ids of the rooms on its two sides, None for the outside.
        cells: by state, for each level the cells of the whole lattice that it blocks and
            nothing else does, ascending.
        swept: the cells that its closed leaf meets, whatever else does, for each level.
    """

    id: str
    joint: str | None
    rooms: Rooms
    cells: dict[str, list[Int]]
    swept: list[Int]

    def state(self, wanted: str) -> str:
        """The state that it is in where all doors are to be in another: that if it has it."""
        return wanted if wanted == "removed" or wanted in self.cells else "modelled"


@dataclass(frozen=True)
class Place:
    """What doors stand in: the scene without them.

    Attributes:
        lattice: the whole lattice.
        floors: the storeys.
        occupied: per storey, shape (height, width), bool.
        footprint: the agent's volume.
        room_at: the id of the room of a level's cell, None for none.
    """

    lattice: Lattice
    floors: Sequence[LevelFloor]
    occupied: Sequence[Bool]
    footprint: Footprint
    room_at: RoomAt


def place_doors(
    scene: Scene, bodies: Sequence[DoorBody], place: Place
) -> tuple[list[Door], list[DoorBody]]:
    """Tell what each door blocks in each state, and which bodies are doors at all.

    A body that no pattern names is a door when it stands between two rooms, or between a room
    and the outside. What turns out to be none belongs to the scene: floors and rooms are to be
    found once more with it. What stands beside the lattice as it is modelled is neither.

    Args:
        scene: the whole scene, as modelled.
        bodies: what may be doors.
        place: what was found without them.

    Returns:
        The doors, and what looks like a door and joins no two rooms.
    """
    if not bodies:
        return [], []
    posed = {state: pose_doors(scene, bodies, state) for state in STATES if state != "removed"}
    extents = measure_geoms(posed["closed"], scene.model.ngeom)
    doors: list[Door] = []
    strays: list[DoorBody] = []
    for body in bodies:
        blocked = _blocked_by_state(posed, body, place)
        leaf = _Leaf.of(extents, body)
        rooms = _rooms_beside(leaf, blocked["closed"], place)
        if rooms is None and not body.named:
            if _is_on_lattice(posed["modelled"], body, place):
                strays.append(body)
            continue
        cells = {
            state: [_only_free(*both) for both in zip(per_level, place.occupied, strict=True)]
            for state, per_level in blocked.items()
        }
        doors.append(Door(body.id, body.joint, rooms or (None, None), cells, blocked["closed"]))
    return doors, strays


def tell_stuck(doors: Sequence[Door], state: str) -> list[str]:
    """Tell which doors can't be in the state that all are to be in."""
    return [
        f"door {door.id!r} can't be {state}, as it has no hinge or slide of its own: it stays as "
        f"modelled"
        for door in doors
        if door.state(state) != state
    ]


def describe_doors(
    doors: Sequence[Door], state: str, cut: Callable[[int, Int], Int]
) -> list[dict[str, Any]]:
    """The doors as the file has them, see `navbake.navgrid.doors`.

    Args:
        doors: the doors.
        state: the state that the grid is written in; doors that haven't it are as modelled.
        cut: turns cells of the whole lattice into cells of a level's own rectangle.
    """
    return [
        {
            "id": door.id,
            "joint": door.joint,
            "rooms": list(door.rooms),
            "state": door.state(state),
            "cells": {
                name: [
                    [level, to_runs(cut(level, cells))]
                    for level, cells in enumerate(per_level)
                    if len(cells)
                ]
                for name, per_level in door.cells.items()
            },
        }
        for door in doors
    ]


# ---------------------------------------------------------------- what a door blocks


def _blocked_by_state(
    posed: dict[str, Shapes], body: DoorBody, place: Place
) -> dict[str, list[Int]]:
    """For each state that the door has, and each level, the cells that it meets.

    A door that can't move is closed as it is modelled.
    """
    blocked: dict[str, list[Int]] = {}
    at: dict[float | None, str] = {}
    for state, shapes in posed.items():
        position = body.position(state)
        if position in at:
            blocked[state] = blocked[at[position]]
        else:
            at[position] = state
            blocked[state] = _blocked_cells(_shapes_of(shapes, body), place)
    if not body.positions:
        del blocked["open"]
    return blocked


def _shapes_of(shapes: Shapes, body: DoorBody) -> Shapes:
    geoms = np.zeros(len(shapes.closed), dtype=np.bool_)
    geoms[body.geoms] = True
    return shapes.only(geoms)


def _is_on_lattice(shapes: Shapes, body: DoorBody, place: Place) -> bool:
    bounds = _shapes_of(shapes, body).bounds()
    return bounds is None or place.lattice.window(bounds, place.footprint.reach) is not None


def _blocked_cells(shapes: Shapes, place: Place) -> list[Int]:
    """For each level, the cells with a floor whose volume the shapes meet."""
    lattice, footprint = place.lattice, place.footprint
    none: Int = np.empty(0, dtype=np.int64)
    bounds = shapes.bounds()
    window = None if bounds is None else lattice.window(bounds, footprint.reach)
    if window is None:
        return [none] * len(place.floors)
    rows, cols = window
    tiled = tile_shapes(shapes, lattice.cut(rows, cols), footprint.reach)
    columns = cast_columns(tiled)
    width = cols.stop - cols.start
    blocked = []
    for level in place.floors:
        floor = level.floor[rows, cols].ravel()
        local: Int = np.flatnonzero(~np.isnan(floor))
        answer = check_occupancy(columns, tiled, footprint, local, floor[local]).occupied
        row, col = np.divmod(local[answer], width)
        blocked.append((row + rows.start) * lattice.width + col + cols.start)
    return blocked


def _only_free(cells: Int, occupied: Bool) -> Int:
    return cells[~occupied.ravel()[cells]]


# ---------------------------------------------------------------- what a door joins


@dataclass(frozen=True)
class _Leaf:
    """A closed leaf: the largest geom of a door, seen from above."""

    center: Float
    along: Float
    across: Float
    width: float
    thickness: float

    @classmethod
    def of(cls, extents: Extents, body: DoorBody) -> _Leaf:
        largest = largest_side(extents, body.geoms)
        across = extents.across[largest]
        return cls(
            center=extents.center[largest],
            along=np.array([-across[1], across[0]]),
            across=across,
            width=float(extents.long[largest]),
            thickness=float(extents.thin[largest]),
        )

    def looks(self, step: float) -> Float:
        """Where one looks: sides, places along the leaf, steps away from it, x and y [m]."""
        distance = self.thickness / 2 + np.arange(0.0, LOOK, step)
        start = self.center + self.along * np.array(SHARES)[:, None] * self.width
        side = self.across * np.array([-1.0, 1.0])[:, None, None, None]
        away: Float = start[:, None] + side * distance[:, None]
        return away


def _rooms_beside(leaf: _Leaf, closed: Sequence[Int], place: Place) -> Rooms | None:
    """The rooms on a closed leaf's two sides, None for outside; None if they aren't two."""
    sizes = [len(cells) for cells in closed]
    if not any(sizes) or not np.isfinite(leaf.center).all():
        return None
    level = int(np.argmax(sizes))
    row, col = place.lattice.rows_cols(leaf.looks(place.lattice.cell_size / 2))
    sides = [_side(row[side], col[side], level, place) for side in (0, 1)]
    return (sides[0], sides[1]) if sides[0] != sides[1] else None


def _side(rows: Int, cols: Int, level: int, place: Place) -> str | None:
    """The room that most of one side of a leaf looks into; None for none.

    Args:
        rows, cols: the cells that it looks at, shape (places, steps away).
        level: their level.
        place: what there is.
    """
    lattice, floor = place.lattice, place.floors[level].floor
    votes: dict[str | None, int] = {}
    for line in zip(rows.tolist(), cols.tolist(), strict=True):
        found: str | None = None
        for row, col in zip(*line, strict=True):
            inside = 0 <= row < lattice.height and 0 <= col < lattice.width
            if not inside or np.isnan(floor[row, col]):
                found = None  # where the floor ends, the outside begins
                continue
            room = place.room_at(level, row * lattice.width + col)
            if room is None:
                break  # a wall
            found = room
        votes[found] = votes.get(found, 0) + 1
    return max(votes, key=lambda room: (votes[room], room is not None, room or ""))
