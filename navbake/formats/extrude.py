"""Grids as MuJoCo scenes: floors as slabs, and what is blocked as walls, in as few boxes as may be.

With the settings that are written beside it, the scene bakes to the cells that it was made of:

- A floor is a slab under each cell that has one, at its height. What is unknown has none.
- A wall stands on the floor of each cell that is blocked and not unknown. It rises to the floor
  above it, or over all floors; so its top is no floor by itself.
- Cells next to each other with the same heights share a box (`cover_planes`). Boxes are
  a thousandth of a cell smaller on each side, so that none reaches into a cell beside it.
- What is blocked and touches no free cell, not through other blocked cells either, comes back as
  unknown: a bake knows the floor under things from the floor beside them.
- Of several levels, the same places are free at the same heights. Where levels interleave, as at
  the top of a stair, a tread may come back on the level below.
- The settings have the cells' size and place, the levels' grounds, an agent without a radius (that
  of the grid is in its cells already), and keep floors of any size.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.formats.source import Files
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Json

WALL_HEIGHT = 2.5  # over the highest floor [m]
SLAB = 0.02  # thickness of a floor [m]; thin, because it takes headroom from the level below
INSET = 1e-3  # of a cell, by which a box is smaller on each side
OVER_FLOORS = 0.01  # where the uppermost level ends, over its highest floor [m]; walls go on
MAX_BOXES = 200_000
HIGHEST = 1e4  # of walls [m]
DIGITS = 9  # of lengths in the settings, after the point [m]
FLOOR, WALL = "0.82 0.8 0.76 1", "0.45 0.5 0.58 1"  # colours


class Boxes(NamedTuple):
    """Boxes along the world's axes: lower and upper corners, each of shape (n, 3) [m]."""

    low: Float
    high: Float


def encode_mjcf(
    grid: NavGrid,
    path: Path,
    *,
    level: int | None = None,
    height: float | None = None,
    flat: bool | None = None,
) -> Files:
    """Make a scene of a grid, and beside it the settings that bake it to the same cells.

    Args:
        path: ends in ``.xml``; the settings have the same name, with ``.yaml``.
        level: of this level only; of all if None, each at its height.
        height: how far walls rise over the highest floor [m], more than the agent's height.
            2.5 if None, or as much more as the agent is high.
        flat: lay all floors of a level at its ground, as on a map without heights; needs fewer
            boxes where the ground is rough.

    Raises:
        FormatError: there is no such level or no free cell, the walls are too low, levels don't
            lie over each other, or it takes more than 200,000 boxes.
    """
    if path.suffix.lower() != ".xml":
        raise FormatError(f"expected a name that ends in .xml, got {path}")
    count = len(grid.levels)
    if level is not None and not 0 <= level < count:
        raise FormatError(f"no level {level}: the grid has {count}, counted from 0")
    height = _check_height(grid, height)
    levels = grid.levels if level is None else [grid.levels[level]]
    floors = [_floor_of(one, bool(flat)) for one in levels]
    if not any(
        (one.free & ~np.isnan(floor)).any() for one, floor in zip(levels, floors, strict=True)
    ):
        raise FormatError("the grid has no free cell to make a scene of")
    lattice = _common_lattice(levels)
    stacked = _stack(levels, floors, lattice)
    parts = _make_boxes(levels, stacked, lattice, float(np.nanmax(stacked)) + height)
    settings = _settings(grid, path, lattice, levels, stacked)
    settings_path = path.with_suffix(".yaml")
    lines = _write_scene(grid.scene_id or path.stem, parts, settings, settings_path)
    text = yaml.safe_dump(settings, sort_keys=False, default_flow_style=None, allow_unicode=True)
    head = f"# Bakes {_plain(path.name)} to the cells that it was made of.\n"
    return {path: "".join(lines).encode(), settings_path: (head + text).encode()}


def _check_height(grid: NavGrid, height: float | None) -> float:
    least = grid.agent_height
    height = max(WALL_HEIGHT, least + 1.0) if height is None else height
    if not least < height <= HIGHEST:
        raise FormatError(f"expected walls higher than the agent ({least:g} m), got {height:g} m")
    return height


def _make_boxes(
    levels: list[SceneGrid2D], stacked: Float, lattice: Lattice, top: float
) -> list[tuple[str, Boxes]]:
    """Floors and walls of each level, each under the first part of its boxes' names."""
    parts: list[tuple[str, Boxes]] = []
    for k, level in enumerate(levels):
        rows, cols = _window(level.lattice, lattice)
        floor = stacked[k, rows, cols]
        ceiling = _ceiling(floor, stacked[:, rows, cols], top)
        parts.append((f"floor_{k}", _slabs(level.lattice, floor)))
        parts.append((f"wall_{k}", _walls(level.lattice, floor, ~level.free, ceiling)))
    num_boxes = sum(len(boxes.low) for _, boxes in parts)
    if num_boxes > MAX_BOXES:
        raise FormatError(
            f"the scene takes {num_boxes:,} boxes, expected {MAX_BOXES:,} at most: extrude one "
            "level at a time, or with flat floors"
        )
    return parts


def _floor_of(level: SceneGrid2D, is_flat: bool) -> Float:
    """World z of each cell's floor, NaN for none [m].

    Where a grid states no floors, it has one everywhere at its ground.
    """
    floor = level.floor
    if "floorHeight" not in level.attributes:
        return np.full(level.shape, level.ground)
    return np.where(np.isnan(floor), np.nan, level.ground) if is_flat else floor


def _common_lattice(levels: list[SceneGrid2D]) -> Lattice:
    """The lattice of all levels together; each is a rectangle of its cells."""
    cell = levels[0].lattice.cell_size
    bounds = np.array([level.lattice.bounds for level in levels])
    (x0, y0), (x1, y1) = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    lattice = Lattice(float(x0), float(y1), cell, round((x1 - x0) / cell), round((y1 - y0) / cell))
    for level in levels:
        offset = (np.array(level.lattice.bounds) - lattice.bounds) / cell
        if (
            abs(level.lattice.cell_size - cell) > 1e-9
            or np.abs(offset - np.rint(offset)).max() > 1e-3
        ):
            raise FormatError("expected levels on one lattice: extrude one (level) at a time")
    return lattice


def _window(own: Lattice, whole: Lattice) -> tuple[slice, slice]:
    row = round((whole.y_max - own.y_max) / whole.cell_size)
    col = round((own.x_min - whole.x_min) / whole.cell_size)
    return slice(row, row + own.height), slice(col, col + own.width)


def _stack(levels: list[SceneGrid2D], floors: list[Float], lattice: Lattice) -> Float:
    """The floors of all levels on one lattice, shape (num_levels, height, width)."""
    stacked = np.full((len(levels), *lattice.shape), np.nan)
    for k, (level, floor) in enumerate(zip(levels, floors, strict=True)):
        stacked[(k, *_window(level.lattice, lattice))] = floor
    return stacked


def _ceiling(floor: Float, others: Float, top: float) -> Float:
    """Where walls on these floors end: under the next floor above, else at the top."""
    with np.errstate(invalid="ignore"):
        above = np.where(others > floor, others, np.inf).min(axis=0)
    return np.where(np.isinf(above), top, above - SLAB)


def _slabs(lattice: Lattice, floor: Float) -> Boxes:
    has_floor = ~np.isnan(floor)
    heights, labels = np.unique(floor[has_floor], return_inverse=True)
    bounds, labels = _cover(has_floor, labels)
    return _boxes(lattice, bounds, heights[labels] - SLAB, heights[labels])


def _walls(lattice: Lattice, floor: Float, blocked: Bool, ceiling: Float) -> Boxes:
    stands = blocked & ~np.isnan(floor)
    stands[stands] = ceiling[stands] > floor[stands]
    spans = np.stack([floor[stands], ceiling[stands]], axis=1)
    heights, labels = np.unique(spans, axis=0, return_inverse=True)
    bounds, labels = _cover(stands, labels)
    return _boxes(lattice, bounds, *heights[labels].T)


def _cover(mask: Bool, labels: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rectangles of cells of one label, and which label each has."""
    from navbake.formats.kernels.planes import cover_planes  # numba loads slowly

    cells = np.zeros(mask.shape, dtype=np.int32)
    cells[mask] = labels.ravel() + 1
    bounds, _ = cover_planes(cells, np.zeros(mask.shape), 0.0, 0.0)
    return bounds, cells[bounds[:, 0], bounds[:, 1]].astype(np.int64) - 1


def _boxes(lattice: Lattice, bounds: NDArray[np.int64], low: Float, high: Float) -> Boxes:
    row, col, end_row, end_col = bounds.T.astype(np.float64)
    cell = lattice.cell_size
    x = lattice.x_min + cell * np.stack([col + INSET, end_col - INSET])
    y = lattice.y_max - cell * np.stack([end_row - INSET, row + INSET])
    return Boxes(np.stack([x[0], y[0], low], axis=1), np.stack([x[1], y[1], high], axis=1))


def _settings(
    grid: NavGrid, path: Path, lattice: Lattice, levels: list[SceneGrid2D], stacked: Float
) -> Json:
    lowest, highest = float(np.nanmin(stacked)), float(np.nanmax(stacked))
    grounds = [round(level.ground, DIGITS) + 0.0 for level in levels]
    grounds[0] = min(grounds[0], round(lowest, DIGITS) + 0.0)
    if not all(low < high for low, high in itertools.pairwise(grounds)):
        raise FormatError("expected levels with ascending grounds: extrude one (level) at a time")
    stated: list[Json] = [{"ground": ground} for ground in grounds]
    stated[-1]["top"] = round(max(highest, grounds[-1]) + OVER_FLOORS, DIGITS)
    step = min(grid.max_step, 0.99 * grid.agent_height)
    return {
        "scene": {"path": path.name},
        "agent": {
            "height": grid.agent_height,
            "radius": 0.0,
            "traversable_floor_height": step,
        },
        "grid": {
            "cell_size": lattice.cell_size,
            "bounds": [round(value, DIGITS) + 0.0 for value in lattice.bounds],
            "max_cells": max(25_000_000, lattice.width * lattice.height),
        },
        "levels": stated,
        "floors": {"min_area": 0, "shrink": 0, "crack": 0, "tops": True, "roofs": True},
    }


def _write_scene(
    name: str, parts: list[tuple[str, Boxes]], settings: Json, settings_path: Path
) -> Iterator[str]:
    printable = "".join(letter for letter in name if letter.isprintable())
    cells = settings["grid"]
    told = (
        f"{_plain(settings_path.name)}: cells of {cells['cell_size']!r} m, bounds {cells['bounds']}"
    )
    yield f"<mujoco model={quoteattr(printable)}>\n"
    yield f"  <!-- It bakes to the cells that it was made of with the settings in {told} -->\n"
    yield (
        "  <default>\n"
        f'    <default class="floor"><geom type="box" rgba="{FLOOR}"/></default>\n'
        f'    <default class="wall"><geom type="box" rgba="{WALL}"/></default>\n'
        "  </default>\n  <worldbody>\n"
        '    <light directional="true" dir="-0.4 -0.2 -1" diffuse="0.8 0.8 0.8"/>\n'
    )
    for prefix, boxes in parts:
        kind = prefix.split("_")[0]
        middle, half = (boxes.low + boxes.high) / 2, (boxes.high - boxes.low) / 2
        for k, (at, size) in enumerate(zip(middle.tolist(), half.tolist(), strict=True)):
            pos, extent = (" ".join(map(repr, values)) for values in (at, size))
            yield f'    <geom name="{prefix}_{k}" class="{kind}" pos="{pos}" size="{extent}"/>\n'
    yield "  </worldbody>\n</mujoco>\n"


def _plain(text: str) -> str:
    """Text that an XML comment may hold: no two hyphens in a row."""
    return re.sub("-(?=-)", "- ", "".join(c for c in text if c.isprintable()))
