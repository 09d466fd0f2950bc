"""Reads and writes grids in any of the formats of `navbake.formats.format_table`.

A format's reader or writer is imported when it is used.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast

from navbake.errors import FormatError
from navbake.formats.format_table import FileFormat, find_format
from navbake.formats.source import check_path, write_files
from navbake.lazy import resolve

if TYPE_CHECKING:
    from navbake.formats.source import Files
    from navbake.navgrid.grid import NavGrid
    from navbake.navgrid.links import Agent


LOG = logging.getLogger(__name__)


def read_as(path: str | os.PathLike[str], name: str | None = None, **options: object) -> NavGrid:
    """Read a grid in any format that can be read.

    Args:
        path: the file.
        name: the name of its format in `GRID_FORMATS` of the table, None to go by the file's
            ending.
        options: options of the format's reader, see `FileFormat.read_options`.

    Returns:
        The grid.

    Raises:
        FormatError: the format is unknown, or the file is broken.
    """
    return read_with(find_format(path, name, writing=False), path, **options)


def read_with(file_format: FileFormat, path: str | os.PathLike[str], **options: object) -> NavGrid:
    """Read a grid with the reader of a format.

    Args:
        file_format: the format, which can be read.
        path: the file.
        options: options of the format's reader, see `FileFormat.read_options`.

    Returns:
        The grid.

    Raises:
        FormatError: the file is broken.
    """
    grid: NavGrid = resolve(f"navbake.formats.{file_format.read}")(path, **options)
    return grid


def list_files(path: Path, file_format: FileFormat) -> list[Path]:
    """List the files that a format's reader reads for a path.

    Args:
        path: the file that the reader is given.
        file_format: its format.

    Returns:
        The path itself, then the other files, such as the image of a map.

    Raises:
        FormatError: the file is broken, so that the other files are unknown.
    """
    if file_format.list_parts is None:
        return [path]
    return [path, *resolve(f"navbake.formats.{file_format.list_parts}")(path)]


def encode_as(
    grid: NavGrid, path: str | os.PathLike[str], name: str | None = None, **options: object
) -> Files:
    """Encode the files of a grid in any format that can be written, without writing them.

    Args:
        grid: the grid.
        path: the file that is to be written; several files take their names from it.
        name: the name of the format in `GRID_FORMATS` of the table, None to go by the path's
            ending.
        options: options of the format's writer, see `FileFormat.write_options`. ``radius`` [m]
            inflates the grid for a robot of this radius first.

    Returns:
        The content of each file by its path, in the order of writing.

    Raises:
        FormatError: the format is unknown, takes no such option, or can't hold the grid.
    """
    return encode_with(find_format(path, name, writing=True), grid, Path(path), None, **options)


def encode_with(
    file_format: FileFormat,
    grid: NavGrid,
    path: Path,
    progress: Callable[[str, float], None] | None = None,
    **options: object,
) -> Files:
    """Encode the files of a grid with the writer of a format, without writing them.

    Args:
        file_format: the format, which can be written.
        grid: the grid.
        path: the file that is to be written; several files take their names from it.
        progress: called with a name and the fraction that is done, 0 to 1, by the writers of slow
            formats, see `FileFormat.reports_progress`; None for no report.
        options: options of the format's writer, see `encode_as`.

    Returns:
        The content of each file by its path, in the order of writing.

    Raises:
        FormatError: the format takes no such option, or can't hold the grid.
    """
    for option in options:
        if option not in file_format.write_options:
            accepted_options = ", ".join(file_format.write_options) or "none"
            raise FormatError(
                f"{file_format.name} takes no option {option!r}, it takes: {accepted_options}",
                key=option,
                value=options[option],
            )
    if file_format.reports_progress:
        options["progress"] = progress
    if not file_format.loses:
        encoded_files: Files = resolve(f"navbake.formats.{file_format.encode}")(
            grid, path, **options
        )
        return encoded_files

    from navbake.formats import map_losses  # loads numpy

    agent = cast("str | Agent | None", options.get("agent"))
    level = cast("int | None", options.get("level"))
    stairs: str | None = "free"
    if "stairs" in file_format.closes:
        stairs = cast("str | None", options.get("stairs"))
    closed_cells = map_losses.find_closed_cells(
        grid,
        stairs=stairs,
        agent=agent,
        closes_areas="areas" in file_format.closes,
    )
    radius = cast("float | None", options.get("radius"))
    map_grid = grid
    if file_format.inflates:
        options.pop("radius", None)
        if radius is not None:
            map_grid = grid.inflate(radius)  # checks the radius itself
    if file_format.closes:
        options.pop("stairs", None)
        options.pop("agent", None)
        closed_cell_masks = closed_cells.join_masks()
        if file_format.marks_closed_cells:
            options["closed_cell_masks"] = closed_cell_masks
        elif any(mask.any() for mask in closed_cell_masks):
            map_grid = map_losses.close_cells(map_grid, closed_cell_masks)
    files: Files = resolve(f"navbake.formats.{file_format.encode}")(map_grid, path, **options)
    if radius is None and options.get("inflation") is not None:  # costs are for the grid's agent
        radius = grid.agent_radius
    losses = map_losses.describe_losses(
        grid, file_format.loses, closed_cells, level=level, agent=agent, radius=radius or 0.0
    )
    if losses:
        LOG.warning("%s has no place for %s", file_format.name, ", ".join(losses))
    return files


def write_as(
    grid: NavGrid, path: str | os.PathLike[str], to: str | None = None, **options: object
) -> list[Path]:
    """Write a grid in any format that can be written, all its files or none.

    Args:
        grid: the grid.
        path: the file; several files take their names from it.
        to: the name of the format in `GRID_FORMATS` of the table, None to go by the path's ending.
        options: options of the format's writer, see `encode_as`.

    Returns:
        The paths of the written files.

    Raises:
        FormatError: the format is unknown, takes no such option, or can't hold the grid; or a file
            can't be written.
    """
    return write_files(encode_as(grid, check_path(path), to, **options))
