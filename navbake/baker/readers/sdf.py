"""Reads worlds and models of Gazebo (SDF): collisions, visuals, and joints of links.

A ``<collision>`` becomes a geom that collides and isn't drawn, a ``<visual>`` one that is drawn and
doesn't collide. Lights, plugins, sensors and populations are not read. Meshes count by their
triangles, as in Gazebo. A static model is one body with the model's name. In other models, the
canonical link is a body with the model's name, and each further link is a body ``model::link``.

Source: SDFormat specification 1.12, sdformat.org.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navbake.baker.geometry.shapes import Mesh, tessellate
from navbake.baker.readers.mesh import (
    MESH_SUFFIXES,
    file_up_axis,
    join_meshes,
    read_named_meshes,
    rotation_to_z_up,
)
from navbake.baker.readers.parsed_scene import (
    JointTree,
    ParsedGeom,
    ParsedJoint,
    ParsedScene,
    check_count,
)
from navbake.baker.readers.sdf_frames import (
    WORLD_NAMES,
    Element,
    Scope,
    is_true,
    numbers_of,
    text_of,
)
from navbake.config.settings import SceneSettings
from navbake.errors import FormatError, SceneError
from navbake.formats.scene_files import find_model_file, list_sdf_paths
from navbake.formats.source import read_pixels
from navbake.types import Float

HEIGHT_FIELD_BASE = 0.1  # thickness of a height field below its lowest point [m]
MIN_HEIGHT_RANGE = 1e-6  # least difference between a height field's highest and lowest point [m]
# A joint with a larger limit counts as unlimited; SDF writes 1e16 for no limit [m or rad]
MAX_JOINT_LIMIT = 1e10
HINGE_TYPES = ("revolute", "continuous")
MAX_NESTING = 50  # levels of models in models, and of frames attached to frames
# The last version of SDF whose joint axes are in the frame of the model
LAST_VERSION_WITH_MODEL_AXES = (1, 4)
# Models that come with Gazebo: they need not be found
SUN_MODEL = "sun"
GROUND_MODEL = "ground_plane"


class SolidSize(NamedTuple):
    """How SDF states the size of a kind of solid.

    Attributes:
        element: the name of the XML element with the values.
        num_values: the number of values in the element.
        factor: what the values are multiplied by to be MuJoCo's sizes.
    """

    element: str
    num_values: int
    factor: float


SOLID_SIZES = {
    "box": SolidSize("size", 3, 0.5),
    "sphere": SolidSize("radius", 1, 1.0),
    "ellipsoid": SolidSize("radii", 3, 1.0),
}


class HeightField(NamedTuple):
    """A height field that is read from an image.

    Attributes:
        heights: the heights, scaled to 0 to 1; row 0 is at the smallest y.
        size: the size as MuJoCo states it: half of the width, half of the depth, the difference
            between the highest and lowest point, and the thickness of the base [m].
        lowest: the lowest height [m].
    """

    heights: Float
    size: tuple[float, float, float, float]
    lowest: float


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
    """A ``<joint>``, and the scope of the world or model that contains it."""

    scope: Scope
    element: Element


def read_world(path: Path, settings: SceneSettings) -> ParsedScene:
    """Read the first world of an .sdf or .world file; if it has none, the models in the file.

    A missing file of a mesh or height field is an error if the geom collides, and a warning if it
    is only drawn. `navbake.formats.scene_files.list_sdf_paths` lists where models are searched for.

    Args:
        path: the file.
        settings: `scene.model_path` is used: folders with models.

    Returns:
        The parsed scene.

    Raises:
        SceneError: the file, or a model in it, is missing or broken.
    """
    return _WorldReader(path, settings).read()


class _WorldReader:
    """Reads a file, and the files that it includes."""

    def __init__(self, path: Path, settings: SceneSettings) -> None:
        self._path = path
        self._model_folders = settings.model_path
        self._parsed_scene = ParsedScene()
        # Name -> world pose, of bodies that may move
        self._body_poses: dict[str, Float] = {}
        # Full name of a link -> name of its body; empty if its model is static
        self._body_of_link: dict[str, str] = {}
        self._joints: list[JointOfScope] = []
        self._meshes: dict[MeshKey, Mesh] = {}
        self._parse = cache(parse_sdf)
        self._find_model = cache(self._search_model)
        self._count = 0  # models and geoms so far

    def read(self) -> ParsedScene:
        """Read the world with all models in it."""
        root = self._parse(self._path)
        worlds = root.findall("world")
        if len(worlds) > 1:
            self._warn(f"{len(worlds)} worlds in {self._path}: the first one is taken")
        element = worlds[0] if worlds else root
        world = Scope(self._find_models, element, element, self._path, None)
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
        return self._parsed_scene

    def _warn(self, text: str) -> None:
        self._parsed_scene.warnings.append(text)

    # ------------------------------------------------------------ models

    def _add_to_count(self) -> None:
        self._count += 1
        check_count(self._count, self._path)

    def _find_models(self, scope: Scope) -> list[Scope]:
        """List the models directly in a world or a model, in their order in the file."""
        if scope.depth > MAX_NESTING:
            raise SceneError(f"{scope.file} includes itself, by model {scope.name!r}")
        models = []
        for element in scope.element:
            file: Path | None = scope.file
            model = element if element.tag == "model" else None
            if element.tag == "include":
                file = self._find_model(text_of(element, "uri"), scope.file)
                model = None if file is None else self._parse(file).find("model")
            if model is not None and file is not None:
                self._add_to_count()
                models.append(Scope(self._find_models, model, element, file, scope))
        return models

    def _search_model(self, uri: str, file: Path) -> Path | None:
        """Find the file of an included model; None if it isn't found, but comes with Gazebo."""
        places = list(list_sdf_paths(uri, file, self._model_folders))
        for place in places:
            candidate = find_model_file(place)
            if candidate.is_file():
                return candidate
        if _model_name(uri) not in (SUN_MODEL, GROUND_MODEL):
            raise _not_found_error(f"{uri!r} of {file}", places)
        return None

    def _read_models(self, scope: Scope) -> None:
        """Read the models in a world or a model; Gazebo's own ground becomes a plane."""
        for element in scope.element:
            if element.tag == "population":
                name = element.get("name")
                self._warn(f"population {name!r} of {scope.file} is left out: name its models")
            elif element.tag == "include":
                uri = text_of(element, "uri")
                if _model_name(uri) == GROUND_MODEL and self._find_model(uri, scope.file) is None:
                    text = "taken as Gazebo's own, endless ground"
                    self._warn(f"{uri} of {scope.file} not found: {text}")
                    name = text_of(element, "name") or GROUND_MODEL
                    pose = scope.pose_of_element(element)
                    self._add_geom(ParsedGeom(name, name, "plane", (0.0, 0.0), pose, drawn=False))
        for model in scope.models:
            self._read_model(model)

    def _read_model(self, scope: Scope) -> None:
        self._read_models(scope)
        canonical_link = scope.canonical_link()
        for link in scope.element.findall("link"):
            link_name = str(link.get("name"))
            full_name = scope.full_name(link_name)
            has_model_name = scope.is_static or link_name == canonical_link
            body = scope.name if has_model_name else full_name
            self._body_of_link[full_name] = "" if scope.is_static else body
            if not scope.is_static:
                self._body_poses[body] = scope.pose_of(link_name)
            for element in link:
                if element.tag in ("collision", "visual"):
                    name = f"{full_name}::{element.get('name')}"
                    pose = scope.pose_of_element(element, link_name)
                    self._read_shape(scope, element, name, body, pose)
        if not scope.is_static:
            self._joints += [JointOfScope(scope, joint) for joint in scope.element.findall("joint")]

    # ------------------------------------------------------------ geometry

    def _add_geom(self, geom: ParsedGeom) -> None:
        self._add_to_count()
        self._parsed_scene.geoms.append(geom)

    def _read_shape(
        self, scope: Scope, element: Element, name: str, body: str, pose: Float
    ) -> None:
        """Read the geometry of a ``<collision>`` or a ``<visual>``.

        Args:
            scope: the model that contains the element.
            element: the ``<collision>`` or ``<visual>``.
            name: the geom's name.
            body: the name of the geom's body.
            pose: from the element's frame to the world, (4, 4) [m].
        """
        is_visual = element.tag == "visual"
        geometry = element.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None or shape.tag == "empty":
            return
        where = f"{element.tag} {name!r} of {scope.file}"

        def numbers(key: str, count: int = 1, default: list[float] | None = None) -> list[float]:
            if default is not None and shape.find(key) is None:
                return default
            return numbers_of(text_of(shape, key), count, f"<{key}> of {where}")

        mesh = None
        heights = None
        size = tuple[float, ...]()
        kind = shape.tag
        if kind in SOLID_SIZES:
            stated_size = SOLID_SIZES[kind]
            values = numbers(stated_size.element, stated_size.num_values)
            size = tuple(value * stated_size.factor for value in values)
        elif kind in ("cylinder", "capsule"):
            size = (numbers("radius")[0], numbers("length")[0] / 2)
        elif kind == "cone":  # MuJoCo has no cones
            mesh = tessellate("cone", (numbers("radius")[0], numbers("length")[0] / 2))
            kind = "mesh"
        elif kind == "plane":
            normal = np.array(numbers("normal", 3, [0.0, 0.0, 1.0]))
            pose = pose.copy()
            pose[:3, :3] = pose[:3, :3] @ rotation_to_z_up(normal).T
            # A plane that collides is endless; only one that is drawn has a size.
            sides = numbers("size", 2, [0.0, 0.0]) if is_visual else [0.0, 0.0]
            size = (sides[0] / 2, sides[1] / 2)
        elif kind in ("mesh", "heightmap"):
            uri = text_of(shape, "uri")
            file = self._find_file(uri, scope.file, where, is_required=not is_visual)
            if file is None:
                return
            if kind == "mesh":
                mesh = self._read_mesh(file, shape, where)
                pose = pose @ np.diag([*numbers("scale", 3, [1.0, 1.0, 1.0]), 1.0])
            else:
                kind = "hfield"
                position = numbers("pos", 3, [0.0, 0.0, 0.0])
                height_field = _read_heights(file, numbers("size", 3, [1.0, 1.0, 1.0]))
                heights = height_field.heights
                size = height_field.size
                pose = pose.copy()
                pose[:3, 3] += pose[:3, :3] @ np.add(position, [0.0, 0.0, height_field.lowest])
        else:
            self._warn(f"{where} left out: its geometry is <{kind}>")
            return
        self._add_geom(
            ParsedGeom(
                name=name,
                body=body,
                kind=kind,
                size=size,
                pose=pose,
                mesh=mesh,
                heights=heights,
                collides=not is_visual,
                drawn=is_visual,
            )
        )

    def _find_file(self, uri: str, file: Path, where: str, *, is_required: bool) -> Path | None:
        """Find the file of a mesh or image.

        Args:
            uri: the file as the scene names it.
            file: the file of the scene or model that names it.
            where: the element that names it, for messages.
            is_required: whether a missing file is an error; else it is a warning.

        Returns:
            The file; None if it is missing and not required.
        """
        places = list(list_sdf_paths(uri, file, self._model_folders))
        for place in places:
            if place.is_file():
                return place
        if is_required:
            raise _not_found_error(f"{uri!r} of {where}", places)
        self._warn(f"{uri!r} of {where} not found: left out, as it is only drawn")
        return None

    def _read_mesh(self, file: Path, shape: Element, where: str) -> Mesh:
        """Read a mesh, in metres with z up.

        The unit and up axis that a DAE states are applied; glTF has y up. All other files are taken
        to be in metres with z up.

        Args:
            file: the mesh's file.
            shape: the ``<mesh>`` element.
            where: the ``<collision>`` or ``<visual>``, for errors.
        """
        submesh = text_of(shape, "submesh/name")
        is_centered = is_true(text_of(shape, "submesh/center"))
        key = MeshKey(file, submesh, is_centered)
        if key not in self._meshes:
            if file.suffix.lower() not in MESH_SUFFIXES:
                suffixes = ", ".join(sorted(MESH_SUFFIXES))
                raise SceneError(f"cannot read {file}, the mesh of {where}: expected {suffixes}")
            meshes = read_named_meshes(file, file_up_axis(file) or "z")
            matching = [mesh for mesh in meshes if submesh in ("", mesh.name)]
            if not matching:
                listed = ", ".join(sorted(mesh.name for mesh in meshes)[:20])
                raise SceneError(f"no submesh {submesh!r} in {file}, of {where}: it has {listed}")
            vertices, faces = join_meshes(matching)
            if is_centered:
                vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
            self._meshes[key] = Mesh(vertices, faces)
        return self._meshes[key]

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
                frame_name = frame_scope.canonical_link()
                continue
            element = frame_scope.frame(frame_name)
            if element.tag == "link":
                return self._body_of_link[frame_scope.full_name(frame_name)]
            child = text_of(element, "child") if element.tag == "joint" else ""
            frame_name = child or element.get("attached_to", "")
        raise SceneError(f"no link {name!r} of {scope.name or 'the world'} in {scope.file}")

    def _attach(self, joint_tree: JointTree, scope: Scope, element: Element) -> None:
        """Attach the child of a ``<joint>`` to its parent."""
        name = scope.full_name(str(element.get("name")))
        parent = self._find_body(scope, text_of(element, "parent"))
        child = self._find_body(scope, text_of(element, "child"))
        where = f"joint {name!r} of {scope.file}"
        joint = self._read_joint(scope, element, name, where)
        if not child or not joint_tree.attach(parent, child, joint):
            self._warn(f"{where} is left out: its bodies don't move, or hang on other joints")

    def _read_joint(
        self, scope: Scope, element: Element, name: str, where: str
    ) -> ParsedJoint | None:
        """Read a ``<joint>``.

        Args:
            scope: the world or model that contains the joint.
            element: the ``<joint>``.
            name: the joint's full name.
            where: the joint and its file, for messages.

        Returns:
            The joint; None if it is fixed, or of a type that navbake doesn't know.
        """
        kind = str(element.get("type"))
        pose = scope.pose_of(str(element.get("name")))
        axis = element.find("axis")
        if kind == "ball":
            return ParsedJoint(name, "ball", pose[:3, 3], np.zeros(3))
        if kind in (*HINGE_TYPES, "prismatic") and axis is not None:
            direction = np.array(
                numbers_of(text_of(axis, "xyz") or "0 0 1", 3, f"<xyz> of {where}")
            )
            xyz = axis.find("xyz")
            axis_frame = "" if xyz is None else xyz.get("expressed_in", "")
            axis_pose = scope.pose_of(axis_frame) if axis_frame else pose
            version = _version_of(self._parse(scope.file))
            is_old = version <= LAST_VERSION_WITH_MODEL_AXES
            if is_old or is_true(text_of(axis, "use_parent_model_frame")):
                axis_pose = scope.pose_of("")
            lower_text = text_of(axis, "limit/lower") or "-1e16"
            upper_text = text_of(axis, "limit/upper") or "1e16"
            low = numbers_of(lower_text, 1, f"<lower> of {where}")[0]
            high = numbers_of(upper_text, 1, f"<upper> of {where}")[0]
            is_limited = low < high and max(-low, high) < MAX_JOINT_LIMIT and kind != "continuous"
            return ParsedJoint(
                name=name,
                kind="hinge" if kind in HINGE_TYPES else "slide",
                anchor=pose[:3, 3],
                axis=axis_pose[:3, :3] @ direction,
                limits=(low, high) if is_limited else None,
            )
        if kind != "fixed":
            self._warn(f"{where} is taken as fixed: its type is {kind}")
        return None


def parse_sdf(file: Path) -> Element:
    """Parse an XML file, and return its ``<sdf>`` element.

    Raises:
        SceneError: the XML is broken, or no SDF.
    """
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise SceneError(f"broken XML in {file}: {error}") from error
    if root.tag != "sdf":
        raise SceneError(f"expected <sdf> in {file}, got <{root.tag[:40]}>")
    return root


def _version_of(root: Element) -> tuple[int, ...]:
    """Return the version of SDF that a file states; (2,), later than all, if it states none."""
    words = (root.get("version") or "").split(".")
    return tuple(map(int, words)) if all(word.isdecimal() for word in words) else (2,)


def _model_name(uri: str) -> str:
    return Path(uri.partition("://")[2] or uri).name


def _read_heights(file: Path, sides: list[float]) -> HeightField:
    """Read a height field from an image: the brighter a pixel, the higher the ground.

    The first row of pixels is at the largest y.

    Args:
        file: the image.
        sides: the height field's width, depth and height, which is that of the brightest pixel [m].
    """
    try:
        brightness = read_pixels(file).light[::-1].astype(np.float64)
    except FormatError as error:
        raise SceneError(str(error)) from error
    brightness /= max(float(brightness.max()), 1.0)
    low = float(brightness.min())
    high = float(brightness.max())
    height_range = max((high - low) * sides[2], MIN_HEIGHT_RANGE)
    return HeightField(
        heights=(brightness - low) / ((high - low) or 1.0),
        size=(sides[0] / 2, sides[1] / 2, height_range, HEIGHT_FIELD_BASE),
        lowest=low * sides[2],
    )


def _not_found_error(item: str, places: list[Path]) -> SceneError:
    """Make the error that says in which places a file or model was searched for, in vain."""
    folders = list(dict.fromkeys(str(place) for place in places))
    listed = ", ".join(folders[:4]) + (", …" if len(folders) > 4 else "")
    existing_folder = next((place for place in places if place.is_dir()), None)
    hint = ""
    if existing_folder is not None:
        hint = f" ({existing_folder} has no {find_model_file(existing_folder).name})"
    return SceneError(
        f"{item} not found in {listed}{hint}: name the folder that holds it by `--model-path`, "
        "`scene.model_path` or GZ_SIM_RESOURCE_PATH"
    )
