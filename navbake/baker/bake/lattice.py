"""Fits the lattice of cells on which a scene is baked."""

import math
from bisect import bisect_left

import numpy as np

from navbake.baker.core.windows import Window
from navbake.baker.scene.scene import Scene, describe_unit
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError, SceneError
from navbake.navgrid.lattice import CELL_SLACK, Lattice
from navbake.types import Float

# Sums and products of lengths are rounded: the extents of a box may be too large by this fraction
# of its size
SIZE_ROUNDING = 1e-6
# Vertices of a mesh file may be stored in float32: its extents may also be too large by this
# fraction of the largest coordinate
FLOAT32_ROUNDING = 2.0**-22
# Extents are never reduced by more than this fraction of a cell, however far away a mesh lies
MAX_ROUNDED_FRACTION = 0.25
# A geom makes the scene's box large if the box without this geom has less than this fraction of its
# area, seen from above
MAX_REMAINING_FRACTION = 0.5
SAME_AREA_FRACTION = 0.01  # areas of boxes are equal if they differ by less than this fraction
# Floors are found on the scene up to this far around `grid.bounds`, or up to the longer side of the
# bounds, if that is more [m]
MAX_EXTENSION = 50.0


def fit_lattice(scene: Scene, config: BakeConfig) -> Lattice:
    """Fit a lattice to the scene, or to the bounds of the settings.

    The extents of the scene's box are reduced by `box_rounding` before its cells are counted, so
    that rounding (of a mesh in inches, say) does not add a row or column of cells.

    Args:
        scene: the posed scene.
        config: all settings; `grid` has the cell size, the bounds and the limit of cells.

    Returns:
        The lattice that is baked.

    Raises:
        ConfigError: the lattice would have too many cells, or the scene is
            endless.
        SceneError: the scene's box is not finite.
    """
    settings = config.grid
    # Where structure is endless, movables give the box.
    scene_box = scene.shapes.bounds if scene.bounds is None else scene.bounds
    if settings.bounds is not None:
        bounds = tuple(settings.bounds)
    elif scene_box is not None:
        bounds = (*scene_box[0, :2].tolist(), *scene_box[1, :2].tolist())
    else:
        no_end_text = f"only infinite planes count in {config.scene.path}, so the grid has no end"
        raise ConfigError(f"{no_end_text}: set `grid.bounds` to [x_min, y_min, x_max, y_max]")
    if not np.isfinite(bounds).all():
        raise SceneError(f"the scene {config.scene.path} has geoms whose pose is not finite")
    width = bounds[2] - bounds[0]
    depth = bounds[3] - bounds[1]
    # A float, as an integer could be too large to convert.
    num_cells = math.prod(
        max(1.0, (side + 2 * settings.margin) / settings.cell_size) for side in (width, depth)
    )
    if num_cells > settings.max_cells:
        raise ConfigError(
            f"a grid of {num_cells:.3g} cells is more than `grid.max_cells` = "
            f"{settings.max_cells}: {width:.6g} x {depth:.6g} m at `grid.cell_size` = "
            f"{settings.cell_size:g} m; {_name_farthest_geom(scene, config)}"
            f"{describe_unit(scene, config.scene)}; check the cell size, bake a part "
            f"(`grid.bounds`), leave geoms out (`scene.exclude`), or raise the limit"
        )
    rounding = 0.0
    if settings.bounds is None:
        rounding = box_rounding(scene, np.array(bounds), settings.cell_size)
    bounds = tuple(float(side) for side in bounds)
    return Lattice.cover(bounds, settings.cell_size, settings.margin, rounding)


def box_rounding(scene: Scene, bounds: Float, cell_size: float) -> float:
    """Return by how much rounding may have enlarged the extents of a scene's box [m].

    Args:
        scene: the posed scene.
        bounds: the box: x_min, y_min, x_max, y_max, shape (4,) [m].
        cell_size: edge of a cell [m].
    """
    rounding = SIZE_ROUNDING * float((bounds[2:] - bounds[:2]).max())
    if scene.exact_meshes:
        rounding += FLOAT32_ROUNDING * float(np.abs(bounds).max())
    return min(rounding, MAX_ROUNDED_FRACTION * cell_size)


def _name_farthest_geom(scene: Scene, config: BakeConfig) -> str:
    """Name the geom without which the scene's box is smallest, as the beginning of a sentence.

    Where the box is about as large without any single geom, it is the geom with the largest box,
    seen from above. The text is empty if the settings state the box, or no geom has a finite one.
    """
    shapes = scene.shapes if scene.bounds is None else scene.structure
    is_finite_box = np.isfinite(shapes.boxes).all(axis=1)
    geom_ids, geom_of_box = np.unique(shapes.geom_of_box[is_finite_box], return_inverse=True)
    if config.grid.bounds is not None or not len(geom_ids):
        return ""
    boxes = shapes.boxes[is_finite_box]
    lower_corners = np.full((len(geom_ids), 2), np.inf)
    upper_corners = np.full((len(geom_ids), 2), -np.inf)
    np.minimum.at(lower_corners, geom_of_box, boxes[:, :2])
    np.maximum.at(upper_corners, geom_of_box, boxes[:, 3:5])
    sides = upper_corners - lower_corners
    area = sides.prod(axis=1)
    largest_geom = int(area.argmax())
    name = scene.geoms[int(geom_ids[largest_geom])].name
    width, depth = sides[largest_geom].tolist()
    largest_geom_text = f"the largest geom is {name!r}, {width:.6g} x {depth:.6g} m; "
    if len(geom_ids) == 1:
        return largest_geom_text
    # the box without a geom ends at the second lowest or highest side where that geom has the first
    two_lowest_sides = np.sort(lower_corners, axis=0)[:2]
    two_highest_sides = np.sort(upper_corners, axis=0)[-2:]
    remaining_sides = np.where(
        upper_corners == two_highest_sides[1], two_highest_sides[0], two_highest_sides[1]
    )
    remaining_sides -= np.where(
        lower_corners == two_lowest_sides[0], two_lowest_sides[1], two_lowest_sides[0]
    )
    remaining_area = remaining_sides.prod(axis=1)
    is_enlarging_geom = (
        remaining_area
        <= MAX_REMAINING_FRACTION * (two_highest_sides[1] - two_lowest_sides[0]).prod()
    )
    if not is_enlarging_geom.any():
        return largest_geom_text
    # of a floor and a small thing far away, the box is small without either: the thing is the one
    total_area = remaining_area + area
    is_best_geom = is_enlarging_geom & (
        total_area <= (1 + SAME_AREA_FRACTION) * total_area[is_enlarging_geom].min()
    )
    farthest_geom = int(np.where(is_best_geom, area, np.inf).argmin())
    name = scene.geoms[int(geom_ids[farthest_geom])].name
    width, depth = remaining_sides[farthest_geom].tolist()
    return f"without {name!r} it is {width:.6g} x {depth:.6g} m; "


def extend_lattice(
    lattice: Lattice, bounds: Float | None, max_cells: int, rounding: float = 0.0
) -> tuple[Lattice, Window]:
    """Extend a lattice by whole cells until it covers the scene, or as far as limits allow.

    On each side it is extended by at most MAX_EXTENSION, or by the lattice's own longer side if
    that is more. Geoms farther away have no influence on the floors. If that would be too many
    cells, it is extended equally to all sides, as far as `max_cells` allows.

    Args:
        lattice: the lattice to extend.
        bounds: the scene's box, shape (2, 3) [m]; None for an endless scene, for which the lattice
            stays as it is.
        max_cells: the most cells that the extended lattice may have.
        rounding: by how much rounding may have enlarged the box's extents, see `box_rounding` [m].

    Returns:
        The extended lattice, and the window of it that is `lattice`.
    """
    if bounds is None:
        return lattice, (slice(0, lattice.height), slice(0, lattice.width))
    x_min, y_min, x_max, y_max = lattice.bounds
    scene_x_min, scene_y_min = bounds[0, :2].tolist()
    scene_x_max, scene_y_max = bounds[1, :2].tolist()

    def count_cells(length: float) -> int:
        return max(0, math.ceil((length - rounding) / lattice.cell_size - CELL_SLACK))

    num_cols_west = count_cells(x_min - scene_x_min)
    num_cols_east = count_cells(scene_x_max - x_max)
    num_rows_south = count_cells(y_min - scene_y_min)
    num_rows_north = count_cells(scene_y_max - y_max)

    def extend(max_extension: int) -> Lattice:
        num_cols_added_west = min(num_cols_west, max_extension)
        num_rows_added_north = min(num_rows_north, max_extension)
        return lattice._replace(
            x_min=lattice.x_min - num_cols_added_west * lattice.cell_size,
            y_max=lattice.y_max + num_rows_added_north * lattice.cell_size,
            width=lattice.width + num_cols_added_west + min(num_cols_east, max_extension),
            height=lattice.height + num_rows_added_north + min(num_rows_south, max_extension),
        )

    def is_too_large(max_extension: int) -> bool:
        extended_lattice = extend(max_extension)
        return extended_lattice.width * extended_lattice.height > max_cells

    # The number of cells grows with the extension: bisect for the largest that is allowed.
    extension_limit = max(
        math.ceil(MAX_EXTENSION / lattice.cell_size), lattice.width, lattice.height
    )
    extensions = range(
        1,
        min(extension_limit, max(num_cols_west, num_cols_east, num_rows_south, num_rows_north)) + 1,
    )
    max_extension = bisect_left(extensions, True, key=is_too_large)
    first_row = min(num_rows_north, max_extension)
    first_col = min(num_cols_west, max_extension)
    window = (
        slice(first_row, first_row + lattice.height),
        slice(first_col, first_col + lattice.width),
    )
    return extend(max_extension), window
