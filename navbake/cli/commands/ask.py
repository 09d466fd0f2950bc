"""The commands that query and check a grid: `info`, `rooms`, `why`, `path`, `verify`, `audit`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from typer import Argument, BadParameter, Exit, Option

import navbake
from navbake.cli import printing
from navbake.cli.options import (
    OUTPUT,
    PLACE,
    PLACE_HELP,
    AsJson,
    GridFile,
    beside_output,
    check_output,
    flag,
    option,
    parse_place,
    position_of_place,
    refuse_unused,
    write_picture,
)
from navbake.cli.printing import print_json, print_tables, say, verify_table
from navbake.errors import QueryError
from navbake.formats.convert import read_as
from navbake.views.tables import (
    agent_table,
    area_table,
    door_table,
    level_table,
    link_table,
    room_table,
)

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime import paths
    from navbake.verifier.report import VerifyReport

# Functions import views when they run: --help loads no numpy.

NAMED = ("room:", "object:")
SAMPLE = 100_000
SHOWN = 20  # printed disagreements


def info(grid: GridFile, as_json: AsJson = False) -> None:
    """Print a summary of a grid: levels, doors, links, areas, agents, versions.

    Example: navbake info house.grid.json
    """
    from navbake.views.describe import describe

    content = navbake.load(grid)
    facts = describe(content)
    if as_json:
        printing.print_json(facts)
        return
    tables = [
        door_table(content.doors, content.level_names),
        link_table(content.links, content.level_names),
        area_table(facts["areas"]),
        agent_table(facts["agents"]),
    ]
    shown = [table for table in tables if table.rows]
    print_tables(printing.summary_table(facts), level_table(facts), *shown)
    printing.print_warnings(content.warnings)


def rooms(grid: GridFile, as_json: AsJson = False) -> None:
    """List the rooms of a grid, what each opens to, and the doors.

    Example: navbake rooms house.grid.json
    """
    content = navbake.load(grid)
    found, doors = content.rooms, content.doors
    if as_json:
        lists = {"rooms": [r.to_json() for r in found], "doors": [d.to_json() for d in doors]}
        printing.print_json({"scene_id": content.scene_id, **lists})
        return
    print_tables(room_table(found, content.level_names))
    print(f"{len(found)} room{'' if len(found) == 1 else 's'}")
    if doors:
        print()
        print_tables(door_table(doors, content.level_names))


def why(
    grid: GridFile,
    place: str | None = Argument(None, metavar=PLACE, help=f"World position, {PLACE_HELP}."),
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
    given = places[0]
    x, y, z, level = parse_place(given, "--at")
    content = navbake.load(grid)
    if z is not None:
        cell = content.cell_at((x, y, z))
        if cell is None:
            raise QueryError(f"{given} is in no cell: it lies beside the grid, or below its floors")
        level = cell.level
    if level is None:
        cells = describe_column(content, x, y)
    else:
        cells = [content.describe_cell(x, y, level)]
    if as_json:
        printing.print_json(cells)
    else:
        print_tables(*map(printing.cell_table, cells))


class Planner(NamedTuple):
    """Options that say who plans, for what, and over which links."""

    agent: str | None = option("NAME", "Plan for one of the grid's agents.")
    by: str = option("cost|time", "Find the cheapest path, or the quickest.", default="cost")
    close: list[str] | None = option("LINK", "Close a link; may be repeated.", "--close")
    open: list[str] | None = option("LINK", "Open a link; may be repeated.", "--open")


def path(
    grid: GridFile,
    planner: Planner,
    start: str = option(
        f"{PLACE}|room:NAME",
        f"Start, {PLACE_HELP}; or near the middle of a room.",
        "--from",
        "--start",
        default=...,
    ),
    goals: list[str] = option(
        f"{PLACE}|room:NAME|object:NAME",
        "Goal: a position, a room, or an object to stop beside. Repeat it with several "
        "positions to reach the cheapest of them.",
        "--to",
        "--goal",
        default=...,
    ),
    radius: float | None = option("METRES", "Inflate the grid for this agent radius first [m]."),
    smooth: bool = Option(True, help="Straighten the path, or follow the cells' centres."),
    as_json: AsJson = False,
    output: Path | None = option("PNG|SVG", "Draw the path; - for a PNG on stdout.", *OUTPUT),
) -> None:
    """Plan a path through a grid, or say why there is none.

    The exit status is 1 if there is none.

    Example: navbake path house.grid.json --from 0,-4.8 --to -2.2,-3.2,L1
    """
    if output is not None:
        check_output(output, ".png", ".svg", inputs=[grid])
    is_named = any(goal.startswith(NAMED) for goal in goals)
    if len(goals) > 1 and is_named:
        raise BadParameter("several goals have to be positions", param_hint="--to")
    begin = None if start.startswith("room:") else parse_place(start, "--from")
    ends = [] if is_named else [parse_place(text, "--to") for text in goals]
    content = navbake.load(grid)
    states = {"open": planner.open, "closed": planner.close}
    if any(states.values()):
        content = content.with_links({n: state for state, ns in states.items() for n in ns or ()})
    if radius is not None:
        content = content.inflate(radius)
    finder = navbake.PathFinder(content, agent=planner.agent)
    origin: Any = position_of_place(content, begin, "--from") if begin else None
    if origin is None:
        name = start.removeprefix("room:")
        middles = [room.centroid for room in content.rooms if name in (room.id, room.name)]
        origin = finder.snap(middles[0] if middles else (0.0, 0.0, 0.0), room=name)
        if origin is None:
            raise QueryError(f"no agent can stand in room {name!r}")
    goal: Any = goals[0] if is_named else [position_of_place(content, p, "--to") for p in ends]
    found = finder.find_path(origin, goal, by=planner.by, smooth=smooth)
    reason = None if found else finder.why_not(origin, goal)
    with beside_output(output):
        if as_json:
            _print_json(found, reason)
        elif found:
            print(f"length  {found.length:.3f} m")
            print(f"cost    {found.cost:.3f}")
            print(f"time    {found.seconds:.1f} s")
            say(f"rooms   {', '.join(found.rooms) or '-'}")
            say(f"doors   {', '.join(found.doors) or '-'}")
            if content.links:
                say(f"links   {', '.join(found.links) or '-'}")
            print("      x       y       z  level")
            for (x, y, z), level in zip(found.positions, found.levels, strict=True):
                print(f"{x:7.3f} {y:7.3f} {z:7.3f}  {level}")
        else:
            say(f"no path: {reason}")
    if output is not None:
        write_picture(content, output, layers=("occupancy",), route=found)
    if not found:
        raise Exit(1)


def _print_json(found: paths.Path | None, reason: str | None) -> None:
    keys = ["length", "cost", "seconds", "rooms", "doors", "links", "positions", "levels", "cells"]
    values = {key: getattr(found, key) for key in keys} if found else {}
    lists = {
        key: value.tolist() if hasattr(value, "tolist") else value for key, value in values.items()
    }
    printing.print_json({"path": lists or None, "reason": reason})


class Sample(NamedTuple):
    """Options that select cells."""

    sample: int = option("N", "How many cells to look at, >= 1.", default=SAMPLE)
    every: bool = flag("--all", "Look at all cells.")
    seed: int = option("N", "Seed of the sample and of the paths.", default=0, min=0)


def verify(
    grid: GridFile,
    which: Sample,
    scene: Path | None = option(
        "SCENE|CONFIG",
        "The scene, or the settings of the bake (YAML).  [default: the file that the grid "
        "names, beside it or in the current folder, or in `scenes` there]",
    ),
    radius: float | None = option(
        "METRES",
        "Radius of the agent on free cells and paths [m]; a grid that isn't inflated, or for "
        "less, is inflated for it.  [default: that of the grid]",
    ),
    paths: int = option("N", "Sweep the agent along this many paths.", default=0, min=0),
    tolerance: float = option(
        "METRES",
        "What touches by less than this is free [m], > 0, at most a quarter of a cell.",
        default=1e-4,
    ),
    as_json: AsJson = False,
    output: Path | None = option(
        "PNG|SVG", "Draw the disagreements; - for a PNG on stdout.", *OUTPUT
    ),
    force: bool = flag("--force", "Compare with a scene that isn't the one that was baked."),
) -> None:
    """Compare a grid with its scene by MuJoCo and FCL.

    The exit status is 1 if they disagree.

    Example: navbake verify house.grid.json --all
    """
    if which.every and which.sample != SAMPLE:
        raise BadParameter("expected one of them", param_hint="--sample, --all")
    if output is not None:
        check_output(output, ".png", ".svg", inputs=[grid, *([scene] if scene else [])])
    from navbake.verifier.verify import verify as compare  # loads MuJoCo

    report = compare(
        grid,
        scene,
        sample=None if which.every else which.sample,
        seed=which.seed,
        radius=radius,
        paths=paths,
        tolerance=tolerance,
        force=force,
    )
    with beside_output(output):
        if as_json:
            print_json(report.to_json())
        else:
            _print(report)
    if output is not None:
        marks = [(found.level, *found.position[:2], found.kind) for found in report.findings]
        _write_marked(navbake.load(grid), output, marks)
    if not report.ok:
        raise Exit(1)


def _print(report: VerifyReport) -> None:
    print_tables(verify_table(report))
    if report.sweeps is not None:
        swept = report.sweeps
        say(
            f"{swept.paths} paths of {swept.length:.0f} m in all swept with {swept.radius:g} m: "
            f"{swept.touching} touch, {swept.beside} meet what lies within a step of their ends"
        )
    for note in report.notes:
        say(f"note: {note}")
    for found in report.findings[:SHOWN]:
        x, y, z = found.position
        cell = "" if found.cell is None else f", row {found.cell[0]}, col {found.cell[1]}"
        say(f"{found.kind}: level {found.level}{cell} ({x:.3f}, {y:.3f}, {z:.3f}): {found.text}")
    if len(report.findings) > SHOWN:
        say(f"and {len(report.findings) - SHOWN} more: --json lists them")
    share = f"{report.checked:,} of {report.num_cells:,} cells"
    verdict = "agree" if report.ok else f"disagree at {len(report.findings)} places"
    say(f"grid and scene {verdict}, at {share}")


def audit(
    grid: GridFile,
    as_json: AsJson = False,
    output: Path | None = option("PNG|SVG", "Draw the places; - for a PNG on stdout.", *OUTPUT),
    on: Path | None = option(
        "FILE", "GRID is a graph of routes on this grid, or map of nav2.", "--grid"
    ),
    radius: float | None = option(
        "METRES", "Radius that lanes have to be free for [m].  [default: that of the graph]"
    ),
) -> None:
    """Look at a grid of any program, or at a graph of routes, for what a person would notice.

    It needs no scene. The exit status is 1 if there are errors, 0 if there are only remarks.

    Example: navbake audit house.grid.json -o remarks.png
    """
    refuse_unused(("--radius", radius is not None, on is not None, "--grid"))
    if output is not None:
        check_output(output, ".png", ".svg", inputs=[grid, *([on] if on else [])])
    from navbake.auditor.audit import audit as look_at  # loads numpy
    from navbake.auditor.report import count_of  # loads it too

    if on is None:
        content = navbake.load(grid)
        report = look_at(content)
    else:
        from navbake.auditor.routes import audit_routes  # loads it too

        content = read_as(on)
        report = audit_routes(grid, content, radius=radius)
    with beside_output(output):
        if as_json:
            print_json(report.to_json())
        else:
            for remark in report.remarks:
                say(remark)
            errors = count_of(len(report.errors), "error")
            others = count_of(len(report.remarks) - len(report.errors), "remark")
            say(f"{len(report.checks)} checks: {errors}, {others}")
    if output is not None:
        placed = [(-1 if r.level is None else r.level, r.place, r.check) for r in report.remarks]
        marks = [(level, *place[:2], kind) for level, place, kind in placed if place is not None]
        _write_marked(content, output, marks)
    if not report.ok:
        raise Exit(1)


def _write_marked(
    grid: NavGrid, output: Path, marks: Sequence[tuple[int, float, float, str]]
) -> None:
    """Draw a grid's occupancy with marks: level, world x and y [m], and text."""
    from navbake.views.plot import Mark  # loads numpy

    write_picture(grid, output, layers=("occupancy",), marks=[Mark(*mark) for mark in marks])
