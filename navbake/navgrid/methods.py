"""Methods of grids whose functions live in modules above: the run time, formats, views.

Each calls the function that is registered for its name, see `navbake.navgrid.operations`.
"""

# the attached methods have no body of their own
# mypy: disable-error-code="empty-body"

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid.cells import Cell, Cells
from navbake.navgrid.operations import operation
from navbake.types import Bool, Json

if TYPE_CHECKING:
    from typing_extensions import Self

    from navbake.formats.floor_mesh import FloorMesh
    from navbake.formats.graphs import CellGraph, RoomGraph
    from navbake.formats.shapes import Shape
    from navbake.navgrid.block_state import Block
    from navbake.runtime.place import Place
    from navbake.tensors.grid_tensors import GridTensors

Method = TypeVar("Method", bound=Callable[..., Any])

KINDS = ("room", "walkable", "door")  # of shapes


def _attached(method: Method) -> Method:
    """Have a method of grids call the function that is registered for its name."""

    @wraps(method)
    def call(self: Any, *args: Any, **kwargs: Any) -> Any:
        return operation(f"grid.{method.__name__}")(self, *args, **kwargs)

    return cast(Method, call)


class Operations:
    """What a grid can do by the modules above it."""

    @_attached
    def at(self, position: ArrayLike, level: int | None = None) -> Place | None:
        """Floor, room, island, weight and occupancy at a world position [m]; None for no cell.

        See `navbake.runtime.place.place_at`.
        """

    @_attached
    def values_at(self, layer: str, positions: ArrayLike, level: int | None = None) -> NDArray[Any]:
        """One layer at world positions, shape (..., 3) [m], by its name: ``floor``, ``room``, ….

        See `navbake.runtime.place.values_at`.
        """

    @_attached
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

    @_attached
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

    @_attached
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

    @_attached
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

    @_attached
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

    def blockers(self, x: float, y: float, level: int | None = None) -> list[str]:
        """The names of what blocks the cell at a position, sorted; [] where nothing does.

        Takes and raises what `describe_cell` does.
        """
        return list(self.describe_cell(x, y, level)["blockers"])

    @_attached
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a NavGrid file, gzipped if its name ends in ``.gz``."""

    @_attached
    def _repr_html_(self) -> str:
        """What a notebook shows of the grid; see `navbake.views.notebook.show_html`."""

    @_attached
    def _repr_png_(self) -> bytes:
        """What a notebook shows that takes pictures alone; see `navbake.views.notebook`."""

    @_attached
    def convert(
        self, path: str | os.PathLike[str], to: str | None = None, **options: Any
    ) -> list[Path]:
        """Write the grid in any format that is written; see `navbake.formats.convert.FORMATS`.

        Args:
            path: of the file that names the others, if there are several.
            to: the format's name; by the file's ending if None.
            options: what the format takes.

        Returns:
            The files that were written.

        Raises:
            FormatError: there is no such format or option, or it can't hold the grid.
        """

    def to_nav2(
        self,
        path: str | os.PathLike[str],
        *,
        level: int | None = None,
        radius: float | None = None,
        mode: str = "trinary",
        image: str | None = None,
        inflation: float | None = None,
        scaling: float | None = None,
    ) -> list[Path]:
        """Write maps of ROS and nav2: a YAML and an image for each level.

        Takes and raises what `navbake.formats.nav2.encode_nav2` does; `navbake.from_nav2`
        reads them.

        Returns:
            The files that were written.
        """
        options = {"level": level, "radius": radius, "mode": mode, "image": image}
        options |= {"inflation": inflation, "scaling": scaling}
        return self.convert(path, "nav2", **options)

    def to_procthor(
        self,
        path: str | os.PathLike[str],
        *,
        level: int | None = None,
        radius: float | None = None,
    ) -> list[Path]:
        """Write MolmoSpaces' ``ProcTHORMap`` (PNG) of each level.

        Takes and raises what `navbake.formats.procthor.encode_procthor` does;
        `navbake.from_procthor` reads them.

        Returns:
            The files that were written.
        """
        return self.convert(path, "procthor", level=level, radius=radius)

    def to_npz(self, path: str | os.PathLike[str]) -> list[Path]:
        """Write a NumPy archive that holds all of the grid; `navbake.from_npz` reads it.

        See `navbake.formats.npz` for its arrays.
        """
        return self.convert(path, "npz")

    def to_mjcf(
        self,
        path: str | os.PathLike[str],
        *,
        level: int | None = None,
        height: float | None = None,
        flat: bool = False,
    ) -> list[Path]:
        """Write a MuJoCo scene of walls and floors, and the settings that bake it to these cells.

        Takes and raises what `navbake.formats.extrude.encode_mjcf` does.

        Returns:
            The files that were written.
        """
        return self.convert(path, "mjcf", level=level, height=height, flat=flat)

    @_attached
    def to_mesh(self, tolerance: float = 0.001) -> FloorMesh:
        """The walkable floor as quads, level by level; `convert` writes it as GLB or OBJ.

        See `navbake.formats.floor_mesh.make_floor_mesh`.

        Args:
            tolerance: how far the mesh may be off the floor at a cell's centre [m], >= 0.

        Raises:
            QueryError: the tolerance is none.
        """

    @_attached
    def to_polygons(self, kinds: Collection[str] = KINDS) -> list[Shape]:
        """Rooms and walkable areas as polygons along the cells' edges, doors as lines.

        Each gives its `geometry` for shapely. See `navbake.formats.shapes.find_shapes`.

        Args:
            kinds: which shapes: ``room``, ``walkable``, ``door``.

        Raises:
            QueryError: a kind is unknown.
        """

    @_attached
    def to_geojson(self, kinds: Collection[str] = KINDS) -> Json:
        """The same as a GeoJSON FeatureCollection; `convert` writes it.

        See `navbake.formats.shapes.to_geojson`.

        Args:
            kinds: which features: ``room``, ``walkable``, ``door``.

        Raises:
            QueryError: a kind is unknown.
        """

    @overload
    def to_graph(
        self, kind: Literal["cells"] = "cells", *, cut_corners: bool = False
    ) -> CellGraph: ...
    @overload
    def to_graph(self, kind: Literal["rooms"], *, cut_corners: bool = False) -> RoomGraph: ...
    @_attached
    def to_graph(self, kind: str = "cells", *, cut_corners: bool = False) -> CellGraph | RoomGraph:
        """The steps between free cells, or the ways between rooms, as a graph.

        Each gives itself `to_networkx`; of cells, `matrix` is for scipy.

        Args:
            kind: ``cells``, see `navbake.formats.graphs.make_cell_graph`; or ``rooms``,
                see `navbake.formats.graphs.make_room_graph`.
            cut_corners: let diagonal steps pass blocked corners; of ``cells``.

        Raises:
            QueryError: the kind is unknown, or a weight is negative.
        """
