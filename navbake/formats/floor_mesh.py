"""The walkable floor of a grid as a mesh of few quads, written as binary glTF (.glb) or OBJ.

A level is an object, a room a material or a group of it; trimesh has no groups in an OBJ, and no
primitives of one object in a GLB.

Source: glTF 2.0 Specification, Khronos Group, sections 3 and 4.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.errors import QueryError
from navbake.formats.source import Files
from navbake.navgrid.colors import FREE, color_rooms, rgb_of, to_linear
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.lattice import FARTHEST
from navbake.types import Float, Int, Json

TOLERANCE = 0.001  # [m]
MAX_SLOPE = 45.0  # of files that state none [deg]
SLACK = 1e-6  # relative rounding of the steepest slope
NO_ROOM = "no room"
COMPONENTS = {np.dtype("<f4"): 5126, np.dtype("<u2"): 5123, np.dtype("<u4"): 5125}
# targets of buffer views
VERTICES = 34962
INDICES = 34963
UPS = ("y", "z")
VERTEX = "v %.10g %.10g %.10g %.3f %.3f %.3f\n"
FACE = "f %d %d %d\nf %d %d %d\n"


@dataclass(frozen=True, eq=False)
class LevelMesh:
    """The walkable floor of a level: quads of two triangles and four vertices each."""

    name: str  #: Of the level.
    #: The outer corner of the level's cell 0, on its ground: world x, y, z [m].
    origin: tuple[float, float, float]
    #: World x, y, z [m], shape (4 n, 3), float64; of each quad anticlockwise from above.
    vertices: Float
    room: Int  #: By quad, its number in `rooms`, shape (n,), int64, ascending; 0 for none.
    rooms: list[str]  #: The rooms' names by that number, each once; 0 is "no room".
    #: The rooms' indices on the level by that number, see `SceneGrid2D.room_index`.
    indices: list[int]

    @property
    def faces(self) -> Int:
        """The vertices of each triangle, anticlockwise from above, shape (2 n, 3), int64."""
        first = 4 * np.arange(len(self.room))[:, None, None]
        faces: Int = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
        return faces

    @property
    def area(self) -> float:
        """Seen from above [m²]; that of the free cells."""
        quads = self.vertices.reshape(-1, 4, 3)
        return float(np.prod(quads[:, 2, :2] - quads[:, 0, :2], axis=1).sum())


@dataclass(frozen=True, eq=False)
class FloorMesh:
    """The walkable floor of a grid: a mesh a level, lowest first."""

    levels: list[LevelMesh]

    @property
    def vertices(self) -> Float:
        """World x, y, z of all levels [m], shape (n, 3), float64."""
        return np.concatenate([level.vertices for level in self.levels])

    @property
    def faces(self) -> Int:
        """The triangles of all levels as rows of `vertices`, shape (m, 3), int64."""
        first = np.cumsum([0] + [len(level.vertices) for level in self.levels])
        return np.concatenate([v.faces + n for v, n in zip(self.levels, first, strict=False)])

    @property
    def area(self) -> float:
        """Seen from above [m²]; that of the free cells."""
        return sum(level.area for level in self.levels)


def make_floor_mesh(grid: NavGrid, tolerance: float = TOLERANCE) -> FloorMesh:
    """Make a mesh of a grid's free cells.

    Each free cell is covered once, all others are left open. Cells of one room in a rectangle whose
    floor is a plane within the tolerance become one quad: level, or sloped where three cells or
    more in a line rise evenly, up to the grid's `maxSlope` (45 degrees if it states none). So
    stairs are level treads, and ramps are slopes; stairs whose treads are all one cell deep become
    a slope.

    There are no risers. Where two quads meet, their heights differ by the step between the cells'
    floors, plus at most the rise of each quad over half a cell. A free cell without floor height
    lies on the level's ground.

    The mesh is off the floor at a cell's centre by at most `tolerance` [m], >= 0. Raises a
    QueryError if that is invalid.
    """
    is_length = isinstance(tolerance, int | float | np.number) and 0 <= tolerance <= FARTHEST
    if not is_length:
        raise QueryError(f"expected a tolerance of 0 m or more, got {tolerance!r}")
    # rooms by number, with unique names in the whole grid
    count = Counter(room.name for room in grid.rooms)
    names = {
        (room.level, room.index): room.name if room.name and count[room.name] == 1 else room.id
        for room in grid.rooms
    }
    stated: Any = grid.navbake.get("maxSlope")
    is_angle = type(stated) in (int, float) and 0 <= stated < 90
    steepest = math.tan(math.radians(stated if is_angle else MAX_SLOPE)) * (1 + SLACK)
    levels = []
    for number, level in enumerate(grid.levels):
        lattice = level.lattice
        size = level.lattice.cell_size
        index = level.room_index.astype(np.int32)
        labels = np.where(level.free, index + 1, 0)
        heights = level.floor_or_ground
        first, rows, cols, z = cover_quads(labels, heights, float(tolerance), steepest * size)
        own = index[first[:, 0], first[:, 1]]
        order = np.argsort(own, kind="stable")
        corners = [lattice.x_min + cols * size, lattice.y_max - rows * size, z]
        found, room = np.unique(own[order], return_inverse=True)
        indices = [i for i in found.tolist() if i]
        mesh = LevelMesh(
            name=grid.level_names[number],
            origin=(lattice.x_min, lattice.y_max, level.ground),
            vertices=np.stack(corners, axis=-1)[order].reshape(-1, 3),
            # 0 is no room, also where all cells are in one
            room=room.astype(np.int64) + (len(indices) == len(found)),
            rooms=[NO_ROOM, *(names.get((number, i), f"{number}:{i}") for i in indices)],
            indices=[0, *indices],
        )
        levels.append(mesh)
    return FloorMesh(levels)


def cover_quads(
    labels: NDArray[np.int32], heights: Float, tolerance: float, steepest: float, margin: float = 0
) -> tuple[Int, Float, Float, Float]:
    """Cover cells by few quads, each of one label and one plane; see `cover_planes`.

    Returns:
        Row and column of each quad's first cell, shape (n, 2); and rows, columns and heights of its
        corners, anticlockwise from above, the lower left one first, shape (n, 4) each. The quads
        are larger by `margin` on each side [cells]; smaller if it is negative.
    """
    from navbake.compiled import ensure_compiled  # numba loads slowly
    from navbake.formats.plane_kernels import cover_planes  # as above

    ensure_compiled("formats.plane_kernels.")
    bounds, planes = cover_planes(labels, heights, tolerance, steepest)
    row0, col0, row1, col1 = bounds.T
    rows = np.stack([row1, row1, row0, row0], axis=1) + np.array([1, 1, -1, -1]) * margin
    cols = np.stack([col0, col1, col1, col0], axis=1) + np.array([-1, 1, 1, -1]) * margin
    # from the first centre
    down = rows - row0[:, None] - 0.5
    right = cols - col0[:, None] - 0.5
    z = planes[:, :1] + right * planes[:, 1:2] + down * planes[:, 2:]
    return bounds[:, :2], rows, cols, z


def find_room_colors(grid: NavGrid, mesh: FloorMesh) -> list[NDArray[np.uint8]]:
    """Colours of `LevelMesh.rooms`, sRGB, shape (n, 3), by level; neighbours' differ."""
    found = []
    for number, level in enumerate(mesh.levels):
        colors = color_rooms(grid, number)[level.indices]
        colors[0] = rgb_of(FREE)
        found.append(colors)
    return found


# ---------------------------------------------------------------- files


class GlbBuffer:
    """The one buffer of a GLB, and its views and accessors."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._views: list[Json] = []
        self._accessors: list[Json] = []

    def add_bytes(self, content: bytes, target: int | None = None) -> int:
        """Append bytes, and return the number of their buffer view."""
        view = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(content)}
        self._views.append(view if target is None else {**view, "target": target})
        self._data += content + bytes(-len(content) % 4)
        return len(self._views) - 1

    def add_indices(self, faces: NDArray[np.uint32]) -> int:
        """Append indices into vertices, any shape, and return the number of their accessor."""
        return self._add(np.ravel(faces), "SCALAR", INDICES)

    def add_vectors(self, values: NDArray[Any], **more: Any) -> int:
        """Append vectors, shape (n, 2 to 4), float32 or uint16, and return their accessor's number.

        `more` are further entries of the accessor.
        """
        return self._add(values, f"VEC{values.shape[1]}", VERTICES, **more)

    def add_positions(self, vertices: NDArray[np.float32]) -> int:
        """Append vertices, shape (n, 3), n > 0, with their bounds, which glTF demands."""
        low = vertices.min(axis=0).tolist()
        high = vertices.max(axis=0).tolist()
        return self.add_vectors(vertices, min=low, max=high)

    def _add(self, values: NDArray[Any], shape: str, target: int, **more: Any) -> int:
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        view = self.add_bytes(values.tobytes(), target)
        component = COMPONENTS[values.dtype]
        entry = {"bufferView": view, "componentType": component, "count": len(values)}
        self._accessors.append({**entry, "type": shape, **more})
        return len(self._accessors) - 1

    def pack(self, document: Json) -> bytes:
        """The content of a GLB file, without the document's empty parts, as glTF demands."""
        tables = {"accessors": self._accessors, "bufferViews": self._views}
        if self._data:
            tables["buffers"] = [{"byteLength": len(self._data)}]
        asset = {"version": "2.0", "generator": f"navbake {__version__}"}
        whole = {"asset": asset, "scene": 0, **document, **tables}
        text = orjson.dumps({key: value for key, value in whole.items() if value not in ([], {})})
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        if self._data:
            chunks += struct.pack("<I4s", len(self._data), b"BIN\0") + self._data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def encode_glb(grid: NavGrid, path: Path, *, tolerance: float = TOLERANCE) -> Files:
    """Encode a grid's walkable floor as GLB; see `make_floor_mesh` for its quads.

    y is up, in metres, as glTF has it: ``(x, z, -y)`` of the world. Each level is an object by its
    name, with its origin at the outer corner of cell 0 on the ground; each room a material by its
    name, in its colour of the pictures.
    """
    mesh = make_floor_mesh(grid, tolerance)
    buffer = GlbBuffer()
    scenes = [{"nodes": list(range(len(mesh.levels)))}]
    document: Json = {"scenes": scenes, "nodes": [], "meshes": [], "materials": []}
    for level, colors in zip(mesh.levels, find_room_colors(grid, mesh), strict=True):
        x, y, z = level.origin
        node: Json = {"name": level.name, "translation": [x, z, 0.0 - y]}
        document["nodes"].append(node)
        if not len(level.room):
            continue
        node["mesh"] = len(document["meshes"])
        primitives = list[Json]()
        document["meshes"].append({"name": level.name, "primitives": primitives})
        east, north, up = (level.vertices - level.origin).T
        turned = np.stack([east, up, 0.0 - north], axis=1).astype(np.float32)
        for room in np.unique(level.room).tolist():
            # its quads in a row
            first, end = np.searchsorted(level.room, [room, room + 1]).tolist()
            name = level.rooms[room]
            materials = document["materials"]
            part = {"POSITION": buffer.add_positions(turned[4 * first : 4 * end])}
            faces = buffer.add_indices(level.faces[: 2 * (end - first)].astype(np.uint32))
            own = {"material": len(materials), "extras": {"room": name}}
            primitives.append({"attributes": part, "indices": faces, **own})
            color = [*np.round(to_linear(colors[room] / 255), 6).tolist(), 1.0]
            looks = {"baseColorFactor": color, "metallicFactor": 0.0}
            materials.append({"name": name, "pbrMetallicRoughness": looks, "doubleSided": True})
    return {path: buffer.pack(document)}


def encode_obj(grid: NavGrid, path: Path, *, tolerance: float = TOLERANCE, up: str = "y") -> Files:
    """Encode a grid's walkable floor as OBJ; see `make_floor_mesh` for its quads.

    Each level is an object, each room a group of it. Vertices have their room's colour after their
    position, an extension that most programs read. Each character of a name that is no letter,
    digit, ``.`` or ``-`` becomes ``_``. `up` is ``y``: ``(x, z, -y)`` of the world, or ``z``: the
    world's own x, y, z, in metres. Raises a QueryError for any other.
    """
    if up not in UPS:
        raise QueryError(f"expected y or z as up, got {up!r}")
    mesh = make_floor_mesh(grid, tolerance)
    lines = [f"# the walkable floor of a navbake grid, in metres, {up} up\n"]
    done = 0
    levels = set[str]()
    groups = set[str]()
    for level, colors in zip(mesh.levels, find_room_colors(grid, mesh), strict=True):
        lines.append(f"o {_own_name(level.name, levels)}\n")
        x, y, z = level.vertices.T
        z = np.round(z, 6)  # drops the noise of float32
        points = np.stack([x, z, 0.0 - y] if up == "y" else [x, y, z], axis=1)
        shades = colors[np.repeat(level.room, 4)] / 255
        values = np.hstack([points, shades]).ravel().tolist()
        lines.append((VERTEX * len(points)) % tuple(values))
        faces = level.faces + done + 1  # counted from 1 through the file
        for room in np.unique(level.room).tolist():
            own = faces[np.repeat(level.room == room, 2)].ravel().tolist()
            lines.append(f"g {_own_name(level.rooms[room], groups)}\n")
            lines.append((FACE * (len(own) // 6)) % tuple(own))
        done += len(points)
    return {path: "".join(lines).encode()}


def _own_name(name: str, used: set[str]) -> str:
    """A unique name with the characters that OBJ allows."""
    plain = re.sub(r"[^\w.\-]", "_", name) or "_"
    numbered = (plain if k == 1 else f"{plain}_{k}" for k in itertools.count(1))
    found = next(name for name in numbered if name not in used)
    used.add(found)
    return found
