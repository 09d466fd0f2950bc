"""What the page of a batch says follows from the index, whoever wrote that."""

from __future__ import annotations

import json

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.batch.page import content
from navbake.batch.page.content import Progress, describe_batch, measure_work

OK = {
    "id": "houses/a",
    "status": "ok",
    "source": "../a.xml",
    "version": "0.1.0",
    "free_area": 12.5,
    "cells": 400,
    "levels": 1,
    "rooms": 2,
    "doors": 0,
    "warnings": ["door 'x' is shut"],
    "audit": ["2 patches"],
    "files": {"grid.json.gz": {}, "report.html": {}},
    "stages": {"scene": 0.5, "rooms": 0.25},
    "seconds": 1.0,
    "ended": "2026-01-01T00:00:10.000Z",
}
BAD = {
    "id": "b",
    "status": "failed",
    "source": "../b.xml",
    "how": "error",
    "error": "no file b.xml",
}
LEFT = {"id": "c", "status": "left", "source": "../c.xml"}


def describe(*rows, **options):
    made = describe_batch(rows, lambda id: True, **options)
    return json.loads(orjson.dumps(made))


def test_columns_have_what_the_rows_have():
    made = describe(OK, BAD, LEFT)
    scenes = made["scenes"]
    assert scenes["id"] == ["houses/a", "b", "c"] and scenes["status"] == [0, 1, 2]
    assert scenes["freeArea"] == [12.5, None, None] and scenes["seconds"] == [1.0, None, None]
    assert scenes["thumbnail"] == [1, 0, 0] and scenes["error"] == [-1, 0, -1]
    assert made["fileLists"] == [["grid.json.gz", "report.html"], []]
    assert scenes["files"] == [0, 1, 1]
    assert made["stageNames"] == ["scene", "rooms"] and scenes["stages"] == [[0.5, 0.25], [], []]
    assert made["errors"] == {
        "texts": [["error", "no file b.xml"]],
        "group": [0],
        "groups": [["error", "no file b.xml"]],
    }
    assert made["warnings"]["texts"] == [["", "door 'x' is shut"]]
    assert made["remarks"]["groups"] == [["", "2 patches"]]
    assert (made["counts"], made["total"], made["noRows"]) == ([1, 1, 1], 3, 0)
    assert (made["progress"], made["work"]) == (None, 1.0)
    assert describe(progress=Progress(3, 9))["progress"] == [3, 9]


def test_names_that_lead_out_have_no_links_and_no_pictures():
    hostile = ["..", "/etc", "a/../../b", "C:\\x", "javascript:alert(1)", "a\ud800", ""]
    made = describe(*({**OK, "id": name} for name in hostile))
    assert made["scenes"]["thumbnail"] == [0] * len(hostile)
    assert made["fileLists"] == [[]]
    made = describe({**OK, "files": {"../../secret": {}, "grid.json.gz": {}, "notes.html": {}}})
    assert made["fileLists"] == [["grid.json.gz"]]


@pytest.mark.parametrize("value", ["1", None, True, [1], {}, 1e300, -(10**400), "\ud800"])
def test_values_that_are_none_are_left_out(value):
    made = describe(
        {"id": "a", "status": "ok"} | {key: value for key in OK if key not in ("id", "status")}
    )
    assert made["scenes"]["cells"] == [None] and made["work"] == 0


def test_what_is_no_row_is_counted():
    made = describe(
        OK,
        3,
        None,
        {"id": 3, "status": "ok"},
        {"id": "a", "status": "fine"},
        {"id": "a", "status": []},
    )
    assert (made["total"], made["noRows"]) == (1, 5)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=5,
)


@given(
    st.lists(
        st.fixed_dictionaries(
            {"status": st.sampled_from(["ok", "failed"]), "id": st.text()},
            optional={key: json_values for key in OK if key not in ("id", "status")}
            | {"error": json_values, "how": json_values},
        ),
        max_size=3,
    )
)
def test_any_index_becomes_a_page(rows):
    assert describe(*rows)["total"] == len(rows)


def test_long_texts_are_cut_and_many_scenes_too(monkeypatch):
    made = describe({**BAD, "error": "x" * 5000})
    assert len(made["errors"]["texts"][0][1]) == content.MAX_TEXT
    monkeypatch.setattr(content, "MAX_SCENES", 2)
    made = describe(OK, LEFT, BAD)
    assert made["scenes"]["id"] == ["b", "houses/a"]
    assert (made["total"], made["counts"]) == (3, [1, 1, 1])


def test_sums_are_of_all_scenes_also_of_those_that_are_not_shown(monkeypatch):
    monkeypatch.setattr(content, "MAX_SCENES", 1)
    other = {**OK, "version": "0.2.0", "stages": {"doors": 0.5, "rooms": 0.5}, "audit": []}
    made = describe(BAD, OK, other, {**OK, "stages": None, "cells": 10**14, "free_area": "1"})
    assert made["scenes"]["id"] == ["b"] and made["stageNames"] == ["scene", "rooms", "doors"]
    assert made["sums"] == {
        **{"freeArea": 25.0, "cells": 1e14 + 800, "levels": 3, "rooms": 6, "doors": 0},
        **{"seconds": 3.0, "warned": 3, "remarked": 2, "versions": ["0.1.0", "0.2.0"]},
        **{"stages": [0.5, 0.75, 0.5], "staged": 2.0},
    }
    made = describe(*({**OK, "cells": 10**15 - 1} for _ in range(20_000)))
    assert made["sums"]["cells"] == pytest.approx(2e19)  # more than JSON's writer takes as whole


def test_time_is_that_in_which_any_scene_was_baked():
    def row(ended, seconds):
        return {"ended": f"2026-01-01T{ended}Z", "seconds": seconds}

    spans = [
        row("00:00:10.000", 4),
        row("00:00:12.500", 4),
        row("00:00:08.000", 1),
        row("09:00:00", 2),
    ]
    assert measure_work(spans) == pytest.approx(6.5 + 2)
    assert measure_work([row("00:00:10", 1), {"ended": "noon"}, {"seconds": 3}]) == 1
    assert measure_work([]) == 0
