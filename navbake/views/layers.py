"""Makes the layers of a level for pictures: a colour or a value for each cell, names, doors.

Values have the colours of viridis, by Nathaniel Smith and Stéfan van der Walt (CC0), without its
dark end, which would look occupied. Its lightness rises steadily, so that it also works in grey and
for the colour-blind.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError, count_of
from navbake.navgrid import colors
from navbake.navgrid.cells import check_level
from navbake.navgrid.door_states import DoorLine, find_door_lines, mark_door_cells
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import islands_of, measure_clearance
from navbake.views.describe import Connection, describe_area, find_connections

if TYPE_CHECKING:
    from navbake.verifier.report import Finding

# The relief shading of the floor has 3/4 of its full strength where neighbouring cells differ in z
# by RELIEF_STEP [m], or by the slope RELIEF_SLOPE if that is more: else hills of large cells would
# be all dark.
RELIEF_STEP = 0.04
RELIEF_SLOPE = 0.3
# largest shares of white and of black that relief mixes into a colour
MAX_LIGHT = 0.3
MAX_SHADE = 0.35
MAX_SAMPLES = 400  # most cells along a room's longer side that are looked at to place its name
OCCUPANCY_COLORS = {"free": colors.FREE, "occupied": colors.OCCUPIED, "no floor": colors.NO_FLOOR}
DISAGREEMENTS = "disagreements"  # the layer that shows what a verification found

# Colours of viridis from 0.22 to 1, chosen so that neighbours differ equally to all people, also to
# those who see no red or no green
VIRIDIS = [
    "#3e4989", "#31678e", "#287d8e", "#218e8d", "#1e9c89",
    "#24ab82", "#39b976", "#5bc863", "#8ed644", "#fde725",
]  # fmt: skip
SHADES = 1024  # number of different colours of a scale
MIN_RANGE = 0.1  # smallest range of values on a scale, so that flat floors look flat
HEIGHT_STEP = 0.01  # on a scale of heights, z is rounded to multiples of this [m]
MIN_SCALE_LENGTH = 5.0  # smallest length of a scale of heights, in multiples of `HEIGHT_STEP`
MAX_HEIGHTS = 1 << 16  # most steps that a range of heights is split into
MAX_TICKS = 6
TICK_GAP = 0.11  # smallest distance of two ticks, relative to the scale's length

Legend: TypeAlias = tuple[tuple[str, str], ...]
"""Meanings and their colours."""
Reals: TypeAlias = NDArray[np.floating]
"""Values in float32 or float64."""


class Tick(NamedTuple):
    """A value that is written beside the bar of a scale, and its position on the bar."""

    position: float  # along the bar, 0 to 1
    text: str


class ColorScale(NamedTuple):
    """A color scale: a bar of colours on which each value has a position, 0 to 1.

    Attributes:
        label: what the values are, with their unit.
        values: some values, ascending; the positions of values between them are interpolated.
        positions: the position of each of `values` on the bar, 0 to 1, ascending.
        ticks: the values that are written beside the bar.
        colors: the bar's colours at equal distances.
    """

    label: str
    values: Sequence[float]
    positions: Sequence[float]
    ticks: tuple[Tick, ...]
    colors: Sequence[str] = VIRIDIS

    def bar(self, count: int) -> NDArray[np.uint8]:
        """Return `count` colours at equal distances along the bar, lowest value first.

        The shape is (count, 3).
        """
        bar_positions = np.linspace(0.0, len(self.colors) - 1, count)
        rgb_of_colors = np.array([colors.rgb_of(color) for color in self.colors], dtype=np.float64)
        channels = [
            np.interp(bar_positions, np.arange(len(rgb_of_colors)), channel)
            for channel in rgb_of_colors.T
        ]
        return np.round(np.stack(channels, axis=1)).astype(np.uint8)

    def color(self, values: Reals) -> NDArray[np.uint8]:
        """Return the colours of values, shape (…, 3), 0 to 255.

        Args:
            values: finite values, shape (…). Those below or above `self.values` get the colour at
                that end of the bar.
        """
        positions = np.interp(values, self.values, self.positions)
        shades = np.round(positions * (SHADES - 1)).astype(np.intp)
        painted: NDArray[np.uint8] = self.bar(SHADES).take(shades, axis=0)
        return painted


class Label(NamedTuple):
    """A name on a picture.

    Attributes:
        text: the name.
        fallback: the text to write if no font has the letters of the name.
        x: world x of the name's middle [m].
        y: world y of the name's middle [m].
        width: how wide the name may be [m]; 0 for the name of a point.
        height: how high the name may be [m]; 0 for the name of a point.
        number: the number to write where there is no space for the name.
    """

    text: str
    fallback: str
    x: float
    y: float
    width: float
    height: float
    number: int = 0


class Panel(NamedTuple):
    """A layer of a level, ready to be drawn.

    Attributes:
        title: the title of the picture.
        rgb: the colour of each cell, shape (height, width, 3).
        values: a value for each cell, shape (height, width). Cells with a finite value are
            coloured by `scale`, not by `rgb`.
        scale: the color scale of `values`.
        legend: meanings of the colours of `rgb`.
        labels: names on the picture.
        doors: lines across doorways.
        connections: links and stairs to draw, of all levels.
        relief: the difference of values between neighbours at which relief shading has 3/4 of its
            full strength; 0 for no shading.
    """

    title: str
    rgb: NDArray[np.uint8]
    values: NDArray[np.float32] | None = None
    scale: ColorScale | None = None
    legend: Legend = ()
    labels: tuple[Label, ...] = ()
    doors: tuple[DoorLine, ...] = ()
    connections: tuple[Connection, ...] = ()
    relief: float = 0.0


def make_panel(
    grid: NavGrid, layer: str, level_number: int, *, findings: Sequence[Finding] | None = None
) -> Panel:
    """Make the panel of a level's layer; `paint` turns it into colours.

    Args:
        grid: a grid of one or several levels.
        layer: one of `LAYERS`, or `DISAGREEMENTS`.
        level_number: the number of the level, 0 is the lowest.
        findings: the findings of a verification, which `DISAGREEMENTS` needs.

    Raises:
        QueryError: there is no such layer or level, or there are no findings for `DISAGREEMENTS`.
    """
    check_level(level_number, len(grid.levels))
    if layer == DISAGREEMENTS:
        if findings is None:
            raise QueryError(f"the layer {layer} shows what a verification found: pass findings")
        panel = _show_disagreements(grid, level_number, findings)
    elif layer not in LAYERS:
        raise QueryError(f"expected one of {', '.join(LAYERS)} as layer, got {layer!r}")
    else:
        panel = LAYERS[layer](grid, level_number)
    title = panel.title
    if panel.scale is not None and len(panel.scale.ticks) == 1:
        title = f"{title}: {panel.scale.ticks[0].text}"
    if len(grid.levels) > 1:
        title = f"{grid.level_names[level_number]}: {title}"
    return panel._replace(title=title)


def paint(panel: Panel) -> NDArray[np.uint8]:
    """Return the colours of a panel's cells, shape (height, width, 3), row 0 at the largest y."""
    if panel.values is None or panel.scale is None:
        return panel.rgb
    has_value = np.isfinite(panel.values)
    painted = panel.scale.color(panel.values[has_value])
    if panel.relief:
        shading = relief_shading(panel.values, panel.relief)[has_value][:, None]
        mixed_fraction = np.where(shading > 0, shading * MAX_LIGHT, -shading * MAX_SHADE)
        painted = np.round(
            painted * (1 - mixed_fraction) + (shading > 0) * 255 * mixed_fraction
        ).astype(np.uint8)
    rgb = panel.rgb.copy()
    rgb[has_value] = painted
    return rgb


def relief_shading(heights: Reals, full_height_step: float) -> NDArray[np.float32]:
    """Compute the relief shading of floors, -1 (shaded) to 1 (lit), shape (height, width).

    The light comes from the upper left of the map. A cell whose floor is higher than its upper and
    left neighbour is lit; one whose floor is lower lies in shade.

    Args:
        heights: z of each cell's floor [m], shape (height, width); not finite where there is none.
            Neighbours without a floor don't count.
        full_height_step: the difference of z at which the shading has 3/4 of its full strength [m].
    """
    finite_heights = np.where(np.isfinite(heights), heights, np.nan)
    no_height = np.float32(np.nan)
    rise_down = np.nan_to_num(np.diff(finite_heights, axis=0, prepend=no_height))
    rise_right = np.nan_to_num(np.diff(finite_heights, axis=1, prepend=no_height))
    shading: NDArray[np.float32] = np.tanh((rise_down + rise_right) / np.float32(full_height_step))
    return shading


# --- scales of values -----------------------------------------------------------------------------


def linear_scale(values: Reals, label: str, *, dark_high: bool = False) -> ColorScale:
    """Make a linear color scale; its ticks are round numbers, or the value if all are equal.

    Args:
        values: finite values, shape (n,).
        label: what the values are, with their unit.
        dark_high: whether the largest value is the darkest, not the lightest.
    """
    low = float(values.min()) if values.size else 0.0
    high = float(values.max()) if values.size else MIN_RANGE
    ticks = [(low, f"{low:g}")]
    if high > low:
        step = round_up_step((high - low) / MAX_TICKS)
        num_decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        first_multiple = math.ceil(low / step - 1e-9)
        last_multiple = math.floor(high / step + 1e-9)
        ticks = [
            (multiple * step, f"{multiple * step + 0.0:.{num_decimals}f}")
            for multiple in range(first_multiple, last_multiple + 1)
        ]
    margin = max(0.0, MIN_RANGE - (high - low)) / 2
    if dark_high:
        high += 2 * margin
    else:
        low -= margin
        high += margin
    bar_colors = VIRIDIS[::-1] if dark_high else VIRIDIS
    bar_ticks = tuple(Tick((value - low) / (high - low), text) for value, text in ticks)
    return ColorScale(label, (low, high), (0.0, 1.0), bar_ticks, bar_colors)


def round_up_step(minimum: float) -> float:
    """Return the smallest number, at least `minimum`, that is 1, 2 or 5 times a power of ten."""
    power_of_ten = 10.0 ** math.floor(math.log10(minimum))
    return next(
        (
            factor * power_of_ten
            for factor in (1, 2, 5)
            if factor * power_of_ten >= minimum * (1 - 1e-9)
        ),
        10 * power_of_ten,
    )


def height_scale(heights: Reals, label: str) -> ColorScale:
    """Make a scale on which floors 2 cm apart and floors 3 m apart differ visibly.

    Heights are rounded to centimetres. On the bar, the distance of two heights without a floor
    between them is proportional to the cube root of their difference: 3 m are 5 times as long as
    2 cm, not 150 times. Ticks are at the most frequent height, at the ends, then at the next most
    frequent heights.

    Args:
        heights: finite z of floors [m], shape (n,).
        label: what the heights are, with their unit.
    """
    if not heights.size:
        return linear_scale(heights, label)
    low = float(heights.min())
    high = float(heights.max())
    step = max(HEIGHT_STEP, (high - low) / MAX_HEIGHTS)
    num_cells = np.bincount(np.round((heights - low) / step).astype(np.int64))
    height_indices = np.flatnonzero(num_cells)
    bar_distances = np.concatenate([[0.0], np.cumsum(np.cbrt(np.diff(height_indices)))])
    # flat floors look flat: a few centimetres are a part of the scale, not all of it
    scale_length = max(float(bar_distances[-1]), MIN_SCALE_LENGTH)
    positions = 0.5 + (bar_distances - bar_distances[-1] / 2) / scale_length
    values = low + height_indices * step
    indices_by_count = np.argsort(-num_cells[height_indices], kind="stable").tolist()
    ticks: list[Tick] = []
    for index in [indices_by_count[0], 0, len(height_indices) - 1, *indices_by_count]:
        position = float(positions[index])
        if all(abs(position - tick.position) >= TICK_GAP for tick in ticks[:MAX_TICKS]):
            ticks.append(Tick(position, f"{values[index] + 0.0:.2f}"))
    if positions[0] > 0:
        positions = np.concatenate([[0.0], positions, [1.0]])
        values = np.concatenate([[low - step], values, [values[-1] + step]])
    bar_ticks = tuple(sorted(ticks[:MAX_TICKS]))
    return ColorScale(label, values.tolist(), positions.tolist(), bar_ticks)


# --- the layers -----------------------------------------------------------------------------------


def _paint_occupancy(level: SceneGrid2D) -> tuple[NDArray[np.uint8], Legend]:
    """Paint the cells of a level by whether they are free.

    Returns:
        The colour of each cell, shape (height, width, 3); and the legend, whose first entry is that
        of free cells.
    """
    color_index = np.where(level.free, 0, np.where(np.isnan(level.floor_height), 2, 1)).astype(
        np.uint8
    )
    is_in_level = np.bincount(color_index.ravel(), minlength=len(OCCUPANCY_COLORS)) > 0
    legend = [
        entry
        for color_number, entry in enumerate(OCCUPANCY_COLORS.items())
        if color_number == 0 or is_in_level[color_number]
    ]
    palette = np.array(
        [colors.rgb_of(color) for color in OCCUPANCY_COLORS.values()], dtype=np.uint8
    )
    return palette[color_index], tuple(legend)


def _show_occupancy(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    area = np.count_nonzero(level.free) * level.lattice.cell_size**2
    rgb, legend = _paint_occupancy(level)
    lines = find_door_lines(grid, level_number)
    return Panel(f"occupancy, {area:.1f} m² free", rgb, legend=legend, doors=lines)


def _show_floor(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    rgb = np.full((*level.shape, 3), colors.rgb_of(colors.NO_FLOOR), dtype=np.uint8)
    floor_z = level.floor_height * np.float32(level.unit)
    scale = height_scale(floor_z[np.isfinite(floor_z)], "z [m]")
    legend = (("no floor", colors.NO_FLOOR),) if np.isnan(floor_z).any() else ()
    step = max(RELIEF_STEP, RELIEF_SLOPE * level.lattice.cell_size)
    return Panel("floor height [m]", rgb, floor_z, scale, legend, relief=step)


def _show_clearance(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    stored_clearance = level.attributes.get("clearance")
    clearances = (
        measure_clearance(level) if stored_clearance is None else stored_clearance * level.unit
    )
    clearances = np.where(level.free, clearances, np.nan).astype(np.float32)
    scale = linear_scale(clearances[np.isfinite(clearances)], "to the nearest obstacle [m]")
    rgb, legend = _paint_occupancy(level)
    return Panel("clearance [m]", rgb, clearances, scale, legend[1:])


def _show_weights(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    costs = np.where(level.free, level.weights, np.nan).astype(np.float32)
    scale = linear_scale(costs[np.isfinite(costs)], "cost of a cell", dark_high=True)
    costs[level.weights == 1] = np.nan  # cells of cost 1 have the colour of free cells
    rgb, legend = _paint_occupancy(level)
    return Panel("weights", rgb, costs, scale, (("cost 1", colors.FREE), *legend[1:]))


def _show_islands(grid: NavGrid, level_number: int) -> Panel:
    islands = islands_of(grid)
    level = grid.levels[level_number]
    num_islands = max(int(labels.max(initial=0)) for labels in islands)
    max_gap = math.ceil(colors.MAX_NEIGHBOR_GAP / level.lattice.cell_size)  # [cells]
    # an island may span several levels, and has one colour on all of them
    neighbours = set().union(*(colors.find_neighbours(labels, max_gap) for labels in islands))
    palette = np.array([colors.rgb_of(color) for color in colors.ROOMS], dtype=np.uint8)
    color_of_island = colors.choose_colors(num_islands, neighbours, len(palette))
    rgb, legend = _paint_occupancy(level)
    rgb[level.free] = palette[color_of_island[islands[level_number][level.free]]]
    return Panel("islands", rgb, legend=legend[1:])


def paint_rooms(grid: NavGrid, level_number: int) -> NDArray[np.uint8]:
    """Paint the cells of a level in the colours of their rooms, and doors; blocked cells darker.

    Args:
        grid: a grid of one or several levels.
        level_number: the number of the level, 0 is the lowest.

    Returns:
        The colour of each cell, shape (height, width, 3).
    """
    level = grid.levels[level_number]
    rooms = colors.color_rooms(grid, level_number)
    palette = np.stack([colors.darken_rooms(rooms), rooms], axis=1).reshape(-1, 3)
    # cells with the index 0 are in no room
    palette[0] = colors.rgb_of(colors.OCCUPIED)
    palette[1] = colors.rgb_of(colors.FREE)
    rgb = palette.take(level.room_index.astype(np.uint32) * 2 + level.free, axis=0)
    rgb[np.isnan(level.floor_height)] = colors.rgb_of(colors.NO_FLOOR)
    _paint_doors(rgb, grid, level_number)
    return rgb


def _paint_doors(rgb: NDArray[np.uint8], grid: NavGrid, level_number: int) -> None:
    rgb[mark_door_cells(grid, level_number, in_current_state=False)] = colors.rgb_of(colors.DOORWAY)
    rgb[mark_door_cells(grid, level_number, in_current_state=True)] = colors.rgb_of(colors.DOOR)


def _show_rooms(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    room_index = level.room_index
    free = level.free
    no_floor = np.isnan(level.floor_height)
    doors = mark_door_cells(grid, level_number, in_current_state=True)
    doorways = mark_door_cells(grid, level_number, in_current_state=False)
    outdoors = [room.index for room in grid.rooms if room.level == level_number and room.outdoors]
    cells_of_entry = {
        ("outdoors", colors.OUTDOORS): np.isin(room_index, outdoors),
        ("occupied, no room", colors.OCCUPIED): (room_index == 0) & ~free & ~no_floor,
        ("no floor", colors.NO_FLOOR): no_floor,
        ("free, no room", colors.FREE): (room_index == 0) & free,
        ("greyer: occupied in a room", colors.ROOM_LEGEND): (room_index > 0) & ~free,
        ("door", colors.DOOR): doors,
        ("doorway", colors.DOORWAY): doorways & ~doors,
    }
    legend = tuple(entry for entry, cells in cells_of_entry.items() if cells.any())
    names = [
        RegionName(room.index, room.name, f"{level_number}:{room.index}")
        for room in grid.rooms
        if room.level == level_number
    ]
    labels = _label_regions(level, room_index, names)
    lines = find_door_lines(grid, level_number)
    return Panel(
        "rooms", paint_rooms(grid, level_number), legend=legend, labels=labels, doors=lines
    )


class RegionName(NamedTuple):
    """The name of a room or area of a level."""

    number: int  # the index of the room or area, which its cells have
    name: str | None  # None if the room or area has no name
    fallback: str  # the text to write if there is no name


def _label_regions(
    level: SceneGrid2D, region_index: NDArray[np.integer], names: Iterable[RegionName]
) -> tuple[Label, ...]:
    """Place the names of rooms or areas on the map of a level.

    The cell that is farthest from the edge of the room is found. The name stands in the middle of
    the horizontal run of the room's cells through that cell, and may be as wide as the run.

    Args:
        level: the level.
        region_index: the index of each cell's room or area, 0 for none, shape (height, width).
        names: the names to place; those without cells are left out.
    """
    from scipy import ndimage  # takes longer to load than most pictures to draw

    def ends_of_run(is_in_line: NDArray[np.bool_], position: int) -> list[int]:
        """Return the first and the last index of the run of True in a line around a position."""
        run_labels = ndimage.label(is_in_line)[0]
        run_ends: list[int] = np.flatnonzero(run_labels == run_labels[position])[[0, -1]].tolist()
        return run_ends

    labels = []
    slices_of_region = dict(enumerate(ndimage.find_objects(region_index.astype(np.int32)), 1))
    for region in names:
        cell_slices = slices_of_region.get(region.number)
        if cell_slices is None:
            continue
        is_region = region_index[cell_slices] == region.number
        sampling_stride = max(1, -(-max(is_region.shape) // MAX_SAMPLES))
        is_region = is_region[::sampling_stride, ::sampling_stride]
        sample_size = level.lattice.cell_size * sampling_stride
        edge_distance = ndimage.distance_transform_edt(np.pad(is_region, 1))[1:-1, 1:-1]
        row, col = divmod(int(np.argmax(edge_distance)), edge_distance.shape[1])
        first_col, last_col = ends_of_run(is_region[row], col)
        top_row, bottom_row = ends_of_run(is_region[:, (first_col + last_col) // 2], row)
        middle_col = cell_slices[1].start + (first_col + last_col) / 2 * sampling_stride
        x, y = level.lattice.positions(
            cell_slices[0].start + row * sampling_stride, middle_col
        ).tolist()
        half_height = min(row - top_row, bottom_row - row)  # the name's middle is in this row
        label = Label(
            text=region.name or region.fallback,
            fallback=region.fallback,
            x=x,
            y=y,
            width=(last_col - first_col + 1) * sample_size,
            height=(2 * half_height + 1) * sample_size,
            number=region.number,
        )
        labels.append(label)
    return tuple(labels)


def _label_point(text: str, fallback: str, x: float, y: float, number: int) -> Label:
    return Label(text, fallback, x, y, width=0.0, height=0.0, number=number)


def _show_doors(grid: NavGrid, level_number: int) -> Panel:
    rgb, legend = _paint_occupancy(grid.levels[level_number])
    legend = (("door", colors.DOOR), ("doorway", colors.DOORWAY), *legend)
    lines = find_door_lines(grid, level_number)
    labels = []
    for door_number, line in enumerate(lines, 1):
        width = f"{line.width:.1f} m"
        x, y = line.middle
        labels.append(_label_point(f"{line.id} {width}", width, x, y, door_number))
    _paint_doors(rgb, grid, level_number)
    return Panel("doors", rgb, legend=legend, labels=tuple(labels), doors=lines)


def _show_links(grid: NavGrid, level_number: int) -> Panel:
    rgb, legend = _paint_occupancy(grid.levels[level_number])
    # each step in both directions: level and cell of its start, level and cell of its end
    steps = np.concatenate([grid.step_array, grid.step_array[:, [2, 3, 0, 1]]])
    steps = steps[steps[:, 0] == level_number]
    direction = np.sign(steps[:, 2] - level_number)
    step_colors = (
        ("leads up", colors.LINK_UP, 1),
        ("leads down", colors.LINK_DOWN, -1),
        ("steep, same level", colors.LINK_ACROSS, 0),
    )
    for _, color, sign in step_colors:
        cells = steps[direction == sign, 1]
        rgb.reshape(-1, 3)[cells] = colors.rgb_of(color)
    legend = (*((meaning, color) for meaning, color, _ in step_colors), *legend)
    if grid.links:
        legend = (("link", colors.LINK), *legend)
    connections = find_connections(grid)
    labels = []
    for connection_number, connection in enumerate(connections, 1):
        stop = next((stop for stop in connection.stops if stop.level == level_number), None)
        if stop is not None:
            labels.append(
                _label_point(
                    connection.label(), str(connection_number), stop.x, stop.y, connection_number
                )
            )
    return Panel("links", rgb, legend=legend, labels=tuple(labels), connections=tuple(connections))


def _show_areas(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    names = []
    rgb, legend = _paint_occupancy(level)
    area_entries = []
    for area_number, area in enumerate(grid.areas, 1):
        color = colors.ROOMS[area_number % len(colors.ROOMS)]
        if math.isinf(area.cost):
            color = colors.KEEP_OUT
        in_area = level.area_index == area_number
        area_rgb = np.array(colors.rgb_of(color), dtype=np.uint8)
        rgb[in_area & level.free] = area_rgb
        rgb[in_area & ~level.free] = colors.darken_rooms(area_rgb)
        if in_area.any():
            area_entries.append((describe_area(area), color))
        names.append(RegionName(area_number, area.name, str(area_number)))
    labels = _label_regions(level, level.area_index, names)
    return Panel("areas", rgb, legend=(*area_entries, *legend), labels=labels)


def _show_disagreements(grid: NavGrid, level_number: int, findings: Sequence[Finding]) -> Panel:
    """Make the panel of the cells where grid and scene disagree, coloured by kind of finding."""
    level = grid.levels[level_number]
    rgb, legend = _paint_occupancy(level)
    color_of_kind = choose_kind_colors(finding.kind for finding in findings)
    level_findings = [finding for finding in findings if finding.level == level_number]
    for finding in level_findings:
        row, col = finding.cell or level.lattice.rows_cols(finding.position)
        if 0 <= row < level.height and 0 <= col < level.width:
            rgb[row, col] = colors.rgb_of(color_of_kind[finding.kind])
    title = count_of(len(level_findings), "disagreement")
    return Panel(title, rgb, legend=(*color_of_kind.items(), *legend))


def choose_kind_colors(kinds: Iterable[str]) -> dict[str, str]:
    """Choose a colour for each kind of mark; if there are many kinds, some share a colour.

    Args:
        kinds: the kinds of the marks in a picture, in any order, also repeated.

    Returns:
        Kind -> its colour.
    """
    return {
        kind: colors.MARKS[index % len(colors.MARKS)]
        for index, kind in enumerate(sorted(set(kinds)))
    }


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
"""Name of a layer -> the function that makes its panel for a level."""
