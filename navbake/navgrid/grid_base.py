"""What one may ask of a grid, whether it has one level or several."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid.attributes import describe_attributes

if TYPE_CHECKING:
    from typing_extensions import Self

    from navbake.navgrid.grid import NavGrid, SceneGrid2D
    from navbake.runtime.blocks.block import Block
    from navbake.runtime.places.locate import Cell, Cells
    from navbake.runtime.places.place import Place

Json: TypeAlias = dict[str, Any]


class GridBase:
    """What one level and several share: what the metadata say, and what one may ask of either."""

    metadata: Json

    @property
    def levels(self) -> list[SceneGrid2D]:
        """The levels, lowest first."""
        raise NotImplementedError

    @property
    def _itself(self) -> NavGrid:
        return cast("NavGrid", self)  # nothing else derives from this class

    @property
    def scene_id(self) -> str | None:
        """The scene's name, if the file gives one."""
        name = self.metadata.get("sceneId")
        return name if isinstance(name, str) else None

    @property
    def navbake(self) -> Json:
        """What navbake wrote into the metadata: versions, digests, frame; {} in others' files."""
        own = self.metadata.get("navbake")
        return own if isinstance(own, dict) else {}

    @property
    def rooms(self) -> list[Json]:
        """The table of the rooms, see `navbake.navgrid.rooms.describe_rooms`."""
        from navbake.navgrid.rooms import describe_rooms

        return describe_rooms(self._itself)

    @property
    def doors(self) -> list[Json]:
        """The doors: id, joint, rooms, state, and the cells that each blocks; [] if none."""
        doors = self.navbake.get("doors", [])
        return doors if isinstance(doors, list) else []

    @property
    def cell_attributes(self) -> list[Json]:
        """What the metadata says of each attribute, completed where it says nothing."""
        return describe_attributes(self.metadata, self.levels)

    def cell_at(self, position: ArrayLike, level: int | None = None) -> Cell | None:
        """The cell of a world position [m]; see `navbake.runtime.places.locate.cell_at`."""
        from navbake.runtime.places.locate import cell_at

        return cell_at(self._itself, position, level)

    def cells_at(self, positions: ArrayLike, level: int | None = None) -> Cells:
        """The cells of world positions, shape (..., 3) [m]; -1 for none. See `cell_at`."""
        from navbake.runtime.places.locate import cells_at

        return cells_at(self._itself, positions, level)

    def position_of(self, cells: Cell | Cells) -> NDArray[np.float64]:
        """World x, y and floor z [m] of cells' centres, shape (..., 3), float64."""
        from navbake.runtime.places.locate import position_of

        return position_of(self._itself, cells)

    def at(self, position: ArrayLike, level: int | None = None) -> Place | None:
        """Floor, room, island, weight and occupancy at a world position [m]; None for no cell.

        See `navbake.runtime.places.place.place_at`.
        """
        from navbake.runtime.places.place import place_at

        return place_at(self._itself, position, level)

    def values_at(self, layer: str, positions: ArrayLike, level: int | None = None) -> NDArray[Any]:
        """One layer at world positions, shape (..., 3) [m], by its name: ``floor``, ``room``, ….

        See `navbake.runtime.places.place.values_at`.
        """
        from navbake.runtime.places.place import values_at

        return values_at(self._itself, layer, positions, level)

    def inflate(
        self,
        radius: float,
        clearance: float | None = None,
        mode: str = "exact",
        *,
        costs: str = "step",
        scaling: float = 10.0,
    ) -> Self:
        """The same grid for an agent of another radius.

        ``exact``: a cell stays free if the open disc of the radius round its centre meets no
        occupied cell's square. So nothing that the bake saw is ever hit, whatever the radius; the
        baked radius needs no adding or taking away. See `navbake.runtime.inflation.inflate` for
        steps, other levels, the edges of the grid and cells without floor. ``minos``: the weights
        that the original client's ``refine`` gives, cell for cell.

        A cell that isn't free stays so (but for what ``refine`` does at radius 0 with a
        clearance). Occupancy stays as baked, so a grid can be inflated again; a file that tells
        none, or no floors, gets those layers, as they followed from its weights.

        Args:
            radius: of the agent [m], 0 to 10,000.
            clearance: how far beyond the radius cells cost more [m]; None for none with ``step``,
                and for as far as the cost reaches 1 with ``nav2``.
            mode: ``exact`` or ``minos``.
            costs: what such a cell weighs at least: ``step``, 10; ``nav2``, the cost of nav2's
                inflation layer, ``floor(252 exp(-scaling (d - radius)))``, d from the centre of
                the nearest occupied cell of the level.
            scaling: of ``nav2`` [1/m], > 0.

        Returns:
            A new grid; its metadata list what was done under ``inflation``.

        Raises:
            QueryError: an argument is out of its range.
        """
        from navbake.runtime.inflation.inflate import inflate

        whole: Any = self
        inflated: Self = inflate(whole, radius, clearance, mode, costs=costs, scaling=scaling)
        return inflated

    def inflate_footprint(
        self, polygon: ArrayLike, num_headings: int = 16
    ) -> list[NDArray[np.bool_]]:
        """Where an agent that isn't round can stand, heading by heading.

        Args:
            polygon: its outline from above, shape (n, 2), n >= 3, in its own frame [m]: x ahead,
                y to the left, its centre at the origin. Without crossings.
            num_headings: how many headings; number k looks along ``2 π k / num_headings``,
                counter-clockwise from the world's x.

        Returns:
            For each level, shape (num_headings, height, width), bool: whether the cell is free
            and the polygon, its origin on the cell's centre, meets no occupied cell's square;
            see `navbake.runtime.inflation.footprint`.

        Raises:
            QueryError: the polygon is none, or there is no heading.
        """
        from navbake.runtime.inflation.footprint import inflate_footprint

        return inflate_footprint(self._itself, polygon, num_headings)

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
        from navbake.runtime.blocks.blocking import block

        return block(
            self._itself,
            cells=cells,
            disc=disc,
            box=box,
            level=level,
            height=height,
            margin=margin,
        )

    def with_doors(self, states: Mapping[str, str] | str) -> Self:
        """The same grid with doors in other states, as a bake in these states would have it.

        Args:
            states: ``modelled``, ``open``, ``closed`` or ``removed``, by a door's id or for all.

        Raises:
            QueryError: there is no such door, or no such state, or the grid was inflated.
        """
        from navbake.navgrid.doors import with_doors

        whole: Any = self
        changed: Self = with_doors(whole, states)
        return changed

    def describe_cell(self, x: float, y: float, level: int | None = None) -> Json:
        """What the grid knows of a place: floor, room, island, doors, and what occupies it.

        Args:
            x, y: world position [m].
            level: which level, 0 is the lowest; may be left out where there is but one.

        Returns:
            See `navbake.views.why.describe_cell`.

        Raises:
            QueryError: there is no such level, or the position is no number or beside the grid.
        """
        from navbake.views.why import describe_cell

        return describe_cell(self._itself, x, y, level)

    def blockers(self, x: float, y: float, level: int | None = None) -> list[str]:
        """The names of what blocks the cell at a place, sorted; [] where nothing does.

        Args:
            x, y: world position [m].
            level: which level, 0 is the lowest; may be left out where there is but one.

        Raises:
            QueryError: there is no such level, or the position is no number or beside the grid.
        """
        blockers: list[str] = self.describe_cell(x, y, level)["blockers"]
        return blockers

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a NavGrid file, gzipped if its name ends in ``.gz``."""
        from navbake.formats.navgrid import write_navgrid

        write_navgrid(self._itself, path)
