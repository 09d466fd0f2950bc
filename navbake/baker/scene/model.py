"""Loads scene files and scenes in memory as compiled MuJoCo models.

Files are MJCF, URDF, MJB, meshes, and scenes that a reader parses (USD, SDF, Open-RMF's buildings).

If MuJoCo's compiler crashes, its process ends; and Python can't interrupt the compiler.
`load_isolated` runs it in a child process, so that a crash, or a compilation that takes too long,
is an error.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import mujoco
import numpy as np

from navbake.baker.readers.mesh import (
    NamedMesh,
    convert_trimesh,
    is_mesh_scene,
    join_meshes,
    read_named_meshes,
)
from navbake.baker.readers.orientation import orient_meshes
from navbake.baker.readers.parsed_scene import (
    build_model,
    build_model_of_meshes,
    catch_warnings,
    compile_geometry,
    compile_model,
    compile_spec,
    convert_read_errors,
    fill_mesh,
)
from navbake.baker.scene.names import name_at
from navbake.baker.scene.pose import data_with_joints
from navbake.config.settings import BakeConfig, SceneSettings
from navbake.errors import ConfigError, NavbakeError, SceneError
from navbake.files import scratch_folder
from navbake.formats.package_paths import RosPackages
from navbake.formats.scene_files import (
    BUILDING_SUFFIXES,
    MESH_SUFFIXES,
    MJB_SUFFIX,
    SCENE_SUFFIXES,
    SDF_SUFFIXES,
    STAGE_SUFFIXES,
    XML_SUFFIXES,
    check_inputs,
    list_mesh_paths,
    scene_suffix,
)
from navbake.formats.xml_files import find_root_tag, parse_xml
from navbake.known_names import list_first, unique_name
from navbake.lazy import resolve
from navbake.mujoco_types import MjDataLike, MjModelLike, MjSpecLike
from navbake.processes import (
    describe_exit,
    end_with_parent,
    give_back_memory,
    is_lack_of_memory,
    limit_memory,
)

if TYPE_CHECKING:
    import trimesh
    from typing_extensions import TypeIs  # `typing` has it from Python 3.13 on

SceneInMemory: TypeAlias = "MjModelLike | MjSpecLike | trimesh.Scene | trimesh.Trimesh"
"""A scene that is not in a file: a model, a spec or meshes."""

SceneInput: TypeAlias = "SceneInMemory | BakeConfig | str | PathLike[str] | Mapping[str, object]"
"""A scene in memory; settings; or the path of a scene or of a YAML file with settings."""

# File suffix -> function that reads such a file as a `ParsedScene`
READERS = dict.fromkeys(STAGE_SUFFIXES, "navbake.baker.readers.usd:read_stage")
READERS |= dict.fromkeys(SDF_SUFFIXES, "navbake.baker.readers.sdf:read_world")
READERS |= dict.fromkeys(BUILDING_SUFFIXES, "navbake.baker.readers.building:read_building")
# File suffix, of formats that navbake doesn't read -> what the user can do
CONVERSIONS = {
    ".fbx": "convert it first, by `assimp export SCENE.fbx SCENE.glb` (Debian's assimp-utils)",
    ".ifc": "convert it first, by ifcopenshell (pip install ifcopenshell), as docs/scenes.md shows",
}
XML_ERRORS = (ElementTree.ParseError, ValueError, LookupError)
DEFAULT_MODEL_NAME = "MuJoCo Model"  # MuJoCo's default name of a model
# Memory that was freed is given back after a model of at least this size was compiled [bytes]
LARGE_MODEL_SIZE = 1 << 24
# Sizes that a MjData and a model must have in common: the places of geoms depend on them
POSE_SIZES = ("nq", "nmocap", "nbody", "ngeom")

# The child gets this process's sys.path before it imports anything. By default, ``python -c``
# imports from the current folder, which can't be trusted: it may contain the scene.
CHILD_CODE = (
    "import sys; sys.path[:] = {path!r}; "
    "from navbake.baker.scene.model import compile_job; compile_job(sys.argv[1])"
)
IMPORT_SECONDS = 120.0  # extra time for the child to start and to end on a busy machine [s]
ALARM_SIGNAL = int(getattr(signal, "SIGALRM", 14))
# The files through which the parent and the child process exchange a scene
JOB_FILE = "job.pickle"
MODEL_FILE = "model.mjb"
RESULT_FILE = "result.pickle"
STARTED_FILE = "started"  # the child creates it when it begins to compile


def mujoco_version() -> str:
    """Return the version of the installed MuJoCo."""
    return str(mujoco.__version__)


class SceneModel(NamedTuple):
    """The compiled model of a scene, before the geoms that count are selected.

    Attributes:
        model: the model. It has a tetrahedron in place of each mesh of `exact_meshes`.
        exact_meshes: geom id -> mesh in the world frame: the meshes of a mesh file, or those of a
            parsed scene that never move.
        ground_geom: id of the geom that `scene.ground` adds; None if there is none.
        warnings: warnings of MuJoCo and of the reader.
        data: the model's pose; None if the settings define it.
        named_leaves: names of the bodies that are leaves of doors, as the file says.
    """

    model: mujoco.MjModel
    exact_meshes: dict[int, NamedMesh]
    ground_geom: int | None
    warnings: list[str]
    data: mujoco.MjData | None = None
    named_leaves: frozenset[str] = frozenset()


def load_model(settings: SceneSettings, warnings: list[str]) -> SceneModel:
    """Load and compile a scene file.

    The ground that `scene.ground` asks for is added as an endless plane on a new body. Both come
    last, so that the ids of all others stay the same.

    Args:
        settings: the scene's path, and how to read it.
        warnings: the list of `catch_warnings`, which receives the warnings of MuJoCo and of the
            reader. If MuJoCo fails, the error quotes them.

    Returns:
        The compiled model.

    Raises:
        SceneError: the file is missing or broken, or navbake doesn't read its format.
        ConfigError: `scene.ground` can't be added.
    """
    path = Path(settings.path)
    ground_height = settings.ground
    exact_meshes: dict[int, NamedMesh] = {}
    named_leaves = frozenset[str]()
    suffix = scene_suffix(path)
    try:
        if not path.exists():
            raise SceneError(f"no scene file at {path}", path=str(path), key="scene.path")
        if not path.is_file():
            path_type = "folder" if path.is_dir() else "device"
            raise SceneError(f"expected a scene file, got a {path_type} at {path}")
        if suffix in MESH_SUFFIXES:
            read_meshes = partial(read_named_meshes, path, unit=settings.unit, warnings=warnings)
            meshes = orient_meshes(read_meshes, settings, warnings)
            model, exact_meshes = build_model_of_meshes(meshes, path, ground_height, warnings)
        elif suffix == MJB_SUFFIX:
            model = _load_binary(path, ground_height, warnings)
        elif suffix in XML_SUFFIXES:
            check_inputs(path, settings.model_path)
            model = _load_xml(settings, warnings)
        elif suffix in READERS:
            with convert_read_errors(str(path)):
                parsed_scene = resolve(READERS[suffix])(path, settings)
                model, exact_meshes = build_model(parsed_scene, path, ground_height, warnings)
            named_leaves = frozenset(parsed_scene.named_leaves)
        elif suffix in CONVERSIONS:
            raise SceneError(f"cannot read {path}: {CONVERSIONS[suffix]}")
        else:
            suffixes = ", ".join(sorted(SCENE_SUFFIXES))
            raise SceneError(f"cannot tell what {path} is: expected one of {suffixes}")
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror or error}") from error
    if model.nbuffer >= LARGE_MODEL_SIZE:
        give_back_memory()  # what the compiler freed is several times as large as the model
    ground_geom = find_ground(model, settings)
    return SceneModel(model, exact_meshes, ground_geom, warnings, named_leaves=named_leaves)


def _load_binary(path: Path, ground: float | None, warnings: list[str]) -> mujoco.MjModel:
    if ground is not None:
        hint = f"bake the XML that {path} was made of"
        raise ConfigError(f"`scene.ground` can't be added to an MJB: {hint}")
    version_hint = f"this is {mujoco_version()}: save it again, or bake its XML"
    hint = f" (an MJB fits only the MuJoCo that wrote it, {version_hint})"
    load_file = partial(mujoco.MjModel.from_binary_path, str(path))
    return compile_model(path, warnings, load_file, hint)


class CompileLimits(NamedTuple):
    """The time and memory that MuJoCo may take to compile a scene.

    Attributes:
        seconds: the time limit [s].
        memory: the memory that it may reserve, besides what the process has at its start [GiB];
            only limited on Linux.
    """

    seconds: float = 60.0
    memory: float = 4.0


class CompileResult(NamedTuple):
    """The values that the child process returns besides the model's file.

    Attributes:
        warnings: warnings of MuJoCo and of the reader.
        error: the reason that there is no model; None if there is one.
        exact_meshes: geom id -> mesh in the world frame, for the meshes that the model has only a
            tetrahedron for.
        named_leaves: names of the bodies that are leaves of doors, as the file says.
    """

    warnings: list[str]
    error: Exception | None
    exact_meshes: dict[int, NamedMesh]
    named_leaves: frozenset[str]


def load_isolated(
    settings: SceneSettings, limits: CompileLimits, warnings: list[str]
) -> SceneModel:
    """Load a scene file in a child process, which returns the model as an MJB file.

    Args:
        settings: the scene's path, and how to read it.
        limits: the time and memory that the child may take.
        warnings: the list to which the warnings of MuJoCo and of the reader are added.

    Returns:
        The compiled model.

    Raises:
        SceneError: see `load_model`; or MuJoCo crashed, or took too long.
        ConfigError: see `load_model`.
        NavbakeError: the child process does not start.
    """
    scene_path = Path(settings.path)
    with scratch_folder() as folder:
        (folder / JOB_FILE).write_bytes(pickle.dumps((settings, limits)))
        import_folders = [import_folder or os.getcwd() for import_folder in sys.path]
        command = [sys.executable, "-c", CHILD_CODE.format(path=import_folders), str(folder)]
        max_seconds = limits.seconds + IMPORT_SECONDS  # except on Windows, the child ends earlier
        try:
            exit_status = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=max_seconds,
            ).returncode
        except subprocess.TimeoutExpired:
            exit_status = -ALARM_SIGNAL
        if exit_status == -ALARM_SIGNAL:
            hint = "make the scene smaller, or give it more time"
            raise SceneError(
                f"MuJoCo did not compile {scene_path} within {limits.seconds:g} s: {hint}"
            )
        exit_text = f"({describe_exit(exit_status)})"
        if not (folder / STARTED_FILE).exists():
            hint = f"does {sys.executable!r} find navbake?"
            raise NavbakeError(
                f"cannot start a process to compile {scene_path} in {exit_text}: {hint}"
            )
        if not (folder / RESULT_FILE).exists():
            demand_text = (
                f"too much, or for more than {limits.memory:g} GiB of memory, or is broken"
            )
            reason = f"the scene asks for {demand_text}"
            raise SceneError(f"MuJoCo crashed as it compiled {scene_path} {exit_text}: {reason}")
        result: CompileResult = pickle.loads((folder / RESULT_FILE).read_bytes())
        warnings += result.warnings
        if result.error is not None:
            raise result.error
        model = mujoco.MjModel.from_binary_path(str(folder / MODEL_FILE))
    return SceneModel(
        model=model,
        exact_meshes=result.exact_meshes,
        ground_geom=find_ground(model, settings),
        warnings=warnings,
        named_leaves=result.named_leaves,
    )


def compile_job(job_folder: str) -> None:
    """Compile a scene in the child process of `load_isolated`, and write the model or the error.

    Args:
        job_folder: the folder with the job's file, in which the result is written.
    """
    folder = Path(job_folder)
    settings, limits = pickle.loads((folder / JOB_FILE).read_bytes())
    limit_memory(limits.memory)
    end_with_parent()
    (folder / STARTED_FILE).touch()
    if hasattr(signal, "setitimer"):  # its signal ends this process, even inside MuJoCo
        signal.setitimer(signal.ITIMER_REAL, limits.seconds)
    failure: Exception | None = None
    exact_meshes: dict[int, NamedMesh] = {}
    named_leaves = frozenset[str]()
    with catch_warnings() as warnings:
        try:
            scene_model = load_model(settings, warnings)
            exact_meshes = scene_model.exact_meshes
            named_leaves = scene_model.named_leaves
            mujoco.mj_saveModel(scene_model.model, str(folder / MODEL_FILE), None)
        except Exception as error:
            if not is_lack_of_memory(error) and not isinstance(error, NavbakeError):
                raise
            message = f"{settings.path} needs more than {limits.memory:g} GiB of memory"
            failure = SceneError(message) if is_lack_of_memory(error) else error
    result = CompileResult(warnings, failure, exact_meshes, named_leaves)
    (folder / RESULT_FILE).write_bytes(pickle.dumps(result))


def limit_mesh_cache(num_bytes: int) -> None:
    """Limit the size of MuJoCo's cache of mesh files, which all scenes of the process share.

    Args:
        num_bytes: the largest size of the cache [bytes].
    """
    mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), num_bytes)


def find_ground(model: mujoco.MjModel, settings: SceneSettings) -> int | None:
    """Return the id of the geom that `scene.ground` adds, the model's last; None if there is none.

    Args:
        model: the compiled model.
        settings: the settings with which it was loaded.
    """
    return None if settings.ground is None else int(model.ngeom) - 1


# ---------------------------------------------------------------- MJCF and URDF


def _load_xml(settings: SceneSettings, warnings: list[str]) -> mujoco.MjModel:
    path = Path(settings.path)
    if path.stat().st_size == 0:
        raise SceneError(f"{path} is empty: expected an MJCF or URDF scene")
    root_tag = ""
    with suppress(*XML_ERRORS):
        root_tag = str(next(ElementTree.iterparse(path, events=("start",)))[1].tag)
    if not root_tag or root_tag.startswith("{"):  # Python's parser fails, or knows a namespace
        root_tag = find_root_tag(path.read_bytes())
    if root_tag == "robot":
        return _load_urdf(path, settings, warnings)
    if root_tag not in ("mujoco", ""):
        raise SceneError(f"expected <mujoco> or <robot> in {path}, got <{root_tag[:40]}>")
    # MuJoCo's parser decides what is MJCF; Python's may be stricter.
    try:
        return compile_model(path, warnings, lambda: _load_mjcf(path, settings.ground, warnings))
    except SceneError as error:
        try:
            ElementTree.parse(path)
        except XML_ERRORS as xml_error:  # it says more exactly where the XML is broken
            raise SceneError(f"broken XML in {path}: {xml_error}") from error
        raise


def _load_mjcf(path: Path, ground: float | None, warnings: list[str]) -> mujoco.MjModel:
    if path.suffix == ".xml":
        spec = mujoco.MjSpec.from_file(str(path))
        _drop_missing_textures(spec, path, warnings)
        return compile_spec(spec, ground, warnings)
    if ground is not None:  # MjSpec only reads files that end in .xml
        raise ConfigError(f"`scene.ground` can't be added to {path}: let its name end in .xml")
    return mujoco.MjModel.from_xml_path(str(path))


def _load_urdf(path: Path, settings: SceneSettings, warnings: list[str]) -> mujoco.MjModel:
    """Load a URDF; its meshes are read by `read_named_meshes`, which reads all mesh formats."""
    packages = RosPackages(settings.model_path)
    urdf_text, mesh_files = read_urdf(path, settings.geoms, warnings, packages)

    def build_urdf_model() -> mujoco.MjModel:
        spec = mujoco.MjSpec.from_string(urdf_text)
        read_mesh_file = cache(
            lambda mesh_key: read_named_meshes(mesh_files[mesh_key], warnings=warnings)
        )
        for mesh in spec.meshes:
            vertices, faces = join_meshes(read_mesh_file(mesh.file))
            mesh.file = ""
            fill_mesh(mesh, vertices, faces)
        return compile_geometry(spec, settings.ground, warnings)

    return compile_model(path, warnings, build_urdf_model)


def _drop_missing_textures(spec: mujoco.MjSpec, path: Path, warnings: list[str]) -> None:
    """Replace textures whose files are missing by plain ones, with a warning.

    No bake needs textures.
    """
    missing_files = list[str]()
    folders = [path.parent / spec.texturedir, path.parent]
    for texture in spec.textures:
        texture_files = [name for name in (texture.file, *texture.cubefiles) if name]
        missing_names = [
            name
            for name in texture_files
            if not any((folder / name).is_file() for folder in folders)
        ]
        if spec.strippath:
            missing_names = [
                name for name in missing_names if not (folders[0] / Path(name).name).is_file()
            ]
        if missing_names:
            missing_files += missing_names
            texture.file = ""
            texture.cubefiles = [""] * len(texture.cubefiles)
            texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = 1
            texture.height = 1
    if missing_files:
        names_text = list_first([repr(name) for name in missing_files])
        warnings.append(f"texture {names_text} of {path} not found: drawn plain")


def read_urdf(
    path: Path,
    geoms_setting: str = "auto",
    warnings: list[str] | None = None,
    packages: RosPackages | None = None,
) -> tuple[str, dict[str, Path]]:
    """Read a URDF: its XML for MuJoCo, and the files of its meshes.

    Unless the file's own ``<mujoco><compiler_element/>`` says otherwise, visuals are kept, and
    links on fixed joints keep their own bodies and names. MuJoCo would do neither.

    A visual with a missing mesh is left out, with a warning, if visuals don't count: because the
    file discards them, or because the file has collision geometry and `geoms_setting` is neither
    ``visual`` nor ``all``. Otherwise it is an error.

    Args:
        path: the URDF.
        geoms_setting: the value of `scene.geoms`.
        warnings: the list to which warnings are added; None to add none.
        packages: the folders of ROS packages; None for those that ROS's variables list.

    Returns:
        The XML; and key -> file of a mesh: the XML has such a key in place of each mesh's path.

    Raises:
        SceneError: the XML is broken, or a mesh is missing that can't be left out.
    """
    packages = RosPackages() if packages is None else packages

    @cache
    def find_file(name: str) -> Path | None:
        candidate_paths = list_mesh_paths(path, name, packages)
        return next(
            (candidate_path for candidate_path in candidate_paths if candidate_path.is_file()), None
        )

    def find_missing_meshes(element: ElementTree.Element) -> list[str]:
        names = [mesh.get("filename", "") for mesh in element.iter("mesh")]
        return [name for name in names if not find_file(name)]

    try:
        root = parse_xml(path.read_bytes())
        compiler_element = _find_urdf_compiler(root)
        are_visuals_counted = (
            geoms_setting in ("visual", "all") or root.find("link/collision/geometry") is None
        )
        if compiler_element.get("discardvisual") == "true" or not are_visuals_counted:
            dropped_meshes = list[str]()
            for link in list(root.iter("link")):
                for visual in link.findall("visual"):
                    missing_meshes = find_missing_meshes(visual)
                    if missing_meshes:
                        dropped_meshes += missing_meshes
                        link.remove(visual)
            if dropped_meshes and warnings is not None:
                reason = "as it is only drawn, and visuals don't count here"
                names_text = list_first([repr(name) for name in dropped_meshes])
                warnings.append(f"mesh {names_text} of {path} not found: left out, {reason}")
        missing_names = [*dict.fromkeys(find_missing_meshes(root))]
        if missing_names:
            raise SceneError(_describe_missing_meshes(path, missing_names))
        used_names: set[str] = set()
        mesh_keys: dict[Path, str] = {}
        for mesh in root.iter("mesh"):
            file = find_file(mesh.get("filename", "")) or path
            if file not in mesh_keys:  # MuJoCo names a mesh by the stem of its file
                mesh_keys[file] = f"{unique_name(file.stem, used_names)}.mesh"
            mesh.set("filename", mesh_keys[file])
        urdf_text = ElementTree.tostring(root, encoding="unicode")
        return urdf_text, {key: file for file, key in mesh_keys.items()}
    except (*XML_ERRORS, RecursionError) as error:
        raise SceneError(f"broken XML in {path}: {error}") from error


def _find_urdf_compiler(root: ElementTree.Element) -> ElementTree.Element:
    """Return a URDF's ``<mujoco><compiler/>``, with navbake's defaults; it is added if missing."""
    mujoco_element = root.find("mujoco")
    if mujoco_element is None:
        mujoco_element = ElementTree.SubElement(root, "mujoco")
    compiler_element = mujoco_element.find("compiler")
    if compiler_element is None:
        compiler_element = ElementTree.SubElement(mujoco_element, "compiler")
    default_attributes = {"discardvisual": "false", "fusestatic": "false"}
    compiler_element.attrib = {**default_attributes, **compiler_element.attrib, "meshdir": ""}
    compiler_element.attrib.pop("assetdir", None)
    return compiler_element


def _describe_missing_meshes(urdf: Path, filenames: list[str]) -> str:
    """Describe where the first of the missing meshes was searched for, and list the others."""
    filename = filenames[0]
    other_names = ", ".join(repr(name) for name in filenames[1:])
    scheme, _, bare_path = filename.rpartition("://")
    folders = Path(bare_path).parts
    shorter_paths = [
        repr(str(Path(*folders[first_folder:]))) for first_folder in range(1, len(folders))
    ]
    hint = f"also as {', '.join(shorter_paths)}; " if shorter_paths else ""
    if scheme == "package" and folders:
        hint += (
            f"name the folder that holds the package {folders[0]!r} by `--model-path`, "
            "`scene.model_path`, ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, or "
        )
    place_text = f"not found there, in {urdf.absolute().parent} or in the folders above it"
    missing_text = (
        f"mesh {filename!r} of {urdf} {place_text}: {hint}write its path from the URDF's folder"
    )
    return f"{missing_text}; neither are {other_names}" if other_names else missing_text


# ---------------------------------------------------------------- scenes in memory


def is_in_memory(scene: object) -> TypeIs[SceneInMemory]:
    """Return whether an object is a scene: an MjModel, an MjSpec, a trimesh.Scene or a Trimesh."""
    return isinstance(scene, mujoco.MjModel | mujoco.MjSpec) or is_mesh_scene(scene)


def name_of(scene: SceneInMemory) -> str:
    """Return the name of a scene in memory: its model's name; ``scene`` if there is none."""
    name = ""
    if isinstance(scene, mujoco.MjModel):
        name = name_at(scene, 0)
    elif isinstance(scene, mujoco.MjSpec):
        name = str(scene.modelname)
    return "scene" if name in ("", DEFAULT_MODEL_NAME) else name


def load_from_memory(
    scene: SceneInMemory, data: MjDataLike | None, settings: SceneSettings
) -> SceneModel:
    """Compile a scene in memory, and copy its pose.

    MuJoCo's warnings are only collected if the scene has to be compiled.

    Args:
        scene: the scene, which is not changed.
        data: the pose, by its joint positions and mocap bodies; it is not changed. None for the
            pose of the settings.
        settings: the settings of the scene; errors name their path.

    Returns:
        The compiled model, and the pose.

    Raises:
        ConfigError: `data` fits a different model, or the settings state a pose as well.
        SceneError: the scene can't be compiled.
    """
    path = settings.path
    ground_height = settings.ground
    exact_meshes: dict[int, NamedMesh] = {}
    with catch_warnings() as warnings:
        if isinstance(scene, mujoco.MjModel):
            if ground_height is not None:
                hint = "which is compiled: give its MjSpec or its file"
                raise ConfigError(f"`scene.ground` can't be added to {path}, {hint}")
            model = scene
        elif isinstance(scene, mujoco.MjSpec):
            model = compile_model(
                path, warnings, lambda: compile_spec(scene.copy(), ground_height, warnings)
            )
        elif is_mesh_scene(scene):
            read_meshes = partial(convert_trimesh, scene, path, unit=settings.unit)
            meshes = orient_meshes(read_meshes, settings, warnings)
            model, exact_meshes = build_model_of_meshes(meshes, path, ground_height, warnings)
    scene_model = SceneModel(model, exact_meshes, find_ground(model, settings), warnings)
    if data is None:
        return scene_model
    if settings.keyframe is not None or settings.joints:
        key = "keyframe" if settings.keyframe is not None else "joints"
        raise ConfigError(f"expected a pose by `scene.{key}` or by a data, got both")
    check_data(model, data, str(path))
    return scene_model._replace(data=data_with_joints(model, data, {}))


def check_data(model: mujoco.MjModel, data: object, name: str) -> None:
    """Check that a mujoco.MjData fits a model: compare sizes and types of joints.

    Args:
        model: the model.
        data: the data.
        name: the model's name, for errors.

    Raises:
        ConfigError: `data` is no mujoco.MjData, or fits a different model.
    """
    if not isinstance(data, mujoco.MjData):
        raise ConfigError(f"expected a mujoco.MjData of {name}, got {type(data).__name__}")
    mismatch_text = f"the data is of another model than {name}"
    for size_name in POSE_SIZES:
        model_size = getattr(model, size_name)
        data_size = getattr(data.model, size_name)
        if data_size != model_size:
            raise ConfigError(
                f"{mismatch_text}: expected {size_name} = {model_size}, got {data_size}"
            )
    if not np.array_equal(model.jnt_type, data.model.jnt_type):
        raise ConfigError(f"{mismatch_text}: its joints differ")
