"""What the viewer shows for what its reader has chosen; without a browser."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.grid import NavGrid
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import Path
from navbake.types import Float, Json
from navbake.views.layers import DISAGREEMENTS, LAYERS, Panel, make_panel, paint
from navbake.views.viewer.overlay import (
    Pick,
    draw_overlay,
    floor_under,
    lay_carpet,
    mesh_of,
    pick,
)
from navbake.views.viewer.scene_mesh import Drawing, Surface, cut_drawing, draw_scene

if TYPE_CHECKING:
    from navbake.baker.scene.scene import Scene
    from navbake.config.settings import BakeConfig
    from navbake.verifier.report import VerifyReport

Made = TypeVar("Made")
CUT_OVER = 1.3  # a level is looked into from so high over its ground [m]
INSPECT, ROUTE = "tells about the cell", "sets start, then goal"
CLICKS = (INSPECT, ROUTE)
"""What a click may do."""
RECENT = 6  # results of a kind that are kept, so that going back is fast
SAMPLE = 20_000  # cells that are verified


@dataclass(frozen=True)
class Choices:
    """What is to be shown.

    Attributes:
        levels: numbers of the levels that are shown, ascending.
        layer: name of the layer.
        inflation: radius and clearance [m], None for the grid as it is.
        doors: states of the doors that are in another than in the grid, by id.
        cut: world z above which the scene is not drawn [m], None for none.
        with_scene: draw the scene.
        with_hidden: draw what MuJoCo's viewers hide, too: the geom groups from 3 on.
        with_names: write names of rooms and doors.
        opacity: of the layer, above 0, up to 1.
        click: what a click does, one of `CLICKS`.
        start, goal: of the path, None for none.
        inspected: the cell that is told about, None for none.
    """

    levels: tuple[int, ...]
    layer: str = "occupancy"
    inflation: tuple[float, float] | None = None
    doors: tuple[tuple[str, str], ...] = ()
    cut: float | None = None
    with_scene: bool = True
    with_hidden: bool = False
    with_names: bool = True
    opacity: float = 0.9
    click: str = INSPECT
    start: Pick | None = None
    goal: Pick | None = None
    inspected: Pick | None = None

    def with_level(self, grid: NavGrid, number: int | None) -> Choices:
        """Look at one level from above, or at all of them: the scene is cut over the highest."""
        levels = tuple(range(len(grid.levels))) if number is None else (number,)
        return replace(self, levels=levels, cut=cut_over(grid, levels))

    def with_door(self, grid: NavGrid, names: Sequence[str], state: str) -> Choices:
        """Put doors into a state; those that can't be in it stay as they are."""
        states = dict(self.doors)
        for door in grid.doors:
            if door.id in names and state in door.states:
                states.pop(door.id, None)
                states |= {} if state == door.state else {door.id: state}
        return replace(self, doors=tuple(sorted(states.items())))

    def without_clicks(self) -> Choices:
        """As if nothing had been clicked."""
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


def cut_over(grid: NavGrid, levels: Sequence[int]) -> float:
    """Where the scene is cut so that one looks into the highest of some levels, world z [m]."""
    return max(grid.levels[number].ground for number in levels) + CUT_OVER


def first_choices(grid: NavGrid, layer: str = "occupancy") -> Choices:
    """What is shown at first: all levels, cut over the highest one."""
    levels = tuple(range(len(grid.levels)))
    return Choices(levels, layer, cut=cut_over(grid, levels))


def keep_choices(chosen: Choices, grid: NavGrid) -> Choices:
    """The same choices for another grid, such as a new bake: what it doesn't have is dropped."""
    levels = tuple(number for number in chosen.levels if number < len(grid.levels))
    states = {door.id: door.states for door in grid.doors}
    return replace(
        chosen,
        levels=levels or tuple(range(len(grid.levels))),
        doors=tuple((name, state) for name, state in chosen.doors if state in states.get(name, ())),
        inspected=_on(grid, chosen.inspected),
        start=_on(grid, chosen.start),
        goal=_on(grid, chosen.goal) if _on(grid, chosen.start) else None,
    )


def _on(grid: NavGrid, found: Pick | None) -> Pick | None:
    """The cell of another grid at the place of a click; None beside it."""
    if found is None or found.cell.level >= len(grid.levels):
        return None
    try:
        cell = grid.cell_at(found.position, found.cell.level)
    except QueryError:
        return None
    return None if cell is None else found._replace(cell=cell, geom=None)


class Counts(NamedTuple):
    """How much of a grid is free.

    Attributes:
        free: free cells of all levels.
        cells: all cells with a floor.
        area: of the free ones [m²].
    """

    free: int
    cells: int
    area: float


class Route(NamedTuple):
    """The path between two clicks.

    Attributes:
        path: None where there is none.
        reason: why there is none; "" where there is one.
    """

    path: Path | None
    reason: str = ""


class Told(NamedTuple):
    """What is told of a cell.

    Attributes:
        facts: as `navbake.views.describe.describe_cell` has them.
        clicked: name of the geom that was clicked, None for none.
        lit: what blocks the cell, or else was clicked: triangles, shape (n, 3, 3) [m].
    """

    facts: Json
    clicked: str | None
    lit: NDArray[np.float32]


class Exhibit:
    """A grid, its scene, and what follows from them for what is chosen.

    Args:
        grid: as it was baked or read.
        scene: the scene that it was baked from; None to show the grid alone.
        config: the settings of the bake, where they are known.
        note: what the reader should know of the grid and the scene, in one line.
    """

    def __init__(
        self,
        grid: NavGrid,
        scene: Scene | None = None,
        config: BakeConfig | None = None,
        note: str = "",
    ) -> None:
        self.grid, self.scene, self.config, self.note = grid, scene, config, note
        self.report: VerifyReport | None = None
        with_holes = scene is not None
        self.carpets = [lay_carpet(level, with_holes=with_holes) for level in grid.levels]
        self._kept: dict[str, dict[Hashable, Any]] = {}

    def _keep(self, kind: str, key: Hashable, make: Callable[[], Made]) -> Made:
        """What was made for a key before, or is made now."""
        kept = self._kept.setdefault(kind, {})
        made: Made = kept.pop(key) if key in kept else make()
        kept[key] = made
        while len(kept) > RECENT:
            del kept[next(iter(kept))]
        return made

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of the layers that can be chosen."""
        names = tuple(name for name in LAYERS if name != "doors" or self.grid.doors)
        return names if self.scene is None else (*names, DISAGREEMENTS)

    @property
    def bounds(self) -> Float:
        """Lower and upper corner of what is looked into, world frame, shape (2, 3) [m].

        It reaches from the lowest ground up to where the scene is cut over the highest.
        """
        corners = np.array([level.lattice.bounds for level in self.grid.levels])
        grounds = [level.ground for level in self.grid.levels]
        low, high = corners[:, :2].min(axis=0), corners[:, 2:].max(axis=0)
        return np.array([[*low, min(grounds)], [*high, max(grounds) + CUT_OVER]])

    def shown_grid(self, chosen: Choices) -> NavGrid:
        """The grid with its doors as chosen, inflated as chosen."""

        def make() -> NavGrid:
            grid: NavGrid = self.grid.with_doors(dict(chosen.doors)) if chosen.doors else self.grid
            if chosen.inflation is None:
                return grid
            inflated: NavGrid = grid.inflate(*chosen.inflation)
            return inflated

        return self._keep("grid", (chosen.doors, chosen.inflation), make)

    def count(self, chosen: Choices) -> Counts:
        """How much of the shown grid is free."""
        levels = self.shown_grid(chosen).levels
        free = [int(np.count_nonzero(level.free)) for level in levels]
        cells = sum(int(np.count_nonzero(~np.isnan(level.floor_height))) for level in levels)
        areas = [n * level.lattice.cell_size**2 for n, level in zip(free, levels, strict=True)]
        return Counts(sum(free), cells, sum(areas))

    def panel(self, chosen: Choices, number: int) -> Panel:
        """The chosen layer of a level."""
        key = chosen.doors, chosen.inflation, chosen.layer, number, id(self.report)
        findings = None if self.report is None else self.report.findings

        def make() -> Panel:
            layer = chosen.layer
            if layer == DISAGREEMENTS and findings is None:
                layer = "occupancy"  # until the scene is verified
            return make_panel(self.shown_grid(chosen), layer, number, findings=findings)

        return self._keep(f"panel {number}", key, make)

    def overlay(self, chosen: Choices, number: int) -> bytes:
        """The chosen layer of a level, as it lies in the scene: GLB."""
        panel = self.panel(chosen, number)
        key = id(panel), chosen.opacity
        # the panel is kept with its picture: an id counts as long as its object is there
        return self._keep(
            f"overlay {number}",
            key,
            lambda: (panel, draw_overlay(self.carpets[number], paint(panel), chosen.opacity)),
        )[1]

    def is_covered(self, chosen: Choices, number: int, place: tuple[float, float, float]) -> bool:
        """Whether a place on a level lies below the floor of a higher level that is shown."""
        floors = (floor_under(self.grid, k, place)[1] for k in chosen.levels if k > number)
        return any(floor > place[2] + self.grid.max_step for floor in floors)

    def drawing(self, chosen: Choices) -> Drawing | None:
        """The scene as triangles, its doors as chosen; None without a scene."""
        scene = self.scene
        if scene is None:
            return None

        def make() -> Drawing:
            if not chosen.doors:
                return draw_scene(scene, with_hidden=chosen.with_hidden)
            # loads MuJoCo, which moves the doors
            from navbake.verifier.source import pose_doors

            grid: Any = self.grid.with_doors(dict(chosen.doors))
            posed = pose_doors(scene, grid)
            return draw_scene(
                scene, data=posed.data, removed=posed.removed, with_hidden=chosen.with_hidden
            )

        return self._keep("drawing", (chosen.doors, chosen.with_hidden), make)

    def surfaces(self, chosen: Choices) -> tuple[Surface, ...]:
        """What is drawn of the scene."""
        drawing = self.drawing(chosen) if chosen.with_scene else None
        if drawing is None:
            return ()
        height = chosen.cut
        if height is None:
            return drawing.surfaces
        key = chosen.doors, chosen.with_hidden, height
        return self._keep("surfaces", key, lambda: cut_drawing(drawing, height))

    def click(self, chosen: Choices, ray: tuple[ArrayLike, ArrayLike]) -> Choices:
        """The choices after a click along a ray: its origin and its direction."""
        surfaces = self.surfaces(chosen)
        return chosen.with_click(pick(self.grid, ray, surfaces, self.carpets, chosen.levels))

    def route(self, chosen: Choices) -> Route | None:
        """The path between start and goal; None where one of them is missing."""
        start, goal = chosen.start, chosen.goal
        if start is None or goal is None:
            return None
        key = chosen.doors, chosen.inflation

        def make() -> Route:
            finder = self._keep("finder", key, lambda: PathFinder(self.shown_grid(chosen)))
            try:
                path = finder.find_path(start.position, goal.position)
                if path is not None:
                    return Route(path)
                return Route(None, finder.why_not(start.position, goal.position) or "no path")
            except QueryError as error:
                return Route(None, str(error))

        return self._keep("route", (*key, start.position, goal.position), make)

    def tell(self, chosen: Choices) -> Told | None:
        """What is to be told of the inspected cell, None for none."""
        found = chosen.inspected
        if found is None:
            return None
        x, y, _ = found.position
        facts = self.shown_grid(chosen).describe_cell(x, y, found.cell.level)
        drawing = self.drawing(chosen)
        if drawing is None:
            return Told(facts, None, np.empty((0, 3, 3), np.float32))
        clicked = None if found.geom is None else drawing.names[found.geom]
        names = set(facts["blockers"])
        geoms = [geom for geom, name in enumerate(drawing.names) if name in names]
        if (
            not geoms
            and found.geom is not None
            and clicked in [*facts["objects"], *facts["walls"], *facts["doors"]]
        ):
            geoms = [found.geom]
        return Told(facts, clicked, mesh_of(drawing.surfaces, geoms))

    def verify(self) -> None:
        """Compare a sample of the grid's cells with the scene, for the layer of disagreements."""
        if self.scene is None:
            raise QueryError("there is no scene to compare the grid with")
        # loads MuJoCo and FCL
        from navbake.verifier.verify import Options, verify_scene

        self.report = verify_scene(self.grid, self.scene, Options(sample=SAMPLE), self.config)
