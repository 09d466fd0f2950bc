"""Floors in a scene in which furniture moves: only the cells near it are decided again.

What is a floor depends on the whole scene: on the sizes of sheets, on their outlines, on what lies
over what. But most of what moves only takes cells from one large floor and gives others back, and
that changes nothing else as long as the floor stays the one that it is. `LiveFloors` notes what
that rests on. A change that might touch any of it is `NotLocal`: then all floors are found again.
"""

from __future__ import annotations

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.levels import Floors, Judged
from navbake.baker.floors.outline import find_edges
from navbake.baker.floors.sheets import agent_limits
from navbake.baker.kernels.constants import CLOSED_SURFACE
from navbake.baker.live.budget import FloorBudget
from navbake.baker.live.columns import LiveColumns, Region
from navbake.baker.live.growth import FloorChanges, FloorGrowth
from navbake.baker.live.kernels.sheets import hold_region
from navbake.baker.live.not_local import NotLocal
from navbake.baker.live.sheets import LiveSheets
from navbake.baker.scene.shapes import Planes
from navbake.config.settings import BakeConfig
from navbake.types import Int


class LiveFloors:
    """The one level of a scene, kept up to date.

    Attributes:
        level: the level; its arrays are written to.
    """

    def __init__(
        self,
        config: BakeConfig,
        floors: Floors,
        judged: Judged,
        columns: Columns,
        live: LiveColumns,
    ) -> None:
        """Note what the floors rest on; NotLocal where they are of another kind.

        Args:
            judged: what was decided on the way to the floors.
            columns: what they were found in.
            live: the same; gets the sheet of each surface.
        """
        _check_kind(config, floors, judged, columns)
        self._live, self._limits = live, agent_limits(config.agent)
        self.level = floors.levels[0]
        self._sheets = LiveSheets(config, judged, columns, live)
        self._check_outline(judged)
        step = self._limits.step
        self._budget = FloorBudget(self.level, self._sheets, step)
        self._growth = FloorGrowth(self.level, judged, columns, live, self._sheets, step)

    def _check_outline(self, judged: Judged) -> None:
        """The floor lies over nothing that one can stand on, and drops to no other floor.

        So it is no top, no shelf and no roof, whatever stands on it and beside it.
        """
        every, main = judged.every, self._sheets.main
        is_main = np.arange(len(every.sheet_size)) == main
        edges = find_edges(judged.large, is_main, self._limits.step, self._sheets.reach)
        if not np.isnan(edges.floors).all():
            raise NotLocal("the floor drops to another one")
        above = np.flatnonzero(every.sheet == main)
        above = above[above > 0]
        if (every.cell[above - 1] == every.cell[above]).any():
            raise NotLocal("the floor lies over another surface to stand on")

    def follow(self, changed: Region, touched: Int, planes: Planes) -> FloorChanges:
        """Bring columns, sheets and floors up to date; `check` tells whether they may be kept.

        Args:
            changed: the cells whose columns are others now, with these, as `LiveColumns.cast`
                gives them; they are put into the columns.
            touched: all cells near what moved.
            planes: the endless planes of the scene.

        Raises:
            NotLocal: more than the floor near these cells may change. What was known of columns
                and floors is lost.
        """
        near_other = self._sheets.near_other
        if near_other[touched].any() or near_other[changed.cells].any():
            raise NotLocal("another floor, a top or a roof is near")
        if (changed.columns.closed == CLOSED_SURFACE).any():
            self._check_enclosed(changed, planes)
        if not len(changed.cells):
            return FloorChanges.none()
        self._sheets.forget(changed.cells)
        self._live.put(changed, planes)
        cells = self._sheets.follow(changed.cells)
        heights, is_over = self._sheets.floor_in(cells)
        if is_over.any():
            raise NotLocal("the floor lies over another surface to stand on")
        self._budget.check(heights)
        return self._growth.follow(cells)

    def check(self, changes: FloorChanges) -> None:
        """NotLocal where the floor may be judged otherwise after changes; reads floors alone."""
        self._budget.spend(changes)

    def _check_enclosed(self, changed: Region, planes: Planes) -> None:
        """No closed mesh holds anything that one could stand on, see `find_enclosed`."""
        holder = np.empty(len(changed.columns.z), dtype=np.int32)
        crossings = changed.by_id(self._live.scratch)
        hold_region(self._live.lattice, changed.cells, crossings, planes, self._limits, holder)
        if (holder >= 0).any():
            raise NotLocal("a closed mesh may hold a floor")


def _check_kind(config: BakeConfig, floors: Floors, judged: Judged, columns: Columns) -> None:
    """NotLocal where floors depend on more than `LiveFloors` knows of."""
    step, size = config.agent.traversable_floor_height, columns.lattice.cell_size
    reasons = {
        "`levels` are given": config.levels != "auto",
        "`floors.from` is given": bool(config.floors.starts),
        "`floors.reach` is steps": config.floors.reach != "all",
        "there are several levels": len(floors.levels) > 1,
        "ramps may rise by more than a step a cell": (
            size * np.tan(np.radians(config.agent.max_slope)) > step
        ),
        "floors lie over each other": bool((np.diff(judged.counted.start) > 1).any()),
        "a closed mesh holds a floor": judged.holds_floor,
    }
    for reason, holds in reasons.items():
        if holds:
            raise NotLocal(reason)
