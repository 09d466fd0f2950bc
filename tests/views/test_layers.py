"""What pictures show: the right colour in the right cell, names where there is space."""

import numpy as np
import pytest

from navbake.errors import QueryError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.views.colors import DOOR, FREE, NO_FLOOR, OCCUPIED, rgb_of
from navbake.views.layers import LAYERS, make_panels
from navbake.views.plot import render_png

ROOMS = """
#########
#aaa#bbb#
#aaaDbbb#
#aaa#bTb#
#########..
"""


def make_level(art=ROOMS, name="küche"):
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
                    {"id": "d", "state": "open", "cells": {"closed": [[0, [door, 1]]], "open": []}}
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
    (panel,) = make_panels(make_level(), "rooms")
    colors = {tuple(map(int, rgb)) for rgb in panel.rgb.reshape(-1, 3)}
    assert len(colors) == 6  # two rooms, a table, a door, no room, no floor
    a, b = panel.rgb[1, 1], panel.rgb[1, 5]
    assert (panel.rgb[1:4, 1:4] == a).all()
    assert (panel.rgb[3, 6] < b).any()
    assert tuple(panel.rgb[2, 4]) == rgb_of(DOOR)
    assert tuple(panel.rgb[0, 0]) == rgb_of(OCCUPIED)
    assert tuple(panel.rgb[0, 10]) == rgb_of(NO_FLOOR)
    assert ("door", DOOR) in panel.legend


def test_free_cells_of_no_room_are_not_shown_as_walls():
    level = make_level()
    level.attributes["roomIndex"][1, 1] = 0
    [panel] = make_panels(level, "rooms")
    assert tuple(panel.rgb[1, 1]) == rgb_of(FREE)
    assert ("free, no room", FREE) in panel.legend
    [panel] = make_panels(make_level(), "rooms")
    assert not any(name == "free, no room" for name, _ in panel.legend)


def test_names_stand_in_their_rooms():
    (panel,) = make_panels(make_level(), "rooms")
    one, other = panel.labels
    assert (one.x, one.y) == pytest.approx((1.25, 1.25))
    assert one.width == pytest.approx(1.5)
    assert (other.text, other.fallback) == ("küche", "0:2")
    assert 2.0 <= other.x <= 4.0


def test_clearance_and_islands_need_not_be_in_the_file():
    level = make_level()
    (computed,) = make_panels(level, "clearance")
    assert computed.values[2, 2] == pytest.approx(0.75)
    assert np.isnan(computed.values[0, 0])
    stored = np.where(level.free, np.float32(7), 0)
    level.attributes["clearance"] = stored
    assert make_panels(level, "clearance")[0].values[2, 2] == 7
    (islands,) = make_panels(level, "island")
    level.attributes["island"] = np.where(level.free, 1, 0).astype(np.uint16)
    np.testing.assert_array_equal(make_panels(level, "island")[0].rgb, islands.rgb)


def test_weights():
    level = make_level()
    level.weights[1, 1] = 10.0
    (panel,) = make_panels(level, "weights")
    assert panel.values[1, 1] == 10
    assert np.isnan(panel.values[3, 6])
    assert tuple(panel.rgb[3, 6]) == rgb_of(OCCUPIED)


def test_every_layer_of_every_level_is_drawn():
    pytest.importorskip("matplotlib")
    levels = [make_level(), make_level()]
    grid = MultiLevelGrid(grids=levels, cell_size=0.5, metadata=levels[0].metadata)
    pictures = {render_png(grid, layers=[layer]) for layer in LAYERS}
    assert len(pictures) == len(LAYERS)
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    assert render_png(grid, layers=["rooms"]) in pictures  # the same bytes again
    assert all(len(make_panels(grid, layer)) == 2 for layer in LAYERS)


@pytest.mark.parametrize("name", ["$x_{ [b]$", "客厅", "\U0001f3e0\U000e0fff", "a" * 300, "  "])
def test_any_name_is_drawn_without_a_complaint(name, recwarn):
    pytest.importorskip("matplotlib")
    assert render_png(make_level(name=name), layers=["rooms"]).startswith(b"\x89PNG")
    assert [str(warning.message) for warning in recwarn] == []


def test_refuses():
    with pytest.raises(QueryError, match=r"expected one of occupancy, floor, .* got 'heat'"):
        make_panels(make_level(), "heat")
    with pytest.raises(QueryError, match="at least one layer"):
        render_png(make_level(), layers=[])
