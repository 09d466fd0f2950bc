"""Parses XML in the same way as the programs that read SDF and URDF.

Gazebo, ROS and MuJoCo parse XML by TinyXML-2, which accepts more than the standard: ``--`` in
comments, prefixes that are not declared, an ``&`` that begins no entity, blank lines before the
declaration. Namespaces mean nothing to it: ``gz:type`` is a name like any other.

Python's parser (expat) reads a file first, without namespaces. If it refuses the file, the parser
of this module reads it, by the rules of TinyXML-2. Both parsers refuse elements in more than
`MAX_DEPTH` others, and both take time in proportion to the file's size.

Source: leethomason/tinyxml2, tinyxml2.cpp (XMLNode::ParseDeep, XMLElement::ParseAttributes,
XMLUtil::GetCharacterRef), and TINYXML2_MAX_ELEMENT_DEPTH in tinyxml2.h.
"""

from __future__ import annotations

import codecs
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Set
from contextlib import suppress
from typing import NamedTuple, Protocol
from xml.parsers import expat

Element = ElementTree.Element
MAX_DEPTH = 500  # elements in elements
NAME_REGEX = r"[A-Za-z_:\x80-\U0010ffff][\w.:\-\x80-\U0010ffff]*"
NAME_PATTERN = re.compile(NAME_REGEX)
# An attribute, with the blanks before it
ATTRIBUTE_PATTERN = re.compile(rf"\s*({NAME_REGEX})\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
BLANKS_PATTERN = re.compile(r"\s*")
ENTITY_PATTERN = re.compile(r"&(?:#(\d{1,7})|#x([0-9A-Fa-f]{1,6})|(lt|gt|amp|quot|apos));")
ENTITIES = {"lt": "<", "gt": ">", "amp": "&", "quot": '"', "apos": "'"}
# How markup that is ignored begins -> how it ends
IGNORED_MARKUP = {"<!--": "-->", "<?": "?>", "<!": ">"}
CDATA_START = "<![CDATA["
CDATA_END = "]]>"
BYTE_ORDER_MARKS = {codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def parse_xml(content: bytes) -> Element:
    """Parse the content of an XML file; text after its first element is ignored.

    Args:
        content: the file's content.

    Returns:
        The first element. Names of elements and attributes are as written, with their prefixes.

    Raises:
        ValueError: there is no element, it isn't closed, or its tags are broken; the message is
            one line, with the number of the line in the file.
    """
    try:
        return _parse_standard(content)
    except (expat.ExpatError, ValueError, LookupError):
        builder = ElementTree.TreeBuilder()
        _Parser(_decode(content), builder).parse()
        return builder.close()


def find_root_tag(content: bytes) -> str:
    """Return the name of the first element of an XML file as written; empty if there is none."""
    collector = _TagCollector(frozenset(), only_first=True)
    with suppress(ValueError):
        _Parser(_decode(content), collector).parse()
    return collector.tags[0].name if collector.tags else ""


class StartTag(NamedTuple):
    """The start tag of an XML element.

    Attributes:
        name: the element's name as written, with its prefix.
        attributes: name -> value of each attribute.
    """

    name: str
    attributes: dict[str, str]


def list_start_tags(content: bytes, attribute_names: Set[str]) -> list[StartTag]:
    """List the elements of an XML file that have at least one of some attributes.

    The file's first element is always listed. Of a broken file, only the elements before its fault
    are listed.

    Args:
        content: the file's content. Bytes that are not UTF-8 are decoded as `os.fsdecode` does it,
            so that they may stand in names of files.
        attribute_names: names of the attributes.

    Returns:
        The elements' start tags, in the file's order.
    """
    collector = _TagCollector(attribute_names)
    parser = expat.ParserCreate("utf-8")  # TinyXML-2 ignores the encoding that a file states
    parser.StartElementHandler = collector.start
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, ValueError):
        collector.tags.clear()
        with suppress(ValueError):
            _Parser(_decode(content, errors="surrogateescape"), collector).parse()
    return collector.tags


def _decode(content: bytes, errors: str = "replace") -> str:
    """Decode a file as UTF-8, or as UTF-16 if it begins so.

    Args:
        content: the file's content.
        errors: what other bytes become, as `bytes.decode` takes it; U+FFFD by default.
    """
    encoding = BYTE_ORDER_MARKS.get(content[:2])
    if encoding is None:
        text = content.decode("utf-8-sig", errors=errors)
    else:
        text = content.decode(encoding, errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _parse_standard(content: bytes) -> Element:
    """Parse well-formed XML by expat, which bounds what entities expand to."""
    builder = ElementTree.TreeBuilder()
    depth = 0

    def start_element(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise ValueError(f"more than {MAX_DEPTH} elements in elements")
        builder.start(tag, attributes)

    def end_element(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser = expat.ParserCreate()  # without a separator, it leaves namespaces alone
    parser.buffer_text = True
    parser.StartElementHandler = start_element
    parser.EndElementHandler = end_element
    parser.CharacterDataHandler = builder.data
    parser.Parse(content, True)
    return builder.close()


class _Target(Protocol):
    """Receives what a parser finds, as `ElementTree.TreeBuilder` does."""

    def start(self, tag: str, attributes: dict[str, str], /) -> object:
        """Receive the beginning of an element: its name and attributes."""

    def end(self, tag: str, /) -> object:
        """Receive the end of an element: its name."""

    def data(self, data: str, /) -> object:
        """Receive a piece of the text in an element."""


class _TagCollector:
    """Collects the first start tag, and all others with one of some attributes.

    Args:
        attribute_names: names of attributes.
        only_first: whether to end the parser by a ValueError after the first start tag.

    Attributes:
        tags: the start tags.
    """

    def __init__(self, attribute_names: Set[str], *, only_first: bool = False) -> None:
        self.tags: list[StartTag] = []
        self._attribute_names = attribute_names
        self._only_first = only_first

    def start(self, tag: str, attributes: dict[str, str], /) -> None:
        if not self.tags or not self._attribute_names.isdisjoint(attributes):
            self.tags.append(StartTag(tag, attributes))
        if self._only_first:
            raise ValueError("the first element is all that counts")

    def end(self, tag: str, /) -> None:
        pass

    def data(self, data: str, /) -> None:
        pass


class _Parser:
    """Parses a text by the rules of TinyXML-2, up to the end of its first element.

    Args:
        text: the text of the file.
        target: receives the elements and their text.
    """

    def __init__(self, text: str, target: _Target) -> None:
        self._text = text
        self._position = 0
        self._target = target
        self._open_tags = list[str]()

    def parse(self) -> None:
        """Parse the text; raise a ValueError if it is broken."""
        is_done = False
        while not is_done:
            tag_start = self._text.find("<", self._position)
            if tag_start < 0:
                self._position = len(self._text)
                open_tags = self._open_tags
                missing_text = f"</{open_tags[-1][:40]}>" if open_tags else "an element"
                raise self._error(f"the file ends without {missing_text}")
            if self._open_tags and tag_start > self._position:
                self._target.data(_replace_entities(self._text[self._position : tag_start]))
            self._position = tag_start
            is_done = self._parse_markup()

    def _parse_markup(self) -> bool:
        """Parse what begins with ``<``; return whether it ends the first element."""
        text = self._text
        if text.startswith(CDATA_START, self._position):
            text_start = self._position + len(CDATA_START)
            self._skip_past(CDATA_END)
            if self._open_tags:
                self._target.data(text[text_start : self._position - len(CDATA_END)])
            return False
        for beginning, ending in IGNORED_MARKUP.items():
            if text.startswith(beginning, self._position):
                self._skip_past(ending)
                return False
        if text.startswith("</", self._position):
            return self._parse_end_tag()
        return self._parse_start_tag()

    def _skip_past(self, ending: str) -> None:
        end = self._text.find(ending, self._position)
        if end < 0:
            beginning = self._text[self._position : self._position + 9].split("\n")[0]
            raise self._error(f"expected {ending} after {beginning}")
        self._position = end + len(ending)

    def _parse_start_tag(self) -> bool:
        name_match = NAME_PATTERN.match(self._text, self._position + 1)
        if name_match is None:
            actual_text = self._text[self._position : self._position + 20].split("\n")[0]
            raise self._error(f"expected the name of an element, got {actual_text!r}")
        tag = name_match[0]
        position = name_match.end()
        attributes = dict[str, str]()
        while True:
            attribute_match = ATTRIBUTE_PATTERN.match(self._text, position)
            if attribute_match is None:
                break
            key, double_quoted, single_quoted = attribute_match.groups()
            value = double_quoted if double_quoted is not None else single_quoted
            attributes.setdefault(key, _replace_entities(value))
            position = attribute_match.end()
        blanks_match = BLANKS_PATTERN.match(self._text, position)
        position = position if blanks_match is None else blanks_match.end()
        is_empty_element = self._text.startswith("/>", position)
        if not is_empty_element and not self._text.startswith(">", position):
            actual_text = self._text[position : position + 20].split("\n")[0]
            raise self._error(f"expected an attribute or > in <{tag[:40]}>, got {actual_text!r}")
        if len(self._open_tags) == MAX_DEPTH:
            raise self._error(f"more than {MAX_DEPTH} elements in elements")
        self._target.start(tag, attributes)
        self._position = position + (2 if is_empty_element else 1)
        if is_empty_element:
            self._target.end(tag)
            return not self._open_tags
        self._open_tags.append(tag)
        return False

    def _parse_end_tag(self) -> bool:
        name_match = NAME_PATTERN.match(self._text, self._position + 2)
        tag = "" if name_match is None else name_match[0]
        open_tag = self._open_tags[-1] if self._open_tags else ""
        if not open_tag or tag != open_tag:
            wanted_text = f"expected </{open_tag[:40]}>" if open_tag else "expected an element"
            raise self._error(f"{wanted_text}, got </{tag[:40]}>")
        self._skip_past(">")
        self._target.end(tag)
        self._open_tags.pop()
        return not self._open_tags

    def _error(self, reason: str) -> ValueError:
        line = self._text.count("\n", 0, self._position) + 1
        return ValueError(f"line {line}: {reason}")


def _replace_entities(text: str) -> str:
    """Replace references to characters; what looks like one and is none stays as it is."""
    return ENTITY_PATTERN.sub(_character_of, text) if "&" in text else text


def _character_of(entity_match: re.Match[str]) -> str:
    decimal, hexadecimal, name = entity_match.groups()
    if name:
        return ENTITIES[name]
    code_point = int(decimal) if decimal else int(hexadecimal, 16)
    is_character = 0 < code_point < 0xD800 or 0xDFFF < code_point < 0x110000
    return chr(code_point) if is_character else entity_match[0]
