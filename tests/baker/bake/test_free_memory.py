"""A bake says before it begins that it needs more memory than is free."""

import logging

import navbake
from navbake.baker.bake import memory
from navbake.baker.bake.memory import estimate_memory
from navbake.baker.bake.stages import bake_stages

FLOOR = "<mujoco><worldbody><geom type='box' size='2 2 .1'/></worldbody></mujoco>"


def test_too_little_memory_is_told(monkeypatch, caplog, tmp_path):
    scene = tmp_path / "floor.xml"
    scene.write_text(FLOOR)
    monkeypatch.setattr(memory, "measure_free_memory", lambda: 1000)
    with caplog.at_level(logging.WARNING):
        grid = navbake.bake(scene)
    text = caplog.text
    assert "needs about 0.0 GB of memory, and 0.0 GB are free" in text
    assert "1600 cells" in text and "`grid.cell_size`" in text
    assert not grid.warnings  # the grid is the same on any machine


def test_enough_memory_is_not_told(caplog, tmp_path):
    scene = tmp_path / "floor.xml"
    scene.write_text(FLOOR)
    with caplog.at_level(logging.WARNING):
        navbake.bake(scene)
    assert "memory" not in caplog.text


def test_memory_grows_with_cells_and_triangles():
    stages = bake_stages(navbake.samples.path("apartment"))
    structure = stages.scene.structure
    estimates = [
        estimate_memory(structure, stages.lattice._replace(width=width), stages.shape_margin)
        for width in (100, 200, 400)
    ]
    assert estimates[2] - estimates[1] == 2 * (estimates[1] - estimates[0]) > 0
