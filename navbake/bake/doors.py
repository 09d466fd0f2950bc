"""Doors: hinged and sliding bodies between rooms, and the cells that each blocks in each state.

Doors are no part of what floors, levels and rooms are found from. Their cells are laid over the
occupancy of everything else, so that a grid with a door in another state equals a bake of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.bake.collect import collect_shapes
from navbake.bake.columns import cast_columns, tile_shapes
from navbake.bake.extents import measure_geoms
from navbake.bake.levels import LevelFloor
from navbake.bake.model import data_with_joint
from navbake.bake.occupancy import Footprint, check_occupancy
from navbake.bake.scene import Scene
from navbake.bake.shapes import Shapes
from navbake.config import DoorSettings
from navbake.doors import STATES, to_runs
from navbake.lattice import Lattice

Bool = NDArray[np.bool_]
Float = NDArray[np.float64]
Int = NDArray[np.int64]

HINGE, SLIDE = 3, 2  # MuJoCo's numbers of these joints (mjtJoint)
QUARTER = np.pi / 2  # how far a hinge without limits opens [rad]
UPRIGHT = 0.9  # least cosine between a hinge's axis and the vertical
# What a leaf that is found by itself is like [m]
LEAF_HEIGHT = 1.5
LEAF_WIDTH = (0.4, 2.5)
LEAF_THICKNESS = 0.2
LOOK = 0.6  # how far on each side of a leaf its room may begin [m]


@dataclass(frozen=True)
class DoorBody:
    """A body that may be a door.

    Attributes:
        id: its body's name, or ``body <id>``.
        joint: its joint's name, or ``joint <id>``; None where it can't move.
        geoms: ids of the counted geoms of the body and of what hangs on it.
        positions: the joint's position in each state but removed [rad or m]; empty where it
            can't move.
        joint_id: MuJoCo's id of the joint, -1 for none.
        named: whether a pattern names it, rather than its looks.
    """

    id: str
    joint: str | None
    geoms: Int
    positions: dict[str, float]
    joint_id: int
    named: bool


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
    rooms: tuple[str | None, str | None]
    cells: dict[str, list[Int]]
    swept: list[Int]


@dataclass(frozen=True)
class PlacedDoors:
    """The doors, and what is occupied without them.

    Attributes:
        doors: the doors.
        occupied: per storey, shape (height, width), bool: by all but doors.
        strays: by name, what looked like a door and is none: for each level, the cells that it
            blocks as modelled; they are among the occupied ones.
    """

    doors: list[Door]
    occupied: list[Bool]
    strays: dict[str, list[Int]]


def find_door_bodies(scene: Scene, settings: DoorSettings) -> tuple[list[DoorBody], list[str]]:
    """Find the bodies that may be doors: by name, or because they hang and look like a leaf.

    Args:
        scene: the scene.
        settings: patterns, and whether to look for leaves.

    Returns:
        The bodies, by body id, and warnings. One that hangs on another door is part of it.
    """
    model = scene.model
    counted = np.array([report.counted for report in scene.geoms], dtype=np.bool_)
    found: list[DoorBody] = []
    inside: set[int] = set()
    used: set[str] = set()
    for body in range(1, model.nbody):
        if int(model.body_parentid[body]) in inside:
            inside.add(body)
            continue
        name = model.body(body).name or f"body {body}"
        pattern = next((p for p in settings.patterns if fnmatchcase(name, p)), None)
        joint = _own_joint(model, body)
        if pattern is None and (joint < 0 or not settings.find):
            continue
        geoms = _geoms_under(model, body, counted)
        if not len(geoms):
            continue
        candidate = _door_body(scene, name, joint, geoms, pattern is not None)
        if pattern is None and not _looks_like_leaf(scene, candidate):
            continue
        used.update(p for p in settings.patterns if fnmatchcase(name, p))
        inside.add(body)
        found.append(candidate)
    idle = [f"`doors.patterns`: {p!r} matches no body" for p in settings.patterns if p not in used]
    return found, idle


def without_doors(scene: Scene, doors: Sequence[DoorBody]) -> Scene:
    """The scene as floors, levels and rooms are found from: without what may be a door."""
    if not doors:
        return scene
    geoms = np.concatenate([door.geoms for door in doors])
    return replace(scene, shapes=_shapes_of(scene, scene.data, geoms, inverse=True))


def place_doors(
    scene: Scene,
    bodies: Sequence[DoorBody],
    lattice: Lattice,
    floors: Sequence[LevelFloor],
    occupied: Sequence[Bool],
    footprint: Footprint,
    room_at: Callable[[int, int], str | None],
) -> PlacedDoors:
    """Tell what each door blocks in each state, and which bodies are doors at all.

    A body that no pattern names is a door when it stands between two rooms, or between a room
    and the outside. What turns out to be none is laid over the occupancy as it is modelled.

    Args:
        scene: the whole scene.
        bodies: what may be doors.
        lattice: the whole lattice.
        floors: the storeys.
        occupied: per storey, shape (height, width), bool, without any door.
        footprint: the agent's volume.
        room_at: the id of the room of a level's cell, None for none.

    """
    base = [mask.copy() for mask in occupied]
    found: list[tuple[DoorBody, dict[str, list[Int]], tuple[str | None, str | None]]] = []
    strays: dict[str, list[Int]] = {}
    for body in bodies:
        blocked = {
            state: _blocked_cells(_posed_shapes(scene, body, state), lattice, floors, footprint)
            for state in STATES
            if state != "removed" and (state == "modelled" or body.positions)
        }
        closed = blocked.get("closed", blocked["modelled"])
        rooms = _rooms_beside(scene, body, lattice, floors, closed, room_at)
        if not body.named and rooms is None:
            for mask, cells in zip(base, blocked["modelled"], strict=True):
                mask.ravel()[cells] = True
            strays[body.id] = blocked["modelled"]
            continue
        blocked.setdefault("closed", blocked["modelled"])
        found.append((body, blocked, rooms or (None, None)))
    doors = [
        Door(
            id=body.id,
            joint=body.joint,
            rooms=rooms,
            cells={
                state: [
                    cells[~mask.ravel()[cells]] for mask, cells in zip(base, per_level, strict=True)
                ]
                for state, per_level in blocked.items()
            },
            swept=blocked["closed"],
        )
        for body, blocked, rooms in found
    ]
    return PlacedDoors(doors, base, strays)


def describe_doors(
    doors: Sequence[Door], state: str, cut: Callable[[int, Int], Int]
) -> list[dict[str, Any]]:
    """The doors as the file has them, see `navbake.doors`.

    Args:
        doors: the doors.
        state: the state that the grid is written in.
        cut: turns cells of the whole lattice into cells of a level's own rectangle.
    """
    return [
        {
            "id": door.id,
            "joint": door.joint,
            "rooms": list(door.rooms),
            "state": state,
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


# ---------------------------------------------------------------- bodies


def _geoms_under(model: Any, body: int, counted: Bool) -> Int:
    """The counted geoms of a body and of what hangs on it."""
    below = np.zeros(model.nbody, dtype=np.bool_)
    below[body] = True
    for child in range(body + 1, model.nbody):  # parents come before their children
        below[child] = below[int(model.body_parentid[child])]
    under: Int = np.flatnonzero(below[model.geom_bodyid] & counted)
    return under


def _own_joint(model: Any, body: int) -> int:
    """The body's hinge or slide if that is its only joint, else -1."""
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    is_door = count == 1 and int(model.jnt_type[first]) in (HINGE, SLIDE)
    return first if is_door else -1


def _door_body(scene: Scene, name: str, joint: int, geoms: Int, named: bool) -> DoorBody:
    model = scene.model
    if joint < 0:
        return DoorBody(name, None, geoms, {}, -1, named)
    modelled = float(scene.data.qpos[model.jnt_qposadr[joint]])
    low, high = (float(v) for v in model.jnt_range[joint])
    if not model.jnt_limited[joint]:
        low, high = 0.0, QUARTER if int(model.jnt_type[joint]) == HINGE else 1.0
    closed = min(max(0.0, low), high)
    open_ = low if closed - low > high - closed else high
    positions = {"modelled": modelled, "open": open_, "closed": closed}
    joint_name = model.joint(joint).name or f"joint {joint}"
    return DoorBody(name, joint_name, geoms, positions, joint, named)


def _looks_like_leaf(scene: Scene, body: DoorBody) -> bool:
    """Whether a body hangs on one hinge or slide, and is tall, thin and as wide as a door."""
    if body.joint_id < 0:
        return False
    axis = scene.data.xaxis[body.joint_id]
    is_hinge = int(scene.model.jnt_type[body.joint_id]) == HINGE
    if is_hinge != (abs(axis[2]) >= UPRIGHT):
        return False
    leaf = _leaf(scene, body)
    return (
        leaf.height >= LEAF_HEIGHT
        and LEAF_WIDTH[0] <= leaf.width <= LEAF_WIDTH[1]
        and leaf.thickness <= LEAF_THICKNESS
    )


# ---------------------------------------------------------------- places


@dataclass(frozen=True)
class _Leaf:
    """A closed leaf: the largest geom of a door, seen from above."""

    center: Float
    along: Float
    across: Float
    width: float
    thickness: float
    height: float


def _leaf(scene: Scene, body: DoorBody) -> _Leaf:
    shapes = _posed_shapes(scene, body, "closed" if body.positions else "modelled")
    extents = measure_geoms(shapes, scene.model.ngeom)
    area = (extents.long * (extents.high - extents.low))[body.geoms]
    largest = body.geoms[int(np.nanargmax(area))] if not np.isnan(area).all() else body.geoms[0]
    return _Leaf(
        center=extents.center[largest],
        along=extents.along[largest],
        across=extents.across[largest],
        width=float(extents.long[largest]),
        thickness=float(extents.thin[largest]),
        height=float(extents.high[largest] - extents.low[largest]),
    )


def _posed_shapes(scene: Scene, body: DoorBody, state: str) -> Shapes:
    data = scene.data
    if body.positions and state != "modelled":
        data = data_with_joint(scene.model, scene.data, body.joint_id, body.positions[state])
    return _shapes_of(scene, data, body.geoms)


def _shapes_of(scene: Scene, data: Any, geoms: Int, inverse: bool = False) -> Shapes:
    """The counted geometry of some geoms only, or of all but these."""
    chosen = np.zeros(len(scene.choices), dtype=np.bool_)
    chosen[geoms] = True
    choices = [
        replace(choice, counted=choice.counted and bool(chosen[geom]) != inverse)
        for geom, choice in enumerate(scene.choices)
    ]
    return collect_shapes(scene.model, data, choices, scene.parts).shapes


def _blocked_cells(
    shapes: Shapes, lattice: Lattice, floors: Sequence[LevelFloor], footprint: Footprint
) -> list[Int]:
    """For each level, the cells with a floor whose volume the shapes meet."""
    none: Int = np.empty(0, dtype=np.int64)
    bounds = shapes.bounds()
    window = None if bounds is None else _window(bounds, lattice, footprint.reach)
    if window is None:
        return [none] * len(floors)
    rows, cols = window
    tiled = tile_shapes(shapes, lattice.cut(rows, cols), footprint.reach)
    columns = cast_columns(tiled)
    width = cols.stop - cols.start
    blocked = []
    for level in floors:
        floor = level.floor[rows, cols].ravel()
        local: Int = np.flatnonzero(~np.isnan(floor))
        answer = check_occupancy(columns, tiled, footprint, local, floor[local]).occupied
        row, col = np.divmod(local[answer], width)
        blocked.append((row + rows.start) * lattice.width + col + cols.start)
    return blocked


def _window(bounds: Float, lattice: Lattice, reach: float) -> tuple[slice, slice] | None:
    """The cells round a box, or None where it lies beside the lattice."""
    corners = np.array(
        [[bounds[0, 0] - reach, bounds[1, 1] + reach], [bounds[1, 0] + reach, bounds[0, 1] - reach]]
    )
    row, col = lattice.rows_cols(corners)
    rows = slice(max(int(row[0]) - 1, 0), min(int(row[1]) + 2, lattice.height))
    cols = slice(max(int(col[0]) - 1, 0), min(int(col[1]) + 2, lattice.width))
    return (rows, cols) if rows.start < rows.stop and cols.start < cols.stop else None


def _rooms_beside(
    scene: Scene,
    body: DoorBody,
    lattice: Lattice,
    floors: Sequence[LevelFloor],
    closed: Sequence[Int],
    room_at: Callable[[int, int], str | None],
) -> tuple[str | None, str | None] | None:
    """The rooms on a closed leaf's two sides, None for outside; None if they aren't two."""
    sizes = [len(cells) for cells in closed]
    if not any(sizes):
        return None
    level = int(np.argmax(sizes))
    leaf = _leaf(scene, body)
    sides = [_side(leaf, way, level, lattice, floors[level], room_at) for way in (-1.0, 1.0)]
    if sides[0] == sides[1]:
        return None
    return sides[0], sides[1]


def _side(
    leaf: _Leaf,
    way: float,
    level: int,
    lattice: Lattice,
    floor: LevelFloor,
    room_at: Callable[[int, int], str | None],
) -> str | None:
    """The room that most of one side of a leaf looks into, 0.6 m away; None for none."""
    votes: dict[str | None, int] = {}
    for share in (-0.3, -0.15, 0.0, 0.15, 0.3):
        start = leaf.center + leaf.along * share * leaf.width
        found: str | None = None
        for distance in np.arange(0.0, LOOK, lattice.cell_size / 2):
            point = start + leaf.across * way * (leaf.thickness / 2 + distance)
            row, col = (int(v) for v in lattice.rows_cols(point))
            inside = 0 <= row < lattice.height and 0 <= col < lattice.width
            if not inside or np.isnan(floor.floor[row, col]):
                found = None  # where the floor ends, the outside begins
                continue
            room = room_at(level, row * lattice.width + col)
            if room is None:
                break  # a wall
            found = room
        votes[found] = votes.get(found, 0) + 1
    return max(votes, key=lambda room: (votes[room], room is not None, room or ""))
