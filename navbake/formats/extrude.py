"""Converts grids to MuJoCo scenes: floors as slabs and blocked cells as walls, in few boxes.

With the settings written beside it, the scene bakes to the cells of the grid:

- A floor is a slab under each cell that has one, at its height. Unknown cells have none.
- A wall stands on the floor of each blocked cell that isn't unknown. It rises to the floor above
  it, or over all floors, so that its top is no floor by itself.
- Adjacent cells with the same heights share a box (`cover_quads`). Boxes are a thousandth of a
  cell smaller on each side, so that none reaches into an adjacent cell.
- Blocked cells that are not connected with a free cell, even through other blocked cells, become
  unknown: a bake derives the floor under objects from the floor beside them.
- Of several levels, the same places are free at the same heights. Where levels interleave, as at
  the top of a stair, a tread may move to the level below.
- The settings have the cells' size and place, the levels' grounds, an agent without a radius (the
  cells already include the grid's), and keep floors of any size.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from navbake.errors import FormatError
from navbake.formats.convert import select_levels
from navbake.formats.floor_mesh import cover_quads
from navbake.formats.source import Files, check_named
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Json
from navbake.yaml_text import encode_yaml

WALL_HEIGHT = 2.5  # over the highest floor [m]
SLAB = 0.02  # thickness of a floor [m]; thin, because it takes headroom from the level below
INSET = 1e-3  # of a cell, by which a box is smaller on each side
OVER_FLOORS = 0.01  # where the uppermost level ends, over its highest floor [m]; walls go on
MAX_BOXES = 200_000
HIGHEST = 1e4  # of walls [m]
DIGITS = 9  # of lengths in the settings, after the point [m]
HEAD = """\
  <default>
    <default class="floor"><geom type="box" rgba="0.82 0.8 0.76 1"/></default>
    <default class="wall"><geom type="box" rgba="0.45 0.5 0.58 1"/></default>
  </default>
  <worldbody>
    <light directional="true" dir="-0.4 -0.2 -1" diffuse="0.8 0.8 0.8"/>
"""


def encode_mjcf(
    grid: NavGrid,
    path: Path,
    *,
    level: int | None = None,
    height: float | None = None,
    flat: bool | None = None,
) -> Files:
    """Make a scene of a grid, and settings beside it that bake it to the same cells.

    Args:
        path: ends in ``.xml``; the settings have the same name, with ``.yaml``.
        level: this level only; all if None, each at its height.
        height: of walls over the highest floor [m], more than the agent's height. If None: 2.5,
            or more for a high agent.
        flat: put all floors of a level at its ground, as on a map without heights; needs fewer
            boxes on rough ground.

    Raises:
        FormatError: there is no such level or no free cell, the walls are too low, levels don't
            lie over each other, or more than 200,000 boxes are needed.
    """
    levels = [grid.levels[k] for k in select_levels(grid, path, level, (".xml",))]
    least = grid.agent_height
    height = max(WALL_HEIGHT, least + 1.0) if height is None else height
    if not least < height <= HIGHEST:
        raise FormatError(f"expected walls higher than the agent ({least:g} m), got {height:g} m")
    floors = [_floor_of(own, bool(flat)) for own in levels]
    if not any((own.free & ~np.isnan(z)).any() for own, z in zip(levels, floors, strict=True)):
        raise FormatError("the grid has no free cell to make a scene of")
    lattice, windows = _place_levels(levels)
    stacked = np.full((len(levels), *lattice.shape), np.nan)
    for k, window in enumerate(windows):
        stacked[(k, *window)] = floors[k]
    top = float(np.nanmax(stacked)) + height
    parts = list[tuple[str, Float]]()
    for k, (own, window, floor) in enumerate(zip(levels, windows, floors, strict=True)):
        # walls end under the next floor above, else at the top
        with np.errstate(invalid="ignore"):
            others = stacked[(slice(None), *window)]
            above = np.where(others > floor, others, np.inf).min(axis=0)
        ceiling = np.where(np.isinf(above), top, above - SLAB)
        has_floor = ~np.isnan(floor)
        parts.append((f"floor_{k}", _boxes(own.lattice, has_floor, floor - SLAB, floor)))
        stands = has_floor & ~own.free & (ceiling > np.nan_to_num(floor, nan=np.inf))
        parts.append((f"wall_{k}", _boxes(own.lattice, stands, floor, ceiling)))
    num_boxes = sum(len(boxes) for _, boxes in parts)
    if num_boxes > MAX_BOXES:
        remedy = "extrude one level at a time, or with flat floors"
        most = f"expected {MAX_BOXES:,} at most"
        raise FormatError(f"the scene takes {num_boxes:,} boxes, {most}: {remedy}")
    settings = _settings(grid, path, lattice, levels, stacked)
    settings_path = path.with_suffix(".yaml")
    check_named(path)
    head = f"# Bakes {_plain(path.name)} to the cells that it was made of.\n"
    lines = _scene_lines(grid.scene_id or path.stem, parts, settings, settings_path.name)
    return {path: "".join(lines).encode(), settings_path: head.encode() + encode_yaml(settings)}


def _floor_of(level: SceneGrid2D, is_flat: bool) -> Float:
    """World z of each cell's floor, NaN for none [m]; the ground if a grid has no floors."""
    if "floorHeight" not in level.attributes:
        return np.full(level.shape, level.ground)
    return np.where(np.isnan(level.floor), np.nan, level.ground) if is_flat else level.floor


def _place_levels(levels: list[SceneGrid2D]) -> tuple[Lattice, list[tuple[slice, slice]]]:
    """The common lattice of all levels, and each level's rectangle in it."""
    cell = levels[0].lattice.cell_size
    bounds = np.array([level.lattice.bounds for level in levels])
    x0, y0 = bounds[:, :2].min(axis=0)
    x1, y1 = bounds[:, 2:].max(axis=0)
    whole = Lattice(float(x0), float(y1), cell, round((x1 - x0) / cell), round((y1 - y0) / cell))
    windows = []
    for level in levels:
        own = level.lattice
        offset = (np.array(own.bounds) - whole.bounds) / cell
        if abs(own.cell_size - cell) > 1e-9 or np.abs(offset - np.rint(offset)).max() > 1e-3:
            raise FormatError("expected levels on one lattice: extrude one (level) at a time")
        row = round((whole.y_max - own.y_max) / cell)
        col = round((own.x_min - whole.x_min) / cell)
        windows.append((slice(row, row + own.height), slice(col, col + own.width)))
    return whole, windows


def _boxes(lattice: Lattice, mask: Bool, low: Float, high: Float) -> Float:
    """Boxes over rectangles of cells with the same heights: (n, 2, 3), both corners [m]."""
    spans = np.stack([low[mask], high[mask]], axis=1)
    heights, labels = np.unique(spans, axis=0, return_inverse=True)
    cells = np.zeros(mask.shape, dtype=np.int32)
    cells[mask] = labels.ravel() + 1
    first, rows, cols, _ = cover_quads(cells, np.zeros(mask.shape), 0.0, 0.0, -INSET)
    z = heights[cells[first[:, 0], first[:, 1]].astype(np.int64) - 1]
    x = lattice.x_min + lattice.cell_size * cols[:, :2]
    y = lattice.y_max - lattice.cell_size * rows[:, 1:3]
    return np.stack([x, y, z], axis=-1)


def _settings(
    grid: NavGrid, path: Path, lattice: Lattice, levels: list[SceneGrid2D], stacked: Float
) -> Json:
    lowest = float(np.nanmin(stacked))
    highest = float(np.nanmax(stacked))
    grounds = [round(level.ground, DIGITS) + 0.0 for level in levels]
    grounds[0] = min(grounds[0], round(lowest, DIGITS) + 0.0)
    if not all(low < high for low, high in itertools.pairwise(grounds)):
        raise FormatError("expected levels with ascending grounds: extrude one (level) at a time")
    stated: list[Json] = [{"ground": ground} for ground in grounds]
    stated[-1]["top"] = round(max(highest, grounds[-1]) + OVER_FLOORS, DIGITS)
    step = min(grid.max_step, 0.99 * grid.agent_height)
    return {
        "scene": {"path": path.name},
        "agent": {"height": grid.agent_height, "radius": 0.0, "traversable_floor_height": step},
        "grid": {
            "cell_size": lattice.cell_size,
            "bounds": [round(value, DIGITS) + 0.0 for value in lattice.bounds],
            "max_cells": max(25_000_000, lattice.width * lattice.height),
        },
        "levels": stated,
        "floors": {"min_area": 0, "shrink": 0, "crack": 0, "tops": True, "roofs": True},
    }


def _scene_lines(
    name: str, parts: list[tuple[str, Float]], settings: Json, settings_name: str
) -> Iterator[str]:
    cells = settings["grid"]
    stated = f"cells of {cells['cell_size']!r} m, bounds {cells['bounds']}"
    where = f"with the settings in {_plain(settings_name)}: {stated}"
    yield f"<mujoco model={quoteattr(''.join(filter(str.isprintable, name)))}>\n"
    yield f"  <!-- It bakes to the cells that it was made of {where} -->\n{HEAD}"
    for prefix, boxes in parts:
        kind = prefix.split("_")[0]
        low = boxes[:, 0]
        high = boxes[:, 1]
        both = zip(((low + high) / 2).tolist(), ((high - low) / 2).tolist(), strict=True)
        for k, (at, size) in enumerate(both):
            pos = " ".join(map(repr, at))
            extent = " ".join(map(repr, size))
            yield f'    <geom name="{prefix}_{k}" class="{kind}" pos="{pos}" size="{extent}"/>\n'
    yield "  </worldbody>\n</mujoco>\n"


def _plain(text: str) -> str:
    """Text for an XML comment: without two hyphens in a row."""
    return re.sub("-(?=-)", "- ", "".join(filter(str.isprintable, text)))
