"""A scene as the bake sees it: which geoms count, as what, and where."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.geometry.shapes import Shapes
from navbake.baker.readers.mesh import NamedMesh, bounds_of_meshes
from navbake.baker.readers.parsed_scene import catch_warnings
from navbake.baker.scene.collect import (
    TYPE_NAMES,
    GeomSelection,
    MeshTriangles,
    collect_shapes,
    select_geoms,
)
from navbake.baker.scene.hull_room import HullRoomTest
from navbake.baker.scene.leaves import DoorCandidate
from navbake.baker.scene.model import CompileLimits, SceneModel, load_isolated, load_model
from navbake.baker.scene.names import all_names, name_at, names_at
from navbake.baker.scene.pose import pose_model, warn_out_of_range
from navbake.baker.scene.roles import (
    LEAF,
    ROLES,
    SceneRoles,
    find_actuated_bodies,
    find_roles,
    mark_structure,
)
from navbake.config.settings import (
    BakeConfig,
    SceneSettings,
    stem_of,
)
from navbake.errors import SceneError
from navbake.formats.scene_files import SDF_SUFFIXES, STAGE_SUFFIXES
from navbake.navgrid.user_data import without_garbage_collection
from navbake.threads import run_beside
from navbake.types import Bool, Float, Int

LARGE_ARRAY = 1 << 20  # arrays of more bytes are hashed where they are
WORTH_THREAD = 1 << 17  # hashing so many bytes takes longer than starting a thread
# A mesh that is higher or wider, and any scene that is smaller, is probably not in metres [m]
HIGH_MESH = 100.0
WIDE_MESH = 5000.0
SMALL = 0.5


@dataclass(frozen=True)
class GeomReport:
    """What became of one geom, for `navbake geoms`."""

    id: int  # MuJoCo's
    name: str  # which patterns match; ``geom <id>`` where it has none
    body: str  # its body's name, or ``body <id>``
    type: str  # MuJoCo's: plane, hfield, sphere, capsule, ellipsoid, cylinder, box, mesh, sdf
    counted: bool  # whether it takes part in the bake
    # as what, empty where it isn't counted: solid; half-space, strip (one side infinite) or
    # rectangle; hull, shell, surface, closed surface (its inside is occupied) or partly closed,
    # with the number of triangles that were turned to face out
    shape: str
    reason: str  # why it is counted or left out
    role: str = ""  # one of `divide.ROLES`; empty where it isn't counted


@dataclass
class Scene:
    """A posed scene, ready for rays and overlaps."""

    id: str
    geoms: list[GeomReport]  # by geom id
    shapes: Shapes  # the counted geoms' geometry, world frame
    bounds: Float | None  # corners of all finite geoms that stand, (2, 3) [m]; None without
    digest: str  # sha256 of the posed model: what its geoms are, where, and what they can do
    warnings: list[str]  # one line each
    hints: list[str]  # those of them that say that axes or units look wrong
    # The compiled mujoco.MjModel; of a mesh file it has the names, the bodies and the ground, but a
    # tetrahedron in place of each part
    model: Any
    data: Any  # its mujoco.MjData in the pose that is baked
    selections: list[GeomSelection]  # by geom id
    exact_meshes: dict[int, NamedMesh]  # the meshes of a mesh scene by geom id, world frame
    meshes: MeshTriangles  # what the model's meshes count by, for geoms in other poses
    roles: NDArray[np.uint8]  # by geom id, see `divide`
    movable: Bool  # by body id, whether it can move and carries no floor
    is_structure_body: Bool  # by body id, whether it is structure
    mover_of_body: Int  # by body id, the topmost body that moves it; itself if none does
    actuated: frozenset[int]  # of these, those that actuators move
    named_leaves: frozenset[str]  # the names of bodies that the file says are doors
    leaves: list[DoorCandidate]  # bodies that may be doors, by body id
    cars: list[int]  # bodies that are cars of lifts, by body id
    unused: list[str]  # warnings of patterns of doors that match nothing, one line each

    @property
    def mover_of(self) -> Int:
        """By geom id, the topmost body that moves it; its own body if none does."""
        mover_of_body: Int = self.mover_of_body[self.model.geom_bodyid]
        return mover_of_body

    @property
    def is_structure(self) -> Bool:
        """By geom id, whether it makes floors."""
        return mark_structure(self.roles)

    @cached_property
    def structure(self) -> Shapes:
        """The geometry of what stands."""
        return self.shapes.only(self.is_structure)


@without_garbage_collection()
def load_scene(
    config: BakeConfig,
    *,
    limits: CompileLimits | None = None,
    opened: SceneModel | None = None,
) -> Scene:
    """Load a scene, pose it, choose the geoms that count, and divide them by what can move.

    With limits, MuJoCo compiles in a child process; `opened` is the model of a scene in memory.
    """
    settings = config.scene
    opened = opened or load_scene_file(settings, limits)
    model = opened.model
    exact_meshes = opened.exact_meshes
    ground = opened.ground
    data = opened.data
    with catch_warnings() as warned:
        data = pose_model(model, settings) if data is None else data
    digest = run_beside(lambda: start_digest(model, data, exact_meshes)())
    meshes = MeshTriangles(model)
    room = HullRoomTest(model, data, meshes, config.agent, config.floors)
    said = {geom: part.mode for geom, part in exact_meshes.items()}

    def choose(left_out: Bool) -> tuple[list[GeomSelection], Shapes, dict[int, str], list[str]]:
        """Choose geoms without those of some bodies; their shapes, what these are, and notes."""
        selections, notes = select_geoms(model, settings, room.hides_room, left_out, ground, said)
        shapes, kinds, shape_notes = collect_shapes(
            model, data, selections, exact_meshes, meshes=meshes
        )
        return selections, shapes, kinds, [*notes, *shape_notes]

    def divide_chosen(selections: list[GeomSelection], shapes: Shapes) -> SceneRoles:
        counted = np.array([choice.counted for choice in selections], dtype=np.bool_)
        return find_roles(
            model,
            data,
            shapes=shapes,
            counted=counted,
            named_leaves=opened.named_leaves,
            config=config,
        )

    try:
        selections, shapes, kinds, notes = choose(np.zeros(model.nbody, dtype=np.bool_))
        roles = divide_chosen(selections, shapes)
        if settings.exclude.movable:
            # but for what may be a door
            left_out = roles.movable.copy()
            left_out[model.geom_bodyid[roles.roles == LEAF]] = False
            selections, shapes, kinds, notes = choose(left_out)
            roles = divide_chosen(selections, shapes)
    except SceneError as error:
        raise SceneError(f"{error}, in {settings.path}") from error
    own = [choice for geom, choice in enumerate(selections) if geom != ground]
    if not own:
        raise SceneError(f"{settings.path} has no geoms: nothing to bake")
    if not any(choice.counted for choice in own):
        reasons = "; ".join(sorted({choice.reason for choice in own})[:3])
        none = f"none of the {len(own)} geoms of {settings.path} counts"
        raise SceneError(f"{none} (`scene.geoms` is {settings.geoms}): {reasons}")
    warnings = [" ".join(warning.split()) for warning in [*opened.warnings, *warned]]
    warnings += warn_out_of_range(model, settings)
    hints = [text for text in warnings if exact_meshes and "`scene.up" in text]
    bounds = shapes.only(mark_structure(roles.roles)).bounds
    size = _warn_size(settings, exact_meshes, bounds)
    hints += size
    warnings += [*_warn_geometry(model, settings, exact_meshes), *size, *notes, *roles.warnings]
    types = model.geom_type.tolist()
    geoms = [
        GeomReport(
            id=geom,
            name=names.geom,
            body=names.body,
            type=TYPE_NAMES.get(types[geom], "unknown"),
            counted=choice.counted,
            shape=kinds.get(geom, ""),
            reason=choice.reason,
            role=ROLES[roles.roles[geom]],
        )
        for geom, (names, choice) in enumerate(zip(all_names(model).geoms, selections, strict=True))
    ]
    return Scene(
        id=settings.id or stem_of(settings.path),
        geoms=geoms,
        shapes=shapes,
        bounds=bounds,
        digest=digest(),
        warnings=warnings,
        hints=hints,
        model=model,
        data=data,
        selections=selections,
        exact_meshes=exact_meshes,
        meshes=meshes,
        roles=roles.roles,
        movable=roles.movable,
        is_structure_body=roles.is_structure_body,
        mover_of_body=roles.mover_of_body,
        actuated=frozenset(roles.mover_of_body[[*find_actuated_bodies(model)]].tolist()),
        named_leaves=opened.named_leaves,
        leaves=roles.leaves,
        cars=roles.cars,
        unused=roles.unused,
    )


def load_scene_file(settings: SceneSettings, limits: CompileLimits | None = None) -> SceneModel:
    """The model of the file that the settings name."""
    with catch_warnings() as warned:
        if limits is None:
            return load_model(settings, warned)
        return load_isolated(settings, limits, warned)


def _warn_geometry(
    model: Any, settings: SceneSettings, exact_meshes: dict[int, NamedMesh]
) -> list[str]:
    """Warn of geometry that can't be baked, and of settings that are for mesh files."""
    notes = [
        f"{kind} can't be baked and is left out: "
        + ", ".join(name_at(model, start) or f"{kind} {i}" for i, start in enumerate(starts))
        for kind, starts in (("flex", model.name_flexadr), ("skin", model.name_skinadr))
        if len(starts)
    ]
    given = {"up": settings.up not in ("auto", "z"), "unit": settings.unit != 1.0}
    text = "is for mesh files and does nothing here"
    unused = [f"`scene.{name}` {text}" for name, is_given in given.items() if is_given]
    suffix = Path(settings.path).suffix.lower()
    takes_frame = suffix in STAGE_SUFFIXES or (bool(exact_meshes) and suffix not in SDF_SUFFIXES)
    return [*notes, *([] if takes_frame else unused)]


def _warn_size(
    settings: SceneSettings, exact_meshes: dict[int, NamedMesh], bounds: Any
) -> list[str]:
    """Warn of a scene whose size says that its unit is not the metre."""
    if bounds is None or "unit" in settings.model_fields_set:
        return []
    suffix = Path(settings.path).suffix.lower()
    if suffix in SDF_SUFFIXES | STAGE_SUFFIXES:  # these state their unit
        exact_meshes = {}
    sides = np.diff(bounds_of_meshes(exact_meshes.values()) if exact_meshes else bounds, axis=0)[0]
    width = float(sides.max())
    height = float(sides[2])
    if width < SMALL:
        hint = "MuJoCo's unit is the metre: check the lengths, or the `scale` of its meshes"
        if suffix in STAGE_SUFFIXES:
            hint = "check its metersPerUnit, or set `scene.unit` (1 takes metres)"
        if exact_meshes:
            unit = "the metres that one unit of it is, as 1000 for kilometres"
            hint = f"set `scene.unit` to {unit} (1 silences this)"
        return [f"the {'mesh' if exact_meshes else 'scene'} is only {width:.6g} m large: {hint}"]
    if exact_meshes and (height > HIGH_MESH or width > WIDE_MESH):
        text = f"{height:.6g} m high" if height > HIGH_MESH else f"{width:.6g} m large"
        hint = "if it is in centimetres, set `scene.unit` to 0.01, in millimetres to 0.001"
        return [f"the mesh is {text}: {hint} (1 silences this)"]
    return []


DigestedNames = tuple[Any, NDArray[np.uint8], NDArray[np.uint8]]
"""The sha256 of the geoms' names, with which a digest begins; the names of sites, and of joints."""


def digest_names(model: Any) -> DigestedNames:
    """The part of a scene's digest that depends on names, which never change."""
    digest = hashlib.sha256()
    for names in all_names(model).geoms:
        digest.update("\0".join(names).encode() + b"\n")
    sites = np.frombuffer(
        "\x00".join(names_at(model, model.name_siteadr.tolist())).encode(), dtype=np.uint8
    )
    joints = np.frombuffer(
        "\x00".join(names_at(model, model.name_jntadr.tolist())).encode(), dtype=np.uint8
    )
    return digest, sites, joints


def start_digest(
    model: Any, data: Any, exact_meshes: dict[int, NamedMesh], names: DigestedNames | None = None
) -> Callable[[], str]:
    """Start the sha256 of all of a posed model that a bake uses; the result waits for its hex.

    Small arrays are hashed together, as hashing releases Python's lock each time.
    """
    begun, sites, joints = names or digest_names(model)
    digest = begun.copy()
    left = bytearray()
    for number, array in enumerate(_digest_arrays(model, data, exact_meshes, sites, joints)):
        left += f"{number} {array.dtype.str} {array.shape}\n".encode()
        if array.nbytes > LARGE_ARRAY:
            digest.update(left)
            digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
            left = bytearray()
        else:
            left += array.tobytes()

    def finish() -> str:
        digest.update(left)
        return str(digest.hexdigest())

    return run_beside(finish) if len(left) > WORTH_THREAD else finish


def _digest_arrays(
    model: Any, data: Any, exact_meshes: dict[int, NamedMesh], *names: NDArray[np.uint8]
) -> Iterator[NDArray[Any]]:
    yield from (model.geom_type, model.geom_size, model.geom_dataid, model.geom_bodyid)
    yield from (model.geom_contype, model.geom_conaffinity, model.geom_group)
    yield from (model.geom_rgba, model.geom_matid, model.mat_rgba)
    yield from (data.geom_xpos, data.geom_xmat)
    yield from (model.body_parentid, model.body_weldid, model.body_mocapid)
    # before MuJoCo 4, its booleans were bytes
    is_limited = np.asarray(model.jnt_limited, dtype=np.bool_)
    yield from (model.jnt_type, model.jnt_bodyid, is_limited, model.jnt_range)
    yield from (model.jnt_pos, model.jnt_axis, model.jnt_qposadr, data.qpos)
    yield from (model.site_type, model.site_size, data.site_xpos, data.site_xmat)
    yield from names
    yield from (model.mesh_vertadr, model.mesh_faceadr, model.mesh_vert, model.mesh_face)
    yield from (model.mesh_graphadr, model.mesh_graph)
    yield from (model.hfield_nrow, model.hfield_ncol, model.hfield_size, model.hfield_data)
    for geom in sorted(exact_meshes):
        yield from (np.array([geom]), exact_meshes[geom].vertices, exact_meshes[geom].faces)
