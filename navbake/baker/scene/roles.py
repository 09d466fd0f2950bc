"""What of a scene stands, what can move, and what may be a door.

What stands makes floors, walls and rooms; what can move is only ever in the way.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.cars import find_cars
from navbake.baker.scene.leaves import DoorCandidate, find_door_candidates, mark_candidate_geoms
from navbake.baker.scene.names import all_names, find_subtree_ends, warn_unmatched
from navbake.config.settings import BakeConfig
from navbake.types import Bool, Int

# The role of a geom; a carrier is what moves and carries floors nevertheless, but is no wall
LEFT_OUT, STATIC_STRUCTURE, MOVING_STRUCTURE, MOVABLE, LEAF = range(5)
# and its name in reports
ROLES = ("", "structure", "structure that moves", "movable", "leaf")

# What an actuator moves (MuJoCo's mjtTrn), and what a tendon runs over (mjtWrap)
JOINT, JOINT_IN_PARENT, SLIDER_CRANK, TENDON, SITE, BODY = range(6)
WRAP_JOINT = 1
WRAP_SITE = 3


class SceneRoles(NamedTuple):
    """How a scene is divided into structure, movables and leaves.

    Attributes:
        roles: by geom id, LEFT_OUT, STATIC_STRUCTURE, MOVING_STRUCTURE, MOVABLE or LEAF, shape
            (ngeom,), uint8.
        movable: by body id, whether it can move and carries no floor, shape (nbody,), bool.
        is_structure_body: by body id, whether it is structure, shape (nbody,), bool.
        mover_of_body: by body id, the topmost body that moves it; itself if none does.
        leaves: the bodies that may be doors, by body id.
        cars: the bodies that are cars of lifts, by body id.
        unused: warnings of patterns of doors that match nothing.
        warnings: what the user should know besides, one line each.
    """

    roles: NDArray[np.uint8]
    movable: Bool
    is_structure_body: Bool
    mover_of_body: Int
    leaves: list[DoorCandidate]
    cars: list[int]
    unused: list[str]
    warnings: list[str]


def find_movable_bodies(model: Any) -> Bool:
    """Mark the bodies that are not welded to the world, shape (nbody,).

    They, or bodies above them, have a joint, or are mocap bodies.
    """
    is_mocap = model.body_mocapid[model.body_rootid] >= 0
    movable: Bool = (model.body_weldid != 0) | is_mocap
    return movable


def mark_structure(roles: NDArray[np.uint8]) -> Bool:
    """Mark the geoms that make floors, by their roles."""
    structure: Bool = (roles == STATIC_STRUCTURE) | (roles == MOVING_STRUCTURE)
    return structure


def find_roles(
    model: Any,
    data: Any,
    shapes: Shapes,
    counted: Bool,
    named_leaves: Collection[str],
    config: BakeConfig,
) -> SceneRoles:
    """Divide the geoms that count into what stands, what can move, and leaves of doors.

    Bodies that `floors.movable` names, and cars of lifts, carry floors, with all that hangs on
    them. Where nothing stands, all bodies are taken as they stand.

    Args:
        model, data: the posed model.
        shapes: all geometry that counts.
        counted: by geom, whether it counts.
        named_leaves: the names of bodies that the file says are doors.
    """
    movable = find_movable_bodies(model)
    ends = find_subtree_ends(model)
    names = all_names(model).bodies
    warnings = list[str]()
    for pattern in config.floors.movable:
        matching = [body for body in range(1, model.nbody) if fnmatchcase(names[body], pattern)]
        for body in matching:
            movable[body : ends[body]] = False
        if not matching:
            warnings.append(warn_unmatched("floors.movable", pattern, names[1:], "no body"))
    cars = find_cars(model, data, shapes, config.links, config.agent, config.grid.cell_size)
    for body in cars:
        movable[body : ends[body]] = False

    def find_leaves(is_structure_body: Bool) -> tuple[list[DoorCandidate], list[str]]:
        return find_door_candidates(
            model,
            data,
            shapes=shapes,
            counted=counted,
            movable=movable,
            is_structure_body=is_structure_body,
            named=named_leaves,
            settings=config.doors,
        )

    is_structure_body = ~movable
    leaves, unused = find_leaves(is_structure_body)
    roles = assign_roles(model, counted, movable, is_structure_body, leaves)
    if not mark_structure(roles).any():
        warnings.append(
            "all bodies can move or look like doors, so that nothing stands: floors, walls and "
            "rooms are made of all of them in the baked pose; `floors.movable` names those that "
            "stand"
        )
        is_structure_body = np.ones_like(movable)
        leaves, unused = find_leaves(is_structure_body)
        roles = assign_roles(model, counted, movable, is_structure_body, leaves)
    if not mark_structure(roles).any():
        leaves = []
        roles = assign_roles(model, counted, movable, is_structure_body, leaves)
    return SceneRoles(
        roles=roles,
        movable=movable,
        is_structure_body=is_structure_body,
        mover_of_body=_find_movers(model, movable),
        leaves=leaves,
        cars=cars,
        unused=unused,
        warnings=warnings,
    )


def assign_roles(
    model: Any,
    counted: Bool,
    movable: Bool,
    is_structure_body: Bool,
    leaves: Sequence[DoorCandidate],
) -> NDArray[np.uint8]:
    """The role of each geom, shape (ngeom,).

    Args:
        counted: by geom, whether it counts.
        movable, is_structure_body: see `SceneRoles`.
        leaves: the bodies that may be doors.
    """
    of_bodies = np.where(is_structure_body, STATIC_STRUCTURE, MOVABLE)
    of_bodies[find_movable_bodies(model) & ~movable] = MOVING_STRUCTURE
    roles: NDArray[np.uint8] = of_bodies[model.geom_bodyid].astype(np.uint8)
    roles[mark_candidate_geoms(model.ngeom, leaves)] = LEAF
    roles[~counted] = LEFT_OUT
    return roles


def _find_movers(model: Any, movable: Bool) -> Int:
    """By body id, the topmost body that moves it; itself if none does."""
    mover_of_body = np.arange(model.nbody)
    for body, parent in enumerate(model.body_parentid.tolist()):  # parents come first
        if movable[body] and movable[parent]:
            mover_of_body[body] = mover_of_body[parent]
    return mover_of_body


def find_actuated_bodies(model: Any) -> set[int]:
    """The bodies that actuators move: by their joints, sites, tendons, or as they are."""
    bodies = set[int]()
    kinds = model.actuator_trntype.tolist()
    for kind, number in zip(kinds, model.actuator_trnid[:, 0].tolist(), strict=True):
        if kind in (JOINT, JOINT_IN_PARENT):
            bodies.add(int(model.jnt_bodyid[number]))
        elif kind in (SLIDER_CRANK, SITE):
            bodies.add(int(model.site_bodyid[number]))
        elif kind == BODY:
            bodies.add(number)
        elif kind == TENDON:
            first = int(model.tendon_adr[number])
            wraps = range(first, first + int(model.tendon_num[number]))
            for wrap in wraps:
                thing = int(model.wrap_objid[wrap])
                if model.wrap_type[wrap] == WRAP_JOINT:
                    bodies.add(int(model.jnt_bodyid[thing]))
                elif model.wrap_type[wrap] == WRAP_SITE:
                    bodies.add(int(model.site_bodyid[thing]))
    return bodies
