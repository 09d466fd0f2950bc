"""What a picture shows of each level: a colour or a value for every cell, names and doors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import check_level
from navbake.navgrid.colors import (
    ACROSS,
    DARKER,
    DOOR,
    DOORWAY,
    DOWN,
    FREE,
    MARKS,
    NO_FLOOR,
    OCCUPIED,
    ROOMS,
    UP,
    WALL,
    choose_colors,
    find_neighbours,
    rgb_of,
)
from navbake.navgrid.door_lines import doorway_cells, find_door_lines
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance, islands_of
from navbake.views.color_scale import height_scale, linear_scale
from navbake.views.names import label_doors, label_rooms
from navbake.views.panel import Panel, paint
from navbake.views.room_cells import RoomCells

if TYPE_CHECKING:
    from navbake.verifier.report import Finding

__all__ = ["DISAGREEMENTS", "LAYERS", "make_panel", "make_panels", "paint"]

RELIEF = 0.04  # a step that is lit or shaded well [m]
RELIEF_SLOPE = 0.3  # or one of a cell, at this slope, so that large cells of hills aren't all dark
OCCUPANCY = {"free": FREE, "occupied": OCCUPIED, "no floor": NO_FLOOR}
DISAGREEMENTS = "disagreements"  # the layer that shows what a verification found


def make_panels(
    grid: NavGrid, layer: str, *, findings: Sequence[Finding] | None = None
) -> list[Panel]:
    """Show a layer of all levels, lowest first; see `make_panel`."""
    numbers = range(len(grid.levels))
    return [make_panel(grid, layer, number, findings=findings) for number in numbers]


def make_panel(
    grid: NavGrid, layer: str, number: int, *, findings: Sequence[Finding] | None = None
) -> Panel:
    """Show a layer of one level.

    Args:
        grid: a grid of one or several levels.
        layer: one of `LAYERS`, or `DISAGREEMENTS`.
        number: of the level, 0 is the lowest.
        findings: what a verification found, for the layer `DISAGREEMENTS`.

    Returns:
        The layer; `paint` turns it into colours.

    Raises:
        QueryError: there is no such layer or level, or it needs findings and has none.
    """
    check_level(number, len(grid.levels))
    if layer == DISAGREEMENTS and findings is not None:
        panel = _show_disagreements(grid, number, findings)
    elif layer == DISAGREEMENTS:
        raise QueryError(f"the layer {layer} shows the findings of a verification: pass findings")
    elif layer not in LAYERS:
        raise QueryError(f"expected one of {', '.join(LAYERS)} as layer, got {layer!r}")
    else:
        panel = LAYERS[layer](grid, number)
    if len(grid.levels) == 1:
        return panel
    return panel._replace(title=f"{grid.level_names[number]}: {panel.title}")


def _show_occupancy(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    area = np.count_nonzero(level.free) * level.lattice.cell_size**2
    title = f"occupancy, {area:.1f} m\N{SUPERSCRIPT TWO} free"
    doors = find_door_lines(grid, number)
    return Panel(title, _color_occupancy(level), legend=_legend_of(level), doors=doors)


def _show_floor(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    rgb = np.full((*level.shape, 3), rgb_of(NO_FLOOR), dtype=np.uint8)
    metres = level.floor_height * np.float32(level.unit)
    scale = height_scale(metres[np.isfinite(metres)], "z [m]")
    legend = (("no floor", NO_FLOOR),) if np.isnan(metres).any() else ()
    step = max(RELIEF, RELIEF_SLOPE * level.lattice.cell_size)
    title = "floor height [m]"
    if len(scale.ticks) == 1:
        title = f"{title}: {scale.ticks[0].text}"
    return Panel(title, rgb, metres, scale, legend, relief=step)


def _show_clearance(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    stored = level.attributes.get("clearance")
    metres = clearance(level) if stored is None else stored * level.unit
    return _show_free(level, metres, "clearance [m]", "to the nearest obstacle [m]")


def _show_weights(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    return _show_free(level, level.weights, "weights", "cost of a cell", dark_high=True)


def _show_free(
    level: SceneGrid2D,
    values: NDArray[np.floating],
    title: str,
    label: str,
    *,
    dark_high: bool = False,
) -> Panel:
    """Show values where an agent can stand, and what is there elsewhere."""
    shown = np.where(level.free, values, np.nan).astype(np.float32)
    scale = linear_scale(shown[np.isfinite(shown)], label, dark_high=dark_high)
    if len(scale.ticks) == 1:  # nothing to tell apart, so a number says it
        title = f"{title}: {scale.ticks[0].text}"
    return Panel(title, _color_occupancy(level), shown, scale, _legend_of(level)[1:])


def _show_islands(grid: NavGrid, number: int) -> Panel:
    islands = islands_of(grid)
    level, island = grid.levels[number], islands[number]
    count = max(int(each.max(initial=0)) for each in islands)
    reach = math.ceil(WALL / level.lattice.cell_size)
    # an island may span several levels, and has one colour on all of them
    pairs = set().union(*(find_neighbours(each, reach) for each in islands))
    palette = np.array([rgb_of(color) for color in ROOMS], dtype=np.uint8)
    rgb = _color_occupancy(level)
    rgb[level.free] = palette[choose_colors(count, pairs, len(palette))[island[level.free]]]
    return Panel("islands", rgb, legend=_legend_of(level)[1:])


def _show_rooms(grid: NavGrid, number: int) -> Panel:
    cells, index = RoomCells.of(grid, number), grid.levels[number].room_index
    entries = {
        ("no room", OCCUPIED): ((index == 0) & ~cells.free & ~np.isnan(cells.floor)).any(),
        ("no floor", NO_FLOOR): np.isnan(cells.floor).any(),
        ("free, no room", FREE): ((index == 0) & cells.free).any(),
        ("darker: occupied", DARKER): ((index > 0) & ~cells.free).any(),
        ("door", DOOR): cells.door.any(),
        ("doorway", DOORWAY): (cells.doorway & ~cells.door).any(),
    }
    legend = tuple(entry for entry, is_there in entries.items() if is_there)
    labels, doors = label_rooms(grid, number), find_door_lines(grid, number)
    return Panel("rooms", cells.paint(), legend=legend, labels=labels, doors=doors)


def _show_doors(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    rgb = _color_occupancy(level)
    rgb[doorway_cells(grid, number, blocked=False)] = rgb_of(DOORWAY)
    rgb[doorway_cells(grid, number, blocked=True)] = rgb_of(DOOR)
    legend = (("door", DOOR), ("doorway", DOORWAY), *_legend_of(level))
    marks = find_door_lines(grid, number)
    return Panel("doors", rgb, legend=legend, labels=label_doors(marks), doors=marks)


def _show_links(grid: NavGrid, number: int) -> Panel:
    level = grid.levels[number]
    rgb = _color_occupancy(level)
    links = grid.link_array
    ends = np.concatenate([links, links[:, [2, 3, 0, 1]]])
    ends = ends[ends[:, 0] == number]
    rows, cols = np.divmod(ends[:, 1], level.width)
    for color, leads in (
        (ACROSS, ends[:, 2] == number),
        (UP, ends[:, 2] > number),
        (DOWN, ends[:, 2] < number),
    ):
        rgb[rows[leads], cols[leads]] = rgb_of(color)
    legend = (("leads up", UP), ("leads down", DOWN), ("steep, same level", ACROSS))
    return Panel("links", rgb, legend=(*legend, *_legend_of(level)))


def _show_disagreements(grid: NavGrid, number: int, findings: Sequence[Finding]) -> Panel:
    """Show the cells where a verification found that grid and scene disagree, by kind."""
    level = grid.levels[number]
    rgb = _color_occupancy(level)
    kinds = color_kinds(finding.kind for finding in findings)
    here = [finding for finding in findings if finding.level == number]
    for finding in here:
        row, col = finding.cell or level.lattice.rows_cols(finding.position)
        if 0 <= row < level.height and 0 <= col < level.width:
            rgb[row, col] = rgb_of(kinds[finding.kind])
    title = f"{len(here)} disagreement{'' if len(here) == 1 else 's'}"
    return Panel(title, rgb, legend=(*kinds.items(), *_legend_of(level)))


def color_kinds(kinds: Iterable[str]) -> dict[str, str]:
    """A colour for each kind of mark."""
    return {kind: MARKS[n % len(MARKS)] for n, kind in enumerate(sorted(set(kinds)))}


LAYERS: dict[str, Callable[[NavGrid, int], Panel]] = {
    "occupancy": _show_occupancy,
    "floor": _show_floor,
    "rooms": _show_rooms,
    "doors": _show_doors,
    "clearance": _show_clearance,
    "island": _show_islands,
    "weights": _show_weights,
    "links": _show_links,
}
"""How each layer of a level is shown, by the layer's name."""


def _color_occupancy(level: SceneGrid2D) -> NDArray[np.uint8]:
    """Colours of the cells by whether an agent can stand in them, shape (height, width, 3)."""
    palette = np.array([rgb_of(color) for color in OCCUPANCY.values()], dtype=np.uint8)
    painted: NDArray[np.uint8] = palette[_kinds(level)]
    return painted


def _kinds(level: SceneGrid2D) -> NDArray[np.uint8]:
    """Which of `OCCUPANCY` each cell is, shape (height, width)."""
    is_blocked = np.where(np.isnan(level.floor_height), np.uint8(2), np.uint8(1))
    return np.where(level.free, np.uint8(0), is_blocked)


def _legend_of(level: SceneGrid2D) -> tuple[tuple[str, str], ...]:
    """What there is of `OCCUPANCY` on a level; free is always first."""
    there = np.bincount(_kinds(level).ravel(), minlength=len(OCCUPANCY)) > 0
    there[0] = True
    return tuple(
        entry for entry, is_there in zip(OCCUPANCY.items(), there, strict=True) if is_there
    )
