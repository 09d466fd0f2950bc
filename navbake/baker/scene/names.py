"""Names of a model's geoms, bodies and joints, and the warning when no name matches."""

from collections.abc import Iterable
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from navbake.baker.kernels.constants import MESH, SDF
from navbake.known_names import find_near


class GeomNames(NamedTuple):
    """The names that patterns match a geom by, and reports tell it by.

    Attributes:
        geom: its own; ``geom <id>`` where it has none.
        mesh: its mesh's; empty where it has none.
        body: its body's; ``body <id>`` where it has none.
    """

    geom: str
    mesh: str
    body: str


def name_at(model: Any, address: int) -> str:
    """A name out of the model's store, such as ``name_at(model, model.name_bodyadr[3])``.

    MuJoCo's own accessors fail on names that aren't UTF-8; here their odd bytes are replaced.
    """
    names: bytes = model.names
    return names[address : names.find(b"\0", address)].decode("utf-8", errors="replace")


# Each stage asks for all names again, and they never change
_names: WeakKeyDictionary[Any, list[GeomNames]] = WeakKeyDictionary()


def names_of(model: Any, geom: int) -> GeomNames:
    """The names of a geom."""
    if model not in _names:
        _names[model] = [_read_names(model, number) for number in range(model.ngeom)]
    return _names[model][geom]


def _read_names(model: Any, geom: int) -> GeomNames:
    mesh = ""
    if model.geom_type[geom] in (MESH, SDF) and model.geom_dataid[geom] >= 0:
        mesh = name_at(model, model.name_meshadr[model.geom_dataid[geom]])
    own = name_at(model, model.name_geomadr[geom]) or f"geom {geom}"
    return GeomNames(own, mesh, body_name(model, int(model.geom_bodyid[geom])))


def body_name(model: Any, body: int) -> str:
    """A body's name; ``body <id>`` where it has none."""
    return name_at(model, model.name_bodyadr[body]) or f"body {body}"


def joint_name(model: Any, joint: int) -> str:
    """A joint's name; ``joint <id>`` where it has none."""
    return name_at(model, model.name_jntadr[joint]) or f"joint {joint}"


def unique_name(name: str, taken: set[str]) -> str:
    """The name, numbered from 2 where it is taken, as in ``wall#2``; taken from now on."""
    candidate, count = name, 1
    while candidate in taken:
        count += 1
        candidate = f"{name}#{count}"
    taken.add(candidate)
    return candidate


def warn_unmatched(setting: str, pattern: str, known: Iterable[str], found: str = "nothing") -> str:
    """The warning that a pattern of a setting matches none of the known names, with near ones."""
    near = find_near(pattern.strip("*"), sorted({name for name in known if name}), most=3)
    hint = f"; near names are {', '.join(near)}" if near else ""
    return f"`{setting}` pattern {pattern!r} matches {found}{hint}"
