"""Hits: what vertical lines cross, in the order in which it was found, and how they become columns.

Hits are sorted by insertion, which is stable: most columns are short and nearly sorted. A line
through an edge that triangles share is the hard case. It hits whatever it passes within RIM; of two
hits of neighbouring triangles of one part, one is dropped. A line within an upright side of a
closed part hits triangles that rounding has tilted a little: the steepest of them are dropped until
the part is left as often as it was entered. Else all that lies below would count as inside.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.constants import OPEN_SURFACE
from navbake.baker.core.tolerances import SAME_HEIGHT
from navbake.baker.geometry.triangle_kernels import unit_normal
from navbake.compiled import NO_REFCOUNT, subkernel
from navbake.types import Bool, Float, Int32

# Lines this close to a rim cross it, so that seams between geoms never leak [m]
RIM = 1e-7
# In place of a triangle's number
OF_SOLID = np.int32(-1)
OF_PLANE = np.int32(-2)
# In place of the geom of hits behind a column's end, which were dropped
DROPPED = np.int32(-1)
# Whether a hit is at a triangle's edge; plain bools would be types of their own
INSIDE = np.bool_(False)
AT_EDGE = np.bool_(True)


class Hits(NamedTuple):
    """Hits of some lines; the first four are parts of `ColumnHits`, the others are scratch.

    Attributes:
        z, normal, geom, closed: as in `ColumnHits`.
        facet: the triangle that was hit, OF_SOLID or OF_PLANE.
        at_edge: whether a triangle was hit within RIM of its edge.
    """

    z: Float
    normal: NDArray[np.float32]
    geom: Int32
    closed: NDArray[np.uint8]
    facet: Int32
    at_edge: Bool


@subkernel
def make_hits(count):
    """Room for some hits of their own."""
    z = np.empty(count)
    normal = np.empty((count, 3), np.float32)
    geom = np.empty(count, np.int32)
    closed = np.empty(count, np.uint8)
    facet = np.empty(count, np.int32)
    return Hits(z, normal, geom, closed, facet, np.empty(count, np.bool_))


@subkernel
def hits_of(column_hits, first, last):
    """ColumnHits ``[first:last]``, with scratch."""
    z = column_hits.z[first:last]
    normal = column_hits.normal[first:last]
    geom = column_hits.geom
    closed = column_hits.closed[first:last]
    facet = np.empty(last - first, np.int32)
    return Hits(z, normal, geom[first:last], closed, facet, np.empty(last - first, np.bool_))


@subkernel(forceinline=True)
def copy_hit(hits, source, into, target):
    """Copy a hit to a place of the same hits or of others."""
    into.z[target] = hits.z[source]
    for axis in range(3):
        into.normal[target, axis] = hits.normal[source, axis]
    into.geom[target] = hits.geom[source]
    into.closed[target] = hits.closed[source]
    into.facet[target] = hits.facet[source]
    into.at_edge[target] = hits.at_edge[source]


@subkernel(forceinline=True)
def _is_less(one, i, hits, j):
    """Whether a hit comes before another: by height, then geom, undersides first."""
    if one.z[i] != hits.z[j]:
        return one.z[i] < hits.z[j]
    if one.geom[i] != hits.geom[j]:
        return one.geom[i] < hits.geom[j]
    return (one.normal[i, 2] > 0.0) < (hits.normal[j, 2] > 0.0)


@subkernel(inline="always")
def _sort(hits, first, last, spare, place):
    """Sort the hits of a line by insertion; `spare` has room for one at a place."""
    for i in range(first + 1, last):
        if not _is_less(hits, i, hits, i - 1):
            continue
        copy_hit(hits, i, spare, place)
        j = i
        while j > first and _is_less(spare, place, hits, j - 1):
            copy_hit(hits, j - 1, hits, j)
            j -= 1
        copy_hit(spare, place, hits, j)


@subkernel(inline="always")
def _has_edge(hits, first, last):
    """Whether any hit of a line is at a triangle's edge; of most lines none is."""
    at_edge = hits.at_edge
    for i in range(first, last):  # noqa: SIM110 (numba has no generators in `any`)
        if at_edge[i]:
            return True
    return False


@subkernel(inline="always")
def _is_same_part(hits, i, j, facets):
    """Whether two hits of triangles are of one part of one geom."""
    is_same_geom = hits.geom[i] == hits.geom[j]
    return is_same_geom and facets.part[hits.facet[i]] == facets.part[hits.facet[j]]


@subkernel(inline="always")
def _drop_doubles(hits, first, last, facets):
    """Drop hits that two neighbouring triangles of a part have at their shared edge."""
    kept = first
    for i in range(first, last):
        is_double = False
        if hits.at_edge[i]:
            j = kept - 1
            while j >= first and hits.z[i] - hits.z[j] <= SAME_HEIGHT:
                same_side = (hits.normal[i, 2] > 0.0) == (hits.normal[j, 2] > 0.0)
                if hits.at_edge[j] and same_side and _is_same_part(hits, i, j, facets):
                    is_double = True
                    break
                j -= 1
        if not is_double:
            copy_hit(hits, i, hits, kept)
            kept += 1
    return kept


@subkernel(inline="always")
def _steepest_of_part(hits, first, last, i, facets, side):
    """The steepest hit at an edge of the i-th one's part that faces up (1) or down (-1), or -1."""
    steepest = np.int64(-1)
    up = 0.0
    for j in range(first, last):
        if not hits.at_edge[j] or not _is_same_part(hits, i, j, facets):
            continue
        rise = side * unit_normal(facets.corners, hits.facet[j])[2]
        if rise > 0.0 and (steepest < 0 or rise < up):
            steepest = np.int64(j)
            up = rise
    return steepest


@subkernel(inline="always")
def _balance_parts(hits, first, last, facets):
    """Drop hits at edges, so that each closed part is left as often as it is entered."""
    i = first
    while i < last:
        surplus = 0
        if hits.at_edge[i] and hits.closed[i] != OPEN_SURFACE:
            for j in range(first, last):
                if hits.facet[j] >= 0 and _is_same_part(hits, i, j, facets):
                    surplus += 1 if hits.normal[j, 2] > 0.0 else -1
        dropped = np.int64(-1)
        if surplus != 0:
            side = 1.0 if surplus > 0 else -1.0
            dropped = _steepest_of_part(hits, first, last, i, facets, side)
        if dropped < 0:
            i += 1
            continue
        for j in range(dropped + 1, last):
            copy_hit(hits, j, hits, j - 1)
        last -= 1
        # the i-th one is looked at again, and it is the next one where an earlier one was dropped
        if dropped < i:
            i -= 1
    return last


@subkernel(**NO_REFCOUNT)
def _settle_edges(hits, first, last, facets):
    """Drop the hits at edges that make no crossing; returns where those that stay end."""
    return _balance_parts(hits, first, _drop_doubles(hits, first, last, facets), facets)


@subkernel(inline="always")
def settle(hits, first, last, facets, spare, place):
    """Turn the hits of a line into column_hits: sorted, each once; returns how many were dropped.

    DROPPED is the geom of those behind the last that stays. `spare` has room for one hit at a
    place.
    """
    _sort(hits, first, last, spare, place)
    if not _has_edge(hits, first, last):
        return np.int64(0)
    kept = _settle_edges(hits, first, last, facets)
    for i in range(kept, last):
        hits.geom[i] = DROPPED
    return last - kept
