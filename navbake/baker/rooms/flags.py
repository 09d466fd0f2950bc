"""The input of rooms: flags of each level's cells, and marks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import ColumnSource
from navbake.baker.connect import label_parts
from navbake.baker.contents.contents import Contents
from navbake.baker.contents.walls import WALL_BAND
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import BUILDING, WALL
from navbake.baker.rooms.gaps import WIDEST
from navbake.baker.rooms.kernels import gaps as kernels
from navbake.baker.rooms.sources import MarkedRooms, mark_rooms
from navbake.baker.rooms.walls import find_windows
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings, RoomSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS, run_in_bands
from navbake.types import Bool, Float, Int

# The scene goes on beyond the lattice where it does so by more than this share of a cell
BEYOND = 0.5
# What is outdoors reaches the edge over more than this in one piece: no opening in a wall at the
# edge is so wide [m]
EDGE_LENGTH = WIDEST
EVERY_SIDE = np.ones((2, 2), dtype=np.bool_)


class LevelFlags(NamedTuple):
    """Flags of a level's cells, shape (height, width) of the whole lattice."""

    floor: Float  # heights, NaN for none [m]
    open: Bool  # with a floor, and no wall or window
    hole: Bool  # without a floor, and nothing stands at the height of an agent's body
    # open cells beside which there is nothing up to the edge of the grid, or ground too steep to
    # stand on, such as the bank of a ditch; no walls and pillars, which reach above heads
    edge: Bool
    # with a floor, and nothing above an agent's head; no cells of a level where too few are at the
    # edge for anything to be outdoors: nothing else depends on it
    sky: Bool
    bank: Bool  # without a floor, and the ground under the sky is too steep to stand on


class RoomFlags(NamedTuple):
    """All that rooms depend on besides settings."""

    lattice: Lattice
    levels: list[LevelFlags]
    empty: Bool  # cells in whose columns there is nothing, shape (height, width)
    ends: Bool  # the sides of the lattice at which the scene ends, [[upper, lower], [left, right]]
    walls: Shapes  # the geometry of walls and of meshes that hold a building
    has_ground: bool  # endless ground goes on beyond the lattice
    links: Int  # steps between cells, see `Floors`, shape (n, 4)
    marks: Mapping[str, MarkedRooms]  # the rooms that each source marks


def are_equal(one: Any, other: Any) -> bool:
    """Whether flags, rooms or doors, or parts of them, are the same."""
    if one is other:
        return True
    if is_dataclass(one):
        return all(are_equal(getattr(one, k.name), getattr(other, k.name)) for k in fields(one))
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(are_equal(one[k], other[k]) for k in one)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(are_equal, one, other))
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    return bool(one == other)


class ColumnFlags:
    """Flags of each cell's column.

    Attributes:
        bits: by level, (cells,), see `flag_columns`.
        decisive: by level, (cells,), which of them rooms depend on, as `read_flags` finds.
    """

    def __init__(self, floors: Floors, agent: AgentSettings) -> None:
        self._limits = agent_limits(agent)
        self.bits = [np.zeros(level.floor.size, dtype=np.uint8) for level in floors.levels]
        self.decisive = list[NDArray[np.uint8]]()

    def look(self, cells: slice | Int, crossings: Crossings, levels: Sequence[LevelFloor]) -> bool:
        """Flag some cells, as which the columns are numbered; whether any decisive flag changed."""
        changed, found = False, np.empty(len(crossings.start) - 1, dtype=np.uint8)
        for number, (bits, level) in enumerate(zip(self.bits, levels, strict=True)):
            asked = crossings, level.floor.ravel()[cells], level.ground, self._limits, WALL_BAND[0]
            run_in_bands(kernels.flag_columns, len(found), *asked, found, least=LEAST_CELLS)
            if self.decisive:
                changed |= bool(((bits[cells] ^ found) & self.decisive[number][cells]).any())
            bits[cells] = found
        return changed


def read_flags(
    scene: Scene,
    columns: ColumnSource,
    floors: Floors,
    of_columns: ColumnFlags,
    contents: Contents | None,
    settings: RoomSettings,
    agent: AgentSettings,
) -> RoomFlags:
    """Read all that rooms depend on from a scene and its earlier stages."""
    lattice, levels = columns.lattice, list[LevelFlags]()
    of_columns.decisive = []
    wall = low = np.zeros(lattice.shape, dtype=np.bool_)
    for number, level in enumerate(floors.levels):
        if contents is not None:
            wall, low = contents.mark_walls(number)
        marked = of_columns.bits[number].reshape(lattice.shape)
        empty, hole, bank, sky, tall = ((marked & flag) > 0 for flag in kernels.COLUMN_FLAGS)
        open_cells = ~np.isnan(level.floor) & ~wall & ~find_windows(low, wall, lattice.cell_size)
        edge = edge_cells(empty | bank, EVERY_SIDE) & open_cells
        decisive = np.full(edge.shape, sum(kernels.COLUMN_FLAGS), dtype=np.uint8)
        decisive[~edge] -= kernels.TALL
        edge &= ~tall
        longest = np.sqrt(2) * np.count_nonzero(edge) * lattice.cell_size  # if all touch
        if longest <= EDGE_LENGTH:
            sky[:] = False
            decisive -= kernels.SKY
        of_columns.decisive.append(decisive.ravel())
        levels.append(LevelFlags(level.floor, open_cells, hole, edge, sky, bank))
    ends = ~EVERY_SIDE
    if scene.bounds is not None:
        x0, y0, x1, y1 = lattice.bounds
        (low_x, low_y), (high_x, high_y) = scene.bounds[:, :2]
        more = np.array([[high_y - y1, y0 - low_y], [x0 - low_x, high_x - x1]])
        ends = more <= BEYOND * lattice.cell_size
    has_ground = len(scene.shapes.planes.geom) > 0
    is_wall = np.zeros(len(scene.geoms), dtype=np.bool_)
    if contents is not None:
        is_wall = np.isin(contents.partitions, (WALL, BUILDING))
    marks = mark_rooms(scene, columns, floors.levels, settings, agent)
    walls = scene.shapes.only(is_wall)
    return RoomFlags(lattice, levels, empty, ends, walls, has_ground, floors.links, marks)


def edge_cells(is_open: Bool, sides: Bool) -> Bool:
    """Closed cells at some `sides` of the lattice, or beside open cells connected to these."""
    empty = np.pad(is_open, 1)
    empty[[0, -1]] |= sides[0][:, None]
    empty[:, [0, -1]] |= sides[1]
    part, _ = label_parts(empty)
    outer = np.unique(np.concatenate([part[[0, -1]].ravel(), part[:, [0, -1]].ravel()]))
    beyond = np.isin(part, outer[outer > 0])
    edge: Bool = beyond[:-2, 1:-1] | beyond[2:, 1:-1] | beyond[1:-1, :-2] | beyond[1:-1, 2:]
    return edge & ~beyond[1:-1, 1:-1]
