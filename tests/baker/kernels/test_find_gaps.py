"""Gaps between floors, as `find_gaps` finds them, and as a plain loop over all cells does.

Run ``NAVBAKE_EXAMPLES=3000 pytest tests/baker/kernels/test_find_gaps.py`` for more scenes.
"""

from __future__ import annotations

import os
import tracemalloc
from typing import NamedTuple

import numpy as np
import pytest

from navbake.baker.columns import Columns
from navbake.baker.cracks import count_gaps, crack_cells, list_gaps, only_near
from navbake.baker.kernels.arrays import AgentLimits, Crossings
from navbake.baker.kernels.constants import OPEN_SURFACE, SAME, SOLID
from navbake.navgrid.lattice import Lattice

MORE = int(os.environ.get("NAVBAKE_EXAMPLES", "0"))
# no difference of two heights, which are multiples of 1 cm, is near a limit
LIMITS = AgentLimits(min_up=0.7, headroom=1.045, step=0.255)
LATTICE = Lattice(x_min=0.0, y_max=0.0, width=8, height=6, cell_size=0.1)


class Face(NamedTuple):
    """A surface that a cell's line crosses."""

    z: float
    up: float  # the normal's z

    @property
    def is_even(self) -> bool:
        return self.up >= LIMITS.min_up

    @property
    def slope(self) -> float:
        return (1 - self.up**2) ** 0.5 / self.up


class Cell(NamedTuple):
    """What is in a cell: faces, from below, and the solids between them, from low to high."""

    faces: list[Face]
    solids: list[tuple[float, float]]

    def is_blocked(self, low: float, high: float) -> bool:
        inside = any(bottom < high and top > low for bottom, top in self.solids)
        return inside or any(low < face.z < high for face in self.faces)

    def goes_on(self, low: float, high: float) -> bool:
        return any(face.is_even and low <= face.z <= high for face in self.faces)

    def stood_on(self) -> list[Face]:
        room = LIMITS.headroom
        return [f for f in self.faces if f.is_even and not self.is_blocked(f.z + SAME, f.z + room)]


def random_cell(rng: np.random.Generator, floor: float) -> Cell:
    """One or two storeys, of slabs and sheets; no two faces are at one height."""
    faces, solids = [], []
    for storey in (floor, floor + 1.5):
        top = round(storey + 0.05 * int(rng.choice([0, 0, 0, 3, -3, 5])), 2)
        up = float(rng.choice([1.0, 1.0, 1.0, 0.9, 0.75, -1.0, 0.3]))
        kind = rng.choice(["slab", "sheet", "none"], p=[0.5, 0.15, 0.35])
        if kind == "slab":
            faces += [Face(round(top - 0.12, 2), -1.0), Face(top, abs(up))]
            solids.append((round(top - 0.12, 2), top))
        elif kind == "sheet":
            faces.append(Face(top, up))
        if rng.random() < 0.08:  # something hangs over it
            bottom = round(top + rng.choice([0.21, 0.41, 0.98]), 2)
            faces += [Face(bottom, -1.0), Face(round(bottom + 0.11, 2), 1.0)]
            solids.append((bottom, round(bottom + 0.11, 2)))
    return Cell(sorted(faces), solids)


def random_cells(seed: int) -> dict[tuple[int, int], Cell]:
    rng = np.random.default_rng(seed)
    places = np.ndindex(LATTICE.shape)
    tilt = float(rng.choice([0.0, 0.0, 0.07]))
    return {(row, col): random_cell(rng, round(tilt * col, 2)) for row, col in places}


def as_columns(cells: dict[tuple[int, int], Cell]) -> Columns:
    faces = [face for cell in cells.values() for face in cell.faces]
    solid = {(n, z) for n, cell in enumerate(cells.values()) for ends in cell.solids for z in ends}
    closed = [
        SOLID if (n, face.z) in solid else OPEN_SURFACE
        for n, cell in enumerate(cells.values())
        for face in cell.faces
    ]
    normal = np.array([((1 - face.up**2) ** 0.5, 0.0, face.up) for face in faces])
    counts = [len(cell.faces) for cell in cells.values()]
    crossings = Crossings(
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        np.array([face.z for face in faces]),
        normal.astype(np.float32),
        np.zeros(len(faces), dtype=np.int32),
        np.array(closed, dtype=np.uint8),
    )
    return Columns(LATTICE, crossings)


def lower_side(cells, place, way, distance, face):
    """The far side of the gap at a place, seen from a face so many cells along a way, or None."""
    (row, col), z, here = place, face.z, cells[place]
    if here.goes_on(z - LIMITS.step, z + LIMITS.step):
        return None
    for back in (1, 2):
        other = cells.get((row - back * way[0], col - back * way[1]))
        for floor in other.stood_on() if other else []:
            away = (distance + back) * LATTICE.cell_size
            least = z - LIMITS.step - away * max(face.slope, floor.slope)
            if not least <= floor.z <= z + SAME:
                continue
            if here.goes_on(floor.z - LIMITS.step, z + LIMITS.step):
                return None
            is_barred = here.is_blocked(z + LIMITS.step, floor.z + LIMITS.headroom)
            return None if is_barred else floor.z
    return None


def plain_gaps(cells) -> set[tuple[int, float, float]]:
    """The gaps up to two cells from their sides: cell id, and heights of both sides."""
    ways = [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c]
    found = set()
    for row, col in cells:
        for down, across in ways:
            for distance in (1, 2):
                side = cells.get((row + distance * down, col + distance * across))
                for face in side.stood_on() if side else []:
                    low = lower_side(cells, (row, col), (down, across), distance, face)
                    if low is not None:
                        found.add((row * LATTICE.width + col, low, face.z))
    return found


@pytest.mark.parametrize("seed", range(MORE or 60))
def test_gaps_as_a_plain_loop_finds_them(seed):
    cells = random_cells(seed)
    gaps = list_gaps(as_columns(cells), LIMITS, crack=0.15)
    found = set(zip(gaps.cell.tolist(), gaps.low.tolist(), gaps.high.tolist(), strict=True))
    expected = plain_gaps(cells)
    assert found <= expected
    # of several with one upper side, one is enough
    assert {(cell, high) for cell, _, high in found} == {(cell, high) for cell, _, high in expected}
    assert expected
    assert (np.diff(gaps.cell) >= 0).all()


@pytest.mark.parametrize("seed", range(MORE or 60))
def test_gaps_of_some_cells_are_counted_by_what_is_near(seed):
    columns, num = as_columns(random_cells(seed)), LATTICE.width * LATTICE.height
    for crack in (0.05, 0.15):
        expected = np.bincount(list_gaps(columns, LIMITS, crack).cell, minlength=num)
        cells = np.flatnonzero(np.random.default_rng(seed).random(num) < 0.1)
        near = only_near(columns, cells, crack_cells(crack, LATTICE))
        np.testing.assert_array_equal(count_gaps(near, cells, LIMITS, crack), expected[cells])


def test_what_is_near_takes_memory_for_cells_and_not_for_windows():
    lattice = Lattice(x_min=0.0, y_max=2.0, width=200, height=200, cell_size=0.01)
    num = lattice.width * lattice.height
    one = np.arange(num + 1), np.zeros(num), np.zeros((num, 3), np.float32)
    crossings = Crossings(*one, np.arange(num, dtype=np.int32), np.zeros(num, np.uint8))
    cells = np.arange(0, num, 37)
    tracemalloc.start()
    near = only_near(Columns(lattice, crossings), cells[:20], 30)
    only_near(Columns(lattice, crossings), cells, 30)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    row, col = np.divmod(cells[:20], 200)
    rows, cols = (abs(np.arange(200) - place[:, None]) <= 30 for place in (row, col))
    expected = (rows[:, :, None] & cols[:, None, :]).any(axis=0)
    np.testing.assert_array_equal(np.diff(near.start).reshape(200, 200), expected)
    np.testing.assert_array_equal(near.geom, np.flatnonzero(expected))
    assert most < 10e6  # windows for each cell take 67 MB
