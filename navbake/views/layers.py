"""What pictures show of each level: a colour or a value for every cell, and names on top."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.islands import clearance, islands_of
from navbake.navgrid.rooms import Room
from navbake.views.info import level_name

if TYPE_CHECKING:
    from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D

    AnyGrid = SceneGrid2D | MultiLevelGrid

FREE, OCCUPIED, NO_FLOOR, DOOR = "#f7f3e8", "#3b4252", "#b9c0cc", "#c0392b"
FURNITURE = 0.75  # how bright a room's colour is where something stands in it
DARKER = "#8f8f8f"  # stands in the legend for all rooms' darker colours
GOLDEN = 0.618034  # of a turn: hues this far apart stay apart, however many there are
SHADES = ((0.5, 0.97), (0.25, 0.95), (0.6, 0.87))  # saturation and value, in turn


@dataclass(frozen=True)
class Label:
    """A name on a picture.

    Attributes:
        text: the name.
        fallback: what to write where no font has its letters.
        x, y: where its middle is, world frame [m].
        room: how wide the cells are that it is about, there [m].
    """

    text: str
    fallback: str
    x: float
    y: float
    room: float


@dataclass(frozen=True)
class Panel:
    """One layer of one level.

    Attributes:
        title: what is to be seen.
        rgb: colours, shape (height, width, 3), uint8.
        values: what a colour scale shows instead, shape (height, width), float32, NaN where the
            colours stay.
        scale: what the values are, with their unit; empty where there are none.
        legend: what colours mean.
        labels: names to write.
    """

    title: str
    rgb: NDArray[np.uint8]
    values: NDArray[np.float32] | None = None
    scale: str = ""
    legend: tuple[tuple[str, str], ...] = ()
    labels: tuple[Label, ...] = ()


def make_panels(grid: AnyGrid, layer: str) -> list[Panel]:
    """Show a layer of all levels.

    Args:
        grid: a grid of one or several levels. Clearance and islands need not be in it.
        layer: one of `LAYERS`.

    Raises:
        QueryError: there is no such layer.
    """
    if layer not in LAYERS:
        raise QueryError(f"expected one of {', '.join(LAYERS)} as layer, got {layer!r}")
    return LAYERS[layer](grid)


def rgb_of(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour like ``#f7f3e8``."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def _show_occupancy(grid: AnyGrid) -> list[Panel]:
    legend = (("free", FREE), ("occupied", OCCUPIED), ("no floor", NO_FLOOR))
    panels = []
    for number, level in enumerate(grid.levels):
        area = np.count_nonzero(level.free) * level.lattice.cell_size**2
        title = (
            f"{level_name(grid, number)}: ground {level.ground:.2f} m, "
            f"free {area:.1f} m\N{SUPERSCRIPT TWO}"
        )
        panels.append(Panel(title, _color_occupancy(level), legend=legend))
    return panels


def _show_floor(grid: AnyGrid) -> list[Panel]:
    panels = []
    for number, level in enumerate(grid.levels):
        floor = level.floor_height * np.float32(level.unit)
        rgb = np.full((*level.shape, 3), rgb_of(NO_FLOOR), dtype=np.uint8)
        title = f"{level_name(grid, number)}: floor height"
        panels.append(Panel(title, rgb, floor, "z [m]", (("no floor", NO_FLOOR),)))
    return panels


def _show_clearance(grid: AnyGrid) -> list[Panel]:
    values = [level.attributes.get("clearance") for level in grid.levels]
    metres = [
        clearance(level) if stored is None else (stored * level.unit).astype(np.float32)
        for level, stored in zip(grid.levels, values, strict=True)
    ]
    return _show_free(grid, metres, "clearance", "to the nearest obstacle [m]")


def _show_weights(grid: AnyGrid) -> list[Panel]:
    weights = [level.weights.astype(np.float32) for level in grid.levels]
    return _show_free(grid, weights, "weights", "cost of a cell")


def _show_free(
    grid: AnyGrid, values: list[NDArray[np.float32]], name: str, scale: str
) -> list[Panel]:
    """Show values where an agent can stand, and what is there elsewhere."""
    legend = (("occupied", OCCUPIED), ("no floor", NO_FLOOR))
    return [
        Panel(
            f"{level_name(grid, number)}: {name}",
            _color_occupancy(level),
            np.where(level.free, value, np.float32(np.nan)),
            scale,
            legend,
        )
        for number, (level, value) in enumerate(zip(grid.levels, values, strict=True))
    ]


def _show_islands(grid: AnyGrid) -> list[Panel]:
    islands = islands_of(grid)
    panels = []
    for number, (level, island) in enumerate(zip(grid.levels, islands, strict=True)):
        rgb = _color_occupancy(level)
        part = island.astype(np.int64)
        rgb[level.free] = _palette(int(part.max(initial=0)))[part[level.free]]
        title = f"{level_name(grid, number)}: islands"
        legend = (("occupied", OCCUPIED), ("no floor", NO_FLOOR))
        panels.append(Panel(title, rgb, legend=legend))
    return panels


def _show_rooms(grid: AnyGrid) -> list[Panel]:
    rooms = grid.rooms
    palette = _palette(len(rooms))
    panels = []
    for number, level in enumerate(grid.levels):
        index = level.room_index
        colors = np.zeros((int(index.max(initial=0)) + 1, 3), dtype=np.uint8)
        colors[0] = rgb_of(OCCUPIED)
        labels = []
        for k, room in enumerate(rooms, 1):
            cells = index == room.index
            if room.level == number and cells.any():
                colors[room.index] = palette[k]
                labels.append(_place_label(level, cells, room))
        rgb = colors[index]
        left = (index == 0) & level.free
        rgb[left] = rgb_of(FREE)
        stands = (index > 0) & ~level.free
        rgb[stands] = (rgb[stands] * FURNITURE).astype(np.uint8)
        rgb[np.isnan(level.floor_height)] = rgb_of(NO_FLOOR)
        doors = _door_mask(grid, number)
        rgb[doors] = rgb_of(DOOR)
        legend = [("no room", OCCUPIED), ("no floor", NO_FLOOR)]
        legend += [("free, no room", FREE)] if left.any() else []
        legend += [("darker: occupied", DARKER)] if stands.any() else []
        legend += [("door", DOOR)] if doors.any() else []
        panels.append(
            Panel(
                f"{level_name(grid, number)}: rooms",
                rgb,
                legend=tuple(legend),
                labels=tuple(labels),
            )
        )
    return panels


LAYERS: dict[str, Callable[[AnyGrid], list[Panel]]] = {
    "occupancy": _show_occupancy,
    "floor": _show_floor,
    "rooms": _show_rooms,
    "clearance": _show_clearance,
    "island": _show_islands,
    "weights": _show_weights,
}
"""How each layer is shown, by its name."""


def _color_occupancy(level: SceneGrid2D) -> NDArray[np.uint8]:
    """Colours of the cells by whether an agent can stand in them, shape (height, width, 3)."""
    palette = np.array([rgb_of(OCCUPIED), rgb_of(FREE), rgb_of(NO_FLOOR)], dtype=np.uint8)
    kind = np.where(level.free, 1, np.where(np.isnan(level.floor_height), 2, 0))
    return palette[kind]


def _palette(count: int) -> NDArray[np.uint8]:
    """A colour for each number from 1, shape (count + 1, 3), uint8; 0 is black."""
    colors = [(0.0, 0.0, 0.0)]
    for number in range(count):
        saturation, value = SHADES[number % len(SHADES)]
        colors.append(colorsys.hsv_to_rgb((0.58 + number * GOLDEN) % 1.0, saturation, value))
    return np.round(np.array(colors) * 255).astype(np.uint8)


def _door_mask(grid: AnyGrid, number: int) -> NDArray[np.bool_]:
    """The cells of a level in which a door stands, closed or as it is."""
    level = grid.levels[number]
    mask = np.zeros(level.width * level.height, dtype=np.bool_)
    for door in grid.doors:
        for state in ("closed", door.state):
            mask[door.cells_in(state, len(grid.levels))[number]] = True
    return mask.reshape(level.shape)


def _place_label(level: SceneGrid2D, mask: NDArray[np.bool_], room: Room) -> Label:
    """Put a room's name where there is most space around it."""
    from scipy.ndimage import distance_transform_edt

    rows, cols = np.nonzero(mask)
    part = mask[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    space = distance_transform_edt(np.pad(part, 1))[1:-1, 1:-1]
    row, col = np.unravel_index(int(np.argmax(space)), space.shape)
    others = np.flatnonzero(~np.pad(part[row], 1)) - 1
    after = int(np.searchsorted(others, col))
    first, last = others[after - 1] + 1, others[after] - 1
    middle = (first + last) / 2 + cols.min()
    x, y = level.lattice.positions(row + rows.min(), middle)
    width = (last - first + 1) * level.lattice.cell_size
    name = f"{room.level}:{room.index}"
    return Label(room.name or name, name, float(x), float(y), width)
