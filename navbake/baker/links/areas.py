"""Areas of the settings, painted on the floors: keep-out, slow and expensive zones."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import cast_columns, tile_shapes
from navbake.baker.core.tolerances import LIMIT_SLACK, TOUCH_DEPTH
from navbake.baker.core.windows import Window
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.geometry.extents import measure_extents
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.baker.occupancy.occupancy import Footprint, check_occupancy
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.scene.collect import GeomSelection, collect_shapes
from navbake.baker.scene.names import all_names, warn_unmatched
from navbake.baker.scene.scene import Scene
from navbake.config.links import AreaSettings
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError
from navbake.known_names import suggest
from navbake.navgrid.lattice import Lattice, cover_cells, touch_cells
from navbake.navgrid.links import Area
from navbake.types import Bool, Float, Json

BELOW = 0.05  # a geom marks a floor that lies up to so far over it, as a rug does [m]


class PaintedAreas(NamedTuple):
    """The areas of the settings on the whole lattice."""

    layers: list[NDArray[np.uint8]]  # the area of each cell of each level, 1-based, 0 for none
    table: list[Json]  # the areas as a file states them
    warnings: list[str]  # what the user should know, one line each


Marked = tuple[list[Bool], float, list[str]]
"""The cells of an area by level, how wide it is [m], NaN if unknown, and warnings."""


def paint_areas(
    scene: Scene, lattice: Lattice, levels: Sequence[LevelFloor], rooms: Rooms, config: BakeConfig
) -> PaintedAreas:
    """Paint the areas one over the other; later ones win.

    A keep-out area, one that bars any agent, takes each cell with a floor whose open square it
    touches; any other takes the cells whose centres lie in it.

    Raises:
        ConfigError: an area's level doesn't exist.
    """
    layers = [np.zeros(lattice.shape, dtype=np.uint8) for _ in levels]
    table = list[Json]()
    warnings = list[str]()
    for number, area in enumerate(config.areas, 1):
        if area.room is not None:
            masks, width, notes = _mark_room(area, rooms)
        elif area.geoms:
            masks, width, notes = _mark_geoms(area, scene, lattice, levels, config.agent.height)
        else:
            masks, width, notes = _mark_outline(area, lattice, levels)
        count = 0
        for layer, level, mask in zip(layers, levels, masks, strict=True):
            mask &= ~np.isnan(level.floor)
            layer[mask] = number
            count += int(np.count_nonzero(mask))
        warnings += notes
        if not count and not notes:
            warnings.append(f"area {area.name!r} covers no cell with a floor")
        elif count and width < lattice.cell_size * (1 - LIMIT_SLACK):
            takes = "it takes each cell that it touches, so it is wider in the grid"
            takes = takes if area.keeps_out else "it takes cells by their centres, so it has gaps"
            size = f"{width:.3g} m wide, thinner than a cell of {lattice.cell_size:g} m"
            warnings.append(f"area {area.name!r} is only {size}: {takes}")
        agents = None if area.agents is None else tuple(area.agents)
        table.append(Area(area.name, float(area.cost), area.speed, agents).to_json())
    return PaintedAreas(layers, table, warnings)


def _mark_room(area: AreaSettings, rooms: Rooms) -> Marked:
    own = [room for room in rooms.table if area.room in (room.id, room.name)]
    masks = [np.zeros_like(layer, dtype=np.bool_) for layer in rooms.index]
    for room in own:
        masks[room.level] |= rooms.index[room.level] == room.index
    known = [room.name or room.id for room in rooms.table]
    why = f"no room {area.room!r} for area {area.name!r}: {suggest(area.room, known)}"
    return masks, np.nan, [] if own else [why]


def _mark_outline(area: AreaSettings, lattice: Lattice, levels: Sequence[LevelFloor]) -> Marked:
    """The cells of a polygon on its level, or of a box on all levels with floors in it."""
    cover = touch_cells if area.keeps_out else cover_cells
    if area.box is not None:
        (x0, y0, low), (x1, y1, high) = area.box
        mask = cover([[(x0, y0), (x1, y0), (x1, y1), (x0, y1)]], lattice)
        floors = [level.floor for level in levels]
        within = [(low - LIMIT_SLACK <= floor) & (floor <= high + LIMIT_SLACK) for floor in floors]
        return [mask & inside for inside in within], min(x1 - x0, y1 - y0), []
    on = [k for k, level in enumerate(levels) if area.level in (k, level.name)]
    if not on:
        listed = ", ".join(f"{k} ({level.name})" for k, level in enumerate(levels))
        raise ConfigError(f"no level {area.level!r} for area {area.name!r}: there are {listed}")
    masks = [np.zeros(lattice.shape, np.bool_) for _ in levels]
    outline = area.polygon or []
    masks[on[0]] = cover([outline, *area.rings], lattice)
    corners = np.array(outline)
    sides = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(*sides.T)
    normals = np.stack([-sides[:, 1], sides[:, 0]])[:, length > 0] / length[length > 0]
    return masks, float(np.ptp(corners @ normals, axis=0).min()), []


def _mark_geoms(
    area: AreaSettings, scene: Scene, lattice: Lattice, levels: Sequence[LevelFloor], high: float
) -> Marked:
    """The cells over whose floors geoms, left out or not, stand or hang lower than an agent's head.

    The agent is `high` [m].
    """
    names = [geom.geom for geom in all_names(scene.model).geoms]
    masks = [np.zeros(lattice.shape, np.bool_) for _ in levels]
    warnings = list[str]()
    chosen = np.zeros(len(names), dtype=np.bool_)
    for pattern in area.geoms:
        found = [fnmatchcase(name, pattern) for name in names]
        chosen |= found
        if not any(found):
            text = warn_unmatched("geoms", pattern, names)
            warnings.append(f"of area {area.name!r}, {text}")
    if not chosen.any():
        return masks, np.nan, warnings
    geoms = np.flatnonzero(chosen).tolist()
    known = scene.selections
    modes = {geom: known[geom].mesh if known[geom].counted else "surface" for geom in geoms}
    choices = {geom: GeomSelection(True, "marks an area", modes[geom]) for geom in geoms}
    shapes, *_ = collect_shapes(scene.model, scene.data, choices, scene.exact_meshes, geoms)
    window: Window | None = np.s_[0 : lattice.height], np.s_[0 : lattice.width]
    if not len(shapes.planes.geom) and not shapes.endless.any():
        window = None if shapes.bounds is None else lattice.window(shapes.bounds)
    if window is None:
        return masks, np.nan, warnings
    tiled = tile_shapes(shapes, lattice.cut(*window), lattice.cell_size)
    columns = cast_columns(tiled)
    # surfaces that enclose nothing are looked for in squares wider by 2 * TOUCH_DEPTH
    square = lattice.cell_size / 2 - 3 * TOUCH_DEPTH
    touching = Footprint(square, 0.0, -BELOW, high - TOUCH_DEPTH)
    for mask, level in zip(masks, levels, strict=True):
        floor = level.floor[window].ravel()
        cells = np.flatnonzero(~np.isnan(floor))
        floors = floor[cells]
        inside = np.zeros(len(cells), dtype=np.bool_)
        if area.keeps_out:
            inside = check_occupancy(columns, tiled, touching, cells, floors).occupied
        else:
            band: tuple[Float, Float] = (floors - BELOW, floors + high)
            find_blocked_lines(cells, *band, columns.hits, inside, 0, len(cells))
        part = np.zeros(len(floor), dtype=np.bool_)
        part[cells[inside]] = True
        mask[window] = part.reshape(mask[window].shape)
    thin = measure_extents(shapes, len(names)).thin[geoms]
    return masks, float(np.nanmin(thin, initial=np.inf)), warnings
