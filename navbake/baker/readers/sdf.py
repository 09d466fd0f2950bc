"""Reads worlds and models of Gazebo (SDF) as pieces: collisions, visuals, and joints of links.

Collisions collide and aren't drawn, visuals are drawn and don't collide. Lights, plugins, sensors
and populations are passed by. Meshes count by their triangles, as Gazebo collides them. A static
model is one body by its name; of others, the canonical link has the model's name, and further ones
are called ``model::link``.

Source: SDFormat specification 1.12, sdformat.org.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path
from typing import Any

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
    WORLD,
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

BASE = 0.1  # of a height field, below its lowest point [m]
FLAT = 1e-6  # the least height of one [m]
ENDLESS = 1e10  # of a joint's limits, which SDF states as 1e16 [m or rad]
# Of solids: the element with the numbers of their size, how many, and times what they are MuJoCo's
SOLIDS = {"box": ("size", 3, 0.5), "sphere": ("radius", 1, 1.0), "ellipsoid": ("radii", 3, 1.0)}
HINGES = ("revolute", "continuous")
MOST_NESTED = 50  # models in models
LAST_IN_MODEL = 1, 4  # the last version of SDF whose axes are in the frame of the model
# Models that come with Gazebo itself, where they aren't found
SUN = "sun"
GROUND = "ground_plane"


def read_world(path: Path, settings: SceneSettings) -> ParsedScene:
    """Read the first world of an .sdf or .world file, or its models.

    A mesh or height field that is missing is an error where it collides, and a warning where it is
    only drawn; models are looked for as `navbake.formats.scene_files.list_sdf_paths` says.

    Raises:
        SceneError: the file, or a model in it, is missing or broken.
    """
    return _Reader(path, settings).read()


class _Reader:
    def __init__(self, path: Path, settings: SceneSettings) -> None:
        self._path = path
        self._folders = settings.model_path
        self._result = ParsedScene()
        self._poses: dict[str, Float] = {}  # of bodies that may move
        self._bodies: dict[str, str] = {}  # by link with its scope's names, its body
        self._joints: list[tuple[Scope, Element]] = []
        self._meshes: dict[Any, Mesh] = {}
        self._parse = cache(parse_sdf)
        self._find_model = cache(self._search_model)
        self._count = 0  # of models and pieces

    def read(self) -> ParsedScene:
        root = self._parse(self._path)
        worlds = root.findall("world")
        if len(worlds) > 1:
            self._warn(f"{len(worlds)} worlds in {self._path}: the first one is taken")
        element = worlds[0] if worlds else root
        world = Scope(self.find_models, element, element, self._path, None)
        if world.element.find("state/model") is not None:
            self._warn(
                f"<state> of {self._path} is passed by, as in today's Gazebo; Gazebo classic "
                "places models by it"
            )
        self._read_inner(world)
        self._joints += [(world, joint) for joint in world.element.findall("joint")]
        ties = JointTree(self._poses)
        for scope, element in self._joints:
            self._tie(ties, scope, element)
        self._result.bodies = ties.make_bodies()
        return self._result

    def _warn(self, text: str) -> None:
        self._result.warnings.append(text)

    # ------------------------------------------------------------ models

    def _add_to_count(self) -> None:
        self._count += 1
        check_count(self._count, self._path)

    def find_models(self, scope: Scope) -> list[Scope]:
        """The models in a world or a model, in order."""
        if scope.depth > MOST_NESTED:
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
                models.append(Scope(self.find_models, model, element, file, scope))
        return models

    def _search_model(self, uri: str, file: Path) -> Path | None:
        """The file of an included model; None where Gazebo has it itself."""
        places = list(list_sdf_paths(uri, file, self._folders))
        found = next((one for one in map(find_model_file, places) if one.is_file()), None)
        if found is None and _model_name(uri) not in (SUN, GROUND):
            raise _not_found(f"{uri!r} of {file}", places)
        return found

    def _read_inner(self, scope: Scope) -> None:
        """Read the models in a world or a model."""
        for element in scope.element:
            if element.tag == "population":
                name = element.get("name")
                self._warn(f"population {name!r} of {scope.file} is left out: name its models")
            elif element.tag == "include":
                uri = text_of(element, "uri")
                if _model_name(uri) == GROUND and self._find_model(uri, scope.file) is None:
                    text = "taken as Gazebo's own, endless ground"
                    self._warn(f"{uri} of {scope.file} not found: {text}")
                    name = text_of(element, "name") or GROUND
                    pose = scope.place(element)
                    self._add(name, name, "plane", (0.0, 0.0), pose, is_visual=False)
        for model in scope.models:
            self._read_model(model)

    def _read_model(self, scope: Scope) -> None:
        self._read_inner(scope)
        first = scope.canonical()
        for link in scope.element.findall("link"):
            own = str(link.get("name"))
            name = scope.full(own)
            body = scope.name if scope.is_static or own == first else name
            self._bodies[name] = "" if scope.is_static else body
            if not scope.is_static:
                self._poses[body] = scope.pose_of(own)
            for element in link:
                if element.tag in ("collision", "visual"):
                    shape = f"{name}::{element.get('name')}"
                    self._read_shape(scope, element, shape, body, scope.place(element, own))
        if not scope.is_static:
            self._joints += [(scope, joint) for joint in scope.element.findall("joint")]

    # ------------------------------------------------------------ geometry

    def _add(
        self, name: str, body: str, kind: str, size: tuple[float, ...], pose: Float,
        mesh: Mesh | None = None, heights: Float | None = None, *, is_visual: bool,
    ) -> None:  # fmt: skip
        shape = kind, size, pose, mesh, heights
        self._add_to_count()
        self._result.pieces.append(
            ParsedGeom(name, body, *shape, "surface", collides=not is_visual, drawn=is_visual)
        )

    def _read_shape(
        self, scope: Scope, element: Element, name: str, body: str, pose: Float
    ) -> None:
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
        if kind in SOLIDS:
            key, count, share = SOLIDS[kind]
            size = tuple(value * share for value in numbers(key, count))
        elif kind in ("cylinder", "capsule", "cone"):
            size = numbers("radius")[0], numbers("length")[0] / 2
            if kind == "cone":
                kind, size, mesh = "mesh", (), tessellate(kind, size)
        elif kind == "plane":
            turn = rotation_to_z_up(np.array(numbers("normal", 3, [0.0, 0.0, 1.0]))).T
            pose = pose.copy()
            pose[:3, :3] = pose[:3, :3] @ turn
            # what collides is endless, what is drawn has a size
            sides = numbers("size", 2, [0.0, 0.0]) if is_visual else [0.0, 0.0]
            size = sides[0] / 2, sides[1] / 2
        elif kind in ("mesh", "heightmap"):
            file = self._find(text_of(shape, "uri"), scope.file, where, is_drawn=is_visual)
            if file is None:
                return
            if kind == "mesh":
                mesh = self._read_mesh(file, shape, where)
                pose = pose @ np.diag([*numbers("scale", 3, [1.0] * 3), 1.0])
            else:
                kind = "hfield"
                shift = numbers("pos", 3, [0.0] * 3)
                heights, size, lift = _read_heights(file, numbers("size", 3, [1.0] * 3))
                pose = pose.copy()
                pose[:3, 3] += pose[:3, :3] @ np.add(shift, [0.0, 0.0, lift])
        else:
            self._warn(f"{where} left out: its geometry is <{kind}>")
            return
        self._add(name, body, kind, size, pose, mesh, heights, is_visual=is_visual)

    def _find(self, uri: str, file: Path, where: str, *, is_drawn: bool) -> Path | None:
        """The file of a mesh or image; None, with a warning, for a missing one that is drawn."""
        places = list(list_sdf_paths(uri, file, self._folders))
        found = next((place for place in places if place.is_file()), None)
        if found is None and is_drawn:
            self._warn(f"{uri!r} of {where} not found: left out, as it is only drawn")
        elif found is None:
            raise _not_found(f"{uri!r} of {where}", places)
        return found

    def _read_mesh(self, file: Path, shape: Element, where: str) -> Mesh:
        """A mesh in metres, z up: a DAE by its own unit and axis, glTF y up, others as they are."""
        submesh = text_of(shape, "submesh/name")
        is_centered = is_true(text_of(shape, "submesh/center"))
        key = file, submesh, is_centered
        if key not in self._meshes:
            if file.suffix.lower() not in MESH_SUFFIXES:
                known = ", ".join(sorted(MESH_SUFFIXES))
                raise SceneError(f"cannot read {file}, the mesh of {where}: expected {known}")
            parts = read_named_meshes(file, file_up_axis(file) or "z")
            named = [part for part in parts if submesh in ("", part.name)]
            if not named:
                listed = ", ".join(sorted(part.name for part in parts)[:20])
                raise SceneError(f"no submesh {submesh!r} in {file}, of {where}: it has {listed}")
            vertices, faces = join_meshes(named)
            if is_centered:
                vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
            self._meshes[key] = Mesh(vertices, faces)
        return self._meshes[key]

    # ------------------------------------------------------------ joints

    def _body_of(self, scope: Scope, name: str) -> str:
        """The body that a joint's end belongs to, by a link's or a frame's name; empty for none."""
        at = scope
        end = name
        for _ in range(MOST_NESTED):  # frames may be attached to frames
            if end in WORLD:
                return ""
            at, end = at.resolve(end)
            if not end:
                if at.above is None:
                    return ""
                end = at.canonical()
                continue
            element = at.frame(end)
            if element.tag == "link":
                return self._bodies[at.full(end)]
            end = text_of(element, "child") if element.tag == "joint" else ""
            end = end or element.get("attached_to", "")
        raise SceneError(f"no link {name!r} of {scope.name or 'the world'} in {scope.file}")

    def _tie(self, ties: JointTree, scope: Scope, element: Element) -> None:
        kind = str(element.get("type"))
        name = scope.full(str(element.get("name")))
        parent = self._body_of(scope, text_of(element, "parent"))
        child = self._body_of(scope, text_of(element, "child"))
        where = f"joint {name!r} of {scope.file}"
        joint = None
        place = scope.pose_of(str(element.get("name")))
        axis = element.find("axis")
        if kind == "ball":
            joint = ParsedJoint(name, "ball", place[:3, 3], np.zeros(3))
        elif kind in (*HINGES, "prismatic") and axis is not None:
            xyz = axis.find("xyz")
            way = np.array(numbers_of(text_of(axis, "xyz") or "0 0 1", 3, f"<xyz> of {where}"))
            frame = "" if xyz is None else xyz.get("expressed_in", "")
            turn = scope.pose_of(frame) if frame else place
            is_old = _version_of(self._parse(scope.file)) <= LAST_IN_MODEL
            if is_old or is_true(text_of(axis, "use_parent_model_frame")):
                turn = scope.pose_of("")
            low = numbers_of(
                text_of(axis, f"limit/{'lower'}") or "-1e16", 1, f"<{'lower'}> of {where}"
            )[0]
            high = numbers_of(
                text_of(axis, f"limit/{'upper'}") or "1e16", 1, f"<{'upper'}> of {where}"
            )[0]
            is_limited = low < high and max(-low, high) < ENDLESS and kind != "continuous"
            limits = (low, high) if is_limited else None
            kind = "hinge" if kind in HINGES else "slide"
            joint = ParsedJoint(name, kind, place[:3, 3], turn[:3, :3] @ way, limits)
        elif kind != "fixed":
            self._warn(f"{where} is taken as fixed: its type is {kind}")
        if not child or not ties.tie(parent, child, joint):
            self._warn(f"{where} is left out: its bodies don't move, or hang on other joints")


def parse_sdf(file: Path) -> Element:
    """The <sdf> element of a file."""
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise SceneError(f"broken XML in {file}: {error}") from error
    if root.tag != "sdf":
        raise SceneError(f"expected <sdf> in {file}, got <{root.tag[:40]}>")
    return root


def _version_of(root: Element) -> tuple[int, ...]:
    """The version of SDF that a file is in; the latest where it says none."""
    words = (root.get("version") or "").split(".")
    return tuple(map(int, words)) if all(word.isdecimal() for word in words) else (2,)


def _model_name(uri: str) -> str:
    return Path(uri.partition("://")[2] or uri).name


def _read_heights(file: Path, sides: list[float]) -> tuple[Float, tuple[float, ...], float]:
    """A height field of an image: heights from 0 to 1, MuJoCo's size, and its lowest height [m].

    The brightest pixel is as high as `sides` say; the first row of pixels is at the largest y.
    """
    try:
        light = read_pixels(file).light[::-1].astype(np.float64)
    except FormatError as error:
        raise SceneError(str(error)) from error
    light /= max(float(light.max()), 1.0)
    low = float(light.min())
    high = float(light.max())
    rise = max((high - low) * sides[2], FLAT)
    heights = (light - low) / ((high - low) or 1.0)
    return heights, (sides[0] / 2, sides[1] / 2, rise, BASE), low * sides[2]


def _not_found(what: str, places: list[Path]) -> SceneError:
    """The error of a file or model that is in none of its possible places."""
    folders = list(dict.fromkeys(str(place) for place in places))
    listed = ", ".join(folders[:4]) + (", …" if len(folders) > 4 else "")
    folder = next((place for place in places if place.is_dir()), None)
    empty = "" if folder is None else f" ({folder} has no {find_model_file(folder).name})"
    return SceneError(
        f"{what} not found in {listed}{empty}: name the folder that holds it by `--model-path`, "
        "`scene.model_path` or GZ_SIM_RESOURCE_PATH"
    )
