"""Values that a shell completes: names in a grid, formats, layers, samples.

Each function returns all values; typer leaves those that begin with what was typed. A grid that
can't be read, or that takes long to read, completes nothing.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from typer import Context

import navbake
from navbake import samples
from navbake.errors import NavbakeError
from navbake.formats.format_table import GRID_FORMATS, ROUTE_FORMATS

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid

MAX_GRID_BYTES = 5_000_000  # a larger file takes more than a second to read


def list_written_formats() -> list[str]:
    """List the names of the formats of grids and routes that are written."""
    return [form.name for form in (*GRID_FORMATS, *ROUTE_FORMATS) if form.encode]


def list_read_formats() -> list[str]:
    """List the names of the formats of grids and routes that are read."""
    return [form.name for form in (*GRID_FORMATS, *ROUTE_FORMATS) if form.read]


def list_route_formats() -> list[str]:
    """List the names of the formats of routes that are written."""
    return [form.name for form in ROUTE_FORMATS if form.encode]


def list_layers() -> list[str]:
    """List the layers of pictures."""
    from navbake.views.layers import LAYERS  # loads numpy

    return list(LAYERS)


def list_samples() -> list[str]:
    """List the names of samples."""
    return samples.names()


def list_scenes(incomplete: str) -> list[str]:
    """List the names of samples, and the files and folders that begin with what was typed."""
    typed_path = Path(incomplete)
    folder = typed_path if incomplete.endswith("/") else typed_path.parent
    file_names = []
    if folder.is_dir():
        prefix = incomplete[: incomplete.rfind("/") + 1]
        for path in sorted(folder.iterdir()):
            file_names.append(f"{prefix}{path.name}{'/' if path.is_dir() else ''}")
    return samples.names() + file_names


def list_levels(ctx: Context) -> list[str]:
    """List the numbers of the levels of the command's grid, then the names that levels were given.

    Names that only repeat the number, such as ``level 0``, are left out.
    """
    grid = _read_grid(ctx)
    if grid is None:
        return []
    names = enumerate(grid.level_names)
    given_names = [name for number, name in names if name != f"level {number}"]
    return [*map(str, range(len(grid.levels))), *given_names]


def list_door_states(ctx: Context) -> list[str]:
    """List the states of all doors, and of each door of the command's grid as NAME=STATE."""
    from navbake.navgrid.rooms import DOOR_STATES  # loads numpy

    grid = _read_grid(ctx)
    doors = () if grid is None else grid.doors
    return [*DOOR_STATES, *(f"{door.id}={state}" for door in doors for state in door.states)]


def list_rooms(ctx: Context) -> list[str]:
    """List the ids and names of the rooms of the command's grid."""
    grid = _read_grid(ctx)
    if grid is None:
        return []
    from navbake.navgrid.names import list_room_names  # loads numpy

    return list_room_names(grid)


def list_objects(ctx: Context) -> list[str]:
    """List the names of the objects of the command's grid."""
    grid = _read_grid(ctx)
    if grid is None:
        return []
    from navbake.navgrid.names import list_object_names  # loads numpy

    return list_object_names(grid)


def list_agents(ctx: Context) -> list[str]:
    """List the names of the agents of the command's grid."""
    grid = _read_grid(ctx)
    return [] if grid is None else list(grid.agents)


def list_links(ctx: Context) -> list[str]:
    """List the names of the links of the command's grid."""
    grid = _read_grid(ctx)
    return [] if grid is None else [link.name for link in grid.links]


def list_starts(ctx: Context) -> list[str]:
    """List the rooms of the command's grid as places, such as ``room:kitchen``."""
    return [f"room:{name}" for name in list_rooms(ctx)]


def list_goals(ctx: Context) -> list[str]:
    """List the rooms and objects of the command's grid as places, such as ``object:sofa``."""
    return list_starts(ctx) + [f"object:{name}" for name in list_objects(ctx)]


def _read_grid(ctx: Context) -> NavGrid | None:
    """Read the grid that was typed before; None if there is none that can be read quickly."""
    # behind an option without its value, which is to be completed, arguments are not parsed
    typed_values = [ctx.params.get("grid"), ctx.params.get("source"), *ctx.args]
    typed_values += ctx.params.get("grids") or ()
    grid_files = [value for value in typed_values if value is not None and os.path.isfile(value)]
    if not grid_files or os.path.getsize(grid_files[0]) > MAX_GRID_BYTES:
        return None
    try:
        return navbake.load(grid_files[0])
    except NavbakeError:
        return None
