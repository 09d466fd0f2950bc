"""Standable surfaces, listed by threads and block by block, are those of a plain loop."""

import numpy as np
import pytest

from navbake.baker.columns import Rows
from navbake.baker.floors.kernels.sheets import mark_surfaces
from navbake.baker.floors.sheets import StandableFinder, agent_limits
from navbake.baker.kernels.constants import SLACK
from navbake.baker.stages import bake_stages
from navbake.threads import limit_threads

BOXES = 40


def scene():
    """Boxes at all heights over a floor: surfaces under others, bumps, and covered ones."""
    draw = np.random.default_rng(5)
    boxes = []
    for _ in range(BOXES):
        x, y, z = draw.uniform(-3, 3), draw.uniform(-3, 3), draw.choice([0.1, 0.4, 1.5, 3.0])
        half = draw.uniform(0.1, 0.8, 2)
        boxes.append(f'<geom type="box" size="{half[0]} {half[1]} .1" pos="{x} {y} {z}"/>')
    floor = '<geom type="box" size="3.3 3.3 .1" pos="0 0 -.1"/>'
    return f"<mujoco><worldbody>{floor}{''.join(boxes)}</worldbody></mujoco>"


def list_plainly(columns, shapes, agent):
    """The standable surfaces and the footings, column by column."""
    num, cells = len(columns.z), len(columns.start) - 1
    like, stands = np.zeros(num, bool), np.zeros(num, bool)
    count = np.zeros(cells, np.int64)
    asked = columns.lattice, columns.crossings, shapes.planes, agent_limits(agent)
    mark_surfaces(*asked, like, stands, count, 0, cells)
    surfaces, footing = [], []
    for cell in range(cells):
        first, last = columns.start[cell], columns.start[cell + 1]
        for i in range(first, last):
            z = columns.z[i]
            if stands[i]:
                is_top = columns.z[last - 1] - z <= SLACK
                surfaces.append((z, cell, len(footing), columns.geom[i], is_top))
            if like[i]:
                footing.append((z, cell))
    return surfaces, footing


@pytest.mark.parametrize("threads", [1, 3])
def test_surfaces_are_those_of_a_plain_loop(tmp_path, threads):
    path = tmp_path / "boxes.xml"
    path.write_text(scene())
    stages = bake_stages({"scene": {"path": str(path)}, "grid": {"cell_size": 0.1}})
    columns, shapes, agent = stages.columns, stages.tiled.shapes, stages.config.agent
    surfaces, footing = list_plainly(columns, shapes, agent)
    assert len(surfaces) > 4000 and len(footing) > len(surfaces)
    whole, middle = columns.known_rows, Rows(0, 32)
    for blocks in ([whole], [middle, Rows(middle.end, whole.end)]):
        finder = StandableFinder(columns.lattice, shapes, agent)
        with limit_threads(threads):
            for rows in blocks:
                finder.add(columns.only_rows(rows))
        found, listed = finder.found()
        parts = found.z, found.cell, found.surface, found.geom, found.is_top
        assert list(zip(*(part.tolist() for part in parts), strict=True)) == surfaces
        at = np.repeat(np.arange(len(listed.start) - 1), np.diff(listed.start))
        assert list(zip(listed.z.tolist(), at.tolist(), strict=True)) == footing
        cell = np.repeat(np.arange(len(found.start) - 1), np.diff(found.start))
        assert np.array_equal(cell, found.cell)
