"""The files that a scene is made of."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from navbake.baker.scene.urdf import read_urdf
from navbake.errors import SceneError

XML_SUFFIXES = (".xml", ".mjcf", ".urdf")
FOLDERS = ("meshdir", "assetdir")  # attributes of a compiler that say where files are
LOOKS = ("texture", "skin")  # what changes how a scene looks, and no cell


def find_inputs(scene: Path) -> list[Path]:
    """The files that a scene is made of, as far as they are there: itself first, then sorted.

    In MJCF these are all that an element names as its ``file``, in included files and attached
    models as well, but for textures and skins. Which folder a name counts from depends on the
    compiler's settings and on MuJoCo's version, so it is looked for in all that come into question:
    one file too many costs a bake that was not needed, one too few a stale grid. XML that is broken
    names nothing.
    """
    if scene.suffix.lower() not in XML_SUFFIXES:
        return [scene]
    root = _root(scene)
    if root is not None and root.tag == "robot":
        return [scene, *sorted(_meshes_of_urdf(scene))]
    return [scene, *sorted(set(_named_files(scene)) - {scene})]


def _meshes_of_urdf(scene: Path) -> set[Path]:
    try:
        return {*read_urdf(scene)[1].values()}
    except SceneError:
        return set()


def _named_files(scene: Path) -> Iterator[Path]:
    names: dict[str, None] = {}
    folders = {scene.parent: None}
    left, seen = [scene], {os.path.realpath(scene)}
    while left:
        file = left.pop()
        root = _root(file)
        for element in () if root is None else root.iter():
            for key in FOLDERS:
                if key in element.attrib:
                    for home in (scene.parent, file.parent):
                        folders[home / element.attrib[key]] = None
            name = element.get("file")
            if not name or element.tag in LOOKS:
                continue
            names[name] = None
            for path in (scene.parent / name, file.parent / name):
                is_xml = path.suffix.lower() in XML_SUFFIXES and os.path.isfile(path)
                if is_xml and os.path.realpath(path) not in seen:
                    seen.add(os.path.realpath(path))
                    folders[path.parent] = None
                    left.append(path)
    for name in names:
        for folder in folders:
            # `strippath` of a compiler leaves out the folders of names
            for path in (folder / name, folder / Path(name).name):
                if os.path.isfile(path):
                    yield path


def _root(path: Path) -> ElementTree.Element | None:
    try:
        # who reads a pipe may wait for ever
        return ElementTree.parse(path).getroot() if os.path.isfile(path) else None
    except (OSError, ElementTree.ParseError, ValueError, LookupError, RecursionError):
        return None
