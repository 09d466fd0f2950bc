"""Checks of floors: free cells without one, floors far away, and floors that jump."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from navbake.auditor.facts import Facts
from navbake.auditor.report import ERROR, REMARK, Remark, count_of, remark_on_cells
from navbake.types import Float, Int

FARTHEST = 10_000.0  # floors beyond are a wrong unit [m]
MIN_AREA = 1.0  # of a floor that no step leads to, unless the settings of a bake say another [m²]
MOST_ROUND = 0.75  # share of a patch's outline that is nearly all of it: a corner may touch a wall
HALF_ROUND = 0.5  # share from which on nobody would take a patch for a storey beside another
MOST_PATCHES = 10  # that are told one by one


def check_floors(facts: Facts) -> Iterator[Remark]:
    """Free cells have no floor, or one that is absurdly high or low."""
    for number, level in enumerate(facts.levels):
        floor, free = facts.floors[number], facts.free[number]
        if not level.uses_cell_floors:
            continue
        missing = free & np.isnan(floor)
        yield from remark_on_cells(facts, "floors", number, missing, "free without a floor")
        far = np.abs(np.where(np.isnan(floor), 0.0, floor)) > FARTHEST
        text = f"farther than {FARTHEST:g} m from 0"
        yield from remark_on_cells(facts, "floors", number, far, text)


def check_jumps(facts: Facts) -> Iterator[Remark]:
    """A patch of floor lies more than a step above or below what is round it.

    No step and no link leads there, so it is a spike, a pit, or the top of something. One that is
    too small for a floor can't be meant; of a larger one, a person would ask.
    """
    found = []
    outline = _measure_outlines(facts)
    area = outline.cells * facts.levels[0].lattice.cell_size ** 2
    for higher, edges, rise in ((True, *outline.drops), (False, *outline.rises)):
        share = edges / np.maximum(outline.edges, 1)
        for patch in np.flatnonzero(share >= HALF_ROUND).tolist():
            is_fault = share[patch] >= MOST_ROUND and area[patch] < _min_area(facts)
            way = f"{rise[patch] / edges[patch]:.2f} m {'above' if higher else 'below'}"
            around = "all" if share[patch] >= MOST_ROUND else "most of what is"
            size = f"{area[patch]:.3g} m² of floor ({count_of(int(outline.cells[patch]), 'cell')})"
            text = f"{size} lies {way} {around} round it, and no step leads there"
            found.append((not is_fault, -area[patch], patch, text))
    for is_remark, _, patch, text in sorted(found)[:MOST_PATCHES]:
        number, place = _middle(facts, patch)
        yield Remark("jumps", REMARK if is_remark else ERROR, number, place, text)
    rest = sorted(found)[MOST_PATCHES:]
    if rest:
        severity = REMARK if rest[0][0] else ERROR
        yield Remark("jumps", severity, None, None, f"{len(rest)} more patches of floor jump")


class _Outlines(NamedTuple):
    """The outlines of all islands, by their numbers.

    Attributes:
        cells: how many cells it has.
        edges: how many edges of its cells are its outline.
        drops: of these, how many drop to another island, and by how much in all [m].
        rises: the same where the other island is higher.
    """

    cells: Int
    edges: Int
    drops: tuple[Int, Float]
    rises: tuple[Int, Float]


def _measure_outlines(facts: Facts) -> _Outlines:
    islands = facts.islands
    count = max((int(island.max(initial=0)) for island in islands), default=0) + 1
    cells, edges, drops, rises = (np.zeros(count, dtype=np.int64) for _ in range(4))
    dropped, risen = np.zeros(count), np.zeros(count)
    for island, floor in zip(islands, facts.floors, strict=True):
        cells += np.bincount(island.ravel(), minlength=count)
        wide, high = np.pad(island, 1), np.pad(floor, 1, constant_values=np.nan)
        for beside in (np.s_[:-2, 1:-1], np.s_[2:, 1:-1], np.s_[1:-1, :-2], np.s_[1:-1, 2:]):
            with np.errstate(invalid="ignore"):  # floors that are infinite are told as such
                other, down = wide[beside], floor - high[beside]
            is_outline = (island > 0) & (other != island)
            edges += np.bincount(island[is_outline], minlength=count)
            jumps = is_outline & (other > 0)
            for mask, num, total in ((down > 0, drops, dropped), (down < 0, rises, risen)):
                own = island[jumps & mask]
                num += np.bincount(own, minlength=count)
                total += np.bincount(own, np.abs(down[jumps & mask]), minlength=count)
    cells[0] = 0
    return _Outlines(cells, edges, (drops, dropped), (rises, risen))


def _middle(facts: Facts, patch: int) -> tuple[int, tuple[float, float, float]]:
    """The level that has most of an island, and the place of a cell in its middle."""
    on = [np.flatnonzero(island == patch) for island in facts.islands]
    number = max(range(len(on)), key=lambda k: len(on[k]))
    row, col = divmod(int(on[number][len(on[number]) // 2]), facts.levels[number].width)
    return number, facts.place(number, row, col)


def _min_area(facts: Facts) -> float:
    """The area from which on a floor that no step leads to is one [m²]."""
    settings = facts.settings.get("floors")
    stated = settings.get("min_area") if isinstance(settings, dict) else None
    return float(stated) if isinstance(stated, int | float) else MIN_AREA
