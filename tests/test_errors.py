"""Errors carry their parts as attributes, beside a message of one line."""

from __future__ import annotations

import copy
import json
import pickle

import pytest

import navbake
from grid_maps import level_from
from navbake.errors import NavbakeError

PARTS = ("path", "key", "value", "expected", "place", "hint")


def parts_of(error: NavbakeError) -> dict[str, object]:
    """The attributes of an error that it has."""
    return {name: getattr(error, name) for name in PARTS if getattr(error, name) is not None}


def config_error(tmp_path, text: str) -> navbake.ConfigError:
    """The error of settings in a file ``house.yaml``."""
    path = tmp_path / "house.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(navbake.ConfigError) as raised:
        navbake.bake(path)
    assert raised.value.path == str(path)
    return raised.value


def test_an_error_has_all_parts_and_none_by_default():
    assert parts_of(NavbakeError("a text")) == {}
    assert str(NavbakeError("a text")) == "a text" and NavbakeError("a text").args == ("a text",)
    assert str(NavbakeError()) == ""


@pytest.mark.parametrize("copied", [copy.copy, lambda error: pickle.loads(pickle.dumps(error))])
def test_parts_survive_a_copy_and_another_process(copied):
    error = navbake.ConfigError("a text", path="a.yaml", key="grid", value=[1], expected="a map")
    again = copied(error)
    assert type(again) is navbake.ConfigError and str(again) == "a text"
    assert parts_of(again) == parts_of(error) != {}


def test_a_wrong_setting(tmp_path):
    error = config_error(tmp_path, "scene: {path: a.xml}\ngrid: {cell_size: 5cm}")
    assert (error.key, error.value, error.expected) == ("grid.cell_size", "5cm", "a number > 0")
    assert str(error) == f'expected a number > 0, got "5cm" at `grid.cell_size` in {error.path}'


def test_a_setting_in_a_list(tmp_path):
    error = config_error(tmp_path, "scene: {path: a.xml}\nlevels: [{ground: 0}, {ground: x}]")
    assert (error.key, error.value, error.expected) == ("levels[1].ground", "x", "a number")


def test_an_unknown_setting(tmp_path):
    error = config_error(tmp_path, "scene: {path: a.xml}\ngrid: {cellsize: 0.1, margin: -1}")
    assert (error.key, error.value) == ("grid.cellsize", None)
    assert error.hint == "the nearest known one is `grid.cell_size`"


def test_a_missing_setting(tmp_path):
    error = config_error(tmp_path, "grid: {}")
    assert (error.key, error.value, error.expected) == ("scene.path", None, "a value")


def test_a_line_that_is_no_yaml(tmp_path):
    error = config_error(tmp_path, "scene: {path: a.xml}\nrooms: {geoms: *hall}")
    assert error.place == "line 2"
    assert error.hint == "text that begins with * needs quotes"


def test_a_keyword_over_the_settings(tmp_path):
    with pytest.raises(navbake.ConfigError) as raised:
        navbake.bake({"scene": {"path": "a.xml"}}, agent={"height": 0})
    assert parts_of(raised.value) == {
        "path": "the settings with the keywords",
        "key": "agent.height",
        "value": 0,
        "expected": "a number > 0",
    }


def test_settings_that_are_not_there():
    with pytest.raises(navbake.ConfigError) as raised:
        navbake.bake("nowhere.yaml")
    assert parts_of(raised.value) == {"path": "nowhere.yaml"}


def grid_file(tmp_path, text: str):
    path = tmp_path / "a.grid.json"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_that_is_no_json(tmp_path):
    path = grid_file(tmp_path, '{"type": NaN}')
    with pytest.raises(navbake.FormatError) as raised:
        navbake.load(path)
    assert raised.value.path == str(path)
    assert raised.value.place == "line 1, column 10"
    assert raised.value.hint == "NaN and Infinity are no JSON, write null"


def test_a_wrong_value_in_a_file(tmp_path):
    path = grid_file(tmp_path, json.dumps({"type": "map", "width": 2, "height": 1}))
    with pytest.raises(navbake.FormatError) as raised:
        navbake.load(path)
    error = raised.value
    assert (error.path, error.place, error.value) == (str(path), "type", "map")
    assert str(error).startswith(f"expected {error.expected}, got 'map' at `type` in {error.path}")


@pytest.fixture(scope="module")
def finder():
    level = level_from("...\n.#.\n...")
    return navbake.PathFinder(level)


QUERIES = {
    "room": (lambda finder: finder.find_path((0.05, -0.05), "room:hall"), "room", "hall"),
    "object": (lambda finder: finder.find_path((0.05, -0.05), "object:cup"), "object", "cup"),
    "island": (lambda finder: finder.random_point(island=9), "island", 9),
    "position": (lambda finder: finder.snap("here"), "position", "here"),
    "agent": (lambda finder: navbake.PathFinder(finder.grid, agent="cart"), "agent", "cart"),
    "level": (lambda finder: finder.grid.at((0.0, 0.0), level=7), "level", 7),
    "radius": (lambda finder: finder.grid.inflate(-1), "radius", -1),
    "layer": (lambda finder: finder.grid.values_at("heights", (0.0, 0.0)), "layer", "heights"),
    "door": (lambda finder: finder.grid.with_doors({"gate": "open"}), "gate", "open"),
}


@pytest.mark.parametrize(("ask", "key", "value"), QUERIES.values(), ids=QUERIES)
def test_a_wrong_query(finder, ask, key, value):
    with pytest.raises(navbake.QueryError) as raised:
        ask(finder)
    assert (raised.value.key, raised.value.value) == (key, value)
    assert raised.value.expected or raised.value.hint


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(navbake.FormatError) as raised:
        navbake.load(tmp_path / "none.grid.json")
    assert parts_of(raised.value) == {"path": str(tmp_path / "none.grid.json")}
