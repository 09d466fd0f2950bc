"""Writes YAML templates: every setting with its meaning, unit, range and default."""

import contextlib
import json
import os
import re
import textwrap
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from navbake.config.settings import (
    YAML_SUFFIXES,
    BakeConfig,
    find_source,
    is_settings,
    load_config,
    parse_config,
)
from navbake.errors import ConfigError, SceneError
from navbake.files import hint_at_file, write_whole
from navbake.formats.scene_files import SCENE_SUFFIXES
from navbake.known_names import append_hint
from navbake.yaml_text import parse_yaml

SCHEMA_NAME = "navbake.schema.json"  # where settings look for their JSON Schema, beside them
LINE_LENGTH = 110  # longest line of a template
COMMENT_COLUMN = 34  # where comments beside settings begin


def render_template(config: BakeConfig) -> str:
    """Write settings as a YAML document with comments, which reads back as the same settings."""
    lines = [
        f"# yaml-language-server: $schema={SCHEMA_NAME}",
        f"# `navbake schema -o {SCHEMA_NAME}` writes that schema: then editors complete this file.",
        "# Settings of a navbake bake: metres, world frame with z up.",
        "# Every key but scene.path may be left out.",
    ]
    return "\n".join([*lines, *_write_section_lines(config)]) + "\n"


def make_schema() -> dict[str, Any]:
    """Make the JSON Schema of the settings, by which editors complete and check a YAML file.

    It refuses nothing that `navbake.bake` accepts. Rules on several settings are not in it.
    """
    schema = BakeConfig.model_json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Settings of a navbake bake",
        "description": "Metres, world frame with z up.",
    }


def write_template(
    scene: str | PathLike[str], path: str | PathLike[str] | None = None, *, force: bool = False
) -> Path:
    """Write the default settings for a scene, with comments.

    Args:
        scene: The path of the scene.
        path: The path to write, which ends in .yaml or .yml; None for ``<scene id>.yaml`` in the
            current folder.
        force: Overwrite an existing file.

    Returns:
        The path of the written file.

    Raises:
        ConfigError: The path exists or cannot be written, or `scene` is settings or a grid.
        SceneError: There is no such scene.
    """
    name, text = make_template(Path(scene), Path() if path is None else Path(path).parent)
    path = Path(name if path is None else path)
    if path.suffix.lower() not in YAML_SUFFIXES:
        expected = "a name that ends in .yaml"
        raise ConfigError(f"expected {expected}, got {path}", path=str(path), expected=expected)
    if os.path.exists(path) and not force:
        hint = "--force overwrites it"
        raise ConfigError(f"{path} exists; {hint}", path=str(path), hint=hint)
    try:
        write_whole(text.encode(), path)
    except OSError as error:
        message = f"cannot write {path}: {error.strerror}"
        raise ConfigError(message, path=str(path)) from error
    return path


def make_template(scene: Path, folder: Path) -> tuple[str, str]:
    """Make the YAML template of a scene.

    Args:
        scene: The path of the scene.
        folder: The folder that the template is for; `scene.path` in it is relative to this folder.

    Returns:
        The name of the file, ``<scene id>.yaml``, and its text.

    Raises:
        ConfigError: `scene` is settings or a grid.
        SceneError: There is no such scene.
    """
    source = find_source(scene)
    if is_settings(source):
        message = f"expected a scene, got the settings file {source}"
        hint = None
        if source != scene:
            hint = f"`navbake samples {scene}` copies the sample"
            message += f": {hint}"
        raise ConfigError(message, path=str(source), expected="a scene", hint=hint)
    scene_id = load_config(scene).scene.id
    if not os.path.isfile(scene):
        hint = hint_at_file(scene, SCENE_SUFFIXES)
        message = append_hint(f"no such file: {scene}", hint)
        raise SceneError(message, path=str(scene), hint=hint or None)
    scene = scene.resolve()
    with contextlib.suppress(ValueError):  # Windows has no relative path to another drive
        scene = Path(os.path.relpath(scene, folder.resolve()))
    template_text = render_template(parse_config({"scene": {"path": scene, "id": scene_id}}))
    # check that the text reads back, whatever the file's name
    file_name = f"{scene_id}.yaml"
    parse_config(parse_yaml(template_text, str(folder / file_name)), str(folder / file_name))
    return file_name, template_text


def _write_section_lines(section: BaseModel, indent: str = "") -> list[str]:
    """Write a line for each setting, with its comment beside it, or above if that is too long."""
    lines = []
    for key, field in type(section).model_fields.items():
        key_name = field.alias or key
        value = getattr(section, key)
        comment = field.description or ""
        if not indent:
            lines.append("")
        if isinstance(value, BaseModel):
            lines.append(f"{indent}{key_name}:  # {comment}")
            lines += _write_section_lines(value, indent + "  ")
            continue
        line = f"{indent}{key_name}: {_to_flow_style(value)}"
        commented_line = f"{line:<{COMMENT_COLUMN}}  # {comment}"
        if len(commented_line) <= LINE_LENGTH:
            lines.append(commented_line)
        else:
            comment_lines = textwrap.wrap(comment, LINE_LENGTH - len(indent) - 2)
            lines += [f"{indent}# {comment_line}" for comment_line in comment_lines]
            lines.append(line)
    return lines


def _to_flow_style(value: object) -> str:
    """Write a value as JSON (YAML's flow style); text without quotes if YAML allows it."""
    if isinstance(value, Path):
        value = value.as_posix()
    is_word = isinstance(value, str) and re.fullmatch(r"[A-Za-z_.][\w./-]*", value, re.ASCII)
    if is_word and parse_yaml(str(value), "a word") == value:
        return str(value)
    return json.dumps(value, ensure_ascii=False, default=BaseModel.model_dump)
