"""Reads the elements of MJCF, also where Python's parser is stricter than MuJoCo's.

MuJoCo's parser (TinyXML-2) takes XML that expat refuses: ``--`` in a comment, ``&`` and ``<`` in
the value of an attribute, bytes that are no UTF-8, an encoding that nobody knows. It reads bytes as
they are, whatever encoding the file names, and it knows no namespaces.
"""

from __future__ import annotations

import html
import re
from xml.etree import ElementTree

# What the two parsers read in different ways: another encoding, namespaces, entities of its own
DIFFERS = re.compile(rb"xmlns|<!DOCTYPE|<\?xml[^>]*encoding\s*=\s*[\"'](?!(?i:utf-?8)[\"'])")
NAME = re.compile(rb"[^\s/>\"'=<]+")
ATTRIBUTE = re.compile(rb"\s*([^\s/>\"'=<]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
TAG_END = re.compile(rb"\s*(/?)>")
# What is no element, and where it ends
PASSED_OVER = ((b"<!--", b"-->"), (b"<![CDATA[", b"]]>"), (b"<?", b"?>"), (b"<!", b">"))
ENTITY = re.compile(r"&(?:lt|gt|amp|quot|apos|#[0-9]{1,7}|#x[0-9a-fA-F]{1,6});")
MOST_DEEP = 500  # elements in each other, from which on MuJoCo's parser refuses a file


def read_elements(content: bytes) -> ElementTree.Element | None:
    """The root element of MJCF, with all that is in it; None where there is none.

    Where MuJoCo's parser would find the XML broken, the tree ends. Texts between elements, which
    MJCF has none of, are not kept. Names that are no UTF-8 are as the system's calls give them
    (``surrogateescape``).
    """
    if not DIFFERS.search(content):
        try:
            return ElementTree.fromstring(content)
        except (ElementTree.ParseError, ValueError, LookupError, RecursionError):
            pass  # it may be one of those that MuJoCo's parser takes
    return read_leniently(content)


def read_leniently(content: bytes) -> ElementTree.Element | None:
    """The same as `read_elements`, without Python's parser, which is faster."""
    above: list[ElementTree.Element] = []
    root: ElementTree.Element | None = None
    place = content.find(b"<")
    while place >= 0:
        passed = next((each for each in PASSED_OVER if content.startswith(each[0], place)), None)
        if passed is not None:
            place = content.find(passed[1], place + len(passed[0]))
        elif content.startswith(b"</", place):
            place = content.find(b">", place)
            del above[-1:]
        else:
            name = NAME.match(content, place + 1)
            if name is None:
                return root
            attributes: dict[str, str] = {}
            place = name.end()
            while found := ATTRIBUTE.match(content, place):
                key, *values = (b"" if part is None else part for part in found.groups())
                attributes.setdefault(_text(key), _text(b"".join(values)))
                place = found.end()
            end = TAG_END.match(content, place)
            if end is None or len(above) >= MOST_DEEP:
                return root
            element = ElementTree.Element(_text(name[0]), attributes)
            if above:
                above[-1].append(element)
            elif root is None:
                root = element
            if not end[1]:
                above.append(element)
            place = end.end()
        if root is not None and not above:
            return root
        place = content.find(b"<", place) if place >= 0 else place
    return root


def _text(value: bytes) -> str:
    text = value.decode(errors="surrogateescape")
    return ENTITY.sub(lambda found: html.unescape(found[0]), text)
