"""What happens in a batch, as lines of JSON: for programs that collect logs."""

from __future__ import annotations

from navbake._version import __version__
from navbake.batch.job import FAILED, stamp
from navbake.batch.workers import AGAIN
from navbake.types import Json

# of a row of the index: what tells whether a scene is done, which may be long
BOOKKEEPING = ("key", "inputs", "files", "ended")


def line_of_event(event: str, values: Json) -> Json:
    """A line of the log.

    It has ``time``, ``level`` (``info``, ``warning`` or ``error``) and ``event``: ``begin``,
    ``scene-begin``, ``retry``, ``scene`` or ``end``. Others of its keys are those of the index.
    """
    is_error = values.get("status") == FAILED or values.get("stopped") or values.get("failed")
    level = "error" if is_error else "info"
    if event == AGAIN or (values.get("warnings") and not is_error):
        level = "warning"
    values = {key: value for key, value in values.items() if key not in BOOKKEEPING}
    if event == "begin":
        values["version"] = __version__
    return {"time": stamp(), "level": level, "event": event, **values}
