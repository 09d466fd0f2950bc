"""Doors in the states that a grid states: their bodies moved by MuJoCo, or left out."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from navbake.baker.scene.bodies import find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.names import body_name
from navbake.baker.scene.scene import Scene
from navbake.navgrid.doors import Door
from navbake.navgrid.grid_base import GridBase

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


class DoorPose(NamedTuple):
    """How the doors stand.

    Attributes:
        data: MuJoCo's data with the doors' joints moved.
        removed: ids of the geoms of removed doors.
        geoms: ids of the geoms of all doors: no floor is one of them.
        unknown: ids of doors that the scene doesn't have.
    """

    data: Any
    removed: set[int]
    geoms: set[int]
    unknown: list[str]


def pose_doors(scene: Scene, grid: GridBase) -> DoorPose:
    """Move the doors of a scene into the states that a grid states."""
    model = scene.model
    bodies = {body_name(model, body): body for body in range(1, model.nbody)}
    ends = find_subtree_ends(model)
    data = mujoco.MjData(model)
    data.qpos[:] = scene.data.qpos
    data.mocap_pos[:], data.mocap_quat[:] = scene.data.mocap_pos, scene.data.mocap_quat
    removed: set[int] = set()
    geoms: set[int] = set()
    unknown = []
    for door in grid.doors:
        body = bodies.get(door.id, _numbered(door.id, model.nbody))
        if body is None:
            unknown.append(door.id)
            continue
        own = set(geoms_of_bodies(model, body, int(ends[body])).tolist())
        geoms |= own
        if door.state == "removed":
            removed |= own
        elif (position := _position(model, body, door)) is not None:
            data.qpos[model.jnt_qposadr[model.body_jntadr[body]]] = position
    mujoco.mj_kinematics(model, data)
    return DoorPose(data, removed, geoms, unknown)


def _numbered(name: str, count: int) -> int | None:
    """The body of a door whose name others share, as in ``leaf (body 3)``."""
    number = name.rpartition("(body ")[2].removesuffix(")")
    return int(number) if number.isdecimal() and int(number) < count else None


def _position(model: Any, body: int, door: Door) -> float | None:
    """Where its hinge or slide is in the door's state [rad or m]; None as it is modelled.

    It opens to the end of its range that is farther from where it is closed, which is at 0 or
    next to it. Without a range, a hinge opens by a quarter turn, a slide by a metre.
    """
    joint = int(model.body_jntadr[body])
    if door.state not in ("open", "closed") or joint < 0 or model.body_jntnum[body] != 1:
        return None
    if int(model.jnt_type[joint]) not in (HINGE, SLIDE):
        return None
    low, high = (float(v) for v in model.jnt_range[joint])
    if not model.jnt_limited[joint]:
        low, high = 0.0, np.pi / 2 if int(model.jnt_type[joint]) == HINGE else 1.0
    closed = min(max(0.0, low), high)
    if door.state == "closed":
        return closed
    return low if closed - low > high - closed else high
