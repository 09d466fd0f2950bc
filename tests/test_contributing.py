"""CONTRIBUTING's tables name folders, files and functions: all of them exist."""

import re
from pathlib import Path

import pytest

from project_paths import ROOT

CODE = re.compile(r"`([^`]+)`")
FILE_SUFFIXES = (".py", ".html", ".js", ".css", ".toml", ".md")
IDENTIFIER = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


def read_rows() -> list[tuple[str, str]]:
    """Return the two cells of each row of the tables, without heads and rules."""
    rows = []
    for line in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("| ") and len(cells) == 2 and cells[0] not in ("folder", "question"):
            rows.append((cells[0], cells[1]))
    return rows


def is_path(name: str) -> bool:
    """Return whether a name is that of a file or a folder."""
    return " " not in name and ("/" in name or name.endswith(FILE_SUFFIXES))


def check_row(first_cell: str, second_cell: str) -> list[str]:
    """Return the paths and names of a row that don't exist.

    A path is relative to the checkout, or to a folder that the row has named before. An identifier
    of the second cell occurs in a file of the row, or in a folder of the first cell.
    """
    missing = []
    folders = [ROOT]
    searched: list[Path] = []
    identifiers = []
    for cell in (first_cell, second_cell):
        for name in CODE.findall(cell):
            full_name = name.replace("… ", "navbake/baker/")
            if is_path(full_name):
                paths = [folder / full_name for folder in folders if (folder / full_name).exists()]
                if not paths:
                    missing.append(name)
                    continue
                path = paths[-1]
                folders.append(path if path.is_dir() else path.parent)
                if path.is_file() or cell == first_cell:
                    searched.append(path)
            elif cell == second_cell and IDENTIFIER.fullmatch(name):
                identifiers.append(name)
    sources = [
        source.read_text(encoding="utf-8")
        for path in searched
        for source in ([path] if path.is_file() else sorted(path.glob("*.py")))
    ]
    for identifier in identifiers:
        words = [re.compile(rf"\b{word}\b") for word in identifier.split(".")]
        # one file has all words of a dotted name
        if not any(all(word.search(source) for word in words) for source in sources):
            missing.append(identifier)
    return missing


def test_every_path_and_name_of_the_tables_exists() -> None:
    rows = read_rows()
    assert len(rows) > 50
    missing = {first: names for first, second in rows if (names := check_row(first, second))}
    assert missing == {}


@pytest.mark.parametrize(
    ("second_cell", "missing"),
    [
        ("`grow_levels` in `navbake/baker/floors/growth.py`", []),
        ("`grow_levels` in `growth.py`", ["growth.py", "grow_levels"]),
        ("`grow_cellar` in `navbake/baker/floors/growth.py`", ["grow_cellar"]),
        ("`TrackedScene.find_change` in `navbake/baker/live/tracked_scene.py`", []),
        ("`TrackedScene.rest` in `navbake/baker/live/tracked_scene.py`", ["TrackedScene.rest"]),
        ("`kernels/` in `navbake/baker/`", ["kernels/"]),
    ],
)
def test_what_does_not_exist_is_found(second_cell: str, missing: list[str]) -> None:
    assert check_row("a question", second_cell) == missing
