"""MCAP files of ROS 2 messages, which Foxglove, rerun and ``ros2 bag play`` open.

Topics: ``/map``, or ``/map_0`` and on of several levels, with a ``nav_msgs/OccupancyGrid`` at the
level's height; ``/path_0`` and on with a ``nav_msgs/Path`` each; and ``/links`` with a
``visualization_msgs/MarkerArray`` of the steps between levels and, from stop to stop, of the named
links. Frames are ``map``, times are 0.

Source: the definitions of messages of ROS 2 Humble; ``mcap_ros2`` encodes them.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from navbake.errors import FormatError
from navbake.formats.convert import select_levels
from navbake.formats.occupancy import compute_occupancy_values
from navbake.formats.source import Files, import_extra
from navbake.navgrid.grid import NavGrid
from navbake.runtime.paths import Path as Route
from navbake.types import Json

# fields of messages by type, ``name: type`` as in ROS' own definitions
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
FRAME = {"frame_id": "map"}
UPRIGHT = {"w": 1.0}  # a quaternion
LINE_LIST = 5  # type of a marker: a line between each two points
LINE = 0.03  # width of a line [m]
COLOR = {"r": 0.9, "g": 0.5, "b": 0.1, "a": 1.0}


def encode_mcap(
    grid: NavGrid, path: Path, *, level: int | None = None, route: Sequence[Route] = ()
) -> Files:
    """Encode a file of a message for each level, for each path, and for all links.

    Args:
        path: ends in ``.mcap``.
        level: the map of this level only, without links.
        route: paths of `PathFinder.find_path`.

    Raises:
        FormatError: there is no such level.
        MissingDependencyError: mcap-ros2-support is not installed.
    """
    writing: Any = import_extra("mcap_ros2.writer", "mcap", "MCAP")
    chosen = select_levels(grid, path, level, (".mcap",))
    if any(found is None for found in route):
        raise FormatError("expected paths as `route`, got None: there is no path")
    file = io.BytesIO()
    schemas = dict[str, Any]()
    with writing.Writer(file) as writer:

        def write(topic: str, kind: str, message: Json) -> None:
            if kind not in schemas:
                name = kind.replace("/", "/msg/")
                schemas[kind] = writer.register_msgdef(name, define_message(kind))
            writer.write_message(topic, schemas[kind], message, log_time=0, publish_time=0)

        for number in chosen:
            own = grid.levels[number]
            x, y = own.lattice.bounds[:2]
            origin = {"position": _point([x, y, own.ground]), "orientation": UPRIGHT}
            info = {"resolution": own.lattice.cell_size, "origin": origin}
            info |= {"width": own.width, "height": own.height}
            values = (
                compute_occupancy_values(grid, number)[::-1].ravel().tolist()
            )  # row 0 at the bottom
            topic = "/map" if len(chosen) == 1 else f"/map_{number}"
            map_of_level = {"header": FRAME, "info": info, "data": values}
            write(topic, "nav_msgs/OccupancyGrid", map_of_level)
        for number, found in enumerate(route):
            poses = [
                {"header": FRAME, "pose": {"position": _point(place), "orientation": UPRIGHT}}
                for place in found.positions
            ]
            write(f"/path_{number}", "nav_msgs/Path", {"header": FRAME, "poses": poses})
        markers = [*_markers(grid)] if len(chosen) == len(grid.levels) else []
        if markers:
            write("/links", "visualization_msgs/MarkerArray", {"markers": markers})
    return {path: file.getvalue()}


def _markers(grid: NavGrid) -> Iterator[Json]:
    """Lines of the steps, in the namespace ``links``, then of each named link, in its own."""
    level, cell = grid.step_array.reshape(-1, 2).T
    width = np.array([level.width for level in grid.levels])[level]
    steps = grid.position_of((level, *np.divmod(cell, width)))
    lines = [("links", [*steps])] if len(steps) else []
    for link in grid.links:
        places = [stop.position for stop in link.stops]
        lines.append((link.name, [*chain.from_iterable(pairwise(places))]))
    for number, (name, ends) in enumerate(lines):
        marker = {"header": FRAME, "ns": name, "id": number, "type": LINE_LIST}
        marker |= {"pose": {"orientation": UPRIGHT}, "scale": {"x": LINE}, "color": COLOR}
        yield marker | {"points": [_point(place) for place in ends]}


def _point(place: Any) -> Json:
    return dict(zip("xyz", map(float, place), strict=True))


def define_message(kind: str) -> str:
    """The definition of a message of ROS 2, with those of its parts."""
    parts: dict[str, str] = {}

    def add(name: str) -> None:
        parts[name] = MESSAGES[name].replace("; ", "\n") + "\n"
        for field in MESSAGES[name].split("; "):
            inner = field.split()[0].removesuffix("[]")
            if inner in MESSAGES and inner not in parts:
                add(inner)

    add(kind)
    first, *others = parts.items()
    line = "=" * 80
    return first[1] + "".join(f"{line}\nMSG: {name}\n{text}" for name, text in others)
