"""``ProcTHORMap`` of MolmoSpaces: a PNG of free cells and rooms, its matrices in text chunks.

Red and green are 255 in free cells (MolmoSpaces calls that ``occupancy``), blue is the room's
number, 0 for none. The text chunks hold the matrices ``world_to_map`` (2 × 4) and ``map_to_world``
(3 × 3): ``round([x, y, z, 1] @ world_to_map.T)`` is the row and column of a position, and
``[row, col, 1] @ map_to_world.T`` the world position of a pixel's middle. So whole numbers stand
for the centres of cells. In matrices that are used with ``floor``, they stand for corners of cells.

Source: ``ProcTHORMap.save`` and ``load`` of ``molmo_spaces/utils/scene_maps.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.files import readable_stem
from navbake.formats.level_paths import list_level_paths
from navbake.formats.occupancy import level_from_rooms
from navbake.formats.source import Files, encode_image, open_image
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import LEAST_EDGE, MAX_COORDINATE, Lattice
from navbake.types import Float, Json, JsonValue

MAX_ROOMS = 255  # largest number in a byte
ZERO_SHARE = 1e-6  # an entry up to this share of a matrix's largest entry counts as 0
INTEGER_TOLERANCE = 1e-9  # by how much a whole number of pixels per metre may be off


def encode_procthor(grid: NavGrid, path: Path, *, level: int | None = None) -> Files:
    """Encode the ``ProcTHORMap`` of each level.

    Args:
        grid: the grid.
        path: the file, which ends in ``.png``; several levels have numbers after the stem.
        level: the number of the only level to write, None for all.

    Returns:
        The content of each file by its path.

    Raises:
        FormatError: there is no such level, or one has more than 255 rooms.
    """
    files: Files = {}
    for level_number, level_path in list_level_paths(grid, path, level, (".png",)).items():
        grid_level = grid.levels[level_number]
        num_rooms = grid_level.room_index.max(initial=0)
        if num_rooms > MAX_ROOMS:
            actual_text = f"level {level_number} has {num_rooms}"
            raise FormatError(f"a ProcTHORMap numbers rooms up to {MAX_ROOMS}, {actual_text}")
        free_channel = np.where(grid_level.free, np.uint8(255), np.uint8(0))
        pixels = np.stack(
            [free_channel, free_channel, grid_level.room_index.astype(np.uint8)], axis=-1
        )
        cell_size = grid_level.lattice.cell_size
        x_min = grid_level.lattice.x_min
        y_max = grid_level.lattice.y_max
        pixels_per_metre = 1.0 / cell_size
        is_whole = abs(pixels_per_metre - round(pixels_per_metre)) < INTEGER_TOLERANCE
        rooms = [room for room in grid.rooms if room.level == level_number]
        value_of_keyword: Json = {
            "world_to_map": [
                [0.0, -pixels_per_metre, 0.0, y_max / cell_size - 0.5],
                [pixels_per_metre, 0.0, 0.0, -x_min / cell_size - 0.5],
            ],
            "map_to_world": [
                [0.0, cell_size, x_min + cell_size / 2],
                [-cell_size, 0.0, y_max - cell_size / 2],
                [0.0, 0.0, grid_level.ground],
            ],
            "px_per_m": round(pixels_per_metre) if is_whole else pixels_per_metre,
            "room_ids_to_name": {str(room.index): room.name or room.id for room in rooms},
        }
        text_of_keyword = {
            key: orjson.dumps(text).decode() for key, text in value_of_keyword.items()
        }
        files[level_path] = encode_image(pixels, "PNG", **text_of_keyword)
    return files


def read_procthor(path: str | PathLike[str]) -> SceneGrid2D:
    """Read a ``ProcTHORMap`` as a grid of one level.

    Rows and columns may run along either axis of the world, in either direction: the map is turned
    or flipped so that columns run along x, and rows against y. All cells have a flat floor at the z
    of ``map_to_world``. Grey maps (``iTHORMap``) have no rooms.

    Args:
        path: the file.

    Returns:
        The level, with the rooms that the map names.

    Raises:
        FormatError: the file is no such map, or its axes are not parallel to the world's.

    Example:
        >>> grid = navbake.from_procthor("train_0.png")
    """
    image = open_image(path, ("PNG",))
    world_to_map = _read_matrix(image.info, "world_to_map", (2, 4), path)
    map_to_world = _read_matrix(image.info, "map_to_world", (3, 3), path)
    if image.mode not in ("L", "1", "RGB"):
        message = f"expected a map of 1 or 3 channels in {path}, got {image.mode}"
        raise FormatError(
            message, path=str(path), value=image.mode, expected="a map of 1 or 3 channels"
        )
    red, _, blue = np.moveaxis(np.asarray(image.convert("RGB")), -1, 0)
    room_channel = blue if image.mode == "RGB" else np.zeros_like(blue)
    layers, lattice = _straighten(np.stack([red, room_channel]), world_to_map, path)
    is_free = layers[0] > 0
    room_index = layers[1].astype(np.uint16)
    ground = float(map_to_world[2, 2])
    if not abs(ground) <= MAX_COORDINATE:
        raise _make_range_error(path)
    names_by_number = _parse_text(
        image.info.get("room_ids_to_name", "null"), "room_ids_to_name", path
    )
    if not isinstance(names_by_number, dict | None):
        expected = "names by number"
        raise FormatError(
            f"expected {expected} as `room_ids_to_name` in {path}",
            path=str(path),
            key="room_ids_to_name",
            value=names_by_number,
            expected=expected,
        )
    room_names = {
        int(key): name
        for key, name in (names_by_number or {}).items()
        if key.isdecimal() and len(key) < 10 and isinstance(name, str)
    }
    return level_from_rooms(is_free, room_index, room_names, lattice, ground, readable_stem(path))


def _straighten(
    layers: NDArray[np.uint8], world_to_map: Float, path: str | PathLike[str]
) -> tuple[NDArray[np.uint8], Lattice]:
    """Turn layers so that columns run along x and rows against y, and find their lattice.

    Args:
        layers: layers of a map, shape (n, height, width).
        world_to_map: the map's matrix, shape (2, 4).
        path: the file, for errors.

    Returns:
        The turned layers, and the lattice of their cells.

    Raises:
        FormatError: the map's axes are not parallel to the world's, its cells are no squares, or it
            is out of range.
    """
    largest_entry = float(np.abs(world_to_map[:, :2]).max())
    direction_entries = np.where(
        np.abs(world_to_map[:, :3]) <= ZERO_SHARE * largest_entry, 0.0, world_to_map[:, :3]
    )
    if direction_entries[0, 0] != 0:  # rows run along x
        layers = layers.transpose(0, 2, 1)
        direction_entries = direction_entries[::-1]
        world_to_map = world_to_map[::-1]
    (row_x, row_y, row_z), (col_x, col_y, col_z) = direction_entries
    is_straight = row_x == col_y == row_z == col_z == 0 and row_y != 0 and col_x != 0
    if not is_straight or abs(abs(row_y) - abs(col_x)) > ZERO_SHARE * largest_entry:
        message = f"`world_to_map` of {path} turns by no quarter, or stretches"
        raise FormatError(message, path=str(path), key="world_to_map")

    _, height, width = layers.shape
    # the world's origin in the map
    origin_row, origin_col = world_to_map[:, 3].tolist()
    if row_y > 0:
        layers = layers[:, ::-1]
        origin_row = height - 1 - origin_row
    if col_x < 0:
        layers = layers[:, :, ::-1]
        origin_col = width - 1 - origin_col
    cell_size = 1.0 / float(abs(col_x))
    x_min = -(origin_col + 0.5) * cell_size
    y_max = (origin_row + 0.5) * cell_size
    lattice = Lattice(x_min, y_max, cell_size, width, height)
    if not cell_size >= LEAST_EDGE or not all(
        abs(bound) <= MAX_COORDINATE for bound in lattice.bounds
    ):
        raise _make_range_error(path)
    return np.ascontiguousarray(layers), lattice


def _make_range_error(path: str | PathLike[str]) -> FormatError:
    expected = f"a map within {MAX_COORDINATE:g} m of the origin"
    return FormatError(f"expected {expected}, got {path}", path=str(path), expected=expected)


def _read_matrix(
    image_texts: Mapping[Any, Any], key: str, shape: tuple[int, int], path: str | PathLike[str]
) -> Float:
    """Read the matrix that the text `key` of an image states."""
    try:
        matrix = np.array(_parse_text(image_texts.get(key), key, path))
    except ValueError:  # rows of several lengths
        matrix = np.empty(0)
    if matrix.shape != shape or matrix.dtype.kind not in "if":
        expected = f"a {shape[0]} × {shape[1]} matrix of numbers"
        raise FormatError(
            f"expected {expected} as `{key}` in {path}", path=str(path), key=key, expected=expected
        )
    return matrix.astype(np.float64)


def _parse_text(text: object, key: str, path: str | PathLike[str]) -> JsonValue:
    """Parse the JSON in the text `key` of an image."""
    if not isinstance(text, str):
        message = f"expected a ProcTHORMap, {path} has no text `{key}`"
        raise FormatError(message, path=str(path), key=key, expected="a ProcTHORMap")
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError as error:
        message = f"expected JSON as text `{key}` in {path}: {error}"
        raise FormatError(message, path=str(path), key=key, expected="JSON") from error
