"""The shapes of a grid: rooms and walkable areas as polygons along cells' edges, doors as lines.

They are written as GeoJSON and WKT, and rooms are read from GeoJSON. Coordinates are the world's
x, y in metres, not the longitude and latitude that RFC 7946 is about.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError, QueryError
from navbake.files import encode_csv
from navbake.formats.allowance import shown
from navbake.formats.source import Files, import_extra, path_name, read_object
from navbake.navgrid.door_lines import find_ends
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.polygon import find_fault
from navbake.types import Float, Json

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

ROOM, WALKABLE, DOOR = "room", "walkable", "door"
KINDS = (ROOM, WALKABLE, DOOR)
DECIMALS = 9  # of coordinates: a nanometre
SMALLEST = 1e-6  # cells with an edge below this keep all digits [m]
COLUMNS = ("kind", "level", "levelName", "height", "id", "name", "area")

Ring = list[list[float]]


@dataclass(frozen=True, eq=False)
class Shape:
    """A room, the walkable area of a level, or a door, from above.

    Attributes:
        kind: ``room``, ``walkable`` or ``door``.
        level: its level, 0 is the lowest.
        level_name: the level's name.
        height: world z of the level's ground [m].
        id: of a room or door, unique among those of the grid, None for none.
        name: of a room, None for none.
        area: of the cells [m²]; 0 of a door.
        parts: of a polygon: for each part its rings, the outer one first, then the holes; each of
            shape (n, 2), float64, world x, y [m], the first corner not repeated. Outer rings run
            anticlockwise, holes clockwise.
        line: of a door: both ends, shape (2, 2), float64, world x, y [m]; None of others.
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
        """The shape for shapely: a Polygon, a MultiPolygon or a LineString, valid, in metres.

        Raises:
            MissingDependencyError: shapely is not installed.
        """
        shapely = import_extra("shapely")
        if self.line is not None:
            line: BaseGeometry = shapely.LineString(self.line)
            return line
        polygons = [shapely.Polygon(rings[0], rings[1:]) for rings in self.parts]
        joined: BaseGeometry = polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons)
        return joined

    @property
    def properties(self) -> Json:
        """All but the geometry, in values that JSON can hold."""
        named = {"levelName": self.level_name, "height": self.height, "id": self.id}
        own = {"kind": self.kind, "level": self.level, **named}
        return {**own, "name": self.name, "area": self.area, **self.more}


def find_shapes(grid: NavGrid, kinds: Collection[str] = KINDS) -> list[Shape]:
    """The rooms, walkable areas and doors of a grid as shapes.

    Polygons run exactly along the cells' edges: of a room, round all of its cells, also those that
    something stands in; of what is walkable, round the free cells of a level. A cell's centre lies
    in a polygon if and only if the polygon has the cell. Cells that only touch at a corner are
    parts of their own, so polygons are valid. A door is a line from jamb to jamb, where its leaf is
    when it is closed (else, as it is now); see `navbake.navgrid.door_lines.find_ends`.

    Args:
        grid: a grid of one or several levels.
        kinds: which shapes: ``room``, ``walkable``, ``door``.

    Returns:
        For each level, lowest first, its rooms by index, its walkable area (none where no cell is
        free), and its doors. A door of two levels is on both.

    Raises:
        QueryError: a kind is unknown.
    """
    unknown = sorted(set(kinds) - set(KINDS))
    if isinstance(kinds, str) or unknown:
        raise QueryError(f"expected some of {', '.join(KINDS)} as kinds, got {kinds!r}")
    shapes = []
    for number, level in enumerate(grid.levels):
        place = (number, grid.level_names[number], _rounded(level.ground))
        square = level.lattice.cell_size**2
        if ROOM in kinds:
            known = {room.index: room for room in grid.rooms if room.level == number}
            count = np.bincount(level.room_index.ravel())
            for index, parts in trace_polygons(level.room_index, level.lattice).items():
                room, area = known.get(index), _rounded(int(count[index]) * square)
                name = (room and room.name) or None
                room_id = room.id if room else f"{number}:{index}"
                more: Json = {"outdoors": True} if room and room.outdoors else {}
                shapes.append(Shape(ROOM, *place, room_id, name, area, parts, None, more))
        if WALKABLE in kinds and level.free.any():
            parts = trace_polygons(level.free, level.lattice)[1]
            area = _rounded(int(np.count_nonzero(level.free)) * square)
            shapes.append(Shape(WALKABLE, *place, None, None, area, parts, None, {}))
        for door in grid.doors if DOOR in kinds else ():
            ends = find_ends(grid, door, number)
            if ends is not None:
                more = {"state": door.state, "rooms": list(door.rooms)}
                shapes.append(Shape(DOOR, *place, door.id, None, 0.0, [], np.array(ends), more))
    return shapes


def _rounded(value: float) -> float:
    """To a micrometre, and without -0.0."""
    return round(float(value), 6) + 0.0


# ---------------------------------------------------------------- outlines


def trace_polygons(labels: NDArray[Any], lattice: Lattice) -> dict[int, list[list[Float]]]:
    """Trace the outlines of labelled cells, shape (height, width), exactly along the cells' edges.

    A part is cells of one label, 0 for none, that share edges. No ring has a corner twice, and
    rings of one label meet at single corners at most. So each part is a valid polygon, and all
    parts of a label a valid multipolygon (OGC simple features), whatever the cells are.

    Returns:
        By ascending label, its parts by their first cells in reading order; of each its rings, the
        outer one first, then the holes, as `Shape.parts` has them, to a nanometre.
    """
    from navbake.formats.kernels.outlines import trace_rings  # numba loads slowly
    from navbake.navgrid.kernels.connect import number_parts  # as above

    own = np.ascontiguousarray(labels, dtype=np.int32)
    cell = np.arange(own.size).reshape(own.shape)
    right, down = own[:, 1:] == own[:, :-1], own[1:] == own[:-1]
    pairs = np.stack([np.append(cell[:, 1:][right], cell[1:][down]),
                      np.append(cell[:, :-1][right], cell[:-1][down])])  # fmt: skip
    numbers = np.where(own, number_parts(pairs, own.size).reshape(own.shape) + 1, 0)
    numbers = np.pad(numbers.astype(np.int32), 1)
    inner = numbers[1:-1, 1:-1]
    beside = numbers[:-2, 1:-1], numbers[2:, 1:-1], numbers[1:-1, :-2], numbers[1:-1, 2:]
    num_sides = sum(np.count_nonzero((inner != other) & (inner > 0)) for other in beside)
    corners, start, part = trace_rings(numbers, num_sides)
    label_of = np.zeros(int(numbers.max()) + 1, dtype=np.int32)
    label_of[inner] = own
    # twice the areas of rings, by the shoelace formula; rows run against y
    row, col = corners.astype(np.int64).T
    after = np.arange(1, len(corners) + 1)
    after[start[1:] - 1] = start[:-1]  # of a ring's last corner, its first one
    cross = row * col[after] - col * row[after]
    is_hole = np.add.reduceat(cross, start[:-1]) < 0 if len(part) else np.zeros(0, np.bool_)
    x, y = lattice.x_min + col * lattice.cell_size, lattice.y_max - row * lattice.cell_size
    points = np.stack([x, y], axis=-1)
    if lattice.cell_size > SMALLEST:
        points = np.round(points, DECIMALS)
    rings = np.split(points + 0.0, start[1:-1])  # no -0.0
    found: dict[int, dict[int, list[Float]]] = {}
    for k in np.lexsort((is_hole, part, label_of[part])).tolist():
        parts = found.setdefault(int(label_of[part[k]]), {})
        parts.setdefault(int(part[k]), []).append(rings[k])
    return {label: list(parts.values()) for label, parts in found.items()}


# ---------------------------------------------------------------- files


def to_geojson(grid: NavGrid, kinds: Collection[str] = KINDS) -> Json:
    """Describe a grid's rooms, walkable areas and doors as a FeatureCollection, see `find_shapes`.

    A room or a walkable area is a Polygon or MultiPolygon, a door a LineString, in world x, y [m].
    Properties are ``kind``, ``level``, ``levelName``, ``height`` (of the level's ground [m]),
    ``id``, ``name`` and ``area`` [m²]; ``outdoors`` of rooms, ``state`` and ``rooms`` of doors.

    Args:
        grid: a grid of one or several levels.
        kinds: which features: ``room``, ``walkable``, ``door``.

    Raises:
        QueryError: a kind is unknown.
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
        own = {"type": "Feature", "geometry": geometry, "properties": shape.properties}
        features.append(own)
    about = {
        "sceneId": grid.scene_id,
        "frame": "world x, y in metres",
        "cellSize": grid.levels[0].lattice.cell_size,
    }
    return {"type": "FeatureCollection", "navbake": about, "features": features}


def encode_geojson(grid: NavGrid, path: Path) -> Files:
    """Make a GeoJSON file of all that `to_geojson` describes."""
    return {path: orjson.dumps(to_geojson(grid), option=orjson.OPT_APPEND_NEWLINE)}


def encode_wkt(grid: NavGrid, path: Path) -> Files:
    """Make a CSV of a grid's shapes, as GDAL, QGIS, PostGIS and pandas take it.

    Its columns are ``WKT`` (OGC simple features) and then the properties that all features of a
    GeoJSON of the grid have. Raises a MissingDependencyError without shapely.
    """
    shapely = import_extra("shapely")
    rows: list[list[Any]] = [["WKT", *COLUMNS]]
    for shape in find_shapes(grid):
        wkt = shapely.to_wkt(shape.geometry, rounding_precision=DECIMALS)
        rows.append([wkt, *(shape.properties[column] for column in COLUMNS)])
    return {path: encode_csv(rows)}


def read_room_outlines(path: str | os.PathLike[str]) -> list[Json]:
    """Read the polygons of a GeoJSON file: a FeatureCollection, or a single Feature.

    Coordinates are world x, y in metres; a third one is left out. Of the properties, ``name``
    (text), ``level`` (a number from 0, or a name; 0 if missing) and ``outdoors`` (false if missing)
    count. A feature whose ``kind`` is ``walkable`` or ``door`` is left out. A MultiPolygon is one
    room. Rings may be closed or not. Errors name the feature.

    Returns:
        ``name``, ``level``, ``outdoors``, ``points`` (the first outline) and ``rings`` (holes and
        further parts) of each.
    """
    if not os.path.lexists(path):
        raise FormatError(f"no such file: {path_name(path)}")
    content, _ = read_object(path, expected="a GeoJSON FeatureCollection")
    kind = content.get("type") if isinstance(content, dict) else None
    features = [content] if kind == "Feature" else None
    if kind == "FeatureCollection":
        features = content.get("features")
    if not isinstance(features, list):
        raise FormatError(f"expected a GeoJSON FeatureCollection in {path}, got {_shown(kind)}")
    found = (_read_feature(feature, f"feature {k} of {path}") for k, feature in enumerate(features))
    return [outline for outline in found if outline is not None]


def _read_feature(feature: Any, where: str) -> Json | None:
    """The outline of a feature; None where it says that it is something else than a room."""

    def check(is_good: bool, expected: str, value: Any) -> None:
        if not is_good:
            raise FormatError(f"expected {expected}, got {_shown(value)} {where}")

    properties = feature.get("properties") if isinstance(feature, dict) else None
    properties = {} if properties is None else properties
    if isinstance(properties, dict) and properties.get("kind") in KINDS[1:]:
        return None
    is_feature = isinstance(feature, dict) and feature.get("type") == "Feature"
    number, where = where, f"as {where}"
    check(is_feature, "a Feature", feature)
    where = f"in {number}"
    if not isinstance(properties, dict):
        raise FormatError(f"expected an object at `properties`, got {shown(properties)} {where}")
    name, level = properties.get("name"), properties.get("level", 0)
    check(name is None or (isinstance(name, str) and bool(name)), "text at `properties.name`", name)
    if name is not None:
        where = "in " + number.replace(" of ", f" ({name!r}) of ", 1)
    level = int(level) if isinstance(level, float) and level.is_integer() else level
    is_number = isinstance(level, int) and not isinstance(level, bool) and level >= 0
    expected = "a level's number from 0, or its name, at `properties.level`"
    check(is_number or (isinstance(level, str) and bool(level)), expected, level)
    outdoors = properties.get("outdoors")
    expected = "true or false at `properties.outdoors`"
    check(outdoors is None or isinstance(outdoors, bool), expected, outdoors)
    geometry = feature.get("geometry")
    geometry = geometry if isinstance(geometry, dict) else {}
    kind, polygons = geometry.get("type"), geometry.get("coordinates")
    check(kind in ("Polygon", "MultiPolygon"), "a Polygon or MultiPolygon", kind)
    polygons = [polygons] if kind == "Polygon" else polygons
    if not isinstance(polygons, list) or not all(isinstance(part, list) for part in polygons):
        raise FormatError(f"expected lists of rings at `coordinates` {where}")
    rings = [_read_ring(ring, where) for polygon in polygons for ring in polygon]
    if not rings:
        raise FormatError(f"expected an outline, got none {where}")
    about = {"name": name, "level": level, "outdoors": bool(outdoors)}
    return {**about, "points": rings[0], "rings": rings[1:]}


def _read_ring(ring: Any, where: str) -> Ring:
    def is_position(value: Any) -> bool:
        is_list = isinstance(value, list) and len(value) >= 2
        return is_list and all(type(v) in (int, float) and math.isfinite(v) for v in value[:2])

    if not isinstance(ring, list) or not all(map(is_position, ring)):
        raise FormatError(f"expected a ring of positions [x, y] {where}")
    points = [[float(x), float(y)] for x, y, *_ in ring]
    if len(points) > 1 and points[0] == points[-1]:
        points.pop()
    if len(points) < 3:
        raise FormatError(f"expected a ring of 3 corners or more, got {len(points)} {where}")
    if fault := find_fault(points):
        raise FormatError(f"expected a simple outline, got {fault} {where}")
    return points


def _shown(value: Any) -> str:
    return "none" if value is None else (value if isinstance(value, str) else repr(value))[:60]
