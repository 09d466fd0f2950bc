"""What an inflation closes: steps between levels, links and doors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.lazy import lazy
from navbake.navgrid.doors import Door
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.search import Search
from navbake.types import Bool, Int

ndimage = lazy("scipy.ndimage")  # saves scipy at start-up

RISE = 0.05  # metres: ways that rise by more are called stairs
LEAST_AREA = 0.5  # m² on both levels: what steps that stay free have to lead to


class Cut(NamedTuple):
    """A way that is closed for a larger agent."""

    name: str  #: As in ``the stairs between level 0 and 1 near (4.2, 1.8)``, ``door 'hall'``.
    cells: Int  #: Flat ids of the cells on it.


def find_cuts(before: Search, after: Search) -> list[Cut]:
    """Find the steps between levels, the links and the doors that only one of two grids has open.

    Steps side by side are one way. They are closed where no free step is left, or where the free
    ones lead to less than 0.5 m² on one of the levels, as a landing between blocked treads. A door
    is closed where none of its leaf's cells is free, a link where it is too narrow, or where fewer
    than two of its stops are. Both searches are on the same cells.
    """
    flat, found = before.flat, list[Cut]()
    for low, high, what, ends in group_steps(before):
        was_open, is_open = (_lead_on(search, ends) for search in (before, after))
        if was_open.any() and not is_open.any():
            x, y, _ = flat.positions(ends).mean(axis=(0, 1))
            name = f"the {what} between level {low} and {high} near ({x:.2f}, {y:.2f})"
            found.append(Cut(name, ends.ravel()))
    for link in before.grid.links:
        cells = np.array([flat.layout.start[stop.level] + stop.cell for stop in link.stops])
        was_fit, is_fit = (
            search.flat.free[cells].sum() > 1 and link.fits(search.radius)
            for search in (before, after)
        )
        if was_fit and not is_fit:
            found.append(Cut(f"the link {link.name!r} ({link.kind})", cells))
    for door in before.grid.doors:
        cells = find_leaf(door, flat)
        cells = cells[flat.free[cells]]
        if len(cells) and not after.flat.free[cells].any():
            found.append(Cut(f"door {door.id!r}", cells))
    return found


class StepGroup(NamedTuple):
    """Steps side by side between two levels: stairs, or a ramp."""

    low: int  #: The lower level.
    high: int
    what: str  #: ``stairs`` or ``ramp``.
    ends: Int  #: Flat ids of the cells of each step, the lower level's first, shape (n, 2).


def group_steps(search: Search) -> list[StepGroup]:
    """Group the steps between levels whose cells touch on the lower level."""
    flat, steps, found = search.flat, search.grid.step_array, []
    steps = np.where((steps[:, 0] <= steps[:, 2])[:, None], steps, steps[:, [2, 3, 0, 1]])
    steps = steps[steps[:, 0] < steps[:, 2]]
    ends = flat.layout.start[steps[:, ::2]] + steps[:, 1::2]
    for low, high in np.unique(steps[:, ::2], axis=0).tolist():
        own = ends[(steps[:, 0] == low) & (steps[:, 2] == high)]
        _, row, col = flat.split(own[:, 0])
        marks = np.zeros(search.grid.levels[low].shape, dtype=np.bool_)
        marks[row, col] = True
        group = ndimage.label(marks, structure=np.ones((3, 3)))[0][row, col]
        for one in np.unique(group).tolist():
            cells = own[group == one]
            rise = np.abs(np.diff(flat.positions(cells)[..., 2], axis=1)).max()
            found.append(StepGroup(low, high, "stairs" if rise > RISE else "ramp", cells))
    return found


def _lead_on(search: Search, ends: Int) -> Bool:
    """Whether each step, by flat ids of its ends, is free and leads to enough of both levels."""
    flat, islands = search.flat, search.islands
    size = flat.layout.cell_size[flat.level_of(ends)] ** 2
    count = np.zeros(ends.shape, dtype=np.int64)
    for number in range(flat.num_levels):
        of_level = np.bincount(islands.number[flat.cells_of(number)], minlength=islands.count + 1)
        is_on = flat.level_of(ends) == number
        count[is_on] = of_level[islands.number[ends[is_on]]]
    leads: Bool = np.all(flat.free[ends] & (count * size >= LEAST_AREA), axis=1)
    return leads


def find_leaf(door: Door, flat: FlatGrid) -> Int:
    """The flat ids of the cells that a door's leaf takes when closed."""
    cells = door.solid_in if door.solid else door.cells_in
    pairs = zip(flat.layout.start, cells("closed", flat.num_levels), strict=False)
    return np.concatenate([start + ids for start, ids in pairs])
