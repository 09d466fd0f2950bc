"""User data of long files: parsed when asked for, refused then, written back; and shared ones."""

from __future__ import annotations

import copy
import gc
import gzip
import io
import json
import pickle
import threading
from dataclasses import replace

import numpy as np
import orjson
import pytest

from differences import first_difference
from navbake.errors import FormatError
from navbake.formats import navgrid as reader
from navbake.formats.navgrid import dumps_navgrid, read_navgrid
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.user_data import SharedEntries, UserData, without_garbage_collection

WALLS = {"walls": ["wall_x_0", "wall_y_0"], "doors": ["d"]}


@pytest.fixture(autouse=True)
def defer_all(monkeypatch):
    monkeypatch.setattr(reader, "SPLIT_BYTES", 0)


def level(user_data=None, **fields) -> dict:
    given = {"0": WALLS, "3": {"objects": ["a{b"]}} if user_data is None else user_data
    content = {
        **{"type": "SceneGrid2D", "metadata": {"sceneId": "s"}, "weights": [1, 1, 1, 1, 1, 1]},
        **{"userData": given, "tileAttributes": {}, "width": 3, "height": 2},
        **{"cellSize": 0.1, "min": [0, 0, 0], "unit": 1, "timings": {}},
    }
    return {**content, **fields}


def house(*levels) -> dict:
    own = [{key: value for key, value in one.items() if key != "metadata"} for one in levels]
    return {
        **{"type": "MultiLevelGrid", "metadata": {"sceneId": "s"}, "cellSize": 0.1, "unit": 1},
        **{"grids": own, "timings": {}},
    }


def compact(content) -> bytes:
    return json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode()


def is_deferred(grid: SceneGrid2D) -> bool:
    return not grid.user_data.is_read


def test_user_data_are_read_when_asked_for():
    grid = read_navgrid(compact(level())).levels[0]
    assert is_deferred(grid)
    assert "not read" in repr(grid.user_data)
    assert grid.user_data == {0: WALLS, 3: {"objects": ["a{b"]}}
    assert not is_deferred(grid)
    assert grid.user_data is grid.user_data


def test_each_level_keeps_its_own():
    content = house(level({"1": {"a": 1}}), level({}), level({"2": {"walls": []}}))
    grids = read_navgrid(gzip.compress(compact(content))).levels
    assert all(map(is_deferred, grids))
    assert [grid.user_data for grid in grids] == [{1: {"a": 1}}, {}, {2: {"walls": []}}]


ODD = {
    "spaces": json.dumps(level()).encode(),
    "lines": json.dumps(level(), indent=1).encode(),
    "a string with brackets": compact(level({"1": {"a": '}}"'}, "2": {"walls": []}})),
    "of metadata": compact(level({}, metadata={"userData": {"1": {"a": 1}}})),
    "of an extra field": compact(level({}, mine={"userData": {"1": {"a": 1}}})),
    "a string that says it": compact(level(note="userData")),
    "an escaped key": compact(level()).replace(b'"userData"', b'"user\\u0044ata"', 1),
    "twice": compact(level()).replace(b'"unit":1', b'"userData":{"1":{"a":[1]}},"unit":1'),
    "null": compact({**level(), "userData": None}),
    "a house's own": compact({**house(level({})), "userData": {"1": {"a": 1}}}),
    "a level's grids": compact(level(grids=[{"userData": 1}])),
    "levels twice": compact(house(level({"1": {"a": 1}}))).replace(
        b'"timings":{}}', b'"grids":[' + compact(level({})) + b'],"timings":{}}'
    ),
}


@pytest.mark.parametrize("name", ODD)
def test_whatever_else_is_in_a_file_each_level_has_its_own(name):
    data = ODD[name]
    parsed = orjson.loads(data)
    own = parsed["grids"] if parsed["type"] == "MultiLevelGrid" else [parsed]
    grid = read_navgrid(data)
    for one, stated in zip(grid.levels, own, strict=True):
        assert one.user_data == {int(k): v for k, v in (stated["userData"] or {}).items()}
    reader.SPLIT_BYTES = 1 << 20
    assert first_difference(grid, read_navgrid(data)) is None
    assert grid.extra == read_navgrid(data).extra


@pytest.mark.parametrize("data", [b"[1]", b"{", b'{"type":1,"grids":[1]}', b'{"a":' * 100_000])
def test_what_is_no_file_of_a_grid_is_parsed_as_a_whole(data):
    with pytest.raises(FormatError):
        read_navgrid(data)


BROKEN = {
    "an id": (level({"6": {}, "2": {"a": 1}}), "id from 0 to 5 as key, got '6' at `userData`"),
    "a name": (level({"1": {"a": 1}, "2x": {"a": 1}}), "got '2x' at `userData`"),
    "no object": (level({"3": [1], "2": {"a": 1}}), r"got a list of 1 at `userData\[3\]`"),
    "of a level": (house(level({}), level({"9": {"a": 1}})), r"at `grids\[1\].userData`"),
    "deep": (level({"1": {"a": json.loads("[" * 70 + "]" * 70)}}), "deeper than 64 .*`userData`"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_wrong_user_data_are_refused_when_first_used_or_written(name, tmp_path):
    content, culprit = BROKEN[name]
    path = tmp_path / "house.json"
    path.write_bytes(compact(content))
    grid = read_navgrid(path)
    broken = grid.levels[-1]
    for _ in range(2):
        with pytest.raises(FormatError, match=culprit + ".* in .*house.json"):
            _ = broken.user_data.get(0)
    with pytest.raises(FormatError, match=culprit):
        grid.save(tmp_path / "b.json")
    assert not (tmp_path / "b.json").exists()


def test_what_would_be_written_otherwise_is_encoded_anew():
    data = compact(level({"3": {"a": 1.50}, "1": {"a": 2}})).replace(b"1.5", b"1.50")
    grid = read_navgrid(data)
    assert b'"userData":{"1":{"a":2},"3":{"a":1.5}}' in dumps_navgrid(grid)


def test_changed_user_data_are_written():
    grid = read_navgrid(compact(level())).levels[0]
    twin = replace(grid, unit=2.0)
    grid.user_data[5] = {"doors": ["new"]}
    for one in (grid, twin):  # they share the user data, as after any `replace`
        assert read_navgrid(dumps_navgrid(one)).levels[0].user_data[5] == {"doors": ["new"]}
    grid.user_data = {}
    assert grid.user_data == {}
    assert twin.user_data[5] == {"doors": ["new"]}


@pytest.mark.parametrize(
    "make", [copy.copy, copy.deepcopy, lambda g: pickle.loads(pickle.dumps(g))]
)
def test_copies_have_them_too(make):
    grid = read_navgrid(compact(level())).levels[0]
    twin = make(grid)
    assert first_difference(twin, read_navgrid(compact(level()))) is None


def test_replace_and_comparison_see_the_dictionary():
    grid = read_navgrid(compact(level())).levels[0]
    assert replace(grid, unit=2.0).user_data is grid.user_data
    other = read_navgrid(compact(level({"0": {"walls": ["other"]}}))).levels[0]
    assert "user_data[0]" in (first_difference(grid, other) or "")
    assert SceneGrid2D(width=3, height=2, cell_size=1, min_yup=(0, 0, 0), weights=grid.weights)


def test_shared_entries_are_written_as_the_same_dictionary():
    rng = np.random.default_rng(0)
    entries = [{"objects": [f"thing {k}", 'ﬁn"\\']} for k in range(5)]
    cells = np.sort(rng.choice(200, 80, replace=False))
    shared = UserData(SharedEntries(cells, rng.integers(0, 5, 80), entries))
    plain_one = {int(c): e for c, e in zip(cells, shared.find(cells), strict=True)}

    def grid(user_data):
        return SceneGrid2D(
            width=20, height=10, cell_size=0.1, min_yup=(0.0, 0.0, 0.0),
            weights=np.ones((10, 20)), user_data=user_data,
        )  # fmt: skip

    text = dumps_navgrid(grid(shared))
    assert not shared.is_read
    assert text == dumps_navgrid(grid(plain_one))
    level = grid(shared)
    level.user_data[int(cells[0])] = {"objects": ["mine"]}
    assert b'"mine"' in dumps_navgrid(level)


def test_a_change_in_one_cell_is_none_in_those_that_share_its_entry():
    entries = [{"objects": ["lamp"], "walls": ["beam"], "more": {"deep": [1]}}]
    entries[0]["walls"] = entries[0]["objects"]  # as the bake has them where all names are both
    user_data = UserData(SharedEntries(np.arange(3), np.zeros(3, dtype=np.int64), entries))
    user_data[1]["note"] = "mine"
    user_data[1]["objects"].append("chair")
    user_data[1]["more"]["deep"].append(2)
    same = {"objects": ["lamp"], "walls": ["lamp"], "more": {"deep": [1]}}
    assert user_data[0] == user_data[2] == entries[0] == same
    assert user_data[1]["walls"] == ["lamp"]


def test_what_is_made_later_is_made_once_and_can_be_copied():
    made = []

    def make():
        made.append(1)
        return SharedEntries(np.array([1, 4]), np.array([0, 0]), [{"objects": ["a"]}])

    shared = UserData(make)
    assert not made
    for other in (copy.deepcopy(shared), pickle.loads(pickle.dumps(shared))):
        assert not other.is_read
        assert other == {1: {"objects": ["a"]}, 4: {"objects": ["a"]}}
    assert shared[1] is not shared[4]
    assert made == [1]


def test_user_data_are_a_mapping():
    user_data = UserData({3: {"a": 1}})
    assert user_data == {3: {"a": 1}} == UserData({3: {"a": 1}})
    assert user_data != {3: {"a": 2}}
    assert len(user_data) == 1 and list(user_data) == [3]
    assert 3 in user_data and 4 not in user_data
    user_data[4] = {}
    del user_data[3]
    assert repr(user_data) == "UserData({4: {}})"
    assert user_data.get(3) is None and user_data.pop(4) == {}
    assert UserData.of(user_data) is user_data
    own = {1: {"a": 1}}
    UserData.of(own)[2] = {"b": 2}
    assert own == {1: {"a": 1}, 2: {"b": 2}}


@pytest.mark.parametrize("first_out", ["first", "second"])
def test_garbage_is_collected_again_when_the_last_of_two_threads_has_parsed(first_out):
    """Each of the threads would restore what it met, and the second one meets a pause."""
    entered = {"first": threading.Event(), "second": threading.Event()}
    leave = {"first": threading.Event(), "second": threading.Event()}

    def parse(name):
        with without_garbage_collection():
            entered[name].set()
            leave[name].wait(10)

    threads = {name: threading.Thread(target=parse, args=[name]) for name in entered}
    for name in ("first", "second"):
        threads[name].start()
        assert entered[name].wait(10)
        assert not gc.isenabled()
    last_out = "second" if first_out == "first" else "first"
    leave[first_out].set()
    threads[first_out].join()
    assert not gc.isenabled()
    leave[last_out].set()
    threads[last_out].join()
    assert gc.isenabled()


def test_a_disabled_collector_stays_disabled():
    gc.disable()
    try:
        read_navgrid(orjson.dumps(level()))
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_garbage_is_collected_while_a_stream_is_read():
    class Stream(io.BytesIO):
        states = []  # noqa: RUF012

        def read(self, *args):
            self.states.append(gc.isenabled())
            return super().read(*args)

    read_navgrid(Stream(orjson.dumps(level())))
    assert Stream.states
    assert all(Stream.states)
