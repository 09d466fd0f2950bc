"""The table of formats that grids are converted from and to, and the choice by name or ending.

The table names functions as ``module:function``, which are imported on use, so that the command
line lists formats without loading them. A writer, ``(grid, path, **options)``, returns the contents
of files by path, in the order of writing; a reader, ``(path, **options)``, returns a grid.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from navbake.errors import FormatError
from navbake.formats.source import check_path, write_files
from navbake.lazy import resolve

if TYPE_CHECKING:
    from navbake.formats.source import Files
    from navbake.navgrid.grid import NavGrid


OCTREE_SUFFIXES = (".bt", ".ot")
"""Endings of OctoMap's files, whose voxels lie on whole multiples of their edge."""
VOXEL_SUFFIXES = (".binvox", *OCTREE_SUFFIXES, ".npz")
"""Endings of voxel files; see `navbake.formats.voxels`."""


class FileFormat(NamedTuple):
    """A format of files that hold a grid or parts of one."""

    name: str  #: As in ``--to`` and ``--from``.
    endings: tuple[str, ...]  #: Of its files' names, the usual one first; the longest match wins.
    meaning: str  #: A description in one line.
    encode: str | None  #: The writer, None if it is only read.
    read: str | None = None  #: The reader, None if it is only written.
    write_options: tuple[str, ...] = ()  #: Names of the options of writing.
    #: The function that lists further files of the reader, None for a single file.
    parts: str | None = None
    read_options: tuple[str, ...] = ()  #: Names of the reader's options.
    #: Whether `encode_as` inflates the grid for the option ``radius``, instead of the writer.
    inflates: bool = False


GRID_FORMATS = (
    FileFormat("navgrid", (".json", ".json.gz"), "NavGrid of sstk and MINOS: all that a grid holds",
               "navgrid:encode_files", "navgrid:read_navgrid"),
    FileFormat("npz", (".npz",), "NumPy archive: all that a grid holds, arrays as they are",
               "npz:encode_grid_npz", "npz:read_grid_npz"),
    FileFormat("nav2", (".yaml", ".yml"),
               "map of ROS and nav2: a YAML and an image for each level, or a costmap",
               "nav2:encode_nav2", "nav2:read_nav2",
               ("level", "radius", "mode", "image", "inflation", "scaling"), "nav2:list_images",
               ("rules",)),
    FileFormat("nav2-keepout", (".yaml", ".yml"),
               "mask of nav2's keepout filter: areas, rooms and polygons that robots stay out of",
               "nav2_masks:encode_keepout", "nav2_masks:read_keepout",
               ("level", "image", "zone", "zones", "agent"), "nav2:list_images"),
    FileFormat("nav2-speed", (".yaml", ".yml"),
               "mask of nav2's speed filter: limits in areas, rooms and polygons, NAME=PERCENT each",
               "nav2_masks:encode_speed", "nav2_masks:read_speed",
               ("level", "image", "zone", "zones", "agent", "absolute"), "nav2:list_images"),
    FileFormat("procthor", (".png",),
               "ProcTHORMap of MolmoSpaces: free cells and rooms of each level",
               "procthor:encode_procthor", "procthor:read_procthor", ("level", "radius"),
               inflates=True),
    FileFormat("omnigibson", (".png",),
               "OmniGibson: floor_trav_N.png of each level, with room maps of level 0",
               "omnigibson:encode_omnigibson", "omnigibson:read_omnigibson",
               ("level", "radius", "categories"), "omnigibson:list_room_maps", inflates=True),
    FileFormat("grscenes", (".npy",), "occupancy.npy of GRScenes: free, obstacle or undefined",
               "grscenes:encode_grscenes", "grscenes:read_grscenes", ("level", "radius"),
               inflates=True),
    FileFormat("mcap", (".mcap",),
               "messages of ROS 2 for Foxglove and rerun: a map of each level, paths, links",
               "mcap:encode_mcap", None, ("level", "radius", "route"), inflates=True),
    FileFormat("mjcf", (".xml",),
               "MuJoCo scene of walls and floors, and the settings that bake it to these cells",
               "extrude:encode_mjcf", None, ("level", "height", "flat")),
    FileFormat("rmf-building", (".building.yaml",),
               "building of Open-RMF's traffic editor: floors, walls, doors, lifts, lanes",
               "rmf_building:encode_building"),
    FileFormat("glb", (".glb",), "walkable floor as a mesh, glTF 2.0, for Blender, Unity, Unreal",
               "floor_mesh:encode_glb", None, ("tolerance",)),
    FileFormat("obj", (".obj",),
               "walkable floor as a mesh, Wavefront OBJ, for Recast and any other",
               "floor_mesh:encode_obj", None, ("tolerance", "up")),
    FileFormat("geojson", (".geojson",), "rooms, walkable areas and doors as polygons and lines",
               "shapes:encode_geojson"),
    FileFormat("wkt", (".wkt", ".csv"), "the same as a table with WKT, for GDAL, QGIS, PostGIS",
               "shapes:encode_wkt"),
    FileFormat("graphml", (".graphml",),
               "rooms and the ways between them as a graph, for networkx, Gephi, yEd",
               "graphs:encode_graphml"),
    FileFormat("graph", (".graph.npz",),
               "free cells and the steps between them as a sparse matrix, for scipy",
               "graphs:encode_cell_graph", None, ("cut_corners",)),
)  # fmt: skip
"""Formats of grids; of formats with an ending in common, the first is its."""

ROUTE_FORMATS = (
    FileFormat("nav2-route", (".geojson",), "nav2's Route Server",
               "route_files:encode_nav2_route", "route_files:read_nav2_route"),
    FileFormat("lif", (".json", ".lif"), "Layout Interchange Format of the VDMA",
               "route_files:encode_lif", "route_files:read_lif"),
    FileFormat("rmf", (".yaml", ".yml"), "navigation graph of Open-RMF",
               "route_files:encode_rmf", "route_files:read_rmf"),
    FileFormat("graphml", (".graphml",), "networkx, Gephi, yEd",
               "route_files:encode_graphml", "route_files:read_graphml"),
)  # fmt: skip
"""Formats of graphs of routes."""


def find_format(
    path: str | os.PathLike[str],
    name: str | None = None,
    *,
    writing: bool,
    formats: tuple[FileFormat, ...] = GRID_FORMATS,
) -> FileFormat:
    """Find the format of a file, by its name in a table or else by the file's ending.

    `writing` selects among written formats, else among read ones. Raises a FormatError.
    """
    known = [form for form in formats if (form.encode if writing else form.read) is not None]
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
    is_image = formats is GRID_FORMATS and file.endswith(".pgm")
    hint = ": give the .yaml of the map, which names the image" if is_image else ""
    raise FormatError(
        f"expected a name that ends as a format that is {done} does, {listed}; got "
        f"{os.fsdecode(path)}{hint}"
    )


def read_as(path: str | os.PathLike[str], name: str | None = None, **options: Any) -> NavGrid:
    """Read a grid in any format that is read, given by name or else by the file's ending.

    `options` are those of the format's reader, see `GRID_FORMATS`.
    """
    form = find_format(path, name, writing=False)
    grid: NavGrid = resolve(f"navbake.formats.{form.read}")(path, **options)
    return grid


def list_files(path: Path, form: FileFormat) -> list[Path]:
    """The files that a format's reader reads; raises as it does."""
    return [path, *(resolve(f"navbake.formats.{form.parts}")(path) if form.parts else ())]


def encode_as(
    grid: NavGrid, path: str | os.PathLike[str], name: str | None = None, **options: Any
) -> Files:
    """Encode the files of a grid in any format that is written, without writing them.

    `name` is the format's, by default that of the path's ending; `options` are those that
    `GRID_FORMATS` lists for it. Where the format `inflates`, the grid is inflated for a robot of `radius` first
    [m]. Raises a FormatError for an unknown format, or a grid that it can't hold.
    """
    form = find_format(path, name, writing=True)
    for option in options:
        if option not in form.write_options:
            takes = ", ".join(form.write_options) or "none"
            raise FormatError(f"{form.name} takes no option {option!r}, it takes: {takes}")
    radius = options.pop("radius", None) if form.inflates else None
    grid = grid if radius is None else grid.inflate(radius)
    made: Files = resolve(f"navbake.formats.{form.encode}")(grid, Path(path), **options)
    return made


def write_as(
    grid: NavGrid, path: str | os.PathLike[str], to: str | None = None, **options: Any
) -> list[Path]:
    """Write a grid in any format that is written, all its files or none; see `encode_as`.

    Returns the paths of the written files.
    """
    return write_files(encode_as(grid, check_path(path), to, **options))


def select_levels(
    grid: NavGrid, path: Path, level: int | None, endings: tuple[str, ...]
) -> list[int]:
    """All levels' numbers, or the given one alone; raises a FormatError."""
    if path.suffix.lower() not in endings:
        raise FormatError(f"expected a name that ends in {' or '.join(endings)}, got {path}")
    if level is None:
        return list(range(len(grid.levels)))
    check_level(grid, level)
    return [level]


def check_level(grid: NavGrid, level: int) -> None:
    """Raise a FormatError for a level that the grid lacks."""
    if not 0 <= level < len(grid.levels):
        raise FormatError(f"no level {level}: the grid has {len(grid.levels)}, counted from 0")


def list_level_paths(
    grid: NavGrid, path: Path, level: int | None, endings: tuple[str, ...]
) -> dict[int, Path]:
    """The path of each level's map, by the level's number; raises as `select_levels` does.

    A single level has the path itself, several ones a number after the stem: ``map_0.yaml``.
    """
    chosen = select_levels(grid, path, level, endings)
    if len(chosen) == 1:
        return {chosen[0]: path}
    return {k: path.with_name(f"{path.stem}_{k}{path.suffix}") for k in chosen}
