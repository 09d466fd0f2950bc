"""Settings as keywords lie over those of a file, a mapping or a BakeConfig."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.config.keywords import add_keywords_to_config, make_memory_config
from navbake.config.settings import find_scene_stem, is_memory_path, load_config
from navbake.errors import ConfigError

YAML = """
scene: {path: house.xml, exclude: {bodies: [cat], movable: true}, joints: {door: 1.0}}
agent: {height: 1.5, radius: 0.3}
rooms: {polygons: [{name: hall, points: [[0, 0], [1, 0], [1, 1]]}]}
"""


@pytest.fixture
def house(tmp_path):
    path = tmp_path / "house.yaml"
    path.write_text(YAML, encoding="utf-8")
    return path


def test_keys_of_sections_are_replaced_one_by_one(house):
    over = {
        "scene": {"exclude": {"bodies": ["dog"]}, "joints": {"gate": 0.5}},
        "agent": {"radius": 0.2},
        "levels": [{"ground": 0.0}],
    }
    for config in (house, str(house), load_config(house)):
        found = add_keywords_to_config(config, over)
        assert found.scene.path == house.parent / "house.xml"
        assert found.scene.exclude.bodies == ["dog"]
        assert found.scene.exclude.movable is True
        assert found.scene.joints == {"door": 1.0, "gate": 0.5}
        assert (found.agent.height, found.agent.radius) == (1.5, 0.2)
        assert [level.ground for level in found.levels] == [0.0]
        assert [room.name for room in found.rooms.polygons] == ["hall"]
    assert add_keywords_to_config({"scene": {"path": "a.xml"}}, over).agent.radius == 0.2
    assert add_keywords_to_config("a.xml", over).scene.id == "a"


def test_keys_do_not_undo_a_short_form():
    with pytest.raises(
        ConfigError, match=r"`rooms` is \"none\", so there is no key for `rooms\.min_"
    ):
        add_keywords_to_config(
            {"scene": {"path": "a.xml"}, "rooms": "none"}, {"rooms": {"min_area": 2}}
        )


def test_without_keywords_settings_stay_as_they_are(house):
    config = load_config(house)
    assert add_keywords_to_config(config, {}) is config
    assert add_keywords_to_config(house, {}) == config
    assert add_keywords_to_config(config, {"agent": {}}) == config


def test_python_values_count_as_those_of_yaml():
    over = {
        "agent": {"radius": np.float32(0.25)},
        "grid": {"bounds": (0, 0, np.int64(2), 3), "margin": np.float64(1)},
        "floors": {"from": np.zeros((1, 3))},
    }
    config = add_keywords_to_config("a.xml", over)
    assert config.agent.radius == 0.25
    assert config.grid.bounds == [0, 0, 2, 3]
    assert config.floors.starts == [[0, 0, 0]]


def test_errors_name_where_the_settings_are_from(house):
    with pytest.raises(ConfigError, match=r"`agent.radius` in .*house\.yaml with the keywords"):
        add_keywords_to_config(house, {"agent": {"radius": -1}})
    with pytest.raises(ConfigError, match=r"at `agent.radius` in the settings with the keywords"):
        add_keywords_to_config({"scene": {"path": "a.xml"}}, {"agent": {"radius": -1}})
    with pytest.raises(ConfigError, match=r"at `agent.radius` in the keywords"):
        make_memory_config("flat", {"agent": {"radius": -1}})
    with pytest.raises(ConfigError, match=r"expected a mapping, got 5 at `scene` in the keywords"):
        make_memory_config("flat", {"scene": 5})


def test_scene_in_memory_has_a_name_in_place_of_a_path():
    for name, stem in (("flat", "flat"), ("a/b\\c", "a_b_c"), ("", "scene"), ("..", "scene")):
        settings = make_memory_config(name, {}).scene
        assert is_memory_path(settings.path)
        assert find_scene_stem(settings.path) == settings.id == stem
    named = make_memory_config("flat", {"scene": {"path": "scenes/house.xml"}}).scene
    assert (named.id, find_scene_stem(named.path)) == ("house", "house")
    assert not is_memory_path(named.path)
