"""Places agents at random with a minimum distance, and bounds how many fit.

Poisson-disc sampling by dart throwing (Cook 1986), on the cells that are still free of the agents
before. A crowd that jams is drawn again, and at last packed row by row. Two agents clash if their
centres are less than `reach` [m] apart on the map and their floors less than `height` [m].
"""

import math

import numpy as np
from numpy.random import Generator

from navbake.errors import QueryError
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.places import cells_in_annulus
from navbake.types import Bool, Int

TRIES = 8  # random crowds before one is packed
DARTS = 32  # cells drawn at once
SHIFTS = 3  # of the honeycomb, along each axis
REMEDY = "expected fewer agents, or a smaller min_distance or clearance"


def place_crowd(
    flat: FlatGrid,
    parts: list[Int],
    n: int,
    apart: tuple[float, float],
    rng: Generator,
    words: tuple[str, str],
) -> Int:
    """Draw a cell for each of n agents: flat ids in random order; QueryError if they don't fit.

    Each part, an array of flat ids, gets n / len(parts) agents, rounded; agents that don't fit go
    to other parts. `apart` is (`reach`, `height`); `words` name the agents and the area in errors.
    """
    agents, where = f"{'1 agent' if n == 1 else f'{n} agents'} {words[0]}", words[1]
    found = most = 0
    for attempt in range(TRIES):
        # the part of each agent
        whole = np.tile(np.arange(len(parts)), n // len(parts))
        rest = rng.permutation(len(parts))[: n % len(parts)]
        owner = rng.permutation(np.concatenate([whole, rest]))
        chosen = _draw_crowd(flat, parts, apart, owner, rng)
        found = max(found, len(chosen))
        if found == n:
            return chosen
        if attempt == 0:
            most = most_that_fit(flat, np.concatenate(parts), apart)
            if most < n:
                raise QueryError(f"{agents}: at most {most} fit {where}; {REMEDY}")
    packed = _pack_crowd(flat, np.concatenate(parts), apart, n, rng)
    if len(packed) == n:
        return rng.permutation(packed)
    known = f"places for {max(found, len(packed))} were found {where}"
    raise QueryError(f"{agents}: {known}, and more than {most} never fit; {REMEDY}")


def most_that_fit(flat: FlatGrid, cells: Int, apart: tuple[float, float]) -> int:
    """An upper bound of the number of agents that fit on some cells.

    In a honeycomb whose hexagons are `reach` wide, each hexagon holds one agent. The bound is the
    least number of hexagons with cells over several shifted honeycombs.
    """
    reach, height = apart[0] * (1.0 - 1e-6), apart[1]
    if reach <= 0.0 or not len(cells):
        return len(cells)
    p = flat.positions(cells)
    p -= p.min(axis=0)
    layer = np.floor(p[:, 2] / height) if height > 0 else np.zeros(len(cells))
    most = len(cells)
    for x, y in ((p[:, 0], p[:, 1]), (p[:, 1], p[:, 0])):
        for shift in np.ndindex(SHIFTS, SHIFTS):
            offset = np.array(shift) * reach / SHIFTS
            # axial coordinates of hexagons whose corners are half of `reach` from their middles,
            # rounded so that q + r + s is 0 again: the one with the largest error gives way
            u, v = (x + offset[0]) / (reach / 2), (y + offset[1]) / (reach / 2)
            exact = np.stack([math.sqrt(3.0) / 3.0 * u - v / 3.0, 2.0 / 3.0 * v])
            exact = np.vstack([exact, -exact.sum(axis=0)])
            near = np.round(exact)
            worst = np.argmax(np.abs(near - exact), axis=0), np.arange(len(cells))
            near[worst] -= near.sum(axis=0)
            q, r = near[:2] - near[:2].min(axis=1, keepdims=True)
            numbers = q + (q.max() + 1) * (r + (r.max() + 1) * layer)
            most = min(most, len(np.unique(numbers)))
    return most


def _take(flat: FlatGrid, apart: tuple[float, float], taken: Bool, cell: int) -> None:
    """Mark the cells that are too near to a cell as taken."""
    (reach, height), here = apart, flat.positions(cell)
    for level in range(flat.num_levels):
        near = cells_in_annulus(flat, level, here, (0.0, reach), flat.free)
        if flat.num_levels > 1 or reach > height:
            rise = np.abs(flat.positions(near)[:, 2] - here[2])
            near = near[rise < height]
        taken[near] = True
    taken[cell] = True


def _draw_crowd(
    flat: FlatGrid, parts: list[Int], apart: tuple[float, float], owner: Int, rng: Generator
) -> Int:
    """Draw a cell for each agent from its part, else from another; stops early if none is left."""
    left, chosen = list(parts), np.empty(len(owner), dtype=np.int64)
    taken = np.zeros(flat.num_cells, dtype=np.bool_)

    def throw(cells: Int) -> Int:
        darts = cells[draw_cells(flat, cells, rng, DARTS)] if len(cells) else cells
        return darts[~taken[darts]]

    for k, own in enumerate(owner.tolist()):
        for part in (own, *rng.permutation(len(parts)).tolist()):
            hits = throw(left[part])
            while not len(hits) and len(left[part]):
                left[part] = left[part][~taken[left[part]]]
                hits = throw(left[part])
            if len(hits):
                break
        else:
            return chosen[:k]
        chosen[k] = hits[0]
        _take(flat, apart, taken, int(hits[0]))
    return chosen


def _pack_crowd(
    flat: FlatGrid, cells: Int, apart: tuple[float, float], n: int, rng: Generator
) -> Int:
    """Place up to n agents row by row from a random side, each in the first cell left."""
    swap, signs = rng.integers(2), rng.choice([-1.0, 1.0], size=2)
    p = flat.positions(cells)[:, :2] * signs
    taken = np.zeros(flat.num_cells, dtype=np.bool_)
    chosen: list[int] = []
    for cell in cells[np.lexsort((p[:, swap], p[:, 1 - swap]))].tolist():
        if len(chosen) < n and not taken[cell]:
            chosen.append(cell)
            _take(flat, apart, taken, cell)
    return np.array(chosen, dtype=np.int64)


def draw_cells(flat: FlatGrid, cells: Int, rng: Generator, count: int) -> Int:
    """Draw indices into cells, with probability in proportion to the cells' areas."""
    sizes = flat.layout.cell_size
    if len(set(sizes)) == 1:
        return rng.integers(len(cells), size=count)
    # cells of different areas: search a random number in the cumulative area
    edges = np.cumsum(sizes[flat.level_of(cells)] ** 2)
    found = np.searchsorted(edges, rng.uniform(0.0, edges[-1], size=count), side="right")
    return np.minimum(found, len(cells) - 1)


def parts_of_area(flat: FlatGrid, cells: Int, n: int, start: float) -> list[Int]:
    """Cut cells, ordered by `along_hilbert`, into n parts of equal area; some may be empty.

    The first part begins at the share `start` of the whole area.
    Source: He and Owen, "Extensible grids: uniform sampling on a space filling curve" (2016).
    """
    ends = np.cumsum(flat.layout.cell_size[flat.level_of(cells)] ** 2)
    # a cell belongs to the part that contains its middle
    middle = (ends - np.diff(ends, prepend=0.0) / 2) / ends[-1]
    part = np.floor(((middle - start) % 1.0) * n).astype(np.int64)
    order = np.argsort(part, kind="stable")
    return np.split(cells[order], np.searchsorted(part[order], np.arange(1, n)))


def along_hilbert(flat: FlatGrid, cells: Int) -> Int:
    """Sort cells by level and along the curve of Hilbert (1891)."""
    level, row, col = flat.split(cells)
    x, y, index = col, row, np.zeros_like(row)
    side = 1 << max(int(max(row.max(initial=0), col.max(initial=0))).bit_length() - 1, 0)
    while side:
        right, lower = (x & side > 0).astype(np.int64), (y & side > 0).astype(np.int64)
        index += side * side * ((3 * right) ^ lower)
        # each quarter holds the curve of half the size, turned or mirrored to fit
        mirrored = (lower == 0) & (right == 1)
        x, y = np.where(mirrored, side - 1 - x, x), np.where(mirrored, side - 1 - y, y)
        x, y = np.where(lower == 0, y, x), np.where(lower == 0, x, y)
        x, y = x & (side - 1), y & (side - 1)
        side >>= 1
    return cells[np.lexsort((index, level))]
