"""Finds the islands of a grid (the connected parts of its free cells), and cells' clearance."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.grid import GridBase, NavGrid, SceneGrid2D
from navbake.navgrid.links import MAX_AREAS, find_arcs
from navbake.navgrid.obstacle_state import CellRange
from navbake.types import Bool, Int, Int32

STEP_SLACK = 1e-6  # tolerance of the highest step [m]
# files store islands as uint16: this number stands for the 65535th island and all smaller ones
MAX_STORED_ISLAND = 65535


def find_islands(grid: GridBase) -> list[Int32]:
    """Number the connected parts of the free cells, the largest first.

    Two free cells are connected if they share an edge and their floors differ by at most the
    grid's `traversableFloorHeight` (plus 1e-6 m and float32 rounding). They are also connected if a
    step joins them, or if open links lead from each to the other. A free cell without a floor
    height is connected with all free neighbours. Cells of an area whose cost is infinite count as
    not free.

    Returns:
        An array for each level, shape (height, width), int32: the number of each free cell's
        island, else 0. Islands of equal size are numbered by their lowest (level, cell id).
    """
    levels = grid.levels
    first_cells = np.cumsum([0] + [level.width * level.height for level in levels], dtype=np.int64)
    widths = np.array([level.width for level in levels], dtype=np.int64)
    is_free = np.concatenate([level.free.ravel() for level in levels])
    floor_y = np.concatenate([level.floor_height.ravel() for level in levels])
    is_free &= ~values_by_area(grid, [area.bars(None) for area in grid.areas], False)
    # flat ids over all levels, so that steps join cells as edges do
    steps = first_cells[grid.step_array[:, ::2]] + grid.step_array[:, 1::2]
    arcs = find_arcs(grid.links, first_cells)
    island_numbers = label_islands(
        first_cells=first_cells,
        widths=widths,
        is_free=is_free,
        floor=floor_y,
        max_rise=step_limit(grid),
        steps=steps,
        arcs=arcs.ends[arcs.fits_radius(grid.radius)],
    )
    return [
        island_numbers[first_cells[level_number] : first_cells[level_number + 1]].reshape(
            level.shape
        )
        for level_number, level in enumerate(levels)
    ]


def values_by_area(grid: GridBase, values: Sequence[object], value_outside: object) -> NDArray[Any]:
    """Return an array by flat id: for each cell, the value that belongs to the cell's area.

    Args:
        grid: The grid.
        values: A value for each of its areas, in their order.
        value_outside: The value of cells in no area.

    Returns:
        The value of each cell, by flat id over all levels; an array of the single entry
        `value_outside` if the grid has no areas.
    """
    if not len(values):
        return np.array([value_outside])
    value_by_area = np.array([value_outside, *values, *[value_outside] * (MAX_AREAS - len(values))])
    return np.concatenate([value_by_area[level.area_index].ravel() for level in grid.levels])


def label_islands(
    first_cells: Int,
    widths: Int,
    is_free: Bool,
    floor: NDArray[Any],
    max_rise: float,
    steps: Int,
    arcs: Int | None = None,
) -> Int32:
    """Number the connected parts of free cells by the rule of `find_islands`.

    The algorithm is that of Shiloach and Vishkin (1982). A run is a row of connected cells side by
    side. Each run has a pointer to a connected run of a lower number, at first to itself. Two steps
    alternate until all runs of a part point to the same one: for each pair of connected runs, the
    higher of the two runs that they point to gets a pointer to the lower one; then all pointers are
    followed to their ends.

    Args:
        first_cells: First flat id of each level, then the number of all cells, shape (levels + 1,).
        widths: Number of columns of each level, shape (levels,).
        is_free: Whether each cell is free, by flat id, shape (n,).
        floor: Floor of each cell, NaN for none, shape (n,).
        max_rise: Largest difference of neighbours' floors, in the unit of `floor`.
        steps: Flat ids of the two cells that each step joins, shape (m, 2).
        arcs: Flat ids of the cells that each link leads from and to, shape (k, 2); None for no
            links.

    Returns:
        The number of each cell's island by flat id, int32; 0 if it is not free.
    """
    # float32, and a difference of two that is rounded to it, could pass a limit
    floor = floor.astype(np.float64)
    begins_run = is_free.copy()
    cell_pairs = [steps[is_free[steps].all(axis=1)]]
    for first_cell, end_cell, num_cols in zip(
        first_cells[:-1], first_cells[1:], widths, strict=True
    ):
        level_cells = slice(first_cell, end_cell)
        is_level_free = is_free[level_cells].reshape(-1, num_cols)
        level_floor = floor[level_cells].reshape(-1, num_cols)
        level_begins_run = begins_run[level_cells].reshape(-1, num_cols)
        # an unknown floor, NaN, is level with its neighbours
        joins_right = is_level_free[:, 1:] & is_level_free[:, :-1]
        joins_right &= ~(np.abs(level_floor[:, 1:] - level_floor[:, :-1]) > max_rise)
        level_begins_run[:, 1:] &= ~joins_right
        joins_down = is_level_free[1:] & is_level_free[:-1]
        joins_down &= ~(np.abs(level_floor[1:] - level_floor[:-1]) > max_rise)
        # one pair of cells for each pair of runs: where the pair to the left doesn't join, or where
        # one of the runs begins
        joins_down[:, 1:] &= (
            ~joins_down[:, :-1] | level_begins_run[1:, 1:] | level_begins_run[:-1, 1:]
        )
        upper_cells = np.flatnonzero(joins_down) + first_cell
        cell_pairs.append(np.stack([upper_cells, upper_cells + num_cols], axis=1))
    run_of_cell = np.cumsum(begins_run) - 1
    run_pairs = run_of_cell[np.concatenate(cell_pairs)]
    root_of_run = np.arange(np.count_nonzero(begins_run))
    while len(run_pairs):
        run_pairs = root_of_run[run_pairs]
        run_pairs = run_pairs[run_pairs[:, 0] != run_pairs[:, 1]]
        np.minimum.at(root_of_run, run_pairs.max(axis=1), run_pairs.min(axis=1))
        while (root_of_run[root_of_run] != root_of_run).any():
            root_of_run = root_of_run[root_of_run]
    island_of_run = np.unique(root_of_run, return_inverse=True)[1]
    if arcs is not None and is_free[arcs].all(axis=1).any():
        free_arcs = arcs[is_free[arcs].all(axis=1)]
        island_of_run = _join_linked(island_of_run, island_of_run[run_of_cell[free_arcs]])
    island_of_run = island_of_run[run_of_cell[is_free]]
    island_sizes = np.bincount(island_of_run, minlength=1)
    number_by_island = np.empty(len(island_sizes), dtype=np.int32)
    # stable, so that islands of one size stay in the order of their first cells
    number_by_island[np.argsort(-island_sizes, kind="stable")] = np.arange(1, len(island_sizes) + 1)
    island_numbers = np.zeros(len(is_free), dtype=np.int32)
    island_numbers[is_free] = number_by_island[island_of_run]
    return island_numbers


def _join_linked(island_of_run: Int, linked_islands: Int) -> Int:
    """Join islands that links connect in both directions, and renumber all islands from 0.

    The islands keep their order; a joined island has the place of the first of its parts.

    Args:
        island_of_run: The island of each run, shape (n,).
        linked_islands: The islands that each link leads from and to, shape (k, 2).

    Returns:
        The new island of each run, shape (n,).
    """
    from scipy.sparse import coo_array  # scipy loads slowly
    from scipy.sparse.csgraph import connected_components  # scipy loads slowly

    num_islands = int(island_of_run.max()) + 1
    graph = coo_array(
        (np.ones(len(linked_islands)), tuple(linked_islands.T)), shape=(num_islands, num_islands)
    )
    components = connected_components(graph, connection="strong")[1]
    lowest_island = np.full(num_islands, num_islands)
    np.minimum.at(lowest_island, components, np.arange(num_islands))
    return np.unique(lowest_island[components][island_of_run], return_inverse=True)[1]


def islands_of(grid: GridBase) -> list[Int32]:
    """Return the islands of a grid: those stored in its file, or else those of `find_islands`.

    The result of `find_islands` is cached until the grid changes.

    A stored layer ``island`` is used under three conditions: navbake wrote the file (in files of
    other programs the layer may mean anything), no added obstacle blocks a cell, and the grid has
    no more islands than the layer's uint16 can number.

    Returns:
        For each level, the number of each cell's island, shape (height, width), int32. The arrays
        must not be modified.
    """
    stored_layers = [level.attributes.get("island") for level in grid.levels]
    if (
        grid.navbake
        and not grid.is_blocked
        and all(
            layer is not None and layer.max(initial=0) < MAX_STORED_ISLAND
            for layer in stored_layers
        )
    ):
        return [np.asarray(layer).astype(np.int32) for layer in stored_layers]
    digest = _digest_sources(grid)
    if grid.cached_islands is None or grid.cached_islands[0] != digest:
        grid.cached_islands = (digest, find_islands(grid))
    return grid.cached_islands[1]


def _digest_sources(grid: GridBase) -> bytes:
    """Hash all data that the islands depend on: callers may have changed a grid's arrays."""
    tables = (grid.step_array.tolist(), grid.links, grid.areas, grid.radius)
    digest = blake2b(repr((step_limit(grid), *tables)).encode())
    for level in grid.levels:
        digest.update(level.area_index.data if grid.areas else b"")
        digest.update(np.packbits(level.free).tobytes())
        digest.update(np.ascontiguousarray(level.floor_height).data)
    return digest.digest()


def measure_clearance(
    level: SceneGrid2D, cell_range: CellRange | None = None
) -> NDArray[np.float32]:
    """Measure the distance from each free cell to the nearest cell that is not free [m].

    The distance is measured between centres, and half a cell is subtracted. Cells outside the grid
    are not free. Cells that only the disc of the baked radius blocks count as free (see
    `SceneGrid2D.free_for_point`), but their own clearance is 0.

    Args:
        level: The level.
        cell_range: Measure in this range of cells only, and ignore blocked cells beyond it; None
            for all cells.

    Returns:
        The clearance [m], of the shape of the level or of `cell_range`, float32; 0 in cells that
        are not free.
    """
    from scipy.ndimage import distance_transform_edt  # scipy loads slowly

    first_row, stop_row, first_col, stop_col = cell_range or (0, level.height, 0, level.width)
    is_free = level.free[first_row:stop_row, first_col:stop_col]
    is_free_for_point = level.free_for_point[first_row:stop_row, first_col:stop_col]
    # one blocked cell beyond each side of the cells that is an edge of the grid
    pad_top = int(first_row == 0)
    pad_left = int(first_col == 0)
    pad_bottom = int(stop_row == level.height)
    pad_right = int(stop_col == level.width)
    padded_mask = np.pad(is_free_for_point, ((pad_top, pad_bottom), (pad_left, pad_right)))
    distances = distance_transform_edt(padded_mask)  # in cells
    distances = distances[
        pad_top : pad_top + is_free.shape[0], pad_left : pad_left + is_free.shape[1]
    ]
    return np.where(is_free, (distances - 0.5) * level.lattice.cell_size, 0.0).astype(np.float32)


def group_steps(grid: GridBase, steps: Int) -> Iterator[Int]:
    """Group the steps between levels that lie side by side: each group is a stair.

    Steps belong to one stair if they join the same two levels, and their cells on the first of
    these levels touch, also at corners.

    Args:
        grid: The grid.
        steps: Some rows of its `step_array`, shape (n, 4).

    Yields:
        The rows of `steps` of each stair, shape (k, 4). Stairs are sorted by the levels they join.
    """
    from scipy import ndimage  # scipy loads slowly

    for level_pair in np.unique(steps[:, ::2], axis=0).tolist():
        steps_of_pair = steps[(steps[:, ::2] == level_pair).all(axis=1)]
        level = grid.levels[level_pair[0]]
        is_step_cell = np.zeros(level.shape, dtype=np.bool_)
        rows_and_cols = np.divmod(steps_of_pair[:, 1], level.width)
        is_step_cell[rows_and_cols] = True
        group_numbers = ndimage.label(is_step_cell, np.ones((3, 3)))[0][rows_and_cols]
        for group_number in np.unique(group_numbers).tolist():
            yield steps_of_pair[group_numbers == group_number]


def step_limit(grid: GridBase) -> float:
    """Return the largest height difference between neighbours that an agent can step [file units].

    It is the grid's `traversableFloorHeight`, plus 1e-6 m and the float32 rounding of its highest
    floor, so that a step of exactly the allowed height is allowed.
    """
    highest_floor = 0.0
    for level in grid.levels:
        floor = level.floor_height
        for extreme in (np.nanmin(floor, initial=0.0), np.nanmax(floor, initial=0.0)):
            highest_floor = max(highest_floor, abs(float(extreme)))
    rounding = float(np.spacing(np.float32(highest_floor)))
    return grid.max_step / grid.unit + STEP_SLACK / grid.unit + rounding


def with_current_islands(grid: NavGrid) -> NavGrid:
    """Return a grid whose layer ``island``, if it has one, tells of added obstacles, too.

    `block` leaves this layer as it is: an obstacle may change it in all cells, and renewing it
    would take far longer than `block`. So it is renewed where a grid is written or copied.

    Args:
        grid: The grid, which stays as it is. It is returned itself if no obstacle blocks a cell, or
            if it has no such layer; in files of other programs, the layer may mean anything.

    Raises:
        FormatError: A table on which the islands depend is broken.
    """
    has_layer = any("island" in level.attributes for level in grid.levels)
    if not grid.navbake or not has_layer or not grid.is_blocked:
        return grid
    current_grid = grid.with_levels([level.with_layers() for level in grid.levels])
    renew_islands(current_grid)
    return current_grid


def renew_islands(grid: GridBase) -> None:
    """Recompute the layer ``island`` of the levels, if they have it."""
    add_layers(grid, {name for level in grid.levels for name in level.attributes} & {"island"})


def add_layers(grid: GridBase, names: Iterable[str]) -> None:
    """Compute the layers ``island`` and ``clearance``, and store them as attributes of the levels.

    Layers of these names that the levels already have are replaced.

    Args:
        grid: The grid, which changes.
        names: Names of layers; only ``island`` (uint16; islands above 65535 become 65535) and
            ``clearance`` (float32 [m]) are computed, other names are ignored.
    """
    if "island" in names:
        for level, island_numbers in zip(grid.levels, find_islands(grid), strict=True):
            level.attributes["island"] = np.minimum(island_numbers, MAX_STORED_ISLAND).astype(
                np.uint16
            )
    if "clearance" in names:
        for level in grid.levels:
            level.attributes["clearance"] = measure_clearance(level)
