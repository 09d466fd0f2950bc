"""Checks of single layers: all free, all blocked, weights, floors, stored layers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from navbake.auditor.facts import SLACK, Facts
from navbake.auditor.report import ERROR, REMARK, Remark
from navbake.types import Bool

MANY = 100  # cells that a grid has at least, if it is to say something that all are free
FARTHEST = 10_000.0  # floors beyond are a wrong unit [m]
LARGE = 1e-3  # metres that a clearance may be off


def check_all_free(facts: Facts) -> Iterator[Remark]:
    """All cells are free: nothing stands there, not even a wall."""
    total = sum(free.size for free in facts.free)
    if total >= MANY and all(free.all() for free in facts.free):
        text = f"all {total} cells are free: nothing stands on the floor, and it ends nowhere"
        yield Remark("all free", REMARK, None, None, text)


def check_empty_levels(facts: Facts) -> Iterator[Remark]:
    """A level has no floor, or nowhere to stand; or so has the whole grid."""
    if not any(free.any() for free in facts.free):
        yield Remark("all blocked", ERROR, None, None, "no cell is free, on any level")
        return
    for number, (free, floor) in enumerate(zip(facts.free, facts.floors, strict=True)):
        if free.any():
            continue
        has_floor = np.count_nonzero(~np.isnan(floor))
        text = f"none of its {has_floor} cells with a floor is free" if has_floor else "no floor"
        yield Remark("empty level", ERROR, number, None, text)


def check_weights(facts: Facts) -> Iterator[Remark]:
    """Weights and occupancy contradict each other, or a weight is none."""
    is_inflated = "inflation" in facts.grid.metadata
    for number, level in enumerate(facts.levels):
        weights, occupied = level.weights, level.occupancy != 0
        free, own = facts.free[number], "occupancy" in level.attributes
        opened = occupied & (level.solid == 0) if is_inflated else np.zeros_like(occupied)
        broken = np.isnan(weights) | (weights < 0)
        yield from _cells(facts, "weights", number, broken, "a weight that is no cost")
        on_occupied = free & occupied & ~opened
        if own:
            text = "free by weight, but occupied"
            yield from _cells(facts, "weights", number, on_occupied, text)
            if not is_inflated:
                text = "blocked by weight, but not occupied"
                blocked = ~free & ~broken & ~occupied
                yield from _cells(facts, "weights", number, blocked, text)


def check_floors(facts: Facts) -> Iterator[Remark]:
    """Free cells have no floor, or one that is absurdly high or low."""
    for number, level in enumerate(facts.levels):
        floor, free = facts.floors[number], facts.free[number]
        if not level.uses_cell_floors:
            continue
        yield from _cells(facts, "floors", number, free & np.isnan(floor), "free without a floor")
        far = np.abs(np.where(np.isnan(floor), 0.0, floor)) > FARTHEST
        yield from _cells(facts, "floors", number, far, f"farther than {FARTHEST:g} m from 0")


def check_jumps(facts: Facts) -> Iterator[Remark]:
    """The floor of a free cell is a spike or a pit: all round it, the floor is even."""
    for number, free in enumerate(facts.free):
        floor = np.where(free, facts.floors[number], np.nan)
        wide = np.pad(floor, 1, constant_values=np.nan)
        around = np.stack([wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]])
        known = (~np.isnan(around)).sum(axis=0)
        low = np.where(np.isnan(around), np.inf, around).min(axis=0)
        high = np.where(np.isnan(around), -np.inf, around).max(axis=0)
        with np.errstate(invalid="ignore"):
            off = np.maximum(floor - high, low - floor)
            jumps = free & (known >= 3) & (high - low <= facts.step + SLACK)
            jumps &= off > facts.step + SLACK
        jumps.ravel()[_linked(facts, number)] = False
        for row, col in np.argwhere(jumps)[:5].tolist():
            text = f"the floor of one free cell jumps by {off[row, col]:.2f} m against all round it"
            yield Remark("jumps", ERROR, number, facts.place(number, row, col), text)


def check_layers(facts: Facts) -> Iterator[Remark]:
    """Stored layers contradict what they follow from: islands and clearance."""
    if not facts.grid.navbake:
        return  # in files of other programs they may be anything
    for number, level in enumerate(facts.levels):
        stored = level.attributes.get("island")
        if stored is not None and not _same_parts(stored, facts.islands[number]):
            text = "the layer `island` isn't what is connected"
            yield Remark("layers", ERROR, number, None, text)
        stored = level.attributes.get("clearance")
        if stored is not None:
            cell = level.lattice.cell_size
            open_ = np.pad(level.free_for_point, 1)
            away = (distance_transform_edt(open_)[1:-1, 1:-1] - 0.5) * cell
            away = np.where(level.free, away, 0.0)
            wrong = np.abs(stored * level.unit - away) > LARGE
            yield from _cells(facts, "layers", number, wrong, "a wrong `clearance`")


def _same_parts(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two arrays of numbers part the cells in the same way."""
    pairs = np.unique(np.stack([one.ravel(), other.ravel()]), axis=1)
    return all(len(np.unique(side)) == pairs.shape[1] for side in pairs)


def _linked(facts: Facts, number: int) -> list[int]:
    """The cells of a level that a link leads from."""
    links = facts.links
    found = [links[links[:, k] == number, k + 1] for k in (0, 2)]
    return [int(cell) for cells in found for cell in cells]


def _cells(facts: Facts, check: str, number: int, mask: Bool, what: str) -> Iterator[Remark]:
    """One remark on all marked cells of a level, with the place of the first."""
    count = int(np.count_nonzero(mask))
    if count:
        verb = ("have", "has") if what.startswith("a ") else ("are", "is")
        text = f"{count} cell{'s' if count > 1 else ''} {verb[count == 1]} {what}"
        yield Remark(check, ERROR, number, facts.first(number, mask), text)
