"""Loads the scene that is baked: the geoms that count, with their shapes, poses and roles."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake import samples
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.readers.mesh import NamedMesh, measure_mesh_bounds
from navbake.baker.readers.parsed_scene import catch_warnings
from navbake.baker.scene.collect import (
    TYPE_NAMES,
    GeomSelection,
    MeshTriangles,
    collect_shapes,
    drawn_box_of_planes,
    select_geoms,
)
from navbake.baker.scene.hull_room import HullRoomTest
from navbake.baker.scene.leaves import DoorCandidate
from navbake.baker.scene.model import CompileLimits, SceneModel, load_isolated, load_model
from navbake.baker.scene.names import all_names, name_at, names_at
from navbake.baker.scene.pose import pose_model, warn_out_of_range
from navbake.baker.scene.roles import (
    LEAF,
    ROLE_NAMES,
    SceneRoles,
    find_actuated_bodies,
    find_roles,
    mark_structure,
)
from navbake.baker.scene.skies import find_skies
from navbake.config.settings import (
    AgentSettings,
    BakeConfig,
    SceneSettings,
    find_scene_stem,
)
from navbake.errors import SceneError
from navbake.files import hint_at_file
from navbake.formats.scene_files import SCENE_SUFFIXES, SDF_SUFFIXES, STAGE_SUFFIXES, XML_SUFFIXES
from navbake.formats.xml_files import find_root_tag
from navbake.known_names import append_hint, find_similar_names
from navbake.navgrid.user_data import without_garbage_collection
from navbake.threads import run_beside
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:
    import mujoco

# The attributes of a model that decide which geoms count, which shapes they have, and how large
# they are, in the order in which a scene's digest depends on them. Users may write to them between
# two updates.
GEOM_ATTRIBUTES = (
    "geom_type", "geom_size", "geom_dataid", "geom_bodyid", "geom_contype", "geom_conaffinity",
    "geom_group", "geom_rgba", "geom_matid", "mat_rgba",
)  # fmt: skip
MAX_COPIED_BYTES = 1 << 20  # larger arrays are hashed without a copy
# More bytes than this are hashed in a thread; fewer take no longer than the threads' taking turns
# at Python's global lock [bytes]
MIN_THREAD_BYTES = 1 << 19
# A scene that is higher or whose box has a longer side, or a scene whose box has only shorter
# sides, is probably not in metres [m]
MAX_SCENE_HEIGHT = 100.0
MAX_SCENE_SIDE = 5000.0
MIN_SCENE_SIDE = 0.5
METRES_HINT = "MuJoCo's unit is the metre: check the lengths, or the `scale` of its meshes"


class GeomReport(NamedTuple):
    """The report on one geom, as `navbake geoms` prints it: whether and how it is baked.

    Attributes:
        id: the geom's id in MuJoCo.
        name: the name that patterns match; ``geom <id>`` if it has none.
        body: the name of its body, or ``body <id>``.
        type: its type in MuJoCo: plane, hfield, sphere, capsule, ellipsoid, cylinder, box, mesh or
            sdf.
        counted: whether it takes part in the bake.
        shape: how it is represented; empty if it isn't counted. One of: solid; half-space, strip
            (infinite in one direction) or rectangle; hull, shell, surface, closed surface (its
            inside is occupied) or partly closed surface. The last two may state how many triangles
            were turned to face out.
        reason: why it is counted or left out.
        role: one of `roles.ROLE_NAMES`; empty if it isn't counted.
        group: its group in MuJoCo, 0 to 5.
    """

    id: int
    name: str
    body: str
    type: str
    counted: bool
    shape: str
    reason: str
    role: str = ""
    group: int = 0


@dataclass
class Scene:
    """A scene in the pose that is baked.

    Attributes:
        id: the scene's id, from the settings or the file name.
        geoms: for each geom, whether and how it is baked.
        shapes: the geometry of the geoms that count, world frame.
        bounds: lowest and highest x, y, z of all finite geoms of the structure, (2, 3) [m]. If all
            structure is endless planes, those of the rectangles that MuJoCo draws for the planes;
            None if it draws these endless, too.
        digest: sha256 of the posed model: its geoms, their poses, and how they can move.
        warnings: the warnings about the scene, one line each.
        hints: the warnings that say why there may be no floor: axes or units look wrong, or a sky
            is left out; `warnings` has them, too.
        model: the compiled model. It has a tetrahedron in place of each mesh of `exact_meshes`.
        data: the model's data in the pose that is baked.
        selections: for each geom, whether it counts and how it is represented.
        exact_meshes: geom id -> mesh in the world frame: the meshes that a model has only a
            tetrahedron for, see `SceneModel`.
        meshes: a cache of the triangles of the model's meshes, for geoms in other poses.
        roles: for each geom, its role: LEFT_OUT, STATIC_STRUCTURE, MOVING_STRUCTURE, MOVABLE or
            LEAF, (ngeom,), uint8.
        is_movable_body: for each body, whether it can move and carries no floor, (nbody,).
        is_structure_body: for each body, whether it is structure, (nbody,).
        mover_of_body: for each body, the id of the body that it moves with: of a movable body, its
            topmost movable ancestor or itself; of any other body, itself; (nbody,).
        actuated_bodies: ids of the bodies that actuators move. If such a body has a movable
            ancestor, the id of the topmost one stands for it.
        named_leaves: names of the bodies that are leaves of doors, as the scene's file says.
        leaves: the door candidates, ascending by body id.
        car_bodies: ids of the bodies that are cars of lifts, ascending.
        pattern_warnings: warnings of patterns of doors that match nothing, one line each.
    """

    id: str
    geoms: list[GeomReport]
    shapes: Shapes
    bounds: Float | None
    digest: str
    warnings: list[str]
    hints: list[str]
    model: mujoco.MjModel
    data: mujoco.MjData
    selections: list[GeomSelection]
    exact_meshes: dict[int, NamedMesh]
    meshes: MeshTriangles
    roles: NDArray[np.uint8]
    is_movable_body: Bool
    is_structure_body: Bool
    mover_of_body: Int
    actuated_bodies: frozenset[int]
    named_leaves: frozenset[str]
    leaves: list[DoorCandidate]
    car_bodies: list[int]
    pattern_warnings: list[str]

    @property
    def mover_of_geom(self) -> Int:
        """For each geom, the id of the body that it moves with, see `mover_of_body`, (ngeom,)."""
        mover_of_geom: Int = self.mover_of_body[self.model.geom_bodyid]
        return mover_of_geom

    @property
    def is_structure(self) -> Bool:
        """For each geom, whether it is structure, (ngeom,)."""
        return mark_structure(self.roles)

    @cached_property
    def structure(self) -> Shapes:
        """The geometry of the structure: of the geoms from which floors, walls and rooms come."""
        return self.shapes.only(self.is_structure)

    @property
    def has_open_mesh(self) -> bool:
        """Whether a mesh of `exact_meshes` is not closed."""
        if not self.exact_meshes:
            return False
        return any(
            geom.shape.startswith(("surface", "partly closed surface")) for geom in self.geoms
        )


class CountedGeoms(NamedTuple):
    """The geoms that count, with their geometry and roles.

    Attributes:
        selections: for each geom, whether it counts and how it is represented.
        shapes: the geometry of the geoms that count, world frame.
        shape_kinds: for the geoms that count: geom id -> how it is represented, in the words of
            `GeomReport.shape`.
        roles: the roles of geoms and bodies.
        warnings: messages of one line.
        sky_warnings: those of `warnings` that name skies that are left out, at most one.
    """

    selections: list[GeomSelection]
    shapes: Shapes
    shape_kinds: dict[int, str]
    roles: SceneRoles
    warnings: list[str]
    sky_warnings: list[str]


def load_scene(
    config: BakeConfig,
    *,
    limits: CompileLimits | None = None,
    scene_model: SceneModel | None = None,
) -> Scene:
    """Load a scene, pose it, select the geoms that count, and find their roles.

    Args:
        config: all settings.
        limits: limits for MuJoCo's compiler, which then runs in a child process; None to compile in
            this process, without limits.
        scene_model: the compiled model; None to load the file that `config` names.

    Returns:
        The posed scene.

    Raises:
        ConfigError: a setting does not fit the scene.
        SceneError: the scene cannot be read, or no geom counts.
    """
    if scene_model is None:
        scene_model = load_scene_file(config, limits)
    with without_garbage_collection():  # not while a file is compiled, which may take long
        return _pose_scene(scene_model, config)


def _pose_scene(scene_model: SceneModel, config: BakeConfig) -> Scene:
    """Pose a compiled model, select the geoms that count, and find their roles."""
    settings = config.scene
    model = scene_model.model
    exact_meshes = scene_model.exact_meshes
    with catch_warnings() as pose_warnings:
        data = pose_model(model, settings) if scene_model.data is None else scene_model.data
    wait_for_digest = run_beside(lambda: start_hashing(model, data, exact_meshes)())
    meshes = MeshTriangles(model)
    try:
        counted_geoms = _count_geoms(scene_model, data, meshes, config)
    except SceneError as error:
        raise SceneError(f"{error}, in {settings.path}") from error
    roles = counted_geoms.roles
    _check_any_counts(counted_geoms.selections, scene_model.ground_geom, settings)
    structure = counted_geoms.shapes.only(mark_structure(roles.roles))
    bounds = structure.bounds
    if bounds is None:
        bounds = drawn_box_of_planes(model, data, structure.planes.geom.tolist())
    model_warnings = [
        " ".join(warning.split()) for warning in [*scene_model.warnings, *pose_warnings]
    ]
    model_warnings += warn_out_of_range(model, settings)
    size_warnings = _warn_size(settings, exact_meshes, bounds)
    hints = [text for text in model_warnings if exact_meshes and "`scene.up" in text]
    return Scene(
        id=settings.id or find_scene_stem(settings.path),
        geoms=_report_geoms(model, counted_geoms),
        shapes=counted_geoms.shapes,
        bounds=bounds,
        digest=wait_for_digest(),
        warnings=[
            *model_warnings,
            *_warn_unused_geometry(model),
            *_warn_lost_objects(model),
            *_warn_unused_settings(settings, exact_meshes),
            *size_warnings,
            *counted_geoms.warnings,
            *roles.warnings,
        ],
        hints=[*hints, *size_warnings, *counted_geoms.sky_warnings],
        model=model,
        data=data,
        selections=counted_geoms.selections,
        exact_meshes=exact_meshes,
        meshes=meshes,
        roles=roles.roles,
        is_movable_body=roles.is_movable_body,
        is_structure_body=roles.is_structure_body,
        mover_of_body=roles.mover_of_body,
        actuated_bodies=frozenset(roles.mover_of_body[[*find_actuated_bodies(model)]].tolist()),
        named_leaves=scene_model.named_leaves,
        leaves=roles.leaves,
        car_bodies=roles.car_bodies,
        pattern_warnings=roles.pattern_warnings,
    )


def load_scene_file(config: BakeConfig, limits: CompileLimits | None = None) -> SceneModel:
    """Load and compile the scene file that the settings name.

    Args:
        config: all settings, of which `scene` says how to read the file.
        limits: limits for MuJoCo's compiler, which then runs in a child process; None to compile in
            this process, without limits.

    Returns:
        The compiled model.

    Raises:
        SceneError: the file is missing or broken.
        ConfigError: a setting does not fit the file.
    """
    _check_scene_exists(config)
    with catch_warnings() as warnings:
        if limits is None:
            return load_model(config.scene, warnings)
        return load_isolated(config.scene, limits, warnings)


def _check_scene_exists(config: BakeConfig) -> None:
    """Raise a SceneError if there is no scene file; it names what the user may have meant."""
    path = Path(config.scene.path)
    try:
        if path.exists():
            return
    except OSError as error:  # as for a name that is too long
        raise SceneError(f"cannot read {path}: {error.strerror or error}") from error
    hint = hint_at_file(path, SCENE_SUFFIXES)
    near_samples = find_similar_names(path, samples.names())
    if not hint and near_samples:
        hint = f"did you mean the sample {near_samples[0]!r}?"
    message = f"no scene file at {path}"
    if config.settings_file:
        message += f" (`scene.path` in {config.settings_file})"
    raise SceneError(
        append_hint(message, hint), path=str(path), key="scene.path", hint=hint or None
    )


def _count_geoms(
    scene_model: SceneModel, data: mujoco.MjData, meshes: MeshTriangles, config: BakeConfig
) -> CountedGeoms:
    """Select the geoms that count, and find their roles.

    `scene.exclude.movable` leaves out movables except door candidates. So roles are found twice:
    with all geoms, then without the movables.
    """
    hull_room = HullRoomTest(scene_model.model, data, meshes, config.agent, config.floors)
    no_left_out_bodies = np.zeros(scene_model.model.nbody, dtype=np.bool_)
    counted_geoms = _count_geoms_without(no_left_out_bodies, scene_model, hull_room, config)
    if config.scene.exclude.movable:
        roles = counted_geoms.roles
        is_left_out_body = roles.is_movable_body.copy()
        is_left_out_body[scene_model.model.geom_bodyid[roles.roles == LEAF]] = False
        counted_geoms = _count_geoms_without(is_left_out_body, scene_model, hull_room, config)
    return counted_geoms


def _count_geoms_without(
    is_left_out_body: Bool, scene_model: SceneModel, hull_room: HullRoomTest, config: BakeConfig
) -> CountedGeoms:
    """Select the geoms that count, and find their roles.

    Args:
        is_left_out_body: for each body, whether its geoms are left out, (nbody,).
        scene_model: the compiled model.
        hull_room: tells what the hull of a mesh hides; it also has the model and its pose.
        config: all settings.
    """
    model = hull_room.model
    data = hull_room.data
    exact_meshes = scene_model.exact_meshes
    selections, selection_warnings = select_geoms(
        model,
        config.scene,
        find_hidden=hull_room.find_hidden,
        is_left_out_body=is_left_out_body,
        ground_geom=scene_model.ground_geom,
        file_mesh_modes={geom: mesh.mode for geom, mesh in exact_meshes.items()},
    )
    sky_warnings = list[str]()
    if config.scene.geoms == "auto":
        sky_warnings = _leave_out_skies(model, data, selections, config.agent)
    shapes, shape_kinds, shape_warnings = collect_shapes(
        model, data, selections, exact_meshes, meshes=hull_room.meshes
    )
    roles = find_roles(
        model,
        data,
        shapes=shapes,
        is_counted=np.array([selection.is_counted for selection in selections], dtype=np.bool_),
        named_leaves=scene_model.named_leaves,
        config=config,
    )
    return CountedGeoms(
        selections=selections,
        shapes=shapes,
        shape_kinds=shape_kinds,
        roles=roles,
        warnings=[*selection_warnings, *sky_warnings, *shape_warnings],
        sky_warnings=sky_warnings,
    )


def _leave_out_skies(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    selections: list[GeomSelection],
    agent: AgentSettings,
) -> list[str]:
    """Leave out the skies of a scene, see `find_skies`; return a warning that names them.

    Their entries in `selections`, one for each geom, are changed.
    """
    is_counted = np.array([selection.is_counted for selection in selections], dtype=np.bool_)
    sky_geoms = find_skies(model, data, is_counted, min_room=agent.height)
    for geom in sky_geoms:
        selections[geom] = selections[geom]._replace(is_counted=False, reason="encloses everything")
    if not sky_geoms:
        return []
    names = ", ".join(repr(all_names(model).geoms[geom].geom) for geom in sky_geoms)
    return [
        f"left out, because everything else lies inside of this solid, as under a sky: {names}; "
        f"`scene.geoms: all` counts it, `scene.exclude.geoms` silences this"
    ]


def _check_any_counts(
    selections: list[GeomSelection], ground_geom: int | None, settings: SceneSettings
) -> None:
    """Raise a SceneError if no geom counts, except the ground that `scene.ground` adds."""
    scene_selections = [
        selection for geom, selection in enumerate(selections) if geom != ground_geom
    ]
    if not scene_selections:
        raise SceneError(f"{settings.path} has no geoms: nothing to bake")
    if not any(selection.is_counted for selection in scene_selections):
        reasons = "; ".join(sorted({selection.reason for selection in scene_selections})[:3])
        problem_text = f"none of the {len(scene_selections)} geoms of {settings.path} counts"
        raise SceneError(f"{problem_text} (`scene.geoms` is {settings.geoms}): {reasons}")


def _report_geoms(model: mujoco.MjModel, counted_geoms: CountedGeoms) -> list[GeomReport]:
    geom_types = model.geom_type.tolist()
    groups = model.geom_group.tolist()
    roles = counted_geoms.roles.roles
    reports = []
    for geom, names in enumerate(all_names(model).geoms):
        selection = counted_geoms.selections[geom]
        reports.append(
            GeomReport(
                id=geom,
                name=names.geom,
                body=names.body,
                type=TYPE_NAMES.get(geom_types[geom], "unknown"),
                counted=selection.is_counted,
                shape=counted_geoms.shape_kinds.get(geom, ""),
                reason=selection.reason,
                role=ROLE_NAMES[roles[geom]],
                group=groups[geom],
            )
        )
    return reports


# ---------------------------------------------------------------- warnings


def _warn_unused_geometry(model: mujoco.MjModel) -> list[str]:
    """Warn of geometry that can't be baked: flexes and skins."""
    warnings = []
    for object_type, addresses in (("flex", model.name_flexadr), ("skin", model.name_skinadr)):
        if len(addresses):
            names = [
                name_at(model, address) or f"{object_type} {object_id}"
                for object_id, address in enumerate(addresses)
            ]
            warnings.append(f"{object_type} can't be baked and is left out: {', '.join(names)}")
    return warnings


def _warn_lost_objects(model: mujoco.MjModel) -> list[str]:
    """Warn of OBJ files with several objects: MuJoCo only takes the faces of the first object."""
    warnings = []
    for mesh, address in enumerate(model.mesh_pathadr.tolist()):
        if address < 0:
            continue
        path = model.paths[address:].split(b"\0", 1)[0].decode(errors="replace")
        if not path.lower().endswith(".obj"):
            continue
        first_vertex = int(model.mesh_vertadr[mesh])
        first_face = int(model.mesh_faceadr[mesh])
        vertices = model.mesh_vert[first_vertex : first_vertex + int(model.mesh_vertnum[mesh])]
        faces = model.mesh_face[first_face : first_face + int(model.mesh_facenum[mesh])]
        has_face = np.zeros(len(vertices), dtype=np.bool_)
        has_face[faces.ravel()] = True
        if has_face.all():
            continue
        lost_vertices = vertices[~has_face]
        side_lengths = np.ptp(lost_vertices, axis=0)
        if np.count_nonzero(side_lengths) < 2:  # spare points, and no object
            continue
        size_text = " x ".join(f"{side_length:.3g}" for side_length in side_lengths)
        name = name_at(model, int(model.name_meshadr[mesh])) or Path(path).stem
        warnings.append(
            f"mesh {name!r}: {len(lost_vertices)} of {len(vertices)} vertices have no face, and "
            f"span {size_text} m: of an OBJ with several objects, MuJoCo takes the faces of the "
            f"first alone; join the objects of {path}, or write a file for each"
        )
    return warnings


def _warn_unused_settings(settings: SceneSettings, exact_meshes: dict[int, NamedMesh]) -> list[str]:
    """Warn of settings that have no effect because they are for scene files of other formats.

    `scene.up` and `scene.unit` are for mesh files and USD stages; other scenes state their own axes
    and units. `scene.strict` and `scene.model_path` are for files that name others.
    """
    suffix = Path(settings.path).suffix.lower()
    warnings = []
    is_mesh_file = bool(exact_meshes) and suffix not in SDF_SUFFIXES
    if not is_mesh_file and suffix not in STAGE_SUFFIXES:
        if settings.up not in ("auto", "z"):
            warnings.append("`scene.up` is for mesh files and does nothing here")
        if settings.unit != 1.0:
            warnings.append("`scene.unit` is for mesh files and does nothing here")
    if settings.strict and suffix not in SDF_SUFFIXES:
        warnings.append("`scene.strict` (`--strict`) is for SDF and does nothing here")
    if settings.model_path and suffix not in SDF_SUFFIXES and not _is_urdf(Path(settings.path)):
        warnings.append(
            "`scene.model_path` (`--model-path`) is for SDF and URDF and does nothing here"
        )
    return warnings


def _is_urdf(path: Path) -> bool:
    """Return whether a path names a URDF, by its root tag."""
    is_xml_file = path.suffix.lower() in XML_SUFFIXES and path.is_file()
    return is_xml_file and find_root_tag(path.read_bytes()) == "robot"


def _warn_size(
    settings: SceneSettings, exact_meshes: dict[int, NamedMesh], bounds: Float | None
) -> list[str]:
    """Warn of a scene that is so small or large that its unit is probably not the metre."""
    if bounds is None or "unit" in settings.model_fields_set:
        return []
    suffix = Path(settings.path).suffix.lower()
    # SDF and USD have a known unit.
    has_known_unit = suffix in SDF_SUFFIXES | STAGE_SUFFIXES
    is_mesh_file = bool(exact_meshes) and not has_known_unit
    bounds_to_check = measure_mesh_bounds(exact_meshes.values()) if is_mesh_file else bounds
    side_lengths = np.diff(bounds_to_check, axis=0)[0]
    longest_side = float(side_lengths.max())
    height = float(side_lengths[2])
    if longest_side < MIN_SCENE_SIDE:
        hint = METRES_HINT
        if suffix in STAGE_SUFFIXES:
            hint = "check its metersPerUnit, or set `scene.unit` (1 takes metres)"
        if is_mesh_file:
            unit_text = "the metres that one unit of it is, as 1000 for kilometres"
            hint = f"set `scene.unit` to {unit_text} (1 silences this)"
        scene_type = "mesh" if is_mesh_file else "scene"
        return [f"the {scene_type} is only {longest_side:.6g} m large: {hint}"]
    if not has_known_unit and (height > MAX_SCENE_HEIGHT or longest_side > MAX_SCENE_SIDE):
        size_text = f"{longest_side:.6g} m large"
        if height > MAX_SCENE_HEIGHT:
            size_text = f"{height:.6g} m high"
        if not is_mesh_file:
            return [f"the scene is {size_text}: {METRES_HINT} (`scene.unit: 1` silences this)"]
        hint = (
            "if it is in centimetres, set `scene.unit` to 0.01, in inches to 0.0254, in "
            "millimetres to 0.001"
        )
        return [f"the mesh is {size_text}: {hint} (1 silences this)"]
    return []


def describe_unit(scene: Scene, settings: SceneSettings) -> str:
    """Say how to check the unit of a scene: by `scene.unit` where its file has no fixed unit."""
    suffix = Path(settings.path).suffix.lower()
    has_unit_setting = scene.exact_meshes or suffix in STAGE_SUFFIXES
    if has_unit_setting and suffix not in SDF_SUFFIXES:
        return "check the scene's unit (`scene.unit`)"
    return METRES_HINT


# ---------------------------------------------------------------- digest


class DigestedModel(NamedTuple):
    """The parts of a scene's digest that no pose changes.

    Attributes:
        geom_hash: a hash object that was fed what each digest begins with: the geoms' names, and
            the arrays of `GEOM_ATTRIBUTES`.
        sites: the names of sites, as bytes, (n,).
        joints: the names of joints, as bytes, (n,).
    """

    geom_hash: hashlib._Hash
    sites: NDArray[np.uint8]
    joints: NDArray[np.uint8]


def digest_model(model: mujoco.MjModel) -> DigestedModel:
    """Compute the parts of a scene's digest that no pose changes.

    They are to be computed again when an attribute of `GEOM_ATTRIBUTES` was written to.
    """
    geom_hash = hashlib.sha256()
    for names in all_names(model).geoms:
        geom_hash.update("\0".join(names).encode() + b"\n")
    geom_arrays = [getattr(model, attribute) for attribute in GEOM_ATTRIBUTES]
    geom_hash.update(_hash_large_arrays(geom_hash, geom_arrays, first_number=0))
    return DigestedModel(
        geom_hash=geom_hash,
        sites=_join_names(model, model.name_siteadr),
        joints=_join_names(model, model.name_jntadr),
    )


def _join_names(model: mujoco.MjModel, addresses: Int32) -> NDArray[np.uint8]:
    names = names_at(model, addresses.tolist())
    return np.frombuffer("\0".join(names).encode(), dtype=np.uint8)


def start_hashing(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    exact_meshes: dict[int, NamedMesh],
    digested_model: DigestedModel | None = None,
) -> Callable[[], str]:
    """Start to compute the sha256 of everything in a posed model that a bake depends on.

    Args:
        model: the model.
        data: the model's pose.
        exact_meshes: geom id -> mesh in the world frame, for the meshes that the model has only a
            tetrahedron for.
        digested_model: the parts of the digest that no pose changes; computed if None.

    Returns:
        A function that waits for the digest, and returns it as hexadecimal digits.
    """
    if digested_model is None:
        digested_model = digest_model(model)
    digest = digested_model.geom_hash.copy()
    pending_bytes = _hash_large_arrays(
        digest,
        _posed_arrays(model, data, exact_meshes, digested_model),
        first_number=len(GEOM_ATTRIBUTES),
    )

    def finish() -> str:
        digest.update(pending_bytes)
        return str(digest.hexdigest())

    return run_beside(finish) if len(pending_bytes) > MIN_THREAD_BYTES else finish


def _hash_large_arrays(
    digest: hashlib._Hash, arrays: Iterable[NDArray[np.generic]], first_number: int
) -> bytes:
    """Feed arrays to a hash object: up to the last large one, and return the bytes of the rest.

    Small arrays are joined, because each call of a hash function releases Python's global lock.

    Args:
        digest: the hash object.
        arrays: the arrays.
        first_number: the number of the first array in the digest.
    """
    pending_buffers = list[bytes | memoryview]()
    for array_number, array in enumerate(arrays, first_number):
        pending_buffers.append(f"{array_number} {array.dtype.str} {array.shape}\n".encode())
        if array.nbytes > MAX_COPIED_BYTES:
            digest.update(b"".join(pending_buffers))
            digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
            pending_buffers = []
        else:
            pending_buffers.append(np.ascontiguousarray(array).data)
    return b"".join(pending_buffers)


def _posed_arrays(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    exact_meshes: dict[int, NamedMesh],
    digested_model: DigestedModel,
) -> Iterator[NDArray[np.generic]]:
    """Yield the arrays of a posed model that follow in a digest, which depends on their order."""
    yield from (data.geom_xpos, data.geom_xmat)
    yield from (model.body_parentid, model.body_weldid, model.body_mocapid)
    # Before MuJoCo 4, its booleans were bytes.
    is_limited = np.asarray(model.jnt_limited, dtype=np.bool_)
    yield from (model.jnt_type, model.jnt_bodyid, is_limited, model.jnt_range)
    yield from (model.jnt_pos, model.jnt_axis, model.jnt_qposadr, data.qpos)
    yield from (model.site_type, model.site_size, data.site_xpos, data.site_xmat)
    yield from (digested_model.sites, digested_model.joints)
    yield from (model.mesh_vertadr, model.mesh_faceadr, model.mesh_vert, model.mesh_face)
    yield from (model.mesh_graphadr, model.mesh_graph)
    yield from (model.hfield_nrow, model.hfield_ncol, model.hfield_size, model.hfield_data)
    for geom in sorted(exact_meshes):
        yield from (np.array([geom]), exact_meshes[geom].vertices, exact_meshes[geom].faces)
