"""The lattice that a scene is baked on."""

import math

import numpy as np

from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError, SceneError
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int

Window = tuple[slice, slice]
"""Rows and columns of the whole lattice, with a start and a stop each."""

# Where the two cells of each edge are in an array: left and right, upper and lower
EDGES = ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:]))


def lay_lattice(scene: Scene, config: BakeConfig) -> Lattice:
    """Lay one lattice over the scene, or over the bounds of the settings.

    Raises:
        ConfigError: the scene is endless and no bounds are set, or there are too many cells.
        SceneError: the scene's box isn't finite.
    """
    settings = config.grid
    if settings.bounds is not None:
        bounds = tuple(settings.bounds)
    elif scene.bounds is not None:
        bounds = (*scene.bounds[0, :2].tolist(), *scene.bounds[1, :2].tolist())
    else:
        raise ConfigError(
            f"only infinite planes count in {config.scene.path}, so the grid has no end: "
            f"set `grid.bounds` to [x_min, y_min, x_max, y_max]"
        )
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
    return Lattice.cover(tuple(float(b) for b in bounds), settings.cell_size, settings.margin)


def bounding_window(mask: Bool) -> Window:
    """The smallest window that holds all marked cells, of which there is one at least."""
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def cut_cells(cells: Int, window: Window, width: int) -> tuple[Int, Bool]:
    """Turn cells of a lattice of a width into cells of a window; also which of them are in it."""
    rows, cols = window
    row, col = np.divmod(cells, width)
    inside = (row >= rows.start) & (row < rows.stop) & (col >= cols.start) & (col < cols.stop)
    cut: Int = ((row - rows.start) * (cols.stop - cols.start) + col - cols.start)[inside]
    return cut, inside
