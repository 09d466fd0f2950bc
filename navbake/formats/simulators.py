"""Maps of simulators: GRScenes, MolmoSpaces (ProcTHOR), and OmniGibson and iGibson.

- GRScenes' ``occupancy.npy``: samples of a level, between their own world coordinates. The first
  row has the x of each column, the first column the y of each row [m], the corner nothing. The
  other values are 0 for free, 1 for an obstacle, and -1 for undefined. In files of GRScenes, y
  falls from row to row, and the steps of x and y differ by a little.
- ``ProcTHORMap``: a PNG with its matrices in text chunks. Red and green are 255 in free cells
  (MolmoSpaces calls that ``occupancy``), blue is the room's number, 0 for none. ``world_to_map``
  (2 × 4) and ``map_to_world`` (3 × 3) are the matrices of its formulas:
  ``round([x, y, z, 1] @ world_to_map.T)`` is row and column, and ``[row, col, 1] @ map_to_world.T``
  the world position of that pixel's middle. So whole numbers are the middles of cells, half a cell
  off from matrices for ``floor``.
- OmniGibson: square grey PNGs of 0.01 m a pixel. The origin is in the middle of the image, columns
  run along x, and rows along y, from the lowest. ``floor_trav_0.png`` is 255 where a robot's centre
  may be on floor 0. ``floor_insseg_0.png`` has the number of the room, and ``floor_semseg_0.png``
  that of its category, a line of ``room_categories.txt``, both 0 outside of rooms. OmniGibson has
  room maps of floor 0 only. navbake's own files have their cells in a text chunk of the PNG, by
  which they come back.

Sources: the answer of GRScenes' authors in InternUtopia's issue 83; ``ProcTHORMap.save`` and
``load`` of ``molmo_spaces/utils/scene_maps.py``; ``map_base.py``, ``traversable_map.py`` and
``segmentation_map.py`` of OmniGibson.
"""

from __future__ import annotations

import io
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
from navbake.formats.allowance import MAX_PIXELS, Allowance, JsonPath
from navbake.formats.convert import chosen_levels, level_paths
from navbake.formats.npz import read_npy
from navbake.formats.occupancy import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    level_from_rooms,
    level_from_values,
)
from navbake.formats.source import Files, check_path, encode_image, open_image, read_bytes
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST, LEAST_EDGE, Lattice
from navbake.types import Float, Json

# of GRScenes
OBSTACLE = 1
UNEVEN = 0.01  # of a step, by which a coordinate may be off
DRIFT = 0.01  # of a cell, by which a map with steps of two lengths may be off at its end
BYTES = 32  # of memory for a cell: values, weights, layers
# of images
MAX_ROOMS = 255  # numbers in a byte
ZERO = 1e-6  # relative size of a matrix's entry that counts as 0
PIXEL = 0.01  # edge [m]
SLACK = 1e-7  # [m], by which a pixel is smaller on each side: cells' edges aren't exact
ROOMS = "floor_insseg_0.png"
KINDS = "floor_semseg_0.png"
CATEGORIES = "room_categories.txt"
NO_OBJECTS = "no_obj"  # in the name of a map without furniture
NUMBER = re.compile(r"[\s_-]*\d*$")  # at the end of a room's name


# ---------------------------------------------------------------- GRScenes


def encode_grscenes(grid: NavGrid, path: Path, *, level: int | None = None) -> Files:
    """Encode an ``occupancy.npy`` of each level, float64; cells without a floor are undefined.

    `path` ends in ``.npy``; `level` is as of `encode_nav2`. Raises a FormatError for a wrong one.
    """
    files: Files = {}
    for number, own_path in level_paths(grid, path, level, (".npy",)).items():
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
    if abs(dx - dy) * max(shape) > DRIFT * min(dx, dy):
        cell = min(dx, dy)
        shape = max(1, round(height * dy / cell)), max(1, round(width * dx / cell))
    allowance = Allowance(array.nbytes, "max_cells")
    allowance.take_cells(shape, place)
    allowance.take_array(shape, BYTES, place)
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
    if abs(step) < LEAST_EDGE or np.abs(found - even).max() > UNEVEN * abs(step):
        place.fail(f"expected {axis} of samples in even steps, got others")
    return step


# ---------------------------------------------------------------- ProcTHOR


def encode_procthor(grid: NavGrid, path: Path, *, level: int | None = None) -> Files:
    """Encode the ``ProcTHORMap`` of each level; `path` ends in ``.png``.

    `level` is as of `encode_nav2`. Raises a FormatError for an unknown level, or one of more than
    255 rooms.
    """
    files: Files = {}
    for number, own_path in level_paths(grid, path, level, (".png",)).items():
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
    linear = np.where(np.abs(to_map[:, :3]) <= ZERO * scale, 0.0, to_map[:, :3])
    if linear[0, 0] != 0:  # rows run along x
        layers = layers.transpose(0, 2, 1)
        linear = linear[::-1]
        to_map = to_map[::-1]
    (row_x, row_y, row_z), (col_x, col_y, col_z) = linear
    is_straight = row_x == col_y == row_z == col_z == 0 and row_y != 0 and col_x != 0
    if not is_straight or abs(abs(row_y) - abs(col_x)) > ZERO * scale:
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


# ---------------------------------------------------------------- OmniGibson


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
    chosen = chosen_levels(grid, path, level, (".png",))
    for number in chosen:
        own = grid.levels[number]
        lattice = own.lattice
        if lattice.cell_size < PIXEL - SLACK:
            raise FormatError(f"expected cells of {PIXEL} m at least, got {lattice.cell_size:g} m")
        half = math.ceil(max(map(abs, lattice.bounds)) / PIXEL) + 1  # 0 has to be in room maps
        if (2 * half) ** 2 > MAX_PIXELS:
            far = half * PIXEL
            most = math.isqrt(MAX_PIXELS) // 2 * PIXEL
            what = f"OmniGibson's maps are centred on the origin, and level {number} ends"
            raise FormatError(f"{what} {far:.1f} m from it, expected {most:.1f} m at most")
        text = orjson.dumps({**lattice._asdict(), "ground": own.ground}).decode()
        free = np.ones((2 * half, 2 * half), dtype=bool)
        reach = PIXEL / 2 - SLACK  # a pixel meets two cells at most along each axis
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
    middle = (np.arange(2 * half) + (0.5 - half)) * PIXEL
    rows, cols = lattice.rows_cols(np.stack([middle + right, middle + up], axis=-1))
    rows, cols = (np.clip(k + 1, 0, n + 1) for k, n in zip((rows, cols), layer.shape, strict=True))
    found: NDArray[Any] = np.pad(layer, 1)[rows[:, None], cols]
    return found


def _encode_rooms(grid: NavGrid, folder: Path, half: int, categories: Path | None) -> Files:
    """The room maps of level 0."""
    level = grid.levels[0]
    names = {
        room.index: NUMBER.sub("", (room.name or "").lower()).replace(" ", "_") or "room"
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
        files[folder / CATEGORIES] = "".join(f"{name}\n" for name in known).encode()
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
    files[folder / ROOMS] = encode_image(index.astype(np.uint8), "PNG")
    files[folder / KINDS] = encode_image(kinds[index].astype(np.uint8), "PNG")
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
    half = size * PIXEL / 2
    lattice = Lattice(-half, half, PIXEL, size, size)
    ground = 0.0
    if isinstance(own, str):
        lattice, ground = _parse_cells(own, path)
    rows = np.floor(lattice.center_y() / PIXEL + size / 2).astype(np.int64)
    cols = np.floor(lattice.center_x() / PIXEL + size / 2).astype(np.int64)
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
    found = [path.with_name(name) for name in (ROOMS, KINDS, CATEGORIES)]
    is_first = path.stem.endswith("_0") and found[0].exists()
    return [file for file in found if file.exists()] if is_first else []


def _parse_cells(text: str, path: str | PathLike[str]) -> tuple[Lattice, float]:
    """The lattice and the ground that navbake wrote into a map."""
    try:
        stated: Json = orjson.loads(text)
        ground = float(stated.pop("ground"))
        lattice = Lattice(**stated)
        is_sound = lattice.cell_size >= PIXEL - SLACK and min(lattice.width, lattice.height) >= 1
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
    for name in (ROOMS, KINDS):
        if not (folder / name).exists():
            layers.append(np.zeros((size, size), dtype=np.uint8))
            continue
        image = open_image(folder / name, ("PNG",))
        if image.size != (size, size) or image.mode not in ("L", "P"):
            got = f"{image.mode} of {image.width} × {image.height}"
            raise FormatError(f"expected bytes of {size} × {size} in {folder / name}, got {got}")
        layers.append(np.asarray(image))
    index, kinds = layers
    known = _read_lines(folder / CATEGORIES) if (folder / CATEGORIES).exists() else []
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
