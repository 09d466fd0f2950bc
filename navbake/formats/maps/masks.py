"""Masks of nav2's costmap filters: where robots stay out, and where they go slowly.

A mask is a map on the cells of its level, in mode ``raw``. 0 changes nothing. In a keepout mask,
100 is where no robot may go. In a speed mask, 1 to 100 is the limit in percent of a robot's
speed, which the filter info server takes with ``type: 1``, ``base: 0.0``, ``multiplier: 1.0``.

Source: nav2's documentation of its costmap filters and their masks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navbake.errors import FormatError
from navbake.formats.maps.nav2 import IMAGES, YAMLS, encode_map
from navbake.formats.maps.occupancy import FREE, OCCUPIED, Values
from navbake.formats.maps.paths import level_paths
from navbake.formats.shapes.geojson import read_room_outlines
from navbake.formats.source import Files
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.polygon import cover_cells
from navbake.types import Int, Json

MAX_LISTED = 20  # names that an error lists


class Zone(NamedTuple):
    """A part of a level."""

    names: tuple[str, ...]  # that it can be called by
    level: int
    cells: Callable[[], Int]  # ids; found when asked for, as a level may have hundreds of rooms
    is_polygon: bool


def encode_keepout(
    grid: NavGrid,
    path: Path,
    *,
    level: int | None = None,
    image: str | None = None,
    zone: Sequence[str] | None = None,
    zones: str | PathLike[str] | None = None,
) -> Files:
    """Make the masks of the keepout filter, one for each level.

    Args:
        path, level: as of `navbake.formats.maps.nav2.encode_nav2`.
        image: ``pgm`` or ``png``; ``pgm`` if None.
        zone: names, ids or numbers of rooms, and names of polygons.
        zones: a GeoJSON file of polygons, see
            `navbake.formats.shapes.geojson.read_room_outlines`. All of them count if `zone` is
            None.

    Raises:
        FormatError: nothing has such a name, or a polygon holds no cell's centre of its level.
    """
    known = _find_zones(grid, zones)
    chosen = [(one, OCCUPIED) for one in known if one.is_polygon]
    if zone is not None:
        chosen = [(one, OCCUPIED) for name in zone for one in _named(name, known)]
    return _encode(grid, path, level, image, chosen)


def encode_speed(
    grid: NavGrid,
    path: Path,
    *,
    level: int | None = None,
    image: str | None = None,
    zone: Sequence[str] | None = None,
    zones: str | PathLike[str] | None = None,
) -> Files:
    """Make the masks of the speed filter, one for each level.

    Args:
        path, level, image, zones: as of `encode_keepout`.
        zone: ``NAME=PERCENT`` each, from 1 to 100; where several overlap, the least counts.

    Raises:
        FormatError: as of `encode_keepout`, or a limit is none.
    """
    known = _find_zones(grid, zones)
    chosen = []
    for entry in zone or []:
        name, _, text = entry.rpartition("=")
        if not name or not text.isdecimal() or len(text) > 3 or not 1 <= int(text) <= 100:
            raise FormatError(f"expected NAME=PERCENT, 1 to 100, as zone, got {entry!r}")
        chosen += [(one, int(text)) for one in _named(name, known)]
    return _encode(grid, path, level, image, sorted(chosen, key=lambda pair: -pair[1]))


def _encode(
    grid: NavGrid,
    path: Path,
    level: int | None,
    image: str | None,
    chosen: list[tuple[Zone, int]],
) -> Files:
    image = image or "pgm"
    if image not in IMAGES:
        raise FormatError(f"expected {' or '.join(IMAGES)} as image, got {image!r}")
    if not chosen:
        raise FormatError("a mask needs zones: rooms by name, id or number, or polygons (GeoJSON)")
    files: Files = {}
    for number, yaml_path in level_paths(grid, path, level, YAMLS).items():
        values: Values = np.full(grid.levels[number].shape, FREE, dtype=np.int8)
        for zone, value in chosen:
            if zone.level == number:
                values.flat[zone.cells()] = value
        files |= encode_map(grid.levels[number], values, yaml_path, "raw", image)
    return files


def _find_zones(grid: NavGrid, path: str | PathLike[str] | None) -> list[Zone]:
    """The rooms of a grid, and the polygons of a file."""
    found = []
    for room in grid.rooms:
        names = (str(room.index), room.id, *([room.name] if room.name else []))
        cells = partial(_room_cells, grid.levels[room.level], room.index)
        found.append(Zone(names, room.level, cells, False))
    outlines = [] if path is None else read_room_outlines(path)
    for number, outline in enumerate(outlines):
        name = outline["name"] or f"feature {number}"
        where = _level_of(grid, outline["level"], f"{name!r} in {path}")
        rings = [outline["points"], *outline["rings"]]
        covered = np.flatnonzero(cover_cells(rings, grid.levels[where].lattice))
        if not len(covered):
            raise FormatError(f"{name!r} in {path} lies outside of level {where}: it holds no cell")
        found.append(Zone((name,), where, lambda covered=covered: covered, True))  # type: ignore[misc]
    return found


def _room_cells(level: SceneGrid2D, index: int) -> Int:
    return np.flatnonzero(level.room_index == index)


def _level_of(grid: NavGrid, stated: Json, whose: str) -> int:
    names = grid.level_names
    if isinstance(stated, str) and stated in names:
        return names.index(stated)
    if isinstance(stated, int) and stated < len(names):
        return stated
    raise FormatError(f"no level {stated!r}, which {whose} is on: the grid has {', '.join(names)}")


def _named(name: str, known: list[Zone]) -> list[Zone]:
    """The zones of a name; one that several levels have is on all of them."""
    found = [zone for zone in known if name in zone.names]
    if not found:
        names = list(dict.fromkeys(zone.names[-1] for zone in known))
        listed = ", ".join(names[:MAX_LISTED]) + (", …" if len(names) > MAX_LISTED else "")
        raise FormatError(f"no room or polygon is called {name!r}; there are: {listed or 'none'}")
    return found
