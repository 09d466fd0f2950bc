"""Methods of grids that write other programs' files; each calls a format's function by name."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from navbake.navgrid.operations import operation


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

        Takes and raises what `navbake.formats.maps.nav2.encode_nav2` does; `navbake.from_nav2`
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

        Takes and raises what `navbake.formats.maps.procthor.encode_procthor` does;
        `navbake.from_procthor` reads them.

        Returns:
            The files that were written.
        """
        return self.convert(path, "procthor", level=level, radius=radius)

    def to_npz(self, path: str | os.PathLike[str]) -> list[Path]:
        """Write a NumPy archive that holds all of the grid; `navbake.from_npz` reads it.

        See `navbake.formats.maps.grid_npz` for its arrays.
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

        Takes and raises what `navbake.formats.maps.mjcf.encode_mjcf` does.

        Returns:
            The files that were written.
        """
        return self.convert(path, "mjcf", level=level, height=height, flat=flat)
