"""Which cells are next to an object: ring by ring, never through a wall."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import cells_around
from oracles.ways import make_level

NAMES = {
    "T": {"objects": ["thing"]},
    "o": {"objects": ["table"]},
    "b": {"blockers": ["table"]},
    "W": {"walls": ["wall"]},
    "w": {"blockers": ["wall"]},
    "B": {"objects": ["table"], "walls": ["wall"]},
}


def beside_thing(*rows: str) -> list[str]:
    """A map with an x for each cell next to the thing, T.

    Cells: free (``.``), too near to something (``~``), solid (``#``), or with names and solid.
    """
    cells = np.array([list(row) for row in rows])
    grid = make_level(cells == ".", np.zeros(cells.shape))
    grid.attributes["occupancy"] = (cells != ".").astype(np.uint8)
    grid.attributes["solid"] = (~np.isin(cells, (".", "~"))).astype(np.uint8)
    grid.metadata["navbake"] = {"version": "0"}  # else `solid` may be anything
    grid.user_data = {n: NAMES[cell] for n, cell in enumerate(cells.flat) if cell in NAMES}
    cells.ravel()[cells_around(grid, PathFinder(grid).search.flat, "thing")] = "x"
    return ["".join(row) for row in cells.tolist()]


def test_the_nearest_ring_and_the_next():
    found = beside_thing("......", "......", "..T...", "......", "......")
    assert found == ["..x...", ".xxx..", "xxTxx.", ".xxx..", "..x..."]


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("...T#..", ".xxT#.."),
        ("T#..", "T#.."),
        # on a table: beyond it, but not beyond a wall, whatever else is in the wall's cells
        ("To..", "Toxx"),
        ("Tob..", "Tobxx"),
        ("To#..", "To#.."),
        ("ToW..", "ToW.."),
        ("ToB..", "ToB.."),
        ("Tow..W", "Tow..W"),
        # nothing stands where only the agent's radius blocks, up to 1 m away
        ("T~~..", "T~~xx"),
        ("T" + 8 * "~" + "...", "T" + 8 * "~" + "xx."),
        ("T" + 10 * "~" + "...", "T" + 10 * "~" + "..."),
    ],
)
def test_next_to_it_as_far_as_nothing_stands(row, expected):
    assert beside_thing(row) == [expected]
