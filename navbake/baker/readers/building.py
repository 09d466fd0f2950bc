"""Buildings of Open-RMF's traffic editor (``.building.yaml``) as pieces of a scene.

Walls, floors with their holes, doors and lifts become what rmf_building_map_tools makes of them
for simulators: walls 2.5 m high and 0.1 m thick, floors 0.1 m, doors 2.2 m. Levels are laid over
each other by their fiducials. Furniture (`models`) has no geometry in the file and is left out. A
lift is its car, which moves between its floors; its doors open with it and are left out.

Source: open-rmf/rmf_traffic_editor, ``rmf_building_map_tools/building_map``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from navbake.baker.geometry.shapes import Mesh
from navbake.baker.readers.parsed_scene import (
    ParsedBody,
    ParsedGeom,
    ParsedJoint,
    ParsedScene,
    reading,
)
from navbake.config.settings import SceneSettings
from navbake.errors import SceneError
from navbake.formats.source import import_extra
from navbake.lazy import lazy
from navbake.types import Float, Json

shapely = lazy("shapely")  # of the extra [convert]

WALL = 0.1, 2.5  # thickness and height [m]
FLOOR = 0.1  # thickness [m]
DOOR = 0.03, 2.2, 0.01  # thickness, height, and the gap round a leaf [m]
CAR = 0.05, 0.05, 2.5, 0.05  # its walls' and floor's thickness, its height, the gap round it [m]
SLIDING = ("sliding", "double_sliding", "telescopic", "double_telescopic")
HINGED = ("hinged", "double_hinged")
GEOGRAPHIC = ("web_mercator", "wgs84")


def read_building(path: Path, settings: SceneSettings) -> ParsedScene:
    """Read a building: its floors, walls, doors and lifts.

    Raises:
        SceneError: the file is no building, names a vertex that isn't there, or has no scale.
        MissingDependencyError: shapely is not installed.
    """
    try:
        content = yaml.load(path.read_bytes(), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except yaml.YAMLError as error:
        raise SceneError(f"no YAML in {path}: {' '.join(str(error).split())[:200]}") from error
    if not isinstance(content, dict) or not isinstance(content.get("levels"), dict):
        raise SceneError(f"no building in {path}: expected `levels`, as traffic-editor writes them")
    import_extra("shapely")
    with np.errstate(divide="raise", invalid="raise"):  # by points that coincide
        return _Building(content, path).gather()


class _Building:
    """A building's file, and where its vertices are in the world."""

    def __init__(self, content: Json, path: Path) -> None:
        self.content = content
        self.path = path
        self.found = ParsedScene()
        self.levels: Json = content["levels"]
        system = content.get("coordinate_system", "reference_image")
        if system in GEOGRAPHIC:
            raise SceneError(
                f"{path} is in {system}: expected reference_image or cartesian_meters, which "
                "traffic-editor saves as well"
            )
        self.is_image = system == "reference_image"
        self.maps = dict.fromkeys(self.levels, (1.0 + 0j, 0j))  # z -> z * first + second
        self.reference = content.get("reference_level_name", next(iter(self.levels), ""))
        if self.is_image:
            self.maps = {self.reference: (self._scale(self.reference) + 0.0j, 0.0j)}
            self.maps |= {name: self._lay(name) for name in self.levels if name not in self.maps}

    def _points(self, level: str) -> NDArray[np.complex128]:
        """The vertices of a level in the file's units, y up, as complex numbers."""
        rows = self.levels[level].get("vertices") or []
        points = np.array([complex(row[0], row[1]) for row in rows], dtype=np.complex128)
        return points.conj() if self.is_image else points

    def _scale(self, level: str) -> float:
        """Metres of a pixel, as the mean of the level's measurements."""
        points = self._points(level)
        shares = []
        for one, other, values in self.levels[level].get("measurements") or []:
            shares.append(float(values["distance"][1]) / abs(points[one] - points[other]))
        if not shares:
            raise SceneError(
                f"level {level!r} of {self.path} has no measurement: pixels have no size without "
                "one; draw one in traffic-editor"
            )
        return float(np.mean(shares))

    def _lay(self, level: str) -> tuple[complex, complex]:
        """How a level's image lies over the reference's: by the fiducials that both have."""
        scale = self.maps[self.reference][0].real
        marks = [
            {name: complex(x, -y) for x, y, name in self.levels[one].get("fiducials") or []}
            for one in (self.reference, level)
        ]
        shared = [name for name in marks[0] if name in marks[1]]
        if len(shared) < 2:
            self._warn(
                f"level {level!r} of {self.path} shares {len(shared)} fiducials with "
                f"{self.reference!r}, expected 2 or more: its image lies over the other's as it is"
            )
            own = self._scale(level) if self.levels[level].get("measurements") else scale
            return own + 0.0j, 0.0j
        ref, own_marks = (np.array([each[name] for name in shared]) for each in marks)
        first, second = np.array(list(combinations(range(len(shared)), 2))).T
        apart = ref[second] - ref[first]
        own_apart = own_marks[second] - own_marks[first]
        turns = own_apart * apart.conj()
        turn = (turns / abs(turns)).sum().conj()  # mean of the directions' differences
        factor = turn / abs(turn) / np.mean(abs(own_apart) / abs(apart))
        shift = np.mean(ref - own_marks * factor)
        return complex(factor * scale), complex(shift * scale)

    def place(self, level: str) -> Float:
        """World x and y of a level's vertices [m], shape (n, 2)."""
        factor, shift = self.maps[level]
        placed = self._points(level) * factor + shift
        return np.stack([placed.real, placed.imag], axis=1)

    def gather(self) -> ParsedScene:
        lifts: Json = self.content.get("lifts") or {}
        thick, high = WALL
        shafts = {name: self._shaft(lift) for name, lift in lifts.items()}
        for level, content in self.levels.items():
            xy = self.place(level)
            z = float(content.get("elevation", 0.0))
            served = [shafts[name] for name, lift in lifts.items() if self._passes(lift, z)]
            for number, floor in enumerate(content.get("floors") or [], 1):
                holes = [xy[hole["vertices"]] for hole in content.get("holes") or []] + served
                outline = xy[[int(v) for v in floor.get("vertices") or []]]
                name = f"{level}/floor_{number}"
                if len(outline) >= 3:
                    with reading(f"{name} of {self.path}"):
                        mesh = make_slab(outline, holes, z)
                    if not len(mesh.faces):
                        self._warn(f"{name} of {self.path} left out: it has no area")
                        continue
                    self.found.pieces.append(ParsedGeom(name, name, "mesh", (), np.eye(4), mesh))
            for number, (one, other, *_) in enumerate(content.get("walls") or [], 1):
                name = f"{level}/wall_{number}"
                with reading(f"{name} of {self.path}"):
                    x, y = xy[other] - xy[one]
                    middle = (xy[one] + xy[other]) / 2
                    size = (math.hypot(x, y) + thick) / 2, thick / 2, high / 2
                    self._add_box(name, size, pose_of((*middle, z + high / 2), math.atan2(y, x)))
            for number, (one, other, values) in enumerate(content.get("doors") or [], 1):
                with reading(f"door {number} of level {level!r} in {self.path}"):
                    self._add_door(xy[[one, other]], z, {k: v[1] for k, v in values.items()})
        for name, lift in lifts.items():
            with reading(f"lift {name!r} of {self.path}"):
                self._add_lift(str(name), lift)
        return self.found

    def _warn(self, text: str) -> None:
        self.found.warnings.append(text)

    def _add_box(self, name: str, size: tuple[float, ...], pose: Float, body: str = "") -> None:
        self.found.pieces.append(ParsedGeom(name, body or name, "box", size, pose))

    def _add_door(self, ends: Float, z: float, values: Json) -> None:
        """Add a door's leaves, closed; each moves by a joint."""
        name = str(values["name"])
        kind = str(values["type"])
        if kind not in SLIDING + HINGED:
            self._warn(
                f"door {name!r} of {self.path} is of type {kind!r}, which is not known: it is left "
                f"out; known are {', '.join(SLIDING + HINGED)}"
            )
            return
        if values.get("motion_axis") == "end":
            ends = ends[::-1]
        back = ends[0] - ends[1]  # x of the door's frame leads from its end to its start
        length = math.hypot(*back)
        yaw = math.atan2(back[1], back[0])
        if length == 0:
            raise SceneError(f"door {name!r} of {self.path} has no width: its vertices coincide")
        ratio = float(values.get("right_left_ratio", 1.0))
        first = length * ratio / (1 + ratio) if kind.startswith("double") else length
        # leaves at the start and at the end of the door: name, sign of x, length
        leaves = [(name, 1, first)]
        if first < length:
            leaves = [(f"{name}_right", 1, first), (f"{name}_left", -1, length - first)]
        thick, high, gap = DOOR
        direction = 1 if float(values.get("motion_direction", 1)) >= 0 else -1
        for leaf, side, wide in leaves:
            middle = ends.mean(axis=0) + back / length * side * (length - wide) / 2
            pose = pose_of((*middle, z + gap + high / 2), yaw)
            hinge = pose[:3, 3] + pose[:3, 0] * side * wide / 2
            if kind in SLIDING:
                joint = ParsedJoint(leaf, "slide", hinge, pose[:3, 0] * side, (0.0, wide))
            else:
                turn = math.radians(abs(float(values.get("motion_degrees", 90.0))))
                axis = np.array([0.0, 0.0, -1.0]) * direction * side
                joint = ParsedJoint(leaf, "hinge", hinge, axis, (0.0, turn))
            self.found.bodies[leaf] = ParsedBody(leaf, "", pose, joint)
            self.found.named_leaves.add(leaf)
            self._add_box(leaf, ((wide - gap) / 2, thick / 2, high / 2), pose, leaf)

    def _elevation(self, level: str) -> float:
        return float(self.levels[level].get("elevation", 0.0))

    def _passes(self, lift: Json, z: float) -> bool:
        """Whether a lift's shaft leads through the floors at a height."""
        low = lift.get("lowest_floor")
        high = lift.get("highest_floor")
        is_above = not low or z >= self._elevation(low)
        is_below = not high or z <= self._elevation(high)
        return bool(lift.get("level_doors")) and is_above and is_below

    def _pose_of_lift(self, lift: Json, z: float) -> Float:
        factor, shift = self.maps[lift.get("reference_floor_name") or self.reference]
        at = complex(lift["x"], -lift["y"] if self.is_image else lift["y"]) * factor + shift
        return pose_of((at.real, at.imag, z), float(lift["yaw"]))

    def _shaft(self, lift: Json) -> Float:
        """The corners of a lift's shaft, shape (4, 2)."""
        half = np.array([lift["width"], lift["depth"]]) / 2 + CAR[3]
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
        pose = self._pose_of_lift(lift, 0.0)
        return np.asarray(corners @ pose[:2, :2].T + pose[:2, 3])

    def _add_lift(self, name: str, lift: Json) -> None:
        """Add a lift's car at its first floor: floor and walls, open where it has doors."""
        stops = [self._elevation(level) for level in lift.get("level_doors") or {}]
        if len(stops) < 2:
            opens = f"opens on {len(stops)} levels, expected 2 or more"
            self._warn(f"lift {name!r} of {self.path} {opens}: it is left out")
            return
        first = lift.get("initial_floor_name") or next(iter(lift["level_doors"]))
        z = self._elevation(first)
        pose = self._pose_of_lift(lift, z)
        limits = min(stops) - z, max(stops) - z
        joint = ParsedJoint(name, "slide", pose[:3, 3], np.array([0.0, 0.0, 1.0]), limits)
        self.found.bodies[name] = ParsedBody(name, "", pose, joint)
        _, floor, high, _ = CAR
        half = float(lift["width"]) / 2, float(lift["depth"]) / 2
        sizes = half[0], half[1], floor / 2
        self._add_box(f"{name}/floor", sizes, pose @ pose_of((0, 0, -floor / 2)), name)
        for number, (middle, size) in enumerate(_walls_of_car(half, lift.get("doors") or {}), 1):
            at = pose @ pose_of((*middle, high / 2))
            self._add_box(f"{name}/wall_{number}", (*size, high / 2), at, name)


def _walls_of_car(
    half: tuple[float, float], doors: Json
) -> Iterator[tuple[tuple[float, float], tuple[float, float]]]:
    """Middles and half sizes of a car's walls, in its frame: its sides but for the doors."""
    thick = CAR[0]
    for axis in (0, 1):  # the sides across x, then those across y
        across = 1 - axis
        reach = half[across] - (thick if axis == 0 else 0.0)
        for sign in (-1, 1):
            gaps = []
            for door in doors.values():
                at = float(door["x"]), float(door["y"])
                off = [abs(abs(at[k]) - half[k]) for k in (0, 1)]
                if (off[0] <= off[1]) == (axis == 0) and (at[axis] > 0) == (sign > 0):
                    gaps.append((at[across] - door["width"] / 2, at[across] + door["width"] / 2))
            begin = -reach
            for low, end in [*sorted(gaps), (reach, reach)]:
                if low - begin > 1e-6:
                    middle = [0.0, 0.0]
                    size = [0.0, 0.0]
                    middle[axis] = sign * (half[axis] - thick / 2)
                    size[axis] = thick / 2
                    middle[across] = (begin + low) / 2
                    size[across] = (low - begin) / 2
                    yield (middle[0], middle[1]), (size[0], size[1])
                begin = max(begin, end)


def pose_of(at: Any, yaw: float = 0.0) -> Float:
    """A pose upright at x, y, z [m], turned about z, shape (4, 4)."""
    pose = np.eye(4)
    pose[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    pose[:3, 3] = at
    return pose


def make_slab(outline: Float, holes: list[Float], z: float) -> Mesh:
    """A polygon without its holes as a closed slab below a height; empty for one without area."""
    area = shapely.make_valid(shapely.polygons(outline))
    for hole in holes:
        area = area.difference(shapely.make_valid(shapely.polygons(hole)))
    tops = shapely.get_parts(shapely.constrained_delaunay_triangles(area))
    corners = np.array([shapely.get_coordinates(t.normalize())[2::-1] for t in tops])
    if not len(tops):
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))
    flat, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int32)
    a, b, c = (flat[faces[:, k]] for k in range(3))
    dx, dy = (b - a).T
    ex, ey = (c - a).T
    turned = dx * ey - dy * ex < 0
    faces[turned] = faces[turned][:, ::-1]
    # an edge of one triangle alone is the outline's, and gets a wall down
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.sort(edges, axis=1)
    _, place, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
    one, other = edges[place[count == 1]].T
    low = np.int32(len(flat))
    sides = [np.stack([one, one + low, other], 1), np.stack([other, one + low, other + low], 1)]
    layers = [np.column_stack([flat, np.full(len(flat), height)]) for height in (z, z - FLOOR)]
    vertices = np.concatenate(layers)
    return Mesh(vertices, np.concatenate([faces, faces[:, ::-1] + low, *sides]).astype(np.int32))
