"""What the viewer draws of a MuJoCo scene: its geoms as triangles, merged by how they look."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.lazy import lazy
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:
    from navbake.baker.scene.scene import Scene

creation = lazy("trimesh.creation")  # a page without a scene does without
intersections = lazy("trimesh.intersections")
trimesh = lazy("trimesh")

Faces = NDArray[np.uint32]

SHOWN_GROUPS = 3  # MuJoCo's viewers show the geoms of the groups 0 to 2
ENDLESS = 1.5  # an endless plane is drawn so much larger than what stands on it
QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
# up to so many round geoms: corners of a circle, and rows of quads from a sphere's pole to its
# equator; a page without a graphics card draws some 100,000 triangles smoothly
DETAILS = ((100, 20, 5), (500, 12, 3))
COARSE = 8, 2
CAP_SHADE = 0.35  # light of a cut face, by that of its geom

# mjtGeom: numbers of the file format, the same in all versions
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(8)
ROUND = (SPHERE, CAPSULE, ELLIPSOID, CYLINDER)
RGB, RGBA = 1, 7  # mjtTextureRole: which textures of a material are its colour
FLAT_TEXTURE = 0  # mjtTexture: a picture, not the six sides of a cube
NO_COLOR = np.array([0.5, 0.5, 0.5, 1], dtype=np.float32)  # rgba of a geom that states none


class Surface(NamedTuple):
    """Triangles that are drawn alike.

    Attributes:
        vertices: shape (n, 3), float32, world frame [m].
        faces: shape (m, 3), uint32.
        geom: of each vertex, shape (n,), int32.
        colors: of each vertex, 0 to 1, linear light, shape (n, 4), float32.
        uv: of each vertex on the texture, shape (n, 2), float32; None without one.
        texture: MuJoCo's texture id, -1 for none.
        is_round: shaded as a round surface, else as flat triangles.
    """

    vertices: NDArray[np.float32]
    faces: Faces
    geom: NDArray[np.int32]
    colors: NDArray[np.float32]
    uv: NDArray[np.float32] | None = None
    texture: int = -1
    is_round: bool = False


class Drawing(NamedTuple):
    """A scene as triangles.

    Attributes:
        surfaces: what is drawn.
        textures: pictures by MuJoCo's texture id, shape (height, width, 3 or 4), uint8.
        bounds: lower and upper corner of all, world frame, shape (2, 3) [m].
        names: of each geom as grids name it, by geom id.
        solid: whether a geom is one convex piece, so that a cut through it can be closed.
        has_hidden: some geoms are drawn only with hidden ones.
    """

    surfaces: tuple[Surface, ...]
    textures: dict[int, NDArray[np.uint8]]
    bounds: Float
    names: tuple[str, ...]
    solid: Bool
    has_hidden: bool


class _Piece(NamedTuple):
    """Triangles of one geom or of several of a kind, before they are merged."""

    vertices: Float
    faces: NDArray[Any]
    geom: NDArray[np.int32]  # of each vertex
    uv: NDArray[np.float32] | None = None
    texture: int = -1
    is_round: bool = False


def draw_scene(
    scene: Scene, *, data: Any = None, removed: Collection[int] = (), with_hidden: bool = False
) -> Drawing:
    """Make triangles of a scene.

    Drawn is what MuJoCo's viewers draw: geoms of the groups 0 to 2 that aren't clear; all groups
    where these hold nothing. Textures of meshes are drawn; other geoms have the mean colour of
    theirs.

    Args:
        scene: a loaded scene.
        data: its mujoco.MjData in another pose.
        removed: ids of geoms that are left out.
        with_hidden: draw the other groups, too.
    """
    model, data = scene.model, scene.data if data is None else data
    looks = _find_looks(model)
    drawn = (looks.rgba[:, 3] > 0) & ~np.isin(np.arange(model.ngeom), list(removed))
    in_groups = drawn & (model.geom_group < SHOWN_GROUPS)
    has_hidden = bool(in_groups.any() and (drawn & ~in_groups).any())
    if has_hidden and not with_hidden:
        drawn = in_groups
    pieces = [*_draw_solids(model, data, drawn), *_draw_others(scene, data, looks, drawn)]
    bounds = _bounds_of(pieces)
    planes = np.flatnonzero(drawn & (model.geom_type == PLANE)).tolist()
    pieces += [_draw_plane(model, data, geom, bounds) for geom in planes]
    surfaces = _merge(pieces, looks)
    textures = {
        one.texture: _read_texture(model, one.texture) for one in surfaces if one.texture >= 0
    }
    solid = (model.geom_type >= SPHERE) & (model.geom_type <= BOX)
    names = tuple(_name_things(model))
    return Drawing(surfaces, textures, _bounds_of(pieces), names, solid, has_hidden)


def _draw_solids(model: Any, data: Any, drawn: Bool) -> Iterator[_Piece]:
    """Boxes, spheres and the like, all of a kind at once."""
    count = int(np.isin(model.geom_type[drawn], ROUND).sum())
    detail = next(((corners, rows) for most, corners, rows in DETAILS if count <= most), COARSE)
    for kind in (*ROUND, BOX):
        geoms = np.flatnonzero(drawn & (model.geom_type == kind)).astype(np.int32)
        if not len(geoms):
            continue
        unit, end = _unit_of(kind, *detail)
        sizes = model.geom_size[geoms].copy()
        halves = np.zeros(len(geoms))  # of a length along z, besides the size
        if kind in (SPHERE, CAPSULE):
            halves = sizes[:, 1] * (kind == CAPSULE)
            sizes[:] = sizes[:, :1]
        elif kind == CYLINDER:
            sizes = sizes[:, [0, 0, 1]]
        local = np.asarray(unit.vertices) * sizes[:, None]
        local[..., 2] += end * halves[:, None]
        turns = data.geom_xmat[geoms].reshape(-1, 3, 3).transpose(0, 2, 1)
        placed = local @ turns + data.geom_xpos[geoms][:, None]
        first = (np.arange(len(geoms)) * len(end))[:, None, None]
        faces = (np.asarray(unit.faces) + first).reshape(-1, 3)
        owners = np.repeat(geoms, len(end))
        yield _Piece(placed.reshape(-1, 3), faces, owners, is_round=kind in ROUND)


def _unit_of(kind: int, corners: int, rows: int) -> tuple[Any, Float]:
    """The solid of size 1, and where each vertex of a capsule goes along z: -1, 0 or 1."""
    if kind == BOX:
        box = creation.box((2, 2, 2))
        return box, np.zeros(len(box.vertices))
    if kind == CYLINDER:
        # edges twice, so that the round side and the flat ends are shaded apart
        line = np.array([[0, -1], [1, -1], [1, -1], [1, 1], [1, 1], [0, 1]], dtype=np.float64)
        end = np.zeros(len(line))
    else:
        lower = np.linspace(-np.pi / 2, 0, rows + 1)
        angle = np.concatenate([lower, -lower[::-1]])
        end = np.repeat([-1.0, 1.0], rows + 1) * (kind == CAPSULE)
        if kind != CAPSULE:
            angle, end = np.delete(angle, rows), np.delete(end, rows)
        line = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # a revolution leaves out triangles without area, so a capsule's side needs a length
    long = line + np.outer(end, [0, 1])
    unit = creation.revolve(long, sections=corners, process=False)
    ends = np.tile(end, corners)
    unit.vertices = np.asarray(unit.vertices) - np.outer(ends, [0, 0, 1])
    return unit, ends


def _draw_others(scene: Scene, data: Any, looks: _Looks, drawn: Bool) -> Iterator[_Piece]:
    """Meshes, height fields, and the exact parts of a mesh file."""
    model = scene.model
    for geom in np.flatnonzero(drawn).tolist():
        kind, uv, texture = int(model.geom_type[geom]), None, -1
        if geom in scene.parts:  # in the world frame already
            part = scene.parts[geom]
            yield _piece(geom, np.asarray(part.vertices), np.asarray(part.faces))
            continue
        if kind == HFIELD:
            vertices, faces = _hfield_triangles(model, int(model.geom_dataid[geom]))
        elif kind >= MESH and model.geom_dataid[geom] >= 0:
            texture = int(looks.texture[geom])
            mesh = int(model.geom_dataid[geom])
            vertices, faces, uv = _mesh_triangles(model, mesh, with_uv=texture >= 0)
        else:
            continue
        placed = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        piece = _piece(geom, placed, faces)
        yield piece if uv is None else piece._replace(uv=uv, texture=texture)


def _piece(geom: int, vertices: Float, faces: NDArray[Any]) -> _Piece:
    return _Piece(vertices, faces, np.full(len(vertices), geom, np.int32))


def _mesh_triangles(
    model: Any, mesh: int, *, with_uv: bool
) -> tuple[Float, NDArray[Any], NDArray[np.float32] | None]:
    """Vertices and faces of a mesh in its geom's frame, and where they lie on its texture."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    start, num = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = model.mesh_face[start : start + num]
    if not with_uv or model.mesh_texcoordnum[mesh] == 0:
        return vertices, faces, None
    # corners that share a place needn't share one on the texture
    corners = model.mesh_facetexcoord[start : start + num].ravel()
    uv = model.mesh_texcoord[int(model.mesh_texcoordadr[mesh]) + corners].astype(np.float32)
    return vertices[faces.ravel()], np.arange(3 * num).reshape(-1, 3), uv


def _hfield_triangles(model: Any, hfield: int) -> tuple[Float, NDArray[Any]]:
    """The upper side of a height field, in its geom's frame."""
    rows, cols = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
    first = int(model.hfield_adr[hfield])
    half_x, half_y, top = (float(v) for v in model.hfield_size[hfield, :3])
    z = model.hfield_data[first : first + rows * cols].astype(np.float64) * top
    x, y = np.meshgrid(np.linspace(-half_x, half_x, cols), np.linspace(-half_y, half_y, rows))
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + cols + 1, corner + cols], axis=1)
    return np.stack([x.ravel(), y.ravel(), z], axis=1), quads[:, QUAD].reshape(-1, 3)


def _draw_plane(model: Any, data: Any, geom: int, bounds: Float) -> _Piece:
    """A plane's rectangle; where it is endless, as far as what else there is, and some more."""
    rotation, position = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    middle = ((bounds.mean(axis=0) - position) @ rotation)[:2]
    reach = ENDLESS * max(float(np.linalg.norm(bounds[1] - bounds[0])) / 2, 1.0)
    half = model.geom_size[geom, :2]
    is_endless = half <= 0
    middle, half = np.where(is_endless, middle, 0.0), np.where(is_endless, reach, half)
    corners = np.zeros((4, 3))
    corners[:, :2] = middle + half * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return _piece(geom, corners @ rotation.T + position, QUAD)


def _bounds_of(pieces: Sequence[_Piece]) -> Float:
    pieces = [piece for piece in pieces if len(piece.vertices)]
    if not pieces:
        return np.array([[-1.0, -1, -1], [1, 1, 1]])
    low = np.min([piece.vertices.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.vertices.max(axis=0) for piece in pieces], axis=0)
    return np.stack([low, high])


def _merge(pieces: Sequence[_Piece], looks: _Looks) -> tuple[Surface, ...]:
    """Join pieces that are drawn alike: opaque or clear, round or flat, by their texture."""
    alike: dict[tuple[bool, bool, int], list[_Piece]] = {}
    for piece in pieces:
        clear = looks.rgba[piece.geom[piece.faces[:, 0]], 3] < 1
        for is_clear in (False, True):
            kept = piece._replace(faces=piece.faces[clear == is_clear])
            if len(kept.faces):
                alike.setdefault((is_clear, piece.is_round, piece.texture), []).append(kept)
    surfaces = []
    for (_, is_round, texture), some in sorted(alike.items(), key=lambda one: one[0]):
        start = np.cumsum([0, *(len(piece.vertices) for piece in some)])
        faces = np.concatenate([p.faces + n for p, n in zip(some, start, strict=False)])
        vertices = np.concatenate([piece.vertices for piece in some])
        owner = np.concatenate([piece.geom for piece in some])
        uv = None if texture < 0 else np.concatenate([p.uv for p in some if p.uv is not None])
        used, faces = np.unique(faces, return_inverse=True)  # a clear geom's aren't an opaque one's
        owner = owner[used]
        surfaces.append(
            Surface(
                vertices[used].astype(np.float32),
                faces.reshape(-1, 3).astype(np.uint32),
                owner,
                (looks.plain if uv is None else looks.textured)[owner],
                None if uv is None else uv[used],
                texture,
                is_round,
            )
        )
    return tuple(surfaces)


def _name_things(model: Any) -> list[str]:
    """What grids call each geom: its topmost body, or itself where it hangs on the world."""
    text = bytes(model.names)

    def name(address: int, other: str) -> str:
        return text[address : text.index(b"\0", address)].decode(errors="replace") or other

    roots = model.body_rootid[model.geom_bodyid].tolist()
    addresses = model.name_bodyadr
    bodies = {root: name(int(addresses[root]), f"body {root}") for root in set(roots)}
    return [
        bodies[root] if root else name(address, f"geom {geom}")
        for geom, (root, address) in enumerate(zip(roots, model.name_geomadr.tolist(), strict=True))
    ]


# --- colours and textures, as MuJoCo's own viewers have them ----------------------------------


class _Looks(NamedTuple):
    """How geoms look, by geom id.

    Attributes:
        rgba: as MuJoCo has it, 0 to 1, shape (n, 4).
        plain: the same as linear light, times the mean of the texture, if there is one.
        textured: as linear light, for triangles that lie on their texture.
        texture: MuJoCo's id of a texture that meshes with coordinates lie on, -1 for none.
    """

    rgba: NDArray[np.float32]
    plain: NDArray[np.float32]
    textured: NDArray[np.float32]
    texture: Int


def _find_looks(model: Any) -> _Looks:
    """A geom with a material has the material's colour, unless it states one of its own."""
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
        mean = _read_texture(model, one)[..., :3].reshape(-1, 3).mean(axis=0) / 255
        plain[texture == one, :3] *= _to_linear(mean)
    flat = np.isin(texture, np.flatnonzero(np.asarray(model.tex_type) == FLAT_TEXTURE))
    return _Looks(rgba, plain, textured, np.where(flat, texture, -1))


def _read_texture(model: Any, texture: int) -> NDArray[np.uint8]:
    """A texture's picture, shape (height, width, 3 or 4), its upper row first."""
    shape = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
    first, count = int(model.tex_adr[texture]), int(np.prod(shape, dtype=np.int64))
    picture = np.asarray(model.tex_data[first : first + count]).reshape(shape)
    return np.repeat(picture, 3, axis=2) if shape[2] == 1 else picture


def _to_linear(color: NDArray[Any]) -> NDArray[np.float32]:
    """Linear light of colours as screens take them (sRGB), shape (..., 3 or 4); opacity stays."""
    color = np.asarray(color, dtype=np.float32)
    linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    linear[..., 3:] = color[..., 3:]
    return linear.astype(np.float32)


# --- what of it is below a height -----------------------------------------------------------------


# A triangle that lies in the plane stays: trimesh would drop it [m]
FLUSH = 1e-6


def cut_drawing(drawing: Drawing, height: float) -> tuple[Surface, ...]:
    """The surfaces below a height [m], world z.

    A triangle across the plane is replaced by its lower part. Cut boxes, cylinders and so on get
    a face there, darker than they are; meshes and height fields stay open.
    """
    kept: list[Surface] = []
    for surface in drawing.surfaces:
        z = surface.vertices[:, 2]
        if not len(z) or float(z.max()) <= height:
            kept.append(surface)
            continue
        below = _cut_surface(surface, height)
        kept += [one for one in (below, _close(surface, height, drawing.solid)) if len(one.faces)]
    return tuple(kept)


def _cut_surface(surface: Surface, height: float) -> Surface:
    corners = surface.vertices[surface.faces]
    # slivers have no area, but places on them can't be told by their corners
    whole = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any(axis=1)
    faces, vertices = surface.faces[whole].astype(np.int64), surface.vertices.astype(np.float64)
    plane = [0, 0, -1], [0, 0, height + FLUSH]
    # the corners of a triangle are of one geom: so is what lies between them
    geoms = np.stack([surface.geom, surface.geom], axis=1).astype(np.float64)
    cut, left, owner = intersections.slice_faces_plane(vertices, faces, *plane, uv=geoms)
    cut[:, 2] = np.minimum(cut[:, 2], height)
    geom, uv = np.rint(owner[:, 0]).astype(np.int32), surface.uv
    if uv is not None:
        _, _, uv = intersections.slice_faces_plane(vertices, faces, *plane, uv=uv)
    color_of = np.zeros((int(surface.geom.max()) + 1, 4), np.float32)
    color_of[surface.geom] = surface.colors
    return surface._replace(
        vertices=cut.astype(np.float32),
        faces=left.astype(np.uint32),
        geom=geom,
        colors=color_of[geom],
        uv=None if uv is None else uv.astype(np.float32),
    )


def _close(surface: Surface, height: float, solid: Bool) -> Surface:
    """Faces over cut solids: each a fan round its middle, for a section of one is convex."""
    owner = surface.geom[surface.faces[:, 0]]
    chosen = surface.faces[solid[owner]]
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
