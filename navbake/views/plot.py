"""Pictures of a grid: layers of each level, in world metres."""

from __future__ import annotations

import io
import math
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from navbake.errors import MissingDependencyError, QueryError, printable
from navbake.formats.source import write_bytes
from navbake.navgrid.cells import check_level
from navbake.navgrid.colors import DOOR, DOORWAY, ROUTE
from navbake.navgrid.grid import NavGrid
from navbake.runtime.paths import Path as Route
from navbake.views.layers import ColorScale, Label, Panel, color_kinds, make_panel, paint

# Functions import matplotlib when they draw: it is an extra, and takes half a second to load.

FORMATS = (".png", ".svg")
DEFAULT_LAYERS = ("occupancy", "floor")
DPI = 150  # of a PNG: 1.5 pixels for each of a README's
MAX_PIXELS = 65_000  # Agg draws at most 65,536 a side
MAX_CELLS = 1800  # along a side; of more, several are drawn as one, in their mean colour
MAX_COLUMNS = 3
WIDE = 2.4  # maps so much wider than high lie below each other

# Lengths in inches. A picture is 8.3 inches wide at most, 830 pixels of a README at 100 an inch:
# letters of 8 points are 11 pixels high there.
WIDTH, MAX_HEIGHT, MIN_WIDTH = 8.3, 290.0, 4.6
MARGIN, HEADING = 0.12, 0.4
LEFT, RIGHT, BELOW, TITLE = 0.42, 0.14, 0.3, 0.27  # round a map
BAR, BAR_GAP, BAR_NUMBERS = 0.1, 0.08, 0.46  # the bar of a colour scale and its numbers
MAX_MAP_HEIGHT, MIN_MAP, MIN_PANEL = 5.6, 0.02, 2.3

HEADING_POINTS, TITLE_POINTS, LEGEND_POINTS, TICK_POINTS = 10.5, 9.0, 8.0, 7.5
NAME_POINTS, NUMBER_POINTS = (9.0, 8.0, 7.0), (8.0, 7.0, 6.0)  # sizes that are tried
POINT = 12  # half a side of what a point's name keeps clear of [pixels]
MOST_LETTERS, MOST_KEYS = 40, 40  # of a name on a map; names in the key to numbers
KEY_LETTERS = 130  # a line of the key
FONT = "DejaVu Sans"  # comes with matplotlib
INK, FAINT = "#222222", "#9aa0a8"
STROKES = {  # colours and widths [points] of lines, from below
    "door, closed": (("#ffffff", 4.2), (DOOR, 2.6)),
    "door, open": ((DOOR, 3.8), ("#ffffff", 1.6)),
    "path, from o to x": (("#ffffff", 3.4), (ROUTE, 1.8)),
}


class Mark(NamedTuple):
    """A place to mark on a picture: level (-1 for all), world x and y [m], and what is there."""

    level: int
    x: float
    y: float
    kind: str


def plot_grid(grid: NavGrid, path: str | PathLike[str], **drawn: Any) -> Path:
    """Write a picture, whole or not at all, and return the path that was written.

    It is an SVG if the name ends in ``.svg``, else a PNG; see `render_picture` for the arguments.
    """
    path = Path(path)
    form = "svg" if path.name.lower().endswith(".svg") else "png"
    write_bytes(render_picture(grid, form, **drawn), path)
    return path


def plot(
    grid: NavGrid, path: str | PathLike[str] | None = None, **drawn: Any
) -> Image.Image | Path:
    """Draw a grid: an image, which notebooks show and which has ``show()``; see `render_picture`.

    With a path, the picture is written there, and the path returned; see `plot_grid`.
    """
    if path is not None:
        return plot_grid(grid, path, **drawn)
    return Image.open(io.BytesIO(render_picture(grid, **drawn)))


def render_picture(
    grid: NavGrid,
    form: str = "png",
    *,
    level: int | None = None,
    layers: Sequence[str] = DEFAULT_LAYERS,
    route: Route | None = None,
    marks: Sequence[Mark] = (),
) -> bytes:
    """Draw a grid as PNG, or as SVG, which stays sharp at any size; the same grid, the same bytes.

    A level has a row, the lowest is on top, and a layer a column; levels of one layer lie beside
    each other. All panels have one scale and show the same part of the world. Up is the world's
    +y. It is made to be read 830 pixels wide, as in a README.

    Args:
        grid: a grid of one or several levels.
        form: ``png`` or ``svg``.
        level: draw only this one, 0 is the lowest.
        layers: what to draw: names of `navbake.views.layers.LAYERS`.
        route: a path to draw on top, each of its parts on its level.
        marks: places to mark; those on no level are on all of them.

    Raises:
        QueryError: there is no such level or layer.
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
    chosen = list(range(len(grid.levels))) if level is None else [level]
    if not layers:
        raise QueryError("expected at least one layer to draw, got none")
    shown = [(number, make_panel(grid, layer, number)) for number in chosen for layer in layers]
    panels = [panel for _, panel in shown]
    kinds = color_kinds(mark.kind for mark in marks)
    bounds = np.array([grid.levels[number].lattice.bounds for number in chosen])
    view = (*bounds[:, :2].min(axis=0).tolist(), *bounds[:, 2:].max(axis=0).tolist())
    texts = [grid.scene_id or "", *kinds, *(panel.title for panel in panels)]
    texts += [label.text for panel in panels for label in panel.labels]
    families, missing = find_fonts("".join(texts))
    # ids in an SVG are hashes, salted at random unless told not to; letters are drawn as shapes,
    # so that a picture looks alike where its fonts are missing; no name is markup
    settings: Any = {"svg.hashsalt": "navbake", "svg.fonttype": "path", "text.parse_math": False}
    settings |= {"font.family": families, "text.color": INK}
    with rc_context(settings), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        figure: Any = Figure(facecolor="white")
        FigureCanvasAgg(figure)
        axes = add_axes(figure, view, panels, len(layers))
        _write_heading(figure, grid)
        keys: dict[str, None] = {}
        for ax, (number, panel) in zip(axes, shown, strict=True):
            _draw_panel(ax, panel, grid.levels[number].lattice.bounds)
            if route is not None:
                _draw_route(ax, route, number)
            for mark in marks:
                if mark.level in (number, -1):
                    style = {"color": kinds[mark.kind], "markersize": 5, "mew": 1.2}
                    ax.plot(mark.x, mark.y, "s", markerfacecolor="none", **style)
            labels = [
                label._replace(text=label.fallback) if missing & {*label.text} else label
                for label in panel.labels
            ]
            keys |= dict.fromkeys(write_names(ax, labels))
        _draw_legend(figure, panels, kinds, list(keys), route is not None)
        content = io.BytesIO()
        metadata = {"Software": None} if form == "png" else {"Creator": None, "Date": None}
        # the legend hangs below the figure, which grows by it
        box = figure.get_tightbbox().padded(MARGIN)
        figure.savefig(content, format=form, dpi=figure.dpi, metadata=metadata, bbox_inches=box)
    return content.getvalue()


def find_fonts(text: str) -> tuple[list[str], set[str]]:
    """Families of installed fonts that have the letters of a text, and letters that none has."""
    from matplotlib import font_manager

    families, missing = [FONT], {letter for letter in printable(text) if letter > "~"}
    # a Last Resort font has a box for every letter
    fonts = [f for f in font_manager.fontManager.ttflist if not f.name.startswith("Last Resort")]
    for font in sorted(fonts, key=lambda font: (font.name != FONT, font.name, font.fname)):
        if not missing:
            break
        try:
            known = {*map(chr, font_manager.get_font(font.fname).get_charmap())}
        except (OSError, RuntimeError):  # matplotlib's list names a font that was removed
            continue
        if missing & known and font.name not in families:
            families.append(font.name)
        missing -= known
    return families, missing


def _bar_of(panel: Panel) -> ColorScale | None:
    """The scale of values that a panel shows beside its map."""
    return panel.scale if panel.scale is not None and len(panel.scale.ticks) > 1 else None


def add_axes(
    figure: Any, view: tuple[float, float, float, float], panels: Sequence[Panel], num_layers: int
) -> list[Any]:
    """Give a figure its size and each panel a place: the layers of a level in a row, if they fit.

    Levels of one layer lie beside each other. Corridors lie below each other, as wide as the
    picture.
    """
    wide, high = view[2] - view[0], view[3] - view[1]
    in_line = num_layers if num_layers > 1 else len(panels)
    columns = 1 if wide > WIDE * high else min(in_line, MAX_COLUMNS)
    rows_each = math.ceil(in_line / columns)  # of a level, or of all
    rows, around_y = rows_each * (len(panels) // in_line), TITLE + BELOW
    around_x = np.full(columns, LEFT + RIGHT)
    for number, panel in enumerate(panels):
        if _bar_of(panel):
            around_x[number % in_line % columns] = LEFT + RIGHT + BAR_GAP + BAR + BAR_NUMBERS
    most_wide = (WIDTH - 2 * MARGIN - around_x.sum()) / columns
    most_high = min(MAX_MAP_HEIGHT, (MAX_HEIGHT - HEADING) / rows - around_y)
    scale = min(most_wide / wide, max(most_high, MIN_MAP) / high)
    size = max(wide * scale, MIN_MAP), max(high * scale, MIN_MAP)
    slots = np.maximum(size[0] + around_x, min(MIN_PANEL, (WIDTH - 2 * MARGIN) / columns))
    width = max(slots.sum(), MIN_WIDTH - 2 * MARGIN)
    height = rows * (size[1] + around_y) + HEADING
    figure.set_size_inches(width, height)
    figure.set_dpi(min(DPI, MAX_PIXELS / max(width, height)))
    axes = []
    for number in range(len(panels)):
        row, column = divmod(number % in_line, columns)
        row += number // in_line * rows_each
        left, top = slots[:column].sum() + LEFT, height - HEADING - row * (size[1] + around_y)
        bottom = top - TITLE - size[1]
        place = left / width, bottom / height, size[0] / width, size[1] / height
        axes.append(figure.add_axes(place, xlim=view[::2], ylim=view[1::2]))
        axes[-1].panel_width = slots[column] - LEFT - RIGHT  # what its title has
    return axes


def _write_heading(figure: Any, grid: NavGrid) -> None:
    style = {"y": 1 - HEADING / 2 / figure.get_figheight(), "va": "center_baseline"}
    facts = f"cells of {grid.levels[0].lattice.cell_size:g} m, axes in metres"
    figure.text(1, s=facts, ha="right", fontsize=TICK_POINTS, **style)
    name = printable(grid.scene_id or "grid")
    written = figure.text(0, s=name, fontsize=HEADING_POINTS, fontweight="bold", **style)
    _cut(written, figure.get_figwidth() - 2.6)


def _cut(text: Any, width: float) -> None:
    """Leave out the end of a text that is wider than so much [inches]."""
    whole, dpi = text.get_text(), text.get_figure().dpi
    kept = len(whole)
    while kept > 1 and text.get_window_extent().width > width * dpi:
        kept = min(kept - 1, int(kept * width * dpi / text.get_window_extent().width))
        text.set_text(f"{whole[:kept].rstrip()}…")


def _draw_panel(ax: Any, panel: Panel, bounds: tuple[float, float, float, float]) -> None:
    """Draw title, cells and doors, and the colour bar of a panel."""
    from matplotlib.ticker import MaxNLocator

    width = ax.get_window_extent().width
    title = ax.set_title(printable(panel.title), loc="left", fontsize=TITLE_POINTS, pad=5)
    _cut(title, ax.panel_width)
    for axis, length in ((ax.xaxis, width), (ax.yaxis, ax.get_window_extent().height)):
        steps = max(min(5, int(length / DPI / 0.35)), 1)
        axis.set_major_locator(MaxNLocator(steps, steps=[1, 2, 5, 10]))
        axis.set_visible(length > 0.2 * DPI)
    ax.tick_params(labelsize=TICK_POINTS, length=2.5, width=0.6, color=FAINT, labelcolor=INK, pad=2)
    ax.spines[:].set(edgecolor=FAINT, linewidth=0.6)
    scale = _bar_of(panel)
    if scale is not None:
        _draw_bar(ax, scale)
    image = Image.fromarray(paint(panel))
    image = image.reduce(max(1, -(-max(image.size) // MAX_CELLS)))
    x_min, y_min, x_max, y_max = bounds
    limits = ax.get_xlim(), ax.get_ylim()
    # nearest: cells have sharp edges; the others average where several share a pixel
    pixels = width / max(np.ptp(limits[0]), 1e-12) * (x_max - x_min)
    how = "nearest" if image.width <= pixels else "antialiased"
    extent = (x_min, x_max, y_min, y_max)
    ax.imshow(np.asarray(image), extent=extent, aspect="auto", interpolation=how)
    ax.set(xlim=limits[0], ylim=limits[1])
    for door in panel.doors:
        x, y = zip(door.start, door.end, strict=True)
        ax.plot(x, y, **_strokes(_door_line(door.state)), solid_capstyle="butt")


def _draw_bar(ax: Any, scale: ColorScale) -> None:
    """Draw a colour scale to the right of a map, the highest value on top."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap

    figure, box = ax.get_figure(), ax.get_position()
    across, up = figure.get_size_inches()
    height = max(box.height, 0.4 / up)
    place = box.x1 + BAR_GAP / across, box.y0, BAR / across, height
    few = scale.ticks if height * up > 0.8 else (scale.ticks[0], scale.ticks[-1])
    bar = figure.colorbar(
        ScalarMappable(cmap=ListedColormap(scale.bar(256) / 255)), cax=figure.add_axes(place)
    )
    numbers = [tick.text.replace("-", "\N{MINUS SIGN}") for tick in few]
    bar.set_ticks([tick.position for tick in few], labels=numbers)
    bar.ax.tick_params(labelsize=TICK_POINTS, length=2, width=0.6, color=FAINT, pad=2)
    bar.outline.set_visible(False)


def _strokes(name: str) -> dict[str, Any]:
    """The style of a line of several strokes over each other, by its name in `STROKES`."""
    from matplotlib.patheffects import Stroke

    drawn = [Stroke(linewidth=width, foreground=color) for color, width in STROKES[name]]
    return {"path_effects": drawn, "linewidth": max(width for _, width in STROKES[name])}


def _door_line(state: str) -> str:
    return "door, closed" if state == "closed" else "door, open"


def _draw_route(ax: Any, route: Route, level: int) -> None:
    """Draw the parts of a path that are on a level, and its ends."""
    on_level = route.levels == level
    x, y = np.where(on_level, route.positions[:, :2].T, np.nan)
    ax.plot(x, y, **_strokes("path, from o to x"), solid_joinstyle="round")
    for end, marker in ((0, "o"), (-1, "X")):
        style = {"color": ROUTE, "markeredgecolor": "white", "markersize": 8, "clip_on": False}
        ax.plot(x[end], y[end], marker, **style)


def write_names(ax: Any, labels: Sequence[Label]) -> Iterator[str]:
    """Write names on a map, those of large rooms first, none over another; yields the key.

    A name stands in the middle of its room, in one line or two, as large as fits; that of a point
    stands beside it. Where it doesn't fit, a number does, which the key explains. Where not even
    that fits, nothing does.
    """
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import Bbox

    to_pixels, frame = ax.transData, ax.get_window_extent()
    scale = frame.width / np.ptp(ax.get_xlim())  # pixels a metre
    points = [to_pixels.transform((label.x, label.y)) for label in labels if not label.width]
    taken = [Bbox([at - POINT, at + POINT]) for at in points]
    for label in sorted(labels, key=lambda label: -label.width * label.height):
        whole, is_point = printable(label.text), not label.width
        name = whole if len(whole) <= MOST_LETTERS else f"{whole[:MOST_LETTERS]}…"
        middle = to_pixels.transform((label.x, label.y))
        room = np.array([label.width, label.height]) * scale if not is_point else np.inf
        sizes = NAME_POINTS[-1:] if is_point else NAME_POINTS
        forms = [(text, size) for size in sizes for text in _broken(name)]
        forms += [(str(label.number), size) for size in NUMBER_POINTS]
        written = ax.text(label.x, label.y, "", ha="center", va="center", linespacing=1.05)
        for text, size in forms:
            written.set(text=text, fontsize=size)
            extent = np.array(written.get_window_extent().size)
            half = extent / 2 + 3
            away = half + POINT + 1  # above, below, to the right or to the left of a point
            ways = [(0, 1), (0, -1), (1, 0), (-1, 0)] if is_point else [(0, 0)]
            # moved so that it lies on the map
            moved = [np.clip(middle + way * away, frame.p0 + half, frame.p1 - half) for way in ways]
            boxes = [Bbox([at - half, at + half]) for at in moved]
            free = [box for box in boxes if not any(box.overlaps(each) for each in taken)]
            if free and (extent <= room).all() and (2 * half <= frame.size).all():
                break
        else:
            written.remove()
            continue
        taken.append(free[0])
        written.set_position(to_pixels.inverted().transform((free[0].p0 + free[0].p1) / 2))
        if is_point:  # it may lie over anything
            written.set_bbox({"facecolor": "white", "alpha": 0.85, "pad": 1, "edgecolor": "none"})
        else:
            written.set_path_effects([withStroke(linewidth=2, foreground="white", alpha=0.65)])
        if text == str(label.number):
            yield f"{label.number}: {whole}"


def _broken(text: str) -> list[str]:
    """A text in one line, and in two if it has words to break between."""
    letters = " " if " " in text.strip() else "_-"
    breaks = [at for at, letter in enumerate(text) if letter in letters and at > 0]
    if not breaks:
        return [text]
    at = min(breaks, key=lambda at: abs(at - len(text) / 2))
    return [text, f"{text[:at]}{text[at].strip()}\n{text[at + 1 :]}"]


def _draw_legend(
    figure: Any,
    panels: Sequence[Panel],
    kinds: dict[str, str],
    keys: list[str],
    with_route: bool,
) -> None:
    """Say below the maps what colours, lines and numbers mean, as wide as the figure."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    meanings = dict(entry for panel in panels for entry in panel.legend)
    lines = {_door_line(door.state) for panel in panels for door in panel.doors}
    if lines:  # they stand for doors in the legend
        meanings = {name: c for name, c in meanings.items() if c not in (DOOR, DOORWAY)}
    lines |= {"path, from o to x"} if with_route else set()
    entries: list[Any] = [
        Patch(facecolor=color, edgecolor="#777777", linewidth=0.5, label=printable(name))
        for name, color in (meanings | kinds).items()
    ]
    entries += [Line2D([], [], label=name, **_strokes(name)) for name in STROKES if name in lines]
    more = [f"and {len(keys) - MOST_KEYS} more"] if len(keys) > MOST_KEYS else []
    key = "   ".join(entry.replace(" ", "\N{NO-BREAK SPACE}") for entry in keys[:MOST_KEYS] + more)
    width = figure.get_window_extent().width
    style = {"loc": "upper left", "bbox_to_anchor": (0, 0), "frameon": False, "borderpad": 0}
    style |= {"fontsize": LEGEND_POINTS, "handlelength": 1.6, "handletextpad": 0.5}
    for columns in range(len(entries), 0, -1):
        legend = figure.legend(handles=entries, ncols=columns, columnspacing=1.4, **style)
        if legend.get_window_extent().width <= width or columns == 1:
            break
        legend.remove()
    if key:
        lines_of_key = textwrap.fill(key, int(KEY_LETTERS * width / DPI / WIDTH))
        legend.set_title(lines_of_key, {"size": LEGEND_POINTS})
        legend.set_alignment("left")
