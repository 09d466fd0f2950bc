"""Finds which leaves are doors, which rooms each connects, and which cells each blocks.

A leaf is a body that may be a door, see `DoorCandidate`. Floors and levels are found without the
leaves; closed leaves separate rooms. Whether a leaf is a door depends on floors and rooms alone,
not on movables. The cells that only a door blocks are stored separately. So a door's state can be
switched in a grid, with the same result as a bake in that state.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from navbake.baker.columns.columns import ColumnSource
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import NEIGHBOR_SLICES, Window, crop_cells
from navbake.baker.doors.posed_leaves import MIN_CARRIED_AREA, CellsByState, Leaf, LeafCells
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.floors.surfaces import find_standable_tops
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.rooms.leaves import mark_visible
from navbake.baker.rooms.rooms import RoomIds, Rooms
from navbake.baker.scene.leaves import DoorCandidate, mark_candidate_geoms
from navbake.baker.scene.roles import MOVABLE
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, BakeConfig
from navbake.navgrid.rooms import Door, Runs, to_runs
from navbake.threads import limit_threads
from navbake.types import Bool, Int, Int32

# A door is stuck if, when open, it blocks at least this share of the cells that it closes
STUCK_SHARE = 0.75
# State of a door -> its description in warnings
STATE_TEXTS = {
    "modelled": "as it is modelled",
    "open": "when it is open",
    "closed": "when it is closed",
}


@dataclass(frozen=True, eq=False)
class ClassifiedLeaf:
    """A body that may be a door (a leaf), classified as a door or as an obstacle.

    An obstacle stays in its modelled pose. The classification depends on floors and rooms, and not
    on movables.

    Attributes:
        leaf: the geometry of the leaf in each state.
        is_door: whether the leaf is a door. A leaf that is no door has no rooms.
        rooms: the ids of the rooms on both sides; None for the outside.
        blocked: state -> for each level, ids of the cells where the leaf overlaps an agent at the
            cell's centre, see `LeafCells`.
        blocked_squares: state -> for each level, ids of the cells whose own square overlaps the
            leaf; empty if the agent is no wider than a cell.
        carried_floor_warning: the warning that an agent could walk on the door's top; empty if none
            could.
    """

    leaf: Leaf
    is_door: bool
    rooms: RoomIds
    blocked: CellsByState
    blocked_squares: CellsByState
    carried_floor_warning: str

    @property
    def candidate(self) -> DoorCandidate:
        """The door candidate of the scene that the leaf belongs to."""
        return self.leaf.candidate

    @property
    def closed_cells(self) -> Sequence[Int]:
        """For each level, the ids of the cells that the closed leaf blocks."""
        return self.blocked["closed"]

    def state(self, wanted_state: str) -> str:
        """Return the wanted state if the door has that state, else ``modelled``.

        All doors have the state ``removed``, in which they block nothing.
        """
        return (
            wanted_state
            if wanted_state == "removed" or wanted_state in self.blocked
            else "modelled"
        )


@dataclass(frozen=True)
class DoorInputs:
    """The floors, rooms and hits by which a leaf is classified as a door or as an obstacle.

    Attributes:
        columns: hits of structure on the vertical line through each cell's centre.
        floors: the floors of each level.
        rooms: the rooms; closed leaves separate them.
        agent: the agent; its height and highest step are read.
    """

    columns: ColumnSource
    floors: Sequence[LevelFloor]
    rooms: Rooms
    agent: AgentSettings


def select_doors(leaves: Sequence[ClassifiedLeaf]) -> list[ClassifiedLeaf]:
    """Return the leaves that are doors."""
    return [leaf for leaf in leaves if leaf.is_door]


def mark_obstacle_geoms(scene: Scene, leaves: Sequence[ClassifiedLeaf], config: BakeConfig) -> Bool:
    """Mark the geoms of movables, and of leaves that are no doors.

    Such geoms block cells; they make no floors, rooms or doors. With `scene.exclude.movable`, a
    leaf that can move and is no door is not marked.

    Args:
        scene: the posed scene.
        leaves: all classified leaves, doors or not.
        config: all settings.

    Returns:
        For each geom, whether it is marked, shape (ngeom,), bool.
    """
    rejected_leaves = [leaf.candidate for leaf in leaves if not leaf.is_door]
    is_obstacle_geom = mark_candidate_geoms(len(scene.roles), rejected_leaves)
    if config.scene.exclude.movable:
        is_obstacle_geom &= scene.is_structure_body[scene.model.geom_bodyid]
    is_obstacle_geom |= scene.roles == MOVABLE
    return is_obstacle_geom


# ---------------------------------------------------------------- which leaves are doors


def classify_leaves(leaves: Sequence[LeafCells], inputs: DoorInputs) -> list[ClassifiedLeaf]:
    """Decide which leaves (bodies that may be doors) are doors.

    A leaf that a pattern of the settings or the scene file names as a door is always a door. All
    other leaves are doors if they stand between two rooms, or between a room and the outside.

    Args:
        leaves: all leaves, with the cells that they block.
        inputs: floors and rooms.

    Returns:
        A classified leaf for each leaf, in the same order.
    """
    # For each level and cell, how many closed leaves block it
    num_leaves_by_level = [np.zeros(level.floor.size, dtype=np.int32) for level in inputs.floors]
    for leaf in leaves:
        for num_leaves_of_cell, closed_cells in zip(
            num_leaves_by_level, leaf.blocked["closed"], strict=True
        ):
            num_leaves_of_cell[closed_cells] += 1
    with limit_threads(1):  # a door is too small to be worth more
        return [_classify_leaf(leaf, num_leaves_by_level, inputs) for leaf in leaves]


def _classify_leaf(
    leaf_cells: LeafCells, num_leaves_by_level: Sequence[Int32], inputs: DoorInputs
) -> ClassifiedLeaf:
    """Decide whether a leaf is a door.

    Args:
        leaf_cells: the leaf, with the cells that it blocks.
        num_leaves_by_level: for each level and cell, how many closed leaves block it.
        inputs: floors and rooms.
    """
    leaf = leaf_cells.leaf
    rooms = _find_rooms_beside(leaf, leaf_cells.blocked["closed"], num_leaves_by_level, inputs)
    is_door = rooms is not None or leaf.candidate.is_named
    return ClassifiedLeaf(
        leaf=leaf,
        is_door=is_door,
        rooms=rooms or (None, None),
        blocked=leaf_cells.blocked,
        blocked_squares=leaf_cells.blocked_squares,
        carried_floor_warning=_warn_carried_floor(leaf, inputs) if is_door else "",
    )


def closes_same_cells(leaf_cells: LeafCells, former_leaf: ClassifiedLeaf) -> bool:
    """Return whether a leaf in its new pose closes the same cells, so that rooms stay as they are.

    That is so if all of these are the same as before: the cells that the closed leaf blocks, the
    cells on the lines away from it, and whether it is named as a door.

    Args:
        leaf_cells: the leaf in its new pose.
        former_leaf: the classified leaf in its previous pose.
    """
    lines = leaf_cells.leaf.lines
    former_lines = former_leaf.leaf.lines
    if lines is None or former_lines is None:
        has_same_lines = lines is former_lines
    else:
        has_same_lines = all(map(np.array_equal, lines, former_lines))
    return (
        has_same_lines
        and leaf_cells.leaf.candidate.is_named == former_leaf.candidate.is_named
        and all(map(np.array_equal, leaf_cells.blocked["closed"], former_leaf.closed_cells))
    )


def move_leaf(
    leaf_cells: LeafCells, former_leaf: ClassifiedLeaf, inputs: DoorInputs
) -> ClassifiedLeaf:
    """Return a classified leaf in a new pose, with the classification and rooms of the old pose.

    The new pose must close the same cells as the old one, see `closes_same_cells`.

    Args:
        leaf_cells: the leaf in its new pose.
        former_leaf: the classified leaf in its previous pose.
        inputs: floors and rooms.
    """
    carried_floor_warning = (
        _warn_carried_floor(leaf_cells.leaf, inputs) if former_leaf.is_door else ""
    )
    return replace(
        former_leaf,
        leaf=leaf_cells.leaf,
        blocked=leaf_cells.blocked,
        blocked_squares=leaf_cells.blocked_squares,
        carried_floor_warning=carried_floor_warning,
    )


def _find_rooms_beside(
    leaf: Leaf,
    closed_cells: Sequence[Int],
    num_leaves_by_level: Sequence[Int32],
    inputs: DoorInputs,
) -> RoomIds | None:
    """Find the rooms on both sides of a closed leaf, along lines away from it.

    The room of a line is the last room that it meets before a wall or another closed leaf; the room
    of a side is that of most of its lines. If both sides have the same room, lines continue behind
    other leaves, up to a wall. If both sides still have the same room, as where the doorway belongs
    to it, only the last cell of each line counts. If that is in no room, the side is the outside.

    Args:
        leaf: the leaf.
        closed_cells: for each level, ids of the cells that the closed leaf blocks.
        num_leaves_by_level: for each level and cell, how many closed leaves block it.
        inputs: floors and rooms.

    Returns:
        The ids of the two rooms, None for the outside. None instead of a pair if a side meets only
        a wall, if both sides have the same room, or if the leaf blocks no cell.
    """
    num_closed_cells = [len(cells) for cells in closed_cells]
    if not any(num_closed_cells) or leaf.lines is None:
        return None
    level_number = int(np.argmax(num_closed_cells))
    sight_cells = leaf.lines.sight_cells  # (sides, lines, steps)
    is_on_lattice = sight_cells >= 0
    clipped_cells = np.maximum(sight_cells, 0)
    is_visible = mark_visible(
        sight_cells, inputs.rooms.is_open_by_level[level_number], inputs.floors[level_number].floor
    )
    if not is_visible.any(axis=(1, 2)).all():
        return None
    num_other_leaves = num_leaves_by_level[level_number][clipped_cells] - np.isin(
        clipped_cells, closed_cells[level_number]
    )
    is_other_leaf = is_on_lattice & (num_other_leaves > 0)
    is_before_leaves = is_visible & ~np.logical_or.accumulate(is_other_leaf, axis=-1)
    room_in_sight = np.where(
        is_on_lattice, inputs.rooms.index[level_number].ravel()[clipped_cells], 0
    )
    has_room = room_in_sight > 0
    for is_counted in (is_before_leaves & has_room, is_visible & has_room, is_visible):
        side_rooms = [
            _find_room_in_sight(room_in_sight[side], is_counted[side], level_number, inputs.rooms)
            for side in (0, 1)
        ]
        if side_rooms[0] != side_rooms[1]:
            return side_rooms[0], side_rooms[1]
    return None


def _find_room_in_sight(
    room_at_step: Int, is_counted: Bool, level_number: int, rooms: Rooms
) -> str | None:
    """Return the id of the room in which most lines of a side end; None if most end in no room.

    Args:
        room_at_step: index of the room at each step along each line, 0 for none, shape (lines,
            steps).
        is_counted: a mask of the steps that count, shape (lines, steps); a line ends at its last
            one.
        level_number: number of the level.
        rooms: the rooms.
    """
    last_step = is_counted.shape[-1] - 1 - is_counted[:, ::-1].argmax(axis=-1)
    last_room = room_at_step[np.arange(len(last_step)), last_step]
    line_rooms = np.where(is_counted.any(axis=-1), last_room, 0)
    num_lines_by_room = Counter(rooms.id_of(level_number, index) for index in line_rooms.tolist())
    return max(
        num_lines_by_room,
        key=lambda room_id: (num_lines_by_room[room_id], room_id is not None, room_id or ""),
    )


# ---------------------------------------------------------------- doors of the grid


@dataclass(frozen=True, eq=False)
class DoorCells:
    """The cells that only a door blocks, in each of its states.

    Attributes:
        blocked: state -> for each level, ids of the cells where the door, and nothing else except
            other doors, overlaps the footprint of an agent at the cell's centre.
        blocked_squares: the same for the cell's own square, without the agent's disc; empty if the
            disc doesn't reach beyond the square.
    """

    blocked: CellsByState
    blocked_squares: CellsByState


def find_door_cells(
    door: ClassifiedLeaf, blocked_masks: Sequence[Bool], blocked_square_masks: Sequence[Bool] | None
) -> DoorCells:
    """Return the cells that only a door blocks, in each of its states.

    Args:
        door: the door.
        blocked_masks: for each level, shape (height, width), bool: the cells that something other
            than a door blocks.
        blocked_square_masks: the same for the cell's square alone, without the agent's disc: the
            cells whose square overlaps something other than a door. None if it would equal
            `blocked_masks`.
    """
    door_squares: CellsByState = {}
    if blocked_square_masks is not None:
        door_squares = _remove_blocked_cells(door.blocked_squares, blocked_square_masks)
    return DoorCells(_remove_blocked_cells(door.blocked, blocked_masks), door_squares)


def _remove_blocked_cells(
    cells_by_state: CellsByState, blocked_masks: Sequence[Bool]
) -> dict[str, list[Int]]:
    """Remove the cells that are blocked on their level.

    Args:
        cells_by_state: state -> for each level, ids of cells.
        blocked_masks: for each level, a mask of the blocked cells, (height, width).
    """
    free_cells = dict[str, list[Int]]()
    for state, cells_by_level in cells_by_state.items():
        free_cells[state] = [
            cells[~is_blocked.ravel()[cells]]
            for cells, is_blocked in zip(cells_by_level, blocked_masks, strict=True)
        ]
    return free_cells


def is_stuck(door_cells: DoorCells) -> bool:
    """Return whether the open door still blocks most of the cells that the closed door blocks."""
    cells_when_closed = door_cells.blocked["closed"]
    num_closed_cells = sum(len(closed_cells) for closed_cells in cells_when_closed)
    num_cells_in_both = sum(
        len(np.intersect1d(closed_cells, open_cells, assume_unique=True))
        for closed_cells, open_cells in zip(
            cells_when_closed, door_cells.blocked["open"], strict=True
        )
    )
    return num_cells_in_both > 0 and num_cells_in_both >= STUCK_SHARE * num_closed_cells


def make_door(
    leaf: ClassifiedLeaf,
    door_cells: DoorCells,
    windows: Sequence[Window],
    num_cols: int,
    wanted_state: str,
) -> Door:
    """Make a door of the grid.

    Args:
        leaf: a leaf that is a door.
        door_cells: the cells that only the door blocks, ids on the whole lattice.
        windows: for each level, the rows and columns of the whole lattice that the grid holds.
        num_cols: number of columns of the whole lattice.
        wanted_state: the door's state; ``modelled`` is used if the door doesn't have that state.
    """
    return Door(
        id=leaf.candidate.id,
        joint=leaf.candidate.joint,
        rooms=leaf.rooms,
        state=leaf.state(wanted_state),
        cells=_to_cell_runs(door_cells.blocked, windows, num_cols),
        solid=_to_cell_runs(door_cells.blocked_squares, windows, num_cols),
        width=leaf.leaf.width,
    )


def _to_cell_runs(
    cells_by_state: CellsByState, windows: Sequence[Window], num_cols: int
) -> dict[str, dict[int, Runs]]:
    """Convert ids of cells on the whole lattice to ids in the grid, as runs of consecutive ids.

    Args:
        cells_by_state: state -> for each level, ids of cells on the whole lattice.
        windows: for each level, the rows and columns of the whole lattice that the grid holds.
        num_cols: number of columns of the whole lattice.

    Returns:
        State -> number of a level -> runs of cell ids in the level's grid; a level without such
        cells is left out.
    """
    runs_by_state: dict[str, dict[int, Runs]] = {}
    for state, cells_by_level in cells_by_state.items():
        runs_by_level: dict[int, Runs] = {}
        for level_number, (cells, window) in enumerate(zip(cells_by_level, windows, strict=True)):
            window_cells, _ = crop_cells(cells, window, num_cols)
            if len(window_cells):
                runs_by_level[level_number] = to_runs(window_cells)
        runs_by_state[state] = runs_by_level
    return runs_by_state


# ---------------------------------------------------------------- warnings


def warn_doors(
    doors: Sequence[ClassifiedLeaf], stuck_ids: Collection[str], wanted_state: str
) -> list[str]:
    """Return the warnings about doors.

    They name doors whose open state still blocks their doorway, doors that should be open but that
    no single hinge or slide moves, and doors with a top that an agent could walk on.

    Args:
        doors: the doors.
        stuck_ids: ids of the doors that still block most of their cells when open, see `is_stuck`.
        wanted_state: the state that the settings ask for.
    """
    stuck_warnings = [
        f"the open state of door {door.candidate.id!r} still closes its doorway, as its joint "
        f"opens it by {door.leaf.travel_text} only: check its range, whether the file means "
        "degrees or radians (`<compiler angle>`), and `grid.cell_size`"
        for door in doors
        if door.candidate.id in stuck_ids
    ]
    no_joint_warnings = []
    if wanted_state == "open":
        no_joint_warnings = [
            f"door {door.candidate.id!r} is not moved by exactly one hinge or slide of its own: "
            "open, it is taken out of its opening"
            for door in doors
            if not door.candidate.positions
        ]
    carried_floor_warnings = [
        door.carried_floor_warning for door in doors if door.carried_floor_warning
    ]
    return stuck_warnings + no_joint_warnings + carried_floor_warnings


def _warn_carried_floor(leaf: Leaf, inputs: DoorInputs) -> str:
    """Return the warning that an agent could walk on a door's top, in the first such state.

    Args:
        leaf: the door's geometry in each state.
        inputs: floors and rooms.

    Returns:
        The warning, empty if `MIN_CARRIED_AREA` of the top or more is walkable in no state.
    """
    for state, shapes in leaf.top_shapes.items():
        area = _measure_walkable_area(shapes, inputs)
        if area >= MIN_CARRIED_AREA - LIMIT_SLACK:
            return (
                f"door {leaf.candidate.id!r} carries {area:.1f} m² of floor {STATE_TEXTS[state]}, "
                "which is missing in the grid, because doors carry no floor: exclude it from "
                "`doors` if agents walk on it"
            )
    return ""


def _measure_walkable_area(shapes: Shapes, inputs: DoorInputs) -> float:
    """Return the area of a door's top that agents can walk on [m²]; 0 if no step leads there.

    Where the top is at most a step above the floor, like a mat's, it does not count.

    Args:
        shapes: the door's geometry in one state.
        inputs: floors, rooms and the agent.
    """
    lattice = inputs.rooms.lattice
    agent = inputs.agent
    bounds = shapes.bounds
    window = None if bounds is None else lattice.window(bounds)
    if window is None:
        return 0.0
    rows, cols = window
    top_height = find_standable_tops(shapes, lattice.cut(rows, cols), agent)
    max_step = agent.traversable_floor_height + LIMIT_SLACK
    floors = [level.floor[window] for level in inputs.floors]
    for floor in floors:
        top_height[np.abs(top_height - floor) <= max_step] = np.nan  # a mat
    rows_of_top, cols_of_top = np.nonzero(~np.isnan(top_height))
    cells = (rows_of_top + rows.start) * lattice.width + cols_of_top + cols.start
    heights = top_height[rows_of_top, cols_of_top]
    is_covered = np.zeros(len(cells), dtype=np.bool_)  # by structure too low for an agent below it
    find_blocked_lines(
        cells,
        heights + LIMIT_SLACK,
        heights + agent.height - LIMIT_SLACK,
        inputs.columns.columns_at(cells).hits,
        is_covered,
        0,
        len(cells),
    )
    top_height[rows_of_top[is_covered], cols_of_top[is_covered]] = np.nan
    for floor in floors:
        for first_slices, second_slices in NEIGHBOR_SLICES:
            height_differences = [
                top_height[first_slices] - floor[second_slices],
                top_height[second_slices] - floor[first_slices],
            ]
            if (np.abs(np.stack(height_differences)) <= max_step).any():
                return float(np.count_nonzero(~np.isnan(top_height))) * lattice.cell_size**2
    return 0.0
