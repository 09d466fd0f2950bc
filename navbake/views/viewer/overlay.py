"""Triangles for the browser: scene, layers of levels, and what of them a click meets.

They are sent as binary glTF (GLB). Source: Khronos Group, glTF 2.0 Specification, and its
extension ``KHR_materials_unlit``.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.formats.mesh_files import Buffer
from navbake.lazy import lazy
from navbake.navgrid.cells import Cell
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.types import Float, Json
from navbake.views.viewer.scene_mesh import Surface

Image = lazy("PIL.Image")  # which the command line's start does without
trimesh = lazy("trimesh")

LIFT = 0.012  # by which the grid lies over the floor, so that it is seen [m]
FLAT = 0.01  # how far a layer may be off the floor [m]
MOST = 200_000  # rectangles of a level; with more, FLAT is doubled until it is enough
STEEPEST = 1.0  # rise of a rectangle by its length
OVERLAP = 0.002  # of a cell, by which rectangles overlap: none shows through between them
MAX_SIDE = 4096  # pixels of a picture that any browser takes; of more cells, several are one
MOST_FLAT = 400_000  # triangles with sharp edges; of more, edges are smooth, which takes less
LIGHT = 0.2, 0.3, 0.16, 0.8  # from everywhere, and on what faces along x, y and z
BELOW = 0.05  # a floor so much over what was clicked is still under it [m]
NEAREST, MIPMAPS, CLAMP = 9728, 9987, 33071  # how pictures are sampled


class Carpet(NamedTuple):
    """The floor of a level, on which its layers are laid: a rectangle where it is even.

    Attributes:
        vertices: four of each rectangle, shape (4 n, 3), float32, world frame [m].
        faces: two triangles of each, shape (2 n, 3), uint32.
        uv: of each vertex on the level's picture, shape (4 n, 2), float32.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    uv: NDArray[np.float32]


def lay_carpet(level: SceneGrid2D, *, with_holes: bool = True, most: int = MOST) -> Carpet:
    """The floor of a level.

    Args:
        with_holes: draw nothing where there is no floor; else these cells lie at its ground.
        most: how many rectangles there may be, unless single cells are more.
    """
    from navbake.formats.kernels.planes import cover_planes  # numba loads slowly

    floor, size = level.floor.astype(np.float64), level.lattice.cell_size
    shown = ~np.isnan(floor) if with_holes else np.ones(level.shape, np.bool_)
    heights = np.where(np.isnan(floor), level.ground, floor)
    flatness, span = FLAT, float(np.ptp(heights))
    while True:
        labels = shown.astype(np.int32)
        bounds, planes = cover_planes(labels, heights, flatness, STEEPEST * size)
        if len(bounds) <= most or flatness > span:
            break
        flatness *= 2
    row0, col0, row1, col1 = bounds.T
    # counter-clockwise from above
    row = np.stack([row1, row1, row0, row0], axis=1) + np.array([1, 1, -1, -1]) * OVERLAP
    col = np.stack([col0, col1, col1, col0], axis=1) + np.array([-1, 1, 1, -1]) * OVERLAP
    down, right = row - row0[:, None] - 0.5, col - col0[:, None] - 0.5  # from the first centre
    z = planes[:, :1] + right * planes[:, 1:2] + down * planes[:, 2:] + LIFT + flatness
    x, y = level.lattice.x_min + col * size, level.lattice.y_max - row * size
    first = (np.arange(len(row)) * 4)[:, None, None]
    return Carpet(
        np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32),
        (np.array([[0, 1, 2], [0, 2, 3]]) + first).reshape(-1, 3).astype(np.uint32),
        np.stack([col / level.width, row / level.height], axis=-1)
        .reshape(-1, 2)
        .astype(np.float32),
    )


def draw_overlay(carpet: Carpet, rgb: NDArray[np.uint8], opacity: float = 1.0) -> bytes:
    """A layer of a level as GLB.

    Args:
        rgb: a colour for each cell, shape (height, width, 3).
        opacity: above 0, up to 1.
    """
    picture = Image.fromarray(rgb)
    picture = picture.reduce(-(-max(picture.size) // MAX_SIDE))
    part = Part(carpet.vertices, carpet.faces, uv=carpet.uv, picture=0, opacity=opacity)
    return make_glb([part], [write_png(np.asarray(picture))])


def draw_surfaces(surfaces: Sequence[Surface], textures: Mapping[int, NDArray[np.uint8]]) -> bytes:
    """Surfaces of a scene and the textures that they use as one GLB, with light and shade.

    The light comes from above, from the south-west and, weaker, from the south; both sides of a
    triangle are alike. It is in the colours, so that a browser has only these to draw, which it
    does smoothly without a graphics card, too.
    """
    used = sorted({one.texture for one in surfaces if one.uv is not None})
    parts = []
    for one in surfaces:
        if not one.is_round and len(one.faces) <= MOST_FLAT:  # edges are sharp
            corners = one.faces.ravel()
            one = one._replace(
                vertices=one.vertices[corners],
                faces=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
                colors=one.colors[corners],
                uv=None if one.uv is None else one.uv[corners],
            )
        mesh = trimesh.Trimesh(one.vertices, one.faces, process=False)
        share = LIGHT[0] + np.abs(mesh.vertex_normals) @ LIGHT[1:]
        colors = one.colors * np.stack([share, share, share, np.ones_like(share)], axis=1)
        picture = None if one.uv is None else used.index(one.texture)
        parts.append(Part(one.vertices, one.faces, colors, one.uv, picture))
    return make_glb(parts, [write_png(textures[number]) for number in used])


class Part(NamedTuple):
    """Triangles that are drawn alike, in their colours as they are.

    Attributes:
        vertices: shape (n, 3), world frame [m].
        faces: indices into `vertices`, shape (m, 3).
        colors: red, green, blue and opacity of each vertex, 0 to 1, linear light, shape (n, 4).
        uv: place of each vertex on a picture, from its upper left corner, shape (n, 2).
        picture: which of the pictures; None for none.
        opacity: of all of it; below 1, what is behind shines through.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    colors: NDArray[Any] | None = None
    uv: NDArray[np.float32] | None = None
    picture: int | None = None
    opacity: float = 1.0


def make_glb(parts: Sequence[Part], pictures: Sequence[bytes] = ()) -> bytes:
    """Write triangles, and the PNG files that lie on them, as one GLB."""
    buffer = Buffer()
    primitives: list[Json] = []
    materials: list[Json] = []
    for one in parts:
        if not len(one.faces):
            continue
        is_clear = one.opacity < 1
        attributes = {"POSITION": buffer.add_positions(one.vertices)}
        if one.colors is not None:
            steps = np.round(np.clip(one.colors, 0, 1) * 65535).astype(np.uint16)
            attributes["COLOR_0"] = buffer.add_vectors(steps, normalized=True)
            is_clear |= bool((one.colors[:, 3] < 1).any())
        if one.uv is not None:
            attributes["TEXCOORD_0"] = buffer.add_vectors(one.uv)
        look: Json = {"baseColorFactor": [1.0, 1.0, 1.0, one.opacity]}
        if one.picture is not None:
            look["baseColorTexture"] = {"index": one.picture}
        materials.append(
            {
                "pbrMetallicRoughness": look,
                "alphaMode": "BLEND" if is_clear else "OPAQUE",
                "doubleSided": True,
                "extensions": {"KHR_materials_unlit": {}},
            }
        )
        indices = buffer.add_indices(one.faces)
        material = len(materials) - 1
        primitives.append({"attributes": attributes, "indices": indices, "material": material})
    views = [buffer.add_bytes(picture) for picture in pictures]
    document: Json = {"extensionsUsed": ["KHR_materials_unlit"], "scenes": [{}]}
    if primitives:
        document |= {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
        document |= {"meshes": [{"primitives": primitives}], "materials": materials}
    if views:
        sampler = {"magFilter": NEAREST, "minFilter": MIPMAPS, "wrapS": CLAMP, "wrapT": CLAMP}
        document["images"] = [{"bufferView": view, "mimeType": "image/png"} for view in views]
        document["samplers"] = [sampler]
        document["textures"] = [{"source": number, "sampler": 0} for number in range(len(views))]
    return buffer.pack(document)


def write_png(pixels: NDArray[np.uint8]) -> bytes:
    """A picture as PNG, packed fast rather than small: it goes no farther than this machine."""
    content = io.BytesIO()
    Image.fromarray(pixels).save(content, "PNG", compress_level=1)
    return content.getvalue()


# --- what a click meets ---------------------------------------------------------------------------


class Pick(NamedTuple):
    """What a click has met.

    Attributes:
        cell: level, row and column.
        position: world x, y of the click, and z of the cell's floor, or of the level's ground
            where it has none [m].
        geom: id of the geom that was clicked, None where it was the grid itself.
    """

    cell: Cell
    position: tuple[float, float, float]
    geom: int | None


def pick(
    grid: NavGrid,
    ray: tuple[ArrayLike, ArrayLike],
    surfaces: Sequence[Surface],
    carpets: Sequence[Carpet],
    levels: Collection[int],
) -> Pick | None:
    """Find the cell under a click, on one of the levels that are shown; None for none.

    The cell is the one below the nearest thing, be it a geom or the grid. Of several levels it is
    the one whose floor is the nearest below; where none has a floor there, whose ground is.

    Args:
        ray: origin [m] and direction of the line of sight, world frame.
        surfaces: what is drawn of the scene.
        carpets: of all levels, and
        levels: which of them are shown.
    """
    origin, direction = (np.asarray(each, dtype=np.float64) for each in ray)
    distance, geom = np.inf, None
    for surface in surfaces:
        found, triangle = _meet(origin, direction, surface.vertices[surface.faces])
        if found < distance:
            distance, geom = found, int(surface.geom[surface.faces[triangle, 0]])
    for carpet in (carpets[number] for number in levels):
        found, _ = _meet(origin, direction, carpet.vertices[carpet.faces])
        if found <= distance:
            distance, geom = found, None
    if not np.isfinite(distance):
        return None
    place = origin + distance * direction
    # by whether there is a floor, whether it is below, and how far
    ranked = []
    for number in sorted(levels):
        cell, floor = floor_under(grid, number, place)
        if cell is not None:
            z = floor if np.isfinite(floor) else grid.levels[number].ground
            depth = float(place[2]) - z
            ranked.append(((not np.isfinite(floor), depth < -BELOW, abs(depth)), cell, z))
    if not ranked:
        return None
    _, cell, z = min(ranked)
    return Pick(cell, (float(place[0]), float(place[1]), z), geom)


def floor_under(grid: NavGrid, number: int, place: ArrayLike) -> tuple[Cell | None, float]:
    """The cell of a level at a place, None beside it, and its floor, NaN for none [m]."""
    level = grid.levels[number]
    row, col = (int(v) for v in level.lattice.rows_cols(place))
    if not (0 <= row < level.height and 0 <= col < level.width):
        return None, np.nan
    return Cell(number, row, col), float(level.floor_of(np.array(row), np.array(col)))


def _meet(origin: Float, direction: Float, corners: NDArray[np.float32]) -> tuple[float, int]:
    """How far the nearest of some triangles is on a ray, and which it is; infinite for none.

    Algorithm: Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997.
    """
    if not len(corners):
        return np.inf, -1
    first = corners[:, 0].astype(np.float64)
    along, across = corners[:, 1] - first, corners[:, 2] - first
    normal = np.cross(direction, across)
    volume = (along * normal).sum(axis=1)
    away = origin - first
    turned = np.cross(away, along)
    with np.errstate(divide="ignore", invalid="ignore"):  # a triangle that the ray runs along
        u = (away * normal).sum(axis=1) / volume
        v = turned @ direction / volume
        distance = (across * turned).sum(axis=1) / volume
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    distance = np.where(met, distance, np.inf)
    nearest = int(np.argmin(distance))
    return float(distance[nearest]), nearest


def mesh_of(surfaces: Sequence[Surface], geoms: Collection[int]) -> NDArray[np.float32]:
    """The triangles of some geoms, shape (n, 3, 3), world frame [m]."""
    chosen = np.array(sorted(geoms), dtype=np.int32)
    found = [s.vertices[s.faces[np.isin(s.geom[s.faces[:, 0]], chosen)]] for s in surfaces]
    return np.concatenate([np.empty((0, 3, 3), np.float32), *found])
