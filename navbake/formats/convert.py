"""The formats that grids are converted from and to: one table, and the choice from it by ending.

The table names functions as ``module:function``, and they are imported when a file is converted:
so the command line lists all formats without loading any. A writer is a function
``(grid, path, **options)`` that gives the files to be written, path by path, in the order in which
they are to appear; a reader is a function ``(path, **options)`` that gives a grid.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from navbake.errors import FormatError
from navbake.formats.source import check_path, write_files
from navbake.navgrid.operations import resolve

if TYPE_CHECKING:
    from navbake.formats.source import Files
    from navbake.navgrid.grid import NavGrid


OCTREES = (".bt", ".ot")
"""Endings of OctoMap's files, whose voxels lie on whole multiples of their edge."""
VOXELS = (".binvox", *OCTREES, ".npz")
"""Endings of voxel files; see `navbake.formats.voxels`."""


class Format(NamedTuple):
    """A format of files that hold a grid, or what can be said of one.

    Attributes:
        name: how ``--to`` and ``--from`` call it.
        endings: of its files' names, the first is the usual one. An ending may have several dots;
            the longest that fits a name decides, then the first in the table.
        meaning: what it is, in one line.
        encode: the function that makes the files, None where it is only read.
        read: the function that reads one, None where it is only written.
        parts: the function that lists further files which `read` reads, None where it reads one.
        write_options, read_options: names of the options that these functions take.
    """

    name: str
    endings: tuple[str, ...]
    meaning: str
    encode: str | None
    read: str | None = None
    write_options: tuple[str, ...] = ()
    read_options: tuple[str, ...] = ()
    parts: str | None = None


FORMATS = (
    Format(
        name="navgrid",
        endings=(".json", ".json.gz"),
        meaning="NavGrid of sstk and MINOS: all that a grid holds",
        encode="navbake.formats.navgrid:encode_files",
        read="navbake.formats.navgrid:read_navgrid",
    ),
    Format(
        name="npz",
        endings=(".npz",),
        meaning="NumPy archive: all that a grid holds, arrays as they are",
        encode="navbake.formats.npz:encode_grid_npz",
        read="navbake.formats.npz:read_grid_npz",
    ),
    Format(
        name="nav2",
        endings=(".yaml", ".yml"),
        meaning="map of ROS and nav2: a YAML and an image for each level, or a costmap",
        encode="navbake.formats.nav2:encode_nav2",
        read="navbake.formats.nav2:read_nav2",
        write_options=("level", "radius", "mode", "image", "inflation", "scaling"),
        parts="navbake.formats.nav2:list_images",
    ),
    Format(
        name="nav2-keepout",
        endings=(".yaml", ".yml"),
        meaning="mask of nav2's keepout filter: rooms and polygons that robots stay out of",
        encode="navbake.formats.nav2:encode_keepout",
        write_options=("level", "image", "zone", "zones"),
    ),
    Format(
        name="nav2-speed",
        endings=(".yaml", ".yml"),
        meaning="mask of nav2's speed filter: limits in rooms and polygons, NAME=PERCENT each",
        encode="navbake.formats.nav2:encode_speed",
        write_options=("level", "image", "zone", "zones"),
    ),
    Format(
        name="procthor",
        endings=(".png",),
        meaning="ProcTHORMap of MolmoSpaces: free cells and rooms of each level",
        encode="navbake.formats.procthor:encode_procthor",
        read="navbake.formats.procthor:read_procthor",
        write_options=("level", "radius"),
    ),
    Format(
        name="mjcf",
        endings=(".xml",),
        meaning="MuJoCo scene of walls and floors, and the settings that bake it to these cells",
        encode="navbake.formats.extrude:encode_mjcf",
        write_options=("level", "height", "flat"),
    ),
    Format(
        name="glb",
        endings=(".glb",),
        meaning="walkable floor as a mesh, glTF 2.0, for Blender, Unity, Unreal",
        encode="navbake.formats.mesh_files:encode_glb",
        write_options=("tolerance",),
    ),
    Format(
        name="obj",
        endings=(".obj",),
        meaning="walkable floor as a mesh, Wavefront OBJ, for Recast and any other",
        encode="navbake.formats.mesh_files:encode_obj",
        write_options=("tolerance", "up"),
    ),
    Format(
        name="geojson",
        endings=(".geojson",),
        meaning="rooms, walkable areas and doors as polygons and lines",
        encode="navbake.formats.geojson:encode_geojson",
    ),
    Format(
        name="wkt",
        endings=(".wkt", ".csv"),
        meaning="the same as a table with WKT, for GDAL, QGIS, PostGIS",
        encode="navbake.formats.geojson:encode_wkt",
    ),
    Format(
        name="graphml",
        endings=(".graphml",),
        meaning="rooms and the ways between them as a graph, for networkx, Gephi, yEd",
        encode="navbake.formats.room_graph:encode_graphml",
    ),
    Format(
        name="graph",
        endings=(".graph.npz",),
        meaning="free cells and the steps between them as a sparse matrix, for scipy",
        encode="navbake.formats.cell_graph:encode_cell_graph",
        write_options=("cut_corners",),
    ),
)
"""All formats; of formats with an ending in common, the first is its."""


def find_format(path: str | os.PathLike[str], name: str | None = None, *, writing: bool) -> Format:
    """Find the format of a file, by its name in the table or else by the file's ending.

    Args:
        name: as the table has it, or None for what the ending says.
        writing: whether the file is to be written; else it is to be read.

    Raises:
        FormatError: no format has this name or ending, or it is not written, or not read.
    """
    known = [form for form in FORMATS if (form.encode if writing else form.read) is not None]
    done = "written" if writing else "read"
    if name is not None:
        for form in known:
            if form.name == name:
                return form
        names = ", ".join(form.name for form in known)
        raise FormatError(f"expected a format that is {done} ({names}), got {name}")
    file = os.path.basename(os.fsdecode(path)).lower()
    fitting = [(ending, form) for form in known for ending in form.endings if file.endswith(ending)]
    if fitting:
        return max(fitting, key=lambda pair: len(pair[0]))[1]  # the first of equally long ones
    listed = ", ".join(f"{'/'.join(form.endings)} ({form.name})" for form in known)
    raise FormatError(
        f"expected a name that ends as a format that is {done} does, {listed}; got "
        f"{os.fsdecode(path)}"
    )


def read_as(path: str | os.PathLike[str], name: str | None = None, **options: Any) -> NavGrid:
    """Read a grid from a file of any format that is read.

    Args:
        name: of the format; by the file's ending if None.
        options: what the format's reader takes, see `FORMATS`.

    Raises:
        FormatError: there is no such format, or the file is broken.
    """
    form = find_format(path, name, writing=False)
    _check_options(form, form.read_options, options)
    grid: NavGrid = resolve(str(form.read))(path, **options)
    return grid


def list_files(path: Path, form: Format) -> list[Path]:
    """The files that the reader of a format reads; raises as it does."""
    return [path, *(resolve(form.parts)(path) if form.parts is not None else ())]


def encode_as(
    grid: NavGrid, path: str | os.PathLike[str], name: str | None = None, **options: Any
) -> Files:
    """Make the files of a grid in any format that is written; nothing is written yet.

    Args:
        path: of the file that names the others, if there are several.
        name: of the format; by the file's ending if None.
        options: what the format's writer takes, see `FORMATS`.

    Raises:
        FormatError: there is no such format, or it can't hold the grid.
    """
    form = find_format(path, name, writing=True)
    _check_options(form, form.write_options, options)
    made: Files = resolve(str(form.encode))(grid, Path(path), **options)
    return made


def write_as(
    grid: NavGrid, path: str | os.PathLike[str], to: str | None = None, **options: Any
) -> list[Path]:
    """Write a grid in any format that is written, all its files or none; see `encode_as`.

    Returns:
        The files that were written.
    """
    return write_files(encode_as(grid, check_path(path), to, **options))


def _check_options(form: Format, known: tuple[str, ...], options: Mapping[str, Any]) -> None:
    for option in options:
        if option not in known:
            takes = ", ".join(known) or "none"
            raise FormatError(f"{form.name} takes no option {option!r}, it takes: {takes}")
