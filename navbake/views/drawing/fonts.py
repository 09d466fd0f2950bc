"""Fonts that have the letters of a name, and how wide a text is in them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from navbake.errors import printable

# Functions import matplotlib when they draw: it is an extra, and takes half a second to load.

FONT = "DejaVu Sans"  # comes with matplotlib
UNKNOWN = "\N{REPLACEMENT CHARACTER}"  # stands for letters that no font has
LINE_ADVANCE = 1.2  # from line to line, of a line's height
REFERENCE_DPI = 720  # texts are measured at this resolution; they grow with their size


class Text(NamedTuple):
    """A text in one line or several, and the font that has its letters."""

    text: str
    font: str = FONT

    def size(self, points: float) -> tuple[float, float]:
        """Its width and height in letters of so many points [inches]."""
        lines = [_measure(line, self.font) for line in self.text.split("\n")]
        height = lines[0][1] * (1 + LINE_ADVANCE * (len(lines) - 1))
        return max(width for width, _ in lines) * points / 10, height * points / 10

    def cut(self, points: float, width: float) -> Text:
        """The text, with its end left out if it is wider than so much [inches]."""
        if self.size(points)[0] <= width:
            return self
        low, high = 0, len(self.text)  # letters that fit, and that don't
        while high - low > 1:
            middle = (low + high) // 2
            fits = self._replace(text=f"{self.text[:middle]}…").size(points)[0] <= width
            low, high = (middle, high) if fits else (low, middle)
        return self._replace(text=f"{self.text[:low].rstrip()}…")

    def style(self, points: float) -> dict[str, Any]:
        """What matplotlib takes to write it; nothing in it is markup."""
        return {
            "fontfamily": self.font,
            "fontsize": points,
            "linespacing": 1.05,
            "parse_math": False,
        }


def find_text(text: str, fallback: str | None = None) -> Text:
    """A text with a font that has all its letters; if there is none, what to write instead.

    That is the fallback, or else the text with `UNKNOWN` for each letter that is missing.
    """
    shown = printable(text)
    font = _font_for(frozenset(shown) - {" ", "\n"})
    if font is not None:
        return Text(shown, font)
    if fallback is not None:
        return Text(fallback)
    return Text(
        "".join(letter if _font_for(frozenset(letter)) == FONT else UNKNOWN for letter in shown)
    )


@lru_cache(maxsize=4096)
def _font_for(letters: frozenset[str]) -> str | None:
    """An installed font that has all of some letters, or None."""
    from matplotlib import font_manager

    wanted = {ord(letter) for letter in letters if not letter.isspace()}
    # a Last Resort font has a box for every letter
    fonts = [f for f in font_manager.fontManager.ttflist if not f.name.startswith("Last Resort")]
    for font in sorted(fonts, key=lambda font: (font.name != FONT, font.name, font.fname)):
        try:
            known = font_manager.get_font(font.fname).get_charmap()
        except (OSError, RuntimeError):  # matplotlib's list names a font that was removed
            continue
        if wanted <= known.keys():
            return str(font.name)
    return None


@lru_cache(maxsize=4096)
def _measure(line: str, font: str) -> tuple[float, float]:
    """Width and height of a line in letters of 10 points [inches]."""
    from matplotlib.backends import backend_agg
    from matplotlib.font_manager import FontProperties

    renderer: Any = backend_agg.RendererAgg(1, 1, REFERENCE_DPI)  # type: ignore[no-untyped-call]
    properties = FontProperties(family=font, size=10)
    width, _, _ = renderer.get_text_width_height_descent(line, properties, ismath=False)
    _, height, _ = renderer.get_text_width_height_descent("lp", properties, ismath=False)
    return width / REFERENCE_DPI, height / REFERENCE_DPI
