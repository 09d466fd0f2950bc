"""Links: those of the settings, put on cells, and those that its rules find in the scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from navbake.baker.kernels.constants import SLACK
from navbake.baker.scene.names import unique_name
from navbake.baker.traffic.drops import find_edges
from navbake.baker.traffic.ground import Ground, MadeLink
from navbake.baker.traffic.lifts import find_ladders, find_lifts
from navbake.config.traffic import LinkSettings
from navbake.navgrid.links import Stop

NEAR = (
    0.5  # how far a stop of the settings may be from its cell, seen from above, and in height [m]
)
FINDERS: dict[str, Callable[[Ground, LinkSettings], list[MadeLink]]] = {
    "drop": find_edges,
    "jump": find_edges,
    "ladder": find_ladders,
    "lift": find_lifts,
}


class Links(NamedTuple):
    """The named links of a bake, cells counted on the whole lattice, and warnings."""

    links: list[MadeLink]
    warnings: list[str]


def find_links(ground: Ground, settings: list[LinkSettings]) -> Links:
    """Put the given links on cells, and find those that rules ask for; given ones first.

    A stop without a free cell nearby, or on the cell of one before, is left out, and so is a link
    of fewer than two stops.
    """
    links, warnings = list[MadeLink](), list[str]()
    for given in settings:
        if given.auto is None:
            link, told = _place_link(given, ground)
            links += [link] if len(link.stops) > 1 else []
            warnings += told
    taken = {given.name for given in settings if given.name}
    for rule in settings:
        if rule.auto is None:
            continue
        found = FINDERS[rule.auto](ground, rule)
        found.sort(key=lambda link: [(stop.level, stop.cell) for stop in link.stops])
        for number, link in enumerate(found, 1):
            name = unique_name(link.fields.get("name") or f"{rule.auto} {number}", taken)
            named = {"name": name, "kind": rule.auto, "auto": True}
            links.append(MadeLink(link.stops, {**link.fields, **_stated(rule), **named}))
        if not found:
            warnings.append(f"`links` asks for {rule.auto}s, but the scene has none")
    return Links(links, warnings)


def _stated(settings: LinkSettings) -> dict[str, object]:
    """What the settings say of a link beside its stops, without what they leave open."""
    stated = settings.model_dump(include={"width", "cost", "seconds", "agents", "state"})
    return {key: value for key, value in stated.items() if value is not None}


def _place_link(given: LinkSettings, ground: Ground) -> tuple[MadeLink, list[str]]:
    """The link with each stop on the nearest free cell; and what is wrong with its stops."""
    stops, wrong, taken = list[Stop](), list[str](), set[tuple[int, int]]()
    for number, (x, y, z) in enumerate(given.stops, 1):
        found = _find_stop(x, y, z, ground)
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
    return MadeLink(stops, fields), told


def _find_stop(x: float, y: float, z: float, ground: Ground) -> Stop | str:
    """The nearest free cell on the level whose floor is nearest to z; or why there is none."""
    lattice, at = ground.lattice, np.array([[x, y], [x, y]])
    window = lattice.window(at, NEAR)
    if window is None:
        return "lies outside of the grid"
    rows, cols = window
    off = np.hypot(lattice.center_x()[None, cols] - x, lattice.center_y()[rows, None] - y)
    gap = np.abs(ground.floors[:, rows, cols] - z)
    gap = np.where((off <= NEAR + SLACK) & ~np.isnan(gap), gap, np.inf)
    nearest = gap.min(axis=(1, 2))
    level = int(np.argmin(nearest))
    if not np.isfinite(nearest[level]):
        return f"has no floor within {NEAR:g} m"
    if nearest[level] > NEAR + SLACK:
        return f"is {nearest[level]:.2f} m off the nearest floor"
    here = ground.free[level, rows, cols] & (gap[level] <= NEAR + SLACK)
    if not here.any():
        return f"is blocked: nothing is free within {NEAR:g} m"
    off = np.where(here, np.round(off, 9), np.inf)
    row, col = np.unravel_index(int(np.argmin(off)), off.shape)
    cell = (int(row) + rows.start) * lattice.width + int(col) + cols.start
    return Stop(level, cell, (x, y, z))
