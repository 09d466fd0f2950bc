"""The methods of a grid whose code is in other modules: queries, planning, export, pictures.

Each method of `GridMethods` calls one function of another module. Most of these modules belong to
folders above this one and import `navbake.navgrid.grid`. So this module imports upwards: for type
annotations, and inside of its methods. Only `navbake.routes.graph_methods` does so, too. The graph
of imports in `tests/test_imports.py` and `scripts/draw_imports.py` leaves both out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.types import Bool, Float, Int32, Json

if TYPE_CHECKING:
    from PIL.Image import Image
    from typing_extensions import Self

    from navbake.formats.floor_mesh import FloorMesh
    from navbake.formats.graphs import CellGraph, RoomGraph
    from navbake.formats.shapes import Shape
    from navbake.navgrid.cells import Place
    from navbake.navgrid.grid import NavGrid
    from navbake.navgrid.lattice import Cell, Cells
    from navbake.navgrid.links import Agent
    from navbake.routes.graph import RouteGraph
    from navbake.runtime import paths
    from navbake.runtime.blocking import AddedObstacle
    from navbake.runtime.stand import StandPoses
    from navbake.tensors.grid_tensors import GridTensors
    from navbake.views.plot import Mark

# Functions import the modules that they call: most of these import this module, or load slowly.


class GridMethods:
    """Methods that `GridBase` inherits; a position is world x, y, z [m]."""

    def _as_grid(self) -> NavGrid:
        """Return the grid itself: only the classes of grids inherit from this class."""
        return cast("NavGrid", self)

    # ---------------------------------------------------------------- cells and positions

    def cell_at(self, position: ArrayLike, level: int | None = None) -> Cell | None:
        """Return the cell of a position; None outside the grid or below all of its floors.

        The cell is on the level with the highest floor that lies at or below the position, or at
        most a step (`max_step`) above it. If no level has such a floor there, the grounds of the
        levels count as floors.

        Args:
            position: World x, y, z [m], shape (3,). x, y are enough with `level`, or on a grid of
                one level.
            level: The level of the cell, 0 is the lowest; z is then ignored. None to find it by z.

        Returns:
            Level, row and column; or None.

        Raises:
            QueryError: The level does not exist, or the position is not valid.
        """
        from navbake.navgrid.cells import cell_at

        return cell_at(self._as_grid(), position, level)

    def cells_at(self, positions: ArrayLike, level: int | None = None) -> Cells:
        """Return the cells of many positions, by the rule of `cell_at`.

        Args:
            positions: World x, y, z [m], shape (..., 3); shape (..., 2) is enough with `level`, or
                on a grid of one level.
            level: The level of all cells, 0 is the lowest; z is then ignored. None to find each by
                z.

        Returns:
            Level, row and column of each, three arrays of shape (...), int64; -1 in all three where
            there is no cell.

        Raises:
            QueryError: The level does not exist, or a position is not valid.
        """
        from navbake.navgrid.cells import cells_at

        return cells_at(self._as_grid(), positions, level)

    def position_of(self, cells: Cell | Cells | tuple[ArrayLike, ArrayLike, ArrayLike]) -> Float:
        """Return the centres of cells, on the floor.

        Args:
            cells: One cell, or several as arrays of level, row and column of shape (...). A plain
                tuple (level, row, col) is enough.

        Returns:
            World x, y, z [m], shape (..., 3), float64. z is the ground of the level where a cell
            has no floor.

        Raises:
            QueryError: A cell does not exist.
        """
        from navbake.navgrid.cells import position_of

        return position_of(self._as_grid(), cells)

    def at(self, position: ArrayLike, level: int | None = None) -> Place | None:
        """Return the values of all layers of the grid in the cell of a position.

        Args:
            position: World x, y, z [m], shape (3,). x, y are enough with `level`, or on a grid of
                one level.
            level: The level of the cell, 0 is the lowest; z is then ignored. None to find it by z.

        Returns:
            The cell, its floor, whether it is free, its weight, room, area and island; None where
            `cell_at` returns None.

        Raises:
            QueryError: The level does not exist, or the position is not valid.

        Example:
            >>> place = grid.at((1.0, 2.0, 0.0))
            >>> place.free, place.room, place.floor
            (True, '0:2', 0.0)
        """
        from navbake.navgrid.cells import place_at

        return place_at(self._as_grid(), position, level)

    @overload
    def values_at(
        self, layer: Literal["floor", "weight"], positions: ArrayLike, level: int | None = None
    ) -> Float: ...
    @overload
    def values_at(
        self, layer: Literal["clearance"], positions: ArrayLike, level: int | None = None
    ) -> NDArray[np.float32]: ...
    @overload
    def values_at(
        self, layer: Literal["free"], positions: ArrayLike, level: int | None = None
    ) -> Bool: ...
    @overload
    def values_at(
        self, layer: Literal["occupancy"], positions: ArrayLike, level: int | None = None
    ) -> NDArray[np.uint8]: ...
    @overload
    def values_at(
        self, layer: Literal["room"], positions: ArrayLike, level: int | None = None
    ) -> NDArray[np.uint16]: ...
    @overload
    def values_at(
        self, layer: Literal["island"], positions: ArrayLike, level: int | None = None
    ) -> Int32: ...
    @overload
    def values_at(
        self, layer: str, positions: ArrayLike, level: int | None = None
    ) -> NDArray[np.generic]: ...
    def values_at(
        self, layer: str, positions: ArrayLike, level: int | None = None
    ) -> NDArray[np.generic]:
        """Return the values of one layer of the grid at many positions.

        | layer | value | dtype | outside the grid |
        |---|---|---|---|
        | ``floor`` | world z of the floor [m], NaN without floor | float64 | NaN |
        | ``free`` | whether an agent can stand there | bool | False |
        | ``occupancy`` | 1 for an obstacle | uint8 | 1 |
        | ``weight`` | cost of the cell, inf where it is not free | float64 | inf |
        | ``room`` | index of the room on its level, 0 for none | uint16 | 0 |
        | ``island`` | number of the connected part from 1, 0 for none | int32 | 0 |
        | ``clearance`` | distance to the nearest cell that is not free [m] | float32 | 0 |

        Any other name is an attribute as the file stores it, in its own dtype; outside the grid it
        is NaN, or 0 for integers.

        Args:
            layer: The name of a layer above, or of an attribute (`SceneGrid2D.attributes`).
            positions: World x, y, z [m], shape (..., 3); shape (..., 2) is enough with `level`, or
                on a grid of one level.
            level: The level of all cells, 0 is the lowest; z is then ignored. None to find each by
                z.

        Returns:
            The values, shape (...).

        Raises:
            QueryError: The layer or the level does not exist, or a position is not valid.
        """
        from navbake.navgrid.cells import values_at

        return values_at(self._as_grid(), layer, positions, level)

    def describe_cell(self, position: ArrayLike, level: int | None = None) -> Json:
        """Describe the cell at a position in a dict that can be written as JSON.

        Args:
            position: World x, y, z [m], shape (3,). x, y are enough with `level`, or on a grid of
                one level.
            level: The level of the cell, 0 is the lowest; z is then ignored. None to find it by z.

        Returns:
            ``level``, ``row``, ``col``, ``cell`` (its id, ``col + row * width``), ``center`` (world
            x, y [m]), ``floor`` (world z [m], None without floor), ``free``, ``occupied``,
            ``weight`` (None for infinite), ``room`` (its entry in the table `rooms`, else its
            index, None for no room), ``island`` (from 1, the largest; None where it is not free),
            ``area`` (its name, or None) and ``links`` (names of the links with a stop in the cell).
            Names of what stands in the cell are in ``doors``, ``objects`` and ``walls``, names of
            what blocks it in ``blockers``.

        Raises:
            QueryError: The level does not exist, or the position is not valid or in no cell.
        """
        from navbake.views.describe import describe_cell

        return describe_cell(self._as_grid(), position, level)

    def blockers(self, position: ArrayLike, level: int | None = None) -> list[str]:
        """Return the sorted names of the things that block the cell at a position.

        Args:
            position: World x, y, z [m], shape (3,). x, y are enough with `level`, or on a grid of
                one level.
            level: The level of the cell, 0 is the lowest; z is then ignored. None to find it by z.

        Returns:
            Names of doors, objects and walls; [] in a free cell, and where the grid has no names.

        Raises:
            QueryError: The level does not exist, or the position is not valid or in no cell.

        Example:
            >>> grid.blockers((-1.0, -3.5))
            ['sofa']
        """
        return list(self.describe_cell(position, level)["blockers"])

    # ---------------------------------------------------------------- grids made of the grid

    def without_obstacles(self) -> Self:
        """Return a grid in which no added obstacle (see `block`) blocks a cell.

        Returns:
            A new grid; the grid itself if no obstacle blocks a cell now.
        """
        from navbake.navgrid.unblocking import without_obstacles

        return cast("Self", without_obstacles(self._as_grid()))

    def _with_current_islands(self) -> Self:
        """Return the grid with a layer ``island`` that tells of added obstacles, too.

        Returns:
            A new grid; the grid itself if no obstacle blocks a cell, or if it has no such layer.

        Raises:
            FormatError: A table on which the islands depend is broken.
        """
        from navbake.navgrid.islands import with_current_islands

        return cast("Self", with_current_islands(self._as_grid()))

    def with_doors(self, states: Mapping[str, str] | str) -> Self:
        """Return the grid with doors in other states, as a bake with these states would make it.

        Args:
            states: ``modelled``, ``open``, ``closed`` or ``removed``: one state for all doors; or
                door id -> state, for some doors.

        Returns:
            A new grid; doors that are not in `states` keep their state.

        Raises:
            QueryError: A door or a state does not exist, or the grid was inflated: change its doors
                before it is inflated.

        Example:
            >>> night = grid.with_doors("closed").inflate(0.3)
        """
        from navbake.navgrid.door_states import with_doors

        return cast("Self", with_doors(self._as_grid(), states))

    def with_links(self, states: Mapping[str, str]) -> Self:
        """Return the grid with links opened or closed.

        Args:
            states: Link name -> ``open`` or ``closed``.

        Returns:
            A new grid, which shares its arrays with this one; links that are not in `states` keep
            their state.

        Raises:
            QueryError: A link or a state does not exist.

        Example:
            >>> without_lift = grid.with_links({"lift A": "closed"})
        """
        from navbake.navgrid.door_states import with_links

        return cast("Self", with_links(self._as_grid(), states))

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
        """Return the grid for an agent of another radius than that of the bake.

        In mode ``exact``, a cell stays free if the open disc of `radius` around its centre overlaps
        no occupied cell's square, and no floor that is more than a step higher or lower. In mode
        ``minos``, the weights are those that MINOS's client computes (``refine``), cell for cell.

        A grid that is inflated already can be inflated for a larger radius. For a smaller one it
        stays as it is, and a `navbake.InflationWarning` says so.

        A blocked cell stays blocked, unless only the disc of the baked radius blocked it (see
        `SceneGrid2D.solid`). With radius 0 and a clearance, ``minos`` frees other blocked cells,
        too. Occupancy stays as it was baked. The metadata list each inflation under ``inflation``.

        Args:
            radius: Radius of the agent [m], 0 to 10,000.
            clearance: Distance beyond `radius` in which cells cost more [m], 0 to 10,000. None
                means 0 with costs ``step``; with ``nav2``, the distance at which the cost has
                fallen to 1.
            mode: ``exact`` or ``minos``.
            costs: The least weight of a cell within the clearance. ``step``: 10. ``nav2``: the cost
                of nav2's inflation layer, ``floor(252 exp(-scaling (d - radius)))``. There, d is
                the distance to the centre of the nearest cell that a geom overlaps or that has no
                floor. At the top of a stair, another level's floor goes on at the same height:
                d then counts that level's occupied cells, not the hole in this level.
            scaling: nav2's ``cost_scaling_factor`` [1/m], > 0; for costs ``nav2``.
            ledges: In mode ``exact``: ``avoid`` keeps the disc off floors that are more than a step
                lower, ``ignore`` lets it overhang them.

        Returns:
            A new grid of the same class.

        Raises:
            QueryError: An argument is out of its range, or arguments exclude each other.

        Example:
            >>> for_robot = grid.inflate(0.3, clearance=0.5, costs="nav2", scaling=3.0)
        """
        from navbake.runtime.inflation import inflate

        # the function takes either class of grid and returns the same one, but no union of both
        inflated = inflate(
            cast("Any", self), radius, clearance, mode, costs=costs, scaling=scaling, ledges=ledges
        )
        return cast("Self", inflated)

    def inflate_footprint(
        self, polygon: ArrayLike, num_headings: int = 16, *, ledges: str = "avoid"
    ) -> list[Bool]:
        """Mark the cells where an agent with a polygonal footprint can stand, for each heading.

        A cell is free for a heading if it is free, and the polygon with its origin on the cell's
        centre overlaps no occupied cell's square.

        Args:
            polygon: Outline from above, shape (n, 2), n >= 3, in the agent's frame [m]: x ahead, y
                to the left, the agent's centre at the origin. No two sides cross.
            num_headings: Number of headings, >= 1. Heading k is ``2 π k / num_headings`` [rad],
                counter-clockwise from the world's x axis.
            ledges: ``avoid`` keeps the footprint off floors that are more than a step lower,
                ``ignore`` lets it overhang them.

        Returns:
            For each level an array of shape (num_headings, height, width), bool.

        Raises:
            QueryError: The polygon or another argument is not valid.
        """
        from navbake.runtime.inflation import inflate_footprint

        return inflate_footprint(self._as_grid(), polygon, num_headings, ledges=ledges)

    def block(
        self,
        *,
        cells: Cell | Cells | None = None,
        disc: tuple[ArrayLike, float] | None = None,
        box: tuple[ArrayLike, ArrayLike] | None = None,
        level: int | None = None,
        height: float | None = None,
        margin: float | None = None,
    ) -> AddedObstacle:
        """Block cells of the grid for an obstacle, until it is freed.

        The weights, the occupancy and the layers ``solid`` and ``clearance`` of this grid change in
        place. Each `PathFinder` on it avoids the obstacle, too. One for an agent of another size
        uses the radius of that agent as the margin. Obstacles may overlap. Grids that are made of
        this one keep its current obstacles.

        The islands of cells and of finders are those without the blocked cells. A layer ``island``
        is as well in files, copies and grids that are made of this one meanwhile; in this grid, it
        stays as it is, as an obstacle may change it in all cells.

        A disc or a box blocks the cells where an agent on the floor would collide with it: where it
        overlaps the cell's square or the disc of `margin` around the cell's centre. Beside the
        grid, or where it is too high or too low for any agent, it blocks no cell. That is no error,
        as things may leave the grid and come back.

        Give exactly one of `cells`, `disc` and `box`.

        Args:
            cells: Level, row and column, of one cell or as arrays; as `cell_at` and `cells_at`
                return them.
            disc: Centre and radius [m]. Given x, y, z, it reaches from z up by `height`, on all
                levels; given x, y, it takes the whole height of its level.
            box: Lower and upper corner, world frame [m]; given x, y, it takes the whole height of
                its level.
            level: Block cells of this level only; positions need no z then.
            height: Height of the disc [m]; None for the agent's height.
            margin: Radius of the agent [m]; None for that of the inflation or, if the grid is not
                inflated, of the bake.

        Returns:
            The obstacle, with the `cells` it blocks. Call its `free` to free them, or use it as a
            context manager.

        Raises:
            QueryError: Not exactly one of cells, disc and box is given, or an argument is not
                valid.

        Example:
            >>> with grid.block(disc=((2.0, 1.0, 0.0), 0.3)):
            ...     path = finder.find_path(start, goal)
        """
        from navbake.runtime.blocking import block

        return block(
            self._as_grid(),
            cells=cells,
            disc=disc,
            box=box,
            level=level,
            height=height,
            margin=margin,
        )

    # ---------------------------------------------------------------- planning

    def find_path(
        self,
        start: ArrayLike,
        goal: paths.Goal,
        *,
        level: int | None = None,
        by: str = "cost",
        smooth: bool = True,
        agent: str | Agent | None = None,
    ) -> paths.Path | None:
        """Plan one path. Each call prepares the whole grid: use a `PathFinder` for several paths.

        Args:
            start: World x, y, z [m]; x, y are enough with `level`, or on a grid of one level.
            goal: A position, several positions (the cheapest to reach counts), ``room:NAME``, or
                ``object:NAME``; see `PathFinder`.
            level: The level of start and goal, 0 is the lowest; z is then ignored.
            by: ``cost``: the cheapest path; ``time``: the quickest.
            smooth: Straighten the path where that stays free; else it runs through the centres of
                cells.
            agent: The name of one of the grid's `agents`, or an `Agent`; None for the grid's own.

        Returns:
            The path; None if there is none, see `PathFinder.why_not`.

        Raises:
            QueryError: A position is not valid, or a level, room, object or agent does not exist.

        Example:
            >>> path = grid.find_path((0.5, 0.5, 0.0), "room:kitchen")
            >>> path.length
            6.31
        """
        from navbake.runtime.path_finder import PathFinder

        finder = PathFinder(self._as_grid(), agent=agent)
        return finder.find_path(start, goal, level=level, by=by, smooth=smooth)

    def routes(
        self,
        agent: str | Agent | None = None,
        progress: Callable[[str, float], None] | None = None,
    ) -> RouteGraph:
        """Make the graph of routes for an agent, as the grid is now.

        The grid is inflated to the radius of the agent.

        Args:
            agent: The name of one of the grid's `agents`, or an `Agent`; None for an agent of the
                grid's radius that may use all areas and links.
            progress: Called with ``routes`` and the fraction that is done, 0 to 1; None for no
                report.

        Returns:
            Nodes and lanes; its `save` writes it for nav2, Open-RMF and others.

        Raises:
            QueryError: The grid names no such agent, or can't be used for one of its size.
        """
        from navbake.routes.build import make_routes

        return make_routes(self._as_grid(), agent, progress)

    def tensors(
        self,
        xp: ModuleType = np,
        *,
        device: object = None,
        dtype: str | None = None,
        goals: Sequence[paths.Goal] = (),
        max_drop: float = 0.5,
        cut_corners: bool = False,
        agent: str | Agent | None = None,
    ) -> GridTensors:
        """Return the grid as arrays of an array library, for batched queries on one device.

        Later changes of the grid, obstacles included, have no effect: make new tensors then. For
        several grids in one set of arrays, see `navbake.tensors.make_tensors`.

        Args:
            xp: ``numpy``, ``torch``, ``jax.numpy`` or another module that follows the Python array
                API.
            device: Device of the arrays, as the library names it; None for its default.
            dtype: ``"float32"`` or ``"float64"``, of positions and of all values in metres; None
                for the library's default. float32 is refused if it cannot resolve the cells at
                their distance from the origin.
            goals: Goals as `PathFinder.find_path` takes them; `navbake.tensors.distance_to_goal`
                and `navbake.tensors.path_step` number them in this order.
            max_drop: Largest height above the floor at which `navbake.tensors.is_navigable` is true
                [m], >= 0.
            cut_corners: Allow diagonal steps past blocked corners.
            agent: The name of one of the grid's `agents`, or an `Agent`; the arrays describe the
                grid for an agent of its size. None for the grid's own.

        Returns:
            The arrays; the functions of `navbake.tensors` answer queries with them.

        Raises:
            MissingDependencyError: The extra ``navbake[tensors]`` is not installed.
            QueryError: An argument is not valid.

        Example:
            >>> import torch
            >>> tensors = grid.tensors(torch, device="cuda", goals=["room:kitchen"])
            >>> distance = navbake.tensors.distance_to_goal(tensors, positions)
        """
        from navbake.tensors.build import make_tensors

        return make_tensors(
            self._as_grid(),
            xp,
            device=device,
            dtype=dtype,
            goals=goals,
            max_drop=max_drop,
            cut_corners=cut_corners,
            agent=agent,
        )

    # ---------------------------------------------------------------- files

    def save(self, path: str | PathLike[str]) -> None:
        """Write the grid as a NavGrid file, as a whole or not at all; `navbake.load` reads it.

        Args:
            path: Name of the file, which ends in ``.json``, or in ``.json.gz`` to compress it.

        Raises:
            FormatError: The name ends as one of another format, the format cannot hold the grid, or
                the file cannot be written.
        """
        from navbake.formats.navgrid import write_navgrid

        write_navgrid(self._as_grid(), path)

    def convert(
        self, path: str | PathLike[str], to: str | None = None, **options: object
    ) -> list[Path]:
        """Write the grid in any format that navbake writes: all files of it, or none.

        Args:
            path: Name of the file; its ending says the format unless `to` does.
            to: Name of the format, such as ``nav2`` or ``geojson``; see docs/convert.md.
            **options: Options of the format, such as ``level`` and ``radius``.

        Returns:
            The paths of the written files.

        Raises:
            FormatError: The format or an option does not exist, the format cannot hold the grid, or
                a file cannot be written.

        Example:
            >>> grid.convert("floor.glb")
            [PosixPath('floor.glb')]
        """
        from navbake.formats.convert import write_as

        return write_as(self._as_grid(), path, to, **options)

    def to_nav2(
        self,
        path: str | PathLike[str],
        *,
        level: int | None = None,
        radius: float | None = None,
        mode: str = "trinary",
        image: str | None = None,
        inflation: float | None = None,
        scaling: float | None = None,
        stairs: str | None = None,
        agent: str | Agent | None = None,
    ) -> list[Path]:
        """Write maps for nav2's map server: for each level an image, and a YAML that names it.

        Cells without a floor are unknown, the others free or occupied. Modes ``scale`` and ``raw``
        hold costs as well: 1 to 98 for weights above 1, and 99 for cells that only an inflation
        blocked. `navbake.from_nav2` reads the maps.

        Args:
            path: Name of the YAML, which ends in ``.yaml`` or ``.yml``. Maps of several levels have
                numbers: ``map_0.yaml``, ``map_1.yaml``.
            level: Write the map of this level only, 0 is the lowest; its name gets no number.
            radius: Inflate the grid for a robot of this radius first [m]; see `inflate`.
            mode: ``trinary``, ``scale`` or ``raw``.
            image: ``pgm`` or ``png``; None for ``png`` in mode ``scale``, else for ``pgm``.
            inflation: Write costs by nav2's formula up to this distance from obstacles, which is
                nav2's ``inflation_radius`` [m]; not in mode ``trinary``. The radius in the formula
                is `radius`, or the grid's if that is None.
            scaling: nav2's ``cost_scaling_factor`` [1/m], with `inflation`; None for 10.
            stairs: A map has no heights, so a robot would plan up a stair. ``occupied`` closes
                stairs, and floors that a wheeled robot reaches only over stairs. ``free`` leaves
                them free. None means ``occupied``.
            agent: The agent that the map is for, by its name in the grid or as an `Agent`: areas
                that bar it are occupied. None for areas that bar all agents.

        Returns:
            The paths of the written files.

        Raises:
            FormatError: There is no such level, mode or image, options exclude each other, or a
                file cannot be written.
            QueryError: A radius, inflation or scaling is out of its range, or the grid has no such
                agent.

        Example:
            >>> grid.to_nav2("map.yaml", level=0, radius=0.0)  # nav2 inflates it for the robot
            [PosixPath('map.pgm'), PosixPath('map.yaml')]
        """
        from navbake.formats.convert import write_as

        return write_as(
            self._as_grid(),
            path,
            "nav2",
            level=level,
            radius=radius,
            mode=mode,
            image=image,
            inflation=inflation,
            scaling=scaling,
            stairs=stairs,
            agent=agent,
        )

    def to_procthor(
        self,
        path: str | PathLike[str],
        *,
        level: int | None = None,
        radius: float | None = None,
        stairs: str | None = None,
        agent: str | Agent | None = None,
    ) -> list[Path]:
        """Write a ``ProcTHORMap`` of MolmoSpaces for each level: free cells and rooms as a PNG.

        Args:
            path: Name of the image, which ends in ``.png``; maps of several levels have numbers.
            level: Write the map of this level only, 0 is the lowest.
            radius: Inflate the grid for a robot of this radius first [m]; see `inflate`.
            stairs: A map has no heights, so a robot would plan up a stair. ``occupied`` closes
                stairs, and floors that a wheeled robot reaches only over stairs. ``free`` leaves
                them free. None means ``occupied``.
            agent: The agent that the map is for, by its name in the grid or as an `Agent`: areas
                that bar it are occupied. None for areas that bar all agents.

        Returns:
            The paths of the written files.

        Raises:
            FormatError: There is no such level, one has more than 255 rooms, or a file cannot be
                written.
            QueryError: The radius is out of its range, or the grid has no such agent.
        """
        from navbake.formats.convert import write_as

        return write_as(
            self._as_grid(),
            path,
            "procthor",
            level=level,
            radius=radius,
            stairs=stairs,
            agent=agent,
        )

    def to_npz(self, path: str | PathLike[str]) -> list[Path]:
        """Write all that the grid holds as a NumPy archive; `navbake.from_npz` reads it.

        Equal grids give files with equal bytes. Arrays keep their dtypes.

        Args:
            path: Name of the file, which ends in ``.npz``.

        Returns:
            A list with the path of the file alone.

        Raises:
            FormatError: The format cannot hold the grid, or the file cannot be written.
        """
        from navbake.formats.convert import write_as

        return write_as(self._as_grid(), path, "npz")

    def to_mjcf(
        self,
        path: str | PathLike[str],
        *,
        level: int | None = None,
        height: float | None = None,
        flat: bool | None = None,
    ) -> list[Path]:
        """Write a MuJoCo scene of walls and floors, and settings that bake it to the same cells.

        Args:
            path: Name of the scene, which ends in ``.xml``; the settings beside it have the same
                name with ``.yaml``.
            level: Write this level only, 0 is the lowest; None for all, each at its height.
            height: Height of the walls over the highest floor [m], more than the agent's height.
                None for 2.5, or more for a tall agent.
            flat: Put all floors of a level at the ground of the level, which needs fewer boxes on
                rough ground; None is False.

        Returns:
            The paths of the scene and of the settings.

        Raises:
            FormatError: There is no such level or no free cell, the walls are too low, levels do
                not lie over each other, more than 200,000 boxes are needed, or a file cannot be
                written.
        """
        from navbake.formats.convert import write_as

        return write_as(self._as_grid(), path, "mjcf", level=level, height=height, flat=flat)

    # ---------------------------------------------------------------- shapes and graphs

    def to_mesh(self, tolerance: float = 0.001) -> FloorMesh:
        """Make a mesh of the free cells, for Recast, Blender, Unity and others.

        The mesh covers each free cell once, unless an area bars all agents from it, and nothing
        else. A rectangle of cells of one room becomes one quad if its floor is a plane within the
        tolerance. A quad is horizontal, or sloped where at least three cells in a line rise evenly,
        up to the grid's ``maxSlope`` (45 degrees if the file states none). So stairs become
        horizontal treads, and ramps become slopes. Stairs whose treads are all one cell deep become
        a slope, too.

        There are no risers. Where two quads meet, their heights differ by the step between the
        floors of the cells, plus at most the rise of each quad over half a cell. A free cell
        without floor lies on the ground of the level.

        Args:
            tolerance: Largest distance between the mesh and the floor at a cell's centre [m], >= 0.

        Returns:
            The mesh, with a `LevelMesh` for each level, lowest first.

        Raises:
            QueryError: The tolerance is not valid.
        """
        from navbake.formats.floor_mesh import make_floor_mesh

        return make_floor_mesh(self._as_grid(), tolerance)

    def to_polygons(self, kinds: Collection[str] = ("room", "walkable", "door")) -> list[Shape]:
        """Return rooms and walkable areas as polygons, and doors as lines, in world x, y [m].

        Polygons run exactly along the edges of cells. The polygon of a room contains all of its
        cells, also occupied ones. The polygon of a walkable area contains the free cells of a
        level. A cell's centre is in a polygon if and only if the cell belongs to it. Cells that
        only touch at a corner are in separate parts, so all polygons are valid. A door is a line
        from jamb to jamb along its closed leaf; if the grid does not have the closed leaf, along
        the leaf in its current state.

        Args:
            kinds: The kinds of shapes: some of ``room``, ``walkable`` and ``door``.

        Returns:
            For each level, lowest first: its rooms by index, its walkable area (none without free
            cells), and its doors. A door of two levels is on both.

        Raises:
            QueryError: There is no such kind.
        """
        from navbake.formats.shapes import find_shapes

        return find_shapes(self._as_grid(), kinds)

    def to_geojson(self, kinds: Collection[str] = ("room", "walkable", "door")) -> Json:
        """Return the shapes of `to_polygons` as a GeoJSON FeatureCollection.

        A room or a walkable area is a Polygon or MultiPolygon, a door a LineString, in world x, y
        [m]. Properties are ``kind``, ``level``, ``levelName``, ``height`` (of the level's ground
        [m]), ``id``, ``name`` and ``area`` [m²]; ``outdoors`` of rooms, ``state`` and ``rooms`` of
        doors.

        Args:
            kinds: The kinds of shapes: some of ``room``, ``walkable`` and ``door``.

        Returns:
            The FeatureCollection, which can be written as JSON.

        Raises:
            QueryError: There is no such kind.
        """
        from navbake.formats.shapes import to_geojson

        return to_geojson(self._as_grid(), kinds)

    @overload
    def to_graph(
        self, kind: Literal["cells"] = "cells", *, cut_corners: bool = False
    ) -> CellGraph: ...

    @overload
    def to_graph(self, kind: Literal["rooms"], *, cut_corners: bool = False) -> RoomGraph: ...

    @overload
    def to_graph(self, kind: str, *, cut_corners: bool = False) -> CellGraph | RoomGraph: ...

    def to_graph(self, kind: str = "cells", *, cut_corners: bool = False) -> CellGraph | RoomGraph:
        """Make the graph of the free cells or of the rooms, as they are now.

        Args:
            kind: ``cells``: a node for each free cell, an edge for each step of `PathFinder`, with
                its cost. ``rooms``: a node for each room, an edge for each door or opening between
                two rooms.
            cut_corners: Allow diagonal steps past blocked corners; of kind ``cells``.

        Returns:
            A `CellGraph` or a `RoomGraph`; both convert to networkx.

        Raises:
            QueryError: There is no such kind, or a weight is negative.
        """
        from navbake.formats.graphs import make_graph

        return make_graph(self._as_grid(), kind, cut_corners=cut_corners)

    # ---------------------------------------------------------------- pictures

    @overload
    def plot(
        self,
        path: None = None,
        *,
        level: int | None = None,
        layers: Sequence[str] = ("occupancy", "floor"),
        route: paths.Path | None = None,
        marks: Sequence[Mark] = (),
        poses: StandPoses | None = None,
        region: Sequence[Bool] | None = None,
        bounds: Sequence[float] | None = None,
        dpi: float = 150.0,
        titles: bool = True,
    ) -> Image: ...

    @overload
    def plot(
        self,
        path: str | PathLike[str],
        *,
        level: int | None = None,
        layers: Sequence[str] = ("occupancy", "floor"),
        route: paths.Path | None = None,
        marks: Sequence[Mark] = (),
        poses: StandPoses | None = None,
        region: Sequence[Bool] | None = None,
        bounds: Sequence[float] | None = None,
        dpi: float = 150.0,
        titles: bool = True,
    ) -> Path: ...

    def plot(
        self,
        path: str | PathLike[str] | None = None,
        *,
        level: int | None = None,
        layers: Sequence[str] = ("occupancy", "floor"),
        route: paths.Path | None = None,
        marks: Sequence[Mark] = (),
        poses: StandPoses | None = None,
        region: Sequence[Bool] | None = None,
        bounds: Sequence[float] | None = None,
        dpi: float = 150.0,
        titles: bool = True,
    ) -> Image | Path:
        """Draw layers of the grid: as an image, which notebooks show, or into a file.

        The picture has a row for each level, the lowest on top, and a column for each layer. If
        there is a single layer, the levels are side by side. All panels have the same scale and
        show the same part of the world, +y up. The same grid gives the same bytes.

        Args:
            path: Name of the file, which ends in ``.png``, ``.svg`` or ``.pdf``; None for no file.
            level: Draw this level only, 0 is the lowest.
            layers: What to draw: ``occupancy``, ``floor``, ``rooms``, ``doors``, ``clearance``,
                ``island``, ``weights``, ``links`` or ``area``.
            route: A path to draw on top, each of its parts on its level.
            marks: Places to mark, each as level (-1 for all levels), world x and y [m], and the
                kind of the mark, such as the name of a fault.
            poses: Poses of a base to draw as arrows, from `PathFinder.stand_poses`.
            region: Cells to shade, from `PathFinder.stand_region`: for each level, bool, shape
                (height, width).
            bounds: The part of the world to show, world x_min, y_min, x_max, y_max [m]; None for
                all of the grid.
            dpi: Pixels per inch of a PNG, 30 to 1200; the picture is at most 8.3 inches wide.
            titles: Whether to write the heading and the maps' titles.

        Returns:
            The image, or the path of the file if `path` is given.

        Raises:
            QueryError: There is no such level or layer, the bounds show nothing of the grid,
                `dpi` is out of its range, or `path` has another ending.
            MissingDependencyError: The extra ``navbake[plot]`` is not installed.

        Example:
            >>> grid.plot("house.svg", layers=["rooms"])
            PosixPath('house.svg')
        """
        from navbake.views.plot import Overlays, plot

        return plot(
            self._as_grid(),
            path,
            level=level,
            layers=layers,
            overlays=Overlays(route, marks, poses, region),
            bounds=bounds,
            dpi=dpi,
            titles=titles,
        )

    def _repr_html_(self) -> str:
        """Return what a notebook shows: a line of facts, and a picture of each level."""
        from navbake.views.notebook import render_html

        return render_html(self._as_grid())

    def _repr_png_(self) -> bytes:
        """Return one picture of all levels as PNG, for programs that show no HTML."""
        from navbake.views.notebook import draw_png

        return draw_png(self._as_grid())
