"""What the viewer draws as triangles: a MuJoCo scene, the layers of levels; what a click meets.

All is sent as binary glTF (GLB). Source: Khronos Group, glTF 2.0 Specification, and its extension
``KHR_materials_unlit``.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.formats.floor_mesh import GlbBuffer, cover_quads
from navbake.lazy import lazy
from navbake.navgrid.cells import Cell, place_at
from navbake.navgrid.colors import to_linear
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.types import Bool, Float, Int, Json

if TYPE_CHECKING:
    from navbake.baker.scene.scene import Scene

Image = lazy("PIL.Image")  # which the command line's start does without
creation = lazy("trimesh.creation")  # a page without a scene does without
graph = lazy("trimesh.graph")
intersections = lazy("trimesh.intersections")
trimesh = lazy("trimesh")

SHOWN_GROUPS = 3  # MuJoCo's viewers show the geoms of the groups 0 to 2
ENDLESS = 1.5  # an endless plane is drawn so much larger than what stands on it
QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
# up to so many round geoms: corners of a circle; a page without a graphics card draws some 100,000
# triangles smoothly
CORNERS = ((100, 20), (500, 12), (1 << 62, 8))
MOST_DRAWN = 200_000  # triangles of meshes; where geoms have more, their meshes are coarsened
SHARP = 1.2  # an edge between faces at this angle is drawn as one [rad]
CAP_SHADE = 0.35  # light of a cut face, by that of its geom
FLUSH = 1e-6  # a triangle that lies in the plane of a cut stays: trimesh would drop it [m]
MOST_FLAT = 400_000  # triangles with sharp edges; of more, edges are smooth, which takes less
# A mesh that so many geoms of one colour show is sent once, and drawn coarser from far: from so
# many metres on with so much of its triangles, from twice as far with what `MOST_DRAWN` allows
LEAST_ALIKE = 4
NEAR = 6.0
NEAR_SHARE = 0.4
MOST_SENT = 20_000  # triangles of such a mesh
LIGHT = 0.2, 0.3, 0.16, 0.8  # from everywhere, and on what faces along x, y and z

# mjtGeom: numbers of the file format, the same in all versions
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(8)
ROUND = (SPHERE, CAPSULE, ELLIPSOID, CYLINDER)
# which of a geom's sizes stretch its unit solid along x, y and z
SIZES = {SPHERE: (0, 0, 0), CAPSULE: (0, 0, 0), CYLINDER: (0, 0, 1)}
SIZES |= {ELLIPSOID: (0, 1, 2), BOX: (0, 1, 2)}
# mjtTextureRole: which textures of a material are its colour
RGB = 1
RGBA = 7
FLAT_TEXTURE = 0  # mjtTexture: a picture, not the six sides of a cube
NO_COLOR = np.array([0.5, 0.5, 0.5, 1], dtype=np.float32)  # rgba of a geom that states none

LIFT = 0.012  # by which the grid lies over the floor, so that it is seen [m]
FLAT = 0.01  # how far a layer may be off the floor [m]
MOST = 200_000  # rectangles of a level; with more, FLAT is doubled until it is enough
STEEPEST = 1.0  # rise of a rectangle by its length
OVERLAP = 0.002  # of a cell, by which rectangles overlap: none shows through between them
MAX_SIDE = 4096  # pixels of a picture that any browser takes; of more cells, several are one
BELOW = 0.05  # a floor so much over what was clicked is still under it [m]
# how pictures are sampled
NEAREST = 9728
MIPMAPS = 9987
CLAMP = 33071


class Surface(NamedTuple):
    """Triangles that are drawn alike; arrays by vertex, and None for white, plain or no geom."""

    vertices: NDArray[Any]  # shape (n, 3), world frame [m]
    faces: NDArray[Any]  # indices into `vertices`, shape (m, 3)
    geom: NDArray[np.int32] | None = None  # shape (n,)
    colors: NDArray[Any] | None = None  # linear light and opacity, 0 to 1, shape (n, 4)
    uv: NDArray[Any] | None = None  # on the picture, from the upper left corner, shape (n, 2)
    texture: int = -1  # id of the picture, -1 for none
    is_round: bool = False  # shaded as a round surface, else as flat triangles
    opacity: float = 1.0  # of all of it; below 1, what is behind shines through

    @property
    def owners(self) -> Int:
        """The geom of each triangle, -1 for none."""
        geom = np.full(len(self.vertices), -1) if self.geom is None else self.geom
        owners: Int = geom[self.faces[:, 0]].astype(np.int64)
        return owners


class Batch(NamedTuple):
    """A mesh that several geoms show, in one colour."""

    content: bytes  # the mesh in its own frame, lit as the first of the geoms lies: GLB
    geoms: Int  # ids, shape (n,)
    rotations: Float  # quaternions w, x, y, z of the geoms, shape (n, 4)
    positions: Float  # of the geoms, world frame, shape (n, 3) [m]
    tops: Float  # up to where each geom reaches, world z, shape (n,) [m]
    lod: tuple[tuple[float, float], ...]  # from which distance [m], with which share of triangles

    def below(self, height: float | None) -> Bool:
        """Which of the geoms are wholly below a height [m], all for None: shape (n,)."""
        return np.full(len(self.tops), True) if height is None else self.tops <= height


class Drawing(NamedTuple):
    """A scene as triangles."""

    surfaces: tuple[Surface, ...]  # of all geoms, those of the batches included
    textures: dict[int, NDArray[np.uint8]]  # by MuJoCo's id, shape (height, width, 3 or 4)
    bounds: Float  # lower and upper corner of all, world frame, shape (2, 3) [m]
    names: tuple[str, ...]  # of each geom as grids name it, by geom id
    solid: Bool  # whether a geom is one convex piece, so that a cut through it can be closed
    has_hidden: bool  # some geoms are drawn only with hidden ones
    batches: tuple[Batch, ...] = ()


def draw_scene(
    scene: Scene, *, data: Any = None, removed: Collection[int] = (), with_hidden: bool = False
) -> Drawing:
    """Make triangles of a scene, in its own pose or that of another mujoco.MjData.

    Drawn is what MuJoCo's viewers draw: geoms of the groups 0 to 2 that aren't clear; all groups
    where these hold nothing, or with hidden ones. Geoms whose ids are `removed` are left out.
    Textures of meshes are drawn; other geoms have the mean colour of theirs. Geoms that look alike
    are one surface.
    """
    model = scene.model
    data = scene.data if data is None else data
    plain, textured, texture = _find_looks(model)
    drawn = (plain[:, 3] > 0) & ~np.isin(np.arange(model.ngeom), list(removed))
    in_groups = drawn & (model.geom_group < SHOWN_GROUPS)
    has_hidden = bool(in_groups.any() and (drawn & ~in_groups).any())
    if has_hidden and not with_hidden:
        drawn = in_groups
    pieces = [*_draw_solids(model, data, drawn, plain[:, 3] < 1)]
    pieces += _draw_others(scene, data, drawn, texture)
    bounds = _bounds_of(pieces)
    planes = np.flatnonzero(drawn & (model.geom_type == PLANE)).tolist()
    pieces += [_draw_plane(model, data, geom, bounds) for geom in planes]
    looks = [(plain[piece.owners[0], 3] < 1, piece.is_round, piece.texture) for piece in pieces]
    surfaces = []
    textures = {}
    for look in sorted(set(looks)):
        some = [piece for piece, own in zip(pieces, looks, strict=True) if own == look]
        _, is_round, number = look
        parts = [piece.vertices for piece in some], [piece.faces for piece in some]
        vertices, faces = trimesh.util.append_faces(*parts)
        geom = np.concatenate([piece.geom for piece in some if piece.geom is not None])
        triangles = vertices.astype(np.float32), faces.astype(np.uint32), geom
        colors = plain[geom]
        uv = None
        if number >= 0:
            colors = textured[geom]
            textures[number] = _read_texture(model, number)
            uv = np.concatenate([piece.uv for piece in some if piece.uv is not None])
        surfaces.append(Surface(*triangles, colors, uv, number, is_round))
    solid = (model.geom_type >= SPHERE) & (model.geom_type <= BOX)
    names = [  # as grids name geoms: by the topmost body, or itself where it hangs on the world
        model.body(root).name or f"body {root}" if root else model.geom(geom).name or f"geom {geom}"
        for geom, root in enumerate(model.body_rootid[model.geom_bodyid].tolist())
    ]
    batches = tuple(_find_batches(scene, data, drawn & (texture < 0), plain))
    bounds = _bounds_of(pieces)
    return Drawing(tuple(surfaces), textures, bounds, tuple(names), solid, has_hidden, batches)


def _find_batches(
    scene: Scene, data: Any, drawn: Bool, colors: NDArray[np.float32]
) -> Iterator[Batch]:
    """Opaque meshes that several geoms show; those that are tilted alike share their light."""
    model = scene.model
    can = drawn & (model.geom_type == MESH) & (model.geom_dataid >= 0) & (colors[:, 3] == 1)
    geoms = np.array(
        [geom for geom in np.flatnonzero(can) if geom not in scene.exact_meshes], np.int64
    )
    if not len(geoms):
        return
    share = MOST_DRAWN / int(model.mesh_facenum[model.geom_dataid[geoms]].sum())
    tilts = np.round(data.geom_xmat[geoms, 6:], 2) + 0.0
    keys = np.column_stack([model.geom_dataid[geoms], colors[geoms], tilts])
    _, number = np.unique(keys, axis=0, return_inverse=True)
    for one in range(int(number.max()) + 1):
        own = geoms[number.ravel() == one]
        if len(own) < LEAST_ALIKE:
            continue
        mesh = model.mesh(int(model.geom_dataid[own[0]]))
        rotations = data.geom_xmat[own]
        first = int(mesh.vertadr[0])
        start = int(mesh.faceadr[0])
        vertices = model.mesh_vert[first : first + int(mesh.vertnum[0])].astype(np.float64)
        faces = model.mesh_face[start : start + int(mesh.facenum[0])]
        if len(faces) > MOST_SENT:
            vertices, faces = coarsen(vertices, faces, MOST_SENT)
        tops = (rotations.reshape(-1, 3, 3)[:, 2] @ vertices.T).max(axis=1)
        positions = data.geom_xpos[own].copy()
        made = trimesh.Trimesh(vertices, faces, process=False)
        is_fine = share < 1  # else few triangles, each with edges of its own
        if is_fine:
            made = graph.smooth_shade(made, SHARP, facet_minarea=None)
        look = np.tile(colors[own[0]], (len(made.vertices), 1))
        corners = made.vertices.astype(np.float32)
        sides = made.faces.astype(np.uint32)
        surface = Surface(corners, sides, colors=look, is_round=is_fine)
        content = draw_surfaces([surface], {}, rotations[0].reshape(3, 3))
        turns = trimesh.transformations.quaternion_from_matrix
        quaternions = np.array([turns(turn) for turn in rotations.reshape(-1, 3, 3)])
        lod = ((NEAR, max(NEAR_SHARE, share)), (2 * NEAR, share)) if is_fine else ()
        yield Batch(content, own, quaternions, positions, positions[:, 2] + tops, lod)


def _draw_solids(model: Any, data: Any, drawn: Bool, clear: Bool) -> Iterator[Surface]:
    """Boxes, spheres and the like, all of a kind at once, opaque and clear ones apart."""
    count = int(np.isin(model.geom_type[drawn], ROUND).sum())
    corners = next(corners for most, corners in CORNERS if count <= most)
    for (kind, sizes), is_clear in product(SIZES.items(), (False, True)):
        geoms = np.flatnonzero(drawn & (model.geom_type == kind) & (clear == is_clear))
        if not len(geoms):
            continue
        unit = _unit_of(kind, corners)
        local = unit.vertices * model.geom_size[geoms][:, None, sizes]
        if kind == CAPSULE:  # its halves lie apart
            local[..., 2] += np.sign(unit.vertices[:, 2]) * model.geom_size[geoms, 1, None]
        turns = data.geom_xmat[geoms].reshape(-1, 3, 3).transpose(0, 2, 1)
        placed = (local @ turns + data.geom_xpos[geoms][:, None]).reshape(-1, 3)
        first = (np.arange(len(geoms)) * len(unit.vertices))[:, None, None]
        owners = np.repeat(geoms, len(unit.vertices)).astype(np.int32)
        yield Surface(placed, (unit.faces + first).reshape(-1, 3), owners, is_round=kind in ROUND)


def _unit_of(kind: int, corners: int) -> Any:
    """The solid of size 1; the halves of a capsule lie on each other."""
    if kind == BOX:
        return creation.box((2, 2, 2))
    if kind == CYLINDER:  # its round side and its flat ends are shaded apart
        return graph.smooth_shade(creation.cylinder(1, 2, corners), SHARP, facet_minarea=None)
    if kind != CAPSULE:
        return creation.uv_sphere(count=[corners // 2, corners])
    unit = creation.capsule(2, 1, count=[corners // 2, corners])
    unit.vertices[:, 2] -= np.sign(unit.vertices[:, 2]) * (1 - 1e-9)  # the sign stays
    return unit


def _draw_others(scene: Scene, data: Any, drawn: Bool, textures: Int) -> Iterator[Surface]:
    """Meshes, height fields, and the exact parts of a mesh file."""
    model = scene.model
    coarse = dict[int, tuple[Any, Any]]()
    own = model.geom_dataid[drawn & (model.geom_type >= MESH) & (model.geom_dataid >= 0)]
    share = MOST_DRAWN / max(int(model.mesh_facenum[own].sum()), 1)
    for geom in np.flatnonzero(drawn).tolist():
        kind = int(model.geom_type[geom])
        number = int(model.geom_dataid[geom])
        uv = None
        if geom in scene.exact_meshes:  # in the world frame already
            part = scene.exact_meshes[geom]
            yield _piece(geom, np.asarray(part.vertices), np.asarray(part.faces))
            continue
        if kind == HFIELD:  # its upper side
            rows = int(model.hfield_nrow[number])
            cols = int(model.hfield_ncol[number])
            heights = model.hfield_data[int(model.hfield_adr[number]) :][: rows * cols]
            y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in (rows, cols)), indexing="ij")
            unit = np.stack([x.ravel(), y.ravel(), heights.astype(np.float64)], axis=1)
            vertices = unit * model.hfield_size[number, :3]
            corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
            faces = (corner[:, None] + np.array([0, 1, cols + 1, cols]))[:, QUAD].reshape(-1, 3)
        elif kind >= MESH and number >= 0:
            mesh = model.mesh(number)
            has_uv = int(textures[geom]) >= 0
            first = int(mesh.vertadr[0])
            start = int(mesh.faceadr[0])
            vertices = model.mesh_vert[first : first + int(mesh.vertnum[0])].astype(np.float64)
            end = start + int(mesh.facenum[0])
            faces = model.mesh_face[start:end]
            if has_uv and model.mesh_texcoordnum[number]:
                # corners that share a place needn't share one on the texture
                corners = model.mesh_facetexcoord[start:end].ravel() + mesh.texcoordadr[0]
                uv = model.mesh_texcoord[corners]
                vertices = vertices[faces.ravel()]
                faces = np.arange(len(vertices)).reshape(-1, 3)
            elif share < 1:
                if number not in coarse:
                    coarse[number] = coarsen(vertices, faces, int(share * len(faces)))
                vertices, faces = coarse[number]
        else:
            continue
        placed = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        piece = _piece(geom, placed, faces)
        yield piece if uv is None else piece._replace(uv=uv, texture=int(textures[geom]))


def coarsen(vertices: Float, faces: NDArray[Any], most: int) -> tuple[Float, NDArray[Any]]:
    """A mesh of about so many triangles, the coarsest one if there are more.

    Vertices in one cell of a lattice become one (Rossignac and Borrel 1993, vertex clustering).
    """
    unit = (vertices - vertices.min(axis=0)) / max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    for steps in (64, 48, 32, 24, 16, 12, 8, 6, 4):
        first, number = trimesh.grouping.unique_rows(np.round(unit * steps).astype(np.int64))
        made = trimesh.Trimesh(vertices[first], number[faces], process=False)
        made.update_faces(made.nondegenerate_faces() & made.unique_faces())
        if len(made.faces) <= most:
            break
    return made.vertices, made.faces


def _piece(geom: int, vertices: Float, faces: NDArray[Any]) -> Surface:
    return Surface(vertices, faces, np.full(len(vertices), geom, np.int32))


def _draw_plane(model: Any, data: Any, geom: int, bounds: Float) -> Surface:
    """A plane's rectangle; where it is endless, as far as what else there is, and some more."""
    rotation = data.geom_xmat[geom].reshape(3, 3)
    position = data.geom_xpos[geom]
    middle = ((bounds.mean(axis=0) - position) @ rotation)[:2]
    reach = ENDLESS * max(float(np.linalg.norm(bounds[1] - bounds[0])) / 2, 1.0)
    half = model.geom_size[geom, :2]
    middle = np.where(half <= 0, middle, 0.0)
    half = np.where(half <= 0, reach, half)
    corners = middle + half * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return _piece(geom, corners @ rotation[:, :2].T + position, QUAD)


def _bounds_of(pieces: Sequence[Surface]) -> Float:
    nothing = np.array([[-1.0, -1, -1], [1, 1, 1]])
    corners = np.concatenate([piece.vertices for piece in pieces]) if pieces else nothing
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def _find_looks(model: Any) -> tuple[NDArray[np.float32], NDArray[np.float32], Int]:
    """How geoms look, as MuJoCo's own viewers have it, by geom id.

    A geom without a colour of its own has its material's. Returns linear light, times the mean of
    the texture, and opacity, shape (n, 4); the same without the texture; and MuJoCo's id of a
    texture that a mesh may lie on, -1 for none.
    """
    rgba = np.array(model.geom_rgba, dtype=np.float32).reshape(-1, 4)
    material = np.array(model.geom_matid, dtype=np.int64)
    taken = (material >= 0) & (rgba == NO_COLOR).all(axis=1)
    texture = np.full(len(rgba), -1, dtype=np.int64)
    if model.nmat:
        rgba[taken] = model.mat_rgba[material[taken]]
        ids = np.asarray(model.mat_texid).reshape(model.nmat, -1)
        own = np.where(ids[:, RGB] >= 0, ids[:, RGB], ids[:, RGBA])
        texture = np.where(material >= 0, own[material], -1)
    textured = _to_linear(rgba)
    plain = textured.copy()
    for one in np.unique(texture[texture >= 0]).tolist():
        mean = _read_texture(model, one)[..., :3].mean(axis=(0, 1)) / 255
        plain[texture == one, :3] *= _to_linear(mean)
    flat = np.isin(texture, np.flatnonzero(np.asarray(model.tex_type) == FLAT_TEXTURE))
    return plain, textured, np.where(flat, texture, -1)


def _read_texture(model: Any, texture: int) -> NDArray[np.uint8]:
    """A texture's picture, shape (height, width, 3 or 4), its upper row first."""
    shape = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
    first = int(model.tex_adr[texture])
    count = int(np.prod(shape, dtype=np.int64))
    picture = np.asarray(model.tex_data[first : first + count]).reshape(shape)
    return np.repeat(picture, 3, axis=2) if shape[2] == 1 else picture


def _to_linear(color: NDArray[Any]) -> NDArray[np.float32]:
    """Linear light of colours as screens take them (sRGB), shape (..., 3 or 4); opacity stays."""
    color = np.asarray(color, dtype=np.float32)
    linear = to_linear(color)
    linear[..., 3:] = color[..., 3:]
    return linear.astype(np.float32)


# --- what of it is below a height -----------------------------------------------------------------


def cut_drawing(drawing: Drawing, height: float) -> tuple[Surface, ...]:
    """The surfaces below a height [m], world z.

    A triangle across the plane is replaced by its lower part. Cut boxes, cylinders and so on get
    a face there, darker than they are; meshes and height fields stay open.
    """
    kept: list[Surface] = []
    for surface in drawing.surfaces:
        if (surface.vertices[:, 2] <= height).all():
            kept.append(surface)
        else:
            parts = _cut_surface(surface, height), _close(surface, height, drawing.solid)
            kept += [part for part in parts if len(part.faces)]
    return tuple(kept)


def _cut_surface(surface: Surface, height: float) -> Surface:
    corners = surface.vertices[surface.faces]
    # slivers have no area, but places on them can't be told by their corners
    whole = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any(axis=1)
    faces = surface.faces[whole].astype(np.int64)
    vertices = surface.vertices.astype(np.float64)
    # geom, colour and place on the texture of a corner go along; geom and colour are a triangle's
    columns = surface.geom, surface.colors, surface.uv
    along = [column for column in columns if column is not None]
    vertices, faces, more = intersections.slice_faces_plane(
        vertices, faces, [0, 0, -1], [0, 0, height + FLUSH], uv=np.column_stack(along)
    )
    vertices[:, 2] = np.minimum(vertices[:, 2], height)
    more = more.astype(np.float32)
    return surface._replace(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.uint32),
        geom=np.rint(more[:, 0]).astype(np.int32),
        colors=more[:, 1:5],
        uv=None if surface.uv is None else more[:, 5:],
    )


def _close(surface: Surface, height: float, solid: Bool) -> Surface:
    """Faces over cut solids: each a fan round its middle, for a section of one is convex."""
    assert surface.geom is not None and surface.colors is not None
    chosen = surface.faces[solid[surface.owners]]
    mesh = trimesh.Trimesh(surface.vertices, chosen, process=False)
    lines, faces = intersections.mesh_plane(mesh, [0, 0, 1], [0, 0, height], return_faces=True)
    geoms, number = np.unique(surface.geom[chosen[faces, 0]], return_inverse=True)
    sums = [np.bincount(number, lines[:, :, axis].mean(axis=1)) for axis in range(3)]
    middle = (np.stack(sums) / np.bincount(number)).T[number]
    vertices = np.concatenate([lines, middle[:, None]], axis=1).reshape(-1, 3).astype(np.float32)
    shade = np.array([CAP_SHADE, CAP_SHADE, CAP_SHADE, 1], dtype=np.float32)
    return Surface(
        vertices,
        np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3),
        np.repeat(geoms[number], 3).astype(np.int32),
        np.repeat(surface.colors[chosen[faces, 0]] * shade, 3, axis=0),
    )


# --- the layers of levels, and what is sent -------------------------------------------------------


def lay_carpet(level: SceneGrid2D, *, with_holes: bool = True, most: int = MOST) -> Surface:
    """The floor of a level, on which its layers are laid: a rectangle where it is even.

    Without holes, cells without a floor lie at the level's ground. There are at most `most`
    rectangles, unless single cells are more.
    """
    floor = level.floor.astype(np.float64)
    size = level.lattice.cell_size
    shown = ~np.isnan(floor) if with_holes else np.ones(level.shape, np.bool_)
    heights = np.where(np.isnan(floor), level.ground, floor)
    cells = shown.astype(np.int32)
    flatness = FLAT
    span = float(np.ptp(heights))
    while True:
        _, row, col, z = cover_quads(cells, heights, flatness, STEEPEST * size, OVERLAP)
        if len(row) <= most or flatness > span:
            break
        flatness *= 2
    x = level.lattice.x_min + col * size
    y = level.lattice.y_max - row * size
    first = (np.arange(len(row)) * 4)[:, None, None]
    uv = np.stack([col / level.width, row / level.height], axis=-1).reshape(-1, 2)
    return Surface(
        np.stack([x, y, z + LIFT + flatness], axis=-1).reshape(-1, 3).astype(np.float32),
        (QUAD + first).reshape(-1, 3).astype(np.uint32),
        uv=uv.astype(np.float32),
        texture=0,
    )


def draw_overlay(carpet: Surface, rgb: NDArray[np.uint8], opacity: float = 1.0) -> bytes:
    """A layer of a level as GLB: a colour for each cell, shape (height, width, 3)."""
    picture = Image.fromarray(rgb)
    picture = picture.reduce(-(-max(picture.size) // MAX_SIDE))
    return make_glb([carpet._replace(opacity=opacity)], {0: np.asarray(picture)})


def draw_surfaces(
    surfaces: Sequence[Surface],
    textures: Mapping[int, NDArray[np.uint8]],
    rotation: ArrayLike | None = None,
) -> bytes:
    """Surfaces of a scene and the textures that they use as one GLB, with light and shade.

    The light, see `LIGHT`, is in the colours, which a browser draws smoothly without a graphics
    card, too; both sides of a triangle are alike. `rotation`, (3, 3), leads from the frame of the
    vertices to the world's axes.
    """
    turn = np.eye(3) if rotation is None else np.asarray(rotation)
    lit = []
    for one in surfaces:
        assert one.colors is not None
        if not one.is_round and len(one.faces) <= MOST_FLAT:  # edges are sharp
            corners = one.faces.ravel()
            one = one._replace(
                vertices=one.vertices[corners],
                faces=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
                colors=one.colors[corners],
                uv=None if one.uv is None else one.uv[corners],
            )
        mesh = trimesh.Trimesh(one.vertices, one.faces, process=False)
        share = (LIGHT[0] + np.abs(mesh.vertex_normals @ turn.T) @ LIGHT[1:])[:, None]
        colors = one.colors * np.where([True, True, True, False], share, 1.0)
        lit.append(one._replace(colors=colors))
    return make_glb(lit, textures)


def make_glb(
    surfaces: Sequence[Surface], pictures: Mapping[int, NDArray[np.uint8]] | None = None
) -> bytes:
    """Write triangles in their colours as they are, and the pictures that lie on them, as GLB."""
    buffer = GlbBuffer()
    primitives = list[Json]()
    materials = list[Json]()
    surfaces = [one for one in surfaces if len(one.faces)]
    used = sorted({one.texture for one in surfaces if one.uv is not None})
    for one in surfaces:
        is_clear = one.opacity < 1
        attributes = {"POSITION": buffer.add_positions(one.vertices)}
        if one.colors is not None:
            steps = np.round(np.clip(one.colors, 0, 1) * 65535).astype(np.uint16)
            attributes["COLOR_0"] = buffer.add_vectors(steps, normalized=True)
            is_clear |= bool((one.colors[:, 3] < 1).any())
        look: Json = {"baseColorFactor": [1.0, 1.0, 1.0, one.opacity]}
        if one.uv is not None:
            attributes["TEXCOORD_0"] = buffer.add_vectors(one.uv)
            look["baseColorTexture"] = {"index": used.index(one.texture)}
        material: Json = {"alphaMode": "BLEND" if is_clear else "OPAQUE", "doubleSided": True}
        material |= {"pbrMetallicRoughness": look, "extensions": {"KHR_materials_unlit": {}}}
        primitive = {"attributes": attributes, "indices": buffer.add_indices(one.faces)}
        primitives.append({**primitive, "material": len(materials)})
        materials.append(material)
    document: Json = {"extensionsUsed": ["KHR_materials_unlit"], "scenes": [{}]}
    if primitives:
        document |= {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
        document |= {"meshes": [{"primitives": primitives}], "materials": materials}
    document |= {"images": [], "textures": []}  # left out where they are empty
    for place, number in enumerate(used):
        content = io.BytesIO()  # packed fast rather than small: it stays on this machine
        Image.fromarray((pictures or {})[number]).save(content, "PNG", compress_level=1)
        view = buffer.add_bytes(content.getvalue())
        document["images"].append({"bufferView": view, "mimeType": "image/png"})
        document["textures"].append({"source": place, "sampler": 0})
        sampler = {"magFilter": NEAREST, "minFilter": MIPMAPS, "wrapS": CLAMP, "wrapT": CLAMP}
        document["samplers"] = [sampler]
    return buffer.pack(document)


# --- what a click meets ---------------------------------------------------------------------------


class Pick(NamedTuple):
    """What a click has met."""

    cell: Cell
    # world x, y of the click, and z of the cell's floor, or of the level's ground without one [m]
    position: tuple[float, float, float]
    geom: int | None  # that was clicked, None where it was the grid itself


def pick(
    grid: NavGrid,
    ray: tuple[ArrayLike, ArrayLike],
    surfaces: Sequence[Surface],
    levels: Collection[int],
) -> Pick | None:
    """Find the cell under a click, on one of the levels that are shown; None for none.

    The cell is the one below the nearest thing that the ray, an origin [m] and a direction, meets:
    a surface of a geom or of the grid, which come last. Of several levels it is the one whose
    floor is the nearest below; where none has a floor there, whose ground is.
    """
    origin, direction = (np.asarray(each, dtype=np.float64) for each in ray)
    distance = np.inf
    geom = -1
    for surface in surfaces:
        corners = surface.vertices[surface.faces].astype(np.float64)
        normals = trimesh.triangles.cross(corners)
        with np.errstate(divide="ignore", invalid="ignore"):  # a triangle that the ray runs along
            away = ((corners[:, 0] - origin) * normals).sum(axis=1) / (normals @ direction)
            places = origin + away[:, None] * direction
            shares = trimesh.triangles.points_to_barycentric(corners, places)
            met = np.flatnonzero((shares >= -1e-9).all(axis=1) & (away > 0) & (away <= distance))
        if len(met):
            nearest = met[np.argmin(away[met])]
            distance = float(away[nearest])
            geom = int(surface.owners[nearest])
    if not np.isfinite(distance):
        return None
    x, y, z = (origin + distance * direction).tolist()
    # by whether there is a floor, whether it is below, and how far
    ranked = []
    for number in sorted(levels):
        place = place_at(grid, (x, y), number)
        if place is not None:
            under = grid.levels[number].ground if place.floor is None else place.floor
            rank = place.floor is None, z - under < -BELOW, abs(z - under)
            ranked.append((rank, place.cell, under))
    if not ranked:
        return None
    _, cell, under = min(ranked)
    return Pick(cell, (x, y, under), None if geom < 0 else geom)
