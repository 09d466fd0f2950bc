"""Methods of grids whose functions live in modules above: the run time, formats, views.

These import the grid, so the grid may not import them: it names the function, which is imported
when the method is first looked at. Signature and docstring are the function's.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from navbake.lazy import Method
from navbake.navgrid.block_state import Block
from navbake.types import Bool, Json


class Operations:
    """What a grid can do by the modules above it; see the functions that are named here."""

    at = Method[Any]("navbake.runtime.place:place_at")
    values_at = Method[NDArray[Any]]("navbake.runtime.place:values_at")
    inflate = Method[Any]("navbake.runtime.inflation:inflate")
    inflate_footprint = Method[list[Bool]]("navbake.runtime.inflation:inflate_footprint")
    block = Method[Block]("navbake.runtime.blocks:block")
    tensors = Method[Any]("navbake.tensors.build:make_tensors")
    describe_cell = Method[Json]("navbake.views.describe:describe_cell")
    save = Method[None]("navbake.formats.navgrid:write_navgrid")
    convert = Method[list[Path]]("navbake.formats.convert:write_as")
    to_mesh = Method[Any]("navbake.formats.floor_mesh:make_floor_mesh")
    to_polygons = Method[list[Any]]("navbake.formats.shapes:find_shapes")
    to_geojson = Method[Json]("navbake.formats.shapes:to_geojson")
    to_graph = Method[Any]("navbake.formats.graphs:make_graph")
    _repr_html_ = Method[str]("navbake.views.notebook:show_html")
    _repr_png_ = Method[bytes]("navbake.views.notebook:draw_png")

    def blockers(self, x: float, y: float, level: int | None = None) -> list[str]:
        """The names of what blocks the cell at a position, sorted; [] where nothing does.

        Takes and raises what `describe_cell` does.
        """
        return list(self.describe_cell(x, y, level)["blockers"])

    def to_nav2(self, path: str | os.PathLike[str], **options: Any) -> list[Path]:
        """Write maps of ROS and nav2: a YAML and an image for each level.

        Takes the options of `navbake.formats.nav2.encode_nav2`, and raises what it does;
        `navbake.from_nav2` reads them. Returns the files that were written.
        """
        return self.convert(path, "nav2", **options)

    def to_procthor(self, path: str | os.PathLike[str], **options: Any) -> list[Path]:
        """Write MolmoSpaces' ``ProcTHORMap`` (PNG) of each level.

        Takes the options of `navbake.formats.procthor.encode_procthor`, and raises what it does;
        `navbake.from_procthor` reads them. Returns the files that were written.
        """
        return self.convert(path, "procthor", **options)

    def to_npz(self, path: str | os.PathLike[str]) -> list[Path]:
        """Write a NumPy archive that holds all of the grid; `navbake.from_npz` reads it.

        See `navbake.formats.npz` for its arrays.
        """
        return self.convert(path, "npz")

    def to_mjcf(self, path: str | os.PathLike[str], **options: Any) -> list[Path]:
        """Write a MuJoCo scene of walls and floors, and the settings that bake it to these cells.

        Takes the options of `navbake.formats.extrude.encode_mjcf`, and raises what it does. Returns
        the files that were written.
        """
        return self.convert(path, "mjcf", **options)
