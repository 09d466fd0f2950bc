"""The panel of the page: what can be chosen, and what is told."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from navbake.views.layers import DISAGREEMENTS
from navbake.views.viewer import texts
from navbake.views.viewer.exhibit import CLICKS, INSPECT, Choices, Exhibit, Route, Told

if TYPE_CHECKING:
    import viser

Change = Callable[[Choices], Choices]

ALL_LEVELS, ALL_DOORS, AS_BAKED = "all levels", "all doors", "as baked"
RADIUS_STEP = 0.01  # [m]
MAX_RADIUS = 1.0  # [m], or twice the grid's own
MOST_SWITCHES = 12  # levels that have a switch each
CUT_STEP = 0.05  # [m]
INFLATED = "The grid was inflated when it was made: its doors stay as they are."


class Controls:
    """The panel for an exhibit.

    Args:
        gui: of the page.
        exhibit: what is shown.
        chosen: what is chosen at first.
        change: is given how the choices change, whenever the reader changes them.
        verify: is called when the reader asks for a verification.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        exhibit: Exhibit,
        chosen: Choices,
        change: Callable[[Change], None],
        verify: Callable[[], None],
    ) -> None:
        self._gui, self._exhibit, self._change = gui, exhibit, change
        self._handles: dict[str, Any] = {}
        gui.reset()
        self.status = gui.add_markdown("", visible=False)
        gui.add_markdown(texts.say_grid(exhibit.grid, exhibit.note))
        self._add_layers(chosen, verify)
        self._add_agent(chosen)
        self._add_click(chosen)
        if exhibit.grid.doors:
            self._add_doors(chosen)
        self._add_picture(chosen)

    def _folder(self, name: str, *, is_open: bool = True) -> AbstractContextManager[Any]:
        return self._gui.add_folder(name, expand_by_default=is_open)

    def _on(self, handle: Any, make: Callable[[Any], Change]) -> None:
        """Change the choices when the reader, and not this program, sets an input."""

        def changed(event: Any) -> None:
            if event.client is not None:
                self._change(make(event.target.value))

        handle.on_update(changed)

    def _add_layers(self, chosen: Choices, verify: Callable[[], None]) -> None:
        gui, grid, add = self._gui, self._exhibit.grid, self._handles
        with self._folder("Layer"):
            add["layer"] = gui.add_dropdown(
                "Layer", self._exhibit.layers, initial_value=chosen.layer
            )
            self._on(add["layer"], lambda name: lambda now: replace(now, layer=name))
            if grid.levels[1:]:
                names = [ALL_LEVELS, *_unique(grid.level_names)]
                add["level"] = gui.add_dropdown("Level", names, initial_value=_level(names, chosen))

                def look(name: str) -> Change:
                    number = None if name == ALL_LEVELS else names.index(name) - 1
                    return lambda now: now.with_level(grid, number)

                self._on(add["level"], look)
            add["legend"] = gui.add_html("")
            add["verify"] = gui.add_button(
                "Compare with the scene",
                hint="Let MuJoCo and FCL look at a sample of the cells (navbake verify).",
                visible=False,
            )
            add["verified"] = gui.add_markdown("", visible=False)
            add["verify"].on_click(lambda _: verify())

    def _add_agent(self, chosen: Choices) -> None:
        gui, grid, add = self._gui, self._exhibit.grid, self._handles
        most = max(MAX_RADIUS, 2 * grid.agent_radius)
        radius, clearance = chosen.inflation or (grid.agent_radius, 0.0)
        with self._folder("Agent"):
            add["free"] = gui.add_markdown("")
            add["radius"] = gui.add_slider(
                "Radius [m]", 0.0, most, RADIUS_STEP, min(radius, most),
                hint="Inflate the grid for an agent of this radius.",
            )  # fmt: skip
            add["clearance"] = gui.add_slider(
                "Clearance [m]", 0.0, most, RADIUS_STEP, min(clearance, most),
                hint="Cells so near beyond the radius cost more.",
            )  # fmt: skip
            add["as baked"] = gui.add_button(
                "As baked", hint="Show the grid as it is in the file, not inflated here."
            )

        def inflate(_: Any) -> Change:
            sizes = float(add["radius"].value), float(add["clearance"].value)
            return lambda now: replace(now, inflation=sizes)

        self._on(add["radius"], inflate)
        self._on(add["clearance"], inflate)
        add["as baked"].on_click(lambda _: self._change(lambda now: replace(now, inflation=None)))

    def _add_click(self, chosen: Choices) -> None:
        gui, add = self._gui, self._handles
        with self._folder("Click"):
            add["click"] = gui.add_dropdown("A click", CLICKS, initial_value=chosen.click)
            self._on(add["click"], lambda does: lambda now: replace(now, click=does))
            add["told"] = gui.add_markdown("")
            add["route"] = gui.add_markdown("")
            add["forget"] = gui.add_button("Clear", visible=False)
            add["forget"].on_click(lambda _: self._change(lambda now: now.without_clicks()))

    def _add_doors(self, chosen: Choices) -> None:
        gui, grid, add = self._gui, self._exhibit.grid, self._handles
        names = [door.id for door in grid.doors]
        states = sorted({state for door in grid.doors for state in door.states})
        with self._folder("Doors", is_open=False):
            if "inflation" in grid.metadata:
                gui.add_markdown(INFLATED)
                return
            add["door"] = gui.add_dropdown("Door", [ALL_DOORS, *names])
            add["state"] = gui.add_dropdown("State", [AS_BAKED, *states])

        def put(state: str) -> Change:
            which = names if add["door"].value == ALL_DOORS else [add["door"].value]
            if state != AS_BAKED:
                return lambda now: now.with_door(grid, which, state)
            return lambda now: replace(
                now, doors=tuple(one for one in now.doors if one[0] not in which)
            )

        def show(event: Any) -> None:
            if event.client is not None:
                self._change(lambda now: now)

        self._on(add["state"], put)
        add["door"].on_update(show)

    def _add_picture(self, chosen: Choices) -> None:
        gui, exhibit, add = self._gui, self._exhibit, self._handles
        with self._folder("Picture"):
            if exhibit.scene is not None:
                self._add_cut(chosen)
            count = len(exhibit.grid.levels)
            for number, name in enumerate(_unique(exhibit.grid.level_names)):
                if 1 < count <= MOST_SWITCHES:
                    key = f"level {number}"
                    add[key] = gui.add_checkbox(name, number in chosen.levels)
                    self._on(add[key], lambda on, k=number: lambda now: _switch(now, k, on))  # type: ignore[misc]
            add["opacity"] = gui.add_slider("Layer's opacity", 0.1, 1.0, 0.1, chosen.opacity)
            self._on(add["opacity"], lambda share: lambda now: replace(now, opacity=share))
            add["names"] = gui.add_checkbox("Names", chosen.with_names)
            self._on(add["names"], lambda on: lambda now: replace(now, with_names=on))
            dark = gui.add_checkbox("Dark page", False)
            dark.on_update(lambda event: set_theme(gui, dark=event.target.value))

    def _add_cut(self, chosen: Choices) -> None:
        gui, exhibit, add = self._gui, self._exhibit, self._handles
        drawing = exhibit.drawing(chosen)
        assert drawing is not None and exhibit.scene is not None
        low = float(exhibit.bounds[0, 2])
        high = max(float(drawing.bounds[1, 2]), low) + CUT_STEP
        cut = min(high if chosen.cut is None else chosen.cut, high)
        add["cut"] = gui.add_slider(
            "Cut height [m]", round(low, 2), round(high, 2), CUT_STEP, round(max(cut, low), 2),
            hint="The scene is drawn up to here, so that one sees into storeys.",
        )  # fmt: skip

        def cut_at(height: float) -> Change:
            top = height >= round(high, 2) - CUT_STEP / 2
            return lambda now: replace(now, cut=None if top else height)

        self._on(add["cut"], cut_at)
        add["scene"] = gui.add_checkbox("Scene", chosen.with_scene)
        self._on(add["scene"], lambda on: lambda now: replace(now, with_scene=on))
        if drawing.has_hidden:
            add["hidden"] = gui.add_checkbox(
                "Hidden geoms", chosen.with_hidden,
                hint="What MuJoCo's own viewers hide: the geom groups from 3 on.",
            )  # fmt: skip
            self._on(add["hidden"], lambda on: lambda now: replace(now, with_hidden=on))

    def show(self, chosen: Choices, route: Route | None, told: Told | None) -> None:
        """Bring what is told, and inputs that follow from others, up to date."""
        exhibit, at = self._exhibit, self._handles
        as_it_is = replace(chosen, doors=(), inflation=None)
        at["free"].content = texts.say_counts(exhibit.count(chosen), exhibit.count(as_it_is))
        panels = [exhibit.panel(chosen, number) for number in chosen.levels]
        at["legend"].content = texts.write_legend(panels)
        asks = chosen.layer == DISAGREEMENTS
        at["verify"].visible = asks
        at["verified"].visible = asks and exhibit.report is not None
        if exhibit.report is not None:
            at["verified"].content = texts.say_report(exhibit.report)
        is_inspecting = chosen.click == INSPECT
        at["told"].visible, at["route"].visible = is_inspecting, not is_inspecting
        at["told"].content = texts.say_cell(told, chosen.inflation)
        at["route"].content = texts.say_route(chosen, route)
        at["forget"].visible = any((chosen.start, chosen.goal, chosen.inspected))
        self._follow(chosen)

    def _follow(self, chosen: Choices) -> None:
        """Set the inputs that another one, or a new grid, has changed."""
        at, grid = self._handles, self._exhibit.grid
        if chosen.inflation is None:
            at["radius"].value = min(grid.agent_radius, float(at["radius"].max))
            at["clearance"].value = 0.0
        at["as baked"].disabled = chosen.inflation is None
        if "level" in at:
            at["level"].value = _level(list(at["level"].options), chosen)
        for number in range(len(grid.levels)):
            if f"level {number}" in at:
                at[f"level {number}"].value = number in chosen.levels
        if "cut" in at:
            cut = at["cut"].max if chosen.cut is None else chosen.cut
            at["cut"].value = float(min(max(cut, at["cut"].min), at["cut"].max))
        if "state" in at:
            states = dict(chosen.doors)
            one = at["door"].value
            named = states.get(one) if one != ALL_DOORS else _common(states, len(grid.doors))
            at["state"].value = named or AS_BAKED

    def say(self, text: str) -> None:
        """Write a line at the top of the panel; none if empty."""
        self.status.content = text
        self.status.visible = bool(text)


def set_theme(gui: viser.GuiApi, *, dark: bool) -> None:
    """How the page looks: without the marks of the library, and nothing that shares it."""
    gui.configure_theme(
        dark_mode=dark, show_logo=False, show_share_button=False, control_width="medium"
    )


def _level(names: list[str], chosen: Choices) -> str:
    return names[chosen.levels[0] + 1] if len(chosen.levels) == 1 else names[0]


def _switch(chosen: Choices, number: int, on: bool) -> Choices:
    levels = {*chosen.levels, number} if on else {*chosen.levels} - {number}
    return replace(chosen, levels=tuple(sorted(levels)))


def _common(states: dict[str, str], count: int) -> str | None:
    """The state of all doors, where all are in one that was chosen."""
    found = set(states.values())
    return found.pop() if len(found) == 1 and len(states) == count else None


def _unique(names: list[str]) -> list[str]:
    """Names that tell apart what has one name."""
    return [
        name if names.count(name) == 1 else f"{name} ({number})"
        for number, name in enumerate(names)
    ]
