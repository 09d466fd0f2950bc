"""What MuJoCo says of poses of a base: what it meets, how far it is from a thing, what it sees."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np

STEP = 0.25  # what is lower is stepped over [m]
TOUCH = 1e-5  # less than this is touching, not meeting, for MuJoCo's distances [m]
AXIS_RADIUS = 1e-4  # of the capsule that stands for the base's axis [m]
AXIS_HALF_LENGTH = 30.0
EYE_RADIUS = 1e-4
MAX_DISTANCE = 3.0


class Judgement(NamedTuple):
    """What is true of a pose.

    Attributes:
        met: names of the geoms that the base meets.
        distance: from its axis to the target on the floor plan [m].
        is_seen: whether a ray from the eye meets the target first.
    """

    met: list[str]
    distance: float
    is_seen: bool


class BaseInScene:
    """A scene with a base that can be put anywhere: a box over its footprint, an axis, an eye.

    Geoms of which MuJoCo measures no distances (height fields, SDF) are left out.

    Args:
        path: the scene, an MJCF.
        footprint: length and width of the base's box [m]; its middle is its axis.
        height: height of the base and of its eye [m].
        keyframe: name of the pose; None for the pose of the file.
    """

    def __init__(
        self, path: str, footprint: tuple[float, float], height: float, keyframe: str | None = None
    ) -> None:
        spec = mujoco.MjSpec.from_file(path)
        pose = {key.name: np.array(key.qpos) for key in spec.keys}.get(keyframe)
        for key in list(spec.keys):
            spec.delete(key)
        body = spec.worldbody.add_body(name="base", mocap=True)
        half_height = (height - STEP) / 2
        geoms = mujoco.mjtGeom
        body.add_geom(
            name="base",
            type=geoms.mjGEOM_BOX,
            size=[footprint[0] / 2, footprint[1] / 2, half_height],
            pos=[0.0, 0.0, STEP + half_height],
        )
        body.add_geom(
            name="axis", type=geoms.mjGEOM_CAPSULE, size=[AXIS_RADIUS, AXIS_HALF_LENGTH, 0.0]
        )
        body.add_geom(
            name="eye", type=geoms.mjGEOM_SPHERE, size=[EYE_RADIUS, 0, 0], pos=[0.0, 0.0, height]
        )
        self.height = height
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        if pose is not None:
            self.data.qpos[:] = pose
        mujoco.mj_kinematics(self.model, self.data)
        model = self.model
        self.base, self.axis, self.eye = (model.geom(name).id for name in ("base", "axis", "eye"))
        self.body = model.body("base").id
        root = model.body_rootid[model.geom_bodyid]
        collides = (model.geom_contype | model.geom_conaffinity) != 0
        is_measured = ~np.isin(model.geom_type, [geoms.mjGEOM_HFIELD, geoms.mjGEOM_SDF])
        self.solid = np.flatnonzero(collides & is_measured & (model.geom_bodyid != self.body))
        self.geoms_of: dict[str, list[int]] = {}
        for geom in np.flatnonzero(is_measured & (model.geom_bodyid != self.body)).tolist():
            name = model.body(root[geom]).name if root[geom] else model.geom(geom).name
            self.geoms_of.setdefault(name, []).append(geom)

    def put(self, position, heading: float) -> None:
        self.data.mocap_pos[0] = position
        self.data.mocap_quat[0] = [math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)]
        mujoco.mj_kinematics(self.model, self.data)

    def distance(self, first: int, second: int, max_distance: float, ends=None) -> float:
        return mujoco.mj_geomDistance(self.model, self.data, first, second, max_distance, ends)

    def list_met(self) -> list[str]:
        """The names of the geoms that the base meets."""
        reach = self.model.geom_rbound[self.base]
        offsets = self.data.geom_xpos[self.solid] - self.data.geom_xpos[self.base]
        bounds = self.model.geom_rbound[self.solid]
        is_near = (bounds == 0) | (np.linalg.norm(offsets, axis=1) <= bounds + reach + 0.1)
        return [
            self.model.geom(geom).name or f"geom {geom}"
            for geom in self.solid[is_near].tolist()
            if self.distance(self.base, geom, 0.1) < -TOUCH
        ]

    def measure(self, name: str) -> float:
        """The distance from the base's axis to a thing, seen from above [m]."""
        distances = [self.distance(self.axis, geom, MAX_DISTANCE) for geom in self.geoms_of[name]]
        return min(distances) + AXIS_RADIUS

    def sees(self, name: str) -> bool:
        """Whether a ray from the eye to some point of a thing meets the thing first."""
        eye = self.data.geom_xpos[self.eye].copy()
        own = set(self.geoms_of[name])
        ends = np.zeros(6)
        hit = np.zeros(1, dtype=np.int32)
        for geom in self.geoms_of[name]:
            self.distance(self.eye, geom, 2 * MAX_DISTANCE, ends)
            aims = [ends[3:].copy(), self.data.geom_xpos[geom].copy()]
            self.distance(self.axis, geom, MAX_DISTANCE, ends)
            aims.append(ends[3:].copy())
            # points all over the geom's box
            half = self.model.geom_aabb[geom, 3:]
            corners = np.array(np.meshgrid(*[[-0.9, 0.0, 0.9]] * 3)).reshape(3, -1).T * half
            corners += self.model.geom_aabb[geom, :3]
            rotation = self.data.geom_xmat[geom].reshape(3, 3)
            aims += list(self.data.geom_xpos[geom] + corners @ rotation.T)
            for aim in aims:
                direction = aim - eye
                length = np.linalg.norm(direction)
                if length < 1e-9:
                    continue
                mujoco.mj_ray(
                    self.model, self.data, eye, direction / length, None, 1, self.body, hit
                )
                if hit[0] in own:
                    return True
        return False

    def judge(self, position, heading: float, name: str) -> Judgement:
        self.put(position, heading)
        return Judgement(self.list_met(), self.measure(name), self.sees(name))
