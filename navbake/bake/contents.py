"""What stands in each cell: which geoms, what they are, and under which names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navbake.bake.columns import Columns, TiledShapes
from navbake.bake.extents import Extents, measure_geoms
from navbake.bake.levels import Floors, LevelFloor
from navbake.bake.occupancy import TOUCH, Footprint
from navbake.bake.scene import Scene
from navbake.bake.structure import Carriers, Footing, find_carriers, find_ceilings
from navbake.bake.walls import (
    BUILDING,
    DOOR,
    OBJECT,
    STRUCTURE,
    WALL,
    WALL_BAND,
    Standing,
    find_buildings,
    find_walls,
    is_static,
    match_walls,
    wall_candidates,
)
from navbake.config import AgentSettings, NameSettings
from navbake.kernels.contents import count_candidates, describe_floors, list_geoms
from navbake.kernels.flags import BLOCKS, PROBED, STANDS, UNPROVED
from navbake.kernels.lists import number_lists
from navbake.kernels.sheets import SAME, SLACK
from navbake.lattice import Lattice

Bool = NDArray[np.bool_]
Window = tuple[slice, slice]
Names = dict[str, list[str]]

# Keys of a cell's user data, and the bits that stand for them while they are gathered
DOORS, OBJECTS, WALLS, BLOCKERS = 1, 2, 4, 8
KEYS = {"doors": DOORS, "objects": OBJECTS, "walls": WALLS}
NAMED = OBJECTS | WALLS  # doors are objects, too
ALL_BITS = 16


@dataclass(frozen=True)
class LevelContents:
    """The geoms of a storey's cells, ragged: cell i holds ``[start[i], start[i + 1])``.

    Attributes:
        lattice: the cells, the whole lattice.
        start: shape (cells + 1,), int64.
        geom: MuJoCo's geom ids, ascending in a cell, shape (n,), int32.
        stands: whether the geom meets the cell's square between floor and ceiling, shape (n,).
        blocks: whether it meets the volume that the occupancy is about, shape (n,), bool.
        upper: whether it stands there and meets the square in `WALL_BAND`, be that above the
            ceiling or not, shape (n,), bool; asked only of `wall_candidates`.
        footing: what carries the floor.
    """

    lattice: Lattice
    start: NDArray[np.int64]
    geom: NDArray[np.int32]
    stands: Bool
    blocks: Bool
    upper: Bool
    footing: Footing

    @property
    def cell(self) -> NDArray[np.int64]:
        """Cell id of each entry, shape (n,), int64."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))


@dataclass(frozen=True)
class Contents:
    """What stands in all cells with a floor.

    Attributes:
        levels: the storeys' cells, lowest first.
        kinds: by geom id, OBJECT, WALL, STRUCTURE, DOOR or BUILDING, shape (ngeom,), uint8.
        names: by geom id, see `name_geoms`.
        extents: the geoms'.
        warnings: what the user should know, one line each.
    """

    levels: list[LevelContents]
    kinds: NDArray[np.uint8]
    names: list[str]
    extents: Extents
    warnings: list[str]

    def wall_cells(self, level: int) -> Bool:
        """Mark the cells of a storey that a wall stands in and blocks.

        Returns:
            Shape (height, width) of the whole lattice, bool. Cells without a floor are not
            among them.
        """
        listed = self.levels[level]
        chosen = self._is_wall(listed) & listed.stands & listed.blocks
        cells = np.zeros(len(listed.start) - 1, dtype=np.bool_)
        cells[listed.cell[chosen]] = True
        return cells.reshape(listed.lattice.shape)

    def user_data(self, level: int, window: Window) -> dict[int, Names]:
        """Name what stands in a storey's cells, as the original client does.

        `objects` are all things but walls and the building's own floors, ceilings and stairs;
        `doors` are those of them that are doors; `walls` are the walls; `blockers` are the
        names of all that blocks the cell, where that isn't the same as all of the former. Of
        what carries a floor, only things are named where one stands on them (rugs, pallets).

        Args:
            level: its number.
            window: rows and columns of the lattice that its grid holds.

        Returns:
            By cell id on the window, ascending: sorted names under each key that has any.
            Cells with the same names share one dict; nobody may change it.
        """
        listed = self.levels[level]
        cell, name, bits = self._name_bits(listed)
        token = name * ALL_BITS + bits
        if window != (slice(0, listed.lattice.height), slice(0, listed.lattice.width)):
            row, col = np.divmod(cell, listed.lattice.width)
            (top, bottom), (left, right) = ((side.start, side.stop) for side in window)
            inside = (row >= top) & (row < bottom) & (col >= left) & (col < right)
            cell, token = ((row - top) * (right - left) + col - left)[inside], token[inside]
        first = np.flatnonzero(np.diff(cell, prepend=-1))
        start = np.append(first, len(cell))
        number = np.empty(len(first), dtype=np.int64)
        lists = number_lists(start, token, number)
        described = self._describe(token, start[lists], start[lists + 1])
        found = map(described.__getitem__, number.tolist())
        return dict(zip(cell[first].tolist(), found, strict=True))

    def _is_wall(self, listed: LevelContents) -> Bool:
        kind = self.kinds[listed.geom]
        wall: Bool = (kind == WALL) | ((kind == BUILDING) & listed.upper)
        return wall

    def _name_bits(
        self, listed: LevelContents
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Cells, numbers of names and keys, by cell and then name, none twice."""
        kind = self.kinds[listed.geom]
        bits = np.where(listed.blocks, BLOCKERS, 0)
        bits |= np.where(listed.stands & self._is_wall(listed), WALLS, 0)
        bits |= np.where(listed.stands & (kind == OBJECT), OBJECTS, 0)
        bits |= np.where(listed.stands & (kind == DOOR), OBJECTS | DOORS, 0)
        number = _number_names(self.names)
        carrier = listed.footing.carrier
        below = np.flatnonzero(carrier >= 0)
        below = below[self.kinds[carrier[below]] == OBJECT]
        cell = np.concatenate([listed.cell, below])
        name = np.concatenate([number[listed.geom], number[carrier[below]]])
        bits = np.concatenate([bits, np.full(len(below), OBJECTS)])
        kept = bits > 0
        cell, name, bits = cell[kept], name[kept], bits[kept]
        pair = cell * len(self.names) + name
        if (np.diff(pair) < 0).any():
            order = np.argsort(pair, kind="stable")
            pair, cell, name, bits = pair[order], cell[order], name[order], bits[order]
        first = np.flatnonzero(np.diff(pair, prepend=-1))
        merged = np.bitwise_or.reduceat(bits, first) if len(first) else bits
        return cell[first], name[first], merged

    def _describe(
        self, token: NDArray[np.int64], begin: NDArray[np.int64], end: NDArray[np.int64]
    ) -> list[Names]:
        """The user data of cells that hold the tokens from each begin to its end."""
        name_of = [self.names[k] for k in (token // ALL_BITS).tolist()]
        bits_of = (token % ALL_BITS).tolist()
        described = []
        for one, other in zip(begin.tolist(), end.tolist(), strict=True):
            names, bits = name_of[one:other], bits_of[one:other]
            if len(set(bits)) == 1:
                names.sort()
                described.append(dict.fromkeys(_KEYS_OF[bits[0]], names))
            else:
                described.append(_describe_mixed(names, bits))
        return described


def _describe_mixed(names: Sequence[str], bits: Sequence[int]) -> Names:
    """The user data of a cell that holds names under different keys."""
    pairs = sorted(zip(names, bits, strict=True))
    data = {
        key: found for key, bit in KEYS.items() if (found := [name for name, b in pairs if b & bit])
    }
    if any(bool(b & BLOCKERS) != bool(b & NAMED) for b in bits):
        blockers = [name for name, b in pairs if b & BLOCKERS]
        if blockers:
            data["blockers"] = blockers
    return data


# The keys of a cell whose names all have the same bits
_KEYS_OF = [list(_describe_mixed(["name"], [bits])) for bits in range(ALL_BITS)]


def find_contents(
    scene: Scene,
    columns: Columns,
    tiled: TiledShapes,
    floors: Floors,
    occupied: Sequence[Bool],
    agent: AgentSettings,
    settings: NameSettings,
    doors: Bool | None = None,
) -> Contents:
    """List what stands in every cell with a floor, and tell what each geom is.

    Args:
        scene: the scene.
        columns: all surfaces.
        tiled: the geometry on its lattice.
        floors: the storeys.
        occupied: their occupancy, shape (height, width) each, bool.
        agent: its size, step and slope.
        settings: what the user says of walls.
        doors: by geom id, which geoms are doors; none if None.
    """
    num = len(scene.geoms)
    extents = measure_geoms(scene.shapes, num)
    candidates = wall_candidates(scene, extents)
    tops = _level_tops(scene, floors)
    levels = [
        _list_level(columns, tiled, level, top, mask, agent, candidates)
        for level, top, mask in zip(floors.levels, tops, occupied, strict=True)
    ]
    footings = [listed.footing for listed in levels]
    carriers = find_carriers(floors, footings, extents, agent, columns.lattice)
    standing = _standing(levels, floors, extents)
    kinds = _tell_kinds(scene, extents, standing, carriers, agent, doors)
    named, warnings = match_walls(scene, settings.walls)
    if settings.walls:
        kinds[kinds == WALL] = OBJECT
        kinds[named] = WALL
    return Contents(levels, kinds, name_geoms(scene), extents, warnings)


def _tell_kinds(
    scene: Scene,
    extents: Extents,
    standing: Standing,
    carriers: Carriers,
    agent: AgentSettings,
    doors: Bool | None,
) -> NDArray[np.uint8]:
    """Tell what each geom is, walls by their shape."""
    buildings = find_buildings(scene, extents, standing)
    excluded = buildings if doors is None else buildings | doors
    walls = find_walls(scene, extents, standing, carriers, excluded)
    kinds = np.full(len(extents.thin), OBJECT, dtype=np.uint8)
    ceilings = find_ceilings(extents, standing.base, is_static(scene), agent)
    kinds[carriers.building | ceilings] = STRUCTURE
    kinds[walls] = WALL
    kinds[buildings] = BUILDING
    if doors is not None:
        kinds[doors] = DOOR
    return kinds


def name_geoms(scene: Scene) -> list[str]:
    """Name each geom after its topmost body, or by its own name where it hangs on the world.

    What has no name is called ``body 3`` or ``geom 12``.
    """
    model = scene.model
    roots = model.body_rootid[model.geom_bodyid]
    bodies = {int(root): model.body(root).name or f"body {root}" for root in np.unique(roots)}
    return [
        bodies[int(root)] if root else report.name
        for root, report in zip(roots, scene.geoms, strict=True)
    ]


def _level_tops(scene: Scene, floors: Floors) -> list[float]:
    """The height where each storey ends: the next one's ground, or the scene's top [m]."""
    top = -np.inf if scene.bounds is None else float(scene.bounds[1, 2])
    return [*(level.ground for level in floors.levels[1:]), top]


def _list_level(
    columns: Columns,
    tiled: TiledShapes,
    level: LevelFloor,
    top: float,
    occupied: Bool,
    agent: AgentSettings,
    probed: Bool,
) -> LevelContents:
    """List the geoms of one storey's cells; a cell's ceiling is never lower than the agent."""
    lattice, shapes = columns.lattice, tiled.shapes
    place = (lattice.x_min, lattice.y_max, lattice.cell_size, lattice.width, lattice.height)
    solids, planes = shapes.solids, shapes.planes
    footprint = Footprint.of(agent, lattice.cell_size)
    half = lattice.cell_size / 2 - TOUCH
    upper_low, upper_high = WALL_BAND[0] + TOUCH, WALL_BAND[1] - TOUCH
    floor = level.floor.ravel()
    ceiling = np.maximum(top, floor + agent.height) - TOUCH
    slot = np.zeros(len(floor) + 1, dtype=np.int64)
    count_candidates(
        *place, floor, ceiling, footprint.reach,
        tiled.solid_start, tiled.solid_item, solids.bounds,
        tiled.triangle_start, tiled.triangle_item, shapes.triangles.geom, tiled.triangle_bounds,
        planes.pos, planes.mat, slot[1:],
    )  # fmt: skip
    np.cumsum(slot, out=slot)
    geom, flags = np.empty(slot[-1], dtype=np.int32), np.zeros(slot[-1], dtype=np.uint8)
    list_geoms(
        *place, floor, ceiling, SAME + TOUCH, upper_low, upper_high, half,
        footprint.square, footprint.radius, footprint.low, footprint.high,
        occupied.ravel(), probed,
        columns.start, columns.z, columns.normal, columns.geom, shapes.closed,
        tiled.solid_start, tiled.solid_item, solids.geom, solids.kind, solids.pos, solids.mat,
        solids.size, solids.bounds,
        tiled.triangle_start, tiled.triangle_item, shapes.triangles.geom,
        shapes.triangles.corners, tiled.triangle_bounds,
        planes.geom, planes.pos, planes.mat,
        slot, geom, flags,
    )  # fmt: skip
    kept = flags > 0
    start, flags = np.concatenate([[0], np.cumsum(kept)])[slot], flags[kept]
    unproved = np.flatnonzero(flags & UNPROVED)
    if len(unproved):  # what FCL found out about the cell decides
        cells = np.searchsorted(start, unproved, side="right") - 1
        flags[unproved[occupied.ravel()[cells]]] |= BLOCKS
    return LevelContents(
        lattice=lattice,
        start=start,
        geom=geom[kept],
        stands=(flags & STANDS) > 0,
        blocks=(flags & BLOCKS) > 0,
        upper=(flags & PROBED) > 0,
        footing=_footing(columns, floor, agent),
    )


def _footing(columns: Columns, floor: NDArray[np.float64], agent: AgentSettings) -> Footing:
    carrier, gap = np.empty(len(floor), dtype=np.int32), np.empty(len(floor))
    min_up = float(np.cos(np.radians(agent.max_slope))) - SLACK
    describe_floors(
        floor, columns.start, columns.z, columns.normal, columns.geom, min_up, carrier, gap
    )
    return Footing(carrier, gap)


def _standing(levels: Sequence[LevelContents], floors: Floors, extents: Extents) -> Standing:
    num = len(extents.low)
    base, rise = np.full(num, np.inf), np.full(num, -np.inf)
    area, upper_area = np.zeros(num), np.zeros(num)
    for listed, level in zip(levels, floors.levels, strict=True):
        geom = listed.geom[listed.stands]
        floor = level.floor.ravel()[listed.cell[listed.stands]]
        low, high = extents.low[geom], extents.high[geom]
        np.fmin.at(base, geom, low - floor)
        np.fmax.at(rise, geom, high - np.maximum(low, floor))
        square = listed.lattice.cell_size**2
        area = np.maximum(area, np.bincount(geom, minlength=num) * square)
        upper = np.bincount(listed.geom[listed.upper], minlength=num) * square
        upper_area = np.maximum(upper_area, upper)
    return Standing(base, rise, area, upper_area)


def _number_names(names: Sequence[str]) -> NDArray[np.int64]:
    """Number the names by their first geoms, so that a scene's order of geoms is theirs, too."""
    first: dict[str, int] = {}
    return np.array([first.setdefault(name, k) for k, name in enumerate(names)], dtype=np.int64)
