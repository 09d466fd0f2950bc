"""Finds the structure in each cell: occupied cells, the geoms in them, their kinds and names.

The cells of all levels are checked once against structure, one chunk of rows after the other.
Movables are checked separately, see `navbake.baker.occupants.movable`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import Columns, ColumnSource, ShapeSource, TiledShapes
from navbake.baker.core.blocks import LEAST_BLOCKS, Blocks, RowsBuilder, list_rows
from navbake.baker.core.clock import StageClock
from navbake.baker.core.tiles import TILE
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.levels import Floors
from navbake.baker.geometry.extents import Extents
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import (
    LevelOccupancy,
    StructureOccupancy,
    check_level_occupancy,
)
from navbake.baker.occupants import occupant_kernels as kernels
from navbake.baker.occupants.cell_names import name_geoms
from navbake.baker.occupants.column_flags import flag_columns
from navbake.baker.occupants.kinds import (
    MAX_COVERING_HEIGHT,
    MAX_THING_HEIGHT,
    FloorCounts,
    OccupantSizes,
    classify_floor_geoms,
    classify_geoms,
    find_steps,
)
from navbake.baker.occupants.occupant_kernels import FloorLayers, GeomHeights, LevelOccupants
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, NameSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS, run_in_chunks
from navbake.types import Bool, Int32

# The fewest cells that are checked by a call of their own: each takes several calls of numpy
CELLS_PER_CALL = 1 << 14
# Empty rows of `measure_blocks`
NO_ROWS = (np.empty((0, 7), dtype=np.int64), np.empty((0, 2)))


class OccupantGeoms(NamedTuple):
    """The geoms of structure that are listed as occupants of cells.

    Attributes:
        extents: the geoms' bounding boxes.
        is_wall_candidate: mask by geom id of the geoms whose shape may be that of a wall, see
            `navbake.baker.occupants.kinds.mark_wall_candidates`, shape (ngeom,), bool.
    """

    extents: Extents
    is_wall_candidate: Bool


class CellLists(NamedTuple):
    """The lists of the geoms in each cell of a range, of all levels.

    Attributes:
        cells: the range of cell ids.
        geom: geom ids, with -1 at the end of each list, see `check_tiles`, int32.
        flags: the flags of each entry of `geom`, uint8.
    """

    cells: slice
    geom: Int32
    flags: NDArray[np.uint8]


class StandingCells(NamedTuple):
    """The structure in the cells of all levels, and flags of the cells' vertical lines.

    Attributes:
        occupancy: the cells that structure occupies.
        occupants: for each level, the geoms in its cells; empty if they were not requested.
        column_flags: for each level, bits of each cell that the hits on its vertical line decide
            (empty, a hole, steep, under the sky, something tall), see `flag_columns`.
    """

    occupancy: StructureOccupancy
    occupants: list[LevelOccupants]
    column_flags: list[NDArray[np.uint8]]


@dataclass(frozen=True)
class StandingOccupants:
    """The structure in all cells with a floor.

    Attributes:
        levels: for each level, lowest first, the geoms in its cells.
        kinds: for each geom, OBJECT, WALL, STRUCTURE or BUILDING, shape (ngeom,), uint8.
        room_kinds: like `kinds`, but for finding rooms: panes, and geoms with the shape of a wall,
            are WALL regardless of their names.
        names: for each geom, the name under which user data lists it: that of its topmost body, see
            `name_geoms`.
        warnings: warnings about wall patterns, one line each.
    """

    levels: list[LevelOccupants]
    kinds: NDArray[np.uint8]
    room_kinds: NDArray[np.uint8]
    names: list[str]
    warnings: list[str]

    def mark_walls(self, level: int) -> tuple[Bool, Bool]:
        """Mark the cells of a level that a wall blocks, and those that a low wall (a sill) blocks.

        Args:
            level: number of the level.

        Returns:
            A mask of the cells that a wall occupies and blocks; and a mask of the cells that the
            mesh of a whole building blocks without reaching into `WALL_HEIGHTS`, as at a sill; both
            (height, width), bool.
        """
        occupants = self.levels[level]
        cells = np.arange(len(occupants.list_start))
        is_wall = np.empty(len(cells), dtype=np.bool_)
        is_low_wall = np.empty(len(cells), dtype=np.bool_)
        run_in_chunks(
            kernels.mark_walls,
            len(cells),
            occupants,
            self.room_kinds,
            cells,
            is_wall,
            is_low_wall,
            min_chunk_size=LEAST_CELLS,
        )
        shape = occupants.lattice.shape
        return is_wall.reshape(shape), is_low_wall.reshape(shape)


def find_standing_cells(
    columns: ColumnSource,
    shape_source: ShapeSource,
    floors: Floors,
    footprint: Footprint,
    agent: AgentSettings,
    occupant_geoms: OccupantGeoms | None,
    clock: StageClock,
) -> StandingCells:
    """Find the cells that structure occupies, the structure in each, and the flags for rooms.

    Args:
        columns: hits of structure on the vertical line through each cell's centre.
        shape_source: the structure's geometry, by tiles of the same lattice.
        floors: the floors of all levels.
        footprint: the volume over a floor that has to be free.
        agent: the agent; its height, highest step and largest slope are read.
        occupant_geoms: the geoms that are listed as occupants; None to list no occupants.
        clock: measures the time for the flags, which counts as a part of the stage of rooms.
    """
    lattice = columns.lattice
    num_cells = lattice.width * lattice.height
    occupied_masks = [np.isnan(level.floor) for level in floors.levels]
    blocked_square_masks = None
    if footprint.radius > 0.0:
        blocked_square_masks = [mask.copy() for mask in occupied_masks]
    column_flags = [np.empty(num_cells, dtype=np.uint8) for _ in floors.levels]
    occupants_builder = None
    wall_candidates = None
    if occupant_geoms is not None:
        occupants_builder = OccupantsBuilder(lattice, len(floors.levels), occupant_geoms.extents)
        wall_candidates = occupant_geoms.is_wall_candidate

    def check_tile_rows(
        chunk: Columns,
        tiled_shapes: TiledShapes,
        lists_by_tile_row: dict[int, CellLists],
        first_tile_row: int,
        end_tile_row: int,
    ) -> None:
        first_cell = first_tile_row * TILE * lattice.width
        end_cell = min(end_tile_row * TILE * lattice.width, num_cells)
        occupancy_by_level = check_level_occupancy(
            chunk,
            tiled_shapes,
            footprint=footprint,
            cells=np.arange(first_cell, end_cell),
            floors=floors,
            agent=agent,
            wall_candidates=wall_candidates,
        )
        for level_number, level_occupancy in enumerate(occupancy_by_level):
            occupied_masks[level_number].reshape(-1)[level_occupancy.cells] = (
                level_occupancy.occupancy.occupied
            )
            if blocked_square_masks is not None:
                level_blocked_squares = blocked_square_masks[level_number].reshape(-1)
                level_blocked_squares[level_occupancy.cells] = (
                    level_occupancy.occupancy.square_occupied
                )
        if occupants_builder is not None:
            occupants_builder.write_cells(occupancy_by_level)
            occupancy = occupancy_by_level[0].occupancy
            lists_by_tile_row[first_tile_row] = CellLists(
                slice(first_cell, end_cell), occupancy.geom, occupancy.flags
            )

    tile_rows_per_call = -(-CELLS_PER_CALL // (TILE * lattice.width))  # rounded up
    for chunk in columns.row_chunks():
        tiled_shapes = chunk.nearby_shapes or shape_source.shapes_near_rows(chunk.valid_rows)
        first_cell, end_cell = chunk.valid_rows.cell_range(lattice)
        first_tile_row = chunk.valid_rows.first // TILE
        end_tile_row = -(-chunk.valid_rows.end // TILE)  # rounded up
        lists_by_tile_row = dict[int, CellLists]()
        run_in_chunks(
            check_tile_rows,
            end_tile_row - first_tile_row,
            chunk,
            tiled_shapes,
            lists_by_tile_row,
            min_chunk_size=tile_rows_per_call,
            begin=first_tile_row,
        )
        if occupants_builder is not None:
            cell_lists = [lists_by_tile_row[tile_row] for tile_row in sorted(lists_by_tile_row)]
            occupants_builder.append(cell_lists, end_cell / num_cells)
        with clock.add_to_stage("rooms"):
            hits = chunk.hits._replace(start=chunk.start[first_cell : end_cell + 1])
            chunk_flags = flag_columns(hits, floors.levels, slice(first_cell, end_cell), agent)
            for level_flags, level_chunk_flags in zip(column_flags, chunk_flags, strict=True):
                level_flags[first_cell:end_cell] = level_chunk_flags
    return StandingCells(
        occupancy=StructureOccupancy(occupied_masks, blocked_square_masks),
        occupants=[] if occupants_builder is None else occupants_builder.occupants,
        column_flags=column_flags,
    )


class OccupantsBuilder:
    """Collects the occupants of all levels while their cells are checked in chunks."""

    def __init__(self, lattice: Lattice, num_levels: int, extents: Extents) -> None:
        num_cells = lattice.width * lattice.height
        no_geoms = np.empty(0, dtype=np.int32)
        no_flags = np.empty(0, dtype=np.uint8)
        self._lists_builder = RowsBuilder([no_geoms, no_flags])
        self._levels = [
            LevelOccupants(
                lattice=lattice,
                list_start=np.zeros(num_cells, dtype=np.int32),
                geom=no_geoms,
                flags=no_flags,
                floor_geom=np.full(num_cells, -1, dtype=np.int32),
                floor_flags=np.zeros(num_cells, dtype=np.uint8),
            )
            for _ in range(num_levels)
        ]
        # by geom id: how high the geom's surface is over a floor that it lies on, at most [m]
        self._max_gap_on_floor = LIMIT_SLACK + np.fmax(
            extents.top - extents.bottom + MAX_COVERING_HEIGHT, MAX_THING_HEIGHT
        )

    def write_cells(self, occupancy_by_level: Sequence[LevelOccupancy]) -> None:
        """Write which geoms are the floors of some cells, and where the cells' lists begin.

        Several threads may write different cells at a time.

        Args:
            occupancy_by_level: for each level, the cells and their lists. The lists are in the same
                arrays for all levels, see `check_level_occupancy`, which `append` appends.
        """
        for occupants, level_occupancy in zip(self._levels, occupancy_by_level, strict=True):
            cells = level_occupancy.cells
            lists = level_occupancy.occupant_lists
            # where no geom is the floor, `floor_geom` is -1, the last entry: these bits aren't read
            is_on_floor = lists.gap_below <= self._max_gap_on_floor[lists.floor_geom]
            is_covering = lists.gap_below <= MAX_COVERING_HEIGHT + LIMIT_SLACK
            occupants.list_start[cells] = lists.list_start
            occupants.floor_geom[cells] = lists.floor_geom
            occupants.floor_flags[cells] = is_on_floor * kernels.ON_FLOOR | (
                is_covering * kernels.COVERING
            )

    def append(self, cell_lists: Sequence[CellLists], appended_fraction: float) -> None:
        """Append the lists of cells that were written.

        Args:
            cell_lists: the lists of one range of cells after the other.
            appended_fraction: the fraction of all cells that have been appended after this call, in
                (0, 1].
        """
        first_entry = self._lists_builder.num_rows
        for cells, geom, _ in cell_lists:
            for occupants in self._levels:
                # cells without a floor, too: the first of the lists is empty
                occupants.list_start[cells] += np.int32(first_entry)
            first_entry += len(geom)
        self._lists_builder.append(
            [(geom, flags) for _, geom, flags in cell_lists], appended_fraction
        )

    @property
    def occupants(self) -> list[LevelOccupants]:
        """The occupants of each level; cells that were not appended have empty lists."""
        geom, flags = self._lists_builder.build()
        return [occupants._replace(geom=geom, flags=flags) for occupants in self._levels]


def classify_occupants(
    scene: Scene,
    levels: Sequence[LevelOccupants],
    floors: Floors,
    extents: Extents,
    agent: AgentSettings,
    settings: NameSettings,
) -> StandingOccupants:
    """Classify the structure in the cells as walls, whole buildings, floors, ceilings or things.

    Args:
        scene: the scene of the geoms.
        levels: the geoms in each cell, by level.
        floors: the floors of all levels.
        extents: bounding boxes of the structure's geoms.
        agent: the agent; its height and highest step are read.
        settings: the patterns of wall names.

    Returns:
        The geoms in each cell, with their kinds, names and warnings.
    """
    sizes, floor_counts = _measure_levels(levels, floors, extents)
    lattice = levels[0].lattice
    floor_geoms = classify_floor_geoms(
        floor_counts,
        steps=find_steps(floors, [occupants.floor_geom for occupants in levels], lattice),
        cell_size=lattice.cell_size,
        max_step=agent.traversable_floor_height,
    )
    classified_geoms = classify_geoms(
        scene,
        extents,
        sizes=sizes,
        floor_geoms=floor_geoms,
        agent=agent,
        settings=settings,
    )
    return StandingOccupants(
        levels=list(levels),
        kinds=classified_geoms.kinds,
        room_kinds=classified_geoms.room_kinds,
        names=name_geoms(scene),
        warnings=classified_geoms.warnings,
    )


def _measure_levels(
    levels: Sequence[LevelOccupants], floors: Floors, extents: Extents
) -> tuple[OccupantSizes, FloorCounts]:
    """Measure how high geoms rise over floors, and in how many cells their surfaces are the floor.

    Args:
        levels: for each level, the geoms in its cells.
        floors: the floors of all levels.
        extents: bounding boxes of the geoms.

    Returns:
        Heights and occupied areas, and counts of cells, by geom id.
    """
    lattice = levels[0].lattice
    num_geoms = len(extents.bottom)
    geom_heights = GeomHeights(low=extents.bottom, high=extents.top)
    min_bottom_over_floor = np.full(num_geoms, np.inf)
    max_top_over_bottom = np.full(num_geoms, -np.inf)
    is_stood_on = np.zeros(num_geoms, dtype=np.bool_)
    blocks = np.arange(Blocks(lattice).num_blocks)
    total_counts = np.zeros((num_geoms, kernels.NUM_COUNTS), dtype=np.int64)  # of all levels
    largest_counts = np.zeros((num_geoms, kernels.NUM_COUNTS), dtype=np.int64)  # of any level
    for occupants, level in zip(levels, floors.levels, strict=True):
        floor_layers = FloorLayers(level.floor.ravel(), level.standable.ravel())
        _, (block_counts, block_heights) = list_rows(
            kernels.measure_blocks,
            blocks,
            NO_ROWS,
            occupants,
            floor_layers,
            geom_heights,
            least=LEAST_BLOCKS,
        )
        row_geoms = block_counts[:, kernels.GEOM]
        # counted for the level's own geoms alone, which are few of a tower's
        level_geoms, geom_index = np.unique(row_geoms, return_inverse=True)
        level_counts = np.zeros((len(level_geoms), kernels.NUM_COUNTS), dtype=np.int64)
        np.add.at(level_counts, geom_index, block_counts[:, : kernels.NUM_COUNTS])
        total_counts[level_geoms] += level_counts
        largest_counts[level_geoms] = np.maximum(largest_counts[level_geoms], level_counts)
        is_stood_on[row_geoms[block_counts[:, kernels.IS_STANDABLE] > 0]] = True
        np.minimum.at(min_bottom_over_floor, row_geoms, block_heights[:, kernels.MIN_BOTTOM_HEIGHT])
        np.maximum.at(max_top_over_bottom, row_geoms, block_heights[:, kernels.MAX_RISE])
    areas_by_count = (largest_counts * lattice.cell_size**2).astype(np.float64, copy=False)
    sizes = OccupantSizes(
        min_bottom_over_floor=min_bottom_over_floor,
        max_top_over_bottom=max_top_over_bottom,
        area=areas_by_count[:, kernels.NUM_CELLS],
        area_at_wall_height=areas_by_count[:, kernels.NUM_AT_WALL_HEIGHT],
    )
    floor_counts = FloorCounts(
        num_cells=total_counts[:, kernels.NUM_FLOORS],
        num_on_floors=total_counts[:, kernels.NUM_ON_FLOORS],
        num_covering=total_counts[:, kernels.NUM_COVERS],
        is_stood_on=is_stood_on,
    )
    return sizes, floor_counts
