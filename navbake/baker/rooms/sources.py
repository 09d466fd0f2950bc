"""Rooms that someone marked: by floor geoms, by sites, by polygons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns, cast_columns, tile_shapes
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.constants import SAME
from navbake.baker.rooms.volumes import vertical_chords
from navbake.baker.scene.choice import Choice
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.names import name_at, warn_unmatched
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Solids, solid_bounds
from navbake.config.rooms import DEFAULT_GEOMS, DEFAULT_SITES, RoomPolygon
from navbake.errors import ConfigError
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.polygon import cover_cells

Labels = NDArray[np.int32]

# A room's floor lies at most this far below what one stands on (a rug), or above it (a picture
# of a floor over the one that collides) [m]
BELOW, ABOVE = 0.05, 0.005
# A site's volume may begin this far above the floor [m]
OFF_FLOOR = 0.05
# Share of itself, or of the agent, that a site's volume has between floor and head
HALF = 0.5
# What stands before a room's name in that of its floor
FLOOR_PREFIXES = ("floor|", "floor_")


@dataclass(frozen=True)
class Claim:
    """What one source says of the rooms.

    Attributes:
        names: a room's name, or None; the room of ``names[k]`` has the number k + 1.
        labels: the room of each cell by level, shape (height, width), int32, 0 for none.
        warnings: what the user should know, one line each.
    """

    names: list[str | None]
    labels: list[Labels]
    warnings: list[str] = field(default_factory=list)


def claim_by_geoms(
    scene: Scene,
    columns: Columns,
    levels: Sequence[LevelFloor],
    patterns: Sequence[str],
    step: float,
) -> Claim:
    """Give each cell the room whose geom is its floor.

    Of the geoms that match, that is the one whose surface lies highest from 5 cm below the floor
    to 5 mm above it; so rugs cover no room, and geoms may be floors that are only drawn, and
    don't count in the bake. Of several at one height the first counts. Meshes are taken as their
    triangles. Furniture may be named like a room: a geom is a floor when half of its upper side
    is, or lies up to a step under one (a carpet, a podium).

    Args:
        scene: the scene.
        columns: all surfaces of what counts in it.
        levels: the storeys.
        patterns: of geom names.
        step: the agent's [m].
    """
    model, lattice = scene.model, columns.lattice
    names = [name_at(model, address) for address in model.name_geomadr]
    chosen, warnings = _match(names, patterns, DEFAULT_GEOMS, "geoms")
    labels = [np.zeros(lattice.shape, dtype=np.int32) for _ in levels]
    if not chosen:
        return Claim([], labels, warnings)
    number = np.zeros(model.ngeom + 1, dtype=np.int32)
    number[chosen] = np.arange(1, len(chosen) + 1)
    cell, z, geom = _surfaces_of(scene, columns, chosen)
    heights = [z - level.floor.ravel()[cell] for level in levels]  # NaN for no floor: no match
    at_floor = np.any([(h >= -step - SAME) & (h <= ABOVE + SAME) for h in heights], axis=0)
    sides = np.bincount(geom, minlength=model.ngeom)
    is_floor = np.bincount(geom[at_floor], minlength=model.ngeom) >= HALF * sides
    for label, height in zip(labels, heights, strict=True):
        here = (height >= -BELOW - SAME) & (height <= ABOVE + SAME) & is_floor[geom]
        highest = np.full(label.size, -np.inf)
        np.maximum.at(highest, cell[here], z[here])
        here &= z >= highest[cell] - SAME
        first = np.full(label.size, model.ngeom, dtype=np.int32)
        np.minimum.at(first, cell[here], geom[here])
        label[:] = number[first].reshape(lattice.shape)
    return Claim([_room_name(names[geom]) for geom in chosen], labels, warnings)


def claim_by_sites(
    scene: Scene,
    levels: Sequence[LevelFloor],
    patterns: Sequence[str],
    lattice: Lattice,
    agent_height: float,
    min_area: float,
) -> Claim:
    """Give each cell the room in whose site's volume an agent in it stands.

    Counted is the vertical line through the cell's centre, from 5 cm below its floor to the
    agent's height over it. At least half of what the volume has of the line, or half of the
    agent, has to be between the two. So a marker that lies on the floor, a box from floor to
    ceiling and a sphere round the middle of a room are each as large as they look from above,
    and none reaches into the next storey. Of volumes that overlap the first counts.

    Args:
        scene: the scene.
        levels: the storeys.
        patterns: of site names.
        lattice: the cells.
        agent_height: [m].
        min_area: of floor that a site marks at least, on all levels together [m²].
    """
    model, data = scene.model, scene.data
    names = [name_at(model, address) for address in model.name_siteadr]
    chosen, warnings = _match(names, patterns, DEFAULT_SITES, "sites")
    labels = [np.zeros(lattice.shape, dtype=np.int32) for _ in levels]
    kept: list[str | None] = []
    small: list[str] = []
    for site in chosen:
        solid = _solid(model.site_type[site], data, site, model.site_size[site])
        masks = [_stands_in(solid, level.floor, lattice, agent_height) for level in levels]
        if sum(int(mask.sum()) for mask in masks) * lattice.cell_size**2 < min_area:
            small.append(names[site])
            continue
        kept.append(names[site])
        for label, mask in zip(labels, masks, strict=True):
            label[mask & (label == 0)] = len(kept)
    if small:
        warnings.append(
            f"sites that hold less than {min_area:g} m² of floor (`rooms.min_area`) are no "
            f"rooms: {', '.join(small[:5])}{', …' if len(small) > 5 else ''}"
        )
    return Claim(kept, labels, warnings)


def claim_by_polygons(
    levels: Sequence[LevelFloor],
    polygons: Sequence[RoomPolygon],
    lattice: Lattice,
) -> Claim:
    """Give each cell the room in whose polygon its centre lies; of several, the first.

    Args:
        levels: the storeys.
        polygons: the rooms.
        lattice: the cells.

    Raises:
        ConfigError: a polygon's level is none of the levels.
    """
    labels = [np.zeros(lattice.shape, dtype=np.int32) for _ in levels]
    warnings = []
    for number, polygon in enumerate(polygons):
        level = _find_level(polygon, number, levels)
        mask = cover_cells([polygon.points, *polygon.rings], lattice)
        if not (mask & ~np.isnan(levels[level].floor)).any():
            warnings.append(
                f"room {_called(polygon, number)} of `rooms.polygons` has no floor on "
                f"{levels[level].name}, whose {_span(levels[level], lattice)}"
            )
        labels[level][mask & (labels[level] == 0)] = number + 1
    return Claim([polygon.name for polygon in polygons], labels, warnings)


def _surfaces_of(
    scene: Scene, columns: Columns, chosen: Sequence[int]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int32]]:
    """The surfaces of geoms that face up: cells, heights, geoms.

    The columns have those that count already, but hulls cover more than the meshes do.
    """
    known = [geom for geom in chosen if scene.geoms[geom].shape not in ("", "hull")]
    parts = [(columns, known)]
    others = set(chosen) - set(known)
    if others:
        choices = [
            Choice(geom in others, "marks a room", "surface") for geom in range(len(scene.geoms))
        ]
        shapes = collect_shapes(scene.model, scene.data, choices, {}).shapes
        parts.append((cast_columns(tile_shapes(shapes, columns.lattice, 0.0)), sorted(others)))
    found = []
    for surfaces, geoms in parts:
        is_meant = np.zeros(len(scene.geoms), dtype=np.bool_)
        is_meant[geoms] = True
        at = np.flatnonzero(is_meant[surfaces.geom] & (surfaces.normal[:, 2] > 0))
        cell = np.searchsorted(surfaces.start, at, side="right") - 1
        found.append((cell, surfaces.z[at], surfaces.geom[at]))
    cells, heights, geoms_of = zip(*found, strict=True)
    return np.concatenate(cells), np.concatenate(heights), np.concatenate(geoms_of)


def _match(
    names: Sequence[str], patterns: Sequence[str], defaults: Sequence[str], setting: str
) -> tuple[list[int], list[str]]:
    """Ids of what matches; what the user looks for and isn't there is told, with near names."""
    chosen: set[int] = set()
    warnings = []
    for pattern in patterns:
        found = [k for k, name in enumerate(names) if name and fnmatchcase(name, pattern)]
        chosen.update(found)
        if not found and pattern not in defaults:
            warnings.append(warn_unmatched(f"rooms.{setting}", pattern, names))
    return sorted(chosen), warnings


def _room_name(geom: str) -> str:
    for prefix in FLOOR_PREFIXES:
        if geom.startswith(prefix) and geom != prefix:
            return geom.removeprefix(prefix)
    return geom


def _solid(kind: int, data: object, site: int, size: NDArray[np.float64]) -> Solids:
    pos = data.site_xpos[[site]].astype(np.float64)  # type: ignore[attr-defined]
    mat = data.site_xmat[[site]].astype(np.float64)  # type: ignore[attr-defined]
    kinds = np.array([kind], dtype=np.int32)
    size = size[None].astype(np.float64)
    return Solids(
        np.array([site], dtype=np.int32), kinds, pos, mat, size, solid_bounds(kinds, pos, mat, size)
    )


def _stands_in(
    solid: Solids, floor: NDArray[np.float64], lattice: Lattice, agent_height: float
) -> NDArray[np.bool_]:
    mask = np.zeros(lattice.shape, dtype=np.bool_)
    x0, y0, _, x1, y1, _ = solid.bounds[0]
    (row0, row1), (col0, col1) = lattice.rows_cols([[x0, y1], [x1, y0]])
    rows = slice(max(row0, 0), max(row1 + 1, 0))
    cols = slice(max(col0, 0), max(col1 + 1, 0))
    bottom = floor[rows, cols] - OFF_FLOOR
    top = floor[rows, cols] + agent_height
    x, y = np.meshgrid(lattice.center_x()[cols], lattice.center_y()[rows])
    low, high = vertical_chords(solid, x, y)
    inside = np.minimum(high, top) - np.maximum(low, bottom)
    enough = HALF * np.minimum(high - low, agent_height)
    with np.errstate(invalid="ignore"):
        mask[rows, cols] = (high > low) & (inside >= enough - SAME)
    return mask


def _find_level(polygon: RoomPolygon, number: int, levels: Sequence[LevelFloor]) -> int:
    names = [level.name for level in levels]
    if isinstance(polygon.level, int) and polygon.level < len(levels):
        return polygon.level
    if polygon.level in names:
        return names.index(str(polygon.level))
    listed = ", ".join(f"{k} ({name})" for k, name in enumerate(names))
    raise ConfigError(
        f"no level {polygon.level!r} for room {_called(polygon, number)} of `rooms.polygons`: "
        f"there are {listed}"
    )


def _called(polygon: RoomPolygon, number: int) -> str:
    return repr(polygon.name) if polygon.name else f"[{number}]"


def _span(level: LevelFloor, lattice: Lattice) -> str:
    rows, cols = np.nonzero(~np.isnan(level.floor))
    x, y = lattice.center_x()[cols], lattice.center_y()[rows]
    return f"floor spans x {x.min():.2f} to {x.max():.2f}, y {y.min():.2f} to {y.max():.2f} m"
