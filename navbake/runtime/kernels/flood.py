"""Whether steps lead from one cell to another: a flood fill that stops where it gets there.

Depth first, with a stack of its own. Labelling all islands would tell as well, and looks at every
cell of the grid.
"""

import numpy as np

from navbake.compiled import kernel
from navbake.runtime.kernels.arrays import find_slot, level_of


@kernel
def floods(space, origin, is_goal):
    """Whether steps over passable cells and links lead from a passable cell to one of a mask.

    Steps lead over edges of cells, as in `navbake.navgrid.islands.find_islands`. `space` is a
    `navbake.runtime.kernels.arrays.Space`, `is_goal` by flat id, bool.
    """
    layout, links, floors, passable = space
    starts, widths, heights = layout.start, layout.width, layout.height
    link_cell, link_start, link_target = links.cell, links.start, links.target
    floor, max_step, has_links = floors.z, floors.max_step, len(link_cell) > 0
    seen = np.zeros(len(passable), np.bool_)
    stack = np.empty(len(passable), np.int64)
    stack[0], seen[origin] = origin, True
    count = 1
    while count > 0:
        count -= 1
        cell = stack[count]
        if is_goal[cell]:
            return True
        level = level_of(starts, cell)
        width = widths[level]
        row, col = divmod(cell - starts[level], width)
        for way in range(4):
            if way == 0:
                is_inside, other = col > 0, cell - 1
            elif way == 1:
                is_inside, other = col < width - 1, cell + 1
            elif way == 2:
                is_inside, other = row > 0, cell - width
            else:
                is_inside, other = row < heights[level] - 1, cell + width
            if not is_inside or seen[other] or not passable[other]:
                continue
            # written so that NaN, no floor, is no step
            if not abs(floor[cell] - floor[other]) > max_step:
                seen[other] = True
                stack[count] = other
                count += 1
        slot = find_slot(link_cell, cell) if has_links else -1
        if slot >= 0:
            for i in range(link_start[slot], link_start[slot + 1]):
                other = link_target[i]
                if passable[other] and not seen[other]:
                    seen[other] = True
                    stack[count] = other
                    count += 1
    return False
