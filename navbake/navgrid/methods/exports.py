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
