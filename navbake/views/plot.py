"""Pictures of a grid: layers of each level, in world metres."""

import io
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from navbake.errors import MissingDependencyError, NavbakeError, QueryError, printable
from navbake.files import write_whole
from navbake.navgrid.cells import check_level
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.runtime.paths.path import Path as Route
from navbake.views.colors import MARKS, ROUTE
from navbake.views.layers import make_panels
from navbake.views.panel import Label, Panel, paint

# Functions import matplotlib when they draw: it is an extra, and takes half a second to load.

DEFAULT_LAYERS = ("occupancy", "floor")
COLOR_MAP = "viridis"
MIN_RANGE = 0.1  # least span of a colour scale, so that flat floors look flat [m]
DPI = 150
PANEL_INCHES = 6.0  # longer side of a panel
MIN_PANEL_INCHES = 3.0  # shorter side of one
MAX_FIGURE_INCHES = 300.0  # Agg draws at most 65,536 pixels a side
FONT_SIZES = (3.0, 9.0)  # points, of names in rooms
LETTER = 0.6  # width of a letter, by its size
FONT = "DejaVu Sans"  # comes with matplotlib


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
    """Write what `render_png` draws, whole or not at all, and return the path that was written."""
    path = Path(path)
    content = render_png(grid, level=level, layers=layers, route=route, marks=marks)
    try:
        write_whole(content, path)
    except OSError as error:
        raise NavbakeError(f"cannot write {path}: {error.strerror}") from error
    return path


def render_png(
    grid: NavGrid,
    *,
    level: int | None = None,
    layers: Sequence[str] = DEFAULT_LAYERS,
    route: Route | None = None,
    marks: Sequence[Mark] = (),
) -> bytes:
    """Draw a grid as PNG: a row for each level, lowest on top; the same grid, the same bytes.

    Args:
        grid: a grid of one or several levels.
        level: draw only this one, 0 is the lowest.
        layers: what to draw, a column each: occupancy, floor, rooms, clearance, island, weights.
        route: a path to draw on top, each of its parts on its level.
        marks: places to mark; those on no level are on all of them.

    Raises:
        QueryError: there is no such level or layer.
        MissingDependencyError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        message = 'plots need matplotlib: pip install "navbake[plot]"'
        raise MissingDependencyError(message) from error

    check_level(level, len(grid.levels))
    chosen = range(len(grid.levels)) if level is None else [level]
    if not layers:
        raise QueryError("expected at least one layer to draw, got none")
    columns = [make_panels(grid, layer) for layer in layers]
    # all panels span the bounds of all levels, so that a place is in line on all of them
    bounds = np.array([grid.levels[index].lattice.bounds for index in chosen])
    x_min, y_min = bounds[:, :2].min(axis=0).tolist()
    x_max, y_max = bounds[:, 2:].max(axis=0).tolist()
    size = _figure_size(x_max - x_min, y_max - y_min, len(chosen), len(layers))
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    axes = figure.subplots(len(chosen), len(layers), squeeze=False)
    for row, index in zip(axes, chosen, strict=True):
        for ax, panels in zip(row, columns, strict=True):
            _draw_panel(figure, ax, panels[index], grid.levels[index])
            ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), xlabel="x [m]", ylabel="y [m]")
            _write_labels(ax, panels[index].labels, max(x_max - x_min, y_max - y_min))
            if route is not None:
                _draw_route(ax, route, index)
            _draw_marks(ax, marks, index)
    cell_size = grid.levels[0].lattice.cell_size
    figure.suptitle(
        f"{printable(grid.scene_id or 'grid')}, cells of {cell_size:g} m", parse_math=False
    )
    _draw_legend(figure, [panels[index] for panels in columns for index in chosen], route, marks)

    content = io.BytesIO()
    figure.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()


def _figure_size(width: float, height: float, rows: int, cols: int) -> tuple[float, float]:
    scale = PANEL_INCHES / max(width, height)
    # the constants are inches for the labels of axes, the title and the legend
    panel_width = max(width * scale, MIN_PANEL_INCHES) + 0.9
    panel_height = max(height * scale, MIN_PANEL_INCHES) + 0.8
    return cols * panel_width + 0.8, min(rows * panel_height + 0.8, MAX_FIGURE_INCHES)


def _draw_panel(figure: Any, ax: Any, panel: Panel, level: SceneGrid2D) -> None:
    x_min, y_min, x_max, y_max = level.lattice.bounds
    rgb = paint(panel)
    ax.imshow(rgb, extent=(x_min, x_max, y_min, y_max))  # row 0, the top one, has the largest y
    ax.set_title(panel.title, fontsize="medium", parse_math=False)


def _write_labels(ax: Any, labels: Sequence[Label], longer_side: float) -> None:
    """Write names in the middle of their rooms, in a size that fits the room's width."""
    for label in labels:
        font = _font_for(label.text)
        text = label.text if font else label.fallback
        points = label.width * PANEL_INCHES / longer_side * 72 / (LETTER * len(text))
        style = {"fontfamily": font or FONT, "fontsize": float(np.clip(points, *FONT_SIZES))}
        centred = {"ha": "center", "va": "center"}
        ax.text(label.x, label.y, text, **style, **centred, clip_on=True, parse_math=False)


def _font_for(text: str) -> str | None:
    """An installed font that has all letters of a text, or None."""
    from matplotlib import font_manager

    wanted = {ord(letter) for letter in text if not letter.isspace()}
    fonts = font_manager.fontManager.ttflist
    for font in sorted(fonts, key=lambda font: (font.name != FONT, font.name, font.fname)):
        try:
            letters = font_manager.get_font(font.fname).get_charmap()
        except (OSError, RuntimeError):  # matplotlib's list names a font that was removed
            continue
        if wanted <= letters.keys():
            return str(font.name)
    return None


def _draw_route(ax: Any, route: Route, level: int) -> None:
    """Draw the parts of a path that are on a level, and its ends."""
    x, y = route.positions[:, 0], route.positions[:, 1]
    on_level = route.levels == level
    ax.plot(np.where(on_level, x, np.nan), np.where(on_level, y, np.nan), color=ROUTE, lw=1.5)
    for end, marker in ((0, "o"), (-1, "X")):
        if on_level[end]:
            ax.plot(x[end], y[end], marker, color=ROUTE, markeredgecolor="white", markersize=8)


def _draw_marks(ax: Any, marks: Sequence[Mark], level: int) -> None:
    """Draw the marks of a level, one colour for each kind."""
    here = [mark for mark in marks if mark.level in (level, -1)]
    for kind, color in _colors_of(marks).items():
        places = np.array([(mark.x, mark.y) for mark in here if mark.kind == kind])
        if len(places):
            ax.plot(*places.T, "s", color=color, markersize=5, markerfacecolor="none", mew=1.2)


def _colors_of(marks: Sequence[Mark]) -> dict[str, str]:
    kinds = sorted({mark.kind for mark in marks})
    return {kind: MARKS[number % len(MARKS)] for number, kind in enumerate(kinds)}


def _draw_legend(
    figure: Any, panels: Sequence[Panel], route: Route | None, marks: Sequence[Mark]
) -> None:
    from matplotlib.patches import Patch

    kinds = dict(entry for panel in panels for entry in panel.legend)
    patches = [
        Patch(facecolor=color, edgecolor="black", label=kind) for kind, color in kinds.items()
    ]
    if route is not None:
        patches.append(Patch(facecolor=ROUTE, label="path, from o to x"))
    patches += [Patch(facecolor=c, label=kind) for kind, c in _colors_of(marks).items()]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches))
