"""The commands that read scenes: `samples`, `init`, `geoms`, `bake` and `voxelize`."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from typer import BadParameter, Exit

import navbake
from navbake.cli import completion, options, printing
from navbake.cli.options import (
    OUTPUT_FLAGS,
    AgentRadius,
    CellSize,
    SceneFiles,
    SceneOrConfig,
    argument,
    flag,
    option,
)
from navbake.cli.printing import (
    add_facts,
    add_files,
    print_error,
    print_warnings,
    say,
    say_unless_quiet,
)
from navbake.errors import ConfigError, NavbakeError
from navbake.formats.format_table import OCTREE_SUFFIXES, VOXEL_SUFFIXES
from navbake.views.tables import make_level_table, make_table

if TYPE_CHECKING:
    from navbake.baker.bake.pipeline import BakeResult
    from navbake.config.settings import BakeConfig
    from navbake.navgrid.grid import NavGrid
    from navbake.types import Json

Triple = tuple[float, float, float]  # navbake.types would load numpy

# Functions import what reads scenes only when they run, so that --help loads no MuJoCo or numpy.


def init(
    scene: Path = argument("SCENE", "Scene file: MJCF, MJB, URDF, USD, SDF or a mesh."),
    output: Path | None = option(
        "FILE", "YAML; - for stdout.  [default: ./<id>.yaml]", *OUTPUT_FLAGS
    ),
    force: bool = flag("--force", "Overwrite FILE if it exists."),
) -> None:
    """Write a YAML file with all settings, commented, for a scene.

    Example: navbake init house.xml -o house.yaml
    """
    from navbake.config.settings import load_config
    from navbake.config.template import make_template, write_template

    options.refuse_unused("--force", force, has_effect=output != options.STDOUT, purpose="files")
    if output == options.STDOUT:
        options.write_output(make_template(scene, Path())[1].encode(), output)
        add_facts(scene_id=load_config(scene).scene.id)
        return
    path = write_template(scene, output, force=force)
    add_files(path)
    add_facts(scene_id=load_config(scene).scene.id)
    say_unless_quiet(f"{path}: the default settings; `navbake bake {path}` bakes with them")


def schema(
    output: Path = option(
        "JSON", "File.  [default: stdout]", *OUTPUT_FLAGS, default=options.STDOUT
    ),
) -> None:
    """Write the JSON Schema of the settings, so that editors complete and check a YAML file.

    The first line of what `navbake init` writes names navbake.schema.json, beside the YAML.

    Example: navbake schema -o navbake.schema.json
    """
    from navbake.config.template import make_schema

    options.check_output(output, ".json")
    content = json.dumps(make_schema(), indent=2, ensure_ascii=False)
    options.write_output(f"{content}\n".encode(), output)
    if output != options.STDOUT:
        say_unless_quiet(output)


def samples(
    names: list[str] | None = argument(
        "NAME", "Samples to copy.  [default: list them]", None, completion.list_samples
    ),
    folder: Path = option("FOLDER", "Where to copy them to.", *OUTPUT_FLAGS, default=Path()),
) -> None:
    """Copy sample scenes and their settings here, to try navbake with.

    Example: navbake samples house -o try
    """
    from navbake import samples as sample_files  # not for --help

    sample_facts = []
    for name in names or sample_files.names():
        settings_path = sample_files.path(name)
        first_line = settings_path.read_text(encoding="utf-8").splitlines()[0]
        description = first_line.removeprefix("# ")
        if names:
            copied_paths = sample_files.copy(name, folder)
            add_files(*copied_paths)
            settings_path = copied_paths[0]
        sample_facts.append(
            {"name": name, "description": description, "settings": str(settings_path)}
        )
        if names:
            say_unless_quiet(
                f"{settings_path}: a sample's settings; `navbake bake {settings_path}` bakes it"
            )
        else:
            say(f"{name:<10} {description}")
    add_facts(samples=sample_facts)


def geoms(
    config: SceneOrConfig,
    *,
    scene_files: SceneFiles,
) -> None:
    """List the geoms of a scene: whether each is counted, its shape, its role, and why.

    Example: navbake geoms house.xml
    """
    from navbake.baker.scene.scene import load_scene
    from navbake.config.settings import load_config

    settings = load_config(config, scene_files.list_overrides())
    options.say_if_sample(config)
    scene = load_scene(settings)
    print_warnings(scene.warnings)
    keys = ("id", "name", "body", "type", "group", "counted", "shape", "role", "reason")
    geom_facts = [{key: getattr(geom, key) for key in keys} for geom in scene.geoms]
    add_facts(scene_id=scene.id, geoms=geom_facts)
    num_counted = sum(geom.counted for geom in scene.geoms)
    rows = [
        (
            geom.id,
            geom.name,
            geom.body,
            geom.type,
            geom.group,
            "yes" if geom.counted else "no",
            geom.shape,
            geom.role,
            geom.reason,
        )
        for geom in scene.geoms
    ]
    headings = ("id", "geom", "body", "type", "group", "counted", "as", "role", "why")
    printing.print_tables(make_table(headings, rows, numbers=("id", "group")))
    say(f"{num_counted} geoms counted, {len(scene.geoms) - num_counted} left out")


def voxelize(
    config: SceneOrConfig,
    res: float = option("METRES", "Edge of a voxel [m].", default=0.1),
    position: Triple | None = option("X Y Z", "Centre [m].  [default: the scene's]", "--center"),
    cells: tuple[int, int, int] | None = option("NX NY NZ", "Number of voxels along each axis."),
    size: Triple | None = option("X Y Z", "Size of the grid [m], in place of --cells."),
    align: bool = flag("--align", "Begin voxels at multiples of --res, as octrees always do."),
    compact: bool = flag("--compact", ".binvox: renumber the IDs that occur, from 1."),
    twin: bool = flag("--twin", ".binvox with IDs: write NAME.occupied.binvox without IDs, too."),
    airsim: bool = flag("--airsim", ".binvox: AirSim's layout, and its places."),
    free: bool = flag("--free", "Octrees: mark voxels that are not occupied as free."),
    outputs: list[Path] = option(
        "FILE", "File: .binvox, .bt, .ot or .npz. May be repeated.", *OUTPUT_FLAGS, default=...
    ),
    segments: list[str] | None = option(
        "WHAT", "IDs by geom, body, top (top-most body) or PATTERN=ID, repeatedly.", "--segment"
    ),
    ignore: list[str] | None = option("PATTERN", "Leave out these bodies. May be repeated."),
    *,
    scene_files: SceneFiles,
) -> None:
    """Voxelize a scene: write which voxels are occupied.

    Example: navbake voxelize house.yaml --res 0.1 -o house.binvox
    """
    if options.STDOUT in outputs:
        raise BadParameter("expected a name: its ending says which format", param_hint="-o")
    for output in outputs:
        options.check_output(output, *VOXEL_SUFFIXES, inputs=[config])
    endings = [output.suffix.lower() for output in outputs]
    has_binvox = ".binvox" in endings
    is_octree_file = [ending in OCTREE_SUFFIXES for ending in endings]
    binvox_has_ids = bool(segments) and has_binvox
    options.refuse_unused(
        "--compact", compact, has_effect=binvox_has_ids, purpose=".binvox with --segment"
    )
    options.refuse_unused(
        "--twin", twin, has_effect=binvox_has_ids, purpose=".binvox with --segment"
    )
    options.refuse_unused("--airsim", airsim, has_effect=has_binvox, purpose=".binvox")
    options.refuse_unused("--free", free, has_effect=any(is_octree_file), purpose=".bt and .ot")
    if segments and all(is_octree_file):
        raise BadParameter("octrees hold no IDs: write a .npz, too", param_hint="--segment")
    from navbake.config.settings import load_config  # loads numpy
    from navbake.formats.voxels import id_table_path, write_voxels

    settings = load_config(config, scene_files.list_overrides())
    options.say_if_sample(config)
    for output in outputs:
        options.check_output(output, inputs=settings.inputs)
    voxelizer = navbake.Voxelizer(settings, ignore=ignore or [])
    print_warnings(voxelizer.scene.warnings)
    layout: Literal["airsim", "binvox"] = "airsim" if airsim else "binvox"
    # an octree's voxels begin at multiples of their edge, and all files hold the same ones
    grid = voxelizer.create(
        res=res,
        position=position,
        cells=cells,
        size=size,
        align=align or any(is_octree_file),
        segments=_parse_segments(segments),
        layout=layout,
    )
    print_warnings(grid.notes)
    num_notes = len(grid.notes)
    written_paths: list[Path] = []
    for output, ending in zip(outputs, endings, strict=True):
        id_mapping: Literal["compact"] | None = None
        if compact and ending == ".binvox":
            id_mapping = "compact"
        write_voxels(grid, output, free=free, layout=layout, mapping=id_mapping)
        written_paths.append(output)
        if grid.is_segmented and ending not in OCTREE_SUFFIXES:
            written_paths.append(id_table_path(output))
        if twin and grid.is_segmented and ending == ".binvox":
            twin_path = output.with_suffix(".occupied.binvox")
            write_voxels(grid.without_ids(), twin_path, layout=layout)
            written_paths.append(twin_path)
    for path in written_paths:
        say_unless_quiet(path)
    add_files(*written_paths)
    print_warnings(grid.notes[num_notes:])
    num_occupied = int(grid.occupied.sum())
    add_facts(
        scene_id=voxelizer.scene.id,
        shape=grid.shape,
        res=grid.res,
        bounds=grid.bounds,
        num_occupied=num_occupied,
        ids=grid.names,
    )
    lower_corner_text = _format_corner(grid.bounds[0])
    upper_corner_text = _format_corner(grid.bounds[1])
    ids_text = f", {len(grid.names)} IDs" if grid.is_segmented else ""
    voxels_text = f"{' × '.join(map(str, grid.shape))} voxels of {grid.res:g} m"
    summary_text = f"{voxels_text}, {lower_corner_text} to {upper_corner_text} m:"
    say_unless_quiet(f"{summary_text} {num_occupied} occupied{ids_text}")


def _format_corner(corner: Iterable[float]) -> str:
    return f"({', '.join(f'{round(coordinate, 6) + 0.0:.6g}' for coordinate in corner)})"


def _parse_segments(segment_values: list[str] | None) -> str | dict[str, int] | None:
    """Read the values of --segment.

    Returns:
        ``geom``, ``body`` or ``top`` if it is the only value; else pattern of a name -> ID, where
        a pattern without an ID gets its number among the values, from 1. None without values.

    Raises:
        BadParameter: an ID is no whole number, or a pattern is empty.
    """
    if not segment_values:
        return None
    if segment_values in (["geom"], ["body"], ["top"]):
        return segment_values[0]
    patterns: dict[str, int] = {}
    for pattern_number, segment_value in enumerate(segment_values, 1):
        pattern, is_given, id_text = segment_value.rpartition("=")
        if not is_given:
            pattern = segment_value
            id_text = str(pattern_number)
        if not id_text.isdecimal() or not pattern:
            message = f"expected geom, body, top or PATTERN=ID, got {segment_value}"
            raise BadParameter(message, param_hint="--segment")
        patterns[pattern] = int(id_text)
    return patterns


def bake(
    configs: list[Path] = argument(
        "CONFIG",
        "Settings (YAML), a scene, or a sample's name.",
        completion=completion.list_scenes,
    ),
    output: str | None = option(
        "FILE|FOLDER",
        "File (.json or .json.gz), - for stdout, or a folder: one that exists, or a new one that "
        "ends in /.  [default: the settings' output, or <id>.grid.json here]",
        *OUTPUT_FLAGS,
    ),
    name: str | None = option(
        "NAME", "Name of files in the folder: {id} of the scene, {stem}, {parent}.  [default: {id}]"
    ),
    *,
    scene_files: SceneFiles,
    radius: AgentRadius = None,
    cell_size: CellSize = None,
    threads: int | None = option("N", "Number of threads.  [default: all cores]", min=1),
    no_timings: bool = flag(
        "--no-timings", "Leave out timings, so that two bakes give the same bytes."
    ),
    isolate: bool = flag("--isolate", "Compile in a process of its own: a crash is an error then."),
    seconds: float | None = option(
        "SECONDS", "How long that may take [s].  [default: 60]", "--isolate-seconds", min=0.0
    ),
    memory: float | None = option(
        "GIB",
        "How much memory it may take, on Linux [GiB].  [default: 4]",
        "--isolate-memory",
        min=0.0,
    ),
) -> None:
    """Bake scenes into navigation grids.

    Of several CONFIGs, each is baked even if another one fails.

    Example: navbake bake house.yaml --set grid.cell_size=0.05
    """
    is_file = output is not None and not is_folder(output)
    if len(configs) > 1 and is_file:
        problem = f"with several CONFIGs, expected a folder, got {output} (a new one ends in /)"
        raise BadParameter(problem, param_hint="-o")
    if is_file and output != str(options.STDOUT) and not Path(output or "").suffix:
        problem = f"expected a name that ends in {', '.join(options.GRID_SUFFIXES)}, got {output}"
        raise BadParameter(f"{problem}: a new folder is written {output}/", param_hint="-o")
    options.refuse_unused(
        "--name", name is not None, has_effect=not is_file, purpose="files in a folder"
    )
    if name is not None:
        expand_file_name(name, "id", Path("stem"))
    options.refuse_unused(
        "--isolate-seconds", seconds is not None, has_effect=isolate, purpose="--isolate"
    )
    options.refuse_unused(
        "--isolate-memory", memory is not None, has_effect=isolate, purpose="--isolate"
    )
    from navbake.config.settings import load_config
    from navbake.views.describe import describe

    compile_limits: dict[str, float] | None = None
    if isolate:
        compile_limits = {}
        if seconds is not None:
            compile_limits["seconds"] = seconds
        if memory is not None:
            compile_limits["memory"] = memory
    overrides = scene_files.list_overrides()
    overrides += options.override_sizes(radius, cell_size)
    jobs: list[tuple[Path, BakeConfig]] = []
    failures: list[Json] = []
    scene_facts: list[Json] = []
    for path in configs:
        with _collect_failures(path, failures, len(configs)):
            jobs.append((path, load_config(path, overrides)))
            options.say_if_sample(path)
    written_paths: set[Path] = set()
    for (path, config), output_path in zip(
        jobs, list_output_files(jobs, output, name), strict=True
    ):
        with _collect_failures(path, failures, len(configs)):
            if output_path.resolve() in written_paths:
                problem = (
                    f"{output_path} was written for another scene: give each its own `scene.id`"
                )
                raise ConfigError(f"{problem}, or name files, as by --name '{{parent}}-{{stem}}'")
            is_settings_output = output_path == config.output
            inputs = (path, *config.inputs)
            suffixes = () if is_settings_output else options.GRID_SUFFIXES
            may_make_folder = not (is_file or is_settings_output)
            options.check_output(
                output_path, *suffixes, inputs=inputs, may_make_folder=may_make_folder
            )
            if (
                not output_path.name.lower().endswith(options.GRID_SUFFIXES)
                and output_path != options.STDOUT
            ):
                problem = (
                    f"expected a name that ends in {', '.join(options.GRID_SUFFIXES)} as `output`"
                )
                raise ConfigError(f"{problem} in {path}, got {output_path}")
            result = _bake_and_report(config, output_path, threads, compile_limits, not no_timings)
            warnings = list(result.warnings)
            if radius:
                warnings += _warn_of_what_radius_closes(result.grid, radius)
            written_paths.add(output_path.resolve())
            scene_facts.append(
                {
                    "config": str(path),
                    "scene_id": result.grid.scene_id,
                    "file": str(output_path),
                    "levels": describe(result.grid)["levels"],
                    "seconds": result.timings,
                    "warnings": warnings,
                }
            )
    add_facts(scenes=scene_facts, failures=failures)
    if failures:
        print_error(f"{len(failures)} of {len(configs)} failed")
        raise Exit(1)


@contextmanager
def _collect_failures(path: Path, failures: list[Json], num_configs: int) -> Iterator[None]:
    """Let a command go on after a NavbakeError in the with statement, if it has several CONFIGs.

    The error is printed.

    Args:
        path: the CONFIG that is worked on.
        failures: after an error, it is appended with its ``config``, as --json prints both.
        num_configs: number of CONFIGs; if it is 1, the error is raised.
    """
    try:
        yield
    except NavbakeError as error:
        if num_configs == 1:
            raise
        failures.append({"config": str(path), "error": str(error)})
        path_prefix = "" if str(path) in str(error) else f"{path}: "
        print_error(f"{path_prefix}{error}")


def _bake_and_report(
    config: BakeConfig,
    output_path: Path,
    threads: int | None,
    compile_limits: dict[str, float] | None,
    with_timings: bool,
) -> BakeResult:
    """Bake a grid, write it, print its levels and warnings, and return what the bake returns.

    Args:
        config: the settings.
        output_path: the file to write, or stdout.
        threads: number of threads; None for the default.
        compile_limits: arguments of `CompileLimits`, to compile the scene in a process of its own;
            None to compile it in this process.
        with_timings: whether the grid has its timings.
    """
    from navbake.baker.bake.pipeline import run_bake
    from navbake.baker.scene.model import CompileLimits
    from navbake.formats.navgrid import encode_files
    from navbake.views.describe import describe

    prints_lines = not (printing.VERBOSITY.quiet or printing.VERBOSITY.as_json)
    with printing.show_progress_bars(str(config.scene.id), printing.VERBOSITY.quiet) as progress:
        early_warnings: list[str] = []

        def print_early(warning: str) -> None:
            early_warnings.append(warning)
            print_warnings([warning])

        result = run_bake(
            config,
            threads=threads,
            progress=progress,
            limits=None if compile_limits is None else CompileLimits(**compile_limits),
            warn_early=print_early if prints_lines else None,  # else, all follow the bake
        )
    if not with_timings:
        result.grid.timings = {}
    start_time = time.perf_counter()
    output_path.parent.mkdir(parents=True, exist_ok=True)
    replaced_text = " (replaced)" if output_path.exists() else ""
    (content,) = encode_files(result.grid, output_path).values()
    options.write_output(content, output_path)
    result.timings["write"] = time.perf_counter() - start_time
    if not prints_lines:
        print_warnings(result.warnings)
        return result
    with options.keep_stdout_for(output_path):
        if output_path != options.STDOUT:
            say(f"{output_path}{replaced_text}")
        printing.print_tables(make_level_table(describe(result.grid)))
        for warning in result.warnings:
            if warning not in early_warnings:
                say(f"warning: {warning}")
        stages_text = ", ".join(
            f"{stage} {seconds:.2f}" for stage, seconds in result.timings.items()
        )
        say(f"{sum(result.timings.values()):.2f} s: {stages_text}")
    return result


def _warn_of_what_radius_closes(grid: NavGrid, radius: float) -> list[str]:
    """Print a warning of stairs, doors and links that the baked radius [m] closes for the agent.

    Returns the warnings.
    """
    from navbake.runtime.passage import make_point_grid  # loads numpy
    from navbake.runtime.search import Search

    search_before = Search(make_point_grid(grid), radius=0.0)
    return printing.warn_of_closed_connections(search_before, Search(grid), radius)


# --- output files -----------------------------------------------------------------------------


def is_folder(output: str) -> bool:
    """Return whether an output path means a folder: it exists as one, or ends in a slash."""
    return output.endswith(("/", os.sep)) or os.path.isdir(output)


def list_output_files(
    jobs: Sequence[tuple[Path, BakeConfig]], output: str | None, name: str | None
) -> list[Path]:
    """Return the output file of each CONFIG.

    Without `output` and `name`, it is the file that the settings name (`output`), or else
    ``<id>.grid.json`` in the current folder.

    Args:
        jobs: the path of each CONFIG, and its settings.
        output: the output file, or a folder to write into; None for the current folder.
        name: the file's name in the folder, see `expand_file_name`; None for the scene's id.
    """
    if output is not None and not is_folder(output):
        return [Path(output) for _ in jobs]
    output_paths = []
    for path, config in jobs:
        file_name = expand_file_name(name or "{id}", str(config.scene.id), path.resolve())
        if not file_name:
            raise ConfigError(f"`--name {name}` makes no file name of {path}")
        settings_output = config.output if output is None and name is None else None
        output_paths.append(settings_output or Path(output or "") / f"{file_name}.grid.json")
    return output_paths


def expand_file_name(name: str, scene_id: str, path: Path) -> str:
    """Fill in the fields of a file's name.

    Args:
        name: the name, without its ending; may have the fields ``{id}``, ``{stem}``, ``{parent}``.
        scene_id: the value of ``{id}``.
        path: the CONFIG; ``{stem}`` is its name without its ending, ``{parent}`` its folder's name.

    Raises:
        BadParameter: the name has another field, is empty, or may lead out of the folder.
    """
    try:
        file_name = name.format(id=scene_id, stem=path.stem, parent=path.parent.name)
    except (AttributeError, LookupError, ValueError) as error:
        message = f"expected fields out of {{id}}, {{stem}}, {{parent}}, got {name}"
        raise BadParameter(message, param_hint="--name") from error
    if not name or Path(name).is_absolute() or ".." in Path(name).parts or name.endswith("/"):
        message = f"expected the name of a file in the folder, got {name!r}"
        raise BadParameter(message, param_hint="--name")
    return file_name
