"""Rooms and walkable areas as polygons along cells' edges, and doors as lines.

They are written as GeoJSON and WKT, and rooms are read from GeoJSON. Coordinates are the world's
x, y in metres, unlike RFC 7946's longitude and latitude.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from navbake.types import Float, Int, Json

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

ndimage = lazy("scipy.ndimage")

ROOM = "room"
WALKABLE = "walkable"
DOOR = "door"
KINDS = (ROOM, WALKABLE, DOOR)
DECIMALS = 9  # of coordinates: a nanometre
SMALLEST = 1e-6  # cells with an edge below this keep all digits [m]
COLUMNS = ("kind", "level", "levelName", "height", "id", "name", "area")


@dataclass(frozen=True, eq=False)
class Shape:
    """A room, the walkable area of a level, or a door, from above."""

    kind: str  #: ``room``, ``walkable`` or ``door``.
    level: int  #: 0 is the lowest.
    level_name: str  #: The level's name.
    height: float  #: World z of the level's ground [m].
    id: str | None  #: Of a room or door, unique among those of the grid, None for none.
    name: str | None  #: Of a room, None for none.
    area: float  #: Of the cells [m²]; 0 of a door.
    #: Of a polygon: for each part its rings, the outer one first, then the holes; each of shape (n,
    #: 2), float64, world x, y [m], the first corner not repeated. Outer rings run anticlockwise,
    #: holes clockwise.
    parts: list[list[Float]]
    #: Of a door: both ends, shape (2, 2), float64, world x, y [m]; None of others.
    line: Float | None
    more: Json  #: Further properties: ``outdoors`` of a room; ``state`` and ``rooms`` of a door.

    @property
    def geometry(self) -> BaseGeometry:
        """The valid shapely Polygon, MultiPolygon or LineString [m], if shapely is installed."""
        shapely = import_extra("shapely")
        if self.line is not None:
            line: BaseGeometry = shapely.LineString(self.line)
            return line
        polygons = [shapely.Polygon(rings[0], rings[1:]) for rings in self.parts]
        made: BaseGeometry = shapely.MultiPolygon(polygons) if polygons[1:] else polygons[0]
        return made

    @property
    def properties(self) -> Json:
        """JSON of all but the geometry."""
        own = {"kind": self.kind, "level": self.level, "levelName": self.level_name}
        own |= {"height": self.height, "id": self.id, "name": self.name, "area": self.area}
        return {**own, **self.more}


def find_shapes(grid: NavGrid, kinds: Collection[str] = KINDS) -> list[Shape]:
    """The rooms, walkable areas and doors of a grid as shapes.

    Polygons run exactly along the cells' edges: of a room, round all of its cells, occupied ones
    too; of a walkable area, round the free cells of a level. A cell's centre lies in a polygon if
    and only if the polygon has the cell. Cells that only touch at a corner are separate parts, so
    polygons are valid. A door is a line from jamb to jamb along its closed leaf (else in its
    current state); see `navbake.navgrid.door_states.find_leaf_ends`.

    Returns for each level, lowest first, those of `kinds`: its rooms by index, its walkable area
    (none without free cells), and its doors. A door of two levels is on both. Raises a QueryError
    for an unknown kind.
    """
    unknown = sorted(set(kinds) - set(KINDS))
    if isinstance(kinds, str) or unknown:
        raise QueryError(f"expected some of {', '.join(KINDS)} as kinds, got {kinds!r}")
    shapes = []
    for number, level in enumerate(grid.levels):
        place = (number, grid.level_names[number], rounded(level.ground))
        square = level.lattice.cell_size**2
        if ROOM in kinds:
            known = {room.index: room for room in grid.rooms if room.level == number}
            count = np.bincount(level.room_index.ravel())
            for index, parts in trace_polygons(level.room_index, level.lattice).items():
                room = known.get(index)
                area = rounded(int(count[index]) * square)
                name = (room and room.name) or None
                room_id = room.id if room else f"{number}:{index}"
                more: Json = {"outdoors": True} if room and room.outdoors else {}
                shapes.append(Shape(ROOM, *place, room_id, name, area, parts, None, more))
        if WALKABLE in kinds and level.free.any():
            parts = trace_polygons(level.free, level.lattice)[1]
            area = rounded(int(np.count_nonzero(level.free)) * square)
            shapes.append(Shape(WALKABLE, *place, None, None, area, parts, None, {}))
        for door in grid.doors if DOOR in kinds else ():
            ends = find_leaf_ends(grid, door, number)
            if ends is not None:
                more = {"state": door.state, "rooms": list(door.rooms)}
                shapes.append(Shape(DOOR, *place, door.id, None, 0.0, [], np.array(ends), more))
    return shapes


# ---------------------------------------------------------------- outlines


def trace_polygons(labels: NDArray[Any], lattice: Lattice) -> dict[int, list[list[Float]]]:
    """Trace the outlines of labelled cells, shape (height, width), exactly along the cells' edges.

    A part is cells of one label, 0 for none, that share edges. No ring has a corner twice, and
    rings of one label meet at single corners at most. So each part is a valid polygon, and all
    parts of a label a valid multipolygon (OGC simple features). Returns by ascending label its
    parts by their first cells in reading order; each has rings as in `Shape.parts`, to a nanometre.
    """
    own = np.asarray(labels, dtype=np.int32)
    found: dict[int, list[list[Float]]] = {}
    for label, window in enumerate(ndimage.find_objects(own), 1):
        if window is None:
            continue
        numbers, count = ndimage.label(own[window] == label)
        parts: list[list[Float]] = [[] for _ in range(count)]
        for part, corners in _trace_rings(numbers):
            row, col = (corners + [first.start for first in window]).T
            points = np.stack([lattice.x_min + col * lattice.cell_size,
                               lattice.y_max - row * lattice.cell_size], axis=-1)  # fmt: skip
            if lattice.cell_size > SMALLEST:
                points = np.round(points, DECIMALS)
            parts[part - 1].append(points + 0.0)  # no -0.0
        found[label] = parts
    return found


def _trace_rings(parts: NDArray[np.int32]) -> Iterator[tuple[int, Int]]:
    """Yield the rings of parts of cells, (height, width), from 1: each ring's part and corners.

    Contour following with crack codes (Freeman 1961; Rosenfeld and Kak, Digital Picture Processing,
    1982). Each side between a cell and a neighbour of another part is a step with its cell on the
    left. A walk turns right if a cell of its part lies ahead on the right, even if it touches its
    own by a corner alone, goes on if one lies ahead, and else turns left. The cells of a part are
    connected by their sides, so the cells on both sides of such a corner aren't, and no ring has a
    corner twice.

    Corners are rows and columns, 0, 0 the upper left one of the first cell, shape (n, 2). Seen with
    rows downwards, outer rings run anticlockwise and holes clockwise; of a part, the outer one is
    first, then holes by their first sides below them in reading order.
    """
    padded = np.pad(parts, 1)
    own = padded.ravel()
    width = padded.shape[1]
    # ways: east, north, west, south, along the south, east, north, west side; a left turn is + 1
    ahead = np.array([1, -width, -1, width])
    right = np.array([width, 1, -width, -1])
    cell, way = np.divmod(np.arange(4 * own.size), 4)
    steps = np.flatnonzero((own[cell] > 0) & (own[cell] != own[(cell + right[way]) % own.size]))
    cell = cell[steps]
    way = way[steps]
    here = cell + ahead[way]
    beside = cell + ahead[way] + right[way]
    turns_right = own[beside] == own[cell]
    goes_on = own[here] == own[cell]
    next_cell = np.where(turns_right, beside, np.where(goes_on, here, cell))
    next_way = (way + np.where(turns_right, 3, np.where(goes_on, 0, 1))) % 4
    after = np.searchsorted(steps, 4 * next_cell + next_way).tolist()
    is_corner = (next_way != way).tolist()
    # where a step ends, from the upper left corner of its cell, less the border
    row, col = np.divmod(cell, width)
    ends = np.stack([row + np.array([0, -1, -1, 0])[way], col + np.array([0, 0, -1, -1])[way]], 1)
    done = np.zeros(len(steps), dtype=np.bool_)
    for first in np.flatnonzero(way == 2).tolist():  # each ring has a side to the north
        if done[first]:
            continue
        ring = []
        step = first
        while not done[step]:
            done[step] = True
            if is_corner[step]:
                ring.append(step)
            step = after[step]
        yield int(own[cell[first]]), ends[ring]


# ---------------------------------------------------------------- files


def to_geojson(grid: NavGrid, kinds: Collection[str] = KINDS) -> Json:
    """Describe a grid's shapes as a FeatureCollection; see `find_shapes` for `kinds` and errors.

    A room or a walkable area is a Polygon or MultiPolygon, a door a LineString, in world x, y [m].
    Properties are ``kind``, ``level``, ``levelName``, ``height`` (of the level's ground [m]),
    ``id``, ``name`` and ``area`` [m²]; ``outdoors`` of rooms, ``state`` and ``rooms`` of doors.
    """
    features = []
    for shape in find_shapes(grid, kinds):
        rings = [[[*ring.tolist(), ring[0].tolist()] for ring in part] for part in shape.parts]
        form: tuple[str, Any] = ("MultiPolygon", rings)
        if shape.line is not None:
            form = "LineString", shape.line.tolist()
        elif len(rings) == 1:
            form = "Polygon", rings[0]
        geometry = dict(zip(("type", "coordinates"), form, strict=True))
        features.append({"type": "Feature", "geometry": geometry, "properties": shape.properties})
    about = {
        "sceneId": grid.scene_id,
        "frame": "world x, y in metres",
        "cellSize": grid.levels[0].lattice.cell_size,
    }
    return {"type": "FeatureCollection", "navbake": about, "features": features}


def encode_geojson(grid: NavGrid, path: Path) -> Files:
    """Encode the FeatureCollection of `to_geojson`."""
    return {path: orjson.dumps(to_geojson(grid), option=orjson.OPT_APPEND_NEWLINE)}


def encode_wkt(grid: NavGrid, path: Path) -> Files:
    """Encode a grid's shapes as a CSV for GDAL, QGIS, PostGIS and pandas.

    Its columns are ``WKT`` (OGC simple features) and then the properties that all features of
    `to_geojson` have. Raises a MissingDependencyError without shapely.
    """
    shapely = import_extra("shapely")
    rows: list[list[Any]] = [["WKT", *COLUMNS]]
    for shape in find_shapes(grid):
        wkt = shapely.to_wkt(shape.geometry, rounding_precision=DECIMALS)
        rows.append([wkt, *(shape.properties[column] for column in COLUMNS)])
    return {path: encode_csv(rows)}


def read_room_outlines(path: str | os.PathLike[str]) -> list[Json]:
    """Read the polygons of a GeoJSON file: a FeatureCollection, or a single Feature.

    Coordinates are world x, y in metres; a third one is ignored. The properties are ``name``
    (text), ``level`` (a number from 0, or a name; 0 if missing) and ``outdoors`` (false if
    missing). Features of ``kind`` ``walkable`` or ``door`` are left out. A MultiPolygon is one
    room. Rings may be closed or not. Errors name the feature. Returns ``name``, ``level``,
    ``outdoors``, ``points`` (the first outline) and ``rings`` (holes and further parts) of each.
    """
    found: list[Json] = []
    for k, feature in enumerate(_read_features(path)):
        where = f"feature {k} of {path}"
        is_feature = isinstance(feature, dict) and feature.get("type") == "Feature"
        _check(is_feature, "a Feature", feature, where)
        properties = {} if feature.get("properties") is None else feature["properties"]
        _check(isinstance(properties, dict), "an object at `properties`", properties, where)
        if properties.get("kind") in KINDS[1:]:
            continue
        name = properties.get("name")
        level = properties.get("level", 0)
        outdoors = properties.get("outdoors")
        geometry = feature.get("geometry")
        is_name = name is None or (isinstance(name, str) and name != "")
        _check(is_name, "text at `properties.name`", name, where)
        where = where if name is None else f"feature {k} ({name!r}) of {path}"
        level = int(level) if isinstance(level, float) and level.is_integer() else level
        is_level = level != "" if isinstance(level, str) else type(level) is int and level >= 0
        expected = "a level's number from 0, or its name, at `properties.level`"
        _check(is_level, expected, level, where)
        is_flag = isinstance(outdoors, bool | None)
        _check(is_flag, "true or false at `properties.outdoors`", outdoors, where)
        kind = geometry.get("type") if isinstance(geometry, dict) else None
        points, *rings = _read_rings(geometry, kind, where)
        about = {"name": name, "level": level, "outdoors": bool(outdoors)}
        found.append({**about, "points": points, "rings": rings})
    return found


def read_links_or_areas(path: str | os.PathLike[str], section: str) -> list[Json]:
    """Read the entries of the settings' `areas` or `links` from a JSON or GeoJSON file.

    JSON has a list of them. GeoJSON has a Feature for each, whose properties are its keys: a
    Polygon or MultiPolygon is an area's `polygon` and `rings`, a LineString or MultiPoint with x,
    y, z a link's `stops`; without a geometry, the properties say all. Errors name the feature.
    """
    entries = []
    for k, feature in enumerate(_read_features(path, with_lists=True)):
        if isinstance(feature, dict) and feature.get("type") == "Feature":
            where = f"feature {k} of {path}"
            geometry = feature.get("geometry")
            kind = geometry.get("type") if isinstance(geometry, dict) else None
            properties = feature.get("properties")
            is_object = isinstance(properties, dict | None)
            _check(is_object, "an object at `properties`", properties, where)
            feature = dict(properties or {})
            if section == "links" and geometry is not None:
                is_line = kind in ("LineString", "MultiPoint")
                _check(is_line, "a LineString or MultiPoint", kind, where)
                feature["stops"] = geometry.get("coordinates")
            elif geometry is not None:
                feature["polygon"], *feature["rings"] = _read_rings(geometry, kind, where)
        entries.append(feature)
    return entries


def _read_features(path: str | os.PathLike[str], *, with_lists: bool = False) -> list[Any]:
    """The features of a GeoJSON file; or the list that a JSON file is, `with_lists`."""
    if not os.path.lexists(path):
        raise FormatError(f"no such file: {format_path(path)}")
    content, _ = read_json(path, expected="a GeoJSON FeatureCollection")
    if with_lists and isinstance(content, list):
        return content
    kind = content.get("type") if isinstance(content, dict) else None
    features = [content] if kind == "Feature" else None
    if kind == "FeatureCollection":
        features = content.get("features")
    _check(isinstance(features, list), "a GeoJSON FeatureCollection", kind, str(path))
    return features or []


def _read_rings(geometry: Any, kind: Any, where: str) -> list[list[list[float]]]:
    """All rings of a Polygon or MultiPolygon, the first outline first."""
    _check(kind in ("Polygon", "MultiPolygon"), "a Polygon or MultiPolygon", kind, where)
    polygons = geometry.get("coordinates")
    polygons = [polygons] if kind == "Polygon" else polygons
    are_lists = isinstance(polygons, list) and all(isinstance(part, list) for part in polygons)
    _check(are_lists, "lists of rings at `coordinates`", polygons, where)
    rings = []
    for ring in (ring for polygon in polygons for ring in polygon):
        if not isinstance(ring, list) or not all(
            isinstance(position, list)
            and len(position) >= 2
            and all(type(value) in (int, float) for value in position[:2])
            for position in ring
        ):
            raise FormatError(f"expected a ring of positions [x, y] in {where}")
        points = [[float(x), float(y)] for x, y, *_ in ring]
        if len(points) > 1 and points[0] == points[-1]:
            points.pop()
        if len(points) < 3:
            raise FormatError(f"expected a ring of 3 corners or more, got {len(points)} in {where}")
        if fault := find_outline_fault(points):
            raise FormatError(f"expected a simple outline, got {fault} in {where}")
        rings.append(points)
    _check(bool(rings), "an outline", None, where)
    return rings


def _check(is_good: bool, expected: str, value: object, where: str) -> None:
    """Raise a FormatError for a value of a feature that is not what was expected."""
    if not is_good:
        text = value if isinstance(value, str) else repr(value)
        text = format_value(value) if isinstance(value, dict | list) else text[:60]
        got = "none" if value is None else text
        raise FormatError(f"expected {expected}, got {got} in {where}")
