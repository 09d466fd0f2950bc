"""Masks of nav2's costmap filters: where robots stay out, and how fast they go.

A mask is a map on the cells of its level, in mode ``raw``; 0 changes nothing. In a keepout mask,
100 is forbidden and less is a cost. In a speed mask, a value of 1 to 100 stands for a limit of
``base + multiplier * value``: of type 1 in percent of a robot's speed, of type 2 in m/s. These
numbers are in the parameters of nav2's ``costmap_filter_info_server``, which are written beside
the mask with those of the ``map_server`` that serves it: ``slow_filter.yaml`` beside ``slow.yaml``.

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
from typing import Any, NamedTuple

import numpy as np
import yaml

from navbake.errors import FormatError
from navbake.files import readable_stem
from navbake.formats.allowance import JsonPath, check_number, check_object
from navbake.formats.convert import check_level, list_level_paths
from navbake.formats.nav2 import IMAGES, YAMLS, check_choice, encode_map, read_map
from navbake.formats.navgrid import check_grid
from navbake.formats.occupancy import FREE, INSCRIBED, OCCUPIED, OccupancyValues, level_from_values
from navbake.formats.shapes import read_room_outlines
from navbake.formats.source import Files, check_path, read_yaml
from navbake.known_names import suggest
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.islands import renew_islands
from navbake.navgrid.lattice import cover_cells, touch_cells
from navbake.navgrid.links import MAX_AREAS, SPEED, Agent, Area
from navbake.runtime.blocking import find_agent
from navbake.types import Bool, Json

LOG = logging.getLogger(__name__)
# types of filters
KEEPOUT = 0
PERCENT = 1
ABSOLUTE = 2
MAX_LISTED = 20  # names that an error lists
SLACK = 1e-9  # share of a value by which a limit may be above its own
ROUND = (1.0, 0.5, 0.1, 0.05, 0.01)  # multipliers that are tried first [m/s]

Zone = tuple[tuple[str, ...], int, int | Bool]
"""A part of a level: the names that it can be called by, the level, and which cells it has: the
index of a room, or the mask of a polygon."""


class Scale(NamedTuple):
    """What the values of a mask stand for."""

    type: int = KEEPOUT
    base: float = 0.0
    multiplier: float = 1.0


def encode_mask(
    grid: NavGrid,
    path: Path,
    *,
    has_limits: bool,
    level: int | None = None,
    image: str | None = None,
    zone: Sequence[str] | None = None,
    zones: str | PathLike[str] | None = None,
    agent: str | Agent | None = None,
    absolute: bool | None = None,
) -> Files:
    """Encode the masks of the keepout filter, or of the speed filter, one for each level.

    Without zones they are those of the grid's areas: in a keepout mask, those that bar the agent;
    in a speed mask, those with a speed. Limits are rounded down. Finite costs of areas are left out
    of keepout masks, with a warning.

    Args:
        path, level, image: as of `encode_nav2`; in mode ``raw``.
        has_limits: for the speed filter, whose zones have limits.
        zone: names, ids or numbers of rooms, and names of polygons; of the speed filter
            ``NAME=PERCENT`` each, from 1 to 100, of which the least counts where zones overlap.
            Of the keepout filter all polygons if None.
        zones: a GeoJSON file of polygons, see `navbake.formats.shapes.read_room_outlines`. A
            keepout mask marks every cell that one touches, a speed mask those whose centre it has.
        agent: a name in the grid, or an agent, for masks of areas; its speed is 100 %.
        absolute: limits of areas in m/s, not in percent.

    Raises:
        FormatError: a name is unknown, a limit invalid, or rounded down to 0, a polygon holds no
            cell's centre of its level, or nothing is to be marked.
        QueryError: the grid names no such agent.
    """
    image = image or "pgm"
    check_choice(image, IMAGES, "image")
    if zone is None and zones is None and grid.areas:
        marked, scale = _mark_areas(grid, find_agent(grid, agent), has_limits, bool(absolute))
    else:
        if agent is not None or absolute:
            raise FormatError("agent and absolute are for masks of the grid's areas, without zones")
        marked = _mark_zones(grid, zone, zones, has_limits)
        scale = Scale(PERCENT if has_limits else KEEPOUT)
    files: Files = {}
    for k, yaml_path in list_level_paths(grid, path, level, YAMLS).items():
        files |= encode_map(grid.levels[k], marked[k], yaml_path, "raw", image)
        kind = "speed" if has_limits else "keepout"
        topic = f"{kind}_filter_mask"
        info = {"type": scale.type, "filter_info_topic": f"{kind}_filter_info"}
        info |= {"mask_topic": topic, "base": scale.base, "multiplier": scale.multiplier}
        served = {"yaml_filename": yaml_path.name, "topic_name": topic, "frame_id": "map"}
        content = {
            f"{kind}_costmap_filter_info_server": {"ros__parameters": info},
            f"{kind}_filter_mask_server": {"ros__parameters": served},
        }
        text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
        files[_info_path(yaml_path)] = text.encode()
    return files


encode_keepout = partial(encode_mask, has_limits=False)
encode_speed = partial(encode_mask, has_limits=True)


def _mark_areas(
    grid: NavGrid, agent: Agent | None, has_limits: bool, absolute: bool
) -> tuple[list[OccupancyValues], Scale]:
    """The values of all levels by the grid's areas."""
    table = np.zeros(len(grid.areas) + 1, dtype=np.int8)
    scale = Scale()
    if has_limits:
        fastest = SPEED if agent is None else agent.speed
        speeds = [area.speed for area in grid.areas if area.speed is not None]
        scale = Scale(ABSOLUTE, 0.0, _multiplier(speeds)) if absolute else Scale(PERCENT)
        unit = scale.multiplier if absolute else fastest / 100.0
    for place, area in enumerate(grid.areas, 1):
        if not has_limits:
            table[place] = OCCUPIED if area.bars(agent) else FREE
        elif area.speed is not None:
            table[place] = min(math.floor(area.speed / unit * (1.0 + SLACK)), 100)
            if not table[place]:
                raise FormatError(
                    f"expected a speed of {unit:g} m/s or more, which a value of 1 stands for, got "
                    f"{area.speed:g} m/s in area {area.name!r}"
                )
    if not table.any():
        what = "has a speed" if has_limits else "bars this agent" if agent else "bars all agents"
        raise FormatError(f"a mask needs zones or areas: no area of the grid {what}")
    priced = [area.name for area in grid.areas if area.cost != 1.0 and not area.bars(agent)]
    if priced and not has_limits:
        LOG.warning("a keepout mask has no costs of areas: left out of %s", ", ".join(priced))
    return [table[level.area_index] for level in grid.levels], scale


def _multiplier(speeds: Sequence[float]) -> float:
    """The limit of a value of 1 [m/s], by which up to 100 stand for speeds, exactly if it can."""
    most = max(speeds, default=1.0)
    for unit in ROUND:
        shares = [speed / unit for speed in speeds]
        if most <= 100 * unit and all(abs(v - round(v)) < 1e-6 * max(v, 1.0) for v in shares):
            return unit
    return most / 100.0


def _mark_zones(
    grid: NavGrid, zone: Sequence[str] | None, zones: Any, has_limits: bool
) -> list[OccupancyValues]:
    """The values of all levels by rooms and polygons."""
    known = _find_zones(grid, zones, has_limits)
    chosen: list[tuple[Zone, int]] = []
    if zone is None and not has_limits:
        chosen = [(own, OCCUPIED) for own in known if not isinstance(own[2], int)]
    for entry in zone or []:
        name = entry
        value = OCCUPIED
        if has_limits:
            name, _, text = entry.rpartition("=")
            if not name or not text.isdecimal() or len(text) > 3 or not 1 <= int(text) <= 100:
                raise FormatError(f"expected NAME=PERCENT, 1 to 100, as zone, got {entry!r}")
            value = int(text)
        found = [own for own in known if name in own[0]]  # on all levels with that name
        if not found:
            owner = "the grid" if zones is None else f"the grid or {zones}"
            there = suggest(name, (own[0][-1] for own in known), MAX_LISTED, owner)
            raise FormatError(f"no room or polygon is called {name!r}: {there}")
        chosen += [(own, value) for own in found]
    if not chosen:
        raise FormatError("a mask needs zones: rooms by name, id or number, or polygons (GeoJSON)")
    marked: list[OccupancyValues] = [np.full(v.shape, FREE, dtype=np.int8) for v in grid.levels]
    for (_, k, cells), value in sorted(chosen, key=lambda pair: -pair[1]):
        is_room = isinstance(cells, int)
        marked[k][grid.levels[k].room_index == cells if is_room else cells] = value
    return marked


def _find_zones(grid: NavGrid, path: str | PathLike[str] | None, has_limits: bool) -> list[Zone]:
    """The rooms of a grid, and the polygons of a file."""
    found: list[Zone] = [
        ((str(room.index), room.id, *([room.name] if room.name else [])), room.level, room.index)
        for room in grid.rooms
    ]
    names = grid.level_names
    for k, outline in enumerate([] if path is None else read_room_outlines(path)):
        name = outline["name"] or f"feature {k}"
        level = outline["level"]
        number = names.index(level) if level in names else level
        if not isinstance(number, int) or number >= len(names):
            whose = f"{name!r} in {path}"
            there = ", ".join(names)
            raise FormatError(f"no level {level!r}, which {whose} is on: the grid has {there}")
        rings = [outline["points"], *outline["rings"]]
        lattice = grid.levels[number].lattice
        touched = touch_cells(rings, lattice)
        mask = cover_cells(rings, lattice) if has_limits else touched
        if not mask.any():
            where = f"lies outside of level {number}: it holds no cell"
            if touched.any():
                where = f"is thinner than a cell of level {number}: it holds no cell's centre"
            raise FormatError(f"{name!r} in {path} {where}")
        found.append(((name,), number, mask))
    return found


def _info_path(path: Path) -> Path:
    """Where the parameters of a mask's filter are."""
    return path.with_name(f"{path.stem}_filter{path.suffix}")


# ---------------------------------------------------------------- reading


def read_mask(
    path: str | PathLike[str],
    *,
    has_limits: bool,
    grid: NavGrid | None = None,
    level: int = 0,
    agent: str | Agent | None = None,
) -> NavGrid:
    """Read a mask of the keepout or speed filter as areas, one for each value but 0 and unknown.

    In a keepout mask, 99 and 100 bar all agents, and less is nav2's cost.

    Args:
        path: the mask's YAML. The filter's parameters are read where `encode_mask` writes them;
            without them, values are percent.
        has_limits: whether it is one of the speed filter.
        grid: the grid that gets the areas, after its own; a new one of free cells if None. A cell
            takes what the mask has at its centre.
        level: of the grid.
        agent: whose speed is 100 %: a name in the grid, or an agent; 1 m/s if None.

    Raises:
        FormatError: a file is broken, there is no such level, or there are too many areas.
        QueryError: the grid names no such agent.
    """
    values, lattice, stated = read_map(path)
    if grid is None:
        empty = np.zeros_like(values)
        level = 0
        metadata: Json = {"sceneId": readable_stem(path), "navbake": {}}
        grid = level_from_values(empty, lattice, stated.ground, metadata)
        check_grid(grid, JsonPath(check_path(path)))
    check_level(grid, level)
    target = grid.levels[level].lattice
    rows, cols = lattice.rows_cols(target.positions(*np.indices(target.shape)))
    inside = (rows >= 0) & (rows < lattice.height) & (cols >= 0) & (cols < lattice.width)
    seen = np.zeros(target.shape, dtype=np.int8)
    seen[inside] = values[rows[inside], cols[inside]]
    whose = find_agent(grid, agent)
    scale = _read_info(Path(path)) if has_limits else Scale()
    table = list(grid.areas)
    index = grid.levels[level].area_index.copy()
    names = {area.name for area in table}
    for value in np.unique(seen[seen > FREE]).tolist():
        area = _area_of(value, scale, has_limits, SPEED if whose is None else whose.speed)
        name = area.name
        again = 2
        while name in names:
            name = f"{area.name} ({again})"
            again = again + 1
        names.add(name)
        table.append(Area(name, area.cost, area.speed))
        if len(table) > MAX_AREAS:
            raise FormatError(f"expected at most {MAX_AREAS} areas, got more by {path}")
        index[seen == value] = len(table)
    areas = {"areas": [area.to_json() for area in table]}
    levels = []
    for k, own in enumerate(grid.levels):
        metadata = {**own.metadata, "navbake": {**own.navbake, **areas}}
        attributes = {"area": index} if k == level else {}
        levels.append(own.with_layers(attributes=attributes, metadata=metadata))
    metadata = {**grid.metadata, "navbake": {**grid.navbake, **areas}}
    done: NavGrid = grid.with_levels(levels, metadata)
    renew_islands(done)
    return done


def read_keepout(
    path: str | PathLike[str], *, grid: NavGrid | None = None, level: int = 0
) -> NavGrid:
    """Read a mask of the keepout filter as areas of a grid; `read_mask` of the filter."""
    return read_mask(path, has_limits=False, grid=grid, level=level)


def read_speed(
    path: str | PathLike[str],
    *,
    grid: NavGrid | None = None,
    level: int = 0,
    agent: str | Agent | None = None,
) -> NavGrid:
    """Read a mask of the speed filter as areas of a grid; `read_mask` of the filter."""
    return read_mask(path, has_limits=True, grid=grid, level=level, agent=agent)


def _area_of(value: int, scale: Scale, has_limits: bool, fastest: float) -> Area:
    """The area of the cells with a value."""
    if not has_limits:
        if value >= INSCRIBED:
            return Area("keepout" if value == OCCUPIED else f"keepout {value}", math.inf)
        return Area(f"cost {value}", float(1 + math.ceil(251 * (value - 1) / 97)))
    limit = round(scale.base + scale.multiplier * value, 9)
    speed = limit if scale.type == ABSOLUTE else round(limit / 100.0 * fastest, 9)
    name = f"speed {limit:g} m/s" if scale.type == ABSOLUTE else f"speed {limit:g} %"
    # nav2 takes limits that are no share of a speed for none
    return Area(name, 1.0, speed if speed > 0 else None)


def _read_info(path: Path) -> Scale:
    """The parameters beside a mask; percent without them."""
    info = _info_path(path)
    if not info.exists():
        return Scale(PERCENT)
    content, name = read_yaml(info, expected="the parameters of a filter")
    place = JsonPath(name)
    for node, entry in check_object(content, place).items():
        own = check_object(check_object(entry, place).get("ros__parameters"), place[str(node)])
        if "multiplier" in own and "type" in own:
            numbers = [
                float(check_number(own.get(key), place[str(node)][key])) for key in Scale._fields
            ]
            if numbers[0] not in (PERCENT, ABSOLUTE):
                place[str(node)]["type"].refuse("1 (percent) or 2 (m/s)", own["type"])
            return Scale(int(numbers[0]), *numbers[1:])
    place.fail("expected a node with type, base and multiplier")
