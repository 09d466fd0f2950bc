"""The commands that query a grid: `info`, `rooms`, `why`, `path`, `sample`, `stand`."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import BadParameter, Exit, Option

import navbake
from navbake.cli import completion, options, printing
from navbake.cli.options import (
    LEVEL_OPTION,
    OUTPUT_FLAGS,
    PLACE,
    PLACE_HELP,
    DoorStates,
    GridFile,
    argument,
    option,
)
from navbake.cli.printing import add_facts, print_tables, print_warnings, say
from navbake.errors import QueryError, count_of
from navbake.lengths import format_length
from navbake.views import tables

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.stand import StandPoses

# Functions import `navbake.views` only when they run, so that --help doesn't load numpy.

NAME_PREFIXES = ("room:", "object:")
STAND_PREFIXES = ("object:", "category:")
POSE_COLUMNS = ("target", "x m", "y m", "z m", "heading rad", "distance m", "path m")
PLACE_METAVAR = f"{PLACE}|room:NAME"
PATH_FIELDS = "length", "cost", "seconds", "rooms", "doors", "links", "positions", "levels", "cells"
RADIUS_OPTION: Any = option("METRES", "Inflate the grid for this agent radius first [m].")


def info(grid: GridFile) -> None:
    """Print a summary of a grid: levels, doors, links, areas, agents, versions.

    Example: navbake info house.grid.json
    """
    from navbake.views.describe import describe

    nav_grid = navbake.load(grid)
    facts = describe(nav_grid)
    facts.pop("warnings")  # printed, and so added, below
    add_facts(**facts)
    tables_of_file = [
        tables.make_door_table(nav_grid.doors, nav_grid.level_names),
        tables.make_link_table(nav_grid.links, nav_grid.level_names),
        tables.make_area_table(facts["areas"]),
        tables.make_agent_table(facts["agents"]),
    ]
    nonempty_tables = [table for table in tables_of_file if table.rows]
    made_by = [(name.replace("_", " "), value) for name, value in facts["made_by"].items()]
    summary = [("type", facts["type"]), *tables.list_grid_facts(facts), *made_by]
    print_tables(
        tables.make_table(("", ""), summary), tables.make_level_table(facts), *nonempty_tables
    )
    print_warnings(nav_grid.warnings)


def rooms(grid: GridFile) -> None:
    """List the rooms of a grid, what each opens to, and the doors.

    Example: navbake rooms house.grid.json
    """
    nav_grid = navbake.load(grid)
    room_list = nav_grid.rooms
    doors = nav_grid.doors
    reason = None if room_list else _explain_no_rooms(nav_grid, grid)
    add_facts(
        scene_id=nav_grid.scene_id,
        reason=reason,
        rooms=[room.to_json() for room in room_list],
        doors=[door.to_json() for door in doors],
    )
    if reason is None:
        print_tables(tables.make_room_table(room_list, nav_grid.level_names))
        say(count_of(len(room_list), "room"))
    else:
        say(f"no rooms: {reason}")
    if doors:
        say()
        print_tables(tables.make_door_table(doors, nav_grid.level_names))


def _explain_no_rooms(nav_grid: NavGrid, path: Path) -> str:
    """Say why a grid has no rooms, and what gives it some.

    Args:
        nav_grid: the grid.
        path: its file.
    """
    if "settingsDigest" not in nav_grid.navbake:
        scene_path = f"{path.name.partition('.')[0]}.walls.xml"
        settings_path = Path(scene_path).with_suffix(".yaml")
        return (
            "the grid was made of a map or by another program, not by a bake; "
            f"`navbake convert {path} {scene_path}`, then `navbake bake {settings_path}`, "
            "divides it at its doors"
        )
    return (
        "no walls stand round its floor, it is smaller than `rooms.min_area`, or the settings say "
        "`rooms: none`; `rooms.polygons` in the settings draws rooms"
    )


def why(
    grid: GridFile,
    place: str | None = argument(PLACE, f"World position, {PLACE_HELP}.", None),
    at: str | None = option(PLACE, "The same."),
) -> None:
    """Print what a grid holds at a position, and what blocks it.

    Of X,Y alone, each level that spans the position is printed; of X,Y,Z, the one whose floor is
    the nearest below it.

    Example: navbake why house.grid.json 1.5,0.2,L0
    """
    from navbake.views.describe import describe_column

    places = [text for text in (at, place) if text is not None]
    if len(places) != 1:
        got_text = " and ".join(map(repr, places)) or "none"
        raise BadParameter(f"expected one place, {PLACE}, got {got_text}", param_hint="--at")
    place = places[0]
    x, y, z, level = options.parse_place(place, "--at")
    nav_grid = navbake.load(grid)
    if z is not None:
        cell_facts = [nav_grid.describe_cell((x, y, z))]
    elif level is not None:
        cell_facts = [nav_grid.describe_cell((x, y), level)]
    else:
        cell_facts = describe_column(nav_grid, x, y)
    add_facts(scene_id=nav_grid.scene_id, cells=cell_facts)
    print_tables(*map(printing.make_cell_table, cell_facts))


def path(
    grid: GridFile,
    agent: str | None = option(
        "NAME", "Plan for one of the grid's agents.", completion=completion.list_agents
    ),
    by: str = option("cost|time", "Find the cheapest path, or the quickest.", default="cost"),
    closed: list[str] | None = option(
        "LINK", "Close a link; may be repeated.", "--close", completion=completion.list_links
    ),
    opened: list[str] | None = option(
        "LINK", "Open a link; may be repeated.", "--open", completion=completion.list_links
    ),
    start: str = option(
        PLACE_METAVAR,
        f"Start, {PLACE_HELP}; or a room's middle.",
        "--from",
        "--start",
        default=...,
        completion=completion.list_starts,
    ),
    goals: list[str] = option(
        f"{PLACE_METAVAR}|object:NAME",
        "Goal; the cheapest of several.",
        "--to",
        "--goal",
        default=...,
        completion=completion.list_goals,
    ),
    doors: DoorStates = None,
    radius: float | None = RADIUS_OPTION,
    smooth: bool = Option(True, help="Straighten the path, or follow the cells' centres."),
    output: Path | None = option(
        "PNG|SVG|PDF", "Draw the path; - for a PNG on stdout.", *OUTPUT_FLAGS
    ),
) -> None:
    """Plan a path through a grid, or say why there is none.

    The exit status is 1 if there is none.

    Example: navbake path house.grid.json --from 0,-4.8 --to -2.2,-3.2,L1
    """
    if output is not None:
        options.check_output(output, *options.PICTURE_SUFFIXES, inputs=[grid])
    is_named = any(goal.startswith(NAME_PREFIXES) for goal in goals)
    if len(goals) > 1 and is_named:
        raise BadParameter("several goals have to be positions", param_hint="--to")
    # loading takes seconds, so wrong places are told first
    load_grid = partial(navbake.load, grid)
    start_place = None
    if not start.startswith("room:"):
        start_place = options.parse_place(start, "--from", load_grid)
    goal_places = []
    if not is_named:
        goal_places = [
            options.parse_place(text, "--to", load_grid, with_objects=True) for text in goals
        ]
    nav_grid = load_grid()
    if opened or closed:
        state_by_link = dict.fromkeys(opened or (), "open") | dict.fromkeys(closed or (), "closed")
        nav_grid = nav_grid.with_links(state_by_link)
    # places are checked before anything is compiled
    start_position: Any = (
        options.position_of_place(nav_grid, start_place, "--from") if start_place else None
    )
    goal_positions = [options.position_of_place(nav_grid, place, "--to") for place in goal_places]
    if len({len(position) for position in goal_positions}) > 1:
        # only a grid of one level takes places without z, and only some have none: all get it
        goal_positions = [
            options.position_of_place(nav_grid, place._replace(level=0), "--to")
            for place in goal_places
        ]
    grid_as_in_file = nav_grid
    from navbake.runtime.agents import find_agent  # loads numpy

    path_agent = find_agent(grid_as_in_file, agent)
    if path_agent is not None and radius is not None:
        path_agent = replace(path_agent, radius=radius)
        radius = None  # the finder inflates the grid for its agent
    nav_grid = _adapt_grid(grid_as_in_file, doors, radius)
    finder = navbake.PathFinder(nav_grid, agent=path_agent)
    if start_position is None:
        name = start.removeprefix("room:")
        room_middles = [room.centroid for room in nav_grid.rooms if name in (room.id, room.name)]
        start_position = finder.snap(
            room_middles[0] if room_middles else (0.0, 0.0, 0.0), room=name
        )
        if start_position is None:
            raise QueryError(f"no agent can stand in room {name!r}")
    goal: Any = goals[0] if is_named else goal_positions
    planned_path = finder.find_path(start_position, goal, by=by, smooth=smooth)
    reason = None if planned_path else finder.why_not(start_position, goal)
    if reason and doors is None and _can_open_doors(grid_as_in_file):
        grid_with_open_doors = _adapt_grid(grid_as_in_file, ["open"], radius)
        if navbake.PathFinder(grid_with_open_doors, agent=path_agent).find_path(
            start_position, goal, by=by
        ):
            reason += "; `--doors open` opens all doors, `--doors NAME=open` one"
    path_facts = {key: getattr(planned_path, key) for key in PATH_FIELDS} if planned_path else None
    add_facts(scene_id=nav_grid.scene_id, path=path_facts, reason=reason)
    with options.keep_stdout_for(output):
        if planned_path:
            say(f"length  {planned_path.length:.3f} m")
            say(f"cost    {planned_path.cost:.3f}")
            from navbake.navgrid.links import DEFAULT_SPEED  # loads numpy

            speed_text = "" if finder.agent else f" (at {DEFAULT_SPEED:g} m/s)"
            say(f"time    {planned_path.seconds:.1f} s{speed_text}")
            say(f"rooms   {', '.join(planned_path.rooms) or '-'}")
            say(f"doors   {', '.join(planned_path.doors) or '-'}")
            if nav_grid.links:
                say(f"links   {', '.join(planned_path.links) or '-'}")
            say("      x       y       z  level")
            for position, level in zip(planned_path.positions, planned_path.levels, strict=True):
                x, y, z = [format_length(coordinate, 3) for coordinate in position]
                say(f"{x:>7} {y:>7} {z:>7}  {level}")
        else:
            say(f"no path: {reason}")
    if output is not None:
        options.write_picture(nav_grid, output, layers=("occupancy",), route=planned_path)
    if not planned_path:
        raise Exit(1)


def sample(
    grid: GridFile,
    count: int = option("N", "How many places.", "-n", "--count", default=1, min=1),
    seed: int = option("N", "Seed of the draw.", default=0, min=0),
    room: str | None = option(
        "NAME", "Draw in this room only, by id or name.", completion=completion.list_rooms
    ),
    level: str | None = LEVEL_OPTION,
    outdoors: bool = Option(True, help="Also in rooms that are outdoors, or indoors alone."),
    spread: float | None = option(
        "METRES", "At least so far from each other [m].  [default: any distance]", min=0.0
    ),
    radius: float | None = RADIUS_OPTION,
) -> None:
    """Draw places where an agent can stand, each with a heading.

    The same seed gives the same places.

    Example: navbake sample house.grid.json -n 5 --room kitchen --spread 0.8
    """
    import numpy as np  # --help does without it

    nav_grid = navbake.load(grid)
    level_number = options.find_level(nav_grid, level)
    nav_grid = _adapt_grid(nav_grid, None, radius)
    finder = navbake.PathFinder(nav_grid)
    rng = np.random.default_rng(seed)
    if spread is None:
        positions = finder.random_point(
            rng, count, room=room, level=level_number, outdoors=outdoors
        )
        headings = rng.uniform(-math.pi, math.pi, count)
    else:
        room_names = None if room is None else [room]
        has_yard = any(grid_room.outdoors for grid_room in nav_grid.rooms)
        if room is None and not outdoors and has_yard:
            room_names = [indoor.id for indoor in nav_grid.rooms if not indoor.outdoors]
            if not room_names:
                raise QueryError(f"no room of {nav_grid.scene_id!r} is indoors")
        positions, headings = finder.spawn(
            rng, count, rooms=room_names, level=level_number, min_distance=spread
        )
    cells = [finder.cell_at(position) for position in positions]
    levels = [cell.level for cell in cells if cell is not None]
    room_ids = [finder.room_at(position) for position in positions.tolist()]
    places = [
        {"position": position, "heading": heading, "level": place_level, "room": room_id}
        for position, heading, place_level, room_id in zip(
            positions.tolist(), headings.tolist(), levels, room_ids, strict=True
        )
    ]
    add_facts(scene_id=nav_grid.scene_id, seed=seed, places=places)
    rows = []
    for position, heading, place_level, room_id in zip(
        positions, headings, levels, room_ids, strict=True
    ):
        number_texts = [format_length(number, 3) for number in (*position, heading)]
        rows.append([*number_texts, place_level, room_id])
    column_names = ("x m", "y m", "z m", "heading rad", "level", "room")
    print_tables(tables.make_table(column_names, rows, column_names[:5]))


def stand(
    grid: GridFile,
    target_texts: list[str] = argument(
        f"object:NAME|category:NAME|{PLACE}", "What to reach; several are reached one by one."
    ),
    reach: str = option(
        "LEAST,GREATEST",
        "Distance from the base's axis to the target [m].",
        default="0.3,0.8",
    ),
    count: int = option("N", "Most poses for each target.", "-n", "--count", default=16, min=1),
    footprint: str | None = option(
        "LENGTH,WIDTH", "Size of a rectangular base round its axis [m].  [default: a disc]"
    ),
    facing: bool = Option(True, help="Face the target, or any direction."),
    height: float | None = option("METRES", "Shoulder's height: measure in space [m].", min=0.0),
    sight: bool = Option(True, help="The target must be in sight, or may be hidden."),
    eye: float | None = option("METRES", "Height of the eye [m].  [default: the agent's]", min=0.0),
    spread: float = option("METRES", "At least so far apart [m].", default=0.25, min=0.0),
    seed: int = option("N", "Seed of the draw.", default=0, min=0),
    start: str | None = option(
        PLACE, "Where the robot is: nearest poses first, where a path leads.", "--from", "--start"
    ),
    doors: DoorStates = None,
    radius: float | None = RADIUS_OPTION,
    output: Path | None = option(
        "JSON|PNG|SVG|PDF", "Write the poses, or draw them where bases can stand.", *OUTPUT_FLAGS
    ),
) -> None:
    """Find where a robot's base can stand to reach a thing, or say why nowhere.

    The exit status is 1 if there is no pose at all.

    Example: navbake stand house.grid.json object:sofa --radius 0.3
    """
    if output is not None:
        options.check_output(output, ".json", *options.PICTURE_SUFFIXES, inputs=[grid])
    least_and_greatest = options.parse_pair(reach, "--reach")
    outline = None
    if footprint is not None:
        outline = options.parse_rectangle(footprint, "--footprint")
    typed_places = [_parse_target(text) for text in target_texts]
    typed_start = None if start is None else options.parse_place(start, "--from")
    nav_grid = navbake.load(grid)
    targets = [
        text if place is None else options.position_of_place(nav_grid, place, "TARGET")
        for text, place in zip(target_texts, typed_places, strict=True)
    ]
    start_position = None
    if typed_start is not None:
        start_position = options.position_of_place(nav_grid, typed_start, "--from")
    grid_as_in_file = nav_grid
    nav_grid = _adapt_grid(grid_as_in_file, doors, radius)
    finder = navbake.PathFinder(nav_grid)
    if start_position is not None:
        blocked_start_text = finder.why_not(start_position, start_position)
        if blocked_start_text is not None:
            raise QueryError(blocked_start_text)
    rules: dict[str, Any] = {
        "reach": least_and_greatest,
        "footprint": outline,
        "facing": "target" if facing else None,
        "height": height,
        "sight": sight if eye is None or not sight else eye,
        "start": start_position,
    }
    poses = finder.stand_poses(targets, count=count, spread=spread, seed=seed, **rules)
    helps_to_open = False
    is_blocked = bool(poses.why_not) and start is not None
    if is_blocked and doors is None and _can_open_doors(grid_as_in_file):
        grid_with_open_doors = _adapt_grid(grid_as_in_file, ["open"], radius)
        finder_with_open_doors = navbake.PathFinder(grid_with_open_doors)
        poses_with_open_doors = finder_with_open_doors.stand_poses(targets, count=1, **rules)
        helps_to_open = len(poses_with_open_doors.why_not) < len(poses.why_not)
    rows = poses.to_records()
    facts = {"scene_id": nav_grid.scene_id, "poses": rows, "why_not": poses.why_not}
    add_facts(**facts)
    with options.keep_stdout_for(output):
        if rows:
            _print_poses(poses)
        for reason in poses.why_not.values():
            say(f"no pose: {reason}")
        if helps_to_open:
            say("`--doors open` opens all doors: then there is a pose")
    if output is not None and output.suffix.lower() == ".json":
        options.write_output(json.dumps(facts, indent=2).encode(), output)
        printing.say_unless_quiet(output)
    elif output is not None:
        region = finder.stand_region(targets, **rules)
        options.write_picture(nav_grid, output, layers=("occupancy",), poses=poses, region=region)
    if not rows:
        raise Exit(1)


def _adapt_grid(grid: NavGrid, doors: list[str] | None, radius: float | None) -> NavGrid:
    """Return a grid with doors in other states, inflated for an agent's radius.

    Args:
        grid: the grid, which is not changed.
        doors: values of `--doors`, see `options.set_doors`; None to leave doors as they are.
        radius: the radius [m]; None for no inflation.
    """
    adapted_grid = options.set_doors(grid, doors)
    if radius is not None:
        adapted_grid = adapted_grid.inflate(radius)
    return adapted_grid


def _can_open_doors(grid: NavGrid) -> bool:
    """Whether a grid has doors whose state can change: not after it was inflated, also for 0 m."""
    return bool(grid.doors) and "inflation" not in grid.metadata


def _parse_target(text: str) -> options.TypedPlace | None:
    """Parse a target that is a place; None for one that is named."""
    if text.startswith(STAND_PREFIXES):
        return None
    if not options.PLACE_PATTERN.fullmatch(text):
        message = f"expected object:NAME, category:NAME or {PLACE}, got {text!r}"
        raise BadParameter(message, param_hint="TARGET")
    return options.parse_place(text, "TARGET")


def _print_poses(poses: StandPoses) -> None:
    """Print poses as a table."""
    rows = []
    for index, position in enumerate(poses.positions.tolist()):
        numbers = [*position, poses.headings[index], poses.distances[index]]
        if not math.isnan(poses.path_lengths[index]):
            numbers.append(poses.path_lengths[index])
        texts = [format_length(number, 3) for number in numbers]
        rows.append([poses.targets[poses.target_index[index]], *texts])
    column_names = POSE_COLUMNS[: len(rows[0])]
    print_tables(tables.make_table(column_names, rows, column_names[1:]))
