"""Compile specs of scenes as models: MuJoCo's errors and warnings, endless ground, meshes."""

import threading
import warnings as python_warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from navbake.baker.scene.mesh_scene import MeshPart
from navbake.baker.scene.names import unique_name
from navbake.errors import ConfigError, SceneError
from navbake.processes import lacked_memory
from navbake.types import Float, Int, Int32

TETRAHEDRON = np.eye(4, 3), np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
"""Vertices and faces, counter-clockwise from outside."""
BY_MUJOCO = "MuJoCo: "  # what its warnings begin with
_WARNING_LOCK = threading.Lock()  # MuJoCo has one hook for warnings, whatever the thread


def model_of_parts(
    parts: list[MeshPart], path: Path, ground: float | None, warnings: list[str]
) -> tuple[Any, dict[int, MeshPart]]:
    """A model with mesh parts' names, and the parts by geom id.

    Each is a static body with one geom, which can't collide. It is a tetrahedron, as MuJoCo would
    compile the part's triangles for many seconds.
    """

    def build() -> Any:
        spec = mujoco.MjSpec()
        for part in parts:
            fill_mesh(spec.add_mesh(name=part.name), *TETRAHEDRON)
            body = spec.worldbody.add_body(name=part.name)
            geom = body.add_geom(name=part.name, type=mujoco.mjtGeom.mjGEOM_MESH)
            geom.meshname, geom.contype, geom.conaffinity = part.name, 0, 0
        return compile_geometry(spec, ground, warnings)

    model = compile_model(path, warnings, build)
    return model, {int(model.geom(part.name).id): part for part in parts}


def compile_model(path: Path, warnings: list[str], load: Callable[[], Any], hint: str = "") -> Any:
    """Call `load`; MuJoCo's error is raised as a SceneError, with its warnings."""
    try:
        return load()
    except (ConfigError, SceneError):
        raise
    except Exception as error:  # mujoco raises ValueError, FatalError and UnexpectedError
        said = [*str(error).splitlines(), *(w.removeprefix(BY_MUJOCO) for w in warnings)]
        lines = dict.fromkeys(" ".join(line.split()) for line in said or [type(error).__name__])
        reason = "; ".join(line for line in lines if line)  # each once, in order
        reason = reason.removeprefix("Error: ").removeprefix("XML Error: ")
        hint = "" if lacked_memory(error) else hint
        raise SceneError(f"MuJoCo cannot load {path}: {reason[:400]}{hint}") from error


def compile_spec(spec: Any, ground: float | None, warnings: list[str]) -> Any:
    """Compile a spec; what MuJoCo warns of is added to `warnings`.

    Endless ground is added at a height, under a name that nothing else has.
    """
    for mesh in spec.meshes:
        # Geoms of type sdf collide by a field of distances in an octree, which takes 0.2 s a mesh
        # to fill. They count by their triangles here. Older MuJoCos fill it always.
        if hasattr(mesh, "octree_maxdepth"):
            mesh.octree_maxdepth = 0
    if ground is not None:
        name = unique_name("ground", {thing.name for thing in (*spec.geoms, *spec.bodies)})
        body = spec.worldbody.add_body(name=name, pos=(0.0, 0.0, ground))
        # it collides with nothing, so that `scene.geoms: auto` judges the scene's own geoms
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        body.add_geom(name=name, type=plane, size=(0, 0, 1), contype=0, conaffinity=0)
    with python_warnings.catch_warnings(record=True) as said:  # MjSpec warns by Python's means
        python_warnings.simplefilter("always")
        model = spec.compile()
    texts = [f"{BY_MUJOCO}{each.message}" for each in said]
    warnings.extend(text for text in texts if text not in warnings)
    return model


def compile_geometry(spec: Any, ground: float | None, warnings: list[str]) -> Any:
    """Compile a spec with any masses and inertias, which a bake does not need."""
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = max(spec.compiler.boundmass, 1e-6)
    spec.compiler.boundinertia = max(spec.compiler.boundinertia, 1e-6)
    return compile_spec(spec, ground, warnings)


def fill_mesh(mesh: Any, vertices: Float, faces: Int | Int32) -> None:
    spare = np.repeat(vertices[-1:], max(0, 4 - len(vertices)), axis=0)  # MuJoCo wants four
    mesh.uservert = np.concatenate([vertices, spare]).astype(np.float32).ravel()
    mesh.userface = faces.astype(np.int32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it need not be closed


@contextmanager
def catch_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, each after `BY_MUJOCO`; else they go to ./MUJOCO_LOG.TXT."""
    with _WARNING_LOCK:
        before = mujoco.get_mju_user_warning()
        warnings: list[str] = []
        mujoco.set_mju_user_warning(lambda text: warnings.append(f"{BY_MUJOCO}{text}"))
        try:
            yield warnings
        finally:
            mujoco.set_mju_user_warning(before)
