"""Doors: which candidates join rooms, and what each door blocks in each state.

Floors, levels and rooms are found without the doors. The cells of a door are laid over what
everything else occupies, so that a grid with a door in another state equals a bake of it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from navbake.baker.columns import ColumnSource, cast_columns, tile_shapes
from navbake.baker.doors.candidates import DoorCandidate, largest_side, pose_doors
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.constants import HINGE, SLACK
from navbake.baker.lattice import EDGES
from navbake.baker.occupancy.occupancy import Footprints, Occupancy, check_footprints
from navbake.baker.rooms.rooms import RoomIds, Rooms
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.doors import STATES
from navbake.types import Bool, Int

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
class PlacedDoor:
    """A door on the whole lattice.

    Attributes:
        id, joint: as of its candidate.
        rooms: the ids of the rooms on its two sides, None for the outside.
        cells: by state, for each level the cells that the door blocks and nothing else does,
            ascending.
        closed_cells: for each level, the cells that the closed door blocks, whatever else does.
        solid: as `cells`, of the cells whose squares the door meets and nothing else does; empty
            where the footprint is the square.
        travel: by how much its joint opens it, with the unit; empty for no joint.
    """

    id: str
    joint: str | None
    rooms: RoomIds
    cells: dict[str, list[Int]]
    closed_cells: list[Int]
    solid: dict[str, list[Int]] = field(default_factory=dict)
    travel: str = ""

    def state(self, wanted: str) -> str:
        """The wanted state if the door has it, else modelled."""
        return wanted if wanted == "removed" or wanted in self.cells else "modelled"


@dataclass(frozen=True)
class Doors:
    """The doors of a scene.

    Attributes:
        placed: the doors.
        rejected: candidates that stand on the lattice and join no two rooms. They are parts of
            the scene, which is to be baked again with them: see `settle_doors`.
        warnings: what the user should know, one line each.
    """

    placed: list[PlacedDoor]
    rejected: list[DoorCandidate]
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Surroundings:
    """What doors stand in: what was found in the scene without them."""

    floors: Sequence[LevelFloor]
    occupancy: Occupancy
    rooms: Rooms
    footprints: Footprints


def place_doors(scene: Scene, candidates: Sequence[DoorCandidate], around: Surroundings) -> Doors:
    """Decide which candidates are doors, and find the cells that each door blocks in each state.

    A candidate that no pattern names is a door when it stands between two rooms, or between a
    room and the outside. One that stands beside the lattice, as modelled, is left out: it is no
    door of the grid, and nothing of the grid changes with it. The scene is the whole one.
    """
    if not candidates:
        return Doors([], [])
    posed = {state: pose_doors(scene, candidates, state) for state in STATES if state != "removed"}
    extents = measure_geoms(posed["closed"], scene.model.ngeom)
    placed: list[PlacedDoor] = []
    rejected: list[DoorCandidate] = []
    for candidate in candidates:
        by_state = _blocked_by_state(posed, candidate, around)
        blocked = {state: cells for state, (cells, _) in by_state.items()}
        leaf = largest_side(extents, candidate.geoms)
        rooms = _rooms_beside(leaf, extents, blocked["closed"], around)
        if rooms is None and not candidate.named:
            box = candidate.only(posed["modelled"]).bounds()
            reach = around.footprints.whole.reach
            if box is None or around.rooms.lattice.window(box, reach) is not None:
                rejected.append(candidate)
            continue
        occupied, squares = around.occupancy.levels, around.occupancy.solid
        cells = {state: _only_free(levels, occupied) for state, levels in blocked.items()}
        solid = {}
        if squares is not None:
            met = {state: levels for state, (_, levels) in by_state.items()}
            solid = {state: _only_free(levels, squares) for state, levels in met.items()}
        travel = ""
        if candidate.positions:
            by = abs(candidate.positions["open"] - candidate.positions["closed"])
            is_hinge = int(scene.model.jnt_type[candidate.joint_id]) == HINGE
            travel = f"{np.degrees(by):.3g}°" if is_hinge else f"{by:.3g} m"
        names, sides = (candidate.id, candidate.joint), rooms or (None, None)
        placed.append(PlacedDoor(*names, sides, cells, blocked["closed"], solid, travel))
    return Doors(placed, rejected)


def warn_immovable_doors(doors: Sequence[PlacedDoor], state: str) -> list[str]:
    """Warn of doors that can't be in the state that is wanted of all, or that open nothing."""
    warnings = []
    for door in doors:
        if "open" in door.cells:
            pairs = zip(door.cells["closed"], door.cells["open"], strict=True)
            both = sum(len(np.intersect1d(closed, opened)) for closed, opened in pairs)
            if both and both >= STUCK * sum(map(len, door.cells["closed"])):
                warnings.append(
                    f"the open state of door {door.id!r} still closes its doorway, as its joint "
                    f"opens it by {door.travel} only: check its range, whether the file means "
                    "degrees or radians (`<compiler angle>`), and `grid.cell_size`"
                )
    return warnings + [
        f"door {door.id!r} can't be {state}, as it has no hinge or slide of its own: it stays as "
        f"modelled"
        for door in doors
        if door.state(state) != state
    ]


# ---------------------------------------------------------------- what a door blocks


def _blocked_by_state(
    posed: dict[str, Shapes], candidate: DoorCandidate, around: Surroundings
) -> dict[str, tuple[list[Int], list[Int]]]:
    """For each state that the door has, and each level, the cells that it blocks.

    First those that it blocks with the whole footprint, then those whose squares it meets. A door
    that can't move is closed as it is modelled.
    """
    blocked: dict[str, tuple[list[Int], list[Int]]] = {}
    state_at: dict[float | None, str] = {}
    for state, shapes in posed.items():
        # states at one position of the joint are found once
        first = state_at.setdefault(candidate.position(state), state)
        blocked[state] = blocked.get(first) or _blocked_cells(candidate.only(shapes), around)
    if not candidate.positions:
        del blocked["open"]
    return blocked


def _only_free(cells: list[Int], occupied: Sequence[Bool]) -> list[Int]:
    """For each level, the cells that nothing else occupies."""
    return [ids[~mask.ravel()[ids]] for ids, mask in zip(cells, occupied, strict=True)]


def _blocked_cells(shapes: Shapes, around: Surroundings) -> tuple[list[Int], list[Int]]:
    """For each level, the cells with a floor whose volume the shapes meet; and over the square."""
    lattice, reach = around.rooms.lattice, around.footprints.whole.reach
    bounds = shapes.bounds()
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
        answers = check_footprints(columns, tiled, around.footprints, local, floor[local])
        row, col = np.divmod(local, width)
        ids = (row + rows.start) * lattice.width + col + cols.start
        blocked.append(ids[answers.occupied])
        solid.append(ids[answers.solid])
    return blocked, solid


# ---------------------------------------------------------------- what a door joins


def _rooms_beside(
    leaf: int, extents: Extents, closed_cells: Sequence[Int], around: Surroundings
) -> RoomIds | None:
    """The rooms on a closed leaf's two sides, None for outside; None if they aren't two.

    On each side that is the last room in sight, before the floor may end: a door to a ledge joins
    the room that the ledge is. Only where that is one room on both sides, because what is left of
    the doorway beyond the leaf belongs to the room behind it, the outside begins where the
    floor ends.
    """
    sizes = [len(cells) for cells in closed_cells]
    if not any(sizes) or not np.isfinite(extents.center[leaf]).all():
        return None
    level = int(np.argmax(sizes))
    across = extents.across[leaf]
    along = np.array([-across[1], across[0]])
    step = around.rooms.lattice.cell_size / 2
    # points on lines away from both sides, shape (sides, lines, steps, 2) [m]
    distance = extents.thin[leaf] / 2 + np.arange(0.0, SIGHT, step)
    start = extents.center[leaf] + along * np.array(LINES)[:, None] * extents.long[leaf]
    sight = start[:, None] + across * np.array([-1.0, 1.0])[:, None, None, None] * distance[:, None]
    rows, cols = around.rooms.lattice.rows_cols(sight)
    for floor_ends in (False, True):
        one, other = (
            _room_in_sight(rows[side], cols[side], level, around, floor_ends) for side in (0, 1)
        )
        if one != other:
            return one, other
    return None


def _room_in_sight(
    rows: Int, cols: Int, level: int, around: Surroundings, floor_ends: bool
) -> str | None:
    """The room that most lines of sight, (lines, steps) cells of a level, end in; None for none.

    Where the floor ends, or is in no room, `floor_ends` says whether the outside begins.
    """
    lattice, open_cells = around.rooms.lattice, around.rooms.open_cells[level]
    floor = around.floors[level].floor
    votes: Counter[str | None] = Counter()
    for line in zip(rows.tolist(), cols.tolist(), strict=True):
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


# ---------------------------------------------------------------- what one could walk on


def warn_walkable_doors(
    scene: Scene,
    doors: Sequence[DoorCandidate],
    columns: ColumnSource,
    floors: Sequence[LevelFloor],
    agent: AgentSettings,
) -> list[str]:
    """Warn of doors that carry 0.5 m² of floor or more, in any of their states.

    Floor is what faces up within the agent's slope and has its headroom. It has to lie no more
    than a step from a floor beside it, and not on a floor, as a mat does. The columns and floors
    are without doors.
    """
    warnings: dict[str, str] = {}
    for state, when in WHEN.items():
        left = [door for door in doors if door.id not in warnings]
        if not left:
            break
        shapes = pose_doors(scene, left, state)
        extents = measure_geoms(shapes, scene.model.ngeom)
        for door in left:
            # seen from above, most doors are too small, which is quickly found
            if np.nansum((extents.thin * extents.long)[door.geoms]) < MIN_AREA - SLACK:
                continue
            area = _walkable_area(door.only(shapes), columns, floors, agent)
            if area >= MIN_AREA - SLACK:
                warnings[door.id] = (
                    f"door {door.id!r} carries {area:.1f} m² of floor {when}, which is "
                    f"missing in the grid, because doors carry no floor: exclude it from `doors` "
                    f"if agents walk on it"
                )
    return [warnings[door.id] for door in doors if door.id in warnings]


def _walkable_area(
    shapes: Shapes, columns: ColumnSource, floors: Sequence[LevelFloor], agent: AgentSettings
) -> float:
    """How much of the top of a door an agent can stand on, if a step leads there [m²]."""
    lattice, bounds = columns.lattice, shapes.bounds()
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
    parts = [level.floor[window] for level in floors]
    for floor in parts:  # what lies on a floor is a mat
        top[np.abs(top - floor) <= step] = np.nan
    places = np.argwhere(~np.isnan(top))
    known = columns.at((places[:, 0] + rows.start) * lattice.width + places[:, 1] + cols.start)
    for r, c in places.tolist():
        cell = (r + rows.start) * lattice.width + c + cols.start
        above = known.z[known.start[cell] : known.start[cell + 1]]
        above = above[above > top[r, c] + SLACK]
        if len(above) and above[0] < top[r, c] + agent.height - SLACK:
            top[r, c] = np.nan
    sides = [(a, b) for one, other in EDGES for a, b in ((one, other), (other, one))]
    if not any((np.abs(top[a] - floor[b]) <= step).any() for floor in parts for a, b in sides):
        return 0.0
    return float(np.count_nonzero(~np.isnan(top))) * lattice.cell_size**2
