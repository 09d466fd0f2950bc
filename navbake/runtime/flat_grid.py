"""The flat view of a grid that kernels work on: the cells of all levels, one after the other."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import Cell, Cells, check_positions
from navbake.navgrid.islands import step_limit
from navbake.types import Bool, Float, Int

REAL = int | float | np.integer | np.floating

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.kernels.arrays import Floors, Layout, Links, Space


@dataclass(frozen=True, eq=False)
class FlatGrid:
    """All levels of a grid as one row of cells, and where steps lead from level to level.

    The flat id of a cell is ``start[level] + row * width[level] + col``. Two neighbours on one
    level are a step apart where both are free and their floors differ by at most `max_step`.
    Where a link leads, the baker has decided about the floor: it joins two cells, both ways,
    whenever both are free.

    Attributes:
        layout: where the cells of each level lie.
        links: steps between cells that are not neighbours on one level.
        floors: heights of the cells' floors [m], and `max_step`.
        free: by flat id, shape (n,), bool.
        weight: cost of a cell, shape (n,), float64, inf where it isn't free.
        slopes: by flat id, uint8, to which neighbours a link leads on the same level: bits EAST
            and SOUTH of `navbake.runtime.kernels.arrays`; empty where none does.
    """

    layout: Layout
    links: Links
    floors: Floors
    free: Bool
    weight: Float
    slopes: NDArray[np.uint8]

    @property
    def num_levels(self) -> int:
        """Number of levels, at least 1."""
        return len(self.layout.width)

    @property
    def num_cells(self) -> int:
        """Number of cells of all levels."""
        return int(self.layout.start[-1])

    def cells_of(self, level: int) -> slice:
        """Where the cells of a level are among the flat ids."""
        return slice(int(self.layout.start[level]), int(self.layout.start[level + 1]))

    def level_of(self, cells: Int | int) -> Int:
        """The levels of cells, by flat id, same shape."""
        return np.searchsorted(self.layout.start, cells, side="right") - 1

    def split(self, cells: Int | int) -> Cells:
        """Level, row and column of cells by their flat ids, of the same shape; -1 stays -1."""
        cells = np.asarray(cells, dtype=np.int64)
        level = self.level_of(cells)
        row, col = np.divmod(cells - self.layout.start[level], self.layout.width[level])
        if (level < 0).any():
            row, col = (np.where(level < 0, -1, v) for v in (row, col))
        return Cells(level, row, col)

    def cell(self, cell: int) -> Cell:
        """Level, row and column of one cell by its flat id."""
        return Cell(*(int(v) for v in self.split(cell)))

    def cells_at(self, positions: ArrayLike, level: int | None = None) -> Int:
        """`navbake.navgrid.cells.cells_at`, faster: flat ids, shape (...), -1 for no cell."""
        return self._cells_at(check_positions(positions, self.num_levels, level), level)

    def _cells_at(self, p: Float, level: int | None) -> Int:
        from navbake.runtime.kernels.places import locate  # saves numba at start-up

        on, points = as_points(p, level)
        cells: Int = locate(self.layout, self.floors, on, points)
        return cells.reshape(p.shape[:-1])

    def locate(
        self, position: ArrayLike, level: int | None = None, what: str = "position"
    ) -> tuple[Float, int | None]:
        """One position as float64, and the flat id of its cell, None for none."""
        p = self.check_one(position, level, what)
        cell = int(self._cells_at(p, level))
        return p, cell if cell >= 0 else None

    def check_one(
        self, position: ArrayLike, level: int | None = None, what: str = "position"
    ) -> Float:
        """One position as float64, shape (2,) or (3,)."""
        p = check_positions(position, self.num_levels, level)
        if p.ndim != 1:
            raise QueryError(f"expected one {what}, got an array of shape {p.shape}")
        return p

    def cell_at(self, position: ArrayLike, level: int | None = None) -> int | None:
        """The flat id of the cell that one position is in; None for none."""
        return self.locate(position, level)[1]

    def free_cell_at(self, position: ArrayLike, level: int | None = None) -> tuple[Float, int]:
        """As `locate`; raises QueryError where no agent can stand."""
        p, cell = self.locate(position, level)
        if cell is None or not self.free[cell]:
            where = ", ".join(f"{v:g}" for v in p)
            raise QueryError(f"no agent can stand at {where}: snap it to the nearest place first")
        return p, cell

    def positions(self, cells: Int | int) -> Float:
        """World positions of cells' centres on the floor, or else the level's ground [m].

        Shape (..., 3), float64, of flat ids of shape (...).
        """
        level = self.level_of(cells)
        row, col = np.divmod(cells - self.layout.start[level], self.layout.width[level])
        size = self.layout.cell_size[level]
        x = self.layout.x_min[level] + (col + 0.5) * size
        y = self.layout.y_max[level] - (row + 0.5) * size
        floor = self.floors.z[cells]
        z = np.where(np.isnan(floor), self.floors.ground[level], floor)
        return np.stack([x, y, z], axis=-1)

    def link_ends(self) -> tuple[Int, Int]:
        """The cells that each link leads from and to, by flat id; each link is there both ways."""
        return np.repeat(self.links.cell, np.diff(self.links.start)), self.links.target

    def sight_through(self, clear: Bool) -> Space:
        """What a line of sight may run through: cells of a mask, whatever their floors' heights."""
        from navbake.runtime.kernels.arrays import Space  # saves numba at start-up

        return Space(self.layout, self.links, self.floors._replace(max_step=math.inf), clear)


def check_distance(distance: float, name: str = "max_distance") -> None:
    """Raise QueryError for anything but a number >= 0."""
    if not (isinstance(distance, REAL) and distance >= 0):
        raise QueryError(f"expected a {name} >= 0 m, got {distance!r}")


def as_points(p: Float, level: int | None) -> tuple[int, Float]:
    """Checked positions as kernels take them: the level, -1 for any, and positions (n, 2 or 3)."""
    on = 0 if level is None and p.shape[-1] == 2 else -1 if level is None else int(level)
    return on, np.ascontiguousarray(p.reshape(-1, p.shape[-1]))


def flatten(grid: NavGrid) -> FlatGrid:
    """Copy the levels of a grid into one row of cells; later changes of the grid don't matter."""
    from navbake.runtime.kernels.arrays import Floors, Layout, Links  # saves numba at start-up

    levels = grid.levels
    lattices = [level.lattice for level in levels]
    layout = Layout(
        start=np.cumsum([0] + [level.width * level.height for level in levels], dtype=np.int64),
        width=np.array([v.width for v in lattices], dtype=np.int64),
        height=np.array([v.height for v in lattices], dtype=np.int64),
        x_min=np.array([v.x_min for v in lattices], dtype=np.float64),
        y_max=np.array([v.y_max for v in lattices], dtype=np.float64),
        cell_size=np.array([v.cell_size for v in lattices], dtype=np.float64),
    )
    floors = Floors(
        z=np.concatenate(
            [
                level.floor.ravel()
                if level.uses_cell_floors
                else np.full(level.width * level.height, level.ground)
                for level in levels
            ]
        ),
        ground=np.array([level.ground for level in levels], dtype=np.float64),
        max_step=step_limit(grid) * grid.unit,
    )
    weight = np.concatenate([level.weights.ravel().astype(np.float64) for level in levels])
    free = np.isfinite(weight)
    weight[~free] = np.inf
    # the lengths need the cells' positions, which need a FlatGrid
    cell, start, target = _link_lists(grid.link_array, layout.start)
    links = Links(cell, start, target, np.empty(0))
    slopes = _find_slopes(grid.link_array, layout)
    flat = FlatGrid(layout, links, floors, free, weight, slopes)
    return replace(flat, links=links._replace(length=_link_lengths(flat)))


def _link_lists(links: Int, start: Int) -> tuple[Int, Int, Int]:
    """Links as lists by cell, each link both ways and once."""
    a = start[links[:, 0]] + links[:, 1]
    b = start[links[:, 2]] + links[:, 3]
    pairs = np.stack([np.concatenate([a, b]), np.concatenate([b, a])], axis=1)
    pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
    cell, first = np.unique(pairs[:, 0], return_index=True)
    return cell, np.append(first, len(pairs)), np.ascontiguousarray(pairs[:, 1])


def _find_slopes(links: Int, layout: Layout) -> NDArray[np.uint8]:
    """The `slopes` of a FlatGrid."""
    from navbake.runtime.kernels.arrays import EAST, SOUTH  # saves numba at start-up

    own = links[links[:, 0] == links[:, 2]]
    if not len(own):
        return np.zeros(0, dtype=np.uint8)
    slopes = np.zeros(layout.start[-1], dtype=np.uint8)
    low, high = np.sort(own[:, [1, 3]], axis=1).T
    width, first = layout.width[own[:, 0]], layout.start[own[:, 0]]
    for step, bit in ((np.ones_like(width), EAST), (width, SOUTH)):
        beside = (high - low == step) & ((bit == SOUTH) | (low // width == high // width))
        slopes[(first + low)[beside]] |= np.uint8(bit)
    return slopes


def _link_lengths(flat: FlatGrid) -> Float:
    """How long each link is [m].

    It is the octile distance between the centres of its cells, seen from above, and at least a
    cell: between neighbours on one lattice, as navbake links them, exactly a cell.
    """
    source, target = flat.link_ends()
    one, other = flat.positions(source), flat.positions(target)
    across, along = np.sort(np.abs(one - other)[:, :2], axis=1).T
    size = flat.layout.cell_size
    least = np.minimum(size[flat.level_of(source)], size[flat.level_of(target)])
    return np.asarray(np.maximum(along + (math.sqrt(2.0) - 1.0) * across, least))
