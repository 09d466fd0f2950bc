"""Makes the links of a bake: listed in the settings, or found by rules, such as drops and jumps."""

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
MAX_STOP_DISTANCE = 0.5
# The greatest height of drops, and the widest gap, unless the settings state others [m]
DEFAULT_DROP_HEIGHT = 1.0
DEFAULT_EDGE_GAP = 0.5

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
        is_obstacle_geom: for each geom, whether it belongs to a movable or to a leaf that is no
            door, (ngeom,), bool.
        occupied: for each level, a mask of the cells that anything except doors occupies, shape
            (height, width).
        config: all settings.

    Returns:
        The links, with cell ids on the whole lattice, and their warnings.
    """
    if geometry is None:
        return BakedLinks([], [])
    floor_heights = np.stack([level.floor for level in floors.levels])
    is_free = ~(np.stack(occupied) | np.isnan(floor_heights))
    # A link ends on cells that are free whether doors are open or closed.
    for door in select_doors(leaves):
        for cells_of_levels in door.blocked.values():
            for is_level_free, cells in zip(is_free, cells_of_levels, strict=True):
                is_level_free.ravel()[cells] = False
    search = LinkSearch(
        scene=scene,
        shapes=scene.shapes.only(scene.is_structure | is_obstacle_geom),
        lattice=lattice,
        floor_heights=floor_heights,
        is_free=is_free,
        geometry=geometry.with_shapes(scene.shapes.only(is_obstacle_geom), lattice),
        agent=config.agent,
    )
    return find_links(search, config.links)


def find_links(search: LinkSearch, settings: list[LinkSettings]) -> BakedLinks:
    """Make the links that the settings list, and find the links that their rules describe.

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
    finder_of_kind: dict[str, LinkFinder] = {"ladder": find_ladders, "lift": find_lifts}
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
        find_links_of_rule = finder_of_kind.get(rule.auto, find_drops_or_jumps)
        rule_links = find_links_of_rule(search, rule)
        rule_links.sort(key=lambda link: [(stop.level, stop.cell) for stop in link.stops])
        for link_number, link in enumerate(rule_links, 1):
            name = unique_name(link.fields.get("name") or f"{rule.auto} {link_number}", used_names)
            fields = {
                **link.fields,
                **_list_stated_fields(rule),
                "name": name,
                "kind": rule.auto,
                "auto": True,
            }
            links.append(LatticeLink(link.stops, fields))
        if not rule_links:
            warnings.append(f"`links` asks for {rule.auto}s, but the scene has none")
    return BakedLinks(links, warnings)


def _list_stated_fields(settings: LinkSettings) -> dict[str, object]:
    """Return name -> value of the link's width, cost, seconds, agents and state, if set."""
    fields = settings.model_dump(include={"width", "cost", "seconds", "agents", "state"})
    return {key: value for key, value in fields.items() if value is not None}


def _place_link(settings: LinkSettings, search: LinkSearch) -> tuple[LatticeLink, list[str]]:
    """Make a link that the settings list, each of its stops on the nearest free cell.

    Returns:
        The link, without the stops that have no such cell; and a warning about these stops, if
        there are any.
    """
    stops = list[Stop]()
    stop_errors = list[str]()
    used_cells = set[tuple[int, int]]()
    for stop_number, (x, y, z) in enumerate(settings.stops, 1):
        stop = _find_stop(x, y, z, search)
        if isinstance(stop, Stop) and (stop.level, stop.cell) in used_cells:
            stop = "is on the cell of another stop"
        if isinstance(stop, Stop):
            used_cells.add((stop.level, stop.cell))
            stops.append(stop)
        else:
            stop_errors.append(f"stop {stop_number}, ({x:.2f}, {y:.2f}, {z:.2f}), {stop}")
    fields = {
        "name": settings.name,
        "kind": settings.kind,
        "one_way": settings.one_way,
        **_list_stated_fields(settings),
    }
    warnings = []
    if stop_errors:
        consequence = f"it has {len(stops)} stops left" if len(stops) > 1 else "it is left out"
        warnings = [f"link {settings.name!r}: {'; '.join(stop_errors)}; {consequence}"]
    return LatticeLink(stops, fields), warnings


def _find_stop(x: float, y: float, z: float, search: LinkSearch) -> Stop | str:
    """Make a stop of the settings at a position, on the free cell nearest to it.

    Args:
        x, y, z: the position, world frame [m].
        search: floors and free cells.

    Returns:
        The stop, on the level whose floor is nearest to z; or, if there is no free cell within
        `MAX_STOP_DISTANCE`, what is wrong with the position, as the end of a sentence.
    """
    lattice = search.lattice
    window = lattice.window(np.array([[x, y], [x, y]]), MAX_STOP_DISTANCE)
    if window is None:
        return "lies outside of the grid"
    rows, cols = window
    distance = np.hypot(lattice.center_x()[None, cols] - x, lattice.center_y()[rows, None] - y)
    height_difference = np.abs(search.floor_heights[:, rows, cols] - z)
    is_near = (distance <= MAX_STOP_DISTANCE + LIMIT_SLACK) & ~np.isnan(height_difference)
    height_difference = np.where(is_near, height_difference, np.inf)
    least_height_difference = height_difference.min(axis=(1, 2))
    level_number = int(np.argmin(least_height_difference))
    if not np.isfinite(least_height_difference[level_number]):
        return f"has no floor within {MAX_STOP_DISTANCE:g} m"
    if least_height_difference[level_number] > MAX_STOP_DISTANCE + LIMIT_SLACK:
        return f"is {least_height_difference[level_number]:.2f} m off the nearest floor"
    is_free = search.is_free[level_number, rows, cols] & (
        height_difference[level_number] <= MAX_STOP_DISTANCE + LIMIT_SLACK
    )
    if not is_free.any():
        return f"is blocked: nothing is free within {MAX_STOP_DISTANCE:g} m"
    distance = np.where(is_free, np.round(distance, 9), np.inf)
    row, col = np.unravel_index(int(np.argmin(distance)), distance.shape)
    cell = (int(row) + rows.start) * lattice.width + int(col) + cols.start
    return Stop(level_number, cell, (x, y, z))


def find_drops_or_jumps(search: LinkSearch, rule: LinkSettings) -> list[LatticeLink]:
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
    max_gap = DEFAULT_EDGE_GAP if rule.gap is None else rule.gap
    # jumps lead both ways: two of the four directions find them all
    directions = range(len(DIRECTIONS) if is_drop else 2)
    check_landing = _make_drop_test(search, rule) if is_drop else _make_jump_test(search, rule)
    crossings_of_levels = [
        search.find_crossings(level_number, is_level_free, directions, max_gap, check_landing)
        for level_number, is_level_free in enumerate(search.is_free)
    ]
    crossings = np.concatenate([np.empty(0, dtype=CROSSING), *crossings_of_levels])
    is_clear = search.mark_clear(crossings, search.geometry)
    links = []
    for group in search.group_crossings(crossings[is_clear]):
        middle_crossing = group.middle_crossing
        direction = int(middle_crossing["direction"])
        start_stop = search.make_stop_off_edge(
            int(middle_crossing["from_level"]),
            int(middle_crossing["from_cell"]),
            direction=(direction + 2) % len(DIRECTIONS),
            width=group.width,
        )
        end_stop = search.make_stop_off_edge(
            int(middle_crossing["to_level"]),
            int(middle_crossing["to_cell"]),
            direction,
            group.width,
        )
        links.append(
            LatticeLink([start_stop, end_stop], {"one_way": is_drop, "width": group.width})
        )
    return links


def _heights_above_start(search: LinkSearch, rows: Int, cols: Int, from_height: Float) -> Float:
    """Return how far the floor of each level lies above the start of each line, (levels, n) [m].

    It is -inf where a level has no floor.

    Args:
        search: the floors.
        rows, cols: rows and columns of the cells that the lines have come to, (n,).
        from_height: heights of the floors where the lines start, (n,) [m].
    """
    height_above_start: Float = np.nan_to_num(
        search.floor_heights[:, rows, cols] - from_height, nan=-np.inf
    )
    return height_above_start


def _make_drop_test(search: LinkSearch, rule: LinkSettings) -> LandingTest:
    """Make the function that tests where lines over an edge land as drops.

    A line lands on a free floor that is more than a step lower than its start, and lower by at most
    the rule's height; of several such floors, on the highest. It goes on as long as no floor lies
    within a step of its start's height.
    """
    max_drop = LIMIT_SLACK + (rule.height or DEFAULT_DROP_HEIGHT)

    def check_landing(rows: Int, cols: Int, from_height: Float, _num_between: int) -> Landings:
        height_above_start = _heights_above_start(search, rows, cols, from_height)
        is_over_edge = ~(np.abs(height_above_start) <= search.max_step).any(axis=0)
        height_of_lower_floors = np.where(
            height_above_start < -search.max_step, height_above_start, -np.inf
        )
        landing_level = height_of_lower_floors.argmax(axis=0)
        can_land = is_over_edge & (height_of_lower_floors.max(axis=0) >= -max_drop)
        can_land &= search.is_free[landing_level, rows, cols]
        return Landings(landing_level, can_land, continues=np.asarray(is_over_edge))

    return check_landing


def _make_jump_test(search: LinkSearch, rule: LinkSettings) -> LandingTest:
    """Make the function that tests where lines over a gap land as jumps.

    A line may land after at least one cell between. Of the floors there, it lands on the one
    nearest in height to its start, if that is free and at most a step higher or lower; the rule's
    height, if it has one, takes the place of the step. The line goes on as long as no floor lies
    within a step of its start's height.
    """
    max_rise = LIMIT_SLACK + (rule.height or search.max_step)

    def check_landing(rows: Int, cols: Int, from_height: Float, num_between: int) -> Landings:
        height_above_start = _heights_above_start(search, rows, cols, from_height)
        is_over_edge = ~(np.abs(height_above_start) <= search.max_step).any(axis=0)
        landing_level = np.abs(height_above_start).argmin(axis=0)
        can_land = (np.abs(height_above_start).min(axis=0) <= max_rise) & (num_between > 0)
        can_land &= search.is_free[landing_level, rows, cols]
        return Landings(landing_level, can_land, continues=np.asarray(is_over_edge))

    return check_landing
