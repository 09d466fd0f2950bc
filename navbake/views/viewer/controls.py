"""The panel of the page: what can be chosen, and what is said, as Markdown and HTML.

Names from files are escaped.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from navbake.episodes.episode import Episode
from navbake.runtime.paths import Path
from navbake.types import Json
from navbake.views.layers import DISAGREEMENTS, Panel
from navbake.views.tables import cell_facts
from navbake.views.viewer.exhibit import (
    CLICKS,
    GOAL,
    INSPECT,
    START,
    TRAJECTORY,
    Choices,
    Counts,
    Exhibit,
)

if TYPE_CHECKING:
    import viser

Change = Callable[[Choices], Choices]

ALL_LEVELS = "all levels"
ALL_DOORS = "all doors"
AS_BAKED = "as baked"
NO_EPISODE = "none"
MOST_EPISODES = 500
RADIUS_STEP = 0.01  # [m]
MAX_RADIUS = 1.0  # [m], or twice the grid's own
MOST_SWITCHES = 12  # levels that have a switch each
CUT_STEP = 0.05  # [m]
INFLATED = "The grid was inflated when it was made: its doors stay as they are."
MARKED = re.compile(r"([\\`*_{}\[\]<>()#+!|~.&:@-])")
HINT_INSPECT = "Click a cell or a thing to read about it."
HINT_START = "Click where the path starts."
HINT_GOAL = "Click where it goes to."
NAMES_SHOWN = 6
SCALES_SHOWN = 3


class Controls:
    """The panel for an exhibit; calls `change` with how the reader changes choices, or `verify`."""

    def __init__(
        self,
        gui: viser.GuiApi,
        exhibit: Exhibit,
        chosen: Choices,
        change: Callable[[Change], None],
        verify: Callable[[], None],
    ) -> None:
        self._gui = gui
        self._exhibit = exhibit
        self._change = change
        self._handles: dict[str, Any] = {}
        gui.reset()
        self._status = gui.add_markdown("", visible=False)
        grid = exhibit.grid
        size = plain(f"{exhibit.grid.levels[0].lattice.cell_size:g}")
        storeys = f"{len(grid.levels)} levels" if grid.levels[1:] else "one level"
        text = f"**{plain(grid.scene_id or 'grid')}** — {storeys}, cells of {size} m"
        gui.add_markdown(f"{text}\n\n{plain(exhibit.note)}")
        with gui.add_folder("Layer"):
            self._add_layers(chosen, verify)
        with gui.add_folder("Agent"):
            self._add_agent(chosen)
        with gui.add_folder("Click"):
            click = gui.add_dropdown("A click", CLICKS, initial_value=chosen.click)
            self._keep("click", click, _set("click"))
            self._keep("told", gui.add_markdown(""))
            self._keep("route", gui.add_markdown(""))
            self._keep("clear", gui.add_button("Clear", visible=False))
            self._handles["clear"].on_click(lambda _: change(Choices.without_clicks))
        if exhibit.grid.doors:
            with gui.add_folder("Doors"):
                self._add_doors()
        if exhibit.runs:
            with gui.add_folder("Episode"):
                names = [NO_EPISODE, *list(exhibit.runs)[:MOST_EPISODES]]
                first = chosen.episode if chosen.episode in names else NO_EPISODE
                which = gui.add_dropdown("Episode", names, initial_value=first)

                def choose(name: str) -> Change:
                    return _set("episode")("" if name == NO_EPISODE else name)

                self._keep("episode", which, choose)
                self._keep("task", gui.add_markdown(""))
        with gui.add_folder("Picture"):
            self._add_picture(chosen)

    def _keep(self, name: str, handle: Any, make: Callable[[Any], Change] | None = None) -> None:
        """Keep an input, whose value makes a change when the reader, not this program, sets it."""
        self._handles[name] = handle

        def update(event: Any) -> None:
            if event.client is not None and make is not None:
                self._change(make(event.target.value))

        if make is not None:
            handle.on_update(update)

    def _add_layers(self, chosen: Choices, verify: Callable[[], None]) -> None:
        gui = self._gui
        grid = self._exhibit.grid
        layers = self._exhibit.layers
        layer = gui.add_dropdown("Layer", layers, initial_value=chosen.layer)
        self._keep("layer", layer, _set("layer"))
        if grid.levels[1:]:
            names = [ALL_LEVELS, *_unique(grid.level_names)]

            def look(name: str) -> Change:
                number = None if name == ALL_LEVELS else names.index(name) - 1
                return lambda now: now.with_level(grid, number)

            level = gui.add_dropdown("Level", names, initial_value=_level(names, chosen))
            self._keep("level", level, look)
        self._keep("legend", gui.add_html(""))
        hint = "Let MuJoCo and FCL look at a sample of the cells (navbake verify)."
        self._keep("verify", gui.add_button("Compare with the scene", hint=hint, visible=False))
        self._keep("verified", gui.add_markdown("", visible=False))
        self._handles["verify"].on_click(lambda _: verify())

    def _add_agent(self, chosen: Choices) -> None:
        gui = self._gui
        grid = self._exhibit.grid
        most = max(MAX_RADIUS, 2 * grid.agent_radius)
        sizes = chosen.inflation or (grid.agent_radius, 0.0)
        hints = {
            "radius": "Inflate the grid for an agent of this radius.",
            "clearance": "Cells so near beyond cost more.",
        }

        def inflate(_: Any) -> Change:
            return _set("inflation")(tuple(float(self._handles[name].value) for name in hints))

        self._keep("free", gui.add_markdown(""))
        for (name, hint), size in zip(hints.items(), sizes, strict=True):
            bounds = 0.0, most, RADIUS_STEP, min(size, most)
            slider = gui.add_slider(f"{name.capitalize()} [m]", *bounds, hint=hint)
            self._keep(name, slider, inflate)
        hint = "Show the grid as it is in the file, not inflated here."
        self._keep("as baked", gui.add_button("As baked", hint=hint))
        self._handles["as baked"].on_click(lambda _: self._change(_set("inflation")(None)))

    def _add_doors(self) -> None:
        gui = self._gui
        grid = self._exhibit.grid
        at = self._handles
        if "inflation" in grid.metadata:
            gui.add_markdown(INFLATED)
            return
        names = [door.id for door in grid.doors]
        states = sorted({state for door in grid.doors for state in door.states})

        def put(state: str) -> Change:
            which = names if at["door"].value == ALL_DOORS else [at["door"].value]
            if state != AS_BAKED:
                return lambda now: now.with_door(grid, which, state)
            return lambda now: replace(now, doors=tuple(d for d in now.doors if d[0] not in which))

        self._keep("door", gui.add_dropdown("Door", [ALL_DOORS, *names]), lambda _: lambda now: now)
        self._keep("state", gui.add_dropdown("State", [AS_BAKED, *states]), put)

    def _add_picture(self, chosen: Choices) -> None:
        gui = self._gui
        exhibit = self._exhibit
        drawing = exhibit.drawing(chosen)
        if drawing is not None:
            low = float(exhibit.bounds[0, 2])
            high = max(float(drawing.bounds[1, 2]), low) + CUT_STEP
            cut = max(low, high if chosen.cut is None else min(chosen.cut, high))
            low = round(low, 2)
            high = round(high, 2)
            cut = round(cut, 2)

            def cut_at(height: float) -> Change:
                return _set("cut")(None if height >= high - CUT_STEP / 2 else height)

            hint = "The scene is drawn up to here, so that one sees into storeys."
            slider = gui.add_slider("Cut height [m]", low, high, CUT_STEP, cut, hint=hint)
            self._keep("cut", slider, cut_at)
            self._keep("scene", gui.add_checkbox("Scene", chosen.with_scene), _set("with_scene"))
            if drawing.has_hidden:
                hint = "What MuJoCo's own viewers hide: the geom groups from 3 on."
                hidden = gui.add_checkbox("Hidden geoms", chosen.with_hidden, hint=hint)
                self._keep("hidden", hidden, _set("with_hidden"))
        names = _unique(exhibit.grid.level_names)
        for number, name in enumerate(names if 1 < len(names) <= MOST_SWITCHES else ()):

            def switch(on: bool, own: int = number) -> Change:
                added = {own} if on else set()
                return lambda now: replace(now, levels=tuple(sorted({*now.levels} - {own} | added)))

            self._keep(f"level {number}", gui.add_checkbox(name, number in chosen.levels), switch)
        opacity = gui.add_slider("Layer's opacity", 0.1, 1.0, 0.1, chosen.opacity)
        self._keep("opacity", opacity, _set("opacity"))
        self._keep("names", gui.add_checkbox("Names", chosen.with_names), _set("with_names"))
        self._keep("dark", gui.add_checkbox("Dark page", bool(chosen.dark)), _set("dark"))

    def show(self, chosen: Choices, route: Path | str | None, told: Json | None) -> None:
        """Bring what is said, and inputs that follow from others, up to date."""
        exhibit = self._exhibit
        grid = self._exhibit.grid
        at = self._handles
        as_it_is = replace(chosen, doors=(), inflation=None)
        at["free"].content = say_counts(exhibit.count(chosen), exhibit.count(as_it_is))
        marked = {"start": START, "goal and path": GOAL} if chosen.start or chosen.episode else {}
        if "task" in at:
            episode, trajectory = exhibit.runs.get(chosen.episode, (None, None))
            at["task"].content = say_episode(episode)
            marked |= {} if trajectory is None else {"trajectory": TRAJECTORY}
        panels = [exhibit.panel(chosen, n) for n in chosen.levels]
        at["legend"].content = write_legend(panels, marked)
        at["verify"].visible = chosen.layer == DISAGREEMENTS
        at["verified"].visible = chosen.layer == DISAGREEMENTS and exhibit.report is not None
        at["verified"].content = say_report(exhibit)
        is_inspecting = chosen.click == INSPECT
        at["told"].visible = is_inspecting
        at["route"].visible = not is_inspecting
        at["told"].content = say_cell(told, chosen.inflation)
        at["route"].content = say_route(chosen, route)
        at["clear"].visible = any((chosen.start, chosen.goal, chosen.inspected))
        if chosen.inflation is None:
            at["radius"].value = min(grid.agent_radius, float(at["radius"].max))
            at["clearance"].value = 0.0
        at["as baked"].disabled = chosen.inflation is None
        at["dark"].value = bool(chosen.dark)
        if "level" in at:
            at["level"].value = _level(list(at["level"].options), chosen)
        for number in range(len(grid.levels) if "level 0" in at else 0):
            at[f"level {number}"].value = number in chosen.levels
        if "cut" in at:
            cut = at["cut"].max if chosen.cut is None else chosen.cut
            at["cut"].value = float(min(max(cut, at["cut"].min), at["cut"].max))
        if "state" in at:
            states = dict(chosen.doors)
            common = {*states.values()} if len(states) == len(grid.doors) else set()
            named = states.get(at["door"].value, AS_BAKED)
            at["state"].value = common.pop() if len(common) == 1 else named

    def say(self, text: str) -> None:
        """Write a line at the top of the panel; none if empty."""
        self._status.content = text
        self._status.visible = bool(text)


def _set(field: str) -> Callable[[Any], Change]:
    """Makes changes that set a field of the choices to a value."""
    return lambda value: lambda now: replace(now, **{field: value})


def _level(names: list[str], chosen: Choices) -> str:
    return names[chosen.levels[0] + 1] if len(chosen.levels) == 1 else names[0]


def _unique(names: list[str]) -> list[str]:
    """Names, numbered where several are the same."""
    return [f"{name} ({n})" if names.count(name) > 1 else name for n, name in enumerate(names)]


# --- the words ------------------------------------------------------------------------------------


def plain(text: object) -> str:
    """Text for Markdown as it is, on one line: the page takes HTML in Markdown, scripts included.

    A line's end would begin a new block, in which other rules hold.
    """
    return MARKED.sub(r"\\\1", " ".join(str(text).split()))


def say_counts(now: Counts, before: Counts) -> str:
    """How much is free, and how much is in the grid as it is."""
    free, cells, area = now
    text = f"**{free:,} free cells**, {area:,.1f} m²"
    if now != before:
        return f"{text} — as baked: {before[0]:,}"
    return f"{text} — {free / cells:.0%} of the floor" if cells else text


def say_route(chosen: Choices, route: Path | str | None) -> str:
    """The path between the clicks, why there is none, or what to click next."""
    if route is None:
        return HINT_GOAL if chosen.start is not None and chosen.goal is None else HINT_START
    if isinstance(route, str):
        return f"**No path**: {plain(route)}"
    lines = [f"**{plain(f'{route.length:.2f}')} m**, cost {plain(f'{route.cost:.2f}')}"]
    lines += [f"Rooms: {_listed(route.rooms, ' → ')}"] if route.rooms else []
    lines += [f"Doors: {_listed(route.doors, ', ')}"] if route.doors else []
    levels = list(dict.fromkeys(route.levels.tolist()))
    lines += [f"Levels: {' → '.join(map(str, levels))}"] if levels[1:] else []
    return "\n\n".join(lines)


def say_cell(facts: Json | None, inflation: tuple[float, float] | None) -> str:
    """What there is to know of a cell, and why an agent can or can't stand there."""
    if facts is None:
        return HINT_INSPECT
    verdict = "**blocked**"
    if facts["free"]:
        verdict = "**free**: an agent can stand here"
    elif facts["blockers"]:
        verdict = f"**blocked** by {_listed(facts['blockers'], ', ')}"
    elif facts["floor"] is None:
        verdict = "**no floor** here"
    elif inflation is not None and not facts["occupied"]:
        radius = plain(f"{inflation[0]:g}")
        verdict = f"**blocked**: nearer to something than the radius, {radius} m"
    rows = {"clicked": [facts["clicked"]] if facts["clicked"] else [], **cell_facts(facts)}
    shown = {k: plain(v) if isinstance(v, str) else _listed(v, ", ") for k, v in rows.items()}
    lines = [f"| {plain(key)} | {text} |" for key, text in shown.items() if text]
    return "\n".join(["| | |", "|---|---|", f"| Verdict | {verdict} |", *lines])


def _listed(names: Sequence[str], between: str) -> str:
    """Names as code; not between backquotes, where a ``|`` in a name would end a table's cell."""
    shown = between.join(f"<code>{plain(name)}</code>" for name in names[:NAMES_SHOWN])
    return f"{shown} and {len(names) - NAMES_SHOWN} more" if names[NAMES_SHOWN:] else shown


def say_episode(episode: Episode | None) -> str:
    """What an episode asks for."""
    if episode is None:
        return ""
    goal = episode.goals[0].name or episode.goals[0].category or episode.goals[0].room
    lines = [f"**{plain(episode.task)}**" + (f" {_listed([goal], '')}" if goal else "")]
    if episode.distance is not None:
        lines.append(f"shortest path {plain(f'{episode.distance:.2f}')} m")
    if episode.instruction:
        lines.append(plain(episode.instruction))
    return "\n\n".join(lines)


def write_legend(panels: Sequence[Panel], marked: Mapping[str, str] | None = None) -> str:
    """The legend of a layer's levels: the scales of the highest levels, and what colours mean."""
    scales = [(panel.title, panel.scale) for panel in panels[::-1] if panel.scale is not None]
    parts = []
    for title, scale in scales[:SCALES_SHOWN]:
        ticks = "".join(
            f'<span style="position:absolute;left:{100 * tick.position:.1f}%;'
            f'transform:translateX(-{100 * tick.position:.0f}%)">{html.escape(tick.text)}</span>'
            for tick in scale.ticks
        )
        parts.append(
            f"<div>{html.escape(title if scales[1:] else scale.label)}</div>"
            f'<div style="height:10px;border-radius:2px;margin-top:2px;'
            f'background:linear-gradient(to right, {", ".join(scale.colors)})"></div>'
            f'<div style="position:relative;height:18px">{ticks}</div>'
        )
    meanings = dict(entry for panel in panels for entry in panel.legend) | dict(marked or {})
    swatches = "".join(
        f'<span style="display:inline-flex;align-items:center;margin-right:10px">'
        f'<span style="width:11px;height:11px;border-radius:2px;margin-right:5px;'
        f'border:1px solid rgba(128,128,128,.6);background:{color}"></span>'
        f"{html.escape(meaning)}</span>"
        for meaning, color in meanings.items()
    )
    body = "".join([*parts, f"<div>{swatches}</div>"])
    return f'<div style="font-size:12px;line-height:1.5;padding:2px 12px 6px">{body}</div>'


def say_report(exhibit: Exhibit) -> str:
    """What a verification found; "" before one."""
    if (report := exhibit.report) is None:
        return ""
    verdict = "agree" if report.ok else f"**disagree at {len(report.findings)} places**"
    return f"Grid and scene {verdict}, at {report.checked:,} of {report.num_cells:,} cells."


def say_error(error: Exception) -> str:
    """An error, in one line."""
    return f"**Error**: {plain(' '.join(str(error).split()) or type(error).__name__)}"
