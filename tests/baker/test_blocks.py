"""Blocks of rows: however large they are, a bake gives the same bytes."""

import numpy as np
import pytest

from navbake.baker import columns as columns_module
from navbake.baker.clock import StageClock
from navbake.baker.columns import Rows, split_rows
from navbake.baker.cracks import find_columns, find_columns_of_rows
from navbake.baker.stages import take_first_look
from navbake.config.settings import parse_config

# slabs with cracks between them along both axes and at an angle, and a post in one
SLAB = '<geom type="box" size=".4 .4 .1" pos="{} {} {}" euler="0 0 {}"/>'
CRACKED = "".join(
    SLAB.format(0.81 * i + 0.005 * (j % 3), 0.82 * j, 0.02 * (i % 3), 2 * ((i + j) % 4))
    for i in range(4)
    for j in range(5)
)
CRACKED += '<geom type="cylinder" size=".05 .5" pos="1.2 1.2 .5"/>'
CRACKED += '<geom type="plane" size="0 0 1" pos="0 0 -1"/>'


def stages_of(tmp_path, geoms, cell_size):
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    return take_first_look(
        parse_config({"scene": {"path": str(path)}, "grid": {"cell_size": cell_size}}), StageClock()
    )


@pytest.mark.parametrize("cell_size", [0.05, 0.02, 0.013])
def test_columns_of_rows_are_those_of_the_whole(tmp_path, monkeypatch, cell_size):
    """Cracks are closed in the same way, also where they cross the blocks' borders."""
    stages = stages_of(tmp_path, CRACKED, cell_size)
    tiled, agent, lattice = stages.tiled, stages.config.agent, stages.lattice
    whole = find_columns(tiled, agent, 0.03)
    plain = columns_module.cast_columns(tiled)
    assert len(split_rows(lattice)) == 1
    assert len(plain.z) != len(whole.z) or (plain.z != whole.z).any()
    for rows in (8, 16, 40):
        monkeypatch.setattr(columns_module, "BLOCK_CELLS", rows * lattice.width)
        assert len(split_rows(lattice)) == -(-lattice.height // rows)
        blocks = find_columns(tiled, agent, 0.03)
        for one, other in zip(blocks.crossings, whole.crossings, strict=True):
            np.testing.assert_array_equal(one, other)
    rng = np.random.default_rng(0)
    for first, end in np.sort(rng.integers(0, lattice.height + 1, (5, 2))).tolist():
        (part, _), expected = find_columns_of_rows(tiled, agent, 0.03, Rows(first, end)), whole
        a, b = first * lattice.width, end * lattice.width
        np.testing.assert_array_equal(
            part.start[a : b + 1], expected.start[a : b + 1] - expected.start[a]
        )
        inside = slice(int(expected.start[a]), int(expected.start[b]))
        for one, other in zip(part.crossings[1:], expected.crossings[1:], strict=True):
            np.testing.assert_array_equal(one, other[inside])
