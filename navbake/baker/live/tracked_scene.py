"""A scene in one pose after the other: what moved, the scene as it is now, and its leaves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.baker.core.constants import FREE, HINGE, MESH, SLIDE
from navbake.baker.geometry.shapes import Primitives, Shapes
from navbake.baker.rooms.flags import find_markers
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.hull_room import HullRoomTest
from navbake.baker.scene.leaves import DoorCandidate, find_door_candidates, mark_candidate_geoms
from navbake.baker.scene.model import SceneModel, check_data
from navbake.baker.scene.names import body_name, find_subtree_ends, geoms_of_bodies, joint_name
from navbake.baker.scene.pose import data_with_joints, place_geoms
from navbake.baker.scene.roles import LEAF, LEFT_OUT, MOVING_STRUCTURE, assign_roles
from navbake.baker.scene.scene import Scene, digest_names, load_scene, start_digest
from navbake.config.settings import BakeConfig
from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.types import Bool, Float

# What of a model decides which geoms count, as what, and how large they are; users write there
CHOOSING = (
    "geom_type", "geom_size", "geom_dataid", "geom_contype", "geom_conaffinity", "geom_group",
    "geom_rgba", "geom_matid", "mat_rgba",
)  # fmt: skip

# What of it tells how joints turn
TURNING = "jnt_range", "jnt_limited", "jnt_axis", "jnt_pos"
# Of a data, that a pose is
PARTS = "qpos", "mocap_pos", "mocap_quat"


class SceneChange(NamedTuple):
    """What is different in a scene.

    Attributes:
        scene: the scene as it is now.
        geoms: the geoms that count now or did, and whose geometry or way to count differs, by id.
        structure: why what stands, or what marks rooms, is another; empty where it isn't.
        digest: returns the scene's digest, which it does not have yet.
        compared: what the next pose is compared with.
    """

    scene: Scene
    geoms: Bool
    structure: str
    digest: Callable[[], str]
    compared: PoseSnapshot


class PoseSnapshot(NamedTuple):
    """What two poses of a model are compared by.

    Attributes:
        choices: what decides which geoms count.
        poses: of the geoms, (ngeom, 12).
        turning: what says how hinges and slides turn, and how far; users write there.
        positions: of the hinges and slides.
        marking_geoms: the shapes of the geoms that mark rooms by name.
        marking_sites: the poses and sizes of the sites that mark rooms.
    """

    choices: list[bytes]
    poses: Float
    turning: list[bytes]
    positions: Float
    marking_geoms: list[bytes]
    marking_sites: Float


class TrackedScene:
    """A scene of one model, in one pose after the other.

    Of two datas of the model one is in the pose of now, and the other becomes the next.
    """

    def __init__(self, config: BakeConfig, opened: SceneModel, scene: Scene) -> None:
        self._config = config
        self._opened = opened
        self._meshes = scene.meshes
        self._model = model = opened.model
        self.scene = scene
        self._names = digest_names(model)
        self._next = data_with_joints(model, scene.data, {})
        self._bodies = {body_name(model, body): body for body in range(model.nbody - 1, 0, -1)}
        self._joints = {joint_name(model, joint): joint for joint in range(model.njnt - 1, -1, -1)}
        self._hinged_geoms = _mark_moved_by(model, (HINGE, SLIDE))
        self._slide_geoms = _mark_moved_by(model, (SLIDE,))
        self._finds_lifts = any(rule.auto == "lift" for rule in config.links)
        self._turning_positions = model.jnt_qposadr[np.isin(model.jnt_type, (HINGE, SLIDE))]
        self._marking_geoms, self._marking_sites = find_markers(model, config.rooms)
        self.keep(scene, self._read(scene.data))

    def _read(self, data: Any) -> PoseSnapshot:
        model = self._model
        sites = self._marking_sites
        is_structure_body = self.scene.is_structure_body[model.site_bodyid[sites]]
        where = data.site_xpos, data.site_xmat, model.site_size, model.site_type[:, None]
        return PoseSnapshot(
            choices=[getattr(model, name).tobytes() for name in CHOOSING],
            poses=np.hstack([data.geom_xpos, data.geom_xmat]),
            turning=[getattr(model, name).tobytes() for name in TURNING],
            positions=data.qpos[self._turning_positions],
            marking_geoms=[
                getattr(model, name)[self._marking_geoms].tobytes()
                for name in ("geom_type", "geom_dataid", "geom_size")
            ],
            marking_sites=np.hstack([values[sites][is_structure_body] for values in where]),
        )

    def keep(self, scene: Scene, compared: PoseSnapshot) -> None:
        """Take a scene for the one that the next pose is compared with."""
        if scene.data is self._next:
            self._next = self.scene.data
        self.scene = scene
        self._compared = compared
        # whoever reads it on another thread has the last pose, or this one
        self.kept = tuple(getattr(scene.data, part).copy() for part in PARTS)

    def pose(
        self,
        data: Any,
        bodies: Mapping[str, ArrayLike] | None,
        joints: Mapping[str, float] | None,
    ) -> SceneChange:
        """Take the next pose, and find what moved; see `Baker.update`."""
        was = self.scene
        model = self._model
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
        compared = self._read(data)
        moved = (compared.poses != self._compared.poses).any(axis=1)
        if self._may_be_divided_otherwise(data, moved, compared):
            scene = load_scene(self._config, opened=self._opened._replace(data=data))
            geoms = find_differing(was.shapes, scene.shapes)
            geoms |= [a != b for a, b in zip(was.selections, scene.selections, strict=True)]
            scene = replace(scene, leaves=self._keep_leaves(scene.leaves, moved | geoms, compared))
            digest: Callable[[], str] = lambda: scene.digest  # noqa: E731
        else:
            digest = start_digest(model, data, was.exact_meshes, self._names)
            geoms = moved & (was.roles != LEFT_OUT)
            shapes = was.shapes
            if geoms.any():
                after, *_ = collect_shapes(
                    model,
                    data,
                    selections=was.selections,
                    exact_meshes=was.exact_meshes,
                    only=np.flatnonzero(geoms).tolist(),
                    meshes=was.meshes,
                )
                shapes = shapes.with_replaced(after, geoms)
            scene = replace(was, shapes=shapes, digest="", data=data)
            scene = self._follow_leaves(scene, moved, compared)
        structure = self._find_other_structure(scene, geoms, moved, compared)
        return SceneChange(scene, geoms, structure, digest, compared)

    def _find_other_structure(
        self, scene: Scene, geoms: Bool, moved: Bool, compared: PoseSnapshot
    ) -> str:
        """Why what stands, or what marks rooms, is another than before; empty where it isn't."""
        was = self.scene
        differs = geoms & (was.is_structure | scene.is_structure)
        differs |= was.is_structure != scene.is_structure
        if differs.any():
            geom = int(np.argmax(differs))
            name = scene.geoms[geom].name
            does = (
                "carries floor"
                if MOVING_STRUCTURE in (was.roles[geom], scene.roles[geom])
                else "stands"
            )
            return f"{name!r}, which {does}, has changed"
        if ((was.roles == LEAF) != (scene.roles == LEAF)).any():
            return "other bodies than before look like leaves of doors"
        marking = self._marking_geoms
        is_structure_body = scene.is_structure_body[scene.model.geom_bodyid[marking]]
        is_other = moved[marking][is_structure_body].any()
        is_other |= compared.marking_geoms != self._compared.marking_geoms
        is_other |= not np.array_equal(compared.marking_sites, self._compared.marking_sites)
        if is_other:
            return "what marks rooms has changed"
        return ""

    def _turn_otherwise(self, compared: PoseSnapshot) -> bool:
        """Whether hinges and slides turn otherwise than before, as someone wrote to the model."""
        return compared.turning != self._compared.turning

    def _follow_leaves(self, scene: Scene, moved: Bool, compared: PoseSnapshot) -> Scene:
        """The scene with the leaves of now."""
        is_turned = not np.array_equal(compared.positions, self._compared.positions)
        may_be_leaf = self._hinged_geoms | mark_candidate_geoms(len(moved), scene.leaves)
        is_turned |= self._turn_otherwise(compared)
        if not is_turned and not (moved & may_be_leaf).any():
            return scene
        leaves, unused = find_door_candidates(
            scene.model,
            scene.data,
            shapes=scene.shapes,
            counted=scene.roles != LEFT_OUT,
            movable=scene.movable,
            is_structure_body=scene.is_structure_body,
            named=scene.named_leaves,
            settings=self._config.doors,
        )
        leaves = self._keep_leaves(leaves, moved, compared)
        roles = assign_roles(
            scene.model, scene.roles != LEFT_OUT, scene.movable, scene.is_structure_body, leaves
        )
        return replace(scene, leaves=leaves, unused=unused, roles=roles)

    def _keep_leaves(
        self, leaves: list[DoorCandidate], moved: Bool, compared: PoseSnapshot
    ) -> list[DoorCandidate]:
        """The leaves of now, of which those that don't differ are the objects that they were."""
        turn_otherwise = self._turn_otherwise(compared)
        former = {leaf.id: leaf for leaf in self.scene.leaves}

        def is_same(leaf: DoorCandidate) -> bool:
            before = former.get(leaf.id)
            if before is None or turn_otherwise or moved[leaf.geoms].any():
                return False
            return (
                before.joint_id == leaf.joint_id
                and before.positions == leaf.positions
                and before.named == leaf.named
                and np.array_equal(before.geoms, leaf.geoms)
            )

        return [former[leaf.id] if is_same(leaf) else leaf for leaf in leaves]

    def _may_be_divided_otherwise(self, data: Any, moved: Bool, compared: PoseSnapshot) -> bool:
        """Whether other geoms may count, or as what, so that the scene has to be loaded again.

        What was written to the model says so; and the pose of what may be the car of a lift, of a
        leaf that is spared from being left out, and of meshes so large that their hulls may hide
        room.
        """
        if compared.choices != self._compared.choices:
            return True
        may_be_car = (moved & self._slide_geoms).any() or self._turn_otherwise(compared)
        if self._finds_lifts and may_be_car:
            return True
        if self._config.scene.exclude.movable and (moved & self._hinged_geoms).any():
            return True
        meshes = moved & (self._model.geom_type == MESH)
        if not meshes.any():
            return False
        model = self.scene.model
        agent = self._config.agent
        floors = self._config.floors
        before = HullRoomTest(model, self.scene.data, self._meshes, agent, floors)
        now = HullRoomTest(model, data, self._meshes, agent, floors)
        geoms = np.flatnonzero(meshes).tolist()
        return any(before.is_large(geom) or now.is_large(geom) for geom in geoms)

    def _place_body(self, pose: Any, name: str, placed: ArrayLike) -> None:
        model = self._model
        body = self._bodies.get(name)
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
        mocap = int(model.body_mocapid[body])
        first = int(model.body_jntadr[body])
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
        model = self._model
        joint = self._joints.get(name)
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
        model = self._model
        wrong = np.flatnonzero(~np.isfinite(pose.qpos))
        if not len(wrong) and all(np.isfinite(getattr(pose, part)).all() for part in PARTS[1:]):
            return
        joints = np.searchsorted(model.jnt_qposadr, wrong, side="right") - 1
        mocap = np.isfinite(np.hstack([pose.mocap_pos, pose.mocap_quat])).all(axis=1)
        placed = np.isin(model.body_mocapid, np.flatnonzero(~mocap))
        for body in (*model.jnt_bodyid[joints], *np.flatnonzero(placed)):
            what = f"body {body_name(model, int(body))!r}"
            raise QueryError(f"expected numbers as the pose of {what}, got NaN or infinity")


def _mark_moved_by(model: Any, kinds: Sequence[int]) -> Bool:
    """Mark the geoms of bodies with a joint of some kinds, and of all that hangs on them."""
    ends = find_subtree_ends(model)
    marked = np.zeros(model.ngeom, dtype=np.bool_)
    for body in model.jnt_bodyid[np.isin(model.jnt_type, kinds)].tolist():
        marked[geoms_of_bodies(model, body, int(ends[body]))] = True
    return marked


def find_differing(was: Shapes, now: Shapes) -> Bool:
    """Mark the geoms whose geometry differs, shape (ngeom,)."""
    num = len(was.endless)
    differs = np.array(was.endless != now.endless)

    def compare(old: Primitives, new: Primitives) -> None:
        arrays: Iterable[tuple[NDArray[Any], NDArray[Any]]] = zip(old, new, strict=True)
        same: Bool = np.bincount(old.geom, minlength=num) == np.bincount(new.geom, minlength=num)
        differs[~same] = True
        kept = same[old.geom], same[new.geom]
        for one, other in arrays:
            unequal = one[kept[0]] != other[kept[1]]
            rows = unequal.any(axis=tuple(range(1, unequal.ndim)))
            differs[new.geom[kept[1]][rows]] = True

    compare(was.solids, now.solids)
    compare(was.planes, now.planes)
    old = dict(zip(was.meshes.geom.tolist(), was.meshes.triangles, strict=True))
    new = dict(zip(now.meshes.geom.tolist(), now.meshes.triangles, strict=True))
    for geom in old.keys() | new.keys():
        one = old.get(geom, ())
        other = new.get(geom, ())
        differs[geom] |= len(one) != len(other) or not all(map(np.array_equal, one[:4], other[:4]))
    return differs


def _numbers(given: ArrayLike, what: str) -> Float:
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError(f"expected numbers as the pose of {what}, got {given!r}") from error
