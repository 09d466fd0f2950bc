"""The lattice over a scene, whatever its numbers went through."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from navbake.baker.bake.lattice import box_rounding, extend_lattice, fit_lattice
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import parse_config

INCH = 0.0254


class Box:
    """A scene as far as its lattice goes: lower and upper corner [m]."""

    def __init__(self, *corners):
        self.bounds = np.array(corners, dtype=np.float64)
        self.exact_meshes = {0: None}  # a mesh file


def count(low, high, cell, **grid):
    config = parse_config({"scene": {"path": "a.xml"}, "grid": {"cell_size": cell, **grid}}, "x")
    lattice = fit_lattice(Box([*low, 0.0], [*high, 1.0]), config)
    return lattice.width, lattice.height


WAYS = {
    "exact": lambda v: v,
    "metres": lambda v: float(np.float32(v)),
    "inches": lambda v: float(np.float32(v / INCH)) * INCH,
    "inches in float32": lambda v: float(np.float32(np.float32(v / INCH) * np.float32(INCH))),
    "feet": lambda v: float(np.float32(v / 0.3048)) * 0.3048,
}


@pytest.mark.parametrize("way", WAYS)
@given(
    st.tuples(*[st.integers(1, 400)] * 2),
    st.sampled_from([0.05, 0.08, 0.1, 0.13]),
    st.tuples(*[st.sampled_from([0.0, -3.21, 123.4, 10_000.0, -9_876.5])] * 2),
)
def test_a_box_of_whole_cells_has_these_in_any_numbers(way, cells, cell, low):
    high = [v + n * cell for v, n in zip(low, cells, strict=True)]
    stored = ([WAYS[way](v) for v in corner] for corner in (low, high))
    assert count(*stored, cell) == cells


def test_what_is_more_than_rounding_opens_a_cell():
    assert count((0, 0), (10.00002, 10.0), 0.1) == (101, 100)
    assert count((10_000, 0), (10_010.02, 10.0), 0.1) == (101, 100)
    # bounds that are stated are exact
    assert count((0, 0), (1, 1), 0.1, bounds=[0, 0, 10.000002, 10.0]) == (101, 100)


def test_a_window_goes_on_by_whole_cells():
    box = Box([1e4, 0, 0], [float(np.float32(1e4 + 3.3)) + 1e-3, 2.0, 1])
    config = parse_config(
        {"scene": {"path": "a.xml"}, "grid": {"bounds": [1e4 + 1, 0.5, 1e4 + 2, 1.5]}}, "x"
    )
    rounding = box_rounding(box, box.bounds[:, :2].ravel(), 0.1)
    whole, _ = extend_lattice(fit_lattice(box, config), box.bounds, 10**6, rounding)
    assert whole.shape == (20, 33)


@pytest.mark.parametrize("cells", [(41, 29), (37, 23), (53, 31), (17, 44)])
def test_a_mesh_in_inches_far_away_has_the_cells_of_its_size(tmp_path, cells):
    mesh = trimesh.creation.box((*(0.1 * np.array(cells)), 0.2))
    mesh.apply_translation([1000.3, -1000.7, 0.0])
    mesh.apply_scale(1 / INCH)
    mesh.export(tmp_path / "a.stl")  # in float32
    settings = {"scene": {"path": str(tmp_path / "a.stl"), "up": "z", "unit": INCH}}
    config = parse_config(settings, "x")
    lattice = fit_lattice(load_scene(config), config)
    assert (lattice.width, lattice.height) == cells
