"""Writes YAML, and reads hand-written YAML: plain scalars as in YAML 1.2, and unique keys."""

import re
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from navbake.errors import ConfigError

MAPPINGS_OF_NAMES = (("scene", "joints"), ("scene", "meshes"))  # their keys may hold dots
MOST_SHOWN = 200  # characters of a message of PyYAML, which repeats long tags and names
# raised by PyYAML for a value that doesn't fit its explicit tag, as in ``!!bool maybe``
UNFIT = (AttributeError, IndexError, KeyError, TypeError, ValueError)
_TAG = "tag:yaml.org,2002:"


class _Loader(yaml.SafeLoader):
    """SafeLoader, but ``1e-3`` is a number, ``on`` and ``2026-01-01`` are text, ``010`` is 10."""

    # An empty table in place of YAML 1.1's; the loop below fills it with YAML 1.2's core schema,
    # plus numbers like 1_000_000.
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Don't merge keys ``<<``, which can grow without bound."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key_node, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen:
                text = f"the key {key!r} stands here a second time"
                raise yaml.constructor.ConstructorError(None, None, text, key_node.start_mark)
            seen |= {key} if isinstance(key, Hashable) else set()
        return super().construct_mapping(node, deep)

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        return int(str(self.construct_scalar(node)))


_Loader.add_constructor(_TAG + "int", _Loader.construct_integer)
for _name, _pattern in {
    "bool": r"true|True|TRUE|false|False|FALSE",
    "null": r"~|null|Null|NULL|",
    "int": r"[-+]?[0-9]+(?:_[0-9]+)*",
    "float": r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
}.items():
    _Loader.add_implicit_resolver(_TAG + _name, re.compile(rf"^(?:{_pattern})$"), None)


def read_yaml(path: Path) -> Any:
    try:
        return decode_yaml(path.read_bytes(), str(path))
    except FileNotFoundError:
        raise ConfigError(f"no such file: {path}") from None
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error


def decode_yaml(content: bytes, source: str) -> Any:
    """Parse a YAML file's content; a ConfigError names the source."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{source} is no YAML: byte {error.start} is not UTF-8") from error
    return parse_yaml(text, source)


def encode_yaml(content: Any) -> bytes:
    """Encode content as YAML in its own order, innermost lists and mappings in a line."""
    text: str = yaml.safe_dump(
        content, sort_keys=False, default_flow_style=None, allow_unicode=True
    )
    return text.encode()


def parse_yaml(text: str, source: str) -> Any:
    """Parse one YAML document; a ConfigError names the source, and the line of a syntax error."""
    try:
        return yaml.load(text, _Loader)  # a SafeLoader
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        problem = str(error.problem or error.context)[:MOST_SHOWN]
        hint = "; text that begins with * needs quotes" if "alias" in problem else ""
        raise ConfigError(f"{problem} in line {line} of {source}{hint}") from error
    except RecursionError as error:
        raise ConfigError(f"{source} is nested too deeply") from error
    except (yaml.YAMLError, *UNFIT) as error:
        problem = str(error).splitlines()[0][:MOST_SHOWN]
        raise ConfigError(f"{source} is no YAML: {problem}") from error


def apply_overrides(data: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Set each ``a.b=value`` in a copy of nested mappings; the last one of a key counts."""
    result = dict(data)
    for override in overrides:
        *sections, last = override_key(override)
        value = parse_yaml(override.partition("=")[2], f"--set {override}")
        target = result
        for depth, section in enumerate(sections):
            inner = target.get(section)
            if inner is not None and not isinstance(inner, Mapping):
                text = f"`{'.'.join(sections[: depth + 1])}` is no mapping"
                raise ConfigError(f"{text}, so there is no key for --set {override}")
            target[section] = dict(inner or {})
            target = target[section]
        target[last] = value
    return result


def override_key(override: str) -> tuple[str, ...]:
    """Split the key of ``a.b=value`` at its dots; a name of a joint or mesh may hold dots."""
    dotted, equals, _ = override.partition("=")
    parts = tuple(part.strip() for part in dotted.split("."))
    if not equals or not all(parts):
        raise ConfigError(f"expected KEY=VALUE with a dotted key, got --set {override}")
    for names in MAPPINGS_OF_NAMES:
        if parts[: len(names)] == names and len(parts) > len(names):
            return *names, ".".join(parts[len(names) :])
    return parts
