"""The commands that read scenes, but for the bake: `samples`, `init`, `geoms` and `voxelize`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

from typer import Argument, BadParameter, Option

import navbake
from navbake.cli.options import (
    STDOUT,
    AsJson,
    Overrides,
    SceneOrConfig,
    check_output,
    check_scene,
    flag,
    option,
    refuse_unused,
)
from navbake.cli.printing import (
    geom_table,
    print_json,
    print_tables,
    print_warnings,
    say,
    say_unless_quiet,
)
from navbake.formats.convert import OCTREES, VOXELS

Triple = tuple[float, float, float]  # navbake.types would load numpy

# Functions import what reads scenes when they run: --help loads neither MuJoCo nor numpy.


def init(
    scene: Path = Argument(
        ...,
        metavar="SCENE",
        callback=check_scene,
        help="Scene file: MJCF, MJB, URDF or a mesh.",
    ),
    output: Path | None = option(
        "FILE", "YAML to write; - for stdout.  [default: ./<id>.yaml]", "-o", "--output"
    ),
    force: bool = flag("--force", "Overwrite FILE if it exists."),
) -> None:
    """Write a YAML file with all settings, commented, for a scene.

    Example: navbake init house.xml -o house.yaml
    """
    from navbake.config.template import template_for, write_template

    refuse_unused(("--force", force, output != STDOUT, "files"))
    if output == STDOUT:
        print(template_for(scene, Path()), end="")
        return
    path = write_template(scene, output, force=force)
    say_unless_quiet(
        f"{path}: the default settings; `navbake bake {path}` bakes the scene with them"
    )


def samples(
    names: list[str] | None = Argument(
        None, metavar="NAME", help="Samples to copy.  [default: list them]"
    ),
    folder: Path = option(
        "FOLDER",
        "Where to copy them to.  [default: the current folder]",
        "-o",
        "--output",
        default=Path(),
        show_default=False,
    ),
) -> None:
    """Copy sample scenes and their settings here, to try navbake with.

    Example: navbake samples house -o try
    """
    from navbake import samples as known  # --help does without it

    if not names:
        for name in known.names():
            first = known.path(name).read_text(encoding="utf-8").splitlines()[0]
            say(f"{name:<10} {first.removeprefix('# ')}")
        return
    for name in names:
        settings = known.copy(name, folder)[0]
        say_unless_quiet(
            f"{settings}: the settings of a sample; `navbake bake {settings}` bakes it"
        )


def geoms(config: SceneOrConfig, as_json: AsJson = False, overrides: Overrides = None) -> None:
    """List the geoms of a scene: which count, as what, and why.

    Example: navbake geoms house.xml
    """
    from navbake.baker.scene.scene import load_scene
    from navbake.config.settings import load_config

    settings = load_config(config, overrides or [])
    scene = load_scene(settings.scene, settings.agent, settings.floors)
    print_warnings(scene.warnings)
    if as_json:
        keys = ("id", "name", "body", "type", "counted", "shape", "reason")
        rows = [{key: getattr(geom, key) for key in keys} for geom in scene.geoms]
        print_json({"scene_id": scene.id, "geoms": rows, "warnings": list(scene.warnings)})
        return
    num_counted = sum(geom.counted for geom in scene.geoms)
    print_tables(geom_table(scene.geoms))
    print(f"{num_counted} geoms counted, {len(scene.geoms) - num_counted} left out")


class Box(NamedTuple):
    """Options that place the grid."""

    res: float = option("METRES", "Edge of a voxel [m].", default=0.1)
    position: Triple | None = option(
        "X Y Z", "Centre [m].  [default: of the scene's box]", "--center"
    )
    cells: tuple[int, int, int] | None = option("NX NY NZ", "Number of voxels along each axis.")
    size: Triple | None = option("X Y Z", "Size of the grid [m], in place of --cells.")
    align: bool = flag("--align", "Begin voxels at multiples of --res, as octrees always do.")


class Layout(NamedTuple):
    """Options that say how the files are written."""

    compact: bool = flag("--compact", ".binvox: renumber the IDs that occur, from 1.")
    twin: bool = flag("--twin", ".binvox with IDs: write NAME.occupied.binvox without IDs, too.")
    airsim: bool = flag("--airsim", ".binvox: use AirSim's layout.")
    free: bool = flag("--free", "Octrees: mark voxels that are not occupied as free.")


def voxelize(
    config: SceneOrConfig,
    outputs: Annotated[
        list[Path],
        Option(
            "-o",
            "--output",
            metavar="FILE",
            help="File to write: .binvox, .bt, .ot or .npz. May be repeated.",
        ),
    ],
    box: Box,
    layout: Layout,
    segments: list[str] | None = option(
        "WHAT",
        "Give voxels the IDs of what fills them: geom, body, top (top-most body), or "
        "PATTERN=ID, which may be repeated.",
        "--segment",
    ),
    ignore: list[str] | None = option("PATTERN", "Leave out these bodies. May be repeated."),
    overrides: Overrides = None,
) -> None:
    """Voxelize a scene: write which voxels are occupied.

    Example: navbake voxelize house.yaml --res 0.1 -o house.binvox
    """
    if STDOUT in outputs:
        raise BadParameter("expected a name: its ending says which format", param_hint="-o")
    for output in outputs:
        check_output(output, *VOXELS, inputs=[config])
    has_octree = [output.suffix.lower() in OCTREES for output in outputs]
    has_ids = bool(segments) and any(output.suffix.lower() == ".binvox" for output in outputs)
    refuse_unused(
        ("--compact", layout.compact, has_ids, ".binvox with --segment"),
        ("--twin", layout.twin, has_ids, ".binvox with --segment"),
        ("--airsim", layout.airsim, any(o.suffix.lower() == ".binvox" for o in outputs), ".binvox"),
        ("--free", layout.free, any(has_octree), ".bt and .ot"),
    )
    if segments and all(has_octree):
        raise BadParameter(
            "octrees hold no IDs: write a .npz or a .binvox, too", param_hint="--segment"
        )
    from navbake.config.settings import load_config  # loads numpy

    settings = load_config(config, overrides or [])
    for output in outputs:
        check_output(output, inputs=settings.inputs)
    voxelizer = navbake.Voxelizer(settings, ignore=ignore or [])
    print_warnings(voxelizer.scene.warnings)
    # an octree's voxels begin at multiples of their edge, and all files are to hold the same ones
    box = box._replace(align=box.align or any(has_octree))
    grid = voxelizer.create(segments=_parse_segments(segments), **box._asdict())
    print_warnings(grid.notes)
    known = len(grid.notes)
    for output in outputs:
        _write(grid, output, layout)
    print_warnings(grid.notes[known:])
    low, high = (f"({', '.join(f'{c:.6g}' for c in corner)})" for corner in grid.bounds)
    ids = f", {len(grid.names)} IDs" if grid.is_segmented else ""
    say_unless_quiet(
        f"{' × '.join(map(str, grid.shape))} voxels of {grid.res:g} m, {low} to {high} m: "
        f"{grid.occupied.sum()} occupied{ids}"
    )


def _write(grid: navbake.VoxelGrid, output: Path, layout: Layout) -> None:
    from navbake.formats.voxels import names_path, write_voxels  # loads numpy

    is_binvox = output.suffix.lower() == ".binvox"
    form: Any = "airsim" if layout.airsim else "binvox"
    mapping: Any = "compact" if layout.compact and is_binvox else None
    write_voxels(grid, output, free=layout.free, layout=form, mapping=mapping)
    say_unless_quiet(output)
    if grid.is_segmented and output.suffix.lower() in (".binvox", ".npz"):
        say_unless_quiet(names_path(output))
    if layout.twin and grid.is_segmented and is_binvox:
        beside = output.with_suffix(".occupied.binvox")
        write_voxels(grid.without_ids(), beside, layout=form)
        say_unless_quiet(beside)


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
            raise BadParameter(
                f"expected geom, body, top or PATTERN=ID, got {word}", param_hint="--segment"
            )
        patterns[pattern] = int(value)
    return patterns
