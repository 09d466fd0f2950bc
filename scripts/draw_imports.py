"""Draw which folder of the package imports which, in docs/pictures/imports.svg.

    python scripts/draw_imports.py          # write the picture
    python scripts/draw_imports.py --check  # exit with 1 if it is out of date

Imports inside functions and for types count. A folder stands above all that it imports; an arrow
that follows from two others is left out (the transitive reduction of the graph). The modules at the
top of the package, which all may import, are one box. What `FORWARDING` imports is left out.
"""

from __future__ import annotations

import argparse
import ast
import sys
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "navbake"
PICTURE = ROOT / "docs" / "pictures" / "imports.svg"
FORWARDING = ("navbake.navgrid.grid_methods", "navbake.routes.graph_methods")
"""Methods that call modules above their own; `tests/test_imports.py` says what they may hold."""
BASE = "errors, files, types, …"  # the modules at the top, but those that only start the package
BOX_WIDTH = 118  # of a folder's box, and so on [px]
BOX_HEIGHT = 26
GAP_X = 16
GAP_Y = 44
MARGIN = 16

Graph = dict[str, set[str]]


def folder_of(module: str) -> str:
    """The folder that a module is drawn in: ``baker/rooms`` for navbake.baker.rooms.gaps."""
    parts = module.split(".")[1:]
    if parts in ([], ["testing"]):
        return "navbake"
    if parts == ["__main__"]:
        return "cli"
    if parts[0] == "baker" and len(parts) > 2:
        return f"baker/{parts[1]}"
    if parts == ["scores"] or (PACKAGE / parts[0]).is_dir():
        return parts[0]
    return BASE


def import_graph() -> Graph:
    """Which folders each folder imports."""
    modules: dict[str, Path] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        modules[name.removesuffix(".__init__")] = path
    graph: Graph = {}
    for name, path in modules.items():
        if path.stat().st_size == 0 or name in FORWARDING:
            continue
        imported = graph.setdefault(folder_of(name), set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                targets = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                targets = [f"{node.module}.{alias.name}" for alias in node.names]
                targets = [name if name in modules else node.module for name in targets]
            else:
                continue
            imported.update(folder_of(target) for target in targets if target in modules)
        imported.discard(folder_of(name))
    return graph


def place_in_rows(graph: Graph) -> dict[str, int]:
    """The row of each folder, counted from below: one more than the highest that it imports.

    Raises:
        SystemExit: folders import each other in a circle.
    """
    rows: dict[str, int] = {}

    def row_of(folder: str, path: tuple[str, ...]) -> int:
        if folder in path:
            circle = " -> ".join([*path[path.index(folder) :], folder])
            sys.exit(f"these folders import each other: {circle}")
        if folder not in rows:
            below = [row_of(imported, (*path, folder)) for imported in graph[folder]]
            rows[folder] = max(below, default=-1) + 1
        return rows[folder]

    for folder in sorted(graph):
        row_of(folder, ())
    return rows


def without_implied(graph: Graph) -> Graph:
    """The graph without the imports that follow from two others."""

    def reachable(folder: str) -> set[str]:
        below = set(graph[folder])
        for imported in graph[folder]:
            below |= reachable(imported)
        return below

    return {
        folder: {
            imported
            for imported in folders
            if not any(imported in reachable(between) for between in folders)
        }
        for folder, folders in graph.items()
    }


def place_in_columns(graph: Graph, rows: dict[str, int]) -> dict[str, float]:
    """The x of each box's middle [px]: near the middle of what it imports, without overlaps."""
    pitch = BOX_WIDTH + GAP_X
    middles: dict[str, float] = {}
    for row in range(max(rows.values()) + 1):
        folders = sorted(folder for folder in graph if rows[folder] == row)

        def wanted(folder: str) -> float:
            below = [middles[imported] for imported in graph[folder] if imported in middles]
            return sum(below) / len(below) if below else 0.0

        folders.sort(key=lambda folder: (wanted(folder), folder))
        center = sum(map(wanted, folders)) / len(folders)
        for number, folder in enumerate(folders):
            middles[folder] = center + (number - (len(folders) - 1) / 2) * pitch
    smallest = min(middles.values())
    return {name: middle - smallest + BOX_WIDTH / 2 + MARGIN for name, middle in middles.items()}


def draw(graph: Graph) -> str:
    """The picture as SVG."""
    rows = place_in_rows(graph)
    arrows = without_implied(graph)
    middles = place_in_columns(arrows, rows)
    num_rows = max(rows.values()) + 1
    width = max(middles.values()) + BOX_WIDTH / 2 + MARGIN
    height = num_rows * (BOX_HEIGHT + GAP_Y) - GAP_Y + 2 * MARGIN

    def top_of(folder: str) -> float:
        return MARGIN + (num_rows - 1 - rows[folder]) * (BOX_HEIGHT + GAP_Y)

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        'font-family="sans-serif" font-size="12">',
        "<title>Which folder imports which: arrows point down</title>",
        '<rect width="100%" height="100%" fill="white"/>',
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 1 L7 4 L0 7 z" fill="#555"/></marker></defs>',
    ]
    for folder in sorted(arrows):
        for imported in sorted(arrows[folder]):
            lines.append(
                f'<line x1="{middles[folder]:.0f}" y1="{top_of(folder) + BOX_HEIGHT:.0f}" '
                f'x2="{middles[imported]:.0f}" y2="{top_of(imported):.0f}" '
                'stroke="#777" marker-end="url(#head)"/>'
            )
    for folder in sorted(graph):
        x = middles[folder] - BOX_WIDTH / 2
        fill = "#dcebf7" if folder.startswith("baker/") else "#f2efe4"
        lines.append(
            f'<rect x="{x:.0f}" y="{top_of(folder):.0f}" width="{BOX_WIDTH}" '
            f'height="{BOX_HEIGHT}" rx="4" fill="{fill}" stroke="#555"/>'
            f'<text x="{middles[folder]:.0f}" y="{top_of(folder) + 17:.0f}" '
            f'text-anchor="middle">{escape(folder)}</text>'
        )
    return "\n".join([*lines, "</svg>"]) + "\n"


def main() -> None:
    """Write the picture, or check that it is up to date."""
    parser = argparse.ArgumentParser(description="Draw which folder imports which.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if stale")
    picture = draw(import_graph())
    if not parser.parse_args().check:
        PICTURE.write_text(picture, encoding="utf-8")
        print(f"wrote {PICTURE}")
    elif not PICTURE.exists() or PICTURE.read_text(encoding="utf-8") != picture:
        sys.exit(f"{PICTURE} is out of date: run `python scripts/draw_imports.py`")


if __name__ == "__main__":
    main()
