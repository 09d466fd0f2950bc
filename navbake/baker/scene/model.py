"""The compiled MuJoCo model of any scene: MJCF, URDF, MJB, a mesh, a scene of pieces (USD, SDF or a
building of Open-RMF), or one in memory.

A crash of MuJoCo's compiler ends its process, and Python can't stop it while it is busy. In a child
process both become errors, see `load_isolated`.
"""

import os
import pickle
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from navbake.baker.readers.mesh import (
    MESH_SUFFIXES,
    NamedMesh,
    convert_trimesh,
    is_mesh_scene,
    join_meshes,
    read_named_meshes,
)
from navbake.baker.readers.orientation import orient_meshes
from navbake.baker.readers.parsed_scene import (
    build_model,
    catch_warnings,
    compile_geometry,
    compile_model,
    compile_spec,
    fill_mesh,
    model_of_meshes,
    reading,
)
from navbake.baker.scene.names import name_at
from navbake.baker.scene.pose import data_with_joints
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, NavbakeError, SceneError
from navbake.files import scratch_folder
from navbake.formats.scene_files import (
    BUILDING_SUFFIXES,
    SDF_SUFFIXES,
    STAGE_SUFFIXES,
    XML_SUFFIXES,
    check_inputs,
    list_mesh_paths,
    scene_suffix,
)
from navbake.known_names import list_first, unique_name
from navbake.lazy import resolve
from navbake.processes import end_with_parent, ending_of, lacked_memory, limit_memory

MJB_SUFFIX = ".mjb"
# Readers of scenes that become pieces, see `pieces`; and of what has none, what
# is to be done with it
READERS = dict.fromkeys(STAGE_SUFFIXES, "navbake.baker.readers.usd:read_stage")
READERS |= dict.fromkeys(SDF_SUFFIXES, "navbake.baker.readers.sdf:read_world")
READERS |= dict.fromkeys(BUILDING_SUFFIXES, "navbake.baker.readers.building:read_building")
REFUSED = {
    ".fbx": "convert it first, by `assimp export SCENE.fbx SCENE.glb` (Debian's assimp-utils)",
    ".ifc": "convert it first, by ifcopenshell (pip install ifcopenshell), as docs/scenes.md shows",
}
BROKEN_XML = (ElementTree.ParseError, ValueError, LookupError)
NO_NAME = "MuJoCo Model"  # what MuJoCo calls a model that was given no name
# What decides where a model's geoms stand: a data fits a model that is the same in these
SIZES = ("nq", "nmocap", "nbody", "ngeom")

# The child gets this process's module path first of all: with -c, Python would look in the current
# folder, which is as little to be trusted as the scene.
CHILD = (
    "import sys; sys.path[:] = {path!r}; "
    "from navbake.baker.scene.model import compile_job; compile_job(sys.argv[1])"
)
IMPORT_SECONDS = 120.0  # what the child may take besides, to start and to end, on a busy machine
ALARM = int(getattr(signal, "SIGALRM", 14))
JOB = "job.pickle"
MODEL = "model.mjb"
RESULT = "result.pickle"
STARTED = "started"  # what the child writes when it begins to compile


def mujoco_version() -> str:
    """The installed MuJoCo's version."""
    return str(mujoco.__version__)


class SceneModel(NamedTuple):
    """A scene's compiled mujoco.MjModel, before geoms are chosen.

    With the exact meshes of a mesh scene by geom id, the geom of `scene.ground`, MuJoCo's warnings,
    the pose, None where the settings say it, and the names of bodies that the file says are doors.
    """

    model: Any
    exact_meshes: dict[int, NamedMesh]
    ground: int | None
    warnings: list[str]
    data: Any = None
    named_leaves: frozenset[str] = frozenset()


def load_model(settings: SceneSettings, warnings: list[str]) -> SceneModel:
    """Open a scene file.

    `scene.ground` is added as an endless plane on a body of its own, the last one, so that all
    other ids stay. `warnings` are those of `catch_warnings`, for the reason where MuJoCo fails.
    """
    path = Path(settings.path)
    ground = settings.ground
    exact_meshes: dict[int, NamedMesh] = {}
    named_leaves = frozenset[str]()
    suffix = scene_suffix(path)
    try:
        if not path.exists():
            raise SceneError(f"no scene file at {path}")
        if not path.is_file():
            kind = "folder" if path.is_dir() else "device"
            raise SceneError(f"expected a scene file, got a {kind} at {path}")
        if suffix in MESH_SUFFIXES:
            found = orient_meshes(
                partial(read_named_meshes, path, unit=settings.unit), settings, warnings
            )
            model, exact_meshes = model_of_meshes(found, path, ground, warnings)
        elif suffix == MJB_SUFFIX:
            if ground is not None:
                hint = f"bake the XML that {path} was made of"
                raise ConfigError(f"`scene.ground` can't be added to an MJB: {hint}")
            this = f"this is {mujoco_version()}: save it again, or bake its XML"
            hint = f" (an MJB fits only the MuJoCo that wrote it, {this})"
            load = partial(mujoco.MjModel.from_binary_path, str(path))
            model = compile_model(path, warnings, load, hint)
        elif suffix in XML_SUFFIXES:
            check_inputs(path)
            model = _load_xml(settings, warnings)
        elif suffix in READERS:
            with reading(str(path)):
                pieces = resolve(READERS[suffix])(path, settings)
            model, exact_meshes = build_model(pieces, path, ground, warnings)
            named_leaves = frozenset(pieces.named_leaves)
        elif suffix in REFUSED:
            raise SceneError(f"cannot read {path}: {REFUSED[suffix]}")
        else:
            known = ", ".join(sorted({MJB_SUFFIX, *XML_SUFFIXES, *MESH_SUFFIXES, *READERS}))
            raise SceneError(f"cannot tell what {path} is: expected one of {known}")
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror or error}") from error
    ground_geom = ground_of(model, settings)
    return SceneModel(model, exact_meshes, ground_geom, warnings, named_leaves=named_leaves)


class CompileLimits(NamedTuple):
    """What MuJoCo may take to compile a scene; memory is limited on Linux only."""

    seconds: float = 60.0
    memory: float = 4.0  # that it may reserve beyond what the process starts with [GiB]


def load_isolated(
    settings: SceneSettings, limits: CompileLimits, warnings: list[str]
) -> SceneModel:
    """`load_model` in a child process, whose model comes back as a file (MJB)."""
    scene = Path(settings.path)
    with scratch_folder() as place:
        (place / JOB).write_bytes(pickle.dumps((settings, limits)))
        path = [entry or os.getcwd() for entry in sys.path]
        command = [sys.executable, "-c", CHILD.format(path=path), str(place)]
        streams: Any = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        longest = limits.seconds + IMPORT_SECONDS  # the child ends itself, but on Windows
        try:
            status = subprocess.run(command, **streams, timeout=longest).returncode
        except subprocess.TimeoutExpired:
            status = -ALARM
        if status == -ALARM:
            hint = "make the scene smaller, or give it more time"
            raise SceneError(f"MuJoCo did not compile {scene} within {limits.seconds:g} s: {hint}")
        ended = f"({ending_of(status)})"
        if not (place / STARTED).exists():
            hint = f"does {sys.executable!r} find navbake?"
            raise NavbakeError(f"cannot start a process to compile {scene} in {ended}: {hint}")
        if not (place / RESULT).exists():
            too_much = f"too much, or for more than {limits.memory:g} GiB of memory, or is broken"
            asks = f"the scene asks for {too_much}"
            raise SceneError(f"MuJoCo crashed as it compiled {scene} {ended}: {asks}")
        warned, error, exact_meshes, named_leaves = pickle.loads((place / RESULT).read_bytes())
        warnings += warned
        if error is not None:
            raise error
        model = mujoco.MjModel.from_binary_path(str(place / MODEL))
    ground_geom = ground_of(model, settings)
    return SceneModel(model, exact_meshes, ground_geom, warnings, named_leaves=named_leaves)


def compile_job(folder: str) -> None:
    """Compile the scene of a job, in the child, and write the model or the error."""
    place = Path(folder)
    settings, limits = pickle.loads((place / JOB).read_bytes())
    limit_memory(limits.memory)
    end_with_parent()
    (place / STARTED).touch()
    if hasattr(signal, "setitimer"):  # whose signal ends this process, whatever MuJoCo does
        signal.setitimer(signal.ITIMER_REAL, limits.seconds)
    failed: Exception | None = None
    exact_meshes: dict[int, NamedMesh] = {}
    named_leaves = frozenset[str]()
    with catch_warnings() as warned:
        try:
            opened = load_model(settings, warned)
            exact_meshes = opened.exact_meshes
            named_leaves = opened.named_leaves
            mujoco.mj_saveModel(opened.model, str(place / MODEL), None)
        except Exception as error:
            if not lacked_memory(error) and not isinstance(error, NavbakeError):
                raise
            lacks = f"{settings.path} needs more than {limits.memory:g} GiB of memory"
            failed = SceneError(lacks) if lacked_memory(error) else error
    (place / RESULT).write_bytes(pickle.dumps((warned, failed, exact_meshes, named_leaves)))


def limit_mesh_cache(num_bytes: int) -> None:
    """Set how much memory MuJoCo keeps of meshes in case a later scene names the same files."""
    mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), num_bytes)


def ground_of(model: Any, settings: SceneSettings) -> int | None:
    """The geom of `scene.ground`, None without."""
    return None if settings.ground is None else int(model.ngeom) - 1


def _load_xml(settings: SceneSettings, warnings: list[str]) -> Any:
    path = Path(settings.path)
    ground = settings.ground
    if path.stat().st_size == 0:
        raise SceneError(f"{path} is empty: expected an MJCF or URDF scene")
    root = ""  # where Python's parser doesn't get that far
    with suppress(*BROKEN_XML):
        root = str(next(ElementTree.iterparse(path, events=("start",)))[1].tag)
    if root == "robot":
        text, files = read_urdf(path, settings.geoms, warnings)

        def build() -> Any:
            """The model, its meshes read as mesh scenes are, whatever their format."""
            spec = mujoco.MjSpec.from_string(text)
            read = cache(lambda file: read_named_meshes(files[file]))
            for mesh in spec.meshes:
                parts = read(mesh.file)
                mesh.file = ""
                fill_mesh(mesh, *join_meshes(parts))
            return compile_geometry(spec, ground, warnings)

        return compile_model(path, warnings, build)
    if root not in ("mujoco", ""):
        raise SceneError(f"expected <mujoco> or <robot> in {path}, got <{root[:40]}>")

    def load() -> Any:
        if path.suffix == ".xml":
            spec = mujoco.MjSpec.from_file(str(path))
            _drop_missing_textures(spec, path, warnings)
            return compile_spec(spec, ground, warnings)
        if ground is not None:  # MjSpec reads no other ending
            raise ConfigError(f"`scene.ground` can't be added to {path}: let its name end in .xml")
        return mujoco.MjModel.from_xml_path(str(path))

    try:  # MuJoCo's parser is the judge of MJCF, also where Python's is stricter
        return compile_model(path, warnings, load)
    except SceneError as error:
        try:
            ElementTree.parse(path)
        except BROKEN_XML as problem:  # says better where
            raise SceneError(f"broken XML in {path}: {problem}") from error
        raise


def _drop_missing_textures(spec: Any, path: Path, warnings: list[str]) -> None:
    """Make textures with a missing file plain, with a warning: no bake needs them."""
    missing = list[str]()
    for texture in spec.textures:
        files = [name for name in (texture.file, *texture.cubefiles) if name]
        places = [path.parent / spec.texturedir, path.parent]
        lost = [name for name in files if not any((place / name).is_file() for place in places)]
        if spec.strippath:
            lost = [name for name in lost if not (places[0] / Path(name).name).is_file()]
        if lost:
            missing += lost
            texture.file = ""
            texture.cubefiles = [""] * len(texture.cubefiles)
            texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = 1
            texture.height = 1
    if missing:
        listed = list_first(list(map(repr, missing)))
        warnings.append(f"texture {listed} of {path} not found: drawn plain")


def read_urdf(
    path: Path, geoms: str = "auto", warnings: list[str] | None = None
) -> tuple[str, dict[str, Path]]:
    """Read a URDF: its XML for MuJoCo, and the file of each mesh by its key in that XML.

    Unless the file's own ``<mujoco><compiler/>`` says otherwise, visuals are kept and links that
    hang on a fixed joint keep their bodies and names, both against MuJoCo's defaults.

    A visual whose mesh is missing is left out, with a warning, where visuals don't count: the file
    discards them, or it has collision geometry and `scene.geoms` counts that.
    """

    @cache
    def find(name: str) -> Path | None:
        return next((place for place in list_mesh_paths(path, name) if place.is_file()), None)

    def missing(thing: ElementTree.Element) -> list[str]:
        return [name for m in thing.iter("mesh") if not find(name := m.get("filename", ""))]

    try:
        root = ElementTree.parse(path).getroot()
        compiler = root
        for tag in ("mujoco", "compiler"):
            found = compiler.find(tag)
            compiler = ElementTree.SubElement(compiler, tag) if found is None else found
        own = {"discardvisual": "false", "fusestatic": "false"}
        compiler.attrib = {**own, **compiler.attrib, "meshdir": ""}
        compiler.attrib.pop("assetdir", None)
        counts = geoms in ("visual", "all") or root.find("link/collision/geometry") is None
        if compiler.get("discardvisual") == "true" or not counts:
            visuals = [(link, v) for link in root.iter("link") for v in link.findall("visual")]
            left_out = [name for _, visual in visuals for name in missing(visual)]
            for link, visual in visuals:
                if missing(visual):
                    link.remove(visual)
            if left_out and warnings is not None:
                because = "as it is only drawn, and visuals don't count here"
                listed = list_first(list(map(repr, left_out)))
                warnings.append(f"mesh {listed} of {path} not found: left out, {because}")
        for name in missing(root):
            raise SceneError(_not_found(path, name))
        taken: set[str] = set()
        keys: dict[Path, str] = {}
        for mesh in root.iter("mesh"):
            file = find(mesh.get("filename", "")) or path
            if file not in keys:  # MuJoCo names a mesh by the stem of its file
                keys[file] = f"{unique_name(file.stem, taken)}.mesh"
            mesh.set("filename", keys[file])
        text = ElementTree.tostring(root, encoding="unicode")
        return text, {key: file for file, key in keys.items()}
    except (*BROKEN_XML, RecursionError) as error:
        raise SceneError(f"broken XML in {path}: {error}") from error


def _not_found(urdf: Path, filename: str) -> str:
    scheme, _, bare = filename.rpartition("://")
    parts = Path(bare).parts
    tails = [repr(str(Path(*parts[first:]))) for first in range(1, len(parts))]
    also = f"also as {', '.join(tails)}; " if tails else ""
    if scheme == "package" and parts:
        also += f"put the folder of the package {parts[0]!r} beside or above the URDF, or "
    where = f"not found there, in {urdf.absolute().parent} or in the folders above it"
    return f"mesh {filename!r} of {urdf} {where}: {also}write its path from the URDF's folder"


def is_in_memory(scene: Any) -> bool:
    """Whether something is a scene itself: an MjModel, an MjSpec, a trimesh.Scene or a Trimesh."""
    return isinstance(scene, mujoco.MjModel | mujoco.MjSpec) or is_mesh_scene(scene)


def name_of(scene: Any) -> str:
    """The name of a scene in memory: its model's own, else ``scene``."""
    name = name_at(scene, 0) if isinstance(scene, mujoco.MjModel) else ""
    name = str(getattr(scene, "modelname", name))  # of a spec
    return "scene" if name in ("", NO_NAME) else name


def load_from_memory(scene: Any, data: Any, settings: SceneSettings) -> SceneModel:
    """The model of a scene in memory, in the pose of a data; neither is changed.

    Warnings are known of specs alone, which are compiled here. Joint positions and mocap bodies of
    the data are the pose; without it, the settings say it. Errors name the settings' path.
    """
    path = settings.path
    ground = settings.ground
    exact_meshes: dict[int, NamedMesh] = {}
    with catch_warnings() as warned:
        if isinstance(scene, mujoco.MjModel):
            if ground is not None:
                hint = "which is compiled: give its MjSpec or its file"
                raise ConfigError(f"`scene.ground` can't be added to {path}, {hint}")
            model = scene
        elif isinstance(scene, mujoco.MjSpec):
            model = compile_model(path, warned, lambda: compile_spec(scene.copy(), ground, warned))
        else:
            read = partial(convert_trimesh, scene, path, unit=settings.unit)
            found = orient_meshes(read, settings, warned)
            model, exact_meshes = model_of_meshes(found, path, ground, warned)
    opened = SceneModel(model, exact_meshes, ground_of(model, settings), warned)
    if data is None:
        return opened
    if settings.keyframe is not None or settings.joints:
        key = "keyframe" if settings.keyframe is not None else "joints"
        raise ConfigError(f"expected a pose by `scene.{key}` or by a data, got both")
    check_data(model, data, str(path))
    return opened._replace(data=data_with_joints(model, data, {}))


def check_data(model: Any, data: Any, name: str) -> None:
    """Raise a ConfigError unless a mujoco.MjData fits a model, by numbers of things and joints."""
    if not isinstance(data, mujoco.MjData):
        raise ConfigError(f"expected a mujoco.MjData of {name}, got {type(data).__name__}")
    other = data.model
    text = f"the data is of another model than {name}"
    for size in SIZES:
        if getattr(model, size) != (got := getattr(other, size)):
            raise ConfigError(f"{text}: expected {size} = {getattr(model, size)}, got {got}")
    if not np.array_equal(model.jnt_type, other.jnt_type):
        raise ConfigError(f"{text}: its joints differ")
