"""A report holds what its grids hold, and nothing in them can run."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from
from navbake.auditor.audit import audit
from navbake.errors import FormatError, NavbakeError, QueryError
from navbake.navgrid.islands import islands_of, measure_clearance
from navbake.views import difference, report
from navbake.views.layers import LAYERS, make_panel, paint
from navbake.views.report import read_verification, render_report, write_report
from project_paths import GOLDEN
from report_pages import check_policy, content_of, picture_of, unpack


@pytest.fixture(scope="module")
def house():
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    grid.timings = {"createMillis": 12.0}  # goldens have none
    return grid


def test_cells_are_told_as_the_grid_has_them(house):
    [sheet] = content_of(render_report(house))["sheets"]
    for number, level in enumerate(house.levels):
        shown = sheet["levels"][number]
        lists, arrays = unpack(shown, level.shape)
        np.testing.assert_allclose(arrays["floor"], level.floor, atol=0.5001e-3)
        away = np.nan_to_num(arrays["clearance"])
        np.testing.assert_allclose(away, measure_clearance(level), atol=0.5001e-3)
        np.testing.assert_array_equal(arrays["room"], level.room_index)
        np.testing.assert_array_equal(arrays["island"], islands_of(house)[number])
        weights = np.nan_to_num(arrays["weight"], nan=np.inf)
        np.testing.assert_array_equal(weights, level.weights)
        for cell, entry in level.user_data.items():
            kept = {key: sorted(entry[key]) for key in report.NAME_KINDS if entry.get(key)}
            which = int(arrays["names"].flat[cell])
            assert (lists[which] if which >= 0 else {}) == kept
        assert np.count_nonzero(arrays["names"] >= 0) == len(level.user_data)


def test_clearances_count_from_zero_where_no_cell_is_blocked():
    level = level_from("....\n....\n....")
    [sheet] = content_of(render_report(level))["sheets"]
    away = unpack(sheet["levels"][0], level.shape)[1]["clearance"]
    np.testing.assert_allclose(away, measure_clearance(level), atol=0.5001e-3)


def test_floors_that_are_worlds_apart_are_told():
    level = level_from("..")
    level.attributes["floorHeight"] = np.array([[-5e9, 5e9]], dtype=np.float32)
    [sheet] = content_of(render_report(level))["sheets"]
    floor = unpack(sheet["levels"][0], (1, 2))[1]["floor"]
    np.testing.assert_allclose(floor, level.floor, atol=5)


def test_pictures_are_those_of_the_layers(house):
    [sheet] = content_of(render_report(house))["sheets"]
    for number in range(len(house.levels)):
        layers = sheet["levels"][number]["layers"]
        assert [layer["name"] for layer in layers] == [
            layer
            for layer in LAYERS
            if layer != "area"  # it has none
        ]
        for layer in layers:
            expected = paint(make_panel(house, layer["name"], number))
            np.testing.assert_array_equal(picture_of(layer), expected)


def test_tables_list_rooms_doors_and_links(house):
    [sheet] = content_of(render_report(house))["sheets"]
    tables = {table["title"]: table for table in sheet["tables"]}
    assert [row[0] for row in tables["Rooms"]["rows"]] == [room.id for room in house.rooms]
    assert [row[0] for row in tables["Doors"]["rows"]] == [door.id for door in house.doors]
    steps = tables["Stairs and steep ramps"]
    assert sum(int(row[steps["columns"].index("steps")]) for row in steps["rows"]) == len(
        house.steps
    )
    assert len(steps["rows"]) == 2  # of its two stairs
    folded = {title for title, table in tables.items() if table["folded"]}
    assert folded == {"Timings", "Made by"}
    rooms = next(each for each in sheet["levels"][0]["layers"] if each["name"] == "rooms")
    names = {room.name or room.id for room in house.rooms if not room.level and not room.outdoors}
    assert names <= {name for name, _ in rooms["legend"]}
    assert ["agent.height", "1.8"] in tables["Settings"]["rows"]
    assert any(row[0] == "create" for row in tables["Timings"]["rows"])
    assert sheet["warnings"] == list(house.warnings)


def test_the_same_grids_give_the_same_page(house):
    assert render_report([house, house]) == render_report([house, house])


def test_two_grids_have_a_sheet_of_what_differs(house):
    page = content_of(render_report([house, house.inflate(0.4)], names=["as baked", "wider"]))
    assert [sheet["name"] for sheet in page["sheets"]] == ["as baked", "wider", "difference"]
    sheet = page["sheets"][2]
    [first, second] = sheet["levels"]
    change = unpack(first, (first["height"], first["width"]))[1]["change"]
    closed = house.levels[0].free & ~house.inflate(0.4).levels[0].free
    np.testing.assert_array_equal(change == first["kinds"].index("became blocked"), closed)
    assert second["of"] == [[0, 1], [1, 1]]
    assert "became blocked" in sheet["tables"][0]["columns"]
    # three grids have none
    assert len(content_of(render_report([house] * 3))["sheets"]) == 3


def test_names_can_neither_end_an_element_nor_run():
    level = level_from("..")
    level.metadata["sceneId"] = "</script><script>alert(1)</script>$SCRIPT\n\u2028"
    level.user_data[0] = {"objects": ["</script><img src=x onerror=alert(1)>"]}
    page = render_report(level)
    assert page.count(b"</script>") == 2
    assert b"<img" not in page
    assert b"<script>alert" not in page
    assert "$SCRIPT" in content_of(page)["title"]


def test_the_policy_allows_the_pages_own_script_and_style_only(house):
    page = render_report(house).decode()
    rules = check_policy(page)
    assert rules["default-src"] == "'none'"
    assert "://" not in re.sub(r'id="content">.*?</script>', "", page, flags=re.DOTALL)


def test_large_levels_show_every_nth_cell(monkeypatch):
    monkeypatch.setattr(difference, "MAX_PAGE_CELLS", 6)
    level = level_from("..#..\n#...#\n.....")
    [sheet] = content_of(render_report(level))["sheets"]
    [shown] = sheet["levels"]
    assert shown["every"] == 2
    free = ~np.isnan(unpack(shown, (2, 3))[1]["weight"])
    np.testing.assert_array_equal(free, level.free[::2, ::2])
    assert picture_of(shown["layers"][0]).shape == (2, 3, 3)


def test_audits_and_verifications_are_marked(tmp_path):
    grid = house_from([level_from("..#..\n..#.."), level_from("...", ground=3.0)])
    report = audit(grid)
    finding = {
        "kind": "free cell touches",
        "level": 1,
        "position": [0.05, -0.05, 3],
        "text": "touches a lamp",
    }
    file = tmp_path / "verify.json"
    file.write_text(
        json.dumps(
            {"ok": False, "sceneId": "house", "checked": 3, "cells": 13, "findings": [finding]}
        )
    )
    read = read_verification(file)
    [sheet] = content_of(render_report(grid, audits=[report], verifications=[read]))["sheets"]
    marks = sheet["levels"][1]["marks"]
    assert {
        "level": 1,
        "x": 0.05,
        "y": -0.05,
        "kind": "verify: free cell touches",
        "text": "touches a lamp",
    } in marks
    titles = [table["title"] for table in sheet["tables"]]
    assert "Verification: disagrees, 3 of 13 cells looked at" in titles
    assert "Audit" in titles
    placed = [
        remark
        for remark in report.remarks
        if remark.place is not None and remark.level in (0, None)
    ]
    assert sum(mark["kind"].startswith("audit") for mark in sheet["levels"][0]["marks"]) == len(
        placed
    )
    for key in ("sceneId", "scene_id"):  # the first is that of files until 0.3
        with pytest.raises(QueryError, match="of 'house', 13 cells, got one of 'barn', 13 cells"):
            render_report(grid, verifications=[{**read, key: "barn"}])
    with pytest.raises(QueryError, match="of 'house', 13 cells, got one of 'house', 12 cells"):
        render_report(grid, verifications=[{**read, "cells": 12}])
    read["findings"][0]["level"] = 2
    with pytest.raises(FormatError, match="levels below 2 in the verification, got 2"):
        render_report(grid, verifications=[read])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("{", "expected what .* prints: broken JSON in .*verify.json"),
        ("[]", "expected what `navbake verify --json` prints in .*verify.json"),
        ('{"ok": 1}', r"verify.json: Expected `bool`, got `int` - at `\$.ok`"),
        (
            '{"ok": true, "checked": 1, "cells": 2, "findings": [{"kind": "x"}]}',
            r"missing required field `level` - at `\$.findings\[0\]`",
        ),
        (
            '{"ok": true, "checked": 1, "cells": 2, "findings": '
            '[{"kind": "x", "level": 0, "position": [1, 2], "text": ""}]}',
            r"length 3, got 2 - at `\$.findings\[0\].position`",
        ),
    ],
)
def test_what_is_no_verification_is_refused(tmp_path, text, fault):
    file = tmp_path / "verify.json"
    file.write_text(text)
    with pytest.raises(FormatError, match=fault):
        read_verification(file)


def test_wrong_arguments_are_named(tmp_path):
    level = level_from("..")
    with pytest.raises(QueryError, match="at least one grid to report on"):
        render_report([])
    with pytest.raises(QueryError, match="as many names as grids, 1, got 2"):
        render_report(level, names=["a", "b"])
    with pytest.raises(NavbakeError, match=r"cannot write .*nowhere"):
        write_report(level, tmp_path / "nowhere" / "report.html")
