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
from navbake.formats.shapes import DECIMALS, KINDS, find_shapes, import_shapely
from navbake.formats.source import Files, path_name, read_object
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.polygon import find_fault
from navbake.types import Json

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
