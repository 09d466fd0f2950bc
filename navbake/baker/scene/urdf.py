"""URDF made ready for MuJoCo: visuals kept, links not fused, mesh files found."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from navbake.baker.scene.names import unique_name
from navbake.errors import SceneError
from navbake.formats.scene_files import mesh_places


def read_urdf(path: Path) -> tuple[str, dict[str, Path]]:
    """Read a URDF: its XML for MuJoCo, and the file of each mesh by its key in that XML.

    Unless the file's own ``<mujoco><compiler/>`` says otherwise, visuals are kept and links that
    hang on a fixed joint keep their bodies and names, both against MuJoCo's defaults.

    Where a mesh is looked for: `navbake.formats.scene_files.mesh_places`.

    Raises:
        SceneError: the file is no XML, or a mesh is missing.
    """
    try:
        root = ElementTree.parse(path).getroot()
        taken: set[str] = set()
        keys: dict[Path, str] = {}
        for mesh in root.iter("mesh"):
            found = _find_mesh(path, mesh.get("filename", ""))
            if found not in keys:  # MuJoCo names a mesh by the stem of its file
                keys[found] = f"{unique_name(found.stem, taken)}.mesh"
            mesh.set("filename", keys[found])
        _set_compiler(root)
        text = ElementTree.tostring(root, encoding="unicode")
        return text, {key: found for found, key in keys.items()}
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SceneError(f"broken XML in {path}: {error}") from error
    except RecursionError as error:
        raise SceneError(f"broken XML in {path}: it is nested too deep") from error


def _find_mesh(urdf: Path, filename: str) -> Path:
    for place in mesh_places(urdf, filename):
        if place.is_file():
            return place
    raise SceneError(f"mesh {filename!r} of {urdf} not found there or in the folders above it")


def _set_compiler(root: ElementTree.Element) -> None:
    place = root
    for tag in ("mujoco", "compiler"):
        found = place.find(tag)
        place = ElementTree.SubElement(place, tag) if found is None else found
    place.attrib = {"discardvisual": "false", "fusestatic": "false", **place.attrib, "meshdir": ""}
    place.attrib.pop("assetdir", None)
