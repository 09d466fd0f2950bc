"""Maps of OmniGibson and iGibson: square grey PNGs of 0.01 m a pixel.

The origin is in the middle of the image, columns run along x, and rows along y, from the lowest.
``floor_trav_0.png`` is 255 where a robot's centre may be on floor 0. ``floor_insseg_0.png`` has the
number of the room, and ``floor_semseg_0.png`` that of its category, a line of
``room_categories.txt``, both 0 outside of rooms. OmniGibson has room maps of floor 0 only.
navbake's own files have their cells in a text chunk of the PNG, by which they come back.

Sources: ``map_base.py``, ``traversable_map.py`` and ``segmentation_map.py`` of OmniGibson.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.files import readable_stem
from navbake.formats.allowance import MAX_PIXELS
from navbake.formats.convert import select_levels
from navbake.formats.occupancy import (
    level_from_rooms,
)
from navbake.formats.source import Files, encode_image, open_image, read_bytes
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST, Lattice
from navbake.types import Json

MAX_ROOMS = 255  # numbers in a byte
PIXEL_SIZE = 0.01  # edge [m]
PIXEL_MARGIN = 1e-7  # [m], by which a pixel is smaller on each side: cells' edges aren't exact
ROOMS_FILE = "floor_insseg_0.png"
CATEGORIES_FILE = "floor_semseg_0.png"
CATEGORY_NAMES_FILE = "room_categories.txt"
NO_OBJECTS = "no_obj"  # in the name of a map without furniture
TRAILING_NUMBER = re.compile(r"[\s_-]*\d*$")  # at the end of a room's name


def encode_omnigibson(
    grid: NavGrid, path: Path, *, level: int | None = None, categories: Path | None = None
) -> Files:
    """Encode a map for each level, and the room maps of level 0 beside it.

    A pixel is free if all cells that it meets are. A room's category is its name in lower case,
    with ``_`` for spaces and without a number at the end, or ``room``.

    Args:
        path: ends in ``.png``; the level's number is added: ``floor_trav_0.png``. There are no room
            maps if its name has ``no_obj``, as that of a grid that was baked without furniture.
        level: this level only.
        categories: the ``room_categories.txt`` of OmniGibson's dataset, which has to have all
            rooms' categories. If None, one of these rooms is written.

    Raises:
        FormatError: there is no such level, an image is too large, cells are smaller than a pixel,
            there are more than 255 rooms, or a category isn't in the list.
    """
    files: Files = {}
    chosen = select_levels(grid, path, level, (".png",))
    for number in chosen:
        own = grid.levels[number]
        lattice = own.lattice
        if lattice.cell_size < PIXEL_SIZE - PIXEL_MARGIN:
            raise FormatError(
                f"expected cells of {PIXEL_SIZE} m at least, got {lattice.cell_size:g} m"
            )
        half = math.ceil(max(map(abs, lattice.bounds)) / PIXEL_SIZE) + 1  # 0 has to be in room maps
        if (2 * half) ** 2 > MAX_PIXELS:
            far = half * PIXEL_SIZE
            most = math.isqrt(MAX_PIXELS) // 2 * PIXEL_SIZE
            what = f"OmniGibson's maps are centred on the origin, and level {number} ends"
            raise FormatError(f"{what} {far:.1f} m from it, expected {most:.1f} m at most")
        text = orjson.dumps({**lattice._asdict(), "ground": own.ground}).decode()
        free = np.ones((2 * half, 2 * half), dtype=bool)
        reach = PIXEL_SIZE / 2 - PIXEL_MARGIN  # a pixel meets two cells at most along each axis
        for right, up in itertools.product((-reach, reach), repeat=2):
            free &= _sample(own.free, lattice, half, right, up)
        pixels = np.where(free, np.uint8(255), np.uint8(0))
        name = path.with_name(f"{path.stem}_{number}{path.suffix}")
        files[name] = encode_image(pixels, "PNG", navbake=text)
        if number == 0 and NO_OBJECTS not in path.stem and own.room_index.any():
            files |= _encode_rooms(grid, path.parent, half, categories)
    return files


def _sample(
    layer: NDArray[Any], lattice: Lattice, half: int, right: float = 0.0, up: float = 0.0
) -> NDArray[Any]:
    """A layer at the middles of all pixels, moved right and up [m]; 0 outside of the lattice."""
    middle = (np.arange(2 * half) + (0.5 - half)) * PIXEL_SIZE
    rows, cols = lattice.rows_cols(np.stack([middle + right, middle + up], axis=-1))
    rows, cols = (np.clip(k + 1, 0, n + 1) for k, n in zip((rows, cols), layer.shape, strict=True))
    found: NDArray[Any] = np.pad(layer, 1)[rows[:, None], cols]
    return found


def _encode_rooms(grid: NavGrid, folder: Path, half: int, categories: Path | None) -> Files:
    """The room maps of level 0."""
    level = grid.levels[0]
    names = {
        room.index: TRAILING_NUMBER.sub("", (room.name or "").lower()).replace(" ", "_") or "room"
        for room in grid.rooms
        if room.level == 0
    }
    most = int(level.room_index.max())
    if most > MAX_ROOMS:
        limit = f"a map of OmniGibson numbers rooms up to {MAX_ROOMS}"
        raise FormatError(f"{limit}, level 0 has {most}")
    files: Files = {}
    if categories is None:
        known = sorted({*names.values(), "room"})
        files[folder / CATEGORY_NAMES_FILE] = "".join(f"{name}\n" for name in known).encode()
    else:
        known = _read_lines(categories)
        for number, name in names.items():
            if name not in known:
                what = f"room {number} of level 0 is a {name!r}, which {categories} doesn't have"
                remedy = "name rooms as its lines do, see `rooms` in the settings"
                raise FormatError(f"{what}: {remedy}")
    kinds = np.zeros(most + 1, dtype=np.int64)
    kinds[1:] = known.index("room") + 1 if "room" in known else 0
    for number, name in names.items():
        kinds[number] = known.index(name) + 1
    if kinds.max() > MAX_ROOMS:
        limit = f"a map of OmniGibson numbers categories up to {MAX_ROOMS}"
        raise FormatError(f"{limit}, the last of level 0 has the number {kinds.max()}")
    index = _sample(level.room_index, level.lattice, half)
    files[folder / ROOMS_FILE] = encode_image(index.astype(np.uint8), "PNG")
    files[folder / CATEGORIES_FILE] = encode_image(kinds[index].astype(np.uint8), "PNG")
    return files


def read_omnigibson(path: str | PathLike[str]) -> SceneGrid2D:
    """Read a traversability map as a grid of one level, with the rooms of room maps beside it.

    Cells are pixels of 0.01 m, or those that navbake made the map of. All have a flat floor, at
    z = 0 unless navbake wrote the map. Rooms are numbered as in ``floor_insseg_0.png``, which is
    read beside a map whose name ends in ``_0``; with ``room_categories.txt``, they are named as
    OmniGibson names them, ``bedroom_0``. Raises a FormatError if the file is no such map, or a room
    map isn't of its size.
    """
    image = open_image(path, ("PNG",))
    own = image.info.get("navbake")
    size = image.width
    if image.width != image.height:
        got = f"{image.width} × {image.height}"
        raise FormatError(f"expected a square map in {path}, got {got} pixels")
    if image.mode not in ("1", "L"):
        raise FormatError(f"expected a map of one channel in {path}, got {image.mode}")
    half = size * PIXEL_SIZE / 2
    lattice = Lattice(-half, half, PIXEL_SIZE, size, size)
    ground = 0.0
    if isinstance(own, str):
        lattice, ground = _parse_cells(own, path)
    rows = np.floor(lattice.center_y() / PIXEL_SIZE + size / 2).astype(np.int64)
    cols = np.floor(lattice.center_x() / PIXEL_SIZE + size / 2).astype(np.int64)
    if min(rows[-1], cols[0]) < 0 or max(rows[0], cols[-1]) >= size:
        raise FormatError(
            f"the cells that the text of {path} states reach beyond its {size} pixels"
        )
    picked = rows[:, None], cols
    free = np.asarray(image.convert("L"))[picked] == 255
    rooms = np.zeros(free.shape, dtype=np.uint16)
    names = dict[int, str]()
    if list_room_maps(Path(path)):
        index, names = _read_rooms(Path(path).parent, size)
        rooms = index[picked].astype(np.uint16)
    return level_from_rooms(free, rooms, names, lattice, ground, readable_stem(path))


def list_room_maps(path: Path) -> list[Path]:
    """The room maps that `read_omnigibson` reads beside a map."""
    found = [path.with_name(name) for name in (ROOMS_FILE, CATEGORIES_FILE, CATEGORY_NAMES_FILE)]
    is_first = path.stem.endswith("_0") and found[0].exists()
    return [file for file in found if file.exists()] if is_first else []


def _parse_cells(text: str, path: str | PathLike[str]) -> tuple[Lattice, float]:
    """The lattice and the ground that navbake wrote into a map."""
    try:
        stated: Json = orjson.loads(text)
        ground = float(stated.pop("ground"))
        lattice = Lattice(**stated)
        is_sound = (
            lattice.cell_size >= PIXEL_SIZE - PIXEL_MARGIN
            and min(lattice.width, lattice.height) >= 1
        )
        is_sound &= abs(ground) <= FARTHEST and lattice.width * lattice.height <= MAX_PIXELS
        is_sound &= type(lattice.width) is type(lattice.height) is int
        if not is_sound or not all(abs(edge) <= FARTHEST for edge in lattice.bounds):
            raise ValueError("out of range")
    except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise FormatError(f"expected the cells of a map as `navbake` in {path}: {error}") from error
    return lattice, ground


def _read_rooms(folder: Path, size: int) -> tuple[NDArray[np.uint8], dict[int, str]]:
    """The numbers of rooms, and names as OmniGibson's.

    These are the category of a room's first pixel, and a count from 0 in each.
    """
    layers = []
    for name in (ROOMS_FILE, CATEGORIES_FILE):
        if not (folder / name).exists():
            layers.append(np.zeros((size, size), dtype=np.uint8))
            continue
        image = open_image(folder / name, ("PNG",))
        if image.size != (size, size) or image.mode not in ("L", "P"):
            got = f"{image.mode} of {image.width} × {image.height}"
            raise FormatError(f"expected bytes of {size} × {size} in {folder / name}, got {got}")
        layers.append(np.asarray(image))
    index, kinds = layers
    known = (
        _read_lines(folder / CATEGORY_NAMES_FILE) if (folder / CATEGORY_NAMES_FILE).exists() else []
    )
    names = dict[int, str]()
    counts = Counter[str]()
    numbers, first = np.unique(index, return_index=True)
    for number, kind in zip(numbers.tolist(), kinds.ravel()[first].tolist(), strict=True):
        if number and 1 <= kind <= len(known) and known[kind - 1]:
            name = known[kind - 1]
            names[number] = f"{name}_{counts[name]}"
            counts[name] += 1
    return index, names


def _read_lines(path: Path) -> list[str]:
    text = read_bytes(path)[0].decode(errors="replace")
    return [line.rstrip() for line in text.split("\n")]
