"""Makes the layers of a level for pictures: a colour or a value for each cell, names, doors.

Values have the colours of viridis, by Nathaniel Smith and Stéfan van der Walt (CC0), without its
dark end, which would look occupied. Its lightness rises steadily, so that it also works in grey and
for the colour-blind.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError, count_of
from navbake.lengths import format_length
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
MAX_WHITE_SHARE = 0.3
MAX_BLACK_SHARE = 0.35
# most cells along a room's longer side that are looked at to place its name
MAX_SAMPLED_CELLS = 400
MAX_NUMBERED_ISLANDS = 200  # on a level; the largest
# how a layer is drawn on the floors of a scene
LAYER_LIFT = 0.012  # height of the drawn grid over the floor, so that the floor doesn't hide it [m]
FLAT_TOLERANCE = 0.01  # how far a drawn layer may be off the floor [m]
MAX_RISE = 1.0  # steepest slope of a rectangle: its rise, divided by its length
OCCUPANCY_COLORS = {
    "free": colors.FREE,
    "occupied": colors.OCCUPIED,
    "no floor": colors.NO_FLOOR,
    "closed by inflation": colors.CLOSED,
}
LEAF_TEXT = "door leaf"  # legend: where a door blocks the way
DOORWAY_TEXT = "doorway"  # legend: where a door would block the way if it were closed
DISAGREEMENTS = "disagreements"  # the layer that shows what a verification found

# Colours of viridis from 0.22 to 1, chosen so that neighbours differ equally to all people, also to
# those who see no red or no green
VIRIDIS = [
    "#3e4989", "#31678e", "#287d8e", "#218e8d", "#1e9c89",
    "#24ab82", "#39b976", "#5bc863", "#8ed644", "#fde725",
]  # fmt: skip
NUM_SHADES = 1024  # number of different colours of a scale
MIN_VALUE_RANGE = 0.1  # smallest range of values on a scale, so that flat floors look flat
HEIGHT_STEP = 0.01  # on a scale of heights, z is rounded to multiples of this [m]
MIN_SCALE_LENGTH = 5.0  # smallest length of a scale of heights, in multiples of `HEIGHT_STEP`
MAX_HEIGHT_STEPS = 1 << 16  # most steps that a range of heights is split into
MAX_TICKS = 6
MIN_TICK_GAP = 0.11  # smallest distance of two ticks, relative to the scale's length

Legend: TypeAlias = tuple[tuple[str, str], ...]
"""Meanings and their colours."""
Rectangle: TypeAlias = tuple[float, float, float, float]
"""World x_min, y_min, x_max, y_max [m]."""
Reals: TypeAlias = NDArray[np.floating]
"""Values in float32 or float64."""


class Tick(NamedTuple):
    """A value that is written beside the bar of a scale, and its position on the bar."""

    position: float  # along the bar, 0 to 1
    text: str


class ColorScale(NamedTuple):
    """A color scale: a bar of colours on which each value has a position, 0 to 1.

    Attributes:
        label: the name of the quantity, with its unit.
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

    def bar(self, num_colors: int) -> NDArray[np.uint8]:
        """Return colours at equal distances along the bar, that of the lowest value first.

        Args:
            num_colors: the number of colours, >= 1.

        Returns:
            Red, green and blue of each colour, 0 to 255, shape (num_colors, 3).
        """
        bar_positions = np.linspace(0.0, len(self.colors) - 1, num_colors)
        rgb_of_colors = np.array([colors.rgb_of(color) for color in self.colors], dtype=np.float64)
        channels = [
            np.interp(bar_positions, np.arange(len(rgb_of_colors)), channel)
            for channel in rgb_of_colors.T
        ]
        return np.round(np.stack(channels, axis=1)).astype(np.uint8)

    def color(self, values: Reals, num_shades: int = NUM_SHADES) -> NDArray[np.uint8]:
        """Return the colours of values, shape (…, 3), 0 to 255.

        Args:
            values: finite values, shape (…). Those below or above `self.values` get the colour at
                that end of the bar.
            num_shades: the number of different colours, >= 2.
        """
        positions = np.interp(values, self.values, self.positions)
        shade_indices = np.round(positions * (num_shades - 1)).astype(np.intp)
        value_rgb: NDArray[np.uint8] = self.bar(num_shades).take(shade_indices, axis=0)
        return value_rgb


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
        key_text: what the number stands for in a key; empty for `text`.
    """

    text: str
    fallback: str
    x: float
    y: float
    width: float
    height: float
    number: int = 0
    key_text: str = ""


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
        keep_clear: rectangles that names of points stay off, such as those of door leaves.
        relief_step: the difference of values between neighbours at which relief shading has 3/4 of
            its full strength; 0 for no shading.
    """

    title: str
    rgb: NDArray[np.uint8]
    values: NDArray[np.float32] | None = None
    scale: ColorScale | None = None
    legend: Legend = ()
    labels: tuple[Label, ...] = ()
    doors: tuple[DoorLine, ...] = ()
    connections: tuple[Connection, ...] = ()
    keep_clear: tuple[Rectangle, ...] = ()
    relief_step: float = 0.0


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


def tint_free_cells(panel: Panel) -> Panel:
    """Return the panel as scenes show it: free cells have a tint that no floor has."""
    rgb = panel.rgb.copy()
    rgb[(rgb == colors.rgb_of(colors.FREE)).all(axis=-1)] = colors.rgb_of(colors.FREE_TINT)
    legend = tuple(
        (meaning, colors.FREE_TINT if color == colors.FREE else color)
        for meaning, color in panel.legend
    )
    return panel._replace(rgb=rgb, legend=legend)


def paint(panel: Panel, num_shades: int = NUM_SHADES) -> NDArray[np.uint8]:
    """Return the colours of a panel's cells, shape (height, width, 3), row 0 at the largest y.

    Args:
        panel: the panel.
        num_shades: the number of different colours of its values without relief, >= 2.
    """
    if panel.values is None or panel.scale is None:
        return panel.rgb
    has_value = np.isfinite(panel.values)
    value_rgb = panel.scale.color(panel.values[has_value], num_shades)
    if panel.relief_step:
        shading = relief_shading(panel.values, panel.relief_step)[has_value][:, None]
        mixed_share = np.where(shading > 0, shading * MAX_WHITE_SHARE, -shading * MAX_BLACK_SHARE)
        value_rgb = np.round(
            value_rgb * (1 - mixed_share) + (shading > 0) * 255 * mixed_share
        ).astype(np.uint8)
    rgb = panel.rgb.copy()
    rgb[has_value] = value_rgb
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


def linear_scale(values: Reals, label: str, *, is_high_dark: bool = False) -> ColorScale:
    """Make a linear color scale with ticks at round numbers.

    If all values are equal, there is one tick, at that value.

    Args:
        values: finite values, shape (n,).
        label: the name of the quantity, with its unit.
        is_high_dark: whether the largest value is the darkest, not the lightest.
    """
    low = float(values.min()) if values.size else 0.0
    high = float(values.max()) if values.size else MIN_VALUE_RANGE
    ticks = [(low, f"{low + 0.0:g}")]  # no -0
    if high > low:
        step = round_up_step((high - low) / MAX_TICKS)
        num_decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        first_multiple = math.ceil(low / step - 1e-9)
        last_multiple = math.floor(high / step + 1e-9)
        ticks = [
            (multiple * step, f"{multiple * step + 0.0:.{num_decimals}f}")
            for multiple in range(first_multiple, last_multiple + 1)
        ]
    margin = max(0.0, MIN_VALUE_RANGE - (high - low)) / 2
    if is_high_dark:
        high += 2 * margin
    else:
        low -= margin
        high += margin
    bar_colors = VIRIDIS[::-1] if is_high_dark else VIRIDIS
    bar_ticks = tuple(Tick((value - low) / (high - low), text) for value, text in ticks)
    return ColorScale(label, (low, high), (0.0, 1.0), bar_ticks, bar_colors)


def round_up_step(number: float) -> float:
    """Round a number up to the next 1, 2 or 5 times a power of ten."""
    power_of_ten = 10.0 ** math.floor(math.log10(number))
    return next(
        (
            factor * power_of_ten
            for factor in (1, 2, 5)
            if factor * power_of_ten >= number * (1 - 1e-9)
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
        label: the name of the heights, with their unit.
    """
    if not heights.size:
        return linear_scale(heights, label)
    low = float(heights.min())
    high = float(heights.max())
    height_step = max(HEIGHT_STEP, (high - low) / MAX_HEIGHT_STEPS)
    num_cells_at_height = np.bincount(np.round((heights - low) / height_step).astype(np.int64))
    height_indices = np.flatnonzero(num_cells_at_height)
    bar_distances = np.concatenate([[0.0], np.cumsum(np.cbrt(np.diff(height_indices)))])
    # flat floors look flat: a few centimetres are a part of the scale, not all of it
    scale_length = max(float(bar_distances[-1]), MIN_SCALE_LENGTH)
    positions = 0.5 + (bar_distances - bar_distances[-1] / 2) / scale_length
    values = low + height_indices * height_step
    indices_by_frequency = np.argsort(-num_cells_at_height[height_indices], kind="stable").tolist()
    ticks: list[Tick] = []
    for index in [indices_by_frequency[0], 0, len(height_indices) - 1, *indices_by_frequency]:
        position = float(positions[index])
        if all(abs(position - tick.position) >= MIN_TICK_GAP for tick in ticks[:MAX_TICKS]):
            # no -0.00
            ticks.append(Tick(position, format_length(values[index])))
    if positions[0] > 0:
        positions = np.concatenate([[0.0], positions, [1.0]])
        values = np.concatenate([[low - height_step], values, [values[-1] + height_step]])
    bar_ticks = tuple(sorted(ticks[:MAX_TICKS]))
    return ColorScale(label, values.tolist(), positions.tolist(), bar_ticks)


# --- the layers -----------------------------------------------------------------------------------


def _paint_occupancy(level: SceneGrid2D) -> tuple[NDArray[np.uint8], Legend]:
    """Paint the cells of a level by whether they are free.

    Returns:
        The colour of each cell, shape (height, width, 3); and the legend of the colours that occur.
    """
    color_index = np.where(level.free, 0, np.where(np.isnan(level.floor_height), 2, 1)).astype(
        np.uint8
    )
    color_index[level.closed_by_inflation] = 3
    is_color_used = np.bincount(color_index.ravel(), minlength=len(OCCUPANCY_COLORS)) > 0
    legend = [
        entry
        for color_number, entry in enumerate(OCCUPANCY_COLORS.items())
        if is_color_used[color_number]
    ]
    palette = np.array(
        [colors.rgb_of(color) for color in OCCUPANCY_COLORS.values()], dtype=np.uint8
    )
    return palette[color_index], tuple(legend)


def _drop_free(legend: Legend) -> Legend:
    """Return the legend of a layer that gives free cells other colours."""
    return tuple(entry for entry in legend if entry[1] != colors.FREE)


def _show_occupancy(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    free_area = np.count_nonzero(level.free) * level.lattice.cell_size**2
    rgb, legend = _paint_occupancy(level)
    door_lines = find_door_lines(grid, level_number)
    return Panel(f"occupancy, {free_area:.1f} m² free", rgb, legend=legend, doors=door_lines)


def _show_floor(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    rgb = np.full((*level.shape, 3), colors.rgb_of(colors.NO_FLOOR), dtype=np.uint8)
    floor_z = level.floor_height * np.float32(level.unit)
    scale = height_scale(floor_z[np.isfinite(floor_z)], "z [m]")
    legend = (("no floor", colors.NO_FLOOR),) if np.isnan(floor_z).any() else ()
    relief_step = max(RELIEF_STEP, RELIEF_SLOPE * level.lattice.cell_size)
    return Panel("floor height [m]", rgb, floor_z, scale, legend, relief_step=relief_step)


def _show_clearance(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    stored_clearance = level.attributes.get("clearance")
    clearances = (
        measure_clearance(level) if stored_clearance is None else stored_clearance * level.unit
    )
    clearances = np.where(level.free, clearances, np.nan).astype(np.float32)
    scale = linear_scale(clearances[np.isfinite(clearances)], "to the nearest obstacle [m]")
    rgb, legend = _paint_occupancy(level)
    return Panel("clearance [m]", rgb, clearances, scale, _drop_free(legend))


def _show_weights(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    costs = np.where(level.free, level.weights, np.nan).astype(np.float32)
    scale = linear_scale(costs[np.isfinite(costs)], "cost of a cell", is_high_dark=True)
    costs[level.weights == 1] = np.nan  # cells of cost 1 have the colour of free cells
    rgb, legend = _paint_occupancy(level)
    has_cost_1 = bool((level.free & (level.weights == 1)).any())
    cost_1_legend = (("cost 1", colors.FREE),) if has_cost_1 else ()
    return Panel("weights", rgb, costs, scale, (*cost_1_legend, *_drop_free(legend)))


def _show_islands(grid: NavGrid, level_number: int) -> Panel:
    island_layers = islands_of(grid)
    level = grid.levels[level_number]
    num_islands = max(int(island_layer.max(initial=0)) for island_layer in island_layers)
    max_gap = math.ceil(colors.MAX_NEIGHBOR_GAP / level.lattice.cell_size)  # [cells]
    # an island may span several levels, and has one colour on all of them
    neighbour_pairs = set().union(
        *(colors.find_neighbours(island_layer, max_gap) for island_layer in island_layers)
    )
    palette = np.array([colors.rgb_of(color) for color in colors.ROOMS], dtype=np.uint8)
    color_of_island = colors.choose_colors(num_islands, neighbour_pairs, len(palette))
    rgb, legend = _paint_occupancy(level)
    island_index = island_layers[level_number]
    rgb[level.free] = palette[color_of_island[island_index[level.free]]]
    num_cells_of_island = np.bincount(island_index.ravel(), minlength=num_islands + 1)
    num_cells_of_island[0] = 0  # not free
    region_names = []
    for island in np.argsort(-num_cells_of_island, kind="stable")[:MAX_NUMBERED_ISLANDS].tolist():
        area = num_cells_of_island[island] * level.lattice.cell_size**2
        region_names.append(RegionName(island, f"{island}: {area:.2f} m²", str(island)))
    labels = tuple(
        label._replace(key_text=label.text.partition(" ")[2])
        for label in _label_regions(level, island_index, region_names)
    )
    return Panel("islands, with their areas", rgb, legend=_drop_free(legend), labels=labels)


def paint_rooms(grid: NavGrid, level_number: int) -> NDArray[np.uint8]:
    """Paint the cells of a level in the colours of their rooms, blocked cells darker.

    The cells of doors and doorways, and cells that inflation closed, have colours of their own.

    Args:
        grid: a grid of one or several levels.
        level_number: the number of the level, 0 is the lowest.

    Returns:
        The colour of each cell, shape (height, width, 3).
    """
    level = grid.levels[level_number]
    room_colors = colors.color_rooms(grid, level_number)
    palette = np.stack([colors.darken_rooms(room_colors), room_colors], axis=1).reshape(-1, 3)
    # cells with the index 0 are in no room
    palette[0] = colors.rgb_of(colors.OCCUPIED)
    palette[1] = colors.rgb_of(colors.FREE)
    rgb = palette.take(level.room_index.astype(np.uint32) * 2 + level.free, axis=0)
    rgb[np.isnan(level.floor_height)] = colors.rgb_of(colors.NO_FLOOR)
    rgb[level.closed_by_inflation] = colors.rgb_of(colors.CLOSED)
    _paint_doors(rgb, grid, level_number)
    return rgb


def _paint_doors(rgb: NDArray[np.uint8], grid: NavGrid, level_number: int) -> None:
    rgb[mark_door_cells(grid, level_number, in_current_state=False)] = colors.rgb_of(colors.DOORWAY)
    rgb[mark_door_cells(grid, level_number, in_current_state=True)] = colors.rgb_of(colors.DOOR)


def _show_rooms(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    room_index = level.room_index
    is_free = level.free
    is_closed = level.closed_by_inflation
    has_no_floor = np.isnan(level.floor_height)
    is_door = mark_door_cells(grid, level_number, in_current_state=True)
    is_doorway = mark_door_cells(grid, level_number, in_current_state=False)
    outdoor_indices = [
        room.index for room in grid.rooms if room.level == level_number and room.outdoors
    ]
    mask_of_entry = {
        ("outdoors", colors.OUTDOORS): np.isin(room_index, outdoor_indices),
        ("occupied", colors.OCCUPIED): ((room_index == 0) & ~is_free & ~is_closed & ~has_no_floor),
        ("no floor", colors.NO_FLOOR): has_no_floor,
        ("free, no room", colors.FREE): (room_index == 0) & is_free,
        ("greyer: occupied in a room", colors.ROOM_LEGEND): (
            (room_index > 0) & ~is_free & ~is_closed
        ),
        ("closed by inflation", colors.CLOSED): is_closed,
        (LEAF_TEXT, colors.DOOR): is_door,
        (DOORWAY_TEXT, colors.DOORWAY): is_doorway & ~is_door,
    }
    legend = tuple(entry for entry, mask in mask_of_entry.items() if mask.any())
    region_names = [
        RegionName(room.index, room.name, f"{level_number}:{room.index}")
        for room in grid.rooms
        if room.level == level_number
    ]
    # names stand off the leaves
    labels = _label_regions(level, np.where(is_door | is_doorway, 0, room_index), region_names)
    door_lines = find_door_lines(grid, level_number)
    return Panel(
        "rooms", paint_rooms(grid, level_number), legend=legend, labels=labels, doors=door_lines
    )


class RegionName(NamedTuple):
    """The name of a room or area of a level."""

    number: int  # the index of the room or area, which its cells have
    name: str | None  # None if the room or area has no name
    fallback: str  # the text to write if there is no name


def _label_regions(
    level: SceneGrid2D, region_index: NDArray[np.integer], region_names: Iterable[RegionName]
) -> tuple[Label, ...]:
    """Place the names of rooms or areas on the map of a level.

    The cell that is farthest from the edge of the room is found. The name stands in the middle of
    the horizontal run of the room's cells through that cell, and may be as wide as the run.

    Args:
        level: the level.
        region_index: the index of each cell's room or area, 0 for none, shape (height, width).
        region_names: the names to place; those without cells are left out.
    """
    from scipy import ndimage  # takes longer to load than most pictures to draw

    def find_run_ends(is_in_line: NDArray[np.bool_], index: int) -> list[int]:
        """Return the first and the last index of the run of True in a line around a position."""
        run_labels = ndimage.label(is_in_line)[0]
        run_ends: list[int] = np.flatnonzero(run_labels == run_labels[index])[[0, -1]].tolist()
        return run_ends

    labels = []
    slices_of_region = dict(enumerate(ndimage.find_objects(region_index.astype(np.int32)), 1))
    for region_name in region_names:
        region_slices = slices_of_region.get(region_name.number)
        if region_slices is None:
            continue
        is_in_region = region_index[region_slices] == region_name.number
        sampling_stride = max(1, -(-max(is_in_region.shape) // MAX_SAMPLED_CELLS))
        is_in_region = is_in_region[::sampling_stride, ::sampling_stride]
        sample_edge = level.lattice.cell_size * sampling_stride
        edge_distance = ndimage.distance_transform_edt(np.pad(is_in_region, 1))[1:-1, 1:-1]
        row, col = divmod(int(np.argmax(edge_distance)), edge_distance.shape[1])
        first_col, last_col = find_run_ends(is_in_region[row], col)
        top_row, bottom_row = find_run_ends(is_in_region[:, (first_col + last_col) // 2], row)
        middle_col = region_slices[1].start + (first_col + last_col) / 2 * sampling_stride
        x, y = level.lattice.positions(
            region_slices[0].start + row * sampling_stride, middle_col
        ).tolist()
        half_height = min(row - top_row, bottom_row - row)  # the name's middle is in this row
        label = Label(
            text=region_name.name or region_name.fallback,
            fallback=region_name.fallback,
            x=x,
            y=y,
            width=(last_col - first_col + 1) * sample_edge,
            height=(2 * half_height + 1) * sample_edge,
            number=region_name.number,
        )
        labels.append(label)
    return tuple(labels)


def _label_point(text: str, fallback: str, x: float, y: float, number: int) -> Label:
    return Label(text, fallback, x, y, width=0.0, height=0.0, number=number)


def _show_doors(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    rgb, legend = _paint_occupancy(level)
    _paint_doors(rgb, grid, level_number)
    door_entries = tuple(
        (meaning, color)
        for meaning, color in ((LEAF_TEXT, colors.DOOR), (DOORWAY_TEXT, colors.DOORWAY))
        if (rgb == colors.rgb_of(color)).all(axis=-1).any()
    )
    door_lines = find_door_lines(grid, level_number)
    labels = []
    for door_number, door_line in enumerate(door_lines, 1):
        width_text = f"{door_line.width:.1f} m"
        if door_line.leaf_width is not None:  # to a centimetre, as it is measured on the geometry
            width_text = f"{round(door_line.leaf_width, 2):g} m"
        x, y = door_line.middle
        labels.append(_label_point(f"{door_line.id} {width_text}", width_text, x, y, door_number))
    return Panel(
        "doors",
        rgb,
        legend=(*door_entries, *legend),
        labels=tuple(labels),
        doors=door_lines,
        keep_clear=_find_door_rectangles(grid, level_number),
    )


def _find_door_rectangles(grid: NavGrid, level_number: int) -> tuple[Rectangle, ...]:
    """Return rectangles around the cells of each door's leaf: as it stands now, and closed."""
    lattice = grid.levels[level_number].lattice
    half_cell = lattice.cell_size / 2
    rectangles = []
    for door in grid.doors:
        for state in {door.state: None, "closed": None}:
            cells = door.cells_in(state, len(grid.levels))[level_number]
            if not len(cells):
                continue
            centers = lattice.positions(*np.divmod(cells, lattice.width))
            x_min, y_min = (centers.min(axis=0) - half_cell).tolist()
            x_max, y_max = (centers.max(axis=0) + half_cell).tolist()
            rectangles.append((x_min, y_min, x_max, y_max))
    return tuple(rectangles)


def _show_links(grid: NavGrid, level_number: int) -> Panel:
    rgb, legend = _paint_occupancy(grid.levels[level_number])
    # each step in both directions: level and cell of its start, level and cell of its end
    steps = np.concatenate([grid.step_array, grid.step_array[:, [2, 3, 0, 1]]])
    steps = steps[steps[:, 0] == level_number]
    level_change_sign = np.sign(steps[:, 2] - level_number)
    step_colors = (
        ("leads up", colors.LINK_UP, 1),
        ("leads down", colors.LINK_DOWN, -1),
        ("steep, same level", colors.LINK_ACROSS, 0),
    )
    for _, color, change_sign in step_colors:
        cell_ids = steps[level_change_sign == change_sign, 1]
        rgb.reshape(-1, 3)[cell_ids] = colors.rgb_of(color)
    step_entries = tuple(
        (meaning, color)
        for meaning, color, _ in step_colors
        if (rgb == colors.rgb_of(color)).all(axis=-1).any()
    )
    legend = (*step_entries, *legend)
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
    # names stand off the lines on the level
    half_width = grid.levels[level_number].lattice.cell_size
    line_rectangles = [
        (
            min(start.x, end.x) - half_width,
            min(start.y, end.y) - half_width,
            max(start.x, end.x) + half_width,
            max(start.y, end.y) + half_width,
        )
        for connection in connections
        for start, end in itertools.pairwise(connection.stops)
        if start.level == end.level == level_number
    ]
    return Panel(
        "links",
        rgb,
        legend=legend,
        labels=tuple(labels),
        connections=tuple(connections),
        keep_clear=tuple(line_rectangles),
    )


def _show_areas(grid: NavGrid, level_number: int) -> Panel:
    level = grid.levels[level_number]
    region_names = []
    rgb, legend = _paint_occupancy(level)
    area_entries = []
    for area_number, area in enumerate(grid.areas, 1):
        color = colors.ROOMS[area_number % len(colors.ROOMS)]
        if math.isinf(area.cost):
            color = colors.KEEP_OUT
        is_in_area = level.area_index == area_number
        area_rgb = np.array(colors.rgb_of(color), dtype=np.uint8)
        rgb[is_in_area & level.free] = area_rgb
        is_occupied = ~level.free & ~level.closed_by_inflation
        rgb[is_in_area & is_occupied] = colors.darken_rooms(area_rgb)
        if is_in_area.any():
            area_entries.append((describe_area(area), color))
        region_names.append(RegionName(area_number, area.name, str(area_number)))
    labels = _label_regions(level, level.area_index, region_names)
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
