"""Converts voxels to a floor plan over a range of heights, and a level to voxels."""

import math

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.lattice import CELL_SLACK, Lattice
from navbake.voxels.grid import VoxelGrid, check_memory


def lattice_of(voxels: VoxelGrid) -> Lattice:
    """Return the lattice of a voxel grid's vertical columns, seen from above."""
    nx, ny, _ = voxels.shape
    x, y, _ = voxels.origin
    return Lattice(x, y + ny * voxels.res, voxels.res, nx, ny)


def cut_band(
    voxels: VoxelGrid,
    low: float,
    high: float,
    floor: NDArray[np.floating] | None = None,
    *,
    whole: bool = False,
) -> NDArray[np.uint8]:
    """Mark the vertical columns of voxels that are occupied in a range of heights.

    Args:
        voxels: Voxels of any dtype; those that are not 0 are occupied.
        low: Lower end of the range [m]: world z, or the height over the floor if `floor` is given.
        high: Upper end of the range [m], > low.
        floor: World z of each cell's floor [m], shape (ny, nx); where it is NaN, there is no floor,
            and the column is occupied.
        whole: Whether only voxels count that lie in the range as a whole; else all that overlap it
            count.

    Returns:
        1 for occupied columns, else 0, uint8, shape (ny, nx): ``[row, col]`` as in navigation
        grids, with rows towards smaller y. The cells are those of `lattice_of`.

    Raises:
        QueryError: The range is empty, or the floor has another shape.
    """
    nx, ny, nz = voxels.shape
    if not low < high:
        expected = "a band of heights, low < high"
        raise QueryError(
            f"expected {expected}, got {low:g} and {high:g}", value=(low, high), expected=expected
        )
    if floor is not None and floor.shape != (ny, nx):
        expected = f"a floor of shape (ny, nx) = {(ny, nx)}"
        raise QueryError(
            f"expected {expected}, got {floor.shape}",
            key="floor",
            value=floor.shape,
            expected=expected,
        )
    base_z = np.zeros((ny, nx)) if floor is None else np.asarray(floor, dtype=np.float64)
    start_heights = (base_z + low - voxels.origin[2]) / voxels.res
    end_heights = (base_z + high - voxels.origin[2]) / voxels.res
    if whole:
        first_layers = np.ceil(start_heights - CELL_SLACK)
        end_layers = np.floor(end_heights + CELL_SLACK)
    else:
        first_layers = np.floor(start_heights + CELL_SLACK)
        end_layers = np.ceil(end_heights - CELL_SLACK)
    first_layers = np.nan_to_num(first_layers).clip(0, nz)
    end_layers = np.nan_to_num(end_layers).clip(0, nz)
    is_occupied = np.isnan(base_z)
    is_filled = voxels.occupied.transpose(1, 0, 2)[::-1]  # [x, y, z] as [row, col, z]
    # layer by layer, without a mask of all voxels
    for layer in range(int(first_layers.min()), int(end_layers.max())):
        is_occupied |= is_filled[:, :, layer] & (first_layers <= layer) & (layer < end_layers)
    return is_occupied.astype(np.uint8)


def plan_of(
    voxels: VoxelGrid, floor: float, *, step: float = 0.25, height: float = 1.14
) -> SceneGrid2D:
    """Make the floor plan of voxels: a navigation grid over a flat, horizontal floor.

    A cell is blocked if a voxel overlaps the heights from `step` to `height` over the floor. Holes
    in the floor are not detected, because voxels don't show where there is a floor.

    Args:
        voxels: The voxels of the obstacles.
        floor: World z of the floor [m].
        step: Highest step of the agent [m].
        height: Height of the agent [m], > step.

    Returns:
        The level, with a floor in every cell.

    Raises:
        QueryError: The height is not above the step.
    """
    occupancy = cut_band(voxels, floor + step, floor + height)
    lattice = lattice_of(voxels)
    x_low, y_low, x_high, y_high = lattice.bounds
    stored_floor = float(np.float32(floor))
    bottom = min(float(voxels.bounds[0, 2]), stored_floor)
    top = max(float(voxels.bounds[1, 2]), stored_floor)
    return SceneGrid2D(
        width=lattice.width,
        height=lattice.height,
        cell_size=voxels.res,
        min_yup=(x_low, floor, 0.0 - y_high),
        bbox_yup=((x_low, bottom, 0.0 - y_high), (x_high, top, 0.0 - y_low)),
        weights=np.where(occupancy == 0, np.float32(1), np.float32(np.inf)),
        attributes={
            "floorHeight": np.full(lattice.shape, floor, dtype=np.float32),
            "occupancy": occupancy,
        },
    )


def voxels_of(level: SceneGrid2D, *, step: float = 0.25, height: float = 1.14) -> VoxelGrid:
    """Make voxels of a level's occupied cells, from `step` to `height` over their floors.

    Occupied cells without a floor are filled from `step` to `height` over the level's ground. A
    voxel is filled if it overlaps this range of heights by more than float32 rounding.

    The edge of a voxel is that of a cell. The lowest layer of voxels begins `step` above the
    level's ground; where floors are lower than the ground, there are further layers below it. Rooms
    and weights are left out.

    Args:
        level: A level with ``occupancy`` and ``floorHeight``.
        step: Highest step of the agent, as in the level's settings [m].
        height: Height of the agent, as in the level's settings [m], > step.

    Returns:
        The voxels, of dtype bool.

    Raises:
        QueryError: The height is not above the step.
        ConfigError: The voxels need more memory than there is.
    """
    if not step < height:
        expected = "a band of heights, step < height"
        raise QueryError(
            f"expected {expected}, got {step:g} and {height:g}",
            value=(step, height),
            expected=expected,
        )
    lattice = level.lattice
    res = level.lattice.cell_size
    stored_floor = np.where(np.isnan(level.floor_height), np.float32(0), level.floor_height)
    has_floor = ~np.isnan(level.floor_height)
    floor = np.where(has_floor, stored_floor.astype(np.float64) * level.unit, level.ground)
    slack_layers = (
        CELL_SLACK + np.spacing(np.abs(stored_floor)).astype(np.float64) * level.unit / res
    )
    # whole voxels from `step` over the ground down to `step` over the lowest floor
    num_lower_voxels = max(math.ceil(((level.ground - floor) / res - slack_layers).max()), 0)
    bottom = level.ground + step - num_lower_voxels * res
    start_layer = np.floor((floor + step - bottom) / res + slack_layers)
    end_layer = np.ceil((floor + height - bottom) / res - slack_layers)
    shape = (lattice.width, lattice.height, max(int(end_layer.max()), 1))
    check_memory(shape, 1)
    values = np.zeros(shape, dtype=np.bool_)
    value_columns = values.transpose(1, 0, 2)[::-1]
    is_filled_cell = level.occupancy != 0
    for layer in range(values.shape[2]):
        value_columns[:, :, layer] = is_filled_cell & (start_layer <= layer) & (layer < end_layer)
    x_low, y_low, _, _ = lattice.bounds
    return VoxelGrid(values=values, origin=(x_low, y_low, bottom), res=res)
