"""Measure how narrow regions are, by runs of cells along x and along y.

A run is a row of neighboring cells (or a column of them) that an agent can walk along, from one
edge of a region to the edge on the other side, as in run-length encoding of binary images.
"""

import numpy as np

from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.region_kernels import region_of_surface
from navbake.baker.floors.surface_kernels import EAST, SOUTH, STANDABLE, slopes_join
from navbake.compiled import NO_REFCOUNT, kernel, subkernel


@subkernel(**NO_REFCOUNT)
def _find_joined(surfaces, rule, j, cell, axis, sign):
    """Find the standable surface of the next cell that a step or slopes join to surface j.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        j: the id of a surface.
        cell: the id of its cell.
        axis: EAST or SOUTH.
        sign: 1 for the next cell in that direction, -1 for the next cell in the opposite direction.

    Returns:
        The id of the surface, -1 for none; of several, the one nearest in height.
    """
    lattice = surfaces.lattice
    if axis == EAST:
        col = cell % lattice.width + sign
        if col < 0 or col >= lattice.width:
            return np.int64(-1)
        neighbor = cell + sign
    else:
        neighbor = cell + sign * lattice.width
        if neighbor < 0 or neighbor >= lattice.width * lattice.height:
            return np.int64(-1)
    nearest = np.int64(-1)
    for i in range(surfaces.first[neighbor], surfaces.end[neighbor]):
        if not surfaces.marks[i] & STANDABLE:
            continue
        rise = abs(surfaces.z[i] - surfaces.z[j])
        joins = rise <= rule.step + LIMIT_SLACK
        if not joins and rule.by_slopes:
            if sign > 0:
                joins = slopes_join(surfaces, j, i, axis, rule.step)
            else:
                joins = slopes_join(surfaces, i, j, axis, rule.step)
        if joins and (nearest < 0 or rise < abs(surfaces.z[nearest] - surfaces.z[j])):
            nearest = np.int64(i)
    return nearest


@kernel(nogil=True, **NO_REFCOUNT)
def list_narrow_runs(labelled, rule, max_cells, blocks, counts, columns, begin, end):
    """List the places where regions are narrow: runs of at most `max_cells` cells.

    A run is a row of neighboring cells, or a column of them, whose surfaces are joined by steps or
    slopes. No surface beyond its two ends is joined to it. Listed are the runs whose eastern or
    southern end is in ``blocks[begin:end]``. This is a kernel for
    `navbake.baker.core.blocks.list_rows`.

    Args:
        labelled: a `LabelledSurfaces` with the regions whose runs are listed.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        max_cells: longer runs are not listed.
        blocks: ids of blocks of cells.
        counts: receives how many runs each block has.
        columns: one array that receives the runs, (n, 6) int64: the axis, EAST or SOUTH; the number
            of cells; the surface and the cell at the eastern or southern end; and the surface and
            the cell at the other end.
        begin: index in `blocks` of the first block.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose runs had no room; `end` if all had room.
    """
    (rows,) = columns
    num = 0
    surfaces = labelled.surfaces
    width = surfaces.lattice.width
    for k in range(begin, end):
        num_before = num
        row0, row1, col0, col1 = block_window(surfaces.lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * width + col0, row * width + col1):
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    if region_of_surface(labelled, j) < 0:
                        continue
                    for axis in range(SOUTH + 1):
                        if _find_joined(surfaces, rule, j, cell, axis, 1) >= 0:
                            continue
                        to_previous = 1 if axis == EAST else width
                        num_cells = 1
                        last = np.int64(j)
                        last_cell = cell
                        while num_cells <= max_cells:
                            previous = _find_joined(surfaces, rule, last, last_cell, axis, -1)
                            if previous < 0:
                                break
                            last = previous
                            last_cell -= to_previous
                            num_cells += 1
                        if num_cells > max_cells:
                            continue
                        if num == rows.shape[0]:
                            return k
                        rows[num, 0] = axis
                        rows[num, 1] = num_cells
                        rows[num, 2] = j
                        rows[num, 3] = cell
                        rows[num, 4] = last
                        rows[num, 5] = last_cell
                        num += 1
        counts[k] = num - num_before
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def list_run_surfaces(surfaces, rule, runs, start, surface_cells, begin, end):
    """List all surfaces of the runs ``runs[begin:end]``, and the cells of these surfaces.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        rule: the `JoinRule` that the runs were found by.
        runs: the runs, as `list_narrow_runs` lists them, (runs, 6) int64.
        start: for each run, the row of `surface_cells` from which on its surfaces are written.
        surface_cells: receives the id of each surface, and the id of its cell, (n, 2) int64.
        begin: index of the first run.
        end: index past the last one.
    """
    for n in range(begin, end):
        axis = runs[n, 0]
        to_previous = 1 if axis == EAST else surfaces.lattice.width
        j = runs[n, 2]
        cell = runs[n, 3]
        for k in range(runs[n, 1]):
            surface_cells[start[n] + k, 0] = j
            surface_cells[start[n] + k, 1] = cell
            j = _find_joined(surfaces, rule, j, cell, axis, -1)
            cell -= to_previous
