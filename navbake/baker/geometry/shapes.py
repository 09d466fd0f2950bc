"""The counted geoms' geometry as arrays, in the world frame: what rays and overlaps work on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import Facets, Planes, Solids
from navbake.baker.core.blocks import join_arrays
from navbake.baker.core.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID
from navbake.baker.geometry.triangle_kernels import expand_mesh, measure_areas
from navbake.lazy import lazy
from navbake.threads import num_threads, run_in_chunks
from navbake.types import Bool, Float, Int, Int32

spatial = lazy("scipy.spatial")

# Half-size in place of the infinite side of a plane with a finite one; heights on a tilted one are
# off by about 1e-16 ENDLESS_HALF_SIZE^2 [m]
ENDLESS_HALF_SIZE = 1e4
# points or triangles of a share; shares, each with arrays of its own
LEAST = 4096
MOST_SHARES = 8
SIDES = 32  # of a round solid that is drawn by triangles


class GeomTriangles(NamedTuple):
    """The triangles of one geom, counter-clockwise from the front, and its `GeomReport.shape`.

    It is made of a mesh, a hull, a height field or a finite plane. `part` is 0 for what encloses
    nothing, and for all that is no mesh; `closed` is OPEN_SURFACE, CLOSED_SURFACE, SOLID (height
    fields) or CONVEX_SOLID (hulls): inside of all but the first counts as occupied.
    """

    vertices: Float
    faces: Int32
    part: Int32
    closed: NDArray[np.uint8]
    kind: str


class Mesh(NamedTuple):
    """Triangles that several pieces may have in common, counter-clockwise from outside."""

    vertices: Float
    faces: Int32


@dataclass(frozen=True, eq=False)
class Meshes:
    """The geoms that are made of triangles, ascending, shape (n,), and the triangles of each.

    Geoms of one mesh share all arrays but the vertices, which are in the world frame [m]. `boxes`
    are exact, (n, 6): lower corner, upper corner [m].
    """

    geom: Int32
    triangles: Sequence[GeomTriangles]
    boxes: Float

    @property
    def counts(self) -> Int:
        """How many triangles each geom has, shape (n,)."""
        return np.array([len(one.faces) for one in self.triangles], dtype=np.int64)

    @cached_property
    def expanded(self) -> Facets:
        """All triangles, which are kept."""
        return self.expand()

    def only(self, kept: Bool) -> Meshes:
        """Those that are kept, shape (n,)."""
        if kept.all():
            return self
        pairs = zip(self.triangles, kept.tolist(), strict=True)
        chosen = [one for one, is_kept in pairs if is_kept]
        return Meshes(self.geom[kept], chosen, self.boxes[kept])

    def expand(self) -> Facets:
        """All triangles, by geom."""
        ends = np.cumsum([0, *self.counts])
        corners = np.empty((ends[-1], 3, 3))
        bounds = np.empty((ends[-1], 6))
        facing = np.empty(ends[-1], dtype=np.int8)

        def write(first: int, end: int) -> None:
            geom = int(np.searchsorted(ends, first, side="right")) - 1
            while first < end:
                begin, last = ends[geom : geom + 2].tolist()
                arrays = (array[begin:last] for array in (corners, bounds, facing))
                mesh = self.triangles[geom]
                last = min(last, end)
                expand_mesh(mesh.vertices, mesh.faces, *arrays, first - begin, last - begin)
                first = last
                geom = geom + 1

        run_in_chunks(write, int(ends[-1]), least=4096)
        parts: list[list[NDArray[Any]]] = [[one.part, one.closed] for one in self.triangles]
        parts = parts or [[np.empty(0, np.int32), np.empty(0, np.uint8)]]
        part, closed = join_arrays(parts)
        return Facets(np.repeat(self.geom, self.counts), part, closed, corners, bounds, facing)


Primitives = TypeVar("Primitives", Solids, Planes)
# So many triangles are expanded together
TOGETHER = 1 << 20


@dataclass(frozen=True)
class Shapes:
    """All counted geometry."""

    solids: Solids
    planes: Planes
    meshes: Meshes
    # By geom id, planes with one infinite side: their triangles reach ENDLESS_HALF_SIZE, and do not
    # count for the box
    endless: Bool

    @cached_property
    def bounds(self) -> Float | None:
        """The box round everything finite, shape (2, 3), float64 [m]; None if all is infinite."""
        ends = self.meshes.boxes[~self.endless[self.meshes.geom]]
        boxes = np.concatenate([self.solids.bounds, ends])
        low = boxes[:, :3]
        high = boxes[:, 3:]
        return np.stack([low.min(axis=0), high.max(axis=0)]) if len(low) else None

    @cached_property
    def boxes(self) -> Float:
        """Boxes round the geometry, one a geom, (n, 6) [m], endless for planes."""
        planes = np.tile(np.repeat([-np.inf, np.inf], 3), (len(self.planes.geom), 1))
        return np.concatenate([self.solids.bounds, self.meshes.boxes, planes])

    @cached_property
    def boxed_geoms(self) -> Int32:
        """The geom of each of `boxes`."""
        return np.concatenate([self.solids.geom, self.meshes.geom, self.planes.geom])

    @property
    def triangles(self) -> Facets:
        """All triangles."""
        return self.meshes.expanded

    def forget_triangles(self) -> None:
        """Give back the memory of the triangles; they are expanded again when asked for."""
        self.meshes.__dict__.pop("expanded", None)

    def triangles_of_some(self) -> Iterator[Facets]:
        """All triangles, but of few geoms at a time unless they are all expanded."""
        if "expanded" in self.meshes.__dict__:
            yield self.triangles
            return
        group = np.cumsum(self.meshes.counts) // TOGETHER
        for number in np.unique(group).tolist():
            yield self.meshes.only(group == number).expand()

    def only(self, geoms: Bool) -> Shapes:
        """The geometry of the geoms that are marked, shape (ngeom,), bool."""
        if geoms.all():
            return self

        def marked(items: Primitives) -> Primitives:
            kept = geoms[items.geom]
            return items if kept.all() else type(items)._make(array[kept] for array in items)

        meshes = self.meshes.only(geoms[self.meshes.geom])
        return Shapes(marked(self.solids), marked(self.planes), meshes, self.endless & geoms)

    def replaced(self, new: Shapes, geoms: Bool) -> Shapes:
        """The shapes with new ones, of the same kinds, in place of those of the marked geoms."""

        def put(old: Primitives, now: Primitives) -> Primitives:
            at = np.flatnonzero(geoms[old.geom])
            if not len(at):
                return old
            arrays: list[NDArray[Any]] = [array.copy() for array in old]
            for array, values in zip(arrays, now, strict=True):
                array[at] = values
            return type(old)._make(arrays)

        triangles = list(self.meshes.triangles)
        boxes = self.meshes.boxes.copy()
        at = np.flatnonzero(geoms[self.meshes.geom])
        boxes[at] = new.meshes.boxes
        for n, one in zip(at.tolist(), new.meshes.triangles, strict=True):
            triangles[n] = one
        meshes = Meshes(self.meshes.geom, triangles, boxes)
        solids = put(self.solids, new.solids)
        planes = put(self.planes, new.planes)
        return Shapes(solids, planes, meshes, self.endless)

    def turned(self, axes: Float) -> Shapes:
        """The solids in a frame with these axes, its rows, shape (3, 3)."""
        solids = self.solids
        mats = axes @ self.solids.mat.reshape(-1, 3, 3)
        pose = solids.pos @ axes.T, np.ascontiguousarray(mats.reshape(-1, 9)), solids.size
        bounds = solid_bounds(solids.kind, *pose)
        planes = Planes._make(array[:0] for array in self.planes)
        turned = Solids(solids.geom, solids.kind, *pose, bounds)
        none = np.zeros(len(self.meshes.geom), dtype=np.bool_)
        return Shapes(turned, planes, self.meshes.only(none), self.endless)


def gather_meshes(triangles: Mapping[int, GeomTriangles]) -> Meshes:
    """The meshes of some geoms, by ascending ids, without those of no triangle."""
    some = {geom: one for geom, one in triangles.items() if len(one.faces)}
    boxes = np.empty((len(some), 6))
    known = dict[int, Bool]()
    for box, (vertices, faces, *_) in zip(boxes, some.values(), strict=True):
        if id(faces) not in known:  # geoms of one mesh share it
            known[id(faces)] = mark_used_vertices(len(vertices), faces)
        is_used = known[id(faces)]
        box[:] = bounding_box(vertices if is_used.all() else vertices[is_used])
    return Meshes(np.array(list(some), dtype=np.int32), list(some.values()), boxes)


def solid_bounds(kind: Int32, pos: Float, mat: Float, size: Float) -> Float:
    """Exact boxes of solids from the fields of `Solids`: lower and upper corners, (n, 6) [m]."""
    axes = mat.reshape(-1, 3, 3)
    half = np.stack([support_distances(kind, axes[:, k], size) for k in range(3)], axis=1)
    return np.concatenate([pos - half, pos + half], axis=1)


def support_distances(kind: Int32, way: Float, size: Float) -> Float:
    """How far solids reach from their centres along unit vectors in their own frames, (n,) [m]."""
    along = np.abs(way)
    reach = np.empty(len(kind))
    kinds = set(kind.tolist())
    for number in kinds:
        own = kind == number if len(kinds) > 1 else slice(None)
        up = along[own, 2]
        sizes = size[own]
        if number == BOX:
            reach[own] = (along[own] * sizes).sum(axis=1)
        elif number == ELLIPSOID:
            reach[own] = np.sqrt(np.square(along[own] * sizes).sum(axis=1))
        elif number == CYLINDER:
            flat = np.sqrt(np.clip(1.0 - np.square(up), 0.0, None))
            reach[own] = up * sizes[:, 1] + sizes[:, 0] * flat
        else:
            reach[own] = sizes[:, 0] + (up * sizes[:, 1] if number == CAPSULE else 0.0)
    return reach


def height_field_triangles(heights: Float, size: Float) -> Float:
    """A height field as a closed mesh in its geom's frame: top, four sides and bottom.

    Its cells are split from their lower corner to their upper one, as MuJoCo's rays and collisions
    split them. Heights are 0 to 1, row 0 at the smallest y; the size is MuJoCo's.
    """
    rows, cols = heights.shape
    x, y = np.meshgrid(np.linspace(-size[0], size[0], cols), np.linspace(-size[1], size[1], rows))
    top = np.stack([x, y, heights * size[2]], axis=-1)
    base = np.stack([x, y, np.full_like(x, -size[3])], axis=-1)
    a = top[:-1, :-1]
    b = top[:-1, 1:]
    c = top[1:, 1:]
    d = top[1:, :-1]
    parts = [np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)]
    upper = np.concatenate([top[0, :-1], top[:-1, -1], top[-1, :0:-1], top[:0:-1, 0]])
    lower = np.concatenate([base[0, :-1], base[:-1, -1], base[-1, :0:-1], base[:0:-1, 0]])
    beside = np.roll(upper, -1, axis=0)
    under = np.roll(lower, -1, axis=0)
    # the bottom is fanned over the same border points, so that every edge is met from both sides
    middle = np.broadcast_to((base[0, 0] + base[-1, -1]) / 2, lower.shape)
    for corners in ((lower, under, beside), (lower, beside, upper), (middle, under, lower)):
        parts.append(np.stack(corners, axis=-2))
    return np.concatenate([part.reshape(-1, 3, 3) for part in parts])


def hull_faces(vertices: Float) -> Int32 | None:
    """Corners of the convex hull's faces, counter-clockwise from outside; None for a flat one."""
    try:
        hull = spatial.ConvexHull(vertices)
    except (spatial.QhullError, ValueError):  # flat, or fewer than four
        return None
    corners: Float = vertices[hull.simplices]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Qhull's simplices turn either way round, but its equations point outward
    inward = np.einsum("ij,ij->i", cross, hull.equations[:, :3]) < 0
    faces: Int32 = hull.simplices.astype(np.int32)
    faces[inward] = faces[inward][:, ::-1]
    return faces


# ---------------------------------------------------------------- meshes as arrays


def count_shares(count: int) -> int:
    """Into how many shares so many points or triangles are divided, each worth a thread."""
    return max(1, min(num_threads(), MOST_SHARES, count // LEAST))


def triangle_areas(vertices: Float, faces: Int32) -> Float:
    """The areas of triangles, (m,) float64 [m²]."""
    area = np.empty(len(faces))
    run_in_chunks(measure_areas, len(faces), vertices, faces, area, least=4096)
    return area


def bounding_box(points: Float) -> Float:
    """The box round points, (n, 3): lower and upper corner, (6,) [m]; NaN if one has a NaN."""
    box = np.empty(6)

    def measure(first: int, end: int) -> None:
        for k in range(first, end):  # numpy takes ten times as long along narrow rows
            box[k] = points[:, k].min()
            box[3 + k] = points[:, k].max()

    run_in_chunks(measure, 3, least=1 if len(points) > LEAST else 3)
    return box


def mark_used_vertices(num: int, faces: Int32) -> Bool:
    """Mark which of so many vertices some faces use, shape (num,)."""
    marks = np.zeros((count_shares(len(faces)), num), dtype=np.bool_)

    def mark(first: int, end: int) -> None:
        for share in range(first, end):
            begin = len(faces) * share // len(marks)
            last = len(faces) * (share + 1) // len(marks)
            marks[share][faces[begin:last]] = True

    run_in_chunks(mark, len(marks))
    return marks[0] if len(marks) == 1 else np.asarray(marks.any(axis=0))


def drop_unused_vertices(vertices: Float, faces: Int32) -> tuple[Float, Int32]:
    """The vertices that faces use, and the faces counted in them."""
    is_used = mark_used_vertices(len(vertices), faces)
    if is_used.all():
        return vertices, faces
    return vertices[is_used], (np.cumsum(is_used, dtype=np.int32) - 1)[faces]


# ---------------------------------------------------------------- triangles of solids and polygons


def tessellate(kind: str, size: Sequence[float]) -> Mesh:
    """A solid as triangles; round ones, and cones, with `SIDES` sides.

    Sizes are MuJoCo's; a cone's are the radius of its base and half its height, its tip is up.
    """
    if kind == "plane":
        corners = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        halves = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
        return Mesh(corners * (*size[:2], 1.0), halves)
    if kind == "box":
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
        hull = hull_faces(corners.astype(np.float64))
        assert hull is not None
        return Mesh(corners, hull)
    radius = size[0]
    half = size[1] if len(size) > 1 else 0.0
    arc = np.linspace(-math.pi / 2, 0.0, SIDES // 4 + 1)
    if kind == "cylinder":
        profile = [(0.0, -half), (radius, -half), (radius, half), (0.0, half)]
    elif kind == "cone":
        profile = [(0.0, -half), (radius, -half), (0.0, half)]
    else:
        lift = half if kind == "capsule" else 0.0
        lower = [(radius * math.cos(a), radius * math.sin(a) - lift) for a in arc.tolist()]
        profile = lower + [(r, -z) for r, z in lower[::-1][lift == 0 :]]
    ends = (profile[0], profile[-1])
    rings = profile[1:-1]
    turn = np.arange(SIDES) * (2 * math.pi / SIDES)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    layers = [np.column_stack([r * around, np.full(SIDES, z)]) for r, z in rings]
    vertices = np.concatenate([*layers, [[0.0, 0.0, ends[0][1]], [0.0, 0.0, ends[1][1]]]])
    here = np.arange(SIDES)
    beside = (np.arange(SIDES) + 1) % SIDES
    low = len(vertices) - 2
    high = len(vertices) - 1
    top = (len(rings) - 1) * SIDES
    faces = [np.column_stack([np.full(SIDES, low), beside, here])]
    for start in range(0, top, SIDES):
        a = start + here
        b = start + beside
        faces += [np.column_stack([a, b, b + SIDES]), np.column_stack([a, b + SIDES, a + SIDES])]
    faces.append(np.column_stack([top + here, top + beside, np.full(SIDES, high)]))
    if kind == "ellipsoid":
        vertices = vertices / radius * np.asarray(size)
    return Mesh(vertices, np.concatenate(faces).astype(np.int32))


def triangulate(vertices: Float, counts: Int, indices: Int, holes: Int) -> Int32:
    """Triangles of polygons in space, which wind as these do, (n, 3).

    Convex ones are fans; of others ears are cut off (Meisters, Polygons have ears, 1975). Takes
    vertices, (m, 3), how many corners each polygon has, and the vertices of all corners, polygon by
    polygon. Those with fewer than three, and those numbered in `holes`, are left out.
    """
    if not len(holes) and (counts == 3).all():
        return np.asarray(indices.reshape(-1, 3).astype(np.int32))
    start = np.cumsum(counts) - counts
    found = [np.empty((0, 3), dtype=np.int32)]
    kept = counts >= 3
    kept[holes[(holes >= 0) & (holes < len(counts))]] = False
    for size in np.unique(counts[kept]).tolist():
        first = start[kept & (counts == size)]
        corners = indices[first[:, None] + np.arange(size)].astype(np.int32)
        if size > 3:
            is_convex = _are_convex(vertices[corners])
            found += [_cut_ears(vertices[one], one) for one in corners[~is_convex]]
            corners = corners[is_convex]
        for k in range(1, size - 1):
            found.append(corners[:, [0, k, k + 1]])
    return np.concatenate(found)


def _are_convex(points: Float) -> Bool:
    """Mark the polygons that turn to one side at all corners, shape of points (n, k, 3)."""
    points = points - points[:, :1]
    edge = np.roll(points, -1, axis=1) - points
    turn = np.cross(edge, np.roll(edge, -1, axis=1))
    normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)  # Newell's
    bends = np.einsum("nkc,nc->nk", turn, normal)
    return np.asarray((bends >= -1e-9 * np.abs(bends).max(axis=1, keepdims=True)).all(axis=1))


def _cut_ears(points: Float, corners: Int32) -> Int32:
    """The triangles of one simple polygon."""
    points = points - points[0]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    drop = int(np.abs(normal).argmax())  # the plane in which the polygon is widest
    flat = np.delete(points, drop, axis=1)
    way = 1.0 if (normal[drop] > 0) == (drop != 1) else -1.0
    left = list(range(len(points)))
    found = list[list[int]]()

    def area(a: Float, b: Float, c: Float) -> Float:
        """Twice the area of triangles, positive where they wind as the polygon."""
        ab = b - a
        ac = c - a
        return np.asarray(way * (ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]))

    while len(left) > 3:
        for k in range(len(left)):
            ear = left[k - 1], left[k], left[(k + 1) % len(left)]
            a, b, c = flat[list(ear)]
            size = area(a, b, c)
            others = flat[[p for p in left if p not in ear]]
            # corners at the place of one of the ear's belong to a slit
            others = others[~(others[:, None] == [a, b, c]).all(axis=2).any(axis=1)]
            sides = area(a, b, others), area(b, c, others), area(c, a, others)
            if size > 0 and not (np.min(sides, axis=0) >= 0).any():
                break
        else:  # corners on a line, or lines that cross: the flattest is cut off
            ears = [[left[k - 1], left[k], left[(k + 1) % len(left)]] for k in range(len(left))]
            k = int(np.argmin([abs(area(*flat[ear])) for ear in ears]))
            ear = left[k - 1], left[k], left[(k + 1) % len(left)]
        found.append([*ear])
        left.pop(k)
    return np.asarray(corners[np.array([*found, left])])
