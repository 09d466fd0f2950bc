"""Makes links: those that the settings list, and those that rules find, like drops and jumps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.doors.doors import ClassifiedLeaf, select_doors
from navbake.baker.floors.levels import Floors
from navbake.baker.links.lifts import find_ladders, find_lifts
from navbake.baker.links.search import (
    CROSSING,
    DIRECTIONS,
    CollisionGeometry,
    Landings,
    LandingTest,
    LatticeLink,
    LinkSearch,
)
from navbake.baker.scene.scene import Scene
from navbake.config.links import LinkSettings
from navbake.config.settings import BakeConfig
from navbake.known_names import unique_name
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.links import Stop
from navbake.types import Bool, Float, Int

# The largest distance of a stop of the settings from its cell, seen from above, and in height [m]
STOP_REACH = 0.5
# The greatest height of drops, and the widest gap, where the settings state none [m]
DROP_HEIGHT = 1.0
EDGE_GAP = 0.5

LinkFinder = Callable[[LinkSearch, LinkSettings], list[LatticeLink]]


class BakedLinks(NamedTuple):
    """The named links of a bake.

    Attributes:
        links: the links, with cell ids on the whole lattice.
        warnings: warnings about the links, one line each.
    """

    links: list[LatticeLink]
    warnings: list[str]


def bake_links(
    scene: Scene,
    lattice: Lattice,
    floors: Floors,
    geometry: CollisionGeometry | None,
    leaves: Sequence[ClassifiedLeaf],
    is_obstacle_geom: Bool,
    occupied: Sequence[Bool],
    config: BakeConfig,
) -> BakedLinks:
    """Find the named links: those that the settings list, and those that the settings' rules find.

    Args:
        scene: the posed scene.
        lattice: the whole lattice.
        floors: the floors of all levels.
        geometry: the structure that agents on links may collide with; None without settings of
            links.
        leaves: all classified leaves, doors or not.
        is_obstacle_geom: for each geom, see `mark_obstacle_geoms`, (ngeom,).
        occupied: for each level, a mask of the cells that anything except doors occupies, shape
            (height, width).
        config: all settings.

    Returns:
        The links, with cell ids on the whole lattice, and their warnings.
    """
    if geometry is None:
        return BakedLinks([], [])
    floor_heights = np.stack([level.floor for level in floors.levels])
    free = ~(np.stack(occupied) | np.isnan(floor_heights))
    # A link ends on cells that are free whether doors are open or closed.
    for door in select_doors(leaves):
        for cells_of_levels in door.blocked.values():
            for level_free, cells in zip(free, cells_of_levels, strict=True):
                level_free.ravel()[cells] = False
    search = LinkSearch(
        scene=scene,
        shapes=scene.shapes.only(scene.is_structure | is_obstacle_geom),
        lattice=lattice,
        floors=floor_heights,
        free=free,
        geometry=geometry.with_shapes(scene.shapes.only(is_obstacle_geom), lattice),
        agent=config.agent,
    )
    return find_links(search, config.links)


def find_links(search: LinkSearch, settings: list[LinkSettings]) -> BakedLinks:
    """Place the stops of the settings' links on cells, and find the links of the settings' rules.

    A stop is left out if no free cell is nearby, or if it is on the same cell as an earlier stop. A
    link with fewer than two stops is left out.

    Args:
        search: floors, free cells and geometry.
        settings: links and rules, in the order of the settings.

    Returns:
        The links that the settings list, followed by those that rules find, and warnings.
    """
    links = list[LatticeLink]()
    warnings = list[str]()
    finders: dict[str, LinkFinder] = {"ladder": find_ladders, "lift": find_lifts}
    for link_settings in settings:
        if link_settings.auto is None:
            link, link_warnings = _place_link(link_settings, search)
            if len(link.stops) > 1:
                links.append(link)
            warnings += link_warnings
    used_names = {link_settings.name for link_settings in settings if link_settings.name}
    for rule in settings:
        if rule.auto is None:
            continue
        finder = finders.get(rule.auto, find_edges)
        rule_links = finder(search, rule)
        rule_links.sort(key=lambda link: [(stop.level, stop.cell) for stop in link.stops])
        for number, link in enumerate(rule_links, 1):
            name = unique_name(link.fields.get("name") or f"{rule.auto} {number}", used_names)
            fields = {
                **link.fields,
                **_set_fields(rule),
                "name": name,
                "kind": rule.auto,
                "auto": True,
            }
            links.append(LatticeLink(link.stops, fields))
        if not rule_links:
            warnings.append(f"`links` asks for {rule.auto}s, but the scene has none")
    return BakedLinks(links, warnings)


def _set_fields(settings: LinkSettings) -> dict[str, object]:
    """Return by name those of width, cost, seconds, agents and state that the settings state."""
    fields = settings.model_dump(include={"width", "cost", "seconds", "agents", "state"})
    return {key: value for key, value in fields.items() if value is not None}


def _place_link(settings: LinkSettings, search: LinkSearch) -> tuple[LatticeLink, list[str]]:
    """Make a link that the settings list, each of its stops on the nearest free cell.

    Returns:
        The link, without the stops that have no such cell; and a warning about these stops, if
        there are any.
    """
    stops = list[Stop]()
    errors = list[str]()
    used_cells = set[tuple[int, int]]()
    for number, (x, y, z) in enumerate(settings.stops, 1):
        stop = _find_stop(x, y, z, search)
        if isinstance(stop, Stop) and (stop.level, stop.cell) in used_cells:
            stop = "is on the cell of another stop"
        if isinstance(stop, Stop):
            used_cells.add((stop.level, stop.cell))
            stops.append(stop)
        else:
            errors.append(f"stop {number}, ({x:.2f}, {y:.2f}, {z:.2f}), {stop}")
    fields = {
        "name": settings.name,
        "kind": settings.kind,
        "one_way": settings.one_way,
        **_set_fields(settings),
    }
    warnings = []
    if errors:
        outcome = f"it has {len(stops)} stops left" if len(stops) > 1 else "it is left out"
        warnings = [f"link {settings.name!r}: {'; '.join(errors)}; {outcome}"]
    return LatticeLink(stops, fields), warnings


def _find_stop(x: float, y: float, z: float, search: LinkSearch) -> Stop | str:
    """Make a stop of the settings at a position, on the free cell nearest to it.

    Args:
        x, y, z: the position, world frame [m].
        search: floors and free cells.

    Returns:
        The stop, on the level whose floor is nearest to z; or, if there is none within
        `STOP_REACH`, what is wrong with the position, the end of a sentence.
    """
    lattice = search.lattice
    window = lattice.window(np.array([[x, y], [x, y]]), STOP_REACH)
    if window is None:
        return "lies outside of the grid"
    rows, cols = window
    distance = np.hypot(lattice.center_x()[None, cols] - x, lattice.center_y()[rows, None] - y)
    height_gap = np.abs(search.floors[:, rows, cols] - z)
    is_near = (distance <= STOP_REACH + LIMIT_SLACK) & ~np.isnan(height_gap)
    height_gap = np.where(is_near, height_gap, np.inf)
    least_gap = height_gap.min(axis=(1, 2))
    level = int(np.argmin(least_gap))
    if not np.isfinite(least_gap[level]):
        return f"has no floor within {STOP_REACH:g} m"
    if least_gap[level] > STOP_REACH + LIMIT_SLACK:
        return f"is {least_gap[level]:.2f} m off the nearest floor"
    is_free = search.free[level, rows, cols] & (height_gap[level] <= STOP_REACH + LIMIT_SLACK)
    if not is_free.any():
        return f"is blocked: nothing is free within {STOP_REACH:g} m"
    distance = np.where(is_free, np.round(distance, 9), np.inf)
    row, col = np.unravel_index(int(np.argmin(distance)), distance.shape)
    cell = (int(row) + rows.start) * lattice.width + int(col) + cols.start
    return Stop(level, cell, (x, y, z))


def find_edges(search: LinkSearch, rule: LinkSettings) -> list[LatticeLink]:
    """Find the drops or jumps of a rule, within the rule's height [m] and gap [m].

    An edge is a free cell beside which no floor lies within a step. A drop leads straight from an
    edge to the first free cell that is lower by more than a step: the agent moves on at the edge's
    height, and falls there. A jump leads straight over a gap of at least one cell to a floor whose
    height differs by at most a step, or by at most the rule's height if it has one. Nothing may be
    in the way between the two ends and over them, up to the agent's height over the higher end.
    Drops or jumps side by side become one link, at their middle. Its stops are moved away from the
    edge, so that an agent as wide as the link can stand there, see `LinkSearch.make_stop_off_edge`.

    Args:
        search: floors, free cells and geometry.
        rule: a rule for drops or jumps.

    Returns:
        The links, with cell ids on the whole lattice.
    """
    is_drop = rule.auto == "drop"
    max_gap = EDGE_GAP if rule.gap is None else rule.gap
    # jumps lead both ways: two of the four directions find them all
    directions = range(len(DIRECTIONS) if is_drop else 2)
    check_landing = _drop_test(search, rule) if is_drop else _jump_test(search, rule)
    crossings = [
        search.find_crossings(level, free, directions, max_gap, check_landing)
        for level, free in enumerate(search.free)
    ]
    candidates = np.concatenate([np.empty(0, dtype=CROSSING), *crossings])
    is_clear = search.mark_clear(candidates, search.geometry)
    links = []
    for group in search.group_crossings(candidates[is_clear]):
        middle = group.middle
        direction = int(middle["direction"])
        start = search.make_stop_off_edge(
            int(middle["from_level"]),
            int(middle["from_cell"]),
            direction=(direction + 2) % len(DIRECTIONS),
            width=group.width,
        )
        end = search.make_stop_off_edge(
            int(middle["to_level"]), int(middle["to_cell"]), direction, group.width
        )
        links.append(LatticeLink([start, end], {"one_way": is_drop, "width": group.width}))
    return links


def _rises(search: LinkSearch, rows: Int, cols: Int, from_height: Float) -> Float:
    """Return how far the floor of each level lies above the start of each line, (levels, n) [m].

    It is -inf where a level has no floor.

    Args:
        search: the floors.
        rows, cols: the cells that the lines have come to, (n,).
        from_height: heights of the floors where the lines start, (n,) [m].
    """
    rise: Float = np.nan_to_num(search.floors[:, rows, cols] - from_height, nan=-np.inf)
    return rise


def _drop_test(search: LinkSearch, rule: LinkSettings) -> LandingTest:
    """Return a function that tests where lines over an edge land as drops.

    A line lands on a free floor that is more than a step lower than its start, and lower by at most
    the rule's height; of several such floors, on the highest. It goes on as long as no floor lies
    within a step of its start's height.
    """
    max_drop = LIMIT_SLACK + (rule.height or DROP_HEIGHT)

    def check_landing(rows: Int, cols: Int, from_height: Float, _num_between: int) -> Landings:
        rise = _rises(search, rows, cols, from_height)
        is_over_edge = ~(np.abs(rise) <= search.max_step).any(axis=0)
        rise_of_lower = np.where(rise < -search.max_step, rise, -np.inf)
        level = rise_of_lower.argmax(axis=0)
        lands = is_over_edge & (rise_of_lower.max(axis=0) >= -max_drop)
        lands &= search.free[level, rows, cols]
        return Landings(level, lands, goes_on=np.asarray(is_over_edge))

    return check_landing


def _jump_test(search: LinkSearch, rule: LinkSettings) -> LandingTest:
    """Return a function that tests where lines over a gap land as jumps.

    A line lands beyond at least one cell, on the floor nearest in height to its start, if that is
    free and differs by at most a step, or the rule's height if it has one. The line goes on as long
    as no floor lies within a step of its start's height.
    """
    max_rise = LIMIT_SLACK + (rule.height or search.max_step)

    def check_landing(rows: Int, cols: Int, from_height: Float, num_between: int) -> Landings:
        rise = _rises(search, rows, cols, from_height)
        is_over_edge = ~(np.abs(rise) <= search.max_step).any(axis=0)
        level = np.abs(rise).argmin(axis=0)
        lands = (np.abs(rise).min(axis=0) <= max_rise) & (num_between > 0)
        lands &= search.free[level, rows, cols]
        return Landings(level, lands, goes_on=np.asarray(is_over_edge))

    return check_landing
