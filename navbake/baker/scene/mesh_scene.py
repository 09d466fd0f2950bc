"""Takes mesh files and trimesh scenes as named parts. Only this module imports trimesh."""

import io
import logging
import re
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.scene.kernels.triangles import measure_areas
from navbake.baker.scene.mesh_readers import PREPARE, check_gltf, check_ply, read_plain
from navbake.baker.scene.names import unique_name
from navbake.config.settings import stem_of
from navbake.errors import SceneError
from navbake.formats.allowance import MAX_BYTES
from navbake.lazy import lazy
from navbake.types import Float, Int32

trimesh = lazy("trimesh")

MESH_SUFFIXES = frozenset({".obj", ".ply", ".stl", ".glb", ".gltf", ".dae"})

# A turn of y-up coordinates into the world's z-up: (x, y, z) -> (x, -z, y), nothing mirrored.
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
NO_AREA = 5e-15  # of triangles that are no larger [m²]
# MuJoCo takes no coordinates beyond (its mjMAXVAL) [m]
MAX_COORDINATE = 1e10
# Floors and ceilings have at least this many times the area of walls of one direction, if a mesh
# is to be taken for one that lies on its side
LYING = 1.5
# How trimesh reads a format
PLAIN: dict[str, Any] = {"skip_materials": True}
OPTIONS = {".glb": PLAIN, ".gltf": PLAIN}
OPTIONS[".obj"] = PLAIN | {"split_objects": True, "split_groups": True, "group_material": False}


class MeshPart(NamedTuple):
    """One named piece of a mesh file; faces are counter-clockwise from outside."""

    name: str  # the file's; unique once it is in the world's frame
    vertices: Float
    faces: Int32


def read_mesh_parts(path: Path, up: str = "z", unit: float = 1.0) -> list[MeshPart]:
    """Read a mesh file as named parts in the world frame.

    Every object, group, solid and node of the file is read. A DAE's own ``<unit meter>`` is
    applied first, then `unit`, then `up`. What the file says of its vertical axis counts for
    nothing, as files are wrong about it too often. Triangles without area, unused vertices and
    parts without triangles are dropped.

    Raises:
        SceneError: the file can't be read as a mesh or holds no triangle; a coordinate is no
            number, or beyond 1e10 m.
    """
    try:
        found = _read_parts(path)
        scale = unit * (_dae_unit(path) if path.suffix.lower() == ".dae" else 1.0)
    except OSError as error:
        raise SceneError(f"cannot read the mesh {path}: {error.strerror or error}") from error
    return _to_world(found, path, up, scale)


def is_mesh_scene(scene: Any) -> bool:
    """Whether something is a trimesh.Scene or a trimesh.Trimesh; loads trimesh only for its own."""
    if not any(kind.__module__.partition(".")[0] == "trimesh" for kind in type(scene).__mro__):
        return False
    return isinstance(scene, trimesh.Scene | trimesh.Trimesh)


def take_mesh_parts(scene: Any, path: Path, up: str = "z", unit: float = 1.0) -> list[MeshPart]:
    """Take a trimesh.Scene or trimesh.Trimesh, which stays as it is, as `read_mesh_parts` a file.

    Parts are named by the scene graph's nodes, or by the stem of the path, which errors name. What
    the scene says of its unit counts for nothing, as `unit` decides.
    """
    with _silence():
        whole = scene if isinstance(scene, trimesh.Scene) else trimesh.Scene(scene)
        try:
            found = _parts_of(whole)
        except (ValueError, TypeError, KeyError, IndexError) as error:
            reason = " ".join(str(error).split())[:200]
            raise SceneError(f"cannot take the meshes of {path}: {reason}") from error
    # kernels are compiled for arrays that can be written, and the caller may change these later
    own = [MeshPart(name, vertices.copy(), faces.copy()) for name, vertices, faces in found]
    return _to_world(own, path, up, unit)


def lies_on_side(parts: Iterable[MeshPart]) -> bool:
    """Whether a mesh in the world frame looks as if its y axis were the vertical one.

    It does where its box is lowest along y, and the surface within 45° of facing along y has
    `LYING` times the area of that facing along z, as floors and ceilings have of walls.
    """
    parts = list(parts)
    # axis by axis: numpy takes ten times as long along the rows of a narrow array
    low = [min(part.vertices[:, axis].min() for part in parts) for axis in range(3)]
    high = [max(part.vertices[:, axis].max() for part in parts) for axis in range(3)]
    width, depth, height = np.subtract(high, low)
    if not depth < min(width, height):
        return False
    corners = np.concatenate([part.vertices[part.faces] for part in parts])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    faces_y, faces_z = (
        size[np.abs(normal[:, axis]) >= size * np.sqrt(0.5)].sum() for axis in (1, 2)
    )
    return bool(faces_y > LYING * faces_z)


def _read_parts(path: Path) -> list[MeshPart]:
    """A part for each node of the file that carries a mesh, in the file's frame and unit."""
    suffix = path.suffix.lower()
    if path.stat().st_size > MAX_BYTES:
        raise SceneError(f"{path} is too large: expected a mesh of {MAX_BYTES >> 20} MiB at most")
    if suffix in (".glb", ".gltf"):
        check_gltf(path)
    data = PREPARE[suffix](path) if suffix in PREPARE else b""
    plain = read_plain(data, suffix)
    if plain is not None:
        return [MeshPart("", *plain)]
    source: Any = io.BytesIO(data) if suffix in PREPARE else path
    options = OPTIONS.get(suffix, {})
    try:
        with _silence():
            loaded = trimesh.load_scene(source, file_type=suffix[1:], process=False, **options)
            parts = _parts_of(loaded)
    except Exception as error:  # trimesh passes on whatever its parsers raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise SceneError(
            f"cannot read the mesh {path}, it is broken or cut off: {reason}"
        ) from error
    if suffix == ".ply":
        num_vertices = sum(len(part.vertices) for part in parts)
        check_ply(path, data, num_vertices, sum(len(part.faces) for part in parts))
    return parts


def _parts_of(loaded: Any) -> list[MeshPart]:
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
        parts.append(MeshPart(name, _turn(vertices, turn) + shift[:, 0], corners))
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


def _dae_unit(path: Path) -> float:
    """Metres per unit as a DAE states it; 1 where it doesn't."""
    for event, element in ElementTree.iterparse(path, events=("start", "end")):
        tag = element.tag.rpartition("}")[2]
        if event == "start" and tag == "unit":
            meter = element.get("meter", "1")
            with suppress(ValueError):
                if 0 < float(meter) < float("inf"):
                    return float(meter)
            raise SceneError(f"expected a number > 0 as <unit meter> in {path}, got {meter!r}")
        if event == "end" and tag == "asset":
            break
    return 1.0


def _to_world(found: list[MeshPart], path: Path, up: str, scale: float) -> list[MeshPart]:
    """Turn parts into the world frame, and name each by a name of its own."""
    turn = scale * (Y_UP_TO_Z_UP if up == "y" else np.eye(3))
    taken = {"world"}  # MuJoCo's own body
    parts = [_clean(part, turn, path) for part in found]
    named = [part._replace(name=unique_name(part.name, taken)) for part in parts if len(part.faces)]
    if not named:
        raise SceneError(f"no triangles in {path}: expected a mesh with at least one")
    return named


def _clean(part: MeshPart, turn: Float, path: Path) -> MeshPart:
    """Turn a part into the world frame; leave out empty triangles and unused vertices."""
    name = "".join(char if char.isprintable() else "_" for char in part.name)
    if re.fullmatch(r"geometry(_\d+)?", name):  # trimesh made it up
        name = stem_of(path)
    name = name.removeprefix(path.name).removeprefix("_") or stem_of(path)
    vertices, faces = _only_used(part.vertices, part.faces)
    with np.errstate(all="ignore"):
        vertices = _turn(vertices, turn)
    # two reductions, where `isfinite` and `abs` make arrays as large; NaN is the least of all
    low, high = (float(vertices.min()), float(vertices.max())) if len(vertices) else (0.0, 0.0)
    if not np.isfinite([low, high]).all():
        raise SceneError(f"mesh {name!r} in {path} has coordinates that are no numbers")
    if max(-low, high) > MAX_COORDINATE:
        raise SceneError(
            f"mesh {name!r} in {path} reaches beyond {MAX_COORDINATE:g} m: check `scene.unit`"
        )
    has_area = measure_areas(vertices, faces) > NO_AREA
    used = (vertices, faces) if has_area.all() else _only_used(vertices, faces[has_area])
    return MeshPart(name, *used)


def _only_used(vertices: Float, faces: Int32) -> tuple[Float, Int32]:
    """The vertices that faces use, and the faces counted in them."""
    is_used = np.zeros(len(vertices), dtype=np.bool_)
    is_used[faces] = True
    if is_used.all():
        return vertices, faces
    return vertices[is_used], (np.cumsum(is_used, dtype=np.int32) - 1)[faces]
