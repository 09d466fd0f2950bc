"""YAML of strangers: whatever reads it, few lines stand for few values."""

from __future__ import annotations

import contextlib
import importlib.util
import re
import time

import pytest
import yaml

from command_line import run_command
from navbake.baker.readers.building import read_building
from navbake.batch.scenes import read_shared_settings
from navbake.config.settings import SceneSettings, load_config
from navbake.errors import ConfigError, NavbakeError
from navbake.formats.nav2 import read_nav2
from navbake.formats.route_files import read_routes
from navbake.yaml_text import MAX_REPEATED_VALUES, parse_yaml

ALIASES = "a0: &a0 [1, 1]\n" + "".join(
    f"a{number}: &a{number} [*a{number - 1}, *a{number - 1}]\n" for number in range(1, 40)
)
MERGES = "m0: &m0 {k: 1}\n" + "".join(
    f"m{number}: &m{number}\n  <<: [{', '.join([f'*m{number - 1}'] * 9)}]\n  k{number}: 1\n"
    for number in range(1, 20)
)
# what a file may begin with -> what its readers say
BOMBS = {
    "aliases": (ALIASES, "aliases repeat more than 100,000 values in line 1"),
    "merge keys": (MERGES, "`<<` merges keys in YAML 1.1 alone: write the keys themselves"),
    "an alias in its value": ("a: &a [*a]\n", "the alias *a stands in its own value in line 1"),
    "half of a pair": ('a: "\\ud800"\n', "invalid Unicode character escape code in line 1"),
    # "is nested too deeply", or libyaml's "maximum nesting depth" since PyYAML 6.0.4
    "brackets": ("a: " + "[" * 300_000, "nest"),
}
READERS = {
    "settings": load_config,
    "shared settings": read_shared_settings,
    "a building": lambda path: read_building(path, SceneSettings(path=path)),
    "a graph of routes": lambda path: read_routes(path, "rmf"),
    "a map": read_nav2,
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("bomb", BOMBS)
def test_few_lines_that_stand_for_values_without_end_are_refused(tmp_path, reader, bomb):
    text, reason = BOMBS[bomb]
    path = tmp_path / "a.yaml"
    path.write_text(text + "scene: {path: a.xml}\nlevels: {}\n")
    begin = time.process_time()
    with pytest.raises(NavbakeError) as error:
        READERS[reader](path)
    assert time.process_time() - begin < 2
    assert (reason if bomb != "merge keys" else "in line") in str(error.value)
    assert "a.yaml" in str(error.value)


def test_categories_of_episodes_are_read_alike(tmp_path, capsys):
    path = tmp_path / "a.yaml"
    path.write_text(ALIASES)
    arguments = (
        "episodes",
        path,
        "-o",
        tmp_path / "a.jsonl",
        "--task",
        "object",
        "--categories",
        path,
    )
    status, _, err = run_command(capsys, *arguments)
    assert (status, len(err.splitlines())) == (1, 1) and "aliases repeat" in err


# a text -> what is wrong with it, and in which line
FAULTS = {
    "scene:\n\tpath: a.xml": ("a tab where YAML wants spaces", 2),
    "scene:\n  path: a.xml\n\tid: b": ("a tab where YAML wants spaces", 3),
    "scene:\n    path: a.xml\n  id: b": ("an indentation that fits no line above", 3),
    "scene: {path: a.xml}\n agent: {}": ("an indentation that fits no line above", 2),
    " scene: {path: a.xml}\nagent: {}": ("an indentation that fits no line above", 2),
    "links:\n  - {name: a}\n - {name: b}": ("an indentation that fits no line above", 3),
    "scene:\n  path: a.xml\n   id: b": ("a key indented deeper than the keys above it", 3),
    "agent:\n  radius: 0.3\n    height: 1": ("a key indented deeper than the keys above it", 3),
    "scene\n  path: a.xml": ("a key without a colon after it", 1),
    "scene:\n  path a.xml\n  id: b": ("a key without a colon after it", 2),
    "scene:\n  path: a.xml\n  id:b\n  up: z": ("a key without a colon and a space after it", 3),
    "scene: path: a.xml": ("a second colon, of text that needs quotes,", 1),
    "scene: {path: a.xml\nagent: {}": ("a { that is not closed, or no comma behind a value,", 1),
    "a: 1\nb: [[0, 0], [1, 1]\nc:\n  d: 1": (
        "a [ that is not closed, or no comma behind a value,",
        2,
    ),
    "grid: {margin: 1 bounds: 1}": ("a { that is not closed, or no comma behind a value,", 1),
    'scene:\n  path: "a.xml\n  id: b\nagent: {}': ("a quote that is never closed", 2),
    'scene:\n  path: "a".xml': ("text behind a value that ends before it", 2),
    'scene:\n  path: "C:\\scenes\\a.xml"': (
        "a backslash in double quotes, in place of single ones,",
        2,
    ),
    "names: @a": ("text that begins with @ and needs quotes", 1),
    "names: `a`": ("text that begins with ` and needs quotes", 1),
    "geoms: *wall": ("text that begins with * and needs quotes", 1),
    "key\r\rb: 1": ("a key without a colon after it", 1),
    "a: b\r\rc: d: e": ("a second colon, of text that needs quotes,", 3),
    "a: b\r\n\x85c: d: e\u2028f: 1": ("a second colon, of text that needs quotes,", 3),
    "a: b\n\n\n  c: d\n": ("a key indented deeper than the keys above it", 4),
    "scene:\n  path\n\n  id: b": ("a key without a colon after it", 2),
    "a: 1\n}\n": ("a } without its opening bracket", 2),
    "a: [1]]": ("a ] without its opening bracket", 1),
    "links:\n  - name: a\n  kind: b": ("a key among list items, or a list item among keys,", 3),
}


@pytest.mark.parametrize("parser", ["libyaml", "PyYAML"])
@pytest.mark.parametrize("text", FAULTS)
def test_faults_are_told_in_plain_words(text, parser, monkeypatch):
    fault, line = FAULTS[text]
    told = re.escape(f"found {fault} in line {line} of house.yaml (")
    parse = parse_yaml
    if parser == "PyYAML":  # as where PyYAML comes without libyaml
        monkeypatch.delattr(yaml, "CSafeLoader", raising=False)
        spec = importlib.util.find_spec("navbake.yaml_text")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        parse = module.parse_yaml
    with pytest.raises(ConfigError, match=f"^{told}") as caught:
        parse(text, "house.yaml")
    assert caught.value.place == f"line {line}"
    assert caught.value.hint and caught.value.hint not in caught.value.args[0]  # what to do


def test_aliases_and_quoted_signs_are_read():
    assert parse_yaml("a: &a {b: [1]}\nc: [*a, *a]", "x") == {
        "a": {"b": [1]},
        "c": [{"b": [1]}, {"b": [1]}],
    }
    assert parse_yaml('"<<": 1', "x") == {"<<": 1}
    assert parse_yaml('a: "\U0001f600 \\U0001f600"', "x") == {"a": "\U0001f600 \U0001f600"}


def test_aliases_are_counted_with_what_they_repeat():
    values = ", ".join(["1"] * 999)  # a list of them is a thousand values
    repeats = MAX_REPEATED_VALUES // 1000
    assert len(parse_yaml(f"a: &a [{values}]\nb: [{'*a, ' * repeats}]", "x")["b"]) == repeats
    with pytest.raises(ConfigError, match="aliases repeat more than"):
        parse_yaml(f"a: &a [{values}]\nb: [{'*a, ' * (repeats + 1)}]", "x")


@pytest.mark.parametrize(
    "piece", ["[", "{", "- ", "? ", "&a ", "!a ", ": ", "'", '"', "# \n", "{a: ", "x y ", "\n"]
)
def test_time_is_linear_in_the_size(piece):
    begin = time.process_time()
    with contextlib.suppress(ConfigError):
        parse_yaml(f"a: {piece * 200_000}", "x")
    assert time.process_time() - begin < 5
