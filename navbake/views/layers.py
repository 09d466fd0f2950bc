"""What a picture shows of each level: a colour or a value for every cell, and labels."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance, islands_of
from navbake.navgrid.rooms import Room
from navbake.types import Bool
from navbake.views.colors import DARKER, DOOR, FREE, NO_FLOOR, OCCUPIED, make_palette, rgb_of

FURNITURE = 0.75  # brightness of a room's colour where something stands in it
BLOCKED_LEGEND = (("occupied", OCCUPIED), ("no floor", NO_FLOOR))


class Label(NamedTuple):
    """A room's name on a picture."""

    text: str
    fallback: str  # written in its place if no font has its letters
    x: float  # of its middle, world frame [m]
    y: float
    width: float  # of the room at this place [m]


class Panel(NamedTuple):
    """One layer of one level; cells whose value is finite are coloured by that, not by `rgb`."""

    title: str
    rgb: NDArray[np.uint8]  # shape (height, width, 3)
    values: NDArray[np.float32] | None = None  # shape (height, width)
    scale: str = ""  # what the values are, with their unit
    legend: tuple[tuple[str, str], ...] = ()  # meanings and their colours
    labels: tuple[Label, ...] = ()


def make_panels(grid: NavGrid, layer: str) -> list[Panel]:
    """Show one of `LAYERS` of all levels, lowest first."""
    if layer not in LAYERS:
        raise QueryError(f"expected one of {', '.join(LAYERS)} as layer, got {layer!r}")
    panels = (LAYERS[layer](grid, number) for number in range(len(grid.levels)))
    return [
        panel._replace(title=f"{name}: {panel.title}")
        for name, panel in zip(grid.level_names, panels, strict=True)
    ]


def _show_occupancy(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    area = np.count_nonzero(level.free) * level.lattice.cell_size**2
    title = f"ground {level.ground:.2f} m, free {area:.1f} m\N{SUPERSCRIPT TWO}"
    return Panel(title, _color_occupancy(level), legend=(("free", FREE), *BLOCKED_LEGEND))


def _show_floor(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    rgb = np.full((*level.shape, 3), rgb_of(NO_FLOOR), dtype=np.uint8)
    metres = level.floor_height * np.float32(level.unit)
    return Panel("floor height", rgb, metres, "z [m]", (("no floor", NO_FLOOR),))


def _show_clearance(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    stored = level.attributes.get("clearance")
    metres = clearance(level) if stored is None else stored * level.unit
    return _show_free(level, metres, "clearance", "to the nearest obstacle [m]")


def _show_weights(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    return _show_free(level, level.weights, "weights", "cost of a cell")


def _show_free(level: SceneGrid2D, values: NDArray[np.floating], title: str, scale: str) -> Panel:
    """Show values where an agent can stand, and what is there elsewhere."""
    shown = np.where(level.free, values, np.nan).astype(np.float32)
    return Panel(title, _color_occupancy(level), shown, scale, BLOCKED_LEGEND)


def _show_islands(grid: NavGrid, number: int) -> Panel:
    level, island = grid.levels[number], islands_of(grid)[number]
    rgb = _color_occupancy(level)
    rgb[level.free] = make_palette(int(island.max(initial=0)))[island[level.free]]
    return Panel("islands", rgb, legend=BLOCKED_LEGEND)


def _show_rooms(grid: NavGrid, number: int) -> Panel:
    cells = RoomCells.of(grid, number)
    level, index = grid.levels[number], cells.room_index
    labels = []
    for room in grid.rooms:
        mask = index == room.index
        if room.level == number and mask.any():
            labels.append(_place_label(level, mask, room))
    legend = [("no room", OCCUPIED), ("no floor", NO_FLOOR)]
    legend += [("free, no room", FREE)] if ((index == 0) & cells.free).any() else []
    legend += [("darker: occupied", DARKER)] if ((index > 0) & ~cells.free).any() else []
    legend += [("door", DOOR)] if cells.door.any() else []
    return Panel("rooms", cells.paint(), legend=tuple(legend), labels=tuple(labels))


class RoomCells(NamedTuple):
    """What the colour of a cell in a picture of rooms follows from; arrays (height, width)."""

    colors: NDArray[np.uint8]  # shape (2 n + 2, 3): see `paint`
    room_index: NDArray[np.uint16]
    free: Bool
    floor: NDArray[np.float32]  # NaN for none
    door: Bool  # where one stands, closed or as it is

    @classmethod
    def of(cls, grid: NavGrid, number: int) -> "RoomCells":
        """The cells of one level."""
        level = grid.levels[number]
        index = level.room_index
        rooms = np.zeros((int(index.max(initial=0)) + 1, 3), dtype=np.uint8)
        # one palette for all levels, so that rooms over each other differ
        for room, color in zip(grid.rooms, make_palette(len(grid.rooms))[1:], strict=True):
            if room.level == number and room.index < len(rooms):
                rooms[room.index] = color
        colors = np.stack([(rooms * FURNITURE).astype(np.uint8), rooms], axis=1).reshape(-1, 3)
        colors[:2] = rgb_of(OCCUPIED), rgb_of(FREE)
        colors = np.concatenate([colors, [rgb_of(NO_FLOOR), rgb_of(DOOR)]]).astype(np.uint8)
        return cls(colors, index, level.free, level.floor_height, _door_mask(grid, number))

    def paint(self, rows: slice = slice(None)) -> NDArray[np.uint8]:
        """Colours of some rows, shape (number of rows, width, 3).

        A room has two colours, for occupied and for free cells; the last two are no floor and a
        door.
        """
        code = self.room_index[rows] * np.intp(2) + self.free[rows]
        code[np.isnan(self.floor[rows])] = len(self.colors) - 2
        code[self.door[rows]] = len(self.colors) - 1
        painted: NDArray[np.uint8] = self.colors.take(code, axis=0)
        return painted


LAYERS: dict[str, Callable[[NavGrid, int], Panel]] = {
    "occupancy": _show_occupancy,
    "floor": _show_floor,
    "rooms": _show_rooms,
    "clearance": _show_clearance,
    "island": _show_islands,
    "weights": _show_weights,
}
"""How each layer of a level is shown, by the layer's name."""


def _color_occupancy(level: SceneGrid2D) -> NDArray[np.uint8]:
    """Colours of the cells by whether an agent can stand in them, shape (height, width, 3)."""
    palette = np.array([rgb_of(OCCUPIED), rgb_of(FREE), rgb_of(NO_FLOOR)], dtype=np.uint8)
    return palette[np.where(level.free, 1, np.where(np.isnan(level.floor_height), 2, 0))]


def _door_mask(grid: NavGrid, number: int) -> Bool:
    """The cells of a level in which a door stands, closed or as it is."""
    mask = np.zeros(grid.levels[number].shape, dtype=np.bool_)
    for door in grid.doors:
        for state in ("closed", door.state):
            mask.flat[door.cells_in(state, len(grid.levels))[number]] = True
    return mask


def _place_label(level: SceneGrid2D, mask: Bool, room: Room) -> Label:
    """Put a room's name where the largest disc fits into the room."""
    # Imported here, as scipy takes longer to load than most pictures to draw.
    from scipy.ndimage import distance_transform_edt

    rows, cols = np.nonzero(mask)
    part = mask[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    space = distance_transform_edt(np.pad(part, 1))[1:-1, 1:-1]
    row, col = np.unravel_index(int(np.argmax(space)), space.shape)
    # the run of the room's cells in that row: what the name may take up, and its middle
    others = np.flatnonzero(~np.pad(part[row], 1)) - 1
    after = int(np.searchsorted(others, col))
    first, last = others[after - 1] + 1, others[after] - 1
    middle = (first + last) / 2 + cols.min()
    x, y = level.lattice.positions(row + rows.min(), middle)
    width = (last - first + 1) * level.lattice.cell_size
    fallback = f"{room.level}:{room.index}"
    return Label(room.name or fallback, fallback, float(x), float(y), width)
