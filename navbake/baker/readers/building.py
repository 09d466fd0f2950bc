"""Reads buildings of Open-RMF's traffic editor (``.building.yaml``) as parsed scenes.

Walls, floors with their holes, doors and lifts get the sizes that rmf_building_map_tools gives them
for simulators: walls are 2.5 m high and 0.1 m thick, floors 0.1 m thick, doors 2.2 m high.
Fiducials (points that several levels have in common) align the levels with each other. Buildings in
WGS84 are projected as the editor's tools do it. Furniture (`models`) has no geometry in the file
and is left out. Of a lift, only the car is read, which moves between the floors; its doors are left
out.

Source: open-rmf/rmf_traffic_editor, ``rmf_building_map_tools/building_map``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.baker.geometry.shapes import Mesh
from navbake.baker.readers.parsed_scene import (
    ParsedBody,
    ParsedGeom,
    ParsedJoint,
    ParsedScene,
    convert_read_errors,
)
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, SceneError
from navbake.formats.source import import_extra
from navbake.lazy import lazy
from navbake.types import Float, Json
from navbake.yaml_text import decode_yaml

shapely = lazy("shapely")  # of the extra [convert]

MAX_FIDUCIALS = 500  # that a level shares with the reference level; each two make a line
# The file has lines only; these are the sizes that simulators give them [m]
WALL_THICKNESS = 0.1
WALL_HEIGHT = 2.5
FLOOR_THICKNESS = 0.1
DOOR_THICKNESS = 0.03
DOOR_HEIGHT = 2.2
DOOR_GAP = 0.01  # the free space round a door leaf
CAR_WALL_THICKNESS = 0.05
CAR_FLOOR_THICKNESS = 0.05
CAR_HEIGHT = 2.5
CAR_GAP = 0.05  # the free space between a lift's car and its shaft
SLIDING_DOORS = ("sliding", "double_sliding", "telescopic", "double_telescopic")
HINGED_DOORS = ("hinged", "double_hinged")
COORDINATE_SYSTEMS = ("reference_image", "cartesian_meters", "wgs84")
KILOMETRE = 1000.0  # [m]


class PlanTransform(NamedTuple):
    """Maps a level's plan to the world: a point p = x + iy becomes factor * p + shift.

    Attributes:
        factor: the rotation and the scale, as a complex number [m per unit of the plan].
        shift: the translation, as a complex number x + iy [m].
    """

    factor: complex
    shift: complex


class Projection(NamedTuple):
    """Maps longitude and latitude [degrees, WGS84] to the world.

    Attributes:
        transformer: pyproj's transformer, which returns easting and northing [m].
        offset: easting and northing of the world's origin, as a complex number [m].
    """

    transformer: Any
    offset: complex

    def project(self, points: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Project points from longitude + i latitude [degrees] to x + iy in the world [m]."""
        easting, northing = self.transformer.transform(points.real, points.imag)
        world_points = np.asarray(easting) + 1j * np.asarray(northing) - self.offset
        if not np.isfinite(world_points).all():
            raise SceneError("expected longitude and latitude [degrees] in the area of the CRS")
        return world_points


class DoorLeaf(NamedTuple):
    """One leaf of a door.

    Attributes:
        name: the leaf's name.
        side: 1 if the leaf is at the start of the door, -1 if it is at the door's end.
        width: the leaf's width [m].
    """

    name: str
    side: int
    width: float


class CarWall(NamedTuple):
    """A wall of a lift's car, seen from above: its position and size in the car's frame.

    Attributes:
        middle: x and y of its centre [m].
        half_size: half of its size along x and y [m].
    """

    middle: tuple[float, float]
    half_size: tuple[float, float]


def read_building(path: Path, settings: SceneSettings) -> ParsedScene:
    """Read a building: its floors, walls, doors and lifts.

    Args:
        path: the file.
        settings: unused, but all readers have this argument.

    Returns:
        The parsed scene.

    Raises:
        SceneError: the file is no building, refers to a missing vertex, or has no scale.
        MissingDependencyError: shapely is not installed.
    """
    try:
        content = decode_yaml(path.read_bytes(), str(path))
    except ConfigError as error:
        raise SceneError(str(error), path=str(path), place=error.place) from error
    if not isinstance(content, dict) or not isinstance(content.get("levels"), dict):
        raise SceneError(f"no building in {path}: expected `levels`, as traffic-editor writes them")
    import_extra("shapely")
    with np.errstate(divide="raise", invalid="raise"):  # if points coincide
        return _BuildingReader(content, path).read()


class _BuildingReader:
    """Reads the content of a building's file."""

    def __init__(self, content: Json, path: Path) -> None:
        self._content = content
        self._path = path
        self._parsed_scene = ParsedScene()
        self._levels: Json = content["levels"]
        coordinate_system = content.get("coordinate_system", "reference_image")
        if coordinate_system not in COORDINATE_SYSTEMS:
            raise SceneError(
                f"{path} is in {coordinate_system}: expected {', '.join(COORDINATE_SYSTEMS)}, in "
                "which "
                "traffic-editor saves as well"
            )
        self._is_image = coordinate_system == "reference_image"
        self._reference_level = content.get("reference_level_name", next(iter(self._levels), ""))
        self._projection = self._find_projection() if coordinate_system == "wgs84" else None
        self._transforms = self._find_transforms()

    # ------------------------------------------------------------ places

    def _find_projection(self) -> Projection:
        """Find the projection of a building in WGS84: that of its parameter ``generate_crs``.

        The world's origin is at the parameters ``suggested_offset_x`` and ``suggested_offset_y``,
        as in simulations; without them, at the whole kilometre south-west of all vertices, with a
        warning. Source: ``building.py`` and ``wgs84_transform.py`` of ``rmf_building_map_tools``.

        Raises:
            SceneError: the file states no CRS, or none in metres.
            MissingDependencyError: pyproj is not installed.
        """
        parameters = self._content.get("parameters") or {}
        with convert_read_errors(f"`parameters` of {self._path}"):
            parameter_values = {name: parameter[1] for name, parameter in parameters.items()}
        crs_name = parameter_values.get("generate_crs")
        if not crs_name:
            raise SceneError(
                f"{self._path} is in wgs84 without a projection: expected the parameter "
                "`generate_crs`, such as generate_crs: [1, 'EPSG:32632'], got nothing"
            )
        pyproj = import_extra("pyproj", feature="a building in wgs84")
        try:
            crs = pyproj.CRS.from_user_input(str(crs_name))
            axis_units = {axis.unit_name for axis in crs.axis_info}
            if not crs.is_projected or axis_units - {"metre", "meter"}:
                raise ValueError("no projection in metres")
            # easting first, whatever the order of axes of the CRS
            transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        except (pyproj.exceptions.ProjError, ValueError) as error:
            reason = " ".join(str(error).split())[:200]
            raise SceneError(
                f"expected a projection in metres as `generate_crs` of {self._path}, such as "
                f"EPSG:32632, got {crs_name!r}: {reason}"
            ) from error
        if "suggested_offset_x" in parameter_values or "suggested_offset_y" in parameter_values:
            with convert_read_errors(f"`parameters` of {self._path}"):
                x = float(parameter_values.get("suggested_offset_x", 0.0))
                y = float(parameter_values.get("suggested_offset_y", 0.0))
            return Projection(transformer, complex(x, y))
        projection = Projection(transformer, 0j)
        with convert_read_errors(f"vertices of {self._path}"):
            points = np.concatenate(
                [
                    np.zeros(0, np.complex128),
                    *(self._read_points(level_name) for level_name in self._levels),
                ]
            )
            world_points = projection.project(points)
        if not len(world_points):
            return projection
        x = math.floor(float(world_points.real.min()) / KILOMETRE) * KILOMETRE
        y = math.floor(float(world_points.imag.min()) / KILOMETRE) * KILOMETRE
        self._warn(
            f"{self._path} has no suggested_offset_x and suggested_offset_y: the world's origin is "
            f"at {x:.0f}, {y:.0f} m in {crs_name}"
        )
        return Projection(transformer, complex(x, y))

    def _find_transforms(self) -> dict[str, PlanTransform]:
        """Return name of a level -> the transform from its plan to the world."""
        if not self._is_image:
            return dict.fromkeys(self._levels, PlanTransform(1.0 + 0j, 0j))
        scale = self._measure_pixel(self._reference_level)
        transforms = {self._reference_level: PlanTransform(scale + 0.0j, 0.0j)}
        for level_name in self._levels:
            if level_name not in transforms:
                transforms[level_name] = self._align_with_reference(level_name, scale)
        return transforms

    def _read_points(self, level_name: str) -> NDArray[np.complex128]:
        """The vertices of a level in the file's units, y up, as complex numbers."""
        vertex_rows = self._levels[level_name].get("vertices") or []
        points = np.array(
            [complex(vertex_row[0], vertex_row[1]) for vertex_row in vertex_rows],
            dtype=np.complex128,
        )
        return points.conj() if self._is_image else points

    def _measure_pixel(self, level_name: str) -> float:
        """Return the edge of a pixel of a level's plan [m]: the mean of all its measurements."""
        points = self._read_points(level_name)
        scales = []
        for start, end, measurement in self._levels[level_name].get("measurements") or []:
            scales.append(float(measurement["distance"][1]) / abs(points[start] - points[end]))
        if not scales:
            raise SceneError(
                f"level {level_name!r} of {self._path} has no measurement: pixels have no size "
                "without one; draw one in traffic-editor"
            )
        return float(np.mean(scales))

    def _align_with_reference(self, level_name: str, reference_scale: float) -> PlanTransform:
        """Find the transform that lays a level's fiducials over those of the reference level.

        With fewer than two fiducials in common, the image is scaled only, with a warning.

        Args:
            level_name: the level's name.
            reference_scale: edge of a pixel of the reference level [m].
        """
        reference_fiducials = self._read_fiducials(self._reference_level)
        level_fiducials = self._read_fiducials(level_name)
        shared_names = [name for name in reference_fiducials if name in level_fiducials]
        if len(shared_names) < 2:
            self._warn(
                f"level {level_name!r} of {self._path} shares {len(shared_names)} fiducials with "
                f"{self._reference_level!r}, expected 2 or more: its image lies over the other's "
                "as it is"
            )
            has_measurements = bool(self._levels[level_name].get("measurements"))
            scale = self._measure_pixel(level_name) if has_measurements else reference_scale
            return PlanTransform(scale + 0.0j, 0.0j)
        if len(shared_names) > MAX_FIDUCIALS:
            raise SceneError(
                f"level {level_name!r} of {self._path} shares {len(shared_names):,} fiducials with "
                f"{self._reference_level!r}, expected {MAX_FIDUCIALS} at most"
            )
        reference_points = np.array([reference_fiducials[name] for name in shared_names])
        level_points = np.array([level_fiducials[name] for name in shared_names])
        first_indices, second_indices = np.triu_indices(len(shared_names), k=1)  # all pairs
        reference_lines = reference_points[second_indices] - reference_points[first_indices]
        level_lines = level_points[second_indices] - level_points[first_indices]
        relative_rotations = level_lines * reference_lines.conj()
        # the mean rotation between the lines
        mean_rotation = (relative_rotations / abs(relative_rotations)).sum().conj()
        factor = (
            mean_rotation / abs(mean_rotation) / np.mean(abs(level_lines) / abs(reference_lines))
        )
        shift = np.mean(reference_points - level_points * factor)
        return PlanTransform(complex(factor * reference_scale), complex(shift * reference_scale))

    def _read_fiducials(self, level_name: str) -> dict[str, complex]:
        fiducial_rows = self._levels[level_name].get("fiducials") or []
        return {name: complex(x, -y) for x, y, name in fiducial_rows}

    def _find_world_points(self, level_name: str) -> Float:
        """World x and y of a level's vertices [m], shape (n, 2)."""
        transform = self._transforms[level_name]
        points = self._read_points(level_name)
        if self._projection is not None:
            with convert_read_errors(f"vertices of level {level_name!r} in {self._path}"):
                points = self._projection.project(points)
        points = points * transform.factor + transform.shift
        return np.stack([points.real, points.imag], axis=1)

    def _read_elevation(self, level_name: str) -> float:
        return float(self._levels[level_name].get("elevation", 0.0))

    # ------------------------------------------------------------ floors and walls

    def read(self) -> ParsedScene:
        """Read all levels and lifts."""
        lifts: Json = self._content.get("lifts") or {}
        shafts = {name: self._find_shaft_corners(lift) for name, lift in lifts.items()}
        for level_name in self._levels:
            z = self._read_elevation(level_name)
            level_shafts = [
                shafts[name] for name, lift in lifts.items() if self._passes_through(lift, z)
            ]
            self._read_level(level_name, z, level_shafts)
        for name, lift in lifts.items():
            with convert_read_errors(f"lift {name!r} of {self._path}"):
                self._add_lift(str(name), lift)
        return self._parsed_scene

    def _read_level(self, level_name: str, z: float, shafts: list[Float]) -> None:
        """Add the floors, walls and doors of a level.

        Args:
            level_name: its name.
            z: its elevation [m].
            shafts: for each shaft through the level's floors, its corners, (4, 2) [m].
        """
        level_content = self._levels[level_name]
        points = self._find_world_points(level_name)
        for element_number, floor in enumerate(level_content.get("floors") or [], 1):
            holes = [points[hole["vertices"]] for hole in level_content.get("holes") or []]
            outline = points[[int(vertex) for vertex in floor.get("vertices") or []]]
            if len(outline) >= 3:
                self._add_floor(
                    f"{level_name}/floor_{element_number}", outline, [*holes, *shafts], z
                )
        for element_number, (start, end, *_) in enumerate(level_content.get("walls") or [], 1):
            name = f"{level_name}/wall_{element_number}"
            with convert_read_errors(f"{name} of {self._path}"):
                self._add_wall(name, points[start], points[end], z)
        for element_number, (start, end, door_values) in enumerate(
            level_content.get("doors") or [], 1
        ):
            with convert_read_errors(
                f"door {element_number} of level {level_name!r} in {self._path}"
            ):
                properties = {key: door_value[1] for key, door_value in door_values.items()}
                self._add_door(points[[start, end]], z, properties)

    def _warn(self, text: str) -> None:
        self._parsed_scene.warnings.append(text)

    def _add_floor(self, name: str, outline: Float, holes: list[Float], z: float) -> None:
        with convert_read_errors(f"{name} of {self._path}"):
            mesh = make_slab(outline, holes, z)
        if not len(mesh.faces):
            self._warn(f"{name} of {self._path} left out: it has no area")
            return
        self._parsed_scene.geoms.append(ParsedGeom(name, name, "mesh", (), np.eye(4), mesh))

    def _add_wall(self, name: str, start: Float, end: Float, z: float) -> None:
        length_x, length_y = end - start
        middle_x, middle_y = (start + end) / 2
        half_size = (
            (math.hypot(length_x, length_y) + WALL_THICKNESS) / 2,
            WALL_THICKNESS / 2,
            WALL_HEIGHT / 2,
        )
        pose = make_pose((middle_x, middle_y, z + WALL_HEIGHT / 2), math.atan2(length_y, length_x))
        self._add_box(name, half_size, pose, body=name)

    def _add_box(
        self, name: str, half_size: tuple[float, float, float], pose: Float, body: str
    ) -> None:
        self._parsed_scene.geoms.append(ParsedGeom(name, body, "box", half_size, pose))

    # ------------------------------------------------------------ doors

    def _add_door(self, door_ends: Float, z: float, properties: Json) -> None:
        """Add the leaves of a closed door, with a joint each.

        Args:
            door_ends: start and end of the door, (2, 2) [m].
            z: elevation of its level [m].
            properties: the door's properties, as the file states them.
        """
        name = str(properties["name"])
        door_type = str(properties["type"])
        if door_type not in SLIDING_DOORS + HINGED_DOORS:
            self._warn(
                f"door {name!r} of {self._path} is of type {door_type!r}, which is not known: it "
                f"is left out; known are {', '.join(SLIDING_DOORS + HINGED_DOORS)}"
            )
            return
        if properties.get("motion_axis") == "end":
            door_ends = door_ends[::-1]
        end_to_start = door_ends[0] - door_ends[1]  # the x axis of the door's frame
        door_length = math.hypot(*end_to_start)
        yaw = math.atan2(end_to_start[1], end_to_start[0])
        if door_length == 0:
            raise SceneError(f"door {name!r} of {self._path} has no width: its vertices coincide")
        turning_direction = 1 if float(properties.get("motion_direction", 1)) >= 0 else -1
        for leaf in _find_leaves(name, door_type, door_length, properties):
            leaf_offset = end_to_start / door_length * leaf.side * (door_length - leaf.width) / 2
            middle_x, middle_y = door_ends.mean(axis=0) + leaf_offset
            pose = make_pose((middle_x, middle_y, z + DOOR_GAP + DOOR_HEIGHT / 2), yaw)
            outer_edge = pose[:3, 3] + pose[:3, 0] * leaf.side * leaf.width / 2
            if door_type in SLIDING_DOORS:
                axis = pose[:3, 0] * leaf.side
                limits = (0.0, leaf.width)
                joint = ParsedJoint(leaf.name, "slide", outer_edge, axis, limits)
            else:
                max_angle = math.radians(abs(float(properties.get("motion_degrees", 90.0))))
                axis = np.array([0.0, 0.0, -1.0]) * turning_direction * leaf.side
                joint = ParsedJoint(leaf.name, "hinge", outer_edge, axis, (0.0, max_angle))
            half_size = ((leaf.width - DOOR_GAP) / 2, DOOR_THICKNESS / 2, DOOR_HEIGHT / 2)
            self._parsed_scene.bodies[leaf.name] = ParsedBody(leaf.name, "", pose, joint)
            self._parsed_scene.named_leaves.add(leaf.name)
            self._add_box(leaf.name, half_size, pose, body=leaf.name)

    # ------------------------------------------------------------ lifts

    def _passes_through(self, lift: Json, z: float) -> bool:
        """Return whether a lift's shaft leads through the floors at elevation z [m]."""
        lowest_level = lift.get("lowest_floor")
        highest_level = lift.get("highest_floor")
        is_above = not lowest_level or z >= self._read_elevation(lowest_level)
        is_below = not highest_level or z <= self._read_elevation(highest_level)
        return bool(lift.get("level_doors")) and is_above and is_below

    def _find_lift_pose(self, lift: Json, z: float) -> Float:
        transform = self._transforms[lift.get("reference_floor_name") or self._reference_level]
        y = -lift["y"] if self._is_image else lift["y"]
        position = complex(lift["x"], y)
        if self._projection is not None:
            position = complex(self._projection.project(np.array([position]))[0])
        position = position * transform.factor + transform.shift
        return make_pose((position.real, position.imag, z), float(lift["yaw"]))

    def _find_shaft_corners(self, lift: Json) -> Float:
        """The corners of a lift's shaft, shape (4, 2) [m]."""
        half_size = np.array([lift["width"], lift["depth"]]) / 2 + CAR_GAP
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half_size
        pose = self._find_lift_pose(lift, 0.0)
        return np.asarray(corners @ pose[:2, :2].T + pose[:2, 3])

    def _add_lift(self, name: str, lift: Json) -> None:
        """Add a lift's car, where the lift starts: a floor, and walls with openings for doors."""
        stop_heights = [
            self._read_elevation(level_name) for level_name in lift.get("level_doors") or {}
        ]
        if len(stop_heights) < 2:
            reason = f"opens on {len(stop_heights)} levels, expected 2 or more"
            self._warn(f"lift {name!r} of {self._path} {reason}: it is left out")
            return
        first_level_name = lift.get("initial_floor_name") or next(iter(lift["level_doors"]))
        z = self._read_elevation(first_level_name)
        pose = self._find_lift_pose(lift, z)
        limits = (min(stop_heights) - z, max(stop_heights) - z)
        joint = ParsedJoint(name, "slide", pose[:3, 3], np.array([0.0, 0.0, 1.0]), limits)
        self._parsed_scene.bodies[name] = ParsedBody(name, "", pose, joint)
        half_width = float(lift["width"]) / 2
        half_depth = float(lift["depth"]) / 2
        self._add_box(
            f"{name}/floor",
            (half_width, half_depth, CAR_FLOOR_THICKNESS / 2),
            pose @ make_pose((0, 0, -CAR_FLOOR_THICKNESS / 2)),
            body=name,
        )
        walls = _find_car_walls((half_width, half_depth), lift.get("doors") or {})
        for wall_number, wall in enumerate(walls, 1):
            self._add_box(
                f"{name}/wall_{wall_number}",
                (*wall.half_size, CAR_HEIGHT / 2),
                pose @ make_pose((*wall.middle, CAR_HEIGHT / 2)),
                body=name,
            )


def _find_leaves(name: str, door_type: str, door_length: float, properties: Json) -> list[DoorLeaf]:
    """Return the leaves of a door: a single leaf, or a right and a left leaf."""
    if not door_type.startswith("double"):
        return [DoorLeaf(name, 1, door_length)]
    right_left_ratio = float(properties.get("right_left_ratio", 1.0))
    right_width = door_length * right_left_ratio / (1 + right_left_ratio)
    if right_width >= door_length:
        return [DoorLeaf(name, 1, right_width)]
    return [
        DoorLeaf(f"{name}_right", 1, right_width),
        DoorLeaf(f"{name}_left", -1, door_length - right_width),
    ]


def _find_car_walls(half_sizes: tuple[float, float], doors: Json) -> Iterator[CarWall]:
    """Yield the walls of a lift's car: the parts of its four sides without a door.

    Args:
        half_sizes: half of the car's size along x and y [m].
        doors: the car's doors, with their positions and widths in the car's frame.
    """
    for axis in (0, 1):  # the two sides perpendicular to x, then the two perpendicular to y
        other_axis = 1 - axis
        # The sides perpendicular to x stand between the other two, so they are shorter.
        half_length = half_sizes[other_axis] - (CAR_WALL_THICKNESS if axis == 0 else 0.0)
        for sign in (-1, 1):
            openings = []
            for door in doors.values():
                position = (float(door["x"]), float(door["y"]))
                x_distance = abs(abs(position[0]) - half_sizes[0])
                y_distance = abs(abs(position[1]) - half_sizes[1])
                is_on_side_pair = (x_distance <= y_distance) == (axis == 0)
                if is_on_side_pair and (position[axis] > 0) == (sign > 0):
                    opening_middle = position[other_axis]
                    openings.append(
                        (opening_middle - door["width"] / 2, opening_middle + door["width"] / 2)
                    )
            wall_start = -half_length
            for opening_start, opening_end in [*sorted(openings), (half_length, half_length)]:
                if opening_start - wall_start > 1e-6:
                    wall_middle = [0.0, 0.0]
                    half_size = [0.0, 0.0]
                    wall_middle[axis] = sign * (half_sizes[axis] - CAR_WALL_THICKNESS / 2)
                    half_size[axis] = CAR_WALL_THICKNESS / 2
                    wall_middle[other_axis] = (wall_start + opening_start) / 2
                    half_size[other_axis] = (opening_start - wall_start) / 2
                    yield CarWall(
                        middle=(wall_middle[0], wall_middle[1]),
                        half_size=(half_size[0], half_size[1]),
                    )
                wall_start = max(wall_start, opening_end)


def make_pose(position: ArrayLike, yaw: float = 0.0) -> Float:
    """Return a pose that is turned about z only, as a matrix from its frame to the world, (4, 4).

    Args:
        position: x, y and z [m].
        yaw: the turn about z [rad].
    """
    pose = np.eye(4)
    pose[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    pose[:3, 3] = position
    return pose


def make_slab(outline: Float, holes: list[Float], z: float) -> Mesh:
    """Make a horizontal slab, `FLOOR_THICKNESS` thick, from a polygon with holes.

    Args:
        outline: corners of the polygon, (n, 2) [m].
        holes: corners of each hole, (n, 2) [m].
        z: height of the slab's top [m].

    Returns:
        The slab, a closed mesh; an empty mesh if the polygon has no area.
    """
    floor_polygon = shapely.make_valid(shapely.polygons(outline))
    for hole in holes:
        floor_polygon = floor_polygon.difference(shapely.make_valid(shapely.polygons(hole)))
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(floor_polygon))
    if not len(triangles):
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))
    triangle_corners = np.array(
        [shapely.get_coordinates(triangle.normalize())[2::-1] for triangle in triangles]
    )
    points, point_of_corner = np.unique(
        triangle_corners.reshape(-1, 2), axis=0, return_inverse=True
    )
    faces = point_of_corner.reshape(-1, 3).astype(np.int32)
    first_side = points[faces[:, 1]] - points[faces[:, 0]]
    second_side = points[faces[:, 2]] - points[faces[:, 0]]
    cross_product = first_side[:, 0] * second_side[:, 1] - first_side[:, 1] * second_side[:, 0]
    is_clockwise = cross_product < 0
    faces[is_clockwise] = faces[is_clockwise][:, ::-1]
    # An edge of only one triangle is part of the outline: the slab gets a side there.
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, first_edge_index, num_triangles = np.unique(
        np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True
    )
    outline_edges = edges[first_edge_index[num_triangles == 1]]
    start_points = outline_edges[:, 0]
    end_points = outline_edges[:, 1]
    num_points = np.int32(len(points))  # point i of the top is above point i + num_points
    side_faces = [
        np.stack([start_points, start_points + num_points, end_points], 1),
        np.stack([end_points, start_points + num_points, end_points + num_points], 1),
    ]
    bottom_faces = faces[:, ::-1] + num_points
    vertices = np.concatenate(
        [
            np.column_stack([points, np.full(len(points), height)])
            for height in (z, z - FLOOR_THICKNESS)
        ]
    )
    return Mesh(vertices, np.concatenate([faces, bottom_faces, *side_faces]).astype(np.int32))
