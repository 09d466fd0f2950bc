"""The files that a scene is made of."""

from __future__ import annotations

import json
import os
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol
from urllib.parse import unquote
from xml.etree import ElementTree

from navbake.formats.mjcf.xml_tree import read_elements

XML_SUFFIXES = (".xml", ".mjcf", ".urdf")
MODELS = ("include", "model", "attach")  # elements whose file is XML, whatever its name
MOST_FILES = 10_000  # of XML, that a scene is followed to: links may make any number of one
LOOKS = ("texture", "skin")  # what changes how a scene looks, and no cell
# attributes of a compiler that say where files are; of looks as well
FOLDERS = ("meshdir", "assetdir")
LOOK_FOLDERS = (*FOLDERS, "texturedir")
# attributes that name a file, in MJCF and in URDF that it attaches; of looks as well, of which a
# cube has one a side
NAMES = ("file", "filename")
LOOK_NAMES = (*NAMES, "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")


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
        folders: that come into question, the scene's own first; most have few of the names.
        names: of files, as they are in the XML, with slashes.
    """

    folders: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    def places_of(self, name: str) -> Iterator[Path]:
        """All paths at which a name would be found."""
        for each in _variants(name):
            for folder in self.folders:
                yield from _meant(Path(folder, each))

    def present(self, listed: Folders) -> Iterator[str]:
        """The paths of all names that may be files, by the listings of the folders.

        `os.path.isfile` says whether one is. Names and folders are many, and a folder has few of
        the names. So the names are kept as a tree of their parts, and each folder's listing is
        compared with the tree, part by part.
        """
        tree = _Branch()
        for name in dict.fromkeys(each for whole in self.names for each in _variants(whole)):
            if os.path.isabs(name) or os.path.splitdrive(name)[0]:
                yield from map(str, _meant(Path(name)))  # whatever the folder
            else:
                tree.add(name)
        for folder in self.folders if tree.parts else ():
            left = [(folder, tree)]
            while left:  # no recursion: a stranger's name may have any number of parts
                place, branch = left.pop()
                here = listed.content(place)
                few, many = sorted((branch.parts, branch.parts if here is None else here), key=len)
                for key in (key for key in few if key in many):
                    for part, deeper in branch.parts[key].items():
                        for path in listed.at(place, part):
                            if deeper.is_end:
                                yield path
                            if deeper.parts:
                                left.append((path, deeper))


@dataclass(slots=True)
class _Branch:
    """Names of files that begin alike.

    Attributes:
        is_end: whether one of them ends here.
        parts: how the others go on, up to the next slash: first by `fold_name`, then as it is
            written.
    """

    is_end: bool = False
    parts: dict[str, dict[str, _Branch]] = field(default_factory=dict)

    def add(self, name: str) -> None:
        branch = self
        for part in name.split("/"):
            if part not in ("", os.curdir):
                branch = branch.parts.setdefault(fold_name(part), {}).setdefault(part, _Branch())
        branch.is_end = True


class Folders:
    """What is in folders, each of which is listed once.

    Args:
        base: that relative paths of folders count from.
    """

    def __init__(self, base: str | os.PathLike[str] = "") -> None:
        self._base = base
        self._content: dict[str, frozenset[str] | None] = {}

    def content(self, folder: str) -> frozenset[str] | None:
        """The keys of the names in a folder; None if it can't be listed, but may have files."""
        if folder not in self._content:
            self._content[folder] = self._list(folder)
        return self._content[folder]

    def at(self, folder: str, part: str) -> tuple[str, ...]:
        """What a part of a path may mean in a folder; ``..`` of a link has two, see `_meant`."""
        if folder == os.curdir:
            return (part,)
        path = os.path.join(folder, part)
        if part != os.pardir or os.path.basename(folder) == os.pardir:
            return (path,)
        above = os.path.dirname(folder) or os.curdir
        return (path, above) if os.path.islink(os.path.join(self._base, folder)) else (above,)

    def _list(self, folder: str) -> frozenset[str] | None:
        try:
            names = os.listdir(os.path.join(self._base, folder) or os.curdir)
        except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: no path at all
            return frozenset((os.pardir,))  # by which MuJoCo goes on, see `_meant`
        except OSError:  # one that may be entered, but not read
            return None
        return frozenset((os.pardir, *map(fold_name, names)))


def fold_name(name: str) -> str:
    """A name without what some file systems ignore: capitals, and how accents are composed.

    Names that differ in nothing else may be one file. This is Unicode's canonical caseless
    matching.
    """
    if name.isascii():
        return name.lower()
    return unicodedata.normalize("NFD", unicodedata.normalize("NFD", name).casefold())


def _meant(*paths: Path) -> Iterator[Path]:
    """Paths, each as MuJoCo reads it and as the system does, if that is not the same.

    MuJoCo drops a folder before ``..``, even one that is missing, or a link. The system finds
    nothing in a missing folder, and goes on from where a link leads to.
    """
    for path in paths:
        if os.pardir in path.parts:
            short = os.path.normpath(path)
            if not os.path.exists(path) or os.path.realpath(short) != os.path.realpath(path):
                yield Path(short)
        yield path


def _variants(name: str) -> Iterable[str]:
    """What a name may mean: `strippath` of a compiler leaves out the folders of names.

    MuJoCo drops those before ``..`` as well, see `_meant`.
    """
    short = os.path.normpath(name) if os.pardir in name.split("/") else name
    return dict.fromkeys((name, short, os.path.basename(name)))


def find_inputs(
    scene: Path, files: Files = HERE, *, looks: bool = False, missing: bool = False
) -> list[Path]:
    """The files that a scene is made of, as far as they are there: itself first, then sorted.

    In MJCF these are all that an element names as its ``file``, in included files and attached
    models as well, but for textures and skins. Which folder a name counts from depends on the
    compiler's settings and on MuJoCo's version, so it is looked for in all that come into question:
    one file too many costs a bake that was not needed, one too few a stale grid. Folders that these
    count from are the scene's, the file's, and that of the attached model which includes it. XML
    that MuJoCo's parser refuses names nothing after its error. Of URDF they are the meshes, of glTF
    the files of numbers beside it.

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
        if files is HERE and not missing:  # the same, and quick
            found = {Path(place) for place in search.present(Folders()) if os.path.isfile(place)}
        else:
            places = ([*search.places_of(name)] for name in search.names)
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
    left, seen = [(scene, root, scene.parent)], {_place(scene, scene.parent)}
    while left:
        file, top, home = left.pop()
        bases = dict.fromkeys((scene.parent, home, file.parent))
        for element in () if top is None else top.iter():
            for key in LOOK_FOLDERS if looks else FOLDERS:
                if key in element.attrib:
                    folders |= dict.fromkeys(places_from(bases, element.attrib[key]))
            if element.tag in left_out:
                continue
            for name in _names_of(element, looks):
                names[name] = None
                for path in places_from(bases, name):
                    is_xml = path.suffix.lower() in XML_SUFFIXES or element.tag in MODELS
                    if not is_xml or len(seen) == MOST_FILES or not files.has(path):
                        continue
                    folders[path.parent] = None
                    base = home if element.tag == "include" else path.parent
                    place = _place(path, base)
                    if place not in seen:
                        seen.add(place)
                        left.append((path, _root(path, files), base))
    return Search(tuple(map(str, folders)), tuple(names))


def _place(path: Path, home: Path) -> tuple[str, ...]:
    """What makes XML another one: names in it count from where it is reached, even by a link."""
    return os.path.normpath(path), os.path.realpath(path), os.path.normpath(home)


def places_from(folders: Iterable[Path], name: str) -> Iterator[Path]:
    """The paths that a name in MJCF may mean, as it counts from any of some folders."""
    return _meant(*(folder / _slashed(name) for folder in folders))


def _found(places: list[Path], files: Files, missing: bool) -> list[Path]:
    """Those places where a file is; all of them where it is nowhere and that is asked for."""
    return [place for place in places if files.has(place)] or (places if missing else [])


def _names_of(element: ElementTree.Element, looks: bool) -> list[str]:
    names = (element.get(key) for key in (LOOK_NAMES if looks else NAMES))
    return [_slashed(name) for name in names if name]


def _slashed(name: str) -> str:
    """A path as MuJoCo reads it on any system: a backslash stands between folders, too."""
    return name.replace("\\", "/")


def _root(path: Path, files: Files) -> ElementTree.Element | None:
    """The root element of an XML file; None where it is broken or missing."""
    if not files.has(path):
        return None
    files.bring(path)
    try:
        # who reads a pipe may wait for ever
        return read_elements(path.read_bytes()) if os.path.isfile(path) else None
    except OSError:
        return None
