"""The layers of a grid at one position, or one layer at many positions."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.block_state import BLOCKED
from navbake.navgrid.cells import Cell, cell_at, cells_at
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.islands import clearance, islands_of

LAYERS: dict[str, tuple[Callable[[NavGrid], list[NDArray[Any]]], float]] = {
    "floor": (lambda grid: [level.floor for level in grid.levels], np.nan),
    "free": (lambda grid: [level.free for level in grid.levels], False),
    "occupancy": (lambda grid: [level.occupancy for level in grid.levels], 1),
    "weight": (lambda grid: [level.weights.astype(np.float64) for level in grid.levels], np.inf),
    "room": (lambda grid: [level.room_index for level in grid.levels], 0),
    "island": (lambda grid: list(islands_of(grid)), 0),
    "clearance": (lambda grid: [clearance(level) for level in grid.levels], 0),
}
"""How each layer is made, one array a level, and its value where there is no cell."""


@dataclass(frozen=True)
class Place:
    """The layers of a grid in one cell."""

    cell: Cell  #: Level, row and column.
    floor: float | None  #: World z of the floor [m], None where there is none.
    free: bool  #: An agent can stand here.
    occupied: bool  #: Something stands in the agent's way.
    weight: float  #: Cost of the cell, infinite where it isn't free.
    room: str | None  #: Id of the room in the grid's `rooms`, None for none.
    area: str | None  #: Name of the area in the grid's `areas`, None for none.
    grid: NavGrid = field(repr=False, compare=False)  #: The grid.

    @property
    def island(self) -> int | None:
        """Number of the connected part, from 1, the largest; None where the cell isn't free."""
        level, row, col = self.cell
        return int(islands_of(self.grid)[level][row, col]) or None if self.free else None

    @property
    def is_blocked(self) -> bool:
        """Whether `grid.block` currently blocks the cell."""
        level, row, col = self.cell
        state = self.grid.levels[level].block_state
        return state is not None and bool(state.held(BLOCKED)[row, col])


def place_at(grid: NavGrid, position: ArrayLike, level: int | None = None) -> Place | None:
    """Look up all layers in the cell of a position; see `navbake.navgrid.cells.cell_at`."""
    cell = cell_at(grid, position, level)
    return None if cell is None else place_in(grid, cell)


def place_in(grid: NavGrid, cell: Cell) -> Place:
    part, at = grid.levels[cell.level], (cell.row, cell.col)
    floor, weight = float(part.floor_height[at]), float(part.weights[at])
    free = math.isfinite(weight)
    index, area = int(part.room_index[at]), int(part.area_index[at])
    of_table = (r.id for r in grid.stated_rooms or () if (r.level, r.index) == (cell.level, index))
    return Place(
        cell=cell,
        floor=None if math.isnan(floor) else floor * part.unit,
        free=free,
        occupied=bool(part.occupancy[at]),
        weight=weight if free else math.inf,
        room=next(of_table, f"{cell.level}:{index}") if index else None,
        area=grid.areas[area - 1].name if 0 < area <= len(grid.areas) else None,
        grid=grid,
    )


def values_at(
    grid: NavGrid, layer: str, positions: ArrayLike, level: int | None = None
) -> NDArray[Any]:
    """Look up one layer at positions as `navbake.navgrid.cells.cells_at` takes them.

    Layers are ``floor`` (world z [m], float64), ``free`` (bool), ``occupancy`` (uint8), ``weight``
    (float64), ``room`` (its number on its level, uint16), ``island`` (int32), ``clearance`` ([m],
    float32, as `navbake.navgrid.islands.clearance`), or a stored attribute by its name in the
    file. Shape (...). Outside the grid: NaN, False, 1, inf, 0, 0, 0; of an attribute NaN or 0,
    by its dtype. Raises QueryError for an unknown layer.
    """
    cells = cells_at(grid, positions, level)
    find, outside = LAYERS.get(layer, (None, None))
    # an attribute, of all levels in one dtype; some may not have it
    layers = find(grid) if find else [part.attributes.get(layer) for part in grid.levels]
    arrays = {number: array for number, array in enumerate(layers) if array is not None}
    if not arrays:
        known = [*LAYERS, *(key for part in grid.levels for key in part.attributes)]
        hint = suggest(layer, known, limit=len(known))
        raise QueryError(f"no layer {layer!r} in {grid.scene_id!r}: {hint}")
    dtype = np.result_type(*arrays.values())
    if outside is None:
        outside = np.nan if dtype.kind == "f" else 0
    values = np.full(cells.level.shape, outside, dtype=dtype)
    for number, array in arrays.items():
        here = cells.level == number
        values[here] = array[cells.row[here], cells.col[here]]
    return values
