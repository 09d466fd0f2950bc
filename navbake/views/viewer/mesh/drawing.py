"""What the viewer draws of a MuJoCo scene: its geoms as triangles, merged by how they look."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Float
from navbake.views.viewer.mesh.materials import Look, find_looks, read_texture
from navbake.views.viewer.mesh.primitives import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    HFIELD,
    MESH,
    PLANE,
    ROUND,
    SPHERE,
    choose_detail,
    shape_of,
)

if TYPE_CHECKING:
    from navbake.baker.scene.scene import Scene

SHOWN_GROUPS = 3  # MuJoCo's viewers show the geoms of the groups 0 to 2
ENDLESS = 1.5  # an endless plane is drawn so much larger than what stands on it
QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


class Surface(NamedTuple):
    """Triangles that are drawn alike.

    Attributes:
        vertices: shape (n, 3), float32, world frame [m].
        faces: shape (m, 3), uint32.
        geom: of each triangle, shape (m,), int32.
        colors: of each vertex, 0 to 1, linear light, shape (n, 4), float32.
        uv: of each vertex on the texture, shape (n, 2), float32; None without one.
        texture: MuJoCo's texture id, -1 for none.
        is_round: shaded as a round surface, else as flat triangles.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
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
    solid: NDArray[np.bool_]
    has_hidden: bool


class _Piece(NamedTuple):
    """Triangles of one geom or of several of a kind, before they are merged."""

    vertices: Float
    faces: NDArray[np.uint32]
    vertex_geom: NDArray[np.int32]
    face_geom: NDArray[np.int32]
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
    looks = find_looks(model)
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
        one.texture: read_texture(model, one.texture) for one in surfaces if one.texture >= 0
    }
    solid = (model.geom_type >= SPHERE) & (model.geom_type <= BOX)
    names = tuple(name_things(model))
    return Drawing(surfaces, textures, _bounds_of(pieces), names, solid, has_hidden)


def _draw_solids(model: Any, data: Any, drawn: NDArray[np.bool_]) -> list[_Piece]:
    """Boxes, spheres and the like, all of a kind at once."""
    pieces = []
    detail = choose_detail(int(np.isin(model.geom_type[drawn], ROUND).sum()))
    for kind in (SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX):
        geoms = np.flatnonzero(drawn & (model.geom_type == kind)).astype(np.int32)
        if not len(geoms):
            continue
        shape, sizes, halves = shape_of(kind, model.geom_size[geoms], detail)
        rotations = data.geom_xmat[geoms].reshape(-1, 3, 3)
        vertices = shape.place(sizes, halves, rotations, data.geom_xpos[geoms])
        count = len(shape.unit)
        first = (np.arange(len(geoms), dtype=np.uint32) * np.uint32(count))[:, None, None]
        faces = (shape.faces[None] + first).reshape(-1, 3)
        owners = np.repeat(geoms, count), np.repeat(geoms, len(shape.faces))
        pieces.append(_Piece(vertices.reshape(-1, 3), faces, *owners, is_round=kind in ROUND))
    return pieces


def _draw_others(scene: Scene, data: Any, looks: Look, drawn: NDArray[np.bool_]) -> list[_Piece]:
    """Meshes, height fields, and the exact parts of a mesh file."""
    model, pieces = scene.model, []
    for geom in np.flatnonzero(drawn).tolist():
        kind = int(model.geom_type[geom])
        if geom in scene.parts:  # in the world frame already
            part = scene.parts[geom]
            pieces.append(_piece(geom, np.asarray(part.vertices), np.asarray(part.faces)))
            continue
        if kind == HFIELD:
            vertices, faces = _hfield_triangles(model, int(model.geom_dataid[geom]))
            uv = None
        elif kind >= MESH and model.geom_dataid[geom] >= 0:
            textured = looks.texture[geom] >= 0
            vertices, faces, uv = _mesh_triangles(model, int(model.geom_dataid[geom]), textured)
        else:
            continue
        placed = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        piece = _piece(geom, placed, faces)
        if uv is not None:
            piece = piece._replace(uv=uv, texture=int(looks.texture[geom]))
        pieces.append(piece)
    return pieces


def _piece(geom: int, vertices: Float, faces: NDArray[Any]) -> _Piece:
    of_vertices, of_faces = (np.full(len(of), geom, np.int32) for of in (vertices, faces))
    return _Piece(vertices, faces.astype(np.uint32), of_vertices, of_faces)


def _mesh_triangles(
    model: Any, mesh: int, with_uv: bool
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
    rotation = data.geom_xmat[geom].reshape(3, 3)
    position = data.geom_xpos[geom]
    middle = (bounds.mean(axis=0) - position) @ rotation
    reach = ENDLESS * max(float(np.linalg.norm(bounds[1] - bounds[0])) / 2, 1.0)
    sides = []
    for axis in range(2):
        half = float(model.geom_size[geom, axis])
        centre, half = (0.0, half) if half > 0 else (float(middle[axis]), reach)
        sides.append((centre - half, centre + half))
    (x0, x1), (y0, y1) = sides
    corners = np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)], dtype=np.float64)
    return _piece(geom, corners @ rotation.T + position, QUAD)


def _bounds_of(pieces: Sequence[_Piece]) -> Float:
    pieces = [piece for piece in pieces if len(piece.vertices)]
    if not pieces:
        return np.array([[-1.0, -1, -1], [1, 1, 1]])
    low = np.min([piece.vertices.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.vertices.max(axis=0) for piece in pieces], axis=0)
    return np.stack([low, high])


def _merge(pieces: Sequence[_Piece], looks: Look) -> tuple[Surface, ...]:
    """Join pieces that are drawn alike: opaque or clear, round or flat, by their texture."""
    alike: dict[tuple[bool, bool, int], list[_Piece]] = {}
    for piece in pieces:
        clear = looks.rgba[piece.face_geom, 3] < 1
        for is_clear in (False, True):
            chosen = clear == is_clear
            if chosen.any():
                kept = piece if chosen.all() else _cut(piece, chosen)
                alike.setdefault((is_clear, piece.is_round, piece.texture), []).append(kept)
    return tuple(_join(some, looks) for _, some in sorted(alike.items(), key=lambda one: one[0]))


def _cut(piece: _Piece, chosen: NDArray[np.bool_]) -> _Piece:
    """Some of a piece's triangles, and the vertices that they use."""
    used, faces = np.unique(piece.faces[chosen], return_inverse=True)
    return piece._replace(
        vertices=piece.vertices[used],
        faces=faces.reshape(-1, 3).astype(np.uint32),
        vertex_geom=piece.vertex_geom[used],
        face_geom=piece.face_geom[chosen],
        uv=None if piece.uv is None else piece.uv[used],
    )


def _join(pieces: Sequence[_Piece], looks: Look) -> Surface:
    start = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    faces = [p.faces + np.uint32(first) for p, first in zip(pieces, start[:-1], strict=True)]
    owner = np.concatenate([piece.vertex_geom for piece in pieces])
    first = pieces[0]
    has_uv = first.uv is not None
    colors = looks.textured[owner] if has_uv else looks.plain[owner]
    return Surface(
        np.concatenate([piece.vertices for piece in pieces]).astype(np.float32),
        np.concatenate(faces),
        np.concatenate([piece.face_geom for piece in pieces]),
        colors,
        np.concatenate([p.uv for p in pieces if p.uv is not None]) if has_uv else None,
        first.texture,
        first.is_round,
    )


def name_things(model: Any) -> list[str]:
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
