"""Which geoms of a model count, by the settings, and why; and their geometry, gathered into shapes.

Does not import mujoco.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.core import constants
from navbake.baker.core.arrays import Planes, Solids
from navbake.baker.geometry.mesh_parts import split_mesh
from navbake.baker.geometry.shapes import (
    ENDLESS_HALF_SIZE,
    GeomTriangles,
    Shapes,
    gather_meshes,
    height_field_triangles,
    hull_faces,
    solid_bounds,
    tessellate,
)
from navbake.baker.readers.mesh import NamedMesh
from navbake.baker.scene.names import GeomNames, all_names, name_at, warn_unmatched
from navbake.config.settings import SceneSettings
from navbake.errors import SceneError
from navbake.types import Bool, Float, Int, Int32

LARGEST = 1e100  # of places and sizes, whose squares have to be numbers, too [m]
SOLIDS = range(constants.SPHERE, constants.BOX + 1)  # and capsule, ellipsoid, cylinder between
DRAWN_GROUPS = 3  # MuJoCo's viewers draw the geom groups below this unless told otherwise
TYPE_NAMES = dict(enumerate("plane hfield sphere capsule ellipsoid cylinder box mesh sdf".split()))  # noqa: SIM905


class GeomSelection(NamedTuple):
    """What becomes of one geom."""

    counted: bool  # whether it takes part in the bake
    reason: str
    mesh: str  # as what, if it is a mesh: hull, surface (or auto), or shell, which encloses nothing


def select_geoms(
    model: Any,
    settings: SceneSettings,
    hides_room: Callable[[int], bool],
    movable: Bool,
    ground: int | None = None,
    said: Mapping[int, str] | None = None,
) -> tuple[list[GeomSelection], list[str]]:
    """Decide for each geom whether it counts, and meshes as what.

    Excluded geoms never count. `collision` counts geoms that can collide (contype or conaffinity
    not 0). `auto` does the same, but counts all geoms if none of those left can collide. `visual`
    counts geoms that are drawn (alpha above 0, in a group that MuJoCo's viewers draw), but for
    those that can collide on a body, not the world, with drawn geoms of another group that can't.
    `scene.meshes: auto` takes a mesh that collides as its hull, as MuJoCo does, unless that hides
    room for an agent; or as `said`, by geom id, where the scene's file says it. `ground` always
    counts. Bodies that are marked as `movable`, shape (nbody,), are left out.

    Returns a choice for each geom, by its id, and what the user should know.
    """
    names = all_names(model).geoms
    excluded, notes = _find_excluded(model, settings, movable, names)
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    any_collides = any(can and not out for can, out in zip(collides, excluded, strict=True))
    counts = _rule(model, settings.geoms, collides, any_collides)
    rules = [(False, out) if out else rule for out, rule in zip(excluded, counts, strict=True)]
    if ground is not None:
        rules[ground] = (True, "added by `scene.ground`")
    by_pattern = settings.meshes
    if isinstance(by_pattern, str):
        modes: list[str] = [by_pattern] * len(names)
    else:
        pairs = by_pattern.items()
        modes = [next((mode for p, mode in pairs if _matches(p, name)), "auto") for name in names]
        of_meshes = np.flatnonzero(np.isin(model.geom_type, (constants.MESH, constants.SDF)))
        known = [text for geom in of_meshes for text in names[geom]]
        notes += _unused("scene.meshes", by_pattern, known, "no mesh")
    for geom, mode in (said or {}).items():
        modes[geom] = mode if modes[geom] == "auto" else modes[geom]
    opened = []
    # MuJoCo collides meshes by their hull, but not signed distance fields
    for geom in np.flatnonzero(collides & (model.geom_type == constants.MESH)).tolist():
        if modes[geom] == "auto" and rules[geom][0]:
            modes[geom] = "surface" if hides_room(geom) else "hull"
            opened += [names[geom].geom] if modes[geom] == "surface" else []
    selections = [GeomSelection(*rule, mode) for rule, mode in zip(rules, modes, strict=True)]
    if opened:
        more = f", and {len(opened) - 1} more" if opened[1:] else ""
        because = "because its convex hull hides room to stand in; MuJoCo collides the hull"
        which = "set `scene.meshes` to surface or hull to say which"
        notes.append(f"mesh geom {opened[0]!r}{more} counts by its triangles, {because}: {which}")
    return selections, notes


def _rule(model: Any, geoms: str, collides: Bool, any_collides: bool) -> list[tuple[bool, str]]:
    """For each geom, whether it counts by `scene.geoms`, and why."""
    if geoms == "all":
        return [(True, "all geoms count")] * model.ngeom
    if geoms == "auto" and not any_collides:
        return [(True, "no geom can collide, so all count")] * model.ngeom
    if geoms != "visual":
        no = (False, "can't collide (contype and conaffinity are 0)")
        yes = (True, "can collide")
        return [yes if can else no for can in collides]
    # a geom's opacity is its material's, unless its own colour was set (as MuJoCo draws it)
    alpha: Float = model.geom_rgba[:, 3].astype(np.float64)
    is_default = (model.geom_rgba == np.array([0.5, 0.5, 0.5, 1.0], np.float32)).all(axis=1)
    by_material = (model.geom_matid >= 0) & is_default
    alpha[by_material] = model.mat_rgba[model.geom_matid[by_material], 3]
    groups = model.geom_group.tolist()
    bodies = model.geom_bodyid.tolist()
    drawn = (alpha > 0) & (model.geom_group < DRAWN_GROUPS)
    visuals: dict[int, set[int]] = {}
    for visual in np.flatnonzero(drawn & ~collides & (model.geom_bodyid > 0)).tolist():
        visuals.setdefault(bodies[visual], set()).add(groups[visual])
    rule = []
    for geom, (group, body) in enumerate(zip(groups, bodies, strict=True)):
        if group >= DRAWN_GROUPS:
            rule.append((False, f"not drawn (group {group})"))
        elif not drawn[geom]:
            rule.append((False, "not drawn (alpha 0)"))
        elif collides[geom] and visuals.get(body, set()) - {group}:
            rule.append((False, "stands in for its body's visual geoms"))
        else:
            rule.append((True, "is drawn"))
    return rule


def _find_excluded(
    model: Any, settings: SceneSettings, movable: Bool, names: list[GeomNames]
) -> tuple[list[str], list[str]]:
    """Why each geom is excluded, with its body or one above, or empty; and unmatched patterns."""
    exclude = settings.exclude
    parents = model.body_parentid.tolist()
    of_bodies = [""] * model.nbody
    bodies = all_names(model).bodies
    for body in range(1, model.nbody):  # parents come before their children
        pattern = _first_match(exclude.bodies, bodies[body])
        if pattern:
            of_bodies[body] = f"excluded: body {bodies[body]!r} matches {pattern!r}"
        elif of_bodies[parents[body]]:
            of_bodies[body] = of_bodies[parents[body]]
        elif movable[body]:
            of_bodies[body] = f"excluded: body {bodies[body]!r} can move"
    reasons = [of_bodies[body] for body in model.geom_bodyid.tolist()]
    for geom, name in enumerate(names) if exclude.geoms else ():
        pattern = _first_match(exclude.geoms, name.geom)
        reasons[geom] = f"excluded: matches {pattern!r}" if pattern else reasons[geom]
    notes = _unused("scene.exclude.bodies", exclude.bodies, bodies[1:])
    return reasons, notes + _unused("scene.exclude.geoms", exclude.geoms, [n.geom for n in names])


def _matches(pattern: str, names: Iterable[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names if name)


def _first_match(patterns: Iterable[str], name: str) -> str | None:
    return next((pattern for pattern in patterns if fnmatchcase(name, pattern)), None)


def _unused(
    setting: str, patterns: Iterable[str], names: list[str], found: str = "nothing"
) -> list[str]:
    unmatched = [pattern for pattern in patterns if not _matches(pattern, names)]
    return [warn_unmatched(setting, pattern, names, found) for pattern in unmatched]


# ---------------------------------------------------------------- geometry


def _one_part(vertices: Float, faces: Int32 | None, closed: int, kind: str) -> GeomTriangles:
    """Triangles that are all of one part, by corners of shape (m, 3, 3) if there are no faces."""
    if faces is None:
        vertices = vertices.reshape(-1, 3)
        faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    num = len(faces)
    part = np.zeros(num, np.int32)
    codes = np.full(num, closed, np.uint8)
    return GeomTriangles(vertices, faces, part, codes, kind)


class MeshTriangles:
    """The triangles of a model's meshes by mode, each found once."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._found: dict[tuple[int, str], GeomTriangles] = {}

    def count(self, mesh: int, mode: str) -> GeomTriangles:
        """Count a mesh as a mode says, in its own frame; see `count_mesh`."""
        if (mesh, mode) not in self._found:
            vertices, faces, hull = _mesh_arrays(self._model, mesh)
            self._found[mesh, mode] = count_mesh(vertices, faces, mode, hull)
        return self._found[mesh, mode]


def count_mesh(
    vertices: Float, faces: Int | Int32, mode: str, hull: Int32 | None = None
) -> GeomTriangles:
    """Count a mesh as its hull (found if None), as a shell, or as its triangles if it is flat."""
    if mode == "hull":
        hull = hull_faces(vertices) if hull is None else hull
        if hull is not None:
            # vertices inside of the hull are no part of it
            used, index = np.unique(hull, return_inverse=True)
            faces = index.reshape(hull.shape).astype(np.int32)
            return _one_part(vertices[used], faces, constants.CONVEX_SOLID, "hull")
    faces = faces.astype(np.int32, copy=False)
    if mode == "shell":
        return _one_part(vertices, faces, constants.OPEN_SURFACE, "shell")
    split = split_mesh(vertices, faces)
    return GeomTriangles(vertices, split.faces, split.part, split.closed, split.kind)


def collect_shapes(
    model: Any,
    data: Any,
    selections: Sequence[GeomSelection] | Mapping[int, GeomSelection],
    exact_meshes: Mapping[int, NamedMesh],
    only: Iterable[int] | None = None,
    meshes: MeshTriangles | None = None,
) -> tuple[Shapes, dict[int, str], list[str]]:
    """Gather the geometry of the geoms that count, of all or of some ids, ascending.

    `exact_meshes` are exact meshes by geom id, world frame, in place of the model's. Returns also
    the `GeomReport.shape` of each, and notes for the user.
    """
    meshes = MeshTriangles(model) if meshes is None else meshes
    names = all_names(model).geoms
    kinds = dict[int, str]()
    notes = dict[str, str]()
    solids = list[int]()
    planes = list[int]()
    triangles = dict[int, GeomTriangles]()
    endless = np.zeros(model.ngeom, dtype=np.bool_)
    every = range(len(selections)) if only is None else only
    ids = np.array([geom for geom in every if selections[geom].counted], dtype=np.int64)
    numbers = np.hstack([data.geom_xpos[ids], data.geom_xmat[ids], model.geom_size[ids]])
    # lists, which are read geom by geom in less time than arrays
    is_placed = (np.abs(numbers) <= LARGEST).all(axis=1)  # NaN isn't
    columns = ids, model.geom_type[ids], model.geom_dataid[ids], is_placed
    for geom, kind, shape, placed in zip(*(array.tolist() for array in columns), strict=True):
        name, mesh, _ = names[geom]
        mode = ""
        if not placed:
            what = f"a pose or size that is no number, or beyond {LARGEST:g} m"
            raise SceneError(f"geom {name!r} has {what}")
        if kind in SOLIDS:
            solids.append(geom)
            kinds[geom] = "solid"
            continue
        if kind == constants.PLANE:
            half = model.geom_size[geom, :2]
            if (half <= 0).all():
                planes.append(geom)
                kinds[geom] = "half-space"
                continue
            endless[geom] = (half <= 0).any()
            what = "strip" if endless[geom] else "rectangle"
            sides = tessellate("plane", np.where(half > 0, half, ENDLESS_HALF_SIZE).tolist())
            found = _one_part(*sides, constants.OPEN_SURFACE, what)
        elif kind not in (constants.HFIELD, constants.MESH, constants.SDF) or shape < 0:
            raise SceneError(f"geom {name!r} is broken: it has no shape (type {kind})")
        elif kind == constants.HFIELD:
            found = _one_part(_height_field(model, shape), None, constants.SOLID, "solid")
        else:
            mode = selections[geom].mesh
            exact = exact_meshes.get(geom)
            counted = exact and count_mesh(exact.vertices, exact.faces, mode)
            found = counted or meshes.count(shape, mode)
            if mode == "hull" and found.kind != "hull":
                flat = f"mesh {mesh!r} of geom {name!r} is flat, so it has no convex hull"
                notes.setdefault(mesh, f"{flat}: it counts by its triangles")
        kinds[geom] = found.kind
        if geom not in exact_meshes:
            vertices = found.vertices @ data.geom_xmat[geom].reshape(3, 3).T
            vertices += data.geom_xpos[geom]
            found = found._replace(vertices=vertices)
        triangles[geom] = found
    index = np.array(solids, dtype=np.int32)
    plane = np.array(planes, dtype=np.int32)
    of_solids = model.geom_type[index], data.geom_xpos[index], data.geom_xmat[index]
    own = *of_solids, model.geom_size[index]
    gathered = Shapes(
        solids=Solids(index, *own, solid_bounds(*own)),
        planes=Planes(plane, data.geom_xpos[plane], data.geom_xmat[plane]),
        meshes=gather_meshes(triangles),
        endless=endless,
    )
    return gathered, kinds, list(notes.values())


def _height_field(model: Any, hfield: int) -> Float:
    shape = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
    first = int(model.hfield_adr[hfield])
    size = model.hfield_size[hfield]
    heights = model.hfield_data[first : first + shape[0] * shape[1]].reshape(shape)
    if not (np.isfinite(heights).all() and (np.abs(size) <= LARGEST).all()):
        name = name_at(model, model.name_hfieldadr[hfield])
        what = f"heights or a size that are no numbers, or beyond {LARGEST:g} m"
        raise SceneError(f"hfield {name!r} has {what}")
    return height_field_triangles(heights.astype(np.float64), size)


def _mesh_arrays(model: Any, mesh: int) -> tuple[Float, Int32, Int32 | None]:
    """A mesh's vertices, its faces, and its hull's faces if MuJoCo has one; its geom's frame."""
    first = int(model.mesh_vertadr[mesh])
    count = int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    first = int(model.mesh_faceadr[mesh])
    count = int(model.mesh_facenum[mesh])
    faces = model.mesh_face[first : first + count]
    hull = np.empty((0, 3), dtype=np.int32)
    name = name_at(model, model.name_meshadr[mesh])
    address = int(model.mesh_graphadr[mesh])
    if address >= 0:  # of MuJoCo's `mesh_graph`: v, m, two lists of v, v + 3 m numbers, the faces
        num_vertices, num_faces = (int(n) for n in model.mesh_graph[address : address + 2])
        first = address + 2 + 3 * (num_vertices + num_faces)
        corners = np.asarray(model.mesh_graph[first : first + 3 * num_faces])
        if len(corners) != 3 * num_faces:
            raise SceneError(f"mesh {name!r} is broken: its hull's faces are missing")
        hull = corners.reshape(-1, 3)
    for index in (faces, hull):
        if index.size and not 0 <= int(index.min()) <= int(index.max()) < len(vertices):
            raise SceneError(f"mesh {name!r} is broken: faces of missing vertices")
    if not np.isfinite(vertices).all():
        raise SceneError(f"mesh {name!r} has coordinates that are no numbers")
    return vertices, faces, hull if len(hull) else None
