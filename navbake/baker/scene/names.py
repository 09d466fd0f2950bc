"""What a model's things are called, and what to tell when nobody is called so."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from navbake.baker.kernels.constants import MESH, SDF


@dataclass(frozen=True)
class GeomNames:
    """A geom's names.

    Attributes:
        geom: its own; ``geom <id>`` where it has none.
        body: its body's; ``body <id>`` where it has none.
        mesh: its mesh's; empty where it has none.
    """

    geom: str
    body: str
    mesh: str


def name_at(model: Any, address: int) -> str:
    """A name out of the model's store, such as ``name_at(model, model.name_bodyadr[3])``.

    MuJoCo's own accessors fail on names that aren't UTF-8; here their odd bytes are replaced.
    """
    names: bytes = model.names
    return names[address : names.find(b"\0", address)].decode("utf-8", errors="replace")


# Each stage asks for all names again, and they never change
_names: WeakKeyDictionary[Any, list[GeomNames]] = WeakKeyDictionary()


def names_of(model: Any, geom: int) -> GeomNames:
    """The names that a geom is known by, in reports and patterns alike."""
    if model not in _names:
        _names[model] = [_read_names(model, number) for number in range(model.ngeom)]
    return _names[model][geom]


def _read_names(model: Any, geom: int) -> GeomNames:
    mesh = ""
    if model.geom_type[geom] in (MESH, SDF) and model.geom_dataid[geom] >= 0:
        mesh = name_at(model, model.name_meshadr[model.geom_dataid[geom]])
    own = name_at(model, model.name_geomadr[geom]) or f"geom {geom}"
    return GeomNames(own, body_name(model, int(model.geom_bodyid[geom])), mesh)


def body_name(model: Any, body: int) -> str:
    """A body's name; ``body <id>`` where it has none."""
    return name_at(model, model.name_bodyadr[body]) or f"body {body}"


def joint_name(model: Any, joint: int) -> str:
    """A joint's name; ``joint <id>`` where it has none."""
    return name_at(model, model.name_jntadr[joint]) or f"joint {joint}"


def warn_unmatched(
    setting: str, pattern: str, known: Iterable[str], matches: str = "nothing"
) -> str:
    """Tell that a pattern of the settings matches nothing, and which names are near it.

    Args:
        setting: where the pattern stands, such as ``rooms.geoms``.
        pattern: what was looked for.
        known: all names that there are.
        matches: what it does match.
    """
    names = sorted({name for name in known if name})
    near = difflib.get_close_matches(pattern.strip("*"), names, n=3, cutoff=0.4)
    hint = f"; near names are {', '.join(near)}" if near else ""
    return f"`{setting}` pattern {pattern!r} matches {matches}{hint}"
