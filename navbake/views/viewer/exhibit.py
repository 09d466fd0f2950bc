"""What the viewer shows for what its reader has chosen; without a browser."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.episodes.episode import Episode, EpisodeSet, Goal, scene_of
from navbake.errors import QueryError
from navbake.navgrid import colors
from navbake.navgrid.cells import place_at
from navbake.navgrid.grid import NavGrid
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import Path
from navbake.scores import Trajectory
from navbake.types import Bool, Float, Json
from navbake.views.describe import bend, find_ways
from navbake.views.layers import DISAGREEMENTS, LAYERS, Panel, make_panel, paint
from navbake.views.viewer import meshes
from navbake.views.viewer.meshes import Batch, Drawing, Pick, Surface

if TYPE_CHECKING:
    from navbake.baker.scene.scene import Scene
    from navbake.config.settings import BakeConfig
    from navbake.verifier.report import VerifyReport

Made = TypeVar("Made")
CUT_OVER = 1.3  # a level is looked into from so high over its ground [m]
# colours on the page: of free cells, as one sees them on grey floors, too, and of marks
TINT = "#a9dfc4"
START = "#2f9e44"
GOAL = colors.ROUTE
LIT = "#ff922b"
TRAJECTORY = "#c2255c"
# arcs of stairs and of closed links
STAIRS = "#495057"
CLOSED = "#868e96"
# of letters: at most, and of names of points [m]
NAME_HEIGHT = 0.4
POINT_HEIGHT = 0.18
NAME_OVER = 1.0  # of names over the floor: most furniture is lower [m]
LETTER = 0.65  # how wide a letter is by its height
INSPECT = "tells about the cell"
ROUTE = "sets start, then goal"
CLICKS = (INSPECT, ROUTE)
"""What a click may do."""
RECENT = 6  # results of a kind that are kept, so that going back is fast
SAMPLE = 20_000  # cells that are verified
MOST_NAMES = 250  # names that are written at most, the largest rooms' first


@dataclass(frozen=True)
class Choices:
    """What is to be shown."""

    levels: tuple[int, ...]  # numbers, ascending
    layer: str = "occupancy"
    inflation: tuple[float, float] | None = None  # radius, clearance [m]; None as the grid is
    doors: tuple[tuple[str, str], ...] = ()  # ids and states of those in another than the grid's
    cut: float | None = None  # world z above which the scene is not drawn [m], None for none
    with_scene: bool = True
    with_hidden: bool = False  # what MuJoCo's viewers hide, too: the geom groups from 3 on
    with_names: bool = True  # of rooms and doors
    opacity: float = 0.9  # of the layer, above 0, up to 1
    dark: bool | None = None  # the page; None, which is light, until a reader has it dark
    click: str = INSPECT  # one of `CLICKS`
    start: Pick | None = None  # of the path
    goal: Pick | None = None
    inspected: Pick | None = None  # the cell that is described
    episode: str = ""  # id of the one that is shown, none if empty

    def with_level(self, grid: NavGrid, number: int | None) -> Choices:
        """Look at one level from above, or at all of them: the scene is cut over the highest."""
        levels = tuple(range(len(grid.levels))) if number is None else (number,)
        return replace(self, levels=levels, cut=grid.levels[levels[-1]].ground + CUT_OVER)

    def with_door(self, grid: NavGrid, names: Sequence[str], state: str) -> Choices:
        """Put doors into a state; those that can't be in it stay as they are."""
        own = {door.id: door.state for door in grid.doors}
        able = [door.id for door in grid.doors if door.id in names and state in door.states]
        states = {**dict(self.doors), **dict.fromkeys(able, state)}
        return replace(self, doors=tuple(sorted(states.items() - own.items())))

    def with_dark_system(self) -> Choices:
        """For a reader whose system is dark: the page turns dark, unless a reader chose before."""
        return replace(self, dark=True) if self.dark is None else self

    def without_clicks(self) -> Choices:
        """Forget what was clicked."""
        return replace(self, start=None, goal=None, inspected=None)

    def with_click(self, found: Pick | None) -> Choices:
        """After a click on a cell, or beside all of them: None."""
        if self.click == INSPECT:
            return replace(self, inspected=found)
        if found is None:
            return self
        if self.start is None or self.goal is not None:
            return replace(self, start=found, goal=None)
        return replace(self, goal=found)


def first_choices(grid: NavGrid) -> Choices:
    """What is shown at first: the occupancy of all levels, cut over the highest one."""
    return Choices(()).with_level(grid, None)


def keep_choices(chosen: Choices, grid: NavGrid) -> Choices:
    """The same choices for another grid, such as a new bake: what it doesn't have is dropped."""

    def on_grid(found: Pick | None) -> Pick | None:
        """The cell of the other grid at the place of a click; None beside it."""
        if found is None or found.cell.level >= len(grid.levels):
            return None
        cell = grid.cell_at(found.position, found.cell.level)
        return None if cell is None else found._replace(cell=cell, geom=None)

    everything = range(len(grid.levels))
    states = {(door.id, state) for door in grid.doors for state in door.states}
    start = on_grid(chosen.start)
    return replace(
        chosen,
        levels=tuple(n for n in chosen.levels if n in everything) or tuple(everything),
        doors=tuple(door for door in chosen.doors if door in states),
        inspected=on_grid(chosen.inspected),
        start=start,
        goal=on_grid(chosen.goal) if start else None,
    )


def kept(*fields: str) -> Callable[[Callable[..., Made]], Callable[..., Made]]:
    """Keeps the last `RECENT` results of a method of `Exhibit`, by these fields of the choices."""

    def decorate(method: Callable[..., Made]) -> Callable[..., Made]:
        @wraps(method)
        def call(exhibit: Exhibit, chosen: Choices, *number: int) -> Made:
            results = exhibit.kept.setdefault((method.__name__, *number), {})
            key = tuple(getattr(chosen, name) for name in fields)
            made: Made = results.pop(key) if key in results else method(exhibit, chosen, *number)
            results[key] = made
            while len(results) > RECENT:
                del results[next(iter(results))]
            return made

        return call

    return decorate


Counts: TypeAlias = tuple[int, int, float]
"""How much of a grid is free: cells of all levels, those with a floor, and free area [m²]."""
Runs: TypeAlias = dict[str, tuple[Episode | None, Trajectory | None]]
"""Episodes, and where an agent was in them, by the episodes' ids."""


def list_runs(
    grid: NavGrid, episodes: EpisodeSet | None, trajectories: Sequence[Trajectory]
) -> Runs:
    """The episodes of a grid's scene with their trajectories; all trajectories without a set."""
    if episodes is None:
        return {each.episode: (None, each) for each in trajectories}
    driven = {each.episode: each for each in trajectories}
    own = [each for each in episodes.episodes if each.scene == scene_of(grid)]
    return {each.id: (each, driven.get(each.id)) for each in own}


class Name(NamedTuple):
    """A name in the scene."""

    text: str
    position: tuple[float, float, float]  # of its middle [m]
    height: float  # of its letters [m]


class Exhibit:
    """A grid, its scene if it has one, and what follows from them for what is chosen.

    `config` are the settings of the bake, where they are known; `note` is one line for the reader;
    `runs` are episodes and trajectories that can be shown.
    """

    def __init__(
        self,
        grid: NavGrid,
        scene: Scene | None = None,
        config: BakeConfig | None = None,
        note: str = "",
        runs: Runs | None = None,
    ) -> None:
        self.grid = grid
        self.scene = scene
        self.config = config
        self.note = note
        self.runs = runs or {}
        self.report: VerifyReport | None = None
        with_holes = scene is not None
        self.carpets = [meshes.lay_carpet(level, with_holes=with_holes) for level in grid.levels]
        self.kept: dict[Hashable, dict[Hashable, Any]] = {}

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of the layers that can be chosen."""
        tables = {"doors": self.grid.doors, "area": self.grid.areas}
        names = tuple(name for name in LAYERS if tables.get(name, True))
        return names if self.scene is None else (*names, DISAGREEMENTS)

    @property
    def bounds(self) -> Float:
        """Lower and upper corner of what is looked into, world frame, shape (2, 3) [m].

        It reaches from the lowest ground up to where the scene is cut over the highest.
        """
        corners = np.array([level.lattice.bounds for level in self.grid.levels])
        grounds = [level.ground for level in self.grid.levels]
        low = corners[:, :2].min(axis=0)
        high = corners[:, 2:].max(axis=0)
        return np.array([[*low, min(grounds)], [*high, max(grounds) + CUT_OVER]])

    @kept("doors", "inflation")
    def shown_grid(self, chosen: Choices) -> NavGrid:
        """The grid with its doors as chosen, inflated as chosen."""
        grid: NavGrid = self.grid.with_doors(dict(chosen.doors)) if chosen.doors else self.grid
        inflated: NavGrid = grid.inflate(*chosen.inflation) if chosen.inflation else grid
        return inflated

    def count(self, chosen: Choices) -> Counts:
        """How much of the shown levels is free."""
        levels = [self.shown_grid(chosen).levels[number] for number in chosen.levels]
        free = sum(int(np.count_nonzero(level.free)) for level in levels)
        cells = sum(int(np.count_nonzero(~np.isnan(level.floor_height))) for level in levels)
        return free, cells, free * self.grid.levels[0].lattice.cell_size ** 2

    @kept("doors", "inflation", "layer")
    def panel(self, chosen: Choices, number: int) -> Panel:
        """The chosen layer of a level; its occupancy until the scene is verified."""
        findings = None if self.report is None else self.report.findings
        is_early = chosen.layer == DISAGREEMENTS and findings is None
        layer = "occupancy" if is_early else chosen.layer
        panel = make_panel(self.shown_grid(chosen), layer, number, findings=findings)
        rgb = panel.rgb.copy()
        free = colors.rgb_of(colors.FREE)
        rgb[(rgb == free).all(axis=-1)] = colors.rgb_of(TINT)
        legend = tuple((name, TINT if c == colors.FREE else c) for name, c in panel.legend)
        return panel._replace(rgb=rgb, legend=legend)

    @kept("doors", "inflation", "layer", "opacity")
    def overlay(self, chosen: Choices, number: int) -> bytes:
        """The chosen layer of a level, as it lies in the scene: GLB."""
        rgb = paint(self.panel(chosen, number))
        return meshes.draw_overlay(self.carpets[number], rgb, chosen.opacity)

    def names(self, chosen: Choices) -> list[Name]:
        """Names on the shown levels, those of the largest rooms first.

        None lies over another of its level, or below another floor.
        """
        found = []
        levels = chosen.levels if chosen.with_names else ()
        for number in levels:
            for label in self.panel(chosen, number).labels:
                here = [(k, place_at(self.grid, (label.x, label.y), k)) for k in levels]
                floors = {k: p.floor for k, p in here if p is not None and p.floor is not None}
                z = floors.get(number, self.grid.levels[number].ground)
                if not any(k > number and f > z + self.grid.max_step for k, f in floors.items()):
                    width = LETTER * len(label.text)
                    height = min(NAME_HEIGHT, label.width / width if label.width else POINT_HEIGHT)
                    place = label.x, label.y, z + NAME_OVER
                    found.append((-label.width, number, Name(label.text, place, height)))

        def meets(one: Name, other: Name) -> bool:
            """Whether two names overlap, seen from above."""
            x, y = (abs(a - b) for a, b in zip(one.position[:2], other.position[:2], strict=True))
            wide = sum(LETTER * len(name.text) * name.height for name in (one, other)) / 2
            return x < wide and y < (one.height + other.height) / 2

        names: dict[int, list[Name]] = {number: [] for number in levels}
        for _, number, name in sorted(found)[:MOST_NAMES]:
            if not any(meets(name, other) for other in names[number]):
                names[number].append(name)
        return [name for own in names.values() for name in own]

    @kept("levels", "layer")
    def arcs(self, chosen: Choices) -> list[tuple[Float, str]]:
        """Arcs of links and stairs between stops on shown levels, and their colours."""
        if chosen.layer != "links":
            return []
        found = []
        for way in find_ways(self.grid):
            color = colors.LINK if way.link else STAIRS
            for (one, *start), (other, *end) in itertools.pairwise(way.places):
                if {one, other} <= {*chosen.levels}:
                    color = CLOSED if way.is_closed else color
                    found.append((bend(np.array(start), np.array(end)), color))
        return found

    @kept("doors", "with_hidden")
    def drawing(self, chosen: Choices) -> Drawing | None:
        """The scene as triangles, its doors as chosen; None without a scene."""
        if self.scene is None:
            return None
        moved: dict[str, Any] = {}
        if chosen.doors:
            from navbake.verifier.source import pose_doors  # loads MuJoCo, which moves the doors

            grid: Any = self.grid.with_doors(dict(chosen.doors))
            posed = pose_doors(self.scene, grid)
            moved = {"data": posed.data, "removed": posed.removed}
        return meshes.draw_scene(self.scene, with_hidden=chosen.with_hidden, **moved)

    @kept("doors", "with_hidden", "with_scene", "cut")
    def surfaces(self, chosen: Choices) -> tuple[Surface, ...]:
        """What is drawn of the scene."""
        drawing = self.drawing(chosen) if chosen.with_scene else None
        if drawing is None or chosen.cut is None:
            return () if drawing is None else drawing.surfaces
        return meshes.cut_drawing(drawing, chosen.cut)

    @kept("doors", "with_hidden", "with_scene", "cut")
    def scene_glb(self, chosen: Choices) -> bytes:
        """What is drawn of the scene but its batches, as GLB; empty for nothing."""
        surfaces = self.surfaces(chosen)
        drawing = self.drawing(chosen)
        if drawing is None or not surfaces:
            return b""
        sent = [batch.geoms[batch.below(chosen.cut)] for batch in drawing.batches]
        if sent:
            once = np.concatenate(sent)
            kept = [one.faces[~np.isin(one.owners, once)] for one in surfaces]
            surfaces = tuple(one._replace(faces=f) for one, f in zip(surfaces, kept, strict=True))
        return meshes.draw_surfaces(surfaces, drawing.textures)

    def batches(self, chosen: Choices) -> list[tuple[Batch, Bool]]:
        """The batches of the scene, and which of their geoms are below the cut."""
        drawing = self.drawing(chosen) if chosen.with_scene else None
        found = () if drawing is None else drawing.batches
        pairs = [(batch, batch.below(chosen.cut)) for batch in found]
        return [(batch, below) for batch, below in pairs if below.any()]

    def click(self, chosen: Choices, ray: tuple[ArrayLike, ArrayLike]) -> Choices:
        """The choices after a click along a ray: its origin and its direction."""
        surfaces = [*self.surfaces(chosen), *(self.carpets[number] for number in chosen.levels)]
        return chosen.with_click(meshes.pick(self.grid, ray, surfaces, chosen.levels))

    @kept("doors", "inflation")
    def finder(self, chosen: Choices) -> PathFinder:
        """Finds paths in the shown grid."""
        return PathFinder(self.shown_grid(chosen))

    @kept("doors", "inflation", "start", "goal")
    def route(self, chosen: Choices) -> Path | str | None:
        """The path between start and goal, or why there is none; None where one is missing."""
        if chosen.start is None or chosen.goal is None:
            return None
        ends = chosen.start.position, chosen.goal.position
        finder = self.finder(chosen)
        try:
            return finder.find_path(*ends) or finder.why_not(*ends) or "no path"
        except QueryError as error:
            return str(error)

    @kept("doors", "inflation", "episode")
    def way(self, chosen: Choices) -> Float:
        """The path of the episode, shape (n, 3); where it states none, one in the shown grid."""
        episode, _ = self.runs.get(chosen.episode, (None, None))
        if episode is None or episode.path or episode.task == "sequence":
            return np.array(episode.path if episode else ()).reshape(-1, 3)
        places = [place for goal in episode.goals if (place := goal_place(goal)) is not None]
        try:
            found = self.finder(chosen).find_path(episode.start, np.array(places).reshape(-1, 3))
        except QueryError:  # a start or a goal that isn't on the grid
            found = None
        return np.empty((0, 3)) if found is None else found.positions

    def tell(self, chosen: Choices) -> Json | None:
        """What `describe_cell` says of the inspected cell, None for none, and more.

        ``clicked`` is the name of what was; ``lit`` the drawn triangles of what blocks the cell, or
        else was clicked, shape (n, 3, 3) [m]; ``outline`` the cell's corners, shape (5, 3) [m].
        """
        found = chosen.inspected
        if found is None or chosen.click != INSPECT:
            return None
        x, y, _ = found.position
        facts = self.shown_grid(chosen).describe_cell(x, y, found.cell.level)
        drawing = self.drawing(chosen)
        clicked = None
        lit = np.empty((0, 3, 3), np.float32)
        if drawing is not None:
            clicked = None if found.geom is None else drawing.names[found.geom]
            geoms = [n for n, name in enumerate(drawing.names) if name in facts["blockers"]]
            standing = [*facts["objects"], *facts["walls"], *facts["doors"]]
            if not geoms and found.geom is not None and clicked in standing:
                geoms = [found.geom]
            lit = triangles_of(self.surfaces(chosen), geoms)
        around = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 0)])
        half = self.grid.levels[0].lattice.cell_size / 2
        outline = np.array([*facts["center"], found.position[2]]) + half * around
        return {**facts, "clicked": clicked, "lit": lit, "outline": outline}

    def verify(self) -> None:
        """Compare a sample of the grid's cells with the scene, for the layer of disagreements."""
        if self.scene is None:
            raise QueryError("there is no scene to compare the grid with")
        # loads MuJoCo and FCL
        from navbake.verifier.verify import verify_scene

        self.report = verify_scene(self.grid, self.scene, self.config, sample=SAMPLE)
        self.kept.clear()


def goal_place(goal: Goal) -> tuple[float, float, float] | None:
    """Where a goal is drawn: at its position, or its first view point."""
    return goal.position or (goal.view_points[0].position if goal.view_points else None)


def triangles_of(surfaces: Sequence[Surface], geoms: Sequence[int]) -> NDArray[np.float32]:
    """The triangles of some geoms, shape (n, 3, 3), world frame [m]."""
    own = [one.vertices[one.faces[np.isin(one.owners, geoms)]] for one in surfaces]
    return np.concatenate([np.empty((0, 3, 3), np.float32), *own])
