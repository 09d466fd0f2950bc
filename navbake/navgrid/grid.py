"""Navigation grids in memory: `SceneGrid2D` of one level, and `MultiLevelGrid` of several.

Arrays are ``[row, col]``, shape (height, width): col along file X, row along file Z. Arrays,
`cell_size`, `min_yup` and `bbox_yup` are as in the file: y up, in file units (metres in every
file that navbake writes). Positions in methods are in the world frame: z up, metres;
`SceneGrid2D.lattice` converts between the two.

Of this folder, only `navbake.navgrid.grid_methods` imports from the folders above it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, cast
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError, count_of
from navbake.navgrid.grid_methods import GridMethods
from navbake.navgrid.lattice import MAX_COORDINATE, Lattice
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
from navbake.navgrid.metadata import describe_attributes, split_metadata
from navbake.navgrid.obstacle_state import BLOCKED, CHANGING_ATTRIBUTES, ObstacleState
from navbake.navgrid.rooms import Door, Room, measure_rooms, parse_doors, parse_rooms
from navbake.navgrid.user_data import Box, UserData, parse_boxes
from navbake.types import Bool, Float, Int, Int32, Json, Vector3

if TYPE_CHECKING:
    from typing_extensions import Self

Table = TypeVar("Table")

MAX_RADIUS = 10_000.0  # largest radius of an agent [m]
DEFAULT_HEIGHT = 1.14  # height of the agent, if the file states none [m]
DEFAULT_STEP = 0.25  # highest step that the agent takes, if the file states none [m]


@dataclass(eq=False, repr=False, kw_only=True)
class GridBase(GridMethods):
    """Common base of grids of one level and of several levels.

    The properties `rooms`, `doors`, `steps`, `links`, `areas`, `agents` and `name_boxes` parse a
    table of the file on first access. They raise a FormatError if that table is broken.

    Attributes:
        cell_size: Edge of a cell [file units], > 0.
        unit: Metres per file unit, > 0.
        metadata: The metadata, as in the file.
        timings: Milliseconds of each stage of the bake, as in the file; comparisons of grids ignore
            them.
        extra: Fields of the file that the format does not define; they are written back.
        cached_islands: The digest of the grid's data at the last call of
            `navbake.navgrid.islands.find_islands`, and the islands that it found; None before.
        obstacles: The current obstacles, each a `navbake.runtime.blocking.AddedObstacle`.
        fitted_grids: Grids made of this one for agents of other sizes. An obstacle that is added to
            this grid, or freed, is added to them or freed, too.
    """

    cell_size: float
    unit: float = 1.0
    metadata: Json = field(default_factory=dict, repr=False)
    timings: Json = field(default_factory=dict, repr=False)
    extra: Json = field(default_factory=dict, repr=False)
    cached_islands: tuple[bytes, list[Int32]] | None = field(default=None, init=False, repr=False)
    obstacles: list[Any] = field(default_factory=list, init=False, repr=False)
    fitted_grids: WeakSet[NavGrid] | None = field(default=None, init=False, repr=False)
    # name of a table -> its entries in the metadata, and the table parsed from them
    _tables: dict[str, tuple[object, object]] = field(default_factory=dict, init=False, repr=False)

    def __getstate__(self) -> Json:
        """Return the state for copies and pickles: all but caches and obstacles.

        What the obstacles block stays blocked. So a layer ``island`` is that of the cells which are
        free now.
        """
        return {
            **self._with_current_islands().__dict__,
            "cached_islands": None,
            "obstacles": [],
            "fitted_grids": None,
            "obstacle_state": None,
            "_tables": {},
        }

    @property
    def levels(self) -> list[SceneGrid2D]:
        """The levels, lowest first."""
        raise NotImplementedError

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        """Return the grid with all of its levels replaced.

        Args:
            levels: The new levels, lowest first, as many as the grid has.
            metadata: The new metadata of the grid; None to keep them. Levels that inherited their
                metadata from the grid inherit the new ones.
        """
        raise NotImplementedError

    def __repr__(self) -> str:
        levels_text = count_of(len(self.levels), "level")
        free_area = sum(
            np.count_nonzero(level.free) * level.lattice.cell_size**2 for level in self.levels
        )
        num_rooms = sum(int(np.count_nonzero(np.unique(level.room_index))) for level in self.levels)
        rooms_text = count_of(num_rooms, "room")
        facts_text = (
            f"{levels_text}, {free_area:.1f} m² free, {rooms_text}, {self.describe_radius()}"
        )
        return f"{type(self).__name__}({self.scene_id!r}, {facts_text})"

    def describe_radius(self) -> str:
        """Describe the grid's radius in words, and whether it comes from a bake or an inflation."""
        verb = "inflated" if self.exact_inflations else "baked"
        return f"{verb} for a radius of {self.radius:g} m"

    @property
    def is_blocked(self) -> bool:
        """Whether an added obstacle (see `block`) currently blocks any cell."""
        obstacle_states = [level.obstacle_state for level in self.levels]
        return any(
            obstacle_state is not None and obstacle_state.is_blocked
            for obstacle_state in obstacle_states
        )

    @property
    def scene_id(self) -> str | None:
        """The name of the scene; None if the file has none."""
        name = self.metadata.get("sceneId")
        return name if isinstance(name, str) else None

    @property
    def agent_height(self) -> float:
        """Height of the grid's agent [m]; 1.14 if the file states none."""
        return self._length("agentHeight") or DEFAULT_HEIGHT

    @property
    def agent_radius(self) -> float:
        """Radius of the agent that the grid was baked for [m]; 0 if the file states none."""
        return self._length("agentRadius") or 0.0

    @property
    def exact_inflations(self) -> list[Json]:
        """The metadata's entries about inflations of the grid in mode ``exact``.

        Files of other programs may hold anything there: entries without a valid radius are left
        out.
        """
        inflations = self.metadata.get("inflation")
        if not isinstance(inflations, list):
            return []
        return [
            inflation
            for inflation in inflations
            if isinstance(inflation, dict)
            and inflation.get("mode") == "exact"
            and isinstance(inflation.get("radius"), int | float)
            and 0 <= inflation["radius"] <= MAX_RADIUS
        ]

    @property
    def inflated_radius(self) -> float:
        """The largest radius that the grid was inflated for in mode ``exact`` [m], or 0."""
        return max((float(inflation["radius"]) for inflation in self.exact_inflations), default=0.0)

    @property
    def radius(self) -> float:
        """The agent's radius [m].

        `inflated_radius` if the grid was inflated in mode ``exact``, also for 0 m; else
        `agent_radius`.
        """
        return self.inflated_radius if self.exact_inflations else self.agent_radius

    @property
    def max_step(self) -> float:
        """The highest step that the agent takes [m]; 0.25 if the file states none."""
        step = self._length("traversableFloorHeight")
        return DEFAULT_STEP if step is None else step

    def _length(self, key: str) -> float | None:
        """Return a length of the metadata [m]; None unless it is a number from 0 to 1e10 m."""
        length = self.metadata.get(key)
        if not isinstance(length, int | float) or not 0 <= length * self.unit <= MAX_COORDINATE:
            return None
        return float(length) * self.unit

    @property
    def navbake(self) -> Json:
        """The entry ``navbake`` of the metadata; {} in files of other programs."""
        metadata = self.metadata.get("navbake")
        return metadata if isinstance(metadata, dict) else {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings of the bake, one line each.

        Each level has the warnings of the whole scene. Changes of the grid (`inflate`,
        `with_doors`) neither add nor remove warnings.
        """
        warnings = self.navbake.get("warnings")
        if not isinstance(warnings, list):
            return ()
        return tuple(line for line in warnings if isinstance(line, str))

    @property
    def rooms(self) -> tuple[Room, ...]:
        """The rooms, sorted by level and index; without a table, measured from `room_index`."""
        rooms = self.stated_rooms
        if rooms is not None:
            return rooms
        rooms_by_level = (level.measure_rooms(number) for number, level in enumerate(self.levels))
        return tuple(chain.from_iterable(rooms_by_level))

    @property
    def stated_rooms(self) -> tuple[Room, ...] | None:
        """The rooms in the table of the file; None without a table."""
        if self.navbake.get("rooms") is None:
            return None
        return self._table("rooms", lambda entries: parse_rooms(entries, len(self.levels)))

    @property
    def doors(self) -> tuple[Door, ...]:
        """The doors in the file's order."""
        if "doors" not in self.navbake:
            return ()
        return self._table("doors", lambda entries: parse_doors(entries, self._cell_counts))

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps between levels, and between neighbouring cells of steep ramps; see `Step`."""
        return tuple(Step(*row) for row in self.step_array.tolist())

    @property
    def step_array(self) -> Int:
        """`steps` as an array, int64, shape (n, 4): the fields of `Step` in their order."""
        return self._table(
            "links", lambda entries: parse_steps(entries, self._cell_counts), part_name="steps"
        )

    @property
    def links(self) -> tuple[Link, ...]:
        """The named links, lifts and others, in the file's order; see `with_links`."""
        return self._table("links", lambda entries: parse_links(entries, self._cell_counts))

    @property
    def areas(self) -> tuple[Area, ...]:
        """The areas in the file's order; `SceneGrid2D.area_index` numbers them from 1."""
        return self._table("areas", parse_areas)

    @property
    def agents(self) -> dict[str, Agent]:
        """The agents that the file names, by name."""
        return dict(self._table("agents", parse_agents))

    @property
    def name_boxes(self) -> dict[str, Box]:
        """The upright boxes round the things that cells name, by name; empty if the file has none.

        Each is world x, y, z of the lower corner, then of the upper corner [m], in the pose of the
        bake.
        """
        if "boxes" not in self.navbake:
            return {}
        return self._table("boxes", parse_boxes)

    @property
    def _cell_counts(self) -> list[int]:
        """The number of cells of each level."""
        return [level.width * level.height for level in self.levels]

    def _table(self, name: str, parse: Callable[[Any], Table], part_name: str = "") -> Table:
        """Return a parsed table of the metadata; parse it only if its entries are new.

        Args:
            name: Key of the table under ``navbake``.
            parse: Converts the entries to the result.
            part_name: Name of what `parse` returns, if it is only a part of the table, such as the
                steps of ``links``.
        """
        entries = self.navbake.get(name)
        key = part_name or name
        if key not in self._tables or self._tables[key][0] is not entries:
            self._tables[key] = (entries, parse(entries))
        return cast("Table", self._tables[key][1])

    @property
    def level_names(self) -> list[str]:
        """The levels' names, lowest first; ``level 0``, ``level 1``, … if the file has none."""
        names = [f"level {level_number}" for level_number in range(len(self.levels))]
        entries = self.navbake.get("levels")
        if not isinstance(entries, list):
            return names
        for level_number, entry in enumerate(entries[: len(names)]):
            name = entry.get("name") if isinstance(entry, dict) else None
            if isinstance(name, str) and name:
                names[level_number] = name
        return names

    @property
    def cell_attributes(self) -> list[Json]:
        """The entry of each attribute in the metadata, with its name, type and data type."""
        return describe_attributes(self.metadata, [level.attributes for level in self.levels])


class DerivedWeights:
    """Gives levels the attribute `SceneGrid2D.weights`, whose array may be made on first access.

    If no weights were set, they are derived from the occupancy then. Deriving the weights of a
    million cells takes as long as the rest of a small update, which does not need them.
    """

    def __get__(self, level: SceneGrid2D, owner: type | None = None) -> NDArray[Any]:
        weights = level.__dict__["weights"]
        if weights is None:
            weights = np.where(level.attributes["occupancy"] != 0, np.inf, 1.0)
            level.__dict__["weights"] = weights
        return np.asarray(weights)

    def __set__(self, level: SceneGrid2D, weights: NDArray[Any] | DerivedWeights | None) -> None:
        level.__dict__["weights"] = None if weights is self else weights


DERIVED_WEIGHTS = cast("NDArray[Any]", DerivedWeights())
"""Weights that are derived from a level's occupancy: 1 where it is 0, inf elsewhere."""


@dataclass(eq=False, repr=False, kw_only=True)
class SceneGrid2D(GridBase):
    """The navigation grid of one level.

    Attributes:
        width: Number of columns, >= 1.
        height: Number of rows, >= 1.
        min_yup: Lower corner of cell 0, file frame [file units]; its Y is the level's ground.
        bbox_yup: Lower and upper corner of the level, file frame [file units]; None if the file
            states none.
        weights: Costs of cells, shape (height, width), float32 or float64; inf where an agent can't
            stand. By default 1 where the occupancy is 0, else inf.
        attributes: Name (``floorHeight``, …) -> further layer, shape (height, width), of any dtype.
        user_data: Cell id -> the file's data about this cell; parsed on first use.
        obstacle_state: The added obstacles on the level; None before the first `block`.
    """

    width: int
    height: int
    min_yup: Vector3
    bbox_yup: tuple[Vector3, Vector3] | None = None
    weights: NDArray[Any] = field(default=DERIVED_WEIGHTS)
    attributes: dict[str, NDArray[Any]] = field(default_factory=dict)
    user_data: MutableMapping[int, Json] = field(default_factory=UserData)
    obstacle_state: ObstacleState | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        layers = {"weights": self.__dict__["weights"], **self.attributes}
        for name, array in layers.items():
            if array is not None and array.shape != self.shape:
                expected = f"(height, width) = {self.shape}"
                raise FormatError(
                    f"{name} has shape {array.shape}, expected {expected}",
                    key=name,
                    value=array.shape,
                    expected=expected,
                )

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), the shape of every array."""
        return self.height, self.width

    @property
    def levels(self) -> list[SceneGrid2D]:
        """A list with this level alone."""
        return [self]

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        """Return the grid with its one level replaced: the new level is itself the grid.

        Args:
            levels: A list with the new level alone.
            metadata: The new metadata; None to keep the metadata of the new level.
        """
        (level,) = levels
        changed_level = level if metadata is None else level.with_layers(metadata=metadata)
        return cast("Self", changed_level)

    def with_layers(
        self,
        *,
        weights: NDArray[Any] | None = None,
        attributes: Mapping[str, NDArray[Any]] | None = None,
        user_data: MutableMapping[int, Json] | None = None,
        metadata: Json | None = None,
    ) -> Self:
        """Return the level with some layers replaced; arguments that are None replace nothing.

        The new level shares the other arrays with this one. If `block` was called on this level,
        layers that `block` changes in place are copied instead.

        Args:
            weights: The new weights, shape (height, width).
            attributes: Name -> attribute to add or replace, shape (height, width).
            user_data: Cell id -> new data about this cell.
            metadata: The new metadata.
        """
        layers = dict(self.attributes)
        if self.obstacle_state is not None:
            for name in CHANGING_ATTRIBUTES & layers.keys():
                layers[name] = layers[name].copy()
            weights = self.weights.copy() if weights is None else weights
        if weights is None:
            # weights that are not derived yet may be derived later, from the new level's occupancy,
            # unless that is replaced
            is_occupancy_replaced = attributes is not None and "occupancy" in attributes
            weights = self.weights if is_occupancy_replaced else self.__dict__["weights"]
        return replace(
            self,
            weights=DERIVED_WEIGHTS if weights is None else weights,
            attributes={**layers, **(attributes or {})},
            user_data=self.user_data if user_data is None else user_data,
            metadata=self.metadata if metadata is None else metadata,
        )

    @property
    def uses_cell_floors(self) -> bool:
        """Whether each cell has a floor height of its own.

        This is so if the file has ``floorHeight``, and does not say ``useCellFloorHeight: false``.
        """
        is_used = self.metadata.get("useCellFloorHeight")
        return "floorHeight" in self.attributes and is_used is not False

    @property
    def lattice(self) -> Lattice:
        """The lattice of the cells, which converts between cells and world positions [m]."""
        # 0.0 - z, because -z would turn 0.0 into -0.0
        x_min = self.min_yup[0] * self.unit
        y_max = 0.0 - self.min_yup[2] * self.unit
        return Lattice(x_min, y_max, self.cell_size * self.unit, self.width, self.height)

    @property
    def ground(self) -> float:
        """World z at which the level begins [m].

        It is also the floor of free cells if the file has no heights of floors.
        """
        return self.min_yup[1] * self.unit

    @property
    def free(self) -> Bool:
        """True where an agent can stand (finite weight), shape (height, width), bool."""
        return np.asarray(np.isfinite(self.weights))

    @property
    def floor_height(self) -> NDArray[np.float32]:
        """The floor's Y [file units], shape (height, width), float32, NaN for no floor.

        Without ``floorHeight`` in the file, free cells have the level's ground as their floor. If
        the file says ``useCellFloorHeight: false``, the ground is the floor of free cells and of
        cells with a number in ``floorHeight``. The array is read-only, unless it is the one in
        `attributes`.
        """
        stored_floor = self.attributes.get("floorHeight")
        if stored_floor is None or not self.uses_cell_floors:
            has_floor = self.free if stored_floor is None else self.free | ~np.isnan(stored_floor)
            return _read_only(np.where(has_floor, np.float32(self.min_yup[1]), np.float32(np.nan)))
        if stored_floor.dtype == np.float32:
            return stored_floor
        with np.errstate(over="ignore"):  # what float32 can't hold becomes infinite
            return _read_only(stored_floor.astype(np.float32))

    @property
    def floor(self) -> Float:
        """World z of the floor [m], shape (height, width), float64, NaN for no floor."""
        return self.floor_of(slice(None), slice(None))

    def floor_of(self, rows: Int | slice, cols: Int | slice) -> Float:
        """Return world z of the floor of some cells [m], float64, NaN for no floor.

        Args:
            rows: The rows of the cells: indices or a slice of the rows of `floor_height`.
            cols: The columns of the cells: indices or a slice of the columns of `floor_height`.
        """
        return self.floor_height[rows, cols].astype(np.float64) * self.unit

    @property
    def floor_or_ground(self) -> Float:
        """World z of the floor, or of the level's ground where a cell has no floor [m].

        Shape (height, width), float64.
        """
        floor = self.floor
        return np.where(np.isnan(floor), self.ground, floor)

    @property
    def occupancy(self) -> NDArray[np.uint8]:
        """1 for an obstacle in the agent's way, shape (height, width), uint8.

        If the file has no layer ``occupancy``, cells of infinite weight are occupied. If the dtype
        of the layer is not uint8, cells where it is not 0 are occupied. The array is read-only,
        unless it is the one in `attributes`.
        """
        stored_layer = self.attributes.get("occupancy")
        return _as_flags(~self.free if stored_layer is None else stored_layer)

    @property
    def solid(self) -> NDArray[np.uint8]:
        """1 where a geom overlaps the cell's square or there is no floor; (height, width), uint8.

        `inflate` starts from this layer. `occupancy` is also 1 where a geom overlaps only the disc
        of the bake's agent round the cell's centre. If that disc fits into a cell, both are equal,
        and the file has no layer ``solid``. The array is read-only, unless it is the one in
        `attributes`.
        """
        stored_layer = self.attributes.get("solid")
        if stored_layer is None or not self.navbake:  # other programs may use the name for anything
            return self.occupancy
        return _as_flags(stored_layer)

    @property
    def free_for_point(self) -> Bool:
        """True where an agent without a radius can stand, as far as the file shows it.

        Shape (height, width), bool. It is True in all free cells. If the grid has a layer ``solid``
        and was not inflated, it is also True in blocked cells whose own square nothing overlaps:
        only the disc of the baked radius, or the margin of an added obstacle, blocks them.
        """
        free = self.free
        if "solid" not in self.attributes or not self.navbake or "inflation" in self.metadata:
            return free
        is_blocked = self.occupancy != 0
        if self.obstacle_state is not None:
            is_blocked |= self.obstacle_state.mask_of(BLOCKED)
        return np.asarray(free | (is_blocked & (self.solid == 0)))

    @property
    def closed_by_inflation(self) -> Bool:
        """True where an agent fits as the grid was baked, and not as it was inflated.

        Shape (height, width), bool. All False in a grid that was not inflated. Cells that an added
        obstacle blocks are False.
        """
        if "inflation" not in self.metadata:
            return np.zeros(self.shape, dtype=np.bool_)
        is_closed: Bool = (self.occupancy == 0) & ~self.free & ~np.isnan(self.floor_height)
        if self.obstacle_state is not None:
            is_closed &= ~self.obstacle_state.mask_of(BLOCKED)
        return is_closed

    @property
    def room_index(self) -> NDArray[np.uint16]:
        """The index of each cell's room on its level, from 1; shape (height, width), uint16.

        0 in cells of no room. All 0 if the file has no ``roomIndex``; stored values that uint16
        can't hold become 0. The array is read-only, unless it is the one in `attributes`.
        """
        return self._index_layer("roomIndex", np.uint16)

    @property
    def area_index(self) -> NDArray[np.uint8]:
        """The number of each cell's area, shape (height, width), uint8; 0 in cells of no area.

        Area 1 is the first of `areas`. Numbers beyond that table count as no area. All 0 if the
        file has no layer ``area``; stored values that uint8 can't hold become 0. The array is
        read-only, unless it is the one in `attributes`.
        """
        return self._index_layer("area", np.uint8)

    def _index_layer(self, name: str, dtype: type[Any]) -> NDArray[Any]:
        """Return an attribute as unsigned integers.

        All 0 if there is no such attribute; 0 where the dtype can't hold the stored value.

        Args:
            name: Name of the attribute.
            dtype: The unsigned integer type of the result.
        """
        stored_layer = self.attributes.get(name)
        if stored_layer is None:
            return _read_only(np.zeros(self.shape, dtype=dtype))
        if stored_layer.dtype == dtype:
            return stored_layer
        is_index = (stored_layer >= 0) & (stored_layer <= np.iinfo(dtype).max)
        return _read_only(np.where(is_index, stored_layer, 0).astype(dtype))

    def measure_rooms(self, number: int = 0) -> list[Room]:
        """Describe the rooms of the level from `room_index` alone.

        Args:
            number: The number of the level in the grid that the rooms are for.

        Returns:
            The rooms, sorted by index, without names and neighbours.
        """
        if not self.room_index.any():  # saves time on maps of other programs, which may be large
            return []
        return measure_rooms(self.room_index, self.floor_or_ground, self.lattice, number)


@dataclass(eq=False, repr=False, kw_only=True)
class MultiLevelGrid(GridBase):
    """The navigation grids of a scene with several levels.

    A level without metadata of its own inherits the parts of the grid's metadata that are about
    this level (see `navbake.navgrid.metadata`). So each level is a complete grid by itself.

    Attributes:
        grids: The levels, lowest first, at least one.
    """

    grids: list[SceneGrid2D]
    _inherited_metadata: list[Json] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        if not self.grids:
            raise FormatError("a MultiLevelGrid has at least one level, got none")
        num_levels = len(self.grids)
        for level, level_metadata in zip(
            self.grids, split_metadata(self.metadata, num_levels), strict=True
        ):
            if not level.metadata or level.metadata == self.metadata:
                level.metadata = level_metadata
        # other copies, to compare with the metadata of levels, which callers may change
        self._inherited_metadata.extend(split_metadata(self.metadata, num_levels))

    @property
    def levels(self) -> list[SceneGrid2D]:
        """The levels, lowest first; `grids` itself."""
        return self.grids

    def inherits_metadata(self, number: int, level: SceneGrid2D) -> bool:
        """Return whether a level still has the metadata that it inherited from this grid.

        Args:
            number: Number of the level in this grid, 0 is the lowest.
            level: The level with this number, or a level that replaces it.
        """
        return level.metadata == self._inherited_metadata[number]

    def with_levels(self, levels: Sequence[SceneGrid2D], metadata: Json | None = None) -> Self:
        """Return the grid with all of its levels replaced.

        Args:
            levels: The new levels, lowest first, as many as the grid has. A level that still has
                the metadata inherited from this grid inherits the metadata of the new grid.
            metadata: The new metadata of the grid; None to keep them.
        """
        grids = [
            level.with_layers(metadata={}) if self.inherits_metadata(number, level) else level
            for number, level in enumerate(levels)
        ]
        return replace(self, grids=grids, metadata=self.metadata if metadata is None else metadata)


def _as_flags(layer: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert a layer to uint8: 1 where it is not 0. A uint8 layer is returned unchanged."""
    if layer.dtype == np.uint8:
        return layer
    return _read_only((layer != 0).astype(np.uint8))


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Make a computed array read-only: writing to it would not change the grid."""
    array.flags.writeable = False
    return array


NavGrid: TypeAlias = SceneGrid2D | MultiLevelGrid
"""A grid of one level or of several: what functions take and return."""
