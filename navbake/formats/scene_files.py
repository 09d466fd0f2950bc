"""Lists the files that a scene's MJCF, URDF, SDF, USD or glTF refers to."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple, Protocol
from urllib.parse import unquote

from navbake.errors import SceneError
from navbake.files import check_regular
from navbake.formats.package_paths import RosPackages, parse_fuel_address
from navbake.formats.xml_files import StartTag, find_root_tag, list_start_tags, parse_xml

XML_SUFFIXES = frozenset({".xml", ".mjcf", ".urdf"})
SDF_SUFFIXES = frozenset({".sdf", ".world"})
BUILDING_SUFFIXES = frozenset({".building.yaml", ".building.yml"})
USD_SUFFIXES = frozenset({".usd", ".usda", ".usdc"})
STAGE_SUFFIXES = USD_SUFFIXES | {".usdz"}  # a .usdz contains all of its files
MESH_SUFFIXES = frozenset({".obj", ".ply", ".stl", ".glb", ".gltf", ".dae"})
MJB_SUFFIX = ".mjb"
SCENE_SUFFIXES = XML_SUFFIXES | SDF_SUFFIXES | BUILDING_SUFFIXES | STAGE_SUFFIXES | MESH_SUFFIXES
SCENE_SUFFIXES |= {MJB_SUFFIX}
# environment variables that list the folders of Gazebo's models, the newest variable first
MODEL_PATHS = (
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
    "GAZEBO_MODEL_PATH",
    "GAZEBO_RESOURCE_PATH",
    "SDF_PATH",
)
# schemes of a URDF's meshes that begin with the name of a ROS package
PACKAGE_SCHEMES = ("package", "model")
MATERIAL_SUFFIX = ".material"  # ending of a script of Ogre's, which changes the appearance alone
# files in the folder of a model of Gazebo
MODEL_CONFIG = "model.config"
MODEL_SDF = "model.sdf"
MAX_VERSION_DIGITS = 9  # of each number in a version of SDF
MAX_PROLOG_BYTES = 1 << 16  # bytes before the first element of an SDF, such as a licence
MODEL_ELEMENTS = ("include", "model", "attach")  # the file of these is XML, whatever its name
TEXTURE_ELEMENTS = ("texture", "skin")  # these change a scene's appearance, but no cell
# attributes of a compiler that name folders, without and with the folders of textures
FOLDER_ATTRIBUTES = ("meshdir", "assetdir")
ALL_FOLDER_ATTRIBUTES = (*FOLDER_ATTRIBUTES, "texturedir")
# attributes that name a file in MJCF, and in a URDF that MJCF attaches: without and with the
# attributes for the sides of a cube's texture
FILE_ATTRIBUTES = ("file", "filename")
ALL_FILE_ATTRIBUTES = (
    *FILE_ATTRIBUTES, "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback",
)  # fmt: skip
MAX_CANDIDATES = 500_000  # names of files in a model times the folders that its compilers name
MAX_NAME_PARTS = 32  # of a URDF's mesh, of which the first ones are dropped one by one
# attributes by which `find_inputs` finds names of files and folders
NAMING_ATTRIBUTES = frozenset({*ALL_FOLDER_ATTRIBUTES, *ALL_FILE_ATTRIBUTES})


def scene_suffix(path: str | os.PathLike[str]) -> str:
    """Return the ending of a scene's file that tells its kind: ``.xml``, ``.building.yaml``."""
    name = os.path.basename(os.fsdecode(path)).lower()
    for suffix in BUILDING_SUFFIXES:
        if name.endswith(suffix):
            return suffix
    return os.path.splitext(name)[1]


class FileAccess(Protocol):
    """Gives access to files of a scene that are not on this machine."""

    def has(self, path: Path) -> bool:
        """Whether there is a regular file at the path."""

    def ensure_local(self, path: Path) -> None:
        """Copy an existing file to this machine, unless that was done before."""


def check_inputs(scene: Path, folders: Sequence[Path] = ()) -> None:
    """Check that MuJoCo can open a scene's files.

    It can't open a path that isn't UTF-8, and would wait for ever for a pipe or a device.

    Args:
        scene: the scene's file.
        folders: the folders of the setting `scene.model_path`.

    Raises:
        SceneError: the scene's path isn't UTF-8, or an input is a pipe or a device.
    """
    if os.fsencode(scene).decode(errors="replace") != str(scene):
        message = f"MuJoCo reads paths in UTF-8 only, got {scene}: rename it"
        raise SceneError(message, path=str(scene), expected="a path in UTF-8", hint="rename it")
    find_inputs(scene, with_textures=True, folders=folders)


def find_inputs(
    scene: Path,
    file_access: FileAccess | None = None,
    *,
    with_textures: bool = False,
    with_missing: bool = False,
    folders: Sequence[Path] = (),
) -> list[Path]:
    """List the existing files that a scene consists of.

    For MJCF, these are all files that an element refers to, also in included files and attached
    models. In which folder MuJoCo looks depends on the compiler's settings and on its version. So
    the file of that name in each possible folder is listed: a file too many at worst bakes a scene
    again for nothing, but a file too few would leave a grid that is out of date.

    For URDF, the files are the meshes; for glTF, the buffers; for SDF, models, meshes and height
    fields; for USD, all layers.

    Args:
        scene: the scene's file.
        file_access: access to the files if they are not on this machine.
        with_textures: include textures and skins.
        with_missing: include all possible paths of each missing file.
        folders: folders of the models of an SDF, and of the packages of a URDF, see
            `list_sdf_paths` and `list_mesh_paths`.

    Returns:
        The path of the scene's own file, then the paths of the other files, sorted.

    Raises:
        SceneError: an input is a pipe or a device of this machine, which would block its reader.
    """

    @cache
    def exists(path: Path) -> bool:
        if file_access is not None:
            return file_access.has(path)
        try:
            check_regular(path)
        except OSError as error:
            message = f"cannot read {path}: {error.strerror}"
            raise SceneError(message, path=str(path)) from error
        return os.path.isfile(path)

    def read_file(path: Path) -> bytes:
        """Return the content of a file; empty if it can't be read."""
        if exists(path):
            with suppress(OSError):
                if file_access is not None:
                    file_access.ensure_local(path)
                return path.read_bytes()
        return b""

    input_paths: set[Path] = set()

    def add_existing(candidates: Iterable[Path], only_first: bool = False) -> None:
        """Add the existing paths of a file to `input_paths`.

        If none exists and `with_missing` is True, all possible paths are added.

        Args:
            candidates: the possible paths of the file, in the order of search.
            only_first: whether to add only the first existing path.
        """
        candidates = list(candidates)
        existing_paths = [path for path in candidates if exists(path)]
        if existing_paths:
            input_paths.update(existing_paths[:1] if only_first else existing_paths)
        elif with_missing:
            input_paths.update(candidates)

    suffix = scene.suffix.lower()
    elements = _list_elements(read_file(scene)) if suffix in XML_SUFFIXES else []
    if elements and elements[0].name == "robot":
        packages = RosPackages(folders)
        meshes = [element for element in elements if element.name == "mesh"]
        for name in dict.fromkeys(mesh.attributes.get("filename", "") for mesh in meshes):
            add_existing(list_mesh_paths(scene, name, packages), only_first=True)
    elif elements:
        for candidates in _list_mjcf_paths(scene, elements, read_file, with_textures):
            add_existing(candidates)
    if suffix in SDF_SUFFIXES | USD_SUFFIXES:
        unread_files = [scene]
        searched_files = set[Path]()
        while unread_files:
            file = unread_files.pop()
            if file in searched_files:
                continue
            searched_files.add(file)
            content = read_file(file)
            if suffix in USD_SUFFIXES:
                candidate_lists = _list_usd_paths(file, with_textures) if content else []
            else:
                candidate_lists = _list_sdf_inputs(file, content, folders, with_textures)
            for candidates in candidate_lists:
                add_existing(candidates)
                unread_files += [path for path in candidates if exists(path)]
    for path in [scene, *input_paths]:
        if path.suffix.lower() == ".gltf":
            for uri in _list_buffer_names(read_file(path)):
                names = {uri, uri.strip(), unquote(uri)}
                add_existing(path.parent / name for name in names)
    return [scene, *sorted(input_paths - {scene})]


def _list_usd_paths(layer: Path, with_textures: bool) -> list[list[Path]]:
    """Return, for each file that a layer of USD names, a list of its only possible path."""
    return [
        [layer.parent / name]
        for name in _list_layer_names(layer)
        if with_textures or scene_suffix(name) in STAGE_SUFFIXES
    ]


def _list_sdf_inputs(
    file: Path, content: bytes, folders: Sequence[Path], with_textures: bool
) -> list[list[Path]]:
    """Return, for each file that an SDF or a model.config names, its possible paths."""
    if file.name == MODEL_CONFIG:
        return [[file.parent / entry.name] for entry in _list_config_entries(content)]
    if find_root_tag(content[:MAX_PROLOG_BYTES]) != "sdf":  # a mesh, an image
        return []
    try:
        root = parse_xml(content)
    except ValueError:
        return []
    uris = dict.fromkeys((element.text or "").strip() for element in root.iter("uri"))
    return [
        _list_model_files(list_sdf_paths(uri, file, folders))
        for uri in uris
        if uri and "\0" not in uri and (with_textures or not uri.endswith(MATERIAL_SUFFIX))
    ]


def list_mesh_paths(urdf: Path, name: str, packages: RosPackages) -> Iterator[Path]:
    """Yield the possible paths of a URDF's mesh, in the order of search.

    The order for a mesh such as ``package://pkg/meshes/a.dae``:

    1. the package in the folders that the settings state;
    2. ``pkg/meshes/a.dae`` in the URDF's folder, and in each folder above it;
    3. the package as ROS finds it;
    4. ``meshes/a.dae``, then ``a.dae``, in the folders of 2: so meshes are found without ROS.

    For a plain path, 1 and 3 are left out.

    Args:
        urdf: the URDF.
        name: the mesh's file name, as the URDF states it.
        packages: finds the folders of packages.
    """
    scheme, _, bare_name = name.rpartition("://")
    mesh_path = Path(bare_name)
    name_parts = mesh_path.parts
    is_in_package = (
        scheme in PACKAGE_SCHEMES and len(name_parts) > 1 and not mesh_path.is_absolute()
    )
    folders = [urdf.parent, *urdf.absolute().parent.parents]
    if is_in_package:
        for package_folder in packages.list_stated_folders(name_parts[0]):
            yield package_folder.joinpath(*name_parts[1:])
    for num_dropped_parts in range(len(name_parts) if len(name_parts) <= MAX_NAME_PARTS else 1):
        for folder in folders:
            yield folder.joinpath(*name_parts[num_dropped_parts:])
        if num_dropped_parts == 0 and is_in_package:
            for package_folder in packages.list_installed_folders(name_parts[0]):
                yield package_folder.joinpath(*name_parts[1:])


def list_sdf_paths(uri: str, file: Path, folders: Sequence[Path] = ()) -> Iterator[Path]:
    """Yield the possible paths of a file that an SDF names, in the order of search.

    The order of search:

    1. the SDF's folder, unless the name has a scheme, such as ``model://…``;
    2. `folders`;
    3. the folders in the environment variables `MODEL_PATHS`;
    4. all folders above the SDF, and their subfolders ``models``: so a checkout of a world with its
       models needs no variable.

    A model of Fuel is searched in these folders, whatever the case of its name, and then in the
    caches of Fuel.

    Args:
        uri: the name in the SDF.
        file: the SDF.
        folders: folders of models, from the settings.
    """
    scheme, _, name = uri.rpartition("://")
    fuel_file = parse_fuel_address(uri)
    is_plain_path = scheme in ("", "file")
    path = Path(name if is_plain_path else name.lstrip("/"))
    if is_plain_path:
        yield file.parent / path
    elif scheme in ("http", "https", "fuel"):  # by its name alone
        path = Path(path.name)
    for folder in _list_model_folders(file, folders):
        if fuel_file is not None:
            yield from fuel_file.list_paths_in_folder(folder)
        yield folder / path
    if fuel_file is not None:
        yield from fuel_file.list_paths_in_caches()


def _list_model_folders(file: Path, folders: Sequence[Path]) -> Iterator[Path]:
    """Yield the folders in which an SDF's models are searched, see `list_sdf_paths`."""
    yield from folders
    for variable in MODEL_PATHS:
        for folder_name in os.environ.get(variable, "").split(os.pathsep):
            if folder_name:
                yield Path(folder_name)
    for parent in file.absolute().parents:
        yield parent
        yield parent / "models"


def find_model_file(path: Path) -> Path:
    """Find the SDF file of a model of Gazebo.

    Args:
        path: the model's folder, or already its file.

    Returns:
        The file that the folder's ``model.config`` lists; of several, the one with the latest
        version of SDF; without that list, ``model.sdf``. If `path` is no folder, `path` itself.
    """
    if not path.is_dir():
        return path
    config_file = path / MODEL_CONFIG
    entries = _list_config_entries(config_file.read_bytes()) if config_file.is_file() else []
    if not entries:
        return path / MODEL_SDF
    return path / max(entries, key=lambda entry: entry.version).name


class _ConfigEntry(NamedTuple):
    """A file that a model.config lists: its version of SDF, and its name."""

    version: tuple[int, ...]
    name: str


def _list_config_entries(content: bytes) -> list[_ConfigEntry]:
    """Return the files that a model.config lists; none if it is broken."""
    try:
        root = parse_xml(content)
    except ValueError:
        return []
    entries = []
    for element in root.iter("sdf"):
        name = (element.text or "").strip()
        if name and "\0" not in name:
            entries.append(_ConfigEntry(parse_sdf_version(element.get("version")) or (), name))
    return entries


def parse_sdf_version(text: str | None) -> tuple[int, ...] | None:
    """Return the numbers of a version of SDF, such as ``1.9``; None for another text."""
    version_parts = (text or "").split(".")
    is_version = all(
        version_part.isdecimal() and len(version_part) <= MAX_VERSION_DIGITS
        for version_part in version_parts
    )
    return tuple(map(int, version_parts)) if is_version else None


def _list_model_files(paths: Iterable[Path]) -> list[Path]:
    """Return the paths; for a path without a suffix, a model's folder, return the model's files."""
    files = []
    for path in paths:
        if path.suffix:
            files.append(path)
        else:
            files.append(path / MODEL_CONFIG)
            files.append(path / MODEL_SDF)
    return files


def _list_layer_names(layer: Path) -> list[str]:
    """Return the names of the layers and textures that a layer of USD refers to.

    Names with a scheme, such as ``omniverse://…``, are left out. Without usd-core, the list is
    empty.
    """
    with suppress(ImportError):
        from pxr import Tf, UsdUtils  # of the extra [usd]

        diagnostics = UsdUtils.CoalescingDiagnosticDelegate()  # keeps USD's messages off stderr
        with suppress(Tf.ErrorException):  # whoever reads the layer says what is wrong
            name_lists = UsdUtils.ExtractExternalReferences(str(layer))
            return [name for name in chain.from_iterable(name_lists) if "://" not in name]
        diagnostics.TakeUncoalescedDiagnostics()
    return []


class _MjcfFile(NamedTuple):
    """A file of a model, to be searched for names of files."""

    path: Path
    model_folder: Path  # the folder of the model's main file, which may include this one


def _list_mjcf_paths(
    scene: Path,
    elements: list[StartTag],
    read_file: Callable[[Path], bytes],
    with_textures: bool,
) -> list[list[Path]]:
    """Return, for each file that MJCF names, its possible paths.

    Args:
        scene: the main file.
        elements: its elements, from `_list_elements`.
        read_file: returns the content of a file; empty if there is no such file.
        with_textures: whether to list the files of textures and skins, too.

    Raises:
        SceneError: there are more than `MAX_CANDIDATES` paths, as few names and few folders make.
    """
    folder_attributes = ALL_FOLDER_ATTRIBUTES if with_textures else FOLDER_ATTRIBUTES
    file_attributes = ALL_FILE_ATTRIBUTES if with_textures else FILE_ATTRIBUTES
    # (folders of the name, name), an ordered set
    names_in_folders: dict[tuple[tuple[Path, ...], str], None] = {}
    compiler_folders = {""}
    unread_files = [_MjcfFile(scene, scene.parent)]
    searched_files = set[tuple[str, ...]]()
    elements_of_file = {os.path.realpath(scene): elements}
    while unread_files:
        file = unread_files.pop()
        real_path = os.path.realpath(file.path)
        # a file is searched again where its names are relative to other folders
        file_identity = (
            real_path,
            os.path.realpath(file.path.parent),
            os.path.realpath(file.model_folder),
        )
        if file_identity in searched_files:
            continue
        searched_files.add(file_identity)
        if real_path not in elements_of_file:
            elements_of_file[real_path] = _list_elements(read_file(file.path))
        base_folders = tuple(dict.fromkeys((scene.parent, file.model_folder, file.path.parent)))
        included_files: dict[_MjcfFile, None] = {}
        for element in elements_of_file[real_path]:
            for key in folder_attributes:
                if key in element.attributes:
                    compiler_folders.add(_replace_backslashes(element.attributes[key]))
            if element.name in TEXTURE_ELEMENTS and not with_textures:
                continue
            for key in file_attributes:
                name = _replace_backslashes(element.attributes.get(key, ""))
                if not name or "\0" in name:
                    continue
                names_in_folders[base_folders, name] = None
                is_xml = Path(name).suffix.lower() in XML_SUFFIXES
                if element.name not in MODEL_ELEMENTS and not is_xml:
                    continue
                for path in _list_paths(base_folders, [""], name):
                    model_folder = file.model_folder if element.name == "include" else path.parent
                    included_files[_MjcfFile(path, model_folder)] = None
        unread_files += included_files
    folders = sorted(compiler_folders)
    if len(names_in_folders) * len(folders) > MAX_CANDIDATES:
        raise SceneError(
            f"{scene} names {len(names_in_folders):,} files, and {len(folders):,} folders in which "
            "each may be: too many to look for all",
            path=str(scene),
        )
    return [_list_paths(base_folders, folders, name) for base_folders, name in names_in_folders]


def _list_paths(base_folders: Iterable[Path], folders: Iterable[str], name: str) -> list[Path]:
    """Return the possible paths of a file that MJCF names.

    The file may also be looked for without the folders in its name (`strippath` of the compiler).
    If a path contains ``..``, MuJoCo drops the folder before it, even if that is a link or missing,
    while the system follows the link; so both paths are returned.

    Args:
        base_folders: the folders that the name may be relative to.
        folders: the compiler's folders of files, relative to these; "" for none.
        name: the name.
    """
    paths: dict[Path, None] = {}  # an ordered set
    for folder in folders:
        for file_name in dict.fromkeys((name, os.path.basename(name))):
            for base_folder in base_folders:
                path = base_folder / folder / file_name
                paths[path] = None
                if os.pardir in path.parts:
                    paths[Path(os.path.normpath(path))] = None
    return list(paths)


def _list_buffer_names(content: bytes) -> list[str]:
    """Return the names of the files that hold a glTF file's buffers."""
    try:
        buffers = json.loads(content)["buffers"]
        uris = [str(buffer["uri"]) for buffer in buffers if "uri" in buffer]
    except (ValueError, RecursionError, LookupError, TypeError):
        return []
    return [uri for uri in uris if not uri.startswith("data:") and "\0" not in unquote(uri)]


def _replace_backslashes(name: str) -> str:
    """Return a path as MuJoCo reads it on any system: a backslash separates folders, too."""
    return name.replace("\\", "/")


def _list_elements(content: bytes) -> list[StartTag]:
    """Return the first element of an XML file, and all others that may name files or folders."""
    return list_start_tags(content, NAMING_ATTRIBUTES)
