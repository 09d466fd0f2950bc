"""The lattice that a scene is baked on."""

import math
from bisect import bisect_left
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError, SceneError
from navbake.navgrid.lattice import CELL_SLACK, Lattice
from navbake.types import Bool, Float, Int

Window = tuple[slice, slice]
"""Rows and columns of the whole lattice, with a start and a stop each."""

BOX_ROUNDING = 1e-6  # of a box's farthest coordinate; float32 has 6e-8, and is computed with
# Where the two cells of each edge are in an array: left and right, upper and lower
EDGES: tuple[tuple[Any, Any], ...] = ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:]))


def list_differing(values: NDArray[Any]) -> Int:
    """The ids of cells beside each other whose values differ, (height, width); shape (2, n)."""
    width, flat = values.shape[1], values.ravel()
    right = np.flatnonzero(flat[:-1] != flat[1:])
    right = right[(right + 1) % width > 0]
    down = np.flatnonzero(flat[:-width] != flat[width:])
    pairs = [right, right + 1], [down, down + width]
    return np.concatenate(pairs, axis=1)


def lay_lattice(scene: Scene, config: BakeConfig) -> Lattice:
    """Lay one lattice over the scene, or over the bounds of the settings.

    A scene's extents are reduced by `BOX_ROUNDING`, so that meshes in float32, in inches or 10 km
    away, get as many cells as exact numbers would.
    """
    settings = config.grid
    # where what stands is endless, what can move is the box
    box = scene.shapes.bounds if scene.bounds is None else scene.bounds
    if settings.bounds is not None:
        bounds = tuple(settings.bounds)
    elif box is not None:
        bounds = (*box[0, :2].tolist(), *box[1, :2].tolist())
    else:
        endless = f"only infinite planes count in {config.scene.path}, so the grid has no end"
        raise ConfigError(f"{endless}: set `grid.bounds` to [x_min, y_min, x_max, y_max]")
    if not np.isfinite(bounds).all():
        raise SceneError(f"the scene {config.scene.path} has geoms whose pose is not finite")
    sides = [bounds[2] - bounds[0], bounds[3] - bounds[1]]
    # a float, because an integer could be too large to convert
    cells = math.prod(max(1.0, (s + 2 * settings.margin) / settings.cell_size) for s in sides)
    if cells > settings.max_cells:
        raise ConfigError(
            f"a grid of {cells:.3g} cells is more than `grid.max_cells` = {settings.max_cells}: "
            f"{sides[0]:.6g} x {sides[1]:.6g} m at `grid.cell_size` = {settings.cell_size:g} m; "
            f"check the scene's unit (`scene.unit`), the cell size, or raise the limit"
        )
    rounding = 0.0 if settings.bounds is not None else BOX_ROUNDING * float(np.abs(bounds).max())
    bounds = tuple(float(b) for b in bounds)
    return Lattice.cover(bounds, settings.cell_size, settings.margin, rounding)


def lay_whole(lattice: Lattice, bounds: Float | None, max_cells: int) -> tuple[Lattice, Window]:
    """Extend a lattice to the whole scene; returns it, and the given one as its window.

    It is extended by whole cells up to the scene's `bounds`, (2, 3) [m], but not if these are None,
    for an endless scene. With too many cells it is extended to all sides as far as possible.
    """
    if bounds is None:
        return lattice, (slice(0, lattice.height), slice(0, lattice.width))
    x0, y0, x1, y1 = lattice.bounds
    (west, south), (east, north) = bounds[:, :2].tolist()
    rounding = BOX_ROUNDING * float(np.abs(bounds[:, :2]).max())
    west, east, south, north = (
        max(0, math.ceil((side - rounding) / lattice.cell_size - CELL_SLACK))
        for side in (x0 - west, east - x1, y0 - south, north - y1)
    )

    def extend(reach: int) -> Lattice:
        left, above = min(west, reach), min(north, reach)
        return lattice._replace(
            x_min=lattice.x_min - left * lattice.cell_size,
            y_max=lattice.y_max + above * lattice.cell_size,
            width=lattice.width + left + min(east, reach),
            height=lattice.height + above + min(south, reach),
        )

    def is_too_large(reach: int) -> bool:
        width, height = extend(reach)[3:]
        return width * height > max_cells

    reaches = range(1, max(west, east, south, north) + 1)
    reach = bisect_left(reaches, True, key=is_too_large)  # the farthest that is not too large
    row, col = min(north, reach), min(west, reach)
    return extend(reach), (slice(row, row + lattice.height), slice(col, col + lattice.width))


def clip_boxes(lattice: Lattice, boxes: Float, margin: float) -> Float:
    """Boxes, (n, 6) [m], that reach beyond the lattice by at most `margin` [m], at any height."""
    x_min, y_min, x_max, y_max = lattice.bounds
    low = np.array([x_min - margin, y_min - margin, -np.inf])
    high = np.array([x_max + margin, y_max + margin, np.inf])
    clipped: Float = boxes.clip(np.tile(low, 2), np.tile(high, 2))
    return clipped


def cells_near(lattice: Lattice, boxes: Float, reach: float) -> Int:
    """The cells within `reach` [m] and one cell of boxes, (n, 6) [m]; ascending."""
    # boxes may be endless
    near_boxes = clip_boxes(lattice, boxes, reach + 4 * lattice.cell_size)
    west, south = (near_boxes[:, :2] - reach).T
    east, north = (near_boxes[:, 3:5] + reach).T
    first_row, first_col = lattice.rows_cols(np.stack([west, north], axis=1))
    last_row, last_col = lattice.rows_cols(np.stack([east, south], axis=1))
    mask = np.zeros(lattice.shape, dtype=np.bool_)
    rows = np.stack([first_row - 1, last_row + 2]).clip(0, lattice.height).T.tolist()
    cols = np.stack([first_col - 1, last_col + 2]).clip(0, lattice.width).T.tolist()
    for (row, past_row), (col, past_col) in zip(rows, cols, strict=True):
        mask[row:past_row, col:past_col] = True
    first = min((row for row, _ in rows), default=0)
    last = max((past_row for _, past_row in rows), default=0)
    near: Int = np.flatnonzero(mask[first:last]) + first * lattice.width
    return near


def bounding_window(mask: Bool) -> Window:
    """The smallest window that holds all marked cells, one at least."""
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def cut_cells(cells: Int, window: Window, width: int) -> tuple[Int, Bool]:
    """Turn cells of a lattice of a width into cells of a window; also which of them are in it."""
    rows, cols = window
    row, col = np.divmod(cells, width)
    inside = (row >= rows.start) & (row < rows.stop) & (col >= cols.start) & (col < cols.stop)
    cut: Int = ((row - rows.start) * (cols.stop - cols.start) + col - cols.start)[inside]
    return cut, inside
