"""Tests, examples and scripts use public names only: what is private may change at any time."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from project_paths import ROOT

# of the standard library, public for all their underscore
DOCUMENTED = ("_", "_asdict", "_exit", "_fields", "_make", "_replace")
FOLDERS = ("tests", "examples", "scripts")
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


def private_names(source: str) -> list[str]:
    """The names with one underscore in front that code takes from somewhere else."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            found += [alias.name for alias in node.names if is_private(alias.name)]
        elif isinstance(node, ast.Attribute) and is_private(node.attr):
            is_own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
            found += [] if is_own else [node.attr]
    return found


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name not in DOCUMENTED


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_private_name_is_used(path: Path):
    assert private_names(path.read_text(encoding="utf-8")) == []


def test_private_names_are_found():
    source = "from a import _b, c, __d__\nx._e\nself._f\nx.__g__\n_, y = x\n"
    assert private_names(source) == ["_b", "_e"]
