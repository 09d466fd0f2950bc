"""The panel of the page: what can be chosen, and what is said."""

from __future__ import annotations

from collections.abc import Callable
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
        change: is called with how the choices change, whenever the reader changes them.
        verify: is called when the reader wants a verification.
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
        with gui.add_folder("Layer"):
            self._add_layers(chosen, verify)
        with gui.add_folder("Agent"):
            self._add_agent(chosen)
        with gui.add_folder("Click"):
            self._add_click(chosen)
        if exhibit.grid.doors:
            with gui.add_folder("Doors", expand_by_default=False):
                self._add_doors()
        with gui.add_folder("Picture"):
            self._add_picture(chosen)

    def _keep(self, name: str, handle: Any, make: Callable[[Any], Change] | None = None) -> None:
        """Keep an input; change the choices when the reader, and not this program, sets it."""
        self._handles[name] = handle
        if make is not None:
            handle.on_update(
                lambda event: event.client is not None and self._change(make(event.target.value))
            )

    def _keep_button(self, name: str, change: Change, **options: Any) -> None:
        self._handles[name] = button = self._gui.add_button(name, **options)
        button.on_click(lambda _: self._change(change))

    def _add_layers(self, chosen: Choices, verify: Callable[[], None]) -> None:
        gui, grid, layers = self._gui, self._exhibit.grid, self._exhibit.layers
        layer = gui.add_dropdown("Layer", layers, initial_value=chosen.layer)
        self._keep("layer", layer, lambda name: lambda now: replace(now, layer=name))
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
        gui, grid = self._gui, self._exhibit.grid
        most = max(MAX_RADIUS, 2 * grid.agent_radius)
        sizes = chosen.inflation or (grid.agent_radius, 0.0)

        def inflate(_: Any) -> Change:
            radius, clearance = (float(self._handles[name].value) for name in names)
            return lambda now: replace(now, inflation=(radius, clearance))

        names = ("radius", "clearance")
        hints = (
            "Inflate the grid for an agent of this radius.",
            "Cells so near beyond cost more.",
        )
        self._keep("free", gui.add_markdown(""))
        for name, size, hint in zip(names, sizes, hints, strict=True):
            label, first = f"{name.capitalize()} [m]", min(size, most)
            self._keep(
                name, gui.add_slider(label, 0.0, most, RADIUS_STEP, first, hint=hint), inflate
            )
        hint = "Show the grid as it is in the file, not inflated here."
        self._keep_button("As baked", lambda now: replace(now, inflation=None), hint=hint)

    def _add_click(self, chosen: Choices) -> None:
        gui = self._gui
        click = gui.add_dropdown("A click", CLICKS, initial_value=chosen.click)
        self._keep("click", click, lambda does: lambda now: replace(now, click=does))
        self._keep("told", gui.add_markdown(""))
        self._keep("route", gui.add_markdown(""))
        self._keep_button("Clear", Choices.without_clicks, visible=False)

    def _add_doors(self) -> None:
        gui, grid, at = self._gui, self._exhibit.grid, self._handles
        if "inflation" in grid.metadata:
            gui.add_markdown(INFLATED)
            return
        names = [door.id for door in grid.doors]
        states = sorted({state for door in grid.doors for state in door.states})

        def put(state: str) -> Change:
            which = names if at["door"].value == ALL_DOORS else [at["door"].value]
            if state != AS_BAKED:
                return lambda now: now.with_door(grid, which, state)
            return lambda now: replace(
                now, doors=tuple(one for one in now.doors if one[0] not in which)
            )

        self._keep("door", gui.add_dropdown("Door", [ALL_DOORS, *names]), lambda _: lambda now: now)
        self._keep("state", gui.add_dropdown("State", [AS_BAKED, *states]), put)

    def _add_picture(self, chosen: Choices) -> None:
        gui, exhibit = self._gui, self._exhibit
        if exhibit.scene is not None:
            self._add_cut(chosen)
        names = _unique(exhibit.grid.level_names)
        for number, name in enumerate(names if 1 < len(names) <= MOST_SWITCHES else ()):

            def switch(on: bool, number: int = number) -> Change:
                others = {number} if on else set()
                return lambda now: replace(
                    now, levels=tuple(sorted({*now.levels} - {number} | others))
                )

            self._keep(f"level {number}", gui.add_checkbox(name, number in chosen.levels), switch)
        opacity = gui.add_slider("Layer's opacity", 0.1, 1.0, 0.1, chosen.opacity)
        self._keep("opacity", opacity, lambda share: lambda now: replace(now, opacity=share))
        with_names = gui.add_checkbox("Names", chosen.with_names)
        self._keep("names", with_names, lambda on: lambda now: replace(now, with_names=on))
        dark = gui.add_checkbox("Dark page", False)
        dark.on_update(lambda event: set_theme(gui, dark=event.target.value))

    def _add_cut(self, chosen: Choices) -> None:
        gui, exhibit = self._gui, self._exhibit
        drawing = exhibit.drawing(chosen)
        assert drawing is not None and exhibit.scene is not None
        low = float(exhibit.bounds[0, 2])
        high = max(float(drawing.bounds[1, 2]), low) + CUT_STEP
        cut = max(low, high if chosen.cut is None else min(chosen.cut, high))
        low, high, cut = round(low, 2), round(high, 2), round(cut, 2)

        def cut_at(height: float) -> Change:
            top = height >= high - CUT_STEP / 2
            return lambda now: replace(now, cut=None if top else height)

        hint = "The scene is drawn up to here, so that one sees into storeys."
        slider = gui.add_slider("Cut height [m]", low, high, CUT_STEP, cut, hint=hint)
        self._keep("cut", slider, cut_at)
        scene = gui.add_checkbox("Scene", chosen.with_scene)
        self._keep("scene", scene, lambda on: lambda now: replace(now, with_scene=on))
        if drawing.has_hidden:
            hint = "What MuJoCo's own viewers hide: the geom groups from 3 on."
            hidden = gui.add_checkbox("Hidden geoms", chosen.with_hidden, hint=hint)
            self._keep("hidden", hidden, lambda on: lambda now: replace(now, with_hidden=on))

    def show(self, chosen: Choices, route: Route | None, told: Told | None) -> None:
        """Bring what is said, and inputs that follow from others, up to date."""
        exhibit, grid, at = self._exhibit, self._exhibit.grid, self._handles
        as_it_is = replace(chosen, doors=(), inflation=None)
        at["free"].content = texts.say_counts(exhibit.count(chosen), exhibit.count(as_it_is))
        panels = [exhibit.panel(chosen, number) for number in chosen.levels]
        at["legend"].content = texts.write_legend(panels)
        at["verify"].visible = chosen.layer == DISAGREEMENTS
        at["verified"].visible = chosen.layer == DISAGREEMENTS and exhibit.report is not None
        if exhibit.report is not None:
            at["verified"].content = texts.say_report(exhibit.report)
        is_inspecting = chosen.click == INSPECT
        at["told"].visible, at["route"].visible = is_inspecting, not is_inspecting
        at["told"].content = texts.say_cell(told, chosen.inflation)
        at["route"].content = texts.say_route(chosen, route)
        at["Clear"].visible = any((chosen.start, chosen.goal, chosen.inspected))
        if chosen.inflation is None:
            at["radius"].value = min(grid.agent_radius, float(at["radius"].max))
            at["clearance"].value = 0.0
        at["As baked"].disabled = chosen.inflation is None
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
            common = {*states.values()} if len(states) == len(grid.doors) else set()
            named = states.get(at["door"].value, AS_BAKED)
            at["state"].value = common.pop() if len(common) == 1 else named

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


def _unique(names: list[str]) -> list[str]:
    """Names, numbered where several are the same."""
    return [
        name if names.count(name) == 1 else f"{name} ({number})"
        for number, name in enumerate(names)
    ]
