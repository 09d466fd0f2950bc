"""The input of rooms: flags of each level's cells, and what geoms, sites and polygons mark."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from fnmatch import translate
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import ColumnSource, cast_columns, tile_shapes
from navbake.baker.core.components import label_components_2d
from navbake.baker.core.constants import BUILDING, WALL
from navbake.baker.core.tolerances import SAME_HEIGHT
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.geometry.shapes import Shapes, Solids, solid_bounds
from navbake.baker.occupants.list_kernels import COLUMN_FLAGS
from navbake.baker.occupants.standing import StandingOccupants
from navbake.baker.rooms.gaps import WIDEST
from navbake.baker.rooms.walls import find_windows
from navbake.baker.scene.collect import Choice, collect_shapes
from navbake.baker.scene.names import all_names, warn_unmatched
from navbake.baker.scene.scene import Scene
from navbake.config.settings import DEFAULT_GEOMS, DEFAULT_SITES, AgentSettings, RoomSettings
from navbake.errors import ConfigError
from navbake.navgrid.lattice import Lattice, cover_cells
from navbake.types import Bool, Float, Int, Int32

# The scene goes on beyond the lattice where it does so by more than this share of a cell
BEYOND = 0.5
# What is outdoors reaches the edge over more than this in one piece: no opening in a wall at the
# edge is so wide [m]
EDGE_LENGTH = WIDEST
EVERY_SIDE = np.ones((2, 2), dtype=np.bool_)

# A room's floor geom lies at most this far below the walkable floor, as under a rug [m]
BELOW = 0.05
# Or this far above it, as a floor that is only drawn over the one that collides [m]
ABOVE = 0.005
# A site's volume may begin this far above the floor [m]
OFF_FLOOR = 0.05
# A geom is a floor where at least this share of its upper side is one
FLOOR_SHARE = 0.5
# Share of itself, or of the agent, that a site's volume has at least between floor and head
STANDING_SHARE = 0.5
DEFAULTS = {"geoms": DEFAULT_GEOMS, "sites": DEFAULT_SITES}
# What stands before a room's name in that of its floor
FLOOR_PREFIXES = ("floor|", "floor_")


class MarkedRooms(NamedTuple):
    """The rooms that one source marks, by level; room k + 1 is called ``names[k]``."""

    names: Sequence[str | None]
    labels: Sequence[Int32]  # the number of each cell's room, shape (height, width), 0 for none
    warnings: Sequence[str] = ()  # what the user should know, one line each
    # the same with cells whose floor lies up to a step over the room's, as on a podium, if any
    covered: Sequence[Int32] = ()
    outdoors: Set[int] = frozenset()  # the numbers of those that are


class LevelFlags(NamedTuple):
    """Flags of a level's cells, shape (height, width) of the whole lattice."""

    floor: Float  # heights, NaN for none [m]
    open: Bool  # with a floor, and no wall or window
    hole: Bool  # without a floor, and nothing stands at the height of an agent's body
    # open cells beside which there is nothing up to the edge of the grid, or ground too steep to
    # stand on, such as the bank of a ditch; no walls and pillars, which reach above heads
    edge: Bool
    # with a floor, and nothing above an agent's head; no cells of a level where too few are at the
    # edge for anything to be outdoors: nothing else depends on it
    sky: Bool
    bank: Bool  # without a floor, and the ground under the sky is too steep to stand on
    occupied: Bool  # without a floor, or what stands meets the square in an agent's way


class RoomFlags(NamedTuple):
    """All that rooms depend on besides settings and closed leaves."""

    lattice: Lattice
    levels: list[LevelFlags]
    empty: Bool  # cells in whose columns there is nothing, shape (height, width)
    ends: Bool  # the sides of the lattice at which the scene ends, [[upper, lower], [left, right]]
    walls: Shapes  # the geometry of walls and of meshes that hold a building
    has_ground: bool  # endless ground goes on beyond the lattice
    links: Int  # steps between cells, see `Floors`, shape (n, 4)
    marks: Mapping[str, MarkedRooms]  # the rooms that each source marks


def gather_flags(
    scene: Scene,
    columns: ColumnSource,
    floors: Floors,
    column_flags: Sequence[NDArray[np.uint8]],
    standing_occupants: StandingOccupants | None,
    occupied: Sequence[Bool],
    settings: RoomSettings,
    agent: AgentSettings,
) -> RoomFlags:
    """Read all that rooms depend on, but settings and closed leaves.

    `occupied` are the cells of each level, of the whole lattice, that have no floor, or whose
    squares are met by what stands in an agent's way.
    """
    lattice = columns.lattice
    levels = list[LevelFlags]()
    wall = low = np.zeros(lattice.shape, dtype=np.bool_)
    for number, level in enumerate(floors.levels):
        if standing_occupants is not None:
            wall, low = standing_occupants.mark_walls(number)
        marked = column_flags[number].reshape(lattice.shape)
        empty, hole, bank, sky, tall = ((marked & flag) > 0 for flag in COLUMN_FLAGS)
        open_cells = ~np.isnan(level.floor) & ~wall & ~find_windows(low, wall, lattice.cell_size)
        edge = edge_cells(empty | bank, EVERY_SIDE) & open_cells
        edge &= ~tall
        longest = np.sqrt(2) * np.count_nonzero(edge) * lattice.cell_size  # if all touch
        if longest <= EDGE_LENGTH:
            sky[:] = False
        levels.append(LevelFlags(level.floor, open_cells, hole, edge, sky, bank, occupied[number]))
    ends = ~EVERY_SIDE
    if scene.bounds is not None:
        x0, y0, x1, y1 = lattice.bounds
        (low_x, low_y), (high_x, high_y) = scene.bounds[:, :2]
        more = np.array([[high_y - y1, y0 - low_y], [x0 - low_x, high_x - x1]])
        ends = more <= BEYOND * lattice.cell_size
    has_ground = len(scene.structure.planes.geom) > 0
    is_wall = np.zeros(len(scene.geoms), dtype=np.bool_)
    if standing_occupants is not None:
        is_wall = np.isin(standing_occupants.partitions, (WALL, BUILDING))
    marks = mark_rooms(scene, columns, floors.levels, settings, agent)
    walls = scene.structure.only(is_wall)
    return RoomFlags(lattice, levels, empty, ends, walls, has_ground, floors.links, marks)


def edge_cells(is_open: Bool, sides: Bool) -> Bool:
    """Closed cells at some `sides` of the lattice, or beside open cells connected to these."""
    empty = np.pad(is_open, 1)
    empty[[0, -1]] |= sides[0][:, None]
    empty[:, [0, -1]] |= sides[1]
    part, _ = label_components_2d(empty)
    outer = np.unique(np.concatenate([part[[0, -1]].ravel(), part[:, [0, -1]].ravel()]))
    beyond = np.isin(part, outer[outer > 0])
    edge: Bool = beyond[:-2, 1:-1] | beyond[2:, 1:-1] | beyond[1:-1, :-2] | beyond[1:-1, 2:]
    return edge & ~beyond[1:-1, 1:-1]


def mark_rooms(
    scene: Scene,
    columns: ColumnSource,
    levels: Sequence[LevelFloor],
    settings: RoomSettings,
    agent: AgentSettings,
) -> dict[str, MarkedRooms]:
    """Find the rooms that geoms, sites and polygons mark in a scene, by source."""
    found = {}
    if "geoms" in settings.sources:
        found["geoms"] = _mark_by_geoms(scene, columns, levels, settings, agent)
    if "sites" in settings.sources:
        found["sites"] = _mark_by_sites(scene, columns.lattice, levels, settings, agent)
    if "polygons" in settings.sources:
        found["polygons"] = _mark_by_polygons(columns.lattice, levels, settings)
    return found


def find_markers(model: Any, settings: RoomSettings) -> tuple[list[int], list[int]]:
    """The geoms and the sites of a model that mark rooms by name, if their bodies stand."""
    geoms = list[int]()
    if "geoms" in settings.sources:
        geoms, _ = _match(all_names(model).own_geoms, tuple(settings.geoms), "geoms")
    sites = list[int]()
    if "sites" in settings.sources:
        sites, _ = _match(all_names(model).sites, tuple(settings.sites), "sites")
    return geoms, sites


def _mark_by_geoms(
    scene: Scene,
    columns: ColumnSource,
    levels: Sequence[LevelFloor],
    settings: RoomSettings,
    agent: AgentSettings,
) -> MarkedRooms:
    """Give each cell the room of the matching geom that is its floor.

    Its surface lies highest from 5 cm below (under a rug) to 5 mm above the floor, and of several
    the first counts. Furniture may be named like a room: so half of its upper side has to be floor,
    or lie up to a step under one (a carpet, a podium), which then is `covered`.
    """
    num = scene.model.ngeom
    names = all_names(scene.model).own_geoms
    matching, warnings = _match(names, tuple(settings.geoms), "geoms")
    # what can move marks no room
    stands = scene.stands[scene.model.geom_bodyid]
    chosen = [geom for geom in matching if stands[geom]]
    labels, covered = ([np.zeros(columns.lattice.shape, np.int32) for _ in levels] for _ in "ab")
    if not chosen:
        return MarkedRooms([], labels, warnings)
    number = np.zeros(num + 1, dtype=np.int32)
    number[chosen] = np.arange(1, len(chosen) + 1)
    cell, z, geom = _upward_surfaces(scene, columns, set(chosen))
    lowest = -agent.traversable_floor_height - SAME_HEIGHT
    # NaN where there is no floor, which compares as False
    heights = [z - level.floor.ravel()[cell] for level in levels]
    at_floor = np.any([(h >= lowest) & (h <= ABOVE + SAME_HEIGHT) for h in heights], axis=0)
    sides = np.bincount(geom, minlength=num)
    is_floor = np.bincount(geom[at_floor], minlength=num) >= FLOOR_SHARE * sides
    for found, reach in ((labels, -BELOW - SAME_HEIGHT), (covered, lowest)):
        for label, height in zip(found, heights, strict=True):
            here = (height >= reach) & (height <= ABOVE + SAME_HEIGHT) & is_floor[geom]
            highest = np.full(label.size, -np.inf)
            np.maximum.at(highest, cell[here], z[here])
            here &= z >= highest[cell] - SAME_HEIGHT
            first = np.full(label.size, num, dtype=np.int32)
            np.minimum.at(first, cell[here], geom[here])
            label[:] = number[first].reshape(label.shape)
    called: list[str | None] = []
    for name in (names[geom] for geom in chosen):
        without = (name[len(prefix) :] for prefix in FLOOR_PREFIXES if name.startswith(prefix))
        called.append(next(filter(None, without), name))
    return MarkedRooms(called, labels, warnings, covered)


def _mark_by_sites(
    scene: Scene,
    lattice: Lattice,
    levels: Sequence[LevelFloor],
    settings: RoomSettings,
    agent: AgentSettings,
) -> MarkedRooms:
    """Give each cell the room of the first site in which an agent stands there, see `_stand_in`.

    A site with less than `rooms.min_area` of floor, on all levels together, is no room.
    """
    names = all_names(scene.model).sites
    chosen, warnings = _match(names, tuple(settings.sites), "sites")
    labels = [np.zeros(lattice.shape, dtype=np.int32) for _ in levels]
    kept = list[str | None]()
    small = list[str]()
    for site in chosen:
        if not scene.stands[scene.model.site_bodyid[site]]:
            continue
        masks = _stand_in(site, scene, lattice, levels, agent)
        if sum(int(mask.sum()) for mask in masks) * lattice.cell_size**2 < settings.min_area:
            small.append(names[site])
            continue
        kept.append(names[site])
        for label, mask in zip(labels, masks, strict=True):
            label[mask & (label == 0)] = len(kept)
    if small:
        listed = ", ".join(small[:5]) + (", …" if len(small) > 5 else "")
        told = f"sites that hold less than {settings.min_area:g} m² of floor (`rooms.min_area`)"
        warnings = [*warnings, f"{told} are no rooms: {listed}"]
    return MarkedRooms(kept, labels, warnings)


def _stand_in(
    site: int, scene: Scene, lattice: Lattice, levels: Sequence[LevelFloor], agent: AgentSettings
) -> list[Bool]:
    """The cells of each level whose agent stands in a site's volume.

    The cell's line meets the volume over a length, of which at least half, or half of an agent,
    lies between 5 cm below the floor and the agent's height.
    """
    model = scene.model
    data = scene.data
    kind = model.site_type[[site]].astype(np.int32)
    place = np.zeros(1, dtype=np.int32)
    pose = data.site_xpos[[site]], data.site_xmat[[site]], model.site_size[[site]]
    solid = Solids(place, kind, *pose, solid_bounds(kind, *pose))
    masks = [np.zeros(lattice.shape, dtype=np.bool_) for _ in levels]
    window = lattice.window(solid.bounds.reshape(2, 3))
    if window is None:
        return masks
    nothing = scene.shapes.only(np.zeros(model.ngeom, dtype=np.bool_))
    cut = lattice.cut(*window)
    surfaces = cast_columns(tile_shapes(replace(nothing, solids=solid), cut, 0.0))
    low, high = np.full((2, *cut.shape), np.nan)
    hit = np.diff(surfaces.start).reshape(cut.shape) > 1
    low[hit] = surfaces.z[surfaces.start[:-1][hit.ravel()]]
    high[hit] = surfaces.z[surfaces.start[1:][hit.ravel()] - 1]
    for mask, level in zip(masks, levels, strict=True):
        floor = level.floor[window]
        inside = np.minimum(high, floor + agent.height) - np.maximum(low, floor - OFF_FLOOR)
        enough = STANDING_SHARE * np.minimum(high - low, agent.height)
        mask[window] = inside >= enough - SAME_HEIGHT
    return masks


def _mark_by_polygons(
    lattice: Lattice, levels: Sequence[LevelFloor], settings: RoomSettings
) -> MarkedRooms:
    """Give each cell the room in whose polygon its centre lies; of several, the first."""
    polygons = settings.polygons
    labels = [np.zeros(lattice.shape, dtype=np.int32) for _ in levels]
    warnings = []
    for number, polygon in enumerate(polygons):
        called = f"room {repr(polygon.name) if polygon.name else f'[{number}]'}"
        on = [k for k, level in enumerate(levels) if polygon.level in (k, level.name)]
        if not on:
            listed = ", ".join(f"{k} ({level.name})" for k, level in enumerate(levels))
            raise ConfigError(
                f"no level {polygon.level!r} for {called} of `rooms.polygons`: there are {listed}"
            )
        level = levels[on[0]]
        label = labels[on[0]]
        mask = cover_cells([polygon.points, *polygon.rings], lattice)
        known = ~np.isnan(level.floor)
        if not (mask & known).any():
            rows, cols = np.nonzero(known)
            x = lattice.center_x()[cols]
            y = lattice.center_y()[rows]
            warnings.append(
                f"{called} of `rooms.polygons` has no floor on {level.name}, whose floor spans "
                f"x {x.min():.2f} to {x.max():.2f}, y {y.min():.2f} to {y.max():.2f} m"
            )
        label[mask & (label == 0)] = number + 1
    outdoors = {number for number, polygon in enumerate(polygons, 1) if polygon.outdoors}
    return MarkedRooms([polygon.name for polygon in polygons], labels, warnings, outdoors=outdoors)


def _upward_surfaces(
    scene: Scene, columns: ColumnSource, chosen: set[int]
) -> tuple[Int, Float, Int32]:
    """Cells, heights and geoms of surfaces that face up; of hulls, those of their mesh."""
    num = len(scene.geoms)
    known = {geom for geom in chosen if scene.geoms[geom].shape not in ("", "hull")}
    parts: list[tuple[ColumnSource, set[int]]] = [(columns, known)]
    if others := chosen - known:
        choices = [Choice(geom in others, "marks a room", "surface") for geom in range(num)]
        shapes, *_ = collect_shapes(scene.model, scene.data, choices, scene.parts)
        parts.append((cast_columns(tile_shapes(shapes, columns.lattice, 0.0)), others))
    found = []
    for surfaces, geoms in parts:
        is_meant = np.isin(np.arange(num), list(geoms))
        for block in surfaces.row_chunks() if geoms else ():
            first, end = block.valid_rows.cell_range(block.lattice)
            at = np.flatnonzero(is_meant[block.geom] & (block.normal[:, 2] > 0))
            cell = first + np.searchsorted(block.start[first : end + 1], at, side="right") - 1
            found.append((cell, block.z[at], block.geom[at]))
    cells, heights, owners = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return cells, heights, owners


@lru_cache(maxsize=8)  # each update calls it
def _match(
    names: tuple[str, ...], patterns: tuple[str, ...], setting: str
) -> tuple[list[int], list[str]]:
    """Ids of what matches, and a warning for each pattern of the user's that matches nothing."""
    chosen = set[int]()
    warnings = list[str]()
    for pattern in patterns:
        matches = re.compile(translate(pattern)).match
        found = [k for k, name in enumerate(names) if name and matches(name)]
        chosen.update(found)
        if not found and pattern not in DEFAULTS[setting]:
            warnings.append(warn_unmatched(f"rooms.{setting}", pattern, names))
    return sorted(chosen), warnings
