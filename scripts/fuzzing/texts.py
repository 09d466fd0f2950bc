"""Good inputs, small and with all that a reader knows: grids, settings, outlines, a glTF."""

from __future__ import annotations

import base64
import json
import struct
from typing import Any

_ROOM = {
    "index": 1, "id": "hall", "name": "Hall", "level": 0, "area": 2.5, "centroid": [1.0, -1.0, 0.0],
    "source": "geoms", "neighbours": [{"room": "up", "door": "door", "kind": "door"}],
}  # fmt: skip
_DOOR = {
    "id": "door", "joint": "hinge", "rooms": ["hall", None], "state": "closed",
    "cells": {"closed": [[0, [1, 2]]], "open": [[0, [5, 1]]], "modelled": [[0, [1, 2]]]},
}  # fmt: skip
_METADATA = {
    "sceneId": "sample", "agentHeight": 1.5, "agentRadius": 0.2, "traversableFloorHeight": 0.25,
    "cellAttributes": [{"name": "floorHeight", "type": "Float32Array", "dataType": "continuous"}],
    "navbake": {
        "version": "0.1.0", "levels": [{"name": "ground"}, {"name": "first"}],
        "rooms": [_ROOM, {**_ROOM, "id": "up", "level": 1, "name": None}], "doors": [_DOOR],
        "links": [0, 0, 1, 0],
    },
    "inflation": [{"radius": 0.2, "clearance": 0, "mode": "exact"}],
}  # fmt: skip
_USER_DATA = {
    "1": {"doors": ["door"], "objects": ["door", "cup"], "walls": [], "blockers": ["door"]},
    "4": {"objects": ["table"], "note": {"a": [1, None]}},
}


def _runs(datatype: str, *data: Any) -> dict[str, Any]:
    kinds = {"type": "array", "datatype": datatype, "length": 6, "encoding": "rle"}
    return {**kinds, "data": list(data)}


def _level(ground: float, **more: Any) -> dict[str, Any]:
    return {
        "type": "SceneGrid2D",
        "weights": _runs("float64", 1, 4, None, 2),
        "userData": _USER_DATA,
        "tileAttributes": {
            "occupancy": _runs("uint8", 0, 4, 1, 2),
            "floorHeight": _runs("float32", ground, 5, None, 1),
            "roomIndex": _runs("uint16", 1, 6),
        },
        "width": 3, "height": 2, "cellSize": 0.5, "min": [0, ground, 0], "unit": 1,
        "bbox": {"min": [0, ground, 0], "max": [1.5, ground + 2, 1]}, "timings": {"bake": 0.1},
        **more,
    }  # fmt: skip


GRIDS: tuple[dict[str, Any], ...] = (
    {
        "type": "MultiLevelGrid", "metadata": _METADATA, "cellSize": 0.5, "unit": 1,
        "grids": [_level(0.0), _level(3.0)], "timings": {}, "extra": [1],
    },
    _level(0.0, metadata={**_METADATA, "navbake": {"rooms": [_ROOM], "doors": [_DOOR]}}),
    {
        "type": "SceneGrid2D", "width": 2, "height": 2, "cellSize": 1, "min": [0, 0, 0],
        "weights": [1, 1, None, 2.5], "userData": {"0": {"objects": ["cup"]}},
        "tileAttributes": {"island": {"dataType": "Int32Array", "data": [1, 1, 0, 2]}},
    },
)  # fmt: skip

SETTINGS = (
    "scene:\n  path: a.xml\nagent:\n  height: 1.5\n  radius: 0.2\ngrid:\n  cell_size: 0.1\n"
    "  bounds: [-2, -2, 2, 2]",
    "scene:\n  path: a.glb\n  id: sample\n  up: y\n  unit: 0.01\n  geoms: all\n  keyframe: 0\n"
    "  meshes: {wall*: hull}\n  exclude:\n    bodies: [robot]\n    movable: true\n"
    "  joints:\n    hinge: 0.5\n    free: [0, 0, 1]",
    "scene: {path: a.xml}\nlevels:\n  - name: ground\n    height: 0\n  - name: first\n"
    "    height: 3\ndoors:\n  state: open\nattributes: [island]\nnames:\n  walls: true\n"
    "output: a.json",
    "scene: {path: a.xml}\nrooms:\n  from: [polygons, auto]\n  geoms: [floor*]\n  polygons:\n"
    "    - name: hall\n      level: 0\n      points: [[0, 0], [4, 0], [4, 3]]\n  door_width: 1.2",
    "scene: {path: a.xml}\nrooms: auto\nfloors:\n  roofs: false\n  min_area: 2",
)
TAGS = (
    *(
        "!!bool",
        "!!int",
        "!!float",
        "!!null",
        "!!str",
        "!!timestamp",
        "!!binary",
        "!!set",
        "!!omap",
    ),
    *("!!pairs", "!!seq", "!!map", "!!merge", "!!value", "!!python/none", "!own", "!", "&a", "*a"),
)
SCALARS = (
    *(
        "maybe",
        "x",
        "''",
        "~",
        "yes",
        "1e999",
        "-.inf",
        ".nan",
        "0x1F",
        "1_000",
        "1:30",
        "2026-01-01",
    ),
    *(
        "[1, 2",
        "{a: 1}",
        "[[1]]",
        "[[[]]]",
        "? a",
        "- 1",
        "|\n  text",
        ">",
        "'open",
        '"\\x"',
        "%TAG",
    ),
    *(
        "1" + "0" * 400,
        "1" * 5000,
        "{[1]: 2}",
        "{a: {a: {a: 1}}}",
        "[" * 1500,
        "<<",
        "\u2028",
        "@",
        "`",
    ),
)

_HALL = [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]
OUTLINES: tuple[dict[str, Any], ...] = (
    {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"name": "hall", "level": 0},
                "geometry": {"type": "Polygon", "coordinates": [_HALL, [[1, 1], [2, 1], [2, 2]]]},
            },
            {
                "type": "Feature",
                "properties": None,
                "geometry": {
                    "type": "MultiPolygon",
                    "coordinates": [[_HALL], [[[5, 5, 0], [6, 5], [6, 6]]]],
                },
            },
        ],
    },
    {
        "type": "Feature",
        "properties": {"level": "ground"},
        "geometry": {"type": "Polygon", "coordinates": [_HALL]},
    },
)

_POINTS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + struct.pack("<3H", 0, 1, 2)
GLTF = json.dumps({
    "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0, "name": "part", "translation": [1, 2, 3], "children": []}],
    "meshes": [
        {"name": "m", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 4}]},
    ],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "byteOffset": 0},
        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
    ],
    "bufferViews": [
        {"buffer": 0, "byteOffset": 0, "byteLength": 36},
        {"buffer": 0, "byteOffset": 36, "byteLength": 6},
    ],
    "buffers": [{
        "byteLength": len(_POINTS),
        "uri": "data:application/octet-stream;base64," + base64.b64encode(_POINTS).decode(),
    }],
})  # fmt: skip
