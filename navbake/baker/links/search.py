"""What links are found on: the floors of all levels, where they are free, and straight ways out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import ColumnSource, ShapeSource, cast_columns, tile_shapes
from navbake.baker.core.components import adjacent_pairs, label_components
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import Window, crop_cells
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.occupancy.occupancy import Footprint, check_occupancy
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.links import Stop
from navbake.types import Bool, Float, Int, Json

DIRECTIONS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""The directions in which links cross gaps, as steps of row and column."""
ROOM = 0.5  # between a stop and the edge, for agents larger than the bake's [m]
Crossings = NDArray[np.void]
"""Straight ways between free cells with `CROSSING`'s fields: candidates for links."""
NUMBERS = ("way", "level", "cell", "other_level", "other_cell", "between")
CROSSING = np.dtype([(name, np.int64) for name in NUMBERS] + [("z", "f8"), ("other_z", "f8")])
"""Index into `DIRECTIONS`, both ends, how many cells lie between, and both floors [m]."""

Landing = Callable[[Int, Int, Float, int], tuple[Int, Bool, Bool]]
"""Of rows, columns, floors at the starts, and how many cells lie between, returns the levels to
land on, whether one lands, and whether else one goes on."""


class LatticeLink(NamedTuple):
    """A link: its stops, with cells on the whole lattice, and further fields of a `Link`."""

    stops: list[Stop]
    fields: Json


class CollisionShapes(NamedTuple):
    """Geometry that an agent may collide with, by columns and by tiles of one lattice."""

    columns: ColumnSource
    tiles: ShapeSource


class CollisionGeometry(NamedTuple):
    """What an agent may collide with, on the whole lattice or on a window of it."""

    obstacles: Sequence[CollisionShapes]
    footprint: Footprint
    window: Window | None = None

    def with_shapes(self, shapes: Shapes, lattice: Lattice) -> CollisionGeometry:
        """The space with further geometry."""
        tiled = tile_shapes(shapes, lattice, self.footprint.reach)
        more = CollisionShapes(cast_columns(tiled), tiled)
        return self._replace(obstacles=[*self.obstacles, more])


class LinkSearch(NamedTuple):
    """The levels of a bake as finders of links read them."""

    scene: Scene
    shapes: Shapes  # of all that is no door
    lattice: Lattice
    floors: Float  # of all levels, shape (levels, height, width) of the whole lattice
    free: Bool  # the same; not where a door blocks in any of its states
    geometry: CollisionGeometry
    agent: AgentSettings

    @property
    def step(self) -> float:
        """The highest step, with room for rounding [m]."""
        return self.agent.traversable_floor_height + LIMIT_SLACK

    def stop(self, level: int, cell: int) -> Stop:
        """A stop in the middle of a cell."""
        row, col = divmod(cell, self.lattice.width)
        x, y = self.lattice.positions(row, col).tolist()
        z = float(np.float32(self.floors[level, row, col]))
        return Stop(level, cell, (round(x, 6) + 0.0, round(y, 6) + 0.0, round(z, 6) + 0.0))

    def stand_back(self, level: int, cell: int, way: int, width: float) -> Stop:
        """A stop where any agent that fits through a width is off the edge, at most `ROOM`.

        It lies straight beyond a cell in a direction, over free cells without a step between;
        where these end earlier, on the last of them.
        """
        down, right = DIRECTIONS[way]
        rows, cols = self.lattice.shape
        row, col = divmod(cell, cols)
        for _ in range(
            math.ceil(min(width / 2, ROOM) / self.lattice.cell_size - 0.5 - LIMIT_SLACK)
        ):
            r = row + down
            c = col + right
            floor = self.floors[level]
            if not (0 <= r < rows and 0 <= c < cols and self.free[level, r, c]):
                break
            if abs(floor[r, c] - floor[row, col]) > self.step:
                break
            row = r
            col = c
        return self.stop(level, row * cols + col)

    def look_out(
        self, starts: tuple[int, Bool], ways: Iterable[int], gap: float, land: Landing
    ) -> Crossings:
        """Go straight from marked cells of a level over a gap [m] until `land` lands."""
        level, marked = starts
        parts = [np.empty(0, dtype=CROSSING)]
        rows, cols = self.lattice.shape
        for way in ways:
            down, right = DIRECTIONS[way]
            row, col = np.nonzero(marked)
            z = self.floors[level, row, col]
            for between in range(math.floor(gap / self.lattice.cell_size + LIMIT_SLACK) + 1):
                r = row + (between + 1) * down
                c = col + (between + 1) * right
                inside = (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
                row = row[inside]
                col = col[inside]
                r = r[inside]
                c = c[inside]
                z = z[inside]
                other, lands, goes_on = land(r, c, z, between)
                found = np.empty(int(np.count_nonzero(lands)), dtype=CROSSING)
                found["way"] = way
                found["level"] = level
                found["between"] = between
                found["cell"] = (row * cols + col)[lands]
                found["z"] = z[lands]
                found["other_cell"] = (r * cols + c)[lands]
                found["other_level"] = other[lands]
                found["other_z"] = self.floors[other, r, c][lands]
                parts.append(found)
                goes_on = goes_on & ~lands
                row = row[goes_on]
                col = col[goes_on]
                z = z[goes_on]
        return np.concatenate(parts)

    def are_clear(self, found: Crossings, geometry: CollisionGeometry) -> Bool:
        """Whether nothing stands in the way of each, over its higher end and to its lower one."""
        count = found["between"] + 1
        width = self.lattice.width
        owner = np.repeat(np.arange(len(found)), count)
        step = np.array([down * width + right for down, right in DIRECTIONS])[found["way"]]
        nth = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 1
        top = np.maximum(found["z"], found["other_z"])
        asked: list[tuple[Any, ...]] = [
            (found["cell"][owner] + nth * step[owner], top[owner], owner),
            (found["cell"], top, np.arange(len(found))),
        ]
        # the fall, in volumes over each other without a gap
        stride = self.agent.height - self.agent.traversable_floor_height
        low = found["other_z"] + stride
        while (falls := np.flatnonzero(low < top)).size:
            asked.append((found["other_cell"][falls], low[falls], falls))
            low = low + stride
        cells, floors, whose = (np.concatenate(arrays) for arrays in zip(*asked, strict=True))
        if geometry.window is not None:
            cells = crop_cells(cells, geometry.window, width)[0]
        clear = np.ones(len(found), dtype=np.bool_)
        for obstacles in geometry.obstacles:
            columns = obstacles.columns.covering(np.unique(cells))
            tiled = obstacles.tiles.near_cells(cells)
            met = check_occupancy(columns, tiled, geometry.footprint, cells, floors).occupied
            clear[whose[met]] = False
        return clear

    def group(self, found: Crossings) -> list[tuple[Crossings, np.void, float]]:
        """Group leaps of one way and pair of levels that start side by side, without a step.

        Returns each group, its middle one, and how wide it is for discs [m].
        """
        groups = []
        cols = self.lattice.width
        size = self.lattice.cell_size
        for key in np.unique(found[["level", "other_level", "way"]]):
            own = found[found[["level", "other_level", "way"]] == key]
            own = own[np.argsort(own["cell"], kind="stable")]
            pairs = adjacent_pairs(own["cell"], cols)
            rises = np.abs([np.diff(own[name][pairs], axis=0)[0] for name in ("z", "other_z")])
            part = label_components(pairs[:, (rises <= self.step).all(axis=0)], len(own))
            for number in range(int(part.max(initial=-1)) + 1):
                some = own[part == number]
                at = np.stack(np.divmod(some["cell"], cols)).astype(np.float64)
                off = np.square(at - at.mean(axis=1, keepdims=True)).sum(axis=0)
                length = math.hypot(*np.ptp(at, axis=1)) * size
                width = round(length + max(2 * self.agent.radius, size), 6)
                groups.append((some, some[int(np.argmin(np.round(off, 9)))], width))
        return groups
