"""The files that a scene is made of."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol
from urllib.parse import unquote
from xml.etree import ElementTree

XML_SUFFIXES = (".xml", ".mjcf", ".urdf")
MODELS = ("include", "model", "attach")  # elements whose file is MJCF, whatever its name
LOOKS = ("texture", "skin")  # what changes how a scene looks, and no cell
# attributes of a compiler that say where files are; of looks as well
FOLDERS = ("meshdir", "assetdir")
LOOK_FOLDERS = (*FOLDERS, "texturedir")
# attributes that name a file; of looks as well, of which a cube has one a side
NAMES = ("file",)
LOOK_NAMES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")


class Files(Protocol):
    """Where a scene's files are looked for."""

    def has(self, path: Path) -> bool:
        """Whether there is such a file."""

    def bring(self, path: Path) -> None:
        """Make ready for reading what `has` found."""


class FilesHere:
    """The files of this machine."""

    def has(self, path: Path) -> bool:
        """Whether there is such a file; a pipe or a folder is none."""
        return os.path.isfile(path)

    def bring(self, path: Path) -> None:
        """Do nothing: it is there."""


HERE = FilesHere()


class Search(NamedTuple):
    """Where the files that MJCF names are looked for: each name in each folder.

    Attributes:
        folders: that come into question; most have few of the names.
        names: of files, as they are in the XML, with slashes.
    """

    folders: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    def places(self) -> Iterator[str]:
        """All paths at which a file would be one of the scene's."""
        for name in self.names:
            yield from self.places_of(name)

    def places_of(self, name: str) -> Iterator[str]:
        """All paths at which a name would be found."""
        # `strippath` of a compiler leaves out the folders of names
        for each in dict.fromkeys((name, os.path.basename(name))):
            for folder in self.folders:
                yield os.path.join(folder, each)


def find_inputs(
    scene: Path, files: Files = HERE, *, looks: bool = False, missing: bool = False
) -> list[Path]:
    """The files that a scene is made of, as far as they are there: itself first, then sorted.

    In MJCF these are all that an element names as its ``file``, in included files and attached
    models as well, but for textures and skins. Which folder a name counts from depends on the
    compiler's settings and on MuJoCo's version, so it is looked for in all that come into question:
    one file too many costs a bake that was not needed, one too few a stale grid. XML that is broken
    names nothing. Of URDF they are the meshes, of glTF the files of numbers beside it.

    Args:
        scene: its file.
        files: where to look for the others.
        looks: whether textures and skins are asked for as well.
        missing: whether to list, of a file that is nowhere, all places where it is looked for.
    """
    return look_for_inputs(scene, files, looks=looks, missing=missing)[0]


def look_for_inputs(
    scene: Path, files: Files = HERE, *, looks: bool = False, missing: bool = False
) -> tuple[list[Path], Search]:
    """`find_inputs`, and where the files were looked for, which is told of MJCF only."""
    search = Search()
    suffix = scene.suffix.lower()
    root = _root(scene, files) if suffix in XML_SUFFIXES else None
    if root is None:
        found = {*_buffers((scene,), files, missing)}
    elif root.tag == "robot":
        meshes = {*_meshes_of_urdf(scene, root, files, missing)}
        found = {*meshes, *_buffers(meshes, files, missing)}
    else:
        search = _search(scene, root, files, looks)
        places = ([*map(Path, search.places_of(name))] for name in search.names)
        found = {path for each in places for path in _found(each, files, missing)}
    return [scene, *sorted(found - {scene})], search


def mesh_places(urdf: Path, name: str) -> Iterator[Path]:
    """Where a mesh that a URDF names is looked for, first to last.

    As it is written, then, from the URDF's folder up, by the tail of its path, the longest first:
    that finds ``package://pkg/meshes/a.dae`` without ROS.
    """
    bare = Path(name.split("://", 1)[-1])
    folders = [urdf.parent, *urdf.absolute().parent.parents]
    for first in range(len(bare.parts)):
        for folder in folders:
            yield folder.joinpath(*bare.parts[first:])


def _meshes_of_urdf(
    scene: Path, root: ElementTree.Element, files: Files, missing: bool
) -> Iterator[Path]:
    for mesh in root.iter("mesh"):
        places = [*mesh_places(scene, mesh.get("filename", ""))]
        found = next((place for place in places if files.has(place)), None)
        yield from (places if missing else ()) if found is None else (found,)


def _buffers(meshes: Iterable[Path], files: Files, missing: bool) -> Iterator[Path]:
    """The files that glTF files keep their numbers in."""
    for mesh in meshes:
        if mesh.suffix.lower() != ".gltf" or not files.has(mesh):
            continue
        files.bring(mesh)
        try:
            header = json.loads(mesh.read_bytes())
            uris = [str(buffer["uri"]) for buffer in header["buffers"] if "uri" in buffer]
        except (OSError, ValueError, RecursionError, LookupError, TypeError):
            continue
        for uri in uris:
            names = () if uri.startswith("data:") else {uri, uri.strip(), unquote(uri)}
            places = [mesh.parent / name for name in names if "\0" not in name]
            yield from _found(places, files, missing)


def _search(scene: Path, root: ElementTree.Element | None, files: Files, looks: bool) -> Search:
    names: dict[str, None] = {}
    folders = {scene.parent: None}
    left_out = () if looks else LOOKS
    left, seen = [(scene, root)], {os.path.realpath(scene)}
    while left:
        file, top = left.pop()
        for element in () if top is None else top.iter():
            for key in LOOK_FOLDERS if looks else FOLDERS:
                if key in element.attrib:
                    for home in (scene.parent, file.parent):
                        folders[home / _slashed(element.attrib[key])] = None
            if element.tag in left_out:
                continue
            for name in _names_of(element, looks):
                names[name] = None
                for path in (scene.parent / name, file.parent / name):
                    is_xml = path.suffix.lower() in XML_SUFFIXES or element.tag in MODELS
                    if is_xml and files.has(path) and os.path.realpath(path) not in seen:
                        seen.add(os.path.realpath(path))
                        folders[path.parent] = None
                        left.append((path, _root(path, files)))
    return Search(tuple(map(str, folders)), tuple(names))


def _found(places: list[Path], files: Files, missing: bool) -> list[Path]:
    """Those places where a file is; all of them where it is nowhere and that is asked for."""
    return [place for place in places if files.has(place)] or (places if missing else [])


def _names_of(element: ElementTree.Element, looks: bool) -> list[str]:
    names = (element.get(key) for key in (LOOK_NAMES if looks else NAMES))
    return [_slashed(name) for name in names if name]


def _slashed(name: str) -> str:
    """A path as MuJoCo reads it on any system: a backslash stands between folders, too."""
    return name.replace("\\", "/")


def _root(path: Path, files: Files) -> Any:
    """The root element of an XML file; None where it is broken or missing."""
    if not files.has(path):
        return None
    files.bring(path)
    try:
        # who reads a pipe may wait for ever
        return ElementTree.parse(path).getroot() if os.path.isfile(path) else None
    except (OSError, ElementTree.ParseError, ValueError, LookupError, RecursionError):
        return None
