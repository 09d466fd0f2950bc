"""The geoms that count, as FCL and MuJoCo hold them: what a verification judges by.

The shapes come from the compiled MuJoCo model and the choice of geoms alone. A MuJoCo model of
their own makes them what the bake counts: a mesh that counts by its hull is its hull, also for
rays, and transparent geoms are hit like others.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any, NamedTuple

import fcl
import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import QhullError

from navbake.baker.scene.scene import Scene
from navbake.errors import SceneError
from navbake.lazy import lazy
from navbake.types import Bool, Float, Int, Json

trimesh = lazy("trimesh")

GEOM = mujoco.mjtGeom
# What an obstacle is: convex solid or hull, endless plane, or height field; or a part of a mesh: a
# sheet that encloses nothing, a closed part that faces out or in, or one that may enclose something
CONVEX = "convex"
HALF_SPACE = "half-space"
HEIGHT_FIELD = "height field"
SHEET = "sheet"
SOLID = "solid"
CAVITY = "cavity"
UNCLEAR = "unclear"
ENCLOSING = (HEIGHT_FIELD, SOLID, CAVITY)  # their surface alone doesn't show what is inside
MOST_OPEN = 0.05  # share of open edges up to which a part may be a closed one with a flaw
THINNEST = 1e-6  # volume by area of what is a sheet with two sides [m]
FAR = 1e4  # half-size that stands for the infinite side of a plane with a finite one [m]
UPRIGHT = 1e-9  # least z of a unit normal, up or down, of what a vertical line can cross


SOLIDS: dict[int, tuple[Callable[[Float], Any], Callable[[Float, Float], Any]]] = {
    GEOM.mjGEOM_SPHERE: (lambda s: fcl.Sphere(s[0]), lambda s, way: s[0]),
    GEOM.mjGEOM_CAPSULE: (
        lambda s: fcl.Capsule(s[0], 2 * s[1]),
        lambda s, way: s[0] + s[1] * abs(way[2]),
    ),
    GEOM.mjGEOM_ELLIPSOID: (lambda s: fcl.Ellipsoid(*s), lambda s, way: np.linalg.norm(s * way)),
    GEOM.mjGEOM_CYLINDER: (
        lambda s: fcl.Cylinder(s[0], 2 * s[1]),
        lambda s, way: s[0] * np.hypot(way[0], way[1]) + s[1] * abs(way[2]),
    ),
    GEOM.mjGEOM_BOX: (lambda s: fcl.Box(*(2 * s)), lambda s, way: (s * np.abs(way)).sum()),
}
"""FCL's shape of a solid by its size; how far it reaches along a unit vector of its frame [m]."""


class PlacedPiece(NamedTuple):
    """One convex solid, plane, height field, or part of a mesh, where it stands."""

    geom: int
    kind: str
    shape: Any  # FCL's, in its place
    low: Float  # corners of its box [m]
    high: Float
    points: Float | None  # corners of a hull

    @property
    def same_in_mujoco(self) -> bool:
        """Whether MuJoCo collides the same shape: not surfaces, nor finite planes."""
        return self.kind in (CONVEX, HALF_SPACE)


class _Piece(NamedTuple):
    """What an obstacle is made of, in its geom's frame."""

    kind: str
    shape: Any
    geom: Json
    points: Float | None = None
    triangles: Int | None = None


class Obstacles:
    """The geoms that count, but for some, in a pose that doors may change.

    They are numbered as the geoms of a MuJoCo model. Behind them it has a box and a cylinder to
    probe with, and the geoms of `facing`: the triangles of a surface that face up, and those that
    face down, because where two lie in one place, a ray meets one. `names` are the scene's geoms'.
    """

    def __init__(self, scene: Scene, data: Any, left_out: Collection[int] = ()) -> None:
        self._scene = scene
        self._spec = mujoco.MjSpec()
        self.items: list[PlacedPiece] = []
        self._heights: list[Float] = []  # of height fields
        self._meshes: dict[tuple[int, str], list[_Piece]] = {}
        self._halves: dict[tuple[int, bytes], list[str]] = {}
        self._facing: dict[int, list[Json]] = {}
        for geom, choice in enumerate(scene.selections):
            if not choice.counted or geom in left_out:
                continue
            mat = data.geom_xmat[geom].reshape(3, 3).copy()
            pos = data.geom_xpos[geom]
            if geom in scene.exact_meshes:  # in the world's frame
                mat = np.eye(3)
                pos = np.zeros(3)
            for piece in self._pieces_of(geom, choice.mesh_mode):
                self._put(geom, piece, mat, pos)
        self.names = [report.name for report in scene.geoms]
        boxes = np.array([(item.low, item.high) for item in self.items]).reshape(-1, 2, 3)
        self._low, self._high = np.ascontiguousarray(boxes.transpose(1, 2, 0))
        world = self._spec.worldbody
        world.add_geom(type=GEOM.mjGEOM_BOX, size=[0.1, 0.1, 0.1])
        world.add_geom(type=GEOM.mjGEOM_CYLINDER, size=[0.1, 0.1, 0.0])
        count = len(self.items) + 2
        self.facing = dict[int, list[int]]()
        for number, halves in self._facing.items():
            self.facing[number] = list(range(count, count + len(halves)))
            count += len(halves)
            for half in halves:
                world.add_geom(**half)
        try:
            self.model = model = self._spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            text = " ".join(str(error).split())[:300]
            raise SceneError(f"MuJoCo can't hold the shapes that count: {text}") from error
        for number, heights in enumerate(self._heights):
            first = int(model.hfield_adr[number])  # compiling stretched them to 0 to 1
            model.hfield_data[first : first + heights.size] = heights.ravel()
        self.data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)
        # MuJoCo makes these arrays anew whenever they are asked for
        self.size = model.geom_size
        self.pos = self.data.geom_xpos
        self.mat = self.data.geom_xmat

    def name(self, number: int) -> str:
        """The name of the geom that an obstacle belongs to."""
        return self.names[self.items[number].geom]

    def meeting(self, low: ArrayLike, high: ArrayLike) -> list[int]:
        """The obstacles whose boxes meet a box, ascending."""
        meets = (self._low <= np.reshape(high, (3, 1))) & (self._high >= np.reshape(low, (3, 1)))
        found: list[int] = np.flatnonzero(meets.all(axis=0)).tolist()
        return found

    def support(self, number: int, way: Float) -> float:
        """How far a convex obstacle or a half-space reaches along a unit vector [m]; may be inf."""
        item = self.items[number]
        if item.points is not None:
            return float((item.points @ way).max())
        pos = self.pos[number]
        mat = self.mat[number].reshape(3, 3)
        if item.kind == HALF_SPACE:
            return float(pos @ way) if way @ mat[:, 2] > 1 - 1e-12 else np.inf
        kind = int(self.model.geom_type[number])
        return float(pos @ way + SOLIDS[kind][1](self.size[number], mat.T @ way))

    def _pieces_of(self, geom: int, mode: str) -> list[_Piece]:
        """What a geom of the scene is made of; a mesh may have several parts."""
        model = self._scene.model
        part = self._scene.exact_meshes.get(geom)
        kind = int(model.geom_type[geom])
        size = model.geom_size[geom].copy()
        if part is not None:
            return self._mesh(part.vertices, part.faces.astype(np.int64), part.vertices, mode)
        if kind in (GEOM.mjGEOM_MESH, GEOM.mjGEOM_SDF):
            key = int(model.geom_dataid[geom]), mode
            if key not in self._meshes:
                self._meshes[key] = self._mesh(*_mesh_arrays(model, key[0]), mode)
            return self._meshes[key]
        if kind == GEOM.mjGEOM_HFIELD:
            return [self._height_field(int(model.geom_dataid[geom]))]
        if kind != GEOM.mjGEOM_PLANE:
            return [_Piece(CONVEX, SOLIDS[kind][0](size), {"type": kind, "size": size})]
        if (size[:2] <= 0).all():
            shape = fcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
            return [_Piece(HALF_SPACE, shape, {"type": kind, "size": [0, 0, 1]})]
        x, y = np.where(size[:2] > 0, size[:2], FAR)
        corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        surface = _surface(corners, np.array([[0, 1, 2], [0, 2, 3]]))
        return [_Piece(SHEET, surface, {"type": kind, "size": [*size[:2], 1.0]}, corners)]

    def _put(self, geom: int, piece: _Piece, mat: Float, pos: Float) -> None:
        """Place a piece, and in MuJoCo's model what stands for it."""
        placed = fcl.CollisionObject(piece.shape, fcl.Transform(mat, pos))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, mat.ravel())
        place = {"pos": pos, "quat": quat}
        self._spec.worldbody.add_geom(**place, **piece.geom)
        points = None if piece.points is None else piece.points @ mat.T + pos
        if points is not None:
            low = points.min(axis=0)
            high = points.max(axis=0)
        elif piece.kind == HALF_SPACE:
            low = np.full(3, -np.inf)
            high = np.full(3, np.inf)
            if mat[2, 2] > 1 - 1e-12:  # nothing over a level one needs to be asked about
                high[2] = pos[2]
        else:
            reach = SOLIDS[piece.geom["type"]][1]
            size = piece.geom["size"]
            half = np.array([reach(size, axis) for axis in mat])
            low = pos - half
            high = pos + half
        if piece.triangles is not None and piece.points is not None:
            # meshes of what faces up of it, and of what faces down
            key = id(piece.shape), mat[2].tobytes()
            if key not in self._halves:
                a, b, c = (piece.points[piece.triangles[:, k]] for k in range(3))
                normal = np.cross(b - a, c - a)
                rise = normal @ mat[2]
                least = UPRIGHT * np.linalg.norm(normal, axis=1)
                halves = [piece.triangles[rise > least], piece.triangles[rise < -least]]
                meshes = [_used(piece.points, half) for half in halves if len(half)]
                self._halves[key] = [self._name_mesh(*mesh) for mesh in meshes]
            common = place | {"type": GEOM.mjGEOM_MESH, "contype": 0, "conaffinity": 0}  # no hulls
            named = self._halves[key]
            self._facing[len(self.items)] = [common | {"meshname": half} for half in named]
        hull = points if piece.kind == CONVEX else None
        self.items.append(PlacedPiece(geom, piece.kind, placed, low, high, hull))

    def _mesh(self, vertices: Float, faces: Int, on_hull: Float, mode: str) -> list[_Piece]:
        if mode == "hull":
            with suppress(QhullError, ValueError):  # a flat one has none
                hull = trimesh.convex.convex_hull(on_hull)
                points = np.array(hull.vertices)
                triangles = np.array(hull.faces, dtype=np.int64)
                counted = np.insert(triangles, 0, 3, axis=1).ravel()
                name = self._name_mesh(points, triangles)
                geom = {"type": GEOM.mjGEOM_MESH, "meshname": name}
                return [_Piece(CONVEX, fcl.Convex(points, len(triangles), counted), geom, points)]
        # rays meet its halves; what stands for it in the numbering is never asked
        stand_in: Json = {"type": GEOM.mjGEOM_SPHERE, "size": [1e-3, 0, 0]}
        pieces = []
        for kind, own in [(SHEET, faces)] if mode == "shell" else split_parts(vertices, faces):
            points, triangles = _used(vertices, own)
            pieces.append(_Piece(kind, _surface(points, triangles), stand_in, points, triangles))
        return pieces

    def _height_field(self, number: int) -> _Piece:
        model = self._scene.model
        rows = int(model.hfield_nrow[number])
        cols = int(model.hfield_ncol[number])
        first = int(model.hfield_adr[number])
        size = model.hfield_size[number]
        heights = model.hfield_data[first : first + rows * cols].reshape(rows, cols).copy()
        name = f"field {len(self._heights)}"
        self._heights.append(heights)
        self._spec.add_hfield(name=name, nrow=rows, ncol=cols, size=size, userdata=heights.ravel())
        geom: Json = {"type": GEOM.mjGEOM_HFIELD, "hfieldname": name}
        # its closed surface; squares are halved as MuJoCo's documentation says
        x = np.linspace(-size[0], size[0], cols)
        y = np.linspace(-size[1], size[1], rows)
        x, y = np.meshgrid(x, y)
        top = heights.astype(np.float64) * size[2]
        bottom = np.full_like(x, -size[3])
        points = np.concatenate([np.stack([x, y, z], axis=-1) for z in (top, bottom)])
        points = points.reshape(-1, 3)
        index = np.arange(rows * cols).reshape(rows, cols)
        under = rows * cols
        squares = np.stack(
            [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1
        ).reshape(-1, 4)
        rim = np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2::-1, 0]])
        p = rim[:-1]
        q = rim[1:]
        sides = np.stack([p + under, q + under, q, p], axis=-1)
        quads = np.concatenate([squares, squares[:, ::-1] + under, sides])
        surface = _surface(points, trimesh.geometry.triangulate_quads(quads))
        return _Piece(HEIGHT_FIELD, surface, geom, points)

    def _name_mesh(self, points: Float, triangles: Int) -> str:
        """Add a mesh to MuJoCo's model, and return its name."""
        if len(points) < 4:  # MuJoCo takes no fewer
            points = np.concatenate([points, points.mean(axis=0, keepdims=True)])
        name = f"mesh {len(self._spec.meshes)}"
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        points = points.ravel()
        triangles = triangles.ravel()
        self._spec.add_mesh(name=name, uservert=points, userface=triangles, inertia=shell)
        return name


def _surface(vertices: Float, faces: Int) -> Any:
    shape = fcl.BVHModel()
    shape.beginModel(len(vertices), len(faces))
    shape.addSubModel(np.ascontiguousarray(vertices, dtype=np.float64), faces)
    shape.endModel()
    return shape


def _find_turned(vertices: Float, faces: Int, edge: Int, way: Int, part: Int) -> Bool:
    """The triangles that are wound against most of the area of their parts.

    Edge and direction are those of each corner. In a graph that has each triangle twice, as it is
    and turned, neighbours over an edge of two triangles are joined where they wind alike.
    """
    order = np.argsort(edge, kind="stable")
    pair = np.stack([order[:-1], order[1:]])[:, np.diff(edge[order]) == 0]
    pair = pair[:, np.bincount(edge)[edge[pair[0]]] == 2]
    one, other, count = *pair // 3, len(faces)
    other = other + count * (way[pair[0]] == way[pair[1]])
    ends = np.concatenate([[one, other], [one + count, (other + count) % (2 * count)]], axis=1)
    graph = coo_array((np.ones(ends.shape[1], np.int8), tuple(ends)), (2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    first = label[np.unique(part, return_index=True)[1]][part]
    differs = label[:count] != first
    turned = np.bincount(part, np.where(differs, area, -area)) > 0
    return np.asarray(differs != turned[part])


def _used(vertices: Float, faces: Int) -> tuple[Float, Int]:
    """The vertices that faces use, and the faces by these."""
    used, corners = np.unique(faces, return_inverse=True)
    return vertices[used], corners.reshape(-1, 3)


def _mesh_arrays(model: Any, number: int) -> tuple[Float, Int, Float]:
    """Vertices and faces of a mesh, and the vertices of MuJoCo's hull of it, geom's frame."""
    mesh = model.mesh(number)
    vert = int(mesh.vertadr[0])
    face = int(mesh.faceadr[0])
    address = int(mesh.graphadr[0])
    vertices = model.mesh_vert[vert : vert + int(mesh.vertnum[0])].astype(np.float64)
    faces = model.mesh_face[face : face + int(mesh.facenum[0])].astype(np.int64)
    if address < 0:
        return vertices, faces, vertices
    # numbers of vertices and faces, edge addresses, then the vertices' ids
    count = int(model.mesh_graph[address])
    return vertices, faces, vertices[model.mesh_graph[address + 2 + count :][:count]]


def split_parts(vertices: Float, faces: Int) -> list[tuple[str, Int]]:
    """The parts of a mesh, by kind and faces; all sheets as one.

    A part is what hangs together over edges. It encloses a volume where each of its edges is met
    as often in one direction as in the other, once triangles that are wound against most of the
    part's area are turned. With few open edges, it is unclear, and its surface alone is judged.
    """
    _, point = np.unique(vertices, axis=0, return_inverse=True)
    corner = point.reshape(-1)[faces]
    whole = (corner != np.roll(corner, 1, axis=1)).all(axis=1)
    faces = faces[whole]
    corner = corner[whole]
    if not len(faces):
        return []
    first = corner.ravel()
    second = np.roll(corner, -1, axis=1).ravel()
    ends = np.sort(np.stack([first, second], axis=1), axis=1)
    _, edge, met = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    # faces and edges as the nodes of one graph: faces with an edge in common hang together
    face = np.repeat(np.arange(len(faces)), 3)
    nodes = len(faces) + len(met)
    graph = coo_array((np.ones(len(face), np.int8), (face, len(faces) + edge)), (nodes, nodes))
    count, label = connected_components(graph, directed=False)
    part, of_edge = np.split(label, [len(faces)])
    way = np.where(first < second, 1, -1)
    if np.bincount(edge, way).any():
        is_open = np.bincount(of_edge, met % 2, count) > 0
        turned = _find_turned(vertices, faces, edge, way, part) & ~is_open[part]
        faces = np.where(turned[:, None], faces[:, ::-1], faces)
        way = np.where(turned[face], -way, way)
    surplus = np.bincount(edge, way)
    is_turned = np.bincount(of_edge, surplus != 0, count) > 0
    open_edges = np.bincount(of_edge, met % 2, count)
    all_edges = np.bincount(of_edge)
    # volume as seen from the first corner of each part [m³], and area [m²]
    origin = vertices[faces[np.unique(part, return_index=True)[1], 0]][part]
    a, b, c = (vertices[faces[:, k]] - origin for k in range(3))
    cross = np.cross(b - a, c - a)
    volume = np.bincount(part, (a * cross).sum(axis=1)) / 6
    area = np.bincount(part, np.linalg.norm(cross, axis=1)) / 2
    kind = np.where(volume > 0, SOLID, CAVITY).astype(object)
    # an almost closed part may enclose something, with a stray triangle or a membrane
    kind[is_turned | (open_edges > 0)] = UNCLEAR
    is_thin = np.abs(volume) <= THINNEST * area
    kind[(open_edges > MOST_OPEN * all_edges) | (is_thin & ~is_turned)] = SHEET
    by_part = np.argsort(part, kind="stable")
    pieces = np.split(faces[by_part], np.cumsum(np.bincount(part))[:-1])
    sheets = [piece for piece, k in zip(pieces, kind, strict=True) if k == SHEET]
    parts = [(str(k), piece) for k, piece in zip(kind, pieces, strict=True) if k != SHEET]
    return [*parts, (SHEET, np.concatenate(sheets))] if sheets else parts
