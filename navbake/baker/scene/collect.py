"""Selects the geoms of a model that count, and collects their geometry as shapes.

Does not import mujoco.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navbake.baker.core import constants
from navbake.baker.core.arrays import Planes, Solids
from navbake.baker.geometry.mesh_parts import split_mesh
from navbake.baker.geometry.shapes import (
    ENDLESS_HALF_SIZE,
    GeomTriangles,
    Shapes,
    gather_meshes,
    hull_faces,
    make_height_field_pieces,
    solid_bounds,
    tessellate,
)
from navbake.baker.readers.mesh import NamedMesh
from navbake.baker.scene.names import GeomNames, all_names, name_at, warn_unmatched
from navbake.baker.scene.skies import SOLID_TYPES
from navbake.config.settings import SceneSettings
from navbake.errors import SceneError
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:
    import mujoco

MAX_LENGTH = 1e100  # largest position or size: its square has to be finite, too [m]
NUM_DRAWN_GROUPS = 3  # MuJoCo's viewers draw the geom groups below this unless told otherwise
TYPE_NAMES = dict(
    enumerate(
        ["plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf"]
    )
)
# Why a geom doesn't count
CANT_COLLIDE_REASON = "can't collide (contype and conaffinity are 0)"
COLLIDES_IN_PAIRS_REASON = "collides in a <contact><pair> alone (contype and conaffinity are 0)"
# MuJoCo's default of `rgba`
DEFAULT_COLOR = np.array([0.5, 0.5, 0.5, 1.0], np.float32)


class GeomSelection(NamedTuple):
    """Whether a geom counts, and how it is represented.

    Attributes:
        is_counted: whether the geom takes part in the bake.
        reason: why it does or does not.
        mesh_mode: how a mesh is represented: ``hull`` for its convex hull; ``surface`` or ``auto``
            for its triangles; ``shell`` for its triangles, as sheets that enclose nothing.
    """

    is_counted: bool
    reason: str
    mesh_mode: str


class CountDecision(NamedTuple):
    """Whether a geom counts, and why.

    Attributes:
        is_counted: whether the geom takes part in the bake.
        reason: why it does or does not.
    """

    is_counted: bool
    reason: str


# ---------------------------------------------------------------- which geoms count


def select_geoms(
    model: mujoco.MjModel,
    settings: SceneSettings,
    find_hidden: Callable[[int], str],
    is_left_out_body: Bool,
    ground_geom: int | None = None,
    file_mesh_modes: Mapping[int, str] | None = None,
) -> tuple[list[GeomSelection], list[str]]:
    """Decide for each geom whether it counts, and for meshes, how they are represented.

    Excluded geoms never count, and the geom that `scene.ground` adds always counts. `scene.geoms`:

    - ``collision`` counts geoms that can collide (contype or conaffinity is not 0).
    - ``auto`` does the same; but if all geoms that can collide are excluded, all geoms count.
    - ``visual`` counts geoms that are drawn (alpha above 0, in a group that MuJoCo's viewers draw).
      But a geom that can collide is left out if its body has visuals: drawn geoms of another group
      that can't collide. (The world body's geoms are never left out for this reason.)
    - ``all`` counts all geoms.

    With `scene.meshes: auto`, a mesh that can collide is represented by its hull, as in MuJoCo,
    unless the hull hides room for an agent, or ground. If the scene's file says how a mesh
    collides, ``auto`` follows the file.

    Args:
        model: the model.
        settings: `scene.geoms`, `scene.meshes` and `scene.exclude` are used.
        find_hidden: a function: id of a mesh geom -> what its hull hides, such as ``room to stand
            in``; an empty text if it hides nothing.
        is_left_out_body: for each body, whether it is left out because it can move, (nbody,).
        ground_geom: id of the geom that `scene.ground` adds; None if there is none.
        file_mesh_modes: geom id -> the mesh mode that the scene's file states.

    Returns:
        A selection for each geom, in the order of ids; and warnings.
    """
    names = all_names(model).geoms
    exclusions, warnings = _find_exclusions(model, settings, is_left_out_body, names)
    can_collide = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    any_can_collide = any(
        geom_can_collide and not exclusion
        for geom_can_collide, exclusion in zip(can_collide, exclusions, strict=True)
    )
    decisions = _apply_geoms_setting(model, settings.geoms, can_collide, any_can_collide)
    for geom, exclusion in enumerate(exclusions):
        if exclusion:
            decisions[geom] = CountDecision(False, exclusion)
    if ground_geom is not None:
        decisions[ground_geom] = CountDecision(True, "added by `scene.ground`")
    mesh_modes, mode_warnings = _find_mesh_modes(model, settings, names)
    warnings += mode_warnings
    for geom, mesh_mode in (file_mesh_modes or {}).items():
        if mesh_modes[geom] == "auto":
            mesh_modes[geom] = mesh_mode
    surface_names = list[str]()  # of meshes whose hull hides something
    first_hidden_text = ""
    # In MuJoCo, the hull of a mesh collides, but not that of a signed distance field.
    for geom in np.flatnonzero(can_collide & (model.geom_type == constants.MESH)).tolist():
        if mesh_modes[geom] == "auto" and decisions[geom].is_counted:
            hidden_text = find_hidden(geom)
            if hidden_text:
                mesh_modes[geom] = "surface"
                surface_names.append(_describe_mesh_geom(geom, names[geom]))
                first_hidden_text = first_hidden_text or hidden_text
            else:
                mesh_modes[geom] = "hull"
    if surface_names:
        num_more_text = f", and {len(surface_names) - 1} more" if len(surface_names) > 1 else ""
        warnings.append(
            f"mesh geom {surface_names[0]}{num_more_text} counts by its triangles, because its "
            f"convex hull hides {first_hidden_text}; MuJoCo collides the hull: set `scene.meshes` "
            "to surface or hull to say which"
        )
    selections = [
        GeomSelection(decision.is_counted, decision.reason, mesh_mode)
        for decision, mesh_mode in zip(decisions, mesh_modes, strict=True)
    ]
    return selections, warnings


def _describe_mesh_geom(geom: int, names: GeomNames) -> str:
    """Return the name of a geom with a mesh; of one without a name, those of its mesh and body."""
    if names.geom != f"geom {geom}":
        return repr(names.geom)
    return f"{names.geom!r} (mesh {names.mesh!r} of body {names.body!r})"


def _find_mesh_modes(
    model: mujoco.MjModel, settings: SceneSettings, names: list[GeomNames]
) -> tuple[list[str], list[str]]:
    """Return the mode that `scene.meshes` states for each geom, and warnings of unused patterns."""
    if isinstance(settings.meshes, str):
        mode_of_all: str = settings.meshes
        return [mode_of_all] * len(names), []
    mode_of_pattern = settings.meshes
    mesh_modes: list[str] = []
    for geom_names in names:
        matching_modes = [
            mesh_mode
            for pattern, mesh_mode in mode_of_pattern.items()
            if _matches_any(pattern, geom_names)
        ]
        mesh_modes.append(matching_modes[0] if matching_modes else "auto")
    mesh_geoms = np.flatnonzero(np.isin(model.geom_type, (constants.MESH, constants.SDF)))
    mesh_names = [name for geom in mesh_geoms for name in names[geom]]
    return mesh_modes, _warn_unused_patterns("scene.meshes", mode_of_pattern, mesh_names, "no mesh")


def _apply_geoms_setting(
    model: mujoco.MjModel, geoms_setting: str, can_collide: Bool, any_can_collide: bool
) -> list[CountDecision]:
    """Decide for each geom whether `scene.geoms` counts it.

    Args:
        model: the model.
        geoms_setting: the value of `scene.geoms`.
        can_collide: for each geom, whether it can collide, shape (ngeom,).
        any_can_collide: whether any geom that isn't excluded can collide.
    """
    if geoms_setting == "all":
        return [CountDecision(True, "all geoms count")] * model.ngeom
    if geoms_setting == "auto" and not any_can_collide:
        return [CountDecision(True, "no geom can collide, so all count")] * model.ngeom
    if geoms_setting != "visual":
        colliding_decision = CountDecision(True, "can collide")
        other_decision = CountDecision(False, CANT_COLLIDE_REASON)
        decisions = [
            colliding_decision if geom_can_collide else other_decision
            for geom_can_collide in can_collide
        ]
        pair_geoms = np.concatenate([model.pair_geom1, model.pair_geom2])
        for geom in np.unique(pair_geoms[~can_collide[pair_geoms]]).tolist():
            decisions[geom] = CountDecision(False, COLLIDES_IN_PAIRS_REASON)
        return decisions
    groups = model.geom_group.tolist()
    bodies = model.geom_bodyid.tolist()
    is_drawn = mark_drawn(model)
    visual_groups: dict[int, set[int]] = {}  # body -> groups of its drawn geoms that can't collide
    for visual_geom in np.flatnonzero(is_drawn & ~can_collide & (model.geom_bodyid > 0)).tolist():
        visual_groups.setdefault(bodies[visual_geom], set()).add(groups[visual_geom])
    decisions = []
    for geom, (group, body) in enumerate(zip(groups, bodies, strict=True)):
        if group >= NUM_DRAWN_GROUPS:
            decisions.append(CountDecision(False, f"not drawn (group {group})"))
        elif not is_drawn[geom]:
            decisions.append(CountDecision(False, "not drawn (alpha 0)"))
        elif can_collide[geom] and visual_groups.get(body, set()) - {group}:
            decisions.append(CountDecision(False, "stands in for its body's visual geoms"))
        else:
            decisions.append(CountDecision(True, "is drawn"))
    return decisions


def mark_drawn(model: mujoco.MjModel) -> Bool:
    """Mark the geoms that MuJoCo's viewers draw: not fully transparent, in a group that is drawn.

    A geom's opacity is its material's, unless its own colour was set.

    Args:
        model: the model.

    Returns:
        A mask, shape (ngeom,).
    """
    alpha: Float = model.geom_rgba[:, 3].astype(np.float64)
    is_default = (model.geom_rgba == DEFAULT_COLOR).all(axis=1)
    has_material_color = (model.geom_matid >= 0) & is_default
    alpha[has_material_color] = model.mat_rgba[model.geom_matid[has_material_color], 3]
    is_drawn: Bool = (alpha > 0) & (model.geom_group < NUM_DRAWN_GROUPS)
    return is_drawn


def _find_exclusions(
    model: mujoco.MjModel, settings: SceneSettings, is_left_out_body: Bool, names: list[GeomNames]
) -> tuple[list[str], list[str]]:
    """Find for each geom why it is excluded, and warn of patterns that match nothing.

    A geom is excluded if a pattern matches its name, or the name of its body or of an ancestor of
    its body; or if such a body is in `is_left_out_body`.

    Returns:
        A reason for each geom, empty if it isn't excluded; and warnings.
    """
    exclusions = settings.exclude
    parents = model.body_parentid.tolist()
    body_reasons = [""] * model.nbody
    body_names = all_names(model).bodies
    for body in range(1, model.nbody):  # parents come before their children
        pattern = _first_match(exclusions.bodies, body_names[body])
        if pattern:
            body_reasons[body] = f"excluded: body {body_names[body]!r} matches {pattern!r}"
        elif body_reasons[parents[body]]:
            body_reasons[body] = body_reasons[parents[body]]
        elif is_left_out_body[body]:
            body_reasons[body] = f"excluded: body {body_names[body]!r} can move"
    reasons = [body_reasons[body] for body in model.geom_bodyid.tolist()]
    geom_names = [geom.geom for geom in names]
    if exclusions.geoms:
        for geom, name in enumerate(geom_names):
            pattern = _first_match(exclusions.geoms, name)
            if pattern:
                reasons[geom] = f"excluded: matches {pattern!r}"
    warnings = [
        *_warn_unused_patterns("scene.exclude.bodies", exclusions.bodies, body_names[1:]),
        *_warn_unused_patterns("scene.exclude.geoms", exclusions.geoms, geom_names),
    ]
    return reasons, warnings


def _matches_any(pattern: str, names: Iterable[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names if name)


def _first_match(patterns: Iterable[str], name: str) -> str | None:
    return next((pattern for pattern in patterns if fnmatchcase(name, pattern)), None)


def _warn_unused_patterns(
    setting: str, patterns: Iterable[str], names: list[str], matches_text: str = "nothing"
) -> list[str]:
    unmatched_patterns = [pattern for pattern in patterns if not _matches_any(pattern, names)]
    return [warn_unmatched(setting, pattern, names, matches_text) for pattern in unmatched_patterns]


# ---------------------------------------------------------------- geometry


def _make_single_part(
    vertices: Float, faces: Int32, closed_code: int, shape_kind: str
) -> GeomTriangles:
    """Make `GeomTriangles` of one part; all its triangles have the same code of what they enclose.

    Args:
        vertices: shape (n, 3) [m].
        faces: indices of vertices, shape (m, 3).
        closed_code: OPEN_SURFACE, SOLID or CONVEX_SOLID, for all triangles.
        shape_kind: the value of `GeomReport.shape`, such as ``hull``.
    """
    num_faces = len(faces)
    part_of_face = np.zeros(num_faces, np.int32)
    closed_codes = np.full(num_faces, closed_code, np.uint8)
    return GeomTriangles(vertices, faces, part_of_face, closed_codes, shape_kind)


class MeshTriangles:
    """A cache of the triangles that represent a model's meshes, by mesh and by mesh mode.

    Args:
        model: the model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._triangles: dict[tuple[int, str], GeomTriangles] = {}

    def get(self, mesh: int, mesh_mode: str) -> GeomTriangles:
        """Return the triangles that represent a mesh, in the mesh's frame.

        Args:
            mesh: the mesh's id.
            mesh_mode: how the mesh is represented: ``hull``, ``shell``, ``surface`` or ``auto``,
                see `represent_mesh`.

        Raises:
            SceneError: the mesh is broken.
        """
        if (mesh, mesh_mode) not in self._triangles:
            vertices, faces, hull = _mesh_arrays(self._model, mesh)
            self._triangles[mesh, mesh_mode] = represent_mesh(vertices, faces, mesh_mode, hull)
        return self._triangles[mesh, mesh_mode]


def represent_mesh(
    vertices: Float, faces: Int | Int32, mesh_mode: str, hull: Int32 | None = None
) -> GeomTriangles:
    """Return the triangles that represent a mesh.

    Args:
        vertices: shape (n, 3) [m].
        faces: indices of vertices, counter-clockwise from outside, shape (m, 3).
        mesh_mode: ``hull`` for the convex hull, or for the mesh's own triangles if it is flat;
            ``shell`` for its own triangles, as sheets that enclose nothing; ``surface`` or ``auto``
            for its own triangles, where each closed part is a solid.
        hull: the faces of the convex hull; computed if None.

    Returns:
        The triangles, in the mesh's frame.
    """
    if mesh_mode == "hull":
        hull = hull_faces(vertices) if hull is None else hull
        if hull is not None:
            # Vertices inside the hull are left out.
            used_vertices, vertex_index = np.unique(hull, return_inverse=True)
            faces = vertex_index.reshape(hull.shape).astype(np.int32)
            return _make_single_part(vertices[used_vertices], faces, constants.CONVEX_SOLID, "hull")
    faces = faces.astype(np.int32, copy=False)
    if mesh_mode == "shell":
        return _make_single_part(vertices, faces, constants.OPEN_SURFACE, "shell")
    split_triangles = split_mesh(vertices, faces)
    return GeomTriangles(
        vertices,
        split_triangles.faces,
        split_triangles.part,
        split_triangles.closed,
        split_triangles.description,
    )


def collect_shapes(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    selections: Sequence[GeomSelection] | Mapping[int, GeomSelection],
    exact_meshes: Mapping[int, NamedMesh],
    geom_ids: Iterable[int] | None = None,
    meshes: MeshTriangles | None = None,
) -> tuple[Shapes, dict[int, str], list[str]]:
    """Collect the geometry of the geoms that count, in the world frame.

    Args:
        model: the model.
        data: the model's pose.
        selections: geom id -> whether the geom counts, and how it is represented.
        exact_meshes: geom id -> mesh in the world frame, to use in place of the model's.
        geom_ids: ids of the geoms to collect, ascending; None for all.
        meshes: a cache of the triangles of the model's meshes; None for a new one.

    Returns:
        The shapes; geom id -> how the geom is represented, in the words of `GeomReport.shape`; and
        warnings.

    Raises:
        SceneError: a geom is broken, or its pose or size is not finite.
    """
    meshes = MeshTriangles(model) if meshes is None else meshes
    names = all_names(model).geoms
    shape_kinds = dict[int, str]()
    warnings = dict[str, str]()  # mesh name -> warning
    solid_ids = list[int]()
    plane_geoms = list[int]()
    triangles = list[tuple[int, GeomTriangles]]()
    is_endless = np.zeros(model.ngeom, dtype=np.bool_)
    geoms = range(len(selections)) if geom_ids is None else geom_ids
    counted_ids = np.array([geom for geom in geoms if selections[geom].is_counted], dtype=np.int64)
    pose_numbers = np.hstack(
        [data.geom_xpos[counted_ids], data.geom_xmat[counted_ids], model.geom_size[counted_ids]]
    )
    is_finite = (np.abs(pose_numbers) <= MAX_LENGTH).all(axis=1)  # NaN isn't
    # Iterating over lists is faster than over arrays.
    geom_rows = zip(
        counted_ids.tolist(),
        model.geom_type[counted_ids].tolist(),
        model.geom_dataid[counted_ids].tolist(),
        is_finite.tolist(),
        strict=True,
    )
    for geom, geom_type, data_id, has_finite_numbers in geom_rows:
        name = names[geom].geom
        if not has_finite_numbers:
            problem_text = f"a pose or size that is no number, or beyond {MAX_LENGTH:g} m"
            raise SceneError(f"geom {name!r} has {problem_text}")
        if geom_type in SOLID_TYPES:
            solid_ids.append(geom)
            shape_kinds[geom] = "solid"
            continue
        if geom_type == constants.PLANE:
            half_sides = model.geom_size[geom, :2]
            is_endless_side = half_sides <= 0  # as MuJoCo means a size of 0
            if _is_ground_plane(model, data, geom) or is_endless_side.all():
                plane_geoms.append(geom)
                shape_kinds[geom] = "half-space"
                continue
            is_endless[geom] = is_endless_side.any()
            geom_triangles = _plane_triangles(half_sides, is_strip=bool(is_endless[geom]))
        elif geom_type not in (constants.HFIELD, constants.MESH, constants.SDF) or data_id < 0:
            raise SceneError(f"geom {name!r} is broken: it has no shape (type {geom_type})")
        elif geom_type == constants.HFIELD:
            shape_kinds[geom] = "solid"
            pieces = _height_field_pieces(model, data_id)
            triangles += [(geom, _to_world(piece, data, geom)) for piece in pieces]
            continue
        else:
            mesh_mode = selections[geom].mesh_mode
            if geom in exact_meshes:
                exact_mesh = exact_meshes[geom]
                geom_triangles = represent_mesh(exact_mesh.vertices, exact_mesh.faces, mesh_mode)
            else:
                geom_triangles = meshes.get(data_id, mesh_mode)
            if mesh_mode == "hull" and geom_triangles.description != "hull":
                mesh_name = names[geom].mesh
                reason = f"mesh {mesh_name!r} of geom {name!r} is flat, so it has no convex hull"
                warnings.setdefault(mesh_name, f"{reason}: it counts by its triangles")
        shape_kinds[geom] = geom_triangles.description
        if geom not in exact_meshes:
            geom_triangles = _to_world(geom_triangles, data, geom)
        triangles.append((geom, geom_triangles))
    plane_ids = np.array(plane_geoms, dtype=np.int32)
    shapes = Shapes(
        solids=_collect_solids(model, data, np.array(solid_ids, dtype=np.int32)),
        planes=Planes(plane_ids, data.geom_xpos[plane_ids], data.geom_xmat[plane_ids]),
        meshes=gather_meshes(triangles),
        is_endless=is_endless,
    )
    return shapes, shape_kinds, list(warnings.values())


def _is_ground_plane(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> bool:
    """Return whether a plane is endless ground: it stands, can collide, and faces up within 45°.

    MuJoCo collides a plane as endless, whatever its size: the size is only drawn. But a plane that
    faces to the side or down is taken for a wall or a ceiling as large as it is drawn. If it were
    endless, it would fill all that is behind it.
    """
    body = model.geom_bodyid[geom]
    is_static = model.body_weldid[body] == 0 and model.body_mocapid[body] < 0
    can_collide = model.geom_contype[geom] != 0 or model.geom_conaffinity[geom] != 0
    is_facing_up = data.geom_xmat[geom, 8] >= np.sqrt(0.5)
    return bool(is_static and can_collide and is_facing_up)


def drawn_box_of_planes(
    model: mujoco.MjModel, data: mujoco.MjData, plane_ids: Iterable[int]
) -> Float | None:
    """Return the box round the rectangles that MuJoCo's viewer draws for planes.

    Args:
        model: the model.
        data: the model's pose.
        plane_ids: geom ids of the planes.

    Returns:
        The lowest and the highest corner, shape (2, 3), world frame [m]; None if all planes are
        endless along at least one side. Such planes are left out of the box.
    """
    corners = list[Float]()
    for geom in plane_ids:
        half_sides = model.geom_size[geom, :2]
        if (half_sides > 0).all():
            rotation = data.geom_xmat[geom].reshape(3, 3)
            rectangle_corners = tessellate("plane", half_sides.tolist()).vertices
            corners.append(rectangle_corners @ rotation.T + data.geom_xpos[geom])
    if not corners:
        return None
    all_corners = np.concatenate(corners)
    return np.stack([all_corners.min(axis=0), all_corners.max(axis=0)])


def _collect_solids(model: mujoco.MjModel, data: mujoco.MjData, geom_ids: Int32) -> Solids:
    types = model.geom_type[geom_ids]
    positions = data.geom_xpos[geom_ids]
    rotations = data.geom_xmat[geom_ids]
    sizes = model.geom_size[geom_ids]
    bounds = solid_bounds(types, positions, rotations, sizes)
    return Solids(geom_ids, types, positions, rotations, sizes, bounds)


def _plane_triangles(half_sides: Float, *, is_strip: bool) -> GeomTriangles:
    """Make the triangles of a rectangular plane, or of a strip, which is endless along x or y."""
    finite_half_sides = np.where(half_sides > 0, half_sides, ENDLESS_HALF_SIZE)
    mesh = tessellate("plane", finite_half_sides.tolist())
    shape_kind = "strip" if is_strip else "rectangle"
    return _make_single_part(mesh.vertices, mesh.faces, constants.OPEN_SURFACE, shape_kind)


def _to_world(triangles: GeomTriangles, data: mujoco.MjData, geom: int) -> GeomTriangles:
    """Transform triangles from a geom's frame into the world frame."""
    vertices = triangles.vertices @ data.geom_xmat[geom].reshape(3, 3).T
    vertices += data.geom_xpos[geom]
    return triangles._replace(vertices=vertices)


def _height_field_pieces(model: mujoco.MjModel, hfield: int) -> Iterator[GeomTriangles]:
    """Make the triangles of a height field as a solid, in its geom's frame, piece by piece."""
    num_rows = int(model.hfield_nrow[hfield])
    num_cols = int(model.hfield_ncol[hfield])
    first_height = int(model.hfield_adr[hfield])
    hfield_size = model.hfield_size[hfield]
    heights = model.hfield_data[first_height : first_height + num_rows * num_cols].reshape(
        num_rows, num_cols
    )
    if not (np.isfinite(heights).all() and (np.abs(hfield_size) <= MAX_LENGTH).all()):
        name = name_at(model, model.name_hfieldadr[hfield])
        problem_text = f"heights or a size that are no numbers, or beyond {MAX_LENGTH:g} m"
        raise SceneError(f"hfield {name!r} has {problem_text}")
    triangles_of_faces = dict[int, GeomTriangles]()  # by the id of the faces, which pieces share
    for vertices, faces in make_height_field_pieces(heights, hfield_size):
        if id(faces) not in triangles_of_faces:
            triangles_of_faces[id(faces)] = _make_single_part(
                vertices, faces, constants.SOLID, "solid"
            )
        yield triangles_of_faces[id(faces)]._replace(vertices=vertices)


def _mesh_arrays(model: mujoco.MjModel, mesh: int) -> tuple[Float, Int32, Int32 | None]:
    """Return the vertices and faces of a mesh, in its geom's frame, and the faces of its hull.

    The hull is None if the model doesn't have it.
    """
    first_vertex = int(model.mesh_vertadr[mesh])
    num_vertices = int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first_vertex : first_vertex + num_vertices].astype(np.float64)
    first_face = int(model.mesh_faceadr[mesh])
    num_faces = int(model.mesh_facenum[mesh])
    faces = model.mesh_face[first_face : first_face + num_faces]
    name = name_at(model, model.name_meshadr[mesh])
    hull = _read_hull_faces(model, mesh, name)
    for vertex_indices in (faces, hull):
        if vertex_indices.size and not 0 <= int(vertex_indices.min()) <= int(
            vertex_indices.max()
        ) < len(vertices):
            raise SceneError(f"mesh {name!r} is broken: faces of missing vertices")
    if not np.isfinite(vertices).all():
        raise SceneError(f"mesh {name!r} has coordinates that are no numbers")
    return vertices, faces, hull if len(hull) else None


def _read_hull_faces(model: mujoco.MjModel, mesh: int, name: str) -> Int32:
    """Return the faces of a mesh's hull, (n, 3); n = 0 if the model doesn't have the hull.

    MuJoCo's `mesh_graph` of a hull with v vertices and m faces contains v, m, two lists of v
    numbers each, a list of v + 3 m numbers, and the faces.
    """
    graph_start = int(model.mesh_graphadr[mesh])
    if graph_start < 0:
        return np.empty((0, 3), dtype=np.int32)
    num_vertices = int(model.mesh_graph[graph_start])
    num_faces = int(model.mesh_graph[graph_start + 1])
    first_corner = graph_start + 2 + 3 * (num_vertices + num_faces)
    corner_indices = np.asarray(model.mesh_graph[first_corner : first_corner + 3 * num_faces])
    if len(corner_indices) != 3 * num_faces:
        raise SceneError(f"mesh {name!r} is broken: its hull's faces are missing")
    return corner_indices.reshape(-1, 3)
