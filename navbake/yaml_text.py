"""Writes YAML, and reads it, also from strangers.

Scalars are read as in YAML 1.2. A key that stands twice in a mapping is an error.

A file must neither fill the memory nor crash the process. A few lines with aliases can stand for
endlessly many values, so the values that aliases repeat are counted. Deep nesting is an error,
because Python code with a limit of recursion puts the values together. Only the parser is libyaml,
which is fast; its own composer crashes at deep nesting.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml
from yaml.composer import Composer

from navbake.errors import ConfigError

if TYPE_CHECKING:  # it loads numpy
    from navbake.types import JsonValue

# settings whose keys are names, which may contain dots
MAPPINGS_OF_NAMES = (("scene", "joints"), ("scene", "meshes"))
MAX_REPEATED_VALUES = 100_000  # most values that all aliases of a file together may stand for
MERGE_KEY = "<<"  # of YAML 1.1; YAML 1.2 has none
MAX_PROBLEM = 200  # characters of a message of PyYAML, which repeats long tags and names
LINE_END = re.compile("\r\n|[\r\n\x85\u2028\u2029]")  # where both parsers count a line
# PyYAML raises these for a value that doesn't fit its explicit tag, such as ``!!bool maybe``
TAG_ERRORS = (AttributeError, IndexError, KeyError, TypeError, ValueError)
_TAG = "tag:yaml.org,2002:"
_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # libyaml's is three times as fast


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """A safe loader: ``1e-3`` is a number, ``on`` and ``2026-01-01`` are text, ``010`` is 10."""

    # An empty table in place of YAML 1.1's; the loop below fills it with YAML 1.2's core schema,
    # plus numbers like 1_000_000.
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012

    # libyaml's parser has methods of these names in C
    get_single_node = Composer.get_single_node
    compose_document = Composer.compose_document
    compose_scalar_node = Composer.compose_scalar_node
    compose_sequence_node = Composer.compose_sequence_node
    compose_mapping_node = Composer.compose_mapping_node

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.anchors: dict[str, yaml.Node] = {}
        self._num_values = 0  # so far, with those that aliases repeat
        self._num_repeated = 0
        self._sizes = dict[str, int]()  # name of an anchor -> number of values in its node

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node; count the values in it, and refuse too many of them."""
        event = self.peek_event()
        anchor = event.anchor
        if self.check_event(yaml.AliasEvent) and anchor in self.anchors:
            self._repeat(anchor, event.start_mark)
            return Composer.compose_node(self, parent, index)
        num_values_before = self._num_values
        self._num_values += 1
        node: yaml.Node | None = Composer.compose_node(self, parent, index)
        if anchor is not None:
            self._sizes[anchor] = self._num_values - num_values_before
        return node

    def _repeat(self, anchor: str, alias_mark: yaml.Mark) -> None:
        """Count the values that an alias repeats; raise an error if they are too many.

        Args:
            anchor: the name of the anchor that the alias refers to.
            alias_mark: the alias's position in the text.
        """
        if anchor not in self._sizes:
            problem = f"the alias *{anchor} stands in its own value"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=alias_mark)
        self._num_values += self._sizes[anchor]
        self._num_repeated += self._sizes[anchor]
        if self._num_repeated > MAX_REPEATED_VALUES:
            problem = f"aliases repeat more than {MAX_REPEATED_VALUES:,} values"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=alias_mark)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Refuse the keys ``<<`` of YAML 1.1, whose merging can grow without bound."""
        for key_node, _ in node.value:
            if key_node.value == MERGE_KEY and key_node.style not in ("'", '"'):
                problem = f"`{MERGE_KEY}` merges keys in YAML 1.1 alone: write the keys themselves"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = set()
        for key_node, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                continue
            if key in keys:
                problem = f"the key {key!r} stands here a second time"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            keys.add(key)
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep)
        return mapping

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


def read_yaml(path: Path) -> JsonValue:
    """Read a YAML file, see `parse_yaml`; raise a ConfigError if the file can't be read."""
    try:
        return decode_yaml(path.read_bytes(), str(path))
    except FileNotFoundError:
        raise ConfigError(f"no such file: {path}", path=str(path)) from None
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}", path=str(path)) from error


def decode_yaml(content: bytes, source: str) -> JsonValue:
    """Parse the content of a YAML file, UTF-8 with or without a byte order mark.

    Args:
        content: The bytes of the file.
        source: The name of the file, for messages.

    Raises:
        ConfigError: The content is not UTF-8, or no YAML.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        message = f"{source} is no YAML: byte {error.start} is not UTF-8"
        raise ConfigError(message, path=source, place=f"byte {error.start}") from error
    return parse_yaml(text, source)


def encode_yaml(content: object) -> bytes:
    """Encode content as YAML: keys in their order, each innermost list or mapping on one line."""
    text: str = yaml.dump(
        content, Dumper=_DUMPER, sort_keys=False, default_flow_style=None, allow_unicode=True
    )
    return text.encode()


def parse_yaml(text: str, source: str) -> JsonValue:
    """Parse one YAML document.

    Args:
        text: The document.
        source: The name of the file, for messages.

    Returns:
        Nested dicts and lists, text, numbers, booleans and None.

    Raises:
        ConfigError: The text is no YAML, or a key is there twice; the message names the line.
    """
    try:
        return yaml.load(text, _Loader)  # a SafeLoader
    except yaml.MarkedYAMLError as error:
        problem = str(error.problem or error.context)[:MAX_PROBLEM]
        line_index = error.problem_mark.line if error.problem_mark else 0
        fault = _find_likely_fault(error, text)
        if fault is not None:
            line_index = fault.line_index
        # libyaml ends the last line, and may stop behind it
        num_lines = len(LINE_END.split(text.rstrip("\r\n\x85\u2028\u2029")))
        line = min(line_index + 1, num_lines)
        message = f"{problem} in line {line} of {source}"
        if fault is not None:
            message = f"{fault.text} in line {line} of {source} ({problem})"
        hint = None if fault is None else fault.remedy
        raise ConfigError(message, path=source, place=f"line {line}", hint=hint) from error
    except RecursionError as error:
        raise ConfigError(f"{source} is nested too deeply", path=source) from error
    except (yaml.YAMLError, *TAG_ERRORS) as error:
        problem = str(error).splitlines()[0][:MAX_PROBLEM]
        raise ConfigError(f"{source} is no YAML: {problem}", path=source) from error


class _Fault(NamedTuple):
    """What is likely wrong in a YAML text.

    Attributes:
        text: the fault in plain words, before "in line 3".
        line_index: the index of the line in the text.
        remedy: what to do about it.
    """

    text: str
    line_index: int
    remedy: str


def _find_likely_fault(error: yaml.MarkedYAMLError, text: str) -> _Fault | None:
    """Find what is likely wrong at the place where the parser gave up.

    The parser says what it expected there, in the terms of YAML's grammar, and often stops only
    after the line at fault. libyaml and PyYAML's own parser use different words.

    Args:
        error: the parser's error.
        text: what was parsed.

    Returns:
        The fault; None where the parser's own words say it.
    """
    mark = error.problem_mark
    if mark is None:
        return None
    problem = str(error.problem)
    context = str(error.context)
    begin = error.context_mark or mark  # where the mapping, list or text begins
    lines = LINE_END.split(text)
    line = lines[mark.line] if mark.line < len(lines) else ""
    text_before = line[: mark.column]
    character = line[mark.column : mark.column + 1]
    if character == "\t" or " tab " in problem:
        return _Fault("found a tab where YAML wants spaces", mark.line, "indent it with spaces")
    if "cannot start any token" in problem:
        return _Fault(
            f"found text that begins with {character} and needs quotes",
            mark.line,
            f"text that begins with {character} needs quotes",
        )
    if "undefined alias" in problem:
        return _Fault(
            "found text that begins with * and needs quotes",
            mark.line,
            "text that begins with * needs quotes",
        )
    if "unknown escape character" in problem:
        return _Fault(
            "found a backslash in double quotes, in place of single ones,",
            mark.line,
            "text with a backslash needs single quotes",
        )
    if "end of stream" in problem and "quoted" in context:
        return _Fault("found a quote that is never closed", begin.line, "close the quote")
    if "could not find expected ':'" in problem:
        return _Fault(
            "found a key without a colon and a space after it",
            begin.line,
            "write a colon and a space after the key",
        )
    if "mapping values are not allowed" in problem:
        return _find_fault_at_colon(lines, mark.line, mark.column)
    if "flow" in context and "expected ','" in problem:
        bracket = "{" if "mapping" in context else "["
        return _Fault(
            f"found a {bracket} that is not closed, or no comma behind a value,",
            begin.line,
            f"close the {bracket}, and put commas between the values",
        )
    if "parsing a block" in context or "document start" in problem:
        if character and character in "}]":
            return _Fault(
                f"found a {character} without its opening bracket",
                mark.line,
                f"remove the {character}, or open its bracket",
            )
        if text_before.strip():
            return _Fault(
                "found text behind a value that ends before it",
                mark.line,
                "put the value and the text into the same quotes, or remove the text",
            )
        if error.context_mark is not None and begin.column == mark.column:
            return _Fault(
                "found a key among list items, or a list item among keys,",
                mark.line,
                "indent it below the item or the key that it belongs to",
            )
        return _Fault(
            "found an indentation that fits no line above",
            mark.line,
            "indent it as the lines that it belongs to",
        )
    return None


def _find_fault_at_colon(lines: Sequence[str], line_index: int, column: int) -> _Fault:
    """Find what is likely wrong where a parser refuses a colon.

    Args:
        lines: the lines of the text.
        line_index: the index of the line with the colon.
        column: the colon's index in its line.
    """
    if ": " in lines[line_index][:column]:
        return _Fault(
            "found a second colon, of text that needs quotes,",
            line_index,
            "text with a colon and a space needs quotes",
        )
    # the parser took the line above for the beginning of a text of several lines; such a text may
    # have blank lines
    index_above = line_index - 1
    while index_above > 0 and not lines[index_above].strip():
        index_above -= 1
    if index_above >= 0 and ":" not in lines[index_above]:
        return _Fault(
            "found a key without a colon after it", index_above, "write a colon after the key"
        )
    return _Fault(
        "found a key indented deeper than the keys above it",
        line_index,
        "indent the key as the keys above it",
    )


def apply_overrides(settings: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Return a copy of nested mappings in which some values are replaced.

    Args:
        settings: Nested mappings, as read from YAML.
        overrides: Texts ``a.b=value`` with a dotted key and a value in YAML; if there are several
            for a key, the last one counts.

    Raises:
        ConfigError: An override has no key, no YAML as its value, or a key below a value that is no
            mapping.
    """
    changed_settings = dict(settings)
    for override in overrides:
        *sections, last_key = split_override_key(override)
        value = parse_yaml(override.partition("=")[2], f"--set {override}")
        section_settings = changed_settings
        for depth, section in enumerate(sections):
            section_values = section_settings.get(section)
            if section_values is not None and not isinstance(section_values, Mapping):
                key = ".".join(sections[: depth + 1])
                message = f"`{key}` is no mapping, so there is no key for --set {override}"
                raise ConfigError(message, key=key, value=section_values, expected="a mapping")
            section_settings[section] = dict(section_values or {})
            section_settings = section_settings[section]
        section_settings[last_key] = value
    return changed_settings


def split_override_key(override: str) -> tuple[str, ...]:
    """Return the parts of the key of ``a.b=value``, split at its dots.

    The name of a joint or a mesh, which may contain dots, is one part.
    """
    dotted_key, equals_sign, _ = override.partition("=")
    key_parts = tuple(part.strip() for part in dotted_key.split("."))
    if not equals_sign or not all(key_parts):
        expected = "KEY=VALUE with a dotted key"
        raise ConfigError(
            f"expected {expected}, got --set {override}", value=override, expected=expected
        )
    for section_names in MAPPINGS_OF_NAMES:
        if key_parts[: len(section_names)] == section_names and len(key_parts) > len(section_names):
            return *section_names, ".".join(key_parts[len(section_names) :])
    return key_parts
