"""Doors: which candidates join rooms, and what each door blocks in each state.

Floors, levels and rooms are found without the doors. The cells of a door are laid over what
everything else occupies, so that a grid with a door in another state equals a bake of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from navbake.baker.columns import ColumnSource, cast_columns, tile_shapes
from navbake.baker.doors.candidates import DoorCandidate, largest_side, pose_doors
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.constants import HINGE, SLACK
from navbake.baker.lattice import EDGES, cut_cells
from navbake.baker.occupancy.occupancy import Footprint, Occupancy, look_at_cells
from navbake.baker.rooms.rooms import RoomIds, Rooms
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.doors import STATES
from navbake.threads import limit_threads
from navbake.types import Bool, Float, Int

# How far from each side of a closed leaf a room is looked for [m]
SIGHT = 0.6
# Where lines of sight begin along the leaf, as shares of its width from its middle; its ends are
# left out, because the frame is there
LINES = (-0.3, -0.15, 0.0, 0.15, 0.3)
# From which share on of the cells of a closed door that its open state blocks as well it opens
# nothing: nobody who needs a doorway gets through a quarter of it
STUCK = 0.75
MIN_AREA = 0.5  # of floor on a door that is worth a warning [m²]
WHEN = {"modelled": "as it is modelled", "open": "when it is open", "closed": "when it is closed"}


@dataclass(frozen=True)
class Placing:
    """What a candidate turned out to be on the whole lattice."""

    candidate: DoorCandidate
    box: Float | None  # round all of its states, shape (2, 3) [m]; None if it has no geometry
    is_part: bool = False  # of the scene: it stands on the lattice and joins no two rooms
    rooms: RoomIds = (None, None)
    # by state and level, the cells that the door blocks and nothing else does, ascending; empty
    # where the candidate is no door
    cells: dict[str, list[Int]] = field(default_factory=dict)
    # the same of cells whose squares it meets; empty where the footprint is the square
    solid: dict[str, list[Int]] = field(default_factory=dict)
    closed_cells: Sequence[Int] = ()  # by level, what the closed door blocks, whatever else does
    travel: str = ""  # by how much its joint opens it, with the unit
    carried: str = ""  # a warning of the floor that it carries

    def state(self, wanted: str) -> str:
        """The wanted state if the door has it, else modelled."""
        return wanted if wanted == "removed" or wanted in self.cells else "modelled"

    def depends_on(self, cells: Int, around: Surroundings) -> bool:
        """Whether it may be another one where something changed in some cells."""
        lattice = around.rooms.lattice
        reach = max(SIGHT, around.footprint.reach) + lattice.cell_size
        window = None if self.box is None else lattice.window(self.box, reach)
        return window is not None and bool(cut_cells(cells, window, lattice.width)[1].any())


def warn_doors(doors: Sequence[Placing], wanted: str) -> list[str]:
    """Warn of doors that open nothing, that are `wanted` open without a joint, or carry floor."""
    stuck, fixed = list[str](), list[str]()
    for door in doors:
        name, closed = door.candidate.id, door.cells["closed"]
        pairs = zip(closed, door.cells.get("open", ()), strict=False)
        both = sum(len(np.intersect1d(*pair)) for pair in pairs)
        if both and both >= STUCK * sum(map(len, closed)):
            stuck.append(
                f"the open state of door {name!r} still closes its doorway, as its "
                f"joint opens it by {door.travel} only: check its range, whether the file "
                "means degrees or radians (`<compiler angle>`), and `grid.cell_size`"
            )
        if wanted == "open" and not door.candidate.positions:
            fixed.append(
                f"door {name!r} has no hinge or slide of its own: open, it is taken out of its "
                "opening"
            )
    return stuck + fixed + [door.carried for door in doors if door.carried]


@dataclass(frozen=True)
class Surroundings:
    """What doors stand in: what was found in the scene without them."""

    columns: ColumnSource
    floors: Sequence[LevelFloor]
    occupancy: Occupancy
    rooms: Rooms
    footprint: Footprint
    agent: AgentSettings


def place_doors(
    scene: Scene, candidates: Sequence[DoorCandidate], around: Surroundings
) -> list[Placing]:
    """Decide which candidates are doors, and find the cells that each door blocks in each state.

    A candidate that no pattern names is a door when it stands between two rooms, or between a
    room and the outside. One beside the lattice, as modelled, is neither door nor part of a scene.
    """
    if not candidates:
        return []
    posed = {state: pose_doors(scene, candidates, state) for state in STATES if state != "removed"}
    extents = {state: measure_geoms(shapes, scene.model.ngeom) for state, shapes in posed.items()}
    of_doors = [{state: one.only(posed[state]) for state in posed} for one in candidates]
    with limit_threads(1):  # a door is too small to be worth more
        pairs = zip(candidates, of_doors, strict=True)
        return [_place_door(one, own, extents, scene, around) for one, own in pairs]


def _place_door(
    candidate: DoorCandidate,
    own: dict[str, Shapes],
    extents: dict[str, Extents],
    scene: Scene,
    around: Surroundings,
) -> Placing:
    boxes = [box for shapes in own.values() if (box := shapes.bounds) is not None]
    box = np.stack([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]]) if boxes else None
    # by state; one that can't move is closed as it is modelled, and blocks nothing when it is open
    blocked: dict[str, tuple[list[Int], list[Int]]] = {}
    state_at: dict[float | None, str] = {}
    for state, shapes in own.items():
        # states at one position of the joint are found once
        first = state_at.setdefault(candidate.position(state), state)
        blocked[state] = blocked.get(first) or _blocked_cells(shapes, around)
    if not candidate.positions:
        nothing = [np.empty(0, dtype=np.int64)] * len(around.floors)
        blocked["open"] = nothing, nothing
    closed, _ = blocked["closed"]
    leaf = largest_side(extents["closed"], candidate.geoms)
    rooms = _rooms_beside(leaf, extents["closed"], closed, around)
    if rooms is None and not candidate.named:
        bounds, reach = own["modelled"].bounds, around.footprint.reach
        is_part = bounds is None or around.rooms.lattice.window(bounds, reach) is not None
        return Placing(candidate, box, is_part)

    def only_free(number: int, occupied: Sequence[Bool]) -> dict[str, list[Int]]:
        """By state and level, the cells that nothing else occupies."""
        pairs = {s: zip(both[number], occupied, strict=True) for s, both in blocked.items()}
        return {s: [ids[~mask.ravel()[ids]] for ids, mask in both] for s, both in pairs.items()}

    cells = only_free(0, around.occupancy.levels)
    solid = only_free(1, around.occupancy.solid) if around.occupancy.solid is not None else {}
    travel = ""
    if candidate.positions:
        by = abs(candidate.positions["open"] - candidate.positions["closed"])
        is_hinge = int(scene.model.jnt_type[candidate.joint_id]) == HINGE
        travel = f"{np.degrees(by):.3g}°" if is_hinge else f"{by:.3g} m"
    carried = ""
    for state, when in WHEN.items():
        area = _walkable_area(own[state], extents[state], candidate.geoms, around)
        if area >= MIN_AREA - SLACK:
            carried = (
                f"door {candidate.id!r} carries {area:.1f} m² of floor {when}, which is missing "
                "in the grid, because doors carry no floor: exclude it from `doors` if agents "
                "walk on it"
            )
            break
    found = cells, solid, closed, travel, carried
    return Placing(candidate, box, False, rooms or (None, None), *found)


def _blocked_cells(shapes: Shapes, around: Surroundings) -> tuple[list[Int], list[Int]]:
    """By level, the cells whose volume over the floor shapes meet, and whose squares they do."""
    lattice, reach = around.rooms.lattice, around.footprint.reach
    bounds = shapes.bounds
    window = None if bounds is None else lattice.window(bounds, reach)
    if window is None:
        nothing = [np.empty(0, dtype=np.int64)] * len(around.floors)
        return nothing, nothing
    # only the cells near the door are looked at
    rows, cols = window
    tiled = tile_shapes(shapes, lattice.cut(rows, cols), reach)
    columns, width = cast_columns(tiled), cols.stop - cols.start
    blocked, solid = [], []
    for level in around.floors:
        floor = level.floor[rows, cols].ravel()
        local: Int = np.flatnonzero(~np.isnan(floor))
        answers = look_at_cells(columns, tiled, around.footprint, local, floor[local])
        row, col = np.divmod(local, width)
        ids = (row + rows.start) * lattice.width + col + cols.start
        blocked.append(ids[answers.occupied])
        solid.append(ids[answers.solid])
    return blocked, solid


def _rooms_beside(
    leaf: int, extents: Extents, closed_cells: Sequence[Int], around: Surroundings
) -> RoomIds | None:
    """The rooms on a closed leaf's two sides, None for outside; None if they aren't two.

    On each side that is the last room in sight, before the floor may end: a door to a ledge joins
    the ledge. Only where that is one room on both sides, because the doorway beyond the leaf
    belongs to the room behind it, the outside begins where the floor ends.
    """
    sizes = [len(cells) for cells in closed_cells]
    if not any(sizes) or not np.isfinite(extents.center[leaf]).all():
        return None
    level = int(np.argmax(sizes))
    across = extents.across[leaf]
    along = np.array([-across[1], across[0]])
    lattice = around.rooms.lattice
    # points on lines away from both sides, shape (sides, lines, steps, 2) [m]
    distance = extents.thin[leaf] / 2 + np.arange(0.0, SIGHT, lattice.cell_size / 2)
    start = extents.center[leaf] + along * np.array(LINES)[:, None] * extents.long[leaf]
    sight = start[:, None] + across * np.array([-1.0, 1.0])[:, None, None, None] * distance[:, None]
    rows, cols = lattice.rows_cols(sight)
    open_cells, floor = around.rooms.open_cells[level], around.floors[level].floor

    def room_in_sight(side: int, floor_ends: bool) -> str | None:
        """The room that most lines end in; `floor_ends` where the outside begins beyond a floor."""
        votes: Counter[str | None] = Counter()
        for line in zip(rows[side].tolist(), cols[side].tolist(), strict=True):
            seen: str | None = None
            for row, col in zip(*line, strict=True):
                inside = 0 <= row < lattice.height and 0 <= col < lattice.width
                if inside and not open_cells[row, col] and not np.isnan(floor[row, col]):
                    break  # a wall
                room = around.rooms.room_at(level, row * lattice.width + col) if inside else None
                if room is not None or floor_ends:
                    seen = room
            votes[seen] += 1
        return max(votes, key=lambda room: (votes[room], room is not None, room or ""))

    for floor_ends in (False, True):
        one, other = room_in_sight(0, floor_ends), room_in_sight(1, floor_ends)
        if one != other:
            return one, other
    return None


def _walkable_area(shapes: Shapes, extents: Extents, geoms: Int, around: Surroundings) -> float:
    """How much of the top of a door an agent can stand on, if a step leads there [m²].

    That faces up within the agent's slope, has its headroom, and lies on no floor, as a mat does.
    """
    lattice, bounds, agent = around.rooms.lattice, shapes.bounds, around.agent
    window = None if bounds is None else lattice.window(bounds)
    # seen from above, most doors are too small, which is quickly found
    if window is None or np.nansum((extents.thin * extents.long)[geoms]) < MIN_AREA - SLACK:
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
    known = around.columns.at(cells)
    for (r, c), cell in zip(places.tolist(), cells.tolist(), strict=True):
        above = known.z[known.start[cell] : known.start[cell + 1]]
        above = above[above > top[r, c] + SLACK]
        if len(above) and above[0] < top[r, c] + agent.height - SLACK:
            top[r, c] = np.nan
    sides = [(a, b) for one, other in EDGES for a, b in ((one, other), (other, one))]
    if not any((np.abs(top[a] - floor[b]) <= step).any() for floor in parts for a, b in sides):
        return 0.0
    return float(np.count_nonzero(~np.isnan(top))) * lattice.cell_size**2
