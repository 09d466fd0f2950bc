"""What stands in each cell: whether it is occupied, by which geoms, what they are, their names.

What stands is looked at once, block by block; what can move is looked at by itself, see
`navbake.baker.occupants.movable`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import Columns, ColumnSource, ShapeSource, TiledShapes
from navbake.baker.core.blocks import Blocks, list_rows
from navbake.baker.core.clock import StageClock
from navbake.baker.core.components import expand_ranges
from navbake.baker.core.limits import agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK, TOUCH_DEPTH
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.geometry.extents import Extents
from navbake.baker.occupancy.occupancy import (
    NO_LISTING,
    CellOccupancy,
    Footprint,
    Occupancy,
    check_occupancy,
)
from navbake.baker.occupancy.occupancy_kernels import OccupantLists
from navbake.baker.occupants import list_kernels as kernels
from navbake.baker.occupants.cell_names import name_geoms
from navbake.baker.occupants.column_flags import flag_columns
from navbake.baker.occupants.kinds import (
    COVERING,
    THING_HEIGHT,
    WALL_HEIGHTS,
    GeomHeights,
    classify_floor_geoms,
    classify_geoms,
    find_steps,
)
from navbake.baker.occupants.list_kernels import LevelOccupants
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, NameSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS, run_in_chunks
from navbake.types import Bool, Int, Int32

# Lists get so many times the room that they are expected to need
SPARE = 1.1
# How far above its floors the last storey ends, whatever moves at the scene's top [m]
OPEN_ABOVE = 100.0
# Empty columns of `measure_blocks`
NO_MEASURES = np.empty((0, 7), dtype=np.int64), np.empty((0, 2))


class LevelOccupancy(NamedTuple):
    """What was found over the floors of some cells of a level.

    Attributes:
        cells: those of the cells that have a floor, shape (n,).
        found: the answers for these.
        listing: the lists of what stands in them; empty if none are asked for.
    """

    cells: Int
    found: CellOccupancy
    listing: OccupantLists


class StandingCells(NamedTuple):
    """What stands in the cells of all storeys.

    Attributes:
        occupancy: the cells that it occupies.
        levels: the geoms in each cell, by level; empty if they are not asked for.
        column_flags: flags of each cell's column, by level, see `flag_columns`.
    """

    occupancy: Occupancy
    levels: list[LevelOccupants]
    column_flags: list[NDArray[np.uint8]]


@dataclass(frozen=True)
class StandingOccupants:
    """What stands in all cells with a floor.

    Attributes:
        levels: the storeys' cells, lowest first.
        kinds: by geom id, OBJECT, WALL, STRUCTURE or BUILDING, shape (ngeom,), uint8.
        partitions: the same for rooms, which walls by shape and panes part whatever their names.
        names: by geom id, see `name_geoms`.
        warnings: what the user should know, one line each.
    """

    levels: list[LevelOccupants]
    kinds: NDArray[np.uint8]
    partitions: NDArray[np.uint8]
    names: list[str]
    warnings: list[str]

    def mark_walls(self, level: int) -> tuple[Bool, Bool]:
        """Mark the cells that a wall stands in and blocks.

        Also returns those that a building's mesh blocks only below `WALL_HEIGHTS`.
        """
        listed = self.levels[level]
        cells = np.arange(len(listed.first))
        walls = np.empty(len(cells), dtype=np.bool_)
        lows = np.empty(len(cells), dtype=np.bool_)
        run_in_chunks(
            kernels.mark_walls,
            len(cells),
            listed,
            self.partitions,
            cells,
            walls,
            lows,
            least=LEAST_CELLS,
        )
        return walls.reshape(listed.lattice.shape), lows.reshape(listed.lattice.shape)


def find_tops(floors: Floors) -> list[float]:
    """The height at which each storey ends: the next one's ground; inf for the last [m]."""
    return [*(level.ground for level in floors.levels[1:]), np.inf]


def check_level_occupancy(
    columns: Columns,
    tiled: TiledShapes,
    footprint: Footprint,
    cells: Int,
    level: LevelFloor,
    top: float,
    agent: AgentSettings,
    probed: Bool | None,
) -> LevelOccupancy:
    """Look at what is over the floors of some cells of a level, ascending.

    Args:
        columns, tiled: the geometry that is looked for, near these cells.
        top: where the storey ends [m].
        probed: by geom id, whether it is tested in the walls' band; None to list nothing.
    """
    floor = level.floor.ravel()[cells]
    has_floor = ~np.isnan(floor)
    here = cells[has_floor]
    heights = floor[has_floor]
    listing = NO_LISTING
    if probed is not None:
        ceiling = np.minimum(top, heights + OPEN_ABOVE)
        listing = OccupantLists(
            ceiling=np.maximum(ceiling, heights + agent.height) - TOUCH_DEPTH,
            first=np.empty(len(here), dtype=np.int32),
            carrier=np.empty(len(here), dtype=np.int32),
            gap=np.empty(len(here)),
            probed=probed,
            low=WALL_HEIGHTS[0] + TOUCH_DEPTH,
            high=WALL_HEIGHTS[1] - TOUCH_DEPTH,
            min_up=agent_limits(agent).min_up,
        )
    found = check_occupancy(columns, tiled, footprint, here, heights, listing)
    return LevelOccupancy(here, found, listing)


def find_standing_cells(
    columns: ColumnSource,
    tiles: ShapeSource,
    floors: Floors,
    footprint: Footprint,
    agent: AgentSettings,
    probed: Bool | None,
    clock: StageClock,
) -> StandingCells:
    """Find what stands in all cells, and flag their columns for rooms, in one pass over the blocks.

    Args:
        columns: of what stands.
        tiles: what stands, by tiles of the same lattice.
        probed: see `check_level_occupancy`.
        clock: times the flags as a part of rooms.
    """
    lattice = columns.lattice
    num_cells = lattice.width * lattice.height
    tops = find_tops(floors)
    taken = [np.isnan(level.floor) for level in floors.levels]
    solid = [mask.copy() for mask in taken] if footprint.radius > 0.0 else None
    flags = [np.zeros(num_cells, dtype=np.uint8) for _ in floors.levels]
    lists = [GrowingLists(lattice) for _ in floors.levels if probed is not None]
    for block in columns.row_chunks():
        tiled = block.nearby_shapes or tiles.near_rows(block.valid_rows)
        first, end = block.valid_rows.cell_range(lattice)
        cells = np.arange(first, end)
        for k, level in enumerate(floors.levels):
            look = check_level_occupancy(
                block,
                tiled,
                footprint=footprint,
                cells=cells,
                level=level,
                top=tops[k],
                agent=agent,
                probed=probed,
            )
            taken[k].reshape(-1)[look.cells] = look.found.occupied
            if solid is not None:
                solid[k].reshape(-1)[look.cells] = look.found.solid
            if probed is not None:
                lists[k].append(look, end / num_cells)
        with clock.part("rooms"):
            hits = block.hits._replace(start=block.start[first : end + 1])
            for k, level in enumerate(floors.levels):
                flag_columns(hits, level, slice(first, end), agent, flags[k])
    levels = [growing.listed for growing in lists]
    return StandingCells(Occupancy(taken, solid), levels, flags)


class GrowingLists:
    """The lists of a level's cells, while blocks are added; `listed` has what was added."""

    def __init__(self, lattice: Lattice) -> None:
        num = lattice.width * lattice.height
        self._used = 0
        self.listed = LevelOccupants(
            lattice=lattice,
            first=np.zeros(num, dtype=np.int32),
            geom=np.empty(0, dtype=np.int32),
            flags=np.empty(0, dtype=np.uint8),
            carrier=np.full(num, -1, dtype=np.int32),
            gap=np.full(num, np.inf),
        )

    def append(self, look: LevelOccupancy, share: float) -> None:
        """Add the lists of some cells; `share` of all cells are known with these."""
        used = self._used
        needed = used + len(look.found.geom)
        if needed > len(self.listed.geom):
            size = int(needed * SPARE / share) if share < 1.0 else needed
            geom = np.empty(size, dtype=np.int32)
            flags = np.empty(size, dtype=np.uint8)
            geom[:used] = self.listed.geom[:used]
            flags[:used] = self.listed.flags[:used]
            self.listed = self.listed._replace(geom=geom, flags=flags)
        self.listed.geom[used:needed] = look.found.geom
        self.listed.flags[used:needed] = look.found.flags
        self.listed.first[look.cells] = look.listing.first + np.int32(used)
        self.listed.carrier[look.cells] = look.listing.carrier
        self.listed.gap[look.cells] = look.listing.gap
        self._used = needed


def classify_occupants(
    scene: Scene,
    levels: Sequence[LevelOccupants],
    floors: Floors,
    extents: Extents,
    agent: AgentSettings,
    settings: NameSettings,
) -> StandingOccupants:
    """Classify what stands in the cells: walls, buildings, their floors and ceilings, or things.

    Args:
        levels: the geoms in each cell.
        extents: of all that stands.
    """
    over_floors, counts, stood_on = _measure_levels(levels, floors, extents)
    carrier = np.stack([listed.carrier for listed in levels])
    lattice = levels[0].lattice
    carriers = classify_floor_geoms(
        counts=counts,
        stood_on=stood_on,
        cell_size=lattice.cell_size,
        step=agent.traversable_floor_height,
        steps=find_steps(floors, carrier, lattice),
    )
    kinds, partitions, warnings = classify_geoms(
        scene,
        extents,
        over_floors=over_floors,
        carriers=carriers,
        agent=agent,
        settings=settings,
    )
    return StandingOccupants(list(levels), kinds, partitions, name_geoms(scene), warnings)


def _measure_levels(
    levels: Sequence[LevelOccupants], floors: Floors, extents: Extents
) -> tuple[GeomHeights, Int, Bool]:
    """How geoms stand over floors, and the arguments of `classify_floor_geoms`."""
    num = len(extents.low)
    heights = (extents.low, extents.high)
    base = np.full(num, np.inf)
    rise = np.full(num, -np.inf)
    stood_on = np.zeros(num, dtype=np.bool_)
    on_floor = np.fmax(extents.high - extents.low + COVERING, THING_HEIGHT) + LIMIT_SLACK
    limits = (on_floor, COVERING + LIMIT_SLACK)
    blocks = np.arange(Blocks(levels[0].lattice).num)
    counts = np.zeros((len(levels), 5, num), dtype=np.int64)
    for k, (listed, level) in enumerate(zip(levels, floors.levels, strict=True)):
        layers = (level.floor.ravel(), level.standable.ravel())
        _, (rows, over) = list_rows(
            kernels.measure_blocks, blocks, NO_MEASURES, listed, layers, heights, limits
        )
        geom = rows[:, 0]
        np.add.at(counts[k].T, geom, rows[:, 1:6])
        stood_on[geom[rows[:, 6] > 0]] = True
        np.minimum.at(base, geom, over[:, 0])
        np.maximum.at(rise, geom, over[:, 1])
    area, upper_area = counts[:, :2].max(axis=0) * levels[0].lattice.cell_size ** 2
    over_floors = GeomHeights(base, rise, area, upper_area)
    return over_floors, counts[:, 2:].sum(axis=0), stood_on


def entries_of_cells(
    first: Int32, geom: Int32, flags: NDArray[np.uint8], cells: Int
) -> tuple[Int, Int32, NDArray[np.uint8]]:
    """What lists say of some cells, by cell and then geom: places in `cells`, geoms and flags.

    The list of cell i begins at `first[i]` and ends before the geom -1.
    """
    begin = first[cells]
    counts = np.zeros(len(cells), dtype=np.int64)
    left = np.flatnonzero(geom[begin] >= 0)
    while len(left):  # cells whose lists go on
        counts[left] += 1
        left = left[geom[begin[left] + counts[left]] >= 0]
    cell, place = expand_ranges(begin, begin + counts)
    return cell, geom[place], flags[place]
