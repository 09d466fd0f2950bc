"""`navbake.view`: a grid in its scene, in the browser."""

from __future__ import annotations

import logging
import math
import os
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from functools import partial
from itertools import product
from os import PathLike
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np

from navbake.episodes.episode import EpisodeSet
from navbake.episodes.files import read_episodes
from navbake.errors import NavbakeError
from navbake.formats.navgrid import read_navgrid
from navbake.formats.scene_files import find_inputs
from navbake.navgrid.colors import rgb_of
from navbake.navgrid.grid import GridBase, NavGrid
from navbake.runtime.paths import Path as Route
from navbake.scores import Trajectory, read_trajectories
from navbake.types import Bool, Float, Json
from navbake.views.viewer.controls import Change, Controls, say_error
from navbake.views.viewer.exhibit import (
    GOAL,
    LIT,
    START,
    TRAJECTORY,
    Choices,
    Exhibit,
    Name,
    first_choices,
    goal_place,
    keep_choices,
    list_runs,
)
from navbake.views.viewer.meshes import Batch
from navbake.views.viewer.server import HOST, PORT, PageServer

if TYPE_CHECKING:
    import viser

PLAIN: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False}
# the page is without the marks of the library, and nothing on it shares it
THEME: Any = {"show_logo": False, "show_share_button": False, "control_width": "medium"}
PATH_LIFT = 0.06  # of a path over the floor [m]
PATH_WIDTH = 5.0  # [pixels]
MARK = 1 / 180  # radius of a mark, by the diagonal of the grid
MARK_RADII = 0.06, 0.5  # least and greatest [m]
POLE = np.array([[0, 0, 0], [0, 0, 1.3]])  # over the clicked cell [m]
GROWN = 0.006  # by which what is lit is larger than it is, so that it is seen [m]
ELEVATION = math.radians(58)  # of the first camera over the horizon
FIELD_OF_VIEW = math.radians(45)
USUAL_ASPECT = 1.2
MARGIN = 1.08  # by which the first camera is farther away than the box needs
LOG = logging.getLogger("navbake")
PERIOD = 0.5  # between two looks at files [s]


def find_camera(bounds: Float, aspect: float) -> Float:
    """Where a box, (2, 3) [m], fills a page of an aspect, seen from -y and above: (3,) [m]."""
    middle = bounds.mean(axis=0)
    away = np.array([0.0, -math.cos(ELEVATION), math.sin(ELEVATION)])
    up = np.array([0.0, math.sin(ELEVATION), math.cos(ELEVATION)])
    corners = np.array(list(product(*bounds.T))) - middle
    slope = math.tan(FIELD_OF_VIEW / 2)
    across = np.abs(corners[:, 0]) / (slope * aspect)
    along = np.abs(corners @ up) / slope
    distance = (np.maximum(across, along) + corners @ away).max()
    place: Float = middle + max(float(distance), 1.0) * MARGIN * away
    return place


class Viewer(AbstractContextManager["Viewer"]):
    """A page that shows a grid, until it is closed; also as a context manager.

    Changes come from threads of the server into a queue. One thread applies all that wait, then
    shows the result once, so that a dragged slider shows its latest place alone.

    Attributes:
        url: where the page is.
    """

    def __init__(self, exhibit: Exhibit, page: PageServer, *, watch: Watch | None = None) -> None:
        self._page = page
        self._server = page.viser
        self.url = page.url
        self._exhibit = exhibit
        self._chosen = first_choices(exhibit.grid)
        self._changes: SimpleQueue[Change | None] = SimpleQueue()  # None at the end
        self._closed = threading.Event()
        self._scene = self._server.scene
        self._shown: dict[str, tuple[Any, list[Any]]] = {}  # by name: what it shows, its nodes
        self._drawn: Any = None  # what the scene was drawn for
        self._dark: bool | None = None  # how the page was drawn
        self._scene.set_up_direction("+z")
        self._scene.world_axes.visible = False
        self._scene.configure_default_lights(cast_shadow=False)
        self._set_up()
        # look at the grid from -y and above, so that it fills the page
        bounds = exhibit.bounds
        camera = self._server.initial_camera
        place = find_camera(bounds, USUAL_ASPECT)
        camera.fov = FIELD_OF_VIEW
        camera.near = 0.05
        camera.far = 40 * max(float(place[2] - bounds[0, 2]), 1.0)
        camera.look_at = bounds.mean(axis=0)
        camera.position = place

        def fit(camera: viser.CameraHandle) -> None:
            """Move the first camera of a page that is narrower than usual, or becomes so."""
            if camera.aspect < USUAL_ASPECT and np.allclose(camera.position, place, atol=0.01):
                camera.position = find_camera(bounds, camera.aspect)
                camera.look_at = bounds.mean(axis=0)

        def follow(client: viser.ClientHandle) -> None:
            fit(client.camera)
            client.camera.on_update(fit)

        self._server.on_client_connect(follow)
        self._scene.on_click()(self._click)
        page.on_dark = lambda: self._changes.put(Choices.with_dark_system)
        forget = self._server.gui.add_command("Clear what was clicked", hotkey="escape")
        forget.on_trigger(lambda _: self._changes.put(Choices.without_clicks))
        self._thread = threading.Thread(target=self._work, name="viewer", daemon=True)
        self._thread.start()
        if watch is not None:
            threading.Thread(target=self._watch, args=(watch,), name="watch", daemon=True).start()

    def show(self, grid: NavGrid | str | PathLike[str], scene: Any = None, **more: Any) -> None:
        """Show another grid on the page; takes what `view` takes of grid, scene and episodes."""
        self._show_other(make_exhibit(grid, scene, **more))

    def open(self) -> None:
        """Open the page in this machine's browser, where it has one with windows."""
        windows = ("DISPLAY", "WAYLAND_DISPLAY")
        # without windows, Python would start a browser in the terminal
        if not sys.platform.startswith("linux") or any(map(os.environ.get, windows)):
            webbrowser.open(self.url)

    def wait(self) -> None:
        """Wait until the page is closed; Ctrl-C closes it."""
        try:
            while not self._closed.wait(PERIOD):
                pass
        finally:
            self.close()

    def close(self) -> None:
        """Take the page away, and free its port."""
        if not self._closed.is_set():
            self._closed.set()
            self._changes.put(None)
            self._thread.join()
            self._page.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _set_up(self) -> None:
        def compare(chosen: Choices) -> Choices:
            self._controls.say("Comparing the grid with the scene…")
            self._exhibit.verify()
            self._controls.say("")
            return chosen

        gui = self._server.gui
        change = self._changes.put
        name = self._exhibit.grid.scene_id
        gui.set_panel_label(name or "navbake")
        self._page.title = f"{name} – navbake" if name else "navbake"
        self._controls = Controls(
            gui, self._exhibit, self._chosen, change, partial(change, compare)
        )
        gui.main_panel.dock_right()  # beside the scene, not over it

    def _click(self, event: viser.SceneClickEvent) -> None:
        ray = event.ray_origin, event.ray_direction
        self._changes.put(lambda chosen: self._exhibit.click(chosen, ray))

    def _show_other(self, exhibit: Exhibit) -> None:
        """Show another exhibit with the same choices, as far as it has them; from any thread."""

        def take(chosen: Choices) -> Choices:
            self._exhibit = exhibit
            self._chosen = keep_choices(chosen, exhibit.grid)
            for node in list(self._shown):
                self._put(node, None, list)
            self._drawn = None
            self._set_up()
            return self._chosen

        self._changes.put(take)

    def _work(self) -> None:
        changes: list[Change | None] = []
        while None not in changes:
            for change in [*changes, self._show]:
                try:  # an error is shown, and the page lives on
                    self._chosen = change(self._chosen) if change else self._chosen
                except Exception as error:
                    if not isinstance(error, NavbakeError):
                        LOG.exception("the viewer failed")
                    self._controls.say(say_error(error))
            changes = [self._changes.get()]
            while not self._changes.empty():
                changes.append(self._changes.get())

    def _show(self, chosen: Choices) -> Choices:
        """Bring the page up to date; only what has changed is sent."""
        exhibit = self._exhibit
        route = exhibit.route(chosen)
        told = exhibit.tell(chosen)
        if bool(chosen.dark) != self._dark:
            self._dark = bool(chosen.dark)
            self._server.gui.configure_theme(dark_mode=self._dark, **THEME)
        with self._server.atomic():
            self._draw(chosen, route, told)
            self._controls.show(chosen, route, told)
        scene = id(exhibit), chosen.doors, chosen.with_hidden, chosen.with_scene, chosen.cut
        if scene != self._drawn:  # takes longer than all else
            self._controls.say("Drawing the scene…")
            self._server.flush()
            self._put_glb("/scene", exhibit.scene_glb(chosen))
            self._put("/batches", scene, lambda: map(self._add_batch, exhibit.batches(chosen)))
            self._drawn = scene
            self._controls.say("")
        return chosen

    def _draw(self, chosen: Choices, route: Route | str | None, told: Json | None) -> None:
        """Draw all but the scene."""
        exhibit = self._exhibit
        for number in range(len(exhibit.grid.levels)):
            overlay = exhibit.overlay(chosen, number) if number in chosen.levels else b""
            self._put_glb(f"/grid/{number}", overlay)
        names = exhibit.names(chosen)
        self._put("/names", names, lambda: map(self._write_name, names))
        low, high = exhibit.bounds
        radius = float(np.clip(np.linalg.norm(high - low) * MARK, *MARK_RADII))
        clicks = (chosen.start, START), (chosen.goal, GOAL)
        ends = [(found.position, color) for found, color in clicks if found is not None]
        path = route.positions if isinstance(route, Route) else np.empty((0, 3))
        drawn = ends, [(path, GOAL)], radius
        self._put("/path", repr(drawn), lambda: self._draw_ways("/path", *drawn))
        arcs = exhibit.arcs(chosen)
        stops = [(arc[at], color) for arc, color in arcs for at in (0, -1)]
        joined = "/links", stops, arcs, radius / 2
        self._put("/links", id(arcs), lambda: self._draw_ways(*joined))
        episode, trajectory = exhibit.runs.get(chosen.episode, (None, None))
        ends = []
        ways = []
        if episode is not None:
            ends = [(episode.start, START)]
            places = map(goal_place, episode.goals)
            ends += [(place, GOAL) for place in places if place is not None]
            ways = [(exhibit.way(chosen), GOAL)]
        if trajectory is not None:
            ways.append((np.array(trajectory.positions).reshape(-1, 3), TRAJECTORY))
        run = "/run", ends, ways, radius
        key = id(exhibit), chosen.episode, exhibit.way(chosen).tobytes()
        self._put("/run", key, lambda: self._draw_ways(*run))
        told = told or {"lit": np.empty((0, 3)), "outline": np.empty((0, 3))}
        lit = told["lit"].reshape(-1, 3)
        cell = told["outline"]
        self._put("/lit", lit.tobytes(), lambda: self._light(lit))
        # the pole is seen where furniture hides the cell
        mark = [(cell, LIT), (cell[:4].mean(axis=0) + POLE, LIT)] if len(cell) else []
        self._put("/cell", cell.tobytes(), lambda: self._draw_ways("/cell", [], mark, 0))

    def _put(self, name: str, key: Any, make: Callable[[], Iterable[Any]]) -> None:
        """Put other nodes under a name, where the key is another than before."""
        before, nodes = self._shown.get(name, (None, []))
        if before != key:
            for node in nodes:
                node.remove()
            self._shown[name] = key, list(make())

    def _put_glb(self, name: str, content: bytes) -> None:
        """Put a GLB on the page, where it is another than before; empty content takes it away."""
        before, nodes = self._shown.get(name, (b"", []))
        if content and nodes and content is not before:  # the node stays: nothing flickers
            nodes[0].glb_data = content
            self._shown[name] = content, nodes
        else:
            add = self._scene.add_glb
            self._put(name, content, lambda: [add(name, content, **PLAIN)] if content else [])

    def _add_batch(self, batch_below: tuple[Batch, Bool]) -> Any:
        """A mesh that several geoms show, at those of its places that are below the cut."""
        batch, below = batch_below
        where = batch.rotations[below], batch.positions[below]
        style: Any = {"lod": batch.lod or "off", **PLAIN}
        name = f"/batches/{batch.geoms[0]}"
        return self._scene.add_batched_glb(name, batch.content, *where, **style)

    def _write_name(self, name: Name) -> Any:
        """A name as high as fits its room, hidden by what stands before it."""
        size: Any = {"font_size_mode": "scene", "font_scene_height": name.height}
        style: Any = {"position": name.position, "anchor": "center-center", "depth_test": True}
        where = "/names/{}/{}/{}".format(*name.position)
        return self._scene.add_label(where, name.text, **size, **style)

    def _draw_ways(
        self, name: str, ends: list[tuple[Any, str]], ways: list[tuple[Float, str]], radius: float
    ) -> Iterable[Any]:
        """Draw places as balls of a radius [m], and lines from position to position."""
        for number, ((x, y, z), color) in enumerate(ends):
            at = (x, y, z + radius)
            rgb = rgb_of(color)
            yield self._scene.add_icosphere(f"{name}/{number}", radius, rgb, position=at, **PLAIN)
        for number, (positions, color) in enumerate(ways):
            if len(positions) > 1:
                lifted = positions + np.array([0, 0, PATH_LIFT])
                points = np.stack([lifted[:-1], lifted[1:]], axis=1).astype(np.float32)
                style: Any = {"thickness": PATH_WIDTH, "thickness_units": "screen"}
                where = f"{name}/line {number}"
                yield self._scene.add_line_segments(where, points, rgb_of(color), **style)

    def _light(self, corners: Float) -> Iterable[Any]:
        """Draw triangles, each three corners, over what they are triangles of."""
        if len(corners):
            middle = corners.mean(axis=0)
            half = np.maximum(np.abs(corners - middle).max(axis=0), GROWN)
            grown = middle + (corners - middle) * (1 + GROWN / half)
            faces = np.arange(len(corners)).reshape(-1, 3)
            style: Any = {"opacity": 0.75, "flat_shading": True, "side": "double", **PLAIN}
            yield self._scene.add_mesh_simple("/lit/0", grown, faces, color=rgb_of(LIT), **style)

    def _watch(self, watch: Watch) -> None:
        """Read again whatever has changed; what can't be read is said, and the last stays."""

        def say(chosen: Choices) -> Choices:
            self._controls.say("Files have changed: baking again…")
            return chosen

        def fail(error: Exception, chosen: Choices) -> Choices:
            raise error

        while not self._closed.wait(PERIOD):
            try:
                if watch.look():
                    self._changes.put(say)
                    self._show_other(watch.read())
            except Exception as error:  # whoever mends the file may mend this, too
                self._changes.put(partial(fail, error))


def view(
    grid: NavGrid | str | PathLike[str],
    scene: Any = None,
    *,
    data: Any = None,
    host: str = HOST,
    port: int = PORT,
    open_page: bool = True,
    force: bool = False,
    allow_origin: Sequence[str] = (),
    episodes: EpisodeSet | str | PathLike[str] | None = None,
    trajectories: Sequence[Trajectory] | str | PathLike[str] = (),
) -> Viewer:
    """Show a grid in its scene, in the browser; see ``docs/viewer.md``.

    The page is served on this machine alone unless `host` says otherwise, and asks for nothing
    from anywhere else.

    Args:
        grid: a grid of one or several levels, or the path of its file.
        scene: what it was baked from: a mujoco.MjModel or MjSpec, a trimesh.Scene or Trimesh,
            settings, or the path of a scene or YAML; None for the file that the grid names, beside
            the grid or in the current folder, or in ``scenes`` there. Where there is none,
            the grid is shown alone.
        data: the mujoco.MjData with the pose of a model or spec.
        host: address of this machine to listen at.
        port: where to listen; 0 for any free port.
        open_page: open the page in the browser.
        force: show the grid in a scene that it was not baked from.
        allow_origin: further addresses at which browsers may show the page, such as that of a
            proxy: ``https://lab.example.org``.
        episodes: a set to show episodes of, or its file.
        trajectories: where an agent was in episodes, or a file of `read_trajectories`.

    Returns:
        What closes the page: call its `close`, or its `wait` to wait for Ctrl-C. Its `show` puts
        another grid on the page, and its `url` says where that is.

    Raises:
        MissingDependencyError: viser is not installed.
        QueryError: the scene isn't the one that the grid was baked from.
        SceneError, ConfigError, FormatError: scene, settings or grid can't be read.
        NavbakeError: the port is in use.

    Example:
        >>> import navbake
        >>> grid = navbake.bake("my_scene.xml")
        >>> navbake.view(grid, scene="my_scene.xml").wait()
    """
    more: Any = {"episodes": episodes, "trajectories": trajectories}
    exhibit = make_exhibit(grid, scene, data=data, force=force, **more)
    viewer = Viewer(exhibit, PageServer(host, port, allowed=allow_origin))
    if open_page:
        viewer.open()
    return viewer


def make_exhibit(
    grid: NavGrid | str | PathLike[str],
    scene: Any = None,
    *,
    data: Any = None,
    force: bool = False,
    episodes: EpisodeSet | str | PathLike[str] | None = None,
    trajectories: Sequence[Trajectory] | str | PathLike[str] = (),
) -> Exhibit:
    """What is shown of a grid and its scene; takes and raises what `view` does."""
    # loads MuJoCo, which a page without a scene could do without
    from navbake.verifier.source import NoSceneError, find_source

    path = None if isinstance(grid, GridBase) else Path(grid)
    content: Any = grid if path is None else read_navgrid(path)
    if isinstance(episodes, str | PathLike):
        episodes = read_episodes(episodes)
    if isinstance(trajectories, str | PathLike):
        trajectories = read_trajectories(trajectories)
    runs = list_runs(content, episodes, trajectories)
    try:
        shown, config, notes = find_source(content, scene, path, force=force, data=data)
    except NoSceneError as error:
        if scene is not None:
            raise
        return Exhibit(content, note=f"Without its scene: {error}", runs=runs)
    note = "; ".join(notes) if content.navbake else ""
    return Exhibit(content, shown, config, note=note, runs=runs)


def watch_grid(grid: str | PathLike[str], scene: str | PathLike[str] | None, **more: Any) -> Watch:
    """Reads the exhibit of a grid's file, again when grid or scene change."""
    named = [Path(path) for path in (grid, scene) if path is not None]
    return Watch(lambda: make_exhibit(grid, scene, **more), lambda: find_files(named))


def find_files(paths: Iterable[Path]) -> list[Path]:
    """Files and all that scenes among them name; of a missing file, all places it may be at."""
    found = (find_inputs(path, looks=True, missing=True) for path in paths)
    return [*dict.fromkeys(path for of_one in found for path in of_one)]


class Watch:
    """Notices when files have changed and rest again, from when it is made.

    `read` reads or bakes the exhibit; `files` is called again after each change, for a scene
    may name others then.
    """

    def __init__(self, read: Callable[[], Exhibit], files: Callable[[], Iterable[Path]]) -> None:
        self.read = read
        self._list_files = files
        self._known = self._last = self._state_of(files())

    def _state_of(self, files: Iterable[Path]) -> dict[Path, tuple[int, int] | None]:
        """When each file was written, and its size; None for one that isn't there."""
        state: dict[Path, tuple[int, int] | None] = dict.fromkeys(files)
        for path in state:
            with suppress(OSError, ValueError):  # ValueError: a name with a NUL
                status = os.stat(path)
                state[path] = status.st_mtime_ns, status.st_size
        return state

    def look(self) -> bool:
        """Whether the files are others than when this was last true, and as at the last look."""
        now = self._state_of(self._known)
        rests = now == self._last
        self._last = now
        if not rests or now == self._known:
            return False
        self._known = self._last = self._state_of(self._list_files())
        return True
