"""The NavGrid format: what is read, what is refused and how, and that writing is the inverse."""

from __future__ import annotations

import copy
import gzip
import io
import json
import os
import re
import tracemalloc
from pathlib import Path

import hypothesis.extra.numpy as hnp
import numpy as np
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navbake
from differences import first_difference
from navbake.errors import FormatError
from navbake.formats import allowance, arrays
from navbake.formats.convert import read_as
from navbake.formats.navgrid import dumps_navgrid, read_navgrid, write_navgrid
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.runtime.flat_grid import flatten

INF, NAN = np.inf, np.nan
DTYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")


def seed_example() -> dict:
    """The format's own example, filled up to its length."""
    metadata = {
        "sceneId": "p5dScene.0049e2ed9d7b7c49930d92c30fd59ff7",
        "cellAttributes": [
            {"name": "floorHeight", "type": "Float32Array", "dataType": "continuous"},
            {"name": "roomIndex", "type": "Uint16Array", "dataType": "categorical"},
            {"name": "occupancy", "type": "Uint8Array", "dataType": "categorical"},
        ],
        "agentHeight": 1.1400000000000001,
        "agentRadius": 0.05,
        "traversableFloorHeight": 0.25,
        "useCellFloorHeight": True,
    }
    runs = {"length": 5032, "encoding": "rle"}
    return {
        "type": "SceneGrid2D",
        "metadata": metadata,
        "weights": {"type": "array", **runs, "data": [None, 59, 1, 9, None, 4964]},
        "userData": {"431": {"doors": ["0_10"]}},
        "tileAttributes": {
            "floorHeight": {
                **{"type": "array", "datatype": "float32", **runs},
                "data": [None, 1, 0.05, 57, None, 1, 0.05, 9, None, 4964],
            },
            "roomIndex": {
                **{"type": "array", "datatype": "uint16", **runs},
                "data": [0, 1, 3, 23, 0, 5008],
            },
            "occupancy": {
                **{"type": "array", "datatype": "uint8", **runs},
                "data": [1, 59, 0, 9, 1, 4964],
            },
        },
        "width": 68,
        "height": 74,
        "cellSize": 0.1,
        "min": [-42.707003021161874, 0.04999999701976885, -44.075568771362306],
        "unit": 1,
        "bbox": {
            "min": [-42.658744811854994, -1.862645572503485e-09, -44.06613540649414],
            "max": [-35.95526123046875, 2.734999938867986, -36.685002136230466],
        },
        "timings": {"createMillis": 2275},
    }


def small(**fields) -> dict:
    """A file of 3 × 2 cells; None takes a field away."""
    content = {
        "type": "SceneGrid2D",
        "width": 3,
        "height": 2,
        "cellSize": 0.5,
        "min": [0, 0, 0],
        "weights": {"type": "array", "length": 6, "encoding": "rle", "data": [1, 5, None, 1]},
        **fields,
    }
    return {key: value for key, value in content.items() if value is not None}


def house(**fields) -> dict:
    """A file of two levels of 3 × 2 cells, linked."""
    level = small(unit=1, type=None)
    return {
        "type": "MultiLevelGrid",
        "metadata": {"sceneId": "house", "navbake": {"links": [0, 1, 1, 2]}},
        "cellSize": 0.5,
        "unit": 1,
        "grids": [level, copy.deepcopy(level)],
        **fields,
    }


def attribute(data, datatype="uint8", encoding="rle", **fields) -> dict:
    """A small file with one attribute, `a`."""
    array = {"type": "array", "datatype": datatype, "encoding": encoding, "data": data, **fields}
    return small(tileAttributes={"a": {k: v for k, v in array.items() if v is not None}})


def read(content) -> SceneGrid2D | MultiLevelGrid:
    return read_navgrid(json.dumps(content).encode())


def rewritten(grid):
    return read_navgrid(dumps_navgrid(grid))


# Reading


def test_the_formats_own_example_is_read_field_by_field():
    grid = read(seed_example())
    assert isinstance(grid, SceneGrid2D)
    assert (grid.width, grid.height, grid.shape) == (68, 74, (74, 68))
    assert (grid.cell_size, grid.unit, grid.scene_id) == (
        0.1,
        1,
        seed_example()["metadata"]["sceneId"],
    )
    assert grid.min_yup == (-42.707003021161874, 0.04999999701976885, -44.075568771362306)
    assert grid.bbox_yup is not None
    assert grid.bbox_yup[1] == (-35.95526123046875, 2.734999938867986, -36.685002136230466)
    assert grid.metadata == seed_example()["metadata"]
    assert grid.user_data == {431: {"doors": ["0_10"]}}
    assert grid.timings == {"createMillis": 2275}
    assert np.flatnonzero(grid.free).tolist() == list(range(59, 68))
    assert np.isinf(grid.weights[0, 58])
    assert grid.floor_height[0, 1] == np.float32(0.05)
    assert np.isnan(grid.floor_height[0, 0])
    assert grid.room_index.ravel()[:25].tolist() == [0] + [3] * 23 + [0]
    assert grid.occupancy.sum() == 5032 - 9
    assert [grid.floor_height.dtype, grid.room_index.dtype, grid.occupancy.dtype] == [
        *(np.float32, np.uint16, np.uint8)
    ]
    assert grid.lattice.y_max == 44.075568771362306


def test_the_formats_own_example_is_written_as_it_is():
    written = json.loads(dumps_navgrid(read(seed_example())))
    assert written == seed_example()
    assert list(written) == list(seed_example())


def test_a_file_needs_no_more_than_its_lattice():
    grid = read(small(weights=None))
    assert isinstance(grid, SceneGrid2D)
    assert (grid.weights == 1).all()
    assert (grid.unit, grid.bbox_yup, grid.metadata, grid.user_data) == (1.0, None, {}, {})
    assert (grid.attributes, grid.timings, grid.extra) == ({}, {}, {})


def test_null_stands_for_missing_in_optional_fields():
    empty = dict.fromkeys(("metadata", "userData", "tileAttributes", "bbox", "unit", "timings"))
    content = {**small(), **empty}
    assert first_difference(read(content), read(small())) is None


def test_missing_weights_follow_from_occupancy_and_floor():
    occupancy = {"datatype": "uint8", "data": [0, 0, 1, 0, 1, 0]}
    floor = {"datatype": "float32", "data": [0, None, 0, 0, 0, 0]}
    free = read(small(weights=None, tileAttributes={"occupancy": occupancy})).levels[0].free
    assert free.ravel().tolist() == [True, True, False, True, False, True]
    both = {"occupancy": occupancy, "floorHeight": floor}
    free = read(small(weights=None, tileAttributes=both)).levels[0].free
    assert free.ravel().tolist() == [True, False, False, True, False, True]


FLAT = {"cellAttributes": [], "useCellFloorHeight": False}


@pytest.mark.parametrize("in_level", [True, False], ids=["of a level", "of all levels"])
def test_floor_is_the_ground_where_cells_are_not_to_have_their_own(in_level):
    """On free cells, and where there is a floor; what is stored stays, and is written back."""
    stored = [0.5, 0.75, None, None, 0.25, None]
    floor = {"datatype": "float32", "data": stored}
    own = {"metadata": FLAT} if in_level else {}
    level = small(min=[0, 2.5, 0], tileAttributes={"floorHeight": floor}, **own)
    content = {"type": "MultiLevelGrid", "metadata": FLAT, "grids": [level]}
    grid = read(content)
    ground = [2.5, 2.5, 2.5, 2.5, 2.5, np.nan]  # the last weighs infinity, and has no floor
    grid.levels[0].weights[1, 2] = np.inf
    np.testing.assert_array_equal(grid.levels[0].floor_height.ravel(), ground)
    np.testing.assert_array_equal(grid.values_at("floor", [[0.2, -0.2, 2.5]]), [2.5])
    assert grid.cell_at([0.2, -0.2, 2.5]) == (0, 0, 0) and grid.cell_at([0.2, -0.2, 0.5]) is None
    assert grid.position_of((0, 0, 1)).tolist() == [0.75, -0.25, 2.5]
    assert flatten(grid).floors.z[0] == 2.5
    again = navbake.load(dumps_navgrid(grid)).levels[0]
    np.testing.assert_array_equal(
        again.attributes["floorHeight"].ravel(), np.array(stored, dtype=np.float32)
    )
    inflated = grid.inflate(0.6)
    np.testing.assert_array_equal(inflated.levels[0].floor_height.ravel(), ground)
    for stated in (True, None):
        content["metadata"] = level["metadata"] = {**FLAT, "useCellFloorHeight": stated}
        np.testing.assert_array_equal(
            read(content).levels[0].floor_height.ravel(), np.array(stored, dtype=np.float32)
        )


@pytest.mark.parametrize("encoding", ["rle", "raw", None])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_datatype_is_read_in_every_encoding(dtype, encoding):
    values = [0, 1, 1, 1, 100, 0]
    data = [0, 1, 1.0, 3, 100, 1.0, 0, 1] if encoding == "rle" else values
    array = read(attribute(data, dtype, encoding)).levels[0].attributes["a"]
    assert array.dtype == dtype
    assert array.ravel().tolist() == values


def test_limits_of_the_integers_are_read():
    for dtype in DTYPES[:6]:
        info = np.iinfo(dtype)
        array = read(attribute([info.min, 3, info.max, 3], dtype)).levels[0].attributes["a"]
        assert (array.min(), array.max()) == (info.min, info.max)


@pytest.mark.parametrize(
    "array",
    [
        {"datatype": "Uint8Array", "data": [1, 2, 3, 4, 5, 6]},
        {"dataType": "uint8", "data": [1, 2, 3, 4, 5, 6], "length": 6.0},
        {"datatype": "uchar", "data": [1, 2, 3, 4, 5, 6]},
        {"datatype": "uint8clamped", "data": [1, 2, 3, 4, 5, 6], "encoding": None},
        {"data": [1, 2, 3, 4, 5, 6]},
        [1, 2, 3, 4, 5, 6],
    ],
)
def test_datatypes_are_found_however_they_are_spelled(array):
    metadata = {"cellAttributes": [{"name": "a", "type": "Uint8ClampedArray"}]}
    found = read(small(metadata=metadata, tileAttributes={"a": array})).levels[0].attributes["a"]
    assert found.dtype == np.uint8
    assert found.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_an_array_that_says_nothing_is_float64():
    assert (
        read(small(tileAttributes={"a": [1, 2.5, None, 0, 0, 0]})).levels[0].attributes["a"].dtype
        == np.float64
    )


def test_null_is_infinite_in_weights_and_nan_elsewhere_in_both_encodings():
    raw, runs = [None, 2.5, 1, 1, 1, None], [None, 1, 2.5, 1, 1, 3, None, 1]
    for data, encoding in ((raw, "raw"), (runs, "rle")):
        weights = read(small(weights={"encoding": encoding, "data": data})).levels[0].weights
        assert weights.ravel().tolist() == [INF, 2.5, 1, 1, 1, INF]
        array = read(attribute(data, "float32", encoding)).levels[0].attributes["a"]
        np.testing.assert_array_equal(array.ravel(), [NAN, 2.5, 1, 1, 1, NAN])
    assert np.isinf(read(small(weights=raw)).levels[0].weights[0, 0])


def test_numbers_of_arrays_are_those_of_the_file_however_large_or_mixed():
    kinds = {
        "whole": [0, -7, 2**53 + 1, -(2**63), 2**63 - 1, 255],
        "beyond 64 bits with a sign": [2**64 - 1, 0, 1, 2, 3, 2**63],
        "whole and others": [1, 0.1, -2.5, 3, 2**63, 1e300],
        "missing": [None, 1, 2**60 + 1, None, 0.5, 2],
    }
    for kind, numbers in kinds.items():
        expected = np.array([NAN if n is None else float(n) for n in numbers])
        runs = [entry for number in numbers for entry in (number, 1)]
        for data, encoding in ((numbers, "raw"), (runs, "rle")):
            array = read(attribute(data, "float64", encoding)).levels[0].attributes["a"]
            np.testing.assert_array_equal(array.ravel(), expected, err_msg=kind)


def test_integral_floats_and_empty_runs_are_tolerated():
    content = attribute([7, 0, 1, 6.0, 9, 0], length=6.0)
    grid = read({**content, "width": 3.0, "height": 2.0})
    assert grid.levels[0].attributes["a"].tolist() == [[1, 1, 1], [1, 1, 1]]


def test_levels_take_over_what_they_lack():
    content = house(unit=0.5)
    for level in content["grids"]:
        del level["cellSize"], level["unit"]
    content["grids"][1] |= {"unit": 2, "metadata": {"sceneId": "attic"}}
    grid = read(content)
    assert isinstance(grid, MultiLevelGrid)
    assert [level.cell_size for level in grid.levels] == [0.5, 0.5]
    assert [level.unit for level in grid.levels] == [0.5, 2]
    assert [level.scene_id for level in grid.levels] == ["house", "attic"]
    assert grid.step_array.tolist() == [[0, 1, 1, 2]]


def test_the_cell_size_of_the_whole_may_be_missing():
    content = house()
    del content["cellSize"]
    assert read(content).cell_size == 0.5
    del content["grids"][1]["cellSize"]
    with pytest.raises(FormatError, match=r"number > 0, got nothing at `grids\[1\].cellSize`"):
        read(content)


def test_unknown_fields_are_kept_on_every_level():
    content = house(maker={"name": "x"}, metadata={"sceneId": "h", "more": [1, None, {"a": 2.5}]})
    content["grids"][0] |= {"edges": [1, 2], "tileAttributes": {"heat": [1, 2, 3, 4, 5, 6]}}
    written = json.loads(dumps_navgrid(read(content)))
    assert written["maker"] == {"name": "x"}
    assert written["metadata"]["more"] == [1, None, {"a": 2.5}]
    assert written["grids"][0]["edges"] == [1, 2]
    heat = written["grids"][0]["tileAttributes"]["heat"]["data"]
    assert heat[::2] == [1, 2, 3, 4, 5, 6] and set(heat[1::2]) == {1}


def test_a_file_is_read_from_wherever_it_is(tmp_path):
    data = json.dumps(small()).encode()
    packed = gzip.compress(data)
    path = tmp_path / "a.json"  # packed, whatever its name says
    path.write_bytes(packed)
    two_parts = gzip.compress(data[:20]) + gzip.compress(data[20:])
    with path.open("rb") as stream:
        sources = [data, packed, two_parts, b"\xef\xbb\xbf" + data, b"\n " + data, path, str(path)]
        for source in [*sources, io.BytesIO(data), stream]:
            assert first_difference(read_navgrid(source), read(small())) is None


# Bad input


def with_doors(*doors, **cells) -> dict:
    """A house with doors, each an id, or with one door with the cells of some states."""
    one = [{"id": "a", "state": "closed", "cells": cells}] if cells else []
    many = [{"id": name, "state": "open", "cells": {"open": [[0, [1, 2]]]}} for name in doors]
    return house(metadata={"navbake": {"doors": one + many}})


def test_doors_are_read():
    content = with_doors("b", closed=[[0, [0, 2, 4, 1]], [1, [3, 3]]], open=[])
    assert [door.id for door in read(content).doors] == ["a", "b"]


BAD_FILES = {
    "empty": (b"", "got nothing"),
    "no JSON": (b"PK\x03\x04 zip", r"JSON object, got 'PK\\x03\\x04 zip'"),
    "a list": (b"[1, 2]", "JSON object, got '"),
    "blank": (b"  \n ", "got nothing"),
    "truncated": (
        json.dumps(seed_example()).encode()[:700],
        "unexpected end of data; the file is incomplete: copy it again, or make it anew$",
    ),
    "trailing": (json.dumps(small()).encode() + b"}", "broken JSON"),
    "invalid UTF-8": (b'{"type": "\xff\xfe"}', "line 1, column .*UTF-8(?!.*incomplete)"),
    "NaN": (b'{"width": NaN}', "column 11: .*write null"),
    "Infinity": (b'{"width": Infinity}', "write null"),
    "-Infinity": (b'{"width": -Infinity}', "broken JSON"),
    "1e999": (b'{"cellSize": 1e999}', "infinity"),
    "deep list": (b'{"a":' + b"[" * 100_000, "depth"),
    "deep object": (b'{"a":' * 100_000, "depth"),
    "half a surrogate": (b'{"a": "\\ud800"}', "surrogate"),
    "truncated gzip": (gzip.compress(json.dumps(seed_example()).encode())[:-30], "gzip"),
    "broken gzip": (b"\x1f\x8b" + b"nonsense" * 9, "gzip"),
    "gzip of nothing": (gzip.compress(b""), "got nothing"),
    "gzip of text": (gzip.compress(b"text"), "object, got 'text'"),
}

CULPRITS = {
    "no type": (small(type=None), "'SceneGrid2D' or 'MultiLevelGrid', got nothing at `type`"),
    "unknown type": (small(type="Graph"), "got 'Graph' at `type`"),
    "type of another type": (small(type=[1]), "got a list of 1 at `type`"),
    "no width": (small(width=None), "a whole number >= 1, got nothing at `width`"),
    "width 0": (small(width=0), "got 0 at `width`"),
    "width -3": (small(width=-3), "got -3 at `width`"),
    "width 2.5": (small(width=2.5), "got 2.5 at `width`"),
    "width true": (small(width=True), "got true at `width`"),
    "height a string": (small(height="2"), "got '2' at `height`"),
    "height a list": (small(height=[2]), "got a list of 1 at `height`"),
    "cellSize 0": (small(cellSize=0), "a number > 0, got 0 at `cellSize`"),
    "cellSize -1": (small(cellSize=-1), "got -1 at `cellSize`"),
    "cellSize 1e308": (
        small(cellSize=1e308),
        r"within 1e\+10 m of the origin, got .*1e\+308",
    ),
    "cellSize 1e-308": (small(cellSize=1e-308), "cells of 1e-09 m or more, got 1e-308 m"),
    "unit 1e308": (small(unit=1e308), r"within 1e\+10 m of the origin"),
    "unit 1e-300": (small(unit=1e-300), "cells of 1e-09 m or more"),
    "min 1e308": (small(min=[0, 1e308, 0]), r"within 1e\+10 m of the origin"),
    "cellSize a string": (small(cellSize="5cm"), "got '5cm' at `cellSize`"),
    "cellSize true": (small(cellSize=True), "got true at `cellSize`"),
    "unit 0": (small(unit=0), "a number > 0, got 0 at `unit`"),
    "no min": (small(min=None), "three numbers, got nothing at `min`"),
    "min of 2": (small(min=[0, 0]), "three numbers, got a list of 2 at `min`"),
    "min with null": (small(min=[0, None, 0]), r"a finite number, got null at `min\[1\]`"),
    "min an object": (small(min={"x": 0}), "got an object of 1 fields at `min`"),
    "bbox a list": (small(bbox=[]), "an object, got a list of 0 at `bbox`"),
    "bbox without max": (small(bbox={"min": [0, 0, 0]}), "got nothing at `bbox.max`"),
    "metadata a list": (small(metadata=[]), "an object, got a list of 0 at `metadata`"),
    "navbake a string": (small(metadata={"navbake": "1"}), "got '1' at `metadata.navbake`"),
    "cellAttributes": (
        small(metadata={"cellAttributes": {}}),
        "a list, .*`metadata.cellAttributes`",
    ),
    "a cellAttribute": (
        small(metadata={"cellAttributes": [1]}),
        r"got 1 at .*cellAttributes\[0\]`",
    ),
    "its name": (small(metadata={"cellAttributes": [{}]}), r"got nothing at .*\[0\].name`"),
    "timings": (small(timings=5), "an object, got 5 at `timings`"),
    "deep metadata": (
        small(metadata=json.loads('{"a":' * 70 + "1" + "}" * 70)),
        "deeper .*`metadata`",
    ),
    "deep extra": (small(extra=json.loads("[" * 90 + "]" * 90)), "deeper than 64 .*`extra`"),
    "userData a list": (small(userData=[]), "an object, got a list of 0 at `userData`"),
    "userData id": (small(userData={"6": {}}), "id from 0 to 5 as key, got '6' at `userData`"),
    "userData -1": (small(userData={"-1": {}}), "got '-1' at `userData`"),
    "userData 01": (small(userData={"01": {}}), "got '01' at `userData`"),
    "userData name": (small(userData={"door": {}}), "got 'door' at `userData`"),
    "userData ²": (small(userData={"²": {}}), "got '²' at `userData`"),
    "userData ٣": (small(userData={"٣": {}}), "got '٣' at `userData`"),
    "userData long": (small(userData={"9" * 9999: {}}), "got '9999.*…"),
    "userData value": (small(userData={"2": {}, "3": [1]}), r"got a list of 1 at `userData\[3\]`"),
    "weights a number": (small(weights=1), "an array, got 1 at `weights`"),
    "weights of a kind": (
        small(weights={"type": "sparse", "data": []}),
        "got 'sparse' at `weights.type`",
    ),
    "no data": (small(weights={"encoding": "rle"}), "a list, got nothing at `weights.data`"),
    "data a string": (small(weights={"data": "11111"}), "a list, got '11111' at `weights.data`"),
    "encoding": (small(weights={"encoding": "zip", "data": []}), "got 'zip' at `weights.encoding`"),
    "bare list": (small(weights=[1, 1]), "6 values, one a cell, got 2 at `weights`"),
    "tileAttributes": (small(tileAttributes=[]), "got a list of 0 at `tileAttributes`"),
    "length": (attribute([1, 6], length=7), "6, which is width × height, got 7 at `.*a.length`"),
    "length -1": (attribute([1, 6], length=-1), "got -1 at `tileAttributes.a.length`"),
    "length a string": (attribute([1, 6], length="6"), "got '6' at `tileAttributes.a.length`"),
    "length huge": (attribute([1, 6], length=10**12), "which is width × height, got 1000000000000"),
    "raw too short": (
        attribute([1] * 5, encoding="raw"),
        "6 values, one a cell, got 5 at `.*a.data`",
    ),
    "raw too long": (attribute([1] * 7, encoding="raw"), "6 values, .* got 7 at `.*a.data`"),
    "runs too short": (attribute([1, 5]), "runs over 6 cells, got runs over 5 at `.*a.data`"),
    "no runs": (attribute([]), "got runs over 0 at `tileAttributes.a.data`"),
    "runs too long": (attribute([1, 5, 0, 2]), "6 cells, got runs over 7 at `.*a.data`"),
    "a run of 10^12": (attribute([1, 10**12]), "got runs over 1000000000000 at `.*data`"),
    "a run of 10^300": (attribute([1, 1e300]), r"got runs over 1e\+300 at `.*data`"),
    "odd runs": (attribute([1, 5, 0]), r"odd number \(3\) of entries at `tileAttributes.a.data`"),
    "count -1": (
        attribute([1, 7, 0, -1]),
        r"a count, a whole number >= 0, got -1 at `.*data\[3\]`",
    ),
    "count 1.5": (attribute([1, 4.5, 0, 1.5]), r"a count, .* got 4.5 at `.*data\[1\]`"),
    "count null": (attribute([1, None]), r"a count, .* got null at `.*data\[1\]`"),
    "count true": (attribute([1, 5, 0, True]), r"a count, .* got true at `.*data\[3\]`"),
    "a count, then a value": (attribute([1, "5", "x", 1]), r"a count, .* got '5' at `.*data\[1\]`"),
    "a value, then a count": (attribute([{}, 5, 1, "1"]), r"a value of uint8, .*data\[0\]`"),
    "sums that overflow": (
        attribute([1, 2**63 - 1, 0, 2**63 - 1, 1, 8]),
        r"runs over 6 cells, got runs over 1.84467440737096e\+19 at",
    ),
    "value true": (attribute([1, 5, True, 1]), r"a value of uint8, got true at `.*data\[2\]`"),
    "value a string": (attribute([1, 5, "x" * 999, 1]), r"uint8, got 'xxx.*… at `.*data\[2\]`"),
    "value a list": (attribute([[1], 6]), r"uint8, got a list of 1 at `.*data\[0\]`"),
    "raw value": (attribute([1, 1, {}, 1, 1, 1], encoding="raw"), r"an object .* `.*data\[2\]`"),
    "bare value": (small(weights=[1, 1, "1", 1, 1, 1]), r"got '1' at `weights\[2\]`"),
    "300": (attribute([300, 6]), r"a value of uint8, got 300 at `tileAttributes.a.data\[0\]`"),
    "-1": (attribute([0, 5, -1, 1]), r"a value of uint8, got -1 at `.*data\[2\]`"),
    "1.5": (attribute([1.5, 6], "int32"), "a value of int32, got 1.5"),
    "null": (attribute([None, 6], "uint16"), "a value of uint16, got null"),
    "10^30": (attribute([10**30, 6], "uint32"), r"a value of uint32, got 1e\+30"),
    "1e39": (attribute([1e39, 6], "float32"), r"a value of float32, got 1e\+39"),
    "datatype": (
        attribute([1, 6], "int64"),
        "a datatype of int8, .* got 'int64' at `.*a.datatype`",
    ),
    "datatype 8": (attribute([1, 6], 8), "a datatype of .* got 8 at `tileAttributes.a.datatype`"),
    "type in metadata": (
        small(
            metadata={"cellAttributes": [{"name": "a", "type": "Array"}]},
            tileAttributes={"a": [0] * 6},
        ),
        "a datatype of .* got 'Array' at `tileAttributes.a`",
    ),
    "odd name": (small(tileAttributes={"a\n b": 1}), r"at `tileAttributes\['a\\n b'\]`"),
    "too many cells": (
        small(width=10**6, height=10**6),
        r"too many cells \(1000000 × 1000000, expected 100,000,000 at most\)",
    ),
    "endless": (small(width=1e300), "max_cells"),
    "no grids": (house(grids=None), "at least one level, got null at `grids`"),
    "empty grids": (house(grids=[]), "at least one level, got a list of 0 at `grids`"),
    "a grid of 5": (house(grids=[5]), r"an object, got 5 at `grids\[0\]`"),
    "a grid of grids": (house(grids=[house()]), r"got 'MultiLevelGrid' at `grids\[0\].type`"),
    "a level's array": (house(grids=[small(), attribute([300, 6])]), r"`grids\[1\].tile.*\[0\]`"),
    "the house's unit": (house(unit=-1), "got -1 at `unit`"),
    "two doors of one id": (with_doors("a", "b", "a"), r"got 'a' twice at `.*doors\[2\].id`"),
    "a door's level twice": (
        with_doors(closed=[[1, [0, 1]], [0, [1, 1]], [1, [2, 1]]]),
        r"each level once.* in state closed at `.*doors\[0\]`",
    ),
    "a door's state": (with_doors(ajar=[]), r"'ajar' at `key` in `.*doors\[0\].cells`"),
    "a door's cells": (
        with_doors(open=[[0, [5, 2]]]),
        r"within the grid, in state open at `.*doors\[0\]`",
    ),
    "a link": (
        house(metadata={"navbake": {"links": [0, 1, 2, 0]}}),
        "got cell 0 of level 2 in link 0",
    ),
}


def _message(source, **options) -> str:
    with pytest.raises(FormatError) as caught:
        read_navgrid(source, **options)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 300
    return message


@pytest.mark.parametrize("name", BAD_FILES)
def test_broken_files_are_refused(name, tmp_path):
    data, culprit = BAD_FILES[name]
    path = tmp_path / "house.json"
    path.write_bytes(data)
    for source, shown in ((data, "the bytes given"), (path, "house.json")):
        message = _message(source)
        assert re.search(culprit, message), message
        assert shown in message


@pytest.mark.parametrize("name", CULPRITS)
def test_wrong_content_is_refused_with_its_place(name, tmp_path):
    content, culprit = CULPRITS[name]
    path = tmp_path / "house.json"
    path.write_bytes(json.dumps(content).encode())
    message = _message(path)
    assert re.search(culprit, message), message
    assert f" in {path}" in message


def test_paths_that_are_no_files_are_refused(tmp_path):
    assert "No such file" in _message(tmp_path / "absent.json")
    assert "absent.json" in _message(str(tmp_path / "absent.json"))
    assert "expected a file, got the folder" in _message(tmp_path)
    assert "null byte" in _message("a\0b")
    assert "binary mode" in _message(io.StringIO("{}"))


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no such device here")
def test_an_endless_device_is_turned_away_at_once():
    assert "got '\\x00" in _message("/dev/zero")


@pytest.mark.parametrize(
    "content",
    [
        small(width=10**6, height=10**6),
        small(width=1e12, height=1),
        small(width=10**12, height=10**12, weights={"encoding": "rle", "data": [1, 10**24]}),
        attribute([1, 10**12]),
        attribute([1, 6], length=10**12),
        attribute([0, 10**12, 1, 10**12] * 1000),
    ],
)
def test_huge_claims_take_no_memory(content):
    data = json.dumps(content).encode()
    tracemalloc.start()
    try:
        _message(data)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


def test_max_cells_counts_all_levels_and_all_arrays():
    assert read_navgrid(json.dumps(house()).encode(), max_cells=12)
    assert "expected 5 at most" in _message(json.dumps(house()).encode(), max_cells=11)
    many = small(tileAttributes={f"a{i}": [0] * 6 for i in range(99)})
    assert read_navgrid(json.dumps(many).encode(), max_cells=600)
    message = _message(json.dumps(many).encode(), max_cells=6)
    assert "more memory than max_cells = 6 allows at `tileAttributes.a16` in" in message


def uniform(num_arrays: int, edge: int = 2000) -> bytes:
    """A file of edge × edge cells, the same value all over each array."""
    runs = {"datatype": "float64", "encoding": "rle", "data": [1, edge * edge]}
    arrays = {f"a{i}": runs for i in range(num_arrays)}
    content = small(width=edge, height=edge, weights=runs, tileAttributes=arrays)
    return json.dumps(content, separators=(",", ":")).encode()


def test_a_small_file_of_a_large_level_is_read():
    grid = read_navgrid(uniform(4))
    assert len(uniform(4)) < 1000
    assert grid.levels[0].weights.size == 4_000_000
    assert len(grid.levels[0].attributes) == 4


def test_a_small_file_of_many_arrays_is_refused_unless_meant():
    data = uniform(30)
    message = _message(data)
    assert f"more memory than a file of {len(data):,} bytes may fill (2" in message
    assert "at `tileAttributes.a" in message
    assert message.endswith("pass max_cells if that is meant")
    assert len(read_navgrid(uniform(15, 500), max_cells=10**6).levels[0].attributes) == 15


def test_what_a_file_may_fill_grows_with_its_size(monkeypatch):
    monkeypatch.setattr(allowance, "BASE_MEMORY", 0)
    monkeypatch.setattr(allowance, "MEMORY_PER_FILE_BYTE", 8)
    runs = {"data": [1, 6], "encoding": "rle"}
    many = {f"a{i}": runs for i in range(9)}
    assert read(small(tileAttributes=many))  # 60 values in more bytes
    wide = {"width": 3000, "height": 1, "weights": {"data": [1, 3000], "encoding": "rle"}}
    assert "a file of " in _message(json.dumps(small(**wide)).encode())
    assert read(small(**wide, note="x" * 3000))


def test_a_gzip_bomb_is_refused(monkeypatch):
    monkeypatch.setattr(allowance, "BASE_MEMORY", 8 << 20)
    bomb = gzip.compress(b"{" + b" " * (8 << 20))
    message = _message(bomb)
    assert f"more text than a file of {len(bomb):,} bytes may unpack to" in message
    assert message.endswith("unpack it first if that is meant")


# Round trips

NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=8)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | FINITE | NAMES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=5,
)
OBJECTS = st.dictionaries(NAMES.filter(lambda name: name != "navbake"), JSON_VALUES, max_size=2)
LENGTHS = st.floats(-1e6, 1e6)
VECTORS = st.tuples(LENGTHS, LENGTHS, LENGTHS)


def _arrays(dtype: str, shape: tuple[int, int]):
    if dtype.startswith("float"):
        width = int(dtype[5:])
        few = st.sampled_from([NAN, 0.0, -0.0, 0.5, 3.0])
        values = few | st.floats(allow_nan=True, allow_infinity=False, width=width)
        return hnp.arrays(dtype, shape, elements=values)
    info = np.iinfo(dtype)
    values = st.sampled_from([0, 1]) | st.integers(int(info.min), int(info.max))
    return hnp.arrays(dtype, shape, elements=values)


@st.composite
def levels(draw, own_metadata=OBJECTS) -> SceneGrid2D:
    shape = draw(st.tuples(st.integers(1, 5), st.integers(1, 5)))
    weights = st.sampled_from([INF, 1.0, 10.0, 0.1]) | FINITE
    names = draw(st.lists(NAMES, max_size=3, unique=True))
    attributes = {name: draw(_arrays(draw(st.sampled_from(DTYPES)), shape)) for name in names}
    num_cells = shape[0] * shape[1]
    dtype = draw(st.sampled_from([np.float32, np.float64]))
    with np.errstate(over="ignore"):
        cell_weights = draw(hnp.arrays(np.float64, shape, elements=weights)).astype(dtype)
    return SceneGrid2D(
        width=shape[1],
        height=shape[0],
        cell_size=draw(st.sampled_from([0.05, 1.0, 1 / 3])),
        min_yup=draw(VECTORS),
        bbox_yup=draw(st.none() | st.tuples(VECTORS, VECTORS)),
        unit=draw(st.sampled_from([1.0, 0.01])),
        weights=np.where(np.isinf(cell_weights), dtype(INF), cell_weights),
        attributes=attributes,
        user_data=draw(st.dictionaries(st.integers(0, num_cells - 1), OBJECTS, max_size=3)),
        metadata=draw(own_metadata),
        timings=draw(OBJECTS),
        extra={f"x{key}": value for key, value in draw(OBJECTS).items()},
    )


@st.composite
def houses(draw) -> MultiLevelGrid:
    grids = draw(st.lists(levels(st.just({}) | OBJECTS), min_size=1, max_size=3))
    ends = st.sampled_from(
        [(i, cell) for i, grid in enumerate(grids) for cell in range(grid.weights.size)]
    )
    links = draw(st.lists(st.tuples(ends, ends).map(lambda pair: [*pair[0], *pair[1]]), max_size=3))
    return MultiLevelGrid(
        grids=grids,
        cell_size=0.05,
        unit=draw(st.sampled_from([1.0, 0.01])),
        metadata={**draw(OBJECTS), "sceneId": "s", "navbake": {"links": links}},
        timings=draw(OBJECTS),
        extra={f"x{key}": value for key, value in draw(OBJECTS).items()},
    )


@given(levels() | houses())
def test_write_then_read_is_the_identity(grid):
    data = dumps_navgrid(grid)
    again = read_navgrid(data)
    assert first_difference(grid, again) is None
    assert first_difference(again, grid) is None
    assert again.timings == grid.timings
    assert again.step_array.tolist() == grid.step_array.tolist()
    assert dumps_navgrid(again) == data


@given(hnp.arrays(np.uint32, 50).map(lambda bits: bits.view(np.float32)))
def test_any_float32_survives(values):
    values = np.where(np.isfinite(values), values, np.float32(NAN))[None]
    grid = SceneGrid2D(
        **{"width": 50, "height": 1, "cell_size": 1.0, "min_yup": (0.0, 0.0, 0.0)},
        weights=np.ones((1, 50)),
        attributes={"a": values},
    )
    np.testing.assert_array_equal(rewritten(grid).levels[0].attributes["a"], values)


# Writing


def make_grid(**fields) -> SceneGrid2D:
    defaults = {
        **{"width": 3, "height": 2, "cell_size": 0.1, "min_yup": (-0.0, 1.0, 2.5)},
        "weights": np.array([[1, 1, INF], [INF, NAN, 2.5]], dtype=np.float32),
    }
    return SceneGrid2D(**{**defaults, **fields})


def make_house(**fields) -> MultiLevelGrid:
    return MultiLevelGrid(**{"grids": [make_grid(), make_grid()], "cell_size": 0.1, **fields})


def test_what_is_written_reads_well():
    floor = np.array([[0.05, 0.05, NAN], [INF, -0.0, 3]], dtype=np.float32)
    grid = make_grid(
        attributes={
            "floorHeight": floor,
            "island": np.array([[1, 1, 0], [0, 0, 65535]], np.uint16),
        },
        user_data={10**0: {"doors": ["a"]}, 0: {}},
    )
    assert dumps_navgrid(grid) == (
        b'{"type":"SceneGrid2D","metadata":{"cellAttributes":['
        b'{"name":"floorHeight","type":"Float32Array","dataType":"continuous"},'
        b'{"name":"island","type":"Uint16Array","dataType":"categorical"}]},'
        b'"weights":{"type":"array","length":6,"encoding":"rle","data":[1,2,null,3,2.5,1]},'
        b'"userData":{"0":{},"1":{"doors":["a"]}},"tileAttributes":{'
        b'"floorHeight":{"type":"array","datatype":"float32","length":6,"encoding":"rle",'
        b'"data":[0.05,2,null,2,0,1,3,1]},'
        b'"island":{"type":"array","datatype":"uint16","length":6,"encoding":"rle",'
        b'"data":[1,2,0,3,65535,1]}},'
        b'"width":3,"height":2,"cellSize":0.1,"min":[0,1,2.5],"unit":1,"timings":{}}\n'
    )


def test_levels_have_no_metadata_but_their_own():
    attic = make_grid(metadata={"sceneId": "attic"})
    written = json.loads(dumps_navgrid(make_house(grids=[make_grid(), attic], metadata={"a": 1})))
    assert list(written) == ["type", "metadata", "cellSize", "unit", "grids", "timings"]
    assert written["metadata"] == {"a": 1, "cellAttributes": []}
    assert "metadata" not in written["grids"][0]
    assert written["grids"][1]["metadata"] == {"sceneId": "attic", "cellAttributes": []}


def test_levels_may_differ_in_an_attributes_dtype():
    lower, upper = make_grid(attributes={"a": np.ones((2, 3), np.int8)}), make_grid()
    upper.attributes["a"] = np.full((2, 3), np.finfo(np.float32).max)
    lower.weights = upper.weights = np.ones((2, 3))
    grid = make_house(grids=[lower, upper], metadata={"sceneId": "s"})
    written = json.loads(dumps_navgrid(grid))
    assert "metadata" not in written["grids"][0]
    assert written["grids"][1]["metadata"]["cellAttributes"][0]["type"] == "Float32Array"
    assert first_difference(rewritten(grid), grid) is None


def test_arrays_in_any_memory_layout_are_written():
    values = np.arange(6, dtype=">f4").reshape(2, 3)
    grid = make_grid(attributes={"a": values, "b": np.asfortranarray(values.astype(np.int16))})
    again = rewritten(grid).levels[0].attributes
    np.testing.assert_array_equal(again["a"], values)
    np.testing.assert_array_equal(again["b"], values)


def _grown(**fields):
    grid = make_grid()
    for name, value in fields.items():
        setattr(grid, name, value)
    return grid


UNWRITABLE = {
    "min": (_grown(min_yup=(0.0, NAN, 0.0)), r"a finite number, got nan at `min\[1\]`"),
    "cellSize": (_grown(cell_size=INF), "a number > 0, got inf at `cellSize`"),
    "unit": (_grown(unit=0), "a number > 0, got 0 at `unit`"),
    "bbox": (_grown(bbox_yup=((0, 0, 0), (1, 1, -INF))), r"got -inf at `bbox.max\[2\]`"),
    "metadata": (_grown(metadata={"a": [{"b": NAN}]}), r"got nan at `metadata.a\[0\].b`"),
    "metadata type": (_grown(metadata={"a": np.zeros(2)}), "type ndarray at `metadata.a`"),
    "metadata number": (_grown(metadata={"a": np.int64(2)}), "type int64 at `metadata.a`"),
    "metadata key": (_grown(metadata={"a": {1: 2}}), "strings as keys .* at `metadata`"),
    "metadata keys": (_grown(metadata={"a": {(1, 2): {}}, "b": NAN}), "got nan at `metadata.b`"),
    "navbake": (_grown(metadata={"navbake": []}), "an object, .* 0 at `metadata.navbake`"),
    "deep metadata": (_grown(metadata=json.loads('{"a":' * 70 + "1" + "}" * 70)), "deeper than 64"),
    "long integer": (_grown(metadata={"a": 2**70}), "64-bit"),
    "surrogate": (_grown(metadata={"a": "\ud800"}), "cannot write the grid"),
    "userData": (_grown(user_data={2: {"a": INF}}), r"got inf at `userData\['2'\].a`"),
    "userData id": (_grown(user_data={6: {}}), "ids from 0 to 5, got 6 at `userData`"),
    "userData key": (_grown(user_data={"2": {}}), "ids from 0 to 5, got '2' at `userData`"),
    "userData value": (_grown(user_data={2: []}), r"an object, got a list of 0 at `userData\[2\]`"),
    "timings": (_grown(timings={"a": NAN}), "got nan at `timings.a`"),
    "extra": (_grown(extra={"a": [NAN]}), r"got nan at `extra.a\[0\]`|got nan at `a\[0\]`"),
    "extra of ours": (_grown(extra={"width": 5}), "at `width`"),
    "dtype": (
        _grown(attributes={"a": np.zeros((2, 3), np.int64)}),
        "got int64 at `tileAttributes.a",
    ),
    "bool": (_grown(attributes={"a": np.zeros((2, 3), bool)}), "got bool at `tileAttributes.a"),
    "shape": (_grown(attributes={"a": np.zeros((3, 2))}), r"got \(3, 2\) at `tileAttributes.a"),
    "a level": (
        make_house(grids=[make_grid(), _grown(unit=NAN)]),
        r"got nan at `grids\[1\].unit`",
    ),
    "a link": (
        make_house(metadata={"navbake": {"links": [0, 0, 0, 6]}}),
        "got cell 6 of level 0 in link 0",
    ),
}


@pytest.mark.parametrize("name", UNWRITABLE)
def test_what_the_format_cannot_hold_is_not_written(name, tmp_path):
    grid, culprit = UNWRITABLE[name]
    with pytest.raises(FormatError) as caught:
        write_navgrid(grid, tmp_path / "a.json")
    assert re.search(culprit, str(caught.value)), str(caught.value)
    assert str(caught.value).isprintable()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("leaf", ["[]", "[1]", "[0.5]", '{"a":null}'])
def test_what_is_nested_too_deep_is_neither_read_nor_written(leaf):
    deepest = json.loads('{"a":' * 63 + leaf + "}" * 63)
    assert rewritten(make_grid(metadata=deepest)).metadata["a"] == deepest["a"]
    assert read(small(extra=[deepest["a"]])).extra == {"extra": [deepest["a"]]}
    too_deep = {"a": deepest}
    for make in (
        lambda: read(small(timings=too_deep)),
        lambda: rewritten(make_grid(metadata=too_deep)),
    ):
        with pytest.raises(FormatError, match="nested deeper than 64 levels"):
            make()


def test_numpys_float64_is_a_number_in_metadata():
    grid = make_grid(metadata={"a": np.float64(0.1)})
    assert json.loads(dumps_navgrid(grid))["metadata"]["a"] == 0.1


def test_save_writes_a_file_that_loads(tmp_path):
    for grid in (make_grid(), make_house()):
        path = tmp_path / "a.json"
        grid.save(path)
        grid.save(str(path))  # over the first
        assert path.read_bytes() == dumps_navgrid(grid)
        assert os.listdir(tmp_path) == ["a.json"]
        assert first_difference(read_navgrid(path), rewritten(grid)) is None


@pytest.mark.parametrize(
    ("name", "ways"),
    [
        ("x.png", r"convert\(path\) writes procthor, grid\.plot\(path\) draws a picture"),
        ("x.SVG", r"grid\.plot\(path\) draws a picture"),
        ("x.yaml", r"grid\.convert\(path\) writes nav2"),
        ("x.graph.npz", r"grid\.convert\(path\) writes npz"),
        ("x.csv", r"grid\.convert\(path\) writes wkt"),
    ],
)
def test_save_refuses_names_of_other_formats(tmp_path, name, ways):
    with pytest.raises(FormatError, match=rf"\.json or \.json\.gz, .*{name}: .*{ways}"):
        make_grid().save(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a", "a.grid", "a.JSON"])
def test_save_takes_names_that_no_other_format_has(tmp_path, name):
    make_grid().save(tmp_path / name)
    assert read_navgrid(tmp_path / name).shape == make_grid().shape


@pytest.mark.parametrize("version", ["0.10.0", "99.1", "1.0.0rc1"])
@pytest.mark.parametrize("ending", ["json", "npz"])
def test_a_file_by_a_newer_version_is_read_with_one_line(tmp_path, caplog, version, ending):
    grid = make_grid()
    grid.metadata["navbake"] = {"version": version}
    (path,) = grid.convert(tmp_path / f"a.{ending}")
    assert read_as(path).navbake["version"] == version
    (line,) = caplog.messages
    assert f"a.{ending} is by navbake {version}, this is " in line


@pytest.mark.parametrize("version", ["0.0.9", "0.1.0", "", "new", None, 7, ["9.9"]])
def test_other_versions_are_read_without_a_word(tmp_path, caplog, version):
    grid = make_grid()
    grid.metadata["navbake"] = {"version": version}
    grid.save(tmp_path / "a.json")
    assert read_navgrid(tmp_path / "a.json").navbake["version"] == version
    assert not caplog.messages


def test_gzipped_files_have_the_same_bytes_whatever_name_and_time(tmp_path):
    make_grid().save(tmp_path / "a.json.gz")
    make_grid().save(tmp_path / "b.GZ")
    data = (tmp_path / "a.json.gz").read_bytes()
    assert data == (tmp_path / "b.GZ").read_bytes()
    assert data[:10] == b"\x1f\x8b\x08\x00\x00\x00\x00\x00" + data[8:9] + b"\xff"
    assert gzip.decompress(data) == dumps_navgrid(make_grid())


def test_paths_that_cannot_be_written_are_named(tmp_path):
    (tmp_path / "file").write_text("")
    for path, culprit in (
        (tmp_path, "it is a folder"),
        (tmp_path / "absent" / "a.json", "there is no folder .*absent"),
        (tmp_path / "file" / "a.json", "Not a directory"),
        ("a\0b", "null byte"),
    ):
        with pytest.raises(FormatError, match=f"cannot write .*: .*{culprit}") as caught:
            make_grid().save(path)
        assert str(caught.value).isprintable()


def test_orjson_still_writes_float32_in_their_own_decimals():
    data = orjson.dumps(np.array([0.05, NAN], np.float32), option=orjson.OPT_SERIALIZE_NUMPY)
    assert data == b"[0.05,null]"


@pytest.mark.parametrize("dtype", ["float32", "float64", "uint8", "int32"])
def test_pieces_make_no_difference(monkeypatch, dtype):
    """Runs that go on from piece to piece stay one, and pieces are joined as one text."""
    rng = np.random.default_rng(0)
    values = np.array([1, 2, 2.5, 3, np.nan, np.inf, -0.0]) if dtype[0] == "f" else np.arange(5)
    cells = np.repeat(rng.choice(values, 60), rng.integers(1, 9, 60)).astype(dtype)[:240]
    user_data = {k: {"objects": [f"thing {k % 3}"]} for k in range(0, 240, 7)}
    grid = make_grid(
        width=20,
        height=12,
        weights=np.ones((12, 20)),
        attributes={"a": cells.reshape(12, 20)},
        user_data=user_data,
    )
    whole = dumps_navgrid(grid)
    assert navbake.load(whole).user_data == user_data
    for size in (1, 2, 7, 100, 239):
        monkeypatch.setattr(arrays, "CHUNK_LENGTH", size)
        monkeypatch.setattr("navbake.formats.navgrid.CELLS_AT_ONCE", size)
        assert dumps_navgrid(grid) == whole
