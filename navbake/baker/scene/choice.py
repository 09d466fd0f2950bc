"""Which geoms of a model count, by the settings, and why. Does not import mujoco."""

from collections.abc import Callable, Iterable, Mapping
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.kernels.constants import FREE, MESH, SDF
from navbake.baker.scene.names import GeomNames, all_names, warn_unmatched
from navbake.config.settings import SceneSettings
from navbake.types import Bool, Float

DRAWN_GROUPS = 3  # MuJoCo's viewers draw the geom groups below this unless told otherwise


class Choice(NamedTuple):
    """What becomes of one geom."""

    counted: bool  # whether it takes part in the bake
    reason: str
    mesh: str  # as what, if it is a mesh: hull, surface (or auto), or shell, which encloses nothing


def choose_geoms(
    model: Any,
    settings: SceneSettings,
    hides_room: Callable[[int], bool],
    ground: int | None = None,
    said: Mapping[int, str] | None = None,
) -> tuple[list[Choice], list[str]]:
    """Decide for each geom whether it counts, and meshes as what.

    Excluded geoms never count. `collision` counts geoms that can collide (contype or conaffinity
    not 0). `auto` does the same, but counts all geoms if none of those left can collide. `visual`
    counts geoms that are drawn (alpha above 0, in a group that MuJoCo's viewers draw), but for
    those that can collide on a body, not the world, with drawn geoms of another group that can't.
    `scene.meshes: auto` takes a mesh that collides as its hull, as MuJoCo does, unless that hides
    room for an agent; or as `said`, by geom id, where the scene's file says it. `ground` always
    counts.

    Returns a choice for each geom, by its id, and what the user should know.
    """
    names = all_names(model).geoms
    excluded, notes = _find_excluded(model, settings, names)
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    any_collides = any(can and not out for can, out in zip(collides, excluded, strict=True))
    counts = _rule(model, settings.geoms, collides, any_collides)
    rules = [(False, out) if out else rule for out, rule in zip(excluded, counts, strict=True)]
    if ground is not None:
        rules[ground] = (True, "added by `scene.ground`")
    by_pattern = settings.meshes
    if isinstance(by_pattern, str):
        modes: list[str] = [by_pattern] * len(names)
    else:
        pairs = by_pattern.items()
        modes = [next((mode for p, mode in pairs if _matches(p, name)), "auto") for name in names]
        of_meshes = np.flatnonzero(np.isin(model.geom_type, (MESH, SDF)))
        known = [text for geom in of_meshes for text in names[geom]]
        notes += _unused("scene.meshes", by_pattern, known, "no mesh")
    for geom, mode in (said or {}).items():
        modes[geom] = mode if modes[geom] == "auto" else modes[geom]
    opened = []
    # MuJoCo collides meshes by their hull, but not signed distance fields
    for geom in np.flatnonzero(collides & (model.geom_type == MESH)).tolist():
        if modes[geom] == "auto" and rules[geom][0]:
            modes[geom] = "surface" if hides_room(geom) else "hull"
            opened += [names[geom].geom] if modes[geom] == "surface" else []
    choices = [Choice(*rule, mode) for rule, mode in zip(rules, modes, strict=True)]
    if opened:
        more = f", and {len(opened) - 1} more" if opened[1:] else ""
        because = "because its convex hull hides room to stand in; MuJoCo collides the hull"
        which = "set `scene.meshes` to surface or hull to say which"
        notes.append(f"mesh geom {opened[0]!r}{more} counts by its triangles, {because}: {which}")
    return choices, notes


def _rule(model: Any, geoms: str, collides: Bool, any_collides: bool) -> list[tuple[bool, str]]:
    """For each geom, whether it counts by `scene.geoms`, and why."""
    if geoms == "all":
        return [(True, "all geoms count")] * model.ngeom
    if geoms == "auto" and not any_collides:
        return [(True, "no geom can collide, so all count")] * model.ngeom
    if geoms != "visual":
        no, yes = (False, "can't collide (contype and conaffinity are 0)"), (True, "can collide")
        return [yes if can else no for can in collides]
    # a geom's opacity is its material's, unless its own colour was set (as MuJoCo draws it)
    alpha: Float = model.geom_rgba[:, 3].astype(np.float64)
    is_default = (model.geom_rgba == np.array([0.5, 0.5, 0.5, 1.0], np.float32)).all(axis=1)
    by_material = (model.geom_matid >= 0) & is_default
    alpha[by_material] = model.mat_rgba[model.geom_matid[by_material], 3]
    groups, bodies = model.geom_group.tolist(), model.geom_bodyid.tolist()
    drawn = (alpha > 0) & (model.geom_group < DRAWN_GROUPS)
    visuals: dict[int, set[int]] = {}
    for visual in np.flatnonzero(drawn & ~collides & (model.geom_bodyid > 0)).tolist():
        visuals.setdefault(bodies[visual], set()).add(groups[visual])
    rule = []
    for geom, (group, body) in enumerate(zip(groups, bodies, strict=True)):
        if group >= DRAWN_GROUPS:
            rule.append((False, f"not drawn (group {group})"))
        elif not drawn[geom]:
            rule.append((False, "not drawn (alpha 0)"))
        elif collides[geom] and visuals.get(body, set()) - {group}:
            rule.append((False, "stands in for its body's visual geoms"))
        else:
            rule.append((True, "is drawn"))
    return rule


def _find_excluded(
    model: Any, settings: SceneSettings, names: list[GeomNames]
) -> tuple[list[str], list[str]]:
    """Why each geom is excluded, with its body or one above, or empty; and unmatched patterns."""
    exclude, parents = settings.exclude, model.body_parentid.tolist()
    free = set(model.jnt_bodyid[model.jnt_type == FREE].tolist())
    of_bodies, bodies = [""] * model.nbody, all_names(model).bodies
    for body in range(1, model.nbody):  # parents come before their children
        pattern = _first_match(exclude.bodies, bodies[body])
        if pattern:
            of_bodies[body] = f"excluded: body {bodies[body]!r} matches {pattern!r}"
        elif exclude.movable and body in free:
            of_bodies[body] = f"excluded: body {bodies[body]!r} is movable (free joint)"
        else:
            of_bodies[body] = of_bodies[parents[body]]
    reasons = [of_bodies[body] for body in model.geom_bodyid.tolist()]
    for geom, name in enumerate(names) if exclude.geoms else ():
        pattern = _first_match(exclude.geoms, name.geom)
        reasons[geom] = f"excluded: matches {pattern!r}" if pattern else reasons[geom]
    notes = _unused("scene.exclude.bodies", exclude.bodies, bodies[1:])
    return reasons, notes + _unused("scene.exclude.geoms", exclude.geoms, [n.geom for n in names])


def _matches(pattern: str, names: Iterable[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names if name)


def _first_match(patterns: Iterable[str], name: str) -> str | None:
    return next((pattern for pattern in patterns if fnmatchcase(name, pattern)), None)


def _unused(
    setting: str, patterns: Iterable[str], names: list[str], found: str = "nothing"
) -> list[str]:
    unmatched = [pattern for pattern in patterns if not _matches(pattern, names)]
    return [warn_unmatched(setting, pattern, names, found) for pattern in unmatched]
