"""Masks of nav2's costmap filters: where robots stay out, and how fast they go.

A mask is a map on the cells of its level, in mode ``raw``; 0 changes nothing. In a keepout mask,
100 is forbidden and less is a cost. In a speed mask, a value of 1 to 100 stands for the speed limit
``base + multiplier * value``: in percent of a robot's speed for type 1, in m/s for type 2. Type,
base and multiplier are parameters of nav2's ``costmap_filter_info_server``. They are written beside
the mask, with the parameters of the ``map_server`` that serves it: ``slow_filter.yaml`` beside
``slow.yaml``.

Source: ``keepout_filter.cpp``, ``speed_filter.cpp`` of ``nav2_costmap_2d`` and nav2's documentation
of both.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from navbake.errors import FormatError
from navbake.files import readable_stem
from navbake.formats.allowance import JsonPath, check_number, check_object
from navbake.formats.level_paths import check_written_level, list_level_paths
from navbake.formats.nav2 import IMAGE_SUFFIXES, YAML_SUFFIXES, encode_map, read_map
from navbake.formats.navgrid import check_grid
from navbake.formats.occupancy import FREE, INSCRIBED, OCCUPIED, OccupancyValues, level_from_values
from navbake.formats.shapes import read_room_outlines
from navbake.formats.source import Files, check_path, read_yaml_source
from navbake.known_names import check_choice, list_first, suggest
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.islands import renew_islands
from navbake.navgrid.lattice import cover_cells, touch_cells
from navbake.navgrid.links import DEFAULT_SPEED, MAX_AREAS, Agent, Area
from navbake.runtime.agents import find_agent
from navbake.types import Bool, Json

LOG = logging.getLogger(__name__)
# types of filters, by nav2's numbers
KEEPOUT = 0
SPEED_PERCENT = 1
SPEED_ABSOLUTE = 2
MAX_VALUE = 100  # of a mask
MAX_LISTED_NAMES = 20  # names that an error lists
# a value is used even if its limit is higher than the wanted one by this share, for rounding
LIMIT_SLACK = 1e-9
ROUND_MULTIPLIERS = (1.0, 0.5, 0.1, 0.05, 0.01)  # tried in this order [m/s]


class Zone(NamedTuple):
    """A room or a named polygon of a level, which a mask of a costmap filter can mark.

    Attributes:
        names: all names that a user may give for it.
        level: number of its level.
        room_index: the room's index on its level; None for a polygon.
        mask: the polygon's cells, bool, shape (height, width); None for a room.
    """

    names: tuple[str, ...]
    level: int
    room_index: int | None
    mask: Bool | None


class FilterScale(NamedTuple):
    """The scale of a speed mask: a value stands for the speed limit ``base + multiplier * value``.

    Attributes:
        type: nav2's number of the type of filter, such as `SPEED_PERCENT`.
        base: the limit that the value 0 would stand for [% or m/s].
        multiplier: by how much the limit grows for each 1 of the value [% or m/s].
    """

    type: int = KEEPOUT
    base: float = 0.0
    multiplier: float = 1.0


def encode_mask(
    grid: NavGrid,
    path: Path,
    *,
    is_speed_mask: bool,
    level: int | None = None,
    image: str | None = None,
    zone: Sequence[str] | None = None,
    zones: str | PathLike[str] | None = None,
    agent: str | Agent | None = None,
    absolute: bool | None = None,
) -> Files:
    """Encode the masks of the keepout filter, or of the speed filter, one for each level.

    Without zones, the masks mark the grid's areas: a keepout mask the areas that bar the agent, a
    speed mask the areas with a speed limit. Limits are rounded down. A keepout mask leaves out the
    finite costs of areas, with a warning. Masks that mark no cell get one, too.

    Args:
        grid: the grid.
        path: the masks' YAML, see `encode_nav2`; its mode is ``raw``.
        is_speed_mask: True for the speed filter, whose zones have limits; False for the keepout
            filter.
        level: the number of the only level to write, None for all.
        image: ``pgm`` or ``png``; ``pgm`` if None.
        zone: the zones to mark: names, ids or numbers of rooms, and names of polygons. For the
            speed filter, each is ``NAME=PERCENT``, with 1 to 100 percent; where zones overlap, the
            lowest limit counts. For the keepout filter, None means all polygons.
        zones: a GeoJSON file of polygons, see `navbake.formats.shapes.read_room_outlines`. A
            keepout mask marks every cell that a polygon touches, a speed mask every cell whose
            centre is in one.
        agent: the agent for masks of areas: its name in the grid, or the agent itself; its speed is
            100 %.
        absolute: whether to write limits of areas in m/s, not in percent.

    Returns:
        The content of each file by its path: the masks' YAMLs and images, and the filters'
        parameters.

    Raises:
        FormatError: a name is unknown, a limit is invalid or rounded down to 0, a polygon marks no
            cell of its level, or there is nothing to mark.
        QueryError: the grid has no such agent.
    """
    image = image or "pgm"
    check_choice(image, IMAGE_SUFFIXES, "image", FormatError)
    if zone is None and zones is None and grid.areas:
        mask_agent = find_agent(grid, agent)
        masks, scale = _mark_areas(grid, mask_agent, is_speed_mask, bool(absolute))
    else:
        if agent is not None or absolute:
            raise FormatError("agent and absolute are for masks of the grid's areas, without zones")
        masks = _mark_zones(grid, zone, zones, is_speed_mask)
        scale = FilterScale(SPEED_PERCENT if is_speed_mask else KEEPOUT)
    files: Files = {}
    path_of_level = list_level_paths(grid, path, level, YAML_SUFFIXES)
    if not any(masks[level_number].any() for level_number in path_of_level):
        marked_levels = [f"level {number}" for number, mask in enumerate(masks) if mask.any()]
        reason = "the zones or areas have none"
        if marked_levels:
            reason = f"the zones or areas are on {list_first(marked_levels, MAX_LISTED_NAMES)}"
        LOG.warning("%s marks no cell: %s", path.name, reason)
    for level_number, yaml_path in path_of_level.items():
        files |= encode_map(grid.levels[level_number], masks[level_number], yaml_path, "raw", image)
        filter_name = "speed" if is_speed_mask else "keepout"
        mask_topic = f"{filter_name}_filter_mask"
        filter_parameters = {
            "type": scale.type,
            "filter_info_topic": f"{filter_name}_filter_info",
            "mask_topic": mask_topic,
            "base": scale.base,
            "multiplier": scale.multiplier,
        }
        map_server_parameters = {
            "yaml_filename": yaml_path.name,
            "topic_name": mask_topic,
            "frame_id": "map",
        }
        content = {
            f"{filter_name}_costmap_filter_info_server": {"ros__parameters": filter_parameters},
            f"{filter_name}_filter_mask_server": {"ros__parameters": map_server_parameters},
        }
        parameters_text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
        files[_find_parameters_path(yaml_path)] = parameters_text.encode()
    return files


encode_keepout = partial(encode_mask, is_speed_mask=False)
encode_speed = partial(encode_mask, is_speed_mask=True)


def _mark_areas(
    grid: NavGrid, agent: Agent | None, is_speed_mask: bool, absolute: bool
) -> tuple[list[OccupancyValues], FilterScale]:
    """Make the mask of each level from the grid's areas; return the masks and their scale."""
    value_of_area = np.zeros(len(grid.areas) + 1, dtype=np.int8)  # of each area; areas count from 1
    scale = FilterScale()
    if is_speed_mask:
        agent_speed = DEFAULT_SPEED if agent is None else agent.speed
        scale = FilterScale(SPEED_PERCENT)
        limit_per_value = agent_speed / 100.0  # the limit that the value 1 stands for [m/s]
        if absolute:
            limit_per_value = _find_multiplier(
                [area.speed for area in grid.areas if area.speed is not None]
            )
            scale = FilterScale(SPEED_ABSOLUTE, 0.0, limit_per_value)
    for area_number, area in enumerate(grid.areas, 1):
        if not is_speed_mask:
            value_of_area[area_number] = OCCUPIED if area.bars(agent) else FREE
        elif area.speed is not None:
            mask_value = math.floor(area.speed / limit_per_value * (1.0 + LIMIT_SLACK))
            value_of_area[area_number] = min(mask_value, MAX_VALUE)
            if not value_of_area[area_number]:
                raise FormatError(
                    f"expected a speed of {limit_per_value:g} m/s or more, which a value of 1 "
                    f"stands for, got {area.speed:g} m/s in area {area.name!r}",
                    key="speed",
                    value=area.speed,
                    expected=f"a speed of {limit_per_value:g} m/s or more",
                )
    if not value_of_area.any():
        reason = "bars this agent" if agent else "bars all agents"
        if is_speed_mask:
            reason = "has a speed"
        hint = "give --zone or --zones, or paint `areas` in the settings of the bake"
        raise FormatError(f"a mask needs zones or areas, and no area of the grid {reason}: {hint}")
    costly_area_names = [
        area.name for area in grid.areas if area.cost != 1.0 and not area.bars(agent)
    ]
    if costly_area_names and not is_speed_mask:
        LOG.warning(
            "a keepout mask has no costs of areas: left out of %s", ", ".join(costly_area_names)
        )
    return [value_of_area[level.area_index] for level in grid.levels], scale


def _find_multiplier(speeds: Sequence[float]) -> float:
    """Find a multiplier [m/s] by which values up to 100 can stand for all of some speeds [m/s].

    It is the first of `ROUND_MULTIPLIERS` of which all speeds are whole multiples. If there is
    none, it is a hundredth of the largest speed.
    """
    max_speed = max(speeds, default=1.0)
    for multiplier in ROUND_MULTIPLIERS:
        if max_speed > MAX_VALUE * multiplier:
            continue
        values = [speed / multiplier for speed in speeds]
        if all(abs(value - round(value)) < 1e-6 * max(value, 1.0) for value in values):
            return multiplier
    return max_speed / 100.0


def _mark_zones(
    grid: NavGrid,
    zone: Sequence[str] | None,
    zones_path: str | PathLike[str] | None,
    is_speed_mask: bool,
) -> list[OccupancyValues]:
    """Make the mask of each level from zones, see `encode_mask` for the arguments."""
    if isinstance(zone, str):
        expected = f"a list of zones, as in [{zone!r}]"
        raise FormatError(
            f"expected {expected}, got {zone!r}", key="zone", value=zone, expected=expected
        )
    available_zones = _find_zones(grid, zones_path, is_speed_mask)
    marked_zones: list[tuple[Zone, int]] = []  # (zone, value of its cells)
    if zone is None and not is_speed_mask:
        marked_zones = [
            (polygon, OCCUPIED) for polygon in available_zones if polygon.mask is not None
        ]
    for zone_text in zone or []:
        name = zone_text
        mask_value = OCCUPIED
        if is_speed_mask:
            name, _, percent_text = zone_text.rpartition("=")
            is_number = percent_text.isdecimal() and len(percent_text) <= 3
            if not (name and is_number and 1 <= int(percent_text) <= 100):
                expected = "NAME=PERCENT, 1 to 100, as zone"
                raise FormatError(
                    f"expected {expected}, got {zone_text!r}",
                    key="zone",
                    value=zone_text,
                    expected=expected,
                )
            mask_value = int(percent_text)
        matching_zones = [candidate for candidate in available_zones if name in candidate.names]
        if not matching_zones:
            owner_text = "the grid" if zones_path is None else f"the grid or {zones_path}"
            zone_names = (candidate.names[-1] for candidate in available_zones)
            hint = suggest(name, zone_names, MAX_LISTED_NAMES, owner_text)
            raise FormatError(
                f"no room or polygon is called {name!r}: {hint}", key="zone", value=name, hint=hint
            )
        # on all levels with that name
        marked_zones += [(matching_zone, mask_value) for matching_zone in matching_zones]
    if not marked_zones:
        raise FormatError("a mask needs zones: rooms by name, id or number, or polygons (GeoJSON)")
    masks: list[OccupancyValues] = [
        np.full(level.shape, FREE, dtype=np.int8) for level in grid.levels
    ]
    # the least value is written last, so it counts where zones overlap
    for marked_zone, mask_value in sorted(marked_zones, key=lambda mark: -mark[1]):
        is_marked = marked_zone.mask
        if is_marked is None:
            is_marked = grid.levels[marked_zone.level].room_index == marked_zone.room_index
        masks[marked_zone.level][is_marked] = mask_value
    return masks


def _find_zones(
    grid: NavGrid, zones_path: str | PathLike[str] | None, is_speed_mask: bool
) -> list[Zone]:
    """Return the rooms of a grid and the polygons of a file as zones.

    In a speed mask, a polygon has the cells whose centre is in it; else all cells that it touches.
    """
    zones = []
    for room in grid.rooms:
        room_names = [str(room.index), room.id]
        if room.name:
            room_names.append(room.name)
        zones.append(Zone(tuple(room_names), room.level, room.index, None))
    level_names = grid.level_names
    for feature_index, outline in enumerate(
        [] if zones_path is None else read_room_outlines(zones_path)
    ):
        name = outline["name"] or f"feature {feature_index}"
        stated_level = outline["level"]
        level_number = (
            level_names.index(stated_level) if stated_level in level_names else stated_level
        )
        if not isinstance(level_number, int) or level_number >= len(level_names):
            polygon_text = f"{name!r} in {zones_path}"
            names_text = ", ".join(level_names)
            raise FormatError(
                f"no level {stated_level!r}, which {polygon_text} is on: the grid has {names_text}",
                path=str(zones_path),
                key="level",
                value=stated_level,
            )
        rings = [outline["points"], *outline["rings"]]
        lattice = grid.levels[level_number].lattice
        is_touched = touch_cells(rings, lattice)
        is_in_zone = cover_cells(rings, lattice) if is_speed_mask else is_touched
        if not is_in_zone.any():
            fault = f"lies outside of level {level_number}: it holds no cell"
            if is_touched.any():
                fault = f"is thinner than a cell of level {level_number}: it holds no cell's centre"
            raise FormatError(f"{name!r} in {zones_path} {fault}", path=str(zones_path), value=name)
        zones.append(Zone((name,), level_number, None, is_in_zone))
    return zones


def _find_parameters_path(path: Path) -> Path:
    """Return the path of the file with the filter's parameters, beside a mask's YAML."""
    return path.with_name(f"{path.stem}_filter{path.suffix}")


# ---------------------------------------------------------------- reading


def read_mask(
    path: str | PathLike[str],
    *,
    is_speed_mask: bool,
    grid: NavGrid | None = None,
    level: int = 0,
    agent: str | Agent | None = None,
) -> NavGrid:
    """Read a mask of the keepout or speed filter as areas: one for each value above 0.

    In a keepout mask, 99 and 100 bar all agents, and lower values are nav2's costs.

    Args:
        path: the mask's YAML. The filter's parameters are read where `encode_mask` writes them;
            without them, values are percent.
        is_speed_mask: whether the mask is one of the speed filter.
        grid: the grid that gets the areas, after those that it has; None for a new grid of free
            cells. A cell gets the mask's value at its centre.
        level: the number of the grid's level that the mask belongs to.
        agent: the agent whose speed is 100 %: a name in the grid, or an agent; 1 m/s if None.

    Returns:
        A new grid with the areas.

    Raises:
        FormatError: a file is broken, there is no such level, or there are too many areas.
        QueryError: the grid has no such agent.
    """
    mask_values, mask_lattice, map_yaml = read_map(path)
    if grid is None:
        free_values = np.zeros_like(mask_values)
        level = 0
        metadata: Json = {"sceneId": readable_stem(path), "navbake": {}}
        grid = level_from_values(free_values, mask_lattice, map_yaml.ground, metadata)
        check_grid(grid, JsonPath(check_path(path)))
    check_written_level(grid, level)

    # the mask's value at each cell's centre
    lattice = grid.levels[level].lattice
    rows, cols = mask_lattice.rows_cols(lattice.positions(*np.indices(lattice.shape)))
    is_inside = (rows >= 0) & (rows < mask_lattice.height)
    is_inside &= (cols >= 0) & (cols < mask_lattice.width)
    values = np.zeros(lattice.shape, dtype=np.int8)
    values[is_inside] = mask_values[rows[is_inside], cols[is_inside]]

    mask_agent = find_agent(grid, agent)
    agent_speed = DEFAULT_SPEED if mask_agent is None else mask_agent.speed
    scale = _read_parameters(Path(path)) if is_speed_mask else FilterScale()
    areas = list(grid.areas)
    area_index = grid.levels[level].area_index.copy()
    used_names = {area.name for area in areas}
    for mask_value in np.unique(values[values > FREE]).tolist():
        area = _make_area(mask_value, scale, is_speed_mask, agent_speed)
        name = area.name
        suffix = 2
        while name in used_names:
            name = f"{area.name} ({suffix})"
            suffix = suffix + 1
        used_names.add(name)
        areas.append(Area(name, area.cost, area.speed))
        if len(areas) > MAX_AREAS:
            message = f"expected at most {MAX_AREAS} areas, got more by {path}"
            raise FormatError(message, path=str(path), expected=f"at most {MAX_AREAS} areas")
        area_index[values == mask_value] = len(areas)

    area_table = {"areas": [area.to_json() for area in areas]}
    levels = []
    for level_number, grid_level in enumerate(grid.levels):
        metadata = {**grid_level.metadata, "navbake": {**grid_level.navbake, **area_table}}
        attributes = {"area": area_index} if level_number == level else {}
        levels.append(grid_level.with_layers(attributes=attributes, metadata=metadata))
    metadata = {**grid.metadata, "navbake": {**grid.navbake, **area_table}}
    marked_grid: NavGrid = grid.with_levels(levels, metadata)
    renew_islands(marked_grid)
    return marked_grid


def read_keepout(
    path: str | PathLike[str], *, grid: NavGrid | None = None, level: int = 0
) -> NavGrid:
    """Read a mask of the keepout filter as areas of a grid, see `read_mask`.

    Args:
        path: the mask's YAML.
        grid: the grid that gets the areas, None for a new grid of free cells.
        level: the number of the grid's level that the mask is of.

    Returns:
        A new grid with the areas.

    Raises:
        FormatError: a file is broken, there is no such level, or there are too many areas.
    """
    return read_mask(path, is_speed_mask=False, grid=grid, level=level)


def read_speed(
    path: str | PathLike[str],
    *,
    grid: NavGrid | None = None,
    level: int = 0,
    agent: str | Agent | None = None,
) -> NavGrid:
    """Read a mask of the speed filter as areas of a grid, see `read_mask`.

    Args:
        path: the mask's YAML.
        grid: the grid that gets the areas, None for a new grid of free cells.
        level: the number of the grid's level that the mask is of.
        agent: the agent whose speed is 100 %: a name in the grid, or an agent; 1 m/s if None.

    Returns:
        A new grid with the areas.

    Raises:
        FormatError: a file is broken, there is no such level, or there are too many areas.
        QueryError: the grid has no such agent.
    """
    return read_mask(path, is_speed_mask=True, grid=grid, level=level, agent=agent)


def _make_area(
    mask_value: int, scale: FilterScale, is_speed_mask: bool, agent_speed: float
) -> Area:
    """Make the area for the cells of a mask with some value."""
    if not is_speed_mask:
        if mask_value >= INSCRIBED:
            return Area("keepout" if mask_value == OCCUPIED else f"keepout {mask_value}", math.inf)
        return Area(f"cost {mask_value}", float(1 + math.ceil(251 * (mask_value - 1) / 97)))
    speed_limit = round(scale.base + scale.multiplier * mask_value, 9)
    speed = (
        speed_limit if scale.type == SPEED_ABSOLUTE else round(speed_limit / 100.0 * agent_speed, 9)
    )
    name = (
        f"speed {speed_limit:g} m/s" if scale.type == SPEED_ABSOLUTE else f"speed {speed_limit:g} %"
    )
    # nav2 takes a limit of 0 and less as no limit
    return Area(name, 1.0, speed if speed > 0 else None)


def _read_parameters(path: Path) -> FilterScale:
    """Read the scale of a mask's values from the parameters beside it; else values are percent."""
    parameters_path = _find_parameters_path(path)
    if not parameters_path.exists():
        return FilterScale(SPEED_PERCENT)
    content, name = read_yaml_source(parameters_path, expected="the parameters of a filter")
    place = JsonPath(name)
    for node_name, entry in check_object(content, place).items():
        node_place = place[str(node_name)]
        parameters = check_object(check_object(entry, place).get("ros__parameters"), node_place)
        if "multiplier" in parameters and "type" in parameters:
            filter_type = check_number(parameters.get("type"), node_place["type"])
            base = check_number(parameters.get("base"), node_place["base"])
            multiplier = check_number(parameters.get("multiplier"), node_place["multiplier"])
            if filter_type not in (SPEED_PERCENT, SPEED_ABSOLUTE):
                node_place["type"].refuse("1 (percent) or 2 (m/s)", parameters["type"])
            return FilterScale(int(filter_type), float(base), float(multiplier))
    place.fail("expected a node with type, base and multiplier")
