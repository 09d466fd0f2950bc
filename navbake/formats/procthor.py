"""``ProcTHORMap`` of MolmoSpaces: a PNG of free cells and rooms, its matrices in text chunks.

Red and green are 255 in free cells (MolmoSpaces calls that ``occupancy``), blue is the room's
number, 0 for none. ``world_to_map`` (2 × 4) and ``map_to_world`` (3 × 3) are the matrices of its
formulas: ``round([x, y, z, 1] @ world_to_map.T)`` is row and column, and
``[row, col, 1] @ map_to_world.T`` the world position of that pixel's middle. So whole numbers are
the middles of cells, half a cell off from matrices for ``floor``.

Source: ``ProcTHORMap.save`` and ``load`` of ``molmo_spaces/utils/scene_maps.py``.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.files import readable_stem
from navbake.formats.convert import list_level_paths
from navbake.formats.occupancy import (
    level_from_rooms,
)
from navbake.formats.source import Files, encode_image, open_image
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST, LEAST_EDGE, Lattice
from navbake.types import Float, Json

MAX_ROOMS = 255  # numbers in a byte
ZERO_SHARE = 1e-6  # an entry below this share of a matrix's largest counts as 0


def encode_procthor(grid: NavGrid, path: Path, *, level: int | None = None) -> Files:
    """Encode the ``ProcTHORMap`` of each level; `path` ends in ``.png``.

    `level` is as of `encode_nav2`. Raises a FormatError for an unknown level, or one of more than
    255 rooms.
    """
    files: Files = {}
    for number, own_path in list_level_paths(grid, path, level, (".png",)).items():
        own = grid.levels[number]
        if own.room_index.max(initial=0) > MAX_ROOMS:
            got = f"level {number} has {own.room_index.max()}"
            raise FormatError(f"a ProcTHORMap numbers rooms up to {MAX_ROOMS}, {got}")
        free = np.where(own.free, np.uint8(255), np.uint8(0))
        pixels = np.stack([free, free, own.room_index.astype(np.uint8)], axis=-1)
        cell = own.lattice.cell_size
        x = own.lattice.x_min
        y = own.lattice.y_max
        density = 1.0 / cell
        rooms = [room for room in grid.rooms if room.level == number]
        texts: Json = {
            "world_to_map": [
                [0.0, -density, 0.0, y / cell - 0.5],
                [density, 0.0, 0.0, -x / cell - 0.5],
            ],
            "map_to_world": [
                [0.0, cell, x + cell / 2],
                [-cell, 0.0, y - cell / 2],
                [0.0, 0.0, own.ground],
            ],
            "px_per_m": round(density) if abs(density - round(density)) < 1e-9 else density,
            "room_ids_to_name": {str(room.index): room.name or room.id for room in rooms},
        }
        notes = {key: orjson.dumps(text).decode() for key, text in texts.items()}
        files[own_path] = encode_image(pixels, "PNG", **notes)
    return files


def read_procthor(path: str | PathLike[str]) -> SceneGrid2D:
    """Read a ``ProcTHORMap`` as a grid of one level.

    Rows and columns may run along either axis of the world, in either direction; they are turned
    to navbake's. All cells have a flat floor at the z of ``map_to_world``. Grey maps (``iTHORMap``)
    have no rooms. Raises a FormatError if the file is no such map, or not along the world's axes.
    """
    image = open_image(path, ("PNG",))
    to_map = _matrix(image.info, "world_to_map", (2, 4), path)
    to_world = _matrix(image.info, "map_to_world", (3, 3), path)
    if image.mode not in ("L", "1", "RGB"):
        raise FormatError(f"expected a map of 1 or 3 channels in {path}, got {image.mode}")
    red, _, blue = np.moveaxis(np.asarray(image.convert("RGB")), -1, 0)
    rooms = blue if image.mode == "RGB" else np.zeros_like(blue)
    layers, lattice = _straighten(np.stack([red, rooms]), to_map, path)
    free = layers[0] > 0
    rooms = layers[1].astype(np.uint16)
    z = float(to_world[2, 2])
    if not abs(z) <= FARTHEST:
        raise FormatError(f"expected a map within {FARTHEST:g} m of the origin, got {path}")
    stated = _parse_text(image.info.get("room_ids_to_name", "null"), "room_ids_to_name", path)
    if not isinstance(stated, dict | None):
        raise FormatError(f"expected names by number as `room_ids_to_name` in {path}")
    names = {
        int(key): name
        for key, name in (stated or {}).items()
        if key.isdecimal() and len(key) < 10 and isinstance(name, str)
    }
    return level_from_rooms(free, rooms, names, lattice, z, readable_stem(path))


def _straighten(
    layers: NDArray[np.uint8], to_map: Float, path: str | PathLike[str]
) -> tuple[NDArray[np.uint8], Lattice]:
    """Turn layers so that columns run along x and rows against y, and find their lattice."""
    scale = float(np.abs(to_map[:, :2]).max())
    linear = np.where(np.abs(to_map[:, :3]) <= ZERO_SHARE * scale, 0.0, to_map[:, :3])
    if linear[0, 0] != 0:  # rows run along x
        layers = layers.transpose(0, 2, 1)
        linear = linear[::-1]
        to_map = to_map[::-1]
    (row_x, row_y, row_z), (col_x, col_y, col_z) = linear
    is_straight = row_x == col_y == row_z == col_z == 0 and row_y != 0 and col_x != 0
    if not is_straight or abs(abs(row_y) - abs(col_x)) > ZERO_SHARE * scale:
        raise FormatError(f"`world_to_map` of {path} turns by no quarter, or stretches")
    _, height, width = layers.shape
    down, right = to_map[:, 3].tolist()
    if row_y > 0:
        layers = layers[:, ::-1]
        down = height - 1 - down
    if col_x < 0:
        layers = layers[:, :, ::-1]
        right = width - 1 - right
    cell = 1.0 / float(abs(col_x))
    lattice = Lattice(-(right + 0.5) * cell, (down + 0.5) * cell, cell, width, height)
    if not cell >= LEAST_EDGE or not all(abs(value) <= FARTHEST for value in lattice.bounds):
        raise FormatError(f"expected a map within {FARTHEST:g} m of the origin, got {path}")
    return np.ascontiguousarray(layers), lattice


def _matrix(texts: Json, key: str, shape: tuple[int, int], path: str | PathLike[str]) -> Float:
    try:
        matrix = np.array(_parse_text(texts.get(key), key, path))
    except ValueError:  # rows of several lengths
        matrix = np.empty(0)
    if matrix.shape != shape or matrix.dtype.kind not in "if":
        expected = f"a {shape[0]} × {shape[1]} matrix of numbers"
        raise FormatError(f"expected {expected} as `{key}` in {path}")
    return matrix.astype(np.float64)


def _parse_text(text: Any, key: str, path: str | PathLike[str]) -> Any:
    if not isinstance(text, str):
        raise FormatError(f"expected a ProcTHORMap, {path} has no text `{key}`")
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise FormatError(f"expected JSON as text `{key}` in {path}: {error}") from error
