"""Places agents at random, none too near to another, and says how many can fit at most.

Agents are placed one after the other, each uniformly on what the others before it leave free:
random sequential adsorption, which is Poisson-disc sampling by dart throwing (Cook 1986) without
the darts that miss. Such a crowd jams before it is as dense as can be. Where it does, it is drawn
again, and at last packed in order, row by row.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.errors import QueryError
from navbake.runtime.draws import draw_cells
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.places import SLACK, cells_in_annulus
from navbake.types import Bool, Float, Int

TRIES = 8  # random crowds that are drawn before one is packed
DARTS = 32  # cells that are drawn at once
MISSES = 2  # rounds of darts after which cells that are taken are sorted out
CHUNK = 4096  # cells of a row that are looked at once
SHIFTS = 3  # of the honeycomb, along each axis
REMEDY = "expected fewer agents, or a smaller min_distance or clearance"


class Spacing(NamedTuple):
    """How near two agents may be.

    Attributes:
        radius: of an agent [m]: discs of this radius do not touch.
        min_distance: between their centres on the map [m].
        height: agents on floors that are so far apart [m] don't meet.
    """

    radius: float
    min_distance: float
    height: float

    @property
    def reach(self) -> float:
        """Centres clash up to this distance [m], slack for rounding aside."""
        return max(2.0 * self.radius, self.min_distance - 2.0 * SLACK, 0.0)

    def __str__(self) -> str:
        if self.min_distance > 2.0 * self.radius:
            return f"{self.min_distance:g} m apart"
        return f"of radius {self.radius:g} m"


def place_crowd(
    flat: FlatGrid, parts: list[Int], n: int, spacing: Spacing, rng: np.random.Generator, where: str
) -> Int:
    """Draw the cells of n agents: as many from each part, give or take one, as far as they fit.

    What doesn't fit into a part is drawn from the others.

    Args:
        parts: flat ids of their cells.
        where: what a message calls all of them.

    Returns:
        Flat ids, shape (n,), in random order.

    Raises:
        QueryError: they don't fit: at once where that can be proved, else after `TRIES` and one
            packing.
    """
    found = 0
    for attempt in range(TRIES):
        chosen = _draw_crowd(_Crowd(flat, spacing), parts, share_out(n, len(parts), rng), rng)
        found = max(found, len(chosen))
        if found == n:
            return chosen
        if attempt == 0:
            most = most_that_fit(flat, np.concatenate(parts), spacing)
            if most < n:
                raise QueryError(f"{_count(n)} {spacing}: at most {most} fit {where}; {REMEDY}")
    packed = _pack_crowd(_Crowd(flat, spacing), np.concatenate(parts), n, rng)
    if len(packed) == n:
        return rng.permutation(packed)
    raise QueryError(
        f"{_count(n)} {spacing}: places for {max(found, len(packed))} were found {where}, and "
        f"more than {most} never fit; {REMEDY}"
    )


def most_that_fit(flat: FlatGrid, cells: Int, spacing: Spacing) -> int:
    """A number of agents that some cells can't hold more than, though perhaps less.

    A honeycomb whose hexagons are as wide as agents are apart holds one agent in each: as many
    as hexagons have a cell. Of several honeycombs the one with the fewest counts.
    """
    reach = spacing.reach * (1.0 - 1e-6)
    if reach <= 0.0 or not len(cells):
        return len(cells)
    p = flat.positions(cells)
    p -= p.min(axis=0)
    layer = np.floor(p[:, 2] / spacing.height).astype(np.int64) if spacing.height > 0 else 0
    most = len(cells)
    for x, y in ((p[:, 0], p[:, 1]), (p[:, 1], p[:, 0])):
        for shift in np.ndindex(SHIFTS, SHIFTS):
            offset = np.array(shift) * reach / SHIFTS
            q, r = _hexagon_of(x + offset[0], y + offset[1], reach / 2)
            q, r = q - q.min(), r - r.min()
            numbers = q + (q.max() + 1) * (r + (r.max() + 1) * layer)
            most = min(most, len(np.unique(numbers)))
    return most


def share_out(n: int, num_parts: int, rng: np.random.Generator) -> Int:
    """The part of each of n agents: as many in each, give or take one, in random order."""
    whole = np.tile(np.arange(num_parts), n // num_parts)
    rest = rng.permutation(num_parts)[: n % num_parts]
    return rng.permutation(np.concatenate([whole, rest]))


class _Crowd:
    """The cells that the agents so far leave to others."""

    def __init__(self, flat: FlatGrid, spacing: Spacing) -> None:
        self.flat, self.spacing = flat, spacing
        self.taken: Bool = np.zeros(flat.num_cells, dtype=np.bool_)

    def add(self, cell: int) -> None:
        """Take what is too near to a cell."""
        flat, spacing = self.flat, self.spacing
        here = flat.positions(cell)
        for level in range(flat.num_levels):
            near = cells_in_annulus(flat, level, here, (0.0, spacing.reach), flat.free)
            if flat.num_levels > 1 or spacing.reach > spacing.height:
                rise = np.abs(flat.positions(near)[:, 2] - here[2])
                near = near[rise < spacing.height]
            self.taken[near] = True
        self.taken[cell] = True


def _draw_crowd(crowd: _Crowd, parts: list[Int], owner: Int, rng: np.random.Generator) -> Int:
    """Draw a cell for each agent from its part, or another one; fewer where none is left."""
    left, chosen = list(parts), np.empty(len(owner), dtype=np.int64)
    full = np.zeros(len(parts), dtype=np.bool_)
    for k, part in enumerate(owner.tolist()):
        cell = -1
        while cell < 0:
            if full[part]:
                others = np.flatnonzero(~full)
                if not len(others):
                    return chosen[:k]
                part = int(others[rng.integers(len(others))])
            cell, left[part] = _draw_open(crowd, left[part], rng)
            full[part] = cell < 0
        chosen[k] = cell
        crowd.add(cell)
    return chosen


def _draw_open(crowd: _Crowd, cells: Int, rng: np.random.Generator) -> tuple[int, Int]:
    """Draw a cell that isn't taken, -1 for none; and the cells without some that are taken."""
    for _ in range(MISSES if len(cells) else 0):
        darts = cells[draw_cells(crowd.flat, cells, rng, DARTS)]
        hits = ~crowd.taken[darts]
        if hits.any():
            return int(darts[int(np.argmax(hits))]), cells
    cells = cells[~crowd.taken[cells]]
    if not len(cells):
        return -1, cells
    return int(cells[draw_cells(crowd.flat, cells, rng, 1)[0]]), cells


def _pack_crowd(crowd: _Crowd, cells: Int, n: int, rng: np.random.Generator) -> Int:
    """Place up to n agents as near to one another as may be: line by line, from a random side.

    The next agent takes the first cell that is left. In the open that makes a honeycomb, the
    densest of all crowds.
    """
    swap, signs = rng.integers(2), rng.choice([-1.0, 1.0], size=2)
    p = crowd.flat.positions(cells)[:, :2] * signs
    cells = cells[np.lexsort((p[:, swap], p[:, 1 - swap]))]
    chosen: list[int] = []
    first = 0
    while len(chosen) < n and first < len(cells):
        is_open = ~crowd.taken[cells[first : first + CHUNK]]
        if not is_open.any():
            first += CHUNK
            continue
        first += int(np.argmax(is_open))
        chosen.append(int(cells[first]))
        crowd.add(chosen[-1])
    return np.array(chosen, dtype=np.int64)


def _count(n: int) -> str:
    return "1 agent" if n == 1 else f"{n} agents"


def _hexagon_of(x: Float, y: Float, radius: float) -> tuple[Int, Int]:
    """The hexagon of a honeycomb that each point is in; corners are `radius` from the middle.

    Axial coordinates, rounded so that the three of them, q + r + s = 0, still sum to nothing: the
    largest error gives way.
    """
    q = (math.sqrt(3.0) / 3.0 * x - y / 3.0) / radius
    r = (2.0 / 3.0 * y) / radius
    near = np.round(np.stack([q, r, -q - r]))
    error = np.abs(near - np.stack([q, r, -q - r]))
    worst = np.argmax(error, axis=0)
    near[0] = np.where(worst == 0, -near[1] - near[2], near[0])
    near[1] = np.where(worst == 1, -near[0] - near[2], near[1])
    return near[0].astype(np.int64), near[1].astype(np.int64)
