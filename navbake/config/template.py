"""Writes YAML to start from: every setting with its meaning, unit, range and default."""

from __future__ import annotations

import contextlib
import json
import os
import re
import textwrap
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from navbake.config.settings import YAML_SUFFIXES, BakeConfig, load_config, parse_config
from navbake.config.yaml_text import parse_yaml
from navbake.errors import ConfigError, SceneError
from navbake.files import write_whole

LINE_LENGTH = 110
COMMENT_COLUMN = 34


def render_template(config: BakeConfig) -> str:
    """Write settings as a commented YAML document, which reads back as the same settings."""
    lines = [
        "# Settings of a navbake bake: metres, world frame with z up.",
        "# Every key but scene.path may be left out.",
    ]
    for name, field in BakeConfig.model_fields.items():
        lines += ["", *_setting_lines(name, getattr(config, name), field.description or "", "")]
    return "\n".join(lines) + "\n"


def write_template(
    scene: str | PathLike[str], path: str | PathLike[str] | None = None, *, force: bool = False
) -> Path:
    """Write the commented default settings for a scene, and return the path that was written.

    The path is ``<scene id>.yaml`` in the current folder if None; `force` overwrites a file.

    Raises:
        SceneError: there is no such scene.
        ConfigError: the YAML exists, or cannot be written.
    """
    scene = Path(scene)
    if scene.suffix.lower() in YAML_SUFFIXES:
        raise ConfigError(f"expected a scene, got the settings file {scene}")
    if not scene.is_file():
        raise SceneError(f"no such file: {scene}")
    config = load_config(scene)
    path = Path(f"{config.scene.id}.yaml" if path is None else path)
    if path.suffix.lower() not in YAML_SUFFIXES:
        raise ConfigError(f"expected a name that ends in .yaml, got {path}")
    if path.exists() and not force:
        raise ConfigError(f"{path} exists; --force overwrites it")
    text = render_template(_relative_to(config, path.parent))
    # Names of files can be anything: make sure that the text reads back.
    parse_config(parse_yaml(text, str(path)), str(path))
    try:
        write_whole(text.encode(), path)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
    return path


def _relative_to(config: BakeConfig, folder: Path) -> BakeConfig:
    path = config.scene.path.resolve()
    with contextlib.suppress(ValueError):  # Windows has no relative path to another drive
        path = Path(os.path.relpath(path, folder.resolve()))
    return config.model_copy(update={"scene": config.scene.model_copy(update={"path": path})})


def _setting_lines(name: str, value: Any, description: str, indent: str) -> list[str]:
    if isinstance(value, BaseModel):
        lines = [f"{indent}{name}:  # {description}"]
        for key, field in type(value).model_fields.items():
            lines += _setting_lines(
                field.alias or key, getattr(value, key), field.description or "", indent + "  "
            )
        return lines
    line = f"{indent}{name}: {_flow(value)}"
    commented = f"{line:<{COMMENT_COLUMN}}  # {description}"
    if len(commented) <= LINE_LENGTH:
        return [commented]
    comment = textwrap.wrap(description, LINE_LENGTH - len(indent) - 2)
    return [*(f"{indent}# {part}" for part in comment), line]


def _flow(value: Any) -> str:
    """A value as JSON, which is YAML's flow style; without quotes where YAML reads it as text."""
    value = value.as_posix() if isinstance(value, Path) else value
    is_word = isinstance(value, str) and re.fullmatch(r"[A-Za-z_.][\w./-]*", value, re.ASCII)
    if is_word and parse_yaml(value, "a word") == value:
        return str(value)
    return json.dumps(value, ensure_ascii=False, default=BaseModel.model_dump)
