"""What an editor knows of a user's script: the types that mypy reveals, none of them `Any`.

All is checked in one run of mypy: expressions whose types are known, a whole script, wrong calls.
"""

from __future__ import annotations

import inspect
import os
import re
import runpy
import subprocess
import sys

import pytest

import navbake
from project_paths import ROOT

USER_SCRIPT = ROOT / "tests" / "user_script.py"

# expression of a user's script -> what mypy reveals of it, without the names of modules
REVEALED = {
    "grid": "SceneGrid2D | MultiLevelGrid",
    'navbake.load("house.grid.json")': "SceneGrid2D | MultiLevelGrid",
    "grid.levels": "list[SceneGrid2D]",
    "grid.rooms": "tuple[Room, ...]",
    "grid.inflate(0.3)": "SceneGrid2D | MultiLevelGrid",
    'grid.with_doors("open").levels[0].inflate(0.3)': "SceneGrid2D",
    "grid.at((1.0, 2.0, 0.0))": "Place | None",
    'grid.values_at("floor", [(1.0, 2.0, 0.0)])': "ndarray[float64]",
    'grid.values_at("free", [(1.0, 2.0, 0.0)])': "ndarray[bool]",
    'grid.values_at("room", [(1.0, 2.0, 0.0)])': "ndarray[unsignedinteger]",
    "navbake.tensors.floor(grid.tensors(), path.positions)": "ndarray[float64]",
    "navbake.tensors.is_navigable(grid.tensors(), path.positions)": "ndarray[bool]",
    "navbake.tensors.patch(grid.tensors(), path.positions, 0.0)": "ndarray[bool]",
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


# a call that is wrong, after `BEGINNING` -> a word of what mypy says of it
WRONG_CALLS = {
    "navbake.bake(3)": "int",
    'navbake.bake("house.xml", cell_size=0.1)': "cell_size",
    'navbake.bake("house.xml", grid=0.1)': "float",
    'navbake.bake("house.xml", "keyframe")': "MjDataLike",
    'navbake.Baker(["house.xml"])': "list[str]",
    "navbake.load(3)": "int",
    'grid.inflate("0.3")': "str",
    "grid.inflate(0.3, clearence=0.1)": "clearence",
    "grid.at()": "position",
    'grid.values_at([(1.0, 2.0, 0.0)], "floor")': "values_at",
    "grid.with_doors(True)": "bool",
    'grid.plot(layer="rooms")': "layer",
    "grid.plot(layers=3)": "int",
    'grid.to_nav2("map.yaml", radius="0.3")': "str",
    'grid.tensors("torch")': "Module",
    "grid.levels[0].fre": "fre",
    "path.position": "position",
    "navbake.PathFinder(3)": "int",
    "finder.find_path((1.0, 2.0, 0.0))": "goal",
    "finder.random_point(5)": "Generator",
    'finder.stand_poses("object:sofa", reach=0.6)': "float",
    "finder.geodesic_distance((1.0, 2.0, 0.0))": "geodesic_distance",
    "navbake.draw(grid, path)": "draw",
    'navbake.episodes.make_episodes(grid, "point", num=4)': "num",
    "navbake.tensors.is_navigable(grid, path.positions)": "is_navigable",
    "navbake.tensors.floor(grid.tensors(), 3.0)": "float",
    "navbake.scores.Measures(grid, path)": "PathFinder",
}
LINE = re.compile(r"^(\w+)\.py:(\d+): (\w+): (.*)$", re.M)


def plain(revealed: str) -> str:
    """A type without its modules; numpy writes a shape that it doesn't know as Any."""
    text = re.sub(r"\b(?:\w+\.)+(?=\w)", "", revealed)
    array = r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)(?:\[\w+\])?\]\]"
    return re.sub(array, r"ndarray[\1]", text)


@pytest.fixture(scope="module")
def messages(tmp_path_factory) -> dict[str, dict[int, list[str]]]:
    """What mypy says in its strict mode, by script and by line."""
    pytest.importorskip("mypy")
    folder = tmp_path_factory.mktemp("user")
    scripts = {
        "revealed": BEGINNING + "".join(f"reveal_type({text})\n" for text in REVEALED),
        "wrong": BEGINNING + "".join(f"{call}\n" for call in WRONG_CALLS),
        "user_script": "# mypy: disallow-any-expr\n" + USER_SCRIPT.read_text(encoding="utf-8"),
    }
    for name, text in scripts.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    # errors in navbake itself are those of its own run of mypy
    options = ["--strict", "--follow-imports=silent", "--config-file=", "--no-pretty"]
    # a cache of its own: other options make a cache useless for the package's own run of mypy
    options.append(f"--cache-dir={ROOT / '.mypy_cache' / 'user_scripts'}")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *options, *(f"{name}.py" for name in scripts)],
        cwd=folder,
        env={**os.environ, "MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert not done.stderr, done.stderr
    by_script: dict[str, dict[int, list[str]]] = {name: {} for name in scripts}
    for script, line, kind, text in LINE.findall(done.stdout):
        by_script[script].setdefault(int(line), []).append(f"{kind}: {text}")
    return by_script


@pytest.fixture(scope="module")
def revealed(messages) -> dict[str, str]:
    """The type of each expression in `REVEALED`."""
    first = BEGINNING.count("\n") + 1
    types = {}
    for line, texts in messages["revealed"].items():
        types[list(REVEALED)[line - first]] = texts[0].split('"')[1]
    return types


@pytest.mark.skipif(sys.version_info < (3, 11), reason="numpy for Python 3.10 has other types")
@pytest.mark.timeout(900)
def test_mypy_reveals_every_type(revealed):
    assert {expression: plain(text) for expression, text in revealed.items()} == REVEALED


def test_no_type_is_any(revealed):
    for expression, text in revealed.items():
        assert not re.search(r"\bAny\b", plain(text)), f"{expression}: {text}"


@pytest.mark.timeout(900)
def test_no_expression_of_a_users_script_is_any(messages):
    lines = ["", *USER_SCRIPT.read_text(encoding="utf-8").splitlines()]
    errors = {
        lines[line - 1]: texts
        for line, texts in messages["user_script"].items()
        if any(re.search(r"\bAny\b", plain(text)) or "contains" not in text for text in texts)
    }
    assert not errors


def test_a_users_script_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(USER_SCRIPT))
    assert (tmp_path / "map.yaml").exists()
    assert (tmp_path / "apartment.png").exists()
    assert "['hall', 'kitchen']" in capsys.readouterr().out


@pytest.mark.timeout(900)
@pytest.mark.parametrize("call", WRONG_CALLS)
def test_mypy_flags_a_wrong_call(messages, call):
    line = BEGINNING.count("\n") + 1 + list(WRONG_CALLS).index(call)
    texts = messages["wrong"].get(line, [])
    errors = [text for text in texts if text.startswith("error: ")]
    assert errors
    assert WRONG_CALLS[call] in errors[0]


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
