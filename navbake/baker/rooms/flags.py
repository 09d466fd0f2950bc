"""What rooms are found from: flags of each level's cells, and marks; nothing else decides rooms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import ColumnSource
from navbake.baker.connect import label_parts
from navbake.baker.contents.walls import WALL_BAND
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.rooms.kernels import gaps as kernels
from navbake.baker.rooms.sources import MarkedRooms, mark_rooms
from navbake.baker.rooms.walls import find_windows
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, RoomSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int

# The scene goes on beyond the lattice where it does so by more than this share of a cell
BEYOND = 0.5
LEAST_CELLS = 4096  # so many are worth a call on another thread
EVERY_SIDE = np.ones((2, 2), dtype=np.bool_)


class LevelFlags(NamedTuple):
    """What rooms need of the cells of a level, shape (height, width) of the whole lattice.

    Attributes:
        floor: heights, NaN for none, float64 [m].
        open: with a floor, and no wall or window, bool.
        hole: without a floor, and nothing stands at the height of an agent's body, bool.
        edge: open cells at the edge of the grid, bool: floor beyond which there is nothing up to
            that edge, or ground that is too steep to stand on, such as the bank of a ditch. Walls
            and pillars are left out: what reaches above heads.
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


class ColumnFlags:
    """What rooms read of each cell's column, on each level.

    Attributes:
        bits: by level, see `flag_columns`, shape (cells,), uint8.
    """

    def __init__(self, floors: Floors, agent: AgentSettings) -> None:
        self._limits = agent_limits(agent)
        self.bits = [np.zeros(level.floor.size, dtype=np.uint8) for level in floors.levels]

    def look(self, cells: slice | Int, crossings: Crossings, levels: Sequence[LevelFloor]) -> bool:
        """Look at the columns of some cells, numbered as they are; whether any flag changed."""
        changed, found = False, np.empty(len(crossings.start) - 1, dtype=np.uint8)
        for bits, level in zip(self.bits, levels, strict=True):
            asked = crossings, level.floor.ravel()[cells], level.ground, self._limits, WALL_BAND[0]
            run_in_bands(kernels.flag_columns, len(found), *asked, found, least=LEAST_CELLS)
            changed |= not np.array_equal(bits[cells], found)
            bits[cells] = found
        return changed


def read_flags(
    scene: Scene,
    columns: ColumnSource,
    floors: Floors,
    of_columns: Sequence[NDArray[np.uint8]],
    blocked: Sequence[tuple[Bool, Bool]],
    settings: RoomSettings,
    agent: AgentSettings,
) -> RoomFlags:
    """Read from a scene, and from what was found in its columns, all that its rooms depend on.

    Args:
        of_columns: by level, see `ColumnFlags`.
        blocked: by level, the cells that a wall stands in, and those that a mesh of a whole
            building blocks, but not above heads; shape (height, width).

    Raises:
        ConfigError: a polygon names a level that does not exist.
    """
    lattice, levels = columns.lattice, list[LevelFlags]()
    for level, bits, (wall, low) in zip(floors.levels, of_columns, blocked, strict=True):
        marked = bits.reshape(lattice.shape)
        empty, hole, bank, sky, tall = ((marked & flag) > 0 for flag in kernels.COLUMN_FLAGS)
        open_cells = ~np.isnan(level.floor) & ~wall & ~find_windows(low, wall, lattice.cell_size)
        edge = edge_cells(empty | bank, EVERY_SIDE) & open_cells & ~tall
        levels.append(LevelFlags(level.floor, open_cells, hole, edge, sky, bank))
    ends = find_ends(lattice, scene.bounds)
    has_ground = len(scene.shapes.planes.geom) > 0
    marks = mark_rooms(scene, columns, floors.levels, settings, agent)
    return RoomFlags(lattice, levels, empty, ends, has_ground, floors.links, marks)


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


def find_ends(lattice: Lattice, bounds: Float | None) -> Bool:
    """At which sides of a lattice the scene in a box ends: [[upper, lower], [left, right]]."""
    if bounds is None:
        return np.zeros((2, 2), dtype=np.bool_)
    x0, y0, x1, y1 = lattice.bounds
    (low_x, low_y), (high_x, high_y) = bounds[:, :2]
    more = np.array([[high_y - y1, y0 - low_y], [x0 - low_x, high_x - x1]])
    return np.asarray(more <= BEYOND * lattice.cell_size)
