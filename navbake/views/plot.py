"""Pictures of a grid: layers of each level, in world metres."""

from __future__ import annotations

import io
import itertools
import math
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from PIL import Image

from navbake.errors import MissingDependencyError, QueryError, printable
from navbake.formats.source import write_bytes
from navbake.navgrid.cells import check_level
from navbake.navgrid.colors import DOOR, DOORWAY, LINK, ROUTE
from navbake.navgrid.grid import NavGrid
from navbake.runtime.paths import Path as Route
from navbake.views.describe import Connection
from navbake.views.layers import Label, Panel, colors_of_kinds, make_panel, paint

# Functions import matplotlib when they draw: it is an extra, and takes half a second to load.

DEFAULT_LAYERS = ("occupancy", "floor")
DPI = 150  # of a PNG: 1.5 pixels for each of a README's
MAX_COLUMNS = 3
WIDE = 2.4  # maps so much wider than high lie below each other
LONGEST = 40.0  # times its other side that a map is long at most: the world goes on beside it

# Lengths in inches. A picture is 8.3 inches wide at most, 830 pixels of a README at 100 an inch:
# letters of 8 points are 11 pixels high there.
WIDTH = 8.3
MAX_HEIGHT = 290.0
MIN_WIDTH = 4.6
# AROUND: ticks, title and colour bar
MAX_MAP_HEIGHT = 5.6
AROUND_X = 1.1
AROUND_Y = 0.65
LINE = 0.2  # a line of the heading or the legend
LETTERS = 13  # of a title or a legend in an inch

HEADING_POINTS = 10.5
TITLE_POINTS = 9.0
LEGEND_POINTS = 8.0
TICK_POINTS = 7.5
# sizes that are tried
NAME_POINTS = (9.0, 8.0, 7.0)
NUMBER_POINTS = (8.0, 7.0, 6.0)
POINT = 12  # half a side of what a point's name keeps clear of [pixels]
# of a name on a map; names in the key to numbers
MOST_LETTERS = 40
MOST_KEYS = 40
FONT = "DejaVu Sans"  # comes with matplotlib
INK = "#222222"
FAINT = "#9aa0a8"
STROKES = {  # colours and widths [points] of lines, from below
    "door, closed": (("#ffffff", 4.2), (DOOR, 2.6)),
    "door, open": ((DOOR, 3.8), ("#ffffff", 1.6)),
    "path, from o to x": (("#ffffff", 3.4), (ROUTE, 1.8)),
    "link": (("#ffffff", 3.2), (LINK, 1.6)),
    "link, closed": (("#ffffff", 3.2), (FAINT, 1.6)),
    "stairs": (("#ffffff", 2.8), (INK, 1.0)),
}


Mark: TypeAlias = tuple[int, float, float, str]
"""A place to mark on a picture: level (-1 for all), world x and y [m], and what is there."""


def plot_grid(grid: NavGrid, path: str | PathLike[str], **drawn: Any) -> Path:
    """Write the picture of `render_picture`, an SVG if the name says so, else a PNG."""
    path = Path(path)
    form = "svg" if path.name.lower().endswith(".svg") else "png"
    write_bytes(render_picture(grid, form, **drawn), path)
    return path


def plot(grid: NavGrid, path: str | PathLike[str] | None = None, **more: Any) -> Image.Image | Path:
    """Draw a grid: an image, which notebooks show and which has ``show()``; see `render_picture`.

    With a path, the picture is written there, and the path returned; see `plot_grid`.
    """
    if path is not None:
        return plot_grid(grid, path, **more)
    return Image.open(io.BytesIO(render_picture(grid, **more)))


def render_picture(
    grid: NavGrid,
    form: str = "png",
    *,
    level: int | None = None,
    layers: Sequence[str] = DEFAULT_LAYERS,
    route: Route | None = None,
    marks: Sequence[Mark] = (),
) -> bytes:
    """Draw a grid as PNG or SVG; the same grid, the same bytes.

    A level has a row, the lowest is on top, and a layer a column; levels of one layer lie beside
    each other. All panels have one scale and show the same part of the world, +y up.

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
        from matplotlib.transforms import Bbox
    except ImportError as error:
        message = 'plots need matplotlib: pip install "navbake[plot]"'
        raise MissingDependencyError(message) from error

    check_level(level, len(grid.levels))
    chosen = list(range(len(grid.levels))) if level is None else [level]
    if not layers:
        raise QueryError("expected at least one layer to draw, got none")
    shown = [(number, make_panel(grid, layer, number)) for number in chosen for layer in layers]
    panels = [panel for _, panel in shown]
    kinds = colors_of_kinds(kind for *_, kind in marks)
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
        figure: Any = Figure(facecolor="white", dpi=DPI)
        FigureCanvasAgg(figure)
        axes = add_axes(figure, view, panels, len(layers))
        name = wrap(grid.scene_id or "grid", figure.get_figwidth())
        figure.suptitle(name, x=0.01, ha="left", fontsize=HEADING_POINTS, fontweight="bold")
        for ax, (number, panel) in zip(axes, shown, strict=True):
            _draw_panel(ax, panel, grid.levels[number].lattice.bounds)
            if route is not None:  # its parts on the level, and its ends
                x, y = np.where(route.levels == number, route.positions[:, :2].T, np.nan)
                ax.plot(x, y, **_strokes("path, from o to x"), solid_joinstyle="round")
                style = {"color": ROUTE, "markeredgecolor": "white", "markersize": 8}
                for end, marker in ((0, "o"), (-1, "X")):
                    ax.plot(x[end], y[end], marker, clip_on=False, **style)
            for on, x, y, kind in marks:
                if on in (number, -1):
                    style = {"color": kinds[kind], "markersize": 5, "mew": 1.2}
                    ax.plot(x, y, "s", markerfacecolor="none", **style)
        legend = _draw_legend(figure, panels, kinds, route is not None)
        figure.draw_without_rendering()  # the layout: names need to know how large rooms are
        figure.set_layout_engine("none")
        keys: dict[str, None] = {}
        for ax, panel in zip(axes, panels, strict=True):
            labels = [
                label._replace(text=label.fallback) if missing & {*label.text} else label
                for label in panel.labels
            ]
            keys |= dict.fromkeys(write_names(ax, labels))
        more = [f"and {len(keys) - MOST_KEYS} more"] if len(keys) > MOST_KEYS else []
        entries = [e.replace(" ", "\N{NO-BREAK SPACE}") for e in [*keys][:MOST_KEYS] + more]
        facts = f"cells of {grid.levels[0].lattice.cell_size:g} m, axes in metres"
        text = wrap("   ".join([facts, *entries]), figure.get_figwidth() * 1.2, lines=99)
        legend.set_title(text, {"size": LEGEND_POINTS})
        own = [
            (ax, number)
            for ax, (number, panel) in zip(axes, shown, strict=True)
            if panel.connections
        ]
        _draw_ways(figure, {number: ax for ax, number in own}, panels)
        content = io.BytesIO()
        metadata = {"Software": None} if form == "png" else {"Creator": None, "Date": None}
        # lines of the key hang below the figure, which grows by them
        low = min(0.0, legend.get_window_extent().y0 / DPI - LINE / 2)
        box = Bbox([[0, low], figure.get_size_inches()])
        figure.savefig(content, format=form, metadata=metadata, bbox_inches=box)
    return content.getvalue()


def find_fonts(text: str) -> tuple[list[str], set[str]]:
    """Families of installed fonts that have the letters of a text, and letters that none has."""
    from matplotlib import font_manager

    families = [FONT]
    missing = {letter for letter in printable(text) if letter > "~"}
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


def wrap(text: str, width: float, lines: int = 3) -> str:
    """A text in a few lines that are so wide [inches]."""
    letters = max(int(width * LETTERS), 8)
    return textwrap.fill(printable(text), letters, max_lines=lines, placeholder="…")


def add_axes(
    figure: Any, view: tuple[float, float, float, float], panels: Sequence[Panel], num_layers: int
) -> list[Any]:
    """Give a figure its size and each panel a place, as `render_picture` says.

    Maps much wider than high lie below each other, as wide as the picture.
    """
    sides = np.array([view[2] - view[0], view[3] - view[1]])
    wide, high = sides = np.maximum(sides, max(sides.max() / LONGEST, 1e-3))
    middle = np.array(view).reshape(2, 2).mean(axis=0)
    in_line = num_layers if num_layers > 1 else len(panels)
    columns = 1 if wide > WIDE * high else min(in_line, MAX_COLUMNS)
    rows_each = math.ceil(in_line / columns)  # of a level, or of all
    rows = rows_each * (len(panels) // in_line)
    most_wide = WIDTH / columns - AROUND_X
    most_high = min(MAX_MAP_HEIGHT, (MAX_HEIGHT - 1.0) / rows - AROUND_Y)
    map_wide, map_high = sides * min(most_wide / wide, most_high / high)
    width = min(max(columns * (map_wide + AROUND_X), MIN_WIDTH), WIDTH)
    figure.set_size_inches(width, rows * (map_high + AROUND_Y) + 1.0)
    figure.set_layout_engine("compressed", w_pad=0.05, h_pad=0.05)
    grid = figure.subplots(rows, columns, squeeze=False)
    x_limits, y_limits = zip(middle - sides / 2, middle + sides / 2, strict=True)
    axes = []
    for number in range(len(panels)):
        row, column = divmod(number % in_line, columns)
        ax = grid[number // in_line * rows_each + row, column]
        ax.set(xlim=x_limits, ylim=y_limits, aspect="equal")
        ax.panel_width = width / columns - 0.5  # what its title has [inches]
        ax.pixels = 0.9 * map_wide * DPI / wide  # of a metre, at least
        axes.append(ax)
    for ax in {*grid.flat} - {*axes}:
        ax.remove()
    return axes


def _draw_panel(ax: Any, panel: Panel, bounds: tuple[float, float, float, float]) -> None:
    """Draw title, cells and doors, and the colour bar of a panel."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap

    ax.set_title(wrap(panel.title, ax.panel_width), loc="left", fontsize=TITLE_POINTS, pad=5)
    ax.tick_params(labelsize=TICK_POINTS, length=2.5, width=0.6, color=FAINT, labelcolor=INK, pad=2)
    ax.spines[:].set(edgecolor=FAINT, linewidth=0.6)
    x_min, y_min, x_max, y_max = bounds
    limits = ax.get_xlim(), ax.get_ylim()
    image = paint(panel)
    # cells have sharp edges, unless several share a pixel
    how = "nearest" if image.shape[1] <= ax.pixels * (x_max - x_min) else "antialiased"
    ax.imshow(image, extent=(x_min, x_max, y_min, y_max), interpolation=how)
    ax.set(xlim=limits[0], ylim=limits[1])
    if panel.scale is not None and len(panel.scale.ticks) > 1:
        colors = ScalarMappable(cmap=ListedColormap(panel.scale.bar(256) / 255))
        bar = ax.get_figure().colorbar(colors, ax=ax, fraction=0.05, pad=0.02, aspect=30)
        numbers = [tick.text.replace("-", "\N{MINUS SIGN}") for tick in panel.scale.ticks]
        bar.set_ticks([tick.position for tick in panel.scale.ticks], labels=numbers)
        bar.ax.tick_params(labelsize=TICK_POINTS, length=2, width=0.6, color=FAINT, pad=2)
        bar.outline.set_visible(False)
    for door in panel.doors:
        x, y = zip(door.start, door.end, strict=True)
        ax.plot(x, y, **_strokes(_door_line(door.state)), solid_capstyle="butt")


def _strokes(name: str) -> dict[str, Any]:
    """The style of a line of several strokes over each other, by its name in `STROKES`."""
    from matplotlib.patheffects import Stroke

    drawn = [Stroke(linewidth=width, foreground=color) for color, width in STROKES[name]]
    return {"path_effects": drawn, "linewidth": max(width for _, width in STROKES[name])}


def _draw_ways(figure: Any, axes: dict[int, Any], panels: Sequence[Panel]) -> None:
    """Draw links and stairs from stop to stop, also from storey to storey; axes are by level."""
    from matplotlib.patches import ConnectionPatch

    for way in next((panel.connections for panel in panels if panel.connections), ()):
        style = _strokes(_way_line(way))
        color = STROKES[_way_line(way)][1][0]
        places = way.stops
        for level, x, y, _ in places[: 1 if way.one_way else None]:
            if level in axes and way.link is not None:
                axes[level].plot(x, y, "o", color=color, markeredgecolor="white", markersize=6)
        for (one, x0, y0, _), (other, x1, y1, _) in itertools.pairwise(places):
            if one in axes and other in axes:
                arc = ConnectionPatch(
                    (x0, y0), (x1, y1), coordsA=axes[one].transData, coordsB=axes[other].transData,
                    arrowstyle="-|>" if way.one_way else "-", mutation_scale=7,
                    connectionstyle=f"arc3,rad={0.15 if one != other else 0}", shrinkA=0,
                    shrinkB=0, color=color, alpha=0.9, **style,
                )  # fmt: skip
                figure.add_artist(arc)


def _way_line(way: Connection) -> str:
    """The name of the line of a link or stair in `STROKES`."""
    if way.link is None:
        return "stairs"
    return "link, closed" if way.is_closed else "link"


def _door_line(state: str) -> str:
    return "door, closed" if state == "closed" else "door, open"


def write_names(ax: Any, labels: Sequence[Label]) -> Iterator[str]:
    """Write names on a map, those of large rooms first, none over another; yields the key.

    A name stands in the middle of its room, in one line or two, as large as fits, or beside its
    point. Where it doesn't fit, a number does, which the key explains; else nothing.
    """
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import Bbox

    to_pixels = ax.transData
    frame = ax.get_window_extent()
    scale = frame.width / np.ptp(ax.get_xlim())  # pixels a metre
    points = [to_pixels.transform((label.x, label.y)) for label in labels if not label.width]
    taken = [Bbox([at - POINT, at + POINT]) for at in points]
    for label in sorted(labels, key=lambda label: -label.width * label.height):
        whole = printable(label.text)
        is_point = not label.width
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
    figure: Any, panels: Sequence[Panel], kinds: dict[str, str], with_route: bool
) -> Any:
    """Say below the maps what colours and lines mean."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    meanings = dict(entry for panel in panels for entry in panel.legend)
    lines = {_door_line(door.state) for panel in panels for door in panel.doors}
    lines |= {_way_line(way) for panel in panels for way in panel.connections}
    if lines:  # they stand for doors and links in the legend
        meanings = {name: c for name, c in meanings.items() if c not in (DOOR, DOORWAY, LINK)}
    lines |= {"path, from o to x"} if with_route else set()
    entries: list[Any] = [
        Patch(facecolor=color, edgecolor="#777777", linewidth=0.5, label=printable(name))
        for name, color in (meanings | kinds).items()
    ]
    entries += [Line2D([], [], label=name, **_strokes(name)) for name in STROKES if name in lines]
    letters = max((len(entry.get_label()) for entry in entries), default=1) + 6
    columns = min(max(int(figure.get_figwidth() * LETTERS / letters), 1), max(len(entries), 1))
    figure.set_figheight(figure.get_figheight() + LINE * -(-len(entries) // columns))
    return figure.legend(
        handles=entries, ncols=columns, loc="outside lower left", frameon=False, borderpad=0,
        fontsize=LEGEND_POINTS, handlelength=1.6, handletextpad=0.5, columnspacing=1.4,
        title=" ", title_fontsize=LEGEND_POINTS, alignment="left",
    )  # fmt: skip
