"""Tracks the poses of a scene: finds which geoms and leaves change from one pose to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.baker.bake.uncounted import mark_drawn_uncounted
from navbake.baker.core.constants import FREE, HINGE, MESH, SLIDE
from navbake.baker.geometry.shapes import GeomTriangles, Primitives, Shapes
from navbake.baker.rooms.flags import find_markers
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.hull_room import are_any_large
from navbake.baker.scene.leaves import DoorCandidate, find_door_candidates, mark_candidate_geoms
from navbake.baker.scene.model import SceneModel, check_data
from navbake.baker.scene.names import (
    body_name,
    find_joint_of_body,
    find_subtree_ends,
    geoms_of_bodies,
    joint_name,
    list_joint_names,
)
from navbake.baker.scene.pose import data_with_joints, place_geoms
from navbake.baker.scene.roles import LEAF, LEFT_OUT, MOVING_STRUCTURE, assign_roles
from navbake.baker.scene.scene import (
    GEOM_ATTRIBUTES,
    Scene,
    digest_model,
    load_scene,
    start_hashing,
)
from navbake.config.settings import BakeConfig
from navbake.errors import QueryError
from navbake.known_names import MAX_LISTED, list_first, suggest
from navbake.mujoco_types import MjDataLike
from navbake.types import Bool, Float

if TYPE_CHECKING:
    import mujoco

# The attributes of a model that decide how joints move bodies
JOINT_ATTRIBUTES = ("jnt_range", "jnt_limited", "jnt_axis", "jnt_pos")

# The attributes of the geoms that mark rooms, except their poses
MARKER_ATTRIBUTES = ("geom_type", "geom_dataid", "geom_size")


class PoseArrays(NamedTuple):
    """Copies of the arrays of a mujoco.MjData that make up its pose.

    Attributes:
        qpos: joint positions, (nq,).
        mocap_pos: positions of mocap bodies, (nmocap, 3) [m].
        mocap_quat: orientations of mocap bodies, (nmocap, 4): w, x, y, z.
    """

    qpos: Float
    mocap_pos: Float
    mocap_quat: Float


class PoseSnapshot(NamedTuple):
    """Values of one pose, to be compared with those of the next pose to find what changed.

    The poses of geoms, and joint positions, are compared in the data of the two poses.

    Attributes:
        geom_attributes: the model's arrays that decide which geoms the bake uses, as bytes.
        joint_attributes: the model's arrays that decide how joints move bodies, as bytes.
        marker_geoms: the shapes of the geoms whose names mark rooms, as bytes.
        marker_sites: the poses, sizes and types of the sites that mark rooms, as bytes.
    """

    geom_attributes: list[bytes]
    joint_attributes: list[bytes]
    marker_geoms: list[bytes]
    marker_sites: list[bytes]


class SceneChange(NamedTuple):
    """The difference between a scene's current pose and its next one.

    Attributes:
        scene: the scene in the next pose.
        is_changed_geom: for each geom, whether the bake uses it in one of the two poses, and its
            geometry or role differs between them.
        full_bake_reason: why the whole scene has to be baked (structure, or a marker of a room, has
            changed); empty if an update is enough.
        is_uncounted_changed: whether a drawn geom that doesn't count, as it can't collide, has
            moved, or may have appeared or vanished.
        wait_for_digest: a function that waits until the digest of the scene is computed, and
            returns it. `scene` does not have the digest yet.
        snapshot: the values of the next pose, for comparison with the pose after it.
    """

    scene: Scene
    is_changed_geom: Bool
    full_bake_reason: str
    is_uncounted_changed: bool
    wait_for_digest: Callable[[], str]
    snapshot: PoseSnapshot


class TrackedScene:
    """Keeps a model's scene in its current pose, and finds the differences of the next pose.

    Two mujoco.MjData of the model are kept: one in the current pose, one for the next pose.

    Args:
        config: all settings.
        scene_model: the compiled model.
        scene: the scene in its first pose.

    Attributes:
        scene: the scene in the current pose.
        pose_arrays: a copy of the current pose; any thread may read it at any time.
    """

    def __init__(self, config: BakeConfig, scene_model: SceneModel, scene: Scene) -> None:
        model = scene_model.model
        self._config = config
        self._scene_model = scene_model
        self._model = model
        self._digested_model = digest_model(model)
        self._next_data = data_with_joints(model, scene.data, {})
        # Of equal names the first counts, so that it is entered last.
        self._body_ids = {body_name(model, body): body for body in range(model.nbody - 1, 0, -1)}
        self._joint_ids = {
            joint_name(model, joint): joint for joint in range(model.njnt - 1, -1, -1)
        }
        self._is_jointed_geom = _mark_geoms_moved_by(model, (HINGE, SLIDE))
        self._is_sliding_geom = _mark_geoms_moved_by(model, (SLIDE,))
        self._finds_lifts = any(rule.auto == "lift" for rule in config.links)
        self._qpos_addresses = model.jnt_qposadr[np.isin(model.jnt_type, (HINGE, SLIDE))]
        marker_geom_ids, marker_site_ids = find_markers(model, config.rooms)
        self._marker_geoms = np.array(marker_geom_ids, dtype=np.int64)
        self._marker_sites = np.array(marker_site_ids, dtype=np.int64)
        self.scene = scene
        self.pose_arrays = _copy_pose(scene.data)
        self._is_uncounted_geom = mark_drawn_uncounted(scene)
        self._snapshot = self._take_snapshot(scene.data)

    def _take_snapshot(self, data: mujoco.MjData) -> PoseSnapshot:
        model = self._model
        site_ids = self._marker_sites
        site_ids = site_ids[self.scene.is_structure_body[model.site_bodyid[site_ids]]]
        return PoseSnapshot(
            geom_attributes=[getattr(model, attribute).tobytes() for attribute in GEOM_ATTRIBUTES],
            joint_attributes=[
                getattr(model, attribute).tobytes() for attribute in JOINT_ATTRIBUTES
            ],
            marker_geoms=[
                getattr(model, attribute)[self._marker_geoms].tobytes()
                for attribute in MARKER_ATTRIBUTES
            ],
            marker_sites=[
                data.site_xpos[site_ids].tobytes(),
                data.site_xmat[site_ids].tobytes(),
                model.site_size[site_ids].tobytes(),
                model.site_type[site_ids].tobytes(),
            ],
        )

    def commit(self, scene: Scene, snapshot: PoseSnapshot) -> None:
        """Make a scene the current one; `find_change` compares the next pose with it.

        Args:
            scene: the scene of the last `SceneChange`; after a full bake, the scene that was baked.
            snapshot: the snapshot of that `SceneChange`.
        """
        if scene.data is self._next_data:
            self._next_data = self.scene.data
        if scene.selections is not self.scene.selections:
            self._is_uncounted_geom = mark_drawn_uncounted(scene)
        self.scene = scene
        if snapshot.geom_attributes != self._snapshot.geom_attributes:
            self._digested_model = digest_model(self._model)
        self._snapshot = snapshot
        # One assignment, so that another thread reads the last pose or this one.
        self.pose_arrays = _copy_pose(scene.data)

    def find_change(
        self,
        data: MjDataLike | None,
        bodies: Mapping[str, ArrayLike] | None,
        joints: Mapping[str, float] | None,
    ) -> SceneChange:
        """Find the difference between the current pose and the next one.

        The current scene is replaced only by `commit`.

        Args:
            data: the data whose joint positions and mocap bodies are the next pose; the current
                pose if None.
            bodies: bodies with a free joint, and mocap bodies, by name: x, y, z [m], or x, y, z and
                a quaternion w, x, y, z.
            joints: positions of hinges and slides, by name [rad or m].

        Returns:
            The scene in the next pose, and what differs from the current one.

        Raises:
            QueryError: there is no such body or joint, or a pose is not finite.
            ConfigError: the data belongs to a different model.
            SceneError: the scene holds nothing to bake any more.
        """
        old_scene = self.scene
        model = self._model
        source_data: MjDataLike = old_scene.data
        if data is not None:
            check_data(model, data, str(self._config.scene.path))
            source_data = data
        next_data = self._next_data
        next_data.qpos[:] = source_data.qpos
        next_data.mocap_pos[:] = source_data.mocap_pos
        next_data.mocap_quat[:] = source_data.mocap_quat
        for name, pose in (bodies or {}).items():
            self._place_body(next_data, name, pose)
        for name, joint_position in (joints or {}).items():
            self._move_joint(next_data, name, joint_position)
        self._check_finite(next_data)
        place_geoms(model, next_data)
        snapshot = self._take_snapshot(next_data)
        is_moved_geom = _mark_moved_geoms(old_scene.data, next_data)
        if self._needs_new_roles(next_data, is_moved_geom, snapshot):
            scene = load_scene(self._config, scene_model=self._scene_model._replace(data=next_data))
            is_changed_geom = find_changed_geoms(old_scene.shapes, scene.shapes)
            selections = zip(old_scene.selections, scene.selections, strict=True)
            is_changed_geom |= [
                old_selection != new_selection for old_selection, new_selection in selections
            ]
            leaves = self._reuse_leaves(scene.leaves, is_moved_geom | is_changed_geom, snapshot)
            scene = replace(scene, leaves=leaves)
            digest = scene.digest
            wait_for_digest: Callable[[], str] = lambda: digest  # noqa: E731
        else:
            wait_for_digest = start_hashing(
                model, next_data, old_scene.exact_meshes, self._digested_model
            )
            is_changed_geom = is_moved_geom & (old_scene.roles != LEFT_OUT)
            shapes = self._move_shapes(next_data, is_changed_geom)
            scene = replace(old_scene, shapes=shapes, digest="", data=next_data)
            scene = self._update_leaves(scene, is_moved_geom, snapshot)
        return SceneChange(
            scene=scene,
            is_changed_geom=is_changed_geom,
            full_bake_reason=self._find_full_bake_reason(
                scene, is_changed_geom, is_moved_geom, snapshot
            ),
            is_uncounted_changed=self._is_uncounted_changed(scene, is_moved_geom, snapshot),
            wait_for_digest=wait_for_digest,
            snapshot=snapshot,
        )

    def _move_shapes(self, data: mujoco.MjData, is_changed_geom: Bool) -> Shapes:
        """Return the current scene's shapes, with the changed geoms in the next pose.

        Args:
            data: the next pose.
            is_changed_geom: the geoms that are placed anew, (ngeom,).
        """
        scene = self.scene
        if not is_changed_geom.any():
            return scene.shapes
        moved_shapes, *_ = collect_shapes(
            scene.model,
            data,
            selections=scene.selections,
            exact_meshes=scene.exact_meshes,
            geom_ids=np.flatnonzero(is_changed_geom).tolist(),
            meshes=scene.meshes,
        )
        return scene.shapes.with_replaced(moved_shapes, is_changed_geom)

    def _find_full_bake_reason(
        self, scene: Scene, is_changed_geom: Bool, is_moved_geom: Bool, snapshot: PoseSnapshot
    ) -> str:
        """Return why the whole scene has to be baked again; empty if an update is enough.

        That is so if structure, the choice of leaves, or a marker of rooms has changed.

        Args:
            scene: the scene in the next pose.
            is_changed_geom: see `SceneChange`, (ngeom,).
            is_moved_geom: the geoms whose poses differ between the two poses, (ngeom,).
            snapshot: the values of the next pose.
        """
        old_scene = self.scene
        is_changed_structure = is_changed_geom & (old_scene.is_structure | scene.is_structure)
        is_changed_structure |= old_scene.is_structure != scene.is_structure
        if is_changed_structure.any():
            geom = int(np.argmax(is_changed_structure))
            name = scene.geoms[geom].name
            roles = (old_scene.roles[geom], scene.roles[geom])
            role_text = "carries floor" if MOVING_STRUCTURE in roles else "stands"
            return f"{name!r}, which {role_text}, has changed"
        if ((old_scene.roles == LEAF) != (scene.roles == LEAF)).any():
            return "other bodies than before look like leaves of doors"
        marker_geom_ids = self._marker_geoms
        is_structure = scene.is_structure_body[scene.model.geom_bodyid[marker_geom_ids]]
        is_marker_changed = (
            is_moved_geom[marker_geom_ids][is_structure].any()
            or snapshot.marker_geoms != self._snapshot.marker_geoms
            or snapshot.marker_sites != self._snapshot.marker_sites
        )
        return "what marks rooms has changed" if is_marker_changed else ""

    def _is_uncounted_changed(
        self, scene: Scene, is_moved_geom: Bool, snapshot: PoseSnapshot
    ) -> bool:
        """Return whether the drawn geoms that don't count may stand elsewhere, or be others.

        Args:
            scene: the scene in the next pose.
            is_moved_geom: the geoms whose poses differ between the two poses, (ngeom,).
            snapshot: the values of the next pose.
        """
        if snapshot.geom_attributes != self._snapshot.geom_attributes:
            return True
        is_loaded_again = scene.selections is not self.scene.selections
        if is_loaded_again and (mark_drawn_uncounted(scene) != self._is_uncounted_geom).any():
            return True
        return bool((is_moved_geom & self._is_uncounted_geom).any())

    def _are_joints_changed(self, snapshot: PoseSnapshot) -> bool:
        """Return whether a user has changed the model so that joints move bodies differently."""
        return snapshot.joint_attributes != self._snapshot.joint_attributes

    def _update_leaves(self, scene: Scene, is_moved_geom: Bool, snapshot: PoseSnapshot) -> Scene:
        """Return the scene with the door candidates and the roles of the next pose.

        Candidates are only searched for if one may have changed.

        Args:
            scene: the scene in the next pose, with the candidates of the current one.
            is_moved_geom: the geoms whose poses differ between the two poses, (ngeom,).
            snapshot: the values of the next pose.
        """
        may_be_leaf_geom = self._is_jointed_geom | mark_candidate_geoms(
            len(is_moved_geom), scene.leaves
        )
        may_change = (
            (scene.data.qpos != self.scene.data.qpos)[self._qpos_addresses].any()
            or self._are_joints_changed(snapshot)
            or (is_moved_geom & may_be_leaf_geom).any()
        )
        if not may_change:
            return scene
        is_counted = scene.roles != LEFT_OUT
        leaves, pattern_warnings = find_door_candidates(
            scene.model,
            scene.data,
            shapes=scene.shapes,
            is_counted=is_counted,
            is_movable_body=scene.is_movable_body,
            is_structure_body=scene.is_structure_body,
            named_leaves=scene.named_leaves,
            settings=self._config.doors,
        )
        leaves = self._reuse_leaves(leaves, is_moved_geom, snapshot)
        roles = assign_roles(
            scene.model, is_counted, scene.is_movable_body, scene.is_structure_body, leaves
        )
        return replace(scene, leaves=leaves, pattern_warnings=pattern_warnings, roles=roles)

    def _reuse_leaves(
        self, leaves: list[DoorCandidate], is_changed_geom: Bool, snapshot: PoseSnapshot
    ) -> list[DoorCandidate]:
        """Replace unchanged door candidates by the equal objects of the current scene.

        Later steps recognize unchanged candidates by this: they are the same objects as before.
        """
        are_joints_changed = self._are_joints_changed(snapshot)
        old_leaves = {leaf.id: leaf for leaf in self.scene.leaves}

        def is_unchanged(leaf: DoorCandidate) -> bool:
            old_leaf = old_leaves.get(leaf.id)
            if old_leaf is None or are_joints_changed or is_changed_geom[leaf.geoms].any():
                return False
            return (
                old_leaf.joint_id == leaf.joint_id
                and old_leaf.positions == leaf.positions
                and old_leaf.is_named == leaf.is_named
                and np.array_equal(old_leaf.geoms, leaf.geoms)
            )

        return [old_leaves[leaf.id] if is_unchanged(leaf) else leaf for leaf in leaves]

    def _needs_new_roles(
        self, data: mujoco.MjData, is_moved_geom: Bool, snapshot: PoseSnapshot
    ) -> bool:
        """Return whether different geoms may count, so that the scene has to be loaded again.

        This is so if a user has changed the model's attributes that decide about it, or if one of
        these moved:

        - what may be a lift's car;
        - what may be a leaf, which `scene.exclude.movable` would keep;
        - a mesh so large that its hull may hide room.
        """
        if snapshot.geom_attributes != self._snapshot.geom_attributes:
            return True
        if self._finds_lifts and (
            (is_moved_geom & self._is_sliding_geom).any() or self._are_joints_changed(snapshot)
        ):
            return True
        if self._config.scene.exclude.movable and (is_moved_geom & self._is_jointed_geom).any():
            return True
        moved_meshes = np.flatnonzero(is_moved_geom & (self._model.geom_type == MESH))
        if not len(moved_meshes):
            return False
        agent = self._config.agent
        floors = self._config.floors
        return any(
            are_any_large(self._model, pose, moved_meshes, agent, floors)
            for pose in (self.scene.data, data)
        )

    def _place_body(self, data: mujoco.MjData, name: str, pose: ArrayLike) -> None:
        model = self._model
        body = self._body_ids.get(name)
        if body is None:
            raise QueryError(f"no body {name!r} in the scene: {suggest(name, self._body_ids)}")
        pose_numbers = _to_numbers(pose, f"body {name!r}")
        if pose_numbers.shape not in ((3,), (7,)):
            raise QueryError(
                f"expected x, y, z [m] of body {name!r}, or these and a quaternion w, x, y, z; "
                f"got shape {pose_numbers.shape}"
            )
        if len(pose_numbers) == 7 and not pose_numbers[3:].any():
            raise QueryError(f"expected a quaternion of body {name!r} that is not 0")
        mocap_id = int(model.body_mocapid[body])
        first_joint = int(model.body_jntadr[body])
        if mocap_id >= 0:
            data.mocap_pos[mocap_id] = pose_numbers[:3]
            if len(pose_numbers) == 7:
                data.mocap_quat[mocap_id] = pose_numbers[3:]
        elif first_joint >= 0 and int(model.jnt_type[first_joint]) == FREE:
            qpos_address = int(model.jnt_qposadr[first_joint])
            data.qpos[qpos_address : qpos_address + len(pose_numbers)] = pose_numbers
        else:
            raise QueryError(
                f"body {name!r} can't be placed: it has no free joint and is no mocap body; turn "
                "its joints, or write to model.body_pos and call update()"
            )

    def _move_joint(self, data: mujoco.MjData, name: str, position: ArrayLike) -> None:
        model = self._model
        joint = self._joint_ids.get(name)
        if joint is None:
            hint = self._suggest_joint(name)
            raise QueryError(
                f"no joint {name!r} in the scene: {hint}", key="joints", value=name, hint=hint
            )
        position_array = _to_numbers(position, f"joint {name!r}")
        if int(model.jnt_type[joint]) not in (HINGE, SLIDE) or position_array.size != 1:
            raise QueryError(
                f"expected one number [m or rad] for joint {name!r}, a hinge or a slide; place "
                f"the bodies of other joints"
            )
        data.qpos[model.jnt_qposadr[joint]] = position_array.item()

    def _suggest_joint(self, name: str) -> str:
        """Write a hint for the name of a joint that isn't there.

        It begins with the joint of the body of that name, which may be a door.
        """
        joint_names = list_joint_names(self._model)
        joint = find_joint_of_body(self._model, name)
        if joint is None:
            return suggest(name, joint_names)
        if int(self._model.jnt_type[joint]) == FREE:
            return f"{name!r} is a body with a free joint, write bodies={{{name!r}: [x, y, z]}}"
        own_name = joint_name(self._model, joint)
        joint_names.remove(own_name)
        names_text = list_first([own_name, *joint_names], MAX_LISTED)
        return f"{name!r} is moved by its joint {own_name!r}; it has {names_text}"

    def _check_finite(self, data: mujoco.MjData) -> None:
        """Raise a QueryError if the pose of a body is not finite; the error names the body."""
        model = self._model
        wrong_qpos_indices = np.flatnonzero(~np.isfinite(data.qpos))
        is_mocap_finite = np.isfinite(data.mocap_pos).all(axis=1)
        is_mocap_finite &= np.isfinite(data.mocap_quat).all(axis=1)
        if not len(wrong_qpos_indices) and is_mocap_finite.all():
            return
        wrong_joints = np.searchsorted(model.jnt_qposadr, wrong_qpos_indices, side="right") - 1
        wrong_mocaps = np.flatnonzero(~is_mocap_finite)
        mocap_bodies = np.flatnonzero(np.isin(model.body_mocapid, wrong_mocaps))
        for body in (*model.jnt_bodyid[wrong_joints], *mocap_bodies):
            body_text = f"body {body_name(model, int(body))!r}"
            raise QueryError(f"expected numbers as the pose of {body_text}, got NaN or infinity")


def _copy_pose(data: mujoco.MjData) -> PoseArrays:
    return PoseArrays(data.qpos.copy(), data.mocap_pos.copy(), data.mocap_quat.copy())


def _mark_moved_geoms(old_data: mujoco.MjData, new_data: mujoco.MjData) -> Bool:
    """Mark the geoms whose poses differ between two data of a model; shape (ngeom,)."""
    is_moved_geom = np.zeros(len(new_data.geom_xpos), dtype=np.bool_)
    for old_values, new_values in (
        (old_data.geom_xpos, new_data.geom_xpos),
        (old_data.geom_xmat, new_data.geom_xmat),
    ):
        # faster than `any` along rows, as few geoms move
        changed_values = np.flatnonzero(new_values != old_values)
        is_moved_geom[changed_values // new_values.shape[1]] = True
    return is_moved_geom


def _mark_geoms_moved_by(model: mujoco.MjModel, joint_types: Sequence[int]) -> Bool:
    """Mark the geoms of bodies with a joint of some types, and of these bodies' descendants."""
    subtree_ends = find_subtree_ends(model)
    is_moved_geom = np.zeros(model.ngeom, dtype=np.bool_)
    for body in model.jnt_bodyid[np.isin(model.jnt_type, joint_types)].tolist():
        is_moved_geom[geoms_of_bodies(model, body, int(subtree_ends[body]))] = True
    return is_moved_geom


def find_changed_geoms(old_shapes: Shapes, new_shapes: Shapes) -> Bool:
    """Mark the geoms whose geometry differs between two lists of shapes.

    Args:
        old_shapes: shapes of a scene.
        new_shapes: shapes of the same model, in a different pose or of a different choice of geoms.

    Returns:
        A mask by geom id, shape (ngeom,), bool.
    """
    is_changed_geom = np.array(old_shapes.is_endless != new_shapes.is_endless)
    _mark_changed_primitives(old_shapes.solids, new_shapes.solids, is_changed_geom)
    _mark_changed_primitives(old_shapes.planes, new_shapes.planes, is_changed_geom)
    old_pieces_of_geom = _group_triangles_by_geom(old_shapes)
    new_pieces_of_geom = _group_triangles_by_geom(new_shapes)
    for geom in old_pieces_of_geom.keys() | new_pieces_of_geom.keys():
        old_pieces = old_pieces_of_geom.get(geom, [])
        new_pieces = new_pieces_of_geom.get(geom, [])
        is_changed_geom[geom] |= len(old_pieces) != len(new_pieces)
        for old_piece, new_piece in zip(old_pieces, new_pieces, strict=False):
            is_changed_geom[geom] |= not (
                np.array_equal(old_piece.vertices, new_piece.vertices)
                and np.array_equal(old_piece.faces, new_piece.faces)
                and np.array_equal(old_piece.part, new_piece.part)
                and np.array_equal(old_piece.closed, new_piece.closed)
            )
    return is_changed_geom


def _group_triangles_by_geom(shapes: Shapes) -> dict[int, list[GeomTriangles]]:
    """Return the triangles of each geom: one entry, or the pieces of a height field."""
    triangles_of_geom = dict[int, list[GeomTriangles]]()
    for geom, piece in zip(shapes.meshes.geom.tolist(), shapes.meshes.triangles, strict=True):
        triangles_of_geom.setdefault(geom, []).append(piece)
    return triangles_of_geom


def _mark_changed_primitives(
    old_primitives: Primitives, new_primitives: Primitives, is_changed_geom: Bool
) -> None:
    """Mark the geoms whose solids or planes appeared, vanished or changed.

    Args:
        old_primitives: the solids or the planes of one scene.
        new_primitives: the solids or the planes of the other scene.
        is_changed_geom: becomes True for these geoms, (ngeom,).
    """
    num_geoms = len(is_changed_geom)
    old_counts = np.bincount(old_primitives.geom, minlength=num_geoms)
    new_counts = np.bincount(new_primitives.geom, minlength=num_geoms)
    is_same_count: Bool = old_counts == new_counts
    is_changed_geom[~is_same_count] = True
    is_compared_in_old = is_same_count[old_primitives.geom]
    is_compared_in_new = is_same_count[new_primitives.geom]
    compared_geoms = new_primitives.geom[is_compared_in_new]
    array_pairs: Iterable[tuple[NDArray[np.generic], NDArray[np.generic]]] = zip(
        old_primitives, new_primitives, strict=True
    )
    for old_array, new_array in array_pairs:
        is_unequal = old_array[is_compared_in_old] != new_array[is_compared_in_new]
        is_unequal_row = is_unequal.any(axis=tuple(range(1, is_unequal.ndim)))
        is_changed_geom[compared_geoms[is_unequal_row]] = True


def _to_numbers(numbers: ArrayLike, subject: str) -> Float:
    try:
        return np.asarray(numbers, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError(f"expected numbers as the pose of {subject}, got {numbers!r}") from error
