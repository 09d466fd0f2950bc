"""What rooms are found from: flags of each level's cells, and marks; nothing else decides rooms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns, ColumnSource
from navbake.baker.connect import label_parts
from navbake.baker.contents.walls import WALL_BAND
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels.constants import SAME, SLACK
from navbake.baker.rooms.sources import MarkedRooms, mark_rooms
from navbake.baker.rooms.walls import find_windows
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, RoomSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int

# The scene goes on beyond the lattice where it does so by more than this share of a cell
BEYOND = 0.5


class LevelFlags(NamedTuple):
    """What rooms need of the cells of a level, shape (height, width) of the whole lattice.

    Attributes:
        floor: heights, NaN for none, float64 [m].
        open: with a floor, and no wall or window, bool.
        hole: without a floor, and nothing stands at the height of an agent's body, bool.
        edge: open cells at the edge of the grid, see `find_edge`, bool.
        sky: with a floor, and nothing above an agent's head, bool.
        bank: without a floor, and the ground under the sky is too steep to stand on, bool.
    """

    floor: Float
    open: Bool
    hole: Bool
    edge: Bool
    sky: Bool
    bank: Bool


class RoomFlags(NamedTuple):
    """All that rooms depend on beside settings: `find_rooms` is a function of these.

    Attributes:
        lattice: the cells.
        levels: the flags of each level.
        empty: cells in whose columns there is nothing, shape (height, width), bool.
        ends: the sides of the lattice at which the scene ends, [[upper, lower], [left, right]].
        has_ground: whether endless ground goes on beyond the lattice.
        links: steps between cells, see `Floors`, shape (n, 4).
        marks: the rooms that each source marks, by source.
    """

    lattice: Lattice
    levels: list[LevelFlags]
    empty: Bool
    ends: Bool
    has_ground: bool
    links: Int
    marks: Mapping[str, MarkedRooms]

    def equal(self, other: RoomFlags) -> bool:
        """Whether the same rooms are found from both."""
        return _equal(self, other)


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(_equal(one[k], other[k]) for k in one)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    return bool(one == other)


class Overhead(NamedTuple):
    """What lies highest over each cell, and holes in the floors of each level.

    Attributes:
        columns: all surfaces.
        top: height of the highest surface of each cell, NaN for none, shape (cells,), float64 [m].
        up: the z of that surface's unit normal, shape (cells,), float32.
        holes: of each level, the cells without a floor in which nothing stands at the height of
            an agent's body, shape (height, width), bool.
    """

    columns: ColumnSource
    top: Float
    up: NDArray[np.float32]
    holes: list[Bool]


class OverheadFinder:
    """Finds what lies highest over each cell, and holes in floors, block by block."""

    def __init__(
        self, columns: ColumnSource, levels: Sequence[LevelFloor], agent: AgentSettings
    ) -> None:
        num_cells = columns.lattice.width * columns.lattice.height
        self._levels, self._agent = levels, agent
        self._found = Overhead(
            columns,
            np.full(num_cells, np.nan),
            np.zeros(num_cells, dtype=np.float32),
            [np.isnan(level.floor) for level in levels],
        )

    def add(self, columns: Columns) -> None:
        """Look at the columns of a block."""
        first, end = columns.known_rows.cells(columns.lattice)
        start = columns.start[first : end + 1]
        filled = np.flatnonzero(np.diff(start))
        last = start[filled + 1] - 1
        self._found.top[first + filled] = columns.z[last]
        self._found.up[first + filled] = columns.normal[last, 2]
        for level, holes in zip(self._levels, self._found.holes, strict=True):
            keep_holes(holes.ravel()[first:end], start, level.ground, columns, self._agent)

    def found(self) -> Overhead:
        """What was found in all blocks."""
        return self._found


def keep_holes(
    holes: Bool, start: NDArray[np.int64], ground: float, columns: Columns, agent: AgentSettings
) -> None:
    """Keep the marks of cells in which nothing stands at the height of an agent's body.

    That is so where the next surface over the level's ground and a step is higher than the agent,
    unless it is the top of something.
    """
    cell = np.flatnonzero(holes)
    if not len(cell):
        return
    below = columns.z <= ground + agent.traversable_floor_height
    count = np.concatenate([[0], np.cumsum(below)])
    begin, end = start[cell], start[cell + 1]
    following = begin + count[end] - count[begin]
    has_next = np.flatnonzero(following < end)
    entry = following[has_next]
    is_low = columns.z[entry] <= ground + agent.height
    is_top = columns.normal[entry, 2] > 0
    holes[cell[has_next[is_low | is_top]]] = False


class Blocked(NamedTuple):
    """What keeps cells of a level out of all rooms, shape (height, width), bool.

    Attributes:
        wall: cells that a wall stands in.
        low: cells that a mesh of a whole building blocks, but not above heads; see `find_windows`.
    """

    wall: Bool
    low: Bool


def read_flags(
    scene: Scene,
    overhead: Overhead,
    floors: Floors,
    blocked: Sequence[Blocked],
    settings: RoomSettings,
    agent: AgentSettings,
) -> RoomFlags:
    """Read from a scene, and from what was found in its columns, all that its rooms depend on.

    Raises:
        ConfigError: a polygon names a level that does not exist.
    """
    lattice, min_up = overhead.columns.lattice, agent_limits(agent).min_up
    empty = np.isnan(overhead.top).reshape(lattice.shape)
    top, up = overhead.top.reshape(lattice.shape), overhead.up.reshape(lattice.shape)
    levels: list[LevelFlags] = []
    of_levels = zip(floors.levels, blocked, overhead.holes, strict=True)
    for level, (wall, low), hole in of_levels:
        floor, bare = level.floor, np.isnan(level.floor)
        open_cells = ~bare & ~wall & ~find_windows(low, wall, lattice.cell_size)
        bank = bare & (up > 0) & (up < min_up)
        edge = find_edge(empty | bank, open_cells, floor, overhead.columns)
        sky = top <= floor + agent.height + SLACK
        levels.append(LevelFlags(floor, open_cells, hole, edge, sky, bank))
    bounds = scene.bounds
    ends = np.zeros((2, 2), dtype=np.bool_) if bounds is None else find_ends(lattice, bounds)
    has_ground = len(scene.shapes.planes.geom) > 0
    marks = mark_rooms(scene, overhead.columns, floors.levels, settings, agent)
    return RoomFlags(lattice, levels, empty, ends, has_ground, floors.links, marks)


def find_edge(beyond: Bool, open_cells: Bool, floor: Float, columns: ColumnSource) -> Bool:
    """Mark the open cells of a level at the edge of the grid, or at what lies `beyond` it.

    That is floor beyond which there is nothing up to that edge, or ground that is too steep to
    stand on, such as the bank of a ditch. Walls and pillars are left out: what reaches above heads.
    """
    edge = edge_cells(beyond, np.ones((2, 2), dtype=np.bool_)) & open_cells
    cell = np.flatnonzero(edge)
    known, height = columns.at(cell), floor.ravel()[cell]
    start, end = known.start[cell], known.start[cell + 1]
    owner = np.repeat(np.arange(len(cell)), end - start)
    entry = np.arange(len(owner)) + (start - np.cumsum(end - start) + (end - start))[owner]
    below = known.z[entry] <= height[owner] + SAME
    above = start + np.bincount(owner[below], minlength=len(cell))
    tall = above < end
    above = above[tall]
    tall[tall] = (known.normal[above, 2] > 0) & (known.z[above] > height[tall] + WALL_BAND[0])
    edge[edge] = ~tall
    return edge


def edge_cells(is_open: Bool, sides: Bool) -> Bool:
    """Cells on the edge of the lattice, or of open cells that reach it, and are not open.

    `sides` says which of the lattice's edges count: [[upper, lower], [left, right]].
    """
    empty = np.pad(is_open, 1)
    empty[[0, -1]] |= sides[0][:, None]
    empty[:, [0, -1]] |= sides[1]
    part, _ = label_parts(empty)
    outer = np.unique(np.concatenate([part[[0, -1]].ravel(), part[:, [0, -1]].ravel()]))
    beyond = np.isin(part, outer[outer > 0])
    edge: Bool = beyond[:-2, 1:-1] | beyond[2:, 1:-1] | beyond[1:-1, :-2] | beyond[1:-1, 2:]
    return edge & ~beyond[1:-1, 1:-1]


def find_ends(lattice: Lattice, bounds: Float) -> Bool:
    """At which sides of a lattice the scene in a box ends: [[upper, lower], [left, right]]."""
    x0, y0, x1, y1 = lattice.bounds
    (low_x, low_y), (high_x, high_y) = bounds[:, :2]
    more = np.array([[high_y - y1, y0 - low_y], [x0 - low_x, high_x - x1]])
    return np.asarray(more <= BEYOND * lattice.cell_size)
