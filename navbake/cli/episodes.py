"""The commands `episodes` and `score`: sets of episodes from grids, and agents' scores in them."""

from __future__ import annotations

import math
import os
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter

import navbake
from navbake.cli import completion, options
from navbake.cli.options import OUTPUT_FLAGS, DoorStates, argument, flag, option
from navbake.cli.printing import (
    add_facts,
    add_files,
    print_tables,
    print_warnings,
    say,
    say_unless_quiet,
)
from navbake.errors import ConfigError, QueryError, count_of
from navbake.files import encode_csv
from navbake.known_names import suggest
from navbake.views.tables import make_table

if TYPE_CHECKING:
    from navbake.episodes.episode import EpisodeSet
    from navbake.navgrid.grid import NavGrid

# Functions import what reads grids when they run: --help stays quick.

EPISODE_SUFFIXES = (".jsonl", ".jsonl.gz", ".parquet")
FOREIGN_SUFFIXES = (".json", ".json.gz", ".json.bz2", ".csv", ".csv.gz", ".csv.bz2")
"""Endings of other programs' sets of episodes."""
SET_FORMATS = ("habitat-pointnav", "habitat-objectnav", "habitat-vln", "minos", "molmospaces")
"""Names of other programs' formats of sets of episodes."""


def episodes(
    grids: Annotated[list[Path], Argument(metavar="GRID…", help="NavGrid files.")],
    task: str = option(
        "TASK",
        "point, object, room, sequence, explore or reach.",
        default="point",
        choices="point|object|room|sequence|explore|reach",
    ),
    objects: list[str] | None = option(
        "PATTERN",
        "Objects by name. May be repeated.",
        "--object",
        completion=completion.list_objects,
    ),
    categories: Path | None = option("YAML", "Patterns of names by category, or type of room."),
    rooms: list[str] | None = option(
        "PATTERN",
        "Rooms by id or name. May be repeated.",
        "--room",
        completion=completion.list_rooms,
    ),
    reach: str | None = option(
        "METRES",
        "How near to the goal counts as reached; with TASK reach LEAST,GREATEST [m].",
    ),
    footprint: str | None = option(
        "LENGTH,WIDTH",
        "Size of a rectangular base that has to fit, with TASK reach [m].  [default: a disc]",
    ),
    length: int | None = option("N", "Goals of a sequence.  [default: 3]", min=2),
    of: str | None = option(
        "KIND",
        "What its goals are: point, object or room.  [default: point]",
        choices="point|object|room",
    ),
    share: float | None = option(
        "SHARE",
        "Share of the free area that has to be explored, 0 to 1, with TASK explore.  "
        "[default: 0.9]",
    ),
    sampler: str = option(
        "NAME",
        "uniform, habitat, stratified or minos.",
        default="uniform",
        choices="uniform|habitat|stratified|minos",
    ),
    rule: list[str] | None = option("KEY=VALUE", "A rule, e.g. min_distance=2. May be repeated."),
    total: int | None = option("N", "Episodes in all.  [default: 100 a scene]", "--count", min=1),
    per_scene: int | None = option("N", "Episodes of each scene, in place of --count.", min=1),
    seed: int = option("N", "Seed of the draw.", default=0, min=0),
    split: list[str] | None = option("NAME=SHARE", "A part of the set. May be repeated."),
    split_by: str | None = option("scene|room", "What is in one part whole.  [default: scene]"),
    doors: DoorStates = None,
    radius: float | None = option("METRES", "Agent's radius; grids are inflated for it [m]."),
    height: float | None = option("METRES", "Agent's height, at most the grid's [m]."),
    speed: float | None = option("M/S", "Agent's speed, as a note [m/s]."),
    agent: str | None = option(
        "NAME",
        "One of the grids' agents: its size, speed and rights.",
        completion=completion.list_agents,
    ),
    output: Path = option(
        "SET", "File: .jsonl, .jsonl.gz or .parquet.", *OUTPUT_FLAGS, default=...
    ),
) -> None:
    """Draw solvable episodes on grids: starts, goals and distances.

    Example: navbake episodes house.grid.json -o house.jsonl --count 50 --sampler habitat
    """
    if total is not None and per_scene is not None:
        raise BadParameter("expected one of them", param_hint="--count, --per-scene")
    if output.name.lower().endswith(FOREIGN_SUFFIXES):
        endings_text = ", ".join(EPISODE_SUFFIXES)
        remedy = f"`navbake convert SET.jsonl {output}` writes it then"
        problem = f"expected a name that ends in {endings_text}, got {output}: {remedy}"
        raise BadParameter(problem, param_hint="-o")
    goal_kind = (of or "point") if task == "sequence" else task
    has_object_goals = goal_kind in ("object", "reach")
    has_room_goals = goal_kind == "room"
    has_named_goals = has_object_goals or has_room_goals
    options.refuse_unused(
        "--object",
        bool(objects),
        has_effect=has_object_goals,
        purpose="--task object and reach, --of object",
    )
    options.refuse_unused(
        "--room", bool(rooms), has_effect=has_room_goals, purpose="--task room, --of room"
    )
    options.refuse_unused(
        "--categories",
        categories is not None,
        has_effect=has_named_goals,
        purpose="goals that have names",
    )
    options.refuse_unused(
        "--footprint", footprint is not None, has_effect=task == "reach", purpose="--task reach"
    )
    options.refuse_unused(
        "--length", length is not None, has_effect=task == "sequence", purpose="--task sequence"
    )
    options.refuse_unused(
        "--of", of is not None, has_effect=task == "sequence", purpose="--task sequence"
    )
    options.refuse_unused(
        "--share", share is not None, has_effect=task == "explore", purpose="--task explore"
    )
    options.refuse_unused(
        "--split-by", split_by is not None, has_effect=bool(split), purpose="--split"
    )
    options.check_output(output, *EPISODE_SUFFIXES, inputs=grids)
    from msgspec import ValidationError, convert  # --help does without it

    from navbake import episodes as sets  # loads numpy
    from navbake.yaml_text import read_yaml  # PyYAML loads slowly

    task_fields: dict[str, Any] = {"objects": objects or (), "rooms": rooms or ()}
    for name, value in (("length", length), ("of", of), ("share", share)):
        if value is not None:
            task_fields[name] = value
    if task == "reach":
        stance: dict[str, Any] = {}
        if reach is not None:
            stance["reach"] = options.parse_pair(reach, "--reach")
        if footprint is not None:
            stance["footprint"] = options.parse_rectangle(footprint, "--footprint")
        task_fields["stance"] = stance
    elif reach is not None:
        task_fields["radius"] = options.parse_length(reach, "--reach")
    if categories is not None:
        try:
            patterns = convert(read_yaml(categories), dict[str, list[str] | str])
        except ValidationError as error:
            raise ConfigError(f"cannot read {categories}: {error}") from error
        task_fields["rooms" if has_room_goals else "objects"] = {
            label: [pattern] if isinstance(pattern, str) else pattern
            for label, pattern in patterns.items()
        }
    rules: dict[str, Any] = options.read_pairs(rule, "--rule", "KEY=VALUE")
    if "edges" in rules:
        rules["edges"] = rules["edges"].split(",")
    shares = options.read_pairs(split, "--split", "NAME=SHARE")
    count = total or (per_scene or 100) * len(grids)
    loaded_grids = [_load_grid(grid, doors) for grid in grids]
    sampler_rules = sets.make_rules(sampler, **rules)
    episode_set = sets.make_episodes(
        loaded_grids,
        sets.make_task(task, **task_fields),
        sampler_rules,
        count=count,
        seed=seed,
        radius=radius,
        height=height,
        speed=speed,
        agent=agent,
        splits=sets.make_splits(shares, split_by or "scene"),
        files=[find_relative_path(grid, output.parent) for grid in grids],
    )
    sets.write_episodes(episode_set, output)
    add_files(output)
    print_draws(episode_set, output)
    yard_areas = [area for area in map(_yard_area, loaded_grids) if area > 0.0]
    leaves_yards_out = bool(yard_areas) and not sampler_rules.outdoors
    add_facts(
        scenes=[{"scene_id": grid_entry.scene} for grid_entry in episode_set.header.grids],
        num_episodes=len(episode_set),
        refused=episode_set.header.rejected,
        outdoor_area_left_out=round(sum(yard_areas), 6) if leaves_yards_out else 0.0,
    )
    if leaves_yards_out:
        scenes_text = count_of(len(yard_areas), "scene")
        say_unless_quiet(
            f"outdoors is left out, {sum(yard_areas):.0f} m² of {scenes_text}: "
            "`--rule outdoors=true` takes it in"
        )
    warn_of_few(episode_set, count)


def _load_grid(path: Path, doors: list[str] | None) -> NavGrid:
    """Load a grid, with its doors in the states of `--doors`; None to leave them as they are."""
    return options.set_doors(navbake.load(path), doors)


def print_draws(episode_set: EpisodeSet, output: Path) -> None:
    """Say how many episodes are in a file, and how many draws each rule refused."""
    rejected_draws = episode_set.header.rejected
    num_rejected = sum(rejected_draws.values())
    say_unless_quiet(f"{output}: {len(episode_set)} episodes, {num_rejected} draws refused")
    for reason, num_draws in rejected_draws.items():
        say_unless_quiet(f"  {num_draws:>8} {reason}")


def warn_of_few(episode_set: EpisodeSet, count: int) -> None:
    """Warn if a set has fewer episodes than were wanted."""
    if len(episode_set) < count:
        print_warnings([f"only {len(episode_set)} of {count}: the rules refuse the rest"])


def _yard_area(grid: NavGrid) -> float:
    """Return the area outdoors round a building [m²]; 0 if there is no building."""
    from navbake.navgrid.rooms import has_building  # loads numpy

    rooms = grid.rooms
    if not has_building(rooms):
        return 0.0
    return sum(room.area for room in rooms if room.outdoors)


def find_relative_path(path: Path, folder: Path) -> str:
    """Return the path of a file as seen from a folder, with forward slashes."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def find_grids(episode_set: EpisodeSet, folder: Path) -> list[Path]:
    """Find the grids of a set of episodes in a folder, such as that of a batch.

    The set's header names the grids' files. If a name is ``a/b/grid.json``, the grid may be
    ``a/b/grid.json``, ``b/grid.json`` or ``grid.json`` in the folder, or be in the folder of its
    scene's name there.

    Args:
        episode_set: the set.
        folder: the folder to search.

    Returns:
        The path of each grid of the set's header.

    Raises:
        QueryError: a grid is not there.
    """
    paths = []
    for grid_entry in episode_set.header.grids:
        path_parts = PurePosixPath(grid_entry.file or "grid.json.gz").parts
        candidate_names = [Path(*path_parts[index:]) for index in range(len(path_parts))]
        candidate_names.append(Path(grid_entry.scene, path_parts[-1]))
        candidate_paths = [folder / name for name in candidate_names if ".." not in name.parts]
        existing_paths = [file for file in candidate_paths if file.is_file()]
        if not existing_paths:
            raise QueryError(
                f"no grid of {grid_entry.scene!r} in {folder}: expected {candidate_paths[-1]}"
            )
        paths.append(existing_paths[0])
    return paths


def convert_episode_set(
    source: Path, output: Path, format_name: str | None, scenes: dict[str, str]
) -> None:
    """Convert a set of episodes to another format, and print which data the new file lacks.

    Args:
        source: the file to read.
        output: the file to write.
        format_name: the format to write; None to go by the ending of `output`.
        scenes: name of a scene -> its name in the other program.
    """
    from navbake.episodes import read_episodes, write_episodes  # loads numpy
    from navbake.episodes.files import SCENE_FIELD

    options.check_output(output, inputs=[source])
    episode_set = read_episodes(source, scenes)
    scene_names = {episode.scene for episode in episode_set.episodes}
    is_named = not scene_names.isdisjoint(scenes) or SCENE_FIELD in scenes
    if scenes and not is_named:  # other scenes may be in other files
        name = min(scenes)
        problem = f"--scene {name}={scenes[name]} fits no scene of {source}"
        raise ConfigError(f"{problem}: {suggest(name, sorted(scene_names))}")
    missing_data = write_episodes(episode_set, output, format_name, scenes)
    add_files(output)
    add_facts(scenes=[{"scene_id": scene_name} for scene_name in sorted(scene_names)])
    say_unless_quiet(output)
    if not scenes and not output.name.lower().endswith(EPISODE_SUFFIXES):
        name = min(scene_names, default="ID")
        example = "--scene '{id}=data/{id}.glb'"
        say_unless_quiet(f"its scenes are called as here, as {name!r}: `{example}` names them anew")
    if missing_data:
        print_warnings([f"{output} doesn't hold: {', '.join(missing_data)}"])


def score(
    content: Annotated[Path, Argument(metavar="SET", help="The episodes.")],
    trajectories: Annotated[Path, Argument(metavar="TRAJECTORIES", help=".jsonl or .npz.")],
    grids: list[Path] | None = argument(
        "GRID…",
        "Grids of the set, its voxels, or their folder.  [default: those that the set names]",
        None,
    ),
    by: str = option(
        "GROUP",
        "all, distance, ratio, room, scene or split.",
        default="all",
        choices="all|distance|ratio|room|scene|split",
    ),
    threshold: float = option(
        "METRES", "Distance at which nDTW counts a point as missed [m].", default=3.0
    ),
    seed: int = option("N", "Seed of the confidence intervals.", default=0, min=0),
    scene: list[str] | None = option(
        "NAME=ID",
        "What a set of another program calls a scene; {id}=data/{id}.glb names all. May be "
        "repeated.",
    ),
    doors: DoorStates = None,
    partial: bool = flag("--partial", "Leave out episodes without a trajectory."),
    force: bool = flag("--force", "Score on another grid, in other voxels, or for another agent."),
    output: Path | None = option(
        "CSV", "Write a row for each episode; - for stdout.", *OUTPUT_FLAGS
    ),
) -> None:
    """Score trajectories against a set of episodes, with 95 % confidence intervals.

    Example: navbake score house.jsonl runs.jsonl house.grid.json -o scores.csv
    """
    if output is not None:
        options.check_output(output, ".csv", inputs=[content, trajectories, *(grids or [])])
    import msgspec  # --help does without it

    from navbake import scores  # loads numpy
    from navbake.episodes import read_episodes  # loads numpy
    from navbake.episodes.episode import FLY_TASK

    episode_set = read_episodes(content, options.read_pairs(scene, "--scene", "NAME=ID"))
    if not grids:
        file_names = [entry.file for entry in episode_set.header.grids if entry.file]
        path_by_name = {name: content.parent / name for name in file_names}
        grids = [path if path.exists() else Path(name) for name, path in path_by_name.items()]
        missing_grids = [path for path in grids if not path.exists()]
        if missing_grids:
            problem = f"no file {missing_grids[0]}, which {content} names, beside it or here"
            raise QueryError(f"{problem}: give the grids, or the folder that they are in")
    elif len(grids) == 1 and grids[0].is_dir():
        grids = find_grids(episode_set, grids[0])
    are_flights = {episode.task for episode in episode_set.episodes} == {FLY_TASK}
    options.refuse_unused("--doors", doors is not None, has_effect=not are_flights, purpose="grids")
    if not grids:
        noun = "voxels" if are_flights else "grids"
        raise QueryError(f"expected the {noun} of {content}, which names none: give them")
    loaded_grids: list[Any] = [
        navbake.load_voxels(file) if are_flights else _load_grid(file, doors) for file in grids
    ]
    rows = scores.score_set(
        episode_set, scores.read_trajectories(trajectories), loaded_grids,
        threshold=threshold, force=force, partial=partial,
    )  # fmt: skip
    groups = scores.summarize(rows, by, seed=seed)
    group_facts = [
        group | {measure: group[measure]._asdict() for measure in scores.MEAN_FIELDS}
        for group in groups
    ]
    add_facts(
        scenes=[{"scene_id": grid_entry.scene} for grid_entry in episode_set.header.grids],
        groups=msgspec.json.decode(msgspec.json.encode(group_facts)),  # null for NaN
    )
    with options.keep_stdout_for(output):
        for group in groups:
            say(f"{group['group']}: {group['episodes']} episodes")
            intervals = [(key, group[key]) for key in scores.MEAN_FIELDS if group[key].known]
            table_rows = [
                (
                    measure,
                    f"{interval.mean:.3f}",
                    f"{interval.low:.3f} to {interval.high:.3f}",
                    interval.known,
                )
                for measure, interval in intervals
            ]
            print_tables(make_table(("measure", "mean", "95 %", "of"), table_rows, ("of",)))
    if force and not are_flights:
        warn_of_other_radius(episode_set, loaded_grids)
    if not are_flights:
        warn_of_unreachable(episode_set, rows, loaded_grids)
    if output is not None:
        headings = list(rows[0]) if rows else ["episode"]
        options.write_output(encode_csv([headings, *(row.values() for row in rows)]), output)


def warn_of_other_radius(episode_set: EpisodeSet, grids: list[NavGrid]) -> None:
    """Warn if grids that are taken as they are aren't inflated for the set's agent."""
    agent = episode_set.header.agent
    agent_text = "the set names no agent"
    if agent is not None:
        agent_text = f"the set's agent has a radius of {agent.radius:g} m"
    radii = sorted({grid.radius for grid in grids})
    if agent is None or any(abs(radius - agent.radius) > 1e-6 for radius in radii):
        radii_text = ", ".join(f"{radius:g}" for radius in radii)
        problem = f"--force takes the grids as they are, for a radius of {radii_text} m"
        hint = "`navbake inflate` makes one for a larger agent"
        print_warnings([f"{problem}, and {agent_text}: {hint}"])


def warn_of_unreachable(
    episode_set: EpisodeSet, rows: list[dict[str, Any]], grids: list[NavGrid]
) -> None:
    """Warn of episodes whose goals no path reaches, and say why there is none for the first.

    Args:
        episode_set: the set.
        rows: the measures of its episodes, see `navbake.scores.score_set`.
        grids: the set's grids.
    """
    unreachable_ids = [row["episode"] for row in rows if math.isinf(row["shortest"])]
    if not unreachable_ids:
        return
    from navbake.episodes.episode import list_goal_positions, scene_of  # loads numpy

    [episode] = [item for item in episode_set.episodes if item.id == unreachable_ids[0]]
    [grid, *_] = [item for item in grids if scene_of(item) == episode.scene]
    goals: Any = list_goal_positions(episode) or f"room:{episode.goals[0].room}"
    reason = navbake.PathFinder(grid).why_not(episode.start, goals)
    verb = "has" if len(unreachable_ids) == 1 else "have"
    count_text = f"{len(unreachable_ids)} of {count_of(len(rows), 'episode')} {verb} no path"
    effect = "no success, and left out of the means of distance, soft_spl and ndtw"
    reason_text = f": {reason}" if reason else ""
    print_warnings([f"{count_text} to a goal, {effect}; episode {episode.id!r}{reason_text}"])
