"""A window of floors that were found on the whole scene."""

from dataclasses import replace

import numpy as np

from navbake.baker.floors.levels import Floors
from navbake.baker.floors.patch import Patch
from navbake.baker.lattice import Window, cut_cells
from navbake.errors import SceneError
from navbake.types import Int


def crop_floors(floors: Floors, window: Window) -> Floors:
    """Cut a window out of the floors of a whole scene.

    Levels without a standable surface in the window are left out. What is said of the others,
    such as which roofs were dropped, stays as far as a part of it lies in the window.

    Raises:
        SceneError: no floor lies in the window.
    """
    shown = [k for k, level in enumerate(floors.levels) if level.standable[window].any()]
    if not shown:
        raise SceneError("no floor lies inside of `grid.bounds`")
    number = np.full(len(floors.levels), -1, dtype=np.int64)
    number[shown] = np.arange(len(shown))
    levels = []
    for new, old in enumerate(shown):
        level = floors.levels[old]
        name = f"level {new}" if level.name == f"level {old}" else level.name
        floor, standable = level.floor[window].copy(), level.standable[window].copy()
        levels.append(replace(level, name=name, floor=floor, standable=standable))
    width = floors.levels[0].floor.shape[1]

    def is_shown(patch: Patch) -> bool:
        return bool(cut_cells(patch.cells.astype(np.int64), window, width)[1].any())

    return Floors(
        levels,
        _crop_links(floors.links, number, window, width),
        tops=list(filter(is_shown, floors.tops)),
        roofs=list(filter(is_shown, floors.roofs)),
        small_starts=list(filter(is_shown, floors.small_starts)),
        unreached=[
            replace(part, level=int(number[part.level]))
            for part in floors.unreached
            if number[part.level] >= 0 and is_shown(part.patch)
        ],
        left_out=list(filter(is_shown, floors.left_out)),
        enclosed=list(filter(is_shown, floors.enclosed)),
    )


def _crop_links(links: Int, number: Int, window: Window, width: int) -> Int:
    """The links between cells of the window, on the levels that it shows."""
    kept = (number[links[:, 0]] >= 0) & (number[links[:, 2]] >= 0)
    for cell in (1, 3):
        kept &= cut_cells(links[:, cell], window, width)[1]
    links = links[kept]
    for level, cell in ((0, 1), (2, 3)):
        links[:, level] = number[links[:, level]]
        links[:, cell] = cut_cells(links[:, cell], window, width)[0]
    return links
