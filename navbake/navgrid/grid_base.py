"""What grids of one level and of several have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

from navbake.navgrid import cells
from navbake.navgrid import doors as door_states
from navbake.navgrid.doors import Door, parse_doors
from navbake.navgrid.lattice import FARTHEST
from navbake.navgrid.metadata import Link, describe_attributes, parse_links
from navbake.navgrid.methods import Operations
from navbake.navgrid.rooms import Room, measure_rooms, parse_rooms
from navbake.types import Int, Int32, Json

if TYPE_CHECKING:
    from typing_extensions import Self

    from navbake.navgrid.grid import SceneGrid2D

Table = TypeVar("Table")


@dataclass(eq=False, kw_only=True)
class GridBase(Operations):
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
        states = [level.block_state for level in self.levels]
        clean = [
            level if state is None else state.without_blocks(level)
            for level, state in zip(self.levels, states, strict=True)
        ]
        return self.with_levels(clean)

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
        rooms = (measure_rooms(level, number) for number, level in enumerate(self.levels))
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

    # functions that take the grid first, as methods, with their docstrings
    cell_at = cells.cell_at
    cells_at = cells.cells_at
    position_of = cells.position_of
    with_doors = door_states.with_doors
