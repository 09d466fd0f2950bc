"""Suggestions are near ones only, and one pattern stands for a list of one."""

from __future__ import annotations

import pytest

from navbake.config.settings import parse_config
from navbake.errors import ConfigError, FormatError, QueryError
from navbake.known_names import check_choice, find_similar_names, suggest

SCENE = {"scene": {"path": "a.xml"}}


@pytest.mark.parametrize(
    ("key", "nearest"),
    [
        ("agent.step", "agent.traversable_floor_height"),
        ("agent.max_step", "agent.traversable_floor_height"),
        ("agent.step_height", "agent.traversable_floor_height"),
        ("agent.radus", "agent.radius"),
        ("agent.slope", "agent.max_slope"),
        ("grid.size", "grid.cell_size"),
        ("grid.resolution", "grid.cell_size"),
        ("scene.file", "scene.path"),
        ("cell_size", "grid.cell_size"),
        ("resolution", "grid.cell_size"),
    ],
)
def test_the_key_that_was_meant(key, nearest):
    with pytest.raises(ConfigError, match=f"nearest known one is `{nearest}`"):
        parse_config(SCENE, "x", [f"{key}=1"])


@pytest.mark.parametrize("key", ["colour", "doors.step", "agent.stature", "scene.colour"])
def test_nothing_where_none_is_near(key):
    with pytest.raises(ConfigError, match=rf"unknown key `{key}`, known are"):
        parse_config(SCENE, "x", [f"{key}=1"])


def test_names_are_near_by_slips_words_and_plurals():
    known = ["sofa", "dining_table", "bodies", "Kitchen", "max_slope", "wall_1"]
    for name, near in (
        ("soffa", "sofa"),
        ("sfoa", "sofa"),
        ("sof", "sofa"),
        ("table", "dining_table"),
        ("body", "bodies"),
        ("kitchen", "Kitchen"),
        ("walls", "wall_1"),
    ):
        assert find_similar_names(name, known) == [near], name
    for name in ("step", "chair", "so", "", "bath", 7):
        assert find_similar_names(name, known) == [], name
    assert suggest("step", ["state"]) == "it has state"
    assert suggest("Sopha", ["bed", "sofa"]) == "did you mean 'sofa'? it has bed, sofa"


@pytest.mark.parametrize(
    "section",
    ["scene.exclude.bodies", "scene.exclude.geoms", "doors.patterns", "names.walls", "rooms.geoms"],
)
def test_one_pattern_is_a_list_of_one(section):
    config = parse_config(SCENE, "x", [f"{section}=robot*"])
    for part in section.split("."):
        config = getattr(config, part)
    assert config == ["robot*"]


@pytest.mark.parametrize("error", [QueryError, FormatError])
def test_a_word_that_is_no_choice_is_refused_with_the_choices(error):
    check_choice("up", ("up", "down"), "way", error)
    with pytest.raises(error, match=r"^expected up or down as way, got 'left'$") as raised:
        check_choice("left", ("up", "down"), "way", error)
    assert (raised.value.key, raised.value.value) == ("way", "left")
    assert raised.value.expected == "up or down"
