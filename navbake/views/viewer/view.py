"""`navbake.view`: a grid in its scene, in the browser."""

from __future__ import annotations

import errno
import io
import logging
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout, suppress
from functools import partial
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from navbake.errors import MissingDependencyError, NavbakeError
from navbake.formats.navgrid import read_navgrid
from navbake.formats.scene_files import find_inputs
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.grid_base import GridBase
from navbake.views.viewer.controls import Change, Controls, say_error, set_theme
from navbake.views.viewer.exhibit import Choices, Exhibit, first_choices, keep_choices
from navbake.views.viewer.page import Stage

if TYPE_CHECKING:
    import viser
    from typing_extensions import Self

LOG = logging.getLogger("navbake")
MISSING = 'the viewer needs viser: pip install "navbake[view]"'
TAKEN = "port {1} of {0} is in use: choose another one by --port, or 0 for any free one"
HOST, PORT = "127.0.0.1", 8080
EVERYWHERE = ("0.0.0.0", "::", "")  # hosts that stand for all addresses of this machine
PERIOD = 0.5  # between two looks at files [s]


class Viewer:
    """A page that shows a grid, until it is closed; also as a context manager.

    What the reader does comes from threads of the server. It is collected, and one thread works on
    all that has come, then shows the result once. So a slider that is dragged shows its latest
    place, not all that it passed.

    Attributes:
        url: where the page is.
    """

    def __init__(
        self, exhibit: Exhibit, *, host: str = HOST, port: int = PORT, watch: Watch | None = None
    ) -> None:
        self._server = open_server(host, port)
        self.url = url_of(self._server)
        self._exhibit, self._chosen = exhibit, first_choices(exhibit.grid)
        self._changes: SimpleQueue[Change | None] = SimpleQueue()  # None at the end
        self._closed = threading.Event()
        set_theme(self._server.gui, dark=False)
        self._stage = Stage(self._server)
        self._set_up()
        self._stage.place_camera(exhibit.bounds)
        self._server.scene.on_click()(self._click)
        self._thread = threading.Thread(target=self._work, name="viewer", daemon=True)
        self._thread.start()
        if watch is not None:
            threading.Thread(target=self._watch, args=(watch,), name="watch", daemon=True).start()

    def show(
        self, grid: NavGrid | str | PathLike[str], scene: Any = None, *, data: Any = None
    ) -> None:
        """Show another grid on the page; takes what `view` takes."""
        self._show_other(make_exhibit(grid, scene, data=data))

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
            close_server(self._server)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _set_up(self) -> None:
        gui = self._server.gui
        gui.set_panel_label(self._exhibit.grid.scene_id or "navbake")
        change = self._changes.put
        self._controls = Controls(gui, self._exhibit, self._chosen, change, self._verify)
        gui.main_panel.dock_right()  # beside the scene, not over it

    def _click(self, event: viser.SceneClickEvent) -> None:
        ray = event.ray_origin, event.ray_direction
        self._changes.put(lambda chosen: self._exhibit.click(chosen, ray))

    def _verify(self) -> None:
        def compare(chosen: Choices) -> Choices:
            self._controls.say("Comparing the grid with the scene…")
            self._exhibit.verify()
            self._controls.say("")
            return chosen

        self._changes.put(compare)

    def _show_other(self, exhibit: Exhibit) -> None:
        """Show another exhibit with the same choices, as far as it has them; from any thread."""

        def take(chosen: Choices) -> Choices:
            self._exhibit, self._chosen = exhibit, keep_choices(chosen, exhibit.grid)
            self._stage.clear()
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
        route, told = self._exhibit.route(chosen), self._exhibit.tell(chosen)
        with self._server.atomic():
            self._stage.show(self._exhibit, chosen, route, told)
            self._controls.show(chosen, route, told)
        return chosen

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
) -> Viewer:
    """Show a grid in its scene, in the browser.

    The page has the levels, layers, doors, paths between clicks, and what blocks a cell; see
    ``docs/viewer.md``. It is served on this machine alone unless `host` says otherwise, and asks
    for nothing from anywhere else.

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
    viewer = Viewer(make_exhibit(grid, scene, data=data, force=force), host=host, port=port)
    if open_page:
        viewer.open()
    return viewer


def make_exhibit(
    grid: NavGrid | str | PathLike[str],
    scene: Any = None,
    *,
    data: Any = None,
    force: bool = False,
) -> Exhibit:
    """What is shown of a grid and its scene; takes and raises what `view` does."""
    # loads MuJoCo, which a page without a scene could do without
    from navbake.verifier.source import NoSceneError, find_source

    path = None if isinstance(grid, GridBase) else Path(grid)
    content: Any = grid if path is None else read_navgrid(path)
    try:
        source = find_source(content, scene, path, force=force, data=data)
    except NoSceneError as error:
        if scene is not None:
            raise
        return Exhibit(content, note=f"Without its scene: {error}")
    notes = source.notes if content.navbake else []
    config = source.config if source.are_known else None
    return Exhibit(content, source.scene, config, note="; ".join(notes))


def watch_grid(
    grid: str | PathLike[str], scene: str | PathLike[str] | None, *, force: bool = False
) -> Watch:
    """Reads the exhibit of a grid's file, again when grid or scene change."""
    named = [Path(path) for path in (grid, scene) if path is not None]
    return Watch(lambda: make_exhibit(grid, scene, force=force), lambda: find_files(named))


def find_files(paths: Iterable[Path]) -> list[Path]:
    """Files and, of scenes among them, all that these name: includes, meshes, textures, ….

    Of a file that isn't there, all places where it is looked for: somebody may put it there.
    """
    found = (find_inputs(path, looks=True, missing=True) for path in paths)
    return [*dict.fromkeys(path for of_one in found for path in of_one)]


class Watch:
    """Notices when files have changed and rest again: whoever writes them may take some time.

    Made before the files are read first, it misses no change meanwhile. `read` reads or bakes the
    exhibit; `list_files` is called again after each change, for a scene may name others then.
    """

    def __init__(
        self, read: Callable[[], Exhibit], list_files: Callable[[], Iterable[Path]]
    ) -> None:
        self.read, self._list_files = read, list_files
        self._known = self._last = self._state_of(list_files())

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
        rests, self._last = now == self._last, now
        if not rests or now == self._known:
            return False
        self._known = self._last = self._state_of(self._list_files())
        return True


# --- the web server: viser's, kept to this machine and quiet -------------------------------------


def open_server(host: str = HOST, port: int = PORT) -> viser.ViserServer:
    """Serve an empty page at an address of this machine; port 0 is any that is free."""
    check_viser()
    # viser takes the next free port, without a word, and waits forever for an unknown host
    check_address(host, port)
    import viser  # of the extra [view], and slow to load

    with redirect_stdout(io.StringIO()):  # viser prints its address in a box
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if port and server.get_port() != port:
        close_server(server)
        raise NavbakeError(TAKEN.format(host, port))
    # viser's own page can ask for a tunnel to its makers' server: nothing leaves this machine
    server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop serving, and free the port."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def url_of(server: viser.ViserServer) -> str:
    """The address of the page, for a browser on this machine."""
    host = "localhost" if server.get_host() in EVERYWHERE else server.get_host()
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"


def check_viser() -> None:
    """Raise where viser is not installed."""
    is_there = False
    with suppress(ImportError, ValueError):  # something keeps it from being found
        is_there = find_spec("viser") is not None
    if not is_there:
        raise MissingDependencyError(MISSING)


def check_address(host: str, port: int) -> None:
    """Raise where nothing can listen at an address now."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.getaddrinfo(host or None, port)  # whose error is another than that of a port
        socket.create_server((host, port), family=family).close()
    except (socket.gaierror, UnicodeError, OverflowError) as error:
        raise NavbakeError(f"{host!r}, port {port}, is no address of this machine") from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise NavbakeError(TAKEN.format(host, port)) from error
        raise NavbakeError(f"cannot listen at {host}, port {port}: {error.strerror}") from error
