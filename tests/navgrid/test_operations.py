"""The methods of grids that call functions of other modules: each takes what its function takes."""

from __future__ import annotations

import ast
import inspect

import pytest

import navbake
from grid_maps import level_from
from navbake.lazy import resolve
from navbake.navgrid import grid_methods
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.grid_methods import GridMethods
from navbake.voxels.grid import VoxelGrid

# method -> the function whose parameters it has, after the grid
FUNCTIONS = {
    "cell_at": "navgrid.cells:cell_at",
    "cells_at": "navgrid.cells:cells_at",
    "position_of": "navgrid.cells:position_of",
    "at": "navgrid.cells:place_at",
    "values_at": "navgrid.cells:values_at",
    "describe_cell": "views.describe:describe_cell",
    "with_doors": "navgrid.door_states:with_doors",
    "with_links": "navgrid.door_states:with_links",
    "inflate": "runtime.inflation:inflate",
    "inflate_footprint": "runtime.inflation:inflate_footprint",
    "block": "runtime.blocking:block",
    "routes": "routes.build:make_routes",
    "tensors": "tensors.build:make_tensors",
    "without_obstacles": "navgrid.unblocking:without_obstacles",
    "_with_current_islands": "navgrid.islands:with_current_islands",
    "save": "formats.navgrid:write_navgrid",
    "convert": "formats.convert:write_as",
    "to_npz": "formats.npz:encode_grid_npz",
    "to_mjcf": "formats.extrude:encode_mjcf",
    "to_mesh": "formats.floor_mesh:make_floor_mesh",
    "to_polygons": "formats.shapes:find_shapes",
    "to_geojson": "formats.shapes:to_geojson",
    "to_graph": "formats.graphs:make_graph",
    "_repr_html_": "views.notebook:render_html",
    "_repr_png_": "views.notebook:draw_png",
}
NEVER_FAILING = {"without_obstacles"}
# these have parameters of several functions, or use another method
ALONE = {"plot", "to_nav2", "to_procthor", "blockers", "find_path"}

METHODS = {name: method for name, method in vars(GridMethods).items() if inspect.isfunction(method)}


def parameters_of(function, *, first: int) -> list[tuple[str, object, object]]:
    """Name, kind and default of each parameter but the first ones."""
    parameters = list(inspect.signature(function).parameters.values())[first:]
    return [(each.name, each.kind, each.default) for each in parameters]


def test_each_method_has_its_function():
    assert METHODS.keys() - {"_as_grid"} == FUNCTIONS.keys() | ALONE


@pytest.mark.parametrize(("name", "place"), FUNCTIONS.items())
def test_a_method_takes_what_its_function_takes(name, place):
    function = resolve(f"navbake.{place}")
    assert parameters_of(METHODS[name], first=1) == parameters_of(function, first=1)


def test_a_plot_takes_what_pictures_take():
    taken = parameters_of(GridMethods.plot, first=1)
    # of a picture without a file, the form is no choice
    expected = []
    for parameter in parameters_of(resolve("navbake.views.plot:render_picture"), first=2):
        name, kind, default = parameter
        if name == "overlays":
            expected += [(field, kind, value) for field, value in default._asdict().items()]
        else:
            expected.append(parameter)
    assert taken[1:] == expected
    (level,) = parameters_of(resolve("navbake.formats.procthor:encode_procthor"), first=2)
    names = ("radius", "stairs", "agent")  # of all maps
    expected = [level, *((name, *level[1:]) for name in names)]
    assert parameters_of(GridMethods.to_procthor, first=2) == expected


def test_a_map_of_nav2_takes_what_its_writer_takes_and_which_cells_it_closes():
    *writer_parameters, closed_cell_masks = parameters_of(
        resolve("navbake.formats.nav2:encode_nav2"), first=2
    )
    assert closed_cell_masks[0] == "closed_cell_masks"
    expected = [
        *writer_parameters,
        *((name, *closed_cell_masks[1:]) for name in ("stairs", "agent")),
    ]
    assert parameters_of(GridMethods.to_nav2, first=2) == expected


def test_a_path_is_found_with_the_arguments_of_path_finder():
    parameters = parameters_of(GridMethods.find_path, first=1)
    expected = parameters_of(navbake.PathFinder.find_path, first=1)
    (agent,) = (each for each in parameters_of(navbake.PathFinder, first=1) if each[0] == "agent")
    assert parameters == [*expected, agent]


def test_voxels_are_saved_with_the_options_of_their_formats():
    function = resolve("navbake.formats.voxels:write_voxels")
    assert parameters_of(VoxelGrid.save, first=1) == parameters_of(function, first=1)


@pytest.mark.parametrize("kind", [SceneGrid2D, MultiLevelGrid, VoxelGrid])
@pytest.mark.parametrize("name", ["save", "at"])
def test_help_shows_a_method_with_its_arguments(kind, name):
    method = getattr(kind, name)
    assert method.__name__ == name
    assert str(inspect.signature(method)).startswith("(self, ")
    assert "Args:" in inspect.getdoc(method)


@pytest.mark.parametrize("name", sorted(METHODS.keys() - {"_as_grid", "_repr_html_", "_repr_png_"}))
def test_a_method_documents_all_arguments_and_its_value(name):
    method = METHODS[name]
    text = inspect.getdoc(method)
    for parameter in list(inspect.signature(method).parameters)[1:]:
        assert f"{parameter}: " in text, parameter
    assert "Returns:" in text or method.__annotations__["return"] == "None"
    assert ("Raises:" in text) == (name not in NEVER_FAILING)


def test_a_method_calls_the_function_that_it_is_named_with():
    tree = ast.parse(inspect.getsource(grid_methods))
    calls = {
        method.name: {
            f"{node.module}:{imported.name}".removeprefix("navbake.")
            for node in ast.walk(method)
            if isinstance(node, ast.ImportFrom)
            for imported in node.names
        }
        for method in ast.walk(tree)
        if isinstance(method, ast.FunctionDef) and any(map(is_import, ast.walk(method)))
    }
    by_format = {name: {"formats.convert:write_as"} for name in calls if name.startswith("to_")}
    shapes = {name: {FUNCTIONS[name]} for name in FUNCTIONS if name in calls}
    expected = {**by_format, **shapes, "plot": {"views.plot:Overlays", "views.plot:plot"}}
    expected["find_path"] = {"runtime.path_finder:PathFinder"}
    for name in ("to_nav2", "to_npz", "to_mjcf", "to_procthor"):
        expected[name] = {"formats.convert:write_as"}
    assert calls == expected


def is_import(node: ast.AST) -> bool:
    return isinstance(node, ast.ImportFrom)


def test_short_ways_to_write_draw_and_plan(tmp_path):
    level = level_from("...\n##.\n...")
    (written,) = level.to_npz(tmp_path / "a.npz")
    assert navbake.from_npz(written).shape == level.shape
    assert level.plot().size == level.plot(layers=["occupancy", "floor"]).size
    assert level.plot(tmp_path / "a.svg").read_bytes().startswith(b"<?xml")
    start, goal = (0.05, -0.05), (0.05, -0.25)
    path, known = level.find_path(start, goal), navbake.PathFinder(level).find_path(start, goal)
    assert path.length == known.length > 0.4
