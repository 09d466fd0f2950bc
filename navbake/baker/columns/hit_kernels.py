"""Sort the hits of a vertical line, and drop hits until each crossing is counted once.

Hits are sorted by insertion, as most columns are short and nearly sorted.

A line through an edge that triangles share is the hard case. A line hits all triangles that it
misses by at most RIM_WIDTH; so of two hits on neighboring triangles of a mesh, one is dropped. A
line within a vertical side of a closed surface hits triangles that rounding has tilted a little.
The steepest of them are dropped until the line leaves the surface as often as it enters it;
otherwise everything below would count as inside.

A part, here, is a connected closed part of a geom's mesh, see `Facets.part`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.constants import OPEN_SURFACE
from navbake.baker.core.tolerances import SAME_HEIGHT
from navbake.baker.geometry.triangle_kernels import unit_normal
from navbake.compiled import NO_REFCOUNT, subkernel
from navbake.types import Bool, Float, Int32

# A line that misses a shape's rim by at most this crosses the shape, so that seams between geoms
# never leak [m]
RIM_WIDTH = 1e-7
# Values of `LineHits.facet` of hits on other shapes than triangles
OF_SOLID = np.int32(-1)
OF_PLANE = np.int32(-2)
# Value of `geom` of dropped hits; they stand after the last valid hit of their column
DROPPED = np.int32(-1)
# Values of `LineHits.at_edge`; for plain bools, numba would compile functions again
INSIDE = np.bool_(False)
AT_EDGE = np.bool_(True)


class LineHits(NamedTuple):
    """Hits of some vertical lines while they are collected.

    Attributes:
        z, normal, geom, closed: as in `ColumnHits`.
        facet: the index of the triangle that is hit, OF_SOLID or OF_PLANE, (n,) int32.
        at_edge: whether a triangle is hit at most RIM_WIDTH from its edge, (n,) bool.
    """

    z: Float
    normal: NDArray[np.float32]
    geom: Int32
    closed: NDArray[np.uint8]
    facet: Int32
    at_edge: Bool


@subkernel
def make_hits(count):
    """Allocate room for `count` hits."""
    z = np.empty(count)
    normal = np.empty((count, 3), np.float32)
    geom = np.empty(count, np.int32)
    closed = np.empty(count, np.uint8)
    facet = np.empty(count, np.int32)
    return LineHits(z, normal, geom, closed, facet, np.empty(count, np.bool_))


@subkernel
def view_hits(column_hits, first, end):
    """Return some hits of columns as `LineHits`, so that writing to these writes to the columns.

    Args:
        column_hits: the columns, as `ColumnHits`.
        first, end: range of hits.
    """
    z = column_hits.z[first:end]
    normal = column_hits.normal[first:end]
    geom = column_hits.geom
    closed = column_hits.closed[first:end]
    facet = np.empty(end - first, np.int32)
    return LineHits(z, normal, geom[first:end], closed, facet, np.empty(end - first, np.bool_))


@subkernel(forceinline=True)
def copy_hit(hits, source, target_hits, target):
    """Copy a hit to another place.

    Args:
        hits: `LineHits` to copy from.
        source: number of the hit.
        target_hits: `LineHits` to copy to, the same or another one.
        target: number of the copy.
    """
    target_hits.z[target] = hits.z[source]
    for axis in range(3):
        target_hits.normal[target, axis] = hits.normal[source, axis]
    target_hits.geom[target] = hits.geom[source]
    target_hits.closed[target] = hits.closed[source]
    target_hits.facet[target] = hits.facet[source]
    target_hits.at_edge[target] = hits.at_edge[source]


@subkernel(forceinline=True)
def _is_less(first_hits, i, hits, j):
    """Return whether hit i of `first_hits` comes before hit j of `hits` in a column.

    The lower hit comes first; of two at one height, the one of the lower geom id; of two of one
    geom, the one on an underside.
    """
    if first_hits.z[i] != hits.z[j]:
        return first_hits.z[i] < hits.z[j]
    if first_hits.geom[i] != hits.geom[j]:
        return first_hits.geom[i] < hits.geom[j]
    return (first_hits.normal[i, 2] > 0.0) < (hits.normal[j, 2] > 0.0)


@subkernel(inline="always")
def _sort(hits, first, end, spare, spare_place):
    """Sort the hits ``first:end`` of a line by insertion, in the order of `_is_less`.

    `spare` is a `LineHits` with room for one hit at index `spare_place`.
    """
    for i in range(first + 1, end):
        if not _is_less(hits, i, hits, i - 1):
            continue
        copy_hit(hits, i, spare, spare_place)
        j = i
        while j > first and _is_less(spare, spare_place, hits, j - 1):
            copy_hit(hits, j - 1, hits, j)
            j -= 1
        copy_hit(spare, spare_place, hits, j)


@subkernel(inline="always")
def _has_edge(hits, first, end):
    """Return whether any of the hits ``first:end`` of a line is at the edge of a triangle."""
    at_edge = hits.at_edge
    for i in range(first, end):  # noqa: SIM110 (numba has no generators in `any`)
        if at_edge[i]:
            return True
    return False


@subkernel(inline="always")
def _is_same_part(hits, i, j, facets):
    """Return whether hits i and j are of triangles of the same part of the same geom."""
    is_same_geom = hits.geom[i] == hits.geom[j]
    return is_same_geom and facets.part[hits.facet[i]] == facets.part[hits.facet[j]]


@subkernel(inline="always")
def _drop_doubles(hits, first, end, facets):
    """Drop one of two hits on neighboring triangles, where a line runs through their shared edge.

    The line has the hits ``first:end``. Returns the index past the last hit that remains.
    """
    remaining_end = first
    for i in range(first, end):
        is_double = False
        if hits.at_edge[i]:
            j = remaining_end - 1
            while j >= first and hits.z[i] - hits.z[j] <= SAME_HEIGHT:
                is_same_side = (hits.normal[i, 2] > 0.0) == (hits.normal[j, 2] > 0.0)
                if hits.at_edge[j] and is_same_side and _is_same_part(hits, i, j, facets):
                    is_double = True
                    break
                j -= 1
        if not is_double:
            copy_hit(hits, i, hits, remaining_end)
            remaining_end += 1
    return remaining_end


@subkernel(inline="always")
def _steepest_of_part(hits, first, end, i, facets, side):
    """Find the steepest triangle that a line hits at an edge, in the same mesh part as hit i.

    The line has the hits ``first:end``. Only triangles that face up count if `side` is 1, only
    those that face down if it is -1. Returns the index of the hit, -1 for none.
    """
    steepest = np.int64(-1)
    least_up = 0.0
    for j in range(first, end):
        if not hits.at_edge[j] or not _is_same_part(hits, i, j, facets):
            continue
        up = side * unit_normal(facets.corners, hits.facet[j])[2]
        if up > 0.0 and (steepest < 0 or up < least_up):
            steepest = np.int64(j)
            least_up = up
    return steepest


@subkernel(inline="always")
def _balance_parts(hits, first, end, facets):
    """Drop hits at edges until the line leaves each closed part of a mesh as often as it enters it.

    The line has the hits ``first:end``. Returns the index past the last hit that remains.
    """
    i = first
    while i < end:
        surplus = 0
        if hits.at_edge[i] and hits.closed[i] != OPEN_SURFACE:
            for j in range(first, end):
                if hits.facet[j] >= 0 and _is_same_part(hits, i, j, facets):
                    surplus += 1 if hits.normal[j, 2] > 0.0 else -1
        dropped = np.int64(-1)
        if surplus != 0:
            side = 1.0 if surplus > 0 else -1.0
            dropped = _steepest_of_part(hits, first, end, i, facets, side)
        if dropped < 0:
            i += 1
            continue
        for j in range(dropped + 1, end):
            copy_hit(hits, j, hits, j - 1)
        end -= 1
        # hit i is tested again; if an earlier one was dropped, it is at i - 1 now
        if dropped < i:
            i -= 1
    return end


@subkernel(**NO_REFCOUNT)
def _clean_edges(hits, first, end, facets):
    """Drop superfluous hits at edges of triangles, so that each crossing is counted once.

    The line has the hits ``first:end``. Returns the index past the last hit that remains.
    """
    return _balance_parts(hits, first, _drop_doubles(hits, first, end, facets), facets)


@subkernel(inline="always")
def finish_line(hits, first, end, facets, spare, spare_place):
    """Turn the collected hits of a line into a column: sort them, and keep each crossing once.

    Args:
        hits: `LineHits`; the line has the hits ``first:end``. They are sorted in place; the last
            ones get DROPPED as their geom.
        first, end: range of the line's hits.
        facets: the triangles, as `Facets`.
        spare: `LineHits` that has room for one hit, as scratch.
        spare_place: index of this room in `spare`.

    Returns:
        How many hits were dropped, int64.
    """
    _sort(hits, first, end, spare, spare_place)
    if not _has_edge(hits, first, end):
        return np.int64(0)
    remaining_end = _clean_edges(hits, first, end, facets)
    for i in range(remaining_end, end):
        hits.geom[i] = DROPPED
    return end - remaining_end
