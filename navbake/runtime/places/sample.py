"""Draws random places where an agent can stand, and poses; see the methods of `PathFinder`."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.places.checks import as_generator, check_distances
from navbake.types import Bool, Float, Int

INSIDE = 1e-6  # of a cell: how far from its edges a point stays
SLACK = 1e-9  # metres


class Pose(NamedTuple):
    """Where an agent stands and looks.

    Attributes:
        position: world x, y and floor z [m], shape (3,), float64.
        heading: 0 along x, counted towards y, -pi to pi [rad].
    """

    position: Float
    heading: float


def draw_places(
    cache: GridCache,
    cells: Int,
    rng: np.random.Generator | None,
    count: int | None,
    anywhere: bool,
    limits: Mapping[str, object],
) -> Float:
    """Draw places in some cells; where there are none, `limits` tell what was asked for."""
    rng = as_generator(rng)
    if count is not None and (not isinstance(count, int | np.integer) or count < 0):
        raise QueryError(f"expected a count >= 0, got {count!r}")
    if not len(cells):
        given = [f"{name} {v}" for name, v in limits.items() if v not in (None, False)]
        asked = f" with {', '.join(given)}" if given else ""
        raise QueryError(f"no free cell in {cache.grid.scene_id!r}{asked}")
    flat, num = cache.flat, 1 if count is None else int(count)
    chosen = cells[draw_cells(flat, cells, rng, num)]
    positions = flat.positions(chosen)
    if anywhere:
        size = flat.layout.cell_size[flat.level_of(chosen)]
        half = 0.5 - INSIDE
        positions[:, :2] += rng.uniform(-half, half, size=(num, 2)) * size[:, None]
    return positions.reshape(3) if count is None else positions


def draw_pose(
    cache: GridCache,
    rng: np.random.Generator | None,
    target: ArrayLike | None,
    distances: tuple[float, float],
    *,
    in_sight: bool,
    same_room: bool,
    level: int | None,
) -> Pose:
    """`PathFinder.random_pose`."""
    from navbake.runtime.kernels.nearest import first_in_sight  # saves numba at start-up

    rng = as_generator(rng)
    if target is None:
        cells = np.flatnonzero(cache.allowed(level=level))
        place = draw_places(cache, cells, rng, None, False, {"level": level})
        return Pose(place, float(rng.uniform(-math.pi, math.pi)))
    cells = cells_near(cache, target, distances, True, level)
    flat, number, (low, high) = cache.flat, cache.rooms.number, distances
    p, home = flat.locate(target, level)
    assert home is not None  # or there were no cells near it
    if same_room:
        cells = cells[(number[cells] == number[home]) & (number[home] > 0)]
    if in_sight:
        # the first that sees the target, in a random order: as if drawn from all that do
        space = flat.sight_through(~cache.occupied)
        found = first_in_sight(space, number, home, p[0], p[1], rng.permutation(cells))
        cells = np.array([found] if found >= 0 else [], dtype=np.int64)
    limits = {"distance [m]": f"{low:g} to {high:g}", "in sight": in_sight}
    place = draw_places(cache, cells, rng, None, False, limits)
    return Pose(place, math.atan2(p[1] - place[1], p[0] - place[0]))


def cells_near(
    cache: GridCache,
    position: ArrayLike,
    distances: tuple[float, float],
    straight: bool,
    level: int | None,
) -> Int:
    """The free cells so far from a position, straight or by the shortest path: flat ids."""
    low, high = distances
    check_distances(low, high)
    flat = cache.flat
    p, home = flat.locate(position, level)
    if home is None:
        where = ", ".join(f"{v:g}" for v in p)
        raise QueryError(f"{where} is in no cell of {cache.grid.scene_id!r}: nothing is near")
    if straight:
        return cells_in_annulus(flat, int(flat.level_of(home)), p, distances, flat.free)
    flat.free_cell_at(p, level)
    field = cache.search.field(np.array([home]), weighted=False)
    near = (field >= low) & (field <= high + SLACK)
    return np.flatnonzero(near & np.isfinite(field))  # inf <= inf: not what no path leads to


def cells_in_annulus(
    flat: FlatGrid, level: int, point: Float, distances: tuple[float, float], allowed: Bool
) -> Int:
    """The allowed cells of a level whose centres are so far from a point on the map.

    Distances are the smallest and the largest [m], both included; flat ids ascend.
    """
    layout = flat.layout
    size, width = float(layout.cell_size[level]), int(layout.width[level])
    row = (layout.y_max[level] - point[1]) / size - 0.5
    col = (point[0] - layout.x_min[level]) / size - 0.5
    reach = distances[1] / size
    rows = _near(row, reach, int(layout.height[level]))
    cols = _near(col, reach, width)
    squared = ((rows - row)[:, None] ** 2 + (cols - col) ** 2) * size**2
    low, high = max(distances[0] - SLACK, 0.0), distances[1] + SLACK
    near = (squared >= low**2) & (squared <= high**2)
    cells = (int(layout.start[level]) + rows[:, None] * width + cols)[near]
    found: Int = cells[allowed[cells]].astype(np.int64)
    return found


def draw_cells(flat: FlatGrid, cells: Int, rng: np.random.Generator, count: int) -> Int:
    """Draw indices into some cells, each cell as likely as its area has it."""
    sizes = flat.layout.cell_size
    if len(set(sizes)) == 1:
        return rng.integers(len(cells), size=count)
    # cells of different areas: a point on their areas in a row falls into one of them
    edges = np.cumsum(sizes[flat.level_of(cells)] ** 2)
    found = np.searchsorted(edges, rng.uniform(0.0, edges[-1], size=count), side="right")
    return np.minimum(found, len(cells) - 1)


def _near(at: float, reach: float, count: int) -> Int:
    """The numbers from 0 to count - 1 that are at most `reach` away from `at`."""
    first = math.ceil(min(max(at - reach, 0.0), count))
    return np.arange(first, math.floor(max(min(at + reach, count - 1), -1.0)) + 1)
