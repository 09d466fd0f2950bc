"""List the surfaces that floors may consist of, cell by cell, and mark those an agent can stand on.

Whether a surface lies inside of a solid follows from the winding number of the vertical line above
it: the line's exits from solids less its entries (signed crossings of a ray, as in Alciatore and
Miranda, A Winding Number and Point-in-Polygon Algorithm, 1995).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.core.tiles import cell_center
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int32

if TYPE_CHECKING:  # kernels depend on kernels alone
    from navbake.navgrid.lattice import Lattice

# Bits of `Surfaces.flags`; `list_surfaces` defines them
FLOOR_LIKE = 1  # a floor may continue at the surface
STANDABLE = 2  # an agent can stand on the surface
UNCOVERED = 4  # an agent can stand on the surface, and nothing lies above it
ENCLOSED = 8  # an agent could stand there if the closed mesh or plane around it were hollow
# Value of `Surfaces.flags` for ridges, the tops of walls and beams: no floor may continue there
RIDGE_FLAGS = 0

# Directions from a cell to its neighbor. Row numbers grow to the south, against y
EAST = 0
SOUTH = 1
WEST = 2
NORTH = 3

# In a building that leans a little, the sides of treads lean, too: z of their unit normals is at
# most this, which is a lean of 2.9 degrees
MAX_SIDE_NORMAL_Z = 0.05


class Surfaces(NamedTuple):
    """The surfaces that floors may consist of: cell i has the surfaces ``first[i]:end[i]``.

    A surface is a place where the vertical line through a cell's centre crosses geometry that faces
    up. Surfaces are numbered block of cells by block of cells, not in the order of cell ids.

    Attributes:
        lattice: the `Lattice` of the cells.
        first: the id of the lowest surface of each cell, shape (cells,), int32.
        end: the id past the highest surface of each cell, shape (cells,), int32.
        z: heights, ascending in a cell, shape (n,), float64 [m].
        geom: MuJoCo's geom ids, shape (n,), int32; for an ENCLOSED surface, the id of the mesh or
            plane around it.
        flags: bits, shape (n,), uint8: FLOOR_LIKE, a floor may continue there; STANDABLE, an agent
            can stand there; UNCOVERED, STANDABLE with nothing above; ENCLOSED, an agent could stand
            there if the closed mesh or the plane around it were hollow.
        normal: unit normals, shape (n, 3), float32; (n, 0) where no slope rises by more than a step
            over a cell.
    """

    lattice: Lattice
    first: Int32
    end: Int32
    z: Float
    geom: Int32
    flags: NDArray[np.uint8]
    normal: NDArray[np.float32]


@subkernel(**NO_REFCOUNT)
def count_planes_around(planes, lattice, cell, z):
    """Count the infinite planes that a point over a cell's centre lies inside of.

    Args:
        planes: a `Planes`; each plane is solid on the side that its normal points away from.
        lattice: the `Lattice` of the cell.
        cell: id of the cell, over whose centre the point lies.
        z: the point's height [m].

    Returns:
        The number of planes around the point, and the geom id of the last of them, -1 for none.
    """
    num_planes = 0
    last_geom = np.int32(-1)
    for plane in range(planes.geom.shape[0]):
        x, y = cell_center(lattice, cell)
        distance_from_plane = (
            planes.mat[plane, 2] * (x - planes.pos[plane, 0])
            + planes.mat[plane, 5] * (y - planes.pos[plane, 1])
            + planes.mat[plane, 8] * (z - planes.pos[plane, 2])
        )
        if distance_from_plane < -SAME_HEIGHT:
            num_planes = num_planes + 1
            last_geom = planes.geom[plane]
    return num_planes, last_geom


@subkernel(inline="always")
def _winding_at(hits, hit):
    """Return how a hit of a column changes the number of solids around the line, going down.

    Returns:
        The change of the number of closed meshes, and of the number of other solids: 1 where the
        line enters one, -1 where it leaves one, else 0.
    """
    winding = 1 if hits.normal[hit, 2] > 0.0 else -1
    if hits.closed[hit] == CLOSED_SURFACE:
        return winding, 0
    return 0, winding if hits.closed[hit] != OPEN_SURFACE else 0


@subkernel(inline="always")
def _find_enclosing_mesh(hits, hit, end_hit):
    """Return the geom id of the closed mesh around a hit of a column, -1 if there is none.

    Of several meshes it is the one whose upper side is nearest above the hit. `end_hit` is the
    index past the column's last hit.
    """
    z = hits.z
    normal = hits.normal
    geom = hits.geom
    closed = hits.closed
    for j in range(hit + 1, end_hit):
        if closed[j] != CLOSED_SURFACE or normal[j, 2] <= 0.0 or z[j] - z[hit] <= SAME_HEIGHT:
            continue
        winding = 0
        for k in range(hit + 1, end_hit):
            if geom[k] == geom[j] and closed[k] == CLOSED_SURFACE and z[k] - z[hit] > SAME_HEIGHT:
                winding += 1 if normal[k, 2] > 0.0 else -1
        if winding > 0:
            return geom[j]
    return np.int32(-1)


@kernel(nogil=True, **NO_REFCOUNT)
def list_surfaces(lattice, hits, planes, agent_limits, cells, row_counts, row_arrays, begin, end):
    """List the surfaces that floors may consist of, in the columns of ``cells[begin:end]``.

    A hit is FLOOR_LIKE if its normal is within the agent's slope. A steeper hit that faces up is
    FLOOR_LIKE, too, if it lies at most a step above a hit within the slope: a bump too low to be an
    obstacle.

    A hit is STANDABLE if it is within the slope, lies inside of no solid, and has the agent's
    headroom below the next hit above it. It is ENCLOSED if it would be STANDABLE without the closed
    meshes around it, or without the infinite planes around it. Of several such hits at one height,
    the first is marked. A STANDABLE hit is UNCOVERED if the column has no hit above it.

    In a building that leans, the line over a tread may cross the side of the next tread, at most a
    step higher. That side is then the next hit above the lower tread, which is STANDABLE
    nevertheless.

    This is a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        lattice: the `Lattice` of the cells.
        hits: the `ColumnHits` of all cells.
        planes: a `Planes`: the infinite planes of the scene.
        agent_limits: the `AgentLimits`.
        cells: ids of cells.
        row_counts: receives how many surfaces each cell has.
        row_arrays: four arrays that receive the rows, a row for each surface: height [m], geom id,
            marks and normal, as in `Surfaces`. If the normals have shape (n, 0), none are written.
        begin: index in `cells` of the first cell.
        end: index past the last one.

    Returns:
        The index in `cells` of the first cell whose rows had no room; `end` if all had room.
    """
    heights, geoms, flags, normals = row_arrays
    num_rows = 0
    for index in range(begin, end):
        first_hit = hits.start[cells[index]]
        end_hit = hits.start[cells[index] + 1]
        num_rows_before = num_rows
        # every hit may become a row
        if num_rows + end_hit - first_hit > heights.shape[0]:
            return index
        standable_z = -math.inf  # height of the last standable surface
        enclosed_z = -math.inf  # height of the last enclosed surface
        gentle_z = -math.inf  # height of the last surface within the slope
        gentle_row = num_rows
        # the closed meshes, and the other solids, that the hit lies inside of: one whose underside
        # is at the hit's height (within SAME_HEIGHT) is around it, one whose top is there is not
        num_meshes = 0
        num_solids = 0
        for hit in range(first_hit, end_hit):
            mesh_winding, solid_winding = _winding_at(hits, hit)
            num_meshes += mesh_winding
            num_solids += solid_winding
        next_hit_above = first_hit  # the next hit above the hit, not at its height
        for hit in range(first_hit, end_hit):
            z = hits.z[hit]
            while next_hit_above < end_hit and hits.z[next_hit_above] - z <= SAME_HEIGHT:
                mesh_winding, solid_winding = _winding_at(hits, next_hit_above)
                num_meshes -= mesh_winding
                num_solids -= solid_winding
                next_hit_above += 1
            height_of_next_hit = hits.z[next_hit_above] if next_hit_above < end_hit else math.inf
            normal_z = hits.normal[hit, 2]
            is_gentle = normal_z >= agent_limits.min_normal_z
            # too steep, and no bump that is low enough to step over
            if not is_gentle and not (
                normal_z > 0.0 and z - gentle_z <= agent_limits.max_step + LIMIT_SLACK
            ):
                continue
            if (
                not is_gentle
                and normal_z <= MAX_SIDE_NORMAL_Z
                and gentle_z - standable_z > SAME_HEIGHT
            ):
                # the side of a tread covers the tread below, which is the floor
                has_headroom = height_of_next_hit - gentle_z >= agent_limits.headroom - LIMIT_SLACK
                if num_meshes + num_solids <= 0 and has_headroom:
                    standable_z = gentle_z
                    flags[gentle_row] |= (
                        STANDABLE if height_of_next_hit < math.inf else STANDABLE | UNCOVERED
                    )
                    continue
            heights[num_rows] = z
            geoms[num_rows] = hits.geom[hit]
            flags[num_rows] = FLOOR_LIKE
            for axis in range(normals.shape[1]):
                normals[num_rows, axis] = hits.normal[hit, axis]
            if is_gentle:
                gentle_z = z
                gentle_row = num_rows
                if (
                    z - standable_z > SAME_HEIGHT
                    and height_of_next_hit - z >= agent_limits.headroom - LIMIT_SLACK
                ):
                    num_planes, plane_geom = count_planes_around(planes, lattice, cells[index], z)
                    # only closed meshes, or only planes, are around the hit
                    is_in_meshes_or_planes_alone = num_solids <= 0 and (
                        num_meshes <= 0 or num_planes == 0
                    )
                    if num_meshes + num_solids + num_planes <= 0:
                        flags[num_rows] |= STANDABLE
                        standable_z = z
                        if hits.z[end_hit - 1] - z <= LIMIT_SLACK:
                            flags[num_rows] |= UNCOVERED
                    elif is_in_meshes_or_planes_alone and z - enclosed_z > SAME_HEIGHT:
                        flags[num_rows] |= ENCLOSED
                        enclosed_z = z
                        mesh_geom = _find_enclosing_mesh(hits, hit, end_hit)
                        geoms[num_rows] = mesh_geom if mesh_geom >= 0 else plane_geom
            num_rows += 1
        row_counts[index] = num_rows - num_rows_before
    return end


@subkernel(inline="always")
def find_first_not_below(z, first_surface, end_surface, least_z):
    """Return the first of some surfaces that is not below a height; their end if all are.

    Surfaces of a cell ascend. Whoever looks for those near each surface of a neighboring cell goes
    on from the last result, so that all searches together visit each surface once.

    Args:
        z: heights of all surfaces [m].
        first_surface: index of the first of the surfaces.
        end_surface: index past the last one.
        least_z: the height [m].
    """
    while first_surface < end_surface and z[first_surface] < least_z:
        first_surface += 1
    return first_surface


@subkernel(**NO_REFCOUNT)
def are_joined_by_slopes(surfaces, surface_a, surface_b, direction, max_step):
    """Return whether slopes join two surfaces of neighboring cells that no step joins.

    The slope of each of the two surfaces predicts how much the floor rises from `surface_a` to
    `surface_b`. At least one slope must predict more than a step, up or down. The surfaces join if
    the real rise lies between the two predictions (for example if a floor bends between the cells,
    at the foot of a ramp), or if it differs from each prediction by at most a step.

    Args:
        surfaces: a `Surfaces` with normals.
        surface_a: id of a surface.
        surface_b: id of a surface of the neighboring cell in the direction.
        direction: EAST or SOUTH, from the cell of a to the cell of b.
        max_step: the highest step [m].
    """
    rise = surfaces.z[surface_b] - surfaces.z[surface_a]
    if abs(rise) <= max_step + LIMIT_SLACK:
        return False
    normal = surfaces.normal
    cell_size = surfaces.lattice.cell_size
    axis = 0
    slope_sign = -cell_size
    if direction == SOUTH:  # which is against y
        axis = 1
        slope_sign = cell_size
    predicted_rise_a = slope_sign * normal[surface_a, axis] / normal[surface_a, 2]
    predicted_rise_b = slope_sign * normal[surface_b, axis] / normal[surface_b, 2]
    if max(abs(predicted_rise_a), abs(predicted_rise_b)) <= max_step + LIMIT_SLACK:
        return False
    # a bend between the two cells makes the real rise a mean of both predictions
    lowest_rise = min(predicted_rise_a, predicted_rise_b)
    highest_rise = max(predicted_rise_a, predicted_rise_b)
    if lowest_rise - LIMIT_SLACK <= rise <= highest_rise + LIMIT_SLACK:
        return True
    is_near_prediction_a = abs(rise - predicted_rise_a) <= max_step + LIMIT_SLACK
    return is_near_prediction_a and abs(rise - predicted_rise_b) <= max_step + LIMIT_SLACK
