"""The commands of voxel grids and map descriptors."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from navbake.cli.files import check_writable
from navbake.errors import ConfigError, FormatError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from navbake.voxels.grid import VoxelGrid

Triple = tuple[float, float, float]
OCTREES = (".bt", ".ot")
SUFFIXES = (".binvox", *OCTREES, ".npz")


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command()(voxelize)
    app.command()(mdf)


def voxelize(
    config: Annotated[
        Path, typer.Argument(metavar="SCENE|CONFIG", help="A scene, or settings (YAML).")
    ],
    outputs: Annotated[
        list[Path],
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="File to write: .binvox, .bt, .ot or .npz; may be given several times.",
        ),
    ],
    res: Annotated[float, typer.Option(help="Edge of a voxel [m].")] = 0.1,
    center: Annotated[
        Triple | None,
        typer.Option(metavar="X Y Z", help="Centre [m].  [default: the scene's box as a whole]"),
    ] = None,
    cells: Annotated[
        tuple[int, int, int] | None,
        typer.Option(metavar="NX NY NZ", help="Voxels along each axis."),
    ] = None,
    size: Annotated[
        Triple | None, typer.Option(metavar="X Y Z", help="Or what the grid covers [m].")
    ] = None,
    segments: Annotated[
        list[str] | None,
        typer.Option(
            "--segment",
            metavar="WHAT",
            help="Voxels hold IDs: geom, body, top (top-most body), or PATTERN=ID, several times.",
        ),
    ] = None,
    compact: Annotated[
        bool, typer.Option("--compact", help="binvox: number the IDs that occur anew, from 1.")
    ] = False,
    twin: Annotated[
        bool, typer.Option("--twin", help="Of a .binvox with IDs, write NAME.occupied.binvox, too.")
    ] = False,
    airsim: Annotated[
        bool, typer.Option("--airsim", help="binvox: in the layout that AirSim writes.")
    ] = False,
    free: Annotated[
        bool, typer.Option("--free", help="Octrees: what isn't occupied is free, not unknown.")
    ] = False,
    align: Annotated[
        bool,
        typer.Option(
            "--align", help="Move the grid onto whole multiples of res, as octrees always do."
        ),
    ] = False,
    ignore: Annotated[
        list[str] | None,
        typer.Option(metavar="PATTERN", help="Leave out bodies; may be given several times."),
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Override a setting of the scene."),
    ] = None,
) -> None:
    """Write which voxels of a scene are filled."""
    for output in outputs:
        _check_output(output)
    if segments and all(output.suffix.lower() in OCTREES for output in outputs):
        raise typer.BadParameter(
            "octrees hold no IDs: write a .npz or a .binvox, too", param_hint="--segment"
        )
    from navbake.baker.voxelize.voxelizer import Voxelizer
    from navbake.config.settings import load_config

    settings = load_config(config, overrides or [])
    voxelizer = Voxelizer(settings, ignore=ignore or [])
    for warning in voxelizer.scene.warnings:
        _warn(warning)
    align = align or any(output.suffix.lower() in OCTREES for output in outputs)
    grid = voxelizer.create(
        center, cells, res=res, size=size, segments=_parse_segments(segments), align=align
    )
    for note in grid.notes:
        _warn(note)
    for output in outputs:
        _write(grid, output, "airsim" if airsim else "binvox", compact, twin, free)
    _print_summary(grid)


def _write(
    grid: VoxelGrid,
    output: Path,
    layout: Literal["binvox", "airsim"],
    compact: bool,
    twin: bool,
    free: bool,
) -> None:
    from navbake.formats.voxels import names_path, write_voxels

    is_binvox = output.suffix.lower() == ".binvox"
    mapping: Literal["compact"] | None = "compact" if compact and is_binvox else None
    write_voxels(grid, output, free=free, layout=layout, mapping=mapping)
    print(output)
    if grid.is_segmented and output.suffix.lower() in (".binvox", ".npz"):
        print(names_path(output))
    if twin and grid.is_segmented and is_binvox:
        beside = output.with_suffix(".occupied.binvox")
        write_voxels(grid.without_ids(), beside, layout=layout)
        print(beside)


def _print_summary(grid: VoxelGrid) -> None:
    import numpy as np

    low, high = grid.bounds
    box = " to ".join(f"({', '.join(f'{c:.6g}' for c in corner)})" for corner in (low, high))
    count = int(np.count_nonzero(grid.values))
    ids = f", {len(grid.names)} IDs" if grid.is_segmented else ""
    print(
        f"{' × '.join(map(str, grid.shape))} voxels of {grid.res:g} m, {box} m: "
        f"{count} occupied{ids}"
    )


def _check_output(output: Path) -> None:
    if output.suffix.lower() not in SUFFIXES:
        raise typer.BadParameter(
            f"expected a name that ends in {', '.join(SUFFIXES)}, got {output}", param_hint="-o"
        )
    check_writable(output)


def _warn(message: str) -> None:
    print(f"navbake: warning: {message}", file=sys.stderr)


def _parse_segments(words: list[str] | None) -> Any:
    """``geom``, ``body`` or ``top`` alone, or patterns, with IDs or counted from 1."""
    if not words:
        return None
    if words in (["geom"], ["body"], ["top"]):
        return words[0]
    patterns: dict[str, int] = {}
    for number, word in enumerate(words, 1):
        pattern, is_given, value = word.rpartition("=")
        if not is_given:
            pattern, value = word, str(number)
        if not value.isdecimal() or not pattern:
            raise typer.BadParameter(
                f"expected geom, body, top or PATTERN=ID, got {word}", param_hint="--segment"
            )
        patterns[pattern] = int(value)
    return patterns


def mdf(
    grid: Annotated[Path | None, typer.Argument(metavar="GRID", help="A NavGrid file.")] = None,
    decode: Annotated[
        tuple[str, str] | None,
        typer.Option("--decode", metavar="P1 P2", help="Draw this descriptor instead of a grid."),
    ] = None,
    level: Annotated[int, typer.Option(min=0, help="Which level, 0 is the lowest.")] = 0,
    corner: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X Y", help="Lower left corner [m].  [default: the level's]"),
    ] = None,
    rows: Annotated[
        int | None,
        typer.Option(min=1, help="Squares up.  [default: all of the level; of P1 and P2: 20]"),
    ] = None,
    cols: Annotated[
        int | None,
        typer.Option(min=1, help="Squares across.  [default: all of the level; of P1 and P2: 15]"),
    ] = None,
    square: Annotated[float, typer.Option(help="Edge of a square [m].")] = 0.1,
    explored: Annotated[
        Path | None,
        typer.Option(
            metavar="NPY",
            help="What is explored: an array [row, col] of the squares, row 0 at the top.  "
            "[default: all]",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Write a level as a map descriptor, part 1 and part 2, and draw it."""
    if (grid is None) == (decode is None):
        raise typer.BadParameter("expected a GRID, or --decode P1 P2", param_hint="GRID")
    if (rows is None) != (cols is None):
        raise typer.BadParameter("expected both or none of them", param_hint="--rows, --cols")
    from navbake.arena import map_descriptor

    shape = None if rows is None or cols is None else (rows, cols)
    if decode is not None:
        part1, part2 = decode
        known, filled = map_descriptor.decode(part1, part2, shape or map_descriptor.ARENA)
    else:
        assert grid is not None
        known, filled = _read_squares(grid, level, square, corner, shape, explored)
        part1, part2 = map_descriptor.encode(known, filled)
    drawing = map_descriptor.draw(known, filled)
    if as_json:
        facts = {"rows": known.shape[0], "cols": known.shape[1], "part1": part1, "part2": part2}
        print(json.dumps({**facts, "map": drawing.split("\n")}, indent=2))
        return
    if decode is None:
        print(f"{part1}\n{part2}")
    print(drawing)


def _read_squares(
    path: Path,
    level: int,
    square: float,
    corner: tuple[float, float] | None,
    shape: tuple[int, int] | None,
    explored: Path | None,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """What is explored of a level's squares, and their obstacles."""
    import numpy as np

    from navbake.arena.arena import find_obstacles, place_squares
    from navbake.formats.navgrid import read_navgrid

    levels = read_navgrid(path).levels
    if level >= len(levels):
        raise ConfigError(f"no level {level} in {path}: it has {len(levels)}, counted from 0")
    squares = place_squares(levels[level], square=square, corner=corner, shape=shape)
    filled = find_obstacles(levels[level], squares)
    if explored is None:
        return np.ones_like(filled), filled
    try:
        known = np.load(explored, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise FormatError(f"expected an array (.npy), {explored} can't be read: {error}") from error
    if not isinstance(known, np.ndarray):
        raise FormatError(f"expected one array (.npy), got several in {explored}")
    return known, filled
