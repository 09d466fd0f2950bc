"""The positions of a square lattice that steps lead to, as users of AI2-THOR know them."""

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.inflation.margins import agent_radius
from navbake.runtime.many import ManyPlaces
from navbake.runtime.places.checks import REAL
from navbake.types import Bool, Float, Int

STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
NEAR = 1e-4  # of a cell: how far from where it should be a step may end
TOUCH = 1e-9  # share of a radius by which a disc may be over what it touches


def find_reachable(
    cache: GridCache, many: ManyPlaces, start: ArrayLike, spacing: float, level: int | None
) -> Float:
    """`PathFinder.reachable_positions`."""
    flat = cache.flat
    cell = float(flat.layout.cell_size.max())
    if not isinstance(spacing, REAL) or not cell * (1 - NEAR) <= spacing < np.inf:
        raise QueryError(f"expected a spacing of a cell's {cell:g} m or more, got {spacing!r}")
    p, home = flat.free_cell_at(start, level)
    first = np.append(p[:2], flat.positions(home)[2])
    seen = _Seen(cache, first[:2], float(spacing))
    places, at = first[None], np.zeros((1, 2), dtype=np.int64)
    seen.add(at, flat.level_of(np.array([home])))
    found = [places]
    while len(places):
        at = (at[:, None] + STEPS).reshape(-1, 2)
        wanted = first[:2] + at * spacing
        ends = many.try_step(np.repeat(places, len(STEPS), axis=0), wanted, slide=False)
        arrived = (np.abs(ends[:, :2] - wanted) <= NEAR * cell).all(axis=1)
        at, places = at[arrived], ends[arrived]
        cells = flat.cells_at(places)
        new = seen.add(at, flat.level_of(cells))
        at, places = at[new], places[new]
        stands = _stands(cache, many, cells[new], places)
        at, places = at[stands], places[stands]
        found.append(places)
    return np.concatenate(found)


class _Seen:
    """The points of the lattice that steps have led to, on each level."""

    def __init__(self, cache: GridCache, origin: Float, spacing: float) -> None:
        layout = cache.flat.layout
        x1 = layout.x_min + layout.width * layout.cell_size
        y0 = layout.y_max - layout.height * layout.cell_size
        low = np.array([layout.x_min.min(), y0.min()])
        high = np.array([x1.max(), layout.y_max.max()])
        self._first = np.floor((low - origin) / spacing).astype(np.int64) - 1
        size = np.ceil((high - origin) / spacing).astype(np.int64) + 2 - self._first
        self._seen = np.zeros((cache.flat.num_levels, *size), dtype=np.bool_)

    def add(self, at: Int, levels: Int) -> Int:
        """Note points on levels; the indices of those that are new, each once."""
        places = np.ravel_multi_index((levels, *(at - self._first).T), self._seen.shape)
        _, once = np.unique(places, return_index=True)
        once = np.sort(once)
        new = once[~self._seen.ravel()[places[once]]]
        self._seen.ravel()[places[new]] = True
        return new


def _stands(cache: GridCache, many: ManyPlaces, cells: Int, places: Float) -> Bool:
    """Whether an agent's disc meets nothing at places in free cells.

    At a free cell's centre it does not; beside the centre, obstacles are measured.
    """
    flat, radius = cache.flat, agent_radius(cache.grid)
    off = np.abs(places - flat.positions(cells))[:, :2].max(axis=1)
    is_center = off <= NEAR * flat.layout.cell_size[flat.level_of(cells)]
    clear = many.clearance(places, max_distance=2.0 * radius + 1.0) >= radius * (1.0 - TOUCH)
    return np.asarray(is_center | clear)
