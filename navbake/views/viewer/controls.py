"""The panel of controls on the viewer's page: its inputs, and its texts as Markdown and HTML.

Names from files are escaped.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

from navbake.episodes.episode import Episode
from navbake.errors import count_of
from navbake.navgrid.colors import STAND
from navbake.runtime.paths import Path
from navbake.types import Json
from navbake.views.layers import DISAGREEMENTS, Panel
from navbake.views.tables import list_cell_facts
from navbake.views.viewer.view_state import (
    ARC_LEGEND,
    CLICK_TEXTS,
    GOAL_COLOR,
    INSPECT_TEXT,
    REACH_TEXT,
    ROUTE_TEXT,
    START_COLOR,
    TRAJECTORY_COLOR,
    Choices,
    FreeSpace,
    Inspection,
    StandView,
    ViewState,
)

if TYPE_CHECKING:
    import viser

Change: TypeAlias = Callable[[Choices], Choices]
"""A function that returns new choices from the present ones."""

ALL_LEVELS = "all levels"
ALL_DOORS = "all doors"
AS_BAKED = "as baked"
NO_EPISODE = "none"
MAX_EPISODES = 500  # most episodes that the panel lists
RADIUS_STEP = 0.01  # step of the sliders for radius and clearance [m]
MAX_RADIUS = 1.0  # end of these sliders, unless twice the grid's radius is more [m]
MAX_CHECKBOXES = 12  # a grid with more levels has no checkboxes for levels
CUT_STEP = 0.05  # step of the slider for the cut [m]
INFLATED_HINT = "The grid was inflated when it was made: its doors stay as they are."
MARKDOWN_SIGNS = re.compile(r"([\\`*_{}\[\]<>()#+!|~.&:@-])")
MIN_SNAP_DISTANCE = 0.005  # ends of paths that are nearer to their clicks are where these are [m]
HINT_INSPECT = "Click a cell or a thing to read about it."
HINT_START = "Click where the path starts."
HINT_GOAL = "Click where it goes to."
HINT_REACH = "Click a thing, or a place on the floor, that a robot is to reach."
MAX_REACH = 2.0  # end of the slider for the reach [m]
REACH_STEP = 0.05  # [m]
MAX_LISTED_NAMES = 6  # most names in a list; the text says how many more there are
# measure of a trajectory -> its title on the page, and its unit
SCORE_TITLES = {
    "spl": ("SPL", ""),
    "soft_spl": ("SoftSPL", ""),
    "ndtw": ("nDTW", ""),
    "distance": ("left to the goal", " m"),
    "length": ("went", " m"),
    "shortest": ("shortest path", " m"),
    "collisions": ("collisions", ""),
    "time": ("time", " s"),
    "coverage": ("covered", ""),
}
MAX_SCALES = 3  # most color scales in the legend


class Controls:
    """The panel of a page: inputs that change the user's choices, and texts that describe them."""

    def __init__(
        self,
        gui: viser.GuiApi,
        view_state: ViewState,
        choices: Choices,
        change: Callable[[Change], None],
        verify: Callable[[], None],
        switch_dark: Callable[[viser.ClientHandle], None],
        save_picture: Callable[[viser.ClientHandle], None],
    ) -> None:
        """Empty the panel, and fill it.

        Args:
            gui: viser's panel.
            view_state: the grid and its scene.
            choices: the user's choices.
            change: is called when the user sets an input; it applies a change of the choices.
            verify: is called when the user wants to compare the grid with the scene.
            switch_dark: makes the page of one client dark, or light again.
            save_picture: sends a picture to one client.
        """
        self._gui = gui
        self._view_state = view_state
        self._change = change
        self._switch_dark = switch_dark
        self._save_picture = save_picture
        # name -> an input or text of viser; their types differ
        self._handles: dict[str, Any] = {}
        gui.reset()
        self._status = gui.add_markdown("", visible=False)
        gui.add_markdown(_format_heading(view_state))
        with gui.add_folder("Layer"):
            self._add_layers(choices, verify)
        with gui.add_folder("Agent"):
            self._add_agent(choices)
        with gui.add_folder("Click"):
            self._add_click(choices)
        if view_state.grid.doors:
            with gui.add_folder("Doors"):
                self._add_doors()
        if view_state.runs:
            with gui.add_folder("Episode"):
                self._add_episodes(choices)
        with gui.add_folder("Picture"):
            self._add_picture(choices)

    def _add_input(
        self,
        name: str,
        input_handle: viser.GuiInputHandle[Any],
        make_change: Callable[[Any], Change],
    ) -> None:
        """Register an input of the panel.

        Args:
            name: a name for the input, by which `_handles` has it.
            input_handle: the input.
            make_change: returns the change of the choices for a value that the user has set.
        """
        self._handles[name] = input_handle

        def on_update(event: viser.GuiEvent[viser.GuiInputHandle[Any]]) -> None:
            # without a client, the program itself has set the input
            if event.client is not None:
                self._change(make_change(event.target.value))

        input_handle.on_update(on_update)

    def _add_layers(self, choices: Choices, verify: Callable[[], None]) -> None:
        gui = self._gui
        grid = self._view_state.grid
        layers = self._view_state.layers
        layer_input = gui.add_dropdown("Layer", layers, initial_value=choices.layer)
        self._add_input("layer", layer_input, _make_setter("layer"))
        if len(grid.levels) > 1:
            level_names = [ALL_LEVELS, *_number_duplicates(grid.level_names)]

            def show_level(name: str) -> Change:
                level_number = None if name == ALL_LEVELS else level_names.index(name) - 1
                return lambda choices: choices.with_level(grid, level_number)

            shown_name = _find_shown_level_name(level_names, choices)
            level_input = gui.add_dropdown("Level", level_names, initial_value=shown_name)
            self._add_input("level", level_input, show_level)
        self._handles["legend"] = gui.add_html("")
        hint = "Let MuJoCo and FCL look at a sample of the cells (navbake verify)."
        verify_button = gui.add_button("Compare with the scene", hint=hint, visible=False)
        verify_button.on_click(lambda _: verify())
        self._handles["verify"] = verify_button
        self._handles["verified"] = gui.add_markdown("", visible=False)

    def _add_agent(self, choices: Choices) -> None:
        gui = self._gui
        grid = self._view_state.grid
        self._handles["free"] = gui.add_markdown("")
        max_size = max(MAX_RADIUS, 2 * grid.agent_radius)
        radius, clearance = choices.inflation or (grid.agent_radius, 0.0)

        def inflate(_: float) -> Change:
            radius_and_clearance = (self._handles["radius"].value, self._handles["clearance"].value)
            return _make_setter("inflation")(tuple(map(float, radius_and_clearance)))

        def add_slider(name: str, size: float, hint: str) -> None:
            slider = gui.add_slider(
                f"{name.capitalize()} [m]",
                min=0.0,
                max=max_size,
                step=RADIUS_STEP,
                initial_value=min(size, max_size),
                hint=hint,
            )
            self._add_input(name, slider, inflate)

        add_slider("radius", radius, "Inflate the grid for an agent of this radius.")
        add_slider("clearance", clearance, "Cells so near beyond cost more.")
        hint = "Show the grid as it is in the file, not inflated here."
        reset_button = gui.add_button("As baked", hint=hint)
        reset_button.on_click(lambda _: self._change(_make_setter("inflation")(None)))
        self._handles["as baked"] = reset_button

    def _add_click(self, choices: Choices) -> None:
        gui = self._gui
        click_input = gui.add_dropdown("A click", CLICK_TEXTS, initial_value=choices.click)
        self._add_input("click", click_input, _make_setter("click"))
        self._handles["cell"] = gui.add_markdown("")
        self._handles["route"] = gui.add_markdown("")
        reach_slider = gui.add_multi_slider(
            "Reach [m]",
            min=0.0,
            max=MAX_REACH,
            step=REACH_STEP,
            initial_value=choices.reach,
            hint="Least and greatest distance from the base's axis to the thing.",
        )
        self._add_input(
            "reach", reach_slider, lambda reach: _make_setter("reach")(tuple(map(float, reach)))
        )
        self._handles["stands"] = gui.add_markdown("")
        clear_button = gui.add_button("Clear", visible=False)
        clear_button.on_click(lambda _: self._change(Choices.without_clicks))
        self._handles["clear"] = clear_button

    def _add_doors(self) -> None:
        gui = self._gui
        grid = self._view_state.grid
        if "inflation" in grid.metadata:
            gui.add_markdown(INFLATED_HINT)
            return
        all_door_ids = [door.id for door in grid.doors]
        state_names = sorted({state for door in grid.doors for state in door.states})

        def set_state(state: str) -> Change:
            selected_door = self._handles["door"].value
            changed_ids = all_door_ids if selected_door == ALL_DOORS else [selected_door]

            def change(choices: Choices) -> Choices:
                if state != AS_BAKED:
                    return choices.with_door(grid, changed_ids, state)
                doors = tuple(door for door in choices.doors if door[0] not in changed_ids)
                return replace(choices, doors=doors)

            return change

        door_input = gui.add_dropdown("Door", [ALL_DOORS, *all_door_ids])
        # to select a door changes no choice, but the page is drawn, and shows the door's state
        self._add_input("door", door_input, lambda _: lambda choices: choices)
        state_input = gui.add_dropdown("State", [AS_BAKED, *state_names])
        self._add_input("state", state_input, set_state)

    def _add_episodes(self, choices: Choices) -> None:
        episode_names = [NO_EPISODE, *list(self._view_state.runs)[:MAX_EPISODES]]
        shown_name = choices.episode if choices.episode in episode_names else NO_EPISODE

        def show_episode(name: str) -> Change:
            return _make_setter("episode")("" if name == NO_EPISODE else name)

        episode_input = self._gui.add_dropdown("Episode", episode_names, initial_value=shown_name)
        self._add_input("episode", episode_input, show_episode)
        self._handles["task"] = self._gui.add_markdown("")

    def _add_picture(self, choices: Choices) -> None:
        gui = self._gui
        self._add_scene(choices)
        level_names = _number_duplicates(self._view_state.grid.level_names)
        if 1 < len(level_names) <= MAX_CHECKBOXES:
            for level_number, name in enumerate(level_names):
                checkbox = gui.add_checkbox(name, level_number in choices.levels)
                self._add_input(f"level {level_number}", checkbox, _make_level_switch(level_number))
        opacity_slider = gui.add_slider("Layer's opacity", 0.1, 1.0, 0.1, choices.opacity)
        self._add_input("opacity", opacity_slider, _make_setter("opacity"))
        names_checkbox = gui.add_checkbox("Names", choices.with_names)
        self._add_input("names", names_checkbox, _make_setter("with_names"))
        hint = "Of this reader alone; others keep theirs."
        dark_button = gui.add_button("Dark or light page", hint=hint)
        dark_button.on_click(_call_with_client(self._switch_dark))
        hint = "A PNG of the scene, as large as it is here."
        picture_button = gui.add_button("Save a picture", hint=hint)
        picture_button.on_click(_call_with_client(self._save_picture))

    def _add_scene(self, choices: Choices) -> None:
        """Add the inputs for scene and voxels; without both, add nothing."""
        gui = self._gui
        drawing = self._view_state.drawing(choices)
        voxels = self._view_state.voxels
        if drawing is None and voxels is None:
            return
        lowest_z = float(self._view_state.bounds[0, 2])
        highest_z = lowest_z
        if drawing is not None:
            highest_z = max(float(drawing.bounds[1, 2]), highest_z)
        if voxels is not None:
            lowest_z = min(float(voxels.bounds[0, 2]), lowest_z)
            highest_z = max(float(voxels.bounds[1, 2]), highest_z)
        highest_z += CUT_STEP
        cut_height = highest_z if choices.cut is None else min(choices.cut, highest_z)
        cut_height = max(lowest_z, cut_height)
        slider_end = round(highest_z, 2)

        def make_cut_change(cut_height: float) -> Change:
            is_at_end = cut_height >= slider_end - CUT_STEP / 2
            return _make_setter("cut")(None if is_at_end else cut_height)

        slider = gui.add_slider(
            "Cut height [m]",
            min=round(lowest_z, 2),
            max=slider_end,
            step=CUT_STEP,
            initial_value=round(cut_height, 2),
            hint="Scene and voxels are drawn up to here, so that one sees into storeys.",
        )
        self._add_input("cut", slider, make_cut_change)
        if voxels is not None:
            voxels_checkbox = gui.add_checkbox("Voxels", choices.with_voxels)
            self._add_input("voxels", voxels_checkbox, _make_setter("with_voxels"))
        if drawing is None:
            return
        scene_checkbox = gui.add_checkbox("Scene", choices.with_scene)
        self._add_input("scene", scene_checkbox, _make_setter("with_scene"))
        if drawing.has_hidden:
            hint = "What MuJoCo's own viewers hide: the geom groups from 3 on."
            hidden_checkbox = gui.add_checkbox("Hidden geoms", choices.with_hidden, hint=hint)
            self._add_input("hidden", hidden_checkbox, _make_setter("with_hidden"))

    def update(
        self,
        choices: Choices,
        route: Path | str | None,
        inspection: Inspection | None,
        stand_view: StandView | None,
    ) -> None:
        """Update the texts, and the inputs that depend on the choices.

        Args:
            choices: the user's choices.
            route: the path between the clicks, or why there is none; None if a click is missing.
            inspection: the inspected cell, None for none.
            stand_view: where a base can stand to reach the clicked thing; None without a click.
        """
        view_state = self._view_state
        handles = self._handles
        baked_choices = replace(choices, doors=(), inflation=None)
        handles["free"].content = describe_free_space(
            view_state.count(choices), view_state.count(baked_choices)
        )
        color_of_mark = {}
        if choices.start or choices.episode or view_state.flight is not None:
            color_of_mark = {"start": START_COLOR, "goal and path": GOAL_COLOR}
        if "task" in handles:
            episode_run = view_state.runs.get(choices.episode)
            task_text = describe_episode(episode_run.episode if episode_run else None)
            scores_text = describe_scores(view_state.scores(choices))
            handles["task"].content = "\n\n".join(filter(None, (task_text, scores_text)))
            if episode_run is not None and episode_run.trajectory is not None:
                color_of_mark["trajectory"] = TRAJECTORY_COLOR
        if stand_view is not None and len(stand_view.region):
            color_of_mark["base in reach"] = STAND
        arc_colors = {arc.color for arc in view_state.arcs(choices)}
        color_of_mark |= {
            meaning: color for meaning, color in ARC_LEGEND.items() if color in arc_colors
        }
        panels = [view_state.panel(choices, level_number) for level_number in choices.levels]
        handles["legend"].content = render_legend(panels, color_of_mark)
        shows_disagreements = choices.layer == DISAGREEMENTS
        handles["verify"].visible = shows_disagreements
        handles["verified"].visible = shows_disagreements and view_state.report is not None
        handles["verified"].content = describe_report(view_state)
        is_reaching = choices.click == REACH_TEXT
        handles["cell"].visible = choices.click == INSPECT_TEXT
        handles["route"].visible = choices.click == ROUTE_TEXT
        handles["reach"].visible = is_reaching
        handles["stands"].visible = is_reaching
        handles["cell"].content = describe_inspection(inspection, choices.inflation)
        handles["route"].content = describe_route(choices, route)
        handles["stands"].content = describe_stands(stand_view)
        clicks = (choices.start, choices.goal, choices.inspected, choices.reached)
        handles["clear"].visible = any(clicks)
        self._update_inputs(choices)

    def _update_inputs(self, choices: Choices) -> None:
        """Set the inputs whose values change with other choices, for example by `Clear`."""
        handles = self._handles
        grid = self._view_state.grid
        if choices.inflation is None:
            handles["radius"].value = min(grid.agent_radius, float(handles["radius"].max))
            handles["clearance"].value = 0.0
        handles["as baked"].disabled = choices.inflation is None
        if "level" in handles:
            handles["level"].value = _find_shown_level_name(list(handles["level"].options), choices)
        if "level 0" in handles:
            for level_number in range(len(grid.levels)):
                handles[f"level {level_number}"].value = level_number in choices.levels
        if "cut" in handles:
            cut_slider = handles["cut"]
            cut_height = cut_slider.max if choices.cut is None else choices.cut
            cut_slider.value = float(min(max(cut_height, cut_slider.min), cut_slider.max))
        if "state" in handles:
            state_of_door = dict(choices.doors)
            different_states = set(state_of_door.values())
            if len(state_of_door) == len(grid.doors) and len(different_states) == 1:
                handles["state"].value = different_states.pop()
            else:
                handles["state"].value = state_of_door.get(handles["door"].value, AS_BAKED)

    def show_status(self, text: str) -> None:
        """Write a line of Markdown at the top of the panel; an empty text removes it."""
        self._status.content = text
        self._status.visible = bool(text)


def _format_heading(view_state: ViewState) -> str:
    """Return the grid's name, its numbers of levels, and the view state's note, as Markdown."""
    grid = view_state.grid
    name = escape_markdown(grid.scene_id or "grid")
    levels_text = f"{len(grid.levels)} levels" if len(grid.levels) > 1 else "one level"
    cell_size_text = escape_markdown(f"{grid.levels[0].lattice.cell_size:g}")
    note_text = escape_markdown(view_state.note)
    return f"**{name}** — {levels_text}, cells of {cell_size_text} m\n\n{note_text}"


def _call_with_client(
    call: Callable[[viser.ClientHandle], None],
) -> Callable[[viser.GuiEvent[viser.GuiButtonHandle]], None]:
    """Return a callback of a button that calls a function with the client who pressed it."""

    def on_click(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client is not None:
            call(event.client)

    return on_click


def _make_setter(field_name: str) -> Callable[[Any], Change]:
    """Return a function that takes a value and returns the change that sets a field to it."""
    return lambda value: lambda choices: replace(choices, **{field_name: value})


def _make_level_switch(level_number: int) -> Callable[[bool], Change]:
    """Return a function that takes a bool and returns the change that shows or hides a level."""

    def make_change(is_shown: bool) -> Change:
        def change(choices: Choices) -> Choices:
            levels = set(choices.levels) - {level_number}
            if is_shown:
                levels.add(level_number)
            return replace(choices, levels=tuple(sorted(levels)))

        return change

    return make_change


def _find_shown_level_name(level_options: list[str], choices: Choices) -> str:
    """Return the name of the shown level; the first name if several levels are shown.

    Args:
        level_options: `ALL_LEVELS`, then the names of the levels.
        choices: the user's choices.
    """
    return level_options[choices.levels[0] + 1] if len(choices.levels) == 1 else level_options[0]


def _number_duplicates(level_names: list[str]) -> list[str]:
    """Return the names of levels; the level's number is appended to names that occur twice."""
    return [
        f"{name} ({level_number})" if level_names.count(name) > 1 else name
        for level_number, name in enumerate(level_names)
    ]


# --- texts ----------------------------------------------------------------------------------------


def escape_markdown(text: object) -> str:
    """Escape text for Markdown, and put it on one line.

    The page renders HTML in Markdown, scripts included. A line break would begin a new block, in
    which Markdown has different rules.
    """
    return MARKDOWN_SIGNS.sub(r"\\\1", " ".join(str(text).split()))


def describe_free_space(shown_space: FreeSpace, baked_space: FreeSpace) -> str:
    """Describe how much of the shown grid is free.

    Args:
        shown_space: the free space of the grid with the chosen doors and inflation.
        baked_space: the free space of the grid as it is in its file.

    Returns:
        Markdown.
    """
    text = f"**{shown_space.num_free_cells:,} free cells**, {shown_space.free_area:,.1f} m²"
    if shown_space != baked_space:
        return f"{text} — as baked: {baked_space.num_free_cells:,}"
    if not shown_space.num_floor_cells:
        return text
    return f"{text} — {shown_space.num_free_cells / shown_space.num_floor_cells:.0%} of the floor"


def describe_route(choices: Choices, route: Path | str | None) -> str:
    """Describe the path between two clicks.

    Args:
        choices: the user's choices, with the clicks.
        route: the path, or why there is none; None if a click is missing.

    Returns:
        Markdown; if a click is missing, what to click next.
    """
    if route is None:
        return HINT_GOAL if choices.start is not None and choices.goal is None else HINT_START
    if isinstance(route, str):
        return f"**No path**: {escape_markdown(route)}"
    length_text = escape_markdown(f"{route.length:.2f}")
    cost_text = escape_markdown(f"{route.cost:.2f}")
    lines = [f"**{length_text} m**, cost {cost_text}"]
    ends = (
        ("start", choices.start, route.positions[0]),
        ("goal", choices.goal, route.positions[-1]),
    )
    for name, clicked, place in ends:
        if clicked is not None:
            distance = math.dist(clicked.position[:2], place[:2].tolist())
            if distance > MIN_SNAP_DISTANCE:
                distance_text = escape_markdown(f"{distance:.2f}")
                lines.append(f"The {name} is {distance_text} m from the click, on free floor.")
    if route.rooms:
        lines.append(f"Rooms: {_list_names(route.rooms, ' → ')}")
    if route.doors:
        lines.append(f"Doors: {_list_names(route.doors, ', ')}")
    levels = list(dict.fromkeys(route.levels.tolist()))
    if len(levels) > 1:
        lines.append(f"Levels: {' → '.join(map(str, levels))}")
    return "\n\n".join(lines)


def describe_stands(stand_view: StandView | None) -> str:
    """Describe where a base can stand to reach the clicked thing.

    Args:
        stand_view: the poses and cells; None without a click.

    Returns:
        Markdown; without a click, what to click.
    """
    if stand_view is None:
        return HINT_REACH
    poses = stand_view.poses
    (target,) = poses.targets
    target_text = f"<code>{escape_markdown(target)}</code>"
    if not len(poses):
        return f"{target_text}: **no pose**: {escape_markdown(poses.why_not[target])}"
    cells_text = count_of(len(stand_view.region), "cell")
    nearest_text = escape_markdown(f"{poses.distances.min():.2f}")
    return f"{target_text} is in reach from **{cells_text}**, the nearest pose at {nearest_text} m"


def describe_inspection(
    inspection: Inspection | None, inflation: tuple[float, float] | None
) -> str:
    """Describe a cell, and why an agent can or can't stand there.

    Args:
        inspection: the inspected cell; None for none.
        inflation: the agent's radius [m] and clearance [m] by which the grid is inflated; None for
            no inflation.

    Returns:
        A Markdown table; if there is no cell, what to click.
    """
    if inspection is None:
        return HINT_INSPECT
    facts = inspection.facts
    verdict = "**blocked**"
    if facts["free"]:
        verdict = "**free**: an agent can stand here"
    elif facts["blockers"]:
        verdict = f"**blocked** by {_list_names(facts['blockers'], ', ')}"
    elif facts["floor"] is None:
        verdict = "**no floor** here"
    elif inflation is not None and not facts["occupied"]:
        radius_text = escape_markdown(f"{inflation[0]:g}")
        verdict = f"**blocked**: nearer to something than the radius, {radius_text} m"
    clicked_names = [inspection.clicked] if inspection.clicked else []
    rows = {"clicked": clicked_names, **list_cell_facts(facts)}
    lines = ["| | |", "|---|---|", f"| Verdict | {verdict} |"]
    for key, fact in rows.items():
        is_text = isinstance(fact, str)
        fact_text = escape_markdown(fact) if is_text else _list_names(fact, ", ")
        if fact_text:
            lines.append(f"| {escape_markdown(key)} | {fact_text} |")
    return "\n".join(lines)


def _list_names(names: Sequence[str], separator: str) -> str:
    """Join names, formatted as code, for Markdown; at most `MAX_LISTED_NAMES` are listed.

    They are in HTML, not between backquotes: there a ``|`` would end a table's cell.
    """
    listed_names = names[:MAX_LISTED_NAMES]
    text = separator.join(f"<code>{escape_markdown(name)}</code>" for name in listed_names)
    num_more = len(names) - len(listed_names)
    return f"{text} and {num_more} more" if num_more else text


def describe_episode(episode: Episode | None) -> str:
    """Describe the task of an episode as Markdown; return an empty text for no episode."""
    if episode is None:
        return ""
    first_goal = episode.goals[0]
    goal_name = first_goal.name or first_goal.category or first_goal.room
    task_text = f"**{escape_markdown(episode.task)}**"
    lines = [f"{task_text} {_list_names([goal_name], '')}" if goal_name else task_text]
    if episode.distance is not None:
        lines.append(f"shortest path {escape_markdown(f'{episode.distance:.2f}')} m")
    if episode.instruction:
        lines.append(escape_markdown(episode.instruction))
    return "\n\n".join(lines)


def describe_scores(scores: Json | str | None) -> str:
    """Describe the measures of a trajectory as Markdown.

    Args:
        scores: the measures by name, or why there are none; None for no trajectory.
    """
    if scores is None:
        return ""
    if isinstance(scores, str):
        return f"**Not scored**: {escape_markdown(scores)}"
    verdict = "success" if scores["success"] else "no success"
    lines = [f"**Trajectory: {verdict}**", "", "| | |", "|---|---|"]
    for name, (title, unit) in SCORE_TITLES.items():
        value = scores[name]
        if math.isfinite(value):
            lines.append(f"| {title} | {escape_markdown(f'{round(value, 2):g}')}{unit} |")
    return "\n".join(lines)


def render_legend(panels: Sequence[Panel], color_of_mark: Mapping[str, str] | None = None) -> str:
    """Write the legend of a layer.

    Args:
        panels: the panels of the shown levels, the lowest first.
        color_of_mark: the meaning of each kind of mark on the page, such as a path -> its colour.

    Returns:
        HTML: color scales, of the highest levels if there are too many; and what colours mean.
    """
    scales = [(panel.title, panel.scale) for panel in panels[::-1] if panel.scale is not None]
    html_parts = []
    for title, scale in scales[:MAX_SCALES]:
        ticks_html = "".join(
            f'<span style="position:absolute;left:{100 * tick.position:.1f}%;'
            f'transform:translateX(-{100 * tick.position:.0f}%)">{html.escape(tick.text)}</span>'
            for tick in scale.ticks
        )
        heading = title if len(scales) > 1 else scale.label
        html_parts.append(
            f"<div>{html.escape(heading)}</div>"
            f'<div style="height:10px;border-radius:2px;margin-top:2px;'
            f'background:linear-gradient(to right, {", ".join(scale.colors)})"></div>'
            f'<div style="position:relative;height:18px">{ticks_html}</div>'
        )
    color_of_meaning: dict[str, str] = {}
    for panel in panels:
        color_of_meaning |= dict(panel.legend)
    color_of_meaning |= color_of_mark or {}
    swatches_html = "".join(
        f'<span style="display:inline-flex;align-items:center;margin-right:10px">'
        f'<span style="width:11px;height:11px;border-radius:2px;margin-right:5px;'
        f'border:1px solid rgba(128,128,128,.6);background:{color}"></span>'
        f"{html.escape(meaning)}</span>"
        for meaning, color in color_of_meaning.items()
    )
    legend_body = "".join([*html_parts, f"<div>{swatches_html}</div>"])
    return f'<div style="font-size:12px;line-height:1.5;padding:2px 12px 6px">{legend_body}</div>'


def describe_report(view_state: ViewState) -> str:
    """Describe the outcome of the last verification as Markdown; empty if there is none."""
    report = view_state.report
    if report is None:
        return ""
    verdict = "agree" if report.ok else f"**disagree at {len(report.findings)} places**"
    return f"Grid and scene {verdict}, at {report.checked:,} of {report.num_cells:,} cells."


def format_error(error: Exception) -> str:
    """Format an error as a line of Markdown."""
    text = " ".join(str(error).split()) or type(error).__name__
    return f"**Error**: {escape_markdown(text)}"
