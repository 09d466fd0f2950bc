"""A scene as the bake sees it: which geoms count, as what, and where; the one user of mujoco."""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from navbake.bake.shapes import (
    FAR,
    Planes,
    Shapes,
    Solids,
    Triangles,
    height_field_triangles,
    is_closed_solid,
    solid_bounds,
)
from navbake.config import SceneSettings
from navbake.errors import SceneError
from navbake.kernels.sheets import SOLID, SURFACE

PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
HFIELD = int(mujoco.mjtGeom.mjGEOM_HFIELD)
MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
SDF = int(mujoco.mjtGeom.mjGEOM_SDF)
GEOM_TYPES = {
    int(t): t.name.removeprefix("mjGEOM_").lower()
    for t in (mujoco.mjtGeom(i) for i in range(int(mujoco.mjtGeom.mjNGEOMTYPES)))
}


@dataclass(frozen=True)
class GeomReport:
    """What became of one geom, for `navbake geoms`.

    Attributes:
        id: MuJoCo's geom id.
        name: its name, or ``geom <id>`` where it has none.
        body: its body's name, or ``body <id>``.
        type: MuJoCo's type: plane, hfield, sphere, capsule, ellipsoid, cylinder, box, mesh, sdf.
        counted: whether it takes part in the bake.
        shape: as what: ``solid``, ``half-space``, ``rectangle``, ``hull``, ``surface``; a surface
            that is closed counts as ``closed surface``; empty where it isn't counted.
        reason: why it is counted or left out.
    """

    id: int
    name: str
    body: str
    type: str
    counted: bool
    shape: str
    reason: str


@dataclass
class Scene:
    """A posed scene, ready for rays and overlaps.

    Attributes:
        id: the scene's id.
        geoms: what became of each geom, by geom id.
        shapes: the counted geoms' geometry, world frame.
        bounds: (2, 3) float64, lower and upper corner of all counted finite geoms [m], or None
            where only infinite planes count.
        digest: sha256 of all geoms' names, types, sizes, poses and vertices.
        warnings: what the user should know, one line each.
        model: the compiled mujoco.MjModel.
        data: its mujoco.MjData in the pose that is baked.
    """

    id: str
    geoms: list[GeomReport]
    shapes: Shapes
    bounds: NDArray[np.float64] | None
    digest: str
    warnings: list[str] = field(default_factory=list)
    model: Any = None
    data: Any = None


def mujoco_version() -> str:
    """The installed MuJoCo's version."""
    return str(mujoco.__version__)


def load_scene(settings: SceneSettings) -> Scene:
    """Load a scene, pose it and choose the geoms that count.

    Args:
        settings: the `scene` part of the configuration, its path absolute.

    Returns:
        The scene. Nothing of it changes later.

    Raises:
        SceneError: the file is missing, broken, or holds no geom that counts; a keyframe or
            joint is unknown.
    """
    model, notes = _load_model(settings)
    data = _pose(model, settings)
    chosen = _choose_geoms(model, settings, notes)
    shapes, reports = _collect_shapes(model, data, chosen)
    if not any(report.counted for report in reports):
        raise SceneError(_nothing_counts(settings, reports))
    return Scene(
        id=settings.id or Path(settings.path).stem,
        geoms=reports,
        shapes=shapes,
        bounds=shapes.bounds(),
        digest=_digest(model, data),
        warnings=notes,
        model=model,
        data=data,
    )


def mujoco_library() -> str:
    """Path of MuJoCo's shared library, whose rays the kernels call."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            return str(path)
    raise SceneError(f"MuJoCo's shared library is not in {folder}: reinstall mujoco")


# ---------------------------------------------------------------- loading


def _load_model(settings: SceneSettings) -> tuple[Any, list[str]]:
    from navbake.bake.mesh_scene import MESH_SUFFIXES

    path = Path(settings.path)
    if not path.exists():
        raise SceneError(f"no scene file at {path}")
    if not path.is_file():
        raise SceneError(f"expected a scene file, got a folder at {path}")
    suffix = path.suffix.lower()
    notes: list[str] = []
    if suffix in MESH_SUFFIXES:
        model = _model_from_mesh(path, settings)
    elif suffix == ".mjb":
        model = _compile(path, lambda: mujoco.MjModel.from_binary_path(str(path)))
    elif suffix in {".xml", ".urdf", ".mjcf"}:
        model = _model_from_xml(path)
    else:
        known = ", ".join(sorted({".xml", ".mjcf", ".mjb", ".urdf"} | MESH_SUFFIXES))
        raise SceneError(f"cannot tell what {path} is: expected one of {known}")
    for count, kind, names in (
        (model.nflex, "flex", [model.flex(i).name for i in range(model.nflex)]),
        (model.nskin, "skin", [model.skin(i).name for i in range(model.nskin)]),
    ):
        if count:
            listed = ", ".join(n or f"{kind} {i}" for i, n in enumerate(names))
            notes.append(f"{kind} can't be baked and is left out: {listed}")
    return model, notes


def _compile(path: Path, load: Any) -> Any:
    try:
        return load()
    except Exception as error:  # mujoco raises ValueError, FatalError and UnexpectedError
        reason = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(f"MuJoCo cannot load {path}: {reason[:400]}") from error


def _model_from_xml(path: Path) -> Any:
    if path.stat().st_size == 0:
        raise SceneError(f"{path} is empty: expected an MJCF or URDF scene")
    root_tag = _root_tag(path)
    if root_tag == "robot":
        text, assets = _prepare_urdf(path)
        return _compile(path, lambda: mujoco.MjModel.from_xml_string(text, assets))
    return _compile(path, lambda: mujoco.MjModel.from_xml_path(str(path)))


def _root_tag(path: Path) -> str:
    try:
        for _, element in ElementTree.iterparse(path, events=("start",)):
            return element.tag
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SceneError(f"broken XML in {path}: {error}") from error
    raise SceneError(f"broken XML in {path}: no element found")


def _prepare_urdf(path: Path) -> tuple[str, dict[str, bytes]]:
    """Make a URDF ready for MuJoCo: visuals kept, links not fused, mesh paths resolved.

    MuJoCo drops visuals, fuses fixed links and strips folders from mesh names unless told
    otherwise, and reads neither DAE nor GLB nor PLY; those are handed to it as STL.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise SceneError(f"broken XML in {path}: {error}") from error
    assets: dict[str, bytes] = {}
    for mesh in root.iter("mesh"):
        filename = mesh.get("filename", "")
        found = _resolve_urdf_mesh(path, filename)
        if found is None:
            raise SceneError(f"mesh {filename!r} not found for {path}")
        name = f"{len(assets):04d}_{found.stem}"
        if found.suffix.lower() in {".obj", ".stl"}:
            name += found.suffix.lower()
            assets[name] = found.read_bytes()
        else:
            name += ".stl"
            assets[name] = _as_stl(found)
        mesh.set("filename", name)
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    for key, value in (("discardvisual", "false"), ("fusestatic", "false"), ("meshdir", "")):
        if compiler.get(key) is None or key == "meshdir":
            compiler.set(key, value)
    return ElementTree.tostring(root, encoding="unicode"), assets


def _resolve_urdf_mesh(urdf: Path, filename: str) -> Path | None:
    """Find a URDF's mesh: as written, or under the URDF's folders by the tail of its path."""
    bare = filename.split("://", 1)[-1]
    if filename.startswith("file://") and Path(bare).is_file():
        return Path(bare)
    parts = Path(bare).parts
    for folder in [urdf.parent, *urdf.parent.parents][:6]:
        for first in range(len(parts)):
            candidate = folder.joinpath(*parts[first:])
            if candidate.is_file():
                return candidate
    return None


def _as_stl(path: Path) -> bytes:
    """The triangles of any mesh that trimesh reads, as binary STL."""
    from navbake.bake.mesh_scene import read_mesh_parts

    corners = np.concatenate([p.vertices[p.faces] for p in read_mesh_parts(path)])
    record = np.zeros(
        len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")]
    )
    record["corners"] = corners
    return b"\0" * 80 + np.uint32(len(corners)).tobytes() + record.tobytes()


def _model_from_mesh(path: Path, settings: SceneSettings) -> Any:
    """Turn a mesh file into a model: one static geom a part, which can't collide."""
    from navbake.bake.mesh_scene import read_mesh_parts

    spec = mujoco.MjSpec()
    for part in read_mesh_parts(path, settings.up, settings.unit):
        used, faces = np.unique(part.faces, return_inverse=True)
        vertices = part.vertices[used]
        if len(vertices) < 4:  # MuJoCo wants four
            vertices = np.concatenate([vertices, vertices[-1:]])
        mesh = spec.add_mesh(name=part.name)
        mesh.uservert = np.ascontiguousarray(vertices, dtype=np.float32).ravel()
        mesh.userface = np.ascontiguousarray(faces, dtype=np.int32).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it need not be closed
        body = spec.worldbody.add_body(name=part.name)
        body.add_geom(
            name=part.name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=part.name,
            contype=0,
            conaffinity=0,
        )
    return _compile(path, spec.compile)


# ---------------------------------------------------------------- posing


def _pose(model: Any, settings: SceneSettings) -> Any:
    data = mujoco.MjData(model)
    if settings.keyframe is not None:
        mujoco.mj_resetDataKeyframe(model, data, _keyframe_id(model, settings))
    for name, value in settings.joints.items():
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint < 0:
            names = [model.joint(i).name for i in range(model.njnt)]
            raise SceneError(
                f"no joint {name!r} for `scene.joints` in {settings.path}: it has "
                f"{_listed(names)}"
            )
        width = {0: 7, 1: 4}.get(int(model.jnt_type[joint]), 1)
        values = np.atleast_1d(np.asarray(value, dtype=np.float64))
        if values.shape != (width,):
            raise SceneError(
                f"expected {width} numbers for joint {name!r} in `scene.joints`, "
                f"got {values.size}"
            )
        address = int(model.jnt_qposadr[joint])
        data.qpos[address : address + width] = values
    mujoco.mj_kinematics(model, data)
    return data


def _keyframe_id(model: Any, settings: SceneSettings) -> int:
    key = settings.keyframe
    if isinstance(key, str):
        found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, key)
        if found >= 0:
            return int(found)
        names = [model.key(i).name for i in range(model.nkey)]
        raise SceneError(
            f"no keyframe {key!r} for `scene.keyframe` in {settings.path}: it has {_listed(names)}"
        )
    if key is None or not 0 <= key < model.nkey:
        raise SceneError(
            f"expected a keyframe below {model.nkey} at `scene.keyframe`, got {key}, "
            f"in {settings.path}"
        )
    return key


def _listed(names: list[str]) -> str:
    named = [n for n in names if n]
    if not named:
        return "none with a name"
    return ", ".join(named[:20]) + (f" and {len(named) - 20} more" if len(named) > 20 else "")


# ---------------------------------------------------------------- choosing


@dataclass(frozen=True)
class _Choice:
    counted: bool
    reason: str
    mesh_mode: str  # "hull" or "surface", for meshes


def _choose_geoms(model: Any, settings: SceneSettings, notes: list[str]) -> list[_Choice]:
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    visible = _alpha(model) > 0
    mode = settings.geoms
    any_collides = bool(collides.any())
    if mode == "auto":
        mode = "collision" if any_collides else "visual"
    excluded = _excluded(model, settings, notes)
    has_visual = np.zeros(model.nbody, dtype=bool)
    np.logical_or.at(has_visual, model.geom_bodyid, ~collides & visible)
    choices = []
    for geom in range(model.ngeom):
        name, mesh_name, body_name = _geom_names(model, geom)
        mesh_mode = _mesh_mode(settings, (name, mesh_name, body_name))
        if mesh_mode == "auto":
            mesh_mode = "hull" if collides[geom] else "surface"
        if excluded[geom]:
            choices.append(_Choice(False, excluded[geom], mesh_mode))
            continue
        body_has_visual = bool(has_visual[model.geom_bodyid[geom]])
        counted, reason = _by_mode(mode, bool(collides[geom]), bool(visible[geom]), body_has_visual)
        if settings.geoms == "auto" and not any_collides and counted:
            reason = "no geom can collide, so all visible ones count"
        choices.append(_Choice(counted, reason, mesh_mode))
    return choices


def _by_mode(mode: str, collides: bool, visible: bool, body_has_visual: bool) -> tuple[bool, str]:
    if mode == "all":
        return True, "all geoms count"
    if mode == "collision":
        return collides, "can collide" if collides else "can't collide (contype, conaffinity 0)"
    if not visible:
        return False, "invisible (alpha 0)"
    if not collides:
        return True, "visual: can't collide"
    if body_has_visual:
        return False, "collision stand-in of a body that has visual geoms"
    return True, "visible, and its body has no visual geom beside it"


def _alpha(model: Any) -> NDArray[np.float64]:
    alpha = model.geom_rgba[:, 3].astype(np.float64)
    material = model.geom_matid
    has_material = material >= 0
    if has_material.any():
        alpha[has_material] *= model.mat_rgba[material[has_material], 3]
    return alpha


def _excluded(model: Any, settings: SceneSettings, notes: list[str]) -> list[str]:
    """The reason each geom is excluded, empty where it isn't."""
    body_reason = [""] * model.nbody
    used: set[str] = set()
    free = {
        int(model.jnt_bodyid[j])
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
    }
    for body in range(1, model.nbody):  # parents come before their children
        parent = int(model.body_parentid[body])
        name = model.body(body).name
        pattern = _first_match(settings.exclude.bodies, name)
        if pattern is not None:
            used.add(pattern)
            body_reason[body] = f"excluded: body matches {pattern!r}"
        elif body_reason[parent]:
            body_reason[body] = body_reason[parent]
        elif settings.exclude.movable and body in free:
            body_reason[body] = "excluded: movable (free joint)"
    reasons = []
    for geom in range(model.ngeom):
        pattern = _first_match(settings.exclude.geoms, model.geom(geom).name)
        if pattern is not None:
            used.add(pattern)
            reasons.append(f"excluded: geom matches {pattern!r}")
        else:
            reasons.append(body_reason[int(model.geom_bodyid[geom])])
    for pattern in [*settings.exclude.bodies, *settings.exclude.geoms]:
        if pattern not in used:
            notes.append(f"`scene.exclude` pattern {pattern!r} matches nothing")
    return reasons


def _first_match(patterns: list[str], name: str) -> str | None:
    return next((p for p in patterns if name and fnmatchcase(name, p)), None)


def _mesh_mode(settings: SceneSettings, names: tuple[str, ...]) -> str:
    modes = settings.meshes
    if isinstance(modes, str):
        return modes
    for pattern, mode in modes.items():
        if any(name and fnmatchcase(name, pattern) for name in names):
            return mode
    return "auto"


def _geom_names(model: Any, geom: int) -> tuple[str, str, str]:
    """Names of a geom, of its mesh and of its body; empty where there is none."""
    mesh = ""
    if model.geom_type[geom] in (MESH, SDF) and model.geom_dataid[geom] >= 0:
        mesh = model.mesh(int(model.geom_dataid[geom])).name
    return model.geom(geom).name, mesh, model.body(int(model.geom_bodyid[geom])).name


# ---------------------------------------------------------------- geometry


class _Collector:
    """Gathers the counted geoms' geometry, kind by kind."""

    def __init__(self, model: Any, data: Any) -> None:
        self.model, self.data = model, data
        self.solids: list[int] = []
        self.planes: list[int] = []
        self.corners: list[NDArray[np.float64]] = []
        self.corner_geoms: list[int] = []
        self.closed = np.zeros(model.ngeom, dtype=np.uint8)
        self._meshes: dict[tuple[int, str], tuple[NDArray[Any], bool]] = {}

    def add(self, geom: int, mesh_mode: str) -> str:
        """Take one geom in; returns as what."""
        kind = int(self.model.geom_type[geom])
        if kind == PLANE:
            return self._add_plane(geom)
        if kind == HFIELD:
            corners = self._hfield(int(self.model.geom_dataid[geom]))
            self._add_triangles(geom, corners, SOLID)
            return "solid"
        if kind in (MESH, SDF):
            mode = "surface" if kind == SDF and mesh_mode == "hull" else mesh_mode
            corners, closed = self._mesh(int(self.model.geom_dataid[geom]), mode)
            if mode == "hull":
                self._add_triangles(geom, corners, SOLID)
                return "hull"
            self._add_triangles(geom, corners, SURFACE if closed else 0)
            return "closed surface" if closed else "surface"
        self.solids.append(geom)
        self.closed[geom] = SOLID
        return "solid"

    def shapes(self) -> Shapes:
        model, data = self.model, self.data
        index = np.array(self.solids, dtype=np.int32)
        kind = model.geom_type[index].astype(np.int32)
        pos = data.geom_xpos[index].astype(np.float64)
        mat = data.geom_xmat[index].astype(np.float64)
        size = model.geom_size[index].astype(np.float64)
        plane = np.array(self.planes, dtype=np.int32)
        counts = [len(c) for c in self.corners]
        corners = np.concatenate(self.corners) if self.corners else np.zeros((0, 3, 3))
        return Shapes(
            solids=Solids(index, kind, pos, mat, size, solid_bounds(kind, pos, mat, size)),
            planes=Planes(
                plane,
                data.geom_xpos[plane].astype(np.float64),
                data.geom_xmat[plane].astype(np.float64),
            ),
            triangles=Triangles(
                np.repeat(np.array(self.corner_geoms, dtype=np.int32), counts),
                np.ascontiguousarray(corners, dtype=np.float64),
            ),
            closed=self.closed,
        )

    def _add_plane(self, geom: int) -> str:
        half = self.model.geom_size[geom, :2]
        if (half <= 0).all():
            self.planes.append(geom)
            return "half-space"
        x, y = np.where(half > 0, half, FAR)
        local = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        self._add_triangles(geom, local[[[0, 1, 2], [0, 2, 3]]], 0)
        return "rectangle"

    def _add_triangles(self, geom: int, corners: NDArray[Any], closed: int) -> None:
        mat = self.data.geom_xmat[geom].reshape(3, 3)
        world = corners.astype(np.float64) @ mat.T + self.data.geom_xpos[geom]
        self.corners.append(world)
        self.corner_geoms.append(geom)
        self.closed[geom] = closed

    def _mesh(self, mesh: int, mode: str) -> tuple[NDArray[Any], bool]:
        key = (mesh, mode)
        if key not in self._meshes:
            model = self.model
            first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            vertices = model.mesh_vert[first : first + count].astype(np.float64)
            if mode == "hull":
                self._meshes[key] = (hull_triangles(vertices, model.mesh(mesh).name), True)
            else:
                first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
                corners = vertices[model.mesh_face[first : first + count]]
                self._meshes[key] = (corners, is_closed_solid(corners))
        return self._meshes[key]

    def _hfield(self, hfield: int) -> NDArray[np.float64]:
        model = self.model
        rows, cols = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
        first = int(model.hfield_adr[hfield])
        heights = model.hfield_data[first : first + rows * cols].reshape(rows, cols)
        size = model.hfield_size[hfield].astype(np.float64)
        return height_field_triangles(heights.astype(np.float64), size)


def hull_triangles(vertices: NDArray[np.float64], name: str = "") -> NDArray[np.float64]:
    """The convex hull of points, as outward triangles.

    Args:
        vertices: shape (n, 3), float64 [m].
        name: whose hull it is, for the error.

    Returns:
        Corners, shape (m, 3, 3), float64, counter-clockwise from outside.

    Raises:
        SceneError: the points lie in a plane.
    """
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError) as error:
        raise SceneError(
            f"mesh {name!r} has no convex hull (its vertices lie in a plane): "
            f"set `scene.meshes` to surface for it"
        ) from error
    corners: NDArray[np.float64] = vertices[hull.simplices]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", cross, hull.equations[:, :3]) < 0
    corners[inward] = corners[inward][:, ::-1]
    return corners


def _collect_shapes(
    model: Any, data: Any, chosen: list[_Choice]
) -> tuple[Shapes, list[GeomReport]]:
    collector = _Collector(model, data)
    reports = []
    for geom, choice in enumerate(chosen):
        name, _, body = _geom_names(model, geom)
        reports.append(
            GeomReport(
                id=geom,
                name=name or f"geom {geom}",
                body=body or f"body {int(model.geom_bodyid[geom])}",
                type=GEOM_TYPES.get(int(model.geom_type[geom]), "unknown"),
                counted=choice.counted,
                shape=collector.add(geom, choice.mesh_mode) if choice.counted else "",
                reason=choice.reason,
            )
        )
    return collector.shapes(), reports


def _nothing_counts(settings: SceneSettings, reports: list[GeomReport]) -> str:
    if not reports:
        return f"{settings.path} has no geoms: nothing to bake"
    reasons = sorted({report.reason for report in reports})
    return (
        f"none of the {len(reports)} geoms of {settings.path} counts "
        f"(`scene.geoms` is {settings.geoms}): {'; '.join(reasons[:3])}"
    )


def _digest(model: Any, data: Any) -> str:
    """sha256 of what the bake can see of a posed model, wherever it was loaded from."""
    digest = hashlib.sha256()
    for geom in range(model.ngeom):
        digest.update("\0".join(_geom_names(model, geom)).encode() + b"\n")
    for array in _digest_arrays(model, data):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _digest_arrays(model: Any, data: Any) -> Iterator[NDArray[Any]]:
    yield model.geom_type
    yield model.geom_size
    yield model.geom_dataid
    yield model.geom_contype
    yield model.geom_conaffinity
    yield data.geom_xpos
    yield data.geom_xmat
    yield model.mesh_vert
    yield model.mesh_face
    yield model.hfield_data
    yield model.hfield_size

