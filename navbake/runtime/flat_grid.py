"""The flat view of a grid that kernels walk on: the cells of all levels, one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.islands import step_limit

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid, SceneGrid2D


@dataclass(frozen=True, eq=False)
class Walk:
    """All levels of a grid as one row of cells, and where steps lead from level to level.

    The flat id of a cell is ``start[level] + row * width[level] + col``. Two neighbours on one
    level are a step apart where both are free and their floors differ by at most `max_step`; a
    cell without floor height is level with each of its neighbours. Where a link leads, the floor
    is the baker's business: it joins two cells, both ways, whenever both are free.

    Attributes:
        start: first flat id of each level, and one past the last, shape (num_levels + 1,), int64.
        width: number of columns of each level, shape (num_levels,), int64.
        height: number of rows of each level, shape (num_levels,), int64.
        x_min: world x of the outer edge of column 0 of each level [m], float64.
        y_max: world y of the outer edge of row 0 of each level [m], float64; rows run towards
            smaller y.
        cell_size: edge of a cell of each level [m], float64; the same on all in what navbake
            bakes.
        ground: world z of each level's ground [m], float64: the floor of free cells that have
            none of their own.
        free: shape (n,), bool.
        floor: world z of the floor [m], shape (n,), float64, NaN where there is none; the ground
            on a level whose file tells no floors.
        weight: cost of a cell, shape (n,), float64, inf where it isn't free.
        max_step: by how much the floors of neighbours may differ [m], slack included; see
            `navbake.navgrid.islands.step_limit`.
        link_cell: cells that links lead from, shape (m,), ascending, each once, int64.
        link_start: shape (m + 1,), int64: from ``link_cell[i]`` links lead to
            ``link_target[link_start[i]:link_start[i + 1]]``.
        link_target: flat ids, ascending for each cell, int64; each link is there both ways.
    """

    start: NDArray[np.int64]
    width: NDArray[np.int64]
    height: NDArray[np.int64]
    x_min: NDArray[np.float64]
    y_max: NDArray[np.float64]
    cell_size: NDArray[np.float64]
    ground: NDArray[np.float64]
    free: NDArray[np.bool_]
    floor: NDArray[np.float64]
    weight: NDArray[np.float64]
    max_step: float
    link_cell: NDArray[np.int64]
    link_start: NDArray[np.int64]
    link_target: NDArray[np.int64]

    @property
    def num_levels(self) -> int:
        """Number of levels, at least 1."""
        return len(self.width)

    @property
    def num_cells(self) -> int:
        """Number of cells of all levels."""
        return int(self.start[-1])

    def level_of(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """The levels of cells, by flat id, same shape."""
        return np.searchsorted(self.start, cells, side="right") - 1

    def positions(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """World positions of cells' centres on the floor [m].

        Args:
            cells: flat ids, shape (...).

        Returns:
            Shape (..., 3), float64; where there is no floor height, at the level's ground.
        """
        level = self.level_of(cells)
        row, col = np.divmod(cells - self.start[level], self.width[level])
        size = self.cell_size[level]
        x = self.x_min[level] + (col + 0.5) * size
        y = self.y_max[level] - (row + 0.5) * size
        floor = self.floor[cells]
        z = np.where(np.isnan(floor), self.ground[level], floor)
        return np.stack([x, y, z], axis=-1)


def make_walk(grid: NavGrid) -> Walk:
    """Lay the levels of a grid out as one row of cells.

    Args:
        grid: a grid of one or several levels.

    Returns:
        Copies: what happens to the grid later does not reach them.
    """
    levels = grid.levels
    lattices = [level.lattice for level in levels]
    start = np.cumsum([0] + [level.width * level.height for level in levels], dtype=np.int64)
    weight = np.concatenate([level.weights.ravel().astype(np.float64) for level in levels])
    floors = [_flat_floor(level) for level in levels]
    free = np.isfinite(weight)
    weight[~free] = np.inf
    return Walk(
        start=start,
        width=np.array([lattice.width for lattice in lattices], dtype=np.int64),
        height=np.array([lattice.height for lattice in lattices], dtype=np.int64),
        x_min=np.array([lattice.x_min for lattice in lattices], dtype=np.float64),
        y_max=np.array([lattice.y_max for lattice in lattices], dtype=np.float64),
        cell_size=np.array([lattice.cell_size for lattice in lattices], dtype=np.float64),
        ground=np.array([level.ground for level in levels], dtype=np.float64),
        free=free,
        floor=np.concatenate(floors),
        weight=weight,
        max_step=step_limit(grid) * grid.unit,
        **_link_lists(grid.link_array, start),
    )


def _flat_floor(level: SceneGrid2D) -> NDArray[np.float64]:
    if "floorHeight" not in level.attributes:
        return np.full(level.width * level.height, level.ground)
    return level.floor_height.ravel().astype(np.float64) * level.unit


def _link_lists(links: NDArray[np.int64], start: NDArray[np.int64]) -> dict[str, NDArray[np.int64]]:
    """Links as lists by cell, each link both ways and once."""
    a = start[links[:, 0]] + links[:, 1]
    b = start[links[:, 2]] + links[:, 3]
    pairs = np.stack([np.concatenate([a, b]), np.concatenate([b, a])], axis=1)
    pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
    cell, first = np.unique(pairs[:, 0], return_index=True)
    return {
        "link_cell": cell,
        "link_start": np.append(first, len(pairs)).astype(np.int64),
        "link_target": np.ascontiguousarray(pairs[:, 1]),
    }
