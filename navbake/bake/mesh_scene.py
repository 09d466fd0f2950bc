"""Building meshes (OBJ, PLY, STL, GLB, DAE) as named triangle parts; the one user of trimesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from navbake.errors import SceneError

MESH_SUFFIXES = frozenset({".obj", ".ply", ".stl", ".glb", ".gltf", ".dae"})

# A turn of y-up coordinates into the world's z-up: (x, y, z) -> (x, -z, y), nothing mirrored.
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class MeshPart:
    """One named piece of a mesh scene.

    Attributes:
        name: unique within its scene.
        vertices: shape (n, 3), float64, world frame [m].
        faces: shape (m, 3), int32, indices into `vertices`, counter-clockwise from outside.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]


def read_mesh_parts(path: Path, up: str = "z", unit: float = 1.0) -> list[MeshPart]:
    """Read a mesh file as named parts in the world frame.

    Every group and node of the file is read (MuJoCo's own OBJ reader takes the first group
    only). A DAE's own ``<unit meter>`` is applied first, then `unit`, then `up`. Triangles
    without area are dropped.

    Args:
        path: an OBJ, PLY, STL, GLB, GLTF or DAE file.
        up: the file's vertical axis, "z" or "y".
        unit: metres per unit of the file, > 0.

    Returns:
        The parts that have at least one triangle, in the file's order.

    Raises:
        SceneError: the file can't be read as a mesh or holds no triangle.
    """
    try:
        loaded = trimesh.load_scene(path, process=False)
    except Exception as error:  # trimesh passes on whatever its parsers raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise SceneError(f"cannot read the mesh {path}: {reason}") from error
    scale = unit * _file_unit(loaded, path)
    parts: list[MeshPart] = []
    taken: set[str] = set()
    for node in loaded.graph.nodes_geometry:
        transform, geometry_name = loaded.graph[node]
        geometry = loaded.geometry[geometry_name]
        if not isinstance(geometry, trimesh.Trimesh):
            continue  # paths and point clouds have no surface
        name = _unique(str(node), taken)
        part = _part_of(name, geometry, np.asarray(transform, dtype=np.float64), up, scale)
        if part is None:
            continue
        if not np.isfinite(part.vertices).all():
            raise SceneError(f"mesh {name!r} in {path} has coordinates that are no numbers")
        parts.append(part)
    if not parts:
        raise SceneError(f"no triangles in {path}: expected a mesh with at least one")
    return parts


def _file_unit(loaded: Any, path: Path) -> float:
    """Metres per unit as a DAE states it; 1 for every other format."""
    if path.suffix.lower() != ".dae":
        return 1.0
    import collada

    try:
        meter = collada.Collada(str(path)).assetInfo.unitmeter
    except Exception:  # trimesh has read the file; what its header lacks is no reason to stop
        meter = None
    return float(meter) if meter else 1.0


def _part_of(
    name: str, geometry: Any, transform: NDArray[np.float64], up: str, scale: float
) -> MeshPart | None:
    vertices = np.asarray(geometry.vertices, dtype=np.float64) @ transform[:3, :3].T
    vertices = (vertices + transform[:3, 3]) * scale
    if up == "y":
        vertices = vertices @ Y_UP_TO_Z_UP.T
    faces = np.asarray(geometry.faces, dtype=np.int32)
    if np.linalg.det(transform[:3, :3]) < 0:  # a mirror turns every triangle over
        faces = faces[:, ::-1]
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = faces[~(np.linalg.norm(cross, axis=1) <= 1e-14)]  # keeps NaN, to be named
    return MeshPart(name, vertices, np.ascontiguousarray(faces)) if len(faces) else None


def _unique(name: str, taken: set[str]) -> str:
    candidate, count = name, 1
    while candidate in taken:
        count += 1
        candidate = f"{name}#{count}"
    taken.add(candidate)
    return candidate
