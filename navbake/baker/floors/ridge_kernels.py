"""List the narrow runs of regions: rows and columns of few cells between two edges.

Run lengths along both axes, as in run-length encoding of binary images.
"""

import numpy as np

from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.region_kernels import region_of_surface
from navbake.baker.floors.surface_kernels import EAST, SOUTH, STANDABLE, slopes_join
from navbake.compiled import NO_REFCOUNT, kernel, subkernel


@subkernel(**NO_REFCOUNT)
def _find_joined(surfaces, rule, j, cell, axis, sign):
    """The standable surface of the next cell along an axis that joins a surface, or -1.

    Args:
        surfaces: all surfaces.
        rule: a `JoinRule`.
        j: the id of the surface.
        cell: its cell.
        axis: EAST or SOUTH.
        sign: 1 for the next cell in that direction, -1 for the one in the opposite direction.

    Returns:
        Of several surfaces, the one nearest in height.
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
    """List the runs of at most `max_cells` cells that end in ``blocks[begin:end]``.

    A run is a row of cells, or a column of cells, whose surfaces are joined, and which no surface
    continues at either end. The rows, see `navbake.baker.core.blocks.list_rows`, hold: the axis,
    EAST or SOUTH; the number of cells; the surface and the cell at the eastern or southern end; and
    those at the other end.

    Args:
        labelled: a `LabelledSurfaces`: the regions whose runs are listed.
        rule: a `JoinRule`.
        max_cells: longer runs are not listed.
        blocks: ids of blocks.
        counts: receives the number of rows of each block.
        columns: receive the rows: one array, (capacity, 6) int64.
        begin: index of the first block in `blocks`.
        end: index past the last one.

    Returns:
        The index of the first block that had no room, else `end`.
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
    """List the surfaces of runs, and their cells.

    Args:
        surfaces: all surfaces.
        rule: the `JoinRule` of the runs.
        runs: the runs, as `list_narrow_runs` lists them.
        start: the surfaces of run n are written to the rows from ``start[n]`` on.
        surface_cells: receives the id of each surface, and of its cell, (n, 2) int64.
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
