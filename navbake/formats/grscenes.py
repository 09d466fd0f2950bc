"""GRScenes' ``occupancy.npy``: samples of a level, with their world coordinates.

The array's first row has world x of each column [m], its first column world y of each row [m]; the
entry that they share has no meaning. The other entries are 0 for free, 1 for an obstacle, and -1
for undefined. In files of GRScenes, y falls from row to row, and the steps of x and y differ a
little.

Source: the answer of GRScenes' authors in InternUtopia's issue 83.
"""

from __future__ import annotations

import io
from os import PathLike
from pathlib import Path

import numpy as np

from navbake.files import readable_stem
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.level_paths import list_level_paths
from navbake.formats.npz import read_npy
from navbake.formats.occupancy import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    level_from_values,
)
from navbake.formats.source import Files, check_path
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import LEAST_EDGE, MAX_COORDINATE, Lattice
from navbake.types import Float

OBSTACLE_VALUE = 1
MAX_UNEVENNESS = 0.01  # by how much a coordinate may be off its even place [steps]
# if steps of x and y differ but one cell size is used for both: by how much the last cell may be
# off its place [cells]
MAX_DRIFT = 0.01
BYTES_PER_CELL = 32  # of memory: values, weights, layers


def encode_grscenes(grid: NavGrid, path: Path, *, level: int | None = None) -> Files:
    """Encode an ``occupancy.npy`` of each level, float64; cells without a floor are undefined.

    Args:
        grid: the grid.
        path: the file, which ends in ``.npy``; several levels have numbers after the stem.
        level: the number of the only level to write, None for all.

    Returns:
        The content of each file by its path.

    Raises:
        FormatError: there is no such level, or the path has another ending.
    """
    files: Files = {}
    for level_number, level_path in list_level_paths(grid, path, level, (".npy",)).items():
        grid_level = grid.levels[level_number]
        values = np.zeros((grid_level.height + 1, grid_level.width + 1))
        values[0, 1:] = grid_level.lattice.center_x()
        values[1:, 0] = grid_level.lattice.center_y()
        values[1:, 1:][~grid_level.free] = OBSTACLE_VALUE
        if "floorHeight" in grid_level.attributes:
            values[1:, 1:][~grid_level.free & np.isnan(grid_level.floor_height)] = UNKNOWN
        file = io.BytesIO()
        np.save(file, values)
        files[level_path] = file.getvalue()
    return files


def read_grscenes(path: str | PathLike[str]) -> SceneGrid2D:
    """Read an ``occupancy.npy`` as a grid of one level, with a flat floor at z = 0.

    Cells are squares. If the steps of x and y differ, the cell size is the smaller step, and each
    cell gets the value of the sample nearest to its centre. So each sample has a cell, and no wall
    gets a gap.

    Args:
        path: the file.

    Returns:
        The level.

    Raises:
        FormatError: the file is no such map, or its coordinates are no even steps.

    Example:
        >>> grid = navbake.from_grscenes("occupancy.npy")
    """
    place = JsonPath(check_path(path))
    array = read_npy(path)
    if array.ndim != 2 or min(array.shape) < 2 or array.dtype.kind not in "iuf":
        place.fail(
            f"expected numbers with coordinates around them, got {array.dtype} of {array.shape}"
        )
    if max(array.shape) < 3:
        place.fail("expected two samples at least, to tell how far they are apart, got one")
    values = array[1:, 1:]
    if not np.isin(values, (UNKNOWN, FREE, OBSTACLE_VALUE)).all():
        place.fail("expected 0 (free), 1 (obstacle) or -1 (undefined) as values, got others")
    step_x = _find_step(array[0, 1:], "x", place)
    step_y = _find_step(array[1:, 0], "y", place)
    # a single column is as wide as a row is high, and the reverse
    step_along_x = step_x or step_y
    step_along_y = step_y or step_x
    if step_along_x < 0:
        values = values[:, ::-1]
    if step_along_y > 0:
        values = values[::-1]
    step_along_x = abs(step_along_x)
    step_along_y = abs(step_along_y)
    x_min = float(array[0, 1:].min()) - step_along_x / 2
    y_max = float(array[1:, 0].max()) + step_along_y / 2

    num_rows, num_cols = values.shape
    cell_size = step_along_x
    shape = (num_rows, num_cols)
    if abs(step_along_x - step_along_y) * max(shape) > MAX_DRIFT * min(step_along_x, step_along_y):
        cell_size = min(step_along_x, step_along_y)
        height = max(1, round(num_rows * step_along_y / cell_size))
        width = max(1, round(num_cols * step_along_x / cell_size))
        shape = (height, width)
    allowance = Allowance(array.nbytes, "max_cells")
    allowance.take_cells(shape, place)
    allowance.take_array(shape, BYTES_PER_CELL, place)
    # row and column of the sample that is nearest to each cell's centre
    rows = (np.arange(shape[0]) + 0.5) * cell_size / step_along_y
    rows = np.minimum(rows, num_rows - 0.5).astype(np.int64)
    cols = (np.arange(shape[1]) + 0.5) * cell_size / step_along_x
    cols = np.minimum(cols, num_cols - 0.5).astype(np.int64)
    samples = values[rows[:, None], cols].astype(np.int64)
    value_of_sample = np.array([FREE, OCCUPIED, UNKNOWN], dtype=np.int8)  # for 0, 1 and -1
    lattice = Lattice(x_min, y_max, cell_size, shape[1], shape[0])
    return level_from_values(
        value_of_sample[samples], lattice, 0.0, {"sceneId": readable_stem(path)}
    )


def _find_step(coordinates: Float, axis: str, place: JsonPath) -> float:
    """Return the step between coordinates [m], negative if they fall; 0 for a single coordinate."""
    with np.errstate(over="ignore"):  # long doubles may be beyond all others
        positions = coordinates.astype(np.float64)
    if not (np.abs(positions) <= MAX_COORDINATE).all():  # NaN isn't, either
        place.fail(
            f"expected {axis} of samples within {MAX_COORDINATE:g} m of the origin, got others"
        )
    if len(positions) == 1:
        return 0.0
    step = float(positions[-1] - positions[0]) / (len(positions) - 1)
    even_positions = positions[0] + step * np.arange(len(positions))
    unevenness = np.abs(positions - even_positions).max()
    if abs(step) < LEAST_EDGE or unevenness > MAX_UNEVENNESS * abs(step):
        place.fail(f"expected {axis} of samples in even steps, got others")
    return step
