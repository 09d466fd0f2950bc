"""Asks FCL whether a solid meets a cell's prism. Only this module imports fcl."""

from collections.abc import Callable
from typing import Any

from navbake.baker.kernels.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE
from navbake.baker.scene.shapes import Solids
from navbake.lazy import lazy
from navbake.types import Float, Int32

fcl = lazy("fcl")  # few scenes have a cell that nothing else decides

GEOMETRY: dict[int, Callable[[Float], Any]] = {
    SPHERE: lambda size: fcl.Sphere(size[0]),
    CAPSULE: lambda size: fcl.Capsule(size[0], 2 * size[1]),
    ELLIPSOID: lambda size: fcl.Ellipsoid(*size),
    CYLINDER: lambda size: fcl.Cylinder(size[0], 2 * size[1]),
    BOX: lambda size: fcl.Box(*(2 * size)),
}


def touch_prism(
    solids: Solids, chosen: Int32, center: Float, square: float, radius: float, half_z: float
) -> bool:
    """Whether any of the chosen solids meets an upright prism: a square joined with a disc.

    Args:
        chosen: indices of solids.
        center: the prism's centre, shape (3,) [m].
        square: half of the square's edge, 0 for none [m].
        radius: the disc's radius, 0 for none [m].
        half_z: half of the prism's height [m].
    """
    box = [fcl.Box(2 * square, 2 * square, 2 * half_z)] if square > 0 else []
    shapes = box + ([fcl.Cylinder(radius, 2 * half_z)] if radius > 0 else [])
    prisms = [fcl.CollisionObject(shape, fcl.Transform(center)) for shape in shapes]
    for index in chosen:
        place = fcl.Transform(solids.mat[index].reshape(3, 3), solids.pos[index])
        solid = fcl.CollisionObject(GEOMETRY[int(solids.kind[index])](solids.size[index]), place)
        if any(fcl.collide(prism, solid) > 0 for prism in prisms):
            return True
    return False
