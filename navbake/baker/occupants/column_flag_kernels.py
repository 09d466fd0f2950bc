"""Kernel that flags cells by the hits of structure on the vertical line through their centres.

A cell can be empty, a hole, steep ground, under the sky, or hold something tall.
"""

import numpy as np

from navbake.baker.core.bisection_kernels import find_first_above
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.compiled import kernel

EMPTY = 1  # the cell's vertical line has no hits
HOLE = 2  # the cell has no floor, and nothing is at the heights of an agent's body
STEEP_GROUND = 4  # no floor; the highest surface is ground that is too steep to stand on
SKY = 8  # the cell has a floor, and nothing is above an agent's head
TALL = 16  # what stands on the cell's floor has its top more than `min_tall_height` above the floor
COLUMN_FLAGS = (EMPTY, HOLE, STEEP_GROUND, SKY, TALL)


@kernel(nogil=True)
def flag_columns(hits, floor, ground, limits, min_tall_height, flags, first_cell, end_cell):
    """Write the `COLUMN_FLAGS` of the cells ``range(first_cell, end_cell)`` of a level.

    A cell without a floor is a HOLE if nothing is in the way of the agent's body there. Only
    surfaces more than a step above the level's ground count. The cell is a hole if there is none,
    or if the lowest of them faces down and is higher than the agent. (If that surface faces up, the
    solid below it is in the way.)

    A cell with a floor is TALL if something stands on it whose top is more than `min_tall_height`
    above the floor: the lowest surface above the floor is at that height, and faces up.

    Args:
        hits: hits of structure on the vertical line through the centre of each cell, as
            `ColumnHits`; line i belongs to cell i.
        floor: z of each cell's floor, float64, NaN for none [m].
        ground: z of the level's ground [m].
        limits: the agent's highest step, headroom and largest slope, as `AgentLimits`.
        min_tall_height: the height above the floor from which on something is TALL [m].
        flags: receives the flags of each cell, uint8.
        first_cell: id of the first cell.
        end_cell: id after the last cell.
    """
    start = hits.start
    z = hits.z
    normal = hits.normal
    min_normal_z = np.float32(limits.min_normal_z)
    for cell in range(first_cell, end_cell):
        hit = start[cell]
        end_hit = start[cell + 1]
        has_floor = not np.isnan(floor[cell])
        cell_flags = 0 if hit < end_hit else EMPTY
        top_height = z[end_hit - 1] if hit < end_hit else np.inf
        top_normal_z = normal[end_hit - 1, 2] if hit < end_hit else np.float32(0.0)
        # the first surface that is neither the floor nor within a step of the ground
        lowest_counted_z = floor[cell] + SAME_HEIGHT if has_floor else ground + limits.max_step
        hit = find_first_above(z, hit, end_hit, lowest_counted_z)
        hit_faces_up = hit < end_hit and normal[hit, 2] > 0.0
        if has_floor:
            if top_height <= floor[cell] + limits.headroom + LIMIT_SLACK:
                cell_flags |= SKY
            if hit_faces_up and z[hit] > floor[cell] + min_tall_height:
                cell_flags |= TALL
        else:
            if top_normal_z > 0.0 and top_normal_z < min_normal_z:
                cell_flags |= STEEP_GROUND
            if not hit_faces_up and (hit == end_hit or z[hit] > ground + limits.headroom):
                cell_flags |= HOLE
        flags[cell] = cell_flags
