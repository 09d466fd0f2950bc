"""Types of the fields of settings, and their error messages, each on one line.

A message is ``expected <text>, got <value> at `<key>` in <file>``. A field's type holds the text of
what it expects; `make_config_error` adds the value, the key and the file.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    ValidationInfo,
    WrapValidator,
)
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError

from navbake.errors import ConfigError, FormatError, shorten
from navbake.files import can_be_path, check_regular
from navbake.known_names import find_similar_names
from navbake.navgrid.lattice import find_outline_fault
from navbake.yaml_text import split_override_key


def expected_error(text: str, **details: str) -> PydanticCustomError:
    """Make the error that a validator raises, of the form ``expected <text>, got …``.

    Args:
        text: What is expected.
        **details: Optional parts of the message. ``got`` replaces the text of the wrong value.
            ``at`` is appended to the key, such as ``[0].name`` for the first entry's name.
    """
    return PydanticCustomError("expected", "expected {text}", {"text": text, **details})


def replace_error_text(text: str) -> WrapValidator:
    """Make a validator that replaces any error of a field by ``expected <text>, got …``."""

    def validate_with_text(value: object, validate: Callable[[object], object]) -> object:
        try:
            return validate(value)
        except (ValidationError, ValueError):
            raise expected_error(text) from None

    return WrapValidator(validate_with_text)


class AlsoAcceptsInSchema:
    """Adds the short forms that a setting accepts, such as ``rooms: none``, to its JSON Schema.

    Args:
        *types: The types of the short forms, as JSON Schema names them, such as ``null``.
        words: The words that are short forms.
    """

    def __init__(self, *types: str, words: Sequence[str] = ()) -> None:
        self.schemas: list[dict[str, Any]] = [{"type": name} for name in types]
        if words:
            self.schemas.append({"enum": list(words)})

    def __get_pydantic_json_schema__(
        self, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the setting's schema, for pydantic: the full form, or one of the short ones."""
        return {"anyOf": [handler(core_schema), *self.schemas]}


def setting(default: Any, text: str, default_text: str | None = None) -> Any:
    """Make a field with a default.

    Args:
        default: The default value.
        text: The description, for templates and docs: meaning, [unit], range.
        default_text: The default as the description shows it; None to show `default` itself.
    """
    if default_text is None:
        default_text = default if isinstance(default, str) else json.dumps(default)
    return Field(default=default, description=f"{text}; default {default_text}")


def section(model: type[BaseModel], text: str) -> Any:
    """Make a field that holds a section of settings; a missing section has all its defaults.

    Args:
        model: The class of the section.
        text: The description, for templates and docs.
    """
    return Field(default_factory=model, description=text)


def to_path(value: object) -> Path:
    """Convert text to a path; raise pydantic's error for a value that can't be a path."""
    if isinstance(value, str | PathLike) and str(value) and can_be_path(str(value)):
        return Path(value)
    raise expected_error("a path")


def resolve_path_setting(path: Path, info: ValidationInfo) -> Path:
    """Resolve a path relative to the folder of the file that names it.

    Args:
        path: The path.
        info: Pydantic's information, whose context has that folder.
    """
    return Path((info.context or {}).get("folder", "")) / path


def refuse_if(is_wrong: Callable[[Any], object]) -> Callable[[Any], Any]:
    """Make a validator that raises a ValueError for some values.

    The validator `replace_error_text` of the same field replaces this error by its own message.

    Args:
        is_wrong: Called with the value; returns something true if the value is to be refused.
    """

    def check_value(value: Any) -> Any:
        if is_wrong(value):
            raise ValueError
        return value

    return check_value


def read_if_file(
    key: str, read: Callable[[Path], object]
) -> Callable[[object, ValidationInfo], object]:
    """Make a validator that replaces the path of a file by the content of the file.

    So the digest of the settings depends on the file's content. Null becomes an empty list. Values
    of other types stay as they are.

    Args:
        key: The dotted key of the setting, for messages.
        read: Reads the file; may raise a FormatError.
    """

    def load_value(value: object, info: ValidationInfo) -> object:
        if not isinstance(value, str | PathLike):
            return [] if value is None else value
        path = resolve_path_setting(to_path(value), info)
        if info.context:
            info.context.setdefault("inputs", []).append(path)
        try:
            check_regular(path)
            return read(path)
        except OSError as error:
            message = f"cannot read {path}: {error.strerror}, named at `{key}`"
            raise ConfigError(message, path=str(path), key=key) from error
        except FormatError as error:
            message = f"{error}, named at `{key}`"
            raise ConfigError(
                message,
                path=str(path),
                key=key,
                value=error.value,
                expected=error.expected,
                place=error.place,
                hint=error.hint,
            ) from error

    return load_value


def _check_outline(points: list[list[float]]) -> list[list[float]]:
    outline_fault = find_outline_fault(points)
    if outline_fault:
        raise expected_error("a simple outline", got=outline_fault)
    return points


Positive = Annotated[float, Field(gt=0), replace_error_text("a number > 0")]
NotNegative = Annotated[float, Field(ge=0), replace_error_text("a number >= 0")]
Name = Annotated[str, Field(min_length=1), replace_error_text("text that is not empty")]
OptionalName = Annotated[Name | None, replace_error_text("text that is not empty, or null")]
# a single name is a list of one: `bodies: robot*`
OneOrMore = BeforeValidator(lambda value: [value] if isinstance(value, str) else value)
Patterns = Annotated[list[Name], OneOrMore, AlsoAcceptsInSchema("string")]
Index = Annotated[int, Field(ge=0)]
LevelKey = Annotated[Index | Name, replace_error_text("a level's number from 0, or its name")]
Point2 = Annotated[list[float], Field(min_length=2, max_length=2)]
Point3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Position = Annotated[Point3, replace_error_text("a position [x, y, z]")]
Outline = Annotated[
    list[Point2],
    Field(min_length=3),
    replace_error_text("3 or more corners [[x, y], …]"),
    AfterValidator(_check_outline),
]
FilePath = Annotated[Path, BeforeValidator(to_path), replace_error_text("a path")]
Model = TypeVar("Model", bound=BaseModel)
# an empty `grid:` is null in YAML, and means the section's defaults
Section = Annotated[
    Model,
    BeforeValidator(lambda value: {} if value is None else value),
    AlsoAcceptsInSchema("null"),
]


class Settings(BaseModel):
    """Base class of all sections: types are strict; unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True
    )


EXPECTED_TEXTS = dict.fromkeys(("model_type", "dict_type"), "a mapping")
EXPECTED_TEXTS |= dict.fromkeys(("float_type", "finite_number"), "a number")
EXPECTED_TEXTS |= {
    "list_type": "a list",
    "bool_type": "true or false",
    "invalid_key": "text as a key",
}
"""Type of pydantic's error -> what is expected, for messages."""

KEYS_OF_OTHER_TOOLS = dict.fromkeys(
    ("climb", "max_climb", "max_step", "step", "step_height"), "agent.traversable_floor_height"
)
KEYS_OF_OTHER_TOOLS |= dict.fromkeys(("res", "resolution"), "grid.cell_size")
KEYS_OF_OTHER_TOOLS |= {"file": "scene.path", "robot": "agent", "scale": "scene.unit"}
"""Key of a setting in other tools -> its dotted key here."""


class ShortForm(NamedTuple):
    """A value that people often write in place of a section, which is a mapping.

    For example, they write ``scene: house.xml`` for ``scene: {path: house.xml}``. The error's
    message then shows the section.
    """

    key: str  # the key that the value belongs to
    kinds: tuple[type, ...]  # the types of such values

    def is_used(self, value: object) -> bool:
        """Return whether a value has one of the types of this short form."""
        return isinstance(value, self.kinds) and not isinstance(value, bool)


SHORT_FORMS = {
    "scene": ShortForm("path", (str,)),
    "levels": ShortForm("ground", (int, float)),
}
ENTRY_SECTIONS = ("agents", "areas", "links")  # other sections' unknown keys aren't meant for these
MAX_VALUE_LENGTH = 60  # largest number of characters of a value in a message
MAX_ITEMS = 6  # longer lists are shown in a message by their length
MAX_ERRORS = 3  # largest number of errors in a message
NESTED_TYPES = (Mapping, list, tuple, set)
Location = tuple[int | str, ...]
"""The keys and list indices that lead to a value, from the top."""
Sections = Mapping[str, type[BaseModel]]
"""Dotted key of a section -> its class."""


class Fault(NamedTuple):
    """A wrong setting: the message about it, and the parts of this message."""

    text: str  # the message, without the file
    key: str  # dotted
    value: object = None
    expected: str | None = None
    hint: str | None = None


def make_config_error(
    error: ValidationError, sections: Sections, source: str, overrides: Sequence[str] = ()
) -> ConfigError:
    """Convert pydantic's errors to one ConfigError on one line.

    The message has the first three errors, unknown keys first, and the number of the remaining
    ones. The attributes of the ConfigError describe the first error.

    Args:
        error: What pydantic raised.
        sections: The class of each section.
        source: What the settings were read from, such as a file's name.
        overrides: The texts ``a.b=value`` that replace settings. If the fault is in one of them,
            the message names it in place of `source`.
    """
    # an unknown key is often the reason for other errors; sorting keeps these in order
    error_details = sorted(
        error.errors(), key=lambda error_detail: error_detail["type"] != "extra_forbidden"
    )
    faults: list[Fault] = []
    sources_of_faults: list[str] = []
    for error_detail in error_details[:MAX_ERRORS]:
        # pydantic adds tags of unions' branches, such as =list, and [key]
        location = tuple(
            part
            for part in error_detail["loc"]
            if not str(part).startswith("=") and part != "[key]"
        )
        faults.append(_find_fault(error_detail, location, sections))
        sources_of_faults.append(_find_source_of_value(location, source, overrides))
    text = "; ".join(
        f"{fault.text} in {fault_source}"
        for fault, fault_source in zip(faults, sources_of_faults, strict=True)
    )
    if len(error_details) > MAX_ERRORS:
        text += f" (and {len(error_details) - MAX_ERRORS} more)"
    first_fault = faults[0]
    return ConfigError(
        text,
        path=sources_of_faults[0],
        key=first_fault.key,
        value=first_fault.value,
        expected=first_fault.expected,
        hint=first_fault.hint,
    )


def _find_source_of_value(location: Location, source: str, overrides: Sequence[str]) -> str:
    """Return the last override that sets the value at a location or a part of it, else `source`."""
    for override in reversed(overrides):
        override_parts = split_override_key(override)
        if override_parts[: len(location)] == location[: len(override_parts)]:
            return f"--set {override}"
    return source


def find_unknown_key(
    settings: Mapping[str, Any], sections: Sections, section: str = ""
) -> str | None:
    """Find the first key that is no setting, and return the message about it.

    Args:
        settings: Nested mappings, as read from YAML.
        sections: The class of each section.
        section: The dotted key of the section that `settings` belongs to; "" for the top.

    Returns:
        The error's message, without the file; None if all keys are known.
    """
    for key, value in settings.items():
        if section in sections and key not in _list_keys(sections, section):
            return _describe_unknown_key((*filter(None, section.split(".")), key), sections).text
        if isinstance(value, Mapping):
            unknown_text = find_unknown_key(value, sections, f"{section}.{key}".lstrip("."))
            if unknown_text:
                return unknown_text
    return None


def show_value(value: object) -> str:
    """Write a value of a YAML file on one line, shortened: ``"5cm"``, ``true``, ``[1, 2]``."""
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list | tuple | set):
        is_nested = any(isinstance(element, NESTED_TYPES) for element in value)
        if not value or len(value) > MAX_ITEMS or is_nested:
            return f"a list of {len(value)}"
        text = f"[{', '.join(show_value(element) for element in value)}]"
        return text if len(text) <= MAX_VALUE_LENGTH else f"a list of {len(value)}"
    is_word = value is None or isinstance(value, bool | str)
    text = json.dumps(value, ensure_ascii=False) if is_word else str(value)
    return text if len(text) <= MAX_VALUE_LENGTH else text[: MAX_VALUE_LENGTH - 1] + "…"


def _find_fault(error: ErrorDetails, location: Location, sections: Sections) -> Fault:
    """Convert one of pydantic's errors to a fault."""
    error_type = error["type"]
    error_context = error.get("ctx", {})
    value = error["input"]
    key = _join_location(location)
    if error_type == "extra_forbidden":
        return _describe_unknown_key(location, sections)
    if error_type == "missing":
        return Fault(f"expected a value, found none at `{key}`", key, expected="a value")
    expected = error_context.get("text") or EXPECTED_TEXTS.get(error_type) or error["msg"]
    if error_type == "literal_error":
        expected = error_context["expected"].replace("'", "")
    short_form = SHORT_FORMS.get(str(location[0]))
    if error_type == "model_type" and short_form is not None and short_form.is_used(value):
        expected += f" such as {{{short_form.key}: {shorten(str(value))}}}"
    shown_value = error_context.get("got") or show_value(value)
    if "at" in error_context:  # the fault is a part of the value
        key += error_context["at"]
        value = None
    return Fault(f"expected {expected}, got {shown_value} at `{key}`", key, value, expected)


def _describe_unknown_key(location: Location, sections: Sections) -> Fault:
    """Describe an unknown key and the nearest known key, if possible one of the same section."""
    unknown_name = str(location[-1])
    section = ".".join(part for part in location[:-1] if isinstance(part, str))
    if section not in sections:
        section = section.rpartition(".")[0]  # the last part is a name, such as of an agent
    keys_of_section = _list_keys(sections, section)
    keys_elsewhere: dict[str, str] = {}
    # reversed, so that the first of several sections with the same key is named
    for name in reversed(list(sections)):
        if name not in ENTRY_SECTIONS:
            keys_elsewhere |= _list_keys(sections, name)
    near_keys = [
        keys_of_section[name] for name in find_similar_names(unknown_name, keys_of_section)
    ]
    near_keys += [keys_elsewhere[name] for name in find_similar_names(unknown_name, keys_elsewhere)]
    equivalent_key = KEYS_OF_OTHER_TOOLS.get(unknown_name, "")
    if equivalent_key and section in ("", equivalent_key.rpartition(".")[0]):
        near_keys = [equivalent_key]
    if near_keys:
        hint = f"the nearest known one is `{near_keys[0]}`"
    else:
        hint = f"known are {', '.join(keys_of_section)}"
    key = _join_location(location)
    return Fault(f"unknown key `{shorten(key)}`, {hint},", key, hint=hint)


def _list_keys(sections: Sections, section: str) -> dict[str, str]:
    """Return the keys of a section: last part of the key -> dotted key."""
    keys = [field.alias or name for name, field in sections[section].model_fields.items()]
    return {key: f"{section}.{key}".lstrip(".") for key in keys}


def _join_location(location: Location) -> str:
    """Write a location as a key: ``rooms.polygons[0].name``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).lstrip(".")
