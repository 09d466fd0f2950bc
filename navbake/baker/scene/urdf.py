"""URDF made ready for MuJoCo: visuals kept, links not fused, mesh files found."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from navbake.baker.scene.names import unique_name
from navbake.errors import SceneError
from navbake.formats.scene_files import mesh_places


def read_urdf(
    path: Path, geoms: str = "auto", warnings: list[str] | None = None
) -> tuple[str, dict[str, Path]]:
    """Read a URDF: its XML for MuJoCo, and the file of each mesh by its key in that XML.

    Unless the file's own ``<mujoco><compiler/>`` says otherwise, visuals are kept and links that
    hang on a fixed joint keep their bodies and names, both against MuJoCo's defaults.

    Where a mesh is looked for: `navbake.formats.scene_files.mesh_places`. A visual whose mesh is
    missing is left out, with a warning, where visuals don't count: the file discards them, or it
    has collision geometry and `scene.geoms` counts that.

    Raises:
        SceneError: the file is no XML, or a mesh is missing that counts.
    """
    try:
        root = ElementTree.parse(path).getroot()
        compiler = root
        for tag in ("mujoco", "compiler"):
            found = compiler.find(tag)
            compiler = ElementTree.SubElement(compiler, tag) if found is None else found
        own = {"discardvisual": "false", "fusestatic": "false"}
        compiler.attrib = {**own, **compiler.attrib, "meshdir": ""}
        compiler.attrib.pop("assetdir", None)
        has_collision = root.find("link/collision/geometry") is not None
        is_discarded = compiler.get("discardvisual") == "true"
        if is_discarded or (geoms not in ("visual", "all") and has_collision):
            left_out = _drop_missing_visuals(root, path)
            if left_out and warnings is not None:
                more = f" and {len(left_out) - 1} more" if left_out[1:] else ""
                warnings.append(
                    f"mesh {left_out[0]!r}{more} of {path} not found: left out, as it is only "
                    "drawn, and visuals don't count here"
                )
        taken: set[str] = set()
        keys: dict[Path, str] = {}
        for mesh in root.iter("mesh"):
            name = mesh.get("filename", "")
            file = _find_mesh(path, name)
            if file is None:
                raise SceneError(_not_found(path, name))
            if file not in keys:  # MuJoCo names a mesh by the stem of its file
                keys[file] = f"{unique_name(file.stem, taken)}.mesh"
            mesh.set("filename", keys[file])
        text = ElementTree.tostring(root, encoding="unicode")
        return text, {key: file for file, key in keys.items()}
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise SceneError(f"broken XML in {path}: {error}") from error


def _drop_missing_visuals(root: ElementTree.Element, path: Path) -> list[str]:
    """Remove the visuals whose mesh is missing, and list those meshes."""
    missing = []
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            names = [mesh.get("filename", "") for mesh in visual.iter("mesh")]
            lost = [name for name in names if _find_mesh(path, name) is None]
            if lost:
                link.remove(visual)
                missing += lost
    return missing


def _find_mesh(urdf: Path, filename: str) -> Path | None:
    return next((place for place in mesh_places(urdf, filename) if place.is_file()), None)


def _not_found(urdf: Path, filename: str) -> str:
    scheme, _, bare = filename.rpartition("://")
    parts = Path(bare).parts
    tails = [repr(str(Path(*parts[first:]))) for first in range(1, len(parts))]
    also = f"also as {', '.join(tails)}; " if tails else ""
    package = ""
    if scheme == "package" and parts:
        package = f"put the folder of the package {parts[0]!r} beside or above the URDF, or "
    return (
        f"mesh {filename!r} of {urdf} not found there, in {urdf.absolute().parent} or in the "
        f"folders above it: {also}{package}write its path from the URDF's folder"
    )
