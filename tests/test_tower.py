"""The sample tower is as `docs/links.md` says: its levels, links, and who gets where."""

from __future__ import annotations

import re

import numpy as np
import pytest

import navbake
from project_paths import GOLDEN, ROOT


def table_of(heading: str) -> list[list[str]]:
    """The rows of a table of the page, by the first heading of its columns."""
    text = (ROOT / "docs" / "links.md").read_text()
    head = rf"\| {heading} \|[^\n]*\n\|[-|]+\n"
    (rows,) = re.findall(head + r"((?:\|[^\n]*\n)+)", text)
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows.splitlines()]


@pytest.fixture(scope="module")
def tower():
    return navbake.load(GOLDEN / "tower.grid.json.gz")


def test_levels(tower):
    found = []
    for name, level in zip(tower.level_names, tower.levels, strict=True):
        area = np.count_nonzero(level.free) * level.cell_size**2
        covered = [tower.areas[k - 1].name for k in np.unique(level.area_index) if k]
        found.append([name, f"{level.ground:.2f}", f"{area:.1f}", ", ".join(covered)])
    assert found == table_of("level")


def test_links(tower):
    found = []
    for link in tower.links:
        levels = ", ".join(str(stop.level) for stop in link.stops)
        stops = ", ".join("{:.1f} {:.1f} {:.1f}".format(*stop.position) for stop in link.stops)
        seconds = "" if link.seconds is None else f"{link.seconds:g}"
        row = [link.name, link.kind, levels, stops, f"{link.width:g}", seconds]
        found.append([*row, ", ".join(link.agents or ["all"])])
        assert all(tower.levels[s.level].free.flat[s.cell] for s in link.stops)
    assert found == table_of("link")


@pytest.mark.parametrize("row", table_of("agent"), ids=lambda row: "-".join(row[:4:3]))
def test_ways(tower, row):
    agent, start, goal, by, expected, cost, seconds = row
    finder = navbake.PathFinder(tower, agent=agent)
    start, goal = (tuple(map(float, place.split(","))) for place in (start, goal))
    path = finder.find_path(start, goal, by=by)
    if cost:
        links = ", ".join(path.links) or "none"
        assert [links, f"{path.cost:.2f}", f"{path.seconds:.2f}"] == [expected, cost, seconds]
    else:
        assert path is None and expected in finder.why_not(start, goal)
