"""Doors: what each leaf blocks in each state, and which leaves are doors.

Floors and levels are found without the leaves; closed leaves part rooms. Whether a leaf is a
door depends on floors and rooms alone, not on what moves. The cells of a door are laid over what
everything else occupies, so that a grid with a door in another state equals a bake of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from navbake.baker.columns.columns import (
    Columns,
    ColumnSource,
    TiledShapes,
    cast_columns,
    tile_shapes,
)
from navbake.baker.core.constants import HINGE
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import NEIGHBOR_SLICES, Window, crop_cells
from navbake.baker.doors.poses import pose_doors
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.floors.surfaces import find_standable_tops
from navbake.baker.geometry.extents import Extents, measure_extents
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.occupancy.occupancy import Footprint, check_occupancy
from navbake.baker.rooms.leaves import ClosedLeaf, LeafLines, mark_visible
from navbake.baker.rooms.rooms import RoomIds, Rooms
from navbake.baker.scene.leaves import DoorCandidate, find_largest_side
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import STATES, Door, Runs, to_runs
from navbake.threads import limit_threads
from navbake.types import Bool, Float, Int, Int32

# The length of lines of sight from each side of a closed leaf; they reach at least so many cells
# beyond those that it blocks [m, cells]
SIGHT = 0.6
SIGHT_CELLS = 2.0
# What a leaf ends at reaches at most so far on in its line, if it is no wall [m]
FRAME = 0.5
# Where lines of sight begin along the leaf, as shares of its width from its middle, off the frame
LINES = (-0.3, -0.15, 0.0, 0.15, 0.3)
# A door opens nothing if its open state blocks this share of the closed door's cells
STUCK = 0.75
MIN_AREA = 0.5  # of floor on a door that is worth a warning [m²]
Near = tuple[Window, TiledShapes, Columns]
"""A window of the lattice, and what is in it."""
CellsByState = Mapping[str, Sequence[Int]]
"""By a door's state and level, the ids of cells on the whole lattice, ascending."""
WHEN = {"modelled": "as it is modelled", "open": "when it is open", "closed": "when it is closed"}


@dataclass(frozen=True, eq=False)
class Leaf:
    """The geometry of a candidate in each of its states, on the whole lattice."""

    candidate: DoorCandidate
    # by state, the window near it and what is in it, None for no cells; states at one position of
    # the joint share one
    near: dict[str, Near | None]
    lines: LeafLines | None  # from the closed leaf; None for no geometry that is finite
    tops: dict[str, Shapes]  # by state, where large enough to walk on
    travel: str  # by how much its joint opens it, with the unit


@dataclass(frozen=True, eq=False)
class LeafCells:
    """What a leaf blocks, whatever else stands there.

    Attributes:
        blocked: the cells whose volume over the floor the leaf meets.
        blocked_squares: the cells whose squares alone it meets; empty where the footprint is the
            square.
    """

    leaf: Leaf
    blocked: CellsByState
    blocked_squares: CellsByState

    @property
    def closed(self) -> ClosedLeaf:
        """The closed leaf, which may part rooms."""
        return ClosedLeaf(self.blocked["closed"], self.leaf.lines)


@dataclass(frozen=True, eq=False)
class ClassifiedLeaf:
    """A leaf among floors and rooms: a door, or something that stands in the way as it is.

    It does not depend on what else stands there.

    Attributes:
        is_door: whether it is one; else it has no rooms.
        rooms: on both sides.
        blocked, blocked_squares: see `LeafCells`.
        carried: a warning of the floor that the door carries, empty for none.
    """

    leaf: Leaf
    is_door: bool
    rooms: RoomIds
    blocked: CellsByState
    blocked_squares: CellsByState
    carried: str

    @property
    def candidate(self) -> DoorCandidate:
        """Whose leaf it is."""
        return self.leaf.candidate

    @property
    def closed_cells(self) -> Sequence[Int]:
        """By level, what the closed leaf blocks."""
        return self.blocked["closed"]

    def state(self, wanted: str) -> str:
        """The wanted state if the door has it, else modelled."""
        return wanted if wanted == "removed" or wanted in self.blocked else "modelled"


def select_doors(leaves: Sequence[ClassifiedLeaf]) -> list[ClassifiedLeaf]:
    """Those of the leaves that are doors."""
    return [placed for placed in leaves if placed.is_door]


def free_cells(blocked: CellsByState, occupied: Sequence[Bool]) -> dict[str, list[Int]]:
    """Those of a leaf's cells that nothing else occupies.

    `occupied` are the cells of each level that anything but doors occupies, (height, width).
    """
    return {
        state: [cells[~mask.ravel()[cells]] for cells, mask in zip(by_level, occupied, strict=True)]
        for state, by_level in blocked.items()
    }


def is_stuck(door: ClassifiedLeaf, occupied: Sequence[Bool]) -> bool:
    """Whether a door's open state blocks most of what its closed one does."""
    cells = free_cells(door.blocked, occupied)
    closed = cells["closed"]
    both = sum(
        len(np.intersect1d(at_closed, at_open))
        for at_closed, at_open in zip(closed, cells["open"], strict=True)
    )
    return both > 0 and both >= STUCK * sum(map(len, closed))


def cut_door(
    door: ClassifiedLeaf,
    occupied: Sequence[Bool],
    solid: Sequence[Bool] | None,
    windows: Sequence[Window],
    width: int,
    wanted: str,
) -> Door:
    """The door in a state, with cells on each level's window of the lattice, of a `width`.

    `occupied` and `solid`: the cells of each level that anything but doors occupies, and those
    whose squares it meets, None where these are the same.
    """

    def cut(by_level: Sequence[Int]) -> dict[int, Runs]:
        runs = dict[int, Runs]()
        for number, (cells, window) in enumerate(zip(by_level, windows, strict=True)):
            inside, _ = crop_cells(cells, window, width)
            if len(inside):
                runs[number] = to_runs(inside)
        return runs

    cells = free_cells(door.blocked, occupied)
    squares = {} if solid is None else free_cells(door.blocked_squares, solid)
    return Door(
        door.candidate.id,
        door.candidate.joint,
        door.rooms,
        door.state(wanted),
        {state: cut(by_level) for state, by_level in cells.items()},
        {state: cut(by_level) for state, by_level in squares.items()},
    )


def warn_doors(
    doors: Sequence[ClassifiedLeaf], stuck_ids: Collection[str], wanted: str
) -> list[str]:
    """Warn of doors that open nothing, are `wanted` open without a joint, or carry floor.

    `stuck_ids` are the ids of those that open nothing, see `is_stuck`.
    """
    stuck = [
        f"the open state of door {door.candidate.id!r} still closes its doorway, as its joint "
        f"opens it by {door.leaf.travel} only: check its range, whether the file means degrees or "
        "radians (`<compiler angle>`), and `grid.cell_size`"
        for door in doors
        if door.candidate.id in stuck_ids
    ]
    text = "has no hinge or slide of its own: open, it is taken out of its opening"
    fixed = [f"door {door.candidate.id!r} {text}" for door in doors if not door.candidate.positions]
    carried = [door.carried for door in doors if door.carried]
    return stuck + (fixed if wanted == "open" else []) + carried


@dataclass(frozen=True)
class DoorContext:
    """What leaves are placed in: what stands, its floors, and the rooms that closed leaves part."""

    columns: ColumnSource
    floors: Sequence[LevelFloor]
    rooms: Rooms
    agent: AgentSettings


def pose_leaves(
    scene: Scene, candidates: Sequence[DoorCandidate], lattice: Lattice, reach: float
) -> list[Leaf]:
    """Pose candidates in each state, and cast what is within `reach` [m] of their geometry."""
    if not candidates:
        return []
    posed = {state: pose_doors(scene, candidates, state) for state in STATES if state != "removed"}
    extents = {state: measure_extents(shapes, scene.model.ngeom) for state, shapes in posed.items()}
    with limit_threads(1):  # a door is too small to be worth more
        return [
            _pose_leaf(candidate, scene, posed, extents, lattice=lattice, reach=reach)
            for candidate in candidates
        ]


def _pose_leaf(
    candidate: DoorCandidate,
    scene: Scene,
    posed: Mapping[str, Shapes],
    extents: Mapping[str, Extents],
    lattice: Lattice,
    reach: float,
) -> Leaf:
    """One leaf of all that are `posed`, by state; `extents` measure all geoms in each state."""
    shapes_at = {state: candidate.only(shapes) for state, shapes in posed.items()}
    boxes = {
        state: bounds
        for state, shapes in shapes_at.items()
        if (bounds := shapes.bounds) is not None
    }
    windows = {state: lattice.window(box, reach) for state, box in boxes.items()}
    near = dict[str, Near | None]()
    state_at = dict[float | None, str]()  # the first state at each position of the joint
    for state, shapes in shapes_at.items():
        # states at one position of the joint are found once
        first = state_at.setdefault(candidate.position(state), state)
        window = windows.get(state)
        near[state] = near.get(first)
        if first == state and window is not None:
            tiled = tile_shapes(shapes, lattice.cut(*window), reach)
            near[state] = window, tiled, cast_columns(tiled)
    # seen from above, most doors are too small, which is quickly found
    tops = dict[str, Shapes]()
    for state, measured in extents.items():
        if np.nansum((measured.thin * measured.long)[candidate.geoms]) >= MIN_AREA - LIMIT_SLACK:
            tops[state] = shapes_at[state]
    travel = ""
    if candidate.positions:
        opened_by = abs(candidate.positions["open"] - candidate.positions["closed"])
        is_hinge = int(scene.model.jnt_type[candidate.joint_id]) == HINGE
        travel = f"{np.degrees(opened_by):.3g}°" if is_hinge else f"{opened_by:.3g} m"
    return Leaf(
        candidate,
        near=near,
        lines=_lines_from(extents["closed"], candidate.geoms, lattice, reach),
        tops=tops,
        travel=travel,
    )


def _lines_from(extents: Extents, geoms: Int, lattice: Lattice, reach: float) -> LeafLines | None:
    """The cells along lines from a closed leaf, which blocks those within `reach` [m]."""
    leaf = find_largest_side(extents, geoms)
    if not np.isfinite(extents.center[leaf]).all():
        return None
    across = extents.across[leaf]
    along = np.array([-across[1], across[0]])
    step = lattice.cell_size / 2
    length = max(SIGHT, reach + SIGHT_CELLS * lattice.cell_size)
    # points on the lines, shape (sides, lines, steps, 2) and (ends, steps, 2) [m]
    to_side = extents.thin[leaf] / 2 + np.arange(0.0, length, step)
    start = extents.center[leaf] + along * np.array(LINES)[:, None] * extents.long[leaf]
    ways = across * np.array([-1.0, 1.0])[:, None, None, None]
    sight = start[:, None] + ways * to_side[:, None]
    to_end = extents.long[leaf] / 2 + np.arange(0.0, FRAME + step, step)
    ways = along * np.array([-1.0, 1.0])[:, None, None]
    ends = extents.center[leaf] + ways * to_end[:, None]
    return LeafLines(_cells_at(sight, lattice), _cells_at(ends, lattice))


def _cells_at(points: Float, lattice: Lattice) -> Int:
    """The ids of the cells that points are in, shape (…), -1 beside the lattice."""
    rows, cols = lattice.rows_cols(points)
    inside = (rows >= 0) & (rows < lattice.height) & (cols >= 0) & (cols < lattice.width)
    return np.where(inside, rows * lattice.width + cols, -1)


def find_blocked_cells(
    leaves: Sequence[Leaf], floors: Sequence[LevelFloor], footprint: Footprint, lattice: Lattice
) -> list[LeafCells]:
    """Find the cells that each leaf blocks in each state, over the floors of each level."""
    with limit_threads(1):  # a door is too small to be worth more
        return [_block_cells(leaf, floors, footprint, lattice) for leaf in leaves]


def _block_cells(
    leaf: Leaf, floors: Sequence[LevelFloor], footprint: Footprint, lattice: Lattice
) -> LeafCells:
    nothing: list[Int] = [np.empty(0, dtype=np.int64)] * len(floors)
    blocked = dict[str, list[Int]]()
    squares = dict[str, list[Int]]()
    for state, near in leaf.near.items():
        same = next((other for other in blocked if leaf.near[other] is near), None)
        if near is None:
            blocked[state] = squares[state] = nothing
        elif same is not None:
            blocked[state] = blocked[same]
            squares[state] = squares[same]
        else:
            blocked[state], squares[state] = _find_blocked(near, floors, footprint, lattice)
    # one that can't move is closed as it is modelled, and blocks nothing when it is open
    if not leaf.candidate.positions:
        blocked["open"] = squares["open"] = nothing
    return LeafCells(leaf, blocked, squares if footprint.radius > 0.0 else {})


def _find_blocked(
    near: Near, floors: Sequence[LevelFloor], footprint: Footprint, lattice: Lattice
) -> tuple[list[Int], list[Int]]:
    """By level, the cells whose volume over the floor shapes meet, and whose squares they do."""
    # only the cells near the door are looked at
    (rows, cols), tiled, columns = near
    blocked = list[Int]()
    squares = list[Int]()
    for level in floors:
        floor = level.floor[rows, cols].ravel()
        local: Int = np.flatnonzero(~np.isnan(floor))
        answers = check_occupancy(columns, tiled, footprint, local, floor[local])
        row, col = np.divmod(local, cols.stop - cols.start)
        ids = (row + rows.start) * lattice.width + col + cols.start
        blocked.append(ids[answers.occupied])
        squares.append(ids[answers.solid])
    return blocked, squares


def classify_leaves(leaves: Sequence[LeafCells], context: DoorContext) -> list[ClassifiedLeaf]:
    """Decide which leaves are doors.

    One that a pattern or the file names is a door always. Another is one where it stands between
    two rooms, or between a room and the outside.
    """
    # of each cell of a level, how many closed leaves block it
    counts = [np.zeros(level.floor.size, dtype=np.int32) for level in context.floors]
    for cells in leaves:
        for count, blocked in zip(counts, cells.blocked["closed"], strict=True):
            count[blocked] += 1
    with limit_threads(1):  # a door is too small to be worth more
        return [_place_door(cells, counts, context) for cells in leaves]


def _place_door(
    cells: LeafCells, leaf_counts: Sequence[Int32], context: DoorContext
) -> ClassifiedLeaf:
    leaf = cells.leaf
    rooms = _rooms_beside(leaf, cells.blocked["closed"], leaf_counts, context)
    is_door = rooms is not None or leaf.candidate.named
    return ClassifiedLeaf(
        leaf,
        is_door,
        rooms or (None, None),
        cells.blocked,
        cells.blocked_squares,
        _warn_carried(leaf, context) if is_door else "",
    )


def closes_same_cells(cells: LeafCells, former: ClassifiedLeaf) -> bool:
    """Whether a leaf in another pose closes the same cells, so that it is a door as it was."""
    lines = cells.leaf.lines
    before = former.leaf.lines
    if lines is None or before is None:
        same_lines = lines is before
    else:
        same_lines = all(map(np.array_equal, lines, before))
    return (
        same_lines
        and cells.leaf.candidate.named == former.candidate.named
        and all(map(np.array_equal, cells.blocked["closed"], former.closed_cells))
    )


def move_leaf(cells: LeafCells, former: ClassifiedLeaf, context: DoorContext) -> ClassifiedLeaf:
    """A leaf in another pose that closes the same cells, see `closes_same_cells`."""
    return replace(
        former,
        leaf=cells.leaf,
        blocked=cells.blocked,
        blocked_squares=cells.blocked_squares,
        carried=_warn_carried(cells.leaf, context) if former.is_door else "",
    )


def _warn_carried(leaf: Leaf, context: DoorContext) -> str:
    """The warning of the floor that a door carries, empty for none."""
    for state, shapes in leaf.tops.items():
        area = _walkable_area(shapes, context)
        if area >= MIN_AREA - LIMIT_SLACK:
            return (
                f"door {leaf.candidate.id!r} carries {area:.1f} m² of floor {WHEN[state]}, which "
                "is missing in the grid, because doors carry no floor: exclude it from `doors` if "
                "agents walk on it"
            )
    return ""


def _rooms_beside(
    leaf: Leaf, closed: Sequence[Int], leaf_counts: Sequence[Int32], context: DoorContext
) -> RoomIds | None:
    """For each side, the last room seen along lines away from the closed leaf; None for one room.

    Lines end at walls and at other closed leaves; if both sides then see the same room, they go on
    behind these leaves. If they still do, as where the doorway belongs to the room, the outside,
    None, begins where the floor ends. A side that sees nothing but a wall is none.
    """
    sizes = [len(cells) for cells in closed]
    if not any(sizes) or leaf.lines is None:
        return None
    level = int(np.argmax(sizes))
    sight = leaf.lines.sight
    inside = sight >= 0
    cell = np.maximum(sight, 0)
    is_seen = mark_visible(sight, context.rooms.open_cells[level], context.floors[level].floor)
    if not is_seen.any(axis=(1, 2)).all():
        return None
    is_leaf = leaf_counts[level][cell] > np.isin(cell, closed[level])
    is_before_leaves = is_seen & ~np.logical_or.accumulate(inside & is_leaf, axis=-1)
    room = np.where(inside, context.rooms.index[level].ravel()[cell], 0)
    has_room = room > 0
    for seen in (is_before_leaves & has_room, is_seen & has_room, is_seen):
        sides = [_room_in_sight(room[k], seen[k], level, context.rooms) for k in (0, 1)]
        if sides[0] != sides[1]:
            return sides[0], sides[1]
    return None


def _room_in_sight(room: Int, seen: Bool, level: int, rooms: Rooms) -> str | None:
    """The room that most lines end in, of what is `seen` along them, (lines, steps); None for none.

    `room`: the index of the room at each step.
    """
    last = seen.shape[-1] - 1 - seen[:, ::-1].argmax(axis=-1)
    number = np.where(seen.any(axis=-1), room[np.arange(len(last)), last], 0)
    votes = Counter(rooms.id_of(level, k) for k in number.tolist())
    return max(votes, key=lambda room_id: (votes[room_id], room_id is not None, room_id or ""))


def _walkable_area(shapes: Shapes, context: DoorContext) -> float:
    """The area of a door's top on which an agent can stand, if a step leads there [m²].

    What lies on a floor, like a mat, does not count.
    """
    lattice = context.rooms.lattice
    agent = context.agent
    bounds = shapes.bounds
    window = None if bounds is None else lattice.window(bounds)
    if window is None:
        return 0.0
    rows, cols = window
    cut = lattice.cut(rows, cols)
    top = find_standable_tops(shapes, cut, agent)
    step = agent.traversable_floor_height + LIMIT_SLACK
    floors = [level.floor[window] for level in context.floors]
    for floor in floors:  # what lies on a floor is a mat
        top[np.abs(top - floor) <= step] = np.nan
    places = np.argwhere(~np.isnan(top))
    cells = (places[:, 0] + rows.start) * lattice.width + places[:, 1] + cols.start
    heights = top[tuple(places.T)]
    is_under = np.zeros(len(cells), dtype=np.bool_)  # something an agent would not fit below
    find_blocked_lines(
        cells,
        heights + LIMIT_SLACK,
        heights + agent.height - LIMIT_SLACK,
        context.columns.covering(cells).hits,
        is_under,
        0,
        len(cells),
    )
    top[tuple(places[is_under].T)] = np.nan
    for floor in floors:
        for side, other_side in NEIGHBOR_SLICES:
            rises = [top[side] - floor[other_side], top[other_side] - floor[side]]
            rise = np.abs(np.stack(rises))
            if (rise <= step).any():
                return float(np.count_nonzero(~np.isnan(top))) * lattice.cell_size**2
    return 0.0
