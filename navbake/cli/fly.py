"""The command `fly`, which plans through voxels, and draws episodes there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from typer import BadParameter, Exit

import navbake
from navbake.cli import options
from navbake.cli.episodes import EPISODE_SUFFIXES, find_relative_path, print_draws, warn_of_few
from navbake.cli.options import OUTPUT_FLAGS, SceneFiles, argument, option
from navbake.cli.printing import add_facts, add_files, print_warnings, say, say_unless_quiet
from navbake.formats.format_table import VOXEL_SUFFIXES
from navbake.lengths import format_length

if TYPE_CHECKING:
    from navbake.config.settings import BakeConfig
    from navbake.voxels.finder import FlightPath, VoxelFinder
    from navbake.voxels.grid import VoxelGrid

Triple = tuple[float, float, float]  # navbake.types would load numpy

FLIGHT_SUFFIXES = (".json", ".png", ".mcap", ".npz")
"""Endings of the files that `fly` writes."""

FLIGHT_FIELDS = ("positions", "length", "cost", "radius")
"""Attributes of a path that --json prints."""

# Functions import what reads scenes only when they run, so that --help loads no MuJoCo or numpy.


def fly(
    scene: Path = argument("SCENE|VOXELS", "Scene, settings (YAML), sample's name, or voxels."),
    start: str | None = option("X,Y,Z", "Start of the ball's middle [m].", "--from"),
    goal: str | None = option("X,Y,Z", "Goal of the ball's middle [m].", "--to"),
    radius: float = option("METRES", "Radius of the ball [m].", default=...),
    res: float | None = option("METRES", "Edge of a voxel [m].  [default: 0.1]"),
    margin: float | None = option(
        "METRES", "Voxels round the scene's box, to fly outside of it [m].  [default: 1]", min=0.0
    ),
    min_height: float | None = option("METRES", "Least z of the ball's middle [m]."),
    max_height: float | None = option("METRES", "Greatest z of the ball's middle [m]."),
    clearance: float = option(
        "METRES", "What a metre costs more at 1 m from things [m].", default=0.0, min=0.0
    ),
    unknown: Literal["occupied", "free"] = option(
        "occupied|free", "What unknown voxels count as.", default="occupied"
    ),
    episodes: int | None = option(
        "N", "Draw a set of N episodes, in place of --from and --to.", min=1
    ),
    rules: list[str] | None = option(
        "KEY=VALUE",
        "Of episodes: min_distance, max_distance, min_ratio or reach. May be repeated.",
        "--rule",
    ),
    seed: int | None = option("N", "Seed of the draw of episodes.  [default: 0]", min=0),
    outputs: list[Path] | None = option(
        "FILE",
        "Path: .json, .png or .mcap; signed distances: .npz; episodes: .jsonl, .jsonl.gz or "
        ".parquet. May be repeated.",
        *OUTPUT_FLAGS,
    ),
    *,
    scene_files: SceneFiles,
) -> None:
    """Plan a flight through a scene's voxels, or say why there is none; or draw episodes.

    The exit status is 1 if there is none.

    Example: navbake fly house --from 0,-4.4,1.5 --to -3,3,4.2 --radius 0.25 -o flight.png
    """
    is_path = episodes is None
    is_voxel_file = scene.suffix.lower() in VOXEL_SUFFIXES
    options.refuse_unused("--res", res is not None, has_effect=not is_voxel_file, purpose="scenes")
    options.refuse_unused(
        "--margin", margin is not None, has_effect=not is_voxel_file, purpose="scenes"
    )
    options.refuse_unused(
        "--set", bool(scene_files.overrides), has_effect=not is_voxel_file, purpose="scenes"
    )
    options.refuse_unused(
        "--model-path", bool(scene_files.model_path), has_effect=not is_voxel_file, purpose="scenes"
    )
    options.refuse_unused(
        "--strict", scene_files.strict, has_effect=not is_voxel_file, purpose="scenes"
    )
    options.refuse_unused(
        "--from", start is not None, has_effect=is_path, purpose="one path, not for --episodes"
    )
    options.refuse_unused(
        "--to", goal is not None, has_effect=is_path, purpose="one path, not for --episodes"
    )
    options.refuse_unused(
        "--clearance", clearance > 0.0, has_effect=is_path, purpose="one path, not for --episodes"
    )
    options.refuse_unused("--rule", bool(rules), has_effect=not is_path, purpose="--episodes")
    options.refuse_unused("--seed", seed is not None, has_effect=not is_path, purpose="--episodes")
    if is_path:
        begin = _parse_position(start, "--from")
        end = _parse_position(goal, "--to")
    elif len(outputs or ()) != 1:
        raise BadParameter("expected one file for the episodes", param_hint="-o")
    paths = outputs or []
    for output in paths:
        if output == options.STDOUT:
            message = "expected a name: its ending says which format"
            raise BadParameter(message, param_hint="-o")
        suffixes = FLIGHT_SUFFIXES if is_path else EPISODE_SUFFIXES
        options.check_output(output, *suffixes, inputs=[scene])
    from navbake import episodes as sets  # loads numpy

    flight_rules = sets.make_flight_rules(**options.read_pairs(rules, "--rule", "KEY=VALUE"))
    if is_voxel_file:
        scene_id = None
        voxels = navbake.load_voxels(scene)
    else:
        from navbake.config.settings import load_config

        settings = load_config(scene, scene_files.list_overrides())
        options.say_if_sample(scene)
        scene_id = settings.scene.id
        voxels = _voxelize_box(
            settings, 0.1 if res is None else res, 1.0 if margin is None else margin
        )
    finder = navbake.VoxelFinder(voxels, radius, min_height, max_height, clearance, unknown=unknown)
    if episodes is None:
        add_facts(scene_id=scene_id)
        _plan_path(finder, begin, end, paths, title=scene_id or scene.stem)
        return
    output = paths[0]
    episode_set = sets.make_flight_episodes(
        finder,
        flight_rules,
        count=episodes,
        seed=seed or 0,
        scene=scene_id or scene.stem,  # voxels don't say of which scene they are
        file=find_relative_path(scene, output.parent) if is_voxel_file else None,
    )
    sets.write_episodes(episode_set, output)
    add_files(output)
    add_facts(
        scene_id=scene_id or scene.stem,
        num_episodes=len(episode_set),
        refused=episode_set.header.rejected,
    )
    print_draws(episode_set, output)
    warn_of_few(episode_set, episodes)


def _plan_path(
    finder: VoxelFinder, start: Triple, goal: Triple, outputs: list[Path], title: str
) -> None:
    """Plan a path, print it and write it; exit with 1 if there is none.

    Args:
        finder: the voxels and the ball.
        start: world x, y, z [m].
        goal: world x, y, z [m].
        outputs: the files to write.
        title: what the heading of a picture begins with.
    """
    flight = finder.find_path(start, goal)
    reason = finder.why_not(start, goal) if flight is None else None
    facts = None if flight is None else {key: getattr(flight, key) for key in FLIGHT_FIELDS}
    add_facts(path=facts, reason=reason)
    if flight is None:
        say(f"no path: {reason}")
    else:
        say(f"length  {flight.length:.3f} m")
        say(f"cost    {flight.cost:.3f}")
        say("      x       y       z")
        for position in flight.positions.tolist():
            x, y, z = [format_length(coordinate, 3) for coordinate in position]
            say(f"{x:>7} {y:>7} {z:>7}")
    for output in outputs:
        _write_output(output, finder.voxels, flight, title)
    if flight is None:
        raise Exit(1)


def _parse_position(text: str | None, option_name: str) -> Triple:
    """Return x, y and z of a place that a user typed; raise a BadParameter for another form."""
    if text is None:
        message = f"expected {option_name} X,Y,Z, or --episodes N"
        raise BadParameter(message, param_hint=option_name)
    is_place = options.PLACE_PATTERN.fullmatch(text) is not None
    place = options.parse_place(text, option_name) if is_place else None
    if place is None or place.z is None:
        message = f"expected X,Y,Z as in 1.5,-2,1.2, got {text!r}"
        raise BadParameter(message, param_hint=option_name)
    return place.x, place.y, place.z


def _voxelize_box(settings: BakeConfig, res: float, margin: float) -> VoxelGrid:
    """Make the voxels of a scene's box, and of a margin round it.

    Args:
        settings: the scene's settings.
        res: edge of a voxel [m].
        margin: what the voxels cover beside the box, on each side [m].
    """
    voxelizer = navbake.Voxelizer(settings)
    print_warnings(voxelizer.scene.warnings)
    bounds = voxelizer.shapes.bounds
    if bounds is None or not margin:
        return voxelizer.create(res=res)
    lower, upper = bounds
    size = (upper - lower + 2.0 * margin).tolist()
    return voxelizer.create((lower + upper) / 2.0, res=res, size=size, align=True)


def _write_output(output: Path, voxels: VoxelGrid, flight: FlightPath | None, title: str) -> None:
    """Write one of the files; of those of a path, nothing if there is none."""
    suffix = output.suffix.lower()
    if suffix == ".npz":
        voxels.distances(signed=True).save(output)
        add_files(output)
    elif flight is None:
        return
    elif suffix == ".png":
        from navbake.views.flight import draw_flight  # loads numpy

        options.write_output(draw_flight(voxels, flight, title), output)  # adds the file
    else:
        flight.save(output, voxels=voxels if suffix == ".mcap" else None)
        add_files(output)
    say_unless_quiet(output)
