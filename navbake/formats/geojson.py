"""GeoJSON and WKT of a grid's rooms, walkable areas and doors, and rooms of GeoJSON files.

Coordinates are the world's x, y in metres, not the longitude and latitude that RFC 7946 is about.
"""

import csv
import io
import math
import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

import orjson

from navbake.errors import FormatError
from navbake.formats.allowance import shown
from navbake.formats.shapes import DECIMALS, KINDS, ROOM, Shape, find_shapes, import_shapely
from navbake.formats.source import Files, path_name, read_object
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.polygon import find_fault
from navbake.types import Float, Json

COLUMNS = ("kind", "level", "levelName", "height", "id", "name", "area")

Ring = list[list[float]]


def to_geojson(grid: NavGrid, kinds: Collection[str] = KINDS) -> Json:
    """Describe the rooms, walkable areas and doors of a grid as a FeatureCollection.

    Each is a feature: a room or a walkable area is a Polygon or MultiPolygon along the cells'
    edges, a door a LineString; see `navbake.formats.shapes.find_shapes`. Coordinates are
    world x, y [m]. Properties are ``kind``, ``level``, ``levelName``, ``height`` (of the level's
    ground [m]), ``id``, ``name`` and ``area`` [m²]; ``outdoors`` of rooms, ``state`` and ``rooms``
    of doors.

    Args:
        grid: a grid of one or several levels.
        kinds: which features: ``room``, ``walkable``, ``door``.

    Raises:
        QueryError: a kind is unknown.
    """
    features = [_feature(shape) for shape in find_shapes(grid, kinds)]
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

    WKT (OGC simple features) itself has no place for names, so it is one column: the columns are
    ``WKT`` and then the properties that all features of a GeoJSON of the grid have.

    Raises:
        MissingDependencyError: shapely is not installed.
    """
    shapely = import_shapely()
    text = io.StringIO()
    # lines end as RFC 4180 has it; with other ends, csv leaves a name with such an end unquoted
    table = csv.writer(text, lineterminator="\r\n")
    table.writerow(["WKT", *COLUMNS])
    for shape in find_shapes(grid):
        wkt = shapely.to_wkt(shape.geometry, rounding_precision=DECIMALS)
        properties = shape.properties
        table.writerow([wkt, *(properties[column] for column in COLUMNS)])
    return {path: text.getvalue().encode()}


def _feature(shape: Shape) -> Json:
    if shape.line is not None:
        geometry: Json = {"type": "LineString", "coordinates": shape.line.tolist()}
    else:
        parts = [[_closed(ring) for ring in rings] for rings in shape.parts]
        is_one = len(parts) == 1
        kind = "Polygon" if is_one else "MultiPolygon"
        geometry = {"type": kind, "coordinates": parts[0] if is_one else parts}
    return {"type": "Feature", "geometry": geometry, "properties": shape.properties}


def _closed(ring: Float) -> Ring:
    points: Ring = ring.tolist()
    return [*points, points[0]]


def read_room_outlines(path: str | os.PathLike[str]) -> list[Json]:
    """Read the polygons of a GeoJSON file: a FeatureCollection, or a single Feature.

    Coordinates are world x, y in metres; a third one is left out. Of the properties, ``name``
    (text), ``level`` (a number from 0, or a name; 0 if missing) and ``outdoors`` (false if missing)
    count. A feature whose ``kind`` is another than ``room`` (as `to_geojson` writes for doors and
    walkable areas) is left out. A MultiPolygon is one room. Rings may be closed or not. Errors name
    the feature.

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
    return [
        _read_feature(feature, number, path)
        for number, feature in enumerate(features)
        if not _is_no_room(feature)
    ]


def _is_no_room(feature: Any) -> bool:
    """Whether a feature says that it is something else."""
    properties = feature.get("properties") if isinstance(feature, dict) else None
    kind = properties.get("kind") if isinstance(properties, dict) else None
    return kind in KINDS and kind != ROOM


def _read_feature(feature: Any, number: int, path: str | os.PathLike[str]) -> Json:
    where = f"feature {number} of {path}"
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        raise FormatError(f"expected a Feature, got {_shown(feature)} as {where}")
    properties = feature.get("properties")
    if properties is None:
        properties = {}
    if not isinstance(properties, dict):
        raise FormatError(f"expected an object at `properties`, got {shown(properties)} in {where}")
    name, level = properties.get("name"), properties.get("level", 0)
    if name is not None and not (isinstance(name, str) and name):
        raise FormatError(f"expected text at `properties.name`, got {_shown(name)} in {where}")
    if isinstance(name, str):
        where = f"feature {number} ({name!r}) of {path}"
    if isinstance(level, float) and level.is_integer():
        level = int(level)
    is_number = isinstance(level, int) and not isinstance(level, bool) and level >= 0
    if not is_number and not (isinstance(level, str) and level):
        expected = "a level's number from 0, or its name, at `properties.level`"
        raise FormatError(f"expected {expected}, got {_shown(level)} in {where}")
    outdoors = properties.get("outdoors")
    if outdoors is not None and not isinstance(outdoors, bool):
        expected = "true or false at `properties.outdoors`"
        raise FormatError(f"expected {expected}, got {_shown(outdoors)} in {where}")
    rings = [_read_ring(ring, where) for polygon in _polygons(feature, where) for ring in polygon]
    if not rings:
        raise FormatError(f"expected an outline, got none in {where}")
    about = {"name": name, "level": level, "outdoors": bool(outdoors)}
    return {**about, "points": rings[0], "rings": rings[1:]}


def _polygons(feature: Json, where: str) -> list[list[Any]]:
    geometry = feature.get("geometry")
    geometry = geometry if isinstance(geometry, dict) else {}
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind not in ("Polygon", "MultiPolygon"):
        raise FormatError(f"expected a Polygon or MultiPolygon, got {_shown(kind)} in {where}")
    polygons = [coordinates] if kind == "Polygon" else coordinates
    if not isinstance(polygons, list) or not all(isinstance(part, list) for part in polygons):
        raise FormatError(f"expected lists of rings at `coordinates` in {where}")
    return polygons


def _read_ring(ring: Any, where: str) -> Ring:
    if not isinstance(ring, list) or not all(map(_is_position, ring)):
        raise FormatError(f"expected a ring of positions [x, y] in {where}")
    points = [[float(x), float(y)] for x, y, *_ in ring]
    if len(points) > 1 and points[0] == points[-1]:
        points.pop()
    if len(points) < 3:
        raise FormatError(f"expected a ring of 3 corners or more, got {len(points)} in {where}")
    if fault := find_fault(points):
        raise FormatError(f"expected a simple outline, got {fault} in {where}")
    return points


def _is_position(value: Any) -> bool:
    is_list = isinstance(value, list) and len(value) >= 2
    return is_list and all(type(v) in (int, float) and math.isfinite(v) for v in value[:2])


def _shown(value: Any) -> str:
    return "none" if value is None else (value if isinstance(value, str) else repr(value))[:60]
