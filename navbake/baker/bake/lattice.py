"""The lattice that a scene is baked on."""

import math
from bisect import bisect_left

import numpy as np

from navbake.baker.core.windows import Window
from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError, SceneError
from navbake.navgrid.lattice import CELL_SLACK, Lattice
from navbake.types import Float

BOX_ROUNDING = 1e-6  # of a box's farthest coordinate; float32 has 6e-8, and is computed with


def fit_lattice(scene: Scene, config: BakeConfig) -> Lattice:
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


def extend_lattice(
    lattice: Lattice, bounds: Float | None, max_cells: int
) -> tuple[Lattice, Window]:
    """Extend a lattice to the whole scene; returns it, and the given one as its window.

    It is extended by whole cells up to the scene's `bounds`, (2, 3) [m], but not if these are None,
    for an endless scene. With too many cells it is extended to all sides as far as possible.
    """
    if bounds is None:
        return lattice, (slice(0, lattice.height), slice(0, lattice.width))
    x0, y0, x1, y1 = lattice.bounds
    (west, south), (east, north) = bounds[:, :2].tolist()
    rounding = BOX_ROUNDING * float(np.abs(bounds[:, :2]).max())
    west = max(0, math.ceil((x0 - west - rounding) / lattice.cell_size - CELL_SLACK))
    east = max(0, math.ceil((east - x1 - rounding) / lattice.cell_size - CELL_SLACK))
    south = max(0, math.ceil((y0 - south - rounding) / lattice.cell_size - CELL_SLACK))
    north = max(0, math.ceil((north - y1 - rounding) / lattice.cell_size - CELL_SLACK))

    def extend(reach: int) -> Lattice:
        left = min(west, reach)
        above = min(north, reach)
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
    row = min(north, reach)
    col = min(west, reach)
    return extend(reach), (slice(row, row + lattice.height), slice(col, col + lattice.width))
