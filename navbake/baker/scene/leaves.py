"""Door candidates: bodies that a pattern names, or that look like a door's leaf."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from navbake.baker.core.constants import HINGE, SLIDE
from navbake.baker.geometry.extents import Extents, measure_extents
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.names import (
    all_names,
    find_subtree_ends,
    geoms_of_bodies,
    joint_name,
    warn_unmatched,
)
from navbake.config.settings import DoorSettings
from navbake.types import Bool, Int

QUARTER = np.pi / 2  # how far a hinge without limits opens [rad]
# The size of a leaf that no pattern names, and the rounding that is allowed for [m]
MIN_HEIGHT = 1.5
MIN_WIDTH = 0.4
MAX_WIDTH = 2.5
MAX_THICKNESS = 0.2
ROUNDING = 1e-6
# What a leaf without a joint stands between: no thicker than that, higher than it by this, and so
# near to its ends [m]
JAMB = 0.6
HIGHER = 0.1
BESIDE = 0.1
MAX_LISTED = 3  # bodies that a warning names at most


@dataclass(frozen=True, eq=False)
class DoorCandidate:
    """A body that may be a door."""

    id: str  # its body's name, or ``body <id>``; with its number where two look the same
    joint: str | None  # its joint's name, or ``joint <id>``; None where it can't move
    geoms: Int  # ids of the counted geoms of the body and its descendants, shape (n,)
    positions: dict[str, float]  # of the joint, by state but removed [rad or m]; empty for none
    joint_id: int  # MuJoCo's, -1 for none
    named: bool  # by a pattern or by the file; else it was found by its joint and shape

    def position(self, state: str) -> float | None:
        """The joint's position in a state, as modelled where it hasn't that; None for no joint."""
        return self.positions.get(state, self.positions.get("modelled"))

    def only(self, shapes: Shapes) -> Shapes:
        """The part of `shapes` that belongs to this candidate."""
        return shapes.only(mark_candidate_geoms(len(shapes.endless), [self]))


def find_door_candidates(
    model: Any,
    data: Any,
    shapes: Shapes,
    counted: Bool,
    movable: Bool,
    is_structure_body: Bool,
    named: Collection[str],
    settings: DoorSettings,
) -> tuple[list[DoorCandidate], list[str]]:
    """Find bodies that may be doors, by name or by shape, by body id; warn of unused patterns.

    A leaf that no pattern names hangs on what stands, by one hinge or slide, about or along any
    axis: garage doors tilt, and rollers go up. One without a joint, as in IFC models, stands
    between walls that are higher than it. The descendants of a candidate are part of it.

    Args:
        model, data: the posed model.
        shapes: all geometry that counts.
        counted: by geom, whether it counts.
        movable: by body, whether it can move.
        is_structure_body: by body, whether it is part of what stands.
        named: the names of bodies that the file says are doors.
        settings: patterns, and whether leaves are looked for.
    """
    if not settings.patterns and not settings.find and not named:
        return [], []
    names = all_names(model).bodies
    ends = find_subtree_ends(model)
    # the hinge or slide of each body that has no other joint
    alone = np.isin(model.jnt_type, (HINGE, SLIDE)) & (model.body_jntnum[model.jnt_bodyid] == 1)
    joints = {int(model.jnt_bodyid[joint]): joint for joint in np.flatnonzero(alone).tolist()}
    # by body id, the patterns that match its name; none for the world
    matches = [[p for p in settings.patterns if fnmatchcase(name, p)] for name in names]
    matches[0] = []
    is_named = [bool(matches[k]) or names[k] in named for k in range(model.nbody)]
    is_named[0] = False
    searched = set[int]()
    if settings.find:
        hung = (k for k in joints if movable[k] and is_structure_body[model.body_parentid[k]])
        # a leaf without a joint stands between other geoms
        num_bodies = model.nbody if counted.sum() > 1 else 1
        jointless = (k for k in range(1, num_bodies) if k not in joints)
        fixed = (k for k in jointless if not movable[k : ends[k]].any())
        searched = {body for body in (*hung, *fixed) if not is_named[body]}
    geoms: dict[int, Int] = {}  # of bodies that are searched or match, descendants' included
    for body in range(1, model.nbody):
        if body in searched or is_named[body]:
            under = geoms_of_bodies(model, body, int(ends[body]))
            geoms[body] = under[counted[under]]
    leaves = _find_leaves(shapes, model.ngeom, {body: geoms[body] for body in searched})
    fixed_leaves = {body: leaf for body, leaf in leaves.items() if body not in joints}
    if fixed_leaves:
        # what can move is no jamb
        extents = measure_extents(shapes.only(is_structure_body[model.geom_bodyid]), model.ngeom)
        for body, leaf in fixed_leaves.items():
            if not _stands_between_jambs(leaf, geoms[body], extents):
                del leaves[body]
    # and the end of the bodies of the last candidate
    found = list[int]()
    end = 0
    for body, own in geoms.items():
        if body >= end and len(own) and (is_named[body] or body in leaves):
            found.append(body)
            end = int(ends[body])
    count = Counter(names[body] for body in found)
    candidates = []
    for body in found:
        # names that aren't UTF-8 may look the same
        name = names[body] + (f" (body {body})" if count[names[body]] > 1 else "")
        joint = joints.get(body, -1)
        candidates.append(
            DoorCandidate(
                id=name,
                joint=None if joint < 0 else joint_name(model, joint),
                geoms=geoms[body],
                positions={} if joint < 0 else _positions(model, data, joint),
                joint_id=joint,
                named=is_named[body],
            )
        )
    used = {pattern for body in found for pattern in matches[body]}
    unused = [pattern for pattern in settings.patterns if pattern not in used]
    return candidates, [_warn_unmatched(p, names, matches, geoms) for p in unused]


def _find_leaves(shapes: Shapes, num_geoms: int, geoms: Mapping[int, Int]) -> dict[int, int]:
    """Bodies whose largest geom, in the modelled pose, is as tall, thin and wide as a door."""
    mask = np.isin(np.arange(num_geoms), [k for own in geoms.values() for k in own])
    extents = measure_extents(shapes.only(mask), num_geoms)
    sides = {body: find_largest_side(extents, own) for body, own in geoms.items() if len(own)}
    return {
        body: leaf
        for body, leaf in sides.items()
        if extents.top[leaf] - extents.bottom[leaf] >= MIN_HEIGHT - ROUNDING
        and MIN_WIDTH - ROUNDING <= extents.long_side[leaf] <= MAX_WIDTH + ROUNDING
        and extents.short_side[leaf] <= MAX_THICKNESS + ROUNDING
    }


def _stands_between_jambs(leaf: int, own: Int, extents: Extents) -> bool:
    """Whether both ends of a leaf are at something like a wall, from its foot to above its top."""
    jambs = (extents.short_side <= JAMB) & (extents.long_side > extents.short_side)
    jambs &= extents.top >= extents.top[leaf] + HIGHER
    jambs &= extents.bottom <= (extents.bottom[leaf] + extents.top[leaf]) / 2
    jambs[own] = False
    found = np.flatnonzero(jambs)
    for end in (-0.5, 0.5):
        beyond = end * (extents.long_side[leaf] + 2 * BESIDE) * extents.long_axis[leaf]
        off = extents.center[leaf] + beyond - extents.center[found]
        across = (
            np.abs((off * extents.short_axis[found]).sum(axis=1)) - extents.short_side[found] / 2
        )
        along = np.abs((off * extents.long_axis[found]).sum(axis=1)) - extents.long_side[found] / 2
        if not (np.maximum(across, along) <= BESIDE).any():
            return False
    return True


def _positions(model: Any, data: Any, joint: int) -> dict[str, float]:
    """A joint's positions by state: it opens to the end of its range that is farther from 0."""
    low, high = (float(v) for v in model.jnt_range[joint])
    if not model.jnt_limited[joint]:
        low = 0.0
        high = QUARTER if int(model.jnt_type[joint]) == HINGE else 1.0
    closed = min(max(0.0, low), high)
    opened = low if closed - low > high - closed else high
    modelled = float(data.qpos[model.jnt_qposadr[joint]])
    return {"modelled": modelled, "open": opened, "closed": closed}


def find_largest_side(extents: Extents, geoms: Int) -> int:
    """The geom with the largest upright side; the first if none is finite."""
    area = (extents.long_side * (extents.top - extents.bottom))[geoms]
    return int(geoms[0] if np.isnan(area).all() else geoms[np.nanargmax(area)])


def mark_candidate_geoms(num_geoms: int, doors: Sequence[DoorCandidate]) -> Bool:
    """Mark the geoms of some bodies, shape (num_geoms,)."""
    mask = np.zeros(num_geoms, dtype=np.bool_)
    for door in doors:
        mask[door.geoms] = True
    return mask


def _warn_unmatched(
    pattern: str, names: Sequence[str], matches: Sequence[list[str]], geoms: Mapping[int, Int]
) -> str:
    """Warn of a pattern that names no candidate, and say which bodies it matches instead."""
    matched = [body for body in geoms if pattern in matches[body]]
    if not matched:
        return warn_unmatched("doors.patterns", pattern, names[1:], "no body")
    parts = [body for body in matched if len(geoms[body])]
    kind = "parts of other doors" if parts else "bodies without geoms that count"
    listed = [names[body] for body in parts or matched]
    text = f"only {kind}: {', '.join(listed[:MAX_LISTED])}{', …' if listed[MAX_LISTED:] else ''}"
    others = [name for body, name in enumerate(names) if body and body not in matched]
    return warn_unmatched("doors.patterns", pattern, others, text)
