"""Rooms and walkable areas as polygons along cells' edges, and doors as lines.

They are written as GeoJSON and WKT, and rooms are read from GeoJSON. Coordinates are the world's
x, y in metres, unlike RFC 7946's longitude and latitude.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError, QueryError
from navbake.files import encode_csv
from navbake.formats.allowance import format_value
from navbake.formats.source import Files, format_path, import_extra, read_json
from navbake.lazy import lazy
from navbake.navgrid.door_states import find_leaf_ends
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.lattice import Lattice, find_outline_fault, rounded
from navbake.types import Float, Int, Json, JsonValue

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

ndimage = lazy("scipy.ndimage")

ROOM = "room"
WALKABLE = "walkable"
DOOR = "door"
KINDS = (ROOM, WALKABLE, DOOR)
DECIMALS = 9  # of coordinates: a nanometre
MIN_ROUNDED_EDGE = 1e-6  # below this edge of a cell, coordinates keep all digits [m]
COLUMNS = ("kind", "level", "levelName", "height", "id", "name", "area")


@dataclass(frozen=True, eq=False)
class Shape:
    """A room, the walkable area of a level, or a door, seen from above.

    Attributes:
        kind: ``room``, ``walkable`` (a walkable area) or ``door``.
        level: the number of its level, 0 is the lowest.
        level_name: the level's name.
        height: world z of the level's ground [m].
        id: the id of a room or door, unique among those of the grid; None for a walkable area.
        name: the name of a room, None if it has none.
        area: the area of the shape's cells [m²]; 0 for a door.
        parts: for each part of a room or walkable area, a list of its rings: the outer ring, then
            the holes. A ring is world x, y of its corners [m], shape (n, 2), float64, the first one
            not repeated. Outer rings run anticlockwise, holes clockwise. Empty for a door.
        line: both ends of a door, world x, y [m], shape (2, 2), float64; None for other kinds.
        more: further properties: ``outdoors`` of a room; ``state`` and ``rooms`` of a door.
    """

    kind: str
    level: int
    level_name: str
    height: float
    id: str | None
    name: str | None
    area: float
    parts: list[list[Float]]
    line: Float | None
    more: Json

    @property
    def geometry(self) -> BaseGeometry:
        """The shape as a valid Polygon, MultiPolygon or LineString of shapely [m].

        Raises:
            MissingDependencyError: shapely is not installed.
        """
        shapely = import_extra("shapely")
        if self.line is not None:
            line: BaseGeometry = shapely.LineString(self.line)
            return line
        polygons = [shapely.Polygon(rings[0], rings[1:]) for rings in self.parts]
        if len(polygons) == 1:
            polygon: BaseGeometry = polygons[0]
            return polygon
        multi_polygon: BaseGeometry = shapely.MultiPolygon(polygons)
        return multi_polygon

    @property
    def properties(self) -> Json:
        """The attributes except the geometry, as a JSON object; see `to_geojson`."""
        return {
            "kind": self.kind,
            "level": self.level,
            "levelName": self.level_name,
            "height": self.height,
            "id": self.id,
            "name": self.name,
            "area": self.area,
            **self.more,
        }


def find_shapes(grid: NavGrid, kinds: Collection[str] = KINDS) -> list[Shape]:
    """Find the rooms and walkable areas of a grid as polygons, and its doors as lines.

    Polygons run exactly along the cells' edges. A room's polygon encloses all of its cells, also
    occupied ones; a walkable area's polygon encloses the free cells of a level. Cells that only
    touch at a corner belong to separate parts, so polygons are valid. A door is a line from jamb to
    jamb along its closed leaf, or along its leaf in the current state if it has no closed one; see
    `navbake.navgrid.door_states.find_leaf_ends`.

    Args:
        grid: the grid.
        kinds: the kinds of shapes to find, of ``room``, ``walkable`` and ``door``.

    Returns:
        For each level, lowest first: its rooms by index, its walkable area (none without free
        cells), and its doors. A door of two levels is on both.

    Raises:
        QueryError: a kind is unknown.
    """
    unknown_kinds = sorted(set(kinds) - set(KINDS))
    if isinstance(kinds, str) or unknown_kinds:
        expected = f"some of {', '.join(KINDS)}"
        raise QueryError(
            f"expected {expected} as kinds, got {kinds!r}",
            key="kinds",
            value=kinds,
            expected=expected,
        )
    shapes: list[Shape] = []
    for level_number, level in enumerate(grid.levels):
        level_name = grid.level_names[level_number]
        height = rounded(level.ground)
        cell_area = level.lattice.cell_size**2
        if ROOM in kinds:
            rooms = {room.index: room for room in grid.rooms if room.level == level_number}
            num_cells_of_room = np.bincount(level.room_index.ravel())  # of each room
            for room_index, parts in trace_polygons(level.room_index, level.lattice).items():
                room = rooms.get(room_index)
                room_name = None
                if room and room.name:
                    room_name = room.name
                shape = Shape(
                    kind=ROOM,
                    level=level_number,
                    level_name=level_name,
                    height=height,
                    id=room.id if room else f"{level_number}:{room_index}",
                    name=room_name,
                    area=rounded(int(num_cells_of_room[room_index]) * cell_area),
                    parts=parts,
                    line=None,
                    more={"outdoors": True} if room and room.outdoors else {},
                )
                shapes.append(shape)
        if WALKABLE in kinds and level.free.any():
            shape = Shape(
                kind=WALKABLE,
                level=level_number,
                level_name=level_name,
                height=height,
                id=None,
                name=None,
                area=rounded(int(np.count_nonzero(level.free)) * cell_area),
                parts=trace_polygons(level.free, level.lattice)[1],
                line=None,
                more={},
            )
            shapes.append(shape)
        for door in grid.doors if DOOR in kinds else ():
            leaf_ends = find_leaf_ends(grid, door, level_number)
            if leaf_ends is None:
                continue
            shape = Shape(
                kind=DOOR,
                level=level_number,
                level_name=level_name,
                height=height,
                id=door.id,
                name=None,
                area=0.0,
                parts=[],
                line=np.array(leaf_ends),
                more={"state": door.state, "rooms": list(door.rooms)},
            )
            shapes.append(shape)
    return shapes


# ---------------------------------------------------------------- outlines


def trace_polygons(labels: NDArray[Any], lattice: Lattice) -> dict[int, list[list[Float]]]:
    """Trace the outlines of labelled cells exactly along the cells' edges.

    A part is a group of cells of one label that are connected by their edges. No ring has a corner
    twice, and rings of one label meet at single corners at most. So each part is a valid polygon,
    and all parts of a label are a valid multipolygon (OGC simple features).

    Args:
        labels: the label of each cell, shape (height, width), from 1; 0 for none.
        lattice: the lattice of the cells.

    Returns:
        Label, ascending -> its parts, in the order of their first cells. A part is a list of rings,
        see `Shape.parts`; coordinates are rounded to a nanometre.
    """
    labels = np.asarray(labels, dtype=np.int32)
    parts_by_label: dict[int, list[list[Float]]] = {}
    for label, window in enumerate(ndimage.find_objects(labels), 1):
        if window is None:
            continue
        part_numbers, num_parts = ndimage.label(labels[window] == label)
        first_row = window[0].start
        first_col = window[1].start
        parts: list[list[Float]] = [[] for _ in range(num_parts)]
        for part_number, corners in _trace_rings(part_numbers):
            x = lattice.x_min + (corners[:, 1] + first_col) * lattice.cell_size
            y = lattice.y_max - (corners[:, 0] + first_row) * lattice.cell_size
            ring_points = np.stack([x, y], axis=-1)
            if lattice.cell_size > MIN_ROUNDED_EDGE:
                ring_points = np.round(ring_points, DECIMALS)
            parts[part_number - 1].append(ring_points + 0.0)  # no -0.0
        parts_by_label[label] = parts
    return parts_by_label


def _trace_rings(part_numbers: NDArray[np.int32]) -> Iterator[tuple[int, Int]]:
    """Yield the rings around parts of cells.

    This is contour following with crack codes (Freeman 1961; Rosenfeld and Kak, Digital Picture
    Processing, 1982). Each side between a cell and a neighbour of another part belongs to a walk
    round the part, with the cell on the left. The walk turns right if a cell of the same part lies
    ahead on the right, even if that touches the present cell only at a corner. It goes straight on
    if a cell of the part lies ahead, and turns left otherwise. So no ring has a corner twice.

    Args:
        part_numbers: the number of each cell's part, from 1; 0 for none; shape (height, width).

    Yields:
        For each ring, the number of its part, and its corners: row and column, shape (n, 2), where
        0, 0 is the upper left corner of the first cell. Seen with rows downwards, outer rings run
        anticlockwise and holes clockwise. The outer ring of a part comes before its holes.
    """
    padded_part_numbers = np.pad(part_numbers, 1)
    part_of_cell = padded_part_numbers.ravel()  # of each cell, by flat index
    width = padded_part_numbers.shape[1]
    # directions 0 to 3 lead east, north, west, south, along a cell's south, east, north, west
    # side; a left turn adds 1
    index_offset_ahead = np.array([1, -width, -1, width])
    index_offset_right = np.array([width, 1, -width, -1])
    cells, directions = np.divmod(np.arange(4 * part_of_cell.size), 4)
    part_on_right = part_of_cell[(cells + index_offset_right[directions]) % part_of_cell.size]
    side_ids = np.flatnonzero((part_of_cell[cells] > 0) & (part_of_cell[cells] != part_on_right))
    cells = cells[side_ids]
    directions = directions[side_ids]

    cell_ahead = cells + index_offset_ahead[directions]
    cell_ahead_right = cell_ahead + index_offset_right[directions]
    turns_right = part_of_cell[cell_ahead_right] == part_of_cell[cells]
    goes_straight = part_of_cell[cell_ahead] == part_of_cell[cells]
    next_cell = np.where(turns_right, cell_ahead_right, np.where(goes_straight, cell_ahead, cells))
    num_left_turns = np.where(turns_right, 3, np.where(goes_straight, 0, 1))
    next_direction = (directions + num_left_turns) % 4
    next_side = np.searchsorted(side_ids, 4 * next_cell + next_direction).tolist()
    is_corner = (next_direction != directions).tolist()

    # the corner where a side ends; the border doesn't count
    row, col = np.divmod(cells, width)
    end_row = row + np.array([0, -1, -1, 0])[directions]
    end_col = col + np.array([0, 0, -1, -1])[directions]
    end_corners = np.stack([end_row, end_col], axis=1)
    is_done = np.zeros(len(side_ids), dtype=np.bool_)
    for first_side in np.flatnonzero(directions == 2).tolist():  # each ring has a side to the north
        if is_done[first_side]:
            continue
        ring_sides = []
        side = first_side
        while not is_done[side]:
            is_done[side] = True
            if is_corner[side]:
                ring_sides.append(side)
            side = next_side[side]
        yield int(part_of_cell[cells[first_side]]), end_corners[ring_sides]


# ---------------------------------------------------------------- files


def to_geojson(grid: NavGrid, kinds: Collection[str] = KINDS) -> Json:
    """Describe a grid's shapes as a FeatureCollection.

    A room or a walkable area is a Polygon or MultiPolygon, a door a LineString, in world x, y [m].
    Properties are ``kind``, ``level``, ``levelName``, ``height`` (of the level's ground [m]),
    ``id``, ``name`` and ``area`` [m²]; ``outdoors`` of rooms, ``state`` and ``rooms`` of doors.

    Args:
        grid: the grid.
        kinds: the kinds of shapes to describe, of ``room``, ``walkable`` and ``door``.

    Returns:
        The FeatureCollection as JSON.

    Raises:
        QueryError: a kind is unknown.
    """
    features = []
    for shape in find_shapes(grid, kinds):
        polygons = [[_close_ring(ring) for ring in part] for part in shape.parts]
        geometry: Json
        if shape.line is not None:
            geometry = {"type": "LineString", "coordinates": shape.line.tolist()}
        elif len(polygons) == 1:
            geometry = {"type": "Polygon", "coordinates": polygons[0]}
        else:
            geometry = {"type": "MultiPolygon", "coordinates": polygons}
        features.append({"type": "Feature", "geometry": geometry, "properties": shape.properties})
    file_info = {
        "sceneId": grid.scene_id,
        "frame": "world x, y in metres",
        "cellSize": grid.levels[0].lattice.cell_size,
    }
    return {"type": "FeatureCollection", "navbake": file_info, "features": features}


def _close_ring(ring: Float) -> list[list[float]]:
    """Return the corners of a ring; as GeoJSON demands, the first one is repeated at the end."""
    corners: list[list[float]] = ring.tolist()
    return [*corners, ring[0].tolist()]


def encode_geojson(grid: NavGrid, path: Path) -> Files:
    """Encode the FeatureCollection of `to_geojson`.

    Args:
        grid: the grid.
        path: the path of the file.

    Returns:
        The file's content by its path.
    """
    return {path: orjson.dumps(to_geojson(grid), option=orjson.OPT_APPEND_NEWLINE)}


def encode_wkt(grid: NavGrid, path: Path) -> Files:
    """Encode a grid's shapes as a CSV for GDAL, QGIS, PostGIS and pandas.

    Its columns are ``WKT`` (OGC simple features) and then the properties that all features of
    `to_geojson` have.

    Args:
        grid: the grid.
        path: the path of the file.

    Returns:
        The file's content by its path.

    Raises:
        MissingDependencyError: shapely is not installed.
    """
    shapely = import_extra("shapely")
    rows: list[list[object]] = [["WKT", *COLUMNS]]
    for shape in find_shapes(grid):
        wkt = shapely.to_wkt(shape.geometry, rounding_precision=DECIMALS)
        rows.append([wkt, *(shape.properties[column] for column in COLUMNS)])
    return {path: encode_csv(rows)}


def read_room_outlines(path: str | os.PathLike[str]) -> list[Json]:
    """Read the polygons of a GeoJSON file: a FeatureCollection, or a single Feature.

    Coordinates are world x, y in metres; a third one is ignored. The properties are ``name``
    (text), ``level`` (a number from 0, or a name; 0 if missing) and ``outdoors`` (false if
    missing). Features of ``kind`` ``walkable`` or ``door`` are left out. A MultiPolygon is one
    room. Rings may be closed or not.

    Args:
        path: the file.

    Returns:
        For each polygon an object with ``name``, ``level``, ``outdoors``, ``points`` (the first
        outline) and ``rings`` (holes and further parts).

    Raises:
        FormatError: the file is broken; the error names the feature.
    """
    outlines: list[Json] = []
    for feature_number, feature in enumerate(_read_features(path)):
        place = _FeaturePlace(str(path), f"feature {feature_number}")
        is_feature = isinstance(feature, dict) and feature.get("type") == "Feature"
        place.check(is_feature, "a Feature", feature)
        properties = feature.get("properties")
        if properties is None:
            properties = {}
        place.check(isinstance(properties, dict), "an object at `properties`", properties)
        if properties.get("kind") in KINDS[1:]:
            continue
        name = properties.get("name")
        level = properties.get("level", 0)
        outdoors = properties.get("outdoors")
        geometry = feature.get("geometry")
        is_name = name is None or (isinstance(name, str) and name != "")
        place.check(is_name, "text at `properties.name`", name)
        if name is not None:
            place = _FeaturePlace(str(path), f"feature {feature_number} ({name!r})")
        if isinstance(level, float) and level.is_integer():
            level = int(level)
        is_level = level != "" if isinstance(level, str) else type(level) is int and level >= 0
        place.check(is_level, "a level's number from 0, or its name, at `properties.level`", level)
        is_flag_or_missing = isinstance(outdoors, bool | None)
        place.check(is_flag_or_missing, "true or false at `properties.outdoors`", outdoors)
        geometry_type = geometry.get("type") if isinstance(geometry, dict) else None
        points, *rings = _read_rings(geometry, geometry_type, place)
        outlines.append(
            {
                "name": name,
                "level": level,
                "outdoors": bool(outdoors),
                "points": points,
                "rings": rings,
            }
        )
    return outlines


def read_links_or_areas(path: str | os.PathLike[str], section: str) -> list[Json]:
    """Read the entries of the settings' `areas` or `links` from a JSON or GeoJSON file.

    A JSON file is a list of entries. In GeoJSON, each Feature is an entry, and its properties are
    the entry's keys. Its geometry, if there is one, becomes further keys: a Polygon or MultiPolygon
    becomes the `polygon` and `rings` of an area; a LineString or MultiPoint with x, y, z becomes
    the `stops` of a link.

    Args:
        path: the file.
        section: ``areas`` or ``links``.

    Returns:
        The entries, which are not checked yet.

    Raises:
        FormatError: the file is broken; the error names the feature.
    """
    entries = []
    for feature_number, feature in enumerate(_read_features(path, accepts_lists=True)):
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            entries.append(feature)
            continue
        place = _FeaturePlace(str(path), f"feature {feature_number}")
        geometry = feature.get("geometry")
        geometry_type = geometry.get("type") if isinstance(geometry, dict) else None
        properties = feature.get("properties")
        is_object = isinstance(properties, dict | None)
        place.check(is_object, "an object at `properties`", properties)
        entry = dict(properties or {})
        if section == "links" and geometry is not None:
            is_line = geometry_type in ("LineString", "MultiPoint")
            place.check(is_line, "a LineString or MultiPoint", geometry_type)
            entry["stops"] = geometry.get("coordinates")
        elif geometry is not None:
            polygon, *rings = _read_rings(geometry, geometry_type, place)
            entry["polygon"] = polygon
            entry["rings"] = rings
        entries.append(entry)
    return entries


class _FeaturePlace(NamedTuple):
    """The location of a feature in a file, as errors name it."""

    file: str
    feature: str  # such as ``feature 3 ('Kitchen')``; "" for the file itself

    def __str__(self) -> str:
        return f"{self.feature} of {self.file}" if self.feature else self.file

    def fail(self, message: str, value: object = None, expected: str | None = None) -> NoReturn:
        """Raise a FormatError with this location."""
        raise FormatError(
            f"{message} in {self}",
            path=self.file,
            value=value,
            expected=expected,
            place=self.feature or None,
        )

    def check(self, is_valid: bool, expected: str, value: object) -> None:
        """Raise a FormatError with this location if a value is not valid.

        Args:
            is_valid: whether the value is valid.
            expected: what was expected, for the error.
            value: the value, as parsed.
        """
        if is_valid:
            return
        if value is None:
            actual_text = "none"
        elif isinstance(value, str):
            actual_text = value[:60]
        elif isinstance(value, dict | list):
            actual_text = format_value(value)
        else:
            actual_text = repr(value)[:60]
        self.fail(f"expected {expected}, got {actual_text}", value, expected)


def _read_features(path: str | os.PathLike[str], *, accepts_lists: bool = False) -> list[JsonValue]:
    """Read the features of a GeoJSON file, or the entries of a JSON list if these are accepted."""
    if not os.path.lexists(path):
        raise FormatError(f"no such file: {format_path(path)}", path=str(path))
    content, _ = read_json(path, expected="a GeoJSON FeatureCollection")
    if accepts_lists and isinstance(content, list):
        return content
    content_type = content.get("type") if isinstance(content, dict) else None
    features = [content] if content_type == "Feature" else None
    if content_type == "FeatureCollection":
        features = content.get("features")
    file_place = _FeaturePlace(str(path), "")
    file_place.check(isinstance(features, list), "a GeoJSON FeatureCollection", content_type)
    return features or []


def _read_rings(
    geometry: JsonValue, geometry_type: JsonValue, place: _FeaturePlace
) -> list[list[list[float]]]:
    """Return all rings of a Polygon or MultiPolygon, the first outline first."""
    is_polygon = geometry_type in ("Polygon", "MultiPolygon")
    place.check(is_polygon, "a Polygon or MultiPolygon", geometry_type)
    polygons = geometry.get("coordinates")
    if geometry_type == "Polygon":
        polygons = [polygons]
    are_lists = isinstance(polygons, list) and all(isinstance(part, list) for part in polygons)
    place.check(are_lists, "lists of rings at `coordinates`", polygons)
    rings = []
    for ring in chain.from_iterable(polygons):
        if not isinstance(ring, list) or not all(map(_is_position, ring)):
            place.fail("expected a ring of positions [x, y]", ring, "a ring of positions [x, y]")
        points = [[float(x), float(y)] for x, y, *_ in ring]
        if len(points) > 1 and points[0] == points[-1]:
            points.pop()
        if len(points) < 3:
            expected = "a ring of 3 corners or more"
            place.fail(f"expected {expected}, got {len(points)}", len(points), expected)
        fault = find_outline_fault(points)
        if fault:
            place.fail(f"expected a simple outline, got {fault}", expected="a simple outline")
        rings.append(points)
    place.check(bool(rings), "an outline", None)
    return rings


def _is_position(value: JsonValue) -> bool:
    """Whether a value is a list that begins with two numbers."""
    if not isinstance(value, list) or len(value) < 2:
        return False
    return all(type(coordinate) in (int, float) for coordinate in value[:2])
