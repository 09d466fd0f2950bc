"""Checks of single layers: all free, all blocked, weights, inflation, stored layers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from navbake.auditor.facts import Facts
from navbake.auditor.report import ERROR, REMARK, Remark, remark_on_cells
from navbake.navgrid.grid_base import GridBase
from navbake.types import Bool, Int32

MANY = 100  # cells that a grid has at least, if it is to say something that all are free
FEW = 0.01  # share of a level's cells under which hardly any are free
LARGE = 1e-3  # metres that a clearance may be off


def check_all_free(facts: Facts) -> Iterator[Remark]:
    """All cells are free: nothing stands there, not even a wall."""
    total = sum(free.size for free in facts.free)
    if total >= MANY and all(free.all() for free in facts.free):
        text = f"all {total} cells are free: nothing stands on the floor, and it ends nowhere"
        yield Remark("all free", REMARK, None, None, text)


def check_empty_levels(facts: Facts) -> Iterator[Remark]:
    """A level has no floor, or nowhere to stand; or so has the whole grid.

    An inflation may close a level, where the agent is too large for it.
    """
    reach = facts.inflation.reach
    severity = ERROR if reach is None else REMARK
    inflated = "" if reach is None else f", inflated by {reach:g} m"
    if not any(free.any() for free in facts.free):
        yield Remark(
            "all blocked", severity, None, None, f"no cell is free, on any level{inflated}"
        )
        return
    for number, (free, floor) in enumerate(zip(facts.free, facts.floors, strict=True)):
        if free.any():
            continue
        has_floor = np.count_nonzero(~np.isnan(floor))
        text = f"none of its {has_floor} cells with a floor is free{inflated}"
        if has_floor:
            yield Remark("empty level", severity, number, None, text)
        else:
            yield Remark("empty level", ERROR, number, None, "no floor")


def check_free_share(facts: Facts) -> Iterator[Remark]:
    """Hardly any cell is free: a map that is black but for a few specks."""
    for number, (free, floor) in enumerate(zip(facts.free, facts.floors, strict=True)):
        num_free = int(np.count_nonzero(free))
        num_floor = int(np.count_nonzero(free | ~np.isnan(floor)))
        total = num_floor if facts.levels[number].uses_cell_floors else free.size
        if total >= MANY and 0 < num_free < FEW * total:
            text = f"only {num_free} of {total} cells are free"
            yield Remark("hardly free", REMARK, number, facts.first(number, free), text)


def check_weights(facts: Facts) -> Iterator[Remark]:
    """Weights and occupancy contradict each other, or a weight is none."""
    reach = facts.inflation.reach
    for number, level in enumerate(facts.levels):
        weights, occupied = level.weights, level.occupancy != 0
        free, own = facts.free[number], "occupancy" in level.attributes
        broken = np.isnan(weights) | (weights < 0)
        yield from remark_on_cells(facts, "weights", number, broken, "a weight that is no cost")
        if not own:
            continue
        is_opened = level.solid == 0 if reach is not None else np.zeros_like(occupied)
        on_occupied = free & occupied & ~is_opened
        text = "free by weight, but occupied"
        yield from remark_on_cells(facts, "weights", number, on_occupied, text)
        blocked = ~free & ~broken & ~occupied
        text = "blocked by weight, but not occupied"
        if reach is not None and blocked.any():
            blocked &= ~find_reasons(facts.grid, number, reach)
            text += f", and nothing that an inflation avoids is within {reach:g} m"
        yield from remark_on_cells(facts, "weights", number, blocked, text)


def check_inflation(facts: Facts) -> Iterator[Remark]:
    """The metadata don't tell for which radius a grid was inflated."""
    broken = facts.inflation.broken
    if broken is not None:
        # in files of other programs it may mean anything
        severity = ERROR if facts.grid.navbake else REMARK
        yield Remark("inflation", severity, None, None, broken)


def check_layers(facts: Facts) -> Iterator[Remark]:
    """Stored layers contradict what they follow from: islands and clearance."""
    if not facts.grid.navbake:
        return  # in files of other programs they may be anything
    for number, level in enumerate(facts.levels):
        stored = level.attributes.get("island")
        if stored is not None:
            wrong = _otherwise_parted(stored, facts.islands[number])
            text = "a number in the layer `island` that isn't what is connected"
            yield from remark_on_cells(facts, "layers", number, wrong, text)
        stored = level.attributes.get("clearance")
        if stored is not None:
            cell = level.lattice.cell_size
            open_ = np.pad(level.free_for_point, 1)
            away = (distance_transform_edt(open_)[1:-1, 1:-1] - 0.5) * cell
            away = np.where(level.free, away, 0.0)
            wrong = np.abs(stored * level.unit - away) > LARGE
            yield from remark_on_cells(facts, "layers", number, wrong, "a wrong `clearance`")


def _otherwise_parted(stored: NDArray[Any], own: Int32) -> Bool:
    """The cells by which two arrays of numbers part a level differently.

    A part of one is the part of the other that most of its cells are in, where that holds the other
    way round, too.
    """
    pairs, pair, count = np.unique(
        np.stack([stored.ravel(), own.ravel()]), axis=1, return_inverse=True, return_counts=True
    )
    order = np.argsort(-count, kind="stable")
    is_first = [np.zeros(len(count), dtype=np.bool_) for _ in pairs]
    for side, first in zip(pairs, is_first, strict=True):
        first[order[np.unique(side[order], return_index=True)[1]]] = True
    is_same = is_first[0] & is_first[1]
    return ~is_same[pair].reshape(own.shape)


def find_reasons(grid: GridBase, number: int, reach: float) -> Bool:
    """The cells of a level that have something within reach [m] for which they may be closed.

    That is a cell that is occupied or has no floor, a floor more than a step higher or lower, a
    floor of another level less than the agent's height away, or the edge of the level. They are
    looked for in a square, so that more cells have a reason than an inflation closes, never less.
    """
    level = grid.levels[number]
    cells = min(math.ceil(reach / level.lattice.cell_size) + 1, max(level.shape))
    floor, size = level.floor, 2 * cells + 1
    blocks = (level.occupancy != 0) | np.isnan(floor) | _near_levels(grid, number)
    found: Bool = maximum_filter(blocks, size, mode="constant", cval=True)
    high = maximum_filter(np.where(np.isnan(floor), -np.inf, floor), size)
    low = minimum_filter(np.where(np.isnan(floor), np.inf, floor), size)
    with np.errstate(invalid="ignore"):  # where there is no floor
        found |= (high - floor > grid.max_step) | (floor - low > grid.max_step)
    return found


def _near_levels(grid: GridBase, number: int) -> Bool:
    """The cells of a level where another one has a floor less than the agent's height away."""
    level = grid.levels[number]
    near, own = np.zeros(level.shape, dtype=np.bool_), level.floor
    known = own[~np.isnan(own)]
    for other in grid.levels:
        if other is level or not len(known):
            continue
        floor, body = other.floor, grid.agent_height
        at = np.argwhere((floor > known.min() - body) & (floor < known.max() + body))
        rows, cols = level.lattice.rows_cols(other.lattice.positions(at[:, 0], at[:, 1]))
        inside = (rows >= 0) & (cols >= 0) & (rows < level.height) & (cols < level.width)
        near[rows[inside], cols[inside]] = True
    return near
