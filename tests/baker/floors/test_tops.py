"""Houses on slabs are floors, wherever their walls end; tops of walls and counters are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navbake.baker.stages import bake_stages


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> str:
    pos = f"{(x0 + x1) / 2!r} {(y0 + y1) / 2!r} {(z0 + z1) / 2!r}"
    size = f"{(x1 - x0) / 2!r} {(y1 - y0) / 2!r} {(z1 - z0) / 2!r}"
    return f'<geom type="box" pos="{pos}" size="{size}"/>'


def house(slab: float, ends: float, wall: float, storeys: int) -> str:
    """Storeys of 6 x 5 m over a ground plane; walls end `ends` m past the slab above them."""
    geoms, z = ['<geom type="plane" size="5 5 .1"/>', box(0, 6, 0, 5, 0, slab)], slab
    for _ in range(storeys):
        top = z + 2.5 + ends
        sides = [(0, 6, 0, wall), (0, 6, 5 - wall, 5), (0, wall, 0, 5), (6 - wall, 6, 0, 5)]
        geoms += [box(*side, z, top) for side in sides]
        geoms.append(box(0, 6, 0, 5, z + 2.5, z + 2.7))
        z += 2.7
    return "".join(geoms)


@pytest.mark.parametrize("seed", range(24))
def test_house_on_its_slab_keeps_its_floors(tmp_path: Path, seed):
    generator = np.random.default_rng(seed)
    slab, ends = generator.uniform(0.02, 0.3), generator.choice([-0.002, -0.001, 0, 0.001, 0.002])
    wall, step = generator.uniform(0.02, 0.3), generator.choice([0.01, 0.05, 0.25])
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
