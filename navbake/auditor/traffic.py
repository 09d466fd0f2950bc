"""Checks of named links and of areas."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from navbake.auditor.facts import Facts
from navbake.auditor.levels import MIN_FREE
from navbake.auditor.report import ERROR, REMARK, Found, count_of


def check_named_links(facts: Facts) -> Iterator[Found]:
    """A link's stop is blocked, a lift's stops are on one level, or one leads to a dead spot."""
    links, agents = facts.grid.links, facts.grid.agents
    islands = facts.walks if links else []
    count = np.bincount(np.concatenate([[0], *(part.ravel() for part in islands)]))
    area = count * facts.levels[0].lattice.cell_size ** 2
    for link in links:
        what = f"{link.kind} {link.name!r}"
        for stop in link.stops:
            row, col = divmod(stop.cell, facts.levels[stop.level].width)
            place, island = facts.place(stop.level, row, col), int(islands[stop.level][row, col])
            if not facts.free[stop.level][row, col]:
                by_door = bool(facts.passable[stop.level][row, col])
                why = "a door blocks" if by_door else "blocked is"
                severity = REMARK if by_door or facts.reach is not None else ERROR
                yield severity, stop.level, place, f"{why} a stop of {what}"
            elif area[island] < MIN_FREE:
                text = f"{what} leads to {area[island]:.2f} m² of floor, and nothing else does"
                yield REMARK, stop.level, place, text
        if link.kind == "lift" and len({stop.level for stop in link.stops}) == 1:
            first = link.stops[0]
            text = f"all {count_of(len(link.stops), 'stop')} of {what} are on one level"
            yield REMARK, first.level, first.position, text
        for name in sorted(set(link.agents or ()) - set(agents)):
            yield ERROR, None, None, f"{what} is for agent {name!r}, whom the grid doesn't list"


def check_areas(facts: Facts) -> Iterator[Found]:
    """An area covers no cell of any level, is for an unknown agent, or cells are in none."""
    areas, agents = facts.grid.areas, facts.grid.agents
    if not areas:
        return
    count = np.zeros(256, dtype=np.int64)
    for number, level in enumerate(facts.levels):
        stored = level.attributes.get("area", np.zeros(1, dtype=np.uint8))
        beyond = (stored < 0) | (stored > len(areas))
        yield from facts.on_cells(number, beyond, "in an area that the table doesn't list")
        count += np.bincount(level.area_index.ravel(), minlength=256)
    for place, area in enumerate(areas, 1):
        if not count[place]:
            yield REMARK, None, None, f"area {area.name!r} covers no cell of any level"
        for name in sorted(set(area.agents or ()) - set(agents)):
            text = f"area {area.name!r} is for agent {name!r}, whom the grid doesn't list"
            yield ERROR, None, None, text
