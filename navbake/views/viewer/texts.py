"""The words of the page, as Markdown and HTML; names from files are escaped."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.layers import ColorScale, Panel
from navbake.views.viewer.exhibit import Choices, Counts, Route, Told

if TYPE_CHECKING:
    from navbake.verifier.report import VerifyReport

MARKED = re.compile(r"([\\`*_{}\[\]<>()#+!|~.&:@-])")
HINT_INSPECT = "Click a cell or a thing to read about it."
HINT_START, HINT_GOAL = "Click where the path starts.", "Click where it goes to."
NAMES_SHOWN = 6
SCALES_SHOWN = 3
CHANGED = "Files have changed: baking again…"


def plain(text: object) -> str:
    """Text as it is, on one line, whatever Markdown and HTML would make of it.

    The page takes HTML in Markdown as it stands, scripts included. A line's end would begin a new
    block, in which other rules hold.
    """
    return MARKED.sub(r"\\\1", " ".join(str(text).split()))


def say_counts(now: Counts, before: Counts) -> str:
    """How much is free, and how much is in the grid as it is."""
    text = f"**{now.free:,} free cells**, {now.area:,.1f} m²"
    share = f"{now.free / now.cells:.0%} of the floor" if now.cells else ""
    if now == before:
        return f"{text} — {share}" if share else text
    return f"{text} — as baked: {before.free:,}"


def say_grid(grid: NavGrid, note: str) -> str:
    """What is shown: its name, its size, and a note."""
    level = grid.levels[0]
    storeys = f"{len(grid.levels)} levels" if grid.levels[1:] else "one level"
    text = f"**{plain(grid.scene_id or 'grid')}** — {storeys}, cells of "
    text += f"{plain(f'{level.lattice.cell_size:g}')} m"
    return f"{text}\n\n{plain(note)}" if note else text


def say_route(chosen: Choices, route: Route | None) -> str:
    """The path between the clicks, or what to click next."""
    if route is None:
        return HINT_GOAL if chosen.start is not None and chosen.goal is None else HINT_START
    if route.path is None:
        return f"**No path**: {plain(route.reason)}"
    path = route.path
    lines = [f"**{plain(f'{path.length:.2f}')} m**, cost {plain(f'{path.cost:.2f}')}"]
    if path.rooms:
        lines.append(f"Rooms: {_listed(path.rooms, ' → ')}")
    if path.doors:
        lines.append(f"Doors: {_listed(path.doors, ', ')}")
    levels = list(dict.fromkeys(path.levels.tolist()))
    if levels[1:]:
        lines.append(f"Levels: {' → '.join(str(level) for level in levels)}")
    return "\n\n".join(lines)


def say_cell(told: Told | None, inflation: tuple[float, float] | None) -> str:
    """What there is to know of a cell, and why an agent can or can't stand there."""
    if told is None:
        return HINT_INSPECT
    facts = told.facts
    rows = [("Verdict", _verdict(facts, inflation))]
    if told.clicked is not None:
        rows.append(("Clicked", _code(told.clicked)))
    room, floor, weight = facts["room"], facts["floor"], facts["weight"]
    name = (room["name"] or room["id"]) if isinstance(room, dict) else room
    x, y = facts["center"]
    rows += [
        ("Room", "none" if name is None else plain(name)),
        ("Floor", "none" if floor is None else f"{plain(f'{floor:.3f}')} m"),
        ("Weight", "infinite" if weight is None else plain(f"{weight:g}")),
        ("Island", str(facts["island"] or "none")),
        ("Cell", f"level {facts['level']}, row {facts['row']}, col {facts['col']}"),
        ("Centre", plain(f"{x:.3f}, {y:.3f}") + " m"),
    ]
    rows += [
        (key.capitalize(), _listed(facts[key], ", "))
        for key in ("doors", "objects", "walls")
        if facts[key]
    ]
    return "| | |\n|---|---|\n" + "\n".join(f"| {key} | {text} |" for key, text in rows)


def _verdict(facts: Json, inflation: tuple[float, float] | None) -> str:
    if facts["free"]:
        return "**free**: an agent can stand here"
    if facts["blockers"]:
        return f"**blocked** by {_listed(facts['blockers'], ', ')}"
    if facts["floor"] is None:
        return "**no floor** here"
    if inflation is not None and not facts["occupied"]:
        return f"**blocked**: nearer to something than the radius, {plain(f'{inflation[0]:g}')} m"
    return "**blocked**"


def _listed(names: list[str], between: str) -> str:
    shown = between.join(map(_code, names[:NAMES_SHOWN]))
    return f"{shown} and {len(names) - NAMES_SHOWN} more" if names[NAMES_SHOWN:] else shown


def _code(name: str) -> str:
    """A name in the letters of code.

    Not between backquotes: there a backslash guards nothing, so that a table's cell, and the code
    with it, would end at a ``|`` in the name.
    """
    return f"<code>{plain(name)}</code>"


def write_legend(panels: Sequence[Panel]) -> str:
    """The legend of a layer's levels: their scales of values, and what colours mean.

    Levels have scales of their own; those of the highest levels are written.
    """
    scales = [(panel.title, panel.scale) for panel in panels[::-1] if panel.scale is not None]
    parts = [
        _write_scale(scale, title if scales[1:] else scale.label)
        for title, scale in scales[:SCALES_SHOWN]
    ]
    meanings = dict(entry for panel in panels for entry in panel.legend)
    swatches = "".join(
        f'<span style="display:inline-flex;align-items:center;margin-right:10px">'
        f'<span style="width:11px;height:11px;border-radius:2px;margin-right:5px;'
        f'border:1px solid rgba(128,128,128,.6);background:{color}"></span>'
        f"{html.escape(meaning)}</span>"
        for meaning, color in meanings.items()
    )
    body = "".join([*parts, f"<div>{swatches}</div>"])
    return f'<div style="font-size:12px;line-height:1.5;padding:2px 12px 6px">{body}</div>'


def _write_scale(scale: ColorScale, title: str) -> str:
    stops = ", ".join(scale.colors)
    ticks = "".join(
        f'<span style="position:absolute;left:{100 * tick.position:.1f}%;'
        f'transform:translateX(-{100 * tick.position:.0f}%)">{html.escape(tick.text)}</span>'
        for tick in scale.ticks
    )
    return (
        f'<div style="margin-bottom:2px">{html.escape(title)}</div>'
        f'<div style="height:10px;border-radius:2px;'
        f'background:linear-gradient(to right, {stops})"></div>'
        f'<div style="position:relative;height:18px">{ticks}</div>'
    )


def say_report(report: VerifyReport) -> str:
    """What a verification found."""
    share = f"{report.checked:,} of {report.num_cells:,} cells"
    if report.ok:
        return f"Grid and scene agree, at {share}."
    return f"Grid and scene **disagree at {len(report.findings)} places**, at {share}."


def say_error(error: Exception) -> str:
    """An error, in one line."""
    return f"**Error**: {plain(' '.join(str(error).split()) or type(error).__name__)}"
