"""Which ID a geom's voxels get, and what the IDs stand for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from navbake.baker.scene.names import all_names, body_name, warn_unmatched
from navbake.baker.scene.scene import Scene
from navbake.errors import ConfigError
from navbake.known_names import find_near

Segments = Literal["geom", "body", "top"] | str | Mapping[str, int] | Sequence[str]

KINDS = ("geom", "body", "top")
MOST = 2**32 - 1
OTHER = "other"


@dataclass(frozen=True)
class Labels:
    """The IDs of a scene's geoms.

    Attributes:
        ids: by geom id, shape (n,), uint32; 0 for geoms that don't count.
        names: what each ID stands for.
        notes: what the user should know, one line each.
    """

    ids: NDArray[np.uint32]
    names: dict[int, str]
    notes: list[str]


def label_geoms(scene: Scene, segments: Segments) -> Labels:
    """Give the counted geoms of a scene their IDs.

    `geom` is MuJoCo's geom id plus 1, as in a camera's segmentation image. `body` and `top` (the
    top-most body; a geom of the world stands for itself) count from 1, in the order of the geoms.
    Patterns match the names of a geom, its mesh, its body and the bodies above; the first match
    decides. All other geoms are ``other``, with the greatest of the IDs plus 1.

    Args:
        segments: ``geom``, ``body``, ``top``, a mapping of name patterns (``*``, ``?``, ``[…]``)
            to IDs from 1, or a list of patterns, whose IDs are 1, 2, 3, …. One pattern is a list
            of one.

    Raises:
        ConfigError: it is none of these, or an ID is none.
    """
    if isinstance(segments, str) and segments in KINDS:
        return _label_by_kind(scene, segments)
    patterns = _check_patterns(segments)
    other = max(patterns.values()) + 1
    ids = np.zeros(len(scene.geoms), dtype=np.uint32)
    used = set()
    for geom in _counted(scene):
        names = _known_as(scene.model, geom)
        match = next((p for p in patterns if any(fnmatchcase(n, p) for n in names)), None)
        used.add(match)
        ids[geom] = other if match is None else patterns[match]
    table: dict[int, str] = {}
    for pattern, number in patterns.items():
        table[number] = f"{table[number]}, {pattern}" if number in table else pattern
    if None in used:
        table[other] = OTHER
    known = sorted({name for geom in _counted(scene) for name in _known_as(scene.model, geom)})
    notes = [warn_unmatched("segments", p, known) for p in patterns if p not in used]
    return Labels(ids, table, notes)


def _label_by_kind(scene: Scene, kind: str) -> Labels:
    model = scene.model
    ids = np.zeros(len(scene.geoms), dtype=np.uint32)
    numbers: dict[tuple[str, int], int] = {}
    table: dict[int, str] = {}
    for geom in _counted(scene):
        body = int(model.geom_bodyid[geom])
        if kind == "top":
            body = int(model.body_rootid[body])
        is_geom = kind == "geom" or (kind == "top" and body == 0)
        key = ("geom", geom) if is_geom else ("body", body)
        number = geom + 1 if kind == "geom" else numbers.setdefault(key, len(numbers) + 1)
        ids[geom] = number
        table[number] = all_names(model).geoms[geom].geom if is_geom else body_name(model, body)
    return Labels(ids, table, [])


def _check_patterns(segments: Any) -> dict[str, int]:
    if isinstance(segments, Mapping):
        patterns = dict(segments)
    elif isinstance(segments, str) and (
        set(segments) & set("*?[") or not find_near(segments, KINDS)  # else a slip
    ):
        patterns = {segments: 1}
    elif isinstance(segments, Sequence) and not isinstance(segments, str):
        patterns = {pattern: number for number, pattern in enumerate(segments, 1)}
    else:
        patterns = {}
    if not patterns or not all(isinstance(p, str) and p for p in patterns):
        raise ConfigError(
            f"expected `segments` to be {', '.join(KINDS)}, or name patterns with their IDs, "
            f"got {segments!r}"
        )
    for pattern, number in patterns.items():
        whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if not whole or not 1 <= number < MOST:
            raise ConfigError(
                f"expected an ID from 1 to {MOST - 1} for segment pattern {pattern!r}, "
                f"got {number!r}"
            )
    return {pattern: int(number) for pattern, number in patterns.items()}


def _counted(scene: Scene) -> list[int]:
    return [geom.id for geom in scene.geoms if geom.counted]


def _known_as(model: Any, geom: int) -> list[str]:
    """The names of a geom, its mesh and all bodies above it."""
    names = all_names(model).geoms[geom]
    bodies, body = [], int(model.geom_bodyid[geom])
    while body:
        bodies.append(body_name(model, body))
        body = int(model.body_parentid[body])
    return [name for name in (names.geom, names.mesh, *bodies) if name]
