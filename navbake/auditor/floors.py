"""Checks of floors and of what is connected: missing floors, jumps, islands cut off."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.auditor.facts import Facts
from navbake.auditor.report import ERROR, REMARK, Remark, count_of, remark_on_cells
from navbake.types import Float, Int, Int32

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
        far = np.abs(floor) > FARTHEST  # NaN isn't
        text = f"farther than {FARTHEST:g} m from 0"
        yield from remark_on_cells(facts, "floors", number, far, text)


def check_jumps(facts: Facts) -> Iterator[Remark]:
    """A patch of floor lies more than a step above or below what is round it.

    No step and no link leads there, so it is a spike, a pit, or the top of something. One that is
    too small for a floor can't be meant; of a larger one, a person would ask.
    """
    if not any(len(cells) for steps in facts.steps for cells in steps):
        return
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
    for number, island in enumerate(islands):
        cells += np.bincount(island.ravel(), minlength=count)
        for rim in (island[0], island[-1], island[:, 0], island[:, -1]):
            edges += np.bincount(rim, minlength=count)
        for here, there in (np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:]):
            differ = island[here] != island[there]
            for side in (here, there):
                edges += np.bincount(island[side][differ], minlength=count)
        for own, down in _jumps(facts, number):
            for mask, num, total in ((down > 0, drops, dropped), (down < 0, rises, risen)):
                num += np.bincount(own[mask], minlength=count)
                total += np.bincount(own[mask], np.abs(down[mask]), minlength=count)
    cells[0] = edges[0] = 0
    return _Outlines(cells, edges, (drops, dropped), (rises, risen))


def _jumps(facts: Facts, number: int) -> Iterator[tuple[Int32, Float]]:
    """Islands beside another one, and how far that lies below [m]: above, below, left and right.

    Free neighbours are on two islands only where they lie more than a step apart.
    """
    island, floor = facts.islands[number].ravel(), facts.floors[number].ravel()
    steps, width = facts.steps[number], facts.levels[number].width
    for cells, beside in ((steps.down, steps.down + width), (steps.right, steps.right + 1)):
        apart = island[cells] != island[beside]
        one, other = cells[apart], beside[apart]
        down = floor[one] - floor[other]
        yield island[other], -down
        yield island[one], down


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


MIN_CUT_OFF = 1.0  # of both islands, if what lies between them is to matter [m²]
MOST_CELLS = 3  # of a gap; what is longer is a thin wall
MOST_GAPS = 10  # that are told, the widest islands first


def check_cut_off(facts: Facts) -> Iterator[Remark]:
    """One cell, or two or three side by side, cut off an island.

    The islands are those of a grid whose doors are all open. Where more such cells part the same
    two islands, they are a thin wall between them, and are meant; cells in it that nothing
    occupies are a gap that was closed for a larger agent.
    """
    islands = facts.open_islands
    largest = max((int(island.max(initial=0)) for island in islands), default=0)
    if largest < 2:
        return
    count = np.zeros(largest + 1, dtype=np.int64)
    for island in islands:
        count += np.bincount(island.ravel(), minlength=largest + 1)
    area = count * facts.levels[0].lattice.cell_size ** 2
    found = []
    for number, island in enumerate(islands):
        occupied = facts.levels[number].occupancy.ravel() != 0
        for pair, between in _gaps(facts, number, island).items():
            cells = {cell for cell in between if not occupied[cell]} or between
            if len(cells) <= MOST_CELLS and min(area[list(pair)]) >= MIN_CUT_OFF:
                found.append((min(area[list(pair)]), number, pair, cells))
    for smaller, number, _, cells in sorted(found, key=lambda gap: -gap[0])[:MOST_GAPS]:
        width = facts.levels[number].width
        row, col = divmod(sorted(cells)[len(cells) // 2], width)
        size = len(cells) * facts.levels[number].lattice.cell_size
        text = f"a gap {size:.2f} m wide is blocked by one cell, and cuts off {smaller:.1f} m²"
        yield Remark("cut off", REMARK, number, facts.place(number, row, col), text)


def _gaps(facts: Facts, number: int, island: Int32) -> dict[tuple[int, int], set[int]]:
    """The blocked cells with two islands on opposite sides, by the pair of islands.

    The floors on both sides are within a step of each other, as they would be on one walk.
    """
    floor, own, width = facts.floors[number].ravel(), island.ravel(), island.shape[1]
    gaps: dict[tuple[int, int], set[int]] = {}
    ways = (1, island[:, :-2] != island[:, 2:]), (width, island[:-2] != island[2:])
    for step, differ in ways:
        rows, cols = np.nonzero(differ)  # few do, so that the rest is asked of few
        one = rows * width + cols
        one = one[(own[one] > 0) & (own[one + step] == 0) & (own[one + 2 * step] > 0)]
        cell, other = one + step, one + 2 * step
        with np.errstate(invalid="ignore"):
            is_gap = ~(np.abs(floor[one] - floor[other]) > facts.step_limit)
        is_gap &= ~np.isnan(floor[cell])
        pairs = np.sort(np.stack([own[one][is_gap], own[other][is_gap]], axis=1), axis=1)
        for (a, b), blocked in zip(pairs.tolist(), cell[is_gap].tolist(), strict=True):
            gaps.setdefault((a, b), set()).add(blocked)
    return gaps


def check_unreached_levels(facts: Facts) -> Iterator[Remark]:
    """No link leads to a level from the one with the most free cells."""
    if len(facts.levels) < 2:
        return
    count = len(facts.levels)
    pairs = coo_array((np.ones(len(facts.links)), tuple(facts.links[:, ::2].T)), (count, count))
    _, group = connected_components(pairs, directed=False)
    largest = max(range(count), key=lambda k: int(facts.free[k].sum()))
    for number in np.flatnonzero(group != group[largest]).tolist():
        if not facts.free[number].any():
            continue  # told as empty
        area = float(facts.free[number].sum()) * facts.levels[number].lattice.cell_size ** 2
        text = f"no link leads to its {area:.1f} m²"
        place = facts.first(number, facts.free[number])
        yield Remark("unreached", REMARK, number, place, text)
