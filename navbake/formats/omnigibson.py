"""Maps of OmniGibson and iGibson: square grey PNGs of 0.01 m a pixel.

The world's origin is in the middle of the image. Columns run along x, rows along y; the first row
has the lowest y. ``floor_trav_0.png`` is 255 where a robot's centre may be on floor 0. Of each
pixel, ``floor_insseg_0.png`` has the number of the room, and ``floor_semseg_0.png`` the number of
the room's category: its line in ``room_categories.txt``, from 1. Both are 0 outside of rooms.
OmniGibson has room maps of floor 0 only. Beside a map of another name, such as ``house_0.png``,
they bear that name: ``house_insseg_0.png``. In files that navbake writes, a text chunk of the PNG
also states the grid's cells, which navbake reads back.

Sources: ``map_base.py``, ``traversable_map.py`` and ``segmentation_map.py`` of OmniGibson.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.files import readable_stem
from navbake.formats.allowance import MAX_PIXELS
from navbake.formats.level_paths import select_levels
from navbake.formats.occupancy import level_from_rooms
from navbake.formats.source import Files, encode_image, open_image, read_bytes
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import MAX_COORDINATE, Lattice
from navbake.types import Json

MAX_ROOMS = 255  # largest number in a byte
PIXEL_SIZE = 0.01  # edge of a pixel [m]
# a pixel counts as smaller by this on each side, because cells' edges are rounded [m]
PIXEL_MARGIN = 1e-7
OMNIGIBSON_HEAD = "floor_"  # of the names of OmniGibson's own maps
MAP_WORD = re.compile(r"(.*_|)trav(_.*|)")  # what stands before and after it in a map's name
DEFAULT_CATEGORY = "room"
NO_OBJECTS = "no_obj"  # part of the name of a map without furniture
# matches the reversed end of a room's name; from the front, its cost would grow as the square
REVERSED_NUMBER = re.compile(r"\d*[\s_-]*")


class RoomFiles(NamedTuple):
    """Paths of the files that describe the rooms of level 0, beside the map of that level."""

    room_image: Path  #: Image with the number of each pixel's room.
    category_image: Path  #: Image with the number of each pixel's category.
    category_list: Path  #: Text with the name of a category in each line.


def name_room_files(folder: Path, stem: str) -> RoomFiles:
    """Return the paths of the files that describe the rooms of a map; they are named after it.

    In OmniGibson's dataset, the maps of a scene with and without objects or doors share these
    files: ``floor_trav`` and ``floor_trav_no_obj`` both have ``floor_insseg_0.png``.

    Args:
        folder: the folder of the map.
        stem: the map's name without the number of the level and the ending.
    """
    name_match = MAP_WORD.fullmatch(stem)
    name_head = name_match[1] if name_match else f"{stem}_"
    list_head = "" if name_head == OMNIGIBSON_HEAD else name_head
    return RoomFiles(
        folder / f"{name_head}insseg_0.png",
        folder / f"{name_head}semseg_0.png",
        folder / f"{list_head}room_categories.txt",
    )


def encode_omnigibson(
    grid: NavGrid, path: Path, *, level: int | None = None, categories: Path | None = None
) -> Files:
    """Encode a map for each level, and the room maps of level 0 beside it.

    A pixel is free if all cells that it overlaps are free. A room's category is its name in lower
    case, with ``_`` for spaces and without a number at the end, or ``room``.

    Args:
        grid: the grid.
        path: the file, which ends in ``.png``; the level's number is added: ``floor_trav_0.png``.
            Room maps are not written if the name contains ``no_obj``, which marks a map without
            furniture. Otherwise they are written for a level without rooms, too, so that those of
            an earlier grid don't stay.
        level: the number of the only level to write, None for all.
        categories: the ``room_categories.txt`` of OmniGibson's dataset, which has to have all
            rooms' categories. If None, a list of these rooms' categories is written.

    Returns:
        The content of each file by its path.

    Raises:
        FormatError: there is no such level, an image is too large, cells are smaller than a pixel,
            there are more than 255 rooms, or a category isn't in the list.
    """
    files: Files = {}
    for level_number in select_levels(grid, path, level, (".png",)):
        grid_level = grid.levels[level_number]
        lattice = grid_level.lattice
        if lattice.cell_size < PIXEL_SIZE - PIXEL_MARGIN:
            expected = f"cells of {PIXEL_SIZE} m at least"
            actual_text = f"{lattice.cell_size:g} m"
            raise FormatError(
                f"expected {expected}, got {actual_text}",
                value=lattice.cell_size,
                expected=expected,
            )
        # half of the image's edge [pixels]; room maps need a 0, so there is a margin
        half_size = math.ceil(max(map(abs, lattice.bounds)) / PIXEL_SIZE) + 1
        if (2 * half_size) ** 2 > MAX_PIXELS:
            extent = half_size * PIXEL_SIZE
            max_extent = math.isqrt(MAX_PIXELS) // 2 * PIXEL_SIZE
            fault = f"OmniGibson's maps are centred on the origin, and level {level_number} ends"
            expected = f"{max_extent:.1f} m at most"
            raise FormatError(
                f"{fault} {extent:.1f} m from it, expected {expected}",
                value=extent,
                expected=expected,
            )
        lattice_text = orjson.dumps({**lattice._asdict(), "ground": grid_level.ground}).decode()
        is_free = np.ones((2 * half_size, 2 * half_size), dtype=bool)
        # a pixel overlaps two cells at most along each axis: those at its corners
        half_pixel = PIXEL_SIZE / 2 - PIXEL_MARGIN
        for x_offset, y_offset in itertools.product((-half_pixel, half_pixel), repeat=2):
            is_free &= _sample_pixels(grid_level.free, lattice, half_size, x_offset, y_offset)
        pixels = np.where(is_free, np.uint8(255), np.uint8(0))
        map_path = path.with_name(f"{path.stem}_{level_number}{path.suffix}")
        if level_number == 0 and NO_OBJECTS not in path.stem:
            room_files = name_room_files(path.parent, path.stem)
            files |= _encode_room_maps(grid, room_files, half_size, categories)
        # after the room maps, which are read with it
        files[map_path] = encode_image(pixels, "PNG", navbake=lattice_text)
    return files


def _sample_pixels(
    layer: NDArray[Any],
    lattice: Lattice,
    half_size: int,
    x_offset: float = 0.0,
    y_offset: float = 0.0,
) -> NDArray[Any]:
    """Return a layer's value at a point of each pixel; 0 outside of the lattice.

    Args:
        layer: the value of each cell, shape (height, width).
        lattice: the lattice of the cells.
        half_size: half of the image's edge [pixels].
        x_offset: how far the point is to the right of the pixel's middle [m].
        y_offset: how far the point is above the pixel's middle [m].
    """
    pixel_middles = (np.arange(2 * half_size) + (0.5 - half_size)) * PIXEL_SIZE
    rows, cols = lattice.rows_cols(
        np.stack([pixel_middles + x_offset, pixel_middles + y_offset], axis=-1)
    )
    # a border of zeros stands for everything outside
    height, width = layer.shape
    rows = np.clip(rows + 1, 0, height + 1)
    cols = np.clip(cols + 1, 0, width + 1)
    samples: NDArray[Any] = np.pad(layer, 1)[rows[:, None], cols]
    return samples


def _encode_room_maps(
    grid: NavGrid, room_files: RoomFiles, half_size: int, categories: Path | None
) -> Files:
    """Encode the room maps of level 0, and a list of categories if no file of them is given."""
    level = grid.levels[0]
    category_of_room = {
        room.index: _find_category(room.name or "") for room in grid.rooms if room.level == 0
    }
    num_rooms = int(level.room_index.max())
    if num_rooms > MAX_ROOMS:
        limit_text = f"a map of OmniGibson numbers rooms up to {MAX_ROOMS}"
        raise FormatError(f"{limit_text}, level 0 has {num_rooms}", value=num_rooms)
    files: Files = {}
    if categories is None:
        category_names = sorted({*category_of_room.values(), DEFAULT_CATEGORY})
        files[room_files.category_list] = "".join(f"{name}\n" for name in category_names).encode()
    else:
        category_names = _read_lines(categories)
        for index, category in category_of_room.items():
            if category not in category_names:
                fault = (
                    f"room {index} of level 0 is a {category!r}, which {categories} doesn't have"
                )
                remedy = "name rooms as its lines do, see `rooms` in the settings"
                raise FormatError(
                    f"{fault}: {remedy}", path=str(categories), value=category, hint=remedy
                )
    # index of a room -> number of its category: its line in the list, from 1
    category_numbers = np.zeros(num_rooms + 1, dtype=np.int64)
    if DEFAULT_CATEGORY in category_names:
        category_numbers[1:] = category_names.index(DEFAULT_CATEGORY) + 1
    for index, category in category_of_room.items():
        category_numbers[index] = category_names.index(category) + 1
    if category_numbers.max() > MAX_ROOMS:
        limit_text = f"a map of OmniGibson numbers categories up to {MAX_ROOMS}"
        raise FormatError(
            f"{limit_text}, the last of level 0 has the number {category_numbers.max()}"
        )
    room_pixels = _sample_pixels(level.room_index, level.lattice, half_size)
    files[room_files.room_image] = encode_image(room_pixels.astype(np.uint8), "PNG")
    category_pixels = category_numbers[room_pixels].astype(np.uint8)
    files[room_files.category_image] = encode_image(category_pixels, "PNG")
    return files


def _find_category(room_name: str) -> str:
    """Return the category of a room by its name: ``Living room 2`` is a ``living_room``."""
    name = room_name.lower()
    number_match = REVERSED_NUMBER.match(name[::-1])
    name = name[: len(name) - (number_match.end() if number_match else 0)]
    return name.replace(" ", "_") or DEFAULT_CATEGORY


def read_omnigibson(path: str | PathLike[str]) -> SceneGrid2D:
    """Read a traversability map as a grid of one level, with the rooms of room maps beside it.

    Cells are the pixels of 0.01 m; for a map that navbake wrote, they are the cells of the written
    grid. All have a flat floor, at z = 0 unless navbake wrote the map. Rooms are numbered as in
    ``floor_insseg_0.png``, which is read beside a map whose name ends in ``_0``, see
    `name_room_files`; with ``room_categories.txt``, they are named as OmniGibson names them:
    ``bedroom_0``.

    Args:
        path: the map.

    Returns:
        The level.

    Raises:
        FormatError: the file is no such map, or a room map has a different size.

    Example:
        >>> grid = navbake.from_omnigibson("floor_trav_0.png")
    """
    image = open_image(path, ("PNG",))
    cells_text = image.info.get("navbake")
    num_pixels = image.width
    if image.width != image.height:
        actual_text = f"{image.width} × {image.height} pixels"
        message = f"expected a square map in {path}, got {actual_text}"
        raise FormatError(message, path=str(path), value=image.size, expected="a square map")
    if image.mode not in ("1", "L"):
        message = f"expected a map of one channel in {path}, got {image.mode}"
        raise FormatError(
            message, path=str(path), value=image.mode, expected="a map of one channel"
        )
    half_extent = num_pixels * PIXEL_SIZE / 2
    lattice = Lattice(-half_extent, half_extent, PIXEL_SIZE, num_pixels, num_pixels)
    ground = 0.0
    if isinstance(cells_text, str):
        lattice, ground = _parse_cells(cells_text, path)
    # the pixel at each cell's centre
    rows = np.floor(lattice.center_y() / PIXEL_SIZE + num_pixels / 2).astype(np.int64)
    cols = np.floor(lattice.center_x() / PIXEL_SIZE + num_pixels / 2).astype(np.int64)
    if min(rows[-1], cols[0]) < 0 or max(rows[0], cols[-1]) >= num_pixels:
        message = f"the cells that the text of {path} states reach beyond its {num_pixels} pixels"
        raise FormatError(message, path=str(path))
    pixel_of_cell = (rows[:, None], cols)
    is_free = np.asarray(image.convert("L"))[pixel_of_cell] == 255
    room_numbers = np.zeros(is_free.shape, dtype=np.uint16)
    room_names = dict[int, str]()
    room_files = _find_room_files(Path(path))
    if room_files is not None:
        room_pixels, room_names = _read_room_maps(room_files, num_pixels)
        room_numbers = room_pixels[pixel_of_cell].astype(np.uint16)
    return level_from_rooms(is_free, room_numbers, room_names, lattice, ground, readable_stem(path))


def list_room_maps(path: Path) -> list[Path]:
    """List the existing files of rooms and categories that `read_omnigibson` reads with a map."""
    room_files = _find_room_files(path)
    if room_files is None:
        return []
    return [candidate for candidate in room_files if candidate.exists()]


def _find_room_files(path: Path) -> RoomFiles | None:
    """Find the files of rooms of a map of level 0; None for another level, or without such files.

    Earlier versions of navbake gave OmniGibson's names to the rooms of each map.
    """
    stem = path.stem.removesuffix("_0")
    if stem == path.stem:
        return None
    for candidate_stem in (stem, f"{OMNIGIBSON_HEAD}trav"):
        room_files = name_room_files(path.parent, candidate_stem)
        if room_files.room_image.exists():
            if not room_files.category_list.exists():  # a list for the whole folder
                list_path = path.with_name("room_categories.txt")
                return room_files._replace(category_list=list_path)
            return room_files
    return None


def _parse_cells(text: str, path: str | PathLike[str]) -> tuple[Lattice, float]:
    """Return the lattice and the ground that the text of a map states."""
    try:
        lattice_fields: Json = orjson.loads(text)
        ground = float(lattice_fields.pop("ground"))
        lattice = Lattice(**lattice_fields)
        is_valid = lattice.cell_size >= PIXEL_SIZE - PIXEL_MARGIN
        is_valid &= min(lattice.width, lattice.height) >= 1
        is_valid &= abs(ground) <= MAX_COORDINATE and lattice.width * lattice.height <= MAX_PIXELS
        is_valid &= type(lattice.width) is type(lattice.height) is int
        if not is_valid or not all(abs(bound) <= MAX_COORDINATE for bound in lattice.bounds):
            raise ValueError("out of range")
    except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError) as error:
        expected = "the cells of a map"
        raise FormatError(
            f"expected {expected} as `navbake` in {path}: {error}",
            path=str(path),
            key="navbake",
            value=text,
            expected=expected,
        ) from error
    return lattice, ground


def _read_room_maps(
    room_files: RoomFiles, image_size: int
) -> tuple[NDArray[np.uint8], dict[int, str]]:
    """Read the room number of each pixel, and the names that OmniGibson gives the rooms.

    A name is the room's category (that of its first pixel) with a number: the rooms of a category
    are counted from 0.

    Args:
        room_files: the files.
        image_size: the edge of each image [pixels].

    Returns:
        The image of room numbers, and number of a room -> its name.
    """
    room_numbers = _read_room_map(room_files.room_image, image_size)
    category_numbers = _read_room_map(room_files.category_image, image_size)
    list_path = room_files.category_list
    category_names = _read_lines(list_path) if list_path.exists() else []
    room_names = dict[int, str]()
    num_rooms_of_category = Counter[str]()
    unique_numbers, first_pixel = np.unique(room_numbers, return_index=True)
    first_category = category_numbers.ravel()[first_pixel]
    for room_number, category in zip(unique_numbers.tolist(), first_category.tolist(), strict=True):
        if room_number and 1 <= category <= len(category_names) and category_names[category - 1]:
            name = category_names[category - 1]
            room_names[room_number] = f"{name}_{num_rooms_of_category[name]}"
            num_rooms_of_category[name] += 1
    return room_numbers, room_names


def _read_room_map(path: Path, image_size: int) -> NDArray[np.uint8]:
    """Read the bytes of a square image; zeros if it does not exist."""
    if not path.exists():
        return np.zeros((image_size, image_size), dtype=np.uint8)
    image = open_image(path, ("PNG",))
    if image.size != (image_size, image_size) or image.mode not in ("L", "P"):
        expected = f"bytes of {image_size} × {image_size}"
        actual_text = f"{image.mode} of {image.width} × {image.height}"
        raise FormatError(
            f"expected {expected} in {path}, got {actual_text}",
            path=str(path),
            value=actual_text,
            expected=expected,
        )
    return np.asarray(image)


def _read_lines(path: Path) -> list[str]:
    content, _ = read_bytes(path)
    return [line.rstrip() for line in content.decode(errors="replace").split("\n")]
