"""Methods of grids that write other programs' files; each calls a format's function by name."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from navbake.navgrid.operations import operation
from navbake.types import Json

if TYPE_CHECKING:
    from navbake.formats.cell_graph import CellGraph
    from navbake.formats.floor_mesh import FloorMesh
    from navbake.formats.room_graph import RoomGraph
    from navbake.formats.shapes import Shape

KINDS = ("room", "walkable", "door")  # of shapes


class Exports:
    """What a grid is written as for other programs, beside its own format (`save`)."""

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
        written: list[Path] = operation("grid.convert")(self, path, to, **options)
        return written

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

    def to_mesh(self, tolerance: float = 0.001) -> FloorMesh:
        """The walkable floor as quads, level by level; `convert` writes it as GLB or OBJ.

        See `navbake.formats.floor_mesh.make_floor_mesh`.

        Args:
            tolerance: how far the mesh may be off the floor at a cell's centre [m], >= 0.

        Raises:
            QueryError: the tolerance is none.
        """
        mesh: FloorMesh = operation("grid.to_mesh")(self, tolerance)
        return mesh

    def to_polygons(self, kinds: Collection[str] = KINDS) -> list[Shape]:
        """Rooms and walkable areas as polygons along the cells' edges, doors as lines.

        Each gives its `geometry` for shapely. See `navbake.formats.shapes.find_shapes`.

        Args:
            kinds: which shapes: ``room``, ``walkable``, ``door``.

        Raises:
            QueryError: a kind is unknown.
        """
        shapes: list[Shape] = operation("grid.to_polygons")(self, kinds)
        return shapes

    def to_geojson(self, kinds: Collection[str] = KINDS) -> Json:
        """The same as a GeoJSON FeatureCollection; `convert` writes it.

        See `navbake.formats.geojson.to_geojson`.

        Args:
            kinds: which features: ``room``, ``walkable``, ``door``.

        Raises:
            QueryError: a kind is unknown.
        """
        collection: Json = operation("grid.to_geojson")(self, kinds)
        return collection

    @overload
    def to_graph(
        self, kind: Literal["cells"] = "cells", *, cut_corners: bool = False
    ) -> CellGraph: ...
    @overload
    def to_graph(self, kind: Literal["rooms"], *, cut_corners: bool = False) -> RoomGraph: ...
    def to_graph(self, kind: str = "cells", *, cut_corners: bool = False) -> CellGraph | RoomGraph:
        """The steps between free cells, or the ways between rooms, as a graph.

        Each gives itself `to_networkx`; of cells, `matrix` is for scipy.

        Args:
            kind: ``cells``, see `navbake.formats.cell_graph.make_cell_graph`; or ``rooms``,
                see `navbake.formats.room_graph.make_room_graph`.
            cut_corners: let diagonal steps pass blocked corners; of ``cells``.

        Raises:
            QueryError: the kind is unknown, or a weight is negative.
        """
        graph: CellGraph | RoomGraph = operation("grid.to_graph")(
            self, kind, cut_corners=cut_corners
        )
        return graph
