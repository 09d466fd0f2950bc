"""The command line. Only this module and those of its commands print; only it ends the process."""

from __future__ import annotations

import io
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from navbake._version import __version__
from navbake.cli import voxels
from navbake.cli.files import GridFile, check_writable
from navbake.cli.inflate import inflate
from navbake.cli.path import path
from navbake.cli.warm_up import tell_if_cold, warm_up
from navbake.errors import ConfigError, NavbakeError

if TYPE_CHECKING:
    from navbake.config.settings import BakeConfig

app = typer.Typer(
    name="navbake",
    help="Bake MuJoCo scenes into navigation grids.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 a NavbakeError, 2 wrong usage.

    Args:
        arguments: what follows the command's name; those of the process if None.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of geoms and files are free
    try:
        app(None if arguments is None else list(arguments), prog_name="navbake")
    except NavbakeError as error:
        _print_error(str(error))
        raise SystemExit(1) from None


def _print_version(asked: bool) -> None:
    if asked:
        print(f"navbake {__version__}")
        raise typer.Exit


def _check_overrides(overrides: list[str]) -> list[str]:
    for override in overrides:
        if "=" not in override:
            raise typer.BadParameter(f"expected KEY=VALUE, got {override!r}")
    return overrides


Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        callback=lambda value: _check_overrides(value or []),
        help="Override a setting, as in grid.cell_size=0.05; may be given several times.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None: ...


@app.command()
def bake(
    configs: Annotated[
        list[Path],
        typer.Argument(metavar="CONFIG", help="Settings (YAML), or scenes as they are."),
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--output",
            metavar="OUT",
            help="File to write, or a folder (existing, or ending in /).  "
            "[default: the settings' output, or <id>.grid.json in the current folder]",
        ),
    ] = None,
    overrides: Overrides = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Number of threads.  [default: all cores]")
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")
    ] = False,
) -> None:
    """Bake scenes into navigation grids.

    With several CONFIGs, one that fails does not stop the others.
    """
    if len(configs) > 1 and output is not None and not _is_folder(output):
        raise typer.BadParameter(
            f"with several CONFIGs, expected a folder, got {output} (a new one ends in /)",
            param_hint="-o",
        )
    written: set[Path] = set()
    num_failed = 0
    for config in configs:
        try:
            path = _bake_one(config, output, overrides or [], threads, quiet, written)
        except NavbakeError as error:
            if len(configs) == 1:
                raise
            num_failed += 1
            culprit = "" if str(config) in str(error) else f"{config}: "
            _print_error(f"{culprit}{error}")
        else:
            written.add(path.resolve())
    if num_failed:
        _print_error(f"{num_failed} of {len(configs)} failed")
        raise typer.Exit(1)


@app.command()
def init(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="The scene's file.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="YAML to write.  [default: <id>.yaml in the current folder]",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
) -> None:
    """Write commented settings (YAML) for a scene."""
    from navbake.config.template import write_template

    path = write_template(scene, output, force=force)
    print(f"{path}: the default settings; `navbake bake {path}` bakes the scene with them")


@app.command()
def geoms(
    config: Annotated[
        Path, typer.Argument(metavar="SCENE|CONFIG", help="A scene, or settings (YAML).")
    ],
    as_json: AsJson = False,
    overrides: Overrides = None,
) -> None:
    """Tell of each geom whether it counts, as what, and why."""
    from navbake.baker.scene.scene import load_scene
    from navbake.cli.tables import geom_table, print_tables
    from navbake.config.settings import load_config

    scene = load_scene(load_config(config, overrides or []).scene)
    for warning in scene.warnings:
        _print_error(f"warning: {warning}")
    if as_json:
        keys = ("id", "name", "body", "type", "counted", "shape", "reason")
        rows = [{key: getattr(geom, key) for key in keys} for geom in scene.geoms]
        _print_json({"scene_id": scene.id, "geoms": rows, "warnings": list(scene.warnings)})
        return
    num_counted = sum(geom.counted for geom in scene.geoms)
    print_tables(geom_table(scene.geoms))
    print(f"{num_counted} geoms counted, {len(scene.geoms) - num_counted} left out")


@app.command()
def info(grid: GridFile, as_json: AsJson = False) -> None:
    """Tell what a grid holds: levels, sizes, areas, versions."""
    from navbake.formats.navgrid import read_navgrid
    from navbake.views.info import describe

    content = read_navgrid(grid)
    facts = describe(content)
    if as_json:
        _print_json(facts)
        return
    from navbake.cli.tables import door_table, fact_table, level_table, print_tables

    tables = [fact_table(facts), level_table(facts)]
    if facts["doors"]:
        tables.append(door_table(content.doors, [level["name"] for level in facts["levels"]]))
    print_tables(*tables)


@app.command()
def plot(
    grid: GridFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="PNG", help="PNG to write.")],
    level: Annotated[
        int | None,
        typer.Option(min=0, help="Draw only this level, 0 is the lowest.  [default: all]"),
    ] = None,
    layers: Annotated[
        list[str] | None,
        typer.Option(
            "--layer",
            metavar="LAYER",
            help="What to draw: occupancy, floor, rooms, clearance, island or weights; may be "
            "given several times.  [default: occupancy and floor]",
        ),
    ] = None,
) -> None:
    """Draw layers of each level, side by side."""
    from navbake.formats.navgrid import read_navgrid
    from navbake.views.layers import LAYERS
    from navbake.views.plot import DEFAULT_LAYERS, plot_grid

    for layer in layers or ():
        if layer not in LAYERS:
            raise typer.BadParameter(
                f"expected one of {', '.join(LAYERS)}, got {layer}", param_hint="--layer"
            )
    if output.suffix.lower() != ".png":
        raise typer.BadParameter(
            f"expected a name that ends in .png, got {output}", param_hint="-o"
        )
    check_writable(output)
    chosen = tuple(layers or DEFAULT_LAYERS)
    print(plot_grid(read_navgrid(grid), output, level=level, layers=chosen))


@app.command()
def rooms(grid: GridFile, as_json: AsJson = False) -> None:
    """List the rooms of a grid, what each opens to, and the doors between them."""
    from navbake.formats.navgrid import read_navgrid
    from navbake.views.info import level_name

    content = read_navgrid(grid)
    found, doors = content.rooms, content.doors
    if as_json:
        tables = {"rooms": [r.to_json() for r in found], "doors": [d.to_json() for d in doors]}
        _print_json({"scene_id": content.scene_id, **tables})
        return
    from navbake.cli.tables import door_table, print_tables, room_table

    names = [level_name(content, number) for number in range(len(content.levels))]
    print_tables(room_table(found, names))
    print(f"{len(found)} room{'' if len(found) == 1 else 's'}")
    if doors:
        print()
        print_tables(door_table(doors, names))


@app.command()
def why(
    grid: GridFile,
    at: Annotated[
        str, typer.Option(metavar="X,Y[,LEVEL]", help="World position [m], and level from 0.")
    ],
    as_json: AsJson = False,
) -> None:
    """Tell what a grid knows of a place, and what blocks it there; on each level unless given."""
    from navbake.formats.navgrid import read_navgrid
    from navbake.views.why import describe_cell, describe_column

    x, y, level = _parse_place(at)
    content = read_navgrid(grid)
    if level is None:
        places = describe_column(content, x, y)
    else:
        places = [describe_cell(content, x, y, level)]
    if as_json:
        _print_json(places)
        return
    from navbake.cli.tables import print_tables, why_table

    print_tables(*(why_table(facts) for facts in places))


app.command()(inflate)
app.command()(path)
app.command()(warm_up)


def _parse_place(text: str) -> tuple[float, float, int | None]:
    parts = text.split(",")
    try:
        if len(parts) not in (2, 3):
            raise ValueError
        return float(parts[0]), float(parts[1]), int(parts[2]) if len(parts) == 3 else None
    except ValueError:
        raise typer.BadParameter(
            f"expected X,Y or X,Y,LEVEL as in 1.5,-2,0, got {text}", param_hint="--at"
        ) from None


def _bake_one(
    path: Path,
    output: str | None,
    overrides: Sequence[str],
    threads: int | None,
    quiet: bool,
    written: set[Path],
) -> Path:
    """Bake one scene; whatever can be checked before is checked before."""
    from navbake.config.settings import load_config

    config = load_config(path, overrides)
    target = _choose_output(config, output)
    is_in_folder = output is not None and _is_folder(output)
    check_writable(target, may_make_folder=is_in_folder)
    if target.resolve() in written:
        raise ConfigError(f"{target} was written for another scene: give each its own `scene.id`")
    for source in (path, config.scene.path):
        if target.resolve() == source.resolve():
            raise ConfigError(f"expected an output apart from the inputs, got {target}")

    from navbake.baker.pipeline import run_bake
    from navbake.cli.tables import StageProgress

    if not quiet:
        tell_if_cold()
    with StageProgress(title=config.scene.id, hidden=quiet) as progress:
        result = run_bake(config, threads=threads, progress=progress)
    begin = time.perf_counter()
    if is_in_folder:
        target.parent.mkdir(parents=True, exist_ok=True)
    result.grid.save(target)
    result.timings["write"] = time.perf_counter() - begin
    if quiet:
        for warning in result.warnings:
            _print_error(f"warning: {warning}")
    else:
        _print_summary(target, result)
    return target


def _print_summary(path: Path, result: Any) -> None:
    from navbake.cli.tables import level_table, print_tables
    from navbake.views.info import describe

    print(path)
    print_tables(level_table(describe(result.grid)))
    for warning in result.warnings:
        print(f"warning: {warning}")
    stages = ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in result.timings.items())
    print(f"{sum(result.timings.values()):.2f} s: {stages}")


def _choose_output(config: BakeConfig, output: str | None) -> Path:
    name = f"{config.scene.id}.grid.json"
    if output is None:
        return config.output or Path(name)
    return Path(output) / name if _is_folder(output) else Path(output)


def _is_folder(output: str) -> bool:
    return output.endswith(("/", os.sep)) or os.path.isdir(output)


def _print_error(message: str) -> None:
    print(f"navbake: {message}", file=sys.stderr)


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False))


voxels.register(app)
