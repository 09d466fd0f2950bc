"""The command `navbake view`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from typer import Argument, BadParameter, Option

from navbake.cli.options import GRIDS, Overrides
from navbake.cli.printing import VOLUME, print_warnings, say

if TYPE_CHECKING:
    from navbake.views.viewer.exhibit import Exhibit
    from navbake.views.viewer.view import Reading

# Functions import the baker and the viewer when they run: --help loads neither MuJoCo nor viser.


class Address(NamedTuple):
    """Where the page is served."""

    host: str = Option(
        "127.0.0.1",
        metavar="HOST",
        help="Address of this machine to listen at. Only this machine can reach the default; "
        "0.0.0.0 lets others in, too.",
    )
    port: int = Option(
        8080, metavar="PORT", min=0, max=65535, help="Port to listen at; 0 for any free one."
    )
    no_open: bool = Option(False, "--no-open", help="Only print the link.")


def view(
    address: Address,
    source: Path = Argument(
        ...,
        metavar="GRID|SCENE|CONFIG",
        help="A NavGrid file (.json or .json.gz), or a scene file or settings (YAML) to bake.",
    ),
    scene: Path | None = Option(
        None,
        metavar="SCENE|CONFIG",
        help="The scene of GRID, or the settings of its bake (YAML).  [default: the file that "
        "GRID names, beside it or in the current folder, or in `scenes` there]",
    ),
    overrides: Overrides = None,
    force: bool = Option(False, "--force", help="Show GRID in a scene that it wasn't baked from."),
) -> None:
    """Show a grid in its scene, in the browser, until Ctrl-C.

    A SCENE or CONFIG is baked first, and again whenever it changes on disk.

    Example: navbake view my_scene.yaml --set grid.cell_size=0.1
    """
    from navbake.views.viewer.view import check_address, check_viser

    check_viser()
    check_address(address.host, address.port)  # before the bake, which may take long
    is_grid = source.name.lower().endswith(GRIDS)
    if is_grid and overrides:
        raise BadParameter("does nothing here: it is for a SCENE or CONFIG", param_hint="--set")
    if not is_grid and (scene is not None or force):
        which = "--scene" if scene is not None else "--force"
        raise BadParameter("does nothing here: it is for a GRID", param_hint=which)
    from navbake.views.viewer.view import Viewer, read_again

    reading = read_again(source, scene, force=force) if is_grid else _baked(source, overrides or [])
    viewer = Viewer(reading.read(), host=address.host, port=address.port, reading=reading)
    try:
        say(f"{viewer.url} (Ctrl-C ends it)")
        if not address.no_open:
            viewer.open()
        viewer.wait()
    finally:
        viewer.close()


def _baked(path: Path, overrides: list[str]) -> Reading:
    """Where the exhibit of a scene or of settings comes from: it is baked."""
    from navbake.config.settings import load_config
    from navbake.errors import NavbakeError
    from navbake.views.viewer.view import Reading, Watch, find_files

    def find() -> list[Path]:
        try:
            return find_files([path, *load_config(path, overrides).inputs])
        except NavbakeError:  # broken for now: whoever mends it writes it
            return find_files([path])

    return Reading(lambda: _bake(path, overrides), Watch(find))


def _bake(path: Path, overrides: list[str]) -> Exhibit:
    from navbake.baker.pipeline import run_bake
    from navbake.baker.scene.scene import load_scene, open_file
    from navbake.cli.progress import stage_progress
    from navbake.config.settings import load_config
    from navbake.views.viewer.exhibit import Exhibit

    config = load_config(path, overrides)
    with stage_progress(title=str(config.scene.id), hidden=VOLUME.quiet) as progress:
        opened = open_file(config.scene)
        grid = run_bake(config, progress=progress, opened=opened).grid
    print_warnings(list(grid.warnings))
    scene = load_scene(config.scene, config.agent, config.floors, opened=opened)
    return Exhibit(grid, scene, config)
