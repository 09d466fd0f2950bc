"""GRScenes' ``occupancy.npy``: the samples of a level between their own world coordinates.

The first row has the x of each column, the first column the y of each row [m], the corner nothing.
The other values are 0 for free, 1 for an obstacle, and -1 for undefined. In files of GRScenes, y
falls from row to row, and the steps of x and y differ by a little.

Source: the answer of GRScenes' authors in InternUtopia's issue 83.
"""

from __future__ import annotations

import io
from os import PathLike
from pathlib import Path

import numpy as np

from navbake.files import readable_stem
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.convert import list_level_paths
from navbake.formats.npz import read_npy
from navbake.formats.occupancy import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    level_from_values,
)
from navbake.formats.source import Files, check_path
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST, LEAST_EDGE, Lattice
from navbake.types import Float

OBSTACLE = 1
MAX_UNEVENNESS = 0.01  # of a step, by which a coordinate may be off
MAX_DRIFT = 0.01  # of a cell, by which a map with steps of two lengths may be off at its end
BYTES_PER_CELL = 32  # of memory: values, weights, layers


def encode_grscenes(grid: NavGrid, path: Path, *, level: int | None = None) -> Files:
    """Encode an ``occupancy.npy`` of each level, float64; cells without a floor are undefined.

    `path` ends in ``.npy``; `level` is as of `encode_nav2`. Raises a FormatError for a wrong one.
    """
    files: Files = {}
    for number, own_path in list_level_paths(grid, path, level, (".npy",)).items():
        own = grid.levels[number]
        values = np.zeros((own.height + 1, own.width + 1))
        values[0, 1:] = own.lattice.center_x()
        values[1:, 0] = own.lattice.center_y()
        values[1:, 1:][~own.free] = OBSTACLE
        if "floorHeight" in own.attributes:
            values[1:, 1:][~own.free & np.isnan(own.floor_height)] = UNKNOWN
        file = io.BytesIO()
        np.save(file, values)
        files[own_path] = file.getvalue()
    return files


def read_grscenes(path: str | PathLike[str]) -> SceneGrid2D:
    """Read an ``occupancy.npy`` as a grid of one level, with a flat floor at z = 0.

    Where the steps of x and y differ, cells are squares of the smaller one, each with the value of
    the sample that its middle lies in. So each sample has a cell, and no wall gets a gap. Raises a
    FormatError if the file is no such map, or its coordinates are no even steps.
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
    if not np.isin(values, (UNKNOWN, FREE, OBSTACLE)).all():
        place.fail("expected 0 (free), 1 (obstacle) or -1 (undefined) as values, got others")
    steps = [_step_of(array[0, 1:], "x", place), _step_of(array[1:, 0], "y", place)]
    dx, dy = (step or other for step, other in zip(steps, steps[::-1], strict=True))
    if dx < 0:
        values = values[:, ::-1]
        dx = -dx
    if dy > 0:
        values = values[::-1]
    dy, height, width = abs(dy), *values.shape
    x = float(array[0, 1:].min()) - dx / 2
    top = float(array[1:, 0].max()) + dy / 2
    cell = dx
    shape = (height, width)
    if abs(dx - dy) * max(shape) > MAX_DRIFT * min(dx, dy):
        cell = min(dx, dy)
        shape = max(1, round(height * dy / cell)), max(1, round(width * dx / cell))
    allowance = Allowance(array.nbytes, "max_cells")
    allowance.take_cells(shape, place)
    allowance.take_array(shape, BYTES_PER_CELL, place)
    rows = np.minimum((np.arange(shape[0]) + 0.5) * cell / dy, height - 0.5).astype(np.int64)
    cols = np.minimum((np.arange(shape[1]) + 0.5) * cell / dx, width - 0.5).astype(np.int64)
    table = np.array([FREE, OCCUPIED, UNKNOWN], dtype=np.int8)
    picked = table[values[rows[:, None], cols].astype(np.int64)]
    lattice = Lattice(x, top, cell, shape[1], shape[0])
    return level_from_values(picked, lattice, 0.0, {"sceneId": readable_stem(path)})


def _step_of(coordinates: Float, axis: str, place: JsonPath) -> float:
    """The step between coordinates, negative if they fall; 0 for a single one."""
    if not (np.abs(coordinates) <= FARTHEST).all():  # NaN isn't, either
        place.fail(f"expected {axis} of samples within {FARTHEST:g} m of the origin, got others")
    if len(coordinates) == 1:
        return 0.0
    found = coordinates.astype(np.float64)
    step = float(found[-1] - found[0]) / (len(found) - 1)
    even = found[0] + step * np.arange(len(found))
    if abs(step) < LEAST_EDGE or np.abs(found - even).max() > MAX_UNEVENNESS * abs(step):
        place.fail(f"expected {axis} of samples in even steps, got others")
    return step
