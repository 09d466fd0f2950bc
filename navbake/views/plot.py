"""Pictures of a grid: layers of each level, in world metres."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from navbake.errors import MissingDependencyError, QueryError
from navbake.formats.source import write_bytes
from navbake.navgrid.cells import check_level
from navbake.navgrid.colors import DOOR, DOORWAY, ROUTE
from navbake.navgrid.door_lines import DoorLine
from navbake.navgrid.grid import NavGrid
from navbake.runtime.paths.path import Path as Route
from navbake.views.color_scale import ColorScale, nice_step
from navbake.views.drawing import footer
from navbake.views.drawing.fonts import FONT, Text, find_text
from navbake.views.drawing.label_boxes import Written, place_labels
from navbake.views.drawing.layout import (
    BAR,
    BAR_GAP,
    HEADING,
    MARGIN,
    Layout,
    plan_layout,
)
from navbake.views.layers import color_kinds, make_panel
from navbake.views.panel import Panel, paint

# Functions import matplotlib when they draw: it is an extra, and takes half a second to load.

FORMATS = (".png", ".svg")
DEFAULT_LAYERS = ("occupancy", "floor")
DPI = 150  # of a PNG: 1.5 pixels for each of a README's
MAX_PIXELS = 65_000  # Agg draws at most 65,536 a side
MAX_CELLS = 1800  # along a side; of more, several are drawn as one, in their mean colour
HEADING_POINTS, TITLE_POINTS, TICK_POINTS = 10.5, 9.0, 7.5
INK, FAINT = "#222222", "#9aa0a8"
MOST_KEYS = 40  # entries of the key to the numbers in small rooms
NUM_TICKS, TICK_INCHES = 5, 0.35  # most steps on an axis, and the least length of one
DOOR_STROKES = {  # colours and widths [points], from below
    "closed": (("#ffffff", 4.2), (DOOR, 2.6)),
    "open": ((DOOR, 3.8), ("#ffffff", 1.6)),
}
ROUTE_STROKES = (("#ffffff", 3.4), (ROUTE, 1.8))


class Mark(NamedTuple):
    """A place to mark on a picture: level (-1 for all), world x and y [m], and what is there."""

    level: int
    x: float
    y: float
    kind: str


def plot_grid(
    grid: NavGrid,
    path: str | PathLike[str],
    *,
    level: int | None = None,
    layers: Sequence[str] = DEFAULT_LAYERS,
    route: Route | None = None,
    marks: Sequence[Mark] = (),
) -> Path:
    """Write a picture, whole or not at all, and return the path that was written.

    It is an SVG if the name ends in ``.svg``, else a PNG; see `render_png` for the arguments.
    """
    path = Path(path)
    form = "svg" if path.name.lower().endswith(".svg") else "png"
    content = _render(grid, form, level, layers, route, marks)
    write_bytes(content, path)
    return path


def render_png(
    grid: NavGrid,
    *,
    level: int | None = None,
    layers: Sequence[str] = DEFAULT_LAYERS,
    route: Route | None = None,
    marks: Sequence[Mark] = (),
) -> bytes:
    """Draw a grid as PNG; the same grid, the same bytes.

    A level has a row, the lowest is on top, and a layer a column; levels of one layer lie beside
    each other. All panels have one scale and show the same part of the world. Up is the world's
    +y. It is made to be read 830 pixels wide, as in a README.

    Args:
        grid: a grid of one or several levels.
        level: draw only this one, 0 is the lowest.
        layers: what to draw: names of `navbake.views.layers.LAYERS`.
        route: a path to draw on top, each of its parts on its level.
        marks: places to mark; those on no level are on all of them.

    Raises:
        QueryError: there is no such level or layer.
        MissingDependencyError: matplotlib is not installed.
    """
    return _render(grid, "png", level, layers, route, marks)


def render_svg(
    grid: NavGrid,
    *,
    level: int | None = None,
    layers: Sequence[str] = DEFAULT_LAYERS,
    route: Route | None = None,
    marks: Sequence[Mark] = (),
) -> bytes:
    """Draw a grid as SVG, which stays sharp at any size; see `render_png`."""
    return _render(grid, "svg", level, layers, route, marks)


def _render(
    grid: NavGrid,
    form: str,
    level: int | None,
    layers: Sequence[str],
    route: Route | None,
    marks: Sequence[Mark],
) -> bytes:
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as error:
        message = 'plots need matplotlib: pip install "navbake[plot]"'
        raise MissingDependencyError(message) from error

    check_level(level, len(grid.levels))
    chosen = list(range(len(grid.levels))) if level is None else [level]
    if not layers:
        raise QueryError("expected at least one layer to draw, got none")
    shown = [(number, make_panel(grid, layer, number)) for number in chosen for layer in layers]
    view = _View.of(grid, chosen)
    layout, lines, written = _plan(view, shown, len(layers), route, marks)
    # ids in an SVG are hashes, salted at random unless told not to; letters are drawn as shapes,
    # so that a picture looks alike where its fonts are missing
    with rc_context({"svg.hashsalt": "navbake", "svg.fonttype": "path", "font.family": FONT}):
        dpi = min(DPI, MAX_PIXELS / max(layout.height, layout.width))
        figure = Figure(figsize=(layout.width, layout.height), dpi=dpi, facecolor="white")
        _write_heading(figure, layout, grid)
        for place, (number, panel) in enumerate(shown):
            ax = _draw_panel(figure, panel, layout, place, view)
            _draw_map(ax, panel, grid.levels[number].lattice.bounds)
            _draw_doors(ax, panel.doors)
            if route is not None:
                _draw_route(ax, route, number)
            _draw_marks(ax, marks, number)
            _write_names(ax, written[place], layout)
        footer.draw_footer(figure, lines, MARGIN)
        content = io.BytesIO()
        metadata = {"Software": None} if form == "png" else {"Creator": None, "Date": None}
        figure.savefig(content, format=form, dpi=dpi, metadata=metadata)
    return content.getvalue()


class _View(NamedTuple):
    """The part of the world that all panels show [m]: the bounds of all levels."""

    x: float  # of the lower left corner
    y: float
    width: float
    height: float

    @classmethod
    def of(cls, grid: NavGrid, levels: Sequence[int]) -> _View:
        bounds = np.array([grid.levels[number].lattice.bounds for number in levels])
        x, y = bounds[:, :2].min(axis=0).tolist()
        right, top = bounds[:, 2:].max(axis=0).tolist()
        return cls(x, y, right - x, top - y)


def _plan(
    view: _View,
    shown: Sequence[tuple[int, Panel]],
    num_layers: int,
    route: Route | None,
    marks: Sequence[Mark],
) -> tuple[Layout, list[list[footer.Entry]], list[list[Written]]]:
    """Where the panels lie, what the lines below them say, and which names are where."""
    panels = [panel for _, panel in shown]
    scales = [[p.scale for p in panels[layer::num_layers]] for layer in range(num_layers)]
    bars = [any(scale and len(scale.ticks) > 1 for scale in column) for column in scales]
    num_levels = len(shown) // num_layers
    extent = view.width, view.height
    # the maps' scale doesn't follow from the footer but in very high pictures
    first = plan_layout(extent, num_levels, bars, footer=footer.LINE)
    scale = first.map_size[0] / view.width
    written = [
        place_labels(panel.labels, (view.x, view.y), scale, first.map_size) for panel in panels
    ]
    entries = _legend(panels, scale, route, marks)
    lines = footer.flow(entries, first.width - 2 * MARGIN)
    lines += footer.flow(_keys(written), first.width - 2 * MARGIN)
    height = footer.footer_height(lines)
    layout = plan_layout(extent, num_levels, bars, footer=height)
    return layout, lines, written


def _legend(
    panels: Sequence[Panel], scale: float, route: Route | None, marks: Sequence[Mark]
) -> list[footer.Entry]:
    entries = [footer.scale_entry(scale), footer.north_entry()]
    kinds = dict(entry for panel in panels for entry in panel.legend)
    states = {_drawn_state(mark) for panel in panels for mark in panel.doors}
    if states:  # lines stand for them in the legend
        kinds = {kind: color for kind, color in kinds.items() if color not in (DOOR, DOORWAY)}
    kinds |= color_kinds(mark.kind for mark in marks)
    entries += [footer.color_entry(find_text(kind), color) for kind, color in kinds.items()]
    entries += [
        footer.line_entry(Text(f"door, {state}"), strokes)
        for state, strokes in DOOR_STROKES.items()
        if state in states
    ]
    if route is not None:
        entries.append(footer.line_entry(Text("path, from o to x"), ROUTE_STROKES))
    return entries


def _keys(written: Sequence[Sequence[Written]]) -> list[footer.Entry]:
    """What the numbers in small rooms mean."""
    names = dict.fromkeys(f"{w.number}: {w.name}" for ws in written for w in ws if w.name)
    keys = [footer.Entry(find_text(name), 0.0, None) for name in list(names)[:MOST_KEYS]]
    if len(names) > MOST_KEYS:
        keys.append(footer.Entry(Text(f"and {len(names) - MOST_KEYS} more"), 0.0, None))
    return keys


def _write_heading(figure: Any, layout: Layout, grid: NavGrid) -> None:
    cell_size = grid.levels[0].lattice.cell_size
    facts = Text(f"cells of {cell_size:g} m")
    width = layout.width - 2 * MARGIN
    name = find_text(grid.scene_id or "grid")
    name = name.cut(HEADING_POINTS, width - facts.size(TICK_POINTS)[0] - 0.3)
    y = layout.height - HEADING / 2
    place = {"transform": figure.dpi_scale_trans, "va": "center_baseline", "color": INK}
    style = name.style(HEADING_POINTS) | place
    figure.text(MARGIN, y, name.text, fontweight="bold", **style)
    style = facts.style(TICK_POINTS) | place
    figure.text(layout.width - MARGIN, y, facts.text, ha="right", **style)


def _draw_panel(figure: Any, panel: Panel, layout: Layout, place: int, view: _View) -> Any:
    """Make the axes of a panel, with title and colour bar."""
    width, height = layout.map_size
    corner = layout.corners[place]
    title = find_text(panel.title).cut(TITLE_POINTS, layout.title_widths[place])
    figure.text(
        corner[0],
        corner[1] + height + 0.08,
        title.text,
        transform=figure.dpi_scale_trans,
        color=INK,
        **title.style(TITLE_POINTS),
    )
    ax = figure.add_axes(_share(layout, (*corner, width, height)))
    ax.set_xlim(view.x, view.x + view.width)
    ax.set_ylim(view.y, view.y + view.height)
    for axis, low, length, inches in (
        (ax.xaxis, view.x, view.width, width),
        (ax.yaxis, view.y, view.height, height),
    ):
        ticks, names = _ticks(low, length, inches)
        axis.set_ticks(ticks, names)
    ax.tick_params(labelsize=TICK_POINTS, length=2.5, width=0.6, color=FAINT, labelcolor=INK, pad=2)
    for spine in ax.spines.values():
        spine.set(edgecolor=FAINT, linewidth=0.6)
    if panel.scale is not None and len(panel.scale.ticks) > 1:
        _draw_bar(figure, panel.scale, layout, (corner[0] + width + BAR_GAP, corner[1]))
    return ax


def _share(layout: Layout, box: tuple[float, float, float, float]) -> list[float]:
    """A box of left, bottom, width and height [inches] as shares of the figure."""
    across, up = layout.width, layout.height
    return [box[0] / across, box[1] / up, box[2] / across, box[3] / up]


def _ticks(low: float, length: float, inches: float) -> tuple[list[float], list[str]]:
    """A few round numbers along an axis; the last one has the unit."""
    count = max(min(NUM_TICKS, int(inches / TICK_INCHES)), 1)
    step = nice_step(length / count)
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor((low + length) / step + 1e-9)
    numbers = list(range(first, last + 1)) if inches > 0.2 else []
    names = [
        f"{number * step + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}") for number in numbers
    ]
    if names:
        names[-1] += " m"
    return [number * step for number in numbers], names


def _draw_bar(figure: Any, scale: ColorScale, layout: Layout, corner: tuple[float, float]) -> None:
    """Draw a colour scale to the right of a map, the highest value on top."""
    height = max(layout.map_size[1], 0.4)
    ax = figure.add_axes(_share(layout, (*corner, BAR, height)))
    ax.imshow(scale.bar(256)[:, None], origin="lower", aspect="auto", extent=(0, 1, 0, 1))
    ax.set_xticks([])
    few = [
        tick for tick in scale.ticks if height > 0.8 or tick in (scale.ticks[0], scale.ticks[-1])
    ]
    names = [tick.text.replace("-", "\N{MINUS SIGN}") for tick in few]
    ax.set_yticks([tick.position for tick in few], names)
    ax.yaxis.tick_right()
    ax.tick_params(labelsize=TICK_POINTS, length=2, width=0.6, color=FAINT, labelcolor=INK, pad=2)
    for spine in ax.spines.values():
        spine.set_visible(False)


def _draw_map(ax: Any, panel: Panel, bounds: tuple[float, float, float, float]) -> None:
    """Draw the cells, row 0, the one of the largest y, on top."""
    image = Image.fromarray(paint(panel))
    image = image.reduce(max(1, -(-max(image.size) // MAX_CELLS)))
    x_min, y_min, x_max, y_max = bounds
    limits = ax.get_xlim(), ax.get_ylim()
    # nearest: cells have sharp edges; the others average where several share a pixel
    pixels = ax.get_window_extent().width / max(np.ptp(limits[0]), 1e-12) * (x_max - x_min)
    how = "nearest" if image.width <= pixels else "antialiased"
    ax.imshow(
        np.asarray(image), extent=(x_min, x_max, y_min, y_max), aspect="auto", interpolation=how
    )
    ax.set(xlim=limits[0], ylim=limits[1])


def _draw_doors(ax: Any, doors: Sequence[DoorLine]) -> None:
    """Draw doors from jamb to jamb: closed ones full, others hollow."""
    for door in doors:
        x, y = zip(door.start, door.end, strict=True)
        for color, width in DOOR_STROKES[_drawn_state(door)]:
            ax.plot(x, y, color=color, linewidth=width, solid_capstyle="butt")


def _drawn_state(door: DoorLine) -> str:
    return "closed" if door.state == "closed" else "open"


def _write_names(ax: Any, names: Sequence[Written], layout: Layout) -> None:
    from matplotlib.patheffects import withStroke

    width, height = layout.map_size
    halo = [withStroke(linewidth=2, foreground="white", alpha=0.65)]
    middle = {"ha": "center", "va": "center", "multialignment": "center"}
    for name in names:
        style = name.text.style(name.points) | middle | {"transform": ax.transAxes, "color": INK}
        written = ax.text(name.x / width, name.y / height, name.text.text, **style)
        if name.is_beside:  # it may lie over anything
            written.set_bbox({"facecolor": "white", "alpha": 0.85, "pad": 1, "edgecolor": "none"})
        else:
            written.set_path_effects(halo)


def _draw_route(ax: Any, route: Route, level: int) -> None:
    """Draw the parts of a path that are on a level, and its ends."""
    on_level = route.levels == level
    x = np.where(on_level, route.positions[:, 0], np.nan)
    y = np.where(on_level, route.positions[:, 1], np.nan)
    for color, width in ROUTE_STROKES:
        ax.plot(x, y, color=color, linewidth=width, solid_joinstyle="round")
    for end, marker in ((0, "o"), (-1, "X")):
        if on_level[end]:
            style = {"color": ROUTE, "markeredgecolor": "white", "markersize": 8, "clip_on": False}
            ax.plot(x[end], y[end], marker, **style)


def _draw_marks(ax: Any, marks: Sequence[Mark], level: int) -> None:
    """Draw the marks of a level, one colour for each kind."""
    here = [mark for mark in marks if mark.level in (level, -1)]
    for kind, color in color_kinds(mark.kind for mark in marks).items():
        places = np.array([(mark.x, mark.y) for mark in here if mark.kind == kind])
        if len(places):
            ax.plot(*places.T, "s", color=color, markersize=5, markerfacecolor="none", mew=1.2)
