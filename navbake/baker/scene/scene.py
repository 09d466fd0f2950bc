"""A scene as the bake sees it: which geoms count, as what, and where."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.scene.choice import Choice, choose_geoms
from navbake.baker.scene.collect import TYPE_NAMES, collect_shapes
from navbake.baker.scene.mesh_scene import MESH_SUFFIXES
from navbake.baker.scene.meshes.part import MeshPart
from navbake.baker.scene.model import PosedModel, load_model
from navbake.baker.scene.model import mujoco_library as mujoco_library
from navbake.baker.scene.model import mujoco_version as mujoco_version
from navbake.baker.scene.names import name_at, names_of
from navbake.baker.scene.shapes import Shapes
from navbake.config.scene import SceneSettings
from navbake.errors import SceneError

# Files whose format says that y is up
Y_UP_SUFFIXES = (".glb", ".gltf")
LYING = (
    "glTF files are y up by their specification, and `scene.up` is z: if the scene lies on its "
    "side, set it to y (z silences this)"
)


@dataclass(frozen=True)
class GeomReport:
    """What became of one geom, for `navbake geoms`.

    Attributes:
        id: MuJoCo's geom id.
        name: its name, or ``geom <id>`` where it has none; what patterns match.
        body: its body's name, or ``body <id>``.
        type: MuJoCo's type: plane, hfield, sphere, capsule, ellipsoid, cylinder, box, mesh, sdf.
        counted: whether it takes part in the bake.
        shape: as what: ``solid``; a plane as ``half-space``, ``strip`` (one side infinite) or
            ``rectangle``; a mesh as ``hull``, ``surface`` or ``closed surface`` (it encloses a
            volume, whose inside is occupied); empty where it isn't counted.
        reason: why it is counted or left out.
    """

    id: int
    name: str
    body: str
    type: str
    counted: bool
    shape: str
    reason: str


@dataclass
class Scene:
    """A posed scene, ready for rays and overlaps.

    Attributes:
        id: the scene's id.
        geoms: what became of each geom, by geom id.
        shapes: the counted geoms' geometry, world frame.
        bounds: (2, 3) float64, lower and upper corner of all counted finite geoms [m], or None
            where only infinite planes count.
        digest: sha256 of the posed model: what its geoms are, where, and what they can do.
        warnings: what the user should know, one line each.
        model: the compiled mujoco.MjModel.
        data: its mujoco.MjData in the pose that is baked.
        choices: what becomes of each geom, by geom id.
        parts: meshes that are known better than the model has them, by geom id.
    """

    id: str
    geoms: list[GeomReport]
    shapes: Shapes
    bounds: NDArray[np.float64] | None
    digest: str
    warnings: list[str] = field(default_factory=list)
    model: Any = None
    data: Any = None
    choices: list[Choice] = field(default_factory=list)
    parts: dict[int, MeshPart] = field(default_factory=dict)


def load_scene(settings: SceneSettings) -> Scene:
    """Load a scene, pose it and choose the geoms that count.

    Args:
        settings: the `scene` part of the configuration.

    Returns:
        The scene. Nothing of it changes later.

    Raises:
        SceneError: the file is missing or broken, or holds no geom that counts.
        ConfigError: the settings ask for a keyframe or joint that isn't there.
    """
    posed = load_model(settings)
    choices, notes = choose_geoms(posed.model, settings)
    if not any(choice.counted for choice in choices):
        raise SceneError(_nothing_counts(settings, choices))
    try:
        collected = collect_shapes(posed.model, posed.data, choices, posed.parts)
    except SceneError as error:
        raise SceneError(f"{error}, in {settings.path}") from error
    from_mujoco = [f"MuJoCo: {' '.join(warning.split())}" for warning in posed.warnings]
    idle, unusable = _find_idle(settings), _find_unusable(posed.model)
    return Scene(
        id=settings.id or Path(settings.path).stem,
        geoms=_report_geoms(posed.model, choices, collected.kinds),
        shapes=collected.shapes,
        bounds=collected.shapes.bounds(),
        digest=_digest(posed),
        warnings=[*from_mujoco, *posed.notes, *unusable, *idle, *notes, *collected.notes],
        model=posed.model,
        data=posed.data,
        choices=choices,
        parts=posed.parts,
    )


def _report_geoms(model: Any, choices: list[Choice], kinds: list[str]) -> list[GeomReport]:
    reports = []
    for geom, (choice, kind) in enumerate(zip(choices, kinds, strict=True)):
        names = names_of(model, geom)
        reports.append(
            GeomReport(
                id=geom,
                name=names.geom,
                body=names.body,
                type=TYPE_NAMES.get(int(model.geom_type[geom]), "unknown"),
                counted=choice.counted,
                shape=kind,
                reason=choice.reason,
            )
        )
    return reports


def _nothing_counts(settings: SceneSettings, choices: list[Choice]) -> str:
    if not choices:
        return f"{settings.path} has no geoms: nothing to bake"
    reasons = sorted({choice.reason for choice in choices})
    return (
        f"none of the {len(choices)} geoms of {settings.path} counts "
        f"(`scene.geoms` is {settings.geoms}): {'; '.join(reasons[:3])}"
    )


def _find_unusable(model: Any) -> list[str]:
    """Name what can't be baked."""
    return [
        f"{kind} can't be baked and is left out: "
        + ", ".join(name_at(model, start) or f"{kind} {i}" for i, start in enumerate(starts))
        for kind, starts in (("flex", model.name_flexadr), ("skin", model.name_skinadr))
        if len(starts)
    ]


def _find_idle(settings: SceneSettings) -> list[str]:
    """Name settings that do nothing for this kind of file, and one that may be missing."""
    suffix = Path(settings.path).suffix.lower()
    if suffix in MESH_SUFFIXES:
        is_lying = suffix in Y_UP_SUFFIXES and "up" not in settings.model_fields_set
        return [LYING] if is_lying else []
    given = {"up": settings.up != "z", "unit": settings.unit != 1.0}
    return [
        f"`scene.{name}` is for mesh files and does nothing here"
        for name, is_given in given.items()
        if is_given
    ]


def _digest(posed: PosedModel) -> str:
    """sha256 of what the bake can see of a posed model, wherever it was loaded from."""
    digest = hashlib.sha256()
    for geom in range(posed.model.ngeom):
        names = names_of(posed.model, geom)
        digest.update("\0".join((names.geom, names.mesh, names.body)).encode() + b"\n")
    for number, array in enumerate(_digest_arrays(posed)):
        array = np.ascontiguousarray(array)
        digest.update(f"{number} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _digest_arrays(posed: PosedModel) -> Iterator[NDArray[Any]]:
    model, data = posed.model, posed.data
    yield from (model.geom_type, model.geom_size, model.geom_dataid, model.geom_bodyid)
    yield from (model.geom_contype, model.geom_conaffinity, model.geom_group)
    yield from (model.geom_rgba, model.geom_matid, model.mat_rgba)
    yield from (data.geom_xpos, data.geom_xmat)
    yield from (model.body_parentid, model.body_weldid, model.body_mocapid)
    yield from (model.jnt_type, model.jnt_bodyid, model.jnt_limited, model.jnt_range)
    yield from (model.jnt_pos, model.jnt_axis, model.jnt_qposadr, data.qpos)
    yield from (model.site_type, model.site_size, data.site_xpos, data.site_xmat)
    for addresses in (model.name_siteadr, model.name_jntadr):
        names = [name_at(model, address) for address in addresses]
        yield np.frombuffer("\0".join(names).encode(), dtype=np.uint8)
    yield from (model.mesh_vertadr, model.mesh_faceadr, model.mesh_vert, model.mesh_face)
    yield from (model.mesh_graphadr, model.mesh_graph)
    yield from (model.hfield_nrow, model.hfield_ncol, model.hfield_size, model.hfield_data)
    for geom in sorted(posed.parts):
        yield from (np.array([geom]), posed.parts[geom].vertices, posed.parts[geom].faces)
