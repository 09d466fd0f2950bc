"""Finds skies: solids around everything else in a scene, which only serve as a background.

Does not import mujoco.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navbake.baker.core import constants
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.types import Bool, Float

if TYPE_CHECKING:
    import mujoco

# The geoms inside of a sky cover at least this area, seen from above [m²]: geoms inside of a
# smaller solid are hidden in a thing
MIN_INNER_AREA = 4.0
# MuJoCo's types from sphere to box; capsule, ellipsoid and cylinder lie between them
SOLID_TYPES = range(constants.SPHERE, constants.BOX + 1)


def find_skies(
    model: mujoco.MjModel, data: mujoco.MjData, is_counted: Bool, min_room: float
) -> list[int]:
    """Find the skies of a scene: solids around all other geoms, with room for an agent inside.

    A sky is a box or another solid that only serves as a background. If several solids enclose each
    other, all are skies. A geom that can move is no sky. It also need not be inside of a sky, so
    that the same geoms are skies in any pose. A scene has no sky if a plane in it counts, or if
    what a solid encloses covers less than `MIN_INNER_AREA`.

    Args:
        model: the model.
        data: its pose.
        is_counted: for each geom, whether it counts, shape (ngeom,), bool.
        min_room: how high the top of a sky has to be at least over the lowest of the tops of the
            geoms inside of it [m].

    Returns:
        The ids of the geoms, the largest first.
    """
    lowest_corners, highest_corners = geom_boxes(model, data)
    body_of_geom = model.geom_bodyid
    is_static_geom = (
        is_counted & (model.body_weldid[body_of_geom] == 0) & (model.body_mocapid[body_of_geom] < 0)
    )
    if (is_static_geom & (model.geom_type == constants.PLANE)).any():
        return []
    is_finite_geom = is_static_geom & (model.geom_type != constants.PLANE)
    is_finite_geom &= np.isfinite(lowest_corners).all(axis=1) & np.isfinite(highest_corners).all(
        axis=1
    )
    remaining_geoms = np.flatnonzero(is_finite_geom)
    skies = list[int]()
    while len(remaining_geoms) > 1:
        largest_geom = int(
            remaining_geoms[
                np.argmax(
                    (highest_corners[remaining_geoms] - lowest_corners[remaining_geoms]).prod(
                        axis=1
                    )
                )
            ]
        )
        inner_geoms = remaining_geoms[remaining_geoms != largest_geom]
        if model.geom_type[largest_geom] not in SOLID_TYPES:
            break
        if (lowest_corners[inner_geoms] < lowest_corners[largest_geom]).any() or (
            highest_corners[inner_geoms] > highest_corners[largest_geom]
        ).any():
            break
        if highest_corners[largest_geom, 2] - highest_corners[inner_geoms, 2].min() < min_room:
            break
        inner_width, inner_depth = (
            highest_corners[inner_geoms].max(axis=0) - lowest_corners[inner_geoms].min(axis=0)
        )[:2]
        if inner_width * inner_depth < MIN_INNER_AREA:
            break
        if not _encloses(
            model,
            data,
            largest_geom,
            _list_box_corners(lowest_corners[inner_geoms], highest_corners[inner_geoms]),
        ):
            break
        skies.append(largest_geom)
        remaining_geoms = inner_geoms
    return skies


def geom_boxes(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Float, Float]:
    """Return the lowest and the highest corner of each geom's bounding box, (ngeom, 3) each [m]."""
    rotation = data.geom_xmat.reshape(-1, 3, 3)
    local_boxes = model.geom_aabb
    with np.errstate(all="ignore"):  # the numbers of strangers' models
        center = data.geom_xpos + (rotation @ local_boxes[:, :3, None])[..., 0]
        half_size = (np.abs(rotation) @ local_boxes[:, 3:, None])[..., 0]
        return center - half_size, center + half_size


def _list_box_corners(lowest_corners: Float, highest_corners: Float) -> Float:
    """Return the eight corners of each box, shape (8 n, 3)."""
    takes_high = np.array(list(np.ndindex(2, 2, 2)), dtype=np.bool_)
    corners: Float = np.where(takes_high, highest_corners[:, None], lowest_corners[:, None])
    return corners.reshape(-1, 3)


def _encloses(model: mujoco.MjModel, data: mujoco.MjData, geom: int, points: Float) -> bool:
    """Return whether all points, shape (n, 3), world frame, lie inside a solid geom."""
    rotation = data.geom_xmat[geom].reshape(3, 3)
    local_points = (points - data.geom_xpos[geom]) @ rotation
    size = model.geom_size[geom] + TOUCH_DEPTH
    geom_type = int(model.geom_type[geom])
    if geom_type == constants.BOX:
        return bool((np.abs(local_points) <= size).all())
    if geom_type == constants.ELLIPSOID:
        return bool((((local_points / size) ** 2).sum(axis=1) <= 1.0).all())
    radius = np.hypot(local_points[:, 0], local_points[:, 1])
    distance_along_axis = np.abs(local_points[:, 2])
    if geom_type == constants.CYLINDER:
        return bool(((radius <= size[0]) & (distance_along_axis <= size[1])).all())
    if geom_type == constants.CAPSULE:
        distance_along_axis = np.maximum(distance_along_axis - size[1], 0.0)
    return bool((np.hypot(radius, distance_along_axis) <= size[0]).all())
