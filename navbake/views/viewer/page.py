"""What is on the page of a viewer: the scene, the grid, names, a path."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from navbake.navgrid.colors import ROUTE, rgb_of
from navbake.runtime.paths import Path
from navbake.types import Float, Json
from navbake.views.viewer.exhibit import Choices, Exhibit

if TYPE_CHECKING:
    import viser

PLAIN: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False}
START_COLOR, GOAL_COLOR, LIT_COLOR = (47, 158, 68), rgb_of(ROUTE), (255, 146, 43)
PATH_LIFT = 0.06  # of a path over the floor [m]
PATH_WIDTH = 5.0  # [pixels]
MARK = 1 / 180  # radius of a mark, by the diagonal of the grid
MARK_RADII = 0.06, 0.5  # least and greatest [m]
GROWN = 0.006  # by which what is lit is larger than it is, so that it is seen [m]
ELEVATION = math.radians(58)  # of the first camera over the horizon
FIELD_OF_VIEW = math.radians(45)
USUAL_ASPECT = 1.2
MARGIN = 1.08  # by which the first camera is farther away than the box needs


def find_camera(bounds: Float, aspect: float) -> Float:
    """Where a box, shape (2, 3) [m], fills the page, seen from the south and above: shape (3,) [m].

    `aspect` is the width of the page by its height.
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
        self._server, self._scene = server, server.scene
        self._shown: dict[str, tuple[Any, list[Any]]] = {}  # by name: what it shows, its nodes
        self._scene.set_up_direction("+z")
        self._scene.world_axes.visible = False
        self._scene.configure_default_lights(cast_shadow=False)

    def place_camera(self, bounds: Float) -> None:
        """Look at a box from the south and above, so that it fills the page."""
        camera = self._server.initial_camera
        place = find_camera(bounds, USUAL_ASPECT)
        camera.fov = FIELD_OF_VIEW
        camera.near, camera.far = 0.05, 40 * max(float(place[2] - bounds[0, 2]), 1.0)
        camera.look_at = bounds.mean(axis=0)
        camera.position = place

        def fit(client: viser.ClientHandle) -> None:
            """Move the first camera of a page that is narrower than usual."""
            if client.camera.aspect < USUAL_ASPECT:
                client.camera.position = find_camera(bounds, client.camera.aspect)
                client.camera.look_at = bounds.mean(axis=0)

        self._server.on_client_connect(fit)

    def clear(self) -> None:
        """Take everything away."""
        for name in list(self._shown):
            self._put(name, None, list)

    def show(
        self, exhibit: Exhibit, chosen: Choices, route: Path | str | None, told: Json | None
    ) -> None:
        """Bring the page up to date."""
        self._put_glb("/scene", exhibit.scene_glb(chosen))
        for number in range(len(exhibit.grid.levels)):
            overlay = exhibit.overlay(chosen, number) if number in chosen.levels else b""
            self._put_glb(f"/grid/{number}", overlay)
        names = exhibit.names(chosen)
        self._put("/names", names, lambda: map(self._write_name, names))
        low, high = exhibit.bounds
        radius = float(np.clip(np.linalg.norm(high - low) * MARK, *MARK_RADII))
        clicks = (chosen.start, START_COLOR), (chosen.goal, GOAL_COLOR)
        ends = [(found.position, color) for found, color in clicks if found is not None]
        path = route if isinstance(route, Path) else None
        self._put("/path", (ends, id(path)), lambda: self._draw_path(ends, radius, path))
        lit = np.empty((0, 3, 3)) if told is None else told["lit"]
        self._put("/lit", lit.tobytes(), lambda: self._light(lit.reshape(-1, 3)))

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

    def _write_name(self, name: tuple[str, tuple[float, float, float]]) -> Any:
        text, place = name
        at = "/".join(map(str, place))
        return self._scene.add_label(f"/names/{at}", text, position=place, anchor="center-center")

    def _draw_path(
        self, ends: list[tuple[Any, tuple[int, int, int]]], radius: float, path: Path | None
    ) -> Iterable[Any]:
        for number, ((x, y, z), color) in enumerate(ends):
            at = (x, y, z + radius)
            yield self._scene.add_icosphere(f"/path/{number}", radius, color, position=at, **PLAIN)
        if path is not None and len(path.positions) > 1:
            lifted = path.positions + np.array([0, 0, PATH_LIFT])
            points = np.stack([lifted[:-1], lifted[1:]], axis=1).astype(np.float32)
            yield self._scene.add_line_segments(
                "/path/line", points, GOAL_COLOR, thickness=PATH_WIDTH, thickness_units="screen"
            )

    def _light(self, corners: Float) -> Iterable[Any]:
        """Draw triangles, each three corners, over what they are triangles of."""
        if len(corners):
            middle = corners.mean(axis=0)
            half = np.maximum(np.abs(corners - middle).max(axis=0), GROWN)
            yield self._scene.add_mesh_simple(
                "/lit/0",
                middle + (corners - middle) * (1 + GROWN / half),
                np.arange(len(corners)).reshape(-1, 3),
                color=LIT_COLOR,
                opacity=0.75,
                flat_shading=True,
                side="double",
                **PLAIN,
            )
