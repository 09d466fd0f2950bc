"""What an editor knows of a user's script: the types that mypy reveals, none of them `Any`."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys

import pytest

import navbake
from project_paths import ROOT

# expression of a user's script -> what mypy reveals of it, without the names of modules
REVEALED = {
    "grid": "SceneGrid2D | MultiLevelGrid",
    'navbake.load("house.grid.json")': "SceneGrid2D | MultiLevelGrid",
    "grid.levels": "list[SceneGrid2D]",
    "grid.rooms": "tuple[Room, ...]",
    "grid.inflate(0.3)": "SceneGrid2D | MultiLevelGrid",
    'grid.with_doors("open").levels[0].inflate(0.3)': "SceneGrid2D",
    "grid.at((1.0, 2.0, 0.0))": "Place | None",
    "grid.cell_at((1.0, 2.0, 0.0))": "tuple[int, int, int, fallback=Cell] | None",
    "grid.block(disc=((1.0, 2.0, 0.0), 0.3))": "AddedObstacle",
    "grid.tensors()": "GridTensors",
    "grid.routes()": "RouteGraph",
    'grid.routes().save("routes.geojson")': "list[Path]",
    "grid.routes().audit(grid)": "AuditReport",
    "grid.plot()": "Image",
    'grid.plot("house.svg", layers=["rooms"])': "Path",
    'grid.to_nav2("map.yaml", level=0, radius=0.3)': "list[Path]",
    "grid.to_mesh()": "FloorMesh",
    "grid.to_polygons()": "list[Shape]",
    "grid.to_graph()": "CellGraph",
    'grid.to_graph("rooms")': "RoomGraph",
    "finder": "PathFinder",
    'finder.find_path((1.0, 2.0, 0.0), "room:kitchen")': "Path | None",
    "path.positions": "ndarray[float64]",
    "path.length": "float",
    "path.rooms": "list[str]",
    "finder.snap((1.0, 2.0, 0.0))": "ndarray[float64] | None",
    "finder.snap([(1.0, 2.0, 0.0), (3.0, 2.0, 0.0)])": "ndarray[float64]",
    "finder.is_navigable((1.0, 2.0, 0.0))": "bool",
    "finder.room_at((1.0, 2.0, 0.0))": "str | None",
    "finder.room_at([(1.0, 2.0, 0.0), (3.0, 2.0, 0.0)])": "ndarray[object_]",
    "finder.clearance((1.0, 2.0, 0.0))": "float",
    "finder.clearance([(1.0, 2.0, 0.0), (3.0, 2.0, 0.0)])": "ndarray[float64]",
    "finder.random_point()": "ndarray[float64]",
    "finder.why_not((1.0, 2.0, 0.0), (3.0, 2.0, 0.0))": "str | None",
    "navbake.episodes.make_episodes(grid)": "EpisodeSet",
    'navbake.verify(grid, "house.xml")': "VerifyReport",
    "navbake.audit(grid)": "AuditReport",
    'navbake.Baker("house.xml").grid': "SceneGrid2D | MultiLevelGrid",
    'navbake.load_voxels("house.npz")': "VoxelGrid",
    'navbake.draw(viewer.user_scn, grid, layer="rooms")': "tuple[int, int, fallback=DrawCount]",
    'navbake.draw(viewer.user_scn, path, color="#1864ab")': "tuple[int, int, fallback=DrawCount]",
    'navbake.load_voxels("house.npz").distances().at((1.0, 2.0, 0.0))': "ndarray[float64]",
    "flights": "VoxelFinder",
    "flights.find_path((1.0, 2.0, 1.0), (3.0, 2.0, 1.0))": "FlightPath | None",
    "flights.is_free((1.0, 2.0, 1.0))": "bool",
    "flights.sees((1.0, 2.0, 1.0), (3.0, 2.0, 1.0))": "bool",
    "flights.snap((1.0, 2.0, 1.0))": "ndarray[float64] | None",
    "flights.snap([(1.0, 2.0, 1.0), (3.0, 2.0, 1.0)])": "ndarray[float64]",
}
BEGINNING = """\
from typing import Any

import navbake

viewer: Any  # mujoco has no types

grid = navbake.bake("house.yaml", grid={"cell_size": 0.05})
finder = navbake.PathFinder(grid)
path = finder.find_path((1.0, 2.0, 0.0), (3.0, 2.0, 0.0))
assert path is not None
flights = navbake.VoxelFinder(navbake.load_voxels("house.bt"), 0.3)
"""


def plain(revealed: str) -> str:
    """A type without its modules; numpy writes a shape that it doesn't know as Any."""
    text = re.sub(r"\b(?:\w+\.)+(?=\w)", "", revealed)
    return re.sub(r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)\]\]", r"ndarray[\1]", text)


@pytest.fixture(scope="module")
def revealed(tmp_path_factory) -> dict[str, str]:
    """The type of each expression in `REVEALED`, by mypy in its strict mode."""
    pytest.importorskip("mypy")
    script = tmp_path_factory.mktemp("user") / "script.py"
    lines = [f"reveal_type({expression})" for expression in REVEALED]
    script.write_text(BEGINNING + "\n".join(lines) + "\n", encoding="utf-8")
    # errors in navbake itself are those of its own run of mypy
    options = ["--strict", "--follow-imports=silent", "--config-file=", "--no-pretty"]
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "mypy",
            *options,
            f"--cache-dir={ROOT / '.mypy_cache'}",
            script.name,
        ],
        cwd=script.parent,
        env={**os.environ, "MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = re.findall(r'^script\.py:(\d+): note: Revealed type is "(.*)"$', done.stdout, re.M)
    first = BEGINNING.count("\n") + 1
    expressions = list(REVEALED)
    return {expressions[int(line) - first]: text for line, text in found}


@pytest.mark.timeout(900)
def test_mypy_reveals_every_type(revealed):
    assert {expression: plain(text) for expression, text in revealed.items()} == REVEALED


def test_no_type_is_any(revealed):
    for expression, text in revealed.items():
        assert not re.search(r"\bAny\b", plain(text)), f"{expression}: {text}"


CLASSES = [
    navbake.SceneGrid2D,
    navbake.MultiLevelGrid,
    navbake.PathFinder,
    navbake.VoxelGrid,
    navbake.ExploredMap,
]
METHODS = [
    (kind, name)
    for kind in CLASSES
    for name, method in inspect.getmembers(kind, inspect.isfunction)
    if not name.startswith("_")
]


@pytest.mark.parametrize(("kind", "name"), METHODS)
def test_help_shows_aliases_by_name(kind, name):
    """`ArrayLike` and others are unions of many parts, which would fill a screen."""
    signature = str(inspect.signature(getattr(kind, name)))
    assert "_SupportsArray" not in signature
    assert inspect.getdoc(getattr(kind, name))
