"""Gives fields of classes their text in the reference: the comment ``#: …`` beside or above them.

griffe, which reads docstrings for mkdocstrings, knows no such comments. mkdocs.yml names this
module as an extension of it.
"""

from __future__ import annotations

from typing import Any

import griffe

MARK = "#:"


class FieldComments(griffe.Extension):
    """Makes the comment of a field its docstring."""

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Read the comment of a field that has no docstring."""
        if attr.docstring is not None or attr.lineno is None or attr.endlineno is None:
            return
        source_lines = attr.lines_collection[attr.filepath]
        last_line = source_lines[attr.endlineno - 1]
        if MARK in last_line:
            text = last_line.partition(MARK)[2].strip()
        else:
            comment_lines: list[str] = []
            line_index = attr.lineno - 2
            while line_index >= 0 and source_lines[line_index].strip().startswith(MARK):
                comment_lines.insert(0, source_lines[line_index].partition(MARK)[2].strip())
                line_index -= 1
            text = " ".join(comment_lines)
        if text:
            attr.docstring = griffe.Docstring(text, parent=attr)
