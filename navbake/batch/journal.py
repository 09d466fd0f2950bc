"""What happens in a batch, as lines of JSON: for programs that collect logs."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from navbake._version import __version__
from navbake.batch.crew import AGAIN, BEGUN, LOST, READY, Event
from navbake.batch.full import refused
from navbake.errors import NavbakeError
from navbake.files import write_all
from navbake.types import Json

INFO, WARNING, ERROR = "info", "warning", "error"
NAMES = {READY: "worker-ready", BEGUN: "scene-begin", LOST: "worker-lost", AGAIN: "retry"}
# of a row of the index: what tells whether a scene is done, which may be long
BOOKKEEPING = ("key", "named", "sought", "inputs", "files", "ended")


def stamp() -> str:
    """Now, as ISO 8601 has it: UTC, to a millisecond."""
    now = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
    return now.replace("+00:00", "Z")


class Journal:
    """Makes a line of each thing that happens in a batch, and gives it to all that take lines.

    Each has ``time``, ``level`` (``info``, ``warning`` or ``error``) and ``event``: ``begin``,
    ``worker-ready``, ``scene-begin``, ``worker-lost``, ``retry``, ``scene`` or ``end``. Others of
    its keys are those of the index, and ``worker``.
    """

    def __init__(self, takers: Sequence[Callable[[Json], None]]) -> None:
        self._takers = takers
        self._worker_of: dict[str, int] = {}  # by id, of scenes that are being baked

    def begin(self, total: int, skipped: int) -> None:
        """Before the first scene is baked."""
        self._add("begin", INFO, scenes=total, skipped=skipped, version=__version__)

    def hear(self, event: Event, scene: str | None) -> None:
        """Of what happens meanwhile; `scene` is the id of the one that it happens to."""
        if not self._takers:
            return
        values: Json = {} if scene is None else {"id": scene}
        values["worker"] = event.worker
        if event.what == BEGUN and scene is not None:
            self._worker_of[scene] = event.worker
        elif event.what == READY:
            values["seconds"] = round(event.seconds, 3)
        elif event.what in (LOST, AGAIN):
            values |= {"seconds": round(event.seconds, 3), "how": event.how, "error": event.why}
        level = WARNING if event.what in (LOST, AGAIN) else INFO
        self._add(NAMES[event.what], level, **values)

    def end_scene(self, row: Json) -> None:
        """After each scene, with its row of the index."""
        if not self._takers:
            return
        level = ERROR if row["status"] == "failed" else WARNING if row.get("warnings") else INFO
        worker = self._worker_of.pop(row["id"], None)
        values = {key: value for key, value in row.items() if key not in BOOKKEEPING}
        self._add("scene", level, **values, **({} if worker is None else {"worker": worker}))

    def end(self, counts: Json, stopped: str | None, seconds: float) -> None:
        """At the end: how many scenes became what, and why it ended early, None if it didn't."""
        level = ERROR if stopped or counts["failed"] else INFO
        self._add("end", level, **counts, stopped=stopped, seconds=round(seconds, 3))

    def _add(self, event: str, level: str, **values: Any) -> None:
        line = {"time": stamp(), "level": level, "event": event, **values}
        for take in self._takers:
            take(line)


class LogFile:
    """A file to which lines are added, each in one write, so that several batches may share it.

    All that it does raises a NavbakeError where the file can't be written, a FullError where that
    is for want of space.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        except OSError as error:
            raise self._refused(error) from error

    def add(self, line: Json) -> None:
        """Add a line."""
        text = json.dumps(line, separators=(",", ":"), allow_nan=False).encode() + b"\n"
        try:
            write_all(self._file, text)
        except OSError as error:
            raise self._refused(error) from error

    def close(self) -> None:
        """Give the file back."""
        with suppress(OSError):
            os.close(self._file)

    def _refused(self, error: OSError) -> NavbakeError:
        return refused(f"the log {self._path}", error)
