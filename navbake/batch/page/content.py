"""What the page of a batch says: the rows of its index, in columns, checked and in few bytes.

An index may come from a stranger. A number that is none, or a text that is none, is left out; a
name that could lead out of the folder has no links.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

from navbake.batch.job import check_id
from navbake.batch.page.reasons import Grouping, Reasons
from navbake.batch.products import OWN
from navbake.errors import ConfigError, printable
from navbake.types import Json

STATUSES = ("ok", "failed", "left")
# of each scene, by its name on the page
NUMBERS = {
    "freeArea": "free_area",
    "cells": "cells",
    "levels": "levels",
    "rooms": "rooms",
    "doors": "doors",
    "seconds": "seconds",
}
MAX_SCENES = 100_000  # on a page; it says how many more there are
MAX_TEXT = 1000  # characters of an error, a warning or a remark
MAX_TEXTS = 50  # warnings of a scene, and remarks
MAX_STAGES = 64
MOST = 1e15  # of a number; beyond it, JavaScript's are not exact


class Progress(NamedTuple):
    """How far a batch is that still runs."""

    done: int
    total: int


def describe_batch(
    rows: Iterable[Any], has_thumbnail: Callable[[str], bool], progress: Progress | None = None
) -> Json:
    """What the page shows of the rows of an index.

    Args:
        rows: of the index; what is no row is counted and left out.
        has_thumbnail: whether there is one, by a scene's id.
        progress: how far the batch is, None if it has ended.

    Returns:
        ``scenes``: a list for each column; numbers into the lists beside it are -1 for none.
        Where there are more than `MAX_SCENES`, those that failed come first. Counts and ``sums``
        are of all scenes.
    """
    given = [*rows]
    known = [row for row in given if is_row(row)]
    shown = known
    if len(known) > MAX_SCENES:
        shown = sorted(known, key=lambda row: row["status"] != "failed")[:MAX_SCENES]
    errors, warnings, remarks = Grouping(), Grouping(), Grouping()
    safe = [is_safe(row["id"]) for row in shown]
    files = [_files(row) if is_fine else () for row, is_fine in zip(shown, safe, strict=True)]
    lists = {names: number for number, names in enumerate(dict.fromkeys(files))}
    sums, names = _sums(known)
    stages = [_stages(row) for row in shown]
    scenes: Json = {
        "id": [
            row["id"] if is_fine else _text(row["id"])
            for row, is_fine in zip(shown, safe, strict=True)
        ],
        "source": [_text(row.get("source")) for row in shown],
        "status": [STATUSES.index(row["status"]) for row in shown],
        **{name: [_number(row.get(key)) for row in shown] for name, key in NUMBERS.items()},
        "error": [_error(row, errors) for row in shown],
        "warnings": [warnings.numbers(_texts(row.get("warnings"))) for row in shown],
        "remarks": [remarks.numbers(_texts(row.get("audit"))) for row in shown],
        "files": [lists[of_scene] for of_scene in files],
        "thumbnail": [
            int(is_fine and row["status"] == "ok" and has_thumbnail(row["id"]))
            for row, is_fine in zip(shown, safe, strict=True)
        ],
        "stages": [[stage.get(name) for name in names] if stage else [] for stage in stages],
        "ended": [_text(row.get("ended")) for row in shown],
        "version": [_text(row.get("version")) for row in shown],
    }
    return {
        "total": len(known),
        "noRows": len(given) - len(known),
        "counts": [sum(row["status"] == status for row in known) for status in STATUSES],
        "work": round(measure_work(known), 3),
        "progress": None if progress is None else [progress.done, progress.total],
        "sums": sums,
        "scenes": scenes,
        "fileLists": [*lists],
        "stageNames": [_text(name) for name in names],
        "errors": _reasons(errors.reasons),
        "warnings": _reasons(warnings.reasons),
        "remarks": _reasons(remarks.reasons),
    }


def _sums(rows: Sequence[Json]) -> tuple[Json, list[str]]:
    """What all scenes come to, and the names of stages.

    ``staged`` is the time [s] of the scenes that say how long their stages took.
    """
    stages: dict[str, float] = {}
    staged = 0.0
    for row in rows:
        own = _stages(row)
        staged += (_number(row.get("seconds")) or 0.0) if own else 0.0
        for name, seconds in own.items():
            if name in stages or len(stages) < MAX_STAGES:
                stages[name] = stages.get(name, 0.0) + seconds
    numbers = {
        name: float(sum(_number(row.get(key)) or 0 for row in rows))
        for name, key in NUMBERS.items()
    }
    versions = dict.fromkeys(_text(row.get("version")) for row in rows)
    return {
        **numbers,
        "warned": sum(bool(_texts(row.get("warnings"))) for row in rows),
        "remarked": sum(bool(_texts(row.get("audit"))) for row in rows),
        "versions": [version for version in versions if version][:MAX_TEXTS],
        "stages": [*stages.values()],
        "staged": staged,
    }, [*stages]


def is_row(row: Any) -> bool:
    """Whether it is a row of an index, as far as the page needs that."""
    return (
        isinstance(row, dict) and isinstance(row.get("id"), str) and row.get("status") in STATUSES
    )


def is_safe(name: str) -> bool:
    """Whether an id is the name of a folder within a batch's."""
    try:
        check_id(name, "the index")
    except ConfigError:
        return False
    return True


def measure_work(rows: Iterable[Json]) -> float:
    """How long at least one scene was being baked [s], however often the batch went on.

    That is the length of the union of the times from when each was begun to when it ended.
    """
    spans = []
    for row in rows:
        end, seconds = _time(row.get("ended")), _number(row.get("seconds"))
        if end is not None and seconds is not None:
            spans.append((end - max(seconds, 0.0), end))
    total, reached = 0.0, -math.inf
    for begin, end in sorted(spans):
        total += max(0.0, end - max(begin, reached))
        reached = max(reached, end)
    return total


def _time(text: Any) -> float | None:
    """Seconds since 1970 of a time as ISO 8601 has it."""
    try:
        return datetime.fromisoformat(text.replace("Z", "+00:00")).timestamp()
    except (AttributeError, ValueError, OverflowError, OSError):
        return None


def _error(row: Json, errors: Grouping) -> int:
    if row["status"] != "failed":
        return -1
    return errors.number(_text(row.get("error")), _text(row.get("how")))


def _reasons(reasons: Reasons) -> Json:
    return {"texts": reasons.texts, "group": reasons.group, "groups": reasons.groups}


def _files(row: Json) -> tuple[str, ...]:
    """What was made of a scene; other files are no business of the page."""
    files = row.get("files")
    return tuple(name for name in files if OWN.fullmatch(name)) if isinstance(files, dict) else ()


def _stages(row: Json) -> Mapping[str, float]:
    stages = row.get("stages")
    if not isinstance(stages, dict):
        return {}
    taken = {name: _number(seconds) for name, seconds in stages.items()}
    return {name: seconds for name, seconds in taken.items() if seconds is not None}


def _texts(value: Any) -> Sequence[str]:
    if not isinstance(value, list):
        return ()
    return [_text(each) for each in value[:MAX_TEXTS] if isinstance(each, str)]


def _text(value: Any) -> str:
    """A text in print, cut where it is long; empty where it is none."""
    return printable(value[:MAX_TEXT]) if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return value if is_number and abs(value) < MOST else None
