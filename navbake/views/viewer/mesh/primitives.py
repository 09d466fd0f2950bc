"""The shapes that MuJoCo draws by a few numbers, as triangles: box, sphere, capsule and so on."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Float

DETAILS = ((100, 20, 5), (500, 12, 3))  # up to so many round geoms: corners of a circle, and
COARSE = 8, 2  # rows of quads from the pole of a sphere to its equator; and for more geoms

# mjtGeom: numbers of the file format, the same in all versions
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(8)
ROUND = (SPHERE, CAPSULE, ELLIPSOID, CYLINDER)


class Shape(NamedTuple):
    """Triangles of a geom in its own frame.

    Attributes:
        unit: vertices of the shape of size 1, shape (n, 3).
        end: where a vertex goes along z by half a length, -1, 0 or 1, shape (n,).
        faces: shape (m, 3), counter-clockwise from outside.
    """

    unit: Float
    end: Float
    faces: NDArray[np.uint32]

    def place(self, sizes: Float, halves: Float, rotations: Float, positions: Float) -> Float:
        """Vertices of many geoms of this shape.

        Args:
            sizes: shape (k, 3), by which the unit's axes are multiplied [m].
            halves: half a length along z, shape (k,) [m].
            rotations: shape (k, 3, 3), and
            positions: shape (k, 3), of the geoms in the world.

        Returns:
            Shape (k, n, 3), world frame [m].
        """
        local = self.unit * sizes[:, None, :]
        local[..., 2] += self.end * halves[:, None]
        placed: Float = local @ rotations.transpose(0, 2, 1) + positions[:, None, :]
        return placed


def choose_detail(count: int) -> tuple[int, int]:
    """How finely so many round geoms are drawn: corners of a circle, rows of half a sphere.

    A page without a graphics card draws some 100,000 triangles smoothly.
    """
    return next(((corners, rows) for most, corners, rows in DETAILS if count <= most), COARSE)


def shape_of(
    kind: int, size: Float, detail: tuple[int, int] = DETAILS[0][1:]
) -> tuple[Shape, Float, Float]:
    """The triangles for geoms of one of MuJoCo's kinds.

    Args:
        kind: SPHERE, CAPSULE, ELLIPSOID, CYLINDER or BOX.
        size: MuJoCo's sizes of the geoms, shape (k, 3).
        detail: of round shapes, see `choose_detail`.

    Returns:
        The shape, and `sizes` and `halves` for `Shape.place`.
    """
    zero = np.zeros(len(size))
    radius = size[:, :1]
    if kind == BOX:
        return _BOX, size, zero
    if kind == ELLIPSOID:
        return _make_ball(detail, is_capsule=False), size, zero
    if kind == SPHERE:
        return _make_ball(detail, is_capsule=False), np.repeat(radius, 3, axis=1), zero
    if kind == CAPSULE:
        return _make_ball(detail, is_capsule=True), np.repeat(radius, 3, axis=1), size[:, 1]
    return _make_cylinder(detail), np.hstack([radius, radius, zero[:, None]]), size[:, 1]


def _make_box() -> Shape:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Shape(corners, np.zeros(8), _halve(np.array(quads)))


def _halve(quads: NDArray[np.integer]) -> NDArray[np.uint32]:
    """Two triangles for each quad, shape (n, 4)."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)


def _turn(segments: int, radius: Float, z: Float, end: Float) -> Shape:
    """Turn a line round z: radius, height and `Shape.end` of its points, from the top down."""
    angle = np.arange(segments) * (2 * np.pi / segments)
    x, y = np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))
    unit = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1).reshape(-1, 3)
    row, col = np.mgrid[: len(radius) - 1, :segments]
    right = (col + 1) % segments
    corners = (row, col), (row + 1, col), (row + 1, right), (row, right)
    line = np.stack([radius, z, end])
    is_same = (line[:, 1:] == line[:, :-1]).all(axis=0)  # two rows at one place
    quads = np.stack([(a * segments + b).ravel() for a, b in corners], axis=1)
    faces = _halve(quads[~np.repeat(is_same, segments)])
    ends = faces // segments
    # at a pole, one of the two triangles has no area
    flat = (radius[ends] == 0).sum(axis=1) > 1
    return Shape(unit, np.repeat(end, segments), faces[~flat])


@cache
def _make_ball(detail: tuple[int, int], *, is_capsule: bool) -> Shape:
    angle = np.linspace(0, np.pi / 2, detail[1] + 1)
    upper = np.stack([np.sin(angle), np.cos(angle)])
    upper[0, 0] = 0.0
    lower = (upper * [[1], [-1]])[:, ::-1]
    lower = lower if is_capsule else lower[:, 1:]
    radius, z = np.hstack([upper, lower])
    end = np.repeat([1.0, -1.0], [upper.shape[1], lower.shape[1]]) * is_capsule
    return _turn(detail[0], radius, z, end)


@cache
def _make_cylinder(detail: tuple[int, int]) -> Shape:
    # edges twice, so that the round side and the flat ends are shaded apart
    radius, end = np.array([0.0, 1, 1, 1, 1, 0]), np.array([1.0, 1, 1, -1, -1, -1])
    return _turn(detail[0], radius, np.zeros(6), end)


_BOX = _make_box()
