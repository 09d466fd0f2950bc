"""Navigation grids in memory: what the baker makes, and all that the run time needs.

Arrays are ``[row, col]``, shape (height, width): col along file X, row along file Z. Arrays,
`cell_size`, `min_yup` and `bbox_yup` are as in the file: y up, in file units (which are metres
in every file that navbake writes). Methods that take or give positions use the world: z up,
metres; `SceneGrid2D.lattice` is the bridge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partialmethod
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.lazy import Method
from navbake.navgrid.block_state import BLOCKED, CHANGING, OCCUPIED, BlockState
from navbake.navgrid.doors import Door, parse_doors
from navbake.navgrid.lattice import FARTHEST, Cell, Cells, Lattice
from navbake.navgrid.metadata import Link, cut_metadata, describe_attributes, parse_links
from navbake.navgrid.rooms import Room, measure_rooms, parse_rooms
from navbake.navgrid.user_data import UserData
from navbake.types import Bool, Float, Int, Int32, Json, Vector3

if TYPE_CHECKING:
    from typing_extensions import Self

Table = TypeVar("Table")


@dataclass(eq=False, kw_only=True)
class GridBase:
    """What grids of one level and of several have in common.

    Attributes:
        cell_size: edge of a cell [file units], > 0.
        unit: metres per file unit, > 0.
        metadata: as in the file.
        timings: as in the file; two grids that differ in it only are the same grid.
        extra: fields of the file that are not the format's own; they are written back.
        found_islands: what `navbake.navgrid.islands.islands_of` found last, after its digest.
    """

    cell_size: float
    unit: float = 1.0
    metadata: Json = field(default_factory=dict, repr=False)
    timings: Json = field(default_factory=dict, repr=False)
    extra: Json = field(default_factory=dict, repr=False)
    found_islands: tuple[bytes, list[Int32]] | None = field(default=None, init=False, repr=False)
    _tables: dict[str, tuple[Any, Any]] = field(default_factory=dict, init=False, repr=False)

    def __getstate__(self) -> Json:
        """Copies and pickles leave out caches and blocks."""
        return {**self.__dict__, "found_islands": None, "_tables": {}, "block_state": None}

    @property
    def levels(self) -> list[SceneGrid2D]:
        """The levels, lowest first."""
        raise NotImplementedError

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        """The same grid with other levels.

        Args:
            levels: as many as it has; see `SceneGrid2D.with_layers`.
            metadata: of the new grid; as they are if None. Levels that had taken theirs over from
                the grid take over these.
        """
        raise NotImplementedError

    @property
    def is_blocked(self) -> bool:
        """Whether any cell is blocked now."""
        return any(level.block_state and level.block_state.is_blocked for level in self.levels)

    def without_blocks(self) -> Self:
        """The grid as it is when nothing is blocked; itself if nothing is."""
        if not self.is_blocked:
            return self
        return self.with_levels([level.unblocked() for level in self.levels])

    @property
    def scene_id(self) -> str | None:
        """The scene's name, if the file gives one."""
        name = self.metadata.get("sceneId")
        return name if isinstance(name, str) else None

    @property
    def agent_height(self) -> float:
        """Height of the agent that the grid is for [m]; 1.14 where the file states none."""
        return self._metres("agentHeight") or 1.14

    @property
    def agent_radius(self) -> float:
        """Radius of the agent that the grid was baked for [m]; 0 where the file states none."""
        return self._metres("agentRadius") or 0.0

    @property
    def max_step(self) -> float:
        """The highest step that the agent takes [m]; 0.25 where the file states none."""
        stated = self._metres("traversableFloorHeight")
        return 0.25 if stated is None else stated

    def _metres(self, key: str) -> float | None:
        """A length of the metadata [m]; None where they have none from 0 to 1e10 m."""
        stated = self.metadata.get(key)
        if not isinstance(stated, int | float) or not 0 <= stated * self.unit <= FARTHEST:
            return None
        return float(stated) * self.unit

    @property
    def navbake(self) -> Json:
        """What navbake wrote into the metadata; {} in files of other programs."""
        own = self.metadata.get("navbake")
        return own if isinstance(own, dict) else {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the bake warned of, one line each; empty where it warned of nothing.

        It is about the whole scene, and as the bake left it: a level of several has the warnings
        of all, and no later change of the grid (`inflate`, `with_doors`) adds or removes any.
        """
        stated = self.navbake.get("warnings")
        lines = stated if isinstance(stated, list) else []
        return tuple(line for line in lines if isinstance(line, str))

    @property
    def rooms(self) -> tuple[Room, ...]:
        """The rooms by level and index.

        Of a file without a room table, they are measured from `room_index`.

        Raises:
            FormatError: the file's room table is broken.
        """
        stated = self.stated_rooms
        if stated is not None:
            return stated
        rooms = (level.measure_rooms(number) for number, level in enumerate(self.levels))
        return tuple(chain.from_iterable(rooms))

    @property
    def stated_rooms(self) -> tuple[Room, ...] | None:
        """The rooms as the file's table has them, None where it has no table."""
        if self.navbake.get("rooms") is None:
            return None
        return self._table("rooms", lambda stated: parse_rooms(stated, len(self.levels)))

    @property
    def doors(self) -> tuple[Door, ...]:
        """The doors, as the file lists them.

        Raises:
            FormatError: the file's table of doors is broken.
        """
        if "doors" not in self.navbake:
            return ()
        return self._table("doors", lambda stated: parse_doors(stated, self._num_cells))

    @property
    def links(self) -> tuple[Link, ...]:
        """The steps from level to level, and between neighbours on steep ramps; see `Link`.

        Raises:
            FormatError: the metadata name a level or a cell that does not exist.
        """
        return tuple(Link(*row) for row in self.link_array.tolist())

    @property
    def link_array(self) -> Int:
        """`links` as an array, shape (n, 4), int64: level, cell, other level, other cell."""
        return self._table("links", lambda stated: parse_links(stated, self._num_cells))

    @property
    def _num_cells(self) -> list[int]:
        return [level.width * level.height for level in self.levels]

    def _table(self, name: str, parse: Callable[[Any], Table]) -> Table:
        """A table of navbake's metadata, parsed once for each object that stands there."""
        stated = self.navbake.get(name)
        if name not in self._tables or self._tables[name][0] is not stated:
            self._tables[name] = (stated, parse(stated))
        found: Table = self._tables[name][1]
        return found

    @property
    def level_names(self) -> list[str]:
        """The levels' names, lowest first; ``level 0``, ``level 1``, … where none is stated."""
        stated = self.navbake.get("levels")
        entries = stated if isinstance(stated, list) else []
        names = [f"level {number}" for number in range(len(self.levels))]
        for number, entry in enumerate(entries[: len(names)]):
            name = entry.get("name") if isinstance(entry, dict) else None
            names[number] = name if isinstance(name, str) and name else names[number]
        return names

    @property
    def cell_attributes(self) -> list[Json]:
        """What the metadata say of each attribute, completed where they say nothing."""
        return describe_attributes(self.metadata, [level.attributes for level in self.levels])

    # Functions of modules above that take the grid first, loaded when a method is first looked at;
    # signature and docstring are theirs.
    cell_at = Method[Cell | None]("navbake.navgrid.cells:cell_at")
    cells_at = Method[Cells]("navbake.navgrid.cells:cells_at")
    position_of = Method[Float]("navbake.navgrid.cells:position_of")
    with_doors = Method[Any]("navbake.navgrid.door_states:with_doors")
    at = Method[Any]("navbake.runtime.place:place_at")
    values_at = Method[NDArray[Any]]("navbake.runtime.place:values_at")
    find_path = Method[Any]("navbake.runtime.path_finder:plan_path")
    inflate = Method[Any]("navbake.runtime.inflation:inflate")
    inflate_footprint = Method[list[Bool]]("navbake.runtime.inflation:inflate_footprint")
    block = Method[Any]("navbake.runtime.blocks:block")
    tensors = Method[Any]("navbake.tensors.build:make_tensors")
    describe_cell = Method[Json]("navbake.views.describe:describe_cell")
    save = Method[None]("navbake.formats.navgrid:write_navgrid")
    convert = Method[list[Path]]("navbake.formats.convert:write_as")
    to_nav2: ClassVar[partialmethod[list[Path]]] = partialmethod(convert, to="nav2")
    to_procthor: ClassVar[partialmethod[list[Path]]] = partialmethod(convert, to="procthor")
    to_npz: ClassVar[partialmethod[list[Path]]] = partialmethod(convert, to="npz")
    to_mjcf: ClassVar[partialmethod[list[Path]]] = partialmethod(convert, to="mjcf")
    to_mesh = Method[Any]("navbake.formats.floor_mesh:make_floor_mesh")
    to_polygons = Method[list[Any]]("navbake.formats.shapes:find_shapes")
    to_geojson = Method[Json]("navbake.formats.shapes:to_geojson")
    to_graph = Method[Any]("navbake.formats.graphs:make_graph")
    plot = Method[Any]("navbake.views.plot:plot")
    _repr_html_ = Method[str]("navbake.views.notebook:show_html")
    _repr_png_ = Method[bytes]("navbake.views.notebook:draw_png")

    def blockers(self, x: float, y: float, level: int | None = None) -> list[str]:
        """The names of what blocks the cell at a position, sorted; [] where nothing does.

        Takes and raises what `describe_cell` does.
        """
        return list(self.describe_cell(x, y, level)["blockers"])


@dataclass(eq=False, kw_only=True)
class SceneGrid2D(GridBase):
    """The navigation grid of one level.

    Attributes:
        width: number of columns, >= 1.
        height: number of rows, >= 1.
        min_yup: lower corner of cell 0, file frame [file units]; Y is the level's ground.
        bbox_yup: lower and upper corner of what the level covers, file frame [file units], or
            None where the file says nothing.
        weights: shape (height, width), float32 or float64: the cost of a cell, inf where an
            agent can't stand.
        attributes: further values of each cell under the names they have in the file
            (``floorHeight``, ``roomIndex``, ``occupancy``, …), each of shape (height, width)
            and of its own dtype.
        user_data: what a file keeps for single cells, by cell id (col + row * width); in a large
            file it is read and checked when it is first asked for.
        block_state: who blocks its cells, None until somebody does.
        cell_size, unit, metadata, timings, extra: see `GridBase`.
    """

    width: int
    height: int
    min_yup: Vector3
    bbox_yup: tuple[Vector3, Vector3] | None = None
    weights: NDArray[Any] = field(repr=False)
    attributes: dict[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    user_data: MutableMapping[int, Json] = field(default_factory=UserData, repr=False)
    block_state: BlockState | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        for name, array in {"weights": self.weights, **self.attributes}.items():
            if array.shape != self.shape:
                raise FormatError(
                    f"{name} has shape {array.shape}, expected (height, width) = {self.shape}"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), the shape of every array."""
        return self.height, self.width

    @property
    def levels(self) -> list[SceneGrid2D]:
        return [self]

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        (level,) = levels
        derived: Any = level if metadata is None else level.with_layers(metadata=metadata)
        own: Self = derived
        return own

    def with_layers(
        self,
        *,
        weights: NDArray[Any] | None = None,
        attributes: Mapping[str, NDArray[Any]] | None = None,
        user_data: MutableMapping[int, Json] | None = None,
        metadata: Json | None = None,
    ) -> Self:
        """The same level with other layers; what isn't given is as it is now.

        `attributes` are added or replaced one by one. The new level shares arrays with this one,
        except those that `block` changes in place once it was called here.
        """
        kept = dict(self.attributes)
        if self.block_state is not None:
            kept |= {name: kept[name].copy() for name in CHANGING & kept.keys()}
            weights = self.weights.copy() if weights is None else weights
        return replace(
            self,
            weights=self.weights if weights is None else weights,
            attributes={**kept, **(attributes or {})},
            user_data=self.user_data if user_data is None else user_data,
            metadata=self.metadata if metadata is None else metadata,
        )

    def unblocked(self) -> Self:
        """The level as it is when nothing blocks it; itself if nothing does."""
        state = self.block_state
        if state is None or not state.is_blocked:
            return self
        occupied = {
            name: np.where(state.held(OCCUPIED), clean, self.attributes[name])
            for name, clean in state.occupied.items()
        }
        weights = np.where(state.held(BLOCKED), state.weights, self.weights)
        return self.with_layers(weights=weights, attributes=occupied)

    @property
    def uses_cell_floors(self) -> bool:
        """Whether cells have floors of their own: there are some, and the metadata don't deny it.

        ``useCellFloorHeight: false`` says that an agent stays at the ground height.
        """
        stated = self.metadata.get("useCellFloorHeight")
        return "floorHeight" in self.attributes and stated is not False

    @property
    def lattice(self) -> Lattice:
        """Where the cells lie in the world [m]."""
        # 0.0 - z, because -z would turn 0.0 into -0.0
        x_min, y_max = self.min_yup[0] * self.unit, 0.0 - self.min_yup[2] * self.unit
        return Lattice(x_min, y_max, self.cell_size * self.unit, self.width, self.height)

    @property
    def ground(self) -> float:
        """World z of the level's ground [m]."""
        return self.min_yup[1] * self.unit

    @property
    def free(self) -> Bool:
        """Where an agent can stand: the weight is finite. Shape (height, width), bool."""
        return np.asarray(np.isfinite(self.weights))

    @property
    def floor_height(self) -> NDArray[np.float32]:
        """The floor's Y [file units], shape (height, width), float32, NaN for no floor.

        A file without ``floorHeight`` has its floor at the ground height, where weights are
        finite. So has one that says ``useCellFloorHeight: false``, and also where it knows of a
        floor. The array is read-only unless it is the attribute itself.
        """
        stored = self.attributes.get("floorHeight")
        if stored is None or not self.uses_cell_floors:
            has_floor = self.free if stored is None else self.free | ~np.isnan(stored)
            return _derived(np.where(has_floor, np.float32(self.min_yup[1]), np.float32(np.nan)))
        with np.errstate(over="ignore"):  # what float32 can't hold is infinite
            return stored if stored.dtype == np.float32 else _derived(stored.astype(np.float32))

    @property
    def floor(self) -> Float:
        """World z of the floor [m], shape (height, width), float64, NaN for no floor."""
        return self.floor_of(slice(None), slice(None))

    def floor_of(self, rows: Int | slice, cols: Int | slice) -> Float:
        """World z of the floor of some cells [m], float64, NaN for no floor; see `floor_height`."""
        return self.floor_height[rows, cols].astype(np.float64) * self.unit

    @property
    def floor_or_ground(self) -> Float:
        """World z of the floor, of the level's ground where there is none [m]; as `floor`."""
        floor = self.floor
        return np.where(np.isnan(floor), self.ground, floor)

    @property
    def occupancy(self) -> NDArray[np.uint8]:
        """1 where something stands in the agent's way, shape (height, width), uint8.

        A file without ``occupancy`` is occupied where weights are infinite; one that keeps it
        in another dtype, where it is not 0. Read-only unless it is the attribute itself.
        """
        return _flags(self.attributes.get("occupancy", ~self.free))

    @property
    def solid(self) -> NDArray[np.uint8]:
        """1 where a geom meets the cell's square or there is no floor, uint8 as `occupancy`.

        A bake stores it where the disc of its `agentRadius` reaches beyond the square; everywhere
        else it is `occupancy`. What depends on the size of another agent is measured from it.
        Read-only unless it is the attribute itself.
        """
        stored = self.attributes.get("solid")
        if stored is None or not self.navbake:  # other programs may call anything so
            return self.occupancy
        return _flags(stored)

    @property
    def free_for_point(self) -> Bool:
        """Where an agent without a radius can stand, as far as the grid tells; bool.

        These are the free cells and, with a layer ``solid``, those that only the disc of the baked
        radius closed, or the margin of a block. What an inflation closed stays closed.
        """
        free = self.free
        if "solid" not in self.attributes or not self.navbake or "inflation" in self.metadata:
            return free
        by_radius = self.occupancy != 0
        if self.block_state is not None:
            by_radius |= self.block_state.held(BLOCKED)
        return np.asarray(free | (by_radius & (self.solid == 0)))

    @property
    def room_index(self) -> NDArray[np.uint16]:
        """The room of each cell from 1, 0 for none, shape (height, width), uint16.

        A file without ``roomIndex`` has no rooms; in one that keeps it in another dtype, values
        beyond uint16 are no room. Read-only unless it is the attribute itself.
        """
        stored = self.attributes.get("roomIndex")
        if stored is None:
            return _derived(np.zeros(self.shape, dtype=np.uint16))
        if stored.dtype == np.uint16:
            return stored
        return _derived(np.where((stored >= 0) & (stored < 65536), stored, 0).astype(np.uint16))

    def measure_rooms(self, number: int = 0) -> list[Room]:
        """Describe the rooms of the level, the `number`-th of a grid, from `room_index` alone."""
        if not self.room_index.any():  # as in maps of other programs, which may be large
            return []
        return measure_rooms(self.room_index, self.floor_or_ground, self.lattice, number)


@dataclass(eq=False, kw_only=True)
class MultiLevelGrid(GridBase):
    """The navigation grids of a scene with several levels.

    A level without metadata of its own takes over those of the whole when the grid is made, as
    far as they are about it (see `navbake.navgrid.metadata`). So each level is a grid by
    itself.

    Attributes:
        grids: the levels, lowest first, at least one.
        cell_size, unit, metadata, timings, extra: see `GridBase`.
    """

    grids: list[SceneGrid2D]
    _handed_down: list[Json] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.grids:
            raise FormatError("a MultiLevelGrid has at least one level, got none")
        for number, grid in enumerate(self.grids):
            if not grid.metadata or grid.metadata == self.metadata:
                grid.metadata = cut_metadata(self.metadata, number)
            # to be compared with what a level has later: metadata can be written to
            self._handed_down.append(cut_metadata(self.metadata, number))

    @property
    def levels(self) -> list[SceneGrid2D]:
        return self.grids

    def takes_over(self, number: int, level: SceneGrid2D) -> bool:
        """Whether a level still has the metadata that level `number` of this grid took over."""
        return level.metadata == self._handed_down[number]

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        grids = [
            level.with_layers(metadata={}) if self.takes_over(number, level) else level
            for number, level in enumerate(levels)
        ]
        return replace(self, grids=grids, metadata=self.metadata if metadata is None else metadata)


def _flags(stored: NDArray[Any]) -> NDArray[np.uint8]:
    """A layer as uint8, 1 where it is not 0; itself if it is of that dtype."""
    return stored if stored.dtype == np.uint8 else _derived((stored != 0).astype(np.uint8))


def _derived(array: NDArray[Any]) -> NDArray[Any]:
    """Make a computed array read-only: writing to it would not change the grid."""
    array.flags.writeable = False
    return array


NavGrid: TypeAlias = SceneGrid2D | MultiLevelGrid
