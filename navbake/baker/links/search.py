"""The steps that the searches for drops, jumps, ladders and lifts have in common.

They find straight crossings of gaps between free cells, test these for obstacles, group them, and
make stops of cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import ColumnSource, ShapeSource, cast_columns, tile_shapes
from navbake.baker.core.components import label_components, list_adjacent_pairs
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
    """Says which lines over a gap end in the cells that they have reached; arrays of shape (n,).

    Attributes:
        level: number of the level whose floor in that cell the line may end on, int64.
        has_landed: whether the line ends on that floor, bool.
        continues: whether a line that doesn't end here continues to the next cell, bool.
    """

    level: Int
    has_landed: Bool
    continues: Bool


LandingTest = Callable[[Int, Int, Float, int], Landings]
"""A function that decides which lines over a gap end in the cells that they have come to. It takes
the rows and the columns of these cells, (n,), the heights of the floors at the lines' starts, (n,)
[m], and how many cells lie between start and end."""


class LatticeLink(NamedTuple):
    """A link with stops on the whole lattice.

    Attributes:
        stops: the link's stops, with cell ids on the whole lattice.
        fields: the remaining fields of a `Link`, by name.
    """

    stops: list[Stop]
    fields: Json


class CollisionShapes(NamedTuple):
    """Geometry that an agent may collide with, such as the structure, or all movables.

    Attributes:
        columns: the geometry's hits on the vertical line through each cell's centre.
        shape_source: the geometry's shapes near each tile of cells.
    """

    columns: ColumnSource
    shape_source: ShapeSource


class CollisionGeometry(NamedTuple):
    """The geometry that an agent on a link may collide with.

    Attributes:
        sources: the geometry in several parts, such as structure and movables; a place is free if
            no part blocks it.
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
        tiled_shapes = tile_shapes(shapes, lattice, self.footprint.half_width)
        added_source = CollisionShapes(cast_columns(tiled_shapes), tiled_shapes)
        return self._replace(sources=[*self.sources, added_source])


class CrossingGroup(NamedTuple):
    """Crossings side by side, which become one link.

    Attributes:
        crossings: all crossings of the group.
        middle_crossing: the crossing in the middle of the group.
        width: the width of the strip of floor that agents cover while they move on the crossings of
            the group [m]: the distance between the outermost crossings, plus the agent's diameter,
            or plus the edge of a cell if that is longer.
    """

    crossings: Crossings
    middle_crossing: np.void
    width: float


class LinkSearch(NamedTuple):
    """The values of a bake that the search for links reads, and the steps of the search.

    Attributes:
        scene: the scene.
        shapes: the geometry of everything except doors.
        lattice: the whole lattice.
        floor_heights: height of the floor [m], NaN for none, shape (levels, height, width),
            float64.
        is_free: mask of the cells with a floor that nothing blocks, not even a door in any of its
            states, (levels, height, width), bool.
        geometry: the geometry that an agent on a link may collide with.
        agent: the agent; its radius, height and highest step are read.
    """

    scene: Scene
    shapes: Shapes
    lattice: Lattice
    floor_heights: Float
    is_free: Bool
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
        z = float(np.float32(self.floor_heights[level, row, col]))
        # adding 0 turns -0.0 into 0.0
        return Stop(level, cell, (round(x, 6) + 0.0, round(y, 6) + 0.0, round(z, 6) + 0.0))

    def make_stop_off_edge(self, level: int, cell: int, direction: int, width: float) -> Stop:
        """Make a stop so far from an edge that an agent as wide as the link can stand there.

        From the cell at the edge, the stop lies half of the link's width away in `direction`, but
        at most `MAX_SETBACK`. On the way there, all cells are free, and the floor changes by at
        most the agent's highest step from cell to cell. If a cell on the way does not fulfil this,
        the stop is on the cell before it.

        Args:
            level: number of the level.
            cell: id of the cell at the edge.
            direction: index into `DIRECTIONS` of the direction away from the edge.
            width: width of the link [m].
        """
        row_step, col_step = DIRECTIONS[direction]
        num_rows, num_cols = self.lattice.shape
        floor = self.floor_heights[level]
        is_free = self.is_free[level]
        row, col = divmod(cell, num_cols)
        setback = min(width / 2, MAX_SETBACK)
        for _ in range(math.ceil(setback / self.lattice.cell_size - 0.5 - LIMIT_SLACK)):
            next_row = row + row_step
            next_col = col + col_step
            is_inside = 0 <= next_row < num_rows and 0 <= next_col < num_cols
            if not is_inside or not is_free[next_row, next_col]:
                break
            if abs(floor[next_row, next_col] - floor[row, col]) > self.max_step:
                break
            row = next_row
            col = next_col
        return self.make_stop(level, row * num_cols + col)

    def find_crossings(
        self,
        level: int,
        is_start: Bool,
        directions: Iterable[int],
        max_gap: float,
        check_landing: LandingTest,
    ) -> Crossings:
        """Find the straight lines from cells of a level, over a gap, that land on a floor.

        Args:
            level: number of the level that the lines start on.
            is_start: mask of the cells that lines start from, shape (height, width), bool.
            directions: indices into `DIRECTIONS`.
            max_gap: the widest gap between the two ends [m].
            check_landing: the test that decides in which cell a line ends, and on which level; it
                returns `Landings`.

        Returns:
            The lines that land, an array of `CROSSING`.
        """
        crossings = [np.empty(0, dtype=CROSSING)]
        num_rows, num_cols = self.lattice.shape
        max_num_between = math.floor(max_gap / self.lattice.cell_size + LIMIT_SLACK)
        for direction in directions:
            row_step, col_step = DIRECTIONS[direction]
            # the lines that have not ended yet, by where they start
            start_rows, start_cols = np.nonzero(is_start)
            from_height = self.floor_heights[level, start_rows, start_cols]
            for num_between in range(max_num_between + 1):
                to_row = start_rows + (num_between + 1) * row_step
                to_col = start_cols + (num_between + 1) * col_step
                is_inside = (to_row >= 0) & (to_row < num_rows)
                is_inside &= (to_col >= 0) & (to_col < num_cols)
                start_rows = start_rows[is_inside]
                start_cols = start_cols[is_inside]
                to_row = to_row[is_inside]
                to_col = to_col[is_inside]
                from_height = from_height[is_inside]
                landings = check_landing(to_row, to_col, from_height, num_between)
                is_landed = landings.has_landed
                landed_crossings = np.empty(int(np.count_nonzero(is_landed)), dtype=CROSSING)
                landed_crossings["direction"] = direction
                landed_crossings["from_level"] = level
                landed_crossings["num_between"] = num_between
                landed_crossings["from_cell"] = (start_rows * num_cols + start_cols)[is_landed]
                landed_crossings["from_height"] = from_height[is_landed]
                landed_crossings["to_cell"] = (to_row * num_cols + to_col)[is_landed]
                landed_crossings["to_level"] = landings.level[is_landed]
                landed_crossings["to_height"] = self.floor_heights[landings.level, to_row, to_col][
                    is_landed
                ]
                crossings.append(landed_crossings)
                is_unfinished = landings.continues & ~is_landed
                start_rows = start_rows[is_unfinished]
                start_cols = start_cols[is_unfinished]
                from_height = from_height[is_unfinished]
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
        higher_end_height = np.maximum(crossings["from_height"], crossings["to_height"])
        crossing_indices = np.arange(len(crossings))

        # from the cell after the start to the end, at the height of the higher end
        num_steps = crossings["num_between"] + 1
        crossing_of_step = np.repeat(crossing_indices, num_steps)
        first_step = np.repeat(np.cumsum(num_steps) - num_steps, num_steps)
        step_number = np.arange(len(crossing_of_step)) - first_step + 1
        id_steps_by_direction = np.array(
            [row_step * width + col_step for row_step, col_step in DIRECTIONS]
        )
        id_step = id_steps_by_direction[crossings["direction"]]
        cells = [crossings["from_cell"][crossing_of_step] + step_number * id_step[crossing_of_step]]
        heights = [higher_end_height[crossing_of_step]]
        crossing_of_cell = [crossing_of_step]

        # the start
        cells.append(crossings["from_cell"])
        heights.append(higher_end_height)
        crossing_of_cell.append(crossing_indices)

        # the fall at the lower end, as a stack of volumes without a gap between them
        volume_height = self.agent.height - self.agent.traversable_floor_height
        volume_floor_height = crossings["to_height"] + volume_height
        while True:
            falling_crossings = np.flatnonzero(volume_floor_height < higher_end_height)
            if not len(falling_crossings):
                break
            cells.append(crossings["to_cell"][falling_crossings])
            heights.append(volume_floor_height[falling_crossings])
            crossing_of_cell.append(falling_crossings)
            volume_floor_height = volume_floor_height + volume_height

        checked_cells = np.concatenate(cells)
        checked_heights = np.concatenate(heights)
        crossing_of_checked_cell = np.concatenate(crossing_of_cell)
        if geometry.window is not None:
            checked_cells, _ = crop_cells(checked_cells, geometry.window, width)
        is_clear = np.ones(len(crossings), dtype=np.bool_)
        for source in geometry.sources:
            occupancy = check_occupancy(
                source.columns.columns_at(np.unique(checked_cells)),
                source.shape_source.shapes_near_cells(checked_cells),
                geometry.footprint,
                checked_cells,
                checked_heights,
            )
            is_clear[crossing_of_checked_cell[occupancy.occupied]] = False
        return is_clear

    def group_crossings(self, crossings: Crossings) -> list[CrossingGroup]:
        """Group the crossings that lie side by side.

        Crossings of a group have the same direction and the same two levels, and start in adjacent
        cells. From one crossing to the next, the heights of both ends change by a step at most.

        Args:
            crossings: the crossings, shape (n,).

        Returns:
            The groups, in the order of their levels and directions.
        """
        groups = []
        num_cols = self.lattice.width
        cell_size = self.lattice.cell_size
        group_keys = crossings[["from_level", "to_level", "direction"]]
        for group_key in np.unique(group_keys):
            similar_crossings = crossings[group_keys == group_key]
            similar_crossings = similar_crossings[
                np.argsort(similar_crossings["from_cell"], kind="stable")
            ]
            adjacent_pairs = list_adjacent_pairs(similar_crossings["from_cell"], num_cols)
            is_small_step = np.ones(adjacent_pairs.shape[1], dtype=np.bool_)
            for end_heights in (similar_crossings["from_height"], similar_crossings["to_height"]):
                height_difference = np.abs(
                    end_heights[adjacent_pairs[1]] - end_heights[adjacent_pairs[0]]
                )
                is_small_step &= height_difference <= self.max_step
            group_of_crossing = label_components(
                adjacent_pairs[:, is_small_step], len(similar_crossings)
            )
            for group_number in range(int(group_of_crossing.max(initial=-1)) + 1):
                group_crossings = similar_crossings[group_of_crossing == group_number]
                start_cells = np.stack(np.divmod(group_crossings["from_cell"], num_cols)).astype(
                    np.float64
                )
                offset_from_mean = start_cells - start_cells.mean(axis=1, keepdims=True)
                squared_distance = np.square(offset_from_mean).sum(axis=0)
                length = math.hypot(*np.ptp(start_cells, axis=1)) * cell_size
                width = round(length + max(2 * self.agent.radius, cell_size), 6)
                middle_crossing = group_crossings[int(np.argmin(np.round(squared_distance, 9)))]
                groups.append(CrossingGroup(group_crossings, middle_crossing, width))
        return groups
