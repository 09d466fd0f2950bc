"""A scene in one pose after the other: what moved, the scene as it is now, and its doors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.baker.doors.candidates import DoorCandidate, find_candidates, mark_geoms
from navbake.baker.kernels.constants import FREE, HINGE, MESH, SLIDE
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.model import OpenScene, check_data
from navbake.baker.scene.names import body_name, find_subtree_ends, geoms_of_bodies, joint_name
from navbake.baker.scene.pose import data_with_joints, place_geoms
from navbake.baker.scene.scene import HiddenRoom, Scene, digest_names, load_scene, start_digest
from navbake.baker.scene.shapes import Items, Shapes
from navbake.config.settings import BakeConfig
from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.types import Bool, Float


class FullBake(Exception):
    """Raised when an update needs a full bake; the text says why."""


# What of a model decides which geoms count, as what, and how large they are; users write there
CHOOSING = (
    "geom_type", "geom_size", "geom_dataid", "geom_contype", "geom_conaffinity", "geom_group",
    "geom_rgba", "geom_matid", "mat_rgba",
)  # fmt: skip


class Moved(NamedTuple):
    """What is different in a scene; geoms are marked, shape (ngeom,)."""

    scene: Scene  # as it is now
    geoms: Bool  # those that count now or did, and whose geometry or way to count differs
    every: Bool  # all that may have moved, whether they count or not
    digest: Callable[[], str]  # returns the scene's digest, which it does not have yet


# Of a data, that a pose is
PARTS = "qpos", "mocap_pos", "mocap_quat"


class FollowedScene:
    """A scene of one model, in one pose after the other.

    Of two datas of the model one is in the pose of now, and the other becomes the next.
    """

    def __init__(self, config: BakeConfig, opened: OpenScene, scene: Scene) -> None:
        self._config, self._opened, self._meshes = config, opened, scene.meshes
        self._model = model = opened.model
        self.scene, self._names = scene, digest_names(model)
        self._next = data_with_joints(model, scene.data, {})
        self._bodies = {body_name(model, body): body for body in range(model.nbody - 1, 0, -1)}
        self._joints = {joint_name(model, joint): joint for joint in range(model.njnt - 1, -1, -1)}
        self.keep(scene)

    def keep(self, scene: Scene) -> None:
        """Take a scene for the one that the next pose is compared with."""
        self._chosen = self._choices()
        if scene.data is self._next:
            self._next = self.scene.data
        self.scene, self._poses = scene, _poses_of(scene.data)
        # whoever reads it on another thread has the last pose, or this one
        self.kept = tuple(getattr(scene.data, part).copy() for part in PARTS)

    def _choices(self) -> list[bytes]:
        return [getattr(self._model, name).tobytes() for name in CHOOSING]

    def pose(
        self,
        data: Any,
        bodies: Mapping[str, ArrayLike] | None,
        joints: Mapping[str, float] | None,
    ) -> Moved:
        """Take the next pose, and find what moved; see `Baker.update`."""
        was, model = self.scene, self._model
        source = was.data if data is None else data
        check_data(model, source, str(self._config.scene.path))
        data = self._next
        for part in PARTS:
            getattr(data, part)[:] = getattr(source, part)
        for name, placed in (bodies or {}).items():
            self._place_body(data, name, placed)
        for name, position in (joints or {}).items():
            self._turn_joint(data, name, position)
        self._check_finite(data)
        place_geoms(model, data)
        moved = (_poses_of(data) != self._poses).any(axis=1)
        if self._chosen != self._choices() or self._may_count_otherwise(
            moved & (model.geom_type == MESH), data
        ):
            opened, config = self._opened._replace(data=data), self._config
            scene = load_scene(config.scene, config.agent, config.floors, opened=opened)
            differs = find_differing(was.shapes, scene.shapes)
            differs |= [a != b for a, b in zip(was.choices, scene.choices, strict=True)]
            return Moved(scene, differs, np.ones_like(differs), lambda: scene.digest)
        digest = start_digest(model, data, was.parts, self._names)
        mask = moved & [choice.counted for choice in was.choices]
        shapes, bounds = was.shapes, was.bounds
        if mask.any():
            chosen = was.choices, was.parts, np.flatnonzero(mask).tolist(), was.meshes
            after, *_ = collect_shapes(model, data, *chosen)
            shapes = was.shapes.replaced(after, mask)
            bounds = shapes.bounds
        scene = replace(was, shapes=shapes, bounds=bounds, digest="", data=data)
        return Moved(scene, mask, moved, digest)

    def _may_count_otherwise(self, meshes: Bool, data: Any) -> bool:
        """Whether one of some meshes is or was so large that its pose decides as what it counts."""
        config, scene = self._config, self.scene
        if not meshes.any():
            return False
        geoms, known = np.flatnonzero(meshes).tolist(), (self._meshes, config.agent, config.floors)
        rooms = [HiddenRoom(scene.model, posed, *known) for posed in (scene.data, data)]
        return any(room.is_large(geom) for room in rooms for geom in geoms)

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
        model, wrong = self._model, np.flatnonzero(~np.isfinite(pose.qpos))
        if not len(wrong) and all(np.isfinite(getattr(pose, part)).all() for part in PARTS[1:]):
            return
        joints = np.searchsorted(model.jnt_qposadr, wrong, side="right") - 1
        mocap = np.isfinite(np.hstack([pose.mocap_pos, pose.mocap_quat])).all(axis=1)
        placed = np.isin(model.body_mocapid, np.flatnonzero(~mocap))
        for body in (*model.jnt_bodyid[joints], *np.flatnonzero(placed)):
            what = f"body {body_name(model, int(body))!r}"
            raise QueryError(f"expected numbers as the pose of {what}, got NaN or infinity")


def _poses_of(data: Any) -> Float:
    return np.hstack([data.geom_xpos, data.geom_xmat])


def boxes_of(shapes: Shapes) -> Float:
    """Boxes round the geometry, one a geom, (n, 6) [m], endless for planes."""
    boxes = [shapes.solids.bounds, shapes.meshes.boxes]
    boxes.append(np.tile(np.repeat([-np.inf, np.inf], 3), (len(shapes.planes.geom), 1)))
    return np.concatenate(boxes)


def find_differing(was: Shapes, now: Shapes) -> Bool:
    """Mark the geoms whose geometry differs, shape (ngeom,)."""
    num, differs = len(was.endless), np.array(was.endless != now.endless)

    def compare(old: Items, new: Items) -> None:
        arrays: Iterable[tuple[NDArray[Any], NDArray[Any]]] = zip(old, new, strict=True)
        same: Bool = np.equal(*(np.bincount(items.geom, minlength=num) for items in (old, new)))
        differs[~same] = True
        kept = same[old.geom], same[new.geom]
        for one, other in arrays:
            unequal = one[kept[0]] != other[kept[1]]
            rows = unequal.any(axis=tuple(range(1, unequal.ndim)))
            differs[new.geom[kept[1]][rows]] = True

    compare(was.solids, now.solids)
    compare(was.planes, now.planes)
    old, new = (
        dict(zip(shapes.meshes.geom.tolist(), shapes.meshes.triangles, strict=True))
        for shapes in (was, now)
    )
    for geom in old.keys() | new.keys():
        one, other = old.get(geom, ()), new.get(geom, ())
        differs[geom] |= len(one) != len(other) or not all(map(np.array_equal, one[:4], other[:4]))
    return differs


class FollowedDoors:
    """The candidates for doors in one pose after the other."""

    def __init__(
        self,
        config: BakeConfig,
        scene: Scene,
        candidates: list[DoorCandidate],
        unmatched: list[str],
    ) -> None:
        self._config, self._candidates, self._unmatched = config, candidates, unmatched
        model, ends = scene.model, find_subtree_ends(scene.model)
        self._joints = np.isin(model.jnt_type, (HINGE, SLIDE))
        self._geoms = np.zeros(model.ngeom, dtype=np.bool_)
        for body in np.asarray(model.jnt_bodyid)[self._joints].tolist():
            self._geoms[geoms_of_bodies(model, body, int(ends[body]))] = True
        self._turns = self._turns_of(scene)

    def _turns_of(self, scene: Scene) -> Float:
        """By joint, how it turns and how far, and its position; users write there."""
        model = scene.model
        position = np.where(self._joints, scene.data.qpos[model.jnt_qposadr], 0.0)
        turns = model.jnt_range, model.jnt_limited[:, None], model.jnt_axis, model.jnt_pos
        return np.hstack([*turns, position[:, None]])

    def pose(self, scene: Scene, moved: Bool) -> tuple[list[DoorCandidate], list[str]]:
        """The candidates, those that don't differ as they were; and of unused patterns."""
        turns = self._turns_of(scene)
        is_other = (turns != self._turns).any(axis=1)
        may_differ = self._geoms | mark_geoms(len(moved), self._candidates)
        if is_other.any() or (moved & may_differ).any():
            known = {one.id: one for one in self._candidates}
            found, self._unmatched = find_candidates(scene, self._config.doors)

            def holds(new: DoorCandidate) -> bool:
                old = known.get(new.id)
                turns_alike = new.joint_id < 0 or not is_other[new.joint_id]
                if old is None or moved[new.geoms].any() or not turns_alike:
                    return False
                same = old.joint_id == new.joint_id and old.named == new.named
                return same and np.array_equal(old.geoms, new.geoms)

            self._candidates = [known[new.id] if holds(new) else new for new in found]
            self._turns = turns
        return self._candidates, self._unmatched


def _numbers(given: ArrayLike, what: str) -> Float:
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError(f"expected numbers as the pose of {what}, got {given!r}") from error
