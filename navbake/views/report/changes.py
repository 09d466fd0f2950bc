"""The sheet of a report that shows what differs between two grids."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from navbake.navgrid.colors import rgb_of
from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.report.cells import thinning
from navbake.views.report.difference import (
    ALIKE,
    CHANGES,
    LevelDifference,
    compare_levels,
    list_doors,
    list_rooms,
    list_settings,
    match_levels,
)
from navbake.views.report.packing import pack
from navbake.views.report.pictures import to_png
from navbake.views.report.tables import table

# as many as CHANGES and ALIKE; told apart by hue and by lightness, whatever colours one sees
COLORS = (
    "#009e73",
    "#d55e00",
    "#0072b2",
    "#cc79a7",
    "#e69f00",
    "#6f5f4f",
    "#56b4e9",
    "#f7f3e8",
    "#9aa2b1",
    "#d9dde3",
)


def describe_changes(first: NavGrid, second: NavGrid, names: Sequence[str]) -> Json:
    """The sheet of two grids' difference, as `content.describe_grid` has one of a grid."""
    levels = [
        compare_levels(first.levels[i], second.levels[j], (i, j))
        for i, j in match_levels(first, second)
    ]
    columns = ("what", *names)
    changed = sum(sum(level.counts().values()) for level in levels)
    cells = [
        (
            first.level_names[level.first],
            second.level_names[level.second],
            *(level.counts().get(name, 0) for name in CHANGES),
        )
        for level in levels
    ]
    tables = [
        table("Cells that changed", (*names, *CHANGES), cells, numbers=range(2, 2 + len(CHANGES))),
        table("Levels that only one has", columns, _unmatched(first, second, levels)),
        *(
            table(title, columns, [(row["what"], row["first"], row["second"]) for row in rows])
            for title, rows in (
                ("Rooms that changed", list_rooms(first, second, levels)),
                ("Doors that changed", list_doors(first, second)),
                ("Settings that changed", list_settings(first, second)),
            )
        ),
    ]
    return {
        "name": "difference",
        "facts": [
            ("first", names[0]),
            ("second", names[1]),
            ("cells that changed", f"{changed:,}"),
            *(("free area", _areas(first, second)) for _ in levels[:1]),
        ],
        "warnings": _warnings(first, second),
        "levels": [_show_level(first, second, level) for level in levels],
        "tables": [made for made in tables if made["rows"]],
    }


def _show_level(first: NavGrid, second: NavGrid, level: LevelDifference) -> Json:
    lattice = level.lattice
    every = max(thinning(first.levels[level.first]), thinning(second.levels[level.second]))
    change = level.change[::every, ::every]
    colors = np.array([rgb_of(color) for color in COLORS], dtype=np.uint8)
    legend = [
        (name, color)
        for number, (name, color) in enumerate(zip(CHANGES + ALIKE, COLORS, strict=True))
        if (change == number).any()
    ]
    ours, theirs = first.level_names[level.first], second.level_names[level.second]
    return {
        "name": ours if ours == theirs else f"{ours} / {theirs}",
        "width": lattice.width,
        "height": lattice.height,
        "cellSize": lattice.cell_size,
        "xMin": lattice.x_min,
        "yMax": lattice.y_max,
        "every": every,
        "of": [[0, level.first], [1, level.second]],
        "change": pack(change.astype(np.int64)),
        "kinds": CHANGES + ALIKE,
        "layers": [
            {
                "name": "changes",
                "title": "",
                "png": to_png(colors[change]),
                "legend": legend,
                "scale": None,
                "labels": [],
                "doors": [],
            }
        ],
        "marks": [],
    }


def _unmatched(
    first: NavGrid, second: NavGrid, levels: Sequence[LevelDifference]
) -> list[tuple[str, str, str]]:
    ours, theirs = {level.first for level in levels}, {level.second for level in levels}
    rows = [
        ("only in the first", name, "") for i, name in enumerate(first.level_names) if i not in ours
    ]
    rows += [
        ("only in the second", "", name)
        for i, name in enumerate(second.level_names)
        if i not in theirs
    ]
    return rows


def _areas(first: NavGrid, second: NavGrid) -> str:
    ours, theirs = (
        sum(float(np.count_nonzero(each.free)) * each.lattice.cell_size**2 for each in grid.levels)
        for grid in (first, second)
    )
    return f"{ours:.2f} to {theirs:.2f} m² ({theirs - ours:+.2f})"


def _warnings(first: NavGrid, second: NavGrid) -> list[str]:
    lines = []
    if first.scene_id != second.scene_id:
        lines.append(f"the scenes differ: {first.scene_id!r} and {second.scene_id!r}")
    ours, theirs = (grid.levels[0].lattice.cell_size for grid in (first, second))
    if abs(ours - theirs) > 1e-9:
        lines.append(
            f"cells of {ours:g} m are compared with the cells of {theirs:g} m "
            "in which their centres lie"
        )
    return lines
