"""What the page of a batch says: the rows of its index, checked, grouped by what went wrong.

An index may come from a stranger. A number that is none, or a text that is none, is left out; a
name that could lead out of the folder has no links.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from navbake.batch.products import OWN
from navbake.batch.scenes import check_id
from navbake.errors import ConfigError, printable
from navbake.types import Json
from navbake.views.color_scale import nice_step

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
CHARTS = ("freeArea", "cells", "rooms", "seconds")
NUM_BINS = 24  # bars of a chart, about
SKEWED = 20  # so many times the median at the most: then bars have equal ratios, not widths
REASONS = ("failures", "warnings", "remarks")
MAX_SCENES = 100_000  # on a page; it says how many more there are
MAX_TEXT = 1000  # characters of an error, a warning or a remark
MAX_TEXTS = 50  # warnings of a scene, remarks, and stages
MOST = 1e15  # of a number; beyond it, JavaScript's are not exact

SETTING = re.compile(r"(`[^`]*`)")
QUOTED = re.compile(r"""(?<!\w)'[^']*'(?!\w)|(?<!\w)"[^"]*"(?!\w)""")
WORD = re.compile(r"[^\s`'\"(),;:=<>\[\]{}]+")
FILE = re.compile(
    r"(?i)\.(xml|mjcf|urdf|mjb|ya?ml|json|jsonl|gz|obj|stl|ply|glb|gltf|dae|msh|skn|png|hdr|bin|npz"
    r"|txt|csv)$"
)
THOUSANDS = re.compile(r"(?<=\d),(?=\d{3}(?!\d))")  # commas within a number
# with a unit: 5cm, 30%
NUMERIC = re.compile(r"[-+±]?(\d+(\.\d+)*|\.\d+)([eE][-+]?\d+)?[a-zA-Z%²³°]{0,3}")


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
        ``scenes``: where there are more than `MAX_SCENES`, those that failed come first; counts
        and ``sums`` are of all. ``groups``: of each kind of `REASONS`, which group each text is
        in. ``edges``: of the bars of each chart.
    """
    given = [*rows]
    scenes = [_read_row(row) for row in given if is_row(row)]
    shown = sorted(scenes, key=lambda scene: scene["status"] != "failed")
    shown = (scenes if len(scenes) <= MAX_SCENES else shown)[:MAX_SCENES]
    for scene in shown:
        is_safe_ok = scene["isSafe"] and scene["status"] == "ok"
        scene["thumbnail"] = is_safe_ok and has_thumbnail(scene["id"])
    stages: dict[str, float] = {}
    for scene in scenes:
        for name, seconds in scene["stages"].items():
            if name in stages or len(stages) < MAX_TEXTS:
                stages[name] = stages.get(name, 0.0) + seconds
    versions = dict.fromkeys(scene["version"] for scene in scenes if scene["version"])
    sums: Json = {key: float(sum(scene[key] or 0 for scene in scenes)) for key in NUMBERS}
    sums |= {kind: sum(bool(scene[kind]) for scene in scenes) for kind in REASONS}
    sums |= {"versions": [*versions][:MAX_TEXTS], "stages": stages}
    # the time [s] of the scenes that say how long their stages took
    sums["staged"] = float(sum(scene["seconds"] or 0 for scene in scenes if scene["stages"]))
    return {
        "total": len(scenes),
        "noRows": len(given) - len(scenes),
        "counts": {status: sum(s["status"] == status for s in scenes) for status in STATUSES},
        "work": round(measure_work(scenes), 3),
        "progress": progress and list(progress),
        "sums": sums,
        "scenes": shown,
        "groups": {kind: _group(text for s in shown for text in s[kind]) for kind in REASONS},
        "edges": {key: _edges([s[key] for s in shown if s[key] is not None]) for key in CHARTS},
    }


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


def _read_row(row: Json) -> Json:
    """What a row says of its scene, as far as it can be taken."""
    safe = is_safe(row["id"])
    files, stages = (v if isinstance(v, dict) else {} for v in map(row.get, ("files", "stages")))
    reason = ": ".join(filter(None, (_text(row.get("how")), _text(row.get("error")))))
    taken = {_text(name): _number(each) for name, each in stages.items()}
    return {
        "id": row["id"] if safe else _text(row["id"]),
        "isSafe": safe,
        "status": row["status"],
        **{name: _number(row.get(key)) for name, key in NUMBERS.items()},
        "failures": [reason] if row["status"] == "failed" else [],
        "warnings": _texts(row.get("warnings")),
        "remarks": _texts(row.get("audit")),
        # what was made of it; other files are no business of the page
        "files": [name for name in files if safe and OWN.fullmatch(name)],
        "stages": {name: seconds for name, seconds in taken.items() if seconds is not None},
        **{key: _text(row.get(key)) for key in ("source", "ended", "version")},
    }


def measure_work(scenes: Iterable[Json]) -> float:
    """How long at least one scene was being baked [s], however often the batch went on.

    That is the length of the union of the times from when each was begun to when it ended.
    """
    spans = []
    for scene in scenes:
        end, seconds = _time(scene.get("ended")), _number(scene.get("seconds"))
        if end is not None and seconds is not None:
            spans.append((end - max(seconds, 0.0), end))
    total, reached = 0.0, -math.inf
    for begin, end in sorted(spans):
        total += max(0.0, end - max(begin, reached))
        reached = max(reached, end)
    return total


def _edges(values: Sequence[float]) -> list[float]:
    """The edges of bars for some numbers: as wide as one another, or in equal ratios."""
    if not values:
        return []
    least, most = float(min(values)), float(max(values))
    if least > 0 and most > SKEWED * float(np.median(values)):
        return [*np.geomspace(least, most, NUM_BINS + 1).tolist()[:-1], most]
    step = nice_step((most - least or abs(most) or 1) / (NUM_BINS - 4))
    if all(float(value).is_integer() for value in values):
        step = max(step, 1.0)
    first = math.floor(least / step + 1e-9)
    last = max(math.floor(most / step + 1e-9), first) + 1
    return [round(number * step, 12) for number in range(first, last + 1)]


def _group(texts: Iterable[str]) -> dict[str, str]:
    """The group of each text: what it has in common with others, or itself where it is alone."""
    folded = {text: fold(text) for text in texts}
    members: dict[str, list[str]] = {}
    for text, group in folded.items():
        members.setdefault(group, []).append(text)
    return {text: group if members[group][1:] else text for text, group in folded.items()}


def fold(text: str) -> str:
    """A text without what differs from scene to scene, so that alike ones are the same.

    What is quoted, paths, names of files and words with digits in them become ``…``, numbers
    become ``#``. What stands between backticks is a setting and stays.
    """
    parts = SETTING.split(text)
    parts[::2] = [WORD.sub(_fold_word, THOUSANDS.sub("", QUOTED.sub("…", p))) for p in parts[::2]]
    return "".join(parts)


def _fold_word(match: re.Match[str]) -> str:
    word = match.group()
    core = word.rstrip(".!?")
    if "/" in core or "\\" in core or FILE.search(core):
        folded = "…"
    elif NUMERIC.fullmatch(core):
        folded = "#"
    else:
        folded = "…" if any(letter.isdecimal() for letter in core) else core
    return folded + word[len(core) :]


def _time(text: Any) -> float | None:
    """Seconds since 1970 of a time as ISO 8601 has it."""
    try:
        return datetime.fromisoformat(text.replace("Z", "+00:00")).timestamp()
    except (AttributeError, ValueError, OverflowError, OSError):
        return None


def _texts(value: Any) -> list[str]:
    given = value[:MAX_TEXTS] if isinstance(value, list) else []
    return [_text(each) for each in given if isinstance(each, str)]


def _text(value: Any) -> str:
    """A text in print, cut where it is long; empty where it is none."""
    return printable(value[:MAX_TEXT]) if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return value if is_number and abs(value) < MOST else None
