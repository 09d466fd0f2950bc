"""What a picture shows of each level: a colour or a value for every cell, names and doors.

Values are coloured by viridis, by Nathaniel Smith and Stéfan van der Walt (CC0), without its dark
end, which would look occupied. It gets lighter all the way, for grey and for the colour-blind.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError, count_of
from navbake.navgrid import colors
from navbake.navgrid.cells import check_level
from navbake.navgrid.door_states import DoorLine, doorway_cells, find_door_lines
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance, islands_of
from navbake.views.describe import Connection, describe_area, find_connections

if TYPE_CHECKING:
    from navbake.verifier.report import Finding

RELIEF = 0.04  # a step that is lit or shaded well [m]
RELIEF_SLOPE = 0.3  # or one of a cell, at this slope, so that large cells of hills aren't all dark
# most that relief mixes white or black into a colour
LIT = 0.3
SHADED = 0.35
MAX_SIDE = 400  # cells of a room that are looked at for a name's place, along its longer side
OCCUPANCY = {"free": colors.FREE, "occupied": colors.OCCUPIED, "no floor": colors.NO_FLOOR}
DISAGREEMENTS = "disagreements"  # the layer that shows what a verification found

# From 0.22 to 1, at places whose colours look equally far apart to people who see no red, no green,
# or both
VIRIDIS = ["#3e4989", "#31678e", "#287d8e", "#218e8d", "#1e9c89", "#24ab82", "#39b976", "#5bc863"]
VIRIDIS += ["#8ed644", "#fde725"]
SHADES = 1024  # colours that a scale is rounded to
MIN_RANGE = 0.1  # least span of a scale, so that flat floors look flat
HEIGHT_STEP = 0.01  # heights nearer than this are one [m]
MIN_LENGTH = 5.0  # of a scale of heights, in steps that lie beside each other
MAX_HEIGHTS = 1 << 16  # steps that a range of heights is split into at most
MAX_TICKS = 6
TICK_GAP = 0.11  # least distance of two ticks, of the scale's length

Legend = tuple[tuple[str, str], ...]
"""Meanings and their colours."""


class Tick(NamedTuple):
    """A value beside the bar of a scale."""

    position: float  # along the bar, 0 to 1
    text: str


class ColorScale(NamedTuple):
    """Which colour stands for which value, on a bar from 0, the lowest value, to 1, the highest."""

    label: str  # what the values are, with their unit
    values: Sequence[float]  # ascending; other values lie between them on straight lines
    positions: Sequence[float]  # ascending, 0 to 1, of each of them
    ticks: tuple[Tick, ...]
    colors: Sequence[str] = VIRIDIS  # at equal distances

    def bar(self, count: int) -> NDArray[np.uint8]:
        """Colours at equal distances along the bar, lowest value first, shape (count, 3)."""
        where = np.linspace(0.0, len(self.colors) - 1, count)
        rgb = np.array([colors.rgb_of(color) for color in self.colors], dtype=np.float64)
        mixed = [np.interp(where, np.arange(len(rgb)), channel) for channel in rgb.T]
        return np.round(np.stack(mixed, axis=1)).astype(np.uint8)

    def color(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """The colours of finite values of any shape, shape (…, 3); those beyond it are clipped."""
        place = np.interp(values, self.values, self.positions)
        shade = np.round(place * (SHADES - 1)).astype(np.intp)
        painted: NDArray[np.uint8] = self.bar(SHADES).take(shade, axis=0)
        return painted


class Label(NamedTuple):
    """A name on a picture."""

    text: str
    fallback: str  # written in its place if no font has its letters
    x: float  # of its middle, world frame [m]
    y: float
    width: float  # of what it names at this place [m]; 0 for a point
    height: float
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
    connections: tuple[Connection, ...] = ()  # links and stairs that are drawn, of all levels
    relief: float = 0.0  # a step of values that gets 3/4 of the most light or shade; 0: no relief


def make_panel(
    grid: NavGrid, layer: str, number: int, *, findings: Sequence[Finding] | None = None
) -> Panel:
    """Show one of `LAYERS` of a level, 0 is the lowest; `paint` turns it into colours.

    `DISAGREEMENTS` is a layer, too, if there are findings of a verification. Another layer or
    level is a QueryError.
    """
    check_level(number, len(grid.levels))
    if layer == DISAGREEMENTS:
        if findings is None:
            raise QueryError(f"the layer {layer} shows what a verification found: pass findings")
        panel = _show_disagreements(grid, number, findings)
    elif layer not in LAYERS:
        raise QueryError(f"expected one of {', '.join(LAYERS)} as layer, got {layer!r}")
    else:
        panel = LAYERS[layer](grid, number)
    title = panel.title
    if panel.scale is not None and len(panel.scale.ticks) == 1:
        title = f"{title}: {panel.scale.ticks[0].text}"
    if len(grid.levels) > 1:
        title = f"{grid.level_names[number]}: {title}"
    return panel._replace(title=title)


def paint(panel: Panel) -> NDArray[np.uint8]:
    """The colour of each cell, shape (height, width, 3), row 0 at the largest y."""
    if panel.values is None or panel.scale is None:
        return panel.rgb
    shown = np.isfinite(panel.values)
    painted = panel.scale.color(panel.values[shown])
    if panel.relief:
        lit = relief_shading(panel.values, panel.relief)[shown][:, None]
        share = np.where(lit > 0, lit * LIT, -lit * SHADED)
        painted = np.round(painted * (1 - share) + (lit > 0) * 255 * share).astype(np.uint8)
    rgb = panel.rgb.copy()
    rgb[shown] = painted
    return rgb


def relief_shading(heights: NDArray[Any], step: float) -> NDArray[np.float32]:
    """Relief shading of floors, from -1, in shade, to 1, lit: shape (height, width).

    The light comes from the upper left, as on maps. A cell that is higher than its neighbours
    above and to the left is lit, a lower one lies in shade, by 3/4 at a difference of `step`;
    neighbours without a floor don't count.
    """
    finite = np.where(np.isfinite(heights), heights, np.nan)
    beside = np.float32(np.nan)
    rises = [np.nan_to_num(np.diff(finite, axis=axis, prepend=beside)) for axis in (0, 1)]
    lit: NDArray[np.float32] = np.tanh((rises[0] + rises[1]) / np.float32(step))
    return lit


# --- scales of values -----------------------------------------------------------------------------


def linear_scale(values: NDArray[Any], label: str, *, dark_high: bool = False) -> ColorScale:
    """A scale of finite values, shape (n,); its ticks are round numbers, or the only value.

    The largest is the lightest, or the darkest if `dark_high`.
    """
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, MIN_RANGE)
    ticks = [(low, f"{low:g}")]
    if high > low:
        step = nice_step((high - low) / MAX_TICKS)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        first = math.ceil(low / step - 1e-9)
        last = math.floor(high / step + 1e-9)
        ticks = [(n * step, f"{n * step + 0.0:.{digits}f}") for n in range(first, last + 1)]
    widen = max(0.0, MIN_RANGE - (high - low)) / 2
    low, high = (low, high + 2 * widen) if dark_high else (low - widen, high + widen)
    placed = tuple(Tick((value - low) / (high - low), text) for value, text in ticks)
    return ColorScale(label, (low, high), (0.0, 1.0), placed, VIRIDIS[:: -1 if dark_high else 1])


def nice_step(least: float) -> float:
    """Smallest of 1, 2 or 5 times a power of ten that is at least `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next((n * power for n in (1, 2, 5) if n * power >= least * (1 - 1e-9)), 10 * power)


def height_scale(heights: NDArray[Any], label: str) -> ColorScale:
    """A scale that tells floors 2 cm apart and 3 m apart in one picture.

    Finite heights, shape (n,) [m], are rounded to centimetres. Gaps without floors shrink to their
    cube root: 3 m take 5 times as much of it as 2 cm, not 150 times. Ticks are at the height of the
    largest area, at the ends, then at the next largest areas.
    """
    if not heights.size:
        return linear_scale(heights, label)
    low = float(heights.min())
    high = float(heights.max())
    step = max(HEIGHT_STEP, (high - low) / MAX_HEIGHTS)
    counts = np.bincount(np.round((heights - low) / step).astype(np.int64))
    steps = np.flatnonzero(counts)
    length = np.concatenate([[0.0], np.cumsum(np.cbrt(np.diff(steps)))])
    # flat floors look flat: a few centimetres are a part of the scale, not all of it
    spread = max(float(length[-1]), MIN_LENGTH)
    positions = 0.5 + (length - length[-1] / 2) / spread
    values = low + steps * step
    order = np.argsort(-counts[steps], kind="stable").tolist()
    ticks: list[Tick] = []
    for number in [order[0], 0, len(steps) - 1, *order]:
        place = float(positions[number])
        if all(abs(place - other.position) >= TICK_GAP for other in ticks[:MAX_TICKS]):
            ticks.append(Tick(place, f"{values[number] + 0.0:.2f}"))
    if positions[0] > 0:
        positions = np.concatenate([[0.0], positions, [1.0]])
        values = np.concatenate([[low - step], values, [values[-1] + step]])
    chosen = tuple(sorted(ticks[:MAX_TICKS]))
    return ColorScale(label, values.tolist(), positions.tolist(), chosen)


# --- the layers -----------------------------------------------------------------------------------


def _occupancy(level: SceneGrid2D) -> tuple[NDArray[np.uint8], Legend]:
    """Colours of cells, shape (height, width, 3), and what they mean; free stands first, always."""
    kind = np.where(level.free, 0, np.where(np.isnan(level.floor_height), 2, 1)).astype(np.uint8)
    there = np.bincount(kind.ravel(), minlength=len(OCCUPANCY)) > 0
    legend = [entry for n, entry in enumerate(OCCUPANCY.items()) if n == 0 or there[n]]
    palette = np.array([colors.rgb_of(color) for color in OCCUPANCY.values()], dtype=np.uint8)
    return palette[kind], tuple(legend)


def _show_occupancy(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    area = np.count_nonzero(level.free) * level.lattice.cell_size**2
    rgb, legend = _occupancy(level)
    lines = find_door_lines(grid, number)
    return Panel(f"occupancy, {area:.1f} m² free", rgb, legend=legend, doors=lines)


def _show_floor(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    rgb = np.full((*level.shape, 3), colors.rgb_of(colors.NO_FLOOR), dtype=np.uint8)
    metres = level.floor_height * np.float32(level.unit)
    scale = height_scale(metres[np.isfinite(metres)], "z [m]")
    legend = (("no floor", colors.NO_FLOOR),) if np.isnan(metres).any() else ()
    step = max(RELIEF, RELIEF_SLOPE * level.lattice.cell_size)
    return Panel("floor height [m]", rgb, metres, scale, legend, relief=step)


def _show_clearance(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    stored = level.attributes.get("clearance")
    values = clearance(level) if stored is None else stored * level.unit
    values = np.where(level.free, values, np.nan).astype(np.float32)
    scale = linear_scale(values[np.isfinite(values)], "to the nearest obstacle [m]")
    rgb, legend = _occupancy(level)
    return Panel("clearance [m]", rgb, values, scale, legend[1:])


def _show_weights(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    values = np.where(level.free, level.weights, np.nan).astype(np.float32)
    scale = linear_scale(values[np.isfinite(values)], "cost of a cell", dark_high=True)
    values[level.weights == 1] = np.nan  # the usual cost looks like free floor
    rgb, legend = _occupancy(level)
    return Panel("weights", rgb, values, scale, (("cost 1", colors.FREE), *legend[1:]))


def _show_islands(grid: NavGrid, number: int) -> Panel:
    islands = islands_of(grid)
    level = grid.levels[number]
    count = max(int(each.max(initial=0)) for each in islands)
    reach = math.ceil(colors.WALL / level.lattice.cell_size)
    # an island may span several levels, and has one colour on all of them
    pairs = set().union(*(colors.find_neighbours(each, reach) for each in islands))
    palette = np.array([colors.rgb_of(color) for color in colors.ROOMS], dtype=np.uint8)
    color = colors.choose_colors(count, pairs, len(palette))[islands[number][level.free]]
    rgb, legend = _occupancy(level)
    rgb[level.free] = palette[color]
    return Panel("islands", rgb, legend=legend[1:])


def paint_rooms(grid: NavGrid, number: int) -> NDArray[np.uint8]:
    """Colours of cells by room, darker where occupied, and of doors, shape (height, width, 3)."""
    level = grid.levels[number]
    rooms = colors.color_rooms(grid, number)
    palette = np.stack([colors.darken_rooms(rooms), rooms], axis=1).reshape(-1, 3)
    palette[:2] = colors.rgb_of(colors.OCCUPIED), colors.rgb_of(colors.FREE)
    rgb = palette.take(level.room_index.astype(np.uint32) * 2 + level.free, axis=0)
    rgb[np.isnan(level.floor_height)] = colors.rgb_of(colors.NO_FLOOR)
    _paint_doors(rgb, grid, number)
    return rgb


def _paint_doors(rgb: NDArray[np.uint8], grid: NavGrid, number: int) -> None:
    for color, blocked in ((colors.DOORWAY, False), (colors.DOOR, True)):
        rgb[doorway_cells(grid, number, blocked=blocked)] = colors.rgb_of(color)


def _show_rooms(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    index = level.room_index
    free = level.free
    no_floor = np.isnan(level.floor_height)
    doors = doorway_cells(grid, number, blocked=True)
    doorways = doorway_cells(grid, number, blocked=False)
    outdoors = [r.index for r in grid.rooms if r.level == number and r.outdoors]
    entries = {
        ("outdoors", colors.OUTDOORS): np.isin(index, outdoors),
        ("occupied, no room", colors.OCCUPIED): (index == 0) & ~free & ~no_floor,
        ("no floor", colors.NO_FLOOR): no_floor,
        ("free, no room", colors.FREE): (index == 0) & free,
        ("greyer: occupied in a room", colors.DARKER): (index > 0) & ~free,
        ("door", colors.DOOR): doors,
        ("doorway", colors.DOORWAY): doorways & ~doors,
    }
    legend = tuple(entry for entry, cells in entries.items() if cells.any())
    names = [(r.index, r.name, f"{number}:{r.index}") for r in grid.rooms if r.level == number]
    labels = _label_parts(level, index, names)
    lines = find_door_lines(grid, number)
    return Panel("rooms", paint_rooms(grid, number), legend=legend, labels=labels, doors=lines)


def _label_parts(
    level: SceneGrid2D, index: NDArray[Any], names: Iterable[tuple[int, str | None, str]]
) -> tuple[Label, ...]:
    """Names of a level's parts, each in the middle of the runs of cells through its largest disc.

    Each has a number in `index`, a name or None, and what is written where it has no name.
    """
    from scipy import ndimage  # takes longer to load than most pictures to draw

    def ends_of_run(line: NDArray[np.bool_], at: int) -> list[int]:
        """The first and the last of the true values in a row round one of them."""
        part = ndimage.label(line)[0]
        ends: list[int] = np.flatnonzero(part == part[at])[[0, -1]].tolist()
        return ends

    labels = []
    boxes = dict(enumerate(ndimage.find_objects(index.astype(np.int32)), 1))
    for which, name, fallback in names:
        box = boxes.get(which)
        if box is None:
            continue
        mask = index[box] == which
        stride = max(1, -(-max(mask.shape) // MAX_SIDE))
        mask = mask[::stride, ::stride]
        edge = level.lattice.cell_size * stride
        space = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
        row, col = (int(v) for v in np.unravel_index(np.argmax(space), space.shape))
        first, last = ends_of_run(mask[row], col)
        top, bottom = ends_of_run(mask[:, (first + last) // 2], row)
        across = box[1].start + (first + last) / 2 * stride
        x, y = level.lattice.positions(box[0].start + row * stride, across).tolist()
        half = min(row - top, bottom - row)  # the name's middle is in this row
        size = (last - first + 1) * edge, (2 * half + 1) * edge
        labels.append(Label(name or fallback, fallback, x, y, *size, which))
    return tuple(labels)


def _show_doors(grid: NavGrid, number: int) -> Panel:
    rgb, legend = _occupancy(grid.levels[number])
    legend = (("door", colors.DOOR), ("doorway", colors.DOORWAY), *legend)
    lines = find_door_lines(grid, number)
    labels = []
    for place, line in enumerate(lines, 1):
        width = f"{line.width:.1f} m"
        labels.append(Label(f"{line.id} {width}", width, *line.middle, 0.0, 0.0, place))
    _paint_doors(rgb, grid, number)
    return Panel("doors", rgb, legend=legend, labels=tuple(labels), doors=lines)


def _show_links(grid: NavGrid, number: int) -> Panel:
    rgb, legend = _occupancy(grid.levels[number])
    ends = np.concatenate([grid.step_array, grid.step_array[:, [2, 3, 0, 1]]])
    ends = ends[ends[:, 0] == number]
    colored = {"leads up": colors.UP, "leads down": colors.DOWN, "steep, same level": colors.ACROSS}
    for color, sign in zip(colored.values(), (1, -1, 0), strict=True):
        cells = ends[np.sign(ends[:, 2] - number) == sign, 1]
        rgb.reshape(-1, 3)[cells] = colors.rgb_of(color)
    ways = find_connections(grid)
    labels = []
    for place, way in enumerate(ways, 1):
        here = [(x, y) for level, x, y, _ in way.stops if level == number]
        labels += [Label(way.label(), str(place), *at, 0.0, 0.0, place) for at in here[:1]]
    drawn = (*colored.items(), *legend)
    drawn = (("link", colors.LINK), *drawn) if grid.links else drawn
    return Panel("links", rgb, legend=drawn, labels=tuple(labels), connections=tuple(ways))


def _show_areas(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    index = grid.levels[number].area_index
    names = []
    rgb, legend = _occupancy(level)
    entries = []
    for place, area in enumerate(grid.areas, 1):
        color = colors.ROOMS[place % len(colors.ROOMS)]
        color = colors.KEEP_OUT if math.isinf(area.cost) else color
        here = index == place
        tint = np.array(colors.rgb_of(color), dtype=np.uint8)
        rgb[here & level.free] = tint
        rgb[here & ~level.free] = colors.darken_rooms(tint)
        entries += [(describe_area(area), color)] if here.any() else []
        names.append((place, area.name, str(place)))
    return Panel("areas", rgb, legend=(*entries, *legend), labels=_label_parts(level, index, names))


def _show_disagreements(grid: NavGrid, number: int, findings: Sequence[Finding]) -> Panel:
    """Show the cells where a verification found that grid and scene disagree, by kind."""
    level = grid.levels[number]
    rgb, legend = _occupancy(level)
    kinds = colors_of_kinds(finding.kind for finding in findings)
    here = [finding for finding in findings if finding.level == number]
    for finding in here:
        row, col = finding.cell or level.lattice.rows_cols(finding.position)
        if 0 <= row < level.height and 0 <= col < level.width:
            rgb[row, col] = colors.rgb_of(kinds[finding.kind])
    return Panel(count_of(len(here), "disagreement"), rgb, legend=(*kinds.items(), *legend))


def colors_of_kinds(kinds: Iterable[str]) -> dict[str, str]:
    """A colour for each kind of mark."""
    return {kind: colors.MARKS[n % len(colors.MARKS)] for n, kind in enumerate(sorted(set(kinds)))}


LAYERS: dict[str, Callable[[NavGrid, int], Panel]] = {
    "occupancy": _show_occupancy,
    "floor": _show_floor,
    "rooms": _show_rooms,
    "doors": _show_doors,
    "clearance": _show_clearance,
    "island": _show_islands,
    "weights": _show_weights,
    "links": _show_links,
    "area": _show_areas,
}
"""How each layer of a level is shown, by the layer's name."""
