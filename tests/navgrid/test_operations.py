"""The functions behind the methods of grids: each is where it is named, and takes the object."""

from __future__ import annotations

import inspect

import pytest

import navbake
from grid_maps import level_from
from navbake.lazy import Method, resolve
from navbake.navgrid.grid import GridBase, MultiLevelGrid, SceneGrid2D
from navbake.voxels.grid import VoxelGrid

METHODS = [
    (kind, name, method.where)
    for kind, part in ((SceneGrid2D, GridBase), (MultiLevelGrid, GridBase), (VoxelGrid,) * 2)
    for name, method in vars(part).items()
    if isinstance(method, Method)
]


@pytest.mark.parametrize(("kind", "name", "where"), METHODS)
def test_a_method_is_its_function(kind, name, where):
    function, thing = resolve(where), kind.__new__(kind)
    method = getattr(thing, name)
    assert method.__func__ is getattr(kind, name) is function
    assert method.__self__ is thing
    assert function.__doc__ and inspect.signature(method).parameters is not None


def test_short_ways_to_write_draw_and_plan(tmp_path):
    level = level_from("...\n##.\n...")
    (written,) = level.to_npz(tmp_path / "a.npz")
    assert navbake.from_npz(written).shape == level.shape
    assert level.plot().size == level.plot(layers=["occupancy", "floor"]).size
    assert level.plot(tmp_path / "a.svg").read_bytes().startswith(b"<?xml")
    start, goal = (0.05, -0.05), (0.05, -0.25)
    path, known = level.find_path(start, goal), navbake.PathFinder(level).find_path(start, goal)
    assert path.length == known.length > 0.4
