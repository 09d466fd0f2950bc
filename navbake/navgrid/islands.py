"""The connected parts of a grid, and the clearance of its cells."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.grid import GridBase, SceneGrid2D
from navbake.navgrid.links import MAX_AREAS, find_arcs
from navbake.navgrid.obstacle_state import Window
from navbake.types import Bool, Int, Int32

STEP_SLACK = 1e-6  # [m] tolerance of the highest step
TOO_MANY = 65535  # the number of all further islands in a file


def find_islands(grid: GridBase) -> list[Int32]:
    """Number the connected parts of the free cells, the largest first.

    Two free cells are connected if they share an edge and their floors differ by at most the
    grid's `traversableFloorHeight` (plus 1e-6 m and float32 rounding), or if a step or open links
    lead from each to the other. A free cell without floor height is level with each of its
    neighbours. Cells of an area whose cost is infinite count as not free.

    Returns one array a level, shape (height, width), int32: the number of each free cell's part,
    else 0. Parts of equal size are numbered by their lowest (level, cell id).
    """
    levels = grid.levels
    start = np.cumsum([0] + [level.width * level.height for level in levels], dtype=np.int64)
    width = np.array([level.width for level in levels], dtype=np.int64)
    free = np.concatenate([level.free.ravel() for level in levels])
    floor = np.concatenate([level.floor_height.ravel() for level in levels])
    free &= ~cells_of_areas(grid, [area.bars(None) for area in grid.areas], False)
    # one row of cells for all levels, so that steps join cells like edges do
    steps = start[grid.step_array[:, ::2]] + grid.step_array[:, 1::2]
    arcs = find_arcs(grid.links, start)
    ways = arcs.ends[arcs.fits_radius(grid.radius)]
    island = label_islands(start, width, free, floor, step_limit(grid), steps, ways)
    return [island[start[i] : start[i + 1]].reshape(level.shape) for i, level in enumerate(levels)]


def cells_of_areas(grid: GridBase, values: Sequence[Any], outside: Any) -> NDArray[Any]:
    """The values of areas by their cells, by flat id; without areas one value, `outside`."""
    if not len(values):
        return np.array([outside])
    table = np.array([outside, *values, *[outside] * (MAX_AREAS - len(values))])
    return np.concatenate([table[level.area_index].ravel() for level in grid.levels])


def label_islands(
    start: Int,
    width: Int,
    free: Bool,
    floor: NDArray[Any],
    limit: float,
    steps: Int,
    ways: Int | None = None,
) -> Int32:
    """Number the parts by the rule of `find_islands`; returns int32 by flat id, 0 if not free.

    Connected components by runs of cells along rows. Each run points at the lowest run known to be
    connected with it, at first itself. Alternately, the ends of all pairs of connected runs are
    hooked, the higher to the lower, and all pointers are followed to their ends, until all pairs
    have equal ends (Shiloach and Vishkin, 1982).

    Args:
        start: the first flat id of each level, and the number of cells, shape (levels + 1,).
        width: columns of each level, shape (levels,).
        free, floor: of each cell, shape (n,).
        limit: largest difference of neighbours' floors, in the unit of `floor`.
        steps: pairs of connected cells, shape (m, 2).
        ways: cells that links lead from and to, shape (k, 2).
    """
    # float32, and a difference of two that is rounded to it, could pass a limit
    floor = floor.astype(np.float64)
    begins = free.copy()
    pairs = [steps[free[steps].all(axis=1)]]
    for first, last, columns in zip(start[:-1], start[1:], width, strict=True):
        own = slice(first, last)
        is_free = free[own].reshape(-1, columns)
        height = floor[own].reshape(-1, columns)
        is_first = begins[own].reshape(-1, columns)
        # an unknown floor is level with its neighbours
        right = is_free[:, 1:] & is_free[:, :-1]
        right &= ~(np.abs(height[:, 1:] - height[:, :-1]) > limit)
        is_first[:, 1:] &= ~right
        down = is_free[1:] & is_free[:-1] & ~(np.abs(height[1:] - height[:-1]) > limit)
        # one pair of cells for each pair of runs
        down[:, 1:] &= ~down[:, :-1] | is_first[1:, 1:] | is_first[:-1, 1:]
        upper = np.flatnonzero(down) + first
        pairs.append(np.stack([upper, upper + columns], axis=1))
    run = np.cumsum(begins) - 1
    ends = run[np.concatenate(pairs)]
    root = np.arange(np.count_nonzero(begins))
    while len(ends):
        ends = root[ends]
        ends = ends[ends[:, 0] != ends[:, 1]]
        np.minimum.at(root, ends.max(axis=1), ends.min(axis=1))
        while (root[root] != root).any():
            root = root[root]
    number = np.unique(root, return_inverse=True)[1]
    if ways is not None and free[ways].all(axis=1).any():
        number = _join(number, number[run[ways[free[ways].all(axis=1)]]])
    number = number[run[free]]
    size = np.bincount(number, minlength=1)
    rank = np.empty(len(size), dtype=np.int32)
    # stable, so that equal parts stay in the order of their first cells
    rank[np.argsort(-size, kind="stable")] = np.arange(1, len(size) + 1)
    island = np.zeros(len(free), dtype=np.int32)
    island[free] = rank[number]
    return island


def _join(number: Int, ways: Int) -> Int:
    """Number parts again, from 0 in their order, where those that lead to each other are one.

    `number` has the part of each run, `ways` the parts that links lead from and to, shape (k, 2).
    """
    from scipy.sparse import coo_array  # scipy loads slowly
    from scipy.sparse.csgraph import connected_components  # the same

    count = int(number.max()) + 1
    graph = coo_array((np.ones(len(ways)), tuple(ways.T)), shape=(count, count))
    joined = connected_components(graph, connection="strong")[1]
    lowest = np.full(count, count)
    np.minimum.at(lowest, joined, np.arange(count))
    return np.unique(lowest[joined][number], return_inverse=True)[1]


def islands_of(grid: GridBase) -> list[Int32]:
    """The islands stored in the file, or else the cached result of `find_islands`.

    A stored layer ``island`` is used only in files that navbake wrote, and only without blocks: in
    files of other programs it may mean anything. The arrays must not be modified.
    """
    stored = [level.attributes.get("island") for level in grid.levels]
    if (
        grid.navbake
        and not grid.is_blocked
        and all(s is not None and s.max(initial=0) < TOO_MANY for s in stored)
    ):
        return [np.asarray(s).astype(np.int32) for s in stored]
    # a hash of all that the islands depend on, because a grid's arrays can be written to
    tables = grid.step_array.tolist(), grid.links, grid.areas, grid.radius
    digest = blake2b(repr((step_limit(grid), *tables)).encode())
    for level in grid.levels:
        digest.update(level.area_index.data if grid.areas else b"")
        digest.update(np.packbits(level.free).tobytes())
        digest.update(np.ascontiguousarray(level.floor_height).data)
    if grid.cached_islands is None or grid.cached_islands[0] != digest.digest():
        grid.cached_islands = (digest.digest(), find_islands(grid))
    return grid.cached_islands[1]


def clearance(level: SceneGrid2D, window: Window | None = None) -> NDArray[np.float32]:
    """Measure the distance from each free cell to the nearest cell that is not free [m].

    From centre to centre, less half a cell; outside the grid is not free. Cells that only the disc
    of the baked radius closed count as free: see `SceneGrid2D.free_for_point`. Shape of the level
    or of the window, float32; 0 in cells that are not free. A window ignores the cells outside it.
    """
    from scipy.ndimage import distance_transform_edt  # scipy loads slowly

    row0, row1, col0, col1 = window or (0, level.height, 0, level.width)
    free = level.free[row0:row1, col0:col1]
    is_open = level.free_for_point[row0:row1, col0:col1]
    # one closed cell beyond each side that is at the grid's edge
    top = int(row0 == 0)
    left = int(col0 == 0)
    sides = (top, int(row1 == level.height)), (left, int(col1 == level.width))
    cells = distance_transform_edt(np.pad(is_open, sides))
    cells = cells[top : top + free.shape[0], left : left + free.shape[1]]
    return np.where(free, (cells - 0.5) * level.lattice.cell_size, 0.0).astype(np.float32)


def group_steps(grid: GridBase, steps: Int) -> Iterator[Int]:
    """Group steps from one level to another whose cells on the first touch, as treads of a stair.

    `steps` are rows of `step_array`, and so are the groups, by the numbers of the levels.
    """
    from scipy import ndimage  # scipy loads slowly

    for pair in np.unique(steps[:, ::2], axis=0).tolist():
        own = steps[(steps[:, ::2] == pair).all(axis=1)]
        level = grid.levels[pair[0]]
        marks = np.zeros(level.shape, dtype=np.bool_)
        cells = np.divmod(own[:, 1], level.width)
        marks[cells] = True
        group = ndimage.label(marks, np.ones((3, 3)))[0][cells]
        yield from (own[group == number] for number in np.unique(group).tolist())


def step_limit(grid: GridBase) -> float:
    """The largest difference of neighbours' floors [file units] that is a step.

    It is the grid's `traversableFloorHeight`, plus 1e-6 m and the float32 rounding of its highest
    floor, so that a step exactly as high as allowed is one.
    """
    floors = [np.abs(level.floor_height) for level in grid.levels]
    highest = max(float(np.nanmax(floor, initial=0.0)) for floor in floors)
    rounding = float(np.spacing(np.float32(highest)))
    return grid.max_step / grid.unit + STEP_SLACK / grid.unit + rounding


def renew_islands(grid: GridBase) -> None:
    """Store the islands anew where the levels have a layer of them."""
    add_layers(grid, {name for level in grid.levels for name in level.attributes} & {"island"})


def add_layers(grid: GridBase, names: Iterable[str]) -> None:
    """Compute and store, or replace, the layers among `names` that are known.

    These are ``island`` (uint16; numbers above 65535 become 65535) and ``clearance`` (float32 [m]).
    """
    if "island" in names:
        for level, island in zip(grid.levels, find_islands(grid), strict=True):
            level.attributes["island"] = np.minimum(island, TOO_MANY).astype(np.uint16)
    if "clearance" in names:
        for level in grid.levels:
            level.attributes["clearance"] = clearance(level)
