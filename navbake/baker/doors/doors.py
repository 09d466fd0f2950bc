"""Doors: which candidates join rooms, and what each door blocks in each state.

Floors, levels and rooms are found without the doors. The cells of a door are laid over what
everything else occupies, so that a grid with a door in another state equals a bake of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from navbake.baker.columns import Columns, ColumnSource, TiledShapes, cast_columns, tile_shapes
from navbake.baker.doors.poses import pose_doors
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.constants import HINGE, SLACK
from navbake.baker.kernels.overlap import lines_blocked
from navbake.baker.lattice import EDGES, Window, cut_cells
from navbake.baker.occupancy.occupancy import Footprint, look_at_cells
from navbake.baker.rooms.rooms import RoomIds, Rooms
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.leaves import DoorCandidate, largest_side
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import STATES, Door, Runs, to_runs
from navbake.threads import limit_threads
from navbake.types import Bool, Float, Int

# The length of lines of sight from each side of a closed leaf [m]
SIGHT = 0.6
# Where lines of sight begin along the leaf, as shares of its width from its middle, off the frame
LINES = (-0.3, -0.15, 0.0, 0.15, 0.3)
# A door opens nothing if its open state blocks this share of the closed door's cells
STUCK = 0.75
MIN_AREA = 0.5  # of floor on a door that is worth a warning [m²]
Near = tuple[Window, TiledShapes, Columns]
"""A window of the lattice, and what is in it."""
WHEN = {"modelled": "as it is modelled", "open": "when it is open", "closed": "when it is closed"}


@dataclass(frozen=True, eq=False)
class Leaf:
    """The geometry of a candidate in each of its states, on the whole lattice."""

    candidate: DoorCandidate
    box: Float | None  # round all of its states, shape (2, 3) [m]; None if it has no geometry
    is_beside: bool  # the lattice, as modelled
    # by state, the window near it and what is in it, None for no cells; states at one position of
    # the joint share one
    near: dict[str, Near | None]
    # the cells along lines away from both sides of the closed leaf, shape (sides, lines, steps), -1
    # beside the lattice; None without such lines
    sight: Int | None
    tops: dict[str, Shapes]  # by state, where large enough to walk on
    travel: str  # by how much its joint opens it, with the unit


@dataclass(frozen=True, eq=False)
class PlacedLeaf:
    """A candidate among floors and rooms: a door, a part of the scene, or neither."""

    leaf: Leaf
    is_door: bool = False
    rooms: RoomIds = (None, None)
    # by state and level, the cells that the door alone blocks, ascending; empty for no door
    blocked: dict[str, list[Int]] = field(default_factory=dict)
    # the cells whose squares the door alone meets; empty where the footprint is the square
    blocked_squares: dict[str, list[Int]] = field(default_factory=dict)
    closed_cells: Sequence[Int] = ()  # by level, what the closed door blocks, whatever else does
    carried: str = ""  # a warning of the floor that it carries

    @property
    def candidate(self) -> DoorCandidate:
        """Whose leaf it is."""
        return self.leaf.candidate

    @cached_property
    def is_stuck(self) -> bool:
        """Whether its open state blocks most of what its closed one does."""
        closed, opened = self.blocked["closed"], self.blocked.get("open", [])
        both = sum(len(np.intersect1d(*pair)) for pair in zip(closed, opened, strict=False))
        return both > 0 and both >= STUCK * sum(map(len, closed))

    def state(self, wanted: str) -> str:
        """The wanted state if the door has it, else modelled."""
        return wanted if wanted == "removed" or wanted in self.blocked else "modelled"

    def depends_on(self, touched: Bool, around: Surroundings) -> bool:
        """Whether a change in the cells of a mask, (height, width), may change it."""
        leaf, lattice = self.leaf, around.rooms.lattice
        reach = around.footprint.reach + lattice.cell_size
        window = None if leaf.box is None else lattice.window(leaf.box, reach)
        if window is not None and touched[window].any():
            return True
        return leaf.sight is not None and bool(touched.ravel()[leaf.sight[leaf.sight >= 0]].any())


def free_cells(blocked, occupied):
    return {
        s: [ids[~m.ravel()[ids]] for ids, m in zip(by, occupied, strict=True)]
        for s, by in blocked.items()
    }


def close_leaves(leaves, floors, footprint):
    return []


def cut_door(placing, occupied, solid_layers, windows, width, wanted) -> Door:
    """The door in a state, with cells on each level's window of the lattice, of a `width`."""

    def cut(levels: list[Int]) -> dict[int, Runs]:
        pairs = enumerate(zip(levels, windows, strict=True))
        inside = ((k, cut_cells(*pair, width)[0]) for k, pair in pairs if len(pair[0]))
        return {number: to_runs(cells) for number, cells in inside if len(cells)}

    own = free_cells(placing.blocked, occupied)
    squares = free_cells(placing.blocked_squares, solid_layers) if solid_layers is not None else {}
    cells, solid = ({s: cut(c) for s, c in of.items()} for of in (own, squares))
    state, known = placing.state(wanted), placing.candidate
    return Door(known.id, known.joint, placing.rooms, state, cells, solid)


def warn_doors(doors: Sequence[PlacedLeaf], wanted: str) -> list[str]:
    """Warn of doors that open nothing, are `wanted` open without a joint, or carry floor."""
    stuck = [
        f"the open state of door {door.candidate.id!r} still closes its doorway, as its joint "
        f"opens it by {door.leaf.travel} only: check its range, whether the file means degrees or "
        "radians (`<compiler angle>`), and `grid.cell_size`"
        for door in doors
        if door.is_stuck
    ]
    text = "has no hinge or slide of its own: open, it is taken out of its opening"
    fixed = [f"door {door.candidate.id!r} {text}" for door in doors if not door.candidate.positions]
    carried = [door.carried for door in doors if door.carried]
    return stuck + (fixed if wanted == "open" else []) + carried


@dataclass(frozen=True)
class Surroundings:
    """What was found in the scene without its doors."""

    columns: ColumnSource
    floors: Sequence[LevelFloor]
    rooms: Rooms
    footprint: Footprint
    agent: AgentSettings


def pose_leaves(
    scene: Scene, candidates: Sequence[DoorCandidate], lattice: Lattice, reach: float
) -> list[Leaf]:
    """Pose candidates in each state, and cast what is within `reach` [m] of their geometry."""
    if not candidates:
        return []
    posed = {state: pose_doors(scene, candidates, state) for state in STATES if state != "removed"}
    extents = {state: measure_geoms(shapes, scene.model.ngeom) for state, shapes in posed.items()}

    def pose(candidate: DoorCandidate) -> Leaf:
        own = {state: candidate.only(shapes) for state, shapes in posed.items()}
        boxes = {state: box for state, shapes in own.items() if (box := shapes.bounds) is not None}
        windows = {state: lattice.window(box, reach) for state, box in boxes.items()}
        ends, box = np.array([*boxes.values()]), None
        if len(ends):
            box = np.stack([ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)])
        near, state_at = dict[str, Near | None](), dict[float | None, str]()
        for state, shapes in own.items():
            # states at one position of the joint are found once
            first = state_at.setdefault(candidate.position(state), state)
            window = windows.get(state)
            near[state] = near.get(first)
            if first == state and window is not None:
                tiled = tile_shapes(shapes, lattice.cut(*window), reach)
                near[state] = window, tiled, cast_columns(tiled)
        # seen from above, most doors are too small, which is quickly found
        geoms = candidate.geoms
        sizes = {state: np.nansum((one.thin * one.long)[geoms]) for state, one in extents.items()}
        tops = {state: own[state] for state, size in sizes.items() if size >= MIN_AREA - SLACK}
        travel = ""
        if candidate.positions:
            by = abs(candidate.positions["open"] - candidate.positions["closed"])
            is_hinge = int(scene.model.jnt_type[candidate.joint_id]) == HINGE
            travel = f"{np.degrees(by):.3g}°" if is_hinge else f"{by:.3g} m"
        sight = _lines_of_sight(extents["closed"], geoms, lattice)
        is_beside = "modelled" in windows and windows["modelled"] is None
        return Leaf(candidate, box, is_beside, near, sight, tops, travel)

    with limit_threads(1):  # a door is too small to be worth more
        return [pose(candidate) for candidate in candidates]


def _lines_of_sight(extents: Extents, geoms: Int, lattice: Lattice) -> Int | None:
    leaf = largest_side(extents, geoms)
    if not np.isfinite(extents.center[leaf]).all():
        return None
    across = extents.across[leaf]
    along = np.array([-across[1], across[0]])
    # points on lines away from both sides, shape (sides, lines, steps, 2) [m]
    distance = extents.thin[leaf] / 2 + np.arange(0.0, SIGHT, lattice.cell_size / 2)
    start = extents.center[leaf] + along * np.array(LINES)[:, None] * extents.long[leaf]
    sight = start[:, None] + across * np.array([-1.0, 1.0])[:, None, None, None] * distance[:, None]
    rows, cols = lattice.rows_cols(sight)
    inside = (rows >= 0) & (rows < lattice.height) & (cols >= 0) & (cols < lattice.width)
    return np.where(inside, rows * lattice.width + cols, -1)


def place_doors(leaves: Sequence[Leaf], around: Surroundings) -> list[PlacedLeaf]:
    """Decide which candidates are doors, and find the cells that each door blocks in each state.

    A candidate that no pattern names is a door when it stands between two rooms, or between a
    room and the outside. One beside the lattice, as modelled, is neither door nor part of a scene.
    """
    with limit_threads(1):  # a door is too small to be worth more
        return [_place_door(leaf, around) for leaf in leaves]


def _place_door(leaf: Leaf, around: Surroundings) -> PlacedLeaf:
    candidate = leaf.candidate
    # by state; one that can't move is closed as it is modelled, and blocks nothing when it is open
    blocked: dict[str, tuple[list[Int], list[Int]]] = {}
    for state, near in leaf.near.items():
        same = (blocked[other] for other in blocked if leaf.near[other] is near)
        blocked[state] = next(same, None) or _blocked_cells(near, around)
    if not candidate.positions:
        blocked["open"] = _blocked_cells(None, around)
    closed, _ = blocked["closed"]
    rooms = _rooms_beside(leaf, closed, around)
    if rooms is None and not candidate.named:
        return PlacedLeaf(leaf, False)

    cells = {s: both[0] for s, both in blocked.items()}
    solid = {s: both[1] for s, both in blocked.items()}
    carried = ""
    for state, shapes in leaf.tops.items():
        area = _walkable_area(shapes, around)
        if area >= MIN_AREA - SLACK:
            missing = "which is missing in the grid, because doors carry no floor"
            hint = "exclude it from `doors` if agents walk on it"
            what = f"{area:.1f} m² of floor {WHEN[state]}"
            carried = f"door {candidate.id!r} carries {what}, {missing}: {hint}"
            break
    return PlacedLeaf(leaf, True, rooms or (None, None), cells, solid, closed, carried)


def _blocked_cells(near: Near | None, around: Surroundings) -> tuple[list[Int], list[Int]]:
    """By level, the cells whose volume over the floor shapes meet, and whose squares they do."""
    if near is None:
        nothing = [np.empty(0, dtype=np.int64)] * len(around.floors)
        return nothing, nothing
    # only the cells near the door are looked at
    (rows, cols), tiled, columns = near
    width, whole = cols.stop - cols.start, around.rooms.lattice.width
    blocked, solid = [], []
    for level in around.floors:
        floor = level.floor[rows, cols].ravel()
        local: Int = np.flatnonzero(~np.isnan(floor))
        answers = look_at_cells(columns, tiled, around.footprint, local, floor[local])
        row, col = np.divmod(local, width)
        ids = (row + rows.start) * whole + col + cols.start
        blocked.append(ids[answers.occupied])
        solid.append(ids[answers.solid])
    return blocked, solid


def _rooms_beside(leaf: Leaf, closed: Sequence[Int], around: Surroundings) -> RoomIds | None:
    """For each side, the last room seen along lines away from the closed leaf; None for one room.

    If both sides see the same room, as where the doorway belongs to it, the outside, None, begins
    where the floor ends.
    """
    sizes = [len(cells) for cells in closed]
    if not any(sizes) or leaf.sight is None:
        return None
    level = int(np.argmax(sizes))
    inside, cell = leaf.sight >= 0, np.maximum(leaf.sight, 0)
    floor, is_open = around.floors[level].floor.ravel(), around.rooms.open_cells[level].ravel()
    is_wall = inside & ~is_open[cell] & ~np.isnan(floor[cell])
    is_seen = ~np.logical_or.accumulate(is_wall, axis=-1)
    room = np.where(inside, around.rooms.index[level].ravel()[cell], 0)

    def room_in_sight(side: int, seen: Bool) -> str | None:
        """The room that most lines end in, of what is `seen` along them."""
        last = seen.shape[-1] - 1 - seen[side, :, ::-1].argmax(axis=-1)
        number = np.where(seen[side].any(axis=-1), room[side, np.arange(len(last)), last], 0)
        votes = Counter(around.rooms.id_of(level, k) for k in number.tolist())
        return max(votes, key=lambda room: (votes[room], room is not None, room or ""))

    for seen in (is_seen & (room > 0), is_seen):
        one, other = room_in_sight(0, seen), room_in_sight(1, seen)
        if one != other:
            return one, other
    return None


def _walkable_area(shapes: Shapes, around: Surroundings) -> float:
    """The area of a door's top on which an agent can stand, if a step leads there [m²].

    What lies on a floor, like a mat, does not count.
    """
    lattice, bounds, agent = around.rooms.lattice, shapes.bounds, around.agent
    window = None if bounds is None else lattice.window(bounds)
    if window is None:
        return 0.0
    rows, cols = window
    cut = lattice.cut(rows, cols)
    own = cast_columns(tile_shapes(shapes, cut, 0.0))
    has_any = np.flatnonzero(np.diff(own.start))
    last = own.start[has_any + 1] - 1
    flat = own.normal[last, 2] >= np.cos(np.radians(agent.max_slope)) - SLACK
    top = np.full(cut.shape, np.nan)  # of each cell, if one can stand there
    top.ravel()[has_any[flat]] = own.z[last[flat]]
    step = agent.traversable_floor_height + SLACK
    parts = [level.floor[window] for level in around.floors]
    for floor in parts:  # what lies on a floor is a mat
        top[np.abs(top - floor) <= step] = np.nan
    places = np.argwhere(~np.isnan(top))
    cells = (places[:, 0] + rows.start) * lattice.width + places[:, 1] + cols.start
    tall, under = top[tuple(places.T)], np.zeros(len(cells), dtype=np.bool_)
    band = tall + SLACK, tall + agent.height - SLACK
    lines_blocked(cells, *band, around.columns.at(cells).crossings, under, 0, len(cells))
    top[tuple(places[under].T)] = np.nan
    sides = [(a, b) for one, other in EDGES for a, b in ((one, other), (other, one))]
    if not any((np.abs(top[a] - floor[b]) <= step).any() for floor in parts for a, b in sides):
        return 0.0
    return float(np.count_nonzero(~np.isnan(top))) * lattice.cell_size**2
