"""The commands that show a grid: `navbake plot`, `report` and `view`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from typer import BadParameter

import navbake
from navbake.cli import completion, options, printing
from navbake.cli.batch import draw_missing_thumbnails
from navbake.cli.options import (
    GRID_SUFFIXES,
    LEVEL_OPTION,
    OUTPUT_FLAGS,
    PLACE,
    PLACE_PATTERN,
    SCENE_OPTION,
    STDOUT,
    GridFile,
    SceneFiles,
    argument,
    flag,
    option,
)
from navbake.cli.printing import add_facts, add_files, print_warnings, say, say_unless_quiet
from navbake.errors import ConfigError, FormatError, NavbakeError

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.views.plot import Mark

# Functions import what they need only when they run: --help loads no numpy, MuJoCo or viser.

PLACES_TEXT = "what `navbake sample --json` prints"
ALL_LEVELS = -1  # level of a mark that is drawn on all levels
GRID_ENDING = re.compile(r"(\.grid)?(\.json)?(\.gz)?$")  # the ending of a grid file's name


def plot(
    grid: GridFile,
    output: Path = option(
        "PNG|SVG|PDF", "Picture; - for a PNG on stdout.", *OUTPUT_FLAGS, default=...
    ),
    level: str | None = LEVEL_OPTION,
    layers: list[str] | None = option(
        "LAYER",
        "occupancy, floor, rooms, doors, clearance, island, weights, links or area. May be "
        "repeated.  [default: occupancy and floor]",
        "--layer",
        completion=completion.list_layers,
    ),
    bounds: str | None = option(
        "X0,Y0,X1,Y1", "Show this part of the world only [m].  [default: all of the grid]"
    ),
    points: list[str] | None = option(
        f"{PLACE}|JSON",
        "Mark a place, or those of `navbake sample --json`. May be repeated.",
        "--points",
    ),
    dpi: float = option("N", "Pixels per inch of a PNG.", default=150.0, min=30, max=1200),
    no_title: bool = flag("--no-title", "Leave out the heading and the maps' titles."),
) -> None:
    """Draw a grid: a row for each level, a column for each layer.

    Up is the world's +y. A picture is at most 8.3 inches wide.

    Example: navbake plot house.grid.json -o house.png --layer rooms --layer floor
    """
    from navbake.views.layers import LAYERS
    from navbake.views.plot import DEFAULT_LAYERS

    view_bounds = None if bounds is None else _parse_bounds(bounds)
    for layer in layers or ():
        if layer not in LAYERS:
            problem = f"expected one of {', '.join(LAYERS)}, got {layer}"
            raise BadParameter(problem, param_hint="--layer")
    point_files = [Path(text) for text in points or () if not PLACE_PATTERN.fullmatch(text)]
    options.check_output(output, *options.PICTURE_SUFFIXES, inputs=[grid, *point_files])
    nav_grid = navbake.load(grid)
    level_number = options.find_level(nav_grid, level)
    layer_names = tuple(layers or DEFAULT_LAYERS)
    options.write_picture(
        nav_grid,
        output,
        level=level_number,
        layers=layer_names,
        marks=_read_marks(points or (), nav_grid),
        bounds=view_bounds,
        dpi=dpi,
        titles=not no_title,
    )
    add_facts(scene_id=nav_grid.scene_id, level=level_number, layers=layer_names)


def _parse_bounds(text: str) -> list[float]:
    """Parse the option --bounds: world x_min, y_min, x_max, y_max [m]."""
    try:
        bounds = [float(number_text) for number_text in text.split(",")]
    except ValueError:
        bounds = []
    if len(bounds) != 4:
        message = f"expected X0,Y0,X1,Y1 as in -2,-1.5,4,3, got {text!r}"
        raise BadParameter(message, param_hint="--bounds")
    return bounds


def _read_marks(points: Iterable[str], grid: NavGrid) -> list[Mark]:
    """Return a mark for each place that the option --points names or whose file it names.

    Raises:
        FormatError: a file can't be read, or has no places.
    """
    from navbake.formats.source import read_json

    marks: list[Mark] = []
    for text in points:
        if PLACE_PATTERN.fullmatch(text):
            x, y, z, level = options.parse_place(text, "--points")
            if z is not None:
                cell = grid.cell_at((x, y, z))
                level = None if cell is None else cell.level
            marks.append((ALL_LEVELS if level is None else level, x, y, "point"))
            continue
        content, name = read_json(Path(text), expected=PLACES_TEXT)
        try:
            for place in content["places"]:
                x, y = map(float, place["position"][:2])
                marks.append((int(place["level"]), x, y, Path(text).stem))
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"expected {PLACES_TEXT} in {name}") from error
    return marks


def report(
    grids: list[Path] = argument("GRID|FOLDER", "Grids, or a batch's folder."),
    output: Path | None = option(
        "HTML",
        "Page; - for stdout. Of a batch, index.html in its folder unless given.",
        *OUTPUT_FLAGS,
    ),
    with_audit: bool = flag("--audit", "Audit the grids, and add what is found."),
    verifications: list[Path] | None = option(
        "JSON", "Add what `navbake verify --json` printed; once for each GRID.", "--verify"
    ),
) -> None:
    """Make a page that shows grids in a browser.

    It needs neither a server nor the network. It shows each level's layers and the cell under
    the pointer, and lists rooms, doors, links, settings and timings; of two grids, their
    differences, too. Of a batch's folder it shows all scenes, failures by reason, and
    distributions of free areas and times.

    Example: navbake report before.grid.json after.grid.json -o report.html
    """
    from navbake.auditor.audit import audit
    from navbake.views.report import read_verification, render_report

    if any(os.path.isdir(path) for path in grids):
        options.refuse_unused(
            "--audit",
            with_audit,
            has_effect=False,
            purpose="grids: a batch audits its grids itself",
        )
        options.refuse_unused("--verify", bool(verifications), has_effect=False, purpose="grids")
        from navbake.batch.index import INDEX_NAME, read_index
        from navbake.batch.page import PAGE_NAME, write_page

        if len(grids) > 1 or not os.path.isfile(grids[0] / INDEX_NAME):
            paths_text = ", ".join(map(str, grids))
            raise ConfigError(
                f"expected grids, or one folder of a batch with {INDEX_NAME}, got {paths_text}"
            )
        page_path = grids[0] / PAGE_NAME if output is None else output
        if page_path == STDOUT:
            raise BadParameter("expected a file: the page of a batch has links", param_hint="-o")
        options.check_output(page_path, ".html", ".htm", inputs=[grids[0] / INDEX_NAME])
        draw_missing_thumbnails(grids[0])
        write_page(grids[0], output)
        add_files(page_path)
        add_facts(scenes=[{"scene_id": scene_id} for scene_id in read_index(grids[0])])
        say_unless_quiet(page_path)
        return
    if grids[0].name == "index.jsonl":
        raise ConfigError(f"{grids[0]} is the index of a batch: give its folder, {grids[0].parent}")
    if output is None:
        raise BadParameter("expected a page to write", param_hint="-o")
    if verifications and len(verifications) != len(grids):
        message = f"expected one for each GRID, {len(grids)}, got {len(verifications)}"
        raise BadParameter(message, param_hint="--verify")
    options.check_output(output, ".html", ".htm", inputs=[*grids, *(verifications or ())])
    reports = [read_verification(path) for path in verifications or ()]
    nav_grids = [navbake.load(path) for path in grids]
    page_content = render_report(
        nav_grids,
        names=[GRID_ENDING.sub("", path.name) or path.name for path in grids],
        audits=[audit(nav_grid) for nav_grid in nav_grids] if with_audit else None,
        verifications=reports or None,
    )
    options.write_output(page_content, output)
    add_facts(scenes=[{"scene_id": nav_grid.scene_id} for nav_grid in nav_grids])
    if output != STDOUT:
        say_unless_quiet(output)


def view(
    host: str = option(
        "HOST",
        "Address of this machine to listen at. Only this machine can reach the default; "
        "0.0.0.0 lets others in, too.",
        default="127.0.0.1",
    ),
    port: int = option("PORT", "Port; 0 for any free one.", default=8080, min=0, max=65535),
    no_open: bool = flag("--no-open", "Only print the link."),
    allow_origin: list[str] | None = option("URL", "An address of a proxy. May be repeated."),
    source: Path = argument(
        "GRID|SCENE|CONFIG",
        "A NavGrid file, or a scene, settings or a sample's name to bake.",
        completion=completion.list_scenes,
    ),
    scene: Path | None = SCENE_OPTION,
    *,
    scene_files: SceneFiles,
    force: bool = flag("--force", "Show GRID in a scene that it wasn't baked from."),
    episodes: Path | None = option("EPISODES", "A set of episodes to show."),
    trajectories: Path | None = option("FILE", "Where an agent was: .jsonl or .npz."),
    voxels: Path | None = option("VOXELS", "Voxels to show, below a cut."),
    flight: Path | None = option("JSON", "A path that `navbake fly` wrote, to show as a tube."),
) -> None:
    """Show a grid in its scene, in the browser, until Ctrl-C.

    A SCENE or CONFIG is baked first, and again whenever it changes on disk.

    Example: navbake view my_scene.yaml --set grid.cell_size=0.1
    """
    from navbake.config.settings import load_config
    from navbake.formats.flights import read_flight
    from navbake.views.viewer.server import PageServer
    from navbake.views.viewer.view import Viewer, Watch, find_watched_files, watch_grid
    from navbake.views.viewer.view_state import ViewState

    overrides = scene_files.list_overrides()

    def list_watched_files() -> list[Path]:
        try:
            return find_watched_files([source, *load_config(source, overrides).inputs])
        except NavbakeError:  # broken for now; the next write is tried again
            return find_watched_files([source])

    def bake() -> ViewState:
        from navbake.baker.bake.pipeline import run_bake
        from navbake.baker.scene.scene import load_scene, load_scene_file

        # before the bake, which may be slow
        voxel_grid = None if voxels is None else navbake.load_voxels(voxels)
        flight_path = None if flight is None else read_flight(flight)
        config = load_config(source, overrides)
        with printing.show_progress_bars(
            str(config.scene.id), printing.VERBOSITY.quiet
        ) as progress:
            scene_model = load_scene_file(config)
            grid = run_bake(config, progress=progress, scene_model=scene_model).grid
        print_warnings(list(grid.warnings))
        loaded_scene = load_scene(config, scene_model=scene_model)
        return ViewState(grid, loaded_scene, config, voxels=voxel_grid, flight=flight_path)

    is_grid = source.name.lower().endswith(GRID_SUFFIXES)
    options.refuse_unused(
        "--set", bool(scene_files.overrides), has_effect=not is_grid, purpose="a SCENE or CONFIG"
    )
    options.refuse_unused(
        "--model-path",
        bool(scene_files.model_path),
        has_effect=not is_grid,
        purpose="a SCENE or CONFIG",
    )
    options.refuse_unused(
        "--strict", scene_files.strict, has_effect=not is_grid, purpose="a SCENE or CONFIG"
    )
    options.refuse_unused("--scene", scene is not None, has_effect=is_grid, purpose="a GRID")
    options.refuse_unused("--force", force, has_effect=is_grid, purpose="a GRID")
    options.refuse_unused("--episodes", episodes is not None, has_effect=is_grid, purpose="a GRID")
    options.refuse_unused(
        "--trajectories", trajectories is not None, has_effect=is_grid, purpose="a GRID"
    )
    # before the bake, which may be slow
    with PageServer(host, port, allowed=allow_origin or ()) as server:
        if is_grid:
            watch = watch_grid(
                source,
                scene,
                force=force,
                episodes=episodes,
                trajectories=trajectories or (),
                voxels=voxels,
                flight=flight,
            )
        else:
            options.say_if_sample(source)
            watch = Watch(bake, list_watched_files)
        view_state = watch.read()
        with Viewer(view_state, server, watch=watch) as viewer:
            say(f"{viewer.url} (Ctrl-C ends it)")
            add_facts(scene_id=view_state.grid.scene_id, url=viewer.url)
            printing.print_facts()  # not at the end, which is Ctrl-C
            if not no_open:
                viewer.open()
            viewer.wait()
