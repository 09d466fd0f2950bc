"""Houses on slabs are floors, wherever their walls end; tops of walls and counters are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navbake.baker.bake.pipeline import run_bake
from navbake.baker.bake.stages import bake_stages
from navbake.baker.floors.levels import Floors
from navbake.config.settings import parse_config


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> str:
    pos = f"{(x0 + x1) / 2!r} {(y0 + y1) / 2!r} {(z0 + z1) / 2!r}"
    size = f"{(x1 - x0) / 2!r} {(y1 - y0) / 2!r} {(z1 - z0) / 2!r}"
    return f'<geom type="box" pos="{pos}" size="{size}"/>'


def house(slab: float, ends: float, wall: float, storeys: int) -> str:
    """Storeys of 6 x 5 m over a ground plane; walls end `ends` m past the slab above them."""
    geoms = ['<geom type="plane" size="5 5 .1"/>', box(0, 6, 0, 5, 0, slab)]
    z = slab
    for _ in range(storeys):
        top = z + 2.5 + ends
        sides = [(0, 6, 0, wall), (0, 6, 5 - wall, 5), (0, wall, 0, 5), (6 - wall, 6, 0, 5)]
        geoms += [box(*side, z, top) for side in sides]
        geoms.append(box(0, 6, 0, 5, z + 2.5, z + 2.7))
        z += 2.7
    return "".join(geoms)


def find_floors_of(folder: Path, geoms: list[str], **settings: object) -> Floors:
    path = folder / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>")
    return bake_stages({"scene": {"path": str(path)}, **settings}).floors


@pytest.mark.parametrize("seed", range(24))
def test_house_on_its_slab_keeps_its_floors(tmp_path: Path, seed):
    generator = np.random.default_rng(seed)
    slab = generator.uniform(0.02, 0.3)
    ends = generator.choice([-0.002, -0.001, 0, 0.001, 0.002])
    wall = generator.uniform(0.02, 0.3)
    step = generator.choice([0.01, 0.05, 0.25])
    path = tmp_path / "house.xml"
    geoms = house(float(slab), float(ends), float(wall), 2)
    path.write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    agent = {"traversable_floor_height": float(step)}
    config = {"scene": {"path": str(path)}, "agent": agent, "grid": {"margin": 1.0}}
    stages = bake_stages(config)
    heights = np.stack([level.floor for level in stages.floors.levels])
    row, col = stages.lattice.rows_cols([[3.0, 2.5]])
    inside = heights[:, row[0] - 15 : row[0] + 16, col[0] - 15 : col[0] + 16]
    for floor in (slab, slab + 2.7):
        assert (abs(inside - floor) < 1e-6).any(axis=0).all()


GARDEN = [box(-12, 12, 4, 10, -2, 0), box(-12, 12, -10, -4, -2, 0)]  # 24 m wide, and between
SIDES = [box(-12, -6, -4, 4, -2, 0), box(6, 12, -4, 4, -2, 0)]
# What is the ground, and how large it is [m²]
GROUNDS = {
    "garden with a pool": ([*GARDEN, *SIDES, box(-6, 6, -4, 4, -2, -1.5)], 384),
    "garden in a courtyard": (
        [*GARDEN, *SIDES, box(-6, 6, -4, 4, -2, -1.5), box(-12, -11.8, -10, 10, 0, 3),
         box(11.8, 12, -10, 10, 0, 3), box(-12, 12, 9.8, 10, 0, 3), box(-12, 12, -10, -9.8, 0, 3)],
        375,
    ),
    "ditch": (
        [box(-9, 9, 1, 5, -1, 0), box(-9, 9, -5, -1, -1, 0), box(-9, 9, -1, 1, -1, -0.9)], 144,
    ),
    "terraces": ([box(-9, 9, 0, 12, -1, 0), box(-9, 9, -6, 0, -1.1, -1)], 216),
    "dock": ([box(-9, 9, 0, 10, 0, 1), box(-9, 9, -5, 0, -0.1, 0)], 180),
    "platform": (
        [box(-15, 15, -6, 6, -0.2, 0), box(-15, 15, -3, 3, 0, 1), box(-15, 15, 6, 6.2, 0, 4),
         box(-15, 15, -6.2, -6, 0, 4), box(-15, 15, -6.2, 6.2, 4, 4.2)],
        180,
    ),
    "stage": (
        [box(-8, 8, -8, 8, -0.2, 0), box(-8, 8, -3, 8, 0, 0.8), box(-8, 8, 8, 8.2, 0, 4),
         box(-8.2, -8, -8, 8, 0, 4), box(8, 8.2, -8, 8, 0, 4), box(-8, 8, -8, 8, 4, 4.2)],
        176,
    ),
}  # fmt: skip


@pytest.mark.parametrize("margin", [0.0, 1.0])
@pytest.mark.parametrize("name", GROUNDS)
def test_the_ground_is_no_top(tmp_path: Path, name, margin):
    """The largest floor is kept, whatever lies lower: pools, ditches, track beds, yards."""
    geoms, area = GROUNDS[name]
    floors = find_floors_of(tmp_path, geoms, grid={"margin": margin})
    assert not [top for top in floors.tops if top.area > 0.9 * area]
    heights = np.stack([level.floor for level in floors.levels])
    upper = max(np.isclose(heights, z).sum() for z in (0.0, 0.8, 1.0))
    assert upper * 0.01 == pytest.approx(area, rel=0.03)


@pytest.mark.parametrize(
    ("name", "geoms"),
    [
        ("bed in a small room", [box(0, 2, 0, 3, -0.2, 0), box(0, 2, 0, 1.6, 0, 0.6)]),
        ("block", [box(-6, 6, -6, 6, -0.2, 0), box(-3, 3, -3, 3, 0, 2)]),
        (
            "corridors through a block",
            [box(0, 24, 0, 24, -0.2, 0), box(0, 24, 0, 1, 0, 2), box(0, 1, 0, 24, 0, 2),
             box(23, 24, 0, 24, 0, 2), box(0, 24, 23, 24, 0, 2),
             *(box(0 if k % 2 else 2.5, 21.5 if k % 2 else 24, y, y + 4, 0, 2)
               for k, y in enumerate((2.5, 8, 13.5, 19)))],
        ),
    ],
)  # fmt: skip
def test_what_stands_on_a_floor_has_a_top(tmp_path: Path, name, geoms):
    floors = find_floors_of(tmp_path, geoms)
    assert [level.ground for level in floors.levels] == [0.0]
    assert len(floors.tops) == 1 and floors.tops[0].position[2] > 0.5


def test_large_top_is_told_of_with_a_place_that_keeps_it(tmp_path: Path):
    path = tmp_path / "scene.xml"
    geoms = box(-6, 6, -6, 6, -0.2, 0) + box(-3, 3, -3, 3, 0, 2)
    path.write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    config = {"scene": {"path": str(path)}}
    [warning] = run_bake(parse_config(config)).warnings
    assert "higher than a step over the floor beside it" in warning and "36.0 m²" in warning
    place = [float(word) for word in warning.split("[[")[1].split("]]")[0].split(",")]
    grid = run_bake(parse_config({**config, "floors": {"from": [place]}})).grid
    assert [level.ground for level in grid.levels] == [0.0]
    assert (grid.levels[0].floor_height == 2.0).sum() == 3600
