"""Navigation grids in memory.

Arrays are ``[row, col]``, shape (height, width): col along file X, row along file Z. Arrays,
`cell_size`, `min_yup` and `bbox_yup` are as in the file: y up, in file units (metres in every
file that navbake writes). Positions in methods are in the world frame: z up, metres;
`SceneGrid2D.lattice` converts between the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.navgrid.grid_methods import GridMethods
from navbake.navgrid.lattice import FARTHEST, Lattice
from navbake.navgrid.links import (
    Agent,
    Area,
    Link,
    Step,
    parse_agents,
    parse_areas,
    parse_links,
    parse_steps,
)
from navbake.navgrid.metadata import cut_metadata, describe_attributes
from navbake.navgrid.obstacle_state import BLOCKED, CHANGING, OCCUPIED, ObstacleState
from navbake.navgrid.rooms import Door, Room, measure_rooms, parse_doors, parse_rooms
from navbake.navgrid.user_data import UserData
from navbake.types import Bool, Float, Int, Int32, Json, Vector3

if TYPE_CHECKING:
    from typing_extensions import Self

Table = TypeVar("Table")

MAX_RADIUS = 10_000.0  # [m]


@dataclass(eq=False, kw_only=True)
class GridBase(GridMethods):
    """Common base of grids of one level and of several.

    Its `rooms`, `doors`, `steps`, `links`, `areas` and `agents` are tables of the file, which are
    read when first asked for: they raise a FormatError if the file's table is broken.
    """

    cell_size: float  #: Edge of a cell [file units], > 0.
    unit: float = 1.0  #: Metres per file unit, > 0.
    metadata: Json = field(default_factory=dict, repr=False)  #: As in the file.
    #: As in the file; they don't count in comparisons of grids.
    timings: Json = field(default_factory=dict, repr=False)
    #: Fields of the file that are not the format's own; they are written back.
    extra: Json = field(default_factory=dict, repr=False)
    #: The last result of `navbake.navgrid.islands.islands_of`, after its digest.
    cached_islands: tuple[bytes, list[Int32]] | None = field(default=None, init=False, repr=False)
    #: The current blocks, and grids made of this one for agents of other sizes, which follow them.
    obstacles: list[Any] = field(default_factory=list, init=False, repr=False)
    fitted_grids: WeakSet[Any] | None = field(default=None, init=False, repr=False)
    _tables: dict[str, tuple[Any, Any]] = field(default_factory=dict, init=False, repr=False)

    def __getstate__(self) -> Json:
        """Leave out caches and blocks in copies and pickles."""
        without: Json = {
            "cached_islands": None,
            "_tables": {},
            "obstacles": [],
            "fitted_grids": None,
        }
        return {**self.__dict__, **without, "obstacle_state": None}

    @property
    def levels(self) -> list[SceneGrid2D]:
        """The levels, lowest first."""
        raise NotImplementedError

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        """Replace the levels by as many others, see `SceneGrid2D.with_layers`.

        Metadata are unchanged if None; levels that took theirs over from the grid take over these.
        """
        raise NotImplementedError

    @property
    def is_blocked(self) -> bool:
        """Whether any cell is currently blocked."""
        return any(
            level.obstacle_state and level.obstacle_state.is_blocked for level in self.levels
        )

    def without_blocks(self) -> Self:
        """The grid without blocks; itself if it has none."""
        if not self.is_blocked:
            return self
        return self.with_levels([level.unblocked() for level in self.levels])

    @property
    def scene_id(self) -> str | None:
        """The scene's name, if the file has one."""
        name = self.metadata.get("sceneId")
        return name if isinstance(name, str) else None

    @property
    def agent_height(self) -> float:
        """Height of the grid's agent [m]; 1.14 if the file states none."""
        return self._metres("agentHeight") or 1.14

    @property
    def agent_radius(self) -> float:
        """Radius of the agent of the bake [m]; 0 if the file states none."""
        return self._metres("agentRadius") or 0.0

    @property
    def exact_inflations(self) -> list[Json]:
        """What the metadata note of each inflation in mode ``exact``."""
        done = self.metadata.get("inflation")  # in files of other programs this may be anything
        entries = [e for e in done if isinstance(e, dict)] if isinstance(done, list) else []
        return [entry for entry in entries if entry.get("mode") == "exact"]

    @property
    def inflated_radius(self) -> float:
        """The radius that the grid was inflated for in mode ``exact`` [m]; 0 if it wasn't."""
        radii = [entry.get("radius") for entry in self.exact_inflations]
        numbers = (float(r) for r in radii if isinstance(r, int | float))
        return max((r for r in numbers if 0 <= r <= MAX_RADIUS), default=0.0)

    @property
    def radius(self) -> float:
        """The agent's radius [m]: that of the inflation, else that of the bake."""
        return self.inflated_radius or self.agent_radius

    @property
    def max_step(self) -> float:
        """The highest step that the agent takes [m]; 0.25 if the file states none."""
        stated = self._metres("traversableFloorHeight")
        return 0.25 if stated is None else stated

    def _metres(self, key: str) -> float | None:
        """A length of the metadata [m]; None unless from 0 to 1e10 m."""
        stated = self.metadata.get(key)
        if not isinstance(stated, int | float) or not 0 <= stated * self.unit <= FARTHEST:
            return None
        return float(stated) * self.unit

    @property
    def navbake(self) -> Json:
        """The metadata under ``navbake``; {} in files of other programs."""
        own = self.metadata.get("navbake")
        return own if isinstance(own, dict) else {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings of the bake, one line each.

        Each level has those of the whole scene. Changes of the grid (`inflate`, `with_doors`)
        neither add nor remove warnings.
        """
        stated = self.navbake.get("warnings")
        lines = stated if isinstance(stated, list) else []
        return tuple(line for line in lines if isinstance(line, str))

    @property
    def rooms(self) -> tuple[Room, ...]:
        """The rooms by level and index, measured from `room_index` if the file has no table."""
        stated = self.stated_rooms
        if stated is not None:
            return stated
        rooms = (level.measure_rooms(number) for number, level in enumerate(self.levels))
        return tuple(chain.from_iterable(rooms))

    @property
    def stated_rooms(self) -> tuple[Room, ...] | None:
        """The rooms of the file's table, None without one."""
        if self.navbake.get("rooms") is None:
            return None
        return self._table("rooms", lambda stated: parse_rooms(stated, len(self.levels)))

    @property
    def doors(self) -> tuple[Door, ...]:
        """The doors in the file's order."""
        if "doors" not in self.navbake:
            return ()
        return self._table("doors", lambda stated: parse_doors(stated, self._num_cells))

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps between levels, and between neighbours on steep ramps; see `Step`."""
        return tuple(Step(*row) for row in self.step_array.tolist())

    @property
    def step_array(self) -> Int:
        """`steps` as an array, shape (n, 4), int64: level, cell, other level, other cell."""
        return self._table("links", lambda stated: parse_steps(stated, self._num_cells), "steps")

    @property
    def links(self) -> tuple[Link, ...]:
        """The named links, lifts and others, in the file's order; see `with_links`."""
        return self._table("links", lambda stated: parse_links(stated, self._num_cells))

    @property
    def areas(self) -> tuple[Area, ...]:
        """The areas in the file's order, that of the numbers in `SceneGrid2D.area_index`."""
        return self._table("areas", parse_areas)

    @property
    def agents(self) -> dict[str, Agent]:
        """The agents that the file names, by name."""
        return dict(self._table("agents", parse_agents))

    @property
    def _num_cells(self) -> list[int]:
        return [level.width * level.height for level in self.levels]

    def _table(self, name: str, parse: Callable[[Any], Table], part: str = "") -> Table:
        """A table of navbake's metadata, or part of it, parsed once for each metadata object."""
        stated = self.navbake.get(name)
        key = part or name
        if key not in self._tables or self._tables[key][0] is not stated:
            self._tables[key] = (stated, parse(stated))
        found: Table = self._tables[key][1]
        return found

    @property
    def level_names(self) -> list[str]:
        """The levels' names, lowest first; ``level 0``, ``level 1``, … if the file has none."""
        stated = self.navbake.get("levels")
        entries = stated if isinstance(stated, list) else []
        names = [f"level {number}" for number in range(len(self.levels))]
        for number, entry in enumerate(entries[: len(names)]):
            name = entry.get("name") if isinstance(entry, dict) else None
            names[number] = name if isinstance(name, str) and name else names[number]
        return names

    @property
    def cell_attributes(self) -> list[Json]:
        """The metadata of each attribute, completed from the arrays."""
        return describe_attributes(self.metadata, [level.attributes for level in self.levels])


class DerivedWeights:
    """The attribute `SceneGrid2D.weights`: as given, else derived from the occupancy on first use.

    A million of them take as long to write as the rest of a small update.
    """

    def __get__(self, level: SceneGrid2D, owner: type | None = None) -> NDArray[Any]:
        weights = level.__dict__["weights"]
        if weights is None:
            weights = np.where(level.attributes["occupancy"] != 0, np.inf, 1.0)
            level.__dict__["weights"] = weights
        return np.asarray(weights)

    def __set__(self, level: SceneGrid2D, weights: Any) -> None:
        level.__dict__["weights"] = None if weights is self else weights


DERIVED: Any = DerivedWeights()
"""In place of the weights of a level: 1 where its occupancy is 0, inf elsewhere."""


@dataclass(eq=False, kw_only=True)
class SceneGrid2D(GridBase):
    """The navigation grid of one level."""

    width: int  #: Number of columns, >= 1.
    height: int  #: Number of rows, >= 1.
    min_yup: Vector3  #: Lower corner of cell 0, file frame [file units]; Y is the level's ground.
    #: Lower and upper corner of the level, file frame [file units], or None.
    bbox_yup: tuple[Vector3, Vector3] | None = None
    #: Costs of cells, shape (height, width), float32 or float64; inf where an agent can't stand.
    #: Without them, 1 where the occupancy is 0.
    weights: NDArray[Any] = field(default=DERIVED, repr=False)
    #: Further layers by name (``floorHeight``, …), shape (height, width), own dtypes.
    attributes: dict[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    #: The file's data of single cells, by cell id; parsed on first use.
    user_data: MutableMapping[int, Json] = field(default_factory=UserData, repr=False)
    #: The blocks of its cells, None before the first.
    obstacle_state: ObstacleState | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        given = {"weights": self.__dict__["weights"], **self.attributes}
        for name, array in given.items():
            if array is not None and array.shape != self.shape:
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
        """Replace layers of the level; None leaves a layer as it is.

        `attributes` are added or replaced one by one. The new level shares arrays with this one,
        except those that `block` changes in place once it was called here.
        """
        kept = dict(self.attributes)
        if self.obstacle_state is not None:
            kept |= {name: kept[name].copy() for name in CHANGING & kept.keys()}
            weights = self.weights.copy() if weights is None else weights
        if weights is None:
            # what isn't derived yet is derived from the new level's occupancy, if that is the same
            is_other = attributes is not None and "occupancy" in attributes
            weights = self.weights if is_other else self.__dict__["weights"]
        return replace(
            self,
            weights=DERIVED if weights is None else weights,
            attributes={**kept, **(attributes or {})},
            user_data=self.user_data if user_data is None else user_data,
            metadata=self.metadata if metadata is None else metadata,
        )

    def unblocked(self) -> Self:
        """The level without blocks; itself if it has none."""
        state = self.obstacle_state
        if state is None or not state.is_blocked:
            return self
        occupied = {
            name: np.where(state.mask_of(OCCUPIED), clean, self.attributes[name])
            for name, clean in state.occupied.items()
        }
        weights = np.where(state.mask_of(BLOCKED), state.weights, self.weights)
        return self.with_layers(weights=weights, attributes=occupied)

    @property
    def uses_cell_floors(self) -> bool:
        """Whether cells have own floors, and the metadata lack ``useCellFloorHeight: false``."""
        stated = self.metadata.get("useCellFloorHeight")
        return "floorHeight" in self.attributes and stated is not False

    @property
    def lattice(self) -> Lattice:
        """The cells' positions in the world [m]."""
        # 0.0 - z, because -z would turn 0.0 into -0.0
        x_min = self.min_yup[0] * self.unit
        y_max = 0.0 - self.min_yup[2] * self.unit
        return Lattice(x_min, y_max, self.cell_size * self.unit, self.width, self.height)

    @property
    def ground(self) -> float:
        """World z of the level's ground [m]."""
        return self.min_yup[1] * self.unit

    @property
    def free(self) -> Bool:
        """Where an agent can stand (finite weight), shape (height, width), bool."""
        return np.asarray(np.isfinite(self.weights))

    @property
    def floor_height(self) -> NDArray[np.float32]:
        """The floor's Y [file units], shape (height, width), float32, NaN for no floor.

        Without ``floorHeight``, it is the ground height at finite weights; with
        ``useCellFloorHeight: false``, also where the file has a floor. Read-only unless it is the
        attribute itself.
        """
        stored = self.attributes.get("floorHeight")
        if stored is None or not self.uses_cell_floors:
            has_floor = self.free if stored is None else self.free | ~np.isnan(stored)
            return _derived(np.where(has_floor, np.float32(self.min_yup[1]), np.float32(np.nan)))
        with np.errstate(over="ignore"):  # overflows float32 to infinity
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
        """World z of the floor, or of the level's ground where there is none [m]; as `floor`."""
        floor = self.floor
        return np.where(np.isnan(floor), self.ground, floor)

    @property
    def occupancy(self) -> NDArray[np.uint8]:
        """1 for an obstacle in the agent's way, shape (height, width), uint8.

        A file without ``occupancy`` is occupied at infinite weights; one with another dtype where
        it is not 0. Read-only unless it is the attribute itself.
        """
        return _flags(self.attributes.get("occupancy", ~self.free))

    @property
    def solid(self) -> NDArray[np.uint8]:
        """1 where a geom overlaps the cell's square or there is no floor, uint8 as `occupancy`.

        A bake stores it if the disc of its `agentRadius` reaches beyond the square; else it is
        `occupancy`. Inflation for other agents starts from it. Read-only unless it is the attribute
        itself.
        """
        stored = self.attributes.get("solid")
        if stored is None or not self.navbake:  # other programs may use the name for anything
            return self.occupancy
        return _flags(stored)

    @property
    def free_for_point(self) -> Bool:
        """Where an agent without a radius can stand, as far as the file has it; bool.

        These are the free cells and, with a layer ``solid``, those that only the disc of the baked
        radius or the margin of a block closed. Cells closed by an inflation stay closed.
        """
        free = self.free
        if "solid" not in self.attributes or not self.navbake or "inflation" in self.metadata:
            return free
        by_radius = self.occupancy != 0
        if self.obstacle_state is not None:
            by_radius |= self.obstacle_state.mask_of(BLOCKED)
        return np.asarray(free | (by_radius & (self.solid == 0)))

    @property
    def room_index(self) -> NDArray[np.uint16]:
        """The room of each cell from 1, 0 for none, shape (height, width), uint16.

        All 0 without ``roomIndex``; in other dtypes, values beyond uint16 are 0, too. Read-only
        unless it is the attribute itself.
        """
        return self._numbers("roomIndex", np.uint16)

    @property
    def area_index(self) -> NDArray[np.uint8]:
        """The place of each cell's area in the grid's `areas`, from 1, 0 for none; as `room_index`.

        It means something only where the grid has areas; numbers beyond their table are none.
        """
        return self._numbers("area", np.uint8)

    def _numbers(self, name: str, dtype: type[Any]) -> NDArray[Any]:
        """A layer as unsigned integers, 0 where it has none or a number beyond them."""
        stored = self.attributes.get(name)
        if stored is None:
            return _derived(np.zeros(self.shape, dtype=dtype))
        if stored.dtype == dtype:
            return stored
        inside = (stored >= 0) & (stored <= np.iinfo(dtype).max)
        return _derived(np.where(inside, stored, 0).astype(dtype))

    def measure_rooms(self, number: int = 0) -> list[Room]:
        """Describe the rooms of level `number` of a grid from `room_index` alone."""
        if not self.room_index.any():  # as in maps of other programs, which may be large
            return []
        return measure_rooms(self.room_index, self.floor_or_ground, self.lattice, number)


@dataclass(eq=False, kw_only=True)
class MultiLevelGrid(GridBase):
    """The navigation grids of a scene with several levels.

    A level without metadata of its own takes over the parts of the whole grid's that are about it
    (see `navbake.navgrid.metadata`), so that each level is a grid by itself.
    """

    grids: list[SceneGrid2D]  #: The levels, lowest first, at least one.
    _inherited_metadata: list[Json] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.grids:
            raise FormatError("a MultiLevelGrid has at least one level, got none")
        for number, grid in enumerate(self.grids):
            if not grid.metadata or grid.metadata == self.metadata:
                grid.metadata = cut_metadata(self.metadata, number)
            # for comparison with a level's metadata, which are writable
            self._inherited_metadata.append(cut_metadata(self.metadata, number))

    @property
    def levels(self) -> list[SceneGrid2D]:
        return self.grids

    def inherits_metadata(self, number: int, level: SceneGrid2D) -> bool:
        """Whether a level still has the metadata taken over as level `number` of this grid."""
        return level.metadata == self._inherited_metadata[number]

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        grids = [
            level.with_layers(metadata={}) if self.inherits_metadata(number, level) else level
            for number, level in enumerate(levels)
        ]
        return replace(self, grids=grids, metadata=self.metadata if metadata is None else metadata)


def _flags(stored: NDArray[Any]) -> NDArray[np.uint8]:
    """A layer as uint8, 1 where it is not 0; itself if it has that dtype."""
    return stored if stored.dtype == np.uint8 else _derived((stored != 0).astype(np.uint8))


def _derived(array: NDArray[Any]) -> NDArray[Any]:
    """Make a computed array read-only: writing to it would not change the grid."""
    array.flags.writeable = False
    return array


NavGrid: TypeAlias = SceneGrid2D | MultiLevelGrid
