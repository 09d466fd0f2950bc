"""The commands before a bake: `navbake samples`, `navbake init` and `navbake geoms`."""

from pathlib import Path

from typer import Argument, Option

from navbake.cli.options import STDOUT, AsJson, Overrides, SceneOrConfig, refuse_unused
from navbake.cli.printing import (
    geom_table,
    print_json,
    print_tables,
    print_warnings,
    say,
    say_unless_quiet,
)

# Functions import what reads scenes when they run: --help loads neither MuJoCo nor numpy.


def init(
    scene: Path = Argument(..., metavar="SCENE", help="Scene file: MJCF, MJB, URDF or a mesh."),
    output: Path | None = Option(
        None,
        "-o",
        "--output",
        metavar="FILE",
        help="YAML to write; - for stdout.  [default: ./<id>.yaml]",
    ),
    force: bool = Option(False, "--force", help="Overwrite FILE if it exists."),
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
    folder: Path = Option(
        Path(),
        "-o",
        "--output",
        metavar="FOLDER",
        show_default=False,
        help="Where to copy them to.  [default: the current folder]",
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
