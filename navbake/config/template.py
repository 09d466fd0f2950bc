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
from navbake.files import write_whole
from navbake.yaml_text import parse_yaml

LINE_LENGTH = 110
COMMENT_COLUMN = 34


def render_template(config: BakeConfig) -> str:
    """Write settings as a commented YAML document, which reads back as the same settings."""
    lines = [
        "# Settings of a navbake bake: metres, world frame with z up.",
        "# Every key but scene.path may be left out.",
    ]
    return "\n".join([*lines, *_section_lines(config)]) + "\n"


def write_template(
    scene: str | PathLike[str], path: str | PathLike[str] | None = None, *, force: bool = False
) -> Path:
    """Write the commented default settings for a scene; returns the path.

    The path is ``<scene id>.yaml`` in the current folder if None; `force` overwrites a file.
    """
    name, text = template_for(Path(scene), Path() if path is None else Path(path).parent)
    path = Path(name if path is None else path)
    if path.suffix.lower() not in YAML_SUFFIXES:
        raise ConfigError(f"expected a name that ends in .yaml, got {path}")
    if os.path.exists(path) and not force:
        raise ConfigError(f"{path} exists; --force overwrites it")
    try:
        write_whole(text.encode(), path)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
    return path


def template_for(scene: Path, folder: Path) -> tuple[str, str]:
    """The name and the text of a scene's YAML template, for a folder."""
    found = find_source(scene)
    if is_settings(found):
        hint = "" if found == scene else f": `navbake samples {scene}` copies the sample"
        raise ConfigError(f"expected a scene, got the settings file {found}{hint}")
    scene_id = load_config(scene).scene.id
    if not os.path.isfile(scene):
        raise SceneError(f"no such file: {scene}")
    scene = scene.resolve()
    with contextlib.suppress(ValueError):  # Windows has no relative path to another drive
        scene = Path(os.path.relpath(scene, folder.resolve()))
    text = render_template(parse_config({"scene": {"path": scene, "id": scene_id}}))
    # check that the text reads back, whatever the file's name
    name = f"{scene_id}.yaml"
    parse_config(parse_yaml(text, str(folder / name)), str(folder / name))
    return name, text


def _section_lines(section: BaseModel, indent: str = "") -> list[str]:
    """A line for each setting, its comment beside it, or above if too long."""
    lines = []
    for key, field in type(section).model_fields.items():
        name = field.alias or key
        value = getattr(section, key)
        comment = field.description or ""
        lines += [] if indent else [""]
        if isinstance(value, BaseModel):
            lines += [f"{indent}{name}:  # {comment}", *_section_lines(value, indent + "  ")]
            continue
        line = f"{indent}{name}: {_flow(value)}"
        commented = f"{line:<{COMMENT_COLUMN}}  # {comment}"
        if len(commented) <= LINE_LENGTH:
            lines.append(commented)
        else:
            parts = textwrap.wrap(comment, LINE_LENGTH - len(indent) - 2)
            lines += [*(f"{indent}# {part}" for part in parts), line]
    return lines


def _flow(value: Any) -> str:
    """A value as JSON (YAML's flow style), text without quotes if YAML allows it."""
    value = value.as_posix() if isinstance(value, Path) else value
    is_word = isinstance(value, str) and re.fullmatch(r"[A-Za-z_.][\w./-]*", value, re.ASCII)
    if is_word and parse_yaml(value, "a word") == value:
        return str(value)
    return json.dumps(value, ensure_ascii=False, default=BaseModel.model_dump)
