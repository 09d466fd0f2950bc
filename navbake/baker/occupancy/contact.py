"""FCL's word on whether a solid meets a cell's prism; the one user of fcl."""

from __future__ import annotations

from collections.abc import Callable

import fcl

from navbake.baker.kernels.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE
from navbake.baker.scene.shapes import Solids
from navbake.types import Float

GEOMETRY: dict[int, Callable[[Float], fcl.CollisionGeometry]] = {
    SPHERE: lambda size: fcl.Sphere(size[0]),
    CAPSULE: lambda size: fcl.Capsule(size[0], 2 * size[1]),
    ELLIPSOID: lambda size: fcl.Ellipsoid(*size),
    CYLINDER: lambda size: fcl.Cylinder(size[0], 2 * size[1]),
    BOX: lambda size: fcl.Box(*(2 * size)),
}


def prisms(square: float, radius: float, half_z: float) -> list[fcl.CollisionGeometry]:
    """A cell's footprint over its band: a box for the square, a cylinder for the disc.

    Args:
        square: half of the square's edge, 0 for none [m].
        radius: the disc's radius, 0 for none [m].
        half_z: half of the band's height [m].
    """
    shapes = []
    if square > 0:
        shapes.append(fcl.Box(2 * square, 2 * square, 2 * half_z))
    if radius > 0:
        shapes.append(fcl.Cylinder(radius, 2 * half_z))
    return shapes


def solid_touches(
    solids: Solids, index: int, center: Float, shapes: list[fcl.CollisionGeometry]
) -> bool:
    """Whether a solid meets any of the shapes, all centred at one point.

    Args:
        solids: the solids.
        index: which of them.
        center: shape (3,), world frame [m].
        shapes: see `prisms`.
    """
    place = fcl.Transform(solids.mat[index].reshape(3, 3), solids.pos[index])
    solid = fcl.CollisionObject(GEOMETRY[int(solids.kind[index])](solids.size[index]), place)
    return any(
        fcl.collide(fcl.CollisionObject(shape, fcl.Transform(center)), solid) > 0
        for shape in shapes
    )
