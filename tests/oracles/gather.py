"""What stands in each cell, the slow way: every cell asks every geom, near or far."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns, TiledShapes
from navbake.baker.kernels.arrays import Prism
from navbake.baker.kernels.constants import APART, MEETS, OPEN_SURFACE, TOUCH, UNDECIDED
from navbake.baker.kernels.gjk import DISC, SQUARE, make_simplex
from navbake.baker.kernels.overlap import (
    ANY_GEOM,
    line_is_blocked,
    make_polygons,
    plane_meets_prism,
    triangle_meets_prism,
)
from navbake.baker.kernels.solids import part_of_solid

# parts of kernels as functions that Python can call
make_simplex = numba.njit(make_simplex.py_func)
plane_meets_prism = numba.njit(plane_meets_prism.py_func)
part_of_solid = numba.njit(part_of_solid.py_func)
line_is_blocked = numba.njit(line_is_blocked.py_func)
triangle_meets_prism = numba.njit(triangle_meets_prism.py_func)
make_polygons = numba.njit(make_polygons.py_func)

SIMPLEX, POLYGONS = make_simplex(), make_polygons()


def prism_over(columns: Columns, cell: int, low: float, high: float, square: float, radius: float):
    x, y = columns.lattice.positions(*divmod(cell, columns.lattice.width))
    return Prism(float(x), float(y), float(low), float(high), float(square), float(radius))


def line_meets(columns: Columns, cell: int, prism: Prism, geom: int = ANY_GEOM) -> bool:
    return line_is_blocked(columns.crossings, cell, prism, np.int32(geom))


def geoms_that_meet(tiled: TiledShapes, prism: Prism) -> dict[int, int]:
    """MEETS or UNDECIDED for each geom that isn't apart from a prism, its line left out."""
    found: dict[int, int] = {}
    shapes = tiled.shapes
    for p, geom in enumerate(shapes.planes.geom.tolist()):
        if plane_meets_prism(shapes.planes, p, prism):
            found[geom] = MEETS
    for t in _boxes_near(tiled.facets.bounds, prism, 2.0 * TOUCH):
        edge = 2.0 * TOUCH if tiled.facets.closed[t] == OPEN_SURFACE else 0.0
        if t not in _boxes_near(tiled.facets.bounds, prism, edge):
            continue
        wider = {
            "square": prism.square + edge if prism.square else 0.0,
            "radius": prism.radius + edge if prism.radius else 0.0,
        }
        fields = zip(type(prism).__match_args__, prism, strict=True)
        asked = type(prism)(**{**dict(fields), **wider})
        if triangle_meets_prism(tiled.facets.corners[t], asked, POLYGONS):
            found[int(tiled.facets.geom[t])] = MEETS
    for s in _boxes_near(shapes.solids.bounds, prism, 0.0):
        parts = [part_of_solid(shapes.solids, s, prism, part, SIMPLEX) for part in (SQUARE, DISC)]
        if set(parts) != {APART}:
            found[int(shapes.solids.geom[s])] = MEETS if MEETS in parts else UNDECIDED
    return found


def _boxes_near(bounds: NDArray[np.float64], prism: Prism, edge: float) -> list[int]:
    """The boxes that aren't beside a prism; touching is beside it."""
    reach = max(prism.square, prism.radius) + edge
    low = np.array([prism.x - reach, prism.y - reach, prism.low])
    high = np.array([prism.x + reach, prism.y + reach, prism.high])
    return np.flatnonzero(((bounds[:, :3] < high) & (bounds[:, 3:] > low)).all(axis=1)).tolist()
