"""The walkable floor of a grid as a mesh of few quads, written as binary glTF (.glb) or OBJ.

Each level is an object. Each of its rooms has a material in a GLB, and is a group in an OBJ. Files
are not written by trimesh, which can do neither.

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
from typing import Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.errors import QueryError
from navbake.formats.map_losses import find_closed_cells
from navbake.formats.source import Files
from navbake.navgrid.colors import FREE, color_rooms, rgb_of, to_linear
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.lattice import MAX_COORDINATE
from navbake.types import Float, Int, Json, JsonValue

HEIGHT_TOLERANCE = 0.001  # how far a quad may be off the floor, by default [m]
DEFAULT_MAX_SLOPE = 45.0  # for grids that state none [deg]
SLOPE_TOLERANCE = 1e-6  # share by which a slope may exceed the largest one, for rounding
NO_ROOM = "no room"
COMPONENT_TYPES = {np.dtype("<f4"): 5126, np.dtype("<u2"): 5123, np.dtype("<u4"): 5125}
# targets of buffer views
VERTEX_TARGET = 34962
INDEX_TARGET = 34963
UP_AXES = ("y", "z")
OBJ_VERTEX = "v %.10g %.10g %.10g %.3f %.3f %.3f\n"
OBJ_QUAD = "f %d %d %d\nf %d %d %d\n"  # its two triangles


@dataclass(frozen=True, eq=False)
class LevelMesh:
    """The walkable floor of a level: quads of two triangles and four vertices each.

    Attributes:
        name: the level's name.
        origin: the outer corner of the level's cell 0, on its ground, world x, y, z [m].
        vertices: world x, y, z [m], shape (4 n, 3), float64; four for each quad, anticlockwise
            seen from above.
        room: for each quad, the index into `rooms` of its room, shape (n,), int64, ascending; 0 for
            none.
        rooms: the names of the rooms of all quads, each once; entry 0 is "no room".
        indices: for each entry of `rooms`, the room's index on the level, see
            `SceneGrid2D.room_index`.
    """

    name: str
    origin: tuple[float, float, float]
    vertices: Float
    room: Int
    rooms: list[str]
    indices: list[int]

    @property
    def faces(self) -> Int:
        """The triangles: indices into `vertices`, anticlockwise from above, shape (2 n, 3)."""
        first_vertex = 4 * np.arange(len(self.room))[:, None, None]
        faces: Int = (first_vertex + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
        return faces

    @property
    def area(self) -> float:
        """The area seen from above [m²], which is that of the covered cells."""
        quads = self.vertices.reshape(-1, 4, 3)
        return float(np.prod(quads[:, 2, :2] - quads[:, 0, :2], axis=1).sum())


@dataclass(frozen=True, eq=False)
class FloorMesh:
    """The walkable floor of a grid.

    Attributes:
        levels: the mesh of each level, lowest first.
    """

    levels: list[LevelMesh]

    @property
    def vertices(self) -> Float:
        """World x, y, z of all levels [m], shape (n, 3), float64."""
        return np.concatenate([level.vertices for level in self.levels])

    @property
    def faces(self) -> Int:
        """The triangles of all levels, as indices into `vertices`, shape (m, 3), int64."""
        num_vertices_of_level = [len(level.vertices) for level in self.levels]
        first_vertex = np.cumsum([0, *num_vertices_of_level])
        return np.concatenate(
            [
                level.faces + first_vertex[level_number]
                for level_number, level in enumerate(self.levels)
            ]
        )

    @property
    def area(self) -> float:
        """The area seen from above [m²], which is that of the covered cells."""
        return sum(level.area for level in self.levels)


def make_floor_mesh(grid: NavGrid, tolerance: float = HEIGHT_TOLERANCE) -> FloorMesh:
    """Make a mesh of a grid's free cells.

    Each free cell is covered once, unless an area bars all agents from it; the mesh has holes at
    all other cells. A quad covers a rectangle of cells of one room whose floor is a plane within
    the tolerance. The plane is horizontal, or sloped where at least three cells in a line rise
    evenly, up to the grid's `maxSlope` (45 degrees if it states none). So a stair becomes
    horizontal treads, and a ramp a slope. A stair whose treads are all one cell deep becomes a
    slope, too.

    There are no risers. Where two quads meet, their heights differ by the step between the cells'
    floors, plus at most the rise of each quad over half a cell. A free cell without floor height
    lies on the level's ground.

    Args:
        grid: the grid.
        tolerance: by how much the mesh may be off the floor at a cell's centre [m], >= 0.

    Returns:
        The mesh, with a `LevelMesh` for each level.

    Raises:
        QueryError: the tolerance is invalid.
    """
    is_valid_tolerance = (
        isinstance(tolerance, int | float | np.number) and 0 <= tolerance <= MAX_COORDINATE
    )
    if not is_valid_tolerance:
        raise QueryError(
            f"expected a tolerance of 0 m or more, got {tolerance!r}",
            key="tolerance",
            value=tolerance,
            expected="a tolerance of 0 m or more",
        )
    # (level, index) of a room -> its name, or its id if other rooms have that name
    name_counts = Counter(room.name for room in grid.rooms)
    room_names = {
        (room.level, room.index): room.name
        if room.name and name_counts[room.name] == 1
        else room.id
        for room in grid.rooms
    }
    max_slope: JsonValue = grid.navbake.get("maxSlope")
    if type(max_slope) not in (int, float) or not 0 <= max_slope < 90:
        max_slope = DEFAULT_MAX_SLOPE
    max_gradient = math.tan(math.radians(max_slope)) * (1 + SLOPE_TOLERANCE)

    barred_masks = find_closed_cells(grid, stairs="free").barred_masks
    levels = []
    for level_number, level in enumerate(grid.levels):
        lattice = level.lattice
        cell_size = lattice.cell_size
        room_index = level.room_index.astype(np.int32)
        labels = np.where(level.free & ~barred_masks[level_number], room_index + 1, 0)
        quads = cover_with_quads(
            labels, level.floor_or_ground, float(tolerance), max_gradient * cell_size
        )
        room_of_quad = room_index[quads.first_cell[:, 0], quads.first_cell[:, 1]]
        sort_indices = np.argsort(room_of_quad, kind="stable")
        x = lattice.x_min + quads.cols * cell_size
        y = lattice.y_max - quads.rows * cell_size
        vertices = np.stack([x, y, quads.heights], axis=-1)[sort_indices].reshape(-1, 3)
        unique_room_indices, room = np.unique(room_of_quad[sort_indices], return_inverse=True)
        room_indices = [index for index in unique_room_indices.tolist() if index]
        mesh = LevelMesh(
            name=grid.level_names[level_number],
            origin=(lattice.x_min, lattice.y_max, level.ground),
            vertices=vertices,
            # number 0 is "no room", also where all cells are in a room
            room=room.astype(np.int64) + (len(room_indices) == len(unique_room_indices)),
            rooms=[
                NO_ROOM,
                *(
                    room_names.get((level_number, index), f"{level_number}:{index}")
                    for index in room_indices
                ),
            ],
            indices=[0, *room_indices],
        )
        levels.append(mesh)
    return FloorMesh(levels)


class Quads(NamedTuple):
    """Quads that cover cells. Corners run anticlockwise seen from above, from the lower left one.

    Attributes:
        first_cell: row and column of each quad's first cell in reading order, shape (n, 2), int64.
        rows: the row of each corner, 0 at the upper edge of the first row, shape (n, 4), float64.
        cols: the column of each corner, 0 at the left edge, shape (n, 4), float64.
        heights: the height of each corner [m], shape (n, 4), float64.
    """

    first_cell: Int
    rows: Float
    cols: Float
    heights: Float


def cover_with_quads(
    labels: NDArray[np.int32], heights: Float, tolerance: float, max_rise: float, margin: float = 0
) -> Quads:
    """Cover cells by few quads, each of one label and one plane; see `cover_planes`.

    Args:
        labels: the label of each cell, shape (height, width); cells of label 0 stay uncovered.
        heights: the height at each cell's centre, of the same shape [m].
        tolerance: by how much a cell's height may be off its quad [m].
        max_rise: the largest rise of a quad over a cell [m].
        margin: by how much the quads are larger on each side [cells]; negative for smaller ones.

    Returns:
        The quads, in reading order of their first cells.
    """
    from navbake.compiled import ensure_compiled  # numba loads slowly
    from navbake.formats.plane_kernels import cover_planes  # as above

    ensure_compiled("formats.plane_kernels.")
    cell_bounds, planes = cover_planes(labels, heights, tolerance, max_rise)
    first_row, first_col, stop_row, stop_col = cell_bounds.T
    rows = (
        np.stack([stop_row, stop_row, first_row, first_row], axis=1)
        + np.array([1, 1, -1, -1]) * margin
    )
    cols = (
        np.stack([first_col, stop_col, stop_col, first_col], axis=1)
        + np.array([-1, 1, 1, -1]) * margin
    )
    # planes are given at the first cell's centre
    rows_down = rows - first_row[:, None] - 0.5
    cols_right = cols - first_col[:, None] - 0.5
    corner_heights = planes[:, :1] + cols_right * planes[:, 1:2] + rows_down * planes[:, 2:]
    return Quads(cell_bounds[:, :2], rows, cols, corner_heights)


def find_room_colors(grid: NavGrid, mesh: FloorMesh) -> list[NDArray[np.uint8]]:
    """Return the colours of each level's rooms; those of neighbours differ where that is possible.

    Args:
        grid: the grid.
        mesh: the mesh that was made of it.

    Returns:
        For each level, the sRGB colours of `LevelMesh.rooms`, shape (n, 3), uint8.
    """
    level_colors = []
    for level_number, level in enumerate(mesh.levels):
        colors = color_rooms(grid, level_number)[level.indices]
        colors[0] = rgb_of(FREE)
        level_colors.append(colors)
    return level_colors


# ---------------------------------------------------------------- files


class GlbBuffer:
    """Collects the binary data of a GLB file: the buffer, its buffer views and its accessors."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._views: list[Json] = []
        self._accessors: list[Json] = []

    def add_bytes(self, content: bytes, target: int | None = None) -> int:
        """Append bytes.

        Args:
            content: the bytes.
            target: glTF's number of the kind of data, such as `VERTEX_TARGET`; None for an image.

        Returns:
            The number of their buffer view.
        """
        buffer_view = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(content)}
        self._views.append(buffer_view if target is None else {**buffer_view, "target": target})
        self._data += content + bytes(-len(content) % 4)
        return len(self._views) - 1

    def add_indices(self, faces: NDArray[np.uint32]) -> int:
        """Append the vertex indices of triangles.

        Args:
            faces: the indices, uint32, of any shape.

        Returns:
            The number of their accessor.
        """
        return self._add(np.ravel(faces), "SCALAR", INDEX_TARGET)

    def add_vectors(self, values: NDArray[Any], **fields: JsonValue) -> int:
        """Append vectors.

        Args:
            values: the vectors, shape (n, 2 to 4), float32 or uint16.
            fields: further fields of their accessor.

        Returns:
            The number of their accessor.
        """
        return self._add(values, f"VEC{values.shape[1]}", VERTEX_TARGET, **fields)

    def add_positions(self, vertices: NDArray[np.float32]) -> int:
        """Append the positions of vertices, with their bounds, which glTF demands.

        Args:
            vertices: the positions, float32, shape (n, 3), n > 0.

        Returns:
            The number of their accessor.
        """
        lower_corner = vertices.min(axis=0).tolist()
        upper_corner = vertices.max(axis=0).tolist()
        return self.add_vectors(vertices, min=lower_corner, max=upper_corner)

    def _add(self, values: NDArray[Any], vector_type: str, target: int, **fields: JsonValue) -> int:
        """Append values and their accessor; return its number. Types are such as ``VEC3``."""
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        buffer_view = self.add_bytes(values.tobytes(), target)
        component_type = COMPONENT_TYPES[values.dtype]
        accessor = {
            "bufferView": buffer_view,
            "componentType": component_type,
            "count": len(values),
        }
        self._accessors.append({**accessor, "type": vector_type, **fields})
        return len(self._accessors) - 1

    def pack(self, document: Json) -> bytes:
        """Encode a GLB file.

        Args:
            document: the other fields of glTF's JSON; empty ones are left out, because glTF forbids
                them.

        Returns:
            The content of the file.
        """
        asset = {"version": "2.0", "generator": f"navbake {__version__}"}
        content: Json = {
            "asset": asset,
            "scene": 0,
            **document,
            "accessors": self._accessors,
            "bufferViews": self._views,
        }
        if self._data:
            content["buffers"] = [{"byteLength": len(self._data)}]
        text = orjson.dumps({key: value for key, value in content.items() if value not in ([], {})})
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        if self._data:
            chunks += struct.pack("<I4s", len(self._data), b"BIN\0") + self._data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def encode_glb(grid: NavGrid, path: Path, *, tolerance: float = HEIGHT_TOLERANCE) -> Files:
    """Encode a grid's walkable floor as GLB; see `make_floor_mesh` for its quads.

    As glTF demands, y is up, and lengths are in metres: world x, y, z become ``(x, z, -y)``. Each
    level is an object with the level's name; its origin is the outer corner of cell 0 on the
    ground. Each room is a material with the room's name, in the colour that it has in pictures.

    Args:
        grid: the grid.
        path: the path of the file.
        tolerance: by how much the mesh may be off the floor at a cell's centre [m], >= 0.

    Returns:
        The file's content by its path.

    Raises:
        QueryError: the tolerance is invalid.
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
        vertices = np.stack([east, up, 0.0 - north], axis=1).astype(np.float32)
        for room in np.unique(level.room).tolist():
            # quads are sorted by room
            first_quad, stop_quad = np.searchsorted(level.room, [room, room + 1]).tolist()
            room_name = level.rooms[room]
            materials = document["materials"]
            positions_accessor = buffer.add_positions(vertices[4 * first_quad : 4 * stop_quad])
            faces_accessor = buffer.add_indices(
                level.faces[: 2 * (stop_quad - first_quad)].astype(np.uint32)
            )
            primitives.append(
                {
                    "attributes": {"POSITION": positions_accessor},
                    "indices": faces_accessor,
                    "material": len(materials),
                    "extras": {"room": room_name},
                }
            )
            color = [*np.round(to_linear(colors[room] / 255), 6).tolist(), 1.0]
            material = {"baseColorFactor": color, "metallicFactor": 0.0}
            materials.append(
                {"name": room_name, "pbrMetallicRoughness": material, "doubleSided": True}
            )
    return {path: buffer.pack(document)}


def encode_obj(
    grid: NavGrid, path: Path, *, tolerance: float = HEIGHT_TOLERANCE, up: str = "y"
) -> Files:
    """Encode a grid's walkable floor as OBJ; see `make_floor_mesh` for its quads.

    Each level is an object, each of its rooms a group. A vertex has its room's colour after its
    position, an extension that most programs read. Each character of a name that is no letter,
    digit, ``.`` or ``-`` becomes ``_``.

    Args:
        grid: the grid.
        path: the path of the file.
        tolerance: by how much the mesh may be off the floor at a cell's centre [m], >= 0.
        up: the upward axis. ``z`` keeps the world's x, y, z; ``y`` turns them into ``(x, z, -y)``.

    Returns:
        The file's content by its path.

    Raises:
        QueryError: the tolerance or `up` is invalid.
    """
    if up not in UP_AXES:
        raise QueryError(
            f"expected y or z as up, got {up!r}", key="up", value=up, expected="y or z"
        )
    mesh = make_floor_mesh(grid, tolerance)
    lines = [f"# the walkable floor of a navbake grid, in metres, {up} up\n"]
    num_vertices = 0
    used_level_names = set[str]()
    used_room_names = set[str]()
    for level, colors in zip(mesh.levels, find_room_colors(grid, mesh), strict=True):
        lines.append(f"o {_unique_name(level.name, used_level_names)}\n")
        x, y, z = level.vertices.T
        z = np.round(z, 6)  # drops the noise of float32
        positions = np.stack([x, z, 0.0 - y] if up == "y" else [x, y, z], axis=1)
        vertex_colors = colors[np.repeat(level.room, 4)] / 255
        values = np.hstack([positions, vertex_colors]).ravel().tolist()
        lines.append((OBJ_VERTEX * len(positions)) % tuple(values))
        faces = level.faces + num_vertices + 1  # counted from 1 through the file
        for room in np.unique(level.room).tolist():
            room_faces = faces[np.repeat(level.room == room, 2)].ravel().tolist()
            lines.append(f"g {_unique_name(level.rooms[room], used_room_names)}\n")
            lines.append((OBJ_QUAD * (len(room_faces) // 6)) % tuple(room_faces))
        num_vertices += len(positions)
    return {path: "".join(lines).encode()}


def _unique_name(name: str, used_names: set[str]) -> str:
    """Return an unused name of characters that OBJ allows, and add it to the used ones."""
    base_name = re.sub(r"[^\w.\-]", "_", name) or "_"
    unique_name = base_name
    for number in itertools.count(2):
        if unique_name not in used_names:
            break
        unique_name = f"{base_name}_{number}"
    used_names.add(unique_name)
    return unique_name
