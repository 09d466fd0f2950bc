"""Links, stairs and areas are drawn where they are, on pictures, reports and the viewer's page."""

from __future__ import annotations

import re

import numpy as np
import pytest

import navbake
from color_vision import VISIONS, contrast, difference
from navbake.navgrid import colors
from navbake.navgrid.colors import rgb_of
from navbake.views.describe import compute_arc, find_connections, make_stair_table
from navbake.views.layers import make_panel
from navbake.views.plot import render_picture
from navbake.views.report import describe_map, render_report
from navbake.views.viewer.view_state import Choices, ViewState
from project_paths import GOLDEN
from report_pages import content_of


@pytest.fixture(scope="module")
def tower():
    return navbake.load(GOLDEN / "tower.grid.json.gz")


def test_links_and_stairs_are_connections(tower):
    connections = find_connections(tower)
    assert [(each.name, each.kind, len(each.stops)) for each in connections] == [
        ("lift_a", "lift", 3),
        ("lift_b", "lift", 2),
        ("drop 1", "drop", 2),
        ("stair 1", "stair", 2),
        ("stair 2", "stair", 2),
    ]
    assert sum(each.num_steps for each in connections) == len(tower.steps)
    assert [each.is_one_way for each in connections] == [False, False, True, False, False]


def test_the_two_stairs_of_a_house_are_two_rows():
    house = navbake.load(GOLDEN / "house.grid.json.gz")
    first, second = find_connections(house)
    assert (first.name, second.name) == ("stair 1", "stair 2")
    apart = [np.array(stair.stops[0].position[:2]) for stair in (first, second)]
    assert np.linalg.norm(apart[0] - apart[1]) > 3.0
    for stair in (first, second):
        start, end = stair.stops
        assert {start.level, end.level} == {0, 1}
        assert np.linalg.norm(np.subtract(end.position, start.position)[:2]) < 0.3
    assert [row[:3] for row in make_stair_table(house).rows] == [
        [stair.name, *(house.level_names[stop.level] for stop in stair.stops)]
        for stair in (first, second)
    ]


def test_a_closed_link_says_so_and_looks_other(tower):
    closed = tower.with_links({"lift_a": "closed"})
    assert "lift_a (closed)" in {label.text for label in make_panel(closed, "links", 2).labels}
    assert render_picture(closed, layers=["links"]) != render_picture(tower, layers=["links"])


def test_arcs_lead_from_storey_to_storey(tower):
    """In an SVG each is a curve in two strokes: of lift_a two, and of each other way one."""

    def curves(**drawn):
        svg = render_picture(tower, "svg", layers=["links"], **drawn).decode()
        return len(re.findall(r'<path d="M [-\d. \n]+\nQ ', svg))

    assert curves(level=0) == 2 * 1  # the drop alone
    assert curves() == 2 * 6


def test_areas_are_painted_and_explained(tower):
    panel, level = make_panel(tower, "area", 1), tower.levels[1]
    lab = (level.area_index == 2) & level.free
    assert (panel.rgb[lab] == rgb_of(colors.KEEP_OUT)).all()
    assert (panel.rgb[(level.area_index == 0) & level.free] == rgb_of(colors.FREE)).all()
    assert ("lab: keep-out", colors.KEEP_OUT) in panel.legend
    assert [label.text for label in panel.labels] == ["lab"]
    below = make_panel(tower, "area", 0)
    assert "lobby: at most 0.6 m/s" in dict(below.legend)


def test_a_report_has_their_tables_and_stops(tower):
    [sheet] = content_of(render_report(tower))["sheets"]
    tables = {table["title"]: table["rows"] for table in sheet["tables"]}
    assert [row[0] for row in tables["Links"]] == ["lift_a", "lift_b", "drop 1"]
    assert [row[0] for row in tables["Areas"]] == ["lobby", "lab"]
    assert [row[0] for row in tables["Agents"]] == ["person", "robot"]
    layers = {layer["name"]: layer for layer in describe_map(tower, 1)["layers"]}
    assert "area" in layers
    stops = [way["stops"] for way in layers["links"]["ways"] if way["link"]]
    assert [[stop is not None for stop in own] for own in stops] == [
        [False, True, False],
        [False, True],
        [False, False],
    ]


def test_the_viewer_bends_links_between_shown_storeys(tower):
    view_state = ViewState(tower)
    assert "area" in view_state.layers
    assert view_state.arcs(Choices((0, 1, 2))) == []
    arcs = view_state.arcs(Choices((0, 1, 2), layer="links"))
    assert len(arcs) == 6 and sum(arc.color == colors.LINK for arc in arcs) == 4
    for arc in arcs:
        start, middle, end = arc.points[[0, len(arc.points) // 2, -1]]
        assert np.linalg.norm(middle - (start + end) / 2) > 0.1 * np.linalg.norm(end - start)
    assert len(view_state.arcs(Choices((0, 1), layer="links"))) == 4
    up = compute_arc(np.zeros(3), np.array([2.0, 0.0, 0.5]))
    assert up[:, 2].max() > 0.5 and not up[:, 1].any()


def test_links_and_keep_out_areas_stand_out():
    others = (
        colors.LINK_UP,
        colors.LINK_DOWN,
        colors.LINK_ACROSS,
        colors.ROUTE,
        colors.FREE,
        colors.OCCUPIED,
    )
    for kind in VISIONS:
        assert all(difference(rgb_of(colors.LINK), rgb_of(c), kind) > 10 for c in others)
        areas = (*colors.ROOMS, colors.FREE, colors.OCCUPIED, colors.NO_FLOOR)
        assert all(difference(rgb_of(colors.KEEP_OUT), rgb_of(c), kind) > 8 for c in areas)
    assert contrast(rgb_of(colors.LINK), rgb_of(colors.OCCUPIED)) > 2.95
