"""Reads a USD stage: prims that are drawn or collide, and bodies with their joints.

pxr comes with the extra [usd]. MuJoCo's own plugin for USD is not used: it ignores units, the up
axis, instancers, visibility and purpose.

A prim is drawn unless it or one of its ancestors is invisible, a guide, or a proxy (if the stage
has render prims). It collides if the collision API is applied to it or to an ancestor, whether it
is drawn or not. A prim that is neither drawn nor collides is left out. Coordinates are rounded to
`DECIMALS`, because USD stores 32-bit floats: 3.7 m become 3.7000000477.

Source: Pixar, Universal Scene Description, schemas UsdGeom and UsdPhysics.
"""

from __future__ import annotations

import re
from functools import cache
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.geometry.shapes import Mesh, tessellate, triangulate
from navbake.baker.readers.mesh import AXIS_VECTORS, make_rotation_to_z_up
from navbake.baker.readers.parsed_scene import (
    JointTree,
    ParsedGeom,
    ParsedJoint,
    ParsedScene,
    check_geom_count,
    convert_read_errors,
)
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, SceneError
from navbake.formats.source import import_extra
from navbake.known_names import list_first
from navbake.lazy import lazy
from navbake.types import Bool, Float

if TYPE_CHECKING:
    from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdUtils
else:
    Gf = lazy("pxr.Gf")
    Tf = lazy("pxr.Tf")
    Usd = lazy("pxr.Usd")
    UsdGeom = lazy("pxr.UsdGeom")
    UsdPhysics = lazy("pxr.UsdPhysics")
    UsdUtils = lazy("pxr.UsdUtils")

DECIMALS = 6  # decimals that lengths in metres are rounded to
ROTATION_DECIMALS = 9  # decimals that angles in radians, and rotation matrices, are rounded to
# The axis of a solid -> the rotation matrix that turns z to it
AXIS_FRAMES = {"X": np.eye(3)[:, [1, 2, 0]], "Y": np.eye(3)[:, [2, 0, 1]], "Z": np.eye(3)}
AXIS_ORDERS = np.array(list(permutations(range(3))))
MAX_MESSAGE = 4000  # characters of a message of USD that are searched for its reason
MAX_SKEW = 1e-6  # the largest cosine between two axes of a frame that counts as not skewed
SOLID_TYPES = ("Cube", "Sphere", "Cylinder", "Capsule", "Cone", "Plane")
JOINT_KINDS = {
    "PhysicsRevoluteJoint": "hinge",
    "PhysicsPrismaticJoint": "slide",
    "PhysicsSphericalJoint": "ball",
    "PhysicsFixedJoint": "fixed",
}


class _PrimState(NamedTuple):
    """The properties that a prim inherits from its ancestors, and passes on to its descendants.

    Attributes:
        matrix: from the prim's frame to the stage's; points are row vectors.
        visible: whether neither the prim nor an ancestor is invisible.
        purpose: USD's purpose: default, render, proxy or guide.
        body: name of the rigid body that the prim is part of; empty for none.
        component: name of the prim of kind ``component`` that it is part of; empty for none.
        collides: whether the collision API is applied and enabled.
        approximation: USD's name of the shape that replaces a mesh in collisions.
    """

    matrix: Gf.Matrix4d
    visible: bool = True
    purpose: str = "default"
    body: str = ""
    component: str = ""
    collides: bool = False
    approximation: str = "none"


class _PrimShape(NamedTuple):
    """The shape of a prim, in its own frame and unit.

    Attributes:
        kind: one of `GEOM_TYPES`, or cone.
        size: the size as MuJoCo states it; empty for a mesh.
        frame: from the solid's frame to the prim's, (3, 3); the identity for a mesh.
        mesh: the triangles of a mesh; None for a solid.
    """

    kind: str
    size: tuple[float, ...]
    frame: Float
    mesh: Mesh | None


class _PrimGeometry(NamedTuple):
    """A prim's geometry, before it is placed in the world.

    Attributes:
        name: the geom's name.
        body: the name of its body.
        shape: the shape, in the prim's frame.
        matrix: from the prim's frame to the stage's; points are row vectors.
        mode: how a mesh counts, see `ParsedGeom`.
        collides: whether the geom can collide.
        purpose: USD's purpose, if the prim is drawn; else empty.
    """

    name: str
    body: str
    shape: _PrimShape
    matrix: Gf.Matrix4d
    mode: str
    collides: bool
    purpose: str


class _MeshKey(NamedTuple):
    """The key of a mesh in the cache of meshes.

    Attributes:
        path: the prim's path; for a prim of an instance, its path in the prototype.
        as_bounding_box: whether the mesh is replaced by its bounding box.
    """

    path: Sdf.Path
    as_bounding_box: bool


class _JointEnd(NamedTuple):
    """The frame of a joint on one of the two bodies that it connects, in the world.

    Attributes:
        position: the frame's origin, (3,) [m].
        rotation: the frame's axes as columns, (3, 3).
    """

    position: Float
    rotation: Float


def read_stage(path: Path, settings: SceneSettings) -> ParsedScene:
    """Read a .usd, .usda, .usdc or .usdz file.

    The unit and the up axis are those that the stage states, unless `scene.unit` or `scene.up` say
    otherwise. Names are paths of prims. A reference that can't be resolved is a warning.

    Args:
        path: the file.
        settings: `scene.unit` and `scene.up` are used.

    Returns:
        The parsed scene.

    Raises:
        MissingDependencyError: usd-core is not installed.
        SceneError: the stage or one of its prims is broken.
    """
    import_extra("pxr.Usd", "usd", f"{path}, a USD scene,")
    diagnostics = UsdUtils.CoalescingDiagnosticDelegate()  # else pxr writes to stderr
    try:
        stage = Usd.Stage.Open(str(path))
        return _StageReader(stage, path, settings).read()
    except Tf.ErrorException as error:
        error_text = str(error)[:MAX_MESSAGE]
        messages = re.findall(r" : '(.*?)'\s*(?=\n\tError|\n*$)", error_text, re.DOTALL)
        reason = " ".join((messages or [error_text])[0].split())[:300]
        raise SceneError(f"cannot read the USD stage {path}: {reason}") from error
    finally:
        diagnostics.TakeUncoalescedDiagnostics()


class _StageReader:
    """Reads the prims of a stage, and places them in the world."""

    def __init__(self, stage: Usd.Stage, path: Path, settings: SceneSettings) -> None:
        self._stage = stage
        self._path = path
        self._time = Usd.TimeCode.EarliestTime()
        self._unit, self._to_world = _find_stage_frame(stage, path, settings)
        self._parsed_scene = ParsedScene(decimals=DECIMALS)
        self._geometry: list[_PrimGeometry] = []
        self._rigid_bodies: dict[str, Gf.Matrix4d] = {}  # path -> matrix to the stage's frame
        self._kinematic_bodies: set[str] = set()
        self._joints: list[Usd.Prim] = []
        self._meshes: dict[_MeshKey, Mesh | None] = {}
        # Point instancers whose prototypes are being read
        self._open_instancers: list[Sdf.Path] = []
        self._left_out: dict[str, list[str]] = {}  # reason -> names of prims

    def read(self) -> ParsedScene:
        """Read all prims, then make the bodies and the geoms of the parsed scene."""
        for composition_error in self._stage.GetCompositionErrors():
            prim_paths = re.findall(r"<([^<>]*)>", str(composition_error.rootSite)[-MAX_MESSAGE:])
            error_text = " ".join(str(composition_error)[:MAX_MESSAGE].split())
            error_text = re.sub(r",@anon:[^@]*@", "", error_text)[:300]
            prim_path = prim_paths[-1] if prim_paths else "/"
            self._parsed_scene.warnings.append(f"prim {prim_path} of {self._path}: {error_text}")
        self._read_prims_below(self._stage.GetPseudoRoot(), _PrimState(Gf.Matrix4d(1.0)))
        self._make_bodies()
        self._place_geometry()
        for reason, names in self._left_out.items():
            self._parsed_scene.warnings.append(
                f"prim {list_first(names)} of {self._path} left out: {reason}"
            )
        return self._parsed_scene

    # ------------------------------------------------------------ prims

    def _read_prims_below(
        self, root: Usd.Prim, inherited_state: _PrimState, prefix: str = ""
    ) -> None:
        """Read a prim and its descendants, in their order.

        Args:
            root: the prim.
            inherited_state: the state that the prim inherits from its ancestors.
            prefix: the text that is removed from the start of the prims' paths to make their names.
        """
        traversal_predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
        unread_prims = [(root, inherited_state)]
        while unread_prims:
            prim, parent_state = unread_prims.pop()
            name = str(prim.GetPath()).removeprefix(prefix)
            with convert_read_errors(f"prim {prim.GetPath()} of {self._path}"):
                prim_state = self._find_state(prim, name, parent_state)
                reads_children = self._read_prim(prim, name, prim_state)
            if reads_children:
                children = reversed(prim.GetFilteredChildren(traversal_predicate))
                unread_prims += [(child, prim_state) for child in children]

    def _read_prim(self, prim: Usd.Prim, name: str, state: _PrimState) -> bool:
        """Read one prim of the stage; return whether its children are to be read, too.

        Args:
            prim: the prim.
            name: the name of the geom or instancer that it may become.
            state: the state of the prim, with all that it inherits from its ancestors.
        """
        prim_type = str(prim.GetTypeName())
        if prim_type == "PointInstancer":
            self._read_instancer(prim, name, state)
            return False  # its children are prototypes, which only its points show
        if prim_type in (*SOLID_TYPES, "Mesh"):
            self._read_geometry(prim, name, prim_type, state)
        elif prim_type.startswith("Physics") and prim_type.endswith("Joint"):
            self._joints.append(prim)
        elif prim_type.startswith(("Cylinder", "Capsule")) and prim.IsA(UsdGeom.Gprim):
            # such as Cylinder_1
            self._read_geometry(prim, name, prim_type.partition("_")[0], state)
        elif prim_type and prim.IsA(UsdGeom.Gprim):
            self._leave_out(f"{prim_type} is no surface that navbake reads", name)
        return True

    def _find_state(self, prim: Usd.Prim, name: str, parent_state: _PrimState) -> _PrimState:
        matrix = parent_state.matrix
        visible = parent_state.visible
        purpose = parent_state.purpose
        body = parent_state.body
        component = parent_state.component
        collides = parent_state.collides
        approximation = parent_state.approximation
        # one call, as most prims have few properties
        property_names = prim.GetAuthoredPropertyNames()
        if "visibility" in property_names:
            visible = visible and self._get(prim, "visibility") != "invisible"
        if "purpose" in property_names:
            purpose = str(self._get(prim, "purpose"))
        if "xformOpOrder" in property_names:
            xform = UsdGeom.Xformable(prim)
            local_matrix = xform.GetLocalTransformation(self._time)
            is_reset = xform.GetResetXformStack()
            matrix = local_matrix if is_reset else local_matrix * matrix
        if not component and name.count("/") > 1 and prim.GetMetadata("kind") == "component":
            component = name
        if prim.GetAppliedSchemas():
            if prim.HasAPI(UsdPhysics.RigidBodyAPI):
                rigid_body = UsdPhysics.RigidBodyAPI(prim)
                if rigid_body.GetRigidBodyEnabledAttr().Get(self._time):
                    # A matrix without a rotation fails here, where the error names the prim.
                    _rigid_pose(self._matrix_to_world(matrix))
                    body = name
                    self._rigid_bodies[name] = matrix
                    if rigid_body.GetKinematicEnabledAttr().Get(self._time):
                        self._kinematic_bodies.add(name)
            if prim.HasAPI(UsdPhysics.CollisionAPI):
                enabled_attribute = UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr()
                collides = bool(enabled_attribute.Get(self._time))
            if prim.HasAPI(UsdPhysics.MeshCollisionAPI):
                approximation = str(UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get())
        return _PrimState(
            matrix=matrix,
            visible=visible,
            purpose=purpose,
            body=body,
            component=component,
            collides=collides,
            approximation=approximation,
        )

    def _leave_out(self, reason: str, name: str) -> None:
        self._left_out.setdefault(reason, []).append(name)

    def _get(self, prim: Usd.Prim, name: str) -> object:
        return prim.GetAttribute(name).Get(self._time)

    def _get_number(self, prim: Usd.Prim, name: str) -> float:
        return float(prim.GetAttribute(name).Get(self._time))

    def _get_axis(self, prim: Usd.Prim, name: str) -> str:
        axis = str(self._get(prim, name))
        if axis not in AXIS_FRAMES:
            axis_text = f"{name} of {prim.GetPath()} in {self._path}"
            raise SceneError(f"expected X, Y or Z as {axis_text}, got {axis[:40]!r}")
        return axis

    # ------------------------------------------------------------ geometry

    def _read_geometry(self, prim: Usd.Prim, name: str, prim_type: str, state: _PrimState) -> None:
        is_drawn = state.visible and state.purpose != "guide"
        if not is_drawn and not state.collides:
            self._leave_out("it is invisible" if not state.visible else "it is a guide", name)
            return
        is_hull = state.collides and state.approximation in ("convexHull", "boundingCube")
        if prim_type == "Mesh":
            shape = self._read_mesh(prim, state)
        else:
            shape = self._read_solid(prim, prim_type, state)
        if shape is not None:
            self._geometry.append(
                _PrimGeometry(
                    name=name,
                    body=state.body or state.component or name,
                    shape=shape,
                    matrix=state.matrix,
                    mode="hull" if is_hull else "surface",
                    collides=state.collides,
                    purpose=state.purpose if is_drawn else "",
                )
            )

    def _read_solid(self, prim: Usd.Prim, prim_type: str, state: _PrimState) -> _PrimShape:
        """Make the shape of a solid.

        A plane that collides is endless. Of a solid with two radii, the larger radius counts.
        """
        if prim_type == "Cube":
            half_size = self._get_number(prim, "size") / 2
            return _PrimShape("box", (half_size, half_size, half_size), np.eye(3), None)
        if prim_type == "Sphere":
            radius = self._get_number(prim, "radius")
            return _PrimShape("ellipsoid", (radius, radius, radius), np.eye(3), None)
        axis = self._get_axis(prim, "axis")
        frame = AXIS_FRAMES[axis]
        if prim_type == "Plane":
            half_width = self._get_number(prim, "width") / 2
            half_length = self._get_number(prim, "length") / 2
            half_sides = (half_width, half_length) if axis == "Z" else (half_length, half_width)
            size = (0.0, 0.0) if state.collides else half_sides
            return _PrimShape("plane", size, frame, None)
        radii = []
        for name in ("radius", "radiusBottom", "radiusTop"):
            attribute = prim.GetAttribute(name)
            if attribute:
                radii.append(float(attribute.Get(self._time)))
        size = (max(radii), self._get_number(prim, "height") / 2)
        return _PrimShape(prim_type.lower(), size, frame, None)

    def _read_mesh(self, prim: Usd.Prim, state: _PrimState) -> _PrimShape | None:
        """Read the shape of a mesh, or get it from the cache; None if it is empty."""
        shared_prim = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim
        as_bounding_box = state.collides and state.approximation == "boundingCube"
        mesh_key = _MeshKey(shared_prim.GetPath(), as_bounding_box)
        if mesh_key not in self._meshes:
            self._meshes[mesh_key] = self._read_triangles(prim, as_bounding_box=as_bounding_box)
        mesh = self._meshes[mesh_key]
        return None if mesh is None else _PrimShape("mesh", (), np.eye(3), mesh)

    def _read_triangles(self, prim: Usd.Prim, *, as_bounding_box: bool) -> Mesh | None:
        """Read the triangles of a mesh, or of its bounding box, in the prim's frame.

        Corners are counter-clockwise from outside. Returns None for an empty mesh.
        """
        points = prim.GetAttribute("points").Get(self._time)
        face_counts = prim.GetAttribute("faceVertexCounts").Get(self._time)
        face_indices = prim.GetAttribute("faceVertexIndices").Get(self._time)
        if not points or not face_counts:
            return None
        vertices = np.array(points, dtype=np.float64).reshape(-1, 3)
        corner_counts = np.array(face_counts)
        corner_indices = np.array(face_indices if face_indices is not None else [], int)
        mesh_text = f"mesh {prim.GetPath()} of {self._path}"
        if corner_counts.min() < 0 or corner_counts.sum() != len(corner_indices):
            corners_text = (
                f"{corner_counts.sum()} corners, but faceVertexIndices {len(corner_indices)}"
            )
            raise SceneError(f"{mesh_text} is broken: its faces have {corners_text}")
        if len(corner_indices) and not 0 <= corner_indices.min() <= corner_indices.max() < len(
            vertices
        ):
            expected_text = f"expected faceVertexIndices from 0 to {len(vertices) - 1}"
            got_text = f"got {corner_indices.min()} to {corner_indices.max()}"
            raise SceneError(f"{mesh_text} is broken: {expected_text}, {got_text}")
        if as_bounding_box:
            unit_box = tessellate("box", (0.5, 0.5, 0.5))
            lowest_corner = vertices.min(axis=0)
            highest_corner = vertices.max(axis=0)
            return Mesh(
                lowest_corner + (unit_box.vertices + 0.5) * (highest_corner - lowest_corner),
                unit_box.faces,
            )
        hole_indices = prim.GetAttribute("holeIndices").Get(self._time) or []
        faces = triangulate(
            vertices, corner_counts, corner_indices, np.array(hole_indices, dtype=np.int64)
        )
        if self._get(prim, "orientation") == "leftHanded":
            faces = faces[:, ::-1]
        return Mesh(vertices, faces)

    # ------------------------------------------------------------ point instancers

    def _read_instancer(self, prim: Usd.Prim, name: str, state: _PrimState) -> None:
        """Add the geometry of a point instancer: a copy of a prototype at each of its points.

        Names are ``instancer/number/…``.
        """
        instancer = UsdGeom.PointInstancer(prim)
        prototype_paths = instancer.GetPrototypesRel().GetForwardedTargets()
        prototype_of_point = instancer.GetProtoIndicesAttr().Get(self._time)
        if not prototype_of_point or not prototype_paths:
            return
        prototypes = []
        for path in prototype_paths:
            prototype = self._stage.GetPrimAtPath(path)
            if not prototype:
                raise SceneError(f"prototype {path} of {name} in {self._path} is missing")
            prototypes.append(prototype)
        lowest_index = min(prototype_of_point)
        highest_index = max(prototype_of_point)
        if not 0 <= lowest_index <= highest_index < len(prototypes):
            raise SceneError(
                f"expected protoIndices of {name} in {self._path} from 0 to "
                f"{len(prototypes) - 1}, got {lowest_index} to {highest_index}"
            )
        # The prototypes' own transforms are excluded: their geometry includes them.
        point_matrices = instancer.ComputeInstanceTransformsAtTime(
            self._time, self._time, UsdGeom.PointInstancer.ExcludeProtoXform,
            UsdGeom.PointInstancer.IgnoreMask,
        )  # fmt: skip
        num_points = len(prototype_of_point)
        is_shown = list(instancer.ComputeMaskAtTime(self._time)) or [True] * num_points
        if not len(point_matrices) == len(is_shown) == num_points:
            raise SceneError(
                f"expected as many positions as protoIndices of {name} in {self._path}, got "
                f"{len(point_matrices)} and {num_points}"
            )
        if prim.GetPath() in self._open_instancers:
            raise SceneError(f"point instancer {prim.GetPath()} of {self._path} contains itself")
        self._open_instancers.append(prim.GetPath())
        # Each prototype is read once, at the origin.
        geometry_of_prototype = dict[int, list[_PrimGeometry]]()
        for point_number in range(num_points):
            if not is_shown[point_number]:
                continue
            prototype_index = prototype_of_point[point_number]
            if prototype_index not in geometry_of_prototype:
                geometry_of_prototype[prototype_index] = self._read_prototype(
                    prototypes[prototype_index], state
                )
            instance_name = f"{name}/{point_number}"
            instance_matrix = point_matrices[point_number] * state.matrix
            prototype_geometry = geometry_of_prototype[prototype_index]
            check_geom_count(len(self._geometry) + len(prototype_geometry), self._path)
            for geometry in prototype_geometry:
                self._geometry.append(
                    geometry._replace(
                        name=instance_name + geometry.name,
                        body=state.body or instance_name,
                        matrix=geometry.matrix * instance_matrix,
                    )
                )
        self._open_instancers.pop()

    def _read_prototype(self, root: Usd.Prim, state: _PrimState) -> list[_PrimGeometry]:
        """Read the geometry of a prototype, at the origin, with names relative to the prototype.

        Its rigid bodies and joints are ignored.
        """
        outer_geometry = self._geometry
        outer_bodies = dict(self._rigid_bodies)
        outer_joints = list(self._joints)
        self._geometry = []
        state_at_origin = state._replace(matrix=Gf.Matrix4d(1.0))
        self._read_prims_below(root, state_at_origin, prefix=str(root.GetPath()))
        prototype_geometry = self._geometry
        self._geometry = outer_geometry
        self._rigid_bodies = outer_bodies
        self._joints = outer_joints
        return prototype_geometry

    # ------------------------------------------------------------ bodies and joints

    def _make_bodies(self) -> None:
        """Make the parsed scene's bodies from rigid prims.

        A body is attached to another body by a joint. A body without a joint moves freely, or, if
        it is kinematic, not at all.
        """
        poses = {
            name: _rigid_pose(self._matrix_to_world(matrix))
            for name, matrix in self._rigid_bodies.items()
        }
        joint_tree = JointTree(poses)
        transform_cache = UsdGeom.XformCache(self._time)
        for prim in self._joints:
            self._attach(joint_tree, prim, transform_cache)
        self._parsed_scene.bodies = joint_tree.make_bodies(fixed_names=self._kinematic_bodies)

    def _attach(
        self, joint_tree: JointTree, prim: Usd.Prim, transform_cache: UsdGeom.XformCache
    ) -> None:
        """Attach one of the two bodies that a joint's prim connects to the other one."""
        joint = UsdPhysics.Joint(prim)
        name = str(prim.GetPath())
        joint_type = JOINT_KINDS.get(str(prim.GetTypeName()), "")
        if not joint.GetJointEnabledAttr().Get(self._time):
            return
        parent = self._find_body(joint.GetBody0Rel().GetForwardedTargets())
        child = self._find_body(joint.GetBody1Rel().GetForwardedTargets())
        # The second body is the child, unless it never moves or already has a parent.
        may_be_parent = bool(parent) and not joint_tree.is_attached(parent)
        is_swapped = not child or (joint_tree.is_attached(child) and may_be_parent)
        if is_swapped:
            parent, child = child, parent
        if not joint_type:
            self._leave_out(f"{prim.GetTypeName()} is no joint that navbake reads", name)
            return
        if not child:
            self._leave_out("it ties no rigid body", name)
            return
        with convert_read_errors(f"joint {name} of {self._path}"):
            parsed_joint = self._read_joint(prim, joint_type, transform_cache, is_swapped)
        if not joint_tree.attach(parent, child, parsed_joint):
            self._leave_out("its bodies hang on other joints already", name)

    def _find_body(self, targets: list[Sdf.Path]) -> str:
        """Find the rigid body that a joint's target belongs to; empty if it never moves."""
        prim = self._stage.GetPrimAtPath(targets[0]) if targets else None
        while prim and str(prim.GetPath()) not in self._rigid_bodies:
            prim = prim.GetParent()
        name = str(prim.GetPath()) if prim else ""
        return "" if name in self._kinematic_bodies else name

    def _read_joint(
        self, prim: Usd.Prim, joint_type: str, transform_cache: UsdGeom.XformCache, is_swapped: bool
    ) -> ParsedJoint | None:
        """Read a joint.

        Args:
            prim: the joint's prim.
            joint_type: hinge, slide, ball or fixed.
            transform_cache: the cache of the transforms of the stage's prims.
            is_swapped: whether the joint's first body is the child of its second one.

        Returns:
            The joint in the world frame; None if it is fixed.
        """
        if joint_type == "fixed":
            return None
        joint = UsdPhysics.Joint(prim)
        first_end = self._find_joint_end(prim, 0, joint.GetBody0Rel(), transform_cache)
        second_end = self._find_joint_end(prim, 1, joint.GetBody1Rel(), transform_cache)
        axis_number = (
            0 if joint_type == "ball" else "XYZ".index(self._get_axis(prim, "physics:axis"))
        )
        axis = second_end.rotation[:, axis_number]
        position = 0.0
        if joint_type == "slide":
            position = float(axis @ (second_end.position - first_end.position))
        elif joint_type == "hinge":
            relative_rotation = first_end.rotation.T @ second_end.rotation
            first_axis = (axis_number + 1) % 3
            second_axis = (axis_number + 2) % 3
            position = float(
                np.arctan2(
                    relative_rotation[second_axis, first_axis],
                    relative_rotation[first_axis, first_axis],
                )
            )
        axis_sign = -1.0 if is_swapped else 1.0
        return ParsedJoint(
            name=str(prim.GetPath()),
            kind=joint_type,
            anchor=np.round(second_end.position, DECIMALS),
            axis=np.round(axis_sign * axis, ROTATION_DECIMALS) + 0.0,
            limits=None if joint_type == "ball" else self._read_limits(prim, joint_type),
            position=_round(position, DECIMALS),
        )

    def _read_limits(self, prim: Usd.Prim, joint_type: str) -> tuple[float, float] | None:
        """Read the lowest and highest position of a joint [m or rad]; None if it has no limits."""
        stated_limits = [
            self._get_number(prim, "physics:lowerLimit"),
            self._get_number(prim, "physics:upperLimit"),
        ]
        is_hinge = joint_type == "hinge"
        lower_limit, upper_limit = (
            np.radians(stated_limits) if is_hinge else np.array(stated_limits) * self._unit
        )
        if not np.isfinite([lower_limit, upper_limit]).all() or not lower_limit < upper_limit:
            return None
        return _round(lower_limit, ROTATION_DECIMALS), _round(upper_limit, ROTATION_DECIMALS)

    def _find_joint_end(
        self,
        prim: Usd.Prim,
        body_number: int,
        body_relationship: Usd.Relationship,
        transform_cache: UsdGeom.XformCache,
    ) -> _JointEnd:
        """Find the frame of a joint on one of its two bodies.

        Args:
            prim: the joint's prim.
            body_number: 0 for the first body, 1 for the second.
            body_relationship: the joint's relationship to this body.
            transform_cache: the cache of the transforms of the stage's prims.
        """
        targets = body_relationship.GetForwardedTargets()
        body_prim = self._stage.GetPrimAtPath(targets[0]) if targets else None
        matrix = (
            transform_cache.GetLocalToWorldTransform(body_prim) if body_prim else Gf.Matrix4d(1.0)
        )
        to_world = self._matrix_to_world(matrix)
        position = np.array(self._get(prim, f"physics:localPos{body_number}"), dtype=np.float64)
        rotation = np.array(Gf.Matrix3d(self._get(prim, f"physics:localRot{body_number}"))).T
        return _JointEnd(
            position=to_world[:3, :3] @ position + to_world[:3, 3],
            rotation=_rigid_pose(to_world)[:3, :3] @ rotation,
        )

    # ------------------------------------------------------------ places

    def _matrix_to_world(self, matrix: Gf.Matrix4d) -> Float:
        """Return the matrix from a prim's frame to the world, for column vectors, (4, 4) [m].

        Args:
            matrix: the matrix from the prim's frame to the stage's; points are row vectors.
        """
        return np.asarray(self._to_world @ np.array(matrix).T)

    def _place_geometry(self) -> None:
        """Add the geometry of all prims to the parsed scene, as geoms in the world frame.

        A solid becomes a mesh if its matrix skews it, or scales it so that it is another kind of
        shape (a cylinder with an elliptic base, for example).
        """
        has_render_prims = any(geometry.purpose == "render" for geometry in self._geometry)
        if has_render_prims:
            self._drop_proxies()
        if not self._geometry:
            return
        matrices = np.array([geometry.matrix for geometry in self._geometry])
        to_world = self._to_world @ matrices.transpose(0, 2, 1)
        solid_frames = np.stack([geometry.shape.frame for geometry in self._geometry])
        to_world[:, :3, :3] = to_world[:, :3, :3] @ solid_frames
        scales = np.linalg.norm(to_world[:, :3, :3], axis=1)
        rotations = to_world[:, :3, :3] / np.where(scales > 0, scales, 1.0)[:, None]
        axis_cosines = rotations.transpose(0, 2, 1) @ rotations
        is_skewed = np.abs(axis_cosines - np.eye(3)).max(axis=(1, 2)) > MAX_SKEW
        kinds = np.array(
            [
                geometry.shape.kind if geometry.shape.mesh is None else ""
                for geometry in self._geometry
            ]
        )
        rotations, scales = _straighten(kinds, np.round(rotations, ROTATION_DECIMALS), scales)
        poses = np.tile(np.eye(4), (len(to_world), 1, 1))
        poses[:, :3, :3] = rotations
        poses[:, :3, 3] = np.round(to_world[:, :3, 3], DECIMALS) + 0.0
        make_solid_mesh = cache(tessellate)
        scale_rows = scales.tolist()
        skew_flags = is_skewed.tolist()
        for geometry_index, geometry in enumerate(self._geometry):
            shape = geometry.shape
            mesh = shape.mesh
            geom_size = None
            if mesh is None:
                geom_size = _scale_size(
                    shape.kind, shape.size, scale_rows[geometry_index], skew_flags[geometry_index]
                )
            kind = shape.kind
            pose = poses[geometry_index]
            if geom_size is None:
                kind = "mesh"
                pose = to_world[geometry_index]
                mesh = mesh or make_solid_mesh(shape.kind, shape.size)
            elif kind == "ellipsoid" and geom_size[0] == geom_size[1] == geom_size[2]:
                kind = "sphere"
                geom_size = geom_size[:1]
            is_proxy = has_render_prims and geometry.purpose == "proxy"
            self._parsed_scene.geoms.append(
                ParsedGeom(
                    name=geometry.name,
                    body=geometry.body,
                    kind=kind,
                    size=geom_size or (),
                    pose=pose,
                    mesh=mesh,
                    mode=geometry.mode,
                    collides=geometry.collides,
                    drawn=bool(geometry.purpose) and not is_proxy,
                )
            )

    def _drop_proxies(self) -> None:
        """Leave out proxies that don't collide: render prims are drawn instead of them."""
        remaining_geometry = []
        for geometry in self._geometry:
            if geometry.purpose == "proxy" and not geometry.collides:
                self._leave_out("it is a proxy beside render prims", geometry.name)
            else:
                remaining_geometry.append(geometry)
        self._geometry = remaining_geometry


def _straighten(kinds: NDArray[np.str_], rotations: Float, scales: Float) -> tuple[Float, Float]:
    """Permute and flip the axes of symmetric solids so that they are near the world's axes.

    So a box has the same pose and size whether the stage is y up or z up.

    Args:
        kinds: the kinds of the solids, (n,); empty for meshes.
        rotations: the solids' frames: axes as columns, (n, 3, 3).
        scales: the scales along the axes of the frames, (n, 3).

    Returns:
        The new frames and scales, with the same shapes.
    """
    axis_order = np.tile(np.arange(3), (len(rotations), 1))
    box_indices = np.flatnonzero((kinds == "box") | (kinds == "ellipsoid"))
    # How well each order of the axes matches the world's axes
    axis_match = np.abs(rotations[box_indices][:, np.arange(3)[None], AXIS_ORDERS]).sum(axis=2)
    axis_order[box_indices] = AXIS_ORDERS[axis_match.argmax(axis=1)]
    rotations = np.take_along_axis(rotations, axis_order[:, None, :], axis=2)
    scales = np.take_along_axis(scales, axis_order, axis=1)
    is_symmetric: Bool = kinds != "plane"  # unchanged if an axis is flipped
    for axis in range(3):
        rotations[is_symmetric & (rotations[:, axis, axis] < 0), :, axis] *= -1
    is_upright = np.isin(kinds, ("cylinder", "capsule")) & (rotations[:, 2, 2] == 1.0)
    rotations[is_upright] = np.eye(3)
    rotations[np.linalg.det(rotations) < 0, :, 0] *= -1
    return rotations + 0.0, scales


def _scale_size(
    solid_type: str, size: tuple[float, ...], scales: list[float], is_skewed: bool
) -> tuple[float, ...] | None:
    """Scale the size of a solid.

    Args:
        solid_type: the solid's kind, see `_PrimShape`.
        size: the size before scaling.
        scales: the scales along the solid's axes, three numbers.
        is_skewed: whether the solid is skewed, too.

    Returns:
        The size [m]; None if the result is not a solid of this kind.
    """
    x_scale = _round(scales[0], DECIMALS)
    y_scale = _round(scales[1], DECIMALS)
    z_scale = _round(scales[2], DECIMALS)
    if is_skewed or solid_type == "cone":
        return None
    if solid_type == "capsule" and not x_scale == y_scale == z_scale:
        return None
    if solid_type == "cylinder" and x_scale != y_scale:
        return None
    factors = (scales[0], scales[2]) if solid_type in ("cylinder", "capsule") else scales
    return tuple(
        _round(length * factor, DECIMALS) for length, factor in zip(size, factors, strict=False)
    )


def _rigid_pose(matrix: Float) -> Float:
    """Return the rigid pose nearest to a transform that may scale and skew, (4, 4)."""
    left_vectors, _, right_vectors = np.linalg.svd(matrix[:3, :3])
    rotation = left_vectors @ right_vectors
    rotation = rotation * np.sign(np.linalg.det(rotation))
    pose = np.eye(4)
    pose[:3, :3] = np.round(rotation, ROTATION_DECIMALS) + 0.0
    pose[:3, 3] = np.round(matrix[:3, 3], DECIMALS) + 0.0
    return pose


def _round(value: float, decimals: int) -> float:
    return round(float(value), decimals) + 0.0  # no -0.0


def _find_stage_frame(stage: Usd.Stage, path: Path, settings: SceneSettings) -> tuple[float, Float]:
    """Find a stage's unit, and which way is up in it.

    `scene.unit` and `scene.up` count, if they are set, before what the stage states.

    Returns:
        The length of one unit of the stage [m]; and the matrix from its frame to the world, (4, 4).

    Raises:
        ConfigError: `scene.up` is ``level``.
        SceneError: the stage states no axis, or a wrong unit.
    """
    if settings.up == "level":
        raise ConfigError(f"`scene.up: level` is for mesh files, {path} says what is up itself")
    up = settings.up if settings.up != "auto" else str(UsdGeom.GetStageUpAxis(stage)).lower()
    if isinstance(up, str) and up not in AXIS_VECTORS:
        raise SceneError(f"expected X, Y or Z as upAxis of {path}, got {up[:40]!r}: set `scene.up`")
    is_unit_set = "unit" in settings.model_fields_set
    unit = settings.unit if is_unit_set else float(UsdGeom.GetStageMetersPerUnit(stage))
    if not 0 < unit < np.inf:
        raise SceneError(f"expected metersPerUnit > 0 in {path}, got {unit:g}")
    matrix = np.eye(4)
    matrix[:3, :3] = make_rotation_to_z_up(up) * unit
    return unit, matrix
