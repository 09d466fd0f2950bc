"""What grids of one level and of several have in common."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid import cells, door_states
from navbake.navgrid.attributes import describe_attributes
from navbake.navgrid.cells import Cell, Cells
from navbake.navgrid.doors import Door, parse_doors
from navbake.navgrid.lattice import FARTHEST
from navbake.navgrid.links import Link, parse_links
from navbake.navgrid.methods.exports import Exports
from navbake.navgrid.operations import operation
from navbake.navgrid.rooms import Room, measure_rooms, parse_rooms
from navbake.types import Bool, Int, Int32, Json

if TYPE_CHECKING:
    from typing_extensions import Self

    from navbake.navgrid.block_state import Block
    from navbake.navgrid.grid import SceneGrid2D
    from navbake.runtime.place import Place
    from navbake.tensors.grid_tensors import GridTensors

Table = TypeVar("Table")


@dataclass(eq=False, kw_only=True)
class GridBase(Exports):
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

    def at(self, position: ArrayLike, level: int | None = None) -> Place | None:
        """Floor, room, island, weight and occupancy at a world position [m]; None for no cell.

        See `navbake.runtime.place.place_at`.
        """
        found: Place | None = operation("grid.at")(self, position, level)
        return found

    def values_at(self, layer: str, positions: ArrayLike, level: int | None = None) -> NDArray[Any]:
        """One layer at world positions, shape (..., 3) [m], by its name: ``floor``, ``room``, ….

        See `navbake.runtime.place.values_at`.
        """
        values: NDArray[Any] = operation("grid.values_at")(self, layer, positions, level)
        return values

    def tensors(
        self,
        xp: Any = np,
        *,
        device: Any = None,
        dtype: str | None = None,
        goals: Sequence[Any] = (),
        max_drop: float = 0.5,
        cut_corners: bool = False,
    ) -> GridTensors:
        """The grid as arrays of numpy, PyTorch, JAX or another library, for `navbake.tensors`.

        See `navbake.tensors.make_tensors` for the arguments, and for several grids at once.
        """
        made: GridTensors = operation("grid.tensors")(
            self, xp, device=device, dtype=dtype, goals=goals, max_drop=max_drop,
            cut_corners=cut_corners,
        )  # fmt: skip
        return made

    def inflate(
        self,
        radius: float,
        clearance: float | None = None,
        mode: str = "exact",
        *,
        costs: str = "step",
        scaling: float = 10.0,
        ledges: str = "avoid",
    ) -> Self:
        """The same grid for an agent of another radius.

        ``exact``: a cell stays free if the open disc of the radius round its centre meets no
        occupied cell's square, and no floor more than a step higher or lower. So no baked geometry
        is ever hit, and the radius replaces the baked one. See
        `navbake.runtime.inflation` for steps, other levels, the edges of the grid and cells
        without floor. ``minos``: the weights that the original client's ``refine`` gives,
        cell for cell.

        A cell that isn't free stays so, unless only the baked disc closed it (see
        `SceneGrid2D.solid`; or in ``refine`` at radius 0 with a clearance). Occupancy stays as
        baked, so a grid can be inflated again; a grid without layers for occupancy or floors gets
        them, as they followed from its weights.

        Args:
            radius: of the agent [m], 0 to 10,000.
            clearance: how far beyond the radius cells cost more [m]; None for none with ``step``,
                and for as far as the cost reaches 1 with ``nav2``.
            mode: ``exact`` or ``minos``.
            costs: what such a cell weighs at least: ``step``, 10; ``nav2``, the cost of nav2's
                inflation layer, ``floor(252 exp(-scaling (d - radius)))``, d from the centre of
                the nearest occupied cell of the level.
            scaling: of ``nav2`` [1/m], > 0.
            ledges: of ``exact``: ``avoid`` keeps the disc off floors more than a step lower,
                ``ignore`` lets it hang over them.

        Returns:
            A new grid; its metadata list what was done under ``inflation``.

        Raises:
            QueryError: an argument is out of its range.
        """
        inflated: Self = operation("grid.inflate")(
            self, radius, clearance, mode, costs=costs, scaling=scaling, ledges=ledges
        )
        return inflated

    def inflate_footprint(
        self, polygon: ArrayLike, num_headings: int = 16, *, ledges: str = "avoid"
    ) -> list[Bool]:
        """Where an agent that isn't round can stand, heading by heading.

        Args:
            polygon: its outline from above, shape (n, 2), n >= 3, in its own frame [m]: x ahead,
                y to the left, its centre at the origin. Without crossings.
            num_headings: how many headings; number k looks along ``2 π k / num_headings``,
                counter-clockwise from the world's x.
            ledges: as of `inflate`.

        Returns:
            For each level, shape (num_headings, height, width), bool: whether the cell is free
            and the polygon, its origin on the cell's centre, meets no occupied cell's square;
            see `navbake.runtime.footprint`.

        Raises:
            QueryError: the polygon is none, or there is no heading.
        """
        masks: list[Bool] = operation("grid.inflate_footprint")(
            self, polygon, num_headings, ledges=ledges
        )
        return masks

    def block(
        self,
        *,
        cells: Cell | Cells | None = None,
        disc: tuple[ArrayLike, float] | None = None,
        box: tuple[ArrayLike, ArrayLike] | None = None,
        level: int | None = None,
        height: float | None = None,
        margin: float | None = None,
    ) -> Block:
        """Block cells for something that moves, until they are freed.

        Weights, occupancy and, if it is there, the layer ``clearance`` of this very grid change;
        so do the answers of every `PathFinder` on it. Blocks may overlap. A disc or a box takes
        the cells where an agent that stands on the floor would meet it: those whose square it
        meets, or the disc of `margin` round whose centre. A grid that is derived from this one
        keeps what is blocked when it is made.

        Args:
            cells: level, row and column, as `cell_at` and `cells_at` give them; they alone.
            disc: centre and radius [m]; it stands at the centre's z, on all levels that it
                reaches into. Of x, y alone, it is as high as the level.
            box: lower and upper corner, world frame [m]; of x, y alone, as high as the level.
            level: block this level only; then a position needs no z.
            height: of the disc [m]; the agent's if None.
            margin: radius of the agent [m]; that of the grid's inflation, or else of its bake, if
                None.

        Returns:
            What frees the cells: call its `free`, or use it as a context manager.

        Raises:
            QueryError: not one of cells, disc and box is given, or it is none.
        """
        blocked: Block = operation("grid.block")(
            self, cells=cells, disc=disc, box=box, level=level, height=height, margin=margin
        )
        return blocked

    def describe_cell(self, x: float, y: float, level: int | None = None) -> Json:
        """What the grid knows of a cell: floor, room, island, doors, and what occupies it.

        Args:
            x, y: world position [m].
            level: which level, 0 is the lowest; may be left out where there is but one.

        Returns:
            See `navbake.views.describe.describe_cell`.

        Raises:
            QueryError: there is no such level, or the position is no number or beside the grid.
        """
        described: Json = operation("grid.describe_cell")(self, x, y, level)
        return described

    def blockers(self, x: float, y: float, level: int | None = None) -> list[str]:
        """The names of what blocks the cell at a position, sorted; [] where nothing does.

        Takes and raises what `describe_cell` does.
        """
        return list(self.describe_cell(x, y, level)["blockers"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a NavGrid file, gzipped if its name ends in ``.gz``."""
        operation("grid.save")(self, path)

    def _repr_html_(self) -> str:
        """What a notebook shows of the grid; see `navbake.views.notebook.show_html`."""
        shown: str = operation("grid._repr_html_")(self)
        return shown

    def _repr_png_(self) -> bytes:
        """What a notebook shows that takes pictures alone; see `navbake.views.notebook`."""
        drawn: bytes = operation("grid._repr_png_")(self)
        return drawn
