"""GeoJSON (RFC 7946), as far as it holds rooms: polygons with a name and a level, in metres."""

import math
import os
from pathlib import Path
from typing import Any

import orjson

from navbake.errors import FormatError
from navbake.formats.json_path import shown
from navbake.formats.source import path_name, read_bytes
from navbake.navgrid.polygon import find_fault
from navbake.types import Json

MAX_BYTES = 64 << 20
MAX_CORNERS = 100_000  # of all outlines; checking each takes the square of its corners

Ring = list[list[float]]


def read_room_outlines(path: str | os.PathLike[str]) -> list[Json]:
    """Read the polygons of a GeoJSON file: a FeatureCollection, or a single Feature.

    Coordinates are world x, y in metres; a third one is left out. Of the properties, ``name``
    (text) and ``level`` (a number from 0, or a name; 0 if missing) count. A MultiPolygon is one
    room. Rings may be closed or not. Errors name the feature.

    Returns:
        ``name``, ``level``, ``points`` (the first outline) and ``rings`` (holes and further
        parts) of each.
    """
    content = _parse(Path(path))
    kind = content.get("type") if isinstance(content, dict) else None
    features = [content] if kind == "Feature" else None
    if kind == "FeatureCollection":
        features = content.get("features")
    if not isinstance(features, list):
        raise FormatError(f"expected a GeoJSON FeatureCollection in {path}, got {_shown(kind)}")
    outlines = []
    num_corners = 0
    for number, feature in enumerate(features):
        outline = _read_feature(feature, number, path)
        num_corners += sum(len(ring) for ring in (outline["points"], *outline["rings"]))
        if num_corners > MAX_CORNERS:
            raise FormatError(f"more than {MAX_CORNERS:,} corners up to feature {number} of {path}")
        outlines.append(outline)
    return outlines


def _parse(path: Path) -> Any:
    if not path.exists() and not path.is_symlink():
        raise FormatError(f"no such file: {path_name(path)}")
    content, _ = read_bytes(path, limit=MAX_BYTES)
    try:
        return orjson.loads(content)
    except orjson.JSONDecodeError as error:
        raise FormatError(f"{path} is no JSON: {error}") from error


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
    rings = [_read_ring(ring, where) for polygon in _polygons(feature, where) for ring in polygon]
    if not rings:
        raise FormatError(f"expected an outline, got none in {where}")
    return {"name": name, "level": level, "points": rings[0], "rings": rings[1:]}


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
