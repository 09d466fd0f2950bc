"""Where names are written on a map, so that none lies over another.

A name stands in the middle of its room, in one line or two, as large as fits. Where it doesn't
fit, a number stands there, which a key below the picture explains. Where not even that fits,
nothing does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from navbake.views.drawing.fonts import Text, find_text
from navbake.views.panel import Label

POINTS = (9.0, 8.0, 7.0)  # sizes of a name that are tried
NUMBER_POINTS = (8.0, 7.0, 6.0)  # and of a number
MOST_LETTERS = 40  # of a name; it is cut beyond
MARK = 0.08  # half a side of what a point's name keeps clear of [inches]
PADDING = 0.02  # around a text [inches]


class Box(NamedTuple):
    """A rectangle on a map [inches from its lower left corner]."""

    left: float
    bottom: float
    right: float
    top: float

    def meets(self, other: Box) -> bool:
        """Whether they have more than an edge in common."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.bottom < other.top
            and other.bottom < self.top
        )


class Written(NamedTuple):
    """A name or a number as it is written on a map."""

    text: Text
    points: float
    x: float  # of its middle [inches from the map's lower left corner]
    y: float
    box: Box  # what it takes up
    number: int | None = None  # that it is, None for a name
    name: str = ""  # that the number stands for
    is_beside: bool = False  # what it names, not in it


def place_labels(
    labels: Sequence[Label],
    origin: tuple[float, float],
    inches_per_metre: float,
    size: tuple[float, float],
) -> list[Written]:
    """Find a place for names, those of large rooms first.

    Args:
        labels: the names; one whose width is 0 is that of a point, and stands beside it.
        origin: of the map's lower left corner, world x, y [m].
        inches_per_metre: scale of the map.
        size: width and height of the map [inches].
    """
    marked = [_position(label, origin, inches_per_metre) for label in labels if not label.width]
    taken = [Box(x - MARK, y - MARK, x + MARK, y + MARK) for x, y in marked]
    written = []
    for label in sorted(labels, key=lambda label: -label.width * label.height):
        room = label.width * inches_per_metre, label.height * inches_per_metre
        found = _fit(label, _position(label, origin, inches_per_metre), room, size, taken)
        if found is not None:
            taken.append(found.box)
            written.append(found)
    return written


def _position(
    label: Label, origin: tuple[float, float], inches_per_metre: float
) -> tuple[float, float]:
    return (label.x - origin[0]) * inches_per_metre, (label.y - origin[1]) * inches_per_metre


def _fit(
    label: Label,
    middle: tuple[float, float],
    room: tuple[float, float],
    size: tuple[float, float],
    taken: Sequence[Box],
) -> Written | None:
    """The first of the name's and the number's forms that fits, or None."""
    name = label.text if len(label.text) <= MOST_LETTERS else f"{label.text[:MOST_LETTERS]}…"
    whole = find_text(name, label.fallback)
    number = Text(str(label.number))
    sizes = POINTS if label.width else POINTS[-1:]
    forms = [(text, points) for points in sizes for text in _broken(whole)]
    forms += [(number, points) for points in NUMBER_POINTS]
    for text, points in forms:
        width, height = text.size(points)
        if label.width and (width > room[0] or height > room[1]):
            continue
        width, height = width + 2 * PADDING, height + 2 * PADDING
        for center in [middle] if label.width else _beside(middle, width, height):
            box = _around(center, width, height, size)
            if box is not None and not any(box.meets(other) for other in taken):
                x, y = (box.left + box.right) / 2, (box.bottom + box.top) / 2
                written = Written(text, points, x, y, box, is_beside=not label.width)
                if text is number:
                    return written._replace(number=label.number, name=whole.text)
                return written
    return None


def _beside(middle: tuple[float, float], width: float, height: float) -> list[tuple[float, float]]:
    """Middles of boxes above, below, to the right and to the left of a mark."""
    x, y = middle
    across, up = MARK + width / 2, MARK + height / 2
    return [(x, y + up), (x, y - up), (x + across, y), (x - across, y)]


def _around(
    middle: tuple[float, float], width: float, height: float, size: tuple[float, float]
) -> Box | None:
    """A box around a place, moved so that it lies on the map, or None where it is too large."""
    if width > size[0] or height > size[1]:
        return None
    left = min(max(middle[0] - width / 2, 0.0), size[0] - width)
    bottom = min(max(middle[1] - height / 2, 0.0), size[1] - height)
    return Box(left, bottom, left + width, bottom + height)


def _broken(text: Text) -> list[Text]:
    """A text in one line, and in two if it has words to break between."""
    letters = " " if " " in text.text.strip() else "_-"
    breaks = [at for at, letter in enumerate(text.text) if letter in letters and at > 0]
    if not breaks:
        return [text]
    at = min(breaks, key=lambda at: abs(at - len(text.text) / 2))
    kept = "" if text.text[at] == " " else text.text[at]
    return [text, text._replace(text=f"{text.text[:at]}{kept}\n{text.text[at + 1 :]}")]
