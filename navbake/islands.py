"""The connected parts of a grid, and how far each cell is from what blocks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from navbake.grid import MultiLevelGrid, SceneGrid2D

STEP_SLACK = 1e-6  # metres that a step may be over the highest one
DEFAULT_STEP = 0.25  # metres, where a file doesn't tell its traversableFloorHeight


def find_islands(grid: SceneGrid2D | MultiLevelGrid) -> list[NDArray[np.int32]]:
    """Number the connected parts of the free cells, the largest first.

    Two free cells are connected where they share an edge and their floors differ by at most the
    grid's `traversableFloorHeight` (plus 1e-6 m and what float32 rounds off), or where a link
    joins them. A free cell without floor height is level with each of its neighbours.

    Args:
        grid: a grid of one or several levels.

    Returns:
        One array a level, shape (height, width), int32: 0 where the cell isn't free, else the
        number of its part. Parts of equal size are numbered by their lowest (level, cell id).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    limit = step_limit(grid)
    start = np.cumsum([0] + [level.free.size for level in grid.levels])
    pairs = [
        _step_pairs(level.free, level.floor_height, limit) + first
        for level, first in zip(grid.levels, start[:-1], strict=True)
    ]
    pairs.append(_link_pairs(grid, start))
    free = np.concatenate([level.free.ravel() for level in grid.levels])
    node = np.cumsum(free, dtype=np.int32) - 1  # free cells only, numbered on through the levels
    sources, targets = node[np.concatenate(pairs, axis=1)]
    num_free = int(np.count_nonzero(free))
    steps = coo_array(
        (np.ones(len(sources), dtype=np.bool_), (sources, targets)), shape=(num_free, num_free)
    )
    _, part = connected_components(steps, directed=False)

    islands = np.zeros(len(free), dtype=np.int32)
    islands[free] = _rank_by_size(part)
    return [
        islands[start[i] : start[i + 1]].reshape(level.free.shape)
        for i, level in enumerate(grid.levels)
    ]


def clearance(level: SceneGrid2D) -> NDArray[np.float32]:
    """Measure the distance from each free cell to the nearest cell that is not free.

    From centre to centre, less half a cell; what lies outside the grid counts as not free.

    Args:
        level: one level.

    Returns:
        Metres, shape (height, width), float32; 0 where the cell itself is not free.
    """
    from scipy.ndimage import distance_transform_edt

    cells = distance_transform_edt(np.pad(level.free, 1))[1:-1, 1:-1]
    metres = (cells - 0.5) * level.lattice.cell_size
    return np.where(level.free, metres, 0.0).astype(np.float32)


def highest_step(grid: SceneGrid2D | MultiLevelGrid) -> float:
    """The grid's `traversableFloorHeight` [file units]."""
    stated = grid.metadata.get("traversableFloorHeight")
    if isinstance(stated, int | float) and stated >= 0:
        return float(stated)
    return DEFAULT_STEP / grid.unit


def step_limit(grid: SceneGrid2D | MultiLevelGrid) -> float:
    """By how much the floors of two neighbours may differ [file units].

    The grid's `traversableFloorHeight`, plus 1e-6 m and what float32 rounds off at its highest
    floor, so that a step exactly as high as allowed is one.
    """
    floors = [np.abs(level.floor_height) for level in grid.levels]
    highest = max(float(np.nanmax(floor, initial=0.0)) for floor in floors)
    return highest_step(grid) + STEP_SLACK / grid.unit + float(np.spacing(np.float32(highest)))


def _step_pairs(
    free: NDArray[np.bool_], floor: NDArray[np.float32], limit: float
) -> NDArray[np.int64]:
    """Cell ids of the neighbours that a step joins, shape (2, n)."""
    cell = np.arange(free.size).reshape(free.shape)
    height = floor.astype(np.float64)
    pairs = []
    for near, far in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        too_high = np.abs(height[near] - height[far]) > limit  # False for NaN
        joined = free[near] & free[far] & ~too_high
        pairs.append(np.stack([cell[near][joined], cell[far][joined]]))
    return np.concatenate(pairs, axis=1)


def _link_pairs(grid: SceneGrid2D | MultiLevelGrid, start: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ids, through all levels, of the free cells that links join, shape (2, n)."""
    links = np.asarray(grid.links, dtype=np.int64).reshape(-1, 4)
    free = np.concatenate([level.free.ravel() for level in grid.levels])
    pairs = np.stack([start[links[:, 0]] + links[:, 1], start[links[:, 2]] + links[:, 3]])
    return pairs[:, free[pairs].all(axis=0)]


def _rank_by_size(part: NDArray[np.int32]) -> NDArray[np.int32]:
    """Renumber the parts from 1, largest first, then by their first member."""
    size = np.bincount(part)
    first = np.empty(len(size), dtype=np.int64)
    first[part[::-1]] = np.arange(len(part))[::-1]  # of several, the last one written stays
    rank = np.empty(len(size), dtype=np.int32)
    rank[np.lexsort((first, -size))] = np.arange(1, len(size) + 1)
    return rank[part]


def add_layers(grid: SceneGrid2D | MultiLevelGrid, names: Iterable[str]) -> None:
    """Write further layers into a grid, anew where it has them already.

    Args:
        grid: changed in place.
        names: some of ``island`` (uint16; what lies beyond number 65535 shares it) and
            ``clearance`` (float32 [m]).
    """
    if "island" in names:
        for level, island in zip(grid.levels, find_islands(grid), strict=True):
            level.attributes["island"] = np.minimum(island, 65535).astype(np.uint16)
    if "clearance" in names:
        for level in grid.levels:
            level.attributes["clearance"] = clearance(level)
