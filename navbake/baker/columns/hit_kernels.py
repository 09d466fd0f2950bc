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
HIT_OF_SOLID = np.int32(-1)
HIT_OF_PLANE = np.int32(-2)
# Values of `LineHits.is_at_edge`; for plain bools, numba would compile functions again
INSIDE = np.bool_(False)
AT_EDGE = np.bool_(True)


class LineHits(NamedTuple):
    """Hits of some vertical lines while they are collected.

    Attributes:
        z, normal, geom, closed: as in `ColumnHits`.
        facet: the index of the triangle that is hit, HIT_OF_SOLID or HIT_OF_PLANE, (n,) int32.
        is_at_edge: whether a triangle is hit at most RIM_WIDTH from its edge, (n,) bool.
    """

    z: Float
    normal: NDArray[np.float32]
    geom: Int32
    closed: NDArray[np.uint8]
    facet: Int32
    is_at_edge: Bool


@subkernel
def allocate_hits(num_hits):
    """Allocate `LineHits` with room for `num_hits` hits."""
    z = np.empty(num_hits)
    normal = np.empty((num_hits, 3), np.float32)
    geom = np.empty(num_hits, np.int32)
    closed = np.empty(num_hits, np.uint8)
    facet = np.empty(num_hits, np.int32)
    return LineHits(z, normal, geom, closed, facet, np.empty(num_hits, np.bool_))


@subkernel
def view_hits(column_hits, first_hit, end_hit):
    """Return a range of the columns' hits as `LineHits`.

    Its z, normal, geom and closed are views: writing to them writes to the columns. Its facet and
    is_at_edge, which columns lack, are new arrays without values.

    Args:
        column_hits: the columns, as `ColumnHits`.
        first_hit: index of the first hit.
        end_hit: index past the last one.
    """
    z = column_hits.z[first_hit:end_hit]
    normal = column_hits.normal[first_hit:end_hit]
    geom = column_hits.geom
    closed = column_hits.closed[first_hit:end_hit]
    facet = np.empty(end_hit - first_hit, np.int32)
    return LineHits(
        z, normal, geom[first_hit:end_hit], closed, facet, np.empty(end_hit - first_hit, np.bool_)
    )


@subkernel(forceinline=True)
def copy_hit(hits, source_index, target_hits, target_index):
    """Copy a hit to another place.

    Args:
        hits: `LineHits` to copy from.
        source_index: index of the hit.
        target_hits: `LineHits` to copy to, the same or another one.
        target_index: index at which the copy is written.
    """
    target_hits.z[target_index] = hits.z[source_index]
    for axis in range(3):
        target_hits.normal[target_index, axis] = hits.normal[source_index, axis]
    target_hits.geom[target_index] = hits.geom[source_index]
    target_hits.closed[target_index] = hits.closed[source_index]
    target_hits.facet[target_index] = hits.facet[source_index]
    target_hits.is_at_edge[target_index] = hits.is_at_edge[source_index]


@subkernel(forceinline=True)
def _is_less(hits_a, index_a, hits_b, index_b):
    """Return whether a hit of `hits_a` comes before one of `hits_b` in a column.

    The lower hit comes first; of two at one height, the one of the lower geom id; of two of one
    geom, the one on an underside.
    """
    if hits_a.z[index_a] != hits_b.z[index_b]:
        return hits_a.z[index_a] < hits_b.z[index_b]
    if hits_a.geom[index_a] != hits_b.geom[index_b]:
        return hits_a.geom[index_a] < hits_b.geom[index_b]
    return (hits_a.normal[index_a, 2] > 0.0) < (hits_b.normal[index_b, 2] > 0.0)


@subkernel(inline="always")
def _sort_hits(hits, first_hit, end_hit, scratch_hits, scratch_index):
    """Sort the hits ``first_hit:end_hit`` of a line by insertion, in the order of `_is_less`.

    `scratch_hits` is a `LineHits` with room for one hit at index `scratch_index`.
    """
    for i in range(first_hit + 1, end_hit):
        if not _is_less(hits, i, hits, i - 1):
            continue
        copy_hit(hits, i, scratch_hits, scratch_index)
        j = i
        while j > first_hit and _is_less(scratch_hits, scratch_index, hits, j - 1):
            copy_hit(hits, j - 1, hits, j)
            j -= 1
        copy_hit(scratch_hits, scratch_index, hits, j)


@subkernel(inline="always")
def _has_hit_at_edge(hits, first_hit, end_hit):
    """Return whether any hit of ``first_hit:end_hit`` of a line is at the edge of a triangle."""
    is_at_edge = hits.is_at_edge
    for i in range(first_hit, end_hit):  # noqa: SIM110 (numba has no generators in `any`)
        if is_at_edge[i]:
            return True
    return False


@subkernel(inline="always")
def _is_same_part(hits, first_hit, second_hit, facets):
    """Return whether two hits are of triangles of the same part of the same geom."""
    is_same_geom = hits.geom[first_hit] == hits.geom[second_hit]
    return (
        is_same_geom and facets.part[hits.facet[first_hit]] == facets.part[hits.facet[second_hit]]
    )


@subkernel(inline="always")
def _drop_duplicate_hits(hits, first_hit, end_hit, facets):
    """Drop one of two hits on neighboring triangles, where a line runs through their shared edge.

    The line has the hits ``first_hit:end_hit``. Returns the index past the last hit that remains.
    """
    remaining_end = first_hit
    for i in range(first_hit, end_hit):
        is_duplicate = False
        if hits.is_at_edge[i]:
            j = remaining_end - 1
            while j >= first_hit and hits.z[i] - hits.z[j] <= SAME_HEIGHT:
                is_same_side = (hits.normal[i, 2] > 0.0) == (hits.normal[j, 2] > 0.0)
                if hits.is_at_edge[j] and is_same_side and _is_same_part(hits, i, j, facets):
                    is_duplicate = True
                    break
                j -= 1
        if not is_duplicate:
            copy_hit(hits, i, hits, remaining_end)
            remaining_end += 1
    return remaining_end


@subkernel(inline="always")
def _steepest_of_part(hits, first_hit, end_hit, hit, facets, facing_sign):
    """Find the steepest triangle that a line hits at an edge, in the mesh part of a given hit.

    The line has the hits ``first_hit:end_hit``. Only triangles that face up count if `facing_sign`
    is 1, only those that face down if it is -1. Returns the index of the hit, -1 for none.
    """
    vertices = facets.vertices
    faces = facets.faces
    steepest_hit = np.int64(-1)
    least_normal_z = 0.0
    for j in range(first_hit, end_hit):
        if not hits.is_at_edge[j] or not _is_same_part(hits, hit, j, facets):
            continue
        triangle = hits.facet[j]
        normal = unit_normal(
            vertices[faces[triangle, 0]], vertices[faces[triangle, 1]], vertices[faces[triangle, 2]]
        )
        normal_z = facing_sign * normal[2]
        if normal_z > 0.0 and (steepest_hit < 0 or normal_z < least_normal_z):
            steepest_hit = np.int64(j)
            least_normal_z = normal_z
    return steepest_hit


@subkernel(inline="always")
def _balance_parts(hits, first_hit, end_hit, facets):
    """Drop hits at edges until the line leaves each closed part of a mesh as often as it enters it.

    The line has the hits ``first_hit:end_hit``. Returns the index past the last hit that remains.
    """
    hit = first_hit
    while hit < end_hit:
        surplus_exits = 0
        if hits.is_at_edge[hit] and hits.closed[hit] != OPEN_SURFACE:
            for j in range(first_hit, end_hit):
                if hits.facet[j] >= 0 and _is_same_part(hits, hit, j, facets):
                    surplus_exits += 1 if hits.normal[j, 2] > 0.0 else -1
        dropped_hit = np.int64(-1)
        if surplus_exits != 0:
            facing_sign = 1.0 if surplus_exits > 0 else -1.0
            dropped_hit = _steepest_of_part(hits, first_hit, end_hit, hit, facets, facing_sign)
        if dropped_hit < 0:
            hit += 1
            continue
        for j in range(dropped_hit + 1, end_hit):
            copy_hit(hits, j, hits, j - 1)
        end_hit -= 1
        # the hit is tested again; if an earlier one was dropped, its index is less by 1 now
        if dropped_hit < hit:
            hit -= 1
    return end_hit


@subkernel(**NO_REFCOUNT)
def _drop_superfluous_hits(hits, first_hit, end_hit, facets):
    """Drop superfluous hits at edges of triangles, so that each crossing is counted once.

    The line has the hits ``first_hit:end_hit``. Returns the index past the last hit that remains.
    """
    return _balance_parts(
        hits, first_hit, _drop_duplicate_hits(hits, first_hit, end_hit, facets), facets
    )


@subkernel(inline="always")
def finish_line(hits, first_hit, end_hit, facets, scratch_hits, scratch_index):
    """Turn the collected hits of a line into a column: sorted, with one hit for each crossing.

    Args:
        hits: `LineHits`; the line has the hits ``first_hit:end_hit``. They are sorted in place.
            Hits that are left out, because another one stands for the same crossing, come last.
        first_hit: index of the line's first hit.
        end_hit: index past its last hit.
        facets: the triangles, as `Facets`.
        scratch_hits: `LineHits` that has room for one hit, as scratch.
        scratch_index: index of this room in `scratch_hits`.

    Returns:
        The index past the last hit that remains.
    """
    _sort_hits(hits, first_hit, end_hit, scratch_hits, scratch_index)
    if not _has_hit_at_edge(hits, first_hit, end_hit):
        return end_hit
    return _drop_superfluous_hits(hits, first_hit, end_hit, facets)
