"""Geoms that go to the cells near them find what cells that ask every geom find.

Run ``NAVBAKE_EXAMPLES=300 pytest tests/baker/columns/test_scatter.py`` for more scenes.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import Generator

from navbake.baker.bake.stages import Stages, bake_stages
from navbake.baker.core.constants import MEETS, UNDECIDED
from navbake.baker.core.tiles import TILE, window_bits, window_near_box
from navbake.baker.core.tolerances import SAME_HEIGHT, TOUCH_DEPTH
from navbake.baker.geometry.extents import measure_extents
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import (
    TOP_LEVEL_HEIGHT,
    WALL_HEIGHTS,
    check_occupancy,
    select_list_entries,
)
from navbake.baker.occupancy.volume_kernels import AT_WALL_HEIGHT, BLOCKING, OCCUPYING
from navbake.baker.occupants.kinds import mark_wall_candidates
from navbake.navgrid.lattice import Lattice
from navbake.threads import limit_threads
from oracles.gather import geoms_that_meet, line_meets, prisms_over

MORE = int(os.environ.get("NAVBAKE_EXAMPLES", "0"))
FOLDER = tempfile.TemporaryDirectory()
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3, "plane": 2}


def random_stages(seed: int) -> Stages:
    """A floor with things at random: solids, finite planes, an infinite one, hulls and shells."""
    rng = np.random.default_rng(seed)
    meshes = [_mesh(f"mesh_{i}", rng) for i in range(3)]
    geoms = ['<geom type="box" size="1.5 1.2 0.1" pos="0 0 -0.1"/>']
    for _ in range(rng.integers(2, 14)):
        kind = str(rng.choice([*SIZES, "mesh"]))
        place = f'pos="{_text(rng.uniform((-1.6, -1.3, -0.3), (1.6, 1.3, 1.6)))}"'
        if rng.random() < 0.7:
            place += f' quat="{_text(rng.normal(size=4))}"'
        if kind == "mesh":
            geoms.append(f'<geom type="mesh" mesh="mesh_{rng.integers(3)}" {place}/>')
            continue
        size = rng.choice([0.02, 0.1, 0.4], 3) * rng.uniform(0.5, 2.0, 3)
        size = [*size[: SIZES[kind]], 1.0] if kind == "plane" else size[: SIZES[kind]]
        geoms.append(f'<geom type="{kind}" size="{_text(size)}" {place}/>')
    if rng.random() < 0.5:
        geoms.append('<geom type="plane" size="0 0 1" pos="-1.4 0 0" euler="0 70 0"/>')
    path = Path(FOLDER.name) / "scene.xml"
    world = f"<worldbody>{''.join(geoms)}</worldbody>"
    path.write_text(f"<mujoco><asset>{''.join(meshes)}</asset>{world}</mujoco>")
    return bake_stages(
        {
            "scene": {"path": str(path), "meshes": {"*": "hull" if seed % 2 else "surface"}},
            "grid": {"cell_size": float(rng.choice([0.1, 0.17])), "bounds": [-1.8, -1.5, 1.8, 1.5]},
            "agent": {"radius": float(rng.choice([0.0, 0.05, 0.1, 0.3]))},
            "doors": {"find": False},
            "floors": {"min_area": 0.1, "shrink": 0.0},
            "rooms": "none",
        }
    )


def _mesh(name: str, rng: Generator) -> str:
    """Triangles of all sizes in a heap, which enclose nothing; their hull does."""
    corners = rng.uniform(-0.5, 0.5, (12, 3, 3))
    corners[::2] *= rng.choice([0.02, 0.2, 1.0])
    faces = " ".join(map(str, range(36)))
    return f'<mesh name="{name}" vertex="{_text(corners.ravel())}" face="{faces}" inertia="shell"/>'


def _text(values) -> str:
    return " ".join(f"{value:.4f}" for value in values)


@settings(max_examples=MORE or 12, derandomize=not MORE, database=None, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_occupancy_as_when_every_cell_asks_every_geom(seed):
    stages = random_stages(seed)
    footprint, columns = stages.footprint, stages.columns
    for level, occupied in zip(stages.floors.levels, stages.occupancy.levels, strict=True):
        assert occupied[np.isnan(level.floor)].all()
        for cell in np.flatnonzero(~np.isnan(level.floor)).tolist():
            floor = level.floor.flat[cell]
            band = floor + footprint.low, floor + footprint.high
            prisms = prisms_over(columns, cell, *band, footprint.half_square, footprint.radius)
            answers = set(geoms_that_meet(stages.shape_source, prisms).values())
            if MEETS in answers or line_meets(columns, cell, prisms[0]):
                assert occupied.flat[cell], cell
            elif UNDECIDED not in answers:
                assert not occupied.flat[cell], cell


@settings(max_examples=MORE or 12, derandomize=not MORE, database=None, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_contents_as_when_every_cell_asks_every_geom(seed):
    stages = random_stages(seed)
    columns, contents = stages.columns, stages.standing_occupants
    footprint, height = stages.footprint, stages.config.agent.height
    half = stages.lattice.cell_size / 2 - TOUCH_DEPTH
    extents = measure_extents(stages.scene.shapes, len(stages.scene.geoms))
    candidates = mark_wall_candidates(stages.scene, extents)
    tops = [*(level.ground for level in stages.floors.levels[1:]), np.inf]
    levels = zip(stages.floors.levels, stages.occupancy.levels, tops, contents.levels, strict=True)
    for level, occupied, top, listed in levels:
        every = np.arange(len(listed.list_start))
        at, geom, flags = select_list_entries(listed.list_start, listed.geom, listed.flags, every)
        for cell in np.flatnonzero(~np.isnan(level.floor)).tolist():
            floor = level.floor.flat[cell]
            ceiling = max(min(top, floor + TOP_LEVEL_HEIGHT), floor + height) - TOUCH_DEPTH
            volumes = {
                "stands": (floor + SAME_HEIGHT + TOUCH_DEPTH, ceiling, half, 0.0),
                "blocks": (floor + footprint.low, floor + footprint.high, *footprint[:2]),
                "upper": (
                    floor + WALL_HEIGHTS[0] + TOUCH_DEPTH,
                    floor + WALL_HEIGHTS[1] - TOUCH_DEPTH,
                    half,
                    0.0,
                ),
            }
            sure, maybe = {}, {}
            for name, sizes in volumes.items():
                prisms = prisms_over(columns, cell, *sizes)
                answers = geoms_that_meet(stages.shape_source, prisms)
                geoms = range(len(candidates))
                lines = {g for g in geoms if line_meets(columns, cell, prisms[0], g)}
                sure[name] = lines | {g for g, answer in answers.items() if answer == MEETS}
                maybe[name] = lines | set(answers)
            for allowed in (sure, maybe):
                allowed["blocks"] = allowed["blocks"] if occupied.flat[cell] else set()
                walls = set(np.flatnonzero(candidates).tolist())
                allowed["upper"] = allowed["upper"] & allowed["stands"] & walls
            here = at == cell
            assert (np.diff(geom[here]) > 0).all()
            for name, flag in zip(volumes, (OCCUPYING, BLOCKING, AT_WALL_HEIGHT), strict=True):
                found = set(geom[here & (flags & flag > 0)].tolist())
                assert sure[name] <= found <= maybe[name], (cell, name)


def test_queries_in_any_order_and_more_than_one_a_cell():
    stages, rng = random_stages(5), np.random.default_rng(0)
    footprint = Footprint.for_agent(stages.config.agent, stages.lattice.cell_size)
    num = stages.lattice.width * stages.lattice.height
    cells = rng.integers(0, num, 3000)
    floors = rng.choice([-0.5, 0.0, 0.3, 1.2], 3000)
    ask = stages.columns, stages.shape_source, footprint
    together = check_occupancy(*ask, cells, floors).occupied
    assert together.any() and not together.all()
    for n in range(0, 3000, 40):
        one = check_occupancy(*ask, cells[n : n + 1], floors[n : n + 1])
        assert one.occupied[0] == together[n]
    assert not len(check_occupancy(*ask, cells[:0], floors[:0]).occupied)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core")
def test_any_number_of_threads_finds_the_same():
    answers = []
    for threads in (1, 2):
        with limit_threads(threads):
            stages = random_stages(11)
            level = stages.standing_occupants.levels[0]
            every = np.arange(len(level.list_start))
            listed = select_list_entries(level.list_start, level.geom, level.flags, every)
            answers.append([stages.occupancy.levels[0], *listed])
    for one, two in zip(*answers, strict=True):
        np.testing.assert_array_equal(one, two)


@numba.njit
def look_near(lattice, window, box, reach):
    near = window_near_box(lattice, window, box, 0, reach)
    return near, window_bits(window, near)


@settings(max_examples=MORE or 200, derandomize=not MORE, database=None, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_cells_near_a_box(seed):
    rng = np.random.default_rng(seed)
    lattice = Lattice(
        x_min=float(rng.uniform(-5, 5)), y_max=float(rng.uniform(-5, 5)),
        width=30, height=20, cell_size=float(rng.choice([0.05, 0.1, 0.3])),
    )  # fmt: skip
    row, col = rng.integers(0, 20 - TILE), rng.integers(0, 30 - TILE)
    size = lattice.cell_size
    # often exactly on centres and edges, sometimes far beside
    low = np.array([lattice.x_min, lattice.y_max - 20 * size, 0.0])
    low[:2] += rng.integers(-8, 62, 2) / 2 * size * rng.choice([1.0, 1e6], p=[0.95, 0.05])
    high = low + np.array([*rng.integers(0, 30, 2) / 2 * size, 1.0])
    reach = rng.integers(0, 4) / 2 * size
    box = np.concatenate([low, high])[None]
    window = (row, row + TILE, col, col + TILE)
    near, bits = look_near(lattice, window, box, reach)
    for r in range(row, row + TILE):
        for c in range(col, col + TILE):
            x, y = lattice.positions(r, c)
            beside = max(low[0] - x, x - high[0], low[1] - y, y - high[1]) - reach
            inside = near[0] <= r < near[1] and near[2] <= c < near[3]
            assert inside if beside < 1e-9 else not inside or beside < 0.01 * size
            assert int(bits) >> ((r - row) * TILE + c - col) & 1 == inside
