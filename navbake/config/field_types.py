"""Types of the settings' fields, and their errors, each on one line.

A message is ``expected <text>, got <value> at `<key>` in <file>``: a field's type has the first
part, `describe_errors` adds the rest.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    WrapValidator,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from navbake.errors import ConfigError, FormatError, shorten
from navbake.files import check_regular
from navbake.known_names import find_near
from navbake.navgrid.lattice import find_fault
from navbake.yaml_text import override_key


def refusal(text: str, **details: str) -> PydanticCustomError:
    """An error of the form ``expected <text>, got …``, with details ``got`` and ``at``."""
    return PydanticCustomError("expected", "expected {text}", {"text": text, **details})


def expects(text: str) -> WrapValidator:
    """Give all errors of a value the message ``expected <text>, got …``."""

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
    """A field with a section, which has its defaults if left out."""
    return Field(default_factory=model, description=text)


def to_path(value: Any) -> Path:
    """Convert text to a path; refuses other types."""
    if isinstance(value, str | PathLike) and str(value) and "\0" not in str(value):
        return Path(value)
    raise ValueError("no path")


def resolve(path: Path, info: ValidationInfo) -> Path:
    """Resolve a path relative to the file that names it, by the folder in pydantic's context."""
    return Path((info.context or {}).get("folder", "")) / path


def refuse_if(is_wrong: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A validator that refuses values; `expects` has the message."""

    def check(value: Any) -> Any:
        if is_wrong(value):
            raise ValueError
        return value

    return check


def read_named(key: str, read: Callable[[Path], Any]) -> Callable[[Any, ValidationInfo], Any]:
    """A validator that replaces a file's path by what it holds, so that digests cover that.

    Null is an empty list.
    """

    def take(value: Any, info: ValidationInfo) -> Any:
        if not isinstance(value, str | PathLike):
            return [] if value is None else value
        path = resolve(to_path(value), info)
        if info.context:
            info.context.setdefault("inputs", []).append(path)
        try:
            check_regular(path)
            return read(path)
        except OSError as error:
            message = f"cannot read {path}: {error.strerror}, named at `{key}`"
            raise ConfigError(message) from error
        except FormatError as error:
            raise ConfigError(f"{error}, named at `{key}`") from error

    return take


def _check_outline(points: list[list[float]]) -> list[list[float]]:
    if fault := find_fault(points):
        raise refusal("a simple outline", got=fault)
    return points


Positive = Annotated[float, Field(gt=0), expects("a number > 0")]
NotNegative = Annotated[float, Field(ge=0), expects("a number >= 0")]
Name = Annotated[str, Field(min_length=1), expects("text that is not empty")]
OptionalName = Annotated[Name | None, expects("text that is not empty, or null")]
# a single name is a list of one: `bodies: robot*`
OneOrMore = BeforeValidator(lambda value: [value] if isinstance(value, str) else value)
Patterns = Annotated[list[Name], OneOrMore]
Index = Annotated[int, Field(ge=0)]
LevelKey = Annotated[Index | Name, expects("a level's number from 0, or its name")]
Point2 = Annotated[list[float], Field(min_length=2, max_length=2)]
Point3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Position = Annotated[Point3, expects("a position [x, y, z]")]
Outline = Annotated[
    list[Point2],
    Field(min_length=3),
    expects("3 or more corners [[x, y], …]"),
    AfterValidator(_check_outline),
]
FilePath = Annotated[Path, BeforeValidator(to_path), expects("a path")]
Model = TypeVar("Model", bound=BaseModel)
# an empty `grid:` is null in YAML, and means the section's defaults
Section = Annotated[Model, BeforeValidator(lambda value: {} if value is None else value)]


class Settings(BaseModel):
    """Base of all sections: types are strict, unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True
    )


EXPECTED = dict.fromkeys(("model_type", "dict_type"), "a mapping")
EXPECTED |= dict.fromkeys(("float_type", "finite_number"), "a number")
EXPECTED |= {"list_type": "a list", "bool_type": "true or false", "invalid_key": "text as a key"}
OTHER_WORDS = dict.fromkeys(
    ("climb", "max_climb", "max_step", "step", "step_height"), "agent.traversable_floor_height"
)
OTHER_WORDS |= dict.fromkeys(("res", "resolution"), "grid.cell_size")
OTHER_WORDS |= {"file": "scene.path", "robot": "agent", "scale": "scene.unit"}
"""What other tools call a setting, and its key here."""
SINGLE: dict[str, tuple[str, Any]] = {"scene": ("path", str), "levels": ("ground", (int, float))}
"""Of a section, the key and types of what people write in place of a mapping."""
ENTRIES = ("agents", "areas", "links")  # sections of entries, whose keys none means elsewhere
MAX_SHOWN = 60  # characters of a value in a message
MAX_ITEMS = 6  # of a shown list
NESTED = (Mapping, list, tuple, set)
MAX_ERRORS = 3  # errors in a message
Location = tuple[int | str, ...]
Sections = Mapping[str, type[BaseModel]]  # the model of each section by its dotted key


def describe_errors(
    error: ValidationError, sections: Sections, source: str, overrides: Sequence[str] = ()
) -> str:
    """Describe the first three errors in one line, unknown keys first, and count the others.

    A faulty override is named in place of the source.
    """
    # an unknown key is often the reason for other errors; sorting keeps these in order
    details = sorted(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
    lines = []
    for found in details[:MAX_ERRORS]:
        # pydantic adds the tag of a union's branch, here =list and the like, and [key]
        loc = tuple(p for p in found["loc"] if not str(p).startswith("=") and p != "[key]")
        keys = ((f"--set {each}", override_key(each)) for each in reversed(overrides))
        origin = (name for name, key in keys if key[: len(loc)] == loc[: len(key)])
        lines.append(f"{_complaint(found, loc, sections)} in {next(origin, source)}")
    more = f" (and {len(details) - MAX_ERRORS} more)" if len(details) > MAX_ERRORS else ""
    return "; ".join(lines) + more


def find_unknown_key(data: Mapping[str, Any], sections: Sections, section: str = "") -> str | None:
    """Describe the first unknown key, None if all are known."""
    for key, value in data.items():
        if section in sections and key not in _keys(sections, section):
            return _unknown_key((*filter(None, section.split(".")), key), sections)
        below = f"{section}.{key}".lstrip(".")
        if isinstance(value, Mapping) and (found := find_unknown_key(value, sections, below)):
            return found
    return None


def show_value(value: Any) -> str:
    """A value of a YAML file on one line, shortened: ``"5cm"``, ``true``, ``[1, 2]``."""
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list | tuple | set):
        if not value or len(value) > MAX_ITEMS or any(isinstance(v, NESTED) for v in value):
            return f"a list of {len(value)}"
        shown = f"[{', '.join(show_value(item) for item in value)}]"
        return shown if len(shown) <= MAX_SHOWN else f"a list of {len(value)}"
    is_word = value is None or isinstance(value, bool | str)
    shown = json.dumps(value, ensure_ascii=False) if is_word else str(value)
    return shown if len(shown) <= MAX_SHOWN else shown[: MAX_SHOWN - 1] + "…"


def _complaint(error: ErrorDetails, loc: Location, sections: Sections) -> str:
    kind = error["type"]
    context = error.get("ctx", {})
    value = error["input"]
    if kind == "extra_forbidden":
        return _unknown_key(loc, sections)
    if kind == "missing":
        return f"expected a value, found none at `{_dotted(loc)}`"
    expected = context.get("text") or EXPECTED.get(kind) or error["msg"]
    if kind == "literal_error":
        expected = context["expected"].replace("'", "")
    key, kinds = SINGLE.get(str(loc[0]), ("", ()))
    if kind == "model_type" and isinstance(value, kinds) and not isinstance(value, bool):
        expected += f" such as {{{key}: {shorten(str(value))}}}"
    got = context.get("got") or show_value(value)
    return f"expected {expected}, got {got} at `{_dotted(loc)}{context.get('at', '')}`"


def _unknown_key(loc: Location, sections: Sections) -> str:
    """Suggest the nearest known key, of the same section first."""
    section = ".".join(p for p in loc[:-1] if isinstance(p, str))
    unknown = str(loc[-1])
    section = section if section in sections else section.rpartition(".")[0]  # below a name
    known = _keys(sections, section)
    elsewhere = dict[str, str]()
    # reversed, so that of sections with a key in common the first one is named
    for name in reversed([name for name in sections if name not in ENTRIES]):
        elsewhere |= _keys(sections, name)
    near = [keys[name] for keys in (known, elsewhere) for name in find_near(unknown, keys)]
    meant = OTHER_WORDS.get(unknown, "")
    if meant and section in ("", meant.rpartition(".")[0]):
        near = [meant]
    say = f"the nearest known one is `{near[0]}`" if near else f"known are {', '.join(known)}"
    return f"unknown key `{shorten(_dotted(loc))}`, {say},"


def _keys(sections: Sections, section: str) -> dict[str, str]:
    """The dotted keys of a section by their last parts."""
    keys = [field.alias or name for name, field in sections[section].model_fields.items()]
    return {key: f"{section}.{key}".lstrip(".") for key in keys}


def _dotted(loc: Location) -> str:
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc)
    return "".join(parts).lstrip(".")
