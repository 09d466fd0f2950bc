"""What a picture shows of each level: a colour or a value for every cell, names and doors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import check_level
from navbake.navgrid.colors import (
    ACROSS,
    DARKER,
    DOOR,
    DOORWAY,
    DOWN,
    FREE,
    MARKS,
    NO_FLOOR,
    OCCUPIED,
    ROOMS,
    UP,
    WALL,
    choose_colors,
    color_rooms,
    darkened,
    find_neighbours,
    rgb_of,
)
from navbake.navgrid.door_lines import DoorLine, doorway_cells, find_door_lines
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance, islands_of
from navbake.navgrid.rooms import Room
from navbake.types import Bool
from navbake.views.color_scale import ColorScale, height_scale, linear_scale

if TYPE_CHECKING:
    from navbake.verifier.report import Finding

RELIEF = 0.04  # a step that is lit or shaded well [m]
RELIEF_SLOPE = 0.3  # or one of a cell, at this slope, so that large cells of hills aren't all dark
LIT, SHADED = 0.3, 0.35  # most that relief mixes white or black into a colour
BAND_CELLS = 1 << 20  # painted at once
MAX_SIDE = 400  # cells of a room that are looked at for a name's place, along its longer side
OCCUPANCY = {"free": FREE, "occupied": OCCUPIED, "no floor": NO_FLOOR}
PALETTE = np.array([rgb_of(color) for color in OCCUPANCY.values()], dtype=np.uint8)
DISAGREEMENTS = "disagreements"  # the layer that shows what a verification found

Legend = tuple[tuple[str, str], ...]
"""Meanings and their colours."""


class Label(NamedTuple):
    """A name on a picture."""

    text: str
    fallback: str  # written in its place if no font has its letters
    x: float  # of its middle, world frame [m]
    y: float
    width: float  # of what it names at this place [m]
    height: float  # of the same [m]
    number: int = 0  # written where there is no space for the name


class Panel(NamedTuple):
    """One layer of one level; cells whose value is finite are coloured by that, not by `rgb`."""

    title: str
    rgb: NDArray[np.uint8]  # shape (height, width, 3)
    values: NDArray[np.float32] | None = None  # shape (height, width)
    scale: ColorScale | None = None  # of the values
    legend: Legend = ()
    labels: tuple[Label, ...] = ()
    doors: tuple[DoorLine, ...] = ()
    relief: float = 0.0  # a step of values that gets 3/4 of the most light or shade; 0: no relief


def paint(panel: Panel) -> NDArray[np.uint8]:
    """The colour of each cell, shape (height, width, 3), row 0 at the largest y."""
    if panel.values is None or panel.scale is None:
        return panel.rgb
    painted = panel.rgb.copy()
    # in bands: the numbers in between take ten times the memory of a picture
    band = max(BAND_CELLS // panel.values.shape[1], 1)
    for first in range(0, len(painted), band):
        rows = slice(first, first + band)
        values = panel.values[rows]
        shown = np.isfinite(values)
        colors = panel.scale.color(values[shown])
        if panel.relief:
            above = min(first, 1)  # light falls on the first row by the one above it
            lit = light_of(panel.values[first - above : first + band], panel.relief)[above:]
            lit = lit[shown][:, None]
            share = np.where(lit > 0, lit * LIT, -lit * SHADED)
            colors = np.round(colors * (1 - share) + (lit > 0) * 255 * share).astype(np.uint8)
        painted[rows][shown] = colors
    return painted


def light_of(heights: NDArray[Any], step: float) -> NDArray[np.float32]:
    """How the light falls on floors, from -1, in shade, to 1, lit: shape (height, width).

    The light comes from the upper left, as on maps. A cell that is higher than its neighbours
    above and to the left is lit, one that is lower lies in shade, by 3/4 where it is higher or
    lower by `step`. Where there is no floor beside it, it is neither. So a step of 2 cm shows as
    a line, whatever the scale of colours spans.
    """
    rise = np.zeros(heights.shape, dtype=np.float32)
    finite = np.where(np.isfinite(heights), heights, np.nan)
    rise[1:] += np.nan_to_num(np.diff(finite, axis=0))
    rise[:, 1:] += np.nan_to_num(np.diff(finite, axis=1))
    lit: NDArray[np.float32] = np.tanh(rise / np.float32(step))
    return lit


def make_panel(
    grid: NavGrid, layer: str, number: int, *, findings: Sequence[Finding] | None = None
) -> Panel:
    """Show a layer of one level.

    Args:
        grid: a grid of one or several levels.
        layer: one of `LAYERS`, or `DISAGREEMENTS`.
        number: of the level, 0 is the lowest.
        findings: what a verification found, for the layer `DISAGREEMENTS`.

    Returns:
        The layer; `paint` turns it into colours.

    Raises:
        QueryError: there is no such layer or level, or it needs findings and has none.
    """
    check_level(number, len(grid.levels))
    if layer == DISAGREEMENTS and findings is not None:
        panel = _show_disagreements(grid, number, findings)
    elif layer == DISAGREEMENTS:
        raise QueryError(f"the layer {layer} shows the findings of a verification: pass findings")
    elif layer not in LAYERS:
        raise QueryError(f"expected one of {', '.join(LAYERS)} as layer, got {layer!r}")
    else:
        panel = LAYERS[layer](grid, number)
    if len(grid.levels) == 1:
        return panel
    return panel._replace(title=f"{grid.level_names[number]}: {panel.title}")


def _show_occupancy(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    area = np.count_nonzero(level.free) * level.lattice.cell_size**2
    title = f"occupancy, {area:.1f} m\N{SUPERSCRIPT TWO} free"
    rgb, legend = _occupancy(level)
    return Panel(title, rgb, legend=legend, doors=find_door_lines(grid, number))


def _show_floor(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    rgb = np.full((*level.shape, 3), rgb_of(NO_FLOOR), dtype=np.uint8)
    metres = level.floor_height * np.float32(level.unit)
    scale = height_scale(metres[np.isfinite(metres)], "z [m]")
    legend = (("no floor", NO_FLOOR),) if np.isnan(metres).any() else ()
    step = max(RELIEF, RELIEF_SLOPE * level.lattice.cell_size)
    title = "floor height [m]"
    if len(scale.ticks) == 1:
        title = f"{title}: {scale.ticks[0].text}"
    return Panel(title, rgb, metres, scale, legend, relief=step)


def _show_clearance(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    stored = level.attributes.get("clearance")
    metres = clearance(level) if stored is None else stored * level.unit
    return _show_free(level, metres, "clearance [m]", "to the nearest obstacle [m]")


def _show_weights(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    return _show_free(level, level.weights, "weights", "cost of a cell", dark_high=True)


def _show_free(
    level: SceneGrid2D,
    values: NDArray[np.floating],
    title: str,
    label: str,
    *,
    dark_high: bool = False,
) -> Panel:
    """Show values where an agent can stand, and what is there elsewhere."""
    shown = np.where(level.free, values, np.nan).astype(np.float32)
    scale = linear_scale(shown[np.isfinite(shown)], label, dark_high=dark_high)
    if len(scale.ticks) == 1:  # nothing to tell apart, so a number says it
        title = f"{title}: {scale.ticks[0].text}"
    rgb, legend = _occupancy(level)
    return Panel(title, rgb, shown, scale, legend[1:])


def _show_islands(grid: NavGrid, number: int) -> Panel:
    islands = islands_of(grid)
    level, island = grid.levels[number], islands[number]
    count = max(int(each.max(initial=0)) for each in islands)
    reach = math.ceil(WALL / level.lattice.cell_size)
    # an island may span several levels, and has one colour on all of them
    pairs = set().union(*(find_neighbours(each, reach) for each in islands))
    palette = np.array([rgb_of(color) for color in ROOMS], dtype=np.uint8)
    rgb, legend = _occupancy(level)
    rgb[level.free] = palette[choose_colors(count, pairs, len(palette))[island[level.free]]]
    return Panel("islands", rgb, legend=legend[1:])


def _show_rooms(grid: NavGrid, number: int) -> Panel:
    cells, index = RoomCells.of(grid, number), grid.levels[number].room_index
    entries = {
        ("no room", OCCUPIED): ((index == 0) & ~cells.free & ~np.isnan(cells.floor)).any(),
        ("no floor", NO_FLOOR): np.isnan(cells.floor).any(),
        ("free, no room", FREE): ((index == 0) & cells.free).any(),
        ("darker: occupied", DARKER): ((index > 0) & ~cells.free).any(),
        ("door", DOOR): cells.door.any(),
        ("doorway", DOORWAY): (cells.doorway & ~cells.door).any(),
    }
    legend = tuple(entry for entry, is_there in entries.items() if is_there)
    labels, doors = _label_rooms(grid, number), find_door_lines(grid, number)
    return Panel("rooms", cells.paint(), legend=legend, labels=labels, doors=doors)


def _show_doors(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    rgb, legend = _occupancy(level)
    rgb[doorway_cells(grid, number, blocked=False)] = rgb_of(DOORWAY)
    rgb[doorway_cells(grid, number, blocked=True)] = rgb_of(DOOR)
    legend = (("door", DOOR), ("doorway", DOORWAY), *legend)
    lines = find_door_lines(grid, number)
    widths = [f"{line.width:.1f} m" for line in lines]
    labels = tuple(
        Label(f"{line.id} {width}", width, *line.middle, 0.0, 0.0, place)
        for place, (line, width) in enumerate(zip(lines, widths, strict=True), 1)
    )
    return Panel("doors", rgb, legend=legend, labels=labels, doors=lines)


def _show_links(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    rgb, legend = _occupancy(level)
    links = grid.link_array
    ends = np.concatenate([links, links[:, [2, 3, 0, 1]]])
    ends = ends[ends[:, 0] == number]
    rows, cols = np.divmod(ends[:, 1], level.width)
    for color, leads in (
        (ACROSS, ends[:, 2] == number),
        (UP, ends[:, 2] > number),
        (DOWN, ends[:, 2] < number),
    ):
        rgb[rows[leads], cols[leads]] = rgb_of(color)
    ways = (("leads up", UP), ("leads down", DOWN), ("steep, same level", ACROSS))
    return Panel("links", rgb, legend=(*ways, *legend))


def _show_disagreements(grid: NavGrid, number: int, findings: Sequence[Finding]) -> Panel:
    """Show the cells where a verification found that grid and scene disagree, by kind."""
    level = grid.levels[number]
    rgb, legend = _occupancy(level)
    kinds = color_kinds(finding.kind for finding in findings)
    here = [finding for finding in findings if finding.level == number]
    for finding in here:
        row, col = finding.cell or level.lattice.rows_cols(finding.position)
        if 0 <= row < level.height and 0 <= col < level.width:
            rgb[row, col] = rgb_of(kinds[finding.kind])
    title = f"{len(here)} disagreement{'' if len(here) == 1 else 's'}"
    return Panel(title, rgb, legend=(*kinds.items(), *legend))


def color_kinds(kinds: Iterable[str]) -> dict[str, str]:
    """A colour for each kind of mark."""
    return {kind: MARKS[n % len(MARKS)] for n, kind in enumerate(sorted(set(kinds)))}


LAYERS: dict[str, Callable[[NavGrid, int], Panel]] = {
    "occupancy": _show_occupancy,
    "floor": _show_floor,
    "rooms": _show_rooms,
    "doors": _show_doors,
    "clearance": _show_clearance,
    "island": _show_islands,
    "weights": _show_weights,
    "links": _show_links,
}
"""How each layer of a level is shown, by the layer's name."""


def _occupancy(level: SceneGrid2D) -> tuple[NDArray[np.uint8], Legend]:
    """Colours of cells, shape (height, width, 3), and what they mean; free stands first, always."""
    kind = np.where(level.free, 0, np.where(np.isnan(level.floor_height), 2, 1))
    there = np.bincount(kind.ravel(), minlength=len(OCCUPANCY)) > 0
    legend = [entry for n, entry in enumerate(OCCUPANCY.items()) if n == 0 or there[n]]
    return PALETTE[kind], tuple(legend)


class RoomCells(NamedTuple):
    """What the colour of a cell in a picture of rooms follows from; arrays (height, width)."""

    colors: NDArray[np.uint8]  # shape (2 n + 3, 3): see `paint`
    room_index: NDArray[np.uint16]
    free: Bool
    floor: NDArray[np.float32]  # NaN for none
    doorway: Bool  # where a closed door would stand
    door: Bool  # where one stands now

    @classmethod
    def of(cls, grid: NavGrid, number: int) -> RoomCells:
        """The cells of one level."""
        level = grid.levels[number]
        rooms = color_rooms(grid, number)
        colors = np.stack([darkened(rooms), rooms], axis=1).reshape(-1, 3)
        colors[:2] = rgb_of(OCCUPIED), rgb_of(FREE)
        more = [rgb_of(color) for color in (NO_FLOOR, DOORWAY, DOOR)]
        return cls(
            np.concatenate([colors, more]).astype(np.uint8),
            level.room_index,
            level.free,
            level.floor_height,
            doorway_cells(grid, number, blocked=False),
            doorway_cells(grid, number, blocked=True),
        )

    def paint(self, rows: slice = slice(None)) -> NDArray[np.uint8]:
        """Colours of some rows, shape (number of rows, width, 3).

        A room has two colours, for occupied and for free cells; the last three are no floor, a
        doorway, and a door in the way.
        """
        code = self.room_index[rows] * np.intp(2) + self.free[rows]
        code[np.isnan(self.floor[rows])] = len(self.colors) - 3
        code[self.doorway[rows]] = len(self.colors) - 2
        code[self.door[rows]] = len(self.colors) - 1
        painted: NDArray[np.uint8] = self.colors.take(code, axis=0)
        return painted


def _label_rooms(grid: NavGrid, number: int) -> tuple[Label, ...]:
    """The names of a level's rooms, each where the largest disc fits into the room."""
    # Imported here, as scipy takes longer to load than most pictures to draw.
    from scipy.ndimage import find_objects

    level = grid.levels[number]
    boxes = find_objects(level.room_index.astype(np.int32))
    labels = []
    for room in grid.rooms:
        if room.level == number and room.index <= len(boxes) and boxes[room.index - 1]:
            box = boxes[room.index - 1]
            labels.append(_place_name(level, level.room_index[box] == room.index, box, room))
    return tuple(labels)


def _place_name(level: SceneGrid2D, mask: Bool, box: tuple[slice, slice], room: Room) -> Label:
    """Put a room's name into the middle of the runs of its cells through the disc's centre."""
    from scipy.ndimage import distance_transform_edt  # as above

    stride = max(1, -(-max(mask.shape) // MAX_SIDE))
    mask = mask[::stride, ::stride]
    space = distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    row, col = np.unravel_index(int(np.argmax(space)), space.shape)
    first, last = _run(mask[row], int(col))
    top, bottom = _run(mask[:, (first + last) // 2], int(row))
    middle = box[0].start + row * stride, box[1].start + (first + last) / 2 * stride
    x, y = level.lattice.positions(*middle)
    edge = level.lattice.cell_size * stride
    half = min(int(row) - top, bottom - int(row))  # the name's middle is in this row
    size = (last - first + 1) * edge, (2 * half + 1) * edge
    fallback = f"{room.level}:{room.index}"
    return Label(room.name or fallback, fallback, float(x), float(y), *size, room.index)


def _run(line: Bool, at: int) -> tuple[int, int]:
    """The first and the last of the true values in a row that hold a place."""
    others = np.flatnonzero(~np.pad(line, 1)) - 1
    after = int(np.searchsorted(others, at))
    return int(others[after - 1]) + 1, int(others[after]) - 1
