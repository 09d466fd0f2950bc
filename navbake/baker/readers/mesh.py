"""Reads mesh files and trimesh scenes as named parts. Only this module imports trimesh.

Files that trimesh would silently misread are checked or repaired first. Plain binary PLY and STL
are read without it, as its import takes longer than they do.
"""

import io
import json
import logging
import os
import re
import struct
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from navbake.baker.geometry.shapes import bounding_box, drop_unused_vertices, triangle_areas
from navbake.config.settings import stem_of
from navbake.errors import SceneError
from navbake.formats.allowance import MAX_BYTES
from navbake.known_names import unique_name
from navbake.lazy import lazy
from navbake.threads import run_in_chunks
from navbake.types import Float, Int32

trimesh = lazy("trimesh")

MESH_SUFFIXES = frozenset({".obj", ".ply", ".stl", ".glb", ".gltf", ".dae"})

AXES = {sign + axis: (np.eye(3)[k] * way).tolist()
        for sign, way in (("", 1.0), ("-", -1.0)) for k, axis in enumerate("xyz")}  # fmt: skip
NO_AREA = 5e-15  # of triangles that are no larger [m²]
MAX_COORDINATE = 1e10  # MuJoCo takes none beyond (its mjMAXVAL) [m]
# How trimesh reads a format
PLAIN: dict[str, Any] = {"skip_materials": True}
OPTIONS = {".glb": PLAIN, ".gltf": PLAIN}
OPTIONS[".obj"] = PLAIN | {"split_objects": True, "split_groups": True, "group_material": False}

Direction: TypeAlias = str | Sequence[float] | Float
"""One of `AXES` by its name, or a vector of any length, in the frame of a file."""


class NamedMesh(NamedTuple):
    """One named piece of a mesh file; faces are counter-clockwise from outside."""

    name: str  # the file's; unique once it is in the world's frame
    vertices: Float
    faces: Int32
    mode: str = "auto"  # as what the file says that `scene.meshes: auto` counts it


def read_named_meshes(path: Path, up: Direction = "z", unit: float = 1.0) -> list[NamedMesh]:
    """Read a mesh file as named parts in the world frame: its objects, groups, solids and nodes.

    A DAE's own ``<unit meter>`` is applied first, then `unit`, then `up`, whatever the file says of
    its vertical axis (see `file_up_axis`). Triangles without area, unused vertices and parts
    without triangles are dropped.
    """
    try:
        found = _read_parts(path)
        scale = unit * (_dae_asset(path)[0] if path.suffix.lower() == ".dae" else 1.0)
    except OSError as error:
        raise SceneError(f"cannot read the mesh {path}: {error.strerror or error}") from error
    return _to_world(found, path, up, scale)


def is_mesh_scene(scene: Any) -> bool:
    """Whether something is a trimesh.Scene or a trimesh.Trimesh; others don't load trimesh."""
    if not any(kind.__module__.partition(".")[0] == "trimesh" for kind in type(scene).__mro__):
        return False
    return isinstance(scene, trimesh.Scene | trimesh.Trimesh)


def join_meshes(parts: Sequence[NamedMesh]) -> tuple[Float, Int32]:
    """The vertices and faces of all parts, as one mesh."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)]).astype(np.int32)
    faces = [part.faces + start for part, start in zip(parts, first, strict=False)]
    return np.concatenate([part.vertices for part in parts]), np.concatenate(faces)


def convert_trimesh(
    scene: Any, path: Path, up: Direction = "z", unit: float = 1.0
) -> list[NamedMesh]:
    """Take a trimesh.Scene or trimesh.Trimesh, which stays as it is, as `read_named_meshes` a file.

    Parts are named by the scene graph's nodes, or by the stem of the path, which errors name.
    """
    with _silence():
        whole = scene if isinstance(scene, trimesh.Scene) else trimesh.Scene(scene)
        try:
            found = _parts_of(whole)
        except (ValueError, TypeError, KeyError, IndexError) as error:
            reason = " ".join(str(error).split())[:200]
            raise SceneError(f"cannot take the meshes of {path}: {reason}") from error
    # kernels are compiled for arrays that can be written, and the caller may change these later
    own = [NamedMesh(name, vertices.copy(), faces.copy()) for name, vertices, faces, _ in found]
    return _to_world(own, path, up, unit)


def bounds_of_meshes(parts: Collection[NamedMesh]) -> Float:
    """The lower and the upper corner of the box round parts, shape (2, 3) [m]."""
    boxes = np.array([bounding_box(part.vertices) for part in parts])
    return np.stack([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])


def _read_parts(path: Path) -> list[NamedMesh]:
    """A part for each node of the file that carries a mesh, in the file's frame and unit."""
    suffix = path.suffix.lower()
    if path.stat().st_size > MAX_BYTES:
        raise SceneError(f"{path} is too large: expected a mesh of {MAX_BYTES >> 20} MiB at most")
    if suffix in (".glb", ".gltf"):
        check_gltf(path)
    if (plain := read_plain(path)) is not None:
        return [NamedMesh("", *plain)]
    data = PREPARE[suffix](path) if suffix in PREPARE else b""
    source: Any = io.BytesIO(data) if suffix in PREPARE else path
    options = {"file_type": suffix[1:], "process": False, **OPTIONS.get(suffix, {})}
    try:
        with _silence():
            parts = _parts_of(trimesh.load_scene(source, **options))
    except Exception as error:  # trimesh passes on whatever its parsers raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        text = f"cannot read the mesh {path}, it is broken or cut off: {reason}"
        raise SceneError(text) from error
    if suffix == ".ply":  # of one that is cut off, trimesh finds fewer than its header says
        header = data[:MOST_HEADER].partition(b"end_header")[0]
        for name, field in ((b"vertex", "vertices"), (b"face", "faces")):
            count = sum(len(getattr(part, field)) for part in parts)
            said = re.search(rb"element %s (\d+)" % name, header)
            if said and int(said[1]) > count:
                expected = f"expected {int(said[1])} {name.decode()} elements"
                raise SceneError(f"{path} is cut off: {expected}, got {count}")
    return parts


def _parts_of(loaded: Any) -> list[NamedMesh]:
    """The nodes' meshes in the file's frame, without lines and points, which have no surface."""
    parts = []
    for node in loaded.graph.nodes_geometry:
        matrix, geometry_name = loaded.graph[node]
        geometry = loaded.geometry[geometry_name]
        if not isinstance(geometry, trimesh.Trimesh):
            continue
        faces = np.asarray(geometry.faces, dtype=np.int64)
        vertices = np.asarray(geometry.vertices, dtype=np.float64)
        if faces.shape[1:] != (3,) or vertices.shape[1:] != (3,):
            raise ValueError(f"{geometry_name!r} has no vertices of three coordinates or triangles")
        if len(faces) and not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
            raise ValueError(f"a face of {geometry_name!r} has vertices that are not there")
        turn, shift = np.split(np.asarray(matrix, dtype=np.float64)[:3], [3], axis=1)
        way = -1 if np.linalg.det(turn) < 0 else 1  # a mirror turns every triangle over
        corners = np.ascontiguousarray(faces[:, ::way], dtype=np.int32)
        name = str(node)
        if geometry.metadata.get("from_gltf_primitive"):  # trimesh makes such names up at random
            name = str(loaded.graph.transforms.parents.get(node, geometry_name))
        parts.append(NamedMesh(name, _turn(vertices, turn) + shift[:, 0], corners))
    return parts


def _turn(vertices: Float, matrix: Float) -> Float:
    """Vertices times a matrix; those of most files stay as they are."""
    return vertices if (matrix == np.eye(3)).all() else vertices @ matrix.T


@contextmanager
def _silence() -> Iterator[None]:
    """Keep trimesh's log and warnings off stderr: what matters is raised."""
    logger = logging.getLogger("trimesh")  # its modules' loggers take their level from it
    before = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(before)


def file_up_axis(path: Path) -> str | None:
    """The axis that is up in a mesh file: y by glTF's specification, a DAE's own, else None."""
    suffix = path.suffix.lower()
    if suffix == ".dae" and path.is_file():
        with suppress(ElementTree.ParseError):  # whoever reads the mesh says what is wrong
            return _dae_asset(path)[1]
    return "y" if suffix in (".glb", ".gltf") else None


def rotation_to_z_up(up: Direction) -> Float:
    """The rotation that turns a direction to +z by the least angle, exact for axes, (3, 3)."""
    vector = AXES[up] if isinstance(up, str) else up
    x, y, z = np.divide(vector, np.linalg.norm(vector)).tolist()
    if z < -0.5:  # over the opposite direction, as near that no axis is the best
        return np.asarray(rotation_to_z_up((x, -y, -z)) @ np.diag([1.0, -1.0, -1.0]) + 0.0)
    across = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])  # Rodrigues' formula
    return np.asarray(np.eye(3) + across + across @ across / (1.0 + z) + 0.0)


def _dae_asset(path: Path) -> tuple[float, str | None]:
    """Metres per unit of a DAE, 1 if it states none; and its axis that is up, or None."""
    meters = 1.0
    up = None
    for event, element in ElementTree.iterparse(path, events=("start", "end")):
        tag = element.tag.rpartition("}")[2]
        if event == "start" and tag == "unit":
            meter = element.get("meter", "1")
            meters = 0.0
            with suppress(ValueError):
                meters = float(meter)
            if not 0 < meters < float("inf"):
                raise SceneError(f"expected a number > 0 as <unit meter> in {path}, got {meter!r}")
        if event == "end" and tag == "up_axis":
            axis = (element.text or "").strip()[:1].lower()
            up = axis if axis in AXES else None
        if event == "end" and tag == "asset":
            break
    return meters, up


def _to_world(found: list[NamedMesh], path: Path, up: Direction, scale: float) -> list[NamedMesh]:
    """Turn parts into the world frame, with unique names."""
    turn = scale * rotation_to_z_up(up)
    taken = {"world"}  # MuJoCo's own body
    parts = []
    for part in found:
        name = "".join(char if char.isprintable() else "_" for char in part.name)
        if re.fullmatch(r"geometry(_\d+)?", name):  # trimesh made it up
            name = stem_of(path)
        name = name.removeprefix(path.name).removeprefix("_") or stem_of(path)
        vertices, faces = drop_unused_vertices(part.vertices, part.faces)
        with np.errstate(all="ignore"):
            vertices = _turn(vertices, turn)
        part = check_mesh(NamedMesh(name, vertices, faces), path)
        if len(part.faces):
            parts.append(part._replace(name=unique_name(name, taken)))
    if not parts:
        raise SceneError(f"no triangles in {path}: expected a mesh with at least one")
    return parts


def check_mesh(part: NamedMesh, path: Path) -> NamedMesh:
    """Refuse coordinates that are no places; leave out triangles without area."""
    name, vertices, faces, mode = part
    box = bounding_box(vertices) if len(vertices) else np.zeros(6)
    if not np.isfinite(box).all():
        raise SceneError(f"mesh {name!r} in {path} has coordinates that are no numbers")
    if np.abs(box).max() > MAX_COORDINATE:
        beyond = f"reaches beyond {MAX_COORDINATE:g} m: check `scene.unit`"
        raise SceneError(f"mesh {name!r} in {path} {beyond}")
    has_area = triangle_areas(vertices, faces) > NO_AREA
    used = (vertices, faces) if has_area.all() else drop_unused_vertices(vertices, faces[has_area])
    return NamedMesh(name, *used, mode)


# ---------------------------------------------------------------- files

# [bytes]
STL_HEADER = 84
STL_TRIANGLE = 50
MOST_HEADER = 1 << 20  # of a PLY; what counts stands before that [bytes]
LEAST_READ = 1 << 16  # vertices or triangles of a plain file that a thread reads at once


def prepare_obj(path: Path) -> bytes:
    """An OBJ's text as trimesh reads it rightly: UTF-8, no indents, absolute indices."""
    text = _as_utf8(path.read_bytes()).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    text = text.replace(b"\\\n", b" ")
    if re.search(rb"(?m)^(?:[ \t]+[vf]|[vf]\t)", text):
        text = b"\n".join(b" ".join(line.split()) for line in text.split(b"\n"))
    if not re.search(rb"(?m)^f(?=.*(?:#| -| 0+(?:[/ ]|$)))", text):
        return text
    lines = text.split(b"\n")
    num_vertices = 0
    for number, line in enumerate(lines):
        num_vertices += line.startswith(b"v ")
        if line.startswith(b"f "):
            # references to vertices, counted from 1; textures and normals don't matter here
            words = [word.partition(b"/")[0] for word in line.partition(b"#")[0].split()[1:]]
            indices = [int(word) if re.fullmatch(rb"[-+]?\d{1,18}", word) else 0 for word in words]
            indices = [index + (index < 0) * (num_vertices + 1) for index in indices]
            if min(indices, default=1) <= 0:
                wanted = "expected numbers of vertices, counted from 1"
                raise SceneError(f"{wanted}, in line {number + 1} of {path}")
            lines[number] = b"f " + " ".join(map(str, indices)).encode()
    return b"\n".join(lines)


def prepare_stl(path: Path) -> bytes:
    """An STL's bytes; refuses one that is cut off, or neither text nor binary."""
    data = path.read_bytes()
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in (words := data.lower()):
        starts = re.findall(b"(?m)^\\s*%ssolid" % b"", words)
        ends = re.findall(b"(?m)^\\s*%ssolid" % b"end", words)
        if len(ends) < len(starts):
            raise SceneError(f"{path} is cut off: its last solid has no end")
        return _as_utf8(data)
    count = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    size = STL_HEADER + STL_TRIANGLE * count
    if len(data) < max(size, STL_HEADER):
        wanted = f"expected {size} bytes for the {count} triangles of its header"
        raise SceneError(f"{path} is cut off or no STL: {wanted}, got {len(data)}")
    return data[:size]  # trimesh takes no more, some writers append something


def prepare_ply(path: Path) -> bytes:
    """A PLY's bytes, as UTF-8 if it is text."""
    data = path.read_bytes()
    return _as_utf8(data) if b"format ascii" in data[:200] else data


def _as_utf8(data: bytes) -> bytes:
    """Text that decodes; trimesh needs another package to guess at other encodings."""
    return data.decode("utf-8-sig", errors="replace").encode()


PLY_FORMATS = {b"binary_little_endian": "<", b"binary_big_endian": ">"}
PLY_TYPES = {b"uchar": "u1", b"uint8": "u1", b"int": "i4", b"int32": "i4", b"uint": "u4"}
PLY_TYPES |= {b"uint32": "u4", b"float": "f4", b"float32": "f4", b"double": "f8", b"float64": "f8"}
PLY_COORDINATES = {b"x", b"y", b"z"}
# What a plain vertex may have; one with texture coordinates may belong to several vertices
PLY_VERTEX = PLY_COORDINATES | {b"nx", b"ny", b"nz", b"red", b"green", b"blue", b"alpha"}
PLY_HEADER = re.compile(
    rb"ply\nformat (?P<format>\w+) 1\.0\n(?:comment [^\n]*\n)*"
    rb"element vertex (?P<vertices>\d{1,10})\n(?P<properties>(?:property \w+ \w+\n)+)"
    rb"element face (?P<faces>\d{1,10})\n"
    rb"property list (?P<count>\w+) (?P<index>\w+) vertex_ind\w+\nend_header\n"
)


def read_plain(path: Path) -> tuple[Float, Int32] | None:
    """The vertices and triangles of a binary PLY or STL that holds nothing but these, else None.

    Each thread reads and converts ranges of them.
    """
    if path.suffix.lower() == ".ply":
        return _read_plain_ply(path)
    if path.suffix.lower() != ".stl":
        return None
    with path.open("rb") as file:
        header = file.read(STL_HEADER)
    count = int.from_bytes(header[STL_HEADER - 4 :], "little")
    is_text = header.lstrip()[:5].lower() in (b"solid", b"")
    if is_text or not count or path.stat().st_size < STL_HEADER + STL_TRIANGLE * count:
        return None
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    vertices = np.empty((3 * count, 3))

    def read(first: int, end: int) -> None:
        some = np.fromfile(path, facet, end - first, offset=STL_HEADER + first * STL_TRIANGLE)
        _to_float64(list(some["corners"].reshape(-1, 3).T), vertices[3 * first : 3 * end])

    run_in_chunks(read, count, least=LEAST_READ)
    return vertices, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def _read_plain_ply(path: Path) -> tuple[Float, Int32] | None:
    with path.open("rb") as file:
        header = PLY_HEADER.match(file.read(MOST_HEADER))
    if header is None or header["format"] not in PLY_FORMATS:
        return None
    order = PLY_FORMATS[header["format"]]
    named = [line.split()[1:] for line in header["properties"].splitlines()]
    names = {name for _, name in named}
    kinds = {*(kind for kind, _ in named), header["count"], header["index"]}
    is_known = len(names) == len(named) and PLY_COORDINATES <= names <= PLY_VERTEX
    if not is_known or not kinds <= PLY_TYPES.keys():
        return None
    vertex = np.dtype([(name.decode(), order + PLY_TYPES[kind]) for kind, name in named])
    count = order + PLY_TYPES[header["count"]]
    index = order + PLY_TYPES[header["index"]]
    face = np.dtype([("count", count), ("index", index, 3)])
    num_vertices = int(header["vertices"])
    num_faces = int(header["faces"])
    middle = header.end() + num_vertices * vertex.itemsize
    size = middle + num_faces * face.itemsize
    if not num_vertices or not num_faces or path.stat().st_size != size:
        return None
    vertices = np.empty((num_vertices, 3))
    faces = np.empty((num_faces, 3), dtype=np.int32)
    is_odd = np.zeros(num_faces, dtype=np.bool_)

    def read_vertices(first: int, end: int) -> None:
        offset = header.end() + first * vertex.itemsize
        some = np.fromfile(path, vertex, end - first, offset=offset)
        _to_float64([some[axis] for axis in "xyz"], vertices[first:end])

    def read_faces(first: int, end: int) -> None:
        some = np.fromfile(path, face, end - first, offset=middle + first * face.itemsize)
        faces[first:end] = some["index"]  # one too large for that is negative
        # the number of a polygon's corners stands before each; it has to be three for all
        np.not_equal(some["count"], 3, out=is_odd[first:end])
        low = faces[first:end].min()
        high = faces[first:end].max()
        is_odd[first] |= low < 0 or high >= num_vertices

    run_in_chunks(read_vertices, num_vertices, least=LEAST_READ)
    run_in_chunks(read_faces, num_faces, least=LEAST_READ)
    return None if is_odd.any() else (vertices, faces)


def _to_float64(axes: Sequence[NDArray[np.floating]], out: Float) -> None:
    with np.errstate(invalid="ignore"):  # of NaNs that signal; all NaNs are refused later
        for k, axis in enumerate(axes):
            np.add(axis, 0.0, out=out[:, k], dtype=np.float64)  # no -0.0


JSON_CHUNK = 0x4E4F534A
TRIANGLE_FAN = 6
MESHOPT = "`gltfpack -i FILE -o unpacked.glb -noq` unpacks it (npm has gltfpack)"
UNREAD = {
    "EXT_mesh_gpu_instancing": "export its copies as nodes",
    "EXT_meshopt_compression": MESHOPT,
    "KHR_meshopt_compression": MESHOPT,
}
DRACO = "KHR_draco_mesh_compression"  # which trimesh reads by DracoPy


def check_gltf(path: Path) -> None:
    """Refuse a glTF or GLB file that is cut off, or that trimesh would read as something else."""
    try:
        data = path.read_bytes()
        text = data
        if path.suffix.lower() == ".glb":
            if len(data) < 20 or not data.startswith(b"glTF"):
                raise ValueError("it has no GLB header")
            version, length, json_length, kind = struct.unpack_from("<4I", data, 4)
            if version != 2:
                raise ValueError(f"expected version 2, got {version}")
            if length > len(data):
                raise ValueError(f"it is cut off: expected {length} bytes, got {len(data)}")
            if kind != JSON_CHUNK or 20 + json_length > len(data):
                raise ValueError("its first chunk is no JSON")
            text = data[20 : 20 + json_length]
        header = json.loads(text)
        if not isinstance(header, dict):
            raise ValueError("its JSON is no object")
        problem = next(_find_problems(header, len(data), path.parent), "")
    except (ValueError, RecursionError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise SceneError(f"broken glTF {path}: {' '.join(str(error).split())[:200]}") from error
    if problem:
        raise SceneError(f"cannot read {path}: {problem}")


def _find_problems(header: dict[str, Any], size: int, folder: Path) -> Iterator[str]:
    used = (name for name in header.get("extensionsUsed", []) if name in UNREAD)
    yield from (f"it uses {name}: {UNREAD[name]}" for name in used)
    if DRACO in header.get("extensionsUsed", []) and find_spec("DracoPy") is None:
        yield f'it uses {DRACO}: `pip install "navbake[draco]"` reads it'
    accessors = header.get("accessors", [])
    for accessor in accessors:
        if "bufferView" not in accessor and accessor["count"] > max(size, 10_000_000):
            raise ValueError(f"it claims {accessor['count']} numbers without data")
    for primitive in (each for mesh in header.get("meshes", []) for each in mesh["primitives"]):
        if primitive.get("mode") == TRIANGLE_FAN:
            yield "it has triangle fans: export them as triangles"
        indices = primitive["attributes"].get("POSITION"), primitive.get("indices")
        for accessor in (accessors[index] for index in indices if index is not None):
            if "sparse" in accessor:
                yield "it has sparse accessors: export them as plain ones"
            if accessor.get("normalized"):
                yield "its positions are normalized integers: export it unquantized"
    for uri in (buffer.get("uri") for buffer in header.get("buffers", [])):
        if uri is None or uri.startswith("data:"):
            continue
        if ".." in Path(unquote(uri)).parts:
            yield f"its buffer {uri[:80]!r} lies outside of its folder: put it beside it"
            continue
        there = [folder / name for name in {uri, uri.strip(), unquote(uri)}]
        there = [file for file in there if os.path.exists(file)]
        if not there:
            yield f"its buffer {uri[:80]!r} is missing"
        # a device would never end
        if not all(os.path.isfile(file) and file.stat().st_size <= MAX_BYTES for file in there):
            yield f"its buffer {uri[:80]!r} is no file of {MAX_BYTES >> 20} MiB at most"


PREPARE = {".obj": prepare_obj, ".stl": prepare_stl, ".ply": prepare_ply}
