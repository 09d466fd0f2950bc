"""The same scene, shifted, turned, by other threads, another time: the same grid.

Many of these scenes have faces exactly on cells' edges and centres, and heights exactly on limits.
Run ``NAVBAKE_EXAMPLES=1000 pytest tests/baker/bake/test_invariance.py`` for more of them.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, note, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from navbake.baker.bake.pipeline import run_bake
from navbake.config.settings import parse_config
from navbake.errors import SceneError
from navbake.navgrid.grid import SceneGrid2D

MORE = int(os.environ.get("NAVBAKE_EXAMPLES", "0"))
FOLDER = tempfile.TemporaryDirectory()


@dataclass(frozen=True)
class Scene:
    """A scene as MJCF text, and its settings."""

    geoms: str
    assets: str = ""
    bounds: tuple[float, float, float, float] | None = None
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def cell_size(self) -> float:
        return self.settings.get("grid", {}).get("cell_size", 0.1)


def bake(
    scene: Scene,
    move: tuple[float, float] = (0.0, 0.0),
    quarters: int = 0,
    threads: int | None = None,
    **agent: float,
):
    """Bake a scene that is turned by quarters and then moved."""
    quat = {0: "1 0 0 0", 1: "1 0 0 1", 2: "0 0 0 1", 3: "1 0 0 -1"}[quarters]
    path = Path(FOLDER.name) / "scene.xml"
    path.write_text(
        f"<mujoco><asset>{scene.assets}</asset><worldbody>"
        f'<body pos="{move[0]!r} {move[1]!r} 0" quat="{quat}">{scene.geoms}</body>'
        f"</worldbody></mujoco>"
    )
    config = {"scene": {"path": str(path), "geoms": "all"}, **scene.settings}
    config["grid"] = dict(config.get("grid", {}))
    config["agent"] = {**config.get("agent", {}), **agent}
    if scene.bounds is not None:
        x, y = np.array(scene.bounds[::2]), np.array(scene.bounds[1::2])
        for _ in range(quarters):
            x, y = -y, x
        config["grid"]["bounds"] = [
            x.min() + move[0], y.min() + move[1], x.max() + move[0], y.max() + move[1]
        ]  # fmt: skip
        config["grid"]["bounds"] = [float(b) for b in config["grid"]["bounds"]]
    return run_bake(parse_config(config), threads=threads).grid


def turned(array: NDArray, quarters: int) -> NDArray:
    return np.rot90(array, quarters)  # rows run against y, so this is counter-clockwise too


def turned_ids(ids: NDArray, level: SceneGrid2D, quarters: int) -> NDArray:
    """Where cells are after turning a level's grid by quarters."""
    old = np.arange(level.width * level.height).reshape(level.shape)
    new = np.empty(old.size, dtype=np.int64)
    new[turned(old, quarters).ravel()] = np.arange(old.size)
    return new[ids]


def check_same(first, second, move=(0.0, 0.0), quarters: int = 0) -> None:
    """Assert that a second grid is the first one, turned and moved."""
    assert len(first.levels) == len(second.levels)
    for a, b in zip(first.levels, second.levels, strict=True):
        assert b.ground == pytest.approx(a.ground, abs=1e-9)
        names = ["occupancy", "weights"]
        names += ["room_index"] if quarters == 0 else []  # rooms are numbered row by row
        for name in names:
            expected = turned(getattr(a, name), quarters)
            np.testing.assert_array_equal(getattr(b, name), expected, err_msg=name)
        np.testing.assert_allclose(
            b.floor_height, turned(a.floor_height, quarters), atol=1e-6, rtol=2e-7
        )
        x0, y0, x1, y1 = a.lattice.bounds
        x, y = np.array([x0, x1]), np.array([y0, y1])
        for _ in range(quarters):
            x, y = -y, x
        corners = np.array([x.min(), y.min(), x.max(), y.max()])
        corners += np.array([*move, *move])
        np.testing.assert_allclose(b.lattice.bounds, corners, atol=1e-9)
    links = first.step_array.copy()
    for k, level in enumerate(first.levels):
        for side in (0, 2):
            here = first.step_array[:, side] == k
            links[here, side + 1] = turned_ids(links[here, side + 1], level, quarters)
    assert sorted(map(tuple, links)) == sorted(map(tuple, second.step_array))


def saved(grid) -> bytes:
    """The file's bytes without its timings."""
    path = Path(FOLDER.name) / "saved.grid.json"
    grid.save(path)
    data, count = re.subn(rb'"timings":\{[^{}]*\}', b"", path.read_bytes())
    assert count >= 1
    return data


# ---------------------------------------------------------------- scenes


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> str:
    middle = f"{(x0 + x1) / 2!r} {(y0 + y1) / 2!r} {(z0 + z1) / 2!r}"
    half = f"{(x1 - x0) / 2!r} {(y1 - y0) / 2!r} {(z1 - z0) / 2!r}"
    return f'<geom type="box" pos="{middle}" size="{half}"/>'


FLOOR = box(-1.5, 1.5, -1.0, 1.0, -0.1, 0.0)

TIES = Scene(
    FLOOR
    + box(-0.5, 0.0, -0.3, 0.2, 0.0, 1.0)  # faces on cells' edges
    + box(0.55, 0.85, -0.45, 0.15, 0.0, 1.0)  # on cells' centres
    + box(-1.2, -0.8, 0.4, 0.8, 0.25, 0.6)  # begins where the band begins
    + box(0.2, 0.6, 0.5, 0.9, 1.14, 1.5)  # and where it ends
    + box(0.9, 1.2, 0.4, 0.7, 0.0, 0.25)  # a step just as high as can be taken
    + '<geom type="cylinder" pos="-1.05 -0.55 0.5" size="0.15 0.5"/>'
    + '<geom type="sphere" pos="0.25 -0.65 0.5" size="0.25"/>',
    settings={"floors": {"min_area": 0.3, "shrink": 0.2}},
)

SEAMS = Scene(
    box(-1.5, 0.05, -1.0, 0.05, -0.1, 0.0)
    + box(0.05, 1.5, -1.0, 0.05, -0.1, 0.0)
    + box(-1.5, 0.05, 0.05, 1.0, -0.1, 0.2)
    + box(0.05, 1.5, 0.05, 1.0, -0.1, 0.2)
)

# a lower room; a stair of ten treads beside it, 0.2 m each; an upper floor that it leads to
HOUSE = Scene(
    box(-2.0, 2.0, -2.0, 2.0, -0.1, 0.0)
    + "".join(
        box(1.1, 1.9, -1.41 + 0.25 * k, -1.16 + 0.25 * k, 0, 0.2 * k + 0.2) for k in range(10)
    )
    + box(-2.0, 1.1, -2.0, 2.0, 1.9, 2.0)
    + box(1.1, 1.9, 1.1, 2.0, 1.9, 2.0)
    + box(-0.6, -0.2, 0.3, 0.9, 2.0, 2.9)
    + box(-1.0, -0.55, -1.0, -0.55, 0.0, 1.9)
)

HILLS = [0.0, 0.2, 0.1, 0.3, 0.1, 0.4, 0.6, 0.2, 0.3, 0.9, 0.7, 0.2, 0.0, 0.3, 0.5, 1.0]
ALL_TYPES = Scene(
    '<geom type="hfield" hfield="h" pos="-1.5 0 0.01"/>'
    '<geom type="plane" size="0 0 1"/>'
    '<geom type="plane" size="0.6 0.5 1" pos="1.9 0.3 0.11" quat="1 0.05 0.1 0.2"/>'
    '<geom type="sphere" size="0.3" pos="0.41 0.7 0.5"/>'
    '<geom type="capsule" size="0.1 0.4" pos="0.6 -0.6 0.4" quat="1 0.3 0.4 0"/>'
    '<geom type="ellipsoid" size="0.5 0.2 0.3" pos="1.4 -0.9 0.6" quat="1 0.2 0 0.5"/>'
    '<geom type="cylinder" size="0.2 0.5" pos="2.1 -0.4 0.5" quat="1 0 0.4 0.1"/>'
    '<geom type="box" size="0.3 0.1 0.6" pos="1.2 1.0 0.55" quat="1 0.1 0.1 0.4"/>'
    '<geom type="mesh" mesh="m" pos="0.2 -1.0 0.3" quat="1 0.3 0 0.2"/>'
    '<geom type="mesh" mesh="m" pos="2.4 0.9 0.3" contype="0" conaffinity="0"/>',
    f'<hfield name="h" nrow="4" ncol="4" size="0.8 0.9 0.6 0.1" '
    f'elevation="{" ".join(map(str, HILLS))}"/>'
    '<mesh name="m" vertex="0 0 0 0.5 0 0 0 0.6 0 0 0 0.7" face="0 2 1 0 1 3 1 2 3 2 0 3"/>',
    bounds=(-2.453, -1.552, 3.047, 1.548),
    settings={"grid": {"cell_size": 0.1}, "agent": {"radius": 0.17}},
)

SCENES = {"ties": TIES, "seams": SEAMS, "house": HOUSE, "all types": ALL_TYPES}


# ---------------------------------------------------------------- tests


@pytest.mark.parametrize("radius", [0.0, 0.05, 0.15, 0.25])
@pytest.mark.parametrize("name", SCENES)
def test_shifted_and_turned(name: str, radius: float) -> None:
    scene = SCENES[name]
    grid = bake(scene, radius=radius)
    assert any(level.free.any() for level in grid.levels)
    ways = [(7, -13, 0), (12345, 678, 0), (0, 0, 1), (0, 0, 2), (-3, 41, 3)]
    # lines in two faces belong to what lies east and north, however a scene is turned
    for cols, rows, quarters in ways[:2] if name == "seams" else ways:
        move = cols * scene.cell_size, rows * scene.cell_size
        check_same(grid, bake(scene, move, quarters, radius=radius), move, quarters)


def test_house_has_levels_and_links() -> None:
    grid = bake(HOUSE)
    assert len(grid.levels) == 2
    assert len(grid.steps) >= 4


@pytest.mark.parametrize("name", SCENES)
def test_threads_and_runs_give_the_same_bytes(name: str) -> None:
    first = saved(bake(SCENES[name], threads=1))
    assert first == saved(bake(SCENES[name], threads=2))
    assert first == saved(bake(SCENES[name], threads=2))


def test_another_process_gives_the_same_bytes() -> None:
    here = hashlib.sha256(saved(bake(HOUSE, threads=1))).hexdigest()
    code = (
        f"import sys, hashlib; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import test_invariance as t\n"
        "print(hashlib.sha256(t.saved(t.bake(t.HOUSE, threads=2))).hexdigest())"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "7"}
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    )
    assert run.stdout.strip() == here


def free_places(grid) -> set[tuple[float, float, float]]:
    """Where an agent can stand: x, y and height, to the millimetre."""
    places = set()
    for level in grid.levels:
        for row, col in np.argwhere(level.free):
            x, y = level.lattice.positions(row, col)
            z = float(level.floor_height[row, col])
            places.add((round(float(x), 3), round(float(y), 3), round(z, 3)))
    return places


@pytest.mark.parametrize("name", SCENES)
def test_a_larger_radius_never_frees_a_cell(name: str) -> None:
    before = free_places(bake(SCENES[name], radius=0.0))
    assert before
    for radius in (0.049, 0.05, 0.051, 0.07, 0.0708, 0.1, 0.15, 0.2, 0.33, 0.5, 1.0):
        after = free_places(bake(SCENES[name], radius=radius))
        assert after <= before, f"radius {radius} frees {sorted(after - before)[:3]}"
        before = after


@st.composite
def snapped(draw: st.DrawFn) -> Scene:
    """Boxes with all faces on multiples of half a cell, heights on multiples of 0.05 m."""
    cell = draw(st.sampled_from([0.1, 0.07, 0.15, 0.2]))
    num = draw(st.integers(8, 20))
    geoms = [box(-num * cell / 2, num * cell / 2, -5 * cell, 5 * cell, -0.2, 0.0)]
    for _ in range(draw(st.integers(1, 8))):
        x, y = draw(st.integers(-num, num)), draw(st.integers(-10, 10))
        dx, dy = draw(st.integers(1, 12)), draw(st.integers(1, 12))
        z = draw(st.sampled_from([-0.2, 0.0, 0.0, 0.0, 0.25, 0.5, 1.0, 1.15, 1.2]))
        dz = draw(st.sampled_from([0.05, 0.1, 0.15, 0.25, 0.5, 1.0]))
        kind = draw(st.sampled_from(["box", "box", "box", "cylinder"]))
        if kind == "box":
            sides = x * cell / 2, (x + dx) * cell / 2, y * cell / 2, (y + dy) * cell / 2
            geoms.append(box(*sides, z, z + dz))
        else:
            place = f"{x * cell / 2!r} {y * cell / 2!r} {z + dz / 2!r}"
            size = f"{dx * cell / 4!r} {dz / 2!r}"
            geoms.append(f'<geom type="cylinder" pos="{place}" size="{size}"/>')
    settings_ = {
        "grid": {"cell_size": cell},
        "agent": {
            "height": draw(st.sampled_from([1.15, 1.0, 0.9, 0.6])),
            "radius": draw(st.sampled_from([0.0, 0.5, 1.0, 1.5, 2.0])) * cell,
            "traversable_floor_height": draw(st.sampled_from([0.25, 0.1, 0.0])),
        },
        "floors": {"min_area": 20.3 * cell**2, "shrink": draw(st.sampled_from([0.0, 0.7])) * cell},
    }
    return Scene("".join(geoms), settings=settings_)


EXAMPLES = settings(
    max_examples=MORE or 60,
    derandomize=not MORE,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)


@EXAMPLES
@given(snapped(), st.integers(-99, 99), st.integers(-99, 99), st.integers(0, 3))
def test_snapped_scenes_shifted_and_turned(
    scene: Scene, cols: int, rows: int, quarters: int
) -> None:
    note(scene.geoms)
    try:
        grid = bake(scene, threads=1)
    except SceneError:
        assume(False)
    move = cols * scene.cell_size, rows * scene.cell_size
    check_same(grid, bake(scene, move, quarters), move, quarters)


@EXAMPLES
@given(snapped(), st.lists(st.integers(0, 60), min_size=2, max_size=2).map(sorted))
def test_a_larger_radius_never_frees_a_cell_of_snapped_scenes(
    scene: Scene, hundredths: list[int]
) -> None:
    note(scene.geoms)
    try:
        small, large = (bake(scene, radius=n / 100) for n in hundredths)
    except SceneError:
        assume(False)
    freed = free_places(large) - free_places(small)
    assert not freed, sorted(freed)[:3]
