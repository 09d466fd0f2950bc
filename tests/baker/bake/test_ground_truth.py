"""Bakes of scenes made at random against exact geometry that shares nothing with navbake.

Run ``NAVBAKE_EXAMPLES=3000 pytest tests/baker/bake/test_ground_truth.py`` for more, other scenes.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, event, example, given, note, settings
from hypothesis import strategies as st
from numpy.random import Generator
from numpy.typing import NDArray

from navbake.baker.bake.lattice import fit_lattice
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.columns import column_sources
from navbake.baker.floors import ridges
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import parse_config
from navbake.errors import SceneError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from oracles.prisms import OCCUPIED, UNKNOWN
from oracles.scene import Thing, part_of, scene_xml
from oracles.solids import rotation
from oracles.surfaces import Surface
from oracles.truth import Rules, Truth, UnsureError

MORE = int(os.environ.get("NAVBAKE_EXAMPLES", "0"))
FOLDER = tempfile.TemporaryDirectory()


def examples(number: int) -> settings:
    """A fixed set of examples, or as many random ones as the environment asks for."""
    return settings(
        max_examples=MORE or number,
        derandomize=not MORE,
        database=None,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    )


@pytest.fixture(scope="module", autouse=True)
def surfaces_alone() -> Iterator[None]:
    """Floors are judged surface by surface: rules of ground and of ridges have tests of their own.

    See test_rough_ground.py and test_ridges.py; these scenes are as small as a ridge is wide.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(column_sources, "replace_rough_ground_normals", lambda columns, *_: columns)
        patch.setattr(ridges, "RIDGE_WIDTH", 0.0)
        yield


# ---------------------------------------------------------------- scenes
# Strategies are made once: Hypothesis looks through each new one before it draws from it.


@cache
def millimetres(low: float, high: float) -> st.SearchStrategy[float]:
    return st.integers(round(low * 1000), round(high * 1000)).map(lambda n: n / 1000)


SOLIDS = ("sphere", "capsule", "cylinder", "box")
yaws = st.integers(-314, 314).map(lambda n: n / 100)
tilts = st.one_of(st.just(0.0), st.just(0.0), st.integers(1, 314).map(lambda n: n / 100))


@cache
@st.composite
def quats(draw: st.DrawFn) -> tuple[float, float, float, float]:
    """A turn round z, and half of the time a tilt round some level axis before that."""
    yaw, tilt, axis = draw(yaws), draw(tilts), draw(yaws)
    a, b = np.cos(yaw / 2), np.sin(yaw / 2)
    c, d = np.cos(tilt / 2), np.sin(tilt / 2)
    u, v = np.cos(axis), np.sin(axis)
    return (a * c, d * (a * u - b * v), d * (a * v + b * u), b * c)


@cache
@st.composite
def places(draw: st.DrawFn, half: float, low: float = -0.4, high: float = 1.8):
    x, y = draw(millimetres(-half, half)), draw(millimetres(-half, half))
    return x, y, draw(millimetres(low, high))


@cache
@st.composite
def solids(draw: st.DrawFn, half: float, kinds: tuple[str, ...]) -> Thing:
    kind = draw(st.sampled_from(kinds))
    size = tuple(draw(millimetres(0.01, 0.7)) for _ in range(3))
    if kind == "sphere":
        size = size[:1]
    elif kind in ("cylinder", "capsule"):
        size = size[:2]
    x, y, z = draw(places(half))
    quat = draw(quats())
    if draw(st.booleans()):  # stands on the ground
        z = size[{"box": 2, "ellipsoid": 2, "cylinder": 1}.get(kind, 0)]
        z += size[1] if kind == "capsule" else 0.0
    return Thing(kind, size, (x, y, z), quat)


@cache
@st.composite
def floors(draw: st.DrawFn, half: float) -> list[Thing]:
    """An infinite plane, level or sloping; a floor box, of whole extent or part; or two."""
    choice = draw(st.integers(0, 5))
    if choice == 0:
        return [Thing("plane", (), (0.0, 0.0, draw(millimetres(-0.3, 0.3))))]
    if choice == 1:
        tilt, yaw = draw(st.integers(0, 50)) / 100, draw(yaws)
        quat = (np.cos(tilt / 2), np.sin(tilt / 2) * np.cos(yaw), np.sin(tilt / 2) * np.sin(yaw), 0)
        return [Thing("plane", (), (0.0, 0.0, 0.0), tuple(map(float, quat)))]
    if choice == 2:
        size = draw(millimetres(half / 2, half)), draw(millimetres(half / 2, half)), 0.1
        yaw = draw(yaws)
        quat = float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))
        return [Thing("box", size, (0.0, 0.0, -0.1), quat)]
    if choice == 3:  # two floors with a step between them
        rise = draw(millimetres(-0.4, 0.4))
        edge = draw(millimetres(-half / 2, half / 2))
        far = 3 * half
        return [
            Thing("box", (far, far, 0.1), (edge - far, 0.0, -0.1)),
            Thing("box", (far, far, 0.1), (edge + far, 0.0, rise - 0.1)),
        ]
    return [Thing("plane", (), (0.0, 0.0, 0.0))]


@st.composite
def stacked(draw: st.DrawFn, things: list[Thing]) -> list[Thing]:
    """Put some of the upright things onto the one before, exactly."""
    out: list[Thing] = []
    for thing in things:
        upright = thing.quat[1] == thing.quat[2] == 0 and thing.kind in ("box", "cylinder")
        if out and upright and draw(st.integers(0, 3)) == 0:
            below = out[-1]
            flat = below.quat[1] == below.quat[2] == 0 and below.kind in ("box", "cylinder")
            if flat:
                z = below.pos[2] + below.size[-1] + thing.size[-1]
                x, y = below.pos[0] + thing.pos[0] / 4, below.pos[1] + thing.pos[1] / 4
                thing = Thing(thing.kind, thing.size, (x, y, z), thing.quat)
        out.append(thing)
    return out


@cache
@st.composite
def rules(draw: st.DrawFn) -> Rules:
    cell = draw(st.sampled_from([0.05, 0.07, 0.1, 0.13, 0.2, 0.3]))
    num = draw(st.integers(10, 36))
    half = num * cell / 2
    # the lattice lies askew to all that is drawn in millimetres
    dx, dy = 0.000271828, -0.000314159
    sides = (-half + dx, -half * draw(st.sampled_from([1.0, 0.6])) + dy, half + dx, half + dy)
    area = draw(st.sampled_from([1.0, 0.25]))
    step = draw(st.sampled_from([0.0, 0.1, 0.25, 0.25, 0.4]))
    return Rules(
        cell_size=cell,
        bounds=sides,
        height=step + draw(millimetres(0.1, 1.8)),
        radius=draw(st.one_of(st.just(0.05), millimetres(0.0, 0.4))),
        step=step,
        max_slope=draw(st.sampled_from([45.0, 30.0, 60.0])),
        min_area=min(area, (2 * half) ** 2 / 8),
        shrink=draw(st.sampled_from([0.3, 0.1])) * min(1.0, half),
    )


# ---------------------------------------------------------------- meshes

BOX_FACES = ((0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4))
BOX_FACES += ((1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7))


def prism_mesh(outline: list[tuple[float, float]], parts: list[tuple[int, ...]], height: float):
    """An upright prism over an outline, counter-clockwise, cut into triangles `parts`."""
    num = len(outline)
    vertices = [(x, y, z) for z in (0.0, height) for x, y in outline]
    faces = [(c, b, a) for a, b, c in parts] + [(a + num, b + num, c + num) for a, b, c in parts]
    for i in range(num):
        j = (i + 1) % num
        faces += [(i, j, j + num), (i, j + num, i + num)]
    return tuple(vertices), tuple(faces)


@cache
@st.composite
def shells(draw: st.DrawFn) -> tuple[tuple, tuple]:
    """A closed mesh: an L, a wedge or a skewed box."""
    a, b, c = (draw(millimetres(0.05, 1.2)) for _ in range(3))
    shape = draw(st.sampled_from(["L", "wedge", "box"]))
    if shape == "L":
        d, e = a * draw(st.sampled_from([0.3, 0.55])), b * draw(st.sampled_from([0.2, 0.7]))
        outline = [(0, 0), (a, 0), (a, e), (d, e), (d, b), (0, b)]
        return prism_mesh(outline, [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)], c)
    if shape == "wedge":
        return prism_mesh([(0, 0), (a, 0), (draw(millimetres(-0.5, 0.5)), b)], [(0, 1, 2)], c)
    skew = draw(millimetres(-0.5, 0.5))
    low = [(0, 0, 0), (a, 0, 0), (a, b, 0), (0, b, 0)]
    return (*low, *((x + skew, y - skew / 2, c) for x, y, _ in low)), BOX_FACES


@cache
@st.composite
def sheets(draw: st.DrawFn) -> tuple[tuple, tuple]:
    """An open mesh: a patch of hilly ground, front up, down, or (standing) sideways."""
    rows, cols = draw(st.integers(2, 4)), draw(st.integers(2, 4))
    dx, dy = draw(millimetres(0.1, 1.0)), draw(millimetres(0.1, 1.0))
    hill = draw(st.sampled_from([0.0, 0.05, 0.5]))
    vertices = [
        (c * dx, r * dy, hill * draw(st.integers(-99, 99)) / 99)
        for r in range(rows)
        for c in range(cols)
    ]
    faces = []
    for r in range(rows - 1):
        for c in range(cols - 1):
            i = r * cols + c
            faces += [(i, i + 1, i + cols + 1), (i, i + cols + 1, i + cols)]
    if draw(st.integers(0, 3)) == 0:
        faces = [(c, b, a) for a, b, c in faces]
    return tuple(vertices), tuple(faces)


@cache
@st.composite
def meshes(draw: st.DrawFn, half: float) -> Thing:
    x, y, z = draw(places(half, -0.3, 1.4))
    z += 0.000141421  # a closed surface that stands on another exactly is no matter of geometry
    quat = draw(quats())
    kind = draw(st.sampled_from(["hull", "cloud", "closed", "open"]))
    if kind == "cloud":
        points = st.tuples(*[millimetres(-0.6, 0.6)] * 3)
        vertices = tuple(draw(st.lists(points, min_size=5, max_size=9, unique=True)))
        assume(np.linalg.svd(np.array(vertices) - vertices[0])[1][-1] > 0.05)
        return Thing("hull", (), (x, y, z), quat, vertices)
    vertices, faces = draw(sheets() if kind == "open" else shells())
    return Thing(kind, (), (x, y, z), quat, vertices, faces)


# ---------------------------------------------------------------- comparing


def bake(things: list[Thing], rules: Rules, levels: object = "auto", **floors: float):
    path = Path(FOLDER.name) / "scene.xml"
    path.write_text(scene_xml(things))
    config = {
        "scene": {"path": str(path), "geoms": "all"},
        "agent": {
            "height": rules.height,
            "radius": rules.radius,
            "traversable_floor_height": rules.step,
            "max_slope": rules.max_slope,
        },
        "grid": {"cell_size": rules.cell_size, "bounds": list(rules.bounds)},
        "levels": levels,
        "floors": {
            **{"min_area": rules.min_area, "shrink": rules.shrink, "tops": True, "roofs": True},
            **floors,
        },
    }
    return run_bake(parse_config(config)).grid


def over_all(things: list[Thing], rules: Rules) -> Rules:
    """The same rules with bounds that hold all things, by whole cells more to each side."""
    reach = max(
        max(map(abs, thing.pos[:2]))
        + (
            max(math.hypot(*vertex) for vertex in thing.vertices)
            if thing.vertices
            else sum(thing.size)
        )
        for thing in things
    )
    low_x, low_y, high_x, high_y = rules.bounds
    inside = min(-low_x, -low_y, high_x, high_y)
    more = max(0, math.ceil((reach - inside) / rules.cell_size)) * rules.cell_size
    return replace(rules, bounds=(low_x - more, low_y - more, high_x + more, high_y + more))


def on_lattice(level: SceneGrid2D, truth: Truth) -> tuple[NDArray, NDArray, NDArray]:
    """Floor, occupancy and weights of a level by cell id of the whole lattice."""
    rows, cols = truth.shape
    lattice = level.lattice
    col0 = round((lattice.center_x()[0] - truth.x[0]) / truth.rules.cell_size)
    row0 = round((truth.y[0] - lattice.center_y()[0]) / truth.rules.cell_size)
    assert abs(lattice.center_x()[0] - truth.x[col0]) < 1e-9
    assert abs(lattice.center_y()[0] - truth.y[row0 * cols]) < 1e-9
    window = slice(row0, row0 + level.height), slice(col0, col0 + level.width)
    floor = np.full((rows, cols), np.nan)
    occupancy = np.ones((rows, cols), dtype=np.uint8)
    weights = np.full((rows, cols), np.inf)
    floor[window], occupancy[window] = level.floor_height, level.occupancy
    weights[window] = level.weights
    return floor.ravel(), occupancy.ravel(), weights.ravel()


def check(
    things: list[Thing], rules: Rules, levels: object = "auto", *, snapped: bool = False
) -> None:
    """Bake a scene and compare every cell of every level with the truth.

    All of the scene is baked: what is a floor is decided on the whole, see `test_window.py`.
    """
    rules = over_all(things, rules)
    note(scene_xml(things))
    note(repr(rules))
    try:
        truth = Truth(things, rules, snapped)
    except UnsureError:
        assume(False)
    if not truth.counted.any():
        with pytest.raises(SceneError, match="no floor"):
            bake(things, rules, levels)
        return
    try:
        compare(truth, bake(things, rules, levels), levels)
    except AssertionError:
        # the truth knows no cracks, see `test_cracks.py`: without them all cells are as it says
        compare(truth, bake(things, rules, levels, crack=0.0), levels)
        event("lines are moved out of a crack")


def compare(truth: Truth, grid: SceneGrid2D | MultiLevelGrid, levels: object) -> None:
    """Compare every cell of every level with the truth."""
    grounds = [level.ground for level in grid.levels]
    if isinstance(levels, list):
        grounds = sorted({*(level["ground"] for level in levels), *grounds})
    try:
        standing = truth.place(grounds, 0.02) if isinstance(levels, list) else truth.place(grounds)
        expected = [truth.grow(standing, k) for k in range(len(standing))]
    except UnsureError:
        assume(False)
    if isinstance(levels, list):
        used = [k for k, floor in enumerate(standing) if not np.isnan(floor).all()]
        expected = [expected[k] for k in used]
    assert len(expected) == len(grid.levels)
    unknown = total = 0
    for level, floor in zip(grid.levels, expected, strict=True):
        if len(grid.levels) == 1:
            assert level.shape == truth.shape
        found, occupancy, weights = on_lattice(level, truth)
        tolerance = 1e-6 + 1e-7 * np.abs(floor)
        wrong = (np.isnan(found) != np.isnan(floor)) | (np.abs(found - floor) > tolerance)
        assert not wrong.any(), describe(truth, wrong, floor, found)
        cells = np.flatnonzero(~np.isnan(floor))
        state = np.full(len(floor), OCCUPIED)
        state[cells] = truth.occupied(cells, floor[cells])
        wrong = (state != UNKNOWN) & ((state == OCCUPIED) != (occupancy == 1))
        assert not wrong.any(), describe(truth, wrong, state == OCCUPIED, occupancy)
        np.testing.assert_array_equal(weights, np.where(occupancy == 0, 1.0, np.inf))
        unknown += int((state == UNKNOWN).sum())
        total += len(cells)
    assert unknown <= max(2, 0.01 * total), f"{unknown} of {total} cells were not compared"


def describe(truth: Truth, wrong: NDArray, expected: NDArray, found: NDArray) -> str:
    cells = np.flatnonzero(wrong)[:5]
    lines = [
        f"row {c // truth.shape[1]}, col {c % truth.shape[1]}, x {truth.x[c]:.7f}, "
        f"y {truth.y[c]:.7f}: expected {expected[c]}, got {found[c]}"
        for c in cells
    ]
    return f"{wrong.sum()} of {len(wrong)} cells differ\n" + "\n".join(lines)


# ---------------------------------------------------------------- tests


@st.composite
def scenes(draw: st.DrawFn, *kinds: str, mesh: bool = False) -> tuple[list[Thing], Rules]:
    settings_ = draw(rules())
    half = (settings_.bounds[2] - settings_.bounds[0]) / 2
    each = solids(half, kinds)
    things = draw(st.lists(each | meshes(half) if mesh else each, min_size=1, max_size=8))
    return draw(floors(half)) + draw(stacked(things)), settings_


def beside_a_crack() -> tuple[list[Thing], Rules]:
    """A box, and beside it a wedge with a ridge: the line of a cell between is moved."""
    wedge = prism_mesh([(0, 0), (0.61, 0), (-0.041, 0.271)], [(0, 1, 2)], 0.05)
    turn = 0.25255272993125893, 0.06690211350314866, -0.943414797861247, -0.2042296378822208
    upright = 0.8309406791001636, 0.0, 0.0, -0.5563610229127838
    things = [
        Thing("plane", (), (0.0, 0.0, 0.0)),
        Thing("box", (0.217, 0.103, 0.256), (0.0, 0.122, 0.145), upright),
        Thing("hull", (), (0.152, -0.279, 0.241141421), turn, *wedge),
    ]
    sides = -0.299728172, -0.300314159, 0.300271828, 0.299685841
    return things, Rules(0.05, sides, 0.5, 0.05, 0.4, 45.0, 0.045, 0.09)


@examples(120)
@given(scenes("box", "cylinder", "sphere"))
def test_boxes_cylinders_spheres(scene: tuple[list[Thing], Rules]) -> None:
    check(*scene)


@examples(60)
@given(scenes("capsule", "ellipsoid", "box"))
def test_capsules_ellipsoids(scene: tuple[list[Thing], Rules]) -> None:
    check(*scene)


@examples(80)
@given(scenes("box", "cylinder", mesh=True))
@example(beside_a_crack())
def test_meshes(scene: tuple[list[Thing], Rules]) -> None:
    check(*scene)


@examples(40)
@given(scenes("box", "cylinder"), millimetres(-0.5, 0.5), millimetres(0.3, 1.5))
def test_given_levels(scene: tuple[list[Thing], Rules], ground: float, upper: float) -> None:
    levels = [{"ground": -9.0}, {"ground": ground}, {"ground": ground + upper}]
    with suppress_no_floor():
        check(*scene, levels=levels)


@contextmanager
def suppress_no_floor() -> Iterator[None]:
    """A given level without a floor is an error, and so no grid to compare."""
    try:
        yield
    except SceneError as error:
        if "no floor on level" not in str(error):
            raise


@st.composite
def snapped_scenes(draw: st.DrawFn) -> tuple[list[Thing], Rules]:
    """Faces on multiples of half a cell, heights on multiples of 0.05 m, limits to match."""
    cell = draw(st.sampled_from([0.1, 0.07, 0.15, 0.2, 0.25]))
    num = draw(st.integers(8, 20))
    things = [Thing("box", (num * cell / 2, 5 * cell, 0.1), (0.0, 0.0, -0.1))]
    for _ in range(draw(st.integers(1, 8))):
        x, y = draw(st.integers(-num, num)), draw(st.integers(-10, 10))
        dx, dy = draw(st.integers(1, 12)), draw(st.integers(1, 12))
        z = draw(st.sampled_from([-0.2, 0.0, 0.0, 0.0, 0.25, 0.5, 1.0, 1.15, 1.2]))
        dz = draw(st.sampled_from([0.05, 0.1, 0.15, 0.25, 0.5, 1.0]))
        if draw(st.integers(0, 3)) == 0:
            size: tuple[float, ...] = dx * cell / 4, dz / 2
            things.append(Thing("cylinder", size, (x * cell / 2, y * cell / 2, z + dz / 2)))
        else:
            size = dx * cell / 4, dy * cell / 4, dz / 2
            place = (x + dx / 2) * cell / 2, (y + dy / 2) * cell / 2, z + dz / 2
            things.append(Thing("box", size, place))
    return things, Rules(
        cell_size=cell,
        bounds=(-num * cell / 2, -5 * cell, num * cell / 2, 5 * cell),
        height=draw(st.sampled_from([1.15, 1.0, 0.9, 0.6])),
        radius=draw(st.sampled_from([0.0, 0.5, 1.0, 1.5, 2.0])) * cell,
        step=draw(st.sampled_from([0.25, 0.1, 0.0])),
        min_area=20.3 * cell**2,
        shrink=draw(st.sampled_from([0.0, 0.7])) * cell,
    )


@examples(80)
@given(snapped_scenes())
def test_faces_on_edges_and_centres_of_cells(scene: tuple[list[Thing], Rules]) -> None:
    check(*scene, snapped=True)


@examples(60)
@given(st.lists(solids(2.0, (*SOLIDS, "ellipsoid")) | meshes(2.0), min_size=1, max_size=6))
def test_lattice_is_centred_on_the_scene(things: list[Thing]) -> None:
    """As many whole cells as cover its box; infinite planes don't count."""
    parts = [part_of(thing) for thing in things]
    corners = [
        [part.support(way[None])[0] for way in (*np.eye(3)[:2], *-np.eye(3)[:2])]
        if not isinstance(part, Surface)
        else [*part.corners.max(axis=(0, 1))[:2], *-part.corners.min(axis=(0, 1))[:2]]
        for part in parts
    ]
    x1, y1, x0, y0 = np.max(corners, axis=0) * [1, 1, -1, -1]
    path = Path(FOLDER.name) / "scene.xml"
    path.write_text(scene_xml([*things, Thing("plane", (), (9.0, 9.0, 0.0))]))
    config = parse_config(
        {"scene": {"path": str(path), "geoms": "all"}, "grid": {"cell_size": 0.13}}
    )
    lattice = fit_lattice(load_scene(config), config)
    cells = np.array([x1 - x0, y1 - y0]) / 0.13
    assume((np.abs(cells - np.round(cells)) > 1e-4).all())
    assert (lattice.width, lattice.height) == tuple(np.ceil(cells))
    low_x, low_y, high_x, high_y = lattice.bounds
    middle = (low_x + high_x) / 2, (low_y + high_y) / 2
    np.testing.assert_allclose(middle, [(x0 + x1) / 2, (y0 + y1) / 2], atol=1e-6)
    assert lattice.cell_size == 0.13


# ---------------------------------------------------------------- nearly touching


def touching_point(rng: Generator, rules: Rules) -> tuple[NDArray, NDArray]:
    """A point of the surface of a cell's volume, from its axis at the floor, and a unit normal.

    The normal is that of a plane that only touches the volume there; it doesn't point down.
    """
    # no side of it much smaller: what enters along it enters along each axis, too
    way = rng.uniform(0.5, 1.0, 3) * [rng.choice([-1, 1]), rng.choice([-1, 1]), 1]
    way[rng.random(3) < 0.3] = 0.0
    way = way / np.linalg.norm(way) if way.any() else np.array([0.0, 0.0, 1.0])
    across = np.hypot(way[0], way[1])
    square = np.sign(way[:2]) * rules.cell_size / 2
    disc = way[:2] / max(across, 1e-300) * rules.radius
    edge = max(square, disc, key=lambda p: p @ way[:2])  # the one that reaches farther
    if across == 0:
        edge = rng.uniform(-0.5, 0.5, 2) * rules.cell_size
    z = rules.height if way[2] > 0 else rng.uniform(rules.step, rules.height)
    return np.array([*edge, z]), way


def farthest(thing: Thing, way: NDArray) -> NDArray:
    """A point of a thing that is farthest along a way in its own frame."""
    size = np.array(thing.size)
    if thing.kind == "box":
        return np.sign(way) * size
    if thing.kind == "ellipsoid":
        return size**2 * way / np.linalg.norm(size * way)
    if thing.kind in ("sphere", "capsule"):
        along = size[1] * np.sign(way[2]) if thing.kind == "capsule" else 0.0
        return way * size[0] + np.array([0.0, 0.0, along])
    across = np.hypot(way[0], way[1])
    rim = way[:2] / across * size[0] if across > 1e-12 else np.zeros(2)
    return np.array([*rim, np.sign(way[2]) * size[1]])


@pytest.mark.parametrize("kind", ["sphere", "capsule", "ellipsoid", "cylinder", "box"])
def test_what_nearly_touches_a_cell(kind: str) -> None:
    """A solid 1.2e-7 to 1e-3 m off the volume of one cell leaves it free, one within fills it."""
    rng = np.random.default_rng(len(kind))
    compared = 0
    for _ in range(MORE or 25):
        cell = rng.choice([0.05, 0.1, 0.2])
        half = 4.5 * cell
        where = Rules(
            cell_size=float(cell),
            bounds=(-half, -half, half, half),
            radius=float(rng.choice([0.0, 0.05, 0.13, 0.31])),
            height=float(rng.uniform(0.5, 1.5)),
            min_area=9 * cell**2,
            shrink=0.0,
        )
        touch, way = touching_point(rng, where)
        gap = float(rng.choice([-2.5e-6, -1e-5, -1e-3, 1.2e-7, 1e-6, 1e-5, 1e-3]))
        count = {"sphere": 1, "capsule": 2, "cylinder": 2}.get(kind, 3)
        size = tuple(map(float, rng.uniform(0.02, 0.8, count)))
        turn = rng.normal(size=4) if rng.integers(3) else np.array([1.0, 0.0, 0.0, 0.0])
        quat = tuple(map(float, turn / np.linalg.norm(turn)))
        thing = Thing(kind, size, (0.0, 0.0, 0.0), quat)
        rot = rotation(quat)
        pos = touch + way * gap - rot @ farthest(thing, -way @ rot)
        placed = Thing(kind, size, tuple(map(float, pos)), quat)
        try:
            level = bake([Thing("plane", (), (0.0, 0.0, 0.0)), placed], where).levels[0]
        except SceneError:
            continue  # a large solid leaves too little floor
        if level.floor_height[4, 4] != 0.0:
            continue  # its top is the floor instead
        assert level.occupancy[4, 4] == (gap < 0), f"{gap} m: {placed}, {where}"
        compared += 1
    assert compared > 0.6 * (MORE or 25)
