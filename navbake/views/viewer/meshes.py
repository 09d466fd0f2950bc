"""Makes the triangles of a scene and of layers that the viewer draws, and finds clicked cells.

Triangles are sent to the page as binary glTF (GLB). Source: Khronos Group, glTF 2.0 Specification,
and its extension ``KHR_materials_unlit``.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.formats.floor_mesh import GlbBuffer, cover_with_quads
from navbake.lazy import lazy
from navbake.mujoco_types import MjDataLike
from navbake.navgrid.cells import Cell, place_at
from navbake.navgrid.colors import to_linear
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.types import Bool, Float, Int, Json
from navbake.views.layers import FLAT_TOLERANCE, LAYER_LIFT, MAX_RISE

if TYPE_CHECKING:
    import mujoco
    from trimesh import Trimesh

    from navbake.baker.scene.scene import Scene

Image = lazy("PIL.Image")  # not needed when the command line starts
creation = lazy("trimesh.creation")  # not needed for a page without a scene
graph = lazy("trimesh.graph")
intersections = lazy("trimesh.intersections")
trimesh = lazy("trimesh")

NUM_SHOWN_GROUPS = 3  # MuJoCo's viewers show the geoms of the groups 0 to 2
PLANE_MARGIN = 1.5  # an endless plane is drawn this many times larger than the scene
# Corners of a rectangle's two triangles
RECTANGLE_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
# Pairs: a number of round geoms, and how many corners a circle has if the scene has at most this
# many round geoms. Without a graphics card, a browser draws about 100,000 triangles smoothly.
CIRCLE_CORNERS = ((100, 20), (500, 12), (1 << 62, 8))
# If the meshes of all geoms together have more triangles than this, they are coarsened.
MAX_MESH_TRIANGLES = 200_000
SHARP_ANGLE = 1.2  # an edge whose faces meet at this angle or more isn't smoothed [rad]
CAP_SHADE = 0.35  # brightness of a cap, which closes a cut solid, relative to the solid's
# The plane of a cut is raised by this, since trimesh drops triangles that lie in the plane [m].
CUT_TOLERANCE = 1e-6
# A surface with more triangles is shaded smoothly, without sharp edges, to save memory.
MAX_FLAT_TRIANGLES = 400_000
# A mesh that is shown by at least MIN_BATCH_GEOMS geoms of one colour is sent once, as a batch.
# Where it is far from the camera, the page draws it coarser: beyond LOD_DISTANCE [m], with the
# share LOD_SHARE of its triangles; beyond twice that, with the share by MAX_MESH_TRIANGLES.
MIN_BATCH_GEOMS = 4
LOD_DISTANCE = 6.0
LOD_SHARE = 0.4
MAX_BATCH_TRIANGLES = 20_000  # a batch's mesh with more triangles is coarsened
AMBIENT_LIGHT = 0.2
DIRECTED_LIGHT = (0.3, 0.16, 0.8)  # added on faces that look along x, y and z

# mjtGeom: numbers of the file format, the same in all versions
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(8)
ROUND_KINDS = (SPHERE, CAPSULE, ELLIPSOID, CYLINDER)
# kind of geom -> indices of the entries of its size that scale its unit solid along x, y and z
SIZE_ENTRIES = {
    SPHERE: (0, 0, 0),
    CAPSULE: (0, 0, 0),
    CYLINDER: (0, 0, 1),
    ELLIPSOID: (0, 1, 2),
    BOX: (0, 1, 2),
}
# mjtTextureRole: which textures of a material are its colour
RGB_ROLE = 1
RGBA_ROLE = 7
TEXTURE_2D = 0  # mjtTexture: a flat picture, not the six sides of a cube
DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1], dtype=np.float32)  # of a geom without a colour

# If a level needs more rectangles, FLAT_TOLERANCE is doubled until they are few enough.
MAX_RECTANGLES = 200_000
RECTANGLE_OVERLAP = 0.002  # by how much rectangles overlap, so that no gaps show [cells]
MAX_PICTURE_SIDE = 4096  # longest side of a picture that any browser accepts [pixels]
FLOOR_TOLERANCE = 0.05  # a floor at most this far above the clicked point counts as below it [m]
# numbers of glTF for how pictures are sampled
NEAREST_FILTER = 9728
MIPMAP_FILTER = 9987
CLAMP_TO_EDGE = 33071

Picture: TypeAlias = NDArray[np.uint8]
"""Pixels, shape (height, width, 3 or 4)."""
Faces: TypeAlias = NDArray[np.integer]
"""Triangles, as indices of three vertices each, shape (n, 3)."""
Reals: TypeAlias = NDArray[np.floating]
"""Values in float32 or float64."""


class Surface(NamedTuple):
    """Triangles that are drawn in the same way.

    Attributes:
        vertices: positions, world frame [m], shape (n, 3).
        faces: triangles, as indices into `vertices`, shape (m, 3).
        geom: the id of each vertex's geom, shape (n,); None if the surface belongs to no geom.
        colors: linear red, green, blue and opacity, 0 to 1, shape (n, 4); None for white.
        uv: positions on the texture, 0 to 1 from its upper left corner, shape (n, 2); None for a
            surface without a texture.
        texture: the id of the texture, -1 for none.
        is_round: whether the surface is shaded smoothly, not as flat triangles.
        opacity: the opacity of the whole surface, 1 for opaque.
    """

    vertices: Reals
    faces: Faces
    geom: NDArray[np.int32] | None = None
    colors: Reals | None = None
    uv: Reals | None = None
    texture: int = -1
    is_round: bool = False
    opacity: float = 1.0

    @property
    def face_geoms(self) -> Int:
        """The id of each triangle's geom, -1 for none, shape (m,)."""
        geom = np.full(len(self.vertices), -1) if self.geom is None else self.geom
        face_geoms: Int = geom[self.faces[:, 0]].astype(np.int64)
        return face_geoms


class LodStep(NamedTuple):
    """A level of detail: beyond a distance from the camera, fewer triangles of a mesh are drawn."""

    distance: float  # [m]
    share: float  # share of the mesh's triangles that is drawn, 0 to 1


class MeshBatch(NamedTuple):
    """A mesh that several geoms of one colour show, so that it is sent once.

    Attributes:
        content: the mesh as GLB, in its own frame. Its colours contain the light, which is computed
            once, for the rotation of the first geom.
        geoms: the geoms' ids, shape (n,).
        rotations: the geoms' rotations, quaternions w, x, y, z, shape (n, 4).
        positions: the geoms' positions, world frame [m], shape (n, 3).
        tops: world z of each geom's highest point [m], shape (n,).
        lod: the levels of detail, by ascending distance; empty if the mesh is always drawn in full.
    """

    content: bytes
    geoms: Int
    rotations: Float
    positions: Float
    tops: Float
    lod: tuple[LodStep, ...]

    def is_below(self, height: float | None) -> Bool:
        """Mark the geoms that are wholly below a height, shape (n,).

        Args:
            height: world z [m]; None to mark all geoms.
        """
        return np.full(len(self.tops), True) if height is None else self.tops <= height


class Drawing(NamedTuple):
    """A scene as triangles.

    Attributes:
        surfaces: the triangles of all geoms, those of `batches` included.
        textures: MuJoCo's id of a texture -> its picture.
        bounds: lower and upper corner of the scene, world frame [m], shape (2, 3).
        names: the name of each geom by its id, the same as in grids.
        is_solid: whether each geom is one convex solid, so that a cut through it can be closed;
            shape (number of geoms,).
        has_hidden: whether the scene has geoms that are drawn only if the user wants to see them.
        batches: meshes that several geoms show.
    """

    surfaces: tuple[Surface, ...]
    textures: dict[int, Picture]
    bounds: Float
    names: tuple[str, ...]
    is_solid: Bool
    has_hidden: bool
    batches: tuple[MeshBatch, ...] = ()


class GeomColors(NamedTuple):
    """The colours of a model's n geoms: linear red, green, blue and opacity."""

    # colours that include the texture's mean colour, shape (n, 4)
    with_texture: NDArray[np.float32]
    without_texture: NDArray[np.float32]  # colours to multiply with the texture, shape (n, 4)
    texture_ids: Int  # MuJoCo's id of the texture that a mesh shows, -1 for none, shape (n,)


class Appearance(NamedTuple):
    """How a surface is drawn; surfaces with the same appearance are joined."""

    is_clear: bool  # whether it is partly transparent
    is_round: bool  # whether it is shaded smoothly
    texture: int  # MuJoCo's id of its texture, -1 for none


class ViewRay(NamedTuple):
    """A ray in the world frame, from the camera through a click."""

    origin: ArrayLike  # x, y, z [m]
    direction: ArrayLike  # of any length


# --- a scene as triangles -------------------------------------------------------------------------


def draw_scene(
    scene: Scene,
    *,
    data: MjDataLike | None = None,
    removed: Collection[int] = (),
    with_hidden: bool = False,
) -> Drawing:
    """Make triangles of a scene.

    The geoms that MuJoCo's viewers draw are drawn: those of the groups 0 to 2 that aren't wholly
    transparent, or those of all groups if these three have none. Meshes show their textures; other
    geoms have the mean colour of their texture. Geoms that are drawn in the same way share a
    surface.

    Args:
        scene: a loaded scene.
        data: the data with the pose; None for the scene's own pose.
        removed: the ids of the geoms to leave out.
        with_hidden: whether to draw the geoms of all groups.

    Returns:
        The triangles, in the world frame.
    """
    model = scene.model
    if data is None:
        data = scene.data
    colors = _find_geom_colors(model)
    is_drawn = (colors.with_texture[:, 3] > 0) & ~np.isin(np.arange(model.ngeom), list(removed))
    is_in_shown_group = is_drawn & (model.geom_group < NUM_SHOWN_GROUPS)
    has_hidden = bool(is_in_shown_group.any() and (is_drawn & ~is_in_shown_group).any())
    if has_hidden and not with_hidden:
        is_drawn = is_in_shown_group

    is_clear = colors.with_texture[:, 3] < 1
    geom_surfaces = list(_draw_solids(model, data, is_drawn, is_clear))
    geom_surfaces += _draw_meshes(scene, data, is_drawn, colors.texture_ids)
    bounds = _find_bounds(geom_surfaces)
    plane_geoms = np.flatnonzero(is_drawn & (model.geom_type == PLANE)).tolist()
    geom_surfaces += [_draw_plane(model, data, geom, bounds) for geom in plane_geoms]

    textures: dict[int, Picture] = {}
    surfaces = []
    for surface in _merge_alike(geom_surfaces, is_clear):
        assert surface.geom is not None
        if surface.texture < 0:
            surfaces.append(surface._replace(colors=colors.with_texture[surface.geom]))
        else:
            textures[surface.texture] = _read_texture(model, surface.texture)
            surfaces.append(surface._replace(colors=colors.without_texture[surface.geom]))
    is_in_batch = is_drawn & (colors.texture_ids < 0)
    return Drawing(
        surfaces=tuple(surfaces),
        textures=textures,
        bounds=_find_bounds(geom_surfaces),
        names=_name_geoms(model),
        is_solid=(model.geom_type >= SPHERE) & (model.geom_type <= BOX),
        has_hidden=has_hidden,
        batches=tuple(_make_batches(scene, data, is_in_batch, colors.with_texture)),
    )


def _merge_alike(geom_surfaces: Sequence[Surface], is_clear: Bool) -> Iterator[Surface]:
    """Join the surfaces that have the same appearance.

    Args:
        geom_surfaces: surfaces of one geom, or of several that are drawn alike.
        is_clear: whether each geom is partly transparent, by its id.
    """
    surfaces_of_appearance: dict[Appearance, list[Surface]] = {}
    for geom_surface in geom_surfaces:
        first_geom = geom_surface.face_geoms[0]
        appearance = Appearance(is_clear[first_geom], geom_surface.is_round, geom_surface.texture)
        surfaces_of_appearance.setdefault(appearance, []).append(geom_surface)
    for appearance in sorted(surfaces_of_appearance):
        alike_surfaces = surfaces_of_appearance[appearance]
        vertices, faces = trimesh.util.append_faces(
            [geom_surface.vertices for geom_surface in alike_surfaces],
            [geom_surface.faces for geom_surface in alike_surfaces],
        )
        uv = None
        if appearance.texture >= 0:
            uv = np.concatenate(
                [geom_surface.uv for geom_surface in alike_surfaces if geom_surface.uv is not None]
            )
        yield Surface(
            vertices=vertices.astype(np.float32),
            faces=faces.astype(np.uint32),
            geom=np.concatenate(
                [
                    geom_surface.geom
                    for geom_surface in alike_surfaces
                    if geom_surface.geom is not None
                ]
            ),
            uv=uv,
            texture=appearance.texture,
            is_round=appearance.is_round,
        )


def _name_geoms(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the name of each geom, the same as in grids.

    It is the name of the geom's topmost body. A geom of the world body has its own name.
    """
    names = []
    for geom, root_body in enumerate(model.body_rootid[model.geom_bodyid].tolist()):
        if root_body:
            names.append(model.body(root_body).name or f"body {root_body}")
        else:
            names.append(model.geom(geom).name or f"geom {geom}")
    return tuple(names)


def _make_batches(
    scene: Scene, data: mujoco.MjData, is_drawn: Bool, colors: NDArray[np.float32]
) -> Iterator[MeshBatch]:
    """Batch the opaque meshes that several geoms show.

    A batch is lit once, so its geoms must be tilted alike; they may be rotated about z.
    """
    model = scene.model
    is_candidate = is_drawn & (model.geom_type == MESH) & (model.geom_dataid >= 0)
    is_candidate &= colors[:, 3] == 1
    geoms = np.array(
        [geom for geom in np.flatnonzero(is_candidate) if geom not in scene.exact_meshes], np.int64
    )
    if not len(geoms):
        return
    # share of their triangles with which all meshes together are few enough
    triangle_fraction = MAX_MESH_TRIANGLES / int(model.mesh_facenum[model.geom_dataid[geoms]].sum())
    tilts = np.round(data.geom_xmat[geoms, 6:], 2) + 0.0
    group_keys = np.column_stack([model.geom_dataid[geoms], colors[geoms], tilts])
    _, group_ids = np.unique(group_keys, axis=0, return_inverse=True)
    for group_id in range(int(group_ids.max()) + 1):
        group_geoms = geoms[group_ids.ravel() == group_id]
        if len(group_geoms) >= MIN_BATCH_GEOMS:
            yield _make_batch(model, data, group_geoms, colors[group_geoms[0]], triangle_fraction)


def _make_batch(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geoms: Int,
    color: NDArray[np.float32],
    triangle_fraction: float,
) -> MeshBatch:
    """Make a batch of geoms that show one mesh.

    Args:
        model: the model.
        data: the data with the pose.
        geoms: the ids of the geoms.
        color: the colour of the geoms: linear red, green, blue and opacity.
        triangle_fraction: the share of the mesh's triangles to draw from afar; 1 or more to draw
            all.
    """
    vertices, faces = _mesh_arrays(model, int(model.geom_dataid[geoms[0]]))
    if len(faces) > MAX_BATCH_TRIANGLES:
        vertices, faces = coarsen(vertices, faces, MAX_BATCH_TRIANGLES)
    rotations = data.geom_xmat[geoms].reshape(-1, 3, 3)
    positions = data.geom_xpos[geoms].copy()
    relative_tops = (rotations[:, 2] @ vertices.T).max(axis=1)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    has_many_triangles = triangle_fraction < 1  # else few triangles, each with edges of its own
    lod: tuple[LodStep, ...] = ()
    if has_many_triangles:
        mesh = graph.smooth_shade(mesh, SHARP_ANGLE, facet_minarea=None)
        lod = (
            LodStep(LOD_DISTANCE, max(LOD_SHARE, triangle_fraction)),
            LodStep(2 * LOD_DISTANCE, triangle_fraction),
        )
    surface = Surface(
        mesh.vertices.astype(np.float32),
        mesh.faces.astype(np.uint32),
        colors=np.tile(color, (len(mesh.vertices), 1)),
        is_round=has_many_triangles,
    )
    to_quaternion = trimesh.transformations.quaternion_from_matrix
    return MeshBatch(
        content=draw_surfaces([surface], {}, rotations[0]),
        geoms=geoms,
        rotations=np.array([to_quaternion(rotation) for rotation in rotations]),
        positions=positions,
        tops=positions[:, 2] + relative_tops,
        lod=lod,
    )


def _mesh_arrays(model: mujoco.MjModel, mesh_id: int) -> tuple[Float, Faces]:
    """Return the vertices of a model's mesh in its own frame [m], and its triangles."""
    mesh = model.mesh(mesh_id)
    first_vertex_index = int(mesh.vertadr[0])
    first_face_index = int(mesh.faceadr[0])
    vertices = model.mesh_vert[first_vertex_index : first_vertex_index + int(mesh.vertnum[0])]
    faces = model.mesh_face[first_face_index : first_face_index + int(mesh.facenum[0])]
    return vertices.astype(np.float64), faces


def _draw_solids(
    model: mujoco.MjModel, data: mujoco.MjData, is_drawn: Bool, is_clear: Bool
) -> Iterator[Surface]:
    """Draw boxes, spheres and so on.

    Yields:
        For each kind, a surface of all opaque geoms, and one of all transparent geoms.
    """
    num_round = int(np.isin(model.geom_type[is_drawn], ROUND_KINDS).sum())
    num_corners = next(
        num_corners for max_num_round, num_corners in CIRCLE_CORNERS if num_round <= max_num_round
    )
    for (kind, size_entries), is_clear_group in product(SIZE_ENTRIES.items(), (False, True)):
        geoms = np.flatnonzero(is_drawn & (model.geom_type == kind) & (is_clear == is_clear_group))
        if not len(geoms):
            continue
        unit_solid = _make_unit_solid(kind, num_corners)
        local_vertices = unit_solid.vertices * model.geom_size[geoms][:, None, size_entries]
        if kind == CAPSULE:  # its halves are moved apart
            local_vertices[..., 2] += (
                np.sign(unit_solid.vertices[:, 2]) * model.geom_size[geoms, 1, None]
            )
        rotations = data.geom_xmat[geoms].reshape(-1, 3, 3).transpose(0, 2, 1)
        vertices = (local_vertices @ rotations + data.geom_xpos[geoms][:, None]).reshape(-1, 3)
        first_vertices = (np.arange(len(geoms)) * len(unit_solid.vertices))[:, None, None]
        yield Surface(
            vertices,
            (unit_solid.faces + first_vertices).reshape(-1, 3),
            np.repeat(geoms, len(unit_solid.vertices)).astype(np.int32),
            is_round=kind in ROUND_KINDS,
        )


def _make_unit_solid(kind: int, num_corners: int) -> Trimesh:
    """Make the unit solid of a kind of geom: the solid of half-size 1.

    That of a capsule is a ball; its halves are moved apart later.

    Args:
        kind: the kind of geom, a number of mjtGeom.
        num_corners: how many corners a circle has.
    """
    unit_solid: Trimesh
    if kind == BOX:
        unit_solid = creation.box((2, 2, 2))
    elif kind == CYLINDER:  # its round side and its flat ends are shaded apart
        cylinder = creation.cylinder(1, 2, num_corners)
        unit_solid = graph.smooth_shade(cylinder, SHARP_ANGLE, facet_minarea=None)
    elif kind == CAPSULE:
        unit_solid = creation.capsule(2, 1, count=[num_corners // 2, num_corners])
        # a little less than 1, so that the sign of z still says which half a vertex belongs to
        unit_solid.vertices[:, 2] -= np.sign(unit_solid.vertices[:, 2]) * (1 - 1e-9)
    else:
        unit_solid = creation.uv_sphere(count=[num_corners // 2, num_corners])
    return unit_solid


def _draw_meshes(
    scene: Scene, data: mujoco.MjData, is_drawn: Bool, textures: Int
) -> Iterator[Surface]:
    """Draw meshes, height fields, and geoms for which the scene has an exact mesh.

    If all meshes together have more than `MAX_MESH_TRIANGLES`, meshes without a texture are
    coarsened.

    Args:
        scene: the scene.
        data: the data with the pose.
        is_drawn: whether each geom is drawn.
        textures: the id of each geom's texture, -1 for none.
    """
    model = scene.model
    coarse_meshes: dict[int, tuple[Float, Faces]] = {}
    mesh_ids = model.geom_dataid[is_drawn & (model.geom_type >= MESH) & (model.geom_dataid >= 0)]
    triangle_fraction = MAX_MESH_TRIANGLES / max(int(model.mesh_facenum[mesh_ids].sum()), 1)
    for geom in np.flatnonzero(is_drawn).tolist():
        if geom in scene.exact_meshes:  # in the world frame already
            mesh = scene.exact_meshes[geom]
            yield _make_geom_surface(geom, np.asarray(mesh.vertices), np.asarray(mesh.faces))
            continue

        kind = int(model.geom_type[geom])
        data_id = int(model.geom_dataid[geom])
        texture_id = int(textures[geom])
        texture_positions = None
        vertices: Float
        faces: Faces
        if kind == HFIELD:
            vertices, faces = _make_hfield_top(model, data_id)
        elif kind >= MESH and data_id >= 0:
            vertices, faces = _mesh_arrays(model, data_id)
            if texture_id >= 0 and model.mesh_texcoordnum[data_id]:
                # triangles that share a vertex needn't share its position on the texture
                texture_positions = model.mesh_texcoord[_list_texcoord_ids(model, data_id)]
                vertices = vertices[faces.ravel()]
                faces = np.arange(len(vertices)).reshape(-1, 3)
            elif triangle_fraction < 1:
                if data_id not in coarse_meshes:
                    max_triangles = int(triangle_fraction * len(faces))
                    coarse_meshes[data_id] = coarsen(vertices, faces, max_triangles)
                vertices, faces = coarse_meshes[data_id]
        else:
            continue
        world_vertices = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        surface = _make_geom_surface(geom, world_vertices, faces)
        if texture_positions is not None:
            surface = surface._replace(uv=texture_positions, texture=texture_id)
        yield surface


def _make_hfield_top(model: mujoco.MjModel, hfield_id: int) -> tuple[Float, Int]:
    """Return the vertices and triangles of a height field's upper side, in its own frame [m]."""
    num_rows = int(model.hfield_nrow[hfield_id])
    num_cols = int(model.hfield_ncol[hfield_id])
    heights = model.hfield_data[int(model.hfield_adr[hfield_id]) :][: num_rows * num_cols]
    y, x = np.meshgrid(np.linspace(-1, 1, num_rows), np.linspace(-1, 1, num_cols), indexing="ij")
    unit_vertices = np.stack([x.ravel(), y.ravel(), heights.astype(np.float64)], axis=1)
    first_corners = (np.arange(num_rows - 1)[:, None] * num_cols + np.arange(num_cols - 1)).ravel()
    rectangles = first_corners[:, None] + np.array([0, 1, num_cols + 1, num_cols])
    return unit_vertices * model.hfield_size[hfield_id, :3], rectangles[
        :, RECTANGLE_TRIANGLES
    ].reshape(-1, 3)


def _list_texcoord_ids(model: mujoco.MjModel, mesh_id: int) -> NDArray[np.int32]:
    """Return an index into `model.mesh_texcoord` for each corner of a mesh's triangles, (3 n,)."""
    mesh = model.mesh(mesh_id)
    first_face_index = int(mesh.faceadr[0])
    end_face_index = first_face_index + int(mesh.facenum[0])
    texcoord_ids: NDArray[np.int32] = (
        model.mesh_facetexcoord[first_face_index:end_face_index].ravel() + mesh.texcoordadr[0]
    )
    return texcoord_ids


def coarsen(vertices: Float, faces: Faces, max_triangles: int) -> tuple[Float, Faces]:
    """Coarsen a mesh by vertex clustering: all vertices in a cell of a cubic lattice become one.

    Source: Rossignac and Borrel 1993, Multi-resolution 3D approximations for rendering complex
    scenes.

    Args:
        vertices: shape (n, 3).
        faces: triangles as indices into `vertices`, shape (m, 3).
        max_triangles: the largest number of triangles that should remain. Of several lattices, the
            finest that meets this is used, or the coarsest if none does.

    Returns:
        Vertices and triangles of the coarse mesh.
    """
    longest_side = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    unit_vertices = (vertices - vertices.min(axis=0)) / longest_side
    for num_lattice_cells in (64, 48, 32, 24, 16, 12, 8, 6, 4):
        lattice_cells = np.round(unit_vertices * num_lattice_cells).astype(np.int64)
        first_vertices, cluster_of_vertex = trimesh.grouping.unique_rows(lattice_cells)
        mesh = trimesh.Trimesh(vertices[first_vertices], cluster_of_vertex[faces], process=False)
        mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
        if len(mesh.faces) <= max_triangles:
            break
    return mesh.vertices, mesh.faces


def _make_geom_surface(geom: int, vertices: Float, faces: Faces) -> Surface:
    return Surface(vertices, faces, np.full(len(vertices), geom, np.int32))


def _draw_plane(model: mujoco.MjModel, data: mujoco.MjData, geom: int, bounds: Float) -> Surface:
    """Draw a plane as a rectangle; along an endless direction it extends beyond the scene.

    Args:
        model: the model.
        data: the data with the pose.
        geom: the id of the plane.
        bounds: lower and upper corner of the scene without planes, world frame [m].
    """
    rotation = data.geom_xmat[geom].reshape(3, 3)
    position = data.geom_xpos[geom]
    rectangle_middle = ((bounds.mean(axis=0) - position) @ rotation)[:2]
    endless_half_size = PLANE_MARGIN * max(float(np.linalg.norm(bounds[1] - bounds[0])) / 2, 1.0)
    half_size = model.geom_size[geom, :2]
    is_endless = half_size <= 0
    rectangle_middle = np.where(is_endless, rectangle_middle, 0.0)
    half_size = np.where(is_endless, endless_half_size, half_size)
    corners = rectangle_middle + half_size * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return _make_geom_surface(geom, corners @ rotation[:, :2].T + position, RECTANGLE_TRIANGLES)


def _find_bounds(surfaces: Sequence[Surface]) -> Float:
    """Return the lower and upper corner of surfaces [m], shape (2, 3).

    Without surfaces, they are those of a cube round the origin.
    """
    if not surfaces:
        return np.array([[-1.0, -1, -1], [1, 1, 1]])
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def _find_geom_colors(model: mujoco.MjModel) -> GeomColors:
    """Find the colours of geoms, the same as in MuJoCo's viewers.

    A geom has its own colour, if that isn't MuJoCo's default; else the colour of its material.
    """
    rgba = np.array(model.geom_rgba, dtype=np.float32).reshape(-1, 4)
    material_ids = np.array(model.geom_matid, dtype=np.int64)
    has_material_color = (material_ids >= 0) & (rgba == DEFAULT_RGBA).all(axis=1)
    texture_ids = np.full(len(rgba), -1, dtype=np.int64)
    if model.nmat:
        rgba[has_material_color] = model.mat_rgba[material_ids[has_material_color]]
        texture_of_role = np.asarray(model.mat_texid).reshape(model.nmat, -1)
        rgb_texture = texture_of_role[:, RGB_ROLE]
        texture_of_material = np.where(rgb_texture >= 0, rgb_texture, texture_of_role[:, RGBA_ROLE])
        texture_ids = np.where(material_ids >= 0, texture_of_material[material_ids], -1)
    without_texture = to_linear_rgba(rgba)
    with_texture = without_texture.copy()
    for texture_id in np.unique(texture_ids[texture_ids >= 0]).tolist():
        mean_color = _read_texture(model, texture_id)[..., :3].mean(axis=(0, 1)) / 255
        with_texture[texture_ids == texture_id, :3] *= to_linear_rgba(mean_color)
    is_flat_texture = np.isin(texture_ids, np.flatnonzero(np.asarray(model.tex_type) == TEXTURE_2D))
    return GeomColors(with_texture, without_texture, np.where(is_flat_texture, texture_ids, -1))


def _read_texture(model: mujoco.MjModel, texture_id: int) -> Picture:
    """Return the picture of a texture, shape (height, width, 3 or 4), the upper row first."""
    height = model.tex_height[texture_id]
    width = model.tex_width[texture_id]
    num_channels = model.tex_nchannel[texture_id]
    first_byte = int(model.tex_adr[texture_id])
    num_bytes = int(height) * int(width) * int(num_channels)
    picture = np.asarray(model.tex_data[first_byte : first_byte + num_bytes]).reshape(
        height, width, num_channels
    )
    return np.repeat(picture, 3, axis=2) if num_channels == 1 else picture


def to_linear_rgba(srgb_color: Reals) -> NDArray[np.float32]:
    """Convert sRGB colours to linear light, shape (..., 3 or 4); the opacity stays."""
    srgb_color = np.asarray(srgb_color, dtype=np.float32)
    linear_color = to_linear(srgb_color)
    linear_color[..., 3:] = srgb_color[..., 3:]
    return linear_color.astype(np.float32)


# --- the scene below a height ---------------------------------------------------------------------


def cut_drawing(drawing: Drawing, height: float) -> tuple[Surface, ...]:
    """Cut a scene by a horizontal plane, and keep the part below.

    A triangle across the plane is replaced by its lower part. Cut boxes, cylinders and other convex
    solids are closed by a face that is darker than they are; meshes and height fields stay open.

    Args:
        drawing: the scene.
        height: world z of the plane [m].

    Returns:
        The surfaces below the plane. Those that are wholly above it are left out.
    """
    surfaces: list[Surface] = []
    for surface in drawing.surfaces:
        if (surface.vertices[:, 2] <= height).all():
            surfaces.append(surface)
            continue
        for cut_surface in (
            _cut_surface(surface, height),
            _make_caps(surface, height, drawing.is_solid),
        ):
            if len(cut_surface.faces):
                surfaces.append(cut_surface)
    return tuple(surfaces)


def _cut_surface(surface: Surface, height: float) -> Surface:
    """Return a surface with the parts of its triangles below a height (world z [m])."""
    corners = surface.vertices[surface.faces]
    # triangles without an area are dropped, because they have no barycentric coordinates
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = surface.faces[normals.any(axis=1)].astype(np.int64)
    # trimesh interpolates `uv` at new vertices. So geom, colour and position on the texture of each
    # vertex are passed as `uv`. Geom and colour are the same at all corners of a triangle.
    vertex_attributes = [
        attribute
        for attribute in (surface.geom, surface.colors, surface.uv)
        if attribute is not None
    ]
    vertices, faces, cut_attributes = intersections.slice_faces_plane(
        surface.vertices.astype(np.float64),
        faces,
        plane_normal=[0, 0, -1],
        plane_origin=[0, 0, height + CUT_TOLERANCE],
        uv=np.column_stack(vertex_attributes),
    )
    vertices[:, 2] = np.minimum(vertices[:, 2], height)
    cut_attributes = cut_attributes.astype(np.float32)
    return surface._replace(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.uint32),
        geom=np.rint(cut_attributes[:, 0]).astype(np.int32),
        colors=cut_attributes[:, 1:5],
        uv=None if surface.uv is None else cut_attributes[:, 5:],
    )


def _make_caps(drawn_triangles: Surface, height: float, is_solid: Bool) -> Surface:
    """Make the caps that close cut solids, darker than the solids.

    The section of a convex solid is convex: its cap is a fan of triangles round its middle.

    Args:
        drawn_triangles: triangles of solids and of other geoms, not yet cut.
        height: world z of the cut [m].
        is_solid: whether each geom is a convex solid, see `Drawing.is_solid`.
    """
    assert drawn_triangles.geom is not None and drawn_triangles.colors is not None
    solid_faces = drawn_triangles.faces[is_solid[drawn_triangles.face_geoms]]
    mesh = trimesh.Trimesh(drawn_triangles.vertices, solid_faces, process=False)
    cut_lines, cut_faces = intersections.mesh_plane(
        mesh, [0, 0, 1], [0, 0, height], return_faces=True
    )
    first_vertices = solid_faces[cut_faces, 0]
    geoms, group_of_line = np.unique(drawn_triangles.geom[first_vertices], return_inverse=True)
    position_sums = [
        np.bincount(group_of_line, cut_lines[:, :, axis].mean(axis=1)) for axis in range(3)
    ]
    group_middles = (np.stack(position_sums) / np.bincount(group_of_line)).T[group_of_line]
    vertices = (
        np.concatenate([cut_lines, group_middles[:, None]], axis=1)
        .reshape(-1, 3)
        .astype(np.float32)
    )
    shade_factors = np.array([CAP_SHADE, CAP_SHADE, CAP_SHADE, 1], dtype=np.float32)
    return Surface(
        vertices,
        np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3),
        np.repeat(geoms[group_of_line], 3).astype(np.int32),
        np.repeat(drawn_triangles.colors[first_vertices] * shade_factors, 3, axis=0),
    )


# --- the layers of levels, and GLB ----------------------------------------------------------------


def make_floor_surface(
    level: SceneGrid2D, *, with_holes: bool = True, max_rectangles: int = MAX_RECTANGLES
) -> Surface:
    """Make the surface of a level's floors, on which its layers are drawn as a texture.

    Each flat part of the floors, which may be a slope, is one rectangle.

    Args:
        level: the level.
        with_holes: whether to leave out the cells without a floor; otherwise they lie at the
            level's ground.
        max_rectangles: the largest number of rectangles; if more would be needed, the surface
            follows the floors less closely.

    Returns:
        The surface. Its texture has a pixel for each cell of the level, see `draw_overlay`.
    """
    floor = level.floor.astype(np.float64)
    cell_size = level.lattice.cell_size
    is_shown = ~np.isnan(floor) if with_holes else np.ones(level.shape, np.bool_)
    cell_heights = np.where(np.isnan(floor), level.ground, floor)
    cell_labels = is_shown.astype(np.int32)
    height_span = float(np.ptp(cell_heights))
    flat_tolerance = FLAT_TOLERANCE
    while True:
        _, corner_rows, corner_cols, z = cover_with_quads(
            cell_labels, cell_heights, flat_tolerance, MAX_RISE * cell_size, RECTANGLE_OVERLAP
        )
        if len(corner_rows) <= max_rectangles or flat_tolerance > height_span:
            break
        flat_tolerance *= 2
    x = level.lattice.x_min + corner_cols * cell_size
    y = level.lattice.y_max - corner_rows * cell_size
    corners = np.stack([x, y, z + LAYER_LIFT + flat_tolerance], axis=-1)
    first_corners = (np.arange(len(corner_rows)) * 4)[:, None, None]
    triangles = RECTANGLE_TRIANGLES + first_corners
    texture_positions = np.stack(
        [corner_cols / level.width, corner_rows / level.height], axis=-1
    ).reshape(-1, 2)
    return Surface(
        corners.reshape(-1, 3).astype(np.float32),
        triangles.reshape(-1, 3).astype(np.uint32),
        uv=texture_positions.astype(np.float32),
        texture=0,
    )


def draw_overlay(floor_surface: Surface, cell_colors: Picture, opacity: float = 1.0) -> bytes:
    """Draw a layer of a level on its floor.

    Args:
        floor_surface: the surface of the level, see `make_floor_surface`.
        cell_colors: the colour of each cell, shape (height, width, 3).
        opacity: the opacity of the layer, 0 to 1.

    Returns:
        The triangles as GLB.
    """
    picture = Image.fromarray(cell_colors)
    picture = picture.reduce(-(-max(picture.size) // MAX_PICTURE_SIDE))
    return make_glb([floor_surface._replace(opacity=opacity)], {0: np.asarray(picture)})


def draw_surfaces(
    surfaces: Sequence[Surface],
    textures: Mapping[int, Picture],
    rotation: ArrayLike | None = None,
) -> bytes:
    """Draw surfaces of a scene with light and shade.

    The light is multiplied into the colours, so that browsers draw the scene smoothly even without
    a graphics card. Both sides of a triangle are lit alike. See `AMBIENT_LIGHT` and
    `DIRECTED_LIGHT`.

    Args:
        surfaces: the surfaces, with colours.
        textures: the pictures of the surfaces, by texture id.
        rotation: the rotation from the frame of the vertices to the world frame, shape (3, 3); None
            if they are in the world frame.

    Returns:
        The triangles as GLB.
    """
    to_world = np.eye(3) if rotation is None else np.asarray(rotation)
    lit_surfaces = []
    for surface in surfaces:
        if not surface.is_round and len(surface.faces) <= MAX_FLAT_TRIANGLES:
            surface = _split_vertices(surface)
        assert surface.colors is not None
        mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
        absolute_normals = np.abs(mesh.vertex_normals @ to_world.T)
        light_factors = (AMBIENT_LIGHT + absolute_normals @ DIRECTED_LIGHT)[:, None]
        colors = surface.colors * np.where([True, True, True, False], light_factors, 1.0)
        lit_surfaces.append(surface._replace(colors=colors))
    return make_glb(lit_surfaces, textures)


def _split_vertices(surface: Surface) -> Surface:
    """Give each triangle its own vertices, and so its own normals: all edges are drawn sharp."""
    assert surface.colors is not None
    corners = surface.faces.ravel()
    return surface._replace(
        vertices=surface.vertices[corners],
        faces=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        colors=surface.colors[corners],
        uv=None if surface.uv is None else surface.uv[corners],
    )


def make_glb(
    surfaces: Sequence[Surface], picture_of_texture: Mapping[int, Picture] | None = None
) -> bytes:
    """Write surfaces in their colours, without light, as binary glTF.

    Args:
        surfaces: the surfaces; those without triangles are left out.
        picture_of_texture: id of a texture, see `Surface.texture` -> its picture.

    Returns:
        The triangles as GLB.
    """
    glb_buffer = GlbBuffer()
    primitives = list[Json]()
    materials = list[Json]()
    surfaces = [surface for surface in surfaces if len(surface.faces)]
    textures = sorted({surface.texture for surface in surfaces if surface.uv is not None})
    for surface in surfaces:
        is_clear = surface.opacity < 1
        attributes = {"POSITION": glb_buffer.add_positions(surface.vertices)}
        if surface.colors is not None:
            integer_colors = np.round(np.clip(surface.colors, 0, 1) * 65535).astype(np.uint16)
            attributes["COLOR_0"] = glb_buffer.add_vectors(integer_colors, normalized=True)
            is_clear |= bool((surface.colors[:, 3] < 1).any())
        pbr_shading: Json = {"baseColorFactor": [1.0, 1.0, 1.0, surface.opacity]}
        if surface.uv is not None:
            attributes["TEXCOORD_0"] = glb_buffer.add_vectors(surface.uv)
            pbr_shading["baseColorTexture"] = {"index": textures.index(surface.texture)}
        index_accessor = glb_buffer.add_indices(surface.faces.astype(np.uint32, copy=False))
        primitives.append(
            {"attributes": attributes, "indices": index_accessor, "material": len(materials)}
        )
        materials.append(
            {
                "alphaMode": "BLEND" if is_clear else "OPAQUE",
                "doubleSided": True,
                "pbrMetallicRoughness": pbr_shading,
                "extensions": {"KHR_materials_unlit": {}},
            }
        )

    gltf_document: Json = {"extensionsUsed": ["KHR_materials_unlit"], "scenes": [{}]}
    if primitives:
        gltf_document["scenes"] = [{"nodes": [0]}]
        gltf_document["nodes"] = [{"mesh": 0}]
        gltf_document["meshes"] = [{"primitives": primitives}]
        gltf_document["materials"] = materials
    # `GlbBuffer.pack` leaves out empty lists
    gltf_document["images"] = []
    gltf_document["textures"] = []
    for texture_index, texture in enumerate(textures):
        png_file = io.BytesIO()
        # packed fast rather than small: the page is on this machine
        Image.fromarray((picture_of_texture or {})[texture]).save(png_file, "PNG", compress_level=1)
        buffer_view = glb_buffer.add_bytes(png_file.getvalue())
        gltf_document["images"].append({"bufferView": buffer_view, "mimeType": "image/png"})
        gltf_document["textures"].append({"source": texture_index, "sampler": 0})
        sampler = {
            "magFilter": NEAREST_FILTER,
            "minFilter": MIPMAP_FILTER,
            "wrapS": CLAMP_TO_EDGE,
            "wrapT": CLAMP_TO_EDGE,
        }
        gltf_document["samplers"] = [sampler]
    return glb_buffer.pack(gltf_document)


# --- picking --------------------------------------------------------------------------------------


class Pick(NamedTuple):
    """The cell under a click.

    Attributes:
        cell: the cell's level, row and column.
        position: world x, y of the click [m], and world z of the cell's floor, or of the level's
            ground if the cell has no floor [m].
        geom: the id of the clicked geom, None if the grid itself was clicked.
    """

    cell: Cell
    position: tuple[float, float, float]
    geom: int | None


class Hit(NamedTuple):
    """The first point where a ray meets a surface."""

    position: tuple[float, float, float]  # world x, y, z [m]
    geom: int  # id of the geom, -1 for none


class PickCandidate(NamedTuple):
    """A cell that the user may have clicked.

    Candidates are compared as tuples, field by field: the smallest one is the best.
    """

    has_no_floor: bool
    is_above: bool  # whether the floor is above the clicked point
    distance: float  # from the floor to the clicked point [m]
    cell: Cell
    height: float  # of the floor, or of the level's ground, world z [m]


def pick_cell(
    grid: NavGrid, ray: ViewRay, surfaces: Sequence[Surface], levels: Collection[int]
) -> Pick | None:
    """Find the cell under a click.

    The clicked point is the first point where the ray hits a surface. Each shown level has a cell
    at its x, y. Of these, the cell whose floor is nearest below the point is returned. If none has
    a floor, it is the cell of the level whose ground is nearest below.

    Args:
        grid: the grid.
        ray: the ray from the camera through the click.
        surfaces: the surfaces of the scene, then those of the grid.
        levels: the numbers of the shown levels.

    Returns:
        The cell; None if the ray hits no surface, or hits one outside of all levels.
    """
    hit = _cast_ray(ray, surfaces)
    if hit is None:
        return None
    x, y, z = hit.position
    candidates = []
    for level_number in sorted(levels):
        place = place_at(grid, (x, y), level_number)
        if place is None:
            continue
        floor_height = grid.levels[level_number].ground if place.floor is None else place.floor
        candidates.append(
            PickCandidate(
                has_no_floor=place.floor is None,
                is_above=z - floor_height < -FLOOR_TOLERANCE,
                distance=abs(z - floor_height),
                cell=place.cell,
                height=floor_height,
            )
        )
    if not candidates:
        return None
    best_candidate = min(candidates)
    return Pick(
        best_candidate.cell, (x, y, best_candidate.height), None if hit.geom < 0 else hit.geom
    )


def _cast_ray(ray: ViewRay, surfaces: Sequence[Surface]) -> Hit | None:
    """Find the nearest point where a ray meets a triangle of surfaces; None if it meets none.

    The ray is intersected with the plane of each triangle. The point is in the triangle if none of
    its barycentric coordinates is negative. If triangles are equally near, the last surface counts.
    """
    origin = np.asarray(ray.origin, dtype=np.float64)
    direction = np.asarray(ray.direction, dtype=np.float64)
    nearest_distance = np.inf
    nearest_geom = -1
    for surface in surfaces:
        corners = surface.vertices[surface.faces].astype(np.float64)
        normals = trimesh.triangles.cross(corners)
        # a triangle that the ray runs along divides by 0, and isn't met
        with np.errstate(divide="ignore", invalid="ignore"):
            distances = ((corners[:, 0] - origin) * normals).sum(axis=1) / (normals @ direction)
            points = origin + distances[:, None] * direction
            barycentric_coordinates = trimesh.triangles.points_to_barycentric(corners, points)
            is_hit = (barycentric_coordinates >= -1e-9).all(axis=1)
            is_hit &= (distances > 0) & (distances <= nearest_distance)
            hit_triangles = np.flatnonzero(is_hit)
        if len(hit_triangles):
            nearest_triangle = hit_triangles[np.argmin(distances[hit_triangles])]
            nearest_distance = float(distances[nearest_triangle])
            nearest_geom = int(surface.face_geoms[nearest_triangle])
    if not np.isfinite(nearest_distance):
        return None
    x, y, z = (origin + nearest_distance * direction).tolist()
    return Hit((x, y, z), nearest_geom)
