"""Finds door candidates: bodies whose names match a pattern, or that look like a door's leaf."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    import mujoco

UNLIMITED_HINGE_RANGE = np.pi / 2  # how far a hinge without limits opens [rad]
UNLIMITED_SLIDE_RANGE = 1.0  # how far a slide without limits opens [m]
# The limits of the size of a leaf that no pattern names, and a tolerance for rounded sizes [m]
MIN_LEAF_HEIGHT = 1.5
MIN_LEAF_WIDTH = 0.4
MAX_LEAF_WIDTH = 2.5
MAX_LEAF_THICKNESS = 0.2
SIZE_ROUNDING = 1e-6
# A leaf without a joint stands between two jambs. These are the largest thickness of a jamb, the
# least height by which it rises above the leaf, and its largest distance from the leaf's end [m]
MAX_JAMB_THICKNESS = 0.6
MIN_JAMB_RISE = 0.1
MAX_JAMB_GAP = 0.1
MAX_LISTED_BODIES = 3  # the most bodies that a warning names


@dataclass(frozen=True, eq=False)
class DoorCandidate:
    """A body that may be a door.

    Attributes:
        id: the body's name, or ``body <id>``; the body id is added if two names look the same.
        joint: the name of the body's joint, or ``joint <id>``; None if the body can't move by a
            single hinge or slide.
        geoms: ids of the geoms of the body and its descendants that count, shape (n,).
        positions: state (``modelled``, ``open``, ``closed``) -> the joint's position [rad or m];
            empty if the body can't move by a single hinge or slide.
        joint_id: MuJoCo's id of the joint; -1 for none.
        is_named: whether a pattern or the scene's file names the body. If not, it is a candidate
            because it looks like a leaf.
    """

    id: str
    joint: str | None
    geoms: Int
    positions: dict[str, float]
    joint_id: int
    is_named: bool

    def position(self, state: str) -> float | None:
        """Return the joint's position in a state [rad or m]; None if `positions` is empty.

        Args:
            state: a key of `positions`; any other state has the modelled position.
        """
        return self.positions.get(state, self.positions.get("modelled"))

    def only(self, shapes: Shapes) -> Shapes:
        """Return the shapes of this candidate's geoms, selected from all shapes of a scene."""
        return shapes.only(mark_candidate_geoms(len(shapes.is_endless), [self]))


def find_door_candidates(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    shapes: Shapes,
    is_counted: Bool,
    is_movable_body: Bool,
    is_structure_body: Bool,
    named_leaves: Collection[str],
    settings: DoorSettings,
) -> tuple[list[DoorCandidate], list[str]]:
    """Find the bodies that may be doors, by name or by shape, and warn of unused patterns.

    By shape, a leaf is found if its parent is structure and one hinge or slide joins them. The
    joint's axis may have any direction: garage doors tilt, and roller doors go up. A leaf without a
    joint, as in IFC models, is found if it stands between walls that are higher than it. The
    descendants of a candidate are part of it.

    Args:
        model: the model.
        data: the model's pose.
        shapes: the geometry of all geoms that count.
        is_counted: for each geom, whether it counts, (ngeom,).
        is_movable_body: for each body, whether it can move and carries no floor, (nbody,).
        is_structure_body: for each body, whether it is structure, (nbody,).
        named_leaves: names of the bodies that are leaves of doors, as the scene's file says.
        settings: patterns, and whether leaves are searched for by their shape.

    Returns:
        The candidates, ascending by body id; and the warnings.
    """
    if not settings.patterns and not settings.find and not named_leaves:
        return [], []
    names = all_names(model).bodies
    subtree_ends = find_subtree_ends(model)
    joint_of_body = _find_only_joints(model)
    matching_patterns = [
        [pattern for pattern in settings.patterns if fnmatchcase(name, pattern)] for name in names
    ]
    matching_patterns[0] = []  # the world is no door
    is_named = [
        bool(patterns) or name in named_leaves
        for name, patterns in zip(names, matching_patterns, strict=True)
    ]
    is_named[0] = False
    searched_bodies = set[int]()
    if settings.find:
        hung_bodies = [
            body
            for body in joint_of_body
            if is_movable_body[body] and is_structure_body[model.body_parentid[body]]
        ]
        fixed_bodies = list[int]()
        if is_counted.sum() > 1:  # a leaf without a joint stands between other geoms
            fixed_bodies = [
                body
                for body in range(1, model.nbody)
                if body not in joint_of_body
                and not is_movable_body[body : subtree_ends[body]].any()
            ]
        searched_bodies = {body for body in (*hung_bodies, *fixed_bodies) if not is_named[body]}
    # body id -> geoms of the body and its descendants that count
    counted_geoms: dict[int, Int] = {}
    for body in range(1, model.nbody):
        if body in searched_bodies or is_named[body]:
            subtree_geoms = geoms_of_bodies(model, body, int(subtree_ends[body]))
            counted_geoms[body] = subtree_geoms[is_counted[subtree_geoms]]
    leaf_geoms = _find_leaf_geoms(
        shapes, model.ngeom, {body: counted_geoms[body] for body in searched_bodies}
    )
    fixed_leaves = {body: geom for body, geom in leaf_geoms.items() if body not in joint_of_body}
    if fixed_leaves:
        # Only structure can be a jamb.
        structure_shapes = shapes.only(is_structure_body[model.geom_bodyid])
        extents = measure_extents(structure_shapes, model.ngeom)
        for body, leaf_geom in fixed_leaves.items():
            if not _stands_between_jambs(leaf_geom, counted_geoms[body], extents):
                del leaf_geoms[body]
    candidate_bodies = list[int]()
    subtree_end = 0  # of the last candidate; its descendants are no candidates
    for body, body_geoms in counted_geoms.items():
        if body >= subtree_end and len(body_geoms) and (is_named[body] or body in leaf_geoms):
            candidate_bodies.append(body)
            subtree_end = int(subtree_ends[body])
    name_counts = Counter(names[body] for body in candidate_bodies)
    candidates = []
    for body in candidate_bodies:
        # Names that aren't UTF-8 may look the same.
        suffix = f" (body {body})" if name_counts[names[body]] > 1 else ""
        joint_id = joint_of_body.get(body, -1)
        candidates.append(
            DoorCandidate(
                id=names[body] + suffix,
                joint=None if joint_id < 0 else joint_name(model, joint_id),
                geoms=counted_geoms[body],
                positions={} if joint_id < 0 else _find_positions(model, data, joint_id),
                joint_id=joint_id,
                is_named=is_named[body],
            )
        )
    used_patterns = {pattern for body in candidate_bodies for pattern in matching_patterns[body]}
    warnings = [
        _warn_unused_pattern(pattern, names, matching_patterns, counted_geoms)
        for pattern in settings.patterns
        if pattern not in used_patterns
    ]
    return candidates, warnings


def _find_only_joints(model: mujoco.MjModel) -> dict[int, int]:
    """Return body id -> joint id, for the bodies whose only joint is a hinge or slide."""
    is_only_joint = np.isin(model.jnt_type, (HINGE, SLIDE))
    is_only_joint &= model.body_jntnum[model.jnt_bodyid] == 1
    return {int(model.jnt_bodyid[joint]): joint for joint in np.flatnonzero(is_only_joint).tolist()}


def _find_leaf_geoms(
    shapes: Shapes, num_geoms: int, geoms_of_body: Mapping[int, Int]
) -> dict[int, int]:
    """Find the bodies whose largest geom is as tall, thin and wide as a door, in the scene's pose.

    Args:
        shapes: the geometry of all geoms that count.
        num_geoms: the model's number of geoms.
        geoms_of_body: body id -> ids of the geoms to measure.

    Returns:
        Body id -> id of its largest geom, for each such body.
    """
    measured_geoms = [geom for body_geoms in geoms_of_body.values() for geom in body_geoms]
    is_measured_geom = np.isin(np.arange(num_geoms), measured_geoms)
    extents = measure_extents(shapes.only(is_measured_geom), num_geoms)
    leaf_geoms = {}
    for body, body_geoms in geoms_of_body.items():
        if not len(body_geoms):
            continue
        largest_geom = find_geom_of_largest_side(extents, body_geoms)
        is_tall = (
            extents.top[largest_geom] - extents.bottom[largest_geom]
            >= MIN_LEAF_HEIGHT - SIZE_ROUNDING
        )
        is_wide = extents.long_side[largest_geom] >= MIN_LEAF_WIDTH - SIZE_ROUNDING
        is_too_wide = extents.long_side[largest_geom] > MAX_LEAF_WIDTH + SIZE_ROUNDING
        is_thin = extents.short_side[largest_geom] <= MAX_LEAF_THICKNESS + SIZE_ROUNDING
        if is_tall and is_wide and is_thin and not is_too_wide:
            leaf_geoms[body] = largest_geom
    return leaf_geoms


def _stands_between_jambs(leaf_geom: int, body_geoms: Int, extents: Extents) -> bool:
    """Return whether there is a jamb at both ends of a leaf.

    A jamb is a piece of structure that begins below the leaf's middle and ends above its top.

    Args:
        leaf_geom: id of the leaf's largest geom.
        body_geoms: ids of all geoms of the leaf's body, which are no jambs.
        extents: bounding boxes of all geoms of the structure.
    """
    is_jamb = (extents.short_side <= MAX_JAMB_THICKNESS) & (extents.long_side > extents.short_side)
    is_jamb &= extents.top >= extents.top[leaf_geom] + MIN_JAMB_RISE
    is_jamb &= extents.bottom <= (extents.bottom[leaf_geom] + extents.top[leaf_geom]) / 2
    is_jamb[body_geoms] = False
    jambs = np.flatnonzero(is_jamb)
    long_axis = extents.long_axis[jambs]
    short_axis = extents.short_axis[jambs]
    distance_between_jambs = extents.long_side[leaf_geom] + 2 * MAX_JAMB_GAP
    for end_factor in (-0.5, 0.5):
        end_offset = end_factor * distance_between_jambs * extents.long_axis[leaf_geom]
        jamb_to_end = extents.center[leaf_geom] + end_offset - extents.center[jambs]
        # The distances of the leaf's end from the jambs' boxes, along each axis of the boxes
        short_gap = np.abs((jamb_to_end * short_axis).sum(axis=1)) - extents.short_side[jambs] / 2
        long_gap = np.abs((jamb_to_end * long_axis).sum(axis=1)) - extents.long_side[jambs] / 2
        if not (np.maximum(short_gap, long_gap) <= MAX_JAMB_GAP).any():
            return False
    return True


def _find_positions(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> dict[str, float]:
    """Find the positions of a door's joint when it is as modelled, open and closed.

    A door is closed at the position in the joint's range that is nearest to 0. It is open at the
    end of the range that is farther from the closed position.

    Returns:
        State (``modelled``, ``open``, ``closed``) -> position [rad or m].
    """
    range_start = float(model.jnt_range[joint, 0])
    range_end = float(model.jnt_range[joint, 1])
    if not model.jnt_limited[joint]:
        is_hinge = int(model.jnt_type[joint]) == HINGE
        range_start = 0.0
        range_end = UNLIMITED_HINGE_RANGE if is_hinge else UNLIMITED_SLIDE_RANGE
    closed_position = min(max(0.0, range_start), range_end)
    open_position = (
        range_start if closed_position - range_start > range_end - closed_position else range_end
    )
    modelled_position = float(data.qpos[model.jnt_qposadr[joint]])
    return {"modelled": modelled_position, "open": open_position, "closed": closed_position}


def find_geom_of_largest_side(extents: Extents, geoms: Int) -> int:
    """Return the geom whose bounding box has the largest upright face (longer side times height).

    If no geom has a finite face, it is the first geom.

    Args:
        extents: upright bounding boxes of all geoms.
        geoms: ids of the geoms to choose from, shape (n,), n >= 1.

    Returns:
        The geom's id.
    """
    face_areas = (extents.long_side * (extents.top - extents.bottom))[geoms]
    return int(geoms[0] if np.isnan(face_areas).all() else geoms[np.nanargmax(face_areas)])


def mark_candidate_geoms(num_geoms: int, candidates: Sequence[DoorCandidate]) -> Bool:
    """Return a mask of the geoms that belong to door candidates, shape (num_geoms,).

    Args:
        num_geoms: the model's number of geoms.
        candidates: the candidates.
    """
    is_candidate_geom = np.zeros(num_geoms, dtype=np.bool_)
    for candidate in candidates:
        is_candidate_geom[candidate.geoms] = True
    return is_candidate_geom


def _warn_unused_pattern(
    pattern: str,
    names: Sequence[str],
    matching_patterns: Sequence[list[str]],
    counted_geoms: Mapping[int, Int],
) -> str:
    """Make the warning that a pattern matches no candidate, and which bodies it matches instead.

    Args:
        pattern: the pattern.
        names: the names of all bodies.
        matching_patterns: for each body, the patterns that match its name.
        counted_geoms: body id -> geoms that count, for the bodies that were searched.
    """
    matched_bodies = [body for body in counted_geoms if pattern in matching_patterns[body]]
    if not matched_bodies:
        return warn_unmatched("doors.patterns", pattern, names[1:], "no body")
    bodies_in_doors = [body for body in matched_bodies if len(counted_geoms[body])]
    body_text = "parts of other doors" if bodies_in_doors else "bodies without geoms that count"
    listed_names = [names[body] for body in bodies_in_doors or matched_bodies]
    more_text = ", …" if len(listed_names) > MAX_LISTED_BODIES else ""
    matches_text = f"only {body_text}: {', '.join(listed_names[:MAX_LISTED_BODIES])}{more_text}"
    unmatched_names = [
        name for body, name in enumerate(names) if body and body not in matched_bodies
    ]
    return warn_unmatched("doors.patterns", pattern, unmatched_names, matches_text)
