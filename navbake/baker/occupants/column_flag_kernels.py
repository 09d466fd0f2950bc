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
def flag_columns(hits, floors, grounds, limits, min_tall_height, flags, first_cell, end_cell):
    """Write the `COLUMN_FLAGS` of the cells ``range(first_cell, end_cell)`` of all levels.

    A cell without a floor is a HOLE if nothing is in the way of the agent's body there. Only
    surfaces more than a step above the level's ground count. The cell is a hole if there is none,
    or if the lowest of them faces down and is higher than the agent. (If that surface faces up, the
    solid below it is in the way.)

    A cell with a floor is TALL if something stands on it whose top is more than `min_tall_height`
    above the floor: the lowest surface above the floor is at that height, and faces up.

    Args:
        hits: hits of structure on the vertical line through the centre of each cell, as
            `ColumnHits`; line i belongs to cell i.
        floors: z of each cell's floor on each level, (levels, cells) float64, NaN for none [m].
        grounds: z of each level's ground, (levels,) [m].
        limits: the agent's highest step, headroom and largest slope, as `AgentLimits`.
        min_tall_height: the height above the floor from which on something is TALL [m].
        flags: receives the flags of each cell on each level, (levels, cells) uint8.
        first_cell: id of the first cell.
        end_cell: id after the last cell.
    """
    start = hits.start
    z = hits.z
    normal = hits.normal
    min_normal_z = np.float32(limits.min_normal_z)
    for cell in range(first_cell, end_cell):
        end_hit = start[cell + 1]
        is_empty = start[cell] == end_hit
        top_height = np.inf if is_empty else z[end_hit - 1]
        top_normal_z = np.float32(0.0) if is_empty else normal[end_hit - 1, 2]
        for level in range(floors.shape[0]):
            floor = floors[level, cell]
            has_floor = not np.isnan(floor)
            cell_flags = EMPTY if is_empty else 0
            # the first surface that is neither the floor nor within a step of the ground
            lowest_counted_z = (
                floor + SAME_HEIGHT if has_floor else grounds[level] + limits.max_step
            )
            hit = find_first_above(z, start[cell], end_hit, lowest_counted_z)
            hit_faces_up = hit < end_hit and normal[hit, 2] > 0.0
            if has_floor:
                if top_height <= floor + limits.headroom + LIMIT_SLACK:
                    cell_flags |= SKY
                if hit_faces_up and z[hit] > floor + min_tall_height:
                    cell_flags |= TALL
            else:
                if top_normal_z > 0.0 and top_normal_z < min_normal_z:
                    cell_flags |= STEEP_GROUND
                if not hit_faces_up and (
                    hit == end_hit or z[hit] > grounds[level] + limits.headroom
                ):
                    cell_flags |= HOLE
            flags[level, cell] = cell_flags
