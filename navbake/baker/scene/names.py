"""Finds the names of a model's geoms, bodies and joints, and the subtrees of its bodies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from navbake.baker.core.constants import MESH, SDF
from navbake.known_names import find_similar_names
from navbake.types import Bool, Int

if TYPE_CHECKING:
    import mujoco


class GeomNames(NamedTuple):
    """The names of a geom, its mesh and its body, which patterns match and reports show.

    Attributes:
        geom: the geom's name; ``geom <id>`` if it has none.
        mesh: the name of its mesh; empty if it has no mesh.
        body: the name of its body; ``body <id>`` if the body has none.
    """

    geom: str
    mesh: str
    body: str


def name_at(model: mujoco.MjModel, address: int) -> str:
    """Return the name at an address of the model's store of names; empty if it has no name.

    Args:
        model: the model.
        address: the address of the name's first byte, for example ``model.name_bodyadr[3]``.
    """
    return names_at(model, [address])[0]


def names_at(model: mujoco.MjModel, addresses: Iterable[int]) -> list[str]:
    """Return the names at some addresses of the model's store of names.

    Args:
        model: the model.
        addresses: the addresses of the names' first bytes, for example ``model.name_bodyadr``.

    Returns:
        The names, empty if there is none; bytes that aren't UTF-8 are replaced.
    """
    all_bytes: bytes = model.names  # a copy of all names
    names = []
    for start in addresses:
        stop = all_bytes.find(b"\0", start)
        names.append(all_bytes[start:stop].decode("utf-8", errors="replace"))
    return names


class ModelNames(NamedTuple):
    """All names of a model, in the order of ids.

    Attributes:
        geoms: for each geom, the names of the geom, its mesh and its body.
        bodies: the bodies' names; ``body <id>`` if a body has none.
        stated_geom_names: the geoms' names; empty if a geom has none.
        sites: the sites' names; empty if a site has none.
    """

    geoms: list[GeomNames]
    bodies: list[str]
    stated_geom_names: tuple[str, ...]
    sites: tuple[str, ...]


# A cache: every stage needs the names, which never change.
_names_of_models: WeakKeyDictionary[mujoco.MjModel, ModelNames] = WeakKeyDictionary()


def all_names(model: mujoco.MjModel) -> ModelNames:
    """Return all names of a model. They are cached."""
    names = _names_of_models.get(model)
    if names is None:
        names = _read_names(model)
        _names_of_models[model] = names
    return names


def _read_names(model: mujoco.MjModel) -> ModelNames:
    geom_names = names_at(model, model.name_geomadr.tolist())
    mesh_names = names_at(model, model.name_meshadr.tolist())
    site_names = names_at(model, model.name_siteadr.tolist())
    body_names = [
        name or f"body {body}"
        for body, name in enumerate(names_at(model, model.name_bodyadr.tolist()))
    ]
    is_mesh = np.isin(model.geom_type, (MESH, SDF))
    mesh_ids = np.where(is_mesh, model.geom_dataid, -1).tolist()
    body_ids = model.geom_bodyid.tolist()
    geoms = [
        GeomNames(
            geom=name or f"geom {geom}",
            mesh=mesh_names[mesh_id] if mesh_id >= 0 else "",
            body=body_names[body_id],
        )
        for geom, (name, mesh_id, body_id) in enumerate(
            zip(geom_names, mesh_ids, body_ids, strict=True)
        )
    ]
    return ModelNames(
        geoms=geoms, bodies=body_names, stated_geom_names=tuple(geom_names), sites=tuple(site_names)
    )


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return a body's name; ``body <id>`` if it has none.

    Args:
        model: the model.
        body: the body's id.
    """
    return all_names(model).bodies[body]


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return a joint's name; ``joint <id>`` if it has none.

    Args:
        model: the model.
        joint: the joint's id.
    """
    return name_at(model, model.name_jntadr[joint]) or f"joint {joint}"


def find_joint_of_body(model: mujoco.MjModel, name: str) -> int | None:
    """Return the id of the only joint of a body; None if it has none or several.

    Args:
        model: the model.
        name: the body's name, or ``body <id>``; None is returned for an unknown one.
    """
    body_names = all_names(model).bodies
    if name not in body_names:
        return None
    body = body_names.index(name)
    return int(model.body_jntadr[body]) if model.body_jntnum[body] == 1 else None


def list_joint_names(model: mujoco.MjModel) -> list[str]:
    """List the names of all joints; those without a name, as ``joint <id>``, come last."""
    stated_names = names_at(model, model.name_jntadr.tolist())
    return [name for name in stated_names if name] + [
        f"joint {joint}" for joint, name in enumerate(stated_names) if not name
    ]


def warn_unmatched(
    setting: str, pattern: str, names: Iterable[str], matches_text: str = "nothing"
) -> str:
    """Return the warning that a pattern matches no name, with similar names as a suggestion.

    Args:
        setting: the key of the setting that has the pattern, such as ``doors.patterns``.
        pattern: the pattern.
        names: the names that the user may have meant; empty names are ignored.
        matches_text: the end of the sentence ``<pattern> matches ...``, such as ``no body``.
    """
    near_names = find_similar_names(
        pattern.strip("*"), sorted({name for name in names if name}), max_names=3
    )
    hint = f"; near names are {', '.join(near_names)}" if near_names else ""
    return f"`{setting}` pattern {pattern!r} matches {matches_text}{hint}"


def find_subtree_ends(model: mujoco.MjModel) -> Int:
    """Return for each body the id after its last descendant, shape (nbody,).

    MuJoCo numbers bodies depth first. So body b and its descendants have the ids from b up to, and
    not including, entry b of the result.
    """
    subtree_ends = list(range(1, model.nbody + 1))
    parents = model.body_parentid.tolist()
    for body in range(model.nbody - 1, 0, -1):  # children come after their parents
        subtree_ends[parents[body]] = max(subtree_ends[parents[body]], subtree_ends[body])
    return np.array(subtree_ends, dtype=np.int64)


def geoms_of_bodies(model: mujoco.MjModel, first_body: int, end_body: int) -> Int:
    """Return the ids of the geoms of the bodies ``range(first_body, end_body)``, ascending.

    Args:
        model: the model.
        first_body: id of the first body.
        end_body: id of the last body, plus 1.
    """
    first_geom, end_geom = np.searchsorted(model.geom_bodyid, [first_body, end_body])
    return np.arange(first_geom, end_geom, dtype=np.int64)


def mark_geoms_of_bodies(model: mujoco.MjModel, first_body: int, end_body: int) -> Bool:
    """Return a mask of the geoms of the bodies ``range(first_body, end_body)``, shape (ngeom,).

    Args:
        model: the model.
        first_body: id of the first body.
        end_body: id of the last body, plus 1.
    """
    is_geom_of_bodies = np.zeros(model.ngeom, dtype=np.bool_)
    is_geom_of_bodies[geoms_of_bodies(model, first_body, end_body)] = True
    return is_geom_of_bodies
