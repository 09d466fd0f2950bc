"""The commands that query a grid: `info`, `rooms`, `why`, `path`, `sample`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

from typer import BadParameter, Exit, Option

import navbake
from navbake.cli import options, printing
from navbake.cli.options import (
    LEVEL_OPTION,
    OUTPUT_FLAGS,
    PLACE,
    PLACE_HELP,
    AsJson,
    GridFile,
    argument,
    option,
)
from navbake.cli.printing import print_json, print_tables, print_warnings, say
from navbake.errors import QueryError, count_of
from navbake.views import tables

# Functions import `navbake.views` only when they run, so that --help doesn't load numpy.

NAME_PREFIXES = ("room:", "object:")
PLACE_METAVAR = f"{PLACE}|room:NAME"
PATH_FIELDS = "length", "cost", "seconds", "rooms", "doors", "links", "positions", "levels", "cells"


def info(grid: GridFile, as_json: AsJson = False) -> None:
    """Print a summary of a grid: levels, doors, links, areas, agents, versions.

    Example: navbake info house.grid.json
    """
    from navbake.views.describe import describe

    content = navbake.load(grid)
    facts = describe(content)
    if as_json:
        print_json(facts)
        return
    tables_of_file = [
        tables.make_door_table(content.doors, content.level_names),
        tables.make_link_table(content.links, content.level_names),
        tables.make_area_table(facts["areas"]),
        tables.make_agent_table(facts["agents"]),
    ]
    nonempty_tables = [table for table in tables_of_file if table.rows]
    made_by = [(name.replace("_", " "), value) for name, value in facts["made_by"].items()]
    summary = [("type", facts["type"]), *tables.list_grid_facts(facts), *made_by]
    print_tables(
        tables.make_table(("", ""), summary), tables.make_level_table(facts), *nonempty_tables
    )
    print_warnings(content.warnings)


def rooms(grid: GridFile, as_json: AsJson = False) -> None:
    """List the rooms of a grid, what each opens to, and the doors.

    Example: navbake rooms house.grid.json
    """
    content = navbake.load(grid)
    room_list = content.rooms
    doors = content.doors
    if as_json:
        lists = {"rooms": [r.to_json() for r in room_list], "doors": [d.to_json() for d in doors]}
        print_json({"scene_id": content.scene_id, **lists})
        return
    print_tables(tables.make_room_table(room_list, content.level_names))
    print(count_of(len(room_list), "room"))
    if doors:
        print()
        print_tables(tables.make_door_table(doors, content.level_names))


def why(
    grid: GridFile,
    place: str | None = argument(PLACE, f"World position, {PLACE_HELP}.", None),
    at: str | None = option(PLACE, "The same."),
    as_json: AsJson = False,
) -> None:
    """Print what a grid holds at a position, and what blocks it.

    Of X,Y alone, each level that spans the position is printed; of X,Y,Z, the one whose floor is
    the nearest below it.

    Example: navbake why house.grid.json 1.5,0.2,L0
    """
    from navbake.views.describe import describe_column

    places = [text for text in (at, place) if text is not None]
    if len(places) != 1:
        got = " and ".join(map(repr, places)) or "none"
        raise BadParameter(f"expected one place, {PLACE}, got {got}", param_hint="--at")
    place = places[0]
    x, y, z, level = options.parse_place(place, "--at")
    content = navbake.load(grid)
    if z is not None:
        cell = content.cell_at((x, y, z))
        if cell is None:
            raise QueryError(f"{place} is in no cell: it lies beside the grid, or below its floors")
        level = cell.level
    if level is None:
        cells = describe_column(content, x, y)
    else:
        cells = [content.describe_cell(x, y, level)]
    if as_json:
        print_json(cells)
    else:
        print_tables(*map(printing.make_cell_table, cells))


def path(
    grid: GridFile,
    agent: str | None = option("NAME", "Plan for one of the grid's agents."),
    by: str = option("cost|time", "Find the cheapest path, or the quickest.", default="cost"),
    closed: list[str] | None = option("LINK", "Close a link; may be repeated.", "--close"),
    opened: list[str] | None = option("LINK", "Open a link; may be repeated.", "--open"),
    start: str = option(
        PLACE_METAVAR, f"Start, {PLACE_HELP}; or a room's middle.", "--from", "--start", default=...
    ),
    goals: list[str] = option(
        f"{PLACE_METAVAR}|object:NAME",
        "Goal; the cheapest of several.",
        "--to",
        "--goal",
        default=...,
    ),
    doors: Literal["modelled", "open", "closed", "removed"] | None = option(
        "modelled|open|closed|removed", "State of all doors.  [default: as in the grid]"
    ),
    radius: float | None = option("METRES", "Inflate the grid for this agent radius first [m]."),
    smooth: bool = Option(True, help="Straighten the path, or follow the cells' centres."),
    as_json: AsJson = False,
    output: Path | None = option("PNG|SVG", "Draw the path; - for a PNG on stdout.", *OUTPUT_FLAGS),
) -> None:
    """Plan a path through a grid, or say why there is none.

    The exit status is 1 if there is none.

    Example: navbake path house.grid.json --from 0,-4.8 --to -2.2,-3.2,L1
    """
    if output is not None:
        options.check_output(output, ".png", ".svg", inputs=[grid])
    is_named = any(goal.startswith(NAME_PREFIXES) for goal in goals)
    if len(goals) > 1 and is_named:
        raise BadParameter("several goals have to be positions", param_hint="--to")
    begin = None if start.startswith("room:") else options.parse_place(start, "--from")
    ends = [] if is_named else [options.parse_place(text, "--to") for text in goals]
    content = navbake.load(grid)
    if opened or closed:
        states = dict.fromkeys(opened or (), "open") | dict.fromkeys(closed or (), "closed")
        content = content.with_links(states)
    as_in_file = content
    if doors is not None:
        content = content.with_doors(doors)
    if radius is not None:
        content = content.inflate(radius)
    finder = navbake.PathFinder(content, agent=agent)
    origin: Any = options.position_of_place(content, begin, "--from") if begin else None
    if origin is None:
        name = start.removeprefix("room:")
        middles = [room.centroid for room in content.rooms if name in (room.id, room.name)]
        origin = finder.snap(middles[0] if middles else (0.0, 0.0, 0.0), room=name)
        if origin is None:
            raise QueryError(f"no agent can stand in room {name!r}")
    places = [options.position_of_place(content, end, "--to") for end in ends]
    goal: Any = goals[0] if is_named else places
    path_found = finder.find_path(origin, goal, by=by, smooth=smooth)
    reason = None if path_found else finder.why_not(origin, goal)
    if reason and doors is None and as_in_file.doors and not as_in_file.inflated_radius:
        with_open_doors = as_in_file.with_doors("open")
        if radius is not None:
            with_open_doors = with_open_doors.inflate(radius)
        if navbake.PathFinder(with_open_doors, agent=agent).find_path(origin, goal, by=by):
            reason += "; `--doors open` opens all doors"
    with options.keep_stdout_for(output):
        if as_json:
            facts = {key: getattr(path_found, key) for key in PATH_FIELDS} if path_found else None
            print_json({"path": facts, "reason": reason})
        elif path_found:
            print(f"length  {path_found.length:.3f} m")
            print(f"cost    {path_found.cost:.3f}")
            print(f"time    {path_found.seconds:.1f} s")
            say(f"rooms   {', '.join(path_found.rooms) or '-'}")
            say(f"doors   {', '.join(path_found.doors) or '-'}")
            if content.links:
                say(f"links   {', '.join(path_found.links) or '-'}")
            print("      x       y       z  level")
            positions = path_found.positions.round(3) + 0.0  # no -0.000
            for (x, y, z), level in zip(positions, path_found.levels, strict=True):
                print(f"{x:7.3f} {y:7.3f} {z:7.3f}  {level}")
        else:
            say(f"no path: {reason}")
    if output is not None:
        options.write_picture(content, output, layers=("occupancy",), route=path_found)
    if not path_found:
        raise Exit(1)


def sample(
    grid: GridFile,
    count: int = option("N", "How many places.", "-n", "--count", default=1, min=1),
    seed: int = option("N", "Seed of the draw.", default=0, min=0),
    room: str | None = option("NAME", "In this room only, by id or name."),
    level: int | None = LEVEL_OPTION,
    outdoors: bool = Option(True, help="Also in rooms that are outdoors, or indoors alone."),
    spread: float | None = option(
        "METRES", "At least so far from each other [m].  [default: any distance]", min=0.0
    ),
    radius: float | None = option("METRES", "Inflate the grid for this agent radius first [m]."),
    as_json: AsJson = False,
) -> None:
    """Draw places where an agent can stand, each with a heading.

    The same seed gives the same places.

    Example: navbake sample house.grid.json -n 5 --room kitchen --spread 0.8
    """
    import numpy as np  # --help does without it

    content = navbake.load(grid)
    if radius is not None:
        content = content.inflate(radius)
    finder = navbake.PathFinder(content)
    rng = np.random.default_rng(seed)
    if spread is None:
        positions = finder.random_point(rng, count, room=room, level=level, outdoors=outdoors)
        headings = rng.uniform(-math.pi, math.pi, count)
    else:
        rooms = None if room is None else [room]
        if room is None and not outdoors:
            rooms = [indoor.id for indoor in content.rooms if not indoor.outdoors]
        positions, headings = finder.spawn(
            rng, count, rooms=rooms, level=level, min_distance=spread
        )
    cells = [finder.cell_at(position) for position in positions]
    levels = [cell.level for cell in cells if cell is not None]
    room_ids = [finder.room_at(position) for position in positions.tolist()]
    if as_json:
        places = [
            {"position": position, "heading": heading, "level": level, "room": room_id}
            for position, heading, level, room_id in zip(
                positions.tolist(), headings.tolist(), levels, room_ids, strict=True
            )
        ]
        print_json({"scene_id": content.scene_id, "seed": seed, "places": places})
        return
    rows = []
    for position, heading, level, room_id in zip(
        positions, headings, levels, room_ids, strict=True
    ):
        x, y, z, rounded_heading = np.round([*position, heading], 3) + 0.0  # no -0.000
        numbers = [f"{number:.3f}" for number in (x, y, z, rounded_heading)]
        rows.append([*numbers, level, room_id])
    column_names = ("x m", "y m", "z m", "heading rad", "level", "room")
    print_tables(tables.make_table(column_names, rows, column_names[:5]))
