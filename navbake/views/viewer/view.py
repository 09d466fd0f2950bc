"""`navbake.view`: shows a grid in its scene, in the browser."""

from __future__ import annotations

import io
import logging
import math
import os
import re
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from functools import partial
from itertools import product
from os import PathLike
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import numpy as np
from PIL import Image

from navbake.episodes.episode import EpisodeSet, list_goal_positions
from navbake.episodes.files import read_episodes
from navbake.errors import NavbakeError
from navbake.formats.flights import read_flight
from navbake.formats.navgrid import read_navgrid
from navbake.formats.scene_files import find_inputs
from navbake.formats.voxels import read_voxels
from navbake.mujoco_types import MjDataLike
from navbake.navgrid.colors import STAND, rgb_of
from navbake.navgrid.grid import GridBase, NavGrid
from navbake.runtime.paths import Path as Route
from navbake.scores import Trajectory, read_trajectories
from navbake.types import Float
from navbake.views.viewer.controls import Change, Controls, format_error
from navbake.views.viewer.meshes import Reals, ViewRay
from navbake.views.viewer.server import (
    DARK,
    HOST,
    LIGHT,
    PAGE_KEY,
    PORT,
    SYSTEM_KEY,
    PageServer,
)
from navbake.views.viewer.view_state import (
    GOAL_COLOR,
    HIGHLIGHT_COLOR,
    START_COLOR,
    TRAJECTORY_COLOR,
    Choices,
    Inspection,
    NameLabel,
    StandView,
    ViewState,
    VisibleBatch,
    first_choices,
    list_runs,
    transfer_choices,
)
from navbake.voxels.finder import FlightPath
from navbake.voxels.grid import VoxelGrid

if TYPE_CHECKING:
    import viser
    from typing_extensions import Unpack

    from navbake.baker.scene.model import SceneInput


class Shadows(TypedDict):
    """Whether a node of viser's scene casts and receives shadows."""

    cast_shadow: bool
    receive_shadow: bool


NO_SHADOWS: Shadows = {"cast_shadow": False, "receive_shadow": False}
# without viser's logo, and without a way to share the page with others
THEME: Any = {"show_logo": False, "show_share_button": False, "control_width": "medium"}
PATH_LIFT = 0.06  # height of drawn lines over their positions [m]
REGION_LIFT = 0.03  # height of shaded cells over the floor [m]
# the line of a pose's arrow: ahead and to the left of its position [m]
ARROW = ((0.0, 0.0), (0.25, 0.0), (0.17, 0.06), (0.25, 0.0), (0.17, -0.06))
PATH_WIDTH = 5.0  # width of drawn lines [pixels]
MARK_SHARE = 1 / 180  # radius of a mark, relative to the diagonal of the grid
MIN_MARK_RADIUS = 0.06  # [m]
MAX_MARK_RADIUS = 0.5  # [m]
CELL_POLE = np.array([[0, 0, 0], [0, 0, 1.3]])  # ends of a line up from the inspected cell [m]
HIGHLIGHT_MARGIN = 0.006  # a highlight is larger than its object by this on each side [m]
CAMERA_ELEVATION = math.radians(58)  # angle at which the first camera looks down [rad]
FIELD_OF_VIEW = math.radians(45)  # vertical angle of the first camera [rad]
USUAL_ASPECT = 1.2  # a page's usual width, divided by its height
CAMERA_MARGIN = 1.08  # factor by which the first camera is farther away than need be
STORAGE_TIMEOUT = 5.0  # how long a browser may take to say what it stores [s]
RENDER_TIMEOUT = 60.0  # how long it may take to draw a picture [s]
LOG = logging.getLogger("navbake")
WATCH_PERIOD = 0.5  # time between two checks of files [s]


class ShownBeside(TypedDict, total=False):
    """What the viewer shows beside the grid and its scene, or the paths of the files."""

    episodes: EpisodeSet | str | PathLike[str] | None  #: A set of episodes.
    trajectories: Sequence[Trajectory] | str | PathLike[str]
    """An agent's trajectories in episodes; a file is one that `read_trajectories` reads."""
    voxels: VoxelGrid | str | PathLike[str] | None
    """Voxels, drawn up to a height that the reader chooses."""
    flight: FlightPath | str | PathLike[str] | None
    """A path of a ball through voxels, as a tube; a file is JSON that `FlightPath.save` wrote."""


class Mark(NamedTuple):
    """A place on the floor that is marked by a ball."""

    position: Sequence[float]  # world x, y, z [m]
    color: str


class Line(NamedTuple):
    """A line that is drawn above the floor."""

    positions: Float  # world frame, shape (n, 3) [m]
    color: str


def _draw_arrow(position: Float, heading: float) -> Float:
    """Return the line of an arrow from a position along a heading [rad]: shape (5, 3) [m]."""
    cos = math.cos(heading)
    sin = math.sin(heading)
    offsets = [(cos * ahead - sin * left, sin * ahead + cos * left, 0.0) for ahead, left in ARROW]
    return np.asarray(position + np.array(offsets))


class ShownNodes(NamedTuple):
    """Nodes of viser's scene that were drawn together, and the value for which they were drawn."""

    key: object  # the nodes are replaced when this value changes
    nodes: list[viser.SceneNodeHandle]


def find_camera(bounds: Float, aspect: float) -> Float:
    """Place a camera that looks at a box from -y and above, so that the box fills the page.

    Args:
        bounds: lower and upper corner of the box, world frame [m], shape (2, 3).
        aspect: the page's width divided by its height.

    Returns:
        The camera's position, world x, y, z [m].
    """
    middle = bounds.mean(axis=0)
    # directions from the box to the camera, and up on the page
    to_camera = np.array([0.0, -math.cos(CAMERA_ELEVATION), math.sin(CAMERA_ELEVATION)])
    up_direction = np.array([0.0, math.sin(CAMERA_ELEVATION), math.cos(CAMERA_ELEVATION)])
    corners = np.array(list(product(*bounds.T))) - middle
    half_view_slope = math.tan(FIELD_OF_VIEW / 2)
    # the distance at which each corner is at the side, and at the top or bottom, of the page
    horizontal_distances = np.abs(corners[:, 0]) / (half_view_slope * aspect)
    vertical_distances = np.abs(corners @ up_direction) / half_view_slope
    distance = (np.maximum(horizontal_distances, vertical_distances) + corners @ to_camera).max()
    camera_position: Float = middle + max(float(distance), 1.0) * CAMERA_MARGIN * to_camera
    return camera_position


class Viewer(AbstractContextManager["Viewer"]):
    """A page that shows a grid until it is closed; a with statement closes it at its end.

    The server's threads put the user's changes into a queue. One thread of the viewer applies all
    changes in the queue, then draws once. So of a dragged slider, only the latest position is
    drawn.

    Attributes:
        url: the address of the page.
    """

    def __init__(
        self, view_state: ViewState, page: PageServer, *, watch: Watch | None = None
    ) -> None:
        """Show a grid on a page.

        Args:
            view_state: the grid and its scene.
            page: an empty page.
            watch: reads the grid again when its files change; None for never.
        """
        self._page = page
        self._server = page.viser
        self.url = page.url
        self._view_state = view_state
        self._choices = first_choices(view_state.grid)
        self._changes: SimpleQueue[Change | None] = SimpleQueue()  # None at the end
        self._closed = threading.Event()
        self._scene = self._server.scene
        self._shown: dict[str, ShownNodes] = {}  # by name
        self._scene_key: object = None  # what the scene was last drawn for
        self._dark_clients: set[int] = set()  # ids of the clients whose page is dark
        self._scene.set_up_direction("+z")
        self._scene.world_axes.visible = False
        self._scene.configure_default_lights(cast_shadow=False)
        self._make_panel()
        self._set_camera(view_state.bounds)
        self._scene.on_click()(self._on_click)
        self._server.gui.configure_theme(dark_mode=False, **THEME)
        self._server.on_client_connect(self._greet)
        clear_command = self._server.gui.add_command("Clear what was clicked", hotkey="escape")
        clear_command.on_trigger(lambda _: self._changes.put(Choices.without_clicks))
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()
        if watch is not None:
            threading.Thread(target=self._watch, args=(watch,), name="watch", daemon=True).start()

    def show(
        self,
        grid: NavGrid | str | PathLike[str],
        scene: SceneInput | None = None,
        *,
        data: MjDataLike | None = None,
        force: bool = False,
        **beside: Unpack[ShownBeside],
    ) -> None:
        """Replace the grid on the page; arguments and errors are those of `view`."""
        view_state = make_view_state(grid, scene, data=data, force=force, **beside)
        self._show_view_state(view_state)

    def open(self) -> None:
        """Open the page in this machine's browser; on Linux without a display, do nothing."""
        has_windows = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
        # without windows, Python would start a browser in the terminal
        if has_windows or not sys.platform.startswith("linux"):
            webbrowser.open(self.url)

    def wait(self) -> None:
        """Wait until the page is closed; Ctrl-C closes it."""
        try:
            while not self._closed.wait(WATCH_PERIOD):
                pass
        finally:
            self.close()

    def close(self) -> None:
        """Close the page, and free its port."""
        if not self._closed.is_set():
            self._closed.set()
            self._changes.put(None)
            self._thread.join()
            self._page.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _set_camera(self, bounds: Float) -> None:
        """Point the first camera of each client at the grid, so that it fills the page."""
        position = find_camera(bounds, USUAL_ASPECT)
        camera = self._server.initial_camera
        camera.fov = FIELD_OF_VIEW
        camera.near = 0.05
        camera.far = 40 * max(float(position[2] - bounds[0, 2]), 1.0)
        camera.look_at = bounds.mean(axis=0)
        camera.position = position

        def fit_camera(client_camera: viser.CameraHandle) -> None:
            """Move a client's camera away if its page is narrow and it is where it began."""
            if client_camera.aspect < USUAL_ASPECT and np.allclose(
                client_camera.position, position, atol=0.01
            ):
                client_camera.position = find_camera(bounds, client_camera.aspect)
                client_camera.look_at = bounds.mean(axis=0)

        def on_connect(client: viser.ClientHandle) -> None:
            fit_camera(client.camera)
            client.camera.on_update(fit_camera)

        self._server.on_client_connect(on_connect)

    def _make_panel(self) -> None:
        """Make the panel of controls for the grid."""

        def verify(choices: Choices) -> Choices:
            self._controls.show_status("Comparing the grid with the scene…")
            self._view_state.verify()
            self._controls.show_status("")
            return choices

        gui = self._server.gui
        grid_name = self._view_state.grid.scene_id
        gui.set_panel_label(grid_name or "navbake")
        self._page.title = f"{grid_name} – navbake" if grid_name else "navbake"
        self._controls = Controls(
            gui,
            self._view_state,
            self._choices,
            change=self._changes.put,
            verify=lambda: self._changes.put(verify),
            switch_dark=self._switch_dark,
            save_picture=self._save_picture,
        )
        gui.main_panel.dock_right()  # beside the scene, not over it

    def _greet(self, client: viser.ClientHandle) -> None:
        """Make a new client's page dark if its reader wants that."""
        stored_values = []
        for key in (PAGE_KEY, SYSTEM_KEY):
            with suppress(RuntimeError, TimeoutError):  # it has gone, or stores nothing
                stored_values.append(client.local_storage.get_item(key, timeout=STORAGE_TIMEOUT))
        self._set_dark(client, is_dark=next(filter(None, stored_values), LIGHT) == DARK)

    def _set_dark(self, client: viser.ClientHandle, *, is_dark: bool) -> None:
        if is_dark:
            self._dark_clients.add(client.client_id)
        else:
            self._dark_clients.discard(client.client_id)
        client.gui.configure_theme(dark_mode=is_dark, **THEME)

    def _switch_dark(self, client: viser.ClientHandle) -> None:
        """Make the page of one client dark, or light again; its browser keeps that."""
        is_dark = client.client_id not in self._dark_clients
        client.local_storage.set_item(PAGE_KEY, DARK if is_dark else LIGHT)
        self._set_dark(client, is_dark=is_dark)

    def _save_picture(self, client: viser.ClientHandle) -> None:
        """Send a client a PNG of the scene as it sees it."""
        pixels = client.get_render(
            client.camera.image_height,
            client.camera.image_width,
            transport_format="png",
            timeout=RENDER_TIMEOUT,
        )
        scene_image = Image.fromarray(pixels).convert("RGBA")
        picture = Image.new("RGBA", scene_image.size, "white")
        picture.alpha_composite(scene_image)
        picture_file = io.BytesIO()
        picture.convert("RGB").save(picture_file, "PNG")
        name = re.sub(r"[^\w.-]+", "_", self._view_state.grid.scene_id or "grid")
        client.send_file_download(f"{name}.png", picture_file.getvalue(), save_immediately=True)

    def _on_click(self, event: viser.SceneClickEvent) -> None:
        ray = ViewRay(event.ray_origin, event.ray_direction)
        self._changes.put(lambda choices: self._view_state.click(choices, ray))

    def _show_view_state(self, view_state: ViewState) -> None:
        """Show another grid; may be called from any thread.

        The user's choices stay, as far as the new grid has what they name.
        """

        def change(choices: Choices) -> Choices:
            self._view_state = view_state
            self._choices = transfer_choices(choices, view_state.grid)
            for name in list(self._shown):
                self._replace_nodes(name, None, list)
            self._scene_key = None
            self._make_panel()
            return self._choices

        self._changes.put(change)

    def _run(self) -> None:
        """Apply all waiting changes, draw, and wait for the next change; return after a None."""
        changes: list[Change | None] = []
        while None not in changes:
            for change in [*changes, self._draw]:
                try:  # an error is shown, and the page stays
                    if change is not None:
                        self._choices = change(self._choices)
                except Exception as error:
                    if not isinstance(error, NavbakeError):
                        LOG.exception("the viewer failed")
                    self._controls.show_status(format_error(error))
            changes = [self._changes.get()]
            while not self._changes.empty():
                changes.append(self._changes.get())

    def _draw(self, choices: Choices) -> Choices:
        """Draw the page for the choices, and return them; only what has changed is sent."""
        view_state = self._view_state
        route = view_state.route(choices)
        inspection = view_state.inspect(choices)
        stand_view = view_state.stands(choices)
        with self._server.atomic():
            self._draw_grid(choices)
            self._draw_route(choices, route)
            self._draw_run(choices)
            self._draw_flights(choices)
            self._draw_inspection(inspection)
            self._draw_stands(stand_view)
            self._controls.update(choices, route, inspection, stand_view)
        self._draw_scene(choices)
        return choices

    def _draw_scene(self, choices: Choices) -> None:
        """Draw the scene, which takes longer than all else."""
        scene_key = (
            id(self._view_state),
            choices.doors,
            choices.with_hidden,
            choices.with_scene,
            choices.with_voxels,
            choices.cut,
        )
        if scene_key == self._scene_key:
            return
        self._controls.show_status("Drawing the scene…")
        self._server.flush()
        self._replace_glb("/scene", self._view_state.scene_glb(choices))
        visible_batches = self._view_state.batches(choices)
        self._replace_nodes("/batches", scene_key, lambda: map(self._add_batch, visible_batches))
        self._replace_glb("/voxels", self._view_state.voxel_glb(choices))
        self._scene_key = scene_key
        self._controls.show_status("")

    def _draw_grid(self, choices: Choices) -> None:
        """Draw the shown levels with their names and the arcs of links."""
        view_state = self._view_state
        for level_number in range(len(view_state.grid.levels)):
            overlay = (
                view_state.overlay(choices, level_number) if level_number in choices.levels else b""
            )
            self._replace_glb(f"/grid/{level_number}", overlay)
        names = view_state.names(choices)
        self._replace_nodes("/names", names, lambda: map(self._add_name, names))
        arcs = view_state.arcs(choices)
        stop_marks = [
            Mark(arc.points[end_index], arc.color) for arc in arcs for end_index in (0, -1)
        ]
        lines = [Line(arc.points, arc.color) for arc in arcs]
        radius = self._mark_radius() / 2
        self._replace_nodes(
            "/links",
            id(arcs),
            lambda: self._add_marks_and_lines("/links", stop_marks, lines, radius),
        )

    def _draw_route(self, choices: Choices, route: Route | str | None) -> None:
        """Draw the path between two clicks, and marks where they were."""
        marks = []
        if choices.start is not None:
            marks.append(Mark(choices.start.position, START_COLOR))
        if choices.goal is not None:
            marks.append(Mark(choices.goal.position, GOAL_COLOR))
        positions = route.positions if isinstance(route, Route) else np.empty((0, 3))
        lines = [Line(positions, GOAL_COLOR)]
        radius = self._mark_radius()
        self._replace_nodes(
            "/path",
            repr((marks, lines, radius)),
            lambda: self._add_marks_and_lines("/path", marks, lines, radius),
        )

    def _draw_run(self, choices: Choices) -> None:
        """Draw the start, goals and path of the chosen episode, and an agent's trajectory in it."""
        path = self._view_state.episode_path(choices)
        marks = []
        lines = []
        episode_run = self._view_state.runs.get(choices.episode)
        is_flight = self._view_state.shown_flight_episode(choices) is not None
        if episode_run is not None and episode_run.episode is not None and not is_flight:
            marks.append(Mark(episode_run.episode.start, START_COLOR))
            marks += [Mark(goal, GOAL_COLOR) for goal in list_goal_positions(episode_run.episode)]
            lines.append(Line(path, GOAL_COLOR))
            lines += [
                Line(_draw_arrow(np.array(view_point.position), view_point.heading), STAND)
                for goal in episode_run.episode.goals
                if goal.stance is not None
                for view_point in goal.view_points
            ]
        if episode_run is not None and episode_run.trajectory is not None:
            trajectory = np.array(episode_run.trajectory.positions).reshape(-1, 3)
            lines.append(Line(trajectory, TRAJECTORY_COLOR))
        radius = self._mark_radius()
        self._replace_nodes(
            "/run",
            (id(self._view_state), choices.episode, path.tobytes()),
            lambda: self._add_marks_and_lines("/run", marks, lines, radius),
        )

    def _draw_flights(self, choices: Choices) -> None:
        """Draw the flight, and that of the chosen episode."""
        glbs = self._view_state.flight_glbs(choices)
        self._replace_nodes(
            "/flights",
            (id(self._view_state), choices.episode),
            lambda: [
                self._scene.add_glb(f"/flights/{index}", glb, **NO_SHADOWS)
                for index, glb in enumerate(glbs)
            ],
        )

    def _draw_inspection(self, inspection: Inspection | None) -> None:
        """Draw the outline of the inspected cell, and highlight the objects that block it."""
        corners: Reals = np.empty((0, 3))
        lines = []
        outline_key = b""
        if inspection is not None:
            corners = inspection.highlighted.reshape(-1, 3)
            outline_key = inspection.outline.tobytes()
            # the pole is seen where furniture hides the cell
            pole_ends = inspection.outline[:4].mean(axis=0) + CELL_POLE
            lines = [Line(inspection.outline, HIGHLIGHT_COLOR), Line(pole_ends, HIGHLIGHT_COLOR)]
        self._replace_nodes("/lit", corners.tobytes(), lambda: self._add_highlight("/lit", corners))
        self._replace_nodes(
            "/cell", outline_key, lambda: self._add_marks_and_lines("/cell", [], lines, radius=0)
        )

    def _draw_stands(self, stand_view: StandView | None) -> None:
        """Draw where a base can stand to reach the clicked thing, and highlight that thing."""
        marks: list[Mark] = []
        lines: list[Line] = []
        region: Float = np.empty((0, 4, 3))
        corners: Reals = np.empty((0, 3))
        if stand_view is not None:
            poses = stand_view.poses
            marks = [Mark(position, STAND) for position in poses.positions.tolist()]
            lines = [
                Line(_draw_arrow(position, heading), STAND)
                for position, heading in zip(poses.positions, poses.headings.tolist(), strict=True)
            ]
            region = stand_view.region
            corners = stand_view.highlighted.reshape(-1, 3)
        self._replace_nodes(
            "/reached", corners.tobytes(), lambda: self._add_highlight("/reached", corners)
        )
        self._replace_nodes("/region", region.tobytes(), lambda: self._add_region(region))
        radius = self._mark_radius() / 2
        self._replace_nodes(
            "/poses",
            repr((marks, lines)),
            lambda: self._add_marks_and_lines("/poses", marks, lines, radius),
        )

    def _mark_radius(self) -> float:
        """Return the radius of marks [m]; it is larger on a larger grid."""
        low_corner, high_corner = self._view_state.bounds
        radius = np.linalg.norm(high_corner - low_corner) * MARK_SHARE
        return float(np.clip(radius, MIN_MARK_RADIUS, MAX_MARK_RADIUS))

    def _replace_nodes(
        self, name: str, key: object, add_nodes: Callable[[], Iterable[viser.SceneNodeHandle]]
    ) -> None:
        """Replace the nodes under a name if the key has changed.

        Args:
            name: the name.
            key: a value that changes whenever the nodes must change.
            add_nodes: adds the new nodes to the scene.
        """
        shown_nodes = self._shown.get(name, ShownNodes(None, []))
        if shown_nodes.key != key:
            for node in shown_nodes.nodes:
                node.remove()
            self._shown[name] = ShownNodes(key, list(add_nodes()))

    def _replace_glb(self, name: str, content: bytes) -> None:
        """Replace the node of a GLB under a name if its content has changed.

        If the content is empty, the node is removed.
        """
        shown_nodes: Any = self._shown.get(name, ShownNodes(b"", []))
        if content and shown_nodes.nodes and content is not shown_nodes.key:
            # the node stays, so that nothing flickers
            shown_nodes.nodes[0].glb_data = content
            self._shown[name] = ShownNodes(content, shown_nodes.nodes)
            return

        def add_glb() -> Iterator[viser.SceneNodeHandle]:
            if content:
                yield self._scene.add_glb(name, content, **NO_SHADOWS)

        self._replace_nodes(name, content, add_glb)

    def _add_batch(self, visible: VisibleBatch) -> viser.SceneNodeHandle:
        """Add the mesh of a batch at the pose of each of its geoms that is drawn."""
        batch = visible.batch
        lod: Any = tuple((step.distance, step.share) for step in batch.lod) or "off"
        return self._scene.add_batched_glb(
            f"/batches/{batch.geoms[0]}",
            batch.content,
            batch.rotations[visible.is_drawn],
            batch.positions[visible.is_drawn],
            lod=lod,
            **NO_SHADOWS,
        )

    def _add_name(self, name: NameLabel) -> viser.SceneNodeHandle:
        """Add a name to the scene; objects before it hide it."""
        return self._scene.add_label(
            "/names/{}/{}/{}".format(*name.position),
            name.text,
            position=name.position,
            anchor="center-center",
            depth_test=True,
            font_size_mode="scene",
            font_scene_height=name.height,
        )

    def _add_marks_and_lines(
        self, name: str, marks: Sequence[Mark], lines: Sequence[Line], radius: float
    ) -> Iterator[viser.SceneNodeHandle]:
        """Add balls at marks, and lines, to the scene.

        Args:
            name: the names of the nodes begin with this.
            marks: the marks.
            lines: the lines; those of less than two positions are left out.
            radius: the radius of the balls [m].

        Yields:
            The nodes.
        """
        for index, mark in enumerate(marks):
            x, y, z = mark.position
            yield self._scene.add_icosphere(
                f"{name}/{index}",
                radius,
                rgb_of(mark.color),
                position=(x, y, z + radius),
                **NO_SHADOWS,
            )
        for index, line in enumerate(lines):
            if len(line.positions) < 2:
                continue
            lifted_positions = line.positions + np.array([0, 0, PATH_LIFT])
            yield self._scene.add_line_segments(
                f"{name}/line {index}",
                np.stack([lifted_positions[:-1], lifted_positions[1:]], axis=1).astype(np.float32),
                rgb_of(line.color),
                thickness=PATH_WIDTH,
                thickness_units="screen",
            )

    def _add_region(self, region: Float) -> Iterator[viser.SceneNodeHandle]:
        """Shade cells on the floor.

        Args:
            region: the corners of the cells, world frame [m], shape (n, 4, 3).

        Yields:
            The node; nothing without cells.
        """
        if not len(region):
            return
        first_corners = 4 * np.arange(len(region))[:, None, None]
        yield self._scene.add_mesh_simple(
            "/region/0",
            region.reshape(-1, 3) + np.array([0.0, 0.0, REGION_LIFT]),
            (first_corners + np.array([[0, 2, 1], [0, 3, 2]])).reshape(-1, 3),
            color=rgb_of(STAND),
            opacity=0.5,
            flat_shading=True,
            side="double",
            **NO_SHADOWS,
        )

    def _add_highlight(self, name: str, corners: Reals) -> Iterator[viser.SceneNodeHandle]:
        """Add triangles over the highlighted objects, a little larger than these.

        Args:
            name: the node's name begins with this.
            corners: the corners of the triangles, three rows for each, world frame [m], shape
                (3 n, 3).

        Yields:
            The node; nothing without triangles.
        """
        if not len(corners):
            return
        middle = corners.mean(axis=0)
        half_size = np.maximum(np.abs(corners - middle).max(axis=0), HIGHLIGHT_MARGIN)
        yield self._scene.add_mesh_simple(
            f"{name}/0",
            middle + (corners - middle) * (1 + HIGHLIGHT_MARGIN / half_size),
            np.arange(len(corners)).reshape(-1, 3),
            color=rgb_of(HIGHLIGHT_COLOR),
            opacity=0.75,
            flat_shading=True,
            side="double",
            **NO_SHADOWS,
        )

    def _watch(self, watch: Watch) -> None:
        """Read the grid again and show it whenever its files have changed.

        After an error, the page keeps the previous grid.
        """

        def announce_change(choices: Choices) -> Choices:
            self._controls.show_status("Files have changed: baking again…")
            return choices

        def raise_error(error: Exception, _: Choices) -> Choices:
            raise error

        while not self._closed.wait(WATCH_PERIOD):
            try:
                if watch.has_changed():
                    self._changes.put(announce_change)
                    self._show_view_state(watch.read())
            except Exception as error:  # the next version of the files may be right again
                self._changes.put(partial(raise_error, error))


def view(
    grid: NavGrid | str | PathLike[str],
    scene: SceneInput | None = None,
    *,
    data: MjDataLike | None = None,
    host: str = HOST,
    port: int = PORT,
    open_page: bool = True,
    force: bool = False,
    allow_origin: Sequence[str] = (),
    **beside: Unpack[ShownBeside],
) -> Viewer:
    """Show a grid in its scene, in the browser; see ``docs/viewer.md``.

    The page is served on this machine alone unless `host` says otherwise, and loads nothing from
    the network.

    Args:
        grid: a grid of one or several levels, or the path of its file.
        scene: the scene of the grid: a mujoco.MjModel or MjSpec, a trimesh.Scene or Trimesh,
            settings, or the path of a scene or YAML. None for the file that the grid names; it is
            looked for beside the grid, in the current folder, and in ``scenes`` there. If it isn't
            found, the grid is shown without a scene.
        data: the mujoco.MjData with the pose of a model or spec.
        host: the address of this machine to listen at.
        port: the port to listen at, 0 to 65535; 0 for any free port.
        open_page: whether to open the page in the browser.
        force: whether to show the grid even in a scene that it was not baked from.
        allow_origin: further addresses at which browsers may show the page, such as that of a
            proxy: ``https://lab.example.org``.
        beside: ``episodes``, ``trajectories``, ``voxels`` and ``flight`` to show, each in memory or
            the path of its file, see `ShownBeside`.

    Returns:
        A viewer. Its `close` closes the page, `wait` waits for Ctrl-C, `show` replaces the grid on
        the page, and `url` is the page's address.

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
    view_state = make_view_state(grid, scene, data=data, force=force, **beside)
    viewer = Viewer(view_state, PageServer(host, port, allowed=allow_origin))
    if open_page:
        viewer.open()
    return viewer


def make_view_state(
    grid: NavGrid | str | PathLike[str],
    scene: SceneInput | None = None,
    *,
    data: MjDataLike | None = None,
    force: bool = False,
    **beside: Unpack[ShownBeside],
) -> ViewState:
    """Read the grid, scene, episodes, trajectories, voxels and flight that the viewer shows.

    The arguments and errors are those of `view`.
    """
    # loads MuJoCo, which a page without a scene doesn't need
    from navbake.verifier.source import NoSceneError, find_source

    path = None
    if not isinstance(grid, GridBase):
        path = Path(grid)
        grid = read_navgrid(path)
    make_state = _read_beside(grid, **beside)
    try:
        loaded_scene, config, notes = find_source(grid, scene, path, force=force, data=data)
    except NoSceneError as error:
        if scene is not None:
            raise
        note = f"Without its scene: {error}"
        return make_state(note=note)
    note = "; ".join(notes) if grid.navbake else ""
    return make_state(scene=loaded_scene, config=config, note=note)


def _read_beside(
    grid: NavGrid,
    *,
    episodes: EpisodeSet | str | PathLike[str] | None = None,
    trajectories: Sequence[Trajectory] | str | PathLike[str] = (),
    voxels: VoxelGrid | str | PathLike[str] | None = None,
    flight: FlightPath | str | PathLike[str] | None = None,
) -> partial[ViewState]:
    """Return a ViewState of a grid that only lacks the scene, with what is shown beside it.

    The arguments are those of `ShownBeside`.
    """
    if isinstance(episodes, str | PathLike):
        episodes = read_episodes(episodes)
    if isinstance(trajectories, str | PathLike):
        trajectories = read_trajectories(trajectories)
    if isinstance(voxels, str | PathLike):
        voxels = read_voxels(voxels)
    if isinstance(flight, str | PathLike):
        flight = read_flight(flight)
    runs = list_runs(grid, episodes, trajectories)
    return partial(ViewState, grid, runs=runs, episodes=episodes, voxels=voxels, flight=flight)


def watch_grid(
    grid: str | PathLike[str],
    scene: str | PathLike[str] | None,
    *,
    force: bool = False,
    **beside: Unpack[ShownBeside],
) -> Watch:
    """Watch the files of a grid and of its scene.

    Args:
        grid: the grid's file.
        scene: the scene's file, None for the one that the grid names.
        force: whether to show the grid even in a scene that it was not baked from.
        beside: what is shown beside the grid, or its files.

    Returns:
        A watch whose `read` reads both again.
    """
    watched_paths = [Path(path) for path in (grid, scene) if path is not None]
    return Watch(
        lambda: make_view_state(grid, scene, force=force, **beside),
        lambda: find_watched_files(watched_paths),
    )


def find_watched_files(paths: Iterable[Path]) -> list[Path]:
    """List files, and all files that the scenes among them refer to; each is listed once.

    For a missing file, every path at which it is looked for is listed.
    """
    watched_paths: dict[Path, None] = {}
    for path in paths:
        watched_paths |= dict.fromkeys(find_inputs(path, with_textures=True, with_missing=True))
    return list(watched_paths)


class FileState(NamedTuple):
    """The time of change and the size of a file, by which a write is noticed."""

    modified_ns: int  # time of the last change [ns]
    size: int  # [bytes]


class Watch:
    """Notices that files have changed, once no program writes into them any more.

    Changes before the object is made don't count.
    """

    def __init__(self, read: Callable[[], ViewState], files: Callable[[], Iterable[Path]]) -> None:
        """Begin to watch files.

        Args:
            read: reads or bakes the grid. It isn't called here, but by users of the object.
            files: lists the files to watch. It is called again after each change, because a scene
                may then name other files.
        """
        self.read = read
        self._list_files = files
        self._reported = _read_states(files())  # after the last change that was reported
        self._previous = self._reported  # at the last call of `has_changed`

    def has_changed(self) -> bool:
        """Return whether files have changed since the last call that returned True.

        True is returned once for each change, and only when the files are the same as at the
        previous call: then no program writes into them any more.
        """
        current_states = _read_states(self._reported)
        is_stable = current_states == self._previous
        self._previous = current_states
        if not is_stable or current_states == self._reported:
            return False
        self._reported = _read_states(self._list_files())
        self._previous = self._reported
        return True


def _read_states(files: Iterable[Path]) -> dict[Path, FileState | None]:
    """Read the states of files: path -> state, None for a missing file."""
    state_of_file: dict[Path, FileState | None] = dict.fromkeys(files)
    for path in state_of_file:
        with suppress(OSError, ValueError):  # ValueError: a name with a NUL
            file_status = os.stat(path)
            state_of_file[path] = FileState(file_status.st_mtime_ns, file_status.st_size)
    return state_of_file
