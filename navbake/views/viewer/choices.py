"""What the reader of the page has chosen, apart from how the page lets them choose it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from navbake.errors import QueryError
from navbake.navgrid.grid import NavGrid
from navbake.views.viewer.picking import Pick

CUT_OVER = 1.3  # a level is looked into from so high over its ground [m]
INSPECT, ROUTE = "tells about the cell", "sets start, then goal"
CLICKS = (INSPECT, ROUTE)
"""What a click may do."""


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
