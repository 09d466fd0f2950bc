"""Converts grids to MuJoCo scenes: floors as slabs and blocked cells as walls, in few boxes.

With the settings written beside it, the scene bakes to the cells of the grid:

- A floor is a slab under each cell that has one, at its height. Unknown cells have none.
- A wall stands on the floor of each blocked cell that isn't unknown. It rises to the next floor
  above it. If there is none, it rises over all floors, so that its top doesn't count as a floor.
- Adjacent cells with the same heights share a box (`cover_with_quads`). Boxes are a thousandth of a
  cell smaller on each side, so that none reaches into an adjacent cell.
- A group of blocked cells becomes unknown if no free cell is beside it: a bake derives the floor
  under objects from the floor beside them.
- If there are several levels, the scene bakes to the same free places at the same heights. But
  where levels overlap in height, as at the top of a stair, a tread may change to the level below.
- The settings state the cells' size and place, the levels' grounds, and an agent of radius 0, as
  the walls already include the radius of the grid's agent. The bake keeps floors of any size.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from navbake.errors import FormatError
from navbake.formats.floor_mesh import cover_with_quads
from navbake.formats.level_paths import select_levels
from navbake.formats.source import Files, check_name_encoding
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Json
from navbake.yaml_text import encode_yaml

WALL_HEIGHT = 2.5  # over the highest floor [m]
# Thickness of a floor [m]; thin, because it takes headroom from the level below
SLAB_THICKNESS = 0.02
BOX_INSET = 1e-3  # by how much a box is smaller on each side [cells]
TOP_MARGIN = 0.01  # the uppermost level ends this far over its highest floor; walls rise on [m]
MAX_BOXES = 200_000
MAX_WALL_HEIGHT = 1e4  # [m]
DECIMALS = 9  # of lengths in the settings [m]
LATTICE_TOLERANCE = 1e-3  # by how much the lattices of levels may be displaced [cells]
CELL_SIZE_TOLERANCE = 1e-9  # by how much the levels' cell sizes may differ [m]
DEFAULT_MAX_CELLS = 25_000_000  # `grid.max_cells` in the settings, unless the grid has more
SCENE_HEAD = """\
  <default>
    <default class="floor"><geom type="box" rgba="0.82 0.8 0.76 1"/></default>
    <default class="wall"><geom type="box" rgba="0.45 0.5 0.58 1"/></default>
  </default>
  <worldbody>
    <light directional="true" dir="-0.4 -0.2 -1" diffuse="0.8 0.8 0.8"/>
"""


class _Boxes(NamedTuple):
    """Boxes of one class of the scene: floors or walls of a level."""

    kind: str  # class of the geoms, floor or wall
    level: int
    corners: Float  # lower and upper corner of each box [m], shape (n, 2, 3)


def encode_mjcf(
    grid: NavGrid,
    path: Path,
    *,
    level: int | None = None,
    height: float | None = None,
    flat: bool | None = None,
) -> Files:
    """Encode a grid as a MuJoCo scene, and the settings by which the scene bakes to its cells.

    Args:
        grid: the grid.
        path: the scene, which ends in ``.xml``; the settings have the same name, with ``.yaml``.
        level: the number of the only level to write; None for all, each at its height.
        height: how far walls rise over the highest floor [m]; more than the agent's height. If
            None: 2.5 m, or 1 m more than the agent's height if that is higher.
        flat: whether to put all floors of a level at its ground, as on a map without heights; this
            needs fewer boxes on rough ground.

    Returns:
        The content of the scene and of the settings, each by its path.

    Raises:
        FormatError: there is no such level or no free cell, the walls are too low, levels don't
            lie over each other, or more than 200,000 boxes are needed.
    """
    levels = [grid.levels[index] for index in select_levels(grid, path, level, (".xml",))]
    agent_height = grid.agent_height
    if height is None:
        height = max(WALL_HEIGHT, agent_height + 1.0)
    if not agent_height < height <= MAX_WALL_HEIGHT:
        expected = f"walls higher than the agent ({agent_height:g} m)"
        raise FormatError(
            f"expected {expected}, got {height:g} m", key="height", value=height, expected=expected
        )
    floor_z_of_levels = [_find_floor(grid_level, bool(flat)) for grid_level in levels]
    has_free_cell = any(
        (grid_level.free & ~np.isnan(floor_z)).any()
        for grid_level, floor_z in zip(levels, floor_z_of_levels, strict=True)
    )
    if not has_free_cell:
        raise FormatError("the grid has no free cell to make a scene of")

    lattice, windows = _join_lattices(levels)
    # floors of all levels on the common lattice, shape (level, row, col)
    stacked_floor_z = np.full((len(levels), *lattice.shape), np.nan)
    for index, window in enumerate(windows):
        stacked_floor_z[(index, *window)] = floor_z_of_levels[index]
    wall_top_z = float(np.nanmax(stacked_floor_z)) + height
    box_groups: list[_Boxes] = []
    for index, (grid_level, window, floor_z) in enumerate(
        zip(levels, windows, floor_z_of_levels, strict=True)
    ):
        # walls end under the next floor above, else at the top
        with np.errstate(invalid="ignore"):
            window_floor_z = stacked_floor_z[(slice(None), *window)]
            next_floor_z = np.where(window_floor_z > floor_z, window_floor_z, np.inf).min(axis=0)
        ceiling_z = np.where(np.isinf(next_floor_z), wall_top_z, next_floor_z - SLAB_THICKNESS)
        has_floor = ~np.isnan(floor_z)
        slabs = _make_boxes(grid_level.lattice, has_floor, floor_z - SLAB_THICKNESS, floor_z)
        box_groups.append(_Boxes("floor", index, slabs))
        has_wall = has_floor & ~grid_level.free & (ceiling_z > np.nan_to_num(floor_z, nan=np.inf))
        walls = _make_boxes(grid_level.lattice, has_wall, floor_z, ceiling_z)
        box_groups.append(_Boxes("wall", index, walls))
    num_boxes = sum(len(boxes.corners) for boxes in box_groups)
    if num_boxes > MAX_BOXES:
        remedy = "extrude one level at a time, or with flat floors"
        expected = f"{MAX_BOXES:,} at most"
        message = f"the scene takes {num_boxes:,} boxes, expected {expected}: {remedy}"
        raise FormatError(message, value=num_boxes, expected=expected, hint=remedy)

    settings = _make_settings(grid, path, lattice, levels, stacked_floor_z)
    settings_path = path.with_suffix(".yaml")
    check_name_encoding(path)
    header_comment = f"# Bakes {_format_comment(path.name)} to the cells that it was made of.\n"
    lines = _write_scene(grid.scene_id or path.stem, box_groups, settings, settings_path.name)
    return {
        path: "".join(lines).encode(),
        settings_path: header_comment.encode() + encode_yaml(settings),
    }


def _find_floor(level: SceneGrid2D, is_flat: bool) -> Float:
    """Return world z of each cell's floor [m]; NaN where there is none.

    It is the ground in all cells if the level has no floor heights, and in all cells with a floor
    if `is_flat`.
    """
    if "floorHeight" not in level.attributes:
        return np.full(level.shape, level.ground)
    if is_flat:
        return np.where(np.isnan(level.floor), np.nan, level.ground)
    return level.floor


def _join_lattices(levels: list[SceneGrid2D]) -> tuple[Lattice, list[tuple[slice, slice]]]:
    """Return a lattice that covers all levels, and each level's slices of its rows and columns."""
    cell_size = levels[0].lattice.cell_size
    bounds = np.array([level.lattice.bounds for level in levels])
    x_min, y_min = bounds[:, :2].min(axis=0)
    x_max, y_max = bounds[:, 2:].max(axis=0)
    width = round((x_max - x_min) / cell_size)
    height = round((y_max - y_min) / cell_size)
    common_lattice = Lattice(float(x_min), float(y_max), cell_size, width, height)
    windows = []
    for level in levels:
        lattice = level.lattice
        offset_in_cells = (np.array(lattice.bounds) - common_lattice.bounds) / cell_size
        has_same_size = abs(lattice.cell_size - cell_size) <= CELL_SIZE_TOLERANCE
        if (
            not has_same_size
            or np.abs(offset_in_cells - np.rint(offset_in_cells)).max() > LATTICE_TOLERANCE
        ):
            raise FormatError("expected levels on one lattice: extrude one (level) at a time")
        first_row = round((common_lattice.y_max - lattice.y_max) / cell_size)
        first_col = round((lattice.x_min - common_lattice.x_min) / cell_size)
        windows.append(
            (
                slice(first_row, first_row + lattice.height),
                slice(first_col, first_col + lattice.width),
            )
        )
    return common_lattice, windows


def _make_boxes(lattice: Lattice, is_covered: Bool, low_z: Float, high_z: Float) -> Float:
    """Cover the cells of a mask by few boxes.

    Args:
        lattice: the lattice of the cells.
        is_covered: the cells to cover, shape (height, width).
        low_z: world z where the box of each cell begins [m], shape (height, width).
        high_z: world z where the box of each cell ends [m], shape (height, width).

    Returns:
        The lower and upper corner of each box, world x, y, z [m], shape (n, 2, 3).
    """
    height_pairs = np.stack([low_z[is_covered], high_z[is_covered]], axis=1)
    unique_pairs, pair_numbers = np.unique(height_pairs, axis=0, return_inverse=True)
    labels = np.zeros(is_covered.shape, dtype=np.int32)
    labels[is_covered] = pair_numbers.ravel() + 1
    quads = cover_with_quads(labels, np.zeros(is_covered.shape), 0.0, 0.0, -BOX_INSET)
    quad_labels = labels[quads.first_cell[:, 0], quads.first_cell[:, 1]]
    z = unique_pairs[quad_labels.astype(np.int64) - 1]
    # the first two corners of a quad differ in x, the second and the third in y
    x = lattice.x_min + lattice.cell_size * quads.cols[:, :2]
    y = lattice.y_max - lattice.cell_size * quads.rows[:, 1:3]
    return np.stack([x, y, z], axis=-1)


def _make_settings(
    grid: NavGrid, path: Path, lattice: Lattice, levels: list[SceneGrid2D], stacked_floor_z: Float
) -> Json:
    """Return the settings that bake the scene to the cells of the grid."""
    lowest_floor_z = float(np.nanmin(stacked_floor_z))
    highest_floor_z = float(np.nanmax(stacked_floor_z))
    grounds = [round(level.ground, DECIMALS) + 0.0 for level in levels]
    grounds[0] = min(grounds[0], round(lowest_floor_z, DECIMALS) + 0.0)
    if not all(low < high for low, high in itertools.pairwise(grounds)):
        raise FormatError("expected levels with ascending grounds: extrude one (level) at a time")
    level_entries: list[Json] = [{"ground": ground} for ground in grounds]
    level_entries[-1]["top"] = round(max(highest_floor_z, grounds[-1]) + TOP_MARGIN, DECIMALS)
    max_step = min(grid.max_step, 0.99 * grid.agent_height)
    return {
        "scene": {"path": path.name},
        "agent": {"height": grid.agent_height, "radius": 0.0, "traversable_floor_height": max_step},
        "grid": {
            "cell_size": lattice.cell_size,
            "bounds": [round(value, DECIMALS) + 0.0 for value in lattice.bounds],
            "max_cells": max(DEFAULT_MAX_CELLS, lattice.width * lattice.height),
        },
        "levels": level_entries,
        "floors": {"min_area": 0, "shrink": 0, "crack": 0, "tops": True, "roofs": True},
    }


def _write_scene(
    name: str, box_groups: list[_Boxes], settings: Json, settings_file_name: str
) -> Iterator[str]:
    """Yield the lines of the scene's MJCF."""
    grid_settings = settings["grid"]
    cells_text = f"cells of {grid_settings['cell_size']!r} m, bounds {grid_settings['bounds']}"
    settings_text = f"with the settings in {_format_comment(settings_file_name)}: {cells_text}"
    yield f"<mujoco model={quoteattr(''.join(filter(str.isprintable, name)))}>\n"
    yield f"  <!-- It bakes to the cells that it was made of {settings_text} -->\n{SCENE_HEAD}"
    for boxes in box_groups:
        lower_corners = boxes.corners[:, 0]
        upper_corners = boxes.corners[:, 1]
        centers = ((lower_corners + upper_corners) / 2).tolist()
        half_extents = ((upper_corners - lower_corners) / 2).tolist()
        for box_number, (center, half_extent) in enumerate(zip(centers, half_extents, strict=True)):
            geom_name = f"{boxes.kind}_{boxes.level}_{box_number}"
            pos_text = " ".join(map(repr, center))
            size_text = " ".join(map(repr, half_extent))
            yield (
                f'    <geom name="{geom_name}" class="{boxes.kind}" pos="{pos_text}" '
                f'size="{size_text}"/>\n'
            )
    yield "  </worldbody>\n</mujoco>\n"


def _format_comment(text: str) -> str:
    """Return text that an XML comment can hold: without two hyphens in a row."""
    return re.sub("-(?=-)", "- ", "".join(filter(str.isprintable, text)))
