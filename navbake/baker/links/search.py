"""What the searches for drops, jumps, ladders and lifts share.

Straight crossings of gaps between free cells are found, tested for obstacles, and grouped; stops
are made of cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import ColumnSource, ShapeSource, cast_columns, tile_shapes
from navbake.baker.core.components import adjacent_pairs, label_components
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import Window, crop_cells
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import check_occupancy
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.links import Stop
from navbake.types import Bool, Float, Int, Json

DIRECTIONS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""The directions in which links cross gaps, as steps of row and column. The index of the opposite
direction differs by 2."""
MAX_SETBACK = 0.5  # how far a stop is moved from the edge at most, for large agents [m]

CROSSING = np.dtype(
    [
        ("direction", np.int64),  # index into `DIRECTIONS`
        ("from_level", np.int64),
        ("from_cell", np.int64),
        ("to_level", np.int64),
        ("to_cell", np.int64),
        ("num_between", np.int64),  # cells between both ends
        ("from_height", np.float64),  # heights of the floors of both ends [m]
        ("to_height", np.float64),
    ]
)
Crossings = NDArray[np.void]
"""Straight lines from free cells over a gap to free cells, an array of `CROSSING`."""


class Landings(NamedTuple):
    """Whether each line over a gap ends in the cell that it has reached; arrays of shape (n,).

    Attributes:
        level: number of the level whose floor the line may end on, int64.
        lands: whether the line ends on that floor, bool.
        goes_on: whether a line that doesn't end here continues to the next cell, bool.
    """

    level: Int
    lands: Bool
    goes_on: Bool


LandingTest = Callable[[Int, Int, Float, int], Landings]
"""A function that decides which lines over a gap end in the cells that they have come to. It takes
the rows and the columns of these cells, (n,), the heights of the floors at the lines' starts, (n,)
[m], and how many cells lie between start and end."""


class LatticeLink(NamedTuple):
    """A link with stops on the whole lattice.

    Attributes:
        stops: its stops, with cells of the whole lattice.
        fields: the remaining fields of a `Link`, by name.
    """

    stops: list[Stop]
    fields: Json


class CollisionShapes(NamedTuple):
    """Geometry that an agent may collide with.

    Attributes:
        columns: its hits on the vertical line through each cell's centre.
        tiles: its shapes near each tile of cells.
    """

    columns: ColumnSource
    tiles: ShapeSource


class CollisionGeometry(NamedTuple):
    """The geometry that an agent on a link may collide with.

    Attributes:
        sources: the geometry; a place is free if no source blocks it.
        footprint: the volume over a cell that has to be free.
        window: the part of the whole lattice that the geometry is on; None for all of it.
    """

    sources: Sequence[CollisionShapes]
    footprint: Footprint
    window: Window | None = None

    def with_shapes(self, shapes: Shapes, lattice: Lattice) -> CollisionGeometry:
        """Return a copy of this geometry to which shapes are added.

        Args:
            shapes: the shapes to add.
            lattice: the lattice of the geometry.
        """
        tiled = tile_shapes(shapes, lattice, self.footprint.half_width)
        further_source = CollisionShapes(cast_columns(tiled), tiled)
        return self._replace(sources=[*self.sources, further_source])


class CrossingGroup(NamedTuple):
    """Crossings side by side, which become one link.

    Attributes:
        crossings: all crossings of the group.
        middle: the crossing in the middle of the group.
        width: the width of the strip that the agent's disc covers on all crossings of the group
            [m]: the distance between the outermost crossings, plus the disc's diameter, or plus the
            edge of a cell if that is longer.
    """

    crossings: Crossings
    middle: np.void
    width: float


class LinkSearch(NamedTuple):
    """The values of a bake that the search for links reads, and the steps of the search.

    Attributes:
        scene: the scene.
        shapes: the geometry of everything except doors.
        lattice: the whole lattice.
        floors: height of the floor [m], NaN for none, shape (levels, height, width), float64.
        free: mask of the cells with a floor that nothing blocks, not even a door in any of its
            states, (levels, height, width), bool.
        geometry: the geometry that an agent on a link may collide with.
        agent: the agent; its radius, height and highest step are read.
    """

    scene: Scene
    shapes: Shapes
    lattice: Lattice
    floors: Float
    free: Bool
    geometry: CollisionGeometry
    agent: AgentSettings

    @property
    def max_step(self) -> float:
        """The agent's highest step plus a tolerance for rounding [m]."""
        return self.agent.traversable_floor_height + LIMIT_SLACK

    def make_stop(self, level: int, cell: int) -> Stop:
        """Make a stop in the middle of a cell.

        Args:
            level: number of the level.
            cell: cell id on the whole lattice.
        """
        row, col = divmod(cell, self.lattice.width)
        x, y = self.lattice.positions(row, col).tolist()
        z = float(np.float32(self.floors[level, row, col]))
        # adding 0 turns -0.0 into 0.0
        return Stop(level, cell, (round(x, 6) + 0.0, round(y, 6) + 0.0, round(z, 6) + 0.0))

    def make_stop_off_edge(self, level: int, cell: int, direction: int, width: float) -> Stop:
        """Make a stop so far from an edge that an agent as wide as the link can stand there.

        The stop lies in `direction` from the cell at the edge, half of the link's width away, but
        at most `MAX_SETBACK`. All cells up to the stop are free, and the floors of neighbours among
        them differ by at most the agent's highest step. Where such cells end earlier, the stop is
        on the last of them.

        Args:
            level: number of the level.
            cell: id of the cell at the edge.
            direction: index into `DIRECTIONS` of the direction away from the edge.
            width: width of the link [m].
        """
        down, right = DIRECTIONS[direction]
        num_rows, num_cols = self.lattice.shape
        floor = self.floors[level]
        free = self.free[level]
        row, col = divmod(cell, num_cols)
        setback = min(width / 2, MAX_SETBACK)
        for _ in range(math.ceil(setback / self.lattice.cell_size - 0.5 - LIMIT_SLACK)):
            next_row = row + down
            next_col = col + right
            is_inside = 0 <= next_row < num_rows and 0 <= next_col < num_cols
            if not is_inside or not free[next_row, next_col]:
                break
            if abs(floor[next_row, next_col] - floor[row, col]) > self.max_step:
                break
            row = next_row
            col = next_col
        return self.make_stop(level, row * num_cols + col)

    def find_crossings(
        self,
        level: int,
        starts: Bool,
        directions: Iterable[int],
        max_gap: float,
        check_landing: LandingTest,
    ) -> Crossings:
        """Find the straight lines from cells of a level, over a gap, that land on a floor.

        Args:
            level: number of the level that the lines start on.
            starts: mask of the cells that lines start from, shape (height, width), bool.
            directions: indices into `DIRECTIONS`.
            max_gap: the widest gap between the two ends [m].
            check_landing: the test that decides in which cell a line ends.

        Returns:
            The lines that land, an array of `CROSSING`.
        """
        crossings = [np.empty(0, dtype=CROSSING)]
        num_rows, num_cols = self.lattice.shape
        max_between = math.floor(max_gap / self.lattice.cell_size + LIMIT_SLACK)
        for direction in directions:
            down, right = DIRECTIONS[direction]
            # the lines that have not ended yet, by where they start
            row, col = np.nonzero(starts)
            from_height = self.floors[level, row, col]
            for num_between in range(max_between + 1):
                to_row = row + (num_between + 1) * down
                to_col = col + (num_between + 1) * right
                is_inside = (to_row >= 0) & (to_row < num_rows)
                is_inside &= (to_col >= 0) & (to_col < num_cols)
                row = row[is_inside]
                col = col[is_inside]
                to_row = to_row[is_inside]
                to_col = to_col[is_inside]
                from_height = from_height[is_inside]
                landings = check_landing(to_row, to_col, from_height, num_between)
                lands = landings.lands
                landed = np.empty(int(np.count_nonzero(lands)), dtype=CROSSING)
                landed["direction"] = direction
                landed["from_level"] = level
                landed["num_between"] = num_between
                landed["from_cell"] = (row * num_cols + col)[lands]
                landed["from_height"] = from_height[lands]
                landed["to_cell"] = (to_row * num_cols + to_col)[lands]
                landed["to_level"] = landings.level[lands]
                landed["to_height"] = self.floors[landings.level, to_row, to_col][lands]
                crossings.append(landed)
                goes_on = landings.goes_on & ~lands
                row = row[goes_on]
                col = col[goes_on]
                from_height = from_height[goes_on]
        return np.concatenate(crossings)

    def mark_clear(self, crossings: Crossings, geometry: CollisionGeometry) -> Bool:
        """Mark the crossings on which an agent meets no obstacle.

        The agent moves over all cells at the height of the higher end, and down to the lower end.

        Args:
            crossings: the crossings, shape (n,).
            geometry: the geometry that may be in the way.

        Returns:
            A mask of `crossings`, shape (n,), bool.
        """
        width = self.lattice.width
        top = np.maximum(crossings["from_height"], crossings["to_height"])
        every_crossing = np.arange(len(crossings))

        # from the cell after the start to the end, at the height of the higher end
        num_steps = crossings["num_between"] + 1
        crossing = np.repeat(every_crossing, num_steps)
        first_step = np.repeat(np.cumsum(num_steps) - num_steps, num_steps)
        step = np.arange(len(crossing)) - first_step + 1
        cell_steps = np.array([down * width + right for down, right in DIRECTIONS])
        cell_step = cell_steps[crossings["direction"]]
        cells = [crossings["from_cell"][crossing] + step * cell_step[crossing]]
        heights = [top[crossing]]
        crossing_of_cell = [crossing]

        # the start
        cells.append(crossings["from_cell"])
        heights.append(top)
        crossing_of_cell.append(every_crossing)

        # the fall at the lower end, as a stack of volumes without a gap between them
        volume_height = self.agent.height - self.agent.traversable_floor_height
        low = crossings["to_height"] + volume_height
        while True:
            falling = np.flatnonzero(low < top)
            if not len(falling):
                break
            cells.append(crossings["to_cell"][falling])
            heights.append(low[falling])
            crossing_of_cell.append(falling)
            low = low + volume_height

        checked_cells = np.concatenate(cells)
        checked_heights = np.concatenate(heights)
        checked_crossings = np.concatenate(crossing_of_cell)
        if geometry.window is not None:
            checked_cells, _ = crop_cells(checked_cells, geometry.window, width)
        is_clear = np.ones(len(crossings), dtype=np.bool_)
        for source in geometry.sources:
            occupancy = check_occupancy(
                source.columns.covering(np.unique(checked_cells)),
                source.tiles.near_cells(checked_cells),
                geometry.footprint,
                checked_cells,
                checked_heights,
            )
            is_clear[checked_crossings[occupancy.occupied]] = False
        return is_clear

    def group_crossings(self, crossings: Crossings) -> list[CrossingGroup]:
        """Group the crossings that lie side by side.

        Crossings of a group have the same direction and the same two levels, and start in adjacent
        cells. From one crossing to the next, the heights of both ends change by a step at most.
        """
        groups = []
        num_cols = self.lattice.width
        cell_size = self.lattice.cell_size
        keys = crossings[["from_level", "to_level", "direction"]]
        for key in np.unique(keys):
            alike = crossings[keys == key]
            alike = alike[np.argsort(alike["from_cell"], kind="stable")]
            pairs = adjacent_pairs(alike["from_cell"], num_cols)
            is_step = np.ones(pairs.shape[1], dtype=np.bool_)
            for heights in (alike["from_height"], alike["to_height"]):
                rise = np.abs(heights[pairs[1]] - heights[pairs[0]])
                is_step &= rise <= self.max_step
            component = label_components(pairs[:, is_step], len(alike))
            for number in range(int(component.max(initial=-1)) + 1):
                members = alike[component == number]
                place = np.stack(np.divmod(members["from_cell"], num_cols)).astype(np.float64)
                offset = place - place.mean(axis=1, keepdims=True)
                distance = np.square(offset).sum(axis=0)
                length = math.hypot(*np.ptp(place, axis=1)) * cell_size
                width = round(length + max(2 * self.agent.radius, cell_size), 6)
                middle = members[int(np.argmin(np.round(distance, 9)))]
                groups.append(CrossingGroup(members, middle, width))
        return groups
