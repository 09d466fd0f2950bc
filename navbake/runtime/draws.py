"""Draws random places, poses and crowds of agents, and lists reachable points of a lattice.

Each public function does the work of the method of `navbake.runtime.path_finder.PathFinder` of the
same name. Callers update their `search` to the grid's present obstacles before the call.

A crowd is drawn by Poisson-disc sampling with dart throwing (Cook 1986): the agents one after the
other, each on a random cell that is far enough from all agents before. If an agent finds no such
cell, the whole crowd is drawn again, up to `MAX_CROWDS` times. At last, agents are packed row by
row.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.generators import as_generator
from navbake.lengths import format_position
from navbake.navgrid.cells import check_level
from navbake.runtime.flat_grid import FlatGrid, RealNumber, check_distance
from navbake.runtime.inflation import check_radius, ledges_setting
from navbake.runtime.places import DISTANCE_SLACK, cells_in_annulus, clearance, try_step
from navbake.runtime.search import Search
from navbake.runtime.surroundings import find_free
from navbake.types import Bool, Float, Int

EDGE_SHARE = 1e-6  # share of a cell: how far from its edges a point stays
STRATA = ("area", "room", "island")  # allowed values of `stratify`
LATTICE_STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])  # along x and y
ARRIVAL_TOLERANCE = 1e-4  # share of a cell by which a step may miss its end
RADIUS_SLACK = 1e-9  # share of a radius by which a disc may overlap a square, for rounding
MAX_CROWDS = 8  # how often a random crowd is tried before agents are packed
NUM_DARTS = 32  # how many random cells are drawn at once
NUM_SHIFTS = 3  # how many shifts of the honeycomb are tried along each axis
HEXAGON_SLACK = 1e-6  # share by which hexagons are narrower than the least distance of agents
FIT_HINT = "expected fewer agents, or a smaller min_distance or clearance"


class Pose(NamedTuple):
    """An agent's position and heading."""

    position: Float  #: World x, y and floor z [m], shape (3,), float64.
    heading: float  #: 0 along x, counted towards y, -pi to pi [rad].


class Spawns(NamedTuple):
    """Start poses of n agents."""

    positions: Float  #: World x, y and floor z [m], shape (n, 3), float64.
    headings: Float  #: 0 along x, counted towards y, -pi to pi [rad], shape (n,).


class SpawnRules(NamedTuple):
    """Where agents may start; see the arguments of `PathFinder.spawn`.

    Attributes:
        rooms: ids or names of the rooms; None for anywhere.
        level: number of the level; None for any.
        island: number of the island; None for any.
        reachable_from: a free position, world x, y, z [m]: agents start only where a path from it
            leads. None for no such condition.
        clearance: radius of a disc round each agent that overlaps no obstacle [m]; None for no
            such condition.
        min_distance: least distance between the centres of any two agents [m]; None for twice the
            radius.
        facing: a position or a heading [rad]; None for random headings.
        stratify: ``area``, ``room``, ``island`` or None.
    """

    rooms: str | Sequence[str] | None
    level: int | None
    island: int | None
    reachable_from: ArrayLike | None
    clearance: float | None
    min_distance: float | None
    facing: ArrayLike | None
    stratify: str | None


class Spacing(NamedTuple):
    """How far apart agents must be. Two agents clash if they are too near on the map and in height.

    Attributes:
        distance: they are too near on the map if their centres are at most this far apart [m].
        height: they are too near in height if their floors differ by less than this [m].
    """

    distance: float
    height: float


# ---------------------------------------------------------------- places


def random_point(
    search: Search,
    rng: Generator | None,
    count: int | None,
    *,
    level: int | None,
    room: str | None,
    island: int | None,
    reachable_from: ArrayLike | None,
    anywhere: bool,
    outdoors: bool,
) -> Float:
    """Draw places where an agent can stand, uniformly by area.

    `PathFinder.random_point` describes the arguments after `search`.
    """
    islands = search.allowed_islands(island, reachable_from)
    is_allowed = search.mark_allowed(level=level, room=room, islands=islands, outdoors=outdoors)
    cells = np.flatnonzero(is_allowed)
    island_text = ", ".join(map(str, islands or ()))
    selection_limits: dict[str, object] = {
        "level": level,
        "room": room,
        "island": island_text or None,
        **_describe_outdoors(outdoors),
    }
    return _draw_places(search, cells, rng, count, anywhere, selection_limits)


def random_point_near(
    search: Search,
    rng: Generator | None,
    position: ArrayLike,
    max_distance: float,
    count: int | None,
    *,
    min_distance: float,
    straight: bool,
    room: str | None,
    level: int | None,
    anywhere: bool,
) -> Float:
    """Draw places near a position, uniformly by area.

    `PathFinder.random_point_near` describes the arguments after `search`.
    """
    cells = _find_cells_near(search, position, min_distance, max_distance, straight, level)
    if room is not None:
        cells = cells[search.rooms.number[cells] == search.rooms.find(room)]
    selection_limits = {"room": room, **_describe_distances(min_distance, max_distance)}
    return _draw_places(search, cells, rng, count, anywhere, selection_limits)


def any_free_in_annulus(
    search: Search,
    position: ArrayLike,
    min_distance: float,
    max_distance: float,
    level: int | None,
) -> bool:
    """Return whether any free cell on a position's level has its centre in an annulus round it.

    Args:
        search: the search on the grid.
        position: world x, y, z [m].
        min_distance: inner radius [m].
        max_distance: outer radius [m].
        level: the position's level; None finds it by z.
    """
    cells = _find_cells_near(search, position, min_distance, max_distance, True, level)
    return len(cells) > 0


def random_pose(
    search: Search,
    rng: Generator | None,
    target: ArrayLike | None,
    *,
    min_distance: float,
    max_distance: float,
    in_sight: bool,
    same_room: bool,
    level: int | None,
    outdoors: bool,
) -> Pose:
    """Draw a pose, facing a target if there is one.

    `PathFinder.random_pose` describes the arguments after `search`.
    """
    rng = as_generator(rng)
    if target is None:
        cells = np.flatnonzero(search.mark_allowed(level=level, outdoors=outdoors))
        level_limits = {"level": level, **_describe_outdoors(outdoors)}
        place = _draw_places(search, cells, rng, None, False, level_limits)
        return Pose(place, float(rng.uniform(-math.pi, math.pi)))
    cells = _find_cells_near(search, target, min_distance, max_distance, True, level)
    if not outdoors:
        cells = cells[~search.mark_outdoors()[cells]]
    flat = search.flat
    room_numbers = search.rooms.number
    target_position, target_cell = flat.locate(target, level)
    if same_room:
        target_room = room_numbers[target_cell]
        cells = cells[(room_numbers[cells] == target_room) & (target_room > 0)]
    if in_sight:
        # the first in a random order that sees the target: uniform among all that do
        cells = rng.permutation(cells)
        cell_positions = np.ascontiguousarray(flat.positions(cells)[:, :2])
        visible_index = search.first_in_sight(
            target_cell, target_position, cells, cell_positions, room_numbers
        )
        cells = cells[visible_index : visible_index + 1] if visible_index >= 0 else cells[:0]
    selection_limits = {
        **_describe_distances(min_distance, max_distance),
        "in sight": in_sight,
        **_describe_outdoors(outdoors),
    }
    place = _draw_places(search, cells, rng, None, False, selection_limits)
    target_vector = target_position[:2] - place[:2]
    return Pose(place, math.atan2(target_vector[1], target_vector[0]))


def reachable_positions(
    search: Search, start: ArrayLike, spacing: float, level: int | None
) -> Float:
    """List the points of a square lattice that an agent reaches from a start, step by step.

    This is the code of `PathFinder.reachable_positions`.

    Args:
        search: the search on the grid.
        start: world x, y, z [m].
        spacing: the spacing of the lattice [m], at least a cell's size.
        level: the start's level; None finds it by z.

    Returns:
        World x, y and floor z of the points [m], shape (n, 3): the start, then the other points,
        sorted by the number of moves that lead to them.
    """
    flat = search.flat
    radius = search.grid.radius
    largest_cell_size = float(flat.layout.cell_size.max())
    least_spacing = largest_cell_size * (1 - ARRIVAL_TOLERANCE)
    if not isinstance(spacing, RealNumber) or not least_spacing <= spacing < np.inf:
        raise QueryError(
            f"expected a spacing of a cell's {largest_cell_size:g} m or more, got {spacing!r}"
        )
    start_position, start_cell = flat.free_cell_at(start, level)
    start_place = np.append(start_position[:2], flat.positions(start_cell)[2])
    # The places that the last round of steps reached, and how many lattice spacings each of them
    # lies from the start along x and y.
    places = start_place[None]
    lattice_indices = np.zeros((1, 2), dtype=np.int64)
    seen_indices = {(int(flat.level_of(start_cell)), 0, 0)}
    reached_places = [places]
    while len(places):
        lattice_indices = (lattice_indices[:, None] + LATTICE_STEPS).reshape(-1, 2)
        step_ends = start_place[:2] + lattice_indices * spacing
        step_starts = np.repeat(places, len(LATTICE_STEPS), axis=0)
        places = try_step(search, step_starts, step_ends, slide=False, level=None)
        has_arrived = np.abs(places[:, :2] - step_ends) <= ARRIVAL_TOLERANCE * largest_cell_size
        has_arrived = has_arrived.all(axis=1)
        lattice_indices = lattice_indices[has_arrived]
        places = places[has_arrived]
        cells = flat.cells_at(places)
        is_new = []
        index_lists = lattice_indices.T.tolist()
        for level_and_indices in zip(flat.level_of(cells).tolist(), *index_lists, strict=True):
            is_new.append(level_and_indices not in seen_indices)
            seen_indices.add(level_and_indices)
        lattice_indices = lattice_indices[is_new]
        places = places[is_new]
        cells = cells[is_new]
        # free cells' centres are free of obstacles; elsewhere, measure the clearance
        center_distances = np.abs(places - flat.positions(cells))[:, :2].max(axis=1)
        cell_sizes = flat.layout.cell_size[flat.level_of(cells)]
        is_at_center = center_distances <= ARRIVAL_TOLERANCE * cell_sizes
        clearances = clearance(search, places, None, 2.0 * radius + 1.0)
        can_stand = is_at_center | (clearances >= radius * (1.0 - RADIUS_SLACK))
        lattice_indices = lattice_indices[can_stand]
        places = places[can_stand]
        reached_places.append(places)
    return np.concatenate(reached_places)


def _draw_places(
    search: Search,
    cells: Int,
    rng: Generator | None,
    count: int | None,
    anywhere: bool,
    selection_limits: dict[str, object],
) -> Float:
    """Draw places in some cells.

    Args:
        search: the search on the grid.
        cells: flat ids of free cells.
        rng: the generator; None for a new one.
        count: how many places; None for one, of shape (3,).
        anywhere: whether places are anywhere in the cells, else at their centres.
        selection_limits: name -> value: how the cells were selected, for the error if there are
            none.

    Returns:
        World x, y and floor z [m], shape (3,) or (count, 3).
    """
    rng = as_generator(rng)
    if count is not None and (not isinstance(count, int | np.integer) or count < 0):
        expected = "a count >= 0"
        raise QueryError(
            f"expected {expected}, got {count!r}", key="count", value=count, expected=expected
        )
    if not len(cells):
        limit_texts = [
            f"{name} {value}"
            for name, value in selection_limits.items()
            if value is not None and value is not False  # level 0 is one
        ]
        limits_text = f" with {', '.join(limit_texts)}" if limit_texts else ""
        raise QueryError(f"no free cell in {search.grid.scene_id!r}{limits_text}")
    flat = search.flat
    num_places = 1 if count is None else int(count)
    drawn_cells = cells[draw_cell_indices(flat, cells, rng, num_places)]
    positions = flat.positions(drawn_cells)
    if anywhere:
        cell_size = flat.layout.cell_size[flat.level_of(drawn_cells)]
        max_offset = 0.5 - EDGE_SHARE
        positions[:, :2] += (
            rng.uniform(-max_offset, max_offset, size=(num_places, 2)) * cell_size[:, None]
        )
    return positions.reshape(3) if count is None else positions


def _find_cells_near(
    search: Search,
    position: ArrayLike,
    min_distance: float,
    max_distance: float,
    straight: bool,
    level: int | None,
) -> Int:
    """List the free cells whose centres are at a distance from a position within given limits.

    Args:
        search: the search on the grid.
        position: world x, y, z [m]; free, unless `straight`.
        min_distance: the smallest distance [m].
        max_distance: the largest distance [m].
        straight: whether distances are straight lines on the position's level, else lengths of
            shortest paths from the position.
        level: the position's level; None finds it by z.

    Returns:
        Flat ids, ascending.
    """
    are_numbers = isinstance(min_distance, RealNumber) and isinstance(max_distance, RealNumber)
    if not (are_numbers and 0 <= min_distance <= max_distance):
        expected = "0 <= min_distance <= max_distance [m]"
        raise QueryError(f"expected {expected}, got {min_distance} and {max_distance}")
    flat = search.flat
    center, position_cell = flat.locate(position, level)
    if position_cell < 0:
        place_text = f"in no cell of {search.grid.scene_id!r}"
        raise QueryError(f"{format_position(center)} is {place_text}: nothing is near")
    if straight:
        position_level = int(flat.level_of(position_cell))
        return cells_in_annulus(flat, position_level, center, min_distance, max_distance, flat.free)
    flat.free_cell_at(center, level)  # raises if the position isn't free
    lengths = search.lengths_from(np.array([position_cell]))
    is_near = (lengths >= min_distance) & (lengths <= max_distance + DISTANCE_SLACK)
    return np.flatnonzero(is_near & np.isfinite(lengths))  # inf <= inf where no path leads


def _describe_distances(min_distance: float, max_distance: float) -> dict[str, object]:
    """Return the entry of `selection_limits` of `_draw_places` for a range of distances."""
    return {"distance [m]": f"{min_distance:g} to {max_distance:g}"}


def _describe_outdoors(outdoors: bool) -> dict[str, object]:
    """Return the limit that an error states where places outdoors are left out."""
    return {} if outdoors else {"outdoors": "left out"}


# ---------------------------------------------------------------- crowds


def spawn(search: Search, rng: Generator | None, n: int, rules: SpawnRules) -> Spawns:
    """Draw collision-free start poses for many agents: `PathFinder.spawn`.

    Args:
        search: the search on the grid.
        rng: the generator; None for a new one.
        n: how many agents, >= 1.
        rules: where they may start.
    """
    rng = as_generator(rng)
    grid = search.grid
    level = rules.level
    check_level(level, search.flat.num_levels)
    agent_clearance = rules.clearance
    if agent_clearance is not None:
        check_radius(agent_clearance, "clearance")
        agent_clearance = float(agent_clearance)
    room_names = [rules.rooms] if isinstance(rules.rooms, str | int) else list(rules.rooms or ())
    if rules.rooms is not None and not room_names:
        raise QueryError("expected at least one room, got none")
    room_numbers = tuple(sorted({search.rooms.find(name) for name in room_names}))
    islands = search.allowed_islands(rules.island, rules.reachable_from)
    if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 1:
        expected = "a number of agents n >= 1"
        raise QueryError(f"expected {expected}, got {n!r}", key="n", value=n, expected=expected)
    stratify = rules.stratify
    if stratify not in (None, *STRATA):
        raise QueryError(f"expected {', '.join(STRATA)} or None as stratify, got {stratify!r}")
    min_distance = 0.0 if rules.min_distance is None else rules.min_distance
    check_distance(min_distance, "min_distance")
    radius = grid.radius
    if rules.min_distance is None:
        radius = max(radius, agent_clearance or 0.0)

    room_ids = [search.rooms.id_of(number) for number in room_numbers]
    place_text = f"in {', '.join(map(repr, room_ids or [grid.scene_id]))}"
    place_text += f" on level {level}" if level is not None else ""
    if islands is not None:
        plural_suffix = "s" if len(islands) > 1 else ""
        place_text += f" on island{plural_suffix} {', '.join(map(str, islands))}"

    def find_cells() -> Int:
        is_allowed = search.mark_allowed(level=level, islands=islands)
        if room_numbers:
            is_allowed = is_allowed & np.isin(search.rooms.number, room_numbers)
        if agent_clearance is not None:
            is_allowed = is_allowed & find_free(grid, agent_clearance, ledges_setting(grid))
        return sort_along_hilbert_curve(search.flat, np.flatnonzero(is_allowed))

    key = (room_numbers, level, islands, agent_clearance)
    cells = search.cached_result("spawns", key, find_cells)
    if not len(cells):
        clearance_text = "" if agent_clearance is None else f" with {agent_clearance:g} m round"
        raise QueryError(f"no free cell{clearance_text} {place_text}")
    cell_parts = _split_cells(search, cells, stratify, int(n), rng)
    # centres up to this distance apart clash, with slack for rounding
    min_spacing = max(2.0 * radius, min_distance - 2.0 * DISTANCE_SLACK, 0.0)
    if min_distance > 2.0 * radius:
        size_text = f"{min_distance:g} m apart"
    else:
        size_text = f"of radius {radius:g} m"
    agent_cells = place_crowd(
        search.flat,
        cell_parts,
        int(n),
        Spacing(min_spacing, grid.agent_height),
        rng,
        agents_text=f"{'1 agent' if n == 1 else f'{n} agents'} {size_text}",
        place_text=place_text,
    )
    positions = search.flat.positions(agent_cells)
    return Spawns(positions, _draw_headings(search, positions, rules.facing, rng))


def _split_cells(
    search: Search, cells: Int, stratify: str | None, num_agents: int, rng: Generator
) -> list[Int]:
    """Split cells into parts, among which the agents are divided evenly.

    Args:
        search: the search on the grid.
        cells: flat ids, in the order of Hilbert's curve.
        stratify: ``area`` for a part of equal area for each agent; ``room`` or ``island`` for a
            part for each room or island; None for one part.
        num_agents: number of agents.
        rng: the generator.

    Returns:
        The flat ids of each part; without cells of no room for ``room``.
    """
    if stratify is None:
        return [cells]
    if stratify == "area":
        return split_by_area(search.flat, cells, num_agents, rng.random())
    number_by_cell = search.rooms.number if stratify == "room" else search.islands.number
    part_numbers = number_by_cell[cells]
    if not part_numbers.any():
        scene_name = search.grid.scene_id
        raise QueryError(f"no {stratify} of {scene_name!r} has a free cell to spawn on")
    num_without_part = np.count_nonzero(part_numbers == 0)
    sort_indices = np.argsort(part_numbers, kind="stable")[num_without_part:]
    _, first_indices = np.unique(part_numbers[sort_indices], return_index=True)
    return np.split(cells[sort_indices], first_indices[1:])


def _draw_headings(
    search: Search, positions: Float, facing: ArrayLike | None, rng: Generator
) -> Float:
    """Compute the headings of agents [rad], shape (n,).

    They face `facing` if it is a position, are equal to it if it is a number, and random if it is
    None.
    """
    num_agents = len(positions)
    if facing is None:
        return rng.uniform(-math.pi, math.pi, size=num_agents)
    if isinstance(facing, RealNumber):
        if not math.isfinite(facing):
            raise QueryError(f"expected a finite heading [rad] as facing, got {facing!r}")
        return np.full(num_agents, math.remainder(facing, 2.0 * math.pi))
    target = search.flat.check_position(facing, 0, "position or heading as facing")
    directions = target[:2] - positions[:, :2]
    return np.arctan2(directions[:, 1], directions[:, 0])


def place_crowd(
    flat: FlatGrid,
    cell_parts: list[Int],
    num_agents: int,
    spacing: Spacing,
    rng: Generator,
    *,
    agents_text: str,
    place_text: str,
) -> Int:
    """Draw a cell for each agent of a crowd, so that no two agents clash.

    Args:
        flat: the grid.
        cell_parts: the cells where agents may stand, divided into parts, such as rooms: an array of
            flat ids for each part. Each part gets about equally many agents. Agents that don't fit
            into a part go to other parts.
        num_agents: how many agents.
        spacing: how far apart agents must be.
        rng: the generator.
        agents_text: the words for the agents in errors.
        place_text: the words for the cells in errors, such as ``in 'kitchen'``.

    Returns:
        Flat ids in random order, shape (num_agents,).

    Raises:
        QueryError: the agents don't fit.
    """
    largest_num_placed = 0
    max_num_agents = 0
    for attempt in range(MAX_CROWDS):
        # the part of each agent
        even_part_indices = np.tile(np.arange(len(cell_parts)), num_agents // len(cell_parts))
        leftover_part_indices = rng.permutation(len(cell_parts))[: num_agents % len(cell_parts)]
        part_of_agent = rng.permutation(np.concatenate([even_part_indices, leftover_part_indices]))
        agent_cells = _draw_crowd(flat, cell_parts, spacing, part_of_agent, rng)
        largest_num_placed = max(largest_num_placed, len(agent_cells))
        if largest_num_placed == num_agents:
            return agent_cells
        if attempt == 0:
            max_num_agents = bound_num_agents(flat, np.concatenate(cell_parts), spacing)
            if max_num_agents < num_agents:
                raise QueryError(
                    f"{agents_text}: at most {max_num_agents} fit {place_text}; {FIT_HINT}"
                )
    agent_cells = _pack_crowd(flat, np.concatenate(cell_parts), spacing, num_agents, rng)
    if len(agent_cells) == num_agents:
        return rng.permutation(agent_cells)
    largest_num_placed = max(largest_num_placed, len(agent_cells))
    limits_text = (
        f"places for {largest_num_placed} were found {place_text}, "
        f"and more than {max_num_agents} never fit"
    )
    raise QueryError(f"{agents_text}: {limits_text}; {FIT_HINT}")


def bound_num_agents(flat: FlatGrid, cells: Int, spacing: Spacing) -> int:
    """Compute an upper bound of the number of agents that fit on some cells.

    A hexagon as wide as the least distance between agents holds one agent at most. So the number of
    hexagons of a honeycomb that contain cells is a bound. Several shifted honeycombs are tried.

    Args:
        flat: the grid.
        cells: flat ids.
        spacing: how far apart agents must be.

    Returns:
        The smallest bound of all honeycombs.
    """
    width = spacing.distance * (1.0 - HEXAGON_SLACK)
    if width <= 0.0 or not len(cells):
        return len(cells)
    positions = flat.positions(cells)
    positions -= positions.min(axis=0)
    height = spacing.height
    layers = np.floor(positions[:, 2] / height) if height > 0 else np.zeros(len(cells))
    smallest_bound = len(cells)
    axes = (positions[:, 0], positions[:, 1])
    for x, y in (axes, axes[::-1]):
        for shift in np.ndindex(NUM_SHIFTS, NUM_SHIFTS):
            shift_offset = np.array(shift) * width / NUM_SHIFTS
            num_hexagons = _count_hexagons(x + shift_offset[0], y + shift_offset[1], layers, width)
            smallest_bound = min(smallest_bound, num_hexagons)
    return smallest_bound


def _count_hexagons(x: Float, y: Float, layers: Float, width: float) -> int:
    """Count the hexagons of a honeycomb that contain points; each layer has its own honeycomb.

    Args:
        x: x of the points [m], shape (n,).
        y: y of the points [m], shape (n,).
        layers: number of the layer that each point is in, shape (n,).
        width: distance between opposite corners of a hexagon [m].
    """
    # Axial coordinates q, r and s = -q - r of the hexagons, rounded. So that they add up to 0
    # again, the one with the largest rounding error is corrected.
    u = x / (width / 2)
    v = y / (width / 2)
    exact_coordinates = np.stack([math.sqrt(3.0) / 3.0 * u - v / 3.0, 2.0 / 3.0 * v])
    exact_coordinates = np.vstack([exact_coordinates, -exact_coordinates.sum(axis=0)])
    rounded_coordinates = np.round(exact_coordinates)
    largest_error = np.argmax(np.abs(rounded_coordinates - exact_coordinates), axis=0)
    rounded_coordinates[largest_error, np.arange(len(x))] -= rounded_coordinates.sum(axis=0)
    q, r = rounded_coordinates[:2] - rounded_coordinates[:2].min(axis=1, keepdims=True)
    hexagon_numbers = q + (q.max() + 1) * (r + (r.max() + 1) * layers)
    return len(np.unique(hexagon_numbers))


def _mark_taken(flat: FlatGrid, spacing: Spacing, is_taken: Bool, cell: int) -> None:
    """Mark the cells that are too near to an agent's cell for another agent, in `is_taken`."""
    center = flat.positions(cell)
    for level in range(flat.num_levels):
        near_cells = cells_in_annulus(flat, level, center, 0.0, spacing.distance, flat.free)
        if flat.num_levels > 1 or spacing.distance > spacing.height:
            rise = np.abs(flat.positions(near_cells)[:, 2] - center[2])
            near_cells = near_cells[rise < spacing.height]
        is_taken[near_cells] = True
    is_taken[cell] = True


def _draw_crowd(
    flat: FlatGrid, cell_parts: list[Int], spacing: Spacing, part_of_agent: Int, rng: Generator
) -> Int:
    """Draw a cell for each agent from its part, or from another part if its own is full.

    Args:
        flat: the grid.
        cell_parts: flat ids of the cells of each part.
        spacing: how far apart agents must be.
        part_of_agent: index of each agent's part, shape (n,).
        rng: the generator.

    Returns:
        The agents' flat ids; fewer than n if no part has room for another agent.
    """
    remaining_cells = list(cell_parts)
    agent_cells = np.empty(len(part_of_agent), dtype=np.int64)
    is_taken = np.zeros(flat.num_cells, dtype=np.bool_)

    def throw_darts(cells: Int) -> Int:
        """Draw `NUM_DARTS` of some cells at random, and return those where an agent may stand."""
        darts = cells[draw_cell_indices(flat, cells, rng, NUM_DARTS)] if len(cells) else cells
        return darts[~is_taken[darts]]

    for agent, assigned_part_index in enumerate(part_of_agent.tolist()):
        for part_index in (assigned_part_index, *rng.permutation(len(cell_parts)).tolist()):
            free_darts = throw_darts(remaining_cells[part_index])
            while not len(free_darts) and len(remaining_cells[part_index]):
                remaining_cells[part_index] = remaining_cells[part_index][
                    ~is_taken[remaining_cells[part_index]]
                ]
                free_darts = throw_darts(remaining_cells[part_index])
            if len(free_darts):
                break
        else:
            return agent_cells[:agent]
        agent_cells[agent] = free_darts[0]
        _mark_taken(flat, spacing, is_taken, int(free_darts[0]))
    return agent_cells


def _pack_crowd(
    flat: FlatGrid, cells: Int, spacing: Spacing, num_agents: int, rng: Generator
) -> Int:
    """Place agents row by row, each in the first cell that no other agent is too near to.

    At most `num_agents` agents are placed.
    Rows run along x or y, from a random side. Returns the agents' flat ids.
    """
    axis = rng.integers(2)
    signs = rng.choice([-1.0, 1.0], size=2)
    flipped_xy = flat.positions(cells)[:, :2] * signs
    is_taken = np.zeros(flat.num_cells, dtype=np.bool_)
    agent_cells: list[int] = []
    for cell in cells[np.lexsort((flipped_xy[:, axis], flipped_xy[:, 1 - axis]))].tolist():
        if len(agent_cells) < num_agents and not is_taken[cell]:
            agent_cells.append(cell)
            _mark_taken(flat, spacing, is_taken, cell)
    return np.array(agent_cells, dtype=np.int64)


def draw_cell_indices(flat: FlatGrid, cells: Int, rng: Generator, count: int) -> Int:
    """Draw indices into cells, with probability in proportion to the cells' areas.

    Args:
        flat: the grid.
        cells: flat ids, at least one if `count` is 1 or more.
        rng: the generator.
        count: how many indices; an index may be drawn more than once.

    Returns:
        Indices into `cells`, shape (count,), int64.
    """
    cell_sizes = flat.layout.cell_size
    if len(set(cell_sizes)) == 1:
        return rng.integers(len(cells), size=count)
    # cells of different areas: find the cells in which random values of the cumulative area lie
    cumulative_areas = np.cumsum(cell_sizes[flat.level_of(cells)] ** 2)
    random_areas = rng.uniform(0.0, cumulative_areas[-1], size=count)
    indices = np.searchsorted(cumulative_areas, random_areas, side="right")
    return np.minimum(indices, len(cells) - 1)


def split_by_area(flat: FlatGrid, cells: Int, num_parts: int, first_fraction: float) -> list[Int]:
    """Split cells into parts of about equal area; a part may be empty.

    Source: He and Owen, "Extensible grids: uniform sampling on a space filling curve" (2016).

    Args:
        flat: the grid.
        cells: flat ids, sorted by `sort_along_hilbert_curve`.
        num_parts: number of parts.
        first_fraction: how much of the cells' total area lies before the first part, 0 to 1: a
            random number gives random parts. Parts run from there to the last cell, and then on
            from the first cell.

    Returns:
        The flat ids of each part, `num_parts` arrays in order.
    """
    cumulative_areas = np.cumsum(flat.layout.cell_size[flat.level_of(cells)] ** 2)
    # a cell belongs to the part that contains its middle
    middle_fractions = (
        cumulative_areas - np.diff(cumulative_areas, prepend=0.0) / 2
    ) / cumulative_areas[-1]
    part_of_cell = np.floor(((middle_fractions - first_fraction) % 1.0) * num_parts).astype(
        np.int64
    )
    sort_indices = np.argsort(part_of_cell, kind="stable")
    return np.split(
        cells[sort_indices], np.searchsorted(part_of_cell[sort_indices], np.arange(1, num_parts))
    )


def sort_along_hilbert_curve(flat: FlatGrid, cells: Int) -> Int:
    """Sort cells by level and along the space-filling curve of Hilbert (1891).

    Args:
        flat: the grid.
        cells: flat ids.

    Returns:
        The flat ids in the order of the curve.
    """
    levels, rows, cols = flat.to_cells(cells)
    x = cols
    y = rows
    curve_indices = np.zeros_like(rows)  # of each cell along the curve
    largest_coordinate = int(max(rows.max(initial=0), cols.max(initial=0)))
    quarter_edge = 1 << max(largest_coordinate.bit_length() - 1, 0)
    while quarter_edge:
        is_right = (x & quarter_edge > 0).astype(np.int64)
        is_lower = (y & quarter_edge > 0).astype(np.int64)
        curve_indices += quarter_edge * quarter_edge * ((3 * is_right) ^ is_lower)
        # each quarter holds the curve of half the size, turned or mirrored to fit
        is_mirrored = (is_lower == 0) & (is_right == 1)
        x = np.where(is_mirrored, quarter_edge - 1 - x, x)
        y = np.where(is_mirrored, quarter_edge - 1 - y, y)
        turned_x = np.where(is_lower == 0, y, x)
        turned_y = np.where(is_lower == 0, x, y)
        x = turned_x & (quarter_edge - 1)
        y = turned_y & (quarter_edge - 1)
        quarter_edge >>= 1
    return cells[np.lexsort((curve_indices, levels))]
