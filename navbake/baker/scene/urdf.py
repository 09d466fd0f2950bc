"""URDF made ready for MuJoCo: visuals kept, links not fused, mesh files found."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

from navbake.errors import SceneError


@dataclass(frozen=True)
class Urdf:
    """A URDF whose meshes have names that MuJoCo can carry.

    Attributes:
        text: the XML; its mesh files are keys of `meshes`.
        meshes: where each mesh file is.
    """

    text: str
    meshes: dict[str, Path]


def read_urdf(path: Path) -> Urdf:
    """Read a URDF and find its meshes.

    Unless the file's own ``<mujoco><compiler/>`` says otherwise, visuals are kept and links that
    hang on a fixed joint keep their bodies and names, both against MuJoCo's defaults.

    A mesh is looked for as it is written, then, from the URDF's folder up, by the tail of its
    path, the longest first: that finds ``package://pkg/meshes/a.dae`` without ROS.

    Args:
        path: the file.

    Raises:
        SceneError: it is no XML, or a mesh is missing.
    """
    try:
        root = ElementTree.parse(path).getroot()
        meshes: dict[str, Path] = {}
        keys: dict[Path, str] = {}
        for mesh in root.iter("mesh"):
            found = _find_mesh(path, mesh.get("filename", ""))
            if found not in keys:
                keys[found] = _free_key(found, meshes)
                meshes[keys[found]] = found
            mesh.set("filename", keys[found])
        _set_compiler(root)
        return Urdf(ElementTree.tostring(root, encoding="unicode"), meshes)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SceneError(f"broken XML in {path}: {error}") from error
    except RecursionError as error:
        raise SceneError(f"broken XML in {path}: it is nested too deep") from error


def _find_mesh(urdf: Path, filename: str) -> Path:
    bare = Path(filename.split("://", 1)[-1])
    folders = [urdf.parent, *urdf.absolute().parent.parents]
    for first in range(len(bare.parts)):
        for folder in folders:
            candidate = folder.joinpath(*bare.parts[first:])
            if candidate.is_file():
                return candidate
    raise SceneError(f"mesh {filename!r} of {urdf} not found there, nor in the folders above it")


def _free_key(found: Path, taken: dict[str, Path]) -> str:
    """A file name without folders, and unlike the others; MuJoCo names meshes by its stem."""
    key, count = f"{found.stem}.mesh", 1
    while key in taken:
        count += 1
        key = f"{found.stem}#{count}.mesh"
    return key


def _set_compiler(root: ElementTree.Element) -> None:
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    for key in ("discardvisual", "fusestatic"):
        if compiler.get(key) is None:
            compiler.set(key, "false")
    compiler.set("meshdir", "")
    compiler.attrib.pop("assetdir", None)
