"""The line below a picture: scale bar, north, legend, and a key to numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from navbake.views.color_scale import nice_step
from navbake.views.drawing.fonts import Text

# Functions import matplotlib when they draw: it is an extra, and takes half a second to load.

POINTS = 8.0
LINE = 0.22  # from line to line [inches]
SWATCH = (0.2, 0.12)  # width and height of a colour in the legend [inches]
SPACE = 0.06  # between a swatch and its text [inches]
BETWEEN = 0.2  # between entries [inches]
BAR_INCHES = (0.45, 1.2)  # least and greatest length of a scale bar
INK = "#333333"

Draw = Callable[[Any, Any, float, float], None]
"""Draws a sign: takes a figure, the transform from inches, and the left end of its middle line."""


class Entry(NamedTuple):
    """An entry of the footer: a sign and what it means."""

    text: Text
    sign_width: float  # [inches]
    draw: Draw | None

    @property
    def width(self) -> float:
        """Of sign and text [inches]."""
        gap = SPACE if self.sign_width else 0.0
        return self.sign_width + gap + self.text.size(POINTS)[0]


def scale_entry(inches_per_metre: float) -> Entry:
    """A bar whose length is a round number of metres."""
    metres = nice_step(BAR_INCHES[0] / inches_per_metre)
    length = metres * inches_per_metre

    def draw(figure: Any, inches: Any, x: float, y: float) -> None:
        ends = [x, x, x, x + length, x + length, x + length]
        heights = [y + 0.04, y - 0.04, y, y, y - 0.04, y + 0.04]
        _line(figure, inches, ends, heights, INK, 1.2)

    return Entry(Text(f"{metres:g} m"), length, draw)


def north_entry() -> Entry:
    """An arrow that points up: to the north, the world's +y."""

    def draw(figure: Any, inches: Any, x: float, y: float) -> None:
        from matplotlib.patches import Polygon

        middle = x + 0.05
        _line(figure, inches, [middle, middle], [y - 0.09, y + 0.02], INK, 1.2)
        head = [(middle - 0.05, y), (middle, y + 0.11), (middle + 0.05, y)]
        figure.add_artist(Polygon(head, facecolor=INK, edgecolor="none", transform=inches))

    return Entry(Text("N (+y)"), 0.1, draw)


def color_entry(meaning: Text, color: str) -> Entry:
    """A rectangle of a colour."""

    def draw(figure: Any, inches: Any, x: float, y: float) -> None:
        from matplotlib.patches import Rectangle

        swatch = Rectangle((x, y - SWATCH[1] / 2), *SWATCH, transform=inches)
        swatch.set(facecolor=color, edgecolor="#777777", linewidth=0.5)
        figure.add_artist(swatch)

    return Entry(meaning, SWATCH[0], draw)


def line_entry(meaning: Text, strokes: Sequence[tuple[str, float]]) -> Entry:
    """A line of strokes over each other: their colours and widths [points]."""

    def draw(figure: Any, inches: Any, x: float, y: float) -> None:
        for color, width in strokes:
            _line(figure, inches, [x, x + 0.22], [y, y], color, width)

    return Entry(meaning, 0.22, draw)


def flow(entries: Sequence[Entry], width: float) -> list[list[Entry]]:
    """Break entries into lines of at most a width [inches]; what is too long is cut."""
    lines: list[list[Entry]] = [[]]
    left = width
    for entry in entries:
        if entry.width > width:
            space = width - entry.sign_width - SPACE
            entry = entry._replace(text=entry.text.cut(POINTS, space))
        if lines[-1] and entry.width > left:
            lines.append([])
            left = width
        lines[-1].append(entry)
        left -= entry.width + BETWEEN
    return [line for line in lines if line]


def footer_height(lines: Sequence[Sequence[Entry]]) -> float:
    """Height of the footer [inches]."""
    return math.fsum([LINE] * len(lines)) + 0.1


def draw_footer(figure: Any, lines: Sequence[Sequence[Entry]], left: float) -> None:
    """Draw the lines at the bottom of a figure, from `left` [inches]."""
    inches = figure.dpi_scale_trans
    for number, line in enumerate(reversed(lines)):
        x, y = left, 0.05 + LINE * (number + 0.5)
        for entry in line:
            if entry.draw is not None:
                entry.draw(figure, inches, x, y)
            text_x = x + entry.sign_width + (SPACE if entry.sign_width else 0.0)
            style = entry.text.style(POINTS) | {"va": "center_baseline", "color": INK}
            figure.text(text_x, y, entry.text.text, transform=inches, **style)
            x += entry.width + BETWEEN


def _line(figure: Any, inches: Any, x: list[float], y: list[float], color: str, lw: float) -> None:
    from matplotlib.lines import Line2D

    figure.add_artist(
        Line2D(x, y, color=color, linewidth=lw, solid_capstyle="butt", transform=inches)
    )
