"""MCAP files of ROS 2 messages, which Foxglove, rerun and ``ros2 bag play`` open.

The topics are:

- ``/map``, or for several levels ``/map_0``, ``/map_1``, …: a ``nav_msgs/OccupancyGrid`` at the
  level's height.
- ``/path_0``, ``/path_1``, …: a ``nav_msgs/Path`` each, whose poses head along the path.
- ``/links``: a ``visualization_msgs/MarkerArray`` with lines for the steps between levels, and from
  stop to stop of the named links.

A file of a flight has ``/path_0``, and in ``/voxels`` a ``visualization_msgs/MarkerArray`` with a
cube for each occupied voxel at the surface.

All frames are ``map``, all times are 0.

Source: the definitions of messages of ROS 2 Humble; ``mcap_ros2`` encodes them.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from navbake.errors import FormatError
from navbake.formats.level_paths import select_levels
from navbake.formats.occupancy import compute_occupancy_values
from navbake.formats.source import Files, import_extra
from navbake.navgrid.grid import NavGrid
from navbake.runtime.paths import Path as Route
from navbake.types import Float, Json
from navbake.voxels.finder import FlightPath
from navbake.voxels.grid import VoxelGrid

# type of a message -> its fields, in the language of ROS' own definitions
MESSAGES = {
    "builtin_interfaces/Time": "int32 sec; uint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec; uint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp; string frame_id",
    "std_msgs/ColorRGBA": "float32 r; float32 g; float32 b; float32 a",
    "geometry_msgs/Point": "float64 x; float64 y; float64 z",
    "geometry_msgs/Vector3": "float64 x; float64 y; float64 z",
    "geometry_msgs/Quaternion": "float64 x 0; float64 y 0; float64 z 0; float64 w 1",
    "geometry_msgs/Pose": "geometry_msgs/Point position; geometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header; geometry_msgs/Pose pose",
    "nav_msgs/MapMetaData": (
        "builtin_interfaces/Time map_load_time; float32 resolution; uint32 width; uint32 height; "
        "geometry_msgs/Pose origin"
    ),
    "nav_msgs/OccupancyGrid": ("std_msgs/Header header; nav_msgs/MapMetaData info; int8[] data"),
    "nav_msgs/Path": "std_msgs/Header header; geometry_msgs/PoseStamped[] poses",
    "sensor_msgs/CompressedImage": "std_msgs/Header header; string format; uint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u; float32 v",
    "visualization_msgs/MeshFile": "string filename; uint8[] data",
    "visualization_msgs/Marker": (
        "std_msgs/Header header; string ns; int32 id; int32 type; int32 action; "
        "geometry_msgs/Pose pose; geometry_msgs/Vector3 scale; std_msgs/ColorRGBA color; "
        "builtin_interfaces/Duration lifetime; bool frame_locked; geometry_msgs/Point[] points; "
        "std_msgs/ColorRGBA[] colors; string texture_resource; "
        "sensor_msgs/CompressedImage texture; visualization_msgs/UVCoordinate[] uv_coordinates; "
        "string text; string mesh_resource; visualization_msgs/MeshFile mesh_file; "
        "bool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
}
MAP_FRAME = {"frame_id": "map"}
NO_ROTATION = {"w": 1.0}  # a quaternion
LINE_LIST = 5  # type of a marker: points 0 and 1 are the ends of a line, then 2 and 3, …
CUBE_LIST = 6  # type of a marker: each point is the middle of a cube
VOXEL_COLOR = {"r": 0.6, "g": 0.6, "b": 0.65, "a": 1.0}
LINE_WIDTH = 0.03  # [m]
LINE_COLOR = {"r": 0.9, "g": 0.5, "b": 0.1, "a": 1.0}


def encode_mcap(
    grid: NavGrid, path: Path, *, level: int | None = None, route: Sequence[Route] = ()
) -> Files:
    """Encode an MCAP file: a message for each level, one for each path, and one for all links.

    Args:
        grid: the grid.
        path: the file, which ends in ``.mcap``.
        level: the number of the only level to write, without links; None for all.
        route: the paths to write, as `PathFinder.find_path` returns them.

    Returns:
        The file's content by its path.

    Raises:
        FormatError: there is no such level.
        MissingDependencyError: mcap-ros2-support is not installed.
    """
    mcap_writer = import_extra("mcap_ros2.writer", "mcap", "MCAP")
    level_numbers = select_levels(grid, path, level, (".mcap",))
    if any(planned_path is None for planned_path in route):
        raise FormatError("expected paths as `route`, got None: there is no path")
    file = io.BytesIO()
    with mcap_writer.Writer(file) as writer:
        messages = _Messages(writer)
        for level_number in level_numbers:
            grid_level = grid.levels[level_number]
            x_min, y_min, _, _ = grid_level.lattice.bounds
            map_info = {
                "resolution": grid_level.lattice.cell_size,
                "origin": _make_pose([x_min, y_min, grid_level.ground]),
                "width": grid_level.width,
                "height": grid_level.height,
            }
            # a message begins at the bottom
            values = compute_occupancy_values(grid, level_number)[::-1]
            message = {"header": MAP_FRAME, "info": map_info, "data": values.ravel().tolist()}
            topic = "/map" if len(level_numbers) == 1 else f"/map_{level_number}"
            messages.write(topic, "nav_msgs/OccupancyGrid", message)
        for path_number, planned_path in enumerate(route):
            path_message = _make_path(planned_path.positions)
            messages.write(f"/path_{path_number}", "nav_msgs/Path", path_message)
        if len(level_numbers) == len(grid.levels):
            markers = list(_make_markers(grid))
            if markers:
                messages.write("/links", "visualization_msgs/MarkerArray", {"markers": markers})
    return {path: file.getvalue()}


def encode_flight(flight: FlightPath, voxels: VoxelGrid | None = None) -> bytes:
    """Encode a path through voxels as an MCAP file.

    Args:
        flight: the path.
        voxels: voxels to show; None for none.

    Raises:
        MissingDependencyError: mcap-ros2-support is not installed.
    """
    mcap_writer = import_extra("mcap_ros2.writer", "mcap", "MCAP")
    file = io.BytesIO()
    with mcap_writer.Writer(file) as writer:
        messages = _Messages(writer)
        messages.write("/path_0", "nav_msgs/Path", _make_path(flight.positions))
        if voxels is not None:
            marker = _make_voxel_marker(voxels)
            messages.write("/voxels", "visualization_msgs/MarkerArray", {"markers": [marker]})
    return file.getvalue()


class _Messages:
    """Writes messages to an MCAP file; each type is registered when it is first written."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._schemas = dict[str, Any]()

    def write(self, topic: str, message_type: str, message: Json) -> None:
        if message_type not in self._schemas:
            name = message_type.replace("/", "/msg/")
            definition = define_message(message_type)
            self._schemas[message_type] = self._writer.register_msgdef(name, definition)
        schema = self._schemas[message_type]
        self._writer.write_message(topic, schema, message, log_time=0, publish_time=0)


def _make_path(positions: Float) -> Json:
    """Make a ``nav_msgs/Path`` of positions, shape (n, 3) [m]; its poses head along the path."""
    poses = [
        {"header": MAP_FRAME, "pose": _make_pose(position, heading)}
        for position, heading in zip(positions, find_headings(positions), strict=True)
    ]
    return {"header": MAP_FRAME, "poses": poses}


def _make_voxel_marker(voxels: VoxelGrid) -> Json:
    """Make a marker with a cube for each occupied voxel that has an empty one beside it."""
    occupied = np.pad(voxels.occupied, 1, constant_values=True)
    is_covered = np.ones(voxels.shape, dtype=np.bool_)
    for axis in range(3):
        for shift in (-1, 1):
            neighbors = np.roll(occupied, shift, axis=axis)
            is_covered &= neighbors[1:-1, 1:-1, 1:-1]
    at_surface = np.argwhere(voxels.occupied & ~is_covered)
    centers = (at_surface + 0.5) * voxels.res + np.array(voxels.origin)
    return {
        "header": MAP_FRAME,
        "ns": "voxels",
        "type": CUBE_LIST,
        "pose": {"orientation": NO_ROTATION},
        "scale": {"x": voxels.res, "y": voxels.res, "z": voxels.res},
        "color": VOXEL_COLOR,
        "points": [_make_point(center) for center in centers.tolist()],
    }


def _make_markers(grid: NavGrid) -> Iterator[Json]:
    """Yield markers of lines: one for all steps, then one for each named link.

    The first is in the namespace ``links``, each other one in a namespace of the link's name.
    """
    # both ends of each step
    level, cell_id = grid.step_array.reshape(-1, 2).T
    width = np.array([grid_level.width for grid_level in grid.levels])[level]
    row, col = np.divmod(cell_id, width)
    step_end_positions = grid.position_of((level, row, col))
    lines_of_namespaces: list[
        tuple[str, list[Sequence[float]]]
    ] = []  # (namespace, both ends of each line)
    if len(step_end_positions):
        lines_of_namespaces.append(("links", list(step_end_positions)))
    for link in grid.links:
        stop_positions = [stop.position for stop in link.stops]
        lines_of_namespaces.append((link.name, list(chain.from_iterable(pairwise(stop_positions)))))
    for marker_id, (namespace, line_ends) in enumerate(lines_of_namespaces):
        yield {
            "header": MAP_FRAME,
            "ns": namespace,
            "id": marker_id,
            "type": LINE_LIST,
            "pose": {"orientation": NO_ROTATION},
            "scale": {"x": LINE_WIDTH},
            "color": LINE_COLOR,
            "points": [_make_point(line_end) for line_end in line_ends],
        }


def _make_point(position: Iterable[float]) -> Json:
    x, y, z = position
    return {"x": float(x), "y": float(y), "z": float(z)}


def _make_pose(position: Iterable[float], heading: float = 0.0) -> Json:
    """Make a ``geometry_msgs/Pose`` at a position [m] with a heading about z, from x [rad]."""
    orientation = {"z": math.sin(heading / 2), "w": math.cos(heading / 2)}
    return {"position": _make_point(position), "orientation": orientation}


def find_headings(positions: Float) -> list[float]:
    """Find the heading at each point of a path: the direction to the next point, seen from above.

    Points straight above or below are skipped, as in a lift. The points at the path's end keep the
    last heading. A path that only rises has the heading 0.

    Args:
        positions: the path's points, shape (n, 3) [m].

    Returns:
        n angles about z, from x [rad].
    """
    headings: list[float] = []
    num_pending = 0  # points that wait for the heading of the next horizontal step
    for start, end in pairwise(positions[:, :2].tolist()):
        num_pending += 1
        if start != end:
            heading = math.atan2(end[1] - start[1], end[0] - start[0])
            headings += num_pending * [heading]
            num_pending = 0
    last_heading = headings[-1] if headings else 0.0
    return headings + (len(positions) - len(headings)) * [last_heading]


def define_message(message_type: str) -> str:
    """Return the text that defines a ROS 2 message, with the messages that it contains.

    Args:
        message_type: its type, such as ``nav_msgs/Path``.
    """
    definitions: dict[str, str] = {}

    def add_type(name: str) -> None:
        definitions[name] = MESSAGES[name].replace("; ", "\n") + "\n"
        for field in MESSAGES[name].split("; "):
            field_type = field.split()[0].removesuffix("[]")
            if field_type in MESSAGES and field_type not in definitions:
                add_type(field_type)

    add_type(message_type)
    separator = "=" * 80
    text = definitions.pop(message_type)
    for name, definition in definitions.items():
        text += f"{separator}\nMSG: {name}\n{definition}"
    return text
