"""What the viewer's page draws of flights: voxels below a cut, and paths of a ball as tubes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from navbake.lazy import lazy
from navbake.navgrid.colors import rgb_of
from navbake.types import Float, Int
from navbake.views.boxes import Boxes
from navbake.views.viewer.meshes import CAP_SHADE, Surface, draw_surfaces, to_linear_rgba

trimesh = lazy("trimesh")  # loads slowly

VOXEL_MARGIN = 0.003  # boxes are larger on each side, so that geometry doesn't flicker [m]
LOW_SHADE = 0.55  # brightness of the lowest voxels, relative to the highest
END_SCALE = 1.15  # of the balls at both ends of a tube, relative to its radius
STRAIGHT_TOLERANCE = 1e-6  # how far a point may be off a line that goes on straight [m]
NUM_SIDES = 24  # of a tube
# corners of a cube from (-1, -1, -1) to (1, 1, 1), by face, and the triangles of a face
FACE_CORNERS = np.array(
    [
        [(side, u, v) if axis == 0 else (u, side, v) if axis == 1 else (u, v, side)
         for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        for axis in range(3)
        for side in (-1, 1)
    ]
)  # fmt: skip
TOP_FACE = 5
FACE_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def draw_voxels(boxes: Boxes, height: float | None) -> bytes:
    """Draw voxels below a height; boxes that the cut goes through have a dark face there.

    Higher voxels are brighter.

    Args:
        boxes: the voxels as boxes along the world's axes, see `merge_voxels`.
        height: world z of the cut [m]; None to draw all.

    Returns:
        The triangles as GLB.
    """
    lower = boxes.centers - boxes.half_sizes
    upper = boxes.centers + boxes.half_sizes
    lowest_z = lower[:, 2].min(initial=0.0)
    highest_z = upper[:, 2].max(initial=0.0)
    rgb = boxes.rgb
    is_cut = np.zeros(len(lower), dtype=np.bool_)
    if height is not None:
        # the margin absorbs rounding where the cut is along faces
        is_below = lower[:, 2] < height - VOXEL_MARGIN
        lower = lower[is_below]
        is_cut = upper[is_below, 2] > height + VOXEL_MARGIN
        upper = upper[is_below].copy()
        upper[:, 2] = np.minimum(upper[:, 2], height)
        rgb = rgb[is_below]
    centers = (lower + upper) / 2.0
    half_sizes = (upper - lower) / 2.0 + VOXEL_MARGIN
    # shape (boxes, faces, corners, 3)
    corners = centers[:, None, None] + half_sizes[:, None, None] * FACE_CORNERS
    num_corners = FACE_CORNERS.shape[0] * FACE_CORNERS.shape[1]
    vertex_colors = np.ones((*corners.shape[:3], 4), dtype=np.float32)
    vertex_colors[..., :3] = to_linear_rgba(rgb / 255.0)[:, None, None, :3]
    heights = (corners[..., 2] - lowest_z) / max(highest_z - lowest_z, VOXEL_MARGIN)
    vertex_colors[..., :3] *= (LOW_SHADE + (1.0 - LOW_SHADE) * heights)[..., None]
    vertex_colors[is_cut, TOP_FACE, :, :3] *= CAP_SHADE
    first_corners = np.arange(len(corners) * num_corners).reshape(-1, 4)[:, 0]
    faces = first_corners[:, None, None] + FACE_TRIANGLES
    surface = Surface(
        vertices=corners.reshape(-1, 3).astype(np.float32),
        faces=faces.reshape(-1, 3).astype(np.uint32),
        colors=vertex_colors.reshape(-1, 4),
        is_round=True,  # each face has corners of its own, so its edges are sharp
    )
    return draw_surfaces([surface], {})


def draw_tube(positions: Float, radius: float, start_color: str, color: str) -> bytes:
    """Draw what a ball sweeps on its way, and the ball at its start and its end.

    Args:
        positions: world x, y, z of the ball's centre [m], shape (n, 3), n >= 1.
        radius: radius of the ball [m].
        start_color: colour of the ball at the start, ``#rrggbb``.
        color: colour of the tube and of the ball at the end, ``#rrggbb``.

    Returns:
        The triangles as GLB.
    """
    corners = _drop_straight_points(positions)
    surfaces = [
        _make_ball(positions[0], END_SCALE * radius, start_color),
        _make_ball(positions[-1], END_SCALE * radius, color),
    ]
    surfaces += [_make_ball(corner, radius, color) for corner in corners[1:-1]]
    for begin, end in pairwise(corners):
        if not np.array_equal(begin, end):
            leg = trimesh.creation.cylinder(radius, segment=[begin, end], sections=NUM_SIDES)
            surfaces.append(_make_surface(leg.vertices, leg.faces, color))
    return draw_surfaces(surfaces, {})


def _drop_straight_points(positions: Float) -> Float:
    """Leave out points at which a line goes on straight: their joints would show on the tube."""
    corners = [positions[0]]
    for point, next_point in pairwise(positions[1:]):
        # how far the point is off the line from the last corner to the next point: the area of a
        # parallelogram over its base; multiplied by the base, since that may be 0
        base = next_point - corners[-1]
        area = np.linalg.norm(np.cross(base, point - corners[-1]))
        if area > STRAIGHT_TOLERANCE * np.linalg.norm(base):
            corners.append(point)
    return np.array([*corners, positions[-1]])


def _make_ball(center: Float, radius: float, color: str) -> Surface:
    """Make a ball round a point, world x, y, z [m], of one colour, ``#rrggbb``."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return _make_surface(ball.vertices + center, ball.faces, color)


def _make_surface(vertices: Float, faces: Int, color: str) -> Surface:
    """Make a surface of one colour, ``#rrggbb``."""
    rgba = np.array([*rgb_of(color), 255.0]) / 255.0
    return Surface(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.uint32),
        colors=np.tile(to_linear_rgba(rgba), (len(vertices), 1)),
        is_round=True,
    )
