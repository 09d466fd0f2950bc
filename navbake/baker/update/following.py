"""A scene whose geoms moved: what moved, the scene as it is now, and the candidates for doors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.doors.candidates import DoorCandidate, find_candidates
from navbake.baker.kernels.constants import HINGE, MESH, SLIDE
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.hidden_room import HiddenRoom
from navbake.baker.scene.model import OpenScene
from navbake.baker.scene.names import find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene, digest_names, load_scene, start_digest
from navbake.baker.scene.shapes import Shapes, Solids, Triangles
from navbake.config.settings import BakeConfig
from navbake.types import Bool, Float, Int


class FullBake(Exception):
    """Raised when an update needs a full bake; the text says why."""


# What of a model decides which geoms count, as what, and how large they are; users write there
CHOOSING = (
    "geom_type", "geom_size", "geom_dataid", "geom_contype", "geom_conaffinity", "geom_group",
    "geom_rgba", "geom_matid", "mat_rgba",
)  # fmt: skip


class Moved(NamedTuple):
    """What is different in a scene.

    Attributes:
        scene: as it is now.
        geoms: ids of the geoms that count now or did, and whose geometry differs, ascending.
        boxes: the boxes of the geometry that they had and have, shape (n, 6) [m].
        box_geom: the geom of each box, shape (n,).
        every: all geoms that moved, whether they count or not, shape (ngeom,), bool.
        digest: gives the scene's digest, which it does not have yet.
    """

    scene: Scene
    geoms: Int
    boxes: Float
    box_geom: Int
    every: Bool
    digest: Callable[[], str]


class FollowedScene:
    """A scene of one model, in one pose after the other.

    Args:
        opened: the model.
        scene: in its first pose.
    """

    def __init__(self, config: BakeConfig, opened: OpenScene, scene: Scene) -> None:
        self._config, self._opened = config, opened
        self._names = digest_names(opened.model)
        self._first = scene
        self._is_large = np.zeros(opened.model.ngeom, dtype=np.bool_)
        self.keep(scene, np.arange(opened.model.ngeom))

    def keep(self, scene: Scene, moved: Int) -> None:
        """Take a scene for the one that the next pose is compared with; `moved` are geoms' ids."""
        model = scene.model
        room = self._room(scene.data)
        for geom in moved[model.geom_type[moved] == MESH].tolist():
            self._is_large[geom] = room.is_large(geom)
        chosen = [np.array(getattr(model, name)) for name in CHOOSING]
        self.scene, self._chosen, self._poses = scene, chosen, _poses_of(scene.data)

    def _room(self, data: Any) -> HiddenRoom:
        scene, config = self._first, self._config
        return HiddenRoom(scene.model, data, scene.meshes, config.agent, config.floors)

    def pose(self, data: Any) -> Moved:
        """Find what moved in a pose; `keep` makes it the one that the next is compared with.

        Args:
            data: a mujoco.MjData of the model, with all geoms placed.

        Raises:
            SceneError: a geom that counts stands at no finite place.
        """
        was, model = self.scene, self.scene.model
        moved = np.flatnonzero((_poses_of(data) != self._poses).any(axis=1))
        choices_hold = all(
            np.array_equal(known, getattr(model, name))
            for known, name in zip(self._chosen, CHOOSING, strict=True)
        )
        if not choices_hold or self._may_count_otherwise(moved, data):
            return self._load(data)
        digest = start_digest(model, data, was.parts, self._names)
        counted = np.array([geom for geom in moved.tolist() if was.choices[geom].counted], np.int64)
        every, mask = np.zeros((2, model.ngeom), dtype=np.bool_)
        every[moved], mask[counted] = True, True
        shapes, boxes, owner = was.shapes, np.empty((0, 6)), np.empty(0, dtype=np.int64)
        if len(counted):
            chosen = was.choices, was.parts, counted.tolist(), was.meshes
            new = collect_shapes(model, data, *chosen).shapes
            shapes = _with(was.shapes, new, mask)
            boxes, owner = _join_boxes(was.shapes.only(mask), new)
        bounds = shapes.bounds if len(counted) else was.bounds
        scene = replace(was, shapes=shapes, bounds=bounds, digest="", data=data)
        return Moved(scene, counted, boxes, owner, every, digest)

    def _may_count_otherwise(self, moved: Int, data: Any) -> bool:
        """Whether a mesh moved that is so large that its pose decides as what it counts."""
        meshes = moved[self.scene.model.geom_type[moved] == MESH]
        if not len(meshes):
            return False
        room = self._room(data)
        return any(self._is_large[geom] or room.is_large(geom) for geom in meshes.tolist())

    def _load(self, data: Any) -> Moved:
        """Choose the geoms that count again."""
        config, was = self._config, self.scene
        opened = self._opened._replace(data=data)
        scene = load_scene(config.scene, config.agent, config.floors, opened=opened)
        every = np.ones(scene.model.ngeom, dtype=np.bool_)
        boxes = _join_boxes(was.shapes, scene.shapes)
        return Moved(scene, np.flatnonzero(every), *boxes, every, lambda: scene.digest)


def _poses_of(data: Any) -> Float:
    return np.hstack([data.geom_xpos, data.geom_xmat])


def _with(shapes: Shapes, new: Shapes, changed: Bool) -> Shapes:
    """The shapes with new ones in place of those of the geoms that are marked."""
    solids, planes, triangles = shapes.solids, shapes.planes, shapes.triangles
    at = np.searchsorted(solids.geom, new.solids.geom)
    solids = Solids(*(_put(old, at, now) for old, now in zip(solids, new.solids, strict=True)))
    at = np.searchsorted(planes.geom, new.planes.geom)
    pos, mat = _put(planes.pos, at, new.planes.pos), _put(planes.mat, at, new.planes.mat)
    at = np.flatnonzero(changed[triangles.geom])
    pairs = zip(triangles, new.triangles, strict=True)
    triangles = Triangles(*(_put(old, at, now) for old, now in pairs))
    return Shapes(solids, planes._replace(pos=pos, mat=mat), triangles, shapes.endless)


def _put(old: Any, at: Int, new: Any) -> Any:
    if not len(at):
        return old
    copy = old.copy()
    copy[at] = new
    return copy


def _join_boxes(*shapes: Shapes) -> tuple[Float, Int]:
    found = [boxes_of(one) for one in shapes]
    boxes, owner = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return boxes, owner


def boxes_of(shapes: Shapes) -> tuple[Float, Int]:
    """Boxes round the geometry, one a geom, (n, 6) [m], endless for planes; and the geoms."""
    solids, triangles, planes = shapes.solids, shapes.triangles, shapes.planes
    boxes, owner = [solids.bounds], [solids.geom.astype(np.int64)]
    if len(triangles.geom):
        first = np.flatnonzero(np.diff(triangles.geom, prepend=np.int32(-1)))
        low = np.minimum.reduceat(triangles.corners.min(axis=1), first)
        high = np.maximum.reduceat(triangles.corners.max(axis=1), first)
        boxes.append(np.concatenate([low, high], axis=1))
        owner.append(triangles.geom[first].astype(np.int64))
    boxes.append(np.tile(np.repeat([-np.inf, np.inf], 3), (len(planes.geom), 1)))
    owner.append(planes.geom.astype(np.int64))
    return np.concatenate(boxes), np.concatenate(owner)


class FollowedDoors:
    """The candidates for doors in one pose after the other."""

    def __init__(self, config: BakeConfig, scene: Scene, candidates: list[DoorCandidate]) -> None:
        self._config, self._candidates = config, candidates
        model, ends = scene.model, find_subtree_ends(scene.model)
        self._joints = np.isin(model.jnt_type, (HINGE, SLIDE))
        self._geoms = np.zeros(model.ngeom, dtype=np.bool_)
        for body in np.asarray(model.jnt_bodyid)[self._joints].tolist():
            self._geoms[geoms_of_bodies(model, body, int(ends[body]))] = True
        for candidate in candidates:
            self._geoms[candidate.geoms] = True
        self._turns = self._turns_of(scene)

    def _turns_of(self, scene: Scene) -> Float:
        """By joint, how it turns and how far, and its position; users write there."""
        model = scene.model
        position = np.where(self._joints, scene.data.qpos[model.jnt_qposadr], 0.0)
        turns = model.jnt_range, model.jnt_limited[:, None], model.jnt_axis, model.jnt_pos
        return np.hstack([*turns, position[:, None]])

    def pose(self, scene: Scene, moved: Bool) -> dict[str, DoorCandidate]:
        """The candidates that differ now, by their ids; FullBake where they are not the same.

        Args:
            moved: which geoms did, shape (ngeom,), whether they count or not.
        """
        turns, was = self._turns_of(scene), self._candidates
        is_other = (turns != self._turns).any(axis=1)
        if not is_other.any() and not (moved & self._geoms).any():
            return {}
        found, _ = find_candidates(scene, self._config.doors)
        if list(map(_facts_of, was)) != list(map(_facts_of, found)):
            raise FullBake("other bodies look like doors")
        differ = {
            new.id: new
            for new in found
            if moved[new.geoms].any() or (new.joint_id >= 0 and is_other[new.joint_id])
        }
        self._candidates, self._turns = [differ.get(old.id, old) for old in was], turns
        return differ


def _facts_of(candidate: DoorCandidate) -> tuple[Any, ...]:
    """All of a candidate but how its joint is modelled."""
    known = candidate.id, candidate.joint, candidate.joint_id, candidate.named
    return *known, candidate.geoms.tolist()
