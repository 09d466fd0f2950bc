"""Settings of agents, areas and links: their errors, and that they read back."""

from __future__ import annotations

import pytest

from navbake.config.settings import parse_config, settings_digest
from navbake.config.template import render_template
from navbake.errors import ConfigError
from navbake.yaml_text import parse_yaml

ROBOT = {"robot": {"radius": 0.3, "height": 1.2, "step": 0.1, "speed": 0.8}}
STOPS = [[1, 2, 3], [1, 2, 6]]


def parse(**settings):
    return parse_config({"scene": {"path": "a.xml"}, **settings})


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"agents": {"robot": {"speed": 0}}}, "a number > 0, got 0 at `agents.robot.speed`"),
        (
            {"agents": {"robot": {"radiuss": 1}}},
            "`agents.robot.radiuss`, the nearest known one is `agents.radius`",
        ),
        ({"links": [{"kind": "lift"}]}, "a name, or auto: .* got neither at `links.0.`"),
        ({"links": [{"name": "A"}]}, "2 stops or more, got 0 for 'A' at `links.0..stops`"),
        ({"links": [{"name": "A", "stops": [[1, 2]]}]}, "got a list of 1 at `links.0..stops`"),
        ({"links": [{"auto": "fly"}]}, 'drop, jump, ladder, lift or null, got "fly"'),
        ({"links": [{"auto": "drop", "stops": STOPS}]}, "no `stops` with auto"),
        ({"links": [{"auto": "drop", "width": 1.0}]}, "no `width` with auto"),
        ({"links": [{"name": "A", "stops": STOPS, "gap": 1.0}]}, "no `gap` with a given link"),
        (
            {"links": [{"name": "A", "stops": STOPS, "agents": ["robo"]}], "agents": ROBOT},
            "a name of `agents` .did you mean 'robot'.* at `links.0..agents`",
        ),
        ({"links": [{"name": "A", "stops": STOPS}] * 2}, 'no name twice, got "A" at `links.1.'),
        ({"links": [{"name": "A", "stops": STOPS, "state": "shut"}]}, 'open or closed, got "shut"'),
        ({"areas": [{"name": "A", "room": "x", "geoms": ["y"]}]}, "got room and geoms at `areas"),
        ({"areas": [{"name": "A"}]}, "one of room, polygon, box and geoms, got none for 'A'"),
        ({"areas": [{"name": "A", "room": "x", "cost": 0}]}, "a number > 0, or .inf, got 0"),
        (
            {"areas": [{"name": "A", "polygon": [[0, 0], [1, 1], [1, 0], [0, 1]]}]},
            "a simple outline, got sides that cross: .* at `areas.0..polygon`",
        ),
        ({"areas": [{"name": "A", "box": [[1, 1, 1], [0, 2, 2]]}]}, "lower corner first"),
        ({"areas": "none.geojson"}, "no such file: none.geojson, named at `areas`"),
    ],
)
def test_errors_name_the_culprit(settings, text):
    with pytest.raises(ConfigError, match=text):
        parse(**settings)


def test_agents_that_are_broken_are_no_reason_to_refuse_their_names():
    links = [{"name": "A", "stops": STOPS, "agents": ["robot"]}]
    with pytest.raises(ConfigError, match=r"agents.robot.radius") as caught:
        parse(agents={"robot": {"radius": -1}}, links=links)
    assert "links" not in str(caught.value)


def test_they_read_back_from_a_template():
    config = parse(
        agents=ROBOT,
        areas=[{"name": "lab", "room": "x", "cost": float("inf"), "agents": "robot"}],
        links=[{"auto": "lift", "patterns": "cab*"}, {"name": "A", "stops": STOPS}],
    )
    assert config.areas[0].cost == "inf" and config.areas[0].agents == ["robot"]
    assert parse_config(parse_yaml(render_template(config), "template")) == config


def test_only_those_that_are_set_count_for_the_digest():
    assert settings_digest(parse()) == settings_digest(parse(agents={}, areas=None, links=[]))
    assert settings_digest(parse()) != settings_digest(parse(agents=ROBOT))
    before = "994224f31228b490651eaac60c99864c881109ab565922999dff87c8e7d5090e"
    assert settings_digest(parse()) == before  # of 0.2: the same settings keep their digest
