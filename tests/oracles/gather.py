"""What stands in each cell, the slow way: every cell asks every geom, near or far."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernel_parts import callable_part
from navbake.baker.columns.columns import Columns, TiledShapes
from navbake.baker.core.arrays import Prism
from navbake.baker.core.constants import APART, MEETS, OPEN_SURFACE, UNDECIDED
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.baker.geometry.gjk_kernels import allocate_simplex
from navbake.baker.geometry.overlap_kernels import (
    allocate_polygons,
    plane_meets_prism,
    triangle_meets_prism,
)
from navbake.baker.geometry.solid_kernels import solid_meets_prism

# parts of kernels as functions that Python can call
allocate_simplex = callable_part(allocate_simplex)
plane_meets_prism = callable_part(plane_meets_prism)
solid_meets_prism = callable_part(solid_meets_prism)
triangle_meets_prism = callable_part(triangle_meets_prism)
allocate_polygons = callable_part(allocate_polygons)

SIMPLEX, POLYGONS = allocate_simplex(), allocate_polygons()


def prisms_over(
    columns: Columns, cell: int, low: float, high: float, square: float, radius: float
) -> list[Prism]:
    """The square and the disc over a cell, as far as they have any width."""
    x, y = columns.lattice.positions(*divmod(cell, columns.lattice.width))
    place = float(x), float(y), float(low), float(high)
    return [
        Prism(*place, float(half), is_round)
        for half, is_round in ((square, False), (radius, True))
        if half > 0
    ]


def line_meets(columns: Columns, cell: int, prism: Prism, geom: int | None = None) -> bool:
    """Whether a column's line crosses a geom (any, if None) in a prism, or runs inside of it."""
    hits = range(columns.start[cell], columns.start[cell + 1])
    of_geom = [i for i in hits if geom is None or columns.geom[i] == geom]
    above = [i for i in of_geom if columns.z[i] >= prism.high and columns.hits.closed[i]]
    inside = sum(1 if columns.normal[i, 2] > 0 else -1 for i in above)
    return inside > 0 or any(prism.low < columns.z[i] < prism.high for i in of_geom)


def geoms_that_meet(tiled: TiledShapes, prisms: list[Prism]) -> dict[int, int]:
    """MEETS or UNDECIDED for each geom that isn't apart from all prisms, its line left out."""
    found: dict[int, int] = {}
    for prism in prisms:
        for geom, answer in _geoms_that_meet(tiled, prism).items():
            found[geom] = MEETS if MEETS in (answer, found.get(geom)) else UNDECIDED
    return found


def _geoms_that_meet(tiled: TiledShapes, prism: Prism) -> dict[int, int]:
    found: dict[int, int] = {}
    shapes = tiled.shapes
    for p, geom in enumerate(shapes.planes.geom.tolist()):
        if plane_meets_prism(shapes.planes, p, prism):
            found[geom] = MEETS
    corners = tiled.facets.corners
    bounds = np.hstack([corners.min(axis=1), corners.max(axis=1)])
    for t in _boxes_near(bounds, prism, 2.0 * TOUCH_DEPTH):
        edge = 2.0 * TOUCH_DEPTH if tiled.facets.closed[t] == OPEN_SURFACE else 0.0
        if t not in _boxes_near(bounds, prism, edge):
            continue
        asked = prism._replace(half_width=prism.half_width + edge)
        if triangle_meets_prism(corners[t], asked, POLYGONS):
            found[int(tiled.facets.geom[t])] = MEETS
    for s in _boxes_near(shapes.solids.bounds, prism, 0.0):
        answer = solid_meets_prism(shapes.solids, s, prism, SIMPLEX)
        if answer != APART:
            found[int(shapes.solids.geom[s])] = answer
    return found


def _boxes_near(bounds: NDArray[np.float64], prism: Prism, edge: float) -> list[int]:
    """The boxes that aren't beside a prism; touching is beside it."""
    reach = prism.half_width + edge
    low = np.array([prism.x - reach, prism.y - reach, prism.low])
    high = np.array([prism.x + reach, prism.y + reach, prism.high])
    return np.flatnonzero(((bounds[:, :3] < high) & (bounds[:, 3:] > low)).all(axis=1)).tolist()
