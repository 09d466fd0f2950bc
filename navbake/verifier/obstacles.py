"""The geoms that count, as FCL and MuJoCo hold them: what a verification judges by.

The shapes come from the compiled MuJoCo model and the choice of geoms alone. They are put into a
MuJoCo model of their own, so that MuJoCo means the same shapes as the bake: a mesh that counts by
its hull is its hull there, also for rays, and what is drawn transparent is hit like anything else.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import fcl
import mujoco
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from navbake.baker.scene.scene import Scene
from navbake.errors import SceneError
from navbake.types import Bool, Float, Int, Json

SHEET, SOLID, CAVITY, UNCLEAR = "sheet", "solid", "cavity", "unclear"
MOST_OPEN = 0.05  # share of open edges up to which a part may be a closed one with a flaw
THINNEST = 1e-6  # volume by area of what is a sheet with two sides [m]


class Part(NamedTuple):
    """Triangles of a mesh.

    Attributes:
        kind: SHEET (encloses nothing), SOLID, CAVITY (a closed part that faces in) or UNCLEAR.
        faces: shape (n, 3), indices of the mesh's vertices.
    """

    kind: str
    faces: Int


def split_parts(vertices: Float, faces: Int) -> list[Part]:
    """All sheets as one part, and each part that encloses something, or may, by itself.

    A part is what hangs together over edges. It encloses a volume where each of its edges is met
    as often in one direction as in the other. What only might enclose one (edges that are met
    twice, but in one direction) is unclear: there, only its surface is judged.

    Args:
        vertices: shape (n, 3) [m].
        faces: shape (m, 3), counter-clockwise from outside.
    """
    _, point = np.unique(vertices, axis=0, return_inverse=True)
    corner = point.reshape(-1)[faces]
    whole = (corner != np.roll(corner, 1, axis=1)).all(axis=1)
    faces, corner = faces[whole], corner[whole]
    if not len(faces):
        return []
    first, second = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    ends = np.sort(np.stack([first, second], axis=1), axis=1)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    face = np.repeat(np.arange(len(faces)), 3)
    num_edges = int(edge.max()) + 1
    # faces and edges as the nodes of one graph: faces with an edge in common hang together
    graph = coo_array(
        (np.ones(len(face), dtype=np.int8), (face, len(faces) + edge)),
        shape=(len(faces) + num_edges,) * 2,
    )
    _, label = connected_components(graph, directed=False)
    number, part = np.unique(label[: len(faces)], return_inverse=True)
    direction = np.where(first < second, 1, -1)
    surplus = np.bincount(edge, direction, num_edges)
    met = np.bincount(edge, minlength=num_edges)
    part_of_edge = np.zeros(num_edges, dtype=np.int64)
    part_of_edge[edge] = part[face]
    is_turned = np.bincount(part_of_edge, surplus != 0, len(number)) > 0
    volume, area = _measure(vertices, faces, part, len(number))
    is_thin = np.abs(volume) <= THINNEST * area
    kind = np.where(volume > 0, SOLID, CAVITY).astype(object)
    kind[is_turned] = UNCLEAR
    # an almost closed part may enclose something, with a stray triangle or a membrane
    open_edges = np.bincount(part_of_edge, met % 2, len(number))
    all_edges = np.bincount(part_of_edge, minlength=len(number))
    is_sheet = open_edges > MOST_OPEN * all_edges
    kind[open_edges > 0] = UNCLEAR
    kind[is_sheet | (is_thin & ~is_turned)] = SHEET
    by_part = np.argsort(part, kind="stable")
    pieces = np.split(faces[by_part], np.searchsorted(part[by_part], np.arange(1, len(number))))
    sheets = [piece for piece, k in zip(pieces, kind, strict=True) if k == SHEET]
    parts = [Part(k, f) for k, f in zip(kind, pieces, strict=True) if k != SHEET]
    return [*parts, Part(SHEET, np.concatenate(sheets))] if sheets else parts


def _measure(vertices: Float, faces: Int, part: Int, num: int) -> tuple[Float, Float]:
    """Volume and area of each part, the volume as seen from its first corner [m³, m²]."""
    _, first = np.unique(part, return_index=True)
    corners = vertices[faces] - vertices[faces[first[part], 0]][:, None]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.bincount(part, np.einsum("ij,ij->i", corners[:, 0], cross), num) / 6
    return volume, np.bincount(part, np.linalg.norm(cross, axis=1), num) / 2


GEOM = mujoco.mjtGeom
BIN = 0.5  # edge of the squares that obstacles are sorted into [m]
MOST_BINS = 1000  # squares that an obstacle is listed in at most
FAR = 1e4  # half-size that stands for the infinite side of a plane with a finite one [m]
CONVEX = "convex"  # what an obstacle is, beside the kinds of parts of meshes
HALF_SPACE = "half-space"
HEIGHT_FIELD = "height field"
UPRIGHT = 1e-9  # least z of a unit normal, up or down, of what a vertical line can cross


@dataclass(eq=False)
class Obstacle:
    """One convex solid, plane, height field, or part of a mesh.

    Attributes:
        geom: id of the scene's geom that it belongs to.
        kind: CONVEX, HALF_SPACE, HEIGHT_FIELD, or a part's SHEET, SOLID, CAVITY or UNCLEAR.
        shape: FCL's object, in its place.
        low, high: its box, world frame [m]; infinite for half-spaces.
        same_in_mujoco: whether MuJoCo collides the same shape: it knows no surfaces, and takes
            finite planes for infinite ones.
        points: corners of a hull, world frame, shape (n, 3) [m]; empty for all else.
    """

    geom: int
    kind: str
    shape: Any
    low: Float
    high: Float
    same_in_mujoco: bool
    points: Float = field(default_factory=lambda: np.empty((0, 3)))


@dataclass(eq=False)
class Obstacles:
    """All obstacles, numbered as the geoms of a MuJoCo model that holds nothing else.

    Attributes:
        items: obstacle i is geom i of the model.
        model, data: the MuJoCo model; two more geoms, a box and a cylinder, are to probe with, and
            behind them are those of `facing`.
        low, high: boxes of all, shape (n, 3) [m].
        names: of the scene's geoms, by id.
        facing: of each surface of a mesh, the model's geoms with its triangles that face up, and
            with those that face down: where two lie in one place, a ray meets only one of them.
        pos, mat, size: poses and sizes of the model's geoms, its own arrays.
    """

    items: list[Obstacle]
    model: Any
    data: Any
    low: Float
    high: Float
    names: list[str]
    facing: dict[int, list[int]]
    pos: Float = field(init=False)
    mat: Float = field(init=False)
    size: Float = field(init=False)

    def __post_init__(self) -> None:
        # MuJoCo makes these anew whenever they are asked for
        self.pos, self.mat = self.data.geom_xpos, self.data.geom_xmat
        self.size = self.model.geom_size

    @property
    def box_probe(self) -> int:
        """The model's geom for upright boxes."""
        return len(self.items)

    @property
    def cylinder_probe(self) -> int:
        """The model's geom for upright cylinders."""
        return len(self.items) + 1

    def name(self, number: int) -> str:
        """The name of the geom that an obstacle belongs to."""
        return self.names[self.items[number].geom]

    def meets_box(self, low: Float, high: Float) -> bool:
        """Whether the box of any obstacle meets a box."""
        meets = (self.low <= high).all(axis=1) & (self.high >= low).all(axis=1)
        return bool(meets.any())

    def over(self, x: float, y: float) -> list[int]:
        """The obstacles whose boxes hold a vertical line, ascending."""
        bins, everywhere = self._bins
        boxes = self._sides
        found = [*everywhere, *bins.get((int(x // BIN), int(y // BIN)), ())]
        return sorted(
            k for k in found if boxes[k][0] <= x <= boxes[k][2] and boxes[k][1] <= y <= boxes[k][3]
        )

    @cached_property
    def _sides(self) -> list[list[float]]:
        sides: list[list[float]] = np.hstack([self.low[:, :2], self.high[:, :2]]).tolist()
        return sides

    @cached_property
    def _bins(self) -> tuple[dict[tuple[int, int], list[int]], list[int]]:
        """The obstacles over each square of `BIN`, and those that are over too many."""
        bins: dict[tuple[int, int], list[int]] = {}
        everywhere = []
        for number, sides in enumerate(self._sides):
            if not np.isfinite(sides).all():
                everywhere.append(number)
                continue
            x0, y0, x1, y1 = (int(side // BIN) for side in sides)
            if (x1 - x0 + 1) * (y1 - y0 + 1) > MOST_BINS:
                everywhere.append(number)
                continue
            for place in itertools.product(range(x0, x1 + 1), range(y0, y1 + 1)):
                bins.setdefault(place, []).append(number)
        return bins, everywhere


def build_obstacles(scene: Scene, data: Any, left_out: Collection[int] = ()) -> Obstacles:
    """Make the obstacles of the geoms that count.

    Args:
        data: the pose; doors may stand otherwise than in the scene's own.
        left_out: ids of geoms that are not there.

    Raises:
        SceneError: MuJoCo can't compile them.
    """
    builder = _Builder(scene, data)
    for geom, choice in enumerate(scene.choices):
        if choice.counted and geom not in left_out:
            builder.add(geom, choice.mesh)
    return builder.finish()


class _Builder:
    def __init__(self, scene: Scene, data: Any) -> None:
        self._scene, self._model, self._data = scene, scene.model, data
        self._spec = mujoco.MjSpec()
        self._items: list[Obstacle] = []
        self._heights: list[Float] = []
        self._shared: dict[tuple[int, str], list[Any]] = {}
        self._facing: list[tuple[int, Json]] = []
        self._halves: dict[tuple[str, bytes], list[str]] = {}

    def add(self, geom: int, mesh_mode: str) -> None:
        kind, size = int(self._model.geom_type[geom]), self._model.geom_size[geom].copy()
        if kind == GEOM.mjGEOM_PLANE:
            self._add_plane(geom, size)
        elif kind == GEOM.mjGEOM_HFIELD:
            self._add_height_field(geom)
        elif kind in (GEOM.mjGEOM_MESH, GEOM.mjGEOM_SDF):
            self._add_mesh(geom, mesh_mode)
        else:
            self._put(geom, CONVEX, _solid(kind, size), type=kind, size=size)

    def finish(self) -> Obstacles:
        world = self._spec.worldbody
        world.add_geom(type=GEOM.mjGEOM_BOX, size=[0.1, 0.1, 0.1])
        world.add_geom(type=GEOM.mjGEOM_CYLINDER, size=[0.1, 0.1, 0.0])
        facing: dict[int, list[int]] = {}
        for more, (number, settings) in enumerate(self._facing):
            world.add_geom(**settings)
            facing.setdefault(number, []).append(len(self._items) + 2 + more)
        try:
            model = self._spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            text = " ".join(str(error).split())[:300]
            raise SceneError(f"MuJoCo can't hold the shapes that count: {text}") from error
        for number, heights in enumerate(self._heights):
            first = int(model.hfield_adr[number])  # compiling stretched them to 0 to 1
            model.hfield_data[first : first + heights.size] = heights.ravel()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        none = np.empty((0, 3))
        low = np.array([item.low for item in self._items]) if self._items else none
        high = np.array([item.high for item in self._items]) if self._items else none
        names = [report.name for report in self._scene.geoms]
        return Obstacles(self._items, model, data, low, high, names, facing)

    def _pose(self, geom: int) -> tuple[Float, Float]:
        if geom in self._scene.parts:  # these are in the world's frame
            return np.eye(3), np.zeros(3)
        mat = self._data.geom_xmat[geom].reshape(3, 3).copy()
        return mat, self._data.geom_xpos[geom].copy()

    def _put(
        self,
        geom: int,
        kind: str,
        shape: Any,
        *,
        points: Float | None = None,
        same: bool = True,
        **settings: Any,
    ) -> None:
        """Place a shape of FCL, and the geom of MuJoCo that the settings describe."""
        mat, pos = self._pose(geom)
        placed = fcl.CollisionObject(shape, fcl.Transform(mat, pos))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, mat.ravel())
        self._spec.worldbody.add_geom(pos=pos, quat=quat, **settings)
        kind_of = int(settings["type"])
        if kind == HALF_SPACE:
            low, high = np.full(3, -np.inf), np.full(3, np.inf)
        elif kind == CONVEX and kind_of != GEOM.mjGEOM_MESH:
            half = _half_extents(kind_of, np.asarray(settings["size"]), mat)
            low, high = pos - half, pos + half
        else:
            corners = np.asarray(points) @ mat.T + pos
            low, high = corners.min(axis=0), corners.max(axis=0)
        hull = corners if kind == CONVEX and kind_of == GEOM.mjGEOM_MESH else np.empty((0, 3))
        self._items.append(Obstacle(geom, kind, placed, low, high, same, hull))

    def _add_plane(self, geom: int, size: Float) -> None:
        if (size[:2] <= 0).all():
            shape = fcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
            self._put(geom, HALF_SPACE, shape, type=GEOM.mjGEOM_PLANE, size=[0, 0, 1])
            mat, pos = self._pose(geom)
            if mat[2, 2] > 1 - 1e-12:  # nothing over a level one needs to be asked about
                self._items[-1].high[2] = pos[2]
            return
        x, y = np.where(size[:2] > 0, size[:2], FAR)
        corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        surface = _surface(corners, np.array([[0, 1, 2], [0, 2, 3]]))
        shown = {"type": GEOM.mjGEOM_PLANE, "size": [size[0], size[1], 1.0]}
        self._put(geom, SHEET, surface, points=corners, same=False, **shown)

    def _add_height_field(self, geom: int) -> None:
        model, field_id = self._model, int(self._model.geom_dataid[geom])
        rows, cols = int(model.hfield_nrow[field_id]), int(model.hfield_ncol[field_id])
        first = int(model.hfield_adr[field_id])
        heights = model.hfield_data[first : first + rows * cols].reshape(rows, cols).copy()
        size, name = model.hfield_size[field_id], f"field {len(self._heights)}"
        self._heights.append(heights)
        self._spec.add_hfield(name=name, nrow=rows, ncol=cols, size=size, userdata=heights.ravel())
        vertices, faces = _field_surface(heights.astype(np.float64), size)
        surface, shown = _surface(vertices, faces), {"type": GEOM.mjGEOM_HFIELD, "hfieldname": name}
        self._put(geom, HEIGHT_FIELD, surface, points=vertices, same=False, **shown)

    def _add_mesh(self, geom: int, mode: str) -> None:
        part = self._scene.parts.get(geom)
        key = (int(self._model.geom_dataid[geom]), mode)
        pieces = None if part is not None else self._shared.get(key)
        if pieces is None:
            if part is not None:
                own = part.vertices, part.faces.astype(np.int64), part.vertices
                pieces = self._pieces(*own, mode)
            else:
                pieces = self._pieces(*_mesh_arrays(self._model, key[0]), mode)
                self._shared[key] = pieces
        for kind, shape, points, triangles, name in pieces:
            shown: Json = {"type": GEOM.mjGEOM_MESH, "meshname": name}
            if kind != CONVEX:
                self._add_facing(name, points, triangles, *self._pose(geom))
                shown |= {"contype": 0, "conaffinity": 0}  # needs no hull
            self._put(geom, kind, shape, points=points, same=kind == CONVEX, **shown)

    def _add_facing(self, name: str, points: Float, triangles: Int, mat: Float, pos: Float) -> None:
        """Add what faces up of a surface, and what faces down, each as a mesh of its own."""
        key = name, mat[2].tobytes()
        if key not in self._halves:
            a, b, c = (points[triangles[:, k]] for k in range(3))
            normal = np.cross(b - a, c - a)
            up, least = normal @ mat[2], UPRIGHT * np.linalg.norm(normal, axis=1)
            halves = [triangles[up > least], triangles[up < -least]]
            self._halves[key] = [self._name_mesh(*_used(points, h)) for h in halves if len(h)]
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, mat.ravel())
        place = {"type": GEOM.mjGEOM_MESH, "pos": pos, "quat": quat, "contype": 0, "conaffinity": 0}
        number = len(self._items)
        self._facing += [(number, {**place, "meshname": half}) for half in self._halves[key]]

    def _pieces(self, vertices: Float, faces: Int, on_hull: Float, mode: str) -> list[Any]:
        """Kind, FCL's shape, points, triangles and mesh name of each piece of a mesh."""
        hull = _hull_of(on_hull) if mode == "hull" else None
        if hull is not None:
            points, triangles = hull
            counted = np.concatenate([np.full((len(triangles), 1), 3), triangles], axis=1)
            shape = fcl.Convex(points, len(triangles), counted.ravel())
            return [(CONVEX, shape, points, triangles, self._name_mesh(points, triangles))]
        parts = [(SHEET, faces)] if mode == "shell" else split_parts(vertices, np.asarray(faces))
        pieces = []
        for kind, own in parts:
            points, triangles = _used(vertices, own)
            name = self._name_mesh(points, triangles)
            pieces.append((kind, _surface(points, triangles), points, triangles, name))
        return pieces

    def _name_mesh(self, points: Float, triangles: Int) -> str:
        if len(points) < 4:  # MuJoCo takes no fewer
            points = np.concatenate([points, points.mean(axis=0, keepdims=True)])
        name = f"mesh {len(self._spec.meshes)}"
        self._spec.add_mesh(
            name=name,
            uservert=points.ravel(),
            userface=triangles.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        return name


def _used(vertices: Float, faces: Int) -> tuple[Float, Int]:
    """The vertices that faces use, and the faces by these."""
    used, corners = np.unique(faces, return_inverse=True)
    return vertices[used], corners.reshape(-1, 3)


def _solid(kind: int, size: Float) -> Any:
    if kind == GEOM.mjGEOM_SPHERE:
        return fcl.Sphere(size[0])
    if kind == GEOM.mjGEOM_CAPSULE:
        return fcl.Capsule(size[0], 2 * size[1])
    if kind == GEOM.mjGEOM_ELLIPSOID:
        return fcl.Ellipsoid(*size)
    if kind == GEOM.mjGEOM_CYLINDER:
        return fcl.Cylinder(size[0], 2 * size[1])
    return fcl.Box(*(2 * size))


def _half_extents(kind: int, size: Float, mat: Float) -> Float:
    """Half of the box round a solid, world frame [m]."""
    axis = np.abs(mat[:, 2])
    if kind == GEOM.mjGEOM_SPHERE:
        return np.full(3, size[0])
    if kind == GEOM.mjGEOM_CAPSULE:
        return np.asarray(size[0] + axis * size[1])
    if kind == GEOM.mjGEOM_ELLIPSOID:
        return np.asarray(np.linalg.norm(mat * size, axis=1))
    if kind == GEOM.mjGEOM_CYLINDER:
        return np.asarray(axis * size[1] + size[0] * np.sqrt(np.clip(1 - axis**2, 0, None)))
    return np.asarray(np.abs(mat) @ size)


def _surface(vertices: Float, faces: Int) -> Any:
    shape = fcl.BVHModel()
    shape.beginModel(len(vertices), len(faces))
    shape.addSubModel(np.ascontiguousarray(vertices, dtype=np.float64), faces)
    shape.endModel()
    return shape


def _mesh_arrays(model: Any, mesh: int) -> tuple[Float, Int, Float]:
    """Vertices and faces of a mesh, and the vertices of MuJoCo's hull of it, geom's frame."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = model.mesh_face[first : first + count].astype(np.int64)
    address, on_hull = int(model.mesh_graphadr[mesh]), vertices
    if address >= 0:  # numbers of vertices and faces, edge addresses, then the vertices' ids
        count = int(model.mesh_graph[address])
        on_hull = vertices[model.mesh_graph[address + 2 + count : address + 2 + 2 * count]]
    return vertices, faces, on_hull


def _hull_of(points: Float) -> tuple[Float, Int] | None:
    """Corners and triangles of a convex hull, counter-clockwise from outside; None if flat."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    used, faces = np.unique(hull.simplices, return_inverse=True)
    corners, faces = points[used], faces.reshape(-1, 3).astype(np.int64)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces


def _field_surface(heights: Float, size: Float) -> tuple[Float, Int]:
    """The closed surface of a height field, as MuJoCo's documentation describes it.

    Its squares are halved from their lower corner to their upper one; sides and bottom close it.
    """
    rows, cols = heights.shape
    x, y = np.meshgrid(np.linspace(-size[0], size[0], cols), np.linspace(-size[1], size[1], rows))
    top = np.stack([x.ravel(), y.ravel(), (heights * size[2]).ravel()], axis=1)
    base = np.stack([x.ravel(), y.ravel(), np.full(x.size, -size[3])], axis=1)
    index = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    under = [face[..., ::-1] + rows * cols for face in faces]
    rim = np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2::-1, 0]])
    p, q = rim[:-1], rim[1:]
    sides = [np.stack([p + rows * cols, q + rows * cols, q], axis=-1)]
    sides.append(np.stack([p + rows * cols, q, p], axis=-1))
    everything = [part.reshape(-1, 3) for part in (*faces, *under, *sides)]
    return np.concatenate([top, base]), np.concatenate(everything)


def is_enclosing(obstacles: Obstacles) -> Bool:
    """Which obstacles have an inside that their surface alone doesn't tell of."""
    kinds = (HEIGHT_FIELD, SOLID, CAVITY)
    return np.array([item.kind in kinds for item in obstacles.items], dtype=np.bool_)
