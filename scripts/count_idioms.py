"""Count the idioms that make readers of the package stop, and compare them with their limits.

    python scripts/count_idioms.py             # the table, and the files with most of each
    python scripts/count_idioms.py --worst 30  # more files

A name is vague if it says nothing of its value. A parallel assignment computes several values in
one line. A bundle is a tuple that is only made to be spread into a call. `tests/test_plain.py`
holds the counts to `LIMITS`; what they are for is in CONTRIBUTING.md, under Style.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).resolve().parents[1] / "navbake"

VAGUE_NAMES = frozenset(
    [
        "found",
        "own",
        "one",
        "ones",
        "other",
        "others",
        "known",
        "way",
        "ways",
        "chosen",
        "left",
        "kept",
        "asked",
        "here",
        "there",
        "given",
        "stated",
        "taken",
        "told",
        "judged",
        "like",
        "some",
        "every",
        "same",
        "both",
        "these",
        "those",
        "all",
        "stale",
        "named",
        "placed_by",
        "rest",
        "around",
        "whole",
    ]
)


class Idiom(NamedTuple):
    """An idiom, where it is, and how often it may be."""

    name: str
    limit: float  # of vague names in percent of all bindings, else per 1,000 lines
    lines: list[tuple[Path, int]]  # each place


LIMITS = {
    "vague names": 0.6,
    "parallel assignments": 2.0,
    "bundles": 0.0,
    "unpacked generators": 0.2,
    "touches": 0.0,
    "bare Any": 1.0,
}


class Counts(NamedTuple):
    """What was counted in a package."""

    num_lines: int  # without blank lines and comments
    num_bindings: int
    idioms: dict[str, Idiom]

    def share(self, name: str) -> float:
        """Percent of all bindings for vague names, else occurrences per 1,000 lines."""
        count = len(self.idioms[name].lines)
        if name == "vague names":
            return 100.0 * count / self.num_bindings
        return 1000.0 * count / self.num_lines


def list_bindings(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """All names that a module binds, each with its line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name, node.lineno


def find_parallel_assignments(tree: ast.AST) -> Iterator[int]:
    """Lines of ``a, b = x, y``; a swap is none."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign) or len(node.targets) != 1:
            continue
        target = node.targets[0]
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            names = sorted(ast.unparse(element) for element in target.elts)
            values = sorted(ast.unparse(element) for element in node.value.elts)
            if names != values:
                yield node.lineno


def find_unpacked_generators(tree: ast.AST) -> Iterator[int]:
    """Lines of ``a, b = (f(x) for x in …)``."""
    for node in ast.walk(tree):
        is_unpacked = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple)
        if is_unpacked and isinstance(node.value, ast.GeneratorExp | ast.ListComp):
            yield node.lineno


def find_bundles(tree: ast.AST) -> Iterator[int]:
    """Lines where a local variable becomes a tuple that the function spreads into a call."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        tuples: dict[str, int] = {}
        spread: set[str] = set()
        for node in ast.walk(function):
            if isinstance(node, ast.Assign):
                tuples.update(_tuples_of(node))
            elif isinstance(node, ast.Call):
                for argument in node.args:
                    if isinstance(argument, ast.Starred) and isinstance(argument.value, ast.Name):
                        spread.add(argument.value.id)
        yield from (line for name, line in tuples.items() if name in spread)


def _tuples_of(assignment: ast.Assign) -> Iterator[tuple[str, int]]:
    """The names that an assignment makes tuples of."""
    pairs = [(target, assignment.value) for target in assignment.targets]
    target = assignment.targets[0]
    if isinstance(target, ast.Tuple) and isinstance(assignment.value, ast.Tuple):
        pairs = list(zip(target.elts, assignment.value.elts, strict=False))
    for target, value in pairs:
        if isinstance(target, ast.Name) and isinstance(value, ast.Tuple):
            yield target.id, assignment.lineno


def find_touches(tree: ast.AST) -> Iterator[int]:
    """Lines of ``_ = stage.value``, an attribute that is read for its effect."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_":
            nodes = list(ast.walk(node.value))
            reads = any(isinstance(child, ast.Attribute) for child in nodes)
            calls = any(isinstance(child, ast.Call) for child in nodes)
            if reads and not calls:
                yield node.lineno


def find_bare_any(tree: ast.AST) -> Iterator[int]:
    """Lines of annotations that are `Any` alone."""
    for node in ast.walk(tree):
        for annotation in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if isinstance(annotation, ast.Name) and annotation.id == "Any":
                yield annotation.lineno


def count_idioms(package: Path) -> Counts:
    """Count the idioms in all modules of a package."""
    idioms = {name: Idiom(name, limit, []) for name, limit in LIMITS.items()}
    num_lines = 0
    num_bindings = 0
    for path in sorted(package.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        stripped = [line.strip() for line in source.splitlines()]
        num_lines += sum(1 for line in stripped if line and not line.startswith("#"))
        tree = ast.parse(source)
        bindings = list(list_bindings(tree))
        num_bindings += len(bindings)
        lines = {
            "vague names": [line for name, line in bindings if name.strip("_") in VAGUE_NAMES],
            "parallel assignments": list(find_parallel_assignments(tree)),
            "bundles": list(find_bundles(tree)),
            "unpacked generators": list(find_unpacked_generators(tree)),
            "touches": list(find_touches(tree)),
            "bare Any": list(find_bare_any(tree)),
        }
        for name in LIMITS:
            idioms[name].lines.extend((path, line) for line in lines[name])
    return Counts(num_lines, num_bindings, idioms)


def main() -> None:
    """Print the counts, their limits, and the files with most of each."""
    parser = argparse.ArgumentParser(description="Count idioms that make readers stop.")
    parser.add_argument("package", type=Path, nargs="?", default=PACKAGE)
    parser.add_argument("--worst", type=int, default=5, help="files to list for each idiom")
    arguments = parser.parse_args()
    counts = count_idioms(arguments.package)
    print(f"{counts.num_lines} lines, {counts.num_bindings} bindings")
    for name, idiom in counts.idioms.items():
        unit = "% of bindings" if name == "vague names" else "per 1,000 lines"
        share = counts.share(name)
        verdict = "" if share <= idiom.limit else "  OVER ITS LIMIT"
        print(f"{name:22}{len(idiom.lines):6}  {share:5.2f} {unit}, at most {idiom.limit}{verdict}")
        by_file: dict[Path, list[int]] = {}
        for path, line in idiom.lines:
            by_file.setdefault(path, []).append(line)
        worst = sorted(by_file.items(), key=lambda pair: len(pair[1]), reverse=True)
        for path, lines in worst[: arguments.worst]:
            numbers = ", ".join(map(str, lines[:8])) + (", …" if len(lines) > 8 else "")
            print(f"    {len(lines):4} {path.relative_to(arguments.package)}: {numbers}")


if __name__ == "__main__":
    main()
