"""What happens in a batch, as lines of JSON: for programs that collect logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from navbake._version import __version__
from navbake.batch.job import stamp
from navbake.batch.workers import AGAIN, Ended
from navbake.types import Json

INFO, WARNING, ERROR = "info", "warning", "error"
# of a row of the index: what tells whether a scene is done, which may be long
BOOKKEEPING = ("key", "inputs", "files", "ended")


class Log:
    """Makes a line of each thing that happens in a batch, and gives it to all that take lines.

    Each has ``time``, ``level`` (``info``, ``warning`` or ``error``) and ``event``: ``begin``,
    ``scene-begin``, ``retry``, ``scene`` or ``end``. Others of its keys are those of the index.
    """

    def __init__(self, takers: Sequence[Callable[[Json], None]]) -> None:
        self._takers = takers

    def begin(self, total: int, skipped: int) -> None:
        """Before the first scene is baked."""
        self._add("begin", INFO, scenes=total, skipped=skipped, version=__version__)

    def note(self, event: str, scene: str, ended: Ended) -> None:
        """A scene begins, or will be tried again."""
        if event != AGAIN:
            self._add(event, INFO, id=scene)
            return
        seconds = round(ended.seconds, 3)
        why = {"how": ended.how, "error": ended.value}
        self._add(event, WARNING, id=scene, worker=ended.worker, seconds=seconds, **why)

    def end_scene(self, row: Json, worker: int) -> None:
        """After each scene, with its row of the index and the id of its process."""
        level = ERROR if row["status"] == "failed" else WARNING if row.get("warnings") else INFO
        values = {key: value for key, value in row.items() if key not in BOOKKEEPING}
        self._add("scene", level, **values, worker=worker)

    def end(self, counts: Json, stopped: str | None, seconds: float) -> None:
        """At the end: how many scenes became what, and why it ended early, None if it didn't."""
        level = ERROR if stopped or counts["failed"] else INFO
        self._add("end", level, **counts, stopped=stopped, seconds=round(seconds, 3))

    def _add(self, event: str, level: str, **values: Any) -> None:
        line = {"time": stamp(), "level": level, "event": event, **values}
        for take in self._takers:
            take(line)
