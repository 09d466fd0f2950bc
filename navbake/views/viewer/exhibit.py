"""What the viewer shows for what its reader has chosen; without a browser."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.grid import NavGrid
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import Path
from navbake.types import Float, Json
from navbake.views.layers import DISAGREEMENTS, LAYERS, Panel, make_panel, paint
from navbake.views.viewer.choices import CUT_OVER, Choices
from navbake.views.viewer.mesh.cut import cut_drawing
from navbake.views.viewer.mesh.drawing import Drawing, Surface, draw_scene
from navbake.views.viewer.mesh.overlay import draw_overlay, lay_carpet
from navbake.views.viewer.picking import Ray, mesh_of, pick

if TYPE_CHECKING:
    from navbake.baker.scene.scene import Scene
    from navbake.config.settings import BakeConfig
    from navbake.verifier.report import VerifyReport

Made = TypeVar("Made")
RECENT = 6  # results of a kind that are kept, so that going back is fast
SAMPLE = 20_000  # cells that are verified


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
        for other in (self.grid.levels[k] for k in chosen.levels if k > number):
            row, col = (int(v) for v in other.lattice.rows_cols(place))
            if 0 <= row < other.height and 0 <= col < other.width:
                floor = float(other.floor_of(np.array(row), np.array(col)))
                if floor > place[2] + self.grid.max_step:
                    return True
        return False

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

    def click(self, chosen: Choices, ray: Ray) -> Choices:
        """The choices after a click along a ray."""
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
        if not geoms and found.geom is not None and clicked in _standing(facts):
            geoms = [found.geom]
        return Told(facts, clicked, mesh_of(drawing.surfaces, geoms))

    def verify(self) -> None:
        """Compare a sample of the grid's cells with the scene, for the layer of disagreements."""
        if self.scene is None:
            raise QueryError("there is no scene to compare the grid with")
        # loads MuJoCo and FCL
        from navbake.verifier.verify import Options, verify_scene

        self.report = verify_scene(self.grid, self.scene, Options(sample=SAMPLE), self.config)


def _standing(facts: Json) -> Sequence[str]:
    return [*facts["objects"], *facts["walls"], *facts["doors"]]
