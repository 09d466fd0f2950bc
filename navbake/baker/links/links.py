"""Links: those of the settings, put on cells, and those that its rules find, as drops and jumps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.links.lifts import find_ladders, find_lifts
from navbake.baker.links.search import CROSSING, DIRECTIONS, LatticeLink, LinkSearch
from navbake.config.links import LinkSettings
from navbake.known_names import unique_name
from navbake.navgrid.links import Stop
from navbake.types import Bool, Float, Int

NEAR = 0.5  # of a given stop from its cell, seen from above, and in height [m]
# heights of drops, and gaps, that are not in the settings [m]
DROP = 1.0
GAP = 0.5


class BakedLinks(NamedTuple):
    """The named links of a bake, cells counted on the whole lattice, and warnings."""

    links: list[LatticeLink]
    warnings: list[str]


def find_links(search: LinkSearch, settings: list[LinkSettings]) -> BakedLinks:
    """Put the given links on cells, and find those that rules ask for; given ones first.

    A stop without a free cell nearby, or on the cell of one before, is left out, and so is a link
    of fewer than two stops.
    """
    links = list[LatticeLink]()
    warnings = list[str]()
    finders = {"ladder": find_ladders, "lift": find_lifts}
    for given in settings:
        if given.auto is None:
            link, told = _place_link(given, search)
            links += [link] if len(link.stops) > 1 else []
            warnings += told
    taken = {given.name for given in settings if given.name}
    for rule in settings:
        if rule.auto is None:
            continue
        found = finders.get(rule.auto, find_edges)(search, rule)
        found.sort(key=lambda link: [(stop.level, stop.cell) for stop in link.stops])
        for number, link in enumerate(found, 1):
            name = unique_name(link.fields.get("name") or f"{rule.auto} {number}", taken)
            named = {"name": name, "kind": rule.auto, "auto": True}
            links.append(LatticeLink(link.stops, {**link.fields, **_stated(rule), **named}))
        if not found:
            warnings.append(f"`links` asks for {rule.auto}s, but the scene has none")
    return BakedLinks(links, warnings)


def _stated(settings: LinkSettings) -> dict[str, object]:
    """What the settings say of a link beside its stops, without what they leave open."""
    stated = settings.model_dump(include={"width", "cost", "seconds", "agents", "state"})
    return {key: value for key, value in stated.items() if value is not None}


def _place_link(given: LinkSettings, search: LinkSearch) -> tuple[LatticeLink, list[str]]:
    """The link with each stop on the nearest free cell; and what is wrong with its stops."""
    stops = list[Stop]()
    wrong = list[str]()
    taken = set[tuple[int, int]]()
    for number, (x, y, z) in enumerate(given.stops, 1):
        found = _find_stop(x, y, z, search)
        if isinstance(found, Stop) and (found.level, found.cell) in taken:
            found = "is on the cell of another stop"
        if isinstance(found, Stop):
            taken.add((found.level, found.cell))
            stops.append(found)
        else:
            wrong.append(f"stop {number}, ({x:.2f}, {y:.2f}, {z:.2f}), {found}")
    fields = {"name": given.name, "kind": given.kind, "one_way": given.one_way, **_stated(given)}
    told = []
    if wrong:
        left = f"it has {len(stops)} stops left" if len(stops) > 1 else "it is left out"
        told = [f"link {given.name!r}: {'; '.join(wrong)}; {left}"]
    return LatticeLink(stops, fields), told


def _find_stop(x: float, y: float, z: float, search: LinkSearch) -> Stop | str:
    """The nearest free cell on the level whose floor is nearest to z; or why there is none."""
    lattice = search.lattice
    at = np.array([[x, y], [x, y]])
    window = lattice.window(at, NEAR)
    if window is None:
        return "lies outside of the grid"
    rows, cols = window
    off = np.hypot(lattice.center_x()[None, cols] - x, lattice.center_y()[rows, None] - y)
    gap = np.abs(search.floors[:, rows, cols] - z)
    gap = np.where((off <= NEAR + LIMIT_SLACK) & ~np.isnan(gap), gap, np.inf)
    nearest = gap.min(axis=(1, 2))
    level = int(np.argmin(nearest))
    if not np.isfinite(nearest[level]):
        return f"has no floor within {NEAR:g} m"
    if nearest[level] > NEAR + LIMIT_SLACK:
        return f"is {nearest[level]:.2f} m off the nearest floor"
    here = search.free[level, rows, cols] & (gap[level] <= NEAR + LIMIT_SLACK)
    if not here.any():
        return f"is blocked: nothing is free within {NEAR:g} m"
    off = np.where(here, np.round(off, 9), np.inf)
    row, col = np.unravel_index(int(np.argmin(off)), off.shape)
    cell = (int(row) + rows.start) * lattice.width + int(col) + cols.start
    return Stop(level, cell, (x, y, z))


def find_edges(search: LinkSearch, rule: LinkSettings) -> list[LatticeLink]:
    """Find the drops or jumps of a rule, up to its height and over gaps up to its own [m].

    An edge is a free cell beside which no floor lies within a step. A drop leads straight from
    there to the first free cell that is lower than that; the agent goes on at its height and falls.
    A jump leads over a gap of at least a cell to a floor at about the same height, within a step
    unless the rule has a height. Nothing stands in the way: between them and over both ends, up to
    the agent's height over the higher one. Those side by side are one link, at their middle, whose
    stops are as far from the edge as an agent of its width needs, see `LinkSearch.stand_back`.
    """
    is_drop = rule.auto == "drop"
    most = LIMIT_SLACK + (rule.height or (DROP if is_drop else search.step))

    def land(rows: Int, cols: Int, z: Float, between: int) -> tuple[Int, Bool, Bool]:
        rise: Float = np.nan_to_num(search.floors[:, rows, cols] - z, nan=-np.inf)
        goes_on = np.asarray(~(np.abs(rise) <= search.step).any(axis=0))
        if is_drop:  # it falls onto the highest
            rise = np.where(rise < -search.step, rise, -np.inf)
            level = rise.argmax(axis=0)
            lands = goes_on & (rise.max(axis=0) >= -most)
        else:
            level = np.abs(rise).argmin(axis=0)
            lands = (np.abs(rise).min(axis=0) <= most) & (between > 0)
        lands = lands & search.free[level, rows, cols]
        return level, np.asarray(lands), goes_on

    gap = GAP if rule.gap is None else rule.gap
    ways = range(len(DIRECTIONS) if is_drop else 2)
    parts = [search.look_out((n, free), ways, gap, land) for n, free in enumerate(search.free)]
    found = np.concatenate([np.empty(0, dtype=CROSSING), *parts])
    links = []
    for _, middle, width in search.group(found[search.are_clear(found, search.geometry)]):
        way, level, cell, other, other_cell, *_ = middle.tolist()
        start = search.stand_back(level, cell, (way + 2) % len(DIRECTIONS), width)
        end = search.stand_back(other, other_cell, way, width)
        links.append(LatticeLink([start, end], {"one_way": is_drop, "width": width}))
    return links
