"""The pose that a Baker is told of: a data, or bodies and joints that moved."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navbake.baker.kernels.constants import FREE, HINGE, SLIDE
from navbake.baker.scene.model import check_data
from navbake.baker.scene.names import body_name, joint_name
from navbake.baker.scene.pose import data_with_joints, place_geoms
from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.types import Float

PARTS = "qpos", "mocap_pos", "mocap_quat"  # of a data, that a pose is


class Poses:
    """Two datas of a model, of which one is in the pose of now, and the other becomes the next."""

    def __init__(self, model: Any, data: Any, name: str) -> None:
        self._model, self._name = model, name
        self._now, self._next = data, data_with_joints(model, data, {})
        self._kept = _pose_of(data)
        self._bodies = {body_name(model, body): body for body in range(model.nbody - 1, 0, -1)}
        self._joints = {joint_name(model, joint): joint for joint in range(model.njnt - 1, -1, -1)}

    def take(
        self,
        data: Any,
        bodies: Mapping[str, ArrayLike] | None,
        joints: Mapping[str, float] | None,
    ) -> Any:
        """The data of the next pose, with all geoms placed; see `Baker.update`."""
        source = self._now
        if data is not None:
            check_data(self._model, data, self._name)
            source = data
        pose = self._next
        for part in PARTS:
            getattr(pose, part)[:] = getattr(source, part)
        for name, placed in (bodies or {}).items():
            self._place_body(pose, name, placed)
        for name, position in (joints or {}).items():
            self._turn_joint(pose, name, position)
        self._check_finite(pose)
        place_geoms(self._model, pose)
        return pose

    def copy(self) -> tuple[Float, Float, Float]:
        """The joint positions of now, the mocap bodies' positions, and their quaternions."""
        qpos, position, quaternion = (part.copy() for part in self._kept)
        return qpos, position, quaternion

    def keep(self) -> None:
        """Let the next pose be the one of now."""
        # whoever reads the pose on another thread has the last one, or this one
        self._kept = _pose_of(self._next)
        self._now, self._next = self._next, self._now

    def _place_body(self, pose: Any, name: str, placed: ArrayLike) -> None:
        model, body = self._model, self._bodies.get(name)
        if body is None:
            raise QueryError(f"no body {name!r} in the scene: {suggest(name, self._bodies)}")
        numbers = _numbers(placed, f"body {name!r}")
        if numbers.shape not in ((3,), (7,)):
            raise QueryError(
                f"expected x, y, z [m] of body {name!r}, or these and a quaternion w, x, y, z; "
                f"got shape {numbers.shape}"
            )
        if len(numbers) == 7 and not numbers[3:].any():
            raise QueryError(f"expected a quaternion of body {name!r} that is not 0")
        mocap, first = int(model.body_mocapid[body]), int(model.body_jntadr[body])
        if mocap >= 0:
            pose.mocap_pos[mocap] = numbers[:3]
            if len(numbers) == 7:
                pose.mocap_quat[mocap] = numbers[3:]
        elif first >= 0 and int(model.jnt_type[first]) == FREE:
            address = int(model.jnt_qposadr[first])
            pose.qpos[address : address + len(numbers)] = numbers
        else:
            raise QueryError(
                f"body {name!r} can't be placed: it has no free joint and is no mocap body; turn "
                "its joints, or write to model.body_pos and call update()"
            )

    def _turn_joint(self, pose: Any, name: str, position: ArrayLike) -> None:
        model, joint = self._model, self._joints.get(name)
        if joint is None:
            raise QueryError(f"no joint {name!r} in the scene: {suggest(name, self._joints)}")
        numbers = _numbers(position, f"joint {name!r}")
        if int(model.jnt_type[joint]) not in (HINGE, SLIDE) or numbers.size != 1:
            raise QueryError(
                f"expected one number [m or rad] for joint {name!r}, a hinge or a slide; place "
                f"the bodies of other joints"
            )
        pose.qpos[model.jnt_qposadr[joint]] = numbers.item()

    def _check_finite(self, pose: Any) -> None:
        if all(np.isfinite(part).all() for part in _pose_of(pose)):
            return
        bad = np.flatnonzero(~np.isfinite(pose.qpos))
        what = "a mocap body"
        if len(bad):
            joint = int(np.searchsorted(self._model.jnt_qposadr, bad[0], side="right")) - 1
            body = int(self._model.jnt_bodyid[joint])
            what = f"body {body_name(self._model, body)!r}"
        raise QueryError(f"expected numbers as the pose of {what}, got NaN or infinity")


def _pose_of(data: Any) -> tuple[Float, ...]:
    return tuple(getattr(data, part).copy() for part in PARTS)


def _numbers(given: ArrayLike, what: str) -> Float:
    try:
        numbers = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError(f"expected numbers as the pose of {what}, got {given!r}") from error
    if not np.isfinite(numbers).all():
        raise QueryError(f"expected numbers as the pose of {what}, got NaN or infinity")
    return numbers
