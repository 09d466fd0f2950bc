"""Lists the files that a scene's MJCF, URDF, SDF, USD or glTF refers to."""

from __future__ import annotations

import html
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol
from urllib.parse import unquote

from navbake.errors import SceneError
from navbake.files import check_regular

XML_SUFFIXES = frozenset({".xml", ".mjcf", ".urdf"})
SDF_SUFFIXES = frozenset({".sdf", ".world"})
BUILDING_SUFFIXES = frozenset({".building.yaml", ".building.yml"})
USD_SUFFIXES = frozenset({".usd", ".usda", ".usdc"})
STAGE_SUFFIXES = USD_SUFFIXES | {".usdz"}  # which holds all of its files
# environment variables with the folders of Gazebo's models, today's first
MODEL_PATHS = (
    *("GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "GAZEBO_MODEL_PATH"),
    *("GAZEBO_RESOURCE_PATH", "SDF_PATH"),
)
URI = re.compile(rb"<uri>\s*([^<>]+?)\s*</uri>")
MATERIAL = ".material"  # ending of a script of Ogre's, of looks
# in a folder of a model of Gazebo
MODEL_CONFIG = "model.config"
MODEL_SDF = "model.sdf"
# in a model.config, the version of SDF of a file, and its name
SDF_NAME = re.compile(rb"<sdf(?:\s+version\s*=\s*[\"']([\d.]*)[\"'])?[^>]*>\s*([\w.-]+)\s*</sdf>")
MODELS = ("include", "model", "attach")  # elements whose file is XML, whatever its name
LOOKS = ("texture", "skin")  # elements that change a scene's looks, but no cell
# attributes of a compiler that name folders; of looks as well
FOLDERS = ("meshdir", "assetdir")
LOOK_FOLDERS = (*FOLDERS, "texturedir")
# attributes that name a file, in MJCF and in URDF that it attaches; of looks as well: a cube has
# one a side
NAMES = ("file", "filename")
LOOK_NAMES = (*NAMES, "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")
# for files that MuJoCo's XML parser (TinyXML-2) accepts and Python's refuses (`--` in a comment,
# bytes of any encoding)
COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
ELEMENT = re.compile(rb"<([A-Za-z_]\w*)((?:[^<>\"']|\"[^\"]*\"|'[^']*')*)>")
ATTRIBUTE = re.compile(rb"([\w:.-]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")


def scene_suffix(path: str | os.PathLike[str]) -> str:
    """The ending that says what kind of scene a file is: ``.xml``, ``.building.yaml``, …."""
    name = os.path.basename(os.fsdecode(path)).lower()
    whole = next((suffix for suffix in BUILDING_SUFFIXES if name.endswith(suffix)), None)
    return whole or os.path.splitext(name)[1]


class FileAccess(Protocol):
    """Access to a scene's files that are not on this machine."""

    def has(self, path: Path) -> bool:
        """Whether there is such a regular file."""

    def ensure_local(self, path: Path) -> None:
        """Make an existing file ready for reading."""


def check_inputs(scene: Path) -> None:
    """Raise a SceneError for inputs that MuJoCo can't read.

    These are a scene's path that is not UTF-8, and pipes and devices, on which it would wait for
    ever.
    """
    if os.fsencode(scene).decode(errors="replace") != str(scene):
        raise SceneError(f"MuJoCo reads paths in UTF-8 only, got {scene}: rename it")
    find_inputs(scene, looks=True)


_Element = tuple[str, dict[str, str]]  # tag and attributes


def find_inputs(
    scene: Path,
    files: FileAccess | None = None,
    *,
    looks: bool = False,
    missing: bool = False,
    folders: Sequence[Path] = (),
) -> list[Path]:
    """List the existing files of a scene: itself, then sorted.

    In MJCF these are all files that an element refers to, also in included files and attached
    models. A name's folder depends on the compiler's settings and on MuJoCo's version, so files in
    all possible folders count: one too many costs a bake, one too few leaves a stale grid. In URDF
    they are the meshes, in glTF the buffers, in SDF models, meshes and height fields (`folders` are
    those of models, see `list_sdf_paths`), in USD all layers.

    `looks` includes textures and skins, `missing` all possible places of each missing file. Raises
    a SceneError for a pipe or a device of this machine, which would block its reader.
    """

    def has(path: Path) -> bool:
        if files is not None:
            return files.has(path)
        try:
            check_regular(path)
        except OSError as error:
            raise SceneError(f"cannot read {path}: {error.strerror}") from error
        return os.path.isfile(path)

    def read(path: Path) -> bytes:
        """The content of a file; empty if it can't be read."""
        if has(path):
            with suppress(OSError):
                if files is not None:
                    files.ensure_local(path)
                return path.read_bytes()
        return b""

    elements = _parse_elements(read(scene)) if scene.suffix.lower() in XML_SUFFIXES else []
    found: set[Path] = set()

    def choose(places: Iterable[Path], first: bool = False) -> None:
        places = list(places)
        there = [place for place in places if has(place)]
        found.update((there[:1] if first else there) or (places if missing else []))

    if elements and elements[0][0] == "robot":
        for tag, attributes in elements:
            if tag == "mesh":
                choose(list_mesh_paths(scene, attributes.get("filename", "")), first=True)
    else:
        for places in _places_in_mjcf(scene, elements, read, looks):
            choose(places)
    suffix = scene.suffix.lower()
    if suffix in SDF_SUFFIXES | USD_SUFFIXES:
        left = [scene]
        seen = set[Path]()
        while left:
            file = left.pop()
            if file in seen:
                continue
            seen.add(file)
            content = COMMENT.sub(b"", read(file))
            if suffix in USD_SUFFIXES:
                names = _layers_of(file) if content else []
                named = [
                    [file.parent / name]
                    for name in names
                    if looks or scene_suffix(name) in STAGE_SUFFIXES
                ]
            else:
                uris = [uri.decode(errors="replace") for uri in URI.findall(content)]
                named = [
                    _model_places(list_sdf_paths(uri, file, folders))
                    for uri in uris
                    if looks or not uri.endswith(MATERIAL)
                ]
                if file.name == MODEL_CONFIG:
                    named = [[file.parent / name.decode()] for _, name in SDF_NAME.findall(content)]
            for places in named:
                choose(places)
                left += [place for place in places if has(place)]
    for mesh in [scene, *found]:
        if mesh.suffix.lower() == ".gltf":
            for uri in _buffer_names(read(mesh)):
                choose(mesh.parent / name for name in {uri, uri.strip(), unquote(uri)})
    return [scene, *sorted(found - {scene})]


def list_mesh_paths(urdf: Path, name: str) -> Iterator[Path]:
    """The possible places of a URDF's mesh, first to last.

    As written, then from the URDF's folder up by the tail of its path, the longest first:
    that finds ``package://pkg/meshes/a.dae`` without ROS.
    """
    bare = Path(name.split("://", 1)[-1])
    folders = [urdf.parent, *urdf.absolute().parent.parents]
    for first in range(len(bare.parts)):
        for folder in folders:
            yield folder.joinpath(*bare.parts[first:])


def list_sdf_paths(uri: str, file: Path, folders: Sequence[Path] = ()) -> Iterator[Path]:
    """The possible places of what an SDF file names, first to last.

    Beside the file, unless it is ``model://…`` or the like; in the folders, then in those of the
    environment variables `MODEL_PATHS`; then in the folders above the file, and in their
    ``models``. So a checkout of a world with its models needs no variable.
    """
    scheme, _, name = uri.rpartition("://")
    bare = Path(name.lstrip("/") if scheme not in ("", "file") else name)
    if scheme in ("", "file"):
        yield file.parent / bare
    elif scheme in ("http", "https"):  # of Fuel, by the model's own name
        bare = Path(bare.name)
    yield from (folder / bare for folder in folders)
    listed = (os.environ.get(name, "").split(os.pathsep) for name in MODEL_PATHS)
    yield from (Path(folder) / bare for of_one in listed for folder in of_one if folder)
    for above in file.absolute().parents:
        yield from (above / bare, above / "models" / bare)


def find_model_file(place: Path) -> Path:
    """The SDF file of a model's folder, the latest in its model.config; a file itself."""
    if not place.is_dir():
        return place
    config = place / MODEL_CONFIG
    content = COMMENT.sub(b"", config.read_bytes()) if config.is_file() else b""

    def version(named: tuple[bytes, bytes]) -> list[int]:
        return [int(word) for word in named[0].split(b".") if word]

    named = SDF_NAME.findall(content)
    return place / (max(named, key=version)[1].decode() if named else MODEL_SDF)


def _model_places(places: Iterable[Path]) -> list[Path]:
    """The possible files of what stands at some places, which may be folders of models."""
    return [
        path
        for place in places
        for path in ([place] if place.suffix else [place / MODEL_CONFIG, place / MODEL_SDF])
    ]


def _layers_of(layer: Path) -> list[str]:
    """The layers and textures that a layer of USD names, without those in stores.

    None without usd-core.
    """
    with suppress(ImportError):
        from pxr import Tf, UsdUtils  # of the extra [usd]

        quiet = UsdUtils.CoalescingDiagnosticDelegate()
        with suppress(Tf.ErrorException):  # whoever reads the layer says what is wrong
            named = UsdUtils.ExtractExternalReferences(str(layer))
            return [name for names in named for name in names if "://" not in name]
        quiet.TakeUncoalescedDiagnostics()
    return []


def _places_in_mjcf(
    scene: Path, elements: list[_Element], read: Callable[[Path], bytes], looks: bool
) -> list[list[Path]]:
    """For each file in MJCF, its possible places."""
    named: list[tuple[list[Path], str]] = []  # possible folders of the name, and the name
    folders = {""}
    left = [(scene, elements, scene.parent)]
    seen = set[tuple[str, ...]]()
    while left:
        file, own, home = left.pop()
        # another model: its file, and the folders of its names
        identity = tuple(map(os.path.realpath, (file, file.parent, home)))
        if identity in seen:
            continue
        seen.add(identity)
        bases = [*dict.fromkeys((scene.parent, home, file.parent))]
        for tag, attributes in own:
            keys = LOOK_FOLDERS if looks else FOLDERS
            folders.update(_slashed(attributes[key]) for key in keys if key in attributes)
            if tag in LOOKS and not looks:
                continue
            for key in LOOK_NAMES if looks else NAMES:
                name = _slashed(attributes.get(key, ""))
                if not name or "\0" in name:
                    continue
                named.append((bases, name))
                if tag not in MODELS and Path(name).suffix.lower() not in XML_SUFFIXES:
                    continue
                for path in _places(bases, [""], name):
                    if content := read(path):
                        inner_home = home if tag == "include" else path.parent
                        left.append((path, _parse_elements(content), inner_home))
    return [_places(bases, sorted(folders), name) for bases, name in named]


def _places(bases: Iterable[Path], folders: Iterable[str], name: str) -> list[Path]:
    """The possible paths of a name in MJCF; `strippath` of a compiler drops its folders.

    MuJoCo drops a folder before ``..``, even a link or one that is missing; the system follows it.
    """
    paths: dict[Path, None] = {}
    for folder in folders:
        for each in dict.fromkeys((name, os.path.basename(name))):
            for base in bases:
                path = base / folder / each
                paths[path] = None
                if os.pardir in path.parts:
                    paths[Path(os.path.normpath(path))] = None
    return list(paths)


def _buffer_names(content: bytes) -> list[str]:
    """The buffers of a glTF file that are files."""
    try:
        buffers = json.loads(content)["buffers"]
        uris = [str(each["uri"]) for each in buffers if "uri" in each]
    except (ValueError, RecursionError, LookupError, TypeError):
        return []
    return [uri for uri in uris if not uri.startswith("data:") and "\0" not in unquote(uri)]


def _slashed(name: str) -> str:
    """A path as MuJoCo reads it on any system: a backslash separates folders, too."""
    return name.replace("\\", "/")


def _parse_elements(content: bytes) -> list[_Element]:
    def text(value: bytes) -> str:
        """A name as the system's calls return it, also if it is no UTF-8."""
        return html.unescape(value.decode(errors="surrogateescape"))

    found = ELEMENT.findall(COMMENT.sub(b"", content))
    # of most elements, no attribute matters here
    found[1:] = [each for each in found[1:] if b"file" in each[1] or b"dir" in each[1]]
    return [
        (text(tag), {text(key): text(a or b) for key, a, b in ATTRIBUTE.findall(attributes)})
        for tag, attributes in found
    ]
