"""The state of the viewer's page: the user's choices, and what the page shows for them.

This module needs neither a browser nor viser.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.episodes.episode import (
    FLY_TASK,
    Episode,
    EpisodeSet,
    list_goal_positions,
    scene_of,
)
from navbake.episodes.goals import find_goal_cells
from navbake.errors import QueryError
from navbake.navgrid import colors
from navbake.navgrid.cells import place_at
from navbake.navgrid.grid import NavGrid
from navbake.runtime.name_map import NO_ENTRY
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import Path
from navbake.runtime.stand import StandPoses
from navbake.scores import Trajectory, score_set
from navbake.types import Bool, Float, Json
from navbake.views.boxes import merge_voxels
from navbake.views.describe import Arc, list_arcs
from navbake.views.layers import (
    DISAGREEMENTS,
    LAYERS,
    Label,
    Panel,
    make_panel,
    paint,
    tint_free_cells,
)
from navbake.views.viewer import meshes
from navbake.views.viewer.flights import draw_tube, draw_voxels
from navbake.views.viewer.meshes import Drawing, MeshBatch, Pick, Surface, ViewRay
from navbake.voxels.finder import FlightPath
from navbake.voxels.grid import VoxelGrid

if TYPE_CHECKING:
    from navbake.baker.scene.scene import Scene
    from navbake.config.settings import BakeConfig
    from navbake.verifier.report import VerifyReport

Result = TypeVar("Result")

CUT_HEIGHT = 1.3  # at first, the scene is drawn up to this height over a level's ground [m]
# colours on the page
START_COLOR = colors.START
GOAL_COLOR = colors.ROUTE
HIGHLIGHT_COLOR = "#ff922b"
TRAJECTORY_COLOR = "#c2255c"
ARC_LEGEND = {
    "link": colors.LINK,
    "link, closed": colors.LINK_CLOSED,
    "stairs": colors.STAIRS,
}
NAME_HEIGHT = 0.4  # largest height of a name's letters [m]
POINT_NAME_HEIGHT = 0.18  # height of the letters of names of points, such as doors [m]
NAME_LIFT = 1.0  # height of names over the floor; most furniture is lower [m]
# how much of a distance in y, and of one in z, the first camera sees along the page
DEPTH_SHARE = 0.85
HEIGHT_SHARE = 0.53
POINT_NAME_SPACING = 2.0  # step by which names of points move up, relative to their letters
SNAP_DISTANCE = 0.3  # a click that is so near to free floor counts as on it [m]
LETTER_WIDTH = 0.65  # estimated width of a letter, relative to its height
INSPECT_TEXT = "tells about the cell"
ROUTE_TEXT = "sets start, then goal"
REACH_TEXT = "shows where a base reaches it"
CLICK_TEXTS = (INSPECT_TEXT, ROUTE_TEXT, REACH_TEXT)
"""What a click may do, as the page words it."""
# how many results of a method are kept, so that going back to a choice is fast
NUM_CACHED_RESULTS = 6
UNKNOWN_BALL_RADIUS = 0.1  # of a flight whose ball isn't known, as it is drawn [m]
SAMPLE_SIZE = 20_000  # number of cells that a verification looks at
MAX_NAMES = 250  # most names that are written; those of the largest rooms come first
REACH = (0.3, 0.8)  # at first, how near to a thing its base has to be [m]
# corners of a cell as multiples of half its side; the first is repeated at the end
CELL_OUTLINE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 0)])

Doors: TypeAlias = tuple[tuple[str, str], ...]
"""Pairs of a door's id and its state."""


@dataclass(frozen=True)
class Choices:
    """The choices of the page's user.

    Attributes:
        levels: numbers of the shown levels, ascending.
        layer: one of `ViewState.layers`.
        inflation: the agent's radius [m] and the clearance [m] to inflate the grid by; None for the
            grid as it is.
        doors: the ids and states of the doors whose state differs from the grid's.
        cut: world z above which scene and voxels are not drawn [m]; None to draw all of them.
        with_scene: whether to draw the scene.
        with_voxels: whether to draw the voxels.
        with_hidden: whether to draw also the geom groups from 3 on, which MuJoCo's viewers hide.
        with_names: whether to write the names of rooms and doors.
        opacity: the opacity of the layer, above 0, up to 1.
        click: the effect of a click on a cell, one of `CLICK_TEXTS`.
        start: the start of the path, None for none.
        goal: the goal of the path, None for none.
        inspected: the cell that is described, None for none.
        reached: the click on the thing that a robot's base is to reach, None for none.
        reach: least and greatest distance from the base's axis to that thing [m].
        episode: the id of the shown episode, empty for none.
    """

    levels: tuple[int, ...]
    layer: str = "occupancy"
    inflation: tuple[float, float] | None = None
    doors: Doors = ()
    cut: float | None = None
    with_scene: bool = True
    with_voxels: bool = True
    with_hidden: bool = False
    with_names: bool = True
    opacity: float = 0.9
    click: str = INSPECT_TEXT
    start: Pick | None = None
    goal: Pick | None = None
    inspected: Pick | None = None
    reached: Pick | None = None
    reach: tuple[float, float] = REACH
    episode: str = ""

    def with_level(self, grid: NavGrid, level_number: int | None) -> Choices:
        """Return the choices with one level or all levels shown; the scene is cut above them.

        Args:
            grid: the grid of the page.
            level_number: the number of the level; None for all.
        """
        levels = tuple(range(len(grid.levels))) if level_number is None else (level_number,)
        return replace(self, levels=levels, cut=grid.levels[levels[-1]].ground + CUT_HEIGHT)

    def with_door(self, grid: NavGrid, door_ids: Sequence[str], state: str) -> Choices:
        """Return the choices with doors in a state; doors that lack the state stay unchanged.

        Args:
            grid: the grid of the page.
            door_ids: the ids of the doors.
            state: the state, such as ``closed``.
        """
        grid_state_of_door = {door.id: door.state for door in grid.doors}
        changed_ids = [
            door.id for door in grid.doors if door.id in door_ids and state in door.states
        ]
        state_of_door = {**dict(self.doors), **dict.fromkeys(changed_ids, state)}
        return replace(
            self, doors=tuple(sorted(state_of_door.items() - grid_state_of_door.items()))
        )

    def without_clicks(self) -> Choices:
        """Return the choices without clicked cells."""
        return replace(self, start=None, goal=None, inspected=None, reached=None)

    def with_click(self, clicked: Pick | None) -> Choices:
        """Return the choices after a click on a cell; None is a click outside of all cells."""
        if self.click == INSPECT_TEXT:
            return replace(self, inspected=clicked)
        if self.click == REACH_TEXT:
            return replace(self, reached=clicked)
        if clicked is None:
            return self
        if self.start is None or self.goal is not None:
            return replace(self, start=clicked, goal=None)
        return replace(self, goal=clicked)


def first_choices(grid: NavGrid) -> Choices:
    """Return the choices of a new page: the occupancy of all levels is shown."""
    return Choices(()).with_level(grid, None)


def transfer_choices(choices: Choices, grid: NavGrid) -> Choices:
    """Transfer choices to a new grid, such as a new bake of the scene.

    Args:
        choices: the choices for the previous grid.
        grid: the grid to show.

    Returns:
        The choices without levels, doors and clicked cells that the grid doesn't have.
    """

    def find_again(clicked: Pick | None) -> Pick | None:
        """Find the new grid's cell at the position of a previous click; None if there is none."""
        if clicked is None or clicked.cell.level >= len(grid.levels):
            return None
        cell = grid.cell_at(clicked.position, clicked.cell.level)
        return None if cell is None else clicked._replace(cell=cell, geom=None)

    all_levels = tuple(range(len(grid.levels)))
    door_states = {(door.id, state) for door in grid.doors for state in door.states}
    new_start = find_again(choices.start)
    return replace(
        choices,
        levels=tuple(level for level in choices.levels if level in all_levels) or all_levels,
        doors=tuple(door for door in choices.doors if door in door_states),
        inspected=find_again(choices.inspected),
        reached=find_again(choices.reached),
        start=new_start,
        goal=find_again(choices.goal) if new_start else None,
    )


class FreeSpace(NamedTuple):
    """The free cells of some levels: number and area; and the number of cells with a floor."""

    num_free_cells: int  # number of free cells
    num_floor_cells: int  # number of cells with a floor
    free_area: float  # [m²]


class EpisodeRun(NamedTuple):
    """An episode and an agent's trajectory in it, as far as the page has them."""

    episode: Episode | None  # None where only the trajectory is known
    trajectory: Trajectory | None


Runs: TypeAlias = dict[str, EpisodeRun]
"""Id of an episode -> its run."""


def list_runs(
    grid: NavGrid, episodes: EpisodeSet | None, trajectories: Sequence[Trajectory]
) -> Runs:
    """Pair episodes with trajectories.

    Args:
        grid: the grid; only the episodes of its scene are listed.
        episodes: the episodes; None to list all trajectories, without episodes.
        trajectories: the trajectories; if several are of the same episode, the last counts.

    Returns:
        Id of an episode -> its run.
    """
    if episodes is None:
        return {trajectory.episode: EpisodeRun(None, trajectory) for trajectory in trajectories}
    trajectory_of_episode = {trajectory.episode: trajectory for trajectory in trajectories}
    scene = scene_of(grid)
    return {
        episode.id: EpisodeRun(episode, trajectory_of_episode.get(episode.id))
        for episode in episodes.episodes
        if episode.scene == scene
    }


class NameLabel(NamedTuple):
    """A name that is written in the scene."""

    text: str
    position: tuple[float, float, float]  # the name's middle, world x, y, z [m]
    height: float  # height of the letters [m]

    @property
    def width(self) -> float:
        """The estimated width of the name [m]."""
        return LETTER_WIDTH * len(self.text) * self.height


class VisibleBatch(NamedTuple):
    """A mesh that several geoms show, and which of the geoms are drawn."""

    batch: MeshBatch
    is_drawn: Bool  # whether each of `batch.geoms` is drawn, shape (n,)


class Inspection(NamedTuple):
    """The description of the inspected cell, as the page shows it.

    Attributes:
        facts: the description of the cell, see `navbake.views.describe.describe_cell`.
        clicked: the name of the clicked object, None for none.
        highlighted: the corners of the drawn triangles of the objects that block the cell, world
            frame [m], shape (n, 3, 3). If nothing blocks the cell, those of the clicked object, if
            the grid lists that object in the cell.
        outline: the corners of the cell, the first one repeated at the end, world frame [m],
            shape (5, 3).
    """

    facts: Json
    clicked: str | None
    highlighted: NDArray[np.float32]
    outline: Float


class StandView(NamedTuple):
    """Where a robot's base can stand to reach the clicked thing, as the page shows it.

    Attributes:
        poses: poses from which it is reached, see `PathFinder.stand_poses`; maybe none.
        region: the cells from which it is reached: their corners, world frame [m], shape
            (n, 4, 3).
        highlighted: the corners of the drawn triangles of the thing, world frame [m], shape
            (k, 3, 3).
    """

    poses: StandPoses
    region: Float
    highlighted: NDArray[np.float32]


def cache_results_by(*fields: str) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Make a decorator of `ViewState` methods that caches their last `NUM_CACHED_RESULTS` results.

    Args:
        fields: the names of the fields of `Choices` that the result depends on.

    Returns:
        A decorator of methods that take the choices and, optionally, the number of a level.
    """

    def decorate(method: Callable[..., Result]) -> Callable[..., Result]:
        @wraps(method)
        def call(view_state: ViewState, choices: Choices, *level_number: int) -> Result:
            results = view_state.cache.setdefault((method.__name__, *level_number), {})
            cache_key = tuple(getattr(choices, field) for field in fields)
            # the entry moves to the end of the dict: the first is the one not used for longest
            if cache_key in results:
                result: Result = results.pop(cache_key)
            else:
                result = method(view_state, choices, *level_number)
            results[cache_key] = result
            while len(results) > NUM_CACHED_RESULTS:
                del results[next(iter(results))]
            return result

        return call

    return decorate


class ViewState:
    """A grid and its scene, if it has one, and methods that compute the contents of the page.

    Attributes:
        grid: the grid as it is in its file.
        scene: the scene of the grid, None for none.
        config: the settings of the bake, None if they are unknown.
        note: a line of text for the user, empty for none.
        runs: episodes and trajectories that can be shown.
        episodes: the set that the episodes are of; None for none.
        voxels: voxels to draw, in which flights are scored; None for none.
        flight: a path of a ball to draw; None for none.
        report: the report of the last verification; None before the first.
        floor_surfaces: for each level, the surface that its layers are drawn on.
        voxel_boxes: boxes that cover the occupied voxels; None without voxels.
        cache: results of methods that `cache_results_by` decorates: method (and level) -> fields of
            the choices -> result.
    """

    def __init__(
        self,
        grid: NavGrid,
        scene: Scene | None = None,
        config: BakeConfig | None = None,
        note: str = "",
        runs: Runs | None = None,
        episodes: EpisodeSet | None = None,
        voxels: VoxelGrid | None = None,
        flight: FlightPath | None = None,
    ) -> None:
        self.grid = grid
        self.scene = scene
        self.config = config
        self.note = note
        self.runs: Runs = runs or {}
        self.episodes = episodes
        self.voxels = voxels
        self.flight = flight
        self.report: VerifyReport | None = None
        # without a scene, cells without a floor are drawn at the level's ground
        with_holes = scene is not None
        self.floor_surfaces = [
            meshes.make_floor_surface(level, with_holes=with_holes) for level in grid.levels
        ]
        self.voxel_boxes = None if voxels is None else merge_voxels(voxels)
        self.cache: dict[Hashable, dict[Hashable, Any]] = {}

    @property
    def layers(self) -> tuple[str, ...]:
        """The names of the layers that can be chosen."""
        needed_tables: Mapping[str, Sequence[object]] = {
            "doors": self.grid.doors,
            "area": self.grid.areas,
        }
        names = tuple(name for name in LAYERS if needed_tables.get(name, True))
        return names if self.scene is None else (*names, DISAGREEMENTS)

    @property
    def bounds(self) -> Float:
        """Lower and upper corner of the box that the camera shows, world frame [m], shape (2, 3).

        In z, the box begins at the lowest ground, and ends `CUT_HEIGHT` above the highest one.
        """
        level_bounds = np.array([level.lattice.bounds for level in self.grid.levels])
        grounds = [level.ground for level in self.grid.levels]
        low_xy = level_bounds[:, :2].min(axis=0)
        high_xy = level_bounds[:, 2:].max(axis=0)
        return np.array([[*low_xy, min(grounds)], [*high_xy, max(grounds) + CUT_HEIGHT]])

    @cache_results_by("doors", "inflation")
    def shown_grid(self, choices: Choices) -> NavGrid:
        """Return the grid with the chosen states of doors and the chosen inflation."""
        grid = self.grid
        if choices.doors:
            grid = grid.with_doors(dict(choices.doors))
        if choices.inflation is not None:
            radius, clearance = choices.inflation
            grid = grid.inflate(radius, clearance)
        return grid

    def count(self, choices: Choices) -> FreeSpace:
        """Count the free cells of the shown levels."""
        levels = [self.shown_grid(choices).levels[level_number] for level_number in choices.levels]
        num_free_cells = sum(int(np.count_nonzero(level.free)) for level in levels)
        num_floor_cells = sum(
            int(np.count_nonzero(~np.isnan(level.floor_height))) for level in levels
        )
        return FreeSpace(
            num_free_cells,
            num_floor_cells,
            num_free_cells * self.grid.levels[0].lattice.cell_size ** 2,
        )

    @cache_results_by("doors", "inflation", "layer")
    def panel(self, choices: Choices, level_number: int) -> Panel:
        """Make the panel of a level's chosen layer.

        If the layer shows disagreements and there is no verification yet, it is the panel of the
        occupancy.

        Args:
            choices: the user's choices.
            level_number: the number of the level.
        """
        layer = choices.layer
        findings = None if self.report is None else self.report.findings
        if layer == DISAGREEMENTS and findings is None:
            layer = "occupancy"
        panel = make_panel(self.shown_grid(choices), layer, level_number, findings=findings)
        return tint_free_cells(panel)

    @cache_results_by("doors", "inflation", "layer", "opacity")
    def overlay(self, choices: Choices, level_number: int) -> bytes:
        """Draw the chosen layer of a level on its floor.

        Args:
            choices: the user's choices.
            level_number: the number of the level.

        Returns:
            The triangles as GLB.
        """
        rgb = paint(self.panel(choices, level_number))
        return meshes.draw_overlay(self.floor_surfaces[level_number], rgb, choices.opacity)

    def names(self, choices: Choices) -> list[NameLabel]:
        """List the names to write on the shown levels: level by level, largest rooms first.

        A name is left out if it would overlap the name of a larger room on its level, or if a
        higher shown level has a floor above it. The name of a point, such as a stop of a link,
        moves up first.
        """
        if not choices.with_names:
            return []
        candidate_names = []
        for level_number in choices.levels:
            for label in self.panel(choices, level_number).labels:
                floor_of_level = self._floors_at(label, choices.levels)
                z = floor_of_level.get(level_number, self.grid.levels[level_number].ground)
                is_hidden = any(
                    level > level_number and floor > z + self.grid.max_step
                    for level, floor in floor_of_level.items()
                )
                if is_hidden:
                    continue
                letter_height = POINT_NAME_HEIGHT
                if label.width:
                    letter_height = label.width / (LETTER_WIDTH * len(label.text))
                name = NameLabel(
                    label.text, (label.x, label.y, z + NAME_LIFT), min(NAME_HEIGHT, letter_height)
                )
                candidate_names.append((-label.width, level_number, name))
        names_by_level: dict[int, list[NameLabel]] = {
            level_number: [] for level_number in choices.levels
        }
        for negative_width, level_number, name in sorted(candidate_names)[:MAX_NAMES]:
            is_point = not negative_width
            for num_steps in range(4) if is_point else (0,):
                x, y, z = name.position
                raised_z = z + num_steps * POINT_NAME_SPACING * name.height
                moved_name = name._replace(position=(x, y, raised_z))
                if not any(
                    _overlaps(moved_name, earlier_name)
                    for earlier_name in names_by_level[level_number]
                ):
                    names_by_level[level_number].append(moved_name)
                    break
        return [name for names_of_level in names_by_level.values() for name in names_of_level]

    def _floors_at(self, label: Label, level_numbers: Sequence[int]) -> dict[int, float]:
        """Find the floors at a label: number of a level -> world z of its floor there [m].

        Levels without a floor there are left out.
        """
        floor_of_level = {}
        for level_number in level_numbers:
            place = place_at(self.grid, (label.x, label.y), level_number)
            if place is not None and place.floor is not None:
                floor_of_level[level_number] = place.floor
        return floor_of_level

    @cache_results_by("levels", "layer")
    def arcs(self, choices: Choices) -> list[Arc]:
        """List the arcs of links and stairs between stops on shown levels.

        The list is empty unless the chosen layer is ``links``.
        """
        if choices.layer != "links":
            return []
        return list_arcs(self.grid, choices.levels)

    @cache_results_by("doors", "with_hidden")
    def drawing(self, choices: Choices) -> Drawing | None:
        """Return the whole scene as triangles, with the chosen states of doors.

        It is None if the grid has no scene.
        """
        if self.scene is None:
            return None
        if not choices.doors:
            return meshes.draw_scene(self.scene, with_hidden=choices.with_hidden)
        from navbake.verifier.source import pose_doors  # loads MuJoCo, which moves the doors

        door_pose = pose_doors(self.scene, self.grid.with_doors(dict(choices.doors)))
        return meshes.draw_scene(
            self.scene,
            data=door_pose.data,
            removed=door_pose.removed_geoms,
            with_hidden=choices.with_hidden,
        )

    @cache_results_by("doors", "with_hidden", "with_scene", "cut")
    def surfaces(self, choices: Choices) -> tuple[Surface, ...]:
        """Return the triangles of the scene that are drawn: those below the chosen cut."""
        drawing = self.drawing(choices) if choices.with_scene else None
        if drawing is None:
            return ()
        if choices.cut is None:
            return drawing.surfaces
        return meshes.cut_drawing(drawing, choices.cut)

    @cache_results_by("doors", "with_hidden", "with_scene", "cut")
    def scene_glb(self, choices: Choices) -> bytes:
        """Return the drawn scene as GLB, without the geoms that `batches` draws; may be empty."""
        surfaces = self.surfaces(choices)
        drawing = self.drawing(choices)
        if drawing is None or not surfaces:
            return b""
        drawn_batch_geoms = [batch.geoms[batch.is_below(choices.cut)] for batch in drawing.batches]
        if drawn_batch_geoms:
            batch_geom_ids = np.concatenate(drawn_batch_geoms)
            surfaces = tuple(
                surface._replace(faces=surface.faces[~np.isin(surface.face_geoms, batch_geom_ids)])
                for surface in surfaces
            )
        return meshes.draw_surfaces(surfaces, drawing.textures)

    @cache_results_by("with_voxels", "cut")
    def voxel_glb(self, choices: Choices) -> bytes:
        """Return the voxels below the chosen cut as GLB; empty if none are drawn."""
        if self.voxel_boxes is None or not choices.with_voxels:
            return b""
        return draw_voxels(self.voxel_boxes, choices.cut)

    @cache_results_by("episode")
    def flight_glbs(self, choices: Choices) -> list[bytes]:
        """Return the flight, and that of the chosen episode, as tubes; a GLB each."""
        tubes = []
        if self.flight is not None:
            tubes.append((self.flight.positions, self.flight.radius))
        episode = self.shown_flight_episode(choices)
        if episode is not None and episode.path:
            tubes.append((np.array(episode.path), self.flight_radius))
        return [
            draw_tube(positions, radius, START_COLOR, GOAL_COLOR) for positions, radius in tubes
        ]

    @property
    def flight_radius(self) -> float:
        """Radius of the ball that the episodes are for [m]; a small one if they don't say it."""
        agent = None if self.episodes is None else self.episodes.header.agent
        return UNKNOWN_BALL_RADIUS if agent is None else agent.radius

    def shown_flight_episode(self, choices: Choices) -> Episode | None:
        """Return the chosen episode if it is a flight, else None."""
        episode_run = self.runs.get(choices.episode)
        episode = None if episode_run is None else episode_run.episode
        return episode if episode is not None and episode.task == FLY_TASK else None

    def batches(self, choices: Choices) -> list[VisibleBatch]:
        """List the batches of the scene of which some geoms are wholly below the chosen cut."""
        drawing = self.drawing(choices) if choices.with_scene else None
        if drawing is None:
            return []
        batches = [VisibleBatch(batch, batch.is_below(choices.cut)) for batch in drawing.batches]
        return [visible_batch for visible_batch in batches if visible_batch.is_drawn.any()]

    def click(self, choices: Choices, ray: ViewRay) -> Choices:
        """Return the choices after a click.

        Args:
            choices: the choices before the click.
            ray: the ray from the camera through the click.
        """
        level_surfaces = [self.floor_surfaces[level_number] for level_number in choices.levels]
        clicked_cell = meshes.pick_cell(
            self.grid, ray, [*self.surfaces(choices), *level_surfaces], choices.levels
        )
        return choices.with_click(clicked_cell)

    @cache_results_by("doors", "inflation")
    def finder(self, choices: Choices) -> PathFinder:
        """Return a path finder on the shown grid."""
        return PathFinder(self.shown_grid(choices))

    @cache_results_by("doors", "inflation", "start", "goal")
    def route(self, choices: Choices) -> Path | str | None:
        """Find the path from the clicked start to the clicked goal.

        A click up to `SNAP_DISTANCE` beside free floor, such as in a wall, counts as on it.

        Returns:
            The path; or as text, why there is none. None if the start or the goal isn't clicked.
        """
        if choices.start is None or choices.goal is None:
            return None
        finder = self.finder(choices)
        try:
            start = _snap_click(finder, choices.start)
            goal = _snap_click(finder, choices.goal)
            return finder.find_path(start, goal) or finder.why_not(start, goal) or "no path"
        except QueryError as error:
            return str(error)

    @cache_results_by("doors", "inflation", "click", "reached", "reach", "with_scene", "cut")
    def stands(self, choices: Choices) -> StandView | None:
        """Find where a base as wide as the agent can stand to reach the clicked thing.

        The thing is the clicked object, door or wall. Where none was clicked, it is the place on
        the floor, or of a grid without a scene the first object in the cell.

        Args:
            choices: the user's choices.

        Returns:
            The poses and the region; None without a click.
        """
        clicked = choices.reached
        if clicked is None or choices.click != REACH_TEXT:
            return None
        finder = self.finder(choices)
        flat = finder.search.flat
        names = finder.search.names
        drawing = self.drawing(choices)
        object_names: list[str] = []
        if drawing is None:
            clicked_cell = flat.cells_at(clicked.position, clicked.cell.level)
            cell_entry = int(names.entry_of_cell[clicked_cell])
            if cell_entry != NO_ENTRY:
                object_names = sorted(names.entries[cell_entry].objects)
        elif clicked.geom is not None and drawing.names[clicked.geom] in names.entries_of_name:
            object_names = [drawing.names[clicked.geom]]
        target = f"object:{object_names[0]}" if object_names else clicked.position
        poses = finder.stand_poses(target, reach=choices.reach)
        region = finder.stand_region(target, reach=choices.reach)
        positions = flat.positions(
            np.flatnonzero(np.concatenate([mask.ravel() for mask in region]))
        )
        half_side = self.grid.levels[0].lattice.cell_size / 2
        corners = positions[:, None] + half_side * CELL_OUTLINE[:4]
        highlighted_triangles = np.empty((0, 3, 3), np.float32)
        if drawing is not None and object_names:
            geoms = [geom for geom, name in enumerate(drawing.names) if name == object_names[0]]
            highlighted_triangles = select_triangles(self.surfaces(choices), geoms)
        return StandView(poses, corners, highlighted_triangles)

    @cache_results_by("doors", "inflation", "episode")
    def episode_path(self, choices: Choices) -> Float:
        """Return the path of the chosen episode: world x, y, z [m], shape (n, 3).

        If the episode stores no path, the shortest path in the shown grid is planned; for a
        sequence of goals and for a flight, none is. Without a path, the array is empty.
        """
        episode_run = self.runs.get(choices.episode)
        if episode_run is None or episode_run.episode is None:
            return np.empty((0, 3))
        episode = episode_run.episode
        if episode.path or episode.task in ("sequence", FLY_TASK):
            return np.array(episode.path or ()).reshape(-1, 3)
        finder = self.finder(choices)
        try:
            if any(goal.view_points for goal in episode.goals):  # nobody stands in the object
                cells = np.concatenate([find_goal_cells(finder, goal) for goal in episode.goals])
                places = finder.search.flat.positions(cells)
            else:
                places = np.array(list_goal_positions(episode)).reshape(-1, 3)
            path = finder.find_path(episode.start, places)
        except QueryError:  # a start or a goal that isn't on the grid
            path = None
        return np.empty((0, 3)) if path is None else path.positions

    @cache_results_by("episode")
    def scores(self, choices: Choices) -> Json | str | None:
        """Score the agent's trajectory in the chosen episode, on the grid as it is in its file.

        Flights are scored in the voxels.

        Returns:
            The measures by name, see `navbake.scores.Measures.scores`; or as text, why there are
            none. None if there is no trajectory, or no episode to score it by.
        """
        episode_run = self.runs.get(choices.episode)
        if episode_run is None or episode_run.trajectory is None or self.episodes is None:
            return None
        is_flight = self.shown_flight_episode(choices) is not None
        if is_flight and self.voxels is None:
            return "flights are scored in their voxels: --voxels FILE"
        grid = self.voxels if is_flight and self.voxels is not None else self.grid
        try:
            [measures] = score_set(self.episodes, [episode_run.trajectory], grid, partial=True)
        except QueryError as error:
            return str(error)
        return measures

    def inspect(self, choices: Choices) -> Inspection | None:
        """Describe the inspected cell; return None if there is none."""
        inspected_cell = choices.inspected
        if inspected_cell is None or choices.click != INSPECT_TEXT:
            return None
        x, y, z = inspected_cell.position
        facts = self.shown_grid(choices).describe_cell((x, y), inspected_cell.cell.level)
        clicked_name = None
        highlighted_triangles = np.empty((0, 3, 3), np.float32)
        drawing = self.drawing(choices)
        if drawing is not None:
            clicked_name = (
                None if inspected_cell.geom is None else drawing.names[inspected_cell.geom]
            )
            blocking_geoms = [
                geom for geom, name in enumerate(drawing.names) if name in facts["blockers"]
            ]
            names_in_cell = [*facts["objects"], *facts["walls"], *facts["doors"]]
            if (
                not blocking_geoms
                and inspected_cell.geom is not None
                and clicked_name in names_in_cell
            ):
                blocking_geoms = [inspected_cell.geom]
            highlighted_triangles = select_triangles(self.surfaces(choices), blocking_geoms)
        half_side = self.grid.levels[0].lattice.cell_size / 2
        outline = np.array([*facts["center"], z]) + half_side * CELL_OUTLINE
        return Inspection(facts, clicked_name, highlighted_triangles, outline)

    def verify(self) -> None:
        """Compare a sample of the grid's cells with the scene, and keep the report.

        Raises:
            QueryError: there is no scene.
        """
        if self.scene is None:
            raise QueryError("there is no scene to compare the grid with")
        # loads MuJoCo and FCL
        from navbake.verifier.verify import verify_scene

        self.report = verify_scene(self.grid, self.scene, self.config, sample=SAMPLE_SIZE)
        self.cache.clear()


def _snap_click(finder: PathFinder, clicked: Pick) -> ArrayLike:
    """Return the place nearest to a click where the agent can stand; the click if none is near."""
    level = clicked.cell.level
    place = finder.snap(clicked.position, level=level, max_distance=SNAP_DISTANCE)
    return clicked.position if place is None else place


def _overlaps(first_name: NameLabel, second_name: NameLabel) -> bool:
    """Whether two names overlap, seen from -y and above, as the first camera looks."""
    x_distance = abs(first_name.position[0] - second_name.position[0])
    y_distance = first_name.position[1] - second_name.position[1]
    z_distance = first_name.position[2] - second_name.position[2]
    mean_width = (first_name.width + second_name.width) / 2
    mean_height = (first_name.height + second_name.height) / 2
    # along the page, on which names stand upright
    page_distance = abs(y_distance * DEPTH_SHARE + z_distance * HEIGHT_SHARE)
    return x_distance < mean_width and page_distance < mean_height


def select_triangles(surfaces: Sequence[Surface], geoms: Sequence[int]) -> NDArray[np.float32]:
    """Select the triangles of some geoms.

    Args:
        surfaces: the surfaces of a drawing.
        geoms: the ids of the geoms.

    Returns:
        The triangles' corners, world frame [m], shape (n, 3, 3).
    """
    triangles = [np.empty((0, 3, 3), np.float32)]
    for surface in surfaces:
        faces = surface.faces[np.isin(surface.face_geoms, geoms)]
        triangles.append(surface.vertices[faces])
    return np.concatenate(triangles)
