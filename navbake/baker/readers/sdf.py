"""Reads worlds and models of Gazebo (SDF): collisions, visuals, and joints of links.

A ``<collision>`` becomes a geom that collides and isn't drawn, a ``<visual>`` one that is drawn and
doesn't collide. Lights, plugins, sensors and populations are not read. Meshes count by their
triangles, as in Gazebo. A static model is one body with the model's name. In other models, the
canonical link is a body with the model's name, and each further link is a body ``model::link``.

Source: SDFormat specification 1.12, sdformat.org.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from fnmatch import fnmatchcase
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navbake.baker.geometry.shapes import Mesh, tessellate
from navbake.baker.readers.mesh import (
    StrayMeshError,
    join_meshes,
    make_rotation_to_z_up,
    read_named_meshes,
)
from navbake.baker.readers.parsed_scene import (
    JointTree,
    ParsedGeom,
    ParsedJoint,
    ParsedScene,
    check_geom_count,
)
from navbake.baker.readers.sdf_frames import (
    WORLD_NAMES,
    Element,
    Scope,
    find_text,
    is_true,
    parse_numbers,
)
from navbake.baker.readers.sdf_shapes import (
    extrude_outlines,
    read_height_field,
    read_image_boxes,
)
from navbake.config.settings import SceneSettings
from navbake.errors import SceneError
from navbake.formats.package_paths import is_same_model_name, parse_fuel_address
from navbake.formats.scene_files import (
    MESH_SUFFIXES,
    find_model_file,
    list_sdf_paths,
    parse_sdf_version,
)
from navbake.formats.xml_files import parse_xml
from navbake.types import Float

# A joint with a larger limit counts as unlimited; SDF writes 1e16 for no limit [m or rad]
MAX_JOINT_LIMIT = 1e10
FILE_SHAPES = ("mesh", "heightmap", "image")
GLTF_SUFFIXES = (".glb", ".gltf")
HINGE_TYPES = ("revolute", "continuous")
MAX_NESTING = 50  # levels of models in models, and of frames attached to frames
# The last version of SDF whose joint axes are in the frame of the model
LAST_VERSION_WITH_MODEL_AXES = (1, 4)
INCLUDED_TAGS = ("model", "light", "actor")  # what an included file may have; models alone count
# Models that come with Gazebo: they need not be found
SUN_MODEL = "sun"
GROUND_MODEL = "ground_plane"


class SolidSize(NamedTuple):
    """The XML element in which SDF states the size of a kind of solid.

    Attributes:
        element: the name of the XML element with the values.
        num_values: the number of values in the element.
        factor: the factor from SDF's values to MuJoCo's sizes.
    """

    element: str
    num_values: int
    factor: float


SOLID_SIZES = {
    "box": SolidSize("size", 3, 0.5),
    "sphere": SolidSize("radius", 1, 1.0),
    "ellipsoid": SolidSize("radii", 3, 1.0),
}


class MeshKey(NamedTuple):
    """The key of a mesh in the cache of meshes.

    Attributes:
        file: the mesh's file.
        submesh: the name of the part of the file that is used; empty for all.
        is_centered: whether the part is moved so that its bounding box is centred at the origin.
    """

    file: Path
    submesh: str
    is_centered: bool


class JointOfScope(NamedTuple):
    """A ``<joint>``, and the scope of the world or model that contains it.

    Attributes:
        scope: the world or model.
        element: the ``<joint>``.
    """

    scope: Scope
    element: Element


def read_world(path: Path, settings: SceneSettings) -> ParsedScene:
    """Read the first world of an .sdf or .world file; if it has none, the models in the file.

    Models, meshes and images that aren't there are left out, as in Gazebo, and one warning lists
    them; with `scene.strict`, they are an error. Bodies and geoms that `scene.exclude` names may be
    missing or broken. `navbake.formats.scene_files.list_sdf_paths` lists where files are searched.

    Args:
        path: the file.
        settings: `scene.model_path`, `scene.strict` and `scene.exclude` are used.

    Returns:
        The parsed scene.

    Raises:
        SceneError: the file, or a model in it, is broken; or all models are missing.
    """
    return _WorldReader(path, settings).read()


class _WorldReader:
    """Reads a file, and the files that it includes."""

    def __init__(self, path: Path, settings: SceneSettings) -> None:
        self._path = path
        self._model_folders = settings.model_path
        self._is_strict = settings.strict
        self._exclude = settings.exclude
        # Missing file or model, as messages name it -> how often the scene names it
        self._num_missing: dict[str, int] = {}
        # A place in which a missing file was searched in vain, for the message
        self._searched_places = list[Path]()
        self._missing_models = set[str]()  # full names of included models that aren't there
        self._parsed_scene = ParsedScene()
        # Name -> world pose, of bodies that may move
        self._body_poses: dict[str, Float] = {}
        # Full name of a link -> name of its body; empty if its model is static
        self._body_of_link: dict[str, str] = {}
        self._joints: list[JointOfScope] = []
        # Key -> the mesh, and the warnings to give where it is used
        self._meshes: dict[MeshKey, tuple[Mesh, list[str]]] = {}
        self._parse = cache(parse_sdf)
        self._find_model = cache(self._search_model)
        self._count = 0  # models and geoms so far

    def read(self) -> ParsedScene:
        """Read the world with all models in it."""
        root = self._parse(self._path)
        worlds = root.findall("world")
        if len(worlds) > 1:
            self._warn(f"{len(worlds)} worlds in {self._path}: the first one is taken")
        world_element = worlds[0] if worlds else root
        world = Scope(self._find_models, world_element, world_element, self._path, None)
        if world.element.find("state/model") is not None:
            self._warn(
                f"<state> of {self._path} is passed by, as in today's Gazebo; Gazebo classic "
                "places models by it"
            )
        self._read_models(world)
        self._joints += [JointOfScope(world, joint) for joint in world.element.findall("joint")]
        joint_tree = JointTree(self._body_poses)
        for joint in self._joints:
            self._attach(joint_tree, joint.scope, joint.element)
        self._parsed_scene.bodies = joint_tree.make_bodies()
        if self._num_missing:
            self._warn_missing_files()
        return self._parsed_scene

    def _warn(self, text: str) -> None:
        if text not in self._parsed_scene.warnings:
            self._parsed_scene.warnings.append(text)

    def _warn_missing_files(self) -> None:
        """Warn of all missing files at once; raise a SceneError if the settings are strict."""
        missing_text = ", ".join(
            missing_name if num_times == 1 else f"{missing_name} ({num_times} times)"
            for missing_name, num_times in self._num_missing.items()
        )
        searched_names = [*dict.fromkeys(map(str, self._searched_places))]
        searched_text = ", ".join(searched_names[:4]) + (", …" if len(searched_names) > 4 else "")
        empty_folder = next(
            (searched_place for searched_place in self._searched_places if searched_place.is_dir()),
            None,
        )
        if empty_folder is not None:
            searched_text += f" ({empty_folder} has no {find_model_file(empty_folder).name})"
        message = f"{self._path} names {missing_text}, not found in {searched_text}"
        advice_text = (
            "name the folder that holds them by `--model-path`, `scene.model_path` or "
            "GZ_SIM_RESOURCE_PATH"
        )
        if self._is_strict:
            raise SceneError(
                f"{message}: {advice_text} (`scene.strict` or `--strict` refuses them)"
            )
        if not self._parsed_scene.geoms:
            raise SceneError(f"{message}: no geometry is left; {advice_text}")
        self._warn(
            f"{message}: left out, as in Gazebo; {advice_text}, or refuse them by `--strict`"
        )

    def _record_missing(self, missing_name: str, searched_places: list[Path]) -> None:
        self._num_missing[missing_name] = self._num_missing.get(missing_name, 0) + 1
        if len(self._num_missing) == 1:
            self._searched_places = searched_places

    def _is_excluded_body(self, name: str) -> bool:
        """Return whether `scene.exclude` names a body, or a model that contains it."""
        name_parts = name.split("::")
        enclosing_names = [
            "::".join(name_parts[: part_number + 1]) for part_number in range(len(name_parts))
        ]
        return any(
            fnmatchcase(enclosing_name, pattern)
            for pattern in self._exclude.bodies
            for enclosing_name in enclosing_names
        )

    def _is_excluded_geom(self, name: str) -> bool:
        return any(fnmatchcase(name, pattern) for pattern in self._exclude.geoms)

    # ------------------------------------------------------------ models

    def _add_to_count(self) -> None:
        self._count += 1
        check_geom_count(self._count, self._path)

    def _find_models(self, scope: Scope) -> list[Scope]:
        """List the models directly in a world or a model, in their order in the file."""
        if scope.depth > MAX_NESTING:
            raise SceneError(f"{scope.file} includes itself, by model {scope.name!r}")
        models = []
        for element in scope.element:
            file: Path | None = scope.file
            model = element if element.tag == "model" else None
            if element.tag == "include":
                file, model = self._find_included_model(element, scope)
            if model is not None and file is not None:
                self._add_to_count()
                models.append(Scope(self._find_models, model, element, file, scope))
        return models

    def _find_included_model(
        self, include: Element, scope: Scope
    ) -> tuple[Path | None, Element | None]:
        """Find the file of an included model, and its ``<model>`` element.

        Args:
            include: the ``<include>``.
            scope: the world or model that contains it.

        Returns:
            The file and the element. For a missing model, an element without links is returned, so
            that frames that are relative to the model have a pose. For a model that comes with
            Gazebo and isn't found, both are None.
        """
        uri = find_text(include, "uri")
        name = find_text(include, "name") or _model_name(uri)
        full_name = scope.make_full_name(name)
        empty_model = ElementTree.Element("model", {"name": name})
        is_excluded = self._is_excluded_body(full_name)
        file = self._find_model(uri, scope.file)
        if file is not None:
            try:
                root = self._parse(file)
            except SceneError:
                if not is_excluded:
                    raise
            else:
                model = root.find("model")
                if not is_excluded and all(root.find(tag) is None for tag in INCLUDED_TAGS):
                    itself_text = ", and is the file itself" if file.samefile(scope.file) else ""
                    self._warn(
                        f"<include> of {uri!r} in {scope.file} is left out: {file} has no "
                        f"<model>{itself_text}"
                    )
                return file, model
        elif _is_model(uri, SUN_MODEL) or _is_model(uri, GROUND_MODEL):
            return None, None
        elif not is_excluded and full_name not in self._missing_models:
            searched_paths = list(list_sdf_paths(uri, scope.file, self._model_folders))
            self._record_missing(f"model {uri!r}", searched_paths)
        self._missing_models.add(full_name)
        if is_excluded:
            self._parsed_scene.empty_bodies.add(full_name)
        return scope.file, empty_model

    def _search_model(self, uri: str, file: Path) -> Path | None:
        """Find the file of an included model; None if it isn't there."""
        for model_path in list_sdf_paths(uri, file, self._model_folders):
            model_file = find_model_file(model_path)
            if model_file.is_file():
                return model_file
        return None

    def _read_models(self, scope: Scope) -> None:
        """Read the models in a world or a model; Gazebo's own ground becomes a plane."""
        for element in scope.element:
            if element.tag == "population":
                name = element.get("name")
                self._warn(f"population {name!r} of {scope.file} is left out: name its models")
            elif element.tag == "include":
                uri = find_text(element, "uri")
                if _is_model(uri, GROUND_MODEL) and self._find_model(uri, scope.file) is None:
                    name = find_text(element, "name") or GROUND_MODEL
                    pose = scope.find_pose_of_element(element)
                    self._add_geom(ParsedGeom(name, name, "plane", (0.0, 0.0), pose, drawn=False))
        for model in scope.models:
            self._read_model(model)

    def _read_model(self, scope: Scope) -> None:
        self._read_models(scope)
        canonical_link = scope.find_canonical_link()
        for link in scope.element.findall("link"):
            link_name = str(link.get("name"))
            full_name = scope.make_full_name(link_name)
            has_model_name = scope.is_static or link_name == canonical_link
            body = scope.name if has_model_name else full_name
            self._body_of_link[full_name] = "" if scope.is_static else body
            if not scope.is_static:
                self._body_poses[body] = scope.find_pose(link_name)
            for element in link:
                if element.tag in ("collision", "visual"):
                    name = f"{full_name}::{element.get('name')}"
                    pose = scope.find_pose_of_element(element, link_name)
                    self._add_shape(scope, element, ParsedGeom(name, body, "", (), pose))
        if not scope.is_static:
            self._joints += [JointOfScope(scope, joint) for joint in scope.element.findall("joint")]

    # ------------------------------------------------------------ geometry

    def _add_geom(self, geom: ParsedGeom) -> None:
        self._add_to_count()
        self._parsed_scene.geoms.append(geom)

    def _add_shape(self, scope: Scope, element: Element, placed_geom: ParsedGeom) -> None:
        """Add the geometry of a ``<collision>`` or a ``<visual>`` to the scene.

        Args:
            scope: the model that contains the element.
            element: the ``<collision>`` or ``<visual>``.
            placed_geom: a geom without a shape: its name, body and pose.
        """
        is_visual = element.tag == "visual"
        geometry = element.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if geometry is None or shape is None or shape.tag == "empty":
            return
        element_text = f"{element.tag} {placed_geom.name!r} of {scope.file}"
        reader = _ShapeReader(geometry, shape, placed_geom, element_text)
        is_excluded = self._is_excluded_body(placed_geom.body) or self._is_excluded_geom(
            placed_geom.name
        )
        file = None
        if shape.tag in FILE_SHAPES:
            uri = find_text(shape, "uri")
            candidate_files = list(list_sdf_paths(uri, scope.file, self._model_folders))
            file = next(
                (candidate_file for candidate_file in candidate_files if candidate_file.is_file()),
                None,
            )
            if file is None:
                if is_excluded:
                    self._parsed_scene.empty_bodies.add(placed_geom.body)
                else:
                    self._record_missing(
                        f"{uri!r} of {element.tag} {placed_geom.name!r}", candidate_files
                    )
                return
        mesh_warnings = list[str]()
        read_mesh = partial(self._read_mesh, warnings=mesh_warnings)
        try:
            geoms = list(reader.read(file, read_mesh, is_visual=is_visual))
        except StrayMeshError as error:
            if is_excluded:
                self._parsed_scene.empty_bodies.add(placed_geom.body)
            else:
                self._warn(f"{element_text} left out: {error}")
            return
        except SceneError:
            if not is_excluded:
                raise
            self._parsed_scene.empty_bodies.add(placed_geom.body)
            return
        if not is_excluded:
            for warning in mesh_warnings:
                self._warn(warning)
        for geom in geoms:
            self._add_geom(geom._replace(collides=not is_visual, drawn=is_visual))
        if not geoms:
            self._warn(f"{element_text} left out: its <{shape.tag}> is no shape that navbake reads")

    def _read_mesh(
        self, file: Path, shape: Element, element_text: str, *, warnings: list[str]
    ) -> Mesh:
        """Read a mesh, in metres.

        The unit that a DAE states is applied, but not its up axis: Gazebo doesn't read it
        (gazebosim/gazebo-classic, issue 1305). glTF has y up.

        Args:
            file: the mesh's file.
            shape: the ``<mesh>`` element.
            element_text: the ``<collision>`` or ``<visual>``, for errors.
            warnings: the list to which warnings of the file are added, each time it is used.
        """
        submesh = find_text(shape, "submesh/name")
        is_centered = is_true(find_text(shape, "submesh/center"))
        mesh_key = MeshKey(file, submesh, is_centered)
        if mesh_key not in self._meshes:
            suffix = file.suffix.lower()
            if suffix not in MESH_SUFFIXES:
                suffixes = ", ".join(sorted(MESH_SUFFIXES))
                raise SceneError(
                    f"cannot read {file}, the mesh of {element_text}: expected {suffixes}"
                )
            up = "y" if suffix in GLTF_SUFFIXES else "z"
            file_warnings = list[str]()
            meshes = read_named_meshes(file, up, warnings=file_warnings)
            matching_meshes = [mesh for mesh in meshes if submesh in ("", mesh.name)]
            if not matching_meshes:
                names_text = ", ".join(sorted(mesh.name for mesh in meshes)[:20])
                raise SceneError(
                    f"no submesh {submesh!r} in {file}, of {element_text}: it has {names_text}"
                )
            vertices, faces = join_meshes(matching_meshes)
            if is_centered:
                vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
            self._meshes[mesh_key] = (Mesh(vertices, faces), file_warnings)
        mesh, file_warnings = self._meshes[mesh_key]
        warnings += file_warnings
        return mesh

    # ------------------------------------------------------------ joints

    def _find_body(self, scope: Scope, name: str) -> str:
        """Find the body that a link or frame belongs to.

        Args:
            scope: the world or model in which a joint uses the name.
            name: the name of the link or frame.

        Returns:
            The body's name; empty for the world and for static models.
        """
        frame_scope = scope
        frame_name = name
        for _ in range(MAX_NESTING):  # frames may be attached to frames
            if frame_name in WORLD_NAMES:
                return ""
            frame_scope, frame_name = frame_scope.resolve(frame_name)
            if not frame_name:
                if frame_scope.parent is None:
                    return ""
                frame_name = frame_scope.find_canonical_link()
                continue
            element = frame_scope.get_frame_element(frame_name)
            if element.tag == "link":
                return self._body_of_link[frame_scope.make_full_name(frame_name)]
            child = find_text(element, "child") if element.tag == "joint" else ""
            frame_name = child or element.get("attached_to", "")
        raise SceneError(f"no link {name!r} of {scope.name or 'the world'} in {scope.file}")

    def _is_in_missing_model(self, full_name: str) -> bool:
        return any(
            full_name == model or full_name.startswith(f"{model}::")
            for model in self._missing_models
        )

    def _attach(self, joint_tree: JointTree, scope: Scope, element: Element) -> None:
        """Attach the child of a ``<joint>`` to its parent."""
        name = scope.make_full_name(str(element.get("name")))
        joint_text = f"joint {name!r} of {scope.file}"
        end_names = (find_text(element, "parent"), find_text(element, "child"))
        if any(self._is_in_missing_model(scope.make_full_name(end_name)) for end_name in end_names):
            self._warn(f"{joint_text} is left out: a model that it joins is missing")
            return
        parent_body = self._find_body(scope, end_names[0])
        child_body = self._find_body(scope, end_names[1])
        joint = self._read_joint(scope, element, name, joint_text)
        if not child_body or not joint_tree.attach(parent_body, child_body, joint):
            self._warn(f"{joint_text} is left out: its bodies don't move, or hang on other joints")

    def _read_joint(
        self, scope: Scope, element: Element, name: str, joint_text: str
    ) -> ParsedJoint | None:
        """Read a ``<joint>``.

        Args:
            scope: the world or model that contains the joint.
            element: the ``<joint>``.
            name: the joint's full name.
            joint_text: the joint and its file, for messages.

        Returns:
            The joint; None if it is fixed, or of a type that navbake doesn't know.
        """
        joint_type = str(element.get("type"))
        pose = scope.find_pose(str(element.get("name")))
        axis = element.find("axis")
        if joint_type == "ball":
            return ParsedJoint(name, "ball", pose[:3, 3], np.zeros(3))
        if joint_type in (*HINGE_TYPES, "prismatic") and axis is not None:
            axis_direction = np.array(
                parse_numbers(find_text(axis, "xyz") or "0 0 1", 3, f"<xyz> of {joint_text}")
            )
            xyz = axis.find("xyz")
            axis_frame = "" if xyz is None else xyz.get("expressed_in", "")
            axis_pose = scope.find_pose(axis_frame) if axis_frame else pose
            sdf_version = _read_sdf_version(self._parse(scope.file))
            is_old = sdf_version <= LAST_VERSION_WITH_MODEL_AXES
            if is_old or is_true(find_text(axis, "use_parent_model_frame")):
                axis_pose = scope.find_pose("")
            lower_text = find_text(axis, "limit/lower") or "-1e16"
            upper_text = find_text(axis, "limit/upper") or "1e16"
            lower_limit = parse_numbers(lower_text, 1, f"<lower> of {joint_text}")[0]
            upper_limit = parse_numbers(upper_text, 1, f"<upper> of {joint_text}")[0]
            is_limited = (
                lower_limit < upper_limit
                and max(-lower_limit, upper_limit) < MAX_JOINT_LIMIT
                and joint_type != "continuous"
            )
            return ParsedJoint(
                name=name,
                kind="hinge" if joint_type in HINGE_TYPES else "slide",
                anchor=pose[:3, 3],
                axis=axis_pose[:3, :3] @ axis_direction,
                limits=(lower_limit, upper_limit) if is_limited else None,
            )
        if joint_type != "fixed":
            self._warn(f"{joint_text} is taken as fixed: its type is {joint_type}")
        return None


class _ShapeReader(NamedTuple):
    """Reads the geometry of a ``<collision>`` or a ``<visual>``.

    Attributes:
        geometry: the ``<geometry>``.
        shape: its first element, the shape.
        placed_geom: a geom without a shape: its name, body and pose.
        element_text: the ``<collision>`` or ``<visual>`` and its file, for errors.
    """

    geometry: Element
    shape: Element
    placed_geom: ParsedGeom
    element_text: str

    def read(
        self, file: Path | None, read_mesh: MeshReader, *, is_visual: bool
    ) -> list[ParsedGeom]:
        """Read the geometry.

        Args:
            file: the file of a mesh or an image; None for other shapes.
            read_mesh: a function that reads a mesh's file, see `_WorldReader._read_mesh`.
            is_visual: whether it is only drawn.

        Returns:
            The geoms; none for a shape that navbake doesn't read, or that has no volume.

        Raises:
            SceneError: the shape is broken.
        """
        shape_tag = self.shape.tag
        if shape_tag in SOLID_SIZES:
            stated_size = SOLID_SIZES[shape_tag]
            stated_values = self._numbers(stated_size.element, stated_size.num_values)
            return [
                self._geom(
                    shape_tag,
                    tuple(stated_value * stated_size.factor for stated_value in stated_values),
                )
            ]
        if shape_tag in ("cylinder", "capsule", "cone"):
            size = (self._number("radius"), self._number("length") / 2)
            if shape_tag == "cone":  # MuJoCo has no cones
                return [self._geom("mesh")._replace(mesh=tessellate("cone", size))]
            return [self._geom(shape_tag, size)]
        if shape_tag == "plane":
            return [self._read_plane(is_visual=is_visual)]
        if shape_tag == "polyline":
            return self._read_polylines()
        if file is None:
            return []
        if shape_tag == "mesh":
            mesh = read_mesh(file, self.shape, self.element_text)
            scale = np.diag([*self._numbers("scale", 3, [1.0, 1.0, 1.0]), 1.0])
            return [self._geom("mesh")._replace(mesh=mesh, pose=self.placed_geom.pose @ scale)]
        if shape_tag == "image":
            return self._read_image(file)
        height_field = read_height_field(file, self._numbers("size", 3, [1.0, 1.0, 1.0]))
        position = np.add(
            self._numbers("pos", 3, [0.0, 0.0, 0.0]), [0.0, 0.0, height_field.lowest_height]
        )
        geom = self._geom("hfield", height_field.size, position)
        return [geom._replace(heights=height_field.heights)]

    def _numbers(
        self, key: str, num_values: int, default: list[float] | None = None
    ) -> list[float]:
        if default is not None and self.shape.find(key) is None:
            return default
        return parse_numbers(
            find_text(self.shape, key), num_values, f"<{key}> of {self.element_text}"
        )

    def _number(self, key: str, default: float | None = None) -> float:
        return self._numbers(key, 1, None if default is None else [default])[0]

    def _geom(
        self,
        geom_type: str,
        size: tuple[float, ...] = (),
        position: Float | tuple[float, float, float] | None = None,
    ) -> ParsedGeom:
        """Make a geom of the ``<collision>`` or ``<visual>`` that is read.

        Args:
            geom_type: one of `GEOM_TYPES`.
            size: the size as MuJoCo states it [m].
            position: where the geom's centre is, in the frame of the ``<collision>`` or
                ``<visual>``, (3,) [m]; at its origin if None.
        """
        pose = self.placed_geom.pose.copy()
        if position is not None:
            pose[:3, 3] += pose[:3, :3] @ np.asarray(position)
        return self.placed_geom._replace(kind=geom_type, size=size, pose=pose)

    def _read_plane(self, *, is_visual: bool) -> ParsedGeom:
        normal = np.array(self._numbers("normal", 3, [0.0, 0.0, 1.0]))
        pose = self.placed_geom.pose.copy()
        pose[:3, :3] = pose[:3, :3] @ make_rotation_to_z_up(normal).T
        # A plane that collides is endless; only one that is drawn has a size.
        side_lengths = self._numbers("size", 2, [0.0, 0.0]) if is_visual else [0.0, 0.0]
        return self.placed_geom._replace(
            kind="plane", size=(side_lengths[0] / 2, side_lengths[1] / 2), pose=pose
        )

    def _read_polylines(self) -> list[ParsedGeom]:
        height = self._number("height", 1.0)
        outlines = list[Float]()
        for polyline in self.geometry.findall("polyline"):
            points = [
                parse_numbers((point.text or "").strip(), 2, f"<point> of {self.element_text}")
                for point in polyline.findall("point")
            ]
            if points:
                outlines.append(np.array(points))
        try:
            prisms = extrude_outlines(outlines, height) if outlines else []
        except ValueError as error:
            raise SceneError(f"cannot extrude {self.element_text}: {error}") from error
        return [self._geom("mesh")._replace(mesh=prism, mode="hull") for prism in prisms]

    def _read_image(self, file: Path) -> list[ParsedGeom]:
        half_height = self._number("height", 1.0) / 2
        boxes = read_image_boxes(file, self._number("scale", 1.0), self._number("threshold", 200.0))
        return [
            self._geom("box", (*box.half_sizes, half_height), (*box.center, half_height))
            for box in boxes
        ]


def parse_sdf(file: Path) -> Element:
    """Parse an SDF file, and return its ``<sdf>`` element, the root.

    Args:
        file: the file.

    Raises:
        SceneError: the XML is broken, or no SDF.
    """
    try:
        root = parse_xml(file.read_bytes())
    except ValueError as error:
        raise SceneError(f"broken XML in {file}: {error}") from error
    if root.tag != "sdf":
        raise SceneError(f"expected <sdf> in {file}, got <{root.tag[:40]}>")
    return root


def _read_sdf_version(root: Element) -> tuple[int, ...]:
    """Return the version of SDF that a file states; (2,), later than all, if it states none."""
    return parse_sdf_version(root.get("version")) or (2,)


def _model_name(uri: str) -> str:
    """Return the name of the model that an address names."""
    fuel_file = parse_fuel_address(uri)
    if fuel_file is not None and not fuel_file.path:
        return fuel_file.name
    return Path(uri.partition("://")[2] or uri).name


def _is_model(uri: str, name: str) -> bool:
    """Return whether an address names one of the models that come with Gazebo."""
    return is_same_model_name(_model_name(uri), name)


MeshReader = Callable[[Path, Element, str], Mesh]
"""A function: file, ``<mesh>`` element, where that is -> the mesh."""
