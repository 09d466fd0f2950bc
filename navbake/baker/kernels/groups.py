"""The triangles over each tile by geom, so that a tile asks few geoms instead of many triangles.

A tile's triangles are sorted by geom, as all triangles are. So the groups of all tiles follow
one another in the tiles' list, and where a group begins is where the one before it ends.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from navbake.compiled import UNCOUNTED
from navbake.types import Float, Int


class Groups(NamedTuple):
    """Tile t's triangles by geom: groups ``start[t]`` to ``start[t + 1]``.

    Attributes:
        start: (tiles + 1,) int64.
        first: group g is ``triangle_item[first[g] : first[g + 1]]`` of the tiles, int64.
        box: around its triangles, (groups, 6) float64: lower corner, upper corner [m].
    """

    start: Int
    first: Int
    box: Float


@njit(cache=True, **UNCOUNTED)
def _fill_groups(tile, facets, tiles, groups):
    first, last = tiles.triangle_start[tile], tiles.triangle_start[tile + 1]
    geom, g = -1, groups.start[tile] - 1
    for i in range(first, last):
        t = tiles.triangle_item[i]
        if facets.geom[t] != geom:
            geom = facets.geom[t]
            g += 1
            groups.first[g] = i
            for k in range(6):
                groups.box[g, k] = facets.bounds[t, k]
            continue
        for k in range(3):
            groups.box[g, k] = min(groups.box[g, k], facets.bounds[t, k])
            groups.box[g, 3 + k] = max(groups.box[g, 3 + k], facets.bounds[t, 3 + k])


@njit(cache=True)
def group_triangles(facets, tiles):
    """Group the triangles over each tile by geom."""
    num_tiles = tiles.triangle_start.shape[0] - 1
    start = np.zeros(num_tiles + 1, np.int64)
    for tile in range(num_tiles):
        start[tile + 1], geom = start[tile], -1
        for i in range(tiles.triangle_start[tile], tiles.triangle_start[tile + 1]):
            if facets.geom[tiles.triangle_item[i]] != geom:
                geom = facets.geom[tiles.triangle_item[i]]
                start[tile + 1] += 1
    first = np.full(start[-1] + 1, tiles.triangle_item.shape[0])
    groups = Groups(start, first, np.empty((start[-1], 6)))
    for tile in range(num_tiles):
        _fill_groups(tile, facets, tiles, groups)
    return groups
