"""Reads mesh files and trimesh scenes as named meshes. Only this module imports trimesh.

Files that trimesh would silently misread are checked or repaired first. Plain binary PLY and STL
files are read without trimesh, because importing it takes longer than reading them.
"""

from __future__ import annotations

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
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeGuard
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from navbake.baker.geometry.shapes import bounding_box, drop_unused_vertices, triangle_areas
from navbake.config.settings import find_scene_stem
from navbake.errors import SceneError
from navbake.formats.allowance import MAX_BYTES
from navbake.known_names import list_first, unique_name
from navbake.lazy import lazy
from navbake.threads import run_in_chunks
from navbake.types import Float, Int32, Json

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy("trimesh")


# Axis name -> unit vector, for x, y, z, -x, -y and -z
AXIS_VECTORS: dict[str, list[float]] = dict(zip("xyz", np.eye(3).tolist(), strict=True))
AXIS_VECTORS |= dict(zip(("-x", "-y", "-z"), (np.eye(3) * -1.0).tolist(), strict=True))
MIN_TRIANGLE_AREA = 5e-15  # triangles up to this area are dropped [m²]
MAX_COORDINATE = 1e10  # MuJoCo refuses larger ones (its mjMAXVAL) [m]
# File suffix -> options of trimesh.load_scene
TRIMESH_OPTIONS: dict[str, dict[str, object]] = {
    ".glb": {"skip_materials": True},
    ".gltf": {"skip_materials": True},
    ".obj": {
        "skip_materials": True,
        "split_objects": True,
        "split_groups": True,
        "group_material": False,
    },
}

Direction: TypeAlias = str | Sequence[float] | Float
"""A direction in the frame of a file: a name of `AXIS_VECTORS`, or a vector of any length."""


class NamedMesh(NamedTuple):
    """A mesh with a name: an object, a group, a solid or a node of a file.

    Attributes:
        name: the name in the file; it may be changed to be unique when meshes are moved to the
            world frame.
        vertices: shape (n, 3).
        faces: indices of vertices, counter-clockwise from outside, shape (m, 3).
        mode: how the mesh counts with `scene.meshes: auto`: ``surface`` or ``hull`` if the file
            says so, else ``auto``.
    """

    name: str
    vertices: Float
    faces: Int32
    mode: str = "auto"


class Triangles(NamedTuple):
    """Triangles of a file.

    Attributes:
        vertices: shape (n, 3).
        faces: indices of vertices, counter-clockwise from outside, shape (m, 3).
    """

    vertices: Float
    faces: Int32


class StrayMeshError(SceneError):
    """A mesh of a file lies farther from the origin than `MAX_COORDINATE`.

    A reader may leave such a mesh out, as exporters leave stray objects behind.
    """


def read_named_meshes(
    path: Path, up: Direction = "z", unit: float = 1.0, warnings: list[str] | None = None
) -> list[NamedMesh]:
    """Read the objects, groups, solids or nodes of a mesh file as meshes in the world frame.

    Coordinates are multiplied by a DAE's own ``<unit meter>`` and by `unit`, then rotated so that
    `up` is +z. The up axis that the file states is ignored (`read_up_axis` returns it). Triangles
    without area, unused vertices and meshes without triangles are dropped.

    Exporters leave stray nodes behind: with `warnings`, a mesh beyond `MAX_COORDINATE` is left out
    if others of the file are not.

    Args:
        path: the file.
        up: the direction in the file that is up.
        unit: length of one unit of the file [m].
        warnings: the list to which a warning of stray meshes is added; None if they are an error.

    Returns:
        The meshes, in metres; at least one.

    Raises:
        StrayMeshError: a mesh lies beyond `MAX_COORDINATE`; with `warnings`, all of them do.
        SceneError: the file is missing or broken, or has no triangles.
    """
    try:
        meshes = _read_file(path)
        meters_per_unit = unit
        if path.suffix.lower() == ".dae":
            meters_per_unit = unit * _read_dae_asset(path).meters_per_unit
    except OSError as error:
        raise SceneError(f"cannot read the mesh {path}: {error.strerror or error}") from error
    return _to_world(meshes, path, up, meters_per_unit, warnings)


def is_mesh_scene(scene: object) -> TypeGuard[trimesh.Scene | trimesh.Trimesh]:
    """Return whether an object is a trimesh.Scene or a trimesh.Trimesh.

    If its class is not from trimesh, trimesh is not imported, which takes long.
    """
    if not any(
        base_class.__module__.partition(".")[0] == "trimesh" for base_class in type(scene).__mro__
    ):
        return False
    return isinstance(scene, trimesh.Scene | trimesh.Trimesh)


def join_meshes(meshes: Sequence[NamedMesh]) -> Triangles:
    """Join the triangles of several meshes; their names and modes are dropped."""
    first_vertices = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)]).astype(np.int32)
    faces = [
        mesh.faces + first_vertex
        for mesh, first_vertex in zip(meshes, first_vertices, strict=False)
    ]
    return Triangles(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def convert_trimesh(
    scene: trimesh.Scene | trimesh.Trimesh, path: Path, up: Direction = "z", unit: float = 1.0
) -> list[NamedMesh]:
    """Convert a trimesh.Scene or trimesh.Trimesh to meshes in the world frame.

    Args:
        scene: the scene or mesh, which is not changed.
        path: a path for errors; its stem is the name of meshes whose nodes have no names.
        up: the direction in the scene that is up.
        unit: length of one unit of the scene [m].

    Returns:
        The meshes, in metres; at least one.

    Raises:
        SceneError: the scene is broken, or has no triangles.
    """
    with _silence_trimesh():
        if not isinstance(scene, trimesh.Scene):
            scene = trimesh.Scene(scene)
        try:
            meshes = _read_node_meshes(scene)
        except (ValueError, TypeError, KeyError, IndexError) as error:
            reason = " ".join(str(error).split())[:200]
            raise SceneError(f"cannot take the meshes of {path}: {reason}") from error
    # Copied because kernels are compiled for writable arrays, and the caller may change these.
    copied_meshes = [
        NamedMesh(mesh.name, mesh.vertices.copy(), mesh.faces.copy()) for mesh in meshes
    ]
    return _to_world(copied_meshes, path, up, unit)


def measure_mesh_bounds(meshes: Collection[NamedMesh]) -> Float:
    """Return the lowest and the highest corner of the box of all meshes, shape (2, 3) [m]."""
    boxes = np.array([bounding_box(mesh.vertices) for mesh in meshes])
    return np.stack([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])


def _read_file(path: Path) -> list[NamedMesh]:
    """Read the mesh of each node of a file, in the file's frame and unit."""
    suffix = path.suffix.lower()
    if path.stat().st_size > MAX_BYTES:
        raise SceneError(f"{path} is too large: expected a mesh of {MAX_BYTES >> 20} MiB at most")
    header: Json | None = None
    if suffix in (".glb", ".gltf"):
        header = check_gltf(path)
    triangles = read_plain_file(path)
    if triangles is not None:
        return [NamedMesh("", triangles.vertices, triangles.faces)]
    file_content = b""
    trimesh_source: io.BytesIO | Path = path
    if suffix in REPAIR_FUNCTIONS:
        file_content = REPAIR_FUNCTIONS[suffix](path)
        trimesh_source = io.BytesIO(file_content)
        if _has_only_points(file_content, suffix):
            raise _make_points_error(path)
    elif header is not None and scale_normalized_positions(header):
        trimesh_source = io.BytesIO(_replace_gltf_header(path, header))
    options: dict[str, Any] = {
        "file_type": suffix[1:],
        "process": False,
        **TRIMESH_OPTIONS.get(suffix, {}),
    }
    if suffix == ".gltf":
        options["resolver"] = trimesh.resolvers.FilePathResolver(str(path))  # of its buffers
    try:
        with _silence_trimesh():
            scene = trimesh.load_scene(trimesh_source, **options)
            meshes = _read_node_meshes(scene)
    except Exception as error:  # trimesh passes on whatever its parsers raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        error_text = f"cannot read the mesh {path}, it is broken or cut off: {reason}"
        raise SceneError(error_text) from error
    if suffix == ".ply":
        _check_ply_counts(file_content, meshes, path)
    has_points = any(
        isinstance(geometry, trimesh.PointCloud) for geometry in scene.geometry.values()
    )
    if has_points and not any(len(mesh.faces) for mesh in meshes):
        raise _make_points_error(path)
    return meshes


def _has_only_points(content: bytes, suffix: str) -> bool:
    """Return whether a PLY or an OBJ has vertices, but no faces.

    Args:
        content: the content of the file.
        suffix: the file's suffix; other files than ``.ply`` and ``.obj`` are not looked at.
    """
    if suffix == ".ply":
        header, end_marker, _ = content[:MAX_PLY_HEADER_SIZE].partition(b"end_header")
        element_counts = {
            element: int(count)
            for element, count in re.findall(rb"(?m)^element (\w+)[ \t]+(\d{1,18})", header)
        }
        num_faces = element_counts.get(b"face", 0) + element_counts.get(b"tristrips", 0)
        return bool(end_marker) and element_counts.get(b"vertex", 0) > 0 and num_faces == 0
    if suffix == ".obj":
        has_vertices = re.search(rb"^[ \t]*v[ \t]", content, re.MULTILINE) is not None
        has_faces = re.search(rb"^[ \t]*(?:f|fo|surf)[ \t]", content, re.MULTILINE) is not None
        return has_vertices and not has_faces
    return False


def _make_points_error(path: Path) -> SceneError:
    """Return the error for a file that is a cloud of points."""
    return SceneError(
        f"{path} holds points without triangles: make a mesh of them first, for example with "
        f"MeshLab or `pip install pymeshlab` (screened Poisson), see docs/scans.md"
    )


def _check_ply_counts(content: bytes, meshes: list[NamedMesh], path: Path) -> None:
    """Raise a SceneError if a PLY is cut off: trimesh found fewer elements than its header says."""
    header = content[:MAX_PLY_HEADER_SIZE].partition(b"end_header")[0]
    element_counts = {
        "vertex": sum(len(mesh.vertices) for mesh in meshes),
        "face": sum(len(mesh.faces) for mesh in meshes),
    }
    for element, num_elements in element_counts.items():
        declared_count = re.search(rb"element %s (\d{1,18})" % element.encode(), header)
        if declared_count and int(declared_count[1]) > num_elements:
            expected_text = f"expected {int(declared_count[1])} {element} elements"
            raise SceneError(f"{path} is cut off: {expected_text}, got {num_elements}")


def _read_node_meshes(scene: trimesh.Scene) -> list[NamedMesh]:
    """Return the nodes' meshes in the file's frame. Lines and points are left out."""
    meshes = []
    for node in scene.graph.nodes_geometry:
        transform, geometry_name = scene.graph[node]
        geometry = scene.geometry[geometry_name]
        if not isinstance(geometry, trimesh.Trimesh):
            continue
        faces = np.asarray(geometry.faces, dtype=np.int64)
        vertices = np.asarray(geometry.vertices, dtype=np.float64)
        if faces.shape[1:] != (3,) or vertices.shape[1:] != (3,):
            raise ValueError(f"{geometry_name!r} has no vertices of three coordinates or triangles")
        if len(faces) and not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
            raise ValueError(f"a face of {geometry_name!r} has vertices that are not there")
        transform = np.asarray(transform, dtype=np.float64)
        linear_part = transform[:3, :3]
        translation = transform[:3, 3]
        if np.linalg.det(linear_part) < 0:  # a mirror image reverses the order of corners
            faces = faces[:, ::-1]
        name = str(node)
        if geometry.metadata.get("from_gltf_primitive"):  # trimesh makes such names up at random
            name = str(scene.graph.transforms.parents.get(node, geometry_name))
        meshes.append(
            NamedMesh(
                name=name,
                vertices=_transform(vertices, linear_part) + translation,
                faces=np.ascontiguousarray(faces, dtype=np.int32),
            )
        )
    return meshes


def _transform(vertices: Float, matrix: Float) -> Float:
    """Multiply vertices by a matrix, (3, 3); for the identity, return the same array."""
    return vertices if (matrix == np.eye(3)).all() else vertices @ matrix.T


@contextmanager
def _silence_trimesh() -> Iterator[None]:
    """Keep trimesh's log and warnings off stderr; its errors are still raised."""
    logger = logging.getLogger("trimesh")  # its modules' loggers take their level from it
    old_level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(old_level)


def read_up_axis(path: Path) -> str | None:
    """Return the name of the axis that is up in a mesh file: y for glTF, the stated one for a DAE.

    Returns:
        A name of `AXIS_VECTORS`; None if the file states none.
    """
    suffix = path.suffix.lower()
    if suffix == ".dae" and path.is_file():
        with suppress(ElementTree.ParseError):  # reading the mesh will say what is wrong
            return _read_dae_asset(path).up_axis
    return "y" if suffix in (".glb", ".gltf") else None


def make_rotation_to_z_up(up: Direction) -> Float:
    """Return the smallest rotation that turns a direction to +z, shape (3, 3).

    For the directions of `AXIS_VECTORS`, its entries are exactly -1, 0 or 1.

    Source: Rodrigues' formula for the rotation between two unit vectors.
    """
    vector = AXIS_VECTORS[up] if isinstance(up, str) else up
    x, y, z = np.divide(vector, np.linalg.norm(vector)).tolist()
    if z < -0.5:
        # Near -z the formula loses digits: first turn by 180° about x.
        rotation = make_rotation_to_z_up((x, -y, -z)) @ np.diag([1.0, -1.0, -1.0])
        return np.asarray(rotation + 0.0)
    cross_matrix = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + cross_matrix + cross_matrix @ cross_matrix / (1.0 + z) + 0.0)


class DaeAsset(NamedTuple):
    """The unit and the up axis that a DAE states.

    Attributes:
        meters_per_unit: the length of one unit [m]; 1 if the file states none.
        up_axis: a name of `AXIS_VECTORS`; None if the file states none.
    """

    meters_per_unit: float
    up_axis: str | None


def _read_dae_asset(path: Path) -> DaeAsset:
    meters_per_unit = 1.0
    up_axis = None
    for event, element in ElementTree.iterparse(path, events=("start", "end")):
        tag = element.tag.rpartition("}")[2]
        if event == "start" and tag == "unit":
            meter_text = element.get("meter", "1")
            meters_per_unit = 0.0
            with suppress(ValueError):
                meters_per_unit = float(meter_text)
            if not 0 < meters_per_unit < float("inf"):
                raise SceneError(
                    f"expected a number > 0 as <unit meter> in {path}, got {meter_text!r}"
                )
        if event == "end" and tag == "up_axis":
            axis = (element.text or "").strip()[:1].lower()
            up_axis = axis if axis in AXIS_VECTORS else None
        if event == "end" and tag == "asset":
            break
    return DaeAsset(meters_per_unit, up_axis)


def _to_world(
    meshes: list[NamedMesh],
    path: Path,
    up: Direction,
    meters_per_unit: float,
    warnings: list[str] | None = None,
) -> list[NamedMesh]:
    """Transform meshes to the world frame, with unique names; see `read_named_meshes`."""
    stray_meshes = list[NamedMesh]()
    matrix = meters_per_unit * make_rotation_to_z_up(up)
    used_names = {"world"}  # MuJoCo's own body
    world_meshes = []
    for mesh in meshes:
        name = "".join(char if char.isprintable() else "_" for char in mesh.name)
        if re.fullmatch(r"geometry(_\d+)?", name):  # trimesh made it up
            name = find_scene_stem(path)
        name = name.removeprefix(path.name).removeprefix("_") or find_scene_stem(path)
        vertices, faces = drop_unused_vertices(mesh.vertices, mesh.faces)
        with np.errstate(all="ignore"):
            vertices = _transform(vertices, matrix)
        world_mesh = NamedMesh(name, vertices, faces)
        if warnings is not None and is_beyond_limit(vertices):
            stray_meshes.append(world_mesh)
            continue
        checked_mesh = check_mesh(world_mesh, path)
        if len(checked_mesh.faces):
            world_meshes.append(checked_mesh._replace(name=unique_name(name, used_names)))
    if stray_meshes and not world_meshes:
        check_mesh(stray_meshes[0], path)
    if stray_meshes and warnings is not None:
        names_text = list_first([repr(mesh.name) for mesh in stray_meshes])
        warning = f"mesh {names_text} of {path} left out: it lies beyond {MAX_COORDINATE:g} m"
        if warning not in warnings:
            warnings.append(warning)
    if not world_meshes:
        raise SceneError(f"no triangles in {path}: expected a mesh with at least one")
    return world_meshes


def is_beyond_limit(vertices: Float) -> bool:
    """Return whether a mesh lies beyond `MAX_COORDINATE` with at least one of its vertices.

    Args:
        vertices: shape (n, 3) [m]. If a coordinate is not finite, False is returned.
    """
    if not len(vertices):
        return False
    box = bounding_box(vertices)
    return bool(np.isfinite(box).all() and np.abs(box).max() > MAX_COORDINATE)


def check_mesh(mesh: NamedMesh, path: Path) -> NamedMesh:
    """Check the coordinates of a mesh, and drop its triangles without area.

    Args:
        mesh: in the world frame [m].
        path: the scene's path, for errors.

    Returns:
        The mesh; it may have no triangles.

    Raises:
        StrayMeshError: a coordinate is beyond `MAX_COORDINATE`.
        SceneError: a coordinate is not finite.
    """
    box = bounding_box(mesh.vertices) if len(mesh.vertices) else np.zeros(6)
    if not np.isfinite(box).all():
        raise SceneError(f"mesh {mesh.name!r} in {path} has coordinates that are no numbers")
    if np.abs(box).max() > MAX_COORDINATE:
        problem_text = f"reaches beyond {MAX_COORDINATE:g} m: check `scene.unit`"
        raise StrayMeshError(f"mesh {mesh.name!r} in {path} {problem_text}")
    has_area = triangle_areas(mesh.vertices, mesh.faces) > MIN_TRIANGLE_AREA
    if has_area.all():
        return mesh
    vertices, faces = drop_unused_vertices(mesh.vertices, mesh.faces[has_area])
    return mesh._replace(vertices=vertices, faces=faces)


# ---------------------------------------------------------------- files

STL_HEADER_SIZE = 84  # size of a binary STL's header, with the number of triangles [bytes]
STL_TRIANGLE_SIZE = 50  # size of a triangle in a binary STL [bytes]
MAX_PLY_HEADER_SIZE = 1 << 20  # largest size of a PLY's header [bytes]
MIN_ITEMS_PER_THREAD = 1 << 16  # the fewest vertices or triangles that a thread reads at once


def repair_obj(path: Path) -> bytes:
    """Read an OBJ file, and rewrite the lines that trimesh would misread.

    Returns:
        The text in UTF-8, without indents; vertices of faces are counted from the start of the
        file.

    Raises:
        SceneError: an index of a face is 0, no integer, or before the first vertex.
    """
    text = _to_utf8(path.read_bytes()).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    text = text.replace(b"\\\n", b" ")
    if re.search(rb"(?m)^(?:[ \t]+[vf]|[vf]\t)", text):
        text = b"\n".join(b" ".join(line.split()) for line in text.split(b"\n"))
    if not re.search(rb"(?m)^f(?=.*(?:#| -| 0+(?:[/ ]|$)))", text):
        return text
    lines = text.split(b"\n")
    num_vertices = 0
    for line_number, line in enumerate(lines):
        num_vertices += line.startswith(b"v ")
        if line.startswith(b"f "):
            # 1 is the first vertex of the file, -1 the last one before this line. Indices of
            # textures and normals aren't needed.
            words = [word.partition(b"/")[0] for word in line.partition(b"#")[0].split()[1:]]
            indices = [int(word) if re.fullmatch(rb"[-+]?\d{1,18}", word) else 0 for word in words]
            indices = [index + num_vertices + 1 if index < 0 else index for index in indices]
            if min(indices, default=1) <= 0:
                expected_text = "expected numbers of vertices, counted from 1"
                raise SceneError(f"{expected_text}, in line {line_number + 1} of {path}")
            lines[line_number] = b"f " + " ".join(map(str, indices)).encode()
    return b"\n".join(lines)


def repair_stl(path: Path) -> bytes:
    """Read an STL, and cut off the bytes that some writers append to its triangles.

    Returns:
        The bytes of a binary STL, or the text in UTF-8.

    Raises:
        SceneError: the file is cut off, or no STL.
    """
    file_content = path.read_bytes()
    may_be_text = file_content.lstrip()[:5].lower() == b"solid"
    lower_case_content = file_content.lower() if may_be_text else b""
    if b"facet" in lower_case_content:
        num_solid_starts = len(re.findall(rb"(?m)^[^\S\n]*solid", lower_case_content))
        num_solid_ends = len(re.findall(rb"(?m)^[^\S\n]*endsolid", lower_case_content))
        if num_solid_ends < num_solid_starts:
            raise SceneError(f"{path} is cut off: its last solid has no end")
        return _to_utf8(file_content)
    num_triangles = int.from_bytes(file_content[STL_HEADER_SIZE - 4 : STL_HEADER_SIZE], "little")
    num_bytes = STL_HEADER_SIZE + STL_TRIANGLE_SIZE * num_triangles
    if len(file_content) < max(num_bytes, STL_HEADER_SIZE):
        expected_text = (
            f"expected {num_bytes} bytes for the {num_triangles} triangles of its header"
        )
        raise SceneError(f"{path} is cut off or no STL: {expected_text}, got {len(file_content)}")
    return file_content[:num_bytes]


def repair_ply(path: Path) -> bytes:
    """Read a PLY file; if it is in text form, convert it to UTF-8."""
    file_content = path.read_bytes()
    return _to_utf8(file_content) if b"format ascii" in file_content[:200] else file_content


def _to_utf8(text: bytes) -> bytes:
    """Replace bytes that aren't UTF-8, as trimesh needs another package to guess encodings."""
    return text.decode("utf-8-sig", errors="replace").encode()


# A PLY's words for formats, and for types, -> numpy's codes
PLY_FORMATS = {b"binary_little_endian": "<", b"binary_big_endian": ">"}
PLY_TYPES = {b"uchar": "u1", b"uint8": "u1", b"int": "i4", b"int32": "i4", b"uint": "u4"}
PLY_TYPES |= {b"uint32": "u4", b"float": "f4", b"float32": "f4", b"double": "f8", b"float64": "f8"}
PLY_COORDINATES = {b"x", b"y", b"z"}
# The properties of a plain vertex. Texture coordinates are not among them: where they differ, a
# vertex is stored several times
PLY_VERTEX_PROPERTIES = PLY_COORDINATES | {b"nx", b"ny", b"nz"}
PLY_VERTEX_PROPERTIES |= {b"red", b"green", b"blue", b"alpha"}
PLY_HEADER = re.compile(
    rb"ply\nformat (?P<format>\w+) 1\.0\n(?:comment [^\n]*\n)*"
    rb"element vertex (?P<vertices>\d{1,10})\n(?P<properties>(?:property \w+ \w+\n)+)"
    rb"element face (?P<faces>\d{1,10})\n"
    rb"property list (?P<count>\w+) (?P<index>\w+) vertex_ind\w+\nend_header\n"
)


def read_plain_file(path: Path) -> Triangles | None:
    """Read a binary PLY or STL that holds only vertices and triangles, with several threads.

    Returns:
        The triangles; None for any other file.
    """
    if path.suffix.lower() == ".ply":
        return _read_plain_ply(path)
    if path.suffix.lower() == ".stl":
        return _read_plain_stl(path)
    return None


def _read_plain_stl(path: Path) -> Triangles | None:
    with path.open("rb") as file:
        header = file.read(STL_HEADER_SIZE)
    num_triangles = int.from_bytes(header[STL_HEADER_SIZE - 4 :], "little")
    is_text = header.lstrip()[:5].lower() in (b"solid", b"")
    num_bytes = STL_HEADER_SIZE + STL_TRIANGLE_SIZE * num_triangles
    if is_text or not num_triangles or path.stat().st_size < num_bytes:
        return None
    triangle_type = np.dtype(
        [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    vertices = np.empty((3 * num_triangles, 3))

    def read_triangles(first_triangle: int, end_triangle: int) -> None:
        byte_offset = STL_HEADER_SIZE + first_triangle * STL_TRIANGLE_SIZE
        records = np.fromfile(
            path, triangle_type, end_triangle - first_triangle, offset=byte_offset
        )
        corners = records["corners"].reshape(-1, 3)
        _write_float64(list(corners.T), vertices[3 * first_triangle : 3 * end_triangle])

    run_in_chunks(read_triangles, num_triangles, min_chunk_size=MIN_ITEMS_PER_THREAD)
    return Triangles(vertices, np.arange(3 * num_triangles, dtype=np.int32).reshape(-1, 3))


def _read_plain_ply(path: Path) -> Triangles | None:
    with path.open("rb") as file:
        header_match = PLY_HEADER.match(file.read(MAX_PLY_HEADER_SIZE))
    if header_match is None or header_match["format"] not in PLY_FORMATS:
        return None
    byte_order = PLY_FORMATS[header_match["format"]]
    properties = [line.split()[1:] for line in header_match["properties"].splitlines()]
    property_names = {name for _, name in properties}
    type_names = {
        *(type_name for type_name, _ in properties),
        header_match["count"],
        header_match["index"],
    }
    has_plain_properties = PLY_COORDINATES <= property_names <= PLY_VERTEX_PROPERTIES
    has_unique_names = len(property_names) == len(properties)
    has_readable_types = type_names <= PLY_TYPES.keys()
    if not (has_plain_properties and has_unique_names and has_readable_types):
        return None
    vertex_type = np.dtype(
        [(name.decode(), byte_order + PLY_TYPES[type_name]) for type_name, name in properties]
    )
    count_type = byte_order + PLY_TYPES[header_match["count"]]
    index_type = byte_order + PLY_TYPES[header_match["index"]]
    face_type = np.dtype([("count", count_type), ("index", index_type, 3)])
    num_vertices = int(header_match["vertices"])
    num_faces = int(header_match["faces"])
    faces_offset = header_match.end() + num_vertices * vertex_type.itemsize
    num_bytes = faces_offset + num_faces * face_type.itemsize
    if not num_vertices or not num_faces or path.stat().st_size != num_bytes:
        return None
    vertices = np.empty((num_vertices, 3))
    faces = np.empty((num_faces, 3), dtype=np.int32)
    is_wrong_face = np.zeros(num_faces, dtype=np.bool_)

    def read_vertices(first_vertex: int, end_vertex: int) -> None:
        byte_offset = header_match.end() + first_vertex * vertex_type.itemsize
        records = np.fromfile(path, vertex_type, end_vertex - first_vertex, offset=byte_offset)
        _write_float64([records[axis] for axis in "xyz"], vertices[first_vertex:end_vertex])

    def read_faces(first_face: int, end_face: int) -> None:
        byte_offset = faces_offset + first_face * face_type.itemsize
        records = np.fromfile(path, face_type, end_face - first_face, offset=byte_offset)
        # an index too large for int32 becomes negative
        faces[first_face:end_face] = records["index"]
        # Each polygon begins with its number of corners, which has to be 3.
        np.not_equal(records["count"], 3, out=is_wrong_face[first_face:end_face])
        lowest_index = faces[first_face:end_face].min()
        highest_index = faces[first_face:end_face].max()
        is_wrong_face[first_face] |= lowest_index < 0 or highest_index >= num_vertices

    run_in_chunks(read_vertices, num_vertices, min_chunk_size=MIN_ITEMS_PER_THREAD)
    run_in_chunks(read_faces, num_faces, min_chunk_size=MIN_ITEMS_PER_THREAD)
    return None if is_wrong_face.any() else Triangles(vertices, faces)


def _write_float64(coordinates: Sequence[NDArray[np.floating]], out: Float) -> None:
    """Write arrays of x, y and z into the three columns of an array."""
    with np.errstate(invalid="ignore"):  # signalling NaNs; `check_mesh` refuses all NaNs later
        for axis, column in enumerate(coordinates):
            np.add(column, 0.0, out=out[:, axis], dtype=np.float64)  # no -0.0


JSON_CHUNK = 0x4E4F534A  # the type of a GLB's chunk of JSON
TRIANGLE_FAN = 6  # a mode of glTF's primitives
# glTF's types of normalized integers -> the greatest integer, which stands for 1
MAX_INTEGERS = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}
MESHOPT_HINT = "`gltfpack -i FILE -o unpacked.glb -noq` unpacks it (npm has gltfpack)"
# Extensions of glTF that trimesh does not read -> what the user can do
UNREAD_EXTENSIONS = {
    "EXT_mesh_gpu_instancing": "export its copies as nodes",
    "EXT_meshopt_compression": MESHOPT_HINT,
    "KHR_meshopt_compression": MESHOPT_HINT,
}
DRACO_EXTENSION = "KHR_draco_mesh_compression"  # trimesh reads it if DracoPy is installed


def check_gltf(path: Path) -> Json:
    """Check that trimesh reads all features of a glTF or GLB file, and return the file's JSON.

    Raises:
        SceneError: the file is broken, cut off, or uses a feature that trimesh doesn't read.
    """
    try:
        file_content = path.read_bytes()
        json_text = file_content
        if path.suffix.lower() == ".glb":
            json_text = _read_glb_json(file_content)
        header = json.loads(json_text)
        if not isinstance(header, dict):
            raise ValueError("its JSON is no object")
        problem_text = next(_find_problems(header, len(file_content), path.parent), "")
    except (ValueError, RecursionError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise SceneError(f"broken glTF {path}: {' '.join(str(error).split())[:200]}") from error
    if problem_text:
        raise SceneError(f"cannot read {path}: {problem_text}")
    return header


def scale_normalized_positions(header: Json) -> bool:
    """Add nodes to a glTF that scale positions which it stores as normalized integers.

    trimesh reads the integers as they are. A normalized integer stands for itself divided by the
    greatest one of its type, so a node with that scale, between the mesh and its node, has the same
    effect (glTF 2.0, 3.6.2.2).

    Args:
        header: the JSON of a glTF file, whose nodes are changed.

    Returns:
        Whether the file has such meshes.
    """
    scale_of_mesh = {
        mesh_number: _find_normalized_scale(header, mesh)
        for mesh_number, mesh in enumerate(header.get("meshes", []))
    }
    nodes = header.get("nodes", [])
    for node_number in range(len(nodes)):
        node = nodes[node_number]
        scale = scale_of_mesh.get(node.get("mesh"), 1.0)
        if scale == 1.0:
            continue
        mesh_node = {"name": node.pop("name", str(node_number)), "mesh": node.pop("mesh")}
        node["children"] = [*node.get("children", []), len(nodes)]
        nodes.append({**mesh_node, "scale": [scale] * 3})
    return any(scale != 1.0 for scale in scale_of_mesh.values())


def _find_normalized_scale(header: Json, mesh: Json) -> float:
    """Return the coordinate that the integer 1 stands for in a mesh's normalized positions.

    For a mesh whose positions are not normalized, it is 1.

    Args:
        header: the JSON of a glTF file.
        mesh: the mesh's entry in it.
    """
    accessors = [
        header["accessors"][primitive["attributes"]["POSITION"]]
        for primitive in mesh["primitives"]
        if "POSITION" in primitive["attributes"]
    ]
    for accessor in accessors:
        if accessor.get("normalized"):
            return 1.0 / MAX_INTEGERS[accessor["componentType"]]
    return 1.0


def _replace_gltf_header(path: Path, header: Json) -> bytes:
    """Return the content of a glTF or GLB file, with its JSON replaced by `header`."""
    json_text = json.dumps(header).encode()
    if path.suffix.lower() == ".gltf":
        return json_text
    file_content = path.read_bytes()
    (json_length,) = struct.unpack_from("<I", file_content, 12)
    json_text += b" " * (-len(json_text) % 4)
    chunks = (
        struct.pack("<II", len(json_text), JSON_CHUNK)
        + json_text
        + file_content[20 + json_length :]
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _read_glb_json(file_content: bytes) -> bytes:
    """Return the first chunk of a GLB, its JSON; raise a ValueError if it is broken."""
    if len(file_content) < 20 or not file_content.startswith(b"glTF"):
        raise ValueError("it has no GLB header")
    version, num_bytes, num_json_bytes, chunk_type = struct.unpack_from("<4I", file_content, 4)
    if version != 2:
        raise ValueError(f"expected version 2, got {version}")
    if num_bytes > len(file_content):
        raise ValueError(f"it is cut off: expected {num_bytes} bytes, got {len(file_content)}")
    if chunk_type != JSON_CHUNK or 20 + num_json_bytes > len(file_content):
        raise ValueError("its first chunk is no JSON")
    return file_content[20 : 20 + num_json_bytes]


def _find_problems(header: Json, num_bytes: int, folder: Path) -> Iterator[str]:
    """Yield a message for each feature of a glTF file that trimesh would misread.

    Args:
        header: the file's JSON.
        num_bytes: size of the file [bytes].
        folder: the folder that the file is in.
    """
    extensions = header.get("extensionsUsed", [])
    for extension in extensions:
        if extension in UNREAD_EXTENSIONS:
            yield f"it uses {extension}: {UNREAD_EXTENSIONS[extension]}"
    if DRACO_EXTENSION in extensions and find_spec("DracoPy") is None:
        yield f'it uses {DRACO_EXTENSION}: `pip install "navbake[draco]"` reads it'
    accessors = header.get("accessors", [])
    for accessor in accessors:
        if "bufferView" not in accessor and accessor["count"] > max(num_bytes, 10_000_000):
            raise ValueError(f"it claims {accessor['count']} numbers without data")
    for mesh in header.get("meshes", []):
        for primitive in mesh["primitives"]:
            yield from _find_problems_of_primitive(primitive, accessors)
        normalized_flags = {
            bool(accessors[primitive["attributes"]["POSITION"]].get("normalized"))
            for primitive in mesh["primitives"]
            if "POSITION" in primitive["attributes"]
        }
        if len(normalized_flags) > 1:
            yield "a mesh has normalized and other positions: export it unquantized"
    for buffer in header.get("buffers", []):
        uri = buffer.get("uri")
        if uri is not None and not uri.startswith("data:"):
            yield from _find_problems_of_buffer(uri, folder)


def _find_problems_of_primitive(primitive: Json, accessors: list[Json]) -> Iterator[str]:
    if primitive.get("mode") == TRIANGLE_FAN:
        yield "it has triangle fans: export them as triangles"
    for index in (primitive["attributes"].get("POSITION"), primitive.get("indices")):
        if index is None:
            continue
        accessor = accessors[index]
        if "sparse" in accessor:
            yield "it has sparse accessors: export them as plain ones"
        if accessor.get("normalized") and accessor["componentType"] not in MAX_INTEGERS:
            raise ValueError("its normalized positions are no integers of glTF")


def _find_problems_of_buffer(uri: str, folder: Path) -> Iterator[str]:
    if ".." in Path(unquote(uri)).parts:
        yield f"its buffer {uri[:80]!r} lies outside of its folder: put it beside it"
        return
    candidate_files = [folder / name for name in {uri, uri.strip(), unquote(uri)}]
    existing_files = [file for file in candidate_files if os.path.exists(file)]
    if not existing_files:
        yield f"its buffer {uri[:80]!r} is missing"
    # Reading a device would never end.
    if not all(
        os.path.isfile(file) and file.stat().st_size <= MAX_BYTES for file in existing_files
    ):
        yield f"its buffer {uri[:80]!r} is no file of {MAX_BYTES >> 20} MiB at most"


# File suffix -> the function that returns the file's content as trimesh can read it
REPAIR_FUNCTIONS = {".obj": repair_obj, ".stl": repair_stl, ".ply": repair_ply}
