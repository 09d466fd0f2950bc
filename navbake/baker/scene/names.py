"""Names of a model's geoms, bodies and joints, and the tree of its bodies."""

from collections.abc import Iterable
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from navbake.baker.core.constants import MESH, SDF
from navbake.known_names import find_near
from navbake.types import Bool, Int


class GeomNames(NamedTuple):
    """The names of a geom in patterns and reports."""

    geom: str  # ``geom <id>`` where it has none
    mesh: str  # empty where it has none
    body: str  # ``body <id>`` where it has none


def name_at(model: Any, address: int) -> str:
    """A name out of the model's store, such as ``name_at(model, model.name_bodyadr[3])``."""
    return names_at(model, [address])[0]


def names_at(model: Any, addresses: Iterable[int]) -> list[str]:
    """Some names out of the model's store; bytes that aren't UTF-8, as MuJoCo's, are replaced."""
    store: bytes = model.names  # a copy of all names
    ends = ((first, store.find(b"\0", first)) for first in addresses)
    return [store[first:end].decode("utf-8", errors="replace") for first, end in ends]


class ModelNames(NamedTuple):
    """Names by id: of all geoms and bodies; and the own ones of geoms and sites, empty for none."""

    geoms: list[GeomNames]
    bodies: list[str]
    own_geoms: tuple[str, ...]
    sites: tuple[str, ...]


# Every stage needs the names, which never change
_names: WeakKeyDictionary[Any, ModelNames] = WeakKeyDictionary()


def all_names(model: Any) -> ModelNames:
    """The names of a model, which are read once."""
    if (known := _names.get(model)) is not None:
        return known
    bodies = names_at(model, getattr(model, f"name_{'body'}adr").tolist())
    geoms = names_at(model, getattr(model, f"name_{'geom'}adr").tolist())
    meshes = names_at(model, getattr(model, f"name_{'mesh'}adr").tolist())
    sites = names_at(model, getattr(model, f"name_{'site'}adr").tolist())
    bodies = [name or f"body {body}" for body, name in enumerate(bodies)]
    mesh_of = [*meshes, ""]  # the last one for what is no mesh
    of_mesh = np.where(np.isin(model.geom_type, (MESH, SDF)), model.geom_dataid, -1).tolist()
    columns = zip(geoms, of_mesh, model.geom_bodyid.tolist(), strict=True)
    named = [
        GeomNames(name or f"geom {geom}", mesh_of[shape], bodies[body])
        for geom, (name, shape, body) in enumerate(columns)
    ]
    _names[model] = ModelNames(named, bodies, tuple(geoms), tuple(sites))
    return _names[model]


def body_name(model: Any, body: int) -> str:
    """A body's name; ``body <id>`` where it has none."""
    return all_names(model).bodies[body]


def joint_name(model: Any, joint: int) -> str:
    """A joint's name; ``joint <id>`` where it has none."""
    return name_at(model, model.name_jntadr[joint]) or f"joint {joint}"


def warn_unmatched(setting: str, pattern: str, known: Iterable[str], found: str = "nothing") -> str:
    """The warning that a pattern of a setting matches none of the known names, with near ones."""
    near = find_near(pattern.strip("*"), sorted({name for name in known if name}), most=3)
    hint = f"; near names are {', '.join(near)}" if near else ""
    return f"`{setting}` pattern {pattern!r} matches {found}{hint}"


def find_subtree_ends(model: Any) -> Int:
    """The end of each body's subtree, (nbody,): bodies are numbered depth first."""
    end = list(range(1, model.nbody + 1))
    parent = model.body_parentid.tolist()
    for body in range(model.nbody - 1, 0, -1):  # children come after their parents
        end[parent[body]] = max(end[parent[body]], end[body])
    return np.array(end, dtype=np.int64)


def geoms_of_bodies(model: Any, first: int, end: int) -> Int:
    """Ids of the geoms of the bodies from `first` to before `end`, ascending as the bodies are."""
    low, high = np.searchsorted(model.geom_bodyid, [first, end])
    return np.arange(low, high, dtype=np.int64)


def mark_body(model: Any, first: int, end: int) -> Bool:
    """Mark the geoms of the bodies from `first` to before `end`, shape (ngeom,)."""
    mask = np.zeros(model.ngeom, dtype=np.bool_)
    mask[geoms_of_bodies(model, first, end)] = True
    return mask
