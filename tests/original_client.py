"""How the original client finds the level of a position, from a file's JSON alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

import navbake
from navbake.formats.navgrid import dumps_navgrid
from navbake.navgrid.grid import NavGrid


class Found(NamedTuple):
    """Free cells of all levels, and what became of them."""

    free: int
    elsewhere: int  # put on another level
    nowhere: int  # in no box: the client ends with an error

    @property
    def lost(self) -> int:
        return self.elsewhere + self.nowhere


def look_up(grid: NavGrid, *, by_cells: bool = False) -> Found:
    """Look up the centre of each free cell, on its floor, in a grid as it is written.

    The first level counts with ``bbox.min <= p <= bbox.max`` on each axis. `by_cells` is what
    sstk's `NavScene.js` does instead along x and z: it takes the column and row of the position,
    one beyond the last included.
    """
    content = dumps_navgrid(grid)
    fields = orjson.loads(content)
    levels = fields.get("grids", [fields])
    free = elsewhere = nowhere = 0
    for number, (own, read) in enumerate(zip(levels, navbake.load(content).levels, strict=True)):
        row, col = np.nonzero(read.free)
        x = own["min"][0] + (col + 0.5) * own["cellSize"]
        z = own["min"][2] + (row + 0.5) * own["cellSize"]
        assert read.attributes["floorHeight"].dtype == np.float32
        places = np.stack([x, read.attributes["floorHeight"][row, col].astype(float), z], axis=1)
        found = np.full(len(places), -1)
        for other in reversed(range(len(levels))):
            found[_holds(levels[other], places, by_cells)] = other
        free += len(places)
        elsewhere += int(np.count_nonzero((found >= 0) & (found != number)))
        nowhere += int(np.count_nonzero(found < 0))
    return Found(free, elsewhere, nowhere)


def _holds(level, places, by_cells: bool) -> NDArray[np.bool_]:
    low, high = np.array(level["bbox"]["min"]), np.array(level["bbox"]["max"])
    inside = (low <= places) & (places <= high)
    if by_cells:
        for axis, count in ((0, level["width"]), (2, level["height"])):
            cell = np.floor((places[:, axis] - level["min"][axis]) / level["cellSize"])
            inside[:, axis] = (cell >= 0) & (cell <= count)
    return inside.all(axis=1)
