"""The page of a viewer: its scene, and one thread that brings it up to date."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterable
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from navbake.errors import NavbakeError
from navbake.navgrid.colors import ROUTE, rgb_of
from navbake.types import Float
from navbake.views.viewer import texts
from navbake.views.viewer.controls import Change, Controls, set_theme
from navbake.views.viewer.exhibit import (
    Choices,
    Exhibit,
    Route,
    Told,
    first_choices,
    keep_choices,
)
from navbake.views.viewer.overlay import draw_surfaces, floor_under

if TYPE_CHECKING:
    import viser

LOG = logging.getLogger("navbake")

SCENE, GRID, NAMES, PATH, LIT = "/scene", "/grid", "/names", "/path", "/lit"
START_COLOR, GOAL_COLOR, LIT_COLOR = (47, 158, 68), rgb_of(ROUTE), (255, 146, 43)
PATH_LIFT = 0.06  # of a path over the floor [m]
PATH_WIDTH = 5.0  # [pixels]
MARK = 1 / 180  # radius of a mark, by the diagonal of the grid
MARK_RADII = 0.06, 0.5  # least and greatest [m]
GROWN = 0.006  # by which what is lit is larger than it is, so that it is seen [m]
MOST_NAMES = 250  # names that are written at most, the largest rooms' first
ELEVATION = math.radians(58)  # of the first camera over the horizon
FIELD_OF_VIEW = math.radians(45)
USUAL_ASPECT = 1.2
MARGIN = 1.08  # by which the first camera is farther away than the box needs


def find_camera(bounds: Float, aspect: float) -> Float:
    """Where a box fills the page that is looked at from the south and above, shape (3,) [m].

    Args:
        bounds: lower and upper corner of the box, shape (2, 3) [m].
        aspect: width of the page by its height.
    """
    middle = bounds.mean(axis=0)
    away = np.array([0.0, -math.cos(ELEVATION), math.sin(ELEVATION)])
    up = np.array([0.0, math.sin(ELEVATION), math.cos(ELEVATION)])
    corners = np.array(list(product(*bounds.T))) - middle
    slope = math.tan(FIELD_OF_VIEW / 2)
    across, along = np.abs(corners[:, 0]) / (slope * aspect), np.abs(corners @ up) / slope
    distance = (np.maximum(across, along) + corners @ away).max()
    place: Float = middle + max(float(distance), 1.0) * MARGIN * away
    return place


class Stage:
    """What is on the page of an exhibit; only what has changed is sent."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._shown: dict[str, Any] = {}
        self._nodes: dict[str, Any] = {}
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        server.scene.configure_default_lights(cast_shadow=False)

    def place_camera(self, bounds: Float) -> None:
        """Look at a box from the south and above, so that it fills the usual page."""
        camera = self._server.initial_camera
        place = find_camera(bounds, USUAL_ASPECT)
        camera.fov = FIELD_OF_VIEW
        camera.near, camera.far = 0.05, 40 * max(float(place[2] - bounds[0, 2]), 1.0)
        camera.look_at = bounds.mean(axis=0)
        camera.position = place

    def fit_camera(self, client: viser.ClientHandle, bounds: Float) -> None:
        """Move the first camera of a page that is narrower than usual."""
        if client.camera.aspect < USUAL_ASPECT:
            client.camera.position = find_camera(bounds, client.camera.aspect)
            client.camera.look_at = bounds.mean(axis=0)

    def clear(self) -> None:
        """Take everything away."""
        for name in list(self._nodes):
            self._remove(name)
        self._shown.clear()

    def show(
        self, exhibit: Exhibit, chosen: Choices, route: Route | None, told: Told | None
    ) -> None:
        """Bring the page up to date."""
        surfaces = exhibit.surfaces(chosen)
        drawing = exhibit.drawing(chosen)
        textures = {} if drawing is None else drawing.textures
        self._update(SCENE, surfaces, lambda: draw_surfaces(surfaces, textures))
        for number in range(len(exhibit.grid.levels)):
            name = f"{GRID}/{number}"
            if number not in chosen.levels:
                self._update(name, (), bytes)
                continue
            overlay = exhibit.overlay(chosen, number)
            self._update(name, overlay, lambda overlay=overlay: overlay)  # type: ignore[misc]
        self._write_names(exhibit, chosen)
        self._draw_route(exhibit, chosen, route)
        self._light(told)

    def _update(self, name: str, content: Any, make: Callable[[], bytes]) -> None:
        """Put a GLB on the page, where it is another than before; empty content takes it away."""
        if self._shown.get(name) is content:
            return
        self._shown[name] = content
        if not content:
            self._remove(name)
        elif name in self._nodes:
            self._nodes[name].glb_data = make()
        else:
            self._nodes[name] = self._server.scene.add_glb(
                name, make(), cast_shadow=False, receive_shadow=False
            )

    def _remove(self, name: str) -> None:
        node = self._nodes.pop(name, None)
        if node is not None:
            node.remove()

    def _replace(self, name: str, key: Any, nodes: Callable[[], Iterable[Any]]) -> None:
        """Put other nodes under a name, where the key is another than before."""
        if name in self._shown and self._shown[name] == key:
            return
        self._shown[name] = key
        for old in [one for one in self._nodes if one.startswith(f"{name}/")]:
            self._remove(old)
        for number, node in enumerate(nodes()):
            self._nodes[f"{name}/{number}"] = node

    def _write_names(self, exhibit: Exhibit, chosen: Choices) -> None:
        names = []
        for number in chosen.levels if chosen.with_names else ():
            for label in exhibit.panel(chosen, number).labels:
                _, floor = floor_under(exhibit.grid, number, (label.x, label.y))
                z = floor if math.isfinite(floor) else exhibit.grid.levels[number].ground
                if not exhibit.is_covered(chosen, number, (label.x, label.y, z)):
                    names.append((-label.width, label.text, (label.x, label.y, z + 0.1)))
        chosen_names = sorted(names)[:MOST_NAMES]
        self._replace(
            NAMES,
            chosen_names,
            lambda: [
                self._server.scene.add_label(
                    f"{NAMES}/{number}", text, position=place, anchor="center-center"
                )
                for number, (_, text, place) in enumerate(chosen_names)
            ],
        )

    def _draw_route(self, exhibit: Exhibit, chosen: Choices, route: Route | None) -> None:
        low, high = exhibit.bounds
        radius = float(np.clip(np.linalg.norm(high - low) * MARK, *MARK_RADII))
        ends = [
            (found.position, color)
            for found, color in ((chosen.start, START_COLOR), (chosen.goal, GOAL_COLOR))
            if found is not None
        ]
        path = None if route is None else route.path
        scene = self._server.scene

        def draw() -> Iterable[Any]:
            for number, ((x, y, z), color) in enumerate(ends):
                yield scene.add_icosphere(
                    f"{PATH}/{number}",
                    radius,
                    color,
                    position=(x, y, z + radius),
                    cast_shadow=False,
                    receive_shadow=False,
                )
            if path is not None and len(path.positions) > 1:
                lifted = path.positions + np.array([0, 0, PATH_LIFT])
                points = np.stack([lifted[:-1], lifted[1:]], axis=1).astype(np.float32)
                yield scene.add_line_segments(
                    f"{PATH}/{len(ends)}",
                    points,
                    GOAL_COLOR,
                    thickness=PATH_WIDTH,
                    thickness_units="screen",
                )

        self._replace(PATH, (ends, id(path)), draw)

    def _light(self, told: Told | None) -> None:
        lit = None if told is None or not len(told.lit) else told.lit
        key = None if lit is None else lit.tobytes()

        def draw() -> Iterable[Any]:
            if lit is None:
                return
            corners = lit.reshape(-1, 3)
            middle = corners.mean(axis=0)
            half = np.maximum(np.abs(corners - middle).max(axis=0), GROWN)
            grown = middle + (corners - middle) * (1 + GROWN / half)
            yield self._server.scene.add_mesh_simple(
                f"{LIT}/0",
                grown,
                np.arange(len(grown)).reshape(-1, 3),
                color=LIT_COLOR,
                opacity=0.75,
                flat_shading=True,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )

        self._replace(LIT, key, draw)


class Page:
    """What the reader sees of an exhibit.

    What the reader does comes from threads of the server. It is collected, and one thread of the
    page's own works on all that has come, then shows the result once. So a slider that is dragged
    shows its latest place, not all that it passed.

    Args:
        server: of the page.
        exhibit: what is shown.
    """

    def __init__(self, server: viser.ViserServer, exhibit: Exhibit) -> None:
        self.server, self.exhibit = server, exhibit
        self.chosen = first_choices(exhibit.grid)
        self._changes: list[Change] = []
        self._wake = threading.Condition()
        self._is_done = False
        set_theme(server.gui, dark=False)
        self._stage = Stage(server)
        self._set_up(exhibit)
        self._stage.place_camera(exhibit.bounds)
        server.on_client_connect(lambda client: self._stage.fit_camera(client, exhibit.bounds))
        server.scene.on_click()(self._click)
        self._thread = threading.Thread(target=self._work, name="viewer", daemon=True)
        self._thread.start()

    def _set_up(self, exhibit: Exhibit) -> None:
        gui = self.server.gui
        gui.set_panel_label(exhibit.grid.scene_id or "navbake")
        self._controls = Controls(gui, exhibit, self.chosen, self.change, self._verify)
        gui.main_panel.dock_right()  # beside the scene, not over it

    def change(self, change: Change) -> None:
        """Change what is chosen, soon; from any thread."""
        with self._wake:
            self._changes.append(change)
            self._wake.notify_all()

    def exhibit_other(self, exhibit: Exhibit) -> None:
        """Show another exhibit with the same choices, as far as it has them; from any thread."""

        def take(chosen: Choices) -> Choices:
            self.exhibit, self.chosen = exhibit, keep_choices(chosen, exhibit.grid)
            self._stage.clear()
            self._set_up(exhibit)
            return self.chosen

        self.change(take)

    def say(self, text: str) -> None:
        """Write a line at the top of the panel; none if empty; from any thread."""
        self._do(lambda: self._controls.say(text))

    def _do(self, act: Callable[[], Any]) -> None:
        def keep(chosen: Choices) -> Choices:
            act()
            return chosen

        self.change(keep)

    def close(self) -> None:
        """End the page's thread."""
        with self._wake:
            self._is_done = True
            self._wake.notify_all()
        self._thread.join()

    def _click(self, event: viser.SceneClickEvent) -> None:
        ray = event.ray_origin, event.ray_direction
        self.change(lambda chosen: self.exhibit.click(chosen, ray))

    def _verify(self) -> None:
        def compare() -> None:
            self._controls.say("Comparing the grid with the scene…")
            self.exhibit.verify()
            self._controls.say("")

        self._do(compare)

    def _work(self) -> None:
        self._guarded(self._show)
        while True:
            with self._wake:
                if not self._changes:
                    self._wake.wait_for(lambda: self._is_done or bool(self._changes))
                if self._is_done:
                    return
                changes, self._changes = self._changes, []
            for change in changes:
                self._guarded(lambda change=change: self._apply(change))  # type: ignore[misc]
            self._guarded(self._show)

    def _apply(self, change: Change) -> None:
        self.chosen = change(self.chosen)

    def _show(self) -> None:
        exhibit, chosen = self.exhibit, self.chosen
        route, told = exhibit.route(chosen), exhibit.tell(chosen)
        with self.server.atomic():
            self._stage.show(exhibit, chosen, route, told)
            self._controls.show(chosen, route, told)

    def _guarded(self, act: Callable[[], None]) -> None:
        """Do something; an error is shown, and the page lives on."""
        try:
            act()
        except NavbakeError as error:
            self._controls.say(texts.say_error(error))
        except Exception as error:
            LOG.exception("the viewer failed to show something")
            self._controls.say(texts.say_error(error))
