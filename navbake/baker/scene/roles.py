"""Finds the roles of geoms: structure, structure that moves, movables, and leaves of doors.

Floors, walls and rooms come from structure; movables only block cells.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.cars import find_cars
from navbake.baker.scene.leaves import DoorCandidate, find_door_candidates, mark_candidate_geoms
from navbake.baker.scene.names import all_names, find_subtree_ends, warn_unmatched
from navbake.config.settings import BakeConfig
from navbake.types import Bool, Int

if TYPE_CHECKING:
    import mujoco

# The roles of geoms. MOVING_STRUCTURE carries floors, but is no wall
LEFT_OUT, STATIC_STRUCTURE, MOVING_STRUCTURE, MOVABLE, LEAF = range(5)
# The names of these roles in reports
ROLE_NAMES = ("", "structure", "structure that moves", "movable", "leaf")

# MuJoCo's codes of what an actuator moves (mjtTrn)
JOINT, JOINT_IN_PARENT, SLIDER_CRANK, TENDON, SITE, BODY = range(6)
# MuJoCo's codes of what a tendon runs over (mjtWrap)
WRAP_JOINT = 1
WRAP_SITE = 3


class SceneRoles(NamedTuple):
    """The roles of a scene's geoms and bodies.

    Attributes:
        roles: for each geom, LEFT_OUT, STATIC_STRUCTURE, MOVING_STRUCTURE, MOVABLE or LEAF, shape
            (ngeom,), uint8.
        is_movable_body: for each body, whether it can move and carries no floor, shape (nbody,),
            bool.
        is_structure_body: for each body, whether it is structure, shape (nbody,), bool.
        mover_of_body: for each body, the id of the body that it moves with: of a movable body, its
            topmost movable ancestor or itself; of any other body, itself; shape (nbody,).
        leaves: the door candidates, ascending by body id.
        car_bodies: ids of the bodies that are cars of lifts, ascending.
        pattern_warnings: warnings of patterns of doors that match nothing, one line each.
        warnings: all other warnings, one line each.
    """

    roles: NDArray[np.uint8]
    is_movable_body: Bool
    is_structure_body: Bool
    mover_of_body: Int
    leaves: list[DoorCandidate]
    car_bodies: list[int]
    pattern_warnings: list[str]
    warnings: list[str]


def find_movable_bodies(model: mujoco.MjModel) -> Bool:
    """Return a mask of the bodies that can move, shape (nbody,).

    A body can move if it or one of its ancestors has a joint or is a mocap body.
    """
    is_mocap = model.body_mocapid[model.body_rootid] >= 0
    is_movable_body: Bool = (model.body_weldid != 0) | is_mocap
    return is_movable_body


def mark_structure(roles: NDArray[np.uint8]) -> Bool:
    """Return a mask of the geoms that are structure, whether they can move or not, (ngeom,)."""
    is_structure: Bool = (roles == STATIC_STRUCTURE) | (roles == MOVING_STRUCTURE)
    return is_structure


def find_roles(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    shapes: Shapes,
    is_counted: Bool,
    named_leaves: Collection[str],
    config: BakeConfig,
) -> SceneRoles:
    """Find the role of each geom that counts: structure, movable, or a leaf of a door.

    Geoms that can't move are structure. So are those of bodies that move and carry floors: bodies
    that `floors.movable` names, cars of lifts, and the descendants of both. If no geom would be
    structure, all bodies count as structure in their present pose.

    Args:
        model: the model.
        data: the model's pose.
        shapes: the geometry of all geoms that count.
        is_counted: for each geom, whether it counts, (ngeom,).
        named_leaves: names of the bodies that are leaves of doors, as the scene's file says.
        config: all settings.

    Returns:
        The roles of geoms and bodies, and warnings.
    """
    is_movable_body = find_movable_bodies(model)
    subtree_ends = find_subtree_ends(model)
    names = all_names(model).bodies
    warnings = list[str]()
    for pattern in config.floors.movable:
        bodies = [body for body in range(1, model.nbody) if fnmatchcase(names[body], pattern)]
        for body in bodies:
            is_movable_body[body : subtree_ends[body]] = False
        if not bodies:
            warnings.append(warn_unmatched("floors.movable", pattern, names[1:], "no body"))
    car_bodies = find_cars(model, data, shapes, config.links, config.agent, config.grid.cell_size)
    for body in car_bodies:
        is_movable_body[body : subtree_ends[body]] = False

    def find_leaves(is_structure_body: Bool) -> tuple[list[DoorCandidate], list[str]]:
        return find_door_candidates(
            model,
            data,
            shapes=shapes,
            is_counted=is_counted,
            is_movable_body=is_movable_body,
            is_structure_body=is_structure_body,
            named_leaves=named_leaves,
            settings=config.doors,
        )

    is_structure_body = ~is_movable_body
    leaves, pattern_warnings = find_leaves(is_structure_body)
    roles = assign_roles(model, is_counted, is_movable_body, is_structure_body, leaves)
    if not mark_structure(roles).any():
        warnings.append(
            "all bodies can move or look like doors, so that nothing stands: floors, walls and "
            "rooms are made of all of them in the baked pose; `floors.movable` names those that "
            "stand"
        )
        is_structure_body = np.ones_like(is_movable_body)
        leaves, pattern_warnings = find_leaves(is_structure_body)
        roles = assign_roles(model, is_counted, is_movable_body, is_structure_body, leaves)
    if not mark_structure(roles).any():
        leaves = []
        roles = assign_roles(model, is_counted, is_movable_body, is_structure_body, leaves)
    return SceneRoles(
        roles=roles,
        is_movable_body=is_movable_body,
        is_structure_body=is_structure_body,
        mover_of_body=_find_movers(model, is_movable_body),
        leaves=leaves,
        car_bodies=car_bodies,
        pattern_warnings=pattern_warnings,
        warnings=warnings,
    )


def assign_roles(
    model: mujoco.MjModel,
    is_counted: Bool,
    is_movable_body: Bool,
    is_structure_body: Bool,
    leaves: Sequence[DoorCandidate],
) -> NDArray[np.uint8]:
    """Return the role of each geom, which follows from its body.

    Args:
        model: the model.
        is_counted: for each geom, whether it counts, (ngeom,).
        is_movable_body: for each body, whether it can move and carries no floor, (nbody,).
        is_structure_body: for each body, whether it is structure, (nbody,).
        leaves: the door candidates.

    Returns:
        The role of each geom, shape (ngeom,), uint8.
    """
    body_roles = np.where(is_structure_body, STATIC_STRUCTURE, MOVABLE)
    body_roles[find_movable_bodies(model) & ~is_movable_body] = MOVING_STRUCTURE
    roles: NDArray[np.uint8] = body_roles[model.geom_bodyid].astype(np.uint8)
    roles[mark_candidate_geoms(model.ngeom, leaves)] = LEAF
    roles[~is_counted] = LEFT_OUT
    return roles


def _find_movers(model: mujoco.MjModel, is_movable_body: Bool) -> Int:
    """Find the topmost movable ancestor of each movable body, see `SceneRoles.mover_of_body`."""
    movers = np.arange(model.nbody)
    for body, parent in enumerate(model.body_parentid.tolist()):  # parents come first
        if is_movable_body[body] and is_movable_body[parent]:
            movers[body] = movers[parent]
    return movers


def find_actuated_bodies(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the bodies that actuators move: by joints, sites, tendons, or directly."""
    body_ids = set[int]()
    transmission_types = model.actuator_trntype.tolist()
    target_ids = model.actuator_trnid[:, 0].tolist()
    for transmission_type, target_id in zip(transmission_types, target_ids, strict=True):
        if transmission_type in (JOINT, JOINT_IN_PARENT):
            body_ids.add(int(model.jnt_bodyid[target_id]))
        elif transmission_type in (SLIDER_CRANK, SITE):
            body_ids.add(int(model.site_bodyid[target_id]))
        elif transmission_type == BODY:
            body_ids.add(target_id)
        elif transmission_type == TENDON:
            body_ids |= _find_bodies_of_tendon(model, target_id)
    return body_ids


def _find_bodies_of_tendon(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Return the ids of the bodies whose joints or sites a tendon runs over."""
    body_ids = set[int]()
    first_wrap = int(model.tendon_adr[tendon])
    for wrap in range(first_wrap, first_wrap + int(model.tendon_num[tendon])):
        wrapped_id = int(model.wrap_objid[wrap])
        if model.wrap_type[wrap] == WRAP_JOINT:
            body_ids.add(int(model.jnt_bodyid[wrapped_id]))
        elif model.wrap_type[wrap] == WRAP_SITE:
            body_ids.add(int(model.site_bodyid[wrapped_id]))
    return body_ids
