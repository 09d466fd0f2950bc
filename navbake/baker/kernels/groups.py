"""The triangles over each tile by geom, so that a tile asks few geoms instead of many triangles.

A tile's triangles are sorted by geom, as all triangles are. So the groups of all tiles follow
one another in the tiles' list, and where a group begins is where the one before it ends.
"""

from typing import NamedTuple

from navbake.compiled import UNCOUNTED, kernel
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


@kernel(nogil=True, **UNCOUNTED)
def count_groups(facets, tiles, count, first, end):
    """Count the groups of the tiles ``range(first, end)``, into (tiles,) int64."""
    geoms, items = facets.geom, tiles.triangle_item
    for tile in range(first, end):
        count[tile], geom = 0, -1
        for i in range(tiles.triangle_start[tile], tiles.triangle_start[tile + 1]):
            if geoms[items[i]] != geom:
                geom = geoms[items[i]]
                count[tile] += 1


@kernel(nogil=True, **UNCOUNTED)
def fill_groups(facets, tiles, groups, first, end):
    """Write the groups of the tiles ``range(first, end)``; `start` is known."""
    for tile in range(first, end):
        geom, g = -1, groups.start[tile] - 1
        for i in range(tiles.triangle_start[tile], tiles.triangle_start[tile + 1]):
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
