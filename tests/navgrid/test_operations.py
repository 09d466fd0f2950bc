"""The functions behind the methods of grids: each is where it is registered, and fits."""

from __future__ import annotations

import inspect

import pytest

import navbake
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.operations import OPERATIONS, operation
from navbake.voxels.grid import VoxelGrid

CLASSES = {"grid": SceneGrid2D, "voxels": VoxelGrid}


@pytest.mark.parametrize("name", OPERATIONS)
def test_a_registered_function_takes_what_the_method_takes(name):
    kind, _, method = name.partition(".")
    offered = inspect.signature(getattr(CLASSES[kind], method)).parameters.values()
    taken = list(inspect.signature(operation(name)).parameters.values())
    assert callable(operation(name))
    by_name = {parameter.name: parameter for parameter in taken[1:]}
    for parameter in list(offered)[1:]:  # both take the object itself first
        own = by_name.pop(parameter.name)
        assert (own.kind, own.default) == (parameter.kind, parameter.default), f"{name}: {own}"
    assert all(rest.default is not inspect.Parameter.empty for rest in by_name.values())


def test_methods_call_what_is_registered(monkeypatch):
    """No method is left without its function, and none calls another's."""
    called = []
    monkeypatch.setattr(
        navbake.navgrid.methods,
        "operation",
        lambda name: lambda *_, **__: called.append(name) or {"blockers": []},
    )
    grid = SceneGrid2D.__new__(SceneGrid2D)
    arguments = {
        "_repr_html_": (),
        "_repr_png_": (),
        "at": ((0, 0),),
        "block": (),
        "convert": ("a.npz",),
        "describe_cell": (0, 0),
        "inflate": (0.1,),
        "inflate_footprint": ((),),
        "save": ("a",),
        "tensors": (),
        "to_geojson": (),
        "to_graph": (),
        "to_mesh": (),
        "to_polygons": (),
        "values_at": ("floor", (0, 0)),
    }
    for method, given in arguments.items():
        getattr(grid, method)(*given)
    assert called == [f"grid.{method}" for method in arguments]
    assert set(called) == {name for name in OPERATIONS if name.startswith("grid.")}
    assert MultiLevelGrid.inflate is SceneGrid2D.inflate
