"""Finds skies: solids around everything else in a scene, which are there for looks.

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

# What lies inside of a sky covers at least this area, seen from above; what lies inside of a
# smaller solid is hidden in a thing [m²]
MIN_INNER_AREA = 4.0
# MuJoCo's types from sphere to box; capsule, ellipsoid and cylinder lie between them
SOLID_TYPES = range(constants.SPHERE, constants.BOX + 1)


def find_skies(
    model: mujoco.MjModel, data: mujoco.MjData, counted: Bool, min_room: float
) -> list[int]:
    """Find the skies of a scene: solids that enclose all other geoms, and room for an agent.

    Several solids that enclose each other are all skies. Geoms that can move are no skies, and need
    not be enclosed, so that a sky is one in any pose. There is no sky in a scene with a plane that
    counts, nor where the enclosed geoms cover less than `MIN_INNER_AREA`.

    Args:
        model: the model.
        data: its pose.
        counted: which geoms count, shape (ngeom,).
        min_room: the least distance from the lowest of the enclosed geoms' tops to the solid's top
            [m].

    Returns:
        The ids of the geoms, the largest first.
    """
    low, high = geom_boxes(model, data)
    body = model.geom_bodyid
    stands = counted & (model.body_weldid[body] == 0) & (model.body_mocapid[body] < 0)
    if (stands & (model.geom_type == constants.PLANE)).any():
        return []
    is_finite = stands & (model.geom_type != constants.PLANE)
    is_finite &= np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
    others = np.flatnonzero(is_finite)
    skies = list[int]()
    while len(others) > 1:
        largest = int(others[np.argmax((high[others] - low[others]).prod(axis=1))])
        inner = others[others != largest]
        if model.geom_type[largest] not in SOLID_TYPES:
            break
        if (low[inner] < low[largest]).any() or (high[inner] > high[largest]).any():
            break
        if high[largest, 2] - high[inner, 2].min() < min_room:
            break
        inner_width, inner_depth = (high[inner].max(axis=0) - low[inner].min(axis=0))[:2]
        if inner_width * inner_depth < MIN_INNER_AREA:
            break
        if not _encloses(model, data, largest, _box_corners(low[inner], high[inner])):
            break
        skies.append(largest)
        others = inner
    return skies


def geom_boxes(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Float, Float]:
    """Return the lowest and the highest corner of each geom's bounding box, (ngeom, 3) each [m]."""
    rotation = data.geom_xmat.reshape(-1, 3, 3)
    box = model.geom_aabb
    with np.errstate(all="ignore"):  # the numbers of strangers' models
        center = data.geom_xpos + (rotation @ box[:, :3, None])[..., 0]
        half_size = (np.abs(rotation) @ box[:, 3:, None])[..., 0]
        return center - half_size, center + half_size


def _box_corners(low: Float, high: Float) -> Float:
    """Return the eight corners of each box, shape (8 n, 3)."""
    takes_high = np.array(list(np.ndindex(2, 2, 2)), dtype=np.bool_)
    corners: Float = np.where(takes_high, high[:, None], low[:, None])
    return corners.reshape(-1, 3)


def _encloses(model: mujoco.MjModel, data: mujoco.MjData, geom: int, points: Float) -> bool:
    """Return whether all points, shape (n, 3), world frame, lie inside a solid geom."""
    rotation = data.geom_xmat[geom].reshape(3, 3)
    local = (points - data.geom_xpos[geom]) @ rotation
    size = model.geom_size[geom] + TOUCH_DEPTH
    geom_type = int(model.geom_type[geom])
    if geom_type == constants.BOX:
        return bool((np.abs(local) <= size).all())
    if geom_type == constants.ELLIPSOID:
        return bool((((local / size) ** 2).sum(axis=1) <= 1.0).all())
    radius = np.hypot(local[:, 0], local[:, 1])
    beyond = np.abs(local[:, 2])
    if geom_type == constants.CYLINDER:
        return bool(((radius <= size[0]) & (beyond <= size[1])).all())
    if geom_type == constants.CAPSULE:
        beyond = np.maximum(beyond - size[1], 0.0)
    return bool((np.hypot(radius, beyond) <= size[0]).all())
