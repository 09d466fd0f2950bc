"""Types of the settings' fields: each checks its value and words the error message.

A message reads ``expected <text>, got <value> at `<key>` in <file>``: the types here give its first
part, `navbake.config.errors` the rest.
"""

import json
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    WrapValidator,
)
from pydantic_core import PydanticCustomError


def refusal(text: str, **details: str) -> PydanticCustomError:
    """The error to raise for a value: ``expected <text>, got …``.

    The details are ``got`` and ``at``, where the value's own text and key are not the ones to show.
    """
    return PydanticCustomError("expected", "expected {text}", {"text": text, **details})


def expects(text: str) -> WrapValidator:
    """Give every error of a value one message: ``expected <text>, got …``."""

    def check(value: Any, validate: Callable[[Any], Any]) -> Any:
        try:
            return validate(value)
        except (ValidationError, ValueError):
            raise refusal(text) from None

    return WrapValidator(check)


def setting(default: Any, text: str, default_text: str | None = None) -> Any:
    """A field with a default, described by `text` (meaning, [unit], range) and that default."""
    if default_text is None:
        default_text = default if isinstance(default, str) else json.dumps(default)
    return Field(default=default, description=f"{text}; default {default_text}")


def section(model: type[BaseModel], text: str) -> Any:
    """A field that holds a section, whose settings have their defaults if it is left out."""
    return Field(default_factory=model, description=text)


def to_path(value: Any) -> Path:
    """Take text or a path for a path; anything else is refused."""
    if isinstance(value, str | PathLike) and str(value) and "\0" not in str(value):
        return Path(value)
    raise ValueError("no path")


def resolve(path: Path, info: ValidationInfo) -> Path:
    """Take a path relative to the file that names it, whose folder is in pydantic's context."""
    return Path((info.context or {}).get("folder", "")) / path


def check_distinct(value: list[str]) -> list[str]:
    if len(set(value)) < len(value):
        raise ValueError("twice")
    return value


Positive = Annotated[float, Field(gt=0), expects("a number > 0")]
NotNegative = Annotated[float, Field(ge=0), expects("a number >= 0")]
Name = Annotated[str, Field(min_length=1), expects("text that is not empty")]
OptionalName = Annotated[Name | None, expects("text that is not empty, or null")]
# one pattern is a list of one: `bodies: robot*`
Patterns = Annotated[
    list[Name], BeforeValidator(lambda value: [value] if isinstance(value, str) else value)
]
FilePath = Annotated[Path, BeforeValidator(to_path), expects("a path")]
Model = TypeVar("Model", bound=BaseModel)
# `grid:` with nothing under it is null in YAML, and means the section's defaults
Section = Annotated[Model, BeforeValidator(lambda value: {} if value is None else value)]


class Settings(BaseModel):
    """Base of all sections: types are strict, unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True
    )
