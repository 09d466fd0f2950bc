"""The page of a viewer: one thread brings it up to date, whatever the reader does meanwhile."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from navbake.errors import NavbakeError
from navbake.views.viewer import texts
from navbake.views.viewer.choices import Choices, first_choices, keep_choices
from navbake.views.viewer.controls import Change, Controls, set_theme
from navbake.views.viewer.exhibit import Exhibit
from navbake.views.viewer.picking import Ray
from navbake.views.viewer.stage import Stage

if TYPE_CHECKING:
    import viser

LOG = logging.getLogger("navbake")


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
        ray = Ray.of(event.ray_origin, event.ray_direction)
        self.change(lambda chosen: self.exhibit.click(chosen, ray))

    def _verify(self) -> None:
        def compare() -> None:
            self._controls.say("Comparing the grid with the scene…")
            self.exhibit.verify()
            self._controls.say("")

        self._do(compare)

    def _work(self) -> None:
        self._show()
        while True:
            with self._wake:
                if not self._changes:
                    self._wake.wait_for(lambda: self._is_done or bool(self._changes))
                if self._is_done:
                    return
                changes, self._changes = self._changes, []
            for change in changes:
                self._guarded(lambda change=change: self._apply(change))  # type: ignore[misc]
            self._show()

    def _apply(self, change: Change) -> None:
        self.chosen = change(self.chosen)

    def _show(self) -> None:
        self._guarded(self._bring_up_to_date)

    def _bring_up_to_date(self) -> None:
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
