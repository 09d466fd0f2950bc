"""The JSON Schema of the settings: it has all keys, and refuses nothing that a bake accepts."""

from __future__ import annotations

import json

import pytest

from command_line import run_command
from navbake.config.settings import SECTIONS, parse_config
from navbake.config.template import make_schema


def forms_at(*keys):
    """The schemas of the forms that a setting may have; of a list, those of its entries, too."""
    schema = make_schema()

    def forms_of(node):
        while "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        parts = [*node.get("anyOf", []), *node.get("oneOf", [])]
        nested = (node.get(key) for key in ("items", "additionalProperties"))
        parts += [part for part in nested if isinstance(part, dict)]
        return [node, *(form for part in parts for form in forms_of(part))]

    forms = [schema]
    for key in keys:
        nodes = [form["properties"][key] for form in forms if "properties" in form]
        forms = [form for node in nodes for form in forms_of(node)]
    return forms


@pytest.mark.parametrize("section", SECTIONS)
def test_each_key_is_in_it(section):
    forms = forms_at(*(section.split(".") if section else ()))
    keys = {key for form in forms for key in form.get("properties", ())}
    fields = SECTIONS[section].model_fields
    assert keys == {field.alias or name for name, field in fields.items()}


@pytest.mark.parametrize(
    ("key", "value", "type_or_word"),
    [
        ("grid", None, "null"),
        ("names", False, "boolean"),
        ("rooms", "none", "none"),
        ("agents", None, "null"),
        ("areas", None, "null"),
        ("links", None, "null"),
        ("scene.exclude.bodies", "robot*", "string"),
        ("rooms.polygons", None, "null"),
    ],
)
def test_short_forms_that_a_bake_accepts_are_in_it(key, value, type_or_word):
    settings = {"scene": {"path": "house.xml"}}
    section = settings
    *sections, last = key.split(".")
    for name in sections:
        section = section.setdefault(name, {})
    section[last] = value
    parse_config(settings)
    forms = forms_at(*key.split("."))
    types = [form.get("type") for form in forms]
    words = [word for form in forms for word in form.get("enum", ())]
    assert type_or_word in types + words


def test_the_first_line_of_settings_names_the_file_that_the_command_writes(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.xml").write_text("<mujoco/>")
    run_command(capsys, "init", "room.xml")
    first_line, command, *_ = (tmp_path / "room.yaml").read_text().splitlines()
    name = first_line.partition("$schema=")[2]
    assert first_line.startswith("# yaml-language-server: ")
    assert f"`navbake schema -o {name}`" in command
    assert run_command(capsys, "schema", "-o", name)[0] == 0
    assert json.loads((tmp_path / name).read_text()) == make_schema()
    assert json.loads(run_command(capsys, "schema")[1]) == make_schema()
