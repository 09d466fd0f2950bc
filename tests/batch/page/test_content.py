"""What the page of a batch says follows from the index, whoever wrote that."""

from __future__ import annotations

import json
from itertools import pairwise

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.batch.page import content
from navbake.batch.page.content import Progress, describe_batch, fold, measure_work

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


def test_a_scene_is_what_its_row_says():
    made = describe(OK, BAD, LEFT)
    ok, bad, left = made["scenes"]
    assert [scene["id"] for scene in made["scenes"]] == ["houses/a", "b", "c"]
    assert [scene["status"] for scene in made["scenes"]] == ["ok", "failed", "left"]
    assert (ok["freeArea"], bad["freeArea"], left["seconds"]) == (12.5, None, None)
    assert (ok["thumbnail"], bad["thumbnail"], left["thumbnail"]) == (True, False, False)
    assert ok["files"] == ["grid.json.gz", "report.html"] and bad["files"] == []
    assert ok["stages"] == {"scene": 0.5, "rooms": 0.25} and ok["ended"] == OK["ended"]
    assert (bad["failures"], ok["failures"]) == (["error: no file b.xml"], [])
    assert (ok["warnings"], ok["remarks"]) == (["door 'x' is shut"], ["2 patches"])
    assert made["groups"]["failures"] == {"error: no file b.xml": "error: no file b.xml"}
    assert (made["counts"], made["total"], made["noRows"]) == (
        {"ok": 1, "failed": 1, "left": 1},
        3,
        0,
    )
    assert (made["progress"], made["work"]) == (None, 1.0)
    assert describe(progress=Progress(3, 9))["progress"] == [3, 9]


def test_names_that_lead_out_have_no_links_and_no_pictures():
    hostile = ["..", "/etc", "a/../../b", "C:\\x", "javascript:alert(1)", "a\ud800", ""]
    made = describe(*({**OK, "id": name} for name in hostile))
    assert not any(scene["thumbnail"] or scene["files"] for scene in made["scenes"])
    made = describe({**OK, "files": {"../../secret": {}, "grid.json.gz": {}, "notes.html": {}}})
    assert made["scenes"][0]["files"] == ["grid.json.gz"]


@pytest.mark.parametrize("value", ["1", None, True, [1], {}, 1e300, -(10**400), "\ud800"])
def test_values_that_are_none_are_left_out(value):
    made = describe(
        {"id": "a", "status": "ok"} | {key: value for key in OK if key not in ("id", "status")}
    )
    assert made["scenes"][0]["cells"] is None and made["work"] == 0


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
    assert len(made["scenes"][0]["failures"][0]) == len("error: ") + content.MAX_TEXT
    monkeypatch.setattr(content, "MAX_SCENES", 2)
    made = describe(OK, LEFT, BAD)
    assert [scene["id"] for scene in made["scenes"]] == ["b", "houses/a"]
    assert (made["total"], made["counts"]) == (3, {"ok": 1, "failed": 1, "left": 1})


def test_sums_are_of_all_scenes_also_of_those_that_are_not_shown(monkeypatch):
    monkeypatch.setattr(content, "MAX_SCENES", 1)
    other = {**OK, "version": "0.2.0", "stages": {"doors": 0.5, "rooms": 0.5}, "audit": []}
    made = describe(BAD, OK, other, {**OK, "stages": None, "cells": 10**14, "free_area": "1"})
    assert [scene["id"] for scene in made["scenes"]] == ["b"]
    assert made["sums"] == {
        **{"freeArea": 25.0, "cells": 1e14 + 800, "levels": 3, "rooms": 6, "doors": 0},
        **{"seconds": 3.0, "versions": ["0.1.0", "0.2.0"], "staged": 2.0},
        **{"failures": 1, "warnings": 3, "remarks": 2},
        **{"stages": {"scene": 0.5, "rooms": 0.75, "doors": 0.5}},
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


@pytest.mark.parametrize(
    ("text", "folded"),
    [
        ("no scene file at scenes/a b.xml", "no scene file at … …"),
        (
            "broken XML in x/b.xml: no element: line 1, column 19",
            "broken XML in …: no element: line #, column #",
        ),
        (
            "MuJoCo cannot load a.mjb: Element 'gemo', line 3",
            "MuJoCo cannot load …: Element …, line #",
        ),
        ('got "5cm" at `grid.cell_size` in house.yaml', "got … at `grid.cell_size` in …"),
        ("a grid of 3.24e+10 cells: 18,000 x 18000 m", "a grid of # cells: # x # m"),
        ("it took more than 1.5 s", "it took more than # s"),
        ("0.5 m² of 30% at -3, +4.", "# m² of # at #, #."),
        ("geom12 and geom_7 can't meet", "… and … can't meet"),
        ("doesn't and isn't stay", "doesn't and isn't stay"),
        ("its process ended by SIGSEGV", "its process ended by SIGSEGV"),
        (r"cannot read C:\scenes\a.xml", "cannot read C:…"),
        ("expected <mujoco> or <robot> in model.xml", "expected <mujoco> or <robot> in …"),
        ("", ""),
    ],
)
def test_names_and_numbers_are_folded_and_settings_stay(text, folded):
    assert fold(text) == folded


@given(st.text(max_size=200))
def test_any_text_is_folded_once(text):
    assert fold(fold(text)) == fold(text)


def test_texts_of_a_kind_are_one_group_and_one_alone_is_itself():
    texts = ["error: line 1", "error: line 2", "crashed: line 1"]
    made = describe(*({**BAD, "how": t.split(": ")[0], "error": t.split(": ")[1]} for t in texts))
    groups = ["error: line #", "error: line #", "crashed: line 1"]
    assert made["groups"]["failures"] == dict(zip(texts, groups, strict=True))


@pytest.mark.parametrize(
    ("areas", "edges"),
    [
        ([], []),
        ([3, 3], [3, 4]),
        ([0, 280], [20 * k for k in range(16)]),
        ([0.5, 0.9], [0.5 + 0.02 * k for k in range(22)]),
    ],
)
def test_bars_have_round_edges(areas, edges):
    made = describe(*({**OK, "free_area": area} for area in areas))
    assert made["edges"]["freeArea"] == pytest.approx(edges)


def test_bars_of_skewed_numbers_have_equal_ratios():
    made = describe(*({**OK, "free_area": area} for area in (1, 1, 1, 4096)))
    edges = made["edges"]["freeArea"]
    assert (edges[0], edges[-1]) == (1, 4096)
    assert all(b / a == pytest.approx(2**0.5) for a, b in pairwise(edges))
