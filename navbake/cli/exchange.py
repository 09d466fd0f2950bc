"""The commands that convert a grid: `convert`, `inflate`, `routes`, `map-descriptor`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Option

import navbake
from navbake.cli import completion, options
from navbake.cli.episodes import SET_FORMATS, convert_episode_set
from navbake.cli.options import (
    GRID_SUFFIXES,
    LEVEL_OPTION,
    OUTPUT_FLAGS,
    STDOUT,
    DoorStates,
    GridFile,
    argument,
    option,
)
from navbake.cli.printing import (
    VERBOSITY,
    add_facts,
    add_files,
    print_warnings,
    say,
    say_unless_quiet,
    show_progress_bars,
    warn_of_closed_connections,
)
from navbake.errors import ConfigError, FormatError, QueryError
from navbake.formats.convert import encode_with, list_files, read_with
from navbake.formats.format_table import GRID_FORMATS, ROUTE_FORMATS, FileFormat, find_format
from navbake.formats.scene_files import (
    BUILDING_SUFFIXES,
    SDF_SUFFIXES,
    STAGE_SUFFIXES,
    XML_SUFFIXES,
    scene_suffix,
)
from navbake.formats.source import write_files

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.paths import Path as Route

# endings of sets of episodes that no grid has
EPISODE_ONLY_SUFFIXES = (".jsonl", ".jsonl.gz", ".parquet", ".csv.bz2")
ROUTE_ONLY_SUFFIXES = (".graphml", ".gml", ".lif")  # of files that are read; no grid has these
ROUTE_FORMAT_NAMES = tuple(form.name for form in ROUTE_FORMATS)

SCENE_SUFFIXES = XML_SUFFIXES | SDF_SUFFIXES | BUILDING_SUFFIXES | STAGE_SUFFIXES | {".mjb"}
"""Endings of scenes, which no format of grids that can be read has."""

# Functions import what reads grids only when they run, so that --help stays quick.


def convert(
    source: Annotated[Path, Argument(metavar="IN", help="The file to read.")],
    output: Annotated[Path, Argument(metavar="OUT", help="File to write, - for stdout; not IN.")],
    level: str | None = LEVEL_OPTION,
    doors: DoorStates = None,
    radius: float | None = option("METRES", "Inflate for an agent of this radius first [m]."),
    mode: str | None = option("trinary|scale|raw", "trinary, or with costs.  [default: trinary]"),
    image: str | None = option("pgm|png", "pgm or png.  [default: pgm; png with --mode scale]"),
    rules: str | None = option(
        "humble|main", "Rules of nav2 for the pixels of a map that is read.  [default: humble]"
    ),
    inflation: float | None = option("METRES", "Costs as nav2's, up to so far from obstacles [m]."),
    zone: list[str] | None = option(
        "NAME[=PERCENT]", "Room or polygon of a mask. May be repeated."
    ),
    zones: Path | None = option("GEOJSON", "Polygons of a mask; all unless --zone names some."),
    stairs: str | None = option(
        "occupied|free",
        "Stairs, and floors beyond them, in a map without heights: what no smooth floor or ramp "
        "joins to the level's ground.  [default: occupied]",
    ),
    agent: str | None = option(
        "NAME",
        "Agent whose barred areas a map or mask marks.  [default: any]",
        completion=completion.list_agents,
    ),
    absolute: bool | None = Option(None, "--absolute", help="Limits of areas in m/s, not percent."),
    height: str | None = option(
        "METRES|LOW:HIGH",
        "How far walls of a scene rise over floors [m].  [default: 2.5]  Of voxels that are read: "
        "the heights that must be free, world z [m].",
    ),
    unknown: str | None = option(
        "free|occupied|unknown", "Columns of voxels of which nothing is known.  [default: unknown]"
    ),
    flat: bool | None = Option(None, "--flat", help="Lay the floors of a level at its ground."),
    scaling: float | None = option("FACTOR", "cost_scaling_factor of nav2 [1/m].  [default: 10]"),
    categories: Path | None = option(
        "TXT", "OmniGibson's room_categories.txt.  [default: one of these rooms, written beside]"
    ),
    route: list[str] | None = option(
        "'START GOAL'", "Path to plan and to write, as `navbake path` does. May be repeated."
    ),
    tolerance: float | None = option(
        "METRES", "How far a mesh may be off the floor [m].  [default: 0.001]", min=0
    ),
    up: str | None = option("y|z", "Upward axis of an OBJ.  [default: y]"),
    cut_corners: bool | None = Option(
        None, "--cut-corners", help="Let diagonal steps of a graph pass blocked corners."
    ),
    to: str | None = option(
        "FORMAT",
        "Format of OUT.  [default: by its ending]",
        "--to",
        completion=completion.list_written_formats,
    ),
    source_format: str | None = option(
        "FORMAT",
        "Format of IN.  [default: by its ending]",
        "--from",
        completion=completion.list_read_formats,
    ),
    scene: list[str] | None = option(
        "NAME=ID",
        "What the other program calls a scene, in a set of episodes; {id}=data/{id}.glb names all. "
        "May be repeated.",
    ),
) -> None:
    if output == STDOUT and to is None:
        raise BadParameter("expected a format: stdout has no ending", param_hint="--to")
    format_options = {
        "level": level,
        "doors": doors,
        "radius": radius,
        "mode": mode,
        "image": image,
        "rules": rules,
        "inflation": inflation,
        "zone": zone,
        "zones": zones,
        "stairs": stairs,
        "agent": agent,
        "absolute": absolute,
        "height": height,
        "unknown": unknown,
        "flat": flat,
        "scaling": scaling,
        "categories": categories,
        "route": route,
        "tolerance": tolerance,
        "up": up,
        "cut_corners": cut_corners,
    }
    given_options: dict[str, Any] = {
        key: value
        for key, value in format_options.items()
        if value not in (None, []) and value is not False
    }
    source_name = source.name.lower()
    output_name = output.name.lower()
    if (
        to in SET_FORMATS
        or source_name.endswith((".csv", *EPISODE_ONLY_SUFFIXES))
        or output_name.endswith(EPISODE_ONLY_SUFFIXES)
    ):
        _refuse_grid_options(given_options)
        convert_episode_set(source, output, to, options.read_pairs(scene, "--scene", "NAME=ID"))
        return
    options.refuse_unused("--scene", bool(scene), has_effect=False, purpose="sets of episodes")
    if source_format in ROUTE_FORMAT_NAMES or source_name.endswith(ROUTE_ONLY_SUFFIXES):
        _refuse_grid_options(given_options)
        _convert_routes(source, output, source_format, to)
        return
    reader = _find_format(source, source_format, ("--from", "IN"), writing=False)
    writer = _find_format(output, to, ("--to", "OUT"), writing=True)
    read_options = {
        key: given_options.pop(key) for key in reader.read_options if key in given_options
    }
    if "height" in read_options:
        read_options["height"] = _parse_heights(read_options["height"])
    given_options.pop("doors", None)
    for key in given_options:
        if key in writer.write_options:
            continue
        purposes = [f"{form.name} as OUT" for form in GRID_FORMATS if key in form.write_options]
        purposes += [f"{form.name} as IN" for form in GRID_FORMATS if key in form.read_options]
        options.refuse_unused(
            _option_name(key), True, has_effect=False, purpose=", ".join(purposes)
        )
    if "height" in given_options:
        given_options["height"] = _parse_wall_height(given_options["height"])
    inputs = [source, *(value for value in given_options.values() if isinstance(value, Path))]
    options.check_output(output, inputs=inputs)
    level_file = source.with_name(f"{source.stem}_0{source.suffix}") if source.name else source
    if not source.exists() and level_file.is_file():
        problem = f"cannot read {source}: No such file or directory"
        raise FormatError(f"{problem}, but {level_file} is there: each level has a file of its own")
    inputs += list_files(source, reader)
    grid = read_with(reader, source, **read_options)
    if level is not None:
        given_options["level"] = options.find_level(grid, level)
    grid = options.set_doors(grid, doors)
    if route:
        inflated_grid = grid if radius is None else grid.inflate(radius)
        given_options["route"] = [_plan_route(inflated_grid, text) for text in route]
    target_path = Path(f"stdout{writer.endings[0]}") if output == STDOUT else output
    with show_progress_bars(str(output), VERBOSITY.quiet) as progress:
        content_by_path = encode_with(writer, grid, target_path, progress, **given_options)
    add_facts(scene_id=grid.scene_id, input_format=reader.name, output_format=writer.name)
    if output == STDOUT:
        if len(content_by_path) > 1:
            raise BadParameter(f"{writer.name} is {len(content_by_path)} files", param_hint="OUT")
        (content,) = content_by_path.values()
        options.write_output(content, output)
        return
    for path in content_by_path:
        if path in inputs and path != output:
            problem = f"expected an output apart from the inputs, got {output}"
            raise ConfigError(f"{problem}, which comes with {path}: choose another name")
        options.check_output(path, inputs=inputs)
    for path in write_files(content_by_path):
        add_files(path)
        say_unless_quiet(path)


def _refuse_grid_options(given_options: Mapping[str, object]) -> None:
    """Refuse options that are given and that only conversions of grids have."""
    for key in given_options:
        options.refuse_unused(_option_name(key), True, has_effect=False, purpose="grids")


def _option_name(key: str) -> str:
    """Return the name of an option as it is typed: --cut-corners for cut_corners."""
    return f"--{key.replace('_', '-')}"


def _convert_routes(
    source: Path, output: Path, source_format: str | None, target_format: str | None
) -> None:
    """Convert a graph of routes from one format to another.

    Args:
        source: the file.
        output: the file to write, or `STDOUT`.
        source_format: the name of the source's format; None to go by its ending.
        target_format: the name of the format to write; None to go by the output's ending.
    """
    from navbake.formats.route_files import encode_routes, read_routes

    reader = _find_format(
        source, source_format, ("--from", "IN"), writing=False, formats=ROUTE_FORMATS
    )
    if output == STDOUT and target_format is None:
        raise BadParameter("expected a format: stdout has no ending", param_hint="--to")
    writer = _find_format(
        output, target_format, ("--to", "OUT"), writing=True, formats=ROUTE_FORMATS
    )
    options.check_output(output, inputs=[source])
    graph = read_routes(source, source_format)
    add_facts(scene_id=graph.scene_id, input_format=reader.name, output_format=writer.name)
    options.write_output(encode_routes(graph, output, target_format), output)
    if output != STDOUT:
        say_unless_quiet(output)


def _parse_heights(text: str) -> tuple[float, float]:
    """Parse the heights between which voxels count, ``LOW:HIGH`` [m]."""
    try:
        min_height, max_height = map(float, text.split(":"))
    except ValueError:
        message = f"expected LOW:HIGH of voxels, such as 0.1:1.2 [m], got {text!r}"
        raise BadParameter(message, param_hint="--height") from None
    return min_height, max_height


def _parse_wall_height(text: str) -> float:
    """Parse the height of a scene's walls [m]."""
    try:
        return float(text)
    except ValueError:
        message = f"expected the height of walls [m], got {text!r}"
        raise BadParameter(message, param_hint="--height") from None


def _plan_route(grid: NavGrid, text: str) -> Route:
    """Plan the path of a value of --route.

    Args:
        grid: the grid.
        text: the start (a place), a space, and the goal: a place, ``room:NAME`` or
            ``object:NAME``.

    Raises:
        QueryError: there is no path.
    """
    start_text, _, goal_text = text.partition(" ")
    start_position = options.position_of_place(
        grid, options.parse_place(start_text, "--route"), "--route"
    )
    goal_place: str | list[float] = goal_text.strip()
    if not str(goal_place).startswith(("room:", "object:")):
        typed_goal = options.parse_place(
            str(goal_place), "--route", lambda: grid, with_objects=True
        )
        goal_place = options.position_of_place(grid, typed_goal, "--route")
    finder = navbake.PathFinder(grid)
    path = finder.find_path(start_position, goal_place)
    if path is None:
        raise QueryError(
            f"no path for --route {text!r}: {finder.why_not(start_position, goal_place)}"
        )
    return path


convert.__doc__ = "\n\n".join(
    (
        "Convert a grid from one format to another.",
        "Example: navbake convert house.grid.json map.yaml",
        "Formats:",
        *(
            f"{form.name} ({', '.join(form.endings)}; "
            f"{', '.join(filter(None, (form.read and 'in', form.encode and 'out')))}): "
            f"{form.meaning}."
            for form in GRID_FORMATS
        ),
        f"Graphs of routes ({', '.join(ROUTE_FORMAT_NAMES)}): those that end in "
        f"{', '.join(ROUTE_ONLY_SUFFIXES)}, or that --from names.",
        f"Sets of episodes (.jsonl, .parquet, .json.gz, .csv.bz2; {', '.join(SET_FORMATS)}): IN is "
        "read by its ending and content.",
    )
)


def _find_format(
    path: Path, name: str | None, param_hints: tuple[str, str], **search_options: Any
) -> FileFormat:
    """Find the format of a file.

    Args:
        path: the file.
        name: the format that the user named; None to find it by the file's ending.
        param_hints: for errors, the option that names the format, and the argument that names the
            file.
        search_options: keyword arguments of `find_format`.

    Raises:
        BadParameter: there is no such format.
    """
    if not search_options["writing"] and name is None and scene_suffix(path) in SCENE_SUFFIXES:
        problem = f"{path} is a scene: bake it first, navbake bake {path}"
        raise BadParameter(problem, param_hint=param_hints[1])
    try:
        return find_format(path, name, **search_options)
    except FormatError as error:
        raise BadParameter(str(error), param_hint=param_hints[name is None]) from error


def inflate(
    grid: GridFile,
    metres: float | None = argument("RADIUS", "Radius of the agent [m].", None),
    radius: float | None = option("METRES", "The same."),
    output: Path = option("FILE", ".json or .json.gz; - for stdout.", *OUTPUT_FLAGS, default=...),
    clearance: float | None = option(
        "METRES", "Cells so near beyond the radius cost more [m].  [default: 0, or as nav2 does]"
    ),
    mode: str = option("exact|minos", "By the agent's disc, or as MINOS' client.", default="exact"),
    costs: str = option(
        "step|nav2", "Within the clearance: step (10), or nav2 (exponential).", default="step"
    ),
    scaling: float | None = option("FACTOR", "cost_scaling_factor of nav2 [1/m].  [default: 10]"),
    ledges: str | None = option(
        "avoid|ignore", "No drops of more than a step within the radius, or any.  [default: avoid]"
    ),
) -> None:
    """Inflate the obstacles of a grid for an agent of another radius.

    Example: navbake inflate house.grid.json 0.3 -o wide.grid.json
    """
    from navbake.formats.navgrid import encode_files  # loads numpy
    from navbake.runtime.inflation import NAV2_SCALING, check_arguments
    from navbake.runtime.search import Search

    radii = [value for value in (metres, radius) if value is not None]
    if len(radii) != 1:
        raise BadParameter("expected one radius [m]", param_hint="RADIUS")
    radius = radii[0]
    options.refuse_unused(
        "--scaling", scaling is not None, has_effect=costs == "nav2", purpose="--costs nav2"
    )
    options.refuse_unused(
        "--ledges", ledges is not None, has_effect=mode != "minos", purpose="--mode exact"
    )
    scaling = NAV2_SCALING if scaling is None else scaling
    ledges = ledges or "avoid"
    # check the arguments before reading the grid, which takes seconds
    check_arguments(radius, clearance, mode, costs=costs, scaling=scaling, ledges=ledges)
    options.check_output(output, *GRID_SUFFIXES, inputs=[grid])
    grid_before = navbake.load(grid)
    previous_radius = grid_before.inflated_radius if mode == "exact" else 0.0
    grid_after = grid_before.inflate(
        radius, clearance, mode, costs=costs, scaling=scaling, ledges=ledges
    )
    (content,) = encode_files(grid_after, output).values()
    options.write_output(content, output)
    free_areas = [
        sum(int(level.free.sum()) * level.lattice.cell_size**2 for level in nav_grid.levels)
        for nav_grid in (grid_before, grid_after)
    ]
    share_text = f" ({free_areas[1] / free_areas[0]:.1%})" if free_areas[0] else ""
    if mode == "exact":
        warn_of_closed_connections(Search(grid_before), Search(grid_after), radius)
    total_radius = max(radius, previous_radius)
    add_facts(
        scene_id=grid_after.scene_id,
        radius=total_radius,
        mode=mode,
        free_area=round(free_areas[1], 6),
        free_area_before=round(free_areas[0], 6),
    )
    with options.keep_stdout_for(output):
        summary = f"{output}: {free_areas[1]:.2f} of {free_areas[0]:.2f} m² free{share_text}"
        say_unless_quiet(f"{summary} for an agent of radius {total_radius:g} m ({mode})")


def routes(
    grid: GridFile,
    output: Path = option("FILE", "File to write, - for stdout.", *OUTPUT_FLAGS, default=...),
    agent: str | None = option(
        "NAME",
        "An agent that the grid names.  [default: the grid's own]",
        completion=completion.list_agents,
    ),
    radius: float | None = option(
        "METRES", "Agent's radius [m].  [default: its own, or the grid's]"
    ),
    level: str | None = LEVEL_OPTION,
    doors: DoorStates = None,
    stairs: str | None = option(
        "occupied|free",
        "Lanes over stairs, and on floors beyond them, or none.  [default: free; nav2-route: "
        "occupied, as in the maps of `convert`]",
    ),
    to: str | None = option(
        "FORMAT",
        "Format of the file.  [default: by its ending]",
        "--to",
        completion=completion.list_route_formats,
    ),
) -> None:
    from navbake.formats import map_losses  # loads numpy
    from navbake.formats.route_files import encode_routes
    from navbake.navgrid.links import Agent
    from navbake.routes.build import make_routes
    from navbake.runtime.agents import find_agent

    if output == STDOUT and to is None:
        raise BadParameter("expected a format: stdout has no ending", param_hint="--to")
    writer = _find_format(output, to, ("--to", "-o"), writing=True, formats=ROUTE_FORMATS)
    if stairs is None:
        stairs = "occupied" if "stairs" in writer.closes else "free"
    options.check_output(output, inputs=[grid])
    nav_grid = navbake.load(grid)
    level_number = options.find_level(nav_grid, level)
    nav_grid = options.set_doors(nav_grid, doors)
    route_agent = find_agent(nav_grid, agent)
    if radius is not None:
        route_agent = replace(route_agent or Agent(""), radius=radius)
    closed_cells = map_losses.find_closed_cells(nav_grid, stairs=stairs, closes_areas=False)
    wheeled_grid = map_losses.close_cells(nav_grid, closed_cells.join_masks())
    with show_progress_bars(str(output), VERBOSITY.quiet) as progress:
        graph = make_routes(wheeled_grid, route_agent, progress)
    graph = graph if level_number is None else graph.on_level(level_number)
    options.write_output(encode_routes(graph, output, to), output)
    losses = map_losses.describe_losses(nav_grid, (), closed_cells, level=level_number)
    print_warnings(f"no lanes lead over {loss}" for loss in losses)
    add_facts(
        scene_id=nav_grid.scene_id,
        radius=graph.radius,
        num_nodes=len(graph.nodes),
        num_lanes=len(graph.lanes),
    )
    if output != STDOUT:
        size_text = f"{len(graph.nodes)} nodes, {len(graph.lanes)} lanes"
        say_unless_quiet(f"{output}: {size_text} for a radius of {graph.radius:g} m")


routes.__doc__ = "\n\n".join(
    (
        "Make a graph of where agents drive: nodes, and lanes that are free for them.",
        "Example: navbake routes house.grid.json -o house.geojson",
        "Formats:",
        *(f"{form.name} ({', '.join(form.endings)}): {form.meaning}." for form in ROUTE_FORMATS),
    )
)


def map_descriptor(
    level: str | None = option(
        "N|NAME",
        "Which level, by number or name; 0 is the lowest.  [default: 0]",
        completion=completion.list_levels,
    ),
    corner: tuple[float, float] | None = option("X Y", "Lower left [m].  [default: the level's]"),
    rows: int | None = option("N", "Squares up.  [default: the whole level; decoding: 20]", min=1),
    cols: int | None = option(
        "N", "Squares across.  [default: the whole level; decoding: 15]", min=1
    ),
    square: float | None = option("METRES", "Edge of a square [m].  [default: 0.1]"),
    grid: Path | None = argument("GRID", "A NavGrid file.", None),
    decode: tuple[str, str] | None = option("P1 P2", "Draw this descriptor in place of a GRID."),
    explored: Path | None = option(
        "NPY", "Which squares are explored: an array [row, col], row 0 at the top.  [default: all]"
    ),
) -> None:
    """Write a level as a map descriptor (two hex strings) and draw it.

    Example: navbake map-descriptor house.grid.json --square 0.2
    """
    if (grid is None) == (decode is None):
        raise BadParameter("expected a GRID, or --decode P1 P2", param_hint="GRID")
    if (rows is None) != (cols is None):
        raise BadParameter("expected both or none of them", param_hint="--rows, --cols")
    grid_options = {"level": level, "corner": corner, "square": square, "explored": explored}
    for name, value in grid_options.items():
        options.refuse_unused(
            f"--{name}", value is not None, has_effect=decode is None, purpose="a GRID"
        )
    import numpy as np  # not for --help

    from navbake.arena import map_descriptor as descriptor
    from navbake.formats.npz import read_npy

    shape = None if rows is None or cols is None else (rows, cols)
    scene_id = None
    if decode is not None:
        part1, part2 = decode
        is_explored, is_obstacle = descriptor.decode(part1, part2, shape or descriptor.ARENA_SHAPE)
    else:
        assert grid is not None
        nav_grid = navbake.load(grid)
        scene_id = nav_grid.scene_id
        levels = nav_grid.levels
        level_number = options.find_level(nav_grid, level) or 0
        square_edge = descriptor.SQUARE_EDGE if square is None else square
        squares = descriptor.place_squares(
            levels[level_number], square=square_edge, corner=corner, shape=shape
        )
        is_obstacle = descriptor.find_obstacles(levels[level_number], squares)
        is_explored = np.ones_like(is_obstacle) if explored is None else read_npy(explored)
        part1, part2 = descriptor.encode(is_explored, is_obstacle)
    drawing = descriptor.draw(is_explored, is_obstacle)
    add_facts(
        scene_id=scene_id,
        rows=is_explored.shape[0],
        cols=is_explored.shape[1],
        part1=part1,
        part2=part2,
        map=drawing.split("\n"),
    )
    if decode is None:
        say(part1)
        say(part2)
    for line in drawing.split("\n"):
        say(line)
