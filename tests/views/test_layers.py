"""What pictures show: the right colour in the right cell, names where there is space."""

import numpy as np
import pytest

from navbake.errors import QueryError
from navbake.navgrid.colors import (
    CLOSED,
    DOOR,
    DOORWAY,
    FREE,
    LINK_DOWN,
    LINK_UP,
    NO_FLOOR,
    OCCUPIED,
    OUTDOORS,
    rgb_of,
)
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.verifier.report import FLOOR_OFF, FREE_TOUCHES, Finding
from navbake.views.layers import (
    DISAGREEMENTS,
    LAYERS,
    Panel,
    linear_scale,
    make_panel,
    paint,
    relief_shading,
)
from navbake.views.plot import render_picture

ROOMS = """
#########
#aaa#bbb#
#aaaDbbb#
#aaa#bTb#
#########..
"""


def make_level(art=ROOMS, name="küche", state="open"):
    """``#`` wall, ``.`` no floor, D a door, T a table in room b."""
    rows = art.strip().split("\n")
    cells = np.array([list(row.ljust(max(map(len, rows)), ".")) for row in rows])
    index = np.select([cells == "a", np.isin(cells, ["b", "T", "D"])], [1, 2], 0)
    door = int(np.flatnonzero(cells == "D")[0])
    return SceneGrid2D(
        width=cells.shape[1],
        height=cells.shape[0],
        cell_size=0.5,
        min_yup=(0.0, 0.0, -2.5),
        weights=np.where(np.isin(cells, ["a", "b", "D"]), 1.0, np.inf),
        attributes={
            "floorHeight": np.where(cells == ".", np.nan, 0.0).astype(np.float32),
            "roomIndex": index.astype(np.uint16),
        },
        metadata={
            "navbake": {
                "rooms": [
                    room(1, "a long name for a small room"),
                    room(2, name),
                ],
                "doors": [
                    {"id": "d", "state": state, "cells": {"closed": [[0, [door, 1]]], "open": []}}
                ],
            }
        },
    )


def room(index, name):
    return {
        "index": index,
        "id": name,
        "name": name,
        "level": 0,
        "area": 1.0,
        "centroid": [0, 0, 0],
        "neighbours": [],
    }


def test_rooms():
    panel = make_panel(make_level(), "rooms", 0)
    colors = {tuple(map(int, rgb)) for rgb in panel.rgb.reshape(-1, 3)}
    assert len(colors) == 6  # two rooms, a table, a door, no room, no floor
    a, b = panel.rgb[1, 1], panel.rgb[1, 5]
    assert (panel.rgb[1:4, 1:4] == a).all()
    assert (panel.rgb[3, 6] < b).any()
    assert tuple(panel.rgb[2, 4]) == rgb_of(DOORWAY)
    closed = make_panel(make_level(state="closed"), "rooms", 0)
    assert tuple(closed.rgb[2, 4]) == rgb_of(DOOR)
    assert ("door leaf", DOOR) in closed.legend and ("doorway", DOORWAY) not in closed.legend
    assert tuple(panel.rgb[0, 0]) == rgb_of(OCCUPIED)
    assert tuple(panel.rgb[0, 10]) == rgb_of(NO_FLOOR)
    assert ("doorway", DOORWAY) in panel.legend and ("door leaf", DOOR) not in panel.legend


def test_free_cells_of_no_room_are_not_shown_as_walls():
    level = make_level()
    level.attributes["roomIndex"][1, 1] = 0
    panel = make_panel(level, "rooms", 0)
    assert tuple(panel.rgb[1, 1]) == rgb_of(FREE)
    assert ("free, no room", FREE) in panel.legend
    panel = make_panel(make_level(), "rooms", 0)
    assert not any(name == "free, no room" for name, _ in panel.legend)


def test_names_stand_in_their_rooms():
    panel = make_panel(make_level(), "rooms", 0)
    one, other = panel.labels
    assert (one.x, one.y) == pytest.approx((1.25, 1.25))
    assert (one.width, one.height) == pytest.approx((1.5, 1.5))
    assert (other.text, other.fallback) == ("küche", "0:2")
    assert 2.0 <= other.x <= 4.0


def test_clearance_and_islands_need_not_be_in_the_file():
    level = make_level()
    computed = make_panel(level, "clearance", 0)
    assert computed.values[2, 2] == pytest.approx(0.75)
    assert np.isnan(computed.values[0, 0])
    stored = np.where(level.free, np.float32(7), 0)
    level.attributes["clearance"] = stored
    assert make_panel(level, "clearance", 0).values[2, 2] == 7
    islands = make_panel(level, "island", 0)
    level.attributes["island"] = np.where(level.free, 1, 0).astype(np.uint16)
    np.testing.assert_array_equal(make_panel(level, "island", 0).rgb, islands.rgb)


def test_weights():
    level = make_level()
    level.weights[1, 1] = 10.0
    panel = make_panel(level, "weights", 0)
    assert panel.values[1, 1] == 10
    assert np.isnan(panel.values[3, 6])
    assert tuple(panel.rgb[3, 6]) == rgb_of(OCCUPIED)


def test_every_layer_of_every_level_is_drawn():
    pytest.importorskip("matplotlib")
    levels = [make_level(), make_level()]
    grid = MultiLevelGrid(grids=levels, cell_size=0.5, metadata=levels[0].metadata)
    pictures = {render_picture(grid, layers=[layer]) for layer in LAYERS}
    assert len(pictures) == len(LAYERS)
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    assert render_picture(grid, layers=["rooms"]) in pictures  # the same bytes again


@pytest.mark.parametrize("name", ["$x_{ [b]$", "客厅", "\U0001f3e0\U000e0fff", "a" * 300, "  "])
def test_any_name_is_drawn_without_a_complaint(name, recwarn):
    pytest.importorskip("matplotlib")
    assert render_picture(make_level(name=name), layers=["rooms"]).startswith(b"\x89PNG")
    assert [str(warning.message) for warning in recwarn] == []


def test_refuses():
    with pytest.raises(QueryError, match=r"expected one of occupancy, floor, .* got 'heat'"):
        make_panel(make_level(), "heat", 0)
    with pytest.raises(QueryError, match="at least one layer"):
        render_picture(make_level(), layers=[])


def test_a_level_alone_has_no_name_in_its_title():
    level = make_level()
    grid = MultiLevelGrid(grids=[make_level(), make_level()], cell_size=0.5)
    assert make_panel(level, "rooms", 0).title == "rooms"
    assert [make_panel(grid, "rooms", number).title for number in range(2)] == [
        "level 0: rooms",
        "level 1: rooms",
    ]
    with pytest.raises(QueryError, match="no level 2: expected 0 to 1"):
        make_panel(grid, "rooms", 2)


def test_the_outdoors_have_a_colour_of_their_own():
    level = make_level()
    level.metadata["navbake"]["rooms"][0]["outdoors"] = True
    panel = make_panel(level, "rooms", 0)
    assert tuple(panel.rgb[1, 1]) == rgb_of(OUTDOORS) != tuple(panel.rgb[1, 5])


def test_doors_are_where_they_stand_and_would_stand():
    level = make_level()
    level.metadata["navbake"]["doors"][0]["cells"]["open"] = [[0, [23, 1]]]
    panel = make_panel(level, "doors", 0)
    assert tuple(panel.rgb[2, 4]) == rgb_of(DOORWAY)
    assert tuple(panel.rgb[2, 1]) == rgb_of(DOOR)  # cell 23 of rows of 11
    assert [label.text for label in panel.labels] == ["d 0.5 m"]
    [mark] = panel.doors
    assert (mark.id, mark.state) == ("d", "open")
    assert mark.middle == pytest.approx((2.25, 1.25))


def test_links_lead_up_and_down():
    levels = [make_level(), make_level()]
    metadata = {"navbake": {"links": [[0, 12, 1, 13]]}}
    grid = MultiLevelGrid(grids=levels, cell_size=0.5, metadata=metadata)
    below, above = (make_panel(grid, "links", number) for number in range(2))
    assert tuple(below.rgb[1, 1]) == rgb_of(LINK_UP)
    assert tuple(above.rgb[1, 2]) == rgb_of(LINK_DOWN)
    assert (below.rgb == rgb_of(LINK_UP)).all(axis=2).sum() == 1


def test_disagreements_are_where_they_were_found():
    level = make_level()
    findings = [
        Finding(FREE_TOUCHES, 0, (1, 2), (1.25, 1.75, 0.0), "touches"),
        Finding(FLOOR_OFF, 0, None, (0.75, 0.75, 0.0), "off"),
        Finding(FLOOR_OFF, 0, None, (99.0, 0.0, 0.0), "beside the grid"),
        Finding(FLOOR_OFF, 1, (1, 1), (0.75, 1.75, 3.0), "of another level"),
    ]
    panel = make_panel(level, DISAGREEMENTS, 0, findings=findings)
    colors = dict(panel.legend)
    assert tuple(panel.rgb[1, 2]) == rgb_of(colors[FREE_TOUCHES])
    assert tuple(panel.rgb[3, 1]) == rgb_of(colors[FLOOR_OFF])
    assert panel.title == "3 disagreements"
    plain = make_panel(level, "occupancy", 0).rgb
    assert (panel.rgb != plain).any(axis=2).sum() == 2
    with pytest.raises(QueryError, match="pass findings"):
        make_panel(level, DISAGREEMENTS, 0)


def test_paint_colours_values_and_leaves_the_rest():
    level = make_level()
    level.weights[1, 1] = 10.0
    panel = make_panel(level, "weights", 0)
    painted = paint(panel)
    assert painted.dtype == np.uint8 and painted.shape == panel.rgb.shape
    dear = panel.scale.bar(2)[1]
    assert (painted[1, 1] == dear).all() and (painted[1, 2] == rgb_of(FREE)).all()
    assert ("cost 1", FREE) in panel.legend  # quiet, as nearly all cells have it
    assert (painted[0, 0] == rgb_of(OCCUPIED)).all() and (painted[0, 10] == rgb_of(NO_FLOOR)).all()
    assert dear.sum() < sum(rgb_of(FREE)) / 2  # what costs much is dark
    assert (panel.rgb == make_panel(level, "weights", 0).rgb).all()  # it is not painted over


def test_light_comes_from_the_upper_left():
    heights = np.zeros((4, 4), dtype=np.float32)
    heights[1:3, 1:3] = 0.02
    heights[3, 3] = np.nan
    lit = relief_shading(heights, 0.04)
    assert (lit[1, 1:3] > 0).all() and (lit[1:3, 1] > 0).all()  # its upper and left edge
    assert (lit[3, 1:3] < 0).all() and (lit[1:3, 3] < 0).all()  # below and right of it
    assert lit[0].tolist() == [0] * 4 and lit[3, 3] == 0
    assert lit[1, 2] == pytest.approx(np.tanh(0.5))
    assert relief_shading(np.float32([[0, 0.04]]), 0.04)[0, 1] == pytest.approx(np.tanh(1))


def test_a_panel_of_colours_is_painted_as_it_is():
    rgb = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    np.testing.assert_array_equal(paint(Panel("p", rgb)), rgb)


def test_what_inflation_closed_has_a_colour_of_its_own():
    art = "###########\n#aaaaabbbb#\n#aaaaDbTbb#\n#aaaaabbbb#\n#aaaaabbbb#\n###########"
    baked = make_level(art)
    assert not baked.closed_by_inflation.any()
    inflated = baked.inflate(0.6)
    expected = baked.free & ~inflated.free
    assert expected.any() and inflated.free.any()
    np.testing.assert_array_equal(inflated.closed_by_inflation, expected)
    for layer in ("occupancy", "clearance", "island", "weights"):
        panel = make_panel(inflated, layer, 0)
        assert ("closed by inflation", CLOSED) in panel.legend, layer
        np.testing.assert_array_equal((paint(panel) == rgb_of(CLOSED)).all(axis=2), expected)
        plain_legend = make_panel(baked, layer, 0).legend
        assert all(color != CLOSED for _, color in plain_legend), layer
    rooms = make_panel(inflated, "rooms", 0)
    assert ("closed by inflation", CLOSED) in rooms.legend
    is_closed_color = (rooms.rgb == rgb_of(CLOSED)).all(axis=2)
    is_door_cell = (rooms.rgb == rgb_of(DOORWAY)).all(axis=2)
    np.testing.assert_array_equal(is_closed_color | is_door_cell, expected | is_door_cell)


def test_what_an_obstacle_blocks_was_not_closed_by_inflation():
    inflated = make_level().inflate(0.3)
    closed_by_inflation = inflated.closed_by_inflation
    obstacle = inflated.block(disc=((1.25, 1.25), 0.3), margin=0.3)
    assert not inflated.free[2, 2]
    assert not inflated.closed_by_inflation[2, 2]
    obstacle.free()
    np.testing.assert_array_equal(inflated.closed_by_inflation, closed_by_inflation)


def test_legends_list_what_there_is_and_all_of_it():
    level = make_level(state="closed")
    doors = dict(make_panel(level, "doors", 0).legend)
    assert doors == {"door leaf": DOOR, "free": FREE, "occupied": OCCUPIED, "no floor": NO_FLOOR}
    assert "doorway" in dict(make_panel(make_level(), "doors", 0).legend)
    assert "door leaf" not in dict(make_panel(make_level(), "doors", 0).legend)
    assert "leads up" not in dict(make_panel(level, "links", 0).legend)
    level.weights[level.free] = 7.0
    assert "cost 1" not in dict(make_panel(level, "weights", 0).legend)
    level.weights[:] = np.inf
    assert "free" not in dict(make_panel(level, "occupancy", 0).legend)


def test_islands_are_numbered_with_their_areas():
    level = make_level("#########\n#aaa#bbb#\n#aaa#bbb#\n#aa##bDb#\n#########")
    panel = make_panel(level, "island", 0)
    assert sorted((label.text, label.key_text, label.number) for label in panel.labels) == [
        ("1: 2.25 m²", "2.25 m²", 1),
        ("2: 2.00 m²", "2.00 m²", 2),
    ]


def test_a_doors_label_has_the_width_of_its_leaf_where_it_is_known():
    level = make_level(state="closed")
    [label] = make_panel(level, "doors", 0).labels
    assert label.text == "d 0.5 m"  # a cell
    level = make_level(state="closed")
    level.metadata["navbake"]["doors"][0]["width"] = 0.4749
    assert make_panel(level, "doors", 0).labels[0].text == "d 0.47 m"


def test_names_of_rooms_stand_off_the_leaves():
    panel = make_panel(make_level("#######\n#aaaaa#\n#aaDaa#\n#aaaaa#\n#######"), "rooms", 0)
    [label, *_] = panel.labels
    is_door = (panel.rgb == rgb_of(DOORWAY)).all(axis=2)
    lattice = make_level().lattice
    for x in np.arange(label.x - label.width / 2 + 0.01, label.x + label.width / 2, 0.1):
        row, col = lattice.rows_cols((x, label.y))
        assert not is_door[row, col]


@pytest.mark.parametrize("z", [-0.0, -1e-7, -0.0049])
def test_flat_scales_have_no_negative_zero(z):
    level = make_level()
    level.attributes["floorHeight"][:] = z
    assert make_panel(level, "floor", 0).title == "floor height [m]: 0.00"
    assert linear_scale(np.array([-0.0]), "cost").ticks[0].text == "0"
