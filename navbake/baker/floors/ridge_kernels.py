"""Measure how narrow regions are, by runs of cells along x and along y.

A run is a row of neighboring cells (or a column of them) that an agent can walk along, from one
edge of a region to the edge on the other side, as in run-length encoding of binary images.
"""

import numpy as np

from navbake.baker.core.bisection_kernels import find_first_at_or_above
from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.component_kernels import max_rise_of
from navbake.baker.floors.region_kernels import region_of_surface, surface_of_same_rank
from navbake.baker.floors.surface_kernels import EAST, SOUTH, STANDABLE, are_joined_by_slopes
from navbake.compiled import NO_REFCOUNT, kernel, subkernel

# Signs of steps along an axis; for plain ints, numba would compile functions once for each
FORWARD = np.int64(1)
BACKWARD = np.int64(-1)


@subkernel(**NO_REFCOUNT)
def _next_cell(lattice, cell, axis, sign):
    """Return the id of a cell's neighbor along an axis; -1 at the border of the lattice.

    Args:
        lattice: the `Lattice`.
        cell: the id of the cell.
        axis: EAST or SOUTH.
        sign: FORWARD for the neighbor in that direction, BACKWARD for the one in the opposite
            direction.
    """
    if axis == EAST:
        col = cell % lattice.width + sign
        return cell + sign if 0 <= col < lattice.width else np.int64(-1)
    neighbor = cell + sign * lattice.width
    return neighbor if 0 <= neighbor < lattice.width * lattice.height else np.int64(-1)


@subkernel(**NO_REFCOUNT)
def _has_surface_within_step(surfaces, rule, surface, neighbor):
    """Return whether a cell has any surface within a step of the height of a surface.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        rule: a `JoinRule`, which has the step.
        surface: the id of a surface.
        neighbor: the id of a cell next to that of the surface; -1 for none.
    """
    if neighbor < 0:
        return False
    for i in range(surfaces.first[neighbor], surfaces.end[neighbor]):
        if abs(surfaces.z[i] - surfaces.z[surface]) <= rule.max_step + LIMIT_SLACK:
            return True
    return False


@subkernel(**NO_REFCOUNT)
def _find_joined_surface(surfaces, rule, surface, neighbor, axis, sign):
    """Find the standable surface of a cell that a step or slopes join to one of the cell beside it.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        surface: the id of a surface.
        neighbor: the id of the cell next to that of the surface; -1 for none.
        axis: EAST or SOUTH.
        sign: FORWARD if the neighbor lies in that direction, BACKWARD if in the opposite one.

    Returns:
        The id of the surface, -1 for none; of several, the one nearest in height.
    """
    nearest_surface = np.int64(-1)
    if neighbor < 0:
        return nearest_surface
    # a little more, as sums are rounded
    max_rise = max_rise_of(rule) + LIMIT_SLACK
    end_in_neighbor = surfaces.end[neighbor]
    lowest_z = surfaces.z[surface] - max_rise
    for i in range(
        find_first_at_or_above(surfaces.z, surfaces.first[neighbor], end_in_neighbor, lowest_z),
        end_in_neighbor,
    ):
        if surfaces.z[i] > surfaces.z[surface] + max_rise:
            break
        if not surfaces.flags[i] & STANDABLE:
            continue
        rise = abs(surfaces.z[i] - surfaces.z[surface])
        is_joined = rise <= rule.max_step + LIMIT_SLACK
        if not is_joined and rule.can_slopes_join:
            if sign > 0:
                is_joined = are_joined_by_slopes(surfaces, surface, i, axis, rule.max_step)
            else:
                is_joined = are_joined_by_slopes(surfaces, i, surface, axis, rule.max_step)
        if is_joined and (
            nearest_surface < 0 or rise < abs(surfaces.z[nearest_surface] - surfaces.z[surface])
        ):
            nearest_surface = np.int64(i)
    return nearest_surface


@subkernel(inline="always")
def _is_likely_joined(surfaces, rule, surface, row, cell, axis):
    """Return whether a step joins a surface to the one of the same rank in the next cell.

    If not, other surfaces of the next cell may still be joined to it, see `_find_joined_surface`.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        surface: the id of a surface.
        row: the row of its cell.
        cell: the id of its cell.
        axis: EAST or SOUTH.
    """
    lattice = surfaces.lattice
    if axis == EAST and cell + 1 == (row + 1) * lattice.width:
        return False
    if axis == SOUTH and row + 1 == lattice.height:
        return False
    neighbor = cell + (1 if axis == EAST else lattice.width)
    likely_surface = surface_of_same_rank(surfaces, surface, cell, neighbor)
    return (
        likely_surface >= 0
        and surfaces.flags[likely_surface] & STANDABLE != 0
        and abs(surfaces.z[likely_surface] - surfaces.z[surface]) <= rule.max_step + LIMIT_SLACK
    )


@kernel(nogil=True, **NO_REFCOUNT)
def list_narrow_runs(
    labelled_surfaces, rule, max_cells, blocks, row_counts, row_arrays, begin, end
):
    """List the places where regions are narrow: runs of at most `max_cells` cells.

    A run is a row of neighboring cells, or a column of them, whose surfaces are joined by steps or
    slopes. The cells beyond its two ends have no surface that is joined to it, and none within a
    step, where the floor would go on. Listed are the runs whose eastern or southern end is in
    ``blocks[begin:end]``. This is a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        labelled_surfaces: a `LabelledSurfaces` with the regions whose runs are listed.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        max_cells: longer runs are not listed.
        blocks: ids of blocks of cells.
        row_counts: receives how many runs each block has.
        row_arrays: one array that receives the runs, (n, 6) int64: the axis, EAST or SOUTH; the
            number of cells; the surface and the cell at the eastern or southern end; and the
            surface and the cell at the other end.
        begin: index in `blocks` of the first block.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose runs had no room; `end` if all had room.
    """
    (rows,) = row_arrays
    num_rows = 0
    surfaces = labelled_surfaces.surfaces
    width = surfaces.lattice.width
    for block_index in range(begin, end):
        num_rows_before = num_rows
        row0, row1, col0, col1 = block_window(surfaces.lattice, blocks[block_index])
        for row in range(row0, row1):
            for cell in range(row * width + col0, row * width + col1):
                for j in range(np.int64(surfaces.first[cell]), surfaces.end[cell]):
                    if region_of_surface(labelled_surfaces, j) < 0:
                        continue
                    for axis in range(SOUTH + 1):
                        if _is_likely_joined(surfaces, rule, j, row, cell, axis):
                            continue
                        next_cell = _next_cell(surfaces.lattice, cell, axis, FORWARD)
                        if _has_surface_within_step(surfaces, rule, j, next_cell):
                            continue
                        if _find_joined_surface(surfaces, rule, j, next_cell, axis, FORWARD) >= 0:
                            continue
                        num_cells = 1
                        end_surface = j
                        end_cell = cell
                        next_cell = _next_cell(surfaces.lattice, cell, axis, BACKWARD)
                        while num_cells <= max_cells:
                            next_surface = _find_joined_surface(
                                surfaces, rule, end_surface, next_cell, axis, BACKWARD
                            )
                            if next_surface < 0:
                                break
                            end_surface = next_surface
                            end_cell = next_cell
                            next_cell = _next_cell(surfaces.lattice, end_cell, axis, BACKWARD)
                            num_cells += 1
                        if num_cells > max_cells:
                            continue
                        if _has_surface_within_step(surfaces, rule, end_surface, next_cell):
                            continue
                        if num_rows == rows.shape[0]:
                            return block_index
                        rows[num_rows, 0] = axis
                        rows[num_rows, 1] = num_cells
                        rows[num_rows, 2] = j
                        rows[num_rows, 3] = cell
                        rows[num_rows, 4] = end_surface
                        rows[num_rows, 5] = end_cell
                        num_rows += 1
        row_counts[block_index] = num_rows - num_rows_before
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def list_surfaces_of_runs(surfaces, rule, runs, first_row_of_run, surface_cells, begin, end):
    """List all surfaces of narrow places of regions, and the cells of these surfaces.

    A narrow place is a run of cells, see `list_narrow_runs`. Those of ``runs[begin:end]`` are
    listed.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        rule: the `JoinRule` that the runs were found by.
        runs: the runs, as `list_narrow_runs` lists them, (runs, 6) int64.
        first_row_of_run: for each run, the row of `surface_cells` from which on its surfaces are
            written.
        surface_cells: receives the id of each surface, and the id of its cell, (n, 2) int64.
        begin: index of the first run.
        end: index past the last one.
    """
    for run in range(begin, end):
        axis = runs[run, 0]
        surface = runs[run, 2]
        cell = runs[run, 3]
        for k in range(runs[run, 1]):
            surface_cells[first_row_of_run[run] + k, 0] = surface
            surface_cells[first_row_of_run[run] + k, 1] = cell
            cell = _next_cell(surfaces.lattice, cell, axis, BACKWARD)
            surface = _find_joined_surface(surfaces, rule, surface, cell, axis, BACKWARD)
