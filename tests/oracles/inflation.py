"""Which cells stay free for a larger agent, by the rules' words: every cell against every other."""

from __future__ import annotations

import math

import numpy as np

STEP, HEIGHT, SLAB, BAKED = 0.25, 1.14, 0.3, 0.05


def square_distance(row: int, col: int) -> float:
    """From a centre to the square of the cell so many rows and columns on [cells]."""
    return math.hypot(max(abs(row) - 0.5, 0), max(abs(col) - 0.5, 0))


def exact_free(level, radius: float) -> np.ndarray:
    """The cells of an only level on a flat floor that stay free."""
    cell = level.lattice.cell_size
    free = level.free.copy()
    occupied = np.argwhere(level.occupancy != 0)
    for row, col in np.argwhere(free):
        for r, c in occupied:
            if square_distance(r - row, c - col) * cell < radius * (1 - 1e-9):
                free[row, col] = False
                break
    return free


def stacked_free(grid, radius: float, extent: int, ledges: str = "avoid") -> list[np.ndarray]:
    """The cells that stay free on several levels of one lattice; rectangles, floors, ledges.

    Args:
        grid: levels of the same cell size, whole cells apart.
        radius: [m].
        extent: how far round each level to look, in cells.
        ledges: whether lower floors block.
    """
    origin = grid.levels[0].lattice
    cell = origin.cell_size
    known = []  # of each level, by (row, col) of the first one's lattice: floor, occupied
    for level in grid.levels:
        row0 = round((origin.y_max - level.lattice.y_max) / cell)
        col0 = round((level.lattice.x_min - origin.x_min) / cell)
        known.append(
            {
                (row0 + r, col0 + c): (
                    float(level.floor_height[r, c]),
                    bool(level.occupancy[r, c]),
                    (r, c),
                )
                for r in range(level.height)
                for c in range(level.width)
            }
        )
    places = np.array([place for cells in known for place in cells])
    lowest, highest = places.min(axis=0), places.max(axis=0)
    result = []
    for number, level in enumerate(grid.levels):
        free = level.free.copy()
        for place, (floor, _, own) in known[number].items():
            reached = [
                there
                for there in _reached(place, radius, cell, extent)
                if np.all((lowest <= there) & (there <= highest))  # nothing is known beyond
            ]
            if free[own] and (
                _is_hit(known, number, reached, floor, radius)
                or (ledges == "avoid" and _hangs_over(known, reached, floor))
            ):
                free[own] = False
        result.append(free)
    return result


NOTHING = (math.nan, True, None)


def _reached(place, radius, cell, extent) -> list[tuple[int, int]]:
    span = range(-extent, extent + 1)
    return [
        (place[0] + dr, place[1] + dc)
        for dr in span
        for dc in span
        if square_distance(dr, dc) * cell < radius * (1 - 1e-9)
    ]


def _is_hit(known, number, reached, floor, radius) -> bool:
    for there in reached:
        own_floor, own_occupied, _ = known[number].get(there, NOTHING)
        others = [
            cells[there]
            for i, cells in enumerate(known)
            if i != number and there in cells and abs(cells[there][0] - floor) < HEIGHT - STEP
        ]
        if any(occupied for _, occupied, _ in others):
            return True
        own_counts = not others or abs(own_floor - floor) < HEIGHT - STEP
        if own_occupied and own_counts:
            return True
        goes_on = any(abs(other_floor - floor) <= STEP + 1e-5 for other_floor, _, _ in others)
        if radius > BAKED and any(
            _is_in_the_way(cells.get(there, NOTHING)[0] - floor, i == number, goes_on)
            for i, cells in enumerate(known)
        ):
            return True
    return False


def _hangs_over(known, reached, floor) -> bool:
    """Whether the highest floor of a column that is no obstacle is more than a step lower."""
    for there in reached:
        heights = [cells.get(there, NOTHING)[0] for cells in known]
        below = [h for h in heights if h <= floor + STEP + 1e-5]
        if below and max(below) < floor - STEP - 1e-5:
            return True
    return False


def _is_in_the_way(rise: float, is_own: bool, goes_on_below: bool) -> bool:
    if is_own:
        room = HEIGHT + SLAB + STEP + 1e-5 if goes_on_below else math.inf
    else:
        room = HEIGHT + SLAB
    return STEP + 1e-5 < rise < room


def refine(level, radius: float, clearance: float) -> np.ndarray:
    """The original client's weights, in plain words; radius and clearance in metres."""
    cell = level.lattice.cell_size
    occupied, floor = level.occupancy, level.floor_height
    reach = math.ceil((radius + clearance) / cell - 0.5)
    inner, outer = (radius / cell) ** 2, ((radius + clearance) / cell) ** 2
    weights = np.ones(level.shape)
    for row, col in np.ndindex(level.shape):
        if reach == 0:
            weights[row, col] = math.inf if occupied[row, col] else 1
            continue
        rows = range(max(row - reach, 0), min(row + reach, level.height))
        cols = range(max(col - reach, 0), min(col + reach, level.width))
        squares = [((r - row) ** 2 + (c - col) ** 2, r, c) for r in rows for c in cols]
        within = [(r, c) for d, r, c in squares if d < inner]
        if any(occupied[r, c] and d < outer for d, r, c in squares):
            weights[row, col] = 10
        has_floor = [not np.isnan(floor[r, c]) for r, c in within]
        if any(occupied[r, c] for r, c in within):
            weights[row, col] = math.inf
        if within and sum(has_floor) / len(has_floor) < 0.7:
            weights[row, col] = math.inf
    return weights


def enough_floor(level, radius: float) -> np.ndarray:
    """Where at least 0.7 of the cells have a floor, within each distance up to the radius."""
    cell = level.lattice.cell_size
    has_floor = ~np.isnan(level.floor_height)
    enough = np.ones(level.shape, bool)
    for row, col in np.ndindex(level.shape):
        away = np.array(
            [
                (math.hypot(r - row, c - col), has_floor[r, c])
                for r, c in np.ndindex(level.shape)
                if math.hypot(r - row, c - col) * cell < radius * (1 - 1e-9)
            ]
        ).reshape(-1, 2)
        for limit in np.unique(away[:, 0]):
            enough[row, col] &= away[away[:, 0] <= limit, 1].mean() >= 0.7
    return enough
