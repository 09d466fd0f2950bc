"""The file formats of grids and of graphs of routes, and the choice of one for a file.

Readers and writers stand in the table as text, ``module:function`` below `navbake.formats`. So the
table imports none of them; a module that reads or writes files can look up formats here, and the
command line lists formats without loading them. `navbake.formats.convert` calls the readers and
writers of grids, `navbake.formats.route_files` those of graphs of routes. A writer of grids is
called as ``(grid, path, **options)`` and returns path -> content of the files, in the order of
writing. A reader of grids is called as ``(path, **options)`` and returns a grid.
"""

from __future__ import annotations

import os
from typing import NamedTuple

from navbake.errors import FormatError

OCTREE_SUFFIXES = (".bt", ".ot")
"""Endings of OctoMap's files, whose voxels lie on whole multiples of their edge."""
VOXEL_SUFFIXES = (".binvox", *OCTREE_SUFFIXES, ".npz")
"""Endings of voxel files; see `navbake.formats.voxels`."""


class FileFormat(NamedTuple):
    """A format of files that hold a grid, parts of one, or a graph of routes.

    Attributes:
        name: the format's name, which ``--to`` and ``--from`` take.
        endings: endings of its files' names, the usual one first. A file whose name fits several
            endings has the format of the longest.
        meaning: a description in one line.
        encode: the writer as ``module:function``, None if the format is only read.
        read: the reader as ``module:function``, None if the format is only written.
        write_options: names of the writer's options.
        read_options: names of the reader's options.
        list_parts: the function that lists the files that the reader reads besides the one it is
            given, as ``module:function``; None for a format of single files.
        inflates: whether `convert.encode_as` inflates the grid for the option ``radius``, so that
            the writer need not.
        loses: the kinds of content that the format can't hold: some of ``heights`` (of the floor),
            ``steps`` (between levels), ``areas``, ``links``, ``agents`` and ``doors``. If a grid
            has such content, a warning says so.
        closes: which free cells are written as occupied, to keep robots out where the format can't
            say why: ``stairs`` (see `navbake.formats.map_losses.find_stair_cells`) and ``areas``
            that bar the agent.
        marks_closed_cells: True if the writer marks the cells of `closes` itself, by an option
            `closed_cell_masks`. If False, `convert.encode_with` makes them occupied in the grid
            that it passes to the writer.
        reports_progress: whether the writer takes a function `progress`, which it calls with a name
            and the fraction that is done, 0 to 1.
    """

    name: str
    endings: tuple[str, ...]
    meaning: str
    encode: str | None
    read: str | None = None
    write_options: tuple[str, ...] = ()
    read_options: tuple[str, ...] = ()
    list_parts: str | None = None
    inflates: bool = False
    loses: tuple[str, ...] = ()
    closes: tuple[str, ...] = ()
    marks_closed_cells: bool = False
    reports_progress: bool = False


ALL_LOSSES = ("heights", "steps", "areas", "links", "agents", "doors")

GRID_FORMATS = (
    FileFormat(
        name="navgrid",
        endings=(".json", ".json.gz"),
        meaning="NavGrid of sstk and MINOS: all that a grid holds",
        encode="navgrid:encode_files",
        read="navgrid:read_navgrid",
    ),
    FileFormat(
        name="npz",
        endings=(".npz",),
        meaning="NumPy archive: all that a grid holds, arrays as they are",
        encode="npz:encode_grid_npz",
        read="npz:read_grid_npz",
    ),
    FileFormat(
        name="nav2",
        endings=(".yaml", ".yml"),
        meaning="map of ROS and nav2: a YAML and an image for each level, or a costmap",
        encode="nav2:encode_nav2",
        read="nav2:read_nav2",
        write_options=(
            "level",
            "radius",
            "mode",
            "image",
            "inflation",
            "scaling",
            "stairs",
            "agent",
        ),
        read_options=("rules",),
        list_parts="nav2:list_images",
        loses=ALL_LOSSES,
        closes=("stairs", "areas"),
        marks_closed_cells=True,
    ),
    FileFormat(
        name="nav2-keepout",
        endings=(".yaml", ".yml"),
        meaning="mask of nav2's keepout filter: areas, rooms and polygons that robots stay out of",
        encode="nav2_masks:encode_keepout",
        read="nav2_masks:read_keepout",
        write_options=("level", "image", "zone", "zones", "agent"),
        list_parts="nav2:list_images",
    ),
    FileFormat(
        name="nav2-speed",
        endings=(".yaml", ".yml"),
        meaning=(
            "mask of nav2's speed filter: limits in areas, rooms and polygons, NAME=PERCENT each"
        ),
        encode="nav2_masks:encode_speed",
        read="nav2_masks:read_speed",
        write_options=("level", "image", "zone", "zones", "agent", "absolute"),
        list_parts="nav2:list_images",
    ),
    FileFormat(
        name="procthor",
        endings=(".png",),
        meaning="ProcTHORMap of MolmoSpaces: free cells and rooms of each level",
        encode="procthor:encode_procthor",
        read="procthor:read_procthor",
        write_options=("level", "radius", "stairs", "agent"),
        inflates=True,
        loses=ALL_LOSSES,
        closes=("stairs", "areas"),
    ),
    FileFormat(
        name="omnigibson",
        endings=(".png",),
        meaning="OmniGibson: floor_trav_N.png of each level, with room maps of level 0",
        encode="omnigibson:encode_omnigibson",
        read="omnigibson:read_omnigibson",
        write_options=("level", "radius", "categories", "stairs", "agent"),
        list_parts="omnigibson:list_room_maps",
        inflates=True,
        loses=ALL_LOSSES,
        closes=("stairs", "areas"),
    ),
    FileFormat(
        name="grscenes",
        endings=(".npy",),
        meaning="occupancy.npy of GRScenes: free, obstacle or undefined",
        encode="grscenes:encode_grscenes",
        read="grscenes:read_grscenes",
        write_options=("level", "radius", "stairs", "agent"),
        inflates=True,
        loses=ALL_LOSSES,
        closes=("stairs", "areas"),
    ),
    FileFormat(
        name="octomap",
        endings=OCTREE_SUFFIXES,
        meaning="octree of OctoMap: the floor plan between two heights",
        encode=None,
        read="voxel_plans:read_voxel_plan",
        read_options=("height", "unknown"),
    ),
    FileFormat(
        name="binvox",
        endings=(".binvox",),
        meaning="voxels of binvox: the floor plan between two heights",
        encode=None,
        read="voxel_plans:read_voxel_plan",
        read_options=("height", "unknown"),
    ),
    FileFormat(
        name="mcap",
        endings=(".mcap",),
        meaning="messages of ROS 2 for Foxglove and rerun: a map of each level, paths, links",
        encode="mcap:encode_mcap",
        write_options=("level", "radius", "route", "agent"),
        inflates=True,
        loses=("heights", "areas", "agents", "doors"),
        closes=("areas",),
    ),
    FileFormat(
        name="mjcf",
        endings=(".xml",),
        meaning="MuJoCo scene of walls and floors, and the settings that bake it to these cells",
        encode="extrude:encode_mjcf",
        write_options=("level", "height", "flat"),
        loses=("areas", "links", "agents", "doors"),
    ),
    FileFormat(
        name="rmf-building",
        endings=(".building.yaml",),
        meaning="building of Open-RMF's traffic editor: floors, walls, doors, lifts, lanes",
        encode="rmf_building:encode_building",
        reports_progress=True,
    ),
    FileFormat(
        name="glb",
        endings=(".glb",),
        meaning="walkable floor as a mesh, glTF 2.0, for Blender, Unity, Unreal",
        encode="floor_mesh:encode_glb",
        write_options=("tolerance", "agent"),
        loses=("steps", "areas", "links", "agents", "doors"),
        closes=("areas",),
    ),
    FileFormat(
        name="obj",
        endings=(".obj",),
        meaning="walkable floor as a mesh, Wavefront OBJ, for Recast and any other",
        encode="floor_mesh:encode_obj",
        write_options=("tolerance", "up", "agent"),
        loses=("steps", "areas", "links", "agents", "doors"),
        closes=("areas",),
    ),
    FileFormat(
        name="geojson",
        endings=(".geojson",),
        meaning="rooms, walkable areas and doors as polygons and lines",
        encode="shapes:encode_geojson",
        loses=("steps", "areas", "links", "agents"),
    ),
    FileFormat(
        name="wkt",
        endings=(".wkt", ".csv"),
        meaning="the same as a table with WKT, for GDAL, QGIS, PostGIS",
        encode="shapes:encode_wkt",
        loses=("steps", "areas", "links", "agents"),
    ),
    FileFormat(
        name="graphml",
        endings=(".graphml",),
        meaning="rooms and the ways between them as a graph, for networkx, Gephi, yEd",
        encode="graphs:encode_graphml",
        loses=("agents", "doors"),
    ),
    FileFormat(
        name="gml",
        endings=(".gml",),
        meaning="the same in GraphML's older sibling",
        encode="graphs:encode_gml",
        loses=("agents", "doors"),
    ),
    FileFormat(
        name="graph",
        endings=(".graph.npz",),
        meaning="free cells and the steps between them as a sparse matrix, for scipy",
        encode="graphs:encode_cell_graph",
        write_options=("cut_corners",),
        loses=("agents", "doors"),
    ),
)
"""Formats of grids. If several formats share an ending, a file with it has the first of them."""

ROUTE_FORMATS = (
    FileFormat(
        name="nav2-route",
        endings=(".geojson",),
        meaning="nav2's Route Server",
        encode="route_files:encode_nav2_route",
        read="route_files:read_nav2_route",
        closes=("stairs",),  # as the maps that nav2 drives on
    ),
    FileFormat(
        name="lif",
        endings=(".json", ".lif"),
        meaning="Layout Interchange Format of the VDMA",
        encode="route_files:encode_lif",
        read="route_files:read_lif",
    ),
    FileFormat(
        name="rmf",
        endings=(".yaml", ".yml"),
        meaning="navigation graph of Open-RMF",
        encode="route_files:encode_rmf",
        read="route_files:read_rmf",
    ),
    FileFormat(
        name="graphml",
        endings=(".graphml",),
        meaning="networkx, Gephi, yEd",
        encode="route_files:encode_graphml",
        read="route_files:read_graphml",
    ),
    FileFormat(
        name="gml",
        endings=(".gml",),
        meaning="networkx, Gephi, yEd, in GraphML's older sibling",
        encode="route_files:encode_gml",
        read="route_files:read_gml",
    ),
)
"""Formats of graphs of routes."""


def find_format(
    path: str | os.PathLike[str],
    name: str | None = None,
    *,
    writing: bool,
    formats: tuple[FileFormat, ...] = GRID_FORMATS,
) -> FileFormat:
    """Find the format of a file, by the format's name or else by the file's ending.

    Args:
        path: the file; it need not exist.
        name: the name of the format, None to go by the ending.
        writing: True to choose among formats that can be written, False among those that can be
            read.
        formats: the table to choose from.

    Returns:
        The format. Of several with the same ending, the first in the table.

    Raises:
        FormatError: no such format can be written (or read), or no format has such an ending.
    """
    usable_formats = [
        file_format
        for file_format in formats
        if (file_format.encode if writing else file_format.read) is not None
    ]
    verb_text = "written" if writing else "read"
    if writing:
        _refuse_voxels(os.fsdecode(path), name)
    if name is not None:
        for file_format in usable_formats:
            if file_format.name == name:
                return file_format
        names_text = ", ".join(file_format.name for file_format in usable_formats)
        expected = f"a format that is {verb_text} ({names_text})"
        raise FormatError(f"expected {expected}, got {name}", value=name, expected=expected)

    file_name = os.path.basename(os.fsdecode(path)).lower()
    ending_format_pairs = [
        (ending, file_format)
        for file_format in usable_formats
        for ending in file_format.endings
        if file_name.endswith(ending)
    ]
    if ending_format_pairs:
        # max returns the first of equally long endings
        _, best_format = max(ending_format_pairs, key=lambda pair: len(pair[0]))
        return best_format

    formats_text = ", ".join(
        f"{'/'.join(file_format.endings)} ({file_format.name})" for file_format in usable_formats
    )
    is_map_image = formats is GRID_FORMATS and file_name.endswith(".pgm")
    hint = "give the .yaml of the map, which names the image" if is_map_image else None
    message = (
        f"expected a name that ends as a format that is {verb_text} does, {formats_text}; got "
        f"{os.fsdecode(path)}"
    )
    raise FormatError(
        f"{message}: {hint}" if hint else message,
        path=os.fsdecode(path),
        expected=f"a name that ends as a format that is {verb_text} does",
        hint=hint,
    )


def _refuse_voxels(path: str, name: str | None) -> None:
    """Raise a FormatError if a file that is to be written is one of voxels.

    Args:
        path: the file.
        name: the name of its format; None to go by the ending.
    """
    for file_format in GRID_FORMATS:
        if file_format.encode is None and (
            file_format.name == name
            or (name is None and path.lower().endswith(file_format.endings))
        ):
            output = f"FILE{file_format.endings[0]}" if path == "-" else path
            hint = f"`navbake voxelize SCENE -o {output}`"
            raise FormatError(
                f"{file_format.name} is a format of voxels, which are made of scenes, not of "
                f"grids: {hint}",
                path=path,
                value=file_format.name,
                hint=hint,
            )
