"""Checks of what is connected: islands that one cell cuts off, and levels that nothing reaches."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from navbake.auditor.facts import Facts
from navbake.auditor.report import REMARK, Remark
from navbake.types import Int32

MIN_AREA = 1.0  # of both islands, if what lies between them is to matter [m²]
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
            if len(cells) <= MOST_CELLS and min(area[list(pair)]) >= MIN_AREA:
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
    reached = {max(range(len(facts.levels)), key=lambda k: int(facts.free[k].sum()))}
    pairs = {(int(a), int(b)) for a, _, b, _ in facts.links.tolist()}
    grew = True
    while grew:
        more = {b for a, b in pairs if a in reached} | {a for a, b in pairs if b in reached}
        grew = not more <= reached
        reached |= more
    for number in sorted(set(range(len(facts.levels))) - reached):
        if not facts.free[number].any():
            continue  # told as empty
        area = float(facts.free[number].sum()) * facts.levels[number].lattice.cell_size ** 2
        text = f"no link leads to its {area:.1f} m²"
        place = facts.first(number, facts.free[number])
        yield Remark("unreached", REMARK, number, place, text)
