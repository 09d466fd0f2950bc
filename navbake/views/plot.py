"""Draws pictures of a grid with matplotlib: layers of each level, with axes in world metres."""

from __future__ import annotations

import io
import itertools
import math
import textwrap
import unicodedata
import warnings
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from navbake.errors import MissingDependencyError, QueryError, printable
from navbake.formats.source import write_bytes
from navbake.lengths import format_coordinate, format_position
from navbake.navgrid.cells import check_level
from navbake.navgrid.colors import DOOR, LINK, ROUTE, STAND, TARGET, rgb_of
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.lattice import Lattice
from navbake.runtime.paths import Path as Route
from navbake.runtime.stand import StandPoses
from navbake.types import Bool, Float
from navbake.views.describe import Connection, StopPoint
from navbake.views.layers import (
    Label,
    Panel,
    Rectangle,
    choose_kind_colors,
    make_panel,
    paint,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

    class PanelAxes(Axes):
        """The axes on which one level's map is drawn.

        The size of the figure is chosen so that titles and scales of all its maps fit.

        Attributes:
            title_width: the largest width of the title [inches].
            min_pixels_per_metre: the least scale of the map.
        """

        title_width: float
        min_pixels_per_metre: float


# Functions import matplotlib when they draw: it is an extra, and takes half a second to load.

DEFAULT_LAYERS = ("occupancy", "floor")
DPI = 150  # pixels per inch of a PNG
ARROW_LENGTH = 0.25  # of the arrow of a pose [m]
SHADE_ALPHA = 110  # opacity of shaded cells, 0 to 255
MAX_MAPS_PER_ROW = 3
DPI_RANGE = (30, 1200)
PICTURE_SUFFIXES = (".png", ".svg", ".pdf")
WIDE_ASPECT = 2.4  # maps whose width is more than this times their height lie below each other
MAX_ASPECT = 40.0  # a map that is longer and narrower than this shows empty space beside the grid

# Lengths [inches]. A picture is at most 8.3 inches wide. A README shows 100 pixels per inch, so
# that it is at most 830 pixels wide there, and letters of 8 points are 11 pixels high.
MAX_WIDTH = 8.3
MAX_HEIGHT = 290.0
MIN_WIDTH = 4.6
MAX_MAP_HEIGHT = 5.6
# space beside and above each map for ticks, title and colour bar
MARGIN_X = 1.1
MARGIN_Y = 0.65
MAP_PADDING = 0.05
MIN_TITLE_WIDTH = 1.7  # maps that are narrower stand so far apart that their titles have this width
TITLE_GAP = 0.12  # least distance of two titles beside each other
LINE_HEIGHT = 0.2  # height of a line of the heading or the legend
LETTERS_PER_INCH = 13  # letters of a title or legend that fit into an inch

HEADING_POINTS = 10.5
TITLE_POINTS = 9.0
LEGEND_POINTS = 8.0
TICK_POINTS = 7.5
# font sizes of names and numbers on maps [points]; the first that fits is used
NAME_POINTS = (9.0, 8.0, 7.0)
NUMBER_POINTS = (8.0, 7.0, 6.0)
# Directions from a point to the middle of its name, the best one first. Links to other levels leave
# their stops upwards and downwards.
POINT_NAME_DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
POINT_NAME_DISTANCES = (0.0, 14.0, 28.0, 42.0)  # how much farther away it may stand [pixels]
POINT_HALF_SIDE = 12  # half a side of the square round a point, which stays free of names [pixels]
MAX_LETTERS = 40  # letters of a name on a map
MAX_KEY_ENTRIES = 40  # most entries of the key, which explains the numbers on maps
FONT = "DejaVu Sans"  # comes with matplotlib
TEXT_COLOR = "#222222"
FAINT_COLOR = "#9aa0a8"
# kind of line -> colours and widths [points] of its strokes, which lie on each other, lowest first
LINE_STROKES = {
    "door, closed": (("#ffffff", 4.2), (DOOR, 2.6)),
    "door, open": ((DOOR, 3.8), ("#ffffff", 1.6)),
    "path, from o to x": (("#ffffff", 3.4), (ROUTE, 1.8)),
    "link": (("#ffffff", 3.2), (LINK, 1.6)),
    "link, closed": (("#ffffff", 3.2), (FAINT_COLOR, 1.6)),
    "stairs": (("#ffffff", 2.8), (TEXT_COLOR, 1.0)),
}


MATPLOTLIB_SETTINGS: dict[Any, object] = {
    "svg.hashsalt": "navbake",  # else ids in an SVG are hashes with a random salt
    "svg.fonttype": "path",  # letters are shapes, in case a viewer lacks the fonts
    "pdf.fonttype": 42,  # TrueType: journals refuse the fonts of type 3
    "text.parse_math": False,  # no name is markup
    "text.color": TEXT_COLOR,
    "figure.autolayout": False,  # without a layout engine, these would choose one
    "figure.constrained_layout.use": False,
}
# what matplotlib would write of itself and of the time, by the picture's format
METADATA_KEYS = {
    "png": ("Software",),
    "svg": ("Creator", "Date"),
    "pdf": ("Creator", "Producer", "CreationDate"),
}


Mark: TypeAlias = tuple[int, float, float, str]
"""A place to mark on a picture: its level (-1 for all levels), world x and y [m], and its kind."""


class Overlays(NamedTuple):
    """What is drawn on top of the maps."""

    route: Route | None = None  #: A path, each of its parts on its level.
    marks: Sequence[Mark] = ()  #: Places to mark; those without a level are drawn on all levels.
    poses: StandPoses | None = None  #: Poses of a base, from `PathFinder.stand_poses`, as arrows.
    region: Sequence[Bool] | None = None
    """Cells to shade, from `PathFinder.stand_region`; a mask (height, width) for each level."""


def plot_grid(grid: NavGrid, path: str | PathLike[str], **options: Any) -> Path:
    """Write a picture of a grid.

    Args:
        grid: a grid of one or several levels.
        path: the path of the file, which ends in ``.png``, ``.svg`` or ``.pdf``.
        options: keyword arguments of `render_picture`.

    Returns:
        The path.

    Raises:
        QueryError: the path has another ending, or an option is not valid.

    Example:
        >>> plot_grid(grid, "figure.pdf", bounds=(0, 0, 5, 4), titles=False)
    """
    path = Path(path)
    write_bytes(render_picture(grid, find_picture_format(path), **options), path)
    return path


def find_picture_format(path: str | PathLike[str]) -> str:
    """Return the format of a picture by its file's name: ``png``, ``svg`` or ``pdf``.

    Raises:
        QueryError: the name has another ending.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in PICTURE_SUFFIXES:
        expected = f"a picture that ends in {', '.join(PICTURE_SUFFIXES)}"
        raise QueryError(
            f"expected {expected}, got {path}", key="path", value=str(path), expected=expected
        )
    return suffix[1:]


def plot(
    grid: NavGrid, path: str | PathLike[str] | None = None, **options: Any
) -> Image.Image | Path:
    """Draw a grid.

    Args:
        grid: a grid of one or several levels.
        path: the path of a file to write, see `plot_grid`; None to write no file.
        options: keyword arguments of `render_picture`.

    Returns:
        The path, if one is given. Otherwise the image, which notebooks show and which has a method
        ``show()``.
    """
    if path is not None:
        return plot_grid(grid, path, **options)
    return Image.open(io.BytesIO(render_picture(grid, **options)))


def render_picture(
    grid: NavGrid,
    form: str = "png",
    *,
    level: int | None = None,
    layers: Sequence[str] = DEFAULT_LAYERS,
    overlays: Overlays = Overlays(),  # noqa: B008 it is a tuple
    bounds: Sequence[float] | None = None,
    dpi: float = DPI,
    titles: bool = True,
) -> bytes:
    """Draw a grid as PNG, SVG or PDF; equal arguments give equal bytes.

    Each level has a row of panels, with a panel for each layer; the lowest level is on top. If
    there is only one layer, the levels lie beside each other. All panels have the same scale and
    show the same part of the world, +y up.

    Args:
        grid: a grid of one or several levels.
        form: ``png``, ``svg`` or ``pdf``. A PDF embeds its fonts as TrueType.
        level: the number of the only level to draw, 0 is the lowest; None for all.
        layers: the layers to draw, names of `navbake.views.layers.LAYERS`.
        overlays: what is drawn on top of the maps.
        bounds: the part of the world to show, world x_min, y_min, x_max, y_max [m]; None for all of
            the grid. Names whose place lies outside are left out.
        dpi: pixels per inch of a PNG, 30 to 1200. The picture is at most 8.3 inches wide.
        titles: whether to write the heading and the maps' titles.

    Raises:
        QueryError: there is no such level or layer, the bounds show nothing of the grid, or `dpi`
            is out of its range.
        MissingDependencyError: matplotlib is not installed.
    """
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        message = 'plots need matplotlib: pip install "navbake[plot]"'
        raise MissingDependencyError(message) from error

    check_level(level, len(grid.levels))
    if not layers:
        raise QueryError("expected at least one layer to draw, got none")
    level_numbers = list(range(len(grid.levels))) if level is None else [level]
    panel_level_numbers = [level_number for level_number in level_numbers for _ in layers]
    panels = [
        make_panel(grid, layer, level_number) for level_number in level_numbers for layer in layers
    ]
    if not DPI_RANGE[0] <= dpi <= DPI_RANGE[1]:
        expected = f"{DPI_RANGE[0]} to {DPI_RANGE[1]}"
        raise QueryError(
            f"expected {expected} as dpi, got {dpi:g}", key="dpi", value=dpi, expected=expected
        )
    color_of_kind = choose_kind_colors(kind for *_, kind in overlays.marks)
    view_bounds = _find_view_bounds(grid, level_numbers, bounds)
    if bounds is not None:
        panels = [
            _keep_shown(panel, grid.levels[level_number].lattice, view_bounds)
            for panel, level_number in zip(panels, panel_level_numbers, strict=True)
        ]
    drawn_texts = [grid.scene_id or "", *color_of_kind, *(panel.title for panel in panels)]
    drawn_texts += [label.text for panel in panels for label in panel.labels]
    font_families, missing_letters = choose_fonts("".join(drawn_texts))
    settings = {**MATPLOTLIB_SETTINGS, "font.family": font_families}
    with rc_context(settings), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        figure = Figure(facecolor="white", dpi=DPI)
        FigureCanvasAgg(figure)
        axes = add_axes(figure, view_bounds, panels, len(layers), dpi)
        if titles:
            _write_heading(figure, grid)
        for ax, level_number, panel in zip(axes, panel_level_numbers, panels, strict=True):
            _draw_panel(ax, panel, grid.levels[level_number].lattice.bounds, has_title=titles)
            _draw_overlays(ax, overlays, grid, level_number, color_of_kind)
        legend_colors = {**color_of_kind, **_list_stand_colors(overlays)}
        legend = _draw_legend(figure, panels, legend_colors, overlays.route is not None)
        # names fit rooms, and titles fit beside each other: both need the layout
        _lay_out(figure)
        if titles:
            _fit_titles(figure, axes, panels)
            _lay_out(figure)
        # with an engine of any kind, even "none", `savefig` would draw all once more beforehand
        figure.set_layout_engine(None)
        key_entries = _write_all_names(axes, panels, missing_letters)
        _write_key(legend, grid, key_entries, figure.get_figwidth() * 1.2)
        axes_of_level = {
            level_number: ax
            for ax, level_number, panel in zip(axes, panel_level_numbers, panels, strict=True)
            if panel.connections
        }
        _draw_connections(figure, axes_of_level, panels, view_bounds)
        # the lines of the key hang below the figure, which is extended by them
        bottom_edge = min(0.0, legend.get_window_extent().y0 / DPI - LINE_HEIGHT / 2)
        top_edge = figure.get_figheight()
        if not titles:  # the space for them is cut off
            top_edge = _find_top_of_maps(axes)
        return _encode_figure(figure, form, dpi, bottom_edge, top_edge)


def _write_heading(figure: Figure, grid: NavGrid) -> None:
    """Write the name of a grid, and the radius that it is inflated by, above all maps."""
    heading_text = grid.scene_id or "grid"
    if grid.exact_inflations:
        heading_text = f"{heading_text}, {grid.describe_radius()}"
    heading = wrap_text(heading_text, figure.get_figwidth())
    figure.suptitle(heading, x=0.01, ha="left", fontsize=HEADING_POINTS, fontweight="bold")


def _list_stand_colors(overlays: Overlays) -> dict[str, str]:
    """Return what the legend says of poses and of shaded cells -> its colour."""
    colors = {}
    if overlays.poses is not None or overlays.region is not None:
        colors["where a base can stand"] = STAND
    if overlays.poses is not None:
        colors["what it reaches"] = TARGET
    return colors


def _write_key(legend: Legend, grid: NavGrid, key_entries: Sequence[str], max_width: float) -> None:
    """Write the size of cells, and what numbers on the maps mean, above the legend's entries.

    Args:
        legend: the legend.
        grid: the grid.
        key_entries: what each number on the maps means.
        max_width: the largest width of a line [inches].
    """
    from matplotlib.font_manager import FontProperties

    facts_text = f"cells of {grid.levels[0].lattice.cell_size:g} m, axes in metres"
    key_text = wrap_text("   ".join([facts_text, *key_entries]), max_width, max_lines=99)
    legend.set_title(key_text, FontProperties(size=LEGEND_POINTS))


def _find_top_of_maps(axes: Sequence[PanelAxes]) -> float:
    """Return how high above the figure's lower edge the highest map ends, with padding [inches]."""
    map_frames = [ax.get_tightbbox() for ax in axes]
    return float(max(frame.y1 for frame in map_frames if frame is not None)) / DPI + MAP_PADDING


def _encode_figure(
    figure: Figure, form: str, dpi: float, bottom_edge: float, top_edge: float
) -> bytes:
    """Encode a figure as a file.

    Args:
        figure: the figure.
        form: ``png``, ``svg`` or ``pdf``.
        dpi: pixels per inch of a PNG.
        bottom_edge: the lower edge of what is shown, 0 is that of the figure [inches].
        top_edge: the upper edge of what is shown [inches].
    """
    from matplotlib.transforms import Bbox

    picture_file = io.BytesIO()
    figure.savefig(
        picture_file,
        format=form,
        dpi=dpi,
        metadata=dict.fromkeys(METADATA_KEYS[form]),
        bbox_inches=Bbox(np.array([(0.0, bottom_edge), (figure.get_figwidth(), top_edge)])),
    )
    return picture_file.getvalue()


def _find_view_bounds(
    grid: NavGrid, level_numbers: Sequence[int], bounds: Sequence[float] | None
) -> tuple[float, float, float, float]:
    """Return the rectangle that all maps show, world x_min, y_min, x_max, y_max [m].

    Args:
        grid: the grid.
        level_numbers: the numbers of the levels that are drawn.
        bounds: the rectangle that the user wants; None for that of the levels.

    Raises:
        QueryError: the wanted rectangle is none, or shows nothing of the levels.
    """
    level_bounds = np.array(
        [grid.levels[level_number].lattice.bounds for level_number in level_numbers]
    )
    x_min, y_min = level_bounds[:, :2].min(axis=0).tolist()
    x_max, y_max = level_bounds[:, 2:].max(axis=0).tolist()
    if bounds is None:
        return x_min, y_min, x_max, y_max
    wanted = tuple(map(float, bounds))
    bounds_text = format_position((x_min, y_min, x_max, y_max))
    expected = f"x_min, y_min, x_max, y_max within {bounds_text} m"
    has_area = (
        len(wanted) == 4
        and np.isfinite(wanted).all()
        and wanted[0] < wanted[2]
        and wanted[1] < wanted[3]
    )
    if (
        not has_area
        or max(wanted[0], x_min) >= min(wanted[2], x_max)
        or max(wanted[1], y_min) >= min(wanted[3], y_max)
    ):
        got_text = ", ".join(map(format_coordinate, wanted))
        raise QueryError(
            f"expected bounds {expected}, got {got_text}",
            key="bounds",
            value=bounds,
            expected=expected,
        )
    return wanted[0], wanted[1], wanted[2], wanted[3]


def _keep_shown(
    panel: Panel, lattice: Lattice, view_bounds: tuple[float, float, float, float]
) -> Panel:
    """Return a panel without what lies outside of a rectangle: doors, and entries of the legend.

    Args:
        panel: the panel of a level.
        lattice: the lattice of the level.
        view_bounds: the rectangle, world x_min, y_min, x_max, y_max [m].
    """
    x_min, y_min, x_max, y_max = view_bounds
    rows, cols = lattice.rows_cols([(x_min, y_max), (x_max, y_min)])
    row_slice = slice(max(int(rows[0]), 0), max(int(rows[1]) + 1, 0))
    col_slice = slice(max(int(cols[0]), 0), max(int(cols[1]) + 1, 0))

    def is_painted(color: str, rgb: NDArray[np.uint8]) -> bool:
        return bool((rgb == rgb_of(color)).all(axis=-1).any())

    # colours that no cell has, such as that of any room's occupied cells, stay
    legend = tuple(
        (meaning, color)
        for meaning, color in panel.legend
        if is_painted(color, panel.rgb[row_slice, col_slice]) or not is_painted(color, panel.rgb)
    )
    doors = []
    for door in panel.doors:
        low_x, high_x = sorted([door.start[0], door.end[0]])
        low_y, high_y = sorted([door.start[1], door.end[1]])
        if low_x <= x_max and high_x >= x_min and low_y <= y_max and high_y >= y_min:
            doors.append(door)
    return panel._replace(legend=legend, doors=tuple(doors))


def _draw_overlays(
    ax: PanelAxes,
    overlays: Overlays,
    grid: NavGrid,
    level_number: int,
    color_of_kind: Mapping[str, str],
) -> None:
    """Draw what lies on top of the map of a level: the parts of the overlays that are on it.

    Args:
        ax: the panel of the level.
        overlays: the overlays of all levels.
        grid: the grid.
        level_number: the number of the level.
        color_of_kind: kind of mark -> its colour.
    """
    if overlays.route is not None:
        _draw_route(ax, overlays.route, level_number)
    if overlays.region is not None:
        level_bounds = grid.levels[level_number].lattice.bounds
        _shade_region(ax, overlays.region[level_number], level_bounds)
    if overlays.poses is not None:
        poses = overlays.poses
        is_on_level = grid.cells_at(poses.positions).level == level_number
        _draw_poses(ax, poses.positions[is_on_level], poses.headings[is_on_level], poses.outline)
        # a point without a height, in no cell, has no box
        boxes = poses.target_boxes[np.isfinite(poses.target_boxes).all(axis=1)]
        middles = (boxes[:, :3] + boxes[:, 3:]) / 2.0
        _draw_targets(ax, boxes[grid.cells_at(middles).level == level_number])
    for mark_level, x, y, kind in overlays.marks:
        if mark_level in (level_number, -1):
            color = color_of_kind[kind]
            ax.plot(x, y, "s", markerfacecolor="none", color=color, markersize=5, mew=1.2)


def _draw_route(ax: PanelAxes, route: Route, level_number: int) -> None:
    """Draw the parts of a path that are on a level, and both of its ends."""
    x, y = np.where(route.levels == level_number, route.positions[:, :2].T, np.nan)
    ax.plot(x, y, **_make_line_style("path, from o to x"), solid_joinstyle="round")
    for end_index, marker in ((0, "o"), (-1, "X")):
        ax.plot(
            x[end_index],
            y[end_index],
            marker,
            clip_on=False,
            color=ROUTE,
            markeredgecolor="white",
            markersize=8,
        )


def _shade_region(
    ax: PanelAxes, is_in_region: Bool, bounds: tuple[float, float, float, float]
) -> None:
    """Shade cells of a level with the colour of places where a base can stand."""
    x_min, y_min, x_max, y_max = bounds
    x_limits = ax.get_xlim()
    y_limits = ax.get_ylim()
    shade = np.zeros((*is_in_region.shape, 4), dtype=np.uint8)
    shade[is_in_region] = (*rgb_of(STAND), SHADE_ALPHA)
    ax.imshow(shade, extent=(x_min, x_max, y_min, y_max), interpolation="nearest")
    ax.set(xlim=x_limits, ylim=y_limits)


def _draw_targets(ax: PanelAxes, boxes: Float) -> None:
    """Draw what poses on a level reach: its box from above, and a star in its middle.

    Args:
        ax: the panel of the level.
        boxes: lower and upper corners, shape (n, 6) [m].
    """
    for x_low, y_low, _, x_high, y_high, _ in boxes.tolist():
        corners_x = [x_low, x_high, x_high, x_low, x_low]
        corners_y = [y_low, y_low, y_high, y_high, y_low]
        ax.plot(corners_x, corners_y, color=TARGET, linewidth=1.2, zorder=3)
    middles = (boxes[:, :2] + boxes[:, 3:5]) / 2.0
    ax.plot(*middles.T, "*", color=TARGET, markeredgecolor="white", markersize=11, zorder=4)


def _draw_poses(ax: PanelAxes, positions: Float, headings: Float, outline: Float) -> None:
    """Draw poses of a level: the base's outline, and an arrow from its axis to where it faces.

    Args:
        ax: the panel of the level.
        positions: of the base's axis, world x, y, z [m], shape (n, 3).
        headings: where the base faces [rad], shape (n,).
        outline: the base from above, x ahead, y to the left [m], shape (k, 2).
    """
    from matplotlib.collections import PolyCollection  # loads matplotlib

    cos = np.cos(headings)[:, None]
    sin = np.sin(headings)[:, None]
    corners_x = positions[:, :1] + cos * outline[:, 0] - sin * outline[:, 1]
    corners_y = positions[:, 1:2] + sin * outline[:, 0] + cos * outline[:, 1]
    ax.add_collection(
        PolyCollection(
            list(np.stack([corners_x, corners_y], axis=-1)),
            facecolors="none",
            edgecolors=STAND,
            linewidths=0.9,
            zorder=2.5,
        ),
        autolim=False,
    )
    ax.quiver(
        positions[:, 0],
        positions[:, 1],
        ARROW_LENGTH * np.cos(headings),
        ARROW_LENGTH * np.sin(headings),
        angles="xy",
        scale_units="xy",
        scale=1.0,
        units="dots",
        width=4.0,
        color=STAND,
        edgecolor="white",
        linewidth=0.5,
        zorder=3,
    )
    ax.plot(positions[:, 0], positions[:, 1], "o", color=STAND, markeredgecolor="white", ms=4)


def _lay_out(figure: Figure) -> None:
    """Find the places of all axes, as drawing the figure would; drawing takes twice as long."""
    layout_engine = figure.get_layout_engine()
    assert layout_engine is not None  # `add_axes` sets it
    layout_engine.execute(figure)
    for ax in figure.axes:
        ax.apply_aspect()


def _fit_titles(figure: Figure, axes: Sequence[PanelAxes], panels: Sequence[Panel]) -> None:
    """Break each title so that it ends before the title of the next map, or the figure's edge.

    Args:
        figure: the figure, whose layout is known.
        axes: the axes of the panels.
        panels: the panels.
    """
    figure_width = figure.get_window_extent().width
    frames = [ax.get_window_extent() for ax in axes]
    for ax, panel, frame in zip(axes, panels, frames, strict=True):
        next_lefts = [
            other.x0 for other in frames if other.x0 > frame.x0 and abs(other.y1 - frame.y1) < 1
        ]
        width = min([figure_width, *next_lefts]) - frame.x0 - TITLE_GAP * DPI
        for letter_share in np.arange(1.0, 0.3, -0.05):
            title = wrap_text(panel.title, width / DPI * letter_share)
            title_artist = ax.set_title(title, loc="left", fontsize=TITLE_POINTS, pad=5)
            if title_artist.get_window_extent().width <= width:
                break


def _write_all_names(
    axes: Sequence[PanelAxes], panels: Sequence[Panel], missing_letters: set[str]
) -> list[str]:
    """Write the names of all panels on their maps.

    Args:
        axes: the axes of the panels.
        panels: the panels.
        missing_letters: letters that no font has; a name with such a letter is replaced by its
            fallback.

    Returns:
        The entries of the key, such as ``3: kitchen``, for numbers that stand for names.
    """
    key_entries: dict[str, None] = {}
    for ax, panel in zip(axes, panels, strict=True):
        labels = [
            label._replace(text=label.fallback) if missing_letters & set(label.text) else label
            for label in panel.labels
        ]
        key_entries |= dict.fromkeys(write_names(ax, labels, panel.keep_clear))
    shown_entries = list(key_entries)[:MAX_KEY_ENTRIES]
    if len(key_entries) > MAX_KEY_ENTRIES:
        shown_entries.append(f"and {len(key_entries) - MAX_KEY_ENTRIES} more")
    # with no-break spaces, the lines of the key break between entries only
    return [entry.replace(" ", "\N{NO-BREAK SPACE}") for entry in shown_entries]


def choose_fonts(text: str) -> tuple[list[str], set[str]]:
    """Return the families of installed fonts for a text, and the letters that no font has."""
    from matplotlib import font_manager

    font_families = [FONT]
    missing_letters = {letter for letter in escape_undrawable(text) if letter > "~"}
    # Last Resort fonts are left out: for every letter they have just a box
    fonts = [
        font for font in font_manager.fontManager.ttflist if not font.name.startswith("Last Resort")
    ]
    for font in sorted(fonts, key=lambda font: (font.name != FONT, font.name, font.fname)):
        if not missing_letters:
            break
        try:
            font_letters = {*map(chr, font_manager.get_font(font.fname).get_charmap())}
        except (OSError, RuntimeError):  # matplotlib's list names a font that was removed
            continue
        if missing_letters & font_letters and font.name not in font_families:
            font_families.append(font.name)
        missing_letters -= font_letters
    return font_families, missing_letters


def wrap_text(text: str, width: float, max_lines: int = 3) -> str:
    """Break a text into at most `max_lines` lines of a width [inches]; cut off the rest."""
    max_letters = max(int(width * LETTERS_PER_INCH), 8)
    return textwrap.fill(escape_undrawable(text), max_letters, max_lines=max_lines, placeholder="…")


def escape_undrawable(text: str) -> str:
    """Escape the characters of a text that can't be drawn, such as line ends.

    Spaces of all kinds stay, although `str.isprintable` accepts only the ASCII space.
    """
    is_space = [unicodedata.category(letter) == "Zs" for letter in text]
    return "".join(
        letter if is_drawn else printable(letter)
        for letter, is_drawn in zip(text, is_space, strict=True)
    )


def add_axes(
    figure: Figure,
    view_bounds: tuple[float, float, float, float],
    panels: Sequence[Panel],
    num_layers: int,
    dpi: float = DPI,
) -> list[PanelAxes]:
    """Set the size of a figure, and add axes for each panel in the order of `render_picture`.

    Maps that are much wider than high lie one below the other.

    Args:
        figure: an empty figure.
        view_bounds: the rectangle that all panels show, world x_min, y_min, x_max, y_max [m].
        panels: the panels, level by level; of each level, layer by layer.
        num_layers: the number of layers of a level.
        dpi: pixels per inch of the picture.

    Returns:
        The axes of the panels.
    """
    map_extent = np.array([view_bounds[2] - view_bounds[0], view_bounds[3] - view_bounds[1]])
    map_extent = np.maximum(map_extent, max(map_extent.max() / MAX_ASPECT, 1e-3))
    width, height = map_extent  # of a map [m]
    view_center = np.array(view_bounds).reshape(2, 2).mean(axis=0)
    # a row holds the layers of a level, or, of one layer, all levels
    panels_per_group = num_layers if num_layers > 1 else len(panels)
    num_columns = 1 if width > WIDE_ASPECT * height else min(panels_per_group, MAX_MAPS_PER_ROW)
    rows_per_group = math.ceil(panels_per_group / num_columns)
    num_rows = rows_per_group * (len(panels) // panels_per_group)
    max_map_width = MAX_WIDTH / num_columns - MARGIN_X
    max_map_height = min(MAX_MAP_HEIGHT, (MAX_HEIGHT - 1.0) / num_rows - MARGIN_Y)
    map_width, map_height = map_extent * min(
        max_map_width / width, max_map_height / height
    )  # [inch]
    column_width = map_width + MARGIN_X
    padding_x = MAP_PADDING
    if num_columns > 1 and map_width < MIN_TITLE_WIDTH:
        column_width = min(column_width + MIN_TITLE_WIDTH - map_width, MAX_WIDTH / num_columns)
        padding_x = max(MAP_PADDING, (column_width - map_width - MARGIN_X) / 2)
    figure_width = min(max(num_columns * column_width, MIN_WIDTH), MAX_WIDTH)
    figure.set_size_inches(figure_width, num_rows * (map_height + MARGIN_Y) + 1.0)
    figure.set_layout_engine("compressed", w_pad=padding_x, h_pad=MAP_PADDING)
    axes_grid = figure.subplots(num_rows, num_columns, squeeze=False)
    x_min, y_min = view_center - map_extent / 2
    x_max, y_max = view_center + map_extent / 2
    axes: list[PanelAxes] = []
    for panel_index in range(len(panels)):
        row_in_group, column_index = divmod(panel_index % panels_per_group, num_columns)
        ax = axes_grid[
            panel_index // panels_per_group * rows_per_group + row_in_group, column_index
        ]
        ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal")
        ax.title_width = figure_width / num_columns - 0.5
        ax.min_pixels_per_metre = 0.9 * map_width * dpi / width
        axes.append(ax)
    for ax in {*axes_grid.flat} - {*axes}:
        ax.remove()
    return axes


def _draw_panel(
    ax: PanelAxes, panel: Panel, bounds: tuple[float, float, float, float], *, has_title: bool
) -> None:
    """Draw title, cells and doors, and the colour bar of a panel."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap

    if has_title:
        title = wrap_text(panel.title, ax.title_width)
        ax.set_title(title, loc="left", fontsize=TITLE_POINTS, pad=5)
    style_axes(ax)
    x_min, y_min, x_max, y_max = bounds
    x_limits = ax.get_xlim()
    y_limits = ax.get_ylim()
    image = paint(panel)
    # cells have sharp edges, unless several share a pixel
    is_magnified = image.shape[1] <= ax.min_pixels_per_metre * (x_max - x_min)
    interpolation = "nearest" if is_magnified else "antialiased"
    ax.imshow(image, extent=(x_min, x_max, y_min, y_max), interpolation=interpolation)
    ax.set(xlim=x_limits, ylim=y_limits)
    if panel.scale is not None and len(panel.scale.ticks) > 1:
        color_mappable = ScalarMappable(cmap=ListedColormap(panel.scale.bar(256) / 255))
        figure = ax.get_figure()
        assert figure is not None
        color_bar = figure.colorbar(color_mappable, ax=ax, fraction=0.05, pad=0.02, aspect=30)
        tick_texts = [tick.text.replace("-", "\N{MINUS SIGN}") for tick in panel.scale.ticks]
        color_bar.set_ticks([tick.position for tick in panel.scale.ticks], labels=tick_texts)
        color_bar.ax.tick_params(
            labelsize=TICK_POINTS, length=2, width=0.6, color=FAINT_COLOR, pad=2
        )
        color_bar.outline.set_visible(False)
    for door in panel.doors:
        x = (door.start[0], door.end[0])
        y = (door.start[1], door.end[1])
        ax.plot(x, y, **_make_line_style(_find_door_line_kind(door.state)), solid_capstyle="butt")


def style_axes(ax: Axes) -> None:
    """Give axes the ticks and the frame of navbake's maps."""
    ax.tick_params(
        labelsize=TICK_POINTS,
        length=2.5,
        width=0.6,
        color=FAINT_COLOR,
        labelcolor=TEXT_COLOR,
        pad=2,
    )
    ax.spines[:].set(edgecolor=FAINT_COLOR, linewidth=0.6)


def _make_line_style(line_kind: str) -> dict[str, Any]:
    """Return matplotlib's arguments for a line of a kind in `LINE_STROKES`."""
    from matplotlib.patheffects import Stroke

    strokes = [
        Stroke(linewidth=width, foreground=color) for color, width in LINE_STROKES[line_kind]
    ]
    return {
        "path_effects": strokes,
        "linewidth": max(width for _, width in LINE_STROKES[line_kind]),
    }


def _draw_connections(
    figure: Figure,
    axes_of_level: dict[int, PanelAxes],
    panels: Sequence[Panel],
    view_bounds: tuple[float, float, float, float],
) -> None:
    """Draw links and stairs from stop to stop, also from the map of one level to another.

    Args:
        figure: the figure.
        axes_of_level: number of a level -> its axes.
        panels: the panels; those of links have the connections.
        view_bounds: the rectangle that the maps show, world x_min, y_min, x_max, y_max [m]; what
            ends outside of it is left out.
    """
    from matplotlib.patches import ConnectionPatch

    x_min, y_min, x_max, y_max = view_bounds

    def is_shown(stop: StopPoint) -> bool:
        is_inside = x_min <= stop.x <= x_max and y_min <= stop.y <= y_max
        return stop.level in axes_of_level and is_inside

    # each panel of links has the connections of all levels
    connections = next((panel.connections for panel in panels if panel.connections), ())
    for connection in connections:
        line_kind = _find_connection_line_kind(connection)
        color = LINE_STROKES[line_kind][1][0]
        marked_stops = connection.stops[:1] if connection.is_one_way else connection.stops
        for stop in marked_stops:
            if is_shown(stop) and connection.link is not None:
                axes_of_level[stop.level].plot(
                    stop.x, stop.y, "o", color=color, markeredgecolor="white", markersize=6
                )
        for start, end in itertools.pairwise(connection.stops):
            if not is_shown(start) or not is_shown(end):
                continue
            curvature = 0.15 if start.level != end.level else 0
            arc = ConnectionPatch(
                (start.x, start.y),
                (end.x, end.y),
                coordsA=axes_of_level[start.level].transData,
                coordsB=axes_of_level[end.level].transData,
                arrowstyle="-|>" if connection.is_one_way else "-",
                mutation_scale=7,
                connectionstyle=f"arc3,rad={curvature}",
                shrinkA=0,
                shrinkB=0,
                color=color,
                alpha=0.9,
                **_make_line_style(line_kind),
            )
            figure.add_artist(arc)


def _find_connection_line_kind(connection: Connection) -> str:
    """Return the kind of line of a link or stair in `LINE_STROKES`."""
    if connection.link is None:
        return "stairs"
    return "link, closed" if connection.is_closed else "link"


def _find_door_line_kind(state: str) -> str:
    """Return the kind of line of a door in `LINE_STROKES`."""
    return "door, closed" if state == "closed" else "door, open"


def write_names(
    ax: Axes, labels: Sequence[Label], keep_clear: Sequence[Rectangle] = ()
) -> Iterator[str]:
    """Write names on a map so that they don't overlap; names of large rooms come first.

    A room's name stands in the middle of the room, in one line or two, as large as fits. The name
    of a point stands beside the point. If the name doesn't fit, its number is written; if that
    doesn't fit either, nothing. Names of places outside of the map are left out.

    Args:
        ax: the axes of the map; their size must be final.
        labels: the names.
        keep_clear: rectangles that names of points stay off, world x_min, y_min, x_max, y_max [m].

    Yields:
        For each number that was written instead of a name, its explanation, such as
        ``3: kitchen``.
    """
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import Bbox

    data_to_pixels = ax.transData
    map_frame = ax.get_window_extent()
    pixels_per_metre = map_frame.width / np.ptp(ax.get_xlim())
    labels = [
        label
        for label in labels
        if map_frame.contains(*data_to_pixels.transform((label.x, label.y)))
    ]
    # a name without a width is that of a point
    point_pixels = [
        data_to_pixels.transform((label.x, label.y)) for label in labels if not label.width
    ]
    occupied_boxes = [
        Bbox([point - POINT_HALF_SIDE, point + POINT_HALF_SIDE]) for point in point_pixels
    ]
    clear_boxes = [
        Bbox(data_to_pixels.transform([(x_min, y_min), (x_max, y_max)]))
        for x_min, y_min, x_max, y_max in keep_clear
    ]
    for label in sorted(labels, key=lambda label: -label.width * label.height):
        full_name = escape_undrawable(label.text)
        is_point = not label.width
        name = full_name
        if len(full_name) > MAX_LETTERS:
            name = f"{full_name[:MAX_LETTERS]}…"
        middle_pixel = data_to_pixels.transform((label.x, label.y))
        if is_point:  # the name stands beside the point, in the smallest letters
            font_sizes: Sequence[float] = NAME_POINTS[-1:]
            distances: Sequence[float] = POINT_NAME_DISTANCES
            directions: Sequence[tuple[int, int]] = POINT_NAME_DIRECTIONS
            available_pixels = np.array([np.inf, np.inf])
            forbidden_boxes = [*occupied_boxes, *clear_boxes]
        else:  # the name stands in the room's middle
            font_sizes = NAME_POINTS
            distances = (0.0,)
            directions = ((0, 0),)
            available_pixels = np.array([label.width, label.height]) * pixels_per_metre
            forbidden_boxes = occupied_boxes
        candidate_texts = [
            (text, font_size) for font_size in font_sizes for text in _list_line_breaks(name)
        ]
        candidate_texts += [(str(label.number), font_size) for font_size in NUMBER_POINTS]
        text_artist = ax.text(label.x, label.y, "", ha="center", va="center", linespacing=1.05)
        for text, font_size in candidate_texts:
            text_artist.set(text=text, fontsize=font_size)
            text_extent = np.array(text_artist.get_window_extent().size)
            half_extent = text_extent / 2 + 3
            candidate_boxes = []
            for distance in distances:
                center_offset = half_extent + POINT_HALF_SIDE + 1 + distance
                for direction in directions:
                    # moved so that it lies on the map
                    center = np.clip(
                        middle_pixel + direction * center_offset,
                        map_frame.p0 + half_extent,
                        map_frame.p1 - half_extent,
                    )
                    candidate_boxes.append(Bbox([center - half_extent, center + half_extent]))
            free_boxes = [
                box for box in candidate_boxes if not any(map(box.overlaps, forbidden_boxes))
            ]
            fits_room = (text_extent <= available_pixels).all()
            fits_map = (2 * half_extent <= map_frame.size).all()
            if free_boxes and fits_room and fits_map:
                break
        else:  # not even the number fits
            text_artist.remove()
            continue
        box = free_boxes[0]
        occupied_boxes.append(box)
        x, y = data_to_pixels.inverted().transform((box.p0 + box.p1) / 2)
        text_artist.set_position((x, y))
        if is_point:  # it may lie over anything
            text_artist.set_bbox(
                {"facecolor": "white", "alpha": 0.85, "pad": 1, "edgecolor": "none"}
            )
        else:
            text_artist.set_path_effects([withStroke(linewidth=2, foreground="white", alpha=0.65)])
        if text == str(label.number):
            yield f"{label.number}: {escape_undrawable(label.key_text) or full_name}"


def _list_line_breaks(text: str) -> list[str]:
    """Return a text in one line and, if it has a space, ``_`` or ``-``, broken into two lines."""
    separators = " " if " " in text.strip() else "_-"
    break_indices = [
        index for index, letter in enumerate(text) if letter in separators and index > 0
    ]
    if not break_indices:
        return [text]
    middle_break_index = min(break_indices, key=lambda index: abs(index - len(text) / 2))
    first_line = f"{text[:middle_break_index]}{text[middle_break_index].strip()}"
    return [text, f"{first_line}\n{text[middle_break_index + 1 :]}"]


def _draw_legend(
    figure: Figure, panels: Sequence[Panel], color_of_kind: dict[str, str], has_route: bool
) -> Legend:
    """Add the legend of colours and lines below the maps, and make the figure higher for it.

    Args:
        figure: the figure.
        panels: the panels.
        color_of_kind: kind of mark, or what poses show -> its colour.
        has_route: whether a path is drawn.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    color_of_meaning: dict[str, str] = {}
    for panel in panels:
        color_of_meaning |= dict(panel.legend)
    line_kinds = {_find_door_line_kind(door.state) for panel in panels for door in panel.doors}
    line_kinds |= {
        _find_connection_line_kind(connection)
        for panel in panels
        for connection in panel.connections
    }
    if has_route:
        line_kinds.add("path, from o to x")
    legend_handles: list[Patch | Line2D] = [
        Patch(facecolor=color, edgecolor="#777777", linewidth=0.5, label=escape_undrawable(meaning))
        for meaning, color in (color_of_meaning | color_of_kind).items()
    ]
    legend_handles += [
        Line2D([], [], label=line_kind, **_make_line_style(line_kind))
        for line_kind in LINE_STROKES
        if line_kind in line_kinds
    ]
    max_entry_length = (
        max((len(str(handle.get_label())) for handle in legend_handles), default=1) + 6
    )
    max_columns = max(int(figure.get_figwidth() * LETTERS_PER_INCH / max_entry_length), 1)
    num_columns = min(max_columns, max(len(legend_handles), 1))
    num_rows = -(-len(legend_handles) // num_columns)
    figure.set_figheight(figure.get_figheight() + LINE_HEIGHT * num_rows)
    return figure.legend(
        handles=legend_handles,
        ncols=num_columns,
        loc="outside lower left",
        frameon=False,
        borderpad=0,
        fontsize=LEGEND_POINTS,
        handlelength=1.6,
        handletextpad=0.5,
        columnspacing=1.4,
        title=" ",
        title_fontsize=LEGEND_POINTS,
        alignment="left",
    )
