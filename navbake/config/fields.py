"""What the models of the settings are made of: kinds of values, and what errors call them."""

from __future__ import annotations

import json
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

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


def expects(text: str) -> WrapValidator:
    """Say one thing for all that can be wrong with a value: ``expected <text>, got …``."""

    def check(value: Any, validate: Callable[[Any], Any]) -> Any:
        try:
            return validate(value)
        except (ValidationError, ValueError):
            raise PydanticCustomError("expected", "expected {text}", {"text": text}) from None

    return WrapValidator(check)


def setting(default: Any, text: str, default_text: str | None = None) -> Any:
    """A field whose description is `text` (meaning, [unit], range) and its default."""
    if default_text is None:
        default_text = default if isinstance(default, str) else json.dumps(default)
    return Field(default=default, description=f"{text}; default {default_text}")


def to_path(value: Any) -> Any:
    if isinstance(value, str | PathLike) and str(value) and "\0" not in str(value):
        return Path(value)
    raise ValueError("no path")


def resolve(path: Path, info: ValidationInfo) -> Path:
    """Make a path relative to the file that names it, where the context tells its folder."""
    return Path((info.context or {}).get("folder", "")) / path


def check_distinct(value: list[str]) -> list[str]:
    if len(set(value)) < len(value):
        raise ValueError("twice")
    return value


Number = Annotated[float, expects("a number")]
Positive = Annotated[float, Field(gt=0), expects("a number > 0")]
NotNegative = Annotated[float, Field(ge=0), expects("a number >= 0")]
Flag = Annotated[bool, expects("true or false")]
Name = Annotated[str, Field(min_length=1), expects("text that is not empty")]
FilePath = Annotated[Path, BeforeValidator(to_path), expects("a path")]
# an omitted section may stand there with nothing under it
Section = BeforeValidator(lambda value: {} if value is None else value)


class Settings(BaseModel):
    """Strict: text is no number, a number no flag, nan and inf nothing, unknown keys refused."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True
    )
