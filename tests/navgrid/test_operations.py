"""The functions behind the methods of grids: each is where it is named, and takes the object."""

from __future__ import annotations

import inspect

import pytest

from navbake.lazy import Method, resolve
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.methods import Operations
from navbake.voxels.grid import VoxelGrid

METHODS = [
    (kind, name, method.where)
    for kind, part in ((SceneGrid2D, Operations), (MultiLevelGrid, Operations), (VoxelGrid,) * 2)
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
